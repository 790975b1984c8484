"""The clouds of a topic, one a revolution, from the headers and first points of its messages.

Some recordings contain a PointCloud2 for each UDP packet, some 75 a revolution (Cartographer's
backpack), others for each half of a revolution: successive clouds are joined to whole ones.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from itertools import islice
from weakref import WeakKeyDictionary

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, IntArray
from ffmap.algorithms.base.trajectory import gaps
from ffmap.loaders.bag import Bag, Topic
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import CLOUD_TYPE, describe_layout, points_of
from ffmap.loaders.sensors import cloud_hint, sensor_of

_HEADER_BYTES = 16 + 64  # Up to the frame's name
_FRAME_SHARE_MIN = 0.05  # Of a topic's clouds; a few odd ones are no second lidar
_VIEWS = 30  # Number of clouds that show whether they are parts of a revolution
_VIEWS_OF_MANY, _PARTS_FEW = 1000, 5
_VIEW_POINTS = 2000  # Number of points that show which directions a cloud sees
_STEPS_ALIKE = 0.8  # Minimum mean resultant length of azimuth steps; without order it is near 0
_SECTORS = 36
_PARTS_MAX = 200
_PAUSE = 0.1  # Of a revolution; in fewer than 15 parts, one and a half steps
_OUTLIER_PERIODS = 10
_LOOK_AHEAD = 1000  # Number of following clouds that show whether the clock or one stamp is wrong
_STRETCH_MIN = 3  # Minimum number of clouds between two leaps of the stamps; fewer are wrong


@dataclass(frozen=True, eq=False)
class CloudIndex:
    """Where the clouds of a topic are: (m,) arrays, one row a revolution, in order of log time.

    log_time_ns: int64, of the revolution's first message.
    stamp_ns: int64, header stamp of the revolution's first message.
    message_count: int64, messages a revolution.
    earlier: int64, messages with the same log time before the revolution's first.
    usable: bool, False where the stamp repeats, jumps back, or jumps ahead of most that follow.
    frames: frames in the messages' headers, without rare ones.
    """

    topic: str
    log_time_ns: IntArray
    stamp_ns: IntArray
    message_count: IntArray
    earlier: IntArray
    usable: BoolArray
    frames: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def gathered(self, clouds: int) -> "CloudIndex":
        """Join up to `clouds` successive clouds to one with the first one's stamp.

        Unusable clouds stay alone, and none are joined across a pause.
        """
        if clouds == 1 or not len(self):
            return self
        steps = np.diff(self.stamp_ns)
        joins = self.usable[1:] & self.usable[:-1] & (steps < 1.5 * (self.period_ns or 0))
        first = _first_of_groups(joins, clouds)
        return replace(
            self._rows(first), message_count=np.add.reduceat(self.message_count, first)
        )

    def until(self, stop_ns: int) -> "CloudIndex":
        """Select the clouds before the first one with this stamp or a later one."""
        return self._rows(slice(int(np.argmax(np.append(self.stamp_ns >= stop_ns, True)))))

    def _rows(self, rows: slice | list[int]) -> "CloudIndex":
        names = [f.name for f in fields(self) if f.name not in ("topic", "frames")]
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    @property
    def period_ns(self) -> int | None:
        """The median time between two clouds; None for fewer than two."""
        steps = np.diff(self.stamp_ns[self.usable])
        return int(np.median(steps)) if len(steps) else None

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Stamp of the last cloud before each gap, and the gap's length, in nanoseconds."""
        stamps = self.stamp_ns[self.usable]
        return [(int(stamps[i]), int(stamps[i + 1] - stamps[i])) for i in gaps(stamps)]


_indices: WeakKeyDictionary[Bag, dict[str, CloudIndex]] = WeakKeyDictionary()
"""Of each open bag: reading all headers of a large bag takes seconds."""


def index_clouds(bag: Bag, topic: str) -> CloudIndex:
    """Index all clouds of a topic, once for an open bag.

    Raises InputError where it contains no clouds, and where files of the bag overlap.
    """
    known, found = _indices.setdefault(bag, {}), bag.topic(topic)
    if found.name not in known:
        known[found.name] = _index_clouds(bag, found)
    return known[found.name]


def _index_clouds(bag: Bag, topic: Topic) -> CloudIndex:
    sensor = sensor_of(topic)
    if sensor is None or sensor.unread_reason(bag, topic):
        raise InputError(
            f"{bag.path.name}: topic {topic.name} is {topic.msgtype}, no point cloud; "
            f"{cloud_hint(bag)}"
        )
    bag.check_recorded_once(topic.name)
    frames: tuple[str, ...] = ()
    if found := sensor.index(bag, topic.name):
        log_time_ns, counts, stamps = found
    else:
        log_time_ns, stamps, frames = read_headers(bag, topic.name)
        parts = _parts_a_turn(bag, topic.name) if topic.msgtype == CLOUD_TYPE else 1
        begins = _first_of_groups(_without_pause(stamps, parts), parts) if len(stamps) else []
        counts, stamps = np.diff([*begins, len(stamps)]), stamps[begins]
    first = np.cumsum(counts) - counts
    earlier = np.arange(len(log_time_ns)) - np.searchsorted(log_time_ns, log_time_ns, side="left")
    return CloudIndex(
        topic=topic.name,
        log_time_ns=log_time_ns[first],
        stamp_ns=stamps,
        message_count=counts,
        earlier=earlier[first],
        usable=_usable(stamps, log_time_ns[first]),
        frames=frames,
    )


def _first_of_groups(joins: BoolArray, size: int) -> list[int]:
    """Split a sequence into groups of up to `size`. joins: (m - 1,) what may share a group."""
    first, count = [0], 1
    for i, joined in enumerate(joins.tolist(), start=1):
        count = count + 1 if joined and count < size else 1
        if count == 1:
            first.append(i)
    return first


def _without_pause(stamps: IntArray, parts: int) -> BoolArray:
    """Find the steps (m - 1,) within a revolution; a bag may contain every message twice."""
    steps = np.diff(stamps)
    usual_ns = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    return np.asarray((steps >= 0) & (steps < max(1.5, _PAUSE * parts) * usual_ns))


def read_headers(bag: Bag, topic: str) -> tuple[IntArray, IntArray, tuple[str, ...]]:
    """Read log times and stamps (m,) of a topic's messages, and their frames without rare ones.

    Seconds and nanoseconds are at bytes 4 to 12 in ROS 1 and in CDR, then the frame's length and
    name.
    """
    times_ns, heads = [], []
    for time_ns, head in bag.heads(topic, _HEADER_BYTES):
        times_ns.append(time_ns)
        heads.append(head.ljust(_HEADER_BYTES, b"\0"))
    # The second byte of CDR is odd for little-endian; ROS 1 always is.
    order = "<u4" if bag.ros_version == 1 or not heads or heads[0][1] & 1 else ">u4"
    words = np.frombuffer(b"".join(heads), order).reshape(-1, _HEADER_BYTES // 4).astype(np.int64)
    names = (head[16 : 16 + n] for head, n in zip(heads, words[:, 3].tolist(), strict=True))
    frames = Counter(
        name.split(b"\0")[0].decode(errors="replace").removeprefix("/") for name in names
    )
    few = _FRAME_SHARE_MIN * len(heads)
    return (
        np.array(times_ns, np.int64),
        words[:, 1] * 1_000_000_000 + words[:, 2],
        tuple(sorted(name for name, count in frames.items() if name and count > few)),
    )


def _usable(stamps: IntArray, log_time_ns: IntArray) -> BoolArray:
    """Find the clouds whose stamps increase."""
    usable = np.zeros(len(stamps), bool)
    steps = np.diff(stamps)
    leap_ns = _OUTLIER_PERIODS * float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    last: int | None = None
    for i, stamp in enumerate(stamps.tolist()):
        if last is not None and stamp <= last:
            continue
        # A stamp far ahead of those that follow is the wrong one, not they.
        if last is None or stamp - last > leap_ns:
            following = stamps[i + 1 : i + 1 + _LOOK_AHEAD]
            if 2 * np.count_nonzero(following < stamp) > len(following):
                continue
        usable[i] = True
        last = stamp
    kept = np.flatnonzero(usable)
    if len(kept):
        # A leap in which no time passed separates stretches; short ones are wrong. The first
        # cloud of a driver that has no time yet may be stamped 0. In a pause, time passes.
        steps = np.diff(stamps[kept])
        leaps = (steps > leap_ns) & (2 * np.diff(log_time_ns[kept]) < steps)
        stretch = np.concatenate([[0], np.cumsum(leaps)])
        lengths = np.bincount(stretch)
        if lengths.max() >= _STRETCH_MIN:
            usable[kept] = lengths[stretch] >= _STRETCH_MIN
    return usable


def _parts_a_turn(bag: Bag, topic: str) -> int:
    """Count the successive clouds that make up a revolution.

    Clouds are parts of a revolution where each sees a part of the directions, and the next begins
    where it ended.
    """
    parts = _count_parts(list(_views(bag, topic, _VIEWS)))
    # Many parts are counted over several revolutions.
    return parts if parts <= _PARTS_FEW else _count_parts(list(_views(bag, topic, _VIEWS_OF_MANY)))


def _count_parts(views: Sequence[tuple[float, float]]) -> int:
    if len(views) < 20:
        return 1
    azimuth, share = np.array(views).T
    mean = np.mean(np.exp(1j * np.diff(azimuth)))
    step = abs(float(np.angle(mean))) / (2 * np.pi)
    if abs(mean) < _STEPS_ALIKE or step < 1 / _PARTS_MAX:
        return 1
    # A lidar that turns by more than half a revolution seems to turn the other way round.
    steps = [each for each in (step, 1 - step) if np.median(share) < each + 3 / _SECTORS]
    return max(round(1 / min(steps)), 1) if steps else 1


def _views(bag: Bag, topic: str, count: int) -> Iterator[tuple[float, float]]:
    """Yield the first return's azimuth and the share of directions with returns.

    Of the first `count` clouds, without damaged ones. A cloud without returns begins where the
    one before did.
    """
    azimuth = None
    for raw in islice(bag.messages([topic]), count):
        with suppress(InputError):
            message = bag.deserialize(raw)
            points = points_of(message, describe_layout(message, topic))
            points = points[:: len(points) // _VIEW_POINTS | 1]  # Odd: rows have even lengths
            x, y = (points[axis].astype(np.float64) for axis in "xy")
            valid = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
            turn = np.arctan2(y[valid], x[valid])
            azimuth = turn[0] if len(turn) else azimuth
            sector = np.floor(turn / (2 * np.pi) * _SECTORS) % _SECTORS
            if azimuth is not None:
                yield azimuth, len(np.unique(sector)) / _SECTORS
