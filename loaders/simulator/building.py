"""A floor of a building as a plan: rooms, walls with thickness, doors, windows and columns; and its mesh.

Plan frame: metres, the corridor starts at the origin and runs along x, z = 0 is the floor. Rooms partition the floor by
the walls' centre lines; what the rooms leave of the floor's footprint is wall, so both faces of every wall are real.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry
from shapely.geometry.polygon import orient

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.mesh import MeshBuilder, Spot, Surface

LEAF_THICKNESS_M = 0.04
_CUT_M = 0.001  # Openings reach this far beyond the wall's faces, for a clean cut


RoomKind = Literal["corridor", "office", "meeting", "store", "lab", "living", "bed", "kitchen"]


@dataclass(frozen=True)
class Room:
    """outline: its polygon up to the walls' centre lines; interior: up to their faces."""

    name: str
    kind: RoomKind
    outline: shapely.Polygon
    interior: shapely.Polygon
    ceiling_m: float


@dataclass(frozen=True)
class Opening:
    """A cut through a wall. spot: middle of the sill, x along the wall, y towards the front; depth: y of both faces."""

    spot: Spot
    width_m: float
    bottom_m: float
    top_m: float
    depth: tuple[float, float]

    @cached_property
    def area(self) -> shapely.Polygon:
        """What is cut from the wall, in the plan."""
        half = self.width_m / 2
        return self.spot.rectangle(-half, half, self.depth[0] - _CUT_M, self.depth[1] + _CUT_M)

    @property
    def sill(self) -> FloatArray:
        """(2, 2) the ends of the sill, between the jambs."""
        return self.spot.to_plan(np.array([[-self.width_m / 2, 0.0], [self.width_m / 2, 0.0]]))


@dataclass(frozen=True)
class Door(Opening):
    """rooms: in front (the corridor, where there is one) and behind. angle_deg: 0 closed, 90 open, 170 against the
    wall. recess_m: how far a closed leaf stands behind the front face. hinge: -1 or 1, the jamb of a single leaf.
    """

    rooms: tuple[str, str]
    angle_deg: float
    leaves: int
    hinge: int
    recess_m: float

    @property
    def closed(self) -> bool:
        return self.angle_deg == 0

    @property
    def passable(self) -> bool:
        return self.angle_deg >= 80

    def leaf_spots(self) -> list[tuple[Spot, tuple[float, float], tuple[float, float]]]:
        """Each leaf as a spot at its hinge with its extent along x and y there."""
        length = self.width_m / self.leaves
        hinges = (-1, 1) if self.leaves == 2 else (self.hinge,)
        found = []
        for hinge in hinges:
            angle = np.radians(-self.angle_deg if hinge < 0 else 180.0 + self.angle_deg)
            depth = self.depth[1] - self.recess_m - LEAF_THICKNESS_M if self.closed else self.depth[0]
            x, y = self.spot.to_plan(np.array([[hinge * self.width_m / 2, depth]]))[0]
            across = (0.0, LEAF_THICKNESS_M) if hinge < 0 else (-LEAF_THICKNESS_M, 0.0)
            found.append((Spot(float(x), float(y), self.spot.yaw + float(angle)), (0.0, length), across))
        return found

    def leaf_areas(self) -> list[shapely.Polygon]:
        return [spot.rectangle(*x, *y) for spot, x, y in self.leaf_spots()]


@dataclass(frozen=True)
class Window(Opening):
    """A pane in the middle of its opening."""


@dataclass(frozen=True)
class Plan:
    """corridor: (n, 2) its centre line. podium: a raised part of a room's floor. sills_m: height of what lies in doorways."""

    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    windows: tuple[Window, ...]
    columns: tuple[shapely.Polygon, ...]
    wall_thickness_m: float
    outer_thickness_m: float
    corridor: FloatArray
    podium: shapely.Polygon | None
    podium_m: float
    sills_m: float

    @cached_property
    def footprint(self) -> shapely.Polygon:
        grow = self.outer_thickness_m - self.wall_thickness_m / 2
        joined = shapely.union_all([room.outline.buffer(1e-4, join_style="mitre") for room in self.rooms])
        return shapely.Polygon(joined.buffer(grow, join_style="mitre").exterior)

    @cached_property
    def solid(self) -> BaseGeometry:
        """Walls and columns, as if there were no openings."""
        interiors = shapely.union_all([room.interior for room in self.rooms])
        return self.footprint.difference(interiors).union(shapely.union_all(list(self.columns)))

    @property
    def openings(self) -> list[Opening]:
        return [*self.doors, *self.windows]

    def solid_at(self, z: float) -> BaseGeometry:
        """Walls and columns at a height, openings cut out."""
        cuts = [opening.area for opening in self.openings if opening.bottom_m < z < opening.top_m]
        return self.solid.difference(shapely.union_all(cuts))

    @cached_property
    def free(self) -> BaseGeometry:
        """The floor where a robot may be: rooms and doorways, without columns and leaves."""
        rooms = [room.interior for room in self.rooms]
        doorways = [door.area for door in self.doors if door.passable]
        leaves = [area for door in self.doors for area in door.leaf_areas()]
        podium = [self.podium] if self.podium is not None else []
        return shapely.union_all(rooms + doorways).difference(shapely.union_all(leaves + podium + list(self.columns)))

    def wall_faces(self) -> FloatArray:
        """(n, 2, 2) the segments of every wall face that stands on the floor inside, jambs and columns with them."""
        exterior = self.footprint.exterior
        return np.array(
            [ends for ends in segments(self.solid_at(1e-3)) if exterior.distance(shapely.LineString(ends)) > 1e-3]
        )


def segments(area: BaseGeometry) -> Iterator[FloatArray]:
    """The edges (2, 2) of a polygon or of several."""
    for polygon in getattr(area, "geoms", [area]):
        for ring in (polygon.exterior, *polygon.interiors):
            for a, b in pairwise(ring.coords):
                if np.hypot(b[0] - a[0], b[1] - a[1]) > 1e-6:
                    yield np.array([a, b])


def edges(outline: shapely.Polygon) -> list[FloatArray]:
    """The edges (2, 2) of a room, the room on their left."""
    return list(segments(orient(outline)))


def shared_walls(front: shapely.Polygon, back: shapely.Polygon) -> list[FloatArray]:
    """Stretches (2, 2) of wall centre line between two rooms, `front` on their left; the longest first."""
    found = []
    for edge in edges(front):
        origin, along, length = _frame(edge)
        for other in edges(back):
            across = (other - origin) @ np.array([-along[1], along[0]])
            if np.abs(across).max() > 1e-6:
                continue
            start, end = np.sort((other - origin) @ along)
            start, end = max(start, 0.0), min(end, length)
            if end - start > 1e-3:
                found.append(origin + np.outer([start, end], along))
    return sorted(found, key=lambda ends: -float(np.linalg.norm(ends[1] - ends[0])))


def outer_walls(room: Room, rooms: list[Room]) -> list[FloatArray]:
    """Edges (2, 2) of a room that no other room touches, the room on their left."""
    others = [other.outline for other in rooms if other is not room]
    return [
        edge for edge in edges(room.outline)
        if all(shapely.LineString(edge).intersection(o.buffer(1e-6)).length < 1e-3 for o in others)
    ]  # fmt: skip


def spot_on(ends: FloatArray, along_m: float) -> Spot:
    """A spot on a wall's centre line, y towards the room on its left."""
    origin, along, _ = _frame(ends)
    x, y = origin + along_m * along
    return Spot(float(x), float(y), float(np.arctan2(along[1], along[0])))


def _frame(ends: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return ends[0], (ends[1] - ends[0]) / length, length


def build_structure(plan: Plan, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """Walls, columns, lintels, floor, ceilings, leaves and panes."""
    raise_walls(plan, max(room.ceiling_m for room in plan.rooms), mesh, rng.uniform(0.55, 0.8))
    lay_floor(plan, mesh, rng.uniform(0.15, 0.4))
    for room in plan.rooms:
        mesh.slab(room.interior.buffer(0.02, join_style="mitre"), room.ceiling_m, Truth.CEILING, 0.75)
    for door in plan.doors:
        if plan.sills_m:
            half = door.width_m / 2
            mesh.box(door.spot, (-half, half), (-0.05, 0.05), (0.0, plan.sills_m), Truth.FLOOR, 0.4)
        _hang_leaves(door, mesh, rng.uniform(0.25, 0.6))
    for window in plan.windows:
        middle = sum(window.depth) / 2
        half = window.width_m / 2
        ends = window.spot.to_plan(np.array([[-half, middle], [half, middle]]))
        mesh.wall(ends[None], (window.bottom_m, window.top_m), Truth.GLASS, 0.1)


def raise_walls(plan: Plan, ceiling_m: float, mesh: MeshBuilder, surface: Surface) -> None:
    """Walls and columns up to a little above the highest ceiling, with sills, lintels and reveals of their openings."""
    levels = sorted({0.0, ceiling_m + 0.05, *(z for o in plan.openings for z in (o.bottom_m, o.top_m))})
    for low, high in pairwise(levels):
        ends = np.array(list(segments(plan.solid_at((low + high) / 2))))
        mesh.wall(ends, (low, high), Truth.WALL, surface)
    for opening in plan.openings:
        mesh.slab(opening.area, opening.top_m, Truth.WALL, surface)
        if opening.bottom_m > 0:
            mesh.slab(opening.area, opening.bottom_m, Truth.WALL, surface)


def lay_floor(plan: Plan, mesh: MeshBuilder, surface: Surface) -> None:
    """The floor, and the podium that stands on it."""
    mesh.slab(plan.footprint, 0.0, Truth.FLOOR, surface)
    if plan.podium is not None:
        mesh.slab(plan.podium, plan.podium_m, Truth.FLOOR, surface)
        mesh.wall(np.array(edges(plan.podium)), (0.0, plan.podium_m), Truth.FLOOR, surface)


def _hang_leaves(door: Door, mesh: MeshBuilder, reflectivity: float) -> None:
    truth = Truth.DOOR if door.closed else Truth.OPEN_LEAF
    for spot, x, y in door.leaf_spots():
        mesh.box(spot, x, y, (0.006, door.top_m), truth, reflectivity)
        lever = (x[1] - 0.18, x[1] - 0.06)
        for side in ((y[0] - 0.05, y[0]), (y[1], y[1] + 0.05)):
            mesh.box(spot, lever, side, (1.03, 1.05), truth, 0.5)
