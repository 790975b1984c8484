"""The messages of a simulated drive as drivers publish them, and its ground truth."""

import os
from pathlib import Path
from typing import Any, Self

import numpy as np

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
_BARE_POINT = np.dtype(
    {"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 16}
)
_POINTS: dict[PointLayout, np.dtype[np.void]] = {
    "velodyne": VELODYNE_POINT,
    "ouster": _OUSTER_POINT,
    "hesai": _HESAI_POINT,
    "packets": _BARE_POINT,
    "livox": LIVOX_POINT,
}
_TRUTH_POINT = np.dtype([("truth", "u1")])
_CONTAINERS: dict[Container, bag.Container] = {"bag": "ros1", "db3": "sqlite3", "mcap": "mcap"}


class DriveWriter(BagWriter):
    """The messages of a drive in a new bag. Raises InputError if it exists or cannot be written."""

    caller = "/simulator"

    def __init__(self, out: Path, container: Container) -> None:
        # The name is unique to this process, so that a leftover can be removed.
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
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror}); choose another folder"
            ) from error

    def cloud(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """Return a sweep, or a packet of it, as the lidar's driver publishes it."""
        points = np.zeros(len(sweep.range_m), _POINTS[lidar.points])
        points["x"], points["y"], points["z"] = sweep.points_sensor.T
        from_top = lidar.model.rings - 1 - sweep.ring  # Ouster and Hesai count from the top
        stamp_ns = epoch_ns + sweep.stamp_ns
        match lidar.points:
            case "velodyne":
                points["ring"], points["time"] = sweep.ring, sweep.time_ns / 1e9
            case "ouster":
                points["ring"], points["t"] = from_top, sweep.time_ns
                points["reflectivity"] = sweep.intensity
                points["range"] = np.round(sweep.range_m * 1000.0)
            case "hesai":
                points["ring"], points["timestamp"] = from_top, (stamp_ns + sweep.time_ns) / 1e9
            case "livox":
                points["line"], points["offset_time"] = sweep.ring, sweep.time_ns
                points["reflectivity"] = sweep.intensity
                return livox_message(self._ros1, stamp_ns, lidar.frame_id, points)
        if lidar.points != "packets":
            points["intensity"] = sweep.intensity
        return self._cloud(lidar, stamp_ns, points)

    def classes(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """Return the class of every place of the same cloud."""
        return self._cloud(lidar, epoch_ns + sweep.stamp_ns, sweep.truth.view(_TRUTH_POINT))

    def _cloud(self, lidar: Lidar, stamp_ns: int, points: Any) -> Any:  # noqa: ANN401
        height = lidar.model.rings if lidar.points == "ouster" else 1
        header = self.header(stamp_ns, lidar.frame_id)
        return make_cloud(self._store, header, points.reshape(height, -1))

    def pose(self, T_map_base: FloatArray, stamp_ns: int, base_frame: str) -> Any:  # noqa: ANN401
        """Return an odometry message; its twist is zero."""
        place = self.new("geometry_msgs/msg/Point", *T_map_base[:3, 3].tolist())
        pose = self.new("geometry_msgs/msg/Pose", place, self.quaternion(T_map_base))
        zero = self.new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.new("geometry_msgs/msg/Twist", zero, zero)
        return self.new(
            "nav_msgs/msg/Odometry",
            self.header(stamp_ns, "map"),
            base_frame,
            self.new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
            self.new("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        )

    def text(self, text: str) -> Any:  # noqa: ANN401
        return self.new("std_msgs/msg/String", text)
