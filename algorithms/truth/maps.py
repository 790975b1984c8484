"""Grid maps against the ground truth: cells of walls, doorways blocked (paper, IV.C, Fig. 9e)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.votes import VoxelVotes, columns_of, pack_column
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.doors import squared_distances
from ffmap.algorithms.truth.tally import VOXEL_M, majorities

WALL_TOLERANCE_M = 0.10
"""An occupied cell is right within this distance (m) of a true face; a true cell is found within it
of an occupied cell."""
WALL_RETURNS_MIN = 3
"""Minimum number of wall returns in a true cell."""


class Agreement(IntEnum):
    """What an overlay shows in a cell."""

    NOTHING = 0
    FREE = 1
    BOTH = 2  # wall in both
    ONLY_MAP = 3
    ONLY_REFERENCE = 4


@dataclass(frozen=True, eq=False)
class ComparedMap:
    """A map's occupied cells compared with the true wall faces.

    occupied: (m, 2) centres of the occupied cells; distance_m: (m,) to the nearest true face.
    true_cells: (k, 2) centres of the true cells; covered: (k,) whether an occupied cell is near.
    blocked: (D,) which of the doorways that were passed are blocked.
    cabinets: number of false cells on cabinets as high as the room.
    """

    grid: GridMap
    occupied: FloatArray
    distance_m: FloatArray
    true_cells: FloatArray
    covered: BoolArray
    blocked: BoolArray
    cabinets: int

    @property
    def right(self) -> BoolArray:
        """(m,) whether each occupied cell is near a true face."""
        return self.distance_m <= WALL_TOLERANCE_M + 1e-9

    @property
    def precision(self) -> float:
        """Share of the occupied cells that are right."""
        return float(self.right.mean()) if len(self.right) else float("nan")

    @property
    def recall(self) -> float:
        """Share of the true cells that are covered."""
        return float(self.covered.mean()) if len(self.covered) else float("nan")

    @property
    def error_m(self) -> float:
        """Mean distance of the right cells."""
        return float(self.distance_m[self.right].mean()) if self.right.any() else float("nan")

    @property
    def layers(self) -> Sequence[tuple[Agreement, FloatArray]]:
        """Places (m, 2) of each agreement in drawing order."""
        return (
            (Agreement.ONLY_REFERENCE, self.true_cells[~self.covered]),
            (Agreement.BOTH, self.occupied[self.right]),
            (Agreement.ONLY_MAP, self.occupied[~self.right]),
        )

    @property
    def agreement(self) -> UInt8Array:
        """`Agreement` of each cell of the grid."""
        free = self.grid.cells == Cell.FREE
        cells = np.where(free, Agreement.FREE, Agreement.NOTHING).astype(np.uint8)
        for agreement, places in self.layers:
            index, inside = self.grid.index(places)
            cells[index[inside, 1], index[inside, 0]] = agreement
        return cells


ComparedMaps = Mapping[str, ComparedMap]


def compare_map(
    grid: GridMap,
    faces: FloatArray,
    voxels: VoxelVotes,
    doors: FloatArray,
    wall_m: FloatArray,
) -> ComparedMap:
    """Compare a map with the ground truth.

    Args:
        faces: (F, 2, 2) true wall faces in the map.
        voxels: returns by their true classes, see `Tally.voxels`.
        doors: (D, 2, 2) jambs of the doors that were passed; wall_m: (D,) thickness of their walls.
    """
    occupied = grid.centres(Cell.OCCUPIED)
    distance_m = np.full(len(occupied), np.inf)
    for face in np.asarray(faces, np.float64):
        distance_m = np.minimum(distance_m, squared_distances(occupied, face))
    distance_m = np.sqrt(distance_m)
    true_cells = (_seen_cells(faces, voxels) + 0.5) * VOXEL_M
    false = occupied[distance_m > WALL_TOLERANCE_M + 1e-9]
    is_cabinet = majorities(voxels)[0] == Truth.FULL_HEIGHT_CABINET
    on_cabinet = _near(false, voxels.mean_position[is_cabinet, :2], WALL_TOLERANCE_M)
    return ComparedMap(
        grid=grid,
        occupied=occupied,
        distance_m=distance_m,
        true_cells=true_cells,
        covered=_near(true_cells, occupied, WALL_TOLERANCE_M + 1e-9),
        blocked=blocked_doors(grid, doors, wall_m),
        cabinets=int(np.count_nonzero(on_cabinet)),
    )


def _near(places: FloatArray, others: FloatArray, distance_m: float) -> BoolArray:
    """(n,) whether one of the others is within a distance."""
    if not len(places) or not len(others):
        return np.zeros(len(places), bool)
    return np.asarray(cKDTree(others).query(places)[0] <= distance_m)


def _seen_cells(faces: FloatArray, voxels: VoxelVotes) -> IntArray:
    """(k, 2) int64: the cells that faces run through and that hold enough returns of walls."""
    column, first = np.unique(columns_of(voxels.keys), return_index=True)
    if not len(column) or not len(faces):
        return np.zeros((0, 2), np.int64)
    returns = np.add.reduceat(voxels.counts[:, Truth.WALL], first, dtype=np.int64)
    cells = np.unique(np.concatenate([cells_along(face, VOXEL_M) for face in faces]), axis=0)
    return np.asarray(cells[np.isin(pack_column(cells), column[returns >= WALL_RETURNS_MIN])])


def cells_along(segment: FloatArray, cell_m: float) -> IntArray:
    """Return the cells (k, 2) of a grid that a segment (2, 2) runs through."""
    start, along = segment[0] * (1.0 / cell_m), (segment[1] - segment[0]) * (1.0 / cell_m)
    crossings = [np.array([0.0, 1.0])]
    for axis in range(2):
        if along[axis] != 0:
            low, high = sorted((start[axis], start[axis] + along[axis]))
            lines = np.arange(np.ceil(low), np.floor(high) + 1)
            crossings.append((lines - start[axis]) / along[axis])
    t = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middle = (t[:-1] + t[1:]) / 2
    return np.unique(np.floor(start + middle[:, None] * along).astype(np.int64), axis=0)


def blocked_doors(grid: GridMap, ends: FloatArray, depth_m: FloatArray) -> BoolArray:
    """Return (D,) whether free cells do not connect the two sides of each doorway.

    The area between the jambs is examined, to one cell beyond the wall on either side.

    Args:
        ends: (D, 2, 2) the jambs, along the sill in the middle of the wall.
        depth_m: (D,) thickness of the wall.
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
        blocked[d] = not np.any(np.intersect1d(region[:, 0], region[:, -1]) > 0)
    return blocked
