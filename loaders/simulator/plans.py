"""Generators of building plans: rooms along a corridor that may bend, with walls at right or at odd angles."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TypeVar

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import (
    Door,
    Plan,
    Room,
    RoomKind,
    Window,
    edges,
    outer_walls,
    shared_walls,
    spot_on,
)
from ffmap.loaders.simulator.mesh import Spot
from ffmap.loaders.simulator.settings import SimulationSettings

_CLEAR_OF_BEND_M = 1.4
DoorT = TypeVar("DoorT", bound=Door)
_JAMB_M = 0.5  # Minimum width of wall beside a doorway, from the neighbouring wall's centre line


@dataclass(frozen=True)
class Outline:
    """The coarse shape of a floor.

    corridor: (n, 2) centre line. width_m: clear width of the corridor. depth_m: of the rooms on its left and right.
    skew_m: how far the walls between rooms lean along the corridor. lab_m: widths of rooms that are labs, left first.
    hall_m: depth of a hall across the corridor's end, 0 for none. room_m: widths of the other rooms, least and most.
    kinds: of rooms, of which each room has one; large: of those over 30 m².
    """

    corridor: FloatArray
    width_m: float
    depth_m: tuple[float, float]
    skew_m: float
    lab_m: tuple[float, ...]
    hall_m: float = 0.0
    room_m: tuple[float, float] = (3.0, 4.4)
    kinds: tuple[RoomKind, ...] = ("office", "office", "office", "meeting", "store")
    large: RoomKind = "lab"


def _office(rng: np.random.Generator) -> Outline:
    length = rng.uniform(18, 23)
    depth = (rng.uniform(4.2, 5.5), rng.uniform(4.2, 5.5))
    return Outline(line_of((length, 0.0)), rng.uniform(1.9, 2.5), depth, 0.0, (rng.uniform(7, 9),))


def _angled(rng: np.random.Generator) -> Outline:
    bends = rng.uniform(22, 48, 2) * rng.choice([-1, 1])
    bends[1] *= rng.choice([-1, 0.4])
    line = line_of((rng.uniform(7, 8.5), 0.0), (rng.uniform(6.5, 8), bends[0]), (rng.uniform(5.5, 7), bends[1]))
    depth = (rng.uniform(4.0, 5.2), rng.uniform(4.0, 5.2))
    return Outline(line, rng.uniform(1.9, 2.6), depth, rng.uniform(0.5, 0.9), (rng.uniform(6, 7),))


def _ell(rng: np.random.Generator) -> Outline:
    line = line_of((rng.uniform(12, 14), 0.0), (rng.uniform(11, 13), 90.0 * rng.choice([-1, 1])))
    depth = (rng.uniform(4.0, 4.8), rng.uniform(4.0, 4.8))
    return Outline(line, rng.uniform(2.0, 2.6), depth, 0.0, (rng.uniform(6, 7),))


def _lab(rng: np.random.Generator) -> Outline:
    depth = (rng.uniform(4.5, 5.5), rng.uniform(4.5, 5.5))
    line = line_of((rng.uniform(11, 14), 0.0))
    return Outline(line, rng.uniform(2.0, 2.8), depth, rng.choice([0.0, 0.5]), (), rng.uniform(8, 11))


def _small(rng: np.random.Generator) -> Outline:
    return Outline(line_of((8.0, 0.0)), 2.1, (4.2, 4.2), 0.0, ())


BUILDINGS: dict[str, Callable[[np.random.Generator], Outline]] = {
    "office": _office,
    "angled": _angled,
    "ell": _ell,
    "lab": _lab,
    "small": _small,
}
"""The plans by name: a straight corridor with offices and a lab, one that bends at odd angles, one that turns a right
angle, one that ends in a hall with columns, and three or four rooms for a demonstration."""


def draw_plan(settings: SimulationSettings, rng: np.random.Generator) -> Plan:
    """The named building of `BUILDINGS`."""
    outline = BUILDINGS[settings.building](rng)
    thickness = settings.wall_thickness_m or float(rng.uniform(0.12, 0.28))
    rooms = _partition(outline, thickness, settings, rng)
    doors = _place_doors(rooms, thickness, settings, rng)
    outer = thickness + float(rng.uniform(0.08, 0.2))
    windows = _place_windows(rooms, doors, thickness, outer, settings, rng)
    columns = _place_columns(rooms, doors, windows, rng)
    podium = _place_podium(rooms, doors) if settings.step_m else None
    return Plan(
        tuple(rooms), tuple(doors), tuple(windows), tuple(columns), thickness, outer, outline.corridor, podium,
        settings.step_m, settings.door_sills_m
    )  # fmt: skip


def line_of(*legs: tuple[float, float]) -> FloatArray:
    """(n, 2) from legs of a length in metres and a turn in degrees before each."""
    points, heading = [np.zeros(2)], 0.0
    for length, turn in legs:
        heading += np.radians(turn)
        points.append(points[-1] + length * np.array([np.cos(heading), np.sin(heading)]))
    return np.array(points)


def _offset(line: FloatArray, left_m: float) -> FloatArray:
    """The line moved to its left, with mitred corners."""
    along = np.diff(line, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = np.stack([-along[:, 1], along[:, 0]], 1)
    before, after = np.vstack([normal[:1], normal]), np.vstack([normal, normal[-1:]])
    mitre = (before + after) / (1 + np.sum(before * after, axis=1))[:, None]
    return np.asarray(line + left_m * mitre)


def _partition(
    outline: Outline, thickness: float, settings: SimulationSettings, rng: np.random.Generator
) -> list[Room]:
    ceiling = settings.ceiling_m or float(rng.uniform(2.55, 3.2))
    lowered = ceiling - (float(rng.uniform(0.1, 0.35)) if ceiling > 2.8 and rng.random() < 0.5 else 0.0)
    areas = divide(outline, thickness, rng)
    return [
        Room(name, kind, area, area.buffer(-thickness / 2, join_style="mitre", mitre_limit=10),
             lowered if kind == "corridor" else ceiling)
        for name, kind, area in areas
    ]  # fmt: skip


def divide(
    outline: Outline, thickness: float, rng: np.random.Generator
) -> list[tuple[str, RoomKind, shapely.Polygon]]:
    """Rooms by name, kind and outline up to the walls' centre lines; the corridor, whose walls have a thickness, first."""
    half = (outline.width_m + thickness) / 2
    line = outline.corridor
    walls = np.vstack([_offset(line, half), _offset(line, -half)[::-1]])
    rooms: list[tuple[str, RoomKind, shapely.Polygon]] = [("corridor", "corridor", shapely.Polygon(walls))]
    labs = [outline.lab_m, ()] if rng.random() < 0.5 else [(), outline.lab_m]
    for side, depth, widths in zip((1, -1), outline.depth_m, labs, strict=True):
        near, far = _offset(line, side * half), _offset(line, side * (half + depth))
        cuts = _cuts(outline, widths, side * (half + depth), rng)
        skews = rng.uniform(-outline.skew_m, outline.skew_m, len(cuts))
        for i in range(len(cuts) - 1):
            inner = _stretch(near, line, cuts[i], cuts[i + 1], 0.0, 0.0)
            outer = _stretch(far, line, cuts[i], cuts[i + 1], skews[i], skews[i + 1])
            area = shapely.Polygon(np.vstack([inner, outer[::-1]]))
            kind = outline.large if area.area > 30 else outline.kinds[int(rng.choice(len(outline.kinds)))]
            rooms.append((f"{kind} {len(rooms)}", kind, area))
    if outline.hall_m:
        ends = np.array([_offset(line, s * (half + d))[-1] for s, d in zip((1, -1), outline.depth_m, strict=True)])
        ahead = outline.hall_m * (line[-1] - line[-2]) / np.linalg.norm(line[-1] - line[-2])
        area = shapely.Polygon(np.vstack([ends, ends[::-1] + ahead]))
        rooms.append((f"{outline.large} {len(rooms)}", outline.large, area))
    return rooms


def _cuts(
    outline: Outline, lab_m: tuple[float, ...], reach_m: float, rng: np.random.Generator
) -> FloatArray:
    """Where walls between rooms meet the corridor, in metres along its centre line; both ends included.

    reach_m: how far the rooms reach from the centre line, to its left if positive; inside a bend they have less space.
    A gentle bend has a wall at its corner; in a sharp one a room goes around it.
    """
    legs = np.diff(outline.corridor, axis=0)
    corners = np.append(0.0, np.cumsum(np.linalg.norm(legs, axis=1)))
    turns = np.diff(np.unwrap(np.arctan2(legs[:, 1], legs[:, 0])))
    widths = list(lab_m)
    while sum(widths) < corners[-1]:
        widths.append(float(rng.uniform(*outline.room_m)))
    rng.shuffle(widths)
    cuts = np.append(0.0, np.cumsum(widths))
    cuts = cuts[cuts < corners[-1] - 2.8]
    for corner, turn in zip(corners[1:-1], turns, strict=True):
        margin = _CLEAR_OF_BEND_M + outline.skew_m + max(reach_m * np.tan(turn / 2), 0.0)
        cuts = cuts[(np.abs(cuts - corner) > margin) | (cuts == 0)]
        if abs(turn) < np.radians(60):
            cuts = np.sort(np.append(cuts, corner))
    return np.append(cuts, corners[-1])


def _stretch(
    offset: FloatArray, line: FloatArray, start_m: float, end_m: float, start_skew: float, end_skew: float
) -> FloatArray:
    """The part of an offset line that lies beside a stretch of the centre line, its bends included."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    corners = np.append(0.0, np.cumsum(lengths))

    def beside(along_m: float, skew_m: float) -> FloatArray:
        if along_m in corners[1:-1]:
            return np.asarray(offset[np.searchsorted(corners, along_m)])
        leg = min(int(np.searchsorted(corners, along_m, side="right")) - 1, len(lengths) - 1)
        along = (line[leg + 1] - line[leg]) / lengths[leg]
        first, last = (offset[leg : leg + 2] - line[leg]) @ along
        place = np.clip(along_m - corners[leg] + skew_m, first, last)
        return np.asarray(offset[leg] + (place - first) * along)

    inside = [offset[i] for i in range(1, len(line) - 1) if start_m < corners[i] < end_m]
    return np.array([beside(start_m, start_skew), *inside, beside(end_m, end_skew)])


def _place_doors(
    rooms: list[Room], thickness: float, settings: SimulationSettings, rng: np.random.Generator
) -> list[Door]:
    corridor, others = rooms[0], rooms[1:]
    walls = [
        (corridor, room, ends)
        for room in others
        for ends in shared_walls(corridor.outline, room.outline)[: 2 if room.kind == "lab" else 1]
    ]
    walls += [
        (a, b, shared[0])
        for a, b in combinations(others, 2)
        if (shared := shared_walls(a.outline, b.outline)) and rng.random() < 0.2
    ]
    doors: list[Door] = []
    for front, back, ends in walls:
        length = float(np.linalg.norm(ends[1] - ends[0]))
        parts = 2 if front is corridor and back.kind == "lab" and length > 5 else 1
        for part in range(parts):
            door = _cut_door(front, back, ends, length * np.array([part, part + 1]) / parts, thickness, settings, rng)
            if door is not None:
                doors.append(door)
    shut = rng.permutation(len(doors)) < round(len(doors) * settings.closed_share)
    largest = max(others, key=lambda room: float(room.interior.area))
    entrance = next((i for i, door in enumerate(doors) if largest.name in door.rooms), None)
    if entrance is not None and not shut.all():
        # The largest room is worth a visit: its first door changes places with one that is open.
        other = int(np.flatnonzero(~shut)[0])
        shut[other], shut[entrance] = shut[entrance], False
    return [hang_door(door, bool(s), rooms, rng) for door, s in zip(doors, shut, strict=True)]


def _cut_door(
    front: Room, back: Room, ends: FloatArray, between_m: FloatArray, thickness: float,
    settings: SimulationSettings, rng: np.random.Generator
) -> Door | None:  # fmt: skip
    """A doorway somewhere on a stretch of wall; None where there is no place."""
    leaves = 2 if rng.random() < settings.double_share else 1
    width = float(rng.uniform(1.4, 1.8) if leaves == 2 else rng.uniform(0.82, 1.0))
    low, high = between_m[0] + _JAMB_M + width / 2, between_m[1] - _JAMB_M - width / 2
    if low > high:
        return None
    top = min(float(rng.uniform(2.0, 2.12)), front.ceiling_m - 0.2, back.ceiling_m - 0.2)
    recess = float(rng.uniform(settings.recess_min_m, max(settings.recess_min_m, settings.recess_max_m)))
    return Door(
        spot_on(ends, float(rng.uniform(low, high))), width, 0.0, top, (-thickness / 2, thickness / 2),
        (front.name, back.name), 0.0, leaves, int(rng.choice([-1, 1])), recess
    )  # fmt: skip


def hang_door(door: DoorT, closed: bool, rooms: Sequence[Room], rng: np.random.Generator) -> DoorT:
    """The door with its leaves closed, open, half open or against the wall, whichever the room has space for."""
    kind = rng.choice(["open", "half", "wall"], p=[0.6, 0.2, 0.2])
    angle = {"open": rng.uniform(82, 100), "half": rng.uniform(15, 60), "wall": rng.uniform(165, 175)}[kind]
    if closed:
        return door
    back = next(room for room in rooms if room.name == door.rooms[1])
    space = back.interior.union(door.area).buffer(1e-3)
    tries = [(angle, door.hinge), (angle, -door.hinge), (90.0, door.hinge), (90.0, -door.hinge), (30.0, door.hinge)]
    for angle_deg, hinge in tries:
        hung = replace(door, angle_deg=float(angle_deg), hinge=hinge)
        if all(space.contains(area) for area in hung.leaf_areas()):
            return hung
    return door


def _place_windows(
    rooms: list[Room], doors: list[Door], thickness: float, outer: float, settings: SimulationSettings,
    rng: np.random.Generator
) -> list[Window]:  # fmt: skip
    """Windows in rows in the outer walls, and glazed partitions beside doors."""
    windows = []
    for room in rooms:
        for ends in outer_walls(room, rooms):
            if rng.random() < settings.glass:
                bottom = 0.0 if rng.random() < 0.15 * settings.glass else float(rng.uniform(0.75, 1.0))
                top = min(float(rng.uniform(2.0, 2.4)), room.ceiling_m - 0.15)
                windows += _row(ends, bottom, top, (thickness / 2 - outer, thickness / 2), settings.glass, rng)
    corridor = rooms[0]
    for room in rooms[1:]:
        for ends in shared_walls(corridor.outline, room.outline):
            if rng.random() < 0.35 * settings.glass:
                depth = (-thickness / 2, thickness / 2)
                bottom = float(rng.choice([0.0, 0.9]))
                row = _row(ends, bottom, min(2.2, corridor.ceiling_m - 0.15), depth, settings.glass, rng)
                taken = shapely.union_all([door.area.buffer(0.15) for door in doors])
                windows += [window for window in row if not window.area.intersects(taken)]
    return windows


def _row(
    ends: FloatArray, bottom: float, top: float, depth: tuple[float, float], share: float, rng: np.random.Generator
) -> list[Window]:
    length = float(np.linalg.norm(ends[1] - ends[0]))
    pitch = float(rng.uniform(1.5, 2.6))
    count = int((length - 0.8) / pitch)
    width = pitch * (0.45 + 0.4 * share)
    middles = length / 2 + (np.arange(count) - (count - 1) / 2) * pitch
    return [Window(spot_on(ends, float(m)), width, bottom, top, depth) for m in middles]


def _place_columns(
    rooms: list[Room], doors: list[Door], windows: list[Window], rng: np.random.Generator
) -> list[shapely.Polygon]:
    """Pillars that stand in large rooms, and piers that stand out from walls."""
    openings = shapely.union_all([o.area.buffer(1.1) for o in doors] + [o.area.buffer(0.2) for o in windows])
    columns = []
    for room in rooms:
        side = float(rng.uniform(0.3, 0.5))
        if room.kind == "lab":
            core = room.interior.buffer(-2.0)
            if not core.is_empty:
                x0, y0, x1, y1 = core.minimum_rotated_rectangle.bounds
                for x, y in ((x0 * 0.75 + x1 * 0.25, (y0 + y1) / 2), (x0 * 0.25 + x1 * 0.75, (y0 + y1) / 2)):
                    if core.buffer(0.7).contains(shapely.Point(x, y)):
                        columns.append(Spot(x, y, 0.0).rectangle(-side / 2, side / 2, -side / 2, side / 2))
        for edge in edges(room.interior):
            length = float(np.linalg.norm(edge[1] - edge[0]))
            if length > 3 and rng.random() < 0.3:
                out = 0.12 if room.kind == "corridor" else float(rng.uniform(0.12, 0.3))
                pier = spot_on(edge, float(rng.uniform(0.8, length - 0.8))).rectangle(-side / 2, side / 2, -0.02, out)
                if not pier.intersects(openings):
                    columns.append(pier)
    return columns


def _place_podium(rooms: list[Room], doors: list[Door]) -> shapely.Polygon | None:
    """A raised strip along a wall of the largest room, away from its doors."""
    room = max(rooms[1:], key=lambda room: float(room.interior.area))
    doorways = shapely.union_all([door.area.buffer(1.2) for door in doors])
    strips = []
    for edge in edges(room.interior):
        length = float(np.linalg.norm(edge[1] - edge[0]))
        strip = spot_on(edge, length / 2).rectangle(-length / 2, length / 2, 0.0, 1.3).intersection(room.interior)
        if strip.geom_type == "Polygon" and not strip.intersects(doorways):
            strips.append(strip)
    return max(strips, key=lambda strip: float(strip.area), default=None)
