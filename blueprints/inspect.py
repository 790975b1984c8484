"""One scan, line by line: the line in space, its differences, its profile, and its conditions."""

import math
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints.entities import LINE_TIMELINE, OPENINGS, PLANES, POINTS, Fault
from ffmap.blueprints.views import WITHOUT_NAMES, differences, layout, opening_at, space, text

_MARKS = {
    Fault.OF_THE_SCAN: "cyan: wrong by scan",
    Fault.OF_THE_BUILDING: "pink: wrong by building",
    Fault.RELABELLED: "cyan: changed by the building",
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
            differences("Differences (eq. 2, Fig. 5b)"),
            rrb.Spatial2DView(
                origin="/profile",
                name="Profile, metres",
                visual_bounds=rrb.VisualBounds2D(x_range=[-0.4, range_m], y_range=[-height_m, 0.7]),
            ),
            column_shares=[3, 2],
        ),
        row_shares=[3, 2],
    )
    why = rrb.Vertical(
        text("/why/line", "Why: this line"),
        text("/why/scan", "Why: the whole scan"),
        row_shares=[3, 2],
    )
    root = rrb.Horizontal(seen, why, column_shares=[9, 11])
    return layout(root, opening_at(LINE_TIMELINE, line))


def _line_in_its_scan(
    range_m: float, faults: Sequence[Fault], look_at_m: tuple[float, float, float] | None
) -> rrb.Spatial3DView:
    marked = "".join(f"; {_MARKS[fault]}" for fault in faults)
    x, y, z = look_at_m or (0.0, 0.0, 1.0)
    away_m = max(1.3 * range_m if look_at_m is None else 2.0 * math.hypot(x, y), 5.0)
    # Behind the robot and above, on the side that the line's wall faces.
    position = (x - 0.85 * away_m, -math.copysign(0.4 * away_m, y), 0.5 * away_m)
    return space(
        f"Labels by the scan; violet: line{marked}",
        [POINTS, PLANES, OPENINGS, "/scan/lines/example", "/scan/line/**", "/scan/faults"],
        rrb.EyeControls3D(position=position, look_target=(x, y, z)),
        origin="/scan",
        overrides={
            **WITHOUT_NAMES,
            POINTS: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0)),
        },
    )
