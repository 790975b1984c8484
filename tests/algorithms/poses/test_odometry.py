"""KISS-ICP and its refinement on a lidar that is driven through a box with pillars."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan, subset
from ffmap.algorithms.poses.odometry import (
    OdometrySettings,
    register_scans,
    weakness,
)
from ffmap.algorithms.poses.refinement import Refinement, RefinementSettings, Refiner
from tests import synthetic
from tests.box_drive import (
    CORRIDOR,
    T_HORIZONTAL_VERTICAL,
    Given,
    errors_of,
    registered,
    sweep,
)


@pytest.mark.parametrize("companions", [True, False])
def test_the_way_through_a_box_is_found(scans: list[Given], companions: bool) -> None:
    given = scans if companions else [(i, scan, None) for i, scan, _ in scans]
    settings = OdometrySettings(), RefinementSettings()
    found = list(register_scans(given, *settings, T_HORIZONTAL_VERTICAL))
    assert [r.index for r in found] == list(range(40))
    assert [r.stamp_ns for r in found] == [scan.reference_ns for _, scan, _ in scans]
    off_m, off_deg = errors_of(found)
    # 2 m driven, 30 degrees turned.
    assert off_m.max() < 0.03
    assert off_deg.max() < 1.0
    shares = [r.refined_inlier_share for r in found]
    assert np.nanmedian(shares) > 0.8
    # The map of one scan does not show how well the second one fits.
    assert np.flatnonzero(np.isnan(shares)).tolist() == [1]
    assert all(0 < r.weakest_share <= 1 for r in found)
    assert [weakness(r) for r in found[:12]] == [None] * 12
    again = list(register_scans(given[:12], *settings, T_HORIZONTAL_VERTICAL))
    for first, second in zip(found, again, strict=False):
        np.testing.assert_array_equal(first.T_odom_sensor, second.T_odom_sensor)


def test_the_refinement_can_be_disabled(scans: list[Given]) -> None:
    found = registered([scan for _, scan, _ in scans[:15]], enabled=False)
    assert np.isnan([r.weakest_share for r in found]).all()
    assert {r.refined_m for r in found} == {0.0}
    assert errors_of(found)[0].max() < 0.1


def test_a_cloud_of_nothing_keeps_the_odometrys_motion(scans: list[Given]) -> None:
    thin = subset(scans[5][1], np.arange(0, len(scans[5][1]), 2000))
    found = registered([*(scan for _, scan, _ in scans[:5]), thin, scans[6][1], scans[7][1]])
    assert len(found) == 8
    assert np.isfinite([r.T_odom_sensor for r in found]).all()


@pytest.mark.parametrize("later_ns", [-20_000_000, 0, 1_000])
@pytest.mark.parametrize("refined", [True, False])
def test_a_scan_that_is_not_later_than_the_last_is_skipped(
    scans: list[Given], refined: bool, later_ns: int, capfd: pytest.CaptureFixture[str]
) -> None:
    clouds = [scan for _, scan, _ in scans[:9]]
    again = replace(clouds[4], start_ns=clouds[4].start_ns + later_ns)
    found = registered([*clouds[:5], again, *clouds[5:]], enabled=refined)
    assert [r.index for r in found] == [0, 1, 2, 3, 4, 6, 7, 8, 9]
    assert errors_of(found)[0].max() < 0.1
    assert "out of range" not in capfd.readouterr().err


def test_registrations_in_a_bare_corridor_are_weak() -> None:
    given = [(i, sweep(i, box=CORRIDOR), None) for i in range(8)]
    settings = OdometrySettings(range_max_m=20.0), RefinementSettings()
    why = [weakness(r) for r in register_scans(given, *settings)]
    assert why[0] is None
    assert all("one direction is not constrained" in str(w) for w in why[2:])


def test_a_scan_of_another_place_and_a_refused_one_are_weak(scans: list[Given]) -> None:
    clouds = [scan for _, scan, _ in scans[:6]]
    points = clouds[5].points_sensor + np.float32([40.0, 0.0, 9.0])
    found = registered([*clouds[:5], replace(clouds[5], points_sensor=points)])
    assert "of the scan fits the map" in str(weakness(found[-1]))
    assert "refused" in str(weakness(replace(found[0], refused=True)))


def test_a_robot_that_swings_is_followed() -> None:
    """From 80 degrees a second to the left to as much to the right, and back, each second."""

    def swings(time_s: float) -> FloatArray:
        yaw = np.radians(25.0) * (1.0 - np.cos(3.3 * max(time_s - 0.5, 0.0)))
        return transforms.from_yaw(yaw, [0.0, 0.0, 0.0])

    found = registered([sweep(i, way=swings) for i in range(30)])
    assert not any(r.refused for r in found)
    off_m, off_deg = errors_of(found, swings)
    assert off_deg.max() < 0.5
    assert off_m.max() < 0.05


def test_scans_that_determine_no_pose_are_left_out() -> None:
    """KISS-ICP aborts the process; as it does where all times are the same."""
    given = [synthetic.scan(i, 360) for i in range(7)]
    given[2] = replace(subset(given[2], np.arange(1)), time_ns=None)
    given[3] = replace(given[3], points_sensor=np.full_like(given[3].points_sensor, 1.0))
    line = given[4].points_sensor * np.array([1, 0, 0], np.float32)
    given[4] = replace(given[4], points_sensor=line)
    given[5] = replace(given[5], time_ns=np.zeros(len(given[5]), np.int64))
    found = registered(given)
    assert [r.index for r in found] == [0, 1, 5, 6]
    assert np.isfinite(found[-1].T_odom_sensor).all()


def test_a_scan_whose_registration_fails_has_no_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    given = [(i, synthetic.scan(i, 360), None) for i in range(5)]
    usual, failed = Refiner.refine, []

    def refine(self: Refiner, scan: Scan, *more: Any, **options: Any) -> Refinement | None:
        if scan is given[2][1]:
            raise ValueError("no surface")
        return usual(self, scan, *more, **options)

    def fail(index: int, _: Scan, error: Exception) -> None:
        failed.append((index, str(error)))

    monkeypatch.setattr(Refiner, "refine", refine)
    settings = OdometrySettings(), RefinementSettings()
    found = list(register_scans(given, *settings, on_failure=fail))
    assert [r.index for r in found] == [0, 1, 3, 4]
    assert failed == [(2, "no surface")]
    with pytest.raises(ValueError, match="no surface"):
        list(register_scans(given, *settings))
