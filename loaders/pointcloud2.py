"""sensor_msgs/PointCloud2 as structured arrays, and structured arrays as PointCloud2.

Fields are read in any order, with padding, in any byte order and numeric type, organised or not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.typesys.store import Typestore

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.errors import CloudError
from ffmap.loaders.firing_times import TIME_NAMES, join_times

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
INTENSITY_NAMES = ("reflectivity", "intensity", "intensities", "remission")
"""The first that varies is used: values calibrated for the range before raw ones."""
RING_NAMES = ("ring", "channel", "laser_id", "line", "laser", "scan_id")
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_UINT8, _FLOAT32 = 2, 7
_LABEL_FIELDS = ("label", "label_scan")


@dataclass(frozen=True)
class CloudLayout:
    """The layout of a cloud message.

    point: structured type of a point, with the fields' names, offsets and byte order.
    """

    topic: str
    frame_id: str
    point: np.dtype[np.void]
    height: int
    width: int

    def named(self, names: Sequence[str]) -> tuple[str, ...]:
        """Select the fields with these names, in upper or lower case, in the order of `names`."""
        by_lower = {name.lower(): name for name in reversed(self.point.names or ())}
        return tuple(by_lower[name] for name in names if name in by_lower)

    @property
    def ring_field(self) -> str | None:
        return next(iter(self.named(RING_NAMES)), None)

    @property
    def time_fields(self) -> tuple[str, ...]:
        """The fields that may contain times; the values decide, see `settle_decoding`."""
        return self.named(TIME_NAMES)


def describe_layout(
    message: Message, topic: str, needed: tuple[str, ...] = ("x", "y", "z")
) -> CloudLayout:
    """Read the layout of a message.

    Raises CloudError where it is inconsistent or lacks a needed field.
    """
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    if height * width * step:
        row_bytes, row_step = width * step, int(message.row_step)
        if height > 1 and 0 < row_step < row_bytes:
            raise CloudError(
                f"{topic}: row_step {row_step} is less than width x point_step = {row_bytes}; "
                "fix the driver, or choose another topic"
            )
        size = (height - 1) * max(row_step, row_bytes) + row_bytes
        if len(message.data) < size:
            raise CloudError(
                f"{topic}: the cloud is truncated, {len(message.data)} bytes where height x width "
                f"x point_step = {size}; leave that stretch of the bag out, or choose another topic"
            )
    fields = tuple((f.name, int(f.offset), int(f.datatype)) for f in message.fields)
    order = ">" if message.is_bigendian else "<"
    point = _point_type(topic, fields, step if height * width else None, order, needed)
    return CloudLayout(topic, message.header.frame_id.removeprefix("/"), point, height, width)


@lru_cache(maxsize=64)
def _point_type(
    topic: str,
    fields: tuple[tuple[str, int, int], ...],
    point_step: int | None,
    order: str,
    needed: tuple[str, ...],
) -> np.dtype[np.void]:
    """Make the structured type of a point. point_step: None in a cloud without points."""
    types: dict[str, np.dtype[Any]] = {}
    offsets: dict[str, int] = {}
    for name, offset, datatype in fields:
        if datatype not in _DATATYPES:
            raise CloudError(
                f"{topic}: field {name} has the unknown datatype {datatype}; choose another topic"
            )
        dtype = np.dtype(order + _DATATYPES[datatype])
        end = offset + dtype.itemsize
        if point_step is not None and end > point_step:
            raise CloudError(
                f"{topic}: field {name} ends at byte {end}, beyond point_step {point_step}; "
                "fix the driver, or choose another topic"
            )
        types.setdefault(name, dtype)
        offsets.setdefault(name, offset if point_step is not None else 0)
    if missing := [name for name in needed if name not in types]:
        raise CloudError(
            f"{topic}: no field {' '.join(missing)} among {' '.join(types) or 'none'}; "
            f"choose a topic that has {' '.join(needed)}"
        )
    return np.dtype(
        {
            "names": list(types),
            "formats": list(types.values()),
            "offsets": list(offsets.values()),
            "itemsize": point_step or max(dtype.itemsize for dtype in types.values()),
        }
    )


def points_of(message: Message, layout: CloudLayout) -> npt.NDArray[np.void]:
    """View the points of a message as a structured array (height x width,), row by row."""
    shape, step = (layout.height, layout.width), layout.point.itemsize
    if 0 in shape:
        return np.zeros(0, layout.point)
    strides = (max(int(message.row_step), layout.width * step), step)
    data = np.ascontiguousarray(message.data).data
    return np.ndarray(shape, layout.point, data, strides=strides).reshape(-1)


def valid_points(points: npt.NDArray[np.void]) -> tuple[FloatArray, IntArray]:
    """Select the returns: finite and not zero.

    Returns:
        Coordinates (n, 3) float32, and places (n,) int32 in the cloud.
    """
    with np.errstate(over="ignore"):  # A coordinate beyond float32 becomes infinite
        x, y, z = (points[axis].astype(np.float32) for axis in "xyz")
    finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    index = np.flatnonzero(finite & ((x != 0) | (y != 0) | (z != 0)))
    if len(index) < len(points):
        x, y, z = x.take(index), y.take(index), z.take(index)
    return np.stack([x, y, z], axis=1), index.astype(np.int32)


def field_of(points: npt.NDArray[np.void], name: str, index: IntArray) -> npt.NDArray[Any]:
    """Copy a field of the valid points, at their places `index`, in the machine's byte order."""
    values = points[name]
    # One copy of the whole field is several times as fast as picking values out of the points.
    values = values.astype(values.dtype.newbyteorder("="))
    return values if len(index) == len(points) else values.take(index)


def stamp_ns(message: Message) -> int:
    """Return the header's time stamp in nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def full_labels(cloud_size: int, cloud_index: IntArray, label: UInt8Array) -> UInt8Array:
    """Spread the labels (n,) of returns over their cloud (cloud_size,); 255 without a return."""
    labels = np.full(cloud_size, NO_RETURN, np.uint8)
    labels[cloud_index] = label
    return labels


def encode_labelled(message: Message, label: UInt8Array, label_scan: UInt8Array) -> Message:
    """Append two uint8 fields, `label` and `label_scan`, to each point of a cloud.

    label, label_scan: (height x width,) in the cloud's order; see `full_labels`. The other fields
    stay the same; padding at the end of rows is removed.
    """
    size, step = int(message.height) * int(message.width), int(message.point_step)
    if not len(label) == len(label_scan) == size:
        raise ValueError(f"{len(label)} and {len(label_scan)} labels for a cloud of {size} points")
    labelled = np.empty((size, step + 2), np.uint8)
    if size:
        layout = describe_layout(message, "", needed=())
        labelled[:, :step] = points_of(message, layout).view(np.uint8).reshape(size, step)
        labelled[:, step], labelled[:, step + 1] = label, label_scan
    kept = [field for field in message.fields if field.name not in _LABEL_FIELDS]
    added = [
        replace(message.fields[0], name=name, offset=step + i, datatype=_UINT8, count=1)
        for i, name in enumerate(_LABEL_FIELDS)
    ]
    return replace(
        message,
        fields=[*kept, *added],
        point_step=step + 2,
        row_step=int(message.width) * (step + 2),
        data=labelled.reshape(-1),
    )


def make_header(bag: Bag, stamp_ns: int, frame_id: str) -> Message:
    """Make a std_msgs/Header for the bag's version of ROS."""
    types = bag.typestore.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    sequence = [0] if bag.ros_version == 1 else []
    return types["std_msgs/msg/Header"](*sequence, stamp, frame_id)


def make_cloud(typestore: Typestore, header: Message, points: npt.NDArray[np.void]) -> Message:
    """Make a PointCloud2 of structured points (height, width), little-endian."""
    codes = {np.dtype(kind): code for code, kind in _DATATYPES.items()}
    kinds: Mapping[str, Any] = points.dtype.fields or {}
    field = typestore.types["sensor_msgs/msg/PointField"]
    (height, width), step = points.shape, points.dtype.itemsize
    return typestore.types[CLOUD_TYPE](
        header=header,
        height=height,
        width=width,
        fields=[
            field(name, kinds[name][1], codes[kinds[name][0]], 1)
            for name in points.dtype.names or ()
        ],
        is_bigendian=False,
        point_step=step,
        row_step=step * width,
        data=points.reshape(-1).view(np.uint8),
        is_dense=height == 1,
    )


def merge_clouds(messages: Sequence[Message]) -> Message:
    """Merge the clouds of one revolution, in order; with the header of the first.

    Their first filled field of times counts from one start afterwards (`join_times`). Without such
    a field, `time` (float32, seconds from the first time stamp) is appended: each cloud's own time
    stamp is the time of its points.
    """
    # A part without points may have any layout.
    first = next((m for m in messages if m.width * m.height), messages[0])
    layout = describe_layout(first, "")
    parts, offsets_ns = [], []
    for message in messages:
        found = describe_layout(message, "")
        if found.point == layout.point:
            parts.append(points_of(message, found).copy())
            offsets_ns.append(stamp_ns(message) - stamp_ns(messages[0]))
    fields, step = list(first.fields), layout.point.itemsize
    if names := layout.time_fields:
        name = next((n for n in names if any(part[n].any() for part in parts)), names[0])
        joined = join_times(name, [part[name] for part in parts], offsets_ns)
        for part, times in zip(parts, joined, strict=True):
            part[name] = times
    data = np.concatenate([part.view(np.uint8).reshape(-1, step) for part in parts])
    if not names:
        fields.append(replace(fields[0], name="time", offset=step, datatype=_FLOAT32, count=1))
        times = np.repeat([1e-9 * offset for offset in offsets_ns], [len(part) for part in parts])
        times = times.astype(">f4" if first.is_bigendian else "<f4")
        data = np.hstack([data, times[:, None].view(np.uint8)])
    return replace(
        first,
        header=messages[0].header,
        height=1,
        width=len(data),
        fields=fields,
        point_step=data.shape[1],
        row_step=data.size,
        data=data.reshape(-1),
    )
