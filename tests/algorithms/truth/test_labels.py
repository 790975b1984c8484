"""Every rule of how figures are counted, each against an answer worked out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Label, Truth, Verdict
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.labels import (
    CUBE_M,
    Counter,
    FoundDoors,
    Tally,
    TrueDoors,
    align,
    cells_along,
    class_figures,
    compare_doors,
    compare_trajectories,
    compare_wall_map,
    confusion_by_area,
    outside_kept,
    verdicts,
)
from tests.voting import vote

UNLABELLED = 6
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


def one(truth: int, label: int, count: int = 1) -> np.ndarray:
    confusion = np.zeros((len(Truth), UNLABELLED + 1), np.int64)
    confusion[truth, label] = count
    return confusion


def counts(confusion: np.ndarray) -> dict[Label, tuple[int, int, int]]:
    """(true positives, false positives, false negatives) of the labels that count anything."""
    figures = {
        label: (f.true_positives, f.false_positives, f.false_negatives) for label, f in class_figures(confusion).items()
    }
    return {label: figure for label, figure in figures.items() if any(figure)}


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


class TestClasses:
    def test_precision_recall_and_f1_by_hand(self):
        confusion = one(3, 3, 8) + one(3, 0, 2) + one(0, 3, 1) + one(0, 0, 5)
        wall = class_figures(confusion)[Label.WALL]
        assert wall.precision == pytest.approx(8 / 9)
        assert wall.recall == pytest.approx(8 / 10)
        assert wall.f1 == pytest.approx(2 * (8 / 9) * 0.8 / (8 / 9 + 0.8))

    def test_the_papers_table_follows_from_its_areas(self):
        # Table II: wall 703.24 m² right, 2.80 wrong, 34.99 missed, in hundredths of a square metre.
        wall = class_figures(one(3, 3, 70324) + one(0, 3, 280) + one(3, 0, 3499))[Label.WALL]
        assert (round(100 * wall.precision, 2), round(100 * wall.recall, 2)) == (99.60, 95.26)
        assert 100 * wall.f1 == pytest.approx(97.37, abs=0.02)

    def test_nothing_to_divide_by(self):
        wall = class_figures(one(0, 0))[Label.WALL]
        assert np.isnan([wall.precision, wall.recall, wall.f1]).all()

    @pytest.mark.parametrize("label", range(7))
    def test_glass_is_left_out(self, label: int):
        assert counts(one(Truth.GLASS, label)) == {}

    @pytest.mark.parametrize(
        ("truth", "right"),
        [
            (Truth.FULL_HEIGHT_CABINET, {Label.WALL, Label.CLUTTER}),
            (Truth.BOARD_ON_WALL, {Label.WALL, Label.CLUTTER}),
            (Truth.OPEN_LEAF, {Label.DOOR, Label.CLUTTER}),
            (Truth.PERSON, {Label.CLUTTER, Label.OUTSIDE}),
        ],
    )
    def test_where_two_labels_are_right(self, truth: Truth, right: set[Label]):
        for label in Label:
            assert counts(one(truth, label)) == ({} if label in right else {label: (0, 1, 0)})

    def test_outside_is_right_unless_structure(self):
        assert counts(one(Truth.OUTSIDE, Label.CLUTTER)) == {}
        assert counts(one(Truth.OUTSIDE, Label.OUTSIDE)) == {Label.OUTSIDE: (1, 0, 0)}
        for label in (Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR):
            assert counts(one(Truth.OUTSIDE, label)) == {label: (0, 1, 0), Label.OUTSIDE: (0, 0, 1)}

    def test_a_wrong_label_is_missed_there_and_false_here(self):
        assert counts(one(Truth.WALL, Label.DOOR)) == {Label.WALL: (0, 0, 1), Label.DOOR: (0, 1, 0)}
        assert counts(one(Truth.CLUTTER, Label.OUTSIDE)) == {Label.CLUTTER: (0, 0, 1), Label.OUTSIDE: (0, 1, 0)}

    def test_outside_kept_as_structure(self):
        confusion = one(5, 5, 6) + one(5, 0, 2) + one(5, 3, 1) + one(5, 1, 1) + one(3, 3, 90)
        assert outside_kept(confusion) == pytest.approx(0.2)
        assert np.isnan(outside_kept(one(3, 3)))


def doors(
    *midpoints_xy: tuple[float, float], turn_deg: float = 0.0, width_m: float = 0.9, leaf: bool = False
) -> TrueDoors:
    along = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))]) * width_m / 2
    ends = np.array([[np.array(m) - along, np.array(m) + along] for m in midpoints_xy]).reshape(-1, 2, 2)
    leaves = tuple(e[None] if leaf else np.zeros((0, 2, 2)) for e in ends)
    return TrueDoors(ends, np.full(len(ends), 2.0), leaves, np.zeros(len(ends), np.uint8))


def found(
    *midpoints_xy: tuple[float, float], turn_deg: float = 0.0, width_m: float = 0.9, state: int = 0
) -> FoundDoors:
    ends = doors(*midpoints_xy, turn_deg=turn_deg, width_m=width_m).ends
    return FoundDoors(ends, np.full(len(ends), width_m), np.full(len(ends), state, np.uint8))


class TestPassedDoors:
    def near(self, point: tuple[float, float, float], origin: tuple[float, float, float], true: TrueDoors) -> int:
        counter = Counter(true)
        wall = np.full(1, 3, np.uint8)
        counter.add(np.array([point]), np.array(origin), wall, wall, wall)
        return int(counter.tally().door_returns[0])

    @pytest.mark.parametrize(
        ("point", "expected"),
        [
            ((0.45, 0.29, 1.0), 1),  # beside a jamb
            ((0.45, 0.31, 1.0), 0),
            ((0.45 + 0.2, 0.2, 1.0), 1),  # 0.28 m from it, aslant
            ((0.45 + 0.22, 0.22, 1.0), 0),  # 0.31 m
            ((0.0, 0.0, 2.29), 1),  # above the head
            ((0.0, 0.0, 2.31), 0),
            ((0.0, 0.0, 1.71), 1),  # below it
            ((0.0, 0.0, 1.0), 0),  # in the middle of the opening: neither frame nor leaf
            ((0.0, 0.0, -0.1), 0),
        ],
    )
    def test_near_the_frame(self, point: tuple[float, float, float], expected: int):
        assert self.near(point, (0.0, -2.0, 1.0), doors((0, 0))) == expected

    def test_near_the_leaf(self):
        closed = doors((0, 0), leaf=True)
        assert self.near((0.0, 0.29, 1.0), (0, -2, 1), closed) == 1
        assert self.near((0.0, 0.31, 1.0), (0, -2, 1), closed) == 0
        leaf = np.array([[[-0.45, 0.0], [-0.45, 0.9]]])
        ajar = TrueDoors(closed.ends, closed.head_m, (leaf,), np.ones(1, np.uint8))
        assert self.near((-0.2, 0.9, 1.0), (0, -2, 1), ajar) == 1
        assert self.near((-0.1, 0.9, 1.0), (0, -2, 1), ajar) == 0

    def test_taken_from_within_six_metres(self):
        assert self.near((0.45, 0.0, 1.0), (0.45, -5.99, 1.0), doors((0, 0))) == 1
        assert self.near((0.45, 0.0, 1.0), (0.45, -6.01, 1.0), doors((0, 0))) == 0
        assert self.near((0.45, 0.0, 2.0), (0.45, -5.99, 1.0), doors((0, 0))) == 0

    def test_two_hundred_returns(self):
        none = found()
        assert compare_doors(doors((0, 0)), np.array([200]), none).passed.tolist() == [True]
        assert compare_doors(doors((0, 0)), np.array([199]), none).passed.tolist() == [False]

    def test_a_return_counts_for_each_door_it_is_near_to_and_once(self):
        true = doors((0, 0), (1.0, 0), leaf=True)
        counter = Counter(true)
        wall = np.full(1, 3, np.uint8)
        counter.add(np.array([[0.5, 0.0, 1.0]]), np.array([0.5, -1.0, 1.0]), wall, wall, wall)
        assert counter.tally().door_returns.tolist() == [1, 1]


class TestDoors:
    def compare(self, true: TrueDoors, claims: FoundDoors, returns: list[int] | None = None):
        return compare_doors(true, np.array(returns if returns is not None else [500] * len(true)), claims)

    def test_found_missed_and_invented(self):
        figures = self.compare(doors((0, 0), (5, 0), (10, 0)), found((0.1, 0), (5, 0.2), (20, 0), (30, 0)))
        assert figures.match.tolist() == [0, 1, -1]
        assert figures.found == pytest.approx(2 / 3)
        assert figures.invented == pytest.approx(2 / 4)

    def test_midpoints_within_thirty_centimetres(self):
        assert self.compare(doors((0, 0)), found((0.299, 0))).found == 1
        assert self.compare(doors((0, 0)), found((0.301, 0))).found == 0

    def test_directions_within_fifteen_degrees_either_way_round(self):
        assert self.compare(doors((0, 0)), found((0, 0), turn_deg=14.9)).found == 1
        assert self.compare(doors((0, 0)), found((0, 0), turn_deg=15.1)).found == 0
        assert self.compare(doors((0, 0)), found((0, 0), turn_deg=180)).found == 1

    def test_one_to_one_nearest_first(self):
        # The second detection is nearest to the first door; the first detection must then take the other one.
        figures = self.compare(doors((0, 0), (0.2, 0)), found((0.15, 0), (0.01, 0)))
        assert figures.match.tolist() == [1, 0]
        figures = self.compare(doors((0, 0)), found((0.1, 0), (0.05, 0)))
        assert figures.match.tolist() == [1]
        assert figures.invented == pytest.approx(0.5)

    def test_a_door_not_passed_counts_neither_as_missed_nor_as_invented(self):
        figures = self.compare(doors((0, 0), (5, 0)), found((5, 0)), [500, 20])
        assert (figures.found, figures.invented, len(figures.width_error_m)) == (0.0, 0.0, 0)

    def test_width_and_state_of_those_found(self):
        figures = self.compare(doors((0, 0), (5, 0)), found((0, 0), (5, 0), width_m=0.95, state=1))
        np.testing.assert_allclose(figures.width_error_m, [0.05, 0.05])
        assert figures.state_right.tolist() == [False, False]
        assert self.compare(doors((0, 0)), found((0, 0))).state_right.tolist() == [True]

    def test_no_doors_and_no_detections(self):
        nothing = self.compare(doors(), found())
        assert np.isnan([nothing.found, nothing.invented]).all()
        assert self.compare(doors(), found((0, 0))).invented == 1
        assert self.compare(doors((0, 0)), found()).found == 0

    def test_the_order_of_detections_does_not_matter(self):
        generator = np.random.default_rng(3)
        true = doors(*[(float(x), 0.0) for x in range(8)])
        midpoints = [(float(x + generator.uniform(-0.2, 0.2)), 0.0) for x in range(8)]
        forward, backward = self.compare(true, found(*midpoints)), self.compare(true, found(*midpoints[::-1]))
        assert forward.match.tolist() == [7 - m for m in backward.match.tolist()]


class TestWallMap:
    def grid(self, *occupied_row_column: tuple[int, int]) -> GridMap:
        cells = np.full((40, 60), Cell.FREE, np.uint8)
        for row, column in occupied_row_column:
            cells[row, column] = Cell.OCCUPIED
        return GridMap(cells, np.array([-1.0, -1.0]), 0.05)

    def wall_returns(self, *cells_and_counts: tuple[int, int, int], code: int = Truth.WALL):
        """Returns in the cells (x, y), spread over heights."""
        points = np.concatenate(
            [
                np.stack([np.full(n, (x + 0.5) * 0.05), np.full(n, (y + 0.5) * 0.05), 0.3 * np.arange(n)], axis=1)
                for x, y, n in cells_and_counts
            ]
        )
        return vote(points, np.full(len(points), code, np.uint8), 25, CUBE_M)

    FACE = np.array([[[0.0, 0.025], [0.5, 0.025]]])

    def test_cells_that_a_segment_runs_through(self):
        assert cells_along(np.array([[0.01, 0.01], [0.11, 0.01]]), 0.05).tolist() == [[0, 0], [1, 0], [2, 0]]
        diagonal = cells_along(np.array([[0.01, 0.0], [0.11, 0.1]]), 0.05).tolist()
        assert diagonal == [[0, 0], [1, 0], [1, 1], [2, 1]]
        assert cells_along(np.array([[-0.01, 0.01], [-0.01, 0.01]]), 0.05).tolist() == [[-1, 0]]
        assert cells_along(np.array([[0.11, 0.01], [0.01, 0.01]]), 0.05).tolist() == [[0, 0], [1, 0], [2, 0]]

    def test_true_cells_need_a_face_and_three_returns_of_walls(self):
        cubes = self.wall_returns((0, 0, 3), (1, 0, 2), (2, 1, 9), (4, 0, 5))
        figures = compare_wall_map(self.FACE, cubes, self.grid())
        np.testing.assert_allclose(figures.true_cells, [[0.025, 0.025], [0.225, 0.025]])
        clutter = self.wall_returns((0, 0, 9), code=Truth.CLUTTER)
        assert len(compare_wall_map(self.FACE, clutter, self.grid()).true_cells) == 0

    def test_precision_recall_and_error_by_hand(self):
        cubes = self.wall_returns((0, 0, 3), (9, 0, 3))
        # Centres: (0.025, 0.025) on the face, (0.025, 0.075) 5 cm off, (0.025, 0.325) 30 cm off.
        figures = compare_wall_map(self.FACE, cubes, self.grid((20, 20), (21, 20), (26, 20)))
        assert figures.precision == pytest.approx(2 / 3)
        assert figures.recall == pytest.approx(1 / 2)
        assert figures.error_m == pytest.approx(0.025)

    def test_ten_centimetres_are_still_right(self):
        figures = compare_wall_map(self.FACE, self.wall_returns((0, 0, 3)), self.grid((22, 20)))
        assert (figures.precision, figures.recall) == (1, 1)

    def test_empty_map_empty_truth(self):
        cubes = self.wall_returns((0, 0, 3))
        figures = compare_wall_map(self.FACE, cubes, self.grid())
        assert np.isnan(figures.precision)
        assert figures.recall == 0
        figures = compare_wall_map(np.zeros((0, 2, 2)), cubes, self.grid((20, 20)))
        assert figures.precision == 0
        assert np.isnan([figures.recall, figures.error_m]).all()


def curve(count: int = 200) -> Trajectory:
    """A drive of some 12 m with turns, sway and 0.1 s between poses."""
    t = np.linspace(0, 20, count)
    positions = np.stack([0.5 * t, 2 * np.sin(0.4 * t), 0.02 * np.sin(t)], axis=1)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_euler("zyx", np.stack([0.8 * np.cos(0.4 * t), 0.02 * t, 0.01 * t], axis=1)).as_matrix()
    T[:, :3, 3] = positions
    return Trajectory((t * 1e9).astype(np.int64), T)


class TestTrajectory:
    def test_a_moved_trajectory_is_right_once_aligned(self):
        T_new_map = transforms.make_transform(Rotation.from_euler("zyx", [0.7, 0.1, -0.2]), [3.0, -4.0, 0.0])
        figures = compare_trajectories(curve().moved(T_new_map), curve())
        np.testing.assert_allclose(figures.error_m, 0, atol=1e-9)
        np.testing.assert_allclose(figures.rotation_error_deg, 0, atol=1e-5)
        np.testing.assert_allclose(figures.relative_translation_m, 0, atol=1e-9)
        assert figures.error_unaligned_m.min() > 1

    def test_known_shifts(self):
        true = curve()
        T = true.T_map_base.copy()
        T[::2, 2, 3] += 0.01
        T[1::2, 2, 3] -= 0.01
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        assert figures.ate_rmse_m == pytest.approx(0.01, rel=1e-3)
        np.testing.assert_allclose(figures.error_unaligned_m, 0.01)

    def test_scale_is_not_aligned_away(self):
        true = curve()
        T = true.T_map_base.copy()
        T[:, :3, 3] *= 1.01
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        assert figures.ate_rmse_m > 0.02
        assert figures.relative_translation_m.mean() == pytest.approx(0.01, rel=0.1)

    def test_rotation_by_hand(self):
        true = curve()
        T = true.T_map_base.copy()
        T[::2, :3, :3] = Rotation.from_euler("z", 2, degrees=True).as_matrix() @ T[::2, :3, :3]
        figures = compare_trajectories(Trajectory(true.stamp_ns, T), true)
        np.testing.assert_allclose(figures.rotation_error_deg, 1.0, atol=1e-6)

    def test_only_what_the_truth_covers_and_between_its_poses(self):
        true = curve()
        early = Trajectory(true.stamp_ns - 5_000_000_000, true.T_map_base)
        assert compare_trajectories(early, true).poses == np.count_nonzero(true.covers(early.stamp_ns))
        finer = Trajectory(np.arange(0, 20_000_000_000, 70_000_000), true.at(np.arange(0, 20_000_000_000, 70_000_000)))
        assert compare_trajectories(finer, true).ate_rmse_m < 1e-9

    def test_no_common_time(self):
        true = curve()
        figures = compare_trajectories(Trajectory(true.stamp_ns + 10**12, true.T_map_base), true)
        assert figures.poses == 0
        assert np.isnan(figures.ate_rmse_m)

    def test_standing_still_has_no_relative_error(self):
        T = np.tile(np.eye(4), (5, 1, 1))
        figures = compare_trajectories(Trajectory(np.arange(5), T), Trajectory(np.arange(5), T))
        assert (figures.poses, len(figures.relative_translation_m)) == (5, 0)
        assert figures.ate_rmse_m == pytest.approx(0)

    def test_alignment_recovers_a_known_motion_and_never_mirrors(self):
        generator = np.random.default_rng(0)
        source = generator.normal(size=(50, 3))
        T = transforms.make_transform(Rotation.from_euler("zyx", [1, -0.4, 2.5]), [1, 2, 3])
        np.testing.assert_allclose(align(source, transforms.apply(T, source)), T, atol=1e-9)
        mirrored = align(source, source * [1, 1, -1])
        assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1)


def test_verdicts_agree_with_the_figures() -> None:
    wrong_by_truth = {
        Truth.WALL: {Label.CLUTTER: Verdict.MISSED_WALL, Label.DOOR: Verdict.MISSED_WALL},
        Truth.DOOR: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.MISSED_DOOR},
        Truth.FLOOR: {Label.DOOR: Verdict.FALSE_DOOR, Label.CEILING: Verdict.OTHER},
        Truth.OPEN_LEAF: {Label.WALL: Verdict.FALSE_WALL, Label.CLUTTER: Verdict.RIGHT, Label.DOOR: Verdict.RIGHT},
        Truth.GLASS: dict.fromkeys(Label, Verdict.RIGHT),
        Truth.OUTSIDE: {Label.CLUTTER: Verdict.RIGHT, Label.WALL: Verdict.FALSE_WALL},
        Truth.PERSON: {Label.OUTSIDE: Verdict.RIGHT, Label.WALL: Verdict.FALSE_WALL},
    }
    for truth, expected in wrong_by_truth.items():
        for label, verdict in expected.items():
            assert verdicts(np.array([truth], np.uint8), np.array([label], np.uint8))[0] == verdict, (truth, label)
    own = np.arange(len(Label), dtype=np.uint8)
    assert not verdicts(own, own).any()
    # A return without a label is missed; one whose truth is unknown counts nowhere.
    assert verdicts(np.array([3, 255], np.uint8), np.array([255, 3], np.uint8)).tolist() == [Verdict.MISSED_WALL, 0]
