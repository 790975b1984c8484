"""What the floor, the ceilings and the point lines have in common (paper, III.A): settings, nearly level planes, returns."""

from dataclasses import dataclass

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.settings import StepSettings

HEIGHT_BIN_M = 0.01  # width of the bins in which heights are counted: finer than a lidar's scatter


class RearrangementSettings(StepSettings):
    """Floor, ceiling and point lines (paper, III.A)."""

    floor_height_m: float = Field(
        0.045,
        gt=0,
        le=0.5,
        description="Maximum distance (m) of a floor return from the floor: the paper's height filter. III.A.",
    )
    floor_search_m: float = Field(
        0.25, gt=0, le=2.0, description="Maximum height (m) of the floor above or below the map's. III.A."
    )
    floor_slope_max: float = Field(
        0.09, ge=0, le=0.5, description="Maximum slope of the floor (m per m); 0 keeps it level. III.A."
    )
    ceiling_distance_m: float = Field(
        0.03, gt=0, le=0.5, description="Maximum distance (m) of a ceiling return from a ceiling plane. III.A."
    )
    ceiling_height_min_m: float = Field(
        2.1, gt=0, description="Minimum height (m) of a ceiling above the floor. III.A."
    )
    ceiling_support_min: float = Field(
        0.02, ge=0, le=1, description="Minimum share of the scan's returns on a ceiling. III.A."
    )
    line_points_min: int = Field(
        20, ge=2, description="Minimum number of returns in a point line, floor and ceiling left out. III.A."
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
class Returns:
    """The returns of a scan as the steps after the floor use them.

    points_level: (n, 3) metres in the scan's level frame: z against gravity, its origin on the floor below the base.
    height_m: (n,) metres above the floor. origin_level: (3,) metres, the sensor.
    """

    points_level: FloatArray
    height_m: FloatArray
    origin_level: FloatArray


def plane_rows(planes: tuple[HorizontalPlane, ...]) -> FloatArray:
    """(c, 3) height at the level frame's origin, slope along x, slope along y."""
    return np.array([[p.height_m, *p.slope] for p in planes]).reshape(-1, 3)


def refine_plane(
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
def _heights(points: FloatArray, height_m: float, slope: FloatArray) -> FloatArray:  # pragma: no cover
    heights = np.empty(len(points), np.float32)
    for i in range(len(points)):
        heights[i] = points[i, 2] - (height_m + slope[0] * points[i, 0] + slope[1] * points[i, 1])
    return heights
