"""A flight of stairs up through a stairwell, and platforms. Steps are floor: one stands on them."""

from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator.building import edges, spot_on
from ffmap.loaders.simulator.drawn.elements import DrawnPlan, DrawnRoom, Flight, Well
from ffmap.loaders.simulator.drawn.ranges import Ranges
from ffmap.loaders.simulator.mesh import MeshBuilder, Spot, Surface

_HEADROOM_M = 2.0  # DIN 18065, IRC R311.7.2: 2.03
_TRIES = 4  # Places along each wall


def draw_flight(
    plan: DrawnPlan, keep: BaseGeometry, ranges: Ranges, rng: np.random.Generator
) -> tuple[DrawnRoom, Flight] | None:
    """A flight along a wall of a room that has the space for it, and that room with its stairwell; None where none has."""
    if rng.random() >= ranges.stairs_share:
        return None
    riser, going, width = (float(rng.uniform(*r)) for r in (ranges.riser_m, ranges.going_m, ranges.flight_m))
    for room in sorted(plan.drawn_rooms[1:], key=lambda room: -float(room.interior.area)):
        if room.ceiling.shape != "flat" or room.ceiling.drops or room.ceiling.wells:
            continue
        steps = int(np.ceil(room.ceiling_m / riser))
        length = steps * going
        for edge in _TRIES * edges(room.interior):
            spare = float(np.linalg.norm(edge[1] - edge[0])) - length
            if spare < 0.0:
                continue
            flight = Flight(spot_on(edge, float(rng.uniform(0.0, spare))), width, steps, riser, going)
            if room.interior.buffer(0.001).contains(flight.area) and not flight.area.intersects(keep):
                return _with_stairwell(room, flight), flight
    return None


def _with_stairwell(room: DrawnRoom, flight: Flight) -> DrawnRoom:
    """Open above every step that has no headroom under the ceiling."""
    first = max(int((room.ceiling_m - _HEADROOM_M) / flight.riser_m), 0)
    start, end = first * flight.going_m, flight.steps * flight.going_m
    well = Well(flight.spot.rectangle(start, end, 0.0, flight.width_m), 2.5, None)
    return replace(room, ceiling=replace(room.ceiling, wells=(well,)))


def build_flight(flight: Flight, mesh: MeshBuilder, surface: Surface) -> None:
    """Solid steps."""
    for step in range(flight.steps):
        x = (step * flight.going_m, flight.steps * flight.going_m)
        mesh.box(flight.spot, x, (0.0, flight.width_m), (step * flight.riser_m, (step + 1) * flight.riser_m), Truth.FLOOR, surface)


def draw_platform(
    plan: DrawnPlan, keep: BaseGeometry, ranges: Ranges, rng: np.random.Generator
) -> tuple[shapely.Polygon | None, float]:
    """A raised strip along a wall, and its height."""
    height = float(rng.uniform(*ranges.platform_m))
    if rng.random() >= ranges.platform_share:
        return None, 0.0
    strips = []
    for room in plan.drawn_rooms[1:]:
        for edge in _TRIES * edges(room.interior):
            length, deep = float(np.linalg.norm(edge[1] - edge[0])), float(rng.uniform(0.5, 2.2))
            own = length * float(rng.uniform(0.4, 1.0))
            place = spot_on(edge, float(rng.uniform(own / 2, length - own / 2)))
            strip = _strip(place, own, deep).intersection(room.interior)
            if own > 1.2 and strip.geom_type == "Polygon" and not strip.intersects(keep):
                strips.append(strip)
    return (max(strips, key=lambda strip: float(strip.area)), height) if strips else (None, 0.0)


def _strip(spot: Spot, length_m: float, depth_m: float) -> shapely.Polygon:
    return spot.rectangle(-length_m / 2, length_m / 2, 0.0, depth_m)
