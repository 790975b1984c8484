"""ROS 1 bags and ROS 2 folders through rosbags: the messages of a simulated drive, written under a name of their own
until they are complete.
"""

import os
import shutil
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.bag import make_typestore
from ffmap.loaders.errors import InputError
from ffmap.loaders.packets import VELODYNE_POINT
from ffmap.loaders.pointcloud2 import make_cloud
from ffmap.loaders.simulator.raytrace import Sweep
from ffmap.loaders.simulator.sensors import Lidar
from ffmap.loaders.simulator.settings import Container

_OUSTER_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "noise", "range"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "u1", "<u2", "<u4"],
        "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32],
        "itemsize": 48,
    }
)
_TRUTH_POINT = np.dtype([("truth", "u1")])
_LATCHED = (
    Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, QosTime(0, 0), QosTime(0, 0),
        QosLiveliness.AUTOMATIC, QosTime(0, 0), False
    ),
)  # fmt: skip


class BagWriter:
    """Messages of a drive into one of the containers, in the order in which they are given.

    Written under another name; `close` gives it its own, leaving by an exception removes it. Raises InputError where
    the place is taken or cannot be written.
    """

    def __init__(self, out: Path, container: Container) -> None:
        if out.exists():
            raise InputError(f"{out}: exists already; remove it or choose another name")
        self._out = out
        # A name of this process alone: whatever is left there is removed.
        self._part = out.with_name(f"{out.name}.{os.getpid()}.part")
        self._stack = ExitStack()
        self._connections: dict[str, Any] = {}
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            if self._part.exists():
                raise InputError(f"{self._part}: is in the way; remove it or choose another name")
            self._open(container)
        except OSError as error:
            raise InputError(f"{out}: cannot be written ({error.strerror}); choose another folder") from error

    def _open(self, container: Container) -> None:
        if container == "bag":
            self._types = make_typestore(1)
            self._serialize: Any = self._types.serialize_ros1
            self._writer: Any = self._stack.enter_context(rosbag1.Writer(self._part))
            return
        self._types = make_typestore(2)
        self._serialize = self._types.serialize_cdr
        plugin = rosbag2.StoragePlugin.MCAP if container == "mcap" else rosbag2.StoragePlugin.SQLITE3
        # The folder's name becomes the name of the file inside it, so it gets its right name at once, one level down.
        self._part.mkdir()
        self._writer = self._stack.enter_context(
            rosbag2.Writer(self._part / self._out.name, version=8, storage_plugin=plugin)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()
        if kind is None:
            inner = self._part / self._out.name
            (inner if self._part.is_dir() else self._part).rename(self._out)
        if self._part.is_dir():
            shutil.rmtree(self._part)
        else:
            self._part.unlink(missing_ok=True)

    def write(self, topic: str, message: Any, log_time_ns: int, latched: bool = False) -> None:  # noqa: ANN401
        """Append one of rosbags' message objects."""
        if topic not in self._connections:
            if isinstance(self._writer, rosbag1.Writer):
                options: dict[str, Any] = {"latching": int(latched), "callerid": "/simulator"}
            else:
                options = {"offered_qos_profiles": _LATCHED if latched else ()}
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self._types, **options
            )
        self._writer.write(self._connections[topic], log_time_ns, self._serialize(message, message.__msgtype__))

    def _new(self, name: str, *values: Any) -> Any:  # noqa: ANN401
        return self._types.types[name](*values)

    def _header(self, stamp_ns: int, frame_id: str) -> Any:  # noqa: ANN401
        stamp = self._new("builtin_interfaces/msg/Time", stamp_ns // 1_000_000_000, stamp_ns % 1_000_000_000)
        counter = (0,) if isinstance(self._writer, rosbag1.Writer) else ()
        return self._new("std_msgs/msg/Header", *counter, stamp, frame_id)

    def _cloud(self, lidar: Lidar, stamp_ns: int, points: Any) -> Any:  # noqa: ANN401
        height = 1 if lidar.model.layout == "velodyne" else lidar.model.rings
        return make_cloud(self._types, self._header(stamp_ns, lidar.frame_id), points.reshape(height, -1))

    def cloud(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The sweep as the lidar's driver publishes it."""
        velodyne = lidar.model.layout == "velodyne"
        points = np.zeros(len(sweep.range_m), VELODYNE_POINT if velodyne else _OUSTER_POINT)
        points["x"], points["y"], points["z"] = sweep.points_sensor.T
        points["intensity"] = sweep.intensity
        if velodyne:
            points["ring"], points["time"] = sweep.ring, sweep.time_ns / 1e9
        else:
            points["ring"] = lidar.model.rings - 1 - sweep.ring  # Ouster counts from the top
            points["t"], points["reflectivity"] = sweep.time_ns, sweep.intensity
            points["range"] = np.round(sweep.range_m * 1000.0)
        return self._cloud(lidar, epoch_ns + sweep.stamp_ns, points)

    def classes(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The truth of every place of the same cloud."""
        return self._cloud(lidar, epoch_ns + sweep.stamp_ns, sweep.truth.view(_TRUTH_POINT))

    def static_transforms(self, base_frame: str, T_base_child: Mapping[str, FloatArray], stamp_ns: int) -> Any:  # noqa: ANN401
        """A TFMessage."""
        stamped = [
            self._new(
                "geometry_msgs/msg/TransformStamped", self._header(stamp_ns, base_frame), child,
                self._new("geometry_msgs/msg/Transform", self._vector(T), self._quaternion(T))
            )
            for child, T in T_base_child.items()
        ]  # fmt: skip
        return self._new("tf2_msgs/msg/TFMessage", stamped)

    def odometry(self, T_map_base: FloatArray, stamp_ns: int, base_frame: str) -> Any:  # noqa: ANN401
        """A pose of the truth; its twist is left at zero."""
        place = self._new("geometry_msgs/msg/Point", *(float(v) for v in T_map_base[:3, 3]))
        pose = self._new("geometry_msgs/msg/Pose", place, self._quaternion(T_map_base))
        zero = self._new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        return self._new(
            "nav_msgs/msg/Odometry", self._header(stamp_ns, "map"), base_frame,
            self._new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
            self._new("geometry_msgs/msg/TwistWithCovariance", self._new("geometry_msgs/msg/Twist", zero, zero),
                      np.zeros(36))
        )  # fmt: skip

    def text(self, text: str) -> Any:  # noqa: ANN401
        return self._new("std_msgs/msg/String", text)

    def _vector(self, T: FloatArray) -> Any:  # noqa: ANN401
        return self._new("geometry_msgs/msg/Vector3", *(float(v) for v in T[:3, 3]))

    def _quaternion(self, T: FloatArray) -> Any:  # noqa: ANN401
        quaternion = transforms.quaternion_xyzw(T)
        return self._new("geometry_msgs/msg/Quaternion", *(float(v) for v in quaternion))
