"""Areas in the plan are valid, whatever was joined, grown and shrunk."""

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

from ffmap.algorithms.maps.areas import closed, grown

THREE_WALLS = (
    [
        [3.196664405300135, 5.528365234376171],
        [2.9566741517920283, 0.656216063768612],
        [3.077064240345754, 0.6502859399443718],
        [3.3170544938538606, 5.522435110551931],
    ],
    [
        [3.0442580457256705, 1.141805379091977],
        [2.90272726819663, 0.93572520291769],
        [3.002087631381796, 0.8674869583750835],
        [3.1436184089108368, 1.0735671345493707],
    ],
    [
        [2.8461149571850135, 0.8532931324479751],
        [2.732800032428922, 0.6882975034787222],
        [2.832160395614088, 0.6200592589361158],
        [2.94547532037018, 0.7850548879053687],
    ],
)
"""A long wall and two fragments: grown and shrunk, GEOS makes a hole outside its shell of them."""


def quad(ends: list[list[float]], depth_m: float) -> shapely.Polygon:
    start, end = np.array(ends)
    normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
    return shapely.Polygon([start, end, end - depth_m * normal, start - depth_m * normal])


def test_what_geos_makes_invalid_is_made_valid() -> None:
    walls = shapely.union_all([shapely.Polygon(corners) for corners in THREE_WALLS])
    shrunk = grown(grown(walls, 0.02), -0.02)
    assert shrunk.is_valid
    assert shrunk.area == pytest.approx(walls.area, rel=0.002)
    assert shrunk.difference(shapely.box(2, 0, 3, 1)).area < shrunk.area


@given(st.lists(st.tuples(*[st.floats(0.0, 2.0)] * 4), min_size=1, max_size=8))
# Between the second wall and the third is an acute notch, at whose end lies a part of the first.
@example([(0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.09375, 2.0, 1.0)])
def test_closed_areas_are_valid_and_hold_what_they_are_made_of(
    walls: list[tuple[float, float, float, float]],
) -> None:
    quads = [quad([[a, b], [c, d]], 0.1) for a, b, c, d in walls if np.hypot(a - c, b - d) > 0.1]
    area = shapely.union_all(quads)
    whole = closed(area, 0.02)
    assert whole.is_valid
    assert area.difference(whole.buffer(1e-3)).area < 1e-6
    assert whole.difference(area.buffer(0.15)).area < 1e-6
