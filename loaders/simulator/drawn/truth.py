"""What a drawn building tells beside walls, doors and rooms: how its doors and windows look, and where its other parts are."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.drawn.elements import DrawnPlan, polygons
from ffmap.loaders.simulator.truth import building_truth, feature, in_map

_NEAR_M = 0.08  # Around what an element is made of
_ALL_HEIGHTS = (-0.2, 12.0)
_Element = tuple[str, Truth, BaseGeometry, tuple[float, float]]


def drawn_truth(plan: DrawnPlan, T_map_plan: FloatArray) -> dict[str, Any]:
    """As `building_truth`, with more properties, and with features of the kind `element`.

    door: wall_thickness of its own wall; leaves, their outlines; design, in words; casing (m).
    glass: style of its window, and kind of glass.
    element: Polygon that holds all returns of a part of the building; element, its name; truth, the class that its returns
        have; bottom, height (m).
    """
    truth = building_truth(plan, T_map_plan)
    by_kind: dict[str, list[dict[str, Any]]] = {}
    for own in truth["features"]:
        by_kind.setdefault(own["properties"]["kind"], []).append(own["properties"])
    for properties, door in zip(by_kind.get("door", []), plan.drawn_doors, strict=True):
        leaves = [in_map(np.array(area.exterior.coords), T_map_plan) for area in door.leaf_areas()]
        properties |= {
            "wall_thickness": round(door.depth[1] - door.depth[0], 4), "leaves": leaves, "design": door.design,
            "casing": round(door.casing_m, 4)
        }  # fmt: skip
    for properties, window in zip(by_kind.get("glass", []), plan.drawn_windows, strict=True):
        properties |= {"style": window.style, "glass": window.glass.name.lower()}
    for name, true_class, area, (bottom, top) in _elements(plan):
        for part in polygons(area, 1e-6):
            ring = in_map(np.array(part.exterior.coords), T_map_plan)
            polygon = {"type": "Polygon", "coordinates": [ring]}
            truth["features"].append(
                feature(polygon, kind="element", element=name, truth=true_class.name.lower(), bottom=round(bottom, 3),
                        height=round(top, 3))
            )  # fmt: skip
    return truth


def _elements(plan: DrawnPlan) -> Iterator[_Element]:
    """Name, class, area in the plan, and heights of every part that is counted for itself."""
    for room in plan.drawn_rooms:
        shape = room.ceiling.shape
        with_soffit = ", with soffit" if shape == "flat" and room.ceiling.drops else ""
        yield f"ceiling, {shape}{with_soffit}", Truth.CEILING, room.interior.buffer(0.02), _ALL_HEIGHTS
        # Through a glazed wall one sees true walls and ceilings of the next room; by the labels' meaning they are outside.
        yield "seen through glass, indoors", Truth.OUTSIDE, room.interior, _ALL_HEIGHTS
        for part in room.round:
            yield "round wall", Truth.WALL, part.buffer(_NEAR_M), _ALL_HEIGHTS
    for door in plan.drawn_doors:
        half = door.width_m / 2
        if door.casing_m > 0.001:
            wide = half + door.casing_width_m
            for face, out in ((door.depth[1], door.casing_m), (door.depth[0], -door.casing_m)):
                area = door.spot.rectangle(-wide, wide, face, face + out)
                yield "casing", Truth.WALL, area.buffer(0.01), (0.0, door.top_m + door.casing_width_m)
        if door.style == "arch":
            yield "arch", Truth.WALL, door.area.buffer(0.01), (door.top_m - min(half, 0.5) - 0.02, door.top_m + 0.02)
        if door.closed:
            for area in door.leaf_areas():
                yield f"leaf, {door.design}", Truth.DOOR, area.buffer(0.06), (0.0, door.top_m + 0.02)
    for window in plan.drawn_windows:
        area = window.area.buffer(0.12)
        yield f"window frame, {window.style}", Truth.WALL, window.area, (window.bottom_m, window.top_m)
        yield "blind", Truth.CLUTTER, area, (window.bottom_m, window.top_m)
        if window.bottom_m > 0.2:
            yield f"spandrel, {window.style}", Truth.WALL, area, (0.0, window.bottom_m - 0.03)
    for niche in plan.niches:
        deep = niche.spot.rectangle(-niche.width_m / 2, niche.width_m / 2, niche.depth[0], niche.depth[1] - 0.03)
        yield "niche", Truth.WALL, deep.buffer(0.025), (niche.bottom_m, niche.top_m)
    for wall in plan.half_walls:
        yield "half-height wall", Truth.WALL, wall.area.buffer(_NEAR_M), (0.0, wall.height_m + _NEAR_M)
    for leaning in plan.leaning:
        name = "leaning wall" if leaning.upright else "roof slope"
        yield name, Truth.WALL if leaning.upright else Truth.CEILING, leaning.area.buffer(_NEAR_M), (leaning.knee_m, leaning.top_m)
    for column in plan.columns:
        yield "pillar", Truth.WALL, column.buffer(_NEAR_M), _ALL_HEIGHTS
    for flight in plan.flights:
        yield "stairs", Truth.FLOOR, flight.area.buffer(_NEAR_M), _ALL_HEIGHTS
    if plan.podium is not None:
        yield "platform", Truth.FLOOR, plan.podium.buffer(_NEAR_M), (0.05, plan.podium_m + _NEAR_M)


