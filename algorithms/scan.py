"""One revolution of a spinning lidar, as every step of the method receives it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.integer[Any]]
BoolArray = npt.NDArray[np.bool_]
UInt8Array = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Scan:
    """The returns of one revolution, invalid points dropped; all arrays have one row a return, in the cloud's order.

    points_sensor: (n, 3) float32, metres, in the sensor's frame; z is its spin axis.
    ring: (n,) uint16, the emitter, 0 = lowest elevation about the spin axis.
    ring_count: how many emitters the sensor has.
    time_ns: (n,) int64, nanoseconds from `start_ns` to each firing, never negative; None where the cloud has no times.
    start_ns: time of the sweep's first firing; equals `stamp_ns` where the cloud has no times.
    stamp_ns: the message's header stamp.
    cloud_index: (n,) int32, the place of each return in the message (row-major), to write labels back.
    cloud_size: how many points the message has, valid or not.
    """

    points_sensor: FloatArray
    ring: IntArray
    ring_count: int
    time_ns: IntArray | None
    start_ns: int
    stamp_ns: int
    cloud_index: IntArray
    cloud_size: int

    def __len__(self) -> int:
        return len(self.points_sensor)

    @property
    def end_ns(self) -> int:
        """Time of the last firing."""
        return self.start_ns + (int(self.time_ns.max()) if self.time_ns is not None and len(self) else 0)
