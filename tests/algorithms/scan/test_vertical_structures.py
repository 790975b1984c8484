"""Eq. 2, runs of upright samples, the up-most and the bottom-most, on lines of known shape."""

from collections.abc import Sequence

import numpy as np
import pytest

from ffmap.algorithms.scan.point_lines import SAMPLES
from ffmap.algorithms.scan.rearrangement import Returns
from ffmap.algorithms.scan.vertical_structures import (
    VerticalStructures,
    VerticalStructuresSettings,
    find_vertical_structures,
)

SETTINGS = VerticalStructuresSettings()
ORIGIN = np.array([0.5, -0.3, 1.0])
STEP_M = 0.02


def points_of(lines: Sequence[np.ndarray]) -> np.ndarray:
    """Points (L × 200, 3) from lines (200, 2) of horizontal range from the sensor and height."""
    azimuth = 0.3 + 0.7 * np.arange(len(lines))[:, None]
    rho, z = np.moveaxis(np.array(lines).reshape(-1, SAMPLES, 2), -1, 0)
    xy = np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth)], axis=-1) + ORIGIN[:2]
    return np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3).astype(np.float32)


def find(
    points: np.ndarray, samples: np.ndarray, settings: VerticalStructuresSettings = SETTINGS
) -> VerticalStructures:
    return find_vertical_structures(Returns(points, points[:, 2].copy(), ORIGIN), samples, settings)


def find_in(
    lines: Sequence[np.ndarray], settings: VerticalStructuresSettings = SETTINGS
) -> VerticalStructures:
    samples = np.arange(len(lines) * SAMPLES, dtype=np.int32).reshape(-1, SAMPLES)
    return find(points_of(lines), samples, settings)


def upright(rho_m: float, bottom_m: float, count: int) -> np.ndarray:
    return np.column_stack([np.full(count, rho_m), bottom_m + STEP_M * np.arange(count)])


def flat(near_m: float, z_m: float, count: int) -> np.ndarray:
    """A board from near to far: its horizontal range changes, its height does not."""
    return np.column_stack([near_m + STEP_M * np.arange(count), np.full(count, z_m)])


def extents(found: VerticalStructures) -> list[tuple[int, int, int]]:
    return list(zip(found.line.tolist(), found.first.tolist(), found.last.tolist(), strict=True))


def random_walks(seed: int, count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Lines that rise unevenly, are level now and then, and jump; shuffled in memory."""
    generator = np.random.default_rng(seed)
    shape = (count, SAMPLES)
    rise = generator.uniform(0.0, 0.03, shape) * (generator.random(shape) < 0.9)
    jump = generator.normal(0, 0.5, shape) * (generator.random(shape) < 0.06)
    # Upright and leaning stretches, so that there are runs and gaps between them.
    lean = np.repeat(generator.choice([0.0, 0.3, 3.0], (count, SAMPLES // 20)), 20, axis=1)
    rho = np.abs(3 + np.cumsum(lean * rise + jump, axis=1) + generator.normal(0, 0.002, shape))
    points = points_of(np.stack([rho, np.cumsum(rise, axis=1)], axis=2))
    place = generator.permutation(len(points))
    scattered = np.empty_like(points)
    scattered[place] = points
    samples = place.reshape(shape).astype(np.int32)
    samples[0, 1::2] = samples[0, ::2]  # a line of fewer returns than 200 repeats some
    return scattered, samples


def ranges_and_heights(points: np.ndarray, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    places = points[samples].astype(np.float64)
    return np.hypot(*np.moveaxis(places[..., :2] - ORIGIN[:2], -1, 0)), places[..., 2]


@pytest.mark.parametrize("seed", range(3))
def test_equation_2_is_the_printed_one(seed: int) -> None:
    points, samples = random_walks(seed)
    rho, z = ranges_and_heights(points, samples)
    rise = np.diff(z, axis=1)
    expected = np.where(rise != 0, np.diff(rho, axis=1) / np.where(rise != 0, rise, 1.0), np.nan)
    difference = find(points, samples).difference
    assert difference.dtype == np.float32
    assert np.all(np.isnan(difference[:, 0]))
    np.testing.assert_allclose(difference[:, 1:], expected, rtol=1e-5)
    assert np.count_nonzero(np.isnan(expected)) > 100


@pytest.mark.parametrize("seed", range(3))
def test_structures_are_the_unbroken_runs_of_ten_upright_samples_or_more(seed: int) -> None:
    points, samples = random_walks(seed)
    found = find(points, samples)
    np.testing.assert_array_equal(found.upright, np.abs(found.slope) < SETTINGS.slope_max)
    rho, z = ranges_and_heights(points, samples)
    step_max = np.maximum(0.12, SETTINGS.slope_max * np.abs(np.diff(z, axis=1)))
    jumps = np.abs(np.diff(rho, axis=1)) > step_max
    expected = []
    for line in range(len(samples)):
        run: list[int] = []
        for j in range(SAMPLES + 1):
            ends = j == SAMPLES or not found.upright[line, j] or (j > 0 and jumps[line, j - 1])
            if ends and len(run) >= SETTINGS.points_min:
                expected.append((line, run[0], run[-1]))
            run = [] if ends else run
            if j < SAMPLES and found.upright[line, j]:
                run.append(j)
    assert extents(found) == expected
    assert len(expected) > 10
    for line in range(len(samples)):
        own = np.flatnonzero(found.line == line)
        assert found.upmost[line] == own[np.argmax(found.top_m[own])]
        assert found.bottommost[line] == own[np.argmin(found.bottom_m[own])]


@pytest.mark.parametrize("lean", [0.0, 0.5, -0.9, 1.1, -3.0])
def test_the_slope_is_the_lines_own_and_decides_what_is_upright(lean: float) -> None:
    line = upright(3.0, 0.0, SAMPLES)
    line[:, 1] *= 0.5
    line[:, 0] += lean * line[:, 1] + 4.0
    found = find_in([line])
    np.testing.assert_allclose(found.slope[0], lean, atol=1e-3)
    assert np.all(found.upright[0] == (abs(lean) < SETTINGS.slope_max))
    assert extents(found) == ([(0, 0, SAMPLES - 1)] if abs(lean) < SETTINGS.slope_max else [])


def test_the_upmost_is_the_wall_and_the_bottommost_the_cabinet_before_it() -> None:
    above = upright(2.0, 0.82, SAMPLES - 75)
    cabinet = np.concatenate([upright(1.2, 0.1, 36), flat(1.22, 0.8, 39), above])
    found = find_in([cabinet, upright(2.5, 0.1, SAMPLES), flat(1.0, 0.7, SAMPLES)])
    highest, lowest = int(found.upmost[0]), int(found.bottommost[0])
    assert highest != lowest
    assert (found.line[highest], found.line[lowest]) == (0, 0)
    # The wall from the cabinet's top upwards, its front below; the span rounds corners.
    heights_m = [found.bottom_m[lowest], found.top_m[lowest], found.bottom_m[highest]]
    np.testing.assert_allclose(heights_m, [0.1, 0.8, 0.82], atol=0.1)
    assert found.top_m[highest] == pytest.approx(cabinet[-1, 1])
    # A single structure is both; a board has none.
    assert found.upmost[1] == found.bottommost[1]
    assert extents(found)[found.upmost[1]] == (1, 0, SAMPLES - 1)
    assert found.upmost[2] == found.bottommost[2] == -1


def test_noise_breaks_the_printed_difference_and_not_the_slope() -> None:
    """A wall 2 m away, returns 5 mm apart in height, 1.5 cm of noise."""
    noise = np.random.default_rng(0).normal(0, 0.015, SAMPLES)
    found = find_in([np.column_stack([2 + noise, 0.5 + 0.005 * np.arange(SAMPLES)])])
    printed = np.abs(found.difference[0]) < 2.0
    assert 0.1 < np.mean(printed) < 0.5
    breaks = np.flatnonzero(~printed)
    assert np.diff([*breaks, SAMPLES]).max() <= SETTINGS.points_min  # fewer than ten in a row
    assert len(found.line) == 1
    assert found.last[0] - found.first[0] > 0.95 * SAMPLES


def test_a_line_without_samples_has_nothing_and_does_not_affect_others() -> None:
    points = points_of([upright(2.0 + i, 0.1, SAMPLES) for i in range(4)])
    samples = np.arange(4 * SAMPLES, dtype=np.int32).reshape(4, SAMPLES)
    samples[[0, 2]] = -1
    found = find(points, samples)
    assert np.all(np.isnan(found.difference[[0, 2]]) & np.isnan(found.slope[[0, 2]]))
    assert not np.any(found.upright[[0, 2]])
    assert found.upmost.tolist() == found.bottommost.tolist() == [-1, 0, -1, 1]
    assert extents(found) == [(1, 0, SAMPLES - 1), (3, 0, SAMPLES - 1)]
