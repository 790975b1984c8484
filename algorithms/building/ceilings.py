"""Ceilings that single scans missed or cut up: of other rooms, and sloping ones; and which of all ceilings are rooms'."""

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
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


def map_glimpsed_ceilings(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """Ceilings that no scan found, of rooms seen through a doorway: the highest there is, level, and too broad for a duct.

    A scan finds the ceiling above it; to it, what is higher or lower is clutter. Where its plane meets the walls of a room with
    a higher ceiling, it leaves a line of ceiling on them: only a ceiling that is higher shows that something hangs below it.
    """
    grid, ground_m = grid_over_all(votes, settings.cell_m, settings)
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
    grid, ground_m = grid_over_all(votes, settings.cell_m, settings)
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
    """(n,) which cubes of ceiling (n, 3) are a room's: all but what is both narrow and lower than the ceiling beside it.

    That is the underside of a duct or of a board over a wardrobe, at the height of another room's ceiling. A scan that sees both
    rooms cannot tell the one from the other; but what ends there is no wall.
    """
    grid = GroundGrid.around(ceiling, settings.cell_m, settings.ceiling_reach_m)
    lowest_m, usual_m = grid.heights(ceiling, 0.0), grid.heights(ceiling)
    beside_cells = 2 * round(settings.narrow_beside_m / grid.cell_m) + 1
    hangs = lowest_m < highest_around(usual_m, beside_cells) - settings.drop_min_m
    steep = range_around(lowest_m, 3) > 2.0 * settings.flat_m
    broad = grid.broad(closed(np.isfinite(lowest_m) & ~steep) & ~steep, settings.overhead_width_m)
    # The edge of a ceiling, along a wall behind which another ceiling begins, is steep.
    away, nearest = nearest_known(broad)
    off_m = np.abs(lowest_m - lowest_m[nearest])
    is_edge = (away <= round(settings.ceiling_edge_m / grid.cell_m)) & (off_m < settings.margin_m)
    narrow_m = np.where(hangs & ~is_edge, lowest_m, np.nan)[grid.cells(ceiling)]
    return ~(np.abs(ceiling[:, 2] - narrow_m) < settings.margin_m)
