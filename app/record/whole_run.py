"""What holds throughout a recording: classes, styles, sensors, explanations, properties, warnings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.own_body import OwnBody
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.record import FROM_ODOMETRY
from ffmap.app.record.curves import log_curve_sheet
from ffmap.app.record.log import Log
from ffmap.app.record.shapes import POINT_RADIUS_UI, annotations, rounded, transform, ui_radius, words
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import CurveSheet, Legend

_POINT_STYLES: tuple[tuple[str, float, entities.Color | None], ...] = (
    (entities.POINTS, POINT_RADIUS_UI, None),
    (entities.RELABELLED, 2.5, None),
    (entities.DOOR_CONDITIONS, 5.0, None),
    (entities.KEYPOINTS, 2.0, entities.KEYPOINT_COLOR),
    (entities.LOCAL_MAP, 1.0, entities.LOCAL_MAP_COLOR),
    (entities.WEAK_REGISTRATION, 6.0, entities.WEAK_COLOR),
    (entities.SUBMAPS, 4.0, entities.LOOP_COLOR),
)
_LINE_STYLES: tuple[tuple[str, float, entities.Color | None], ...] = (
    (entities.TRAJECTORY, 2.0, entities.TRAJECTORY_COLOR),
    (entities.LOOPS, 0.75, None),
    (entities.WAY_OF_ODOMETRY, 1.5, entities.WAY_OF_ODOMETRY_COLOR),
    (entities.FLOOR, 1.0, entities.CLASSES[Label.FLOOR][1]),
    (entities.CEILING, 1.0, entities.CLASSES[Label.CEILING][1]),
    (entities.LINES, 0.75, None),
    (entities.EXAMPLE_LINE, 3.0, entities.EXAMPLE_COLOR),
    (entities.UPMOST, 2.0, entities.UPMOST_COLOR),
    (entities.BOTTOMMOST, 2.0, entities.BOTTOMMOST_COLOR),
    (entities.DOOR_LINES, 1.5, entities.CLASSES[Label.DOOR][1]),
    (entities.OPENINGS, 3.0, entities.CLASSES[Label.DOOR][1]),
)


def log_sensors(log: Log, sensors: Mapping[str, FloatArray]) -> None:
    """Where the lidars sit: T_base_sensor (4, 4) by role."""
    for role, T_base_sensor in sensors.items():
        log.static(f"{entities.BASE}/{role}", transform(T_base_sensor), rr.TransformAxes3D(0.3))


def log_own_body(log: Log, role: str, body: OwnBody) -> None:
    """What a lidar sees of the robot itself, which is left out of its scans."""
    points = rr.Points3D(rounded(body.points_sensor), radii=0.02, colors=entities.OWN_BODY_COLOR)
    log.static(f"{entities.BASE}/{role}/{entities.OWN_BODY}", points)


def log_static(
    log: Log,
    sensors: Mapping[str, FloatArray],
    readme: str,
    line_pairs: int | None = None,
    slope_max: float | None = None,
) -> None:
    """What holds throughout: classes, styles, frames, sensors, the sheet of the curves, the explanation.

    sensors: as of `log_sensors`. line_pairs, slope_max: pairs of point lines and the threshold of eq. 2; None where nothing
    is labelled. Without lines the sheet of the curves has the large one alone.
    """
    log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, annotations(entities.CLASSES))
    log.static(entities.LINES, annotations(entities.LINE_OUTCOMES))
    log.static(entities.DOOR_CONDITIONS, annotations(entities.DOOR_CONDITION_CLASSES))
    log.text(entities.README, readme)
    log.text(entities.GLANCE, entities.glance(labelled=line_pairs is not None, scans=log.detail is not Detail.MAP))
    log.text(entities.EVALUATION_HELP, entities.EVALUATION_HELP_TEXT)
    log_legend(log, entities.LABEL_LEGEND, entities.LABEL_LEGEND_ENTRIES)
    log.static(entities.BASE, rr.TransformAxes3D(0.6))
    log_sensors(log, sensors)
    for archetype, styles in ((rr.Points3D, _POINT_STYLES), (rr.LineStrips3D, _LINE_STYLES)):
        for path, radius_ui, color in styles:
            log.static(path, archetype.from_fields(radii=ui_radius(radius_ui), colors=color))
    # Their labels are whole sentences: they show where the pointer rests.
    log.static(entities.UPMOST, rr.LineStrips3D.from_fields(show_labels=False))
    log.static(entities.DOOR_CONDITIONS, rr.Points3D.from_fields(show_labels=False))
    for label in Label:
        name, color = entities.CLASSES[label]
        log.curve_style(f"{entities.LABEL_COUNTS}/{name}", name, color)
    for path, (name, color) in entities.SERIES.items():
        log.curve_style(path, name, color)
    if line_pairs is not None and slope_max is not None and log.detail is Detail.LINES:
        log_curve_sheet(log, CurveSheet(line_pairs), slope_max)


def layout(
    line_pairs: int | None,
    detail: Detail,
    record: dict[str, Any],
    grid: GridMap | None = None,
    several_lidars: bool = False,
) -> rrb.Blueprint:
    """How the recording opens; with the grid, so that the whole building is in view.

    line_pairs: as for `log_static`. record: what run.json holds. several_lidars: whether scans are of more than one.
    """
    return run_blueprint.build(
        line_pairs,
        *run_blueprint.view_of(grid),
        scans=detail is not Detail.MAP,
        registered=record["poses_from"] == FROM_ODOMETRY,
        lines=detail is Detail.LINES,
        growing=grid is None and record["poses_from"] == FROM_ODOMETRY,
        several_lidars=several_lidars,
    )


def log_warnings(log: Log, warnings: Sequence[str]) -> None:
    """Those of the whole run; that there are none is worth telling too."""
    log.text(entities.WARNINGS, "\n".join(f"- {warning}" for warning in warnings) or "None.")


def log_legend(log: Log, path: str, entries: Sequence[tuple[str, entities.Color]]) -> None:
    """Names side by side, each below a dot in its colour, as `blueprints.run` shows them."""
    across = Legend.STEP * (np.arange(len(entries)) + 0.5)
    names, colors = zip(*entries, strict=True)
    dots = np.column_stack([across, np.zeros(len(entries))])
    log.static(f"{path}/dots", rr.Points2D(dots, colors=colors, radii=ui_radius(Legend.DOT_UI)))
    log.static(f"{path}/names", words(dots + np.array([0.0, Legend.NAMES_BELOW]), names))
