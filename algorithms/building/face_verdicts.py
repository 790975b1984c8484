"""Which fused faces are walls: the rays of all scans decide.

A wall stands from the floor to the ceiling, so no ray passes it but through a door or a window. A leaf, a cupboard or a
duct is passed above or below (paper, III.B: the up-most structure is the wall; Nikoohemat et al., 2018: cells that are
filled, empty and occluded). Walls that end lower are told by both their sides, see `low_walls`.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import median_known
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m, segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import WallCells
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import (
    Columns,
    FaceColumnsSettings,
    Storey,
    TracedFaces,
    above_doors_m,
    cells_on_and_passed,
    column_places,
    count_columns,
    long_runs,
    room_before,
    runs,
)
from ffmap.algorithms.building.folds import FoldsSettings, in_folds
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    NO_WALLS,
    Doors,
    Rows,
    Walls,
    cells_in,
    stretches,
)
from ffmap.algorithms.building.openings import OpeningRules, is_pane

ACROSS = 0.5
"""Cosine of the angle between two faces below which one stands across the other."""
SAME_WAY = 0.9
"""Cosine of the angle between two faces above which they look the same way."""
_CORNER_SINE_MIN = 0.3
"""Minimum sine of the angle between two faces that make a corner."""
_KEPT_COLUMNS = 2
"""Columns that are kept of a face between two doorways, for doors count their walls; its last one may be next to nothing."""


class StandingWallsSettings(StepSettings):
    """Telling walls from what only looks like one."""

    above_door_m: float = Field(
        2.15,
        gt=0,
        description="Height above the floor (m), over standard leaves (84 in; DIN 18101: 2.11 m) and cupboards, above which a wall "
        "still stands; in lower rooms the last 25 cm below the ceiling.",
    )
    passed_ratio: float = Field(
        2.0,
        gt=0,
        description="A column is no wall's if more rays than this pass below the ceiling for each that ends there.",
    )
    hollow_ratio: float = Field(
        4.0, gt=0, description="Minimum rays that pass a column open below for each that ends there."
    )
    open_above_m: float = Field(
        0.3,
        gt=0,
        description="A wall is not open over this much (m) of its height above doors, though it be seen there.",
    )
    window_open_m: float = Field(
        0.2, gt=0, description="Minimum height (m) over which a window between a spandrel and a crown is open below doors' heads."
    )
    jamb_share_min: float = Field(0.1, ge=0, le=1, description="Minimum share of a lintel's face with wall below it.")
    cut_min_m: float = Field(0.3, gt=0, description="Minimum length (m) cut out of a face that rays pass above.")
    rest_min_m: float = Field(
        0.5,
        ge=0,
        description="Minimum length (m) of the wall that is left of a face beside a leaf or a cupboard; shorter, it is a "
        "reveal or the leaf's hinge.",
    )
    window_frame_m: float = Field(
        0.6,
        ge=0,
        description="Distance (m) on both sides of a high window within which its wall shows; some rays pass its edges.",
    )
    corner_m: float = Field(0.7, ge=0, description="Maximum distance (m) that a face is extended to a corner.")
    corner_reached_m: float = Field(
        0.1, ge=0, description="A face that ends up to this (m) behind a corner ends there."
    )
    scans_few: int = Field(
        10,
        ge=0,
        description="A face that fewer scans saw, that runs along and across no others, and that does not show from foot to "
        "ceiling, is no wall's.",
    )
    direction_share_min: float = Field(
        0.04,
        ge=0,
        le=1,
        description="Minimum share of the faces' total length that makes a direction one of the walls'.",
    )
    leaning_angle_min_deg: float = Field(
        4.0, ge=0, description="Minimum angle (degrees) between a wall and a leaning leaf."
    )
    leaning_angle_max_deg: float = Field(
        20.0, gt=0, description="Maximum angle (degrees) between a wall and a leaning leaf."
    )
    leaning_distance_m: float = Field(
        0.1, gt=0, description="Maximum distance (m) between a wall and the middle of a leaf that leans on it."
    )
    leaning_share_min: float = Field(0.9, ge=0, le=1, description="Minimum share of a leaning leaf beside its wall.")
    leaning_scans_ratio: float = Field(
        2.5, gt=0, description="A wall is seen by more scans than this for each that sees the leaf that leans on it."
    )
    jamb_m: float = Field(0.15, gt=0, description="Maximum distance (m) between a jamb and its reveal's face.")
    reveal_goes_on_share: float = Field(
        0.95,
        gt=0,
        le=1,
        description="A reveal's face goes on as a wall if rays end on this share of the rows beyond it.",
    )
    stray_rays: int = Field(2, ge=1, description="Fewer rays than this in a row or column may be stray.")
    robot_m: float = Field(
        0.1, ge=0, description="Minimum distance (m) of a wall from where the robot drove: half as wide as any robot is."
    )
    ceiling_near_m: float = Field(2.0, gt=0, description="Maximum horizontal distance (m) of a wall's ceiling.")


class FaceVerdict(IntEnum):
    """What the rays of all scans say of a face."""

    STANDS = 0
    """Nothing passes it but through openings: a wall."""
    ENDS_LOW = 1
    """Rays pass above it, below the ceiling: a leaf, a cupboard, a partition."""
    HANGS = 2
    """Rays pass below it over a longer stretch than an opening has, or the robot drove along it: a duct, a beam."""
    ALONE = 3
    """Few scans saw it, it runs along and across no others, and does not show up to the ceiling: a side of furniture."""
    LEANS = 4
    """It crosses a face that far more scans saw, at a small angle: a leaf that is open against its wall, or a plane fitted askew to
    the wall and what stands before it."""
    OUTSIDE = 5
    """Neither floor nor ceiling was seen before it: another house's front, through a window."""
    MIRRORED = 6
    """Hardly a ray shows it that does not pass a window, or the wall close beside one: what the pane mirrors of another wall."""
    FOLDED = 7
    """It hangs in folds, before and behind its plane by turns: a curtain."""


@dataclass(frozen=True)
class JudgedFaces:
    """The faces that stand, and those that do not with the verdict on each."""

    walls: Walls
    refused: Walls
    verdict: UInt8Array

    @property
    def refused_label(self) -> UInt8Array:
        """(R,) what the returns of each refused face are."""
        return _REFUSED_LABELS[self.verdict]

    def refuse(self, more: Walls, verdict: FaceVerdict) -> "JudgedFaces":
        """The same with more refused faces."""
        verdicts = np.concatenate([self.verdict, np.full(len(more), verdict, np.uint8)])
        return replace(self, refused=self.refused.append(more), verdict=verdicts)


_REFUSED_LABELS = np.full(len(FaceVerdict), Label.CLUTTER, np.uint8)
_REFUSED_LABELS[[FaceVerdict.OUTSIDE, FaceVerdict.MIRRORED]] = Label.OUTSIDE

NO_JUDGED_FACES = JudgedFaces(NO_WALLS, NO_WALLS, np.zeros(0, np.uint8))


@dataclass(frozen=True)
class _ColumnFlags(Rows):
    """What the columns (c,) of faces show.

    ends_low: rays pass above doors. hollow: rays pass below. has_foot: rays end below. visited: the robot drove there.
    """

    ends_low: BoolArray
    hollow: BoolArray
    has_foot: BoolArray
    visited: BoolArray

    @classmethod
    def of(
        cls, faces: TracedFaces, columns: Columns, path_map: FloatArray, rays_min: int, settings: StandingWallsSettings
    ) -> "_ColumnFlags":
        upper_passed, lower_on, lower_passed = columns.upper_passed, columns.lower_on, columns.lower_passed
        has_foot = (lower_on >= rays_min) & (lower_on > lower_passed)
        # What stands, and no wall does, leaves a gap below the ceiling, be it a small part of what is seen above doors.
        ends_low = columns.open_top & has_foot
        ends_low |= (upper_passed >= 4) & (upper_passed > settings.passed_ratio * columns.upper_on)
        # Something may hang above it.
        ends_low |= columns.upper_open_rows >= cells_in(settings.open_above_m)
        hollow = (lower_passed >= rays_min) & (lower_passed > settings.hollow_ratio * lower_on)
        # In low rooms doorways reach up to where walls are judged; what ends low stands below.
        ends_low &= ~(hollow & (above_doors_m(faces.clear_m, settings.above_door_m) < settings.above_door_m))
        return cls(ends_low, hollow, has_foot, faces.visited(path_map, settings.robot_m))


def judge_faces(
    faces: TracedFaces,
    path_map: FloatArray,
    rules: OpeningRules,
    column_settings: FaceColumnsSettings,
    settings: StandingWallsSettings,
    folds: FoldsSettings,
) -> JudgedFaces:
    """Keep the stretches of the faces that stand from floor to ceiling, as far as rays tell.

    path_map: (n, 2) the robot's places.
    """
    building = rules.building
    columns = count_columns(faces, settings.above_door_m, building, column_settings)
    flags = _ColumnFlags.of(faces, columns, path_map, building.rays_min, settings)
    kept: list[tuple[int, int, int]] = []
    refused: list[tuple[int, int, int, FaceVerdict]] = []
    for w in range(len(faces)):
        own = faces.columns(w)
        hangs = _hanging(flags.select(own), faces.cells.of(w), rules, settings)
        low = _ending_low(flags.ends_low[own], columns.select(own), settings)
        hangs, low = _with_rests(hangs, low, faces, columns, own.start, settings)
        folded = in_folds(faces.cells.counts[own].astype(np.float64), folds)
        for first, after in runs(~(hangs | low | folded)):
            if (after - first) * CELL_M >= building.length_min_m:
                kept.append((w, first, after))
        for first, after in runs((hangs | low) & ~folded):
            verdict = FaceVerdict.HANGS if hangs[first:after].mean() > 0.5 else FaceVerdict.ENDS_LOW
            refused.append((w, first, after, verdict))
        refused += [(w, first, after, FaceVerdict.FOLDED) for first, after in runs(folded)]
    verdicts = np.array([verdict for *_, verdict in refused], np.uint8)
    return JudgedFaces(faces.cut(kept), faces.cut([r[:3] for r in refused]), verdicts)


def _hanging(flags: _ColumnFlags, cells: WallCells, rules: OpeningRules, settings: StandingWallsSettings) -> BoolArray:
    """(c,) which columns of one face hang: open below over a longer stretch than an opening has, or where the robot drove.

    What holds a pane is open over any length: a glazed wall. cells: of the face alone.
    """
    if flags.visited.mean() > 0.5:
        return np.ones_like(flags.hollow)
    hangs = long_runs(flags.hollow, cells_in(rules.building.door_width_max_m), bridge=4)
    # A lintel has a jamb: what is open below all along is a duct, however short, or a beam with a pillar at its end.
    if flags.hollow.mean() > 0.5 and flags.has_foot.mean() < settings.jamb_share_min:
        hangs |= ~flags.has_foot
    for first, after in runs(hangs):
        hangs[first:after] = not is_pane(cells.counts[first:after], rules)
    return hangs


def _ending_low(ends_low: BoolArray, columns: Columns, settings: StandingWallsSettings) -> BoolArray:
    """(c,) which columns of one face are lower than the ceiling, and no high window of a wall."""
    beside, reach = cells_in(settings.cut_min_m), cells_in(settings.window_frame_m)
    stands, sill = columns.upper_on > columns.upper_passed, columns.lower_on > 0
    # Below a wall's crown rays pass a door or a window, if wall stands beside it; a cupboard below a duct has no jambs.
    topped = columns.crown_on > settings.passed_ratio * columns.crown_passed
    jamb = topped & (columns.upper_open_rows == 0) & (columns.lower_on > columns.lower_passed)
    ends_low = ends_low.copy()
    for first, last in stretches(topped, 2):
        own = slice(first, last + 1)
        ends_low[own] &= ~topped[own] | (np.count_nonzero(jamb[own]) < beside)
    # A spandrel in line with the wall above a window that goes on along the whole face.
    spandrel = columns.sill_on > settings.passed_ratio * columns.sill_passed
    window = columns.lower_open_rows >= cells_in(settings.window_open_m)
    ends_low &= ~(topped & spandrel & window)
    low = long_runs(ends_low, min(beside, max(len(ends_low) // 2, 1)), bridge=2)
    for first, after in runs(low):
        before, behind = stands[max(first - reach, 0) : first], stands[after : after + reach]
        framed = min(np.count_nonzero(before), np.count_nonzero(behind)) >= beside
        low[first:after] = not (framed and sill[first:after].mean() > 0.5)
    return low


def _with_rests(
    hangs: BoolArray, low: BoolArray, faces: TracedFaces, columns: Columns, start: int, settings: StandingWallsSettings
) -> tuple[BoolArray, BoolArray]:
    """What hangs and what ends low (c,), of one face, each with what is left beside it and is no wall by itself.

    start: the face's first column.
    """
    hangs, low = hangs.copy(), low.copy()
    if hangs.any():
        # The rest of a duct, below which little was seen; beside a gate the wall stands down to the floor.
        for first, after in runs(~(hangs | low)):
            part = slice(start + first, start + after)
            rays = columns.select(part)
            is_little = rays.lower_on.sum() < max(rays.lower_passed.sum(), rays.upper_on.sum())
            # In a low room more rays end on a cupboard than on the beam above it.
            is_narrow = after - first < settings.jamb_share_min * len(hangs)
            hangs[first:after] = (is_little or is_narrow) and not _shows_whole(faces, part, settings)
    if low.any():
        for first, after in runs(~(hangs | low)):
            # Of pillars in line, each is a rest; they show from floor to ceiling.
            inner = slice(start + first + 1, start + after - 1)
            short = (after - first) * CELL_M < settings.rest_min_m
            low[first:after] = short and not _shows_whole(faces, inner, settings)
    return hangs, low


def shows_whole(faces: TracedFaces, settings: StandingWallsSettings) -> BoolArray:
    """(W,) which faces rays end on from the foot to the ceiling, as on a round column's facets, however few scans saw them."""
    return np.array([_shows_whole(faces, faces.columns(w), settings) for w in range(len(faces))], bool)


def _shows_whole(faces: TracedFaces, columns: slice, settings: StandingWallsSettings) -> bool:
    """Whether rays end on columns from the foot to the ceiling."""
    ceiling_m = median_known(faces.clear_m[columns])
    return _goes_on(faces.cells.counts[columns], settings.above_door_m, ceiling_m, settings)


def refuse_outside(judged: JudgedFaces, storey: Storey, settings: FaceColumnsSettings) -> JudgedFaces:
    """The same without faces that were only seen through windows, whether or not these were found."""
    within = room_before(judged.walls, storey, settings)
    return replace(judged, walls=judged.walls.select(within)).refuse(judged.walls.select(~within), FaceVerdict.OUTSIDE)


def join_corners(walls: Walls, settings: StandingWallsSettings) -> Walls:
    """Faces extended to the corners that they make with others, where both end or pass close to it."""
    corner_m = settings.corner_m
    ends = walls.ends.copy()
    faces = list(segments(walls))
    for w, face in enumerate(faces):
        best = np.array([corner_m, corner_m])
        for other in faces:
            turn = float(face.normal @ other.along)
            if abs(turn) < _CORNER_SINE_MIN:
                continue
            t_other = -float(face.before_m(other.start)) / turn
            if not -corner_m < t_other < other.length_m + corner_m:
                continue
            corner = other.at(np.array([t_other]))[0]
            place = float(face.place_m(corner))
            for end, beyond_m in enumerate((-place, place - face.length_m)):
                if 0 < beyond_m < best[end]:
                    best[end], ends[w, end] = beyond_m, corner
                elif -settings.corner_reached_m < beyond_m <= 0:
                    best[end], ends[w, end] = 0.0, walls.ends[w, end]
    return replace(walls, ends=ends)


@dataclass(frozen=True)
class TrimmedFaces:
    """Faces that end where their wall does, and the leaves that were taken for their continuation."""

    faces: TracedFaces
    leaves: Walls


def trim_at_doorways(faces: TracedFaces, doors: Doors, settings: StandingWallsSettings) -> TrimmedFaces:
    """The faces, with those of doors' reveals cut off at their wall's two faces unless they go on up to the ceiling there.

    The leaf of an open door hangs at the end of a reveal, often in line with it, and the scans' planes run from one on to
    the other. What passes through a door of the face itself, or below a lintel in it, says nothing against its wall.

    doors: with their reveals' depth.
    """
    places = column_places(faces.walls, faces.cells.first, 0.0)
    kept: list[tuple[int, int, int]] = []
    leaves: list[tuple[int, int, int]] = []
    top_m: list[float] = []
    for w in range(len(faces)):
        own = faces.columns(w)
        ceiling_m, in_door = median_known(faces.clear_m[own]), _columns_of_doors(doors, faces.walls, w, places[own])
        in_opening = in_door | _below_lintel(faces.cells.counts[own], ceiling_m, settings)
        counts = np.where(in_opening[:, None, None], np.float32(0.0), faces.cells.counts[own])
        first, after = 0, len(counts)
        for d in np.flatnonzero(np.abs(doors.normal @ faces.walls.normal[w]) < ACROSS):
            reveal = _reveal_columns(doors, int(d), places[own], settings.jamb_m)
            if not len(reveal):
                continue
            # The columns next to the wall's own face catch that face's returns; what is kept counts a little beyond its ends.
            before, beyond = counts[first : reveal[0]], counts[reveal[-1] + 1 : after]
            inner = reveal[1:-1] if len(reveal) > 2 else reveal
            if len(before) and not _goes_on(before[:-1], doors.head_m[d], ceiling_m, settings):
                leaves.append((w, first, int(inner[0])))
                top_m.append(float(doors.head_m[d]))
                first = int(inner[0])
            if len(beyond) and not _goes_on(beyond[1:], doors.head_m[d], ceiling_m, settings):
                leaves.append((w, int(inner[-1]) + 1, after))
                top_m.append(float(doors.head_m[d]))
                after = int(inner[-1]) + 1
        first = max(min(first, len(counts) - _KEPT_COLUMNS), 0)
        kept.append((w, first, min(max(after, first + _KEPT_COLUMNS), len(counts))))
    return TrimmedFaces(faces.part(kept), replace(faces.cut(leaves), top_m=np.array(top_m)))


def _reveal_columns(doors: Doors, d: int, places: FloatArray, jamb_m: float) -> IntArray:
    """Which columns of a face, with places (c, 2), are the reveal of a door: within its depth, and next to its jamb."""
    doorway = segment(doors, d)
    behind_m, place_m = -doorway.before_m(places), doorway.place_m(places)
    to_jamb_m = np.minimum(np.abs(place_m), np.abs(place_m - doorway.length_m))
    reveal = np.flatnonzero((behind_m > 0.0) & (behind_m < doors.reveal_m[d]))
    return reveal if len(reveal) and to_jamb_m[reveal].min() <= jamb_m else reveal[:0]


def _columns_of_doors(doors: Doors, walls: Walls, w: int, places: FloatArray) -> BoolArray:
    """(c,) which columns of a face, with places (c, 2), are in a door that it has: one that looks its way, or the opposite."""
    within = np.zeros(len(places), bool)
    for d in np.flatnonzero(np.abs(doors.normal @ walls.normal[w]) > SAME_WAY):
        doorway = segment(doors, d)
        depth_m = np.fmax(doors.reveal_m[d], AT_FACE_M)
        before_m = doorway.before_m(places)
        within |= doorway.beside(places, CELL_M) & (before_m < AT_FACE_M) & (before_m > -depth_m - AT_FACE_M)
    return within


def _below_lintel(counts: FloatArray, clear_m: float, settings: StandingWallsSettings) -> BoolArray:
    """(c,) at which columns (c, rows, 4) rays pass below doors' heads and end above; at a leaf they end below and pass above."""
    if not np.isfinite(clear_m):
        return np.zeros(len(counts), bool)
    on, passed = cells_on_and_passed(counts, clear_m)
    head = max(cells_in(float(above_doors_m(np.array(clear_m), settings.above_door_m))) - FOOT_ROW, 0)
    below, above = (on[:, rows].sum(axis=1) - passed[:, rows].sum(axis=1) for rows in (slice(head), slice(head, None)))
    return np.asarray((below < 0.0) & (above > 0.0))


def _goes_on(counts: FloatArray, head_m: float, clear_m: float, settings: StandingWallsSettings) -> bool:
    """Whether a wall stands in columns (c, rows, 4) from foot to ceiling: a leaf ends below, whatever hangs over it."""
    if not len(counts) or not np.isfinite(clear_m):
        return False
    on, passed = cells_on_and_passed(counts, clear_m)
    seen = (on + passed).sum(axis=0) >= settings.stray_rays
    # Cell by cell: on a pier's side, which is met along its edge alone, more rays end than on all of its front.
    stands = 2 * np.count_nonzero(on > passed, axis=0) > np.count_nonzero(on + passed, axis=0)
    # Beside a passage that reaches the ceiling, the last rows tell.
    head_m = float(above_doors_m(np.array(clear_m), head_m))
    above = seen[max(int(head_m / CELL_M) + 1 - FOOT_ROW, 0) :]
    if not len(above):
        return False
    return bool(np.mean(above) > 0.5 and np.mean(stands[seen]) >= settings.reveal_goes_on_share)


def along_others(walls: Walls, settings: StandingWallsSettings) -> BoolArray:
    """(W,) whether a face runs along or across a good part of the building's others."""
    directions = wall_directions(walls, settings.direction_share_min)
    if not len(directions):
        return np.ones(len(walls), bool)
    return np.asarray(np.abs(walls.normal @ directions.T).max(axis=1) > np.cos(np.radians(5.0)))


def leaning_on_others(walls: Walls, settings: StandingWallsSettings) -> BoolArray:
    """(W,) whether a face stands close to another, all along, at an angle to it: as a leaf does that is open against its wall.

    Of two such faces the one that far fewer scans saw leans.
    """
    leans = np.zeros(len(walls), bool)
    for w in range(len(walls)):
        turn_deg = np.degrees(np.arccos(np.clip(walls.normal @ walls.normal[w], -1.0, 1.0)))
        angled = (turn_deg > settings.leaning_angle_min_deg) & (turn_deg < settings.leaning_angle_max_deg)
        angled &= walls.scan_count > settings.leaning_scans_ratio * walls.scan_count[w]
        for other in np.flatnonzero(angled):
            face = segment(walls, other)
            length_m = np.ptp(face.place_m(walls.ends[w]))
            beside = face.shared_m(walls.ends[w]) > settings.leaning_share_min * length_m
            leans[w] |= beside and abs(face.before_m(walls.ends[w].mean(axis=0))) < settings.leaning_distance_m
    return leans


def wall_directions(walls: Walls, share_min: float) -> FloatArray:
    """(k, 2) the normals that walls have, and those across them; the longest walls' first.

    share_min: minimum share of the walls' total length that has a direction.
    """
    length = lengths_m(walls.ends)
    angle = np.degrees(np.arctan2(walls.normal[:, 1], walls.normal[:, 0])) % 90.0
    left = np.ones(len(walls), bool)
    found: list[float] = []
    while left.any():
        longest = int(np.argmax(np.where(left, length, 0.0)))
        turn = (angle - angle[longest] + 45.0) % 90.0 - 45.0
        same = left & (np.abs(turn) < 2.0)
        if length[same].sum() < share_min * length.sum():
            left &= ~same
            continue
        mean = angle[longest] + float(np.average(turn[same], weights=length[same]))
        found += [mean, mean + 90.0]
        left &= ~same
    radians = np.radians(np.array(found))
    return np.stack([np.cos(radians), np.sin(radians)], axis=1)
