"""Bags of ROS 1 and ROS 2 behind one interface, read message by message.

A drive may lie in several files, as recorders split it by size or time: together they are one bag. Every process opens the
bag for itself; all readers find a log time without reading what comes before it.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from heapq import merge
from itertools import combinations, pairwise
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Literal, Self, TypeAlias, TypeVar

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.message_heads import Reader, read_heads
from ffmap.loaders.recovery import AnyProfileMcapReader, RecoveredMcapReader, RecoveredRos1Reader
from ffmap.loaders.sqlite_wal import SqliteReader
from ffmap.loaders.text_files import require_regular

Container = Literal["ros1", "sqlite3", "mcap"]
Message: TypeAlias = Any  # A message as an object of rosbags: its attributes are the fields of the ROS message
_T = TypeVar("_T")

_MAGIC: Mapping[bytes, Container] = {b"#ROSBAG V": "ros1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite3"}
_WAYS_OUT = "give a ROS 1 .bag, a ROS 2 bag folder, an .mcap or a .db3"

_GAP_NS = 1_000_000_000
"""Time between two files of a drive from which on a part may be missing: recorders open the next file within it."""
_DRIVES_APART_NS = 600_000_000_000
"""Time between two files of a folder from which on they are of several drives."""
_OUT_OF_ORDER_NS = 1_000_000_000
"""Maximum time that two files of a drive share: recorders write what comes at once in any order."""

_NEVER_NS = 2**63 - 1


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; `msgtype` is written "sensor_msgs/msg/PointCloud2" whatever the ROS."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True)
class RawMessage:
    """A message as it lies in the bag. file: the one that it lies in."""

    topic: str
    log_time_ns: int
    data: bytes | memoryview
    file: Path


@dataclass(frozen=True, eq=False)
class BagFile:
    """A file of a bag, open; of a bag that ROS 2 has compressed, the folder.

    start_ns, stop_ns: log time of the first message, and one nanosecond after the last; `start_ns` is the later where there
    are none.
    """

    path: Path
    container: Container
    reader: Reader
    start_ns: int
    stop_ns: int

    @property
    def ros_version(self) -> Literal[1, 2]:
        return 1 if self.container == "ros1" else 2

    def connections(self, topics: Collection[str]) -> list[Connection]:
        return [connection for connection in self.reader.connections if connection.topic in topics]


class FolderReader(DirectoryReader):
    """A folder with metadata.yaml."""

    STORAGE_PLUGINS = MappingProxyType({"mcap": AnyProfileMcapReader, "sqlite3": SqliteReader})


class Bag:
    """An open bag; see `open_bag`.

    files: in the order of time.
    container: what the messages lie in; of several files the first one's.
    ros_version: 1 or 2, which decides how they are serialised.
    topics: by name; those without messages too.
    start_ns, end_ns: log times of the first and the last message; None where there is none.
    warnings: what a user must know about how the bag was opened.
    typestore: every message type of the bag, to make and to serialise messages.
    """

    def __init__(self, path: BagPath, files: Sequence[BagFile], warnings: list[str]) -> None:
        self.path = path
        self.files = tuple(files)
        self.container = files[0].container
        self.ros_version = files[0].ros_version
        self.warnings = warnings
        self.topics: Mapping[str, Topic] = _topics(files)
        used = [file for file in files if file.start_ns < file.stop_ns]
        self.start_ns = min((file.start_ns for file in used), default=None)
        self.end_ns = max((file.stop_ns - 1 for file in used), default=None)
        self.typestore = _typestore_of(self.ros_version, files, warnings)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return 0.0 if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9

    def close(self) -> None:
        """Close the files; messages cannot be read afterwards."""
        for file in self.files:
            file.reader.close()

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages of these topics in the order of their log time, from `start_ns` until before `stop_ns`.

        Raises InputError where the file turns out to be damaged.
        """

        def read(file: BagFile, wanted: list[Connection]) -> Iterator[RawMessage]:
            for connection, time_ns, data in file.reader.messages(wanted, start_ns, stop_ns):
                yield RawMessage(connection.topic, time_ns, data, file.path)

        return self._join(topics, read, lambda message: message.log_time_ns)

    def heads(self, topic: str, size: int) -> Iterator[tuple[int, bytes]]:
        """Log time and first `size` bytes of each message of a topic, in the order of `messages`, but much cheaper."""
        return self._join([topic], lambda file, wanted: read_heads(file.reader, wanted, size), lambda head: head[0])

    def check_recorded_once(self, topic: str) -> None:
        """Raises InputError where two files have a topic of the same time: one is a copy, or they were recorded at once.

        Where a recorder begins a new file, a topic goes on in it: the two share the time of some messages out of order at
        the most, and neither lies wholly within the time of the other.
        """
        span_ns = cache(lambda file: _span_of_topic(file, topic))
        for file, later in combinations(self.files, 2):
            if later.start_ns >= file.stop_ns:
                continue
            (start, end), (later_start, later_end) = span_ns(file), span_ns(later)
            shared_ns = min(end, later_end) - max(start, later_start)
            if 0 < shared_ns >= min(end - start, later_end - later_start, _OUT_OF_ORDER_NS):
                raise InputError(
                    f"{later.path}: its {topic} overlaps with that of {file.path} by {shared_ns / 1e9:.1f} s: one is a copy, or "
                    "two recorders ran at once; give the parts of one drive, each once"
                )

    def deserialize(self, raw: RawMessage) -> Message:
        """The message as an object; its arrays are views of `raw.data`. Raises InputError where it is damaged."""
        msgtype = self.topics[raw.topic].msgtype
        try:
            if self.ros_version == 1:
                return self.typestore.deserialize_ros1(raw.data, msgtype)
            return self.typestore.deserialize_cdr(raw.data, msgtype)
        except Exception as error:
            raise InputError(
                f"{raw.file.name}: a message of {raw.topic} is no valid {msgtype} ({_one_line(error)}); "
                "leave the topic out, or record it again"
            ) from error

    def topic(self, name: str) -> Topic:
        """The topic of that name, with or without its leading slash. Raises InputError where there is none."""
        for candidate in (name, f"/{name}", name.removeprefix("/")):
            if candidate in self.topics:
                return self.topics[candidate]
        known = ", ".join(sorted(self.topics)) or "none"
        raise InputError(f"{self.path.name}: no topic {name}; the bag has: {known}")

    def _join(
        self,
        topics: Collection[str],
        read: Callable[[BagFile, list[Connection]], Iterator[_T]],
        time_ns: Callable[[_T], int],
    ) -> Iterator[_T]:
        def timed(file: BagFile, own: list[Connection]) -> Iterator[tuple[int, _T | None]]:
            # The file is not read before its time has come.
            yield file.start_ns, None
            for item in _sound(file, read(file, own)):
                yield time_ns(item), item

        parts = [timed(file, own) for file in self.files if (own := file.connections(topics))]
        return (item for _, item in merge(*parts, key=itemgetter(0)) if item is not None)


def _sound(file: BagFile, items: Iterator[_T]) -> Iterator[_T]:
    """What is read of a file; raises InputError where that is damaged."""
    try:
        yield from items
    except Exception as error:
        raise InputError(
            f"{file.path.name}: the file is damaged ({_one_line(error)}); repair it or record it again"
        ) from error


def _span_of_topic(file: BagFile, topic: str) -> tuple[int, int]:
    """Log time of the topic's first message in a file and of the last; the first is the later where there are none."""
    first, last = _NEVER_NS, 0
    if connections := file.connections([topic]):
        for last, _ in _sound(file, read_heads(file.reader, connections, 1)):
            first = min(first, last)
    return first, last


def open_bag(path: BagPath | Path) -> Bag:
    """Open a ROS 1 .bag, a ROS 2 folder (sqlite3 or MCAP, with metadata.yaml or without), a bare .db3 or .mcap.

    Several of these, in any order, are the parts of one drive, as are the .bag files of a folder. A ROS 1 or MCAP file that
    was cut, or whose recorder was killed, is opened up to the cut, with a warning; a gap between two parts is warned of.
    Raises InputError where there is no such file, it is no bag, or nothing of it can be read; and where parts cannot be of
    one drive.
    """
    warnings: list[str] = []
    paths = path.parts if isinstance(path, BagPath) else (path,)
    parts = [(one, _open_part(one, warnings)) for one in paths]
    parts.sort(key=lambda part: min(file.start_ns for file in part[1]))
    files = sorted((file for _, part in parts for file in part), key=lambda file: file.start_ns)
    _check_one_drive(files)
    warnings += _gaps(files)
    return Bag(BagPath(tuple(one for one, _ in parts)), files, warnings)


def _check_one_drive(files: Sequence[BagFile]) -> None:
    """Raises InputError where a file is there twice, or where files differ in what those of a drive have in common."""
    known: dict[tuple[int, int], Path] = {}
    types: dict[str, tuple[str, Path]] = {}
    for file in files:
        status = file.path.stat()
        identity = status.st_dev, status.st_ino
        if identity in known:
            twice = "is given twice" if known[identity] == file.path else f"is the same file as {known[identity]}"
            raise InputError(f"{file.path}: {twice}; give each part of a drive once")
        known[identity] = file.path
        if file.ros_version != files[0].ros_version:
            raise InputError(
                f"{file.path}: is a bag of ROS {file.ros_version}, and {files[0].path} one of ROS {files[0].ros_version}; give "
                "the parts of one drive, or convert them to one ROS"
            )
        for connection in file.reader.connections:
            msgtype, first = types.setdefault(connection.topic, (connection.msgtype, file.path))
            if connection.msgtype != msgtype and first != file.path:
                raise InputError(
                    f"{file.path}: {connection.topic} is {connection.msgtype} there and {msgtype} in {first}; give the parts of "
                    "one drive"
                )


def _gaps(files: Sequence[BagFile]) -> Iterator[str]:
    """What to warn of where the time between two files, in order, is long."""
    before: BagFile | None = None
    for file in files:
        if file.start_ns >= file.stop_ns:
            continue
        if before is not None and file.start_ns - before.stop_ns > _GAP_NS:
            yield (
                f"{file.path.name}: begins {(file.start_ns - before.stop_ns) / 1e9:.1f} s after {before.path.name} ends: a part "
                "between them may be missing, or they are not of one drive"
            )
        before = file if before is None or file.stop_ns > before.stop_ns else before


def _open_part(path: Path, warnings: list[str]) -> list[BagFile]:
    try:
        if path.is_dir():
            return _open_folder(path, warnings)
        if path.exists():
            return [_open_file(path, warnings)]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {_WAYS_OUT}") from error
    raise InputError(f"{path}: no such file or folder; {_WAYS_OUT}")


def _open_folder(folder: Path, warnings: list[str]) -> list[BagFile]:
    files = _data_files(folder)
    for entry in folder.iterdir():
        if entry.exists() and not entry.is_dir():
            require_regular(entry, _WAYS_OUT)  # opening a pipe would block
    if (folder / "metadata.yaml").exists():
        reader = FolderReader(folder)
        try:
            reader.open()
        except Exception as error:  # whatever a parser stumbles over: the folder was found to be readable
            if not files:
                raise InputError(f"{folder}: metadata.yaml names no readable bag ({_one_line(error)})") from error
            warnings.append(f"{folder.name}: metadata.yaml does not fit ({_one_line(error)}); the data files are read")
        else:
            return _files_of(folder, reader, warnings)
    elif not files:
        raise InputError(f"{folder}: the folder holds no bag; {_WAYS_OUT}")
    else:
        what = "no ROS 2 bag" if _kind(files[0]) == ".bag" else "no metadata.yaml"
        warnings.append(f"{folder.name}: {what}; its {len(files)} data file(s) are read as one bag")
    _warn_of_unread(folder, [file.name for file in files], warnings)
    opened = [_open_file(file, warnings) for file in files]
    if _kind(files[0]) == ".bag":
        _check_together(folder, opened)
    return opened


def _check_together(folder: Path, files: Sequence[BagFile]) -> None:
    """Raises InputError where the files of a folder are so far apart that they are of several drives."""
    in_time = sorted((file for file in files if file.start_ns < file.stop_ns), key=lambda file: file.start_ns)
    for before, file in pairwise(in_time):
        if file.start_ns - before.stop_ns > _DRIVES_APART_NS:
            minutes = (file.start_ns - before.stop_ns) / 60e9
            raise InputError(
                f"{folder}: holds several drives, {file.path.name} begins {minutes:.0f} min after {before.path.name} ends; name "
                "the files of one"
            )


def _warn_of_unread(folder: Path, read: Collection[str], warnings: list[str]) -> None:
    """Name the files of the folder that look like parts of a bag and are not read. read: names of those that are."""
    like_parts = sorted(path.name for path in folder.iterdir() if {".bag", ".mcap", ".db3"} & {*path.suffixes})
    if others := [name for name in like_parts if name not in read and name.removesuffix(".zstd") not in read]:
        warnings.append(
            f"{folder.name}: left out: {', '.join(others)}; if they are of the drive, give all of its files by name (compressed "
            "ones: after zstd -d)"
        )


def _files_of(path: Path, reader: FolderReader, warnings: list[str]) -> list[BagFile]:
    """The files of a folder with metadata.yaml, which may overlap in time; of a compressed bag rosbags alone can read them."""
    storages = [storage for storage in reader.storages if isinstance(storage, McapReader | SqliteReader)]
    _warn_of_unread(path, [Path(str(storage.path)).name for storage in storages], warnings)
    container: Container = "mcap" if any(isinstance(storage, McapReader) for storage in storages) else "sqlite3"
    if reader.metadata.compression_mode or not storages:
        return [_opened(path, container, reader)]
    return [_opened(Path(str(storage.path)), container, storage) for storage in storages]


def _opened(path: Path, container: Container, reader: Reader) -> BagFile:
    return BagFile(path, container, reader, *_span_ns(reader))


def _open_file(path: Path, warnings: list[str]) -> BagFile:
    require_regular(path, _WAYS_OUT)
    with path.open("rb") as file:
        start = file.read(16)
    if not start:
        raise InputError(f"{path}: the file is empty; {_WAYS_OUT}")
    container = next((kind for magic, kind in _MAGIC.items() if start.startswith(magic)), None)
    reader: Reader
    match container:
        case "ros1":
            if not start.startswith(b"#ROSBAG V2.0"):
                raise InputError(f"{path}: only version 2.0 of ROS 1 bags can be read; run `rosbag migrate` on it")
            reader = Ros1Reader(path)
            rebuilt: Reader = RecoveredRos1Reader(path)
        case "mcap":
            reader = AnyProfileMcapReader(path)
            rebuilt = RecoveredMcapReader(path)
        case "sqlite3":
            reader = rebuilt = SqliteReader(path)
        case _:
            raise InputError(f"{path}: this is no bag; {_WAYS_OUT}")
    try:
        reader.open()
        return _opened(path, container, reader)
    except Exception as error:  # as above: the file was found to be readable
        if container == "sqlite3":
            raise InputError(
                f"{path}: the database is cut or damaged ({_one_line(error)}); repair it with sqlite3's .recover"
            ) from error
        reason = _one_line(error)
    if "profile" in reason:
        raise InputError(f"{path}: {reason}; give the bag of ROS 1 or ROS 2 that it was made from")
    if "encryption" in reason or "compression" in reason.lower():
        raise InputError(f"{path}: {reason} Convert the bag and try again")
    try:
        rebuilt.open()
    except Exception as error:
        raise InputError(f"{path}: the bag is damaged from its start ({_one_line(error)}); {_WAYS_OUT}") from error
    opened = _opened(path, container, rebuilt)
    seconds = max(opened.stop_ns - opened.start_ns, 0) / 1e9
    count = sum(c.msgcount for c in rebuilt.connections)
    warnings.append(
        f"{path.name}: cut, or its recorder was killed: {count} messages over {seconds:.1f} s before the cut are read"
    )
    return opened


def _data_files(folder: Path) -> list[Path]:
    """The folder's bag files by their names: those of ROS 2, or where there are none those of ROS 1."""
    found = sorted(folder.iterdir())
    return [p for p in found if _kind(p) in (".mcap", ".db3")] or [p for p in found if _kind(p) == ".bag"]


def _kind(path: Path) -> str:
    """The file's suffix, without the .active by which recorders mark what they have not finished."""
    return Path(path.name.removesuffix(".active")).suffix


def _span_ns(reader: Reader) -> tuple[int, int]:
    """Log time of the first message and one nanosecond after the last; the first is the later where there are none."""
    if isinstance(reader, Ros1Reader):
        return reader.start_time, reader.end_time
    return reader.metadata.start_time, reader.metadata.end_time


def _topics(files: Iterable[BagFile]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for connection in (c for file in files for c in file.reader.connections):
        known = topics.get(connection.topic)
        count = connection.msgcount + (known.count if known else 0)
        topics[connection.topic] = Topic(connection.topic, known.msgtype if known else connection.msgtype, count)
    return dict(sorted(topics.items()))


_EXTRA_TYPES = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}


@cache
def make_typestore(ros_version: Literal[1, 2]) -> Typestore:
    """The common message types, with those that rosbags lacks: what bags without definitions are read by."""
    from ffmap.loaders.sensors import SENSORS  # Its modules import this one

    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    for definitions in (_EXTRA_TYPES, *(sensor.definitions for sensor in SENSORS)):
        for name, text in definitions.items():
            if name not in store.fielddefs:
                store.register(get_types_from_msg(text, name))
    return store


def _typestore_of(ros_version: Literal[1, 2], files: Iterable[BagFile], warnings: list[str]) -> Typestore:
    """The common types, overridden by the definitions that the bag brings along where these have the common ones' fields."""
    common = make_typestore(ros_version)
    found: dict[str, Any] = {}
    for msgtype, definition in dict.fromkeys((c.msgtype, c.msgdef) for file in files for c in file.reader.connections):
        try:
            found.update(_definitions(msgtype, definition))
        except Exception as error:
            warnings.append(f"the definition of {msgtype} is not understood: {_one_line(error)}")
    for name in sorted(found.keys() & common.fielddefs.keys()):
        lacking = _field_names(common.fielddefs[name]) - _field_names(found[name])
        lacking |= (
            {used for _, field in found[name][1] for used in _types_in(field)} - common.fielddefs.keys() - found.keys()
        )
        if lacking:
            warnings.append(
                f"the definition of {name} in the bag lacks {', '.join(sorted(lacking))}; the common one is used"
            )
            del found[name]
    if all(common.fielddefs.get(name) == definition for name, definition in found.items()):
        return common
    store = get_typestore(Stores.EMPTY)
    try:
        store.register({**common.fielddefs, **found})
    except Exception as error:  # whatever a damaged definition leads to
        warnings.append(
            f"the bag's definitions of messages do not fit together ({_one_line(error)}); common ones are used"
        )
        return common
    return store


def _field_names(definition: Any) -> set[str]:  # noqa: ANN401 - as rosbags has it: constants, then fields
    return {name for name, _ in definition[1]}


def _types_in(field: Any) -> set[str]:  # noqa: ANN401 - as above: a kind of node, then a name, a basic type or the elements
    kind, inner = field
    if kind == Nodetype.NAME:
        return {inner}
    return _types_in(inner[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else set()


def _definitions(msgtype: str, definition: MessageDefinition) -> dict[str, Any]:
    text = definition.data
    match definition.format:
        case MessageDefinitionFormat.MSG:
            return dict(get_types_from_msg(text, msgtype))
        case MessageDefinitionFormat.IDL:
            bar = "=" * 80 + "\n"
            parts = [p.split("\n", 1)[1] for p in text.split(bar)[1:]] if text.startswith(bar + "IDL: ") else [text]
            return {name: value for part in parts for name, value in get_types_from_idl(part).items()}
    return {}


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
