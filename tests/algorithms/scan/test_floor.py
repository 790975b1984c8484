"""The floor of a scan: a plane, or two that meet at a ramp's foot or top."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.scan.floor import find_floor
from ffmap.algorithms.scan.rearrangement import RearrangementSettings

SETTINGS = RearrangementSettings()


def ground(rise: FloatArray, count: int = 30_000, seed: int = 0) -> FloatArray:
    """Returns (n, 3) of a floor and of boxes on it, denser near the sensor, with 1 cm of scatter.

    rise: (k, 3) height at the origin, slope along x, slope along y; the floor is the highest.
    """
    generator = np.random.default_rng(seed)
    reach = 0.5 + 4.0 * generator.random(count) ** 2
    heading = generator.uniform(0, 2 * np.pi, count)
    places = np.column_stack([reach * np.cos(heading), reach * np.sin(heading)])
    height = (rise[:, :1] + rise[:, 1:] @ places.T).max(axis=0)
    boxes = np.hypot(*(places - [2.0, 1.5]).T) < 0.4
    boxes |= np.hypot(*(places - [-1.5, 2.0]).T) < 0.3
    height[boxes] += generator.uniform(0.05, 0.24, int(boxes.sum()))
    return np.column_stack([places, height + generator.normal(0, 0.01, count)]).astype(np.float32)


LEVEL = np.array([[0.0, 0.0, 0.0]])
FOOT = np.array([[0.0, 0.0, 0.0], [-0.08, 0.08, 0.0]])  # a ramp of 8 % that begins 1 m ahead


@pytest.mark.parametrize("rise", [LEVEL, np.array([[0.02, 0.02, -0.01]])])
def test_a_floor_that_is_a_plane_has_no_pieces(rise: FloatArray) -> None:
    floor = find_floor(ground(rise), SETTINGS)
    assert len(floor.pieces) == 0
    np.testing.assert_allclose([floor.height_m, *floor.slope], rise[0], atol=0.003)


@pytest.mark.parametrize("bound", [0.0, 0.03])
def test_a_floor_slopes_up_to_its_bound(bound: float) -> None:
    slope = 0.06 * np.array([np.cos(0.5), np.sin(0.5)])
    bounded = SETTINGS.model_copy(update={"floor_slope_max": bound})
    floor = find_floor(ground(np.array([[0.0, *slope]])), bounded)
    np.testing.assert_allclose(floor.slope, slope * bound / 0.06, atol=0.002)


@pytest.mark.parametrize("top", [False, True])
@pytest.mark.parametrize("turn_deg", [0.0, 200.0])
def test_a_floor_bends_at_a_ramp(top: bool, turn_deg: float) -> None:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = FOOT.copy()
    turned[:, 1:] = FOOT[:, 1:] @ np.array([[c, s], [-s, c]])
    points = ground(turned)
    if top:
        height_m = (turned[:, :1] + turned[:, 1:] @ points[:, :2].T).max(axis=0)
        clear = points[np.abs(points[:, 2] - height_m) < 0.04]
        points, turned = clear * np.array([1, 1, -1], np.float32), -turned
    floor = find_floor(points, SETTINGS)
    assert floor.is_foot == (not top)
    order = np.argsort(np.abs(floor.pieces[:, 1:]).sum(axis=1))
    np.testing.assert_allclose(floor.pieces[order], turned, atol=0.012)
    truth = turned[:, 0] + points[:, :2] @ turned[:, 1:].T
    above_m = points[:, 2] - (truth.min(axis=1) if top else truth.max(axis=1))
    found_m = floor.heights_above(points)
    np.testing.assert_allclose(found_m, above_m, atol=0.01)
    np.testing.assert_allclose(points[:, 2] - floor.height_at(points), found_m, atol=1e-5)


@pytest.mark.parametrize("lifted_m", [0.2, 0.65, 1.4])
def test_the_floor_of_a_sensor_that_is_lifted_is_the_maps(lifted_m: float) -> None:
    """A shelf at the height where the floor would be if the sensor drove holds fewer returns."""
    generator = np.random.default_rng(1)
    shelf = generator.uniform([-3.0, 1.0, -0.02], [3.0, 2.0, 0.02], (1500, 3)).astype(np.float32)
    points = np.concatenate([ground(LEVEL) - np.array([0, 0, lifted_m], np.float32), shelf])
    floor = find_floor(points, SETTINGS, map_floor_m=-lifted_m - 0.03)
    assert floor.height_m == pytest.approx(-lifted_m, abs=0.003)


def test_the_floor_of_a_robot_on_a_ramp_is_below_it() -> None:
    """The map's floor is under the ramp, where nothing is seen."""
    floor = find_floor(ground(LEVEL), SETTINGS, map_floor_m=-0.8)
    assert floor.height_m == pytest.approx(0.0, abs=0.003)


@pytest.mark.parametrize("outside_m", [-0.15, 0.2])
def test_ground_outside_a_window_is_no_floor(outside_m: float) -> None:
    """It covers more of the ground, and holds fewer returns than the floor of the robot."""
    generator = np.random.default_rng(2)
    inside = generator.uniform([-1.0, -1.0, -0.01], [1.0, 1.0, 0.01], (20_000, 3))
    low, high = [2.0, -6.0, outside_m - 0.01], [6.0, 6.0, outside_m + 0.01]
    outside = generator.uniform(low, high, (6_000, 3))
    floor = find_floor(np.concatenate([inside, outside]).astype(np.float32), SETTINGS)
    assert floor.height_m == pytest.approx(0.0, abs=0.003)
    assert floor.rejected_m == pytest.approx(outside_m, abs=0.003)
    # Carried up a step, the robot's floor is neither where it was nor the map's.
    lifted = find_floor((inside + np.array([0, 0, outside_m])).astype(np.float32), SETTINGS)
    assert lifted.height_m == pytest.approx(outside_m, abs=0.003)
    assert lifted.rejected_m == 0.0
