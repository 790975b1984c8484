"""Triangles with a ground-truth class and a surface each, built from prisms, tubes and hulls."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import shapely
import trimesh
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray

Rng = np.random.Generator
Span = tuple[float, float]
UP = np.array([0.0, 0.0, 1.0])
_FACE = np.dtype([("truth", "u1"), ("reflectivity", "f4"), ("gloss", "f4"), ("pane", "u1")])

_MATERIALS: dict[str, tuple[Span, Span]] = {
    "paint": ((0.60, 0.90), (0.0, 0.05)),
    "gloss paint": ((0.45, 0.80), (0.1, 0.5)),
    "wood": ((0.35, 0.70), (0.0, 0.3)),
    "concrete": ((0.25, 0.50), (0.0, 0.0)),
    "tile": ((0.40, 0.75), (0.3, 1.0)),
    "metal": ((0.10, 0.35), (0.6, 1.0)),
    "fabric": ((0.10, 0.70), (0.0, 0.0)),
    "carpet": ((0.06, 0.40), (0.0, 0.0)),
    "plastic": ((0.04, 0.60), (0.0, 0.4)),
    "paper": ((0.60, 0.85), (0.0, 0.1)),
    "leaves": ((0.40, 0.60), (0.0, 0.0)),
}
"""Diffuse reflectivity at 0.9 µm and gloss, in the order of spectral libraries (ECOSTRESS)."""


class Surface(NamedTuple):
    """Class, diffuse reflectivity (0 to 1), gloss at normal incidence, code of `glass.Glass`."""

    truth: Truth
    reflectivity: float
    gloss: float = 0.0
    pane: int = 0


def draw_surface(rng: Rng, truth: Truth, *materials: str) -> Surface:
    """Draw the surface of one of the materials."""
    reflectivity, gloss = _MATERIALS[materials[int(rng.integers(len(materials)))]]
    return Surface(truth, float(rng.uniform(*reflectivity)), float(rng.uniform(*gloss)))


@dataclass(frozen=True)
class Spot:
    """A place on the plan: origin (m) and direction of the x axis (rad)."""

    x: float
    y: float
    yaw: float

    def to_plan(self, points: ArrayLike) -> FloatArray:
        """Transform points (n, 2 or 3) of the spot's frame to the plan's."""
        moved = np.array(points, float)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        moved[:, :2] = moved[:, :2] @ np.array([[c, s], [-s, c]]) + [self.x, self.y]
        return moved

    def moved(self, x: float, y: float, turn: float = 0.0) -> "Spot":
        """Return the spot at (x, y) of this one's frame, turned by an angle (rad)."""
        ((px, py),) = self.to_plan([[x, y]])
        return Spot(float(px), float(py), self.yaw + turn)

    def rectangle(self, x0: float, x1: float, y0: float, y1: float) -> shapely.Polygon:
        """Return a rectangle of the spot's frame as a polygon of the plan."""
        return shapely.Polygon(self.to_plan([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))


@dataclass(frozen=True)
class Mesh:
    """Triangles (n, 3, 3) in metres, and their faces (n,): class, reflectivity, gloss, pane."""

    triangles: FloatArray
    faces: np.ndarray

    def warped(self, warp: Callable[[FloatArray], FloatArray]) -> "Mesh":
        """Return the mesh with every vertex (n, 3) moved."""
        return Mesh(warp(self.triangles.reshape(-1, 3)).reshape(-1, 3, 3), self.faces)


class MeshBuilder:
    """Collect triangles; lengths in metres, z from the floor."""

    def __init__(self) -> None:
        self._triangles: list[FloatArray] = []
        self._faces: list[np.ndarray] = []

    def build(self) -> Mesh:
        return Mesh(np.concatenate(self._triangles), np.concatenate(self._faces))

    def add(self, triangles: FloatArray, surface: Surface) -> None:
        """Add triangles (n, 3, 3) of one surface."""
        self._triangles.append(triangles)
        self._faces.append(np.full(len(triangles), np.array(tuple(surface), _FACE)))

    def prism(self, area: BaseGeometry, z: Span, surface: Surface) -> None:
        """Add polygons extruded from z[0] to z[1]."""
        self.wall(np.array(list(segments(area))).reshape(-1, 2, 2), z, surface)
        self.slab(area, z[0], surface)
        self.slab(area, z[1], surface)

    def box(self, spot: Spot, x: Span, y: Span, z: Span, surface: Surface) -> None:
        """Add a box along the spot's axes."""
        self.prism(spot.rectangle(*x, *y), z, surface)

    def wall(self, ends: FloatArray, z: Span, surface: Surface) -> None:
        """Add vertical rectangles over segments (n, 2, 2)."""
        (a0, b0), (a1, b1) = (np.insert(ends, 2, height, axis=2).swapaxes(0, 1) for height in z)
        self.add(np.concatenate([np.stack([a0, b0, b1], 1), np.stack([a0, b1, a1], 1)]), surface)

    def slab(self, area: BaseGeometry, z: float, surface: Surface) -> None:
        """Add horizontal polygons."""
        self.sheet(area, lambda places: np.full(len(places), z), surface)

    def sheet(
        self, area: BaseGeometry, height: Callable[[FloatArray], FloatArray], surface: Surface
    ) -> None:
        """Add polygons whose corners (n, 2) are at heights (n,)."""
        triangles = shapely.constrained_delaunay_triangles(area)
        corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3].reshape(-1, 2)
        self.add(np.c_[corners, height(corners)].reshape(-1, 3, 3), surface)

    def tube(
        self, start: ArrayLike, end: ArrayLike, radius_m: float, surface: Surface, sides: int = 8
    ) -> None:
        """Add a cylinder between two points (3,)."""
        body = trimesh.creation.cylinder(radius_m, segment=np.array([start, end]), sections=sides)
        self.add(body.triangles, surface)

    def blob(self, centre: ArrayLike, radii: ArrayLike, surface: Surface) -> None:
        """Add an ellipsoid."""
        sphere = trimesh.creation.icosphere(subdivisions=1).triangles
        self.add(centre + sphere * np.asarray(radii, float), surface)

    def hull(self, points: FloatArray, surface: Surface) -> None:
        """Add the convex hull of points (n, 3)."""
        self.add(trimesh.convex.convex_hull(points).triangles, surface)


def polygons(geometry: BaseGeometry, least_m2: float = 1e-4) -> list[shapely.Polygon]:
    """Return the polygons in a geometry that are larger than an area."""
    parts = getattr(geometry, "geoms", [geometry])
    return [part for part in parts if part.geom_type == "Polygon" and part.area > least_m2]


def segments(area: BaseGeometry) -> Iterator[FloatArray]:
    """Yield the edges (2, 2) of polygons, their area on the left."""
    for polygon in map(orient, polygons(area, 0.0)):
        for ring in (polygon.exterior, *polygon.interiors):
            yield from (np.array(ends) for ends in pairwise(ring.coords) if ends[0] != ends[1])


def length_of(ends: FloatArray) -> float:
    return float(np.linalg.norm(ends[1] - ends[0]))


def spot_on(ends: FloatArray, along_m: float) -> Spot:
    """Return a spot on a segment (2, 2), its y axis to the segment's left."""
    along = (ends[1] - ends[0]) / length_of(ends)
    x, y = ends[0] + along_m * along
    return Spot(float(x), float(y), float(np.arctan2(along[1], along[0])))
