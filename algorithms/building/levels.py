"""The level and sloping surfaces of the whole building, for what single scans saw too little of or took for something else.

Ceilings, beams, floors that lie higher than where the robot stood, floors that rooflights mirror, and the storey below.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import reduce

from ffmap.algorithms.building.ceiling_drops import map_ceiling_drops
from ffmap.algorithms.building.ceilings import (
    map_ceilings,
    map_glimpsed_ceilings,
    map_sloping_ceilings,
)
from ffmap.algorithms.building.floors import (
    map_floors_beyond,
    map_raised_floors,
    map_step_fronts,
    map_storey_below,
)
from ffmap.algorithms.building.height_map import HeightMap
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.rooflights import map_mirrored_floors
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.summary import Features


def map_levels(votes: VoxelVotes, blocks: Iterable[Features], settings: LevelsSettings) -> tuple[HeightMap, ...]:
    """All level surfaces of the building, in the order in which they correct labels.

    votes: of the scans' labels. blocks: the scans' features, in portions.
    """
    mirrored = map_mirrored_floors(votes, blocks, settings)
    votes = _corrected_votes(votes, mirrored)
    ceilings = [find(votes, settings) for find in (map_ceilings, map_glimpsed_ceilings, map_sloping_ceilings)]
    # Far away, returns are far apart.
    raised = [map_raised_floors(votes, settings, cell_m) for cell_m in (settings.cell_m, 2 * settings.cell_m)]
    with_raised = reduce(_corrected_votes, raised, votes)
    floors = (*raised, map_floors_beyond(with_raised, settings), map_step_fronts(with_raised, settings))
    drops = map_ceiling_drops(reduce(_corrected_votes, ceilings, votes), settings)
    below = map_storey_below(with_raised, settings)
    levels = (mirrored, *ceilings, *floors, drops, below)
    return tuple(level for level in levels if level.known.any())


def _corrected_votes(votes: VoxelVotes, level: HeightMap) -> VoxelVotes:
    """The votes, corrected where scans took something else for what lies there."""
    wrong = level.label_of(votes.mean_position, votes.label) != votes.label
    if not wrong.any():
        return votes
    counts, surface = votes.counts.copy(), level.surface
    taken_for = slice(None) if surface.taken_for is None else [surface.taken_for]
    own = counts[wrong]
    moved = own[:, taken_for].sum(axis=1)
    own[:, taken_for] = 0
    own[:, surface.label] += moved
    counts[wrong] = own
    return replace(votes, counts=counts)
