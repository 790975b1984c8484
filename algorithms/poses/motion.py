"""Motion of a lidar between scans: how far it may change, extrapolation, and its compensation.

A motion is a twist per nanosecond (6,): rotation vector (rad) and translation (m) in the sensor's
frame.
"""

from typing import NamedTuple

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan

_STEP_NS = 100_000_000
"""The usual time between scans; a motion is extrapolated in such steps, along its arc."""
_CHANGE_DEG, _CHANGE_M = 6.0, 0.15
"""Maximum change of motion from one step to the next. A robot that brakes from a quick turn changes
it by 3°, a lidar in the hand by up to 6°; the rest is noise."""
_CHANGE_DEG_S, _CHANGE_M_S = 90.0, 2.0
"""Maximum further change per second of what a robot, or who carries a lidar, does unexpectedly."""


class Change(NamedTuple):
    """Maximum difference between two poses."""

    degrees: float
    metres: float

    def share_of(self, twist: FloatArray) -> float:
        """A difference (6,) as a share of the maximum."""
        turn_deg, way_m = np.degrees(np.linalg.norm(twist[:3])), np.linalg.norm(twist[3:])
        return float(max(turn_deg / self.degrees, way_m / self.metres))

    def share_between(self, T_expected: FloatArray, T_found: FloatArray) -> float:
        """The difference between two poses (4, 4) as a share of the maximum."""
        return self.share_of(transforms.to_twist(transforms.invert(T_expected) @ T_found))


def may_change(elapsed_ns: int) -> Change:
    """How far a scan may be from where the motion until so long ago leads."""
    further_s = max(elapsed_ns - _STEP_NS, 0) * 1e-9
    return Change(_CHANGE_DEG + _CHANGE_DEG_S * further_s, _CHANGE_M + _CHANGE_M_S * further_s)


def extrapolate(T: FloatArray, motion_per_ns: FloatArray, elapsed_ns: int) -> FloatArray:
    """The pose (4, 4) that a motion leads to, along its arc."""
    steps = max(round(elapsed_ns / _STEP_NS), 1)
    step = transforms.from_twist(motion_per_ns * elapsed_ns / steps)
    if steps == 1:
        return np.asarray(T @ step)
    return transforms.orthonormal(T @ np.linalg.matrix_power(step, steps))


def seen_at(
    stamp_ns: int,
    scan: Scan,
    motion_per_ns: FloatArray,
    range_m: tuple[float, float],
    points_max: int,
    T_sensor_own: FloatArray | None = None,
) -> FloatArray:
    """A scan's returns (n, 3) float64, thinned, as seen at one time from a moving sensor.

    range_m: minimum and maximum of the returns that are used. points_max: their number, about.
    T_sensor_own: (4, 4) to the sensor whose motion is given, from the scan's own; None: they are
    the same.

    The rotation within a sweep is small: two terms of its series are exact to a millimetre.
    """
    # Of an even number of emitters that fire in turn, an even stride would leave most out.
    stride = len(scan) // points_max | 1
    points: FloatArray = scan.points_sensor[::stride].astype(np.float64)
    kept_m = np.linalg.norm(points, axis=1)
    kept = (kept_m > range_m[0]) & (kept_m < range_m[1])
    points = points[kept]
    if T_sensor_own is not None:
        points = transforms.apply(T_sensor_own, points)
    if scan.time_ns is None:
        return points
    late_ns = (scan.start_ns + scan.time_ns[::stride][kept] - stamp_ns)[:, None]
    turned = np.cross(late_ns * motion_per_ns[:3], points)
    turned_twice = np.cross(late_ns * motion_per_ns[:3], turned)
    return np.asarray(points + turned + 0.5 * turned_twice + late_ns * motion_per_ns[3:])
