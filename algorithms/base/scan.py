"""One revolution of a spinning lidar, as every step of the method receives it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field

from ffmap.algorithms.base.settings import StepSettings

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.integer[Any]]
BoolArray = npt.NDArray[np.bool_]
UInt8Array = npt.NDArray[np.uint8]


class ScanSettings(StepSettings):
    """Which returns of a scan are used."""

    range_max_m: float = Field(
        100.0,
        gt=0,
        le=150,
        description="Maximum distance in metres from the lidar; returns farther away are left out: indoors they are errors, "
        "and grids would have to reach as far.",
    )


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


def within_range(scan: Scan, range_max_m: float) -> Scan:
    """The scan without the returns that are farther from the lidar; the very same where there are none."""
    points = scan.points_sensor.astype(np.float64)
    near = np.einsum("ij,ij->i", points, points) <= range_max_m**2
    if near.all():
        return scan
    return replace(
        scan,
        points_sensor=scan.points_sensor[near],
        ring=scan.ring[near],
        time_ns=None if scan.time_ns is None else scan.time_ns[near],
        cloud_index=scan.cloud_index[near],
    )
