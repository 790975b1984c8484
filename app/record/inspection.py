"""One scan's evidence as a recording whose timeline `line` steps through its point lines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
import rerun.blueprint as rrb

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import PointLines
from ffmap.app.record.line_reasons import LineReason, line_document
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.return_reasons import ReturnReasons
from ffmap.app.record.scans import log_example, log_scan
from ffmap.app.record.shapes import (
    annotations,
    packed_colors,
    strip_style,
    strip_style_2d,
    strips_2d,
    ui_radius,
    upright_frames,
    words,
)
from ffmap.app.record.whole_run import log_static
from ffmap.blueprints import inspect as inspect_blueprint
from ffmap.blueprints.entities import (
    BOTTOMMOST_COLOR,
    CLASSES,
    DOOR_COLOR,
    FAULT_CLASSES,
    POINTS,
    SELECTED_COLOR,
    UPMOST_COLOR,
    WALL_COLOR,
    Color,
    Fault,
)

_SIGHT_COLOR = (*SELECTED_COLOR, 45)
_GROWING_COLOR: Color = (200, 140, 90)
_OTHER_COLOR: Color = (120, 140, 170)
TRUE_CLASSES = {int(own): own.name.lower().replace("_", " ") for own in Truth}
"""Name of each class of the ground truth."""
_LABELS = {int(label): name for label, (name, _) in CLASSES.items()}
_LIFT_M = 0.1
"""Distance (m) of a mark before its return, in whose plane it would be hidden."""


@dataclass(frozen=True, eq=False)
class ScanFaults:
    """Faults of the final labels. fault: (n,) of each return. by_truth: ground truth is known."""

    fault: UInt8Array
    by_truth: bool

    @property
    def kinds(self) -> tuple[Fault, ...]:
        """The faults that occur."""
        return tuple(f for f in Fault if f != Fault.NONE and (self.fault == f).any())

    def counts(self, lines: PointLines) -> IntArray:
        """(2n,) number of faults in each point line."""
        line = np.repeat(np.arange(len(lines)), np.diff(lines.starts))
        return np.bincount(line[self.fault[lines.order] > 0], minlength=len(lines))

    def worst_line(self, lines: PointLines) -> int | None:
        """Return the line with most faults; None if there are none."""
        counts = self.counts(lines)
        return int(counts.argmax()) if counts.any() else None


@dataclass(frozen=True)
class ExplainedScan:
    """One scan with its explanation.

    document: on the whole scan, in Markdown. line: the line at which the recording opens.
    notes: on the returns of each line, in Markdown. faults: of the final labels.
    final, truth: (n,) final label and true class of each return. why_changed: half a line on each
    change by the building, "" without one. All are None if unknown.
    """

    level: LevelledScan
    labelling: ScanLabelling
    reasons: Sequence[LineReason]
    document: str
    line: int | None = None
    notes: Sequence[str] | None = None
    faults: ScanFaults | None = None
    final: UInt8Array | None = None
    truth: UInt8Array | None = None
    why_changed: Sequence[str] | None = None


def write(out: Path, recording_id: str, scan: ExplainedScan) -> None:
    """Write the recording of one scan."""
    with open_log(out, recording_id, layout=layout_of(scan)) as log:
        log_explained(log, scan)


def layout_of(scan: ExplainedScan) -> rrb.Blueprint:
    """Return the layout of the recording of one scan."""
    placed, labelling = scan.level.placed, scan.labelling
    kinds = scan.faults.kinds if scan.faults is not None else ()
    middle = _middle(placed, labelling, scan.line)
    return inspect_blueprint.build(_profile_size(placed, labelling), scan.line, kinds, middle)


def log_explained(log: Log, scan: ExplainedScan) -> None:
    """Log one scan with all evidence; the timeline `line` steps through its lines."""
    labelling = scan.labelling
    log_static(log, {}, scan.document, labelling.settings.vertical_structures.slope_max)
    log_scan(log, None, scan.level, labelling, 0)
    of_returns = _of_returns(scan)
    log.static(POINTS, of_returns)
    if scan.faults is not None:
        marked = scan.faults.fault > 0
        log.static("/scan/faults", {name: own[marked] for name, own in of_returns.items()})
    lines = _Lines(log, scan)
    lines.log_styles(*_profile_size(scan.level.placed, labelling))
    for reason in scan.reasons:
        log.at_line(reason.line)
        lines.log_line(reason)
    log.text("/why/scan", scan.document)


def _of_returns(scan: ExplainedScan) -> dict[str, npt.NDArray[Any]]:
    """Return what the viewer shows of a return that is clicked, (n,) each."""
    labelling, lines = scan.labelling, scan.labelling.lines
    line = np.empty(len(labelling.label), np.int32)
    line[lines.order] = np.repeat(np.arange(len(lines)), np.diff(lines.starts))
    reasons = ReturnReasons(labelling, scan.level.placed.points_level).short()
    found = {
        "line": line,
        "why_line": np.array([reason.short for reason in scan.reasons], object)[line],
        "name_of_label_scan": _named(_LABELS, labelling.label),
        "why_label_scan": np.array(reasons, object),
    }
    if scan.final is not None:
        found["final_label"] = _named(_LABELS, scan.final)
    if scan.why_changed is not None:
        found["why_changed"] = np.array(scan.why_changed, object)
    if scan.truth is not None:
        found["true_class"] = _named(TRUE_CLASSES, scan.truth)
    return found


def _named(names: Mapping[int, str], codes: UInt8Array) -> npt.NDArray[Any]:
    table = np.array([names.get(code, "unknown") for code in range(256)], object)
    return np.asarray(table[codes])


def _profile_size(placed: PlacedScan, labelling: ScanLabelling) -> tuple[float, float]:
    """Return the horizontal range and height of the profiles, without the farthest 1 %."""
    samples = labelling.lines.samples[labelling.lines.samples[:, 0] >= 0].ravel()
    if not len(samples):
        return 4.0, 3.0
    range_m = np.linalg.norm(placed.points_level[samples, :2] - placed.origin_level[:2], axis=1)
    height_m = labelling.height_m[samples]
    return float(np.percentile(range_m, 99)) + 0.4, float(np.percentile(height_m, 99.9)) + 0.4


def _middle(
    placed: PlacedScan, labelling: ScanLabelling, line: int | None
) -> tuple[float, float, float] | None:
    """Return the point between the robot and a line, in the level frame."""
    samples = labelling.lines.samples[line] if line is not None else labelling.lines.samples[:0]
    if not (samples >= 0).any():
        return None
    x, y, z = (np.median(placed.points_level[samples], axis=0) + placed.origin_level) / 2
    return float(x), float(y), float(z)


class _Lines:
    """Logs lines in space and as profiles: height over horizontal range, y downwards."""

    def __init__(self, log: Log, scan: ExplainedScan) -> None:
        placed = scan.level.placed
        self._log, self._labelling, self._faults = log, scan.labelling, scan.faults
        self._notes = scan.notes
        self._points, self._origin = placed.points_level, placed.origin_level
        self._floor_m = scan.labelling.floor.height_m
        range_m = np.linalg.norm(placed.points_level[:, :2] - self._origin[:2], axis=1)
        profile = np.column_stack([range_m, -scan.labelling.height_m])
        self._profile = profile.astype(np.float32)
        if scan.faults is not None:
            self._mark(scan.faults)

    def log_styles(self, range_m: float, height_m: float) -> None:
        """Log colours, and floor, ceilings and scale of the profiles."""
        self._log.static("/scan/line/structures", strip_style(None, 4.0))
        self._log.static("/profile/structures", strip_style_2d(None, 3.0, 20.0))
        self._log.static("/scan/line/sight", rr.Mesh3D.from_fields(albedo_factor=_SIGHT_COLOR))
        for path, color, radius in (
            ("/scan/line/growing_plane", _GROWING_COLOR, 2.5),
            ("/scan/line/plane", WALL_COLOR, 2.0),
            ("/scan/line/door", DOOR_COLOR, 3.0),
        ):
            self._log.static(path, strip_style(color, radius, show_labels=True))
        self._log.static("/profile/door", strip_style_2d(DOOR_COLOR, 1.0, 15.0, True))
        for path, radius, order in (
            ("/profile/samples", 2.0, 30.0),
            ("/profile/faults", 5.0, 25.0),
        ):
            points = rr.Points2D.from_fields(radii=ui_radius(radius), draw_order=order)
            self._log.static(path, points)
        levels = [("floor", 0.0, CLASSES[Label.FLOOR][1])]
        for ceiling in self._labelling.ceilings:
            above_m = ceiling.height_m - self._floor_m
            levels.append((f"ceiling {above_m:.2f} m", above_m, CLASSES[Label.CEILING][1]))
        shown = [level for level in levels if level[1] < height_m]
        names, heights, colors = zip(*shown, strict=True)
        lines = [[(0.0, -height), (range_m, -height)] for height in heights]
        self._log.static("/profile/levels", strips_2d(lines, colors, 1.0, 10.0, names))
        step_m = max(1.0, float(np.ceil(range_m / 5.0)))
        ticks = np.arange(step_m, range_m, step_m)
        places = np.column_stack([ticks, np.full(len(ticks), 0.25)])
        self._log.static("/profile/levels/ticks", words(places, [f"{t:g} m" for t in ticks]))

    def _mark(self, faults: ScanFaults) -> None:
        """Log the returns with wrong final labels, before their surface."""
        marked = np.flatnonzero(faults.fault)
        rays = self._points[marked] - self._origin
        lengths = np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), _LIFT_M)
        drawn = (self._points[marked] - _LIFT_M * rays / lengths).astype(np.float32)
        for path in ("/scan/faults", "/profile/faults"):
            self._log.static(path, annotations(FAULT_CLASSES))
        points = rr.Points3D(drawn, class_ids=faults.fault[marked], radii=ui_radius(3.5))
        self._log.static("/scan/faults", points)

    def log_line(self, reason: LineReason) -> None:
        """Log one line: why it became what it is, in space, and its profile."""
        line = reason.line
        note = "" if self._notes is None else self._notes[line]
        document = line_document(self._labelling, reason, self._log_faults(line), note)
        markdown = [rr.MediaType.MARKDOWN]
        self._log.row("/why/line", rr.TextDocument, text=[document], media_type=markdown)
        log_example(self._log, self._points, self._labelling, line)
        self._log_sight(line)
        self._log_structures(line)
        self._log_planes(line)
        self._log_door(line)

    def _log_faults(self, line: int) -> str:
        """Mark the faults in a line's profile, and return them in words."""
        if self._faults is None:
            return ""
        lines = self._labelling.lines
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        fault = self._faults.fault[own]
        wrong = fault > 0
        self._log.row(
            "/profile/faults",
            rr.Points2D,
            positions=self._profile[own[wrong]],
            class_ids=fault[wrong],
        )
        counts = {name: np.count_nonzero(fault == k) for k, (name, _) in FAULT_CLASSES.items()}
        kinds = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        return f"**Final labels of its {len(own)} returns: {kinds}.**" if kinds else ""

    def _log_sight(self, line: int) -> None:
        """Log the rays to the line as a translucent fan: the line alone is a few pixels."""
        samples = self._labelling.lines.samples[line]
        ends = self._points[samples[samples >= 0]]
        path = "/scan/line/sight"
        if len(ends) < 2:
            self._log.row(path, rr.Clear, is_recursive=[False])
            return
        first = np.arange(1, len(ends), dtype=np.uint32)
        fan = np.column_stack([np.zeros_like(first), first, first + 1])
        corners = np.vstack([self._origin, ends]).astype(np.float32)
        self._log.row(path, rr.Mesh3D, vertex_positions=corners, triangle_indices=fan)

    def _log_structures(self, line: int) -> None:
        structures, samples = self._labelling.structures, self._labelling.lines.samples[line]
        own = np.flatnonzero(structures.line == line)
        other, upmost, bottommost = packed_colors(_OTHER_COLOR, UPMOST_COLOR, BOTTOMMOST_COLOR)
        colors = np.where(own == structures.bottommost[line], bottommost, other)
        colors = np.where(own == structures.upmost[line], upmost, colors)
        spans = [samples[structures.first[s] : structures.last[s] + 1] for s in own]
        in_space = [self._points[span] for span in spans]
        self._log.row("/scan/line/structures", rr.LineStrips3D, strips=in_space, colors=colors)
        profiles = [self._profile[span] for span in spans]
        self._log.row("/profile/structures", rr.LineStrips2D, strips=profiles, colors=colors)
        shown = samples[samples >= 0]
        self._log.row(
            "/profile/samples",
            rr.Points2D,
            positions=self._profile[shown],
            class_ids=self._labelling.label[shown],
        )

    def _log_planes(self, line: int) -> None:
        """Log the growing plane when the line's candidate came, and the plane that holds it."""
        planes, structures = self._labelling.planes, self._labelling.structures
        growing: list[FloatArray] = []
        growing_names: list[str] = []
        outlines: list[FloatArray] = []
        names: list[str] = []
        for c in np.flatnonzero(planes.candidates.line == line):
            before = np.flatnonzero(planes.candidate_grown[:c] >= 0)
            if not np.isnan(planes.candidate_distance_m[c]) and len(before):
                latest = planes.candidate_grown[before[-1]]
                peers = before[planes.candidate_grown[before] == latest]
                for s in planes.candidates.structure[peers]:
                    samples = self._labelling.lines.samples[structures.line[s]]
                    span = samples[structures.first[s] : structures.last[s] + 1]
                    growing.append(self._points[span])
                away = f"the growing plane, {100 * planes.candidate_distance_m[c]:.1f} cm away"
                growing_names += [""] * (len(peers) - 1) + [away]
            plane = planes.candidate_plane[c]
            if plane >= 0:
                heights = (self._floor_m + h[[plane]] for h in (planes.bottom_m, planes.top_m))
                outlines.append(upright_frames(planes.ends[[plane]], *heights)[0])
                names.append(f"plane {plane}, {100 * planes.candidate_nearest_m[c]:.1f} cm away")
        for path, drawn, labels in (
            ("/scan/line/growing_plane", growing, growing_names),
            ("/scan/line/plane", outlines, names),
        ):
            self._log.row(path, rr.LineStrips3D, strips=drawn, labels=labels)

    def _log_door(self, line: int) -> None:
        """Log where the line passes below the height at which the depression begins."""
        doors = self._labelling.door_lines
        own = np.flatnonzero((doors.line == line) & doors.behind)
        reach_m = float(self._profile[:, 0].max())
        posts, marks = [], []
        for (x, y), start_m in zip(doors.position[own], doors.start_height_m[own], strict=True):
            posts.append(np.array([[x, y, self._floor_m], [x, y, self._floor_m + start_m]]))
            marks.append(np.array([[0.0, -start_m], [reach_m, -start_m]]))
        depths = [f"{100 * depth_m:.0f} cm deep below here" for depth_m in doors.depth_m[own]]
        self._log.row("/scan/line/door", rr.LineStrips3D, strips=posts, labels=depths)
        starts = [f"depression below {start_m:.2f} m" for start_m in doors.start_height_m[own]]
        self._log.row("/profile/door", rr.LineStrips2D, strips=marks, labels=starts)
