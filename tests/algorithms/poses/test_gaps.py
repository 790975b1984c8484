"""A lidar in a box with pillars whose clouds are missing for a while: where it is found again, and what cannot be found."""

import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.poses.odometry import OdometrySettings, Registration, doubt, register_scans
from ffmap.algorithms.poses.refinement import RefinementSettings, carried_on, may_change
from tests.algorithms.poses import test_odometry as drive

GAP_AT, PERIODS = 12, 16
"""Scans before the gap, and how many are missing."""


def stops(time_s: float) -> FloatArray:
    return drive_along(min(time_s, 1.3))


def drive_along(time_s: float) -> FloatArray:
    return transforms.from_yaw(0.0, [0.8 * time_s, 0.0, 0.0])


def turns(time_s: float) -> FloatArray:
    """A turn by 90 degrees that begins and ends while no cloud is recorded."""
    return transforms.from_yaw(np.radians(90.0) * np.clip((time_s - 1.3) / 1.2, 0.0, 1.0), [0.8 * min(time_s, 1.3), 0.0, 0.0])


def stands(time_s: float) -> FloatArray:
    return transforms.from_yaw(0.3, [0.5, 0.2, 0.0])


def registered(scans: list[Scan]) -> list[Registration]:
    given = [(i, scan, None) for i, scan in enumerate(scans)]
    return list(register_scans(given, OdometrySettings(), RefinementSettings(), None, drive.T_BASE_HORIZONTAL))


def later(scan: Scan, by_ns: int) -> Scan:
    return replace(scan, start_ns=scan.start_ns + by_ns, stamp_ns=scan.stamp_ns + by_ns)


@pytest.mark.parametrize("way", [drive_along, stops, turns, stands])
@pytest.mark.parametrize("missing", [4, PERIODS])
def test_the_scan_after_a_gap_is_found_whatever_the_robot_did_in_it(
    monkeypatch: pytest.MonkeyPatch, way: Callable[[float], FloatArray], missing: int
) -> None:
    monkeypatch.setattr(sys.modules[drive.__name__], "true_pose", way)
    numbers = [*range(GAP_AT), *range(GAP_AT + missing, GAP_AT + missing + 5)]
    found = registered([drive.sweep(i, drive.T_BASE_HORIZONTAL, 1) for i in numbers])
    assert len(found) == len(numbers)
    off_m, off_deg = drive.errors(found)
    assert off_m.max() < 0.04
    assert off_deg.max() < 1.5
    assert [doubt(r) for r in found] == [None] * len(found)
    assert [np.isnan(r.agreement) for r in found] == [True] * GAP_AT + [False] + [True] * 4


def elsewhere(monkeypatch: pytest.MonkeyPatch) -> list[Scan]:
    """Scans of a hall that has nothing in common with the box."""
    pillars_m = np.array([[[-6.0, -7.0, 0.0], [-5.0, -4.0, 4.0]], [[3.0, 5.0, 0.0], [3.4, 8.0, 4.0]]])
    with monkeypatch.context() as patch:
        hall = np.array([-13.0, -9.0, 0.0]), np.array([11.0, 14.0, 4.2])
        patch.setattr(
            sys.modules[drive.__name__],
            "ranges",
            lambda origin, rays: drive.ranges_in_box(origin, rays, *hall, pillars_m),
        )
        return [drive.sweep(i, drive.T_BASE_HORIZONTAL, 3) for i in range(12)]


def test_what_is_seen_nowhere_in_the_map_is_placed_by_the_motion_after_a_short_gap(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.modules[drive.__name__], "true_pose", drive_along)
    before = [drive.sweep(i, drive.T_BASE_HORIZONTAL, 1) for i in range(GAP_AT)]
    gap_ns = 10 * drive.PERIOD_NS
    found = registered([*before, *(later(scan, GAP_AT * drive.PERIOD_NS + gap_ns) for scan in elsewhere(monkeypatch))])
    assert len(found) == 24
    why = doubt(found[GAP_AT])
    assert why is not None
    assert "nothing of the map is in sight" in why
    step = transforms.invert(found[GAP_AT - 1].T_odom_sensor) @ found[GAP_AT].T_odom_sensor
    np.testing.assert_allclose(step[:3, 3], [0.88, 0.0, 0.0], atol=0.05)


def test_what_is_seen_nowhere_in_the_map_is_left_out_after_a_long_gap_until_the_robot_is_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys.modules[drive.__name__], "true_pose", drive_along)
    box = [drive.sweep(i, drive.T_BASE_HORIZONTAL, 1) for i in range(GAP_AT + 4)]
    away_ns, back_ns = 30 * drive.PERIOD_NS, 60 * drive.PERIOD_NS
    away = [later(scan, GAP_AT * drive.PERIOD_NS + away_ns) for scan in elsewhere(monkeypatch)]
    found = registered([*box[:GAP_AT], *away, *(later(scan, back_ns) for scan in box[GAP_AT:])])
    assert [r.index for r in found] == [*range(GAP_AT), *range(GAP_AT + 12, GAP_AT + 16)]
    assert doubt(found[GAP_AT]) is None
    # The robot is where the drive of the box goes on.
    off = transforms.invert(found[0].T_odom_sensor) @ found[-1].T_odom_sensor
    np.testing.assert_allclose(off[:3, 3], [0.8 * 1.5, 0.0, 0.0], atol=0.04)


def test_more_may_change_in_more_time() -> None:
    usual, second = may_change(drive.PERIOD_NS), may_change(11 * drive.PERIOD_NS)
    np.testing.assert_allclose(usual, [6.0, 0.15])
    np.testing.assert_allclose(second, [96.0, 2.15])
    quarter = transforms.from_yaw(np.pi / 2, [0.0, 0.0, 0.0])
    assert usual.share_of(np.eye(4), quarter) == pytest.approx(15.0)
    assert second.share_of(np.eye(4), quarter) < 1.0


def test_a_motion_is_carried_on_along_its_arc() -> None:
    """A quarter of a circle of 1 m within a second."""
    step = transforms.to_twist(transforms.from_yaw(np.pi / 20, [np.sin(np.pi / 20), 1 - np.cos(np.pi / 20), 0.0]))
    T = carried_on(np.eye(4), step / drive.PERIOD_NS, 10 * drive.PERIOD_NS)
    np.testing.assert_allclose(T, transforms.from_yaw(np.pi / 2, [1.0, 1.0, 0.0]), atol=1e-9)
