"""A run against another: what can be compared of their files, and what differs.

Everything is a plain value or array that the recorder draws, the terminal shows and comparison.json keeps.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.votes import VoxelTable
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.truth.changes import (
    COMPARABLE,
    TRANSITIONS,
    ChangedPoints,
    Changes,
    DoorsCompared,
    LabelChange,
    PlaneChange,
    ScanChange,
    TrajectoryChange,
)
from ffmap.algorithms.truth.poses import compare_trajectories
from ffmap.algorithms.truth.runs import (
    changed_of,
    classes_of,
    compare_doors,
    compare_grids,
    compare_walls,
    match_planes,
    transitions,
)
from ffmap.app.analysis.run_labels import has_points, labels_file, pair, read_run_labels, side_by_side
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import DOORS, LABELS, METRICS, TRAJECTORY, WALLS, map_file
from ffmap.app.record.read_back import ReadableRecording, Row, rows
from ffmap.blueprints import entities
from ffmap.loaders.geojson import read_features, segments
from ffmap.loaders.text_files import dotted_keys, read_object
from ffmap.loaders.trajectory_file import read_tum

CUBE_M = 0.1
"""Edge of the cubes in which changed points are gathered for the map."""
_AGAIN = "run ffmap again"
_OTHER_BAG = "the runs are of different bags"


@dataclass(frozen=True)
class RunToCompare:
    """One of the runs, under the letter that it has in the comparison.

    recording: None where it has none that can be read.
    """

    letter: str
    run: FinishedRun
    recording: ReadableRecording | None

    @property
    def title(self) -> str:
        return f"{self.letter}: {self.run.name}"


@dataclass(kw_only=True)
class PairChange(Changes):
    """What differs between two runs; `refused` says why something could not be compared."""

    a: RunToCompare
    b: RunToCompare
    refused: dict[str, str] = field(default_factory=dict)

    @property
    def same_bag(self) -> bool:
        """Whether both runs are of the same bag, so that they have clouds and a map frame in common."""
        return self.a.run.labelled_same_clouds(self.b.run)

    @property
    def reasons(self) -> dict[str, str]:
        """What could not be compared, together where the reason is the same, and that reason."""
        reasons = dict.fromkeys(self.refused.values())
        return {", ".join(name for name in self.refused if self.refused[name] == why): why for why in reasons}


@dataclass(frozen=True)
class Comparison:
    """The first run against each of the others, and what was to be said on the way.

    settings, provenance: what is not the same in all runs. figures: all that any run has. Each has one value a run.
    """

    runs: tuple[RunToCompare, ...]
    changes: tuple[PairChange, ...]
    settings: dict[str, list[Any]]
    provenance: dict[str, list[Any]]
    figures: dict[str, list[float | None]]
    warnings: tuple[str, ...]


def differing_settings(runs: Sequence[FinishedRun]) -> dict[str, list[Any]]:
    """The settings that are not the same in all runs, by their dotted names; None where a run has no such setting."""
    return _differing([dotted_keys(run.part("settings")) for run in runs])


def differing_provenance(runs: Sequence[FinishedRun]) -> dict[str, list[Any]]:
    """Bag, options, versions and outcome, where they are not the same in all runs."""
    return _differing(
        [
            {
                "outcome": run.outcome,
                "bag": str(run.bag_path) if run.bag_path else None,
                "bag digest": run.part("bag").get("digest"),
                "poses from": run.record.get("poses_from"),
                **dotted_keys(run.part("options"), "option "),
                **{f"version of {k}": v for k, v in run.part("versions").items()},
            }
            for run in runs
        ]
    )


def figures(runs: Sequence[FinishedRun]) -> dict[str, list[float | None]]:
    """Every figure of metrics.json, and counts and timings of run.json, one value a run; None where a run lacks it."""
    tables = []
    for run in runs:
        path = run.file(METRICS)
        metrics = read_object(path, "run ffmap evaluate again") if path is not None else {}
        tables.append(
            {
                **dotted_keys({k: v for k, v in metrics.items() if k not in ("truth", "statistics")}),
                **dotted_keys(run.part("counts"), "counts."),
                **dotted_keys(run.part("timings_s"), "seconds."),
            }
        )
    rows = {name: list(map(_figure, values)) for name, values in _by_name(tables).items()}
    return {name: row for name, row in rows.items() if any(figure is not None for figure in row)}


class LabelComparison:
    """The labels of two runs, scan by scan; iterate over it, then ask for `result`."""

    def __init__(self, a: RunToCompare, b: RunToCompare) -> None:
        self._a, self._b = a.run, b.run
        # Where the points lie is asked of one run alone: their places cost more than their labels.
        self._points_of_a = has_points(self._a)
        self._scans: list[ScanChange] = []
        self._only_a = self._only_b = self._unlike = 0
        self._cubes = VoxelTable(CUBE_M, TRANSITIONS)

    def __iter__(self) -> Iterator[ChangedPoints]:
        """The changed points of every scan that both runs have; none changed: no points."""
        # A topic that one run alone labelled has nothing beside it.
        common = common_topics(self._a, self._b)
        points_of_b = not self._points_of_a and has_points(self._b)
        first, second = (
            (cloud for cloud in read_run_labels(run, with_points) if cloud.topic is None or cloud.topic in common)
            for run, with_points in ((self._a, self._points_of_a), (self._b, points_of_b))
        )
        for a, b in pair(first, second):
            if a is None or b is None:
                self._only_a += b is None
                self._only_b += a is None
                continue
            if len(a.label_scan) != len(b.label_scan):
                self._unlike += 1
                continue
            changed_scan = changed_of(transitions(a.label_scan, b.label_scan))
            self._scans.append(ScanChange(a.scan, a.stamp_ns, transitions(a.label, b.label), changed_scan))
            places = np.flatnonzero(a.label != b.label)
            points = a.points_map if a.points_map is not None else b.points_map
            at = points[places] if points is not None else np.full((len(places), 3), np.nan, np.float32)
            placed = np.isfinite(at).all(axis=1)
            before, after = (classes_of(label[places[placed]]) for label in (a.label, b.label))
            changed = ChangedPoints(a.scan, a.stamp_ns, at[placed], before, after)
            self._cubes.add(changed.points_map, changed.transition)
            yield changed

    def result(self) -> LabelChange:
        counts = (self._only_a, self._only_b, self._unlike)
        return LabelChange(tuple(self._scans), *counts, self._cubes.votes())


def compare_files(change: PairChange) -> None:
    """Compare all but the labels, as far as both runs have the files; what cannot be is noted in `refused`."""
    if not change.same_bag:
        change.refused |= dict.fromkeys(COMPARABLE, _OTHER_BAG)
        return
    if paths := _of_both(change, "trajectory", TRAJECTORY):
        poses = _compare_poses(*map(read_tum, paths))
        if len(poses.stamp_ns):
            change.trajectory = poses
        else:
            change.refused["trajectory"] = "the runs have no pose in common"
    if paths := _of_both(change, "walls", WALLS):
        change.walls = compare_walls(*(segments(read_features(path, "lines", _AGAIN)) for path in paths))
    if paths := _of_both(change, "doors", DOORS):
        before, after = (read_features(path, "doors", _AGAIN) for path in paths)
        change.doors = DoorsCompared(before, after, compare_doors(segments(before), segments(after)))
    if paths := _of_both(change, "grid", map_file(entities.FURNITURE_FREE)):
        try:
            change.grid = compare_grids(*map(read_map, paths))
        except ValueError as error:
            change.refused["grid"] = str(error)
    recordings = [run.recording.path for run in (change.a, change.b) if run.recording is not None]
    if len(recordings) < 2:
        change.refused["planes"] = _lacks([r for r in (change.a, change.b) if r.recording is None], "recording")
    elif set(change.a.run.topics) != set(change.b.run.topics):
        change.refused["planes"] = f"{_what_was_labelled(change)}: their scans are numbered otherwise"
    else:
        change.planes = _compare_planes(*recordings)
        if change.planes is None:
            change.refused["planes"] = "a recording has no wall planes of single scans"


def labels_can_be_compared(change: PairChange) -> bool:
    """Whether both runs have labels of the same clouds; else `refused` says why not."""
    a, b = change.a, change.b
    lacking = [run for run in (a, b) if labels_file(run.run) is None]
    if not change.same_bag:
        change.refused["labels"] = _OTHER_BAG
    elif a.run.topics and not common_topics(a.run, b.run):
        change.refused["labels"] = _what_was_labelled(change)
    elif lacking:
        change.refused["labels"] = _lacks(lacking, LABELS)
    return "labels" not in change.refused


def common_topics(a: FinishedRun, b: FinishedRun) -> list[str]:
    """The topics whose clouds both runs labelled."""
    return [topic for topic in a.topics if topic in b.topics]


def _what_was_labelled(change: PairChange) -> str:
    return ", ".join(f"{run.letter} labelled {' and '.join(run.run.topics)}" for run in (change.a, change.b))


def grid_of(run: FinishedRun) -> GridMap | None:
    """A run's furniture-free map."""
    path = run.file(map_file(entities.FURNITURE_FREE))
    return read_map(path) if path is not None else None


def _compare_poses(a: Trajectory, b: Trajectory) -> TrajectoryChange:
    stamp_ns, at_a, at_b = np.intersect1d(a.stamp_ns, b.stamp_ns, assume_unique=True, return_indices=True)
    mine, other = Trajectory(stamp_ns, a.T_map_base[at_a]), Trajectory(stamp_ns, b.T_map_base[at_b])
    return TrajectoryChange(stamp_ns, compare_trajectories(other, mine))


def _compare_planes(path_a: Path, path_b: Path) -> PlaneChange | None:
    """Scan by scan, as far as both recordings go; a scan without planes has no row."""
    found: list[tuple[int, int, int, int]] = []
    first, second = (rows(path, entities.PLANES, "normal") for path in (path_a, path_b))
    for a, b in side_by_side(first, second, lambda row: row.scan, to_the_end=False):
        row = a or b
        assert row is not None
        lost, gained = (0 if own is None else len(own.values["normal"]) for own in (a, b))
        if a is not None and b is not None:
            lost, gained = match_planes(*_planes(a), *_planes(b))
        found.append((row.scan, row.stamp_ns, lost, gained))
    return PlaneChange(*np.array(found, np.int64).T) if found else None


def _planes(row: Row) -> tuple[FloatArray, FloatArray]:
    return row.values["normal"], row.values["offset_m"]


def _of_both(change: PairChange, what: str, name: str) -> tuple[Path, Path] | None:
    """A file of both runs; None where one has none, and `refused` says so."""
    first, second = change.a.run.file(name), change.b.run.file(name)
    if first is not None and second is not None:
        return first, second
    change.refused[what] = _lacks([run for run in (change.a, change.b) if run.run.file(name) is None], name)
    return None


def _lacks(runs: Sequence[RunToCompare], name: str) -> str:
    return f"{' and '.join(run.letter for run in runs)} {'have' if len(runs) > 1 else 'has'} no {name}"


def _by_name(tables: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: [table.get(name) for table in tables] for name in names}


def _differing(tables: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    return {name: row for name, row in _by_name(tables).items() if any(value != row[0] for value in row)}


def _figure(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
