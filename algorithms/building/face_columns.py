"""The columns of wall faces: where they are, how high the room is before them, and what rays found of each."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import Segment, segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.heights import HeightMap, corrected
from ffmap.algorithms.building.levels import LevelsSettings, of_rooms
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    BuildingSettings,
    Rows,
    Walls,
    cells_in,
    stretches,
)
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    FOOT_ROW,
    SUM,
    THROUGH,
    WallCells,
    returns_at_face,
    with_neighbours,
)
from ffmap.algorithms.building.votes import VoxelVotes

CEILING_MARGIN_M = 0.08
"""Rows this close below a ceiling hold its own returns: their scatter, and the row that it lies in."""
LOW_ROOM_M = 0.25
"""In a room lower than its doors and shelves are elsewhere, this much below the ceiling nothing but walls stands."""


FLOOR_NEAR_M = 0.2
"""The floor is seen up to a face where it is seen within this distance of it: furniture is deeper."""


class FaceColumnsSettings(StepSettings):
    """What rays tell of wall faces, column by column, and of the room before them."""

    foot_m: float = Field(0.15, ge=0, description="Minimum height (m) of rays that count; below are skirting boards.")
    crown_m: float = Field(
        0.2,
        gt=0,
        description="Height (m) of the highest part of a face that rays reach: no window, cupboard or leaf has it.",
    )
    top_m: float = Field(
        0.1,
        gt=0,
        description="Height (m) of the uppermost that rays reach of a column: where they pass that, what stands there ends below.",
    )
    row_rays_min: int = Field(3, ge=1, description="Minimum number of rays that pass an open row of a column.")
    row_open_ratio: float = Field(
        10.0, gt=0, description="Minimum rays that pass an open row for each that ends there."
    )
    room_from_m: float = Field(0.3, ge=0, description="Minimum distance (m) before a face at which its room is seen.")
    room_to_m: float = Field(3.0, gt=0, description="Maximum distance (m) before a face at which its room is seen.")
    room_beside_m: float = Field(0.5, ge=0, description="Maximum distance (m) beyond a face's ends of its room.")
    room_cubes_min: int = Field(10, ge=1, description="Minimum cubes of floor or ceiling that prove a room.")


@dataclass(frozen=True)
class Storey:
    """The cubes that are floor (n, 3) and ceiling (m, 3), by the scans' votes or by the building's level surfaces."""

    floor: FloatArray
    ceiling: FloatArray

    @classmethod
    def of(cls, votes: VoxelVotes, levels: Sequence[HeightMap], settings: LevelsSettings) -> "Storey":
        """From the labels that scans gave, and the surfaces that all of them show."""
        by_scans, position = votes.label, votes.mean_position
        label = corrected(levels, position, by_scans)
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
        """(k,) metres from the floor to the ceiling near each place (k, 2); NaN where none was seen within `near_m`.

        The higher ones of the nearest cubes of ceiling count, because ducts and lamps hang below it.
        """
        if len(self.ceiling) < 10 or not len(places):
            return np.full(len(places), np.nan)
        distance, nearest = self._trees[1].query(places, k=10)
        top = np.percentile(self.ceiling[nearest, 2], 80, axis=1)
        return np.where(distance[:, 0] < near_m, top - self.ground_m(places), np.nan)

    def floor_near(self, places: FloatArray, near_m: float) -> BoolArray:
        """(k,) whether the floor was seen at most `near_m` from each place (k, 2)."""
        if not len(self.floor) or not len(places):
            return np.zeros(len(places), bool)
        return np.asarray(self._trees[0].query(places)[0] < near_m)

    def ground_m(self, places: FloatArray) -> FloatArray:
        """(k,) map z of the floor near each place (k, 2); 0 where no floor was seen at all."""
        if len(self.floor) < 5 or not len(places):
            return np.zeros(len(places))
        return np.asarray(np.median(self.floor[self._trees[0].query(places, k=5)[1], 2], axis=1))


def column_places(walls: Walls, first: IntArray, before_m: float = 0.2) -> FloatArray:
    """(columns, 2) x and y of places before the middle of each column of the faces; first: see `WallCells`."""
    places = np.zeros((int(first[-1]), 2))
    for w, face in enumerate(segments(walls)):
        middles = face.at((np.arange(first[w + 1] - first[w]) + 0.5) * CELL_M)
        places[first[w] : first[w + 1]] = middles + before_m * face.normal
    return places


def visited(places: FloatArray, path_map: FloatArray, robot_m: float) -> BoolArray:
    """(k,) whether the robot drove at places (k, 2): its own (n, 2) are closer than `robot_m`."""
    if not len(places) or not len(path_map):
        return np.zeros(len(places), bool)
    return np.asarray(cKDTree(path_map).query(places)[0] < robot_m)


class TracedFace(NamedTuple):
    """One wall face: its number among all, and where its columns lie among all faces'.

    counts: (c, rows, 4) float64 what rays found of its cells.
    top_m: (c,) how high each column stands: up to the ceiling there, or else as high as the face was seen.
    """

    number: int
    segment: Segment
    columns: slice
    counts: FloatArray
    top_m: FloatArray


@dataclass(frozen=True)
class TracedFaces:
    """Wall faces and what is known of each of their columns.

    cells: what rays found. clear_m: (columns,) from the floor to the ceiling before each; NaN where no ceiling was seen.
    ground_m: (columns,) map z of the floor before each.
    """

    walls: Walls
    cells: WallCells
    clear_m: FloatArray
    ground_m: FloatArray

    def __len__(self) -> int:
        return len(self.walls)

    def each(self) -> Iterator[TracedFace]:
        """Each of the faces by itself."""
        top_m = np.where(np.isfinite(self.clear_m), self.clear_m, np.repeat(self.walls.top_m, np.diff(self.cells.first)))
        for w, face in enumerate(segments(self.walls)):
            own = self.columns(w)
            counts = self.cells.counts[own].astype(np.float64)
            yield TracedFace(w, face, own, counts, top_m[own])

    @classmethod
    def of(cls, walls: Walls, cells: WallCells, storey: Storey, ceiling_near_m: float) -> "TracedFaces":
        """ceiling_near_m: maximum distance of a column's ceiling."""
        places = column_places(walls, cells.first)
        return cls(walls, cells, storey.clear_m(places, ceiling_near_m), storey.ground_m(places))

    def columns(self, w: int) -> slice:
        """The columns of one face."""
        return slice(int(self.cells.first[w]), int(self.cells.first[w + 1]))

    def cut(self, stretches: list[tuple[int, int, int]]) -> Walls:
        """Stretches of faces, each a face, its first column and the one after the last, as faces of their own."""
        if not stretches:
            return NO_WALLS
        ends = np.empty((len(stretches), 2, 2))
        for i, (w, first, after) in enumerate(stretches):
            face, columns = segment(self.walls, w), self.columns(w)
            whole = after == columns.stop - columns.start
            ends[i] = face.at(np.array([first * CELL_M, face.length_m if whole else after * CELL_M]))
        return replace(self.walls.select(np.array([s[0] for s in stretches])), ends=ends)

    def part(self, stretches: list[tuple[int, int, int]]) -> "TracedFaces":
        """The same as `cut`, with what is known of the columns."""
        columns = self.cells.columns(stretches)
        return TracedFaces(self.cut(stretches), self.cells.part(stretches), self.clear_m[columns], self.ground_m[columns])

    def visited(self, path_map: FloatArray, robot_m: float) -> BoolArray:
        """(columns,) where the robot drove: its places (n, 2) are closer than `robot_m`."""
        return visited(column_places(self.walls, self.cells.first, 0.0), path_map, robot_m)


@dataclass(frozen=True)
class Columns(Rows):
    """How many rays end on each column (c,) of the faces, and how many pass it, counted with the columns beside it.

    upper: above doors. crown: on the highest rows that rays reach, whatever hangs below the ceiling. open_top: whether most rays
    pass each of the uppermost. lower: between the foot and doors' heads. sill: between the foot and windows' sills.
    upper_open_rows: how many rows above doors almost all rays pass. lower_open_rows: how many rows between sills and doors' heads
    most rays pass.
    """

    upper_on: FloatArray
    upper_passed: FloatArray
    upper_open_rows: IntArray
    crown_on: FloatArray
    crown_passed: FloatArray
    open_top: BoolArray
    lower_on: FloatArray
    lower_passed: FloatArray
    lower_open_rows: IntArray
    sill_on: FloatArray
    sill_passed: FloatArray


def above_doors_m(clear_m: FloatArray, above_door_m: float) -> FloatArray:
    """(k,) height above which nothing but walls stands: above leaves and cupboards, and in low rooms the last 25 cm.

    clear_m: (k,) from the floor to the ceiling; NaN where none was seen.
    """
    return np.asarray(np.fmin(above_door_m, clear_m - LOW_ROOM_M))


def count_columns(
    faces: TracedFaces, above_door_m: float, building: BuildingSettings, settings: FaceColumnsSettings
) -> Columns:
    """What the rays found of each column of the faces; above_door_m: height at which the wall above doors begins."""
    cells = faces.cells
    on, passed = on_and_passed(cells.counts)
    height = (np.arange(cells.rows) + 0.5) * CELL_M
    top = np.where(np.isfinite(faces.clear_m), faces.clear_m, np.inf) - CEILING_MARGIN_M
    upper = (height > above_doors_m(faces.clear_m, above_door_m)[:, None]) & (height < top[:, None])
    lower = (height > settings.foot_m) & (height < building.door_height_min_m)
    sill = (height > settings.foot_m) & (height < building.knee_m)
    upper_on, upper_passed = _with_neighbours(on * upper, cells), _with_neighbours(passed * upper, cells)
    above_sill = lower & ~sill
    middle_on, middle_passed = _with_neighbours(on[:, above_sill], cells), _with_neighbours(passed[:, above_sill], cells)
    reached = upper_on + upper_passed >= settings.row_rays_min
    below_top = reached[:, ::-1].cumsum(axis=1)[:, ::-1]
    crown, top_rows = (reached & (below_top <= cells_in(high_m)) for high_m in (settings.crown_m, settings.top_m))
    is_open = (upper_passed >= settings.row_rays_min) & (upper_passed > settings.row_open_ratio * upper_on)
    return Columns(
        upper_on.sum(axis=1),
        upper_passed.sum(axis=1),
        np.count_nonzero(is_open, axis=1),
        (upper_on * crown).sum(axis=1),
        (upper_passed * crown).sum(axis=1),
        np.count_nonzero(top_rows & (upper_passed > upper_on), axis=1) >= cells_in(settings.top_m),
        _with_neighbours(on[:, lower].sum(axis=1), cells),
        _with_neighbours(passed[:, lower].sum(axis=1), cells),
        np.count_nonzero((middle_passed >= settings.row_rays_min) & (middle_passed > middle_on), axis=1),
        _with_neighbours(on[:, sill].sum(axis=1), cells),
        _with_neighbours(passed[:, sill].sum(axis=1), cells),
    )


def _with_neighbours(values: FloatArray, cells: WallCells) -> FloatArray:
    """The values (c, …) of each column and those beside it on the same face, summed."""
    faces = zip(cells.first[:-1], cells.first[1:], strict=True)
    parts = [with_neighbours(values[first:last]) for first, last in faces]
    return np.concatenate(parts) if parts else values


def rows_on_and_passed(counts: FloatArray, clear_m: float) -> tuple[FloatArray, FloatArray]:
    """How many rays end on columns (c, rows, 4), and how many pass them, in each row between foot and ceiling."""
    on, passed = cells_on_and_passed(counts, clear_m)
    return on.sum(axis=0), passed.sum(axis=0)


def cells_on_and_passed(counts: FloatArray, clear_m: float) -> tuple[FloatArray, FloatArray]:
    """The same of each cell: (c, rows between foot and ceiling) each."""
    rows = slice(FOOT_ROW, int((clear_m - CEILING_MARGIN_M) / CELL_M))
    return on_and_passed(counts[:, rows].astype(np.float64))


def on_and_passed(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How many rays end on cells, or sums of cells (…, 4), and how many pass them: what ends before a face has not passed it."""
    on = returns_at_face(counts)
    behind = np.where(counts[..., SUM] < 0.0, counts[..., FILLED] - on, 0.0)
    return on, counts[..., THROUGH] + behind


def room_before(faces: Walls, storey: Storey, settings: FaceColumnsSettings) -> BoolArray:
    """(W,) whether floor or ceiling is seen before a face; another house's front, through a window, has neither."""
    cubes = np.zeros(len(faces), np.int64)
    for w, face in enumerate(segments(faces)):
        before_m = face.before_m(storey.both)
        beside = face.beside(storey.both, settings.room_beside_m)
        cubes[w] = np.count_nonzero(beside & (before_m > settings.room_from_m) & (before_m < settings.room_to_m))
    return np.asarray(cubes >= settings.room_cubes_min)


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First index, and the one after the last, of each run of True."""
    return [(first, last + 1) for first, last in stretches(flags, 0)]


def long_runs(flags: BoolArray, length: int, bridge: int) -> BoolArray:
    """The flags with gaps of at most `bridge` closed, and of these the runs of at least `length`."""
    long = np.zeros(len(flags), bool)
    for first, last in stretches(flags, bridge):
        long[first : last + 1] = last + 1 - first >= length
    return long
