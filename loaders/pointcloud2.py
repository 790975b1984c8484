"""sensor_msgs/PointCloud2 to scans and back: any field order, padding, byte order and numeric type, organised or not.

How a topic's clouds are read (`CloudDecoding`) is settled once, from clouds all over the bag: a single cloud may be too
poor to tell the unit of its times or how many rings there are.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numba
import numpy as np
import numpy.typing as npt
from rosbags.typesys.store import Typestore

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.own_body import OwnBody
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, subset
from ffmap.loaders.bag import Bag, Message
from ffmap.loaders.dual_returns import APART_M, PAIRS_MIN, nearer_returns
from ffmap.loaders.errors import CloudError
from ffmap.loaders.firing_times import TIME_NAMES, TimeField, azimuth_times, find_time_field, join_times
from ffmap.loaders.rings import RingModel, RingSample, estimate_rings

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
TimeFrom = Literal["auto", "azimuth", "none"]

INTENSITY_NAMES = ("reflectivity", "intensity", "intensities", "remission")
"""The first of them that varies is taken: what a driver has calibrated for the range before what the detector measured."""
RING_NAMES = ("ring", "channel", "laser_id", "line", "laser", "scan_id")
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_UINT8 = 2
_LABEL_FIELDS = ("label", "label_scan")
_SPANS_MAX = 2.0
"""Maximum span of a cloud's times, in sweeps: longer ones overlap the next clouds, so that the times must be wrong."""
_NUMBER_MAX = 2.0**31  # Higher numbers are not rings, and do not fit into integers


@dataclass(frozen=True)
class CloudLayout:
    """What a cloud message says about its points.

    point: the structured type of one point, with the fields' names, offsets and byte order. point_step: its bytes.
    ring_field: the name of the field that holds rings; None where there is none.
    time_fields: the names of those that may hold times; their content decides, see `settle_decoding`.
    """

    topic: str
    frame_id: str
    point: np.dtype[np.void]
    point_step: int
    height: int
    width: int
    ring_field: str | None
    time_fields: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class CloudDecoding:
    """How the clouds of one topic become scans, the same for all of them.

    time: the field of times, its unit and reference; None where there is none, or it tells none.
    time_from: "auto" (the field), "azimuth" (recovered from the direction of each point), "none".
    period_ns: time of a revolution, from the stamps; None where fewer than two clouds are there.
    clock_ns: what is added to the firings' times, where this lidar's clock is off from the other's.
    intensity: the field that tells how strong a return is; None where there is none, or it is the same everywhere.
    dual: whether firings return twice; scans lack the nearer of the two returns.
    own_body: the robot's own body, which scans lack; None where none is known.
    """

    layout: CloudLayout
    rings: RingModel
    time: TimeField | None
    time_from: TimeFrom
    period_ns: int | None
    clock_ns: int = 0
    intensity: str | None = None
    dual: bool = False
    own_body: OwnBody | None = None

    @property
    def timed(self) -> bool:
        """Whether scans will carry the time of each firing."""
        return self.time is not None if self.time_from == "auto" else self.time_from == "azimuth"


def describe_layout(message: Message, topic: str, needed: tuple[str, ...] = ("x", "y", "z")) -> CloudLayout:
    """What the message says about its points. Raises CloudError where it contradicts itself or lacks a needed field."""
    layout = _layout(
        topic,
        message.header.frame_id.removeprefix("/"),
        tuple((f.name, int(f.offset), int(f.datatype)) for f in message.fields),
        int(message.point_step),
        bool(message.is_bigendian),
        int(message.height),
        int(message.width),
        needed,
    )
    rows, row_bytes = layout.height, layout.width * layout.point_step
    if rows and row_bytes:
        row_step = int(message.row_step)
        if rows > 1 and row_step < row_bytes and row_step:
            raise CloudError(
                f"{topic}: row_step {row_step} is less than width x point_step = {row_bytes}; the driver that wrote "
                "the cloud is at fault, choose another topic"
            )
        size = (rows - 1) * max(row_step, row_bytes) + row_bytes
        if len(message.data) < size:
            raise CloudError(
                f"{topic}: the cloud is truncated, {len(message.data)} bytes where height x width x point_step = "
                f"{size}; leave that stretch of the bag out, or choose another topic"
            )
    return layout


@lru_cache(maxsize=64)
def _layout(
    topic: str,
    frame_id: str,
    fields: tuple[tuple[str, int, int], ...],
    point_step: int,
    big_endian: bool,
    height: int,
    width: int,
    needed: tuple[str, ...],
) -> CloudLayout:
    known: dict[str, tuple[np.dtype[Any], int]] = {}
    for name, offset, datatype in fields:
        if datatype not in _DATATYPES:
            raise CloudError(f"{topic}: field {name} has the unknown datatype {datatype}; choose another topic")
        dtype = np.dtype(_DATATYPES[datatype]).newbyteorder(">" if big_endian else "<")
        end = offset + dtype.itemsize
        if height * width and end > point_step:
            raise CloudError(
                f"{topic}: field {name} ends at byte {end}, beyond point_step {point_step}; the driver that "
                "wrote the cloud is at fault, choose another topic"
            )
        known.setdefault(name, (dtype, offset))
    if missing := [name for name in needed if name not in known]:
        raise CloudError(
            f"{topic}: no field {' '.join(missing)} among {' '.join(known) or 'none'}; choose a topic that has "
            f"{' '.join(needed)}"
        )
    formats, offsets = zip(*known.values(), strict=True)
    # Without points, nothing that the message says of their size has to be true.
    size = max(point_step, *(offset + dtype.itemsize for dtype, offset in known.values()))
    return CloudLayout(
        topic=topic,
        frame_id=frame_id,
        point=np.dtype({"names": list(known), "formats": formats, "offsets": offsets, "itemsize": size}),
        point_step=point_step,
        height=height,
        width=width,
        ring_field=next(iter(_named(RING_NAMES, known)), None),
        time_fields=_named(TIME_NAMES, known),
    )


def _named(names: Sequence[str], fields: Iterable[str]) -> tuple[str, ...]:
    """The fields with these names in upper or lower case, in the order of the names."""
    by_lower = {name.lower(): name for name in reversed(list(fields))}
    return tuple(by_lower[name] for name in names if name in by_lower)


def field_column(message: Message, layout: CloudLayout, name: str) -> npt.NDArray[Any]:
    """One field of every point (height x width,), row by row."""
    shape = (layout.height, layout.width)
    if 0 in shape:
        return np.zeros(0, layout.point[name])
    return _rows(message, shape, layout.point)[name].reshape(-1)


def _rows(message: Message, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """The message's points (height, width) or their bytes (height, width, point_step), without what pads the rows."""
    step = int(message.point_step)
    strides = (max(int(message.row_step), shape[1] * step), step, 1)[: len(shape)]
    return np.ndarray(shape, dtype, np.ascontiguousarray(message.data).data, strides=strides)


def _valid_points(message: Message, layout: CloudLayout) -> tuple[FloatArray, IntArray]:
    """Points (n, 3) float32 that the sensor did return, and their places (n,) int32 in the cloud."""
    # What a float32 cannot hold becomes infinite, and is none of the sensor's returns.
    with np.errstate(over="ignore"):
        x, y, z = (field_column(message, layout, axis).astype(np.float32, copy=False) for axis in "xyz")
    return _compact(x, y, z)


@numba.njit(cache=True, nogil=True)
def _compact(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, IntArray]:  # pragma: no cover
    points = np.empty((len(x), 3), np.float32)
    index = np.empty(len(x), np.int32)
    n = 0
    for i in range(len(x)):
        finite = np.isfinite(x[i]) and np.isfinite(y[i]) and np.isfinite(z[i])
        if finite and (x[i] != 0 or y[i] != 0 or z[i] != 0):
            points[n, 0], points[n, 1], points[n, 2] = x[i], y[i], z[i]
            index[n] = i
            n += 1
    return points[:n].copy(), index[:n].copy()


def _field_of(message: Message, layout: CloudLayout, name: str, index: IntArray) -> npt.NDArray[Any]:
    """One field of the valid points, whose places in the cloud are `index` (n,), in the machine's byte order."""
    column = field_column(message, layout, name)
    return _taken(column.astype(column.dtype.newbyteorder("="), copy=False), index)


@numba.njit(cache=True, nogil=True)
def _taken(column: npt.NDArray[Any], index: IntArray) -> npt.NDArray[Any]:  # pragma: no cover
    # NumPy copies the whole column first, whose values lie a point apart.
    taken = np.empty(len(index), column.dtype)
    for i in range(len(index)):
        taken[i] = column[index[i]]
    return taken


def stamp_ns(message: Message) -> int:
    """The header's stamp in nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def settle_decoding(
    messages: Sequence[Message], topic: str, time_from: TimeFrom = "auto", period_ns: int | None = None
) -> CloudDecoding:
    """How the clouds of a topic are to be read, from some of them, best from all over the bag.

    Raises CloudError where none of them is sound.
    """
    layouts, ring_samples = [], []
    time_samples: dict[str, list[tuple[npt.NDArray[Any], int]]] = {}
    varying: set[str] = set()
    failure: CloudError | None = None
    for message in messages:
        try:
            layout = describe_layout(message, topic)
        except CloudError as error:
            failure = error
            continue
        layouts.append(layout)
        points, index = _valid_points(message, layout)
        if not len(points):
            continue
        field = _ring_numbers(message, layout, index) if layout.ring_field else None
        row, column = np.divmod(index, layout.width)
        ring_samples.append(RingSample(points, field, row, column, (layout.height, layout.width)))
        varying |= {name for name in _intensity_fields(layout) if _varies(_field_of(message, layout, name, index))}
        for name in layout.time_fields:
            sample = _field_of(message, layout, name, index), stamp_ns(message)
            time_samples.setdefault(name, []).append(sample)
    if not layouts:
        raise failure or CloudError(f"{topic}: no cloud to read; choose another topic")
    usual = Counter(str(found.point.fields) for found in layouts)
    layout = max(layouts, key=lambda found: (usual[str(found.point.fields)], found.height * found.width))
    times = []
    for name in layout.time_fields:
        alike = [sample for sample in time_samples.get(name, ()) if sample[0].dtype.kind == layout.point[name].kind]
        times.append(find_time_field(name, alike, period_ns))
    # A driver may leave one of them unfilled.
    time = next(filter(None, times), None)
    intensity = next((name for name in _intensity_fields(layout) if name in varying), None)
    decoding = CloudDecoding(layout, estimate_rings(ring_samples), time, time_from, period_ns, intensity=intensity)
    return replace(decoding, dual=_returns_twice(messages, decoding))


def _intensity_fields(layout: CloudLayout) -> tuple[str, ...]:
    """Those that may tell how strong a return is, the best first."""
    return _named(INTENSITY_NAMES, layout.point.names or ())


def _varies(values: npt.NDArray[Any]) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() < known.max())


def _returns_twice(messages: Sequence[Message], decoding: CloudDecoding) -> bool:
    """Whether firings of these clouds return twice, which only their own times and rings tell."""
    if decoding.time_from != "auto" or decoding.time is None or decoding.rings.source in ("bins", "elevation"):
        return False
    pairs = 0
    for message in messages:
        try:
            scan = decode(message, decoding)
        except CloudError:
            continue
        if scan.time_ns is not None:
            nearer = nearer_returns(scan.points_sensor, scan.ring, scan.time_ns, APART_M)
            pairs += int(np.count_nonzero(nearer))
    return pairs >= PAIRS_MIN


def _ring_numbers(message: Message, layout: CloudLayout, index: IntArray) -> IntArray:
    assert layout.ring_field
    numbers = _field_of(message, layout, layout.ring_field, index)
    if np.issubdtype(numbers.dtype, np.floating):
        known = np.abs(numbers) < _NUMBER_MAX
        numbers = np.where(known, numbers, 0 if 2 * np.count_nonzero(known) > len(known) else -1)
    return numbers.astype(np.int64)


def _numbers(message: Message, layout: CloudLayout, rings: RingModel, index: IntArray) -> IntArray | None:
    """What tells the ring of each valid point (n,), as the topic's other clouds have it; None where elevations tell it.

    Raises CloudError where this cloud has it not, or has numbers that those have not.
    """
    match rings.source:
        case "field":
            if not layout.ring_field:
                raise CloudError(f"{layout.topic}: no field with rings, which the topic's other clouds have")
            number = _ring_numbers(message, layout, index)
            if 2 * np.count_nonzero((number < 0) | (number >= rings.count)) > len(number):
                raise CloudError(
                    f"{layout.topic}: field {layout.ring_field} has numbers from {number.min()} to {number.max()}, where the "
                    f"topic's other clouds have {rings.count} rings"
                )
            return number
        case "row" | "column":
            count = layout.height if rings.source == "row" else layout.width
            if len(index) and count != rings.count:
                raise CloudError(
                    f"{layout.topic}: {count} {rings.source}s, where the topic's other clouds have {rings.count}"
                )
            return index // layout.width if rings.source == "row" else index % max(layout.width, 1)
    return None


def decode(message: Message, decoding: CloudDecoding) -> Scan:
    """The cloud as a scan: invalid points, the nearer of two returns of a firing and the robot's own body dropped.

    A scan without any valid point is returned empty. Raises CloudError where the message contradicts itself.
    """
    layout = describe_layout(message, decoding.layout.topic)
    points, index = _valid_points(message, layout)
    ring = decoding.rings.rings(points, _numbers(message, layout, decoding.rings, index))
    stamp = stamp_ns(message)
    time_ns, start_ns = _times(message, layout, decoding, points, ring, index, stamp)
    scan = Scan(
        points_sensor=points,
        ring=ring,
        ring_count=decoding.rings.count,
        time_ns=time_ns,
        start_ns=start_ns + decoding.clock_ns,
        stamp_ns=stamp,
        cloud_index=index,
        cloud_size=layout.height * layout.width,
        intensity=_intensities(message, layout, decoding, index),
    )
    if decoding.dual and time_ns is not None:
        scan = subset(scan, ~nearer_returns(points, ring, time_ns))
    return scan if decoding.own_body is None else subset(scan, ~decoding.own_body.holds(scan.points_sensor))


def _intensities(
    message: Message, layout: CloudLayout, decoding: CloudDecoding, index: IntArray
) -> FloatArray | None:
    """(n,) float32 of the valid points; a cloud that lacks the field which the topic's others have says nothing."""
    if decoding.intensity is None:
        return None
    if decoding.intensity not in (layout.point.names or ()):
        return np.full(len(index), np.nan, np.float32)
    with np.errstate(over="ignore"):
        return _field_of(message, layout, decoding.intensity, index).astype(np.float32, copy=False)


def _times(
    message: Message,
    layout: CloudLayout,
    decoding: CloudDecoding,
    points: FloatArray,
    ring: IntArray,
    index: IntArray,
    stamp: int,
) -> tuple[IntArray | None, int]:
    if decoding.time_from == "auto" and decoding.time and decoding.time.name in layout.time_fields:
        name = decoding.time.name
        if layout.point[name].kind != decoding.layout.point[name].kind:
            raise CloudError(f"{layout.topic}: field {name} is of another type than in the topic's other clouds")
        try:
            values = _field_of(message, layout, name, index)
            time_ns, start_ns = decoding.time.nanoseconds(values, stamp)
            _check_span(time_ns, decoding.time, decoding.period_ns)
            return time_ns, start_ns
        except CloudError as error:
            raise CloudError(f"{layout.topic}: {error}; if it is so in many clouds, use --time-from azimuth") from error
    if decoding.time_from == "azimuth" and decoding.period_ns:
        if decoding.rings.source == "row":
            columns = index.astype(np.int64) % layout.width
            return columns * decoding.period_ns // layout.width, stamp
        return azimuth_times(points, ring, decoding.period_ns), stamp
    return None, stamp


def _check_span(time_ns: IntArray, time: TimeField, period_ns: int | None) -> None:
    """Raises CloudError where one cloud's times span far more than those of the others, which come in every period."""
    if period_ns is None or not len(time_ns):
        return
    span_ns, usual_ns = int(time_ns.max()), max(time.span_ns, period_ns)
    if span_ns > _SPANS_MAX * usual_ns:
        raise CloudError(
            f"the times in field {time.name} span {span_ns / 1e9:.2f} s, where a sweep takes {usual_ns / 1e9:.2f} s"
        )


def full_labels(cloud_size: int, cloud_index: IntArray, label: UInt8Array) -> UInt8Array:
    """Labels (cloud_size,) of every place in a cloud, from those (n,) of its returns; 255 where nothing returned.

    cloud_index: (n,) their places, see `Scan`.
    """
    labels = np.full(cloud_size, NO_RETURN, np.uint8)
    labels[cloud_index] = label
    return labels


def encode_labelled(message: Message, label: UInt8Array, label_scan: UInt8Array) -> Message:
    """The same cloud with two uint8 fields more, `label` and `label_scan`, at the end of each point.

    label, label_scan: (height x width,) in the cloud's order; see `full_labels`. Stamp, points, their order and the
    other fields stay as they are; padding at the end of rows goes.
    """
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    if not len(label) == len(label_scan) == height * width:
        raise ValueError(f"{len(label)} and {len(label_scan)} labels for a cloud of {height} x {width}")
    labelled = np.empty((height, width, step + 2), np.uint8)
    if height * width:
        labelled[:, :, :step] = _rows(message, (height, width, step), np.uint8)
        labelled[:, :, step] = np.reshape(label, (height, width))
        labelled[:, :, step + 1] = np.reshape(label_scan, (height, width))
    kept = [field for field in message.fields if field.name not in _LABEL_FIELDS]
    field = message.fields[0]
    added = [
        replace(field, name=name, offset=step + i, datatype=_UINT8, count=1) for i, name in enumerate(_LABEL_FIELDS)
    ]
    return replace(
        message, fields=[*kept, *added], point_step=step + 2, row_step=width * (step + 2), data=labelled.reshape(-1)
    )


def make_header(bag: Bag, stamp_ns: int, frame_id: str) -> Message:
    """A std_msgs/Header as the bag's version of ROS has it."""
    types = bag.typestore.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    return types["std_msgs/msg/Header"](*([0] if bag.ros_version == 1 else []), stamp, frame_id)


def make_cloud(typestore: Typestore, header: Message, points: npt.NDArray[np.void]) -> Message:
    """A PointCloud2 of structured points (height, width), with the fields, offsets and bytes of their type."""
    codes = {np.dtype(kind): code for code, kind in _DATATYPES.items()}
    kinds: Mapping[str, Any] = points.dtype.fields or {}
    field = typestore.types["sensor_msgs/msg/PointField"]
    (height, width), step = points.shape, points.dtype.itemsize
    return typestore.types[CLOUD_TYPE](
        header=header,
        height=height,
        width=width,
        fields=[field(name, kinds[name][1], codes[kinds[name][0]], 1) for name in points.dtype.names or ()],
        is_bigendian=False,
        point_step=step,
        row_step=step * width,
        data=points.reshape(-1).view(np.uint8),
        is_dense=height == 1,
    )


def merge_clouds(messages: Sequence[Message]) -> Message:
    """One cloud of several that belong to one revolution, in order; stamp and header of the first.

    Their first filled field of times becomes one of the whole revolution (`join_times`). Where they have none, a field `time`
    (float32, seconds from the first stamp) is appended: each cloud's own stamp is the time of its points.
    """
    # A part without points may say anything of their layout.
    first = replace(next((m for m in messages if m.width * m.height), messages[0]), header=messages[0].header)
    layout = describe_layout(first, "")
    blocks = list(_point_blocks(messages, layout))
    step, fields = layout.point_step, list(first.fields)
    data = np.concatenate([block for block, _ in blocks])
    points = data.view(layout.point)[:, 0]
    filled = [name for name in layout.time_fields if points[name].any()]
    if layout.time_fields:
        name = (filled or layout.time_fields)[0]
        parts = [block.view(layout.point)[:, 0][name] for block, _ in blocks]
        points[name] = np.concatenate(join_times(name, parts, [offset_ns for _, offset_ns in blocks]))
    else:
        dtype = np.dtype(">f4" if first.is_bigendian else "<f4")
        fields.append(replace(fields[0], name="time", offset=step, datatype=7, count=1))
        times = np.repeat([offset_ns * 1e-9 for _, offset_ns in blocks], [len(block) for block, _ in blocks])
        data = np.hstack([data, times.astype(dtype)[:, None].view(np.uint8)])
        step += dtype.itemsize
    return replace(
        first,
        height=1,
        width=len(data),
        fields=fields,
        point_step=step,
        row_step=len(data) * step,
        data=data.reshape(-1),
    )


def _point_blocks(messages: Sequence[Message], layout: CloudLayout) -> Iterator[tuple[UInt8Array, int]]:
    """Each cloud's bytes (n, point_step), and its stamp relative to the first one's in nanoseconds."""
    start_ns = stamp_ns(messages[0])
    for message in messages:
        found = describe_layout(message, layout.topic)
        if found.point_step != layout.point_step or found.point != layout.point:
            continue
        points = _rows(message, (found.height, found.width, found.point_step), np.uint8)
        yield points.reshape(-1, found.point_step), stamp_ns(message) - start_ns
