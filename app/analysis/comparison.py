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
    changed_places,
    classes_of,
    compare_doors,
    compare_grids,
    compare_walls,
    match_planes,
    transitions,
)
from ffmap.app.analysis.run_labels import LabelSource, pair
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import DOORS, TRAJECTORY, WALLS, map_file
from ffmap.app.record.read_back import ReadableRecording, Row, rows
from ffmap.blueprints import entities
from ffmap.loaders.geojson import read_features
from ffmap.loaders.text_files import read_object
from ffmap.loaders.trajectory_file import read_tum

CUBE_M = 0.1
"""Edge of the cubes in which changed points are gathered for the map."""


@dataclass(frozen=True)
class RunToCompare:
    """One of the runs, under the letter that it has in the comparison.

    recording: None where it has none that can be read. labels_from: the file that its labels are read from; None where it
    has none.
    """

    letter: str
    run: FinishedRun
    recording: ReadableRecording | None
    labels_from: str | None

    @property
    def labels(self) -> LabelSource:
        """Where its labels are read from."""
        return LabelSource(self.run, self.recording)

    @property
    def title(self) -> str:
        """Letter and name."""
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


def differing_settings(runs: Sequence[FinishedRun]) -> dict[str, list[Any]]:
    """The settings that are not the same in all runs, by their dotted names; None where a run has no such setting."""
    return _differing([_flatten(run.part("settings")) for run in runs])


def differing_provenance(runs: Sequence[FinishedRun]) -> dict[str, list[Any]]:
    """Bag, options, versions and outcome, where they are not the same in all runs."""
    return _differing(
        [
            {
                "outcome": run.outcome,
                "bag": run.part("bag").get("path"),
                "bag digest": run.bag_digest,
                "poses from": run.record.get("poses_from"),
                **{f"option {k}": v for k, v in _flatten(run.part("options")).items()},
                **{f"version of {k}": v for k, v in run.part("versions").items()},
            }
            for run in runs
        ]
    )


def figures(runs: Sequence[FinishedRun]) -> dict[str, list[float | None]]:
    """Every figure of metrics.json, and counts and timings of run.json, one value a run; None where a run lacks it."""
    tables = []
    for run in runs:
        metrics = read_object(run.metrics, "run ffmap evaluate again") if run.metrics is not None else {}
        tables.append(
            {
                **_flatten({k: v for k, v in metrics.items() if k not in ("truth", "statistics")}),
                **{f"counts.{k}": v for k, v in _flatten(run.part("counts")).items()},
                **{f"seconds.{k}": v for k, v in _flatten(run.part("timings_s")).items()},
            }
        )
    names = dict.fromkeys(name for table in tables for name in table)
    return {
        name: [_figure(table.get(name)) for table in tables]
        for name in names
        if any(_figure(table.get(name)) is not None for table in tables)
    }


class LabelComparison:
    """The labels of two runs, scan by scan; iterate over it, then ask for `result`."""

    def __init__(self, a: RunToCompare, b: RunToCompare) -> None:
        self._a, self._b = a.labels, b.labels
        # Where the points lie is asked of one run alone: their places cost more than their labels.
        self._points_of_a = self._a.has_points
        self._final = True
        self._scans: list[ScanChange] = []
        self._only_a = self._only_b = self._unlike = 0
        self._cubes = VoxelTable(CUBE_M, TRANSITIONS)

    def __iter__(self) -> Iterator[ChangedPoints]:
        """The changed points of every scan that both runs have; none changed: no points."""
        first = self._a.read(with_points=self._points_of_a)
        second = self._b.read(with_points=not self._points_of_a)
        for clouds in pair(first, second):
            if clouds.a is None or clouds.b is None:
                self._only_a += clouds.b is None
                self._only_b += clouds.a is None
                continue
            if not clouds.same_cloud:
                self._unlike += 1
                continue
            a, b = clouds.a, clouds.b
            by_scan = transitions(a.label_scan, b.label_scan)
            label_a, label_b, counts = a.label_scan, b.label_scan, by_scan
            if a.label is not None and b.label is not None:
                label_a, label_b, counts = a.label, b.label, transitions(a.label, b.label)
            else:
                self._final = False
            self._scans.append(ScanChange(a.scan, a.stamp_ns, counts, changed_of(by_scan)))
            places = changed_places(label_a, label_b)
            points = a.points_map if a.points_map is not None else b.points_map
            at = points[places] if points is not None else np.full((len(places), 3), np.nan, np.float32)
            placed = np.isfinite(at).all(axis=1)
            changed = ChangedPoints(
                a.scan,
                a.stamp_ns,
                at[placed],
                classes_of(label_a[places[placed]]),
                classes_of(label_b[places[placed]]),
            )
            self._cubes.add(changed.points_map, changed.transition)
            yield changed

    def result(self) -> LabelChange:
        """What was counted."""
        return LabelChange(
            self._final, tuple(self._scans), self._only_a, self._only_b, self._unlike, self._cubes.votes()
        )


def compare_files(change: PairChange) -> None:
    """Compare all but the labels, as far as both runs have the files; what cannot be is noted in `refused`."""
    a, b = change.a, change.b
    if not change.same_bag:
        reason = "the runs are of different bags"
        change.refused |= dict.fromkeys(COMPARABLE, reason)
        return
    if _both(change, "trajectory", a.run.trajectory, b.run.trajectory, TRAJECTORY):
        assert a.run.trajectory is not None
        assert b.run.trajectory is not None
        change.trajectory = _compare_poses(read_tum(a.run.trajectory), read_tum(b.run.trajectory))
        if not len(change.trajectory.stamp_ns):
            change.trajectory = None
            change.refused["trajectory"] = "the runs have no pose in common"
    if paths := _pair_of(change, "walls", WALLS):
        change.walls = compare_walls(*(_segments(read_features(path, "lines", _AGAIN)) for path in paths))
    if paths := _pair_of(change, "doors", DOORS):
        before, after = (read_features(path, "doors", _AGAIN) for path in paths)
        change.doors = DoorsCompared(before, after, compare_doors(_segments(before), _segments(after)))
    if paths := _pair_of(change, "grid", map_file(entities.FURNITURE_FREE)):
        try:
            change.grid = compare_grids(*(read_map(path) for path in paths))
        except ValueError as error:
            change.refused["grid"] = str(error)
    if a.recording is None or b.recording is None:
        change.refused["planes"] = _lacks(change, a.recording, b.recording, "recording")
    else:
        change.planes = _compare_planes(a.recording.path, b.recording.path)
        if change.planes is None:
            change.refused["planes"] = "a recording has no wall planes of single scans"


def labels_can_be_compared(change: PairChange) -> bool:
    """Whether both runs have labels of the same clouds; else `refused` says why not."""
    a, b = change.a, change.b
    reason = ""
    if not change.same_bag:
        reason = "the runs are of different bags"
    elif a.run.topic != b.run.topic:
        reason = f"{a.letter} labelled {a.run.topic}, {b.letter} {b.run.topic}"
    else:
        lacking = [r.letter for r in (a, b) if r.labels_from is None]
        if lacking:
            reason = f"{' and '.join(lacking)} has neither a labelled bag nor scans in a recording"
    if reason:
        change.refused["labels"] = reason
    return not reason


def grid_of(run: FinishedRun) -> GridMap | None:
    """A run's furniture-free map."""
    path = run.file(map_file(entities.FURNITURE_FREE))
    return read_map(path) if path is not None else None


def _compare_poses(a: Trajectory, b: Trajectory) -> TrajectoryChange:
    stamp_ns, at_a, at_b = np.intersect1d(a.stamp_ns, b.stamp_ns, assume_unique=True, return_indices=True)
    mine, other = Trajectory(stamp_ns, a.T_map_base[at_a]), Trajectory(stamp_ns, b.T_map_base[at_b])
    return TrajectoryChange(stamp_ns, compare_trajectories(other, mine))


def _compare_planes(a: Path, b: Path) -> PlaneChange | None:
    """Scan by scan, as far as both recordings go; a scan without planes has no row."""
    found: list[tuple[int, int, int, int]] = []
    first, second = rows(a, entities.PLANES, "normal"), rows(b, entities.PLANES, "normal")
    row_a, row_b = next(first, None), next(second, None)
    while row_a is not None and row_b is not None:
        if row_a.scan == row_b.scan:
            lost, gained = match_planes(*_planes(row_a), *_planes(row_b))
            found.append((row_a.scan, row_a.stamp_ns, lost, gained))
            row_a, row_b = next(first, None), next(second, None)
        elif row_a.scan < row_b.scan:
            found.append((row_a.scan, row_a.stamp_ns, len(row_a.values["normal"]), 0))
            row_a = next(first, None)
        else:
            found.append((row_b.scan, row_b.stamp_ns, 0, len(row_b.values["normal"])))
            row_b = next(second, None)
    return PlaneChange(*np.array(found, np.int64).T) if found else None


def _planes(row: Row) -> tuple[FloatArray, FloatArray]:
    return row.values["normal"], row.values["offset_m"]


def _pair_of(change: PairChange, what: str, name: str) -> tuple[Path, Path] | None:
    first, second = change.a.run.file(name), change.b.run.file(name)
    return (first, second) if _both(change, what, first, second, name) and first and second else None


def _both(change: PairChange, what: str, first: Path | None, second: Path | None, name: str) -> bool:
    if first is not None and second is not None:
        return True
    change.refused[what] = _lacks(change, first, second, name)
    return False


def _lacks(change: PairChange, first: object, second: object, name: str) -> str:
    lacking = [r.letter for r, file in ((change.a, first), (change.b, second)) if file is None]
    return f"{' and '.join(lacking)} {'have' if len(lacking) > 1 else 'has'} no {name}"


_AGAIN = "run ffmap again"


def _segments(features: Sequence[Any]) -> FloatArray:
    """(n, 2, 2) ends of LineStrings."""
    return np.array([[p[:2] for p in f["geometry"]["coordinates"][:2]] for f in features], float).reshape(-1, 2, 2)


def _differing(tables: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    names = dict.fromkeys(name for table in tables for name in table)
    values = {name: [table.get(name) for table in tables] for name in names}
    return {name: row for name, row in values.items() if any(value != row[0] for value in row)}


def _flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flatten(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _figure(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
