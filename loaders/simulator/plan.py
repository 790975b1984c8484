"""The floor of a building as a plan: rooms, walls with thickness, doors, windows, built-in parts.

Plan frame: metres; the corridor starts at the origin and runs along x; z = 0 is the floor. Rooms
partition the floor by the centre lines of walls. What the rooms leave of the footprint is wall.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Span, Spot, length_of, polygons, segments, spot_on
from ffmap.loaders.simulator.settings import CeilingShape, DoorStyle, LeafPlace

LEAF_M = 0.04
"""Thickness of a door leaf."""
SKIN_M = 0.035
"""From a room's outline to the inner face of an outer wall."""
Leaf = tuple[Spot, Span, Span]
"""A spot at the hinge, and the extent of the leaf along x and y there."""
_CUT_M = 0.001  # Openings extend this far beyond the faces of the wall, for a clean cut
_SLIDE_GAP_M = 0.02  # Between a sliding leaf and its wall


@dataclass(frozen=True, eq=False)
class Ceiling:
    """A ceiling with heights (k, 2: x, z) along the spot's x, level along y.

    drops: area of beams, coffers or a soffit that hang below it by drop_m.
    """

    shape: CeilingShape
    spot: Spot
    profile: FloatArray
    drops: BaseGeometry
    drop_m: float

    @property
    def low_m(self) -> float:
        return float(self.profile[:, 1].min()) - (0.0 if self.drops.is_empty else self.drop_m)

    @property
    def high_m(self) -> float:
        return float(self.profile[:, 1].max())

    def height(self, places: FloatArray) -> FloatArray:
        """Return heights (n,) over places (n, 2) of the plan, without drops."""
        along = np.array([np.cos(self.spot.yaw), np.sin(self.spot.yaw)])
        x = (places - [self.spot.x, self.spot.y]) @ along
        return np.asarray(np.interp(x, *self.profile.T))


@dataclass(frozen=True)
class Room:
    """outline: polygon up to the centre lines of walls. interior: up to their faces."""

    name: str
    outline: shapely.Polygon
    interior: shapely.Polygon
    ceiling: Ceiling

    @property
    def ceiling_m(self) -> float:
        return self.ceiling.low_m


@dataclass(frozen=True)
class Part:
    """A built-in part: a prism over `area`, or the hull of `area` and, above it, `top`."""

    name: str
    truth: Truth
    area: shapely.Polygon
    z: Span
    top: shapely.Polygon | None = None

    @property
    def shadow(self) -> shapely.Polygon:
        """All of it in the plan."""
        return self.area if self.top is None else self.area.union(self.top).convex_hull


@dataclass(frozen=True)
class Opening:
    """A cut through a wall. spot: middle of the sill, x along the wall, y towards the front.

    depth: y of both faces.
    """

    spot: Spot
    width_m: float
    bottom_m: float
    top_m: float
    depth: Span

    @cached_property
    def area(self) -> shapely.Polygon:
        """The cut in the plan."""
        half = self.width_m / 2
        return self.spot.rectangle(-half, half, self.depth[0] - _CUT_M, self.depth[1] + _CUT_M)

    @property
    def sill(self) -> shapely.LineString:
        ends = self.spot.to_plan([[-self.width_m / 2, 0.0], [self.width_m / 2, 0.0]])
        return shapely.LineString(ends)

    def before(self, margin_m: float, out_m: float, behind: bool = False) -> shapely.Polygon:
        """Return the floor in front of the opening, or behind it, wider by a margin."""
        half, (back, front) = self.width_m / 2 + margin_m, self.depth
        y = (back - out_m, back) if behind else (front, front + out_m)
        return self.spot.rectangle(-half, half, *y)


@dataclass(frozen=True)
class Door(Opening):
    """rooms: in front and behind, as indices. angle_deg: 0 closed, 90 open, 170 at the wall.

    recess_m: depth of a closed leaf behind the front face. hinge: -1 or 1, side of a single leaf.
    """

    rooms: tuple[int, int]
    style: DoorStyle
    place: LeafPlace
    recess_m: float
    casing_m: float
    glass: Glass | None
    hinge: int
    angle_deg: float = 0.0

    @property
    def closed(self) -> bool:
        return self.angle_deg == 0

    @property
    def passable(self) -> bool:
        return self.angle_deg >= 80

    @property
    def design(self) -> str:
        place = f", {self.place}" if self.style in ("hinged", "double") else ""
        return f"{'glazed ' if self.glass else ''}{self.style}{place}"

    @cached_property
    def leaves(self) -> list[Leaf]:
        half, back, front = self.width_m / 2, *self.depth
        if self.style == "opening":
            return []
        if self.style == "sliding":
            shift = 0.0 if self.closed else self.hinge * (self.width_m + 0.02)
            y = (front + _SLIDE_GAP_M, front + _SLIDE_GAP_M + LEAF_M)
            return [(self.spot, (shift - half - 0.04, shift + half + 0.04), y)]
        hinges = (-1, 1) if self.style == "double" else (self.hinge,)
        depth = front - self.recess_m - LEAF_M if self.closed else back
        found: list[Leaf] = []
        for hinge in hinges:
            turn = np.radians(-self.angle_deg if hinge < 0 else 180.0 + self.angle_deg)
            y = (0.0, LEAF_M) if hinge < 0 else (-LEAF_M, 0.0)
            spot = self.spot.moved(hinge * half, depth, float(turn))
            found.append((spot, (0.0, self.width_m / len(hinges)), y))
        return found

    @property
    def leaf_areas(self) -> list[shapely.Polygon]:
        return [spot.rectangle(*x, *y) for spot, x, y in self.leaves]


@dataclass(frozen=True)
class Window(Opening):
    """pane_y: place of the pane across the wall. blind: share that a blind covers."""

    style: str
    glass: Glass
    pane_y: float
    frame_m: float
    mullions: tuple[float, ...]
    blind: float


@dataclass(frozen=True)
class Plan:
    """rooms: the corridor first, named by its centre line (n, 2). outer_m: of the outer walls."""

    rooms: tuple[Room, ...]
    doors: tuple[Door, ...]
    windows: tuple[Window, ...]
    corridor: FloatArray
    outer_m: float
    sills_m: float
    niches: tuple[Opening, ...] = ()
    parts: tuple[Part, ...] = ()

    @cached_property
    def footprint(self) -> shapely.Polygon:
        grown = [room.outline.buffer(1e-4, join_style="mitre") for room in self.rooms]
        joined = shapely.union_all(grown).buffer(self.outer_m - SKIN_M, join_style="mitre")
        return shapely.Polygon(joined.exterior)

    @cached_property
    def solid(self) -> BaseGeometry:
        """Walls without openings."""
        return self.footprint.difference(shapely.union_all([room.interior for room in self.rooms]))

    @property
    def openings(self) -> list[Opening]:
        return [*self.doors, *self.windows, *self.niches]

    def solid_at(self, z: float) -> BaseGeometry:
        """Return the walls at a height, openings cut out."""
        cuts = [opening.area for opening in self.openings if opening.bottom_m < z < opening.top_m]
        return self.solid.difference(shapely.union_all(cuts))

    @cached_property
    def free(self) -> BaseGeometry:
        """The floor where a robot may be: rooms and open doorways without leaves and parts."""
        rooms = [room.interior for room in self.rooms]
        doorways = [door.area for door in self.doors if door.passable]
        leaves = [area for door in self.doors for area in door.leaf_areas]
        parts = [part.shadow for part in self.parts]
        free = shapely.union_all(rooms + doorways).difference(shapely.union_all(leaves + parts))
        return shapely.union_all(polygons(free))

    def wall_faces(self) -> FloatArray:
        """Return the segments (n, 2, 2) of all faces that reach the floor indoors, with jambs."""
        parts = [part.area for part in self.parts if part.truth == Truth.WALL and part.z[0] == 0]
        solid = self.solid_at(1e-3).union(shapely.union_all(parts))
        outside = self.footprint.exterior
        faces = [e for e in segments(solid) if outside.distance(shapely.LineString(e)) > 1e-3]
        return np.array(faces).reshape(-1, 2, 2)


def shared_walls(front: shapely.Polygon, back: shapely.Polygon) -> list[FloatArray]:
    """Return the stretches (2, 2) where two outlines meet, the longest first, front on the left."""
    return _oriented(front.boundary.intersection(back.boundary), front)


def facades(room: Room, rooms: Sequence[Room]) -> list[FloatArray]:
    """Return the stretches (2, 2) of an outline that touch no other room, the room on the left."""
    others = shapely.union_all([other.outline for other in rooms if other is not room])
    return _oriented(room.outline.boundary.difference(others.buffer(1e-4)), room.outline)


def _oriented(lines: BaseGeometry, left: shapely.Polygon) -> list[FloatArray]:
    parts = [part for part in getattr(lines, "geoms", [lines]) if part.length > 1e-3]
    merged = shapely.line_merge(shapely.MultiLineString(parts)).simplify(1e-4)
    found = []
    for line in getattr(merged, "geoms", [merged]):
        for ends in map(np.array, pairwise(line.coords)):
            beside = spot_on(ends, length_of(ends) / 2).to_plan([[0.0, 0.02]])
            found.append(ends if left.contains(shapely.Point(beside[0])) else ends[::-1])
    return sorted(found, key=length_of, reverse=True)
