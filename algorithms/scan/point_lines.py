"""The 2n point lines of a scan: the returns of each emitter on each side, sorted by angle and resampled (paper, III.A, eq. 1)."""

from dataclasses import dataclass

import numba
import numpy as np

from ffmap.algorithms.base.rings import sort_by_angle, turns
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.scan.rearrangement import RearrangementSettings

SAMPLES = 200
"""Returns in a resampled point line (paper, III.A: "exactly 200 points")."""
LEANING_MIN_DEG = 15.0  # a lidar whose spin axis is less far off upright has no line that stands upright


@dataclass(frozen=True)
class PointLines:
    """The point lines of a scan: n emitters × 2 sides.

    Line 2 × ring + side; side 0 is the half turn counter-clockwise about the spin axis from straight down.

    order: (n,) int32, the scan's returns line by line, each line from below upwards by its angle, eq. 1 unfolded; floor
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
    points_sensor: FloatArray,
    ring: IntArray,
    ring_count: int,
    down_sensor: FloatArray,
    is_horizontal: BoolArray,
    settings: RearrangementSettings,
) -> PointLines:
    """The 2n point lines, each sorted by angle and resampled to 200 returns (paper, III.A, Fig. 4 and 5a).

    Eq. 1 gives the angle from a coordinate's ratio and so folds up onto down; here it is the angle about the spin axis
    from straight down, 0 to π, and its sign is the side.

    points_sensor: (n, 3), z along the spin axis. ring: (n,). down_sensor: (3,) gravity. is_horizontal: (n,) floor or
    ceiling, kept in `order` and left out of `samples`.
    Raises ValueError where the spin axis is upright, for then no line stands upright.
    """
    across = float(np.hypot(down_sensor[0], down_sensor[1]))
    if across < np.sin(np.radians(LEANING_MIN_DEG)):
        raise ValueError("the spin axis is upright: this lidar sweeps no wall from floor to ceiling")
    down_rad = float(np.arctan2(down_sensor[1], down_sensor[0]))
    line, angle_rad = _lines(points_sensor, ring, down_rad)
    order, starts = sort_by_angle(line, angle_rad, 2 * ring_count)
    samples = _resample(order, starts, is_horizontal, settings.line_points_min)
    return PointLines(order, starts, samples)


@numba.njit(cache=True, nogil=True)
def _lines(points: FloatArray, ring: IntArray, down_rad: float) -> tuple[IntArray, FloatArray]:  # pragma: no cover
    """(n,) the point line of each return, and its angle from straight down."""
    turn = turns(points, down_rad)
    line = np.empty(len(points), np.int32)
    for i in range(len(points)):
        line[i] = 2 * np.int64(ring[i]) + (0 if turn[i] > 0 else 1)
    return line, np.abs(turn)


@numba.njit(cache=True, nogil=True)
def _resample(
    order: IntArray, starts: IntArray, is_horizontal: BoolArray, points_min: int
) -> IntArray:  # pragma: no cover
    lines = len(starts) - 1
    samples = np.full((lines, SAMPLES), -1, np.int32)
    kept = np.empty(len(order), np.int32)
    for line in range(lines):
        count = 0
        for j in range(starts[line], starts[line + 1]):
            if not is_horizontal[order[j]]:
                kept[count] = order[j]
                count += 1
        if count < points_min:
            continue
        for s in range(SAMPLES):
            samples[line, s] = kept[(s * (count - 1) * 2 + SAMPLES - 1) // (2 * (SAMPLES - 1))]
    return samples
