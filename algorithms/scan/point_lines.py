"""From a scan to its floor, its ceiling and its 2n point lines (paper, III.A, eq. 1)."""

from dataclasses import dataclass, field

import numba
import numpy as np
from pydantic import Field
from scipy.ndimage import binary_erosion

from ffmap.algorithms.base.rings import sort_by_angle, turns
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings

SAMPLES = 200
"""Returns in a resampled point line (paper, III.A: "exactly 200 points")."""
LEANING_MIN_DEG = 15.0
"""A lidar whose spin axis is less far off upright has no line that stands upright."""

_HEIGHT_BIN_M = 0.01
_CEILING_HEIGHT_MAX_M = 50.0
"""No ceiling is higher; a damaged return may be."""
_CEILING_POINTS = 8_000
_LEVEL_SLOPE = 0.01
"""A floor whose slope is less is level as far as ceilings go."""
_BREADTH_CELL_M = 0.2
_BREADTH_CELLS_MAX = 4_000_000
_BREADTH_INNER_MIN = 4

_FLOOR_CELL_M = 0.2
_FLOOR_RANGE_M = 6.0
_FLOOR_CELL_RETURNS = 3
_ON_FLOOR_M = 0.012
"""A cell of the floor lies so close to its plane."""
_BEND_CELLS_MIN = 40
_BEND_SHARE = 0.07
"""A floor bends where two planes hold so much larger a share of its cells than one does, and each of them as many."""
_BEND_HYPOTHESES = 128
_BEND_REFINEMENTS = 5


class RearrangementSettings(StepSettings):
    """Floor, ceiling and point lines (paper, III.A)."""

    floor_height_m: float = Field(
        0.045, gt=0, le=0.5, description="Half thickness in metres of the height filter that takes the floor. III.A."
    )
    floor_search_m: float = Field(
        0.25, gt=0, le=2.0, description="The floor is looked for this many metres above and below the map's. III.A."
    )
    floor_slope_max: float = Field(
        0.09, ge=0, le=0.5, description="Steepest floor in metres a metre; 0 keeps the map's level. III.A."
    )
    ceiling_distance_m: float = Field(
        0.03,
        gt=0,
        le=0.5,
        description="Returns at most this many metres below or above a ceiling plane are ceiling. III.A.",
    )
    ceiling_height_min_m: float = Field(
        2.1, gt=0, description="Lowest height in metres above the floor at which a ceiling is believed. III.A."
    )
    ceiling_support_min: float = Field(
        0.02, ge=0, le=1, description="Smallest share of the scan's returns that makes a ceiling. III.A."
    )
    ceiling_further_min: float = Field(
        0.004, ge=0, le=1, description="The same share for a further ceiling, seen through a door. III.A."
    )
    ceiling_iterations: int = Field(500, ge=1, le=100_000, description="RANSAC's hypotheses for each ceiling. III.A.")
    ceilings_max: int = Field(
        3, ge=1, le=10, description="Most ceilings in one scan; rooms seen through doors have their own. III.A."
    )
    line_points_min: int = Field(
        20, ge=2, description="Fewest returns, floor and ceiling left out, that make a point line. III.A."
    )


@dataclass(frozen=True)
class HorizontalPlane:
    """A floor or a ceiling: height(x, y) = height_m + slope · (x, y), in the level frame.

    height_m: at the level frame's origin.
    slope: (2,) metres up for each metre along x and y; zero unless the plane was refined.
    support: how many of the returns that it was fitted to lie on it; a share of the scan's, for a share places it.
    """

    height_m: float
    slope: FloatArray
    support: int

    def height_at(self, points_level: FloatArray) -> FloatArray:
        """Height (m,) of the plane at the x and y of points (m, 2 or more)."""
        return np.asarray(self.height_m + points_level[:, :2] @ self.slope)

    def heights_above(self, points_level: FloatArray) -> FloatArray:
        """Heights (n,) float32 of points (n, 3) above the plane, in metres."""
        return np.asarray(_heights(points_level, self.height_m, self.slope))

    @property
    def slopes(self) -> FloatArray:
        """(k, 2) every slope that it has."""
        return self.slope[None]


@dataclass(frozen=True)
class Floor(HorizontalPlane):
    """The floor of a scan: the one plane that fits it best and, where it bends, as a ramp's foot and top do, its two pieces.

    pieces: (2, 3) height at the level frame's origin, slope along x, slope along y of each piece, the larger one first; none
    (0, 3) where the floor is a plane.
    is_foot: whether the higher of the two pieces is the floor, as at a ramp's foot; at its top the lower one is.
    """

    pieces: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    is_foot: bool = False

    def height_at(self, points_level: FloatArray) -> FloatArray:
        """Height (m,) of the floor at the x and y of points (m, 2 or more)."""
        if not len(self.pieces):
            return super().height_at(points_level)
        heights = self.pieces[:, :1] + self.pieces[:, 1:] @ points_level[:, :2].T
        return np.asarray(heights.max(axis=0) if self.is_foot else heights.min(axis=0))

    def heights_above(self, points_level: FloatArray) -> FloatArray:
        """Heights (n,) float32 of points (n, 3) above the floor, in metres."""
        if not len(self.pieces):
            return super().heights_above(points_level)
        return np.asarray(_heights_above_pieces(points_level, self.pieces, self.is_foot))

    @property
    def slopes(self) -> FloatArray:
        """(k, 2) of the plane, or of each piece."""
        return self.pieces[:, 1:] if len(self.pieces) else super().slopes


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


def plane_rows(planes: tuple[HorizontalPlane, ...]) -> FloatArray:
    """(c, 3) height at the level frame's origin, slope along x, slope along y."""
    return np.array([[p.height_m, *p.slope] for p in planes]).reshape(-1, 3)


def below_ceiling(points_level: FloatArray, planes: FloatArray) -> FloatArray:
    """How far (n,) float32 points (n, 3) lie below the ceiling nearest in height, negative above; planes as `plane_rows`.

    Infinite where there is no ceiling.
    """
    return np.asarray(_below(points_level, np.ascontiguousarray(planes, np.float64)))


def find_floor(points_level: FloatArray, settings: RearrangementSettings) -> Floor:
    """The floor below the robot, near the map's (paper: "we can straightforward locate where the floor is").

    The height that holds most returns within `floor_search_m` of the map's floor, refined to a plane by least squares
    over its returns, so that drift, a sloping floor or a tilted mount do not cut it; to two planes where it bends. Falls
    back to the map's floor where too few returns are near it.
    """
    # A third of the returns place the plane as well, to a fraction of a millimetre.
    points_level = np.ascontiguousarray(points_level[::3])
    histogram = _low_histogram(points_level, settings.floor_search_m, _HEIGHT_BIN_M)
    width = max(1, round(settings.floor_height_m / _HEIGHT_BIN_M))
    counts = np.convolve(histogram, np.ones(width), mode="same")
    mode = int(np.argmax(counts))
    if counts[mode] < 20:
        return Floor(0.0, np.zeros(2), 0)
    height_m = -settings.floor_search_m + (mode + 0.5) * _HEIGHT_BIN_M
    plane = _refine(points_level, height_m, np.zeros(2), settings.floor_height_m, settings.floor_slope_max, 10.0)
    return Floor(plane.height_m, plane.slope, plane.support, *_bend(points_level, plane, settings))


def _bend(points_level: FloatArray, plane: HorizontalPlane, settings: RearrangementSettings) -> tuple[FloatArray, bool]:
    """The pieces of a floor that is rather two planes than one, and whether the higher of them is the floor; see `Floor`.

    By the consensus of small cells of the ground, each with the height at which most of its returns lie: returns crowd
    near the sensor, and least squares over all of them would lay one slanting plane through both pieces.
    """
    none = np.zeros((0, 3)), False
    cells = _floor_cells(points_level, plane.height_m, plane.slope, settings.floor_search_m)
    rise_m = cells[:, 2]
    on_plane = np.count_nonzero(np.abs(rise_m) < _ON_FLOOR_M)
    more = int(_BEND_SHARE * len(cells)) + 1
    if len(cells) < _BEND_CELLS_MIN or len(cells) - on_plane < more:
        return none
    A = np.column_stack([np.ones(len(cells)), cells[:, :2]])
    first = _consensus_plane(A, rise_m, plane.slope, settings.floor_slope_max)
    left = np.abs(A @ first - rise_m) > _ON_FLOOR_M
    if np.count_nonzero(left) < more:
        return none
    second = _consensus_plane(A[left], rise_m[left], plane.slope, settings.floor_slope_max)
    bends = [_joined(A, rise_m, np.stack([first, second]), is_foot) for is_foot in (True, False)]
    is_foot = bool(bends[0][1].sum() >= bends[1][1].sum())
    pieces, held = bends[0 if is_foot else 1]
    steepest = np.hypot(*(pieces[:, 1:] + plane.slope).T).max()
    if held.sum() < on_plane + more or held.min() < more or steepest > settings.floor_slope_max:
        return none
    return pieces + np.array([plane.height_m, *plane.slope]), is_foot


def _joined(A: FloatArray, rise_m: FloatArray, pieces: FloatArray, is_foot: bool) -> tuple[FloatArray, IntArray]:
    """Two planes (2, 3) fitted each to the cells on its own side of where they meet, and how many (2,) lie on each."""
    held: IntArray = np.zeros(2, np.int64)
    for _ in range(_BEND_REFINEMENTS):
        heights = A @ pieces.T
        own = heights.argmax(axis=1) if is_foot else heights.argmin(axis=1)
        near = np.abs(heights[np.arange(len(A)), own] - rise_m) < _ON_FLOOR_M
        held[:] = np.bincount(own[near], minlength=2)
        if held.min() < 3:
            break
        parts = (near & (own == 0), near & (own == 1))
        pieces = np.asarray([np.linalg.lstsq(A[part], rise_m[part], rcond=None)[0] for part in parts])
    return pieces, held


def _consensus_plane(A: FloatArray, rise_m: FloatArray, slope: FloatArray, slope_max: float) -> FloatArray:
    """Rise at the origin and slope (3,) of the plane that most cells lie on; of cells with rows 1, x, y (m, 3).

    slope: what the rise is counted from; both together are at most `slope_max`.
    """
    generator = np.random.default_rng(0)
    best: FloatArray = np.zeros(3)
    most = -1
    triples = generator.integers(0, len(A), (_BEND_HYPOTHESES, 3))
    corners = A[triples]
    spanned = np.abs(np.linalg.det(corners)) > _FLOOR_CELL_M
    hypotheses = np.linalg.solve(corners[spanned], rise_m[triples[spanned]][..., None])[..., 0]
    hypotheses = hypotheses[np.hypot(*(hypotheses[:, 1:] + slope).T) <= slope_max]
    if len(hypotheses):
        counts = np.count_nonzero(np.abs(hypotheses @ A.T - rise_m) < _ON_FLOOR_M, axis=1)
        best, most = hypotheses[np.argmax(counts)], int(counts.max())
    for _ in range(2):
        near = np.abs(A @ best - rise_m) < _ON_FLOOR_M
        if most < 3 or np.linalg.matrix_rank(A[near]) < 3:
            break
        best = np.linalg.lstsq(A[near], rise_m[near], rcond=None)[0]
    return np.asarray(best)


def find_ceilings(
    points_level: FloatArray, floor: HorizontalPlane, settings: RearrangementSettings, seed: int
) -> tuple[HorizontalPlane, ...]:
    """The ceilings by RANSAC: the biggest planes parallel to the floor or level, high above it and well supported.

    A plane parallel to a given one has one unknown, its height, so one return makes a hypothesis. The largest is the
    ceiling. A further one is taken only where it can be no duct or lamp: above the largest, or as broad as a room.

    points_level: (n, 3); seed: of the hypotheses.
    """
    height_m = floor.heights_above(points_level)
    high = np.flatnonzero((height_m > settings.ceiling_height_min_m) & (height_m < _CEILING_HEIGHT_MAX_M))
    # A plane needs no more returns than these to be found and placed to a millimetre.
    stride = max(1, len(high) // _CEILING_POINTS)
    high = high[::stride]
    points = points_level[high]
    # Heights above planes parallel to the floor, and above level ones where the floor is a ramp.
    slopes = [*floor.slopes]
    if all(np.hypot(*slope) >= _LEVEL_SLOPE for slope in slopes):
        slopes.append(np.zeros(2))
    parallel = [points[:, 2] - floor.height_m - points[:, :2] @ slope for slope in slopes]
    generator = np.random.default_rng(seed)
    ceilings: list[HorizontalPlane] = []
    for _ in range(settings.ceilings_max + 1):
        share = settings.ceiling_further_min if ceilings else settings.ceiling_support_min
        support_min = max(30, int(share * len(points_level) / stride))
        if len(points) < support_min or len(ceilings) == settings.ceilings_max:
            break
        found = [_ransac_height(heights, settings, generator) for heights in parallel]
        best = int(np.argmax([support for _, support in found]))
        heights, (centre_m, support) = parallel[best], found[best]
        if support < support_min:
            break
        on_plane = np.abs(heights - centre_m) < settings.ceiling_distance_m
        if not ceilings or _is_further_ceiling(points[on_plane], floor.height_m + centre_m, ceilings[0], support):
            ceilings.append(
                _refine(points, floor.height_m + centre_m, slopes[best], settings.ceiling_distance_m, 0.03, 20.0)
            )
        # What touches a plane that was tried is not tried again.
        rest = np.abs(heights - centre_m) > 1.5 * settings.ceiling_distance_m
        parallel, points = [heights[rest] for heights in parallel], points[rest]
    return tuple(ceilings)


def _ransac_height(
    heights_m: FloatArray, settings: RearrangementSettings, generator: np.random.Generator
) -> tuple[float, int]:
    """The best of the hypotheses, as the mean height of its returns, and how many they are."""
    lowest = float(heights_m.min())
    histogram = np.bincount(((heights_m - lowest) / _HEIGHT_BIN_M).astype(np.int64))
    cumulative = np.concatenate([[0], np.cumsum(histogram)])
    hypotheses = heights_m[generator.integers(0, len(heights_m), settings.ceiling_iterations)]
    bins = ((hypotheses - lowest) / _HEIGHT_BIN_M).astype(np.int64)
    reach = max(1, round(settings.ceiling_distance_m / _HEIGHT_BIN_M))
    supports = cumulative[np.minimum(bins + reach + 1, len(histogram))] - cumulative[np.maximum(bins - reach, 0)]
    best_m = float(hypotheses[np.argmax(supports)])
    inliers = heights_m[np.abs(heights_m - best_m) < settings.ceiling_distance_m]
    return float(inliers.mean()), len(inliers)


def _is_further_ceiling(points: FloatArray, height_m: float, largest: HorizontalPlane, support: int) -> bool:
    if height_m > largest.height_m:
        return True
    return support > 0.2 * largest.support and _is_broad(points)


def _is_broad(points: FloatArray) -> bool:
    """Whether most of the ground that returns of one height cover is a metre wide: a duct's underside is not.

    The walls that reach that height are but lines on this ground.
    """
    cell = np.floor(points[:, :2] / _BREADTH_CELL_M).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    covered = np.zeros(cell.max(axis=0) + 2, bool)
    if covered.size > _BREADTH_CELLS_MAX:
        return False
    covered[cell[:, 0], cell[:, 1]] = True
    # A duct of 40 cm, and the wall beside it, cover up to four cells across.
    inner = binary_erosion(covered, np.ones((5, 5), bool))
    return bool(inner.sum() >= _BREADTH_INNER_MIN)


def _refine(
    points: FloatArray, height_m: float, slope: FloatArray, distance_m: float, turn_max: float, range_m: float
) -> HorizontalPlane:
    """Least squares on the returns near a plane, repeated, with its turn from the first slope held to a bound."""
    first = slope
    support = 0
    for _ in range(3):
        moments = _plane_moments(points, height_m, slope, distance_m, range_m)
        support = int(moments[0])
        if support < 20:
            break
        A = np.array(
            [
                [moments[0], moments[1], moments[2]],
                [moments[1], moments[3], moments[4]],
                [moments[2], moments[4], moments[5]],
            ]
        )
        # The prior of a level plane holds what the returns leave open, such as a narrow strip's tilt.
        A[1, 1] += 0.02 * moments[0]
        A[2, 2] += 0.02 * moments[0]
        b = np.array([moments[6], moments[7], moments[8]])
        correction = np.linalg.solve(A, b)
        height_m += float(correction[0])
        slope = slope + correction[1:]
        turn = float(np.hypot(*(slope - first)))
        if turn > turn_max:
            slope = first + (slope - first) * (turn_max / turn)
    return HorizontalPlane(height_m, slope, support)


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
    order, starts = sort_by_angle(line, angle_rad, 2 * ring_count, 0.0)
    samples = _resample(order, starts, is_horizontal, settings.line_points_min)
    return PointLines(order, starts, samples)


@numba.njit(cache=True, nogil=True)
def _low_histogram(points: FloatArray, search_m: float, bin_m: float) -> IntArray:  # pragma: no cover
    histogram = np.zeros(int(np.ceil(2 * search_m / bin_m)), np.int64)
    for i in range(len(points)):
        z = points[i, 2]
        if abs(z) < search_m and points[i, 0] ** 2 + points[i, 1] ** 2 < 36.0:
            histogram[min(int((z + search_m) / bin_m), len(histogram) - 1)] += 1
    return histogram


@numba.njit(cache=True, nogil=True)
def _floor_cells(
    points: FloatArray, height_m: float, slope: FloatArray, search_m: float
) -> FloatArray:  # pragma: no cover
    """(m, 3) x, y and rise above a plane, where most of its returns lie, of each cell of the ground that has enough."""
    cells, bins = int(2 * _FLOOR_RANGE_M / _FLOOR_CELL_M), int(2 * search_m / _HEIGHT_BIN_M)
    counts = np.zeros((cells * cells, bins), np.int32)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        rise = points[i, 2] - (height_m + slope[0] * x + slope[1] * y)
        if abs(x) < _FLOOR_RANGE_M and abs(y) < _FLOOR_RANGE_M and abs(rise) < search_m:
            column, row = int((x + _FLOOR_RANGE_M) / _FLOOR_CELL_M), int((y + _FLOOR_RANGE_M) / _FLOOR_CELL_M)
            counts[column * cells + row, min(int((rise + search_m) / _HEIGHT_BIN_M), bins - 1)] += 1
    found = np.empty((cells * cells, 3))
    m = 0
    for cell in range(cells * cells):
        best, most = 1, 0
        for b in range(1, bins - 1):
            near = counts[cell, b - 1] + counts[cell, b] + counts[cell, b + 1]
            if near > most:
                best, most = b, near
        if most >= _FLOOR_CELL_RETURNS:
            total, weighted = 0, 0
            for b in range(max(best - 3, 0), min(best + 4, bins)):
                total += counts[cell, b]
                weighted += counts[cell, b] * b
            found[m, 0] = (cell // cells + 0.5) * _FLOOR_CELL_M - _FLOOR_RANGE_M
            found[m, 1] = (cell % cells + 0.5) * _FLOOR_CELL_M - _FLOOR_RANGE_M
            found[m, 2] = (weighted / total + 0.5) * _HEIGHT_BIN_M - search_m
            m += 1
    return found[:m]


@numba.njit(cache=True, nogil=True)
def _plane_moments(
    points: FloatArray, height_m: float, slope: FloatArray, distance_m: float, range_m: float
) -> FloatArray:  # pragma: no cover
    """Σ of 1, x, y, xx, xy, yy, r, xr, yr over the returns near the plane, r their residual height."""
    total = np.zeros(9)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        r = points[i, 2] - (height_m + slope[0] * x + slope[1] * y)
        if abs(r) < distance_m and x * x + y * y < range_m * range_m:
            total[0] += 1.0
            total[1] += x
            total[2] += y
            total[3] += x * x
            total[4] += x * y
            total[5] += y * y
            total[6] += r
            total[7] += x * r
            total[8] += y * r
    return total


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


@numba.njit(cache=True, nogil=True)
def _heights(points: FloatArray, height_m: float, slope: FloatArray) -> FloatArray:  # pragma: no cover
    heights = np.empty(len(points), np.float32)
    for i in range(len(points)):
        heights[i] = points[i, 2] - (height_m + slope[0] * points[i, 0] + slope[1] * points[i, 1])
    return heights


@numba.njit(cache=True, nogil=True)
def _heights_above_pieces(points: FloatArray, pieces: FloatArray, highest: bool) -> FloatArray:  # pragma: no cover
    heights = np.empty(len(points), np.float32)
    for i in range(len(points)):
        first = pieces[0, 0] + pieces[0, 1] * points[i, 0] + pieces[0, 2] * points[i, 1]
        second = pieces[1, 0] + pieces[1, 1] * points[i, 0] + pieces[1, 2] * points[i, 1]
        heights[i] = points[i, 2] - (max(first, second) if highest else min(first, second))
    return heights


@numba.njit(cache=True, nogil=True)
def _below(points: FloatArray, planes: FloatArray) -> FloatArray:  # pragma: no cover
    below = np.full(len(points), np.inf, np.float32)
    for i in range(len(points)):
        for c in range(len(planes)):
            b = planes[c, 0] + planes[c, 1] * points[i, 0] + planes[c, 2] * points[i, 1] - points[i, 2]
            if abs(b) < abs(below[i]):
                below[i] = b
    return below
