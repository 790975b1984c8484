"""Readers for bags that were cut: the index that the file lost is rebuilt from its records, the points stay on disk.

Both are rosbags' own readers with another way to open: what follows the index is theirs.
"""

import bz2
import heapq
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Generator, Iterator
from io import BytesIO
from operator import itemgetter
from typing import IO, Any, BinaryIO, NamedTuple, cast

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from rosbags.interfaces import Connection
from rosbags.rosbag1.reader import (
    Chunk,
    ChunkInfo,
    Header,
    IndexData,
    Reader,
    ReaderError,
    RecordType,
    decompressors,
)
from rosbags.rosbag2 import ReaderError as Reader2Error
from rosbags.rosbag2 import storage_mcap
from rosbags.rosbag2.storage_mcap import McapReader

_PIECE = 1 << 16
_LONGEST_HEADER = 1 << 20
_NEVER_NS = 2**63 - 1
_RECORD_HEAD = 9  # Bytes of an MCAP record's opcode and size


class _Ros1Record(NamedTuple):
    header: Header
    data_position: int
    data_size: int


class RecoveredRos1Reader(Reader):
    """A ROS 1 bag without index: cut, or its recorder was killed. Whole messages before the cut are kept."""

    def open(self) -> None:
        """Scan the records from the start to the cut and build the index in memory."""
        self.bio = self.path.open("rb")
        try:
            self._scan(self.bio)
        except BaseException:
            self.close()
            raise

    def _scan(self, file: IO[bytes]) -> None:
        if not file.readline(32).startswith(b"#ROSBAG V2.0"):
            raise ReaderError("File magic is invalid.")
        position, file_end = file.tell(), file.seek(0, 2)
        connections: dict[int, Connection] = {}
        indexes: dict[int, list[IndexData]] = defaultdict(list)
        while record := _read_ros1_record(file, position, file_end):
            match record.header.get_uint8("op"):
                case RecordType.CHUNK:
                    self._scan_chunk(file, position, record, file_end, connections, indexes)
                    # A killed recorder leaves its last chunk with size 0: it is whatever follows.
                    position = record.data_position + record.data_size if record.data_size else file_end
                case RecordType.CONNECTION:
                    self._add_connection(connections, position, file)
                    position = record.data_position + record.data_size
                case _:
                    position = record.data_position + record.data_size
        self.indexes = {key: sorted(indexes[key]) for key in connections}
        self.connections = [c._replace(msgcount=len(self.indexes[c.id])) for c in connections.values()]

    def _scan_chunk(
        self,
        file: IO[bytes],
        chunk_position: int,
        record: _Ros1Record,
        file_end: int,
        connections: dict[int, Connection],
        indexes: dict[int, list[IndexData]],
    ) -> None:
        compression = record.header.get_string("compression")
        available = file_end - record.data_position
        whole = 0 < record.data_size <= available
        size = record.data_size if whole else available
        if compression not in decompressors:
            return
        decompress = decompressors[compression] if whole else _PARTIAL[compression]
        stream, start, end = file, record.data_position, record.data_position + size
        if compression != "none":
            file.seek(record.data_position)
            try:
                content = decompress(file.read(size))
            except (OSError, ValueError, RuntimeError, EOFError):
                return
            stream, start, end = BytesIO(content), 0, len(content)
        position, times_ns, counts = start, [], Counter[int]()
        while (inner := _read_ros1_record(stream, position, end)) and inner.data_position + inner.data_size <= end:
            match inner.header.get_uint8("op"):
                case RecordType.CONNECTION:
                    self._add_connection(connections, position, stream)
                case RecordType.MSGDATA:
                    key, time_ns = inner.header.get_uint32("conn"), inner.header.get_time("time")
                    indexes[key].append(IndexData(time_ns, chunk_position, position - start))
                    times_ns.append(time_ns)
                    counts[key] += 1
            position = inner.data_position + inner.data_size
        self.chunks[chunk_position] = Chunk(size, record.data_position, decompress)
        if times_ns:
            self.chunk_infos.append(ChunkInfo(chunk_position, min(times_ns), max(times_ns) + 1, dict(counts)))

    def _add_connection(self, connections: dict[int, Connection], position: int, stream: IO[bytes]) -> None:
        """By rosbags' own parser, of the record at `position`, which may lie in a chunk; a cut one is left out."""
        file, self.bio = self.bio, cast("BinaryIO", stream)
        try:
            stream.seek(position)
            connection = self.read_connection()
            connections.setdefault(connection.id, connection)
        except ReaderError:
            pass
        finally:
            self.bio = file


def _read_ros1_record(stream: IO[bytes], position: int, end: int) -> _Ros1Record | None:
    """The record's header and where its data lie; None at the end or at what is no record."""
    stream.seek(position)
    size_bytes = stream.read(4)
    if len(size_bytes) < 4 or position + 4 > end:
        return None
    (size,) = struct.unpack("<I", size_bytes)
    if not 0 < size < _LONGEST_HEADER or position + 8 + size > end:
        return None
    try:
        header = Header.read(BytesIO(size_bytes + stream.read(size)))
        header.get_uint8("op")
    except (ReaderError, UnicodeDecodeError):
        return None
    (data_size,) = struct.unpack("<I", stream.read(4))
    return _Ros1Record(header, position + 8 + size, data_size)


class AnyProfileMcapReader(McapReader):
    """rosbags' reader, which refuses a file without profile: tools that merge or filter files write none."""

    def _open(self) -> None:
        assert self.bio
        file = self.bio
        start = file.read(9)
        if len(start) == 9:
            _check_profile(file)
            start += struct.pack("<QI4s", 8, 4, b"ros2")
        self.bio = cast("BinaryIO", _Continued(start, file))
        try:
            super()._open()
        finally:
            self.bio = file


class _Continued:
    """A file whose first bytes, read up to its position, are replaced by others."""

    def __init__(self, start: bytes, file: IO[bytes]) -> None:
        self._start, self._file = BytesIO(start), file
        self.seek, self.tell = file.seek, file.tell

    def read(self, size: int = -1) -> bytes:
        return self._start.read(size) or self._file.read(size)


def _check_profile(file: IO[bytes]) -> None:
    """Read the header after its opcode. Raises an error where the messages are none of ROS 2."""
    profile = storage_mcap.read_string(BytesIO(storage_mcap.read_sized(cast("BinaryIO", file))))
    if profile not in ("", "ros2"):
        raise Reader2Error(f"the profile of the MCAP file is {profile}, not ros2")


class RecoveredMcapReader(McapReader):
    """An MCAP file without summary: cut, or its recorder was killed. Whole messages before the cut are kept."""

    _tail: tuple[int, str] | None = None  # Where the content of the last, cut chunk begins, and its compression
    _definitions = b""  # The records of schemas and channels

    def _open(self) -> None:
        assert self.bio
        file = self.bio
        if file.read(8) != b"\x89MCAP0\r\n" or file.read(1) != b"\x01":
            raise Reader2Error("File magic is invalid.")
        _check_profile(file)
        self.data_start = self.data_end = file.tell()
        file_end = file.seek(0, 2)
        counts: Counter[int] = Counter()
        times_ns = [_NEVER_NS, 0]
        for op, position, size in _mcap_records(file, self.data_start, file_end):
            if op in (_FOOTER, _DATA_END):
                break
            if op == _CHUNK:
                self._add_chunk(file, position, size, file_end, counts, times_ns)
            elif position + size <= file_end:
                self._add_record(file, op, position, size, counts, times_ns)
            if position + size > file_end:
                break
            self.data_end = position + size
        self._read_definitions()
        self.connections = [c._replace(msgcount=counts[c.id]) for c in self.connections]
        count = counts.total()
        self.metadata = self.metadata._replace(
            duration=times_ns[1] - times_ns[0] + 1 if count else 0,
            start_time=times_ns[0],
            end_time=times_ns[1] + 1 if count else 0,
            message_count=count,
        )

    def _read_definitions(self) -> None:
        """By rosbags' own parser, for which the records of schemas and channels are a summary without anything else."""
        file, data_end = self.bio, self.data_end
        self.bio, self.data_end = BytesIO(self._definitions + bytes([_FOOTER])), 0
        self.read_index()
        self.bio, self.data_end = file, data_end

    def _add_chunk(
        self, file: IO[bytes], position: int, size: int, file_end: int, counts: Counter[int], times_ns: list[int]
    ) -> None:
        file.seek(position)
        head = file.read(32)
        if len(head) < 32:
            return
        start_ns, end_ns, plain_size, _, name_size = struct.unpack("<QQQII", head)
        compression = file.read(name_size).decode(errors="replace")
        size_bytes = file.read(8)
        if len(size_bytes) < 8 or compression not in _PARTIAL:
            return
        (stored_size,) = struct.unpack("<Q", size_bytes)
        content_position = file.tell()
        inner_counts: Counter[int] = Counter()
        if position + size > file_end:
            self._tail = (content_position, compression)
            content = _PARTIAL[compression](file.read())
        else:
            content = _PARTIAL[compression](file.read(stored_size))
            if len(content) != plain_size:
                return
        stream = BytesIO(content)
        for op, inner_position, inner_size in _mcap_records(stream, 0, len(content)):
            if inner_position + inner_size <= len(content):
                self._add_record(stream, op, inner_position, inner_size, inner_counts, times_ns)
        counts.update(inner_counts)
        if self._tail is None:
            start, length = position - _RECORD_HEAD, size + _RECORD_HEAD
            sizes = (stored_size, plain_size, inner_counts)
            self.chunks.append(storage_mcap.ChunkInfo(start_ns, end_ns, start, length, {}, 0, compression, *sizes))

    def _add_record(
        self, stream: IO[bytes], op: int, position: int, size: int, counts: Counter[int], times_ns: list[int]
    ) -> None:
        stream.seek(position)
        if op == _MESSAGE:
            key, _, time_ns = struct.unpack("<HIQ", stream.read(14))
            counts[key] += 1
            times_ns[:] = min(times_ns[0], time_ns), max(times_ns[1], time_ns)
        elif op in (_SCHEMA, _CHANNEL):
            stream.seek(position - _RECORD_HEAD)
            self._definitions += stream.read(_RECORD_HEAD + size)

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """As rosbags reads them, and those of the cut chunk at the end."""
        healthy = super().messages(connections, start, stop) if self.chunks or self._tail is None else iter(())
        yield from heapq.merge(healthy, self._tail_messages(connections, start, stop), key=itemgetter(1))

    def _tail_messages(
        self, connections: Collection[Connection], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        if self._tail is None:
            return
        assert self.bio
        position, compression = self._tail
        self.bio.seek(position)
        content = _PARTIAL[compression](self.bio.read())
        by_key = {c.id: c for c in connections}
        found = []
        for op, inner_position, size in _mcap_records(BytesIO(content), 0, len(content)):
            if op == _MESSAGE and inner_position + size <= len(content):
                key, _, time_ns = struct.unpack_from("<HIQ", content, inner_position)
                if key in by_key and (start is None or time_ns >= start) and (stop is None or time_ns < stop):
                    found.append((by_key[key], time_ns, content[inner_position + 22 : inner_position + size]))
        yield from sorted(found, key=itemgetter(1))


_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F


def _mcap_records(stream: IO[bytes], position: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, place and size of each record's content; the last may run beyond `end`."""
    while position + _RECORD_HEAD <= end:
        stream.seek(position)
        op, size = struct.unpack("<BQ", stream.read(_RECORD_HEAD))
        if op == 0:
            return
        yield op, position + _RECORD_HEAD, size
        position += _RECORD_HEAD + size


def _partial(make_decompressor: Callable[[], Any]) -> Callable[[bytes], bytes]:
    """A function that decompresses as much as a cut stream still holds."""

    def decompress(data: bytes) -> bytes:
        decompressor, content = make_decompressor(), bytearray()
        try:
            for first in range(0, len(data), _PIECE):
                content += decompressor.decompress(data[first : first + _PIECE])
        except (OSError, ValueError, RuntimeError, EOFError, zstandard.ZstdError):
            pass
        return bytes(content)

    return decompress


_PARTIAL: dict[str, Callable[[bytes], bytes]] = {
    "": decompressors["none"],
    "none": decompressors["none"],
    "bz2": _partial(bz2.BZ2Decompressor),
    "lz4": _partial(lz4.frame.LZ4FrameDecompressor),
    "zstd": _partial(lambda: zstandard.ZstdDecompressor().decompressobj()),
}
