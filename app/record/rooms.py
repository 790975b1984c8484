"""Rooms as Rerun entities: coloured floors with names and areas, and their topology as a graph."""

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
from ffmap.app.folder.pictures import inner_point, room_color
from ffmap.app.record.building import log_grid
from ffmap.app.record.log import Log, evidence, open_log
from ffmap.app.record.shapes import at_height, strips, ui_radius
from ffmap.blueprints import entities
from ffmap.blueprints import rooms as rooms_blueprint
from ffmap.blueprints.run import view_of

_FLOOR_M, _LINE_M, _NAME_M = 0.01, 0.04, 0.08
"""Heights in metres: rooms lie above the grid, lines above the rooms, passages and names above all; else one would hide another."""

_INSETS_M = 0.0, 0.001, 0.002
"""GEOS fails to triangulate some areas whose rings touch each other; a millimetre within the area, they do not touch."""


def write_recording(path: Path, grid: GridMap, graph: AreaGraph) -> None:
    """Write a segmented map with its rooms, and the viewer's layout."""
    with open_log(path, str(uuid.uuid4()), layout=rooms_blueprint.build(*view_of(grid))) as log:
        log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        log_grid(log, entities.SEGMENTED, grid)
        log_rooms(log, graph)


def log_rooms(log: Log, graph: AreaGraph) -> None:
    """Rooms, passages, topology and Voronoi graph; they hold for the whole recording."""
    log_areas(log, graph)
    inside = _inner_points(graph)
    names = [room.name for room in graph.rooms]
    if len(graph):
        # The graph's view has y downwards, and units of its own.
        positions = (inside * [1.0, -1.0] * entities.GRAPH_UNITS_PER_M).astype(np.float32)
        log.static(
            entities.ROOM_GRAPH,
            rr.GraphNodes(names, positions=positions, labels=names, show_labels=True, colors=_colors(graph)),
            rr.GraphEdges(
                [(names[a], names[b]) for a, b in (p.rooms for p in graph.passages)], graph_type="undirected"
            ),
        )
    ways = [
        at_height(np.stack([inside[p.rooms[0]], p.line.mean(axis=0), inside[p.rooms[1]]]), _LINE_M)
        for p in graph.passages
    ]
    log.static(entities.ROOM_TOPOLOGY, strips(ways, entities.TOPOLOGY_COLOR, 1.5))
    log.static(entities.ROOM_VORONOI, strips(at_height(graph.skeleton, _LINE_M / 2), entities.VORONOI_COLOR, 0.75))
    furniture = at_height(graph.furniture, _LINE_M)
    log.static(entities.ROOM_FURNITURE, rr.Points3D(furniture, colors=entities.FURNITURE_COLOR, radii=ui_radius(1.5)))


def log_areas(log: Log, graph: AreaGraph, root: str = entities.ROOMS) -> None:
    """Coloured floors, outlines, names with areas, and passages, below an entity."""
    if len(graph):
        _log_floors(log, graph, root)
        log.static(
            f"{root}/{entities.ROOM_NAMES}",
            rr.Points3D(
                at_height(_inner_points(graph), _NAME_M),
                colors=entities.TRUTH_COLOR,
                labels=[f"{room.name}, {room.area_m2:.1f} m²" for room in graph.rooms],
                show_labels=True,
                radii=ui_radius(4.0),
            ),
            evidence(area_m2=np.array([room.area_m2 for room in graph.rooms])),
        )
    lines = np.array([passage.line for passage in graph.passages]).reshape(-1, 2, 2)
    labels = [" – ".join(graph.rooms[room].name for room in passage.rooms) for passage in graph.passages]
    log.static(
        f"{root}/{entities.ROOM_PASSAGES}",
        strips(at_height(lines, _NAME_M), entities.PASSAGE_COLOR, 2.5, labels, show_labels=False),
        evidence(door=np.array([-1 if p.door is None else p.door for p in graph.passages], np.int32)),
    )


def _colors(graph: AreaGraph) -> UInt8Array:
    return np.array([room_color(index) for index in range(len(graph))], np.uint8).reshape(-1, 3)


def _inner_points(graph: AreaGraph) -> FloatArray:
    return np.array([inner_point(room) for room in graph.rooms]).reshape(-1, 2)


def _triangles(area: shapely.Polygon) -> Sequence[shapely.Polygon]:
    """Triangulate an area; empty where it has no width, or where GEOS fails."""
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
        corners.append(np.array([np.asarray(part.exterior.coords)[:3] for part in parts]).reshape(-1, 2))
        owner.append(np.full(3 * len(parts), index))
    vertices = np.concatenate(corners)
    log.static(
        f"{root}/{entities.ROOM_FLOORS}",
        rr.Mesh3D(
            vertex_positions=at_height(vertices, _FLOOR_M),
            triangle_indices=np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
            vertex_colors=colors[np.concatenate(owner)],
        ),
    )
    rings = [
        (at_height(np.asarray(ring.coords), _LINE_M), colors[index])
        for index, room in enumerate(graph.rooms)
        for ring in (room.polygon.exterior, *room.polygon.interiors)
    ]
    outlines = strips([ring for ring, _ in rings], [color for _, color in rings], 1.5)
    log.static(f"{root}/{entities.ROOM_OUTLINES}", outlines)
