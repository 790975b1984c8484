"""Windows one by one, in ribbons and as curtain walls, and glazed walls inside; frames, mullions, panes and blinds.

Frames and mullions are wall, blinds are clutter.
"""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray
from ffmap.loaders.simulator.building import Room, outer_walls, shared_walls, spot_on
from ffmap.loaders.simulator.drawn.doors import doorways, draw_glass
from ffmap.loaders.simulator.drawn.elements import DrawnDoor, DrawnRoom, DrawnWindow
from ffmap.loaders.simulator.drawn.materials import draw_material
from ffmap.loaders.simulator.drawn.ranges import Ranges, WindowStyle, choose
from ffmap.loaders.simulator.drawn.walls import SKIN_M
from ffmap.loaders.simulator.glass import Glass
from ffmap.loaders.simulator.mesh import Material, MeshBuilder, Surface

_LOWEST_M = 0.4  # No window is lower
_END_M = 0.3  # Of a façade without a window


def place_windows(
    rooms: Sequence[DrawnRoom], doors: Sequence[DrawnDoor], thickness: Mapping[frozenset[int], float], outer_m: float,
    ranges: Ranges, rng: np.random.Generator
) -> list[DrawnWindow]:  # fmt: skip
    """A building's façades are mostly alike; glazed walls stand between rooms and the corridor."""
    windows: list[DrawnWindow] = []
    usual, glass = choose(ranges.window, rng), draw_glass(ranges, rng)
    everyone = cast(list[Room], list(rooms))
    for room in rooms:
        for ends in outer_walls(room, everyone):
            style = usual if rng.random() < 0.7 else choose(ranges.window, rng)
            if style != "none":
                depth = (SKIN_M - outer_m, SKIN_M)
                windows += [w for w in _row(style, ends, room.ceiling_m, depth, glass, ranges, rng) if _fits(w, room)]
    taken = doorways(doors)
    for number, room in enumerate(rooms[1:], 1):
        half = thickness[frozenset((0, number))] / 2
        for ends in shared_walls(rooms[0].outline, room.outline):
            if rng.random() < ranges.partition_share:
                style = "ribbon" if rng.random() < 0.4 else "curtain wall"
                height, glass = min(room.ceiling_m, rooms[0].ceiling_m), draw_glass(ranges, rng)
                row = _row(style, ends, height, (-half, half), glass, ranges, rng)
                windows += [w for w in _cut(row, taken) if _fits(w, rooms[0]) and _fits(w, room, behind=True)]
    return windows


def _fits(window: DrawnWindow, room: DrawnRoom, behind: bool = False) -> bool:
    """Whether the wall before a window is free of other walls and straight."""
    half = window.width_m / 2
    y = (window.depth[0] - 0.1, window.depth[0]) if behind else (window.depth[1], window.depth[1] + 0.1)
    return bool(room.interior.buffer(0.005).contains(window.spot.rectangle(-half, half, *y)))


def _row(
    style: WindowStyle, ends: FloatArray, ceiling_m: float, depth: tuple[float, float], glass: Glass, ranges: Ranges,
    rng: np.random.Generator
) -> list[DrawnWindow]:  # fmt: skip
    """The windows of a stretch of wall, alike but for their blinds."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    sill, gap = float(rng.uniform(*ranges.sill_m)), float(rng.uniform(*ranges.head_gap_m))
    bottom, top = (0.0, ceiling_m) if style == "curtain wall" else (sill, ceiling_m - gap)
    pitch, share = float(rng.uniform(*ranges.pitch_m)), float(rng.uniform(0.35, 0.85))
    frame, spread = float(rng.uniform(*ranges.mullion_m)), float(rng.uniform(*ranges.mullion_pitch_m))
    pane_y = depth[0] + float(rng.uniform(0.2, 0.8)) * (depth[1] - depth[0])
    count = int((length - 2 * _END_M) / pitch) if style == "single" else 1
    width = pitch * share if style == "single" else length - 2 * _END_M
    if top - bottom < _LOWEST_M or width < 0.4 or count < 1:
        return []
    middles = length / 2 + (np.arange(count) - (count - 1) / 2) * pitch
    parts = max(round(width / spread), 1)
    mullions = tuple(float(x) for x in np.linspace(-width / 2, width / 2, parts + 1)[1:-1])
    windows = []
    for middle in middles:
        blind = float(rng.uniform(*ranges.blind_drop)) if rng.random() < ranges.blind_share else 0.0
        windows.append(
            DrawnWindow(spot_on(ends, float(middle)), width, bottom, top, depth, style, glass, pane_y, frame, mullions, blind,
                        bool(rng.random() < 0.5))
        )  # fmt: skip
    return windows


def _cut(row: Sequence[DrawnWindow], taken: BaseGeometry) -> list[DrawnWindow]:
    """What doors leave of windows: those that meet none, and of one that does, the parts beside it."""
    left = []
    for window in row:
        if not window.area.intersects(taken):
            left.append(window)
            continue
        line = shapely.LineString(window.sill).difference(taken.buffer(0.02))
        for part in getattr(line, "geoms", [line]):
            if part.length > 0.5:
                ends = np.array(part.coords)
                own = spot_on(ends, part.length / 2)
                half = part.length / 2
                left.append(DrawnWindow(own, part.length, window.bottom_m, window.top_m, window.depth, window.style,
                                        window.glass, window.pane_y, window.frame_m,
                                        (0.0,) if half > 0.8 else (), window.blind, window.slats))  # fmt: skip
    return left


def build_window(window: DrawnWindow, mesh: MeshBuilder, rng: np.random.Generator) -> None:
    """A frame with its mullions about panes, and a blind behind it."""
    surface = draw_material(("gloss paint", "metal", "wood"), rng)
    half, frame = window.width_m / 2, window.frame_m
    low, high = window.bottom_m, window.top_m
    y = (max(window.pane_y - 0.035, window.depth[0]), min(window.pane_y + 0.035, window.depth[1]))
    for middle in (-half + frame / 2, *window.mullions, half - frame / 2):
        mesh.box(window.spot, (middle - frame / 2, middle + frame / 2), y, (low, high), Truth.WALL, surface)
    for z in ((low, low + frame), (high - frame, high)):
        mesh.box(window.spot, (-half, half), y, z, Truth.WALL, surface)
    pane = window.spot.to_plan(np.array([[-half, window.pane_y], [half, window.pane_y]]))
    mesh.wall(pane[None], (low, high), Truth.GLASS, Material(0.1, pane=int(window.glass)))
    if window.blind:
        _build_blind(window, y[1] + 0.01, mesh, draw_material(("fabric", "plastic", "metal"), rng))


def _build_blind(window: DrawnWindow, y: float, mesh: MeshBuilder, surface: Surface) -> None:
    """A cloth, or slats with gaps, down to a share of the window."""
    x = (-window.width_m / 2 + 0.02, window.width_m / 2 - 0.02)
    low = window.top_m - window.blind * (window.top_m - window.bottom_m)
    if not window.slats:
        mesh.box(window.spot, x, (y, y + 0.004), (low, window.top_m - 0.01), Truth.CLUTTER, surface)
        return
    for z in np.arange(window.top_m - 0.05, low, -0.05):
        mesh.box(window.spot, x, (y, y + 0.025), (float(z), float(z) + 0.02), Truth.CLUTTER, surface)
