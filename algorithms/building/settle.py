"""What stands of the parsed faces: walls, with their doors and windows, and what is no wall."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import moved
from ffmap.algorithms.building.evidence import (
    BEYOND,
    DEEP,
    FAR,
    FOOT_ROW,
    LAYERS_M,
    NEAR,
    ON,
    RECESS,
    Evidence,
)
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WALLS,
    Blinds,
    BuildingSettings,
    Doors,
    Support,
    Walls,
    Windows,
    cells_in,
    one_door,
    unknown_support,
)
from ffmap.algorithms.building.parse import (
    DOORS,
    OF_WALLS,
    OPENINGS,
    Kind,
    ParseSettings,
    Stretch,
    parse_face,
)
from ffmap.algorithms.building.storey import CEILING_MARGIN_M, TracedFaces
from ffmap.algorithms.building.verdicts import FaceVerdict, JudgedFaces
from ffmap.algorithms.scan.doors import DoorState

_SHEET_M = 0.025
"""Half thickness (m) of a sheet: range noise and what a scan's plane is off over a door's width."""
_LEAF_SHARE_MIN = 0.8
"""Least share of the rays into an opening that end on a leaf or a blind; a pane lets more pass."""
_PATCH = 4
"""Edge (cells) of the patches of an opening of which a pane shows in nearly each."""
_PATCH_RAYS_MIN = 15
"""Least rays into a patch for a pane to show: glass returns every tenth, at a slant fewer."""
_PANE_PATCHES_MIN, _PANE_SHARE_MAX, _FROSTED_PURITY_MIN = 0.9, 0.5, 0.9
"""Of a pane: least share of patches that it shows in, and greatest share of the rays that it
returns; a frosted one returns up to `_LEAF_SHARE_MIN`, and at least this share of all that returns
near."""
_FRONT_MIN_M, _FRONT_SHARE, _PURITY_MIN = 0.5, (0.01, 0.25), 0.7
"""Of a pane in no wall: least width (m), share of the rays that it returns (a rack returns more),
and its least share of all that returns near."""
_AJAR_M = 0.1
"""Least distance (m) of a leaf's free edge from its frame for the door to stand open."""
_JAMBS_MIN, _JAMB_COLUMNS = 0.1, 3
"""Least share, and number of columns, of a face that is wall down to the floor: else it hangs."""


Run = tuple[int, int, int]
"""A part of a face: its number, its first column and the one after its last."""


@dataclass(frozen=True)
class ParsedFaces:
    """Faces with what rays found of them, and the stretches (W lists) that they consist of."""

    faces: TracedFaces
    stretches: tuple[list[Stretch], ...]

    @classmethod
    def of(
        cls,
        faces: TracedFaces,
        path_map: FloatArray,
        building: BuildingSettings,
        settings: ParseSettings,
    ) -> "ParsedFaces":
        """Parse all faces. path_map: (n, 2) the robot's places."""
        top = np.maximum((faces.top_m - CEILING_MARGIN_M) / CELL_M, FOOT_ROW).astype(np.int64)
        driven = faces.visited(path_map, building.robot_m)
        found = []
        for w in range(len(faces)):
            own = faces.columns(w)
            evidence = faces.evidence.ended[own], faces.evidence.depth_sum[own]
            found.append(parse_face(*evidence, top[own], driven[own], building, settings))
        return cls(faces, tuple(found))

    @property
    def opening(self) -> BoolArray:
        """(columns, rows) which cells lie within an opening."""
        within = np.zeros(self.faces.evidence.ended.shape[:2], bool)
        for w, stretches in enumerate(self.stretches):
            own = within[self.faces.columns(w)]
            for s in stretches:
                if s.kind in OPENINGS:
                    own[s.columns, s.sill : s.head] = True
        return within

    def cut(self, runs: list[Run]) -> Walls:
        """Runs of columns as faces of their own, with their support."""
        support = [self._support(*run) for run in runs]
        known = reduce(Support.append, support, unknown_support(0))
        return replace(self.faces.cut(runs), support=known)

    def _support(self, w: int, first: int, after: int) -> Support:
        """Of a single stretch, or of a wall with openings: then of what is wall."""
        within = [s for s in self.stretches[w] if first <= s.first < after]
        own = [s for s in within if s.kind == Kind.WALL] or within
        longest = max(own, key=lambda s: s.width_m)
        is_wall = longest.kind == Kind.WALL
        odds = wall_odds(within, first, after) if is_wall else sum(s.odds for s in own)
        columns, rows = self.faces.columns(w), np.arange(self.faces.evidence.rows)
        top = self.faces.top_m[columns, None] / CELL_M
        asked = np.zeros((len(top), len(rows)), bool)
        for s in own:
            low, high = (s.sill, s.head) if s.kind in OPENINGS else (FOOT_ROW, len(rows))
            asked[s.columns] = (rows >= low) & (rows < np.minimum(high, top[s.columns]))
        ended = self.faces.evidence.ended[columns][asked].astype(np.float64)
        rays = ended[:, ON : NEAR + 1].sum(), ended[:, DEEP:].sum()
        seen = (ended > 0.0).any(axis=1).sum() / max(len(ended), 1)
        known = longest.kind, longest.second, odds, w, first, after, *rays, seen
        return Support(*(np.array([value]) for value in known), *np.full((4, 1), np.nan))

    def part(self, runs: list[Run]) -> "ParsedFaces":
        """Runs of stretches of some faces as faces of their own."""
        found = [
            [
                replace(s, first=s.first - first, after=s.after - first)
                for s in self.stretches[w]
                if first <= s.first < after
            ]
            for w, first, after in runs
        ]
        return ParsedFaces(self.faces.part(runs), tuple(found))

    def gaps_as_panes(self) -> "ParsedFaces":
        """Take gaps for panes up to the ceiling: rays pass both, and what returns decides."""
        found = []
        for w, stretches in enumerate(self.stretches):
            top = (self.faces.top_m[self.faces.columns(w)] / CELL_M).astype(np.int64) - 2
            own = []
            for s in stretches:
                if s.kind == Kind.GAP and (head := int(top[s.columns].min())) > FOOT_ROW:
                    own.append(replace(s, kind=Kind.PANE, sill=FOOT_ROW, head=head, blind=head))
                else:
                    own.append(s)
            found.append(own)
        return ParsedFaces(self.faces, tuple(found))

    def with_panes_told(
        self, openings: "Sequence[Opening]", building: BuildingSettings
    ) -> "tuple[ParsedFaces, list[Opening]]":
        """Openings down to the floor that no door is as wide as, or as high.

        They are panes, passages below a lintel with wall on both sides, or what hangs.

        openings: those of these faces.
        """
        found, told = [list(stretches) for stretches in self.stretches], list[Opening]()
        for opening in openings:
            w, own = opening.wall, opening.stretch
            if own.kind == Kind.PANE and not opening.is_glass:
                top_row = (self.faces.top_m[self.faces.columns(w)][own.columns]).min() / CELL_M
                hangs = own.head < top_row - 2.0 * CEILING_MARGIN_M / CELL_M
                k = found[w].index(own)
                beside = [s.kind for s in self.stretches[w][max(k - 1, 0) : k + 2 : 2]]
                kind = Kind.HANGING if hangs else Kind.GAP
                if hangs and beside == [Kind.WALL] * 2 and opening.may_be_passed(building):
                    kind = Kind.PASSAGE
                found[w][k] = replace(own, kind=kind)
                opening = replace(opening, stretch=found[w][k])
            told.append(opening)
        return ParsedFaces(self.faces, tuple(found)), told


def judge(
    parsed: ParsedFaces, doubtful: BoolArray, odds_min: float, settings: BuildingSettings
) -> tuple[JudgedFaces, list[Run]]:
    """The parts of faces that stand, with their openings, and those that end low or hang.

    doubtful: (F,) which of the first F faces have to show themselves as walls, by odds of
    `odds_min`. The others are not judged.
    """
    faces, kept, refused = parsed.faces, list[Run](), []
    for w, stretches in enumerate(parsed.stretches[: len(doubtful)]):
        ended = faces.evidence.ended[faces.columns(w)]
        for first, after in standing(stretches, cells_in(settings.gap_m)):
            if (after - first) * CELL_M < settings.length_min_m:
                continue
            if doubtful[w] and wall_odds(stretches, first, after) < odds_min:
                refused.append((w, first, after, FaceVerdict.ALONE))
            elif has_jambs(stretches, first, after, ended, settings.knee_m):
                kept.append((w, first, after))
            else:
                refused.append((w, first, after, FaceVerdict.HANGS))
        for own in stretches:
            if own.kind == Kind.LOW:
                refused.append((w, own.first, own.after, FaceVerdict.ENDS_LOW))
            elif own.kind == Kind.HANGING:
                refused.append((w, own.first, own.after, FaceVerdict.HANGS))
    verdicts = np.array([verdict for *_, verdict in refused], np.uint8)
    return JudgedFaces(parsed.cut(kept), parsed.cut([r[:3] for r in refused]), verdicts), kept


def standing(stretches: list[Stretch], gap: int) -> Iterator[tuple[int, int]]:
    """First column, and the one after the last, of what is wall with its openings.

    Between two stretches of wall something short may hide what is there.
    """
    first = after = -1
    for k, own in enumerate(stretches):
        stands = own.kind in OF_WALLS
        hidden = own.kind == Kind.HIDDEN and own.after - own.first <= gap and first >= 0
        hidden &= k + 1 < len(stretches) and stretches[k + 1].kind in OF_WALLS
        if stands or hidden:
            first, after = own.first if first < 0 else first, own.after
        elif first >= 0:
            yield first, after
            first = -1
    if first >= 0:
        yield first, after


def wall_odds(stretches: Sequence[Stretch], first: int, after: int) -> float:
    """Odds (nats) of some columns for being wall, with its windows."""
    kinds = Kind.WALL, Kind.WINDOW
    return sum(s.odds for s in stretches if first <= s.first < after and s.kind in kinds)


def mostly_stands(parsed: ParsedFaces, run: Run) -> bool:
    """Whether most of a part of a face is wall with openings, or hidden."""
    w, first, after = run
    columns = sum(
        max(min(s.after, after) - max(s.first, first), 0)
        for s in parsed.stretches[w]
        if s.kind in (*OF_WALLS, Kind.HIDDEN)
    )
    return 2 * columns > after - first


def has_jambs(
    stretches: list[Stretch], first: int, after: int, ended: FloatArray, knee_m: float
) -> bool:
    """Whether enough of some columns of a face is wall that rays end on, down to the floor."""
    # A window's sill is wall down to the floor, too.
    below = {Kind.WALL: slice(None), Kind.WINDOW: slice(FOOT_ROW, cells_in(knee_m))}
    own = [s for s in stretches if first <= s.first < after and s.kind in below]
    on = sum(int((ended[s.columns, below[s.kind], ON].sum(axis=1) > 0).sum()) for s in own)
    return on >= max(_JAMBS_MIN * (after - first), _JAMB_COLUMNS)


@dataclass(frozen=True)
class Sheet:
    """What closes an opening, if anything does: the depth that most of what returns has.

    behind_m: that depth (m). share: of the rays that came in, those that ended there. patches:
    share of an opening's patches, of those that rays met, that returned any from there. purity: of
    the rays that ended within a wall's depth, those that ended there.
    """

    behind_m: float
    share: float
    patches: float
    purity: float


def find_sheet(ended: FloatArray, depth_sum: FloatArray) -> Sheet | None:
    """The sheet within an opening, or right before it, as a sliding leaf; None where none returned.

    ended, depth_sum: (c, rows, …) of its cells without jambs, sill and head, see `Evidence`.
    """
    layers, came = ended[..., :BEYOND].astype(np.float64), ended.sum(axis=-1, dtype=np.float64)
    met = layers > 0
    if not met.any():
        return None
    depth_m = np.where(met, -depth_sum / np.maximum(layers, 1.0), np.nan)
    known, weight = depth_m[met], np.minimum(layers[met], 3.0)
    order = np.argsort(known)
    known, total = known[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    within = total[np.searchsorted(known, known + _SHEET_M, "right")]
    within -= total[np.searchsorted(known, known - _SHEET_M, "left")]
    middle_m = known[np.argmax(within)]
    if middle_m > -LAYERS_M[BEYOND] - 2.0 * _SHEET_M:
        return None  # a wall behind, of which few returns are as near as depths are booked
    on_sheet = met & (np.abs(depth_m - middle_m) <= _SHEET_M)
    returned = (layers * on_sheet).sum(axis=-1)
    behind_m = -float(depth_sum[on_sheet].sum() / layers[on_sheet].sum())
    rays, shown = _by_patch(came), _by_patch(returned)
    asked = rays >= _PATCH_RAYS_MIN
    patches = float((shown[asked] > 0).mean()) if 2 * asked.sum() >= asked.size else 0.0
    share = float(returned.sum() / max(came.sum(), 1.0))
    deepest = int(np.flatnonzero(on_sheet.any(axis=(0, 1)))[-1])
    near = float(layers[..., : max(deepest + 1, FAR)].sum())
    return Sheet(behind_m, share, patches, float(returned.sum()) / near)


def _by_patch(cells: FloatArray) -> FloatArray:
    """Sums over patches of cells (c, rows); what is left over at the ends is its neighbour's."""
    for axis in (0, 1):
        patches = max(cells.shape[axis] // _PATCH, 1)
        cells = np.add.reduceat(cells, _PATCH * np.arange(patches), axis=axis)
    return cells


@dataclass(frozen=True)
class Opening:
    """A stretch of a face that rays pass or that ends behind the face, with what closes it.

    wall: the number of its face. face: it as a face of its own. evidence: where rays ended in it.
    met: (c,) the rays that crossed its columns. blind: the row from which a blind closes it; that
    of its head where none does.
    """

    wall: int
    stretch: Stretch
    face: Walls
    evidence: Evidence
    met: FloatArray
    sheet: Sheet | None
    blind: int

    @property
    def is_glass(self) -> bool:
        """Whether a pane closes it: it returns from all over, but not all rays.

        A frosted one, other than a leaf that stands ajar, returns most of them and nothing else.
        """
        if self.sheet is None or self.sheet.patches < _PANE_PATCHES_MIN:
            return False
        frosted = self.stretch.kind not in DOORS and self.sheet.purity >= _FROSTED_PURITY_MIN
        return self.sheet.share < (_LEAF_SHARE_MIN if frosted else _PANE_SHARE_MAX)

    @property
    def pane_m(self) -> float:
        """How far (m) the pane stands behind the face; NaN without one."""
        return self.sheet.behind_m if self.sheet is not None and self.is_glass else float("nan")

    @property
    def is_closed(self) -> bool:
        """Whether a leaf closes it, or a wall right behind."""
        return self.sheet is not None and self.sheet.share >= _LEAF_SHARE_MIN

    def may_be_passed(self, settings: BuildingSettings) -> bool:
        """Whether it is open, and at least as wide and high as the smallest door."""
        own = self.stretch
        high = own.head * CELL_M >= settings.door_height_min_m
        return high and own.width_m >= settings.door_width_min_m and not self.is_closed

    @property
    def is_open(self) -> bool:
        """Whether no blind closes all of it."""
        return self.blind - self.stretch.sill > 1


def find_openings(parsed: ParsedFaces, trace_within: Callable[[Walls], Evidence]) -> list[Opening]:
    """All openings of all faces. trace_within: books rays where they ended, see `AllScans`."""
    found = [
        (w, own)
        for w, stretches in enumerate(parsed.stretches)
        for own in stretches
        if own.kind in OPENINGS
    ]
    faces = parsed.cut([(w, own.first, own.after) for w, own in found])
    evidence = trace_within(faces)
    openings = []
    for k, (w, own) in enumerate(found):
        ended = parsed.faces.evidence.ended[parsed.faces.columns(w)][own.columns]
        met = ended[:, own.sill : own.head, ON:].sum(axis=(1, 2))
        within, inner = evidence.of(k), _within(own)
        sheet = find_sheet(within.ended[inner], within.depth_sum[inner])
        face = replace(faces.one(k), support=_with_sheet(faces.support.one(k), sheet))
        opening = Opening(w, own, face, within, met, sheet, _blind(own, within))
        openings.append(opening)
    return openings


def _with_sheet(support: Support, sheet: Sheet | None) -> Support:
    """Add what closes a single opening, whose face is numbered by `Opening.wall`."""
    unknown = replace(support, face=np.array([-1]))
    if sheet is None:
        return unknown
    return replace(
        unknown,
        sheet_m=np.array([sheet.behind_m]),
        sheet_share=np.array([sheet.share]),
        sheet_patches=np.array([sheet.patches]),
    )


def _blind(own: Stretch, within: Evidence) -> int:
    """See `Opening`: frames and panes before a dark outside return too, but not all as a sheet."""
    rows = slice(own.blind + 1, own.head - 1)
    sheet = find_sheet(within.ended[:, rows], within.depth_sum[:, rows])
    return own.blind if sheet is not None and sheet.share >= _LEAF_SHARE_MIN else own.head


def openings_in(openings: Sequence[Opening], runs: Sequence[Run]) -> list[Opening]:
    """The openings within parts of faces; each part is a face of its own."""
    return [
        replace(opening, wall=k)
        for k, (w, first, after) in enumerate(runs)
        for opening in openings
        if opening.wall == w and first <= opening.stretch.first < after
    ]


def _within(own: Stretch) -> tuple[slice, slice]:
    """The cells within an opening's sill, jambs and head, where it is as large as that."""
    width = own.after - own.first
    jamb = 2 if width >= 8 else 0
    rows = slice(max(own.sill + 2, FOOT_ROW + 1), max(own.blind - 2, own.sill + 4))
    return slice(jamb, width - jamb), rows


def doors_of(openings: Sequence[Opening], settings: BuildingSettings) -> Doors:
    """The doors and passages among openings, the surest first; none that a pane closes."""
    kinds = *DOORS, Kind.PASSAGE
    found = [own for own in openings if own.stretch.kind in kinds and not own.is_glass]
    found.sort(key=lambda own: -own.stretch.odds)
    return reduce(Doors.append, (_door(own, settings) for own in found), NO_DOORS)


def glazed_doors_of(openings: Sequence[Opening], settings: BuildingSettings) -> Doors:
    """The closed doors whose leaf is a pane: as large as doors are, down to the floor."""
    found = [
        replace(
            _door(own, settings),
            depth_m=np.array([own.pane_m]),
            state=np.array([DoorState.CLOSED], np.uint8),
            agreement=np.ones(1),
            glazed=np.array([True]),
        )
        for own in openings
        if own.stretch.kind in DOORS and own.is_glass
    ]
    return reduce(Doors.append, found, NO_DOORS)


def _door(opening: Opening, settings: BuildingSettings) -> Doors:
    own, sheet, inner = opening.stretch, opening.sheet, _within(opening.stretch)
    ended, rays = opening.evidence.ended, opening.met
    lintel = ended[:, own.head :, ON].sum(axis=1) > 0
    ajar = _is_ajar(ended[inner], opening.evidence.depth_sum[inner])
    behind_m, share = float("nan"), 1.0 - (sheet.share if sheet is not None else 0.0)
    if sheet is not None and opening.is_closed and not ajar:
        behind_m, share = sheet.behind_m, sheet.share
    return one_door(
        ends=opening.face.ends[0],
        normal=opening.face.normal[0],
        head_m=(own.head - 0.5) * CELL_M,
        depth_m=behind_m,
        state=DoorState.CLOSED if np.isfinite(behind_m) else DoorState.OPEN,
        agreement=share,
        coverage=(rays >= settings.rays_min).mean(),
        lintel=lintel.mean(),
        ajar=ajar,
        ray_count=int(rays.sum()),
        wall=opening.wall,
        support=opening.face.support,
    )


def _is_ajar(ended: FloatArray, depth_sum: FloatArray) -> bool:
    """Whether a leaf stands aslant: the median slope of its columns (Theil and Sen)."""
    near = slice(RECESS, BEYOND)
    rays = ended[..., near].sum(axis=(1, 2), dtype=np.float64)
    known = np.flatnonzero(rays > 3)
    if len(known) < 3 or rays.sum() < 0.5 * ended[..., ON:].sum():
        return False
    depth_m = -depth_sum[..., near].sum(axis=(1, 2), dtype=np.float64)[known] / rays[known]
    first, second = np.triu_indices(len(known), 1)
    slope = np.median((depth_m[second] - depth_m[first]) / (known[second] - known[first]))
    return bool(abs(slope) * len(ended) > _AJAR_M)


def windows_of(openings: Sequence[Opening]) -> Windows:
    """The windows among openings, and doorways that panes close."""
    glass = [own for own in openings if own.stretch.kind == Kind.WINDOW or own.is_glass]
    return _windows([own for own in glass if own.is_open])


def _windows(openings: Sequence[Opening]) -> Windows:
    faces = reduce(Walls.append, (own.face for own in openings), NO_WALLS)
    return Windows(
        ends=faces.ends,
        normal=faces.normal,
        bottom_m=np.array([own.stretch.sill * CELL_M for own in openings]),
        top_m=np.array([own.blind * CELL_M for own in openings]),
        pane_m=np.array([own.pane_m for own in openings]),
        support=faces.support,
    )


def fronts_of(openings: Sequence[Opening]) -> Windows:
    """The panes among openings of lines that no wall explains, each in its own line."""
    found = _windows(
        [
            own
            for own in openings
            if own.stretch.width_m >= _FRONT_MIN_M and own.is_glass and own.sheet is not None
            if own.sheet.purity >= _PURITY_MIN
            if _FRONT_SHARE[0] <= own.sheet.share <= _FRONT_SHARE[1]
        ]
    )
    ends = moved(found.ends, found.normal, -found.pane_m)
    return replace(found, ends=ends, pane_m=np.zeros(len(found)))


def _is_beside_open(opening: Opening, openings: Sequence[Opening]) -> bool:
    """Whether a window in the same face is open, and as high."""
    return any(
        other.wall == opening.wall
        and other.stretch.kind == Kind.WINDOW
        and other.is_open
        and abs(other.stretch.head - opening.stretch.head) <= 2
        and abs(other.stretch.sill - opening.stretch.sill) <= 2
        for other in openings
    )


def blinds_of(openings: Sequence[Opening]) -> Blinds:
    """What hangs in windows and closes them, or their upper part.

    A recess that is closed all over is a niche, but for one beside an open window as high as it.
    """
    found = [
        own
        for own in openings
        if own.stretch.kind == Kind.WINDOW and own.blind < own.stretch.head
        if _is_beside_open(own, openings)
    ]
    behind_m = []
    for own in found:
        rows, near = slice(own.blind, own.stretch.head), slice(RECESS, BEYOND - 1)
        rays = own.evidence.ended[:, rows, near].sum()
        depth_m = own.evidence.depth_sum[:, rows, near].sum()
        behind_m.append(-float(depth_m) / max(float(rays), 1.0))
    faces = reduce(Walls.append, (own.face for own in found), NO_WALLS)
    return Blinds(
        ends=faces.ends,
        normal=faces.normal,
        bottom_m=np.array([own.blind * CELL_M for own in found]),
        top_m=np.array([own.stretch.head * CELL_M for own in found]),
        behind_m=np.array(behind_m),
    )
