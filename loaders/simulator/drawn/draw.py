"""A building drawn from ranges: its plan, and after the robot's ways are known, what is built in their shade."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator.building import RoomKind
from ffmap.loaders.simulator.drawn.ceilings import draw_ceiling
from ffmap.loaders.simulator.drawn.doors import place_doors
from ffmap.loaders.simulator.drawn.elements import DrawnPlan, DrawnRoom
from ffmap.loaders.simulator.drawn.ranges import KINDS, Ranges, ranges_of
from ffmap.loaders.simulator.drawn.stairs import draw_flight, draw_platform
from ffmap.loaders.simulator.drawn.walls import (
    add_bays,
    carve,
    clear_of,
    draw_half_walls,
    draw_leaning,
    draw_pillars,
    draw_thickness,
    place_niches,
    round_corner,
)  # fmt: skip
from ffmap.loaders.simulator.drawn.windows import place_windows
from ffmap.loaders.simulator.plans import Outline, divide, line_of
from ffmap.loaders.simulator.settings import SimulationSettings

_ROOMS: Mapping[str, tuple[tuple[RoomKind, ...], RoomKind]] = {
    "dwelling": (("bed", "bed", "living", "kitchen", "office", "store"), "living"),
    "workplace": (("office", "office", "office", "meeting", "store"), "lab"),
    "institution": (("meeting", "office", "lab", "store"), "meeting"),
}
_TRIES = 100
_DECIDED = {
    "ceiling_m": "ceiling_m", "wall_thickness_m": "inner_wall_m", "recess_min_m": "recess_m", "recess_max_m": "recess_m",
    "double_share": "door", "glass": "window", "ramp_rise_m": "ramp_m", "door_sills_m": "door_sill_m", "step_m": "platform_m"
}  # fmt: skip
"""Properties of the earlier kinds, and the range that takes their place."""


def check_kind(settings: SimulationSettings) -> None:
    """Raises InputError where a property was said that the kind of building does not have."""
    said = settings.model_fields_set
    if settings.building not in KINDS:
        if "drawn" in said:
            raise InputError(f"simulate: drawn.…: {settings.building} is not drawn from ranges; {', '.join(KINDS)} are")
        return
    for name in said & set(_DECIDED):
        raise InputError(f"simulate: {name}: {settings.building} is drawn from ranges; say drawn.{_DECIDED[name]} instead")


def draw_drawn_plan(settings: SimulationSettings, rng: np.random.Generator) -> DrawnPlan:
    """Rooms along a corridor with their doors, windows, niches and ceilings; a plan that the robot's ways are found in."""
    ranges = ranges_of(settings.building, settings.drawn)
    corridor_wall, outer = float(rng.uniform(*ranges.inner_wall_m)), float(rng.uniform(*ranges.outer_wall_m))
    outline, areas = _divided(settings.building, corridor_wall, ranges, rng)
    outlines = add_bays([area for _, _, area in areas], ranges, rng)
    thickness = draw_thickness(outlines, corridor_wall, ranges, rng)
    rooms = []
    height = float(rng.uniform(*ranges.ceiling_m))
    for (name, kind, area), outline_, interior in zip(areas, outlines, carve(outlines, thickness), strict=True):
        round_parts: list[BaseGeometry] = [outline_.difference(area)] if not outline_.equals(area) else []
        if kind != "corridor" and rng.random() < ranges.round_share:
            interior, filled = round_corner(interior, ranges, rng)
            round_parts += [filled] if not filled.is_empty else []
        lowest = max(height - float(rng.uniform(*ranges.storey_spread_m)), ranges.ceiling_m[0])
        own_height = float(rng.uniform(lowest, height))
        ceiling = draw_ceiling(interior, own_height, ranges, rng)
        rooms.append(DrawnRoom(name, kind, outline_, interior, ceiling.low_m, ceiling, tuple(round_parts)))
    doors = place_doors(rooms, thickness, ranges, settings.closed_share, rng)
    windows = place_windows(rooms, doors, thickness, outer, ranges, rng)
    plan = DrawnPlan(
        tuple(rooms), tuple(doors), tuple(windows), (), corridor_wall, outer + corridor_wall / 2 - 0.035, outline.corridor,
        None, 0.0, float(rng.uniform(*ranges.door_sill_m)), tuple(rooms), tuple(doors), tuple(windows), (), (), (), ()
    )  # fmt: skip
    return replace(plan, niches=tuple(place_niches(plan, ranges, rng)))


def build_in(plan: DrawnPlan, ways: BaseGeometry, settings: SimulationSettings, rng: np.random.Generator) -> DrawnPlan:
    """The plan with pillars, half-height and leaning walls, stairs and a platform, clear of the robot's ways and each other."""
    ranges = ranges_of(settings.building, settings.drawn)
    leaves = [leaf for door in plan.doors for leaf in door.leaf_areas()]
    keep = shapely.union_all([ways, clear_of(plan.openings), *leaves])
    leaning = draw_leaning(plan, ways, ranges, rng)
    keep = shapely.union_all([keep, *(wall.area for wall in leaning)])
    found = draw_flight(plan, keep, ranges, rng)
    if found is not None:
        keep = keep.union(found[1].area)
        rooms = tuple(found[0] if room.name == found[0].name else room for room in plan.drawn_rooms)
        plan = replace(plan, rooms=rooms, drawn_rooms=rooms, flights=(found[1],))
    podium, podium_m = draw_platform(plan, keep, ranges, rng)
    keep = keep.union(podium) if podium is not None else keep
    half_walls = draw_half_walls(plan, keep, ranges, rng)
    keep = shapely.union_all([keep, *(wall.area for wall in half_walls)])
    columns = draw_pillars(plan, keep, ranges, rng)
    return replace(
        plan, leaning=tuple(leaning), half_walls=tuple(half_walls), columns=tuple(columns), podium=podium, podium_m=podium_m
    )


def with_ramp(settings: SimulationSettings, rng: np.random.Generator) -> tuple[SimulationSettings, float]:
    """The settings with a ramp's rise, zero where none is drawn, and its gradient."""
    ranges = ranges_of(settings.building, settings.drawn)
    rise, gradient = (float(rng.uniform(*r)) for r in (ranges.ramp_m, ranges.ramp_gradient))
    return settings.model_copy(update={"ramp_rise_m": rise if rng.random() < ranges.ramp_share else 0.0}), gradient


def _divided(
    kind: str, corridor_wall_m: float, ranges: Ranges, rng: np.random.Generator
) -> tuple[Outline, list[tuple[str, RoomKind, shapely.Polygon]]]:
    """An outline and its rooms; drawn again where the corridor bends too sharply for the depth of its rooms."""
    for _ in range(_TRIES):
        outline = _outline(kind, ranges, rng)
        areas = divide(outline, corridor_wall_m, rng)
        overlap = sum(area.area for _, _, area in areas) - shapely.union_all([area.buffer(0) for _, _, area in areas]).area
        if all(area.is_valid for _, _, area in areas) and overlap < 0.01:
            return outline, areas
    raise InputError("simulate: drawn: rooms overlap at the corridor's bend; a smaller room_depth_m or turn_deg helps")


def _outline(kind: str, ranges: Ranges, rng: np.random.Generator) -> Outline:
    legs = ["one", "two"][int(rng.random() >= ranges.legs.get("one", 0.0) / sum(ranges.legs.values()))]
    length, share = float(rng.uniform(*ranges.corridor_length_m)), float(rng.uniform(0.4, 0.6))
    line = [(length, 0.0)]
    if legs == "two":
        turn = float(rng.uniform(*ranges.turn_deg) * rng.choice([-1, 1]))
        line = [(share * length, 0.0), ((1.0 - share) * length, turn)]
    depth = (float(rng.uniform(*ranges.room_depth_m)), float(rng.uniform(*ranges.room_depth_m)))
    skew = 0.0 if rng.random() < 0.6 else float(rng.uniform(*ranges.skew_m))
    kinds, large = _ROOMS[kind]
    wide, width = (float(rng.uniform(5.0, max(ranges.room_width_m[1], 5.1))),), float(rng.uniform(*ranges.corridor_m))
    return Outline(line_of(*line), width, depth, skew, wide, 0.0, ranges.room_width_m, kinds, large)
