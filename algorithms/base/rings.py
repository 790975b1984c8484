"""The order of a scan's returns about the spin axis."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from ffmap.algorithms.base.scan import FloatArray, IntArray


@dataclass(frozen=True)
class RingOrder:
    """The returns of a scan ring by ring, each ring once round.

    order: (n,) int32, rows of the scan; order[starts[r]:starts[r + 1]] is ring r by increasing turn. starts: (rings + 1,) int32.
    turn_rad: (n,) float64, of these in this order: the angle about the spin axis from x towards y, -π to π.
    rank: (n,) int32, the place of each row in this order.
    """

    order: "IntArray"
    starts: "IntArray"
    turn_rad: "FloatArray"
    rank: "IntArray"

    @classmethod
    def of(cls, points_sensor: "FloatArray", ring: "IntArray", ring_count: int) -> "RingOrder":
        """Of points (n, 3) float32 whose z is the spin axis, and the emitter (n,) of each."""
        turn = turns(points_sensor)
        order, starts = sort_by_angle(ring, turn, ring_count)
        return cls(order, starts, *_arranged(turn, order))


@numba.njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def turns(points: "FloatArray") -> "FloatArray":  # pragma: no cover
    """Angle of each return about z from x towards y, -π to π, without branches so that it runs on whole vectors.

    The arc tangent is a polynomial within 1.2e-5 rad, a fraction of an encoder's step (Abramowitz and Stegun, 4.4.47).
    """
    turn = np.empty(len(points), np.float32)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
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
    group: "IntArray", angle_rad: "FloatArray", groups: int
) -> "tuple[IntArray, IntArray]":  # pragma: no cover
    """order (n,) int32 and starts (groups + 1,) int32: order[starts[g]:starts[g + 1]] is group g by increasing angle.

    Returns come in the order of firing, and so does each group go round, one way or the other: it is turned about, and begun
    at its lowest angle. Only a group that does not go round once is sorted.

    group: (n,) from 0; angle_rad: (n,).
    """
    count = len(group)
    starts = np.zeros(groups + 1, np.int32)
    for i in range(count):
        starts[group[i] + 1] += 1
    for g in range(groups):
        starts[g + 1] += starts[g]
    order, place, own = np.empty(count, np.int32), starts[:-1].copy(), np.empty(count, np.int32)
    for i in range(count):
        order[place[group[i]]] = i
        place[group[i]] += 1
    for g in range(groups):
        first, size = starts[g], starts[g + 1] - starts[g]
        if size < 2:
            continue
        rises, falls, lowest, highest = 0, 0, 0, 0
        last = angle_rad[order[first + size - 1]]
        for j in range(size):
            this = angle_rad[order[first + j]]
            if this > last:
                rises, highest = rises + 1, j
            elif this < last:
                falls, lowest = falls + 1, j
            last = this
        if falls == 1 and rises == size - 1:
            if lowest > 0:
                own[:size] = order[first : first + size]
                order[first : first + size - lowest] = own[lowest:size]
                order[first + size - lowest : first + size] = own[:lowest]
        elif rises == 1 and falls == size - 1:
            own[:size] = order[first : first + size]
            for k in range(size):
                order[first + k] = own[(highest - 1 - k) % size]
        else:
            own[:size] = order[first : first + size]
            by_angle = np.argsort(angle_rad[own[:size]], kind="mergesort")
            for k in range(size):
                order[first + k] = own[by_angle[k]]
    return order, starts


@numba.njit(cache=True, nogil=True)
def _arranged(turn: "FloatArray", order: "IntArray") -> "tuple[FloatArray, IntArray]":  # pragma: no cover
    """turn_rad and rank of `RingOrder`."""
    turn_rad, rank = np.empty(len(order)), np.empty(len(order), np.int32)
    for j, i in enumerate(order):
        turn_rad[j], rank[i] = turn[i], j
    return turn_rad, rank
