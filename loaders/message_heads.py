"""The first bytes of every message of a topic, without reading the rest.

A point cloud has 1.5 MB, its header 40 bytes. Where the container is not compressed, only the
headers are read; else the messages are read and cut.
"""

import os
import struct
from collections.abc import Collection, Iterator
from heapq import merge
from operator import itemgetter

from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import Chunk, RecordType, decompressors
from rosbags.rosbag1.reader import Reader as Ros1Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from ffmap.loaders.recovery import WalReader

Reader = Ros1Reader | DirectoryReader | McapReader | Sqlite3Reader
Head = tuple[int, bytes]  # Log time in nanoseconds; the message's first bytes

_ROS1_RECORD_BYTES = 96  # More than a message record's own header takes
_MCAP_MESSAGE = 0x05


def read_heads(reader: Reader, connections: Collection[Connection], size: int) -> Iterator[Head]:
    """Read the first `size` bytes of each message, in the order of `reader.messages`."""
    match reader:
        case Ros1Reader() if not any(map(_is_compressed, reader.chunks.values())):
            return _ros1_heads(reader, connections, size)
        case McapReader() if not any(chunk.compression for chunk in reader.chunks):
            return _mcap_heads(reader, connections, size)
        case Sqlite3Reader() if not isinstance(reader, WalReader):
            return _sqlite_heads(reader, connections, size)
    messages = reader.messages(list(connections))
    return ((time_ns, data[:size]) for _, time_ns, data in messages)


def _is_compressed(chunk: Chunk) -> bool:
    return chunk.decompressor is not decompressors["none"]


def _ros1_heads(
    reader: Ros1Reader, connections: Collection[Connection], size: int
) -> Iterator[Head]:
    assert reader.bio
    file = reader.bio.fileno()
    for entry in merge(*(reader.indexes[c.id] for c in connections)):
        at = reader.chunks[entry.chunk_pos].datapos + entry.offset
        while True:
            record = os.pread(file, _ROS1_RECORD_BYTES + size, at)
            (header_size,) = struct.unpack_from("<I", record)
            if len(record) < header_size + 8:
                record = os.pread(file, header_size + 8 + size, at)
            (data_size,) = struct.unpack_from("<I", record, 4 + header_size)
            op_at = record.index(b"op=", 4, 4 + header_size)
            if record[op_at + 3] == RecordType.MSGDATA:
                break
            at += header_size + 8 + data_size
        yield entry.time, record[header_size + 8 : header_size + 8 + min(size, data_size)]


def _mcap_heads(
    reader: McapReader, connections: Collection[Connection], size: int
) -> Iterator[Head]:
    assert reader.bio
    file = reader.bio.fileno()
    keys = {c.id for c in connections}
    spans = [
        (at := chunk.chunk_start_offset + 49 + len(chunk.compression), at + chunk.compressed_size)
        for chunk in reader.chunks
        if any(chunk.channel_count.get(key, 0) for key in keys)
    ]
    if not reader.chunks:
        spans = [(reader.data_start, reader.data_end)]
    found = []
    for at, end in sorted(spans):
        while at < end:
            op, record_size, key, _, time_ns = struct.unpack("<BQHIQ", os.pread(file, 23, at))
            if op == _MCAP_MESSAGE and key in keys:
                found.append((time_ns, at + 31, min(size, record_size - 22)))
            at += 9 + record_size
    for time_ns, data_at, data_size in sorted(found, key=itemgetter(0)):
        yield time_ns, os.pread(file, data_size, data_at)


def _sqlite_heads(
    reader: Sqlite3Reader, connections: Collection[Connection], size: int
) -> Iterator[Head]:
    assert reader.dbconn
    keys = sorted({c.id for c in connections})
    marks = ",".join("?" * len(keys))
    query = f"SELECT id, timestamp FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp"
    for row, time_ns in reader.dbconn.execute(query, keys):
        assert isinstance(row, int)
        assert isinstance(time_ns, int)
        with reader.dbconn.blob_open("main", "messages", "data", row, False) as blob:
            yield time_ns, blob.read(size)
