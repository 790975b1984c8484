"""Ranges smoothed along the rings: each return moves onto the small facet that its neighbours show.

Single returns are off by some centimetres, as much as a door is recessed; a dozen successive
returns on one surface place it to some millimetres. Edges are kept by the facet model (Haralick and
Watson, "A facet model for image data", 1981): where the neighbours on both sides are not a line,
the best fitting of all runs of neighbours that hold a return places it, and a shorter run where
none fits. Directions are kept as measured.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan
from ffmap.algorithms.base.settings import StepSettings

_RETURNS_MIN = 5  # minimum number of returns of a facet: fewer show no surface
_STEP_MAX_RAD = 0.04  # maximum angle between neighbouring returns of a ring
_FACET_MAX_M = 0.2  # maximum width (m), across its rays, of a facet of more than 5 returns
_SCATTER_MIN_M, _SCATTER_MAX_M = 0.002, 0.06
"""Sensors measure in steps of millimetres; what scatters by more than centimetres is no surface."""
_RESIDUAL_MAX_SCATTERS = 1.4  # maximum RMS distance of returns from their facet, in scatters
_CORRECTION_MAX_SCATTERS = 3.5  # a return farther from its facet, in scatters, is not moved
_CONTRACT = {"contract", "arcp"}  # fused multiply-add; a quotient as a product with an inverse


class SmoothingSettings(StepSettings):
    """Ranges smoothed by their neighbours on the same ring, before anything is decided."""

    returns: int = Field(
        11,
        ge=0,
        le=101,
        description="Maximum number of successive returns of a ring in a facet; below 5, nothing "
        "is smoothed.",
    )


@dataclass(frozen=True)
class SmoothedRanges:
    """The returns of a scan on the facets that they are part of.

    points_sensor: (n, 3) float32, metres, each on the ray that it was measured on.
    correction_m: (n,) float32, added to the measured range; 0 for returns on no facet.
    scatter_m: standard deviation of the measured ranges about smooth surfaces; NaN where nothing
        was smoothed.
    """

    points_sensor: FloatArray
    correction_m: FloatArray
    scatter_m: float

    def of(self, scan: Scan) -> Scan:
        """The scan that was smoothed, with its returns on the facets."""
        return replace(scan, points_sensor=self.points_sensor)

    @property
    def smoothed_share(self) -> float:
        """The share of the returns that are on facets."""
        return float(np.count_nonzero(self.correction_m) / max(len(self.correction_m), 1))


def smooth_ranges(scan: Scan, settings: SmoothingSettings) -> SmoothedRanges:
    """Move every return onto the facet of its ring that fits it best, where one fits."""
    points, rings = scan.points_sensor, scan.rings
    if settings.returns < _RETURNS_MIN or len(points) < _RETURNS_MIN:
        return SmoothedRanges(points, np.zeros(len(points), np.float32), np.nan)
    range_m = _along_rings(points, rings.rank)
    scatter_m = _scatter(range_m, rings.turn_rad, rings.starts)
    scatter_m = min(max(scatter_m, _SCATTER_MIN_M), _SCATTER_MAX_M)
    smooth_m = _smooth(range_m, rings.turn_rad, rings.starts, settings.returns, scatter_m)
    return SmoothedRanges(*_moved(points, rings.rank, range_m, smooth_m), scatter_m)


# Both loops over single returns follow the firings, in the order of memory. Along the rings they
# would take twice as long.
@numba.njit(cache=True, nogil=True)
def _along_rings(points: FloatArray, rank: IntArray) -> FloatArray:
    """Range (n,) float64 of the returns in the order of their rings."""
    range_m = np.empty(len(rank))
    for i, j in enumerate(rank):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        # A return at the sensor itself has no direction and is kept there.
        range_m[j] = max(np.sqrt(x * x + y * y + z * z), 1e-3)
    return range_m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moved(
    points: FloatArray, rank: IntArray, range_m: FloatArray, smooth_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The returns (n, 3) at their smoothed ranges, and how far (n,) they were moved."""
    moved, correction_m = np.empty_like(points), np.empty(len(points), np.float32)
    for i, j in enumerate(rank):
        share = np.float32(smooth_m[j] / range_m[j])
        for axis in range(3):
            moved[i, axis] = points[i, axis] * share
        correction_m[i] = smooth_m[j] - range_m[j]
    return moved, correction_m


@numba.njit(cache=True, nogil=True)
def _scatter(range_m: FloatArray, turn: FloatArray, starts: IntArray) -> float:
    """Scatter from second differences of neighbours, whose median edges do not affect.

    Of several returns of one ray the first counts. The median is that of bins of a hundredth of a
    millimetre, up to 0.4 m.
    """
    bin_m, counts = 1e-5, np.zeros(40_000, np.int32)
    for r in range(len(starts) - 1):
        before, at = -1, -1
        for after in range(starts[r], starts[r + 1]):
            if at >= 0 and turn[after] == turn[at]:
                continue
            if before >= 0 and max(turn[at] - turn[before], turn[after] - turn[at]) < _STEP_MAX_RAD:
                second_m = abs(range_m[before] - 2.0 * range_m[at] + range_m[after])
                counts[int(min(second_m / bin_m, len(counts) - 1.0))] += 1
            before, at = at, after
    half = 0.5 * counts.sum()
    if not half:
        return 0.0
    below, middle = 0, 0
    while below + counts[middle] < half:
        below += counts[middle]
        middle += 1
    median_m = (middle + (half - below) / counts[middle]) * bin_m
    # The median of a normal distribution's absolute value is 0.6745 σ; a second difference has
    # variance 6 σ².
    return float(median_m / (0.6745 * np.sqrt(6.0)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_CONTRACT)
def _smooth(
    range_m: FloatArray, turn: FloatArray, starts: IntArray, returns: int, scatter_m: float
) -> FloatArray:
    """Ranges on the facets; all arrays in the order of the rings.

    Facets are fitted to inverse ranges: those of a plane are a line over a small turn.
    """
    smooth_m = range_m.copy()
    inverse = 1.0 / range_m
    residual_max = (_RESIDUAL_MAX_SCATTERS * scatter_m) * (_RESIDUAL_MAX_SCATTERS * scatter_m)
    correction_max_m = _CORRECTION_MAX_SCATTERS * scatter_m
    # Of one surface at a time, small enough for the processor's nearest cache.
    longest = np.max(starts[1:] - starts[:-1])
    level, slope, residual = np.empty(longest), np.empty(longest), np.empty(longest)
    left = np.empty(longest, np.int64)
    for r in range(len(starts) - 1):
        first = starts[r]
        while first < starts[r + 1]:
            stop = first + 1
            # Neighbours on one surface differ in range by some scatters, more at grazing rays.
            while (
                stop < starts[r + 1]
                and turn[stop] - turn[stop - 1] < _STEP_MAX_RAD
                and abs(range_m[stop] - range_m[stop - 1]) < 6.0 * scatter_m + 0.03 * range_m[stop]
            ):
                stop += 1
            lefts = stop - first
            for k in range(lefts):
                left[k] = first + k
            # A shorter facet may fit where a longer one does not.
            n = min(returns, stop - first)
            while n >= _RETURNS_MIN and lefts > 0:
                begin, end = max(first, left[0] - n + 1), min(stop, left[lefts - 1] + n)
                _fit_facets(range_m, inverse, turn, begin, end, n, first, level, slope, residual)
                still = 0
                for k in range(lefts):
                    j = left[k]
                    low, high = max(first, j - n + 1) - first, min(j, stop - n) - first
                    best = min(max(j - n // 2 - first, low), high)
                    # Beside an edge, a facet that ends there.
                    if residual[best] > residual_max:
                        for s in range(low, high + 1):
                            if residual[s] < residual[best]:
                                best = s
                    on_facet = level[best] + slope[best] * turn[j]
                    if (
                        residual[best] < residual_max
                        and on_facet > 0.0
                        and abs(1.0 / on_facet - range_m[j]) < correction_max_m
                    ):
                        smooth_m[j] = 1.0 / on_facet
                    else:
                        left[still] = j
                        still += 1
                lefts = still
                if n == _RETURNS_MIN:
                    break
                n = max(n - 2, _RETURNS_MIN)
            first = stop
    return smooth_m


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_CONTRACT)
def _fit_facets(
    range_m: FloatArray,
    inverse: FloatArray,
    turn: FloatArray,
    first: int,
    stop: int,
    n: int,
    origin: int,
    level: FloatArray,
    slope: FloatArray,
    residual: FloatArray,
) -> None:
    """Fit a facet of n returns at each place in [first, stop), by sums that slide along.

    level, slope, residual: of the inverse range, and the mean square distance (m²); filled from the
    place `origin` on. Rounding stays below 0.1 mm within 30 m, and 1 mm within 100 m.
    """
    t0, q0 = turn[first], inverse[first]
    t1 = t2 = q1 = q2 = tq = 0.0
    share, share_of_free = 1.0 / n, 1.0 / (n - 2)
    for j in range(first, stop):
        t, q = turn[j] - t0, inverse[j] - q0
        t1, t2, q1, q2, tq = t1 + t, t2 + t * t, q1 + q, q2 + q * q, tq + t * q
        s = j - n + 1
        if s < first:
            continue
        middle_m = range_m[s + n // 2]
        spread = n * t2 - t1 * t1
        narrow = n <= _RETURNS_MIN or (turn[j] - turn[s]) * middle_m < _FACET_MAX_M
        residual[s - origin] = np.inf
        # Returns of one angle, but for rounding, show no slope.
        if spread > 1e-12 * n * t2 and narrow:
            b = (n * tq - t1 * q1) / spread
            a = (q1 - b * t1) * share
            level[s - origin], slope[s - origin] = q0 + a - b * t0, b
            square = middle_m * middle_m
            mean_square = max(q2 - a * q1 - b * tq, 0.0) * share_of_free
            residual[s - origin] = mean_square * square * square
        t, q = turn[s] - t0, inverse[s] - q0
        t1, t2, q1, q2, tq = t1 - t, t2 - t * t, q1 - q, q2 - q * q, tq - t * q
