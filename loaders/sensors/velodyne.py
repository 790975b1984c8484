"""Raw Velodyne packets (velodyne_msgs/VelodyneScan, a message a revolution)."""

from importlib.util import find_spec
from types import MappingProxyType

import numpy as np

from ffmap.loaders.bag import Bag, Message, RawMessage, Topic
from ffmap.loaders.errors import CloudError
from ffmap.loaders.pointcloud2 import make_cloud
from ffmap.loaders.sensors.sensor import Sensor

VELODYNE_POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<u2"),
        ("time", "<f4"),
    ]
)
"""A point in the layout of the Velodyne driver."""
# Added to the packets' times: for the decoder, a stamp of 0 is a missing one.
_ANY_TIME_S = 1000.0


class Velodyne(Sensor):
    """Packets as the Velodyne driver publishes them."""

    messages = "packets of a Velodyne"
    msgtypes = ("velodyne_msgs/msg/VelodyneScan",)
    definitions = MappingProxyType(
        {
            "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
            "velodyne_msgs/msg/VelodyneScan": (
                "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"
            ),
        }
    )

    def unread_reason(self, bag: Bag, topic: Topic) -> str | None:
        if find_spec("velodyne_decoder") is None:
            return (
                f"{topic.name}: a Velodyne's raw packets require velodyne-decoder, which is not "
                "installed: pip install velodyne-decoder; or record the driver's PointCloud2"
            )
        return None

    def decode(self, bag: Bag, raw: RawMessage) -> Message:
        """Make a PointCloud2 of one message, `time` in seconds from its stamp.

        Raises CloudError where velodyne-decoder does not know the sensor.
        """
        import velodyne_decoder  # Slow, and few bags have packets

        scan = bag.deserialize(raw)
        stamp = scan.header.stamp
        packets = velodyne_decoder.PacketVector()
        for packet in scan.packets:
            nanoseconds = int(packet.stamp.nanosec) - int(stamp.nanosec)
            since_s = (packet.stamp.sec - stamp.sec) + 1e-9 * nanoseconds
            data = packet.data.tolist()
            packets.append(velodyne_decoder.VelodynePacket(_ANY_TIME_S + since_s, data))
        points = np.zeros(0, VELODYNE_POINT)
        if len(scan.packets):
            decoder = velodyne_decoder.ScanDecoder(
                velodyne_decoder.Config(timestamp_first_packet=True)
            )
            try:
                start, decoded = decoder.decode(packets, as_pcl_structs=True)
            except (RuntimeError, ValueError, IndexError) as error:
                raise CloudError(
                    f"{raw.topic}: the packets cannot be decoded ({error}); decode them with the "
                    "sensor's own driver and record its PointCloud2"
                ) from error
            points = np.zeros(len(decoded), VELODYNE_POINT)
            names = ["x", "y", "z", "intensity", "ring"]
            points[names] = decoded[names]
            points["time"] = decoded["time"] + np.float32(float(start.host) - _ANY_TIME_S)
        return make_cloud(bag.typestore, scan.header, points[None])
