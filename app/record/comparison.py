"""A comparison as one recording: the runs re-rooted below their letters, and what differs in the map's frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import LazyChunkStream

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.building.votes import majority
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
from ffmap.app.record.log import Log, evidence, scan_columns, set_time
from ffmap.app.record.read_back import chunk_stream
from ffmap.blueprints import entities

_LIFT_M = 0.05
"""What changed lies so far above the map, which would hide it."""

_MAP = (
    *("/", entities.WORLD, entities.TRAJECTORY, f"{entities.BASE}/**", "/world/map/**", f"{entities.BUILDING}/**"),
    *(f"{entities.LABEL_COUNTS}/**", f"{entities.COUNTS}/**", f"{entities.MILLISECONDS}/**", entities.MESSAGES),
)
_SCANS = (
    *(entities.SCAN, entities.POINTS, entities.PLANES, entities.UPMOST),
    *("/scan/doors/**", entities.FLOOR, entities.CEILING),
)


@dataclass(frozen=True)
class TransitionStyle:
    """Colours of the transitions that befell most points."""

    codes: tuple[int, ...]

    @staticmethod
    def of(changes: Sequence[LabelChange]) -> "TransitionStyle":
        """The same colours in every comparison of a recording."""
        return TransitionStyle(tuple(most_frequent(changes, len(entities.TRANSITION_COLORS))))

    def color(self, code: int) -> entities.Color:
        """The transition's own colour, or that of all the rest."""
        if code in self.codes:
            return entities.TRANSITION_COLORS[self.codes.index(code)]
        return entities.OTHER_TRANSITION_COLOR


def write_rerooted(source: Path, letter: str, out: Path, recording_id: str, scans: bool) -> bool:
    """A run's recording below its letter, chunk by chunk; False where it has nothing to show.

    scans: with single scans, without the lines and curves of each.
    """
    wanted = [*_MAP, *(_SCANS if scans else ())]
    counted = _Counted()
    stream: LazyChunkStream = chunk_stream(source).filter(content=wanted)
    stream.map(
        lambda chunk: counted.passing(chunk.with_entity_path(f"/{letter}{chunk.entity_path.rstrip('/')}"))
    ).write_rrd(out, application_id=entities.APPLICATION_ID, recording_id=recording_id)
    return counted.count > 0


class _Counted:
    """How many chunks passed."""

    def __init__(self) -> None:
        self.count = 0

    def passing(self, chunk: Any) -> Any:  # noqa: ANN401 - Rerun's own type
        self.count += 1
        return chunk


def log_changed_points(stream: rr.RecordingStream, letter: str, changed: ChangedPoints) -> None:
    """The points of one scan whose labels differ; their class ids are 7 × before + after."""
    set_time(stream, changed.stamp_ns, changed.scan)
    stream.log(
        entities.CHANGED_POINTS.format(letter),
        rr.Points3D(changed.points_map, class_ids=changed.transition),
        evidence({"before": changed.before, "after": changed.after}),
    )


class ComparisonRecorder:
    """Logs what was found once all scans have been compared."""

    def __init__(self, stream: rr.RecordingStream, style: TransitionStyle) -> None:
        self._stream, self._style = stream, style

    def log_common(self, text: str) -> None:
        """The runs in words, and the colours of what changed."""
        self._static("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._static(entities.RUNS_TEXT, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        self._static(
            "/changes",
            rr.AnnotationContext(
                [
                    rr.AnnotationInfo(id=code, label=name_transition(code), color=self._style.color(code))
                    for code in range(TRANSITIONS)
                ]
            ),
        )

    def log_run(self, letter: str, color: entities.Color, path_m: FloatArray | None, grid: GridMap | None) -> None:
        """A run's trajectory (n, 3) and map, both for the views from above."""
        if path_m is not None:
            self._static(
                f"{entities.PATHS}/{letter}",
                rr.LineStrips3D(
                    [path_m.astype(np.float32)], colors=color, radii=rr.Radius.ui_points(1.5), labels=letter
                ),
            )
        if grid is not None:
            log_grid(Log(self._stream), letter, grid)

    def log_pair(self, letter: str, change: Changes, text: str, scan_of: dict[int, int]) -> None:
        """Everything that differs between the first run and the one of this letter.

        scan_of: the scan of each stamp, as far as it is known.
        """
        self._static(entities.CHANGES_TEXT.format(letter), rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))
        if change.labels is not None:
            self._log_labels(letter, change.labels)
        if change.planes is not None:
            self._log_planes(letter, change.planes)
        if change.trajectory is not None:
            self._log_poses(letter, change.trajectory, scan_of)
        if change.walls is not None:
            path = entities.CHANGED_WALLS.format(letter)
            self._log_strips(f"{path}/lost", change.walls.lost, entities.LOST_COLOR, 5.0)
            self._log_strips(f"{path}/gained", change.walls.gained, entities.GAINED_COLOR, 5.0)
        if change.doors is not None:
            self._log_doors(letter, change.doors)
        if change.grid is not None:
            path = entities.CHANGED_CELLS.format(letter)
            self._log_cells(f"{path}/lost", change.grid.lost, entities.LOST_COLOR)
            self._log_cells(f"{path}/gained", change.grid.gained, entities.GAINED_COLOR)

    def _log_labels(self, letter: str, change: LabelChange) -> None:
        self._static(entities.CHANGED_POINTS.format(letter), rr.Points3D.from_fields(radii=rr.Radius.ui_points(2.5)))
        cubes = change.cubes
        self._static(
            entities.CHANGED_CUBES.format(letter),
            rr.Points3D(
                cubes.mean_position.astype(np.float32),
                class_ids=majority(cubes.counts),
                radii=rr.Radius.ui_points(2.5),
            ),
        )
        if not change.scans:
            return
        indexes = scan_columns([s.scan for s in change.scans], [s.stamp_ns for s in change.scans])
        counts = np.array([s.counts for s in change.scans]).reshape(len(change.scans), -1)
        points = np.maximum(counts.sum(axis=1), 1)
        for rank, code in enumerate(self._style.codes):
            self._log_curve(
                f"{entities.CHANGED_PERCENT.format(letter)}/{rank}",
                indexes,
                100.0 * counts[:, code] / points,
                name_transition(code),
                self._style.color(code),
            )
        changed = np.array([s.changed for s in change.scans])
        self._log_curve(
            f"{entities.CHANGED_PERCENT.format(letter)}/all", indexes, 100.0 * changed / points, "all", (255, 255, 255)
        )
        self._log_curve(
            f"{entities.CHANGED_PERCENT_SCAN.format(letter)}/all",
            indexes,
            100.0 * np.array([s.changed_scan for s in change.scans]) / points,
            "label_scan",
            (255, 255, 255),
        )

    def _log_planes(self, letter: str, change: PlaneChange) -> None:
        indexes = scan_columns(change.scan.tolist(), change.stamp_ns.tolist())
        path = entities.CHANGED_PLANES.format(letter)
        self._log_curve(f"{path}/lost", indexes, change.lost.astype(float), "lost", entities.LOST_COLOR)
        self._log_curve(f"{path}/gained", indexes, change.gained.astype(float), "gained", entities.GAINED_COLOR)

    def _log_poses(self, letter: str, change: TrajectoryChange, scan_of: dict[int, int]) -> None:
        known = np.array([stamp in scan_of for stamp in change.stamp_ns.tolist()], bool)
        stamps = change.stamp_ns[known].tolist()
        if not stamps:
            return
        indexes = scan_columns([scan_of[stamp] for stamp in stamps], stamps)
        path = entities.POSE_DISTANCE.format(letter)
        for name, values, color in (
            ("as_they_stand", change.figures.error_unaligned_m, (255, 255, 255)),
            ("aligned", change.figures.error_m, entities.RUN_COLORS[0]),
        ):
            # To the micrometre: what is less is the arithmetic's.
            self._log_curve(f"{path}/{name}", indexes, np.round(values[known], 6), name.replace("_", " "), color)

    def _log_doors(self, letter: str, doors: DoorsCompared) -> None:
        path = entities.CHANGED_DOORS.format(letter)
        altered = doors.altered
        for name, features, color, labels in (
            (
                "lost",
                [doors.before[i] for i in doors.change.lost],
                entities.LOST_COLOR,
                [f"lost: {doors.before[i]['properties'].get('state')} door" for i in doors.change.lost],
            ),
            (
                "gained",
                [doors.after[j] for j in doors.change.gained],
                entities.GAINED_COLOR,
                [f"gained: {doors.after[j]['properties'].get('state')} door" for j in doors.change.gained],
            ),
            (
                "altered",
                [doors.after[j] for _, j, _ in altered],
                entities.KEYPOINT_COLOR,
                [what for _, _, what in altered],
            ),
        ):
            ends = np.array([[p[:2] for p in f["geometry"]["coordinates"][:2]] for f in features], float).reshape(
                -1, 2, 2
            )
            self._log_strips(f"{path}/{name}", ends, color, 7.0, labels)

    def _log_strips(
        self, path: str, ends: FloatArray, color: entities.Color, radius_ui: float, labels: Sequence[str] | None = None
    ) -> None:
        if len(ends):
            strips = np.pad(ends, ((0, 0), (0, 0), (0, 1)), constant_values=_LIFT_M).astype(np.float32)
            self._static(
                path, rr.LineStrips3D(strips, colors=color, radii=rr.Radius.ui_points(radius_ui), labels=labels)
            )

    def _log_cells(self, path: str, centres: FloatArray, color: entities.Color) -> None:
        if len(centres):
            points = np.pad(centres, ((0, 0), (0, 1)), constant_values=0.5 * _LIFT_M).astype(np.float32)
            self._static(path, rr.Points3D(points, colors=color, radii=rr.Radius.ui_points(2.0)))

    def _log_curve(
        self, path: str, indexes: list[rr.TimeColumn], values: FloatArray | IntArray, name: str, color: entities.Color
    ) -> None:
        self._static(path, rr.SeriesLines(colors=color, names=name, widths=1.5))
        self._stream.send_columns(path, indexes, rr.Scalars.columns(scalars=values))

    def _static(self, path: str, *values: rr.AsComponents) -> None:
        self._stream.log(path, *values, static=True)
