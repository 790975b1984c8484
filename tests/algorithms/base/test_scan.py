"""Which returns of a scan are used, and in which order."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.scan import in_canonical_order, within_range
from tests import synthetic


def test_far_returns_are_removed_from_all_arrays() -> None:
    scan = synthetic.scan()
    assert within_range(scan, 100.0) is scan
    points = scan.points_sensor.copy()
    points[[3, 70]] = [[0, 0, 101.0], [3.4e38, 3.4e38, 0]]
    far = replace(scan, points_sensor=points, time_ns=np.arange(len(points), dtype=np.int64))
    near = within_range(far, 100.0)
    rest = np.delete(np.arange(len(points)), [3, 70])
    np.testing.assert_array_equal(near.points_sensor, points[rest])
    np.testing.assert_array_equal(near.ring, scan.ring[rest])
    np.testing.assert_array_equal(near.time_ns, rest)
    np.testing.assert_array_equal(near.cloud_index, scan.cloud_index[rest])
    assert (near.cloud_size, near.ring_count) == (scan.cloud_size, scan.ring_count)


@pytest.mark.parametrize("together", [False, True], ids=["one by one", "together"])
def test_a_cloud_as_its_lidar_writes_it_is_in_canonical_order(together: bool) -> None:
    """Firing by firing where emitters fire one by one, else by the rows of an organised cloud."""
    scan = synthetic.scan(firings=50)
    firing, ring = np.divmod(np.arange(len(scan)), synthetic.RINGS)
    timed = replace(scan, time_ns=firing * 50_000 + (0 if together else ring * 1_000))
    rows = np.lexsort((firing, -ring)) if together else np.arange(len(scan))
    points, rings, times = scan.points_sensor[rows], scan.ring[rows], timed.time_ns[rows]
    written = replace(timed, points_sensor=points, ring=rings, time_ns=times)
    assert in_canonical_order(written) is written
    np.testing.assert_array_equal(in_canonical_order(timed).points_sensor, written.points_sensor)


@pytest.mark.parametrize("count", [0, 1, 400])
def test_the_rings_of_a_scan_are_sorted_by_azimuth(count: int) -> None:
    random = np.random.default_rng(3)
    points = random.normal(size=(count, 3)).astype(np.float32)
    ring = random.integers(0, 4, count).astype(np.uint16)
    scan = replace(synthetic.scan(), points_sensor=points, ring=ring, ring_count=6)
    rings, azimuth = scan.rings, np.arctan2(points[:, 1], points[:, 0])
    np.testing.assert_array_equal(rings.order[rings.rank], np.arange(count))
    np.testing.assert_array_equal(rings.turn_rad, azimuth[rings.order])
    assert rings.starts[-1] == count
    for r in range(6):
        own = slice(rings.starts[r], rings.starts[r + 1])
        assert np.all(ring[rings.order[own]] == r)
        assert np.all(np.diff(rings.turn_rad[own]) >= 0)
