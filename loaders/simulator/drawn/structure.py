"""The body of a drawn building: walls, floor, ceilings, doors, windows, and what is built into its rooms."""

import numpy as np

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import edges, lay_floor, raise_walls
from ffmap.loaders.simulator.drawn.ceilings import build_ceiling
from ffmap.loaders.simulator.drawn.doors import build_door
from ffmap.loaders.simulator.drawn.elements import DrawnPlan, HalfWall, LeaningWall
from ffmap.loaders.simulator.drawn.materials import draw_material
from ffmap.loaders.simulator.drawn.stairs import build_flight
from ffmap.loaders.simulator.drawn.windows import build_window
from ffmap.loaders.simulator.mesh import MeshBuilder, Surface


def build_drawn(plan: DrawnPlan, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """Everything that is built."""
    wall = draw_material(("paint", "paint", "concrete", "brick", "wood"), rng)
    raise_walls(plan, max(room.ceiling.high_m for room in plan.drawn_rooms), mesh, wall)
    floor = draw_material(("carpet", "wood", "tile", "concrete"), rng)
    lay_floor(plan, mesh, floor)
    for room in plan.drawn_rooms:
        build_ceiling(room.interior, room.ceiling, mesh, draw_material(("paint", "paint", "wood", "concrete"), rng), wall)
    for door in plan.drawn_doors:
        if plan.sills_m > 0.002:
            half, sill = door.width_m / 2, draw_material(("metal", "wood"), rng)
            mesh.box(door.spot, (-half, half), (-0.05, 0.05), (0.0, plan.sills_m), Truth.FLOOR, sill)
        build_door(door, mesh, wall, rng)
    for window in plan.drawn_windows:
        build_window(window, mesh, rng)
    for half_wall in plan.half_walls:
        _build_half_wall(half_wall, mesh, draw_material(("paint", "wood", "tile"), rng))
    for leaning in plan.leaning:
        _build_leaning(leaning, mesh, wall)
    for flight in plan.flights:
        build_flight(flight, mesh, draw_material(("wood", "concrete"), rng))


def _build_half_wall(wall: HalfWall, mesh: MeshBuilder, surface: Surface) -> None:
    mesh.wall(np.array(edges(wall.area)), (0.0, wall.height_m), Truth.WALL, surface)
    mesh.slab(wall.area, wall.height_m, Truth.WALL, surface)


def _build_leaning(wall: LeaningWall, mesh: MeshBuilder, surface: Surface) -> None:
    """A prism before the wall that it is a part of."""
    half, out = wall.length_m / 2, wall.out_m
    low, high = (0.0, out) if wall.lean_deg > 0 else (out, 0.0)
    corners = np.array([[x, y, z] for x in (-half, half) for y, z in ((low, wall.knee_m), (high, wall.top_m))])
    behind = np.array([[x, 0.0, wall.top_m if low == 0.0 else wall.knee_m] for x in (-half, half)])
    a, b, c, d = wall.spot.to_plan(corners)
    left, right = wall.spot.to_plan(behind)
    triangles: FloatArray = np.array([[a, c, d], [a, d, b], [a, b, left], [c, d, right]])
    mesh.add(triangles, Truth.WALL if wall.upright else Truth.CEILING, surface)


