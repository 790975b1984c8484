"""A run's grid maps against the ground truth: figures, and a table of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import main_direction_deg
from ffmap.algorithms.maps.grid import GridMap
from ffmap.algorithms.truth.maps import ComparedMap, ComparedMaps
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import WALLS, map_file
from ffmap.app.folder.pictures import MAP_TITLES, percent
from ffmap.app.tables import make_table
from ffmap.loaders.geojson import read_features, segments

_DEFAULT_WALL_M = 0.2


def read_maps(run_dir: Path) -> dict[str, GridMap]:
    """The maps that a run folder holds, by name."""
    return {str(name): read_map(run_dir / map_file(name)) for name in MAP_TITLES if (run_dir / map_file(name)).exists()}


def wall_thickness_of_doors(building: Mapping[str, Any]) -> FloatArray:
    """(D,) how thick the wall of each door of the truth's GeoJSON is."""
    doors = [f["properties"] for f in building["features"] if f["properties"]["kind"] == "door"]
    return np.array([float(door.get("wall_thickness", _DEFAULT_WALL_M)) for door in doors])


def map_metrics(compared: ComparedMaps) -> dict[str, Any]:
    """Figures by map as fractions and metres, for metrics.json."""
    return {name: _metrics(one) for name, one in compared.items()}


def _metrics(one: ComparedMap) -> dict[str, Any]:
    figures, right = one.figures, int(np.count_nonzero(one.figures.right))
    occupied = len(figures.occupied)
    metrics: dict[str, Any] = {
        "precision": figures.precision,
        "recall": figures.recall,
        "error_m": figures.error_m,
        "true_cells": len(figures.true_cells),
        "occupied_cells": occupied,
        "false_cells": occupied - right,
    }
    if one.cabinets is not None:
        counted = occupied - one.cabinets
        metrics["false_cells_of_cabinets"] = one.cabinets
        metrics["precision_without_cabinets"] = right / counted if counted else float("nan")
    if one.blocked is not None:
        metrics["doors_passed"] = len(one.blocked)
        metrics["doors_blocked"] = int(np.count_nonzero(one.blocked))
        metrics["blocked"] = float(one.blocked.mean()) if len(one.blocked) else float("nan")
    return metrics


def maps_table(metrics: Mapping[str, Any], title: str) -> Table:
    """What `map_metrics` says, one line a map."""
    with_doors = any("doors_blocked" in own for own in metrics.values())
    headings = ["map", "precision %", "recall %", "error cm"]
    headings += ["doors blocked", "no cabinets %"] if with_doors else []
    rows = []
    for name, own in metrics.items():
        row = [MAP_TITLES[name], *(percent(own[figure]) for figure in ("precision", "recall", "error_m"))]
        if with_doors:
            blocked = f"{own['doors_blocked']} of {own['doors_passed']}"
            row += [blocked, percent(own["precision_without_cabinets"])]
        rows.append(row)
    table = make_table(title, headings, rows, padding=(0, 1, 0, 0))
    # No name is cut where the terminal is narrow: they are folded between words, none of which is longer than this.
    table.columns[0].min_width = max(len(word) for name in metrics for word in MAP_TITLES[name].split())
    return table


def walls_direction_deg(run_dir: Path) -> float:
    """The direction of most walls that a run found, as its plan is turned by; 0 where it has no file of walls."""
    path = run_dir / WALLS
    return main_direction_deg(segments(read_features(path, "lines", "run ffmap again"))) if path.exists() else 0.0
