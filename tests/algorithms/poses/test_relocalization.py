"""Scans after a gap, in which the robot drives on, stops, turns, or leaves for another place."""

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.poses.odometry import doubt
from tests.box_drive import (
    PERIOD_NS,
    Box,
    Way,
    errors_of,
    later,
    registered,
    sweep,
)

GAP_AT, PERIODS = 12, 16
"""Scans before the gap, and missing ones."""
HALL = Box(
    np.array([-13.0, -9.0, 0.0]),
    np.array([11.0, 14.0, 4.2]),
    np.array([[[-6.0, -7.0, 0.0], [-5.0, -4.0, 4.0]], [[3.0, 5.0, 0.0], [3.4, 8.0, 4.0]]]),
)


def drives(time_s: float) -> FloatArray:
    return transforms.from_yaw(0.0, [0.8 * time_s, 0.0, 0.0])


def stops(time_s: float) -> FloatArray:
    return drives(min(time_s, 1.3))


def turns(time_s: float) -> FloatArray:
    """By 90 degrees, all while no cloud is recorded."""
    turned = np.clip((time_s - 1.3) / 1.2, 0.0, 1.0)
    return transforms.from_yaw(np.radians(90.0) * turned, [0.8 * min(time_s, 1.3), 0.0, 0.0])


def rests(time_s: float) -> FloatArray:
    return transforms.from_yaw(0.3, [0.5, 0.2, 0.0])


@pytest.mark.parametrize("way", [drives, stops, turns, rests])
@pytest.mark.parametrize("missing", [4, PERIODS])
def test_a_scan_after_a_gap_is_found(way: Way, missing: int) -> None:
    numbers = [*range(GAP_AT), *range(GAP_AT + missing, GAP_AT + missing + 5)]
    found = registered([sweep(i, way=way) for i in numbers])
    assert len(found) == len(numbers)
    off_m, off_deg = errors_of(found, way)
    assert off_m.max() < 0.04
    assert off_deg.max() < 1.5
    assert [doubt(r) for r in found] == [None] * len(found)
    assert [np.isnan(r.agreement) for r in found] == [True] * GAP_AT + [False] + [True] * 4


@pytest.fixture(scope="module")
def box() -> list[Scan]:
    return [sweep(i, way=drives) for i in range(GAP_AT + 4)]


@pytest.fixture(scope="module")
def elsewhere() -> list[Scan]:
    """Scans of a hall that has nothing in common with the box."""
    return [sweep(i, seed=3, way=drives, box=HALL) for i in range(12)]


def test_after_a_short_gap_the_motion_is_extrapolated_if_nothing_matches(
    box: list[Scan], elsewhere: list[Scan]
) -> None:
    away_ns = (GAP_AT + 10) * PERIOD_NS
    found = registered([*box[:GAP_AT], *(later(scan, away_ns) for scan in elsewhere)])
    assert len(found) == 24
    assert "nothing of the map is in sight" in str(doubt(found[GAP_AT]))
    step = transforms.invert(found[GAP_AT - 1].T_odom_sensor) @ found[GAP_AT].T_odom_sensor
    np.testing.assert_allclose(step[:3, 3], [0.88, 0.0, 0.0], atol=0.05)


def test_after_a_long_gap_scans_are_left_out_until_one_matches(
    box: list[Scan], elsewhere: list[Scan]
) -> None:
    away = [later(scan, (GAP_AT + 30) * PERIOD_NS) for scan in elsewhere]
    back = [later(scan, 60 * PERIOD_NS) for scan in box[GAP_AT:]]
    found = registered([*box[:GAP_AT], *away, *back])
    assert [r.index for r in found] == [*range(GAP_AT), *range(GAP_AT + 12, GAP_AT + 16)]
    assert doubt(found[GAP_AT]) is None
    way = transforms.invert(found[0].T_odom_sensor) @ found[-1].T_odom_sensor
    np.testing.assert_allclose(way[:3, 3], [0.8 * 1.5, 0.0, 0.0], atol=0.04)
