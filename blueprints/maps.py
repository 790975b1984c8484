"""The grid maps side by side, each with what it is compared with laid over, and one time cursor for all."""

import rerun.blueprint as rrb

from ffmap.algorithms.maps.rivals import Rival
from ffmap.blueprints import entities

_NAMES = {
    entities.FURNITURE_FREE: "Furniture-free (Fig. 9b): wall black, free white, unseen gray",
    Rival.BELOW_CEILING: "Slice below the ceiling (Fig. 9c)",
    Rival.MIDDLE: "Slice in the middle (Fig. 9d)",
    Rival.UPMOST: "Up-most structures (Fig. 6a)",
    Rival.BOTTOMMOST: "Bottom-most structures (Fig. 6b)",
}


def build(centre_m: tuple[float, float] = (0.0, 0.0), extent_m: float = 20.0) -> rrb.Blueprint:
    """The layout of a run's maps against a reference; centre_m, extent_m: middle and size of what is shown."""
    return rrb.Blueprint(
        tab(centre_m, extent_m, compared=True),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=entities.SCAN_TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


def tab(centre_m: tuple[float, float], extent_m: float, compared: bool) -> rrb.Container:
    """All maps of a run.

    compared: the recording has what they were compared with, which is laid over the furniture-free map beside it.
    """
    views = [_map(name, title, centre_m, extent_m, []) for name, title in _NAMES.items()]
    if compared:
        overlay = [f"{entities.OVERLAYS}/{entities.FURNITURE_FREE}/**"]
        title = "Overlay (Fig. 9e): wall in both green, map only red, reference only orange"
        views.insert(1, _map(entities.FURNITURE_FREE, title, centre_m, extent_m, overlay))
    return rrb.Grid(*views, grid_columns=3, name="Maps")


def _map(
    name: str, title: str, centre_m: tuple[float, float], extent_m: float, overlay: list[str]
) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[f"{entities.GRID}/{name}", entities.TRAJECTORY, f"{entities.BASE}/**", *overlay],
        name=title,
        overrides={entities.TRAJECTORY: until_now()},
        eye_controls=from_above(centre_m, extent_m),
        line_grid=rrb.LineGrid3D(visible=False),
    )


def from_above(centre_m: tuple[float, float], extent_m: float) -> rrb.EyeControls3D:
    """An eye that looks down on so much of the map."""
    return rrb.EyeControls3D(position=(*centre_m, extent_m), look_target=(*centre_m, 0.0), eye_up=(0.0, 1.0, 0.0))


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
