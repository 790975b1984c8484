"""Rooms as files: outlines as GeoJSON, topology as JSON."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ffmap.algorithms.maps.area_graph import AreaGraph
from ffmap.app.folder.atomic import write_geojson


def write_rooms(path: Path, graph: AreaGraph) -> None:
    """Write rooms as Polygons with name, area, doors (ids in doors.geojson) and neighbours."""
    features = []
    for index, room in enumerate(graph.rooms):
        properties = {
            "name": room.name,
            "area": round(room.area_m2, 3),
            "doors": room.doors,
            "neighbours": graph.neighbours(index),
        }
        geometry = shapely.geometry.mapping(room.polygon)
        features.append({"properties": properties, "geometry": geometry})
    write_geojson(path, features)


def write_passages(path: Path, graph: AreaGraph) -> None:
    """Write openings between rooms without a door as LineStrings with their rooms and width."""
    features = [
        {
            "properties": {"rooms": own["rooms"], "width": own["width_m"]},
            "geometry": {"type": "LineString", "coordinates": passage.line},
        }
        for passage, own in zip(graph.passages, topology(graph)["passages"], strict=True)
        if passage.door is None
    ]
    write_geojson(path, features)


def outlines(features: Sequence[dict[str, Any]]) -> list[shapely.Polygon]:
    """Return the Polygons of GeoJSON features."""
    return [shapely.geometry.shape(feature["geometry"]) for feature in features]


def topology(graph: AreaGraph) -> dict[str, Any]:
    """Return rooms and passages for run.json; a passage without a detected door has door null."""
    rooms = [
        {"name": room.name, "area_m2": round(room.area_m2, 3), "doors": list(room.doors)}
        for room in graph.rooms
    ]
    passages = [
        {
            "rooms": [graph.rooms[room].name for room in passage.rooms],
            "door": passage.door,
            "width_m": round(float(np.linalg.norm(passage.line[1] - passage.line[0])), 3),
            "middle": [round(float(value), 3) for value in passage.line.mean(axis=0)],
        }
        for passage in graph.passages
    ]
    return {"rooms": rooms, "passages": passages}


def door_rooms(graph: AreaGraph) -> list[list[str | None] | None]:
    """Name the rooms in front of each detected door and behind it.

    A room that was not mapped is None; so is a door without any mapped room.
    """
    names = [*(room.name for room in graph.rooms), None]
    return [
        None if pair == (-1, -1) else [names[pair[0]], names[pair[1]]] for pair in graph.door_rooms
    ]
