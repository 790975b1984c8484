"""Maps drawn one by one."""

from ffmap.algorithms.base.scan import IntArray
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import Windows
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.grid import (
    GridMap,
    GridMapSettings,
    Immobile,
    draft_cells,
    draft_furniture_free,
    draw_free,
)


def draw_furniture_free(
    immobile: Immobile, drive: Drive, settings: GridMapSettings, thickness: WallThicknessSettings, knee_m: float
) -> GridMap:
    (grid,) = draw_free([draft_furniture_free(immobile, drive, settings, thickness, knee_m)], drive, settings, knee_m)
    return grid


def draw_cells(
    cell_index: IntArray, windows: Windows, drive: Drive, settings: GridMapSettings, knee_m: float
) -> GridMap:
    (grid,) = draw_free([draft_cells(cell_index, windows, drive, settings)], drive, settings, knee_m)
    return grid
