"""A furnished room with a door, scanned by a vertical 32-ring lidar: small, exact, seeded."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, ScanSettings
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.doors import DoorsSettings
from ffmap.algorithms.scan.labelling import MethodSettings
from ffmap.algorithms.scan.rearrangement import RearrangementSettings
from ffmap.algorithms.scan.smoothing import SmoothingSettings, smooth_ranges
from ffmap.algorithms.scan.vertical_structures import VerticalStructuresSettings
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings

RINGS = 32
LOW_M = np.array([-6.0, -2.5, 0.0])
HIGH_M = np.array([6.0, 2.0, 2.8])
DOOR_X_M = (0.4, 1.3)
DOOR_HEAD_M = 2.1
DOOR_DEPTH_M = 0.08
TABLE_M = np.array([[-1.5, 1.1, 0.0], [0.3, 1.8, 0.75]])
T_BASE_SENSOR = transforms.make_transform(
    Rotation.from_euler("y", 90, degrees=True), [0.0, 0.0, 1.0]
)


class Box(NamedTuple):
    """Corners (3,) of a box, and of boxes inside (k, 2, 3)."""

    low_m: FloatArray
    high_m: FloatArray
    inside_m: FloatArray = np.zeros((0, 2, 3))


def settings() -> MethodSettings:
    return MethodSettings(
        ScanSettings(),
        SmoothingSettings(),
        RearrangementSettings(),
        VerticalStructuresSettings(),
        WallPlanesSettings(),
        DoorsSettings(),
    )


def stamp_ns(index: int) -> int:
    return 1_700_000_000_000_000_000 + 100_000_000 * index


def trajectory(scan_count: int) -> Trajectory:
    """Along the room's x axis, 5 cm a scan, 10 scans a second."""
    T_map_base = np.broadcast_to(np.eye(4), (scan_count, 4, 4)).copy()
    T_map_base[:, 0, 3] = 0.05 * np.arange(scan_count)
    return Trajectory(stamp_ns(0) + 100_000_000 * np.arange(scan_count), T_map_base)


def level(scan: Scan, trajectory: Trajectory) -> LevelledScan:
    """The smoothed scan in its place."""
    ranges, settings = smooth_ranges(scan, SmoothingSettings()), RearrangementSettings()
    return place_and_level(scan, ranges, trajectory, T_BASE_SENSOR, 0.0, np.zeros(2), settings)


def scan_of(points_sensor: FloatArray, ring: IntArray, ring_count: int) -> Scan:
    """A scan of points and their emitters, without times."""
    points, count = points_sensor.astype(np.float32), len(points_sensor)
    index = np.arange(count, dtype=np.int32)
    return Scan(points, ring.astype(np.uint16), ring_count, None, 0, 0, index, count)


def scan(index: int = 0, firings: int = 2170, seed: int = 0) -> Scan:
    """A scan on that trajectory: 32 returns a firing, 5 mm of noise, ranges in steps of 2 mm."""
    # Half a step off, for a ray that is parallel to a wall meets it nowhere.
    azimuth = np.repeat((np.arange(firings) + 0.5) * 2 * np.pi / firings, RINGS)
    ring = np.tile(np.arange(RINGS, dtype=np.uint16), firings)
    elevation = np.radians(np.linspace(-30.67, 10.67, RINGS))[ring]
    flat, up = np.cos(elevation), np.sin(elevation)
    rays_sensor = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], axis=1)
    range_m = _cast(np.array([0.05 * index, 0.0, 1.0]), rays_sensor @ T_BASE_SENSOR[:3, :3].T)
    range_m += np.random.default_rng((seed, index)).normal(0, 0.005, len(range_m))
    points_sensor = rays_sensor * (np.round(range_m / 0.002) * 0.002)[:, None]
    stamp = stamp_ns(index)
    return replace(scan_of(points_sensor, ring, RINGS), start_ns=stamp, stamp_ns=stamp)


def _cast(origin: FloatArray, rays: FloatArray) -> FloatArray:
    """Range of each ray inside the room."""
    range_m = ranges(origin, rays, Box(LOW_M, HIGH_M, TABLE_M[None]))
    hit = origin + rays * range_m[:, None]
    door = (hit[:, 1] < LOW_M[1] + 1e-9) & (rays[:, 1] < 0) & (hit[:, 2] < DOOR_HEAD_M)
    door &= (hit[:, 0] > DOOR_X_M[0]) & (hit[:, 0] < DOOR_X_M[1])
    range_m[door] += DOOR_DEPTH_M / -rays[door, 1]
    return range_m


def ranges(origin: FloatArray, rays: FloatArray, box: Box) -> FloatArray:
    """Range of each ray in a box."""
    low_m, high_m, inside_m = box
    with np.errstate(divide="ignore"):
        nearest = np.where(rays > 0, (high_m - origin) / rays, (low_m - origin) / rays).min(axis=1)
    for thing in inside_m:
        to_faces = (thing[:, None] - origin) / rays
        near, far = to_faces.min(axis=0).max(axis=1), to_faces.max(axis=0).min(axis=1)
        nearest = np.where((near < far) & (near > 0) & (near < nearest), near, nearest)
    return nearest


def drive_in_a_room(
    height_m: float = 0.7, ceiling_m: float = 2.6, clouds: int = 8
) -> list[np.ndarray]:
    """Clouds (n, 3), z up, of a lidar that turns and moves through a room of 6 × 8 m."""
    rng = np.random.default_rng(0)
    low, high = np.array([-3.0, -4.0, 0.0]), np.array([3.0, 4.0, ceiling_m])
    seen = []
    for i in range(clouds):
        origin = np.array([*rng.uniform(low[:2] / 2, high[:2] / 2), height_m])
        rays = rng.normal(size=(4000, 3))
        reach = ranges(origin, rays, Box(low, high))
        turn = transforms.from_yaw(0.7 * i, [0.0, 0.0, 0.0])[:3, :3]
        seen.append((rays * reach[:, None] + rng.normal(0, 0.01, (4000, 3))) @ turn.T)
    return seen
