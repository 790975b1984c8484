"""The ground truth of the building, as GeoJSON in the map's frame (metres)."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.mesh import Span, polygons
from ffmap.loaders.simulator.openings import CASING_WIDTH_M
from ffmap.loaders.simulator.plan import Plan

_NEAR_M = 0.08  # Around the parts that elements contain
_ALL_HEIGHTS = (-0.2, 12.0)


def building_truth(plan: Plan, T_map_plan: FloatArray) -> dict[str, Any]:
    """Return a FeatureCollection of walls, doors, rooms, panes, and elements.

    wall: a stretch of a wall's face at the floor, with jambs and pillars. door: the line along the
    sill; recess: of a closed leaf behind the front face. element: a polygon that contains all
    returns of a part between two heights, with its class.
    """

    def places(points: FloatArray) -> list[list[float]]:
        placed = transforms.apply(T_map_plan, np.c_[points, np.zeros(len(points))])
        return [[round(float(x), 4), round(float(y), 4)] for x, y in placed[:, :2]]

    def add(kind: str, place: BaseGeometry, **properties: Any) -> None:  # noqa: ANN401
        ring = places(shapely.get_coordinates(place))
        line = place.geom_type == "LineString"
        geometry = {"type": place.geom_type, "coordinates": ring if line else [ring]}
        own = {name: _rounded(value) for name, value in properties.items()}
        own = {"kind": kind, **own}
        features.append({"type": "Feature", "geometry": geometry, "properties": own})

    features: list[dict[str, Any]] = []
    highest = max(room.ceiling.high_m for room in plan.rooms)
    for ends in plan.wall_faces():
        add("wall", shapely.LineString(ends), height=highest)
    for door in plan.doors:
        add(
            "door", door.sill, state="closed" if door.closed else "open", width=door.width_m,
            height=door.top_m, recess=door.recess_m if door.closed else None,
            leaf="double" if door.style == "double" else "single", angle_deg=door.angle_deg,
            leaves=[places(shapely.get_coordinates(area)) for area in door.leaf_areas],
            wall_thickness=door.depth[1] - door.depth[0], casing=door.casing_m,
            rooms=[plan.rooms[i].name for i in door.rooms], design=door.design
        )  # fmt: skip
    for room in plan.rooms:
        add("room", room.interior, name=room.name, area=room.interior.area, ceiling=room.ceiling_m)
    for window in plan.windows:
        add(
            "glass", window.sill, bottom=window.bottom_m, height=window.top_m,
            style=window.style, glass=window.glass.name.lower()
        )  # fmt: skip
    for name, truth, area, (bottom, top) in _elements(plan):
        for part in polygons(area, 1e-6):
            add("element", part, element=name, truth=truth.name.lower(), bottom=bottom, height=top)
    return {"type": "FeatureCollection", "features": features}


def _rounded(value: object) -> object:
    return round(value, 4) if isinstance(value, float) else value


def _elements(plan: Plan) -> Iterator[tuple[str, Truth, BaseGeometry, Span]]:
    """Yield name, class, area and heights of the parts that are evaluated one by one."""
    for room in plan.rooms:
        area = room.interior.buffer(0.02)
        yield f"ceiling, {room.ceiling.shape}", Truth.CEILING, area, _ALL_HEIGHTS
        # Walls and ceilings behind a glazed wall are outside by the labels' definition.
        yield "seen through glass, indoors", Truth.OUTSIDE, room.interior, _ALL_HEIGHTS
    for door in plan.doors:
        heights = (0.0, door.top_m + _NEAR_M)
        if door.casing_m > 0.001:
            for behind in (False, True):
                casing = door.before(CASING_WIDTH_M, door.casing_m, behind)
                yield "casing", Truth.WALL, casing.buffer(0.01), heights
        if door.closed:
            for area in door.leaf_areas:
                yield f"leaf, {door.design}", Truth.DOOR, area.buffer(0.06), heights
    for window in plan.windows:
        area, heights = window.area.buffer(0.12), (window.bottom_m, window.top_m)
        yield f"window frame, {window.style}", Truth.WALL, window.area, heights
        if window.blind:
            yield "blind", Truth.CLUTTER, area, heights
        if window.bottom_m > 0.2:
            yield f"spandrel, {window.style}", Truth.WALL, area, (0.0, window.bottom_m - 0.03)
    for niche in plan.niches:
        half = niche.width_m / 2
        deep = niche.spot.rectangle(-half, half, niche.depth[0], -0.03)
        yield "niche", Truth.WALL, deep.buffer(0.025), (niche.bottom_m, niche.top_m)
    for part in plan.parts:
        heights = (part.z[0], part.z[1] + _NEAR_M)
        yield part.name, part.truth, part.shadow.buffer(_NEAR_M), heights
