"""Grid maps against the truth: wall cells right, false and missed, doorways blocked (paper, IV.C, Fig. 9e)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.votes import VoxelVotes, columns_of, pack_column
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.doors import squared_distance
from ffmap.algorithms.truth.labels import ratio
from ffmap.algorithms.truth.tally import CUBE_M, Tally, majorities

WALL_TOLERANCE_M = 0.10
"""An occupied cell is right within this distance of a true face, and a true cell found within it of an occupied one."""


class Agreement(IntEnum):
    """What an overlay shows in a cell."""

    NOTHING = 0
    FREE = 1
    BOTH = 2  # wall in both
    ONLY_MAP = 3
    ONLY_REFERENCE = 4
    NOT_SEEN = 5  # wall of the ground truth where the map knows nothing


@dataclass(frozen=True)
class WallMapFigures:
    """The map's occupied cells against the true wall faces.

    occupied: (m, 2) centres of the occupied cells. distance_m: (m,) to the nearest true face (infinite without any).
    true_cells: (k, 2) centres of the true cells. covered: (k,) bool, whether an occupied cell lies near each.
    """

    occupied: FloatArray
    distance_m: FloatArray
    true_cells: FloatArray
    covered: BoolArray

    @property
    def right(self) -> BoolArray:
        """(m,) whether each occupied cell lies near a true face."""
        return self.distance_m <= WALL_TOLERANCE_M + 1e-9

    @property
    def precision(self) -> float:
        return ratio(int(np.count_nonzero(self.right)), len(self.right))

    @property
    def recall(self) -> float:
        return ratio(int(np.count_nonzero(self.covered)), len(self.covered))

    @property
    def error_m(self) -> float:
        """Mean distance of the right cells; NaN without any."""
        return float(self.distance_m[self.right].mean()) if self.right.any() else float("nan")


def compare_wall_map(faces: FloatArray, cubes: VoxelVotes, grid: GridMap) -> WallMapFigures:
    """Occupied cells against true wall faces (F, 2, 2), both in the map's frame.

    A true cell is a 5 cm cell that a face runs through and that holds at least 3 returns of walls.
    """
    occupied = grid.centres(Cell.OCCUPIED)
    cells = _seen_cells(faces, cubes)
    true_cells = (cells + 0.5) * CUBE_M
    if len(occupied) and len(true_cells):
        nearest = cKDTree(occupied).query(true_cells)[0]
        covered = nearest <= WALL_TOLERANCE_M + 1e-9
    else:
        covered = np.zeros(len(true_cells), bool)
    distance = _distance_to_segments(occupied, np.ascontiguousarray(faces, np.float64))
    return WallMapFigures(occupied, distance, true_cells, covered)


@numba.njit(cache=True, nogil=True)
def _distance_to_segments(points: FloatArray, segments: FloatArray) -> FloatArray:  # pragma: no cover
    distance = np.full(len(points), np.inf)
    for i in range(len(points)):
        for k in range(len(segments)):
            distance[i] = min(distance[i], squared_distance(points[i, 0], points[i, 1], segments[k]))
    root: FloatArray = np.sqrt(distance)
    return root


def _seen_cells(faces: FloatArray, cubes: VoxelVotes) -> IntArray:
    """(k, 2) int64: the cells that faces run through and that hold enough returns of walls."""
    column, first = np.unique(columns_of(cubes.keys), return_index=True)
    if not len(column) or not len(faces):
        return np.zeros((0, 2), np.int64)
    returns = np.add.reduceat(cubes.counts[:, Truth.WALL], first, dtype=np.int64)
    cells = np.unique(np.concatenate([cells_along(face, CUBE_M) for face in faces]), axis=0)
    seen: IntArray = cells[np.isin(pack_column(cells), column[returns >= 3])]
    return seen


def cells_along(segment: FloatArray, cell_m: float) -> IntArray:
    """(k, 2) int64: the cells of a grid that a segment (2, 2) runs through."""
    start, along = segment[0] * (1.0 / cell_m), (segment[1] - segment[0]) * (1.0 / cell_m)
    crossings = [np.array([0.0, 1.0])]
    for axis in range(2):
        if along[axis] != 0:
            low, high = sorted((start[axis], start[axis] + along[axis]))
            crossings.append((np.arange(np.ceil(low), np.floor(high) + 1) - start[axis]) / along[axis])
    t = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middle = (t[:-1] + t[1:]) / 2
    cells: IntArray = np.unique(np.floor(start + middle[:, None] * along).astype(np.int64), axis=0)
    return cells


@dataclass(frozen=True, eq=False)
class ComparedMap:
    """A map with its figures.

    unseen: (m, 2) walls of what it was compared with that count nowhere. blocked: which doors that were passed are
    blocked in it; None where no doors are known. cabinets: how many of its false cells are cabinets as high as the room.
    """

    grid: GridMap
    figures: WallMapFigures
    unseen: FloatArray
    blocked: BoolArray | None = None
    cabinets: int | None = None

    @property
    def agreement(self) -> UInt8Array:
        return overlay(self.grid, self.figures, self.unseen)


ComparedMaps = Mapping[str, ComparedMap]


def compare_with_truth(
    maps: Mapping[str, GridMap], faces: FloatArray, tally: Tally, door_ends: FloatArray, wall_m: FloatArray
) -> ComparedMaps:
    """faces: (F, 2, 2) true walls. door_ends: (D, 2, 2) jambs of the doors passed; wall_m: (D,) how thick their walls are."""
    cubes = tally.cubes
    cabinets = cubes.mean_position[majorities(cubes)[0] == Truth.FULL_HEIGHT_CABINET, :2]
    compared = {}
    for name, grid in maps.items():
        figures = compare_wall_map(faces, cubes, grid)
        false = figures.occupied[~figures.right]
        near = cKDTree(cabinets).query(false)[0] <= WALL_TOLERANCE_M if len(cabinets) and len(false) else np.zeros(0)
        compared[name] = ComparedMap(
            grid, figures, np.zeros((0, 2)), blocked_doors(grid, door_ends, wall_m), int(np.count_nonzero(near))
        )
    return compared


def false_and_missed(figures: WallMapFigures, unseen: FloatArray) -> Sequence[tuple[Agreement, FloatArray]]:
    """What an overlay draws over the map, the later above: each agreement with its places (m, 2)."""
    return [
        (Agreement.NOT_SEEN, unseen),
        (Agreement.ONLY_REFERENCE, figures.true_cells[~figures.covered]),
        (Agreement.BOTH, figures.occupied[figures.right]),
        (Agreement.ONLY_MAP, figures.occupied[~figures.right]),
    ]


def overlay(grid: GridMap, figures: WallMapFigures, unseen: FloatArray) -> UInt8Array:
    """(rows, columns) `Agreement`, rows as the grid's: a map with what it is compared with laid over (Fig. 9e).

    unseen: (m, 2) walls of what it is compared with that count nowhere.
    """
    cells = np.where(grid.cells == Cell.FREE, Agreement.FREE, Agreement.NOTHING).astype(np.uint8)
    for agreement, places in false_and_missed(figures, unseen):
        index, inside = grid.index(places)
        cells[index[inside, 1], index[inside, 0]] = agreement
    return cells


def blocked_doors(grid: GridMap, ends: FloatArray, depth_m: FloatArray) -> BoolArray:
    """(D,) whether free cells do not connect the two sides of each doorway.

    ends: (D, 2, 2) the jambs, along the sill in the middle of the wall. depth_m: (D,) the wall's thickness. Looked at is
    what lies between the jambs, one cell beyond the wall on either side.
    """
    blocked, step_m = np.ones(len(ends), bool), 0.02
    for d, (left, right) in enumerate(ends):
        width_m = float(np.linalg.norm(right - left))
        along = (right - left) / max(width_m, 1e-9)
        across = np.array([-along[1], along[0]])
        half_m = 0.5 * depth_m[d] + grid.cell_m
        u = np.arange(0.5 * step_m, width_m, step_m)
        v = np.linspace(-half_m, half_m, 2 * int(np.ceil(half_m / step_m)) + 1)
        places = left + u[:, None, None] * along + v[None, :, None] * across
        index, inside = grid.index(places)
        free = np.zeros(inside.shape, bool)
        free[inside] = grid.cells[index[inside][:, 1], index[inside][:, 0]] == Cell.FREE
        region = label(free)[0]
        through = np.intersect1d(region[:, 0], region[:, -1])
        blocked[d] = not np.any(through > 0)
    return blocked
