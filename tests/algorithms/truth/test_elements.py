"""Labels by the part of a building, and doors by their design, against counts by hand."""

import numpy as np
import pytest
import shapely

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.truth.doors import DoorComparison
from ffmap.algorithms.truth.elements import REST, Element, doors_by_design, tally_elements
from ffmap.algorithms.truth.tally import VOXEL_M, Tally
from tests.algorithms.truth.test_tally import NO_DOORS, ORIGIN


def element(name: str, first: int, last: int, z_m: tuple[float, float] = (0.0, 3.0)) -> Element:
    """Of a wall, around the voxels from `first` to `last` along x."""
    area = shapely.box(first * VOXEL_M, 0.0, (last + 1) * VOXEL_M, VOXEL_M)
    return Element(name, Truth.WALL, area, z_m)


def test_voxels_count_for_the_element_that_holds_them() -> None:
    truth = np.array([3, 3, 3, Truth.FLOOR, 3, 3], np.uint8)
    label = np.array([Label.WALL, 0, 0, Label.WALL, Label.WALL, Label.DOOR], np.uint8)
    tally = Tally(NO_DOORS)
    places = np.array([[(i + 0.5) * VOXEL_M, 0.02, 0.52] for i in range(6)])
    tally.add(places, ORIGIN, truth, label, label)
    elements = [element("niche", *own) for own in ((0, 1), (2, 3), (40, 41))]
    found = tally_elements([*elements, element("too high", 4, 5, (1.0, 2.0))], tally.voxels())
    assert set(found) == {"niche", REST}
    # The second niche holds a voxel of the floor, the third was not seen.
    assert found["niche"] == {
        "truth": "wall",
        "seen": 2,
        "cubes": 3,
        "recall": pytest.approx(1 / 3),
        "labels": {"wall": 1, "clutter": 2},
    }
    assert found[REST]["labels"] == {"wall": 1, "door": 1}


def test_doors_count_by_their_design() -> None:
    doors = DoorComparison(
        passed=np.array([True, True, True, False, True]),
        match=np.array([0, -1, 2, 1, 3]),
        detections=4,
        width_error_m=np.zeros(3),
        state_right=np.array([True, False, True]),
    )
    assert doors_by_design(["flush", "flush", "arch", "sliding", "arch"], doors) == {
        "arch": {"passed": 2, "found": 2, "state_right": 1},
        "flush": {"passed": 2, "found": 1, "state_right": 1},
    }
