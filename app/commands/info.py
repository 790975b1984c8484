"""ffmap info: what a bag holds and what it is good for, on the terminal."""

from collections.abc import Sequence

import numpy as np

from ffmap.loaders.bag import BagFile
from ffmap.loaders.info import BagInfo, CloudInfo, ring_words, size_of, time_words

_REASONS = 3
"""Maximum number of reasons told for which clouds give no scan."""


def describe(found: BagInfo) -> list[str]:
    """A line for each fact, so that descriptions can be searched and compared."""
    bag = found.bag
    facts = f"ROS {bag.ros_version}, {found.size_bytes / 1e6:.1f} MB, {bag.duration_s:.1f} s"
    lines = [f"{bag.path}: {bag.container}, {facts}"]
    if len(bag.files) > 1:
        lines += ["", "files", *_describe_files(bag.files)]
    lines += ["", "topics"]
    width = max(map(len, bag.topics), default=0)
    for topic in bag.topics.values():
        timed = topic.count > 1 and bag.duration_s > 0
        rate = f"{(topic.count - 1) / bag.duration_s:8.1f} Hz" if timed else " " * 11
        lines.append(f"  {topic.name:<{width}} {topic.count:>8} {rate}  {topic.msgtype}")
    for cloud in found.clouds:
        lines += ["", f"lidar {cloud.index.topic}", *(f"  {line}" for line in _describe_cloud(cloud))]
    lines += ["", "roles"]
    if found.rig is None:
        lines.append(f"  not found: {found.rig_problem}")
    else:
        lines.append(f"  base frame: {found.rig.base_frame or 'the lidar itself'}")
        lines.append(f"  mounts from: {found.rig.mounts_from}")
        roles = [("horizontal", found.rig.horizontal), *(("vertical", lidar) for lidar in found.rig.verticals or (None,))]
        for role, lidar in roles:
            lines.append(f"  {role}: {f'{lidar.topic} ({lidar.reasons})' if lidar else 'none'}")
    if found.tree.edges:
        lines += ["", "transforms", *(f"  {edge.parent} -> {edge.child}" for edge in found.tree.edges)]
    for title, texts in (("missing", found.missing), ("warnings", found.warnings)):
        lines += ["", title, *(f"  {text}" for text in texts)] if texts else []
    return lines


def _describe_files(files: Sequence[BagFile]) -> list[str]:
    """Each file's size, and when it begins and ends, counted from the first."""
    width = max(len(file.path.name) for file in files)
    spans = [
        f"{(file.start_ns - files[0].start_ns) / 1e9:8.1f} to {(file.stop_ns - 1 - files[0].start_ns) / 1e9:.1f} s"
        if file.start_ns < file.stop_ns
        else "empty"
        for file in files
    ]
    return [
        f"  {file.path.name:<{width}} {size_of(file.path) / 1e6:10.1f} MB {span}"
        for file, span in zip(files, spans, strict=True)
    ]


def _describe_cloud(cloud: CloudInfo) -> list[str]:
    if cloud.decoding is None:
        return [f"problem: {cloud.problem}"]
    index, layout = cloud.index, cloud.decoding.layout
    valid, places = cloud.points
    lines = [
        f"frame: {layout.frame_id or 'none'}",
        f"clouds: {len(index)}" + (f" at {1e9 / index.period_ns:.2f} Hz" if index.period_ns else ""),
        f"points: {valid} valid of {places} (medians of several clouds); the first has {layout.height} x {layout.width}, "
        f"{'organised' if layout.height > 1 else 'unorganised'}, {layout.point.itemsize} bytes each",
        f"fields: {' '.join(layout.point.names or ()) or 'none'}",
        f"rings: {ring_words(cloud.decoding)}",
        f"times: {time_words(cloud.decoding)}",
    ]
    if cloud.decoded:
        lines.append("messages: raw packets or a driver's own, decoded to clouds")
    if len(index) and (parts := np.median(index.message_count)) > 1:
        lines.append(f"messages: {parts:.0f} make a revolution")
    if cloud.problem is not None:
        lines.append(f"problem: {cloud.problem}")
    elif unusable := np.count_nonzero(~index.usable):
        lines.append(f"unusable: {unusable} clouds whose stamps repeat or jump")
    for reason, count in cloud.bad_clouds[:_REASONS]:
        lines.append(f"unusable: {count} of {cloud.read_count} clouds that were read: {reason}")
    if len(cloud.bad_clouds) > _REASONS:
        lines.append(f"unusable: {sum(count for _, count in cloud.bad_clouds[_REASONS:])} more, for other reasons")
    first_ns = index.stamp_ns[index.usable][0] if index.usable.any() else 0
    gaps = [
        f"gap: {long_ns / 1e9:.2f} s after {at_ns / 1e9:.3f} ({(at_ns - first_ns) / 1e9:.1f} s from the first cloud)"
        for at_ns, long_ns in index.gaps
    ]
    return lines + gaps
