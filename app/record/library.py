"""Results of the library, in a recording of the user's own."""

from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.scan import FloatArray
from ffmap.app.record.building import log_cloud, log_grid
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_styles, log_trajectory
from ffmap.app.record.shapes import annotations, panel_mesh, strips, upright_frames
from ffmap.app.record.whole_run import log_label_legend
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints.entities import (
    CLASSES,
    DOOR_COLOR,
    FURNITURE_FREE,
    GRID,
    STAMP_TIMELINE,
    TRAJECTORY,
    WALL_COLOR,
)
from ffmap.blueprints.views import aslant, following, layout, legend, space, view_of

if TYPE_CHECKING:
    from ffmap.app.library import OpenedRun

_LEGEND = "/legend/labels"


def log_into(
    target: ModuleType | rr.RecordingStream | None,
    shown: rrb.Blueprint,
    write: Callable[[Log], None],
) -> None:
    """Log into a recording, and send its layout.

    target: the module `rerun` or None for the current recording. shown: its layout.
    Raises RuntimeError without a current recording.
    """
    stream = target if isinstance(target, rr.RecordingStream) else rr.get_data_recording()
    if stream is None:
        raise RuntimeError("no recording to log into: call rr.init(...) first")
    log = Log(stream, Detail.LINES)
    write(log)
    log.send_rows()
    rr.send_blueprint(shown, recording=stream)


def building_layout(run: "OpenedRun") -> rrb.Blueprint:
    """Return the layout of a building without scans."""
    shown = ["/world/building/**", "- /world/building/ceiling", f"{GRID}/**", TRAJECTORY]
    building = space("The building (ceiling hidden)", shown, aslant(*view_of(run.grid)))
    root = rrb.Vertical(legend(_LEGEND, "Colours of the labels", 6), building, row_shares=[1, 7])
    return layout(root, following(STAMP_TIMELINE))


def log_building(log: Log, run: "OpenedRun") -> None:
    """Log what a run has written: cloud, walls, doors, grid, trajectory."""
    log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, annotations(CLASSES))
    log_label_legend(log, _LEGEND)
    log_odometry_styles(log)
    if run.cloud is not None:
        log_cloud(log, *run.cloud)
    if run.grid is not None:
        log_grid(log, FURNITURE_FREE, run.grid)
    if run.trajectory is not None:
        log_trajectory(log, run.trajectory.stamp_ns, run.trajectory.T_map_base, None)
    if len(run.walls):
        bottom_m, top_m = (run.walls[name].to_numpy() for name in ("bottom", "top"))
        mesh = panel_mesh(run.ends(run.walls), bottom_m, top_m, WALL_COLOR)
        log.static("/world/building/walls", mesh)
    if len(run.doors):
        head_m: FloatArray = run.doors["height"].to_numpy()
        frames = upright_frames(run.ends(run.doors), np.zeros(len(head_m)), head_m)
        states = run.doors["state"].to_pylist()
        drawn = strips(frames, DOOR_COLOR, 3.0, [f"{state} door" for state in states])
        log.static("/world/building/doors", drawn)
