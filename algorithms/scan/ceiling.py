"""The ceilings of a scan: the largest planes parallel to its floor, by RANSAC (paper, III.A)."""

import numba
import numpy as np
from scipy.ndimage import binary_erosion

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.scan.rearrangement import HEIGHT_BIN_M, HorizontalPlane, RearrangementSettings, refine_plane

_HEIGHT_MAX_M = 50.0
"""Maximum height in metres above the floor of a ceiling; a damaged return may be higher."""
_FURTHER_SHARE_MIN = 0.004
"""Minimum share of the scan's returns on a further ceiling, seen through a door. III.A."""
_HYPOTHESES = 500
"""Number of RANSAC hypotheses for each ceiling. III.A."""
_CEILINGS_MAX = 3
"""Maximum number of ceilings in a scan; rooms seen through doors have their own. III.A."""


def find_ceilings(
    points_level: FloatArray, height_m: FloatArray, floor: HorizontalPlane, settings: RearrangementSettings, seed: int
) -> tuple[HorizontalPlane, ...]:
    """The ceilings by RANSAC: the biggest planes parallel to the floor or level, high above it and well supported.

    A plane parallel to a given one has one unknown, its height, so one return makes a hypothesis. The largest is the
    ceiling. A further one is taken only where it can be no duct or lamp: above the largest, or as broad as a room.

    points_level: (n, 3); height_m: (n,) of these above the floor; seed: of the hypotheses.
    """
    # 8000 returns find a plane and place it to a millimetre.
    points, stride = _thinned(points_level, height_m, settings.ceiling_height_min_m, 8_000)
    # Heights above planes parallel to the floor, and above level ones where the floor slopes by more than a hundredth.
    slopes = [*floor.slopes]
    if all(np.hypot(*slope) >= 0.01 for slope in slopes):
        slopes.append(np.zeros(2))
    parallel = [points[:, 2] - floor.height_m - points[:, :2] @ slope for slope in slopes]
    generator = np.random.default_rng(seed)
    ceilings: list[HorizontalPlane] = []
    for _ in range(_CEILINGS_MAX + 1):
        share = _FURTHER_SHARE_MIN if ceilings else settings.ceiling_support_min
        support_min = max(30, int(share * len(points_level) / stride))
        if len(points) < support_min or len(ceilings) == _CEILINGS_MAX:
            break
        found = [
            _ransac_height(heights, settings.ceiling_distance_m, generator) for heights in parallel
        ]
        best = int(np.argmax([support for _, support in found]))
        heights, (centre_m, support) = parallel[best], found[best]
        if support < support_min:
            break
        on_plane = np.abs(heights - centre_m) < settings.ceiling_distance_m
        found_m = floor.height_m + centre_m
        if (
            not ceilings
            or found_m > ceilings[0].height_m
            or (support > 0.2 * ceilings[0].support and _is_broad(points[on_plane]))
        ):
            ceilings.append(refine_plane(points, found_m, slopes[best], settings.ceiling_distance_m, 0.03, 20.0))
        # What touches a plane that was tried is not tried again.
        rest = np.abs(heights - centre_m) > 1.5 * settings.ceiling_distance_m
        parallel, points = [heights[rest] for heights in parallel], points[rest]
    return tuple(ceilings)


def below_ceiling(points_level: FloatArray, planes: FloatArray) -> FloatArray:
    """How far (n,) float32 points (n, 3) lie below the ceiling nearest in height, negative above; planes as `plane_rows`.

    Infinite where there is no ceiling.
    """
    return np.asarray(_below(points_level, np.ascontiguousarray(planes, np.float64)))


def _ransac_height(
    heights_m: FloatArray, distance_m: float, generator: np.random.Generator
) -> tuple[float, int]:
    """The best of the hypotheses, as the mean height of its returns, and how many they are."""
    chosen = generator.integers(0, len(heights_m), _HYPOTHESES)
    mean_m, count = _best_height(heights_m, chosen, distance_m, HEIGHT_BIN_M)
    return float(mean_m), int(count)


def _is_broad(points: FloatArray) -> bool:
    """Whether the ground below returns of one height is a metre wide somewhere: below a duct it is not.

    The walls that reach that height are only lines on this ground.
    """
    cell = np.floor(points[:, :2] / 0.2).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    size = cell.max(axis=0) + 2
    if size.prod() > 4_000_000:  # damaged returns
        return False
    covered = np.zeros(size, bool)
    covered[cell[:, 0], cell[:, 1]] = True
    # A duct of 40 cm, and the wall beside it, cover up to four cells across.
    return bool(binary_erosion(covered, np.ones((5, 5), bool)).sum() >= 4)


@numba.njit(cache=True, nogil=True)
def _thinned(
    points: FloatArray, above_m: FloatArray, low_m: float, most: int
) -> tuple[FloatArray, int]:  # pragma: no cover
    """Every n-th of the points from `low_m` to `_HEIGHT_MAX_M`, (k, 3) float64, and n.

    Not many more than `most`.
    """
    count = 0
    for i in range(len(points)):
        count += low_m < above_m[i] < _HEIGHT_MAX_M
    stride = max(1, count // most)
    kept = np.empty(((count + stride - 1) // stride, 3))
    place, left_out = 0, 0
    for i in range(len(points)):
        if low_m < above_m[i] < _HEIGHT_MAX_M:
            if left_out == 0:
                kept[place, 0], kept[place, 1], kept[place, 2] = points[i, 0], points[i, 1], points[i, 2]
                place, left_out = place + 1, stride
            left_out -= 1
    return kept, stride


@numba.njit(cache=True, nogil=True)
def _best_height(
    heights_m: FloatArray, chosen: IntArray, distance_m: float, bin_m: float
) -> tuple[float, int]:  # pragma: no cover
    """Of the heights that are chosen as hypotheses the one near which most lie: the mean of these, and how many they are."""
    lowest, highest = heights_m.min(), heights_m.max()
    histogram = np.zeros(int((highest - lowest) / bin_m) + 2, np.int64)
    for height in heights_m:
        histogram[int((height - lowest) / bin_m) + 1] += 1
    cumulative = np.cumsum(histogram)
    reach, last = max(1, round(distance_m / bin_m)), len(histogram) - 1
    best_m, most = 0.0, -1
    for row in chosen:
        cell = int((heights_m[row] - lowest) / bin_m)
        support = cumulative[min(cell + reach + 1, last)] - cumulative[max(cell - reach, 0)]
        if support > most:
            best_m, most = heights_m[row], support
    total, count = 0.0, 0
    for height in heights_m:
        if abs(height - best_m) < distance_m:
            total += height
            count += 1
    return total / count, count


@numba.njit(cache=True, nogil=True)
def _below(points: FloatArray, planes: FloatArray) -> FloatArray:  # pragma: no cover
    below = np.full(len(points), np.inf, np.float32)
    for i in range(len(points)):
        for c in range(len(planes)):
            b = planes[c, 0] + planes[c, 1] * points[i, 0] + planes[c, 2] * points[i, 1] - points[i, 2]
            if abs(b) < abs(below[i]):
                below[i] = b
    return below
