"""Raw packets that are not read: the topic is named, and what to do."""

import os
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ffmap.app.commands.info import describe
from ffmap.loaders.sensors import velodyne
from ffmap.loaders.sensors.unread import UNREAD_TYPES
from tests.loaders.bag_builder import CLOUD, PERIOD_NS, START_NS, cloud, sweep
from tests.program import ffmap_here


def bag_of(path: Path, msgtype: str, with_clouds: bool = False, topic: str = "/packets") -> Path:
    """A bag with a few packets on a topic, and clouds on /points."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint8[] data", msgtype))
    packet = store.types[msgtype](np.zeros(100, np.uint8))
    with Writer(path) as writer:
        packets = writer.add_connection(topic, msgtype, typestore=store)
        points = writer.add_connection("/points", CLOUD, typestore=store) if with_clouds else None
        for i in range(3):
            writer.write(
                packets, START_NS + i * PERIOD_NS, bytes(store.serialize_ros1(packet, msgtype))
            )
            if points:
                made = cloud(sweep(seed=i), START_NS + i * PERIOD_NS)
                writer.write(
                    points, START_NS + i * PERIOD_NS, bytes(store.serialize_ros1(made, CLOUD))
                )
    return path


def test_a_bag_of_nothing_else_is_refused_in_a_line(tmp_path: Path) -> None:
    msgtype = "hesai_ros_driver/msg/UdpFrame"
    path = bag_of(tmp_path / "a.bag", msgtype)
    told = ffmap_here(dict(os.environ), "run", path, "--out", tmp_path / "run")
    assert (told.returncode, told.stdout) == (2, "")
    (line,) = told.stderr.splitlines()
    assert f"/packets: {UNREAD_TYPES[msgtype]}'s raw packets ({msgtype}) are not read" in line
    assert "record the driver's PointCloud2" in line
    shown = ffmap_here(dict(os.environ), "info", path)
    assert shown.returncode == 0
    assert f"/packets: {UNREAD_TYPES[msgtype]}'s raw packets" in shown.stdout


@pytest.mark.parametrize("msgtype", UNREAD_TYPES)
def test_beside_clouds_they_are_warned_of(tmp_path: Path, msgtype: str) -> None:
    lines = describe(bag_of(tmp_path / "a.bag", msgtype, with_clouds=True))
    assert [line for line in lines if line.startswith("lidar ")] == ["lidar /points"]
    assert "  horizontal: /points (the only lidar)" in lines
    assert sum(line.startswith("  /packets: ") for line in lines) == 1


def test_compressed_clouds_are_named_with_what_decompresses_them(tmp_path: Path) -> None:
    msgtype = "draco_point_cloud_transport/msg/CompressedPointCloud2"
    lines = describe(bag_of(tmp_path / "a.bag", msgtype, topic="/side/points/draco"))
    (problem,) = (line for line in lines if line.startswith("  not found: "))
    assert f"/side/points/draco: compressed clouds ({msgtype}) are not read" in problem
    command = "rosrun point_cloud_transport republish draco in:=/side/points raw out:=/side/points"
    assert f"`{command}` and record /side/points" in problem


def test_packets_whose_decoder_is_not_installed_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(velodyne, "find_spec", lambda name: None)
    lines = describe(bag_of(tmp_path / "a.bag", "velodyne_msgs/msg/VelodyneScan"))
    (problem,) = (line for line in lines if line.startswith("  not found: "))
    assert "/packets: a Velodyne's raw packets require velodyne-decoder" in problem
    assert "pip install velodyne-decoder" in problem
