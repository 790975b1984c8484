"""What the bag tells about the building itself, as GeoJSON in the map's frame (metres)."""

from typing import Any

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import Plan


def building_truth(plan: Plan, T_map_plan: FloatArray) -> dict[str, Any]:
    """A FeatureCollection; `kind` tells the features apart.

    wall: LineString, a stretch of a wall's face that stands on the floor (jambs and columns too); height.
    door: LineString along the sill between the jambs; state, width, height, recess (of a closed leaf behind the first
    room's wall face), leaf (single or double), angle_deg, wall_thickness, rooms.
    room: Polygon up to the walls' faces; name, area, ceiling.
    glass: LineString of a pane; bottom, height.
    """

    def line(ends: FloatArray) -> dict[str, Any]:
        return {"type": "LineString", "coordinates": in_map(ends, T_map_plan)}

    top = max(room.ceiling_m for room in plan.rooms)
    features = [feature(line(ends), kind="wall", height=round(top, 3)) for ends in plan.wall_faces()]
    for door in plan.doors:
        features.append(
            feature(
                line(door.sill), kind="door", state="closed" if door.closed else "open",
                width=round(door.width_m, 4), height=round(door.top_m, 4),
                recess=round(door.recess_m, 4) if door.closed else None,
                leaf="double" if door.leaves == 2 else "single", angle_deg=round(door.angle_deg, 1),
                wall_thickness=round(plan.wall_thickness_m, 4), rooms=list(door.rooms)
            )
        )  # fmt: skip
    for room in plan.rooms:
        ring = in_map(np.array(room.interior.exterior.coords), T_map_plan)
        area, ceiling = round(room.interior.area, 3), round(room.ceiling_m, 3)
        polygon = {"type": "Polygon", "coordinates": [ring]}
        features.append(feature(polygon, kind="room", name=room.name, area=area, ceiling=ceiling))
    for window in plan.windows:
        features.append(feature(line(window.sill), kind="glass", bottom=window.bottom_m, height=window.top_m))
    return {"type": "FeatureCollection", "features": features}


def feature(geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:  # noqa: ANN401 (GeoJSON's own freedom)
    """Of GeoJSON."""
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def in_map(points: FloatArray, T_map_plan: FloatArray) -> list[list[float]]:
    """Places (n, 2) of the plan in the map, for GeoJSON."""
    placed = transforms.apply(T_map_plan, np.c_[points, np.zeros(len(points))])
    return [[round(float(x), 4), round(float(y), 4)] for x, y in placed[:, :2]]
