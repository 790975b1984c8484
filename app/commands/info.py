"""ffmap info: what a bag holds and what it is good for, on the terminal."""

from dataclasses import astuple
from pathlib import Path

import typer

from ffmap.app.setup.inputs import InputOptions
from ffmap.loaders.info import BagInfo, CloudInfo, describe_bag

_REASONS = 3
"""Maximum number of reasons told for which clouds give no scan."""


def info(bag: Path, options: InputOptions) -> None:
    """Print a bag's description, a line for each fact, so that it can be searched and compared."""
    for line in describe(describe_bag(bag, *astuple(options))):
        typer.echo(line)


def describe(found: BagInfo) -> list[str]:
    lines = [
        f"{found.path}: {found.container}, ROS {found.ros_version}, {found.size_bytes / 1e6:.1f} MB, {found.duration_s:.1f} s",
        "",
        "topics",
    ]
    width = max((len(topic.name) for topic in found.topics), default=0)
    for topic in found.topics:
        rate = f"{topic.rate_hz:8.1f} Hz" if topic.rate_hz is not None else " " * 11
        lines.append(f"  {topic.name:<{width}} {topic.count:>8} {rate}  {topic.msgtype}")
    for cloud in found.clouds:
        lines += ["", f"lidar {cloud.topic}", *(f"  {line}" for line in _describe_cloud(cloud))]
    lines += ["", "roles"]
    if found.rig is None:
        lines.append(f"  not found: {found.rig_problem}")
    else:
        lines.append(f"  base frame: {found.rig.base_frame or 'the lidar itself'}")
        for role, lidar in (("horizontal", found.rig.horizontal), ("vertical", found.rig.vertical)):
            lines.append(f"  {role}: {f'{lidar.topic} ({lidar.reasons})' if lidar else 'none'}")
    if found.transforms:
        lines += ["", "transforms", *(f"  {edge.parent} -> {edge.child}" for edge in found.transforms)]
    for title, texts in (("missing", found.missing), ("warnings", found.warnings)):
        lines += ["", title, *(f"  {text}" for text in texts)] if texts else []
    return lines


def _describe_cloud(cloud: CloudInfo) -> list[str]:
    if cloud.decoding is None:
        return [f"problem: {cloud.problem}"]
    layout = cloud.decoding.layout
    valid, places = cloud.points
    lines = [
        f"frame: {cloud.frame_id or 'none'}",
        f"clouds: {cloud.cloud_count}" + (f" at {cloud.rate_hz:.2f} Hz" if cloud.rate_hz is not None else ""),
        f"points: {valid} valid of {places} (medians of several clouds); the first has {layout.height} x {layout.width}, "
        f"{'organised' if layout.organised else 'unorganised'}, {layout.point_step} bytes each",
        f"fields: {' '.join(field.name for field in layout.fields) or 'none'}",
        f"rings: {cloud.rings}",
        f"times: {cloud.times}",
    ]
    if cloud.packets:
        lines.append("packets: raw, decoded to a cloud a revolution")
    if cloud.messages_per_cloud > 1:
        lines.append(f"messages: {cloud.messages_per_cloud:.0f} make a revolution")
    if cloud.problem is not None:
        lines.append(f"problem: {cloud.problem}")
    elif cloud.unusable_count:
        lines.append(f"unusable: {cloud.unusable_count} clouds whose stamps repeat or jump")
    for reason, count in cloud.bad_clouds[:_REASONS]:
        lines.append(f"unusable: {count} of {cloud.read_count} clouds that were read: {reason}")
    if len(cloud.bad_clouds) > _REASONS:
        lines.append(f"unusable: {sum(count for _, count in cloud.bad_clouds[_REASONS:])} more, for other reasons")
    for gap in cloud.gaps:
        lines.append(f"gap: {gap.duration_ns / 1e9:.2f} s after {gap.start_ns / 1e9:.3f}")
    return lines
