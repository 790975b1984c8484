"""What all scans of a drive gathered, as the building and its maps are made of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.face_columns import Storey
from ffmap.algorithms.building.levels import HeightMap, LevelsSettings, map_levels
from ffmap.algorithms.building.model import BuildingSettings, Walls, Windows
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.summary import Features

Trace = Callable[[Walls, BuildingSettings, Windows], WallCells]
"""Counts the rays of all scans against faces as `trace_rays` does, without those that ended beyond a window."""


@dataclass(frozen=True)
class Drive:
    """Where the robot was, and what each of its scans says of the building.

    path_map: (n, 2 or more) the robot's places. blocks: gives the features of all scans in portions, each time anew.
    """

    path_map: FloatArray
    blocks: Callable[[], Iterable[Features]]


@dataclass(frozen=True)
class AllScans:
    """What the scans of a drive gathered, in the map frame.

    votes: cubes by the labels that scans gave. rivals: what the paper's maps are drawn from, see `RivalCounter`.
    """

    drive: Drive
    votes: VoxelVotes
    rivals: VoxelVotes
    trace: Trace
    levels_settings: LevelsSettings

    @cached_property
    def levels(self) -> tuple[HeightMap, ...]:
        """The ceilings and floors that they show together."""
        return map_levels(self.votes, self.levels_settings)

    @cached_property
    def storey(self) -> Storey:
        """The building's floor and ceiling."""
        return Storey.of(self.votes, self.levels, self.levels_settings.votes_min)

    @property
    def path_map(self) -> FloatArray:
        """(n, 2) the robot's places."""
        return self.drive.path_map[:, :2]
