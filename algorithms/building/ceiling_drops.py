"""Beams, coffers, soffits and the sides of steps: what hangs below a ceiling, closes up to it and is held by walls.

What is built leaves no air above it: its sides are seen up to the ceiling. No wall holds a lamp, which is shorter than beams
whose ends are hidden. Ducts and pipes run along a wall and leave a slit, in which it goes on to be seen above their underside.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ffmap.algorithms.base.known import row_medians
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.building.height_map import (
    GroundGrid,
    HeightMap,
    Surface,
    grid_over_all,
    highest_around,
    nearest_known,
    windows_around,
)
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.votes import VoxelVotes


def map_ceiling_drops(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """What is built below a ceiling, from its underside up to the ceiling. votes: with the ceilings that no scan found."""
    hanging = _Hanging.of(votes, settings)
    side, closes = _sides(hanging, votes, settings)
    built = _are_built(hanging, side, closes, votes, settings)
    drops = built[hanging.parts] & hanging.hangs
    low_m = -highest_around(np.where(drops, -hanging.low_m, np.nan), 3) - settings.margin_m
    low_m[~np.isfinite(low_m)] = np.nan
    grid, high_m = hanging.grid, np.where(np.isfinite(low_m), hanging.top_m, np.nan)
    return HeightMap(Surface.CEILING_DROP, grid.origin, grid.cell_m, low_m, high_m)


@dataclass(frozen=True)
class _Hanging:
    """What hangs below the ceiling, in the cells (rows, columns) of a grid; heights in the map frame, NaN where unknown.

    ground_m, ceiling_m: the floor and the ceiling. top_m: the highest ceiling near each cell.
    low_m, high_m: from where to where the topmost below the ceiling is seen. hangs: whether that hangs.
    parts: the number of the level part that a cell belongs to, from 1; 0 where nothing hangs. at_part: likewise, with the cells
    that touch a part. lengths: (parts + 1,) how long each part is, in cells.
    walls: whether a wall is seen below the ceiling.
    """

    grid: GroundGrid
    ground_m: FloatArray
    ceiling_m: FloatArray
    top_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    hangs: BoolArray
    parts: IntArray
    at_part: IntArray
    lengths: IntArray
    walls: BoolArray

    @classmethod
    def of(cls, votes: VoxelVotes, settings: LevelsSettings) -> "_Hanging":
        """By the cubes that are ceiling, wall or clutter."""
        label, position = votes.label, votes.mean_position
        grid, ground_m = grid_over_all(votes, settings.cell_m, settings)
        ceiling_m = grid.heights(position[votes.seen() & (label == Label.CEILING)], 1.0)
        top_m = highest_around(ceiling_m, 2 * round(settings.drop_reach_m / grid.cell_m) + 1)
        below_m = -grid.above_m(position, top_m)
        overhead = votes.seen() & ((label == Label.CEILING) | (label == Label.CLUTTER)) & (below_m > 0.5 * votes.voxel_m)
        low_m, high_m = _topmost(grid, position[overhead], settings.drop_gap_m)
        drop_m = top_m - low_m
        hangs = (drop_m > settings.drop_min_m) & (drop_m < settings.drop_max_m) & (low_m - ground_m > settings.headroom_m)
        parts = _level_parts(hangs, low_m, _level_m(settings))
        wall = (label == Label.WALL) & (below_m > 0.0) & (below_m < settings.drop_max_m)
        away, nearest = nearest_known(hangs)
        at_part = np.where(away <= 1.5, parts[nearest], 0)
        low_m = np.where(at_part > 0, low_m[nearest], low_m)
        walls = np.isfinite(grid.heights(position[wall]))
        return cls(grid, ground_m, ceiling_m, top_m, low_m, high_m, hangs, parts, at_part, _lengths(parts), walls)

    def count(self, cells: BoolArray) -> IntArray:
        """(parts + 1,) how many of some cells each part has, those that touch it too."""
        return np.bincount(self.at_part[cells], minlength=len(self.lengths))


def _level_m(settings: LevelsSettings) -> float:
    """Maximum height difference of cells side by side, each of which may be off by as much."""
    return 2.0 * settings.flat_m


def _sides(hanging: _Hanging, votes: VoxelVotes, settings: LevelsSettings) -> tuple[BoolArray, BoolArray]:
    """The cells in which a side of what hangs is seen, and those in which it closes up to the ceiling; (rows, columns) each.

    Above the head of a door or a window it is the wall that closes up to the ceiling. What is deeper than walls are thick hangs,
    though scans take its side for a wall, which begins where it hangs.
    """
    grid, lengths, hangs, low_m = hanging.grid, hanging.lengths, hanging.hangs, hanging.low_m
    is_deep = np.bincount(hanging.parts[hangs], minlength=len(lengths)) * grid.cell_m > settings.drop_deep_m * lengths
    passed = votes.mean_position[(votes.label == Label.WALL) & votes.seen()]
    from_m, up_to_m = grid.heights(passed, 0.0), grid.heights(passed, 1.0)
    begins = (from_m > low_m - _level_m(settings)) & (from_m - hanging.ground_m > settings.headroom_m)
    hung = (hanging.at_part > 0) & is_deep[hanging.at_part] & begins
    high_m = np.where(hung, np.fmax(hanging.high_m, up_to_m), hanging.high_m)
    side = (hung | (hangs & ~hanging.walls)) & (high_m - low_m > votes.voxel_m)
    beside_cells = 2 * round(settings.drop_edge_m / grid.cell_m) + 1
    edge_m = _ceiling_beside_m(hanging.ceiling_m, side, low_m + settings.drop_min_m, beside_cells)
    # Hangers and brackets are short.
    steps_m = np.where(hangs & (lengths[hanging.parts] >= settings.drop_sides_min), low_m, np.nan)
    reached_m = _up_by_the_next_step_m(steps_m, low_m, high_m, votes.voxel_m)[side]
    closes = np.zeros_like(side)
    closes[side] = np.where(np.isfinite(edge_m), edge_m, hanging.top_m[side]) - reached_m < 2.0 * votes.voxel_m
    return side, closes


def _are_built(
    hanging: _Hanging, side: BoolArray, closes: BoolArray, votes: VoxelVotes, settings: LevelsSettings
) -> BoolArray:
    """(parts + 1,) which parts are built: their sides close up, and walls hold them, or they are longer than lamps.

    What runs along a wall is a duct, unless it spans from wall to wall, and the wall is not seen to go on above its underside.

    side, closes: see `_sides`.
    """
    grid, lengths, hangs, low_m, parts = hanging.grid, hanging.lengths, hanging.hangs, hanging.low_m, hanging.parts
    away, nearest_wall = nearest_known(hanging.walls)
    off_wall_m = away * grid.cell_m
    held = hangs & (off_wall_m < 2.0 * grid.cell_m)
    along_wall = hangs & (off_wall_m < settings.slit_max_m)
    cells, sides, closing, holding, along = map(hanging.count, (hangs, side, closes, held, along_wall))
    closed_up = (sides >= settings.drop_sides_min) & (closing > settings.drop_closed_min * sides)
    built = closed_up & ((holding > 0) | (lengths * grid.cell_m > settings.lamp_max_m))
    at_wall = along > 0.8 * cells
    for part in np.flatnonzero(built & at_wall & (holding > 0)):
        own = np.nonzero(parts == part)
        own_walls = np.column_stack([place[own] for place in nearest_wall])
        at_wall[part] = not _spans(np.column_stack(own), own_walls, held[own])
    built &= ~(at_wall & (holding < lengths))
    wall = votes.mean_position[(votes.label == Label.WALL) & votes.seen(settings.votes_min)]
    # Between coffers, and beyond a soffit's end, the wall goes up to the ceiling.
    away, nearest = nearest_known(hangs | np.isfinite(hanging.ceiling_m))
    behind = np.where(away <= 2.0, parts[nearest], 0)
    for part in np.flatnonzero(built & at_wall):
        built[part] = not _goes_on_above(wall, grid, behind == part, np.median(low_m[parts == part]), votes.voxel_m)
    # The slit between a duct and its wall closes up to the ceiling; the duct hangs beside it.
    lowest_m = ndimage.minimum_filter(np.where(hangs & ~built[parts], low_m, np.inf), 3)
    beside = np.bincount(parts[hangs & (lowest_m < low_m - _level_m(settings))], minlength=len(cells))
    return np.asarray(built & (beside < 0.5 * cells))


def _ceiling_beside_m(ceiling_m: FloatArray, side: BoolArray, above_m: FloatArray, size: int) -> FloatArray:
    """(k,) how high the ceiling is beside each of the cells of a drop's sides, NaN where none is seen: the median of those around.

    A ceiling that rises, or is stepped, is higher farther on than where the side meets it; and so is what a pane mirrors.

    ceiling_m, side, above_m: (rows, columns). above_m: what is no higher than this is the drop itself. size: the windows' edge in
    cells.
    """
    around_m = windows_around(ceiling_m, side, size)
    return row_medians(np.where(around_m > above_m[side, None], around_m, np.nan))


def _up_by_the_next_step_m(steps_m: FloatArray, low_m: FloatArray, high_m: FloatArray, layer_m: float) -> FloatArray:
    """How high (rows, columns) the side of what hangs goes on up, where it ends at the underside of a step in the cell beside it.

    A moulded beam is wider at the ceiling, and the underside of its moulding covers where its side would go on. It leaves no air
    between them, as there is between a duct and the beam that it hangs from.

    steps_m: (rows, columns) the undersides of what may be a step, NaN elsewhere. low_m, high_m: from where to where each cell's
    side is seen. layer_m: edge of the cubes.
    """
    up_m = high_m.copy()
    under, top = (np.pad(values, 1, constant_values=np.nan) for values in (steps_m, high_m))
    rows, columns = low_m.shape
    for down, right in np.ndindex(3, 3):
        beside = slice(down, down + rows), slice(right, right + columns)
        is_next = (under[beside] > low_m + layer_m) & (np.abs(under[beside] - high_m) < layer_m)
        up_m = np.where(is_next, np.fmax(up_m, top[beside]), up_m)
    return up_m


def _spans(cells: IntArray, nearest_wall: IntArray, held: BoolArray) -> bool:
    """Whether a part runs from one wall to another: a beam across a corridor, no duct along a wall.

    Walls hold both its ends and nothing between, and of its cells as many are near the one wall as near the other.

    cells, nearest_wall: (k, 2) row and column of its cells, and of the wall nearest to each. held: (k,) which are at a wall.
    """
    from_middle, from_wall = cells - cells.mean(axis=0), cells - nearest_wall
    place = from_middle @ np.linalg.svd(from_middle, full_matrices=False)[2][0]
    at_low, at_high = held & (place < 0.5 * place.min()), held & (place > 0.5 * place.max())
    both_ends = at_low.any() and at_high.any() and not (held & ~at_low & ~at_high).any()
    one_sided = np.linalg.norm(from_wall.sum(axis=0)) > 0.5 * np.linalg.norm(from_wall, axis=1).sum()
    return bool(both_ends and not one_sided)


def _goes_on_above(wall: FloatArray, grid: GroundGrid, behind: BoolArray, low_m: float, layer_m: float) -> bool:
    """Whether the wall behind a part that hangs along it is seen above the part's underside too, in three of four of its cells.

    Into the slit between a duct and its wall one looks a few centimetres deep.

    wall: (n, 3) cubes of walls. behind: (rows, columns) where the part is what hangs nearest. low_m: how high its underside is.
    layer_m: edge of the cubes, of which those at the underside, and some next to it, hold its own returns.
    """
    rows, columns = grid.cells(wall)
    layer = (wall[:, 2] - low_m) / layer_m
    below, above = np.zeros((2, *grid.shape), bool)
    for seen, within in ((below, (layer > -7.0) & (layer < -2.0)), (above, (layer > 1.4) & (layer < 4.0))):
        seen[rows[within], columns[within]] = True
    below &= behind
    return bool(np.count_nonzero(below & above) > 0.75 * np.count_nonzero(below))


def _topmost(grid: GroundGrid, position: FloatArray, gap_m: float) -> tuple[FloatArray, FloatArray]:
    """The lowest and the highest position (rows, columns) of what is topmost in each cell, down to a gap; NaN where nothing is.

    position: (n, 3), within the grid.
    """
    cell = np.ravel_multi_index(grid.cells(position), grid.shape)
    order = np.lexsort((-position[:, 2], cell))
    cell, height_m = cell[order], position[order, 2]
    first = np.diff(cell, prepend=-1) != 0
    piece = np.cumsum(first | (-np.diff(height_m, prepend=np.inf) > gap_m))
    starts = np.flatnonzero(first)
    top = piece == np.repeat(piece[starts], np.diff(starts, append=len(cell)))
    low_m, high_m = np.full(grid.shape, np.nan), np.full(grid.shape, np.nan)
    np.fmin.at(low_m.reshape(-1), cell[top], height_m[top])
    high_m.flat[cell[starts]] = height_m[starts]
    return low_m, high_m


def _level_parts(mask: BoolArray, height_m: FloatArray, flat_m: float) -> IntArray:
    """(rows, columns) numbers of the parts of a mask, from 1, whose cells join at like heights; 0 beside it."""
    number = np.arange(mask.size).reshape(mask.shape)
    rows, columns = mask.shape
    one, other = [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = slice(0, rows - down), slice(max(0, -right), columns - max(0, right))
        there = slice(down, rows), slice(max(0, right), columns - max(0, -right))
        joins = mask[here] & mask[there] & (np.abs(height_m[here] - height_m[there]) < flat_m)
        one.append(number[here][joins])
        other.append(number[there][joins])
    edges = np.concatenate(one), np.concatenate(other)
    _, part = connected_components(
        coo_array((np.ones(len(edges[0]), bool), edges), shape=(mask.size,) * 2), directed=False
    )
    parts: IntArray = np.zeros(mask.shape, np.int64)
    parts[mask] = np.unique(part[mask.reshape(-1)], return_inverse=True)[1] + 1
    return parts


def _lengths(parts: IntArray) -> IntArray:
    """(k,) the longer side, in cells, of the box about each part; 0 of number 0."""
    boxes = ndimage.find_objects(parts)
    return np.array([0, *(max(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in boxes)])
