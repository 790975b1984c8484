"""Draw the plan: rooms, openings, and the parts built into rooms clear of the robot's ways."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator.mesh import Rng, Spot, length_of, polygons, segments, spot_on
from ffmap.loaders.simulator.openings import draw_doors, draw_windows
from ffmap.loaders.simulator.plan import Opening, Part, Plan, Room
from ffmap.loaders.simulator.rooms import draw_rooms
from ffmap.loaders.simulator.settings import SimulationSettings, choose, draw

_UPRIGHT_DEG = 30.0  # A wall that leans more is a ceiling: no cupboard can be placed against it
_PLATFORM_DEPTH_M = 1.3
_TRIES = 20


def draw_plan(settings: SimulationSettings, rng: Rng) -> Plan:
    """Draw rooms, doors and windows; the robot's ways are found in this plan."""
    line, rooms = draw_rooms(settings, rng)
    outer_m = float(np.mean(settings.wall_thickness_m) + rng.uniform(0.08, 0.25))
    doors = draw_doors(rooms, settings, rng)
    windows = draw_windows(rooms, doors, outer_m, settings, rng)
    sills_m = draw(settings.door_sills_m, rng)
    return Plan(tuple(rooms), tuple(doors), tuple(windows), line, outer_m, sills_m)


def build_in(plan: Plan, ways: BaseGeometry, settings: SimulationSettings, rng: Rng) -> Plan:
    """Add niches and built-in parts, clear of the robot's ways, of openings and of each other."""
    doorways = [area for door in plan.doors for area in (door.area.buffer(0.9), *door.leaf_areas)]
    windows = [window.area.buffer(0.15) for window in plan.windows]
    keep = shapely.union_all([ways, *doorways, *windows])
    niches: list[Opening] = []
    parts = _platform(plan, keep, settings.step_m) if settings.step_m else []
    for room in plan.rooms[1:]:
        for name in dict.fromkeys(choose(settings.built, rng) for _ in range(2)):
            taken = [part.shadow for part in parts] + [niche.area for niche in niches]
            keep = shapely.union_all([keep, *(area.buffer(0.1) for area in taken)])
            if name == "niche":
                niches += _niche(plan, room, keep, rng)
            elif name == "round corner":
                parts += _round_corner(room, keep, rng)
            elif name != "nothing":
                for spot in spots_at_walls(room, 0.5, _TRIES, rng):
                    tried = _SHAPES[name](spot, room, rng)
                    if all(_is_free(room, part.shadow, keep) for part in tried):
                        parts += tried
                        break
    return replace(plan, niches=tuple(niches), parts=tuple(parts))


def spots_at_walls(room: Room, width_m: float, tries: int, rng: Rng) -> Iterator[Spot]:
    """Yield random spots at walls that are wide enough, in the middle of the width."""
    walls = [ends for ends in segments(room.interior) if length_of(ends) > width_m]
    lengths = np.array([length_of(ends) for ends in walls])
    for _ in range(tries if walls else 0):
        ends = walls[int(rng.choice(len(walls), p=lengths / lengths.sum()))]
        yield spot_on(ends, float(rng.uniform(width_m / 2, length_of(ends) - width_m / 2)))


def _is_free(room: Room, area: shapely.Polygon, keep: BaseGeometry) -> bool:
    return bool(room.interior.buffer(0.002).contains(area)) and not area.intersects(keep)


def _platform(plan: Plan, keep: BaseGeometry, height_m: float) -> list[Part]:
    """Place a raised strip along a wall, the largest that fits in any room."""
    found = []
    for room in plan.rooms[1:]:
        for ends in segments(room.interior):
            strip = spot_on(ends, 0.0).rectangle(0.0, length_of(ends), 0.0, _PLATFORM_DEPTH_M)
            found += polygons(strip.intersection(room.interior).difference(keep), 1.0)
    largest = sorted(found, key=shapely.area)[-1:]
    return [Part("platform", Truth.FLOOR, area, (0.0, height_m)) for area in largest]


def _niche(plan: Plan, room: Room, keep: BaseGeometry, rng: Rng) -> list[Opening]:
    """Draw a hole in a wall that is thick enough."""
    half, deep = float(rng.uniform(0.2, 0.9)), float(rng.uniform(0.05, 0.3))
    bottom = float(rng.choice([0.0, rng.uniform(0.2, 1.2)]))
    top = min(bottom + float(rng.uniform(0.4, 2.2)), room.ceiling_m - 0.05)
    for spot in spots_at_walls(room, 2 * half + 0.6, _TRIES, rng):
        around = spot.rectangle(-half - 0.05, half + 0.05, -deep - 0.05, -0.002)
        if plan.solid.contains(around) and not around.intersects(keep):
            return [Opening(spot, 2 * half, bottom, top, (-deep, 0.0))]
    return []


def _round_corner(room: Room, keep: BaseGeometry, rng: Rng) -> list[Part]:
    """Fill a corner with a round face."""
    x0, y0, x1, y1 = room.interior.bounds
    radius = min(float(rng.uniform(0.3, 2.5)), 0.4 * min(x1 - x0, y1 - y0))
    smooth = room.interior.buffer(-radius).buffer(radius, quad_segs=24)
    corners = polygons(room.interior.difference(smooth), 0.01)
    free = [area for area in corners if _is_free(room, area, keep)]
    return [Part("round wall", Truth.WALL, area, (0.0, room.ceiling.high_m)) for area in free[:1]]


def _pillar(spot: Spot, room: Room, rng: Rng) -> list[Part]:
    """Draw a round or square pillar, or a pier at a wall."""
    half, out = float(rng.uniform(0.1, 0.3)), float(rng.choice([0.0, rng.uniform(0.2, 3.0)]))
    area = spot.rectangle(-half, half, out, out + half * (2 if out else 1))
    if out and rng.random() < 0.5:
        area = area.centroid.buffer(half)
    return [Part("pillar", Truth.WALL, area, (0.0, room.ceiling.high_m))]


def _half_wall(spot: Spot, room: Room, rng: Rng) -> list[Part]:
    """Draw a half-height wall that extends from a wall into the room."""
    half, out = float(rng.uniform(0.035, 0.15)), float(rng.uniform(0.8, 2.5))
    z = (0.0, float(rng.uniform(0.7, 1.9)))
    return [Part("half-height wall", Truth.WALL, spot.rectangle(-half, half, 0.0, out), z)]


def _leaning_wall(spot: Spot, room: Room, rng: Rng) -> list[Part]:
    """Draw a wall that leans into the room or is thicker at its foot, or a roof's slope."""
    lean, half = float(rng.uniform(-25, 60)), float(rng.uniform(0.4, 0.75))
    roof = lean > _UPRIGHT_DEG
    z = (float(rng.uniform(0.5, 1.4)) if roof else 0.0, room.ceiling.low_m)
    deep = abs(np.tan(np.radians(lean))) * (z[1] - z[0])
    narrow, wide = (spot.rectangle(-half, half, 0.0, own) for own in (0.001, deep))
    if roof:
        return [Part("roof slope", Truth.CEILING, narrow, z, wide)]
    ends = (wide, narrow) if lean < 0 else (narrow, wide)
    return [Part("leaning wall", Truth.WALL, ends[0], z, ends[1])]


def _steps(spot: Spot, room: Room, rng: Rng) -> list[Part]:
    """Draw a flight of a few solid steps along a wall, with a landing."""
    count, width = int(rng.integers(3, 7)), float(rng.uniform(0.7, 1.3))
    riser, going = float(rng.uniform(0.13, 0.20)), float(rng.uniform(0.23, 0.35))  # DIN 18065
    half = (count * going + 0.8) / 2
    treads = [spot.rectangle(i * going - half, half, 0.0, width) for i in range(count)]
    return [
        Part("stairs", Truth.FLOOR, tread, (0.0, (i + 1) * riser)) for i, tread in enumerate(treads)
    ]


_SHAPES: dict[str, Callable[[Spot, Room, Rng], list[Part]]] = {
    "pillar": _pillar,
    "half wall": _half_wall,
    "leaning wall": _leaning_wall,
    "steps": _steps,
}
