"""Errors of a run as a second layer of its recording, evaluation.rrd.

The layer has the recording's id and adds to its entities: which points of each scan are labelled
wrongly, where walls are false or missed, and the true walls and doors.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.labels import Verdict
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.truth.doors import DoorComparison, FoundDoors, TrueDoors
from ffmap.algorithms.truth.labels import verdicts
from ffmap.algorithms.truth.maps import ComparedMaps
from ffmap.algorithms.truth.tally import VOXEL_M, majorities
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.shapes import at_height, packed_colors, strips, ui_radius, upright_frames
from ffmap.app.record.stream import join, send_properties, write_layout
from ffmap.app.record.whole_run import log_legend
from ffmap.blueprints import entities

VERDICT_COLORS = packed_colors(*(color for _, color in entities.VERDICTS.values()))
"""Colour of each `Verdict`, as it is recorded for every point."""
_MISSED_COLOR = entities.VERDICTS[Verdict.MISSED_WALL][1]
_WRONG_COLOR = entities.VERDICTS[Verdict.FALSE_WALL][1]
_NOT_PASSED_COLOR = entities.VERDICTS[Verdict.RIGHT][1]
LEGEND = (
    ("true wall or door", entities.TRUTH_COLOR),
    *(entities.VERDICTS[v] for v in (Verdict.FALSE_WALL, Verdict.MISSED_WALL)),
    *(entities.VERDICTS[v] for v in (Verdict.FALSE_DOOR, Verdict.MISSED_DOOR)),
    ("other wrong label", entities.VERDICTS[Verdict.OTHER][1]),
    ("right, not passed", entities.VERDICTS[Verdict.RIGHT][1]),
)
_ERRORS = [verdict for verdict in Verdict if verdict != Verdict.RIGHT]
_LIFT_M = 0.03
"""Height (m) of outlines above the grid, which would hide them."""


def log_scan_errors(
    log: Log, index: int, stamp_ns: int, truth: UInt8Array, label: UInt8Array
) -> None:
    """Log the verdict on each recorded point of a scan, and the share of each kind of error."""
    verdict = verdicts(truth, label)
    log.at(stamp_ns, index)
    log.row(entities.POINTS, None, {entities.POINT_VERDICT_COLOR: VERDICT_COLORS[verdict]})
    percent = 100.0 * np.bincount(verdict, minlength=len(Verdict)) / max(len(verdict), 1)
    for error in _ERRORS:
        log.row(entities.scan_error(error), rr.Scalars, scalars=percent[[error]])


def write_layer(
    out: Path,
    spool: Path,
    recording_id: str,
    layout: rrb.Blueprint,
    *,
    properties: Mapping[str, float],
    text: str,
    voxels: VoxelVotes,
    faces: FloatArray,
    true_doors: TrueDoors,
    found_doors: tuple[FoundDoors, DoorComparison] | None,
    maps: ComparedMaps,
) -> None:
    """Join the parts `scans-*.rrd` of the spool with the errors of the map.

    Args:
        properties: figures that become properties of the recording. text: all of them, Markdown.
        faces: (F, 2, 2) of the true walls.
    """
    write_layout(spool / "layout.rrd", recording_id, layout)
    with open_log(spool / "map.rrd", recording_id) as log:
        send_properties(log.stream, "metrics", properties)
        log.text("/evaluation/figures", text)
        log_legend(log, "/legend/errors", LEGEND)
        for verdict in _ERRORS:
            name, color = entities.VERDICTS[verdict]
            log.curve_style(entities.scan_error(verdict), f"{name}, %", color)
        walls = strips(at_height(faces, _LIFT_M), entities.TRUTH_COLOR, 1.0)
        log.static("/world/truth/walls", walls)
        _log_doors(log, true_doors, found_doors)
        _log_voxels(log, voxels)
        _log_overlays(log, maps)
    join(out, sorted(spool.glob("*.rrd")))


def _log_doors(
    log: Log, doors: TrueDoors, compared: tuple[FoundDoors, DoorComparison] | None
) -> None:
    """True doors: teal found, orange missed, gray not passed; invented doors red."""
    colors: list[entities.Color] = [entities.TRUTH_COLOR] * len(doors)
    labels = [f"{DoorState(state).name.lower()} door" for state in doors.state]
    if compared is not None:
        found, comparison = compared
        true_width_m = lengths_m(doors.ends)
        for door, match in enumerate(comparison.match):
            if match >= 0:
                state = DoorState(found.state[match]).name.lower()
                off_cm = 100 * (found.width_m[match] - true_width_m[door])
                labels[door] += f", found {state}, width {off_cm:+.0f} cm"
            else:
                passed = comparison.passed[door]
                labels[door] += ", missed" if passed else ", not passed"
                colors[door] = _MISSED_COLOR if passed else _NOT_PASSED_COLOR
        invented = np.setdiff1d(np.arange(len(found)), comparison.match)
        sills = at_height(found.ends[invented], 2 * _LIFT_M)
        words = ["invented door"] * len(sills)
        log.static("/world/errors/invented_doors", strips(sills, _WRONG_COLOR, 4.0, words))
    frames = upright_frames(doors.ends, np.full(len(doors), _LIFT_M), doors.head_m)
    log.static("/world/truth/doors", strips(frames, colors, 2.0, labels, show_labels=False))
    sills = at_height(doors.ends, 2 * _LIFT_M)
    log.static("/world/truth/door_sills", strips(sills, colors, 3.0, labels, show_labels=False))


def _log_voxels(log: Log, voxels: VoxelVotes) -> None:
    """Wrong voxels by kind, in space and laid flat for the view from above."""
    verdict = verdicts(*majorities(voxels))
    for kind in _ERRORS:
        name, color = entities.VERDICTS[kind]
        in_space = voxels.mean_position[verdict == kind].astype(np.float32)
        flat = np.unique(np.round(in_space[:, :2] / VOXEL_M), axis=0) * VOXEL_M
        plan = at_height(flat, _LIFT_M)
        for path, points in (("/world/errors/space", in_space), ("/world/errors/plan", plan)):
            drawn = rr.Points3D(points, colors=color, radii=ui_radius(1.5))
            log.static(f"{path}/{name.replace(' ', '_')}", drawn)


def _log_overlays(log: Log, maps: ComparedMaps) -> None:
    """Cells of each map that agree with the ground truth, that are false, and that are missed."""
    for name, compared in maps.items():
        for agreement, places in compared.layers:
            title, color = entities.AGREEMENTS[agreement]
            points = at_height(places, 2 * _LIFT_M)
            drawn = rr.Points3D(points, colors=color, radii=0.9 * compared.grid.cell_m)
            log.static(f"/world/overlay/{name}/{title.replace(' ', '_')}", drawn)
