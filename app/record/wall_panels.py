"""Walls as upright panels, with holes for their doors and windows."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import Blinds, Doors, Walls, Windows

_BEHIND_MAX_M = 0.5
"""Maximum distance (m) of an opening from the other face of the wall."""
_ALONG_MIN = float(np.cos(np.radians(15.0)))
"""Minimum cosine of the angle between an opening and its wall."""
_SLIVER_M = 0.01
"""Panels narrower or lower than this (m) are omitted."""


@dataclass(frozen=True)
class WallPanels:
    """Rectangles that cover walls without their openings.

    ends: (P, 2, 2) x and y in the map, metres.
    bottom_m, top_m: (P,) heights.
    wall: (P,) index of the wall.
    """

    ends: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    wall: IntArray


def wall_panels(walls: Walls, doors: Doors, *windows: Windows | Blinds) -> WallPanels:
    """Cover each wall except its openings, in either of its faces."""
    holes = np.concatenate([doors.ends, *(part.ends for part in windows)])
    low_m = np.concatenate([np.full(len(doors), -np.inf), *(part.bottom_m for part in windows)])
    high_m = np.concatenate([doors.head_m, *(part.top_m for part in windows)])
    found: list[tuple[FloatArray, float, float, int]] = []
    for wall, (start, end) in enumerate(walls.ends):
        length = float(np.linalg.norm(end - start))
        if length < _SLIVER_M:
            continue
        along = (end - start) / length
        pierced = _pierces(holes, start, along)
        first, last = np.sort(((holes - start) @ along)[pierced], axis=1).T
        cuts = np.unique(np.clip(np.concatenate([[0.0, length], first, last]), 0.0, length))
        for left, right in pairwise(cuts.tolist()):
            if right - left < _SLIVER_M:
                continue
            here = (first < (left + right) / 2) & (last > (left + right) / 2)
            heights = (float(walls.bottom_m[wall]), float(walls.top_m[wall]))
            for low, high in _solid(*heights, low_m[pierced][here], high_m[pierced][here]):
                found.append((start + np.outer([left, right], along), low, high, wall))
    return WallPanels(
        np.array([ends for ends, *_ in found]).reshape(-1, 2, 2),
        np.array([low for _, low, _, _ in found], np.float64),
        np.array([high for _, _, high, _ in found], np.float64),
        np.array([wall for *_, wall in found], np.int64),
    )


def _pierces(holes: FloatArray, start: FloatArray, along: FloatArray) -> IntArray:
    """Return the openings (H, 2, 2) that are parallel and close to the line of a wall."""
    width_m = np.maximum(lengths_m(holes), 1e-9)
    cosine = np.abs((holes[:, 1] - holes[:, 0]) @ along) / width_m
    across = np.abs((holes.mean(axis=1) - start) @ np.array([-along[1], along[0]]))
    return np.flatnonzero((cosine > _ALONG_MIN) & (across < _BEHIND_MAX_M))


def _solid(
    bottom_m: float, top_m: float, low_m: FloatArray, high_m: FloatArray
) -> list[tuple[float, float]]:
    """Return the height ranges without openings; openings may overlap."""
    left: list[tuple[float, float]] = []
    reached = bottom_m
    for low, high in sorted(zip(low_m.tolist(), high_m.tolist(), strict=True)):
        if low - reached > _SLIVER_M:
            left.append((reached, min(low, top_m)))
        reached = max(reached, high)
    if top_m - reached > _SLIVER_M:
        left.append((reached, top_m))
    return left
