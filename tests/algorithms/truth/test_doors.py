"""Which doors were passed, found and invented, each against an answer worked out by hand."""

import numpy as np
import pytest

from ffmap.algorithms.truth.doors import FoundDoors, TrueDoors, compare_doors
from ffmap.algorithms.truth.tally import Counter


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
