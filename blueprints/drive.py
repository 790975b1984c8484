"""A bag in the viewer: the clouds of its lidars, with a run of it also the map."""

from collections.abc import Sequence

import rerun.blueprint as rrb

from ffmap.blueprints.entities import STAMP_TIMELINE
from ffmap.blueprints.views import (
    ROBOT,
    Part,
    aslant,
    behind_the_robot,
    layout,
    legend,
    space,
    text,
)


def build(
    lidars: Sequence[str],
    apart: bool = False,
    map_view: tuple[tuple[float, float], float] | None = None,
) -> rrb.Blueprint:
    """Return the layout of a bag.

    lidars: their names. apart: extrinsics are not known, so that each has a view of its own.
    map_view: centre and extent (m) of the map; None without a map.
    """
    eye = behind_the_robot()
    entries, views = len(lidars), list[Part]()
    if map_view is not None:
        entries = 6
        clouds = [f"/world/{name}/**" for name in lidars]
        building = space(
            "Clouds in the map (its ceiling is hidden)",
            ["/world/building/cloud", *clouds, *ROBOT],
            aslant(*map_view),
        )
        around = ["$origin/**", *clouds]
        views = [building, space("Clouds around the robot", around, eye, "/world/base")]
    elif apart:
        views = [
            space(f"{name}, in its frame", ["$origin/**"], eye, f"/world/base/{name}")
            for name in lidars
        ]
    else:
        views = [space("Clouds around the robot", ["$origin/**"], eye, "/world/base")]
    top = rrb.Horizontal(legend("/legend", "Colours", entries), text("/glance", "What this shows"))
    time = rrb.TimePanel(
        state="collapsed", timeline=STAMP_TIMELINE, play_state="playing", loop_mode="all"
    )
    return layout(rrb.Vertical(top, rrb.Horizontal(*views), row_shares=[1, 7]), time)
