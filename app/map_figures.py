"""A run's grid maps against truth or a reference map: figures in one table, and a picture (paper, Fig. 9e)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.table import Table
from scipy.spatial import cKDTree

from algorithms.evaluation import WALL_TOLERANCE_M, Tally, WallMapFigures, compare_wall_map, majorities
from algorithms.grid_map import GridMap
from algorithms.labels import Truth
from algorithms.map_comparison import Agreement, blocked_doors, overlay
from algorithms.rival_maps import Rival
from algorithms.scan import BoolArray, FloatArray, UInt8Array
from app.files import write_atomically
from app.map_files import read_map
from app.run_folder import map_file
from blueprints import entities

TITLES = {
    entities.FURNITURE_FREE: "furniture-free",
    Rival.BELOW_CEILING: "slice below the ceiling",
    Rival.MIDDLE: "slice in the middle",
    Rival.UPMOST: "up-most structures",
    Rival.BOTTOMMOST: "bottom-most structures",
}
"""Every map of a run, the run's own first."""

_SCALE = 3
_GAP = 24
_TEXT_HEIGHT = 40
_DEFAULT_WALL_M = 0.2


@dataclass(frozen=True, eq=False)
class ComparedMap:
    """A map with its figures.

    unseen: (m, 2) walls of what it was compared with that count nowhere. blocked: which doors that were passed are
    blocked in it; None where no doors are known. cabinets: how many of its false cells are cabinets as high as the room.
    """

    grid: GridMap
    figures: WallMapFigures
    unseen: FloatArray
    blocked: BoolArray | None = None
    cabinets: int | None = None

    @property
    def agreement(self) -> UInt8Array:
        return overlay(self.grid, self.figures, self.unseen)


ComparedMaps = Mapping[str, ComparedMap]


def read_maps(run_dir: Path) -> dict[str, GridMap]:
    """The maps that a run folder holds, by name."""
    return {
        str(name): read_map(run_dir / map_file(name)) for name in TITLES if (run_dir / map_file(name)).exists()
    }


def compare_with_truth(
    maps: Mapping[str, GridMap], faces: FloatArray, tally: Tally, door_ends: FloatArray, wall_m: FloatArray
) -> ComparedMaps:
    """faces: (F, 2, 2) true walls. door_ends: (D, 2, 2) jambs of the doors passed; wall_m: (D,) how thick their walls are."""
    cubes = tally.cubes
    cabinets = cubes.mean_position[majorities(cubes)[0] == Truth.FULL_HEIGHT_CABINET, :2]
    compared = {}
    for name, grid in maps.items():
        figures = compare_wall_map(faces, cubes, grid)
        false = figures.occupied[~figures.right]
        near = cKDTree(cabinets).query(false)[0] <= WALL_TOLERANCE_M if len(cabinets) and len(false) else np.zeros(0)
        compared[name] = ComparedMap(
            grid, figures, np.zeros((0, 2)), blocked_doors(grid, door_ends, wall_m), int(np.count_nonzero(near))
        )
    return compared


def wall_thickness_of_doors(building: Mapping[str, Any]) -> FloatArray:
    """(D,) how thick the wall of each door of the truth's GeoJSON is."""
    doors = [f["properties"] for f in building["features"] if f["properties"]["kind"] == "door"]
    return np.array([float(door.get("wall_thickness", _DEFAULT_WALL_M)) for door in doors])


def map_metrics(compared: ComparedMaps) -> dict[str, Any]:
    """Figures by map as fractions and metres, for metrics.json."""
    metrics: dict[str, Any] = {}
    for name, one in compared.items():
        figures, false = one.figures, int(np.count_nonzero(~one.figures.right))
        metrics[name] = {
            "precision": figures.precision,
            "recall": figures.recall,
            "error_m": figures.error_m,
            "true_cells": len(figures.true_cells),
            "occupied_cells": len(figures.occupied),
            "false_cells": false,
        }
        if one.cabinets is not None:
            counted = len(figures.occupied) - one.cabinets
            right = len(figures.occupied) - false
            metrics[name] |= {
                "false_cells_of_cabinets": one.cabinets,
                "precision_without_cabinets": right / counted if counted else float("nan"),
            }
        if one.blocked is not None:
            blocked = int(np.count_nonzero(one.blocked))
            metrics[name] |= {
                "doors_passed": len(one.blocked),
                "doors_blocked": blocked,
                "blocked": blocked / len(one.blocked) if len(one.blocked) else float("nan"),
            }
    return metrics


def maps_table(metrics: Mapping[str, Any], title: str) -> Table:
    """What `map_metrics` says, one line a map."""
    table = Table(title=title, title_justify="left", padding=(0, 1, 0, 0))
    with_doors = any("doors_blocked" in own for own in metrics.values())
    headings = ["map", "precision %", "recall %", "error cm"]
    headings += ["doors blocked", "no cabinets %"] if with_doors else []
    # No name is cut where the terminal is narrow: they are folded between words, none of which is longer than this.
    longest = max(len(word) for name in metrics for word in TITLES[name].split())
    for heading in headings:
        first = heading == "map"
        table.add_column(heading, justify="left" if first else "right", overflow="fold", min_width=longest if first else None)
    for name, own in metrics.items():
        row = [TITLES[name], _number(own["precision"], 100), _number(own["recall"], 100), _number(own["error_m"], 100)]
        if with_doors:
            row += [
                f"{own['doors_blocked']} of {own['doors_passed']}",
                _number(own["precision_without_cabinets"], 100),
            ]
        table.add_row(*row)
    return table


def write_overlays(path: Path, compared: ComparedMaps, compared_with: str) -> None:
    """One picture (PNG) of all maps side by side with what they are compared with laid over, and the legend.

    compared_with: "truth", or the reference's name.
    """
    # What a slice caught far outside, through windows, would make the pictures small: all show the first map's extent.
    first = next(iter(compared.values())).grid
    low, high = first.origin, first.origin + np.array(first.cells.shape[::-1]) * first.cell_m
    pictures = [
        _picture(one, TITLES[name], map_metrics({name: one})[name], low, high) for name, one in compared.items()
    ]
    legend = [
        (Agreement.BOTH, f"wall in the map and in {compared_with}"),
        (Agreement.ONLY_MAP, "wall only in the map"),
        (Agreement.ONLY_REFERENCE, f"wall only in {compared_with}"),
        (Agreement.NOT_SEEN, f"wall of {compared_with} that was not seen"),
        (Agreement.FREE, "free"),
        (Agreement.NOTHING, "unknown"),
    ]
    legend_width = max(int(_font().getlength(text)) for _, text in legend) + 60
    width = sum(p.width for p in pictures) + _GAP * (len(pictures) + 1) + legend_width
    height = max([p.height for p in pictures] + [30 * len(legend)]) + 2 * _GAP
    sheet = Image.new("RGB", (width, height), "white")
    x = _GAP
    for picture in pictures:
        sheet.paste(picture, (x, _GAP))
        x += picture.width + _GAP
    draw = ImageDraw.Draw(sheet)
    for row, (agreement, text) in enumerate(legend):
        y = _GAP + _TEXT_HEIGHT + 28 * row
        draw.rectangle((x, y, x + 18, y + 18), fill=entities.AGREEMENTS[agreement][1], outline=(90, 90, 90))
        draw.text((x + 28, y), text, fill="black", font=_font())

    write_atomically(path, lambda part: sheet.save(part, format="PNG"))


def _picture(
    one: ComparedMap, title: str, metrics: Mapping[str, Any], low: FloatArray, high: FloatArray
) -> Image.Image:
    """low, high: (2,) the corners of what is shown; it is unknown where the map does not reach."""
    columns, rows = np.round((high - low) / one.grid.cell_m).astype(int)
    agreement = np.full((rows, columns), Agreement.NOTHING, np.uint8)
    shift = np.round((one.grid.origin - low) / one.grid.cell_m).astype(int)
    whole = one.agreement
    left, bottom = np.maximum(shift, 0)
    right, top = np.minimum(shift + whole.shape[::-1], [columns, rows])
    if right > left and top > bottom:
        agreement[bottom:top, left:right] = whole[
            bottom - shift[1] : top - shift[1], left - shift[0] : right - shift[0]
        ]
    colours = np.array([entities.AGREEMENTS[a][1] for a in Agreement], np.uint8)
    drawn = Image.fromarray(np.ascontiguousarray(colours[agreement[::-1]]))
    drawn = drawn.resize((drawn.width * _SCALE, drawn.height * _SCALE), Image.Resampling.NEAREST)
    lines = [
        title,
        f"precision {_number(metrics['precision'], 100)} %, recall {_number(metrics['recall'], 100)} %, "
        f"error {_number(metrics['error_m'], 100)} cm",
    ]
    width = max([drawn.width, *(int(_font().getlength(line)) for line in lines)])
    picture = Image.new("RGB", (width, drawn.height + _TEXT_HEIGHT), "white")
    picture.paste(drawn, (0, _TEXT_HEIGHT))
    draw = ImageDraw.Draw(picture)
    for row, line in enumerate(lines):
        draw.text((0, 18 * row), line, fill="black", font=_font())
    return picture


def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(14)


def _number(value: float | None, scale: float) -> str:
    return "–" if value is None or np.isnan(value) else f"{scale * value:.2f}"


def false_and_missed(one: ComparedMap) -> Sequence[tuple[Agreement, FloatArray]]:
    """What an overlay draws over the map: each agreement with its places (m, 2)."""
    figures = one.figures
    return [
        (Agreement.NOT_SEEN, one.unseen),
        (Agreement.BOTH, figures.occupied[figures.right]),
        (Agreement.ONLY_REFERENCE, figures.true_cells[~figures.covered]),
        (Agreement.ONLY_MAP, figures.occupied[~figures.right]),
    ]
