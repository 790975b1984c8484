"""What floor and ceilings share (paper, III.A): settings, nearly level planes."""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.settings import StepSettings

HEIGHT_BIN_M = 0.01  # bin width (m) of height histograms: finer than a lidar's scatter
_SUPPORT_MIN = 20  # minimum number of returns that a plane is fitted to
_LEVEL_PRIOR = 0.02  # weight of a level plane against the returns' second moments (m²)


class RearrangementSettings(StepSettings):
    """Floor and ceilings (paper, III.A)."""

    floor_height_m: float = Field(
        0.045,
        gt=0,
        le=0.5,
        description="Maximum distance (m) of a floor return from the floor: the paper's height "
        "filter. III.A.",
    )
    floor_slope_max: float = Field(
        0.09,
        ge=0,
        le=0.5,
        description="Maximum slope of the floor (m per m); 0 keeps it level. III.A.",
    )
    ceiling_distance_m: float = Field(
        0.03,
        gt=0,
        le=0.5,
        description="Maximum distance (m) of a ceiling return from a ceiling plane. III.A.",
    )
    ceiling_height_min_m: float = Field(
        2.1, gt=0, description="Minimum height (m) of a ceiling above the floor. III.A."
    )


@dataclass(frozen=True)
class HorizontalPlane:
    """A floor or a ceiling in the level frame: height(x, y) = height_m + slope · (x, y).

    slope: (2,) metres up for each metre along x and y.
    support: number of returns on it, among the subset of the scan that it was fitted to.
    """

    height_m: float
    slope: FloatArray
    support: int

    def height_at(self, points_level: FloatArray) -> FloatArray:
        """Height (m,) of the plane at the x and y of points (m, 2 or more)."""
        return np.asarray(self.height_m + points_level[:, :2] @ self.slope)


class Returns(NamedTuple):  # which compiled functions take, unlike a dataclass
    """The returns of a scan as the steps after the floor use them.

    points_level: (n, 3) metres, level frame: z against gravity, origin on the floor below the base.
    height_m: (n,) above the floor.
    origin_level: (3,) the sensor, in one piece of memory.
    """

    points_level: FloatArray
    height_m: FloatArray
    origin_level: FloatArray


def plane_rows(planes: tuple[HorizontalPlane, ...]) -> FloatArray:
    """(c, 3) height at the level frame's origin, slope along x, slope along y."""
    return np.array([[p.height_m, *p.slope] for p in planes]).reshape(-1, 3)


def refine_plane(
    points: FloatArray,
    height_m: float,
    slope: FloatArray,
    distance_m: float,
    turn_max: float,
    range_m: float,
) -> HorizontalPlane:
    """Fit a plane by repeated least squares to the returns near it.

    distance_m: maximum distance of these returns from the plane.
    turn_max: maximum change of the slope (m per m).
    range_m: maximum horizontal range of these returns.
    """
    first = slope
    support = 0
    for _ in range(3):
        A, b = _normal_equations(points, height_m, slope, distance_m, range_m)
        support = int(A[0, 0])
        if support < _SUPPORT_MIN:
            break
        # The prior holds what the returns leave open, such as the tilt of a narrow strip.
        A[1, 1] += _LEVEL_PRIOR * support
        A[2, 2] += _LEVEL_PRIOR * support
        correction = np.linalg.solve(A, b)
        height_m += float(correction[0])
        slope = slope + correction[1:]
        turn = float(np.hypot(*(slope - first)))
        if turn > turn_max:
            slope = first + (slope - first) * (turn_max / turn)
    return HorizontalPlane(height_m, slope, support)


@numba.njit(cache=True, nogil=True)
def _normal_equations(
    points: FloatArray, height_m: float, slope: FloatArray, distance_m: float, range_m: float
) -> tuple[FloatArray, FloatArray]:
    """Σ a aᵀ (3, 3) and Σ a r (3,), with a = (1, x, y) and r the residual height of each return."""
    n = sx = sy = sxx = sxy = syy = sr = sxr = syr = 0.0
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        r = points[i, 2] - (height_m + slope[0] * x + slope[1] * y)
        if abs(r) < distance_m and x * x + y * y < range_m * range_m:
            n, sx, sy = n + 1.0, sx + x, sy + y
            sxx, sxy, syy = sxx + x * x, sxy + x * y, syy + y * y
            sr, sxr, syr = sr + r, sxr + x * r, syr + y * r
    return np.array([[n, sx, sy], [sx, sxx, sxy], [sy, sxy, syy]]), np.array([sr, sxr, syr])
