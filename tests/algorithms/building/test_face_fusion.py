"""Wall faces from the planes of many scans."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.model import BuildingSettings
from ffmap.algorithms.scan.summary import Features
from tests.two_rooms import TwoRooms

SETTINGS = BuildingSettings()
WALL = (0.0, 0.0)


def features_of(*planes: tuple[float, float], steps_m: float = 0.0) -> Features:
    """A scan for each plane along x, 4 m long, given the y of its ends.

    steps_m: samples lie alternately before and behind the planes that are not level by this.
    """
    ends, moments = [], []
    for first, last in planes:
        x = np.linspace(0.0, 4.0, 400)
        y = first + (last - first) * x / 4.0 + 0.004 * np.where(np.arange(400) % 2, 1.0, -1.0)
        y += np.where(np.arange(400) % 4 < 2, steps_m, -steps_m) * (first != last)
        ends.append([[0.0, first], [4.0, last]])
        moments.append([400, x.sum(), y.sum(), x @ x, x @ y, y @ y])
    scans = TwoRooms().scans(rays=1)
    count = len(planes)
    along = np.diff(np.array(ends).reshape(-1, 2, 2), axis=1)[:, 0] / 4.0
    return Features(
        scan=np.arange(count),
        origin_map=np.tile([2.0, 2.0, 1.0], (count, 1)),
        floor_map=np.zeros((count, 2, 3)),
        floor_is_foot=np.zeros(count, bool),
        floor_reach_m=np.full(count, 5.0),
        ray_count=np.zeros(count, np.int64),
        plane_count=np.ones(count, np.int64),
        ray_end_map=scans.ray_end_map[:0],
        ray_label=scans.ray_label[:0],
        plane_ends_map=np.array(ends).reshape(-1, 2, 2),
        plane_normal=np.stack([-along[:, 1], along[:, 0]], axis=1),
        plane_bottom_m=np.zeros(count),
        plane_top_m=np.full(count, 2.6),
        plane_lines=np.full(count, 20, np.int32),
        plane_moments=np.array(moments, np.float64).reshape(-1, 6),
    )


def off_m(features: Features) -> FloatArray:
    walls = fuse_walls(features, SETTINGS)
    assert len(walls) == 1
    return np.sort(walls.ends[0, :, 1])


@pytest.mark.parametrize("order", [1, -1])
def test_planes_that_grew_over_a_step_do_not_move_a_wall_that_others_show(order: int) -> None:
    planes = [WALL] * 5 + [(-0.02, 0.07)] * 12
    features = features_of(*planes[::order], steps_m=0.03)
    np.testing.assert_allclose(off_m(features), 0.0, atol=0.001)
    assert fuse_walls(features, SETTINGS).scan_count.tolist() == [17]


def test_such_planes_alone_are_no_wall() -> None:
    """All rays together show what is there; what scatters no more than the others is a wall."""
    both = features_of(*[WALL] * 20, *[(3.0, 3.05)] * 4, steps_m=0.03)
    assert fuse_walls(both, SETTINGS).scan_count.tolist() == [20]
    assert len(fuse_walls(features_of(*[WALL] * 20, *[(3.0, 3.05)] * 4), SETTINGS)) == 2


def test_no_planes_are_no_walls() -> None:
    assert len(fuse_walls(features_of(), SETTINGS)) == 0
