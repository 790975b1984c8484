"""Heights over the ground: of a level surface that corrects labels (`HeightMap`), and the grids that they are found on."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import reduce

import numba
import numpy as np
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.votes import VoxelVotes

_TILE_M, _TILE_CUBES = 10.0, 5
"""Positions in a square of this edge (m) that holds fewer, with the squares around it, are single errors: one far away would
stretch a grid by all that lies between."""
_ANYTHING = -1
"""What compiled code is handed for a surface that scans may have taken for anything."""


class Surface(StrEnum):
    """What a height map is of; label: what lies there, taken_for: what scans took it for, None if for anything."""

    label: Label
    taken_for: Label | None

    def __new__(cls, name: str, label: Label, taken_for: Label | None) -> "Surface":
        """A member with its two labels."""
        surface = str.__new__(cls, name)
        surface._value_, surface.label, surface.taken_for = name, label, taken_for
        return surface

    CEILING = "ceiling", Label.CEILING, Label.CLUTTER
    GLIMPSED_CEILING = "glimpsed_ceiling", Label.CEILING, Label.CLUTTER
    SLOPING_CEILING = "sloping_ceiling", Label.CEILING, Label.CLUTTER
    RAISED_FLOOR = "raised_floor", Label.FLOOR, Label.CLUTTER
    FLOOR_BEYOND = "floor_beyond", Label.FLOOR, Label.CLUTTER
    STEP_FRONT = "step_front", Label.FLOOR, Label.CLUTTER
    CEILING_DROP = "ceiling_drop", Label.CEILING, Label.CLUTTER
    STOREY_BELOW = "storey_below", Label.OUTSIDE, Label.WALL
    MIRRORED_FLOOR = "mirrored_floor", Label.OUTSIDE, None


@dataclass(frozen=True)
class HeightMap:
    """Between which heights something lies: low_m and high_m (rows, columns) in the map frame, NaN where there is none.

    origin: (2,) x and y of the first cell's corner, metres; cell_m: the cells' edge.
    """

    surface: Surface
    origin: FloatArray
    cell_m: float
    low_m: FloatArray
    high_m: FloatArray

    @property
    def known(self) -> BoolArray:
        """(rows, columns) which cells have it."""
        return np.isfinite(self.low_m)

    @property
    def places(self) -> FloatArray:
        """(k, 3) the middles of the cells that have it, half way between its heights."""
        row, column = np.nonzero(self.known)
        middle_m = 0.5 * (self.low_m + self.high_m)[row, column]
        return np.column_stack([self.origin + (np.column_stack([column, row]) + 0.5) * self.cell_m, middle_m])

    def label_of(self, points_map: FloatArray, label: UInt8Array) -> UInt8Array:
        """The labels (n,) of points (n, 3); what scans took for something else at these heights gets the surface's label."""
        # As plain numbers: of an enumeration Numba looks at every member, each time that it is handed one.
        taken_for = self.surface.taken_for
        codes = _ANYTHING if taken_for is None else int(taken_for), int(self.surface.label)
        return np.asarray(
            _label_between(points_map, label, *codes, self.origin, self.cell_m, self.low_m, self.high_m)
        )


@numba.njit(cache=True, nogil=True)
def _label_between(
    points: FloatArray,
    label: UInt8Array,
    taken_for: int,
    wanted: int,
    origin: FloatArray,
    cell_m: float,
    low_m: FloatArray,
    high_m: FloatArray,
) -> UInt8Array:  # pragma: no cover
    """The labels (n,) of points (n, 3) with `wanted` in place of `taken_for`, or of anything, between heights of their cells."""
    corrected = label.copy()
    rows, columns = low_m.shape
    for i in range(len(points)):
        if label[i] == taken_for or taken_for == _ANYTHING:
            column, row = np.floor((points[i, 0] - origin[0]) / cell_m), np.floor((points[i, 1] - origin[1]) / cell_m)
            if 0 <= column < columns and 0 <= row < rows:
                cell = int(row), int(column)
                if low_m[cell] < points[i, 2] < high_m[cell]:
                    corrected[i] = wanted
    return corrected


def corrected(levels: Iterable[HeightMap], points_map: FloatArray, label: UInt8Array) -> UInt8Array:
    """The labels (n,) of points (n, 3), corrected by one level surface after the other."""
    return reduce(lambda labels, level: level.label_of(points_map, labels), levels, label)


@dataclass(frozen=True)
class GroundGrid:
    """A grid over the ground.

    origin: (2,) x and y of the first cell's corner, metres. shape: rows, columns. cell_m: edge of the cells.
    """

    origin: FloatArray
    shape: tuple[int, int]
    cell_m: float

    @classmethod
    def around(cls, position: FloatArray, cell_m: float, margin_m: float) -> "GroundGrid":
        """Holds positions (n, 3), except single ones far from all others."""
        if not len(position):
            return cls(np.zeros(2), (1, 1), cell_m)
        corner = position[:, :2].min(axis=0) - margin_m
        among = _among_others(position)
        kept = position[among, :2] if among.any() else position[:, :2]
        # What is left out moves no cell's edge.
        origin = corner + np.floor((kept.min(axis=0) - margin_m - corner) / cell_m) * cell_m
        columns, rows = np.floor((kept.max(axis=0) + margin_m - origin) / cell_m).astype(int) + 1
        return cls(origin, (int(rows), int(columns)), cell_m)

    def level(self, surface: Surface, height_m: FloatArray, margin_m: float | FloatArray) -> HeightMap:
        """A surface at a height (rows, columns), NaN where there is none, give or take a margin."""
        return HeightMap(surface, self.origin, self.cell_m, height_m - margin_m, height_m + margin_m)

    def cells(self, position: FloatArray) -> tuple[IntArray, IntArray]:
        """Row and column (n,) of each position (n, 3); the nearest at the edge for those outside."""
        row, column = np.floor((position[:, 1::-1] - self.origin[::-1]) / self.cell_m).astype(np.int64).T
        return np.clip(row, 0, self.shape[0] - 1), np.clip(column, 0, self.shape[1] - 1)

    def within(self, position: FloatArray) -> FloatArray:
        """Those of the positions (n, 3) that lie in the grid."""
        cell = np.floor((position[:, 1::-1] - self.origin[::-1]) / self.cell_m)
        return position[((cell >= 0) & (cell < self.shape)).all(axis=1)]

    def heights(self, position: FloatArray, quantile: float = 0.5) -> FloatArray:
        """(rows, columns) a quantile of the heights of each cell's positions (n, 3); NaN where there are none."""
        position = self.within(position)
        index = np.ravel_multi_index(self.cells(position), self.shape)
        order = np.lexsort((position[:, 2], index))
        own, first, count = np.unique(index[order], return_index=True, return_counts=True)
        height_m = np.full(self.shape, np.nan)
        height_m.flat[own] = position[order, 2][first + np.minimum((quantile * count).astype(np.int64), count - 1)]
        return height_m

    def highest(self, position: FloatArray) -> FloatArray:
        """(rows, columns, 3) the highest position of each cell; NaN where there is none."""
        position = self.within(position)
        position = position[np.argsort(position[:, 2], kind="stable")]
        highest = np.full((*self.shape, 3), np.nan)
        highest[self.cells(position)] = position
        return highest

    def ground_m(self, floor: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height of the floor's positions (m, 3) in each cell or the nearest with any, NaN without floor; cells to that one."""
        floor_m = self.heights(floor)
        away, nearest = nearest_known(np.isfinite(floor_m))
        return floor_m[nearest], away

    def above_m(self, position: FloatArray, ground_m: FloatArray) -> FloatArray:
        """(n,) heights of positions (n, 3) above the ground (rows, columns) in their cells."""
        return np.asarray(position[:, 2] - ground_m[self.cells(position)])

    def broad(self, mask: BoolArray, diameter_m: float) -> BoolArray:
        """The cells of a mask (rows, columns) that discs within it cover, and those next to them."""
        radius = 0.5 * diameter_m / self.cell_m
        core = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] >= radius
        if not core.any():
            return np.zeros_like(mask)
        return np.asarray(mask & (ndimage.distance_transform_edt(~core) <= radius + 1.0))


def grid_over_all(votes: VoxelVotes, cell_m: float, settings: LevelsSettings) -> tuple[GroundGrid, FloatArray]:
    """A grid over all cubes, and the floor's height (rows, columns) under each of its cells; NaN where no floor is known.

    votes: of the scans' labels.
    """
    grid = GroundGrid.around(votes.mean_position, cell_m, settings.ceiling_reach_m)
    floor = votes.seen(settings.votes_min) & (votes.label == Label.FLOOR)
    return grid, grid.ground_m(votes.mean_position[floor])[0]


def _among_others(position: FloatArray) -> BoolArray:
    """(n,) which positions (n, 3) have others around them."""
    tile = np.floor(position[:, :2] / _TILE_M).astype(np.int64)
    tile -= tile.min(axis=0)
    counts = np.zeros(tile.max(axis=0) + 1, np.int64)
    np.add.at(counts, tuple(tile.T), 1)
    return np.asarray(ndimage.maximum_filter(counts, 3)[tuple(tile.T)] >= _TILE_CUBES)


def nearest_known(known: BoolArray) -> tuple[FloatArray, tuple[IntArray, ...]]:
    """Cells to the nearest known cell, and its row and column; infinity, and each cell itself, where none is known."""
    if not known.any():
        return np.full(known.shape, np.inf), tuple(np.indices(known.shape))
    away, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    return away, tuple(nearest)


def closed(mask: BoolArray, size: int = 3) -> BoolArray:
    """The mask with gaps closed that are narrower than a window of some cells' edge."""
    return np.asarray(ndimage.binary_closing(mask, np.ones((size, size))))


def highest_around(height_m: FloatArray, size: int) -> FloatArray:
    """The highest height within a window of some cells' edge around each cell; minus infinity where none is known."""
    return np.asarray(ndimage.maximum_filter(np.where(np.isnan(height_m), -np.inf, height_m), size))


def range_around(height_m: FloatArray, size: int) -> FloatArray:
    """Difference between the highest and the lowest height within a window around each cell."""
    return highest_around(height_m, size) + highest_around(-height_m, size)


def windows_around(height_m: FloatArray, at: BoolArray, size: int) -> FloatArray:
    """(k, size * size) the heights within a window of some cells' edge around each of the cells `at` (rows, columns).

    Of the few cells that are asked for: the windows of all would take many times the map.
    """
    padded = np.pad(height_m, size // 2, constant_values=np.nan)
    return np.asarray(np.lib.stride_tricks.sliding_window_view(padded, (size, size))[at].reshape(-1, size * size))


def median_around(height_m: FloatArray) -> FloatArray:
    """The median height of each cell and its eight neighbours, NaN where none of them has one."""
    known = ndimage.binary_dilation(~np.isnan(height_m), np.ones((3, 3)))
    median_m = np.full(height_m.shape, np.nan)
    median_m[known] = np.nanmedian(windows_around(height_m, known, 3), axis=1)
    return median_m
