"""Pictures of results: the floor plan (SVG), maps over the ground truth and rooms of a map (PNG)."""

import colorsys
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.area_graph import AreaGraph, Room
from ffmap.algorithms.maps.floor_plan import FloorPlan, Leaf
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.rivals import Rival
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.maps import WALL_TOLERANCE_M, Agreement, ComparedMap, ComparedMaps
from ffmap.app.folder.atomic import written_whole
from ffmap.blueprints import entities

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import PathPatch

INCHES_PER_M = 10.0 / 25.4
"""The floor plan is drawn at a scale of 1:100."""
_DARK, _BLUE = "#2b2f36", "#1d5fd0"
_ROOM_FILLS = ("#eef4fb", "#fdf3e3", "#eef7ea", "#f8edf4", "#f6f4e4", "#e9f5f5")
_MARGIN_M, _FOOT_M, _WIDTH_MIN_M = 1.0, 4.6, 17.0
_KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "wall": ("wall, both sides seen", {"fc": _DARK, "ec": _DARK, "lw": 0.3}),
    "assumed": (
        "wall, one side seen, thickness assumed",
        {"fc": "#c9ccd2", "ec": "#7d838d", "lw": 0.5, "hatch": "////"},
    ),
    "column": ("column", {"fc": "#8a6a4f", "ec": _DARK, "lw": 0.7}),
    "window": ("window", {"fc": "white", "ec": _DARK, "lw": 0.5}),
    "closed": ("closed door", {"color": _BLUE, "lw": 1.4}),
    "leaf": ("open door, leaf as seen", {"color": _BLUE, "lw": 1.4}),
    "unseen": ("open doorway, no leaf seen", {"color": _BLUE, "lw": 0.7, "ls": (0, (3, 2))}),
    "room": ("room, as far as seen", {"fc": _ROOM_FILLS[0], "ec": "none"}),
}
"""What the floor plan shows, in words, and its style."""
_MAP_TITLES = {
    entities.FURNITURE_FREE: "furniture-free",
    Rival.BELOW_CEILING: "slice below the ceiling",
    Rival.MIDDLE: "slice in the middle",
    Rival.UPMOST: "up-most structures",
    Rival.BOTTOMMOST: "bottom-most structures",
}
MAP_TITLES: dict[str, str] = {str(name): title for name, title in _MAP_TITLES.items()}
"""Every map of a run, the furniture-free one first."""
_AGREEMENTS = {
    Agreement.BOTH: "wall in map and ground truth",
    Agreement.ONLY_MAP: "wall in the map only",
    Agreement.ONLY_REFERENCE: "wall in the ground truth only",
    Agreement.NOT_SEEN: "wall of the ground truth, not seen",
    Agreement.FREE: "free",
    Agreement.NOTHING: "unknown",
}
_IN_FRONT = (
    *(Agreement.NOTHING, Agreement.FREE, Agreement.NOT_SEEN),
    *(Agreement.BOTH, Agreement.ONLY_REFERENCE, Agreement.ONLY_MAP),
)
"""Of several cells that share a pixel, the last of these is shown."""
_MAP_PX, _DPI = 1200, 100
_PICTURE_PX = 1600
_SHOWS_THROUGH = 0.35
"""Share of the map that shows through the colours of rooms."""


def write_floor_plan(path: Path, plan: FloorPlan, title: str) -> None:
    """Draw the plan at 1:100 with names, areas, a scale bar, the map's axes and a legend.

    The walls are drawn upright: the map's axes are turned by up to 45°.
    """
    low, high = extent(plan)
    left, top = float(low[0]) - _MARGIN_M, float(high[1]) + _MARGIN_M
    width = max(float(high[0] - low[0]) + 2 * _MARGIN_M, _WIDTH_MIN_M)
    foot = float(low[1]) - _MARGIN_M
    figure, axes = _sheet(width * INCHES_PER_M, (top - foot + _FOOT_M) * INCHES_PER_M)
    axes.set_xlim(left, left + width)
    axes.set_ylim(foot - _FOOT_M, top)

    def place(xy: FloatArray | Sequence[Sequence[float]]) -> FloatArray:
        return turned(np.asarray(xy, float), -plan.direction_deg)

    def areas(kind: str, polygons: Iterable[shapely.Polygon], **style: object) -> None:
        for polygon in polygons:
            patch = _patch(polygon, place, **{**_KINDS[kind][1], **style})
            patch.set_gid(f"{kind}-{len(axes.patches)}")
            axes.add_patch(patch)

    def line(kind: str, points: FloatArray, **style: object) -> None:
        (drawn,) = axes.plot(*place(points).T, **(style or _KINDS[kind][1]))
        drawn.set_gid(f"{kind}-{len(axes.lines)}")

    for number, room in enumerate(plan.rooms):
        areas("room", [room.polygon], fc=_ROOM_FILLS[number % len(_ROOM_FILLS)])
    areas("assumed", plan.assumed)
    areas("wall", plan.walls)
    areas("column", plan.columns)
    areas("window", plan.windows)
    for window in plan.windows:
        line("pane", pane(window), color=_DARK, lw=0.5)
    for door in plan.doors:
        axes.add_patch(_patch(door.outline.buffer(0.01, join_style="mitre"), place, fc="w", ec="none"))
        for leaf in door.leaves:
            line("leaf", np.stack([leaf.hinge, leaf.tip]))
            line("swing", swing(leaf), color=_BLUE, lw=0.5)
        if door.state == DoorState.CLOSED:
            line("closed", door.closed)
        elif not door.leaves:
            line("unseen", door.sill)
    for room in plan.rooms:
        point = room.polygon.representative_point()
        x, y = place([[point.x, point.y]])[0]
        axes.text(x, y, room.name, ha="center", size=8.5, weight="bold", color=_DARK)
        axes.text(x, y - 0.38, f"{room.area_m2:.1f} m²", ha="center", size=7.5, color=_DARK)
    _draw_foot(axes, title, plan, left, foot, width)
    with written_whole(path) as part:
        _save(figure, part, "svg")


def extent(plan: FloorPlan) -> tuple[FloatArray, FloatArray]:
    """Least and largest x and y (2,) of the turned plan; zeros if it is empty."""
    areas = [*plan.walls, *plan.assumed, *plan.columns, *plan.windows]
    areas += [*(door.outline for door in plan.doors), *(room.polygon for room in plan.rooms)]
    tips = [tip for door in plan.doors for leaf in door.leaves for tip in (leaf.tip, shut_tip(leaf))]
    places = np.concatenate([shapely.get_coordinates(areas), np.reshape(tips, (-1, 2))])
    if not len(places):
        return np.zeros(2), np.zeros(2)
    places = turned(places, -plan.direction_deg)
    return places.min(axis=0), places.max(axis=0)


def shut_tip(leaf: Leaf) -> FloatArray:
    """Where the leaf's free edge (2,) is when the door is closed."""
    return leaf.hinge + turned(leaf.tip - leaf.hinge, -leaf.swing_deg)


def swing(leaf: Leaf) -> FloatArray:
    """The arc (n, 2) of the leaf's free edge, from closed to where it was seen."""
    angles = np.linspace(0.0, leaf.swing_deg, 24)
    return np.array([leaf.hinge + turned(shut_tip(leaf) - leaf.hinge, angle) for angle in angles])


def pane(window: shapely.Polygon) -> FloatArray:
    """(2, 2) the line in the middle of a window's cut, along the wall."""
    corners = np.array(window.exterior.coords)[:4]
    return np.array([(corners[0] + corners[3]) / 2, (corners[1] + corners[2]) / 2])


def _draw_foot(
    axes: "Axes", title: str, plan: FloorPlan, left: float, foot: float, width: float
) -> None:
    """Title, scale bar, the map's axes, and a legend of what the plan shows."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch, Rectangle

    axes.plot([left + 0.4, left + width - 0.4], [foot, foot], color=_DARK, lw=0.7)
    axes.text(left + 0.6, foot - 0.6, f"{title} · scale 1:100 · metres", size=8.5, color=_DARK)
    for metre in range(6):
        at = (left + 0.6 + metre, foot - 1.4)
        if metre < 5:
            fill = "white" if metre % 2 else _DARK
            axes.add_patch(Rectangle(at, 1.0, 0.16, fc=fill, ec=_DARK, lw=0.5))
        axes.text(at[0], at[1] - 0.4, str(metre), ha="center", size=7.5, color=_DARK)
    origin = np.array([left + 8.2, foot - 1.7])
    for name, angle_deg in (("x", 0.0), ("y", 90.0)):
        along = turned(np.array([0.8, 0.0]), angle_deg - plan.direction_deg)
        ends = [(float(x), float(y)) for x, y in (origin, origin + along, origin + 1.25 * along)]
        arrow = {"arrowstyle": "->", "color": _DARK, "lw": 0.7}
        axes.annotate("", ends[1], ends[0], arrowprops=arrow)
        axes.text(ends[2][0], ends[2][1], name, ha="center", va="center", size=7.5)
    turn = f"{round(-plan.direction_deg, 1) + 0.0:.1f}".replace("-", "−")
    words = f"axes of the map's coordinates,\nturned by {turn}° to draw walls upright"
    axes.text(left + 9.8, foot - 1.5, words, size=7.5, va="center", color=_DARK)
    unseen = [d for d in plan.doors if d.state != DoorState.CLOSED and not d.leaves]
    shown = {
        "wall": plan.walls,
        "assumed": plan.assumed,
        "column": plan.columns,
        "window": plan.windows,
        "closed": [d for d in plan.doors if d.state == DoorState.CLOSED],
        "leaf": [d for d in plan.doors if d.leaves],
        "unseen": unseen,
        "room": plan.rooms,
    }
    handles: list[Artist] = []
    for kind, (label, style) in _KINDS.items():
        if shown[kind]:
            line = "color" in style
            handles.append(Line2D([], [], label=label, **style) if line else Patch(label=label, **style))
    if handles:
        at = (left + 0.3, foot - _FOOT_M + 0.1)
        axes.legend(
            handles=handles,
            ncols=3,
            loc="lower left",
            bbox_to_anchor=at,
            bbox_transform=axes.transData,
            frameon=False,
            fontsize=7.5,
            labelcolor=_DARK,
        )


def write_overlays(path: Path, compared: ComparedMaps, direction_deg: float) -> None:
    """Draw every map with the ground truth laid over, at one scale, with a legend (Fig. 9e).

    direction_deg: of most walls, see `main_direction_deg`; they are drawn upright.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    first = next(iter(compared.values())).grid
    known = np.concatenate([first.centres(cell) for cell in (Cell.FREE, Cell.OCCUPIED)])
    places = turned(known if len(known) else first.origin[None], -direction_deg)
    low, high = places.min(axis=0) - 0.5, places.max(axis=0) + 0.5
    across = high - low
    count = len(compared) + 1  # and the legend
    sheets = [(columns, math.ceil(count / columns)) for columns in range(1, count + 1)]
    shape = across[0] / across[1]
    columns, rows = min(sheets, key=lambda sheet: abs(math.log(sheet[0] / sheet[1] * shape / 1.5)))
    inches = _MAP_PX / _DPI * across / across.max()
    figure = Figure(figsize=(columns * (inches[0] + 0.8), rows * (inches[1] + 1.6)), layout="tight")
    found: set[int] = set()
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for (name, one), axes in zip(compared.items(), panels, strict=False):
        found |= set(np.unique(one.agreement).tolist())
        _draw_overlay(axes, one, direction_deg, _MAP_PX / across.max())
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_title(f"{MAP_TITLES[name]}\n{_figures(one)}", fontsize=22)
    for axes in panels[len(compared) :]:
        axes.axis("off")
    handles = [
        Patch(fc=np.array(entities.AGREEMENTS[kind][1]) / 255, ec="gray", label=words)
        for kind, words in _AGREEMENTS.items()
        if kind in found
    ]
    title = f"Maps over the ground truth\na wall is right within {100 * WALL_TOLERANCE_M:g} cm"
    panels[len(compared)].legend(
        handles=handles, title=title, loc="center", fontsize=22, title_fontsize=24, frameon=False
    )
    with written_whole(path) as part:
        _save(figure, part, "png")


def _draw_overlay(axes: "Axes", one: ComparedMap, direction_deg: float, px_per_m: float) -> None:
    from matplotlib.transforms import Affine2D

    grid = one.grid
    factor = max(1, math.ceil(2.0 / (px_per_m * grid.cell_m)))
    agreement = coarsened(one.agreement, factor)
    colours = np.array([entities.AGREEMENTS[kind][1] for kind in Agreement], np.uint8)
    rows, columns = agreement.shape
    size_m = factor * grid.cell_m * np.array([columns, rows])
    extent_m = (grid.origin[0], grid.origin[0] + size_m[0], grid.origin[1], grid.origin[1] + size_m[1])
    turn = Affine2D().rotate_deg(-direction_deg)
    axes.imshow(
        colours[agreement],
        extent=extent_m,
        origin="lower",
        interpolation="nearest",
        transform=turn + axes.transData,
    )
    red, green, blue = (value / 255 for value in entities.AGREEMENTS[Agreement.NOTHING][1])
    axes.set_facecolor((red, green, blue))
    axes.set_aspect("equal")
    axes.tick_params(labelsize=14)
    axes.set_xlabel("m", fontsize=14)


def coarsened(agreement: UInt8Array, factor: int) -> UInt8Array:
    """Cells larger by `factor`, each as the cell within it that must not be overlooked."""
    if factor <= 1:
        return agreement
    rank = np.argsort(_IN_FRONT).astype(np.uint8)
    rows, columns = agreement.shape
    padded = np.pad(rank[agreement], [(0, -rows % factor), (0, -columns % factor)])
    tiles = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
    return np.asarray(np.array(_IN_FRONT, np.uint8)[tiles.max(axis=(1, 3))])


def _figures(one: ComparedMap) -> str:
    figures = one.figures
    values = {"precision": figures.precision, "recall": figures.recall, "error": figures.error_m}
    units = {"precision": "%", "recall": "%", "error": "cm"}
    return ", ".join(f"{name} {percent(value)} {units[name]}" for name, value in values.items())


def percent(value: float | None) -> str:
    """A share in percent, or a length in centimetres."""
    return "–" if value is None or np.isnan(value) else f"{100 * value:.2f}"


def write_rooms_picture(path: Path, grid: GridMap, graph: AreaGraph) -> None:
    """Draw a map with its rooms coloured and named and their passages in red, at most 1600 pixels wide."""
    rows, columns = grid.cells.shape
    step = max(1, -(-max(rows, columns) // _PICTURE_PX))
    cells, label = grid.cells[::step, ::step], graph.label[::step, ::step]
    pixels = np.repeat(cells[:, :, None], 3, axis=2)
    colors = np.array([room_color(index) for index in range(len(graph))], float).reshape(-1, 3)
    inside = label >= 0
    pixels[inside] = (1 - _SHOWS_THROUGH) * colors[label[inside]] + _SHOWS_THROUGH * pixels[inside]
    zoom = max(1, _PICTURE_PX // max(cells.shape))
    inches_per_m = zoom / (step * grid.cell_m) / _DPI
    size_m = grid.cell_m * step * np.array(cells.shape[::-1])
    figure, axes = _sheet(*(size_m * inches_per_m))
    low, high = grid.origin, grid.origin + size_m
    axes.imshow(
        pixels,
        extent=(low[0], high[0], low[1], high[1]),
        origin="lower",
        interpolation="nearest",
    )
    for room in graph.rooms:
        style: dict[str, object] = {"fc": "none", "ec": "#282c34", "lw": 0.8}
        axes.add_patch(_patch(room.polygon, lambda xy: xy, **style))
    for passage in graph.passages:
        axes.plot(*passage.line.T, color="#d62828", lw=2.0)
    for room in graph.rooms:
        size = float(np.clip(0.16 * np.sqrt(room.area_m2) * inches_per_m * 72, 6.5, 19))
        x, y = inner_point(room)
        axes.text(x, y, f"{room.name}\n{room.area_m2:.1f} m²", ha="center", va="center", size=size)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    with written_whole(path) as part:
        _save(figure, part, "png")


def room_color(index: int) -> entities.Color:
    """Colours that differ from their neighbours' in the list: hues by the golden angle."""
    red, green, blue = colorsys.hsv_to_rgb((0.58 + index * 0.381966) % 1.0, 0.55, 0.92)
    return round(255 * red), round(255 * green), round(255 * blue)


def inner_point(room: Room) -> tuple[float, float]:
    """A place for the room's name: its centroid, or if that is cramped the point farthest from its walls."""
    widest = shapely.maximum_inscribed_circle(room.polygon, 0.05)
    middle = room.polygon.centroid
    clear_m = room.polygon.boundary.distance(middle)
    roomy = room.polygon.contains(middle) and clear_m > 0.7 * widest.length
    x, y = middle.coords[0] if roomy else widest.coords[0]
    return float(x), float(y)


def _sheet(width_inches: float, height_inches: float) -> "tuple[Figure, Axes]":
    """A figure with axes that fill it, without a frame."""
    # Imported here: matplotlib takes half a second, and only finished maps are drawn.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_inches, height_inches))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.axis("off")
    return figure, axes


def _patch(
    polygon: shapely.Polygon, place: Callable[[FloatArray], FloatArray], **style: Any  # noqa: ANN401 - matplotlib's
) -> "PathPatch":
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [polygon.exterior, *polygon.interiors]
    outlines = [Outline(place(np.array(ring.coords)), closed=True) for ring in rings]
    return PathPatch(Outline.make_compound_path(*outlines), **style)


def _save(figure: "Figure", path: Path, kind: str) -> None:
    """Without the time at which it was made: the same results are the same file."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "ffmap", "svg.fonttype": "none", "hatch.linewidth": 0.4}):
        metadata = {"Date": None} if kind == "svg" else None
        figure.savefig(path, format=kind, dpi=_DPI if kind == "png" else 72, metadata=metadata)
