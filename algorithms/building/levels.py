"""The level surfaces of the whole building, for what single scans saw too little of, or took for something else.

Ceilings, floors that lie higher than where the robot stood, ducts that passed for ceilings, and what passed for floor.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import reduce

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.building.votes import VoxelVotes, majority

_FINE_CELL_M, _VOTES_MIN = 0.1, 3
"""Most surfaces are looked for in cells so large. What so many votes agree on is known."""
_MARGIN_M = 0.04
"""Poses drift, and returns scatter, by so much."""
_FLAT_M = 0.03
"""What is level differs by no more from the cells around it."""

_SEEN_FLOOR_M, _OFF_FLOOR_M = 0.3, 0.2
"""Floor holds a disc so broad here and there. What lies so far above the nearest that does is none."""

_CEILING_CELL_M, _REACH_M = 0.25, 1.5
"""A ceiling goes on level so far beyond what was seen of it."""
_TILE_M, _TILE_CUBES = 10.0, 5
"""Edge in metres of a square of the ground, and the minimum number of cubes in it or beside it: fewer are single errors."""
_OVERHEAD_M, _BROAD_OVERHEAD_M, _UNKNOWN_M = 2.2, 0.8, 0.3
"""What hangs so high and holds a disc so broad, with nothing seen above it, is a ceiling: ducts and lamps are narrow."""

_SLOPE, _SLOPING_OVER_M = (0.15, 1.8), 1.0
"""A sloping ceiling rises by so much over each metre. At its lowest it is so high; nothing so broad stands higher."""
_WINDOW, _WINDOW_SHARE, _PLANE_M = 5, 0.6, 0.025
"""Of so many by so many cells such a share must hold returns, and these lie so close to one plane (RMS)."""
_SPREAD_MIN_M = 0.03
"""What spreads over less in some direction lies in no plane."""
_SLOPE_EDGE_M = 0.25
"""A sloping ceiling goes on as a plane so far beyond where windows fit: up to its walls."""

_RISE_M, _BROAD_M = (0.06, 0.30), 1.2
"""Steps and platforms are so much higher than the floor beside them. They hold a disc so broad: no furniture does so low."""
_FLOOR_CELLS_M = (0.1, 0.2)
"""A raised floor is looked for in cells so large: from afar rays meet it at a slant, and far apart."""
_BEYOND_CELL_M, _LEVEL_M, _BROAD_BEYOND_M = 0.3, 0.05, 0.9
"""Floor that goes on beyond what scans told is looked for in cells so large, so close to its height, and so broad."""
_STEP_M, _STEP_CELLS = (0.08, 0.32), 5
"""Where floors within so many cells differ by so much in height, one ends at the other in a step."""

_HANGS_M, _BESIDE_DUCT_M, _CEILING_EDGE_M = 0.08, 0.4, 0.3
"""A duct hangs so much lower than the ceiling that is seen so close to it. A ceiling's edge is so wide."""


class Surface(StrEnum):
    """What a height map is of."""

    FALSE_FLOOR = "false_floor"
    CEILING = "ceiling"
    GLIMPSED_CEILING = "glimpsed_ceiling"
    SLOPING_CEILING = "sloping_ceiling"
    RAISED_FLOOR = "raised_floor"
    FLOOR_BEYOND = "floor_beyond"
    STEP_FRONT = "step_front"
    DUCT = "duct"

    @property
    def label(self) -> Label:
        """What lies there."""
        return _LABELS[self][0]

    @property
    def taken_for(self) -> Label:
        """What scans took it for."""
        return _LABELS[self][1]


_LABELS = {
    Surface.FALSE_FLOOR: (Label.CLUTTER, Label.FLOOR),
    Surface.CEILING: (Label.CEILING, Label.CLUTTER),
    Surface.GLIMPSED_CEILING: (Label.CEILING, Label.CLUTTER),
    Surface.SLOPING_CEILING: (Label.CEILING, Label.CLUTTER),
    Surface.RAISED_FLOOR: (Label.FLOOR, Label.CLUTTER),
    Surface.FLOOR_BEYOND: (Label.FLOOR, Label.CLUTTER),
    Surface.STEP_FRONT: (Label.FLOOR, Label.CLUTTER),
    Surface.DUCT: (Label.CLUTTER, Label.CEILING),
}


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

    @classmethod
    def level(cls, surface: Surface, origin: FloatArray, cell_m: float, height_m: FloatArray) -> "HeightMap":
        """Of what lies level, so high (rows, columns) in the map frame."""
        return cls(surface, origin, cell_m, height_m - _MARGIN_M, height_m + _MARGIN_M)

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
        """The labels (n,) of points (n, 3), what scans took for something else at these heights made what lies there."""
        wrong = np.flatnonzero(label == self.surface.taken_for)
        rows, columns = self.low_m.shape
        cell = np.floor((points_map[wrong, :2] - self.origin) / self.cell_m).astype(np.int64)
        inside = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
        wrong, cell = wrong[inside], cell[inside]
        of_cell, height_m = (cell[:, 1], cell[:, 0]), points_map[wrong, 2]
        on_it = (height_m > self.low_m[of_cell]) & (height_m < self.high_m[of_cell])
        corrected = label.copy()
        corrected[wrong[on_it]] = self.surface.label
        return corrected


def corrected(levels: Iterable[HeightMap], points_map: FloatArray, label: UInt8Array) -> UInt8Array:
    """The labels (n,) of points (n, 3) when each level surface was asked, one after the other."""
    return reduce(lambda told, level: level.label_of(points_map, told), levels, label)


def map_levels(votes: VoxelVotes) -> tuple[HeightMap, ...]:
    """All that is known of the building's level surfaces, to be asked in this order; votes: of the labels that scans gave."""
    false_floors = map_false_floors(votes)
    told = _corrected_votes(votes, false_floors)
    ceilings = (map_ceilings(told), map_glimpsed_ceilings(told), map_sloping_ceilings(told))
    raised_floors = tuple(map_raised_floors(told, cell_m) for cell_m in _FLOOR_CELLS_M)
    with_raised = reduce(_corrected_votes, raised_floors, told)
    floors = (*raised_floors, map_floors_beyond(with_raised), map_step_fronts(with_raised))
    levels = (false_floors, *ceilings, *floors, map_ducts(told))
    return tuple(level for level in levels if level.known.any())


def map_false_floors(votes: VoxelVotes) -> HeightMap:
    """What scans took for floor on walls and cupboards: strips as narrow as these are thick, far above the floor.

    A scan carries the plane of its floor on as far as it sees; from a ramp that leads up the walls of the next room.
    """
    floor = votes.mean_position[(majority(votes.counts) == Label.FLOOR) & votes.seen()]
    if not len(floor):
        return _nothing(Surface.FALSE_FLOOR)
    origin, shape = _frame(floor, _FINE_CELL_M)
    height_m = _in_cells(floor, origin, shape, _FINE_CELL_M, share=0.5)
    known = np.isfinite(height_m)
    broad = _holding_a_disc(ndimage.binary_closing(known, np.ones((3, 3))), 0.5 * _SEEN_FLOOR_M / _FINE_CELL_M) & known
    if not broad.any():
        return _nothing(Surface.FALSE_FLOOR)
    nearest = ndimage.distance_transform_edt(~broad, return_distances=False, return_indices=True)
    low_m = height_m[tuple(nearest)] + _OFF_FLOOR_M
    return HeightMap(Surface.FALSE_FLOOR, origin, _FINE_CELL_M, low_m, np.full(shape, np.inf))


def _corrected_votes(votes: VoxelVotes, level: HeightMap) -> VoxelVotes:
    """The votes, where scans took something else for what lies there given to that."""
    label = majority(votes.counts)
    wrong = level.label_of(votes.mean_position, label) != label
    counts = votes.counts.copy()
    counts[wrong, level.surface.label] += counts[wrong, level.surface.taken_for]
    counts[wrong, level.surface.taken_for] = 0
    return replace(votes, counts=counts)


def map_ceilings(votes: VoxelVotes) -> HeightMap:
    """The ceilings that all scans found: in each cell the median height of its cubes, and around them the nearest's."""
    is_ceiling = (majority(votes.counts) == Label.CEILING) & votes.seen(_VOTES_MIN)
    position = votes.mean_position[is_ceiling]
    if not len(position):
        return _nothing(Surface.CEILING)
    origin, shape = _frame(position, _CEILING_CELL_M)
    median_m = _in_cells(position, origin, shape, _CEILING_CELL_M, share=0.5)
    away, nearest = ndimage.distance_transform_edt(np.isnan(median_m), return_indices=True)
    height_m = np.where(away * _CEILING_CELL_M <= _REACH_M, median_m[tuple(nearest)], np.nan)
    return HeightMap.level(Surface.CEILING, origin, _CEILING_CELL_M, height_m)


def map_glimpsed_ceilings(votes: VoxelVotes) -> HeightMap:
    """Ceilings that no scan told, of rooms seen through a doorway: the highest there is, level, and too broad for a duct.

    A scan knows the ceiling above it; what is higher or lower is clutter to it.
    """
    label = majority(votes.counts)
    position = votes.mean_position
    seen = votes.seen(_VOTES_MIN)
    floor, known = (seen & (label == surface) for surface in (Label.FLOOR, Label.CEILING))
    if not floor.any():
        return _nothing(Surface.GLIMPSED_CEILING)
    origin, shape = _frame(position, _FINE_CELL_M)
    ground_m, _ = _ground_m(position[floor], origin, shape, _FINE_CELL_M)
    rise_m = _above_m(position, ground_m, origin, _FINE_CELL_M)
    high = (label == Label.CLUTTER) & (rise_m > _OVERHEAD_M)
    highest_m = _in_cells(position[high], origin, shape, _FINE_CELL_M, share=1.0)
    away = ndimage.distance_transform_edt(np.isnan(_in_cells(position[known], origin, shape, _FINE_CELL_M, share=0.5)))
    highest_m[away * _FINE_CELL_M < _UNKNOWN_M] = np.nan
    around = _median_around(highest_m)
    level = np.abs(highest_m - around) < _FLAT_M
    broad = _holding_a_disc(ndimage.binary_closing(level, np.ones((3, 3))), 0.5 * _BROAD_OVERHEAD_M / _FINE_CELL_M)
    return HeightMap.level(Surface.GLIMPSED_CEILING, origin, _FINE_CELL_M, np.where(broad, around, np.nan))


def map_sloping_ceilings(votes: VoxelVotes) -> HeightMap:
    """The undersides of roofs and stairs: the highest there is, in one plane that rises, and too broad for furniture."""
    label = majority(votes.counts)
    position = votes.mean_position
    floor = votes.seen(_VOTES_MIN) & (label == Label.FLOOR)
    if not floor.any():
        return _nothing(Surface.SLOPING_CEILING)
    origin, shape = _frame(position, _FINE_CELL_M)
    ground_m, _ = _ground_m(position[floor], origin, shape, _FINE_CELL_M)
    rise_m = _above_m(position, ground_m, origin, _FINE_CELL_M)
    overhead = votes.seen() & (label != Label.FLOOR) & (rise_m > _SLOPING_OVER_M)
    highest = _highest_in_cells(position[overhead], origin, shape, _FINE_CELL_M)
    mean, slope, rms_m, known = _planes_around(highest, _WINDOW)
    steepness = np.linalg.norm(slope, axis=2)
    rising = (steepness > _SLOPE[0]) & (steepness < _SLOPE[1])
    plane = rising & (rms_m < _PLANE_M) & (known >= _WINDOW_SHARE) & np.isfinite(highest[..., 2])
    broad = _holding_a_disc(ndimage.binary_closing(plane, np.ones((3, 3))), 0.5 * _BROAD_OVERHEAD_M / _FINE_CELL_M)
    told = broad & plane
    if not told.any():
        return _nothing(Surface.SLOPING_CEILING)
    away, nearest = ndimage.distance_transform_edt(~told, return_indices=True)
    centre = origin + (np.indices(shape)[::-1].transpose(1, 2, 0) + 0.5) * _FINE_CELL_M
    mean, slope = mean[tuple(nearest)], slope[tuple(nearest)]
    height_m = mean[..., 2] + ((centre - mean[..., :2]) * slope).sum(axis=2)
    height_m[away * _FINE_CELL_M > _SLOPE_EDGE_M] = np.nan
    within_cell_m = 0.5 * _FINE_CELL_M * np.abs(slope).sum(axis=2) + _MARGIN_M
    return HeightMap(Surface.SLOPING_CEILING, origin, _FINE_CELL_M, height_m - within_cell_m, height_m + within_cell_m)


def _highest_in_cells(position: FloatArray, origin: FloatArray, shape: tuple[int, int], cell_m: float) -> FloatArray:
    """(rows, columns, 3) the highest position of each cell, NaN where there is none; position: (n, 3)."""
    position = _inside(position, origin, shape, cell_m)
    cell = _cells(position, origin, shape, cell_m)
    order = np.argsort(position[:, 2], kind="stable")
    highest = np.full((*shape, 3), np.nan)
    highest[tuple(cell[order].T)] = position[order]
    return highest


def _planes_around(places: FloatArray, size: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The plane through what lies in so many by so many cells around each.

    places: (rows, columns, 3), NaN where a cell has none. Returns its middle (rows, columns, 3), its slope along x and y
    (rows, columns, 2), how far the places lie off it (rows, columns; RMS, metres), and the share of cells that have one.
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
        slope[~(determinant > _SPREAD_MIN_M**4)] = np.nan
    rms_m = np.sqrt(np.maximum(zz - slope[..., 0] * xz - slope[..., 1] * yz, 0.0))
    return mean + middle, slope, rms_m, known


def map_raised_floors(votes: VoxelVotes, cell_m: float = _FINE_CELL_M) -> HeightMap:
    """What lies a step above the floor around it, level and too broad for furniture (paper, V: uneven floors).

    A scan knows the floor that it stands on; what is higher is clutter to it. Here the lowest that was seen in each cell
    tells: furniture stands on something that shows between its legs and beside it.

    cell_m: the larger, the fewer returns tell.
    """
    return _map_floors(votes, Surface.RAISED_FLOOR, cell_m, _RISE_M, _BROAD_M)


def map_floors_beyond(votes: VoxelVotes) -> HeightMap:
    """Where the floor goes on level, though no scan told: seen from afar, through a doorway, or from a ramp's slope."""
    return _map_floors(votes, Surface.FLOOR_BEYOND, _BEYOND_CELL_M, (-_LEVEL_M, _LEVEL_M), _BROAD_BEYOND_M)


def _map_floors(
    votes: VoxelVotes, surface: Surface, cell_m: float, between_m: tuple[float, float], broad_m: float
) -> HeightMap:
    """The lowest that was seen in each cell without floor, where it is level and so broad, so high above the nearest floor."""
    label = majority(votes.counts)
    position = votes.mean_position
    floor = votes.seen(_VOTES_MIN) & (label == Label.FLOOR)
    low = votes.seen() & ((label == Label.FLOOR) | (label == Label.CLUTTER))
    if not floor.any():
        return _nothing(surface)
    origin, shape = _frame(position[low], cell_m)
    ground_m, away = _ground_m(position[floor], origin, shape, cell_m)
    rise_m = _above_m(position, ground_m, origin, cell_m)
    lowest_m = _in_cells(position[low & (rise_m > min(between_m[0], -_MARGIN_M))], origin, shape, cell_m, share=0.0)
    rise_m = lowest_m - ground_m
    around = _median_around(lowest_m)
    level = (np.abs(lowest_m - around) < _FLAT_M) & (rise_m > between_m[0]) & (rise_m < between_m[1]) & (away > 0)
    # What is seen at a slant shows in lines.
    between = ndimage.binary_closing(level, np.ones((5, 5))) & np.isnan(lowest_m)
    closed = ndimage.binary_closing(level, np.ones((3, 3))) | between
    broad = _holding_a_disc(closed, 0.5 * broad_m / cell_m)
    return HeightMap.level(surface, origin, cell_m, np.where(broad, around, np.nan))


def map_step_fronts(votes: VoxelVotes) -> HeightMap:
    """The fronts of steps: what stands between a floor and a higher one, both broad, where the one ends at the other.

    votes: with the raised floors.
    """
    floor = votes.mean_position[(majority(votes.counts) == Label.FLOOR) & votes.seen()]
    if not len(floor):
        return _nothing(Surface.STEP_FRONT)
    origin, shape = _frame(floor, _FINE_CELL_M)
    floor_m = _in_cells(floor, origin, shape, _FINE_CELL_M, share=0.5)
    steep = _highest(floor_m, 3) + _highest(-floor_m, 3) > _STEP_M[0]
    level = ndimage.binary_closing(np.isfinite(floor_m) & ~steep, np.ones((3, 3))) & ~steep
    broad_m = np.where(_holding_a_disc(level, 0.5 * _BROAD_M / _FINE_CELL_M), floor_m, np.nan)
    high_m, low_m = _highest(broad_m, _STEP_CELLS), -_highest(-broad_m, _STEP_CELLS)
    step = (high_m - low_m > _STEP_M[0]) & (high_m - low_m < _STEP_M[1])
    between = np.where(step, 0.0, np.nan)
    return HeightMap(Surface.STEP_FRONT, origin, _FINE_CELL_M, low_m + between, high_m + between + _MARGIN_M)


def map_ducts(votes: VoxelVotes) -> HeightMap:
    """What hangs below a ceiling and is narrow: a duct's underside, at the height of another room's ceiling.

    A scan that sees both rooms cannot tell the one from the other.
    """
    ceiling = votes.mean_position[(majority(votes.counts) == Label.CEILING) & votes.seen()]
    if not len(ceiling):
        return _nothing(Surface.DUCT)
    origin, shape = _frame(ceiling, _FINE_CELL_M)
    lowest_m = _in_cells(ceiling, origin, shape, _FINE_CELL_M, share=0.0)
    usual_m = _in_cells(ceiling, origin, shape, _FINE_CELL_M, share=0.5)
    beside = 2 * round(_BESIDE_DUCT_M / _FINE_CELL_M) + 1
    hangs = lowest_m < _highest(usual_m, beside) - _HANGS_M
    steep = _highest(lowest_m, 3) + _highest(-lowest_m, 3) > 2.0 * _FLAT_M
    closed = ndimage.binary_closing(np.isfinite(lowest_m) & ~steep, np.ones((3, 3))) & ~steep
    broad = _holding_a_disc(closed, 0.5 * _BROAD_OVERHEAD_M / _FINE_CELL_M)
    # Its edge, along a wall behind which another ceiling begins, is steep.
    away, nearest = ndimage.distance_transform_edt(~broad, return_indices=True)
    level_m = np.abs(lowest_m - lowest_m[tuple(nearest)])
    ceilings = (away <= round(_CEILING_EDGE_M / _FINE_CELL_M)) & (level_m < _MARGIN_M)
    return HeightMap.level(Surface.DUCT, origin, _FINE_CELL_M, np.where(hangs & ~ceilings, lowest_m, np.nan))


def _highest(height_m: FloatArray, size: int) -> FloatArray:
    """The highest known of the so many by so many cells around each; minus infinity where none is known."""
    return np.asarray(ndimage.maximum_filter(np.where(np.isnan(height_m), -np.inf, height_m), size))


def _ground_m(
    floor: FloatArray, origin: FloatArray, shape: tuple[int, int], cell_m: float
) -> tuple[FloatArray, FloatArray]:
    """The median height of the floor in each cell, or in the nearest that has one, and how many cells away that is.

    floor: (m, 3) places on it, one at least. origin, shape, cell_m: of the grid.
    """
    floor_m = _in_cells(floor, origin, shape, cell_m, share=0.5)
    away, nearest = ndimage.distance_transform_edt(np.isnan(floor_m), return_indices=True)
    return floor_m[tuple(nearest)], away


def _above_m(position: FloatArray, ground_m: FloatArray, origin: FloatArray, cell_m: float) -> FloatArray:
    """(n,) how high each position (n, 3) lies above the ground (rows, columns) in its cell."""
    return np.asarray(position[:, 2] - ground_m[tuple(_cells(position, origin, ground_m.shape, cell_m).T)])


def _median_around(height_m: FloatArray) -> FloatArray:
    """The median of each cell's and its eight neighbours' heights, NaN where none of them has one."""
    padded = np.pad(height_m, 1, constant_values=np.nan)
    known = ndimage.binary_dilation(~np.isnan(height_m), np.ones((3, 3)))
    # The windows of the few cells that are known: those of all would take nine times the map.
    nine = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))[known].reshape(-1, 9)
    median_m = np.full(height_m.shape, np.nan)
    median_m[known] = np.nanmedian(nine, axis=1)
    return median_m


def _holding_a_disc(mask: BoolArray, radius: float) -> BoolArray:
    """Cells (r, c) of the mask that a disc within it covers, and those next to them; in cells."""
    core = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] >= radius
    if not core.any():
        return np.zeros_like(mask)
    return np.asarray(mask & (ndimage.distance_transform_edt(~core) <= radius + 1.0))


def _nothing(surface: Surface) -> HeightMap:
    return HeightMap.level(surface, np.zeros(2), _FINE_CELL_M, np.zeros((0, 0)))


def _frame(position: FloatArray, cell_m: float) -> tuple[FloatArray, tuple[int, int]]:
    """The origin (2,) and the shape of a grid that holds all positions (n, 3) but for single ones, and what they reach to."""
    corner = position[:, :2].min(axis=0) - _REACH_M
    among = _among_others(position)
    kept = position[among, :2] if among.any() else position[:, :2]
    # What is left out moves no cell's edge.
    origin = corner + np.floor((kept.min(axis=0) - _REACH_M - corner) / cell_m) * cell_m
    columns, rows = np.floor((kept.max(axis=0) + _REACH_M - origin) / cell_m).astype(int) + 1
    return origin, (int(rows), int(columns))


def _among_others(position: FloatArray) -> BoolArray:
    """(n,) which positions (n, 3) have others around them: one return far away would stretch a grid by all that lies between."""
    tile = np.floor(position[:, :2] / _TILE_M).astype(np.int64)
    tile -= tile.min(axis=0)
    counts = np.zeros(tile.max(axis=0) + 1, np.int64)
    np.add.at(counts, tuple(tile.T), 1)
    return np.asarray(ndimage.maximum_filter(counts, 3)[tuple(tile.T)] >= _TILE_CUBES)


def _cells(position: FloatArray, origin: FloatArray, shape: tuple[int, int], cell_m: float) -> FloatArray:
    """Row and column (n, 2) of each position (n, 3), at the edge for what lies outside."""
    cell = np.floor((position[:, 1::-1] - origin[::-1]) / cell_m).astype(np.int64)
    return np.clip(cell, 0, np.array(shape) - 1)


def _inside(position: FloatArray, origin: FloatArray, shape: tuple[int, int], cell_m: float) -> FloatArray:
    """Those of the positions (n, 3) that the grid holds."""
    cell = np.floor((position[:, 1::-1] - origin[::-1]) / cell_m)
    return position[((cell >= 0) & (cell < shape)).all(axis=1)]


def _in_cells(
    position: FloatArray, origin: FloatArray, shape: tuple[int, int], cell_m: float, share: float
) -> FloatArray:
    """In each cell the height that so large a share of its positions (n, 3) lie below; NaN where there are none."""
    position = _inside(position, origin, shape, cell_m)
    cell = _cells(position, origin, shape, cell_m)
    index = cell[:, 0] * shape[1] + cell[:, 1]
    order = np.lexsort((position[:, 2], index))
    own, first, count = np.unique(index[order], return_index=True, return_counts=True)
    height_m = np.full(shape[0] * shape[1], np.nan)
    height_m[own] = position[order, 2][first + np.minimum((share * count).astype(np.int64), count - 1)]
    return height_m.reshape(shape)
