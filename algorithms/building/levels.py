"""The level and sloping surfaces of the whole building, for what single scans saw too little of or took for something else.

Ceilings, floors that lie higher than where the robot stood, ducts that passed for ceilings, and what passed for floor.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import reduce

import numba
import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.votes import VoxelVotes

_TILE_M, _TILE_CUBES = 10.0, 5
"""Positions in a square of this edge (m) that holds fewer, with the squares around it, are single errors: one far away would
stretch a grid by all that lies between."""


class LevelsSettings(StepSettings):
    """Floors, ceilings and ducts that only all scans together show."""

    cell_m: float = Field(0.1, gt=0, description="Edge of the cells (m) where no other is given.")
    votes_min: int = Field(3, ge=1, description="Minimum number of votes at which a cube's label is taken as known.")
    margin_m: float = Field(0.04, gt=0, description="Half thickness (m) of a level surface: drift and scatter.")
    flat_m: float = Field(0.03, gt=0, description="Maximum height difference (m) of a level cell from its neighbours.")
    seen_floor_width_m: float = Field(0.3, gt=0, description="Minimum diameter (m) of a disc that proves floor.")
    false_floor_min_m: float = Field(
        0.2,
        gt=0,
        description="What scans took for floor higher than this (m) above the nearest proven floor is clutter.",
    )
    ceiling_cell_m: float = Field(0.25, gt=0, description="Edge of the cells (m) of the ceilings that scans found.")
    ceiling_reach_m: float = Field(
        1.5, ge=0, description="Maximum distance (m) over which a ceiling goes on level beyond where it was seen."
    )
    overhead_min_m: float = Field(2.2, gt=0, description="Minimum height (m) above the floor of a glimpsed ceiling.")
    overhead_width_m: float = Field(
        0.8, gt=0, description="Minimum diameter (m) of a disc in a ceiling; ducts are narrower."
    )
    overhead_gap_m: float = Field(0.3, ge=0, description="Minimum distance (m) of it from a higher ceiling.")
    slope_min: float = Field(0.15, gt=0, description="Minimum rise per metre of a sloping ceiling.")
    slope_max: float = Field(1.8, gt=0, description="Maximum rise per metre of a sloping ceiling; steeper is a wall.")
    slope_bottom_m: float = Field(1.0, gt=0, description="Minimum height (m) above the floor of a sloping ceiling.")
    slope_window_cells: int = Field(5, ge=3, description="Edge, in cells, of the window that a plane is fitted to.")
    slope_share_min: float = Field(0.6, gt=0, le=1, description="Minimum share of a window's cells that hold returns.")
    slope_rms_max_m: float = Field(0.025, gt=0, description="Maximum RMS distance (m) of returns from their plane.")
    slope_reach_m: float = Field(
        0.25, ge=0, description="Distance (m) over which a sloping ceiling goes on beyond the windows, up to its walls."
    )
    raised_min_m: float = Field(
        0.06, gt=0, description="Minimum height (m) of a step or platform above the floor beside it; carpets are lower."
    )
    raised_max_m: float = Field(
        0.30, gt=0, description="Maximum height (m) of a step or platform above the floor beside it; seats are higher."
    )
    raised_width_m: float = Field(1.2, gt=0, description="Minimum diameter (m) of a disc in a platform.")
    beyond_cell_m: float = Field(0.3, gt=0, description="Edge of the cells (m) for floor beyond what scans found.")
    beyond_level_m: float = Field(0.05, gt=0, description="Maximum height difference (m) of it from the nearest floor.")
    beyond_width_m: float = Field(0.9, gt=0, description="Minimum diameter (m) of a disc within such floor.")
    step_min_m: float = Field(0.08, gt=0, description="Minimum height (m) of a step between two floors.")
    step_max_m: float = Field(0.32, gt=0, description="Maximum height (m) of a step between two floors.")
    step_window_cells: int = Field(
        5, ge=3, description="Edge (cells) of the window within which floors meet in a step."
    )
    duct_drop_m: float = Field(0.08, gt=0, description="Minimum distance (m) of a duct below the ceiling beside it.")
    duct_beside_m: float = Field(0.4, gt=0, description="Maximum distance (m) to the ceiling beside a duct.")
    ceiling_edge_m: float = Field(0.3, ge=0, description="Width (m) of a ceiling's edge, where another may begin.")
    riser_max_m: float = Field(
        1.5,
        gt=0,
        description="Maximum height (m) between two ceilings that meet, as at a coffer or a rooflight's shaft.",
    )
    below_floor_m: float = Field(
        0.4, gt=0, description="What stands lower than this (m) below the nearest floor belongs to the storey below."
    )


class Surface(StrEnum):
    """What a height map is of; label: what lies there, taken_for: what scans took it for."""

    label: Label
    taken_for: Label

    def __new__(cls, name: str, label: Label, taken_for: Label) -> "Surface":
        """A member with its two labels."""
        surface = str.__new__(cls, name)
        surface._value_, surface.label, surface.taken_for = name, label, taken_for
        return surface

    FALSE_FLOOR = "false_floor", Label.CLUTTER, Label.FLOOR
    CEILING = "ceiling", Label.CEILING, Label.CLUTTER
    GLIMPSED_CEILING = "glimpsed_ceiling", Label.CEILING, Label.CLUTTER
    SLOPING_CEILING = "sloping_ceiling", Label.CEILING, Label.CLUTTER
    RAISED_FLOOR = "raised_floor", Label.FLOOR, Label.CLUTTER
    FLOOR_BEYOND = "floor_beyond", Label.FLOOR, Label.CLUTTER
    STEP_FRONT = "step_front", Label.FLOOR, Label.CLUTTER
    DUCT = "duct", Label.CLUTTER, Label.CEILING
    CEILING_RISER = "ceiling_riser", Label.CEILING, Label.CLUTTER
    STOREY_BELOW = "storey_below", Label.OUTSIDE, Label.WALL


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
        surface = self.surface
        return np.asarray(
            _label_between(
                points_map, label, surface.taken_for, surface.label, self.origin, self.cell_m, self.low_m, self.high_m
            )
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
    """The labels (n,) of points (n, 3) with `wanted` in place of `taken_for` between two heights of their cells."""
    corrected = label.copy()
    rows, columns = low_m.shape
    for i in range(len(points)):
        if label[i] == taken_for:
            column, row = np.floor((points[i, 0] - origin[0]) / cell_m), np.floor((points[i, 1] - origin[1]) / cell_m)
            if 0 <= column < columns and 0 <= row < rows:
                cell = int(row), int(column)
                if low_m[cell] < points[i, 2] < high_m[cell]:
                    corrected[i] = wanted
    return corrected


def corrected(levels: Iterable[HeightMap], points_map: FloatArray, label: UInt8Array) -> UInt8Array:
    """The labels (n,) of points (n, 3), corrected by one level surface after the other."""
    return reduce(lambda labels, level: level.label_of(points_map, labels), levels, label)


def map_levels(votes: VoxelVotes, settings: LevelsSettings) -> tuple[HeightMap, ...]:
    """All level surfaces of the building, in the order in which they correct labels; votes: of the scans' labels."""
    false_floors = map_false_floors(votes, settings)
    votes = _corrected_votes(votes, false_floors)
    ceilings = [find(votes, settings) for find in (map_ceilings, map_glimpsed_ceilings, map_sloping_ceilings)]
    # Far away, returns are far apart.
    raised = [map_raised_floors(votes, settings, cell_m) for cell_m in (settings.cell_m, 2 * settings.cell_m)]
    with_raised = reduce(_corrected_votes, raised, votes)
    floors = (*raised, map_floors_beyond(with_raised, settings), map_step_fronts(with_raised, settings))
    ducts = map_ducts(votes, settings)
    risers = map_ceiling_risers(reduce(_corrected_votes, [*ceilings, ducts], votes), settings)
    below = map_storey_below(with_raised, settings)
    levels = (false_floors, *ceilings, *floors, ducts, risers, below)
    return tuple(level for level in levels if level.known.any())


def _corrected_votes(votes: VoxelVotes, level: HeightMap) -> VoxelVotes:
    """The votes, corrected where scans took something else for what lies there."""
    label = votes.label
    wrong = level.label_of(votes.mean_position, label) != label
    counts = votes.counts.copy()
    counts[wrong, level.surface.label] += counts[wrong, level.surface.taken_for]
    counts[wrong, level.surface.taken_for] = 0
    return replace(votes, counts=counts)


# --- grids over the ground ---


@dataclass(frozen=True)
class _Grid:
    """A grid over the ground.

    origin: (2,) x and y of the first cell's corner, metres. shape: rows, columns. cell_m: edge of the cells.
    """

    origin: FloatArray
    shape: tuple[int, int]
    cell_m: float

    @classmethod
    def around(cls, position: FloatArray, cell_m: float, margin_m: float) -> "_Grid":
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
        away, nearest = _nearest(np.isfinite(floor_m))
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


def _among_others(position: FloatArray) -> BoolArray:
    """(n,) which positions (n, 3) have others around them."""
    tile = np.floor(position[:, :2] / _TILE_M).astype(np.int64)
    tile -= tile.min(axis=0)
    counts = np.zeros(tile.max(axis=0) + 1, np.int64)
    np.add.at(counts, tuple(tile.T), 1)
    return np.asarray(ndimage.maximum_filter(counts, 3)[tuple(tile.T)] >= _TILE_CUBES)


def _nearest(known: BoolArray) -> tuple[FloatArray, tuple[IntArray, ...]]:
    """Cells to the nearest known cell, and its row and column; infinity, and each cell itself, where none is known."""
    if not known.any():
        return np.full(known.shape, np.inf), tuple(np.indices(known.shape))
    away, nearest = ndimage.distance_transform_edt(~known, return_indices=True)
    return away, tuple(nearest)


def _closed(mask: BoolArray, size: int = 3) -> BoolArray:
    """The mask with gaps closed that are narrower than a window of some cells' edge."""
    return np.asarray(ndimage.binary_closing(mask, np.ones((size, size))))


def _highest_around(height_m: FloatArray, size: int) -> FloatArray:
    """The highest height within a window of some cells' edge around each cell; minus infinity where none is known."""
    return np.asarray(ndimage.maximum_filter(np.where(np.isnan(height_m), -np.inf, height_m), size))


def _range_around(height_m: FloatArray, size: int) -> FloatArray:
    """Difference between the highest and the lowest height within a window around each cell."""
    return _highest_around(height_m, size) + _highest_around(-height_m, size)


def _median_around(height_m: FloatArray) -> FloatArray:
    """The median height of each cell and its eight neighbours, NaN where none of them has one."""
    padded = np.pad(height_m, 1, constant_values=np.nan)
    known = ndimage.binary_dilation(~np.isnan(height_m), np.ones((3, 3)))
    # The windows of the few cells that are known: those of all would take nine times the map.
    nine = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))[known].reshape(-1, 9)
    median_m = np.full(height_m.shape, np.nan)
    median_m[known] = np.nanmedian(nine, axis=1)
    return median_m


# --- ceilings and ducts ---


def map_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The ceilings that scans found: in each cell the median height of its cubes, around them the nearest cell's."""
    position = votes.mean_position[(votes.label == Label.CEILING) & votes.seen(settings.votes_min)]
    grid = _Grid.around(position, settings.ceiling_cell_m, settings.ceiling_reach_m)
    median_m = grid.heights(position)
    away, nearest = _nearest(np.isfinite(median_m))
    height_m = np.where(away * grid.cell_m <= settings.ceiling_reach_m, median_m[nearest], np.nan)
    return grid.level(Surface.CEILING, height_m, settings.margin_m)


def _heights_above_floor(votes: VoxelVotes, settings: LevelsSettings) -> tuple[_Grid, FloatArray]:
    """A grid over all cubes, and their heights (m,) above the floor; NaN where no floor is known."""
    floor = votes.seen(settings.votes_min) & (votes.label == Label.FLOOR)
    position = votes.mean_position
    grid = _Grid.around(position, settings.cell_m, settings.ceiling_reach_m)
    return grid, grid.above_m(position, grid.ground_m(position[floor])[0])


def map_glimpsed_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Ceilings that no scan found, of rooms seen through a doorway: the highest there is, level, and too broad for a duct.

    A scan finds the ceiling above it; to it, what is higher or lower is clutter. Where its plane meets the walls of a room with
    a higher ceiling, it leaves a line of ceiling on them: only a ceiling that is higher shows that something hangs below it.
    """
    grid, above_m = _heights_above_floor(votes, settings)
    label, position = votes.label, votes.mean_position
    highest_m = grid.heights(position[(label == Label.CLUTTER) & (above_m > settings.overhead_min_m)], 1.0)
    ceiling_m = grid.heights(position[votes.seen(settings.votes_min) & (label == Label.CEILING)], 1.0)
    beside_cells = 2 * round(settings.overhead_gap_m / grid.cell_m) + 1
    highest_m[_highest_around(ceiling_m, beside_cells) > highest_m + settings.margin_m] = np.nan
    around_m = _median_around(highest_m)
    level = np.abs(highest_m - around_m) < settings.flat_m
    broad = grid.broad(_closed(level), settings.overhead_width_m)
    return grid.level(Surface.GLIMPSED_CEILING, np.where(broad, around_m, np.nan), settings.margin_m)


def map_sloping_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The undersides of roofs and stairs: the highest there is, in one plane that rises, and too broad for furniture."""
    grid, above_m = _heights_above_floor(votes, settings)
    overhead = votes.seen() & (votes.label != Label.FLOOR) & (above_m > settings.slope_bottom_m)
    highest = grid.highest(votes.mean_position[overhead])
    mean, slope, rms_m, known = _planes_around(highest, settings.slope_window_cells)
    steepness = np.linalg.norm(slope, axis=2)
    rising = (steepness > settings.slope_min) & (steepness < settings.slope_max)
    fits = (rms_m < settings.slope_rms_max_m) & (known >= settings.slope_share_min) & np.isfinite(highest[..., 2])
    plane = rising & fits
    sloping = grid.broad(_closed(plane), settings.overhead_width_m) & plane
    away, nearest = _nearest(sloping)
    centre = grid.origin + (np.indices(grid.shape)[::-1].transpose(1, 2, 0) + 0.5) * grid.cell_m
    mean, slope = mean[nearest], slope[nearest]
    height_m = mean[..., 2] + ((centre - mean[..., :2]) * slope).sum(axis=2)
    height_m[away * grid.cell_m > settings.slope_reach_m] = np.nan
    within_cell_m = 0.5 * grid.cell_m * np.abs(slope).sum(axis=2)
    return grid.level(Surface.SLOPING_CEILING, height_m, within_cell_m + settings.margin_m)


def _planes_around(places: FloatArray, size: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The plane through the places within a window of `size` by `size` cells around each cell.

    places: (rows, columns, 3), NaN where a cell has none. Returns the mean (rows, columns, 3), the slope along x and y (rows,
    columns, 2), the RMS distance from the plane (rows, columns; metres), and the share of cells that have a place.
    """
    there = np.isfinite(places[..., 0])
    known = ndimage.uniform_filter(there.astype(np.float64), size, mode="constant")
    middle = np.nanmean(places, axis=(0, 1)) if there.any() else np.zeros(3)
    shifted = np.where(there[..., None], places - middle, 0.0)

    def mean_of(values: FloatArray) -> FloatArray:
        return np.asarray(ndimage.uniform_filter(values, size, mode="constant") / known)

    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([mean_of(shifted[..., i]) for i in range(3)], axis=2)
        xx, xy, xz, yy, yz, zz = (
            mean_of(shifted[..., i] * shifted[..., j]) - mean[..., i] * mean[..., j]
            for i in range(3)
            for j in range(i, 3)
        )
        determinant = xx * yy - xy**2
        slope = np.stack([xz * yy - yz * xy, yz * xx - xz * xy], axis=2) / determinant[..., None]
        # Places that spread over less than 3 cm in some direction lie on a line.
        slope[~(determinant > 0.03**4)] = np.nan
    rms_m = np.sqrt(np.maximum(zz - slope[..., 0] * xz - slope[..., 1] * yz, 0.0))
    return mean + middle, slope, rms_m, known


def map_ducts(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Narrow surfaces below a ceiling: a duct's underside, at the height of another room's ceiling.

    A scan that sees both rooms cannot tell the one from the other.
    """
    ceiling = votes.mean_position[(votes.label == Label.CEILING) & votes.seen()]
    grid = _Grid.around(ceiling, settings.cell_m, settings.ceiling_reach_m)
    lowest_m, usual_m = grid.heights(ceiling, 0.0), grid.heights(ceiling)
    beside_cells = 2 * round(settings.duct_beside_m / grid.cell_m) + 1
    hangs = lowest_m < _highest_around(usual_m, beside_cells) - settings.duct_drop_m
    steep = _range_around(lowest_m, 3) > 2.0 * settings.flat_m
    broad = grid.broad(_closed(np.isfinite(lowest_m) & ~steep) & ~steep, settings.overhead_width_m)
    # The edge of a ceiling, along a wall behind which another ceiling begins, is steep.
    away, nearest = _nearest(broad)
    off_m = np.abs(lowest_m - lowest_m[nearest])
    ceilings = (away <= round(settings.ceiling_edge_m / grid.cell_m)) & (off_m < settings.margin_m)
    return grid.level(Surface.DUCT, np.where(hangs & ~ceilings, lowest_m, np.nan), settings.margin_m)


def map_ceiling_risers(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The upright sides between a ceiling and a higher one, both broad, that meet: of coffers, steps and rooflights.

    votes: without ducts, with the ceilings that no scan found.
    """
    ceiling = votes.mean_position[(votes.label == Label.CEILING) & votes.seen()]
    low_m, high_m, grid = _where_they_meet(ceiling, settings.overhead_width_m, settings.riser_max_m, settings)
    return HeightMap(Surface.CEILING_RISER, grid.origin, grid.cell_m, low_m, high_m)


# --- floors ---


def map_false_floors(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """What scans took for floor on walls and cupboards: narrow strips, far above the floor.

    A scan extends the plane of its floor as far as it sees; from a ramp that leads up the walls of the next room.
    """
    floor = votes.mean_position[(votes.label == Label.FLOOR) & votes.seen()]
    grid = _Grid.around(floor, settings.cell_m, settings.ceiling_reach_m)
    height_m = grid.heights(floor)
    known = np.isfinite(height_m)
    broad = grid.broad(_closed(known), settings.seen_floor_width_m) & known
    _, nearest = _nearest(broad)
    low_m = np.where(broad, height_m, np.nan)[nearest] + settings.false_floor_min_m
    return HeightMap(Surface.FALSE_FLOOR, grid.origin, grid.cell_m, low_m, np.full(grid.shape, np.inf))


def map_raised_floors(votes: VoxelVotes, settings: LevelsSettings, cell_m: float) -> HeightMap:
    """Steps and platforms: level, somewhat above the floor around them, and too broad for furniture (paper, V: uneven floors).

    The lowest return of each cell decides: beneath and beside furniture the floor shows. Larger cells need fewer returns.
    """
    between_m = settings.raised_min_m, settings.raised_max_m
    return _map_floors(votes, settings, Surface.RAISED_FLOOR, cell_m, between_m, settings.raised_width_m)


def map_floors_beyond(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Where the floor goes on level though no scan found it: seen from afar, through a doorway, or from a ramp."""
    cell_m, level_m, width_m = settings.beyond_cell_m, settings.beyond_level_m, settings.beyond_width_m
    return _map_floors(votes, settings, Surface.FLOOR_BEYOND, cell_m, (-level_m, level_m), width_m)


def _map_floors(
    votes: VoxelVotes,
    settings: LevelsSettings,
    surface: Surface,
    cell_m: float,
    between_m: tuple[float, float],
    width_m: float,
) -> HeightMap:
    """The lowest returns of cells without floor, where they are level, broad, and between two heights above the nearest floor."""
    label, position = votes.label, votes.mean_position
    floor = votes.seen(settings.votes_min) & (label == Label.FLOOR)
    low = votes.seen() & ((label == Label.FLOOR) | (label == Label.CLUTTER))
    grid = _Grid.around(position[low], cell_m, settings.ceiling_reach_m)
    ground_m, away = grid.ground_m(position[floor])
    low &= grid.above_m(position, ground_m) > min(between_m[0], -settings.margin_m)
    lowest_m = grid.heights(position[low], 0.0)
    above_m, around_m = lowest_m - ground_m, _median_around(lowest_m)
    level = (np.abs(lowest_m - around_m) < settings.flat_m) & (above_m > between_m[0]) & (above_m < between_m[1])
    level &= away > 0
    # What is seen at a slant shows in lines.
    between_lines = _closed(level, 5) & np.isnan(lowest_m)
    broad = grid.broad(_closed(level) | between_lines, width_m)
    return grid.level(surface, np.where(broad, around_m, np.nan), settings.margin_m)


def map_step_fronts(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The fronts of steps: between a floor and a higher one, both broad, where the one ends at the other.

    votes: with the raised floors.
    """
    floor = votes.mean_position[(votes.label == Label.FLOOR) & votes.seen()]
    low_m, high_m, grid = _where_they_meet(floor, settings.raised_width_m, settings.step_max_m, settings)
    return HeightMap(Surface.STEP_FRONT, grid.origin, grid.cell_m, low_m, high_m + settings.margin_m)


def _where_they_meet(
    position: FloatArray, width_m: float, rise_max_m: float, settings: LevelsSettings
) -> tuple[FloatArray, FloatArray, _Grid]:
    """The heights of the lower and the higher of two level surfaces in the cells (rows, columns) where one ends at the other.

    position: (n, 3) of both. width_m: the least diameter of either.
    """
    grid = _Grid.around(position, settings.cell_m, settings.ceiling_reach_m)
    height_m = grid.heights(position)
    steep = _range_around(height_m, 3) > settings.step_min_m
    level = _closed(np.isfinite(height_m) & ~steep) & ~steep
    broad_m = np.where(grid.broad(level, width_m), height_m, np.nan)
    high_m = _highest_around(broad_m, settings.step_window_cells)
    low_m = -_highest_around(-broad_m, settings.step_window_cells)
    meet = (high_m - low_m > settings.step_min_m) & (high_m - low_m < rise_max_m)
    return np.where(meet, low_m, np.nan), np.where(meet, high_m, np.nan), grid


def map_storey_below(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """What lies lower than the floor of this storey: walls of the one below, seen down a stairwell.

    votes: with the raised floors.
    """
    label, position = votes.label, votes.mean_position
    wall = position[label == Label.WALL]
    grid = _Grid.around(position, settings.ceiling_cell_m, settings.ceiling_reach_m)
    ground_m, _ = grid.ground_m(position[votes.seen(settings.votes_min) & (label == Label.FLOOR)])
    highest_m = ground_m - settings.below_floor_m
    lowest_m = grid.heights(wall[grid.above_m(wall, highest_m) < 0.0], 0.0) - settings.margin_m
    return HeightMap(
        Surface.STOREY_BELOW, grid.origin, grid.cell_m, lowest_m, np.where(np.isfinite(lowest_m), highest_m, np.nan)
    )
