"""The grid maps side by side, and what the furniture-free map is compared with."""

import rerun.blueprint as rrb

from ffmap.algorithms.maps.rivals import Rival
from ffmap.blueprints.entities import FURNITURE_FREE, GRID
from ffmap.blueprints.views import ROBOT, from_above, space

_TITLES = {
    FURNITURE_FREE: "Furniture-free (Fig. 9b): wall black, unseen gray",
    Rival.BELOW_CEILING: "Slice below the ceiling (Fig. 9c)",
    Rival.MIDDLE: "Slice in the middle (Fig. 9d)",
    Rival.UPMOST: "Up-most structures (Fig. 6a)",
    Rival.BOTTOMMOST: "Bottom-most structures (Fig. 6b)",
}
_OVERLAY = "Fig. 9e: right green, false red, missed orange"


def tab(centre_m: tuple[float, float], extent_m: float, compared: bool) -> rrb.Container:
    """Return all maps of a run. compared: with the overlay on the reference."""
    eye = from_above(centre_m, extent_m)
    shown = [(title, [f"{GRID}/{name}"]) for name, title in _TITLES.items()]
    if compared:
        overlay = f"/world/overlay/{FURNITURE_FREE}/**"
        shown.insert(1, (_OVERLAY, [f"{GRID}/{FURNITURE_FREE}", overlay]))
    views = [space(title, [*contents, *ROBOT], eye) for title, contents in shown]
    first = len(views) // 2
    rows = rrb.Horizontal(*views[:first]), rrb.Horizontal(*views[first:])
    return rrb.Vertical(*rows, name="Maps")
