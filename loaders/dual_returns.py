"""Firings that return twice, of which the farther return is read.

Drivers put both returns of a firing into one cloud (Velodyne's and Hesai's drivers, Nebula, packets): two points of
one ring, one time and one azimuth. Fields that number the returns (`return_type`, `return_mode`, bits of Livox's
`tag`) differ from driver to driver and are not needed.
"""

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

PAIRS_MIN = 20
"""Minimum number of firings that return twice, over all sampled clouds. Fewer are chance."""
APART_M = 0.1
"""Returns of a firing that are nearer to each other show one surface, and not that firings return twice."""
_SAME_AZIMUTH = 1.0 - 1e-6  # Cosine: 0.08°, less than the step from one firing to the next


def nearer_returns(
    points_sensor: FloatArray, ring: IntArray, time_ns: IntArray, apart_m: float = 0.0
) -> BoolArray:
    """Find the nearer of two returns of a firing, (n,); of two equal ones the second.

    Args:
        points_sensor: (n, 3).
        ring, time_ns: (n,), of each firing.
        apart_m: minimum distance between the two.
    """
    order = np.lexsort((time_ns, ring))
    first, second = order[:-1], order[1:]
    alike = (ring[first] == ring[second]) & (time_ns[first] == time_ns[second])
    first, second = first[alike], second[alike]
    a, b = points_sensor[first].astype(np.float64), points_sensor[second].astype(np.float64)
    range_a, range_b = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    # Not of the elevation: where a beam leaves the sensor off its center, the elevation depends on the range.
    across = np.linalg.norm(a[:, :2], axis=1) * np.linalg.norm(b[:, :2], axis=1)
    pair = np.einsum("ij,ij->i", a[:, :2], b[:, :2]) >= _SAME_AZIMUTH * across
    pair &= np.abs(range_a - range_b) >= apart_m
    nearer = np.zeros(len(ring), bool)
    nearer[np.where(range_a < range_b, first, second)[pair]] = True
    return nearer
