"""The names by which runs are compared: each setting, metric, count and time has one, short and fit for a query.

The same names are columns of `ffmap runs`, of sweep.csv (which has some more), and what --objective, --where and
--sort take: a metric's path in metrics.json joined by underscores, by area without saying so (`wall_f1`, `doors_found`,
`trajectory_ate_rmse_m`); a setting as --set takes it (`wall_planes.similarity_m`); a count (`doors`); `seconds`, what the run took.
"""

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

from ffmap.algorithms.base.labels import Label
from ffmap.loaders.errors import InputError

SECONDS = "seconds"
CPU_SECONDS = "cpu_seconds"
"""What a run on one thread kept a core busy for: unlike `seconds` it does not depend on what else went on."""
QUALITY = "wall_f1"
"""What runs are ranked by where nobody says."""

HEADLINES = (
    *("wall_f1", SECONDS, "ceiling_f1", "floor_f1", "door_f1", "clutter_f1", "doors_found", "doors_invented"),
    *("wall_map_recall", "trajectory_ate_rmse_m", "walls", "doors"),
)
"""The figures that a table shows where nobody chooses; those that no run has are left out."""

_WITHOUT_TRUTH = {SECONDS, CPU_SECONDS, "labelling_s_per_scan", "walls", "doors"}
OBJECTIVES = (
    _WITHOUT_TRUTH
    | {f"{label.name.lower()}_{figure}" for label in Label for figure in ("precision", "recall", "f1")}
    | {"outside_kept_as_structure", "doors_found", "doors_invented", "doors_width_error_m", "doors_state_right"}
    | {"wall_map_precision", "wall_map_recall", "wall_map_error_m", "trajectory_ate_rmse_m"}
)
"""Figures of which one value is better than another."""

_NOT_QUERIED = {
    *("missing", "points", "points_scan", "maps", "statistics", "by_room", "confusion"),
    # What precision and recall are made from.
    *("right_m2", "wrong_m2", "missed_m2"),
}
"""What metrics.json alone has: areas count, not points; the run's own map does, under wall_map; names of rooms are no figures."""

_RENAMED = {
    "timings_s_total": SECONDS,
    "timings_s_cpu": CPU_SECONDS,
    "timings_s_labelling_per_scan": "labelling_s_per_scan",
}
_LESS_IS_BETTER = re.compile(
    r"error|rmse|bias|invented|outside_kept|wrong|missed|skipped|milliseconds|_s$|_s_|seconds$"
)


def flatten(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by the names of their columns; values that are None are left out."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}".replace(".", "_")
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{name}_")
        elif value is not None:
            flat[name] = value if isinstance(value, str | bool | int | float) else str(value)
    return flat


def queried(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metrics that become properties of a recording."""
    return {
        name: queried(value) if isinstance(value, Mapping) else value
        for name, value in metrics.items()
        if name not in _NOT_QUERIED
    }


def figures_of(record: Mapping[str, Any], metrics: Mapping[str, Any] | None) -> dict[str, float]:
    """Every number that a run's run.json and metrics.json say of its results, by name."""
    result = flatten({name: record.get(name, {}) for name in ("timings_s", "counts")})
    named = {_RENAMED.get(name, name.removeprefix("counts_")): value for name, value in result.items()}
    named |= {name.removeprefix("area_"): value for name, value in flatten(metrics or {}).items()}
    return {
        name: float(value)
        for name, value in named.items()
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    }


def less_is_better(name: str) -> bool:
    """Whether a figure is an error or a time."""
    return _LESS_IS_BETTER.search(name) is not None


def check_objective(name: str, with_truth: bool) -> None:
    """Raises InputError where runs cannot be ranked by a figure of this name."""
    if name not in OBJECTIVES:
        close = difflib.get_close_matches(name, OBJECTIVES, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise InputError(
            f"--objective: there is no figure {name!r}; {hint}choose among {', '.join(sorted(OBJECTIVES))}"
        )
    if not with_truth and name not in _WITHOUT_TRUTH:
        known = ", ".join(sorted(_WITHOUT_TRUTH))
        raise InputError(f"--objective {name}: it needs the truth, which a bag does not carry; choose among {known}")


def short_names(settings: Iterable[str]) -> dict[str, str]:
    """Headings for settings by their names: the part after the step where that is enough to tell them apart."""
    names = list(settings)
    last = [name.rpartition(".")[2] for name in names]
    return {name: short if last.count(short) == 1 else name for name, short in zip(names, last, strict=True)}


def format_value(value: object) -> str:
    """A value in a table: numbers with four digits that count, nothing where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float) and not value.is_integer():
        return f"{value:.4g}"
    return f"{value:.0f}" if isinstance(value, float) else str(value)


def fit(widths: Mapping[str, int], room: int, least: int = 0) -> list[str]:
    """As many columns, from the first on, as there is room for with their edges; `least` whatever the room."""
    shown: list[str] = []
    for name, width in widths.items():
        room -= width + 3
        if room < 0 and len(shown) >= least:
            break
        shown.append(name)
    return shown
