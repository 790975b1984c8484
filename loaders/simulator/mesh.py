"""Triangles with a truth class and a material each, put together from simple bodies."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray, UInt8Array

_BOX_FACES = np.array(
    [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7], [4, 5, 6], [4, 6, 7],
     [0, 2, 1], [0, 3, 2]]
)  # fmt: skip

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Material:
    """reflectivity: diffuse, 0 to 1. gloss: what a sheen adds to it at right angles. pane: code of `glass.Glass`."""

    reflectivity: float
    gloss: float = 0.0
    pane: int = 0


Surface = float | Material
"""A material, or the reflectivity of a dull one."""


@dataclass(frozen=True)
class Mesh:
    """triangles: (n, 3, 3) float64, metres; truth: (n,) codes of `Truth`; the others: (n,), see `Material`."""

    triangles: FloatArray
    truth: UInt8Array
    reflectivity: FloatArray
    gloss: FloatArray
    pane: UInt8Array

    def __len__(self) -> int:
        return len(self.triangles)

    def warped(self, warp: Callable[[FloatArray], FloatArray]) -> "Mesh":
        """The same triangles with every vertex (n, 3) moved."""
        return replace(self, triangles=warp(self.triangles.reshape(-1, 3)).reshape(-1, 3, 3))


@dataclass(frozen=True)
class Spot:
    """A place on the floor: its origin in the plan (metres) and the direction of its x axis (radians)."""

    x: float
    y: float
    yaw: float

    def to_plan(self, points: FloatArray) -> FloatArray:
        """Points (n, 2 or 3) of the spot's own frame in the plan's."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        moved = np.array(points, float)
        moved[:, 0] = self.x + c * points[:, 0] - s * points[:, 1]
        moved[:, 1] = self.y + s * points[:, 0] + c * points[:, 1]
        return moved

    def rectangle(self, x0: float, x1: float, y0: float, y1: float) -> shapely.Polygon:
        """A rectangle of the spot's own frame as a polygon of the plan."""
        return shapely.Polygon(self.to_plan(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])))


class MeshBuilder:
    """Collects triangles; lengths in metres, z from the floor."""

    def __init__(self) -> None:
        self._triangles: list[FloatArray] = []
        self._truth: list[UInt8Array] = []
        self._reflectivity: list[FloatArray] = []
        self._gloss: list[FloatArray] = []
        self._pane: list[UInt8Array] = []

    def build(self) -> Mesh:
        return Mesh(
            np.concatenate(self._triangles), np.concatenate(self._truth), np.concatenate(self._reflectivity),
            np.concatenate(self._gloss), np.concatenate(self._pane)
        )  # fmt: skip

    def add(self, triangles: FloatArray, truth: Truth, surface: Surface) -> None:
        """Triangles (n, 3, 3) of one class and one material."""
        material = surface if isinstance(surface, Material) else Material(surface)
        self._triangles.append(np.asarray(triangles, float))
        self._truth.append(np.full(len(triangles), truth, np.uint8))
        self._reflectivity.append(np.full(len(triangles), material.reflectivity))
        self._gloss.append(np.full(len(triangles), material.gloss))
        self._pane.append(np.full(len(triangles), material.pane, np.uint8))

    def box(
        self, spot: Spot, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float],
        truth: Truth, surface: Surface
    ) -> None:  # fmt: skip
        """A box whose sides run along the spot's axes."""
        corners = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
        plan = spot.to_plan(corners)
        vertices = np.concatenate([np.c_[plan, np.full(4, z[0])], np.c_[plan, np.full(4, z[1])]])
        self.add(vertices[_BOX_FACES], truth, surface)

    def wall(self, ends: FloatArray, z: tuple[float, float], truth: Truth, surface: Surface) -> None:
        """Vertical rectangles over segments `ends` (n, 2, 2)."""
        a0, b0 = (np.c_[ends[:, i], np.full(len(ends), z[0])] for i in (0, 1))
        a1, b1 = a0 + (z[1] - z[0]) * UP, b0 + (z[1] - z[0]) * UP
        self.add(np.concatenate([np.stack([a0, b0, b1], 1), np.stack([a0, b1, a1], 1)]), truth, surface)

    def slab(self, area: BaseGeometry, z: float, truth: Truth, surface: Surface) -> None:
        """A horizontal polygon."""
        self.sheet(area, lambda places: np.full(len(places), z), truth, surface)

    def sheet(
        self, area: BaseGeometry, height: Callable[[FloatArray], FloatArray], truth: Truth, surface: Surface
    ) -> None:
        """A polygon whose corners (n, 2) lie at heights (n,); nothing where it is empty."""
        parts = [np.array(p.exterior.coords)[:3] for p in shapely.constrained_delaunay_triangles(area).geoms]
        if parts:
            corners = np.concatenate(parts)[:, :2]
            self.add(np.c_[corners, height(corners)].reshape(-1, 3, 3), truth, surface)

    def tube(
        self, start: FloatArray | list[float], end: FloatArray | list[float], radius: float | tuple[float, float], truth: Truth,
        surface: Surface, sides: int = 10
    ) -> None:  # fmt: skip
        """A closed cylinder or truncated cone between two points (3,)."""
        base, top = np.asarray(start, float), np.asarray(end, float)
        axis = (top - base) / np.linalg.norm(top - base)
        u = np.cross(axis, [1.0, 0, 0] if abs(axis[0]) < 0.9 else [0, 1.0, 0])
        u /= np.linalg.norm(u)
        v = np.cross(axis, u)
        angle = np.arange(sides) * 2 * np.pi / sides
        ring = np.outer(np.cos(angle), u) + np.outer(np.sin(angle), v)
        r0, r1 = radius if isinstance(radius, tuple) else (radius, radius)
        a, b = base + r0 * ring, top + r1 * ring
        a2, b2 = np.roll(a, -1, 0), np.roll(b, -1, 0)
        s, e = np.broadcast_to(base, a.shape), np.broadcast_to(top, a.shape)
        sides_ = [np.stack(t, 1) for t in ((a, a2, b2), (a, b2, b), (s, a2, a), (e, b, b2))]
        self.add(np.concatenate(sides_), truth, surface)

    def blob(
        self, centre: FloatArray, radii: FloatArray, truth: Truth, surface: Surface,
        rng: np.random.Generator | None = None, rows: int = 6, columns: int = 9
    ) -> None:  # fmt: skip
        """An ellipsoid; bumpy with `rng`."""
        theta = np.linspace(0, np.pi, rows + 1)
        phi = np.linspace(0, 2 * np.pi, columns + 1)
        grid = np.stack(
            [np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi)),
             np.outer(np.cos(theta), np.ones_like(phi))], -1
        )  # fmt: skip
        if rng is not None:
            bumps = rng.uniform(0.75, 1.1, grid.shape[:2])
            bumps[:, -1] = bumps[:, 0]
            bumps[[0, -1]] = 1.0
            grid = grid * bumps[..., None]
        points = np.asarray(centre, float) + grid * np.asarray(radii, float)
        a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
        triangles = [np.stack(t, 2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))]
        self.add(np.concatenate(triangles), truth, surface)
