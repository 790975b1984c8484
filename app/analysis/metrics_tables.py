"""What metrics.json says, as a person reads it: tables beside those of the paper, and one line."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.maps.area_graph import Segmented
from ffmap.app.analysis.map_figures import maps_table
from ffmap.app.folder.pictures import percent
from ffmap.app.tables import make_table

Metrics = dict[str, Any]

PAPER = {
    Label.CEILING: (0.8525, 0.9992, 0.9200),
    Label.FLOOR: (0.8955, 0.9985, 0.9442),
    Label.WALL: (0.9960, 0.9526, 0.9737),
    Label.DOOR: (0.8282, 0.8076, 0.8177),
}
"""Table II: precision, recall, F1 by area."""

PAPER_STATISTICS = {
    "milliseconds_per_cloud": (74, 26, 32, 187),
    "points_in_cloud": (96_058, 5_743, 60_130, 100_538),
    "points_in_lines": (40_595, 13_047, 14_885, 75_698),
}
"""Table I: mean, standard deviation, least, most."""
_SEGMENTED = {
    Segmented.FURNITURE_FREE: "furniture-free map",
    Segmented.NORMAL: "normal map, after alpha removal",
    Segmented.NORMAL_AS_IS: "normal map, furniture and all",
}


def print_metrics(metrics: Metrics) -> None:
    """`format_metrics` on the terminal."""
    console = Console()
    for table in format_metrics(metrics):
        console.print(table)
    for reason in metrics.get("missing", ()):
        console.print(f"not compared: {reason}", markup=False, highlight=False, soft_wrap=True)


def in_one_line(metrics: Metrics) -> str:
    """The figures that a person asks for first, and what could not be compared."""
    said = []
    if "area" in metrics:
        said.append(f"wall F1 {percent(metrics['area'][Label.WALL.name.lower()]['f1'])} %")
    if (doors := metrics.get("doors")) is not None:
        others = f" ({doors['true'] - doors['passed']} more not passed)" if doors["true"] > doors["passed"] else ""
        said.append(f"{doors['found_count']} of {doors['passed']} doors found{others}, {doors['invented_count']} invented")
    if (rooms := metrics.get("rooms")) is not None:
        recalled = f", recalled to {percent(rooms['recall'])} %" if rooms["entered"] else ""
        said.append(f"{rooms['entered']} of {rooms['true']} rooms entered{recalled}")
    if (trajectory := metrics.get("trajectory")) is not None:
        said.append(f"poses off by {_centimetres(trajectory['ate_rmse_m'])}")
    said += [f"not compared: {reason}" for reason in metrics.get("missing", ())]
    return ", ".join(said) or "nothing could be compared with the truth"


def format_metrics(metrics: Metrics) -> list[Table]:
    """The labels beside the paper's Table II, the statistics beside its Table I, then maps, rooms, doors and trajectory."""
    tables = []
    headings: tuple[str, ...]
    if "area" in metrics:
        headings = ("label", "precision", "recall", "F1", "paper: precision", "recall", "F1", "single scans: F1")
        tables.append(make_table("Labels by area (Table II)", headings, _label_rows(metrics)))
    if "statistics" in metrics:
        headings = ("", "mean", "std", "min", "max")
        tables.append(make_table("Statistics (Table I)", headings, _statistics_rows(metrics["statistics"])))
    if "maps" in metrics:
        tables.append(maps_table(metrics["maps"], "Grid maps against the truth (Fig. 9)"))
    if "rooms_of_maps" in metrics:
        headings = ("rooms of", "found", "recall of those entered %", "precision %", "split", "merged")
        rooms = _rows_of_maps(metrics["rooms_of_maps"])
        tables.append(make_table("Rooms of maps against the truth (Fig. 10)", headings, rooms))
    if rows := list(_other_rows(metrics)):
        title = "Doors, map, rooms, trajectory"
        tables.append(make_table(title, ("", ""), rows, left=(0, 1), show_header=False))
    return tables


def _label_rows(metrics: Metrics) -> Iterator[list[str]]:
    for label in (Label.CEILING, Label.FLOOR, Label.WALL, Label.DOOR, Label.CLUTTER, Label.OUTSIDE):
        name = label.name.lower()
        own = [metrics["area"][name][figure] for figure in ("precision", "recall", "f1")]
        figures = (*own, *PAPER.get(label, (None, None, None)), metrics["area_scan"][name]["f1"])
        yield [name, *map(percent, figures)]


def _statistics_rows(statistics: Metrics) -> Iterator[list[str]]:
    for name, paper in PAPER_STATISTICS.items():
        digits = 1 if name.startswith("milliseconds") else 0
        own = [statistics[name][figure] for figure in ("mean", "standard_deviation", "min", "max")]
        yield [name.replace("_", " "), *(f"{figure:,.{digits}f}" for figure in own)]
        yield ["  in the paper", *(f"{figure:,}" for figure in paper)]


def _rows_of_maps(rooms_of_maps: Metrics) -> Iterator[list[str]]:
    for name, rooms in rooms_of_maps.items():
        found = [str(rooms["found"]), percent(rooms["recall"]), percent(rooms["precision"])]
        yield [_SEGMENTED[Segmented(name)], *found, str(len(rooms["split"])), str(len(rooms["merged"]))]


def _other_rows(metrics: Metrics) -> Iterator[tuple[str, str]]:
    if (doors := metrics.get("doors")) is not None:
        passed = f"{doors['found_count']} of {doors['passed']} passed, {percent(doors['found'])} %"
        yield "doors found", f"{passed} ({doors['true']} true doors)"
        invented = f"{doors['invented_count']} of {doors['detections']}, {percent(doors['invented'])} %"
        yield "doors invented", invented
        yield "width error, mean", _centimetres(doors["width_error_m"])
        yield "state right", f"{percent(doors['state_right'])} %"
    if "area" in metrics:
        yield "outside kept as structure", f"{percent(metrics['area']['outside_kept_as_structure'])} %"
    if (rooms := metrics.get("rooms")) is not None:
        entered = f"({rooms['entered']} of {rooms['true']} true rooms)"
        yield "rooms entered, recall", f"{percent(rooms['recall'])} % {entered}"
        yield "rooms found, precision", f"{percent(rooms['precision'])} % ({rooms['found']} rooms)"
        yield "rooms split", ", ".join(rooms["split"]) or "none"
        yield "rooms merged", ", ".join(" and ".join(pair) for pair in rooms["merged"]) or "none"
    if (trajectory := metrics.get("trajectory")) is not None:
        rotation = trajectory["rotation_rmse_deg"]
        yield "trajectory, ATE RMSE", _centimetres(trajectory["ate_rmse_m"])
        yield "trajectory, unaligned RMSE", _centimetres(trajectory["unaligned_rmse_m"])
        yield "trajectory, rotation RMSE", "–" if rotation is None else f"{rotation:.2f}°"
        yield "trajectory, error in 1 m", _centimetres(trajectory["relative_translation_rmse_m"])


def _centimetres(metres: float | None) -> str:
    return "–" if metres is None or np.isnan(metres) else f"{100 * metres:.1f} cm"
