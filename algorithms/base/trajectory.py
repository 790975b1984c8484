"""Poses over time: interpolation and motion compensation of every firing (paper, IV.C and V).

The paper used the nearest horizontal scan's pose for a vertical scan and left interpolation for the future; here every
firing has the pose of its own time.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan
from ffmap.algorithms.base.settings import StepSettings

KNOTS = (
    17  # number of poses in a scan, 6 ms apart in one of 0.1 s; between them a firing's pose is interpolated linearly
)

GAP_PERIODS = 2.5
"""A longer step, in usual ones, is a gap: one scan or message may be lost, but more would be an event."""


def gaps(stamp_ns: IntArray) -> IntArray:
    """Places (k,) of the times (n,), in order, after which there is a gap."""
    steps = np.diff(stamp_ns)
    return np.flatnonzero(steps > GAP_PERIODS * np.median(steps)) if len(steps) else np.zeros(0, np.int64)


class TrajectorySettings(StepSettings):
    """Placing scans and levelling the map (paper, IV.C and V)."""

    level_s: float = Field(
        8.0, gt=0, le=60, description="Duration (s) from the start whose walls and floor level the map."
    )
    level_scan_max_deg: float = Field(
        1.0,
        ge=0,
        le=10,
        description="Maximum angle (degrees) by which a scan is turned to give its floor the slope of the map's; 0 turns none.",
    )
    extrapolate_s: float = Field(
        0.3, ge=0, description="Maximum time (s) of a vertical scan before or after the odometry; others are skipped."
    )


@dataclass(frozen=True)
class Trajectory:
    """Poses of the base in the map, in order of time.

    stamp_ns: (n,) int64, strictly increasing.
    T_map_base: (n, 4, 4) float64.
    gap_ns: poses farther apart do not show how the base moved between them; None where all do.
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
        """Whether each time lies within the trajectory, or at most `margin_ns` outside; in a gap, half of `gap_ns`."""
        if not len(self):
            return np.zeros(np.shape(stamp_ns), bool)
        within = (stamp_ns >= self.stamp_ns[0] - margin_ns) & (stamp_ns <= self.stamp_ns[-1] + margin_ns)
        if self.gap_ns is None or len(self) == 1:
            return np.asarray(within)
        after = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 1, len(self) - 1)
        before_ns, after_ns = self.stamp_ns[after - 1], self.stamp_ns[after]
        near = np.minimum(stamp_ns - before_ns, after_ns - stamp_ns) <= min(margin_ns, self.gap_ns / 2)
        return np.asarray(within & (near | (after_ns - before_ns <= self.gap_ns)))

    def at(self, stamp_ns: IntArray) -> FloatArray:
        """T_map_base (m, 4, 4) at any times: positions linearly, rotations by slerp.

        Beyond its ends, and those of a gap, the motion of the nearest two poses is carried on, for the first and last sweeps
        reach outside.
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
            after = np.clip(after + np.where(span > self.gap_ns, np.where(late, 1, -1), 0), 1, len(self) - 1)
        before = after - 1
        span = (self.stamp_ns[after] - self.stamp_ns[before]).astype(np.float64)
        fraction = (stamps - self.stamp_ns[before]) / span
        return transforms.interpolated(self.T_map_base[before], self.T_map_base[after], fraction)

    def part(self, first: int, last: int) -> "Trajectory":
        """The poses from one up to another, by their places."""
        return replace(self, stamp_ns=self.stamp_ns[first:last], T_map_base=self.T_map_base[first:last])

    def moved(self, T_new_map: FloatArray) -> "Trajectory":
        """The same trajectory seen from another map frame."""
        return replace(self, T_map_base=T_new_map @ self.T_map_base)


@dataclass(frozen=True)
class PlacedScan:
    """A scan with every firing at the pose of its own time, in the frame `level`.

    level: gravity-aligned; its origin lies on the floor that the base stands on at the scan's reference time (the middle
    of the sweep), as far as the pose tells, x along the base's heading there.

    points_level: (n, 3) float32, metres.
    origin_level: (3,) the sensor's place at the reference time.
    down_sensor: (3,) unit vector, gravity in the sensor's frame at the reference time.
    T_map_level: (4, 4), a turn about z and a shift.
    T_map_base: (4, 4) at the reference time.
    """

    points_level: FloatArray
    origin_level: FloatArray
    down_sensor: FloatArray
    T_map_level: FloatArray
    T_map_base: FloatArray

    def to_map(self, points_level: FloatArray) -> FloatArray:
        """Points (m, 3) of the level frame in the map's."""
        return transforms.apply(self.T_map_level, points_level)


def seen_at_once(scan: Scan, trajectory: Trajectory, T_base_sensor: FloatArray, edge_tan: FloatArray) -> Scan:
    """The scan that the sensor would have made in no time, where it is at the reference time: without times of firings.

    Its returns then lie about one place, however far the sensor moved, so that neighbours in angle are neighbours in space.

    edge_tan: (rings - 1,) tangents of the elevations between the rings; each return has the ring that it has from there.
    """
    if scan.time_ns is None:
        return scan
    T_map_sensor = _at_knots(scan, trajectory) @ T_base_sensor
    T_reference_sensor = transforms.invert(T_map_sensor[-1]) @ T_map_sensor[:-1]
    points = _place(scan.points_sensor, scan.time_ns, float(max(scan.end_ns - scan.start_ns, 1)), T_reference_sensor)
    level_m = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-6)
    ring = np.searchsorted(edge_tan, points[:, 2] / level_m).astype(np.uint16)
    return replace(scan, points_sensor=points, ring=ring, time_ns=None, start_ns=scan.reference_ns)


def place_scan(
    scan: Scan, trajectory: Trajectory, T_base_sensor: FloatArray, base_height_m: float | None = None
) -> PlacedScan:
    """Put every firing of a scan at the pose of its own time (paper, V: "interpolate the vertical Lidar pose").

    Without times all firings get the pose at the scan's stamp.

    base_height_m: how high the base stands above the floor, wherever that lies; None for a floor at height 0.
    """
    T_map_base = _at_knots(scan, trajectory)
    T_map_level = level_frame(T_map_base[-1], base_height_m)
    T_level_sensor = transforms.invert(T_map_level) @ T_map_base @ T_base_sensor
    time_ns = scan.time_ns if scan.time_ns is not None else np.zeros(0, np.int64)
    points_level = _place(
        scan.points_sensor,
        time_ns,
        float(max(scan.end_ns - scan.start_ns, 1)),
        np.ascontiguousarray(T_level_sensor[:-1]),
    )
    T_reference = T_level_sensor[-1]
    return PlacedScan(
        points_level=points_level,
        origin_level=T_reference[:3, 3],
        down_sensor=-T_reference[2, :3],
        T_map_level=T_map_level,
        T_map_base=T_map_base[-1],
    )


def _at_knots(scan: Scan, trajectory: Trajectory) -> FloatArray:
    """T_map_base (KNOTS + 1, 4, 4) evenly from the first to the last firing, and at the reference time."""
    knots_ns = scan.start_ns + np.linspace(0, scan.end_ns - scan.start_ns, KNOTS).astype(np.int64)
    return trajectory.at(np.append(knots_ns, scan.reference_ns))


def level_frame(T_map_base: FloatArray, base_height_m: float | None) -> FloatArray:
    """T_map_level (4, 4) of a scan with this pose (4, 4) at its reference time; base_height_m: as for `place_scan`."""
    x, y, z = T_map_base[:3, 3]
    floor_m = 0.0 if base_height_m is None else z - base_height_m
    return transforms.from_yaw(transforms.yaw_of(T_map_base), [x, y, floor_m])


@numba.njit(cache=True, nogil=True)
def _place(points: FloatArray, time_ns: IntArray, duration_ns: float, T: FloatArray) -> FloatArray:  # pragma: no cover
    placed = np.empty((len(points), 3), np.float32)
    timed = len(time_ns) == len(points)
    last = len(T) - 1
    per_ns = last / duration_ns
    step = T[1:] - T[:-1]
    for i in range(len(points)):
        position = time_ns[i] * per_ns if timed else 0.0
        k = min(max(int(position), 0), last - 1)
        b = position - k
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        for row in range(3):
            at_knot = T[k, row, 0] * x + T[k, row, 1] * y + T[k, row, 2] * z + T[k, row, 3]
            on = step[k, row, 0] * x + step[k, row, 1] * y + step[k, row, 2] * z + step[k, row, 3]
            placed[i, row] = at_knot + b * on
    return placed
