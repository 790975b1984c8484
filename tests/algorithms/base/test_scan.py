"""What of a scan is used."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base.scan import within_range
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
