"""Doors whose leaf is a pane: a closed one is a window down to its lower rail, as wide and as high as doors, with wall all around;
an open one hangs at its doorway."""

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.building.door_casings import flush_door, glazed
from ffmap.algorithms.building.face_columns import TracedFaces, on_and_passed
from ffmap.algorithms.building.face_verdicts import SAME_WAY
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, ON_FACE_M, Doors, Windows, cells_in
from ffmap.algorithms.building.openings import OpeningRules, lies_on_sheet, tops_m, widened
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, SUM
from ffmap.algorithms.building.windows import wall_of
from ffmap.algorithms.scan.doors import DoorState


def find_glazed_doors(faces: TracedFaces, windows: Windows, rules: OpeningRules) -> Doors:
    """The closed doors of which a window is the pane; what lies behind is seen through it all the same.

    faces: with all rays, those through windows too.
    """
    building, openings = rules.building, rules.openings
    top_m = tops_m(faces.walls, faces.cells, faces.clear_m)
    may_be = (windows.bottom_m <= openings.lower_rail_max_m) & (windows.top_m <= building.door_height_max_m)
    may_be &= (windows.top_m >= building.door_height_min_m - openings.bar_max_m) & np.isfinite(windows.pane_m)
    doors = NO_DOORS
    for k in np.flatnonzero(may_be):
        w, first, after = wall_of(windows, int(k), faces.walls)
        if w < 0:
            continue
        face, own = Segment.between(faces.walls.ends[w], faces.walls.normal[w]), faces.columns(w)
        counts = faces.cells.counts[own].astype(np.float64)
        first, last = _with_stiles(counts, first, after - 1, rules)
        if not building.door_width_min_m <= (last + 1 - first) * CELL_M <= building.door_width_max_m:
            continue
        head_m = float(windows.top_m[k]) + 0.5 * openings.bar_max_m
        if not _stands_around(counts, first, last, head_m, float(np.median(top_m[own][first : last + 1])), rules):
            continue
        door = flush_door(face, w, (first, last + 1), 0, head_m, counts, 0.0)
        jamb = cells_in(openings.jamb_m)
        agreement = _agreement(counts[first + jamb : last + 1 - jamb], rules)
        # A pane that is all but flush tells nothing of where its stiles meet the jambs.
        pane_m = float(windows.pane_m[k])
        doors = doors.append(glazed(door, pane_m if pane_m > ON_FACE_M else 0.0, agreement))
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


def _with_stiles(counts: FloatArray, first: int, last: int, rules: OpeningRules) -> tuple[int, int]:
    """A pane's columns with its leaf's stiles: as far as these are recessed; half as wide as they may be where they are flush."""
    below = counts[:, FOOT_ROW : cells_in(rules.building.door_height_min_m)].sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        recessed = -below[:, SUM] / below[:, FILLED] > rules.building.recess_min_m
    most = cells_in(rules.openings.bar_max_m)
    low, high = widened(recessed, first, last, most)
    flush = most // 2
    return (low if low < first else max(first - flush, 0)), (high if high > last else min(last + flush, len(counts) - 1))


def _stands_around(counts: FloatArray, first: int, last: int, head_m: float, top_m: float, rules: OpeningRules) -> bool:
    """Whether the wall shows on both sides of a doorway, and above it where the ceiling is higher."""
    openings, most = rules.openings, cells_in(rules.openings.bar_max_m)
    rows = slice(FOOT_ROW, cells_in(head_m))
    over = slice(cells_in(head_m) + most // 2, cells_in(top_m - openings.below_ceiling_m))
    beside = cells_in(openings.beside_m)
    sides = counts[max(first - beside, 0) : max(first - 1, 0), rows], counts[last + 2 : last + 1 + beside, rows]
    for part in (*sides, counts[first : last + 1, over]):
        on, passed = on_and_passed(part.sum(axis=(0, 1)))
        if part.shape[1] and not (on >= rules.building.rays_min and on > passed):
            return False
    return True


def _agreement(counts: FloatArray, rules: OpeningRules) -> float:
    """Share of what returns from a doorway's columns (c, rows, 4) that is of one sheet, the leaf's; a pane lets the others pass.

    counts: without the columns at the jambs, where the reveals return too.
    """
    inner = counts[:, FOOT_ROW : cells_in(rules.building.door_height_min_m)]
    return float(inner[lies_on_sheet(inner, rules), FILLED].sum() / max(inner[..., FILLED].sum(), 1.0))
