"""Outlines of rooms: from the cells of a grid onto the faces that bound the rooms."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import Faces, Segment, segments
from ffmap.algorithms.maps.areas import largest
from ffmap.algorithms.maps.grid import GridMap

_PRECISION_M = 1e-6
"""Grid of coordinates when outlines are subtracted: GEOS fails at nearly touching polygons."""
_REACH_CELLS = 2.0
"""Maximum distance (cells) of an outline's edge from the face onto which it is moved."""
_SHORT_CELLS = 8.0
"""Maximum length (cells) of an edge on no face that is left out between two others."""
_STEP_CELLS = 1.2
"""Maximum height (cells) of the steps of cells that are smoothed."""
_PARALLEL_SINE = 0.3
"""Maximum sine of the angle between parallel lines."""
_KEPT_SHARE = 0.5
"""Minimum share of a room's area that remains."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Lines that bound rooms.

    ends: (k, 2, 2) x and y in metres. normal: (k, 2) unit vectors into the rooms.
    """

    ends: FloatArray
    normal: FloatArray


def outline_rooms(
    label: IntArray, numbers: IntArray, grid: GridMap, faces: Sequence[Faces], grow_m: float
) -> list[shapely.Polygon]:
    """Outline the areas (rows, columns) of a grid that have these numbers (k,).

    faces: see `lay_on_faces`. grow_m: how far rooms extend beyond their cells, except into each
    other.
    """
    padded = np.pad(label, ((0, 0), (1, 1)))
    # Each row is cut into runs of one area; every run ends where the next begins.
    row, start = np.nonzero(padded[:, 1:] != padded[:, :-1])
    area = padded[row, start + 1][:-1]
    runs = shapely.box(start[:-1], row[:-1], start[1:], row[:-1] + 1)
    cellwise = [shapely.union_all(runs[area == number]) for number in numbers]
    if not any(len(kind.ends) for kind in faces):
        cellwise = shapely.coverage_simplify(cellwise, 1.0)
    outlines = [
        shapely.transform(largest(cells), lambda corners: grid.origin + grid.cell_m * corners)
        for cells in cellwise
    ]
    grown = [largest(outline.buffer(grow_m, join_style="mitre")) for outline in outlines]
    return lay_on_faces(grown, faces, grid.cell_m)


def lay_on_faces(
    outlines: Sequence[shapely.Polygon], faces: Sequence[Faces], cell_m: float
) -> list[shapely.Polygon]:
    """Move the edges of outlines onto the faces that bound the rooms, and end their overlaps.

    faces: walls, sills of doors and windows; normals point into the rooms. cell_m: edge of the
    cells of the outlines.
    """
    sides = [side for kind in faces for side in segments(kind)]
    ends = np.concatenate([np.zeros((0, 2, 2)), *(kind.ends for kind in faces)])
    tree = shapely.STRtree(shapely.linestrings(ends))
    laid: list[shapely.Polygon] = []
    for outline in outlines:
        own = _laid(outline, sides, tree, cell_m) if sides else outline
        others = [other for other in laid if other.intersects(own)]
        taken = shapely.union_all(others, grid_size=_PRECISION_M)
        laid.append(largest(shapely.difference(own, taken, grid_size=_PRECISION_M)))
    return laid


def _laid(
    outline: shapely.Polygon, sides: Sequence[Segment], tree: shapely.STRtree, cell_m: float
) -> shapely.Polygon:
    smooth = outline.simplify(_STEP_CELLS * cell_m)
    shell, *holes = [
        _laid_ring(shapely.get_coordinates(ring), outline, sides, tree, cell_m)
        for ring in (smooth.exterior, *smooth.interiors)
    ]
    if len(shell) < 3:
        return outline
    room = shapely.Polygon(shell, [hole for hole in holes if len(hole) > 2]).simplify(1e-4)
    if not room.is_valid:
        room = largest(shapely.make_valid(room, method="structure", keep_collapsed=False))
    return room if room.area > _KEPT_SHARE * outline.area else outline


def _laid_ring(
    corners: FloatArray,
    outline: shapely.Polygon,
    sides: Sequence[Segment],
    tree: shapely.STRtree,
    cell_m: float,
) -> list[FloatArray]:
    """Corners of a closed ring (n, 2) of an outline, moved onto the faces of its edges."""
    reach_m = _REACH_CELLS * cell_m

    def face_of(edge: FloatArray) -> Segment | None:
        """The nearest face along an edge (2, 2) that has the room in front, and not behind it."""
        nearest, least_m = None, reach_m
        along = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
        for number in tree.query(shapely.linestrings(edge), predicate="dwithin", distance=reach_m):
            face = sides[number]
            away_m = float(np.abs(face.before_m(edge)).mean())
            if away_m >= least_m or abs(face.normal @ along) > _PARALLEL_SINE:
                continue
            margin_m = min(2 * reach_m, face.length_m / 2)
            low_m, high_m = margin_m, face.length_m - margin_m
            middle = face.at(np.clip(face.place_m(edge.mean(axis=0)[None]), low_m, high_m))
            beside = middle + np.outer([2, -2], reach_m * face.normal)
            before, behind = shapely.contains_xy(outline, *beside.T)
            if before and not behind:
                nearest, least_m = face, away_m
        return nearest

    edges = [(edge, face_of(edge)) for edge in np.stack([corners[:-1], corners[1:]], axis=1)]
    # Cells cut off corners.
    edges = [
        (edge, face)
        for edge, face in edges
        if face or np.linalg.norm(edge[1] - edge[0]) > _SHORT_CELLS * cell_m
    ]
    laid: list[FloatArray] = []
    for (edge, face), (after, other) in zip(edges[-1:] + edges[:-1], edges, strict=True):
        slope = float(other.normal @ face.along) if face and other else 0.0
        if face and other and abs(slope) > _PARALLEL_SINE:
            place = edge[1] - face.before_m(edge[1]) * face.normal
            laid.append(place - other.before_m(place) / slope * face.along)
            continue
        for place, own in ((edge[1], face or other), (after[0], other or face)):
            laid.append(place - own.before_m(place) * own.normal if own else place)
    return laid
