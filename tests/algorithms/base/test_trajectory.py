"""Poses between stamps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import Trajectory


def test_poses_between_stamps_are_scipys() -> None:
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
