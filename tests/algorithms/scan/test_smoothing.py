"""Ranges smoothed along the rings: planes come out thin, edges and thin things stay, directions are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.scan.smoothing import (
    _CORRECTION_MAX_SCATTERS,
    SmoothingSettings,
    smooth_ranges,
)
from tests import synthetic

SETTINGS = SmoothingSettings()
FIRINGS, RINGS = 1800, 8
AZIMUTH = (np.arange(FIRINGS) + 0.5) * 2 * np.pi / FIRINGS - np.pi
HALF_M = np.array([3.0, 2.0])
"""Half the edges of the room about the sensor."""


def in_room() -> FloatArray:
    """(RINGS, FIRINGS) exact ranges from the middle of a room of four walls."""
    across = np.min(HALF_M[:, None] / np.abs([np.cos(AZIMUTH), np.sin(AZIMUTH)]), axis=0)
    return across / np.cos(elevation())[:, None]


def elevation() -> FloatArray:
    return np.radians(np.linspace(-12, 12, RINGS))


def scan_of(range_m: FloatArray, noise_m: float, seed: int = 0) -> Scan:
    """A sweep with these ranges (RINGS, FIRINGS), infinite ones left out."""
    seen = np.isfinite(range_m).ravel()
    measured = range_m + np.random.default_rng(seed).normal(0.0, noise_m, range_m.shape)
    flat, up = np.cos(elevation())[:, None], np.sin(elevation())[:, None]
    rays = np.stack(np.broadcast_arrays(flat * np.cos(AZIMUTH), flat * np.sin(AZIMUTH), up), axis=-1)
    points = (rays * measured[..., None]).reshape(-1, 3)[seen]
    return synthetic.scan_of(points, np.repeat(np.arange(RINGS), FIRINGS)[seen], RINGS)


def errors(scan: Scan, range_m: FloatArray) -> FloatArray:
    """How far (RINGS, FIRINGS) the smoothed returns are from where they should be."""
    smoothed = smooth_ranges(scan, SETTINGS)
    return np.linalg.norm(smoothed.points_sensor, axis=1).reshape(RINGS, FIRINGS) - range_m


@pytest.mark.parametrize("noise_m", [0.01, 0.015, 0.03])
def test_walls_come_out_thin_and_where_they_are(noise_m: float) -> None:
    scan = scan_of(in_room(), noise_m)
    error_m = errors(scan, in_room())
    assert error_m.std() < 0.45 * noise_m
    assert abs(error_m.mean()) < 0.02 * noise_m
    smoothed = smooth_ranges(scan, SETTINGS)
    np.testing.assert_allclose(smoothed.scatter_m, noise_m, rtol=0.05)
    assert smoothed.smoothed_share > 0.98


def test_what_is_exact_stays_so() -> None:
    assert np.abs(errors(scan_of(in_room(), 0.0), in_room())).max() < 0.004
    assert smooth_ranges(scan_of(in_room(), 0.0), SETTINGS).smoothed_share > 0.5


@pytest.mark.parametrize("returns", [5, 6, 10, 11, 12])
def test_facets_of_any_number_of_returns_are_found_far_away(returns: int) -> None:
    """At 20 m no more than five returns fit on a facet."""
    smoothed = smooth_ranges(scan_of(7.0 * in_room(), 0.015), SmoothingSettings(returns=returns))
    assert smoothed.smoothed_share > 0.95


@pytest.mark.parametrize("count", range(5, 13))
def test_runs_of_any_length_are_smoothed(count: int) -> None:
    range_m = 5.0 * in_room()
    range_m[:, np.arange(FIRINGS) % (count + 30) >= count] = np.inf
    assert smooth_ranges(scan_of(range_m, 0.015), SETTINGS).smoothed_share > 0.9


def test_what_a_ray_returned_twice_does_not_hide_the_scatter() -> None:
    scan = scan_of(in_room(), 0.02)
    twice = replace(scan, points_sensor=np.repeat(scan.points_sensor, 2, axis=0), ring=np.repeat(scan.ring, 2))
    smoothed = smooth_ranges(twice, SETTINGS)
    assert np.isfinite(smoothed.points_sensor).all()
    assert smoothed.scatter_m == pytest.approx(0.02, rel=0.1)


def test_what_is_no_surface_at_all_is_left_alone() -> None:
    range_m = np.random.default_rng(4).uniform(1.0, 5.0, (RINGS, FIRINGS))
    smoothed = smooth_ranges(scan_of(range_m, 0.0), SETTINGS)
    assert smoothed.scatter_m <= 0.06
    assert np.abs(smoothed.correction_m).max() <= 0.06 * _CORRECTION_MAX_SCATTERS
    assert smoothed.smoothed_share < 0.05


def test_few_returns_of_a_thinned_scan_tell_no_scatter() -> None:
    """One in a hundred: none has a neighbour."""
    range_m = in_room()
    range_m[:, np.random.default_rng(5).random(FIRINGS) > 0.01] = np.inf
    smoothed = smooth_ranges(scan_of(range_m, 0.02), SETTINGS)
    assert np.abs(smoothed.correction_m).max() < 0.06


def test_returns_stay_on_their_rays_and_the_correction_tells_how_far_they_moved() -> None:
    scan = scan_of(in_room(), 0.02)
    smoothed = smooth_ranges(scan, SETTINGS)
    own, moved = scan.points_sensor.astype(np.float64), smoothed.points_sensor.astype(np.float64)
    own_m, moved_m = np.linalg.norm(own, axis=1), np.linalg.norm(moved, axis=1)
    np.testing.assert_allclose(moved / moved_m[:, None], own / own_m[:, None], atol=1e-6)
    np.testing.assert_allclose(smoothed.correction_m, moved_m - own_m, atol=1e-5)
    assert np.abs(smoothed.correction_m).max() <= _CORRECTION_MAX_SCATTERS * smoothed.scatter_m


@pytest.mark.parametrize("step_m", [0.08, 0.15, 0.5])
def test_an_edge_stays_an_edge(step_m: float) -> None:
    range_m = in_room()
    # A niche in the wall ahead, seen from 9 degrees to the left to 9 to the right.
    niche = np.abs(AZIMUTH) < np.radians(9)
    range_m[:, niche] += step_m
    error_m = errors(scan_of(range_m, 0.015), range_m)
    beside = np.convolve(np.abs(np.diff(niche, prepend=False)), np.ones(9), "same") > 0
    assert np.sqrt(np.mean(error_m[:, beside] ** 2)) < 0.0135
    assert np.abs(error_m[:, beside]).max() < 0.06


def test_a_thin_thing_before_a_wall_is_not_drawn_onto_it() -> None:
    """Ten centimetres are no jump between neighbours, but more than any return is off by."""
    range_m = in_room()
    thin = np.arange(FIRINGS) % 60 == 30
    range_m[:, thin] -= 0.1
    scan = scan_of(range_m, 0.015)
    error_m = errors(scan, range_m)
    assert np.abs(error_m[:, thin]).mean() < 0.03
    assert np.quantile(np.abs(error_m[:, thin]), 0.9) < 0.05


def test_a_recess_of_two_centimetres_shows_through_three_of_noise() -> None:
    range_m = in_room()
    recess = np.abs(AZIMUTH) < np.radians(12)
    range_m[:, recess] += 0.02
    scan = scan_of(range_m, 0.03)
    error_m = errors(scan, in_room())
    inner, outer = np.abs(AZIMUTH) < np.radians(10), (np.abs(np.abs(AZIMUTH) - np.radians(20)) < np.radians(5))
    assert np.mean(error_m[:, inner] > 0.01) > 0.75
    assert np.mean(error_m[:, outer] < 0.01) > 0.75


def test_the_order_of_the_returns_does_not_matter() -> None:
    scan = scan_of(in_room(), 0.02)
    shuffled = np.random.default_rng(1).permutation(len(scan))
    other = replace(scan, points_sensor=scan.points_sensor[shuffled], ring=scan.ring[shuffled])
    assert smooth_ranges(other, SETTINGS).smoothed_share > 0.98
    np.testing.assert_array_equal(
        smooth_ranges(other, SETTINGS).points_sensor, smooth_ranges(scan, SETTINGS).points_sensor[shuffled]
    )


def test_a_turn_of_the_sensor_does_not_matter() -> None:
    scan = scan_of(in_room(), 0.02)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
    turned = smooth_ranges(replace(scan, points_sensor=scan.points_sensor @ turn.T), SETTINGS)
    expected = smooth_ranges(scan, SETTINGS).points_sensor @ turn.T
    # But where the ring is cut open, behind the sensor.
    same = np.isclose(turned.points_sensor, expected, atol=1e-4).all(axis=1)
    assert np.count_nonzero(~same) <= 4 * SETTINGS.returns * RINGS
    assert np.abs(turned.points_sensor - expected).max() < 0.1


@pytest.mark.parametrize("count", [0, 1, 4, 5, 20])
def test_few_returns_are_left_as_they_are_or_smoothed_without_complaint(count: int) -> None:
    scan = scan_of(in_room(), 0.02)
    few = replace(scan, points_sensor=scan.points_sensor[:count], ring=scan.ring[:count])
    smoothed = smooth_ranges(few, SETTINGS)
    assert smoothed.points_sensor.shape == (count, 3)
    assert np.isfinite(smoothed.points_sensor).all()
    assert (smoothed.smoothed_share > 0.0) == (count >= 5)


def test_a_return_at_the_sensor_itself_is_no_trouble() -> None:
    scan = scan_of(in_room(), 0.02)
    points = scan.points_sensor.copy()
    points[100] = 0.0
    smoothed = smooth_ranges(replace(scan, points_sensor=points), SETTINGS)
    assert np.isfinite(smoothed.points_sensor).all()
    np.testing.assert_array_equal(smoothed.points_sensor[100], 0.0)


def test_smoothing_can_be_left_out() -> None:
    scan = scan_of(in_room(), 0.02)
    untouched = smooth_ranges(scan, SmoothingSettings(returns=0))
    np.testing.assert_array_equal(untouched.points_sensor, scan.points_sensor)
    assert untouched.smoothed_share == 0.0
    assert np.isnan(untouched.scatter_m)
