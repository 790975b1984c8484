"""PointCloud2 of any maker's driver, and compressed clouds."""

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
