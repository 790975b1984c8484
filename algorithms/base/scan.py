"""One revolution of a spinning lidar, as every step of the method receives it."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numba
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
        description="Maximum range (m) of a return: indoors, farther returns are errors.",
    )
    own_body: bool = Field(
        True,
        description="Ignore the robot's own body: returns near the lidar that never move in its "
        "frame.",
    )


@dataclass(frozen=True)
class RingOrder:
    """The returns of a scan ring by ring, by increasing azimuth.

    order: (n,) int32, rows of the scan; order[starts[r]:starts[r + 1]] is ring r.
    starts: (rings + 1,) int32.
    turn_rad: (n,) float64, azimuth about the spin axis from x towards y, -π to π, in this order.
    rank: (n,) int32, the place of each row in this order.
    """

    order: IntArray
    starts: IntArray
    turn_rad: FloatArray
    rank: IntArray


@dataclass(frozen=True)
class Scan:
    """The valid returns of one revolution, one row each; see `in_canonical_order`.

    points_sensor: (n, 3) float32, metres; z is the spin axis.
    ring: (n,) uint16, the emitter; 0 has the lowest elevation about the spin axis.
    ring_count: number of emitters.
    time_ns: (n,) int64 from `start_ns` to each firing, never negative; None: the cloud has none.
    start_ns: time of the first firing; `stamp_ns` where the cloud has no times.
    stamp_ns: the message's header stamp.
    cloud_index: (n,) int32, the place of each return in the message (row-major).
    cloud_size: number of points in the message, valid or not.
    intensity: (n,) float32 in the sensor's unit, NaN where unknown; None: the cloud has none.
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
        if self.time_ns is None or not len(self):
            return self.start_ns
        return self.start_ns + int(self.time_ns.max())

    @property
    def reference_ns(self) -> int:
        """The middle of the sweep: the time of the scan's pose."""
        return (self.start_ns + self.end_ns) // 2

    @cached_property
    def rings(self) -> RingOrder:
        """The returns along the rings, for smoothing and point lines."""
        turn = np.arctan2(self.points_sensor[:, 1], self.points_sensor[:, 0])
        order, starts, rank = sort_groups(self.ring, turn, self.ring_count)
        return RingOrder(order, starts, turn.take(order).astype(np.float64), rank)


def sort_groups(
    group: IntArray, key: FloatArray | IntArray, groups: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Sort rows by group (n,), and within a group by key (n,).

    Returns order (n,) int32, starts (groups + 1,) int32 and rank (n,) int32: group g by increasing
    key is order[starts[g]:starts[g + 1]]; rank is the place of each row in this order.
    """
    # Firings come nearly in the order of azimuth, which this sort makes use of.
    return _distributed(group, np.argsort(key, kind="stable"), groups)


@numba.njit(cache=True, nogil=True)
def _distributed(
    group: IntArray, by_key: IntArray, groups: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Distribute rows over their groups in the order `by_key` (n,); see `sort_groups`."""
    starts = np.zeros(groups + 1, np.int32)
    for g in group:
        starts[g + 1] += 1
    for g in range(groups):
        starts[g + 1] += starts[g]
    following = starts.copy()
    order, rank = np.empty(len(group), np.int32), np.empty(len(group), np.int32)
    for row in by_key:
        place = following[group[row]]
        following[group[row]] += 1
        order[place], rank[row] = row, place
    return order, starts, rank


def within_range(scan: Scan, range_max_m: float) -> Scan:
    """Remove farther returns; returns the same object where there are none."""
    points = scan.points_sensor
    if np.abs(points).max(initial=0.0) < range_max_m / 2:  # Nothing is near the limit
        return scan
    near = np.einsum("ij,ij->i", points, points, dtype=np.float64) <= range_max_m**2
    return scan if near.all() else subset(scan, near)


def in_canonical_order(scan: Scan) -> Scan:
    """Sort the returns by an order that does not depend on the cloud's; the same object if sorted.

    Every n-th return, or a sum over them, is then the same however a driver arranges its clouds.
    Where emitters fire one by one, the order is by time. Where several fire at once, or no times
    are known, it is emitter by emitter from the top, each by time or azimuth: in order of firing,
    every n-th return would belong to the same emitters.
    """
    if scan.time_ns is not None and np.all(np.diff(scan.time_ns) > 0):
        return scan
    from_top = scan.ring_count - 1 - scan.ring.astype(np.int64)
    keys: tuple[FloatArray | IntArray, FloatArray | IntArray]
    x, y, z = scan.points_sensor.T
    if scan.time_ns is None:
        keys = from_top, np.arctan2(y, x)
    else:
        later_firings = np.count_nonzero(np.diff(np.sort(scan.time_ns, kind="stable")))
        several_fire = 2 * later_firings < len(scan) - 2
        keys = (from_top, scan.time_ns) if several_fire else (scan.time_ns, from_top)
    step, step_within = np.diff(keys[0]), np.diff(keys[1])
    if np.all((step > 0) | ((step == 0) & (step_within > 0))):
        return scan
    if keys[0] is from_top:
        order = sort_groups(from_top, keys[1], scan.ring_count)[0]
    else:
        order = np.lexsort(keys[::-1])
    same = [np.diff(key[order]) == 0 for key in keys]
    tied = np.flatnonzero(same[0] & same[1])
    if len(tied):
        # Several returns of one ray.
        places = np.union1d(tied, tied + 1)
        rows = order[places]
        by_all = np.lexsort([key[rows] for key in (z, y, x, *keys[::-1])])
        order[places] = rows[by_all]
    return scan if np.array_equal(order, np.arange(len(scan))) else subset(scan, order)


def subset(scan: Scan, rows: BoolArray | IntArray) -> Scan:
    """Select returns by a mask or by rows, which may also reorder them."""
    if rows.dtype == bool:
        rows = np.flatnonzero(rows)  # Selects several times as fast
    return replace(
        scan,
        points_sensor=scan.points_sensor.take(rows, axis=0),
        ring=scan.ring.take(rows),
        time_ns=None if scan.time_ns is None else scan.time_ns.take(rows),
        cloud_index=scan.cloud_index.take(rows),
        intensity=None if scan.intensity is None else scan.intensity.take(rows),
    )
