"""One scan, line by line: the line in space, its differences, its profile, and its conditions."""

import math
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints.entities import FAULT_CLASSES, LINE_TIMELINE, OPENINGS, PLANES, POINTS, Fault
from ffmap.blueprints.views import WITHOUT_NAMES, differences, layout, opening_at, space, text

_COLOR_NAMES = {
    Fault.OF_THE_SCAN: "cyan",
    Fault.OF_THE_BUILDING: "pink",
    Fault.RELABELLED: "cyan",
}


def build(
    profile_m: tuple[float, float],
    line: int | None = None,
    faults: Sequence[Fault] = (),
    look_at_m: tuple[float, float, float] | None = None,
) -> rrb.Blueprint:
    """Return the layout of a recording of one scan.

    profile_m: horizontal range and height of the profile.
    line: the line to open at; None for the first.
    faults: kinds of marked returns.
    look_at_m: in the level frame; None for the whole scan.
    """
    range_m, height_m = profile_m
    seen = rrb.Vertical(
        _line_in_its_scan(range_m, faults, look_at_m),
        rrb.Horizontal(
            differences("Its forward differences (eq. 2, Fig. 5b)"),
            rrb.Spatial2DView(
                origin="/profile",
                name="Its profile: height over range, metres",
                visual_bounds=rrb.VisualBounds2D(
                    x_range=[-0.4, range_m], y_range=[-height_m, 0.4]
                ),
            ),
            column_shares=[3, 2],
        ),
        row_shares=[3, 2],
    )
    why = rrb.Vertical(
        text("/why/line", "Why: this line"), text("/why/scan", "Why: the whole scan")
    )
    root = rrb.Horizontal(seen, why, column_shares=[3, 2])
    return layout(root, opening_at(LINE_TIMELINE, line))


def _line_in_its_scan(
    range_m: float, faults: Sequence[Fault], look_at_m: tuple[float, float, float] | None
) -> rrb.Spatial3DView:
    marked = "".join(f"; {_COLOR_NAMES[fault]}: {FAULT_CLASSES[fault][0]}" for fault in faults)
    x, y, z = look_at_m or (0.0, 0.0, 1.0)
    away_m = max(1.3 * range_m if look_at_m is None else 2.0 * math.hypot(x, y), 5.0)
    # Behind the robot and above, on the side that the line's wall faces.
    position = (x - 0.85 * away_m, -math.copysign(0.4 * away_m, y), 0.5 * away_m)
    return space(
        f"The line in its scan: white, its rays a fan{marked}",
        [POINTS, PLANES, OPENINGS, "/scan/lines/example", "/scan/line/**", "/scan/faults"],
        rrb.EyeControls3D(position=position, look_target=(x, y, z)),
        origin="/scan",
        overrides={
            **WITHOUT_NAMES,
            POINTS: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0)),
        },
    )
