"""The order of returns about the spin axis, however a lidar spins and its driver arranges them."""

import numpy as np
import pytest

from ffmap.algorithms.base.rings import RingOrder, sort_by_angle


def expected(group: np.ndarray, angle: np.ndarray, groups: int) -> tuple[np.ndarray, np.ndarray]:
    order = np.lexsort((np.arange(len(group)), angle, group))
    return order, np.searchsorted(group[order], np.arange(groups + 1))


def check(group: np.ndarray, angle: np.ndarray, groups: int) -> None:
    order, starts = sort_by_angle(group.astype(np.int32), angle.astype(np.float32), groups)
    wanted, wanted_starts = expected(group, angle.astype(np.float32), groups)
    np.testing.assert_array_equal(order, wanted)
    np.testing.assert_array_equal(starts, wanted_starts)


@pytest.mark.parametrize("way", [1, -1], ids=["with the angle", "against it"])
@pytest.mark.parametrize("begin", [0, 1, 17, 99])
def test_rings_that_go_round_once_are_turned_about_and_begun_at_the_lowest(way: int, begin: int) -> None:
    turn = np.roll(np.linspace(-np.pi, np.pi, 100, endpoint=False)[::way], begin)
    angle = np.concatenate([turn + 0.001 * ring for ring in range(4)])
    group = np.repeat(np.arange(4), 100)
    check(group, angle, 4)
    in_turns = np.arange(400).reshape(4, 100).T.ravel()  # emitter after emitter, as they fire
    check(group[in_turns], angle[in_turns], 4)


@pytest.mark.parametrize("seed", range(4))
def test_any_order_is_sorted(seed: int) -> None:
    random = np.random.default_rng(seed)
    group, angle = random.integers(0, 5, 300), random.uniform(-3, 3, 300)
    check(group, angle, 7)  # two have no return
    check(group, np.round(angle), 7)  # many have the same angle
    check(np.sort(group), np.zeros(300), 7)


def test_none_and_one() -> None:
    check(np.zeros(0, int), np.zeros(0), 3)
    check(np.array([2]), np.array([0.5]), 3)


def test_the_rank_of_a_return_is_its_place_among_the_rings() -> None:
    random = np.random.default_rng(3)
    points, ring = random.normal(size=(400, 3)).astype(np.float32), random.integers(0, 4, 400).astype(np.uint16)
    rings = RingOrder.of(points, ring, 4)
    np.testing.assert_array_equal(rings.order[rings.rank], np.arange(400))
    np.testing.assert_allclose(rings.turn_rad, np.arctan2(points[:, 1], points[:, 0])[rings.order], atol=2e-5)
    for r in range(4):
        assert np.all(ring[rings.order[rings.starts[r] : rings.starts[r + 1]]] == r)
        assert np.all(np.diff(rings.turn_rad[rings.starts[r] : rings.starts[r + 1]]) >= 0)
