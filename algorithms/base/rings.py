"""The order of a scan's returns about the spin axis."""

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray

_BINS = 256


@numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def turns(points: FloatArray, down_rad: float) -> FloatArray:  # pragma: no cover
    """Angle of each return about z from straight down, -π to π, without branches so that it runs on whole vectors.

    The arc tangent is a polynomial within 1.2e-5 rad, a fraction of an encoder's step (Abramowitz and Stegun, 4.4.47).
    """
    cos_down, sin_down = np.float32(np.cos(down_rad)), np.float32(np.sin(down_rad))
    turn = np.empty(len(points), np.float32)
    for i in range(len(points)):
        x = points[i, 0] * cos_down + points[i, 1] * sin_down
        y = points[i, 1] * cos_down - points[i, 0] * sin_down
        ax, ay = abs(x), abs(y)
        steep = ay > ax
        ratio = (ax if steep else ay) / max(max(ax, ay), np.float32(1e-30))
        s = ratio * ratio
        a = np.float32(0.0208351)
        a = a * s - np.float32(0.0851330)
        a = a * s + np.float32(0.1801410)
        a = a * s - np.float32(0.3302995)
        a = (a * s + np.float32(0.9998660)) * ratio
        a = np.float32(np.pi / 2) - a if steep else a
        a = np.float32(np.pi) - a if x < 0 else a
        turn[i] = -a if y < 0 else a
    return turn


@numba.njit(cache=True, nogil=True)
def sort_by_angle(
    group: IntArray, angle_rad: FloatArray, groups: int, lowest_rad: float
) -> tuple[IntArray, IntArray]:  # pragma: no cover
    """order (n,) int32 and starts (groups + 1,) int32: order[starts[g]:starts[g + 1]] is group g by increasing angle.

    A counting sort by group and angle, made exact by an insertion pass: linear in any order of the input.

    group: (n,) from 0; angle_rad: (n,) from `lowest_rad` to π.
    """
    count = len(group)
    bins_a_rad = np.float32(_BINS / (np.pi - lowest_rad))
    key = np.empty(count, np.int32)
    offsets = np.zeros(groups * _BINS + 1, np.int32)
    for i in range(count):
        key[i] = group[i] * _BINS + min(int((angle_rad[i] - np.float32(lowest_rad)) * bins_a_rad), _BINS - 1)
        offsets[key[i] + 1] += 1
    for k in range(groups * _BINS):
        offsets[k + 1] += offsets[k]
    starts = offsets[::_BINS].copy()
    order = np.empty(count, np.int32)
    for i in range(count):
        order[offsets[key[i]]] = i
        offsets[key[i]] += 1
    for g in range(groups):
        for j in range(starts[g] + 1, starts[g + 1]):
            moving = order[j]
            steps = 0
            while j - steps > starts[g] and angle_rad[order[j - steps - 1]] > angle_rad[moving]:
                order[j - steps] = order[j - steps - 1]
                steps += 1
            order[j - steps] = moving
    return order, starts
