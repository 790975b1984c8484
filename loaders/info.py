"""Everything that `ffmap info` says about a bag: what is in it, what it is good for, what is missing."""

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.loaders.bag import Bag, Message, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_checks import check_one_lidar, clock_problem, stamp_problem
from ffmap.loaders.cloud_index import CloudIndex, index_clouds
from ffmap.loaders.decoding import CloudDecoding, TimeFrom, decode, settle_decoding
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.frames import FrameTree, read_frame_tree
from ffmap.loaders.own_body import without_own_body
from ffmap.loaders.pointcloud2 import CLOUD_TYPE
from ffmap.loaders.rig import Rig
from ffmap.loaders.scans import SkippedScan, read_scans, sample_messages
from ffmap.loaders.sensors import CLOUDS_WANTED, cloud_topics, unread_topics
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC

_SAMPLES = 8
_READ_MAX = 400  # Maximum number of a lidar's clouds that are read to the last point: more would take minutes


@dataclass(frozen=True, eq=False)
class CloudInfo:
    """A topic with clouds.

    decoded: whether its messages are made clouds here: raw packets, or a driver's own kind.
    points: valid points and all places of a cloud, medians.
    read_count: clouds from all over the bag that were read to the last point; bad_clouds: why those of them with a right
        stamp that give no scan do not, and how many they are, the commonest first.
    decoding: how the clouds are read; None where they cannot be, and `problem` says why.
    """

    index: CloudIndex
    decoded: bool
    points: tuple[int, int]
    read_count: int
    bad_clouds: tuple[tuple[str, int], ...]
    decoding: CloudDecoding | None
    problem: str | None


@dataclass(frozen=True, eq=False)
class BagInfo:
    """A bag, closed, as `ffmap info` prints it.

    tree: what /tf_static (or the unchanging part of /tf) says.
    rig: lidars with their roles and the reasons; None where they cannot be told, and `rig_problem` says why.
    missing: what the bag lacks and what that means, one line each.
    """

    bag: Bag
    size_bytes: int
    clouds: tuple[CloudInfo, ...]
    tree: FrameTree
    rig: Rig | None
    rig_problem: str | None
    missing: tuple[str, ...]
    warnings: tuple[str, ...]


def describe_bag(
    path: BagPath | Path,
    rig_file: Path | None = None,
    horizontal: str | None = None,
    verticals: Sequence[str] = (),
    time_from: TimeFrom = "auto",
) -> BagInfo:
    """Look a bag over; the options are those of `find_rig`.

    Raises InputError where the bag cannot be opened, or does not fit what is said of it.
    """
    with open_bag(path) as bag:
        clouds = tuple(_describe_cloud(bag, topic, time_from) for topic in cloud_topics(bag))
        frames = {c.index.topic: c.decoding.layout.frame_id for c in clouds if c.decoding}
        tree = read_frame_tree(bag, {topic: frame for topic, frame in frames.items() if frame})
        rig, problem = None, None
        try:
            rig = without_own_body(bag, find_rig(bag, rig_file, horizontal, verticals, time_from))
        except InputError as error:
            # What the bag lacks is what is asked for; what the user says of it has to be right.
            if rig_file is not None or horizontal is not None or verticals:
                raise
            problem = str(error)
        size = sum(map(size_of, bag.path.parts))
        told = rig.warnings if rig else tuple(cloud.problem for cloud in clouds if cloud.problem)
        warnings = (*bag.warnings, *told, *_clock_warnings(rig, clouds))
        return BagInfo(bag, size, clouds, tree, rig, problem, tuple(_missing(bag, clouds, tree, rig)), warnings)


def size_of(path: Path) -> int:
    """Bytes of a file, or of the files in a folder."""
    return sum(file.stat().st_size for file in path.iterdir()) if path.is_dir() else path.stat().st_size


def _clock_warnings(rig: Rig | None, clouds: Sequence[CloudInfo]) -> list[str]:
    if rig is None or rig.horizontal is None:
        return []
    indexes = {cloud.index.topic: cloud.index for cloud in clouds}
    horizontal = indexes[rig.horizontal.topic]
    problems = (clock_problem(horizontal, indexes[lidar.topic]) for lidar in rig.verticals)
    return [problem for problem in problems if problem]


def _describe_cloud(bag: Bag, topic: str, time_from: TimeFrom) -> CloudInfo:
    index = index_clouds(bag, topic)
    messages, decoding, problem = [], None, stamp_problem(index)
    try:
        messages = sample_messages(bag, index, _SAMPLES)
        decoding = settle_decoding(messages, topic, time_from, index.period_ns)
        check_one_lidar(index, decoding)
    except CloudError as error:
        problem = str(error)
    counts = _point_counts(messages, decoding) if decoding else []
    read_count, bad_clouds = _bad_clouds(bag, index, decoding) if decoding else (0, ())
    valid, places = np.median(counts, axis=0).astype(int).tolist() if counts else (0, 0)
    decoded = bag.topics[topic].msgtype != CLOUD_TYPE
    return CloudInfo(index, decoded, (valid, places), read_count, bad_clouds, decoding, problem)


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


def ring_words(decoding: CloudDecoding) -> str:
    """How many rings there are, at which elevations, and where they come from."""
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


def time_words(decoding: CloudDecoding) -> str:
    """Where the times of the firings come from."""
    time = decoding.time
    if decoding.time_from == "azimuth":
        return "recovered from the azimuth"
    if decoding.time_from == "none":
        return "not used"
    if time is None:
        names = " and ".join(decoding.layout.time_fields)
        return f"none (field {names} is not filled, or its unit cannot be told)" if names else "none"
    meant = {
        "stamp": "relative to the stamp",
        "epoch": "absolute",
        "own clock": "absolute on the sensor's own clock; the stamp is taken for the sweep's start",
    }[time.reference]
    return f"field {time.name} in {time.unit}, {meant}, a sweep spans {time.span_ns / 1e6:.1f} ms"


def _missing(bag: Bag, clouds: tuple[CloudInfo, ...], tree: FrameTree, rig: Rig | None) -> list[str]:
    if bag.start_ns is None:
        return ["messages: the bag is empty"]
    lines = [] if rig else list(unread_topics(bag).values())
    if not clouds:
        lines.append(f"clouds: without {CLOUDS_WANTED} there is nothing to do")
    for cloud in clouds:
        decoding, topic = cloud.decoding, cloud.index.topic
        if decoding and decoding.rings.source not in ("field", "row", "column"):
            lines.append(f"rings on {topic}: {ring_words(decoding)}")
        if decoding and decoding.time is None:
            lines.append(
                f"times on {topic}: motion compensation is off; --time-from azimuth recovers them unless the clouds are "
                "compensated already"
            )
    if clouds and not tree.edges:
        needed = "one lidar needs none" if len(clouds) == 1 else "several lidars need --rig FILE.toml"
        lines.append(f"transforms: {f'{rig.mounts_from} says where the lidars sit' if rig else needed}")
    if rig and not rig.verticals:
        lines.append("a vertical lidar: there is a trajectory and a recording, and nothing to label")
    if not any(name in bag.topics for name in (POSE_TOPIC, CLASSES_TOPIC, BUILDING_TOPIC)):
        lines.append("truth: no figures can be computed")
    return lines
