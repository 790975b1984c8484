"""The grid maps side by side, each with what it is compared with laid over, and one time cursor for all."""

import rerun.blueprint as rrb

from ffmap.algorithms.maps.rivals import Rival
from ffmap.blueprints import entities
from ffmap.blueprints.views import following, from_above, layout, space

_NAMES = {
    entities.FURNITURE_FREE: "Furniture-free (Fig. 9b): wall black, free white, unseen gray",
    Rival.BELOW_CEILING: "Slice below the ceiling (Fig. 9c)",
    Rival.MIDDLE: "Slice in the middle (Fig. 9d)",
    Rival.UPMOST: "Up-most structures (Fig. 6a)",
    Rival.BOTTOMMOST: "Bottom-most structures (Fig. 6b)",
}


def build(centre_m: tuple[float, float] = (0.0, 0.0), extent_m: float = 20.0) -> rrb.Blueprint:
    """The layout of a run's maps against a reference; centre_m, extent_m: middle and size of what is shown."""
    return layout(tab(centre_m, extent_m, compared=True), following(entities.SCAN_TIMELINE))


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
    contents = [f"{entities.GRID}/{name}", entities.TRAJECTORY, f"{entities.BASE}/**", *overlay]
    return space(title, contents, from_above(centre_m, extent_m))
