"""What the layouts share: panels, views in space, and where their eyes stand."""

from collections.abc import Mapping, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities

Part = rrb.Container | rrb.View
WITHOUT_NAMES = (entities.OPENINGS, rr.LineStrips3D.from_fields(show_labels=False))  # An override for doors in view


def layout(root: Part, time: rrb.TimePanel, recordings: bool = False) -> rrb.Blueprint:
    """A layout with nothing but its views and the time; recordings: the list of recordings is open."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="expanded" if recordings else "collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
        auto_layout=False,
    )


def following(timeline: str) -> rrb.TimePanel:
    """A finished recording opens at its end, where the map is whole; a live one stays at the newest scan."""
    return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="following")


def opening_at(timeline: str, number: int | None) -> rrb.TimePanel:
    """A timeline of numbers that opens at its start, or at one of them.

    A layout cannot place the time cursor; it can play a selection, and one of a single number stays there.
    """
    if number is None:
        return rrb.TimePanel(state="collapsed", timeline=timeline, play_state="paused")
    return rrb.TimePanel(
        state="collapsed",
        timeline=timeline,
        play_state="playing",
        loop_mode="selection",
        time_selection=rrb.components.AbsoluteTimeRange(number, number),
    )


def space(
    name: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D | None,
    origin: str = entities.WORLD,
    overrides: Mapping[Any, Any] | None = None,
) -> rrb.Spatial3DView:
    """A view in space; eye: None where nothing says how large the place is. Of trajectory and growing map it shows all up
    to the time cursor.
    """
    growing: dict[Any, Any] = {
        path: until_now() for path in contents if path.endswith((entities.TRAJECTORY, entities.MAP_POINTS))
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
    """An eye that looks down on a map of this middle and size."""
    return rrb.EyeControls3D(position=(*centre_m, extent_m), look_target=(*centre_m, 0.0), eye_up=(0.0, 1.0, 0.0))


def aslant(
    centre_m: tuple[float, float], extent_m: float, offset: tuple[float, float, float] = (-0.25, -0.7, 0.95)
) -> rrb.EyeControls3D:
    """An eye that sees the whole building from a side; offset: from the building's middle, in parts of its size."""
    (x, y), (dx, dy, dz) = centre_m, offset
    position = (x + dx * extent_m, y + dy * extent_m, dz * extent_m)
    return rrb.EyeControls3D(position=position, look_target=(x, y, 0.0))


def behind_the_robot() -> rrb.EyeControls3D:
    """An eye behind the robot, right of it and above."""
    return rrb.EyeControls3D(position=(-4.8, -3.9, 4.3), look_target=(0.2, 0.0, 1.1))


def until_now() -> rrb.VisibleTimeRanges:
    """Everything from the beginning up to the time cursor."""
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
            )
            for timeline in (entities.SCAN_TIMELINE, entities.STAMP_TIMELINE)
        ]
    )
