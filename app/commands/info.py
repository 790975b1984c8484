"""ffmap info: the content of a bag, the roles of its lidars, and missing data."""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_checks import check_one_lidar, clock_problem, stamp_problem
from ffmap.loaders.cloud_index import CloudIndex, index_clouds
from ffmap.loaders.decoding import CloudDecoding, TimeFrom, decode, settle_decoding
from ffmap.loaders.errors import CloudError, InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.fingerprint import files_of
from ffmap.loaders.frames import read_frame_tree
from ffmap.loaders.own_body import without_own_body
from ffmap.loaders.pointcloud2 import CLOUD_TYPE
from ffmap.loaders.rig import Rig
from ffmap.loaders.scans import SkippedScan, read_scans, sample_messages
from ffmap.loaders.sensors import CLOUDS_WANTED, cloud_topics, unread_topics
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC

_SAMPLES = 8
_CLOUDS_READ_MAX = 400
"""Maximum number of a lidar's clouds that are decoded: more would take minutes."""
_REASONS_MAX = 3
"""Maximum number of reasons printed for clouds that give no scan."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """A topic with clouds; `decoding` is None where they cannot be read, for the `problem`."""

    index: CloudIndex
    decoding: CloudDecoding | None
    problem: str | None


def describe(
    path: BagPath | Path,
    rig_file: Path | None = None,
    horizontal: str | None = None,
    verticals: Sequence[str] = (),
    time_from: TimeFrom = "auto",
) -> list[str]:
    """Describe a bag, one line for each fact; the options are those of `find_rig`.

    Raises InputError where the bag cannot be opened, or does not match the options.
    """
    with open_bag(path) as bag:
        clouds = [_look(bag, topic, time_from) for topic in cloud_topics(bag)]
        frames = {c.index.topic: c.decoding.layout.frame_id for c in clouds if c.decoding}
        edges = read_frame_tree(bag, {t: frame for t, frame in frames.items() if frame}).edges
        rig, problem = None, ""
        try:
            rig = find_rig(bag, rig_file, horizontal, verticals, time_from)
            rig = without_own_body(bag, rig)
        except InputError as error:
            # The bag may lack a rig; what the user names must be right.
            if rig_file is not None or horizontal is not None or verticals:
                raise
            problem = str(error)
        lines = [*_describe_files(bag), "", "topics", *_describe_topics(bag)]
        for cloud in clouds:
            lines += ["", f"lidar {cloud.index.topic}"]
            lines += [f"  {line}" for line in _describe_cloud(bag, cloud)]
        lines += ["", "roles", *(_describe_rig(rig) if rig else [f"  not found: {problem}"])]
        sections = {
            "transforms": [f"{edge.parent} -> {edge.child}" for edge in edges],
            "missing": list(_missing(bag, clouds, bool(edges), rig)),
            "warnings": [*bag.warnings, *_warnings(rig, clouds)],
        }
        for title, texts in sections.items():
            lines += ["", title, *(f"  {text}" for text in texts)] if texts else []
        return lines


def _look(bag: Bag, topic: str, time_from: TimeFrom) -> Cloud:
    index = index_clouds(bag, topic)
    decoding, problem = None, stamp_problem(index)
    try:
        messages = sample_messages(bag, index, _SAMPLES)
        decoding = settle_decoding(messages, topic, time_from, index.period_ns)
        check_one_lidar(index, decoding)
    except CloudError as error:
        problem = str(error)
    return Cloud(index, decoding, problem)


def _describe_files(bag: Bag) -> Iterator[str]:
    """Describe the bag, and of several files each one's size and time."""
    size_mb = sum(file.stat().st_size for file in files_of(bag.path)) / 1e6
    facts = f"ROS {bag.ros_version}, {size_mb:.1f} MB, {bag.duration_s:.1f} s"
    yield f"{bag.path}: {bag.container}, {facts}"
    if len(bag.files) == 1:
        return
    yield from ("", "files")
    width = max(len(file.path.name) for file in bag.files)
    for file in bag.files:
        start_s, stop_s = (
            (time_ns - bag.files[0].start_ns) / 1e9 for time_ns in (file.start_ns, file.stop_ns - 1)
        )
        span = f"{start_s:8.1f} to {stop_s:.1f} s" if file.start_ns < file.stop_ns else "empty"
        yield f"  {file.path.name:<{width}} {file.path.stat().st_size / 1e6:10.1f} MB {span}"


def _describe_topics(bag: Bag) -> Iterator[str]:
    width = max(map(len, bag.topics), default=0)
    for topic in bag.topics.values():
        rate = " " * 11
        if topic.count > 1 and bag.duration_s > 0:
            rate = f"{(topic.count - 1) / bag.duration_s:8.1f} Hz"
        yield f"  {topic.name:<{width}} {topic.count:>8} {rate}  {topic.msgtype}"


def _describe_cloud(bag: Bag, cloud: Cloud) -> Iterator[str]:
    index, decoding = cloud.index, cloud.decoding
    if decoding is None:
        yield f"problem: {cloud.problem}"
        return
    layout = decoding.layout
    yield f"frame: {layout.frame_id or 'none'}"
    rate = f" at {1e9 / index.period_ns:.2f} Hz" if index.period_ns else ""
    yield f"clouds: {len(index)}{rate}"
    counts = []
    for message in sample_messages(bag, index, _SAMPLES):
        with suppress(CloudError):
            scan = decode(message, decoding)
            counts.append((len(scan), scan.cloud_size))
    valid, places = np.median(counts or [(0, 0)], axis=0).astype(int).tolist()
    order = "organised" if layout.height > 1 else "unorganised"
    yield (
        f"points: {valid} valid of {places} (medians of several clouds); the first has "
        f"{layout.height} x {layout.width}, {order}, {layout.point.itemsize} bytes each"
    )
    yield f"fields: {' '.join(layout.point.names or ()) or 'none'}"
    yield f"rings: {ring_text(decoding)}"
    yield f"times: {time_text(decoding)}"
    if bag.topics[index.topic].msgtype != CLOUD_TYPE:
        yield "messages: raw packets or a driver's own, decoded to clouds"
    if len(index) and (parts := np.median(index.message_count)) > 1:
        yield f"messages: {parts:.0f} make a revolution"
    if cloud.problem is not None:
        yield f"problem: {cloud.problem}"
    elif unusable := np.count_nonzero(~index.usable):
        yield f"unusable: {unusable} clouds whose stamps repeat or jump"
    yield from _describe_bad_clouds(bag, index, decoding)
    for at_ns, long_ns in index.gaps:
        since_s = (at_ns - index.stamp_ns[index.usable][0]) / 1e9
        place = f"{at_ns / 1e9:.3f} ({since_s:.1f} s from the first cloud)"
        yield f"gap: {long_ns / 1e9:.2f} s after {place}"


def _describe_bad_clouds(bag: Bag, index: CloudIndex, decoding: CloudDecoding) -> Iterator[str]:
    """Count the clouds with a usable stamp that give no scan, by reason."""
    stride = -(-len(index) // _CLOUDS_READ_MAX)
    # All clouds are read in one go; in a long bag, each sample is looked up.
    starts, count = (range(1), None) if stride <= 1 else (range(0, len(index), stride), 1)
    read, reasons = 0, Counter[str]()
    for first in starts:
        for number, scan in read_scans(bag, index, first, count, decoding):
            read += 1
            if isinstance(scan, SkippedScan) and index.usable[number]:
                reasons[scan.reason] += 1
    for reason, number in reasons.most_common(_REASONS_MAX):
        yield f"unusable: {number} of {read} clouds that were read: {reason}"
    if others := [number for _, number in reasons.most_common()[_REASONS_MAX:]]:
        yield f"unusable: {sum(others)} more, for other reasons"


def ring_text(decoding: CloudDecoding) -> str:
    """Describe the number of rings, their elevations and their source."""
    rings = decoding.rings
    seen = rings.seen_deg
    span = f", {seen[0]:+.1f} to {seen[-1]:+.1f} deg" if len(seen) else ""
    source = {
        "field": f"from field {decoding.layout.ring_field}",
        "row": "the cloud's rows",
        "column": "the cloud's columns",
        "elevation": "estimated from the elevations",
        "bins": "unknown: equal slices of elevation",
    }[rings.source]
    return f"{rings.count} rings{span} ({source})"


def time_text(decoding: CloudDecoding) -> str:
    """Describe the source of the firing times."""
    time = decoding.time
    if decoding.time_from != "auto":
        return "computed from the azimuth" if decoding.time_from == "azimuth" else "not used"
    if time is None:
        names = " and ".join(decoding.layout.time_fields)
        return f"none (field {names} is not filled, or its unit is unknown)" if names else "none"
    meaning = {
        "stamp": "relative to the stamp",
        "epoch": "absolute",
        "own clock": "absolute on the sensor's own clock; the stamp is used as the sweep's start",
    }[time.reference]
    span_ms = time.span_ns / 1e6
    return f"field {time.name} in {time.unit}, {meaning}, a sweep spans {span_ms:.1f} ms"


def _describe_rig(rig: Rig) -> Iterator[str]:
    yield f"  base frame: {rig.base_frame or 'the lidar itself'}"
    yield f"  extrinsics from: {rig.mounts_from}"
    roles = [("horizontal", rig.horizontal)]
    roles += [("vertical", lidar) for lidar in rig.verticals or (None,)]
    for role, lidar in roles:
        yield f"  {role}: {f'{lidar.topic} ({lidar.reasons})' if lidar else 'none'}"


def _warnings(rig: Rig | None, clouds: Sequence[Cloud]) -> list[str]:
    if rig is None:
        return [cloud.problem for cloud in clouds if cloud.problem]
    index_of = {cloud.index.topic: cloud.index for cloud in clouds}
    problems = [
        clock_problem(index_of[rig.horizontal.topic], index_of[lidar.topic])
        for lidar in rig.verticals
        if rig.horizontal
    ]
    return [*rig.warnings, *filter(None, problems)]


def _missing(
    bag: Bag, clouds: Sequence[Cloud], has_transforms: bool, rig: Rig | None
) -> Iterator[str]:
    """Name what the bag lacks and the consequences, one line each."""
    if bag.start_ns is None:
        yield "messages: the bag is empty"
        return
    if not rig:
        yield from unread_topics(bag).values()
    if not clouds:
        yield f"clouds: nothing can be computed without {CLOUDS_WANTED}"
    for cloud in clouds:
        decoding, topic = cloud.decoding, cloud.index.topic
        if decoding and decoding.rings.source not in ("field", "row", "column"):
            yield f"rings on {topic}: {ring_text(decoding)}"
        if decoding and decoding.time is None:
            yield (
                f"times on {topic}: motion compensation is off; --time-from azimuth computes them, "
                "unless the clouds are compensated already"
            )
    if clouds and not has_transforms:
        needed = "one lidar needs none" if len(clouds) == 1 else "several lidars need --rig FILE"
        yield f"transforms: {f'extrinsics are from {rig.mounts_from}' if rig else needed}"
    if rig and not rig.verticals:
        yield "a vertical lidar: there is a trajectory and a recording, and nothing to label"
    if not {POSE_TOPIC, CLASSES_TOPIC, BUILDING_TOPIC} & bag.topics.keys():
        yield "ground truth: no figures can be computed"
