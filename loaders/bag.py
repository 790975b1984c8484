"""Bags of ROS 1 and ROS 2 behind one interface, read message by message.

Every process opens the bag for itself; all readers find a log time without reading what comes before it.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from heapq import merge
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeAlias, TypeVar

from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ffmap.loaders.errors import InputError
from ffmap.loaders.message_heads import Reader, read_heads
from ffmap.loaders.recovery import RecoveredMcapReader, RecoveredRos1Reader
from ffmap.loaders.text_files import require_regular

Container = Literal["ros1", "sqlite3", "mcap"]
Message: TypeAlias = Any  # A message as an object of rosbags: its attributes are the fields of the ROS message
_T = TypeVar("_T")

_MAGIC: Mapping[bytes, Container] = {b"#ROSBAG V": "ros1", b"\x89MCAP0\r\n": "mcap", b"SQLite format 3\0": "sqlite3"}
_WAYS_OUT = "give a ROS 1 .bag, a ROS 2 bag folder, an .mcap or a .db3"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag; `msgtype` is written "sensor_msgs/msg/PointCloud2" whatever the ROS."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True)
class RawMessage:
    """A message as it lies in the bag."""

    topic: str
    log_time_ns: int
    data: bytes | memoryview


class Bag:
    """An open bag; see `open_bag`.

    container: what the messages lie in.
    ros_version: 1 or 2, which decides how they are serialised.
    topics: by name; those without messages too.
    start_ns, end_ns: log times of the first and the last message; None where there is none.
    warnings: what a user must know about how the bag was opened.
    typestore: every message type of the bag, to make and to serialise messages.
    """

    def __init__(self, path: Path, container: Container, readers: list[Reader], warnings: list[str]) -> None:
        self.path = path
        self.container = container
        self.ros_version: Literal[1, 2] = 1 if container == "ros1" else 2
        self.warnings = warnings
        self._readers = sorted(readers, key=lambda reader: _span_ns(reader)[0])
        spans = [_span_ns(reader) for reader in self._readers if reader.connections]
        self._in_turn = all(after[0] >= before[1] for before, after in pairwise(spans))
        self.topics: Mapping[str, Topic] = _topics(self._readers)
        used = [span for span in spans if span[0] < span[1]]
        self.start_ns = min((span[0] for span in used), default=None)
        self.end_ns = max((span[1] - 1 for span in used), default=None)
        self.typestore = _typestore_of(self.ros_version, self._readers, warnings)

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
        for reader in self._readers:
            reader.close()
        self._readers = []

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages of these topics in the order of their log time, from `start_ns` until before `stop_ns`.

        Raises InputError where the file turns out to be damaged.
        """

        def read(reader: Reader, wanted: list[Connection]) -> Iterator[RawMessage]:
            for connection, time_ns, data in reader.messages(wanted, start_ns, stop_ns):
                yield RawMessage(connection.topic, time_ns, data)

        return self._join(topics, read, lambda message: message.log_time_ns)

    def heads(self, topic: str, size: int) -> Iterator[tuple[int, bytes]]:
        """Log time and first `size` bytes of each message of a topic, in the order of `messages`, but much cheaper."""
        return self._join([topic], lambda reader, wanted: read_heads(reader, wanted, size), lambda head: head[0])

    def deserialize(self, raw: RawMessage) -> Message:
        """The message as an object; its arrays are views of `raw.data`. Raises InputError where it is damaged."""
        msgtype = self.topics[raw.topic].msgtype
        try:
            if self.ros_version == 1:
                return self.typestore.deserialize_ros1(raw.data, msgtype)
            return self.typestore.deserialize_cdr(raw.data, msgtype)
        except Exception as error:
            raise InputError(
                f"{self.path.name}: a message of {raw.topic} is no valid {msgtype} ({_one_line(error)}); "
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
        read: Callable[[Reader, list[Connection]], Iterator[_T]],
        time_ns: Callable[[_T], int],
    ) -> Iterator[_T]:
        wanted = [[c for c in reader.connections if c.topic in topics] for reader in self._readers]
        parts = [read(reader, own) for reader, own in zip(self._readers, wanted, strict=True) if own]
        joined = (item for part in parts for item in part) if self._in_turn else merge(*parts, key=time_ns)
        while True:
            try:
                item = next(joined, None)
            except Exception as error:
                raise InputError(
                    f"{self.path.name}: the file is damaged ({_one_line(error)}); repair it or record it again"
                ) from error
            if item is None:
                return
            yield item


def open_bag(path: Path) -> Bag:
    """Open a ROS 1 .bag, a ROS 2 folder (sqlite3 or MCAP, with metadata.yaml or without), a bare .db3 or .mcap.

    A ROS 1 or MCAP file that was cut, or whose recorder was killed, is opened up to the cut, with a warning. Raises
    InputError where there is no such file, it is no bag, or nothing of it can be read.
    """
    warnings: list[str] = []
    try:
        if path.is_dir():
            container, readers = _open_folder(path, warnings)
        elif path.exists():
            container, reader = _open_file(path, warnings)
            readers = [reader]
        else:
            raise InputError(f"{path}: no such file or folder; {_WAYS_OUT}")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {_WAYS_OUT}") from error
    return Bag(path, container, readers, warnings)


def _open_folder(folder: Path, warnings: list[str]) -> tuple[Container, list[Reader]]:
    files = _data_files(folder)
    for entry in folder.iterdir():
        if entry.exists() and not entry.is_dir():
            require_regular(entry, _WAYS_OUT)  # opening a pipe would block
    if (folder / "metadata.yaml").exists():
        reader = Ros2Reader(folder)
        try:
            reader.open()
        except Exception as error:  # whatever a parser stumbles over: the folder was found to be readable
            if not files:
                raise InputError(f"{folder}: metadata.yaml names no readable bag ({_one_line(error)})") from error
            warnings.append(f"{folder.name}: metadata.yaml does not fit ({_one_line(error)}); the data files are read")
        else:
            return _container_of(reader), [reader]
    elif not files:
        inside = sorted(folder.glob("*.bag"))
        hint = f"name the file, such as {inside[0]}" if inside else _WAYS_OUT
        raise InputError(f"{folder}: the folder holds no ROS 2 bag; {hint}")
    else:
        warnings.append(f"{folder.name}: no metadata.yaml; its {len(files)} data file(s) are read as one bag")
    opened = [_open_file(file, warnings) for file in files]
    return opened[0][0], [reader for _, reader in opened]


def _open_file(path: Path, warnings: list[str]) -> tuple[Container, Reader]:
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
            reader = McapReader(path)
            rebuilt = RecoveredMcapReader(path)
        case "sqlite3":
            reader = rebuilt = Sqlite3Reader(path)
        case _:
            raise InputError(f"{path}: this is no bag; {_WAYS_OUT}")
    try:
        reader.open()
        return container, reader
    except Exception as error:  # as above: the file was found to be readable
        if container == "sqlite3":
            raise InputError(
                f"{path}: the database is cut or damaged ({_one_line(error)}); repair it with sqlite3's .recover"
            ) from error
        reason = _one_line(error)
    if "encryption" in reason or "Profile" in reason or "compression" in reason.lower():
        raise InputError(f"{path}: {reason} Convert the bag and try again")
    try:
        rebuilt.open()
    except Exception as error:
        raise InputError(f"{path}: the bag is damaged from its start ({_one_line(error)}); {_WAYS_OUT}") from error
    start_ns, stop_ns = _span_ns(rebuilt)
    seconds = max(stop_ns - start_ns, 0) / 1e9
    count = sum(c.msgcount for c in rebuilt.connections)
    warnings.append(
        f"{path.name}: cut, or its recorder was killed: {count} messages over {seconds:.1f} s before the cut are read"
    )
    return container, rebuilt


def _container_of(reader: Ros2Reader) -> Container:
    storages = getattr(reader.storage, "storages", [])
    return "mcap" if any(isinstance(storage, McapReader) for storage in storages) else "sqlite3"


def _data_files(folder: Path) -> list[Path]:
    """The folder's bag files in the order in which they were recorded: name_2 comes before name_10."""

    def natural(path: Path) -> list[tuple[int, str]]:
        return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]

    return sorted((p for p in folder.iterdir() if p.suffix in (".mcap", ".db3")), key=natural)


def _span_ns(reader: Reader) -> tuple[int, int]:
    """Log time of the first message and one nanosecond after the last."""
    if isinstance(reader, Ros1Reader | Ros2Reader):
        return reader.start_time, reader.end_time
    return reader.metadata.start_time, reader.metadata.end_time


def _topics(readers: list[Reader]) -> dict[str, Topic]:
    topics: dict[str, Topic] = {}
    for connection in (c for reader in readers for c in reader.connections):
        known = topics.get(connection.topic)
        count = connection.msgcount + (known.count if known else 0)
        topics[connection.topic] = Topic(connection.topic, known.msgtype if known else connection.msgtype, count)
    return dict(sorted(topics.items()))


_LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
_LIVOX_CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\nCustomPoint[] points"
)
_EXTRA_TYPES = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
    **{f"{driver}/msg/CustomPoint": _LIVOX_POINT for driver in ("livox_ros_driver", "livox_ros_driver2")},
    **{f"{driver}/msg/CustomMsg": _LIVOX_CLOUD for driver in ("livox_ros_driver", "livox_ros_driver2")},
}


@cache
def make_typestore(ros_version: Literal[1, 2]) -> Typestore:
    """The common message types, with those that rosbags lacks: what bags without definitions are read by."""
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    for name, text in _EXTRA_TYPES.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
    return store


def _typestore_of(ros_version: Literal[1, 2], readers: list[Reader], warnings: list[str]) -> Typestore:
    """The common types, overridden by the definitions that the bag brings along where these have the common ones' fields."""
    common = make_typestore(ros_version)
    found: dict[str, Any] = {}
    for connection in (c for reader in readers for c in reader.connections):
        try:
            found.update(_definitions(connection))
        except Exception as error:
            warnings.append(f"the definition of {connection.msgtype} is not understood: {_one_line(error)}")
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


def _definitions(connection: Connection) -> dict[str, Any]:
    text = connection.msgdef.data
    match connection.msgdef.format:
        case MessageDefinitionFormat.MSG:
            return dict(get_types_from_msg(text, connection.msgtype))
        case MessageDefinitionFormat.IDL:
            bar = "=" * 80 + "\n"
            parts = [p.split("\n", 1)[1] for p in text.split(bar)[1:]] if text.startswith(bar + "IDL: ") else [text]
            return {name: value for part in parts for name, value in get_types_from_idl(part).items()}
    return {}


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
