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
from ffmap.app.record.curves import log_color_scale, log_differences, log_line
from ffmap.app.record.line_reasons import candidate_reasons, door_reasons, line_outcomes
from ffmap.app.record.log import Log, evidence, times
from ffmap.app.record.shapes import (
    POINT_RADIUS_UI,
    SEE_THROUGH,
    annotations,
    rounded,
    strips,
    strips_of,
    transform,
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
_EXAMPLE_COLOR: Color = (255, 255, 255)
_REFUSED_CANDIDATE_COLOR: Color = (110, 110, 110)
_PLANE_COLORS: tuple[Color, ...] = (
    *((31, 186, 140), (214, 110, 40), (126, 118, 220), (231, 60, 148)),
    *((122, 186, 40), (240, 190, 30), (90, 170, 240), (170, 110, 70)),
)
"""Wall planes take these in turn."""
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


def log_scan_classes(log: Log, slope_max: float) -> None:
    """Log names and colours of the entities of scans. slope_max: the threshold of eq. 2."""
    for path, (name, color) in (_LABEL_COUNTS | _COUNTS).items():
        log.curve_style(path, name, color)
    if log.detail is Detail.LINES:
        log.static("/scan/lines", annotations(entities.LINE_OUTCOMES))
        log.static("/scan/doors/conditions", annotations(_DOOR_CONDITIONS))
        log_color_scale(log, slope_max)


def log_scan(
    log: Log,
    index: int,
    level: LevelledScan,
    labelling: ScanLabelling,
    stamp_ns: int,
    intensity: FloatArray | None = None,
) -> None:
    """Log one labelled scan with its evidence, as much as the detail of the log requires.

    intensity: (n,) of its returns; (0,) if only other scans of the recording have some.
    """
    placed = level.placed
    if not log.timeless:
        log.at(stamp_ns, index)
    log.now("/world/base", transform(placed.T_map_base))
    log.now("/scan", transform(placed.T_map_level))
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
        if not log.timeless:
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
        text = rr.TextDocument(f"This scan is from {topic}.")
        log.now("/scan/lidar", text, evidence(place=np.array([place])))


def log_skipped(log: Log, index: int, stamp_ns: int, reason: str) -> None:
    """Log that a cloud was skipped; the scan before it is no longer shown."""
    log.message(f"scan {index} skipped: {reason}", stamp_ns, index)
    log.now("/scan", rr.Clear(recursive=True))


def log_final(
    log: Log,
    index: int,
    stamp_ns: int,
    points_level: FloatArray,
    label_scan: UInt8Array,
    relabelled: Relabelled,
) -> None:
    """Log the final labels of a scan, and the reasons of those that differ from its own.

    At the same index the later `class_ids` of the points replace those of `log_scan`.
    """
    if log.detail is Detail.MAP:
        return
    log.at(stamp_ns, index)
    label = relabelled.label
    changed = label != label_scan
    if changed.any():
        log.now(entities.POINTS, rr.Points3D.from_fields(class_ids=label))
    of_returns = {
        entities.POINT_LABEL_SCAN: label_scan[changed],
        entities.POINT_REASON: relabelled.reason[changed],
        entities.POINT_OFF_FACE: relabelled.off_face_m[changed].astype(np.float16),
    }
    log.now(
        entities.RELABELLED,
        rr.Points3D(rounded(points_level[changed]), class_ids=label[changed], radii=ui_radius(2.5)),
        evidence(**of_returns),
    )


def _log_points(
    log: Log,
    positions: FloatArray,
    ranges: SmoothedRanges,
    labelling: ScanLabelling,
    intensity: FloatArray | None,
) -> None:
    # Fig. 3 is the same cloud with other radii: a second cloud would need a third of the file.
    horizontal = (labelling.label == Label.FLOOR) | (labelling.label == Label.CEILING)
    radius = ui_radius(POINT_RADIUS_UI)
    of_returns = {
        entities.POINT_LABEL_SCAN: labelling.label,
        "measured_alone": ranges.correction_m == 0,
        entities.POINT_RADIUS_UPRIGHT: np.where(horizontal, np.float32(0), radius),
    }
    if intensity is not None:
        # Three digits, and integers up to 2048, within the range of half precision.
        limited = np.minimum(intensity, np.finfo(np.float16).max)
        of_returns["intensity"] = limited.astype(np.float16)
    points = rr.Points3D(positions, class_ids=labelling.label, radii=radius)
    log.now(entities.POINTS, points, evidence(**of_returns))


def _log_planes(log: Log, labelling: ScanLabelling) -> None:
    planes = labelling.planes
    if not len(planes):
        log.now(entities.PLANES, rr.Clear(recursive=False))
        return
    floor_m = labelling.floor.height_at(planes.ends.reshape(-1, 2)).reshape(-1, 2)
    bottom_m, top_m = floor_m + planes.bottom_m[:, None], floor_m + planes.top_m[:, None]
    vertices, triangles = upright_quads(planes.ends, bottom_m, top_m)
    colors = np.array([_plane_color(plane) for plane in range(len(planes))], np.uint8)
    mesh = rr.Mesh3D(
        vertex_positions=vertices,
        triangle_indices=triangles,
        vertex_colors=np.repeat(colors, 4, axis=0),
        albedo_factor=(255, 255, 255, SEE_THROUGH),
    )
    of_planes = "normal", "offset_m", "rms_m", "line_count", "point_count"
    log.now(entities.PLANES, mesh, evidence(planes, *of_planes))


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
    of_openings = "plane", "head_m", "depth_m", "state", "line_count"
    drawn = strips(frames, DOOR_COLOR, 3.0, labels)
    log.now(entities.OPENINGS, drawn, evidence(openings, *of_openings))


def _log_horizontal(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    """Log floor and ceilings as rectangles around their returns."""
    positions, label = positions[::_OUTLINE_STEP], labelling.label[::_OUTLINE_STEP]
    for path, planes, own in (
        ("/scan/floor", (labelling.floor,), Label.FLOOR),
        ("/scan/ceiling", labelling.ceilings, Label.CEILING),
    ):
        seen = positions[label == own, :2]
        outlines = []
        if len(seen):
            (x0, y0), (x1, y1) = seen.min(axis=0), seen.max(axis=0)
            ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
            outlines = [np.column_stack([ring, plane.height_at(ring)]) for plane in planes]
        log.now(
            path,
            strips(outlines, CLASSES[own][1], 1.0),
            evidence(
                height_m=np.array([plane.height_m for plane in planes]),
                slope=np.array([plane.slope for plane in planes]).reshape(-1, 2),
                support=np.array([plane.support for plane in planes], np.int32),
            ),
        )


def _log_lines(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    samples = labelling.lines.samples
    present = np.flatnonzero(samples[:, 0] >= 0).astype(np.int32)
    outcomes = np.array(line_outcomes(labelling), np.uint8)
    lines, owner = unbroken(positions[samples[present, ::_LINE_STEP]])
    line = present[owner]
    outcome = outcomes[line]
    drawn = rr.LineStrips3D(lines, class_ids=outcome, radii=ui_radius(0.75))
    log.now("/scan/lines", drawn, evidence(line=line, outcome=outcome))


def log_example(log: Log, positions: FloatArray, labelling: ScanLabelling, line: int) -> None:
    """Log one line alone, in space and as a curve, at the time that is set."""
    samples = labelling.lines.samples[[line]]
    present = samples[samples[:, 0] >= 0]
    strip, _ = unbroken(rounded(positions[present]))
    log.now("/scan/lines/example", strips(strip, _EXAMPLE_COLOR, 3.0))
    log_line(log, labelling, line)


def _log_candidates(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    """Log wall candidates in the order of Algorithm 1, and the bottom-most structures."""
    structures, planes = labelling.structures, labelling.planes
    colors = np.array([_plane_color(plane) for plane in planes.candidate_plane], np.uint32)
    rgba = colors.reshape(-1, 3) @ np.array([1 << 24, 1 << 16, 1 << 8], np.uint32) + np.uint32(255)
    growth = {
        "growth": planes.candidate_growth,
        "plane": planes.candidate_plane,
        "distance_m": planes.candidate_distance_m,
        entities.CANDIDATE_PLANE_COLOR: rgba,
    }
    upmost, bottommost = planes.candidates.structure, structures.bottommost
    reasons = candidate_reasons(labelling)
    for path, chosen, more, color, labels in (
        ("/scan/candidates/upmost", upmost, growth, entities.UPMOST_COLOR, reasons),
        (
            *("/scan/candidates/bottommost", bottommost[bottommost >= 0]),
            *({}, entities.BOTTOMMOST_COLOR, None),
        ),
    ):
        line, first, last = (
            values[chosen] for values in (structures.line, structures.first, structures.last)
        )
        spans = _spans(positions, labelling.lines.samples, line, first, last)
        drawn = strips(spans, color, 2.0, labels, show_labels=False)
        log.now(path, drawn, evidence(line=line, first=first, last=last, **more))


def _log_door_lines(log: Log, labelling: ScanLabelling) -> None:
    doors, structures = labelling.door_lines, labelling.structures
    above = doors.above_door
    floor_m = np.full(len(doors.line), labelling.floor.height_m)
    top_m = structures.top_m[structures.upmost[doors.line]] + floor_m
    held = 1 + doors.behind.astype(np.uint8) + above
    points = rr.Points3D(
        rounded(np.column_stack([doors.position, top_m])),
        class_ids=held,
        labels=door_reasons(labelling),
        show_labels=False,
        radii=ui_radius(5.0),
    )
    of_lines = "line", "plane", "start_height_m", "depth_m", "state"
    log.now("/scan/doors/conditions", points, evidence(doors, *of_lines, conditions_held=held))
    below = np.empty((np.count_nonzero(above), 2, 3), np.float32)
    below[:, :, :2] = doors.position[above, None]
    below[:, :, 2] = floor_m[above, None] + np.outer(doors.start_height_m[above], [0, 1])
    log.now("/scan/doors/lines", strips(below, DOOR_COLOR, 1.5))


def _plane_color(plane: int) -> Color:
    return _PLANE_COLORS[plane % len(_PLANE_COLORS)] if plane >= 0 else _REFUSED_CANDIDATE_COLOR


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
