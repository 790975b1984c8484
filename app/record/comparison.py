"""A comparison as one recording: the runs re-rooted below their letters, and what differs in the map's frame."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.truth.changes import (
    TRANSITIONS,
    ChangedPoints,
    Changes,
    DoorsCompared,
    LabelChange,
    PlaneChange,
    TrajectoryChange,
    most_frequent,
    name_transition,
)
from ffmap.app.record.building import log_grid
from ffmap.app.record.log import Log, evidence, times
from ffmap.app.record.read_back import chunk_stream
from ffmap.app.record.shapes import annotations, at_height, strips, ui_radius
from ffmap.blueprints import entities

_LIFT_M = 0.05
"""Height in metres of what changed above the map, which would hide it."""
_WHITE = (255, 255, 255)

_MAP = (
    *("/", entities.WORLD, entities.TRAJECTORY, f"{entities.BASE}/**", "/world/map/**", f"{entities.BUILDING}/**"),
    *(f"{entities.LABEL_COUNTS}/**", f"{entities.COUNTS}/**", f"{entities.MILLISECONDS}/**", entities.MESSAGES),
)
_SCANS = (
    *(entities.SCAN, entities.POINTS, entities.PLANES, entities.UPMOST),
    *("/scan/doors/**", entities.FLOOR, entities.CEILING),
)


def write_rerooted(source: Path, letter: str, out: Path, recording_id: str, scans: bool) -> bool:
    """A run's recording below its letter, chunk by chunk; False where it has nothing to show.

    scans: with single scans, without the lines and curves of each.
    """
    passed = 0

    def rerooted(chunk: Any) -> Any:  # noqa: ANN401 - Rerun's own type
        nonlocal passed
        passed += 1
        return chunk.with_entity_path(f"/{letter}{chunk.entity_path.rstrip('/')}")

    wanted = chunk_stream(source).filter(content=[*_MAP, *(_SCANS if scans else ())])
    wanted.map(rerooted).write_rrd(out, application_id=entities.APPLICATION_ID, recording_id=recording_id)
    return passed > 0


def log_changed_points(log: Log, letter: str, changed: ChangedPoints) -> None:
    """The points of one scan whose labels differ; their class ids are 7 × before + after."""
    log.at(changed.stamp_ns, changed.scan)
    log.now(
        entities.CHANGED_POINTS.format(letter),
        rr.Points3D(changed.points_map, class_ids=changed.transition),
        evidence(changed, "before", "after"),
    )


class ComparisonRecorder:
    """Logs what was found once all scans have been compared."""

    def __init__(self, log: Log, changes: Sequence[LabelChange]) -> None:
        """changes: of all pairs, for a transition from one label to another has the same colour in each."""
        self._log = log
        frequent = most_frequent(changes, len(entities.TRANSITION_COLORS))
        self._colors = dict(zip(frequent, entities.TRANSITION_COLORS, strict=False))

    def log_common(self, text: str) -> None:
        """The runs in words, and the colours of what changed."""
        self._log.static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._log.text(entities.RUNS_TEXT, text)
        rest = entities.OTHER_TRANSITION_COLOR
        classes = {code: (name_transition(code), self._colors.get(code, rest)) for code in range(TRANSITIONS)}
        self._log.static("/changes", annotations(classes))

    def log_run(self, letter: str, color: entities.Color, path_m: FloatArray | None, grid: GridMap | None) -> None:
        """A run's trajectory (n, 3) and map, both for the views from above."""
        if path_m is not None:
            self._log.static(f"{entities.PATHS}/{letter}", strips([path_m.astype(np.float32)], color, 1.5, letter))
        if grid is not None:
            log_grid(self._log, letter, grid)

    def log_pair(self, letter: str, change: Changes, text: str, scan_of: dict[int, int]) -> None:
        """Everything that differs between the first run and the one of this letter.

        scan_of: the scan of each stamp, as far as it is known.
        """
        self._log.text(entities.CHANGES_TEXT.format(letter), text)
        if change.labels is not None:
            self._log_labels(letter, change.labels)
        if change.planes is not None:
            self._log_planes(letter, change.planes)
        if change.trajectory is not None:
            self._log_poses(letter, change.trajectory, scan_of)
        if change.doors is not None:
            self._log_doors(letter, change.doors)
        for name, color in (("lost", entities.LOST_COLOR), ("gained", entities.GAINED_COLOR)):
            if change.walls is not None:
                path = f"{entities.CHANGED_WALLS.format(letter)}/{name}"
                self._log_strips(path, getattr(change.walls, name), color, 5.0)
            if change.grid is not None and len(centres := getattr(change.grid, name)):
                cells = rr.Points3D(at_height(centres, 0.5 * _LIFT_M), colors=color, radii=ui_radius(2.0))
                self._log.static(f"{entities.CHANGED_CELLS.format(letter)}/{name}", cells)

    def _log_labels(self, letter: str, change: LabelChange) -> None:
        self._log.static(entities.CHANGED_POINTS.format(letter), rr.Points3D.from_fields(radii=ui_radius(2.5)))
        cubes = change.cubes
        drawn = rr.Points3D(cubes.mean_position.astype(np.float32), class_ids=cubes.label, radii=ui_radius(2.5))
        self._log.static(entities.CHANGED_CUBES.format(letter), drawn)
        if not change.scans:
            return
        indexes = times([s.stamp_ns for s in change.scans], [s.scan for s in change.scans])
        counts = np.array([s.counts for s in change.scans]).reshape(len(change.scans), -1)
        points = np.maximum(counts.sum(axis=1), 1)
        path = entities.CHANGED_PERCENT.format(letter)
        for rank, (code, color) in enumerate(self._colors.items()):
            self._log_curve(f"{path}/{rank}", indexes, 100.0 * counts[:, code] / points, name_transition(code), color)
        changed, changed_scan = np.array([(s.changed, s.changed_scan) for s in change.scans]).T
        self._log_curve(f"{path}/all", indexes, 100.0 * changed / points, "all", _WHITE)
        path = entities.CHANGED_PERCENT_SCAN.format(letter)
        self._log_curve(f"{path}/all", indexes, 100.0 * changed_scan / points, "label_scan", _WHITE)

    def _log_planes(self, letter: str, change: PlaneChange) -> None:
        indexes = times(change.stamp_ns, change.scan)
        path = entities.CHANGED_PLANES.format(letter)
        self._log_curve(f"{path}/lost", indexes, change.lost.astype(float), "lost", entities.LOST_COLOR)
        self._log_curve(f"{path}/gained", indexes, change.gained.astype(float), "gained", entities.GAINED_COLOR)

    def _log_poses(self, letter: str, change: TrajectoryChange, scan_of: dict[int, int]) -> None:
        known = np.array([stamp in scan_of for stamp in change.stamp_ns.tolist()], bool)
        stamps = change.stamp_ns[known].tolist()
        if not stamps:
            return
        indexes = times(stamps, [scan_of[stamp] for stamp in stamps])
        path = entities.POSE_DISTANCE.format(letter)
        for name, values, color in (
            ("as they stand", change.figures.error_unaligned_m, _WHITE),
            ("aligned", change.figures.error_m, entities.RUN_COLORS[0]),
        ):
            # To the micrometre: what is less is the arithmetic's.
            self._log_curve(f"{path}/{name.replace(' ', '_')}", indexes, np.round(values[known], 6), name, color)

    def _log_doors(self, letter: str, doors: DoorsCompared) -> None:
        lost = [doors.before[i] for i in doors.change.lost]
        gained = [doors.after[j] for j in doors.change.gained]
        altered = [doors.after[j] for _, j, _ in doors.altered]
        for name, features, color, labels in (
            ("lost", lost, entities.LOST_COLOR, [f"lost: {_state(door)} door" for door in lost]),
            ("gained", gained, entities.GAINED_COLOR, [f"gained: {_state(door)} door" for door in gained]),
            ("altered", altered, entities.KEYPOINT_COLOR, [what for _, _, what in doors.altered]),
        ):
            ends = np.array([[p[:2] for p in f["geometry"]["coordinates"][:2]] for f in features], float)
            path = f"{entities.CHANGED_DOORS.format(letter)}/{name}"
            self._log_strips(path, ends.reshape(-1, 2, 2), color, 7.0, labels)

    def _log_strips(
        self, path: str, ends: FloatArray, color: entities.Color, radius_ui: float, labels: Sequence[str] | None = None
    ) -> None:
        if len(ends):
            self._log.static(path, strips(at_height(ends, _LIFT_M), color, radius_ui, labels))

    def _log_curve(
        self, path: str, indexes: list[rr.TimeColumn], values: FloatArray, name: str, color: entities.Color
    ) -> None:
        self._log.curve_style(path, name, color)
        self._log.curve(path, indexes, values)


def _state(door: Mapping[str, Any]) -> str:
    return str(door["properties"].get("state"))
