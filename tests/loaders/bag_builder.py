"""Small real bags, written with rosbags, and the clouds in them."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

from ffmap.loaders.bag import make_typestore

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
CLOUD = "sensor_msgs/msg/PointCloud2"
_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
VELODYNE = [
    ("x", "f4"),
    ("y", "f4"),
    ("z", "f4"),
    ("intensity", "f4"),
    ("ring", "u2"),
    ("time", "f4"),
]

Entry = tuple[str, int, Any]  # Topic, log time, message


def header(types: dict[str, Any], stamp_ns: int, frame: str) -> Any:
    make, time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    stamp = time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    if "seq" in make.__dataclass_fields__:
        return make(seq=0, stamp=stamp, frame_id=frame)
    return make(stamp=stamp, frame_id=frame)


def point_dtype(
    fields: Sequence[tuple[str, str]], big: bool = False, gap: int = 0
) -> np.dtype[np.void]:
    """Fields one after the other with `gap` bytes before each and at the end."""
    offsets, at = [], 0
    for _, kind in fields:
        at += gap
        offsets.append(at)
        at += np.dtype(kind).itemsize
    return np.dtype(
        {
            "names": [name for name, _ in fields],
            "formats": [(">" if big else "<") + kind for _, kind in fields],
            "offsets": offsets,
            "itemsize": at + gap,
        }
    )


def cloud(
    points: np.ndarray,
    stamp_ns: int = START_NS,
    frame: str = "lidar",
    ros_version: int = 1,
    row_padding: int = 0,
) -> Any:
    """A PointCloud2 of a structured array, (n,) or (height, width)."""
    types = make_typestore(ros_version).types
    grid = points if points.ndim == 2 else points.reshape(1, -1)
    height, width = grid.shape
    step = grid.dtype.itemsize
    data = np.zeros((height, width * step + row_padding), np.uint8)
    data[:, : width * step] = (
        np.ascontiguousarray(grid).view(np.uint8).reshape(height, width * step)
    )
    fields = [
        types["sensor_msgs/msg/PointField"](
            name=name, offset=offset, datatype=_CODES[dtype.str[1:]], count=1
        )
        for name, (dtype, offset, *_) in grid.dtype.fields.items()
    ]
    return types[CLOUD](
        header=header(types, stamp_ns, frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=any(dtype.str.startswith(">") for dtype, *_ in grid.dtype.fields.values()),
        point_step=step,
        row_step=data.shape[1],
        data=data.reshape(-1),
        is_dense=False,
    )


def sweep(
    columns: int = 90,
    elevations_deg: Sequence[float] = tuple(range(-15, 17, 2)),
    seed: int = 0,
    clockwise: bool = True,
) -> np.ndarray:
    """One revolution in the Velodyne driver's layout, in firing order: (columns x rings,)."""
    rng = np.random.default_rng(seed)
    elevation = np.radians(np.asarray(elevations_deg, np.float64))
    turn = 2 * np.pi * np.arange(columns) / columns
    azimuth = 1.0 + (-turn if clockwise else turn)
    points = np.zeros((columns, len(elevation)), point_dtype(VELODYNE))
    distance = 3 + rng.random(points.shape)
    points["x"] = distance * np.cos(elevation) * np.cos(azimuth)[:, None]
    points["y"] = distance * np.cos(elevation) * np.sin(azimuth)[:, None]
    points["z"] = distance * np.sin(elevation)
    points["ring"] = np.arange(len(elevation))
    points["time"] = 0.1 * np.arange(columns)[:, None] / columns
    return points.reshape(-1)


def only(points: np.ndarray, *names: str) -> np.ndarray:
    """The same points with these fields alone."""
    kinds = dict(VELODYNE)
    kept = np.zeros(points.shape, point_dtype([(name, kinds[name]) for name in names]))
    for name in names:
        kept[name] = points[name]
    return kept


def clouds(
    topic: str,
    count: int,
    frame: str = "lidar",
    ros_version: int = 1,
    late_ns: int = 0,
    **sweep_options: Any,
) -> list[Entry]:
    """Sweeps at 10 Hz, logged 100 ms after their stamps."""
    return [
        (
            topic,
            START_NS + (i + 1) * PERIOD_NS + late_ns,
            cloud(
                sweep(seed=i, **sweep_options),
                START_NS + i * PERIOD_NS + late_ns,
                frame,
                ros_version,
            ),
        )
        for i in range(count)
    ]


def tf_message(
    edges: Iterable[tuple[str, str, Sequence[float], Sequence[float]]],
    ros_version: int = 1,
    stamp_ns: int = START_NS,
) -> Any:
    """A TFMessage of (parent, child, translation, quaternion x y z w)."""
    types = make_typestore(ros_version).types
    stamped = [
        types["geometry_msgs/msg/TransformStamped"](
            header=header(types, stamp_ns, parent),
            child_frame_id=child,
            transform=types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](*map(float, translation)),
                rotation=types["geometry_msgs/msg/Quaternion"](*map(float, rotation)),
            ),
        )
        for parent, child, translation, rotation in edges
    ]
    return types["tf2_msgs/msg/TFMessage"](transforms=stamped)


def odometry(
    stamp_ns: int, position: Sequence[float], child: str = "base", ros_version: int = 1
) -> Any:
    types = make_typestore(ros_version).types
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    covariance = np.zeros(36)
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*map(float, position)),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
    )
    return types["nav_msgs/msg/Odometry"](
        header=header(types, stamp_ns, "map"),
        child_frame_id=child,
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, covariance),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](zero, zero), covariance
        ),
    )


def write_bag(
    path: Path, entries: Sequence[Entry], chunk_bytes: int | None = None, compression: str = ""
) -> Path:
    """Write a bag: ROS 1 for a .bag, else a ROS 2 folder, MCAP for a name that ends in "mcap"."""
    if path.suffix == ".bag":
        writer: Any = Ros1Writer(path)
        store = make_typestore(1)
        if compression:
            writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
        if chunk_bytes:
            writer.chunk_threshold = chunk_bytes
        serialize = store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if path.name.endswith("mcap") else StoragePlugin.SQLITE3
        writer = Ros2Writer(path, version=9, storage_plugin=plugin)
        store = make_typestore(2)
        if compression:
            mode = CompressionMode[compression.upper()]
            writer.set_compression(mode, CompressionFormat.ZSTD)
        serialize = store.serialize_cdr
    with writer:
        connections: dict[str, Any] = {}
        for topic, log_time_ns, message in entries:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], log_time_ns, serialize(message, kind))
    return path
