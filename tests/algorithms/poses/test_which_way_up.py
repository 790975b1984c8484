"""Floor and ceiling keep their distance from a robot that drives and turns; walls do not."""

import numpy as np
import pytest

from ffmap.algorithms.poses.which_way_up import Levels, find_levels, upright_axis
from tests.synthetic import drive_in_a_room


def test_the_floor_is_the_denser_level():
    levels = find_levels(drive_in_a_room(height_m=0.7, ceiling_m=2.6), np.array([0.0, 0.0, 1.0]))
    assert levels.below_m == pytest.approx(0.7, abs=0.05)
    assert levels.above_m == pytest.approx(1.9, abs=0.05)
    assert levels.share > 0.1


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
def test_walls_do_not_keep_their_distance(axis):
    assert find_levels(drive_in_a_room(), np.array(axis)).share < 0.05


def test_a_ceiling_out_of_sight_is_as_far_as_in_the_lowest_room():
    clouds = [p[p[:, 2] < 0.25 * np.hypot(p[:, 0], p[:, 1])] for p in drive_in_a_room(height_m=0.7)]
    levels = find_levels(clouds, np.array([0.0, 0.0, 1.0]))
    assert (levels.below_m, levels.above_m) == pytest.approx((0.7, 1.6), abs=0.05)


def test_a_few_clouds_show_nothing():
    assert upright_axis([find_levels(drive_in_a_room()[:4], np.array([0.0, 0.0, 1.0]))]) is None


def test_the_first_axis_is_kept_unless_another_one_alone_is_upright():
    level, wall, nothing = Levels(0.7, 1.9, 0.3), Levels(1.0, 1.0, 0.2), Levels(1.0, 1.0, 0.01)
    assert upright_axis([wall, level]) == 0
    assert upright_axis([nothing, level]) == 1
    assert upright_axis([nothing, nothing]) is None
