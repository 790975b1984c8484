"""Rooms as Rerun entities: coloured floors with names and areas, and their topology as a graph."""

import uuid
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rerun as rr
import shapely

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.maps.area_graph import AreaGraph
from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.room_files import inner_point, room_color
from ffmap.app.record.building import log_grid
from ffmap.app.record.log import Log, evidence
from ffmap.app.record.stream import open_part
from ffmap.blueprints import entities
from ffmap.blueprints import rooms as rooms_blueprint
from ffmap.blueprints.run import view_of

_FLOOR_M = 0.01
_LINE_M = 0.04
_NAME_M = 0.08
"""Rooms lie so far above the grid, lines above the rooms, passages and names above all: else one would hide another."""


def prepare_recording(grid: GridMap) -> Callable[[Path, AreaGraph], None]:
    """All that needs no rooms of a segmented map's recording; what is returned writes it, its layout inside."""
    blueprint = rooms_blueprint.build(*view_of(grid))

    def write(path: Path, graph: AreaGraph) -> None:
        with open_part(path, str(uuid.uuid4())) as stream:
            stream.send_blueprint(blueprint, make_active=True, make_default=True)
            stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            log_grid(Log(stream), entities.SEGMENTED, grid)
            log_rooms(stream, graph)

    return write


def log_rooms(stream: rr.RecordingStream, graph: AreaGraph) -> None:
    """Rooms, passages, topology and Voronoi graph; they hold for the whole recording."""
    log_areas(stream, graph)
    inside = _inner_points(graph)
    if len(graph):
        stream.log(
            entities.ROOM_GRAPH,
            rr.GraphNodes(
                [room.name for room in graph.rooms],
                # The graph's view has y downwards; a metre is so many of its units.
                positions=(inside * [1.0, -1.0] * entities.GRAPH_UNITS_PER_M).astype(np.float32),
                labels=[room.name for room in graph.rooms],
                show_labels=True,
                colors=_colors(graph),
            ),
            rr.GraphEdges(
                [(graph.rooms[a].name, graph.rooms[b].name) for a, b in (passage.rooms for passage in graph.passages)],
                graph_type="undirected",
            ),
            static=True,
        )
    ways = [np.stack([inside[p.rooms[0]], p.line.mean(axis=0), inside[p.rooms[1]]]) for p in graph.passages]
    stream.log(
        entities.ROOM_TOPOLOGY,
        rr.LineStrips3D(
            [_at_height(way, _LINE_M) for way in ways], colors=entities.TOPOLOGY_COLOR, radii=rr.Radius.ui_points(1.5)
        ),
        static=True,
    )
    stream.log(
        entities.ROOM_VORONOI,
        rr.LineStrips3D(
            _at_height(graph.skeleton, _LINE_M / 2), colors=entities.VORONOI_COLOR, radii=rr.Radius.ui_points(0.75)
        ),
        static=True,
    )
    stream.log(
        entities.ROOM_FURNITURE,
        rr.Points3D(
            _at_height(graph.furniture, _LINE_M), colors=entities.FURNITURE_COLOR, radii=rr.Radius.ui_points(1.5)
        ),
        static=True,
    )


def log_areas(stream: rr.RecordingStream, graph: AreaGraph, root: str = entities.ROOMS) -> None:
    """Coloured floors, outlines, names with areas, and passages, below an entity."""
    if len(graph):
        _log_floors(stream, graph, root)
        stream.log(
            f"{root}/{entities.ROOM_NAMES}",
            rr.Points3D(
                _at_height(_inner_points(graph), _NAME_M),
                colors=entities.TRUTH_COLOR,
                labels=[f"{room.name}, {room.area_m2:.1f} m²" for room in graph.rooms],
                show_labels=True,
                radii=rr.Radius.ui_points(4.0),
            ),
            evidence({"area_m2": np.array([room.area_m2 for room in graph.rooms])}),
            static=True,
        )
    lines = np.array([passage.line for passage in graph.passages]).reshape(-1, 2, 2)
    stream.log(
        f"{root}/{entities.ROOM_PASSAGES}",
        rr.LineStrips3D(
            _at_height(lines, _NAME_M),
            colors=entities.PASSAGE_COLOR,
            radii=rr.Radius.ui_points(2.5),
            labels=[" – ".join(graph.rooms[room].name for room in passage.rooms) for passage in graph.passages],
            show_labels=False,
        ),
        evidence({"door": np.array([-1 if p.door is None else p.door for p in graph.passages], np.int32)}),
        static=True,
    )


def _colors(graph: AreaGraph) -> UInt8Array:
    return np.array([room_color(index) for index in range(len(graph))], np.uint8).reshape(-1, 3)


def _inner_points(graph: AreaGraph) -> FloatArray:
    return np.array([inner_point(room) for room in graph.rooms]).reshape(-1, 2)


def _log_floors(stream: rr.RecordingStream, graph: AreaGraph, root: str) -> None:
    colors = _colors(graph)
    corners, owner = [], []
    for index, room in enumerate(graph.rooms):
        parts = shapely.get_parts(shapely.constrained_delaunay_triangles(room.polygon))
        corners.append(np.array([np.asarray(part.exterior.coords)[:3] for part in parts]).reshape(-1, 2))
        owner.append(np.full(3 * len(parts), index))
    vertices, owners = np.concatenate(corners), np.concatenate(owner)
    stream.log(
        f"{root}/{entities.ROOM_FLOORS}",
        rr.Mesh3D(
            vertex_positions=_at_height(vertices, _FLOOR_M),
            triangle_indices=np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
            vertex_colors=colors[owners],
        ),
        static=True,
    )
    rings = [
        (np.asarray(ring.coords), index)
        for index, room in enumerate(graph.rooms)
        for ring in (room.polygon.exterior, *room.polygon.interiors)
    ]
    stream.log(
        f"{root}/{entities.ROOM_OUTLINES}",
        rr.LineStrips3D(
            [_at_height(ring, _LINE_M) for ring, _ in rings],
            colors=[colors[index] for _, index in rings],
            radii=rr.Radius.ui_points(1.5),
        ),
        static=True,
    )


def _at_height(points_map: FloatArray, height_m: float) -> FloatArray:
    widths = [(0, 0)] * (points_map.ndim - 1) + [(0, 1)]
    return np.pad(points_map, widths, constant_values=height_m).astype(np.float32)
