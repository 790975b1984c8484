"""What all scans of a drive gathered, as the building and its maps are made of it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.building.evidence import Evidence, joined, rows_of
from ffmap.algorithms.building.heights import HeightMap
from ffmap.algorithms.building.levels import LevelsSettings, map_levels
from ffmap.algorithms.building.model import Walls, Windows
from ffmap.algorithms.building.storey import Storey
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.summary import Features

_PLACE_M, _TURN, _VIEWS_MAX = 0.25, 0.25, 20
"""Scans are of one view where their lidar's places and the axes of its frame are this near, and this many tell of the view."""

Trace = Callable[[Walls, Windows], Evidence]
"""Books the rays of all scans in cells of faces, without those that ended beyond a window."""
TracePart = Callable[[Walls, Windows | None], Evidence]
"""The same of the rays alone that ended beyond one of some windows; of all rays without any."""


class TraceOnce:
    """Books the rays of all scans in the cells of the faces alone that were not asked for before.

    What rays found of a face depends on no other face, and most faces are the same from one step to
    the next.
    """

    def __init__(self, trace: TracePart) -> None:
        self._trace = trace
        self._known: dict[bytes, dict[bytes, Evidence]] = {}

    def __call__(self, walls: Walls, windows: Windows) -> Evidence:
        """As `Trace` says."""
        found = self._part(walls, None)
        return found.minus(self._part(walls, windows)) if len(windows) else found

    def _part(self, walls: Walls, through: Windows | None) -> Evidence:
        known = self._known.setdefault(b"" if through is None else through.key, {})
        rows = rows_of(walls)
        keys = [
            ends.tobytes() + normal.tobytes()
            for ends, normal in zip(walls.ends, walls.normal, strict=True)
        ]
        new = np.array([key not in known or known[key].rows < rows for key in keys], bool)
        if not new.any():
            return joined([known[key] for key in keys], rows)
        # As high as the highest face that is asked for, which may be another.
        as_high = replace(walls, top_m=np.full(len(walls), walls.top_m.max()))
        found = self._trace(as_high.select(new), through)
        if new.all() and not walls.scan_count.any():
            return found  # Lines that no scan saw as a plane are many, and asked for once or twice.
        traced = {key: found.of(own) for own, key in enumerate(np.array(keys, object)[new])}
        faces = [traced[key] if key in traced else known[key] for key in keys]
        known |= traced
        return joined(faces, rows)


def new_views(T_map_base: FloatArray, lidar: IntArray) -> BoolArray:
    """Which scans (n,) show something of the building that those before them did not.

    A lidar that stands where it stood before, turned the same way, measures the same again: of each view the first scans tell
    all, and the building takes as long as there are places, however long the drive.

    T_map_base: (n, 4, 4) of each scan, in the order of time. lidar: (n,) whose scan it is.
    """
    turned = T_map_base[:, :3, :2].reshape(-1, 6)
    view = np.rint(np.column_stack([T_map_base[:, :3, 3] / _PLACE_M, turned / _TURN, lidar])).astype(np.int64)
    _, view = np.unique(view, axis=0, return_inverse=True)
    by_view = np.argsort(view, kind="stable")
    first = np.searchsorted(view, view, sorter=by_view)
    new = np.zeros(len(view), bool)
    new[by_view] = np.arange(len(view)) - first[by_view] < _VIEWS_MAX
    return new


@dataclass(frozen=True)
class Drive:
    """Where the robot was, and what each of its scans says of the building.

    path_map: (n, 2 or more) the robot's places. blocks: gives the features of the scans in portions, each time anew.
    """

    path_map: FloatArray
    blocks: Callable[[], Iterable[Features]]


@dataclass(frozen=True)
class AllScans:
    """What the scans of a drive gathered, in the map frame.

    votes: cubes by the labels that scans gave. rivals: what the paper's maps are drawn from, see `RivalCounter`.
    trace_within: books rays in openings, where they ended, see `trace`.
    """

    drive: Drive
    votes: VoxelVotes
    rivals: VoxelVotes
    trace: Trace
    trace_within: Callable[[Walls], Evidence]
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
