"""Compare the first of several runs with each of the others.

Everything is a number, an array or text that the terminal, the recording and comparison.json show.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.truth.changes import (
    TRANSITIONS,
    Became,
    Changes,
    compare_grids,
    most_frequent,
    name_transition,
    unmatched_walls,
)
from ffmap.algorithms.truth.doors import match_doors
from ffmap.algorithms.truth.poses import compare_trajectories
from ffmap.app.analysis.figures import Figure, read_figures
from ffmap.app.analysis.label_changes import compare_labels
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import ScanLabels
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import DOORS, LABELS, TRAJECTORY, WALLS, map_file
from ffmap.blueprints import entities
from ffmap.loaders.geojson import read_features, segments
from ffmap.loaders.text_files import dotted_keys
from ffmap.loaders.trajectory_file import read_tum

_WIDTH_M = 0.01
"""Widths of doors that differ by less are the same."""
_ADVICE = "run ffmap again"

CHANGES = {
    "labels.changed": Figure("labels changed"),
    "labels.changed_share": Figure("labels changed", "%"),
    "labels.became_right": Figure("labels that became right"),
    "labels.became_wrong": Figure("labels that became wrong"),
    "labels.changed_scan": Figure("labels of single scans changed"),
    "labels.points": Figure("points compared"),
    "labels.scans": Figure("scans compared"),
    "labels.scans_only_a": Figure("scans of the first run alone"),
    "labels.scans_only_b": Figure("scans of the other run alone"),
    "labels.scans_unlike": Figure("scans of different size, left out"),
    "trajectory.mean_m": Figure("distance of poses, mean", "cm"),
    "trajectory.max_m": Figure("distance of poses, largest", "cm"),
    "trajectory.aligned_mean_m": Figure("distance of aligned poses, mean", "cm"),
    "trajectory.aligned_max_m": Figure("distance of aligned poses, largest", "cm"),
    "trajectory.poses": Figure("poses compared"),
    "walls.lost_m": Figure("wall faces lost", "m"),
    "walls.gained_m": Figure("wall faces gained", "m"),
    "walls.length_m": Figure("wall faces compared", "m"),
    "doors.lost": Figure("doors lost"),
    "doors.gained": Figure("doors gained"),
    "doors.altered": Figure("doors altered"),
    "doors.compared": Figure("doors compared"),
    "grid.occupied_lost": Figure("occupied cells lost"),
    "grid.occupied_gained": Figure("occupied cells gained"),
    "grid.occupied_kept": Figure("occupied cells kept"),
    "grid.free_lost": Figure("free cells lost"),
    "grid.free_gained": Figure("free cells gained"),
}
"""Numbers that describe what differs between two runs."""

ChangedPoints = Callable[[str, ScanLabels, FloatArray, UInt8Array, UInt8Array], None]
"""Receives the second run's letter, each compared cloud, and positions (c, 3), classes before (c,)
and classes after (c,) of its changed points."""


@dataclass(frozen=True)
class RunToCompare:
    """A run under its letter. recording: None without one that can be read."""

    letter: str
    run: FinishedRun
    recording: Path | None

    @property
    def title(self) -> str:
        """Letter and name."""
        return f"{self.letter}: {self.run.name}"

    @property
    def grid(self) -> GridMap | None:
        """The furniture-free map."""
        path = self.run.file(map_file(entities.FURNITURE_FREE))
        return read_map(path) if path is not None else None


@dataclass(eq=False, kw_only=True)
class Change(Changes):
    """Differences between two runs.

    figures: by the names of `CHANGES`. details: what comparison.json holds beside them.
    not_compared: why, by subject.
    """

    a: RunToCompare
    b: RunToCompare
    figures: dict[str, float] = field(default_factory=dict)
    details: dict[str, Any] = field(default_factory=dict)
    not_compared: dict[str, str] = field(default_factory=dict)

    @property
    def same_bag(self) -> bool:
        """Whether both runs have clouds and a map frame in common."""
        a, b = self.a.run.record, self.b.run.record
        same_bag = a.bag.digest is not None and a.bag.digest == b.bag.digest
        return same_bag and not set(a.topics).isdisjoint(b.topics)

    @property
    def compared(self) -> list[str]:
        """The subjects that were compared."""
        return [subject for subject in _SUBJECTS if subject not in self.not_compared]


@dataclass(frozen=True)
class Comparison:
    """The first run compared with each of the others.

    settings: with options and versions, those that differ. figures: all. One value for each run.
    """

    runs: tuple[RunToCompare, ...]
    changes: tuple[Change, ...]
    settings: dict[str, list[Any]]
    figures: dict[str, list[float | None]]
    warnings: tuple[str, ...]

    @property
    def most_changed(self) -> tuple[str | None, int | None]:
        """Letter and worst scan of the run with most changed labels; None if none changed."""
        changed = [change for change in self.changes if change.figures.get("labels.changed")]
        if not changed:
            return None, None
        most = max(changed, key=lambda change: change.figures["labels.changed"])
        assert most.labels is not None
        return most.b.letter, most.labels.worst


def compare_runs(
    runs: Sequence[RunToCompare],
    warnings: Sequence[str],
    changed_points: ChangedPoints,
) -> Comparison:
    """Compare the first run with each of the others."""
    changes = []
    for other in runs[1:]:
        change = Change(a=runs[0], b=other)
        for subject, (file, compare) in _SUBJECTS.items():
            lacking = [run.letter for run in (change.a, change.b) if run.run.file(file) is None]
            if not change.same_bag:
                why: str | None = "the runs labelled different bags or topics"
            elif lacking:
                why = f"{' and '.join(lacking)} {'has' if len(lacking) == 1 else 'have'} no {file}"
            else:
                why = compare(change, changed_points)
            if why is not None:
                change.not_compared[subject] = why
        changes.append(change)
    tables = [_settings(run.run) for run in runs]
    return Comparison(
        runs=tuple(runs),
        changes=tuple(changes),
        settings={
            name: row
            for name, row in _by_name(tables).items()
            if any(value != row[0] for value in row)
        },
        figures=_by_name([read_figures(run.run.path, run.run.record) for run in runs]),
        warnings=tuple(warnings),
    )


def _compare_labels(change: Change, changed_points: ChangedPoints) -> str | None:
    letter = change.b.letter
    labels, skipped = compare_labels(change.a.run, change.b.run, partial(changed_points, letter))
    if labels is None:
        return "the runs have no cloud in common"
    change.labels = labels
    total, points_total = int(labels.changed.sum()), int(labels.points.sum())
    change.figures |= {
        "labels.changed": total,
        "labels.changed_share": total / points_total if points_total else float("nan"),
        "labels.changed_scan": int(labels.changed_scan.sum()),
        "labels.points": points_total,
        "labels.scans": len(labels.scan),
        **{f"labels.{name}": count for name, count in skipped.items()},
    }
    confusion = labels.counts.sum(axis=0)
    codes = most_frequent([confusion], TRANSITIONS)
    change.details["transitions"] = {
        name_transition(code): int(confusion.flat[code]) for code in codes
    }
    per_scan = {
        "scan": labels.scan,
        "stamp_ns": labels.stamp_ns,
        "points": labels.points,
        "changed": labels.changed,
        "changed_label_scan": labels.changed_scan,
    }
    if labels.judged is not None:
        right, wrong = (labels.judged[:, :, kind] for kind in (Became.RIGHT, Became.WRONG))
        change.figures["labels.became_right"] = int(right.sum())
        change.figures["labels.became_wrong"] = int(wrong.sum())
        per_scan |= {"became_right": right.sum(axis=1), "became_wrong": wrong.sum(axis=1)}
        change.details["became"] = {
            truth.name.lower(): {"right": int(right[:, truth].sum()), "wrong": int(own)}
            for truth in Truth
            if (own := wrong[:, truth].sum()) or right[:, truth].any()
        }
    spots = zip(("became_right", "became_wrong", "changed"), labels.spots, strict=True)
    change.details["spots"] = {name: asdict(spot) for name, spot in spots if spot is not None}
    values = zip(*(column.tolist() for column in per_scan.values()), strict=True)
    change.details["scans"] = [dict(zip(per_scan, row, strict=True)) for row in values]
    return None


def _compare_poses(change: Change, _: ChangedPoints) -> str | None:
    a, b = (read_tum(run.run.path / TRAJECTORY) for run in (change.a, change.b))
    stamp_ns, at_a, at_b = np.intersect1d(
        a.stamp_ns, b.stamp_ns, assume_unique=True, return_indices=True
    )
    if not len(stamp_ns):
        return "the runs have no pose in common"
    errors = compare_trajectories(
        Trajectory(stamp_ns, b.T_map_base[at_b]), Trajectory(stamp_ns, a.T_map_base[at_a])
    )
    change.poses = stamp_ns, errors.error_unaligned_m, errors.error_m
    change.figures |= {
        "trajectory.mean_m": float(errors.error_unaligned_m.mean()),
        "trajectory.max_m": float(errors.error_unaligned_m.max()),
        "trajectory.aligned_mean_m": float(errors.error_m.mean()),
        "trajectory.aligned_max_m": float(errors.error_m.max()),
        "trajectory.poses": len(stamp_ns),
    }
    return None


def _compare_walls(change: Change, _: ChangedPoints) -> None:
    a, b = (
        segments(read_features(run.run.path / WALLS, "lines", _ADVICE))
        for run in (change.a, change.b)
    )
    change.lost["walls"], change.gained["walls"] = unmatched_walls(a, b), unmatched_walls(b, a)
    change.figures |= {
        "walls.lost_m": float(lengths_m(change.lost["walls"]).sum()),
        "walls.gained_m": float(lengths_m(change.gained["walls"]).sum()),
        "walls.length_m": float(lengths_m(a).sum()),
    }


def _compare_doors(change: Change, _: ChangedPoints) -> None:
    a, b = (read_features(run.run.path / DOORS, "doors", _ADVICE) for run in (change.a, change.b))
    match = match_doors(segments(a), segments(b)).tolist()
    altered = [(b[j], _altered(a[i], b[j])) for i, j in enumerate(match) if j >= 0]
    change.doors = {
        "lost": [(a[i], f"lost: {_state(a[i])} door") for i, j in enumerate(match) if j < 0],
        "gained": [
            (door, f"gained: {_state(door)} door") for j, door in enumerate(b) if j not in match
        ],
        "altered": [(door, words) for door, words in altered if words],
    }
    change.figures |= {f"doors.{what}": len(doors) for what, doors in change.doors.items()}
    change.figures["doors.compared"] = len(a)
    change.details["doors"] = {
        what: [{**door, "what": words} for door, words in doors]
        for what, doors in change.doors.items()
    }


def _altered(a: Mapping[str, Any], b: Mapping[str, Any]) -> str:
    """Describe what differs between two doors that match."""
    parts = [f"{_state(a)} → {_state(b)}"] if _state(a) != _state(b) else []
    widths = a["properties"]["width"], b["properties"]["width"]
    if abs(widths[1] - widths[0]) >= _WIDTH_M:
        parts.append(f"width {widths[0]:.2f} → {widths[1]:.2f} m")
    return ", ".join(parts)


def _state(door: Mapping[str, Any]) -> str:
    return str(door["properties"]["state"])


def _compare_grids(change: Change, _: ChangedPoints) -> str | None:
    a, b = change.a.grid, change.b.grid
    assert a is not None
    assert b is not None
    try:
        change.lost["cells"], change.gained["cells"], figures = compare_grids(a, b)
    except ValueError as error:
        return str(error)
    change.figures |= {f"grid.{name}": count for name, count in figures.items()}
    return None


_SUBJECTS: dict[str, tuple[str, Callable[[Change, ChangedPoints], str | None]]] = {
    "labels": (LABELS, _compare_labels),
    "trajectory": (TRAJECTORY, _compare_poses),
    "walls": (WALLS, _compare_walls),
    "doors": (DOORS, _compare_doors),
    "grid": (map_file(entities.FURNITURE_FREE), _compare_grids),
}
"""The file that each comparison reads, and the comparison; it returns why it is impossible."""


def _settings(run: FinishedRun) -> dict[str, Any]:
    """Settings, and what else a run depends on."""
    return {
        **dotted_keys(run.record.settings),
        "bag": str(run.bag_path) if run.bag_path else None,
        "bag digest": run.record.bag.digest,
        "poses from": run.record.poses_from,
        **dotted_keys(run.record.as_json("options", "versions")),
    }


def _by_name(tables: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: [table.get(name) for table in tables] for name in names}
