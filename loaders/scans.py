"""From a bag's messages to scans: one cloud a revolution, numbered over the whole bag, read in any slice.

Some recordings hold one PointCloud2 for each UDP packet, some 75 a revolution (Cartographer's backpack): these are
gathered, a new cloud beginning where the azimuth comes round. Where a driver cuts at half a revolution, or a third, the
clouds that make up one are gathered by their number.
"""

import traceback
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import islice
from weakref import WeakKeyDictionary

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan, in_canonical_order
from ffmap.algorithms.base.trajectory import gaps
from ffmap.loaders.bag import Bag, Message, RawMessage, Topic
from ffmap.loaders.cloud_digest import digest_of
from ffmap.loaders.errors import CloudError, InputError, shortened
from ffmap.loaders.pointcloud2 import (
    CLOUD_TYPE,
    CloudDecoding,
    CloudLayout,
    decode,
    describe_layout,
    field_column,
)
from ffmap.loaders.sensors import sensor_of, unread_topics
from ffmap.loaders.sensors.sensor import Sensor

_HEADER_BYTES = 16 + 64  # Up to the frame's name
_FRAME_SHARE_MIN = 0.05  # Of a topic's clouds; a few odd ones are no second lidar
_SWEEPS_OVERLAP = 1.5  # Sweeps of one lidar follow each other (1), those of two on one topic overlap (2)
_PART_NS = 4_000_000  # Clouds that come closer than this are parts of a revolution: no lidar spins at 250 Hz
_LEAD_POINTS = 32
_LEADS = 100  # Number of clouds whose first returns show whether they are parts of a revolution
_LEADS_ALIKE = 0.8  # Minimum mean resultant length of the steps between them; without any order it is near 0
_SECTORS = 36
_OUTLIER_PERIODS = 10
_LOOK_AHEAD = 1000  # Number of following clouds that decide whether the clock was set or one stamp is wrong
_STRETCH_MIN = 3  # Minimum number of clouds between two leaps of the stamps; fewer are stamped wrongly
_GAPS_NAMED = 3
_APART_NS = 1_000_000_000  # Maximum delay between a cloud's stamp and its recording


@dataclass(frozen=True, eq=False)
class CloudIndex:
    """Where the clouds of a topic lie: one row a revolution, skipped ones included, in the order of log time.

    log_time_ns: (m,) int64, of the revolution's first message.
    stamp_ns: (m,) int64, header stamp of the revolution's first message.
    message_count: (m,) int64, messages a revolution; 1 unless the topic has one for each packet.
    earlier: (m,) int64, messages of the topic with the very same log time that come before the revolution's first.
    usable: (m,) bool, False where the stamp repeats or jumps back behind that of an earlier cloud, or jumps ahead of
        most that follow.
    frames: frames that the messages name, without those of a few.
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
        """The same with up to `clouds` successive ones as one, which has the first one's stamp.

        A cloud that is not usable stays alone, and none is joined across a pause.
        """
        if clouds == 1 or not len(self):
            return self
        steps = np.diff(self.stamp_ns)
        goes_on = self.usable[1:] & self.usable[:-1] & (steps < 1.5 * (self.period_ns or 0))
        first, count = [0], 1
        for i, joins in enumerate(goes_on.tolist(), start=1):
            count = count + 1 if joins and count < clouds else 1
            if count == 1:
                first.append(i)
        rows = {name: getattr(self, name)[first] for name in ("log_time_ns", "stamp_ns", "earlier", "usable")}
        return replace(self, message_count=np.add.reduceat(self.message_count, first), **rows)

    def until(self, stop_ns: int) -> "CloudIndex":
        """The clouds before the first one that is stamped at that time or later."""
        count = int(np.argmax(np.append(self.stamp_ns >= stop_ns, True)))
        arrays = {f.name: getattr(self, f.name)[:count] for f in fields(self) if f.name not in ("topic", "frames")}
        return replace(self, **arrays)

    @property
    def period_ns(self) -> int | None:
        """The usual time between two clouds; None for fewer than two."""
        steps = np.diff(self.stamp_ns[self.usable])
        return int(np.median(steps)) if len(steps) else None

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Stamp of the last cloud before each gap, and the gap's length, in nanoseconds."""
        stamps = self.stamp_ns[self.usable]
        return [(int(stamps[i]), int(stamps[i + 1] - stamps[i])) for i in gaps(stamps)]

    @property
    def lead_ns(self) -> float:
        """How far the stamps are ahead of the times at which the clouds were recorded, the median."""
        return float(np.median((self.stamp_ns - self.log_time_ns)[self.usable]))


@dataclass(frozen=True)
class SkippedScan:
    """A cloud that gives no scan, and why. stamp_ns: its stamp; where that is wrong, the one beside it that is right: a
    day ahead would stretch a recording's time. trace: of the exception that its data raised; empty where none was raised.
    """

    index: int
    stamp_ns: int
    reason: str
    trace: str = ""

    @classmethod
    def failed(cls, index: int, stamp_ns: int, error: Exception) -> "SkippedScan":
        """A cloud whose data raised an exception. Raises it again where another cause is certain: memory, disk, input."""
        if isinstance(error, MemoryError | OSError | InputError):
            raise error
        reason = f"{type(error).__name__}: {shortened(error)}"
        return cls(index, stamp_ns, reason, "".join(traceback.format_exception(error)))


_indices: WeakKeyDictionary[Bag, dict[str, CloudIndex]] = WeakKeyDictionary()
"""Of each open bag, by topic: to read all headers of a large bag takes seconds, and several steps of opening it ask."""


def index_clouds(bag: Bag, topic: str) -> CloudIndex:
    """All clouds of a topic, from the headers and first points of its messages, which are read once for an open bag.

    Raises InputError where it holds no clouds, and where two files of the bag hold clouds of the same time.
    """
    known, found = _indices.setdefault(bag, {}), bag.topic(topic)
    if found.name not in known:
        known[found.name] = _index_clouds(bag, found)
    return known[found.name]


def _index_clouds(bag: Bag, found: Topic) -> CloudIndex:
    sensor = sensor_of(found)
    if sensor is None or sensor.unread_reason(bag, found):
        raise InputError(f"{bag.path.name}: topic {found.name} is {found.msgtype}, no point cloud; {cloud_hint(bag)}")
    bag.check_recorded_once(found.name)
    log_time_ns, counts, stamps, frames = _find_revolutions(bag, found, sensor)
    first = np.cumsum(counts) - counts
    earlier = np.arange(len(log_time_ns)) - np.searchsorted(log_time_ns, log_time_ns, side="left")
    index = CloudIndex(
        topic=found.name,
        log_time_ns=log_time_ns[first],
        stamp_ns=stamps,
        message_count=counts,
        earlier=earlier[first],
        usable=_usable(stamps, log_time_ns[first]),
        frames=frames,
    )
    whole = found.msgtype != CLOUD_TYPE or len(first) < len(log_time_ns)
    return index if whole else index.gathered(_clouds_a_turn(bag, found.name))


def _find_revolutions(
    bag: Bag, topic: Topic, sensor: Sensor
) -> tuple[IntArray, IntArray, IntArray, tuple[str, ...]]:
    """Log times (m,) of a topic's messages; number of messages (r,) and stamp (r,) of each revolution; frames."""
    if found := sensor.index(bag, topic.name):
        return *found, ()
    log_time_ns, stamps, frames = read_headers(bag, topic.name)
    counts: IntArray = np.ones(len(stamps), np.int64)
    if topic.msgtype == CLOUD_TYPE and _are_parts(stamps, log_time_ns):
        counts = _revolutions(bag, topic.name, stamps)
    return log_time_ns, counts, stamps[np.cumsum(counts) - counts], frames


def check_one_lidar(index: CloudIndex, decoding: CloudDecoding) -> None:
    """Raises CloudError where the clouds of a topic are those of two lidars, by their frames or their times."""
    fix = "record each lidar on a topic of its own (Livox: multi_topic 1), or split the topic"
    if len(index.frames) > 1:
        named = " and ".join(index.frames)
        raise CloudError(f"{index.topic}: two lidars on one topic, with frames {named}; {fix} by frame")
    stamps = index.stamp_ns[index.usable]
    if decoding.time is None or len(stamps) < 3:
        return
    # Of two lidars every other step is short.
    step_ns = float(np.median(stamps[2:] - stamps[:-2])) / 2
    if decoding.time.span_ns > _SWEEPS_OVERLAP * step_ns:
        raise CloudError(
            f"{index.topic}: two lidars on one topic, its sweeps take {decoding.time.span_ns / 1e6:.0f} ms and begin "
            f"every {step_ns / 1e6:.0f} ms; {fix}"
        )


def stamp_problem(index: CloudIndex) -> str | None:
    """Why the clouds of a topic cannot be put in order of time; None where they can."""
    if len(index) < 2 or np.count_nonzero(index.usable) > 1:
        return None
    same = not np.any(np.diff(index.stamp_ns))
    what = f"have the same stamp, {index.stamp_ns[0] / 1e9:.3f} s" if same else "have stamps that do not increase"
    return (
        f"{index.topic}: all {len(index)} clouds {what}, so that nothing tells when they were taken; record them with a driver "
        "that stamps them"
    )


def clock_problem(index: CloudIndex, other: CloudIndex) -> str | None:
    """Why two lidars cannot have stamped their clouds by one clock; None where they may have."""
    if min(len(index), len(other)) < 2 or stamp_problem(index) or stamp_problem(other):
        return None
    ahead_ns = other.lead_ns - index.lead_ns
    stamps, others = (each.stamp_ns[each.usable] for each in (index, other))
    if abs(ahead_ns) > _APART_NS:
        return (
            f"the clocks of {index.topic} and {other.topic} are apart: the stamps of {other.topic} are "
            f"{abs(ahead_ns) / 1e9:.1f} s {'ahead' if ahead_ns > 0 else 'behind'}, by the times at which the bag recorded "
            "both; set the lidars to one clock (PTP), or shift that topic's stamps"
        )
    if others[0] > stamps[-1] or others[-1] < stamps[0]:
        return (
            f"{index.topic} and {other.topic} share no time: their stamps run from {stamps[0] / 1e9:.1f} to "
            f"{stamps[-1] / 1e9:.1f} s and from {others[0] / 1e9:.1f} to {others[-1] / 1e9:.1f} s; if both were recorded "
            "together their clocks are apart: set the lidars to one clock (PTP), or shift one topic's stamps"
        )
    return None


def gap_problem(index: CloudIndex) -> str | None:
    """Where clouds are missing, the longest gaps first; None where none are."""
    found = sorted(index.gaps, key=lambda gap: -gap[1])
    if not found:
        return None
    first_ns = index.stamp_ns[index.usable][0]
    named = ", ".join(f"{long_ns / 1e9:.1f} s after {(at_ns - first_ns) / 1e9:.1f} s" for at_ns, long_ns in found[:_GAPS_NAMED])
    more = f" and in {len(found) - _GAPS_NAMED} shorter gaps" if len(found) > _GAPS_NAMED else ""
    return f"{index.topic} has no clouds for {named}{more}: the driver or the recorder lost them"


def cloud_topics(bag: Bag) -> list[str]:
    """Topics with clouds or packets of a lidar that are read, but for the truth's."""
    unread = unread_topics(bag)
    filled = (t for t in bag.topics.values() if t.count and not t.name.startswith("/truth/"))
    return [t.name for t in filled if sensor_of(t) and t.name not in unread]


def cloud_hint(bag: Bag) -> str:
    """The end of an error message: which topics would do."""
    topics = cloud_topics(bag)
    known = f"the bag's clouds are on: {', '.join(topics)}" if topics else "the bag has no clouds"
    return "; ".join([known, *unread_topics(bag).values()])


def read_headers(bag: Bag, topic: str) -> tuple[IntArray, IntArray, tuple[str, ...]]:
    """Log times and header stamps (m,) of a topic's messages, and the frames of more than a few of them.

    Seconds and nanoseconds are at bytes 4 to 12 in ROS 1 and in CDR, the frame's name follows its length.
    """
    times_ns, heads = [], []
    for time_ns, head in bag.heads(topic, _HEADER_BYTES):
        times_ns.append(time_ns)
        heads.append(head.ljust(_HEADER_BYTES, b"\0"))
    # CDR says in its second byte whether it is little-endian; ROS 1 always is.
    little = bag.ros_version == 1 or not heads or heads[0][1] & 1
    words = np.frombuffer(b"".join(heads), "<u4" if little else ">u4").reshape(-1, _HEADER_BYTES // 4).astype(np.int64)
    frames = Counter(head[16 : 16 + length] for head, length in zip(heads, words[:, 3].tolist(), strict=True))
    named = [name for name, count in frames.items() if name.strip(b"\0") and count > _FRAME_SHARE_MIN * len(heads)]
    decoded = sorted({name.split(b"\0")[0].decode(errors="replace").removeprefix("/") for name in named})
    return np.array(times_ns, np.int64), words[:, 1] * 1_000_000_000 + words[:, 2], tuple(decoded)


def _are_parts(stamps: IntArray, log_time_ns: IntArray) -> bool:
    """Whether the messages of a topic come so fast that they are parts of revolutions.

    Where most stamps repeat, the times at which they were recorded tell: a bag may hold every message twice.
    """
    if len(stamps) < 20:
        return False
    repeat = np.mean(np.diff(stamps) == 0) >= 0.5
    steps = np.diff(log_time_ns if repeat else stamps)
    return bool(np.any(steps > 0) and np.median(steps[steps > 0]) < _PART_NS)


def _usable(stamps: IntArray, log_time_ns: IntArray) -> BoolArray:
    """Clouds whose stamps go on from those before."""
    usable = np.zeros(len(stamps), bool)
    steps = np.diff(stamps)
    period = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    last: int | None = None
    for i, stamp in enumerate(stamps.tolist()):
        if last is not None and stamp <= last:
            continue
        # A stamp far ahead would make all that follow jump back: it is the odd one, not they.
        if last is None or stamp - last > _OUTLIER_PERIODS * period:
            following = stamps[i + 1 : i + 1 + _LOOK_AHEAD]
            if 2 * np.count_nonzero(following < stamp) > len(following):
                continue
        usable[i] = True
        last = stamp
    kept = np.flatnonzero(usable)
    usable[kept] = ~_in_short_stretches(stamps[kept], log_time_ns[kept], _OUTLIER_PERIODS * period)
    return usable


def _in_short_stretches(stamps: IntArray, log_time_ns: IntArray, leap_ns: float) -> BoolArray:
    """Clouds (m,) before or after a leap of the stamps in which no time passed, with too few clouds beside them.

    The first cloud of a driver that has no time yet is stamped 0, say. A pause is no leap: time passed.
    """
    steps = np.diff(stamps)
    leaps = (steps > leap_ns) & (2 * np.diff(log_time_ns) < steps)
    stretch = np.concatenate([[0], np.cumsum(leaps)])[: len(stamps)]
    lengths = np.bincount(stretch, minlength=1)
    if lengths.max() < _STRETCH_MIN:
        return np.zeros(len(stamps), bool)
    return np.asarray(lengths[stretch] < _STRETCH_MIN)


def _revolutions(bag: Bag, topic: str, stamps: IntArray) -> IntArray:
    """How many messages each revolution has, from the azimuth of each message's first returns."""
    azimuth = _azimuths(bag, topic)
    steps = np.mod(np.diff(azimuth) + np.pi, 2 * np.pi) - np.pi
    direction = 1.0 if np.nanmedian(steps) > 0 else -1.0
    phase = np.maximum.accumulate(np.concatenate([[0.0], np.nancumsum(direction * steps)]))
    turn = np.floor(phase / (2 * np.pi) + 1e-9).astype(np.int64)
    # A pause longer than half a revolution ends the cloud, whatever the azimuth.
    turns = max(float(phase[-1]) / (2 * np.pi), 1.0)
    period = float(np.sum(np.minimum(np.diff(stamps), 10 * _PART_NS))) / turns
    begins = (np.diff(turn) > 0) | (np.diff(stamps) > period / 2)
    edges = np.concatenate([[0], np.flatnonzero(begins) + 1, [len(stamps)]])
    return np.diff(edges)


def _clouds_a_turn(bag: Bag, topic: str) -> int:
    """Number of successive clouds that make up a revolution; 1 where each is one.

    Clouds are parts of a revolution where each sees a part of the directions, and the next begins where it ended.
    """
    azimuth = _azimuths(bag, topic, _LEADS)
    if len(azimuth) < 20:
        return 1
    mean = np.mean(np.exp(1j * np.diff(azimuth)))
    step = abs(float(np.angle(mean))) / (2 * np.pi)
    if abs(mean) < _LEADS_ALIKE or step < 1 / _SECTORS:
        return 1
    seen = float(np.nanmedian([_seen(bag, raw) for raw in islice(bag.messages([topic]), 8)]))
    # The other way round for a lidar that turns by more than half a revolution.
    steps = [share for share in (step, 1 - step) if seen < share + 3 / _SECTORS]
    return max(round(1 / min(steps)), 1) if steps else 1


def _seen(bag: Bag, raw: RawMessage) -> float:
    """Share of the directions about the spin axis that have returns in a cloud; NaN where it is damaged."""
    try:
        message = bag.deserialize(raw)
        layout = describe_layout(message, raw.topic)
    except InputError:
        return float("nan")
    x, y = (field_column(message, layout, axis).astype(np.float64) for axis in "xy")
    valid = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
    sectors = np.floor(np.arctan2(y[valid], x[valid]) / (2 * np.pi) * _SECTORS)
    return len(np.unique(sectors % _SECTORS)) / _SECTORS


def _azimuths(bag: Bag, topic: str, count: int | None = None) -> FloatArray:
    """Azimuth (m,) in radians of the first return among the first points of each message, or of some from the first on;
    without a return, that of the message before.
    """
    found = _first_layout(bag, topic)
    if found is None:
        return np.zeros(bag.topic(topic).count)
    data_at, layout = found
    lead_bytes = _LEAD_POINTS * layout.point_step
    azimuths, heads = [], list[bytes]()
    for _, head in islice(bag.heads(topic, data_at + lead_bytes), count):
        heads.append(head[data_at:].ljust(lead_bytes, b"\0"))
        if len(heads) == 4096:
            azimuths.append(_lead_azimuths(heads, layout))
            heads = []
    azimuths.append(_lead_azimuths(heads, layout))
    azimuth = np.concatenate(azimuths)
    known = np.flatnonzero(np.isfinite(azimuth))
    if not len(known):
        return np.zeros(len(azimuth))
    # Messages without a return keep the direction of the one before.
    before = known[np.maximum(np.searchsorted(known, np.arange(len(azimuth)), side="right") - 1, 0)]
    return np.asarray(azimuth[before])


def _first_layout(bag: Bag, topic: str) -> tuple[int, CloudLayout] | None:
    """Where in a message the points begin, and their layout, by the first message with points; None where none is
    sound. Header and fields are alike in every message.
    """
    for raw in bag.messages([topic]):
        try:
            message = bag.deserialize(raw)
            layout = describe_layout(message, topic)
        except InputError:
            continue
        if layout.height * layout.width:
            # is_dense, one byte, is all that follows the points.
            return len(raw.data) - 1 - len(message.data), layout
    return None


def _lead_azimuths(heads: list[bytes], layout: CloudLayout) -> FloatArray:
    points = np.frombuffer(b"".join(heads), layout.point).reshape(-1, _LEAD_POINTS)
    x, y = points["x"].astype(np.float64), points["y"].astype(np.float64)
    valid = np.isfinite(x) & np.isfinite(y) & ((x != 0) | (y != 0))
    row = np.arange(len(points))
    first = valid.argmax(axis=1) if len(points) else row
    return np.where(valid.any(axis=1), np.arctan2(y[row, first], x[row, first]), np.nan)


def read_messages(
    bag: Bag, index: CloudIndex, first: int = 0, count: int | None = None, digests: list[bytes] | None = None
) -> Iterator[tuple[int, Message]]:
    """Clouds [first, first + count) as PointCloud2 messages: packets and partial clouds joined to revolutions, Livox's own
    turned into one each.

    A CloudError in place of the message says that it cannot be made one. digests: takes the digests of each cloud's
    messages as it is read.
    """
    sensor = sensor_of(bag.topics[index.topic])
    assert sensor is not None
    to_cloud = sensor.decoder(bag, index.topic)
    for i, group in _gathered(bag, index, first, count):
        if digests is not None:
            digests.extend(map(digest_of, group))
        # Of a part that was recorded twice, one will do.
        kept = [raw for k, raw in enumerate(group) if not k or raw.data != group[k - 1].data]
        try:
            yield i, to_cloud(kept, int(index.stamp_ns[i]))
        except InputError as error:
            yield i, error if isinstance(error, CloudError) else CloudError(str(error))


def read_digests(bag: Bag, index: CloudIndex, first: int = 0, count: int | None = None) -> Iterator[bytes]:
    """The digest of each message of the clouds [first, first + count), none of them decoded."""
    for _, group in _gathered(bag, index, first, count):
        yield from map(digest_of, group)


def _gathered(bag: Bag, index: CloudIndex, first: int, count: int | None) -> Iterator[tuple[int, list[RawMessage]]]:
    """The messages that make up each of the clouds [first, first + count)."""
    stop = len(index) if count is None else min(first + count, len(index))
    if first >= stop:
        return
    raws = islice(bag.messages([index.topic], start_ns=int(index.log_time_ns[first])), int(index.earlier[first]), None)
    for i in range(first, stop):
        group = list(islice(raws, int(index.message_count[i])))
        if not group:
            return
        yield i, group


def read_scans(
    bag: Bag,
    index: CloudIndex,
    first: int,
    count: int | None,
    decoding: CloudDecoding,
    digests: list[bytes] | None = None,
) -> Iterator[tuple[int, Scan | SkippedScan]]:
    """Clouds [first, first + count) as scans with their number in the bag.

    A cloud that cannot be read, one without a valid point, one that contradicts itself, and one
    whose stamp does not go on from those before are SkippedScans. digests: as in `read_messages`.
    """
    for i, message in read_messages(bag, index, first, count, digests):
        stamp = int(index.stamp_ns[i])
        if isinstance(message, CloudError):
            yield i, SkippedScan(i, stamp, str(message))
            continue
        if not index.usable[i]:
            yield i, SkippedScan(i, int(index.stamp_ns[_right_beside(index, i)]), _stamp_reason(index, i))
            continue
        try:
            scan = in_canonical_order(decode(message, decoding))
        except CloudError as error:
            yield i, SkippedScan(i, stamp, str(error))
            continue
        except Exception as error:
            yield i, SkippedScan.failed(i, stamp, error)
            continue
        if not scan.cloud_size:
            yield i, SkippedScan(i, stamp, "no points")
        elif not len(scan):
            yield i, SkippedScan(i, stamp, "no valid point: all are NaN, infinite or zero")
        else:
            yield i, scan


def sample_messages(bag: Bag, index: CloudIndex, count: int) -> list[Message]:
    """Clouds from all over the bag, sound ones only. Raises CloudError where there are clouds and none of these is sound."""
    places = sorted({round(place) for place in np.linspace(0, len(index) - 1, count)}) if len(index) else []
    found = [message for i in places for _, message in read_messages(bag, index, i, 1)]
    sound = [message for message in found if not isinstance(message, CloudError)]
    if found and not sound:
        raise found[0]
    return sound


def _right_beside(index: CloudIndex, i: int) -> int:
    """The last cloud before this one whose stamp is right, or the first after it; there always is one."""
    right = np.flatnonzero(index.usable)
    return int(right[max(int(np.searchsorted(right, i)) - 1, 0)])


def _stamp_reason(index: CloudIndex, i: int) -> str:
    step_ns = int(index.stamp_ns[i]) - int(index.stamp_ns[_right_beside(index, i)])
    if step_ns == 0:
        return "stamp repeats that of the cloud before"
    return f"stamp jumps {'back' if step_ns < 0 else 'ahead'} by {abs(step_ns) / 1e9:.3f} s"
