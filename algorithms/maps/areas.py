"""Areas in the plan."""

import shapely
from shapely.geometry.base import BaseGeometry

_CORNERS_M = 1e-4
"""Grid that corners are laid on where they nearly coincide."""


def largest(area: BaseGeometry) -> shapely.Polygon:
    """The largest part of an area."""
    return max(shapely.get_parts(area), key=shapely.area)


def grown(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    """An area and all that lies within a distance of it, with square corners; shrunk where the distance is negative.

    Of corners that nearly coincide GEOS may make a hole outside its shell, and then refuses to work with the area: they are laid
    on a grid there, and what is invalid all the same is made valid.
    """
    buffered = area.buffer(distance_m, join_style="mitre")
    if not buffered.is_valid:
        buffered = shapely.set_precision(area, _CORNERS_M).buffer(distance_m, join_style="mitre")
    return buffered if buffered.is_valid else shapely.make_valid(buffered, method="structure", keep_collapsed=False)


def closed(area: BaseGeometry, distance_m: float) -> BaseGeometry:
    """An area, and the gaps in it that are narrower than twice a distance; nothing of it goes.

    Shrunk again, square corners cut into what lies at the end of an acute notch that was closed: that is put back.
    """
    return shapely.union(grown(grown(area, distance_m), -distance_m), area, grid_size=_CORNERS_M)
