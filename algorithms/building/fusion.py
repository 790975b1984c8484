"""The building from all scans: which faces stand, its walls, doors and windows, and every map of it.

The steps stand in modules of their own; here is their order, which matters: rays tell which faces stand, faces
where windows are, and what was seen through those is no face of this building.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.doors import drop_doubtful, find_doors, prove_crossed
from ffmap.algorithms.building.face_alignment import AlignedFaces, align_faces
from ffmap.algorithms.building.face_columns import Storey, column_places
from ffmap.algorithms.building.face_foreground import BeforeWalls, BeforeWallsSettings, halo_at_walls, look_before_walls
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.face_verdicts import (
    FaceVerdict,
    JudgedFaces,
    StandingWallsSettings,
    TrimmedFaces,
    along_others,
    join_corners,
    judge_faces,
    leaning_on_others,
    refuse_outside,
    shows_whole,
    trim_at_doorways,
)
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings
from ffmap.algorithms.building.levels import HeightMap, map_levels
from ffmap.algorithms.building.missed_walls import find_hidden_walls
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings, Doors, Walls, Windows
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.thickness import WallThicknessSettings, door_depths, face_thickness, part_walls
from ffmap.algorithms.building.votes import Halo, VoxelVotes, find_halo
from ffmap.algorithms.building.windows import WindowsSettings, find_windows, seen_through
from ffmap.algorithms.maps.area_graph import (
    AreaGraph,
    AreaGraphSettings,
    Bounds,
    Segmented,
    doorways_of,
    find_rooms,
    sides_of,
)
from ffmap.algorithms.maps.floor_plan import FloorPlan, FloorPlanSettings, draw_floor_plan
from ffmap.algorithms.maps.grid import (
    Drive,
    GridMap,
    GridMapSettings,
    Immobile,
    draw_furniture_free,
    standing_stretches,
)
from ffmap.algorithms.maps.rivals import Rival, RivalMapsSettings, draw_rival
from ffmap.algorithms.maps.room_outlines import RoomOutlinesSettings
from ffmap.algorithms.scan.summary import concatenate, select_planes, without_rays

_STRICT_NEAR_M = 0.07
"""Nothing stands ajar behind a hidden wall: what ended farther behind it than its own returns scatter has passed it."""


@dataclass(frozen=True)
class FusionSettings:
    """The settings of every step that makes the building."""

    building: BuildingSettings
    standing_walls: StandingWallsSettings
    before_walls: BeforeWallsSettings
    openings: OpeningsSettings
    windows: WindowsSettings
    door_frames: DoorFramesSettings
    wall_thickness: WallThicknessSettings
    grid_map: GridMapSettings
    area_graph: AreaGraphSettings
    room_outlines: RoomOutlinesSettings
    rival_maps: RivalMapsSettings
    floor_plan: FloorPlanSettings
    relabelling: RelabellingSettings

    @property
    def opening_rules(self) -> OpeningRules:
        """By what doors and windows are told."""
        return OpeningRules(self.building, self.openings)


class Trace(Protocol):
    """Counts the rays of all scans against faces as `trace_rays` does, those that ended beyond a window left out."""

    def __call__(self, faces: Walls, settings: BuildingSettings, windows: Windows, /) -> WallCells: ...


@dataclass(frozen=True)
class AllScans:
    """What the scans of a drive gathered, in the map frame.

    votes: cubes by the labels that scans gave. rivals: what the paper's maps are drawn from, see `RivalCounter`.
    """

    drive: Drive
    votes: VoxelVotes
    rivals: VoxelVotes
    trace: Trace

    @cached_property
    def levels(self) -> tuple[HeightMap, ...]:
        """What they show together of ceilings and floors."""
        return map_levels(self.votes)

    @cached_property
    def storey(self) -> Storey:
        """The building's floor and ceiling."""
        return Storey.of(self.votes, self.levels)

    @property
    def path_map(self) -> FloatArray:
        """(n, 2) the robot's places."""
        return self.drive.path_map[:, :2]


@dataclass(frozen=True)
class Building:
    """All that is made of all scans together."""

    aligned: AlignedFaces
    """The faces that scans' planes make, before any was judged, and those found of all scans' returns together."""
    walls: Walls
    before: BeforeWalls
    judged: JudgedFaces
    doors: Doors
    windows: Windows
    halo: Halo
    levels: tuple[HeightMap, ...]
    """Its ceilings, floors and ducts, where scans took them for something else."""
    grid: GridMap
    rooms: AreaGraph
    compared_rooms: Mapping[Segmented, AreaGraph]
    """Of the maps that the paper compares with (Fig. 10), without any doors known."""
    rivals: Mapping[Rival, GridMap]
    plan: FloorPlan
    thickness_m: FloatArray
    """(W,) of each face's wall."""

    @property
    def model(self) -> BuildingModel:
        """What scans are labelled by."""
        return BuildingModel(self.walls, self.before, self.judged, self.doors, self.windows, self.levels)


def fuse_building(scans: AllScans, settings: FusionSettings, workers: int) -> Building:
    """Walls from all planes, doors and maps from all rays.

    workers: threads that draw maps. Raises ValueError where there is no scan.
    """
    aligned, judged, windows = _find_faces(scans, settings)
    aligned, judged, walls = _add_hidden_walls(aligned, judged, windows, scans, settings)
    trimmed, doors, windows = _find_openings(walls, scans, settings)
    walls, judged = trimmed.walls, judged.refuse(trimmed.leaves, FaceVerdict.ENDS_LOW)

    # The grid shows what lies farther away than what doors and windows are told by.
    immobile = Immobile(walls, scans.trace(walls, _far(settings), NO_WINDOWS), scans.votes, doors, windows)
    grid = draw_furniture_free(immobile, scans.drive, settings.grid_map, settings.wall_thickness)
    standing = standing_stretches(immobile, settings.grid_map)
    rooms = find_rooms(
        grid,
        settings.area_graph,
        doorways_of(doors),
        windows.ends,
        scans.drive.path_map,
        Bounds((standing, *sides_of(doors), windows), settings.room_outlines),
    )
    # All maps show what the furniture-free one does: a slice catches returns far outside, through windows.
    rivals = {rival: own.cropped_to(grid) for rival, own in _draw_rivals(windows, scans, settings, workers).items()}
    plan = draw_floor_plan(
        standing,
        immobile,
        grid,
        scans.storey,
        settings.floor_plan,
        settings.wall_thickness,
        rooms.rooms,
    )
    before = look_before_walls(trimmed.cells, trimmed.clear_m, settings.before_walls)
    halo = find_halo(scans.votes, settings.relabelling.halo_ratio)
    return Building(
        aligned=aligned,
        walls=walls,
        before=before,
        judged=judged,
        doors=doors,
        windows=windows,
        halo=halo_at_walls(halo, walls, doors, before, settings.relabelling.halo_wall_m),
        levels=scans.levels,
        grid=grid,
        rooms=rooms,
        compared_rooms=_compare_rooms(rivals[Rival.MIDDLE], scans, settings),
        rivals=rivals,
        plan=plan,
        thickness_m=face_thickness(walls, part_walls(walls, settings.wall_thickness)),
    )


# --- faces ---


def _find_faces(scans: AllScans, settings: FusionSettings) -> tuple[AlignedFaces, JudgedFaces, Windows]:
    """The faces of the scans' planes, which of them stand, and the windows that the first round knew.

    Where there are windows, there is a second round without the planes that were seen through them.
    """
    planes = concatenate([without_rays(features) for features in scans.drive.blocks()])
    aligned = _align(fuse_walls(planes, settings.building), scans, settings)
    judged = _judge(aligned, scans, settings)
    cells = scans.trace(judged.walls, settings.building, NO_WINDOWS)
    clear_m = _clear_m(judged.walls, cells, scans, settings)
    windows = find_windows(judged.walls, cells, clear_m, settings.opening_rules, settings.windows)
    outside = seen_through(windows, planes)
    if outside.any():
        aligned = _align(fuse_walls(select_planes(planes, ~outside), settings.building), scans, settings)
        judged = _judge(aligned, scans, settings)
    return aligned, judged, windows


def _align(faces: Walls, scans: AllScans, settings: FusionSettings) -> AlignedFaces:
    standing = settings.standing_walls
    return align_faces(faces, scans.votes, scans.storey, standing.above_door_m, standing.ceiling_near_m)


def _judge(aligned: AlignedFaces, scans: AllScans, settings: FusionSettings) -> JudgedFaces:
    """Which faces stand; refused are those that lean, those that are alone, and those that rays or rooms speak against."""
    standing = settings.standing_walls
    # A leaf that leans on its wall would be laid along it.
    leaning, faces = leaning_on_others(aligned.fused), aligned.walls
    leaves, faces = faces.select(leaning), join_corners(faces.select(~leaning), standing.corner_m)
    alone = (faces.scan_count < standing.scans_few) & ~along_others(faces)
    if alone.any():
        doubtful = faces.select(alone)
        cells = scans.trace(doubtful, settings.building, NO_WINDOWS)
        alone[alone] = ~shows_whole(cells, _clear_m(doubtful, cells, scans, settings), standing.above_door_m)
    faces, refused = faces.select(~alone), faces.select(alone)
    cells = scans.trace(faces, settings.building, NO_WINDOWS)
    clear_m = _clear_m(faces, cells, scans, settings)
    judged = judge_faces(faces, cells, clear_m, scans.path_map, settings.building.length_min_m, standing)
    judged = judged.refuse(refused, FaceVerdict.ALONE).refuse(leaves, FaceVerdict.LEANS)
    return refuse_outside(judged, scans.storey)


def _add_hidden_walls(
    aligned: AlignedFaces, judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings
) -> tuple[AlignedFaces, JudgedFaces, Walls]:
    """The faces with those that only all scans together show, and the walls that they make."""
    # No scan saw a plane of a hidden wall that its rays could be measured against.
    strict = _far(settings).model_copy(update={"near_m": _STRICT_NEAR_M, "own_plane_m": 0.0})
    hidden = find_hidden_walls(
        scans.votes,
        scans.storey,
        judged.walls,
        judged.refused,
        scans.path_map,
        lambda faces: scans.trace(faces, strict, windows),
        settings.building.length_min_m,
        settings.standing_walls,
    )
    judged = replace(judged, walls=hidden.known).refuse(hidden.ducts, FaceVerdict.HANGS)
    found = _align(hidden.walls, scans, settings)
    walls = join_corners(judged.walls.append(found.walls), settings.standing_walls.corner_m)
    return aligned.append(found), judged, walls


# --- openings ---


def _find_openings(walls: Walls, scans: AllScans, settings: FusionSettings) -> tuple[TrimmedFaces, Doors, Windows]:
    """Doors and windows, and the walls' faces as the doors' reveals end them."""
    cells = scans.trace(walls, settings.building, NO_WINDOWS)
    clear_m = _clear_m(walls, cells, scans, settings)
    windows = find_windows(walls, cells, clear_m, settings.opening_rules, settings.windows)
    # What a window lets pass is no door's.
    without_glass = scans.trace(walls, settings.building, windows) if len(windows) else cells
    doors = find_doors(walls, without_glass, clear_m, settings.opening_rules, windows)
    doors = place_frames(doors, walls, scans.drive.blocks(), settings.building, settings.door_frames)
    doors = drop_doubtful(doors, settings.building)
    doors = prove_crossed(doors, scans.path_map)
    doors = measure_reveals(doors, scans.drive.blocks(), settings.door_frames)
    parts = part_walls(walls, settings.wall_thickness)
    doors = replace(
        doors, reveal_m=door_depths(doors, walls, parts, settings.wall_thickness, settings.building.reveal_m)
    )
    return trim_at_doorways(walls, cells, doors, clear_m), doors, windows


# --- maps ---


def _draw_rivals(windows: Windows, scans: AllScans, settings: FusionSettings, workers: int) -> dict[Rival, GridMap]:
    """The maps that the paper compares with, side by side."""

    def draw(rival: Rival) -> GridMap:
        return draw_rival(rival, scans.rivals, windows, scans.drive, settings.grid_map, settings.rival_maps)

    with ThreadPoolExecutor(workers) as threads:
        return dict(zip(Rival, threads.map(draw, Rival), strict=True))


def _compare_rooms(normal: GridMap, scans: AllScans, settings: FusionSettings) -> dict[Segmented, AreaGraph]:
    """Rooms of the normal map (Fig. 10), with and without alpha removal."""
    path_map, as_is = scans.drive.path_map, settings.area_graph.without_alpha_removal()
    return {
        Segmented.NORMAL: find_rooms(normal, settings.area_graph, path_map=path_map),
        Segmented.NORMAL_AS_IS: find_rooms(normal, as_is, path_map=path_map),
    }


# --- what several steps ask for ---


def _far(settings: FusionSettings) -> BuildingSettings:
    """For faces, which rays tell of from farther away than of doors and windows."""
    return settings.building.model_copy(update={"range_m": settings.building.far_m})


def _clear_m(faces: Walls, cells: WallCells, scans: AllScans, settings: FusionSettings) -> FloatArray:
    """(columns,) from the floor to the ceiling before each column of the faces; NaN where none was seen."""
    return scans.storey.clear_m(column_places(faces, cells.first), settings.standing_walls.ceiling_near_m)
