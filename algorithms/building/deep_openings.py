"""Openings that seem open at their wall's face, and are closed deep within the wall: by a leaf, or by a window's pane."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengthened
from ffmap.algorithms.building.cells import FILLED, SUM, THROUGH, WallCells, mean_before_m
from ffmap.algorithms.building.closed_doors import is_opaque
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WINDOWS,
    Doors,
    Walls,
    Windows,
    cells_in,
)
from ffmap.algorithms.building.openings import (
    OpeningRules,
    deep_rules,
    is_pane,
    lies_on_sheet,
    without_panels,
)
from ffmap.algorithms.building.unexplained_lines import unseen_faces
from ffmap.algorithms.building.windows import find_pane_m
from ffmap.algorithms.scan.doors import DoorState


def tell_deep_openings(
    doors: Doors, trace: Callable[[Walls], WallCells], rules: OpeningRules
) -> tuple[Doors, Windows]:
    """The doors, closed where a leaf shuts them deep within their wall; and those that a pane shuts there, which are windows.

    What lies deeper than rays are asked about at a wall's face (`near_m`) lets them pass there, as an open doorway does. What the
    robot drove through, or what stands ajar, is open beyond doubt.

    trace: counts rays against faces, as deep behind them as the settings say.
    """
    asked = np.flatnonzero((doors.state == DoorState.OPEN) & ~doors.ajar & ~doors.crossed)
    if not len(asked):
        return doors, NO_WINDOWS
    beside = cells_in(rules.openings.beside_m)
    ends = lengthened(doors.ends[asked], beside * CELL_M)
    faces = unseen_faces(ends, doors.normal[asked], doors.head_m[asked])
    deep = deep_rules(rules)
    cells = trace(faces)
    state, depth_m, agreement = doors.state.copy(), doors.depth_m.copy(), doors.agreement.copy()
    is_window, windows = np.zeros(len(doors), bool), NO_WINDOWS
    for k, d in enumerate(asked):
        counts = cells.of(k).counts[:, : cells_in(doors.head_m[d]) - 1].astype(np.float64)
        # Rays that end on the floor within the doorway come in lower.
        leaf = _leaf_in(counts[:, cells_in(rules.building.knee_m) :], beside, deep)
        inside = slice(beside, len(counts) - beside)
        pane = _pane_in(counts[inside], deep)
        if leaf is not None:
            state[d], depth_m[d], agreement[d] = DoorState.CLOSED, leaf.behind_m, leaf.agreement
        elif pane is not None:
            is_window[d], bottom_m, pane_m = True, np.array([pane.bottom_m]), np.array([pane.behind_m])
            windows = windows.append(Windows(doors.ends[[d]], doors.normal[[d]], bottom_m, doors.head_m[[d]], pane_m))
    return replace(doors, state=state, depth_m=depth_m, agreement=agreement).select(~is_window), windows


class _Leaf(NamedTuple):
    """How far behind the face a leaf lies, and which share of the rays that come in end on it."""

    behind_m: float
    agreement: float


def _leaf_in(counts: FloatArray, beside: int, rules: OpeningRules) -> _Leaf | None:
    """The one sheet that all rays end on which come in through a doorway, if it ends at the jambs.

    The wall of a room or a closet that close behind goes on beyond them, where rays at a slant come to it.

    counts: (c, rows, 4) of the doorway, and of `beside` columns more on either side.
    """
    building, openings = rules.building, rules.openings
    inside = beside + cells_in(openings.jamb_m)
    inner = without_panels(counts[inside : len(counts) - inside], openings.stile_min_m)
    on_sheet, came = lies_on_sheet(inner, rules), inner[..., [FILLED, THROUGH]].sum()
    returns = float(inner[on_sheet, FILLED].sum())
    if not is_opaque(inner, building) or returns < building.opaque_min * came:
        return None
    behind_m = -float(inner[on_sheet, SUM].sum()) / returns
    around = np.concatenate([counts[: beside - 1], counts[len(counts) - beside + 1 :]])
    goes_on = np.abs(mean_before_m(around) + behind_m) < openings.sheet_m
    if np.count_nonzero(goes_on) >= building.rays_min:
        return None
    return _Leaf(behind_m, returns / float(came))


class _Pane(NamedTuple):
    """How far behind the face a pane lies, and the height from which on rays pass it."""

    behind_m: float
    bottom_m: float


def _pane_in(counts: FloatArray, rules: OpeningRules) -> _Pane | None:
    """The sheet that closes a doorway and lets most rays pass, also where it returns some: what stands in the next room does not.

    counts: (c, rows, 4) of the doorway, up to its head.
    """
    high = counts[:, cells_in(rules.building.knee_m) :]
    behind_m, on_sheet = find_pane_m(high, rules), lies_on_sheet(high, rules)
    returned, passed = high[on_sheet][:, [FILLED, THROUGH]].sum(axis=0)
    rows = counts[:, FOOT_ROW:].sum(axis=0)
    is_passed = rows[:, THROUGH] > rows[:, FILLED]
    # A stray return or a jamb makes a sheet as well, but of too few of the rays.
    is_glass = is_pane(counts, rules)
    if not np.isfinite(behind_m) or passed < returned or np.mean(is_passed) < 0.5 or not is_glass:
        return None
    return _Pane(behind_m, (FOOT_ROW + int(is_passed.argmax())) * CELL_M)
