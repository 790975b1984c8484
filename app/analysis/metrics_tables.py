"""Figures of a run in tables and in one line."""

from collections.abc import Mapping, Sequence

from rich.console import Console
from rich.table import Table

from ffmap.app.analysis.figures import (
    FIGURES,
    LABELS,
    MAPS,
    OF_LABEL,
    OF_MAP,
    OF_ROOMS,
    OF_STATISTIC,
    ROOM_MAPS,
    STATISTICS,
    Figure,
    Metrics,
)
from ffmap.app.tables import make_table

_OF_MAPS_SHOWN = ("precision", "recall", "error_m", "doors_passed", "doors_blocked")
_MATRICES = (
    ("Labels by area (Table II)", "{}", LABELS, OF_LABEL),
    ("Labels of single scans by area", "single_scan.{}", LABELS, OF_LABEL),
    ("Statistics (Table I)", "{}", STATISTICS, OF_STATISTIC),
    (
        "Grid maps against the ground truth (Fig. 9)",
        "maps.{}",
        MAPS,
        {name: own for name, own in OF_MAP.items() if name in _OF_MAPS_SHOWN},
    ),
    (
        "Rooms of maps against the ground truth (Fig. 10)",
        "rooms.{}",
        ROOM_MAPS,
        {name: own for name, own in OF_ROOMS.items() if name not in ("true", "recall_of_all")},
    ),
)
"""Tables of figures: title, path of a row, rows and columns."""
_LISTED = ("doors.", "outside_kept", "trajectory.", "scans.")
"""Beginnings of the names of figures that are listed one by one."""


def print_metrics(metrics: Metrics) -> None:
    """Print `format_metrics` on the terminal."""
    console = Console()
    for table in format_metrics(metrics):
        console.print(table)
    for reason in metrics.get("missing", ()):
        console.print(f"not compared: {reason}", markup=False, highlight=False, soft_wrap=True)


def format_metrics(metrics: Metrics) -> list[Table]:
    """Tabulate the figures beside those of the paper."""
    tables = [table for own in _MATRICES if (table := _matrix(metrics, *own)) is not None]
    listed = [
        (figure.title, f"{figure.text(metrics[name])} {figure.unit}".strip())
        for name, figure in FIGURES.items()
        if name in metrics and name.startswith(_LISTED)
    ]
    if listed:
        title = "Doors, trajectory, scans"
        tables.append(make_table(title, ("", ""), listed, left=(0,), show_header=False))
    return tables


def _matrix(
    metrics: Metrics, title: str, path: str, rows: Sequence[str], columns: Mapping[str, Figure]
) -> Table | None:
    """Tabulate the figures of the rows that the metrics have; None if there are none."""
    lines: list[list[str]] = []
    for row in rows:
        names = [f"{path.format(row)}.{column}" for column in columns]
        if not any(name in metrics for name in names):
            continue
        described = [FIGURES[name] for name in names]
        values = [own.text(metrics.get(name)) for name, own in zip(names, described, strict=True)]
        lines.append([row.replace("_", " "), *values])
        if any(own.paper is not None for own in described):
            lines.append(["  in the paper", *(own.text(own.paper) for own in described)])
    if not lines:
        return None
    table = make_table(title, ("", *(own.heading for own in columns.values())), lines)
    # On a narrow terminal names are folded between words.
    table.columns[0].min_width = max(len(word) for line in lines for word in line[0].split())
    return table


def in_one_line(metrics: Metrics) -> str:
    """Summarize the main figures and what could not be compared."""
    parts = []
    if "wall.f1" in metrics:
        parts.append(f"wall F1 {FIGURES['wall.f1'].text(metrics['wall.f1'])} %")
    if "doors.passed" in metrics:
        true, passed, found, invented = (
            metrics[f"doors.{name}"] for name in ("true", "passed", "found_count", "invented_count")
        )
        others = f" ({true - passed} more not passed)" if true > passed else ""
        parts.append(f"{found} of {passed} doors found{others}, {invented} invented")
    if "rooms.furniture_free.true" in metrics:
        true, entered, recall = (
            metrics[f"rooms.furniture_free.{name}"] for name in ("true", "entered", "recall")
        )
        recalled = f", recalled to {100 * recall:.2f} %" if entered else ""
        parts.append(f"{entered} of {true} rooms entered{recalled}")
    if "trajectory.ate_rmse_m" in metrics:
        parts.append(f"poses off by {100 * metrics['trajectory.ate_rmse_m']:.1f} cm")
    parts += [f"not compared: {reason}" for reason in metrics.get("missing", ())]
    return ", ".join(parts) or "nothing could be compared with the ground truth"
