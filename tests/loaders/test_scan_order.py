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


def pairs(*indices: CloudIndex) -> list[tuple[int, int]]:
    order = ScanOrder.of(indices)
    return list(zip(order.lidar.tolist(), order.cloud.tolist(), strict=True))


A, B = index("/a", [5, 25, 30, 45]), index("/b", [10, 20, 40])


def test_scans_are_in_the_order_of_stamps_then_topics() -> None:
    assert pairs(B, A) == [(1, 0), (0, 0), (0, 1), (1, 1), (1, 2), (0, 2), (1, 3)]
    assert ScanOrder.of([B, A]).stamp_ns.tolist() == [5, 10, 20, 25, 30, 40, 45]
    a, b = index("/a", [10, 20]), index("/b", [10, 20])
    assert pairs(a, b) == [(0, 0), (1, 0), (0, 1), (1, 1)]
    assert pairs(b, a) == [(1, 0), (0, 0), (1, 1), (0, 1)]


def test_a_wrong_stamp_moves_no_cloud() -> None:
    # A first cloud stamped 0, and one a day ahead.
    wrong = index("/a", [0, 10, 86_400_000, 30], unusable=(0, 2))
    assert pairs(wrong) == [(0, 0), (0, 1), (0, 2), (0, 3)]
    both = pairs(wrong, index("/b", [5, 20]))
    assert both == [(1, 0), (0, 0), (0, 1), (0, 2), (1, 1), (0, 3)]
    none = index("/a", [7, 7], unusable=(0, 1))
    assert pairs(none, index("/b", [8])) == [(0, 0), (0, 1), (1, 0)]
    assert pairs(index("/a", [])) == []


@pytest.mark.parametrize(("first", "count"), [(0, None), (2, 3), (3, 1), (5, 20), (7, None)])
def test_each_scan_is_read_once_in_order(first: int, count: int | None) -> None:
    unread = {(1, 2)}

    def read(lidar: int, start: int, clouds: int) -> Iterator[tuple[int, str]]:
        own = range(start, start + clouds)
        return iter([(cloud, f"{lidar}:{cloud}") for cloud in own if (lidar, cloud) not in unread])

    scans = list(enumerate(pairs(B, A)))[first : None if count is None else first + count]
    found = list(ScanOrder.of([B, A]).read(first, count, read))
    assert found == [(i, own[0], f"{own[0]}:{own[1]}") for i, own in scans if own not in unread]
