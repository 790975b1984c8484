"""The ceilings of a scan: the largest planes parallel to its floor, by RANSAC (paper, III.A)."""

import numba
import numpy as np
from scipy.ndimage import binary_erosion

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.scan.floor import Floor
from ffmap.algorithms.scan.rearrangement import (
    HEIGHT_BIN_M,
    HorizontalPlane,
    RearrangementSettings,
    refine_plane,
)

_HEIGHT_MAX_M = 50.0  # maximum height (m) of a ceiling; a damaged return may be higher
_RETURNS = 8_000  # number of returns in use: they find a plane and place it to a millimetre
_HYPOTHESES = 500  # RANSAC hypotheses for each ceiling
_CEILINGS_MAX = 3  # rooms that are seen through doors have their own ceilings
_SHARE_MIN = 0.02  # minimum share of the scan's returns on the largest ceiling
_FURTHER_SHARE_MIN = 0.004  # minimum share of the scan's returns on a further ceiling
_FURTHER_SUPPORT_MIN = 0.2  # its minimum support, as a share of the largest ceiling's
_SUPPORT_MIN = 30  # minimum number of returns on any ceiling
_TURN_MAX = 0.03  # maximum slope (m per m) against its hypothesis
_RANGE_MAX_M = 20.0  # maximum horizontal range (m) of returns that it is fitted to


def find_ceilings(
    points_level: FloatArray,
    height_m: FloatArray,
    floor: Floor,
    settings: RearrangementSettings,
    seed: int,
) -> tuple[HorizontalPlane, ...]:
    """Find the largest planes that are parallel to the floor, or level, and high above it.

    A plane parallel to a given one has one unknown, its height, so one return makes a hypothesis.
    The largest plane is the ceiling. Further ones are ceilings only where they cannot be a duct or
    a lamp: above the largest, or as broad as a room.

    height_m: (n,) of the points (n, 3) above the floor; seed: of the hypotheses.
    """
    high = (height_m > settings.ceiling_height_min_m) & (height_m < _HEIGHT_MAX_M)
    rows = np.flatnonzero(high)
    stride = max(1, len(rows) // _RETURNS)
    points = points_level[rows[::stride]].astype(np.float64)
    # Heights above planes parallel to the floor; above a level one too, where the floor slopes.
    slopes = [*(floor.pieces[:, 1:] if len(floor.pieces) else floor.slope[None])]
    if all(np.hypot(*slope) >= 0.01 for slope in slopes):
        slopes.append(np.zeros(2))
    parallel = [points[:, 2] - floor.height_m - points[:, :2] @ slope for slope in slopes]
    distance_m = settings.ceiling_distance_m
    generator = np.random.default_rng(seed)
    ceilings: list[HorizontalPlane] = []
    for _ in range(_CEILINGS_MAX + 1):
        share = _FURTHER_SHARE_MIN if ceilings else _SHARE_MIN
        support_min = max(_SUPPORT_MIN, int(share * len(points_level) / stride))
        if len(points) < support_min or len(ceilings) == _CEILINGS_MAX:
            break
        found = [_ransac_height(heights, distance_m, generator) for heights in parallel]
        best = int(np.argmax([support for _, support in found]))
        heights, (centre_m, support) = parallel[best], found[best]
        if support < support_min:
            break
        ceiling_m = floor.height_m + centre_m
        off_m = np.abs(heights - centre_m)
        if (
            not ceilings
            or ceiling_m > ceilings[0].height_m
            or (
                support > _FURTHER_SUPPORT_MIN * ceilings[0].support
                and _is_broad(points[off_m < distance_m])
            )
        ):
            plane = refine_plane(
                points, ceiling_m, slopes[best], distance_m, _TURN_MAX, _RANGE_MAX_M
            )
            ceilings.append(plane)
        # Returns that touch this plane make no further hypothesis.
        rest = off_m > 1.5 * distance_m
        parallel, points = [heights[rest] for heights in parallel], points[rest]
    return tuple(ceilings)


def _ransac_height(
    heights_m: FloatArray, distance_m: float, generator: np.random.Generator
) -> tuple[float, int]:
    """The best of the hypotheses: the mean height of its returns, and their number."""
    cell = ((heights_m - heights_m.min()) / HEIGHT_BIN_M).astype(np.int64)
    below = np.concatenate([[0], np.cumsum(np.bincount(cell))])  # number of returns below a cell
    chosen = generator.integers(0, len(heights_m), _HYPOTHESES)
    reach = max(1, round(distance_m / HEIGHT_BIN_M))
    above = np.minimum(cell[chosen] + reach + 1, len(below) - 1)
    support = below[above] - below[np.maximum(cell[chosen] - reach, 0)]
    best_m = heights_m[chosen[np.argmax(support)]]
    near = np.abs(heights_m - best_m) < distance_m
    return float(heights_m[near].mean()), int(np.count_nonzero(near))


def _is_broad(points: FloatArray) -> bool:
    """Whether the ground below returns of one height is a metre wide somewhere, as below no duct.

    The walls that reach that height are only lines on this ground.
    """
    cell = np.floor(points[:, :2] / 0.2).astype(np.int64)
    cell -= cell.min(axis=0) - 1
    size = cell.max(axis=0) + 2
    if size.prod() > 4_000_000:  # damaged returns
        return False
    covered = np.zeros(size, bool)
    covered[cell[:, 0], cell[:, 1]] = True
    # A duct of 40 cm and the wall beside it cover up to four cells across.
    return bool(binary_erosion(covered, np.ones((5, 5), bool)).sum() >= 4)


def below_ceiling(points_level: FloatArray, planes: FloatArray) -> FloatArray:
    """Distance (n,) float32 of points (n, 3) below the ceiling nearest in height, negative above.

    planes: (c, 3) as from `plane_rows`; the distance is infinite without a plane.
    """
    return np.asarray(_below(points_level, np.ascontiguousarray(planes, np.float64)))


@numba.njit(cache=True, nogil=True)
def _below(points: FloatArray, planes: FloatArray) -> FloatArray:
    below = np.full(len(points), np.inf, np.float32)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for c in range(len(planes)):
            b = planes[c, 0] + planes[c, 1] * x + planes[c, 2] * y - points[i, 2]
            if abs(b) < abs(below[i]):
                below[i] = b
    return below
