"""The base is a frame whose z points up, whatever the transforms of the topmost frame."""

import numpy as np
import pytest

from ffmap.loaders.candidates import Candidate
from ffmap.loaders.extrinsics import Placement
from ffmap.loaders.frames import FrameTree, StaticTransform
from ffmap.loaders.upright import make_upright
from tests.synthetic import drive_in_a_room

DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
OPTICAL = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def raised(height_m):
    T = np.eye(4)
    T[2, 3] = height_m
    return T


def placed(*edges, turn=DOWN @ DOWN, may_change=True, height_m=0.7):
    """Place a lidar in a room.

    edges: parent, child, T_parent_child. turn: of the lidar in truth, against its frame.
    Returns the base before and after, T_before_after and the warnings.
    """
    tree = FrameTree(StaticTransform(*edge) for edge in edges)
    base, T = tree.root("lidar")
    views = [points @ turn[:3, :3] for points in drive_in_a_room(height_m)]
    lidar = Candidate("/points", "lidar", T, None, 0, stamp_ns=np.zeros(0, int), clouds=views)
    warnings = []
    found = make_upright(Placement([lidar], base, tree.edges), warnings, may_change)
    T_before_after = T @ np.linalg.inv(found.candidates[0].T_base_sensor)
    return (base, found.base), T_before_after, " ".join(warnings)


@pytest.mark.parametrize(
    ("edges", "how"),
    [
        ([("base_link", "lidar", raised(0.5))], {}),
        ([], {}),
        ([("base_link", "lidar", raised(0.5) @ DOWN)], {"turn": DOWN}),
        ([("base_link", "lidar", raised(1.9))], {"height_m": 2.0}),  # On a mast
    ],
)
def test_an_upright_base_is_kept(edges, how):
    (base, after), T, warnings = placed(*edges, **how)
    assert (after, warnings) == (base, "")
    np.testing.assert_array_equal(T, np.eye(4))


@pytest.mark.parametrize("T_root_base", [DOWN, OPTICAL])
def test_base_link_below_a_root_that_does_not_point_up_is_the_base(T_root_base):
    edges = ("root", "base_link", T_root_base), ("base_link", "lidar", raised(0.5))
    bases, T, warning = placed(*edges)
    assert bases == ("root", "base_link")
    np.testing.assert_allclose(T, T_root_base)
    assert warning.startswith("z of root points")


@pytest.mark.parametrize(
    ("edges", "turn", "T_expected"),
    [
        ([("base_link", "lidar", raised(0.5) @ DOWN)], np.eye(4), DOWN),
        ([("base_link", "lidar", raised(0.5))], DOWN, DOWN),
        ([], DOWN, DOWN),
        ([("camera", "lidar", OPTICAL)], np.eye(4), OPTICAL),
    ],
)
def test_a_base_is_turned_where_no_frame_is_upright(edges, turn, T_expected):
    (base, after), T, _ = placed(*edges, turn=turn)
    assert after == f"{base}_upright"
    np.testing.assert_allclose(T, T_expected, atol=1e-12)


def test_a_base_that_may_not_change_is_a_warning():
    (base, after), _, warning = placed(turn=DOWN, may_change=False)
    assert after == base
    assert "may not point up" in warning
    assert "may not point up" in placed(height_m=1.5)[2]
