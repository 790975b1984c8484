"""The 2n point lines of a scan, from below upwards, each resampled to 200 returns (paper, III.A, eq. 1).

The line of a lidar that lies is what one emitter sees on one side. An upright lidar's emitters sweep level, and its lines are
its columns: what all emitters see in one direction.
"""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan, sort_groups
from ffmap.algorithms.scan.rearrangement import RearrangementSettings

SAMPLES = 200
"""Returns in a resampled point line (paper, III.A: "exactly 200 points")."""
COLUMN_PAIRS = 180
"""Pairs of opposite columns of an upright lidar: its point lines are a degree apart."""
_LEANING_MIN_DEG = 15.0  # of a spin axis that is less far off upright, no emitter's line stands upright


@dataclass(frozen=True)
class PointLines:
    """The point lines of a scan: n pairs of opposite lines, of an emitter or of two columns.

    Line 2 × pair + side; side 0 is the half turn counter-clockwise about the spin axis: of emitters from straight down, of
    columns, which are counted in the same sense, from the sensor's -x axis.

    order: (r,) int32, the scan's returns line by line, each line from below upwards by its angle, eq. 1 unfolded; floor
        and ceiling included.
    starts: (2n + 1,) int32; order[starts[l]:starts[l + 1]] is line l.
    samples: (2n, 200) int32, each line without floor and ceiling, resampled to exactly 200 returns, from below
        upwards; -1 throughout a line with too few returns.
    """

    order: IntArray
    starts: IntArray
    samples: IntArray

    def __len__(self) -> int:
        return len(self.samples)


def make_point_lines(
    scan: Scan,
    down_sensor: FloatArray,
    is_horizontal: BoolArray,
    settings: RearrangementSettings,
    column_pairs: int = 0,
) -> PointLines:
    """The 2n point lines, each sorted by angle and resampled to 200 returns (paper, III.A, Fig. 4 and 5a).

    Eq. 1 gives the angle from a coordinate's ratio and so folds up onto down. Here it is the angle from straight down, of
    emitters about the spin axis, 0 to π, and its sign is the side. A column has all returns of a sector; it is resampled from
    those alone that are nearest to the sector's middle, one of each emitter: across a sector a slanting wall's range changes.

    down_sensor: (3,) gravity. is_horizontal: (r,) which returns of the scan are floor or ceiling, kept in `order` and left
    out of `samples`. column_pairs: n of an upright lidar; 0 for lines of emitters.
    Raises ValueError where lines of emitters are asked of an upright lidar, for then none stands upright.
    """
    left_out = is_horizontal
    if column_pairs:
        rings = scan.rings
        line, height, in_middle = _columns(
            scan.points_sensor, scan.ring, scan.ring_count, rings.turn_rad, rings.rank, down_sensor, column_pairs
        )
        left_out = is_horizontal | ~in_middle
        order, starts = sort_groups(line, height, 2 * column_pairs)
    else:
        across = float(np.hypot(down_sensor[0], down_sensor[1]))
        if across < np.sin(np.radians(_LEANING_MIN_DEG)):
            raise ValueError("the spin axis is upright: no emitter of this lidar sweeps a wall from floor to ceiling")
        rings, down_rad = scan.rings, float(np.arctan2(down_sensor[1], down_sensor[0]))
        order, starts = _halves(rings.order, rings.starts, rings.turn_rad, down_rad)
    samples = _resample(order, starts, is_horizontal, left_out, settings.line_points_min)
    return PointLines(order, starts, samples)


@numba.njit(cache=True, nogil=True)
def _columns(
    points: FloatArray,
    ring: IntArray,
    ring_count: int,
    turn_rad: FloatArray,
    rank: IntArray,
    down: FloatArray,
    pairs: int,
) -> tuple[IntArray, FloatArray, BoolArray]:  # pragma: no cover
    """(r,) the line of each return, how high its ray points, from -1 to 1, and whether it is its emitter's in the middle."""
    count, sectors = len(points), 2 * pairs
    line, height, in_middle = np.empty(count, np.int32), np.empty(count, np.float32), np.zeros(count, np.bool_)
    nearest, off = np.full(sectors * ring_count, -1, np.int32), np.full(sectors * ring_count, np.float32(1.0))
    for i in range(count):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        range_m = max(np.sqrt(x * x + y * y + z * z), 1e-6)
        height[i] = -(x * down[0] + y * down[1] + z * down[2]) / range_m
        place = (turn_rad[rank[i]] / (2.0 * np.pi) + 0.5) * sectors
        sector = min(max(int(place), 0), sectors - 1)
        line[i] = 2 * (sector % pairs) + sector // pairs
        cell = sector * ring_count + ring[i]
        from_middle = abs(place - sector - 0.5)
        if from_middle < off[cell]:
            nearest[cell], off[cell] = i, from_middle
    for chosen in nearest:
        if chosen >= 0:
            in_middle[chosen] = True
    return line, height, in_middle


@numba.njit(cache=True, nogil=True)
def _halves(
    ring_order: IntArray, ring_starts: IntArray, turn_rad: FloatArray, down_rad: float
) -> tuple[IntArray, IntArray]:  # pragma: no cover
    """order and starts of `PointLines`: each ring, which goes round once, is cut at straight down and straight up."""
    order, starts = np.empty_like(ring_order), np.zeros(2 * len(ring_starts) - 1, np.int32)
    up_rad = down_rad - np.pi if down_rad > 0.0 else down_rad + np.pi
    for ring in range(len(ring_starts) - 1):
        first, stop = ring_starts[ring], ring_starts[ring + 1]
        own, count = turn_rad[first:stop], stop - first
        down, up = np.searchsorted(own, down_rad, side="right"), np.searchsorted(own, up_rad, side="right")
        rising = up - down + (count if down_rad > 0.0 else 0)
        at = first + down
        for k in range(count):
            # From straight down once round: up on one side, and down again on the other, which is turned about.
            at = at if at < stop else first
            order[first + k if k < rising else stop - 1 - (k - rising)] = ring_order[at]
            at += 1
        starts[2 * ring + 1], starts[2 * ring + 2] = first + rising, stop
    return order, starts


@numba.njit(cache=True, nogil=True)
def _resample(
    order: IntArray, starts: IntArray, is_horizontal: BoolArray, left_out: BoolArray, points_min: int
) -> IntArray:  # pragma: no cover
    """(L, 200) of what is not left out of each line that has enough returns of other than floor and ceiling."""
    lines = len(starts) - 1
    samples = np.full((lines, SAMPLES), -1, np.int32)
    kept = np.empty(len(order), np.int32)
    for line in range(lines):
        count, enough = 0, 0
        for j in range(starts[line], starts[line + 1]):
            enough += not is_horizontal[order[j]]
            if not left_out[order[j]]:
                kept[count] = order[j]
                count += 1
        if enough < points_min or count == 0:
            continue
        for s in range(SAMPLES):
            samples[line, s] = kept[(s * (count - 1) * 2 + SAMPLES - 1) // (2 * (SAMPLES - 1))]
    return samples
