"""Clouds as ROS defines them, of any maker's driver, and what compresses them."""

from ffmap.loaders.bag import Bag, Topic
from ffmap.loaders.pointcloud2 import CLOUD_TYPE
from ffmap.loaders.sensors.sensor import Sensor


class PointCloud2(Sensor):
    """PointCloud2 of any driver: `settle_decoding` finds fields, units and rings by content."""

    messages = "PointCloud2"
    msgtypes = (CLOUD_TYPE,)


class CompressedPointCloud2(Sensor):
    """Compressed clouds, which are not read."""

    def matches(self, topic: Topic) -> bool:
        return topic.msgtype.rpartition("/")[2] == "CompressedPointCloud2"

    def unread_reason(self, bag: Bag, topic: Topic) -> str:
        """How to decompress them: point_cloud_transport publishes /points as /points/draco."""
        base, _, transport = topic.name.rpartition("/")
        base = base or "/points"
        command = f"rosrun point_cloud_transport republish {transport} in:={base} raw out:={base}"
        if bag.ros_version == 2:
            command = (
                f"ros2 run point_cloud_transport republish --ros-args -p in_transport:={transport} "
                f"-p out_transport:=raw --remap in/{transport}:={topic.name} --remap out:={base}"
            )
        what = f"{topic.name}: compressed clouds ({topic.msgtype}) are not read"
        return f"{what}; play the bag with `{command}` and record {base} beside the other topics"
