"""A drive in several files, as recorders split it, in one folder, or in packets."""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from ffmap.loaders.bag import Bag, RawMessage, open_bag
from tests.loaders.bag_builder import PERIOD_NS, Entry, header, write_bag

PACKETS = 40
"""Messages that a revolution is packed in."""


def cut(bag: Path, folder: Path, places_ns: Sequence[int]) -> list[Path]:
    """Write the messages to several bags; all but the first begin at these log times."""
    with open_bag(bag) as opened:
        edges = [None, *places_ns, None]
        return [
            write_bag(folder / f"{number}_{bag.name}", entries(opened, start=start, stop=stop))
            for number, (start, stop) in enumerate(pairwise(edges))
        ]


def entries(
    bag: Bag, topics: Sequence[str] = (), start: int | None = None, stop: int | None = None
) -> list[Entry]:
    """Messages of some topics, or of all."""
    raws = bag.messages(topics or bag.topics, start, stop)
    return [(raw.topic, raw.log_time_ns, bag.deserialize(raw)) for raw in raws]


def in_one_folder(bags: Sequence[Path], folder: Path) -> Path:
    """Copy the files of ROS 2 bags to one folder with one metadata.yaml, as recorders do."""
    folder.mkdir()
    whole: dict[str, dict] = {}
    for bag in bags:
        part = yaml.safe_load((bag / "metadata.yaml").read_text())
        of_part = part["rosbag2_bagfile_information"]
        of_whole = whole.setdefault("rosbag2_bagfile_information", of_part)
        if of_whole is not of_part:
            for name in ("relative_file_paths", "files", "message_count"):
                of_whole[name] += of_part[name]
        for file in bag.iterdir():
            shutil.copy(file, folder)
    (folder / "metadata.yaml").write_text(yaml.safe_dump(whole))
    return folder


def of_topics(bag: Path, topics: Sequence[str]) -> Path:
    """Write a bag beside it with these topics only."""
    with open_bag(bag) as opened:
        return write_bag(bag.with_name(f"bare_{bag.name}"), entries(opened, topics))


def in_packets(bag: Path, topics: Sequence[str]) -> Path:
    """Write a bag beside it with each revolution of these topics in messages of equal duration."""
    with open_bag(bag) as opened:
        made = entries(opened, ["/tf_static"])
        made += [packet for raw in opened.messages(topics) for packet in _packets(opened, raw)]
        return write_bag(
            bag.with_name(f"packets_{bag.name}"), sorted(made, key=lambda entry: entry[1])
        )


def _packets(bag: Bag, raw: RawMessage) -> Iterator[Entry]:
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
        packet = replace(
            message,
            header=header(bag.typestore.types, stamp_ns + first_ns, message.header.frame_id),
            height=1,
            width=len(part),
            row_step=part.size,
            data=part.reshape(-1),
        )
        yield raw.topic, raw.log_time_ns + first_ns, packet
