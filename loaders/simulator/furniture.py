"""What stands, hangs and lies in the rooms, kept clear of the robot's path, of doors and of each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import Plan, Room, edges, spot_on
from ffmap.loaders.simulator.mesh import UP, MeshBuilder, Spot

Size = tuple[float, float]
Build = Callable[[MeshBuilder, Spot, Size, float, np.random.Generator], None]
"""Puts a piece of a width and a depth at a spot, its back at y = 0; the float is the ceiling's height."""


@dataclass(frozen=True)
class Piece:
    """width, depth: ranges in metres. at_wall: stands with its back to a wall. kinds: of rooms. weight: how often.

    height: what it covers above the floor, to keep boards off cupboards and windows off cabinets.
    """

    build: Build
    width: tuple[float, float]
    depth: tuple[float, float]
    at_wall: bool
    kinds: str
    weight: float
    above_m: tuple[float, float] = (0.0, 1.0)


def _desk(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, d = size[0] / 2, min(size[1], 0.8)
    height = float(rng.uniform(0.71, 0.78))
    mesh.box(spot, (-w, w), (0, d), (height - 0.03, height), Truth.CLUTTER, 0.5)
    for x in (-w + 0.03, w - 0.07):
        for y in (0.03, d - 0.07):
            mesh.box(spot, (x, x + 0.04), (y, y + 0.04), (0, height - 0.03), Truth.CLUTTER, 0.4)
    if rng.random() < 0.5:
        mesh.box(spot, (w - 0.5, w - 0.1), (0.1, d - 0.05), (0.02, 0.6), Truth.CLUTTER, 0.5)
    for x in rng.uniform(-w + 0.3, w - 0.3, rng.integers(0, 3)):
        mesh.box(spot, (x - 0.27, x + 0.27), (0.2, 0.24), (height + 0.12, height + 0.46), Truth.CLUTTER, 0.08)
        mesh.box(spot, (x - 0.1, x + 0.1), (0.12, 0.32), (height, height + 0.02), Truth.CLUTTER, 0.1)
        mesh.box(spot, (x - 0.03, x + 0.03), (0.18, 0.2), (height, height + 0.2), Truth.CLUTTER, 0.1)
    if size[1] > 1.1:
        x, y = spot.to_plan(np.array([[rng.uniform(-w / 2, w / 2), d + 0.15]]))[0]
        _chair(mesh, Spot(x, y, spot.yaw + rng.uniform(-0.6, 0.6)), (0.5, 0.5), ceiling, rng)


def _chair(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    dark = float(rng.uniform(0.06, 0.4))
    mesh.box(spot, (-0.23, 0.23), (-0.22, 0.24), (0.42, 0.48), Truth.CLUTTER, dark)
    mesh.box(spot, (-0.22, 0.22), (0.22, 0.27), (0.55, float(rng.uniform(0.85, 1.1))), Truth.CLUTTER, dark)
    mesh.tube([spot.x, spot.y, 0.08], [spot.x, spot.y, 0.44], 0.03, Truth.CLUTTER, 0.3, 6)
    for turn in (0.0, np.pi / 2):
        mesh.box(Spot(spot.x, spot.y, spot.yaw + turn), (-0.27, 0.27), (-0.03, 0.03), (0.04, 0.09), Truth.CLUTTER, 0.15)


def _shelf(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, d = size[0] / 2, size[1]
    height = float(rng.uniform(1.5, 2.15))
    for x in (-w, w - 0.02):
        mesh.box(spot, (x, x + 0.02), (0, d), (0, height), Truth.CLUTTER, 0.5)
    if rng.random() < 0.6:
        mesh.box(spot, (-w, w), (0, 0.01), (0, height), Truth.CLUTTER, 0.5)
    for z in np.linspace(0.05, height - 0.02, int(height / 0.37) + 1):
        mesh.box(spot, (-w, w), (0, d), (z, z + 0.02), Truth.CLUTTER, 0.5)
        x = -w + 0.03
        while x < w - 0.1 and z < height - 0.3:
            thick, tall = rng.uniform(0.03, 0.25), rng.uniform(0.15, 0.31)
            if rng.random() < 0.75 and x + thick < w - 0.03:
                back = (0.02, float(rng.uniform(0.5, 0.95)) * d)
                mesh.box(spot, (x, x + thick), back, (z + 0.02, z + tall), Truth.CLUTTER, rng.uniform(0.1, 0.8))
            x += thick


def _cupboard(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w = size[0] / 2
    height = float(rng.choice([rng.uniform(0.7, 1.3), rng.uniform(1.7, 2.1)]))
    mesh.box(spot, (-w, w), (0.01, size[1]), (0.02, height), Truth.CLUTTER, rng.uniform(0.3, 0.7))
    if rng.random() < 0.6:
        mesh.box(spot, (-w * 0.6, w * 0.5), (0.08, size[1] * 0.8), (height, height + 0.28), Truth.CLUTTER, 0.5)


def _cabinet(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w = size[0] / 2
    top = ceiling - float(rng.choice([0.0, rng.uniform(0.0, 0.03)]))
    mesh.box(spot, (-w, w), (0.0, size[1]), (0, top), Truth.FULL_HEIGHT_CABINET, rng.uniform(0.4, 0.7))


def _board(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, bottom = size[0] / 2, float(rng.uniform(0.8, 1.0))
    mesh.box(spot, (-w, w), (0.0, 0.025), (bottom, bottom + 1.15), Truth.BOARD_ON_WALL, 0.85)


def _radiator(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w = size[0] / 2
    mesh.box(spot, (-w, w), (0.04, 0.12), (0.12, 0.68), Truth.CLUTTER, 0.7)


def _sofa(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, d, cloth = size[0] / 2, size[1], float(rng.uniform(0.1, 0.5))
    mesh.box(spot, (-w, w), (0.03, d), (0.08, 0.42), Truth.CLUTTER, cloth)
    mesh.box(spot, (-w, w), (0.03, 0.25), (0.42, 0.8), Truth.CLUTTER, cloth)
    for x in (-w, w - 0.15):
        mesh.box(spot, (x, x + 0.15), (0.03, d), (0.42, 0.6), Truth.CLUTTER, cloth)


def _plant(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    x, y = spot.to_plan(np.array([[0.0, size[1] / 2]]))[0]
    r, pot, tall = min(size) / 2, float(rng.uniform(0.25, 0.4)), float(rng.uniform(0.8, 1.7))
    mesh.tube([x, y, 0], [x, y, pot], (0.1, 0.15), Truth.CLUTTER, 0.4, 8)
    mesh.tube([x, y, pot], [x, y, tall * 0.7], 0.015, Truth.CLUTTER, 0.3, 5)
    count = int(rng.integers(25, 60))
    base = np.array([x, y, 0]) + np.stack(
        [*(rng.normal(0, r * 0.35, (2, count))), rng.uniform(pot + 0.1, tall, count)], 1
    )
    base[:, :2] = np.clip(base[:, :2], [x - r * 0.8, y - r * 0.8], [x + r * 0.8, y + r * 0.8])
    mesh.add(base[:, None] + rng.normal(0, 0.05, (count, 3, 3)), Truth.CLUTTER, 0.5)


def _boxes(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, z = size[0] / 2, 0.0
    for _ in range(rng.integers(1, 5)):
        inset, height = rng.uniform(0, 0.08, 2), float(rng.uniform(0.2, 0.42))
        mesh.box(spot, (-w + inset[0], w - inset[1]), (0.02, size[1] - 0.02), (z, z + height), Truth.CLUTTER, 0.4)
        z += height


def _table(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, d = size[0] / 2 - 0.45, size[1] - 0.9
    mesh.box(spot, (-w, w), (0.45, 0.45 + d), (0.71, 0.74), Truth.CLUTTER, 0.5)
    for x in (-w + 0.1, w - 0.16):
        for y in (0.55, d + 0.29):
            mesh.box(spot, (x, x + 0.06), (y, y + 0.06), (0, 0.71), Truth.CLUTTER, 0.4)
    for x in np.arange(-w + 0.4, w - 0.2, 0.7):
        for y, turn in ((0.35, np.pi), (d + 0.55, 0.0)):
            if rng.random() < 0.8:
                a, b = spot.to_plan(np.array([[x, y]]))[0]
                _chair(mesh, Spot(a, b, spot.yaw + turn + rng.uniform(-0.4, 0.4)), (0.5, 0.5), ceiling, rng)


def _bench(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, d = size[0] / 2, size[1]
    mesh.box(spot, (-w, w), (0, d), (0.86, 0.9), Truth.CLUTTER, 0.45)
    for x in np.linspace(-w + 0.05, w - 0.55, 3):
        mesh.box(spot, (x, x + 0.5), (0.05, d - 0.05), (0.05, 0.86), Truth.CLUTTER, 0.5)
    for x in rng.uniform(-w + 0.2, w - 0.3, rng.integers(1, 5)):
        high = 0.9 + float(rng.uniform(0.15, 0.6))
        mesh.box(spot, (x - 0.15, x + 0.15), (0.1, 0.4), (0.9, high), Truth.CLUTTER, rng.uniform(0.1, 0.6))


def _person(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    x, y = spot.to_plan(np.array([[0.0, size[1] / 2]]))[0]
    tall, cloth = float(rng.uniform(1.58, 1.9)), float(rng.uniform(0.08, 0.5))
    across = np.array([np.cos(spot.yaw), np.sin(spot.yaw), 0])
    middle = np.array([x, y, 0.0])
    for side in (-0.09, 0.09):
        foot = middle + side * across
        mesh.tube(foot, foot + tall * 0.48 * UP, (0.06, 0.085), Truth.PERSON, cloth, 8)
        shoulder = middle + 2.4 * side * across
        mesh.tube(shoulder + tall * 0.45 * UP, shoulder + tall * 0.82 * UP, 0.045, Truth.PERSON, cloth, 6)
    mesh.blob(middle + tall * 0.65 * UP, np.array([0.19, 0.19, tall * 0.21]), Truth.PERSON, cloth)
    mesh.blob(middle + tall * 0.92 * UP, np.array([0.09, 0.09, tall * 0.08]), Truth.PERSON, 0.5)


CABINET = Piece(_cabinet, (0.8, 1.6), (0.4, 0.6), True, "office lab store corridor", 1.5, (0.0, 4.0))
PIECES: tuple[Piece, ...] = (
    Piece(_desk, (1.2, 1.8), (1.2, 1.3), True, "office lab meeting", 5),
    Piece(_desk, (1.4, 1.8), (1.2, 1.3), False, "office lab", 2),
    Piece(_shelf, (0.7, 1.2), (0.28, 0.42), True, "office lab store meeting", 4, (0.0, 2.2)),
    Piece(_cupboard, (0.7, 1.2), (0.38, 0.5), True, "office lab store corridor", 3, (0.0, 2.2)),
    CABINET,
    Piece(_board, (1.2, 2.4), (0.03, 0.03), True, "office lab meeting corridor", 2, (0.8, 2.2)),
    Piece(_radiator, (0.8, 1.4), (0.13, 0.13), True, "office meeting corridor", 1, (0.0, 0.7)),
    Piece(_sofa, (1.4, 2.0), (0.8, 0.9), True, "office meeting", 0.7),
    Piece(_plant, (0.5, 0.8), (0.5, 0.8), True, "office meeting corridor lab", 2),
    Piece(_boxes, (0.35, 0.6), (0.35, 0.45), True, "office store lab corridor", 2),
    Piece(_table, (2.4, 3.2), (1.9, 2.1), False, "meeting", 3),
    Piece(_bench, (1.6, 2.6), (0.7, 0.8), True, "lab store", 4),
    Piece(_bench, (1.6, 2.6), (0.8, 1.2), False, "lab", 3),
    Piece(_chair, (0.6, 0.6), (0.6, 0.6), False, "office lab meeting store", 2),
    Piece(_person, (0.5, 0.5), (0.5, 0.5), False, "office lab meeting corridor", 1),
)


def furnish(
    plan: Plan, path: BaseGeometry, clutter: float, mesh: MeshBuilder, rng: np.random.Generator
) -> BaseGeometry:
    """Furniture in every room, `clutter` from 0 to 1 as dense as it fits; returns the floor it covers.

    path: what must stay clear, in the plan.
    """
    keep = keep_clear(plan, path)
    taken = []
    for room in plan.rooms:
        taken += fill_room(room, plan, keep, clutter, mesh, rng)
        hang_lamps(room, mesh, rng)
        hang_duct(room, clutter, mesh, rng)
    return shapely.union_all(taken)


def keep_clear(plan: Plan, path: BaseGeometry) -> BaseGeometry:
    """Where nothing may stand: on the path, before doors and at what is built."""
    doorways = [door.spot.rectangle(-d, d, door.depth[0] - 0.95, door.depth[1] + 0.3)
                for door in plan.doors if (d := door.width_m / 2 + 0.12)]  # fmt: skip
    leaves = [leaf.buffer(0.03) for door in plan.doors for leaf in door.leaf_areas()]
    keep = shapely.union_all([path, *doorways, *leaves, *(c.buffer(0.02) for c in plan.columns)])
    if plan.podium is not None:
        keep = keep.union(plan.podium.buffer(0.02))
    return keep


def fill_room(
    room: Room, plan: Plan, keep: BaseGeometry, clutter: float, mesh: MeshBuilder, rng: np.random.Generator,
    catalogue: Sequence[Piece] = PIECES, off_m: tuple[float, float] = (0.0, 0.05)
) -> list[shapely.Polygon]:  # fmt: skip
    """Pieces of a catalogue, put where they fit; returns the floor that each covers. off_m: how far half of them stand
    off their wall, the others touch it.
    """
    density = 0.25 if room.kind == "corridor" else 1.0
    tries = round(clutter**1.5 * density * (8 + 10.0 * room.interior.area))
    pieces = [piece for piece in catalogue if room.kind in piece.kinds]
    weights = np.array([piece.weight for piece in pieces])
    within = room.interior.buffer(0.005)
    openings = [(o.area.buffer(0.06), o.bottom_m, o.top_m) for o in plan.openings if o.area.distance(within) < 0.1]
    walls = edges(room.interior)
    lengths = np.array([np.linalg.norm(wall[1] - wall[0]) for wall in walls])
    placed: list[shapely.Polygon] = []
    for index in rng.choice(len(pieces), tries, p=weights / weights.sum()):
        piece = pieces[index]
        size = (float(rng.uniform(*piece.width)), float(rng.uniform(*piece.depth)))
        spot = _against_wall(walls, lengths, off_m, rng) if piece.at_wall else _in_room(room, walls[0], rng)
        area = spot.rectangle(-size[0] / 2, size[0] / 2, 0.0, size[1])
        others = [other for other in placed if other.intersects(area)]
        if others or not within.contains(area) or area.intersects(keep):
            continue
        covers = [bottom for cut, bottom, top in openings
                  if cut.intersects(area) and piece.above_m[1] > bottom + 0.02 and piece.above_m[0] < top]  # fmt: skip
        if covers and piece.at_wall:
            continue
        piece.build(mesh, spot, size, room.ceiling_m, rng)
        placed.append(area)
    return placed


def _against_wall(
    walls: list[FloatArray], lengths: FloatArray, off_m: tuple[float, float], rng: np.random.Generator
) -> Spot:
    wall = int(rng.choice(len(walls), p=lengths / lengths.sum()))
    spot = spot_on(walls[wall], float(rng.uniform(0, lengths[wall])))
    gap = 0.0 if rng.random() < 0.5 else float(rng.uniform(*off_m))
    x, y = spot.to_plan(np.array([[0.0, gap]]))[0]
    return Spot(x, y, spot.yaw)


def _in_room(room: Room, wall: FloatArray, rng: np.random.Generator) -> Spot:
    x0, y0, x1, y1 = room.interior.bounds
    along = np.arctan2(*(wall[1] - wall[0])[::-1])
    turn = rng.choice([0, 1, 2, 3]) * np.pi / 2 + rng.normal(0, 0.05)
    return Spot(float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1)), float(along + turn))


def hang_lamps(room: Room, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """Rows of long lamps, flush with the ceiling or hung from it."""
    drop = float(rng.choice([0.0, 0.0, rng.uniform(0.1, 0.4)]))
    wall = _longest_wall(room)
    along = float(np.arctan2(*(wall[1] - wall[0])[::-1]))
    top = room.ceiling_m - drop
    for x, y in _grid(room, along, 2.2):
        spot = Spot(x, y, along)
        mesh.box(spot, (-0.6, 0.6), (-0.09, 0.09), (top - 0.07, top), Truth.CLUTTER, 0.6)
        if drop:
            for end in (-0.5, 0.5):
                mesh.box(spot, (end, end + 0.01), (0.0, 0.01), (top, room.ceiling_m), Truth.CLUTTER, 0.4)


def _longest_wall(room: Room) -> FloatArray:
    return max(edges(room.interior), key=lambda ends: float(np.linalg.norm(ends[1] - ends[0])))


def _grid(room: Room, along: float, pitch: float) -> FloatArray:
    """Points (n, 2) on a grid inside a room, at least 0.8 m from its walls."""
    core = room.interior.buffer(-0.8)
    if core.is_empty:
        return np.zeros((0, 2))
    x, y = room.interior.centroid.coords[0]
    steps = np.arange(-12, 13) * pitch
    points = Spot(x, y, along).to_plan(np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2))
    return np.asarray(points[shapely.contains_xy(core, points)])


def hang_duct(room: Room, clutter: float, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """A duct or pipes along a wall under the ceiling."""
    if rng.random() > {"corridor": 0.5, "lab": 0.9, "store": 0.5}.get(room.kind, 0.2) * (0.3 + clutter):
        return
    wall = _longest_wall(room)
    length = float(np.linalg.norm(wall[1] - wall[0]))
    spot = spot_on(wall, length / 2)
    out, half = float(rng.uniform(0.25, 0.5)), length / 2 - 0.05
    if not room.interior.contains(spot.rectangle(-half, half, 0.01, out + 0.2)):
        return
    if rng.random() < 0.5:
        z = room.ceiling_m - float(rng.uniform(0.02, 0.15))
        mesh.box(spot, (-half, half), (out - 0.2, out + 0.15), (z - 0.28, z), Truth.CLUTTER, 0.4)
    else:
        radius = float(rng.uniform(0.04, 0.14))
        ends = spot.to_plan(np.array([[-half, out], [half, out]]))
        z = room.ceiling_m - radius - float(rng.uniform(0.03, 0.15))
        mesh.tube([*ends[0], z], [*ends[1], z], radius, Truth.CLUTTER, 0.4, 12)


def build_outside(plan: Plan, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """The ground, trees and other houses around the building."""
    # GEOS looks for the mitre of two edges in line, finds none, and goes on.
    with np.errstate(invalid="ignore"):
        around = plan.footprint.buffer(rng.uniform(7, 16), join_style="mitre").minimum_rotated_rectangle
    ground = -float(rng.choice([0.15, rng.uniform(2.5, 4.0)]))
    x, y = plan.footprint.centroid.coords[0]
    mesh.slab(shapely.Point(x, y).buffer(90).difference(plan.footprint), ground, Truth.OUTSIDE, 0.25)
    for edge in edges(around):
        if rng.random() < 0.6:
            spot = spot_on(edge, float(np.linalg.norm(edge[1] - edge[0])) / 2)
            half = float(rng.uniform(6, 14))
            mesh.box(spot, (-half, half), (-8.0, 0.0), (ground, float(rng.uniform(6, 14))), Truth.OUTSIDE, 0.45)
    ring = plan.footprint.buffer(3.5).exterior
    for along in rng.uniform(0, ring.length, 14):
        place = np.array([*(ring.interpolate(along).coords[0] + rng.normal(0, 0.5, 2)), ground])
        tall = float(rng.uniform(3.5, 7.0))
        mesh.tube(place, place + tall * 0.5 * UP, 0.12, Truth.OUTSIDE, 0.3, 7)
        crown = np.array([1.1, 1.1, 1.4]) * rng.uniform(0.7, 1.2)
        mesh.blob(place + tall * 0.65 * UP, crown, Truth.OUTSIDE, 0.4, rng, 9, 14)
