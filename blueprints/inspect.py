"""One scan, line by line: the line in space, its curve, its profile, and in words why it became what it is."""

import math
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.entities import CurveSheet
from ffmap.blueprints.timeline import time_panel

_COLOR_NAMES = {
    entities.Fault.OF_THE_SCAN: "cyan",
    entities.Fault.OF_THE_BUILDING: "pink",
    entities.Fault.RELABELLED: "cyan",
}


def build(
    profile_m: tuple[float, float],
    line: int | None = None,
    faults: Sequence[entities.Fault] = (),
    look_at_m: tuple[float, float, float] | None = None,
) -> rrb.Blueprint:
    """The layout of a recording of one scan.

    profile_m: largest horizontal range and height that the profile shows.
    line: the line to open at; None for the first. faults: those that are marked.
    look_at_m: what to look at, in the level frame; None for the whole scan.
    """
    range_m, height_m = profile_m
    marked = "".join(f"; {_COLOR_NAMES[fault]}: {entities.FAULT_CLASSES[fault][0]}" for fault in faults)
    x, y, z = look_at_m or (0.0, 0.0, 1.0)
    far_m = max(1.3 * range_m if look_at_m is None else 2.0 * math.hypot(x, y), 5.0)
    seen = rrb.Vertical(
        rrb.Spatial3DView(
            origin=entities.SCAN,
            contents=[
                entities.POINTS,
                entities.PLANES,
                entities.OPENINGS,
                entities.EXAMPLE_LINE,
                entities.LINE_SIGHT,
                f"{entities.LINE_STRUCTURES}/**",
                entities.LINE_GROWING,
                entities.LINE_PLANE,
                entities.LINE_DOOR,
                entities.FAULTS,
            ],
            name=f"The line in its scan: white, its rays a fan{marked}",
            overrides={
                entities.POINTS: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0)),
                entities.OPENINGS: rr.LineStrips3D.from_fields(show_labels=False),
            },
            # From behind the robot and above, on the side that a line's wall faces, so far that both sides are in view.
            eye_controls=rrb.EyeControls3D(
                position=(x - 0.85 * far_m, -math.copysign(0.4 * far_m, y), 0.5 * far_m), look_target=(x, y, z)
            ),
            line_grid=rrb.LineGrid3D(visible=False),
        ),
        rrb.Horizontal(
            rrb.Spatial2DView(
                origin=entities.CURVES,
                contents=[
                    entities.CURVE_FRAMES,
                    entities.CURVE_THRESHOLDS,
                    entities.CURVE_TEXTS,
                    entities.CURVE_EXAMPLE,
                    entities.CURVE_EXAMPLE_SLOPE,
                    entities.CURVE_EXAMPLE_STRUCTURES,
                    entities.CURVE_EXAMPLE_TEXTS,
                ],
                name="Its forward differences, from its foot (left) upwards (eq. 2, Fig. 5b)",
                visual_bounds=rrb.VisualBounds2D(
                    x_range=[-20, CurveSheet.WIDTH + 20], y_range=[-110, CurveSheet.EXAMPLE_HEIGHT + 20]
                ),
            ),
            rrb.Spatial2DView(
                origin=entities.PROFILE,
                name="Its profile: height over range, metres",
                visual_bounds=rrb.VisualBounds2D(x_range=[-0.4, range_m], y_range=[-height_m, 0.4]),
            ),
            column_shares=[3, 2],
        ),
        row_shares=[3, 2],
    )
    told = rrb.Vertical(
        rrb.TextDocumentView(origin=entities.WHY_LINE, name="Why: this line"),
        rrb.TextDocumentView(origin=entities.WHY_SCAN, name="Why: the whole scan"),
        row_shares=[3, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(seen, told, column_shares=[3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel(entities.LINE_TIMELINE, line),
        auto_views=False,
        auto_layout=False,
    )
