"""The building from all scans: which faces stand, its walls, doors and windows.

The order of the steps matters: rays tell which faces stand, faces where windows are, and what was seen through those is no
face of this building.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.blinds import BlindsSettings
from ffmap.algorithms.building.cells import WallCells
from ffmap.algorithms.building.door_casings import DoorCasingsSettings, find_cased_doors
from ffmap.algorithms.building.door_contrasts import DoorContrastsSettings, find_contrasting_doors
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.door_outlines import DoorOutlinesSettings, find_outlined_doors
from ffmap.algorithms.building.doors import (
    each_once,
    prove_crossed,
)
from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.evidence import LAYERS_M, RECESS, trace
from ffmap.algorithms.building.face_alignment import (
    AlignedFaces,
    FaceAlignmentSettings,
    align_faces,
)
from ffmap.algorithms.building.face_columns import (
    FaceColumnsSettings,
    TracedFaces,
    room_before,
)
from ffmap.algorithms.building.face_foreground import (
    ForegroundSettings,
    bare_foreground,
    find_foreground,
)
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.face_steps import FaceStepsSettings
from ffmap.algorithms.building.face_verdicts import (
    FaceVerdict,
    JudgedFaces,
    StandingWallsSettings,
    TrimmedFaces,
    along_others,
    join_corners,
    leaning_on_others,
    refuse_outside,
    shows_whole,
    trim_at_doorways,
    wall_directions,
)
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings
from ffmap.algorithms.building.folds import FoldsSettings
from ffmap.algorithms.building.glass_fronts import (
    AllRays,
    GlassFrontsSettings,
    GlassRules,
    find_glass_fronts,
    new_fronts,
    set_in_walls,
)
from ffmap.algorithms.building.glazed_doors import panes_of_open_leaves
from ffmap.algorithms.building.halo import Halo, HaloSettings, find_halo, halo_at_walls
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings, find_low_walls, without_low_walls
from ffmap.algorithms.building.missed_walls import (
    MissedWallsSettings,
)
from ffmap.algorithms.building.model import (
    NO_WALLS,
    NO_WINDOWS,
    Blinds,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.rays import OwnPlane
from ffmap.algorithms.building.settle import (
    Openings,
    ParsedFaces,
    blinds_of,
    doors_of,
    find_openings,
    glazed_doors_of,
    judge,
    windows_of,
)
from ffmap.algorithms.building.shades import pictures
from ffmap.algorithms.building.sliding_doors import (
    HangingLeaf,
    find_hanging_leaves,
    find_sliding_doors,
    sliding_panes,
)
from ffmap.algorithms.building.thickness import (
    WallThicknessSettings,
    door_depths,
    face_thickness,
    part_walls,
)
from ffmap.algorithms.building.unexplained_lines import straight_lines, unexplained_columns
from ffmap.algorithms.building.unseen_walls import UnseenWallsSettings, find_unseen_walls
from ffmap.algorithms.building.windows import (
    WindowsSettings,
    is_in_wall,
    join_windows,
    seen_through,
    without_panes,
)
from ffmap.algorithms.scan.summary import (
    Features,
    concatenate,
    select_planes,
    select_scans,
    without_rays,
)


@dataclass(frozen=True)
class FusionSettings:
    """The settings of every step that makes the building."""

    building: BuildingSettings
    levels: LevelsSettings
    face_columns: FaceColumnsSettings
    face_alignment: FaceAlignmentSettings
    face_steps: FaceStepsSettings
    standing_walls: StandingWallsSettings
    folds: FoldsSettings
    parse: ParseSettings
    missed_walls: MissedWallsSettings
    unseen_walls: UnseenWallsSettings
    low_walls: LowWallsSettings
    foreground: ForegroundSettings
    openings: OpeningsSettings
    windows: WindowsSettings
    blinds: BlindsSettings
    glass_fronts: GlassFrontsSettings
    door_casings: DoorCasingsSettings
    door_contrasts: DoorContrastsSettings
    door_outlines: DoorOutlinesSettings
    door_frames: DoorFramesSettings
    wall_thickness: WallThicknessSettings
    halo: HaloSettings
    relabelling: RelabellingSettings

    @property
    def opening_rules(self) -> OpeningRules:
        """By what doors and windows are told."""
        return OpeningRules(self.building, self.openings)



@dataclass(frozen=True)
class Building:
    """All that is made of all scans together.

    model: what scans are labelled by. halo: the same, kept apart because it is large. aligned: the faces before any was judged, and
    those found of all scans' returns together. thickness_m: (W,) of the walls.
    """

    model: BuildingModel
    halo: Halo
    aligned: AlignedFaces
    thickness_m: FloatArray


def fuse_building(scans: AllScans, settings: FusionSettings) -> Building:
    """Walls from all planes, doors and windows from all rays. Raises ValueError where there is no scan."""
    aligned, judged, windows, fronts = _find_faces(scans, settings)
    walls = _add_unseen_walls(judged, windows.append(fronts), scans, settings)
    trimmed, doors, glass, blinds = _find_openings(walls, fronts, scans, settings)
    walls, judged = trimmed.faces.walls, judged.refuse(trimmed.leaves, FaceVerdict.ENDS_LOW)
    foreground = find_foreground(trimmed.faces, doors, settings.standing_walls.above_door_m, settings.foreground)
    low = _find_low_walls(walls, glass, scans, settings)
    is_refused = without_low_walls(judged.refused, low, settings.missed_walls.noise_m)
    judged = replace(judged, refused=judged.refused.select(is_refused), verdict=judged.verdict[is_refused])
    walls, foreground = walls.append(low), foreground.append(bare_foreground(low, scans.storey))
    thickness_m = face_thickness(walls, part_walls(walls, settings.wall_thickness))
    halo = find_halo(scans.votes, settings.halo)
    halo = halo_at_walls(halo, walls, doors, foreground, scans.storey, settings.halo)
    is_leaf = panes_of_open_leaves(glass, doors)
    windows, leaf_panes = glass.select(~is_leaf), glass.select(is_leaf)
    model = BuildingModel(walls, foreground, judged, doors, windows, blinds, scans.levels, leaf_panes, low_walls=low)
    return Building(model, halo, aligned, thickness_m)


# --- faces ---


def _find_faces(scans: AllScans, settings: FusionSettings) -> tuple[AlignedFaces, JudgedFaces, Windows, Windows]:
    """The faces of the scans' planes, which of them stand, and the windows and the glazed fronts that the first round knew.

    Where there are windows, there is a second round without the planes that were seen through them.
    """
    planes = concatenate([without_rays(features) for features in scans.drive.blocks()])
    aligned = _align(fuse_walls(planes, settings.building), scans, settings)
    judged = _judge(aligned, scans, settings)
    faces = _traced(judged.walls, scans, settings)
    seen = find_openings(_parsed(faces, scans, settings), scans.trace_within)
    windows, _ = _windows_in(faces, seen, settings)
    fronts = _find_glass_fronts(aligned.walls, judged, windows, scans, settings)
    glass = windows.append(fronts)
    outside = seen_through(glass, planes)
    if outside.any():
        aligned = _align(fuse_walls(select_planes(planes, ~outside), settings.building), scans, settings)
        # What a pane mirrored seems to have passed the wall beside it.
        judged = _judge(aligned, scans, settings, glass)
        # Walls that panes mirrored have gone, and with them their windows.
        windows = windows.select(is_in_wall(windows, judged.walls, settings.windows))
    return aligned, judged, windows, fronts


def _align(faces: Walls, scans: AllScans, settings: FusionSettings) -> AlignedFaces:
    return align_faces(faces, scans.votes, scans.storey, settings.standing_walls, settings.face_alignment, settings.face_steps)


def _judge(aligned: AlignedFaces, scans: AllScans, settings: FusionSettings, windows: Windows = NO_WINDOWS) -> JudgedFaces:
    """Which faces stand; refused are those that lean, those that are alone, and those that rays or rooms speak against."""
    standing = settings.standing_walls
    # A leaf that leans on its wall would be laid along it.
    leaning, faces = leaning_on_others(aligned.fused, standing), aligned.walls
    leaves, faces = faces.select(leaning), join_corners(faces.select(~leaning), standing)
    alone = (faces.scan_count < standing.scans_few) & ~along_others(faces, standing)
    if alone.any():
        alone[alone] = ~shows_whole(_traced(faces.select(alone), scans, settings, windows), standing)
    traced = without_panes(_traced(faces.select(~alone), scans, settings, windows), windows)
    judged = judge(_parsed(traced, scans, settings), settings.building)
    judged = judged.refuse(faces.select(alone), FaceVerdict.ALONE).refuse(leaves, FaceVerdict.LEANS)
    return refuse_outside(judged, scans.storey, settings.face_columns)


def _add_unseen_walls(judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings) -> Walls:
    """The walls, with those that only all scans together show."""
    standing = settings.standing_walls

    def parse(faces: Walls) -> ParsedFaces:
        return _parsed(_traced(faces, scans, settings, windows), scans, settings)

    found = find_unseen_walls(
        judged.walls,
        judged.refused,
        scans.votes,
        scans.storey,
        lambda faces: _align(faces, scans, settings).walls,
        parse,
        settings.building.gap_m,
        standing.direction_share_min,
        settings.unseen_walls,
    )
    found = found.select(room_before(found, scans.storey, settings.face_columns))
    return join_corners(judged.walls.append(found), standing)


def _find_low_walls(walls: Walls, glass: Windows, scans: AllScans, settings: FusionSettings) -> Walls:
    """The sides of walls that end below the ceiling."""
    missed = settings.missed_walls
    place, weight, _ = unexplained_columns(scans.votes, walls, NO_WALLS, missed.explained_m)
    directions = wall_directions(walls, settings.standing_walls.direction_share_min)
    lines = straight_lines(place, weight, directions, missed.half_thickness_m, settings.building.gap_m)
    trace_unseen = partial(_traced_unseen, scans=scans, settings=settings, windows=glass)
    return find_low_walls(lines, walls, trace_unseen, settings.building, settings.low_walls)


# --- openings ---


def _find_glass_fronts(
    whole: Walls, judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings
) -> Windows:
    def count_all(faces: Walls, known: Windows) -> WallCells:
        return WallCells.of_layers(scans.trace(faces, known), RECESS)

    def each_scan(faces: Walls) -> Iterator[WallCells]:
        def count(blocks: list[Features]) -> WallCells:
            found = trace(faces, blocks, settings.building.range_m, OwnPlane.of(settings.building))
            return WallCells.of_layers(found, RECESS)

        for block in scans.drive.blocks():
            if count([block]).counts.any():
                for scan in block.scan:
                    yield count([select_scans(block, block.scan == scan)])

    unseen = settings.building.model_copy(update={"near_m": -LAYERS_M[RECESS + 1]})
    openings = OpeningRules(unseen, settings.openings)
    rules = GlassRules(openings, settings.standing_walls, settings.glass_fronts, settings.missed_walls)
    return find_glass_fronts(whole, judged, windows, AllRays(scans.votes, scans.path_map, count_all, each_scan), rules)


def _find_openings(
    walls: Walls, fronts: Windows, scans: AllScans, settings: FusionSettings
) -> tuple[TrimmedFaces, Doors, Windows, Blinds]:
    """Doors, windows and what hangs in these, and the walls' faces as the doors' reveals end them."""
    faces = _traced(walls, scans, settings)
    seen = find_openings(_parsed(faces, scans, settings), scans.trace_within)
    blinds = blinds_of(seen)
    windows, leaves = _windows_in(faces, seen, settings)
    fronts = new_fronts(fronts, windows, settings.glass_fronts)
    windows = windows.append(set_in_walls(fronts, walls, settings.glass_fronts))

    # What a window lets pass is no door's.
    clear = _traced(walls, scans, settings, windows) if len(windows) else faces
    openings = find_openings(_parsed(clear, scans, settings), scans.trace_within)
    doors = doors_of(openings, settings.building)
    cased = find_cased_doors(clear, settings.building, settings.door_casings)
    shown = pictures(clear, settings.building)
    contrasting = find_contrasting_doors(shown, settings.building, settings.door_contrasts)
    outlined = find_outlined_doors(shown, settings.building, settings.door_outlines)
    glazed = glazed_doors_of(seen, settings.building)
    sliding = find_sliding_doors(leaves, doors, settings.building)
    doors = doors.append(sliding).append(cased).append(contrasting).append(outlined).append(glazed)
    doors = place_frames(doors, walls, scans.drive.blocks(), settings.building, settings.door_frames)
    doors = prove_crossed(each_once(doors, settings.opening_rules), scans.path_map)
    through_m = doors.reveal_m
    doors = measure_reveals(doors, scans.drive.blocks(), settings.door_frames)
    parts = part_walls(walls, settings.wall_thickness)
    depth_m = door_depths(doors, walls, parts, settings.wall_thickness, settings.building.reveal_m, through_m)
    doors = replace(doors, reveal_m=depth_m)
    return trim_at_doorways(faces, doors, settings.standing_walls), doors, windows, blinds


# --- what several steps ask for ---


def _windows_in(faces: TracedFaces, seen: Openings, settings: FusionSettings) -> tuple[Windows, list[HangingLeaf]]:
    """The windows of the faces, and what hangs before these as leaves do: those that are panes are among the windows."""
    windows = windows_of(seen)
    windows = join_windows(windows, settings.windows.one_wall_m, settings.windows.height_min_m)
    leaves = find_hanging_leaves(faces, settings.building, settings.door_casings)
    return windows.append(sliding_panes(leaves)), leaves


def _parsed(faces: TracedFaces, scans: AllScans, settings: FusionSettings) -> ParsedFaces:
    return ParsedFaces.of(faces, scans.path_map, settings.standing_walls.robot_m, settings.parse)


def _count_all(scans: AllScans, faces: Walls, deepest: int) -> WallCells:
    """What all rays found of some faces, those that ended beyond windows too, down to a layer."""
    return WallCells.of_layers(scans.trace(faces, NO_WINDOWS), deepest)


def _traced(faces: Walls, scans: AllScans, settings: FusionSettings, windows: Windows = NO_WINDOWS) -> TracedFaces:
    """The faces with what rays found of them, and how high the room is before them."""
    evidence = scans.trace(faces, windows)
    return TracedFaces.of(faces, evidence, scans.storey, settings.standing_walls.ceiling_near_m)


def _traced_unseen(faces: Walls, scans: AllScans, settings: FusionSettings, windows: Windows) -> TracedFaces:
    """The same of faces that no scan saw as a plane."""
    evidence = scans.trace(faces, windows)
    return TracedFaces.of(faces, evidence, scans.storey, settings.standing_walls.ceiling_near_m, RECESS)
