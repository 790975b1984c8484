"""One scan, line by line: the line in space, its curve, its profile, and in words why it became what it is."""

import math
from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from ffmap.blueprints import entities
from ffmap.blueprints.entities import CurveSheet
from ffmap.blueprints.views import layout, opening_at, space

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

    profile_m: largest horizontal range and height that the profile shows. line: the line to open at; None for the
    first. faults: those that are marked. look_at_m: what to look at, in the level frame; None for the whole scan.
    """
    range_m, height_m = profile_m
    seen = rrb.Vertical(
        _line_in_its_scan(range_m, faults, look_at_m),
        rrb.Horizontal(
            _differences(),
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
    return layout(rrb.Horizontal(seen, told, column_shares=[3, 2]), opening_at(entities.LINE_TIMELINE, line))


def _line_in_its_scan(
    range_m: float, faults: Sequence[entities.Fault], look_at_m: tuple[float, float, float] | None
) -> rrb.Spatial3DView:
    marked = "".join(f"; {_COLOR_NAMES[fault]}: {entities.FAULT_CLASSES[fault][0]}" for fault in faults)
    x, y, z = look_at_m or (0.0, 0.0, 1.0)
    distance_m = max(1.3 * range_m if look_at_m is None else 2.0 * math.hypot(x, y), 5.0)
    return space(
        f"The line in its scan: white, its rays a fan{marked}",
        [
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
        # From behind the robot and above, on the side that the line's wall faces, with both sides in view.
        rrb.EyeControls3D(
            position=(x - 0.85 * distance_m, -math.copysign(0.4 * distance_m, y), 0.5 * distance_m),
            look_target=(x, y, z),
        ),
        origin=entities.SCAN,
        overrides={
            entities.POINTS: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0)),
            entities.OPENINGS: rr.LineStrips3D.from_fields(show_labels=False),
        },
    )


def _differences() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
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
    )
