"""The files of a run folder. Each is written as NAME.part and renamed, so that a file that is there is complete."""

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import yaml
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.model import Doors, Walls
from ffmap.algorithms.building.votes import FusedCloud
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.atomic import write_atomically, write_geojson
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

FREE_THRESHOLD = 0.196
"""Nav2 reads a pixel p as free below it: (255 − 205) / 255 = 0.1961 has to stay unknown, so its usual 0.25 will not do."""


def write_ply(path: Path, cloud: FusedCloud, colours: UInt8Array) -> None:
    """Binary little-endian PLY: x y z (metres, map frame), label, red green blue.

    colours: (m, 3) uint8, one row a point.
    """
    vertex = np.zeros(
        len(cloud),
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "u1"), ("red", "u1"), ("green", "u1"), ("blue", "u1")],
    )
    for axis, name in enumerate("xyz"):
        vertex[name] = cloud.points_map[:, axis]
    vertex["label"] = cloud.label
    for channel, name in enumerate(("red", "green", "blue")):
        vertex[name] = colours[:, channel]
    kinds = {"<f4": "float", "|u1": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment fused semantic cloud, metres in the map frame",
        f"element vertex {len(cloud)}",
        *(f"property {kinds[vertex.dtype[name].str]} {name}" for name in vertex.dtype.names or ()),
        "end_header\n",
    ]

    def write(part: Path) -> None:
        with part.open("wb") as file:
            file.write("\n".join(header).encode())
            vertex.tofile(file)

    write_atomically(path, write)


def write_grid(path: Path, grid: GridMap) -> None:
    """`path` (…/NAME.yaml) and NAME.pgm beside it, as Nav2's map_server reads them; the image's first row is the top."""
    image = path.with_suffix(".pgm")
    rows, columns = grid.cells.shape
    pixels = np.ascontiguousarray(grid.cells[::-1], np.uint8).tobytes()
    description = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(grid.cell_m),
        "origin": [float(grid.origin[0]), float(grid.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": FREE_THRESHOLD,
    }
    text = yaml.safe_dump(description, sort_keys=False, default_flow_style=None)
    write_atomically(image, lambda part: part.write_bytes(f"P5\n{columns} {rows}\n255\n".encode() + pixels))
    write_atomically(path, lambda part: part.write_text(text, "utf-8"))


def write_walls(path: Path, walls: Walls, thickness_m: FloatArray | None = None) -> None:
    """Wall faces as LineStrings in metres of the map frame; heights, thickness and spread in metres.

    thickness_m: (W,) of each face's wall, NaN where its other side was not seen; None where nobody asked.
    """
    write_geojson(
        path,
        [
            _line_feature(
                ends,
                {
                    "normal": walls.normal[i],
                    "bottom": _millimetres(walls.bottom_m[i]),
                    "top": _millimetres(walls.top_m[i]),
                    "scans": walls.scan_count[i],
                    "rms": walls.rms_m[i],
                    "samples": walls.sample_count[i],
                    "thickness": _millimetres(thickness_m[i]) if thickness_m is not None else None,
                },
            )
            for i, ends in enumerate(walls.ends)
        ],
    )


def write_doors(path: Path, doors: Doors, rooms: Sequence[Sequence[str | None] | None] | None = None) -> None:
    """Doors as LineStrings along the sill between the jambs, in metres of the map frame.

    rooms: names of the two rooms that each door joins, None for one that was not mapped.
    """
    write_geojson(
        path,
        [
            _line_feature(
                ends,
                {
                    "state": DoorState(int(doors.state[i])).name.lower(),
                    "width": _millimetres(np.linalg.norm(ends[1] - ends[0])),
                    "height": _millimetres(doors.head_m[i]),
                    "depth": _millimetres(doors.depth_m[i]),
                    "confidence": doors.confidence[i],
                    "crossed": bool(doors.crossed[i]),
                    "rooms": rooms[i] if rooms is not None else None,
                },
            )
            for i, ends in enumerate(doors.ends)
        ],
    )


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
        self._sink: _Ros1Sink | _Ros2Sink
        self._sink = _Ros1Sink(run_dir) if container == "ros1" else _Ros2Sink(run_dir, container)
        self.path = self._sink.path
        self._store = make_typestore(self._sink.ros_version)
        self._topic = topic
        self._base_frame = base_frame
        self._static = list(static_transforms)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        self._sink.open()
        self._connections = {
            topic: self._sink.connect(topic, msgtype, latched=topic == "/tf_static")
            for topic, msgtype in (("/tf_static", TF), ("/tf", TF), (self._topic, CLOUD))
        }
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if kind is None:
            self._sink.finish()
        else:
            self._sink.abort()

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
        sequence = (0,) if self._sink.ros_version == 1 else ()
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
        serialize = self._store.serialize_ros1 if self._sink.ros_version == 1 else self._store.serialize_cdr
        self._sink.write(self._connections[topic], log_time_ns, serialize(message, msgtype))


class _Ros1Sink:
    """labelled.bag by way of labelled.bag.part."""

    ros_version: Literal[1] = 1

    def __init__(self, run_dir: Path) -> None:
        self.path = run_dir / LABELLED_BAG
        self._part = run_dir / f"{LABELLED_BAG}.part"

    def open(self) -> None:
        self._part.unlink(missing_ok=True)
        self._writer = Ros1Writer(self._part)
        self._writer.open()

    def connect(self, topic: str, msgtype: str, latched: bool) -> Connection:
        store = make_typestore(self.ros_version)
        return self._writer.add_connection(topic, msgtype, typestore=store, latching=int(latched))

    def write(self, connection: Connection, log_time_ns: int, data: bytes | memoryview) -> None:
        self._writer.write(connection, log_time_ns, data)

    def finish(self) -> None:
        self._writer.close()
        self._part.replace(self.path)

    def abort(self) -> None:
        self._writer.abort()
        self._part.unlink(missing_ok=True)


class _Ros2Sink:
    """labelled/ by way of labelled.part/labelled/, for a bag's files are named after the folder they are made in."""

    ros_version: Literal[2] = 2

    def __init__(self, run_dir: Path, container: Container) -> None:
        self.path = run_dir / LABELLED_FOLDER
        self._part = run_dir / f"{LABELLED_FOLDER}.part"
        self._storage = StoragePlugin.MCAP if container == "mcap" else StoragePlugin.SQLITE3

    def open(self) -> None:
        shutil.rmtree(self._part, ignore_errors=True)
        # Version 8 is what the most releases of ROS 2 read.
        self._writer = Ros2Writer(self._part / LABELLED_FOLDER, version=8, storage_plugin=self._storage)
        self._writer.open()
        if isinstance(self._writer.storage, Sqlite3Writer):
            # Large pages suit large messages; the file has no name before it is complete, so no journal is needed.
            self._writer.storage.conn.executescript(
                "PRAGMA journal_mode=OFF; PRAGMA synchronous=OFF; PRAGMA page_size=65536; VACUUM;"
            )

    def connect(self, topic: str, msgtype: str, latched: bool) -> Connection:
        store = make_typestore(self.ros_version)
        return self._writer.add_connection(
            topic, msgtype, typestore=store, offered_qos_profiles=[_LATCHED] if latched else []
        )

    def write(self, connection: Connection, log_time_ns: int, data: bytes | memoryview) -> None:
        self._writer.write(connection, log_time_ns, data)

    def finish(self) -> None:
        self._writer.close()
        shutil.rmtree(self.path, ignore_errors=True)
        (self._part / LABELLED_FOLDER).replace(self.path)
        self._part.rmdir()

    def abort(self) -> None:
        self._writer.abort()
        shutil.rmtree(self._part, ignore_errors=True)


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


def _millimetres(length_m: np.floating[Any]) -> float:
    """What is written of a length: no more digits than it is good for."""
    return round(float(length_m), 3)


def _line_feature(ends: FloatArray, properties: dict[str, object]) -> dict[str, Any]:
    return {"properties": properties, "geometry": {"type": "LineString", "coordinates": ends}}
