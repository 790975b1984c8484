"""The vertical lidar's extrinsics and clock, refined in a corridor that both lidars see."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.poses.extrinsics import refine_extrinsics, surfaces_agreement
from ffmap.algorithms.poses.patches import Patches
from tests.corridor import T_BASE_SENSOR, cast

PERIOD_NS, SCANS = 100_000_000, 24
Seen = tuple[Patches, Trajectory, list[Scan]]


def drive(turn_rad: float, way_m: float) -> Trajectory:
    share = np.linspace(0.0, 1.0, SCANS + 2)
    yaw = turn_rad * np.sin(2 * np.pi * share)
    poses = zip(yaw, share, strict=True)
    T = [transforms.from_yaw(y, [way_m * s, 0.2 * way_m * s, 0.0]) for y, s in poses]
    return Trajectory(PERIOD_NS * (1 + np.arange(SCANS + 2)), np.array(T))


def seen(trajectory: Trajectory) -> Seen:
    """The corridor's patches, and scans whose firings are all of one time, along a drive."""
    scans, points = [], []
    for k in range(SCANS):
        stamp_ns = int(trajectory.stamp_ns[k + 1]) + 30_000_000
        T_map_base = trajectory.at(np.array([stamp_ns]))[0]
        scan, _ = cast(T_map_base @ T_BASE_SENSOR, None, 0.01, k, firings=600)
        scans.append(replace(scan, start_ns=stamp_ns, stamp_ns=stamp_ns))
        placed = place_scan(scans[-1], trajectory, T_BASE_SENSOR)
        points.append(placed.to_map(placed.points_level[::5]))
    mapped = np.concatenate(points).astype(np.float64)
    return Patches.of(mapped[mapped[:, 2] < 1.9], 0.1, 16), trajectory, scans


@pytest.fixture(scope="module")
def turning() -> Seen:
    """On the spot, one way and back, and half a metre ahead."""
    return seen(drive(1.2, 0.5))


@pytest.mark.parametrize("seed", range(4))
def test_extrinsics_and_clock_are_refined(turning: Seen, seed: int) -> None:
    """From 5 degrees, 10 cm and 50 ms."""
    patches, trajectory, scans = turning
    rng = np.random.default_rng(seed)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(5) * axis)
    T_given = transforms.make_transform(turn, 0.1 * way) @ T_BASE_SENSOR
    late_ns = 50_000_000 * (-1) ** seed
    late = [replace(scan, start_ns=scan.start_ns + late_ns) for scan in scans]
    found = refine_extrinsics(patches, trajectory, late, T_given)
    assert found is not None
    off = transforms.to_twist(transforms.invert(T_BASE_SENSOR) @ found.T_base_sensor)
    assert np.degrees(np.linalg.norm(off[:3])) < 0.1
    assert np.linalg.norm(off[3:]) < 0.01
    assert found.clock_s == pytest.approx(-late_ns / 1e9, abs=0.002)
    assert found.rms_after_m < 0.02 < found.rms_before_m
    wrong = found.change(T_BASE_SENSOR) + np.array([0, 0, 0, 0, 0, 0, late_ns / 1e9])
    assert np.all(np.abs(wrong)[[0, 1, 2, 6]] < 4 * found.sigma[[0, 1, 2, 6]])
    change = found.change(T_given)
    assert np.degrees(np.linalg.norm(change[:3])) == pytest.approx(5.0, abs=0.15)
    assert change[6] == found.clock_s


def test_extrinsics_that_agree_are_kept(turning: Seen) -> None:
    rms_m, share = surfaces_agreement(*turning, T_BASE_SENSOR, 20_000)
    found = refine_extrinsics(*turning, T_BASE_SENSOR, agree_m=1.01 * rms_m)
    assert found is not None
    assert (found.rms_before_m, found.rms_after_m, found.clock_s) == (rms_m, rms_m, 0.0)
    assert found.T_base_sensor is T_BASE_SENSOR
    assert np.isnan(found.sigma).all()
    assert 0.1 < share < 1.0


def test_without_turns_a_clock_is_uncertain(turning: Seen) -> None:
    """On a straight way it is like a shift; at rest it has no effect."""
    found = [
        refine_extrinsics(*case, T_BASE_SENSOR)
        for case in (turning, seen(drive(0.0, 1.5)), seen(drive(0.0, 0.0)))
    ]
    turned_s, straight_s, rest_s = (case.sigma[6] for case in found if case is not None)
    assert straight_s > 3 * turned_s
    assert rest_s == pytest.approx(1.0, abs=0.05)


def test_too_few_returns_determine_nothing(turning: Seen) -> None:
    patches, trajectory, scans = turning
    assert refine_extrinsics(patches, trajectory, [], T_BASE_SENSOR) is None
    few = Patches.of(np.zeros((5, 3)), 0.1, 16)
    assert refine_extrinsics(few, trajectory, scans, T_BASE_SENSOR) is None
    far = transforms.make_transform(translation=[300.0, 0.0, 0.0])
    assert refine_extrinsics(patches, trajectory, scans, far @ T_BASE_SENSOR).returns == 0
