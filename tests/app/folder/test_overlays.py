"""The picture that lays maps over the ground truth."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import ComparedMap
from ffmap.app.folder.pictures import MAP_TITLES, write_overlays

GREEN, RED = (20, 140, 60), (240, 50, 50)


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, -44.0])
def test_all_maps_are_shown_alike_and_square_to_the_walls(
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
        distance_m = np.full(len(occupied), 0.5 if k == 1 else 0.0)
        covered = np.ones(len(occupied), bool)
        compared[name] = ComparedMap(
            grid, occupied, distance_m, occupied, covered, np.zeros(0, bool), 0
        )
    write_overlays(tmp_path / "overlay.png", compared, direction_deg)
    with Image.open(tmp_path / "overlay.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    green, red = (np.abs(pixels - colour).max(axis=2) < 80 for colour in (GREEN, RED))
    wall_rows = np.flatnonzero(red.sum(axis=1) > 0.9 * red.sum(axis=1).max())
    across = np.flatnonzero(red[wall_rows[0]])
    assert np.ptp(wall_rows) < 0.05 * np.ptp(across)  # level
    assert green.sum() == pytest.approx(2 * red.sum(), rel=0.2)  # two maps at the same scale
