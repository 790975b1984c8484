"""What stands of the parsed faces: walls, with their doors and windows, and what is no wall."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import moved
from ffmap.algorithms.building.evidence import BEYOND, FAR, FOOT_ROW, LAYERS_M, ON, RECESS, Evidence
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    Blinds,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
    cells_in,
    one_door,
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
"""Least share of the rays into an opening that end on a leaf; a pane lets more pass."""
_PATCH = 4
"""Edge (cells) of the patches of an opening of which a pane shows in nearly each."""
_PATCH_RAYS_MIN = 15
"""Least rays into a patch for a pane to show: glass returns every tenth, at a slant fewer."""
_PANE_PATCHES_MIN, _PANE_SHARE_MAX = 0.9, 0.5
_FRONT_MIN_M, _FRONT_SHARE, _PURITY_MIN = 0.5, (0.01, 0.25), 0.7
"""Least width (m) of a pane in no wall, share of the rays that it returns (a rack returns more), and
least share of what returns near that it returned."""
_BESIDE, _LOST_MAX = 10, 0.5
"""Columns beside an opening whose wall returns every ray, and the share of these that glass, behind
which nothing returns, returns at most."""
_AJAR_M = 0.1
"""Least distance (m) of a leaf's free edge from its frame for the door to stand open."""
_JAMBS_MIN, _JAMB_COLUMNS = 0.1, 3
"""Least share, and number of columns, of a face that is wall down to the floor: what is open below all along hangs."""


@dataclass(frozen=True)
class ParsedFaces:
    """Faces with what rays found of them, and the stretches (W lists) that they were parsed into."""

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

    def gaps_as_panes(self) -> "ParsedFaces":
        """Take gaps for panes up to the ceiling, as which rays pass them: what they return tells."""
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

    def with_panes_told(self, trace_within: Callable[[Walls], Evidence]) -> "ParsedFaces":
        """Openings down to the floor that no door is as wide as, or as high: panes, or what hangs.

        trace_within: books rays where they ended, see `AllScans`.
        """
        found = [list(stretches) for stretches in self.stretches]
        panes = [
            (w, k) for w, own in enumerate(found) for k, s in enumerate(own) if s.kind == Kind.PANE
        ]
        faces = self.faces.cut([(w, found[w][k].first, found[w][k].after) for w, k in panes])
        sheets = _sheets([found[w][k] for w, k in panes], trace_within(faces))
        for (w, k), sheet in zip(panes, sheets, strict=True):
            if not _is_glass(sheet):
                own = found[w][k]
                top_row = (self.faces.top_m[self.faces.columns(w)][own.columns]).min() / CELL_M
                hangs = own.head < top_row - 2.0 * CEILING_MARGIN_M / CELL_M
                found[w][k] = replace(own, kind=Kind.HANGING if hangs else Kind.GAP)
        return ParsedFaces(self.faces, tuple(found))


def judge(
    parsed: ParsedFaces, doubtful: BoolArray, odds_min: float, settings: BuildingSettings
) -> JudgedFaces:
    """The stretches of faces that stand, with their openings, and those that end low or hang.

    doubtful: (W,) which faces have to show themselves as walls, by odds of `odds_min`.
    """
    faces, kept, refused = parsed.faces, [], []
    for w, stretches in enumerate(parsed.stretches):
        ended = faces.evidence.ended[faces.columns(w)]
        for first, after in standing(stretches, cells_in(settings.gap_m)):
            if (after - first) * CELL_M < settings.length_min_m:
                continue
            own_odds = sum(s.odds for s in stretches if first <= s.first < after)
            if doubtful[w] and own_odds < odds_min:
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
    return JudgedFaces(faces.cut(kept), faces.cut([r[:3] for r in refused]), verdicts)


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


def mostly_stands(parsed: ParsedFaces) -> BoolArray:
    """(W,) which faces are wall with openings, or hidden, over most of their length."""
    found = np.zeros(len(parsed.stretches), bool)
    for w, stretches in enumerate(parsed.stretches):
        columns = [(s.after - s.first, s.kind in (*OF_WALLS, Kind.HIDDEN)) for s in stretches]
        standing_columns = sum(count for count, stands in columns if stands)
        found[w] = 2 * standing_columns > sum(count for count, _ in columns)
    return found


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
    share, near = float(returned.sum() / max(came.sum(), 1.0)), layers[..., :FAR].sum()
    return Sheet(behind_m, share, patches, float(returned.sum() / max(near, 1.0)))


def _by_patch(cells: FloatArray) -> FloatArray:
    """Sums over patches of cells (c, rows); what is left over at the ends is its neighbour's."""
    for axis in (0, 1):
        patches = max(cells.shape[axis] // _PATCH, 1)
        cells = np.add.reduceat(cells, _PATCH * np.arange(patches), axis=axis)
    return cells


@dataclass(frozen=True)
class Openings:
    """Stretches of faces that rays pass or that end behind the face, with what closes them.

    wall: (n,) the face of each. faces: each as a face of its own, evidence: where rays ended there.
    met: for each, (c,) the rays that crossed its columns. returned: (n,) how many rays returned from
    what closes it, or its upper part, for each that the wall beside returned.
    """

    wall: tuple[int, ...]
    stretch: tuple[Stretch, ...]
    met: tuple[FloatArray, ...]
    faces: Walls
    evidence: Evidence
    sheet: tuple[Sheet | None, ...]
    returned: tuple[float, ...]

    def __len__(self) -> int:
        return len(self.wall)


def find_openings(parsed: ParsedFaces, trace_within: Callable[[Walls], Evidence]) -> Openings:
    """All openings of all faces. trace_within: books rays where they ended, see `AllScans`."""
    found = [
        (w, own)
        for w, stretches in enumerate(parsed.stretches)
        for own in stretches
        if own.kind in OPENINGS
    ]
    faces = parsed.faces.cut([(w, own.first, own.after) for w, own in found])
    evidence = trace_within(faces)
    walls, stretches = tuple(w for w, _ in found), tuple(own for _, own in found)
    sheets = _sheets(stretches, evidence)
    met, returned = [], []
    for w, own in found:
        crossed = parsed.faces.evidence.ended[parsed.faces.columns(w), :, ON:].sum(axis=2)
        met.append(crossed[own.columns, own.sill : own.head].sum(axis=1))
        returned.append(_returned(crossed, own))
    return Openings(walls, stretches, tuple(met), faces, evidence, tuple(sheets), tuple(returned))


def _returned(crossed: FloatArray, own: Stretch) -> float:
    """See `Openings`. crossed: (c, rows) rays that crossed each cell of the face."""
    rows = slice(own.blind if own.blind < own.head else own.sill, own.head)
    beside = np.r_[max(own.first - _BESIDE, 0) : own.first, own.after : own.after + _BESIDE]
    wall = crossed[beside[beside < len(crossed)], rows]
    return float(crossed[own.columns, rows].mean() / wall.mean()) if wall.any() else 1.0


def _sheets(stretches: Sequence[Stretch], evidence: Evidence) -> list[Sheet | None]:
    """What closes each of some openings, each a face of its own."""
    sheets = []
    for k, own in enumerate(stretches):
        columns, inner = evidence.columns(k), _within(own)
        sheets.append(find_sheet(evidence.ended[columns][inner], evidence.depth_sum[columns][inner]))
    return sheets


def _within(own: Stretch) -> tuple[slice, slice]:
    """The cells within an opening's sill, jambs and head, where it is as large as that."""
    width = own.after - own.first
    jamb = 2 if width >= 8 else 0
    rows = slice(max(own.sill + 2, FOOT_ROW + 1), max(own.blind - 2, own.sill + 4))
    return slice(jamb, width - jamb), rows


def doors_of(openings: Openings, settings: BuildingSettings) -> Doors:
    """The doors among openings, the surest first; none that a pane closes."""
    found = [
        (own.odds, _door(openings, k, settings))
        for k, own in enumerate(openings.stretch)
        if own.kind in DOORS and not _is_glass(openings.sheet[k])
    ]
    found.sort(key=lambda seen: -seen[0])
    return reduce(Doors.append, (door for _, door in found), NO_DOORS)


def glazed_doors_of(openings: Openings, settings: BuildingSettings) -> Doors:
    """The closed doors whose leaf is a pane: as wide and as high as doors are, down to the floor."""
    found = [
        replace(
            _door(openings, k, settings),
            depth_m=np.array([_pane_m(openings.sheet[k])]),
            state=np.array([DoorState.CLOSED], np.uint8),
            agreement=np.ones(1),
            glazed=np.array([True]),
        )
        for k, own in enumerate(openings.stretch)
        if own.kind in DOORS and _is_glass(openings.sheet[k])
    ]
    return reduce(Doors.append, found, NO_DOORS)


def _door(openings: Openings, k: int, settings: BuildingSettings) -> Doors:
    own, sheet, inner = openings.stretch[k], openings.sheet[k], _within(openings.stretch[k])
    columns = openings.evidence.columns(k)
    ended = openings.evidence.ended[columns]
    depth_sum = openings.evidence.depth_sum[columns]
    rays = openings.met[k]
    lintel = ended[:, own.head :, ON].sum(axis=1) > 0
    is_leaf = sheet is not None and sheet.share >= _LEAF_SHARE_MIN
    ajar = _is_ajar(ended[inner], depth_sum[inner])
    behind_m, share = float("nan"), 1.0 - (sheet.share if sheet is not None else 0.0)
    if sheet is not None and is_leaf and not ajar:
        behind_m, share = sheet.behind_m, sheet.share
    return one_door(
        ends=openings.faces.ends[k],
        normal=openings.faces.normal[k],
        head_m=(own.head - 0.5) * CELL_M,
        depth_m=behind_m,
        state=DoorState.CLOSED if np.isfinite(behind_m) else DoorState.OPEN,
        agreement=share,
        coverage=(rays >= settings.rays_min).mean(),
        lintel=lintel.mean(),
        ajar=ajar,
        ray_count=int(rays.sum()),
        wall=openings.wall[k],
    )


def _is_glass(sheet: Sheet | None) -> bool:
    return sheet is not None and sheet.patches >= _PANE_PATCHES_MIN and sheet.share < _PANE_SHARE_MAX


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


def windows_of(openings: Openings) -> Windows:
    """The windows among openings, and doorways that panes close."""
    glass = [
        (own.kind == Kind.WINDOW or _is_glass(sheet)) and own.blind - own.sill > 1
        for own, sheet in zip(openings.stretch, openings.sheet, strict=True)
    ]
    chosen = np.flatnonzero(glass)
    stretch = [openings.stretch[k] for k in chosen]
    pane_m = [_pane_m(openings.sheet[k]) for k in chosen]
    return Windows(
        ends=openings.faces.ends[chosen],
        normal=openings.faces.normal[chosen],
        bottom_m=np.array([own.sill * CELL_M for own in stretch]),
        top_m=np.array([own.blind * CELL_M for own in stretch]),
        pane_m=np.array(pane_m),
    )


def fronts_of(openings: Openings) -> Windows:
    """The panes among openings of lines that no wall explains, each in its own line."""
    chosen = [
        k
        for k, (own, sheet) in enumerate(zip(openings.stretch, openings.sheet, strict=True))
        if own.width_m >= _FRONT_MIN_M and _is_glass(sheet)
        if sheet is not None and sheet.purity >= _PURITY_MIN
        if _FRONT_SHARE[0] <= sheet.share <= _FRONT_SHARE[1]
    ]
    pane_m = np.array([_pane_m(openings.sheet[k]) for k in chosen])
    ends, normal = openings.faces.ends[chosen], openings.faces.normal[chosen]
    return Windows(
        ends=moved(ends, normal, -pane_m),
        normal=normal,
        bottom_m=np.array([openings.stretch[k].sill * CELL_M for k in chosen]),
        top_m=np.array([openings.stretch[k].head * CELL_M for k in chosen]),
        pane_m=np.zeros(len(chosen)),
    )


def _is_open_as(window: Stretch, other: Stretch) -> bool:
    """Whether a window is open in part, and as high as another."""
    is_open = window.kind == Kind.WINDOW and window.blind - window.sill > 1
    return is_open and abs(window.head - other.head) <= 2 and abs(window.sill - other.sill) <= 2


def blinds_of(openings: Openings) -> Blinds:
    """What hangs in windows and closes them, or their upper part.

    A recess that is closed all over is a niche, but for one beside an open window as high as it.
    """
    windows = list(zip(openings.wall, openings.stretch, strict=True))
    chosen = [
        k
        for k, (w, own) in enumerate(windows)
        if own.kind == Kind.WINDOW and own.blind < own.head
        if openings.returned[k] > _LOST_MAX
        if any(w == other and _is_open_as(s, own) for other, s in windows)
    ]
    behind_m = []
    for k in chosen:
        own, columns = openings.stretch[k], openings.evidence.columns(k)
        near = slice(RECESS, BEYOND - 1)
        rays = openings.evidence.ended[columns, own.blind : own.head, near].sum()
        depth_m = openings.evidence.depth_sum[columns, own.blind : own.head, near].sum()
        behind_m.append(-float(depth_m) / max(float(rays), 1.0))
    stretch = [openings.stretch[k] for k in chosen]
    return Blinds(
        ends=openings.faces.ends[chosen],
        normal=openings.faces.normal[chosen],
        bottom_m=np.array([own.blind * CELL_M for own in stretch]),
        top_m=np.array([own.head * CELL_M for own in stretch]),
        behind_m=np.array(behind_m),
    )


def _pane_m(sheet: Sheet | None) -> float:
    return sheet.behind_m if sheet is not None and _is_glass(sheet) else float("nan")
