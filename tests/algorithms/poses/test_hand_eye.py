"""A lidar's extrinsics found by how it and another lidar move, and by what both see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.hand_eye import align_rotations, find_extrinsics
from tests.synthetic import scan_of

UP = np.array([0.0, 0.0, 1.0])
EXTRINSICS = [
    transforms.make_transform(Rotation.from_euler("xyz", angles, degrees=True), shift)
    for angles, shift in (
        ([90, 0, 0], [0.3, 0, -0.4]),
        ([95, 10, 70], [-0.2, 0.5, 0.6]),
        ([-80, 0, 200], [0.0, -0.8, 0.9]),
    )
]
ROOM = np.array([7.0, 4.0, 2.8])


def drive(turn_rad: float, way_m: tuple[float, float] = (2.5, 1.0)) -> Trajectory:
    """Four seconds ahead, in a bend to and fro."""
    poses = [
        transforms.from_yaw(
            turn_rad * np.sin(2 * np.pi * s), [2.0 + way_m[0] * s, 2.0 + way_m[1] * (s - 0.5), 0.5]
        )
        for s in np.linspace(0.0, 1.0, 41)
    ]
    return Trajectory(100_000_000 * (1 + np.arange(41)), np.array(poses))


def of_sensor(base: Trajectory, T_base_sensor: FloatArray, noise_deg: float) -> Trajectory:
    """The sensor's own odometry, with seeded noise."""
    T = transforms.invert(base.T_map_base[0] @ T_base_sensor) @ base.T_map_base @ T_base_sensor
    noise = np.random.default_rng(3).normal(0, np.radians(noise_deg), (len(T), 3))
    turns = [transforms.make_transform(Rotation.from_rotvec(turn)) for turn in noise]
    return Trajectory(base.stamp_ns, T @ np.array(turns))


def walls(room: FloatArray, count: int, seed: int, pillar: bool = True) -> FloatArray:
    """(n, 3) points on the six sides of a room, and on an asymmetric pillar in it."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 1.0, (count, 3)) * room
    side = rng.integers(0, 3, count)
    places[np.arange(count), side] = np.where(rng.uniform(size=count) < 0.5, 0.0, room[side])
    if not pillar:
        return places
    on_pillar = rng.uniform(0.0, 1.0, (count // 8, 3)) * np.array([0.5, 0.0, room[2]])
    return np.concatenate([places, np.array([0.8, 2.2, 0.0]) + on_pillar])


def scans_along(
    base: Trajectory, T_base_sensor: FloatArray, room: FloatArray, pillar: bool = True
) -> list[Scan]:
    scans = []
    for k in range(0, 41, 2):
        T_sensor_map = transforms.invert(base.T_map_base[k] @ T_base_sensor)
        points = transforms.apply(T_sensor_map, walls(room, 1500, k, pillar))
        scan = scan_of(points, np.zeros(len(points)), 16)
        scans.append(replace(scan, start_ns=int(base.stamp_ns[k])))
    return scans


@pytest.mark.parametrize("T_base_sensor", EXTRINSICS)
def test_extrinsics_are_found_without_a_guess(T_base_sensor: FloatArray) -> None:
    base = drive(1.0)
    aligned = align_rotations(base, of_sensor(base, T_base_sensor, 0.1))
    assert aligned is not None
    rotation, axis = aligned
    np.testing.assert_allclose(np.abs(axis @ UP), 1.0, atol=1e-3)
    np.testing.assert_allclose(rotation @ T_base_sensor[:3, :3].T @ UP, UP, atol=0.03)
    scans = scans_along(base, T_base_sensor, ROOM)
    found = find_extrinsics(walls(ROOM, 30_000, 99), base, scans, rotation, axis)
    assert found is not None
    off = transforms.to_twist(transforms.invert(T_base_sensor) @ found.T_base_sensor)
    assert np.degrees(np.linalg.norm(off[:3])) < 5.0
    assert np.linalg.norm(off[3:]) < 0.15
    assert found.hits > 0.5
    assert found.rival_hits < 0.9 * found.hits


def test_a_straight_drive_determines_nothing() -> None:
    base = drive(0.02)
    assert align_rotations(base, of_sensor(base, EXTRINSICS[0], 0.0)) is None
    still = base.part(0, 2)
    assert align_rotations(still, still) is None


def test_a_square_hall_has_a_rival() -> None:
    """From its middle, it looks the same in four directions."""
    hall = np.array([4.0, 4.0, 2.8])
    base = drive(1.0, way_m=(0.0, 0.0))
    turn = Rotation.from_euler("x", 90, degrees=True)
    T_base_sensor = transforms.make_transform(turn, [0.0, 0.0, 0.2])
    aligned = align_rotations(base, of_sensor(base, T_base_sensor, 0.0))
    assert aligned is not None
    scans = scans_along(base, T_base_sensor, hall, pillar=False)
    found = find_extrinsics(walls(hall, 30_000, 99, pillar=False), base, scans, *aligned)
    assert found is not None
    assert found.rival_hits > 0.95 * found.hits
    assert (found.rival_deg + 45) % 90 == pytest.approx(45, abs=4.0)


def test_without_returns_nothing_is_found() -> None:
    base = drive(1.0)
    scans = scans_along(base, EXTRINSICS[0], ROOM)
    assert find_extrinsics(np.zeros((0, 3)), base, scans, np.eye(3), UP) is None
    assert find_extrinsics(walls(ROOM, 100, 0), base, [], np.eye(3), UP) is None
