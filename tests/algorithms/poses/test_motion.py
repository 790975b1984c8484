"""Extrapolation and compensation of motion, and how far it may change."""

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.poses.motion import compensate, extrapolate, may_change

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


def test_compensated_points_are_where_a_still_sensor_sees_them() -> None:
    generator = np.random.default_rng(0)
    points = generator.uniform(-10, 10, (50, 3))
    late_ns = generator.integers(-PERIOD_NS // 2, PERIOD_NS // 2, 50)
    motion_per_ns = np.array([0.1, -0.2, 0.8, 0.5, 1.0, -0.1]) * 1e-9
    exact = [
        transforms.apply(transforms.from_twist(motion_per_ns * t), p[None])[0]
        for t, p in zip(late_ns, points, strict=True)
    ]
    np.testing.assert_allclose(compensate(points, late_ns, motion_per_ns), exact, atol=1e-3)
