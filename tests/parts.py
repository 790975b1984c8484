"""A drive in several files, as recorders split it: a bag cut at any times, its files in one folder, its clouds in packets."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

from ffmap.loaders.bag import Bag, Message, RawMessage, open_bag
from tests.loaders.bag_builder import CLOUD, PERIOD_NS, header

PACKETS = 40
"""Messages that a revolution is packed in."""


def cut(bag: Path, folder: Path, places_ns: Sequence[int]) -> list[Path]:
    """The same messages in a bag after the other, a new one beginning at each of these log times."""
    with open_bag(bag) as opened:
        edges = [None, *places_ns, None]
        return [
            _write(folder, f"{bag.stem}_{number}", opened, opened.messages(opened.topics, start, stop))
            for number, (start, stop) in enumerate(pairwise(edges))
        ]


def in_one_folder(bags: Sequence[Path], folder: Path) -> Path:
    """The files of ROS 2 bags in one folder, as a recorder leaves them: with one metadata.yaml."""
    folder.mkdir()
    parts = [yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"] for bag in bags]
    whole = parts[0]
    for part in parts[1:]:
        whole["relative_file_paths"] += part["relative_file_paths"]
        whole["files"] += part["files"]
        whole["message_count"] += part["message_count"]
    for bag in bags:
        for file in bag.iterdir():
            if file.suffix != ".yaml":
                shutil.copy(file, folder)
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": whole}))
    return folder


def of_topics(bag: Path, topics: Sequence[str]) -> Path:
    """The bag beside it with nothing but these topics."""
    with open_bag(bag) as opened:
        return _write(bag.parent, f"{bag.stem}_bare", opened, opened.messages(topics))


def in_packets(bag: Path, topics: Sequence[str]) -> Path:
    """The bag beside it with each revolution of these topics in messages of equal duration."""
    with open_bag(bag) as opened:
        raws = [
            packet
            for raw in opened.messages([*topics, "/tf_static"])
            for packet in (_packets(opened, raw) if raw.topic in topics else [raw])
        ]
        return _write(bag.parent, f"{bag.stem}_packets", opened, sorted(raws, key=lambda raw: raw.log_time_ns))


def _packets(bag: Bag, raw: RawMessage) -> Iterator[RawMessage]:
    message = bag.deserialize(raw)
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    points = np.asarray(message.data).reshape(-1, message.point_step)
    at = next(field.offset for field in message.fields if field.name == "time")
    times_s = points[:, at : at + 4].copy().view("<f4")[:, 0]
    numbers = np.clip(times_s * 1e9 * PACKETS / PERIOD_NS, 0, PACKETS - 1).astype(int)
    for number in range(PACKETS):
        first_ns = number * PERIOD_NS // PACKETS
        part = points[numbers == number].copy()
        since_s = times_s[numbers == number] - np.float32(1e-9 * first_ns)
        part[:, at : at + 4] = since_s[:, None].view(np.uint8)
        packet: Message = replace(
            message,
            header=header(bag.typestore.types, stamp_ns + first_ns, message.header.frame_id),
            height=1,
            width=len(part),
            row_step=part.size,
            data=part.reshape(-1),
        )
        data = bag.typestore.serialize_ros1(packet, CLOUD)
        yield replace(raw, log_time_ns=raw.log_time_ns + number * PERIOD_NS // PACKETS, data=data)


def _write(folder: Path, name: str, bag: Bag, raws: Iterator[RawMessage] | Sequence[RawMessage]) -> Path:
    """A bag of the kind that `bag` is, with messages of it."""
    if bag.container == "ros1":
        path = folder / f"{name}.bag"
        writer: Any = Ros1Writer(path)
    else:
        path = folder / name
        plugin = StoragePlugin.MCAP if bag.container == "mcap" else StoragePlugin.SQLITE3
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
    with writer:
        connections = {
            topic.name: writer.add_connection(topic.name, topic.msgtype, typestore=bag.typestore)
            for topic in bag.topics.values()
        }
        for raw in raws:
            writer.write(connections[raw.topic], raw.log_time_ns, bytes(raw.data))
    return path
