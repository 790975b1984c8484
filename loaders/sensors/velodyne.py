"""Raw Velodyne packets (velodyne_msgs/VelodyneScan, a message a revolution)."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ffmap.loaders.bag import Bag, Message, RawMessage
from ffmap.loaders.errors import CloudError
from ffmap.loaders.pointcloud2 import make_cloud
from ffmap.loaders.sensors.sensor import Decoder, Sensor

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

    def decoder(self, bag: Bag, topic: str) -> Decoder:
        return VelodyneDecoder(bag, topic).to_cloud


class VelodyneDecoder:
    """Decodes the scans of one sensor, whose model the packets contain."""

    def __init__(self, bag: Bag, topic: str) -> None:
        import velodyne_decoder  # Slow, and few bags have packets

        self._bag, self._topic = bag, topic
        self._velodyne: Any = velodyne_decoder
        config = velodyne_decoder.Config(timestamp_first_packet=True)
        self._decoder: Any = velodyne_decoder.ScanDecoder(config)

    def to_cloud(self, raws: Sequence[RawMessage], stamp_ns: int) -> Message:
        """Make a PointCloud2 of one message, `time` in seconds from its stamp.

        Raises CloudError where velodyne-decoder does not know the sensor.
        """
        scan = self._bag.deserialize(raws[0])
        stamp = scan.header.stamp
        packets = self._velodyne.PacketVector()
        for packet in scan.packets:
            nanoseconds = int(packet.stamp.nanosec) - int(stamp.nanosec)
            since_s = (packet.stamp.sec - stamp.sec) + 1e-9 * nanoseconds
            data = packet.data.tolist()
            packets.append(self._velodyne.VelodynePacket(_ANY_TIME_S + since_s, data))
        points = np.zeros(0, VELODYNE_POINT)
        if len(scan.packets):
            try:
                start, decoded = self._decoder.decode(packets, as_pcl_structs=True)
            except (RuntimeError, ValueError, IndexError) as error:
                raise CloudError(
                    f"{self._topic}: the packets cannot be decoded ({error}); decode them with the "
                    "sensor's own driver and record its PointCloud2"
                ) from error
            points = np.zeros(len(decoded), VELODYNE_POINT)
            names = ["x", "y", "z", "intensity", "ring"]
            points[names] = decoded[names]
            points["time"] = decoded["time"] + np.float32(float(start.host) - _ANY_TIME_S)
        return make_cloud(self._bag.typestore, scan.header, points[None])
