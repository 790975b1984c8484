"""Rings from elevations: as many as the sensor has, each point in its own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffmap.loaders.decoding import decode, settle_decoding
from ffmap.loaders.rings import RingSample, estimate_rings
from tests.loaders.bag_builder import cloud, only, sweep

VLP_32C = (
    "-25 -15.639 -11.31 -8.843 -7.254 -6.148 -5.333 -4.667 -4 -3.667 -3.333 -3 -2.667 -2.333 -2 "
    "-1.667 -1.333 -1 -0.667 -0.333 0 0.333 0.667 1 1.333 1.667 2.333 3.333 4.667 7 10.333 15"
)
SENSORS = {
    "VLP-16": np.arange(-15, 16, 2.0),
    "HDL-32E": -30.67 + 1.3333 * np.arange(32),
    "XT-32": np.arange(-16.0, 16.0),
    "OS1-64": np.linspace(-22.5, 22.5, 64),
    "VLP-32C": np.array(VLP_32C.split(), float),
}


def model_of(points):
    place = np.zeros(len(points), np.int64)
    return estimate_rings([RingSample(points, None, place, place, (1, len(points)))])


@pytest.mark.parametrize("sensor", SENSORS)
def test_rings_from_the_elevations(sensor):
    elevations = SENSORS[sensor]
    messages = [cloud(only(sweep(300, elevations, seed), "x", "y", "z")) for seed in range(3)]
    decoding = settle_decoding(messages, "/points")
    assert (decoding.rings.source, decoding.rings.count) == ("elevation", len(elevations))
    np.testing.assert_allclose(decoding.rings.elevation_deg, elevations, atol=0.05)
    for message in messages:
        rings = np.tile(np.arange(len(elevations)), 300)
        np.testing.assert_array_equal(decode(message, decoding).ring, rings)
    axis = np.array([[0, 0, 2], [0, 0, -2]], np.float32)
    assert decoding.rings.rings(axis, None).tolist() == [len(elevations) - 1, 0]


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    noise_deg=st.sampled_from([0.0, 0.05, 0.12]),
    keep=st.floats(0.3, 1.0),
)
def test_noisy_elevations_and_missing_points(seed, noise_deg, keep):
    rng = np.random.default_rng(seed)
    ring = np.tile(np.arange(32), 400)[rng.random(12_800) < keep]
    elevation = np.radians(SENSORS["XT-32"][ring] + noise_deg * rng.standard_normal(len(ring)))
    azimuth, distance = rng.uniform(-np.pi, np.pi, len(ring)), rng.uniform(2, 20, len(ring))
    level = distance * np.cos(elevation)
    columns = level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)
    points = np.stack(columns, axis=1).astype(np.float32)
    model = model_of(points)
    assert model.count == 32
    assert np.mean(model.rings(points, None) == ring) > 0.999


def test_without_rings_there_are_slices_of_elevation():
    points = np.random.default_rng(0).standard_normal((20_000, 3)).astype(np.float32) * 5
    model = model_of(points)
    assert model.source == "bins"
    np.testing.assert_allclose(np.diff(model.elevation_deg), 0.45, atol=0.01)
    assert set(model.rings(points, None)) == set(range(model.count))
    assert estimate_rings([]).rings(points[:0], None).shape == (0,)


def test_a_topmost_ring_without_returns_is_counted():
    points = sweep(100)
    decoding = settle_decoding([cloud(points[points["ring"] < 15])], "/points")
    assert decoding.rings.count == 16
    assert np.isnan(decoding.rings.elevation_deg[15])


def lines_of(elevation_deg, seed, count=4000):
    """A cloud with the elevations of four lines, or with any."""
    rng = np.random.default_rng(seed)
    line = rng.integers(0, 4, count)
    any_deg = rng.uniform(-7, 52, count)
    elevation = np.radians(any_deg if elevation_deg is None else elevation_deg[line])
    azimuth, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(2, 8, count)
    points = np.zeros(count, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("line", "u1")])
    points["x"] = distance * np.cos(elevation) * np.cos(azimuth)
    points["y"] = distance * np.cos(elevation) * np.sin(azimuth)
    points["z"], points["line"] = distance * np.sin(elevation), line
    return cloud(points)


def test_lines_without_an_elevation_are_no_rings():
    model = settle_decoding([lines_of(None, seed) for seed in range(3)], "/livox/lidar").rings
    assert (model.source, model.count) == ("bins", pytest.approx(130, abs=2))
    assert model.elevation_deg[[0, -1]] == pytest.approx([-6.7, 51.7], abs=0.3)


@pytest.mark.parametrize("count", [4000, 60])
def test_lines_that_keep_their_elevation_are_rings(count):
    messages = [lines_of(np.array([-5.0, 0.0, 5.0, 10.0]), 0, count)]
    model = settle_decoding(messages, "/points").rings
    assert (model.source, model.count) == ("field", 4)
