"""What differs between two results on the same drive: labels return by return, walls, doors, map cells, planes.

The first result, A, is the one that the second, B, is compared against: lost is what A has and B has not, gained the
other way round.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import stretches
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.doors import match_doors, match_nearest
from ffmap.algorithms.truth.labels import UNLABELLED

CLASSES = UNLABELLED + 1  # the labels, and last what has none


def classes_of(label: UInt8Array) -> UInt8Array:
    """Labels as numbers 0 to 6; what has no label is 6."""
    return np.where(label == NO_RETURN, UNLABELLED, label).astype(np.uint8)


def transitions(label_a: UInt8Array, label_b: UInt8Array) -> IntArray:
    """(7, 7) how many points have class i in A and j in B; places where neither has a label count nowhere.

    Raises ValueError where the labels are of clouds of different sizes.
    """
    if len(label_a) != len(label_b):
        raise ValueError(f"{len(label_a)} labels against {len(label_b)}")
    a, b = classes_of(label_a), classes_of(label_b)
    counts = np.bincount(a.astype(np.int64) * CLASSES + b, minlength=CLASSES**2).reshape(CLASSES, CLASSES)
    counts[UNLABELLED, UNLABELLED] = 0
    return counts


def changed_of(counts: IntArray) -> int:
    """How many points of a `transitions` matrix changed."""
    return int(counts.sum() - np.trace(counts))


@dataclass(frozen=True)
class WallChange:
    """Wall faces against wall faces, in metres of length.

    lost, gained: (n, 2, 2) the pieces of A's faces that none of B's runs along, and of B's that none of A's does.
    length_a_m, length_b_m: of all faces.
    """

    lost: FloatArray
    gained: FloatArray
    length_a_m: float
    length_b_m: float

    @property
    def lost_m(self) -> float:
        """Length of what was lost."""
        return float(lengths_m(self.lost).sum())

    @property
    def gained_m(self) -> float:
        """Length of what was gained."""
        return float(lengths_m(self.gained).sum())


def compare_walls(ends_a: FloatArray, ends_b: FloatArray) -> WallChange:
    """Pieces of wall faces (n, 2, 2) that have no partner within 10 cm and 10° in direction."""
    return WallChange(
        _uncovered(ends_a, ends_b),
        _uncovered(ends_b, ends_a),
        float(lengths_m(ends_a).sum()),
        float(lengths_m(ends_b).sum()),
    )


@dataclass(frozen=True)
class DoorChange:
    """Doors against doors.

    match: (n,) the door of B that each of A's is, -1 where it was lost. gained: (k,) those of B that match none of A's.
    """

    match: IntArray
    gained: IntArray

    @property
    def lost(self) -> IntArray:
        """Those of A that match none of B's."""
        return np.flatnonzero(self.match < 0)


def compare_doors(ends_a: FloatArray, ends_b: FloatArray) -> DoorChange:
    """Doors one to one by their sills (n, 2, 2), nearest first: midpoints within 0.3 m, directions within 15°."""
    match = match_doors(ends_a, ends_b)
    return DoorChange(match, np.setdiff1d(np.arange(len(ends_b)), match))


@dataclass(frozen=True)
class GridChange:
    """Occupied cells against occupied cells.

    lost, gained: (n, 2) centres of cells that only A's map, or only B's, has occupied. kept: how many both have.
    freed, blocked: how many cells were free in B alone, or in A alone.
    """

    lost: FloatArray
    gained: FloatArray
    kept: int
    freed: int
    blocked: int


def compare_grids(a: GridMap, b: GridMap) -> GridChange:
    """Cells by their place in the map. Raises ValueError where they differ in size."""
    if not np.isclose(a.cell_m, b.cell_m):
        raise ValueError(f"cells of {a.cell_m:g} m against cells of {b.cell_m:g} m")
    # Both over the smallest rectangle that holds both.
    firsts = np.array([np.rint(grid.origin / grid.cell_m) for grid in (a, b)]).astype(np.int64)
    low = firsts.min(axis=0)
    stops = firsts + np.array([a.cells.shape, b.cells.shape])[:, ::-1]
    columns, rows = stops.max(axis=0) - low
    frame = GridMap(np.full((rows, columns), Cell.UNKNOWN, np.uint8), low * a.cell_m, a.cell_m)
    cells_a, cells_b = (grid.cropped_to(frame).cells for grid in (a, b))
    occupied_a, occupied_b = cells_a == Cell.OCCUPIED, cells_b == Cell.OCCUPIED
    return GridChange(
        frame.middles(occupied_a & ~occupied_b),
        frame.middles(occupied_b & ~occupied_a),
        int(np.count_nonzero(occupied_a & occupied_b)),
        int(np.count_nonzero((cells_b == Cell.FREE) & (cells_a != Cell.FREE))),
        int(np.count_nonzero((cells_a == Cell.FREE) & (cells_b != Cell.FREE))),
    )


def match_planes(
    normal_a: FloatArray, offset_a_m: FloatArray, normal_b: FloatArray, offset_b_m: FloatArray
) -> tuple[int, int]:
    """How many of a scan's wall planes A has that B has not, and how many B that A has not.

    normal: (k, 2), offset_m: (k,) in the level frame of the same scan. One to one, within 5° and 5 cm.
    """
    if not len(normal_a) or not len(normal_b):
        return len(normal_a), len(normal_b)
    cosine = normal_a @ normal_b.T
    distance = np.abs(offset_a_m[:, None] - offset_b_m)
    possible = (cosine >= np.cos(np.radians(5.0))) & (distance <= 0.05)
    matched = int(np.count_nonzero(match_nearest(distance, possible) >= 0))
    return len(normal_a) - matched, len(normal_b) - matched


def _uncovered(ends: FloatArray, others: FloatArray) -> FloatArray:
    """(n, 2, 2) pieces of faces along which none of the others runs."""
    step_m = 0.05
    places, direction = _sampled(others, step_m)
    tree = cKDTree(places) if len(places) else None
    pieces: list[FloatArray] = []
    for start, end in ends:
        count = max(1, round(float(np.linalg.norm(end - start)) / step_m))
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
        middles = start + (end - start) * ((np.arange(count) + 0.5) / count)[:, None]
        covered = np.zeros(count, bool)
        if tree is not None:
            for k, near in enumerate(tree.query_ball_point(middles, 0.1)):
                cosine = np.abs(direction[near] @ along)
                covered[k] = bool(np.any(cosine >= np.cos(np.radians(10.0))))
        for first, last in stretches(~covered, 0):
            piece = start + (end - start) * np.array([[first / count], [(last + 1) / count]])
            if np.linalg.norm(piece[1] - piece[0]) >= 0.1:  # shorter ones are ends that moved by less than two cells
                pieces.append(piece)
    return np.array(pieces).reshape(-1, 2, 2)


def _sampled(ends: FloatArray, step_m: float) -> tuple[FloatArray, FloatArray]:
    """Places along faces, at most half a step apart, and the direction of the face of each."""
    places, directions = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for start, end in ends:
        length_m = float(np.linalg.norm(end - start))
        part = np.linspace(0, 1, max(2, int(np.ceil(length_m / (0.5 * step_m))) + 1))[:, None]
        places.append(start + (end - start) * part)
        directions.append(np.tile((end - start) / max(length_m, 1e-9), (len(part), 1)))
    return np.concatenate(places), np.concatenate(directions)
