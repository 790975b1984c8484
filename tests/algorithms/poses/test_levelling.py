"""Which way is up: the map by floor and walls, a scan by its floor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.poses.levelling import level_map, turn_to_floor
from ffmap.algorithms.scan.floor import find_floor
from tests.corridor import METHOD, labelled, pose


def test_a_scan_is_turned_to_its_floor() -> None:
    _, placed, _, _ = labelled()
    tilt = Rotation.from_euler("xy", [0.8, -0.6], degrees=True)
    points = (tilt.apply(placed.points_level) + np.array([0.0, 0.0, 0.05])).astype(np.float32)
    floor = find_floor(points, METHOD.rearrangement)
    assert floor.height_m == pytest.approx(0.05, abs=0.01)
    level = turn_to_floor(
        replace(placed, points_level=points), floor.height_m, floor.slope, np.zeros(2), 2.0
    )
    again = find_floor(level.points_level, METHOD.rearrangement)
    assert np.hypot(*again.slope) < 0.002
    untouched = turn_to_floor(
        replace(placed, points_level=points), floor.height_m, floor.slope, np.zeros(2), 0.1
    )
    assert untouched.points_level is points


def test_the_map_is_levelled_by_floor_and_walls() -> None:
    tilt = transforms.make_transform(
        Rotation.from_euler("xyz", [3.0, -2.0, 40.0], degrees=True), [5.0, 1.0, -0.3]
    )
    _, placed, _, _ = labelled()
    T_odom_base = tilt @ pose()
    level = level_map(transforms.apply(tilt, placed.points_level), T_odom_base)
    assert level.floor_rms_m < 0.03
    T_map_odom = level.T_map_odom
    np.testing.assert_allclose(level.floor_slope, 0, atol=0.005)
    np.testing.assert_allclose((T_map_odom @ T_odom_base)[:3, 3], 0, atol=0.02)
    np.testing.assert_allclose((T_map_odom @ tilt)[2, :3], [0, 0, 1], atol=0.005)


def test_walls_tell_which_way_is_up_where_the_floor_slopes() -> None:
    scans = [labelled(seed=i, x=x) for i, x in enumerate(np.linspace(0.0, 1.0, 12))]
    points = np.concatenate([placed.to_map(placed.points_level) for _, placed, _, _ in scans])
    floor = np.concatenate([truth for _, _, truth, _ in scans]) == Label.FLOOR
    points[floor, 2] -= (
        0.02 * points[floor, 1]
    )  # the walls' normals lie along y: slopes along x they leave open
    tilt = transforms.make_transform(
        Rotation.from_euler("xy", [2.0, -1.0], degrees=True), [0.0, 0.0, 0.0]
    )
    level = level_map(transforms.apply(tilt, points), tilt @ pose())
    lean_deg = np.degrees(np.arccos((level.T_map_odom @ tilt)[2, 2]))
    assert lean_deg < 0.2  # the floor's normal is off by 1.15 degrees
    np.testing.assert_allclose(level.floor_slope, [0.0, -0.02], atol=0.004)


def room(floor: int) -> np.ndarray:
    """Returns of a room of 8 by 5 m: walls and ceiling seen well, and so many of its floor, all off by some millimetres."""
    rng = np.random.default_rng(2)

    def patch(count: int, low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
        return rng.uniform(low, high, (count, 3)) + rng.normal(0, 0.003, (count, 3))

    # Walls begin where a sensor that looks hardly downwards sees them.
    walls = [patch(8000, (-4, y, 0.1), (4, y, 2.7)) for y in (-2.5, 2.5)]
    parts = [
        *walls,
        patch(20_000, (-4, -2.5, 2.7), (4, 2.5, 2.7)),
        patch(floor, (2.5, -1, 0), (4, 1, 0)),
    ]
    return np.concatenate(parts)


def test_a_floor_of_which_little_is_seen_levels_the_map() -> None:
    level = level_map(room(floor=700), np.eye(4))
    assert level.floor_rms_m < 0.01
    np.testing.assert_allclose(level.T_map_odom, np.eye(4), atol=0.02)


def test_a_ceiling_is_no_floor() -> None:
    level = level_map(room(floor=0), np.eye(4))
    assert np.isnan(level.floor_rms_m)
    np.testing.assert_allclose(level.T_map_odom, np.eye(4), atol=0.02)
