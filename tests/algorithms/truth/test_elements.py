"""Labels by the part of a building that they lie on, and doors by their design, against counts by hand."""

import numpy as np
import pytest
import shapely

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.truth.doors import DoorFigures
from ffmap.algorithms.truth.elements import REST, Element, doors_by_design, tally_elements
from ffmap.algorithms.truth.tally import CUBE_M, Counter
from tests.algorithms.truth.test_tally import NO_DOORS, ORIGIN


def element(name: str, truth: Truth, first: int, last: int, z_m: tuple[float, float] = (0.0, 3.0)) -> Element:
    """Around the cubes from `first` to `last` along x."""
    return Element(name, truth, shapely.box(first * CUBE_M, 0.0, (last + 1) * CUBE_M, CUBE_M), z_m)


def test_cubes_count_for_the_element_that_holds_them() -> None:
    truth = [Truth.WALL, Truth.WALL, Truth.WALL, Truth.FLOOR, Truth.WALL, Truth.WALL]
    label = [Label.WALL, Label.CLUTTER, Label.CLUTTER, Label.WALL, Label.WALL, Label.DOOR]
    places = np.array([[(i + 0.5) * CUBE_M, 0.02, 0.52] for i in range(6)])
    counter = Counter(NO_DOORS)
    counter.add(places, ORIGIN, np.array(truth, np.uint8), np.array(label, np.uint8), np.array(label, np.uint8))
    elements = [
        element("niche", Truth.WALL, 0, 1), element("niche", Truth.WALL, 2, 3), element("niche", Truth.WALL, 40, 41),
        element("too high", Truth.WALL, 4, 5, (1.0, 2.0))
    ]  # fmt: skip
    found = tally_elements(elements, counter.tally().cubes)
    assert set(found) == {"niche", REST}
    # The floor's cube in the second niche is none of it, the third was not seen.
    assert (found["niche"].seen, found["niche"].cubes, dict(found["niche"].labels)) == (2, 3, {"wall": 1, "clutter": 2})
    assert found["niche"].recall == pytest.approx(1 / 3)
    assert dict(found[REST].labels) == {"wall": 1, "door": 1}


def test_doors_count_by_their_design() -> None:
    figures = DoorFigures(
        passed=np.array([True, True, True, False, True]), match=np.array([0, -1, 2, 1, 3]), detections=4,
        width_error_m=np.zeros(3), state_right=np.array([True, False, True])
    )  # fmt: skip
    found = doors_by_design(["flush", "flush", "arch", "flush", "arch"], figures)
    assert {name: (own.passed, own.found, own.state_right) for name, own in found.items()} == {
        "flush": (2, 1, 1), "arch": (2, 2, 1)
    }  # fmt: skip
    none = DoorFigures(np.zeros(5, bool), np.full(5, -1), 0, np.zeros(0), np.zeros(0, bool))
    assert doors_by_design(["never passed"] * 5, none) == {}
