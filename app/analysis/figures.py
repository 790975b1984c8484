"""Figures of runs: functions that compute them as flat dicts, and one table that describes them.

`evaluate`, `compare`, `sweep`, `runs` and the recording iterate over `FIGURES`. To add a figure,
return it from a function below and describe it in the table. Values are fractions, metres, degrees
and seconds; a NaN has nothing to divide by.
"""

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.app.folder.names import METRICS
from ffmap.app.folder.record import RunRecord
from ffmap.loaders.errors import InputError, shortened
from ffmap.loaders.text_files import dotted_keys, read_object

if TYPE_CHECKING:  # `ffmap runs` needs none of the compiled code behind these
    from ffmap.algorithms.base.scan import IntArray
    from ffmap.algorithms.base.votes import VoxelVotes
    from ffmap.algorithms.truth.doors import DoorComparison
    from ffmap.algorithms.truth.maps import ComparedMap
    from ffmap.algorithms.truth.poses import TrajectoryErrors
    from ffmap.algorithms.truth.rooms import RoomFigures
    from ffmap.algorithms.truth.tally import Tally

Metrics = dict[str, Any]
"""Content of metrics.json: figures by name, and some details that are lists, dicts or text."""

_UNITS: dict[str, tuple[int, str, float | None]] = {
    "": (1, ",.0f", 0.0),
    "%": (100, ".2f", 0.001),
    "cm": (100, ".2f", 0.001),
    "m": (1, ",.2f", 0.1),
    "m²": (1, ",.2f", 0.1),
    "°": (1, ".3f", 0.01),
    "s": (1, ".1f", None),
    "ms": (1, ".1f", None),
}
"""Units in which figures are shown: factor from the stored value, format, and tolerance.

Stored values that differ by the tolerance or less are alike: settings that should not matter, like
the number of returns in the odometry, change them as much (docs/usage.md).
"""


@dataclass(frozen=True)
class Figure:
    """Description of a figure. paper: the value in the paper."""

    title: str
    unit: str = ""
    better: Literal["higher", "lower", "neither"] = "neither"
    paper: float | None = None

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} {self.unit}".strip()

    @property
    def arrow(self) -> str:
        """↑ if higher is better, ↓ if lower is better."""
        return {"higher": "↑", "lower": "↓", "neither": ""}[self.better]

    def gain(self, first: float | None, second: float | None) -> float | None:
        """Return how much better the second value is, 0 within the tolerance.

        None if either is unknown, if no direction is better, or for times, which depend on caches
        and on the load of the machine.
        """
        tolerance = _UNITS[self.unit][2]
        if first is None or second is None or self.better == "neither" or tolerance is None:
            return None
        gain = second - first if self.better == "higher" else first - second
        return gain if abs(gain) > tolerance + 1e-9 else 0.0

    def text(self, value: float | None) -> str:
        """Format a value in the figure's unit."""
        factor, form, _ = _UNITS[self.unit]
        return "–" if value is None or math.isnan(value) else format(factor * value, form)

    def difference(self, first: float | None, second: float | None) -> str:
        """Format how much the second value is above the first."""
        if first is None or second is None:
            return "–"
        if math.isclose(first, second, rel_tol=1e-9):  # sums in another order
            return "="
        factor, form, _ = _UNITS[self.unit]
        difference = factor * (second - first)
        text = format(difference, f"+{form}")
        return text if any(digit in text for digit in "123456789") else f"{difference:+.0e}"


LABELS = ("ceiling", "floor", "wall", "door", "clutter", "outside")
MAPS = ("furniture_free", "below_ceiling", "middle", "upmost", "bottommost")
ROOM_MAPS = ("furniture_free", "normal", "normal_without_alpha_removal")
STATISTICS = ("milliseconds_per_cloud", "points_in_cloud", "points_in_lines")
LABELS_BY = {
    "": "",
    "single_scan.": ", single scans",
    "points.": ", by points",
    "points.single_scan.": ", single scans, by points",
}
"""Which labels are compared: final ones by area, those of single scans, and the same by points."""

OF_LABEL = {
    "precision": Figure("precision", "%", "higher"),
    "recall": Figure("recall", "%", "higher"),
    "f1": Figure("F1", "%", "higher"),
}
OF_MAP = {
    "precision": Figure("precision", "%", "higher"),
    "recall": Figure("recall", "%", "higher"),
    "error_m": Figure("error", "cm", "lower"),
    "true_cells": Figure("true cells"),
    "occupied_cells": Figure("occupied cells"),
    "false_cells": Figure("false cells", "", "lower"),
    "false_cells_of_cabinets": Figure("false cells on cabinets"),
    "precision_without_cabinets": Figure("precision without cabinets", "%", "higher"),
    "doors_passed": Figure("doors passed"),
    "doors_blocked": Figure("doors blocked", "", "lower"),
    "blocked": Figure("doors blocked", "%", "lower"),
}
OF_ROOMS = {
    "true": Figure("true rooms"),
    "entered": Figure("entered"),
    "found": Figure("found"),
    "recall": Figure("recall", "%", "higher"),
    "precision": Figure("precision", "%", "higher"),
    "recall_of_all": Figure("recall of all", "%", "higher"),
    "split": Figure("split", "", "lower"),
    "merged": Figure("merged", "", "lower"),
}
OF_STATISTIC = {
    "mean": Figure("mean"),
    "standard_deviation": Figure("std"),
    "min": Figure("min"),
    "max": Figure("max"),
}
_PAPER = {
    "ceiling": (0.8525, 0.9992, 0.9200),
    "floor": (0.8955, 0.9985, 0.9442),
    "wall": (0.9960, 0.9526, 0.9737),
    "door": (0.8282, 0.8076, 0.8177),
    "milliseconds_per_cloud": (74, 26, 32, 187),
    "points_in_cloud": (96_058, 5_743, 60_130, 100_538),
    "points_in_lines": (40_595, 13_047, 14_885, 75_698),
}
"""Values of the paper's Tables I and II."""


def _of_each(
    rows: Sequence[str], columns: Mapping[str, Figure], path: str = "{}", suffix: str = ""
) -> dict[str, Figure]:
    """Describe each column of each row of a table."""
    found = {}
    for row in rows:
        paper = dict(zip(columns, _PAPER.get(row, ()) if path == "{}" else (), strict=False))
        for name, figure in columns.items():
            title = f"{path.format(row)} {figure.title}{suffix}".replace("_", " ").replace(".", " ")
            title = title.replace("maps furniture free", "map").replace("furniture free ", "")
            unit = "ms" if row.startswith("milliseconds") else figure.unit
            own = replace(figure, title=title, unit=unit, paper=paper.get(name))
            found[f"{path.format(row)}.{name}"] = own
    return found


def _counts(by: str) -> dict[str, Figure]:
    """Describe right, wrong and missed labels, in points or by area."""
    names = ("right", "wrong", "missed")
    if by.startswith("points"):
        return {name: Figure(name) for name in names}
    return {f"{name}_m2": Figure(name, "m²") for name in names}


FIGURES: dict[str, Figure] = {
    "seconds": Figure("run time", "s", "lower"),
    "cpu_seconds": Figure("run time on one core", "s", "lower"),
    "labelling_s_per_scan": Figure("labelling of a scan", "s", "lower"),
    "scans": Figure("scans labelled"),
    "walls": Figure("wall faces"),
    "doors": Figure("doors"),
    "rooms": Figure("rooms"),
    **{
        name: own
        for by, suffix in LABELS_BY.items()
        for name, own in _of_each(LABELS, OF_LABEL | _counts(by), by + "{}", suffix).items()
    },
    **{
        f"{by}outside_kept": Figure(f"outside kept as structure{suffix}", "%", "lower")
        for by, suffix in LABELS_BY.items()
    },
    "doors.true": Figure("true doors"),
    "doors.passed": Figure("true doors passed"),
    "doors.found_count": Figure("doors found", "", "higher"),
    "doors.recall": Figure("doors recall", "%", "higher"),
    "doors.detections": Figure("doors detected"),
    "doors.invented_count": Figure("doors invented", "", "lower"),
    "doors.invented": Figure("share of doors invented", "%", "lower"),
    "doors.width_error_m": Figure("door width error", "cm", "lower"),
    "doors.width_bias_m": Figure("door width bias", "cm"),
    "doors.state_right": Figure("door state right", "%", "higher"),
    **_of_each(MAPS, OF_MAP, "maps.{}"),
    **_of_each(ROOM_MAPS, OF_ROOMS, "rooms.{}"),
    "trajectory.poses": Figure("poses"),
    "trajectory.ate_rmse_m": Figure("ATE RMSE", "cm", "lower"),
    "trajectory.ate_mean_m": Figure("ATE mean", "cm", "lower"),
    "trajectory.ate_max_m": Figure("ATE max", "cm", "lower"),
    "trajectory.unaligned_rmse_m": Figure("unaligned RMSE", "cm", "lower"),
    "trajectory.unaligned_mean_m": Figure("unaligned mean", "cm", "lower"),
    "trajectory.unaligned_max_m": Figure("unaligned max", "cm", "lower"),
    "trajectory.rotation_rmse_deg": Figure("rotation RMSE", "°", "lower"),
    "trajectory.relative_translation_rmse_m": Figure("error in 1 m", "cm", "lower"),
    "trajectory.relative_rotation_rmse_deg": Figure("rotation error in 1 m", "°", "lower"),
    "scans.counted": Figure("scans evaluated"),
    "scans.skipped": Figure("scans skipped"),
    "scans.without_truth": Figure("scans without ground truth"),
    **_of_each(STATISTICS, OF_STATISTIC),
}
"""Every figure by its name."""
HEADLINES = (
    "wall.f1",
    "doors.found_count",
    "doors.invented_count",
    "floor.f1",
    "ceiling.f1",
    "door.f1",
    "clutter.f1",
    "outside_kept",
    "maps.furniture_free.recall",
    "maps.furniture_free.precision",
    "rooms.furniture_free.recall",
    "trajectory.ate_rmse_m",
    "seconds",
    "walls",
    "doors",
)
"""The figures that are shown by default, the most important one first."""
_TIMES = {"seconds": "total", "cpu_seconds": "cpu", "labelling_s_per_scan": "labelling_per_scan"}
"""Figures by the names of the times in run.json."""
WITHOUT_TRUTH = tuple(_TIMES)
"""The figures with a better direction that need no ground truth."""


def read_figures(folder: Path, record: RunRecord) -> dict[str, float]:
    """Return all numbers of a run's run.json, which is `record`, and of its metrics.json by name.

    Raises InputError if metrics.json is damaged.
    """
    metrics = folder / METRICS
    times = dict(record.timings_s)
    found = {name: times.pop(key) for name, key in _TIMES.items() if key in times}
    found |= {f"seconds.{name}": value for name, value in times.items()}
    found |= dotted_keys(record.counts)
    if metrics.exists():
        found |= read_object(metrics, "'ffmap evaluate' makes it again")
    return {
        name: float(value)
        for name, value in found.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    }


def comparable(metrics: Mapping[str, Any]) -> dict[str, float]:
    """Return the figures that have a better direction."""
    return {
        name: metrics[name]
        for name, figure in FIGURES.items()
        if figure.better != "neither" and metrics.get(name) is not None
    }


def tally_figures(tally: "Tally", voxels: "VoxelVotes") -> Metrics:
    """Compute the figures of final labels and of single scans, by area and by points."""
    from ffmap.algorithms.truth.tally import VOXEL_M, confusion_by_area

    metrics: Metrics = {
        "scans.counted": tally.scans,
        "scans.skipped": tally.skipped,
        "scans.without_truth": tally.without_truth,
    }
    for by, confusion, unit in (
        ("", confusion_by_area(voxels), VOXEL_M**2),
        ("single_scan.", confusion_by_area(voxels, single_scans=True), VOXEL_M**2),
        ("points.", tally.confusion_points[0], 1),
        ("points.single_scan.", tally.confusion_points[1], 1),
    ):
        metrics |= label_figures(by, confusion, unit)
    return metrics


def label_figures(by: str, confusion: "IntArray", unit: float) -> Metrics:
    """Compute precision, recall and F1 of every label (eq. 3), and what they are computed from.

    Args:
        by: a key of `LABELS_BY`.
        confusion: (11, 7) by `Truth` and `Label`.
        unit: area (m²) of a voxel, or 1 for a point.
    """
    from ffmap.algorithms.truth.labels import outside_kept, right_wrong_missed

    metrics: Metrics = {}
    for label, row in zip(Label, right_wrong_missed(confusion).tolist(), strict=True):
        (right, wrong, missed), name = row, f"{by}{label.name.lower()}"
        metrics[f"{name}.precision"] = _ratio(right, right + wrong)
        metrics[f"{name}.recall"] = _ratio(right, right + missed)
        metrics[f"{name}.f1"] = _ratio(2 * right, 2 * right + wrong + missed)
        for column, count in zip(_counts(by), row, strict=True):
            metrics[f"{name}.{column}"] = round(count * unit, 4)
    metrics[f"{by}outside_kept"] = _ratio(*outside_kept(confusion))
    metrics[f"{by}confusion"] = {
        "truth": [truth.name.lower() for truth in Truth],
        "label": [*(label.name.lower() for label in Label), "unlabelled"],
        "counts": confusion.tolist(),
    }
    return metrics


def door_figures(doors: "DoorComparison") -> Metrics:
    """Count doors found and invented; measure those that were found."""
    passed, found = int(doors.passed.sum()), int((doors.passed & (doors.match >= 0)).sum())
    invented = doors.detections - int((doors.match >= 0).sum())
    return {
        "doors.true": len(doors.match),
        "doors.passed": passed,
        "doors.found_count": found,
        "doors.recall": _ratio(found, passed),
        "doors.detections": doors.detections,
        "doors.invented_count": invented,
        "doors.invented": _ratio(invented, doors.detections),
        "doors.width_error_m": _mean(np.abs(doors.width_error_m)),
        "doors.width_bias_m": _mean(doors.width_error_m),
        "doors.state_right": _mean(doors.state_right),
    }


def map_figures(name: str, one: "ComparedMap") -> Metrics:
    """Compute the figures of a grid map (Fig. 9)."""
    occupied, right = len(one.occupied), int(one.right.sum())
    figures = {
        "precision": one.precision,
        "recall": one.recall,
        "error_m": one.error_m,
        "true_cells": len(one.true_cells),
        "occupied_cells": occupied,
        "false_cells": occupied - right,
        "false_cells_of_cabinets": one.cabinets,
        "precision_without_cabinets": _ratio(right, occupied - one.cabinets),
        "doors_passed": len(one.blocked),
        "doors_blocked": int(one.blocked.sum()),
        "blocked": _mean(one.blocked),
    }
    return {f"maps.{name}.{figure}": value for figure, value in figures.items()}


def figures_of_rooms(rooms: "RoomFigures") -> Metrics:
    """Compute the figures of the rooms of a map (Fig. 10), by the names of `OF_ROOMS`."""
    return {
        "true": len(rooms.recall),
        "entered": int(rooms.counted.sum()),
        "found": len(rooms.precision),
        "recall": rooms.mean_recall,
        "recall_of_all": _mean(rooms.recall),
        "precision": rooms.mean_precision,
        "split": len(rooms.split),
        "merged": len(rooms.merged),
    }


def room_figures(name: str, rooms: "RoomFigures", names: Sequence[str]) -> Metrics:
    """Compute the figures of a run's rooms in a map. names: of the true rooms."""
    figures = figures_of_rooms(rooms) | {
        "split_rooms": [names[room] for room in rooms.split],
        "merged_rooms": [[names[room] for room in pair] for pair in rooms.merged],
        "recall_by_room": dict(zip(names, rooms.recall.tolist(), strict=True)),
    }
    return {f"rooms.{name}.{figure}": value for figure, value in figures.items()}


def trajectory_figures(errors: "TrajectoryErrors") -> Metrics:
    """Compute the errors of a trajectory; of at least one pose."""
    metrics: Metrics = {"trajectory.poses": len(errors.error_m)}
    for name, error_m in (("ate", errors.error_m), ("unaligned", errors.error_unaligned_m)):
        metrics[f"trajectory.{name}_rmse_m"] = _rms(error_m)
        metrics[f"trajectory.{name}_mean_m"] = _mean(error_m)
        metrics[f"trajectory.{name}_max_m"] = float(error_m.max())
    return metrics | {
        "trajectory.rotation_rmse_deg": _rms(errors.rotation_error_deg),
        "trajectory.relative_translation_rmse_m": _rms(errors.relative_translation_m),
        "trajectory.relative_rotation_rmse_deg": _rms(errors.relative_rotation_deg),
    }


def find_name(name: str, known: Iterable[str], option: str, advice: str) -> str:
    """Return the known name; underscores match dots.

    Raises InputError that suggests the most similar name.
    """
    by_name = {own.replace(".", "_"): own for own in known}
    if (found := by_name.get(name.replace(".", "_"))) is not None:
        return found
    close = difflib.get_close_matches(name.replace(".", "_"), by_name, n=1, cutoff=0.5)
    meant = f"did you mean {by_name[close[0]]!r}? " if close else ""
    raise InputError(f"{option}: no figure or setting {shortened(name)!r}; {meant}{advice}")


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")


def _mean(values: np.ndarray[Any, Any]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _rms(values: np.ndarray[Any, Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
