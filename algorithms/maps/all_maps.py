"""All maps of a building: the furniture-free grid, its rooms, the floor plan, and the rivals."""

from collections.abc import Mapping
from dataclasses import dataclass

from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.building.model import BuildingSettings
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
from ffmap.algorithms.maps.free_space import draw_free
from ffmap.algorithms.maps.furniture_free import (
    Immobile,
    draft_furniture_free,
    standing_stretches,
)
from ffmap.algorithms.maps.grid import GridMap, GridMapSettings
from ffmap.algorithms.maps.open_edges import close_edges
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

    grid: the furniture-free map. rooms: its rooms. rivals: the paper's other maps (Fig. 6, Fig. 9c,
    d), of the same extent. compared_rooms: rooms of a rival (Fig. 10), without detected doors.
    """

    grid: GridMap
    rooms: AreaGraph
    rivals: Mapping[Rival, GridMap]
    compared_rooms: Mapping[Segmented, AreaGraph]
    plan: FloorPlan


def draw_maps(building: Building, scans: AllScans, settings: MapsSettings) -> Maps:
    """Draw all maps of a building."""
    doors, windows, knee_m = building.model.doors, building.model.windows, settings.building.knee_m
    passages = building.model.passages
    immobile = Immobile(building.model.walls, building.parsed.stretches, doors, windows, passages)
    standing = standing_stretches(immobile)
    places = [immobile.walls.ends, doors.ends, scans.path_map]
    frame = GridMap.around(places, settings.grid_map.cell_m)
    drafts = [
        draft_furniture_free(immobile, standing, frame, settings.grid_map, settings.wall_thickness),
        *(draft_rival(rival, scans.rivals, frame, windows) for rival in Rival),
    ]
    grid, *drawn = draw_free(drafts, frame, scans.drive, knee_m)
    grid = close_edges(grid, scans.votes, windows.ends)
    rivals = dict(zip(Rival, drawn, strict=True))
    bounds = (standing, *sides_of(building.model.ways), windows)
    path_map, ways = scans.drive.path_map, doorways_of(doors)
    open_ways = doorways_of(passages)
    rooms = find_rooms(grid, settings.area_graph, ways, windows.ends, path_map, bounds, open_ways)
    # Rooms of the normal map (Fig. 10), with and without alpha removal.
    normal = rivals[Rival.MIDDLE]
    as_is = settings.area_graph.model_copy(update={"furniture_max_m": 0.0})
    compared_rooms = {
        Segmented.NORMAL: find_rooms(normal, settings.area_graph, path_map=path_map),
        Segmented.NORMAL_AS_IS: find_rooms(normal, as_is, path_map=path_map),
    }
    plan = draw_floor_plan(standing, immobile, grid, settings.wall_thickness, rooms.rooms)
    return Maps(grid, rooms, rivals, compared_rooms, plan)
