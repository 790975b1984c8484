"""Livox's own clouds, as both drivers write them, with ROS 1 and ROS 2."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.scan import Scan
from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.scans import SkippedScan, read_messages, read_scans
from ffmap.loaders.sensors.livox import LIVOX_POINT, livox_message
from tests.loaders.bag_builder import PERIOD_NS, START_NS, header, write_bag

POINTS = 3000
LINES = 4


def points(i: int) -> np.ndarray:
    rng = np.random.default_rng(i)
    made = np.zeros(POINTS, LIVOX_POINT)
    made["offset_time"] = np.linspace(0, 99_000_000, POINTS)
    azimuth = np.linspace(0, 2 * np.pi, POINTS)
    made["line"] = np.arange(POINTS) % LINES
    made["x"], made["y"] = 5 * np.cos(azimuth), 5 * np.sin(azimuth)
    made["z"] = made["line"] + rng.uniform(0, 0.01, POINTS)
    made["reflectivity"], made["tag"] = rng.integers(0, 256, POINTS), 16
    return made


def message(i: int, driver: str, ros_version: int, frame: str) -> Any:
    types = make_typestore(ros_version).types
    stamp_ns = START_NS + i * PERIOD_NS
    own = [types[f"{driver}/msg/CustomPoint"](*(v.item() for v in row)) for row in points(i)]
    return types[f"{driver}/msg/CustomMsg"](
        header(types, stamp_ns, frame), stamp_ns, POINTS, 7, np.zeros(3, np.uint8), own
    )


# Frames of several lengths: what follows is aligned in ROS 2.
@pytest.mark.parametrize(
    ("name", "driver", "frame"),
    [
        ("a.bag", "livox_ros_driver", "livox_frame"),
        ("a_mcap", "livox_ros_driver2", "lidar"),
        ("b_mcap", "livox_ros_driver2", "livox_frame"),
        ("c_mcap", "livox_ros_driver2", ""),
    ],
)
def test_points_times_and_lines_are_recovered(
    tmp_path: Path, name: str, driver: str, frame: str
) -> None:
    version = 1 if name.endswith(".bag") else 2
    entries = [
        ("/livox/lidar", START_NS + (i + 1) * PERIOD_NS, message(i, driver, version, frame))
        for i in range(3)
    ]
    with open_bag(write_bag(tmp_path / name, entries)) as bag:
        rig = find_rig(bag, verticals=["/livox/lidar"])
        lidar = rig.vertical
        assert lidar is not None
        assert (lidar.frame_id, lidar.ring_count) == (frame, LINES)
        assert lidar.decoding.time is not None
        assert (lidar.decoding.time.name, lidar.decoding.time.unit) == ("offset_time", "ns")
        index = index_clouds(bag, "/livox/lidar")
        read = list(read_scans(bag, index, 0, None, lidar.decoding))
        messages = list(read_messages(bag, index, 0))
    assert len(read) == 3
    for (i, scan), (_, made) in zip(read, messages, strict=True):
        assert isinstance(scan, Scan)
        known = points(i)[np.asarray(scan.cloud_index)]
        assert len(scan) == POINTS
        np.testing.assert_array_equal(scan.points_sensor, np.c_[known["x"], known["y"], known["z"]])
        np.testing.assert_array_equal(scan.time_ns, known["offset_time"])
        np.testing.assert_array_equal(scan.ring, known["line"])
        assert scan.start_ns == scan.stamp_ns == START_NS + i * PERIOD_NS
        assert tuple(f.name for f in made.fields) == LIVOX_POINT.names


def test_a_message_that_holds_fewer_points_than_it_says_is_skipped(tmp_path: Path) -> None:
    store = make_typestore(1)
    entries = [
        ("/livox/lidar", START_NS + i * PERIOD_NS, message(i, "livox_ros_driver", 1, "livox"))
        for i in range(3)
    ]
    path = write_bag(tmp_path / "a.bag", entries)
    whole = bytes(store.serialize_ros1(entries[1][2], "livox_ros_driver/msg/CustomMsg"))
    # The number of points lies behind header, time base, number and identity.
    count_at = 16 + len("livox") + 16
    raw = path.read_bytes()
    assert raw.count(whole) == 1
    count = (POINTS + 5).to_bytes(4, "little")
    path.write_bytes(raw.replace(whole, whole[:count_at] + count + whole[count_at + 4 :]))
    with open_bag(path) as bag:
        decoding = find_rig(bag).horizontal.decoding  # type: ignore[union-attr]
        index = index_clouds(bag, "/livox/lidar")
        read = [scan for _, scan in read_scans(bag, index, 0, None, decoding)]
    assert [isinstance(scan, SkippedScan) for scan in read] == [False, True, False]
    assert "contains fewer" in read[1].reason  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("version", "frame", "count"),
    [(1, "lidar", 1), (1, "", 0), (2, "lidar", 2), (2, "livox_frame", 1), (2, "", 0)],
)
def test_a_message_is_made_as_the_driver_makes_it(version: int, frame: str, count: int) -> None:
    store = make_typestore(version)
    made = livox_message(version == 1, START_NS, frame, points(0)[:count])
    known = message(0, "livox_ros_driver2", version, frame)
    read = (store.deserialize_ros1 if version == 1 else store.deserialize_cdr)(
        made.data, made.__msgtype__
    )
    assert read.header == known.header
    assert (read.timebase, read.point_num, len(read.points)) == (START_NS, count, count)
    assert read.points == known.points[:count]
