"""The building's ceilings: two rooms of different height, one of which a scan saw too little of; and its raised floors."""

import numpy as np
import pytest

from algorithms.height_maps import HeightMap, map_ceilings, map_ducts, map_glimpsed_ceilings, map_raised_floors
from algorithms.labels import Label
from algorithms.semantic_map import merge
from tests.voting import vote


def two_rooms() -> HeightMap:
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
    floor = vote(np.zeros((4, 3)), np.full(4, Label.FLOOR, np.uint8), len(Label), 0.05)
    assert map_ceilings(floor).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    assert map_raised_floors(nothing).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    for votes in (nothing, floor):
        assert map_glimpsed_ceilings(votes).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    assert len(two_rooms().label_of(np.zeros((0, 3)), np.zeros(0, np.uint8))) == 0


def lying(x: tuple[float, float], y: tuple[float, float], z: float, slope: float = 0.0) -> np.ndarray:
    """(n, 3) points 5 cm apart on something level, or sloping along x."""
    xs, ys = (a.ravel() for a in np.meshgrid(np.arange(x[0] + 0.02, x[1], 0.05), np.arange(y[0] + 0.02, y[1], 0.05)))
    return np.column_stack([xs, ys, z + slope * xs])


def raised(*pieces: tuple[np.ndarray, Label]) -> HeightMap:
    portions = [vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces]
    return map_raised_floors(merge(portions * 3))


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_platform_is_floor_and_so_is_what_stands_on_it_not(slope: float) -> None:
    floor, platform = lying((0, 4), (0, 4), 0.01, slope), lying((4, 7), (0, 4), 0.16, slope)
    table = lying((5, 6), (1, 2), 0.73 + slope * 5)
    found = raised((floor, Label.FLOOR), (platform, Label.CLUTTER), (table, Label.CLUTTER))
    clutter = np.zeros(1, np.uint8)
    for x in (4.3, 5.5, 6.8):
        assert found.label_of(np.array([[x, 1.5, 0.16 + slope * x]]), clutter)[0] == Label.FLOOR
        assert found.label_of(np.array([[x, 1.5, 0.25 + slope * x]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[5.5, 1.5, 0.73 + slope * 5]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[2.0, 1.5, 0.16 + slope * 2]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[5.5, 1.5, 0.16]]), np.array([Label.WALL], np.uint8))[0] == Label.WALL


def test_a_platform_that_shows_in_lines_is_floor() -> None:
    """At a slant, an emitter's line on it is far from the next."""
    floor, platform = lying((0, 4), (0, 4), 0.01), lying((4, 7), (0, 4), 0.16)
    lines = platform[np.floor(platform[:, 0] * 10).astype(int) % 4 == 0]
    found = raised((floor, Label.FLOOR), (lines, Label.CLUTTER))
    inner = lines[(lines[:, 0] > 4.5) & (lines[:, 0] < 6.5) & (np.abs(lines[:, 1] - 2.0) < 1.5)]
    assert np.all(found.label_of(inner, np.zeros(len(inner), np.uint8)) == Label.FLOOR)


@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        ((1.0, 2.2), (1.0, 1.8), 0.15),  # a pallet
        ((1.0, 3.5), (1.0, 1.9), 0.15),  # a mattress
        ((1.0, 3.5), (1.0, 3.5), 0.45),  # as high as a seat
        ((1.0, 3.5), (1.0, 3.5), 0.04),  # a carpet
    ],
)
def test_what_is_narrow_high_or_thin_is_no_floor(x: tuple[float, float], y: tuple[float, float], z: float) -> None:
    floor = lying((0, 5), (0, 5), 0.01)
    hidden = (floor[:, 0] > x[0]) & (floor[:, 0] < x[1]) & (floor[:, 1] > y[0]) & (floor[:, 1] < y[1])
    found = raised((floor[~hidden], Label.FLOOR), (lying(x, y, z), Label.CLUTTER))
    assert np.isnan(found.height_m).all()


def test_a_table_whose_floor_is_seen_below_it_is_none() -> None:
    low_table = lying((1.0, 3.5), (1.0, 3.5), 0.25)
    found = raised((lying((0, 5), (0, 5), 0.01), Label.FLOOR), (low_table, Label.CLUTTER))
    assert np.isnan(found.height_m).all()


@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((5.0, 7.0), (0.0, 4.0), 2.82, Label.CEILING),  # of another room, seen through its doorway
        ((5.0, 7.0), (1.0, 1.4), 2.82, Label.CLUTTER),  # a duct
        ((5.0, 7.0), (0.0, 4.0), 1.92, Label.CLUTTER),  # a bunk
        ((0.0, 4.0), (0.0, 4.0), 2.22, Label.CLUTTER),  # a canopy below the ceiling
    ],
)
def test_a_glimpsed_ceiling_is_high_broad_and_the_highest(
    x: tuple[float, float], y: tuple[float, float], z: float, expected: Label
) -> None:
    pieces = (
        (lying((0, 7), (0, 4), 0.01), Label.FLOOR),
        (lying((0, 4), (0, 4), 2.52), Label.CEILING),
        (lying(x, y, z), Label.CLUTTER),
    )
    votes = merge([vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces] * 3)
    point = np.array([[np.mean(x), np.mean(y), z]])
    assert map_glimpsed_ceilings(votes).label_of(point, np.array([Label.CLUTTER], np.uint8))[0] == expected


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        ((1.5, 1.9), (0.5, 3.5), Label.CLUTTER),  # a duct
        ((1.0, 2.5), (0.0, 4.0), Label.CEILING),  # a bulkhead
        ((4.1, 7.0), (0.0, 4.0), Label.CEILING),  # another room's, up to the wall between them
    ],
)
def test_a_narrow_strip_below_a_ceiling_is_a_duct(
    x: tuple[float, float], y: tuple[float, float], expected: Label
) -> None:
    high = lying((0, 4), (0, 4), 3.02)
    beside = (high[:, 0] < x[0]) | (high[:, 0] > x[1]) | (high[:, 1] < y[0]) | (high[:, 1] > y[1])
    low = lying(x, y, 2.72)
    ceiling = np.concatenate([high[beside], low])
    ducts = map_ducts(merge([vote(ceiling, np.full(len(ceiling), Label.CEILING, np.uint8), len(Label), 0.05)]))
    as_ceiling = np.full(len(low), Label.CEILING, np.uint8)
    assert np.all(ducts.label_of(low, as_ceiling) == expected)
    assert np.all(ducts.label_of(high[beside], np.full(beside.sum(), Label.CEILING, np.uint8)) == Label.CEILING)
    # What was not taken for a ceiling stays what it is.
    assert np.all(ducts.label_of(low, np.full(len(low), Label.WALL, np.uint8)) == Label.WALL)


def test_without_a_ceiling_there_is_no_duct() -> None:
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    assert map_ducts(nothing).label_of(np.zeros((1, 3)), np.array([Label.CEILING], np.uint8))[0] == Label.CEILING
