"""What the columns of a wall's face say of openings in it: doorways, leaves, panes."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import (
    FILLED,
    SUM,
    THROUGH,
    depth_moments,
    mean_before_m,
    returns_at_face,
    with_neighbours,
)
from ffmap.algorithms.building.evidence import BEYOND, FOOT_ROW, LAYERS_M
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    ON_FACE_M,
    BuildingSettings,
    cells_in,
    stretches,
)


class OpeningsSettings(StepSettings):
    """Telling doors and windows from the cells of a wall's face."""

    jamb_m: float = Field(
        0.1,
        ge=0,
        description="Width (m) beside a jamb in which returns may be of its reveal: it tells nothing of panes.",
    )
    sheet_m: float = Field(0.02, gt=0, description="Maximum distance (m) of a pane's returns from the pane.")
    expected_min: float = Field(
        4.0, gt=0, description="A part of an opening tells where a pane would have returned this many of the rays that met it."
    )
    pane_piece_m: float = Field(
        1.5, gt=0, description="Maximum length (m) over which a pane's returns lie on one sheet: farther, its face is off by more."
    )
    below_ceiling_m: float = Field(
        0.1, ge=0, description="Height (m) below the ceiling in which returns may be the ceiling's."
    )
    lintel_m: float = Field(
        0.2, gt=0, description="Minimum height (m) of the wall below a low ceiling that tells of the wall above a door."
    )
    beside_m: float = Field(0.4, gt=0, description="Width (m) beside a door in which its wall has to stand.")
    beside_wall_m: float = Field(0.1, gt=0, description="Minimum width (m) of the wall that is seen there.")
    leaf_max_m: float = Field(
        1.5, ge=0, description="Maximum width (m) that a leaf hides beside the open part of its doorway."
    )
    glazed_m: float = Field(
        0.2, gt=0, description="Maximum distance (m) of an opening from a window's face for it to be the window's."
    )
    lower_rail_max_m: float = Field(0.35, ge=0, description="Maximum height (m) of a glazed leaf's lower rail.")
    bar_max_m: float = Field(
        0.2, ge=0, description="Maximum width (m) of a frame's bars, stiles and rails: where more shows, it is the wall."
    )
    doorway_max_m: float = Field(
        1.0, gt=0, description="Maximum depth (m) of a doorway: a corridor with the walls on its sides is wider."
    )
    overlight_min_m: float = Field(
        0.15, gt=0, description="Minimum height (m) of the pane above a closed door in the recess of both."
    )
    stile_min_m: float = Field(
        0.1, gt=0, description="Minimum width (m) of a leaf on both sides of a vision panel in it: a window's frame is narrower."
    )
    ajar_m: float = Field(
        0.1, gt=0, description="Minimum distance (m) of a leaf's free edge from its frame for the door to stand open."
    )


_PASSED = np.eye(4)[THROUGH]
"""Of a cell's counts, that of the rays that went through."""


@dataclass(frozen=True)
class OpeningRules:
    """By what doors and windows are told."""

    building: BuildingSettings
    openings: OpeningsSettings


@dataclass(frozen=True)
class DoorColumns:
    """What a face's columns (c,) say of doors.

    is_open, is_closed: whether it may be an open door's, a closed one's. has_lintel: whether wall was seen above it; a duct
    before the wall may hide that.
    through: share of the rays below a door's head that went through. rays: (c, 4) counts of those.
    lintel_m: mean distance of the wall above before the face; 0 where it is hidden. depth_m: how far behind that a leaf lies.
    """

    is_open: BoolArray
    is_closed: BoolArray
    has_lintel: BoolArray
    through: FloatArray
    rays: FloatArray
    lintel_m: FloatArray
    depth_m: FloatArray


def look_for_doors(counts: FloatArray, top_m: FloatArray, rules: OpeningRules) -> DoorColumns:
    """Columns with nothing but wall above and, below, either nothing for the rays to hit or a recessed leaf.

    counts: (c, rows, 4), see `WallCells`. top_m: (c,) how high the wall stands at each column: see `tops_m`.
    """
    settings, openings = rules.building, rules.openings
    smooth = with_neighbours(counts)
    low, knee, high = FOOT_ROW, cells_in(settings.knee_m), cells_in(settings.door_height_min_m)
    top = (np.maximum(top_m - openings.below_ceiling_m, 0.0) / CELL_M).astype(np.int64)[:, None]
    row = np.arange(counts.shape[1])
    is_upright = _is_upright(smooth)[..., None]
    head = _head_rows(np.where(is_upright, smooth, smooth * _PASSED), top, rules)
    above = (row >= head) & (row < top)
    above_head = smooth * above[..., None]
    # What hangs behind a lintel is seen below it, and would pull its mean back.
    at_face = above_head * (returns_at_face(above_head) > 0)[..., None]
    lintel, upright = at_face.sum(axis=1), (at_face * is_upright).sum(axis=1)
    passed_above = above_head[..., THROUGH].sum(axis=1)
    overlight, passes = _overlights(smooth, top, rules)
    below, foot = smooth[:, low:high].sum(axis=1), smooth[:, low:knee].sum(axis=1)
    # One up to the ceiling leaves no lintel over a leaf: what its pane returns is none.
    to_ceiling = overlight & (passes & above).any(axis=1) & (below[:, FILLED] > below[:, THROUGH])
    has_lintel = (lintel[:, FILLED] >= 2) & (passed_above <= lintel[:, FILLED]) & ~to_ceiling
    may_have_lintel = has_lintel | (passed_above + above_head[..., FILLED].sum(axis=1) < 2)
    lintel = np.where(upright[:, [FILLED]] >= 2, upright, lintel)
    with np.errstate(invalid="ignore", divide="ignore"):
        lintel_m = np.where(has_lintel, lintel[:, SUM] / lintel[:, FILLED], 0.0)
        through = below[:, THROUGH] / (below[:, THROUGH] + below[:, FILLED])
        foot_through = foot[:, THROUGH] / (foot[:, THROUGH] + foot[:, FILLED])
        cell_m = np.where(smooth[..., FILLED] > 0, -smooth[..., SUM] / np.maximum(smooth[..., FILLED], 1), np.nan)
        # What stands before a leaf hides some of its height.
        depth_m = lintel_m + _quartile(cell_m[:, low:high], 3)
        # Below a knee there may be a low sill, and the pane above it.
        foot_depth_m = lintel_m + _quartile(cell_m[:, low:knee], 1)
    is_met = below[:, THROUGH] + below[:, FILLED] >= settings.rays_min
    may_be = may_have_lintel & is_met
    spread_m = np.sqrt(depth_moments(below)[1])
    is_open = may_be & (through > settings.agreement_min) & ~(foot_through < settings.agreement_min)
    is_closed = (may_be | (to_ceiling & is_met)) & (depth_m > settings.recess_min_m) & (spread_m < 0.06)
    is_closed &= through < 1 - settings.agreement_min
    # What steps forward higher than doors are is a cornice, or a cove, but for an overlight in the recess of its door.
    is_closed &= (head[:, 0] <= cells_in(settings.door_height_max_m + CELL_M)) | overlight
    # A leaf is recessed down to the floor; below a window, or a niche, the wall stands less than half as far back.
    is_parapet = foot_depth_m < 0.5 * depth_m
    for first, last in stretches(is_closed, 2):
        if 2 * np.count_nonzero(is_parapet[first : last + 1]) > last + 1 - first:
            is_closed[first : last + 1] = False
    return DoorColumns(is_open, is_closed, has_lintel, through, below, lintel_m, depth_m)


def _overlights(smooth: FloatArray, top: IntArray, rules: OpeningRules) -> tuple[BoolArray, BoolArray]:
    """In which columns (c,) a pane shows above where doors' heads may be, and the cells (c, rows) there that most rays pass.

    It returns some of the rays in the columns around: above a cupboard, or a board, there is nothing.

    smooth: (c, rows, 4); top: (c, 1) the row of the ceiling.
    """
    settings = rules.building
    row = np.arange(smooth.shape[1])
    passes = (smooth[..., THROUGH] > smooth[..., FILLED]) & (row >= cells_in(settings.door_height_min_m)) & (row < top)
    # In the row in which a cupboard ends some rays pass and others return, too.
    inner = passes & (row > passes.argmax(axis=1)[:, None])
    returned, passed = (smooth[..., [FILLED, THROUGH]] * inner[..., None]).sum(axis=1).T
    shows = passes.sum(axis=1) >= cells_in(rules.openings.overlight_min_m)
    shows &= passes[:, : cells_in(settings.door_height_max_m) + 1].any(axis=1)
    around = 2 * cells_in(0.5 * settings.door_width_min_m) + 1
    returned, met = (ndimage.uniform_filter1d(rays, around, mode="constant") for rays in (returned, passed))
    shows &= (passed >= settings.rays_min) & (returned >= np.maximum(settings.pane_share_min * met, 1.0 / around))
    return shows, passes


def _is_upright(smooth: FloatArray) -> BoolArray:
    """(c, rows) whether what is seen in each cell may be wall or leaf, upright and at one depth but for the noise.

    The underside of what touches the wall, a duct or a soffit, has returns at all depths that a face takes in, and so has a lintel
    whose other side is seen as well from the room behind.
    """
    variance = depth_moments(smooth)[1]
    known = variance[smooth[..., FILLED] >= 4]
    noise = float(np.median(known)) if len(known) else 0.0
    return ~(variance - noise > 0.5 * AT_FACE_M**2 / 12.0)  # half of what returns at all depths have


def _quartile(rows: FloatArray, quartile: int) -> FloatArray:
    """(c,) the first, second or third quartile of the known values of each column (c, rows); NaN where none is known."""
    known = np.isfinite(rows).sum(axis=1)
    place = (quartile * np.maximum(known - 1, 0)) // 4
    values = np.take_along_axis(np.sort(rows, axis=1), place[:, None], axis=1)[:, 0]  # NaN last
    return np.where(known > 0, values, np.nan)


def _head_rows(smooth: FloatArray, top: IntArray, rules: OpeningRules) -> IntArray:
    """(c, 1) the row of each column above which the wall over a door shows: where what is seen steps forward most.

    Below a head rays end on a leaf that is set back, or go through; above it they end on the wall. Where nothing steps forward, or
    the wall above is hidden, the row above every door's head.

    smooth: (c, rows, 4); top: (c, 1) the row of the ceiling.
    """
    settings = rules.building
    first = cells_in(settings.door_height_min_m)
    row = np.arange(smooth.shape[1])
    highest = np.maximum(top - cells_in(rules.openings.lintel_m), 0)
    usual = np.minimum(cells_in(settings.door_height_max_m), highest)
    if smooth.shape[1] <= first + 1:
        return usual
    rays = np.where(row < top, smooth[..., FILLED] + smooth[..., THROUGH], 0.0)[:, first:].astype(np.float64)
    # A ray that went through counts as one that ended as deep as leaves are looked for.
    back_m = np.where(rays > 0, settings.near_m * smooth[:, first:, THROUGH] - smooth[:, first:, SUM], 0.0)
    below, above = rays.cumsum(axis=1)[:, :-1], rays[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        below_m = back_m.cumsum(axis=1)[:, :-1] / below
        above_m = back_m[:, ::-1].cumsum(axis=1)[:, ::-1][:, 1:] / above
        step_m = np.where((below >= 2) & (above >= 2), below_m - above_m, 0.0)
        explained = step_m * np.abs(step_m) * below * above / (below + above)
    explained = np.nan_to_num(explained)
    best = explained.argmax(axis=1)[:, None]
    steps = np.take_along_axis(step_m, best, axis=1) > settings.recess_min_m
    return np.where(steps, first + best + 1, usual)


def is_pane(counts: FloatArray, rules: OpeningRules) -> bool:
    """Whether an opening holds a pane: glass lets most rays through, but those that it returns come from one sheet.

    An open doorway returns nothing, and what stands in it has some depth (Wang and Wang, "Detecting glass in simultaneous
    localisation and mapping", 2017). A wide opening is asked piece by piece: over many metres a face is off its pane's
    direction by more than a sheet is thick.

    counts: (c, rows, 4) of the opening's columns; those at its jambs are not looked at.
    """
    jamb = min(cells_in(rules.openings.jamb_m), (len(counts) - 1) // 2)
    inside = slice(jamb, len(counts) - jamb), slice(FOOT_ROW, cells_in(rules.building.door_height_min_m))
    inner = counts[inside]
    if _holds_pane(inner, rules):
        return True
    pieces = _pieces(len(inner), rules)
    return len(pieces) > 1 and 2 * sum(_holds_pane(inner[piece], rules) for piece in pieces) > len(pieces)


def _pieces(columns: int, rules: OpeningRules) -> list[slice]:
    """Some columns in equal pieces, within each of which a face is in line with its pane."""
    count = max(int(np.ceil(columns * CELL_M / rules.openings.pane_piece_m)), 1)
    edges = np.linspace(0, columns, count + 1).round().astype(int).tolist()
    return [slice(first, after) for first, after in pairwise(edges)]


def _holds_pane(inner: FloatArray, rules: OpeningRules) -> bool:
    """The same of a piece of an opening."""
    filled, passed = inner[..., [FILLED, THROUGH]].sum(axis=(0, 1))
    if filled > rules.building.opaque_min * (filled + passed):
        return False  # A wall behind what hangs before it lies on one sheet too.
    # What stands close behind a pane returns far more than the pane: there, the cells that most rays pass tell.
    for part in (inner, inner * (inner[..., THROUGH] > inner[..., FILLED])[..., None]):
        sheet = find_sheet(part, rules)
        if sheet is not None and sheet.returns >= rules.building.pane_share_min * float(part[..., THROUGH].sum()):
            return True
    return False


@dataclass(frozen=True)
class Sheet:
    """The sheet that most returns from within an opening lie on: its distance behind the face, how many, and in how many rows."""

    behind_m: float
    returns: int
    rows: int


def find_sheet(counts: FloatArray, rules: OpeningRules) -> Sheet | None:
    """The sheet in an opening's cells (c, rows, 4): what stands behind a pane, or on its sill, adds returns of other depths.

    None where too few returns lie on one, or where they show in few of the columns that they might: the edge of a leaf or of
    a reveal does so.
    """
    settings = rules.building
    on_sheet = lies_on_sheet(counts, rules)
    filled = counts[..., FILLED]
    returns, columns = float(filled[on_sheet].sum()), int(on_sheet.any(axis=1).sum())
    if returns < settings.rays_min or columns < 0.5 * min(len(counts), returns):
        return None
    behind_m = -float(counts[on_sheet, SUM].sum()) / returns
    # What reaches as deep as is looked goes on beyond: a leaf that is ajar.
    rows = int(on_sheet.any(axis=0).sum())
    return Sheet(behind_m, int(returns), rows) if behind_m < deepest_sheet_m(rules) else None


def deep_rules(rules: OpeningRules) -> OpeningRules:
    """The same for rays that are told apart as deep as the evidence of a face reaches."""
    return replace(rules, building=rules.building.model_copy(update={"near_m": -LAYERS_M[BEYOND]}))


def deepest_sheet_m(rules: OpeningRules) -> float:
    """How far behind a face a sheet shows in its cells."""
    return rules.building.near_m - 2 * rules.openings.sheet_m


def lies_on_sheet(counts: FloatArray, rules: OpeningRules) -> BoolArray:
    """Which cells (c, rows) of an opening, with their counts (c, rows, 4), have returns of the one depth that most have."""
    filled, sheet_m = counts[..., FILLED], rules.openings.sheet_m
    mean_m, variance = depth_moments(counts)
    flat = (filled > 0) & (variance < rules.building.pane_spread_m**2)
    if not flat.any():
        return flat
    depth_m, weight = mean_m[flat], filled[flat]
    order = np.argsort(depth_m)
    depth_m, total = depth_m[order], np.concatenate([[0.0], np.cumsum(weight[order])])
    within = total[np.searchsorted(depth_m, depth_m + sheet_m, "right")]
    within -= total[np.searchsorted(depth_m, depth_m - sheet_m, "left")]
    return np.asarray(flat & (np.abs(mean_m - depth_m[np.argmax(within)]) <= sheet_m))


def without_panels(leaf: FloatArray, stile_min_m: float) -> FloatArray:
    """The cells (c, rows, 4) of a leaf, nothing in those of its vision panels: rays pass where the leaf is all around.

    stile_min_m: see `OpeningsSettings`.
    """
    aside = cells_in(stile_min_m)
    opaque = leaf[..., FILLED] > leaf[..., THROUGH]
    panels, inner = np.zeros_like(opaque), slice(aside, len(opaque) - aside)
    panels[inner] = ndimage.binary_fill_holes(opaque[inner]) & ~opaque[inner]
    return np.asarray(leaf * ~panels[..., None])


def is_open_to_floor(counts: FloatArray, rules: OpeningRules) -> bool:
    """Whether rays pass an opening's columns (c, rows, 4) at its foot: what stands before a window may hide its sill."""
    foot = counts[:, FOOT_ROW : cells_in(rules.building.knee_m)].sum(axis=(0, 1))
    share_min = rules.building.agreement_min
    return bool(foot[THROUGH] >= rules.building.rays_min and foot[THROUGH] > share_min * (foot[THROUGH] + foot[FILLED]))


def to_jambs(below: FloatArray, first: int, last: int, most_m: float) -> tuple[int, int]:
    """An open stretch of columns, widened to the jambs: beside it rays end on the reveals or on a leaf, behind the face.

    What lies behind the face over more than a leaf's width is the wall itself, set back: the reveal ends there.

    below: (columns, 4), a face's counts between the foot and the head of an opening. most_m: on each side.
    """
    most = cells_in(most_m)
    before_m = mean_before_m(below)
    low, high = widened(before_m < -ON_FACE_M, first, last, most + 1)
    low_wall_m, high_wall_m = before_m[low] if first - low > most else 0.0, before_m[high] if high - last > most else 0.0
    return (
        widened(before_m < low_wall_m - ON_FACE_M, first, last, most)[0],
        widened(before_m < high_wall_m - ON_FACE_M, first, last, most)[1],
    )


def widened(flags: BoolArray, first: int, last: int, most: int) -> tuple[int, int]:
    """A stretch of columns with the flagged ones, at most `most`, that follow on each side without a gap."""
    for _ in range(most):
        if first > 0 and flags[first - 1]:
            first -= 1
        if last + 1 < len(flags) and flags[last + 1]:
            last += 1
    return first, last
