"""Loops closed on a drive around a block of rooms, whose way and walls are known and whose odometry drifts."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.gaussian_map import Aligned
from ffmap.algorithms.poses.pose_graph import PoseGraph, PoseGraphSettings, _Edge, _solve, close_loops

SETTINGS = PoseGraphSettings(submap_scans=8, every_scans=4)
POINTS = 1200


def walls(generator: np.random.Generator) -> FloatArray:
    """(n, 3) points of a corridor around a block of 6 by 4 m, with floor, ceiling and pillars at uneven places."""
    sides = []
    for low, high in (([-4.5, -3.5], [4.5, 3.5]), ([-3.0, -2.0], [3.0, 2.0])):
        for axis in (0, 1):
            for end in (low, high):
                count = 12_000
                side = np.empty((count, 3))
                side[:, axis] = end[axis]
                side[:, 1 - axis] = generator.uniform(low[1 - axis], high[1 - axis], count)
                side[:, 2] = generator.uniform(0.0, 2.6, count)
                sides.append(side)
    for x, y in ((-4.4, -1.0), (-1.7, 3.4), (1.2, 2.1), (4.4, 0.7), (2.2, -3.4), (-0.4, -2.1)):
        turn = generator.uniform(0, 2 * np.pi, 4000)
        sides.append(
            np.stack([x + 0.2 * np.cos(turn), y + 0.2 * np.sin(turn), generator.uniform(0, 2.6, 4000)], axis=1)
        )
    for height in (0.0, 2.6):
        flat = np.stack([generator.uniform(-4.5, 4.5, 60_000), generator.uniform(-3.5, 3.5, 60_000)], axis=1)
        flat = flat[(np.abs(flat[:, 0]) > 3.0) | (np.abs(flat[:, 1]) > 2.0)]
        sides.append(np.column_stack([flat, np.full(len(flat), height)]))
    return np.concatenate(sides)


def way(laps: float, scans: int) -> FloatArray:
    """T_map_sensor (n, 4, 4) along the corridor, facing ahead."""
    corners = np.array([[-3.75, -2.75], [3.75, -2.75], [3.75, 2.75], [-3.75, 2.75], [-3.75, -2.75]])
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    at = np.linspace(0, laps * lengths.sum(), scans) % lengths.sum()
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    side = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, 3)
    ahead = np.diff(corners, axis=0)[side] / lengths[side, None]
    xy = corners[side] + ahead * (at - ends[side])[:, None]
    return np.array(
        [
            transforms.from_yaw(float(np.arctan2(a[1], a[0])), [float(p[0]), float(p[1]), 1.0])
            for p, a in zip(xy, ahead, strict=True)
        ]
    )


def seen(T_true: FloatArray, points: FloatArray, generator: np.random.Generator) -> list[FloatArray]:
    """What each pose sees within 4 m, with 1 cm of noise."""
    clouds = []
    for T in T_true:
        near = points[np.linalg.norm(points - T[:3, 3], axis=1) < 4.0]
        chosen = near[generator.choice(len(near), POINTS)] + generator.normal(0, 0.01, (POINTS, 3))
        clouds.append(transforms.apply(transforms.invert(T), chosen).astype(np.float32))
    return clouds


def drifting(T_true: FloatArray, yaw_deg: float, stretch: float) -> FloatArray:
    """The same way as an odometry has it that turns too far by `yaw_deg` and goes too far by a share of the way."""
    T = [np.eye(4)]
    turn = transforms.from_yaw(np.radians(yaw_deg) / len(T_true), [0.0, 0.0, 0.0])
    for before, after in itertools.pairwise(T_true):
        step = transforms.invert(before) @ after
        step[:3, 3] *= 1.0 + stretch
        T.append(T[-1] @ step @ turn)
    return np.array(T)


def off_m(T: FloatArray, T_true: FloatArray) -> FloatArray:
    """(n,) metres from the true way, both seen from their first pose."""
    return np.linalg.norm((transforms.invert(T[0]) @ T - transforms.invert(T_true[0]) @ T_true)[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def drive() -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """True poses, the odometry's, and the clouds, of two laps."""
    generator = np.random.default_rng(7)
    T_true = way(2.0, 160)
    return T_true, drifting(T_true, 4.0, 0.01), seen(T_true, walls(generator), generator)


@pytest.fixture(scope="module")
def closed(drive: tuple[FloatArray, FloatArray, list[FloatArray]]) -> PoseGraph:
    _, T_odometry, clouds = drive
    return close_loops(T_odometry, clouds, SETTINGS)


def test_a_drift_is_undone_where_the_robot_comes_by_again(
    drive: tuple[FloatArray, FloatArray, list[FloatArray]], closed: PoseGraph
) -> None:
    T_true, T_odometry, _ = drive
    T = closed.corrected(T_odometry)
    before, after = off_m(T_odometry, T_true), off_m(T, T_true)
    assert before.max() > 0.3
    assert after.max() < 0.1 * before.max()
    np.testing.assert_allclose(T[0], closed.T_odom_first, atol=1e-12)
    np.testing.assert_allclose(T[0], T_odometry[0], atol=2e-2)  # the drift of the first few scans
    assert np.count_nonzero(closed.is_loop & (closed.weight > 0)) > 10
    np.testing.assert_allclose(
        T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2), np.broadcast_to(np.eye(3), (160, 3, 3)), atol=1e-9
    )


def test_the_first_pose_is_told_by_the_scans_after_it(drive: tuple[FloatArray, FloatArray, list[FloatArray]]) -> None:
    """The map is placed by it: what it is turned by, the whole building is."""
    T_true, _, clouds = drive
    T_odometry = T_true[:30].copy()
    off = Rotation.from_euler("zyx", [0.6, -0.3, 0.2], degrees=True)
    T_odometry[0] = T_true[0] @ transforms.make_transform(off, [0.02, 0.01, -0.02])
    T = close_loops(T_odometry, clouds[:30], SETTINGS).corrected(T_odometry)
    before, after = off_m(T_odometry, T_true[:30]), off_m(T, T_true[:30])
    assert before.max() > 0.05
    assert after.max() < 0.25 * before.max()


def test_without_loops_the_drift_stays(drive: tuple[FloatArray, FloatArray, list[FloatArray]]) -> None:
    """What undoes it is the loops, not the registration of neighbours."""
    T_true, T_odometry, clouds = drive
    along = close_loops(T_odometry, clouds, SETTINGS.model_copy(update={"near_m": 0.0}))
    assert not along.is_loop.any()
    assert off_m(along.corrected(T_odometry), T_true).max() > 0.05


def test_it_is_the_same_wherever_the_odometry_began(
    drive: tuple[FloatArray, FloatArray, list[FloatArray]], closed: PoseGraph
) -> None:
    _, T_odometry, clouds = drive
    T_elsewhere = transforms.make_transform(Rotation.from_euler("zyx", [130, 20, -8], degrees=True), [40.0, -7.0, 3.0])
    moved = close_loops(T_elsewhere @ T_odometry, clouds, SETTINGS)
    np.testing.assert_array_equal(moved.first, closed.first)
    np.testing.assert_allclose(
        moved.corrected(T_elsewhere @ T_odometry), T_elsewhere @ closed.corrected(T_odometry), atol=2e-3
    )


def test_the_same_drive_gives_the_same_poses(
    drive: tuple[FloatArray, FloatArray, list[FloatArray]], closed: PoseGraph
) -> None:
    _, T_odometry, clouds = drive
    again = close_loops(T_odometry, clouds, SETTINGS)
    np.testing.assert_array_equal(again.T_odom_sensor, closed.T_odom_sensor)
    np.testing.assert_array_equal(again.weight, closed.weight)


@pytest.mark.parametrize("scans", [0, 1, 3])
def test_a_drive_too_short_for_a_loop_is_left_as_it_is(
    drive: tuple[FloatArray, FloatArray, list[FloatArray]], scans: int
) -> None:
    _, T_odometry, clouds = drive
    graph = close_loops(T_odometry[:scans], clouds[:scans], SETTINGS)
    np.testing.assert_allclose(graph.corrected(T_odometry[:scans]), T_odometry[:scans], atol=1e-12)


def test_scans_without_returns_keep_the_odometrys_way(drive: tuple[FloatArray, FloatArray, list[FloatArray]]) -> None:
    _, T_odometry, _ = drive
    graph = close_loops(T_odometry[:30], [np.zeros((0, 3), np.float32)] * 30, SETTINGS)
    assert not graph.weight.any()
    np.testing.assert_allclose(graph.corrected(T_odometry[:30]), T_odometry[:30], atol=1e-6)


def test_what_no_registration_holds_is_left_to_the_odometry() -> None:
    """A bare corridor says how far off its walls are, and nothing of how far one has come."""
    T_odometry = np.array([transforms.make_transform(translation=[1.1 * i, 0.05 * (i % 2), 0.0]) for i in range(12)])
    across = np.diag([1e5, 1e5, 1e5, 0.0, 1e5, 1e5])
    step = transforms.make_transform(translation=[0.4, 0.0, 0.0])
    edges = [_Edge(i, i + 1, Aligned(step, 0.9, across)) for i in range(11)]
    solved = _solve(T_odometry, T_odometry, edges)
    np.testing.assert_allclose(solved[:, 0, 3], T_odometry[:, 0, 3], atol=0.02)
    np.testing.assert_allclose(solved[:, 1, 3], 0.0, atol=0.002)


def test_a_false_loop_is_let_go_of() -> None:
    T = np.array([transforms.make_transform(translation=[float(i % 10), 0.0, 0.0]) for i in range(20)])
    held = np.diag([1e5] * 3 + [1e5] * 3)
    edges = [_Edge(i, i + 1, Aligned(transforms.invert(T[i]) @ T[i + 1], 0.9, held)) for i in range(19)]
    edges += [_Edge(i, i + 10, Aligned(np.eye(4), 0.9, held)) for i in (0, 2, 4, 6)]
    wrong = transforms.make_transform(Rotation.from_euler("z", 3, degrees=True), [0.6, -0.4, 0.0])
    solved = _solve(T, T, [*edges, _Edge(5, 15, Aligned(wrong, 0.9, held))])
    np.testing.assert_allclose(solved[:, :3, 3], T[:, :3, 3], atol=0.01)


@pytest.mark.parametrize(("slip_deg", "loop_share"), [(2.0, 0.9), (-4.0, 0.9), (-4.0, 0.45)])
def test_loops_that_agree_put_a_slip_of_the_way_right(slip_deg: float, loop_share: float) -> None:
    """One registration slipped, to both sides of which the robot came again, and saw much of what it had seen, or little."""
    T_true = np.array([transforms.make_transform(translation=[float(i % 10), 0.0, 0.0]) for i in range(20)])
    slip = transforms.make_transform(Rotation.from_euler("z", slip_deg, degrees=True), [0.08, -0.05, 0.0])
    T_odometry = np.concatenate([T_true[:12], slip @ T_true[12:]])
    held = np.diag([1e5] * 6)

    def registered(T: FloatArray, first: int, second: int, share: float = 0.9) -> _Edge:
        return _Edge(first, second, Aligned(transforms.invert(T[first]) @ T[second], share, held))

    edges = [registered(T_odometry, i - back, i) for i in range(20) for back in (1, 2) if i >= back]
    edges += [registered(T_true, i, i + 10 + k, loop_share) for i in range(8) for k in (0, 1)]
    solved = _solve(T_odometry, T_odometry, edges)
    np.testing.assert_allclose(solved, T_true, atol=0.01)


def test_where_the_odometry_slipped_is_told() -> None:
    first, second = np.array([0, 1, 0, 2, 0]), np.array([1, 2, 2, 3, 3])
    weight = np.array([0.9, 0.01, 0.02, 0.0, 0.01])  # the last but one fits too little to tell, the last is a loop
    T, none = np.tile(np.eye(4), (4, 1, 1)), np.zeros(5)
    graph = PoseGraph(T[0], np.array([0, 10, 20, 30]), T, T, first, second, none, none, weight)
    assert graph.slips.tolist() == [0, 10]


def test_poses_between_two_submaps_are_blended() -> None:
    T = np.array([transforms.make_transform(translation=[float(i), 0.0, 0.0]) for i in range(11)])
    shift = transforms.make_transform(Rotation.from_euler("z", 10, degrees=True), [0.0, 0.1, 0.0])
    none = np.zeros(0)
    graph = PoseGraph(
        T[0],
        np.array([0, 8]),
        np.stack([T[0], shift @ T[8]]),
        np.stack([np.eye(4), shift]),
        none,
        none,
        none,
        none,
        none,
    )
    corrected = graph.corrected(T)
    np.testing.assert_allclose(corrected[0], T[0])
    np.testing.assert_allclose(corrected[8], shift @ T[8])
    np.testing.assert_allclose(corrected[10], shift @ T[10])  # beyond the last middle
    np.testing.assert_allclose(transforms.yaw_of(corrected[4]), np.radians(5))
    np.testing.assert_allclose(corrected[4, :3, 3], ((T[4] + shift @ T[4]) / 2)[:3, 3])
