"""The floors of rooms are drawn whatever the rooms' outlines are like."""

import numpy as np
import pytest
import shapely

from ffmap.app.record import rooms


def area_m2(room: shapely.Polygon) -> float:
    return float(sum(part.area for part in rooms._triangles(room)))


OUTLINE = [(13, 13), (75, 128), (108, 1), (78, 1), (31, 7)]
HOLES = [
    [(101, 4), (100, 8), (95, 11)],
    [(91, 9), (92, 11), (90, 11)],
    [(82, 9), (80, 8), (79, 4)],
    [(79, 10), (79, 8), (80, 8)],
    [(79, 10), (77, 11), (77, 9)],
    [(79, 8), (78, 7), (79, 7)],
    [(61, 18), (60, 19), (60, 18)],
    [(58, 18), (59, 19), (58, 19)],
    [(22, 17), (22, 16), (19, 16)],
    [(22, 17), (22, 18), (18, 18)],
]
"""Cells of 5 cm; holes that touch one another, with which GEOS finds no convex corner."""


def test_holes_that_touch_one_another_leave_a_floor() -> None:
    room = shapely.Polygon(0.05 * np.array(OUTLINE), [0.05 * np.array(hole) for hole in HOLES])
    with pytest.raises(shapely.GEOSException):
        shapely.constrained_delaunay_triangles(shapely.Polygon(OUTLINE, HOLES))
    assert area_m2(room) == pytest.approx(room.area, abs=0.0011 * room.length)


def test_outlines_that_cross_themselves_and_slivers_are_survived() -> None:
    bow_tie = shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])
    assert 0 < area_m2(bow_tie) <= 2.0
    assert area_m2(shapely.Polygon([(0, 0), (4, 0), (4, 1e-9)])) < 1e-6
    assert area_m2(shapely.Polygon([(0, 0), (4, 0), (2, 0)])) == 0
