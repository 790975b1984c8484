"""What differs is found exactly: known changes, none where there are none, whatever the order or the frame."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.labels import NO_RETURN, Label
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.runs import (
    CLASSES,
    UNLABELLED,
    changed_of,
    classes_of,
    compare_doors,
    compare_grids,
    compare_walls,
    match_planes,
    transitions,
)

WALLS = np.array([[[0, 0], [5, 0]], [[5, 0], [5, 4]], [[5, 4], [0, 4]], [[0, 4], [0, 0]]], float)
DOORS = np.array([[[1, 0], [1.9, 0]], [[5, 1], [5, 2]], [[3, 4], [2, 4]]], float)


def turned(ends: np.ndarray, angle_rad: float, shift: tuple[float, float]) -> np.ndarray:
    return ends @ Rotation.from_euler("z", angle_rad).as_matrix()[:2, :2].T + shift


def labels(seed: int, count: int = 5000) -> np.ndarray:
    return np.random.default_rng(seed).choice(
        np.array([0, 1, 2, 3, 4, 5, NO_RETURN], np.uint8), count, p=[0.2, 0.2, 0.2, 0.2, 0.1, 0.05, 0.05]
    )


def test_labels_are_counted_point_by_point() -> None:
    a, b = labels(1), labels(2)
    counts = transitions(a, b)
    for before in [*Label, NO_RETURN]:
        for after in [*Label, NO_RETURN]:
            wanted = sum(1 for x, y in zip(a, b, strict=True) if (x, y) == (before, after))
            row, column = (int(classes_of(np.array([label], np.uint8))[0]) for label in (before, after))
            assert counts[row, column] == (0 if before == after == NO_RETURN else wanted)
    assert changed_of(counts) == sum(1 for x, y in zip(a, b, strict=True) if x != y)
    assert np.array_equal(transitions(b, a), counts.T)
    order = np.random.default_rng(3).permutation(len(a))
    assert np.array_equal(transitions(a[order], b[order]), counts)


def test_equal_labels_differ_nowhere() -> None:
    a = labels(1)
    counts = transitions(a, a)
    assert changed_of(counts) == 0
    assert counts.sum() == np.count_nonzero(a != NO_RETURN)
    assert counts[UNLABELLED, UNLABELLED] == 0
    assert transitions(a[:0], a[:0]).shape == (CLASSES, CLASSES)


def test_clouds_of_different_sizes_are_not_compared() -> None:
    with pytest.raises(ValueError, match="5000 labels against 4999"):
        transitions(labels(1), labels(1)[:-1])


@pytest.mark.parametrize(("angle_rad", "shift"), [(0.0, (0.0, 0.0)), (0.7, (-30.0, 12.5))])
def test_a_wall_that_is_gone_is_lost_with_its_length(angle_rad: float, shift: tuple[float, float]) -> None:
    a, b = turned(WALLS, angle_rad, shift), turned(WALLS[[3, 0, 2]], angle_rad, shift)
    found = compare_walls(a, b)
    # At its ends it lies beside the neighbours, but across their direction.
    assert found.lost_m == pytest.approx(4.0, abs=0.01)
    np.testing.assert_allclose(found.lost[0], a[1], atol=0.01)
    assert len(found.gained) == 0
    back = compare_walls(b, a)
    assert back.gained_m == pytest.approx(found.lost_m)
    assert back.lost_m == 0


def test_the_part_of_a_wall_that_has_no_partner_is_lost() -> None:
    split = np.concatenate([WALLS[1:], [[[0, 0.04], [2, 0.04]], [[3.5, -0.03], [5, -0.03]]]])
    found = compare_walls(WALLS, split)
    # The partners beside it reach 10 cm farther than they themselves do, less what they lie off it.
    assert found.lost_m == pytest.approx(1.5 - 2 * 0.09, abs=0.06)
    assert found.gained_m == 0
    assert compare_walls(WALLS, WALLS + np.array([0, 0.3])).lost_m == pytest.approx(10.0, abs=0.7)
    for ends in (WALLS, WALLS[:0]):
        assert compare_walls(ends, ends).lost_m == compare_walls(ends, ends).gained_m == 0
    assert compare_walls(WALLS, WALLS[:0]).lost_m == pytest.approx(18.0)


def test_doors_are_lost_and_gained() -> None:
    moved = DOORS[[2, 0]] + np.array([0.05, -0.02])
    new = np.array([[[9, 9], [9.9, 9]]])
    found = compare_doors(DOORS, np.concatenate([moved, new]))
    assert found.match.tolist() == [1, -1, 0]
    assert found.lost.tolist() == [1]
    assert found.gained.tolist() == [2]
    across = DOORS[:1].mean(axis=1, keepdims=True) + np.array([[[0, -0.45], [0, 0.45]]])
    assert compare_doors(DOORS[:1], across).lost.tolist() == [0]
    assert compare_doors(DOORS[:0], DOORS).gained.tolist() == [0, 1, 2]


def test_map_cells_are_known_by_their_place_whatever_the_grids_reach() -> None:
    cells = np.full((6, 8), Cell.FREE, np.uint8)
    cells[2, :] = Cell.OCCUPIED
    a = GridMap(cells, np.array([-1.0, 0.5]), 0.05)
    other = np.full((9, 12), Cell.UNKNOWN, np.uint8)
    other[3:9, 2:10] = cells
    b = GridMap(other, np.array([-1.1, 0.35]), 0.05)
    same = compare_grids(a, b)
    assert (len(same.lost), len(same.gained), same.kept, same.freed, same.blocked) == (0, 0, 8, 0, 0)
    other[5, 4] = Cell.FREE  # A's row 2, column 2
    other[0, 0] = Cell.OCCUPIED
    found = compare_grids(a, GridMap(other, b.origin, 0.05))
    np.testing.assert_allclose(found.lost, [[-1.0 + 2.5 * 0.05, 0.5 + 2.5 * 0.05]])
    np.testing.assert_allclose(found.gained, [[-1.1 + 0.025, 0.35 + 0.025]])
    assert (found.kept, found.freed, found.blocked) == (7, 1, 0)
    with pytest.raises(ValueError, match=r"0\.05 m against cells of 0\.1 m"):
        compare_grids(a, GridMap(cells, a.origin, 0.1))


def test_planes_of_a_scan_match_one_to_one() -> None:
    angle = np.radians([0.0, 90.0, 180.0])
    normal, offset = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.array([2.0, 1.5, 2.0])
    order = [2, 0, 1]
    assert match_planes(normal, offset, normal[order], offset[order] + 0.03) == (0, 0)
    assert match_planes(normal, offset, normal, offset + 0.06) == (3, 3)
    # Of two that lie near, one alone is its partner.
    assert match_planes(normal, offset, normal[[0, 0]], np.array([2.01, 1.98])) == (2, 1)
    assert match_planes(normal, offset, normal[:0], offset[:0]) == (3, 0)
    tilted = np.stack([np.cos(angle + np.radians(6)), np.sin(angle + np.radians(6))], axis=1)
    assert match_planes(normal, offset, tilted, offset) == (3, 3)
