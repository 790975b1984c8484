"""Which scans the building is made of."""

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.building.drive import new_views

ONE_LIDAR = np.zeros(2000, np.int64)


def poses(x_m: FloatArray, yaw: float = 0.0) -> FloatArray:
    return np.array([transforms.from_yaw(yaw, [x, 0.0, 0.0]) for x in x_m])


def views(T: FloatArray, lidar: IntArray = ONE_LIDAR) -> list[bool]:
    return new_views(T, lidar[: len(T)]).tolist()


def test_a_drive_shows_new_things_as_long_as_it_goes_on() -> None:
    assert all(views(poses(np.linspace(0.0, 20.0, 400))))


def test_a_robot_that_stands_still_soon_shows_nothing_new() -> None:
    shown = views(poses(np.zeros(300)))
    assert all(shown[:10])
    assert not any(shown[30:])


def test_the_same_way_again_and_again_soon_shows_nothing_new() -> None:
    way = np.linspace(0.0, 10.0, 50)
    shown = [sum(views(poses(np.tile(way, times)))) for times in (2, 30, 40)]
    assert shown[0] == 2 * len(way)
    assert shown[1] == shown[2] < 30 * len(way)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_about_any_axis_is_another_view(axis: int) -> None:
    turned = transforms.from_yaw(0.0, [0.0, 0.0, 0.0])
    c, s = np.cos(0.6), np.sin(0.6)
    i, j = [k for k in range(3) if k != axis]
    turned[[i, i, j, j], [i, j, i, j]] = [c, -s, s, c]
    still = poses(np.zeros(100))
    shown = views(np.concatenate([still, np.repeat(turned[None], 100, 0)]))
    assert any(shown[100:])
    assert shown[100:] == shown[:100]


def test_each_lidar_has_views_of_its_own() -> None:
    T, lidar = poses(np.zeros(200)), np.tile([0, 1], 100)
    shown = np.array(views(T, lidar))
    assert shown[lidar == 0].sum() == shown[lidar == 1].sum() == sum(views(T[:100]))


def test_no_scan_shows_nothing() -> None:
    assert views(np.zeros((0, 4, 4))) == []
