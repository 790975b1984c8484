"""Where a lidar sits, from how it and another one move and from what both see."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.hand_eye import align_rotations, find_extrinsics

UP = np.array([0.0, 0.0, 1.0])
MOUNTS = [
    transforms.make_transform(Rotation.from_euler("xyz", angles, degrees=True), shift)
    for angles, shift in (
        ([90, 0, 0], [0.3, 0, -0.4]),
        ([95, 10, 70], [-0.2, 0.5, 0.6]),
        ([-80, 0, 200], [0.0, -0.8, 0.9]),
    )
]
ROOM = np.array([7.0, 4.0, 2.8])


def turning(turn_rad: float) -> Trajectory:
    """Four seconds ahead, in a bend to and fro."""
    share = np.linspace(0.0, 1.0, 41)
    T = [transforms.from_yaw(turn_rad * np.sin(2 * np.pi * s), [2.0 + 2.5 * s, 1.5 + s, 0.5]) for s in share]
    return Trajectory(100_000_000 * (1 + np.arange(41)), np.array(T))


def moved_along(base: Trajectory, T_base_sensor: FloatArray, noise_deg: float) -> Trajectory:
    """What the sensor's own odometry says: from where it began, and with seeded noise."""
    T = transforms.invert(base.T_map_base[0] @ T_base_sensor) @ base.T_map_base @ T_base_sensor
    rng = np.random.default_rng(3)
    turns = Rotation.from_rotvec(np.radians(noise_deg) * rng.normal(size=(len(T), 3)))
    return Trajectory(base.stamp_ns, T @ np.array([transforms.make_transform(turn, np.zeros(3)) for turn in turns]))


def walls(room: FloatArray, count: int, seed: int) -> FloatArray:
    """(n, 3) places spread over the six sides of a room, and over a pillar in it that no turn maps on itself."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 1.0, (count, 3)) * room
    side = rng.integers(0, 3, count)
    places[np.arange(count), side] = np.where(rng.uniform(size=count) < 0.5, 0.0, room[side])
    pillar = np.array([0.8, 2.2, 0.0]) + rng.uniform(0.0, 1.0, (count // 8, 3)) * np.array([0.5, 0.0, room[2]])
    return np.concatenate([places, pillar])


def scan_of(points_map: FloatArray, T_map_sensor: FloatArray, stamp_ns: int) -> Scan:
    points = transforms.apply(transforms.invert(T_map_sensor), points_map).astype(np.float32)
    count = len(points)
    index = np.arange(count, dtype=np.int32)
    return Scan(points, np.zeros(count, np.uint16), 16, None, stamp_ns, stamp_ns, index, count)


def scans_along(base: Trajectory, T_base_sensor: FloatArray, room: FloatArray) -> list[Scan]:
    return [
        scan_of(walls(room, 1500, k), base.T_map_base[k] @ T_base_sensor, int(base.stamp_ns[k]))
        for k in range(0, 41, 2)
    ]


@pytest.mark.parametrize("T_base_sensor", MOUNTS)
def test_turns_tell_which_way_a_lidar_is_up(T_base_sensor: FloatArray) -> None:
    base = turning(1.0)
    aligned = align_rotations(base, moved_along(base, T_base_sensor, 0.1))
    assert aligned is not None
    rotation, axis = aligned
    np.testing.assert_allclose(np.abs(axis @ UP), 1.0, atol=1e-3)
    np.testing.assert_allclose(rotation @ T_base_sensor[:3, :3].T @ UP, UP, atol=0.03)


def test_a_straight_drive_tells_nothing() -> None:
    base = turning(0.02)
    assert align_rotations(base, moved_along(base, MOUNTS[0], 0.0)) is None
    still = Trajectory(base.stamp_ns[:2], base.T_map_base[:2])
    assert align_rotations(still, still) is None


@pytest.mark.parametrize("T_base_sensor", MOUNTS)
def test_a_mount_is_found_from_nothing(T_base_sensor: FloatArray) -> None:
    base = turning(1.0)
    aligned = align_rotations(base, moved_along(base, T_base_sensor, 0.1))
    assert aligned is not None
    found = find_extrinsics(walls(ROOM, 30_000, 99), base, scans_along(base, T_base_sensor, ROOM), *aligned)
    assert found is not None
    off = transforms.to_twist(transforms.invert(T_base_sensor) @ found.T_base_sensor)
    assert np.degrees(np.linalg.norm(off[:3])) < 5.0
    assert np.linalg.norm(off[3:]) < 0.15
    assert found.hits > 0.5
    assert found.rival_hits < 0.9 * found.hits


def test_what_a_square_hall_does_not_tell_is_told() -> None:
    """From the middle, turned by 90 degrees it looks the same."""
    hall = np.array([4.0, 4.0, 2.8])
    rng = np.random.default_rng(0)
    share = np.linspace(0.0, 1.0, 41)
    base = Trajectory(
        100_000_000 * (1 + np.arange(41)),
        np.array([transforms.from_yaw(np.sin(2 * np.pi * s), [2.0, 2.0, 0.5]) for s in share]),
    )
    sides = walls(hall, 30_000, 99)[:30_000]  # without the pillar
    T_base_sensor = transforms.make_transform(Rotation.from_euler("x", 90, degrees=True), [0.0, 0.0, 0.2])
    scans = [
        scan_of(sides[rng.integers(0, len(sides), 1500)], base.T_map_base[k] @ T_base_sensor, int(base.stamp_ns[k]))
        for k in range(0, 41, 2)
    ]
    aligned = align_rotations(base, moved_along(base, T_base_sensor, 0.0))
    assert aligned is not None
    found = find_extrinsics(sides, base, scans, *aligned)
    assert found is not None
    assert found.rival_hits > 0.95 * found.hits
    assert found.rival_deg % 90 == pytest.approx(0, abs=4.0) or found.rival_deg % 90 == pytest.approx(90, abs=4.0)


def test_without_returns_there_is_none() -> None:
    base = turning(1.0)
    assert find_extrinsics(np.zeros((0, 3)), base, scans_along(base, MOUNTS[0], ROOM), np.eye(3), UP) is None
    assert find_extrinsics(walls(ROOM, 100, 0), base, [], np.eye(3), UP) is None
