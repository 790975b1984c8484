"""The messages of a simulated drive, as the drivers of its lidars publish them, and its truth."""

import os
from pathlib import Path
from typing import Any, Self

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders import bag
from ffmap.loaders.bag_writer import BagWriter
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
        height = 1 if lidar.model.layout == "velodyne" else lidar.model.rings
        return make_cloud(self._store, self.header(stamp_ns, lidar.frame_id), points.reshape(height, -1))

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

    def odometry(self, T_map_base: FloatArray, stamp_ns: int, base_frame: str) -> Any:  # noqa: ANN401
        """A pose of the truth; its twist is left at zero."""
        place = self.new("geometry_msgs/msg/Point", *(float(v) for v in T_map_base[:3, 3]))
        pose = self.new("geometry_msgs/msg/Pose", place, self.quaternion(T_map_base))
        zero = self.new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        return self.new(
            "nav_msgs/msg/Odometry", self.header(stamp_ns, "map"), base_frame,
            self.new("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
            self.new("geometry_msgs/msg/TwistWithCovariance", self.new("geometry_msgs/msg/Twist", zero, zero),
                      np.zeros(36))
        )  # fmt: skip

    def text(self, text: str) -> Any:  # noqa: ANN401
        return self.new("std_msgs/msg/String", text)
