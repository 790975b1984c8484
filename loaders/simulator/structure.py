"""Build the mesh of a plan: walls, floor, ceilings, doors, windows, built-in parts, and outside."""

from itertools import pairwise

import numpy as np
import shapely

from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import (
    UP,
    MeshBuilder,
    Rng,
    Span,
    Spot,
    Surface,
    draw_surface,
    length_of,
    segments,
    spot_on,
)
from ffmap.loaders.simulator.openings import CASING_WIDTH_M
from ffmap.loaders.simulator.plan import Door, Leaf, Plan, Room, Window

_FAR_M = 60.0
_STILE_M, _RAIL_M = 0.12, 0.25  # Frame of a glazed leaf: sides and top, bottom
_LEVER = Surface(Truth.DOOR, 0.3, 0.8)


def build_structure(plan: Plan, mesh: MeshBuilder, rng: Rng) -> None:
    """Add everything that is built."""
    wall = draw_surface(rng, Truth.WALL, "paint", "paint", "concrete", "wood")
    floor = draw_surface(rng, Truth.FLOOR, "carpet", "wood", "tile", "concrete")
    top = max(room.ceiling.high_m for room in plan.rooms) + 0.05
    levels = {0.0, top, *(z for o in plan.openings for z in (o.bottom_m, o.top_m))}
    for low, high in pairwise(sorted(levels)):
        mesh.prism(plan.solid_at((low + high) / 2), (low, high), wall)
    mesh.slab(plan.footprint, 0.0, floor)
    for room in plan.rooms:
        _build_ceiling(room, mesh, rng)
    for door in plan.doors:
        if plan.sills_m > 0.002:
            sill = draw_surface(rng, Truth.FLOOR, "metal", "wood")
            x = (-door.width_m / 2, door.width_m / 2)
            mesh.box(door.spot, x, (-0.05, 0.05), (0.0, plan.sills_m), sill)
        _build_door(door, mesh, rng)
    for window in plan.windows:
        _build_window(window, mesh, rng)
    for part in plan.parts:
        surface = (floor if part.truth == Truth.FLOOR else wall)._replace(truth=part.truth)
        if part.top is None:
            mesh.prism(part.area, part.z, surface)
        else:
            corners = [
                np.insert(shapely.get_coordinates(area), 2, z, axis=1)
                for area, z in zip((part.area, part.top), part.z, strict=True)
            ]
            mesh.hull(np.concatenate(corners), surface)


def _build_ceiling(room: Room, mesh: MeshBuilder, rng: Rng) -> None:
    """Add a ceiling that extends a little into the walls."""
    surface = draw_surface(rng, Truth.CEILING, "paint", "paint", "wood", "concrete")
    ceiling, area = room.ceiling, room.interior.buffer(0.02, join_style="mitre")
    for (start, _), (end, _) in pairwise(ceiling.profile):
        strip = ceiling.spot.rectangle(start, end, -_FAR_M, _FAR_M)
        mesh.sheet(area.intersection(strip), ceiling.height, surface)
    drop = (ceiling.high_m - ceiling.drop_m, ceiling.high_m)
    mesh.prism(ceiling.drops, drop, surface)


def _build_door(door: Door, mesh: MeshBuilder, rng: Rng) -> None:
    """Add the casing on both faces of the wall, and the leaves."""
    casing = draw_surface(rng, Truth.WALL, "wood", "gloss paint", "paint", "metal")
    if door.casing_m > 0.001:
        for behind in (False, True):
            frame = door.before(CASING_WIDTH_M, door.casing_m, behind)
            jambs = frame.difference(door.before(0.0, door.casing_m + 0.01, behind))
            mesh.prism(jambs, (0.0, door.top_m), casing)
            mesh.prism(frame, (door.top_m, door.top_m + CASING_WIDTH_M), casing)
    truth = Truth.DOOR if door.closed else Truth.OPEN_LEAF
    surface = draw_surface(rng, truth, "wood", "gloss paint", "paint")
    for leaf in door.leaves:
        _build_leaf(door, leaf, mesh, surface)


def _build_leaf(door: Door, leaf: Leaf, mesh: MeshBuilder, surface: Surface) -> None:
    """Add a solid leaf, or a frame with a pane; with a lever on both sides."""
    spot, (x0, x1), y = leaf
    low, high = 0.006, door.top_m
    if door.glass is None:
        mesh.box(spot, (x0, x1), y, (low, high), surface)
    else:
        inner = (x0 + _STILE_M, x1 - _STILE_M)
        for x in ((x0, inner[0]), (inner[1], x1)):
            mesh.box(spot, x, y, (low, high), surface)
        for z in ((low, _RAIL_M), (high - _STILE_M, high)):
            mesh.box(spot, inner, y, z, surface)
        _build_pane(spot, inner, sum(y) / 2, (_RAIL_M, high - _STILE_M), door.glass, mesh)
    for side in ((y[0] - 0.05, y[0]), (y[1], y[1] + 0.05)):
        lever = _LEVER._replace(truth=surface.truth)
        mesh.box(spot, (x1 - 0.17, x1 - 0.05), side, (1.03, 1.05), lever)


def _build_pane(spot: Spot, x: Span, y: float, z: Span, glass: Glass, mesh: MeshBuilder) -> None:
    ends = spot.to_plan([[x[0], y], [x[1], y]])
    mesh.wall(ends[None], z, Surface(Truth.GLASS, 0.1, pane=glass))


def _build_window(window: Window, mesh: MeshBuilder, rng: Rng) -> None:
    """Add a frame with mullions and a pane, and a blind before it."""
    frame = draw_surface(rng, Truth.WALL, "gloss paint", "metal", "wood")
    half, thick, (back, front) = window.width_m / 2, window.frame_m / 2, window.depth
    low, high = window.bottom_m, window.top_m
    y = (max(window.pane_y - 0.035, back), min(window.pane_y + 0.035, front))
    for x in (-half + thick, *window.mullions, half - thick):
        mesh.box(window.spot, (x - thick, x + thick), y, (low, high), frame)
    for z in (low + thick, high - thick):
        mesh.box(window.spot, (-half, half), y, (z - thick, z + thick), frame)
    _build_pane(window.spot, (-half, half), window.pane_y, (low, high), window.glass, mesh)
    if window.blind:
        cloth = draw_surface(rng, Truth.CLUTTER, "fabric", "plastic", "metal")
        drawn = (high - window.blind * (high - low), high - 0.01)
        blind = (y[1] + 0.01, y[1] + 0.014)
        mesh.box(window.spot, (-half + 0.02, half - 0.02), blind, drawn, cloth)


def build_outside(plan: Plan, mesh: MeshBuilder, rng: Rng) -> None:
    """Add the ground, trees and other houses around the building."""
    ground = -float(rng.choice([0.15, rng.uniform(2.5, 4.0)]))
    area = plan.footprint.centroid.buffer(90).difference(plan.footprint)
    mesh.slab(area, ground, Surface(Truth.OUTSIDE, 0.25))
    around = plan.footprint.envelope.buffer(float(rng.uniform(7, 16)), join_style="mitre")
    for edge in segments(around):
        if rng.random() < 0.6:
            spot, half = spot_on(edge, length_of(edge) / 2), float(rng.uniform(6, 14))
            z = (ground, float(rng.uniform(6, 14)))
            mesh.box(spot, (-half, half), (-8.0, 0.0), z, Surface(Truth.OUTSIDE, 0.45))
    ring = plan.footprint.buffer(3.5).exterior
    for along in rng.uniform(0, ring.length, 14):
        root, tall = np.array([*ring.interpolate(along).coords[0], ground]), rng.uniform(3.5, 7.0)
        mesh.tube(root, root + 0.5 * tall * UP, 0.12, Surface(Truth.OUTSIDE, 0.3))
        crown = np.array([1.1, 1.1, 1.4]) * rng.uniform(0.7, 1.2)
        mesh.blob(root + 0.65 * tall * UP, crown, Surface(Truth.OUTSIDE, 0.4))
