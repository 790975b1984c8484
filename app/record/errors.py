"""What is wrong, where: a run's errors as a second layer of its recording, `evaluation.rrd`.

The layer has the run's own recording id and adds to its entities: opened together, each scan shows which of its points
are labelled wrongly, and the map where walls are false or missed, with the truth's walls and doors as outlines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.doors import DoorFigures, FoundDoors, TrueDoors
from ffmap.algorithms.truth.labels import verdicts
from ffmap.algorithms.truth.maps import ComparedMap, ComparedMaps, false_and_missed
from ffmap.algorithms.truth.tally import CUBE_M, Tally, majorities
from ffmap.app.folder.figures import queried
from ffmap.app.record.log import Log, evidence, open_log
from ffmap.app.record.shapes import at_height, strips, ui_radius, upright_frames
from ffmap.app.record.stream import send_part, send_properties
from ffmap.app.record.whole_run import log_legend
from ffmap.blueprints import entities

VERDICT_COLORS = np.array(
    [(r << 24) | (g << 16) | (b << 8) | 255 for _, (r, g, b) in entities.VERDICTS.values()], np.uint32
)
"""How the verdict of each point of a scan is recorded."""
_MISSED_COLOR = entities.VERDICTS[Verdict.MISSED_WALL][1]
_WRONG_COLOR = entities.VERDICTS[Verdict.FALSE_WALL][1]
_ERRORS = [verdict for verdict in Verdict if verdict != Verdict.RIGHT]
_LIFT_M = 0.03
"""Height in metres of outlines above the grid, which would hide them."""


def log_scan_errors(log: Log, index: int, stamp_ns: int, truth: UInt8Array, label: UInt8Array) -> None:
    """The points of one scan, in the order of its recorded ones; and the share of each kind of error."""
    verdict = verdicts(truth, label)
    log.at(stamp_ns, index)
    verdicts_of_points = {entities.POINT_VERDICT_COLOR: VERDICT_COLORS[verdict]}
    log.now(entities.POINTS, evidence(**verdicts_of_points))
    percent = 100.0 * np.bincount(verdict, minlength=len(Verdict)) / max(len(verdict), 1)
    for error in _ERRORS:
        log.now(entities.scan_error(error), rr.Scalars(percent[error]))


@dataclass(frozen=True)
class MapErrors:
    """What a run was compared with, and what came of it.

    metrics: those by which runs are asked for become properties of the recording. text: the figures in Markdown.
    faces: (F, 2, 2) of the true walls. compared_doors: None where the run has none. maps: by name.
    """

    metrics: Mapping[str, Any]
    text: str
    tally: Tally
    faces: FloatArray
    doors: TrueDoors
    compared_doors: tuple[FoundDoors, DoorFigures] | None
    maps: ComparedMaps


def write_layer(
    out: Path, parts: Sequence[Path], recording_id: str, blueprint: rrb.Blueprint, errors: MapErrors
) -> None:
    """Join the scans' parts with what is wrong on the map. parts: with the scans' errors."""
    with open_log(out, recording_id, layout=blueprint) as log:
        send_properties(log.stream, "metrics", queried(errors.metrics))
        log.text(entities.FIGURES, errors.text)
        log_legend(log, entities.ERROR_LEGEND, entities.ERROR_LEGEND_ENTRIES)
        for verdict in _ERRORS:
            name, color = entities.VERDICTS[verdict]
            log.curve_style(entities.scan_error(verdict), f"{name}, %", color)
        log.static(entities.TRUTH_WALLS, strips(at_height(errors.faces, _LIFT_M), entities.TRUTH_COLOR, 1.0))
        _log_doors(log, errors.doors, errors.compared_doors)
        _log_cubes(log, errors.tally)
        for name, compared in errors.maps.items():
            log_overlay(log, name, compared)
        for part in parts:
            send_part(log.stream, part)


def _log_doors(log: Log, doors: TrueDoors, compared: tuple[FoundDoors, DoorFigures] | None) -> None:
    """True doors: white found, orange missed, gray not passed; invented ones red."""
    colors: list[entities.Color] = [entities.TRUTH_COLOR] * len(doors)
    labels = [f"{DoorState(state).name.lower()} door" for state in doors.state]
    if compared is not None:
        found, figures = compared
        true_width_m = lengths_m(doors.ends)
        for door, (match, passed) in enumerate(zip(figures.match, figures.passed, strict=True)):
            if match >= 0:
                state = DoorState(found.state[match]).name.lower()
                labels[door] += f", found {state}, width {100 * (found.width_m[match] - true_width_m[door]):+.0f} cm"
            else:
                labels[door] += ", missed" if passed else ", not passed"
                colors[door] = _MISSED_COLOR if passed else entities.VERDICTS[Verdict.RIGHT][1]
        invented = np.setdiff1d(np.arange(len(found)), figures.match)
        sills = at_height(found.ends[invented], 2 * _LIFT_M)
        log.static(entities.INVENTED_DOORS, strips(sills, _WRONG_COLOR, 4.0, ["invented door"] * len(sills)))
    frames = upright_frames(doors.ends, np.full(len(doors), _LIFT_M), doors.head_m)
    log.static(entities.TRUTH_DOORS, strips(frames, colors, 2.0, labels, show_labels=False))
    sills = at_height(doors.ends, 2 * _LIFT_M)
    log.static(entities.TRUTH_DOOR_SILLS, strips(sills, colors, 3.0, labels, show_labels=False))


def _log_cubes(log: Log, tally: Tally) -> None:
    """The cubes that are wrong, each kind an entity of its own; in space, and laid flat, for a view from above."""
    verdict = verdicts(*majorities(tally.cubes))
    for kind in _ERRORS:
        name, color = entities.VERDICTS[kind]
        in_space = tally.cubes.mean_position[verdict == kind].astype(np.float32)
        flat = np.unique(np.round(in_space[:, :2] / CUBE_M), axis=0) * CUBE_M
        for path, points in ((entities.ERRORS, in_space), (entities.PLAN_ERRORS, at_height(flat, _LIFT_M))):
            log.static(f"{path}/{name.replace(' ', '_')}", rr.Points3D(points, colors=color, radii=ui_radius(1.5)))


def log_overlay(log: Log, name: str, compared: ComparedMap) -> None:
    """A map against what it was compared with: an entity for what agrees, what is false and what is missed."""
    for agreement, places in false_and_missed(compared.figures, compared.unseen):
        title, color = entities.AGREEMENTS[agreement]
        points = rr.Points3D(at_height(places, 2 * _LIFT_M), colors=color, radii=0.9 * compared.grid.cell_m)
        log.static(f"{entities.OVERLAYS}/{name}/{title.replace(' ', '_')}", points)
