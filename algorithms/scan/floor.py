"""The floor of a scan: a plane near the map's floor or, at a ramp's foot or top, the two planes that meet there (paper, III.A)."""

from dataclasses import dataclass, field, replace

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.scan.rearrangement import HEIGHT_BIN_M, HorizontalPlane, RearrangementSettings, refine_plane

_SUPPORT_MIN = 20
"""Minimum number of returns on a floor."""
_CELL_M = 0.2
"""Edge in metres of the cells of ground whose heights tell whether a floor bends."""
FLOOR_RANGE_M = 6.0
"""Maximum distance in metres from the robot of the ground that tells it."""
_BEND_DISTANCE_M = 0.012
"""Maximum distance in metres of a cell's height from the plane that it lies on."""
_BEND_SHARE_MIN = 0.07
"""A floor bends where two planes hold a share of the cells that is larger by at least this than one
plane's, and each of them holds at least this share."""


@dataclass(frozen=True)
class Floor(HorizontalPlane):
    """The floor of a scan: the one plane that fits it best and, where it bends, as a ramp's foot and top do, its two pieces.

    pieces: (2, 3) height at the level frame's origin, slope along x, slope along y of each piece, the larger one first; none
    (0, 3) where the floor is a plane.
    is_foot: whether the higher of the two pieces is the floor, as at a ramp's foot; at its top the lower one is.
    rejected_m: height above the floor of a surface that holds more ground, as outside a window, and is not below the robot;
        0 where there is none.
    """

    pieces: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    is_foot: bool = False
    rejected_m: float = 0.0

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
        return np.asarray(heights_above_pieces(points_level, self.pieces, self.is_foot))

    @property
    def both_pieces(self) -> FloatArray:
        """(2, 3) the pieces, for `floor_height`; twice the same where the floor is a plane."""
        return self.pieces if len(self.pieces) else np.array([(self.height_m, *self.slope)] * 2)

    @property
    def slopes(self) -> FloatArray:
        """(k, 2) of the plane, or of each piece."""
        return self.pieces[:, 1:] if len(self.pieces) else super().slopes


def find_floor(points_level: FloatArray, settings: RearrangementSettings, map_floor_m: float = 0.0) -> Floor:
    """The floor below the robot, near where it is expected (paper: "we can straightforward locate where the floor is").

    The height that holds most ground within `floor_search_m` of where it is expected, refined to a plane by least squares
    over its returns, so that drift, a sloping floor or a tilted mount do not cut it; to two planes where it bends. Falls
    back to the level frame's floor where too few returns are near.

    It is expected as far below the base as at the first pose, which on ramps holds for what drives, and where the map's floor
    is, which holds for what is carried or flies; what holds more ground is the floor. map_floor_m: height of the latter in
    the level frame. Ground that is at neither height below the base, as outside a window, is the floor only if it also holds
    more returns than the ground expected there: a robot sees its own floor from nearest.
    """
    # A third of the returns place the plane as well, to a fraction of a millimetre.
    points_level = np.ascontiguousarray(points_level[::3])
    height_m, support, ground = _fullest(points_level, 0.0, settings)
    if abs(map_floor_m) > settings.floor_search_m:
        height_m, support, _ = max(
            (height_m, support, ground), _fullest(points_level, map_floor_m, settings), key=lambda found: found[2]
        )
    if support < _SUPPORT_MIN:
        return Floor(0.0, np.zeros(2), 0)
    floor = _fit(points_level, height_m, settings)
    off_m = [_below_base(floor) - expected_m for expected_m in (0.0, map_floor_m)]
    # Ramps, steps and platforms are no reason: below the base, a floor is where it is expected to 2 cm.
    if min(map(abs, off_m)) > settings.floor_height_m:
        fits = [_fit(points_level, expected_m, settings) for expected_m in dict.fromkeys((0.0, map_floor_m))]
        expected = max(fits, key=lambda fit: fit.support)
        if expected.support > floor.support:
            return replace(expected, rejected_m=_below_base(floor) - _below_base(expected))
    return floor


def _fit(points_level: FloatArray, height_m: float, settings: RearrangementSettings) -> Floor:
    """The floor near a height."""
    plane = refine_plane(points_level, height_m, np.zeros(2), settings.floor_height_m, settings.floor_slope_max, 10.0)
    return Floor(plane.height_m, plane.slope, plane.support, *_bend(points_level, plane, settings))


def _below_base(floor: Floor) -> float:
    return float(floor.height_at(np.zeros((1, 2)))[0])


def _fullest(points_level: FloatArray, expected_m: float, settings: RearrangementSettings) -> tuple[float, int, float]:
    """The height near an expected one that holds most ground, how many returns it holds, and how much ground, in cells."""
    search_m = settings.floor_search_m
    histograms = _histograms(points_level, expected_m, search_m)
    window = np.ones(max(1, round(settings.floor_height_m / HEIGHT_BIN_M)))
    returns, ground = (np.convolve(histogram, window, mode="same") for histogram in histograms)
    mode = int(np.argmax(ground))
    return expected_m - search_m + (mode + 0.5) * HEIGHT_BIN_M, int(returns[mode]), float(ground[mode])


def _bend(points_level: FloatArray, plane: HorizontalPlane, settings: RearrangementSettings) -> tuple[FloatArray, bool]:
    """The pieces of a floor that is rather two planes than one, and whether the higher of them is the floor; see `Floor`.

    By the consensus of small cells of the ground, each with the height at which most of its returns lie: returns crowd
    near the sensor, and least squares over all of them would lay one slanting plane through both pieces.
    """
    none = np.zeros((0, 3)), False
    cells = _floor_cells(points_level, plane.height_m, plane.slope, settings.floor_search_m)
    rise_m = cells[:, 2]
    on_plane = np.count_nonzero(np.abs(rise_m) < _BEND_DISTANCE_M)
    more = int(_BEND_SHARE_MIN * len(cells)) + 1
    # Fewer cells do not tell two planes from one.
    if len(cells) < 40 or len(cells) - on_plane < more:
        return none
    A = np.column_stack([np.ones(len(cells)), cells[:, :2]])
    first = _consensus_plane(A, rise_m, plane.slope, settings.floor_slope_max)
    left = np.abs(A @ first - rise_m) > _BEND_DISTANCE_M
    if np.count_nonzero(left) < more:
        return none
    second = _consensus_plane(A[left], rise_m[left], plane.slope, settings.floor_slope_max)
    pair = np.stack([first, second])
    bends = [_joined(A, rise_m, pair, is_foot) for is_foot in (True, False)]
    is_foot = bool(bends[0][1].sum() >= bends[1][1].sum())
    pieces, held = bends[0 if is_foot else 1]
    steepest = np.hypot(*(pieces[:, 1:] + plane.slope).T).max()
    if held.sum() < on_plane + more or held.min() < more or steepest > settings.floor_slope_max:
        return none
    return pieces + np.array([plane.height_m, *plane.slope]), is_foot


def _joined(
    A: FloatArray, rise_m: FloatArray, pieces: FloatArray, is_foot: bool
) -> tuple[FloatArray, IntArray]:
    """Two planes (2, 3) fitted each to the cells on its own side of where they meet, and how many (2,) lie on each."""
    held: IntArray = np.zeros(2, np.int64)
    for _ in range(5):
        heights = A @ pieces.T
        piece = heights.argmax(axis=1) if is_foot else heights.argmin(axis=1)
        near = np.abs(heights[np.arange(len(A)), piece] - rise_m) < _BEND_DISTANCE_M
        held[:] = np.bincount(piece[near], minlength=2)
        if held.min() < 3:
            break
        parts = (near & (piece == 0), near & (piece == 1))
        pieces = np.asarray([np.linalg.lstsq(A[part], rise_m[part], rcond=None)[0] for part in parts])
    return pieces, held


def _consensus_plane(
    A: FloatArray, rise_m: FloatArray, slope: FloatArray, slope_max: float
) -> FloatArray:
    """Rise at the origin and slope (3,) of the plane that most cells lie on; of cells with rows 1, x, y (m, 3).

    slope: of the plane that the rise is counted from; both together are at most `slope_max`.
    """
    generator = np.random.default_rng(0)
    best: FloatArray = np.zeros(3)
    most = -1
    triples = generator.integers(0, len(A), (128, 3))
    corners = A[triples]
    spanned = np.abs(np.linalg.det(corners)) > _CELL_M
    hypotheses = np.linalg.solve(corners[spanned], rise_m[triples[spanned]][..., None])[..., 0]
    hypotheses = hypotheses[np.hypot(*(hypotheses[:, 1:] + slope).T) <= slope_max]
    if len(hypotheses):
        counts = np.count_nonzero(np.abs(hypotheses @ A.T - rise_m) < _BEND_DISTANCE_M, axis=1)
        best, most = hypotheses[np.argmax(counts)], int(counts.max())
    for _ in range(2):
        near = np.abs(A @ best - rise_m) < _BEND_DISTANCE_M
        if most < 3 or np.linalg.matrix_rank(A[near]) < 3:
            break
        best = np.linalg.lstsq(A[near], rise_m[near], rcond=None)[0]
    return np.asarray(best)


@numba.njit(cache=True, nogil=True)
def _histograms(
    points: FloatArray, middle_m: float, search_m: float
) -> FloatArray:  # pragma: no cover
    """(2, bins) of the heights: returns, and cells of the ground. A cell counts once, shared by its returns: so the upright
    returns of a wall count for little at any one height, be they many more than those of a floor that is seen from low.
    """
    cells = int(2 * FLOOR_RANGE_M / _CELL_M)
    cell, count = np.full(len(points), -1, np.int32), np.zeros(cells * cells, np.int32)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]) + FLOOR_RANGE_M, np.float64(points[i, 1]) + FLOOR_RANGE_M
        inside = x >= 0 and y >= 0 and x < cells * _CELL_M and y < cells * _CELL_M
        if inside and abs(points[i, 2] - middle_m) < search_m:
            cell[i] = min(int(x / _CELL_M), cells - 1) * cells + min(int(y / _CELL_M), cells - 1)
            count[cell[i]] += 1
    histograms = np.zeros((2, int(np.ceil(2 * search_m / HEIGHT_BIN_M))))
    for i in range(len(points)):
        if cell[i] >= 0:
            b = min(
                int((points[i, 2] - middle_m + search_m) / HEIGHT_BIN_M), histograms.shape[1] - 1
            )
            histograms[0, b] += 1.0
            histograms[1, b] += 1.0 / count[cell[i]]
    return histograms


@numba.njit(cache=True, nogil=True)
def _floor_cells(
    points: FloatArray, height_m: float, slope: FloatArray, search_m: float
) -> FloatArray:  # pragma: no cover
    """(m, 3) x, y and rise above a plane, where most of its returns lie, of each cell of the ground that has enough."""
    cells, bins = int(2 * FLOOR_RANGE_M / _CELL_M), int(2 * search_m / HEIGHT_BIN_M)
    counts = np.zeros((cells * cells, bins), np.int32)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        rise = points[i, 2] - (height_m + slope[0] * x + slope[1] * y)
        if abs(x) < FLOOR_RANGE_M and abs(y) < FLOOR_RANGE_M and abs(rise) < search_m:
            column, row = int((x + FLOOR_RANGE_M) / _CELL_M), int((y + FLOOR_RANGE_M) / _CELL_M)
            counts[column * cells + row, min(int((rise + search_m) / HEIGHT_BIN_M), bins - 1)] += 1
    found = np.empty((cells * cells, 3))
    m = 0
    for cell in range(cells * cells):
        best, most = 1, 0
        for b in range(1, bins - 1):
            near = counts[cell, b - 1] + counts[cell, b] + counts[cell, b + 1]
            if near > most:
                best, most = b, near
        if most >= 3:
            total, weighted = 0, 0
            for b in range(max(best - 3, 0), min(best + 4, bins)):
                total += counts[cell, b]
                weighted += counts[cell, b] * b
            found[m, 0] = (cell // cells + 0.5) * _CELL_M - FLOOR_RANGE_M
            found[m, 1] = (cell % cells + 0.5) * _CELL_M - FLOOR_RANGE_M
            found[m, 2] = (weighted / total + 0.5) * HEIGHT_BIN_M - search_m
            m += 1
    return found[:m]


@numba.njit(cache=True, nogil=True)
def floor_height(pieces: FloatArray, is_foot: bool, x: float, y: float) -> float:  # pragma: no cover
    """Height in metres of a floor at one place; `pieces` (2, 3) and `is_foot` as of `Floor`."""
    first = pieces[0, 0] + pieces[0, 1] * x + pieces[0, 2] * y
    second = pieces[1, 0] + pieces[1, 1] * x + pieces[1, 2] * y
    return float(max(first, second) if is_foot else min(first, second))


@numba.njit(cache=True, nogil=True)
def heights_above_pieces(points: FloatArray, pieces: FloatArray, is_foot: bool) -> FloatArray:  # pragma: no cover
    """Heights (n,) float32 of points (n, 3) above a floor, in metres; parameters as of `floor_height`."""
    heights = np.empty(len(points), np.float32)
    for i in range(len(points)):
        heights[i] = points[i, 2] - floor_height(pieces, is_foot, points[i, 0], points[i, 1])
    return heights
