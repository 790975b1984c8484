"""Loops closed on two laps of a circle, by an odometry that drifts."""

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses import pose_graph
from ffmap.algorithms.poses.gaussian_map import Aligned
from ffmap.algorithms.poses.pose_graph import (
    Edge,
    PoseGraph,
    PoseGraphSettings,
    close_loops,
    solve,
)

SETTINGS = PoseGraphSettings()
POINTS = 1200
Drive = tuple[FloatArray, FloatArray, list[FloatArray]]


def surfaces(generator: np.random.Generator) -> FloatArray:
    """(n, 3) points on 60 squares of 3 m at random places, along the axes."""
    centre = generator.uniform([-6, -6, 0], [6, 6, 2.6], (60, 1, 3))
    axes = np.eye(3)[[[1, 2], [0, 2], [0, 1]] * 20]
    return (centre + generator.uniform(-1.5, 1.5, (60, 2500, 2)) @ axes).reshape(-1, 3)


def way(laps: float, scans: int) -> FloatArray:
    """T_map_sensor (n, 4, 4) on a circle, facing ahead."""
    angles = np.linspace(0, laps * 2 * np.pi, scans)
    return np.array(
        [transforms.from_yaw(a + np.pi / 2, [4 * np.cos(a), 4 * np.sin(a), 1]) for a in angles]
    )


def seen(
    T_true: FloatArray, points: FloatArray, generator: np.random.Generator
) -> list[FloatArray]:
    """Returns of each pose within 4 m, with 1 cm of noise."""
    clouds = []
    for T in T_true:
        near = points[np.linalg.norm(points - T[:3, 3], axis=1) < 4.0]
        chosen = near[generator.choice(len(near), POINTS)]
        noisy = chosen + generator.normal(0, 0.01, (POINTS, 3))
        clouds.append(transforms.apply(transforms.invert(T), noisy).astype(np.float32))
    return clouds


def drifting(T_true: FloatArray, yaw_deg: float, stretch: float) -> FloatArray:
    """The same way with a drift of the heading, and of the distance by a share."""
    T = [np.eye(4)]
    turn = transforms.from_yaw(np.radians(yaw_deg) / len(T_true), [0.0, 0.0, 0.0])
    for before, after in itertools.pairwise(T_true):
        step = transforms.invert(before) @ after
        step[:3, 3] *= 1.0 + stretch
        T.append(T[-1] @ step @ turn)
    return np.array(T)


def off_m(T: FloatArray, T_true: FloatArray) -> FloatArray:
    """(n,) metres from the true way, both relative to their first pose."""
    off = transforms.invert(T[0]) @ T - transforms.invert(T_true[0]) @ T_true
    return np.linalg.norm(off[:, :3, 3], axis=1)


@pytest.fixture(scope="module", autouse=True)
def small_submaps() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pose_graph, "_SUBMAP_SCANS", 8)
        patch.setattr(pose_graph, "_EVERY_SCANS", 4)
        yield


@pytest.fixture(scope="module")
def drive() -> Drive:
    """True poses, the odometry's, and the clouds, of two laps."""
    generator = np.random.default_rng(7)
    T_true = way(2.0, 160)
    return T_true, drifting(T_true, 5.0, 0.01), seen(T_true, surfaces(generator), generator)


@pytest.fixture(scope="module")
def closed(drive: Drive) -> PoseGraph:
    _, T_odometry, clouds = drive
    return close_loops(T_odometry, clouds, SETTINGS)


def test_a_drift_is_corrected_by_loops_only(drive: Drive, closed: PoseGraph) -> None:
    T_true, T_odometry, clouds = drive
    T = closed.corrected(T_odometry)
    before, after = off_m(T_odometry, T_true), off_m(T, T_true)
    assert before.max() > 0.3
    assert after.max() < 0.1 * before.max()
    np.testing.assert_allclose(T[0], closed.T_odom_first, atol=1e-12)
    np.testing.assert_allclose(T[0], T_odometry[0], atol=2e-2)  # the drift of the first scans
    assert np.count_nonzero(closed.is_loop & (closed.weight > 0)) > 10
    along = close_loops(T_odometry, clouds, SETTINGS.model_copy(update={"near_m": 0.0}))
    assert not along.is_loop.any()
    assert off_m(along.corrected(T_odometry), T_true).max() > 0.05


def test_the_result_does_not_depend_on_the_first_pose(drive: Drive, closed: PoseGraph) -> None:
    _, T_odometry, clouds = drive
    turn = Rotation.from_euler("zyx", [130, 20, -8], degrees=True)
    T_elsewhere = transforms.make_transform(turn, [40.0, -7.0, 3.0])
    moved = close_loops(T_elsewhere @ T_odometry, clouds, SETTINGS)
    np.testing.assert_array_equal(moved.first, closed.first)
    corrected = moved.corrected(T_elsewhere @ T_odometry)
    expected = T_elsewhere @ closed.corrected(T_odometry)
    np.testing.assert_allclose(corrected, expected, atol=5e-3)


def test_the_first_pose_is_registered_to_the_scans_after_it(drive: Drive) -> None:
    """Its error would turn the whole building."""
    T_true, _, clouds = drive
    T_odometry = T_true[:30].copy()
    off = Rotation.from_euler("zyx", [0.6, -0.3, 0.2], degrees=True)
    T_odometry[0] = T_true[0] @ transforms.make_transform(off, [0.02, 0.01, -0.02])
    T = close_loops(T_odometry, clouds[:30], SETTINGS).corrected(T_odometry)
    before, after = off_m(T_odometry, T_true[:30]), off_m(T, T_true[:30])
    assert before.max() > 0.05
    assert after.max() < 0.25 * before.max()


@pytest.mark.parametrize(("scans", "returns"), [(0, True), (1, True), (3, True), (30, False)])
def test_short_drives_and_empty_scans_keep_the_odometry(
    drive: Drive, scans: int, returns: bool
) -> None:
    T_odometry, clouds = drive[1][:scans], drive[2][:scans]
    if not returns:
        clouds = [np.zeros((0, 3), np.float32)] * scans
    graph = close_loops(T_odometry, clouds, SETTINGS)
    assert returns or not graph.weight.any()
    np.testing.assert_allclose(graph.corrected(T_odometry), T_odometry, atol=1e-6)


def shifted(*metres: float) -> FloatArray:
    return transforms.make_transform(translation=list(metres))


def test_unconstrained_directions_keep_the_odometry() -> None:
    """A bare corridor constrains the distance to its walls, not the way along them."""
    T_odometry = np.array([shifted(1.1 * i, 0.05 * (i % 2), 0.0) for i in range(12)])
    across = np.diag([1e5, 1e5, 1e5, 0.0, 1e5, 1e5])
    edges = [Edge(i, i + 1, Aligned(shifted(0.4, 0.0, 0.0), 0.9, across)) for i in range(11)]
    solved = solve(T_odometry, T_odometry, edges)
    np.testing.assert_allclose(solved[:, 0, 3], T_odometry[:, 0, 3], atol=0.02)
    np.testing.assert_allclose(solved[:, 1, 3], 0.0, atol=0.002)


def edge(T: FloatArray, first: int, second: int, share: float = 0.9) -> Edge:
    T_first_second = transforms.invert(T[first]) @ T[second]
    return Edge(first, second, Aligned(T_first_second, share, np.diag([1e5] * 6)))


def test_a_false_loop_is_rejected() -> None:
    T = np.array([shifted(float(i % 10), 0.0, 0.0) for i in range(20)])
    edges = [edge(T, i, i + 1) for i in range(19)] + [edge(T, i, i + 10) for i in (0, 2, 4, 6)]
    turn = Rotation.from_euler("z", 3, degrees=True)
    wrong = T.copy()
    wrong[15] = T[5] @ transforms.make_transform(turn, [0.6, -0.4, 0.0])
    solved = solve(T, T, [*edges, edge(wrong, 5, 15)])
    np.testing.assert_allclose(solved[:, :3, 3], T[:, :3, 3], atol=0.01)


@pytest.mark.parametrize(("slip_deg", "share"), [(2.0, 0.9), (-4.0, 0.9), (-4.0, 0.45)])
def test_loops_that_agree_correct_a_slip(slip_deg: float, share: float) -> None:
    """Before and after one wrong step, the robot returns to the same places."""
    T_true = np.array([shifted(float(i % 10), 0.0, 0.0) for i in range(20)])
    turn = Rotation.from_euler("z", slip_deg, degrees=True)
    slip = transforms.make_transform(turn, [0.08, -0.05, 0.0])
    T_odometry = np.concatenate([T_true[:12], slip @ T_true[12:]])
    edges = [edge(T_odometry, i - back, i) for i in range(20) for back in (1, 2) if i >= back]
    edges += [edge(T_true, i, i + 10 + k, share) for i in range(8) for k in (0, 1)]
    np.testing.assert_allclose(solve(T_odometry, T_odometry, edges), T_true, atol=0.01)


def test_corrections_are_interpolated_between_submaps() -> None:
    T = np.array([shifted(float(i), 0.0, 0.0) for i in range(11)])
    shift = transforms.from_yaw(np.radians(10), [0.0, 0.1, 0.0])
    submaps, corrections = np.stack([T[0], shift @ T[8]]), np.stack([np.eye(4), shift])
    graph = PoseGraph(T[0], np.array([0, 8]), submaps, corrections, *[np.zeros(0)] * 5)
    corrected = graph.corrected(T)
    np.testing.assert_allclose(corrected[[0, 8, 10]], [T[0], shift @ T[8], shift @ T[10]])
    np.testing.assert_allclose(transforms.yaw_of(corrected[4]), np.radians(5))
    np.testing.assert_allclose(corrected[4, :3, 3], ((T[4] + shift @ T[4]) / 2)[:3, 3])
