"""Raw packets that are not read, by the types of their messages: what to say of a topic that holds them."""

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
    """Topics of raw packets that are not read: why not, and what to do, one line each."""
    found = {topic.name: _reason(bag, topic) for topic in bag.topics.values() if topic.count}
    return {name: reason for name, reason in found.items() if reason is not None}


def _reason(bag: Bag, topic: Topic) -> str | None:
    if maker := UNREAD_TYPES.get(topic.msgtype):
        return f"{topic.name}: {maker}'s raw packets ({topic.msgtype}) are not read; record the driver's PointCloud2"
    return ouster.unread_reason(bag, topic.name) if ouster.is_lidars(topic) else None
