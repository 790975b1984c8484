"""Trajectories in and out, to the nanosecond."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.frames import FrameTree, StaticTransform
from ffmap.loaders.trajectory_file import read_pose_topic, read_tum, write_tum
from tests.loaders.bag_builder import START_NS, odometry, tf_message, write_bag


def random_trajectory(count=50):
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-100, 100, (count, 3))
    return Trajectory(START_NS + np.cumsum(rng.integers(1, 10**9, count)), T)


def test_round_trip_keeps_every_nanosecond(tmp_path):
    trajectory = random_trajectory()
    write_tum(tmp_path / "a.tum", trajectory)
    again = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(again.stamp_ns, trajectory.stamp_ns)
    np.testing.assert_allclose(again.T_map_base, trajectory.T_map_base, atol=2e-8)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tum"]
    first = (tmp_path / "a.tum").read_text().split()[0]
    assert first == f"{trajectory.stamp_ns[0] // 10**9}.{trajectory.stamp_ns[0] % 10**9:09d}"


def test_comments_exponents_and_few_decimals(tmp_path):
    (tmp_path / "a.tum").write_text(
        "# stamp x\n\n1.5e0 1 2 3 0 0 0 1\n\t2.000000001 1 2 3 0 0 0 -1 # end\n"
    )
    assert read_tum(tmp_path / "a.tum").stamp_ns.tolist() == [1_500_000_000, 2_000_000_001]


@pytest.mark.parametrize("unit_ns", [1, 1_000, 1_000_000, 1_000_000_000])
def test_stamps_in_any_unit(tmp_path, unit_ns):
    stamps_ns = [START_NS, START_NS + 100_000_000, START_NS + 250_000_000]
    with_fraction = "" if unit_ns < 1_000_000_000 else ".{:09d}"
    rows = [f"{t // unit_ns}{with_fraction.format(t % unit_ns)} 1 2 3 0 0 0 1" for t in stamps_ns]
    (tmp_path / "a.tum").write_text("\n".join(rows))
    assert read_tum(tmp_path / "a.tum").stamp_ns.tolist() == stamps_ns


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no poses"),
        ("1 0 0 0 0 0 0 1\n1700000000000000000 0 0 0 0 0 0 1\n", "line 2: not all values are"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 2: 7 values"),
        ("1 0 0 a 0 0 0 1\n", "line 1: not all values are numbers"),
        ("nan 0 0 0 0 0 0 1\n", "line 1: not all values are numbers"),
        ("91700000000 0 0 0 0 0 0 1\n", "line 1: not all values are numbers"),
        ("1e999999999 0 0 0 0 0 0 1\n", "line 1: not all values are numbers"),
        ("1 0 0 nan 0 0 0 1\n", "line 1: the quaternion"),
        ("1 0 0 0 0 0 0 0\n", "line 1: the quaternion"),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2: the stamp"),
    ],
)
def test_a_file_that_is_not_understood_names_the_line(tmp_path, text, words):
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_tum(path)
    assert words in str(caught.value)
    assert "bad.tum" in str(caught.value)
    with pytest.raises(InputError, match=r"none\.tum"):
        read_tum(tmp_path / "none.tum")


def test_poses_of_an_odometry_topic(tmp_path):
    stamps = START_NS + np.array([0, 10, 5, 20, 20, 30])
    entries = [("/odom", START_NS + i, odometry(int(s), [i, 0, 0])) for i, s in enumerate(stamps)]
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        trajectory = read_pose_topic(bag, "odom", "base")
        assert (trajectory.stamp_ns - START_NS).tolist() == [0, 10, 20, 30]
        assert trajectory.T_map_base[:, 0, 3].tolist() == [0, 1, 3, 5]
        with pytest.raises(InputError, match="poses of frame base, and no transform joins it with"):
            read_pose_topic(bag, "/odom", "other")
        T = np.eye(4)
        T[1, 3] = 2.0
        static = FrameTree([StaticTransform("base", "other", T)])
        moved = read_pose_topic(bag, "/odom", "other", static)
        assert moved.T_map_base[0, :3, 3].tolist() == [0, 2, 0]


def test_poses_of_a_chain_of_transforms(tmp_path):
    entries = []
    for i in range(11):
        edges = [("odom", "base", [0.1 * i, 0, 0], [0, 0, 0, 1])]
        if i % 5 == 0:
            edges.append(("map", "odom", [0, 0.1 * i, 0], [0, 0, 0, 1]))
        entries.append(("/tf", START_NS + i, tf_message(edges, stamp_ns=START_NS + i * 10**8)))
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        trajectory = read_pose_topic(bag, "/tf", "base")
        assert len(trajectory) == 11
        np.testing.assert_allclose(trajectory.T_map_base[:, 0, 3], 0.1 * np.arange(11))
        np.testing.assert_allclose(trajectory.T_map_base[:, 1, 3], 0.1 * np.arange(11), atol=1e-9)
        with pytest.raises(InputError, match="moves nothing above frame lidar; it has: base, odom"):
            read_pose_topic(bag, "/tf", "lidar")
