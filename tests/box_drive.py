"""A lidar of 16 rings that is driven through a box with pillars along a known way."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.poses.odometry import OdometrySettings, Registration, register_scans
from ffmap.algorithms.poses.refinement import RefinementSettings
from tests.synthetic import Box, ranges

PERIOD_NS = 100_000_000
T_BASE_HORIZONTAL = transforms.make_transform(None, [0.0, 0.0, 1.0])
T_BASE_VERTICAL = transforms.make_transform(
    Rotation.from_euler("y", 90, degrees=True), [0.1, 0.0, 0.8]
)
T_HORIZONTAL_VERTICAL = transforms.invert(T_BASE_HORIZONTAL) @ T_BASE_VERTICAL

Way = Callable[[float], FloatArray]
Given = tuple[int, Scan, Scan | None]


BOX = Box(
    np.array([-5.0, -3.0, 0.0]),
    np.array([7.0, 3.5, 2.8]),
    np.array([[[-3.0, 1.5, 0.0], [-2.6, 1.9, 2.8]], [[2.0, -2.2, 0.0], [2.5, -1.7, 2.8]]]),
)
CORRIDOR = Box(np.array([-300, -1.2, 0]), np.array([300, 1.2, 2.8]))


def gentle_curve(time_s: float) -> FloatArray:
    """T_map_base: half a second at rest, then 0.6 m/s in a gentle curve."""
    driven = max(time_s - 0.5, 0.0)
    yaw = 0.15 * driven
    return transforms.from_yaw(
        yaw, [0.6 * driven * np.cos(yaw / 2), 0.6 * driven * np.sin(yaw / 2), 0]
    )


def sweep(
    index: int,
    T_base_sensor: FloatArray = T_BASE_HORIZONTAL,
    seed: int = 1,
    shift_ns: int = 0,
    way: Way = gentle_curve,
    box: Box = BOX,
) -> Scan:
    """Every firing at its own time and pose, with 1 cm of noise."""
    firings, rings = 600, 16
    azimuth = np.repeat((np.arange(firings) + 0.5) * 2 * np.pi / firings, rings)
    elevation = np.tile(np.radians(np.linspace(-15, 15, rings)), firings)
    level = np.cos(elevation)
    rays = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    start_ns = index * PERIOD_NS + shift_ns
    time_ns = np.repeat(np.arange(firings) * PERIOD_NS // firings, rings)
    fired_s = (start_ns + time_ns[::rings]) * 1e-9
    T = np.repeat([way(float(at)) @ T_base_sensor for at in fired_s], rings, axis=0)
    range_m = ranges(T[:, :3, 3], np.einsum("nij,nj->ni", T[:, :3, :3], rays), box)
    range_m += np.random.default_rng((seed, index)).normal(0, 0.01, len(range_m))
    return Scan(
        points_sensor=(rays * range_m[:, None]).astype(np.float32),
        ring=np.tile(np.arange(rings, dtype=np.uint16), firings),
        ring_count=rings,
        time_ns=time_ns.astype(np.int64),
        start_ns=start_ns,
        stamp_ns=start_ns,
        cloud_index=np.arange(len(rays), dtype=np.int32),
        cloud_size=len(rays),
    )


def later(scan: Scan, by_ns: int) -> Scan:
    return replace(scan, start_ns=scan.start_ns + by_ns, stamp_ns=scan.stamp_ns + by_ns)


def registered(scans: list[Scan], **refinement: bool) -> list[Registration]:
    given = [(i, scan, None) for i, scan in enumerate(scans)]
    settings = OdometrySettings(), RefinementSettings(**refinement)
    return list(register_scans(given, *settings, None, T_BASE_HORIZONTAL))


def true_pose(stamp_ns: float, way: Way = gentle_curve) -> FloatArray:
    return way(stamp_ns * 1e-9) @ T_BASE_HORIZONTAL


def errors(
    T_found: list[FloatArray], T_true: list[FloatArray], first: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Metres and degrees from the true poses, both relative to the first."""
    found, true = np.array(T_found), np.array(T_true)
    T_true_rel = transforms.invert(true[first]) @ true
    off = transforms.invert(T_true_rel) @ transforms.invert(found[first]) @ found
    turned_rad = Rotation.from_matrix(off[:, :3, :3]).magnitude()
    return np.linalg.norm(off[:, :3, 3], axis=1), np.degrees(turned_rad)


def errors_of(found: list[Registration], way: Way = gentle_curve) -> tuple[FloatArray, FloatArray]:
    true = [true_pose(registration.stamp_ns, way) for registration in found]
    return errors([registration.T_odom_sensor for registration in found], true)
