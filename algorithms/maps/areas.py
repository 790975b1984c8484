"""Areas in the plan."""

import shapely
from shapely.geometry.base import BaseGeometry

_CORNERS_M = 1e-4
"""Grid that corners are laid on where they nearly coincide."""


def largest(area: BaseGeometry) -> shapely.Polygon:
    """Return the largest part of an area."""
    return max(shapely.get_parts(area), key=shapely.area)


def grown(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    """Buffer an area with square corners.

    Where corners nearly coincide, GEOS may return a hole outside its shell. Corners are then laid
    on a grid; invalid rest is made valid.
    """
    buffered = area.buffer(distance_m, join_style="mitre")
    if not buffered.is_valid:
        buffered = shapely.set_precision(area, _CORNERS_M).buffer(distance_m, join_style="mitre")
    if buffered.is_valid:
        return buffered
    return shapely.make_valid(buffered, method="structure", keep_collapsed=False)


def closed(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    """Close the gaps in an area that are narrower than twice a distance.

    Nothing of the area is lost: square corners cut into the ends of acute notches, which are added
    again.
    """
    return shapely.union(grown(grown(area, distance_m), -distance_m), area, grid_size=_CORNERS_M)
