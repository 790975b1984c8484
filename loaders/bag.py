"""Bags of ROS 1 and ROS 2 behind one interface, read message by message.

A drive may consist of several files, split by size or time: together they are one bag. Every
process opens the bag for itself. All readers seek to a log time.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from heapq import merge
from itertools import combinations
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias, TypeVar

from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.message_heads import Reader, read_heads
from ffmap.loaders.recovery import (
    McapReader,
    RecoveredMcapReader,
    RecoveredRos1Reader,
    sqlite_reader,
)
from ffmap.loaders.text_files import require_regular

Container = Literal["ros1", "sqlite3", "mcap"]
Message: TypeAlias = Any  # A message as an object of rosbags, with the fields of the ROS message
_T = TypeVar("_T")

_MAGIC: Mapping[bytes, Container] = {
    b"#ROSBAG V": "ros1",
    b"\x89MCAP0\r\n": "mcap",
    b"SQLite format 3\0": "sqlite3",
}
_COMPRESSED = re.compile(r"""compression_mode: *["']?(file|message)""", re.IGNORECASE)
_ADVICE = "give a ROS 1 .bag, a ROS 2 bag folder, an .mcap or a .db3"

_GAP_NS = 1_000_000_000
"""Minimum time between two files for a warning: recorders open the next file within it."""
_DRIVES_APART_NS = 600_000_000_000
"""Minimum time between two files of a folder that belong to different drives."""
_OUT_OF_ORDER_NS = 1_000_000_000
"""Maximum time that two files of a drive share: recorders write messages out of order."""


@dataclass(frozen=True)
class Topic:
    """A topic; `msgtype` is written like "sensor_msgs/msg/PointCloud2" for both versions of ROS."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True)
class RawMessage:
    """A serialized message and the file that contains it."""

    topic: str
    log_time_ns: int
    data: bytes | memoryview
    file: Path


@dataclass(frozen=True, eq=False)
class BagFile:
    """An open file of a bag, or the folder of a compressed ROS 2 bag.

    start_ns, stop_ns: log time of the first message, and one nanosecond after the last;
        start_ns > stop_ns in a file without messages.
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


class Bag:
    """An open bag; see `open_bag`.

    files: in the order of time.
    container: of the first file.
    topics: by name, also those without messages.
    start_ns, end_ns: log times of the first and the last message; None without messages.
    typestore: creates and serializes messages.
    """

    def __init__(self, path: BagPath, files: Sequence[BagFile], warnings: list[str]) -> None:
        self.path = path
        self.files = tuple(files)
        self.container = files[0].container
        self.ros_version = files[0].ros_version
        self.warnings = warnings
        self.topics = _topics(files)
        used = [file for file in files if file.start_ns < file.stop_ns]
        self.start_ns = min((file.start_ns for file in used), default=None)
        self.end_ns = max((file.stop_ns - 1 for file in used), default=None)
        self.typestore = make_typestore(self.ros_version)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def duration_s(self) -> float:
        if self.start_ns is None or self.end_ns is None:
            return 0.0
        return (self.end_ns - self.start_ns) / 1e9

    def close(self) -> None:
        for file in self.files:
            file.reader.close()

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Read messages in the order of log time, from `start_ns` until before `stop_ns`.

        Raises InputError where a file is damaged.
        """

        def read(file: BagFile, wanted: list[Connection]) -> Iterator[tuple[int, RawMessage]]:
            for connection, time_ns, data in file.reader.messages(wanted, start_ns, stop_ns):
                yield time_ns, RawMessage(connection.topic, time_ns, data, file.path)

        return (message for _, message in self._join(topics, read))

    def heads(self, topic: str, size: int) -> Iterator[tuple[int, bytes]]:
        """Read log time and first `size` bytes of each message, in the order of `messages`."""
        return self._join([topic], lambda file, wanted: read_heads(file.reader, wanted, size))

    def _join(
        self,
        topics: Collection[str],
        read: Callable[[BagFile, list[Connection]], Iterator[tuple[int, _T]]],
    ) -> Iterator[tuple[int, _T]]:
        """Merge the files by log time; a file is not read before its time has come."""

        def timed(file: BagFile, wanted: list[Connection]) -> Iterator[tuple[int, _T | None]]:
            yield file.start_ns, None
            yield from _undamaged(file, read(file, wanted))

        parts = [timed(file, own) for file in self.files if (own := file.connections(topics))]
        for time_ns, item in merge(*parts, key=itemgetter(0)):
            if item is not None:
                yield time_ns, item

    def check_recorded_once(self, topic: str) -> None:
        """Raise InputError where two files contain a topic during the same time.

        Where a recorder begins a new file, the two share only messages out of order.
        """

        files = [file for file in self.files if file.connections([topic])]
        for file, later in combinations(files, 2):
            shared_ns = min(file.stop_ns, later.stop_ns) - later.start_ns
            shorter_ns = min(file.stop_ns - file.start_ns, later.stop_ns - later.start_ns)
            if 0 < shared_ns >= min(shorter_ns, _OUT_OF_ORDER_NS):
                raise InputError(
                    f"{later.path}: its {topic} overlaps with that of {file.path} by "
                    f"{shared_ns / 1e9:.1f} s, so that one is a copy or two recorders ran at once; "
                    "give the parts of one drive, each once"
                )

    def deserialize(self, raw: RawMessage) -> Message:
        """Deserialize a message; its arrays are views of `raw.data`.

        Raises InputError where it is damaged.
        """
        msgtype = self.topics[raw.topic].msgtype
        try:
            if self.ros_version == 1:
                return self.typestore.deserialize_ros1(raw.data, msgtype)
            return self.typestore.deserialize_cdr(raw.data, msgtype)
        except Exception as error:
            raise InputError(
                f"{raw.file.name}: a message of {raw.topic} is no valid {msgtype} "
                f"({_reason(error)}); leave the topic out, or record it again"
            ) from error

    def topic(self, name: str) -> Topic:
        """Look a topic up, with or without its leading slash. Raises InputError without one."""
        for candidate in (name, f"/{name}", name.removeprefix("/")):
            if candidate in self.topics:
                return self.topics[candidate]
        known = ", ".join(sorted(self.topics)) or "none"
        raise InputError(f"{self.path.name}: no topic {name}; the bag has: {known}")


def _undamaged(file: BagFile, items: Iterator[_T]) -> Iterator[_T]:
    try:
        yield from items
    except Exception as error:
        raise InputError(
            f"{file.path.name}: the file is damaged ({_reason(error)}); "
            "repair it or record it again"
        ) from error


def _topics(files: Sequence[BagFile]) -> Mapping[str, Topic]:
    topics: dict[str, Topic] = {}
    for connection in (c for file in files for c in file.reader.connections):
        name = connection.topic
        known = topics.get(name, Topic(name, connection.msgtype, 0))
        topics[name] = Topic(name, known.msgtype, known.count + connection.msgcount)
    return dict(sorted(topics.items()))


def open_bag(path: BagPath | Path) -> Bag:
    """Open a ROS 1 .bag, a ROS 2 folder (sqlite3 or MCAP), a .db3 or an .mcap.

    Several paths, in any order, are the parts of one drive, as are the .bag files of a folder. A
    ROS 1 or MCAP file that was cut is read up to the cut, with a warning.
    Raises InputError where a path is no readable bag, or parts do not belong to one drive.
    """
    warnings: list[str] = []
    paths = path.parts if isinstance(path, BagPath) else (path,)
    parts = [(one, _open_part(one, warnings)) for one in paths]
    parts.sort(key=lambda part: min(file.start_ns for file in part[1]))
    files = sorted((file for _, part in parts for file in part), key=lambda file: file.start_ns)
    _check_files(files, warnings, in_folder=len(parts) == 1)
    return Bag(BagPath(tuple(one for one, _ in parts)), files, warnings)


def _check_files(files: Sequence[BagFile], warnings: list[str], in_folder: bool) -> None:
    """Check that files belong to one drive; warn of time between them."""
    last = files[0]
    for file in files:
        if file.ros_version != last.ros_version:
            raise InputError(
                f"{file.path}: is a bag of ROS {file.ros_version}, and {last.path} one of ROS "
                f"{last.ros_version}; give the parts of one drive, or convert them to one ROS"
            )
        gap_ns = file.start_ns - last.stop_ns
        if last.start_ns < last.stop_ns and file.start_ns < file.stop_ns and gap_ns > _GAP_NS:
            what = f"begins {gap_ns / 1e9:.1f} s after {last.path.name} ends"
            if in_folder and gap_ns > _DRIVES_APART_NS:
                raise InputError(
                    f"{file.path}: {what}, so that the folder contains several drives; "
                    "name the files of one"
                )
            warnings.append(
                f"{file.path.name}: {what}: a part between them may be missing, or they do not "
                "belong to one drive"
            )
        last = max(last, file, key=lambda each: each.stop_ns)


def _open_part(path: Path, warnings: list[str]) -> list[BagFile]:
    try:
        if path.is_dir():
            return _open_folder(path, warnings)
        if path.exists():
            return [_open_file(path, warnings)]
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be read ({reason}); {_ADVICE}") from error
    raise InputError(f"{path}: no such file or folder; {_ADVICE}")


def _open_folder(folder: Path, warnings: list[str]) -> list[BagFile]:
    entries = sorted(entry for entry in folder.iterdir() if not entry.is_dir())
    for entry in entries:
        if entry.exists():
            require_regular(entry, _ADVICE)  # Opening a pipe would block
    metadata = folder / "metadata.yaml"
    if metadata.exists() and _COMPRESSED.search(metadata.read_text(errors="replace")):
        return [_open_compressed(folder)]
    paths = [entry for entry in entries if _kind(entry) in (".mcap", ".db3")]
    paths = paths or [entry for entry in entries if _kind(entry) == ".bag"]
    if not paths:
        raise InputError(f"{folder}: the folder contains no bag; {_ADVICE}")
    names = {path.name for path in paths}
    parts = [path.name for path in entries if {".bag", ".mcap", ".db3"} & {*path.suffixes}]
    if others := [name for name in parts if name not in names]:
        warnings.append(
            f"{folder.name}: left out: {', '.join(others)}; if they belong to the drive, give all "
            "of its files by name (compressed ones: after zstd -d)"
        )
    return [_open_file(path, warnings) for path in paths]


def _open_compressed(folder: Path) -> BagFile:
    """Open a folder whose files or messages are compressed, which only rosbags' reader reads."""
    try:
        reader = DirectoryReader(folder)
        reader.open()
    except Exception as error:  # Of any kind: the metadata may contain anything
        raise InputError(
            f"{folder}: the compressed bag cannot be read ({_reason(error)}); {_ADVICE}"
        ) from error
    is_sqlite = any(isinstance(storage, Sqlite3Reader) for storage in reader.storages)
    return _opened(folder, "sqlite3" if is_sqlite else "mcap", reader)


def _open_file(path: Path, warnings: list[str]) -> BagFile:
    require_regular(path, _ADVICE)
    with path.open("rb") as file:
        start = file.read(16)
    if not start:
        raise InputError(f"{path}: the file is empty; {_ADVICE}")
    container = next((kind for magic, kind in _MAGIC.items() if start.startswith(magic)), None)
    if container is None:
        raise InputError(f"{path}: this is no bag; {_ADVICE}")
    if container == "ros1" and not start.startswith(b"#ROSBAG V2.0"):
        raise InputError(
            f"{path}: only version 2.0 of ROS 1 bags can be read; run `rosbag migrate` on it"
        )
    readers: dict[Container, Callable[[Path], Reader]] = {
        "ros1": Ros1Reader,
        "mcap": McapReader,
        "sqlite3": sqlite_reader,
    }
    try:
        reader = readers[container](path)
        reader.open()
        return _opened(path, container, reader)
    except Exception as error:  # Of any kind: the file may contain anything
        reason = _reason(error)
    if container == "sqlite3":
        raise InputError(
            f"{path}: the database is cut or damaged ({reason}); repair it with sqlite3's .recover"
        )
    if any(word in reason.lower() for word in ("profile", "encryption", "compression")):
        raise InputError(f"{path}: {reason} Convert the bag and try again")
    recovered = (RecoveredRos1Reader if container == "ros1" else RecoveredMcapReader)(path)
    try:
        recovered.open()
    except Exception as error:  # As above
        raise InputError(
            f"{path}: the bag is damaged from its start ({_reason(error)}); {_ADVICE}"
        ) from error
    opened = _opened(path, container, recovered)
    seconds = max(opened.stop_ns - opened.start_ns, 0) / 1e9
    count = sum(connection.msgcount for connection in recovered.connections)
    warnings.append(
        f"{path.name}: cut, or its recorder was killed: {count} messages over {seconds:.1f} s "
        "before the cut are read"
    )
    return opened


def _opened(path: Path, container: Container, reader: Reader) -> BagFile:
    if isinstance(reader, Ros1Reader):
        return BagFile(path, container, reader, reader.start_time, reader.end_time)
    found = reader.metadata
    return BagFile(path, container, reader, found.start_time, found.end_time)


def _kind(path: Path) -> str:
    """Return the suffix, without the .active of files that a recorder has not finished."""
    return Path(path.name.removesuffix(".active")).suffix


def _reason(error: BaseException) -> str:
    return shortened(error) or type(error).__name__


_EXTRA_TYPES = {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}


@cache
def make_typestore(ros_version: Literal[1, 2]) -> Typestore:
    """Make the store of message types: the common ones, and those of the sensors."""
    from ffmap.loaders.sensors import SENSORS  # Its modules import this one

    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    for definitions in (_EXTRA_TYPES, *(sensor.definitions for sensor in SENSORS)):
        for name, text in definitions.items():
            if name not in store.fielddefs:
                store.register(get_types_from_msg(text, name))
    return store
