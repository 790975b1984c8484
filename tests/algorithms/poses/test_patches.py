"""Planar patches among points."""

import numpy as np
import pytest

from ffmap.algorithms.poses.patches import Patches


def plane(count: int, height_m: float, noise_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-2, 2, (count, 2)), rng.normal(height_m, noise_m, count)])


def test_patches_are_on_their_plane() -> None:
    patches = Patches.of(plane(20_000, 0.0, 0.005), 0.1, 16)
    assert len(patches.centre) > 1000
    assert np.abs(patches.centre[:, 2]).max() < 0.01
    assert np.abs(patches.normal[:, 2]).min() > 0.99


def test_the_few_returns_beyond_a_voxels_side_count_little() -> None:
    patches = Patches.of(plane(200_000, 0.088, 0.01), 0.1, 16)
    assert patches.centre[:, 2].mean() == pytest.approx(0.088, abs=0.0005)


def test_volumes_and_lines_have_no_patches() -> None:
    rng = np.random.default_rng(1)
    line = np.column_stack([rng.uniform(-20, 20, 20_000), *rng.normal(0, 0.002, (2, 20_000))])
    for points in (rng.uniform(-1, 1, (20_000, 3)), line, np.zeros((5, 3))):
        assert not len(Patches.of(points, 0.1, 16).centre)
