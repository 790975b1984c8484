"""The vertical lidar's place and clock, recovered from rooms that both lidars see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.poses.extrinsics import refine_extrinsics
from ffmap.algorithms.poses.patches import Patches
from tests.corridor import T_BASE_SENSOR, cast

PERIOD_NS = 100_000_000


def turning(scans: int) -> Trajectory:
    """On the spot, one way and back, and half a metre ahead."""
    share = np.linspace(0.0, 1.0, scans + 2)
    T = [transforms.from_yaw(1.2 * np.sin(2 * np.pi * s), [0.5 * s, 0.1 * s, 0.0]) for s in share]
    return Trajectory(PERIOD_NS * (1 + np.arange(scans + 2)), np.array(T))


def patches_of(points: FloatArray) -> Patches:
    return Patches.of(points, voxel_m=0.1, neighbours=16)


def at_one_instant(stamp_ns: int, trajectory: Trajectory, seed: int) -> Scan:
    """A sweep whose firings are all of one time."""
    T_map_base = trajectory.at(np.array([stamp_ns]))[0]
    scan, _ = cast(T_map_base @ T_BASE_SENSOR, None, 0.01, seed, firings=600)
    return replace(scan, start_ns=stamp_ns, stamp_ns=stamp_ns)


def seen(trajectory: Trajectory, scans: int) -> tuple[Patches, list[Scan]]:
    """Patches of the room as it is, and scans from all over the drive."""
    swept = [
        at_one_instant(int(trajectory.stamp_ns[k + 1]) + 30_000_000, trajectory, k)
        for k in range(scans)
    ]
    placed = [place_scan(scan, trajectory, T_BASE_SENSOR) for scan in swept]
    points = np.concatenate([p.to_map(p.points_level[::5]) for p in placed]).astype(np.float64)
    return patches_of(points[points[:, 2] < 1.9]), swept


@pytest.fixture(scope="module")
def room() -> tuple[Trajectory, Patches, list[Scan]]:
    trajectory = turning(24)
    return trajectory, *seen(trajectory, 24)


@pytest.mark.parametrize("seed", range(4))
def test_a_mount_and_a_clock_that_are_off_are_found(
    room: tuple[Trajectory, Patches, list[Scan]], seed: int
) -> None:
    """From 5 degrees, 10 cm and 50 ms on."""
    trajectory, patches, scans = room
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    T_given = (
        transforms.make_transform(Rotation.from_rotvec(np.radians(5) * axis), 0.1 * way)
        @ T_BASE_SENSOR
    )
    late_ns = 50_000_000 * (-1) ** seed
    late = [replace(scan, start_ns=scan.start_ns + late_ns) for scan in scans]
    found = refine_extrinsics(patches, trajectory, late, T_given, 20_000)
    assert found is not None
    off = transforms.to_twist(transforms.invert(T_BASE_SENSOR) @ found.T_base_sensor)
    assert np.degrees(np.linalg.norm(off[:3])) < 0.1
    assert np.linalg.norm(off[3:]) < 0.01
    assert found.clock_s == pytest.approx(-late_ns / 1e9, abs=0.002)
    assert found.rms_after_m < 0.02 < found.rms_before_m
    # It says no more than it knows.
    turned = transforms.to_twist(found.T_base_sensor @ transforms.invert(T_BASE_SENSOR))[:3]
    assert np.all(np.abs(turned) < 4 * found.sigma[:3])
    assert abs(found.clock_s + late_ns / 1e9) < 4 * found.sigma[6]
    change = found.change(T_given)
    assert np.degrees(np.linalg.norm(change[:3])) == pytest.approx(5.0, abs=0.15)
    assert change[6] == found.clock_s


def test_on_a_straight_way_a_clock_is_not_known(
    room: tuple[Trajectory, Patches, list[Scan]],
) -> None:
    """It does what a shift along the way does."""
    T = np.tile(np.eye(4), (26, 1, 1))
    T[:, 0, 3] = 0.06 * np.arange(26)
    straight = Trajectory(PERIOD_NS * (1 + np.arange(26)), T)
    found = refine_extrinsics(
        *(lambda p, s: (p, straight, s))(*seen(straight, 24)), T_BASE_SENSOR, 20_000
    )
    turned = refine_extrinsics(room[1], room[0], room[2], T_BASE_SENSOR, 20_000)
    assert found is not None
    assert turned is not None
    assert found.sigma[6] > 3 * turned.sigma[6]


def test_at_rest_a_clock_is_unknown(room: tuple[Trajectory, Patches, list[Scan]]) -> None:
    """Nothing that a robot at rest sees depends on it: it keeps next to all of the second that it was unknown by."""
    rest = Trajectory(PERIOD_NS * (1 + np.arange(26)), np.tile(np.eye(4), (26, 1, 1)))
    patches, scans = seen(rest, 24)
    found = refine_extrinsics(patches, rest, scans, T_BASE_SENSOR, 20_000)
    assert found is not None
    assert found.sigma[6] == pytest.approx(1.0, abs=0.05)
    assert np.all(found.sigma[:6] < 0.05)


def test_too_little_tells_nothing(room: tuple[Trajectory, Patches, list[Scan]]) -> None:
    trajectory, patches, scans = room
    assert refine_extrinsics(patches, trajectory, [], T_BASE_SENSOR, 20_000) is None
    assert (
        refine_extrinsics(patches_of(np.zeros((0, 3))), trajectory, scans, T_BASE_SENSOR, 20_000)
        is None
    )
    assert (
        refine_extrinsics(patches_of(np.zeros((5, 3))), trajectory, scans, T_BASE_SENSOR, 20_000)
        is None
    )
    far = transforms.make_transform(translation=[300.0, 0.0, 0.0])
    assert refine_extrinsics(patches, trajectory, scans, far @ T_BASE_SENSOR, 20_000) is None
