"""Floor and ceiling of the storey, and wall faces with what is known of each of their columns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import segment, segments
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.evidence import Evidence
from ffmap.algorithms.building.heights import HeightMap, Surface, corrected
from ffmap.algorithms.building.levels import LevelsSettings, of_rooms
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Walls

CEILING_MARGIN_M = 0.08
"""Rows this close below a ceiling hold its own returns: their scatter, and the row it lies in."""
CEILING_NEAR_M = 2.0
"""Maximum horizontal distance (m) of a face's ceiling."""
_ABOVE_DOORS_M, _LOW_ROOM_M = 2.15, 0.25
"""Above standard leaves (84 in; DIN 18101: 2.11 m) and cupboards, and below the ceiling (m)."""
_ROOM_M, _ROOM_BESIDE_M, _ROOM_CUBES_MIN = (0.3, 3.0), 0.5, 10
"""A room is seen so far (m) before a face, so far beyond its ends, by so many voxels."""


@dataclass(frozen=True)
class Storey:
    """The voxels that are floor (n, 3) and ceiling (m, 3).

    By the scans' votes, or by the building's level surfaces.
    """

    floor: FloatArray
    ceiling: FloatArray

    @classmethod
    def of(
        cls, votes: VoxelVotes, levels: Sequence[HeightMap], settings: LevelsSettings
    ) -> "Storey":
        """From the labels that scans gave, and the surfaces that all of them show."""
        by_scans, position = votes.label, votes.mean_position
        # A lintel's underside seems a beam's: what ends there is no lower than its room.
        built = [level for level in levels if level.surface != Surface.CEILING_DROP]
        label = corrected(built, position, by_scans)
        agreed = (label != by_scans) | votes.seen(settings.votes_min)
        label = np.where(agreed, label, Label.CLUTTER)
        # What no scan found, but all together, was found to be broad, or to be built.
        ceiling = np.flatnonzero((label == Label.CEILING) & (by_scans == Label.CEILING))
        label[ceiling[~of_rooms(position[ceiling], settings)]] = Label.CLUTTER
        return cls(position[label == Label.FLOOR], position[label == Label.CEILING])

    @cached_property
    def both(self) -> FloatArray:
        """(n + m, 3) floor and ceiling."""
        return np.concatenate([self.floor, self.ceiling])

    @cached_property
    def _trees(self) -> tuple[cKDTree, cKDTree]:
        return cKDTree(self.floor[:, :2]), cKDTree(self.ceiling[:, :2])

    def clear_m(self, places: FloatArray, near_m: float) -> FloatArray:
        """(k,) metres from the floor to the ceiling near each place (k, 2).

        NaN where none was seen within `near_m`.

        The higher ones of the nearest cubes of ceiling count: ducts and lamps hang below it.
        """
        if len(self.ceiling) < 10 or not len(places):
            return np.full(len(places), np.nan)
        distance, nearest = self._trees[1].query(places, k=10)
        top = np.percentile(self.ceiling[nearest, 2], 80, axis=1)
        return np.where(distance[:, 0] < near_m, top - self.ground_m(places), np.nan)

    def ground_m(self, places: FloatArray) -> FloatArray:
        """(k,) map z of the floor near each place (k, 2); 0 where no floor was seen at all."""
        if len(self.floor) < 5 or not len(places):
            return np.zeros(len(places))
        return np.asarray(np.median(self.floor[self._trees[0].query(places, k=5)[1], 2], axis=1))


def above_doors_m(clear_m: FloatArray) -> FloatArray:
    """(k,) height (m) above which nothing but walls stands: above leaves and cupboards.

    In low rooms these are the last 25 cm. clear_m: (k,) from the floor to the ceiling, or NaN.
    """
    return np.asarray(np.fmin(_ABOVE_DOORS_M, clear_m - _LOW_ROOM_M))


def column_places(walls: Walls, first: IntArray, before_m: float = 0.2) -> FloatArray:
    """(columns, 2) x and y of places before the middle of each column of the faces.

    first: see `Evidence`.
    """
    places = np.zeros((int(first[-1]), 2))
    for w, face in enumerate(segments(walls)):
        middles = face.at((np.arange(first[w + 1] - first[w]) + 0.5) * CELL_M)
        places[first[w] : first[w + 1]] = middles + before_m * face.normal
    return places


@dataclass(frozen=True)
class TracedFaces:
    """Wall faces and what is known of each of their columns.

    evidence: what rays found. clear_m: (columns,) from the floor to the ceiling before each; NaN
    where no ceiling was seen. ground_m: (columns,) map z of the floor before each.
    """

    walls: Walls
    evidence: Evidence
    clear_m: FloatArray
    ground_m: FloatArray

    @property
    def top_m(self) -> FloatArray:
        """(columns,) how high each stands: up to the ceiling, or as high as its face was seen."""
        seen_m = np.repeat(self.walls.top_m, np.diff(self.evidence.first))
        return np.where(np.isfinite(self.clear_m), self.clear_m, seen_m)

    def __len__(self) -> int:
        return len(self.walls)

    @classmethod
    def of(cls, walls: Walls, evidence: Evidence, storey: Storey) -> "TracedFaces":
        """Look up floor and ceiling before each column."""
        places = column_places(walls, evidence.first)
        clear_m = storey.clear_m(places, CEILING_NEAR_M)
        return cls(walls, evidence, clear_m, storey.ground_m(places))

    def columns(self, w: int) -> slice:
        """The columns of one face."""
        return self.evidence.columns(w)

    def whole(self, w: int) -> tuple[int, int, int]:
        """One face as a stretch, see `cut`."""
        own = self.columns(w)
        return w, 0, own.stop - own.start

    def cut(self, stretches: list[tuple[int, int, int]]) -> Walls:
        """Stretches of faces as faces of their own.

        stretches: each a face, its first column and the one after its last.
        """
        if not stretches:
            return NO_WALLS
        ends = np.empty((len(stretches), 2, 2))
        for i, (w, first, after) in enumerate(stretches):
            face, columns = segment(self.walls, w), self.columns(w)
            whole = after == columns.stop - columns.start
            last_m = face.length_m if whole else after * CELL_M
            ends[i] = face.at(np.array([first * CELL_M, last_m]))
        return replace(self.walls.select(np.array([s[0] for s in stretches])), ends=ends)

    def part(self, stretches: list[tuple[int, int, int]]) -> "TracedFaces":
        """The same as `cut`, with what is known of the columns."""
        columns, evidence = self.evidence.part(stretches)
        clear_m, ground_m = self.clear_m[columns], self.ground_m[columns]
        return TracedFaces(self.cut(stretches), evidence, clear_m, ground_m)

    def visited(self, path_map: FloatArray, robot_m: float) -> BoolArray:
        """(columns,) where the robot drove: its places (n, 2) are closer than `robot_m`."""
        places = column_places(self.walls, self.evidence.first, 0.0)
        if not len(places) or not len(path_map):
            return np.zeros(len(places), bool)
        return np.asarray(cKDTree(path_map).query(places)[0] < robot_m)


def room_before(faces: Walls, storey: Storey) -> BoolArray:
    """(W,) whether floor or ceiling is seen before a face.

    Before another house's front, seen through a window, is neither.
    """
    cubes = np.zeros(len(faces), np.int64)
    for w, face in enumerate(segments(faces)):
        before_m = face.before_m(storey.both)
        beside = face.beside(storey.both, _ROOM_BESIDE_M)
        near = (before_m > _ROOM_M[0]) & (before_m < _ROOM_M[1])
        cubes[w] = np.count_nonzero(beside & near)
    return np.asarray(cubes >= _ROOM_CUBES_MIN)
