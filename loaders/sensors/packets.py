"""Raw packets and compressed clouds that are not read, by the types of their messages: why not, and what to do."""

from collections.abc import Mapping

from ffmap.loaders import ouster
from ffmap.loaders.bag import Bag, Topic

UNREAD_TYPES: Mapping[str, str] = {
    "hesai_lidar/msg/PandarScan": "Hesai",
    "hesai_ros_driver/msg/UdpFrame": "Hesai",
    "pandar_msgs/msg/PandarScan": "Hesai",
    "rslidar_msg/msg/RslidarPacket": "RoboSense",
    "rslidar_msg/msg/RslidarScan": "RoboSense",
    "rslidar_msgs/msg/rslidarPacket": "RoboSense",
    "rslidar_msgs/msg/rslidarScan": "RoboSense",
}
"""Whose they are: of these makers there is no decoder that gives every model's points and their times."""


def unread_packets(bag: Bag) -> dict[str, str]:
    """Topics of raw packets or compressed clouds that are not read: why not, and what to do, one line each."""
    found = {topic.name: _reason(bag, topic) for topic in bag.topics.values() if topic.count}
    return {name: reason for name, reason in found.items() if reason is not None}


def _reason(bag: Bag, topic: Topic) -> str | None:
    if maker := UNREAD_TYPES.get(topic.msgtype):
        return f"{topic.name}: {maker}'s raw packets ({topic.msgtype}) are not read; record the driver's PointCloud2"
    if topic.msgtype.rpartition("/")[2] == "CompressedPointCloud2":
        return _compressed(bag, topic)
    return ouster.unread_reason(bag, topic.name) if ouster.is_lidars(topic) else None


def _compressed(bag: Bag, topic: Topic) -> str:
    """How to decompress it: point_cloud_transport publishes /points as /points/draco."""
    base, _, transport = topic.name.rpartition("/")
    base = base or "/points"
    command = f"rosrun point_cloud_transport republish {transport} in:={base} raw out:={base}"
    if bag.ros_version == 2:
        command = (
            f"ros2 run point_cloud_transport republish --ros-args -p in_transport:={transport} -p out_transport:=raw "
            f"--remap in/{transport}:={topic.name} --remap out:={base}"
        )
    what = f"{topic.name}: compressed clouds ({topic.msgtype}) are not read"
    return f"{what}; play the bag with `{command}` and record {base} beside the other topics"
