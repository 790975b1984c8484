"""Doors: which walls have one, how it looks, whether it is open, and its body."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import shapely

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import LEAF_THICKNESS_M, shared_walls, spot_on
from ffmap.loaders.simulator.drawn.elements import DrawnDoor, DrawnRoom
from ffmap.loaders.simulator.drawn.materials import draw_material
from ffmap.loaders.simulator.drawn.ranges import DoorStyle, LeafPlace, Ranges, choose
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Material, MeshBuilder, Spot, Surface
from ffmap.loaders.simulator.plans import hang_door

_ARCH_STEPS = 14
_TRIES = 5


def place_doors(
    rooms: Sequence[DrawnRoom], thickness: Mapping[frozenset[int], float], ranges: Ranges, closed_share: float,
    rng: np.random.Generator
) -> list[DrawnDoor]:  # fmt: skip
    """One or two to the corridor from every room, and some between rooms; all on straight, free stretches of wall."""
    pairs = [(0, i, ends) for i in range(1, len(rooms)) for ends in shared_walls(rooms[0].outline, rooms[i].outline)[:2]]
    pairs += [
        (a, b, shared[0])
        for a, b in combinations(range(1, len(rooms)), 2)
        if (shared := shared_walls(rooms[a].outline, rooms[b].outline)) and rng.random() < ranges.connecting_share
    ]
    usual = _draw_look(ranges, rng)
    doors: list[DrawnDoor] = []
    served: dict[int, int] = {}
    for a, b, ends in pairs:
        most = 2 if rooms[b].interior.area > 30 else 1
        if a == 0 and served.get(b, 0) >= most:
            continue
        for _ in range(_TRIES):
            look = usual if rng.random() < 0.5 else _draw_look(ranges, rng)
            door = _draw_door(rooms[a], rooms[b], ends, thickness[frozenset((a, b))], look, ranges, rng)
            if door is not None and not any(door.area.buffer(0.3).intersects(other.area) for other in doors):
                doors.append(door)
                served[b] = served.get(b, 0) + (a == 0)
                break
    if ranges.alike_share > 0:
        doors = [replace(door, alike=bool(rng.random() < ranges.alike_share)) for door in doors]
    shut = rng.permutation(len(doors)) < round(len(doors) * closed_share)
    return [_hang(door, bool(s), rooms, rng) for door, s in zip(doors, shut, strict=True)]


@dataclass(frozen=True)
class _Look:
    """What most doors of a building have in common. recess_m: of the leaf where it is recessed."""

    head_m: float
    casing_m: float
    casing_width_m: float
    place: LeafPlace
    recess_m: float


def _draw_look(ranges: Ranges, rng: np.random.Generator) -> _Look:
    head, casing, width, recess = (
        float(rng.uniform(*r)) for r in (ranges.door_head_m, ranges.casing_m, ranges.casing_width_m, ranges.recess_m)
    )
    return _Look(head, casing, width, choose(ranges.leaf, rng), recess)


def _draw_door(
    front: DrawnRoom, back: DrawnRoom, ends: FloatArray, thick: float, look: _Look, ranges: Ranges,
    rng: np.random.Generator
) -> DrawnDoor | None:  # fmt: skip
    """A door somewhere on a stretch of wall; None where there is no place for what was drawn."""
    style: DoorStyle = choose(ranges.door, rng)
    wide = style in ("double", "opening", "arch")
    width = float(rng.uniform(*(ranges.double_width_m if wide else ranges.door_width_m)))
    length, margin = float(np.linalg.norm(ends[1] - ends[0])), width / 2 + look.casing_width_m + 0.1
    if length < 2 * margin:
        return None
    spot = spot_on(ends, float(rng.uniform(margin, length - margin)))
    lowest = min(front.ceiling_m, back.ceiling_m)
    reaches = rng.random() < ranges.full_height_share and style != "arch"
    top = lowest if reaches else min(look.head_m, lowest - 0.08)
    place: LeafPlace = "middle" if style == "pocket" else look.place
    deepest = thick - LEAF_THICKNESS_M
    recess = {
        "flush": 0.0, "flush behind": deepest, "middle": deepest / 2,
        "recessed": min(look.recess_m, deepest)
    }[place]  # fmt: skip
    if style == "sliding":
        recess = -0.06
    glazed = rng.random() < ranges.glazed_share and style not in ("opening", "arch")
    door = DrawnDoor(
        spot, width, 0.0, top, (-thick / 2, thick / 2), (front.name, back.name), 0.0, 2 if style == "double" else 1,
        int(rng.choice([-1, 1])), recess, style, place, look.casing_m, look.casing_width_m,
        draw_glass(ranges, rng) if glazed else None
    )  # fmt: skip
    half, face = margin - 0.06, thick / 2
    before, behind = spot.rectangle(-half, half, face, face + 0.5), spot.rectangle(-half, half, -face - 0.5, -face)
    fits = front.interior.buffer(0.005).contains(before) and back.interior.buffer(0.005).contains(behind)
    return door if fits and (style != "pocket" or thick >= 0.1) else None


def draw_glass(ranges: Ranges, rng: np.random.Generator) -> Glass:
    """Of a window or a door."""
    return Glass[choose(ranges.glass, rng).upper()]


def _hang(door: DrawnDoor, closed: bool, rooms: Sequence[DrawnRoom], rng: np.random.Generator) -> DrawnDoor:
    """The door open or closed; what has no leaf is always open."""
    match door.style:
        case "hinged" | "double":
            return hang_door(door, closed, rooms, rng)
        case "sliding" if not closed:
            front = next(room for room in rooms if room.name == door.rooms[0])
            tries = [replace(door, angle_deg=90.0, hinge=hinge) for hinge in (door.hinge, -door.hinge)]
            return next((d for d in tries if _hangs_at_wall(d, front.interior)), door)
    return replace(door, angle_deg=90.0) if not closed or door.style in ("opening", "arch") else door


def _hangs_at_wall(door: DrawnDoor, front: shapely.Polygon) -> bool:
    """Whether a parked sliding leaf hangs in the room, and before the wall for all its length."""
    (spot, x, y), wall = door.leaf_spots()[0], door.depth[1]
    return bool(front.contains(spot.rectangle(*x, *y)) and not front.intersects(spot.rectangle(*x, wall - 0.05, wall - 0.01)))


def build_door(door: DrawnDoor, mesh: MeshBuilder, wall: Surface, rng: np.random.Generator) -> None:
    """Casing, leaves and their levers; of an arch its round head. wall: what leaves are finished as that are like it."""
    surface = draw_material(("wood", "gloss paint", "paint", "metal"), rng)
    if door.casing_m > 0.001:
        _build_casing(door, mesh, surface)
    if door.style == "arch":
        _build_arch(door, mesh, draw_material(("paint",), rng))
    leaf: Surface = draw_material(("wood", "gloss paint", "paint"), rng)
    if door.alike:
        leaf = wall
    truth = Truth.DOOR if door.closed else Truth.OPEN_LEAF
    for spot, x, y in door.leaf_spots():
        _build_leaf(door, spot, x, y, truth, mesh, leaf)


def _build_casing(door: DrawnDoor, mesh: MeshBuilder, surface: Surface) -> None:
    """On both faces of the wall; it is a part of it. No wall is left above a door that reaches the ceiling."""
    half, wide = door.width_m / 2, door.casing_width_m
    for face, out in ((door.depth[1], door.casing_m), (door.depth[0], -door.casing_m)):
        y = (min(face, face + out), max(face, face + out))
        for x in ((-half - wide, -half), (half, half + wide)):
            mesh.box(door.spot, x, y, (0.0, door.top_m), Truth.WALL, surface)
        mesh.box(door.spot, (-half - wide, half + wide), y, (door.top_m, door.top_m + wide), Truth.WALL, surface)


def _build_leaf(
    door: DrawnDoor, spot: Spot, x: tuple[float, float], y: tuple[float, float], truth: Truth, mesh: MeshBuilder,
    surface: Surface
) -> None:  # fmt: skip
    """Solid, or a frame about a pane; with a lever on both sides."""
    z = (0.006, door.top_m)
    if door.glass is None:
        mesh.box(spot, x, y, z, truth, surface)
    else:
        stile, rail = min(0.12, 0.2 * (x[1] - x[0])), 0.25
        for part in ((x[0], x[0] + stile), (x[1] - stile, x[1])):
            mesh.box(spot, part, y, z, truth, surface)
        inner = (x[0] + stile, x[1] - stile)
        for part in ((z[0], rail), (z[1] - stile, z[1])):
            mesh.box(spot, inner, y, part, truth, surface)
        pane = spot.to_plan(np.array([[inner[0], sum(y) / 2], [inner[1], sum(y) / 2]]))
        mesh.wall(pane[None], (rail, z[1] - stile), Truth.GLASS, Material(0.1, pane=int(door.glass)))
    lever = (x[1] - 0.17, x[1] - 0.05)
    for side in ((y[0] - 0.05, y[0]), (y[1], y[1] + 0.05)):
        mesh.box(spot, lever, side, (1.03, 1.05), truth, Material(0.3, 0.8))


def _build_arch(door: DrawnDoor, mesh: MeshBuilder, surface: Surface) -> None:
    """What fills the corners between a round head and the square opening: a part of the wall."""
    half, rise = door.width_m / 2, min(door.width_m / 2, 0.5)
    x = np.linspace(-half, half, _ARCH_STEPS + 1)
    z = door.top_m - rise + rise * np.sqrt(np.maximum(1.0 - (x / half) ** 2, 0.0))
    front, back = (np.c_[door.spot.to_plan(np.c_[x, np.full(len(x), y)]), z] for y in door.depth)
    mesh.add(_strip_between(front, back), Truth.WALL, surface)
    for curve in (front, back):
        mesh.add(_strip_between(curve, np.c_[curve[:, :2], np.full(len(x), door.top_m)]), Truth.WALL, surface)


def _strip_between(one: FloatArray, other: FloatArray) -> FloatArray:
    """Triangles (2 k, 3, 3) between two polylines (k + 1, 3)."""
    a, b, c, d = one[:-1], one[1:], other[1:], other[:-1]
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def doorways(doors: Sequence[DrawnDoor]) -> shapely.Polygon:
    """The walls near doors, where no window fits."""
    return shapely.union_all([door.area.buffer(door.casing_width_m + 0.1) for door in doors])
