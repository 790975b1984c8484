"""The base is a frame whose z points up, whatever the transforms say of the topmost frame."""

import numpy as np
import pytest

from ffmap.loaders.frames import FrameTree, StaticTransform
from ffmap.loaders.which_way_up import LidarView, find_upright_base
from tests.synthetic import drive_in_a_room

DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
OPTICAL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def raised(height_m):
    T = np.eye(4)
    T[2, 3] = height_m
    return T


def base_of(*edges, turn=DOWN @ DOWN, may_change=True, height_m=0.7):
    """edges: parent, child, T_parent_child; turn: of the lidar in truth, against its frame."""
    tree = FrameTree(StaticTransform(*edge) for edge in edges)
    base, T = tree.root("lidar")
    clouds = [points @ turn[:3, :3] for points in drive_in_a_room(height_m)]
    return base, find_upright_base(base, tree, [LidarView("/points", "lidar", clouds, T)], may_change)


def test_an_upright_base_is_kept():
    assert base_of(("base_link", "lidar", raised(0.5))) == ("base_link", None)
    assert base_of() == ("lidar", None)


@pytest.mark.parametrize("T_root_base", [DOWN, OPTICAL])
def test_base_link_is_the_base_below_a_root_that_does_not_point_up(T_root_base):
    base, found = base_of(("root", "base_link", T_root_base), ("base_link", "lidar", raised(0.5)))
    assert (base, found.frame, found.edge) == ("root", "base_link", None)
    np.testing.assert_allclose(found.T_base_frame, T_root_base)
    assert "z of root points" in found.warning
    assert "base_link" in found.warning


@pytest.mark.parametrize(
    ("edges", "turn"),
    [
        ([("base_link", "lidar", raised(0.5) @ DOWN)], np.eye(4)),
        ([("base_link", "lidar", raised(0.5))], DOWN),
        ([], DOWN),
    ],
)
def test_a_base_is_turned_where_a_lidar_is_upside_down_against_its_transform(edges, turn):
    base, found = base_of(*edges, turn=turn)
    assert (found.frame, found.edge.parent) == (f"{base}_upright", base)
    np.testing.assert_allclose(found.T_base_frame, DOWN)


def test_a_base_is_turned_as_the_lidar_where_no_other_frame_is_upright():
    _, found = base_of(("camera", "lidar", OPTICAL))
    assert found.frame == "camera_upright"
    np.testing.assert_allclose(found.T_base_frame, OPTICAL)


def test_a_lidar_that_is_turned_as_its_transform_says():
    assert base_of(("base_link", "lidar", raised(0.5) @ DOWN), turn=DOWN)[1] is None


def test_a_mast_carries_a_lidar_below_the_ceiling():
    assert base_of(("base_link", "lidar", raised(1.9)), height_m=2.0)[1] is None


def test_what_may_not_be_changed_is_a_warning():
    base, found = base_of(turn=DOWN, may_change=False)
    assert (found.frame, found.edge) == (base, None)
    assert "may not point up" in found.warning
    assert "may not point up" in base_of(height_m=1.5)[1].warning
