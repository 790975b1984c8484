"""Errors of a trajectory, against answers by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.truth.poses import align, compare_trajectories


def curve(count: int = 200) -> Trajectory:
    """A drive of some 12 m with turns, sway and 0.1 s between poses."""
    t = np.linspace(0, 20, count)
    angles = np.stack([0.8 * np.cos(0.4 * t), 0.02 * t, 0.01 * t], axis=1)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("zyx", angles).as_matrix()
    T[:, :3, 3] = np.stack([0.5 * t, 2 * np.sin(0.4 * t), 0.02 * np.sin(t)], axis=1)
    return Trajectory((t * 1e9).astype(np.int64), T)


def test_a_moved_trajectory_is_right_once_aligned() -> None:
    turn = Rotation.from_euler("zyx", [0.7, 0.1, -0.2])
    T_new_map = transforms.make_transform(turn, [3.0, -4.0, 0.0])
    errors = compare_trajectories(curve().moved(T_new_map), curve())
    np.testing.assert_allclose(errors.error_m, 0, atol=1e-9)
    np.testing.assert_allclose(errors.rotation_error_deg, 0, atol=1e-5)
    np.testing.assert_allclose(errors.relative_translation_m, 0, atol=1e-9)
    assert errors.error_unaligned_m.min() > 1


def test_known_shifts_turns_and_scale() -> None:
    true = curve()
    T = true.T_map_base.copy()
    T[::2, 2, 3] += 0.01
    T[1::2, 2, 3] -= 0.01
    T[::2, :3, :3] = Rotation.from_euler("z", 2, degrees=True).as_matrix() @ T[::2, :3, :3]
    errors = compare_trajectories(Trajectory(true.stamp_ns, T), true)
    np.testing.assert_allclose(errors.error_m, 0.01, rtol=0.05)
    np.testing.assert_allclose(errors.error_unaligned_m, 0.01)
    np.testing.assert_allclose(errors.rotation_error_deg, 1.0, atol=1e-6)
    T = true.T_map_base.copy()
    T[:, :3, 3] *= 1.01
    scaled = compare_trajectories(Trajectory(true.stamp_ns, T), true)
    assert np.sqrt((scaled.error_m**2).mean()) > 0.02  # not aligned away
    assert scaled.relative_translation_m.mean() == pytest.approx(0.01, rel=0.1)


def test_only_what_the_ground_truth_covers_is_compared() -> None:
    true = curve()
    early = Trajectory(true.stamp_ns - 5_000_000_000, true.T_map_base)
    covered = np.count_nonzero(true.covers(early.stamp_ns))
    assert len(compare_trajectories(early, true).error_m) == covered
    stamp_ns = np.arange(0, 20_000_000_000, 70_000_000)
    between = compare_trajectories(Trajectory(stamp_ns, true.at(stamp_ns)), true)
    assert between.error_m.max() < 1e-9
    later = Trajectory(true.stamp_ns + 10**12, true.T_map_base)
    assert len(compare_trajectories(later, true).error_m) == 0


def test_standing_still_has_no_relative_error() -> None:
    still = Trajectory(np.arange(5), np.tile(np.eye(4), (5, 1, 1)))
    errors = compare_trajectories(still, still)
    assert len(errors.relative_translation_m) == 0
    np.testing.assert_allclose(errors.error_m, np.zeros(5), atol=1e-12)


def test_alignment_recovers_a_known_motion_and_never_mirrors() -> None:
    source = np.random.default_rng(0).normal(size=(50, 3))
    T = transforms.make_transform(Rotation.from_euler("zyx", [1, -0.4, 2.5]), [1, 2, 3])
    np.testing.assert_allclose(align(source, transforms.apply(T, source)), T, atol=1e-9)
    mirrored = align(source, source * [1, 1, -1])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1)
