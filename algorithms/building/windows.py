"""Windows of the building, and what was seen through them."""

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import (
    LENGTH,
    Segment,
    before_line,
    crossing,
    lengths_m,
    lines_of,
    segments,
)
from ffmap.algorithms.building.model import CELL_M, NO_WINDOWS, Doors, Walls, Windows
from ffmap.algorithms.building.rays import Rays
from ffmap.algorithms.building.verdicts import SAME_WAY
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import Features, select_rays

_ONE_WALL_M = 0.1
"""Distance (m) between two stretches of a face in which one window shows."""
_SILL_M = 0.3
"""Difference (m) of the sills of two windows next to each other."""


def join_windows(windows: Windows) -> Windows:
    """The windows, each once: those that overlap on one wall are one.

    A garden door and the window beside it, which has a sill, are two.
    """
    joined = NO_WINDOWS
    for own in (windows.one(w) for w in range(len(windows))):
        for k, known in enumerate(segments(joined)):
            if not is_beside(known, own.ends[0], own.normal[0]):
                continue
            place_m = np.concatenate([[0.0, known.length_m], known.place_m(own.ends[0])])
            shorter_m = min(known.length_m, float(lengths_m(own.ends)[0]))
            is_less = known.shared_m(own.ends[0]) < 0.5 * shorter_m
            if is_less and abs(joined.bottom_m[k] - own.bottom_m[0]) > _SILL_M:
                continue
            ends = known.at(np.array([place_m.min(), place_m.max()]))
            one = joined.one(k).append(own)
            own = Windows(
                ends[None],
                known.normal[None],
                one.bottom_m.min(keepdims=True),
                one.top_m.max(keepdims=True),
                np.fmax(one.pane_m[:1], one.pane_m[1:]),
                one.support.one(np.nan_to_num(one.support.odds).argmax()),
            )
            joined = joined.select(np.arange(len(joined)) != k)
            break
        joined = joined.append(own)
    return joined


def is_in_wall(windows: Windows, walls: Walls) -> BoolArray:
    """(N,) which windows lie for the most part in walls that look the same way.

    Mullions between the panes of a glazed front are short walls, and these end beside panes.
    """
    faces = tuple(segments(walls))
    panes = zip(windows.ends, windows.normal, strict=True)
    shared_m = [sum(f.shared_m(own[0]) for f in faces if is_beside(f, *own)) for own in panes]
    return np.array(shared_m) > 0.5 * lengths_m(windows.ends)


def is_beside(face: Segment, ends: FloatArray, normal: FloatArray) -> bool:
    """Whether a window with ends (2, 2) and normal (2,) overlaps a face that looks its way."""
    off_m = np.abs(face.before_m(ends)).max()
    looks = face.normal @ normal > 0.0
    return bool(looks and off_m < _ONE_WALL_M and face.shared_m(ends) > 0.0)


def rays_through(windows: Windows, features: Features) -> Features:
    """The same scans with the rays alone that ended beyond a window."""
    return select_rays(features, _rays_through(lines_of(windows), Rays.of(features)))


@numba.njit(cache=True, nogil=True)
def _rays_through(panes: FloatArray, rays: Rays) -> BoolArray:  # pragma: no cover
    origin, starts, end = rays.origin, rays.starts, rays.end
    passed = np.zeros(len(end), np.bool_)
    for w in range(len(panes)):
        for s in range(len(origin)):
            if before_line(panes, w, origin[s, 0], origin[s, 1]) <= 0.0:
                continue
            for r in range(starts[s], starts[s + 1]):
                x, y = np.float64(end[r, 0]), np.float64(end[r, 1])
                if before_line(panes, w, x, y) <= -CELL_M:
                    _, u = crossing(panes, w, 0.0, x, y, origin[s], 0.0)
                    passed[r] |= 0.0 < u < panes[w, LENGTH]
    return passed


def panes_of_open_leaves(windows: Windows, doors: Doors) -> BoolArray:
    """(N,) which panes are of open doors' leaves.

    These stand aside from the wall, nearer to a jamb than to the doorway's middle, and no farther
    from that jamb than the doorway is wide. They hang in either face of the wall.
    """
    is_leaf = np.zeros(len(windows), bool)
    for d, doorway in enumerate(segments(doors)):
        if doors.state[d] != DoorState.OPEN:
            continue
        is_aside = np.abs(windows.normal @ doorway.normal) < SAME_WAY
        jambs = doorway.at(np.array([0.0, doorway.length_m]))
        other_face = jambs - np.nan_to_num(doors.reveal_m[d]) * doorway.normal
        for jamb in np.concatenate([jambs, other_face]):
            from_jamb_m = np.linalg.norm(windows.ends - jamb, axis=2)
            within = from_jamb_m.max(axis=1) < doorway.length_m + 2.0 * CELL_M
            is_leaf |= is_aside & within & (from_jamb_m.min(axis=1) < 0.5 * doorway.length_m)
    return is_leaf
