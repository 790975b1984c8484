"""A scan is turned to the map's floor, but not by a floor that bends."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.levelling import place_and_level
from ffmap.algorithms.scan.floor import find_floor
from ffmap.algorithms.scan.smoothing import SmoothingSettings, smooth_ranges
from ffmap.app.setup.settings import load_settings
from tests import synthetic

SETTINGS = load_settings(None, [])


def scan_of(rise_m: FloatArray, places: FloatArray) -> Scan:
    """One firing at once of a sensor in the base's origin, which stands on the floor."""
    return synthetic.scan_of(np.column_stack([places, rise_m]), np.zeros(len(places), int), 1)


@pytest.mark.parametrize(
    ("ramp", "tilt_deg", "turned"), [(0.0, 0.4, True), (0.08, 0.0, False), (0.0, 1.5, False)]
)
def test_a_scan_is_levelled_by_a_floor_that_is_a_plane(
    ramp: float, tilt_deg: float, turned: bool
) -> None:
    generator = np.random.default_rng(0)
    places = generator.uniform(-3, 3, (30_000, 2))
    # The ramp begins right ahead: one plane through its foot would look like a tilt.
    rise_m = (
        ramp * np.maximum(places[:, 0] - 1.0, 0.0) + np.tan(np.radians(tilt_deg)) * places[:, 0]
    )
    scan = scan_of(rise_m + generator.normal(0, 0.01, len(places)), places)
    trajectory = Trajectory(np.array([-1, 1]) * 10**9, np.tile(np.eye(4), (2, 1, 1)))
    # These returns follow no ring.
    ranges = smooth_ranges(scan, SmoothingSettings(returns=0))
    rearrangement = SETTINGS.rearrangement
    level = place_and_level(scan, ranges, trajectory, np.eye(4), 0.0, np.zeros(2), rearrangement)
    placed, floor = level.placed, level.floor
    np.testing.assert_allclose(floor.heights_above(placed.points_level).std(), 0.01, atol=0.002)
    assert (np.abs(placed.points_level - scan.points_sensor).max() > 0.01) == turned
    assert (len(floor.pieces) == 2) == (ramp > 0)
    if turned:
        assert np.hypot(*find_floor(placed.points_level, rearrangement).slope) < 0.001


def test_a_scan_of_a_lidar_that_is_lifted_keeps_the_maps_floor() -> None:
    """A hand-held device: 1 m above a sloping floor at first, and 1.7 m above it 5 m farther."""
    generator = np.random.default_rng(0)
    slope, at_m, height_m = np.array([0.01, 0.0]), np.array([5.0, 0.0]), 1.7
    places = generator.uniform(-3, 3, (30_000, 2))
    scan = scan_of(places @ slope - height_m + generator.normal(0, 0.01, len(places)), places)
    T_map_base = np.eye(4)
    T_map_base[:3, 3] = [*at_m, height_m + at_m @ slope]
    trajectory = Trajectory(np.array([-1, 1]) * 10**9, np.tile(T_map_base, (2, 1, 1)))
    ranges = smooth_ranges(scan, SmoothingSettings(returns=0))
    level = place_and_level(scan, ranges, trajectory, np.eye(4), 1.0, slope, SETTINGS.rearrangement)
    assert level.floor.support > 5000
    heights_m = level.floor.heights_above(level.placed.points_level)
    assert abs(heights_m.mean()) < 0.002
    in_map = level.placed.to_map(level.placed.points_level)
    np.testing.assert_allclose((in_map[:, 2] - in_map[:, :2] @ slope).mean(), 0.0, atol=0.003)
