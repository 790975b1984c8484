"""The robot's own body is found in a bag and removed from its scans."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.app.commands.info import describe
from ffmap.app.run.odometry import cache_key
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.scans import read_scans
from tests.algorithms.base.test_own_body import ACROSS, T_BASE_SENSOR, clouds
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, point_dtype, tf_message, write_bag


def test_scans_lack_the_robots_own_body(tmp_path: Path) -> None:
    points, own = clouds(False, ACROSS, "plate")
    edge = (
        "base",
        "lidar",
        T_BASE_SENSOR[:3, 3],
        Rotation.from_matrix(T_BASE_SENSOR[:3, :3]).as_quat(),
    )
    entries = [("/tf_static", START_NS, tf_message([edge]))]
    for i, xyz in enumerate(points):
        # Ring by ring, from the lowest.
        organised = np.zeros(
            (16, len(xyz) // 16), point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4")])
        )
        for axis, values in zip("xyz", xyz.T, strict=True):
            organised[axis] = values.reshape(organised.shape)
        stamp_ns = START_NS + i * PERIOD_NS
        entries.append(("/points", stamp_ns, cloud(organised, stamp_ns)))
    bag = write_bag(tmp_path / "a.bag", entries)
    inputs, as_seen = (find_inputs(bag, RunOptions(), own_body=held) for held in (True, False))
    (warning,) = (text for text in inputs.warnings if "sees the robot itself" in text)
    assert warning.startswith("/points sees the robot itself: ")
    assert warning.endswith(" in base; --set scan.own_body=false keeps them")
    assert f"  {warning}" in describe(bag)
    assert not any("sees the robot" in text for text in as_seen.warnings)
    sensor, other = inputs.horizontal, as_seen.horizontal
    assert sensor is not None
    assert other is not None
    with open_bag(bag) as opened:
        for number, scan in read_scans(opened, sensor.index, 0, None, sensor.lidar.decoding):
            left = own[number][scan.cloud_index]
            assert np.count_nonzero(left) < 0.02 * np.count_nonzero(own[number])
            assert len(scan) > 0.97 * np.count_nonzero(~own[number])
        _, whole = next(read_scans(opened, other.index, 0, 1, other.lidar.decoding))
        assert len(whole) == len(points[0])
    # Poses by other returns are other poses.
    assert cache_key(inputs, sensor, Settings()) != cache_key(as_seen, other, Settings())
