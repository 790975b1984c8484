"""The building's ceilings: two rooms of different height, one of which a scan saw too little of."""

import numpy as np
import pytest

from algorithms.ceiling_map import NO_CEILINGS, CeilingMap, map_ceilings
from algorithms.labels import Label
from algorithms.semantic_map import merge, vote


def two_rooms() -> CeilingMap:
    """Ceilings at 2.5 m where x < 3 and at 3.0 m beyond, with a lamp's returns below the lower one."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.02, 6, 0.05), np.arange(0.02, 2, 0.05)))
    points = np.column_stack([x, y, np.where(x < 3, 2.52, 3.02)])
    lamp = np.array([[1.02, 1.02, 2.37]])
    portions = [vote(points, np.full(len(points), Label.CEILING, np.uint8), len(Label), 0.05) for _ in range(3)]
    return map_ceilings(merge([*portions, vote(lamp, np.zeros(1, np.uint8), len(Label), 0.05)]))


@pytest.mark.parametrize(
    ("point", "label", "expected"),
    [
        ((1.0, 1.0, 2.51), Label.CLUTTER, Label.CEILING),
        ((1.0, 1.0, 2.37), Label.CLUTTER, Label.CLUTTER),  # a lamp
        ((5.0, 1.0, 2.51), Label.CLUTTER, Label.CLUTTER),  # the other room's height
        ((5.0, 1.0, 3.03), Label.CLUTTER, Label.CEILING),
        ((5.0, 3.0, 3.03), Label.CLUTTER, Label.CEILING),  # where the ceiling goes on
        ((5.0, 9.0, 3.03), Label.CLUTTER, Label.CLUTTER),  # far from all that was seen
        ((1.0, 1.0, 2.51), Label.WALL, Label.WALL),  # only clutter is doubted
    ],
)
def test_clutter_at_the_ceilings_height_is_ceiling(
    point: tuple[float, float, float], label: Label, expected: Label
) -> None:
    assert two_rooms().label_of(np.array([point]), np.array([label], np.uint8))[0] == expected


def test_a_building_without_ceilings_changes_nothing() -> None:
    label = np.zeros(1, np.uint8)
    assert NO_CEILINGS.label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    floor = vote(np.zeros((4, 3)), np.full(4, Label.FLOOR, np.uint8), len(Label), 0.05)
    assert map_ceilings(floor).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    assert len(two_rooms().label_of(np.zeros((0, 3)), np.zeros(0, np.uint8))) == 0
