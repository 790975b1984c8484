"""Readers for bags that rosbags refuses: cut files, MCAP without profile, sqlite3 with a log.

Each is a reader of rosbags with another way to open. A cut file lacks its index, which is rebuilt
from the whole chunks; messages in the chunk that was cut are lost (about 1 MB).
"""

import os
import sqlite3
import struct
from collections import defaultdict
from collections.abc import Iterator
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import BinaryIO, cast
from urllib.parse import quote

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag1.reader import Header, RecordType
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

_HEADER_BYTES_MAX = 1 << 20
_WAL_HEADER_BYTES = 32
_MCAP_CHUNK, _MCAP_FOOTER, _MCAP_DATA_END = 0x06, 0x02, 0x0F
_MCAP_PROFILE_AT = 17
"""Position of the profile: after the magic (8 bytes), the opcode (1) and the record's size (8)."""


class RecoveredRos1Reader(rosbag1.Reader):
    """A ROS 1 bag without index: cut, or its recorder was killed."""

    def open(self) -> None:
        self.bio = self.path.open("rb")
        try:
            self._scan(self.bio)
        except BaseException:
            self.close()
            raise

    def _scan(self, file: BinaryIO) -> None:
        file.readline(32)
        connections: dict[int, Connection] = {}
        self.indexes = defaultdict(list)
        file_end = os.fstat(file.fileno()).st_size
        for at, header, data_at, size in _ros1_records(file, file.tell(), file_end):
            # A killed recorder leaves its last chunk with size 0.
            if header.get_uint8("op") != RecordType.CHUNK or not size:
                continue
            file.seek(data_at)
            try:
                decompress = rosbag1.decompressors[header.get_string("compression")]
                content = decompress(file.read(size))
            except (KeyError, OSError, ValueError, RuntimeError, EOFError):
                continue
            self.chunks[at] = rosbag1.Chunk(size, data_at, decompress)
            times_ns = self._scan_chunk(at, BytesIO(content), len(content), connections)
            if times_ns:
                info = rosbag1.ChunkInfo(at, min(times_ns), max(times_ns) + 1, {})
                self.chunk_infos.append(info)
        for index in self.indexes.values():
            index.sort()
        self.connections = [
            connection._replace(msgcount=len(self.indexes[key]))
            for key, connection in connections.items()
        ]

    def _scan_chunk(
        self, chunk_at: int, chunk: BytesIO, size: int, connections: dict[int, Connection]
    ) -> list[int]:
        """Index the messages of a chunk; return their log times."""
        times_ns = []
        for at, header, _, _ in _ros1_records(chunk, 0, size):
            match header.get_uint8("op"):
                case RecordType.CONNECTION:
                    chunk.seek(at)
                    file, self.bio = self.bio, cast("BinaryIO", chunk)
                    connection = self.read_connection()
                    self.bio = file
                    connections.setdefault(connection.id, connection)
                case RecordType.MSGDATA:
                    times_ns.append(header.get_time("time"))
                    entry = rosbag1.IndexData(times_ns[-1], chunk_at, at)
                    self.indexes[header.get_uint32("conn")].append(entry)
        return times_ns


def _ros1_records(file: BinaryIO, at: int, end: int) -> Iterator[tuple[int, Header, int, int]]:
    """Yield the position, header, position of the data and size of the data of whole records."""
    while True:
        file.seek(at)
        try:
            if rosbag1.read_uint32(file) > _HEADER_BYTES_MAX:
                return
            file.seek(at)
            header = Header.read(file)
            header.get_uint8("op")
            size = rosbag1.read_uint32(file)
        except (rosbag1.ReaderError, UnicodeDecodeError):
            return
        data_at = file.tell()
        if data_at + size > end:
            return
        yield at, header, data_at, size
        at = data_at + size


class McapReader(storage_mcap.McapReader):
    """An MCAP file, also without profile: tools that merge or filter files write none."""

    def _open(self) -> None:
        file = cast("BufferedReader", self.bio)
        named = _NamedProfile(file.detach())
        self.bio = named
        try:
            super()._open()
        finally:
            self.bio = BufferedReader(named.detach())


class _NamedProfile(BufferedReader):
    """An MCAP file whose header names the profile ros2 where it names none."""

    def read(self, size: int | None = -1) -> bytes:
        at = self.tell()
        data = super().read(size)
        if at == _MCAP_PROFILE_AT and data.startswith(bytes(4)):
            return (struct.pack("<I", 4) + b"ros2" + data)[: len(data)]
        return data


class RecoveredMcapReader(storage_mcap.McapReader):
    """An MCAP file without summary: cut, or its recorder was killed."""

    def _open(self) -> None:
        file = cast("BufferedReader", self.bio)
        file.seek(_MCAP_PROFILE_AT - 8)
        storage_mcap.skip_sized(file)
        self.data_start = at = file.tell()
        file_end = os.fstat(file.fileno()).st_size
        chunks = []
        while at + 9 <= file_end:
            file.seek(at)
            op, size = struct.unpack("<BQ", file.read(9))
            if op in (0, _MCAP_FOOTER, _MCAP_DATA_END) or at + 9 + size > file_end:
                break
            if op == _MCAP_CHUNK:
                chunks.append(_mcap_chunk(file, at, size))
            at += 9 + size
        self.data_end = at
        self.meta_scan()
        assert self.statistics
        found, counts = self.statistics, self.statistics.channel_message_counts
        self.chunks = [chunk._replace(channel_count=counts) for chunk in chunks]
        self.connections = [c._replace(msgcount=counts.get(c.id, 0)) for c in self.connections]
        if found.message_count:
            self.metadata = self.metadata._replace(
                duration=found.end_time - found.start_time + 1,
                start_time=found.start_time,
                end_time=found.end_time + 1,
                message_count=found.message_count,
            )


def _mcap_chunk(file: BinaryIO, at: int, size: int) -> storage_mcap.ChunkInfo:
    start_ns, end_ns, plain_size, _ = struct.unpack("<QQQI", storage_mcap.read_exact(file, 28))
    compression = storage_mcap.read_string(file)
    (stored_size,) = struct.unpack("<Q", storage_mcap.read_exact(file, 8))
    return storage_mcap.ChunkInfo(
        start_ns, end_ns, at, 9 + size, {}, 0, compression, stored_size, plain_size, {}
    )


class WalReader(Sqlite3Reader):
    """A database with a write-ahead log, as killed recorders leave it; rosbags ignores the log.

    SQLite merges the two without a lock and without shared memory, so that no file changes.
    """

    def open(self) -> None:
        uri = f"file:{quote(str(self.path))}?mode=ro&vfs=unix-none"
        database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        database.execute("PRAGMA locking_mode=EXCLUSIVE")
        self.dbconn = database  # type: ignore[assignment] # It has the one method that is used
        undefined = MessageDefinition(MessageDefinitionFormat.NONE, "")
        ext = ConnectionExtRosbag2("cdr", [])
        self.connections = [
            Connection(key, topic, msgtype, undefined, "", count, ext, self)
            for key, topic, msgtype, count in database.execute(
                "SELECT topics.id, name, type, count(messages.id) FROM topics "
                "LEFT JOIN messages ON topics.id == topic_id GROUP BY topics.id"
            )
        ]
        start_ns, end_ns, count = database.execute(
            "SELECT min(timestamp), max(timestamp) + 1, count(*) FROM messages"
        ).fetchone()
        if count:
            self.metadata = self.metadata._replace(
                duration=end_ns - start_ns,
                start_time=start_ns,
                end_time=end_ns,
                message_count=count,
            )


def sqlite_reader(path: Path) -> Sqlite3Reader:
    """Make the reader of a database, with its write-ahead log where that contains pages."""
    wal = path.with_name(f"{path.name}-wal")
    has_pages = wal.is_file() and wal.stat().st_size > _WAL_HEADER_BYTES
    return WalReader(path) if has_pages else Sqlite3Reader(path)

