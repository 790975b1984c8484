"""What the layouts share: panels, views in space, and their cameras."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.maps.grid import GridMap
from ffmap.blueprints.entities import (
    MAP_POINTS,
    OPENINGS,
    SCAN_TIMELINE,
    STAMP_TIMELINE,
    TRAJECTORY,
)

Part = rrb.Container | rrb.View
ROBOT = (TRAJECTORY, "/world/base/**")
WITHOUT_NAMES = {OPENINGS: rr.LineStrips3D.from_fields(show_labels=False)}
"""Override for doors in a scan."""


def layout(root: Part, time: rrb.TimePanel, recordings: bool = False) -> rrb.Blueprint:
    """Return a layout of views and time panel; recordings: with the list of recordings open."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="expanded" if recordings else "collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
        auto_layout=False,
    )


def following(timeline: str) -> rrb.TimePanel:
    """Return a time panel that opens at the end, and follows a run under way."""
    return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following")


def opening_at(timeline: str, number: int | None) -> rrb.TimePanel:
    """Return a time panel that opens at a number of a timeline, or at its start."""
    if number is None:
        return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="paused")
    # A layout cannot set the time cursor, but it can play a selection of a single number.
    return rrb.TimePanel(
        state="collapsed",
        timeline=timeline,
        play_state="playing",
        loop_mode="selection",
        time_selection=rrb.components.AbsoluteTimeRange(number, number),
    )


def view_of(*grids: GridMap | None) -> tuple[tuple[float, float], float]:
    """Return the centre and the extent (m) of some grid maps."""
    there = [grid for grid in grids if grid is not None]
    if not there:
        return (0.0, 0.0), 20.0
    low = np.min([grid.origin for grid in there], axis=0)
    sizes = [np.array(grid.cells.shape[::-1]) * grid.cell_m for grid in there]
    high = np.max([grid.origin + size for grid, size in zip(there, sizes, strict=True)], axis=0)
    x, y = (low + high) / 2
    return (float(x), float(y)), float(np.max(high - low))


def space(
    name: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D | None,
    origin: str = "/world",
    overrides: Mapping[Any, Any] | None = None,
) -> rrb.Spatial3DView:
    """Return a view in space; trajectory and growing map are shown up to the time cursor.

    eye: None if the size of the place is not known.
    """
    growing: dict[Any, Any] = {
        path: until_now() for path in contents if path.endswith((TRAJECTORY, MAP_POINTS))
    }
    return rrb.Spatial3DView(
        origin=origin,
        contents=list(contents),
        name=name,
        overrides={**growing, **(overrides or {})},
        eye_controls=eye,
        line_grid=rrb.LineGrid3D(visible=False),
    )


def from_above(centre_m: tuple[float, float], extent_m: float) -> rrb.EyeControls3D:
    """Return a camera above the middle of a map."""
    position, target = (*centre_m, extent_m), (*centre_m, 0.0)
    return rrb.EyeControls3D(position=position, look_target=target, eye_up=(0.0, 1.0, 0.0))


def aslant(
    centre_m: tuple[float, float],
    extent_m: float,
    offset: tuple[float, float, float] = (-0.25, -0.7, 0.95),
) -> rrb.EyeControls3D:
    """Return a camera that sees the whole building from a side.

    offset: from the middle of the building, in parts of its extent.
    """
    (x, y), (dx, dy, dz) = centre_m, offset
    position = (x + dx * extent_m, y + dy * extent_m, dz * extent_m)
    return rrb.EyeControls3D(position=position, look_target=(x, y, 0.0))


def behind_the_robot() -> rrb.EyeControls3D:
    """Return a camera behind the robot, right of it and above."""
    return rrb.EyeControls3D(position=(-4.8, -3.9, 4.3), look_target=(0.2, 0.0, 1.1))


def until_now() -> rrb.VisibleTimeRanges:
    """Return everything from the beginning up to the time cursor."""
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(timeline, start=start, end=end)
            for timeline in (SCAN_TIMELINE, STAMP_TIMELINE)
        ]
    )


def differences(name: str) -> rrb.Spatial2DView:
    """Return the sheet of forward differences, see `app.record.curves`."""
    bounds = rrb.VisualBounds2D(x_range=[-30.0, 670.0], y_range=[-215.0, 255.0])
    return rrb.Spatial2DView(origin="/scan/differences", name=name, visual_bounds=bounds)


def legend(origin: str, name: str, entries: int) -> rrb.Spatial2DView:
    """Return a strip of coloured dots with names, see `app.record.whole_run.log_legend`."""
    bounds = rrb.VisualBounds2D(x_range=[-60.0, 120.0 * entries - 60.0], y_range=[-9.0, 24.0])
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds)


def text(origin: str, name: str) -> rrb.TextDocumentView:
    return rrb.TextDocumentView(origin=origin, name=name)
