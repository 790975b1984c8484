"""Extrapolation and compensation of motion, and how far it may change."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.poses.motion import extrapolate, may_change, seen_at
from tests.synthetic import scan_of

PERIOD_NS = 100_000_000


@pytest.mark.parametrize(
    ("turn_deg", "way_m", "jumps"), [(5, 0, False), (-5, 0.1, False), (7, 0, True), (0, 0.2, True)]
)
def test_a_turn_that_robots_brake_from_is_no_jump(
    turn_deg: float, way_m: float, jumps: bool
) -> None:
    T = transforms.from_yaw(np.radians(turn_deg), [way_m, 0.0, 0.0])
    assert (may_change(PERIOD_NS).share_between(np.eye(4), T) > 1.0) == jumps


def test_a_motion_is_extrapolated_along_its_arc() -> None:
    """A quarter of a circle of 1 m within a second."""
    angle = np.pi / 20
    step = transforms.to_twist(transforms.from_yaw(angle, [np.sin(angle), 1 - np.cos(angle), 0.0]))
    T = extrapolate(np.eye(4), step / PERIOD_NS, 10 * PERIOD_NS)
    np.testing.assert_allclose(T, transforms.from_yaw(np.pi / 2, [1.0, 1.0, 0.0]), atol=1e-9)


def test_points_are_where_a_still_sensor_sees_them() -> None:
    generator = np.random.default_rng(0)
    points = generator.uniform(-10, 10, (50, 3))
    time_ns = np.sort(generator.integers(0, PERIOD_NS, 50))
    scan = replace(scan_of(points, np.zeros(50), 1), time_ns=time_ns, start_ns=5 * PERIOD_NS)
    middle_ns = 5 * PERIOD_NS + PERIOD_NS // 2
    motion_per_ns = np.array([0.1, -0.2, 0.8, 0.5, 1.0, -0.1]) * 1e-9
    exact = [
        transforms.apply(transforms.from_twist(motion_per_ns * (t - PERIOD_NS // 2)), p[None])[0]
        for t, p in zip(time_ns, points, strict=True)
    ]
    found = seen_at(middle_ns, scan, motion_per_ns, (0.0, 99.0), 50)
    np.testing.assert_allclose(found, exact, atol=1e-3)


@pytest.mark.parametrize("points_max", [10, 16, 25, 170])
def test_every_ring_is_among_the_thinned_points(points_max: int) -> None:
    """32 emitters that fire in turn: an even stride would take a few of them only."""
    ring = np.tile(np.arange(32), 10)
    scan = scan_of(np.stack([ring + 1.0, ring, ring], axis=1), ring, 32)
    points = seen_at(0, scan, np.zeros(6), (0.0, 99.0), points_max)
    assert len(np.unique(points[:, 1])) == min(len(points), 32)
    assert 0.6 * points_max < len(points) < 2 * points_max
