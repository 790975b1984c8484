"""Draw doors and windows on straight, free stretches of wall."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Rng, Span, Spot, length_of, spot_on
from ffmap.loaders.simulator.plan import (
    LEAF_M,
    SKIN_M,
    Door,
    Opening,
    Room,
    Window,
    facades,
    shared_walls,
)
from ffmap.loaders.simulator.settings import LeafPlace, SimulationSettings, choose, draw

CASING_WIDTH_M = 0.07
_CONNECTED_SHARE = 0.2  # Of the walls between rooms, those with a door
_LARGE_M2 = 30.0  # Rooms from this area on have up to two doors to the corridor
_END_M = 0.4  # Façade beside a ribbon window or curtain wall
_TRIES = 5


class _Look(NamedTuple):
    """What most doors of a building have in common."""

    head_m: float
    casing_m: float
    place: LeafPlace


def draw_doors(rooms: Sequence[Room], settings: SimulationSettings, rng: Rng) -> list[Door]:
    """Draw doors from every room to the corridor, and some between rooms."""
    walls = []
    for a, b in combinations(range(len(rooms)), 2):
        shared = shared_walls(rooms[a].outline, rooms[b].outline)
        if a == 0:
            walls += [(a, b, ends) for ends in shared[: 1 + (rooms[b].interior.area > _LARGE_M2)]]
        elif shared and rng.random() < _CONNECTED_SHARE:
            walls.append((a, b, shared[0]))
    usual = _draw_look(settings, rng)
    doors: list[Door] = []
    for a, b, ends in walls:
        for _ in range(_TRIES):
            look = usual if rng.random() < 0.5 else _draw_look(settings, rng)
            door = _draw_door(rooms, (a, b), ends, look, settings, rng)
            if door is not None and all(door.area.distance(own.area) > 0.3 for own in doors):
                doors.append(door)
                break
    # The doors of the largest room are the last to be closed: it is worth a visit.
    largest = max(range(1, len(rooms)), key=lambda i: float(rooms[i].interior.area))
    order = sorted(rng.permutation(len(doors)), key=lambda i: doors[i].rooms == (0, largest))
    shut = set(order[: round(len(doors) * settings.closed_share)])
    return [
        door if i in shut and door.style != "opening" else _opened(door, rooms, largest, rng)
        for i, door in enumerate(doors)
    ]


def _draw_look(settings: SimulationSettings, rng: Rng) -> _Look:
    head, casing = draw(settings.door_head_m, rng), draw(settings.casing_m, rng)
    return _Look(head, casing, choose(settings.leaf, rng))


def _draw_door(
    rooms: Sequence[Room], between: tuple[int, int], ends: FloatArray, look: _Look,
    settings: SimulationSettings, rng: Rng
) -> Door | None:  # fmt: skip
    """Draw a closed door on a stretch of wall; return None if it does not fit there."""
    front, back = (rooms[i] for i in between)
    style = choose(settings.door, rng)
    width = draw(settings.door_width_m, rng)
    width *= {"double": 1.7, "opening": 1.4}.get(style, 1.0)
    length, margin = length_of(ends), width / 2 + CASING_WIDTH_M + 0.1
    if length < 2 * margin:
        return None
    spot = spot_on(ends, float(rng.uniform(margin, length - margin)))
    depth = _wall_depth(spot, front, back)
    thick = depth[1] - depth[0]
    recess = {
        "flush": 0.0,
        "middle": (thick - LEAF_M) / 2,
        "recessed": min(draw(settings.recess_m, rng), thick - LEAF_M),
        "flush behind": thick - LEAF_M,
    }[look.place]
    top = min(look.head_m, min(front.ceiling_m, back.ceiling_m) - 0.08)
    glazed = rng.random() < settings.glazed_share and style != "opening"
    door = Door(
        spot, width, 0.0, top, depth, between, style, look.place,
        -0.06 if style == "sliding" else recess, look.casing_m,
        _draw_glass(settings, rng) if glazed else None, int(rng.choice([-1, 1]))
    )  # fmt: skip
    fits = _fits(door, front, 0.1, 0.5) and _fits(door, back, 0.1, 0.5, behind=True)
    return door if fits else None


def _wall_depth(spot: Spot, front: Room, back: Room) -> Span:
    """Return y of both faces of the wall at a spot."""
    probe = shapely.LineString(spot.to_plan([[0.0, -1.0], [0.0, 1.0]]))
    middle = shapely.Point(spot.x, spot.y)
    behind, before = (middle.distance(probe.intersection(r.interior)) for r in (back, front))
    return -float(behind), float(before)


def _fits(
    opening: Opening, room: Room, margin_m: float, out_m: float, behind: bool = False
) -> bool:
    """Return whether the wall at an opening is straight and free of other walls."""
    floor = opening.before(margin_m, out_m, behind)
    return bool(room.interior.buffer(0.005).contains(floor))


def _draw_glass(settings: SimulationSettings, rng: Rng) -> Glass:
    return Glass[choose(settings.glass, rng).upper()]


def _opened(door: Door, rooms: Sequence[Room], largest: int, rng: Rng) -> Door:
    """Open a door wide, half or against the wall, whichever there is space for."""
    kind = str(rng.choice(["wide", "half", "wall"], p=[0.6, 0.2, 0.2]))
    kind = "wide" if door.rooms[1] == largest else kind
    angle = float(rng.uniform(*{"wide": (82, 100), "half": (15, 60), "wall": (165, 175)}[kind]))
    angles, into = [angle, 90.0, 30.0], rooms[door.rooms[1]]
    if door.style in ("sliding", "opening"):
        angles, into = [90.0], rooms[door.rooms[0]]
    swept = into.interior.union(door.area).buffer(1e-3)
    for angle_deg in angles:
        for hinge in (door.hinge, -door.hinge):
            opened = replace(door, angle_deg=angle_deg, hinge=hinge)
            if all(swept.contains(area) for area in opened.leaf_areas):
                return opened
    return door


def draw_windows(
    rooms: Sequence[Room], doors: Sequence[Door], outer_m: float, settings: SimulationSettings,
    rng: Rng
) -> list[Window]:  # fmt: skip
    """Draw windows in facades, mostly alike, and glazed walls between rooms and the corridor."""
    usual, glass = choose(settings.window, rng), _draw_glass(settings, rng)
    windows: list[Window] = []
    for room in rooms:
        for ends in facades(room, rooms):
            style = usual if rng.random() < 0.5 else choose(settings.window, rng)
            sill_m, depth = draw(settings.sill_m, rng), (SKIN_M - outer_m, SKIN_M)
            row = _row(style, ends, (sill_m, room.ceiling_m), depth, glass, rng)
            windows += [window for window in row if _fits(window, room, 0.0, 0.1)]
    doorways = shapely.union_all([door.area.buffer(CASING_WIDTH_M + 0.1) for door in doors])
    corridor = rooms[0]
    for room in rooms[1:]:
        for ends in shared_walls(corridor.outline, room.outline)[:1]:
            if rng.random() < settings.glazed_share:
                free = shapely.LineString(ends).difference(doorways)
                longest = max(getattr(free, "geoms", [free]), key=lambda part: part.length)
                depth = _wall_depth(spot_on(ends, length_of(ends) / 2), corridor, room)
                style, glass = choose(settings.window, rng), _draw_glass(settings, rng)
                z = (draw(settings.sill_m, rng), min(room.ceiling_m, corridor.ceiling_m))
                row = _row(style, np.array(longest.coords), z, depth, glass, rng)
                windows += [
                    window for window in row
                    if _fits(window, corridor, 0.0, 0.1) and _fits(window, room, 0.0, 0.1, True)
                ]  # fmt: skip
    return windows


def _row(
    style: str, ends: FloatArray, z: Span, depth: Span, glass: Glass, rng: Rng
) -> list[Window]:
    """Draw the windows of a stretch of wall, alike but for their blinds. z: sill and ceiling."""
    length = length_of(ends) if len(ends) else 0.0
    pitch, width, count = length, length - 2 * _END_M, 1
    if style == "single":
        pitch = float(rng.uniform(1.5, 3.0))
        width, count = pitch * float(rng.uniform(0.4, 0.85)), int((length - 2 * _END_M) / pitch)
    curtain_wall = style == "curtain wall"
    bottom, top = (0.0, z[1]) if curtain_wall else (z[0], z[1] - float(rng.uniform(0.1, 0.7)))
    if style == "none" or top - bottom < 0.4 or width < 0.4:
        return []
    pane_y = depth[0] + float(rng.uniform(0.2, 0.8)) * (depth[1] - depth[0])
    frame, parts = float(rng.uniform(0.04, 0.12)), max(round(width / rng.uniform(0.6, 1.8)), 1)
    mullions = tuple(np.linspace(-width / 2, width / 2, parts + 1)[1:-1].tolist())
    middles = length / 2 + (np.arange(count) - (count - 1) / 2) * pitch
    blinds = rng.uniform(0.1, 0.9, count) * (rng.random(count) < 0.25)
    return [
        Window(spot_on(ends, middle), width, bottom, top, depth, style, glass, pane_y, frame,
               mullions, blind)
        for middle, blind in zip(middles.tolist(), blinds.tolist(), strict=True)
    ]  # fmt: skip
