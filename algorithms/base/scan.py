"""One revolution of a spinning lidar, as every step of the method receives it."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from pydantic import Field

from ffmap.algorithms.base.rings import RingOrder
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
        description="Maximum distance (m) of a return from the lidar: indoors, farther ones are errors.",
    )
    own_body: bool = Field(
        True, description="Leave out the robot's own body: returns near the lidar that stay in one place of it all the time."
    )


@dataclass(frozen=True)
class Scan:
    """The returns of one revolution, invalid points dropped; all arrays have one row a return, see `in_canonical_order`.

    points_sensor: (n, 3) float32, metres, in the sensor's frame; z is its spin axis.
    ring: (n,) uint16, the emitter, 0 = lowest elevation about the spin axis.
    ring_count: how many emitters the sensor has.
    time_ns: (n,) int64, nanoseconds from `start_ns` to each firing, never negative; None where the cloud has no times.
    start_ns: time of the sweep's first firing; equals `stamp_ns` where the cloud has no times.
    stamp_ns: the message's header stamp.
    cloud_index: (n,) int32, the place of each return in the message (row-major), to write labels back.
    cloud_size: how many points the message has, valid or not.
    intensity: (n,) float32 in the sensor's own unit, NaN where a return has none; None where the cloud gives none.
    """

    points_sensor: FloatArray
    ring: IntArray
    ring_count: int
    time_ns: IntArray | None
    start_ns: int
    stamp_ns: int
    cloud_index: IntArray
    cloud_size: int
    intensity: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.points_sensor)

    @property
    def end_ns(self) -> int:
        """Time of the last firing."""
        return self.start_ns + (int(self.time_ns.max()) if self.time_ns is not None and len(self) else 0)

    @property
    def reference_ns(self) -> int:
        """The middle of the sweep, whose pose stands for the whole scan's."""
        return (self.start_ns + self.end_ns) // 2

    @cached_property
    def rings(self) -> RingOrder:
        """Its returns ring by ring: smoothing and point lines both go along the rings."""
        return RingOrder.of(self.points_sensor, self.ring, self.ring_count)


def within_range(scan: Scan, range_max_m: float) -> Scan:
    """The scan without the returns that are farther from the lidar; the very same where there are none."""
    near = _nearer(scan.points_sensor, range_max_m)
    return scan if near.all() else subset(scan, near)


@numba.njit(cache=True, nogil=True)
def _nearer(points: FloatArray, range_max_m: float) -> BoolArray:  # pragma: no cover
    near = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        near[i] = x * x + y * y + z * z <= range_max_m * range_max_m
    return near


def in_canonical_order(scan: Scan) -> Scan:
    """The scan with its returns in an order that the cloud's does not change; the very same where they have it already.

    Every n-th return, or a sum over them, is then the same however a driver arranges its clouds. Where the emitters fire
    one by one, the order is that of firing. Where several fire at once, or no times are known, it is emitter by emitter
    from the top, each in order of time or azimuth: of returns in order of firing, every n-th would be the same emitters'.
    """
    from_top = scan.ring_count - 1 - scan.ring.astype(np.int64)
    keys: tuple[FloatArray | IntArray, FloatArray | IntArray]
    x, y, z = scan.points_sensor.T
    if scan.time_ns is None:
        keys = from_top, np.arctan2(y, x)
    else:
        in_time, times = _times_in_order(scan.time_ns)
        if not in_time:
            times = 1 + int(np.count_nonzero(np.diff(np.sort(scan.time_ns, kind="stable"))))
        several_fire = 2 * (times - 1) < len(scan) - 2
        keys = (from_top, scan.time_ns) if several_fire else (scan.time_ns, from_top)
    if _in_order(*keys):
        return scan
    order = np.lexsort(keys[::-1])
    same = [np.diff(key[order]) == 0 for key in keys]
    if np.any(same[0] & same[1]):
        # What a ray returned twice.
        order = np.lexsort((z, y, x, *keys[::-1]))
    return scan if np.array_equal(order, np.arange(len(scan))) else subset(scan, order)


@numba.njit(cache=True, nogil=True)
def _times_in_order(time_ns: IntArray) -> tuple[bool, int]:  # pragma: no cover
    """Whether firings are in the order of their times, and if so how many times there are."""
    times = 1
    for i in range(1, len(time_ns)):
        if time_ns[i] < time_ns[i - 1]:
            return False, 0
        times += time_ns[i] > time_ns[i - 1]
    return True, times


@numba.njit(cache=True, nogil=True)
def _in_order(first: IntArray, second: FloatArray | IntArray) -> bool:  # pragma: no cover
    """Whether rows increase by their first key, and by the second where the first is the same; none twice."""
    for i in range(1, len(first)):
        if first[i] < first[i - 1] or (first[i] == first[i - 1] and second[i] <= second[i - 1]):
            return False
    return True


def subset(scan: Scan, rows: BoolArray | IntArray) -> Scan:
    """Some of the returns, or all of them in another order."""
    return replace(
        scan,
        points_sensor=scan.points_sensor[rows],
        ring=scan.ring[rows],
        time_ns=None if scan.time_ns is None else scan.time_ns[rows],
        cloud_index=scan.cloud_index[rows],
        intensity=None if scan.intensity is None else scan.intensity[rows],
    )
