"""Differences between two results on one drive: labels, walls, doors, map cells, poses.

Lost walls, doors and cells are in the first result, A, alone; gained ones in the second, B.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth, Verdict
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import stretches
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.labels import UNLABELLED, verdicts

CLASSES = UNLABELLED + 1
"""The labels, and last without a label."""
CLASS_NAMES = (*(label.name.lower() for label in Label), "no label")
TRANSITIONS = CLASSES**2
WALL_M, WALL_DEG = 0.1, 10.0
"""Maximum distance (m) of and angle (°) between wall faces that are the same."""
SPOT_M = 1.5
"""Radius (m) of a spot in the map."""
_STEP_M = 0.05
_CELL_M = 0.5


class Became(IntEnum):
    """What the ground truth makes of a changed label."""

    RIGHT = 0
    WRONG = 1
    NEITHER = 2


def transitions(label_a: UInt8Array, label_b: UInt8Array) -> tuple[UInt8Array, UInt8Array]:
    """Return classes 0 to 6 of labels (m,) in A and B; 6 is without a label."""
    before, after = (
        np.where(label == NO_RETURN, UNLABELLED, label).astype(np.uint8)
        for label in (label_a, label_b)
    )
    return before, after


def count_transitions(label_a: UInt8Array, label_b: UInt8Array) -> IntArray:
    """Count points (7, 7) of class i in A and j in B, but those without a label in both."""
    before, after = transitions(label_a, label_b)
    joint = before.astype(np.int64) * CLASSES + after
    counts = np.bincount(joint, minlength=TRANSITIONS).reshape(CLASSES, CLASSES)
    counts[UNLABELLED, UNLABELLED] = 0
    return counts


def name_transition(code: int) -> str:
    """Return as in "wall → clutter". code: 7 × class in A + class in B."""
    return f"{CLASS_NAMES[code // CLASSES]} → {CLASS_NAMES[code % CLASSES]}"


def most_frequent(counts: Sequence[IntArray], most: int) -> list[int]:
    """Return the codes of the transitions with most points over all (7, 7) counts."""
    total = np.array(counts, np.int64).reshape(-1, CLASSES, CLASSES).sum(axis=0)
    np.fill_diagonal(total, 0)
    order = np.argsort(-total, axis=None, kind="stable")[:most]
    return [int(code) for code in order if total.flat[code] > 0]


def judge(truth: UInt8Array, label_a: UInt8Array, label_b: UInt8Array) -> UInt8Array:
    """Return what became of each label (n,), see `Became`. truth: (n,) see `Truth`."""
    right_a, right_b = (verdicts(truth, own) == Verdict.RIGHT for own in (label_a, label_b))
    became = np.where(right_b, np.uint8(Became.RIGHT), np.uint8(Became.WRONG))
    became[right_a == right_b] = Became.NEITHER
    return became


def count_judged(truth: UInt8Array, became: UInt8Array) -> IntArray:
    """Count points (11, 2) by their `Truth`, those that became right and wrong."""
    judged = became != Became.NEITHER
    joint = truth[judged].astype(np.int64) * 2 + became[judged]
    return np.bincount(joint, minlength=2 * len(Truth)).reshape(len(Truth), 2)


@dataclass(frozen=True)
class Spot:
    """Place in the map with most of some points.

    x_m, y_m: its centre. share: the part of the points within `SPOT_M` of it.
    first, last: the scans that hold the middle nine tenths of these.
    """

    x_m: float
    y_m: float
    share: float
    first: int
    last: int


class SpotFinder:
    """Counts points of a drive by scan and cell of the map; finds the place with most of them."""

    def __init__(self) -> None:
        self._rows: list[IntArray] = []

    def add(self, scan: int, points_map: FloatArray) -> None:
        """Add points (n, 3) of a scan."""
        cells = np.floor(points_map[:, :2] / _CELL_M).astype(np.int64)
        places, count = np.unique(cells, axis=0, return_counts=True)
        self._rows.append(np.column_stack([np.full(len(count), scan), places, count]))

    def find(self) -> Spot | None:
        """Return the place; None without points."""
        rows = np.concatenate([np.zeros((0, 4), np.int64), *self._rows])
        if not len(rows):
            return None
        scan, count = rows[:, 0], rows[:, 3]
        cells, cell = np.unique(rows[:, 1:3], axis=0, return_inverse=True)
        centre_m = (cells + 0.5) * _CELL_M
        total = np.bincount(cell, count)
        near = cKDTree(centre_m).query_ball_point(centre_m, SPOT_M)
        most = max(near, key=lambda own: float(total[own].sum()))
        x_m, y_m = np.average(centre_m[most], axis=0, weights=total[most])
        inside = np.isin(cell, most)
        in_time = np.sort(np.repeat(scan[inside], count[inside]))
        first, last = np.quantile(in_time, (0.05, 0.95), method="nearest").tolist()
        share = float(total[most].sum() / total.sum())
        return Spot(float(x_m), float(y_m), share, first, last)


@dataclass(frozen=True, eq=False)
class LabelChange:
    """Labels of the s scans that both runs have.

    scan, stamp_ns: (s,). counts: (s, 7, 7) points by their classes in both runs.
    changed_scan: (s,) number of labels of single scans that differ.
    voxels: changed points in the map, by their transitions.
    judged: (s, 11, 2) points by their `Truth` that became right and wrong; None without it.
    judged_voxels: such points in the map, by `Became`.
    spots: where most points became right and wrong, and where most changed.
    """

    scan: IntArray
    stamp_ns: IntArray
    counts: IntArray
    changed_scan: IntArray
    voxels: VoxelVotes
    judged: IntArray | None
    judged_voxels: VoxelVotes
    spots: tuple[Spot | None, Spot | None, Spot | None]

    @property
    def points(self) -> IntArray:
        """(s,) labelled points."""
        return np.asarray(self.counts.sum(axis=(1, 2)))

    @property
    def changed(self) -> IntArray:
        """(s,) final labels that differ."""
        return np.asarray(self.points - np.trace(self.counts, axis1=1, axis2=2))

    @property
    def worst(self) -> int | None:
        """Number of the scan with most changed labels; None if none changed."""
        changed = self.changed
        return int(self.scan[np.argmax(changed)]) if changed.any() else None


@dataclass(eq=False, kw_only=True)
class Changes:
    """Differences between two results; empty or None where nothing was compared.

    lost, gained: "walls" (n, 2, 2) in pieces and "cells" (n, 2) of A or B alone.
    doors: features of doors "lost", "gained" and "altered", each with a description.
    poses: time stamps (p,), and distances (p,) in metres, in the map and aligned.
    """

    labels: LabelChange | None = None
    lost: dict[str, FloatArray] = field(default_factory=dict)
    gained: dict[str, FloatArray] = field(default_factory=dict)
    doors: dict[str, list[tuple[Any, str]]] = field(default_factory=dict)
    poses: tuple[IntArray, FloatArray, FloatArray] | None = None


def compare_grids(a: GridMap, b: GridMap) -> tuple[FloatArray, FloatArray, dict[str, int]]:
    """Compare cells by their place.

    Returns the centres (n, 2) of the cells that are occupied in A and in B alone, and numbers of
    cells. Raises ValueError if cells differ in size.
    """
    if not np.isclose(a.cell_m, b.cell_m):
        raise ValueError(f"cells of {a.cell_m:g} m against cells of {b.cell_m:g} m")
    # Both are laid over the smallest rectangle that holds both.
    firsts = np.array([np.rint(grid.origin / grid.cell_m) for grid in (a, b)]).astype(np.int64)
    low = firsts.min(axis=0)
    stops = firsts + np.array([a.cells.shape, b.cells.shape])[:, ::-1]
    columns, rows = stops.max(axis=0) - low
    frame = GridMap(np.full((rows, columns), Cell.UNKNOWN, np.uint8), low * a.cell_m, a.cell_m)
    cells_a, cells_b = (grid.cells_within(frame) for grid in (a, b))
    occupied_a, occupied_b = cells_a == Cell.OCCUPIED, cells_b == Cell.OCCUPIED
    free_a, free_b = cells_a == Cell.FREE, cells_b == Cell.FREE
    lost, gained = occupied_a & ~occupied_b, occupied_b & ~occupied_a
    counted = {
        "occupied_lost": lost,
        "occupied_gained": gained,
        "occupied_kept": occupied_a & occupied_b,
        "free_lost": free_a & ~free_b,
        "free_gained": free_b & ~free_a,
    }
    figures = {name: int(np.count_nonzero(cells)) for name, cells in counted.items()}
    return frame.middles(lost), frame.middles(gained), figures


def unmatched_walls(ends: FloatArray, others: FloatArray) -> FloatArray:
    """Return the pieces (n, 2, 2) of wall faces along which none of the others runs."""
    places, direction = _sampled(others)
    tree = cKDTree(places) if len(places) else None
    pieces: list[FloatArray] = []
    for start, end in ends:
        length_m = float(np.linalg.norm(end - start))
        count = max(1, round(length_m / _STEP_M))
        along = (end - start) / max(length_m, 1e-9)
        middles = start + (end - start) * ((np.arange(count) + 0.5) / count)[:, None]
        covered = np.zeros(count, bool)
        if tree is not None:
            for k, near in enumerate(tree.query_ball_point(middles, WALL_M)):
                cosine = np.abs(direction[near] @ along)
                covered[k] = bool(np.any(cosine >= np.cos(np.radians(WALL_DEG))))
        for first, last in stretches(~covered, 0):
            piece = start + (end - start) * np.array([[first / count], [(last + 1) / count]])
            # Shorter pieces are ends that moved by less than two cells.
            if np.linalg.norm(piece[1] - piece[0]) >= 2 * _STEP_M:
                pieces.append(piece)
    return np.array(pieces).reshape(-1, 2, 2)


def _sampled(ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sample faces at most half a step apart: places (n, 2), and directions of their faces."""
    places, directions = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for start, end in ends:
        length_m = float(np.linalg.norm(end - start))
        part = np.linspace(0, 1, max(2, int(np.ceil(length_m / (0.5 * _STEP_M))) + 1))[:, None]
        places.append(start + (end - start) * part)
        directions.append(np.tile((end - start) / max(length_m, 1e-9), (len(part), 1)))
    return np.concatenate(places), np.concatenate(directions)
