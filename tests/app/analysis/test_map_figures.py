"""Figures of grid maps in a table, and the picture that lays maps over the ground truth."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import Agreement, ComparedMap, WallMapFigures
from ffmap.app.analysis.map_figures import map_metrics, maps_table, walls_direction_deg
from ffmap.app.folder.atomic import write_geojson
from ffmap.app.folder.names import WALLS
from ffmap.app.folder.pictures import MAP_TITLES, coarsened, write_overlays
from ffmap.loaders.errors import InputError


def test_doors_and_cabinets_are_in_the_table(tmp_path):
    grid = GridMap(np.full((10, 10), Cell.FREE, np.uint8), np.zeros(2), 0.05)
    occupied = np.array([[0.1, 0.1], [0.2, 0.1], [0.3, 0.1], [0.4, 0.4]])
    figures = WallMapFigures(occupied, np.array([0.0, 0.02, 0.04, 0.3]), occupied[:2], np.array([True, False]))
    compared = {"furniture_free": ComparedMap(grid, figures, np.zeros((0, 2)), np.array([True, False, False]), 1)}
    own = map_metrics(compared)["furniture_free"]
    assert (own["precision"], own["recall"], own["error_m"]) == (0.75, 0.5, pytest.approx(0.02))
    assert (own["doors_passed"], own["doors_blocked"]) == (3, 1)
    assert (own["false_cells_of_cabinets"], own["precision_without_cabinets"]) == (1, 1.0)
    columns = [list(column.cells) for column in maps_table({"furniture_free": own}, "maps").columns]
    assert ["1 of 3"] in columns
    write_overlays(tmp_path / "overlay.png", compared, 0.0)
    with Image.open(tmp_path / "overlay.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(20, 140, 60), (240, 50, 50)} <= colours
    assert (255, 150, 0) not in colours  # neither on a map nor in the legend


GREEN, RED = (20, 140, 60), (240, 50, 50)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, -44.0])
def test_the_overlay_shows_all_maps_alike_and_square_to_the_walls(
    tmp_path: Path, direction_deg: float
) -> None:
    wall = np.stack([np.linspace(-3.0, 3.0, 400), np.full(400, 1.0)], axis=1)
    x, y = np.meshgrid(np.arange(-3, 3, 0.02), np.arange(-1, 1, 0.02))
    wall, floor = turned(wall, direction_deg), turned(np.c_[x.ravel(), y.ravel()], direction_deg)
    compared = {}
    for k, name in enumerate(list(MAP_TITLES)[:3]):
        origin = np.array([-6.0, -5.0]) - 0.05 * np.array([0, 40 * k])
        cells = np.full((200 + 60 * k, 240), Cell.UNKNOWN, np.uint8)
        for places, cell in ((floor, Cell.FREE), (wall, Cell.OCCUPIED)):
            column, row = np.floor((places - origin) / 0.05).astype(int).T
            cells[row, column] = cell
        grid = GridMap(cells, origin, 0.05)
        occupied = grid.centres(Cell.OCCUPIED)
        right = np.full(len(occupied), k != 1)
        figures = WallMapFigures(occupied, np.where(right, 0.0, 0.5), occupied, right)
        compared[name] = ComparedMap(grid, figures, np.zeros((0, 2)))
    write_overlays(tmp_path / "overlay.png", compared, direction_deg)
    with Image.open(tmp_path / "overlay.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    green, red = (np.abs(pixels - colour).max(axis=2) < 30 for colour in (GREEN, RED))
    wall_rows = np.flatnonzero(red.sum(axis=1) > 0.9 * red.sum(axis=1).max())
    across = np.flatnonzero(red[wall_rows[0]])
    assert np.ptp(wall_rows) < 0.05 * np.ptp(across)  # level
    assert green.sum() == pytest.approx(2 * red.sum(), rel=0.1)  # two maps at the same scale


def test_a_run_of_a_turned_building_gets_an_upright_overlay(tmp_path: Path) -> None:
    assert walls_direction_deg(tmp_path) == 0.0  # no walls, no turn
    ends = turned(np.array([[[0.0, 0.0], [4.0, 0.0]], [[0.0, 0.0], [0.0, 9.0]]]), 33.0)
    features = [{"properties": {}, "geometry": {"type": "LineString", "coordinates": line}} for line in ends]
    write_geojson(tmp_path / WALLS, features)
    assert walls_direction_deg(tmp_path) == pytest.approx(33.0)
    (tmp_path / WALLS).write_text("{}")
    with pytest.raises(InputError, match=WALLS):
        walls_direction_deg(tmp_path)


def test_no_wall_is_lost_where_a_large_map_is_drawn_small():
    agreement = np.full((7, 9), Agreement.FREE, np.uint8)
    agreement[0, 8], agreement[3, 3], agreement[4, 3], agreement[6, 0] = (
        *(Agreement.BOTH, Agreement.ONLY_REFERENCE),
        *(Agreement.BOTH, Agreement.NOTHING),
    )
    small = coarsened(agreement, 3)
    assert small.tolist() == [
        [Agreement.FREE, Agreement.FREE, Agreement.BOTH],
        [Agreement.FREE, Agreement.ONLY_REFERENCE, Agreement.FREE],
        [Agreement.FREE, Agreement.FREE, Agreement.FREE],
    ]
