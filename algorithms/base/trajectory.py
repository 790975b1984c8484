"""Poses over time: interpolation, and motion compensation of every firing (paper, IV.C and V).

The paper gave a vertical scan the nearest horizontal scan's pose and left interpolation for the
future; here every firing has the pose of its own time.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan

KNOTS = 17
"""Number of poses within a scan, 6 ms apart in one of 0.1 s; firings are interpolated linearly."""
GAP_PERIODS = 2.5
"""Duration of a gap in median periods: a single scan or message may be lost without one."""
EXTRAPOLATE_NS = 300_000_000
"""Maximum time of a vertical scan before or after the odometry; others are skipped."""


def gaps(stamp_ns: IntArray) -> IntArray:
    """Indices (k,) of the increasing times (n,) that a gap follows."""
    steps = np.diff(stamp_ns)
    if not len(steps):
        return np.zeros(0, np.int64)
    return np.flatnonzero(steps > GAP_PERIODS * np.median(steps))


@dataclass(frozen=True)
class Trajectory:
    """Poses of the base in the map.

    stamp_ns: (n,) int64, strictly increasing.
    T_map_base: (n, 4, 4) float64.
    gap_ns: between poses farther apart, the motion is unknown; None: it is known everywhere.
    """

    stamp_ns: IntArray
    T_map_base: FloatArray
    gap_ns: float | None = None

    def __post_init__(self) -> None:
        if len(self.stamp_ns) != len(self.T_map_base):
            raise ValueError(f"{len(self.stamp_ns)} stamps for {len(self.T_map_base)} poses")
        if np.any(np.diff(self.stamp_ns) <= 0):
            raise ValueError("the stamps of a trajectory must increase")

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def covers(self, stamp_ns: IntArray, margin_ns: int = 0) -> BoolArray:
        """Whether times are within the trajectory, or at most `margin_ns` outside.

        In a gap: at most the smaller of `margin_ns` and half of `gap_ns` from a pose.
        """
        if not len(self):
            return np.zeros(np.shape(stamp_ns), bool)
        first_ns, last_ns = self.stamp_ns[0] - margin_ns, self.stamp_ns[-1] + margin_ns
        within = (stamp_ns >= first_ns) & (stamp_ns <= last_ns)
        if self.gap_ns is None or len(self) == 1:
            return np.asarray(within)
        after = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 1, len(self) - 1)
        before_ns, after_ns = self.stamp_ns[after - 1], self.stamp_ns[after]
        nearest_ns = np.minimum(stamp_ns - before_ns, after_ns - stamp_ns)
        near = nearest_ns <= min(margin_ns, self.gap_ns / 2)
        return np.asarray(within & (near | (after_ns - before_ns <= self.gap_ns)))

    def at(self, stamp_ns: IntArray) -> FloatArray:
        """T_map_base (m, 4, 4) at any times: positions linearly, rotations by slerp.

        Beyond either end, and within a gap, the motion of the two nearest poses is extrapolated.
        """
        stamps = np.asarray(stamp_ns, np.int64)
        if len(self) == 0:
            raise ValueError("an empty trajectory has no pose")
        if len(self) == 1:
            return np.broadcast_to(self.T_map_base[0], (len(stamps), 4, 4)).copy()
        after = np.clip(np.searchsorted(self.stamp_ns, stamps, side="right"), 1, len(self) - 1)
        if self.gap_ns is not None:
            span = self.stamp_ns[after] - self.stamp_ns[after - 1]
            late = 2 * (stamps - self.stamp_ns[after - 1]) > span
            step = np.where(span > self.gap_ns, np.where(late, 1, -1), 0)
            after = np.clip(after + step, 1, len(self) - 1)
        before = after - 1
        span = (self.stamp_ns[after] - self.stamp_ns[before]).astype(np.float64)
        fraction = (stamps - self.stamp_ns[before]) / span
        return transforms.interpolated(self.T_map_base[before], self.T_map_base[after], fraction)

    def part(self, first: int, last: int) -> "Trajectory":
        """The poses first to last, exclusive."""
        poses = self.T_map_base[first:last]
        return replace(self, stamp_ns=self.stamp_ns[first:last], T_map_base=poses)

    def moved(self, T_new_map: FloatArray) -> "Trajectory":
        """The same trajectory in another map frame."""
        return replace(self, T_map_base=T_new_map @ self.T_map_base)


@dataclass(frozen=True)
class PlacedScan:
    """A scan with every firing at the pose of its own time, in the frame `level`.

    level: gravity-aligned; its origin is on the floor below the base at the scan's reference time
        (the middle of the sweep), its x axis along the base's heading.

    points_level: (n, 3) float32, metres.
    origin_level: (3,) the sensor's position at the reference time.
    down_sensor: (3,) unit vector, gravity in the sensor's frame at the reference time.
    T_map_level: (4, 4), a rotation about z and a translation.
    T_map_base: (4, 4) at the reference time.
    """

    points_level: FloatArray
    origin_level: FloatArray
    down_sensor: FloatArray
    T_map_level: FloatArray
    T_map_base: FloatArray

    def to_map(self, points_level: FloatArray) -> FloatArray:
        """Points (m, 3) from the level frame to the map."""
        return transforms.apply(self.T_map_level, points_level)


def seen_at_once(
    scan: Scan, trajectory: Trajectory, T_base_sensor: FloatArray, edge_tan: FloatArray
) -> Scan:
    """Remove the motion: all returns as seen from the pose at the reference time, without times.

    Neighbours in angle are then neighbours in space, however far the sensor moved.

    edge_tan: (rings - 1,) tangents of the elevations between rings; a return's new ring follows.
    """
    if scan.time_ns is None:
        return scan
    T_map_sensor = _at_knots(scan, trajectory) @ T_base_sensor
    points = _place(scan, transforms.invert(T_map_sensor[-1]) @ T_map_sensor[:-1])
    level_m = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-6)
    ring = np.searchsorted(edge_tan, points[:, 2] / level_m).astype(np.uint16)
    return replace(scan, points_sensor=points, ring=ring, time_ns=None, start_ns=scan.reference_ns)


def place_scan(
    scan: Scan,
    trajectory: Trajectory,
    T_base_sensor: FloatArray,
    base_height_m: float | None = None,
) -> PlacedScan:
    """Put every firing at the pose of its own time (paper, V: "interpolate the ... Lidar pose").

    Without times, all firings have the pose at the scan's stamp.

    base_height_m: height of the base above the floor; None: the floor is at height 0.
    """
    T_map_base = _at_knots(scan, trajectory)
    T_map_level = level_frame(T_map_base[-1], base_height_m)
    T_level_sensor = transforms.invert(T_map_level) @ T_map_base @ T_base_sensor
    return PlacedScan(
        points_level=_place(scan, T_level_sensor[:-1]),
        origin_level=T_level_sensor[-1, :3, 3],
        down_sensor=-T_level_sensor[-1, 2, :3],
        T_map_level=T_map_level,
        T_map_base=T_map_base[-1],
    )


def level_frame(T_map_base: FloatArray, base_height_m: float | None) -> FloatArray:
    """T_map_level (4, 4) of a scan by its pose at the reference time; see `place_scan`."""
    x, y, z = T_map_base[:3, 3]
    floor_m = 0.0 if base_height_m is None else z - base_height_m
    return transforms.from_yaw(transforms.yaw_of(T_map_base), [x, y, floor_m])


def _at_knots(scan: Scan, trajectory: Trajectory) -> FloatArray:
    """T_map_base (KNOTS + 1, 4, 4) evenly from first to last firing, and at the reference time."""
    knots_ns = scan.start_ns + np.linspace(0, scan.end_ns - scan.start_ns, KNOTS).astype(np.int64)
    return trajectory.at(np.append(knots_ns, scan.reference_ns))


def _place(scan: Scan, T_target_sensor: FloatArray) -> FloatArray:
    """Points (n, 3) float32, each by the interpolated pose of its firing; knots (KNOTS, 4, 4)."""
    time_ns = scan.time_ns if scan.time_ns is not None else np.zeros(len(scan), np.int64)
    knots_per_ns = (KNOTS - 1) / float(max(scan.end_ns - scan.start_ns, 1))
    T = np.ascontiguousarray(T_target_sensor)
    return np.asarray(_interpolate(scan.points_sensor, time_ns, knots_per_ns, T))


@numba.njit(cache=True, nogil=True)
def _interpolate(
    points: FloatArray, time_ns: IntArray, knots_per_ns: float, T: FloatArray
) -> FloatArray:
    placed = np.empty((len(points), 3), np.float32)
    last = len(T) - 1
    step = T[1:] - T[:-1]
    for i in range(len(points)):
        position = time_ns[i] * knots_per_ns
        k = min(max(int(position), 0), last - 1)
        b = position - k
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        for row in range(3):
            at_knot = T[k, row, 0] * x + T[k, row, 1] * y + T[k, row, 2] * z + T[k, row, 3]
            on = step[k, row, 0] * x + step[k, row, 1] * y + step[k, row, 2] * z + step[k, row, 3]
            placed[i, row] = at_knot + b * on
    return placed
