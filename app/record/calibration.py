"""The returns of both lidars before and after a calibration."""

import uuid
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.record.shapes import rounded, ui_radius
from ffmap.app.record.stream import open_part

_COLORS = {"room": (150, 150, 150), "as_given": (235, 80, 60), "refined": (70, 200, 110)}
_TITLES = {
    "as_given": "As given: red, on the walls of the horizontal lidar",
    "refined": "As refined: green, on the same walls",
}
_SLICE_M = 0.25
"""Half the height of the slice in the view from above."""


def write_calibration(
    path: Path, height_m: float, room: FloatArray, before: FloatArray, after: FloatArray
) -> None:
    """Write returns of the horizontal lidar, and of the vertical one as given and as refined.

    All are (n, 3). height_m: of the slice in the view from above.
    """
    above, whole = (
        [
            view(origin=f, contents=[f"/{f}/room", f"/{f}/{which}"], name=f"{where}. {title}")
            for which, title in _TITLES.items()
        ]
        for view, f, where in (
            (rrb.Spatial2DView, "above", "From above"),
            (rrb.Spatial3DView, "space", "In space"),
        )
    )
    tabs = rrb.Tabs(
        rrb.Horizontal(*above, name="From above"), rrb.Horizontal(*whole, name="In space")
    )
    layout = rrb.Blueprint(tabs, collapse_panels=True)
    with open_part(path, str(uuid.uuid4()), layout) as stream:
        for (which, color), points in zip(_COLORS.items(), (room, before, after), strict=True):
            radii = ui_radius(1.0 if which == "room" else 1.4)
            points = rounded(points)
            level = points[np.abs(points[:, 2] - height_m) < _SLICE_M, :2] * [1, -1]
            seen_above = rr.Points2D(level, colors=color, radii=radii)
            stream.log(f"above/{which}", seen_above, static=True)
            in_space = rr.Points3D(points, colors=color, radii=radii)
            stream.log(f"space/{which}", in_space, static=True)
