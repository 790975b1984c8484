"""The parts of a drawn building that the earlier kinds do not have, and the plan that holds them. Metres, in the plan."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import LEAF_THICKNESS_M, Door, Opening, Plan, Room, Window, segments
from ffmap.loaders.simulator.drawn.ranges import CeilingShape, DoorStyle, LeafPlace, WindowStyle
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Spot

UPRIGHT_DEG = 30.0
"""What leans by more than this is a ceiling: one cannot stand a cupboard against it."""

_SLIDE_GAP_M = 0.02  # Between a sliding leaf and the wall that it hangs before


@dataclass(frozen=True)
class Drop:
    """Something that hangs from a ceiling, and is a part of it: a beam, a coffer's ribs, a soffit."""

    area: BaseGeometry
    drop_m: float


@dataclass(frozen=True)
class Well:
    """A hole in a ceiling with sides of a height: a skylight, or a stairwell, whose top is closed."""

    area: shapely.Polygon
    rise_m: float
    glass: Glass | None


@dataclass(frozen=True, eq=False)
class Ceiling:
    """profile: (k, 2) heights (second) at places along the spot's x (first); it runs level along y."""

    shape: CeilingShape
    spot: Spot
    profile: FloatArray
    drops: tuple[Drop, ...] = ()
    wells: tuple[Well, ...] = ()

    @property
    def low_m(self) -> float:
        """The least height under it, drops counted."""
        return float(self.profile[:, 1].min()) - max((drop.drop_m for drop in self.drops), default=0.0)

    @property
    def high_m(self) -> float:
        return float(self.profile[:, 1].max())

    def height(self, places: FloatArray) -> FloatArray:
        """(n,) height over places (n, 2) of the plan, without drops."""
        along = np.array([np.cos(self.spot.yaw), np.sin(self.spot.yaw)])
        across_m = (places - [self.spot.x, self.spot.y]) @ along
        return np.asarray(np.interp(across_m, self.profile[:, 0], self.profile[:, 1]))


@dataclass(frozen=True)
class DrawnRoom(Room):
    """ceiling_m of the room is the least height under its ceiling. round: corners and bays whose walls are round."""

    ceiling: Ceiling
    round: tuple[BaseGeometry, ...]


@dataclass(frozen=True)
class DrawnDoor(Door):
    """place: of a closed leaf in the wall. casing_m: how far it stands out of the wall; glass: of the leaf's pane, if any.

    alike: whether the leaf is finished as the wall is.
    """

    style: DoorStyle
    place: LeafPlace
    casing_m: float
    casing_width_m: float
    glass: Glass | None
    alike: bool = False

    @property
    def design(self) -> str:
        """In words, to count by."""
        pane = "glazed " if self.glass is not None else ""
        place = f", {self.place}" if self.style in ("hinged", "double") else ""
        return f"{pane}{self.style}{place}"

    def leaf_spots(self) -> list[tuple[Spot, tuple[float, float], tuple[float, float]]]:
        half = self.width_m / 2
        match self.style:
            case "opening" | "arch":
                return []
            case "sliding":
                shift = 0.0 if self.closed else self.hinge * (self.width_m + 0.02)
                face = self.depth[1] + _SLIDE_GAP_M
                return [(self.spot, (shift - half - 0.04, shift + half + 0.04), (face, face + LEAF_THICKNESS_M))]
            case "pocket":
                across = (-LEAF_THICKNESS_M / 2, LEAF_THICKNESS_M / 2)
                return [(self.spot, (-half, half), across)] if self.closed else []
        return super().leaf_spots()


@dataclass(frozen=True)
class DrawnWindow(Window):
    """pane_y: of the pane across the wall. mullions: their places along the window. blind: share that it covers, 0 for none."""

    style: WindowStyle
    glass: Glass
    pane_y: float
    frame_m: float
    mullions: tuple[float, ...]
    blind: float
    slats: bool


@dataclass(frozen=True)
class Niche(Opening):
    """A hole that does not go through; its front lies at y = 0."""


@dataclass(frozen=True)
class HalfWall:
    """Built, joined to a wall, and too low to reach the ceiling: a wall, unlike a screen that stands on feet."""

    area: shapely.Polygon
    height_m: float


@dataclass(frozen=True)
class LeaningWall:
    """A wall's inner face from `knee_m` up to `top_m`, the room on the spot's y. lean_deg: from upright, towards the room
    above if positive, away from it if negative (battered).
    """

    spot: Spot
    length_m: float
    knee_m: float
    top_m: float
    lean_deg: float

    @property
    def out_m(self) -> float:
        """How far it stands out at its top, or at its foot."""
        return float(abs(np.tan(np.radians(self.lean_deg)))) * (self.top_m - self.knee_m)

    @property
    def upright(self) -> bool:
        """Whether it is a wall."""
        return abs(self.lean_deg) <= UPRIGHT_DEG

    @property
    def foot(self) -> shapely.Polygon:
        """The floor that it covers; empty where it leans over it."""
        out = self.out_m if self.lean_deg < 0 else 0.0
        return self.spot.rectangle(-self.length_m / 2, self.length_m / 2, 0.0, out)

    @property
    def area(self) -> shapely.Polygon:
        """All of it, in the plan."""
        return self.spot.rectangle(-self.length_m / 2, self.length_m / 2, 0.0, self.out_m)


@dataclass(frozen=True)
class Flight:
    """A straight flight of solid steps that go up along the spot's x, from x = 0 on; y across."""

    spot: Spot
    width_m: float
    steps: int
    riser_m: float
    going_m: float

    @property
    def area(self) -> shapely.Polygon:
        return self.spot.rectangle(0.0, self.steps * self.going_m, 0.0, self.width_m)


@dataclass(frozen=True)
class DrawnPlan(Plan):
    """What else is built. The walls' thickness of the base is that of the corridor's."""

    drawn_rooms: tuple[DrawnRoom, ...]
    drawn_doors: tuple[DrawnDoor, ...]
    drawn_windows: tuple[DrawnWindow, ...]
    niches: tuple[Niche, ...]
    half_walls: tuple[HalfWall, ...]
    leaning: tuple[LeaningWall, ...]
    flights: tuple[Flight, ...]

    @property
    def openings(self) -> list[Opening]:
        return [*self.doors, *self.windows, *self.niches]

    @cached_property
    def obstacles(self) -> BaseGeometry:
        """The floor under what stands in rooms, pillars and platforms apart."""
        built: tuple[HalfWall | LeaningWall | Flight, ...] = (*self.half_walls, *self.leaning, *self.flights)
        return shapely.union_all([part.area for part in built])

    @cached_property
    def free(self) -> BaseGeometry:
        return super().free.difference(self.obstacles)

    def wall_faces(self) -> FloatArray:
        """As the base's, with half-height walls, and leaning ones at their foot."""
        standing = [wall.area for wall in self.half_walls] + [wall.foot for wall in self.leaning if wall.upright]
        solid = self.solid_at(1e-3).union(shapely.union_all([area for area in standing if area.area > 0]))
        exterior = self.footprint.exterior
        ends = [ends for ends in segments(solid) if exterior.distance(shapely.LineString(ends)) > 1e-3]
        return np.array(ends).reshape(-1, 2, 2)


def polygons(geometry: BaseGeometry, least_m2: float = 1e-4) -> list[shapely.Polygon]:
    """The polygons in any geometry, those without an area left out."""
    parts = getattr(geometry, "geoms", [geometry])
    return [part for part in parts if part.geom_type == "Polygon" and part.area > least_m2]
