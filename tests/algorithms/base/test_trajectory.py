"""Transforms, and poses between stamps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import Trajectory, gaps


def test_quaternions_and_headings_there_and_back() -> None:
    generator = np.random.default_rng(1)
    for turn in Rotation.from_rotvec(generator.uniform(-4.0, 4.0, (50, 3))):
        T = transforms.make_transform(turn, generator.uniform(-1e3, 1e3, 3))
        quaternion = transforms.quaternion_xyzw(T)
        assert quaternion[3] >= 0
        np.testing.assert_allclose(transforms.from_quaternion(T[:3, 3], quaternion), T, atol=1e-9)
        np.testing.assert_allclose(transforms.invert(T) @ T, np.eye(4), atol=1e-9)
    for yaw_rad in np.linspace(-3.1, 3.1, 9).tolist():
        assert transforms.yaw_of(transforms.from_yaw(yaw_rad, [0.0] * 3)) == pytest.approx(yaw_rad)


def test_interpolation_agrees_with_scipy() -> None:
    generator = np.random.default_rng(0)
    turns = Rotation.from_rotvec(np.cumsum(generator.normal(0, 0.1, (8, 3)), axis=0))
    T = np.stack([transforms.make_transform(r, [i, 2 * i, 0]) for i, r in enumerate(turns)])
    stamps = 1_700_000_000_000_000_000 + np.arange(8) * 100_000_000
    trajectory = Trajectory(stamps, T)
    times = stamps[0] + generator.integers(0, 700_000_000, 50)
    expected = Slerp((stamps - stamps[0]) * 1e-9, turns)((times - stamps[0]) * 1e-9)
    ours = trajectory.at(times)
    assert np.max((Rotation.from_matrix(ours[:, :3, :3]).inv() * expected).magnitude()) < 1e-6
    np.testing.assert_allclose(ours[:, 0, 3], (times - stamps[0]) / 1e8, atol=1e-6)
    with pytest.raises(ValueError, match="increase"):
        Trajectory(stamps[::-1], T)


def test_within_a_gap_the_motion_is_unknown_and_extrapolated_from_either_side() -> None:
    times = np.array([0, 1, 2, 12, 13, 14]) * 100_000_000
    places = (0.0, 1.0, 2.0, 20.0, 19.0, 18.0)
    T = np.stack([transforms.make_transform(None, [x, 0.0, 0.0]) for x in places])
    assert gaps(times).tolist() == [2]
    asked = np.array([150, 250, 320, 330, 700, 1080, 1180, 1250]) * 1_000_000
    whole, parted = Trajectory(times, T), Trajectory(times, T, gap_ns=250_000_000)
    assert whole.covers(asked).all()
    within = [True, True, True, False, False, True, True, True]
    for trajectory in (parted, parted.moved(np.eye(4)), parted.part(1, 6)):
        assert trajectory.covers(asked, 300_000_000).tolist() == within
    expected = [1.5, 2.5, 3.2, 3.3, 7.0, 21.2, 20.2, 19.5]
    np.testing.assert_allclose(parted.at(asked)[:, 0, 3], expected, atol=1e-6)
    assert parted.covers(asked, -50_000_000).tolist() == [True] + [False] * 6 + [True]
