"""The ceilings of a scan."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.scan.ceiling import find_ceilings
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, RearrangementSettings
from tests.algorithms.scan.test_floor import FOOT, ground

SETTINGS = RearrangementSettings()
LEVEL = Floor(0.0, np.zeros(2), 0)


def found_above(
    points: FloatArray, floor: Floor = LEVEL, seed: int = 0
) -> tuple[HorizontalPlane, ...]:
    points = points.astype(np.float32)
    return find_ceilings(points, floor.heights_above(points), floor, SETTINGS, seed)


@pytest.mark.parametrize("slope", [0.08, 0.0])
def test_a_ceiling_over_a_ramp_may_slope_with_it_or_be_level(slope: float) -> None:
    generator = np.random.default_rng(2)
    xy = generator.uniform(-3, 3, (6_000, 2))
    points = np.column_stack([xy, 2.8 + slope * xy[:, 0] + generator.normal(0, 0.01, len(xy))])
    (ceiling,) = found_above(points, Floor(0.0, np.array([0.08, 0.0]), 0))
    assert ceiling.height_m == pytest.approx(2.8, abs=0.01)
    np.testing.assert_allclose(ceiling.slope, [slope, 0.0], atol=0.005)


def test_a_duct_below_the_ceiling_is_no_ceiling_and_a_lower_room_has_one() -> None:
    generator = np.random.default_rng(3)

    def returns(
        count: int, low: tuple[float, float], high: tuple[float, float], height_m: float
    ) -> FloatArray:
        z = generator.normal(height_m, 0.005, count)
        return np.column_stack([generator.uniform(low, high, (count, 2)), z])

    ceiling = returns(12_000, (-3, -3), (3, 3), 2.8)
    duct = returns(4_000, (-3, 1.0), (3, 1.4), 2.45)
    lower = returns(4_000, (3, -3), (5, 1), 2.45)
    with_duct = found_above(np.concatenate([ceiling, duct]))
    assert [round(c.height_m, 1) for c in with_duct] == [2.8]
    with_room = found_above(np.concatenate([ceiling, lower]))
    assert sorted(round(c.height_m, 2) for c in with_room) == [2.45, 2.8]


def test_ceilings_follow_both_pieces_of_the_floor() -> None:
    points = ground(FOOT, 20_000)
    generator = np.random.default_rng(1)
    places = generator.uniform(-3.0, 3.0, (40_000, 2))
    truth_m = 2.6 + (FOOT[:, 0] + places @ FOOT[:, 1:].T).max(axis=1)
    ceiling = np.column_stack([places, truth_m + generator.normal(0, 0.01, len(places))])
    planes = found_above(np.concatenate([points, ceiling]), find_floor(points, SETTINGS))
    off_m = np.min([np.abs(plane.height_at(ceiling) - truth_m) for plane in planes], axis=0)
    assert np.mean(off_m < 0.02) > 0.97
