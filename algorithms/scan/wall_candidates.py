"""From vertical structures to wall candidates: the structures as high as walls (paper, III.B)."""

from enum import IntEnum
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import VerticalStructures

_UPPER_PART_M = 0.4  # height (m) of a candidate's upper part: nothing is before it
OVERHANG_M = 0.2
"""Minimum depth (m) of a soffit, a vault, a roof or a valance before a wall: leaves and blinds are
less deep in their openings."""
_GAP_M_PER_M = 0.15  # added to the maximum gap for each metre of range, as emitters spread


class WallPlanesSettings(StepSettings):
    """Growing wall planes from candidates (paper, III.B, Algorithm 1)."""

    similarity_m: float = Field(
        0.05,
        gt=0,
        le=1,
        description="σ_th: maximum RMS distance (m) of a candidate from the plane that it joins. "
        "Alg. 1.",
    )
    reach_m: float = Field(
        0.35,
        gt=0,
        description="Maximum distance (m) below a ceiling at which a candidate ends: walls meet "
        "the ceiling. III.B.",
    )
    height_min_m: float = Field(
        2.1, gt=0, description="Minimum height (m) of a wall where no ceiling is in view. III.B."
    )
    gap_m: float = Field(
        0.3, gt=0, description="Maximum gap (m) between neighbouring lines of a plane. Alg. 1."
    )
    lines_min: int = Field(3, ge=2, description="Minimum number of lines in a wall plane. Alg. 1.")
    distance_m: float = Field(
        0.045,
        gt=0,
        le=0.5,
        description="Maximum distance (m) of a wall's return from a wall plane of the scan. III.C.",
    )


class Reach(IntEnum):
    """Whether a candidate is as high as a wall, and by what."""

    LOW = 0  # it ends too far below the ceiling, or too low where none is in view: it is refused
    CEILING = 1  # it ends close to a ceiling
    ABOVE_CEILINGS = 2  # it ends above the highest ceiling in view: there is another
    HEIGHT = 3  # no ceiling is in view, and it is high enough
    TURNS_BACK = 4  # its line has next to no returns of a ceiling: it turns back or ends below it
    OVERHUNG = 5  # above it, its line comes nearer, up to a ceiling: a soffit, a vault, a roof


class WallCandidates(NamedTuple):  # which compiled functions take, unlike a dataclass
    """The wall candidates (C,) of a scan, in the order of Algorithm 1.

    structure: vertical structure of each. line: its point line.
    part: number of the walk that it is part of; no plane grows from one walk into the next.
    first, last: first and last sample of its upper part.
    moments: (C, 6) n, Σx, Σy, Σxx, Σxy, Σyy of these samples. middle: (C, 2) their mean x and y.
    reach: uint8, see `Reach`.
    below_ceiling_m: distance of its end below the ceiling nearest in height, negative above; NaN
        where no ceiling is in view.
    gap_max_m: maximum horizontal distance to its neighbour in a plane.
    """

    structure: IntArray
    line: IntArray
    part: IntArray
    first: IntArray
    last: IntArray
    moments: FloatArray
    middle: FloatArray
    reach: UInt8Array
    below_ceiling_m: FloatArray
    gap_max_m: FloatArray


def choose_candidates(
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    ceilings: tuple[HorizontalPlane, ...],
    meets_ceiling: BoolArray,
    settings: WallPlanesSettings,
) -> WallCandidates:
    """Choose the up-most structure of each line, and others that end at a ceiling.

    The paper takes the up-most structures alone. Through an opening, a line shows the wall of the
    next room below the lintel.

    samples: (L, 200) from `make_point_lines`. structures: of these lines.
    ceilings: of this scan; empty where none is in view.
    meets_ceiling: (L,) whether a line has more than a few stray returns of a ceiling.
    """
    is_upmost = structures.upmost[structures.line] == np.arange(len(structures.line))
    ends = samples[structures.line, structures.last]
    reach, below_ceiling_m = _reach_of(returns, ends, ceilings, settings)
    # The wall of a low up-most structure may be higher than what the line shows of it.
    low = np.flatnonzero(
        is_upmost & (reach == Reach.LOW) & (structures.top_m > 0.5 * settings.height_min_m)
    )
    lines = structures.line[low]
    end_reach, _ = _reach_of(returns, samples[lines, -1], ceilings, settings)
    overhung = _overhung(returns, samples[lines], structures.last[low])
    overhung &= end_reach != Reach.LOW
    reach[low[~meets_ceiling[lines]]] = Reach.TURNS_BACK
    reach[low[overhung]] = Reach.OVERHUNG
    chosen = np.flatnonzero(is_upmost | ((reach != Reach.LOW) & (len(ceilings) > 0)))
    # Along the wall: emitter by emitter on one side, then on the other; up-most structures first.
    line, further = structures.line[chosen], ~is_upmost[chosen]
    walk = np.lexsort((line, line % 2, further))
    chosen, line, further = chosen[walk], line[walk], further[walk]
    last = structures.last[chosen]
    moments, first = _upper_parts(returns, samples[line], structures.first[chosen], last)
    middle = moments[:, 1:3] / moments[:, :1]
    range_m = np.hypot(*(middle - returns.origin_level[:2]).T)
    return WallCandidates(
        structure=chosen.astype(np.int32),
        line=line,
        part=line % 2 + 2 * further,
        first=first,
        last=last,
        moments=moments,
        middle=middle,
        reach=reach[chosen],
        below_ceiling_m=below_ceiling_m[chosen],
        gap_max_m=settings.gap_m + _GAP_M_PER_M * range_m,
    )


def _reach_of(
    returns: Returns,
    ends: IntArray,
    ceilings: tuple[HorizontalPlane, ...],
    settings: WallPlanesSettings,
) -> tuple[UInt8Array, FloatArray]:
    """`Reach` of structures by their upper ends (s,) alone, and their `below_ceiling_m`."""
    if not ceilings:
        high = returns.height_m[ends] >= settings.height_min_m
        reach = np.where(high, Reach.HEIGHT, Reach.LOW)
        return reach.astype(np.uint8), np.full(len(ends), np.nan)
    end_level = returns.points_level[ends]
    below_m = np.array([ceiling.height_at(end_level) - end_level[:, 2] for ceiling in ceilings])
    nearest_m = below_m[np.abs(below_m).argmin(axis=0), np.arange(len(ends))]
    reach = np.select(
        [np.abs(nearest_m) < settings.reach_m, below_m.max(axis=0) < 0],
        [Reach.CEILING, Reach.ABOVE_CEILINGS],
        Reach.LOW,
    )
    return reach.astype(np.uint8), nearest_m


@numba.njit(cache=True, nogil=True)
def _overhung(returns: Returns, samples: IntArray, last: IntArray) -> BoolArray:
    """Whether a line, above a structure, touches it, is no farther and no lower, and comes nearer.

    No ray passes above such a structure, as rays do over furniture and below what hangs before a
    wall. One sample in ten may be stray, by more than a quarter of `OVERHANG_M`.

    samples: (s, 200) the lines of some structures. last: (s,) their highest samples.
    """
    points, origin = returns.points_level, returns.origin_level
    overhung = np.zeros(len(last), np.bool_)
    for s in range(len(last)):
        x, y, z = points[samples[s, last[s]]]
        rho = np.hypot(x - origin[0], y - origin[1])
        above, stray, nearest = samples[s, last[s] + 1 :], 0, np.inf
        for j, i in enumerate(above):
            back = np.hypot(points[i, 0] - origin[0], points[i, 1] - origin[1]) - rho
            up = points[i, 2] - z
            if j == 0 and np.hypot(back, up) > OVERHANG_M:
                break
            stray += back > 0.25 * OVERHANG_M or up < -0.25 * OVERHANG_M
            nearest = min(nearest, back)
        overhung[s] = len(above) >= 3 and nearest < -OVERHANG_M and 10 * stray <= len(above)
    return overhung


@numba.njit(cache=True, nogil=True)
def _upper_parts(
    returns: Returns, samples: IntArray, first: IntArray, last: IntArray
) -> tuple[FloatArray, IntArray]:
    """`moments` and `first` of `WallCandidates`, from their lines (C, 200) and whole extents."""
    points, height = returns.points_level, returns.height_m
    moments = np.zeros((len(samples), 6))
    lowest = first.copy()
    for c in range(len(samples)):
        top = height[samples[c, last[c]]]
        s = last[c]
        while s >= first[c] and (last[c] - s < 10 or height[samples[c, s]] > top - _UPPER_PART_M):
            x, y = np.float64(points[samples[c, s], 0]), np.float64(points[samples[c, s], 1])
            moments[c, 0] += 1.0
            moments[c, 1] += x
            moments[c, 2] += y
            moments[c, 3] += x * x
            moments[c, 4] += x * y
            moments[c, 5] += y * y
            s -= 1
        lowest[c] = s + 1
    return moments, lowest
