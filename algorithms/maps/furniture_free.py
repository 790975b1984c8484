"""Occupied cells of the furniture-free grid: walls as thin lines, doorways cut out (Fig. 9b)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import Segment, lengthened, segments
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    NO_DOORS,
    Doors,
    Walls,
    Windows,
    stretches,
)
from ffmap.algorithms.building.parse import Kind, Stretch
from ffmap.algorithms.building.thickness import WallThicknessSettings, face_thickness, part_walls
from ffmap.algorithms.maps.free_space import Draft
from ffmap.algorithms.maps.grid import GridMap, GridMapSettings
from ffmap.algorithms.scan.doors import DoorState

_OPEN = Kind.DOORWAY, Kind.LEAF_DEEP, Kind.LEAF_FAR, Kind.PANE, Kind.PASSAGE
"""What a face is open at, down to the floor: behind a recess within the wall it is not."""
_DOOR_MARGIN_M = 0.1
"""Free space (m) of a doorway beyond both sides of its wall."""
_DOOR_GUESSED_M = 0.3
"""Minimum depth (m) of a doorway whose wall's thickness is not measured."""
_GAP_MAX_M = 0.6
"""Maximum width (m) of a gap beside or in a window's wall that is no passage."""
_SILL_MIN_M = 0.3
"""Minimum height (m) of a window's sill above the floor."""
_RECESS_MAX_M, _RECESS_BESIDE_M = 0.6, 0.12
"""Maximum depth (m) of a window's recess, and distance (m) of its sides from the window's ends."""
_LEAF_ABOVE_M = 0.3
"""Maximum height (m) of an open leaf's face above its door's head."""
_LEAF_BESIDE_M = 0.1
"""Maximum distance (m) from the doorway of the reveal that an open leaf's face continues."""
_NO_FACES: FloatArray = np.zeros((0, 2, 2))


@dataclass(frozen=True)
class Immobile:
    """The fixed structure of a building.

    parsed: the stretches of each wall, but of low walls, which come last and are wall all along.
    passages: openings without leaves, free in any case.
    """

    walls: Walls
    parsed: Sequence[Sequence[Stretch]]
    doors: Doors
    windows: Windows
    passages: Doors = NO_DOORS


def draft_furniture_free(
    immobile: Immobile,
    standing: Walls,
    frame: GridMap,
    settings: GridMapSettings,
    thickness: WallThicknessSettings,
) -> Draft:
    """Draw each visible side of a wall as a line, and cut doorways through the whole wall.

    The inside of walls stays unknown, and so do panes, which block rays.

    standing: see `standing_stretches`.
    """
    doors = immobile.doors.append(immobile.passages)
    has_leaf = np.arange(len(doors)) < len(immobile.doors)
    occupied = np.zeros(frame.cells.shape, bool)
    for ends in standing.ends:
        occupied[frame.on_line(ends)] = True
    doorways = _doorways(doors, immobile.walls, thickness, frame.cell_m)
    for doorway in doorways:
        occupied[frame.in_area(doorway)] = False
    behind = doors.ends - (doors.reveal_m[:, None] * doors.normal)[:, None]
    for reveal in np.stack([doors.ends, behind], axis=2).reshape(-1, 2, 2):
        occupied[frame.on_line(reveal)] = True
    shut = has_leaf & (settings.doors == "closed")
    if settings.doors == "as-seen":
        shut = doors.state == DoorState.CLOSED
    open_ways = [doorway for doorway, is_shut in zip(doorways, shut, strict=True) if not is_shut]
    blocked = _blocked(occupied, frame, immobile.windows, immobile.walls.ends, open_ways)
    # Leaves block no rays: those that passed an open door showed the room behind it.
    leaves = doors.ends - (np.nan_to_num(doors.depth_m)[:, None] * doors.normal)[:, None]
    return Draft(occupied, blocked, open_ways, list(leaves[shut]), hides_walls=True)


def draft_cells(places: FloatArray, frame: GridMap, windows: Windows) -> Draft:
    """Draw a map whose occupied cells are at places (n, 2), without any door."""
    occupied = np.zeros(frame.cells.shape, bool)
    occupied[frame.at(places)] = True
    return Draft(occupied, _blocked(occupied, frame, windows))


def standing_stretches(immobile: Immobile) -> Walls:
    """Cut walls into the stretches that are wall down to the floor.

    Left out are:
    - openings down to the floor;
    - the reveals of windows, below which the wall continues;
    - the leaves of open doors.
    """
    walls = immobile.walls
    owner: list[int] = []
    found: list[FloatArray] = []
    for w, face in enumerate(segments(walls)):
        stands = np.ones(int(np.ceil(face.length_m / CELL_M - 1e-6)), bool)
        for own in immobile.parsed[w] if w < len(immobile.parsed) else ():
            stands[own.columns] &= own.kind not in _OPEN
        middles = face.at((np.arange(len(stands)) + 0.5) * CELL_M)
        stands &= ~_in_window_reveal(middles, face.normal, immobile.windows)
        stands &= ~_of_open_leaf(middles, float(walls.top_m[w]), immobile.doors)
        for first, last in stretches(stands):
            ends_m = [first * CELL_M, min((last + 1) * CELL_M, face.length_m)]
            owner.append(w)
            found.append(face.at(np.array(ends_m)))
    chosen = walls.select(np.array(owner, np.int64))
    return replace(chosen, ends=np.array(found).reshape(-1, 2, 2))


def _in_window_reveal(places: FloatArray, normal: FloatArray, windows: Windows) -> BoolArray:
    """(c,) whether places (c, 2) of a face are in the recess of a window with a sill."""
    within = np.zeros(len(places), bool)
    for window, bottom_m in zip(segments(windows), windows.bottom_m, strict=True):
        if bottom_m < _SILL_MIN_M or abs(normal @ window.normal) > 0.9:  # parallel, to 26°
            continue
        behind_m = -window.before_m(places)
        in_recess = (behind_m > 0) & (behind_m < _RECESS_MAX_M)
        within |= in_recess & window.beside(places, _RECESS_BESIDE_M)
    return within


def _of_open_leaf(places: FloatArray, top_m: float, doors: Doors) -> BoolArray:
    """(c,) which places (c, 2) of a face belong to an open leaf, beyond the reveal it continues.

    A face is a leaf if it is within a leaf's length of a jamb, and as high as the door.
    """
    leaf = np.zeros(len(places), bool)
    may_be = (doors.state == DoorState.OPEN) & (top_m < doors.head_m + _LEAF_ABOVE_M)
    for doorway, reveal_m in zip(
        segments(doors.select(may_be)), doors.reveal_m[may_be], strict=True
    ):
        behind_m = -doorway.before_m(places)
        beyond = (behind_m < -_LEAF_BESIDE_M) | (behind_m > reveal_m + _LEAF_BESIDE_M)
        reach_m = doorway.length_m + reveal_m + _LEAF_BESIDE_M
        for jamb in doorway.at(np.array([0.0, doorway.length_m])):
            if np.linalg.norm(places - jamb, axis=1).max() < reach_m:
                leaf |= beyond
    return leaf


def _doorways(
    doors: Doors, walls: Walls, thickness: WallThicknessSettings, inset_m: float
) -> list[FloatArray]:
    """(4, 2) corners of what each doorway leaves free, from before the wall to behind it."""
    parts = part_walls(walls, thickness)
    # Where the thickness is a guess, or a leaf hid the wall's other side, a doorway rather ends in
    # the room behind.
    guessed = np.isnan(face_thickness(walls, parts)[doors.wall])
    guessed |= doors.state == DoorState.CLOSED
    depth_m = np.where(guessed, np.maximum(doors.reveal_m, _DOOR_GUESSED_M), doors.reveal_m)
    doorways = []
    for sill, behind_m in zip(segments(doors), depth_m, strict=True):
        left, right = sill.at(np.array([inset_m, sill.length_m - inset_m]))
        front, back = _DOOR_MARGIN_M * sill.normal, -(behind_m + _DOOR_MARGIN_M) * sill.normal
        doorways.append(np.array([left + front, right + front, right + back, left + back]))
    return doorways


def _blocked(
    occupied: BoolArray,
    frame: GridMap,
    windows: Windows,
    faces: FloatArray = _NO_FACES,
    doorways: Sequence[FloatArray] = (),
) -> BoolArray:
    """What blocks rays: occupied cells, panes, and gaps beside panes too narrow to pass.

    What glass shows is not part of the building. faces: (F, 2, 2) of walls, some with windows.
    """
    blocked = occupied.copy()
    for ends in windows.ends:
        blocked[frame.on_line(ends)] = True
    passages = shapely.MultiPolygon([shapely.Polygon(corners) for corners in doorways])
    middles = windows.ends.mean(axis=1)
    for ends in faces:
        face = Segment.between(ends)
        in_face = (np.abs(face.before_m(middles)) < AT_FACE_M) & face.beside(middles)
        if (in_face & (np.abs(windows.normal @ face.along) < 0.1)).any():
            _close_gaps(blocked, face, frame, passages)
    for ends in lengthened(windows.ends, _GAP_MAX_M):
        _close_gaps(blocked, Segment.between(ends), frame, passages)
    return blocked


def _close_gaps(
    blocked: BoolArray, line: Segment, frame: GridMap, passages: shapely.Geometry
) -> None:
    """Block the gaps along a line that are narrow, and no passage."""
    step_m = frame.cell_m / 4
    places = line.at(np.linspace(0.0, line.length_m, int(line.length_m / step_m) + 2))
    closed = np.zeros(len(places), bool)
    for side in (-1, 0, 1):
        index, _ = frame.index(places + side * frame.cell_m * line.normal)
        column, row = np.clip(index, 0, np.array(blocked.shape[::-1]) - 1).T
        closed |= blocked[row, column]
    for first, last in stretches(~closed, 0):
        bounded = first > 0 and last < len(places) - 1 and (last - first) * step_m < _GAP_MAX_M
        if bounded and not passages.intersects(shapely.LineString(places[[first, last]])):
            blocked[frame.on_line(places[[first - 1, last + 1]])] = True
