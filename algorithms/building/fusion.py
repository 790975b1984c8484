"""The building from all scans: which faces stand, its walls, doors and windows.

The steps stand in modules of their own; here is their order, which matters: rays tell which faces stand, faces
where windows are, and what was seen through those is no face of this building.
"""

from dataclasses import dataclass, replace

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.doors import drop_doubtful, find_doors, prove_crossed
from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.face_alignment import AlignedFaces, align_faces
from ffmap.algorithms.building.face_columns import column_places
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
from ffmap.algorithms.building.levels import HeightMap
from ffmap.algorithms.building.missed_walls import find_hidden_walls
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings, Doors, Walls, Windows
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.thickness import WallThicknessSettings, door_depths, face_thickness, part_walls
from ffmap.algorithms.building.votes import Halo, find_halo
from ffmap.algorithms.building.windows import WindowsSettings, find_windows, seen_through
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
    relabelling: RelabellingSettings

    @property
    def opening_rules(self) -> OpeningRules:
        """By what doors and windows are told."""
        return OpeningRules(self.building, self.openings)


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
    thickness_m: FloatArray
    """(W,) of each face's wall."""

    @property
    def model(self) -> BuildingModel:
        """What scans are labelled by."""
        return BuildingModel(self.walls, self.before, self.judged, self.doors, self.windows, self.levels)


def fuse_building(scans: AllScans, settings: FusionSettings) -> Building:
    """Walls from all planes, doors and windows from all rays. Raises ValueError where there is no scan."""
    aligned, judged, windows = _find_faces(scans, settings)
    aligned, judged, walls = _add_hidden_walls(aligned, judged, windows, scans, settings)
    trimmed, doors, windows = _find_openings(walls, scans, settings)
    walls, judged = trimmed.walls, judged.refuse(trimmed.leaves, FaceVerdict.ENDS_LOW)
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
    strict = settings.building.for_faces().model_copy(update={"near_m": _STRICT_NEAR_M, "own_plane_m": 0.0})
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
    doors = replace(doors, reveal_m=door_depths(doors, walls, parts, settings.wall_thickness))
    return trim_at_doorways(walls, cells, doors, clear_m), doors, windows


# --- what several steps ask for ---


def _clear_m(faces: Walls, cells: WallCells, scans: AllScans, settings: FusionSettings) -> FloatArray:
    """(columns,) from the floor to the ceiling before each column of the faces; NaN where none was seen."""
    return scans.storey.clear_m(column_places(faces, cells.first), settings.standing_walls.ceiling_near_m)
