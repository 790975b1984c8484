"""Furniture of five kinds (tables, shelves, cupboards, seats, plants), and what hangs in rooms."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator.built_in import spots_at_walls
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
from ffmap.loaders.simulator.plan import Plan, Room

_FULL_HEIGHT_M = 0.05  # A cupboard that ends nearer to the ceiling counts as a full-height cabinet
_GAP_M = 0.08  # Half of the furniture has up to this gap to the wall
_CORRIDOR_SHARE = 0.25  # Density of furniture in the corridor, against rooms
_DARK, _BRIGHT = Surface(Truth.CLUTTER, 0.1), Surface(Truth.CLUTTER, 0.4)


@dataclass(frozen=True)
class _Place:
    """Where a piece is built: its back at y = 0 of the spot, width along x, depth along y (m)."""

    mesh: MeshBuilder
    rng: Rng
    spot: Spot
    width_m: float
    depth_m: float
    room: Room

    def draw(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def surface(self, *materials: str) -> Surface:
        return draw_surface(self.rng, Truth.CLUTTER, *materials)

    def box(self, x: Span, y: Span, z: Span, surface: Surface) -> None:
        self.mesh.box(self.spot, x, y, z, surface)

    def legs(self, depth_m: float, height_m: float, surface: Surface) -> None:
        for x in (-self.width_m / 2 + 0.03, self.width_m / 2 - 0.07):
            for y in (0.03, depth_m - 0.07):
                self.box((x, x + 0.04), (y, y + 0.04), (0.0, height_m), surface)


def _table(at: _Place) -> None:
    """Build a table or a bench, with a drawer, screens and boxes, and a chair before it."""
    w, d, rng, wood = at.width_m / 2, at.depth_m - 0.5, at.rng, at.surface("wood")
    top = float(rng.choice([at.draw(0.71, 0.78), 0.9]))
    at.box((-w, w), (0.0, d), (top - 0.03, top), wood)
    at.legs(d, top - 0.03, wood)
    if rng.random() < 0.6:
        at.box((w - 0.5, w - 0.1), (0.1, d - 0.05), (0.02, top - 0.1), wood)
    for x in rng.uniform(-w + 0.3, w - 0.3, rng.integers(0, 3)):
        at.box((x - 0.27, x + 0.27), (0.2, 0.24), (top + 0.12, top + 0.46), _DARK)
        at.box((x - 0.1, x + 0.1), (0.12, 0.32), (top, top + 0.14), _DARK)
    for x in rng.uniform(-w + 0.2, w - 0.2, rng.integers(0, 3)):
        box = at.surface("plastic", "paper")
        at.box((x - 0.12, x + 0.12), (0.05, 0.3), (top, top + at.draw(0.1, 0.5)), box)
    chair = at.spot.moved(at.draw(-w / 2, w / 2), d - 0.2, float(rng.normal(0, 0.3)))
    _seat(_Place(at.mesh, rng, chair, 0.5, 0.5, at.room))


def _seat(at: _Place) -> None:
    """Build a chair or a sofa, its back at y = depth."""
    w, d, cloth = at.width_m / 2, at.depth_m, at.surface("fabric", "plastic")
    at.box((-w, w), (0.02, d), (0.42, 0.48), cloth)
    at.box((-w, w), (d - 0.06, d), (0.48, at.draw(0.75, 1.1)), cloth)
    at.legs(d, 0.42, _DARK)


def _shelf(at: _Place) -> None:
    """Build boards between two sides, with books."""
    w, d, wood = at.width_m / 2, at.depth_m, at.surface("wood", "metal")
    height = min(at.draw(1.2, 2.15), at.room.ceiling_m - 0.1)
    for x in (-w, w - 0.02):
        at.box((x, x + 0.02), (0.0, d), (0.0, height), wood)
    if at.rng.random() < 0.6:
        at.box((-w, w), (0.0, 0.01), (0.0, height), wood)
    for z in np.linspace(0.05, height - 0.02, int(height / 0.37) + 1).tolist():
        at.box((-w, w), (0.0, d), (z, z + 0.02), wood)
        x = -w + 0.03
        while x < w - 0.28 and z < height - 0.3:
            thick, tall, deep = at.draw(0.03, 0.25), at.draw(0.15, 0.31), at.draw(0.5, 0.95) * d
            if at.rng.random() < 0.75:
                book = at.surface("paper", "plastic")
                at.box((x, x + thick), (0.02, deep), (z + 0.02, z + tall), book)
            x += thick


def _cupboard(at: _Place) -> None:
    """Build a closed box: from a stack of parcels to a wardrobe that reaches the ceiling."""
    w, rng, ceiling = at.width_m / 2, at.rng, at.room.ceiling
    kind = rng.choice(["low", "tall", "full"], p=[0.45, 0.35, 0.2])
    top = at.draw(0.4, 1.3) if kind == "low" else at.draw(1.6, 2.4)
    if kind == "full" and ceiling.shape == "flat":
        top = ceiling.low_m - at.draw(0.003, 0.03)
    top = min(top, ceiling.low_m - 0.003)
    full = ceiling.shape == "flat" and ceiling.low_m - top < _FULL_HEIGHT_M
    truth = Truth.FULL_HEIGHT_CABINET if full else Truth.CLUTTER
    surface = at.surface("wood", "gloss paint", "paint", "plastic")._replace(truth=truth)
    at.box((-w, w), (0.0, at.depth_m), (0.0, top), surface)
    if kind == "low":
        at.box((-0.7 * w, 0.4 * w), (0.05, at.depth_m - 0.05), (top, top + 0.28), surface)


def _plant(at: _Place) -> None:
    """Build a pot, a stem and scattered leaves."""
    rng, reach, count = at.rng, 0.3 * at.width_m, int(at.rng.integers(25, 60))
    foot = np.array([*at.spot.to_plan([[0.0, at.depth_m / 2]])[0], 0.0])
    pot, tall = at.draw(0.25, 0.4), at.draw(0.8, 1.7)
    at.mesh.tube(foot, foot + pot * UP, 0.13, _BRIGHT)
    at.mesh.tube(foot, foot + 0.7 * tall * UP, 0.015, _BRIGHT)
    low, high = [-reach, -reach, pot + 0.1], [reach, reach, tall]
    middle = foot + rng.uniform(low, high, (count, 3))
    at.mesh.add(middle[:, None] + rng.normal(0, 0.05, (count, 3, 3)), at.surface("leaves"))


def _board(at: _Place) -> None:
    """Build a whiteboard, a picture or a mirror on a wall."""
    w, bottom = at.width_m / 2, at.draw(0.8, 1.4)
    z = (bottom, min(bottom + at.draw(0.4, 1.15), at.room.ceiling_m - 0.05))
    if at.rng.random() < 0.1:
        ends = at.spot.to_plan([[-w, 0.02], [w, 0.02]])
        at.mesh.wall(ends[None], z, Surface(Truth.GLASS, 0.1, pane=Glass.MIRROR))
        return
    surface = at.surface("paper", "wood", "plastic")._replace(truth=Truth.BOARD_ON_WALL)
    at.box((-w, w), (0.0, float(at.rng.choice([0.002, 0.025, 0.04]))), z, surface)


def _person(at: _Place) -> None:
    """Build a standing person."""
    foot = np.array([*at.spot.to_plan([[0.0, at.depth_m / 2]])[0], 0.0])
    tall, cloth = at.draw(1.58, 1.9), at.surface("fabric")._replace(truth=Truth.PERSON)
    at.mesh.tube(foot, foot + 0.48 * tall * UP, 0.13, cloth)
    at.mesh.blob(foot + 0.65 * tall * UP, [0.2, 0.2, 0.21 * tall], cloth)
    at.mesh.blob(foot + 0.92 * tall * UP, [0.09, 0.09, 0.08 * tall], cloth)


class _Piece(NamedTuple):
    """Ranges of width and depth (m), mean frequency, and the heights (m) that it covers."""

    build: Callable[[_Place], None]
    width_m: Span
    depth_m: Span
    weight: float
    covers_m: Span = (0.0, 1.0)
    at_wall: bool = True


_PIECES = (
    _Piece(_table, (1.2, 2.4), (1.2, 1.3), 6.0),
    _Piece(_table, (1.4, 2.4), (1.2, 1.5), 3.0, at_wall=False),
    _Piece(_shelf, (0.7, 1.2), (0.28, 0.42), 4.0, (0.0, 2.15)),
    _Piece(_cupboard, (0.4, 1.8), (0.35, 0.65), 7.0, (0.0, 2.4)),
    _Piece(_seat, (0.5, 2.0), (0.5, 0.9), 2.0, at_wall=False),
    _Piece(_plant, (0.5, 0.8), (0.5, 0.8), 2.0),
    _Piece(_board, (0.4, 2.4), (0.05, 0.05), 3.0, (0.8, 2.4)),
    _Piece(_person, (0.5, 0.5), (0.5, 0.5), 1.0, at_wall=False),
)
_WEIGHTS = np.array([piece.weight for piece in _PIECES])


def furnish(
    plan: Plan, path: BaseGeometry, clutter: float, mesh: MeshBuilder, rng: Rng
) -> BaseGeometry:
    """Furnish every room, `clutter` from 0 to 1 as dense as it fits; return the floor covered.

    path: area of the plan that stays clear, as doorways, leaves and built-in parts do.
    """
    doorways = [door.before(0.12, 0.3) for door in plan.doors]
    doorways += [door.before(0.12, 0.95, behind=True) for door in plan.doors]
    leaves = [area.buffer(0.03) for door in plan.doors for area in door.leaf_areas]
    parts = [part.shadow.buffer(0.02) for part in plan.parts]
    keep = shapely.union_all([path, *doorways, *leaves, *parts])
    shapely.prepare(keep)
    taken: list[shapely.Polygon] = []
    for room in plan.rooms:
        density = clutter**1.5 * (1.0 if room is not plan.rooms[0] else _CORRIDOR_SHARE)
        tries = round(density * (8 + 10.0 * room.interior.area))
        taken += _fill(room, tries, plan, keep, mesh, rng)
        _hang(room, clutter, mesh, rng)
    return shapely.union_all(taken)


def _fill(
    room: Room, tries: int, plan: Plan, keep: BaseGeometry, mesh: MeshBuilder, rng: Rng
) -> list[shapely.Polygon]:
    """Try pieces at random places; return the floor of those that fit.

    Each room has its own mixture. Nothing at a wall covers an opening.
    """
    weights = _WEIGHTS * rng.gamma(2.0, 0.5, len(_WEIGHTS))
    within = room.interior.buffer(0.005)
    openings = [o for o in plan.openings if o.area.distance(within) < 0.1]
    taken: list[shapely.Polygon] = []
    for index in rng.choice(len(_PIECES), tries, p=weights / weights.sum()):
        piece = _PIECES[index]
        width, depth = float(rng.uniform(*piece.width_m)), float(rng.uniform(*piece.depth_m))
        for spot in spots_at_walls(room, width, 1, rng):
            gap, turn = float(rng.choice([0.0, rng.uniform(0.0, _GAP_M)])), 0.0
            if not piece.at_wall:
                gap, turn = float(rng.uniform(0.1, 4.0)), float(rng.normal(0, 0.05))
            own = spot.moved(0.0, gap, turn)
            area = own.rectangle(-width / 2, width / 2, 0.0, depth)
            hides = any(
                piece.covers_m[1] > o.bottom_m + 0.02
                and piece.covers_m[0] < o.top_m
                and o.area.distance(area) < 0.06 + _GAP_M
                for o in openings
            )
            taken_already = any(other.intersects(area) for other in (keep, *taken))
            if within.contains(area) and not hides and not taken_already:
                piece.build(_Place(mesh, rng, own, width, depth, room))
                taken.append(area)
    return taken


def _hang(room: Room, clutter: float, mesh: MeshBuilder, rng: Rng) -> None:
    """Hang rows of long lamps, and perhaps a duct or a pipe along the longest wall."""
    wall = max(segments(room.interior), key=length_of)
    low, core, centre = room.ceiling.low_m, room.interior.buffer(-0.8), room.interior.centroid
    top = low - float(rng.choice([0.0, 0.0, rng.uniform(0.1, 0.4)]))
    grid = Spot(centre.x, centre.y, spot_on(wall, 0.0).yaw)
    places = np.stack(np.meshgrid(*2 * [np.arange(-12, 13) * 2.2]), -1).reshape(-1, 2)
    for x, y in places[shapely.contains_xy(core, grid.to_plan(places))].tolist():
        lamp = grid.moved(x, y)
        mesh.box(lamp, (-0.6, 0.6), (-0.09, 0.09), (top - 0.07, top), _BRIGHT)
        ceiling = float(room.ceiling.height(lamp.to_plan([[0.0, 0.0]]))[0])
        mesh.box(lamp, (0.0, 0.01), (0.0, 0.01), (top, ceiling), _BRIGHT)
    spot, half = spot_on(wall, length_of(wall) / 2), length_of(wall) / 2 - 0.05
    out, radius = rng.uniform(0.25, 0.5), float(rng.uniform(0.04, 0.16))
    z = low - radius - rng.uniform(0.02, 0.15)
    free = room.interior.contains(spot.rectangle(-half, half, 0.01, out + 0.2))
    if free and rng.random() < 0.4 * (0.3 + clutter):
        ends = spot.to_plan([[-half, out, z], [half, out, z]])
        mesh.tube(ends[0], ends[1], radius, _BRIGHT, sides=int(rng.choice([4, 12])))
