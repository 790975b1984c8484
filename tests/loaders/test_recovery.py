"""Cut bags: every whole message before the cut is read, in order, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.errors import InputError
from tests.loaders.bag_builder import PERIOD_NS, START_NS, clouds, odometry, write_bag

SMALL = {"columns": 4, "elevations_deg": (-3, -1, 1, 3)}


def _entries(version: int) -> list:
    entries = clouds("/a", 12, ros_version=version, **SMALL)
    entries += clouds("/b", 12, ros_version=version, late_ns=1_000_000, **SMALL)
    for i in range(12):
        log_time_ns = START_NS + i * PERIOD_NS + 2_000_000
        entries.append(("/odom", log_time_ns, odometry(log_time_ns, [i, 0, 0], ros_version=version)))
    return sorted(entries, key=lambda entry: entry[1])


def foreign_mcap(path: Path, entries: list, chunked: bool, compression: CompressionType) -> Path:
    """As ROS 2's own recorder writes it: checksums, and chunks only if asked for."""
    store = make_typestore(2)
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=2000, compression=compression, use_chunking=chunked)
        writer.start(profile="ros2", library="test")
        channels: dict[str, int] = {}
        for topic, log_time_ns, message in entries:
            kind = message.__msgtype__
            if topic not in channels:
                text = store.generate_msgdef(kind, ros_version=2)[0].encode()
                schema = writer.register_schema(kind, "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message, kind))
            writer.add_message(channels[topic], log_time_ns, data, log_time_ns)
        writer.finish()
    return path


def _whole(kind: str, folder: Path) -> Path:
    match kind.split():
        case ["ros1", compression]:
            return write_bag(folder / "a.bag", _entries(1), 1500, "" if compression == "none" else compression)
        case ["mcap", "rosbags"]:
            return write_bag(folder / "a_mcap", _entries(2)) / "a_mcap.mcap"
        case ["mcap", "unchunked"]:
            return foreign_mcap(folder / "a.mcap", _entries(2), False, CompressionType.NONE)
        case ["mcap", compression]:
            return foreign_mcap(folder / "a.mcap", _entries(2), True, CompressionType[compression.upper()])
    raise AssertionError(kind)


def _read(path: Path) -> list[tuple[str, int, bytes]]:
    with open_bag(path) as bag:
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in bag.messages(list(bag.topics))]
        assert sum(t.count for t in bag.topics.values()) == len(messages)
        for topic in bag.topics:
            heads = [(t, d[:12]) for p, t, d in messages if p == topic]
            assert list(bag.heads(topic, 12)) == heads
        if messages:
            assert bag.start_ns == messages[0][1]
            assert bag.end_ns == messages[-1][1]
        return messages


KINDS = ["ros1 none", "ros1 bz2", "ros1 lz4", "mcap rosbags", "mcap unchunked", "mcap none", "mcap lz4", "mcap zstd"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_comes_before_the_cut_is_read(tmp_path, kind):
    path = _whole(kind, tmp_path)
    content = path.read_bytes()
    messages = _read(path)
    assert len(messages) == 36
    cut = tmp_path / f"cut{path.suffix}"
    counts = []
    for position in np.linspace(1, len(content) - 1, 60).astype(int):
        cut.write_bytes(content[:position])
        try:
            found = _read(cut)
        except InputError:
            found = []
        assert found == messages[: len(found)]
        # Uncompressed, each message lies in the file as it is: those before the cut are all there.
        if kind in ("ros1 none", "mcap rosbags", "mcap unchunked", "mcap none"):
            assert len(found) >= sum(content.find(data) + len(data) <= position for _, _, data in messages)
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[len(counts) // 2] > 8


@pytest.mark.parametrize("kind", ["ros1 none", "mcap lz4"])
def test_a_cut_bag_warns_and_seeks(tmp_path, kind):
    path = _whole(kind, tmp_path)
    messages = _read(path)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.6)])
    with open_bag(path) as bag:
        assert "cut" in bag.warnings[0]
        assert path.name in bag.warnings[0]
        start, stop = messages[6][1], messages[12][1]
        part = [(m.topic, m.log_time_ns, bytes(m.data)) for m in bag.messages(list(bag.topics), start, stop)]
        assert part == [m for m in messages if start <= m[1] < stop]


def test_a_killed_ros1_recorder_leaves_a_chunk_of_size_zero(tmp_path):
    path = write_bag(tmp_path / "a.bag", _entries(1), 10**9)
    content = bytearray(path.read_bytes())
    messages = _read(path)
    # index_pos 0, and the chunk's size as the recorder writes it before it is known.
    at = content.index(b"index_pos=") + 10
    content[at : at + 8] = bytes(8)
    chunk = len(b"#ROSBAG V2.0\n") + 4096
    size_at = chunk + 4 + int.from_bytes(content[chunk : chunk + 4], "little")
    content[size_at : size_at + 4] = bytes(4)
    killed = tmp_path / "killed.bag"
    killed.write_bytes(content[: len(content) * 2 // 3])
    found = _read(killed)
    assert found == messages[: len(found)]
    assert len(found) > 12


def test_a_cut_file_in_a_folder(tmp_path):
    folder = write_bag(tmp_path / "a_mcap", _entries(2))
    file = folder / "a_mcap.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with open_bag(folder) as bag:
        assert len(list(bag.messages(list(bag.topics)))) > 8
        assert any("cut" in warning for warning in bag.warnings)
