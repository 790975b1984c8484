"""Flat patches among points: where they lie, how they stand, and where there are none."""

import numpy as np
import pytest

from ffmap.algorithms.poses.patches import Patches


def test_patches_lie_on_the_planes_they_are_of() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(-2, 2, (20_000, 2)), rng.normal(0, 0.005, 20_000)])
    patches = Patches.of(plane, voxel_m=0.1, neighbours=16)
    assert len(patches.centre) > 1000
    assert np.abs(patches.centre[:, 2]).max() < 0.01
    assert np.abs(patches.normal[:, 2]).min() > 0.99
    assert not len(Patches.of(rng.uniform(-1, 1, (20_000, 3)), voxel_m=0.1, neighbours=16).centre)


def test_a_line_is_no_patch() -> None:
    """Any plane through it would fit."""
    rng = np.random.default_rng(1)
    line = np.column_stack([rng.uniform(-20, 20, 20_000), *rng.normal(0, 0.002, (2, 20_000))])
    assert not len(Patches.of(line, voxel_m=0.1, neighbours=16).centre)


def test_patches_of_a_plane_at_a_cubes_side_lie_on_it() -> None:
    """A tenth of its returns scatter into the next cubes, which must not count as much as the full ones."""
    rng = np.random.default_rng(2)
    plane = np.column_stack([rng.uniform(-2, 2, (200_000, 2)), rng.normal(0.088, 0.01, 200_000)])
    patches = Patches.of(plane, voxel_m=0.1, neighbours=16)
    assert patches.centre[:, 2].mean() == pytest.approx(0.088, abs=0.0005)
