"""Pictures of results: the floor plan (SVG), maps over the ground truth and rooms (PNG)."""

import colorsys
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
import shapely.affinity

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.area_graph import AreaGraph, Room
from ffmap.algorithms.maps.floor_plan import FloorPlan
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.rivals import Rival
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.maps import WALL_TOLERANCE_M, Agreement, ComparedMap, ComparedMaps
from ffmap.app.folder.atomic import written_whole
from ffmap.blueprints import entities

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INCHES_PER_M = 10.0 / 25.4
"""Scale of the floor plan, 1:100."""
_DARK, _BLUE = "#2b2f36", "#1d5fd0"
_MARGIN_M, _FOOT_M, _WIDTH_MIN_M = 1.0, 4.6, 17.0
_ROOM_FILLS = ("#eef4fb", "#fdf3e3", "#eef7ea", "#f8edf4", "#f6f4e4", "#e9f5f5")
PLAN_STYLES: dict[str, tuple[str | None, dict[str, Any]]] = {
    "room": ("room, as far as seen", {"ec": "none"}),
    "assumed": (
        "wall, one side seen, thickness assumed",
        {"fc": "#c9ccd2", "ec": "#7d838d", "lw": 0.5, "hatch": "////"},
    ),
    "wall": ("wall, both sides seen", {"fc": _DARK, "ec": _DARK, "lw": 0.3}),
    "column": ("column", {"fc": "#8a6a4f", "ec": _DARK, "lw": 0.7}),
    "window": ("window", {"fc": "white", "ec": _DARK, "lw": 0.5}),
    "pane": (None, {"color": _DARK, "lw": 0.5}),
    "doorway": (None, {"fc": "white", "ec": "none"}),
    "closed": ("closed door", {"color": _BLUE, "lw": 1.4}),
    "open": ("open door", {"color": _BLUE, "lw": 0.7, "ls": (0, (3, 2))}),
}
"""Legend entry and style of each kind of part of the floor plan, in drawing order."""
_MAP_TITLES = {
    entities.FURNITURE_FREE: "furniture-free",
    Rival.BELOW_CEILING: "slice below the ceiling",
    Rival.MIDDLE: "slice in the middle",
    Rival.UPMOST: "up-most structures",
    Rival.BOTTOMMOST: "bottom-most structures",
}
MAP_TITLES: dict[str, str] = {str(name): title for name, title in _MAP_TITLES.items()}
"""Every map of a run, the furniture-free map first."""
_AGREEMENTS = {
    Agreement.BOTH: "wall in map and ground truth",
    Agreement.ONLY_MAP: "wall in the map only",
    Agreement.ONLY_REFERENCE: "wall in the ground truth only",
    Agreement.FREE: "free",
    Agreement.NOTHING: "unknown",
}
_DPI, _MAP_PX, _ROOMS_PX = 100, 1200, 1600


def write_floor_plan(path: Path, plan: FloorPlan, title: str) -> None:
    """Draw the plan upright at 1:100 with room names, a scale bar, the map's axes and a legend."""
    # Imported here, as in the functions below: Matplotlib takes half a second to load.
    from matplotlib.lines import Line2D
    from matplotlib.transforms import Affine2D
    from shapely.plotting import patch_from_polygon

    low_x, low_y, high_x, high_y = extent(plan) + _MARGIN_M * np.array([-1, -1, 1, 1])
    width = max(float(high_x - low_x), _WIDTH_MIN_M)
    size_m = np.array([width, high_y - low_y + _FOOT_M])
    figure, axes = _page(np.array([low_x, low_y - _FOOT_M]), size_m, INCHES_PER_M)
    upright = Affine2D().rotate_deg(-plan.direction_deg) + axes.transData
    for kind, parts in _parts(plan).items():
        label, style = PLAN_STYLES[kind]
        for number, part in enumerate(parts):
            own: dict[str, Any] = {**style, "gid": f"{kind}-{number}", "transform": upright}
            own["label"] = None if number else label
            if kind == "room":
                own["fc"] = _ROOM_FILLS[number % len(_ROOM_FILLS)]
            if isinstance(part, shapely.Polygon):
                axes.add_patch(patch_from_polygon(part, **own))
            else:
                axes.add_line(Line2D(*part.xy, **own))
    for room in plan.rooms:
        place = turned(room_middle(room), -plan.direction_deg)
        _write_name(axes, place, room.name, room.area_m2, 8.0)
    _draw_foot(axes, title, plan.direction_deg, float(low_x) + 0.6, float(low_y))
    _save(path, figure)


def _parts(plan: FloorPlan) -> dict[str, Sequence[shapely.Polygon | shapely.LineString]]:
    """Group the plan's parts by the kinds of `PLAN_STYLES`."""
    closed = [door for door in plan.doors if door.state == DoorState.CLOSED]
    opened = [door for door in plan.doors if door.state == DoorState.OPEN]
    parts: dict[str, Sequence[shapely.Polygon | shapely.LineString]] = {
        "room": [room.polygon for room in plan.rooms],
        "assumed": plan.assumed,
        "wall": plan.walls,
        "column": plan.columns,
        "window": plan.windows,
        "pane": [pane(window) for window in plan.windows],
        "doorway": [door.outline.buffer(0.01, join_style="mitre") for door in plan.doors],
        "closed": [shapely.LineString(door.closed) for door in closed],
        "open": [shapely.LineString(door.sill) for door in opened],
    }
    return {kind: parts[kind] for kind in PLAN_STYLES}


def extent(plan: FloorPlan) -> FloatArray:
    """Compute least x, y and largest x, y (4,) of the upright plan; zeros if empty."""
    everything = shapely.GeometryCollection([part for own in _parts(plan).values() for part in own])
    upright = shapely.affinity.rotate(everything, -plan.direction_deg, origin=(0.0, 0.0))
    bounds: FloatArray = np.nan_to_num(shapely.bounds(upright))
    return bounds


def pane(window: shapely.Polygon) -> shapely.LineString:
    """Return the line in the middle of a window's cut, along the wall."""
    a, b, c, d = np.array(window.exterior.coords)[:4]
    return shapely.LineString([(a + d) / 2, (b + c) / 2])


def _draw_foot(axes: "Axes", title: str, direction_deg: float, left: float, top: float) -> None:
    """Draw title, scale bar, the map's axes and the legend; left, top: in metres on the page."""
    small: dict[str, Any] = {"size": 7.5, "color": _DARK}
    axes.axhline(top, color=_DARK, lw=0.7)
    axes.text(left, top - 0.6, f"{title} · scale 1:100 · metres", size=8.5, color=_DARK)
    axes.plot(left + np.arange(6), np.full(6, top - 1.3), marker="|", color=_DARK, lw=1.5)
    for metre in range(6):
        axes.text(left + metre, top - 1.8, str(metre), ha="center", **small)
    origin = np.array([left + 7.6, top - 1.7])
    for name, angle_deg in (("x", 0.0), ("y", 90.0)):
        tip = origin + turned(np.array([1.0, 0.0]), angle_deg - direction_deg)
        arrow = {"arrowstyle": "<-", "color": _DARK, "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
        axes.annotate(
            name, (*origin,), (*tip,), arrowprops=arrow, ha="center", va="center", **small
        )
    turn = f"{round(-direction_deg, 1) + 0.0:.1f}".replace("-", "−")
    note = f"axes of the map's coordinates,\nturned by {turn}° to draw walls upright"
    axes.text(left + 9.2, top - 1.5, note, va="center", **small)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(ncols=3, loc="lower left", frameon=False, fontsize=7.5, labelcolor=_DARK)


def write_overlays(path: Path, compared: ComparedMaps, direction_deg: float) -> None:
    """Draw every map over the ground truth, at one scale, with a legend (Fig. 9e).

    direction_deg: of most walls, see `main_direction_deg`; they are drawn upright.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    first = next(iter(compared.values())).grid
    known = first.middles(first.cells != Cell.UNKNOWN)
    places = turned(known if len(known) else first.origin[None], -direction_deg)
    low, high = places.min(axis=0) - 0.5, places.max(axis=0) + 0.5
    size_m = high - low
    columns = 2 if size_m[0] > size_m[1] else 3
    rows = math.ceil((len(compared) + 1) / columns)
    inches = _MAP_PX / _DPI * size_m / size_m.max()
    figure = Figure(figsize=(columns * (inches[0] + 0.8), rows * (inches[1] + 1.6)), layout="tight")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(compared) :]:
        axes.axis("off")
    for (name, one), axes in zip(compared.items(), panels, strict=False):
        _draw_overlay(axes, one, direction_deg)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_title(f"{MAP_TITLES[name]}\n{_figures(one)}", fontsize=22)
    found = set(np.unique(np.concatenate([np.unique(c.agreement) for c in compared.values()])))
    handles = [
        Patch(fc=np.array(entities.AGREEMENTS[kind][1]) / 255, ec="gray", label=label)
        for kind, label in _AGREEMENTS.items()
        if kind in found
    ]
    tolerance = f"a wall is right within {100 * WALL_TOLERANCE_M:g} cm"
    title = f"Maps over the ground truth, in metres\n{tolerance}"
    style = {"loc": "center", "fontsize": 22, "title_fontsize": 24, "frameon": False}
    panels[len(compared)].legend(handles=handles, title=title, **style)
    _save(path, figure)


def _draw_overlay(axes: "Axes", one: ComparedMap, direction_deg: float) -> None:
    from matplotlib.transforms import Affine2D

    colours = np.array([entities.AGREEMENTS[kind][1] for kind in Agreement], np.uint8)
    turn = Affine2D().rotate_deg(-direction_deg) + axes.transData
    _show(axes, colours[one.agreement], one.grid, transform=turn)
    axes.set_facecolor(tuple(colours[Agreement.NOTHING] / 255))
    axes.tick_params(labelsize=14)


def _figures(one: ComparedMap) -> str:
    values = {"precision": one.precision, "recall": one.recall, "error": one.error_m}
    units = {"precision": "%", "recall": "%", "error": "cm"}
    return ", ".join(
        f"{name} –" if np.isnan(value) else f"{name} {100 * value:.2f} {units[name]}"
        for name, value in values.items()
    )


def write_rooms_picture(path: Path, grid: GridMap, graph: AreaGraph) -> None:
    """Draw a map with its rooms coloured and named, and their passages in red."""
    from shapely.plotting import patch_from_polygon

    size_m = grid.cell_m * np.array(grid.cells.shape[::-1])
    inches_per_m = _ROOMS_PX / _DPI / float(size_m.max())
    figure, axes = _page(grid.origin, size_m, inches_per_m)
    _show(axes, np.repeat(grid.cells[..., None], 3, axis=2), grid)
    for index, room in enumerate(graph.rooms):
        red, green, blue = (value / 255 for value in room_color(index))
        style = {"fc": (red, green, blue, 0.65), "ec": "#282c34", "lw": 0.8}
        axes.add_patch(patch_from_polygon(room.polygon, **style))
        size = float(np.clip(0.16 * np.sqrt(room.area_m2) * inches_per_m * 72, 6.5, 19))
        _write_name(axes, room_middle(room), room.name, room.area_m2, size)
    for passage in graph.passages:
        axes.plot(*passage.line.T, color="#d62828", lw=2.0)
    _save(path, figure)


def room_middle(room: Room) -> FloatArray:
    """Find a place (2,) in a room for its name."""
    return np.array(room.polygon.representative_point().coords[0])


def room_color(index: int) -> entities.Color:
    """Choose a hue by the golden angle, so that neighbours in the list differ."""
    red, green, blue = colorsys.hsv_to_rgb((0.58 + index * 0.381966) % 1.0, 0.55, 0.92)
    return round(255 * red), round(255 * green), round(255 * blue)


def _page(low: FloatArray, size_m: FloatArray, inches_per_m: float) -> "tuple[Figure, Axes]":
    """Make a figure with frameless axes that fill it; their unit is the metre."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=tuple(size_m * inches_per_m))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), autoscale_on=False)
    axes.set(xlim=(low[0], low[0] + size_m[0]), ylim=(low[1], low[1] + size_m[1]))
    axes.axis("off")
    return figure, axes


def _show(
    axes: "Axes",
    pixels: UInt8Array,
    grid: GridMap,
    **options: Any,  # noqa: ANN401 - Matplotlib's
) -> None:
    """Draw an image (rows, columns, 3) of a grid's cells; the first row has the lowest y."""
    left, bottom = grid.origin
    right, top = grid.origin + grid.cell_m * np.array(pixels.shape[1::-1])
    options |= {"origin": "lower", "aspect": "auto"}
    axes.imshow(pixels, extent=(left, right, bottom, top), **options)


def _write_name(axes: "Axes", place: FloatArray, name: str, area_m2: float, size: float) -> None:
    x, y = place
    text = f"{name}\n{area_m2:.1f} m²"
    axes.text(x, y, text, ha="center", va="center", size=size, color=_DARK)


def _save(path: Path, figure: "Figure") -> None:
    """Save without a time stamp: the same results give the same file."""
    from matplotlib import rc_context

    kind = path.suffix.removeprefix(".")
    metadata = {"Date": None} if kind == "svg" else None
    with (
        rc_context({"svg.hashsalt": "ffmap", "svg.fonttype": "none", "hatch.linewidth": 0.4}),
        written_whole(path) as part,
    ):
        figure.savefig(part, format=kind, dpi=_DPI if kind == "png" else 72, metadata=metadata)
