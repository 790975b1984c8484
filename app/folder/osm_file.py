"""rooms.osm: the Area Graph in osmAG, the OpenStreetMap XML of the paper's laboratory.

Format: Feng et al. 2023, "osmAG: Hierarchical Semantic Topometric Area Graph Maps in the OSM Format
for Mobile Robotics". Rooms are closed ways, passages are ways of two nodes that are in the rings of
both rooms. Areas refer to each other by name: JOSM replaces the numbers of new objects.
"""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from scipy.spatial.distance import cdist

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.maps.area_graph import NO_LINES, AreaGraph
from ffmap.app.folder.atomic import written_whole

EQUATOR_M, ECCENTRICITY_SQUARED = 6378137.0, 0.00669437999014
"""Of WGS 84."""
_BUILDING, _LEVEL = "building", "0"
_ON_RING_M = 0.02
"""Distance (m) from a ring at which a passage's end is on it."""
_DEEPEST_M = 1.0
"""Maximum depth (m) of a doorway."""


def write_osm(path: Path, graph: AreaGraph) -> None:
    """Write rooms, the building around them, and passages; new objects have negative numbers."""
    rings = [_ring(graph, room) for room in range(len(graph))]
    file = _OsmFile()
    file.node((0.0, 0.0), name="root")
    inside = {"level": _LEVEL, "osmAG:parent": _BUILDING}
    if rings:
        hull = shapely.MultiPoint(np.concatenate(rings)).convex_hull
        around = np.array(hull.exterior.coords)[:-1]
        file.area(around, _BUILDING, {"level": _LEVEL, "osmAG:areaType": "structure"})
    for room, ring in zip(graph.rooms, rings, strict=True):
        file.area(ring, room.name, {"indoor": "room", "osmAG:areaType": "room"} | inside)
    for number, passage in enumerate(graph.passages):
        name = f"opening {number}" if passage.door is None else f"door {passage.door}"
        first, second = (graph.rooms[room].name for room in passage.rooms)
        joined = {"osmAG:from": first, "osmAG:to": second}
        tags = {"name": name, "level": _LEVEL, "osmAG:type": "passage"} | joined
        file.way([file.node(end) for end in passage.line], tags)
    with written_whole(path) as part:
        file.write(part)


class _OsmFile:
    """The XML of an .osm file as it grows: nodes first, each place once."""

    def __init__(self) -> None:
        self._nodes: dict[tuple[str, str], ElementTree.Element] = {}
        self._ways: list[ElementTree.Element] = []

    def node(self, place_map: Iterable[float], **tags: str) -> str:
        """Add a node at x, y (m); return its number."""
        x, y = place_map
        lat = math.degrees(y / (EQUATOR_M * (1 - ECCENTRICITY_SQUARED)))
        lon = math.degrees(x / EQUATOR_M)
        place = f"{lat:.11f}", f"{lon:.11f}"
        if place not in self._nodes:
            node = self._element("node", len(self._nodes), tags)
            node.attrib |= {"lat": place[0], "lon": place[1]}
            self._nodes[place] = node
        return self._nodes[place].attrib["id"]

    def area(self, ring: FloatArray, name: str, tags: dict[str, str]) -> None:
        """Add a ring (n, 2) without repeated end."""
        nodes = [self.node(corner) for corner in ring]
        self.way([*nodes, nodes[0]], {"name": name, "osmAG:type": "area"} | tags)

    def way(self, nodes: Sequence[str], tags: dict[str, str]) -> None:
        way = self._element("way", len(self._ways), {})
        for node in nodes:
            ElementTree.SubElement(way, "nd", ref=node)
        for key, value in tags.items():
            ElementTree.SubElement(way, "tag", k=key, v=value)
        self._ways.append(way)

    def write(self, path: Path) -> None:
        root = ElementTree.Element("osm", version="0.6", generator="ffmap", upload="false")
        root.extend([*self._nodes.values(), *self._ways])
        ElementTree.indent(root)
        ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)

    @staticmethod
    def _element(kind: str, number: int, tags: dict[str, str]) -> ElementTree.Element:
        """Make a new object as JOSM saves it; osmAG's parsers require action and visible."""
        element = ElementTree.Element(kind, id=str(-1 - number), action="modify", visible="true")
        for key, value in tags.items():
            ElementTree.SubElement(element, "tag", k=key, v=value)
        return element


def _ring(graph: AreaGraph, room: int) -> FloatArray:
    """Corners (n, 2) of a room's outline, through the ends of its passages, and cut to its holes.

    A passage that does not fit into the outline is left out of it.
    """
    outline = shapely.geometry.polygon.orient(graph.rooms[room].polygon)
    rings = [np.array(ring.coords)[:-1] for ring in (outline.exterior, *outline.interiors)]
    ends = NO_LINES.reshape(-1, 2)
    for passage in graph.passages:
        if room in passage.rooms:
            line = shapely.LineString(passage.line)
            nearest = int(np.argmin([shapely.LinearRing(ring).distance(line) for ring in rings]))
            laid = _laid_through(rings[nearest], passage.line)
            before, after = shapely.Polygon(rings[nearest]), shapely.Polygon(laid)
            moved_m2 = abs(after.area - before.area)
            others = [*rings[:nearest], laid, *rings[nearest + 1 :]]
            kept = cdist(ends, np.concatenate(others)).min(axis=1, initial=np.inf) == 0
            if after.is_valid and moved_m2 < line.length * _DEEPEST_M and kept.all():
                rings[nearest], ends = laid, np.concatenate([ends, passage.line])
    return _cut(rings)


def _laid_through(ring: FloatArray, line: FloatArray) -> FloatArray:
    """Replace the part of a ring (n, 2) between the feet of a line (2, 2) by the line."""
    closed, ends = shapely.LinearRing(ring), shapely.points(line)
    at = shapely.line_locate_point(closed, ends)
    if (at[1] - at[0]) % closed.length > closed.length / 2:
        line, ends, at = line[::-1], ends[::-1], at[::-1]
    feet = shapely.line_interpolate_point(closed, at)
    foot = shapely.get_coordinates(feet)[:, None]
    apart = shapely.distance(feet, ends) > _ON_RING_M
    corner_at = np.append(0.0, np.cumsum(np.hypot(*np.diff(ring, axis=0).T)))
    onwards = (corner_at - at[1] - _ON_RING_M) % closed.length
    others = onwards < (at[0] - at[1]) % closed.length - 2 * _ON_RING_M
    rest = ring[others][np.argsort(onwards[others])]
    return np.concatenate([line, foot[1, apart[1:]], rest, foot[0, apart[:1]]])


def _cut(rings: list[FloatArray]) -> FloatArray:
    """Join holes to the outer ring by cuts, which the ring follows there and back."""
    outer, *holes = rings
    inside = shapely.Polygon(outer, holes)
    shapely.prepare(inside)
    while holes:
        hole = holes.pop(int(np.argmin([cdist(outer, hole).min() for hole in holes])))
        pairs = np.argsort(cdist(outer, hole), axis=None)
        corners = [divmod(int(pair), len(hole)) for pair in pairs]
        free = (c for c in corners if inside.covers(shapely.LineString([outer[c[0]], hole[c[1]]])))
        i, j = next(free, corners[0])
        outer = np.concatenate([outer[: i + 1], hole[j:], hole[: j + 1], outer[i:]])
    return outer
