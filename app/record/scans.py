"""One labelled scan with its evidence."""

from collections.abc import Mapping

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.final_labels import Relabelled
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.smoothing import SmoothedRanges
from ffmap.app.record.curves import log_curve_styles, log_differences, log_line
from ffmap.app.record.line_reasons import candidate_reasons, door_reasons, line_outcomes
from ffmap.app.record.log import Log, evidence, times
from ffmap.app.record.shapes import (
    SEE_THROUGH,
    annotations,
    packed_colors,
    rounded,
    strip_style,
    strips_of,
    ui_radius,
    unbroken,
    upright_frames,
    upright_quads,
)
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from ffmap.blueprints.entities import (
    BOTTOMMOST_COLOR,
    CLASSES,
    DOOR_COLOR,
    UPMOST_COLOR,
    WALL_COLOR,
    Color,
)

_LINE_STEP, _SPAN_STEP, _OUTLINE_STEP = 3, 8, 13
"""Only every n-th sample of lines and candidates, and return of outlines, is drawn: size."""
_PLANE_COLORS = packed_colors(
    *((31, 186, 140), (214, 110, 40), (126, 118, 220), (231, 60, 148)),
    *((122, 186, 40), (240, 190, 30), (90, 170, 240), (170, 110, 70)),
)
"""Wall planes take these in turn."""
_REFUSED_COLOR = packed_colors((110, 110, 110))
_RADIUS_UPRIGHT = np.full(256, ui_radius(1.5))
"""Radius of a return by its label where floor and ceiling are hidden, as in Fig. 3."""
_RADIUS_UPRIGHT[[Label.FLOOR, Label.CEILING]] = 0.0
_DOOR_CONDITIONS: dict[int, tuple[str, Color]] = {
    1: ("1: in a wall plane", (170, 170, 170)),
    2: ("1, 2: all below is behind the plane", (255, 140, 0)),
    3: ("1, 2, 3: high enough: above a door", DOOR_COLOR),
}
"""By the number of the paper's conditions that hold, in order."""

_LABEL_COUNTS = {f"/metrics/labels/{CLASSES[label][0]}": CLASSES[label] for label in Label}
_COUNTS: dict[str, tuple[str, Color]] = {
    "/metrics/counts/lines": ("point lines", (170, 174, 182)),
    "/metrics/counts/structures": ("vertical structures", BOTTOMMOST_COLOR),
    "/metrics/counts/candidates": ("wall candidates", UPMOST_COLOR),
    "/metrics/counts/planes": ("wall planes", WALL_COLOR),
    "/metrics/counts/door_lines": ("door lines", DOOR_COLOR),
    "/metrics/counts/openings": ("openings", DOOR_COLOR),
}
METRICS = (
    *("/metrics/milliseconds/reading", "/metrics/milliseconds/smoothing"),
    *("/metrics/milliseconds/placing", "/metrics/milliseconds/labelling"),
    *_LABEL_COUNTS,
    *_COUNTS,
    *("/metrics/ranges/scatter_mm", "/metrics/ranges/measured_alone_percent"),
)
"""The entities of `scan_metrics`."""


def log_scan_styles(log: Log, slope_max: float) -> None:
    """Log the constant data of all scans: names, colours, sizes. slope_max: threshold of eq. 2."""
    for path, (name, color) in (_LABEL_COUNTS | _COUNTS).items():
        log.curve_style(path, name, color)
    if log.detail is Detail.MAP:
        return
    log.static(entities.POINTS, rr.Points3D.from_fields(radii=ui_radius(1.5)))
    log.static(entities.RELABELLED, rr.Points3D.from_fields(radii=ui_radius(2.5)))
    see_through = rr.Mesh3D.from_fields(albedo_factor=(255, 255, 255, SEE_THROUGH))
    log.static(entities.PLANES, see_through)
    log.static(entities.OPENINGS, strip_style(DOOR_COLOR, 3.0))
    log.static("/scan/floor", strip_style(CLASSES[Label.FLOOR][1], 1.0))
    log.static("/scan/ceiling", strip_style(CLASSES[Label.CEILING][1], 1.0))
    if log.detail is Detail.SCANS:
        return
    log.static("/scan/lines", annotations(entities.LINE_OUTCOMES), strip_style(None, 0.75))
    log.static("/scan/lines/example", strip_style(entities.SELECTED_COLOR, 3.0))
    for path, color in (
        ("/scan/candidates/upmost", entities.UPMOST_COLOR),
        ("/scan/candidates/bottommost", entities.BOTTOMMOST_COLOR),
    ):
        log.static(path, strip_style(color, 2.0, show_labels=False))
    points = rr.Points3D.from_fields(radii=ui_radius(5.0), show_labels=False)
    log.static("/scan/doors/conditions", annotations(_DOOR_CONDITIONS), points)
    log.static("/scan/doors/lines", strip_style(DOOR_COLOR, 1.5))
    log_curve_styles(log, slope_max)


def log_scan(
    log: Log,
    index: int | None,
    level: LevelledScan,
    labelling: ScanLabelling,
    stamp_ns: int,
    intensity: FloatArray | None = None,
) -> None:
    """Log one labelled scan with its evidence, as much as the detail of the log requires.

    index: None in a recording of this scan alone, where it is static and has no example of a line.
    intensity: (n,) of its returns; (0,) if only other scans of the recording have some.
    """
    placed = level.placed
    if index is not None:
        log.at(stamp_ns, index)
    log.pose("/world/base", placed.T_map_base)
    log.pose("/scan", placed.T_map_level)
    if log.detail is Detail.MAP:
        return
    positions = rounded(placed.points_level)
    _log_points(log, positions, level.ranges, labelling, intensity)
    _log_planes(log, labelling)
    _log_openings(log, labelling)
    _log_horizontal(log, positions, labelling)
    if log.detail is Detail.LINES:
        _log_lines(log, positions, labelling)
        _log_candidates(log, positions, labelling)
        _log_door_lines(log, labelling)
        log_differences(log, labelling)
        if index is not None:
            log_example(log, positions, labelling, _example_line(labelling))


def scan_metrics(
    ranges: SmoothedRanges, labelling: ScanLabelling, timings_ms: Mapping[str, float]
) -> FloatArray:
    """Return one value for each of `METRICS`. timings_ms: milliseconds by stage."""
    timings = [timings_ms[stage] for stage in ("reading", "smoothing", "placing", "labelling")]
    counts = np.bincount(labelling.label, minlength=len(Label))[list(Label)]
    found = (
        np.count_nonzero(labelling.lines.samples[:, 0] >= 0),
        len(labelling.structures.line),
        len(labelling.planes.candidates.line),
        len(labelling.planes),
        np.count_nonzero(labelling.door_lines.above_door),
        len(labelling.openings),
    )
    alone_percent = 100.0 * (1.0 - ranges.smoothed_share)
    return np.array([*timings, *counts, *found, 1e3 * ranges.scatter_m, alone_percent])


def log_metrics(log: Log, stamp_ns: IntArray, index: IntArray, metrics: FloatArray) -> None:
    """Log the metrics (n, m) of n scans, see `scan_metrics`."""
    for path, values in zip(METRICS, metrics.T, strict=True):
        log.curve(path, times(stamp_ns, index), values)


def log_lidar(log: Log, place: int, topic: str) -> None:
    """Log which of several lidars the last scan is from. place: index among those labelled."""
    if log.detail is not Detail.MAP:
        text = f"This scan is from {topic}."
        log.row("/scan/lidar", rr.TextDocument, {"place": np.array([place])}, text=[text])


def log_skipped(log: Log, index: int, stamp_ns: int, reason: str) -> None:
    """Log that a cloud was skipped; the scan before it is no longer shown."""
    log.at(stamp_ns, index)
    log.message(f"scan {index} skipped: {reason}")
    log.row("/scan", rr.Clear, is_recursive=[True])


def log_final(
    log: Log,
    index: int,
    stamp_ns: int,
    points_level: FloatArray,
    label_scan: UInt8Array,
    relabelled: Relabelled,
) -> None:
    """Log the final labels of a scan, and what those that differ from its own are from.

    At the same index the later `class_ids` of the points replace those of `log_scan`.
    """
    if log.detail is Detail.MAP:
        return
    log.at(stamp_ns, index)
    label = relabelled.label
    changed = label != label_scan
    if changed.any():
        log.row(entities.POINTS, rr.Points3D, class_ids=label)
    of_returns = {
        entities.POINT_LABEL_SCAN: label_scan[changed],
        entities.POINT_REASON: relabelled.kind[changed],
        entities.POINT_ODDS: relabelled.odds[changed].astype(np.float16),
        entities.POINT_WALL: relabelled.wall[changed].astype(np.int16),
    }
    positions = rounded(points_level[changed])
    log.row(
        entities.RELABELLED, rr.Points3D, of_returns, positions=positions, class_ids=label[changed]
    )


def _log_points(
    log: Log,
    positions: FloatArray,
    ranges: SmoothedRanges,
    labelling: ScanLabelling,
    intensity: FloatArray | None,
) -> None:
    # Fig. 3 is the same cloud with other radii: a second cloud would need a third of the file.
    of_returns = {
        entities.POINT_LABEL_SCAN: labelling.label,
        "measured_alone": ranges.correction_m == 0,
        entities.POINT_RADIUS_UPRIGHT: _RADIUS_UPRIGHT[labelling.label],
    }
    if intensity is not None:
        # Three digits, and integers up to 2048, within the range of half precision.
        limited = np.minimum(intensity, np.finfo(np.float16).max)
        of_returns["intensity"] = limited.astype(np.float16)
    log.row(
        entities.POINTS, rr.Points3D, of_returns, positions=positions, class_ids=labelling.label
    )


def _log_planes(log: Log, labelling: ScanLabelling) -> None:
    planes = labelling.planes
    if not len(planes):
        log.row(entities.PLANES, rr.Clear, is_recursive=[False])
        return
    floor_m = labelling.floor.height_at(planes.ends.reshape(-1, 2)).reshape(-1, 2)
    bottom_m, top_m = floor_m + planes.bottom_m[:, None], floor_m + planes.top_m[:, None]
    vertices, triangles = upright_quads(planes.ends, bottom_m, top_m)
    log.row(
        entities.PLANES,
        rr.Mesh3D,
        evidence(planes, "normal", "offset_m", "rms_m", "line_count", "point_count"),
        vertex_positions=vertices,
        triangle_indices=triangles,
        vertex_colors=_plane_colors(np.repeat(np.arange(len(planes)), 4)),
    )


def _log_openings(log: Log, labelling: ScanLabelling) -> None:
    openings = labelling.openings
    floor_m = np.full(len(openings), labelling.floor.height_m)
    labels = [
        f"{DoorState(state).name.lower()} door, {width:.2f} m in view, {depth:.2f} m deep"
        for state, width, depth in zip(
            openings.state, lengths_m(openings.ends), openings.depth_m, strict=True
        )
    ]
    frames = upright_frames(openings.ends, floor_m, floor_m + openings.head_m)
    of_openings = evidence(openings, "plane", "head_m", "depth_m", "state", "line_count")
    log.row(entities.OPENINGS, rr.LineStrips3D, of_openings, strips=frames, labels=labels)


def _log_horizontal(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    """Log floor and ceilings as rectangles around their returns."""
    positions, label = positions[::_OUTLINE_STEP], labelling.label[::_OUTLINE_STEP]
    for path, planes, own in (
        ("/scan/floor", (labelling.floor,), Label.FLOOR),
        ("/scan/ceiling", labelling.ceilings, Label.CEILING),
    ):
        x, y = positions[label == own, :2].T
        outlines = []
        if len(x):
            x0, y0, x1, y1 = x.min(), y.min(), x.max(), y.max()
            ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
            outlines = [np.column_stack([ring, plane.height_at(ring)]) for plane in planes]
        of_planes = evidence(
            height_m=np.array([plane.height_m for plane in planes]),
            slope=np.array([plane.slope for plane in planes]).reshape(-1, 2),
            support=np.array([plane.support for plane in planes], np.int32),
        )
        frames = np.array(outlines, np.float32).reshape(-1, 5, 3)
        log.row(path, rr.LineStrips3D, of_planes, strips=frames)


def _log_lines(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    samples = labelling.lines.samples
    present = np.flatnonzero(samples[:, 0] >= 0).astype(np.int32)
    lines, owner = unbroken(positions[samples[present, ::_LINE_STEP]])
    line = present[owner]
    outcome = line_outcomes(labelling)[line]
    of_strips = evidence(line=line, outcome=outcome)
    log.row("/scan/lines", rr.LineStrips3D, of_strips, strips=lines, class_ids=outcome)


def log_example(log: Log, positions: FloatArray, labelling: ScanLabelling, line: int) -> None:
    """Log one line alone, in space and as a curve, at the time that is set."""
    samples = labelling.lines.samples[[line]]
    present = samples[samples[:, 0] >= 0]
    strips, _ = unbroken(rounded(positions[present]))
    log.row("/scan/lines/example", rr.LineStrips3D, strips=strips)
    log_line(log, labelling, line)


def _log_candidates(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    """Log wall candidates in the order of Algorithm 1, and the bottom-most structures."""
    structures, planes = labelling.structures, labelling.planes
    growth = {
        "growth": planes.candidate_growth,
        "plane": planes.candidate_plane,
        "distance_m": planes.candidate_distance_m,
        entities.CANDIDATE_PLANE_COLOR: _plane_colors(planes.candidate_plane),
    }
    bottommost = structures.bottommost[structures.bottommost >= 0]
    for path, chosen, more, labels in (
        (
            *("/scan/candidates/upmost", planes.candidates.structure),
            *(growth, {"labels": candidate_reasons(labelling)}),
        ),
        ("/scan/candidates/bottommost", bottommost, {}, {}),
    ):
        line, first, last = (
            values[chosen] for values in (structures.line, structures.first, structures.last)
        )
        spans = _spans(positions, labelling.lines.samples, line, first, last)
        of_spans = evidence(line=line, first=first, last=last, **more)
        log.row(path, rr.LineStrips3D, of_spans, strips=spans, **labels)


def _log_door_lines(log: Log, labelling: ScanLabelling) -> None:
    doors, structures = labelling.door_lines, labelling.structures
    above = doors.above_door
    floor_m = np.full(len(doors.line), labelling.floor.height_m)
    top_m = structures.top_m[structures.upmost[doors.line]] + floor_m
    held = 1 + doors.behind.astype(np.uint8) + above
    names = "line", "plane", "start_height_m", "depth_m", "state"
    of_lines = evidence(doors, *names, conditions_held=held)
    log.row(
        "/scan/doors/conditions",
        rr.Points3D,
        of_lines,
        positions=rounded(np.column_stack([doors.position, top_m])),
        class_ids=held,
        labels=door_reasons(labelling),
    )
    below = np.empty((np.count_nonzero(above), 2, 3), np.float32)
    below[:, :, :2] = doors.position[above, None]
    below[:, :, 2] = floor_m[above, None] + np.outer(doors.start_height_m[above], [0, 1])
    log.row("/scan/doors/lines", rr.LineStrips3D, strips=below)


def _plane_colors(plane: IntArray) -> IntArray:
    return np.where(plane < 0, _REFUSED_COLOR, _PLANE_COLORS[plane % len(_PLANE_COLORS)])


def _example_line(labelling: ScanLabelling) -> int:
    """Return the line with several structures, if any has, that they cover best."""
    structures = labelling.structures
    lines, samples = structures.difference.shape
    covered = np.bincount(structures.line, structures.last - structures.first + 1, lines)
    several = structures.upmost != structures.bottommost
    return int((covered + samples * several).argmax()) if lines else 0


def _spans(
    positions: FloatArray, samples: IntArray, line: IntArray, first: IntArray, last: IntArray
) -> pa.Array:
    """Return line strips through every `_SPAN_STEP`-th sample of structures and their ends."""
    counts = (last - first - 1) // _SPAN_STEP + 2
    starts = np.concatenate([[0], np.cumsum(counts)])
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
    sample = np.minimum(np.repeat(first, counts) + _SPAN_STEP * within, np.repeat(last, counts))
    return strips_of(positions[samples[np.repeat(line, counts), sample]], starts)
