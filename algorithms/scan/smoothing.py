"""Ranges smoothed along the rings: a return takes its place on the small facet that its neighbours show.

Single returns are off by some centimetres, as much as a door's recess is deep; a dozen of them, one after the other on
one surface, show it to some millimetres. Edges stay, by the facet model (Haralick and Watson, "A facet model for image
data", 1981): where the neighbours on both sides are no line, of all the runs of neighbours that hold a return the one that
fits best places it, and a shorter one where none fits. Directions are left as measured.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan
from ffmap.algorithms.base.settings import StepSettings

_RETURNS_MIN = 5  # minimum number of returns of a facet: fewer show no surface
_STEP_MAX_RAD = 0.04  # maximum angle between neighbouring returns of a ring
_CONTRACT = {"contract", "arcp"}  # a product and a sum may be one instruction, a quotient the product with an inverse
_FACET_MAX_M = 0.2
"""Maximum width (m) of a facet of more than 5 returns, across its rays."""
_RESIDUAL_MAX_SCATTERS = 1.4
"""Maximum RMS distance of returns from their facet, in multiples of the scan's scatter."""
_CORRECTION_MAX_SCATTERS = 3.5
"""Maximum distance by which a return is moved, in multiples of the scan's scatter; one farther off
stays."""


class SmoothingSettings(StepSettings):
    """Ranges smoothed by their neighbours on the same ring, before anything is decided."""

    returns: int = Field(
        11,
        ge=0,
        le=101,
        description="Maximum number of successive returns of a ring in a facet; below 5, nothing is smoothed.",
    )


@dataclass(frozen=True)
class SmoothedRanges:
    """The returns of a scan on the facets that they are part of.

    points_sensor: (n, 3) float32, metres, each on the ray that it was measured on.
    correction_m: (n,) float32, how much farther than measured that is; 0 for what lies on no facet.
    scatter_m: standard deviation of the measured ranges about smooth surfaces; NaN where none was smoothed.
    """

    points_sensor: FloatArray
    correction_m: FloatArray
    scatter_m: float

    def of(self, scan: Scan) -> Scan:
        """The scan that they were smoothed of, with its returns on the facets."""
        return replace(scan, points_sensor=self.points_sensor)

    @property
    def smoothed_share(self) -> float:
        """The share of the returns that lie on facets."""
        return float(np.count_nonzero(self.correction_m) / max(len(self.correction_m), 1))


def smooth_ranges(scan: Scan, settings: SmoothingSettings) -> SmoothedRanges:
    """Every return on the facet of its ring that fits it best; where none does, as it was measured."""
    points = scan.points_sensor
    if settings.returns < _RETURNS_MIN or len(points) < _RETURNS_MIN:
        return SmoothedRanges(points, np.zeros(len(points), np.float32), np.nan)
    starts, turn, rank = scan.rings.starts, scan.rings.turn_rad, scan.rings.rank
    range_m = _along_rings(points, rank)
    # Sensors count in steps of millimetres; what scatters by more than some centimetres is no surface.
    scatter_m = min(max(_scatter(range_m, turn, starts), 0.002), 0.06)
    residual_max_m = _RESIDUAL_MAX_SCATTERS * scatter_m
    correction_max_m = _CORRECTION_MAX_SCATTERS * scatter_m
    smooth_m = _smooth(
        range_m,
        turn,
        starts,
        settings.returns,
        _FACET_MAX_M,
        scatter_m,
        residual_max_m,
        correction_max_m,
    )
    return SmoothedRanges(*_moved(points, rank, range_m, smooth_m), scatter_m)


# Compiled, as are all steps over single returns. Both go along the firings, of which each next one is the next of its ring: to
# go along the rings, whose returns lie far apart in a scan, takes `_moved` twice as long.
@numba.njit(cache=True, nogil=True)
def _along_rings(points: FloatArray, rank: IntArray) -> FloatArray:  # pragma: no cover
    """Range (n,) float64 of the returns in the order of their rings."""
    range_m = np.empty(len(rank))
    for i, j in enumerate(rank):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        # A return at the sensor itself has no direction and stays there.
        range_m[j] = max(np.sqrt(x * x + y * y + z * z), 1e-3)
    return range_m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _moved(
    points: FloatArray, rank: IntArray, range_m: FloatArray, smooth_m: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    """The returns (n, 3) at their smoothed ranges, and by how much (n,) they moved."""
    moved, correction_m = np.empty_like(points), np.empty(len(points), np.float32)
    for i, j in enumerate(rank):
        share = np.float32(smooth_m[j] / range_m[j])
        for axis in range(3):
            moved[i, axis] = points[i, axis] * share
        correction_m[i] = smooth_m[j] - range_m[j]
    return moved, correction_m


@numba.njit(cache=True, nogil=True)
def _scatter(range_m: FloatArray, turn: FloatArray, starts: IntArray) -> float:  # pragma: no cover
    """From second differences of neighbours, most of which lie on smooth surfaces; their median knows no edges.

    Of what a ray returned the first counts. The median is that of bins of a hundredth of a millimetre, up to 0.4 m.
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
    # The median of a normal distribution's absolute value is 0.6745 σ; a second difference has variance 6 σ².
    half = 0.5 * counts.sum()
    if not half:
        return 0.0
    below, middle = 0, 0
    while below + counts[middle] < half:
        below += counts[middle]
        middle += 1
    return float((middle + (half - below) / counts[middle]) * bin_m / (0.6745 * np.sqrt(6.0)))


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=_CONTRACT)
def _smooth(
    range_m: FloatArray,
    turn: FloatArray,
    starts: IntArray,
    returns: int,
    facet_max_m: float,
    scatter_m: float,
    residual_max_m: float,
    correction_max_m: float,
) -> FloatArray:  # pragma: no cover
    """Ranges on the facets; all arrays in the order of the rings.

    What an emitter meets of a plane has inverse ranges that are a line over a small turn: so the facets are fitted.
    """
    smooth_m = range_m.copy()
    inverse = 1.0 / range_m
    # Of one surface at a time, small enough for the processor's nearest cache.
    longest = np.max(starts[1:] - starts[:-1])
    level, slope, residual = np.empty(longest), np.empty(longest), np.empty(longest)
    left = np.empty(longest, np.int64)
    residual_max = residual_max_m * residual_max_m
    for r in range(len(starts) - 1):
        first = starts[r]
        while first < starts[r + 1]:
            stop = first + 1
            # Neighbours on one surface differ in range by some scatters, and more where rays graze it.
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
                _fit_facets(range_m, inverse, turn, begin, end, n, facet_max_m, first, level, slope, residual)
                still = 0
                for k in range(lefts):
                    j = left[k]
                    low, high = max(first, j - n + 1) - first, min(j, stop - n) - first
                    best = min(max(j - n // 2 - first, low), high)
                    # Beside an edge one that ends there.
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
    facet_max_m: float,
    origin: int,
    level: FloatArray,
    slope: FloatArray,
    residual: FloatArray,
) -> None:  # pragma: no cover
    """A facet of n returns for each place in [first, stop) at which one can begin, by sums that slide along.

    level, slope, residual: of the inverse range, and the mean square distance (m²), counted from the place `origin` on.
    Rounding of these sums stays below a tenth of a millimetre within 30 m, and a millimetre within 100 m.
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
        residual[s - origin] = np.inf
        # Returns of one angle, but for rounding, show no slope.
        if spread > 1e-12 * n * t2 and (n <= _RETURNS_MIN or (turn[j] - turn[s]) * middle_m < facet_max_m):
            b = (n * tq - t1 * q1) / spread
            a = (q1 - b * t1) * share
            level[s - origin], slope[s - origin] = q0 + a - b * t0, b
            square = middle_m * middle_m
            residual[s - origin] = max(q2 - a * q1 - b * tq, 0.0) * share_of_free * square * square
        t, q = turn[s] - t0, inverse[s] - q0
        t1, t2, q1, q2, tq = t1 - t, t2 - t * t, q1 - q, q2 - q * q, tq - t * q
