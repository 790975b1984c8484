"""Livox's own clouds: CustomMsg of livox_ros_driver and livox_ros_driver2.

The points are read from the message's bytes: as Python objects, a second of them would take a
second. Both drivers have the layout of CustomMsg.msg and CustomPoint.msg in
https://github.com/Livox-SDK/livox_ros_driver2/tree/master/msg
"""

import struct
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from ffmap.loaders.bag import Bag, Message, RawMessage
from ffmap.loaders.bag_writer import SerializedMessage
from ffmap.loaders.errors import CloudError
from ffmap.loaders.pointcloud2 import make_cloud, make_header
from ffmap.loaders.sensors.sensor import Sensor

_DRIVERS = ("livox_ros_driver", "livox_ros_driver2")
_POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
)
_CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "CustomPoint[] points"
)
_POINT_BYTES = 19
_CDR_POINT_BYTES = 20  # Each begins at a multiple of four; the last one ends where its fields do
_HEAD_BYTES = 20  # timebase, point_num, lidar_id, rsvd, and the number of points


def _point_type(order: str = "<", itemsize: int = _POINT_BYTES) -> np.dtype[np.void]:
    return np.dtype(
        {
            "names": ["offset_time", "x", "y", "z", "reflectivity", "tag", "line"],
            "formats": [order + kind for kind in ("u4", "f4", "f4", "f4", "u1", "u1", "u1")],
            "offsets": [0, 4, 8, 12, 16, 17, 18],
            "itemsize": itemsize,
        }
    )


LIVOX_POINT = _point_type()


class Livox(Sensor):
    """The drivers' own clouds; `offset_time` counts nanoseconds from the stamp."""

    messages = "clouds of a Livox (CustomMsg)"
    msgtypes = tuple(f"{driver}/msg/CustomMsg" for driver in _DRIVERS)
    definitions = MappingProxyType(
        {
            **{f"{driver}/msg/CustomPoint": _POINT for driver in _DRIVERS},
            **{f"{driver}/msg/CustomMsg": _CLOUD for driver in _DRIVERS},
        }
    )

    def decode(self, bag: Bag, raw: RawMessage) -> Message:
        ros1, data = bag.ros_version == 1, bytes(raw.data)
        order = "<" if ros1 or (data[1:2] and data[1] & 1) else ">"
        # CDR aligns numbers to their size, counted from behind its first four bytes.
        seconds = "I" if ros1 else "i"
        step = _POINT_BYTES if ros1 else _CDR_POINT_BYTES
        try:
            sec, nanosec, length = struct.unpack_from(f"{order}{seconds}II", data, 4)
            frame_id = data[16 : 16 + length].rstrip(b"\0").decode()
            head_at = 16 + length if ros1 else 4 + -(-(12 + length) // 8) * 8
            (count,) = struct.unpack_from(f"{order}I", data, head_at + _HEAD_BYTES - 4)
        except (struct.error, UnicodeDecodeError) as error:
            raise CloudError(
                f"{raw.topic}: a message is cut ({error}); leave that stretch of the bag out"
            ) from error
        points_at = head_at + _HEAD_BYTES
        if count and len(data) - points_at < (count - 1) * step + _POINT_BYTES:
            raise CloudError(
                f"{raw.topic}: a message with {count} points contains fewer; leave that stretch "
                "of the bag out"
            )
        dtype = _point_type(order, step)
        content = data[points_at:].ljust(count * step, b"\0")
        points = np.frombuffer(content, dtype, count).astype(dtype.newbyteorder("<"))
        header = make_header(bag, sec * 1_000_000_000 + nanosec, frame_id)
        return make_cloud(bag.typestore, header, points[None])


def livox_message(
    ros1: bool, stamp_ns: int, frame_id: str, points: npt.NDArray[np.void]
) -> SerializedMessage:
    """Make a CustomMsg of livox_ros_driver2 of points (n,) of the type LIVOX_POINT."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    frame = frame_id.encode() + b"\0" * (not ros1)
    step = _POINT_BYTES if ros1 else _CDR_POINT_BYTES
    head = struct.pack("<IIII", 0, sec, nanosec, len(frame)) + frame
    if not ros1:
        head = struct.pack("<BBHiII", 0, 1, 0, sec, nanosec, len(frame)) + frame
        head += b"\0" * (-(len(head) - 4) % 8)
    head += struct.pack("<QIB3xI", stamp_ns, len(points), 0, len(points))
    data = points.astype(_point_type("<", step)).tobytes()
    # Behind the last point nothing is aligned.
    end = max(len(points) * step - (step - _POINT_BYTES), 0)
    return SerializedMessage(Livox.msgtypes[1], head + data[:end])
