"""Ceilings that single scans missed or cut up: of other rooms, sloping ones, with beams; and ducts that passed for ceilings."""

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
    closed,
    grid_over_all,
    highest_around,
    median_around,
    nearest_known,
    range_around,
    windows_around,
)
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.votes import VoxelVotes


def map_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The ceilings that scans found: in each cell the median height of its cubes, around them the nearest cell's."""
    position = votes.mean_position[(votes.label == Label.CEILING) & votes.seen(settings.votes_min)]
    grid = GroundGrid.around(position, settings.ceiling_cell_m, settings.ceiling_reach_m)
    median_m = grid.heights(position)
    away, nearest = nearest_known(np.isfinite(median_m))
    height_m = np.where(away * grid.cell_m <= settings.ceiling_reach_m, median_m[nearest], np.nan)
    return grid.level(Surface.CEILING, height_m, settings.margin_m)


def _over_all(votes: VoxelVotes, settings: LevelsSettings) -> tuple[GroundGrid, FloatArray]:
    """`grid_over_all` in the cells of what hangs or slopes."""
    return grid_over_all(votes, settings.votes_min, settings.cell_m, settings.ceiling_reach_m)


def map_glimpsed_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Ceilings that no scan found, of rooms seen through a doorway: the highest there is, level, and too broad for a duct.

    A scan finds the ceiling above it; to it, what is higher or lower is clutter. Where its plane meets the walls of a room with
    a higher ceiling, it leaves a line of ceiling on them: only a ceiling that is higher shows that something hangs below it.
    """
    grid, ground_m = _over_all(votes, settings)
    label, position = votes.label, votes.mean_position
    above_m = grid.above_m(position, ground_m)
    highest_m = grid.heights(position[(label == Label.CLUTTER) & (above_m > settings.overhead_min_m)], 1.0)
    ceiling_m = grid.heights(position[votes.seen(settings.votes_min) & (label == Label.CEILING)], 1.0)
    beside_cells = 2 * round(settings.overhead_gap_m / grid.cell_m) + 1
    highest_m[highest_around(ceiling_m, beside_cells) > highest_m + settings.margin_m] = np.nan
    around_m = median_around(highest_m)
    level = np.abs(highest_m - around_m) < settings.flat_m
    broad = grid.broad(closed(level), settings.overhead_width_m)
    return grid.level(Surface.GLIMPSED_CEILING, np.where(broad, around_m, np.nan), settings.margin_m)


def map_sloping_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The undersides of roofs and stairs: the highest there is, in one plane that rises, and too broad for furniture."""
    grid, ground_m = _over_all(votes, settings)
    above_m = grid.above_m(votes.mean_position, ground_m)
    overhead = votes.seen() & (votes.label != Label.FLOOR) & (above_m > settings.slope_bottom_m)
    highest = grid.highest(votes.mean_position[overhead])
    mean, slope, rms_m, known = _planes_around(highest, settings.window_cells)
    steepness = np.linalg.norm(slope, axis=2)
    rising = (steepness > settings.slope_min) & (steepness < settings.slope_max)
    fits = (rms_m < settings.slope_rms_max_m) & (known >= settings.slope_share_min) & np.isfinite(highest[..., 2])
    plane = rising & fits
    sloping = grid.broad(closed(plane), settings.overhead_width_m) & plane
    away, nearest = nearest_known(sloping)
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


def of_rooms(ceiling: FloatArray, settings: LevelsSettings) -> BoolArray:
    """(n,) which cubes of ceiling (n, 3) are the ceiling of a room: not narrow, and lower than the ceiling beside.

    That is the underside of a duct or of a board over a wardrobe, at the height of another room's ceiling. A scan that sees both
    rooms cannot tell the one from the other; but what ends there is no wall.
    """
    grid = GroundGrid.around(ceiling, settings.cell_m, settings.ceiling_reach_m)
    lowest_m, usual_m = grid.heights(ceiling, 0.0), grid.heights(ceiling)
    beside_cells = 2 * round(settings.duct_beside_m / grid.cell_m) + 1
    hangs = lowest_m < highest_around(usual_m, beside_cells) - settings.drop_min_m
    steep = range_around(lowest_m, 3) > 2.0 * settings.flat_m
    broad = grid.broad(closed(np.isfinite(lowest_m) & ~steep) & ~steep, settings.overhead_width_m)
    # The edge of a ceiling, along a wall behind which another ceiling begins, is steep.
    away, nearest = nearest_known(broad)
    off_m = np.abs(lowest_m - lowest_m[nearest])
    is_edge = (away <= round(settings.ceiling_edge_m / grid.cell_m)) & (off_m < settings.margin_m)
    narrow_m = np.where(hangs & ~is_edge, lowest_m, np.nan)[grid.cells(ceiling)]
    return ~(np.abs(ceiling[:, 2] - narrow_m) < settings.margin_m)


def map_ceiling_drops(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Beams, coffers, soffits and the sides of steps: what hangs below a ceiling, closes up to it and is held by walls.

    What is built leaves no air above it: its sides are seen up to the ceiling. No wall holds a lamp, which is shorter than beams
    whose ends are hidden. Ducts and pipes run along a wall and leave a slit, in which it goes on to be seen above their underside.

    votes: with the ceilings that no scan found.
    """
    label, position = votes.label, votes.mean_position
    grid, ground_m = _over_all(votes, settings)
    ceiling_m = grid.heights(position[votes.seen() & (label == Label.CEILING)], 1.0)
    top_m = highest_around(ceiling_m, 2 * round(settings.drop_reach_m / grid.cell_m) + 1)
    below_m = -grid.above_m(position, top_m)
    overhead = votes.seen() & ((label == Label.CEILING) | (label == Label.CLUTTER)) & (below_m > 0.5 * votes.voxel_m)
    low_m, high_m = _topmost(grid, position[overhead], settings.drop_gap_m)
    drop_m = top_m - low_m
    hangs = (drop_m > settings.drop_min_m) & (drop_m < settings.drop_max_m) & (low_m - ground_m > settings.headroom_m)
    # Two cells side by side may each be off by as much.
    level_m = 2.0 * settings.flat_m
    parts = _level_parts(hangs, low_m, level_m)
    walls = np.isfinite(
        grid.heights(position[(label == Label.WALL) & (below_m > 0.0) & (below_m < settings.drop_max_m)])
    )
    away, nearest_wall = nearest_known(walls)
    off_wall_m = away * grid.cell_m
    # Above the head of a door or a window it is the wall that closes up to the ceiling. What is deeper than walls are thick hangs,
    # though scans take its side for a wall, which begins where it hangs.
    lengths = _lengths(parts)
    is_deep = np.bincount(parts[hangs], minlength=len(lengths)) * grid.cell_m > settings.drop_deep_m * lengths
    away, nearest = nearest_known(hangs)
    at_part = np.where(away <= 1.5, parts[nearest], 0)
    low_m = np.where(at_part > 0, low_m[nearest], low_m)
    passed = position[(label == Label.WALL) & votes.seen()]
    from_m, up_to_m = grid.heights(passed, 0.0), grid.heights(passed, 1.0)
    begins = (from_m > low_m - level_m) & (from_m - ground_m > settings.headroom_m)
    hung = (at_part > 0) & is_deep[at_part] & begins
    high_m = np.where(hung, np.fmax(high_m, up_to_m), high_m)
    side = (hung | (hangs & ~walls)) & (high_m - low_m > votes.voxel_m)
    edge_m = _ceiling_beside_m(ceiling_m, side, low_m + settings.drop_min_m, 2 * round(settings.drop_edge_m / grid.cell_m) + 1)
    closes = np.zeros_like(side)
    # Hangers and brackets are short.
    steps_m = np.where(hangs & (lengths[parts] >= settings.drop_sides_min), low_m, np.nan)
    reached_m = _up_by_the_next_step_m(steps_m, low_m, high_m, votes.voxel_m)[side]
    closes[side] = np.where(np.isfinite(edge_m), edge_m, top_m[side]) - reached_m < 2.0 * votes.voxel_m
    held = hangs & (off_wall_m < 2.0 * grid.cell_m)
    along_wall = hangs & (off_wall_m < settings.slit_max_m)

    cells, sides, closing, holding, along = (
        np.bincount(at_part[mask], minlength=len(lengths)) for mask in (hangs, side, closes, held, along_wall)
    )
    closed_up = (sides >= settings.drop_sides_min) & (closing > settings.drop_closed_min * sides)
    built = closed_up & ((holding > 0) | (lengths * grid.cell_m > settings.lamp_max_m))
    at_wall = along > 0.8 * cells
    for part in np.flatnonzero(built & at_wall & (holding > 0)):
        own = np.nonzero(parts == part)
        own_walls = np.column_stack([place[own] for place in nearest_wall])
        at_wall[part] = not _spans(np.column_stack(own), own_walls, held[own])
    built &= ~(at_wall & (holding < lengths))
    wall = position[(label == Label.WALL) & votes.seen(settings.votes_min)]
    # Between coffers, and beyond a soffit's end, the wall goes up to the ceiling.
    away, nearest = nearest_known(hangs | np.isfinite(ceiling_m))
    behind = np.where(away <= 2.0, parts[nearest], 0)
    for part in np.flatnonzero(built & at_wall):
        built[part] = not _goes_on_above(wall, grid, behind == part, np.median(low_m[parts == part]), votes.voxel_m)
    # The slit between a duct and its wall closes up to the ceiling; the duct hangs beside it.
    lowest_m = ndimage.minimum_filter(np.where(hangs & ~built[parts], low_m, np.inf), 3)
    beside = np.bincount(parts[hangs & (lowest_m < low_m - level_m)], minlength=len(cells))
    drops = (built & (beside < 0.5 * cells))[parts] & hangs
    low_m = -highest_around(np.where(drops, -low_m, np.nan), 3) - settings.margin_m
    low_m[~np.isfinite(low_m)] = np.nan
    return HeightMap(Surface.CEILING_DROP, grid.origin, grid.cell_m, low_m, np.where(np.isfinite(low_m), top_m, np.nan))


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
