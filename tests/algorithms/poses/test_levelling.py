"""The map levelled by floor and walls, a scan by its floor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.poses.levelling import level_map, turn_to_floor
from ffmap.algorithms.scan.floor import find_floor
from tests.corridor import METHOD, labelled, pose


def tilted(*angles_deg: float) -> np.ndarray:
    turn = Rotation.from_euler("xyz", angles_deg, degrees=True)
    return transforms.make_transform(turn, [5.0, 1.0, -0.3])


def test_a_scan_is_turned_to_its_floor() -> None:
    _, placed, _, _ = labelled()
    tilt = Rotation.from_euler("xy", [0.6, -0.5], degrees=True)
    points = (tilt.apply(placed.points_level) + np.array([0.0, 0.0, 0.05])).astype(np.float32)
    floor = find_floor(points, METHOD.rearrangement)
    assert floor.height_m == pytest.approx(0.05, abs=0.01)
    given = replace(placed, points_level=points), floor.height_m, floor.slope, np.zeros(2)
    level = turn_to_floor(*given)
    again = find_floor(level.points_level, METHOD.rearrangement)
    assert np.hypot(*again.slope) < 0.002
    ramp = placed, 0.0, np.array([0.03, 0.0]), np.zeros(2)
    assert turn_to_floor(*ramp) is placed


def test_the_map_is_levelled_by_floor_and_walls() -> None:
    T_odom_map = tilted(3.0, -2.0, 40.0)
    _, placed, _, _ = labelled()
    T_odom_base = T_odom_map @ pose()
    level = level_map(transforms.apply(T_odom_map, placed.points_level), T_odom_base)
    assert level.floor_rms_m < 0.03
    np.testing.assert_allclose(level.floor_slope, 0, atol=0.005)
    np.testing.assert_allclose((level.T_map_odom @ T_odom_base)[:3, 3], 0, atol=0.02)
    np.testing.assert_allclose((level.T_map_odom @ T_odom_map)[2, :3], [0, 0, 1], atol=0.005)


def test_walls_are_upright_where_the_floor_slopes() -> None:
    scans = [labelled(seed=i, x=x) for i, x in enumerate(np.linspace(0.0, 1.0, 12))]
    points = np.concatenate([placed.to_map(placed.points_level) for _, placed, _, _ in scans])
    floor = np.concatenate([truth for _, _, truth, _ in scans]) == Label.FLOOR
    points[floor, 2] -= 0.02 * points[floor, 1]  # across the corridor: its walls determine no other
    T_odom_map = tilted(2.0, -1.0, 0.0)
    level = level_map(transforms.apply(T_odom_map, points), T_odom_map @ pose())
    lean_deg = np.degrees(np.arccos((level.T_map_odom @ T_odom_map)[2, 2]))
    assert lean_deg < 0.2  # the floor's normal is off by 1.15 degrees
    np.testing.assert_allclose(level.floor_slope, [0.0, -0.02], atol=0.004)


@pytest.mark.parametrize("floor_returns", [700, 0])
def test_a_floor_with_few_returns_is_found_and_a_ceiling_is_no_floor(floor_returns: int) -> None:
    """A room of 8 by 5 m whose walls and ceiling are seen well."""
    rng = np.random.default_rng(2)

    def patch(count: int, low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
        return rng.uniform(low, high, (count, 3)) + rng.normal(0, 0.003, (count, 3))

    walls = [patch(8000, (-4, y, 0.1), (4, y, 2.7)) for y in (-2.5, 2.5)]
    ceiling = patch(20_000, (-4, -2.5, 2.7), (4, 2.5, 2.7))
    floor = patch(floor_returns, (2.5, -1, 0), (4, 1, 0))
    level = level_map(np.concatenate([*walls, ceiling, floor]), np.eye(4))
    assert level.floor_rms_m < 0.01 if floor_returns else np.isnan(level.floor_rms_m)
    np.testing.assert_allclose(level.T_map_odom, np.eye(4), atol=0.02)
