"""Bags of killed recorders: messages before the cut and in a write-ahead log are read."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.errors import InputError
from tests.loaders.bag_builder import PERIOD_NS, START_NS, clouds, odometry, write_bag

SMALL = {"columns": 4, "elevations_deg": (-3, -1, 1, 3)}
KINDS = ["ros1 none", "ros1 bz2", "ros1 lz4"]
KINDS += ["mcap unchunked", "mcap none", "mcap lz4", "mcap zstd"]
CHUNK_BYTES = 2000


def _entries(version: int) -> list:
    entries = clouds("/a", 12, ros_version=version, **SMALL)
    entries += clouds("/b", 12, ros_version=version, late_ns=1_000_000, **SMALL)
    for i in range(12):
        log_time_ns = START_NS + i * PERIOD_NS + 2_000_000
        message = odometry(log_time_ns, [i, 0, 0], ros_version=version)
        entries.append(("/odom", log_time_ns, message))
    return sorted(entries, key=lambda entry: entry[1])


def foreign_mcap(path: Path, entries: list, chunked: bool, compression: CompressionType) -> Path:
    """Write a bag like ROS 2's own recorder: checksums, and chunks on request."""
    store = make_typestore(2)
    with path.open("wb") as file:
        writer = McapWriter(
            file, chunk_size=CHUNK_BYTES, compression=compression, use_chunking=chunked
        )
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
    container, how = kind.split()
    if container == "ros1":
        return write_bag(folder / "a.bag", _entries(1), 1500, "" if how == "none" else how)
    chunked = how != "unchunked"
    compression = CompressionType[how.upper()] if chunked else CompressionType.NONE
    return foreign_mcap(folder / "a.mcap", _entries(2), chunked, compression)


def _read(path: Path) -> list[tuple[str, int, bytes]]:
    with open_bag(path) as bag:
        messages = [(m.topic, m.log_time_ns, bytes(m.data)) for m in bag.messages(bag.topics)]
        for topic in bag.topics:
            heads = [(time_ns, data[:9]) for name, time_ns, data in messages if name == topic]
            assert list(bag.heads(topic, 9)) == heads
            assert bag.topics[topic].count == len(heads)
        middle_ns = START_NS + 6 * PERIOD_NS
        later = [message for message in messages if message[1] >= middle_ns]
        assert len(list(bag.messages(bag.topics, middle_ns))) == len(later)
    return messages


@pytest.mark.parametrize("kind", KINDS)
def test_messages_in_whole_chunks_before_the_cut_are_read(tmp_path, kind):
    path = _whole(kind, tmp_path)
    messages, content = _read(path), path.read_bytes()
    cut = tmp_path / f"cut{path.suffix}"
    counts = []
    for position in np.linspace(1, len(content) - 1, 40).astype(int):
        cut.write_bytes(content[:position])
        try:
            found = _read(cut)
        except InputError:
            found = []
        assert found == messages[: len(found)]
        if kind in ("ros1 none", "mcap unchunked", "mcap none"):
            ends = [content.find(data) + len(data) for _, _, data in messages]
            assert len(found) >= sum(end + 2 * CHUNK_BYTES <= position for end in ends)
        counts.append(len(found))
    assert counts == sorted(counts)
    assert counts[len(counts) // 2] > 5


COUNT = 12


def killed(folder: Path, checkpointed: int) -> Path:
    """Make the folder of a killed recorder, with some messages in the database itself."""
    entries = clouds("/a", COUNT, ros_version=2)
    source = next(write_bag(folder / "source_db3", entries).glob("*.db3"))
    live, left = folder / "live.db3", folder / "left"
    with (
        closing(sqlite3.connect(source)) as whole,
        closing(sqlite3.connect(live, isolation_level=None)) as bag,
    ):
        bag.execute("PRAGMA journal_mode=WAL")
        bag.execute("PRAGMA wal_autocheckpoint=0")
        query = "SELECT sql, type, name FROM sqlite_master WHERE sql IS NOT NULL"
        tables = whole.execute(query).fetchall()
        for sql, _, _ in tables:
            bag.execute(sql)
        for name in (name for _, kind, name in tables if kind == "table"):
            for number, row in enumerate(whole.execute(f"SELECT * FROM {name}").fetchall()):
                if name == "messages" and number == checkpointed:
                    bag.execute("PRAGMA wal_checkpoint(RESTART)")
                bag.execute(f"INSERT INTO {name} VALUES ({','.join('?' * len(row))})", row)
        left.mkdir()
        for suffix in ("", "-wal"):
            shutil.copy(f"{live}{suffix}", left / f"a.db3{suffix}")
    return left


def _by_sqlite(folder: Path) -> list[tuple[str, int, bytes]]:
    copy = shutil.copytree(folder, folder.with_name("copy"))
    query = "SELECT '/a', timestamp, data FROM messages ORDER BY timestamp"
    with closing(sqlite3.connect(copy / "a.db3")) as bag:
        return bag.execute(query).fetchall()


@pytest.mark.parametrize(
    ("checkpointed", "described", "torn"),
    [(0, False, None), (5, True, None), (COUNT, False, None), (3, False, 0.6), (3, True, 0.97)],
)
def test_messages_in_a_write_ahead_log_are_read(tmp_path, checkpointed, described, torn):
    left = killed(tmp_path, checkpointed)
    if described:
        text = (tmp_path / "source_db3" / "metadata.yaml").read_text()
        (left / "metadata.yaml").write_text(text.replace("source_db3.db3", "a.db3"))
    if torn:
        content = bytearray((left / "a.db3-wal").read_bytes())
        content[int(torn * len(content))] ^= 1
        (left / "a.db3-wal").write_bytes(content)
    before = {path.name: path.read_bytes() for path in left.iterdir()}
    found = _read(left)
    assert {path.name: path.read_bytes() for path in left.iterdir()} == before
    assert found == _by_sqlite(left)
    assert len(found) == COUNT if torn is None else 3 <= len(found) < COUNT
