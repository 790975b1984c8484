"""What is counted of a scan against the ground truth, against counts by hand."""

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth
from ffmap.algorithms.truth.doors import TrueDoors
from ffmap.algorithms.truth.labels import UNLABELLED
from ffmap.algorithms.truth.tally import VOXEL_M, Tally, confusion_by_area
from tests.algorithms.truth.test_labels import one

NO_DOORS = TrueDoors(np.zeros((0, 2, 2)), np.zeros(0), (), np.zeros(0, np.uint8))
ORIGIN = np.array([0.0, 0.0, 1.0])


def counted(*voxels: tuple[list[int], list[int]]) -> Tally:
    """Count one voxel for each pair of its points' true classes and labels."""
    tally = Tally(NO_DOORS)
    places = [(i + 0.5) * VOXEL_M for i, (truth, _) in enumerate(voxels) for _ in truth]
    points = np.column_stack([places, np.full((len(places), 2), 0.02)])
    truth = np.array([t for truths, _ in voxels for t in truths], np.uint8)
    label = np.array([x for _, labels in voxels for x in labels], np.uint8)
    tally.add(points, ORIGIN, truth, label, label)
    return tally


def test_a_voxel_has_the_majority_of_its_points_and_of_equals_the_lower_code() -> None:
    tally = counted(([3, 3, 0], [3, 0, 0]), ([1, 1], [1, 1]), ([4, 3], [3, 0]), ([1, 8], [5, 4]))
    expected = one(Truth.WALL, Label.CLUTTER, 2) + one(Truth.FLOOR, Label.FLOOR)
    expected += one(Truth.FLOOR, Label.DOOR)
    np.testing.assert_array_equal(confusion_by_area(tally.voxels()), expected)
    by_points = one(3, 3) + one(3, 0, 2) + one(0, 0) + one(1, 1, 2) + one(4, 3)
    by_points += one(1, 5) + one(8, 4)
    np.testing.assert_array_equal(tally.confusion_points[0], by_points)


def test_labels_of_single_scans_are_counted_apart() -> None:
    tally = Tally(NO_DOORS)
    truth, label_scan = np.full(3, 3, np.uint8), np.array([0, 0, 3], np.uint8)
    tally.add(np.full((3, 3), 0.02), ORIGIN, truth, truth, label_scan)
    wall, clutter = one(Truth.WALL, Label.WALL), one(Truth.WALL, Label.CLUTTER)
    np.testing.assert_array_equal(confusion_by_area(tally.voxels()), wall)
    np.testing.assert_array_equal(confusion_by_area(tally.voxels(), single_scans=True), clutter)
    np.testing.assert_array_equal(tally.confusion_points[1], 2 * clutter + wall)


def test_a_return_without_label_is_missed_and_one_without_ground_truth_left_out() -> None:
    tally = counted(([3, 3], [NO_RETURN, NO_RETURN]), ([1], [1]), ([NO_RETURN], [3]))
    expected = one(Truth.WALL, UNLABELLED) + one(Truth.FLOOR, Label.FLOOR)
    np.testing.assert_array_equal(confusion_by_area(tally.voxels()), expected)
    skipped = counted(([3, 3], [NO_RETURN, NO_RETURN]))
    assert (skipped.scans, skipped.skipped, len(skipped.voxels())) == (0, 1, 0)
    assert not skipped.confusion_points.any()


def test_portions_add_up_in_any_order() -> None:
    generator = np.random.default_rng(0)
    jambs = np.array([[[2.0, 0.0], [2.0, 0.9]]])
    doors = TrueDoors(jambs, np.array([2.0]), (np.zeros((0, 2, 2)),), np.zeros(1, np.uint8))
    whole, even, odd, total = (Tally(doors) for _ in range(4))
    for i in range(6):
        truth, label, label_scan = generator.integers(0, (11, 6, 6), (4_000, 3)).T.astype(np.uint8)
        scan = generator.uniform(-3, 3, (4_000, 3)), ORIGIN, truth, label, label_scan
        whole.add(*scan)
        (odd if i % 2 else even).add(*scan)
    total.absorb(odd)
    total.absorb(even)
    for name in ("keys", "counts"):
        a, b = (getattr(tally.voxels(), name) for tally in (whole, total))
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(whole.confusion_points, total.confusion_points)
    np.testing.assert_array_equal(whole.door_returns, total.door_returns)
    assert (whole.scans, total.scans, total.skipped) == (6, 6, 0)
    assert whole.door_returns[0] > 0
