"""The messages of a simulated drive, as the drivers of its lidars publish them, and its truth."""

import os
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders import bag
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import make_cloud
from ffmap.loaders.sensors.livox import LIVOX_POINT, livox_message
from ffmap.loaders.sensors.velodyne import VELODYNE_POINT
from ffmap.loaders.simulator.raytrace import Sweep
from ffmap.loaders.simulator.sensors import Lidar, PointLayout
from ffmap.loaders.simulator.settings import Container

_OUSTER_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "t", "reflectivity", "ring", "noise", "range"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<u4", "<u2", "u1", "<u2", "<u4"],
        "offsets": [0, 4, 8, 16, 20, 24, 26, 28, 32],
        "itemsize": 48,
    }
)
_HESAI_POINT = np.dtype(
    {
        "names": ["x", "y", "z", "intensity", "timestamp", "ring"],
        "formats": ["<f4", "<f4", "<f4", "<f4", "<f8", "<u2"],
        "offsets": [0, 4, 8, 16, 24, 32],
        "itemsize": 48,
    }
)
_BARE_POINT = np.dtype({"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 16})
_POINTS: dict[PointLayout, np.dtype[np.void]] = {
    "velodyne": VELODYNE_POINT,
    "ouster": _OUSTER_POINT,
    "hesai": _HESAI_POINT,
    "packets": _BARE_POINT,
    "livox": LIVOX_POINT,
}
_GRAVITY = np.array([0.0, 0.0, 9.81])
_TRUTH_POINT = np.dtype([("truth", "u1")])
_CONTAINERS: dict[Container, bag.Container] = {"bag": "ros1", "db3": "sqlite3", "mcap": "mcap"}


class DriveWriter(BagWriter):
    """The messages of a drive, in a new bag. Raises InputError where the place is taken or cannot be written."""

    caller = "/simulator"

    def __init__(self, out: Path, container: Container) -> None:
        # A name of this process alone: whatever is left there is removed.
        part = out.with_name(f"{out.name}.{os.getpid()}.part")
        for path, words in ((out, "exists already"), (part, "is in the way")):
            if path.exists():
                raise InputError(f"{path}: {words}; remove it or choose another name")
        super().__init__(out, _CONTAINERS[container], part)

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            return super().__enter__()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror}); choose another folder") from error

    def _cloud(self, lidar: Lidar, stamp_ns: int, points: Any) -> Any:  # noqa: ANN401
        height = lidar.model.rings if lidar.points == "ouster" else 1
        return make_cloud(self._store, self.header(stamp_ns, lidar.frame_id), points.reshape(height, -1))

    def cloud(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The sweep, or what a packet holds of it, as the lidar's driver publishes it."""
        points = np.zeros(len(sweep.range_m), _POINTS[lidar.points])
        points["x"], points["y"], points["z"] = sweep.points_sensor.T
        from_top = lidar.model.rings - 1 - sweep.ring  # Ouster and Hesai count from the top
        match lidar.points:
            case "velodyne":
                points["ring"], points["time"] = sweep.ring, sweep.time_ns / 1e9
            case "ouster":
                points["ring"], points["t"], points["reflectivity"] = from_top, sweep.time_ns, sweep.intensity
                points["range"] = np.round(sweep.range_m * 1000.0)
            case "hesai":
                points["ring"], points["timestamp"] = from_top, (epoch_ns + sweep.stamp_ns + sweep.time_ns) / 1e9
            case "livox":
                points["line"], points["offset_time"], points["reflectivity"] = (
                    sweep.ring,
                    sweep.time_ns,
                    sweep.intensity,
                )
                return livox_message(self._ros1, epoch_ns + sweep.stamp_ns, lidar.frame_id, points)
        if lidar.points != "packets":
            points["intensity"] = sweep.intensity
        return self._cloud(lidar, epoch_ns + sweep.stamp_ns, points)

    def classes(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The truth of every place of the same cloud."""
        return self._cloud(lidar, epoch_ns + sweep.stamp_ns, sweep.truth.view(_TRUTH_POINT))

    def imu(
        self, before: FloatArray, T_map_base: FloatArray, after: FloatArray, step_s: float, stamp_ns: int, frame: str
    ) -> Any:  # noqa: ANN401
        """What an IMU in the base measures, from three poses (4, 4) one after the other; without orientation."""
        turned = Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).as_rotvec() / (2 * step_s)
        moved = (after[:3, 3] - 2 * T_map_base[:3, 3] + before[:3, 3]) / step_s**2
        force = T_map_base[:3, :3].T @ (moved + _GRAVITY)
        turn, push = (self.new("geometry_msgs/msg/Vector3", *(float(v) for v in values)) for values in (turned, force))
        unknown, none = np.r_[-1.0, np.zeros(8)], np.zeros(9)
        orientation = self.new("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        header = self.header(stamp_ns, frame)
        return self.new("sensor_msgs/msg/Imu", header, orientation, unknown, turn, none, push, none)

    def odometry(self, T_map_base: FloatArray, stamp_ns: int, base_frame: str, frame: str = "map") -> Any:  # noqa: ANN401
        """A pose; its twist is left at zero."""
        place = self.new("geometry_msgs/msg/Point", *(float(v) for v in T_map_base[:3, 3]))
        pose = self.new("geometry_msgs/msg/Pose", place, self.quaternion(T_map_base))
        zero = self.new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        return self.new(
            "nav_msgs/msg/Odometry", self.header(stamp_ns, frame), base_frame,
            self.new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
            self.new("geometry_msgs/msg/TwistWithCovariance", self.new("geometry_msgs/msg/Twist", zero, zero),
                      np.zeros(36))
        )  # fmt: skip

    def text(self, text: str) -> Any:  # noqa: ANN401
        return self.new("std_msgs/msg/String", text)
