"""What holds for the whole recording of a run: classes, extrinsics, explanations, warnings."""

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import PurePath
from string import Template
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.own_body import OwnBody
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.panels import KIND_WORDS
from ffmap.algorithms.maps.grid import GridMap
from ffmap.app.folder.record import FROM_ODOMETRY
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_odometry_styles
from ffmap.app.record.scans import log_scan_styles
from ffmap.app.record.shapes import annotations, rounded, transform, ui_radius, words
from ffmap.app.record.tables import table
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import CLASSES, Color

_OWN_BODY_COLOR: Color = (255, 120, 200)
_GLANCE_SCANS = """\
**One scan of the vertical lidar, and the map up to it.** The time cursor at the bottom selects \
the scan. Upper left: its final labels. Below: detection of its walls. Right: all scans."""
_GLANCE_MAP = """\
**The building from all scans**: its cloud, walls, doors, windows, grid map, and what was measured \
of each door. Single scans were not recorded (`--detail lines` records them)."""
_GLANCE_POSES = """\
**The trajectory of the lidar, and the registration of each sweep.** Nothing was labelled, because \
no lidar sees the walls from floor to ceiling. Move the time cursor at the bottom to see other \
sweeps."""
_EVALUATION_HELP = """\
# Comparison with ground truth
The tabs **Figures** and **Errors** beside this one are empty without `evaluation.rrd`. Open it
together with `recording.rrd`, or run `ffmap view RUN`, which opens both.

`ffmap run` writes that file if the bag has ground truth. `ffmap evaluate RUN` writes it later;
`--truth FILE` takes the ground truth from another bag.
"""


def log_static(
    log: Log,
    sensors: Mapping[str, FloatArray],
    readme: str,
    slope_max: float | None = None,
) -> None:
    """Log what holds for the whole recording.

    sensors: T_base_sensor (4, 4) by role. slope_max: the threshold of eq. 2; None if nothing is
    labelled.
    """
    log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, annotations(CLASSES))
    log.text("/readme", readme)
    scans = _GLANCE_MAP if log.detail is Detail.MAP else _GLANCE_SCANS
    log.text("/glance", _with_pointer(_GLANCE_POSES if slope_max is None else scans))
    log.text("/evaluation/help", _EVALUATION_HELP)
    log_label_legend(log, "/legend/labels")
    log.static("/world/base", rr.TransformAxes3D(0.6))
    for role, T_base_sensor in sensors.items():
        log.static(f"/world/base/{role}", transform(T_base_sensor), rr.TransformAxes3D(0.3))
    log_odometry_styles(log)
    if slope_max is not None:
        log_scan_styles(log, slope_max)


def _with_pointer(glance: str) -> str:
    return f"{glance} The last tab, **Read me**, explains the rest."


def log_own_body(log: Log, role: str, body: OwnBody) -> None:
    """Log the returns of a lidar from the robot itself, which are excluded from its scans."""
    points = rr.Points3D(rounded(body.points_sensor), radii=0.02, colors=_OWN_BODY_COLOR)
    log.static(f"/world/base/{role}/own_body", points)


def log_warnings(log: Log, warnings: Sequence[str]) -> None:
    """Log the warnings of the whole run."""
    log.text("/warnings", "\n".join(f"- {warning}" for warning in warnings) or "None.")


def log_label_legend(log: Log, path: str) -> None:
    """Log names and colours of the labels."""
    labels = {"door": "door (leaf)", "clutter": "clutter (furniture)", "outside": "outside (glass)"}
    classes = list(CLASSES.values())[:6]
    log_legend(log, path, [(labels.get(name, name), color) for name, color in classes])


def log_legend(log: Log, path: str, entries: Sequence[tuple[str, Color]]) -> None:
    """Log names side by side, each below a dot in its colour."""
    names, colors = zip(*entries, strict=True)
    dots = np.column_stack([120.0 * np.arange(len(entries)), np.zeros(len(entries))])
    log.static(f"{path}/dots", rr.Points2D(dots, colors=colors, radii=ui_radius(8.0)))
    log.static(f"{path}/names", words(dots + np.array([0.0, 6.0]), names))


def layout(
    labelled: bool,
    detail: Detail,
    record: Mapping[str, Any],
    grid: GridMap | None = None,
    several_lidars: bool = False,
) -> rrb.Blueprint:
    """Return the layout of a run's recording; with the grid, the whole building is in view.

    record: content of run.json. several_lidars: scans are from several lidars.
    """
    registered = record["poses_from"] == FROM_ODOMETRY
    return run_blueprint.build(
        labelled,
        *run_blueprint.view_of(grid),
        scans=detail is not Detail.MAP,
        registered=registered,
        lines=detail is Detail.LINES,
        growing=grid is None and registered,
        several_lidars=several_lidars,
    )


def explain(record: Mapping[str, Any]) -> str:
    """Return the read-me of a recording in Markdown. record: content of run.json at the start."""
    bag = record.get("bag", {})
    facts = {
        "bag": bag.get("path"),
        "further parts": " ".join((bag.get("parts") or [])[1:]),
        "digest": bag.get("digest"),
        "extrinsics from": record.get("mounts_from"),
        "poses from": record.get("poses_from"),
        "started": record.get("started"),
        "settings": record.get("settings_hash"),
        **record.get("versions", {}),
    }
    rig = record.get("rig", {})
    lidars = [
        f"- `{lidar['topic']}` ({role.replace('_', ' ')}): "
        f"{'localization' if role == 'horizontal' else 'mapping; its clouds are labelled'}"
        for role, lidar in rig.items()
    ]
    run = table(("", ""), [(name, f"`{value}`") for name, value in facts.items() if value])
    settings = [
        (step, name, value)
        for step, values in record.get("settings", {}).items()
        if isinstance(values, Mapping)
        for name, value in values.items()
    ]
    if settings:
        run += "\n\n## Settings\n" + table(("step", "setting", "value"), settings)
    text = resources.files("ffmap.app.record").joinpath("readme.md").read_text("utf-8")
    return Template(text).substitute(
        bag=PurePath(str(bag.get("path") or "A run")).name,
        lidars="\n".join(lidars),
        reasons="; ".join(f"{code} {words}" for code, words in KIND_WORDS.items()),
        run=run,
    )
