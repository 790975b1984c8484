"""The first bytes of every message of a topic, without reading the rest.

A cloud is 1.5 MB, its header 40 bytes: to know all stamps of a bag, only the headers are read where the container lets
one seek. Where it does not (compressed chunks), the messages are read and cut.
"""

import os
import struct
from collections.abc import Collection, Iterator
from heapq import merge

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import Reader as Ros1Reader
from rosbags.rosbag1.reader import RecordType, decompressors
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

Reader = Ros1Reader | DirectoryReader | McapReader | Sqlite3Reader
Head = tuple[int, bytes]  # Log time in nanoseconds; the message's first bytes

_ROS1_RECORD_BYTES = 96  # More than a message record's own header takes


def read_heads(reader: Reader, connections: Collection[Connection], size: int) -> Iterator[Head]:
    """The first `size` bytes of each message, in the order in which the reader gives the messages themselves."""
    match reader:
        case Ros1Reader() if all(chunk.decompressor is decompressors["none"] for chunk in reader.chunks.values()):
            return _ros1_heads(reader, connections, size)
        case McapReader() if not getattr(reader, "_tail", None) and not any(c.compression for c in reader.chunks):
            return _mcap_heads(reader, connections, size)
        case Sqlite3Reader():
            return _sqlite_heads(reader, connections, size)
    return ((time_ns, data[:size]) for _, time_ns, data in reader.messages(list(connections)))


def _ros1_heads(reader: Ros1Reader, connections: Collection[Connection], size: int) -> Iterator[Head]:
    assert reader.bio
    descriptor = reader.bio.fileno()
    for entry in merge(*(reader.indexes[c.id] for c in connections)):
        position = reader.chunks[entry.chunk_pos].datapos + entry.offset
        while True:
            record = os.pread(descriptor, _ROS1_RECORD_BYTES + size, position)
            (header_size,) = struct.unpack_from("<I", record)
            if len(record) < header_size + 8:
                record = os.pread(descriptor, header_size + 8 + size, position)
            (data_size,) = struct.unpack_from("<I", record, 4 + header_size)
            op_at = record.index(b"op=", 4, 4 + header_size)
            if record[op_at + 3] == RecordType.MSGDATA:
                break
            position += header_size + 8 + data_size
        yield entry.time, record[header_size + 8 : header_size + 8 + min(size, data_size)]


def _mcap_heads(reader: McapReader, connections: Collection[Connection], size: int) -> Iterator[Head]:
    assert reader.bio
    descriptor = reader.bio.fileno()
    keys = {c.id for c in connections}
    times_ns, positions, sizes = [], [], []
    for start, end in _mcap_spans(reader, keys):
        position = start
        while position < end:
            op, record_size, key, _, time_ns = struct.unpack("<BQHIQ", os.pread(descriptor, 23, position))
            if op == 0x05 and key in keys:
                times_ns.append(time_ns)
                positions.append(position + 31)
                sizes.append(record_size - 22)
            position += 9 + record_size
    for i in np.argsort(np.array(times_ns, np.int64), kind="stable"):
        yield times_ns[i], os.pread(descriptor, min(size, sizes[i]), positions[i])


def _mcap_spans(reader: McapReader, keys: set[int]) -> Iterator[tuple[int, int]]:
    """Where the file holds message records of these channels, uncompressed."""
    if not reader.chunks:
        yield reader.data_start, reader.data_end
    for chunk in sorted(reader.chunks, key=lambda c: c.chunk_start_offset):
        if any(chunk.channel_count.get(key, 0) for key in keys):
            start = chunk.chunk_start_offset + 9 + 40 + len(chunk.compression)
            yield start, start + chunk.compressed_size


def _sqlite_heads(reader: Sqlite3Reader, connections: Collection[Connection], size: int) -> Iterator[Head]:
    assert reader.dbconn
    keys = sorted({c.id for c in connections})
    query = f"SELECT id, timestamp FROM messages WHERE topic_id IN ({','.join('?' * len(keys))}) ORDER BY timestamp"
    blob = None
    for row, time_ns in reader.dbconn.execute(query, keys):
        assert isinstance(row, int)
        assert isinstance(time_ns, int)
        if blob is None:
            blob = reader.dbconn.blob_open("main", "messages", "data", row, False)
        else:
            blob.reopen(row)
        yield time_ns, blob.read(size)
    if blob is not None:
        blob.close()
