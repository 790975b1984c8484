"""The building from all scans: which faces stand, its walls, doors and windows.

Rays tell which faces stand, faces where windows are, and what was seen through those is no face of
this building: hence faces are parsed twice.
"""

from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.doors import each_once, prove_crossed
from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.face_alignment import (
    AlignedFaces,
    FaceAlignmentSettings,
    align_faces,
)
from ffmap.algorithms.building.face_foreground import (
    ForegroundSettings,
    bare_foreground,
    find_foreground,
)
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings, along_low_walls, find_low_walls
from ffmap.algorithms.building.model import (
    NO_WALLS,
    NO_WINDOWS,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import (
    Openings,
    ParsedFaces,
    blinds_of,
    doors_of,
    find_openings,
    fronts_of,
    glazed_doors_of,
    judge,
    mostly_stands,
    windows_of,
)
from ffmap.algorithms.building.storey import CEILING_NEAR_M, TracedFaces, room_before
from ffmap.algorithms.building.thickness import (
    WallThicknessSettings,
    door_depths,
    face_thickness,
    part_walls,
)
from ffmap.algorithms.building.unseen_walls import (
    UnseenWallsSettings,
    both_sides,
    lines_of_any_direction,
    near_a_face,
    straight_lines,
    unexplained_columns,
    walls_of,
)
from ffmap.algorithms.building.verdicts import (
    FaceVerdict,
    JudgedFaces,
    StandingWallsSettings,
    along_others,
    join_corners,
    join_in_line,
    leaning_on_others,
    wall_directions,
)
from ffmap.algorithms.building.windows import (
    is_in_wall,
    join_windows,
    panes_of_open_leaves,
    seen_through,
)
from ffmap.algorithms.scan.summary import concatenate, select_planes, without_rays


@dataclass(frozen=True)
class FusionSettings:
    """The settings of every step that makes the building."""

    building: BuildingSettings
    levels: LevelsSettings
    face_alignment: FaceAlignmentSettings
    parse: ParseSettings
    standing_walls: StandingWallsSettings
    unseen_walls: UnseenWallsSettings
    low_walls: LowWallsSettings
    foreground: ForegroundSettings
    door_frames: DoorFramesSettings
    wall_thickness: WallThicknessSettings
    relabelling: RelabellingSettings


@dataclass(frozen=True)
class Building:
    """All that is made of all scans together.

    model: what scans are labelled by. aligned: the faces before any was judged. parsed: the walls
    but for low ones, with what rays found of them.
    thickness_m: (W,) of the walls.
    """

    model: BuildingModel
    parsed: ParsedFaces
    aligned: AlignedFaces
    thickness_m: FloatArray


def fuse_building(scans: AllScans, settings: FusionSettings) -> Building:
    """Fuse walls from all planes, doors and windows from all rays.

    Raises ValueError where there is no scan.
    """
    aligned, judged, glass = _find_faces(scans, settings)
    walls = _add_unseen_walls(judged, glass, scans, settings)
    fronts = glass.select(~is_in_wall(glass, walls))
    faces = _traced(walls, scans, NO_WINDOWS)
    parsed = _parsed(faces, scans, settings)
    seen = find_openings(parsed, scans.trace_within)
    windows = join_windows(windows_of(seen).append(fronts))
    doors = _find_doors(walls, seen, windows, scans, settings)
    foreground = find_foreground(faces, doors, settings.foreground)
    low = _find_low_walls(walls, windows, scans, settings)
    is_low = along_low_walls(judged.refused, low, settings.unseen_walls.beside_m)
    verdict, refused = judged.verdict[~is_low], judged.refused.select(~is_low)
    judged = replace(judged, refused=refused, verdict=verdict)
    walls = walls.append(low)
    foreground = foreground.append(bare_foreground(low, scans.storey))
    thickness_m = face_thickness(walls, part_walls(walls, settings.wall_thickness))
    is_leaf = panes_of_open_leaves(windows, doors)
    model = BuildingModel(
        walls,
        foreground,
        judged,
        doors,
        windows.select(~is_leaf),
        blinds_of(seen),
        scans.levels,
        leaf_panes=windows.select(is_leaf),
        low_walls=low,
    )
    return Building(model, parsed, aligned, thickness_m)


def _find_faces(
    scans: AllScans, settings: FusionSettings
) -> tuple[AlignedFaces, JudgedFaces, Windows]:
    """The faces of the scans' planes, which of them stand, and the panes that these and lines show.

    Where there are panes, there is a second round without the planes that were seen through them.
    """
    planes = concatenate([without_rays(features) for features in scans.drive.blocks()])
    aligned = _align(fuse_walls(planes, settings.building), scans, settings)
    judged = _judge(aligned, scans, settings, NO_WINDOWS)
    windows = windows_of(_openings(judged.walls, scans, settings))
    lines = _lines(judged.walls, judged.refused, scans, settings)
    parsed = _parsed(_traced(lines, scans, NO_WINDOWS), scans, settings).gaps_as_panes()
    fronts = fronts_of(find_openings(parsed, scans.trace_within))
    # Nobody glazes a wall: a sheet so close before one is the edges of a shelf's boards.
    middles, depth_m = fronts.ends.mean(axis=1), settings.unseen_walls.shelf_m
    shelves = near_a_face(middles, fronts.normal, judged.walls, 0.0, depth_m)
    glass = join_windows(windows.append(fronts.select(~shelves)))
    outside = seen_through(glass, planes)
    if outside.any():
        planes = select_planes(planes, ~outside)
        aligned = _align(fuse_walls(planes, settings.building), scans, settings)
        judged = _judge(aligned, scans, settings, glass)
    return aligned, judged, glass


def _align(faces: Walls, scans: AllScans, settings: FusionSettings) -> AlignedFaces:
    return align_faces(faces, scans.votes, scans.storey, settings.face_alignment)


def _judge(
    aligned: AlignedFaces, scans: AllScans, settings: FusionSettings, windows: Windows
) -> JudgedFaces:
    """Which faces stand, without what was seen through windows."""
    standing = settings.standing_walls
    # A leaf that leans on its wall would be laid along it.
    leaning, faces = leaning_on_others(aligned.fused), aligned.walls
    leaves, faces = faces.select(leaning), faces.select(~leaning)
    faces = join_in_line(faces, settings.building.own_plane_m, settings.building.gap_m)
    faces = join_corners(faces, standing)
    doubtful = (faces.scan_count < standing.scans_few) & ~along_others(faces, standing)
    parsed = _parsed(_traced(faces, scans, windows), scans, settings)
    judged = judge(parsed, doubtful, settings.unseen_walls.odds_min, settings.building)
    within = room_before(judged.walls, scans.storey)
    beyond = judged.walls.select(~within)
    judged = replace(judged, walls=judged.walls.select(within))
    return judged.refuse(leaves, FaceVerdict.LEANS).refuse(beyond, FaceVerdict.OUTSIDE)


def _add_unseen_walls(
    judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings
) -> Walls:
    """The walls, with those that only all scans together show."""
    known = judged.walls
    for lines in (_lines, _chords):
        candidates = _align(lines(known, judged.refused, scans, settings), scans, settings).walls
        parsed = _parsed(_traced(candidates, scans, windows), scans, settings)
        known = known.append(walls_of(parsed, known, settings.building, settings.unseen_walls))
    found = known.select(slice(len(judged.walls), None))
    found = found.select(room_before(found, scans.storey))
    # What only rays without windows show, and others pass, a pane mirrored.
    found = found.select(mostly_stands(_parsed(_traced(found, scans, NO_WINDOWS), scans, settings)))
    return join_corners(judged.walls.append(found), settings.standing_walls)


def _find_low_walls(
    walls: Walls, windows: Windows, scans: AllScans, settings: FusionSettings
) -> Walls:
    """The sides of walls that end below the ceiling."""
    lines = _lines(walls, NO_WALLS, scans, settings)
    parsed = _parsed(_traced(lines, scans, windows), scans, settings)
    return find_low_walls(parsed, walls, settings.low_walls)


def _find_doors(
    walls: Walls, seen: Openings, windows: Windows, scans: AllScans, settings: FusionSettings
) -> Doors:
    """The doors of the walls, by rays that passed no window; glazed ones by all rays."""
    clear = _parsed(_traced(walls, scans, windows), scans, settings)
    doors = doors_of(find_openings(clear, scans.trace_within), settings.building)
    doors = doors.append(glazed_doors_of(seen, settings.building))
    blocks = scans.drive.blocks
    doors = place_frames(doors, walls, blocks(), settings.building, settings.door_frames)
    doors = prove_crossed(each_once(doors, settings.building), scans.path_map)
    through_m = doors.reveal_m
    doors = measure_reveals(doors, blocks(), settings.door_frames)
    thickness = settings.wall_thickness
    parts, unknown_m = part_walls(walls, thickness), settings.building.reveal_m
    depth_m = door_depths(doors, walls, parts, thickness, unknown_m, through_m)
    return replace(doors, reveal_m=depth_m)


def _lines(walls: Walls, refused: Walls, scans: AllScans, settings: FusionSettings) -> Walls:
    """Lines of returns along the walls' directions, from both sides."""
    directions = wall_directions(walls, settings.standing_walls.direction_share_min)
    columns = unexplained_columns(scans.votes, walls.append(refused), settings.unseen_walls)
    lines = straight_lines(columns, directions, settings.building.gap_m, settings.unseen_walls)
    return both_sides(lines, walls, settings.unseen_walls)


def _chords(walls: Walls, refused: Walls, scans: AllScans, settings: FusionSettings) -> Walls:
    """Lines of returns of any direction, as high as walls are, from both sides."""
    columns = unexplained_columns(scans.votes, walls.append(refused), settings.unseen_walls)
    clear_m = scans.storey.clear_m(columns.place, CEILING_NEAR_M)
    height_m = columns.top_m - scans.storey.ground_m(columns.place)
    is_high = height_m > np.fmin(clear_m - 0.35, 2.25)
    lines = lines_of_any_direction(columns.place[is_high], settings.unseen_walls)
    return both_sides(lines, walls, settings.unseen_walls)


def _openings(faces: Walls, scans: AllScans, settings: FusionSettings) -> Openings:
    """The openings of some faces, by all rays."""
    parsed = _parsed(_traced(faces, scans, NO_WINDOWS), scans, settings)
    return find_openings(parsed, scans.trace_within)


def _parsed(faces: TracedFaces, scans: AllScans, settings: FusionSettings) -> ParsedFaces:
    parsed = ParsedFaces.of(faces, scans.path_map, settings.building, settings.parse)
    return parsed.with_panes_told(scans.trace_within)


def _traced(faces: Walls, scans: AllScans, windows: Windows) -> TracedFaces:
    """The faces with what rays found of them, but for those that ended beyond windows."""
    return TracedFaces.of(faces, scans.trace(faces, windows), scans.storey)
