"""A run's grid maps against truth or a reference map: figures in one table, and a picture (paper, Fig. 9e)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rich.table import Table

from ffmap.algorithms.base.scan import FloatArray, UInt8Array
from ffmap.algorithms.base.segments import main_direction_deg, turned
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.rivals import Rival
from ffmap.algorithms.truth.maps import WALL_TOLERANCE_M, Agreement, ComparedMap, ComparedMaps, WallMapFigures
from ffmap.app.folder.atomic import written_whole
from ffmap.app.folder.map_files import read_map
from ffmap.app.folder.names import WALLS, map_file
from ffmap.app.tables import make_table
from ffmap.blueprints import entities
from ffmap.loaders.geojson import read_features, segments

TITLES = {
    entities.FURNITURE_FREE: "furniture-free",
    Rival.BELOW_CEILING: "slice below the ceiling",
    Rival.MIDDLE: "slice in the middle",
    Rival.UPMOST: "up-most structures",
    Rival.BOTTOMMOST: "bottom-most structures",
}
"""Every map of a run, the run's own first."""

_MEANINGS = {
    Agreement.BOTH: "wall in the map and in the {}",
    Agreement.ONLY_MAP: "wall only in the map",
    Agreement.ONLY_REFERENCE: "wall only in the {}",
    Agreement.NOT_SEEN: "wall of the {} that was not seen",
    Agreement.FREE: "free",
    Agreement.NOTHING: "unknown",
}
_IN_FRONT = (
    *(Agreement.NOTHING, Agreement.FREE, Agreement.NOT_SEEN),
    *(Agreement.BOTH, Agreement.ONLY_REFERENCE, Agreement.ONLY_MAP),
)
"""What is seen of several cells that share a pixel: the last of these."""
_PICTURE_PX, _PICTURE_MAX_PX = 1200, 3000
_CELL_MIN_PX, _CELL_MAX_PX = 2.0, 8.0
"""No cell is lost when the map is turned, and none of a tiny map is blown up."""
_SHEET_SHAPE = 1.5
_GAP = 48
_ROWS_AT_ONCE = 64
_TITLE_PX, _TEXT_PX = 48, 36
_HEAD_PX = 120
_MARGIN_M = 0.5
_LINE = (90, 90, 90)
_BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_DEFAULT_WALL_M = 0.2


def read_maps(run_dir: Path) -> dict[str, GridMap]:
    """The maps that a run folder holds, by name."""
    return {str(name): read_map(run_dir / map_file(name)) for name in TITLES if (run_dir / map_file(name)).exists()}


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
        row = [TITLES[name], *(hundredfold(own[figure]) for figure in ("precision", "recall", "error_m"))]
        if with_doors:
            blocked = f"{own['doors_blocked']} of {own['doors_passed']}"
            row += [blocked, hundredfold(own["precision_without_cabinets"])]
        rows.append(row)
    table = make_table(title, headings, rows, padding=(0, 1, 0, 0))
    # No name is cut where the terminal is narrow: they are folded between words, none of which is longer than this.
    table.columns[0].min_width = max(len(word) for name in metrics for word in TITLES[name].split())
    return table


def walls_direction_deg(run_dir: Path) -> float:
    """The direction of most walls that a run found, as its plan is turned by; 0 where it has no file of walls."""
    path = run_dir / WALLS
    return main_direction_deg(segments(read_features(path, "lines", "run ffmap again"))) if path.exists() else 0.0


def write_overlays(path: Path, compared: ComparedMaps, compared_with: str, direction_deg: float) -> None:
    """One picture (PNG) of all maps with what they are compared with laid over, a scale bar and the legend.

    All maps are drawn at one scale, and show what the first one knows. compared_with: "truth", or "reference".
    direction_deg: of most walls, see `main_direction_deg`; they are drawn upright and level.
    """
    window = _Window.around(next(iter(compared.values())).grid, direction_deg)
    shown = {name: one.agreement for name, one in compared.items()}
    found = set(np.unique(np.concatenate([agreement.ravel() for agreement in shown.values()])).tolist())
    pictures = [
        _picture(window.draw(one.grid, shown[name]), TITLES[name], one.figures) for name, one in compared.items()
    ]
    pictures.append(_legend(compared_with, [agreement for agreement in _MEANINGS if agreement in found], window))
    width, height = (max(getattr(picture, side) for picture in pictures) for side in ("width", "height"))
    columns = _columns(len(pictures), width, height)
    rows = math.ceil(len(pictures) / columns)
    sheet = Image.new("RGB", (columns * (width + _GAP) + _GAP, rows * (height + _GAP) + _GAP), "white")
    for place, picture in enumerate(pictures):
        row, column = divmod(place, columns)
        sheet.paste(picture, (_GAP + column * (width + _GAP), _GAP + row * (height + _GAP)))
    with written_whole(path) as part:
        sheet.save(part, format="PNG")


@dataclass(frozen=True)
class _Window:
    """What each picture shows. low, high: (2,) its corners in metres, in the map's frame turned back by direction_deg."""

    low: FloatArray
    high: FloatArray
    direction_deg: float
    pixels_per_m: float

    @classmethod
    def around(cls, grid: GridMap, direction_deg: float) -> "_Window":
        """What a map knows, with a margin."""
        known = np.concatenate([grid.centres(cell) for cell in (Cell.FREE, Cell.OCCUPIED)])
        if not len(known):
            known = grid.origin[None]
        places = turned(known, -direction_deg)
        low, high = places.min(axis=0) - _MARGIN_M, places.max(axis=0) + _MARGIN_M
        cells = float((high - low).max()) / grid.cell_m
        pixels = np.clip(_PICTURE_PX, _CELL_MIN_PX * cells, _CELL_MAX_PX * cells)
        return cls(low, high, direction_deg, float(min(pixels, _PICTURE_MAX_PX)) / cells / grid.cell_m)

    def draw(self, grid: GridMap, agreement: UInt8Array) -> Image.Image:
        """An overlay in its colours; unknown where the map does not reach."""
        factor = math.ceil(_CELL_MIN_PX / (self.pixels_per_m * grid.cell_m) - 1e-9)
        agreement, cell_m = _coarsened(agreement, factor), factor * grid.cell_m
        width, height = np.ceil((self.high - self.low) * self.pixels_per_m).astype(int)
        x = self.low[0] + (np.arange(width) + 0.5) / self.pixels_per_m
        pixels = np.empty((height, width, 3), np.uint8)
        colours = np.array([entities.AGREEMENTS[a][1] for a in Agreement], np.uint8)
        for first in range(0, height, _ROWS_AT_ONCE):  # some rows at a time, for a large building's pixels are many
            rows = np.arange(first, min(first + _ROWS_AT_ONCE, height))
            y = self.high[1] - (rows + 0.5) / self.pixels_per_m
            places = turned(np.stack([np.tile(x, len(y)), np.repeat(y, width)], axis=1), self.direction_deg)
            index = np.floor((places - grid.origin) / cell_m).astype(int)
            inside = ((index >= 0) & (index < agreement.shape[::-1])).all(axis=1)
            shown = np.full(len(places), Agreement.NOTHING, np.uint8)
            shown[inside] = agreement[index[inside, 1], index[inside, 0]]
            pixels[rows] = colours[shown].reshape(len(rows), width, 3)
        return Image.fromarray(pixels)


def _coarsened(agreement: UInt8Array, factor: int) -> UInt8Array:
    """Cells larger by `factor`, each as that of the cells within it that must not be overlooked."""
    if factor <= 1:
        return agreement
    rank = np.argsort(_IN_FRONT).astype(np.uint8)
    rows, columns = agreement.shape
    padded = np.pad(rank[agreement], [(0, -rows % factor), (0, -columns % factor)])
    tiles = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
    return np.asarray(np.array(_IN_FRONT, np.uint8)[tiles.max(axis=(1, 3))])


def _columns(count: int, width: int, height: int) -> int:
    """The number of columns in which `count` pictures make a sheet of about the shape of a screen."""
    shapes = [columns * width / (math.ceil(count / columns) * height) for columns in range(1, count + 1)]
    return 1 + int(np.argmin([abs(math.log(shape / _SHEET_SHAPE)) for shape in shapes]))


def _picture(drawn: Image.Image, title: str, compared: WallMapFigures) -> Image.Image:
    precision, recall, error = map(hundredfold, (compared.precision, compared.recall, compared.error_m))
    figures = f"precision {precision} %   recall {recall} %   error {error} cm"
    width = max(drawn.width + 2, int(_font(_TEXT_PX).getlength(figures)) + 1)
    picture = Image.new("RGB", (width, drawn.height + 2 + _HEAD_PX), "white")
    draw = ImageDraw.Draw(picture)
    draw.text((0, 0), title, fill="black", font=_font(_TITLE_PX))
    draw.text((0, _TITLE_PX + 14), figures, fill="black", font=_font(_TEXT_PX))
    draw.rectangle((0, _HEAD_PX, drawn.width + 1, _HEAD_PX + drawn.height + 1), outline=_LINE)
    picture.paste(drawn, (1, _HEAD_PX + 1))
    return picture


def _legend(compared_with: str, agreements: Sequence[Agreement], window: _Window) -> Image.Image:
    """What the colours mean, and a scale bar of a round length."""
    lines = [_MEANINGS[agreement].format(compared_with) for agreement in agreements]
    title = f"Every map over the {compared_with}"
    rule = f"A wall is right within {100 * WALL_TOLERANCE_M:g} cm."
    row_px = _TEXT_PX + 22
    bar_m = max((m for m in _BARS_M if m * window.pixels_per_m <= _PICTURE_PX / 3), default=_BARS_M[0])
    bar_px = round(bar_m * window.pixels_per_m)
    texts_px = [_font(_TEXT_PX).getlength(line) + 2 * _TEXT_PX for line in [rule, *lines]]
    width_px = max(bar_px + 4 * _TEXT_PX, _font(_TITLE_PX).getlength(title), *texts_px)
    legend = Image.new("RGB", (int(width_px) + 1, _HEAD_PX + row_px * (len(lines) + 2)), "white")
    draw = ImageDraw.Draw(legend)
    draw.text((0, 0), title, fill="black", font=_font(_TITLE_PX))
    draw.text((0, _TITLE_PX + 14), rule, fill="black", font=_font(_TEXT_PX))
    for row, (agreement, line) in enumerate(zip(agreements, lines, strict=True)):
        y = _HEAD_PX + row_px * row
        draw.rectangle((0, y, _TEXT_PX, y + _TEXT_PX), fill=entities.AGREEMENTS[agreement][1], outline=_LINE)
        draw.text((_TEXT_PX + 20, y), line, fill="black", font=_font(_TEXT_PX))
    y = _HEAD_PX + row_px * len(lines) + _TEXT_PX
    draw.rectangle((0, y, bar_px - 1, y + 9), fill="black")
    draw.text((bar_px + 18, y - 0.4 * _TEXT_PX), f"{bar_m:g} m", fill="black", font=_font(_TEXT_PX))
    return legend


def _font(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size_px)


def hundredfold(value: float | None) -> str:
    """A fraction in percent, metres in centimetres."""
    return "–" if value is None or np.isnan(value) else f"{100 * value:.2f}"
