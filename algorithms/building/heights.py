"""Heights over the ground: the map of a surface that corrects labels, and surfaces in a plan grid.

`HeightMap` is how a level or sloping surface is handed over. `PlanGrid` holds heights by cell.
`find_patches` divides one layer of heights into connected surfaces.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import reduce

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array

WINDOW = 5
"""Edge (cells) of the window that a plane is fitted in: 25 heights average the sensor's noise."""
_SHARE_MIN = 0.5
"""Minimum share of the window's cells with a height; with fewer, a plane is a line of returns."""
_SPREAD_MIN_M = 0.03
"""Heights that spread by less than this (m) along some direction do not define a plane."""
_BESIDE = [(0, 1), (0, 2), *((down, right) for down in (1, 2) for right in range(-2, 3))]
"""Half of the cells around one that join a part with it: one cell in between may lack returns."""
_TILE_M, _TILE_MIN = 10.0, 5
"""A grid leaves out positions with fewer others than this within one tile (m) to each side."""


class Surface(StrEnum):
    """Kind of a height map.

    label: of returns on the surface. taken_for: the only label that the surface corrects.
    """

    label: Label
    taken_for: Label

    def __new__(cls, name: str, label: Label, taken_for: Label) -> "Surface":
        surface = str.__new__(cls, name)
        surface._value_, surface.label, surface.taken_for = name, label, taken_for
        return surface

    CEILING = "ceiling", Label.CEILING, Label.CLUTTER
    CEILING_DROP = "ceiling_drop", Label.CEILING, Label.CLUTTER
    FLOOR = "floor", Label.FLOOR, Label.CLUTTER
    STEP_FRONT = "step_front", Label.FLOOR, Label.CLUTTER
    STOREY_BELOW = "storey_below", Label.OUTSIDE, Label.WALL


@dataclass(frozen=True)
class HeightMap:
    """Heights between which a surface lies, by cell of a plan grid.

    origin: (2,) x and y of the first cell's corner in the map (m). cell_m: edge of the cells.
    low_m, high_m: (rows, columns) heights in the map, NaN where the surface is missing.
    """

    surface: Surface
    origin: FloatArray
    cell_m: float
    low_m: FloatArray
    high_m: FloatArray

    @property
    def known(self) -> BoolArray:
        """(rows, columns) cells that have the surface."""
        return np.isfinite(self.low_m)

    @property
    def places(self) -> FloatArray:
        """(k, 3) centres of the cells that have the surface, half way between its heights."""
        row, column = np.nonzero(self.known)
        middle_m = 0.5 * (self.low_m + self.high_m)[row, column]
        xy = self.origin + (np.column_stack([column, row]) + 0.5) * self.cell_m
        return np.column_stack([xy, middle_m])

    def label_of(self, points_map: FloatArray, label: UInt8Array) -> UInt8Array:
        """Return the labels (n,) of points (n, 3), corrected between the surface's heights."""
        doubted = np.flatnonzero(label == self.surface.taken_for)
        cell = np.floor((points_map[doubted, 1::-1] - self.origin[::-1]) / self.cell_m)
        inside = ((cell >= 0) & (cell < self.low_m.shape)).all(axis=1)
        doubted, (row, column) = doubted[inside], cell[inside].astype(np.int64).T
        z = points_map[doubted, 2]
        between = (self.low_m[row, column] < z) & (z < self.high_m[row, column])
        corrected = label.copy()
        corrected[doubted[between]] = self.surface.label
        return corrected


def corrected(levels: Iterable[HeightMap], points: FloatArray, label: UInt8Array) -> UInt8Array:
    """Return the labels (n,) of points (n, 3), corrected by one height map after the other."""
    return reduce(lambda labels, level: level.label_of(points, labels), levels, label)


@dataclass(frozen=True)
class PlanGrid:
    """A grid over the ground.

    origin: (2,) x and y of the first cell's corner (m). shape: rows, columns. cell_m: edge.
    """

    origin: FloatArray
    shape: tuple[int, int]
    cell_m: float

    @classmethod
    def around(cls, position: FloatArray, cell_m: float, margin_m: float) -> "PlanGrid":
        """Cover positions (n, 3), except single ones far away, which would stretch the grid."""
        if not len(position):
            return cls(np.zeros(2), (1, 1), cell_m)
        among = _among_others(position)
        kept = position[among, :2] if among.any() else position[:, :2]
        # Cells are multiples of their edge from the map's origin: no position moves them.
        first = np.floor((kept.min(axis=0) - margin_m) / cell_m)
        columns, rows = (np.floor((kept.max(axis=0) + margin_m) / cell_m) - first).astype(int) + 1
        return cls(first * cell_m, (int(rows), int(columns)), cell_m)

    def cells(self, position: FloatArray) -> tuple[IntArray, IntArray]:
        """Row and column (n,) of positions (n, 3); outside the grid, of the nearest cell."""
        cell = np.floor((position[:, 1::-1] - self.origin[::-1]) / self.cell_m).astype(np.int64)
        row, column = np.clip(cell, 0, np.array(self.shape) - 1).T
        return row, column

    def places(self, position: FloatArray, quantile: float) -> FloatArray:
        """(rows, columns, 3) each cell's position at a quantile of its heights, NaN without."""
        high = self.origin + self.cell_m * np.array(self.shape[::-1])
        inside = (position[:, :2] >= self.origin) & (position[:, :2] < high)
        position = position[inside.all(axis=1)]
        index = np.ravel_multi_index(self.cells(position), self.shape)
        order = np.lexsort((position[:, 2], index))
        own, first, count = np.unique(index[order], return_index=True, return_counts=True)
        place = first + np.minimum((quantile * count).astype(np.int64), count - 1)
        places = np.full((*self.shape, 3), np.nan)
        places.reshape(-1, 3)[own] = position[order[place]]
        return places

    def heights(self, position: FloatArray, quantile: float) -> FloatArray:
        """(rows, columns) a quantile of the heights of each cell's positions, NaN without."""
        return self.places(position, quantile)[..., 2]

    def map(self, surface: Surface, middle_m: FloatArray, half_m: float | FloatArray) -> HeightMap:
        """A height map on this grid, from its middle (rows, columns) and half its thickness."""
        return HeightMap(surface, self.origin, self.cell_m, middle_m - half_m, middle_m + half_m)


def _among_others(position: FloatArray) -> BoolArray:
    """(n,) positions (n, 3) that have others around them."""
    tile = np.floor(position[:, :2] / _TILE_M).astype(np.int64)
    tile -= tile.min(axis=0)
    counts = np.zeros(tile.max(axis=0) + 1, np.int64)
    np.add.at(counts, tuple(tile.T), 1)
    return np.asarray(ndimage.maximum_filter(counts, 3)[tuple(tile.T)] >= _TILE_MIN)


@dataclass(frozen=True)
class Patches:
    """Surfaces in one layer of heights: connected cells whose heights lie on local planes.

    number: (rows, columns) patch of each cell, from 1; 0 elsewhere.
    height_m, slope: (rows, columns) of the plane nearest to a cell, at the cell's centre.
    width_m: (patches + 1,) diameter of the largest disc in each patch (m).
    """

    number: IntArray
    height_m: FloatArray
    slope: FloatArray
    width_m: FloatArray

    def medians(self, values: FloatArray) -> FloatArray:
        """(patches + 1,) the median of values (rows, columns) over each patch."""
        return np.asarray(ndimage.median(values, self.number, np.arange(len(self.width_m))))


def find_patches(
    grid: PlanGrid, places: FloatArray, flat_m: float, margin_m: float, slope_max: float
) -> Patches:
    """Divide one layer of heights into patches.

    A patch grows over cells whose windows fit a plane, and over their neighbours within a window
    that lie on it. Steps interrupt it, slopes do not.

    Args:
        places: (rows, columns, 3) one position of each cell, NaN without.
        flat_m: maximum RMS distance of a window's positions from their plane.
        margin_m: maximum distance of a cell's position from the nearest plane.
        slope_max: maximum rise per metre.
    """
    mean, gradient, rms_m, share = _planes_around(places)
    slope = np.linalg.norm(gradient, axis=2)
    core = (rms_m < flat_m) & (share >= _SHARE_MIN) & (slope < slope_max)
    parts, _ = ndimage.label(core, np.ones((3, 3)))
    away, nearest = nearest_known(core)
    mean, gradient, slope = mean[nearest], gradient[nearest], slope[nearest]

    def plane_m(xy: FloatArray) -> FloatArray:
        return np.asarray(mean[..., 2] + ((xy - mean[..., :2]) * gradient).sum(axis=2))

    off_m = np.abs(places[..., 2] - plane_m(places[..., :2]))
    member = core | ((off_m < margin_m) & (away <= WINDOW // 2))
    number = np.where(member, parts[nearest], 0)
    boxes = enumerate(ndimage.find_objects(number), 1)
    widths = [0.0, *(_width(number[box] == i) for i, box in boxes)]
    centres = grid.origin + (np.indices(grid.shape)[::-1].transpose(1, 2, 0) + 0.5) * grid.cell_m
    return Patches(number, plane_m(centres), slope, grid.cell_m * np.array(widths))


def _width(mask: BoolArray) -> float:
    """Diameter (cells) of the largest disc in a mask without its small gaps."""
    filled = ndimage.binary_closing(np.pad(mask, 3), np.ones((3, 3)))
    return float(2.0 * ndimage.distance_transform_edt(filled).max() - 1.0)


def _planes_around(
    places: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit z = z₀ + g·(x, y) to the places in the window around each cell, by least squares.

    Returns the mean (rows, columns, 3), the gradient g (rows, columns, 2), the RMS residual
    (rows, columns; m) and the share of the window's cells with a place.
    """
    there = np.isfinite(places[..., 0])
    share = ndimage.uniform_filter(there.astype(np.float64), WINDOW, mode="constant")
    middle = np.nanmean(places, axis=(0, 1)) if there.any() else np.zeros(3)
    shifted = np.where(there[..., None], places - middle, 0.0)

    def mean_of(values: FloatArray) -> FloatArray:
        return np.asarray(ndimage.uniform_filter(values, WINDOW, mode="constant") / share)

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([mean_of(shifted[..., i]) for i in range(3)], axis=2)
        xx, xy, xz, yy, yz, zz = (
            mean_of(shifted[..., i] * shifted[..., j]) - mean[..., i] * mean[..., j]
            for i in range(3)
            for j in range(i, 3)
        )
        determinant = xx * yy - xy**2
        gradient = np.stack([xz * yy - yz * xy, yz * xx - xz * xy], axis=2)
        gradient /= determinant[..., None]
        gradient[~(determinant > _SPREAD_MIN_M**4)] = np.nan
        residual = zz - gradient[..., 0] * xz - gradient[..., 1] * yz
    return mean + middle, gradient, np.sqrt(np.maximum(residual, 0.0)), share


def level_parts(mask: BoolArray, height_m: FloatArray, flat_m: float) -> IntArray:
    """(rows, columns) parts of a mask, from 1, whose neighbours differ by less than `flat_m`."""
    cell = np.arange(mask.size).reshape(mask.shape)
    rows, columns = mask.shape
    one, other = [], []
    for down, right in _BESIDE:
        here = slice(0, rows - down), slice(max(0, -right), columns - max(0, right))
        there = slice(down, rows), slice(max(0, right), columns - max(0, -right))
        joins = mask[here] & mask[there] & (np.abs(height_m[here] - height_m[there]) < flat_m)
        one.append(cell[here][joins])
        other.append(cell[there][joins])
    edges = np.concatenate(one), np.concatenate(other)
    graph = coo_array((np.ones(len(edges[0]), bool), edges), shape=(mask.size, mask.size))
    _, part = connected_components(graph, directed=False)
    parts: IntArray = np.zeros(mask.shape, np.int64)
    parts[mask] = np.unique(part[mask.reshape(-1)], return_inverse=True)[1] + 1
    return parts


def nearest_known(known: BoolArray) -> tuple[FloatArray, tuple[IntArray, ...]]:
    """Distance (cells) to the nearest known cell, and its row and column.

    Without any known cell: infinity, and each cell itself.
    """
    if not known.any():
        return np.full(known.shape, np.inf), tuple(np.indices(known.shape))
    away, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    return away, tuple(nearest)


def highest_around(height_m: FloatArray, size: int) -> FloatArray:
    """The maximum height in a window of `size` cells around each cell, NaN where none is known."""
    top_m = ndimage.maximum_filter(np.where(np.isnan(height_m), -np.inf, height_m), size)
    return np.where(np.isfinite(top_m), top_m, np.nan)


def lowest_around(height_m: FloatArray, size: int) -> FloatArray:
    """The minimum height in a window of `size` cells around each cell, NaN where none is known."""
    return -highest_around(-height_m, size)
