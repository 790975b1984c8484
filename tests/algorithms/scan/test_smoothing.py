"""Ranges smoothed along the rings: planes come out thin, edges and thin things are kept."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray, Scan, subset
from ffmap.algorithms.scan.smoothing import SmoothedRanges, SmoothingSettings, smooth_ranges
from tests import synthetic

SETTINGS = SmoothingSettings()
FIRINGS, RINGS = 1800, 8
AZIMUTH = (np.arange(FIRINGS) + 0.5) * 2 * np.pi / FIRINGS - np.pi
ELEVATION = np.radians(np.linspace(-12, 12, RINGS))
CORRECTION_MAX_M = 3.5 * 0.06  # in scatters, of which 6 cm is the largest


def room(scale: float = 1.0) -> FloatArray:
    """(RINGS, FIRINGS) exact ranges from the middle of a room of 6 × 4 m."""
    sides = np.array([[3.0], [2.0]]) / np.abs([np.cos(AZIMUTH), np.sin(AZIMUTH)])
    return scale * np.min(sides, axis=0) / np.cos(ELEVATION)[:, None]


def scan_of(range_m: FloatArray, noise_m: float, seed: int = 0) -> Scan:
    """A sweep with these ranges (RINGS, FIRINGS); infinite ones are no returns."""
    seen = np.isfinite(range_m).ravel()
    measured = range_m + np.random.default_rng(seed).normal(0.0, noise_m, range_m.shape)
    flat, up = np.cos(ELEVATION)[:, None], np.sin(ELEVATION)[:, None]
    axes = np.broadcast_arrays(flat * np.cos(AZIMUTH), flat * np.sin(AZIMUTH), up)
    points = (np.stack(axes, axis=-1) * measured[..., None]).reshape(-1, 3)[seen]
    return synthetic.scan_of(points, np.repeat(np.arange(RINGS), FIRINGS)[seen], RINGS)


def smoothed(range_m: FloatArray, noise_m: float) -> SmoothedRanges:
    return smooth_ranges(scan_of(range_m, noise_m), SETTINGS)


def errors(range_m: FloatArray, noise_m: float, truth_m: FloatArray) -> FloatArray:
    """How far (RINGS, FIRINGS) the smoothed returns are from where they should be."""
    points = smoothed(range_m, noise_m).points_sensor
    return np.linalg.norm(points, axis=1).reshape(RINGS, FIRINGS) - truth_m


@pytest.mark.parametrize("noise_m", [0.01, 0.015, 0.03])
def test_walls_come_out_thin_and_where_they_are(noise_m: float) -> None:
    error_m = errors(room(), noise_m, room())
    assert error_m.std() < 0.45 * noise_m
    assert abs(error_m.mean()) < 0.02 * noise_m
    found = smoothed(room(), noise_m)
    np.testing.assert_allclose(found.scatter_m, noise_m, rtol=0.05)
    assert found.smoothed_share > 0.98


@pytest.mark.parametrize("returns", [5, 6, 9, 12])
def test_facets_and_runs_of_any_number_of_returns_are_smoothed(returns: int) -> None:
    """At 20 m no more than five returns fit on a facet."""
    found = smooth_ranges(scan_of(room(7.0), 0.015), SmoothingSettings(returns=returns))
    assert found.smoothed_share > 0.95
    range_m = room(5.0)
    range_m[:, np.arange(FIRINGS) % (returns + 30) >= returns] = np.inf
    assert smoothed(range_m, 0.015).smoothed_share > 0.9


def test_returns_of_no_surface_are_kept() -> None:
    found = smoothed(np.random.default_rng(4).uniform(1.0, 5.0, (RINGS, FIRINGS)), 0.0)
    assert found.scatter_m <= 0.06
    assert np.abs(found.correction_m).max() <= CORRECTION_MAX_M
    assert found.smoothed_share < 0.05
    thinned = room()  # one return in a hundred: none has a neighbour
    thinned[:, np.random.default_rng(5).random(FIRINGS) > 0.01] = np.inf
    assert np.abs(smoothed(thinned, 0.02).correction_m).max() < 0.06


def test_returns_move_along_their_rays_by_the_correction() -> None:
    scan = scan_of(room(), 0.02)
    scan.points_sensor[100] = 0.0  # a return at the sensor itself
    found = smooth_ranges(scan, SETTINGS)
    np.testing.assert_array_equal(found.points_sensor[100], 0.0)
    own, moved = (np.delete(p, 100, axis=0) for p in (scan.points_sensor, found.points_sensor))
    own_m, moved_m = np.linalg.norm(own, axis=1), np.linalg.norm(moved, axis=1)
    np.testing.assert_allclose(moved / moved_m[:, None], own / own_m[:, None], atol=1e-6)
    np.testing.assert_allclose(np.delete(found.correction_m, 100), moved_m - own_m, atol=1e-5)
    assert np.abs(found.correction_m).max() <= 3.5 * found.scatter_m


@pytest.mark.parametrize("step_m", [0.08, 0.5])
def test_an_edge_is_kept(step_m: float) -> None:
    range_m = room()
    niche = np.abs(AZIMUTH) < np.radians(9)
    range_m[:, niche] += step_m
    error_m = errors(range_m, 0.015, range_m)
    beside = np.convolve(np.abs(np.diff(niche, prepend=False)), np.ones(9), "same") > 0
    assert np.sqrt(np.mean(error_m[:, beside] ** 2)) < 0.0135
    assert np.abs(error_m[:, beside]).max() < 0.06


def test_a_thin_thing_before_a_wall_is_not_drawn_onto_it() -> None:
    """Ten centimetres are no jump between neighbours, but more than any return is off by."""
    range_m = room()
    thin = np.arange(FIRINGS) % 60 == 30
    range_m[:, thin] -= 0.1
    error_m = np.abs(errors(range_m, 0.015, range_m)[:, thin])
    assert error_m.mean() < 0.03
    assert np.quantile(error_m, 0.9) < 0.05


def test_a_recess_of_two_centimetres_shows_through_three_of_noise() -> None:
    range_m = room()
    range_m[:, np.abs(AZIMUTH) < np.radians(12)] += 0.02
    error_m = errors(range_m, 0.03, room())
    from_middle_deg = np.degrees(np.abs(AZIMUTH))
    assert np.mean(error_m[:, from_middle_deg < 10] > 0.01) > 0.75
    assert np.mean(error_m[:, np.abs(from_middle_deg - 20) < 5] < 0.01) > 0.75


def test_the_order_of_the_returns_does_not_matter() -> None:
    scan = scan_of(room(), 0.02)
    rows = np.random.default_rng(1).permutation(len(scan))
    shuffled = smooth_ranges(subset(scan, rows), SETTINGS)
    expected = smooth_ranges(scan, SETTINGS).points_sensor[rows]
    np.testing.assert_array_equal(shuffled.points_sensor, expected)


@pytest.mark.parametrize("count", [0, 1, 4, 5, 20])
def test_few_returns_are_kept_or_smoothed(count: int) -> None:
    found = smooth_ranges(subset(scan_of(room(), 0.02), np.arange(count)), SETTINGS)
    assert found.points_sensor.shape == (count, 3)
    assert np.isfinite(found.points_sensor).all()
    assert (found.smoothed_share > 0.0) == (count >= 5)


def test_smoothing_can_be_switched_off() -> None:
    scan = scan_of(room(), 0.02)
    untouched = smooth_ranges(scan, SmoothingSettings(returns=0))
    np.testing.assert_array_equal(untouched.points_sensor, scan.points_sensor)
    assert untouched.smoothed_share == 0.0
    assert np.isnan(untouched.scatter_m)
