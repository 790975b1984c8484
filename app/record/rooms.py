"""Rooms: coloured floors with names and areas, passages, and their topology as a graph."""

import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import rerun as rr
import shapely

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.maps.area_graph import AreaGraph
from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.pictures import room_color, room_middle
from ffmap.app.record.building import log_grid
from ffmap.app.record.log import Log, evidence, open_log
from ffmap.app.record.shapes import TEXT_COLOR, at_height, strips, ui_radius
from ffmap.blueprints import rooms as rooms_blueprint
from ffmap.blueprints.entities import GRAPH_UNITS_PER_M, SEGMENTED, Color
from ffmap.blueprints.views import view_of

_FLOOR_M, _LINE_M, _NAME_M = 0.01, 0.04, 0.08
"""Heights (m) of floors above the grid, of lines, and of names: they must not hide each other."""
_INSETS_M = 0.0, 0.001, 0.002
"""GEOS fails to triangulate some areas whose rings touch; inset by a millimetre, they do not."""
_PASSAGE_COLOR: Color = (214, 40, 40)
_TOPOLOGY_COLOR: Color = (150, 0, 190)
_VORONOI_COLOR: Color = (54, 120, 255)
_FURNITURE_COLOR: Color = (255, 140, 0)


def write_recording(path: Path, grid: GridMap, graph: AreaGraph) -> None:
    """Write the recording of the rooms of a segmented map."""
    layout = rooms_blueprint.build(*view_of(grid))
    with open_log(path, str(uuid.uuid4()), layout=layout) as log:
        log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_grid(log, SEGMENTED, grid)
        log_rooms(log, graph)


def log_rooms(log: Log, graph: AreaGraph) -> None:
    """Log rooms, passages, topology and Voronoi graph for the whole recording."""
    log_areas(log, graph)
    inside = _inner_points(graph)
    names = [room.name for room in graph.rooms]
    if len(graph):
        # y is downwards in the view of the graph.
        positions = (inside * [1.0, -1.0] * GRAPH_UNITS_PER_M).astype(np.float32)
        edges = [(names[a], names[b]) for a, b in (passage.rooms for passage in graph.passages)]
        nodes = rr.GraphNodes(
            names, positions=positions, labels=names, show_labels=True, colors=_colors(graph)
        )
        log.static("/rooms/graph", nodes, rr.GraphEdges(edges, graph_type="undirected"))
    ways = []
    for passage in graph.passages:
        a, b = passage.rooms
        way = np.stack([inside[a], passage.line.mean(axis=0), inside[b]])
        ways.append(at_height(way, _LINE_M))
    log.static("/world/rooms/topology", strips(ways, _TOPOLOGY_COLOR, 1.5))
    skeleton = at_height(graph.skeleton, _LINE_M / 2)
    log.static("/world/rooms/voronoi", strips(skeleton, _VORONOI_COLOR, 0.75))
    furniture = at_height(graph.furniture, _LINE_M)
    points = rr.Points3D(furniture, colors=_FURNITURE_COLOR, radii=ui_radius(1.5))
    log.static("/world/rooms/furniture", points)


def log_areas(log: Log, graph: AreaGraph, root: str = "/world/rooms") -> None:
    """Log coloured floors, outlines, names with areas, and passages, below an entity."""
    if len(graph):
        _log_floors(log, graph, root)
        areas_m2 = np.array([room.area_m2 for room in graph.rooms])
        labels = [f"{room.name}, {room.area_m2:.1f} m²" for room in graph.rooms]
        names = rr.Points3D(
            at_height(_inner_points(graph), _NAME_M),
            colors=TEXT_COLOR,
            labels=labels,
            show_labels=True,
            radii=ui_radius(4.0),
        )
        log.static(f"{root}/names", names, evidence(area_m2=areas_m2))
    lines = np.array([passage.line for passage in graph.passages]).reshape(-1, 2, 2)
    labels = [" – ".join(graph.rooms[room].name for room in p.rooms) for p in graph.passages]
    drawn = strips(at_height(lines, _NAME_M), _PASSAGE_COLOR, 2.5, labels, show_labels=False)
    doors = np.array([-1 if p.door is None else p.door for p in graph.passages], np.int32)
    log.static(f"{root}/passages", drawn, evidence(door=doors))


def _colors(graph: AreaGraph) -> UInt8Array:
    return np.array([room_color(index) for index in range(len(graph))], np.uint8).reshape(-1, 3)


def _inner_points(graph: AreaGraph) -> FloatArray:
    return np.array([room_middle(room) for room in graph.rooms]).reshape(-1, 2)


def _triangles(area: shapely.Polygon) -> Sequence[shapely.Polygon]:
    """Triangulate an area; return none if it has no width, or GEOS fails."""
    for inset_m in _INSETS_M:
        with suppress(shapely.GEOSException):
            inside = area.buffer(-inset_m, join_style="mitre")
            return list(shapely.get_parts(shapely.constrained_delaunay_triangles(inside)))
    return []


def _log_floors(log: Log, graph: AreaGraph, root: str) -> None:
    colors = _colors(graph)
    corners, owner = [], []
    for index, room in enumerate(graph.rooms):
        parts = _triangles(room.polygon)
        ends = [np.asarray(part.exterior.coords)[:3] for part in parts]
        corners.append(np.array(ends).reshape(-1, 2))
        owner.append(np.full(3 * len(parts), index))
    vertices = np.concatenate(corners)
    mesh = rr.Mesh3D(
        vertex_positions=at_height(vertices, _FLOOR_M),
        triangle_indices=np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
        vertex_colors=colors[np.concatenate(owner)],
    )
    log.static(f"{root}/floors", mesh)
    rings = [
        (at_height(np.asarray(ring.coords), _LINE_M), colors[index])
        for index, room in enumerate(graph.rooms)
        for ring in (room.polygon.exterior, *room.polygon.interiors)
    ]
    outlines = strips([ring for ring, _ in rings], [color for _, color in rings], 1.5)
    log.static(f"{root}/outlines", outlines)
