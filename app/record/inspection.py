"""One scan's evidence as a recording whose timeline `line` steps through its point lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.app.record.curves import log_line
from ffmap.app.record.line_reasons import LineReason, line_document
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import log_scan
from ffmap.app.record.shapes import annotations, markdown, strips_2d, ui_radius, upright_frames, words
from ffmap.app.record.whole_run import log_static
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


@dataclass(frozen=True)
class ExplainedScan:
    """One scan with all that is to be told of it.

    faults: what is marked; None where nothing is known to be wrong. document: on the whole scan, in Markdown. line: the one
    that the recording opens at.
    """

    level: LevelledScan
    labelling: ScanLabelling
    reasons: Sequence[LineReason]
    faults: ScanFaults | None
    document: str
    line: int | None


def write(out: Path, recording_id: str, scan: ExplainedScan) -> None:
    """Write the recording of one scan."""
    placed, labelling = scan.level.placed, scan.labelling
    size_m = _profile_size(placed, labelling)
    kinds = scan.faults.kinds if scan.faults is not None else ()
    middle = _middle(placed, labelling, scan.line)
    with open_log(out, recording_id, layout=inspect_blueprint.build(size_m, scan.line, kinds, middle)) as log:
        log_static(log, {}, scan.document, 0, labelling.settings.vertical_structures.slope_max)
        throughout = Log(log.stream, timeless=True)
        log_scan(throughout, 0, scan.level, labelling, 0)
        throughout.write_rows()
        _Lines(log, scan, *size_m).log()


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

    def __init__(self, log: Log, scan: ExplainedScan, range_m: float, height_m: float) -> None:
        placed = scan.level.placed
        self._log, self._scan, self._labelling = log, scan, scan.labelling
        self._points, self._origin = placed.points_level, placed.origin_level
        self._floor_m = scan.labelling.floor.height_m
        self._range_m = np.linalg.norm(placed.points_level[:, :2] - placed.origin_level[:2], axis=1)
        self._log_styles()
        self._log_sheet(range_m, height_m)
        if scan.faults is not None:
            self._mark(scan.faults)

    def log(self) -> None:
        self._log.text(entities.WHY_SCAN, self._scan.document)
        for reason in self._scan.reasons:
            self._log.at_line(reason.line)
            document = line_document(self._labelling, reason, self._log_faults(reason.line))
            self._log.now(entities.WHY_LINE, markdown(document))
            log_line(self._log, self._points, self._labelling, reason.line)
            self._log_sight(reason.line)
            self._log_structures(reason.line)
            self._log_planes(reason.line)
            self._log_door(reason.line)

    def _log_styles(self) -> None:
        for name, color in _STYLE_COLORS.items():
            in_space = rr.LineStrips3D.from_fields(radii=ui_radius(4.0), colors=color)
            self._log.static(f"{entities.LINE_STRUCTURES}/{name}", in_space)
            in_profile = rr.LineStrips2D.from_fields(radii=ui_radius(3.0), colors=color, draw_order=20.0)
            self._log.static(f"{entities.PROFILE_STRUCTURES}/{name}", in_profile)
        for path, color, radius_ui in (
            (entities.LINE_GROWING, entities.GROWING_COLOR, 2.5),
            (entities.LINE_PLANE, entities.CLASSES[Label.WALL][1], 2.0),
            (entities.LINE_DOOR, entities.CLASSES[Label.DOOR][1], 3.0),
        ):
            style = rr.LineStrips3D.from_fields(radii=ui_radius(radius_ui), colors=color, show_labels=True)
            self._log.static(path, style)
        self._log.static(entities.PROFILE_SAMPLES, rr.Points2D.from_fields(radii=ui_radius(2.0), draw_order=30.0))

    def _log_sheet(self, range_m: float, height_m: float) -> None:
        """Floor and ceilings in the profiles, and their scale."""
        levels = [("floor", 0.0, entities.CLASSES[Label.FLOOR][1])]
        for ceiling in self._labelling.ceilings:
            above_m = ceiling.height_m - self._floor_m
            levels.append((f"ceiling {above_m:.2f} m", above_m, entities.CLASSES[Label.CEILING][1]))
        names, heights, colors = zip(*(level for level in levels if level[1] < height_m), strict=True)
        lines = [[(0.0, -height), (range_m, -height)] for height in heights]
        self._log.static(entities.PROFILE_LEVELS, strips_2d(lines, colors, 1.0, 10.0, names))
        ticks = np.arange(1.0, range_m, 1.0)
        places = np.column_stack([ticks, np.full(len(ticks), 0.25)])
        self._log.static(f"{entities.PROFILE_LEVELS}/ticks", words(places, [f"{tick:g} m" for tick in ticks]))

    def _mark(self, faults: ScanFaults) -> None:
        """Let the returns stand out whose final labels are wrong."""
        marked = np.flatnonzero(faults.fault)
        rays = self._points[marked] - self._origin
        drawn = self._points[marked] - _LIFT_M * rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), _LIFT_M)
        for path in (entities.FAULTS, entities.PROFILE_FAULTS):
            self._log.static(path, annotations(entities.FAULT_CLASSES))
        points = rr.Points3D(drawn.astype(np.float32), class_ids=faults.fault[marked], radii=ui_radius(3.5))
        self._log.static(entities.FAULTS, points)

    def _log_sight(self, line: int) -> None:
        """The rays from the lidar to the line as a sheet: of the line alone one would see a few bright pixels."""
        samples = self._labelling.lines.samples[line]
        ends = self._points[samples[samples >= 0]]
        fan = [(0, i, i + 1) for i in range(1, len(ends))]
        corners = np.vstack([self._origin, ends]).astype(np.float32)
        sheet = rr.Mesh3D(vertex_positions=corners, triangle_indices=fan, albedo_factor=_SIGHT_COLOR)
        self._log.now(entities.LINE_SIGHT, sheet if fan else rr.Clear(recursive=False))

    def _log_structures(self, line: int) -> None:
        structures, samples = self._labelling.structures, self._labelling.lines.samples[line]
        own = np.flatnonzero(structures.line == line)
        upmost, bottommost = structures.upmost[line], structures.bottommost[line]
        roles = {
            "upmost": own[own == upmost],
            "bottommost": own[(own == bottommost) & (own != upmost)],
            "others": own[(own != bottommost) & (own != upmost)],
        }
        for name, chosen in roles.items():
            spans = [samples[structures.first[s] : structures.last[s] + 1] for s in chosen]
            in_space, in_profile = [self._points[span] for span in spans], [self._profile(span) for span in spans]
            self._log.now(f"{entities.LINE_STRUCTURES}/{name}", rr.LineStrips3D(in_space))
            self._log.now(f"{entities.PROFILE_STRUCTURES}/{name}", rr.LineStrips2D(in_profile))
        shown = samples[samples >= 0]
        points = rr.Points2D(self._profile(shown), class_ids=self._labelling.label[shown])
        self._log.now(entities.PROFILE_SAMPLES, points)

    def _log_faults(self, line: int) -> str:
        """Mark what is wrong in one line's profile, and give it in words."""
        if self._scan.faults is None:
            return ""
        lines = self._labelling.lines
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        fault = self._scan.faults.fault[own]
        wrong = fault > 0
        points = rr.Points2D(self._profile(own[wrong]), class_ids=fault[wrong], radii=ui_radius(5.0), draw_order=25.0)
        self._log.now(entities.PROFILE_FAULTS, points)
        counts = {name: np.count_nonzero(fault == kind) for kind, (name, _) in entities.FAULT_CLASSES.items()}
        kinds = [f"{count} {name}" for name, count in counts.items() if count]
        return f"**Final labels of its {len(own)} returns: {', '.join(kinds)}.**" if kinds else ""

    def _log_planes(self, line: int) -> None:
        """The plane that was growing when the line's candidate came, by its lines until then; and the one it is in."""
        planes, structures = self._labelling.planes, self._labelling.structures
        growing: list[FloatArray] = []
        growing_names: list[str] = []
        outlines: list[FloatArray] = []
        names: list[str] = []
        for c in np.flatnonzero(planes.candidate_line == line):
            before = np.flatnonzero(planes.candidate_grown[:c] >= 0)
            if not np.isnan(planes.candidate_distance_m[c]) and len(before):
                peers = before[planes.candidate_grown[before] == planes.candidate_grown[before[-1]]]
                for s in planes.candidate_structure[peers]:
                    span = slice(structures.first[s], structures.last[s] + 1)
                    growing.append(self._points[self._labelling.lines.samples[structures.line[s], span]])
                away = f"the growing plane, {100 * planes.candidate_distance_m[c]:.1f} cm away"
                growing_names += [""] * (len(peers) - 1) + [away]
            plane = planes.candidate_plane[c]
            if plane >= 0:
                heights = (self._floor_m + h[[plane]] for h in (planes.bottom_m, planes.top_m))
                outlines.append(upright_frames(planes.ends[[plane]], *heights)[0])
                names.append(f"plane {plane}, {100 * planes.candidate_nearest_m[c]:.1f} cm away")
        self._log.now(entities.LINE_GROWING, rr.LineStrips3D(growing, labels=growing_names))
        self._log.now(entities.LINE_PLANE, rr.LineStrips3D(outlines, labels=names))

    def _log_door(self, line: int) -> None:
        """Where the line passes below the height at which the depression begins."""
        doors = self._labelling.door_lines
        own = np.flatnonzero((doors.line == line) & doors.behind)
        posts, marks, reach_m = [], [], float(self._range_m.max())
        for d in own:
            start_m = doors.start_height_m[d]
            posts.append([[*doors.position[d], self._floor_m], [*doors.position[d], self._floor_m + start_m]])
            marks.append([[0.0, -start_m], [reach_m, -start_m]])
        labels = [f"{100 * doors.depth_m[d]:.0f} cm deep below here" for d in own]
        self._log.now(entities.LINE_DOOR, rr.LineStrips3D(posts, labels=labels))
        labels = [f"what lies behind begins {doors.start_height_m[d]:.2f} m high" for d in own]
        color = entities.CLASSES[Label.DOOR][1]
        self._log.now(entities.PROFILE_DOOR, strips_2d(marks, color, 1.0, labels=labels))

    def _profile(self, returns: IntArray) -> FloatArray:
        """(k, 2) horizontal range and height downwards, as images have it."""
        return np.column_stack([self._range_m[returns], -self._labelling.height_m[returns]]).astype(np.float32)
