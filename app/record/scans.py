"""One labelled scan with its evidence."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.final_labels import Relabelled
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.rearrangement import HorizontalPlane
from ffmap.algorithms.scan.smoothing import SmoothedRanges
from ffmap.app.record.curves import log_curves, log_line
from ffmap.app.record.line_reasons import candidate_reasons, door_reasons, line_outcomes
from ffmap.app.record.log import Log, arrays, times
from ffmap.app.record.shapes import (
    POINT_RADIUS_UI,
    SEE_THROUGH,
    rounded,
    strips_of,
    transform_columns,
    ui_radius,
    unbroken,
    upright_frames,
    upright_quads,
)
from ffmap.app.setup.outputs import Detail
from ffmap.blueprints import entities
from ffmap.blueprints.entities import CurveSheet

_LINE_STEP, _SPAN_STEP = 3, 8
"""Point lines and candidates are drawn through every n-th sample only, for a recording holds those of every scan."""


def log_scan(
    log: Log,
    index: int,
    level: LevelledScan,
    labelling: ScanLabelling,
    stamp_ns: int,
    line_pairs: int | None = None,
    intensity: FloatArray | None = None,
) -> None:
    """One labelled scan with its evidence, as much as the detail asks for.

    line_pairs: pairs of point lines that the sheet of the curves has room for; None for as many as the scan has.
    intensity: (n,) of its returns, or (0,) where other scans of the recording have some; None where none has.
    """
    placed, ranges = level.placed, level.ranges
    if not log.timeless:
        log.at(stamp_ns, index)
    for path, T in ((entities.BASE, placed.T_map_base), (entities.SCAN, placed.T_map_level)):
        log.row(path, rr.Transform3D, **transform_columns(T[None]))
    if log.detail is not Detail.MAP:
        positions = rounded(placed.points_level)
        _log_points(log, positions, ranges, labelling, intensity)
        _log_planes(log, labelling)
        _log_openings(log, labelling)
        _log_horizontal(log, positions, labelling)
        if log.detail is Detail.LINES:
            _log_lines(log, positions, labelling)
            _log_candidates(log, positions, labelling)
            _log_door_lines(log, labelling)
            log_curves(log, labelling, line_pairs)
            if not log.timeless:
                log_line(log, placed.points_level, labelling, _example_line(labelling))


METRICS = (
    *(f"{entities.MILLISECONDS}/{stage}" for stage in ("reading", "smoothing", "placing", "labelling")),
    *(f"{entities.LABEL_COUNTS}/{entities.CLASSES[label][0]}" for label in Label),
    *(f"{entities.COUNTS}/{name}" for name in ("lines", "structures", "candidates", "planes", "door_lines", "openings")),
    *(f"{entities.RANGES}/{name}" for name in ("scatter_mm", "measured_alone_percent")),
)
"""The entities of a scan's metrics."""


def scan_metrics(ranges: SmoothedRanges, labelling: ScanLabelling, timings_ms: Mapping[str, float]) -> FloatArray:
    """What one scan is in figures, as `METRICS` names them. timings_ms: milliseconds of each stage, by its name."""
    timings = [timings_ms[path.rpartition("/")[2]] for path in METRICS if path.startswith(entities.MILLISECONDS)]
    counts = np.bincount(labelling.label, minlength=len(Label))[list(Label)]
    evidence = (
        np.count_nonzero(labelling.lines.samples[:, 0] >= 0),
        len(labelling.structures.line),
        len(labelling.planes.candidate_line),
        len(labelling.planes),
        np.count_nonzero(labelling.door_lines.above_door),
        len(labelling.openings),
    )
    return np.array([*timings, *counts, *evidence, 1e3 * ranges.scatter_m, 100.0 * (1.0 - ranges.smoothed_share)])


def log_metrics(log: Log, stamp_ns: IntArray, index: IntArray, metrics: FloatArray) -> None:
    """The metrics (n, m) of some scans, see `scan_metrics`."""
    for path, values in zip(METRICS, metrics.T, strict=True):
        log.curve(path, times(stamp_ns, index), values)


def log_lidar(log: Log, place: int, topic: str) -> None:
    """Which lidar the scan that was logged last is from, where there are several. place: among those that are labelled."""
    if log.detail is Detail.MAP:
        return
    evidence = {entities.LIDAR_PLACE: np.array([place])}
    log.row(entities.SCAN_LIDAR, rr.TextDocument, evidence, text=[f"This scan is from {topic}."])


def log_frames(
    log: Log, stamp_ns: IntArray, index: IntArray, T_map_level: FloatArray, T_level_base: FloatArray
) -> None:
    """Where scans lie when all poses are final, all (n, 4, 4); before, each was logged where it was labelled."""
    for path, T in ((entities.BASE, T_map_level @ T_level_base), (entities.SCAN, T_map_level)):
        log.stream.send_columns(path, times(stamp_ns, index), rr.Transform3D.columns(**transform_columns(T)))


def log_skipped(log: Log, index: int, stamp_ns: int, reason: str) -> None:
    """A cloud that could not be used: nothing of the scan before it stays in view."""
    log.message(f"scan {index} skipped: {reason}", stamp_ns, index)
    log.now(entities.SCAN, rr.Clear(recursive=True))


def log_final(
    log: Log, index: int, stamp_ns: int, points_level: FloatArray, label_scan: UInt8Array, relabelled: Relabelled
) -> None:
    """The labels of the final stage, and why: where any differs from the scan's own, the later `class_ids` win."""
    if log.detail is Detail.MAP:
        return
    log.at(stamp_ns, index)
    label = relabelled.label
    changed = label != label_scan
    if changed.any():
        log.row(entities.POINTS, rr.Points3D, class_ids=label)
    log.row(
        entities.RELABELLED,
        rr.Points3D,
        {
            entities.POINT_LABEL_SCAN: label_scan[changed],
            entities.POINT_REASON: relabelled.reason[changed],
            entities.POINT_OFF_FACE: relabelled.off_face_m[changed].astype(np.float16),
        },
        positions=rounded(points_level[changed]),
        class_ids=label[changed],
    )


def _log_points(
    log: Log, positions: FloatArray, ranges: SmoothedRanges, labelling: ScanLabelling, intensity: FloatArray | None
) -> None:
    # Fig. 3 is the same cloud with other radii: a second one would cost a third of the file.
    horizontal = (labelling.label == Label.FLOOR) | (labelling.label == Label.CEILING)
    evidence = {
        entities.POINT_LABEL_SCAN: labelling.label,
        entities.POINT_ALONE: ranges.correction_m == 0,
        entities.POINT_RADIUS_UPRIGHT: np.where(horizontal, np.float32(0), ui_radius(POINT_RADIUS_UI)),
    }
    if intensity is not None:
        # To three digits: whole numbers up to 2048 as they are, and nothing above what half a float holds.
        evidence[entities.POINT_INTENSITY] = np.minimum(intensity, np.finfo(np.float16).max).astype(np.float16)
    log.row(entities.POINTS, rr.Points3D, evidence, positions=positions, class_ids=labelling.label)


def _log_planes(log: Log, labelling: ScanLabelling) -> None:
    planes = labelling.planes
    if not len(planes):
        log.row(entities.PLANES, rr.Clear, is_recursive=[False])
        return
    floor_m = labelling.floor.height_at(planes.ends.reshape(-1, 2)).reshape(-1, 2)
    bottom_m, top_m = floor_m + planes.bottom_m[:, None], floor_m + planes.top_m[:, None]
    vertices, triangles = upright_quads(planes.ends, bottom_m, top_m)
    colors = np.array([_plane_color(plane) for plane in range(len(planes))], np.uint8)
    log.row(
        entities.PLANES,
        rr.Mesh3D,
        arrays(planes, "normal", "offset_m", "rms_m", "line_count", "point_count"),
        vertex_positions=vertices,
        triangle_indices=triangles,
        vertex_colors=np.repeat(colors, 4, axis=0),
        albedo_factor=[SEE_THROUGH],
    )


def _log_openings(log: Log, labelling: ScanLabelling) -> None:
    openings = labelling.openings
    floor_m = np.full(len(openings), labelling.floor.height_m)
    widths_m = lengths_m(openings.ends)
    labels = [
        f"{DoorState(state).name.lower()} door, {width:.2f} m in view, {depth:.2f} m deep"
        for state, width, depth in zip(openings.state, widths_m, openings.depth_m, strict=True)
    ]
    log.row(
        entities.OPENINGS,
        rr.LineStrips3D,
        arrays(openings, "plane", "head_m", "depth_m", "state", "line_count"),
        strips=upright_frames(openings.ends, floor_m, floor_m + openings.head_m),
        labels=labels,
    )


def _log_horizontal(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    """Floor and ceilings as outlines around what was seen of them."""
    # Every 13th return: near enough for an outline, and no ring of the sensor is passed over.
    positions, label = positions[::13], labelling.label[::13]
    for path, planes, own in (
        (entities.FLOOR, (labelling.floor,), Label.FLOOR),
        (entities.CEILING, labelling.ceilings, Label.CEILING),
    ):
        outline = _outline(positions[label == own, :2])
        evidence: dict[str, npt.NDArray[Any]] = {
            "height_m": np.array([plane.height_m for plane in planes]),
            "slope": np.array([plane.slope for plane in planes]).reshape(-1, 2),
            "support": np.array([plane.support for plane in planes], np.int32),
        }
        outlines = [_lift(outline, plane) for plane in planes] if len(outline) else []
        log.row(path, rr.LineStrips3D, evidence, strips=np.array(outlines, np.float32).reshape(-1, 5, 3))


def _log_lines(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    samples = labelling.lines.samples
    present = np.flatnonzero(samples[:, 0] >= 0).astype(np.int32)
    outcome = np.array(line_outcomes(labelling), np.uint8)
    strips, owner = unbroken(positions[samples[present, ::_LINE_STEP]])
    line = present[owner]
    evidence = arrays(line=line, outcome=outcome[line])
    log.row(entities.LINES, rr.LineStrips3D, evidence, strips=strips, class_ids=outcome[line])


def _log_candidates(log: Log, positions: FloatArray, labelling: ScanLabelling) -> None:
    structures, planes = labelling.structures, labelling.planes
    # The wall candidates in the order in which Algorithm 1 met them, the bottom-most line by line.
    plane_colors = np.array([_plane_color(plane) for plane in planes.candidate_plane], np.uint32).reshape(-1, 3)
    growth = {
        "growth": planes.candidate_growth,
        "plane": planes.candidate_plane,
        "distance_m": planes.candidate_distance_m.astype(np.float32),
        entities.CANDIDATE_PLANE_COLOR: plane_colors @ np.array([1 << 24, 1 << 16, 1 << 8], np.uint32) + np.uint32(255),
    }
    for path, chosen, more, labels in (
        (entities.UPMOST, planes.candidate_structure, growth, {"labels": candidate_reasons(labelling)}),
        (entities.BOTTOMMOST, structures.bottommost[structures.bottommost >= 0], {}, {}),
    ):
        line, first, last = structures.line[chosen], structures.first[chosen], structures.last[chosen]
        strips = _spans(positions, labelling.lines.samples, line, first, last)
        log.row(path, rr.LineStrips3D, {"line": line, "first": first, "last": last, **more}, strips=strips, **labels)


def _log_door_lines(log: Log, labelling: ScanLabelling) -> None:
    doors, structures = labelling.door_lines, labelling.structures
    above = doors.above_door
    floor_m = np.full(len(doors.line), labelling.floor.height_m)
    top_m = structures.top_m[structures.upmost[doors.line]] + floor_m
    held = 1 + doors.behind.astype(np.uint8) + above
    log.row(
        entities.DOOR_CONDITIONS,
        rr.Points3D,
        arrays(doors, "line", "plane", "start_height_m", "depth_m", "state", conditions_held=held),
        positions=rounded(np.column_stack([doors.position, top_m])),
        class_ids=held,
        labels=door_reasons(labelling),
    )
    below = np.empty((np.count_nonzero(above), 2, 3), np.float32)
    below[:, :, :2] = doors.position[above, None]
    below[:, :, 2] = floor_m[above, None] + np.outer(doors.start_height_m[above], [0, 1])
    log.row(entities.DOOR_LINES, rr.LineStrips3D, strips=below)


def _plane_color(plane: int) -> entities.Color:
    return entities.PLANE_COLORS[plane % len(entities.PLANE_COLORS)] if plane >= 0 else entities.REFUSED_CANDIDATE_COLOR


def _example_line(labelling: ScanLabelling) -> int:
    """The line that tells most: of those with several structures, if any, the one that they cover best."""
    structures = labelling.structures
    covered = np.bincount(structures.line, structures.last - structures.first + 1, len(labelling.lines))
    several = structures.upmost != structures.bottommost
    return int((covered + CurveSheet.SAMPLES * several).argmax()) if len(covered) else 0


def _spans(positions: FloatArray, samples: IntArray, line: IntArray, first: IntArray, last: IntArray) -> pa.Array:
    """Line strips through every `_SPAN_STEP`-th sample of structures, their ends included."""
    counts = (last - first - 1) // _SPAN_STEP + 2
    starts = np.concatenate([[0], np.cumsum(counts)])
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
    sample = np.minimum(np.repeat(first, counts) + _SPAN_STEP * within, np.repeat(last, counts))
    return strips_of(positions[samples[np.repeat(line, counts), sample]], starts)


def _outline(points_xy: FloatArray) -> FloatArray:
    """Closed rectangle (5, 2) around points, or (0, 2) around none."""
    if not len(points_xy):
        return np.zeros((0, 2), np.float32)
    x, y = points_xy[:, 0], points_xy[:, 1]
    x0, x1, y0, y1 = x.min(), x.max(), y.min(), y.max()
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], np.float32)


def _lift(outline: FloatArray, plane: HorizontalPlane) -> FloatArray:
    return np.column_stack([outline, plane.height_at(outline)]).astype(np.float32)
