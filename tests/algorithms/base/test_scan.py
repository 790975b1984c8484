"""What of a scan is used."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.scan import in_canonical_order, within_range
from tests import synthetic


def test_returns_that_are_too_far_away_are_left_out_with_all_that_belongs_to_them() -> None:
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
def test_a_cloud_in_the_order_that_its_lidar_writes_stays_as_it_is(together: bool) -> None:
    """Firing by firing where the emitters fire one by one, else as an organised cloud's rows are: from the top."""
    scan = synthetic.scan(firings=50)
    firing, ring = np.divmod(np.arange(len(scan)), synthetic.RINGS)
    timed = replace(scan, time_ns=firing * 50_000 + (0 if together else ring * 1_000))
    rows = np.lexsort((firing, -ring)) if together else np.arange(len(scan))
    written = replace(timed, points_sensor=scan.points_sensor[rows], ring=scan.ring[rows], time_ns=timed.time_ns[rows])
    assert in_canonical_order(written) is written
    np.testing.assert_array_equal(in_canonical_order(timed).points_sensor, written.points_sensor)
