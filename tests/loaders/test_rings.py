"""Rings from elevations: as many as the sensor has, each point in its own, the same in every scan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffmap.loaders.decoding import decode, settle_decoding
from ffmap.loaders.rings import RingSample, estimate_rings
from tests.loaders.bag_builder import cloud, only, sweep

SENSORS = {
    "VLP-16": np.arange(-15, 16, 2.0),
    "HDL-32E": -30.67 + 1.3333 * np.arange(32),
    "XT-32": np.arange(-16.0, 16.0),
    "OS1-64": np.linspace(-22.5, 22.5, 64),
    "VLP-32C": np.array(
        [
            -25,
            -15.639,
            -11.31,
            -8.843,
            -7.254,
            -6.148,
            -5.333,
            -4.667,
            -4,
            -3.667,
            -3.333,
            -3,
            -2.667,
            -2.333,
            -2,
            -1.667,
            -1.333,
            -1,
            -0.667,
            -0.333,
            0,
            0.333,
            0.667,
            1,
            1.333,
            1.667,
            2.333,
            3.333,
            4.667,
            7,
            10.333,
            15,
        ]
    ),
}


@pytest.mark.parametrize("sensor", SENSORS)
def test_rings_from_the_elevations(sensor):
    elevations = SENSORS[sensor]
    messages = [cloud(only(sweep(300, elevations, seed), "x", "y", "z")) for seed in range(3)]
    decoding = settle_decoding(messages, "/points")
    assert (decoding.rings.source, decoding.rings.count) == ("elevation", len(elevations))
    np.testing.assert_allclose(decoding.rings.elevation_deg, elevations, atol=0.05)
    for message in messages:
        np.testing.assert_array_equal(decode(message, decoding).ring, np.tile(np.arange(len(elevations)), 300))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), noise_deg=st.sampled_from([0.0, 0.05, 0.12]), keep=st.floats(0.3, 1.0))
def test_smeared_elevations_and_missing_points(seed, noise_deg, keep):
    rng = np.random.default_rng(seed)
    ring = np.tile(np.arange(32), 400)[rng.random(12_800) < keep]
    elevation = np.radians(SENSORS["XT-32"][ring] + noise_deg * rng.standard_normal(len(ring)))
    azimuth, distance = rng.uniform(-np.pi, np.pi, len(ring)), rng.uniform(2, 20, len(ring))
    level = distance * np.cos(elevation)
    points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1).astype(
        np.float32
    )
    place = np.zeros(len(points), np.int64)
    model = estimate_rings([RingSample(points, None, place, place, (1, len(points)))])
    assert model.count == 32
    assert np.mean(model.rings(points, None) == ring) > 0.999


def test_no_rings_to_be_found_gives_slices_of_elevation():
    rng = np.random.default_rng(0)
    points = rng.standard_normal((20_000, 3)).astype(np.float32) * 5
    place = np.zeros(len(points), np.int64)
    model = estimate_rings([RingSample(points, None, place, place, (1, len(points)))])
    assert model.source == "bins"
    np.testing.assert_allclose(np.diff(model.elevation_deg), 0.45, atol=0.01)
    assert set(model.rings(points, None)) == set(range(model.count))


def test_no_points_at_all():
    assert estimate_rings([]).rings(np.zeros((0, 3), np.float32), None).shape == (0,)


def test_a_topmost_ring_that_sees_nothing_is_counted():
    points = sweep(100)
    points = points[points["ring"] < 15]
    decoding = settle_decoding([cloud(points)], "/points")
    assert decoding.rings.count == 16
    assert np.isnan(decoding.rings.elevation_deg[15])


def test_a_point_on_the_spin_axis_has_a_ring():
    model = settle_decoding([cloud(only(sweep(100), "x", "y", "z"))], "/points").rings
    axis = np.array([[0, 0, 2], [0, 0, -2]], np.float32)
    np.testing.assert_array_equal(model.rings(axis, None), [15, 0])


def spread_over(elevation_deg, seed, count=4000):
    """Points of one cloud with the elevations of `elevation_deg` (lines,), or all of a range where none is given."""
    rng = np.random.default_rng(seed)
    line = rng.integers(0, 4, count)
    elevation = np.radians(rng.uniform(-7, 52, count) if elevation_deg is None else elevation_deg[line])
    azimuth, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(2, 8, count)
    points = np.zeros(count, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("line", "u1")])
    points["x"], points["y"] = (distance * np.cos(elevation) * turn(azimuth) for turn in (np.cos, np.sin))
    points["z"], points["line"] = distance * np.sin(elevation), line
    return cloud(points)


def test_lines_that_look_everywhere_are_no_rings():
    model = settle_decoding([spread_over(None, seed) for seed in range(3)], "/livox/lidar").rings
    assert (model.source, model.count) == ("bins", pytest.approx(130, abs=2))
    assert model.elevation_deg[[0, -1]] == pytest.approx([-6.7, 51.7], abs=0.3)


@pytest.mark.parametrize("count", [4000, 60])
def test_lines_that_keep_their_elevation_are_rings_however_few_returns_there_are(count):
    messages = [spread_over(np.array([-5.0, 0.0, 5.0, 10.0]), seed, count) for seed in range(1)]
    model = settle_decoding(messages, "/points").rings
    assert (model.source, model.count) == ("field", 4)
