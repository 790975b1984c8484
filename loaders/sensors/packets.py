"""Raw packets that are not read, by the types of their messages."""

from collections.abc import Mapping

from ffmap.loaders.bag import Bag, Topic
from ffmap.loaders.sensors.sensor import Sensor

UNREAD_TYPES: Mapping[str, str] = {
    "hesai_lidar/msg/PandarScan": "Hesai",
    "hesai_ros_driver/msg/UdpFrame": "Hesai",
    "pandar_msgs/msg/PandarScan": "Hesai",
    "rslidar_msg/msg/RslidarPacket": "RoboSense",
    "rslidar_msg/msg/RslidarScan": "RoboSense",
    "rslidar_msgs/msg/rslidarPacket": "RoboSense",
    "rslidar_msgs/msg/rslidarScan": "RoboSense",
}
"""Makers without a decoder for every model's points and their times."""


class UnreadPackets(Sensor):
    """Packets without a decoder."""

    msgtypes = tuple(UNREAD_TYPES)

    def unread_reason(self, bag: Bag, topic: Topic) -> str:
        maker = UNREAD_TYPES[topic.msgtype]
        what = f"{maker}'s raw packets ({topic.msgtype}) are not read"
        return f"{topic.name}: {what}; record the driver's PointCloud2"
