"""The messages of a simulated drive, as the drivers of its lidars publish them, and its truth."""

import os
from pathlib import Path
from typing import Any, Self

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders import bag
from ffmap.loaders.bag_writer import BagWriter
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator.raytrace import Sweep
from ffmap.loaders.simulator.sensors import Lidar
from ffmap.loaders.simulator.settings import Container

_FLOAT32, _UINT32, _UINT16, _UINT8 = 7, 6, 4, 2
_NUMPY_TYPE = {_FLOAT32: "<f4", _UINT32: "<u4", _UINT16: "<u2", _UINT8: "u1"}
_VELODYNE = [("x", 0, _FLOAT32), ("y", 4, _FLOAT32), ("z", 8, _FLOAT32), ("intensity", 12, _FLOAT32),
             ("ring", 16, _UINT16), ("time", 18, _FLOAT32)]  # fmt: skip
_OUSTER = [("x", 0, _FLOAT32), ("y", 4, _FLOAT32), ("z", 8, _FLOAT32), ("intensity", 16, _FLOAT32), ("t", 20, _UINT32),
           ("reflectivity", 24, _UINT16), ("ring", 26, _UINT8), ("noise", 28, _UINT16), ("range", 32, _UINT32)]  # fmt: skip
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

    def _cloud(
        self,
        stamp_ns: int,
        frame_id: str,
        fields: list[tuple[str, int, int]],
        rows: Any,  # noqa: ANN401
        height: int,
    ) -> Any:  # noqa: ANN401
        described = [self.new("sensor_msgs/msg/PointField", n, offset, kind, 1) for n, offset, kind in fields]
        width, step = len(rows) // height, rows.dtype.itemsize
        return self.new(
            "sensor_msgs/msg/PointCloud2", self.header(stamp_ns, frame_id), height, width, described, False, step,
            step * width, rows.view(np.uint8), height == 1
        )  # fmt: skip

    def cloud(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The sweep as the lidar's driver publishes it."""
        fields, height = (_VELODYNE, 1) if lidar.model.layout == "velodyne" else (_OUSTER, lidar.model.rings)
        rows = _rows(fields, len(sweep.range_m))
        rows["x"], rows["y"], rows["z"] = sweep.points_sensor.T
        rows["intensity"] = sweep.intensity
        if lidar.model.layout == "velodyne":
            rows["ring"], rows["time"] = sweep.ring, sweep.time_ns / 1e9
        else:
            rows["ring"] = lidar.model.rings - 1 - sweep.ring  # Ouster counts from the top
            rows["t"], rows["reflectivity"] = sweep.time_ns, sweep.intensity
            rows["range"] = np.round(sweep.range_m * 1000.0)
        return self._cloud(epoch_ns + sweep.stamp_ns, lidar.frame_id, fields, rows, height)

    def classes(self, lidar: Lidar, sweep: Sweep, epoch_ns: int) -> Any:  # noqa: ANN401
        """The truth of every place of the same cloud."""
        fields = [("truth", 0, _UINT8)]
        rows = _rows(fields, len(sweep.truth))
        rows["truth"] = sweep.truth
        height = 1 if lidar.model.layout == "velodyne" else lidar.model.rings
        return self._cloud(epoch_ns + sweep.stamp_ns, lidar.frame_id, fields, rows, height)

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


def _rows(fields: list[tuple[str, int, int]], count: int) -> Any:  # noqa: ANN401
    """Zeros (count,) of the structured type that the fields describe."""
    names, offsets, kinds = zip(*fields, strict=True)
    last = np.dtype(_NUMPY_TYPE[kinds[-1]]).itemsize
    # Ouster's points are aligned to 16 bytes, Velodyne's are not aligned at all.
    size = offsets[-1] + last if "t" not in names else 48
    formats = [_NUMPY_TYPE[kind] for kind in kinds]
    return np.zeros(count, np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size}))
