"""Livox's own clouds (CustomMsg of livox_ros_driver and livox_ros_driver2) as PointCloud2, field by field, and made.

The points are read from the message's bytes: as objects of Python, a second of them would take a second. Their layout is that
of CustomMsg.msg and CustomPoint.msg, the same in both drivers: https://github.com/Livox-SDK/livox_ros_driver2/tree/master/msg
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
_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
_CLOUD = "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points"
_FIELDS = ["offset_time", "x", "y", "z", "reflectivity", "tag", "line"]
_FORMATS = ["u4", "f4", "f4", "f4", "u1", "u1", "u1"]
_OFFSETS = [0, 4, 8, 12, 16, 17, 18]
_POINT_BYTES = 19
LIVOX_POINT = np.dtype({"names": _FIELDS, "formats": ["<" + kind for kind in _FORMATS], "offsets": _OFFSETS})
_CDR_POINT_BYTES = 20  # Each begins at a multiple of four; the last one ends where its fields do


class Livox(Sensor):
    """The drivers' own clouds."""

    messages = "clouds of a Livox (CustomMsg)"
    msgtypes = tuple(f"{driver}/msg/CustomMsg" for driver in _DRIVERS)
    definitions = MappingProxyType(
        {
            **{f"{driver}/msg/CustomPoint": _POINT for driver in _DRIVERS},
            **{f"{driver}/msg/CustomMsg": _CLOUD for driver in _DRIVERS},
        }
    )

    def decode(self, bag: Bag, raw: RawMessage) -> Message:
        return livox_cloud(bag, raw)


def livox_cloud(bag: Bag, raw: RawMessage) -> Message:
    """The points of one message in their order: offset_time (uint32, nanoseconds from the stamp), x y z, reflectivity, tag, line.

    Raises CloudError where the bytes are not those of a CustomMsg.
    """
    try:
        header, count, order, first = (_ros1_head if bag.ros_version == 1 else _cdr_head)(bytes(raw.data))
    except (struct.error, IndexError, UnicodeDecodeError) as error:
        raise CloudError(f"{raw.topic}: a message is cut ({error}); leave that stretch of the bag out") from error
    step = _POINT_BYTES if bag.ros_version == 1 else _CDR_POINT_BYTES
    data = bytes(raw.data)[first:].ljust(count * step, b"\0")
    if len(raw.data) - first < count * step - (step - _POINT_BYTES if count else 0):
        raise CloudError(
            f"{raw.topic}: a message says that it has {count} points and holds fewer; leave that stretch of the bag out"
        )
    dtype = np.dtype(
        {"names": _FIELDS, "formats": [order + kind for kind in _FORMATS], "offsets": _OFFSETS, "itemsize": step}
    )
    points = np.frombuffer(data, dtype, count).astype(dtype.newbyteorder("<"))
    sec, nanosec, frame_id = header
    made = make_header(bag, sec * 1_000_000_000 + nanosec, frame_id)
    return make_cloud(bag.typestore, made, points[None])


def livox_message(ros1: bool, stamp_ns: int, frame_id: str, points: npt.NDArray[np.void]) -> SerializedMessage:
    """A CustomMsg of livox_ros_driver2. points: (n,) of the type LIVOX_POINT."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    frame = frame_id.encode() + b"\0" * (not ros1)
    step = _POINT_BYTES if ros1 else _CDR_POINT_BYTES
    head = struct.pack("<IIII", 0, sec, nanosec, len(frame)) + frame
    if not ros1:
        head = struct.pack("<BBHiII", 0, 1, 0, sec, nanosec, len(frame)) + frame
        head += b"\0" * (-(len(head) - 4) % 8)
    head += struct.pack("<QIB3xI", stamp_ns, len(points), 0, len(points))
    own = np.zeros(len(points), {"names": _FIELDS, "formats": _FORMATS, "offsets": _OFFSETS, "itemsize": step})
    for name in _FIELDS:
        own[name] = points[name]
    # Behind the last point nothing is aligned.
    data = own.tobytes()[: max(len(points) * step - (step - _POINT_BYTES), 0)]
    return SerializedMessage(Livox.msgtypes[1], head + data)


_Head = tuple[
    tuple[int, int, str], int, str, int
]  # Seconds, nanoseconds and frame; points; byte order; where they begin


def _ros1_head(data: bytes) -> _Head:
    _, sec, nanosec, length = struct.unpack_from("<IIII", data)
    at = 16 + length
    (count,) = struct.unpack_from("<I", data, at + 16)
    return (sec, nanosec, data[16:at].decode()), count, "<", at + 20


def _cdr_head(data: bytes) -> _Head:
    """As in ROS 2: numbers lie at multiples of their size, counted from behind the four bytes that say the byte order."""
    order = "<" if data[1] & 1 else ">"
    sec, nanosec, length = struct.unpack_from(f"{order}iII", data, 4)
    frame_id = data[16 : 16 + max(length - 1, 0)].decode()  # Without the zero at its end
    timebase_at = 4 + -(-(12 + length) // 8) * 8
    (count,) = struct.unpack_from(f"{order}I", data, timebase_at + 16)
    return (sec, nanosec, frame_id), count, order, timebase_at + 20
