"""Everything that `ffmap info` says about a bag: what is in it, what it is good for, what is missing."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.loaders.bag import Bag, Container, Message, open_bag
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.frames import FrameTree, StaticTransform, read_frame_tree
from ffmap.loaders.packets import PACKET_TYPE
from ffmap.loaders.pointcloud2 import CloudDecoding, TimeFrom, decode, settle_decoding
from ffmap.loaders.rig import Rig, find_rig
from ffmap.loaders.scans import (
    CloudIndex,
    SkippedScan,
    clock_problem,
    cloud_topics,
    index_clouds,
    read_scans,
    sample_messages,
    stamp_problem,
)
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC

_SAMPLES = 8
_GAP_PERIODS = 2.5
_READ_MAX = 400  # Maximum number of a lidar's clouds that are read to the last point: more would take minutes


@dataclass(frozen=True)
class TopicInfo:
    """rate_hz: messages by the bag's length; None for fewer than two."""

    name: str
    msgtype: str
    count: int
    rate_hz: float | None


@dataclass(frozen=True)
class Gap:
    """A pause between two clouds; start_ns is the stamp of the last one before it."""

    start_ns: int
    duration_ns: int


@dataclass(frozen=True, eq=False)
class CloudInfo:
    """A topic with clouds.

    frame_id: with the bag's own spelling but for a leading slash; empty where no cloud can be read.
    cloud_count: revolutions; messages_per_cloud is above 1 where each message is a packet's worth.
    unusable_count: clouds whose stamps repeat or jump.
    read_count: clouds from all over the bag that were read to the last point; bad_clouds: why those of them with a right
        stamp that give no scan do not, and how many they are, the commonest first.
    points: valid points and all places of a cloud, medians.
    decoding: how the clouds are read, with layout, rings and times; None where they cannot be, and `problem` says why.
    rings, times: the same in words."""

    topic: str
    packets: bool
    frame_id: str
    cloud_count: int
    messages_per_cloud: float
    rate_hz: float | None
    points: tuple[int, int]
    unusable_count: int
    read_count: int
    bad_clouds: tuple[tuple[str, int], ...]
    gaps: tuple[Gap, ...]
    decoding: CloudDecoding | None
    rings: str
    times: str
    problem: str | None


@dataclass(frozen=True, eq=False)
class BagInfo:
    """A bag as `ffmap info` prints it.

    start_ns, end_ns: log times; None for an empty bag.
    frames, transforms: what /tf_static (or the unchanging part of /tf) says.
    rig: lidars with their roles and the reasons; None where they cannot be told, and `rig_problem` says why.
    missing: what the bag lacks and what that means, one line each."""

    path: Path
    container: Container
    ros_version: int
    size_bytes: int
    start_ns: int | None
    end_ns: int | None
    topics: tuple[TopicInfo, ...]
    clouds: tuple[CloudInfo, ...]
    frames: tuple[str, ...]
    transforms: tuple[StaticTransform, ...]
    rig: Rig | None
    rig_problem: str | None
    missing: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def describe_bag(
    path: Path,
    rig_file: Path | None = None,
    horizontal: str | None = None,
    vertical: str | None = None,
    time_from: TimeFrom = "auto",
) -> BagInfo:
    """Look a bag over; the options are those of `find_rig`.
    Raises InputError where the bag cannot be opened, or does not fit what is said of it."""
    with open_bag(path) as bag:
        indexes = {topic: index_clouds(bag, topic) for topic in cloud_topics(bag)}
        clouds = tuple(_describe_cloud(bag, index, time_from) for index in indexes.values())
        tree = read_frame_tree(bag, {cloud.frame_id for cloud in clouds if cloud.frame_id})
        rig, problem = None, None
        try:
            rig = find_rig(bag, rig_file, horizontal, vertical, time_from)
        except InputError as error:
            # What the bag lacks is what is asked for; what the user says of it has to be right.
            if any(word is not None for word in (rig_file, horizontal, vertical)):
                raise
            problem = str(error)
        return BagInfo(
            path=path,
            container=bag.container,
            ros_version=bag.ros_version,
            size_bytes=sum(p.stat().st_size for p in path.iterdir()) if path.is_dir() else path.stat().st_size,
            start_ns=bag.start_ns,
            end_ns=bag.end_ns,
            topics=_topics(bag),
            clouds=clouds,
            frames=tuple(tree.frames),
            transforms=tree.edges,
            rig=rig,
            rig_problem=problem,
            missing=tuple(_missing(bag, clouds, tree, rig)),
            warnings=(*bag.warnings, *(rig.warnings if rig else ()), *_clock_warnings(rig, indexes)),
        )


def _clock_warnings(rig: Rig | None, indexes: dict[str, CloudIndex]) -> tuple[str, ...]:
    if rig is None or rig.horizontal is None or rig.vertical is None:
        return ()
    problem = clock_problem(indexes[rig.horizontal.topic], indexes[rig.vertical.topic])
    return () if problem is None else (problem,)


def _topics(bag: Bag) -> tuple[TopicInfo, ...]:
    seconds = 0.0 if bag.start_ns is None or bag.end_ns is None else (bag.end_ns - bag.start_ns) / 1e9
    return tuple(
        TopicInfo(t.name, t.msgtype, t.count, (t.count - 1) / seconds if t.count > 1 and seconds > 0 else None)
        for t in bag.topics.values()
    )


def _describe_cloud(bag: Bag, index: CloudIndex, time_from: TimeFrom) -> CloudInfo:
    topic = index.topic
    messages = sample_messages(bag, index, _SAMPLES)
    decoding, problem = None, stamp_problem(index)
    try:
        decoding = settle_decoding(messages, topic, time_from, index.period_ns)
    except CloudError as error:
        problem = str(error)
    counts = _point_counts(messages, decoding) if decoding else []
    read_count, bad_clouds = _bad_clouds(bag, index, decoding) if decoding else (0, ())
    period_ns = index.period_ns
    valid, places = np.median(counts, axis=0).astype(int).tolist() if counts else (0, 0)
    return CloudInfo(
        topic=topic,
        packets=bag.topics[topic].msgtype == PACKET_TYPE,
        frame_id=decoding.layout.frame_id if decoding else "",
        cloud_count=len(index),
        messages_per_cloud=float(np.median(index.message_count)) if len(index) else 0.0,
        rate_hz=1e9 / period_ns if period_ns else None,
        points=(valid, places),
        unusable_count=int(np.count_nonzero(~index.usable)),
        read_count=read_count,
        bad_clouds=bad_clouds,
        gaps=_gaps(index),
        decoding=decoding,
        rings=_ring_words(decoding) if decoding else "",
        times=_time_words(decoding) if decoding else "",
        problem=problem,
    )


def _point_counts(messages: list[Message], decoding: CloudDecoding) -> list[tuple[int, int]]:
    """Valid points and all places of each cloud that can be read."""
    counts = []
    for message in messages:
        with suppress(CloudError):
            scan = decode(message, decoding)
            counts.append((len(scan), scan.cloud_size))
    return counts


def _bad_clouds(bag: Bag, index: CloudIndex, decoding: CloudDecoding) -> tuple[int, tuple[tuple[str, int], ...]]:
    """How many clouds were read, and of those that give no scan the reasons, with how many each is given for."""
    stride = -(-len(index) // _READ_MAX)
    # One after the other, but for a long bag: there each is looked up.
    first = range(1) if stride == 1 else range(0, len(index), stride)
    read_count, reasons = 0, Counter[str]()
    for i in first:
        for number, scan in read_scans(bag, index, i, None if stride == 1 else 1, decoding):
            read_count += 1
            if isinstance(scan, SkippedScan) and index.usable[number]:
                reasons[scan.reason] += 1
    return read_count, tuple(reasons.most_common())


def _gaps(index: CloudIndex) -> tuple[Gap, ...]:
    stamps = index.stamp_ns[index.usable]
    steps = np.diff(stamps)
    if not index.period_ns:
        return ()
    places = np.flatnonzero(steps > _GAP_PERIODS * index.period_ns)
    return tuple(Gap(int(stamps[i]), int(steps[i])) for i in places)


def _ring_words(decoding: CloudDecoding) -> str:
    rings = decoding.rings
    seen = rings.elevation_deg[np.isfinite(rings.elevation_deg)]
    span = f", {seen[0]:+.1f} to {seen[-1]:+.1f} deg" if len(seen) else ""
    source = {
        "field": f"from field {decoding.layout.ring_field}",
        "row": "the cloud's rows",
        "column": "the cloud's columns",
        "elevation": "recovered from the elevations",
        "bins": "not to be told apart: equal slices of elevation",
    }[rings.source]
    return f"{rings.count} rings{span} ({source})"


def _time_words(decoding: CloudDecoding) -> str:
    time = decoding.time
    if decoding.time_from == "azimuth":
        return "recovered from the azimuth"
    if decoding.time_from == "none":
        return "not used"
    if time is None:
        name = decoding.layout.time_field
        return f"none (field {name} is not filled, or its unit cannot be told)" if name else "none"
    meant = {
        "stamp": "relative to the stamp",
        "epoch": "absolute",
        "own clock": "absolute on the sensor's own clock; the stamp is taken for the sweep's start",
    }[time.reference]
    return f"field {time.name} in {time.unit}, {meant}, a sweep spans {time.span_ns / 1e6:.1f} ms"


def _missing(bag: Bag, clouds: tuple[CloudInfo, ...], tree: FrameTree, rig: Rig | None) -> list[str]:
    lines = []
    if bag.start_ns is None:
        return ["messages: the bag is empty"]
    if not clouds:
        lines.append("clouds: without sensor_msgs/PointCloud2 or velodyne_msgs/VelodyneScan there is nothing to do")
    for cloud in clouds:
        if cloud.decoding is None:
            continue
        if cloud.decoding.rings.source not in ("field", "row", "column"):
            lines.append(f"rings on {cloud.topic}: {cloud.rings}")
        if cloud.decoding.time is None:
            lines.append(
                f"times on {cloud.topic}: motion compensation is off; --time-from azimuth recovers them unless the "
                "clouds are compensated already"
            )
    if clouds and not tree.edges:
        lines.append(
            "transforms: one lidar needs none"
            if len(clouds) == 1
            else "transforms: several lidars need --rig FILE.toml"
        )
    if rig and rig.vertical is None:
        lines.append("a vertical lidar: there is a trajectory and a recording, and nothing to label")
    if not any(name in bag.topics for name in (POSE_TOPIC, CLASSES_TOPIC, BUILDING_TOPIC)):
        lines.append("truth: no figures can be computed")
    return lines
