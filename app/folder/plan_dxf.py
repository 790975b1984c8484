"""The floor plan for CAD (DXF)."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.floor_plan import FloorPlan, PlanDoor
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.pictures import extent, pane, room_middle

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts.layout import Modelspace

_MARGIN_M = 1.0
LAYERS = {
    "WALLS": 7,
    "WALLS_ONE_SIDE_SEEN": 8,
    "COLUMNS": 7,
    "DOORS": 5,
    "WINDOWS": 4,
    "ROOMS": 3,
    "ROOM_NAMES": 3,
}
"""Layers with their colours (AutoCAD's colour index)."""


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Write closed polylines with solid hatches, arcs and texts on `LAYERS`.

    Coordinates are metres of the map frame, so that other files fit over the plan. The first view
    is twisted to show the walls upright; the named coordinate system `WALLS` is parallel to them.
    """
    # Imported here: it takes a tenth of a second to load.
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
        space.add_lwpolyline(pane(window).coords, dxfattribs={"layer": "WINDOWS"})
    for door in plan.doors:
        _add_door(space, door)
    attributes = {"layer": "ROOM_NAMES", "rotation": plan.direction_deg}
    for room in plan.rooms:
        place = room_middle(room)
        for line, height, below_m in (
            (room.name, 0.25, 0.0),
            (f"{room.area_m2:.1f} m²", 0.2, 0.35),
        ):
            x, y = place - turned(np.array([0.0, below_m]), plan.direction_deg)
            text = space.add_text(line, height=height, dxfattribs=attributes)
            text.set_placement((x, y), align=TextEntityAlignment.MIDDLE_CENTER)
    _set_view(document, plan)
    with written_whole(path) as part:
        document.saveas(part)


def _set_view(document: "Drawing", plan: FloorPlan) -> None:
    """Twist the first view of model space, and name the coordinate system along the walls."""
    x_axis, y_axis = turned(np.eye(2), plan.direction_deg)
    document.ucs.new("WALLS", dxfattribs={"xaxis": (*x_axis, 0.0), "yaxis": (*y_axis, 0.0)})
    low, high = extent(plan).reshape(2, 2)
    height_m = max(float((high - low).max()), 1.0) + 2 * _MARGIN_M
    # The centre of a twisted view is given in the view's own axes.
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
    _add_polygon(space, door.outline, "DOORS", filled=False)
    if door.state == DoorState.CLOSED:
        space.add_lwpolyline(door.closed.tolist(), dxfattribs={"layer": "DOORS"})
