"""What is counted of a scan against the truth, each against an answer worked out by hand."""

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth
from ffmap.algorithms.truth.doors import TrueDoors
from ffmap.algorithms.truth.labels import UNLABELLED
from ffmap.algorithms.truth.tally import CUBE_M, Counter, Tally, confusion_by_area
from tests.algorithms.truth.test_labels import counts, one

NO_DOORS = TrueDoors(np.zeros((0, 2, 2)), np.zeros(0), (), np.zeros(0, np.uint8))
ORIGIN = np.array([0.0, 0.0, 1.0])


def cube(index: int, count: int) -> np.ndarray:
    """Points in the middle of the cube number `index` along x."""
    return np.tile([(index + 0.5) * CUBE_M, 0.02, 0.02], (count, 1))


def counted(*cubes: tuple[list[int], list[int]]) -> Tally:
    """One cube for each pair of its points' true classes and labels."""
    counter = Counter(NO_DOORS)
    points = np.concatenate([cube(i, len(truth)) for i, (truth, _) in enumerate(cubes)])
    truth = np.array([t for truths, _ in cubes for t in truths], np.uint8)
    label = np.array([x for _, labels in cubes for x in labels], np.uint8)
    counter.add(points, ORIGIN, truth, label, label)
    return counter.tally()


class TestArea:
    def test_a_cube_has_the_majority_of_its_points(self):
        tally = counted(([3, 3, 0], [3, 0, 0]), ([1, 1], [1, 1]))
        expected = one(Truth.WALL, Label.CLUTTER) + one(Truth.FLOOR, Label.FLOOR)
        np.testing.assert_array_equal(confusion_by_area(tally.cubes), expected)

    def test_of_equals_the_lower_code(self):
        tally = counted(([4, 3], [3, 0]), ([1, 8], [5, 4]))
        expected = one(Truth.WALL, Label.CLUTTER) + one(Truth.FLOOR, Label.DOOR)
        np.testing.assert_array_equal(confusion_by_area(tally.cubes), expected)

    def test_cubes_are_five_centimetres_and_floor_downwards(self):
        counter = Counter(NO_DOORS)
        points = np.array([[0.001, 0, 0], [0.049, 0, 0], [0.051, 0, 0], [-0.001, 0, 0]])
        wall = np.full(4, 3, np.uint8)
        counter.add(points, ORIGIN, wall, wall, wall)
        assert confusion_by_area(counter.tally().cubes)[Truth.WALL, Label.WALL] == 3

    def test_by_points_every_point_counts(self):
        tally = counted(([3, 3, 0], [3, 0, 0]))
        expected = one(Truth.WALL, Label.WALL) + one(Truth.WALL, Label.CLUTTER) + one(Truth.CLUTTER, Label.CLUTTER)
        np.testing.assert_array_equal(tally.confusion_points, expected)

    def test_labels_of_single_scans_are_counted_apart(self):
        counter = Counter(NO_DOORS)
        truth = np.full(3, 3, np.uint8)
        counter.add(cube(0, 3), ORIGIN, truth, truth, np.array([0, 0, 3], np.uint8))
        tally = counter.tally()
        np.testing.assert_array_equal(confusion_by_area(tally.cubes), one(Truth.WALL, Label.WALL))
        np.testing.assert_array_equal(confusion_by_area(tally.cubes, single_scans=True), one(Truth.WALL, Label.CLUTTER))
        np.testing.assert_array_equal(
            tally.confusion_points_scan, one(Truth.WALL, Label.CLUTTER, 2) + one(Truth.WALL, Label.WALL)
        )

    def test_a_return_without_a_label_is_missed_and_one_without_truth_left_out(self):
        tally = counted(([3, 3], [NO_RETURN, NO_RETURN]), ([1], [1]), ([NO_RETURN], [3]))
        confusion = confusion_by_area(tally.cubes)
        np.testing.assert_array_equal(confusion, one(Truth.WALL, UNLABELLED) + one(Truth.FLOOR, Label.FLOOR))
        assert counts(confusion) == {Label.WALL: (0, 0, 1), Label.FLOOR: (1, 0, 0)}

    def test_a_scan_without_any_label_was_skipped(self):
        tally = counted(([3, 3], [NO_RETURN, NO_RETURN]))
        assert (tally.scans, tally.skipped, len(tally.cubes)) == (0, 1, 0)
        assert not tally.confusion_points.any()

    def test_portions_add_up_in_any_order(self):
        generator = np.random.default_rng(0)
        doors = TrueDoors(
            np.array([[[2.0, 0.0], [2.0, 0.9]]]), np.array([2.0]), (np.zeros((0, 2, 2)),), np.zeros(1, np.uint8)
        )
        scans = [
            (
                generator.uniform(-3, 3, (4_000, 3)),
                ORIGIN,
                generator.integers(0, 11, 4_000).astype(np.uint8),
                generator.integers(0, 6, 4_000).astype(np.uint8),
                generator.integers(0, 6, 4_000).astype(np.uint8),
            )
            for _ in range(6)
        ]
        whole, even, odd, total = (Counter(doors) for _ in range(4))
        for i, scan in enumerate(scans):
            whole.add(*scan)
            (odd if i % 2 else even).add(*scan)
        total.absorb(odd.tally())
        total.absorb(even.tally())
        a, b = whole.tally(), total.tally()
        np.testing.assert_array_equal(a.cubes.keys, b.cubes.keys)
        np.testing.assert_array_equal(a.cubes.counts, b.cubes.counts)
        np.testing.assert_array_equal(a.confusion_points, b.confusion_points)
        np.testing.assert_array_equal(a.confusion_points_scan, b.confusion_points_scan)
        np.testing.assert_array_equal(a.door_returns, b.door_returns)
        assert (a.scans, a.skipped) == (b.scans, b.skipped) == (6, 0)
        assert a.door_returns[0] > 0
