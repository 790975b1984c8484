"""Faces of one wall become one."""

import numpy as np
import pytest

from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import Walls
from ffmap.algorithms.building.verdicts import join_in_line
from tests.faces import Ends, faces

APART_M, GAP_M = 0.03, 0.6
LONG: Ends = ((0.0, 0.0), (4.0, 0.0))


def joined(*ends: Ends, turn_deg: float = 0.0) -> Walls:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = np.array(ends) @ np.array([[c, s], [-s, c]])
    return join_in_line(faces(*turned.tolist()), APART_M, GAP_M)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0, 170.0])
@pytest.mark.parametrize(
    ("other", "length_m"),
    [
        (((1.0, 0.02), (3.0, 0.0)), 4.0),
        (((3.0, 0.0), (6.0, 0.02)), 6.0),
        (((-2.0, 0.0), (-0.5, 0.0)), 6.0),
    ],
    ids=["within", "overlapping", "beyond a short gap"],
)
def test_faces_in_line_are_one(other: Ends, length_m: float, turn_deg: float) -> None:
    for ends in ((LONG, other), (other, LONG)):
        found = joined(*ends, turn_deg=turn_deg)
        assert lengths_m(found.ends) == pytest.approx(length_m, abs=0.01)
        assert found.sample_count.tolist() == [1800]


@pytest.mark.parametrize(
    "other",
    [
        ((1.0, 0.05), (3.0, 0.05)),
        ((3.0, 0.0), (1.0, 0.0)),
        ((5.0, 0.0), (7.0, 0.0)),
        ((1.0, -1.0), (1.0, 1.0)),
    ],
    ids=["before it", "its other side", "beyond a doorway", "across"],
)
def test_other_faces_stay(other: Ends) -> None:
    assert len(joined(LONG, other)) == 2


def test_several_faces_of_a_wall_are_one_and_no_face_is_none() -> None:
    pieces = [((x, 0.0), (x + 1.2, 0.0)) for x in (0.0, 1.0, 2.0, 3.0)]
    assert lengths_m(joined(*pieces).ends) == pytest.approx(4.2)
    assert len(join_in_line(faces(LONG).select(slice(0, 0)), APART_M, GAP_M)) == 0
