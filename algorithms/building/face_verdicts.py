"""Which fused faces are walls: the rays of all scans decide.

A wall stands from the floor to the ceiling, so no ray passes it but through a door or a window. A leaf, a cupboard or a
duct is passed above or below (paper, III.B: the up-most structure is the wall; Nikoohemat et al., 2018: cells that are
filled, empty and occluded).
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.base.segments import Segment, lengths_m, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_columns import (
    Storey,
    above_doors_m,
    column_places,
    count_columns,
    cut_faces,
    long_runs,
    median_m,
    room_before,
    rows_on_and_passed,
    runs,
    visited_columns,
)
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Doors, Walls, cells_in
from ffmap.algorithms.building.ray_evidence import FOOT_ROW, WallCells

_REST_MIN_M = 0.5
"""What is left of a face beside a leaf or a cupboard is no wall if it is shorter: a reveal, the leaf's hinge."""
_CUT_MIN_M = 0.3
_GAP_MIN_M = 0.3
"""No wall is open over so much of its height above doors."""
_FRAME_M = 0.6
"""So near to a high window as much of its wall stands on both sides; close to its edges some rays pass."""
_REACHED_M = 0.1
"""A face that ends so little behind a corner ends there."""
_AT_JAMB_M = 0.15
"""A reveal's face passes its jamb so closely."""
_LEFT_COLUMNS = 2
"""Of a face between two doorways so much is left, for doors count their walls; its last column may be next to nothing."""
_GOES_ON_SHARE = 0.95
"""A reveal's face goes on as a wall where rays end on so many of the rows beyond."""
_JAMB_SHARE = 0.1
"""A lintel's face has wall below it over such a share of its length at least."""
_RAYS_MIN = 6
"""So many rays below heads tell of a column."""
_LEANING_DEG, _LEANING_M, _LEANING_SHARE, _LEANING_SCANS = (4.0, 20.0), 0.1, 0.9, 2.5
"""At such angles to a face that so many times the scans saw, so close to it, and so much of it beside the other, a leaf leans."""
_DIRECTION_SHARE = 0.04
"""A direction that fewer of the walls' metres have is a leaf's."""
_MEETS_MIN = 0.3
"""Sine of the angle between two faces that make a corner, at least."""
ACROSS = 0.5
"""Cosine of the angle between two faces below which one stands across the other."""
SAME_WAY = 0.9
"""Cosine of the angle between two faces above which they look the same way."""
FURNITURE_M = 0.9
"""What stands against a wall is no deeper."""
NOISE_M, BEFORE_M = 0.1, 0.5
"""So close to a face are its noise, boards and rails; so far before it a pillar stands."""
SCATTERED_RAYS = 2


class StandingWallsSettings(StepSettings):
    """Telling walls from what only looks like one, and finding those that scans saw too little of."""

    above_door_m: float = Field(
        2.12,
        gt=0,
        description="Above this many metres, higher than leaves and cupboards, a wall still stands; in lower rooms in "
        "the last 25 cm below the ceiling.",
    )
    passed_ratio: float = Field(
        2.0,
        gt=0,
        description="A column is no wall's where this many rays pass below the ceiling for each that ends there.",
    )
    hollow_ratio: float = Field(
        4.0, gt=0, description="A column is open below where this many rays pass for each that ends there."
    )
    opening_max_m: float = Field(
        2.6, gt=0, description="What is open below over a longer stretch than this many metres is a duct, no lintel."
    )
    corner_m: float = Field(
        0.7, ge=0, description="A face is carried on to the corner with another that begins at most this far away."
    )
    scans_few: int = Field(
        10,
        ge=0,
        description="A face that fewer scans saw, that runs along and across no others, and that does not show from foot to "
        "ceiling, is a thing's.",
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
    ceiling_near_m: float = Field(2.0, gt=0, description="A wall's ceiling is looked for this many metres around it.")


class FaceVerdict(IntEnum):
    """What the rays of all scans say of a face."""

    STANDS = 0
    """Nothing passes it but through openings: a wall."""
    ENDS_LOW = 1
    """Rays pass above it, below the ceiling: a leaf, a cupboard, a partition."""
    HANGS = 2
    """Rays pass below it over a longer stretch than an opening has, or the robot drove along it: a duct, a beam."""
    ALONE = 3
    """Few scans saw it, it runs along and across no others, and does not show up to the ceiling: the side of a thing."""
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
    visited = visited_columns(walls, cells, path_map, settings.robot_m)
    columns = count_columns(cells, clear_m, settings.above_door_m)
    ends_low = (columns.upper_passed >= 4) & (columns.upper_passed > settings.passed_ratio * columns.upper_on)
    # Something may hang above it.
    ends_low |= columns.upper_open_rows >= cells_in(_GAP_MIN_M)
    hollow = (columns.lower_passed >= _RAYS_MIN) & (columns.lower_passed > settings.hollow_ratio * columns.lower_on)
    # In low rooms doorways reach up to where walls are judged; what ends low stands below.
    ends_low &= ~(hollow & (above_doors_m(clear_m, settings.above_door_m) < settings.above_door_m))
    has_wall_below = (columns.lower_on >= _RAYS_MIN) & (columns.lower_on > columns.lower_passed)
    stands_before = _before_longer(walls)
    kept: list[tuple[int, int, int]] = []
    refused: list[tuple[int, int, int, FaceVerdict]] = []
    for w in range(len(walls)):
        own = slice(int(cells.first[w]), int(cells.first[w + 1]))
        count = own.stop - own.start
        hangs = long_runs(hollow[own], cells_in(settings.opening_max_m), bridge=4)
        low = long_runs(ends_low[own], min(cells_in(_CUT_MIN_M), max(count // 2, 1)), bridge=2)
        # A lintel has a jamb: what is open below all along is a duct, however short.
        if visited[own].mean() > 0.5 or (hollow[own].mean() > 0.5 and has_wall_below[own].mean() < _JAMB_SHARE):
            hangs[:] = True
        stands = columns.upper_on[own] > columns.upper_passed[own]
        low &= ~_between_walls(low, stands, columns.lower_on[own] > 0)
        # What stands before a wall, and is hidden above by a duct, is no higher than what was seen of it.
        low |= stands_before[w] and columns.upper_on[own].sum() < _RAYS_MIN
        if hangs.any():
            # The rest of a duct, below which little was seen; beside a gate the wall stands down to the floor.
            for first, after in runs(~(hangs | low)):
                part = slice(own.start + first, own.start + after)
                little = columns.lower_on[part].sum() < max(
                    columns.lower_passed[part].sum(), columns.upper_on[part].sum()
                )
                hangs[first:after] = little and not _shows_whole(
                    cells.counts[part], clear_m[part], settings.above_door_m
                )
        if low.any():
            for first, after in runs(~(hangs | low)):
                # Of pillars in line, each is a rest; they show from floor to ceiling.
                inner = slice(own.start + first + 1, own.start + after - 1)
                low[first:after] = (after - first) * CELL_M < _REST_MIN_M and not _shows_whole(
                    cells.counts[inner], clear_m[inner], settings.above_door_m
                )
        for first, after in runs(~(hangs | low)):
            if (after - first) * CELL_M >= length_min_m:
                kept.append((w, first, after))
        for first, after in runs(hangs | low):
            verdict = FaceVerdict.HANGS if hangs[first:after].mean() > 0.5 else FaceVerdict.ENDS_LOW
            refused.append((w, first, after, verdict))
    return JudgedFaces(
        cut_faces(walls, cells, kept),
        cut_faces(walls, cells, [r[:3] for r in refused]),
        np.array([r[3] for r in refused], np.uint8),
    )


def _before_longer(walls: Walls) -> BoolArray:
    """(W,) whether a face stands before a longer one that looks the same way, as near as furniture does."""
    length_m = lengths_m(walls.ends)
    middle = walls.ends.mean(axis=1)
    before = np.zeros(len(walls), bool)
    for face in segments(walls):
        distance_m = face.before_m(middle)
        near = (distance_m > NOISE_M) & (distance_m < FURNITURE_M) & face.beside(middle)
        before |= near & (walls.normal @ face.normal > SAME_WAY) & (length_m < face.length_m)
    return before


def _between_walls(low: BoolArray, stands: BoolArray, sill: BoolArray) -> BoolArray:
    """The runs of columns that rays pass below the ceiling, yet with wall on both sides and a sill below: high windows."""
    windows = np.zeros(len(low), bool)
    beside, reach = cells_in(_CUT_MIN_M), cells_in(_FRAME_M)
    for first, after in runs(low):
        before, behind = stands[max(first - reach, 0) : first], stands[after : after + reach]
        framed = min(np.count_nonzero(before), np.count_nonzero(behind)) >= beside
        windows[first:after] = framed and sill[first:after].mean() > 0.5
    return windows


def shows_whole(cells: WallCells, clear_m: FloatArray, above_door_m: float) -> BoolArray:
    """(W,) which faces rays end on from the foot to the ceiling, as on a round column's facets, however few scans saw them.

    clear_m: (columns,) from the floor to the ceiling before each column.
    """
    parts = [slice(int(a), int(b)) for a, b in zip(cells.first[:-1], cells.first[1:], strict=True)]
    return np.array([_shows_whole(cells.counts[p], clear_m[p], above_door_m) for p in parts], bool)


def _shows_whole(counts: FloatArray, clear_m: FloatArray, above_door_m: float) -> bool:
    """Whether rays end on columns (c, rows, 4) from the foot to the ceiling, so high (c,) above it."""
    ceiling_m = median_m(clear_m)
    return _goes_on(counts, float(above_doors_m(np.array(ceiling_m), above_door_m)), ceiling_m)


def refuse_outside(judged: JudgedFaces, storey: Storey) -> JudgedFaces:
    """The same without faces that were only seen through windows, whether or not these were told."""
    within = room_before(judged.walls, storey)
    return replace(judged, walls=judged.walls.select(within)).refuse(judged.walls.select(~within), FaceVerdict.OUTSIDE)


def join_corners(walls: Walls, corner_m: float) -> Walls:
    """Faces carried on to the corners that they make with others, where both end or pass close to it."""
    ends = walls.ends.copy()
    faces = list(segments(walls))
    for w, face in enumerate(faces):
        best = np.array([corner_m, corner_m])
        for other in faces:
            turn = float(face.normal @ other.along)
            if abs(turn) < _MEETS_MIN:
                continue
            t_other = -float(face.before_m(other.start)) / turn
            if not -corner_m < t_other < other.length_m + corner_m:
                continue
            corner = other.at(np.array([t_other]))[0]
            place = float(face.place_m(corner))
            for end, beyond_m in enumerate((-place, place - face.length_m)):
                if 0 < beyond_m < best[end]:
                    best[end], ends[w, end] = beyond_m, corner
                elif -_REACHED_M < beyond_m <= 0:
                    best[end], ends[w, end] = 0.0, walls.ends[w, end]
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
        counts, ceiling_m = cells.counts[own], median_m(clear_m[own])
        for d in np.flatnonzero(np.abs(doors.normal @ walls.normal[w]) < ACROSS):
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
        first = max(min(first, own.stop - own.start - _LEFT_COLUMNS), 0)
        kept.append((w, first, min(max(after, first + _LEFT_COLUMNS), own.stop - own.start)))
    columns = np.concatenate(
        [np.zeros(0, np.int64), *(cells.first[w] + np.arange(first, after) for w, first, after in kept)]
    )
    starts = np.concatenate([[0], np.cumsum([after - first for _, first, after in kept])]).astype(np.int64)
    return TrimmedFaces(
        cut_faces(walls, cells, kept),
        replace(cells, first=starts, counts=cells.counts[columns]),
        clear_m[columns],
        replace(cut_faces(walls, cells, leaves), top_m=np.array(top_m)),
    )


def _goes_on(counts: FloatArray, head_m: float, clear_m: float) -> bool:
    """Whether a wall stands in columns (c, rows, 4) from foot to ceiling: a leaf ends below, whatever hangs over it."""
    if not len(counts) or not np.isfinite(clear_m):
        return False
    on, passed = rows_on_and_passed(counts, clear_m)
    seen = on + passed >= SCATTERED_RAYS
    above = seen[max(int(head_m / CELL_M) + 1 - FOOT_ROW, 0) :]
    return bool(np.mean(above) > 0.5 and np.mean(on[seen] > passed[seen]) >= _GOES_ON_SHARE) if len(above) else False


def along_others(walls: Walls) -> BoolArray:
    """(W,) whether a face runs along or across a good part of the building's others."""
    directions = wall_directions(walls)
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


def wall_directions(walls: Walls) -> FloatArray:
    """(k, 2) the normals that walls have, and those across them; the longest walls' first."""
    length = lengths_m(walls.ends)
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
