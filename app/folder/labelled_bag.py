"""labelled.bag or labelled/: every vertical cloud again, with its labels, and the poses."""

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.names import LABELLED_BAG, LABELLED_FOLDER
from ffmap.loaders.bag import Bag, Container, Message, make_typestore
from ffmap.loaders.errors import CloudError
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.pointcloud2 import describe_layout, encode_labelled, stamp_ns
from ffmap.loaders.rig import Rig
from ffmap.loaders.scans import CloudIndex, read_messages

MAP_FRAME = "map"
CLOUD = "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"


def write_labelled_bag(
    run_dir: Path,
    bag: Bag,
    index: CloudIndex,
    rig: Rig,
    trajectory: Trajectory,
    labels: Iterable[tuple[int, UInt8Array, UInt8Array]],
) -> Path:
    """Every vertical cloud of the bag again, with its labels; see `LabelledBagWriter`.

    index: the vertical clouds. trajectory: T_map_base. labels: in the bag's order, for each labelled scan its number,
    `label` and `label_scan`, both (height x width,); the points of clouds that are not among them get 255.
    """
    labelled = iter(labels)
    following = next(labelled, None)
    with LabelledBagWriter(run_dir, bag.container, index.topic, rig.base_frame, rig.static_transforms) as writer:
        for i, message in read_messages(bag, index):
            if following is not None and following[0] < i:
                raise ValueError(f"the labels of scan {following[0]} come out of order")
            if isinstance(message, CloudError):
                continue
            label = label_scan = np.full(int(message.height) * int(message.width), NO_RETURN, np.uint8)
            if following is not None and following[0] == i:
                _, label, label_scan = following
                following = next(labelled, None)
            usable = index.usable[i] and len(trajectory) > 0
            T_map_base = trajectory.at(index.stamp_ns[i : i + 1])[0] if usable else None
            writer.write(int(index.log_time_ns[i]), _labelled(message, index.topic, label, label_scan), T_map_base)
    return writer.path


def _labelled(message: Message, topic: str, label: UInt8Array, label_scan: UInt8Array) -> Message:
    """The cloud with its labels; one that contradicts itself stays as it is."""
    try:
        describe_layout(message, topic)
    except CloudError:
        return message
    return encode_labelled(message, label, label_scan)


class LabelledBagWriter:
    """Writes `labelled.bag` (ROS 1) or `labelled/` (ROS 2, the input's storage) cloud by cloud.

    Use as a context manager: complete at its end; after an exception nothing is left of it. One process writes; others
    hand it labels, which are 1/24 of the cloud's bytes.

    run_dir: the run folder. container: the input's. topic: the vertical clouds' topic.
    base_frame: the child of `map` in /tf. static_transforms: what /tf_static says, the lidar's mount among it.
    """

    def __init__(
        self,
        run_dir: Path,
        container: Container,
        topic: str,
        base_frame: str,
        static_transforms: Iterable[StaticTransform],
    ) -> None:
        self._container, self._ros_version = container, 1 if container == "ros1" else 2
        name = LABELLED_BAG if container == "ros1" else LABELLED_FOLDER
        self.path, self._part = run_dir / name, run_dir / f"{name}.part"
        self._store = make_typestore(1 if container == "ros1" else 2)
        self._topic = topic
        self._base_frame = base_frame
        self._static = list(static_transforms)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        self._remove_part()
        self._writer = self._open()
        for topic, msgtype in (("/tf_static", TF), ("/tf", TF), (self._topic, CLOUD)):
            latched = topic == "/tf_static"
            how = (
                {"latching": int(latched)} if self._ros_version == 1 else {"offered_qos_profiles": [_LATCHED] * latched}
            )
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=self._store, **how)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if kind is not None:
            self._writer.abort()
            self._remove_part()
            return
        self._writer.close()
        if self._ros_version == 1:
            self._part.replace(self.path)
        else:
            shutil.rmtree(self.path, ignore_errors=True)
            (self._part / LABELLED_FOLDER).replace(self.path)
            self._part.rmdir()

    def _open(self) -> Ros1Writer | Ros2Writer:
        if self._ros_version == 1:
            ros1 = Ros1Writer(self._part)
            ros1.open()
            return ros1
        storage = StoragePlugin.MCAP if self._container == "mcap" else StoragePlugin.SQLITE3
        # By way of labelled.part/labelled/, for a bag's files are named after the folder they are made in; version 8 is
        # what the most releases of ROS 2 read.
        writer = Ros2Writer(self._part / LABELLED_FOLDER, version=8, storage_plugin=storage)
        writer.open()
        if isinstance(writer.storage, Sqlite3Writer):
            # Large pages suit large messages; the file has no name before it is complete, so no journal is needed.
            writer.storage.conn.executescript(
                "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; PRAGMA page_size=65536; VACUUM;"
            )
        return writer

    def _remove_part(self) -> None:
        if self._part.is_dir():
            shutil.rmtree(self._part, ignore_errors=True)
        else:
            self._part.unlink(missing_ok=True)

    def write(self, log_time_ns: int, cloud: Message, T_map_base: FloatArray | None) -> None:
        """Append a labelled PointCloud2, and the pose at its stamp where there is one."""
        if self._static:
            self._write_transforms("/tf_static", log_time_ns, cloud, self._static)
            self._static = []
        if T_map_base is not None:
            pose = StaticTransform(MAP_FRAME, self._base_frame, T_map_base)
            self._write_transforms("/tf", log_time_ns, cloud, [pose])
        self._write(self._topic, log_time_ns, cloud, CLOUD)

    def _write_transforms(
        self, topic: str, log_time_ns: int, cloud: Message, framed: Sequence[StaticTransform]
    ) -> None:
        types = self._store.types
        seconds, nanoseconds = divmod(stamp_ns(cloud), 1_000_000_000)
        stamp = types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
        sequence = (0,) if self._ros_version == 1 else ()
        messages = []
        for transform in framed:
            x, y, z, w = (float(q) for q in transforms.quaternion_xyzw(transform.T_parent_child))
            messages.append(
                types["geometry_msgs/msg/TransformStamped"](
                    types["std_msgs/msg/Header"](*sequence, stamp, transform.parent),
                    transform.child,
                    types["geometry_msgs/msg/Transform"](
                        types["geometry_msgs/msg/Vector3"](*(float(t) for t in transform.T_parent_child[:3, 3])),
                        types["geometry_msgs/msg/Quaternion"](x, y, z, w),
                    ),
                )
            )
        self._write(topic, log_time_ns, types[TF](messages), TF)

    def _write(self, topic: str, log_time_ns: int, message: Message, msgtype: str) -> None:
        serialize = self._store.serialize_ros1 if self._ros_version == 1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], log_time_ns, serialize(message, msgtype))


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
