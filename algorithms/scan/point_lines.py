"""The 2n point lines of a scan, from below upwards, each of 200 returns (paper, III.A, eq. 1).

A lidar on its side: a point line is what one emitter measures on one side of the spin axis.
An upright lidar: its emitters sweep level, so a point line is a column, what all emitters measure
in one direction.
"""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan, sort_groups

POINTS_MIN = 20  # minimum number of returns in a line, without floor and ceiling
SAMPLES = 200  # returns in a resampled point line (III.A: "exactly 200 points")
COLUMN_PAIRS = 180  # pairs of opposite columns of an upright lidar, a degree apart
_LEANING_MIN_DEG = 15.0  # minimum angle of the spin axis to the upright for lines of emitters


@dataclass(frozen=True)
class PointLines:
    """The point lines of a scan: n pairs of opposite lines, of an emitter or of two columns.

    Line 2 × pair + side; side 0 is the half turn counter-clockwise about the spin axis, from
    straight down (emitters) or from the sensor's -x axis (columns, counted in the same sense).

    order: (r,) int32, the scan's returns line by line, each line from below upwards by its angle
        (eq. 1, unfolded), with floor and ceiling.
    starts: (2n + 1,) int32; order[starts[l]:starts[l + 1]] is line l.
    samples: (2n, 200) int32, each line without floor and ceiling, resampled to exactly 200 returns,
        from below upwards; -1 throughout a line with too few returns.
    """

    order: IntArray
    starts: IntArray
    samples: IntArray

    def __len__(self) -> int:
        return len(self.samples)

    def of(self, line: int) -> IntArray:
        """(k,) the returns of a line, from below upwards."""
        return self.order[self.starts[line] : self.starts[line + 1]]

    def count(self, chosen: BoolArray) -> IntArray:
        """(2n,) number of chosen returns in each line; chosen: (r,) of the scan."""
        return np.diff(np.concatenate([[0], np.cumsum(chosen[self.order])])[self.starts])


def make_point_lines(
    scan: Scan,
    down_sensor: FloatArray,
    is_horizontal: BoolArray,
    column_pairs: int = 0,
) -> PointLines:
    """Sort the returns into 2n point lines and resample each (paper, III.A, Fig. 4 and 5a).

    Eq. 1 as printed, the arc tangent of a ratio of coordinates, folds up onto down. Here the angle
    of an emitter's return is that about the spin axis from straight down; its sign is the side.

    down_sensor: (3,) gravity.
    is_horizontal: (r,) whether a return is floor or ceiling.
    column_pairs: n of an upright lidar; 0 for lines of emitters.
    Raises ValueError where no emitter's line is upright.
    """
    is_sampled, rings = ~is_horizontal, scan.rings
    if column_pairs:
        line, rise, in_middle = _columns(
            scan.points_sensor,
            scan.ring,
            scan.ring_count,
            rings.turn_rad,
            rings.rank,
            down_sensor,
            column_pairs,
        )
        # Across a sector, the range of a slanting wall changes.
        is_sampled = is_sampled & in_middle
        order, starts, _ = sort_groups(line, rise, 2 * column_pairs)
    else:
        if np.hypot(down_sensor[0], down_sensor[1]) < np.sin(np.radians(_LEANING_MIN_DEG)):
            raise ValueError("the spin axis is upright: no emitter sweeps from floor to ceiling")
        down_rad = float(np.arctan2(down_sensor[1], down_sensor[0]))
        order, starts = _halves(rings.order, rings.starts, rings.turn_rad, down_rad)
    samples = _resample(order, starts, is_horizontal, is_sampled)
    return PointLines(order, starts, samples)


@numba.njit(cache=True, nogil=True)
def _halves(
    ring_order: IntArray, ring_starts: IntArray, turn_rad: FloatArray, down_rad: float
) -> tuple[IntArray, IntArray]:
    """`order` and `starts` of `PointLines`: each ring is cut at straight down and straight up."""
    order, starts = np.empty_like(ring_order), np.zeros(2 * len(ring_starts) - 1, np.int32)
    up_rad = down_rad - np.pi if down_rad > 0.0 else down_rad + np.pi
    for ring in range(len(ring_starts) - 1):
        first, stop = ring_starts[ring], ring_starts[ring + 1]
        own, turn, count = ring_order[first:stop], turn_rad[first:stop], stop - first
        down, up = np.searchsorted(turn, np.array([down_rad, up_rad]), side="right")
        rising = up - down + (count if down_rad > 0.0 else 0)
        for k in range(count):
            # Once round from straight down: up on one side, and down on the other, reversed.
            place = k if k < rising else count - 1 - (k - rising)
            order[first + place] = own[(down + k) % count]
        starts[2 * ring + 1], starts[2 * ring + 2] = first + rising, stop
    return order, starts


@numba.njit(cache=True, nogil=True)
def _columns(
    points: FloatArray,
    ring: IntArray,
    ring_count: int,
    turn_rad: FloatArray,
    rank: IntArray,
    down: FloatArray,
    pairs: int,
) -> tuple[IntArray, FloatArray, BoolArray]:
    """The line (r,) of each return, the sine (r,) of its elevation, and whether it is sampled.

    Sampled are the returns nearest to the middle of their sector, one of each emitter.
    """
    count, sectors = len(points), 2 * pairs
    line, rise = np.empty(count, np.int32), np.empty(count, np.float32)
    nearest = np.full(sectors * ring_count, -1, np.int32)
    off = np.full(sectors * ring_count, np.float32(1.0))
    for i in range(count):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        range_m = max(np.sqrt(x * x + y * y + z * z), 1e-6)
        rise[i] = -(x * down[0] + y * down[1] + z * down[2]) / range_m
        place = (turn_rad[rank[i]] / (2.0 * np.pi) + 0.5) * sectors
        sector = min(max(int(place), 0), sectors - 1)
        line[i] = 2 * (sector % pairs) + sector // pairs
        cell = sector * ring_count + ring[i]
        from_middle = abs(place - sector - 0.5)
        if from_middle < off[cell]:
            nearest[cell], off[cell] = i, from_middle
    in_middle = np.zeros(count, np.bool_)
    for chosen in nearest:
        if chosen >= 0:
            in_middle[chosen] = True
    return line, rise, in_middle


@numba.njit(cache=True, nogil=True)
def _resample(
    order: IntArray, starts: IntArray, is_horizontal: BoolArray, is_sampled: BoolArray
) -> IntArray:
    """(2n, 200) evenly spaced sampled returns of each line with enough of non-horizontal ones."""
    lines = len(starts) - 1
    samples = np.full((lines, SAMPLES), -1, np.int32)
    for line in range(lines):
        own = order[starts[line] : starts[line + 1]]
        sampled = own[is_sampled[own]]
        if np.count_nonzero(~is_horizontal[own]) < POINTS_MIN or len(sampled) == 0:
            continue
        for s in range(SAMPLES):
            # Rounded s · (count - 1) / (SAMPLES - 1).
            place = (2 * s * (len(sampled) - 1) + SAMPLES - 1) // (2 * (SAMPLES - 1))
            samples[line, s] = sampled[place]
    return samples
