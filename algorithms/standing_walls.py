"""Which fused faces are walls, and the walls that no single scan could tell: the rays of all scans decide.

A wall stands from the floor to the ceiling, so no ray passes it but through a door or a window. A leaf, a cupboard or a
duct is passed above or below (paper, III.B: the up-most structure is the wall; Nikoohemat et al., 2018: cells that are
filled, empty and occluded).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from algorithms.building import AT_FACE_M, CELL_M, NO_WALLS, Doors, Walls, cells_in, stretches
from algorithms.labels import Label
from algorithms.scan import BoolArray, FloatArray, IntArray, UInt8Array
from algorithms.segments import Segment, segments
from algorithms.semantic_map import VoxelVotes, majority
from algorithms.settings import StepSettings
from algorithms.wall_cells import FILLED, FOOT_ROW, SUM, WallCells
from algorithms.wall_openings import widened

_FOOT_M, _SILL_M, _HIP_M = 0.15, 0.7, 1.8
"""Between foot and hip rays that pass a face prove an opening, or that nothing stands there. No window has a lower sill."""
_CEILING_MARGIN_M = 0.08
"""Rows so close below a ceiling hold its own returns."""
_CROWN_M = 0.2
"""No window reaches so close to where these begin."""
_SMOOTH_COLUMNS = 1
_REST_MIN_M = 0.5
"""What is left of a face beside a leaf or a cupboard is no wall if it is shorter: a reveal, the leaf's hinge."""
_CUT_MIN_M = 0.3
_FRAME_M = 0.6
"""So near to a high window as much of its wall stands on both sides; close to its edges some rays pass."""
_ACROSS = 0.5
"""Cosine of the angle between two faces below which one stands across the other."""
_SAME_WAY = 0.9
"""Cosine of the angle between two faces above which they look the same way."""
_AT_CORNER_M = 0.15
_AT_JAMB_M = 0.15
"""A reveal's face passes its jamb so closely."""
_GOES_ON_SHARE = 0.95
"""A reveal's face goes on as a wall where rays end on so many of the rows beyond."""
_FURNITURE_M = 0.9
"""What stands against a wall is no deeper."""
_NOISE_M, _BEFORE_M = 0.1, 0.5
"""So close to a face are its noise, boards and rails; so far before it a pillar stands."""
_WINDOW_COLUMNS = 60
"""A window is at most so many columns wide."""
_PILLAR_SHARE = 0.8
_JAMB_SHARE = 0.1
"""A lintel's face has wall below it over such a share of its length at least."""
_BELOW_CEILING_M, _ABOVE_HEADS_M = 0.35, 2.25
"""What is seen neither so close below the ceiling nor so far up is a leaf, or the reveal of a window."""
_EXPLAINED_M = 0.08
"""What lies so close to a face, and so far beyond its ends, is its own."""
_RAYS_MIN = 6
"""So many rays below heads tell of a column."""
_SCATTERED_RAYS = 2
_AGREED_VOTES = 3
_ROOM_M, _ROOM_BESIDE_M, _ROOM_CUBES = (0.3, 3.0), 0.5, 10
"""Between these distances before a wall of this building, and so far beside it, so many cubes of floor or ceiling are seen."""
_LEANING_DEG, _LEANING_M, _LEANING_SHARE, _LEANING_SCANS = (4.0, 20.0), 0.1, 0.9, 2.5
"""At such angles to a face that so many times the scans saw, so close to it, and so much of it beside the other, a leaf leans."""
_DIRECTION_SHARE = 0.04
"""A direction that fewer of the walls' metres have is a leaf's."""


class StandingWallsSettings(StepSettings):
    """Telling walls from what only looks like one, and finding those that scans saw too little of."""

    above_door_m: float = Field(
        2.12, gt=0, description="Above so many metres, higher than leaves and cupboards, a wall still stands."
    )
    passed_ratio: float = Field(
        2.0,
        gt=0,
        description="A column is no wall's where so many rays pass below the ceiling for each that ends there.",
    )
    hollow_ratio: float = Field(
        4.0, gt=0, description="A column is open below where so many rays pass for each that ends there."
    )
    opening_max_m: float = Field(
        2.6, gt=0, description="What is open below over a longer stretch than so many metres is a duct, no lintel."
    )
    corner_m: float = Field(
        0.7, ge=0, description="A face is carried on to the corner with another that begins at most so far away."
    )
    scans_few: int = Field(
        10,
        ge=0,
        description="A face that fewer scans saw, and that runs along and across no others, is a thing's.",
    )
    hidden_distance_m: float = Field(0.04, gt=0, description="Half thickness in metres of a hidden wall's returns.")
    hidden_passed_max: float = Field(
        0.2, ge=0, lt=1, description="Share of a hidden wall's rays that may pass it: scatter, and the poses' errors."
    )
    hidden_returns_min: int = Field(20, ge=1, description="Fewest returns that prove a hidden wall.")
    hidden_gap_m: float = Field(0.6, ge=0, description="Longest gap in metres within a hidden wall.")
    robot_m: float = Field(
        0.25,
        ge=0,
        description="No hidden wall stands so near the robot's way, in metres; a lamp above it may hang there.",
    )
    ceiling_near_m: float = Field(2.0, gt=0, description="A wall's ceiling is looked for so many metres around it.")


class FaceVerdict(IntEnum):
    """What the rays of all scans say of a face."""

    STANDS = 0
    """Nothing passes it but through openings: a wall."""
    ENDS_LOW = 1
    """Rays pass above it, below the ceiling: a leaf, a cupboard, a partition."""
    HANGS = 2
    """Rays pass below it over a longer stretch than an opening has, or the robot drove along it: a duct, a beam."""
    ALONE = 3
    """Few scans saw it, and it runs along and across no others: the side of a thing."""
    LEANS = 4
    """It stands close to a longer face that more scans saw, at an angle to it: a leaf that is open against its wall."""
    OUTSIDE = 5
    """Neither floor nor ceiling was seen before it: another house's front, through a window."""


@dataclass(frozen=True)
class JudgedFaces:
    """The faces that stand, and those that do not with the verdict on each."""

    walls: Walls
    refused: Walls
    verdict: UInt8Array

    @property
    def refused_label(self) -> UInt8Array:
        """(R,) what the returns of each refused face are."""
        return np.where(self.verdict == FaceVerdict.OUTSIDE, np.uint8(Label.OUTSIDE), np.uint8(Label.CLUTTER))

    def refuse(self, more: Walls, verdict: FaceVerdict) -> "JudgedFaces":
        """The same with more refused faces."""
        verdicts = np.concatenate([self.verdict, np.full(len(more), verdict, np.uint8)])
        return replace(self, refused=self.refused.append(more), verdict=verdicts)


NO_JUDGED_FACES = JudgedFaces(NO_WALLS, NO_WALLS, np.zeros(0, np.uint8))


def clear_heights(places: FloatArray, votes: VoxelVotes, near_m: float) -> FloatArray:
    """(m,) metres from the floor to the ceiling near each place (m, 2); NaN where no ceiling was seen.

    The higher ones of the nearest cubes of ceiling count, for ducts and lamps hang below it.
    """
    floor, ceiling = _floor_and_ceiling(votes)
    if len(ceiling) < 10 or not len(places):
        return np.full(len(places), np.nan)
    distance, nearest = cKDTree(ceiling[:, :2]).query(places, k=10)
    top = np.percentile(ceiling[nearest, 2], 80, axis=1)
    ground = np.zeros(len(places))
    if len(floor) >= 5:
        ground = np.median(floor[cKDTree(floor[:, :2]).query(places, k=5)[1], 2], axis=1)
    return np.where(distance[:, 0] < near_m, top - ground, np.nan)


def _floor_and_ceiling(votes: VoxelVotes) -> tuple[FloatArray, FloatArray]:
    """(n, 3), (m, 3) the cubes that scans agree on to be floor, and ceiling."""
    label = np.where(votes.counts.max(axis=1, initial=0) >= _AGREED_VOTES, majority(votes.counts), Label.CLUTTER)
    return votes.mean_position[label == Label.FLOOR], votes.mean_position[label == Label.CEILING]


def column_places(walls: Walls, first: IntArray, before_m: float = 0.2) -> FloatArray:
    """(columns, 2) x and y so many metres before the middle of each column of the faces; first: see `WallCells`."""
    places = np.zeros((int(first[-1]), 2))
    for w, face in enumerate(segments(walls)):
        middles = face.at((np.arange(first[w + 1] - first[w]) + 0.5) * CELL_M)
        places[first[w] : first[w + 1]] = middles + before_m * face.normal
    return places


@dataclass(frozen=True)
class _Columns:
    """Rays on and past each column (c,) of the faces: above doors, close below the ceiling, between foot and hip, below
    windows' sills."""

    upper_on: FloatArray
    upper_passed: FloatArray
    crown_on: FloatArray
    crown_passed: FloatArray
    lower_on: FloatArray
    lower_passed: FloatArray
    sill_on: FloatArray
    sill_passed: FloatArray


def _count_columns(cells: WallCells, clear_m: FloatArray, settings: StandingWallsSettings) -> _Columns:
    filled, total, passed = (cells.counts[..., i].astype(np.float64) for i in (0, 1, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        on = np.where(np.abs(total / filled) < AT_FACE_M, filled, 0.0)
    passed = passed + filled - on
    height = (np.arange(cells.rows) + 0.5) * CELL_M
    top = np.where(np.isfinite(clear_m), clear_m, np.inf) - _CEILING_MARGIN_M
    upper = (height > settings.above_door_m) & (height < top[:, None])
    crown = upper & (height > top[:, None] - _CROWN_M)
    lower = (height > _FOOT_M) & (height < _HIP_M)
    sill = (height > _FOOT_M) & (height < _SILL_M)
    return _Columns(
        _smooth((on * upper).sum(axis=1), cells),
        _smooth((passed * upper).sum(axis=1), cells),
        _smooth((on * crown).sum(axis=1), cells),
        _smooth((passed * crown).sum(axis=1), cells),
        _smooth(on[:, lower].sum(axis=1), cells),
        _smooth(passed[:, lower].sum(axis=1), cells),
        _smooth(on[:, sill].sum(axis=1), cells),
        _smooth(passed[:, sill].sum(axis=1), cells),
    )


def _visited(walls: Walls, cells: WallCells, path_map: FloatArray, robot_m: float) -> BoolArray:
    """(columns,) whether the robot drove where each column stands."""
    places = column_places(walls, cells.first, 0.0)
    if not len(places) or not len(path_map):
        return np.zeros(len(places), bool)
    return np.asarray(cKDTree(path_map).query(places)[0] < robot_m)


def _smooth(values: FloatArray, cells: WallCells) -> FloatArray:
    """Each column with those beside it on the same face."""
    smooth = np.zeros_like(values)
    for first, last in zip(cells.first[:-1], cells.first[1:], strict=True):
        if last > first:
            kernel = np.ones(2 * _SMOOTH_COLUMNS + 1)
            smooth[first:last] = np.convolve(values[first:last], kernel)[_SMOOTH_COLUMNS:-_SMOOTH_COLUMNS]
    return smooth


def judge_faces(
    walls: Walls,
    cells: WallCells,
    clear_m: FloatArray,
    path_map: FloatArray,
    length_min_m: float,
    settings: StandingWallsSettings,
) -> JudgedFaces:
    """Keep the stretches of the faces that stand from floor to ceiling, as far as rays tell.

    clear_m: (columns,) from the floor to the ceiling before each column. path_map: (n, 2) the robot's places.
    """
    visited = _visited(walls, cells, path_map, settings.robot_m)
    columns = _count_columns(cells, clear_m, settings)
    ends_low = (columns.upper_passed >= 4) & (columns.upper_passed > settings.passed_ratio * columns.upper_on)
    hollow = (columns.lower_passed >= _RAYS_MIN) & (columns.lower_passed > settings.hollow_ratio * columns.lower_on)
    has_wall_below = (columns.lower_on >= _RAYS_MIN) & (columns.lower_on > columns.lower_passed)
    stands_before = _before_longer(walls)
    kept: list[tuple[int, int, int]] = []
    refused: list[tuple[int, int, int, FaceVerdict]] = []
    for w in range(len(walls)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        count = own.stop - own.start
        hangs = _long_runs(hollow[own], cells_in(settings.opening_max_m), bridge=4)
        low = _long_runs(ends_low[own], min(cells_in(_CUT_MIN_M), max(count // 2, 1)), bridge=2)
        # A lintel has a jamb: what is open below all along is a duct, however short.
        if visited[own].mean() > 0.5 or (hollow[own].mean() > 0.5 and has_wall_below[own].mean() < _JAMB_SHARE):
            hangs[:] = True
        stands = columns.upper_on[own] > columns.upper_passed[own]
        low &= ~_between_walls(low, stands, columns.lower_on[own] > 0)
        # What stands before a wall, and is hidden above by a duct, is no higher than what was seen of it.
        low |= stands_before[w] and columns.upper_on[own].sum() < _RAYS_MIN
        if hangs.any():
            # The rest of a duct, below which little was seen.
            for first, after in _runs(~(hangs | low)):
                part = slice(own.start + first, own.start + after)
                hangs[first:after] = columns.lower_on[part].sum() < max(
                    columns.lower_passed[part].sum(), columns.upper_on[part].sum()
                )
        if low.any():
            for first, after in _runs(~(hangs | low)):
                # Of pillars in line, each is a rest; they show from floor to ceiling.
                inner = slice(own.start + first + 1, own.start + after - 1)
                low[first:after] = (after - first) * CELL_M < _REST_MIN_M and not _goes_on(
                    cells.counts[inner], settings.above_door_m, _median_m(clear_m[inner])
                )
        for first, after in _runs(~(hangs | low)):
            if (after - first) * CELL_M >= length_min_m:
                kept.append((w, first, after))
        for first, after in _runs(hangs | low):
            verdict = FaceVerdict.HANGS if hangs[first:after].mean() > 0.5 else FaceVerdict.ENDS_LOW
            refused.append((w, first, after, verdict))
    return JudgedFaces(
        _cut(walls, cells, kept),
        _cut(walls, cells, [r[:3] for r in refused]),
        np.array([r[3] for r in refused], np.uint8),
    )


def _before_longer(walls: Walls) -> BoolArray:
    """(W,) whether a face stands before a longer one that looks the same way, as near as furniture does."""
    length_m = np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1)
    middle = walls.ends.mean(axis=1)
    before = np.zeros(len(walls), bool)
    for face in segments(walls):
        distance_m = face.before_m(middle)
        near = (distance_m > _NOISE_M) & (distance_m < _FURNITURE_M) & face.beside(middle)
        before |= near & (walls.normal @ face.normal > _SAME_WAY) & (length_m < face.length_m)
    return before


def _between_walls(low: BoolArray, stands: BoolArray, sill: BoolArray) -> BoolArray:
    """The runs of columns that rays pass below the ceiling, yet with wall on both sides and a sill below: high windows."""
    windows = np.zeros(len(low), bool)
    beside, reach = cells_in(_CUT_MIN_M), cells_in(_FRAME_M)
    for first, after in _runs(low):
        before, behind = stands[max(first - reach, 0) : first], stands[after : after + reach]
        framed = min(np.count_nonzero(before), np.count_nonzero(behind)) >= beside
        windows[first:after] = framed and sill[first:after].mean() > 0.5
    return windows


def _cut(walls: Walls, cells: WallCells, stretches: list[tuple[int, int, int]]) -> Walls:
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


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First index, and the one after the last, of the runs of True."""
    return [(first, last + 1) for first, last in stretches(flags, 0)]


def _long_runs(flags: BoolArray, length: int, bridge: int) -> BoolArray:
    """The flags with short gaps closed, and of these the runs of at least so many."""
    long = np.zeros(len(flags), bool)
    for first, last in stretches(flags, bridge):
        long[first : last + 1] = last + 1 - first >= length
    return long


def join_corners(walls: Walls, corner_m: float) -> Walls:
    """Faces carried on to the corners that they make with others, where both end or pass close to it."""
    ends = walls.ends.copy()
    along = walls.ends[:, 1] - walls.ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / np.maximum(length, 1e-9)[:, None]
    for w in range(len(walls)):
        best = np.array([corner_m, corner_m])
        for other in range(len(walls)):
            turn = float(walls.normal[w] @ along[other])
            if abs(turn) < 0.3:
                continue
            t_other = -float((walls.ends[other, 0] - walls.ends[w, 0]) @ walls.normal[w]) / turn
            if not -corner_m < t_other < length[other] + corner_m:
                continue
            corner = walls.ends[other, 0] + t_other * along[other]
            place = float((corner - walls.ends[w, 0]) @ along[w])
            if -best[0] < place < 0:
                best[0], ends[w, 0] = -place, corner
            elif length[w] < place < length[w] + best[1]:
                best[1], ends[w, 1] = place - length[w], corner
    return replace(walls, ends=ends)


@dataclass(frozen=True)
class TrimmedFaces:
    """Faces that end where their wall does, and the leaves that were taken for their continuation.

    cells: of the faces. clear_m: (columns,) from the floor to the ceiling before each of their columns.
    """

    walls: Walls
    cells: WallCells
    clear_m: FloatArray
    leaves: Walls


def trim_at_doorways(walls: Walls, cells: WallCells, doors: Doors, clear_m: FloatArray) -> TrimmedFaces:
    """The faces, those of doors' reveals cut off at their wall's two faces unless they go on up to the ceiling there.

    The leaf of an open door hangs at the end of a reveal, often in line with it, and the scans' planes run from one on to
    the other.

    doors: with their reveals' depth. clear_m: (columns,) from the floor to the ceiling before each column.
    """
    places = column_places(walls, cells.first, 0.0)
    doorways = list(segments(doors))
    kept: list[tuple[int, int, int]] = []
    leaves: list[tuple[int, int, int]] = []
    top_m: list[float] = []
    for w in range(len(walls)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        first, after = 0, own.stop - own.start
        counts, ceiling_m = cells.counts[own], _median_m(clear_m[own])
        for d in np.flatnonzero(np.abs(doors.normal @ walls.normal[w]) < _ACROSS):
            behind_m, place_m = -doorways[d].before_m(places[own]), doorways[d].place_m(places[own])
            to_jamb_m = np.minimum(np.abs(place_m), np.abs(place_m - doorways[d].length_m))
            reveal = np.flatnonzero((behind_m > 0.0) & (behind_m < doors.reveal_m[d]))
            if not len(reveal) or to_jamb_m[reveal].min() > _AT_JAMB_M:
                continue
            # The columns next to the wall's own face catch that face's returns; what is kept counts a little beyond its ends.
            before, beyond = counts[first : reveal[0]], counts[reveal[-1] + 1 : after]
            inner = reveal[1:-1] if len(reveal) > 2 else reveal
            if len(before) and not _goes_on(before[:-1], doors.head_m[d], ceiling_m):
                leaves.append((w, first, int(inner[0])))
                top_m.append(float(doors.head_m[d]))
                first = int(inner[0])
            if len(beyond) and not _goes_on(beyond[1:], doors.head_m[d], ceiling_m):
                leaves.append((w, int(inner[-1]) + 1, after))
                top_m.append(float(doors.head_m[d]))
                after = int(inner[-1]) + 1
        kept.append((w, first, after))
    columns = np.concatenate(
        [np.zeros(0, np.int64), *(cells.first[w] + np.arange(first, after) for w, first, after in kept)]
    )
    starts = np.concatenate([[0], np.cumsum([after - first for _, first, after in kept])]).astype(np.int64)
    return TrimmedFaces(
        _cut(walls, cells, kept),
        replace(cells, first=starts, counts=cells.counts[columns]),
        clear_m[columns],
        replace(_cut(walls, cells, leaves), top_m=np.array(top_m)),
    )


def _median_m(values_m: FloatArray) -> float:
    """The median of those that are known; NaN where none is."""
    known = values_m[np.isfinite(values_m)]
    return float(np.median(known)) if len(known) else float("nan")


def _goes_on(counts: FloatArray, head_m: float, clear_m: float) -> bool:
    """Whether a wall stands in columns (c, rows, 4) from foot to ceiling: a leaf ends below, whatever hangs over it."""
    if not len(counts) or not np.isfinite(clear_m):
        return False
    on, passed = _rows_on_and_passed(counts, clear_m)
    seen = on + passed >= _SCATTERED_RAYS
    above = seen[int(head_m / CELL_M) + 1 - FOOT_ROW :]
    return bool(np.mean(above) > 0.5 and np.mean(on[seen] > passed[seen]) >= _GOES_ON_SHARE) if len(above) else False


def _rows_on_and_passed(counts: FloatArray, clear_m: float) -> tuple[FloatArray, FloatArray]:
    """How many rays ended on columns (c, rows, 4), and how many did not, in each row between foot and ceiling."""
    rows = slice(FOOT_ROW, int((clear_m - _CEILING_MARGIN_M) / CELL_M))
    filled, total, _, through = counts[:, rows].sum(axis=0, dtype=np.float64).T
    on = np.where(np.abs(total) < AT_FACE_M * filled, filled, 0.0)
    return on, through + filled - on


def find_hidden_walls(
    votes: VoxelVotes,
    walls: Walls,
    refused: Walls,
    path_map: FloatArray,
    trace: Callable[[Walls], WallCells],
    length_min_m: float,
    settings: StandingWallsSettings,
) -> Walls:
    """Walls that scans saw too little of for a plane: returns of all scans that stand in line with the building's walls.

    Upright columns of returns that belong to no face are looked through for straight lines in the directions that the
    walls have; a line is a wall where rays end on it up to the ceiling and next to none passes.

    path_map: (n, 2) the robot's places: where it was stands no wall. trace: counts rays against faces; a return more than
    some centimetres behind a face counts as passed, and rays through windows do not count.
    """
    place, weight = _unexplained_columns(votes, walls, refused)
    found = _straight_lines(place, weight, _directions(walls), settings)
    if not found:
        return NO_WALLS
    ends = np.array([e for e, _ in found])
    normal = np.array([n for _, n in found])
    # Which side it is seen from is not known yet: both are tried.
    both = Walls(
        np.concatenate([ends, ends[:, ::-1]]),
        np.concatenate([normal, -normal]),
        np.zeros(2 * len(found)),
        np.full(2 * len(found), 5.0),
        np.ones(2 * len(found), np.int32),
        np.zeros(2 * len(found)),
    )
    both = both.select(~_before_a_face(both, walls, _NOISE_M) & ~_faces_a_face(both, walls, _BEFORE_M))
    before, furniture = (_before_a_face(both, walls, depth_m) for depth_m in (_BEFORE_M, _FURNITURE_M))
    cells = trace(both)
    clear_m = clear_heights(column_places(both, cells.first), votes, settings.ceiling_near_m)
    visited = _visited(both, cells, path_map, settings.robot_m)
    columns = _count_columns(cells, clear_m, settings)
    floor_and_ceiling = np.concatenate(_floor_and_ceiling(votes))
    kept: list[tuple[int, int, int]] = []
    top_m: list[float] = []
    before_m: list[float] = []
    for w in range(len(both)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        on = columns.upper_on[own] + columns.lower_on[own]
        passed = columns.upper_passed[own] + columns.lower_passed[own]
        solid = (
            (on > 0)
            & (passed <= settings.hidden_passed_max * on)
            & (columns.lower_passed[own] <= settings.hidden_passed_max * columns.lower_on[own] + _SCATTERED_RAYS)
        )
        solid &= columns.upper_passed[own] <= 0.5 * columns.upper_on[own]
        sill = columns.sill_passed[own] + _SCATTERED_RAYS < settings.hidden_passed_max * columns.sill_on[own]
        sill &= not furniture[w]
        window = sill & (columns.upper_on[own] > _SCATTERED_RAYS) & (columns.crown_passed[own] <= 0.5 * columns.crown_on[own])
        may_be = np.isfinite(clear_m[own]) & ~visited[own] & ~_crossed_by(walls, both, w, own.stop - own.start)
        proven = (solid | window) & may_be
        contradicted = (passed > 2 * _SCATTERED_RAYS) & ~proven
        bridged = _long_runs(proven, 1, bridge=cells_in(settings.hidden_gap_m)) & ~contradicted & may_be
        returned = np.any(cells.counts[own, :, FILLED] > 0, axis=1)
        for first, after in _runs(bridged):
            # Columns were told with those beside them.
            first, after = first + int(np.argmax(returned[first:after])), after - int(np.argmax(returned[first:after][::-1]))
            part = slice(own.start + first, own.start + after)
            reaches = np.mean(columns.upper_on[part] > 0) > 0.5 and np.mean(proven[first:after]) > 0.5
            ceiling_m = _median_m(clear_m[part])
            on_rows, passed_rows = _rows_on_and_passed(cells.counts[part], ceiling_m)
            # A duct's underside and the ceiling next to it are rows of returns, with nothing between them and the floor.
            solid_rows = np.count_nonzero(on_rows > passed_rows) > np.count_nonzero(passed_rows > on_rows)
            below_sill = slice(0, cells_in(_SILL_M) - FOOT_ROW)
            is_window = np.mean(window[first:after]) > 0.5 and np.all(on_rows[below_sill] >= passed_rows[below_sill])
            reaches &= bool(solid_rows or is_window)
            seen = np.flatnonzero(on_rows >= _SCATTERED_RAYS)
            seen_to_m = (FOOT_ROW + seen[-1] + 1) * CELL_M if len(seen) else 0.0
            reaches &= seen_to_m > min(ceiling_m - _BELOW_CEILING_M, _ABOVE_HEADS_M)
            # A pillar shows from floor to ceiling; what else stands or hangs before a wall does not.
            reaches &= not before[w] or float(np.mean(on_rows > passed_rows)) > _PILLAR_SHARE
            counted = float((columns.upper_on[part] + columns.lower_on[part]).sum()) / (2 * _SMOOTH_COLUMNS + 1)
            face = _cut(both, cells, [(w, first, after)])
            length_m = (after - first) * CELL_M + _to_corners_m(face, walls)
            reaches &= counted >= settings.hidden_returns_min and length_m >= length_min_m
            if reaches and _room_before(face, floor_and_ceiling)[0]:
                # Beside it a window may go on, of which not more than the sill is seen.
                first, last = widened(sill & may_be, first, after - 1, _WINDOW_COLUMNS)
                kept.append((w, first, last + 1))
                top_m.append(ceiling_m)
                before_m.append(_returns_before_m(cells.counts[part]))
    hidden = _cut(both, cells, kept)
    moved = hidden.ends + (np.array(before_m)[:, None] * hidden.normal)[:, None] if kept else hidden.ends
    return replace(hidden, ends=moved, top_m=np.array(top_m))


def _returns_before_m(counts: FloatArray) -> float:
    """Mean distance before a face of the returns that may be its own, of cells (c, rows, 4); 0 where there are none."""
    filled, total = counts[..., FILLED].astype(np.float64), counts[..., SUM].astype(np.float64)
    own = np.abs(total) < AT_FACE_M * filled
    return float(total[own].sum() / filled[own].sum()) if own.any() else 0.0


def _to_corners_m(face: Walls, walls: Walls) -> float:
    """By how much a single face is longer up to known faces that end at its ends: close to these its returns pass for theirs."""
    ends = walls.ends[np.abs(walls.normal @ face.normal[0]) < _ACROSS].reshape(-1, 2)
    if not len(ends):
        return 0.0
    nearest_m = np.linalg.norm(face.ends[0][:, None] - ends, axis=2).min(axis=1)
    return float(nearest_m[nearest_m < _AT_CORNER_M].sum())


def refuse_outside(judged: JudgedFaces, votes: VoxelVotes) -> JudgedFaces:
    """The same without faces that were only seen through windows, whether or not these were told."""
    within = _room_before(judged.walls, np.concatenate(_floor_and_ceiling(votes)))
    return replace(judged, walls=judged.walls.select(within)).refuse(judged.walls.select(~within), FaceVerdict.OUTSIDE)


def _room_before(faces: Walls, floor_and_ceiling: FloatArray) -> BoolArray:
    """(W,) whether floor or ceiling is seen before a face: what is seen through a window, another house's front, has neither.

    floor_and_ceiling: (n, 3) places of both.
    """
    cubes = np.zeros(len(faces), np.int64)
    for w, face in enumerate(segments(faces)):
        before_m = face.before_m(floor_and_ceiling)
        beside = face.beside(floor_and_ceiling, _ROOM_BESIDE_M)
        cubes[w] = np.count_nonzero(beside & (before_m > _ROOM_M[0]) & (before_m < _ROOM_M[1]))
    return np.asarray(cubes >= _ROOM_CUBES)


def _crossed_by(walls: Walls, candidates: Walls, w: int, count: int) -> BoolArray:
    """(count,) the columns of one candidate at which it crosses a known face: beyond it another wall goes on, or a reveal."""
    crossed = np.zeros(count, bool)
    candidate = Segment.between(candidates.ends[w], candidates.normal[w])
    for face in segments(walls):
        if abs(face.normal @ candidate.normal) > _ACROSS:
            continue
        column = int(-face.before_m(candidate.start) / (candidate.along @ face.normal) // CELL_M)
        place = candidate.at(np.array([(column + 0.5) * CELL_M]))
        if 0 <= column < count and face.beside(place)[0]:
            crossed[column] = True
    return crossed


def _before_a_face(candidates: Walls, walls: Walls, before_m: float) -> BoolArray:
    """(k,) whether a known face that looks the same way lies so close behind each candidate, or before it."""
    before = np.zeros(len(candidates), bool)
    middle = candidates.ends.mean(axis=1)
    for face in segments(walls):
        same_way = candidates.normal @ face.normal > _SAME_WAY
        before |= same_way & face.beside(middle) & (np.abs(face.before_m(middle)) < before_m)
    return before


def _faces_a_face(candidates: Walls, walls: Walls, apart_m: float) -> BoolArray:
    """(k,) whether a known face looks at each candidate from so near: nobody sees the one from before the other."""
    faces = np.zeros(len(candidates), bool)
    middle = candidates.ends.mean(axis=1)
    for face in segments(walls):
        distance_m = face.before_m(middle)
        opposite = candidates.normal @ face.normal < -_SAME_WAY
        faces |= opposite & face.beside(middle) & (distance_m > 0) & (distance_m < apart_m)
    return faces


def along_others(walls: Walls) -> BoolArray:
    """(W,) whether a face runs along or across a good part of the building's others."""
    directions = _directions(walls)
    if not len(directions):
        return np.ones(len(walls), bool)
    return np.asarray(np.abs(walls.normal @ directions.T).max(axis=1) > np.cos(np.radians(5.0)))


def leaning_on_others(walls: Walls) -> BoolArray:
    """(W,) whether a face stands close to another, all along, at an angle to it: as a leaf does that is open against its wall.

    Of two such the one that fewer scans saw, by far, leans.
    """
    leans = np.zeros(len(walls), bool)
    for w in range(len(walls)):
        turn = np.degrees(np.arccos(np.clip(walls.normal @ walls.normal[w], -1.0, 1.0)))
        angled = (turn > _LEANING_DEG[0]) & (turn < _LEANING_DEG[1])
        for other in np.flatnonzero(angled & (walls.scan_count > _LEANING_SCANS * walls.scan_count[w])):
            face = Segment.between(walls.ends[other], walls.normal[other])
            all_along = face.shared_m(walls.ends[w]) > _LEANING_SHARE * np.ptp(face.place_m(walls.ends[w]))
            leans[w] |= all_along and abs(face.before_m(walls.ends[w].mean(axis=0))) < _LEANING_M
    return leans


def _directions(walls: Walls) -> FloatArray:
    """(k, 2) the normals that walls have, and those across them; the longest walls' first."""
    length = np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1)
    angle = np.degrees(np.arctan2(walls.normal[:, 1], walls.normal[:, 0])) % 90.0
    left = np.ones(len(walls), bool)
    found: list[float] = []
    while left.any():
        longest = int(np.argmax(np.where(left, length, 0.0)))
        turn = (angle - angle[longest] + 45.0) % 90.0 - 45.0
        same = left & (np.abs(turn) < 2.0)
        if length[same].sum() < _DIRECTION_SHARE * length.sum():
            left &= ~same
            continue
        mean = angle[longest] + float(np.average(turn[same], weights=length[same]))
        found += [mean, mean + 90.0]
        left &= ~same
    radians = np.radians(np.array(found))
    return np.stack([np.cos(radians), np.sin(radians)], axis=1)


def _unexplained_columns(votes: VoxelVotes, walls: Walls, refused: Walls) -> tuple[FloatArray, FloatArray]:
    """Upright columns of cubes that no face explains: x and y (m, 2), and how many cubes stand in each (m,)."""
    label = majority(votes.counts)
    unexplained = ((label == Label.CLUTTER) | (label == Label.WALL)) & (votes.counts.max(axis=1, initial=0) > 0)
    position, count = votes.mean_position[unexplained], votes.point_count[unexplained]
    free = np.ones(len(position), bool)
    for faces in (walls, refused):
        for face in segments(faces):
            free &= ~((np.abs(face.before_m(position)) < _EXPLAINED_M) & face.beside(position, _EXPLAINED_M))
    position, count = position[free], count[free]
    cell = np.floor(position[:, :2] / CELL_M).astype(np.int64)
    _, column = np.unique(cell, axis=0, return_inverse=True)
    column = column.ravel()
    columns = int(column.max(initial=-1)) + 1
    weight = np.bincount(column, count, columns)
    place = np.stack([np.bincount(column, count * position[:, axis], columns) / weight for axis in (0, 1)], axis=1)
    cubes = np.bincount(column, minlength=columns)
    stands = cubes >= 3
    return place[stands], np.minimum(cubes[stands], 20).astype(np.float64)


def _straight_lines(
    place: FloatArray, weight: FloatArray, normals: FloatArray, settings: StandingWallsSettings
) -> list[tuple[FloatArray, FloatArray]]:
    """Stretches of columns in line, the strongest first, each column in one: ends (2, 2) and normal (2,)."""
    bin_m = 0.5 * settings.hidden_distance_m
    left = np.ones(len(place), bool)
    across = [place @ normal for normal in normals]
    along = [place @ np.array([-normal[1], normal[0]]) for normal in normals]
    bins = [np.floor((a - a.min(initial=0.0)) / bin_m).astype(np.int64) for a in across]
    dead = [np.zeros(int(b.max(initial=0)) + 3, bool) for b in bins]
    found: list[tuple[FloatArray, FloatArray]] = []
    while len(normals) and left.any():
        best, direction, at = 0.0, 0, 0
        for d in range(len(normals)):
            strength = np.bincount(bins[d][left], weight[left], len(dead[d]))
            strength = np.where(dead[d], 0.0, np.convolve(strength, np.ones(3), "same"))
            if strength.max() > best:
                best, direction, at = float(strength.max()), d, int(np.argmax(strength))
        if best < 9.0:
            break
        centre = float(across[direction].min(initial=0.0)) + (at + 0.5) * bin_m
        near = np.flatnonzero(left & (np.abs(across[direction] - centre) < settings.hidden_distance_m))
        near = near[np.argsort(along[direction][near])]
        breaks = np.flatnonzero(np.diff(along[direction][near]) > settings.hidden_gap_m) + 1
        parts = [p for p in np.split(near, breaks) if len(p) >= 3 and np.ptp(along[direction][p]) > 3 * CELL_M]
        if not parts:
            dead[direction][at] = True
            continue
        part = max(parts, key=lambda p: float(weight[p].sum()))
        left[part] = False
        normal = normals[direction]
        offset = float(np.average(across[direction][part], weights=weight[part]))
        reach = along[direction][part][[0, -1]] + np.array([-0.5, 0.5]) * CELL_M
        found.append((normal * offset + reach[:, None] * np.array([-normal[1], normal[0]]), normal))
    return found
