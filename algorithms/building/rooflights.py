"""What a pane overhead mirrors: the room below it, upside down."""

from collections.abc import Iterable

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.building.height_map import (
    GroundGrid,
    HeightMap,
    Surface,
    closed,
    grid_over_all,
    nearest_known,
)
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.summary import Features


def map_mirrored_floors(votes: VoxelVotes, blocks: Iterable[Features], settings: LevelsSettings) -> HeightMap:
    """Floors that rooflights mirror, and scans take for ceilings: as high above the pane as that is above the floor.

    Each ray to such a floor passes something half way up that returns others: the pane, or its bars. To a hall's ceiling rays pass
    open air.

    votes: of the scans' labels. blocks: the scans' features in the map frame, in portions; not read where nothing broad lies
    overhead, twice as high as any ceiling has to be.
    """
    grid, ground_m = grid_over_all(votes, settings.ceiling_cell_m, settings)
    position, pane_min_m = votes.mean_position, settings.overhead_min_m
    above_m, overhead = grid.above_m(position, ground_m), votes.seen() & _may_be_overhead(votes.label)
    # The mirrored floor is the highest there is.
    height_m = grid.heights(position[overhead & (above_m > 2.0 * pane_min_m)], 1.0)
    may_be_pane = position[overhead & (above_m > pane_min_m)]
    passed_pane, rays = np.zeros(grid.shape, np.int64), np.zeros(grid.shape, np.int64)
    if grid.broad(closed(np.isfinite(height_m)), settings.overhead_width_m).any():
        panes = cKDTree(may_be_pane)
        for half_way, end in _half_way_up(blocks, grid, ground_m, pane_min_m):
            cell = grid.cells(end)
            highest = height_m[cell] - end[:, 2] < settings.overhead_gap_m
            cell = cell[0][highest], cell[1][highest]
            away_m, _ = panes.query(half_way[highest], distance_upper_bound=settings.at_pane_m)
            np.add.at(passed_pane, cell, np.isfinite(away_m))
            np.add.at(rays, cell, 1)
    mirrored = (rays >= settings.mirrored_rays_min) & (passed_pane > settings.mirrored_share_min * rays)
    broad = grid.broad(closed(mirrored), settings.overhead_width_m)
    # Between the few of its places that were seen.
    height_m = np.where(broad, height_m[nearest_known(mirrored)[1]], np.nan)
    pane_m, gap_m = 0.5 * (ground_m + height_m), settings.overhead_gap_m
    return HeightMap(Surface.MIRRORED_FLOOR, grid.origin, grid.cell_m, pane_m + gap_m, height_m + gap_m)


def _may_be_overhead(label: UInt8Array) -> BoolArray:
    """(n,) what scans take for a ceiling, or for what hangs or lies above theirs."""
    return np.isin(label, (Label.CEILING, Label.CLUTTER))


def _half_way_up(
    blocks: Iterable[Features], grid: GroundGrid, ground_m: FloatArray, pane_min_m: float
) -> Iterable[tuple[FloatArray, FloatArray]]:
    """(r, 3) each, in the map frame: where rays to what is more than twice as high as `pane_min_m` are half way up from the floor,
    and where they end."""
    for block in blocks:
        upwards = _may_be_overhead(block.ray_label)
        end, origin = block.ray_end_map[upwards].astype(np.float64), block.origin_map[block.ray_scan[upwards]]
        above_m = grid.above_m(end, ground_m)
        # From below the pane alone.
        far = (above_m > 2.0 * pane_min_m) & (end[:, 2] - 0.5 * above_m > origin[:, 2])
        end, origin, above_m = end[far], origin[far], above_m[far]
        share = 1.0 - 0.5 * above_m / (end[:, 2] - origin[:, 2])
        yield origin + share[:, None] * (end - origin), end
