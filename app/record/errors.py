"""What is wrong, where: a run's errors as a second layer of its recording, `evaluation.rrd`.

The layer has the run's own recording id and adds to its entities: opened together, each scan shows which of its points
are labelled wrongly, and the map where walls are false or missed, with the truth's walls and doors as outlines.
"""

from collections.abc import Mapping
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
from ffmap.app.record.log import evidence, scan_columns, set_time
from ffmap.app.record.shapes import upright_frames
from ffmap.app.record.stream import join, open_part, send_properties
from ffmap.app.record.whole_run import log_legend
from ffmap.blueprints import entities

VERDICT_COLORS = np.array(
    [(r << 24) | (g << 16) | (b << 8) | 255 for _, (r, g, b) in entities.VERDICTS.values()], np.uint32
)
"""How the verdict of each point of a scan is recorded."""
_MISSED_COLOR = entities.VERDICTS[Verdict.MISSED_WALL][1]
_WRONG_COLOR = entities.VERDICTS[Verdict.FALSE_WALL][1]
_LIFT_M = 0.03
"""Outlines lie so far above the grid, which would hide them."""


class ScanErrors:
    """Collects scans' errors and logs them; one for each part of the layer."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._index: list[int] = []
        self._stamp_ns: list[int] = []
        self._shares: list[FloatArray] = []

    def log(self, index: int, stamp_ns: int, truth: UInt8Array, label: UInt8Array) -> None:
        """The points of one scan, in the order of its recorded ones."""
        verdict = verdicts(truth, label)
        set_time(self._stream, stamp_ns, index)
        self._stream.log(entities.POINTS, evidence({entities.POINT_VERDICT_COLOR: VERDICT_COLORS[verdict]}))
        self._index.append(index)
        self._stamp_ns.append(stamp_ns)
        self._shares.append(100.0 * np.bincount(verdict, minlength=len(Verdict)) / max(len(verdict), 1))

    def finish(self) -> None:
        """The share of each kind of error in each scan, as curves."""
        if not self._index:
            return
        indexes = scan_columns(self._index, self._stamp_ns)
        for verdict in Verdict:
            if verdict != Verdict.RIGHT:
                columns = rr.Scalars.columns(scalars=np.array(self._shares)[:, verdict])
                self._stream.send_columns(entities.scan_error(verdict), indexes, columns)


def write_layer(
    out: Path,
    parts: list[Path],
    spool: Path,
    recording_id: str,
    blueprint: rrb.Blueprint,
    metrics: Mapping[str, Any],
    text: str,
    tally: Tally,
    faces: FloatArray,
    doors: TrueDoors,
    compared_doors: tuple[FoundDoors, DoorFigures] | None,
    maps: ComparedMaps,
) -> None:
    """Join the scans' parts with what is wrong on the map.

    parts: of `ScanErrors`, in `spool`. metrics: those by which runs are asked for become properties of the recording.
    text: the figures in Markdown.
    faces: (F, 2, 2) of the true walls. compared_doors: None where the run has none. maps: by name.
    """
    layout, own = spool / "layout.rrd", spool / "map.rrd"
    with open_part(layout, recording_id) as stream:
        # The recording brings a layout of its own, which may be there first.
        stream.send_blueprint(blueprint, make_active=True, make_default=True)
    with open_part(own, recording_id) as stream:
        send_properties(stream, "metrics", queried(metrics))
        stream.log(entities.FIGURES, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        log_legend(stream, entities.ERROR_LEGEND, entities.ERROR_LEGEND_ENTRIES)
        _log_curve_styles(stream)
        _log_walls(stream, faces)
        _log_doors(stream, doors, compared_doors)
        _log_cubes(stream, tally)
        for name, compared in maps.items():
            log_overlay(stream, name, compared)
    join([layout, own, *parts], out)


def _log_curve_styles(stream: rr.RecordingStream) -> None:
    for verdict in Verdict:
        if verdict != Verdict.RIGHT:
            name, color = entities.VERDICTS[verdict]
            style = rr.SeriesLines(colors=color, names=f"{name}, %", widths=1.5)
            stream.log(entities.scan_error(verdict), style, static=True)


def _log_walls(stream: rr.RecordingStream, faces: FloatArray) -> None:
    lines = np.pad(faces, ((0, 0), (0, 0), (0, 1)), constant_values=_LIFT_M)
    stream.log(
        entities.TRUTH_WALLS,
        rr.LineStrips3D(lines.astype(np.float32), colors=entities.TRUTH_COLOR, radii=rr.Radius.ui_points(1.0)),
        static=True,
    )


def _log_doors(stream: rr.RecordingStream, doors: TrueDoors, compared: tuple[FoundDoors, DoorFigures] | None) -> None:
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
        sills = np.pad(found.ends[invented], ((0, 0), (0, 0), (0, 1)), constant_values=2 * _LIFT_M)
        stream.log(
            entities.INVENTED_DOORS,
            rr.LineStrips3D(
                sills.astype(np.float32),
                colors=_WRONG_COLOR,
                radii=rr.Radius.ui_points(4.0),
                labels=["invented door"] * len(sills),
            ),
            static=True,
        )
    sills = np.pad(doors.ends, ((0, 0), (0, 0), (0, 1)), constant_values=2 * _LIFT_M).astype(np.float32)
    frames = upright_frames(doors.ends, np.full(len(doors), _LIFT_M), doors.head_m)
    for path, strips, radius_ui in (
        (entities.TRUTH_DOORS, frames, 2.0),
        (entities.TRUTH_DOOR_SILLS, sills, 3.0),
    ):
        stream.log(
            path,
            rr.LineStrips3D(
                strips, colors=colors, radii=rr.Radius.ui_points(radius_ui), labels=labels, show_labels=False
            ),
            static=True,
        )


def _log_cubes(stream: rr.RecordingStream, tally: Tally) -> None:
    """The cubes that are wrong, each kind an entity of its own; in space, and laid flat, for a view from above."""
    verdict = verdicts(*majorities(tally.cubes))
    for kind in Verdict:
        if kind == Verdict.RIGHT:
            continue
        name, color = entities.VERDICTS[kind]
        in_space = tally.cubes.mean_position[verdict == kind].astype(np.float32)
        flat = np.unique(np.round(in_space[:, :2] / CUBE_M), axis=0) * CUBE_M
        for path, points in (
            (entities.ERRORS, in_space),
            (entities.PLAN_ERRORS, np.pad(flat, ((0, 0), (0, 1)), constant_values=_LIFT_M)),
        ):
            stream.log(
                f"{path}/{name.replace(' ', '_')}",
                rr.Points3D(points, colors=color, radii=rr.Radius.ui_points(1.5)),
                static=True,
            )


def log_overlay(stream: rr.RecordingStream, name: str, compared: ComparedMap) -> None:
    """A map against what it was compared with: an entity for what agrees, what is false and what is missed."""
    for agreement, places in false_and_missed(compared):
        title, color = entities.AGREEMENTS[agreement]
        stream.log(
            f"{entities.OVERLAYS}/{name}/{title.replace(' ', '_')}",
            rr.Points3D(
                np.pad(places, ((0, 0), (0, 1)), constant_values=2 * _LIFT_M).astype(np.float32),
                colors=color,
                radii=0.9 * compared.grid.cell_m,
            ),
            static=True,
        )
