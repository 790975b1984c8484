"""Errors of a trajectory, each against an answer worked out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.truth.poses import align, compare_trajectories


def curve(count: int = 200) -> Trajectory:
    """A drive of some 12 m with turns, sway and 0.1 s between poses."""
    t = np.linspace(0, 20, count)
    positions = np.stack([0.5 * t, 2 * np.sin(0.4 * t), 0.02 * np.sin(t)], axis=1)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("zyx", np.stack([0.8 * np.cos(0.4 * t), 0.02 * t, 0.01 * t], axis=1)).as_matrix()
    T[:, :3, 3] = positions
    return Trajectory((t * 1e9).astype(np.int64), T)


class TestTrajectory:
    def test_a_moved_trajectory_is_right_once_aligned(self):
        T_new_map = transforms.make_transform(Rotation.from_euler("zyx", [0.7, 0.1, -0.2]), [3.0, -4.0, 0.0])
        figures = compare_trajectories(curve().moved(T_new_map), curve())
        np.testing.assert_allclose(figures.error_m, 0, atol=1e-9)
        np.testing.assert_allclose(figures.rotation_error_deg, 0, atol=1e-5)
        np.testing.assert_allclose(figures.relative_translation_m, 0, atol=1e-9)
        assert figures.error_unaligned_m.min() > 1

    def test_known_shifts(self):
        true = curve()
        T = true.T_map_base.copy()
        T[::2, 2, 3] += 0.01
        T[1::2, 2, 3] -= 0.01
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        assert figures.ate_rmse_m == pytest.approx(0.01, rel=1e-3)
        np.testing.assert_allclose(figures.error_unaligned_m, 0.01)

    def test_scale_is_not_aligned_away(self):
        true = curve()
        T = true.T_map_base.copy()
        T[:, :3, 3] *= 1.01
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        assert figures.ate_rmse_m > 0.02
        assert figures.relative_translation_m.mean() == pytest.approx(0.01, rel=0.1)

    def test_rotation_by_hand(self):
        true = curve()
        T = true.T_map_base.copy()
        T[::2, :3, :3] = Rotation.from_euler("z", 2, degrees=True).as_matrix() @ T[::2, :3, :3]
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        np.testing.assert_allclose(figures.rotation_error_deg, 1.0, atol=1e-6)

    def test_only_what_the_truth_covers_and_between_its_poses(self):
        true = curve()
        early = Trajectory(true.stamp_ns - 5_000_000_000, true.T_map_base)
        assert compare_trajectories(early, true).poses == np.count_nonzero(true.covers(early.stamp_ns))
        finer = Trajectory(np.arange(0, 20_000_000_000, 70_000_000), true.at(np.arange(0, 20_000_000_000, 70_000_000)))
        assert compare_trajectories(finer, true).ate_rmse_m < 1e-9

    def test_no_common_time(self):
        true = curve()
        figures = compare_trajectories(Trajectory(true.stamp_ns + 10**12, true.T_map_base), true)
        assert figures.poses == 0
        assert np.isnan(figures.ate_rmse_m)

    def test_standing_still_has_no_relative_error(self):
        T = np.tile(np.eye(4), (5, 1, 1))
        figures = compare_trajectories(Trajectory(np.arange(5), T), Trajectory(np.arange(5), T))
        assert (figures.poses, len(figures.relative_translation_m)) == (5, 0)
        assert figures.ate_rmse_m == pytest.approx(0)

    def test_alignment_recovers_a_known_motion_and_never_mirrors(self):
        generator = np.random.default_rng(0)
        source = generator.normal(size=(50, 3))
        T = transforms.make_transform(Rotation.from_euler("zyx", [1, -0.4, 2.5]), [1, 2, 3])
        np.testing.assert_allclose(align(source, transforms.apply(T, source)), T, atol=1e-9)
        mirrored = align(source, source * [1, 1, -1])
        assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1)
