"""The clouds of several lidars as one sequence of scans."""

from collections.abc import Iterator

import numpy as np
import pytest

from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.scan_order import ScanOrder


def index(topic: str, stamps: list[int], unusable: tuple[int, ...] = ()) -> CloudIndex:
    stamp_ns = np.array(stamps, np.int64)
    ones = np.ones(len(stamps), np.int64)
    usable = ~np.isin(np.arange(len(stamps)), unusable)
    return CloudIndex(topic, stamp_ns, stamp_ns, ones, 0 * ones, usable)


def pairs(order: ScanOrder) -> list[tuple[int, int]]:
    return list(zip(order.lidar.tolist(), order.cloud.tolist(), strict=True))


def test_scans_come_by_their_stamps_whichever_lidar_they_are_from() -> None:
    order = ScanOrder.of([index("/b", [10, 20, 40]), index("/a", [5, 25, 30, 45])])
    assert pairs(order) == [(1, 0), (0, 0), (0, 1), (1, 1), (1, 2), (0, 2), (1, 3)]
    assert order.stamp_ns.tolist() == [5, 10, 20, 25, 30, 40, 45]


def test_of_equal_stamps_the_name_decides_and_not_which_lidar_is_the_first() -> None:
    a, b = index("/a", [10, 20]), index("/b", [10, 20])
    assert pairs(ScanOrder.of([a, b])) == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert pairs(ScanOrder.of([b, a])) == [(1, 0), (0, 0), (1, 1), (0, 1)]


def test_a_wrong_stamp_moves_no_cloud() -> None:
    # A first cloud stamped 0, and one a day ahead.
    wrong = index("/a", [0, 10, 86_400_000, 30], unusable=(0, 2))
    assert pairs(ScanOrder.of([wrong])) == [(0, 0), (0, 1), (0, 2), (0, 3)]
    assert pairs(ScanOrder.of([wrong, index("/b", [5, 20])])) == [(1, 0), (0, 0), (0, 1), (0, 2), (1, 1), (0, 3)]
    none = index("/a", [7, 7], unusable=(0, 1))
    assert pairs(ScanOrder.of([none, index("/b", [8])])) == [(0, 0), (0, 1), (1, 0)]
    assert len(ScanOrder.of([index("/a", [])])) == 0


@pytest.mark.parametrize(("first", "count"), [(0, None), (2, 3), (3, 1), (5, 20), (7, None)])
def test_each_scan_is_read_once_in_order(first: int, count: int | None) -> None:
    order = ScanOrder.of([index("/b", [10, 20, 40]), index("/a", [5, 25, 30, 45])])
    asked: list[tuple[int, int, int]] = []

    def read(lidar: int, start: int, clouds: int) -> Iterator[tuple[int, str]]:
        asked.append((lidar, start, clouds))
        return iter([(cloud, f"{lidar}:{cloud}") for cloud in range(start, start + clouds)])

    stop = 7 if count is None else min(first + count, 7)
    expected = [(scan, *pairs(order)[scan]) for scan in range(first, stop)]
    found = list(order.read(first, count, read))
    assert found == [(scan, lidar, f"{lidar}:{cloud}") for scan, lidar, cloud in expected]
    # No cloud but those is asked for.
    assert sum(clouds for _, _, clouds in asked) == len(expected)


def test_a_cloud_that_is_not_read_is_left_out() -> None:
    order = ScanOrder.of([index("/a", [10, 30]), index("/b", [20, 40])])
    kept = {0: [(1, "a1")], 1: [(0, "b0"), (1, "b1")]}
    found = list(order.read(0, None, lambda lidar, _first, _count: iter(kept[lidar])))
    assert found == [(1, 1, "b0"), (2, 0, "a1"), (3, 1, "b1")]
