"""One scan's evidence as a recording whose timeline `line` steps through its point lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.app.record.curves import log_line
from ffmap.app.record.line_reasons import LineReason, line_document
from ffmap.app.record.log import Log
from ffmap.app.record.scans import log_scan
from ffmap.app.record.shapes import upright_frames
from ffmap.app.record.stream import join, open_part
from ffmap.app.record.whole_run import log_static
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from ffmap.blueprints import inspect as inspect_blueprint
from ffmap.blueprints.entities import Fault

_SIGHT_COLOR = (255, 255, 255, 45)
_LIFT_M = 0.1
"""Distance in metres of a mark from its return, towards the lidar: the plane that it is in would hide it."""
_STYLE_COLORS = {"upmost": entities.UPMOST_COLOR, "bottommost": entities.BOTTOMMOST_COLOR, "others": (120, 140, 170)}


@dataclass(frozen=True, eq=False)
class ScanFaults:
    """fault: (n,) `Fault` of each return. by_truth: whether the run was evaluated; else it is told what was relabelled."""

    fault: UInt8Array
    by_truth: bool

    @property
    def kinds(self) -> tuple[Fault, ...]:
        """The faults that occur."""
        return tuple(fault for fault in Fault if fault != Fault.NONE and (self.fault == fault).any())

    def counts(self, lines: PointLines) -> IntArray:
        """(2n,) how many returns of each point line are at fault."""
        line = np.repeat(np.arange(len(lines)), np.diff(lines.starts))
        return np.bincount(line[self.fault[lines.order] > 0], minlength=len(lines))

    def worst_line(self, lines: PointLines) -> int | None:
        """The line with most of them, the lowest of several; None where there is none."""
        counts = self.counts(lines)
        return int(counts.argmax()) if counts.any() else None


def write(
    out: Path,
    spool: Path,
    recording_id: str,
    level: LevelledScan,
    labelling: ScanLabelling,
    reasons: Sequence[LineReason],
    faults: ScanFaults | None,
    document: str,
    line: int | None,
) -> None:
    """Write the recording of one scan.

    spool: a folder for its parts. faults: what is marked. document: on the whole scan, in Markdown. line: the one to open at.
    """
    placed = level.placed
    layout, content = spool / "layout.rrd", spool / "content.rrd"
    range_m, height_m = _profile_size(placed, labelling)
    with open_part(layout, recording_id) as stream:
        stream.send_blueprint(
            inspect_blueprint.build(
                (range_m, height_m), line, faults.kinds if faults is not None else (), _middle(placed, labelling, line)
            ),
            make_active=True,
            make_default=True,
        )
    with open_part(content, recording_id) as stream:
        log = Log(stream, Detail.LINES, timeless=True)
        log_static(log, {}, document, 0, labelling.settings.vertical_structures.slope_max)
        log_scan(log, 0, level, labelling, 0, {})
        lines = _Lines(log, placed, labelling, range_m, height_m)
        if faults is not None:
            lines.mark(faults)
        lines.log(reasons, document)
    join([layout, content], out)


def _profile_size(placed: PlacedScan, labelling: ScanLabelling) -> tuple[float, float]:
    """Largest horizontal range and height of what the profiles show: all but the farthest hundredth of the samples."""
    samples = labelling.lines.samples[labelling.lines.samples[:, 0] >= 0]
    if not len(samples):
        return 4.0, 3.0
    range_m = np.linalg.norm(placed.points_level[samples.ravel(), :2] - placed.origin_level[:2], axis=1)
    height_m = labelling.height_m[samples.ravel()]
    return float(np.percentile(range_m, 99)) + 0.4, float(np.percentile(height_m, 99.9)) + 0.4


def _middle(placed: PlacedScan, labelling: ScanLabelling, line: int | None) -> tuple[float, float, float] | None:
    """Between the robot and a line, in the level frame; None where there is no such line."""
    samples = labelling.lines.samples[line] if line is not None else labelling.lines.samples[:0]
    if not (samples >= 0).any():
        return None
    x, y, z = (np.median(placed.points_level[samples], axis=0) + placed.origin_level) / 2
    return float(x), float(y), float(z)


class _Lines:
    """Logs every line at its own place on the timeline `line`."""

    def __init__(
        self,
        log: Log,
        placed: PlacedScan,
        labelling: ScanLabelling,
        range_m: float,
        height_m: float,
    ) -> None:
        self._log, self._stream = log, log.stream
        self._points, self._labelling = placed.points_level, labelling
        self._origin = placed.origin_level
        self._range_m = np.linalg.norm(placed.points_level[:, :2] - placed.origin_level[:2], axis=1)
        self._faults: ScanFaults | None = None
        self._log_styles(range_m, height_m)

    def mark(self, faults: ScanFaults) -> None:
        """Let the returns stand out whose final labels are wrong, in the scan and in each line."""
        self._faults = faults
        marked = np.flatnonzero(faults.fault)
        rays = self._points[marked] - self._origin
        drawn = self._points[marked] - _LIFT_M * rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), _LIFT_M)
        classes = rr.AnnotationContext(
            [
                rr.AnnotationInfo(id=int(k), label=name, color=color)
                for k, (name, color) in entities.FAULT_CLASSES.items()
            ]
        )
        for path in (entities.FAULTS, entities.PROFILE_FAULTS):
            self._stream.log(path, classes, static=True)
        self._stream.log(
            entities.FAULTS,
            rr.Points3D(drawn.astype(np.float32), class_ids=faults.fault[marked], radii=rr.Radius.ui_points(3.5)),
            static=True,
        )

    def log(self, reasons: Sequence[LineReason], document: str) -> None:
        self._stream.log(entities.WHY_SCAN, rr.TextDocument(document, media_type=rr.MediaType.MARKDOWN), static=True)
        for reason in reasons:
            self._stream.reset_time()
            self._stream.set_time(entities.LINE_TIMELINE, sequence=reason.line)
            self._stream.log(
                entities.WHY_LINE,
                rr.TextDocument(
                    line_document(self._labelling, reason, self._log_faults(reason.line)),
                    media_type=rr.MediaType.MARKDOWN,
                ),
            )
            log_line(self._log, self._points, self._labelling, reason.line)
            self._log_sight(reason.line)
            self._log_structures(reason.line)
            self._log_planes(reason.line)
            self._log_door(reason.line)

    def _log_styles(self, range_m: float, height_m: float) -> None:
        for name, color in _STYLE_COLORS.items():
            self._stream.log(
                f"{entities.LINE_STRUCTURES}/{name}",
                rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(4.0), colors=color),
                static=True,
            )
            self._stream.log(
                f"{entities.PROFILE_STRUCTURES}/{name}",
                rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(3.0), colors=color, draw_order=20.0),
                static=True,
            )
        for path, color, radius_ui in (
            (entities.LINE_GROWING, entities.GROWING_COLOR, 2.5),
            (entities.LINE_PLANE, entities.CLASSES[3][1], 2.0),
            (entities.LINE_DOOR, entities.CLASSES[4][1], 3.0),
        ):
            self._stream.log(
                path,
                rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(radius_ui), colors=color, show_labels=True),
                static=True,
            )
        self._stream.log(
            entities.PROFILE_SAMPLES,
            rr.Points2D.from_fields(radii=rr.Radius.ui_points(2.0), draw_order=30.0),
            static=True,
        )
        floor_m, top_m = 0.0, height_m
        names = ["floor"] + [
            f"ceiling {c.height_m - self._labelling.floor.height_m:.2f} m" for c in self._labelling.ceilings
        ]
        heights = [floor_m] + [c.height_m - self._labelling.floor.height_m for c in self._labelling.ceilings]
        shown = [(name, height) for name, height in zip(names, heights, strict=True) if height < top_m]
        colors = [entities.CLASSES[1][1] if name == "floor" else entities.CLASSES[2][1] for name, _ in shown]
        self._stream.log(
            entities.PROFILE_LEVELS,
            rr.LineStrips2D(
                [[(0.0, -height), (range_m, -height)] for _, height in shown],
                colors=colors,
                radii=rr.Radius.ui_points(1.0),
                labels=[name for name, _ in shown],
                show_labels=True,
                draw_order=10.0,
            ),
            static=True,
        )
        ticks = np.arange(1.0, range_m, 1.0)
        self._stream.log(
            f"{entities.PROFILE_LEVELS}/ticks",
            rr.Points2D(
                np.column_stack([ticks, np.full(len(ticks), 0.25)]),
                labels=[f"{tick:g} m" for tick in ticks],
                show_labels=True,
                colors=entities.TEXT_COLOR,
                radii=0.0,
            ),
            static=True,
        )

    def _log_sight(self, line: int) -> None:
        """The rays from the lidar to the line as a sheet: of the line alone one would see a few bright pixels."""
        samples = self._labelling.lines.samples[line]
        ends = self._points[samples[samples >= 0]]
        fan = [(0, i, i + 1) for i in range(1, len(ends))]
        self._stream.log(
            entities.LINE_SIGHT,
            rr.Mesh3D(
                vertex_positions=np.vstack([self._origin, ends]).astype(np.float32),
                triangle_indices=fan,
                albedo_factor=_SIGHT_COLOR,
            )
            if fan
            else rr.Clear(recursive=False),
        )

    def _log_structures(self, line: int) -> None:
        structures, samples = self._labelling.structures, self._labelling.lines.samples[line]
        present = samples[0] >= 0
        own = np.flatnonzero(structures.line == line)
        upmost, bottommost = structures.upmost[line], structures.bottommost[line]
        roles = {
            "upmost": own[own == upmost],
            "bottommost": own[(own == bottommost) & (own != upmost)],
            "others": own[(own != bottommost) & (own != upmost)],
        }
        for name, chosen in roles.items():
            spans = [samples[structures.first[s] : structures.last[s] + 1] for s in chosen]
            self._stream.log(
                f"{entities.LINE_STRUCTURES}/{name}", rr.LineStrips3D([self._points[span] for span in spans])
            )
            self._stream.log(
                f"{entities.PROFILE_STRUCTURES}/{name}", rr.LineStrips2D([self._profile(span) for span in spans])
            )
        shown = samples if present else samples[:0]
        self._stream.log(
            entities.PROFILE_SAMPLES, rr.Points2D(self._profile(shown), class_ids=self._labelling.label[shown])
        )

    def _log_faults(self, line: int) -> str:
        """Mark what is wrong in one line's profile, and give it in words."""
        if self._faults is None:
            return ""
        lines = self._labelling.lines
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        fault = self._faults.fault[own]
        marked = own[fault > 0]
        self._stream.log(
            entities.PROFILE_FAULTS,
            rr.Points2D(
                self._profile(marked), class_ids=fault[fault > 0], radii=rr.Radius.ui_points(5.0), draw_order=25.0
            ),
        )
        kinds = [
            f"{np.count_nonzero(fault == k)} {name}"
            for k, (name, _) in entities.FAULT_CLASSES.items()
            if (fault == k).any()
        ]
        return f"**Final labels of its {len(own)} returns: {', '.join(kinds)}.**" if kinds else ""

    def _log_planes(self, line: int) -> None:
        """The plane that was growing when the line's candidate came, by its lines so far; and the one it is in."""
        planes, structures = self._labelling.planes, self._labelling.structures
        growing: list[FloatArray] = []
        growing_names: list[str] = []
        outlines: list[FloatArray] = []
        names: list[str] = []
        for c in np.flatnonzero(planes.candidate_line == line):
            before = np.flatnonzero(planes.candidate_grown[:c] >= 0)
            if not np.isnan(planes.candidate_distance_m[c]) and len(before):
                peers = before[planes.candidate_grown[before] == planes.candidate_grown[before[-1]]]
                for peer in peers:
                    own = planes.candidate_structure[peer]
                    span = self._labelling.lines.samples[
                        structures.line[own], structures.first[own] : structures.last[own] + 1
                    ]
                    growing.append(self._points[span])
                    last = peer == peers[-1]
                    growing_names.append(
                        f"the growing plane, {100 * planes.candidate_distance_m[c]:.1f} cm away" if last else ""
                    )
            plane = planes.candidate_plane[c]
            if plane >= 0:
                floor_m = np.array([self._labelling.floor.height_m])
                ends = planes.ends[[plane]]
                outlines.append(
                    upright_frames(ends, floor_m + planes.bottom_m[plane], floor_m + planes.top_m[plane])[0]
                )
                names.append(f"plane {plane}, {100 * planes.candidate_nearest_m[c]:.1f} cm away")
        self._stream.log(entities.LINE_GROWING, rr.LineStrips3D(growing, labels=growing_names))
        self._stream.log(entities.LINE_PLANE, rr.LineStrips3D(outlines, labels=names))

    def _log_door(self, line: int) -> None:
        """Where the line passes below the height at which the depression begins."""
        doors = self._labelling.door_lines
        own = np.flatnonzero((doors.line == line) & doors.behind)
        strips, marks = [], []
        for d in own:
            floor_m = self._labelling.floor.height_m
            foot = np.array([*doors.position[d], floor_m])
            strips.append(np.stack([foot, foot + np.array([0.0, 0.0, doors.start_height_m[d]])]))
            marks.append([[0.0, -doors.start_height_m[d]], [float(self._range_m.max()), -doors.start_height_m[d]]])
        self._stream.log(
            entities.LINE_DOOR,
            rr.LineStrips3D(strips, labels=[f"{100 * doors.depth_m[d]:.0f} cm deep below here" for d in own]),
        )
        self._stream.log(
            entities.PROFILE_DOOR,
            rr.LineStrips2D(
                marks,
                colors=entities.CLASSES[4][1],
                radii=rr.Radius.ui_points(1.0),
                labels=[f"what lies behind begins {doors.start_height_m[d]:.2f} m high" for d in own],
                show_labels=True,
            ),
        )

    def _profile(self, returns: IntArray) -> FloatArray:
        """(k, 2) horizontal range and height downwards, as images have it."""
        return np.column_stack([self._range_m[returns], -self._labelling.height_m[returns]]).astype(np.float32)
