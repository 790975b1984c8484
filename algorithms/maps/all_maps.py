"""Every map of the building: the furniture-free grid, its rooms, the floor plan, and the maps that the paper compares with."""

from collections.abc import Mapping
from dataclasses import dataclass

from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.area_graph import (
    AreaGraph,
    AreaGraphSettings,
    Segmented,
    doorways_of,
    find_rooms,
    sides_of,
)
from ffmap.algorithms.maps.floor_plan import FloorPlan, draw_floor_plan
from ffmap.algorithms.maps.grid import (
    GridMap,
    GridMapSettings,
    Immobile,
    draft_furniture_free,
    draw_free,
    standing_stretches,
)
from ffmap.algorithms.maps.rivals import Rival, draft_rival


@dataclass(frozen=True)
class MapsSettings:
    """The settings of every step that draws a map."""

    building: BuildingSettings
    wall_thickness: WallThicknessSettings
    grid_map: GridMapSettings
    area_graph: AreaGraphSettings


@dataclass(frozen=True)
class Maps:
    """All maps of a building.

    grid: the furniture-free one. rooms: its rooms. rivals: the paper's other maps (Fig. 6, Fig. 9c, d), of the same extent.
    compared_rooms: rooms of a rival (Fig. 10), found without any door known. plan: the floor plan.
    """

    grid: GridMap
    rooms: AreaGraph
    rivals: Mapping[Rival, GridMap]
    compared_rooms: Mapping[Segmented, AreaGraph]
    plan: FloorPlan


def draw_maps(building: Building, scans: AllScans, settings: MapsSettings, workers: int) -> Maps:
    """workers: number of threads that draw."""
    doors, windows, knee_m = building.model.doors, building.model.windows, settings.building.knee_m
    # The grid shows what lies farther away than what doors and windows are told by.
    cells = scans.trace(building.model.walls, settings.building.for_faces(), NO_WINDOWS)
    immobile = Immobile(building.model.walls, cells, scans.votes, doors, windows)
    drafts = [draft_furniture_free(immobile, scans.drive, settings.grid_map, settings.wall_thickness, knee_m)]
    for rival in Rival:
        drafts.append(draft_rival(rival, scans.rivals, windows, scans.drive, settings.grid_map))
    grid, *drawn = draw_free(drafts, scans.drive, settings.grid_map, knee_m, workers)
    standing = standing_stretches(immobile, settings.grid_map, knee_m)
    bounds = (standing, *sides_of(doors), windows)
    rooms = find_rooms(grid, settings.area_graph, doorways_of(doors), windows.ends, scans.drive.path_map, bounds)
    # All maps show what the furniture-free one does: a slice catches returns far outside, through windows.
    rivals = {rival: own.cropped_to(grid) for rival, own in zip(Rival, drawn, strict=True)}
    plan = draw_floor_plan(
        standing, immobile, grid, scans.storey, settings.wall_thickness, rooms.rooms
    )
    return Maps(grid, rooms, rivals, _compare_rooms(rivals[Rival.MIDDLE], scans, settings), plan)


def _compare_rooms(normal: GridMap, scans: AllScans, settings: MapsSettings) -> dict[Segmented, AreaGraph]:
    """Rooms of the normal map (Fig. 10), with and without alpha removal."""
    path_map, as_is = scans.drive.path_map, settings.area_graph.without_alpha_removal()
    return {
        Segmented.NORMAL: find_rooms(normal, settings.area_graph, path_map=path_map),
        Segmented.NORMAL_AS_IS: find_rooms(normal, as_is, path_map=path_map),
    }
