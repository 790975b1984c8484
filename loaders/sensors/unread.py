"""Compressed clouds, and packets without a decoder: topics that are not read, with the fix."""

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


class CompressedPointCloud2(Sensor):
    """Compressed clouds, which are not read."""

    def matches(self, topic: Topic) -> bool:
        return topic.msgtype.rpartition("/")[2] == "CompressedPointCloud2"

    def unread_reason(self, bag: Bag, topic: Topic) -> str:
        """Name the command that decompresses: point_cloud_transport appends its name to topics."""
        base, _, transport = topic.name.rpartition("/")
        base = base or "/points"
        command = f"rosrun point_cloud_transport republish {transport} in:={base} raw out:={base}"
        if bag.ros_version == 2:
            command = (
                "ros2 run point_cloud_transport republish --ros-args "
                f"-p in_transport:={transport} -p out_transport:=raw "
                f"--remap in/{transport}:={topic.name} --remap out:={base}"
            )
        return (
            f"{topic.name}: compressed clouds ({topic.msgtype}) are not read; play the bag with "
            f"`{command}` and record {base} beside the other topics"
        )
