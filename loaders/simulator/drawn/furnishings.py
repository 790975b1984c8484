"""What stands and hangs in drawn buildings beside the furniture of the earlier ones: wardrobes, beds, kitchens, screens,
pictures, mirrors, curtains, lamps. Nothing of it is built, so all of it is clutter, a board, or a full-height cabinet.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator.drawn.elements import DrawnPlan, DrawnRoom, DrawnWindow
from ffmap.loaders.simulator.drawn.materials import draw_material
from ffmap.loaders.simulator.drawn.ranges import Ranges
from ffmap.loaders.simulator.furniture import CABINET, PIECES, Piece, Size, fill_room, hang_duct, hang_lamps, keep_clear
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Material, MeshBuilder, Spot

_FULL_HEIGHT_M = 0.05  # What ends nearer to the ceiling than this is taken for a wall by any who look
_ALL = "office lab meeting corridor store living bed kitchen"


def _wardrobe(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    """Catalogues have 2.01 and 2.36 m; fitted ones reach the ceiling."""
    top = ceiling - 0.003 if ceiling < 3.2 and rng.random() < 0.4 else min(float(rng.uniform(1.9, 2.6)), ceiling - 0.003)
    truth = Truth.FULL_HEIGHT_CABINET if ceiling - top < _FULL_HEIGHT_M else Truth.CLUTTER
    _closet(mesh, spot, size, top, truth, rng)


def _low_wardrobe(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    """Under a ceiling that is not level none reaches it."""
    top = min(float(rng.uniform(1.9, 2.6)), ceiling - _FULL_HEIGHT_M)
    _closet(mesh, spot, size, top, Truth.CLUTTER, rng)


def _closet(mesh: MeshBuilder, spot: Spot, size: Size, top: float, truth: Truth, rng: np.random.Generator) -> None:
    w = size[0] / 2
    mesh.box(spot, (-w, w), (0.0, size[1]), (0.0, top), truth, draw_material(("wood", "gloss paint", "paint"), rng))


def _bed(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, cloth, wood = size[0] / 2, draw_material(("fabric",), rng), draw_material(("wood",), rng)
    mesh.box(spot, (-w, w), (0.05, size[1]), (0.15, 0.32), Truth.CLUTTER, wood)
    mesh.box(spot, (-w + 0.03, w - 0.03), (0.08, size[1] - 0.03), (0.32, float(rng.uniform(0.45, 0.62))), Truth.CLUTTER, cloth)
    mesh.box(spot, (-w, w), (0.0, 0.05), (0.0, float(rng.uniform(0.7, 1.2))), Truth.CLUTTER, wood)


def _kitchen(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    """Base units 0.6 m deep and 0.9 m high; wall units 0.35 m deep from 1.4 m up (EN 1116)."""
    w, front = size[0] / 2, draw_material(("gloss paint", "wood", "plastic"), rng)
    mesh.box(spot, (-w, w), (0.0, size[1]), (0.1, 0.87), Truth.CLUTTER, front)
    mesh.box(spot, (-w, w), (0.0, size[1] + 0.03), (0.87, 0.91), Truth.CLUTTER, draw_material(("wood", "tile"), rng))
    mesh.box(spot, (-w, w), (0.0, 0.35), (1.42, min(float(rng.uniform(2.0, 2.3)), ceiling - 0.003)), Truth.CLUTTER, front)


def _picture(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    """A poster (flat), a framed picture or a pinboard (up to 5 cm)."""
    w, bottom = size[0] / 2, float(rng.uniform(0.9, 1.5))
    out, tall = float(rng.choice([0.002, 0.02, rng.uniform(0.01, 0.05)])), float(rng.uniform(0.4, 1.2))
    surface = draw_material(("paper", "wood", "plastic", "fabric"), rng)
    mesh.box(spot, (-w, w), (0.0, out), (bottom, min(bottom + tall, ceiling - 0.05)), Truth.BOARD_ON_WALL, surface)


def _mirror(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    w, bottom = size[0] / 2, float(rng.uniform(0.1, 1.1))
    ends = spot.to_plan(np.array([[-w, 0.02], [w, 0.02]]))
    mesh.wall(ends[None], (bottom, min(1.9, ceiling - 0.1)), Truth.GLASS, Material(0.1, pane=int(Glass.MIRROR)))


def _screen(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    """An office screen of cloth on feet: it can be carried away."""
    w, y = size[0] / 2, size[1] / 2
    cloth = draw_material(("fabric",), rng)
    mesh.box(spot, (-w, w), (y - 0.02, y + 0.02), (0.1, float(rng.uniform(1.2, 1.8))), Truth.CLUTTER, cloth)
    for x in (-w + 0.1, w - 0.1):
        mesh.box(spot, (x - 0.03, x + 0.03), (0.0, size[1]), (0.0, 0.1), Truth.CLUTTER, Material(0.2, 0.6))


def _floor_lamp(mesh: MeshBuilder, spot: Spot, size: Size, ceiling: float, rng: np.random.Generator) -> None:
    x, y = spot.to_plan(np.array([[0.0, size[1] / 2]]))[0]
    tall = float(rng.uniform(1.4, 1.9))
    mesh.tube([x, y, 0.0], [x, y, 0.03], 0.13, Truth.CLUTTER, 0.3)
    mesh.tube([x, y, 0.03], [x, y, tall], 0.015, Truth.CLUTTER, Material(0.2, 0.6), 6)
    mesh.tube([x, y, tall - 0.25], [x, y, tall], (0.2, 0.13), Truth.CLUTTER, draw_material(("fabric",), rng))


OWN_PIECES: tuple[Piece, ...] = (
    Piece(_wardrobe, (0.5, 2.4), (0.35, 0.66), True, "bed living office store corridor lab", 4, (0.0, 3.2)),
    Piece(_bed, (0.9, 1.8), (2.0, 2.15), True, "bed", 6),
    Piece(_kitchen, (1.2, 3.0), (0.6, 0.6), True, "kitchen", 8, (0.0, 2.3)),
    Piece(_picture, (0.3, 1.6), (0.05, 0.05), True, _ALL, 5, (0.9, 2.4)),
    Piece(_mirror, (0.4, 1.0), (0.05, 0.05), True, "bed living corridor", 1, (0.1, 1.9)),
    Piece(_screen, (0.8, 1.8), (0.4, 0.4), False, "office lab meeting", 3),
    Piece(_floor_lamp, (0.4, 0.4), (0.4, 0.4), True, "living bed office", 1.5),
)
_AS_AT_HOME = {"living": "office meeting", "bed": "office", "kitchen": "meeting store"}


def _at_home(piece: Piece) -> Piece:
    """A piece of the earlier catalogue, in homes too where its rooms have their like there."""
    kinds = piece.kinds.split()
    own = [room for room, like in _AS_AT_HOME.items() if any(kind in kinds for kind in like.split())]
    return replace(piece, kinds=" ".join([*kinds, *own]))


CATALOGUE = (*(_at_home(piece) for piece in PIECES if piece.build is not CABINET.build), *OWN_PIECES)


def furnish_drawn(
    plan: DrawnPlan, path: BaseGeometry, clutter: float, ranges: Ranges, mesh: MeshBuilder, rng: np.random.Generator
) -> BaseGeometry:
    """Furniture, curtains and lamps in every room; returns the floor they cover. path: what must stay clear, in the plan."""
    keep = keep_clear(plan, path).union(plan.obstacles.buffer(0.02))
    taken: list[shapely.Polygon] = []
    for window in plan.drawn_windows:
        if window.style != "curtain wall" and rng.random() < ranges.curtain_share:
            taken += _hang_curtains(window, plan.drawn_rooms, keep, mesh, rng)
    keep = keep.union(shapely.union_all(taken))
    pieces = [replace(p, weight=10 * ranges.picture_share) if p.build is _picture else p for p in CATALOGUE]
    low_pieces = [replace(p, build=_low_wardrobe) if p.build is _wardrobe else p for p in pieces]
    for room in plan.drawn_rooms:
        level = room.ceiling.shape == "flat" and not room.ceiling.drops and not room.ceiling.wells
        taken += fill_room(room, plan, keep, clutter, mesh, rng, pieces if level else low_pieces, ranges.off_wall_m)
        if level:
            hang_lamps(room, mesh, rng)
            hang_duct(room, clutter, mesh, rng)
        else:
            _hang_pendant(room, mesh, rng)
    return shapely.union_all(taken)


def _hang_pendant(room: DrawnRoom, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """A globe on a cord from the highest part of the ceiling."""
    places = np.array(room.interior.bounds[:2]) + rng.random((8, 2)) * np.ptp(np.reshape(room.interior.bounds, (2, 2)), axis=0)
    lit = [place for place in places if room.interior.buffer(-0.6).contains(shapely.Point(place))]
    for place in lit[: max(1, int(room.interior.area / 15))]:
        top = float(room.ceiling.height(place[None])[0])
        if any(drop.area.contains(shapely.Point(place)) for drop in room.ceiling.drops):
            continue
        middle = max(top - float(rng.uniform(0.4, 1.2)), 1.95)
        if middle < top - 0.2 and not any(well.area.contains(shapely.Point(place)) for well in room.ceiling.wells):
            mesh.tube([*place, middle], [*place, top], 0.006, Truth.CLUTTER, 0.2, 4)
            mesh.blob(np.array([*place, middle]), np.full(3, 0.15), Truth.CLUTTER, draw_material(("fabric", "metal"), rng))


def _hang_curtains(
    window: DrawnWindow, rooms: Sequence[DrawnRoom], keep: BaseGeometry, mesh: MeshBuilder, rng: np.random.Generator
) -> list[shapely.Polygon]:
    """Cloth in folds at both sides of a window, from a rail under the ceiling or above the window, behind a valance or not."""
    face, half, cloth = window.depth[1], window.width_m / 2, draw_material(("fabric",), rng)
    room = next((r for r in rooms if r.interior.contains(window.spot.rectangle(-0.02, 0.02, face + 0.05, face + 0.25))), None)
    if room is None:
        return []
    off, drawn = float(rng.uniform(0.06, 0.15)), float(rng.uniform(0.2, 0.5)) * window.width_m
    top = room.ceiling_m - 0.01 if rng.random() < 0.5 else min(window.top_m + 0.15, room.ceiling_m - 0.01)
    bottom = 0.02 if rng.random() < 0.6 else max(window.bottom_m - 0.1, 0.02)
    hung = []
    for x0, x1 in ((-half - 0.1, -half - 0.1 + drawn), (half + 0.1 - drawn, half + 0.1)):
        area = window.spot.rectangle(x0, x1, face + off - 0.05, face + off + 0.05)
        if room.interior.contains(area) and not area.intersects(keep):
            x = np.linspace(x0, x1, max(int((x1 - x0) / 0.03), 4))
            folds = window.spot.to_plan(np.c_[x, face + off + 0.03 * np.sin(2 * np.pi * x / 0.16)])
            mesh.wall(np.stack([folds[:-1], folds[1:]], 1), (bottom, top), Truth.CLUTTER, cloth)
            hung.append(area)
    valance = window.spot.rectangle(-half - 0.15, half + 0.15, face + off + 0.05, face + off + 0.07)
    if hung and rng.random() < 0.4 and room.interior.contains(valance):
        y = (face + off + 0.05, face + off + 0.07)
        mesh.box(window.spot, (-half - 0.15, half + 0.15), y, (top - 0.2, top), Truth.CLUTTER, draw_material(("wood",), rng))
    return hung


