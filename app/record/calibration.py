"""What both lidars see before and after a calibration."""

import uuid
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.record.shapes import rounded, ui_radius
from ffmap.app.record.stream import open_part

_ROOM, _BEFORE, _AFTER = "room", "as_given", "refined"
_COLORS = {_ROOM: (150, 150, 150), _BEFORE: (235, 80, 60), _AFTER: (70, 200, 110)}
_TITLES = {_BEFORE: "As given: red, on the horizontal lidar's walls", _AFTER: "As refined: green, on the same walls"}
_SLICE_M = 0.25
"""Half the height of the slice that is seen from above."""


def write_calibration(path: Path, height_m: float, room: FloatArray, before: FloatArray, after: FloatArray) -> None:
    """A recording of the horizontal lidar's returns, and the vertical one's (n, 3) as given and as refined, side by side.

    height_m: of a slice that is shown from above, where walls that do not meet are seen at a glance.
    """
    seen = {_ROOM: room, _BEFORE: before, _AFTER: after}
    above = [_views(rrb.Spatial2DView, "above", which, f"From above. {title}") for which, title in _TITLES.items()]
    whole = [_views(rrb.Spatial3DView, "space", which, f"In space. {title}") for which, title in _TITLES.items()]
    tabs = rrb.Tabs(rrb.Horizontal(*above, name="From above"), rrb.Horizontal(*whole, name="In space"))
    with open_part(path, str(uuid.uuid4()), rrb.Blueprint(tabs, collapse_panels=True)) as stream:
        for which, points in seen.items():
            radii = ui_radius(1.0 if which == _ROOM else 1.4)
            color, points = _COLORS[which], rounded(points)
            level = points[np.abs(points[:, 2] - height_m) < _SLICE_M, :2] * [1, -1]
            stream.log(f"above/{which}", rr.Points2D(level, colors=color, radii=radii), static=True)
            stream.log(f"space/{which}", rr.Points3D(points, colors=color, radii=radii), static=True)


def _views(
    kind: type[rrb.Spatial2DView] | type[rrb.Spatial3DView], folder: str, which: str, name: str
) -> rrb.Spatial2DView | rrb.Spatial3DView:
    return kind(origin=folder, contents=[f"/{folder}/{_ROOM}", f"/{folder}/{which}"], name=name)
