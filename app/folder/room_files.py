"""Rooms as files: outlines as GeoJSON, topology as JSON, a picture with names and areas."""

import colorsys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from PIL import Image, ImageDraw, ImageFont

from ffmap.algorithms.maps.area_graph import AreaGraph, Room
from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.atomic import write_geojson, written_whole
from ffmap.blueprints import entities

_PICTURE_PX = 1600
_TRANSPARENCY = 0.35
"""Share of the map that shows through the rooms' colours."""


def write_rooms(path: Path, graph: AreaGraph) -> None:
    """Rooms as Polygons in metres of the map frame, with name, area, doors (ids in doors.geojson) and neighbours."""
    write_geojson(
        path,
        [
            {
                "properties": {
                    "name": room.name,
                    "area": round(room.area_m2, 3),
                    "doors": room.doors,
                    "neighbours": graph.neighbours(index),
                },
                "geometry": shapely.geometry.mapping(room.polygon),
            }
            for index, room in enumerate(graph.rooms)
        ],
    )


def outlines(features: Sequence[dict[str, Any]]) -> list[shapely.Polygon]:
    """The Polygons of GeoJSON features."""
    return [shapely.geometry.shape(feature["geometry"]) for feature in features]


def topology(graph: AreaGraph) -> dict[str, Any]:
    """Rooms and passages, as run.json holds them; a passage's door is null where no door was detected."""
    return {
        "rooms": [
            {"name": room.name, "area_m2": round(room.area_m2, 3), "doors": list(room.doors)} for room in graph.rooms
        ],
        "passages": [
            {
                "rooms": [graph.rooms[room].name for room in passage.rooms],
                "door": passage.door,
                "width_m": round(float(np.linalg.norm(passage.line[1] - passage.line[0])), 3),
                "middle": [round(float(value), 3) for value in passage.line.mean(axis=0)],
            }
            for passage in graph.passages
        ],
    }


def door_rooms(graph: AreaGraph) -> list[list[str | None] | None]:
    """For each detected door the names of the rooms in front and behind, None where one was not mapped, or none."""
    names = [*(room.name for room in graph.rooms), None]
    return [None if pair == (-1, -1) else [names[pair[0]], names[pair[1]]] for pair in graph.door_rooms]


def room_color(index: int) -> entities.Color:
    """Colours that differ from their neighbours' in the list: hues by the golden angle."""
    red, green, blue = colorsys.hsv_to_rgb((0.58 + index * 0.381966) % 1.0, 0.55, 0.92)
    return round(255 * red), round(255 * green), round(255 * blue)


def inner_point(room: Room) -> tuple[float, float]:
    """Where a room's name stands: its middle, or where that is cramped the point farthest from its walls."""
    widest = shapely.maximum_inscribed_circle(room.polygon, 0.05)
    middle = room.polygon.centroid
    roomy = room.polygon.contains(middle) and room.polygon.boundary.distance(middle) > 0.7 * widest.length
    x, y = middle.coords[0] if roomy else widest.coords[0]
    return float(x), float(y)


def write_picture(path: Path, grid: GridMap, graph: AreaGraph) -> None:
    """The map with its rooms coloured and named, passages in red; a PNG of about 1600 pixels at most."""
    rows, columns = grid.cells.shape
    step = max(1, -(-max(rows, columns) // _PICTURE_PX))
    cells, label = grid.cells[::step, ::step], graph.label[::step, ::step]
    zoom = max(1, _PICTURE_PX // max(cells.shape))
    pixels = np.repeat(cells[:, :, None], 3, axis=2)
    colors = np.array([room_color(index) for index in range(len(graph))], np.float64).reshape(-1, 3)
    inside = label >= 0
    pixels[inside] = (1 - _TRANSPARENCY) * colors[label[inside]] + _TRANSPARENCY * pixels[inside]
    image = Image.fromarray(np.ascontiguousarray(pixels[::-1])).resize(
        (cells.shape[1] * zoom, cells.shape[0] * zoom), Image.Resampling.NEAREST
    )
    draw = ImageDraw.Draw(image)
    pixels_per_m = zoom / (step * grid.cell_m)

    def at(point: Sequence[float]) -> tuple[float, float]:
        x, y = (np.asarray(point) - grid.origin) * pixels_per_m
        return float(x), float(image.height - y)

    for room in graph.rooms:
        for ring in (room.polygon.exterior, *room.polygon.interiors):
            draw.line([at(corner) for corner in ring.coords], fill=(40, 44, 52), width=1)
    for passage in graph.passages:
        draw.line([at(end) for end in passage.line], fill=(214, 40, 40), width=max(2, zoom))
    for room in graph.rooms:
        size = float(np.clip(0.16 * np.sqrt(room.area_m2) * pixels_per_m, 9, 26))
        _write_name(draw, at(inner_point(room)), room, size)
    with written_whole(path) as part:
        image.save(part, "PNG")


def _write_name(draw: ImageDraw.ImageDraw, middle: tuple[float, float], room: Room, size: float) -> None:
    """Name and area about a place; the raised 2 is drawn, for Pillow's own font has none."""
    font, small = ImageFont.load_default(size), ImageFont.load_default(0.65 * size)
    x, y = middle
    draw.text((x, y), room.name, fill=(0, 0, 0), anchor="md", font=font)
    area = f"{room.area_m2:.1f} m"
    left = x - (font.getlength(area) + small.getlength("2")) / 2
    draw.text((left, y), area, fill=(0, 0, 0), anchor="la", font=font)
    draw.text((left + font.getlength(area), y), "2", fill=(0, 0, 0), anchor="la", font=small)
