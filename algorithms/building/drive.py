"""What all scans of a drive gathered, as the building and its maps are made of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.evidence import Evidence
from ffmap.algorithms.building.heights import HeightMap
from ffmap.algorithms.building.levels import LevelsSettings, map_levels
from ffmap.algorithms.building.model import Walls, Windows
from ffmap.algorithms.building.storey import Storey
from ffmap.algorithms.scan.summary import Features

_PLACE_M, _TURN, _VIEWS_MAX = 0.25, 0.25, 20
"""Scans are of one view where their lidar's places (m) and the axes of its frame are this near, and
this many scans count of each view."""

Trace = Callable[[Walls], Evidence]
"""Books the rays of all scans in cells of faces."""


def new_views(T_map_base: FloatArray, lidar: IntArray) -> BoolArray:
    """Which scans (n,) show something of the building that those before them did not.

    A lidar that is where it was before, turned the same way, measures the same again: the first
    scans of each view are enough, and the building takes as long as there are places, however long
    the drive.

    T_map_base: (n, 4, 4) of each scan, in the order of time. lidar: (n,) whose scan it is.
    """
    turned = T_map_base[:, :3, :2].reshape(-1, 6)
    place = T_map_base[:, :3, 3] / _PLACE_M
    view = np.rint(np.column_stack([place, turned / _TURN, lidar])).astype(np.int64)
    _, view = np.unique(view, axis=0, return_inverse=True)
    by_view = np.argsort(view, kind="stable")
    first = np.searchsorted(view, view, sorter=by_view)
    new = np.zeros(len(view), bool)
    new[by_view] = np.arange(len(view)) - first[by_view] < _VIEWS_MAX
    return new


@dataclass(frozen=True)
class Drive:
    """Where the robot was, and what each of its scans says of the building.

    path_map: (n, 2 or more) the robot's places. blocks: gives the features of the scans in
    portions, each time anew.
    """

    path_map: FloatArray
    blocks: Callable[[], Iterable[Features]]


@dataclass(frozen=True)
class AllScans:
    """What the scans of a drive gathered, in the map frame.

    votes: cubes by the labels that scans gave. rivals: what the paper's maps are drawn from, see
    `RivalCounter`. trace_within: books rays in openings, where they ended, see `trace`.
    trace_beyond: books the rays alone that ended beyond one of some windows.
    """

    drive: Drive
    votes: VoxelVotes
    rivals: VoxelVotes
    trace: Trace
    trace_within: Trace
    trace_beyond: Callable[[Walls, Windows], Evidence]
    levels_settings: LevelsSettings

    @cached_property
    def levels(self) -> tuple[HeightMap, ...]:
        """The ceilings and floors that they show together."""
        return map_levels(self.votes, self.levels_settings)

    @cached_property
    def storey(self) -> Storey:
        """The building's floor and ceiling."""
        return Storey.of(self.votes, self.levels, self.levels_settings)

    @property
    def path_map(self) -> FloatArray:
        """(n, 2) the robot's places."""
        return self.drive.path_map[:, :2]
