"""Firings that return twice: which of a cloud's returns are of one beam, and which of the two is farther.

Drivers put both returns of a firing into one cloud (Velodyne's and Hesai's drivers, Nebula, packets): two points of one ring,
one time and one direction. Fields that number the returns (`return_type`, `return_mode`, bits of Livox's `tag`) differ from
driver to driver and are not needed. Where a driver publishes each return as a topic of its own (`…_strongest` and `…_last`,
Ouster's `points` and `points2`), one of them is read.
"""

import numba
import numpy as np

from ffmap.algorithms.base.scan import Echo, FloatArray, IntArray, UInt8Array

ECHO_APART_M = 0.1
"""Two returns of a firing that are nearer to each other are one surface, measured twice."""
PAIRS_MIN = 20
"""Fewer firings that return twice, in all clouds that were looked into, are chance."""
_SAME_DIRECTION = 1.0 - 1e-6  # Cosine: 0.08°, less than the step from one firing to the next


def find_echoes(points_sensor: FloatArray, ring: IntArray, time_ns: IntArray) -> UInt8Array:
    """(n,) what each return is to its firing, see `Echo`. points_sensor: (n, 3); ring, time_ns: (n,) of each firing."""
    order = np.lexsort((time_ns, ring))
    return _echoes(points_sensor, ring, time_ns, order, ECHO_APART_M)


@numba.njit(cache=True, nogil=True)
def _echoes(
    points: FloatArray, ring: IntArray, time_ns: IntArray, order: IntArray, apart_m: float
) -> UInt8Array:  # pragma: no cover
    echo = np.zeros(len(points), np.uint8)
    for k in range(len(order) - 1):
        i, j = order[k], order[k + 1]
        if ring[i] != ring[j] or time_ns[i] != time_ns[j]:
            continue
        dot, first, second = 0.0, 0.0, 0.0
        for axis in range(3):
            x, y = np.float64(points[i, axis]), np.float64(points[j, axis])
            dot, first, second = dot + x * y, first + x * x, second + y * y
        first, second = np.sqrt(first), np.sqrt(second)
        if dot < _SAME_DIRECTION * first * second or abs(first - second) < apart_m:
            continue
        near, far = (i, j) if first < second else (j, i)
        echo[near], echo[far] = Echo.NEARER, Echo.FARTHER
    return echo
