"""Floors that single scans did not find: beyond what they saw, on platforms and steps; and the storey below."""

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.height_map import (
    GroundGrid,
    HeightMap,
    Surface,
    closed,
    grid_over_all,
    highest_around,
    median_around,
    range_around,
)
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.votes import VoxelVotes


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
    grid = GroundGrid.around(position[low], cell_m, settings.ceiling_reach_m)
    ground_m, away = grid.ground_m(position[floor])
    low &= grid.above_m(position, ground_m) > min(between_m[0], -settings.margin_m)
    lowest_m = grid.heights(position[low], 0.0)
    above_m, around_m = lowest_m - ground_m, median_around(lowest_m)
    level = (np.abs(lowest_m - around_m) < settings.flat_m) & (above_m > between_m[0]) & (above_m < between_m[1])
    level &= away > 0
    # What is seen at a slant shows in lines.
    between_lines = closed(level, 5) & np.isnan(lowest_m)
    broad = grid.broad(closed(level) | between_lines, width_m)
    return grid.level(surface, np.where(broad, around_m, np.nan), settings.margin_m)


def map_step_fronts(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """The fronts of steps: between a floor and a higher one, both broad, where the one ends at the other.

    votes: with the raised floors.
    """
    floor = votes.mean_position[(votes.label == Label.FLOOR) & votes.seen()]
    grid = GroundGrid.around(floor, settings.cell_m, settings.ceiling_reach_m)
    floor_m = grid.heights(floor)
    steep = range_around(floor_m, 3) > settings.raised_min_m
    level = closed(np.isfinite(floor_m) & ~steep) & ~steep
    broad_m = np.where(grid.broad(level, settings.raised_width_m), floor_m, np.nan)
    high_m = highest_around(broad_m, settings.window_cells)
    low_m = -highest_around(-broad_m, settings.window_cells)
    step = (high_m - low_m > settings.raised_min_m) & (high_m - low_m < settings.raised_max_m)
    low_m, high_m = np.where(step, low_m, np.nan), np.where(step, high_m + settings.margin_m, np.nan)
    return HeightMap(Surface.STEP_FRONT, grid.origin, grid.cell_m, low_m, high_m)


def map_storey_below(votes: VoxelVotes, settings: LevelsSettings) -> HeightMap:
    """What lies lower than the floor of this storey: walls of the one below, seen down a stairwell.

    votes: with the raised floors.
    """
    position = votes.mean_position
    grid, ground_m = grid_over_all(votes, settings.ceiling_cell_m, settings)
    highest_m = ground_m - settings.below_floor_m
    # Whatever scans took it for: it may lie in line with a wall of this storey.
    lowest_m = grid.heights(position[grid.above_m(position, highest_m) < 0.0], 0.0) - settings.margin_m
    return HeightMap(
        Surface.STOREY_BELOW, grid.origin, grid.cell_m, lowest_m, np.where(np.isfinite(lowest_m), highest_m, np.nan)
    )
