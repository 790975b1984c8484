"""Differences between two results: known changes are found, in any frame."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.changes import (
    CLASSES,
    Became,
    SpotFinder,
    compare_grids,
    count_judged,
    count_transitions,
    judge,
    most_frequent,
    name_transition,
    unmatched_walls,
)
from tests.rasters import moved

WALLS = np.array([[[0, 0], [5, 0]], [[5, 0], [5, 4]], [[5, 4], [0, 4]], [[0, 4], [0, 0]]], float)


def test_labels_are_counted_point_by_point() -> None:
    codes = np.array([0, 1, 2, 3, 4, 5, NO_RETURN], np.uint8)
    a, b = np.random.default_rng(1).choice(codes, (2, 5000))
    counts = count_transitions(a, b)
    for row, before in enumerate(codes):
        for column, after in enumerate(codes):
            wanted = np.count_nonzero((a == before) & (b == after))
            assert counts[row, column] == (0 if before == after == NO_RETURN else wanted)
    assert counts.sum() - np.trace(counts) == np.count_nonzero(a != b)
    np.testing.assert_array_equal(count_transitions(b, a), counts.T)
    first, second = most_frequent([counts], 2)
    rows, columns = np.divmod([first, second], CLASSES)
    assert counts[rows[0], columns[0]] >= counts[rows[1], columns[1]] > 0
    assert most_frequent([count_transitions(a, a)], 3) == most_frequent([], 3) == []
    assert name_transition(3 * CLASSES) == "wall → clutter"


def test_labels_that_are_not_counted_became_neither_right_nor_wrong() -> None:
    wall, clutter, floor = Label.WALL, Label.CLUTTER, Label.FLOOR
    rows = (
        (Truth.WALL, clutter, wall, Became.RIGHT),
        (Truth.WALL, wall, NO_RETURN, Became.WRONG),
        (Truth.WALL, clutter, floor, Became.NEITHER),
        (Truth.GLASS, clutter, wall, Became.NEITHER),
        (Truth.BOARD_ON_WALL, clutter, wall, Became.NEITHER),
        (255, clutter, wall, Became.NEITHER),
    )
    truth, a, b, expected = (np.array(own, np.uint8) for own in zip(*rows, strict=True))
    became = judge(truth, a, b)
    np.testing.assert_array_equal(became, expected)
    counts = count_judged(truth, became)
    assert counts.sum() == 2
    np.testing.assert_array_equal(counts[Truth.WALL], [1, 1])


def test_the_spot_with_most_points_is_found_with_its_scans() -> None:
    finder = SpotFinder()
    assert finder.find() is None
    for scan in range(100):
        lone = np.array([[-20.0 + 0.4 * scan, 5.0, 1.0]])
        many = np.array([[3.0, -2.0, 0.5]] * (9 if 40 <= scan < 60 else 0)).reshape(-1, 3)
        finder.add(scan, np.concatenate([lone, many]))
    spot = finder.find()
    assert (spot.x_m, spot.y_m) == pytest.approx((3.0, -2.0), abs=0.3)
    assert spot.share == pytest.approx(180 / 280)
    assert (spot.first, spot.last) == pytest.approx((41, 58), abs=1)


@pytest.mark.parametrize(("turn_deg", "shift"), [(0.0, (0.0, 0.0)), (40.0, (-30.0, 12.5))])
def test_a_wall_that_is_gone_is_lost_with_its_length(
    turn_deg: float, shift: tuple[float, float]
) -> None:
    a, b = moved(WALLS, turn_deg, shift), moved(WALLS[[3, 0, 2]], turn_deg, shift)
    lost = unmatched_walls(a, b)
    # At its ends it is near its neighbours, but across their direction.
    np.testing.assert_allclose(lost, a[1:2], atol=0.01)
    assert len(unmatched_walls(b, a)) == 0


def test_the_part_of_a_wall_without_a_partner_is_lost() -> None:
    parts = np.array([[[0, 0.04], [2, 0.04]], [[3.5, -0.03], [5, -0.03]]])
    split = np.concatenate([WALLS[1:], parts])
    # The parts reach 10 cm farther than they themselves do, less their distance from the wall.
    assert lengths_m(unmatched_walls(WALLS, split)).sum() == pytest.approx(1.32, abs=0.06)
    assert len(unmatched_walls(split, WALLS)) == 0
    assert lengths_m(unmatched_walls(WALLS, WALLS[:0])).sum() == pytest.approx(18.0)
    assert len(unmatched_walls(WALLS[:0], WALLS)) == 0


def test_cells_are_compared_by_their_place() -> None:
    cells = np.full((6, 8), Cell.FREE, np.uint8)
    cells[2, :] = Cell.OCCUPIED
    a = GridMap(cells, np.array([-1.0, 0.5]), 0.05)
    other = np.full((9, 12), Cell.UNKNOWN, np.uint8)
    other[3:9, 2:10] = cells
    b = GridMap(other, np.array([-1.1, 0.35]), 0.05)
    lost, gained, figures = compare_grids(a, b)
    assert len(lost) == len(gained) == 0
    assert [name for name, count in figures.items() if count] == ["occupied_kept"]
    other[5, 4] = Cell.FREE  # A's row 2, column 2
    other[0, 0] = Cell.OCCUPIED
    lost, gained, figures = compare_grids(a, b)
    np.testing.assert_allclose(lost, [[-1.0 + 2.5 * 0.05, 0.5 + 2.5 * 0.05]])
    np.testing.assert_allclose(gained, [[-1.1 + 0.025, 0.35 + 0.025]])
    assert list(figures.values()) == [1, 1, 7, 0, 1]
    with pytest.raises(ValueError, match=r"0\.05 m against cells of 0\.1 m"):
        compare_grids(a, GridMap(cells, a.origin, 0.1))
