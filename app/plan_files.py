"""The floor plan as files: SVG to look at and print, DXF for CAD."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import shapely
from ezdxf.enums import TextEntityAlignment
from ezdxf.filemanagement import new as new_document
from ezdxf.layouts.layout import Modelspace
from ezdxf.units import M as METRES

from algorithms.doors import DoorState
from algorithms.floor_plan import FloorPlan, Leaf, PlanDoor
from algorithms.scan import FloatArray
from app.files import write_atomically

MM_PER_M = 10.0
"""The SVG is drawn at a scale of 1:100."""
_MARGIN_M = 1.0
_FOOT_M = 2.0
_WIDTH_MIN_M = 16.5
"""So wide are the scale bar and the legend."""
_ROOM_FILLS = ("#eef4fb", "#fdf3e3", "#eef7ea", "#f8edf4", "#f6f4e4", "#e9f5f5")
_STYLE = """
.room { stroke: none; }
.wall, .column { fill: #2b2f36; stroke: #2b2f36; stroke-width: 0.1; fill-rule: evenodd; }
.assumed { fill: url(#hatch); stroke: #2b2f36; stroke-width: 0.18; fill-rule: evenodd; }
.doorway { fill: #ffffff; stroke: none; }
.leaf { fill: none; stroke: #1d5fd0; stroke-width: 0.4; stroke-linecap: round; }
.swing { fill: none; stroke: #1d5fd0; stroke-width: 0.15; }
.unknown { fill: none; stroke: #1d5fd0; stroke-width: 0.2; stroke-dasharray: 1 0.8; }
.window { fill: #ffffff; stroke: #2b2f36; stroke-width: 0.15; }
.pane { fill: none; stroke: #2b2f36; stroke-width: 0.15; }
.frame { fill: none; stroke: #2b2f36; stroke-width: 0.25; }
text { font-family: Helvetica, Arial, sans-serif; font-size: 3px; fill: #2b2f36; }
.name { font-weight: bold; text-anchor: middle; }
.area { text-anchor: middle; font-size: 2.6px; }
.middle { text-anchor: middle; }
"""

LAYERS = {
    "WALLS": 7,
    "WALLS_ONE_SIDE_SEEN": 8,
    "COLUMNS": 7,
    "DOORS": 5,
    "WINDOWS": 4,
    "ROOMS": 3,
    "ROOM_NAMES": 3,
}
"""Layers of the DXF file with their colours (AutoCAD's colour index)."""


def write_svg(path: Path, plan: FloorPlan, title: str) -> None:
    """The plan at 1:100 with room names and areas, a scale bar, the map's axes and a legend; +y of the map is up."""
    low_x, low_y, high_x, high_y = plan.bounds
    sheet = _Sheet(low_x - _MARGIN_M, high_y + _MARGIN_M)
    width_m = max(high_x - low_x + 2 * _MARGIN_M, _WIDTH_MIN_M)
    height_m = high_y - low_y + 2 * _MARGIN_M + _FOOT_M
    width, height = width_m * MM_PER_M, height_m * MM_PER_M
    svg = ElementTree.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{width:.1f}mm",
            "height": f"{height:.1f}mm",
            "viewBox": f"0 0 {width:.2f} {height:.2f}",
        },
    )
    ElementTree.SubElement(svg, "title").text = title
    ElementTree.SubElement(svg, "style").text = _STYLE
    _add_hatch(svg)
    ElementTree.SubElement(svg, "rect", {"width": f"{width:.2f}", "height": f"{height:.2f}", "fill": "white"})
    for i, room in enumerate(plan.rooms):
        sheet.area(_group(svg, "rooms"), "room", room.polygon, fill=_ROOM_FILLS[i % len(_ROOM_FILLS)])
    for kind, polygons in (("assumed", plan.assumed), ("wall", plan.walls), ("column", plan.columns)):
        group = _group(svg, f"{kind}s")
        for polygon in polygons:
            sheet.area(group, kind, polygon)
    group = _group(svg, "windows")
    for window in plan.windows:
        sheet.area(group, "window", window)
        sheet.line(group, "pane", _pane(window))
    group = _group(svg, "doors")
    for door in plan.doors:
        sheet.area(group, "doorway", door.outline.buffer(0.01, join_style="mitre"))
        _draw_door(sheet, group, door)
    group = _group(svg, "room-names")
    for room in plan.rooms:
        place = room.polygon.representative_point()
        sheet.text(group, "name", room.name, (place.x, place.y))
        sheet.text(group, "area", f"{room.area_m2:.1f} m²", (place.x, place.y - 0.38))
    _draw_foot(svg, title, width, height)
    ElementTree.indent(svg)
    text = ElementTree.tostring(svg, encoding="unicode", xml_declaration=True)
    write_atomically(path, lambda part: part.write_text(text + "\n", "utf-8"))


class _Sheet:
    """Places of the map on paper: millimetres, y down."""

    def __init__(self, left_m: float, top_m: float) -> None:
        self._left_m, self._top_m = left_m, top_m

    def place(self, xy: Sequence[float] | FloatArray) -> tuple[float, float]:
        return (float(xy[0]) - self._left_m) * MM_PER_M, (self._top_m - float(xy[1])) * MM_PER_M

    def area(self, parent: ElementTree.Element, kind: str, polygon: shapely.Polygon, fill: str | None = None) -> None:
        rings = [polygon.exterior, *polygon.interiors]
        path = " ".join("M" + " L".join(self._words(xy) for xy in ring.coords[:-1]) + " Z" for ring in rings)
        extra = {"fill": fill} if fill else {}
        ElementTree.SubElement(parent, "path", {"class": kind, "d": path, **extra})

    def line(self, parent: ElementTree.Element, kind: str, ends: FloatArray) -> None:
        path = "M" + " L".join(self._words(xy) for xy in ends)
        ElementTree.SubElement(parent, "path", {"class": kind, "d": path})

    def arc(self, parent: ElementTree.Element, centre: FloatArray, start: FloatArray, swing_deg: float) -> None:
        """From `start` around `centre` by an angle, counter-clockwise in the map."""
        radius = MM_PER_M * float(np.linalg.norm(start - centre))
        end = centre + _turned(start - centre, swing_deg)
        # On paper y points down, which turns the sense around.
        sweep = 0 if swing_deg > 0 else 1
        path = f"M{self._words(start)} A{radius:.2f} {radius:.2f} 0 0 {sweep} {self._words(end)}"
        ElementTree.SubElement(parent, "path", {"class": "swing", "d": path})

    def text(self, parent: ElementTree.Element, kind: str, words: str, xy: Sequence[float]) -> None:
        x, y = self.place(xy)
        ElementTree.SubElement(parent, "text", {"class": kind, "x": f"{x:.2f}", "y": f"{y:.2f}"}).text = words

    def _words(self, xy: Sequence[float] | FloatArray) -> str:
        x, y = self.place(xy)
        return f"{x:.2f},{y:.2f}"


def _group(svg: ElementTree.Element, name: str) -> ElementTree.Element:
    found = svg.find(f"g[@id='{name}']")
    return found if found is not None else ElementTree.SubElement(svg, "g", {"id": name})


def _add_hatch(svg: ElementTree.Element) -> None:
    defs = ElementTree.SubElement(svg, "defs")
    pattern = ElementTree.SubElement(
        defs,
        "pattern",
        {"id": "hatch", "width": "1", "height": "1", "patternUnits": "userSpaceOnUse", "patternTransform": "rotate(45)"},
    )
    ElementTree.SubElement(pattern, "rect", {"width": "1", "height": "1", "fill": "#c9ccd2"})
    ElementTree.SubElement(pattern, "rect", {"width": "0.35", "height": "1", "fill": "#7d838d"})


def _draw_door(sheet: _Sheet, group: ElementTree.Element, door: PlanDoor) -> None:
    for leaf in door.leaves:
        sheet.line(group, "leaf", np.stack([leaf.hinge, leaf.tip]))
        # An architect's leaf stands at a right angle to its wall; here it stands as it was seen.
        sheet.arc(group, leaf.hinge, _shut_tip(leaf), leaf.swing_deg)
    if door.state == DoorState.CLOSED:
        sheet.line(group, "leaf", door.closed)
    elif not door.leaves:
        sheet.line(group, "unknown", door.sill)


def _shut_tip(leaf: Leaf) -> FloatArray:
    """Where the leaf's free edge is when it is shut."""
    return leaf.hinge + _turned(leaf.tip - leaf.hinge, -leaf.swing_deg)


def _turned(vector: FloatArray, angle_deg: float) -> FloatArray:
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _pane(window: shapely.Polygon) -> FloatArray:
    """(2, 2) the line in the middle of a window's cut, along the wall."""
    corners = np.array(window.exterior.coords)[:4]
    return np.array([(corners[0] + corners[3]) / 2, (corners[1] + corners[2]) / 2])


def _draw_foot(svg: ElementTree.Element, title: str, width: float, height: float) -> None:
    """Title, scale bar, the map's axes, and what the fills mean."""
    foot = _group(svg, "foot")
    top = height - _FOOT_M * MM_PER_M

    def add(tag: str, words: str | None = None, **attributes: str | float) -> None:
        values = {name.rstrip("_"): str(value) for name, value in attributes.items()}
        ElementTree.SubElement(foot, tag, values).text = words

    add("path", class_="frame", d=f"M4,{top:.2f} L{width - 4:.2f},{top:.2f}")
    add("text", f"{title} · scale 1:100 · metres", class_="title", x=6, y=f"{top + 5:.2f}")
    for metre in range(5):
        fill = "#2b2f36" if metre % 2 == 0 else "#ffffff"
        left = 6 + metre * MM_PER_M
        add("rect", class_="frame", x=left, y=f"{top + 9:.2f}", width=MM_PER_M, height=1.6, style=f"fill:{fill}")
    for metre in range(6):
        add("text", f"{metre}", class_="middle", x=6 + metre * MM_PER_M, y=f"{top + 14.5:.2f}")
    add("text", "m", x=6 + 5 * MM_PER_M + 2, y=f"{top + 14.5:.2f}")
    x, y = 72.0, top + 15.0
    add("path", class_="frame", d=f"M{x},{y - 8} L{x},{y} L{x + 8},{y} M{x + 6.6},{y - 1} L{x + 8},{y} L{x + 6.6},{y + 1} "
        f"M{x - 1},{y - 6.6} L{x},{y - 8} L{x + 1},{y - 6.6}")  # fmt: skip
    add("text", "x", x=x + 9, y=y + 1)
    add("text", "y", x=x - 3, y=y - 7)
    legend = [
        ("wall", "wall, both sides seen"),
        ("assumed", "wall, one side seen, its thickness assumed"),
    ]
    for row, (kind, words) in enumerate(legend):
        y = top + 8 + 5.5 * row
        add("rect", class_=kind, x=88, y=y, width=5, height=2.5)
        add("text", words, x=95, y=y + 2.4)


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Closed polylines with solid hatches, arcs and texts on `LAYERS`, in metres of the map frame."""
    document = new_document("R2010", setup=True)
    document.units = METRES
    for name, colour in LAYERS.items():
        document.layers.add(name, color=colour)
    space = document.modelspace()
    for layer, polygons, filled in (
        ("WALLS", plan.walls, True),
        ("WALLS_ONE_SIDE_SEEN", plan.assumed, False),
        ("COLUMNS", plan.columns, True),
        ("WINDOWS", plan.windows, False),
        ("ROOMS", [room.polygon for room in plan.rooms], False),
    ):
        for polygon in polygons:
            _add_polygon(space, polygon, layer, filled)
    for window in plan.windows:
        space.add_lwpolyline(_pane(window).tolist(), dxfattribs={"layer": "WINDOWS"})
    for door in plan.doors:
        _add_door(space, door)
    for room in plan.rooms:
        place = room.polygon.representative_point()
        for words, height, y in ((room.name, 0.25, place.y), (f"{room.area_m2:.1f} m²", 0.2, place.y - 0.35)):
            text = space.add_text(words, height=height, dxfattribs={"layer": "ROOM_NAMES"})
            text.set_placement((place.x, y), align=TextEntityAlignment.MIDDLE_CENTER)
    write_atomically(path, lambda part: document.saveas(part))


def _add_polygon(space: Modelspace, polygon: shapely.Polygon, layer: str, filled: bool) -> None:
    rings = [list(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    for ring in rings:
        space.add_lwpolyline(ring, close=True, dxfattribs={"layer": layer})
    if filled:
        hatch = space.add_hatch(color=256, dxfattribs={"layer": layer})
        for i, ring in enumerate(rings):
            hatch.paths.add_polyline_path(ring, is_closed=True, flags=1 if i == 0 else 16)


def _add_door(space: Modelspace, door: PlanDoor) -> None:
    attributes = {"layer": "DOORS"}
    _add_polygon(space, door.outline, "DOORS", filled=False)
    if door.state == DoorState.CLOSED:
        space.add_lwpolyline(door.closed.tolist(), dxfattribs=attributes)
    for leaf in door.leaves:
        space.add_line(tuple(leaf.hinge), tuple(leaf.tip), dxfattribs=attributes)
        angles = [
            float(np.degrees(np.arctan2(*(end - leaf.hinge)[::-1]))) for end in (_shut_tip(leaf), leaf.tip)
        ]
        start, end = angles if leaf.swing_deg > 0 else angles[::-1]
        radius = float(np.linalg.norm(leaf.tip - leaf.hinge))
        space.add_arc(tuple(leaf.hinge), radius, start, end, dxfattribs=attributes)
