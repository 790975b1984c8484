"""From point lines to vertical structures by forward differences (paper, III.B, eq. 2, Fig. 5)."""

from dataclasses import dataclass

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.rearrangement import Returns

_SPAN_M = 0.2
"""Length (m) over which the slope is measured. The neighbours of eq. 2 are millimetres apart, where
noise decides."""
_JUMP_M = 0.12  # maximum step (m) in horizontal range between neighbours of one structure
_SLOPE_MAX, _SLOPE_LEVEL = 14.0, 20.0  # slopes (m per m) beyond the first are set to the second


class VerticalStructuresSettings(StepSettings):
    """Upright runs in the point lines (paper, III.B, eq. 2)."""

    slope_max: float = Field(
        1.0,
        gt=0,
        description="Maximum change of horizontal range with height (m per m) of an upright line. "
        "Eq. 2.",
    )
    points_min: int = Field(
        10,
        ge=2,
        le=200,
        description="Minimum number of neighbouring samples in a structure. III.B.",
    )


@dataclass(frozen=True)
class VerticalStructures:
    """The vertical structures of each line: runs of upright samples.

    difference: (L, 200) float32, eq. 2 as printed: the change of horizontal range by the change of
        height between neighbouring samples; NaN at the first sample, between equal heights, and in
        lines without samples.
    slope: (L, 200) float32, the same over a fixed span, which decides; NaN where undefined.
    upright: (L, 200) whether |slope| is below the threshold.
    line, first, last: (S,) int32, each structure's line, first and last sample (inclusive).
    bottom_m, top_m: (S,) float32, heights above the floor of its lowest and highest sample.
    upmost, bottommost: (L,) int32, each line's highest and lowest structure, -1 where it has none.
        The up-most is the wall candidate, the bottom-most is evidence (Fig. 6).
    longest: (L,) int32, samples in the longest run of each line, 0 without any.
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
    longest: IntArray


def find_vertical_structures(
    returns: Returns, samples: IntArray, settings: VerticalStructuresSettings
) -> VerticalStructures:
    """Find the runs of at least `points_min` upright samples in each point line.

    Eq. 2 is computed as printed, but does not decide: the heights of neighbouring returns differ by
    millimetres, less than the noise of the range, so that it exceeds its threshold on a third of a
    near wall. The slope of the line over `_SPAN_M` decides, by total least squares.

    samples: (L, 200) from `make_point_lines`.
    """
    difference, slope, cut = _differences(returns, samples, settings.slope_max)
    upright = np.abs(slope) < settings.slope_max
    joined = np.zeros((len(samples), samples.shape[1] + 1), bool)  # with the sample before
    joined[:, 1:-1] = upright[:, 1:] & upright[:, :-1] & ~cut[:, 1:]
    lines, starts = np.nonzero(upright & ~joined[:, :-1])
    _, stops = np.nonzero(upright & ~joined[:, 1:])
    counts = stops - starts + 1
    longest = np.zeros(len(samples), np.int32)
    np.maximum.at(longest, lines, counts.astype(np.int32))
    long = counts >= settings.points_min
    line, first, last = (run[long].astype(np.int32) for run in (lines, starts, stops))
    upmost, bottommost = np.full((2, len(samples)), -1, np.int32)
    structures = np.arange(len(line), dtype=np.int32)
    upmost[line] = structures  # structures come from below upwards: the last assignment holds
    bottommost[line[::-1]] = structures[::-1]
    return VerticalStructures(
        difference=difference,
        slope=slope,
        upright=upright,
        line=line,
        first=first,
        last=last,
        bottom_m=returns.height_m[samples[line, first]].astype(np.float32),
        top_m=returns.height_m[samples[line, last]].astype(np.float32),
        upmost=upmost,
        bottommost=bottommost,
        longest=longest,
    )


@numba.njit(cache=True, nogil=True)
def _differences(
    returns: Returns, samples: IntArray, slope_max: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Eq. 2, the slope over the span, and whether the line jumps before a sample: (L, 200) each."""
    points, origin = returns.points_level, returns.origin_level
    lines, count = samples.shape
    difference = np.full((lines, count), np.nan, np.float32)
    slope = np.full((lines, count), np.nan, np.float32)
    cut = np.zeros((lines, count), np.bool_)
    rho, z = np.empty(count), np.empty(count)
    for line in range(lines):
        if samples[line, 0] < 0:
            continue
        first = 0
        for j in range(count):
            x, y, z[j] = points[samples[line, j]]
            rho[j] = np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2)
            if j == 0:
                continue
            d_rho, d_z = rho[j] - rho[j - 1], z[j] - z[j - 1]
            if d_z != 0.0:
                difference[line, j] = d_rho / d_z  # eq. 2
            cut[line, j] = abs(d_rho) > max(_JUMP_M, slope_max * abs(d_z))
            if cut[line, j]:
                _slopes(rho[first:j], z[first:j], slope[line, first:j])
                first = j
        _slopes(rho[first:], z[first:], slope[line, first:])
    return difference, slope, cut


@numba.njit(cache=True, nogil=True)
def _slopes(rho: FloatArray, z: FloatArray, slope: FloatArray) -> None:
    """Fill Δρ/Δz of the principal direction about each sample, over at least the span."""
    count = len(rho)
    if count < 3:
        return
    sums = np.zeros((count + 1, 5))
    for j in range(count):
        r, h = rho[j] - rho[0], z[j] - z[0]
        sums[j + 1, 0] = sums[j, 0] + r
        sums[j + 1, 1] = sums[j, 1] + h
        sums[j + 1, 2] = sums[j, 2] + r * r
        sums[j + 1, 3] = sums[j, 3] + r * h
        sums[j + 1, 4] = sums[j, 4] + h * h
    low, high, span, half = 0, 0, _SPAN_M**2, 0.25 * _SPAN_M**2
    for j in range(count):
        # The window is as centred as the piece allows; both of its ends only move up.
        while high < count - 1 and (high < j or _apart_squared(rho, z, j, high) < half):
            high += 1
        while (
            low < j
            and _apart_squared(rho, z, low, high) > span
            and _apart_squared(rho, z, low, j) > half
        ):
            low += 1
        m = high + 1 - low
        if m < 3:
            continue
        share = 1.0 / m
        mean_r = (sums[high + 1, 0] - sums[low, 0]) * share
        mean_z = (sums[high + 1, 1] - sums[low, 1]) * share
        v_rr = (sums[high + 1, 2] - sums[low, 2]) * share - mean_r * mean_r
        v_rz = (sums[high + 1, 3] - sums[low, 3]) * share - mean_r * mean_z
        v_zz = (sums[high + 1, 4] - sums[low, 4]) * share - mean_z * mean_z
        # The principal axis of the 2 × 2 covariance: twice its angle from the vertical has the
        # tangent 2 v_rz / (v_zz - v_rr).
        upright = np.sqrt(4.0 * v_rz * v_rz + (v_zz - v_rr) ** 2) + (v_zz - v_rr)
        level = upright <= 0.0 or 2.0 * abs(v_rz) > _SLOPE_MAX * upright
        slope[j] = np.copysign(_SLOPE_LEVEL, v_rz) if level else 2.0 * v_rz / upright


@numba.njit(cache=True, nogil=True)
def _apart_squared(rho: FloatArray, z: FloatArray, i: int, j: int) -> float:
    return float((rho[i] - rho[j]) ** 2 + (z[i] - z[j]) ** 2)
