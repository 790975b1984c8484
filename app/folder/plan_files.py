"""The floor plan as files: SVG to look at and print, DXF for CAD."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.floor_plan import FloorPlan, Leaf, PlanDoor
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.atomic import write_text, written_whole

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts.layout import Modelspace

MM_PER_M = 10.0
"""The SVG is drawn at a scale of 1:100."""
_MARGIN_M = 1.0
_WIDTH_MIN_M = 16.5
"""Width in metres that the scale bar, the map's axes and two columns of the legend take."""
_FOOT_HEAD_MM = 31.0
_LEGEND_ROW_MM, _LEGEND_COLUMN_MM = 5.5, 78.0
_SYMBOL_MM = (9.0, 3.0)
_ROOM_FILLS = ("#eef4fb", "#fdf3e3", "#eef7ea", "#f8edf4", "#f6f4e4", "#e9f5f5")
_STYLE = """
.room { stroke: none; }
.wall { fill: #2b2f36; stroke: #2b2f36; stroke-width: 0.1; fill-rule: evenodd; }
.column { fill: #8a6a4f; stroke: #2b2f36; stroke-width: 0.25; fill-rule: evenodd; }
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

LAYERS = {"WALLS": 7, "WALLS_ONE_SIDE_SEEN": 8, "COLUMNS": 7, "DOORS": 5, "WINDOWS": 4, "ROOMS": 3, "ROOM_NAMES": 3}
"""Layers of the DXF file with their colours (AutoCAD's colour index)."""


def write_svg(path: Path, plan: FloorPlan, title: str) -> None:
    """The plan at 1:100 with room names and areas, a scale bar, the map's axes and a legend of what occurs on it.

    It is drawn square to most walls: the map's axes, which lie as the robot first stood, are turned by up to 45°.
    """
    low, high = _extent(plan)
    sheet = _Sheet(float(low[0]) - _MARGIN_M, float(high[1]) + _MARGIN_M, plan.direction_deg)
    legend = _legend(plan)
    width = MM_PER_M * max(float(high[0] - low[0]) + 2 * _MARGIN_M, _WIDTH_MIN_M)
    columns = int((width - 6) / _LEGEND_COLUMN_MM)
    foot = _FOOT_HEAD_MM + _LEGEND_ROW_MM * math.ceil(len(legend) / columns)
    height = MM_PER_M * (float(high[1] - low[1]) + 2 * _MARGIN_M) + foot
    size = {"width": f"{width:.1f}mm", "height": f"{height:.1f}mm", "viewBox": f"0 0 {width:.2f} {height:.2f}"}
    svg = ElementTree.Element("svg", {"xmlns": "http://www.w3.org/2000/svg", **size})
    _add(svg, "title", title)
    _add(svg, "style", _STYLE)
    units = {"patternUnits": "userSpaceOnUse", "patternTransform": "rotate(45)"}
    hatch = _add(_add(svg, "defs"), "pattern", id="hatch", width=1, height=1, **units)
    _add(hatch, "rect", width=1, height=1, fill="#c9ccd2")
    _add(hatch, "rect", width=0.35, height=1, fill="#7d838d")
    _add(svg, "rect", width=f"{width:.2f}", height=f"{height:.2f}", fill="white")
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
        sheet.text(group, "area", f"{room.area_m2:.1f} m²", (place.x, place.y), below_mm=3.8)
    _draw_foot(_group(svg, "foot"), title, plan.direction_deg, width, height - foot)
    _draw_legend(_group(svg, "legend"), legend, columns, height - foot + _FOOT_HEAD_MM)
    ElementTree.indent(svg)
    write_text(path, ElementTree.tostring(svg, encoding="unicode", xml_declaration=True) + "\n")


def _extent(plan: FloorPlan) -> tuple[FloatArray, FloatArray]:
    """Least and largest x and y (2,) of everything on the plan, as it is turned; zeros where nothing is drawn."""
    areas = [*plan.walls, *plan.assumed, *plan.columns, *plan.windows, *(door.outline for door in plan.doors)]
    areas += [room.polygon for room in plan.rooms]
    tips = [tip for door in plan.doors for leaf in door.leaves for tip in (leaf.tip, _shut_tip(leaf))]
    places = np.concatenate([shapely.get_coordinates(areas), np.reshape(tips, (-1, 2))])
    if not len(places):
        return np.zeros(2), np.zeros(2)
    on_paper = turned(places, -plan.direction_deg)
    return on_paper.min(axis=0), on_paper.max(axis=0)


class _Sheet:
    """Places of the map on paper: millimetres, y down, turned so that the walls stand square."""

    def __init__(self, left_m: float, top_m: float, direction_deg: float) -> None:
        self._left_m, self._top_m, self._direction_deg = left_m, top_m, direction_deg

    def place(self, xy: Sequence[float] | FloatArray) -> tuple[float, float]:
        x, y = turned(np.asarray(xy, float), -self._direction_deg)
        return (float(x) - self._left_m) * MM_PER_M, (self._top_m - float(y)) * MM_PER_M

    def area(self, parent: ElementTree.Element, kind: str, polygon: shapely.Polygon, fill: str | None = None) -> None:
        rings = [polygon.exterior, *polygon.interiors]
        path = " ".join("M" + " L".join(self._words(xy) for xy in ring.coords[:-1]) + " Z" for ring in rings)
        _add(parent, "path", class_=kind, d=path, **({"fill": fill} if fill else {}))

    def line(self, parent: ElementTree.Element, kind: str, ends: FloatArray) -> None:
        _add(parent, "path", class_=kind, d="M" + " L".join(self._words(xy) for xy in ends))

    def arc(self, parent: ElementTree.Element, centre: FloatArray, start: FloatArray, swing_deg: float) -> None:
        """From `start` around `centre` by an angle, counter-clockwise in the map."""
        radius = MM_PER_M * float(np.linalg.norm(start - centre))
        end = centre + turned(start - centre, swing_deg)
        # On paper y points down, which turns the sense around.
        sweep = 0 if swing_deg > 0 else 1
        path = f"M{self._words(start)} A{radius:.2f} {radius:.2f} 0 0 {sweep} {self._words(end)}"
        _add(parent, "path", class_="swing", d=path)

    def text(
        self, parent: ElementTree.Element, kind: str, words: str, xy: Sequence[float], below_mm: float = 0.0
    ) -> None:
        x, y = self.place(xy)
        _add(parent, "text", words, class_=kind, x=f"{x:.2f}", y=f"{y + below_mm:.2f}")

    def _words(self, xy: Sequence[float] | FloatArray) -> str:
        x, y = self.place(xy)
        return f"{x:.2f},{y:.2f}"


def _group(svg: ElementTree.Element, name: str) -> ElementTree.Element:
    found = svg.find(f"g[@id='{name}']")
    return found if found is not None else ElementTree.SubElement(svg, "g", {"id": name})


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
    return leaf.hinge + turned(leaf.tip - leaf.hinge, -leaf.swing_deg)


def _pane(window: shapely.Polygon) -> FloatArray:
    """(2, 2) the line in the middle of a window's cut, along the wall."""
    corners = np.array(window.exterior.coords)[:4]
    return np.array([(corners[0] + corners[3]) / 2, (corners[1] + corners[2]) / 2])


def _draw_foot(foot: ElementTree.Element, title: str, direction_deg: float, width: float, top: float) -> None:
    """Title, scale bar and the map's axes."""
    _add(foot, "path", class_="frame", d=f"M4,{top:.2f} L{width - 4:.2f},{top:.2f}")
    _add(foot, "text", f"{title} · scale 1:100 · metres", class_="title", x=6, y=f"{top + 6:.2f}")
    for metre in range(5):
        left, style = 6 + metre * MM_PER_M, "fill:#ffffff" if metre % 2 else "fill:#2b2f36"
        _add(foot, "rect", class_="frame", x=left, y=f"{top + 13:.2f}", width=MM_PER_M, height=1.6, style=style)
    for metre in range(6):
        _add(foot, "text", f"{metre}", class_="middle", x=6 + metre * MM_PER_M, y=f"{top + 18.5:.2f}")
    _add(foot, "text", "m", x=6 + 5 * MM_PER_M + 2, y=f"{top + 18.5:.2f}")
    origin = np.array([80.0, top + 18.0])
    for name, angle_deg in (("x", 0.0), ("y", 90.0)):
        towards = turned(np.array([1.0, 0.0]), angle_deg - direction_deg) * [1.0, -1.0]
        tip = origin + 8 * towards
        barbs = [tip - 1.6 * turned(towards, side) for side in (-35.0, 35.0)]
        strokes = [(origin, tip), *((barb, tip) for barb in barbs)]
        line = " ".join(f"M{a[0]:.2f},{a[1]:.2f} L{b[0]:.2f},{b[1]:.2f}" for a, b in strokes)
        _add(foot, "path", class_="frame", d=line)
        x, y = origin + 10.5 * towards
        _add(foot, "text", name, class_="middle", x=f"{x:.2f}", y=f"{y + 1:.2f}")
    _add(foot, "text", "axes of the map's coordinates,", x=95, y=f"{top + 15:.2f}")
    by_deg = f"{round(-direction_deg, 1) + 0.0:.1f}".replace("-", "−")
    _add(foot, "text", f"turned by {by_deg}° to draw walls square", x=95, y=f"{top + 19:.2f}")


_Symbol = Callable[[ElementTree.Element, float, float], None]
"""Puts an example into a group of the legend, with its upper left corner at x, y, `_SYMBOL_MM` large."""


def _legend(plan: FloorPlan) -> list[tuple[str, _Symbol]]:
    """What occurs on the plan, and nothing else: in words, and how it is drawn."""
    closed = [door.state == DoorState.CLOSED for door in plan.doors]
    unseen = [not shut and not door.leaves for shut, door in zip(closed, plan.doors, strict=True)]
    entries = [
        (plan.walls, "wall, both sides seen", _block("wall")),
        (plan.assumed, "wall, one side seen, its thickness assumed", _block("assumed")),
        (plan.columns, "column", _block("column")),
        (plan.windows, "window", _window_symbol),
        (any(closed), "closed door", _in_wall("leaf")),
        (any(door.leaves for door in plan.doors), "open door, its leaf as it stood", _swing_symbol),
        (any(unseen), "open doorway, no leaf seen", _in_wall("unknown")),
        (plan.rooms, "room as far as seen; colours tell rooms apart", _room_symbol),
    ]
    return [(words, draw) for occurs, words, draw in entries if occurs]


def _draw_legend(group: ElementTree.Element, legend: Sequence[tuple[str, _Symbol]], columns: int, top: float) -> None:
    for place, (words, draw) in enumerate(legend):
        x, y = 6 + _LEGEND_COLUMN_MM * (place % columns), top + _LEGEND_ROW_MM * (place // columns) - 4
        draw(group, x, y)
        _add(group, "text", words, x=x + _SYMBOL_MM[0] + 3, y=f"{y + 2.6:.2f}")


def _block(kind: str) -> _Symbol:
    def draw(group: ElementTree.Element, x: float, y: float) -> None:
        _add(group, "rect", class_=kind, x=x, y=f"{y:.2f}", width=_SYMBOL_MM[0], height=_SYMBOL_MM[1])

    return draw


def _in_wall(kind: str) -> _Symbol:
    """A doorway between two ends of wall, with a line of this kind across."""

    def draw(group: ElementTree.Element, x: float, y: float) -> None:
        _wall_ends(group, x, y)
        _add(group, "path", class_=kind, d=f"M{x + 1.5:.2f},{y + 1.5:.2f} L{x + 7.5:.2f},{y + 1.5:.2f}")

    return draw


def _swing_symbol(group: ElementTree.Element, x: float, y: float) -> None:
    for left in (x, x + 5.0):
        _add(group, "rect", class_="wall", x=left, y=f"{y + 2:.2f}", width=1.5, height=1.5)
    _add(group, "path", class_="leaf", d=f"M{x + 1.5:.2f},{y + 2:.2f} L{x + 1.5:.2f},{y - 1.5:.2f}")
    _add(group, "path", class_="swing", d=f"M{x + 5:.2f},{y + 2:.2f} A3.5 3.5 0 0 0 {x + 1.5:.2f},{y - 1.5:.2f}")


def _wall_ends(group: ElementTree.Element, x: float, y: float) -> None:
    for left in (x, x + 7.5):
        _add(group, "rect", class_="wall", x=left, y=f"{y + 0.5:.2f}", width=1.5, height=2)


def _window_symbol(group: ElementTree.Element, x: float, y: float) -> None:
    _wall_ends(group, x, y)
    _add(group, "rect", class_="window", x=x + 1.5, y=f"{y + 0.5:.2f}", width=6, height=2)
    _add(group, "path", class_="pane", d=f"M{x + 1.5:.2f},{y + 1.5:.2f} L{x + 7.5:.2f},{y + 1.5:.2f}")


def _room_symbol(group: ElementTree.Element, x: float, y: float) -> None:
    for left, fill in zip((x, x + 3.0, x + 6.0), _ROOM_FILLS, strict=False):
        _add(group, "rect", class_="room", x=left, y=f"{y:.2f}", width=3, height=_SYMBOL_MM[1], fill=fill)


def _add(
    parent: ElementTree.Element, tag: str, words: str | None = None, **attributes: str | float
) -> ElementTree.Element:
    added = ElementTree.SubElement(parent, tag, {name.rstrip("_"): str(value) for name, value in attributes.items()})
    added.text = words
    return added


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Closed polylines with solid hatches, arcs and texts on `LAYERS`, in metres of the map frame.

    Coordinates stay the map's, so that the other files can be laid over it. The view it opens with is twisted so that the
    walls stand square, and the named coordinate system `WALLS` lies along them.
    """
    # Imported here: it takes a tenth of a second, and no run needs it before its maps are made.
    from ezdxf.enums import TextEntityAlignment
    from ezdxf.filemanagement import new
    from ezdxf.units import M as METRES

    document = new("R2010", setup=True)
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
        place = shapely.get_coordinates(room.polygon.representative_point())[0]
        for words, height, below_m in ((room.name, 0.25, 0.0), (f"{room.area_m2:.1f} m²", 0.2, 0.35)):
            attributes = {"layer": "ROOM_NAMES", "rotation": plan.direction_deg}
            text = space.add_text(words, height=height, dxfattribs=attributes)
            x, y = place - turned(np.array([0.0, below_m]), plan.direction_deg)
            text.set_placement((x, y), align=TextEntityAlignment.MIDDLE_CENTER)
    _look_square(document, plan)
    with written_whole(path) as part:
        document.saveas(part)


def _look_square(document: "Drawing", plan: FloorPlan) -> None:
    """Twist the first view of model space, and name the coordinate system along the walls."""
    x_axis, y_axis = turned(np.eye(2), plan.direction_deg)
    document.ucs.new("WALLS", dxfattribs={"xaxis": (*x_axis, 0.0), "yaxis": (*y_axis, 0.0)})
    low, high = _extent(plan)
    height_m = max(float((high - low).max()), 1.0) + 2 * _MARGIN_M
    # The middle of a twisted view counts in the view's own axes.
    view = document.set_modelspace_vport(height_m, center=tuple((low + high) / 2))
    view.dxf.view_twist = -plan.direction_deg % 360.0


def _add_polygon(space: "Modelspace", polygon: shapely.Polygon, layer: str, filled: bool) -> None:
    rings = [list(ring.coords)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
    for ring in rings:
        space.add_lwpolyline(ring, close=True, dxfattribs={"layer": layer})
    if filled:
        hatch = space.add_hatch(color=256, dxfattribs={"layer": layer})
        for i, ring in enumerate(rings):
            hatch.paths.add_polyline_path(ring, is_closed=True, flags=1 if i == 0 else 16)


def _add_door(space: "Modelspace", door: PlanDoor) -> None:
    attributes = {"layer": "DOORS"}
    _add_polygon(space, door.outline, "DOORS", filled=False)
    if door.state == DoorState.CLOSED:
        space.add_lwpolyline(door.closed.tolist(), dxfattribs=attributes)
    for leaf in door.leaves:
        space.add_line(tuple(leaf.hinge), tuple(leaf.tip), dxfattribs=attributes)
        angles = [float(np.degrees(np.arctan2(*(end - leaf.hinge)[::-1]))) for end in (_shut_tip(leaf), leaf.tip)]
        start, end = angles if leaf.swing_deg > 0 else angles[::-1]
        radius = float(np.linalg.norm(leaf.tip - leaf.hinge))
        space.add_arc(tuple(leaf.hinge), radius, start, end, dxfattribs=attributes)
