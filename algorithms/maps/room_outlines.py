"""Rooms' outlines along the faces that bound them, which are known to the centimetre, in place of the grid's cells."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import Faces, Segment
from ffmap.algorithms.maps.areas import grown, largest

_PRECISION_M = 1e-6
"""Outlines are computed to this: polygons that all but touch each other are cut wrongly in floating point."""
_AT_FACE_CELLS = 2.0
"""Maximum distance (cells) of an outline's edge from the face that it is laid on."""
_CORNER_M = 0.15
"""Maximum distance (m) of two faces' ends from where their lines cross, for a corner there."""
_CORNER_SINE = 0.3
"""Minimum sine of the angle between two faces that make a corner."""
_RUN_MIN_M = 0.15
"""Minimum length (m) of a face that an outline is laid on."""
_TIDY_M = 0.04
"""Half the width (m) of notches and spurs that are left out."""
_KEPT_SHARE = 0.5
"""Minimum share of a room's area that the faces which bound it leave."""
_STEP_SHARE = 0.6
"""Height of the steps of cells that are smoothed, as a share of `_AT_FACE_CELLS`."""


@dataclass(frozen=True, eq=False)
class Sides:
    """Lines that rooms end at. ends: (k, 2, 2) x and y in metres. normal: (k, 2) unit vectors into the rooms."""

    ends: FloatArray
    normal: FloatArray


@dataclass(frozen=True, eq=False)
class _Bound:
    """A face carried on to its corners. inner, outer: (2,) whether a room's inner or outer corner lies at each end."""

    face: Segment
    inner: tuple[bool, bool]
    outer: tuple[bool, bool]


def lay_on_faces(
    outlines: Sequence[shapely.Polygon], faces: Sequence[Faces], cell_m: float
) -> list[shapely.Polygon]:
    """The outlines with their edges on the faces that they run along.

    outlines: rooms that do not overlap, nor do those that are given back. faces: walls, sills of doors and the like,
    whose normals point into the rooms. cell_m: edge of the cells that the outlines are made of.
    """
    if not sum(len(kind.ends) for kind in faces):
        return list(outlines)
    reach_m = _AT_FACE_CELLS * cell_m
    bounds = list(_bounds(faces))
    tree = shapely.STRtree([shapely.LineString(_ends(bound.face)) for bound in bounds])
    laid: list[shapely.Polygon] = []
    for outline in outlines:
        near = np.sort(tree.query(outline.buffer(2 * reach_m), predicate="intersects"))
        laid_one = _laid(outline, [bounds[b] for b in near], reach_m)
        own = largest(shapely.set_precision(laid_one, _PRECISION_M))
        others = shapely.union_all([other for other in laid if other.intersects(own)], grid_size=_PRECISION_M)
        laid.append(largest(shapely.difference(own, others, grid_size=_PRECISION_M)))
    return laid


def _ends(face: Segment) -> FloatArray:
    """(2, 2) its ends."""
    return face.at(np.array([0.0, face.length_m]))


def _bounds(faces: Sequence[Faces]) -> Iterator[_Bound]:
    """Each face, its ends moved to where it meets another."""
    ends, normals = (np.concatenate([getattr(f, name) for f in faces]) for name in ("ends", "normal"))
    for one in (Segment.between(*own) for own in zip(ends, normals, strict=True)):
        ends_m, inner, outer = [0.0, one.length_m], [False, False], [False, False]
        place_m = _crossed_m(one, ends, normals)
        for end, outwards in ((0, -one.along), (1, one.along)):
            away_m = np.abs(place_m - ends_m[end])
            if away_m.min(initial=np.inf) > _CORNER_M:
                continue
            nearest = int(np.argmin(away_m))
            ends_m[end] = float(place_m[nearest])
            inner[end], outer[end] = bool(normals[nearest] @ outwards < 0), bool(normals[nearest] @ outwards > 0)
        if ends_m[1] - ends_m[0] > _RUN_MIN_M:
            face = Segment.between(one.at(np.array(ends_m)), one.normal)
            yield _Bound(face, (inner[0], inner[1]), (outer[0], outer[1]))


def _crossed_m(face: Segment, ends: FloatArray, normals: FloatArray) -> FloatArray:
    """(k,) how far along a face others (k, 2, 2) with their normals (k, 2) cross its line; infinite where they do not."""
    slope = normals @ face.along
    slope = np.where(np.abs(slope) < _CORNER_SINE, np.nan, slope)
    place_m = np.einsum("ij,ij->i", ends[:, 0] - face.start, normals) / slope
    crossing = face.start + place_m[:, None] * face.along
    along = ends[:, 1] - ends[:, 0]
    length_m = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
    beside_m = np.einsum("ij,ij->i", crossing - ends[:, 0], along) / length_m
    met = (beside_m > -_CORNER_M) & (beside_m < length_m + _CORNER_M)
    return np.asarray(np.where(met, place_m, np.inf))


def _laid(outline: shapely.Polygon, bounds: Sequence[_Bound], reach_m: float) -> shapely.Polygon:
    """One outline: what lies between it and the faces is added, what lies behind them taken away."""
    before, behind, lines = [], [], []
    for bound in bounds:
        face = bound.face
        for low_m, high_m in _runs(outline, face, reach_m):
            at_end = (low_m < 2 * reach_m, high_m > face.length_m - 2 * reach_m)
            ends_m = np.array([0.0 if at_end[0] else low_m, face.length_m if at_end[1] else high_m])
            # Around the room's inner corners nothing is left behind the faces; around its outer ones nothing before them.
            signs = np.array([-1.0, 1.0])
            lines.append(face.at(ends_m))
            before.append(_strip(face, ends_m + reach_m * signs * (np.array(at_end) & bound.outer), reach_m))
            behind.append(_strip(face, ends_m + reach_m * signs * (np.array(at_end) & bound.inner), -reach_m))
    if not lines:
        return outline
    area = shapely.union_all([outline, *before]).difference(shapely.union_all(behind))
    room = largest(grown(grown(grown(area, _TIDY_M), -2 * _TIDY_M), _TIDY_M))
    if room.area < _KEPT_SHARE * outline.area:
        return outline
    return _without_steps(room, lines, _STEP_SHARE * reach_m)


def _runs(outline: shapely.Polygon, face: Segment, reach_m: float) -> Iterator[tuple[float, float]]:
    """From where to where along a face an outline's edge lies on it: the room is before it and not behind."""
    ends = _ends(face)
    before = outline.intersection(shapely.LineString(ends + reach_m * face.normal))
    behind = outline.intersection(shapely.LineString(ends - reach_m * face.normal))
    along = _projected(before, face).difference(_projected(behind, face))
    for part in shapely.get_parts(along):
        if part.length > _RUN_MIN_M:
            low_m, _, high_m, _ = part.bounds
            yield low_m, high_m


def _projected(lines: BaseGeometry, face: Segment) -> BaseGeometry:
    """Lines along a face as lines along the x axis, from its first end."""
    spans = [face.place_m(shapely.get_coordinates(p)) for p in shapely.get_parts(lines) if p.length > 0]
    return shapely.union_all([shapely.LineString([(s[0], 0.0), (s[-1], 0.0)]) for s in spans])


def _strip(face: Segment, ends_m: FloatArray, depth_m: float) -> shapely.Polygon:
    """The rectangle before a stretch of a face, or behind it where the depth is negative."""
    ends = face.at(ends_m)
    return shapely.Polygon(np.concatenate([ends, ends[::-1] + depth_m * face.normal]))


def _without_steps(area: shapely.Polygon, lines: Sequence[FloatArray], tolerance_m: float) -> shapely.Polygon:
    """The area with the stretches of its outline between faces simplified; what lies on a face stays."""
    on_faces = shapely.union_all(shapely.linestrings(np.array(lines)))
    rings = [_ring_without_steps(ring, on_faces, tolerance_m) for ring in (area.exterior, *area.interiors)]
    simple = shapely.Polygon(rings[0], rings[1:]).simplify(1e-4)
    return simple if simple.is_valid else area


def _ring_without_steps(ring: shapely.LinearRing, on_faces: BaseGeometry, tolerance_m: float) -> FloatArray:
    corners = shapely.get_coordinates(ring)[:-1]
    kept = np.flatnonzero(shapely.distance(shapely.points(corners), on_faces) < _PRECISION_M)
    if len(kept) < 2:
        return np.asarray(shapely.get_coordinates(ring.simplify(tolerance_m)))
    corners = np.roll(corners, -kept[0], axis=0)
    kept = np.append(kept - kept[0], len(corners))
    corners = np.vstack([corners, corners[:1]])
    parts = [
        shapely.get_coordinates(shapely.LineString(corners[a : b + 1]).simplify(tolerance_m))[:-1]
        for a, b in pairwise(kept)
    ]
    return np.concatenate(parts)
