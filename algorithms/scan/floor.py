"""The floor of a scan: one plane, or two at the foot or top of a ramp (paper, III.A)."""

from dataclasses import dataclass, field, replace

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.scan.rearrangement import (
    HEIGHT_BIN_M,
    HorizontalPlane,
    RearrangementSettings,
    refine_plane,
)

FLOOR_SEARCH_M = 0.25  # maximum height (m) of the floor above or below an expected one
FLOOR_RANGE_M = 6.0  # maximum distance (m) from the robot, along x and y, of the ground in use
_CELL_M = 0.2  # edge (m) of the ground's cells
_CELLS = int(2 * FLOOR_RANGE_M / _CELL_M)
_BINS = int(np.ceil(2 * FLOOR_SEARCH_M / HEIGHT_BIN_M))  # of heights
_SUPPORT_MIN = 20  # minimum number of returns on a floor
_PLANE_RANGE_M = 10.0  # maximum horizontal range (m) of returns that the floor's plane is fitted to
_BEND_CELLS_MIN = 40  # fewer cells do not distinguish two planes from one
_BEND_DISTANCE_M = 0.012  # maximum distance (m) of a cell's height from its plane
_BEND_SHARE_MIN = 0.07
"""A floor bends where two planes hold a share of the cells that exceeds one plane's by this, and
each of the two holds at least this share."""


@dataclass(frozen=True)
class Floor(HorizontalPlane):
    """The floor of a scan: the plane that fits it best and, where the floor bends, its two pieces.

    pieces: (2, 3) height at the level frame's origin, slope along x, slope along y, the larger
        piece first; (0, 3) where the floor is one plane.
    is_foot: whether the floor is the higher of its pieces, as at a ramp's foot, or the lower.
    rejected_m: height above the floor of a surface that covers more ground but is not below the
        robot, as outside a window; 0 without such ground.
    """

    pieces: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    is_foot: bool = False
    rejected_m: float = 0.0

    @property
    def both_pieces(self) -> FloatArray:
        """(2, 3) its pieces, or twice its plane."""
        return self.pieces if len(self.pieces) else np.array([(self.height_m, *self.slope)] * 2)

    def height_at(self, points_level: FloatArray) -> FloatArray:
        """Height (m,) of the floor at the x and y of points (m, 2 or more)."""
        heights = self.both_pieces[:, :1] + self.both_pieces[:, 1:] @ points_level[:, :2].T
        return np.asarray(heights.max(axis=0) if self.is_foot else heights.min(axis=0))

    def heights_above(self, points_level: FloatArray) -> FloatArray:
        """Heights (n,) float32 of points (n, 3) above the floor, in metres."""
        return np.asarray(heights_above_pieces(points_level, self.both_pieces, self.is_foot))


@numba.njit(cache=True, nogil=True)
def heights_above_pieces(points: FloatArray, pieces: FloatArray, is_foot: bool) -> FloatArray:
    """Heights (n,) float32 above a floor of two pieces (2, 3); parameters as in `Floor`."""
    heights = np.empty(len(points), np.float32)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        first = pieces[0, 0] + pieces[0, 1] * x + pieces[0, 2] * y
        second = pieces[1, 0] + pieces[1, 1] * x + pieces[1, 2] * y
        heights[i] = points[i, 2] - (max(first, second) if is_foot else min(first, second))
    return heights


def find_floor(
    points_level: FloatArray, settings: RearrangementSettings, map_floor_m: float = 0.0
) -> Floor:
    """Find the floor below the robot (paper: "we can straightforward locate where the floor is").

    The floor is expected at height 0, as far below the base as at the first pose (robots on wheels,
    also on ramps), or at the map's floor (carried or flying lidars). Near these heights, the height
    that covers most ground is refined to a plane, or to two where the floor bends. Without enough
    returns the floor is at height 0.

    map_floor_m: height of the map's floor in the level frame.
    """
    # A third of the returns places the plane as well, to a fraction of a millimetre.
    points_level = np.ascontiguousarray(points_level[::3])
    expected_m = (0.0, map_floor_m)
    searched_m = expected_m if abs(map_floor_m) > FLOOR_SEARCH_M else expected_m[:1]
    candidates = [_fullest_height(points_level, height_m, settings) for height_m in searched_m]
    height_m, support, _ = max(candidates, key=lambda candidate: candidate[2])
    if support < _SUPPORT_MIN:
        return Floor(0.0, np.zeros(2), 0)
    floor = _fit(points_level, height_m, settings)
    # Ground at neither height, as outside a window, is the floor only if it holds more returns than
    # the ground expected there: a robot sees its own floor from nearest. This does not exclude
    # ramps, steps and platforms: below the base their floor is at an expected height to 2 cm.
    off_m = min(abs(_height_below_base(floor) - height_m) for height_m in expected_m)
    if off_m > settings.floor_height_m:
        fits = [_fit(points_level, height_m, settings) for height_m in dict.fromkeys(expected_m)]
        expected = max(fits, key=lambda fit: fit.support)
        if expected.support > floor.support:
            rejected_m = _height_below_base(floor) - _height_below_base(expected)
            return replace(expected, rejected_m=rejected_m)
    return floor


def _height_below_base(floor: Floor) -> float:
    return float(floor.height_at(np.zeros((1, 2)))[0])


def _fit(points_level: FloatArray, height_m: float, settings: RearrangementSettings) -> Floor:
    """The floor near a height."""
    plane = refine_plane(
        points_level,
        height_m,
        np.zeros(2),
        settings.floor_height_m,
        settings.floor_slope_max,
        _PLANE_RANGE_M,
    )
    pieces, is_foot = _bend(points_level, plane, settings)
    return Floor(plane.height_m, plane.slope, plane.support, pieces, is_foot)


@numba.njit(cache=True, nogil=True)
def _count_heights(
    points: FloatArray, height_m: float, slope: FloatArray
) -> tuple[IntArray, IntArray]:
    """Cells (m,) of the ground, and their number of returns (m, bins) by height about a plane."""
    counts = np.zeros((_CELLS * _CELLS, _BINS), np.int32)
    total = np.zeros(_CELLS * _CELLS, np.int32)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        rise = points[i, 2] - (height_m + slope[0] * x + slope[1] * y)
        if abs(x) < FLOOR_RANGE_M and abs(y) < FLOOR_RANGE_M and abs(rise) < FLOOR_SEARCH_M:
            column, row = int((x + FLOOR_RANGE_M) / _CELL_M), int((y + FLOOR_RANGE_M) / _CELL_M)
            cell = column * _CELLS + row
            counts[cell, min(int((rise + FLOOR_SEARCH_M) / HEIGHT_BIN_M), _BINS - 1)] += 1
            total[cell] += 1
    cells = np.flatnonzero(total)
    return cells, counts[cells]


def _fullest_height(
    points_level: FloatArray, expected_m: float, settings: RearrangementSettings
) -> tuple[float, int, float]:
    """The height near an expected one that covers most ground; its returns; its ground in cells.

    Each cell counts once, shared by its returns: so the returns of a wall, however many, count
    little at any one height.
    """
    _, counts = _count_heights(points_level, expected_m, np.zeros(2))
    shares = counts / counts.sum(axis=1, keepdims=True)
    window = np.ones(max(1, round(settings.floor_height_m / HEIGHT_BIN_M)))
    returns, ground = (np.convolve(c.sum(axis=0), window, mode="same") for c in (counts, shares))
    mode = int(np.argmax(ground))
    height_m = expected_m - FLOOR_SEARCH_M + (mode + 0.5) * HEIGHT_BIN_M
    return height_m, int(returns[mode]), float(ground[mode])


def _bend(
    points_level: FloatArray, plane: HorizontalPlane, settings: RearrangementSettings
) -> tuple[FloatArray, bool]:
    """`pieces` and `is_foot` of `Floor`.

    Fitted to the heights of small cells, because returns crowd near the sensor: least squares over
    all returns would fit one slanting plane through both pieces.
    """
    none = np.zeros((0, 3)), False
    places, rise_m = _cell_heights(*_count_heights(points_level, plane.height_m, plane.slope))
    on_plane = np.count_nonzero(np.abs(rise_m) < _BEND_DISTANCE_M)
    more = int(_BEND_SHARE_MIN * len(places)) + 1
    if len(places) < _BEND_CELLS_MIN or len(places) - on_plane < more:
        return none
    A = np.column_stack([np.ones(len(places)), places])
    first = _consensus_plane(A, rise_m, plane.slope, settings.floor_slope_max)
    left = np.abs(A @ first - rise_m) > _BEND_DISTANCE_M
    if np.count_nonzero(left) < more:
        return none
    second = _consensus_plane(A[left], rise_m[left], plane.slope, settings.floor_slope_max)
    foot, top = (_fit_pieces(A, rise_m, np.stack([first, second]), b) for b in (True, False))
    is_foot = bool(foot[1].sum() >= top[1].sum())
    pieces, held = foot if is_foot else top
    steepest = np.hypot(*(pieces[:, 1:] + plane.slope).T).max()
    too_few = held.sum() < on_plane + more or held.min() < more
    if too_few or steepest > settings.floor_slope_max:
        return none
    return pieces + np.array([plane.height_m, *plane.slope]), is_foot


def _cell_heights(cells: IntArray, counts: IntArray) -> tuple[FloatArray, FloatArray]:
    """Middle (m, 2) of each cell with enough returns, and the height (m,) where most of them are.

    cells, counts: from `_count_heights`.
    """
    windows = counts[:, :-2] + counts[:, 1:-1] + counts[:, 2:]
    enough = windows.max(axis=1) >= 3
    cells, counts, windows, bins = cells[enough], counts[enough], windows[enough], counts.shape[1]
    bin_ = windows.argmax(axis=1)[:, None] + 1 + np.arange(-3, 4)
    weight = np.take_along_axis(counts, bin_ % bins, axis=1) * ((bin_ >= 0) & (bin_ < bins))
    mean_bin = (weight * bin_).sum(axis=1) / weight.sum(axis=1)
    places = (np.column_stack(np.divmod(cells, _CELLS)) + 0.5) * _CELL_M - FLOOR_RANGE_M
    return places, (mean_bin + 0.5) * HEIGHT_BIN_M - FLOOR_SEARCH_M


def _fit_pieces(
    A: FloatArray, rise_m: FloatArray, pieces: FloatArray, is_foot: bool
) -> tuple[FloatArray, IntArray]:
    """Fit two planes (2, 3), each to the cells on its side of their edge; (2,) cells on each.

    A: (m, 3) rows 1, x, y of the cells; rise_m: (m,) their heights.
    """
    held: IntArray = np.zeros(2, np.int64)
    for _ in range(5):
        heights = A @ pieces.T
        piece = heights.argmax(axis=1) if is_foot else heights.argmin(axis=1)
        near = np.abs(heights[np.arange(len(A)), piece] - rise_m) < _BEND_DISTANCE_M
        held = np.bincount(piece[near], minlength=2)
        if held.min() < 3:
            break
        sides = (near & (piece == 0), near & (piece == 1))
        pieces = np.array([np.linalg.lstsq(A[s], rise_m[s], rcond=None)[0] for s in sides])
    return pieces, held


def _consensus_plane(
    A: FloatArray, rise_m: FloatArray, slope: FloatArray, slope_max: float
) -> FloatArray:
    """RANSAC: height at the origin and slope (3,) of the plane that holds most cells (m, 3).

    slope: of the plane that heights are relative to; the sum of both is at most `slope_max`.
    """
    triples = np.random.default_rng(0).integers(0, len(A), (128, 3))
    corners = A[triples]
    spanned = np.abs(np.linalg.det(corners)) > _CELL_M
    hypotheses = np.linalg.solve(corners[spanned], rise_m[triples[spanned]][..., None])[..., 0]
    hypotheses = hypotheses[np.hypot(*(hypotheses[:, 1:] + slope).T) <= slope_max]
    if not len(hypotheses):
        return np.zeros(3)
    counts = np.count_nonzero(np.abs(hypotheses @ A.T - rise_m) < _BEND_DISTANCE_M, axis=1)
    best: FloatArray = hypotheses[np.argmax(counts)]
    for _ in range(2):
        near = np.abs(A @ best - rise_m) < _BEND_DISTANCE_M
        if counts.max() < 3 or np.linalg.matrix_rank(A[near]) < 3:
            break
        best = np.linalg.lstsq(A[near], rise_m[near], rcond=None)[0]
    return best
