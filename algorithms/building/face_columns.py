"""The columns of wall faces: where they are, how high the room is before them, and what rays found of each."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.levels import HeightMap, corrected
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Walls, stretches
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, THROUGH, WallCells, returns_at_face
from ffmap.algorithms.building.votes import VoxelVotes, majority

_FOOT_M, SILL_M, _HIP_M = 0.15, 0.7, 1.8
"""Between foot and hip rays that pass a face prove an opening, or that nothing stands there. No window has a lower sill."""
_CEILING_MARGIN_M = 0.08
"""Rows so close below a ceiling hold its own returns."""
_CROWN_M = 0.2
"""No window reaches so close to where these begin."""
_LEAST_ABOVE_M = 0.25
_ROW_RAYS, _OPEN_RATIO = 3, 10.0
"""A row of a column is open where so many rays pass, and so many for each that ends there."""
SMOOTH_COLUMNS = 1
_AGREED_VOTES = 3
_ROOM_M, _ROOM_BESIDE_M, _ROOM_CUBES = (0.3, 3.0), 0.5, 10
"""Between these distances before a wall of this building, and so far beside it, so many cubes of floor or ceiling are seen."""


@dataclass(frozen=True)
class Storey:
    """The cubes that are floor (n, 3), and ceiling (m, 3): scans agree on that, or the building's level surfaces tell."""

    floor: FloatArray
    ceiling: FloatArray

    @classmethod
    def of(cls, votes: VoxelVotes, levels: Sequence[HeightMap] = ()) -> "Storey":
        """Of the labels that scans gave, and of the surfaces that are told from all of them."""
        by_scans = majority(votes.counts)
        label = corrected(levels, votes.mean_position, by_scans)
        agreed = (label != by_scans) | votes.seen(_AGREED_VOTES)
        label = np.where(agreed, label, Label.CLUTTER)
        return cls(votes.mean_position[label == Label.FLOOR], votes.mean_position[label == Label.CEILING])

    @cached_property
    def both(self) -> FloatArray:
        """(n + m, 3) floor and ceiling."""
        return np.concatenate([self.floor, self.ceiling])

    @cached_property
    def _trees(self) -> tuple[cKDTree, cKDTree]:
        return cKDTree(self.floor[:, :2]), cKDTree(self.ceiling[:, :2])

    def clear_m(self, places: FloatArray, near_m: float) -> FloatArray:
        """(k,) metres from the floor to the ceiling near each place (k, 2); NaN where no ceiling was seen so near.

        The higher ones of the nearest cubes of ceiling count, for ducts and lamps hang below it.
        """
        if len(self.ceiling) < 10 or not len(places):
            return np.full(len(places), np.nan)
        distance, nearest = self._trees[1].query(places, k=10)
        top = np.percentile(self.ceiling[nearest, 2], 80, axis=1)
        return np.where(distance[:, 0] < near_m, top - self.ground_m(places), np.nan)

    def ground_m(self, places: FloatArray) -> FloatArray:
        """(k,) how high in the map the floor is near each place (k, 2); 0 where none was seen at all."""
        if len(self.floor) < 5 or not len(places):
            return np.zeros(len(places))
        return np.asarray(np.median(self.floor[self._trees[0].query(places, k=5)[1], 2], axis=1))


def column_places(walls: Walls, first: IntArray, before_m: float = 0.2) -> FloatArray:
    """(columns, 2) x and y so many metres before the middle of each column of the faces; first: see `WallCells`."""
    places = np.zeros((int(first[-1]), 2))
    for w, face in enumerate(segments(walls)):
        middles = face.at((np.arange(first[w + 1] - first[w]) + 0.5) * CELL_M)
        places[first[w] : first[w + 1]] = middles + before_m * face.normal
    return places


@dataclass(frozen=True)
class Columns:
    """Rays on and past each column (c,) of the faces, told with the columns beside it: above doors, close below the ceiling,
    between foot and hip, below windows' sills. upper_open_rows: above doors, those that almost all rays pass.
    """

    upper_on: FloatArray
    upper_passed: FloatArray
    upper_open_rows: IntArray
    crown_on: FloatArray
    crown_passed: FloatArray
    lower_on: FloatArray
    lower_passed: FloatArray
    sill_on: FloatArray
    sill_passed: FloatArray

    def part(self, columns: slice) -> "Columns":
        """Some of the columns."""
        return Columns(*(getattr(self, field.name)[columns] for field in fields(self)))


def above_doors_m(clear_m: FloatArray, above_door_m: float) -> FloatArray:
    """(k,) from which height on nothing but walls stands: above leaves and cupboards, and in low rooms, whose doors and
    shelves are lower, the last 25 cm.

    clear_m: (k,) from the floor to the ceiling; NaN where none was seen.
    """
    return np.asarray(np.fmin(above_door_m, clear_m - _LEAST_ABOVE_M))


def count_columns(cells: WallCells, clear_m: FloatArray, above_door_m: float) -> Columns:
    """What the rays found of each column of the faces.

    clear_m: (columns,) from the floor to the ceiling before each; NaN where none was seen. above_door_m: where the wall above
    doors begins.
    """
    on, passed = on_and_passed(cells.counts)
    height = (np.arange(cells.rows) + 0.5) * CELL_M
    top = np.where(np.isfinite(clear_m), clear_m, np.inf) - _CEILING_MARGIN_M
    upper = (height > above_doors_m(clear_m, above_door_m)[:, None]) & (height < top[:, None])
    crown = upper & (height > top[:, None] - _CROWN_M)
    lower = (height > _FOOT_M) & (height < _HIP_M)
    sill = (height > _FOOT_M) & (height < SILL_M)
    upper_on, upper_passed = _smooth(on * upper, cells), _smooth(passed * upper, cells)
    is_open = (upper_passed >= _ROW_RAYS) & (upper_passed > _OPEN_RATIO * upper_on)
    return Columns(
        upper_on.sum(axis=1),
        upper_passed.sum(axis=1),
        np.count_nonzero(is_open, axis=1),
        _smooth((on * crown).sum(axis=1), cells),
        _smooth((passed * crown).sum(axis=1), cells),
        _smooth(on[:, lower].sum(axis=1), cells),
        _smooth(passed[:, lower].sum(axis=1), cells),
        _smooth(on[:, sill].sum(axis=1), cells),
        _smooth(passed[:, sill].sum(axis=1), cells),
    )


def visited_columns(walls: Walls, cells: WallCells, path_map: FloatArray, robot_m: float) -> BoolArray:
    """(columns,) whether the robot drove where each column stands."""
    places = column_places(walls, cells.first, 0.0)
    if not len(places) or not len(path_map):
        return np.zeros(len(places), bool)
    return np.asarray(cKDTree(path_map).query(places)[0] < robot_m)


def _smooth(values: FloatArray, cells: WallCells) -> FloatArray:
    """The values (c, …) of each column with those beside it on the same face."""
    smooth = np.zeros_like(values)
    for first, last in zip(cells.first[:-1], cells.first[1:], strict=True):
        if last > first:
            smooth[first:last] = ndimage.convolve1d(
                values[first:last], np.ones(2 * SMOOTH_COLUMNS + 1), axis=0, mode="constant"
            )
    return smooth


def rows_on_and_passed(counts: FloatArray, clear_m: float) -> tuple[FloatArray, FloatArray]:
    """How many rays ended on columns (c, rows, 4), and how many did not, in each row between foot and ceiling."""
    rows = slice(FOOT_ROW, int((clear_m - _CEILING_MARGIN_M) / CELL_M))
    return on_and_passed(counts[:, rows].sum(axis=0, dtype=np.float64))


def on_and_passed(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How many rays ended on cells, or sums of them (…, 4), and how many did not."""
    on = returns_at_face(counts)
    return on, counts[..., THROUGH] + counts[..., FILLED] - on


def median_m(values_m: FloatArray) -> float:
    """The median of those that are known; NaN where none is."""
    known = values_m[np.isfinite(values_m)]
    return float(np.median(known)) if len(known) else float("nan")


def room_before(faces: Walls, storey: Storey) -> BoolArray:
    """(W,) whether floor or ceiling is seen before a face: what is seen through a window, another house's front, has neither."""
    cubes = np.zeros(len(faces), np.int64)
    for w, face in enumerate(segments(faces)):
        before_m = face.before_m(storey.both)
        beside = face.beside(storey.both, _ROOM_BESIDE_M)
        cubes[w] = np.count_nonzero(beside & (before_m > _ROOM_M[0]) & (before_m < _ROOM_M[1]))
    return np.asarray(cubes >= _ROOM_CUBES)


def cut_faces(walls: Walls, cells: WallCells, stretches: list[tuple[int, int, int]]) -> Walls:
    """Stretches of faces, in columns, as faces of their own."""
    if not stretches:
        return NO_WALLS
    owner = np.array([s[0] for s in stretches])
    ends = np.empty((len(stretches), 2, 2))
    for i, (w, first, after) in enumerate(stretches):
        face = Segment.between(walls.ends[w], walls.normal[w])
        whole = after == cells.first[w + 1] - cells.first[w]
        ends[i] = face.at(np.array([first * CELL_M, face.length_m if whole else after * CELL_M]))
    return replace(walls.select(owner), ends=ends)


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First index, and the one after the last, of the runs of True."""
    return [(first, last + 1) for first, last in stretches(flags, 0)]


def long_runs(flags: BoolArray, length: int, bridge: int) -> BoolArray:
    """The flags with short gaps closed, and of these the runs of at least so many."""
    long = np.zeros(len(flags), bool)
    for first, last in stretches(flags, bridge):
        long[first : last + 1] = last + 1 - first >= length
    return long
