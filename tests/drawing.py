"""Maps drawn one by one."""

from ffmap.algorithms.base.scan import IntArray
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import Windows
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.free_space import draw_free
from ffmap.algorithms.maps.furniture_free import (
    Immobile,
    draft_cells,
    draft_furniture_free,
    standing_stretches,
)
from ffmap.algorithms.maps.grid import GridMap, GridMapSettings


def draw_furniture_free(
    immobile: Immobile,
    drive: Drive,
    settings: GridMapSettings,
    thickness: WallThicknessSettings,
    knee_m: float,
) -> GridMap:
    places = [immobile.walls.ends, immobile.doors.ends, drive.path_map[:, :2]]
    frame = GridMap.around(places, settings.cell_m)
    standing = standing_stretches(immobile)
    draft = draft_furniture_free(immobile, standing, frame, settings, thickness)
    (grid,) = draw_free([draft], frame, drive, knee_m)
    return grid


def draw_cells(
    cell_index: IntArray, windows: Windows, drive: Drive, settings: GridMapSettings, knee_m: float
) -> GridMap:
    places = (cell_index + 0.5) * settings.cell_m
    frame = GridMap.around([places, drive.path_map[:, :2]], settings.cell_m)
    draft = draft_cells(places, frame, windows)
    (grid,) = draw_free([draft], frame, drive, knee_m)
    return grid
