"""Raw packets of Ouster lidars, a message each, as clouds in the layout of Ouster's driver.

ouster-sdk, the maker's decoder, reads them. The sensor's metadata, which the driver publishes
beside the packets (`lidar_packets` and `metadata`), define their content and the direction of
each emitter: https://github.com/ouster-lidar/ouster-ros
"""

from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from ffmap.algorithms.base.scan import BoolArray, IntArray, UInt8Array
from ffmap.loaders.bag import Bag, Message, RawMessage, Topic
from ffmap.loaders.errors import CloudError, InputError, shortened
from ffmap.loaders.pointcloud2 import make_cloud, make_header
from ffmap.loaders.sensors.sensor import Decoder, Sensor

_PACKAGES = ("ouster_ros", "ouster_sensor_msgs", "ouster_msgs")
_PACKETS, _CLOUDS, _METADATA = "lidar_packets", "points", "metadata"
_LENGTH_BYTES = 4  # Of the number before the packet's own bytes; CDR has as many more before it
_SPARE_BYTES = 4  # Older drivers send one byte more than the packet has, and CDR is padded
_CLOCKS_APART_NS = 1_000_000_000
_CLOCK_SAMPLES = 400
_DRIFT_MAX = 2e-4  # Of an oscillator; more is noise of a short recording, or the clock was set
_T_MAX_NS = 2**31 - 1  # Lost columns have time 0; they have no returns
_FIELDS = {
    "x": "f4",
    "y": "f4",
    "z": "f4",
    "intensity": "f4",
    "t": "i4",
    "reflectivity": "u2",
    "ring": "u2",
}
_SDK_FIELDS = {"intensity": "SIGNAL", "reflectivity": "REFLECTIVITY"}


class Ouster(Sensor):
    """Packets as Ouster's driver publishes them."""

    messages = "packets of an Ouster"
    msgtypes = tuple(f"{package}/msg/PacketMsg" for package in _PACKAGES)
    definitions = MappingProxyType(dict.fromkeys(msgtypes, "uint8[] buf"))

    def matches(self, topic: Topic) -> bool:
        """Whether packets are a lidar's: those of its IMU have the same type."""
        return super().matches(topic) and _PACKETS in topic.name

    def unread_reason(self, bag: Bag, topic: Topic) -> str | None:
        what = f"{topic.name}: Ouster's raw packets"
        clouds, metadata = _beside(topic.name, _CLOUDS), _beside(topic.name, _METADATA)
        if _is_filled(bag, clouds):
            return f"{what} are not used, because the driver's clouds are on {clouds}"
        if not _is_filled(bag, metadata):
            return (
                f"{what} cannot be read without the sensor's metadata on {metadata}; record that "
                "topic too, or the driver's PointCloud2"
            )
        if _sdk_version().split(".")[0] != "1":
            return (
                f"{what} require version 1 of ouster-sdk, which is not installed: "
                "pip install --no-deps 'ouster-sdk>=1,<2'; or record the driver's PointCloud2"
            )
        return None

    def frame_of(self, bag: Bag, topic: str) -> str:
        """Return the driver's frame of the sensor; of several, with their topics' namespaces."""
        count = sum(self.matches(other) and other.count > 0 for other in bag.topics.values())
        return "os_sensor" if count == 1 else _beside(topic, "os_sensor").removeprefix("/")

    def index(self, bag: Bag, topic: str) -> tuple[IntArray, IntArray, IntArray]:
        return OusterDecoder(bag, topic, self.frame_of(bag, topic)).index()

    def decoder(self, bag: Bag, topic: str) -> Decoder:
        return OusterDecoder(bag, topic, self.frame_of(bag, topic)).to_cloud


def _is_filled(bag: Bag, topic: str) -> bool:
    return topic in bag.topics and bag.topics[topic].count > 0


def _sdk_version() -> str:
    try:
        return version("ouster-sdk")
    except PackageNotFoundError:
        return ""


def _beside(topic: str, name: str) -> str:
    """The topic of this name in the same namespace."""
    return topic[: topic.rindex("/") + 1] + name if "/" in topic else name


class OusterDecoder:
    """Decodes the packets of one sensor. Raises InputError where its metadata are invalid."""

    def __init__(self, bag: Bag, topic: str, frame_id: str) -> None:
        self._core: Any = import_module("ouster.sdk.core")  # Few machines have it
        self._bag, self._topic, self._frame_id = bag, topic, frame_id
        self._data_at = _LENGTH_BYTES * bag.ros_version
        name = _beside(topic, _METADATA)
        try:
            # The driver publishes them again after the sensor was configured.
            *_, latest = bag.messages([name])
            self._sensor = self._core.SensorInfo(bag.deserialize(latest).data)
            self._format = self._core.PacketFormat(self._sensor)
            self._to_points = self._core.XYZLutFloat(self._sensor, use_extrinsics=False)
        except (RuntimeError, ValueError, TypeError) as error:
            raise InputError(
                f"{name}: these are no metadata of an Ouster lidar ({shortened(error)}); record "
                "the driver's PointCloud2"
            ) from error

    def index(self) -> tuple[IntArray, IntArray, IntArray]:
        """Find the revolutions; see `Sensor.index`.

        The stamp is the time of the first firing, by the sensor's clock where that is the bag's,
        else fitted to the log times.
        """
        head = self._format.packet_header_size + self._format.col_header_size
        heads = [
            (time_ns, *self._head_of(data))
            for time_ns, data in self._bag.heads(self._topic, self._data_at + head)
        ]
        if not heads:
            return (np.zeros(0, np.int64),) * 3
        log_time_ns, frame, column_ns = np.array(heads, np.int64).T
        first = np.flatnonzero(_begins(frame, self._format.max_frame_id + 1))
        counts = np.diff(np.append(first, len(frame)))
        own = (frame == np.repeat(frame[first], counts)) & (column_ns > 0)
        times_ns = np.where(own, column_ns, np.iinfo(np.int64).max)
        started_ns = np.minimum.reduceat(times_ns, first)
        return log_time_ns, counts, _on_bags_clock(started_ns, log_time_ns[first])

    def to_cloud(self, raws: Sequence[RawMessage], stamp_ns: int) -> Message:
        """Make a PointCloud2 of a revolution: a row for each emitter, the uppermost first.

        Second returns have as many rows more. `t`: nanoseconds from the stamp. The points are in
        the sensor's frame. Raises CloudError where no packet matches the metadata.
        """
        packets = [packet for packet in map(self._packet_of, raws) if packet is not None]
        if not packets:
            raise CloudError(
                f"{self._topic}: packets of {len(raws[0].data) - self._data_at} bytes, where by "
                f"the metadata they have {self._format.lidar_packet_size}: the sensor is another "
                "one, or was configured again; record the driver's PointCloud2"
            )
        # A late packet belongs to the revolution before.
        packets = [p for p in packets if p.frame_id() == packets[0].frame_id()]
        frame, batcher = self._core.LidarFrame(self._sensor), self._core.FrameBatcher(self._sensor)
        for packet in packets:
            if batcher.batch(packet, frame):
                break
        column_ns = [self._first_column_ns(packet.buf) for packet in packets]
        started_ns = min((time_ns for time_ns in column_ns if time_ns > 0), default=0)
        header = make_header(self._bag, stamp_ns, self._frame_id)
        return make_cloud(self._bag.typestore, header, self._points(frame, started_ns))

    def _points(
        self,
        frame: Any,  # noqa: ANN401 - the SDK's
        started_ns: int,
    ) -> npt.NDArray[np.void]:
        """The returns (rows, columns) of a revolution that started at this time."""
        returns = [second for second in ("", "2") if frame.has_field(f"RANGE{second}")]
        dtype = [
            (name, f"<{kind}")
            for name, kind in _FIELDS.items()
            if frame.has_field(_SDK_FIELDS.get(name, "RANGE"))
        ]
        points = np.zeros((len(returns), frame.h, frame.w), dtype)
        since_ns = np.clip(frame.timestamp.astype(np.int64) - started_ns, -_T_MAX_NS, _T_MAX_NS)
        points["t"] = self._aligned(np.broadcast_to(since_ns, (frame.h, frame.w)))
        points["ring"] = np.arange(frame.h)[:, None]
        for own, second in zip(points, returns, strict=True):
            xyz = self._aligned(self._to_points(frame.field(f"RANGE{second}")))
            own["x"], own["y"], own["z"] = np.moveaxis(xyz, 2, 0)
            for name in _SDK_FIELDS.keys() & dict(dtype):
                own[name] = self._aligned(frame.field(f"{_SDK_FIELDS[name]}{second}"))
        return points.reshape(-1, frame.w)

    def _aligned(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Put the values (rows, columns, …) of one direction into one column, as the driver."""
        return np.asarray(self._core.destagger(self._sensor, np.ascontiguousarray(values)))

    def _packet_of(self, raw: RawMessage) -> Any | None:  # noqa: ANN401 - the SDK's
        data = np.frombuffer(raw.data, np.uint8)[self._data_at :]
        size = self._format.lidar_packet_size
        if not size <= len(data) <= size + _SPARE_BYTES:
            return None
        packet = self._core.LidarPacket(self._format)
        packet.buf[:] = data[:size]
        return packet

    def _head_of(self, data: bytes) -> tuple[int, int]:
        """Number of the revolution and time of the first column, from a message's first bytes."""
        packet = np.zeros(self._format.lidar_packet_size, np.uint8)
        head = np.frombuffer(data, np.uint8)[self._data_at :][: len(packet)]
        packet[: len(head)] = head
        return int(self._format.frame_id(packet)), self._first_column_ns(packet)

    def _first_column_ns(self, packet: UInt8Array) -> int:
        """By the sensor's clock; 0 outside the sensor's azimuth window."""
        times_ns = self._format.packet_header(self._core.ColHeader.TIMESTAMP, packet)
        return int(times_ns.astype(np.int64)[0])


def _begins(frame: IntArray, numbers: int) -> BoolArray:
    """Find the first packets (m,) of revolutions, whose numbers (m,) count modulo `numbers`."""
    steps = np.mod(np.diff(frame) + numbers // 2, numbers) - numbers // 2
    # One back: a late packet. More: the sensor was started again.
    reached = np.maximum.accumulate(np.cumsum(np.where(steps < -1, 1, steps)))
    return np.append(True, np.diff(reached, prepend=0) > 0)


def _on_bags_clock(time_ns: IntArray, log_time_ns: IntArray) -> IntArray:
    """Convert times (n,) of a sensor's clock to the bag's, by log times (n,)."""
    late_ns = log_time_ns - time_ns
    if not len(late_ns) or abs(float(np.median(late_ns))) < _CLOCKS_APART_NS:
        return time_ns
    from scipy.stats import theilslopes  # Slow, and few bags need it

    since_ns, later_ns = time_ns - time_ns[0], late_ns - late_ns[0]
    sample = slice(None, None, -(-len(late_ns) // _CLOCK_SAMPLES))
    drift = 0.0
    if np.ptp(since_ns):
        drift = float(theilslopes(later_ns[sample], since_ns[sample]).slope)
    if abs(drift) > _DRIFT_MAX:
        drift = 0.0
    drift_ns = np.rint(drift * since_ns).astype(np.int64)
    return np.asarray(time_ns + late_ns[0] + drift_ns + int(np.median(later_ns - drift_ns)))
