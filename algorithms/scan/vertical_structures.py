"""From point lines to wall candidates by forward differences (paper, III.B, eq. 2, Fig. 5 and 6)."""

from dataclasses import dataclass

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.rearrangement import Returns

_STEEPEST, _LYING = 14.0, 20.0  # the highest slope that is told, and what stands for all beyond it


class VerticalStructuresSettings(StepSettings):
    """Upright runs in the point lines (paper, III.B, eq. 2)."""

    slope_max: float = Field(
        1.0, gt=0, description="Maximum change of horizontal range with height (m per m) of an upright line. Eq. 2."
    )
    span_m: float = Field(
        0.2,
        gt=0,
        le=2,
        description="Length (m) over which the slope is measured; the neighbours of eq. 2 lie millimetres apart, where noise "
        "decides. III.B.",
    )
    jump_m: float = Field(
        0.12, gt=0, description="Maximum step (m) in horizontal range between neighbours of one structure. III.B."
    )
    points_min: int = Field(
        10, ge=2, le=200, description="Minimum number of neighbouring samples in a structure. III.B."
    )


@dataclass(frozen=True)
class VerticalStructures:
    """The vertical structures of each line: runs of samples that stand upright.

    difference: (L, 200) float32, eq. 2 as printed: the change of horizontal range by the change of height between
        neighbouring samples; NaN at the first sample, where the heights are equal, and in lines without samples.
    slope: (L, 200) float32, the same over a fixed span, which decides; NaN where there is none.
    upright: (L, 200) bool, whether |slope| is below the threshold.
    line, first, last: (S,) int32, each structure's line and its first and last sample, inclusive.
    bottom_m, top_m: (S,) float32, heights above the floor of its lowest and highest sample.
    upmost, bottommost: (L,) int32, index of each line's highest and lowest structure, -1 where it has none. The up-most
        is the wall candidate; the bottom-most is kept for comparison (Fig. 6).
    """

    difference: FloatArray
    slope: FloatArray
    upright: BoolArray
    line: IntArray
    first: IntArray
    last: IntArray
    bottom_m: FloatArray
    top_m: FloatArray
    upmost: IntArray
    bottommost: IntArray


def find_vertical_structures(
    returns: Returns, samples: IntArray, settings: VerticalStructuresSettings
) -> VerticalStructures:
    """The runs of at least `points_min` upright samples in each point line.

    Eq. 2 is computed as printed. What decides is the direction of the line over `span_m`, by total least squares: the
    heights of neighbouring returns differ by millimetres, less than the range's noise, so that the printed quotient
    exceeds its threshold on a third of a near wall.

    samples: (L, 200) from `make_point_lines`. Horizontal ranges are measured from the sensor.
    """
    x0, y0 = returns.origin_level[:2]
    difference, slope, run = _differences(
        returns.points_level, samples, x0, y0, settings.span_m, settings.slope_max, settings.jump_m
    )
    line, first, last = _runs(run, settings.points_min)
    upmost = np.full(len(samples), -1, np.int32)
    bottommost = np.full(len(samples), -1, np.int32)
    structures = np.arange(len(line), dtype=np.int32)
    upmost[line] = structures  # runs come line by line, from below upwards: the last one written stays
    bottommost[line[::-1]] = structures[::-1]
    return VerticalStructures(
        difference=difference,
        slope=slope,
        upright=run > 0,
        line=line,
        first=first,
        last=last,
        bottom_m=returns.height_m[samples[line, first]].astype(np.float32),
        top_m=returns.height_m[samples[line, last]].astype(np.float32),
        upmost=upmost,
        bottommost=bottommost,
    )


@numba.njit(cache=True, nogil=True)
def _differences(
    points: FloatArray, samples: IntArray, x0: float, y0: float, span_m: float, slope_max: float, jump_m: float
) -> tuple[FloatArray, FloatArray, IntArray]:  # pragma: no cover
    """Eq. 2, the slope over the span, and for each upright sample the number of its jump-free piece, from 1."""
    lines, count = samples.shape
    difference = np.full((lines, count), np.nan, np.float32)
    slope = np.full((lines, count), np.nan, np.float32)
    run = np.zeros((lines, count), np.int32)
    rho = np.empty(count)
    z = np.empty(count)
    sums = np.zeros((count + 1, 5))
    for line in range(lines):
        if samples[line, 0] < 0:
            continue
        for j in range(count):
            i = samples[line, j]
            rho[j] = np.sqrt((points[i, 0] - x0) ** 2 + (points[i, 1] - y0) ** 2)
            z[j] = points[i, 2]
        piece_first = 0
        piece = 1
        while piece_first < count:
            piece_last = piece_first
            while piece_last + 1 < count:
                d_rho, d_z = rho[piece_last + 1] - rho[piece_last], z[piece_last + 1] - z[piece_last]
                if d_z != 0.0:
                    difference[line, piece_last + 1] = d_rho / d_z
                if abs(d_rho) > max(jump_m, slope_max * abs(d_z)):
                    break
                piece_last += 1
            _slopes(rho, z, piece_first, piece_last, span_m, slope[line], sums)
            for j in range(piece_first, piece_last + 1):
                if abs(slope[line, j]) < slope_max:
                    run[line, j] = piece
            piece += 1
            piece_first = piece_last + 1
    return difference, slope, run


@numba.njit(cache=True, nogil=True)
def _slopes(
    rho: FloatArray, z: FloatArray, first: int, last: int, span_m: float, slope: FloatArray, sums: FloatArray
) -> None:  # pragma: no cover
    """Δρ/Δz of the line's principal direction about each sample of one piece, over at least the span.

    sums: (samples + 1, 5), whose first row is 0; room for the running sums.
    """
    if last - first < 2:
        return
    for j in range(first, last + 1):
        k = j - first
        r, h = rho[j] - rho[first], z[j] - z[first]
        sums[k + 1, 0] = sums[k, 0] + r
        sums[k + 1, 1] = sums[k, 1] + h
        sums[k + 1, 2] = sums[k, 2] + r * r
        sums[k + 1, 3] = sums[k, 3] + r * h
        sums[k + 1, 4] = sums[k, 4] + h * h
    low, high, span, half = first, first, span_m * span_m, 0.25 * span_m * span_m
    for j in range(first, last + 1):
        # The window is as centred as the piece allows; both of its ends only ever move up.
        while high < last and (high < j or _apart_squared(rho, z, j, high) < half):
            high += 1
        while low < j and _apart_squared(rho, z, low, high) > span and _apart_squared(rho, z, low, j) > half:
            low += 1
        a, b = low - first, high - first + 1
        m = b - a
        if m < 3:
            continue
        share = 1.0 / m
        mean_r, mean_z = (sums[b, 0] - sums[a, 0]) * share, (sums[b, 1] - sums[a, 1]) * share
        v_rr = (sums[b, 2] - sums[a, 2]) * share - mean_r * mean_r
        v_rz = (sums[b, 3] - sums[a, 3]) * share - mean_r * mean_z
        v_zz = (sums[b, 4] - sums[a, 4]) * share - mean_z * mean_z
        # The principal axis of the 2 × 2 covariance; twice its angle from the vertical has the tangent 2 v_rz / (v_zz - v_rr).
        upright = np.sqrt(4.0 * v_rz * v_rz + (v_zz - v_rr) ** 2) + (v_zz - v_rr)
        lies = upright <= 0.0 or 2.0 * abs(v_rz) > _STEEPEST * upright
        slope[j] = np.float32(np.copysign(_LYING, v_rz) if lies else 2.0 * v_rz / upright)


@numba.njit(cache=True, nogil=True)
def _apart_squared(rho: FloatArray, z: FloatArray, i: int, j: int) -> float:  # pragma: no cover
    return float((rho[i] - rho[j]) ** 2 + (z[i] - z[j]) ** 2)


@numba.njit(cache=True, nogil=True)
def _runs(run: IntArray, points_min: int) -> tuple[IntArray, IntArray, IntArray]:  # pragma: no cover
    """Line, first and last sample of every run of equal positive numbers that is long enough."""
    lines, count = run.shape
    line_of = np.empty(lines * count, np.int32)
    first = np.empty(lines * count, np.int32)
    last = np.empty(lines * count, np.int32)
    found = 0
    for line in range(lines):
        j = 0
        while j < count:
            k = j
            while k + 1 < count and run[line, k + 1] == run[line, j]:
                k += 1
            if run[line, j] > 0 and k - j + 1 >= points_min:
                line_of[found], first[found], last[found] = line, j, k
                found += 1
            j = k + 1
    return line_of[:found].copy(), first[:found].copy(), last[:found].copy()
