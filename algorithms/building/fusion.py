"""The building from all scans: which faces are walls, their doors and windows.

planes of all scans ── fuse ──┐
returns of all scans ── lines ┴── trace ── parse ── judge ── walls, doors, windows
                                                   └── again, without rays through panes
"""

from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.building.door_frames import measure_reveals, place_frames
from ffmap.algorithms.building.doors import are_passages, each_once, prove_crossed
from ffmap.algorithms.building.drive import AllScans
from ffmap.algorithms.building.evidence import ON
from ffmap.algorithms.building.face_foreground import (
    ForegroundSettings,
    bare_foreground,
    find_foreground,
)
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings
from ffmap.algorithms.building.flush_doors import find_flush_doors
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings, along_low_walls, find_low_walls
from ffmap.algorithms.building.model import (
    BuildingSettings,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import (
    Opening,
    ParsedFaces,
    Run,
    blinds_of,
    doors_of,
    find_openings,
    fronts_of,
    glazed_doors_of,
    judge,
    mostly_stands,
    openings_in,
    windows_of,
)
from ffmap.algorithms.building.storey import CEILING_NEAR_M, Storey, TracedFaces, room_before
from ffmap.algorithms.building.thickness import (
    WallThicknessSettings,
    door_depths,
    face_thickness,
    part_walls,
)
from ffmap.algorithms.building.unseen_walls import (
    Columns,
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
    wall_directions,
)
from ffmap.algorithms.building.windows import (
    is_in_wall,
    join_windows,
    panes_of_open_leaves,
)
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import concatenate, without_rays

_BELOW_CEILING_M, _WALL_M = 0.35, 2.25
"""Walls reach up to this far (m) below the ceiling, or higher than this (m)."""


@dataclass(frozen=True)
class FusionSettings:
    """The settings of every step that makes the building."""

    building: BuildingSettings
    levels: LevelsSettings
    parse: ParseSettings
    standing_walls: StandingWallsSettings
    unseen_walls: UnseenWallsSettings
    low_walls: LowWallsSettings
    foreground: ForegroundSettings
    wall_thickness: WallThicknessSettings
    relabelling: RelabellingSettings


@dataclass(frozen=True)
class Building:
    """All that is made of all scans together.

    model: what scans are labelled by. fused: the faces before any was judged. parsed: the walls
    but for low ones, with what rays found of them. refused: the same of refused faces, but for
    those that were not parsed.
    thickness_m: (W,) of the walls.
    """

    model: BuildingModel
    parsed: ParsedFaces
    refused: ParsedFaces
    fused: Walls
    thickness_m: FloatArray


@dataclass(frozen=True)
class _Candidates:
    """All faces that may be walls.

    faces: first those that scans see as planes, `planes` of them, then lines that only all scans
    together show, from both sides: `straight` along the walls' directions, then of any direction.
    fused: all planes.
    """

    faces: Walls
    planes: int
    straight: int
    fused: Walls

    @property
    def lines(self) -> IntArray:
        """Numbers of the faces that no scan sees as a plane."""
        return np.arange(self.planes, len(self.faces))


@dataclass(frozen=True)
class _Parsed:
    """Parsed faces and their openings."""

    faces: ParsedFaces
    openings: list[Opening]


def fuse_building(scans: AllScans, settings: FusionSettings) -> Building:
    """Fuse walls from all planes, doors and windows from all rays.

    Each ray is booked once in the cells of all candidates, and these are parsed. Rays that ended
    beyond the panes found so are subtracted, and the faces that they met are parsed again.

    Raises ValueError where there is no scan.
    """
    candidates = _find_candidates(scans, settings)
    traced = TracedFaces.of(candidates.faces, scans.trace(candidates.faces), scans.storey)
    seen = _parse(traced, scans, settings)
    panes = windows_of([own for own in seen.openings if own.wall < candidates.planes])
    fronts = _find_fronts(candidates, seen, scans, settings)
    glass = join_windows(panes.append(fronts))
    clear = _without_outside(seen, glass, scans, settings)
    judged, walls, runs = _judge(candidates, seen, clear, scans, settings)
    in_walls = openings_in(seen.openings, runs)
    panes = windows_of(in_walls).append(panes.select(~is_in_wall(panes, walls)))
    windows = join_windows(panes.append(fronts))
    found = openings_in(clear.openings, runs)
    doors = doors_of(found, settings.building)
    doors = doors.append(glazed_doors_of(in_walls, settings.building))
    parsed = clear.faces.part(runs)
    doors = doors.append(find_flush_doors(parsed, settings.building))
    placed = _place_doors(doors, walls, scans, settings)
    passed = are_passages(placed, settings.building) & (placed.state == DoorState.OPEN)
    doors = placed.select(~passed)
    foreground = find_foreground(parsed.faces, parsed.opening, doors, settings.foreground)
    low = find_low_walls(clear.faces, walls, settings.low_walls)
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
        blinds_of(in_walls),
        scans.levels,
        leaf_panes=windows.select(is_leaf),
        low_walls=low,
        passages=placed.select(passed),
    )
    of_refused = clear.faces.part(refused.support.runs)
    return Building(model, parsed, of_refused, candidates.fused, thickness_m)


def _find_candidates(scans: AllScans, settings: FusionSettings) -> _Candidates:
    """The planes of all scans, fused, and lines of returns that none of these explains."""
    planes = concatenate([without_rays(features) for features in scans.drive.blocks()])
    fused = fuse_walls(planes, settings.building)
    faces = join_corners(fused, fused, settings.standing_walls)
    columns = unexplained_columns(scans.votes, faces, settings.unseen_walls)
    straight = _straight_lines(columns, faces, scans, settings)
    lines = straight.append(_chords(columns, scans, settings))
    lines = join_corners(lines, faces, settings.standing_walls)
    return _Candidates(faces.append(lines), len(faces), len(straight), fused)


def _straight_lines(
    columns: Columns, known: Walls, scans: AllScans, settings: FusionSettings
) -> Walls:
    """Lines of returns along the walls' directions, from both sides."""
    high = _reaches_up(known.ends.mean(axis=1), known.top_m, scans.storey)
    share_min = settings.standing_walls.direction_share_min
    directions = wall_directions(known.select(high), share_min)
    gap_m = settings.building.gap_m
    return both_sides(straight_lines(columns, directions, gap_m, settings.unseen_walls))


def _chords(columns: Columns, scans: AllScans, settings: FusionSettings) -> Walls:
    """Lines of returns of any direction, as high as walls are, from both sides."""
    top_m = columns.top_m - scans.storey.ground_m(columns.place)
    high = _reaches_up(columns.place, top_m, scans.storey)
    return both_sides(lines_of_any_direction(columns.place[high], settings.unseen_walls))


def _reaches_up(places: FloatArray, top_m: FloatArray, storey: Storey) -> BoolArray:
    """(k,) whether what stands at places (k, 2) reaches as high as walls do."""
    clear_m = storey.clear_m(places, CEILING_NEAR_M)
    return np.asarray(top_m > np.fmin(clear_m - _BELOW_CEILING_M, _WALL_M))


def _parse(traced: TracedFaces, scans: AllScans, settings: FusionSettings) -> _Parsed:
    parsed = ParsedFaces.of(traced, scans.path_map, settings.building, settings.parse)
    openings = find_openings(parsed, scans.trace_within)
    return _Parsed(*parsed.with_panes_told(openings, settings.building))


def _find_fronts(
    candidates: _Candidates, seen: _Parsed, scans: AllScans, settings: FusionSettings
) -> Windows:
    """The panes that lines show, such as glazed fronts."""
    straight = candidates.lines[: candidates.straight]
    gaps = seen.faces.part([seen.faces.faces.whole(w) for w in straight])
    fronts = fronts_of(find_openings(gaps.gaps_as_panes(), scans.trace_within))
    # Nobody glazes a wall: a sheet so close before one is the edges of a shelf's boards.
    middles, depth_m = fronts.ends.mean(axis=1), settings.unseen_walls.shelf_m
    walls = candidates.faces.select(slice(candidates.planes))
    shelves = near_a_face(middles, fronts.normal, walls, 0.0, depth_m)
    return fronts.select(along_others(fronts, walls, settings.standing_walls) & ~shelves)


def _without_outside(
    seen: _Parsed, glass: Windows, scans: AllScans, settings: FusionSettings
) -> _Parsed:
    """The same by the rays that did not come through panes."""
    if not len(glass):
        return seen
    faces = seen.faces.faces
    beyond = scans.trace_beyond(faces.walls, glass)
    met = [w for w in range(len(faces)) if beyond.ended[beyond.columns(w)].any()]
    rest = replace(faces, evidence=faces.evidence.minus(beyond))
    again = _parse(rest.part([rest.whole(w) for w in met]), scans, settings)
    stretches = list(seen.faces.stretches)
    for k, w in enumerate(met):
        stretches[w] = again.faces.stretches[k]
    openings = [own for own in seen.openings if own.wall not in met]
    openings += [replace(own, wall=met[own.wall]) for own in again.openings]
    return _Parsed(ParsedFaces(rest, tuple(stretches)), openings)


def _judge(
    candidates: _Candidates,
    seen: _Parsed,
    clear: _Parsed,
    scans: AllScans,
    settings: FusionSettings,
) -> tuple[JudgedFaces, Walls, list[Run]]:
    """Which faces and lines are walls, and which parts of the candidates they are."""
    standing = settings.standing_walls
    planes = candidates.faces.select(slice(candidates.planes))
    outside = np.array([_is_outside(seen, clear, w) for w in range(len(planes))], bool)
    doubtful = (planes.scan_count < standing.scans_few) & ~along_others(planes, planes, standing)
    judged, runs = judge(clear.faces, doubtful, settings.unseen_walls.odds_min, settings.building)
    number = np.array([w for w, *_ in runs], np.int64)
    within = room_before(judged.walls, scans.storey) & ~outside[number]
    beyond = judged.walls.select(~within)
    judged = replace(judged, walls=judged.walls.select(within))
    judged = judged.refuse(beyond, FaceVerdict.OUTSIDE)
    runs = [run for run, stands in zip(runs, within, strict=True) if stands]
    unseen, more = walls_of(
        clear.faces, candidates.lines, judged.walls, settings.building, settings.unseen_walls
    )
    # A wall that all rays together pass is a mirror image in a pane.
    stands = room_before(unseen, scans.storey)
    stands &= np.array([mostly_stands(seen.faces, run) for run in more], bool)
    runs += [run for run, own in zip(more, stands, strict=True) if own]
    return judged, judged.walls.append(unseen.select(stands)), runs


def _is_outside(seen: _Parsed, clear: _Parsed, w: int) -> bool:
    """Whether most of what rays found of a face they found through panes."""
    own = seen.faces.faces.columns(w)
    left, whole = (p.faces.faces.evidence.ended[own, :, ON].sum() for p in (clear, seen))
    return bool(left < 0.5 * whole)


def _place_doors(doors: Doors, walls: Walls, scans: AllScans, settings: FusionSettings) -> Doors:
    """The doors with their edges to a centimetre, each once, and how deep they are."""
    blocks = scans.drive.blocks
    doors = place_frames(doors, walls, blocks(), settings.building)
    doors = prove_crossed(each_once(doors, settings.building), scans.path_map)
    through_m = doors.reveal_m
    doors = measure_reveals(doors, blocks())
    thickness = settings.wall_thickness
    parts, unknown_m = part_walls(walls, thickness), settings.building.reveal_m
    depth_m = door_depths(doors, walls, parts, thickness, unknown_m, through_m)
    return replace(doors, reveal_m=depth_m)
