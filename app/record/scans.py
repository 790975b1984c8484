"""What a run records: from the evidence of each step to Rerun entities. What else is logged, the other `*_recorder` log."""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.building.face_alignment import AlignedFaces
from ffmap.algorithms.building.face_foreground import covered_places
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.levels import HeightMap
from ffmap.algorithms.building.model import CELL_M
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.poses.odometry import Registration
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.rearrangement import HorizontalPlane
from ffmap.algorithms.scan.smoothing import SmoothedRanges
from ffmap.app.record.building_reasons import explain_building
from ffmap.app.record.line_reasons import candidate_reasons, door_reasons, line_outcomes
from ffmap.app.record.stream import send_properties
from ffmap.app.record.wall_panels import wall_panels
from ffmap.blueprints import entities
from ffmap.blueprints.entities import CurveSheet, Legend

GRID_M = 1.0 / 512.0
"""Positions are rounded to so many metres, a sensor's resolution: the file halves."""
JUMP_M = 0.4
"""No stroke is drawn between neighbours in a line that are farther apart."""
POINT_RADIUS_UI = 1.5
_SEE_THROUGH = (255, 255, 255, 90)
"""Factor of a mesh's colours behind which points and lines can be seen."""
MAP_RADIUS_UI = 1.25
FLOAT16_MAX = 65504.0

_POINT_STYLES: tuple[tuple[str, float, entities.Color | None], ...] = (
    (entities.POINTS, POINT_RADIUS_UI, None),
    (entities.RELABELLED, 2.5, None),
    (entities.DOOR_CONDITIONS, 5.0, None),
    (entities.KEYPOINTS, 2.0, entities.KEYPOINT_COLOR),
    (entities.LOCAL_MAP, 1.0, entities.LOCAL_MAP_COLOR),
    (entities.WEAK_REGISTRATION, 6.0, entities.WEAK_COLOR),
    (entities.SUBMAPS, 4.0, entities.LOOP_COLOR),
)
_LINE_STYLES: tuple[tuple[str, float, entities.Color | None], ...] = (
    (entities.TRAJECTORY, 2.0, entities.TRAJECTORY_COLOR),
    (entities.LOOPS, 0.75, None),
    (entities.WAY_OF_ODOMETRY, 1.5, entities.WAY_OF_ODOMETRY_COLOR),
    (entities.FLOOR, 1.0, entities.CLASSES[Label.FLOOR][1]),
    (entities.CEILING, 1.0, entities.CLASSES[Label.CEILING][1]),
    (entities.LINES, 0.75, None),
    (entities.EXAMPLE_LINE, 3.0, entities.EXAMPLE_COLOR),
    (entities.UPMOST, 2.0, entities.UPMOST_COLOR),
    (entities.BOTTOMMOST, 2.0, entities.BOTTOMMOST_COLOR),
    (entities.DOOR_LINES, 1.5, entities.CLASSES[Label.DOOR][1]),
    (entities.OPENINGS, 3.0, entities.CLASSES[Label.DOOR][1]),
)
_CURVE_STYLES: tuple[tuple[str, float, entities.Color], ...] = (
    (entities.CURVE_DIFFERENCES, 0.5, entities.CURVE_COLOR),
    (entities.CURVE_UPMOST, 1.5, entities.UPMOST_COLOR),
    (entities.CURVE_BOTTOMMOST, 1.5, entities.BOTTOMMOST_COLOR),
    (entities.CURVE_EXAMPLE, 1.0, entities.CURVE_COLOR),
    (entities.CURVE_EXAMPLE_SLOPE, 1.0, entities.EXAMPLE_COLOR),
)
_SPAN_STEP = 5
"""Candidates are drawn through every so manieth sample: a recording holds those of every scan."""

rr.set_strict_mode(True)


class Detail(StrEnum):
    """How much is logged of each scan."""

    LINES = "lines"
    """Every intermediate."""
    SCANS = "scans"
    """The labelled cloud, planes and doors; no lines and curves."""
    MAP = "map"
    """Poses, metrics and the map; nothing of the single scan."""


class Recorder:
    """Logs results and evidence into one stream.

    Workers log scans into blocks; the run's own process forwards these blocks and logs all else.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        detail: Detail = Detail.LINES,
        timeless: bool = False,
        scan_stamps_ns: IntArray | None = None,
    ) -> None:
        """timeless: what is logged of a scan holds throughout, as in a recording of one scan alone.

        scan_stamps_ns: (n,) of the vertical clouds in the bag. With them, what concerns a horizontal scan also lies on the
        timeline `scan`, at the first vertical cloud that is not older, or at the last one: there the viewer shows the same
        as at that cloud's stamp. None where there are no vertical clouds: it lies on `stamp` alone.
        """
        self._stream = stream
        self._detail = detail
        self._timeless = timeless
        # The highest stamp up to each cloud, for a clock may step back.
        self._scan_reached_ns: IntArray | None = None
        if scan_stamps_ns is not None and len(scan_stamps_ns):
            self._scan_reached_ns = np.maximum.accumulate(scan_stamps_ns)
        self._metrics: list[tuple[int, int, dict[str, float]]] = []

    # --- once a run ---

    def log_static(
        self,
        sensors: Mapping[str, FloatArray],
        readme: str,
        ring_count: int | None = None,
        slope_max: float | None = None,
    ) -> None:
        """What holds throughout: classes, styles, frames, sensors, the sheet of the curves, the explanation.

        sensors: T_base_sensor (4, 4) by role. ring_count, slope_max: emitters of the vertical lidar and the threshold
        of eq. 2; None where nothing is labelled. With 0 emitters the sheet of the curves has the large one alone.
        """
        self._static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, _annotations(entities.CLASSES))
        self._static(entities.LINES, _annotations(entities.LINE_OUTCOMES))
        self._static(entities.DOOR_CONDITIONS, _annotations(entities.DOOR_CONDITION_CLASSES))
        self._static(entities.README, rr.TextDocument(readme, media_type=rr.MediaType.MARKDOWN))
        glance = entities.glance(labelled=ring_count is not None, scans=self._detail is not Detail.MAP)
        self._static(entities.GLANCE, rr.TextDocument(glance, media_type=rr.MediaType.MARKDOWN))
        self._static(
            entities.EVALUATION_HELP, rr.TextDocument(entities.EVALUATION_HELP_TEXT, media_type=rr.MediaType.MARKDOWN)
        )
        log_legend(self._stream, entities.LABEL_LEGEND, entities.LABEL_LEGEND_ENTRIES)
        self._static(entities.BASE, rr.TransformAxes3D(0.6))
        for role, T_base_sensor in sensors.items():
            self._static(f"{entities.BASE}/{role}", _transform(T_base_sensor), rr.TransformAxes3D(0.3))
        for path, radius_ui, color in _POINT_STYLES:
            self._static(path, rr.Points3D.from_fields(radii=rr.Radius.ui_points(radius_ui), colors=color))
        for path, radius_ui, color in _LINE_STYLES:
            self._static(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(radius_ui), colors=color))
        # Their labels are whole sentences: they show where the pointer rests.
        self._static(entities.UPMOST, rr.LineStrips3D.from_fields(show_labels=False))
        self._static(entities.DOOR_CONDITIONS, rr.Points3D.from_fields(show_labels=False))
        for label in Label:
            name, color = entities.CLASSES[label]
            self._static(f"{entities.LABEL_COUNTS}/{name}", rr.SeriesLines(colors=color, names=name, widths=1.5))
        for path, (name, color) in entities.SERIES.items():
            self._static(path, rr.SeriesLines(colors=color, names=name, widths=1.5))
        if ring_count is not None and slope_max is not None and self._detail is Detail.LINES:
            self._log_curve_sheet(CurveSheet(ring_count), slope_max)

    def log_properties(self, name: str, values: Mapping[str, Any]) -> None:
        """Of the whole run, see `send_properties`."""
        send_properties(self._stream, name, values)

    def log_message(self, text: str, stamp_ns: int, index: int | None = None) -> None:
        """A warning, at the scan or time that it is about."""
        self._at(stamp_ns, index)
        self._log(entities.MESSAGES, rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def log_warnings(self, warnings: Sequence[str]) -> None:
        """Those of the whole run; that there are none is worth telling too."""
        text = "\n".join(f"- {warning}" for warning in warnings) or "None."
        self._static(entities.WARNINGS, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))

    # --- trajectory and odometry ---

    def log_trajectory(
        self,
        stamp_ns: IntArray,
        T_map_base: FloatArray,
        index: IntArray | None,
        previous_T_map_base: FloatArray | None = None,
    ) -> None:
        """The way from each pose to the next; `previous_T_map_base` carries on an earlier call.

        stamp_ns: (n,); T_map_base: (n, 4, 4); index: (n,) of the vertical scans, None where the poses are of horizontal
        ones, which lie on `stamp` alone.
        """
        xyz = T_map_base[:, :3, 3]
        before = xyz[:1] if previous_T_map_base is None else previous_T_map_base[None, :3, 3]
        steps = np.stack([np.concatenate([before, xyz[:-1]]), xyz], axis=1).astype(np.float32)
        indexes = [rr.TimeColumn(entities.STAMP_TIMELINE, timestamp=stamp_ns.astype("datetime64[ns]"))]
        if index is not None:
            indexes.append(rr.TimeColumn(entities.SCAN_TIMELINE, sequence=index))
        self._stream.send_columns(entities.TRAJECTORY, indexes, rr.LineStrips3D.columns(strips=steps))

    def log_odometry_frame(self, stamp_ns: IntArray, T_map_odom: FloatArray) -> None:
        """Where the odometry's frame lies in the levelled map; it moves as the loops that were closed correct its drift.

        stamp_ns: (n,); T_map_odom: (n, 4, 4).
        """
        self._transforms(entities.ODOMETRY, stamp_ns, T_map_odom)

    def log_pose_graph(self, graph: PoseGraph, T_map_odom: FloatArray, stamp_ns: IntArray, moved_m: FloatArray) -> None:
        """The submaps, the loops between them, the way as the odometry had it, and how far each pose was moved.

        T_map_odom: (4, 4) before any loop. stamp_ns, moved_m: (n,) of all scans.
        """
        T_before = transforms.invert(graph.T_correction) @ graph.T_odom_sensor
        at, before = (
            transforms.apply(T_map_odom, T[:, :3, 3]).astype(np.float32) for T in (graph.T_odom_sensor, T_before)
        )
        loops = np.flatnonzero(graph.is_loop & (graph.weight > 0))
        strips = np.stack([at[graph.first[loops]], at[graph.second[loops]]], axis=1)
        colors = [entities.LOOP_COLOR if graph.weight[e] >= 0.5 else entities.LOOP_DOUBTED_COLOR for e in loops]
        labels = [
            f"{graph.inlier_share[e]:.0%} fits, {graph.offset[e]:.1f} standard deviations off, weight {graph.weight[e]:.2f}"
            for e in loops
        ]
        self._static(entities.SUBMAPS, rr.Points3D(at))
        self._static(entities.LOOPS, rr.LineStrips3D(strips, colors=colors, labels=labels, show_labels=False))
        self._static(entities.WAY_OF_ODOMETRY, rr.LineStrips3D([before] if len(before) > 1 else []))
        self._columns(f"{entities.REGISTRATION}/loops_moved_m", stamp_ns, rr.Scalars.columns(scalars=moved_m))

    def log_registrations(self, registrations: Sequence[Registration], weak: Sequence[str | None]) -> None:
        """What was registered of horizontal scans, and how well it fits.

        Many at once: logged one by one they cost the run's own process more than all else that it logs.

        weak: for each in words why it is not to be relied on, or None.
        """
        if not registrations:
            return
        stamp_ns = np.array([r.stamp_ns for r in registrations])
        self._transforms(entities.ODOMETRY_SENSOR, stamp_ns, np.array([r.T_odom_sensor for r in registrations]))
        if self._detail is not Detail.MAP:
            self._cloud_columns(entities.KEYPOINTS, stamp_ns, [r.keypoints_sensor for r in registrations])
            mapped = np.array([len(r.local_map_odom) > 0 for r in registrations])
            self._cloud_columns(
                entities.LOCAL_MAP, stamp_ns[mapped], [r.local_map_odom for r in registrations if len(r.local_map_odom)]
            )
        alarms = [(r, why) for r, why in zip(registrations, weak, strict=True) if why is not None]
        if alarms:
            self._columns(
                entities.WEAK_REGISTRATION,
                np.array([r.stamp_ns for r, _ in alarms]),
                rr.Points3D.columns(positions=np.array([r.T_odom_sensor[:3, 3] for r, _ in alarms], np.float32)),
            )
            self._columns(
                entities.MESSAGES,
                np.array([r.stamp_ns for r, _ in alarms]),
                rr.TextLog.columns(
                    text=[f"registration {r.index} is weak: {why}" for r, why in alarms],
                    level=[rr.TextLogLevel.WARN] * len(alarms),
                ),
            )
        quality = {
            "threshold_m": [r.threshold_m for r in registrations],
            "correction_m": [r.correction_m for r in registrations],
            "residual_m": [r.residual_m for r in registrations],
            "inlier_share": [r.inlier_share for r in registrations],
            "refined_m": [r.refined_m for r in registrations],
            "refined_inlier_share": [r.refined_inlier_share for r in registrations],
            "weakest_share": [r.weakest_share for r in registrations],
            "keypoint_count": [len(r.keypoints_sensor) for r in registrations],
            "milliseconds": [r.milliseconds for r in registrations],
        }
        quality["weak"] = [float(why is not None) for why in weak]
        for name, values in quality.items():
            scalars = np.array(values, np.float64)
            known = np.isfinite(scalars)
            self._columns(
                f"{entities.REGISTRATION}/{name}", stamp_ns[known], rr.Scalars.columns(scalars=scalars[known])
            )

    # --- scans ---

    def log_scan(
        self,
        index: int,
        level: LevelledScan,
        labelling: ScanLabelling,
        stamp_ns: int,
        timings_ms: Mapping[str, float],
    ) -> None:
        """One labelled scan with its evidence, as much as the detail asks for."""
        placed, ranges = level.placed, level.ranges
        if not self._timeless:
            self._at(stamp_ns, index)
        self._log(entities.BASE, _transform(placed.T_map_base))
        self._log(entities.SCAN, _transform(placed.T_map_level))
        if self._detail is not Detail.MAP:
            positions = _round(placed.points_level)
            self._log_points(positions, ranges, labelling)
            self._log_planes(labelling)
            self._log_openings(labelling)
            self._log_horizontal(positions, labelling)
            if self._detail is Detail.LINES:
                self._log_lines(positions, labelling)
                self._log_candidates(positions, labelling)
                self._log_door_lines(labelling)
                self._log_curves(labelling)
                if not self._timeless:
                    self.log_line(placed.points_level, labelling, _example_line(labelling))
        self._metrics.append((index, stamp_ns, _scan_metrics(ranges, labelling, timings_ms)))

    def log_scan_metrics(self) -> None:
        """The metrics of all scans logged so far, at once: one by one they cost as much as the cloud."""
        if not self._metrics:
            return
        index, stamp_ns, rows = zip(*self._metrics, strict=True)
        for path in rows[0]:
            self._stream.send_columns(
                path,
                indexes=scan_columns(index, stamp_ns),
                columns=rr.Scalars.columns(scalars=[row[path] for row in rows]),
            )
        self._metrics.clear()

    def log_skipped(self, index: int, stamp_ns: int, reason: str) -> None:
        """A cloud that could not be used: nothing of the scan before it stays in view."""
        self.log_message(f"scan {index} skipped: {reason}", stamp_ns, index)
        self._log(entities.SCAN, rr.Clear(recursive=True))

    def log_final(
        self, index: int, stamp_ns: int, placed: PlacedScan, label_scan: UInt8Array, label: UInt8Array
    ) -> None:
        """The labels of the final stage: where any differs from the scan's own, the later `class_ids` win."""
        if self._detail is Detail.MAP:
            return
        self._at(stamp_ns, index)
        changed = label != label_scan
        if changed.any():
            self._log(entities.POINTS, rr.Points3D.from_fields(class_ids=label))
        self._log(
            entities.RELABELLED,
            rr.Points3D(_round(placed.points_level[changed]), class_ids=label[changed]),
            evidence({entities.POINT_LABEL_SCAN: label_scan[changed]}),
        )

    def _log_points(self, positions: FloatArray, ranges: SmoothedRanges, labelling: ScanLabelling) -> None:
        # Fig. 3 is the same cloud with other radii: a second one would cost a third of the file.
        horizontal = (labelling.label == Label.FLOOR) | (labelling.label == Label.CEILING)
        self._log(
            entities.POINTS,
            rr.Points3D(positions, class_ids=labelling.label),
            evidence(
                {
                    entities.POINT_LABEL_SCAN: labelling.label,
                    entities.POINT_CORRECTION: np.clip(np.rint(1e3 * ranges.correction_m), -127, 127).astype(np.int8),
                    entities.POINT_RADIUS_UPRIGHT: np.where(horizontal, np.float32(0), _ui_radius(POINT_RADIUS_UI)),
                }
            ),
        )

    def _log_planes(self, labelling: ScanLabelling) -> None:
        planes = labelling.planes
        if not len(planes):
            self._log(entities.PLANES, rr.Clear(recursive=False))
            return
        floor_m = labelling.floor.height_at(planes.ends.reshape(-1, 2)).reshape(-1, 2)
        vertices, triangles = _upright_quads(
            planes.ends, floor_m + planes.bottom_m[:, None], floor_m + planes.top_m[:, None]
        )
        colors = np.array([_plane_color(plane) for plane in range(len(planes))], np.uint8)
        self._log(
            entities.PLANES,
            rr.Mesh3D(
                vertex_positions=vertices,
                triangle_indices=triangles,
                vertex_colors=np.repeat(colors, 4, axis=0),
                albedo_factor=_SEE_THROUGH,
            ),
            evidence(
                {
                    "normal": planes.normal,
                    "offset_m": planes.offset_m,
                    "rms_m": planes.rms_m,
                    "line_count": planes.line_count,
                    "point_count": planes.point_count,
                }
            ),
        )

    def _log_openings(self, labelling: ScanLabelling) -> None:
        openings = labelling.openings
        floor_m = np.full(len(openings), labelling.floor.height_m)
        widths_m = lengths_m(openings.ends)
        labels = [
            f"{DoorState(state).name.lower()} door, {width:.2f} m in view, {depth:.2f} m deep"
            for state, width, depth in zip(openings.state, widths_m, openings.depth_m, strict=True)
        ]
        self._log(
            entities.OPENINGS,
            rr.LineStrips3D(upright_frames(openings.ends, floor_m, floor_m + openings.head_m), labels=labels),
            evidence(
                {
                    "plane": openings.plane,
                    "head_m": openings.head_m,
                    "depth_m": openings.depth_m,
                    "state": openings.state,
                    "line_count": openings.line_count,
                }
            ),
        )

    def _log_horizontal(self, positions: FloatArray, labelling: ScanLabelling) -> None:
        """Floor and ceilings as outlines around what was seen of them."""
        # Every 13th return: near enough for an outline, and no ring of the sensor is passed over.
        positions, label = positions[::13], labelling.label[::13]
        for path, planes, own in (
            (entities.FLOOR, (labelling.floor,), Label.FLOOR),
            (entities.CEILING, labelling.ceilings, Label.CEILING),
        ):
            outline = _outline(positions[label == own, :2])
            self._log(
                path,
                rr.LineStrips3D([_lift(outline, plane) for plane in planes] if len(outline) else []),
                evidence(
                    {
                        "height_m": np.array([plane.height_m for plane in planes]),
                        "slope": np.array([plane.slope for plane in planes]).reshape(-1, 2),
                        "support": np.array([plane.support for plane in planes], np.int32),
                    }
                ),
            )

    def _log_lines(self, positions: FloatArray, labelling: ScanLabelling) -> None:
        samples = labelling.lines.samples
        present = np.flatnonzero(samples[:, 0] >= 0).astype(np.int32)
        outcome = np.array(line_outcomes(labelling), np.uint8)
        strips, owner = _unbroken(positions[samples[present]])
        line = present[owner]
        self._log(
            entities.LINES,
            rr.LineStrips3D(strips, class_ids=outcome[line]),
            evidence({"line": line, "outcome": outcome[line]}),
        )

    def _log_candidates(self, positions: FloatArray, labelling: ScanLabelling) -> None:
        structures, planes = labelling.structures, labelling.planes
        # The wall candidates in the order in which Algorithm 1 met them, the bottom-most line by line.
        plane_colors = np.array([_plane_color(plane) for plane in planes.candidate_plane], np.uint32).reshape(-1, 3)
        growth = {
            "growth": planes.candidate_growth,
            "plane": planes.candidate_plane,
            "distance_m": planes.candidate_distance_m.astype(np.float32),
            entities.CANDIDATE_PLANE_COLOR: plane_colors @ np.array([1 << 24, 1 << 16, 1 << 8], np.uint32)
            + np.uint32(255),
        }
        for path, chosen, more, reasons in (
            (entities.UPMOST, planes.candidate_structure, growth, candidate_reasons(labelling)),
            (entities.BOTTOMMOST, structures.bottommost[structures.bottommost >= 0], {}, None),
        ):
            line, first, last = structures.line[chosen], structures.first[chosen], structures.last[chosen]
            self._log(
                path,
                rr.LineStrips3D(_spans(positions, labelling.lines.samples, line, first, last), labels=reasons),
                evidence({"line": line, "first": first, "last": last} | more),
            )

    def _log_door_lines(self, labelling: ScanLabelling) -> None:
        doors, structures = labelling.door_lines, labelling.structures
        above = doors.above_door
        floor_m = np.full(len(doors.line), labelling.floor.height_m)
        top_m = structures.top_m[structures.upmost[doors.line]] + floor_m
        held = 1 + doors.behind.astype(np.uint8) + above
        self._log(
            entities.DOOR_CONDITIONS,
            rr.Points3D(
                _round(np.column_stack([doors.position, top_m])), class_ids=held, labels=door_reasons(labelling)
            ),
            evidence(
                {
                    "line": doors.line,
                    "plane": doors.plane,
                    "conditions_held": held,
                    "start_height_m": doors.start_height_m,
                    "depth_m": doors.depth_m,
                    "state": doors.state,
                }
            ),
        )
        below = np.empty((np.count_nonzero(above), 2, 3), np.float32)
        below[:, :, :2] = doors.position[above, None]
        below[:, 0, 2] = floor_m[above]
        below[:, 1, 2] = floor_m[above] + doors.start_height_m[above]
        self._log(entities.DOOR_LINES, rr.LineStrips3D(below))

    # --- difference curves ---

    def _log_curve_sheet(self, sheet: CurveSheet, slope_max: float) -> None:
        """Frames, thresholds, titles and styles, which never change."""
        cells = sheet.cells
        half = sheet.CELL_HEIGHT / 2
        small = np.column_stack([cells[:, 0], cells[:, 1] - half])
        boxes = np.concatenate(
            [
                [[0, 0, sheet.WIDTH, sheet.EXAMPLE_HEIGHT]],
                np.column_stack([small, np.full((len(cells), 2), [sheet.SAMPLES, sheet.CELL_HEIGHT])]),
            ]
        )
        self._static(
            entities.CURVE_FRAMES,
            rr.Boxes2D(
                array=boxes,
                array_format=rr.Box2DFormat.XYWH,
                colors=entities.FRAME_COLOR,
                radii=rr.Radius.ui_points(0.5),
            ),
        )
        middles = np.concatenate([[[0, sheet.EXAMPLE_HEIGHT / 2]], cells])
        widths = np.array([sheet.WIDTH] + [sheet.SAMPLES] * len(cells))
        reach = slope_max / sheet.LIMIT * np.array([sheet.EXAMPLE_HEIGHT / 2] + [half] * len(cells))
        thresholds = np.empty((2, len(middles), 2, 2), np.float32)
        thresholds[..., 0, 0], thresholds[..., 1, 0] = middles[:, 0], middles[:, 0] + widths
        thresholds[0, ..., 1], thresholds[1, ..., 1] = (middles[:, 1:] + sign * reach[:, None] for sign in (-1, 1))
        self._static(
            entities.CURVE_THRESHOLDS,
            rr.LineStrips2D(
                thresholds.reshape(-1, 2, 2),
                colors=entities.THRESHOLD_COLOR,
                radii=np.tile([_ui_radius(1.25)] + [_ui_radius(0.5)] * len(cells), 2),
                draw_order=40.0,
            ),
        )
        titles = [
            f"One line, foot left, top right: eq. 2 blue, slope that decides white, threshold ±{slope_max:g} red",
            f"Side 0, emitters 0 to {sheet.ring_count - 1}, each from -{sheet.LIMIT:g} to {sheet.LIMIT:g}; "
            "up-most green, bottom-most orange",
            f"Side 1, emitters 0 to {sheet.ring_count - 1}",
        ]
        tops = [0.0, sheet.side_top(0), sheet.side_top(1)] if sheet.ring_count else [0.0]
        self._static(
            entities.CURVE_TEXTS,
            rr.Points2D(
                [(sheet.WIDTH / 2, top - sheet.TITLE_HEIGHT) for top in tops],
                labels=titles[: len(tops)],
                show_labels=True,
                colors=entities.TEXT_COLOR,
                radii=0.0,
            ),
        )
        for path, radius_ui, color in _CURVE_STYLES:
            self._static(
                path,
                # The thresholds lie on the curves of eq. 2, the rest on both.
                rr.LineStrips2D.from_fields(
                    radii=rr.Radius.ui_points(radius_ui),
                    colors=color,
                    draw_order=30.0 if color == entities.CURVE_COLOR else 50.0,
                ),
            )
        self._static(entities.CURVE_EXAMPLE_STRUCTURES, rr.Boxes2D.from_fields(radii=rr.Radius.ui_points(1.5)))

    def _log_curves(self, labelling: ScanLabelling) -> None:
        """Eq. 2 for every line: its values, the deciding slope's, and both drawn."""
        structures, samples = labelling.structures, labelling.lines.samples
        # Not as tensors, whose union type few readers of tables know.
        self._log(
            entities.STRUCTURES,
            evidence(
                {
                    "difference": _float16(structures.difference),
                    "slope": _float16(structures.slope),
                    "line": structures.line,
                    "first": structures.first,
                    "last": structures.last,
                    "bottom_m": structures.bottom_m,
                    "top_m": structures.top_m,
                    "upmost": structures.upmost,
                    "bottommost": structures.bottommost,
                }
            ),
        )

        sheet = CurveSheet(len(samples) // 2)
        cells = sheet.cells
        present = np.flatnonzero(samples[:, 0] >= 0)
        curves = np.empty((len(present), sheet.SAMPLES, 2), np.float32)
        curves[..., 0] = cells[present, :1] + np.arange(sheet.SAMPLES, dtype=np.float32)
        scale = sheet.CELL_HEIGHT / 2 / sheet.LIMIT
        curves[..., 1] = np.rint(cells[present, 1:] - scale * _clamped(structures.difference[present], sheet.LIMIT))
        self._log(entities.CURVE_DIFFERENCES, rr.LineStrips2D(curves))
        for path, chosen, offset in (
            (entities.CURVE_UPMOST, structures.upmost, sheet.CELL_HEIGHT * 0.36),
            (entities.CURVE_BOTTOMMOST, structures.bottommost, sheet.CELL_HEIGHT * 0.46),
        ):
            own = chosen[chosen >= 0]
            line = structures.line[own]
            bars = np.empty((len(own), 2, 2), np.float32)
            bars[:, 0, 0] = cells[line, 0] + structures.first[own]
            bars[:, 1, 0] = cells[line, 0] + structures.last[own]
            bars[..., 1] = cells[line, 1:] + offset
            self._log(path, rr.LineStrips2D(bars))

    def log_line(self, points_level: FloatArray, labelling: ScanLabelling, line: int) -> None:
        """One line drawn large, in space and with its curve as in Fig. 5b, at the time that is set."""
        structures, sheet = labelling.structures, CurveSheet(len(labelling.lines) // 2)
        present = labelling.lines.samples[line, 0] >= 0
        strips, _ = _unbroken(_round(points_level[labelling.lines.samples[[line] if present else []]]))
        self._stream.log(entities.EXAMPLE_LINE, rr.LineStrips3D(strips))
        middle, scale = sheet.EXAMPLE_HEIGHT / 2, sheet.EXAMPLE_HEIGHT / 2 / sheet.LIMIT
        step = sheet.WIDTH / (sheet.SAMPLES - 1)
        x = np.arange(sheet.SAMPLES) * step
        for path, values in (
            (entities.CURVE_EXAMPLE, structures.difference),
            (entities.CURVE_EXAMPLE_SLOPE, structures.slope),
        ):
            y = middle - scale * _clamped(values[line], sheet.LIMIT)
            self._stream.log(path, rr.LineStrips2D(np.stack([x, y], axis=1, dtype=np.float32)[None] if present else []))
        own = np.flatnonzero(structures.line == line)
        boxes = np.zeros((len(own), 4), np.float32)
        boxes[:, 0] = structures.first[own] * step
        boxes[:, 2] = (structures.last[own] - structures.first[own]) * step
        boxes[:, 3] = sheet.EXAMPLE_HEIGHT
        upmost, bottommost = structures.upmost[line], structures.bottommost[line]
        colors = np.full((len(own), 3), entities.FRAME_COLOR, np.uint8)
        colors[own == bottommost] = entities.BOTTOMMOST_COLOR
        colors[own == upmost] = entities.UPMOST_COLOR
        self._stream.log(
            entities.CURVE_EXAMPLE_STRUCTURES,
            rr.Boxes2D(array=boxes, array_format=rr.Box2DFormat.XYWH, colors=colors),
            evidence({"line": np.array([line]), "first": structures.first[own], "last": structures.last[own]}),
        )
        # At heights of their own, and away from the ends: else they would hide one another, or be cut.
        named = [(upmost, "up-most: wall candidate", entities.UPMOST_COLOR, 0.58)] if upmost >= 0 else []
        if bottommost != upmost:
            named.append((bottommost, "bottom-most", entities.BOTTOMMOST_COLOR, 0.8))
        self._stream.log(
            entities.CURVE_EXAMPLE_TEXTS,
            rr.Points2D(
                [
                    (
                        np.clip(
                            (structures.first[s] + structures.last[s]) / 2 * step,
                            0.15 * sheet.WIDTH,
                            0.85 * sheet.WIDTH,
                        ),
                        height * sheet.EXAMPLE_HEIGHT,
                    )
                    for s, _, _, height in named
                ],
                labels=[name for _, name, _, _ in named],
                colors=[color for _, _, color, _ in named],
                show_labels=True,
                radii=0.0,
            ),
        )

    # --- the building ---

    def log_map_block(self, index: int, stamp_ns: int, points_map: FloatArray, label: UInt8Array) -> None:
        """Points that are new in the map since the last block; the viewer shows all up to the cursor."""
        self._at(stamp_ns, index)
        self._log_split(entities.MAP_POINTS, entities.MAP_CEILING, points_map, label, static=False)

    def log_fused_walls(self, aligned: AlignedFaces) -> None:
        """Where each face was before it was laid along the returns of all scans."""
        if len(aligned.fused):
            self._static(
                entities.FUSED_WALLS,
                rr.LineStrips3D(
                    np.pad(aligned.fused.ends, ((0, 0), (0, 0), (0, 1))).astype(np.float32),
                    colors=entities.FUSED_WALL_COLOR,
                    radii=rr.Radius.ui_points(1.0),
                    labels=[
                        f"before it was laid along all returns ({scans} scans): its ends then moved {100 * a:+.1f} and "
                        f"{100 * b:+.1f} cm towards the room"
                        for scans, (a, b) in zip(aligned.fused.scan_count, aligned.moved_m, strict=True)
                    ],
                    show_labels=False,
                ),
                evidence({"moved_m": aligned.moved_m, "scan_count": aligned.fused.scan_count}),
            )

    def log_building(self, building: BuildingModel) -> None:
        """The fused walls, what stands against them, what was refused as a wall, doors, windows and level surfaces."""
        walls, before, judged, doors, windows = (
            building.walls,
            building.before,
            building.judged,
            building.doors,
            building.windows,
        )
        panels = wall_panels(walls, doors, windows)
        if len(walls):
            self._static(
                entities.WALLS,
                _panel_mesh(panels.ends, panels.bottom_m, panels.top_m, entities.CLASSES[Label.WALL][1]),
                evidence({"wall_of_panel": panels.wall, "scan_count": walls.scan_count, "rms_m": walls.rms_m}),
            )
        if before.covered.any():
            self._static(
                entities.AGAINST_WALLS,
                rr.Points3D(
                    covered_places(walls, before).astype(np.float32),
                    radii=CELL_M / 2,
                    colors=entities.CLASSES[Label.CLUTTER][1],
                    labels="stands against the wall",
                    show_labels=False,
                ),
            )
        if len(judged.refused):
            faces = judged.refused
            self._static(
                entities.REFUSED_WALLS,
                rr.LineStrips3D(
                    upright_frames(faces.ends, faces.bottom_m, faces.top_m),
                    colors=entities.REFUSED_WALL_COLOR,
                    radii=rr.Radius.ui_points(1.5),
                    labels=[f"no wall: {entities.REFUSALS[verdict]}" for verdict in judged.verdict],
                    show_labels=False,
                ),
                evidence({"verdict": judged.verdict, "scan_count": faces.scan_count}),
            )
        widths_m = lengths_m(doors.ends)
        if len(doors):
            sills = np.pad(doors.ends, ((0, 0), (0, 0), (0, 1))).astype(np.float32)
            self._static(
                entities.DOOR_SILLS,
                rr.LineStrips3D(sills, radii=_ui_radius(3.0), colors=entities.CLASSES[Label.DOOR][1]),
            )
            self._static(
                entities.DOORS,
                rr.LineStrips3D(
                    upright_frames(doors.ends, np.zeros(len(doors)), doors.head_m),
                    colors=entities.CLASSES[Label.DOOR][1],
                    radii=rr.Radius.ui_points(3.0),
                    labels=[
                        f"{DoorState(state).name.lower()} door, {width:.2f} m, {confidence:.0%}"
                        for state, width, confidence in zip(doors.state, widths_m, doors.confidence, strict=True)
                    ],
                    show_labels=False,
                ),
                evidence(
                    {
                        "state": doors.state,
                        "confidence": doors.confidence,
                        "agreement": doors.agreement,
                        "coverage": doors.coverage,
                        "lintel": doors.lintel,
                        "ajar": doors.ajar.astype(np.uint8),
                        "scan_count": doors.scan_count,
                        "crossed": doors.crossed.astype(np.uint8),
                        "depth_m": doors.depth_m,
                        "ray_count": doors.ray_count,
                    }
                ),
            )
        # An open door is its frame; a closed one has a leaf.
        closed = doors.select(doors.state == DoorState.CLOSED)
        if len(closed):
            leaf = _panel_mesh(closed.ends, np.zeros(len(closed)), closed.head_m, entities.CLASSES[Label.DOOR][1])
            self._static(entities.DOOR_LEAVES, leaf)
        if len(windows):
            self._static(
                entities.WINDOWS,
                rr.LineStrips3D(
                    upright_frames(windows.ends, windows.bottom_m, windows.top_m),
                    colors=entities.CLASSES[Label.OUTSIDE][1],
                    radii=rr.Radius.ui_points(1.5),
                    labels=["window"] * len(windows),
                    show_labels=False,
                ),
            )

        self._log_levels(building.levels)
        self._static(
            entities.BUILDING_REASONS,
            rr.TextDocument(explain_building(building), media_type=rr.MediaType.MARKDOWN),
        )

    def _log_levels(self, levels: Sequence[HeightMap]) -> None:
        """Where ceilings, floors and ducts were told that scans took for something else, cell by cell."""
        for surface, maps in groupby(levels, key=lambda level: level.surface):
            drawn = [level for level in maps if np.isfinite(level.high_m).any()]
            if not drawn:  # what is no floor reaches up as high as one sees
                continue
            places = np.concatenate([level.places for level in drawn])
            counts = [np.count_nonzero(level.known) for level in drawn]
            low_m, high_m = (
                np.concatenate([getattr(level, name)[level.known] for level in drawn]) for name in ("low_m", "high_m")
            )
            self._static(
                f"{entities.LEVELS}/{surface}",
                rr.Boxes3D(
                    centers=places.astype(np.float32),
                    half_sizes=np.repeat([[0.5 * level.cell_m] * 2 + [0.005] for level in drawn], counts, axis=0),
                    colors=entities.CLASSES[surface.label][1],
                    fill_mode=rr.components.FillMode.Solid,
                    labels=surface.replace("_", " "),
                    show_labels=False,
                ),
                evidence({"low_m": low_m, "high_m": high_m}),
            )

    def log_grid(self, name: str, grid: GridMap) -> None:
        """A grid map; it holds for the whole run."""
        # As in nav_msgs/OccupancyGrid, which the colour map is made for: 0 free, 100 occupied, 255 unknown.
        occupancy = np.select([grid.cells == Cell.OCCUPIED, grid.cells == Cell.FREE], [100, 0], 255).astype(np.uint8)
        rows, columns = occupancy.shape
        self._static(
            f"{entities.GRID}/{name}",
            rr.GridMap(
                data=np.ascontiguousarray(occupancy[::-1]).tobytes(),  # an image's first row is its uppermost
                format=rr.components.ImageFormat(width=columns, height=rows, color_model="L", channel_datatype="U8"),
                cell_size=grid.cell_m,
                # Below the trajectory, which it would hide.
                translation=[float(grid.origin[0]), float(grid.origin[1]), -0.05],
                colormap=rr.components.Colormap.RvizMap,
            ),
        )

    def log_cloud(self, points_map: FloatArray, label: UInt8Array) -> None:
        """The fused semantic cloud, once."""
        self._log_split(entities.CLOUD, entities.CLOUD_CEILING, points_map, label, static=True)

    def _log_split(self, path: str, ceiling_path: str, points_map: FloatArray, label: UInt8Array, static: bool) -> None:
        """The ceiling apart, so that a view can look into the building from above."""
        ceiling = label == Label.CEILING
        positions = _round(points_map)
        for own_path, own in ((path, ~ceiling), (ceiling_path, ceiling)):
            self._stream.log(
                own_path,
                rr.Points3D(positions[own], class_ids=label[own], radii=_ui_radius(MAP_RADIUS_UI)),
                static=static,
            )

    # --- how ---

    def _at(self, stamp_ns: int, index: int | None = None) -> None:
        set_time(self._stream, stamp_ns, index)

    def _log(self, path: str, *values: rr.AsComponents) -> None:
        self._stream.log(path, *values, static=self._timeless)

    def _transforms(self, path: str, stamp_ns: IntArray, T: FloatArray) -> None:
        columns = rr.Transform3D.columns(translation=T[:, :3, 3], quaternion=transforms.quaternion_xyzw(T))
        self._columns(path, stamp_ns, columns)

    def _columns(self, path: str, stamp_ns: IntArray, columns: rr.ComponentColumnList) -> None:
        """One row for each horizontal scan, by its stamp."""
        if not len(stamp_ns):
            return
        indexes = [rr.TimeColumn(entities.STAMP_TIMELINE, timestamp=stamp_ns.astype("datetime64[ns]"))]
        if self._scan_reached_ns is not None:
            scan = np.searchsorted(self._scan_reached_ns, stamp_ns).clip(max=len(self._scan_reached_ns) - 1)
            indexes.append(rr.TimeColumn(entities.SCAN_TIMELINE, sequence=scan))
        self._stream.send_columns(path, indexes, columns)

    def _cloud_columns(self, path: str, stamp_ns: IntArray, clouds: Sequence[FloatArray]) -> None:
        if clouds:
            positions = _round(np.concatenate(clouds))
            sizes = [len(cloud) for cloud in clouds]
            self._columns(path, stamp_ns, rr.Points3D.columns(positions=positions).partition(sizes))

    def _static(self, path: str, *values: rr.AsComponents) -> None:
        self._stream.log(path, *values, static=True)


def log_legend(stream: rr.RecordingStream, path: str, entries: Sequence[tuple[str, entities.Color]]) -> None:
    """Names side by side, each below a dot in its colour, as `blueprints.legend` shows them."""
    across = Legend.STEP * (np.arange(len(entries)) + 0.5)
    dots = rr.Points2D(
        np.column_stack([across, np.zeros(len(entries))]),
        colors=[color for _, color in entries],
        radii=rr.Radius.ui_points(Legend.DOT_UI),
    )
    names = rr.Points2D(
        np.column_stack([across, np.full(len(entries), Legend.NAMES_BELOW)]),
        colors=entities.TEXT_COLOR,
        radii=0.0,
        labels=[name for name, _ in entries],
        show_labels=True,
    )
    stream.log(f"{path}/dots", dots, static=True)
    stream.log(f"{path}/names", names, static=True)


def set_time(stream: rr.RecordingStream, stamp_ns: int, index: int | None = None) -> None:
    """What is logged next is of this time, and of this scan."""
    stream.reset_time()
    stream.set_time(entities.STAMP_TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
    if index is not None:
        stream.set_time(entities.SCAN_TIMELINE, sequence=index)


def scan_columns(index: Sequence[int], stamp_ns: Sequence[int]) -> list[rr.TimeColumn]:
    """Both timelines for one row a scan."""
    return [
        rr.TimeColumn(entities.SCAN_TIMELINE, sequence=index),
        rr.TimeColumn(entities.STAMP_TIMELINE, timestamp=np.array(stamp_ns).astype("datetime64[ns]")),
    ]


def _scan_metrics(
    ranges: SmoothedRanges, labelling: ScanLabelling, timings_ms: Mapping[str, float]
) -> dict[str, float]:
    counts = np.bincount(labelling.label, minlength=len(Label))
    evidence = {
        "lines": int(np.count_nonzero(labelling.lines.samples[:, 0] >= 0)),
        "structures": len(labelling.structures.line),
        "candidates": len(labelling.planes.candidate_line),
        "planes": len(labelling.planes),
        "door_lines": int(np.count_nonzero(labelling.door_lines.above_door)),
        "openings": len(labelling.openings),
    }
    return (
        {f"{entities.MILLISECONDS}/{stage}": value for stage, value in timings_ms.items()}
        | {f"{entities.LABEL_COUNTS}/{entities.CLASSES[label][0]}": float(counts[label]) for label in Label}
        | {f"{entities.COUNTS}/{name}": float(count) for name, count in evidence.items()}
        | {f"{entities.RANGES}/scatter_mm": 1e3 * ranges.scatter_m}
        | {f"{entities.RANGES}/measured_alone_percent": 100.0 * (1.0 - ranges.smoothed_share)}
    )


def _annotations(classes: Mapping[int, tuple[str, entities.Color]]) -> rr.AnnotationContext:
    return rr.AnnotationContext(
        [rr.AnnotationInfo(id=int(key), label=name, color=color) for key, (name, color) in classes.items()]
    )


def _transform(T_parent_child: FloatArray) -> rr.Transform3D:
    return rr.Transform3D(
        translation=T_parent_child[:3, 3], quaternion=rr.Quaternion(xyzw=transforms.quaternion_xyzw(T_parent_child))
    )


def _round(positions_m: FloatArray) -> FloatArray:
    rounded: FloatArray = np.rint(positions_m.astype(np.float32) * np.float32(1.0 / GRID_M)) * np.float32(GRID_M)
    return rounded


def _ui_radius(points: float) -> np.float32:
    """A radius in the viewer's points, which Rerun writes as a negative number."""
    return np.float32(-points)


def evidence(columns: Mapping[str, npt.NDArray[Any]]) -> rr.AnyValues:
    """Arrays beside an archetype, with the same types in every process even where they are empty."""
    typed: dict[str, Any] = {}
    for name, values in columns.items():
        kind = {"d": np.dtype(np.float32), "l": np.dtype(np.int32)}.get(values.dtype.char, values.dtype)
        flat = pa.array(values.astype(kind, copy=False).ravel())
        typed[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 else flat
    return rr.AnyValues(**typed)


def _float16(values: FloatArray) -> FloatArray:
    return np.clip(values, -FLOAT16_MAX, FLOAT16_MAX).astype(np.float16)


def _clamped(values: FloatArray, limit: float) -> FloatArray:
    """For drawing: equal heights, where eq. 2 has no value, are as steep as it gets."""
    return np.where(np.isnan(values), np.float32(limit), np.clip(values, -limit, limit))


def _plane_color(plane: int) -> entities.Color:
    return entities.PLANE_COLORS[plane % len(entities.PLANE_COLORS)] if plane >= 0 else entities.REFUSED_CANDIDATE_COLOR


def _example_line(labelling: ScanLabelling) -> int:
    """The line that tells most: of those with several structures, if any, the one that they cover best."""
    structures = labelling.structures
    covered = np.bincount(structures.line, structures.last - structures.first + 1, len(labelling.lines))
    several = structures.upmost != structures.bottommost
    return int((covered + CurveSheet.SAMPLES * several).argmax()) if len(covered) else 0


def _spans(positions: FloatArray, samples: IntArray, line: IntArray, first: IntArray, last: IntArray) -> pa.Array:
    """Line strips through every so manieth sample of structures, their ends included."""
    counts = (last - first - 1) // _SPAN_STEP + 2
    starts = np.concatenate([[0], np.cumsum(counts)])
    within = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
    sample = np.minimum(np.repeat(first, counts) + _SPAN_STEP * within, np.repeat(last, counts))
    return _strips(positions[samples[np.repeat(line, counts), sample]], starts)


def _unbroken(lines: FloatArray) -> tuple[pa.Array, IntArray]:
    """Line strips of lines (L, n, 3), parted where a line jumps, and the line (S,) that each strip is of."""
    count, length = lines.shape[:2]
    points = lines.reshape(-1, 3)
    step = points[1:] - points[:-1]
    broken = np.ones(len(points), bool)
    broken[1:] = np.einsum("ij,ij->i", step, step) > JUMP_M**2
    broken[::length] = True
    starts = np.flatnonzero(broken)
    return _strips(points, np.append(starts, count * length)), starts // length


def _strips(points: FloatArray, starts: IntArray) -> pa.Array:
    """Ragged line strips without a Python loop: strip i is points[starts[i]:starts[i + 1]]."""
    kind = rr.components.LineStrip3DBatch([]).as_arrow_array().type
    inner = pa.FixedSizeListArray.from_arrays(pa.array(points.astype(np.float32).ravel()), type=kind.value_type)
    return pa.ListArray.from_arrays(pa.array(starts, pa.int32()), inner, type=kind)


def _upright_quads(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (4K, 3) and triangles (2K, 3) over ends (K, 2, 2) between heights (K, 2)."""
    corners = np.empty((len(ends), 4, 3), np.float32)
    corners[:, :2, :2], corners[:, :2, 2] = ends, bottom_m
    corners[:, 2:, :2], corners[:, 2:, 2] = ends[:, ::-1], top_m[:, ::-1]
    triangles = (
        np.array([[0, 1, 2], [0, 2, 3]], np.uint32)[None] + 4 * np.arange(len(ends), dtype=np.uint32)[:, None, None]
    )
    return corners.reshape(-1, 3), triangles.reshape(-1, 3)


def _panel_mesh(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray, color: entities.Color) -> rr.Mesh3D:
    """Upright rectangles that one can see through, over ends (K, 2, 2) between heights (K,)."""
    vertices, triangles = _upright_quads(ends, np.repeat(bottom_m[:, None], 2, 1), np.repeat(top_m[:, None], 2, 1))
    return rr.Mesh3D(vertex_positions=vertices, triangle_indices=triangles, albedo_factor=(*color, _SEE_THROUGH[3]))


def upright_frames(ends: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> FloatArray:
    """Closed outlines (K, 5, 3) over ends (K, 2, 2) between heights (K,)."""
    corners = _upright_quads(ends, np.repeat(bottom_m[:, None], 2, 1), np.repeat(top_m[:, None], 2, 1))[0]
    return corners.reshape(-1, 4, 3)[:, [0, 1, 2, 3, 0]]


def _outline(points_xy: FloatArray) -> FloatArray:
    """Closed rectangle (5, 2) around points, or (0, 2) around none."""
    if not len(points_xy):
        return np.zeros((0, 2), np.float32)
    x, y = points_xy[:, 0], points_xy[:, 1]
    x0, x1, y0, y1 = x.min(), x.max(), y.min(), y.max()
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], np.float32)


def _lift(outline: FloatArray, plane: HorizontalPlane) -> FloatArray:
    return np.column_stack([outline, plane.height_at(outline)]).astype(np.float32)
