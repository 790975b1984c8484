"""Closed doors whose leaf hangs at the far side of a thick wall."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengthened
from ffmap.algorithms.building.flush_doors import is_opaque
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, Doors, Walls, cells_in
from ffmap.algorithms.building.openings import OpeningRules, lies_on_sheet, without_panels
from ffmap.algorithms.building.ray_evidence import FILLED, SUM, THROUGH, WallCells, depth_moments
from ffmap.algorithms.building.unexplained_lines import unseen_faces
from ffmap.algorithms.scan.doors import DoorState


def close_deep_doors(doors: Doors, trace: Callable[[Walls, BuildingSettings], WallCells], rules: OpeningRules) -> Doors:
    """The doors, of which those are closed that seemed open but are shut by one sheet deep within their wall.

    A leaf deeper than rays are asked about at a wall's face (`near_m`) lets them pass there, as an open doorway does. What the
    robot drove through, or what stands ajar, is open beyond doubt.

    trace: counts rays against faces, as deep behind them as the settings say.
    """
    asked = np.flatnonzero((doors.state == DoorState.OPEN) & ~doors.ajar & ~doors.crossed)
    if not len(asked):
        return doors
    beside = cells_in(rules.openings.beside_m)
    ends = lengthened(doors.ends[asked], beside * CELL_M)
    faces = unseen_faces(ends, doors.normal[asked], doors.head_m[asked])
    cells = trace(faces, rules.building.model_copy(update={"near_m": rules.openings.doorway_max_m}))
    state, depth_m, agreement = doors.state.copy(), doors.depth_m.copy(), doors.agreement.copy()
    for k, d in enumerate(asked):
        # Rays that end on the floor within the doorway come in lower.
        rows = slice(cells_in(rules.building.knee_m), cells_in(doors.head_m[d]) - 1)
        leaf = _leaf_in(cells.of(k).counts[:, rows].astype(np.float64), beside, rules)
        if leaf is not None:
            state[d], depth_m[d], agreement[d] = DoorState.CLOSED, leaf.behind_m, leaf.agreement
    return replace(doors, state=state, depth_m=depth_m, agreement=agreement)


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
    goes_on = np.abs(depth_moments(around)[0] + behind_m) < openings.sheet_m
    if np.count_nonzero(goes_on) >= building.rays_min:
        return None
    return _Leaf(behind_m, returns / float(came))
