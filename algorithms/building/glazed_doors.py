"""Doors whose leaf is a pane: a closed one is a window down to its lower rail, as wide and as high as doors, with wall all around;
an open one hangs at its doorway."""

from functools import partial

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import segments
from ffmap.algorithms.building.cells import FILLED, THROUGH, mean_before_m
from ffmap.algorithms.building.closed_doors import closed_door
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import TracedFaces, on_and_passed, runs
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, ON_FACE_M, Doors, Windows, cells_in
from ffmap.algorithms.building.openings import OpeningRules, deepest_sheet_m, widened
from ffmap.algorithms.building.windows import wall_of
from ffmap.algorithms.scan.doors import DoorState

_CROSSES_MIN = 0.75  # Share of a pane's width over which its transom shows
_LEAF_M = 0.05  # Its stiles' faces stand before a pane by no more
_RAIL_MAX_M = 0.35  # Height of a leaf's upper rail with what is over it, a frame or a transom


def find_glazed_doors(faces: TracedFaces, windows: Windows, rules: OpeningRules) -> Doors:
    """The closed doors of which a window is the pane; what lies behind is seen through it all the same.

    faces: with all rays, those through windows too.
    """
    building, openings = rules.building, rules.openings
    may_be = (windows.bottom_m <= openings.lower_rail_max_m) & np.isfinite(windows.pane_m)
    may_be &= windows.top_m >= building.door_height_min_m - openings.bar_max_m
    traced, doors = tuple(faces.each()) if may_be.any() else (), NO_DOORS
    for k in np.flatnonzero(may_be):
        w, first, after = wall_of(windows, int(k), faces.walls)
        if w < 0:
            continue
        face, counts = traced[w].segment, traced[w].counts
        pane_m, glass_m = float(windows.pane_m[k]), float(windows.top_m[k])
        leaf = _leaf_around(counts, first, after - 1, pane_m, rules)
        if leaf is None or not building.door_width_min_m <= (leaf[1] + 1 - leaf[0]) * CELL_M <= building.door_width_max_m:
            continue
        transom_m = _transom_m(counts[first:after], glass_m, rules)
        first, last = leaf
        edge_m = head_m = _upper_edge_m(counts[first : last + 1], glass_m, pane_m, rules)
        if np.isfinite(transom_m):
            head_m = transom_m + 0.5 * openings.bar_max_m
        if head_m > building.door_height_max_m + CELL_M:
            continue
        if not _stands_around(counts, first, last, edge_m, float(np.median(traced[w].top_m[first : last + 1])), rules):
            continue
        jamb = cells_in(openings.jamb_m)
        agreement = _agreement(counts[first + jamb : last + 1 - jamb], pane_m, rules)
        # A pane that is all but flush tells nothing of where its stiles meet the jambs.
        depth_m = pane_m if pane_m > ON_FACE_M else 0.0
        told = partial(closed_door, face, (first, last + 1), counts, head_m, known_min=0.0, wall=w)
        doors = doors.append(told(depth_m=depth_m, agreement=agreement, glazed=True))
    return doors


def panes_of_open_leaves(windows: Windows, doors: Doors) -> BoolArray:
    """(N,) which panes are of open doors' leaves: not along the wall, nearer to a jamb than to the doorway's middle, and no farther
    from that jamb than the doorway is wide, to two columns of cells."""
    is_leaf = np.zeros(len(windows), bool)
    for doorway, state in zip(segments(doors), doors.state, strict=True):
        if state != DoorState.OPEN:
            continue
        is_aside = np.abs(windows.normal @ doorway.normal) < SAME_WAY
        for jamb in doorway.at(np.array([0.0, doorway.length_m])):
            from_jamb_m = np.linalg.norm(windows.ends - jamb, axis=2)
            within = from_jamb_m.max(axis=1) < doorway.length_m + 2.0 * CELL_M
            is_leaf |= is_aside & within & (from_jamb_m.min(axis=1) < 0.5 * doorway.length_m)
    return is_leaf


def _leaf_around(counts: FloatArray, first: int, last: int, pane_m: float, rules: OpeningRules) -> tuple[int, int] | None:
    """The columns of the leaf whose pane a window is; None where it has no stiles but a window's frame, which is narrower.

    Stiles are where the pane is, see `_is_at_pane`. Where that is in the wall's face they may be flush with it: those are taken for
    half as wide as they may be.
    """
    most, stile = cells_in(rules.openings.bar_max_m), cells_in(rules.openings.stile_min_m)
    below = counts[:, FOOT_ROW : cells_in(rules.building.door_height_min_m)].sum(axis=1)
    at_pane = _is_at_pane(below, pane_m, rules)
    low, high = widened(at_pane, first, last, most)
    if pane_m <= _LEAF_M:
        flush = most // 2
        low, high = low if low < first else first - flush, high if high > last else last + flush
        return max(low, 0), min(high, len(counts) - 1)
    leaf = low + np.flatnonzero(at_pane[low : high + 1])
    if not len(leaf):
        return None
    first, last = int(leaf[0]), int(leaf[-1])
    # A column of glass that returns nothing is no stile's either.
    is_stile = at_pane & (below[:, FILLED] >= below[:, THROUGH])
    has_stiles = is_stile[first : first + stile].all() and is_stile[last + 1 - stile : last + 1].all()
    return (first, last) if has_stiles else None


def _is_at_pane(rays: FloatArray, pane_m: float, rules: OpeningRules) -> BoolArray:
    """(n,) which parts of a face return from where a pane stands, but for a leaf's thickness: stiles and rails, or the pane itself.

    rays: (n, 4) their counts, see `WallCells`. pane_m: how far behind the face it stands; deeper, cells do not tell.
    """
    least_m = min(pane_m, deepest_sheet_m(rules)) - _LEAF_M
    return np.asarray(-mean_before_m(rays) > max(rules.building.recess_min_m, least_m))


def _upper_edge_m(counts: FloatArray, glass_m: float, pane_m: float, rules: OpeningRules) -> float:
    """Height of the upper edge of what holds a pane, the rail of a leaf or of a fanlight, where it shows as `_leaf_around` says.

    Flush ones are taken for half as high as bars may be.

    counts: (c, rows, 4) of the leaf's columns. glass_m: height of the glass's upper edge.
    """
    if pane_m <= _LEAF_M:
        return glass_m + 0.5 * rules.openings.bar_max_m
    highest = cells_in(glass_m) - 1
    at_pane = _is_at_pane(counts.sum(axis=0), pane_m, rules)
    return (widened(at_pane, highest, highest, cells_in(_RAIL_MAX_M))[1] + 1) * CELL_M


def _transom_m(counts: FloatArray, glass_m: float, rules: OpeningRules) -> float:
    """Height of the lower edge of a transom as high as doors' heads, above which is a fanlight; NaN where there is none.

    counts: (c, rows, 4) of the pane's columns. glass_m: height of the glass's upper edge.
    """
    building, most = rules.building, cells_in(_RAIL_MAX_M)
    lowest = cells_in(building.door_height_min_m - rules.openings.bar_max_m)
    highest = min(cells_in(building.door_height_max_m), cells_in(glass_m))
    crosses = np.mean(counts[..., FILLED] > counts[..., THROUGH], axis=0) >= _CROSSES_MIN
    for start, stop in runs(crosses[:highest]):
        if lowest <= start and stop < highest and stop - start <= most:
            return start * CELL_M
    return float("nan")


def _stands_around(counts: FloatArray, first: int, last: int, edge_m: float, top_m: float, rules: OpeningRules) -> bool:
    """Whether the wall shows beside a doorway, be it a window's sill, which is higher than rails, and above it where the ceiling is
    higher. What stands before the wall may hide it on one side, but the face goes on there.

    edge_m: height of the upper edge of what holds its glass.
    """
    openings, edge, bar = rules.openings, cells_in(edge_m), cells_in(rules.openings.bar_max_m)
    rail = cells_in(openings.lower_rail_max_m)
    whole, sill = slice(FOOT_ROW, edge), slice(rail, rail + bar)
    above = counts[first : last + 1, edge + bar // 2 : cells_in(top_m - openings.below_ceiling_m)]
    beside = cells_in(openings.beside_m)
    sides = counts[max(first - beside, 0) : max(first - 1, 0)], counts[last + 2 : last + 1 + beside]
    if not all(len(side) for side in sides):
        return False
    seen = [side for side in sides if sum(_met(side[:, whole])) >= rules.building.rays_min * len(side)]
    stands = [any(_is_wall(side[:, rows], rules) for rows in (whole, sill)) for side in seen]
    return bool(stands) and all(stands) and (not above.shape[1] or _is_wall(above, rules))


def _is_wall(counts: FloatArray, rules: OpeningRules) -> bool:
    """Whether most rays that meet some cells (c, rows, 4) end there."""
    on, passed = _met(counts)
    return on >= rules.building.rays_min and on > passed


def _met(counts: FloatArray) -> tuple[float, float]:
    """How many rays end on some cells (c, rows, 4), and how many pass them."""
    on, passed = on_and_passed(counts)
    return float(on.sum()), float(passed.sum())


def _agreement(counts: FloatArray, pane_m: float, rules: OpeningRules) -> float:
    """Share of what returns from a doorway's columns (c, rows, 4) that is of the leaf: at its pane, or before that by no more than
    a leaf's thickness. Its pane lets other rays pass, which is no evidence against it.

    counts: without the columns at the jambs, where the reveals return too.
    """
    inner = counts[:, FOOT_ROW : cells_in(rules.building.door_height_min_m)]
    from_pane_m = -mean_before_m(inner) - pane_m
    of_leaf = (from_pane_m > -_LEAF_M) & (from_pane_m < rules.openings.sheet_m)
    return float(inner[of_leaf, FILLED].sum() / max(inner[..., FILLED].sum(), 1.0))
