"""Faces end at the corners that they make, and have the directions of the building's walls."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.verdicts import (
    StandingWallsSettings,
    join_corners,
    wall_directions,
)
from tests.faces import Ends, faces

SETTINGS = StandingWallsSettings()
LONG: Ends = ((0.0, 0.0), (4.0, 0.0))


def turned(ends: FloatArray, turn_deg: float) -> FloatArray:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.asarray(ends @ np.array([[c, s], [-s, c]]) + np.array([3.0, -7.0]))


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 170.0])
@pytest.mark.parametrize(
    ("other", "end_m"),
    [
        (((4.4, -1.0), (4.4, 3.0)), 4.4),
        (((4.4, 0.3), (4.4, 3.0)), 4.4),
        (((4.9, -1.0), (4.9, 3.0)), 4.0),
        (((4.4, 1.0), (4.4, 3.0)), 4.0),
        (((4.5, 0.1), (8.0, 0.1)), 4.0),
        (((3.95, -1.0), (3.95, 3.0)), 4.0),
    ],
    ids=["across", "ends close by", "too far", "ends too far", "parallel", "reached"],
)
def test_a_face_is_extended_to_the_corner_that_it_makes(
    other: Ends, end_m: float, turn_deg: float
) -> None:
    walls = faces(*turned(np.array([LONG, other]), turn_deg).tolist())
    found = join_corners(walls, walls, SETTINGS)
    np.testing.assert_allclose(
        found.ends[0], turned(np.array([[0.0, 0.0], [end_m, 0.0]]), turn_deg), atol=1e-9
    )
    back = join_corners(walls.select(np.array([1, 0])), walls, SETTINGS)
    np.testing.assert_allclose(back.ends[1], found.ends[0], atol=1e-9)


def test_the_nearest_of_several_corners_counts() -> None:
    walls = faces(LONG, ((4.6, -1.0), (4.6, 3.0)), ((4.2, -1.0), (4.2, 3.0)))
    assert join_corners(walls, walls, SETTINGS).ends[0, 1, 0] == pytest.approx(4.2)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 120.0])
def test_directions_are_those_of_most_of_the_walls_length(turn_deg: float) -> None:
    ends = np.array([LONG, ((0.0, 0.0), (0.0, 3.0)), ((1.0, 1.0), (1.2, 1.2))])
    normals = wall_directions(faces(*turned(ends, turn_deg).tolist()), 0.1)
    assert len(normals) == 2
    along = turned(ends, turn_deg)[0, 1] - turned(ends, turn_deg)[0, 0]
    assert np.sort(np.abs(normals @ along)) == pytest.approx([0.0, 4.0], abs=1e-9)
