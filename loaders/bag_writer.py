"""Bags of ROS 1 and ROS 2 as rosbags writes them, under another name until they are complete."""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.transforms import quaternion_xyzw
from ffmap.loaders.bag import Container, Message, make_typestore
from ffmap.loaders.frames import StaticTransform

_FOREVER = QosTime(9223372036, 854775807)
_LATCHED = Qos(
    history=QosHistory.KEEP_LAST,
    depth=1,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.TRANSIENT_LOCAL,
    deadline=_FOREVER,
    lifespan=_FOREVER,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_FOREVER,
    avoid_ros_namespace_conventions=False,
)


@dataclass(frozen=True)
class SerializedMessage:
    """A message in the version of ROS that is written."""

    __msgtype__: str
    data: bytes


class BagWriter:
    """Writes a ROS 1 .bag, or the folder of a ROS 2 bag.

    As a context manager: the complete bag replaces whatever is at `path`; after an exception
    nothing is left of it. part: the path until then.
    """

    caller: ClassVar[str | None] = None
    """The node in the messages of a ROS 1 bag."""

    def __init__(self, path: Path, container: Container, part: Path | None = None) -> None:
        self.path, self._container, self._ros1 = path, container, container == "ros1"
        self._part = part or path.with_name(f"{path.name}.part")
        self._store = make_typestore(1 if self._ros1 else 2)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        self._remove_part()
        self._writer = self._open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is not None:
            self._writer.abort()
            self._remove_part()
            return
        self._writer.close()
        if self._ros1:
            self._part.replace(self.path)
        else:
            shutil.rmtree(self.path, ignore_errors=True)
            (self._part / self.path.name).replace(self.path)
            self._part.rmdir()

    def _open(self) -> Any:  # noqa: ANN401 - either of rosbags' writers
        if self._ros1:
            ros1 = Ros1Writer(self._part)
            ros1.open()
            return ros1
        storage = StoragePlugin.MCAP if self._container == "mcap" else StoragePlugin.SQLITE3
        # A bag's files have the name of their folder, so it is one level down; most releases of
        # ROS 2 read version 8.
        ros2 = Ros2Writer(self._part / self.path.name, version=8, storage_plugin=storage)
        ros2.open()
        return ros2

    def _remove_part(self) -> None:
        if self._part.is_dir():
            shutil.rmtree(self._part, ignore_errors=True)
        else:
            self._part.unlink(missing_ok=True)

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Add a topic. latched: whether later subscribers receive the last message."""
        how: dict[str, Any] = {"offered_qos_profiles": [_LATCHED] * latched}
        if self._ros1:
            how = {"latching": int(latched), "callerid": self.caller}
        connection = self._writer.add_connection(topic, msgtype, typestore=self._store, **how)
        self._connections[topic] = connection

    def write(
        self,
        topic: str,
        message: Message | SerializedMessage,
        log_time_ns: int,
        latched: bool = False,
    ) -> None:
        """Append a message, to a known topic or a new one."""
        if topic not in self._connections:
            self.add_topic(topic, message.__msgtype__, latched)
        connection = self._connections[topic]
        if isinstance(message, SerializedMessage):
            data: bytes | memoryview = message.data
        else:
            store = self._store
            serialize = store.serialize_ros1 if self._ros1 else store.serialize_cdr
            data = serialize(message, connection.msgtype)
        self._writer.write(connection, log_time_ns, data)

    def new(self, msgtype: str, *values: Any) -> Message:  # noqa: ANN401 - of any fields
        """Make a message."""
        return self._store.types[msgtype](*values)

    def header(self, stamp_ns: int, frame_id: str) -> Message:
        stamp = self.new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))
        return self.new("std_msgs/msg/Header", *([0] if self._ros1 else []), stamp, frame_id)

    def quaternion(self, T: FloatArray) -> Message:
        """Make a message of the rotation of a transform (4, 4)."""
        return self.new("geometry_msgs/msg/Quaternion", *(float(q) for q in quaternion_xyzw(T)))

    def transforms(self, stamp_ns: int, edges: Iterable[StaticTransform]) -> Message:
        """Make a TFMessage."""
        messages = []
        for edge in edges:
            shift = (float(t) for t in edge.T_parent_child[:3, 3])
            transform = self.new(
                "geometry_msgs/msg/Transform",
                self.new("geometry_msgs/msg/Vector3", *shift),
                self.quaternion(edge.T_parent_child),
            )
            header = self.header(stamp_ns, edge.parent)
            stamped = self.new("geometry_msgs/msg/TransformStamped", header, edge.child, transform)
            messages.append(stamped)
        return self.new("tf2_msgs/msg/TFMessage", messages)
