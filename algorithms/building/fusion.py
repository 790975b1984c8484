"""The building from all scans: which faces stand, its walls, doors and windows.

The order of the steps matters: rays tell which faces stand, faces where windows are, and what was seen through those is no
face of this building.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.blinds import BlindsSettings, find_blinds
from ffmap.algorithms.building.deep_openings import tell_deep_openings
from ffmap.algorithms.building.door_casings import DoorCasingsSettings, find_cased_doors
from ffmap.algorithms.building.door_contrasts import DoorContrastsSettings, find_contrasting_doors
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.door_outlines import DoorOutlinesSettings, find_outlined_doors
from ffmap.algorithms.building.doors import (
    each_once,
    find_doors,
    lower_heads_to_overlights,
    prove_crossed,
)
from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.face_alignment import (
    AlignedFaces,
    FaceAlignmentSettings,
    align_faces,
)
from ffmap.algorithms.building.face_columns import (
    FLOOR_NEAR_M,
    FaceColumnsSettings,
    TracedFaces,
    column_places,
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
    judge_faces,
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
from ffmap.algorithms.building.glazed_doors import find_glazed_doors, panes_of_open_leaves
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings, find_low_walls, without_low_walls
from ffmap.algorithms.building.missed_walls import (
    AllReturns,
    MissedWallsSettings,
    SearchSettings,
    find_missed_walls,
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
from ffmap.algorithms.building.mullions import find_mullions
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
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
from ffmap.algorithms.building.windows import (
    WindowsSettings,
    find_windows,
    is_in_wall,
    look_deeper,
    seen_through,
    widened_in_walls,
    without_panes,
)
from ffmap.algorithms.scan.summary import concatenate, select_planes, select_scans, without_rays


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
    missed_walls: MissedWallsSettings
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
    relabelling: RelabellingSettings

    @property
    def opening_rules(self) -> OpeningRules:
        """By what doors and windows are told."""
        return OpeningRules(self.building, self.openings)

    @property
    def for_unseen_faces(self) -> BuildingSettings:
        """How rays are counted against faces that no scan saw as a plane."""
        near_m = self.missed_walls.near_m
        return self.building.for_faces().model_copy(update={"near_m": near_m, "own_plane_m": 0.0})


@dataclass(frozen=True)
class Building:
    """All that is made of all scans together.

    model: what scans are labelled by. aligned: the faces before any was judged, and those found of all scans' returns together.
    thickness_m: (W,) of the walls.
    """

    model: BuildingModel
    aligned: AlignedFaces
    thickness_m: FloatArray


def fuse_building(scans: AllScans, settings: FusionSettings) -> Building:
    """Walls from all planes, doors and windows from all rays. Raises ValueError where there is no scan."""
    aligned, judged, windows, fronts = _find_faces(scans, settings)
    aligned, judged, walls = _add_missed_walls(aligned, judged, windows.append(fronts), scans, settings)
    trimmed, doors, glass, blinds = _find_openings(walls, fronts, scans, settings)
    walls, judged = trimmed.faces.walls, judged.refuse(trimmed.leaves, FaceVerdict.ENDS_LOW)
    foreground = find_foreground(trimmed.faces, doors, settings.standing_walls.above_door_m, settings.foreground)
    low = _find_low_walls(walls, glass, scans, settings)
    is_refused = without_low_walls(judged.refused, low, settings.missed_walls.noise_m)
    judged = replace(judged, refused=judged.refused.select(is_refused), verdict=judged.verdict[is_refused])
    walls, foreground = walls.append(low), foreground.append(bare_foreground(low, scans.storey))
    thickness_m = face_thickness(walls, part_walls(walls, settings.wall_thickness))
    is_leaf = panes_of_open_leaves(glass, doors)
    windows, leaf_panes = glass.select(~is_leaf), glass.select(is_leaf)
    mullions = find_mullions(windows, partial(_count_all, scans), settings.opening_rules)
    model = BuildingModel(walls, foreground, judged, doors, windows, blinds, scans.levels, leaf_panes, mullions, low)
    return Building(model, aligned, thickness_m)


# --- faces ---


def _find_faces(scans: AllScans, settings: FusionSettings) -> tuple[AlignedFaces, JudgedFaces, Windows, Windows]:
    """The faces of the scans' planes, which of them stand, and the windows and the glazed fronts that the first round knew.

    Where there are windows, there is a second round without the planes that were seen through them.
    """
    planes = concatenate([without_rays(features) for features in scans.drive.blocks()])
    aligned = _align(fuse_walls(planes, settings.building), scans, settings)
    judged = _judge(aligned, scans, settings)
    windows, _ = _windows_in(_traced(judged.walls, scans, settings), settings)
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
    traced = without_panes(_traced(faces.select(~alone), scans, settings, windows), windows, settings.building.near_m)
    judged = judge_faces(traced, scans.path_map, settings.opening_rules, settings.face_columns, standing, settings.folds)
    judged = judged.refuse(faces.select(alone), FaceVerdict.ALONE).refuse(leaves, FaceVerdict.LEANS)
    return refuse_outside(judged, scans.storey, settings.face_columns)


def _add_missed_walls(
    aligned: AlignedFaces, judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings
) -> tuple[AlignedFaces, JudgedFaces, Walls]:
    """The faces with those that only all scans together show, and the walls that they make."""
    standing, missed = settings.standing_walls, settings.missed_walls

    trace = partial(_traced_unseen, scans=scans, settings=settings)
    widened = widened_in_walls(windows, judged.walls, missed.beside_glass_m, settings.windows)
    trace_clear = partial(trace, windows=widened) if len(windows) else None
    search = SearchSettings(settings.building, standing, settings.face_columns, missed, settings.folds)
    returns = AllReturns(scans.votes, scans.storey, scans.path_map, partial(trace, windows=windows), trace_clear)
    # What too few scans saw as a plane may be a wall that all returns together show, unless it hangs.
    hangs = judged.refused.bottom_m >= settings.building.door_height_min_m
    refused = judged.refused.select((judged.verdict != FaceVerdict.ALONE) | hangs)
    found = find_missed_walls(judged.walls, refused, returns, search)
    judged = replace(judged, walls=found.known).refuse(found.ducts, FaceVerdict.HANGS)
    judged = judged.refuse(found.mirrored, FaceVerdict.MIRRORED)
    added = _align(found.walls, scans, settings)
    walls = join_corners(judged.walls.append(added.walls), standing)
    return aligned.append(added), judged, walls


def _find_low_walls(walls: Walls, glass: Windows, scans: AllScans, settings: FusionSettings) -> Walls:
    """The sides of walls that end below the ceiling."""
    missed = settings.missed_walls
    place, weight, _ = unexplained_columns(scans.votes, walls, NO_WALLS, missed.explained_m)
    directions = wall_directions(walls, settings.standing_walls.direction_share_min)
    lines = straight_lines(place, weight, directions, missed.half_thickness_m, settings.building.gap_m)
    trace = partial(_traced_unseen, scans=scans, settings=settings, windows=glass)
    return find_low_walls(lines, walls, trace, settings.building, settings.low_walls)


# --- openings ---


def _find_glass_fronts(
    whole: Walls, judged: JudgedFaces, windows: Windows, scans: AllScans, settings: FusionSettings
) -> Windows:
    def trace(faces: Walls, known: Windows) -> WallCells:
        return scans.trace(faces, settings.for_unseen_faces, known)

    def each_scan(faces: Walls) -> Iterator[WallCells]:
        for block in scans.drive.blocks():
            if trace_rays(faces, [block], settings.for_unseen_faces).counts.any():
                for scan in block.scan:
                    yield trace_rays(faces, [select_scans(block, block.scan == scan)], settings.for_unseen_faces)

    openings = OpeningRules(settings.for_unseen_faces, settings.openings)
    rules = GlassRules(openings, settings.standing_walls, settings.glass_fronts, settings.missed_walls)
    return find_glass_fronts(whole, judged, windows, AllRays(scans.votes, scans.path_map, trace, each_scan), rules)


def _find_openings(
    walls: Walls, fronts: Windows, scans: AllScans, settings: FusionSettings
) -> tuple[TrimmedFaces, Doors, Windows, Blinds]:
    """Doors, windows and what hangs in these, and the walls' faces as the doors' reveals end them."""
    faces = _traced(walls, scans, settings)
    windows, leaves = _windows_in(faces, settings)
    fronts = new_fronts(fronts, windows, settings.glass_fronts)
    windows = windows.append(set_in_walls(fronts, walls, settings.glass_fronts))

    trace = partial(_count_all, scans)
    windows = look_deeper(windows, partial(trace, building=settings.building), settings.opening_rules, settings.windows)
    # What a window lets pass is no door's.
    clear = replace(faces, cells=scans.trace(walls, settings.building, windows)) if len(windows) else faces
    floor_before = scans.storey.floor_near(column_places(walls, faces.cells.first, 0.5 * FLOOR_NEAR_M), FLOOR_NEAR_M)
    doors = find_doors(clear, settings.opening_rules, windows, floor_before)
    cased = find_cased_doors(clear, settings.building, settings.door_casings)
    shown = pictures(clear, settings.building)
    contrasting = find_contrasting_doors(shown, settings.building, settings.door_contrasts)
    outlined = find_outlined_doors(shown, settings.building, settings.door_outlines)
    glazed = find_glazed_doors(faces, windows, settings.opening_rules)
    sliding = find_sliding_doors(leaves, doors, settings.building)
    doors = doors.append(sliding).append(cased).append(contrasting).append(outlined).append(glazed)
    doors = place_frames(doors, walls, scans.drive.blocks(), settings.building, settings.door_frames)
    doors = lower_heads_to_overlights(doors, windows, settings.opening_rules)
    doors = prove_crossed(each_once(doors, settings.opening_rules), scans.path_map)
    doors, deep_windows = tell_deep_openings(doors, trace, settings.opening_rules)
    windows = windows.append(deep_windows)
    through_m = doors.reveal_m
    doors = measure_reveals(doors, scans.drive.blocks(), settings.door_frames)
    parts = part_walls(walls, settings.wall_thickness)
    depth_m = door_depths(doors, walls, parts, settings.wall_thickness, settings.building.reveal_m, through_m)
    doors = replace(doors, reveal_m=depth_m)
    blinds = find_blinds(windows, faces, settings.building, settings.blinds)
    return trim_at_doorways(faces, doors, settings.standing_walls), doors, windows, blinds


# --- what several steps ask for ---


def _windows_in(faces: TracedFaces, settings: FusionSettings) -> tuple[Windows, list[HangingLeaf]]:
    """The windows of the faces, and what hangs before these as leaves do: those that are panes are among the windows."""
    windows = find_windows(faces, settings.opening_rules, settings.windows)
    leaves = find_hanging_leaves(faces, settings.building, settings.door_casings)
    return windows.append(sliding_panes(leaves)), leaves


def _count_all(scans: AllScans, faces: Walls, building: BuildingSettings) -> WallCells:
    """What all rays found of some faces, those that ended beyond windows too."""
    return scans.trace(faces, building, NO_WINDOWS)


def _traced(faces: Walls, scans: AllScans, settings: FusionSettings, windows: Windows = NO_WINDOWS) -> TracedFaces:
    """The faces with what rays found of them, and how high the room is before them."""
    cells = scans.trace(faces, settings.building, windows)
    return TracedFaces.of(faces, cells, scans.storey, settings.standing_walls.ceiling_near_m)


def _traced_unseen(faces: Walls, scans: AllScans, settings: FusionSettings, windows: Windows) -> TracedFaces:
    """The same of faces that no scan saw as a plane."""
    cells = scans.trace(faces, settings.for_unseen_faces, windows)
    return TracedFaces.of(faces, cells, scans.storey, settings.standing_walls.ceiling_near_m)
