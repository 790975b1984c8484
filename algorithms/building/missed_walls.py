"""The walls that every single scan missed: returns of all scans in line, where rays end up to the ceiling, or to a duct."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base.known import median_known
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import FILLED, THROUGH, with_neighbours
from ffmap.algorithms.building.evidence import FOOT_ROW, first_columns
from ffmap.algorithms.building.face_columns import (
    Columns,
    FaceColumnsSettings,
    Storey,
    TracedFaces,
    cells_on_and_passed,
    count_columns,
    long_runs,
    on_and_passed,
    room_before,
    rows_on_and_passed,
    runs,
)
from ffmap.algorithms.building.face_verdicts import (
    ACROSS,
    SAME_WAY,
    StandingWallsSettings,
    wall_directions,
)
from ffmap.algorithms.building.folds import FoldsSettings, in_folds
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    BuildingSettings,
    Rows,
    Walls,
    cells_in,
)
from ffmap.algorithms.building.openings import widened
from ffmap.algorithms.building.unexplained_lines import (
    Line,
    both_sides,
    straight_lines,
    unexplained_columns,
)
from ffmap.algorithms.building.votes import VoxelVotes

_UNDERSIDE_CELL_M = 2.0 * CELL_M
"""Edge of the cells that count a duct's underside."""
_LINTEL_MIN = 0.75
"""Share of an opening's width over which its lintel shows."""


class MissedWallsSettings(StepSettings):
    """Walls that every single scan missed, and what proves them."""

    near_m: float = Field(
        0.07,
        gt=0,
        description="Maximum distance (m) of a missed wall's returns behind its face; farther, a ray has passed it: nothing "
        "stands ajar behind it.",
    )
    explained_m: float = Field(0.08, gt=0, description="Maximum distance (m) from a known face of its own returns.")
    beside_glass_m: float = Field(
        0.3,
        ge=0,
        description="Distance (m) beside a pane within which it may go on: what only rays through it and this show, it mirrors.",
    )
    beside_glass_max: float = Field(
        0.9, gt=0, le=1, description="Maximum share of a wall's returns whose rays pass within that distance of a pane."
    )
    noise_m: float = Field(0.1, gt=0, description="Maximum distance (m) before a face of its noise and boards.")
    pillar_depth_m: float = Field(0.5, gt=0, description="Maximum distance (m) of a pillar's front before its wall.")
    furniture_depth_m: float = Field(0.9, gt=0, description="Maximum depth (m) of furniture that stands at a wall.")
    half_thickness_m: float = Field(0.04, gt=0, description="Half thickness (m) of a missed wall's returns.")
    passed_max: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Maximum share of a missed wall's rays that pass it, because of scatter and of the poses' errors.",
    )
    returns_min: int = Field(20, ge=1, description="Minimum number of returns that prove a missed wall.")
    corner_m: float = Field(
        0.15, gt=0, description="Distance (m) from a corner where returns pass for the other wall's."
    )
    chord_m: float = Field(
        0.35, gt=0, description="Minimum length (m) of a chord of a round wall; twice as much is looked at."
    )
    jamb_m: float = Field(
        0.15,
        gt=0,
        description="Minimum width (m) of the wall beside a window that joins it to its sill: columns are told with those beside "
        "them, so one of a corner passes for two.",
    )
    window_min_m: float = Field(
        0.3, gt=0, description="Minimum width (m) of a window between two stretches of a wall: there are gaps between things too."
    )
    sill_m: float = Field(
        0.15, gt=0, description="Height (m) of the lowest that is seen of a wall below a window: rays pass a doorway there."
    )
    slit_m: float = Field(
        0.1, gt=0, description="Minimum height (m) of a slit that rays pass between what stands and what hangs above it."
    )
    below_ceiling_m: float = Field(
        0.35, gt=0, description="A wall shows up to this (m) below the ceiling, or above heads."
    )
    above_heads_m: float = Field(
        2.25,
        gt=0,
        description="Height above the floor (m): what shows up to here is a wall, however high the room; a leaf or the "
        "reveal of a window is lower.",
    )
    underside_near_m: float = Field(
        0.15,
        gt=0,
        description="Maximum height difference (m) between a duct's underside and the top of the wall below.",
    )
    duct_depth_min_m: float = Field(0.3, gt=0, description="Minimum depth (m) of a duct before its wall.")
    duct_depth_max_m: float = Field(0.8, gt=0, description="Maximum depth (m) of a duct before its wall.")
    duct_share_min: float = Field(
        0.7,
        gt=0,
        le=1,
        description="Minimum share of a wall that a duct hangs before, and of the cells in which its underside shows.",
    )
    duct_length_min_m: float = Field(0.8, gt=0, description="Minimum length (m) of a wall below a duct.")


@dataclass(frozen=True)
class SearchSettings:
    """What the search for missed walls is set by."""

    building: BuildingSettings
    standing: StandingWallsSettings
    columns: FaceColumnsSettings
    missed: MissedWallsSettings
    folds: FoldsSettings


@dataclass(frozen=True)
class AllReturns:
    """What all scans show together.

    path_map: (n, 2) the robot's places. trace: counts rays against faces, without those through windows; a return more than some
    centimetres behind a face counts as passed. trace_clear: the same without those that pass close beside a window; None where
    none is known.
    """

    votes: VoxelVotes
    storey: Storey
    path_map: FloatArray
    trace: Callable[[Walls], TracedFaces]
    trace_clear: Callable[[Walls], TracedFaces] | None


@dataclass(frozen=True)
class MissedWalls:
    """Walls that every single scan missed, and what hung before some of them.

    known: the known faces, without what hangs before a missed wall. ducts: that. mirrored: what looked like a missed wall, and is
    a pane's reflection of some other.
    """

    walls: Walls
    known: Walls
    ducts: Walls
    mirrored: Walls


@dataclass(frozen=True)
class _Duct:
    """A stretch of a known face, or of a refused one that hangs, from where to where along it: a duct's front before a wall."""

    face: int
    low_m: float
    high_m: float


@dataclass(frozen=True)
class _Proven:
    """A stretch of a candidate that is a wall: as a single face, and what hangs before it."""

    wall: Walls
    duct: _Duct | None


def find_missed_walls(walls: Walls, refused: Walls, returns: AllReturns, settings: SearchSettings) -> MissedWalls:
    """Walls of which scans saw too little for a plane: returns of all scans that stand in line with the building's walls.

    Columns of returns that belong to no face, walls or refused, are searched for lines in the walls' directions; a line is a wall
    where rays end on it up to the ceiling, or to the underside of a duct, and hardly any passes. What is left then is searched for
    chords of round walls, which have directions of their own.
    """
    hang = refused.select(refused.bottom_m >= settings.building.door_height_min_m)
    undersides = _undersides(returns, settings.building.door_height_min_m)
    known, asked, proven = walls, NO_WALLS, list[_Proven]()
    for lines_in in (_lines_along_walls, _chords):
        candidates = _candidates(lines_in(returns, known, refused, settings), known, asked, settings.missed)
        if len(candidates):
            asked, search = candidates, _Search(known, hang, returns.trace(candidates), undersides, returns, settings)
            proven += [stretch for w in range(len(candidates)) for stretch in search.walls_in(w)]
            known = reduce(Walls.append, [p.wall for p in proven], walls)
    found = known.select(np.arange(len(known)) >= len(walls))
    mirrored = _seen_by_glass(found, returns, settings.missed)
    before = [p.duct for p, by_glass in zip(proven, mirrored, strict=True) if p.duct is not None and not by_glass]
    rest, ducts = _cut_out(walls, [duct for duct in before if duct.face < len(walls)], settings.building.length_min_m)
    return MissedWalls(found.select(~mirrored), rest, ducts, found.select(mirrored))


def _candidates(lines: list[Line], walls: Walls, asked: Walls, missed: MissedWallsSettings) -> Walls:
    """The lines as faces, but for those along known ones or some that were asked before; which side each is seen from is not known
    yet, so both are tried."""
    if not lines:
        return NO_WALLS
    both = both_sides(lines)
    # Between a candidate and a close face that looks at it nobody can stand.
    middles = both.ends.mean(axis=1)
    faced = _near_a_face(middles, both.normal, walls, 0.0, missed.pillar_depth_m, opposite=True)
    along = _near_a_face(middles, both.normal, walls.append(asked), -missed.noise_m, missed.noise_m)
    return both.select(~faced & ~along)


def _lines_along_walls(returns: AllReturns, walls: Walls, refused: Walls, settings: SearchSettings) -> list[Line]:
    """Stretches of unexplained columns in the walls' directions, and the sides of pillars."""
    missed, gap_m = settings.missed, settings.building.gap_m
    place, weight, _ = unexplained_columns(returns.votes, walls, refused, missed.explained_m)
    directions = wall_directions(walls, settings.standing.direction_share_min)
    lines = straight_lines(place, weight, directions, missed.half_thickness_m, gap_m)
    return lines + _pillar_sides(place, weight, walls, missed)


@dataclass(frozen=True)
class _ColumnStates(Rows):
    """What the columns (c,) of a candidate are.

    proven: wall from floor to ceiling, or around a window. window: of these, what may be a window's. contradicted: rays pass.
    """

    proven: BoolArray
    window: BoolArray
    contradicted: BoolArray


class _Search:
    """Which stretches of candidates are walls."""

    def __init__(
        self,
        known: Walls,
        hang: Walls,
        faces: TracedFaces,
        undersides: FloatArray,
        returns: AllReturns,
        settings: SearchSettings,
    ) -> None:
        """known: the known faces. hang: refused ones that begin above heads. faces: the candidates. undersides: (m, 3) of ducts."""
        self._known, self._faces, self._storey, self._settings = known, faces, returns.storey, settings
        self._fronts = known.append(hang)
        standing = settings.standing
        self._gap = cells_in(settings.building.gap_m)
        self._free = np.isfinite(faces.clear_m) & ~faces.visited(returns.path_map, standing.robot_m)
        self._columns = count_columns(faces, standing.above_door_m, settings.building, settings.columns)
        self._undersides = undersides

    def walls_in(self, w: int) -> Iterator[_Proven]:
        """The stretches of a candidate that are walls."""
        own, settings = self._faces.columns(w), self._settings
        rays, all_counts = self._columns.select(own), self._faces.cells.counts[own]
        states = self._states(w)
        for first, after in self._stretches(states, all_counts):
            stretch = slice(first, after)
            counts, ceiling_m = all_counts[stretch], median_known(self._faces.clear_m[own][stretch])
            face = self._faces.cut([(w, first, after)])
            duct, window = self._duct_before(face, counts), states.window[stretch]
            length_m = (after - first) * CELL_M + _to_corners_m(face, self._known, settings.missed.corner_m)
            if (
                length_m >= settings.building.length_min_m
                and self._is_proven(rays.select(stretch), states.select(stretch), duct is not None)
                # What is but a window between known walls rests on these.
                and (duct is not None or window.all() or self._reaches_ceiling(counts[~window], ceiling_m))
                and room_before(face, self._storey, settings.columns)[0]
                and in_folds(counts.astype(np.float64), settings.folds).mean() <= 0.5
            ):
                yield _Proven(self._as_seen(face, counts, ceiling_m), duct)

    def _as_seen(self, wall: Walls, counts: FloatArray, ceiling_m: float) -> Walls:
        """A single face with what it rests on: the returns in its columns (c, rows, 4), up to the ceiling."""
        returns, total, squares = counts[..., :THROUGH].sum(axis=0, dtype=np.float64).T
        # What is but a window between known walls may have fewer in each row.
        seen = np.flatnonzero(returns >= min(self._settings.standing.stray_rays, returns.max()))
        spread_m2 = squares.sum() / returns.sum() - (total.sum() / returns.sum()) ** 2
        return replace(
            wall,
            bottom_m=np.array([seen[0] * CELL_M]),
            top_m=np.array([min((seen[-1] + 1) * CELL_M, ceiling_m)]),
            rms_m=np.array([np.sqrt(max(spread_m2, 0.0))]),
            sample_count=np.array([returns.sum()], np.int64),
        )

    def _states(self, w: int) -> _ColumnStates:
        """What the columns of a candidate are."""
        own, standing = self._faces.columns(w), self._settings.standing
        columns = self._columns.select(own)
        may_be = self._free[own] & ~_crossed_by(self._known, self._faces.walls, w, own.stop - own.start)
        passed_max, stray = self._settings.missed.passed_max, standing.stray_rays
        on, passed = columns.upper_on + columns.lower_on, columns.upper_passed + columns.lower_passed
        solid = (
            may_be
            & (on > 0)
            & (passed <= passed_max * on)
            & (columns.lower_passed <= passed_max * columns.lower_on + stray)
            & (columns.upper_passed <= 0.5 * columns.upper_on)
        )
        window = may_be & self._between_jambs(w, solid)
        return _ColumnStates(solid | window, window, ~may_be | ((passed > 2 * stray) & ~solid & ~window))

    def _between_jambs(self, w: int, solid: BoolArray) -> BoolArray:
        """(c,) the columns of a candidate that are closed below between stretches of wall in line: its own, or known faces.

        Furniture is not in line with the wall on both its sides, but for a radiator between piers: it has no lintel, and the wall
        close behind it. What hangs in a window, or stands before it, may hide its sill or its lintel. Where the lintel shows, what
        stands before a jamb may hide all but its edge, and between known faces an opening may reach down to the floor.

        solid: (c,) its own columns of wall.
        """
        settings, own = self._settings, self._faces.columns(w)
        candidate, gap = segment(self._faces.walls, w), self._gap
        alike = self._known.ends[self._known.normal @ candidate.normal > SAME_WAY]
        in_line = [ends for ends in alike if np.abs(candidate.before_m(ends)).max() < settings.building.in_line_m]
        known = [np.sort(candidate.place_m(ends)) / CELL_M for ends in in_line]
        known_before = any(low < 0 and abs(high) <= gap for low, high in known)
        known_behind = any(high > len(solid) and abs(low - len(solid)) <= gap for low, high in known)
        columns = self._columns.select(own)
        sill, opened = self._shows_sill(self._faces.cells.counts[own])
        crown = columns.crown_on > columns.crown_passed
        shown = sill | crown
        met = columns.upper_on + columns.lower_on + columns.upper_passed + columns.lower_passed
        jamb, edge = (
            long_runs(flags, cells_in(settings.missed.jamb_m), 0)
            for flags in (solid, solid | (met <= settings.standing.stray_rays))
        )
        between = np.zeros(len(solid), bool)
        for first, after in runs(~solid):
            part = slice(first, after)
            has_lintel = np.mean(crown[part]) > _LINTEL_MIN
            beside = edge if has_lintel else jamb
            has_jambs = (beside[first - 1] if first > 0 else known_before) and (
                beside[after] if after < len(solid) else known_behind
            )
            is_wide = after - first >= cells_in(settings.missed.window_min_m)
            is_door = long_runs(opened[part], cells_in(settings.building.door_width_min_m), bridge=2).any()
            has_sill = sill[part].any() and np.mean(shown[part]) > 0.5
            spans = has_lintel and after - first == len(solid)
            between[part] = has_jambs and is_wide and (spans or (has_sill and not is_door))
        places = candidate.at((np.arange(len(solid)) + 0.5) * CELL_M)
        before_wall = _near_a_face(places, candidate.normal, self._known, 0.0, settings.missed.furniture_depth_m)
        return between & (crown | ~before_wall)

    def _shows_sill(self, counts: FloatArray) -> tuple[BoolArray, BoolArray]:
        """(c,) each: at which columns (c, rows, 4) rays end on the lowest that is seen of them below sills, and where they pass."""
        missed, stray = self._settings.missed, self._settings.standing.stray_rays
        low = slice(FOOT_ROW, cells_in(self._settings.building.knee_m))
        on, passed = on_and_passed(with_neighbours(counts[:, low].astype(np.float64)))
        seen = on + passed > 0
        lowest = seen & (seen.cumsum(axis=1) <= cells_in(missed.sill_m))
        on, passed = (on * lowest).sum(axis=1), (passed * lowest).sum(axis=1)
        opened = passed > missed.passed_max * on + stray
        return (on > 0) & ~opened, opened

    def _stretches(self, states: _ColumnStates, counts: FloatArray) -> Iterator[tuple[int, int]]:
        """First column, and the one after the last, of what may be one wall; counts: (c, rows, 4)."""
        returned = np.any(counts[..., FILLED] > 0, axis=1)
        on, passed = (rays.sum(axis=1) for rays in on_and_passed(counts))
        for first, after in runs(long_runs(states.proven, 1, bridge=self._gap) & ~states.contradicted):
            # Columns are counted with those beside them: a column without returns is too much, a pillar's outer ones lack.
            own = np.flatnonzero(returned[first:after])
            if len(own):
                begin, last = widened(on > passed, first + int(own[0]), first + int(own[-1]), 1)
                yield begin, last + 1

    def _is_proven(self, columns: Columns, states: _ColumnStates, below_duct: bool) -> bool:
        """Whether most columns of a stretch are proven, by enough returns, and seen above doors unless a duct hides them."""
        # Each return is counted in its column and in the two beside it.
        returns = float((columns.upper_on + columns.lower_on).sum()) / 3
        seen_above, proven = np.mean((columns.upper_on > 0) | states.window), np.mean(states.proven)
        enough = returns >= self._settings.missed.returns_min
        return bool((seen_above > 0.5 or below_duct) and proven > 0.5 and enough)

    def _reaches_ceiling(self, counts: FloatArray, ceiling_m: float) -> bool:
        """Whether a stretch of a candidate is wall all the way up. counts: (c, rows, 4) of its columns that are no window's."""
        missed = self._settings.missed
        on_cells, passed_cells = cells_on_and_passed(counts, ceiling_m)
        on, passed = on_cells.sum(axis=0), passed_cells.sum(axis=0)
        seen = np.flatnonzero(on >= self._settings.standing.stray_rays)
        highest_m = min(ceiling_m - missed.below_ceiling_m, missed.above_heads_m)
        if not len(seen) or (FOOT_ROW + seen[-1] + 1) * CELL_M <= highest_m:
            return False
        # Rays pass between a shelf and the duct above it over all their width, however much of the height is theirs.
        slits = long_runs(np.mean(passed_cells > on_cells, axis=0) > 0.5, cells_in(missed.slit_m), 0)
        return bool(np.count_nonzero(on > passed) > np.count_nonzero(passed > on) and not slits.any())

    def _duct_before(self, face: Walls, counts: FloatArray) -> _Duct | None:
        """The face that hangs before a stretch as the front of a duct or a soffit; None where none does.

        A duct's underside joins the one to the other, as high as the wall was seen. A lintel is no deeper than a wall; or in a
        thick one, where a leaf may hang that deep, it is no wider than a door, and the wall goes on at both its ends.

        face: of one stretch. counts: (c, rows, 4) of its columns.
        """
        missed, building, noise_m = self._settings.missed, self._settings.building, self._settings.missed.noise_m
        wall = next(segments(face))
        on, passed = rows_on_and_passed(counts, building.door_height_min_m)
        if wall.length_m < missed.duct_length_min_m or not np.all(on > passed):
            return None
        seen = np.flatnonzero(counts[..., FILLED].sum(axis=0) >= self._settings.standing.stray_rays)
        if not len(seen):
            return None
        top_m = (seen[-1] + 1) * CELL_M
        undersides = self._undersides[np.abs(self._undersides[:, 2] - top_m) < missed.underside_near_m]
        for w, front in enumerate(segments(self._fronts)):
            depth_m = float(wall.before_m(front.at(np.array([0.5 * front.length_m])))[0])
            is_deep = missed.duct_depth_min_m < depth_m < missed.duct_depth_max_m
            if front.normal @ wall.normal < SAME_WAY or not is_deep:
                continue
            if wall.shared_m(self._fronts.ends[w]) < missed.duct_share_min * wall.length_m:
                continue
            low_m, high_m = np.sort(front.place_m(face.ends[0]))
            goes_on_m = min(low_m, front.length_m - high_m) if w < len(self._known) else 0.0
            if goes_on_m >= building.length_min_m and wall.length_m <= building.door_width_max_m:
                continue
            place_m, before_m = wall.place_m(undersides), wall.before_m(undersides)
            between = (place_m > 0) & (place_m < wall.length_m) & (before_m > noise_m) & (before_m < depth_m)
            cells = np.stack([place_m[between], before_m[between]], axis=1) // _UNDERSIDE_CELL_M
            whole = wall.length_m * (depth_m - noise_m) / _UNDERSIDE_CELL_M**2
            if len(np.unique(cells, axis=0)) >= missed.duct_share_min * whole:
                return _Duct(w, max(float(low_m), 0.0), min(float(high_m), front.length_m))
        return None


def _seen_by_glass(faces: Walls, returns: AllReturns, missed: MissedWallsSettings) -> BoolArray:
    """(W,) which faces hardly a ray shows but those that pass a window, or the wall close beside it, where the pane may go on."""
    if not len(faces) or returns.trace_clear is None:
        return np.zeros(len(faces), bool)
    first = first_columns(faces)[:-1]
    on, on_clear = (
        np.add.reduceat(trace(faces).cells.counts[:, FOOT_ROW:, FILLED].sum(axis=1), first)
        for trace in (returns.trace, returns.trace_clear)
    )
    return np.asarray(on - on_clear > missed.beside_glass_max * on)


def _undersides(returns: AllReturns, height_min_m: float) -> FloatArray:
    """(m, 3) x, y and height above the floor of the cubes that may be of a duct's underside: no wall's, higher than heads."""
    position = returns.votes.mean_position[returns.votes.label != Label.WALL]
    position[:, 2] -= returns.storey.ground_m(position[:, :2])
    return np.asarray(position[position[:, 2] > height_min_m])


def _cut_out(walls: Walls, ducts: list[_Duct], length_min_m: float) -> tuple[Walls, Walls]:
    """The faces without the ducts' stretches, and what was cut out of them.

    A rest that is too short for a face is cut with the stretch beside it.
    """
    with_duct = sorted({duct.face for duct in ducts})
    rest, cut = walls.select(~np.isin(np.arange(len(walls)), with_duct)), NO_WALLS
    for w in with_duct:
        own, face = walls.one(w), segment(walls, w)
        reached_m, cut_from_m = 0.0, 0.0
        taken = sorted((duct.low_m, duct.high_m) for duct in ducts if duct.face == w)
        for low_m, high_m in [*taken, (face.length_m, face.length_m)]:
            if low_m - reached_m >= length_min_m:
                rest = rest.append(_part(own, face, reached_m, low_m))
                if reached_m > cut_from_m:
                    cut = cut.append(_part(own, face, cut_from_m, reached_m))
                cut_from_m = low_m
            reached_m = max(reached_m, high_m)
        if reached_m > cut_from_m:
            cut = cut.append(_part(own, face, cut_from_m, reached_m))
    return rest, cut


def _part(own: Walls, face: Segment, low_m: float, high_m: float) -> Walls:
    """A stretch of a single face."""
    return replace(own, ends=face.at(np.array([low_m, high_m]))[None])


def _to_corners_m(face: Walls, walls: Walls, near_m: float) -> float:
    """Length by which a single face is longer up to known faces that end near its ends: there its returns pass for theirs."""
    ends = walls.ends[np.abs(walls.normal @ face.normal[0]) < ACROSS].reshape(-1, 2)
    if not len(ends):
        return 0.0
    nearest_m = np.linalg.norm(face.ends[0][:, None] - ends, axis=2).min(axis=1)
    return float(nearest_m[nearest_m < near_m].sum())


def _crossed_by(walls: Walls, candidates: Walls, w: int, count: int) -> BoolArray:
    """(count,) the columns of one candidate at which it crosses a known face; beyond it another wall, or a reveal, goes on."""
    crossed = np.zeros(count, bool)
    candidate = segment(candidates, w)
    for face in segments(walls):
        if abs(face.normal @ candidate.normal) > ACROSS:
            continue
        column = int(-face.before_m(candidate.start) / (candidate.along @ face.normal) // CELL_M)
        place = candidate.at(np.array([(column + 0.5) * CELL_M]))
        if 0 <= column < count and face.beside(place)[0]:
            crossed[column] = True
    return crossed


def _near_a_face(
    places: FloatArray, normals: FloatArray, walls: Walls, above_m: float, below_m: float, opposite: bool = False
) -> BoolArray:
    """(k,) whether each place (k, 2) lies between two distances before a known face that looks the same way, or the opposite.

    normals: (k, 2), or (2,) of all, where what is there looks.
    """
    near = np.zeros(len(places), bool)
    for face in segments(walls):
        before_m = face.before_m(places)
        looks = (-normals if opposite else normals) @ face.normal > SAME_WAY
        near |= looks & face.beside(places) & (before_m > above_m) & (before_m < below_m)
    return near


def _chords(returns: AllReturns, walls: Walls, refused: Walls, settings: SearchSettings) -> list[Line]:
    """Stretches of unexplained columns in line, whatever their direction, that are as high as walls."""
    missed, storey = settings.missed, returns.storey
    place, _, top_m = unexplained_columns(returns.votes, walls, refused, missed.explained_m)
    clear_m = storey.clear_m(place, settings.standing.ceiling_near_m)
    is_high = top_m - storey.ground_m(place) > np.fmin(clear_m - missed.below_ceiling_m, missed.above_heads_m)
    return _lines_of_any_direction(place[is_high], missed)


def _lines_of_any_direction(place: FloatArray, settings: MissedWallsSettings) -> list[Line]:
    """Stretches of columns (n, 2) in line, whatever their direction, each column in one: ends (2, 2) and normal (2,)."""
    if not len(place):
        return []
    tree, left = cKDTree(place), np.ones(len(place), bool)
    found: list[Line] = []
    for seed in range(len(place)):
        near = np.array(tree.query_ball_point(place[seed], settings.chord_m)) if left[seed] else np.zeros(0, int)
        near = near[left[near]]
        for _ in range(2):
            # The line of least squares, without what is off it.
            if len(near) < 3:
                break
            middle = place[near].mean(axis=0)
            along = np.linalg.eigh(np.cov((place[near] - middle).T))[1][:, 1]
            normal = np.array([along[1], -along[0]])
            near = near[np.abs((place[near] - middle) @ normal) < 0.5 * settings.half_thickness_m]
        reach = np.sort((place[near] - middle) @ along) if len(near) >= 3 else np.zeros(1)
        if reach[-1] - reach[0] < settings.chord_m or np.diff(reach).max() > 3 * CELL_M:
            continue
        left[near] = False
        found.append((middle + (reach[[0, -1]] + np.array([-0.5, 0.5]) * CELL_M)[:, None] * along, normal))
    return found


def _pillar_sides(
    place: FloatArray, weight: FloatArray, walls: Walls, missed: MissedWallsSettings
) -> list[Line]:
    """The sides between two known faces one before the other, as a pillar has: ends (2, 2) and normal (2,).

    Such a side is short, and most of its returns pass for those of either face.
    """
    found: list[Line] = []
    faces = list(segments(walls))
    for back in faces:
        before_m, place_m = back.before_m(place), back.place_m(place)
        for front in faces:
            depth_m = float(back.before_m(front.at(np.array([0.5 * front.length_m])))[0])
            if front.normal @ back.normal < SAME_WAY or not missed.noise_m < depth_m < missed.furniture_depth_m:
                continue
            for end_m in back.place_m(front.at(np.array([0.0, front.length_m]))):
                near = (before_m > 0) & (before_m < depth_m) & (np.abs(place_m - end_m) < missed.corner_m)
                if not 0 < end_m < back.length_m or not near.any():
                    continue
                off_m = np.abs(place_m[near][:, None] - place_m[near])
                strength = (off_m < missed.half_thickness_m) @ weight[near]
                side = off_m[np.argmax(strength)] < missed.half_thickness_m
                foot = back.at(np.array([np.average(place_m[near][side], weights=weight[near][side])]))[0]
                found.append((np.stack([foot, foot + depth_m * back.normal]), back.along))
    return found
