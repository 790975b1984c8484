"""Which doors were passed, found and invented, against answers by hand."""

import numpy as np
import pytest

from ffmap.algorithms.truth.doors import DoorComparison, FoundDoors, TrueDoors, compare_doors
from ffmap.algorithms.truth.tally import Tally

WALL = np.full(1, 3, np.uint8)


def doors(
    *midpoints: tuple[float, float], turn_deg: float = 0.0, width_m: float = 0.9, leaf: bool = False
) -> TrueDoors:
    half = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))]) * width_m / 2
    ends = np.array([[np.array(m) - half, np.array(m) + half] for m in midpoints])
    leaves = tuple(e[None] if leaf else np.zeros((0, 2, 2)) for e in ends)
    count = len(midpoints)
    return TrueDoors(ends.reshape(-1, 2, 2), np.full(count, 2.0), leaves, np.zeros(count, np.uint8))


def compare(
    true: TrueDoors,
    *midpoints: tuple[float, float],
    turn_deg: float = 0.0,
    width_m: float = 0.9,
    state: int = 0,
    returns: tuple[int, ...] | None = None,
) -> DoorComparison:
    """Compare with detections at these midpoints."""
    ends, count = doors(*midpoints, turn_deg=turn_deg, width_m=width_m).ends, len(midpoints)
    found = FoundDoors(ends, np.full(count, width_m), np.full(count, state, np.uint8))
    return compare_doors(true, np.array(returns or [500] * len(true)), found)


def near(point: tuple[float, ...], origin: tuple[float, ...], true: TrueDoors) -> list[int]:
    tally = Tally(true)
    tally.add(np.array([point]), np.array(origin), WALL, WALL, WALL)
    return tally.door_returns.tolist()


@pytest.mark.parametrize(
    ("point", "leaf", "expected"),
    [
        ((0.45, 0.29, 1.0), False, 1),  # beside a jamb
        ((0.45, 0.31, 1.0), False, 0),
        ((0.45 + 0.22, 0.22, 1.0), False, 0),  # 0.31 m from it, aslant
        ((0.0, 0.0, 2.29), False, 1),  # above the lintel's underside
        ((0.0, 0.0, 2.31), False, 0),
        ((0.0, 0.0, 1.0), False, 0),  # in the middle of the opening
        ((0.0, 0.29, 1.0), True, 1),  # before the leaf
        ((0.0, 0.31, 1.0), True, 0),
    ],
)
def test_returns_near_frame_and_leaf(point: tuple[float, ...], leaf: bool, expected: int) -> None:
    assert near(point, (0.0, -2.0, 1.0), doors((0, 0), leaf=leaf)) == [expected]


def test_returns_count_from_within_six_metres_once_for_each_door() -> None:
    assert near((0.45, 0.0, 1.0), (0.45, -5.99, 1.0), doors((0, 0))) == [1]
    assert near((0.45, 0.0, 1.0), (0.45, -6.01, 1.0), doors((0, 0))) == [0]
    assert near((0.5, 0.0, 1.0), (0.5, -1.0, 1.0), doors((0, 0), (1.0, 0), leaf=True)) == [1, 1]
    assert compare(doors((0, 0), (5, 0)), returns=(200, 199)).passed.tolist() == [True, False]


@pytest.mark.parametrize(
    ("true", "midpoints", "turn_deg", "match"),
    [
        (((0, 0), (5, 0), (10, 0)), ((0.1, 0), (5, 0.2), (20, 0)), 0.0, [0, 1, -1]),
        (((0, 0),), ((0.299, 0),), 0.0, [0]),
        (((0, 0),), ((0.301, 0),), 0.0, [-1]),
        (((0, 0),), ((0, 0),), 14.9, [0]),
        (((0, 0),), ((0, 0),), 15.1, [-1]),
        # The second detection is nearest to the first door; the first takes the other one.
        (((0, 0), (0.2, 0)), ((0.15, 0), (0.01, 0)), 0.0, [1, 0]),
        (((0, 0),), (), 0.0, [-1]),
        ((), ((0, 0),), 0.0, []),
    ],
)
def test_matches_are_one_to_one_and_nearest_first(
    true: tuple, midpoints: tuple, turn_deg: float, match: list[int]
) -> None:
    assert compare(doors(*true), *midpoints, turn_deg=turn_deg).match.tolist() == match


def test_width_and_state_of_doors_that_were_passed_and_found() -> None:
    true = doors((0, 0), (5, 0), (9, 0))
    compared = compare(true, (0, 0), (5, 0), width_m=0.95, state=1, returns=(500, 20, 500))
    np.testing.assert_allclose(compared.width_error_m, [0.05])
    assert compared.state_right.tolist() == [False]
    assert (compared.match.tolist(), compared.detections) == ([0, 1, -1], 2)
