"""Rooms found against rooms that are known."""

import numpy as np
import pytest
import shapely

from ffmap.algorithms.truth.rooms import compare_room_images, compare_rooms, rooms_of_image

LEFT, RIGHT = shapely.box(0, 0, 4, 5), shapely.box(4.2, 0, 8.2, 5)


def test_recall_and_precision_are_of_the_largest_overlap() -> None:
    half, rest = shapely.box(0, 0, 2, 5), shapely.box(2, 0, 8.2, 5)
    figures = compare_rooms([LEFT, RIGHT], [half, rest])
    np.testing.assert_allclose(figures.recall, [0.5, 1.0])
    np.testing.assert_allclose(figures.precision, [1.0, 20 / 31])
    assert figures.mean_recall == pytest.approx(0.75)


def test_a_room_is_split_by_two_that_touch_in_it_not_by_two_views_into_it() -> None:
    touching = [shapely.box(0, 0, 2, 5), shapely.box(2, 0, 4, 5), RIGHT]
    assert compare_rooms([LEFT, RIGHT], touching).split == (0,)
    apart = [shapely.box(0, 0, 1, 5), shapely.box(3, 0, 4, 5), RIGHT]
    assert compare_rooms([LEFT, RIGHT], apart).split == ()


def test_rooms_are_merged_where_one_room_holds_most_that_was_mapped_of_both() -> None:
    figures = compare_rooms([LEFT, RIGHT], [shapely.box(0, 0, 8.2, 5)])
    assert figures.merged == ((0, 1),)
    assert compare_rooms([LEFT, RIGHT], [LEFT.union(shapely.box(4, 0, 4.3, 5)), RIGHT]).merged == ()


def test_the_mean_recall_is_over_rooms_that_the_robot_entered() -> None:
    path = np.column_stack([np.linspace(1, 4.4, 40), np.full(40, 2.0), np.zeros(40)])
    figures = compare_rooms([LEFT, RIGHT], [LEFT], path)
    np.testing.assert_array_equal(figures.counted, [True, False])
    assert figures.mean_recall == 1.0
    assert np.isnan(compare_rooms([LEFT], [], np.zeros((0, 3))).mean_recall)


def test_true_rooms_are_four_connected_and_not_tiny() -> None:
    pixels = np.zeros((40, 60), np.uint8)
    pixels[5:25, 5:25] = 255
    pixels[25:35, 25:45] = 251  # touches by a corner only
    pixels[2:4, 50:55] = 255  # 0.025 m²
    pixels[37:39, 5:25] = 250
    label = rooms_of_image(pixels, 0.05)
    assert label.max() == 1
    assert np.count_nonzero(label == label[10, 10]) == 400
    assert label[30, 30] not in (-1, label[10, 10])
    assert label[2, 51] == label[37, 10] == -1


def test_only_free_cells_of_the_segmented_map_count() -> None:
    true = np.full((10, 20), -1)
    true[:, :10], true[:, 10:] = 0, 1
    found = np.zeros((10, 20), int)
    free = np.ones((10, 20), bool)
    free[:5, :10] = False
    figures = compare_room_images(true, found, free, 0.5)
    np.testing.assert_allclose(figures.recall, [1.0, 1.0])
    np.testing.assert_allclose(figures.precision, [100 / 150])
    assert figures.merged == ((0, 1),)
    found[:, 15:] = 1
    assert compare_room_images(true, found, free, 0.5).split == ()
    found[:, 10:15] = 2
    assert compare_room_images(true, found, free, 0.5).split == (1,)
