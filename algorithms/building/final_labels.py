"""From the building back to the scans: the final label of every return."""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_verdicts import JudgedFaces
from ffmap.algorithms.building.levels import HeightMap, corrected
from ffmap.algorithms.building.model import CELL_M, Doors, Walls, Windows
from ffmap.algorithms.building.votes import Halo
from ffmap.algorithms.scan.doors import DoorState

_GRAZING = 0.2
"""Sine of the angle between a ray and a face below which where they cross says nothing."""

_ANOTHER_CEILING_M = 0.06
"""A ceiling that hangs so much lower than what is known of the ceiling before a wall is another room's.

What is known comes from cubes of all scans' returns, which lie as far apart as poses drift and returns scatter.
"""

_OWN_MAX_M, _OWN_BIN_M, _OWN_RETURNS = 0.06, 0.002, 20
"""A scan shows a face so far off at most, to so much, where so many of its returns tell."""
_OWN_FROM_M, _OWN_TO_M = 0.08, 0.7
"""Its foot and its top are told by what returned between these distances from floor, or ceiling."""

_LEAF_HANGS_M, _AT_LEAF_M = 0.03, 0.012
"""Over so much of a reveal, at its end, a return so far within the frame is the leaf's."""

_AT_DOOR_M = 1.0
"""What is farther before or behind a door's face has nothing to do with that door: leaves and reveals are nearer."""
_OTHER_FACE_M = 0.5
"""A doorway opens every face that stands at most so far from the door's: that of its wall's other side too."""
_LINTEL_M = 0.3
"""What lies within a wall so far above a door's head is its lintel's underside: the head is known to a cell or two."""

_FACE_GOES_ON_M, _REFUSED_GOES_ON_M = 0.1, 0.2
"""A face counts so far above the highest that was seen of it; a refused one, which no ceiling ends, farther."""
_SCAN_DOOR_RATIO = 2.0
"""What a scan called door, where the building has none, is wall up to so many wall distances from a face: it is recessed."""

_ALONG_X, _ALONG_Y, _START, _NORMAL_X, _NORMAL_Y, _OFFSET, _LENGTH = range(7)
"""The columns of `_frames`."""


class RelabellingSettings(StepSettings):
    """What the building's walls and doors change in a scan's labels."""

    wall_distance_m: float = Field(
        0.04, gt=0, description="Clutter within this many metres of a fused wall face becomes wall."
    )
    body_m: float = Field(
        0.07,
        ge=0,
        description="Clutter at most this many metres behind a face that the sensor looks at is within the wall: its scatter.",
    )
    leaf_distance_m: float = Field(
        0.1, gt=0, description="A return at most this many metres behind a closed leaf is its scatter."
    )
    margin_m: float = Field(
        0.05, ge=0, description="A wall face, or a window, counts this many metres beyond its ends."
    )
    at_reveal_m: float = Field(
        0.035, ge=0, description="A reveal or the underside of a lintel is known to this many metres."
    )
    opening_m: float = Field(
        0.015, ge=0, description="This many metres within the frame of an open door no wall stands."
    )
    refused_m: float = Field(
        0.06,
        ge=0,
        description="What a scan calls wall at most this many metres off a refused face is clutter, or outside.",
    )
    pane_m: float = Field(0.0, ge=0, description="More than this many metres behind a pane a return is outside.")
    behind_glass_m: float = Field(
        0.12,
        gt=0,
        description="The same behind a window's wall, where the pane returned nothing and its place is not known.",
    )
    forget_m: float = Field(
        0.2, gt=0, description="A wall return farther than this many metres from every fused face becomes clutter."
    )
    edge_m: float = Field(
        0.06,
        ge=0,
        le=0.2,
        description="So near both to a wall and to floor or ceiling a return is of the one that its ray meets first.",
    )
    floor_scatter_m: float = Field(
        0.015, ge=0, description="A floor seen level lies within this many metres of where its plane is."
    )
    range_scatter_m: float = Field(
        0.02,
        ge=0,
        description="A return is off by at most this many metres along its ray, which lifts it off a floor seen steeply.",
    )
    halo_ratio: float = Field(
        10.0,
        ge=1,
        description="Clutter with fewer than one in this many votes of the floor, ceiling or wall beside it is its scatter.",
    )
    halo_wall_m: float = Field(
        0.12, gt=0, description="So near one of the building's faces clutter may be a wall's scatter."
    )


@dataclass(frozen=True)
class BuildingModel:
    """What the building tells each scan's returns, in the map frame.

    walls: the faces that stand.
    before: what is before each of them: how high the ceiling hangs, and where something stands flat against it.
    judged: with the faces that were refused, whose returns are clutter, or outside. Its own `walls` are not asked.
    doors: closed ones with their leaf, open ones with nothing between their jambs.
    windows: stretches of wall; what lies beyond their panes is outside.
    levels: what lies at known heights, applied one after the other: what is no floor though scans took it for that, which
        is asked before the faces are; ceilings and raised floors; ducts, which turn what scans took for ceiling into clutter.
    """

    walls: Walls
    before: Foreground
    judged: JudgedFaces
    doors: Doors
    windows: Windows
    levels: tuple[HeightMap, ...]


class _Faces(NamedTuple):
    """Wall faces for compiled code.

    frame: (W, 7) of `_frames`. top_m: (W,) highest that was seen. first: (W + 1,) the column at which each begins.
    clear_m: (columns,) from the floor to the ceiling before it. covered: (columns, rows) whether something stands there.
    """

    frame: FloatArray
    top_m: FloatArray
    first: IntArray
    clear_m: FloatArray
    covered: BoolArray


class _Refused(NamedTuple):
    """Refused faces: frame (R, 7) of `_frames`, top_m (R,), and the label (R,) of their returns."""

    frame: FloatArray
    top_m: FloatArray
    label: UInt8Array


class _Doorways(NamedTuple):
    """Doors: frame (D, 7) of `_frames`, head_m (D,) above the floor, reveal_m (D,) how deep the reveals are.

    depth_m: (D,) of the closed leaf behind the wall's face; minus infinity where the door is open.
    """

    frame: FloatArray
    head_m: FloatArray
    depth_m: FloatArray
    reveal_m: FloatArray


class _Panes(NamedTuple):
    """Windows: frame (N, 7) of `_frames`, and how far behind their face what returns is outside, beyond_m (N,)."""

    frame: FloatArray
    beyond_m: FloatArray


class _Lengths(NamedTuple):
    """The lengths of `RelabellingSettings` that compiled code asks for, metres."""

    wall_distance_m: float
    body_m: float
    leaf_distance_m: float
    margin_m: float
    at_reveal_m: float
    opening_m: float
    refused_m: float
    forget_m: float
    edge_m: float
    floor_scatter_m: float
    range_scatter_m: float


class _Return(NamedTuple):
    """One return: its place in the map, its height above the floor and how far it is below the scan's ceiling, metres."""

    x: float
    y: float
    z: float
    height_m: float
    below_ceiling_m: float


class _AtDoor(NamedTuple):
    """What a return is to the building's doors.

    on_leaf: it is a closed leaf's. on_reveal: it is a reveal's or a lintel's, hence wall. in_opening: it is between the
    jambs of an open door. in_doorway: it is before, within or behind one, where no wall has a body.
    """

    on_leaf: bool
    on_reveal: bool
    in_opening: bool
    in_doorway: bool


def relabel(
    points_map: FloatArray,
    height_m: FloatArray,
    below_ceiling_m: FloatArray,
    label_scan: UInt8Array,
    origin_map: FloatArray,
    building: BuildingModel,
    halo: Halo,
    settings: RelabellingSettings,
) -> UInt8Array:
    """The final labels (n,): what many scans agree on overrules what one scan saw.

    A return in a closed doorway is door; wall and door only stand where the building has them; clutter on a wall
    face or on a door's reveals or lintel is wall; what a ray reached through a window is outside; clutter that is but the
    scatter of a surface is that surface's, and at the height of the building's ceiling or of a raised floor it is that;
    what scans took for ceiling and is a duct is clutter.

    points_map: (n, 3) metres in the map frame.
    height_m: (n,) metres above the floor that the scan saw, which doors' heads are measured from too.
    below_ceiling_m: (n,) metres below the scan's ceiling, infinite without one.
    label_scan: (n,) uint8, see `Label`, of the scan alone; it is not changed.
    origin_map: (3,) the sensor in the map frame, where all rays begin.
    building: what all scans together found.
    halo: the cubes in which clutter is a surface's scatter; asked before the building's levels.
    """
    walls, doors, windows, refused = building.walls, building.doors, building.windows, building.judged.refused
    before = building.before
    # What a scan took for floor on a wall is to be asked about like anything else there.
    first = [level for level in building.levels if level.surface.taken_for == Label.FLOOR]
    last = [level for level in building.levels if level.surface.taken_for != Label.FLOOR]
    label = np.asarray(
        _relabel(
            points_map,
            height_m,
            below_ceiling_m,
            corrected(first, points_map, label_scan),
            np.ascontiguousarray(origin_map, np.float64),
            _Faces(_frames(walls.ends, walls.normal), walls.top_m, before.first, before.clear_m, before.covered),
            _Refused(_frames(refused.ends, refused.normal), refused.top_m, building.judged.refused_label),
            _Doorways(
                _frames(doors.ends, doors.normal),
                doors.head_m,
                np.where(doors.state == DoorState.CLOSED, doors.depth_m, -np.inf),
                doors.reveal_m,
            ),
            _Panes(
                _frames(windows.ends, windows.normal),
                np.where(np.isfinite(windows.pane_m), windows.pane_m + settings.pane_m, settings.behind_glass_m),
            ),
            _Lengths(*(getattr(settings, name) for name in _Lengths._fields)),
        )
    )
    return corrected(last, points_map, halo.label_of(points_map, label))


def _frames(ends: FloatArray, normal: FloatArray) -> FloatArray:
    """(k, 7) for each segment: direction x y, its first end's place along it, normal x y, offset, length."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.maximum(length, 1e-9)
    start = np.sum(along * ends[:, 0], axis=1, keepdims=True)
    offset = np.sum(normal * ends[:, 0], axis=1, keepdims=True)
    return np.ascontiguousarray(np.concatenate([along, start, normal, offset, length], axis=1))


@numba.njit(cache=True, nogil=True)
def _before(frame: FloatArray, k: int, x: float, y: float) -> float:  # pragma: no cover
    """How far before the k-th segment's line a place is, metres; negative behind it."""
    return float(frame[k, _NORMAL_X] * x + frame[k, _NORMAL_Y] * y - frame[k, _OFFSET])


@numba.njit(cache=True, nogil=True)
def _is_before(frame: FloatArray, k: int, origin: FloatArray) -> bool:  # pragma: no cover
    """Whether the sensor looks at the k-th face."""
    return bool(frame[k, _NORMAL_X] * origin[0] + frame[k, _NORMAL_Y] * origin[1] > frame[k, _OFFSET])


@numba.njit(cache=True, nogil=True)
def _along(frame: FloatArray, k: int, x: float, y: float) -> float:  # pragma: no cover
    """How far along the k-th segment from its first end a place is, metres."""
    return float(frame[k, _ALONG_X] * x + frame[k, _ALONG_Y] * y - frame[k, _START])


@numba.njit(cache=True, nogil=True)
def _crossing(
    frame: FloatArray, k: int, behind_m: float, x: float, y: float, origin: FloatArray
) -> tuple[float, float]:  # pragma: no cover
    """Where a ray crosses the k-th face, or the plane so far behind it: the share of the ray's length, the place along it.

    NaN where the ray does not come from before the face, or runs along it, so that the crossing says nothing.
    """
    before = _before(frame, k, origin[0], origin[1]) + behind_m
    approach = before - (_before(frame, k, x, y) + behind_m)
    if before <= 0.0 or approach < _GRAZING * np.hypot(x - origin[0], y - origin[1]):
        return np.nan, np.nan
    share = before / approach
    cx, cy = origin[0] + share * (x - origin[0]), origin[1] + share * (y - origin[1])
    return share, _along(frame, k, cx, cy)


@numba.njit(cache=True, nogil=True)
def _own_places(
    points: FloatArray, height: FloatArray, below_ceiling: FloatArray, label_scan: UInt8Array, frame: FloatArray
) -> FloatArray:  # pragma: no cover
    """(W, 2) how far before each face the scan itself shows its foot, and its top; 0 where it shows neither.

    A pose may be off by a centimetre, and its upright by tenths of a degree, which is as much at the ceiling.
    """
    bins = int(2.0 * _OWN_MAX_M / _OWN_BIN_M)
    counts = np.zeros((len(frame), 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != Label.WALL:
            continue
        at_foot = _OWN_FROM_M < height[i] < _OWN_TO_M
        if not at_foot and not _OWN_FROM_M < below_ceiling[i] < _OWN_TO_M:
            continue
        for w in range(len(frame)):
            s = _before(frame, w, points[i, 0], points[i, 1])
            u = _along(frame, w, points[i, 0], points[i, 1])
            if abs(s) < _OWN_MAX_M and _OWN_MAX_M < u < frame[w, _LENGTH] - _OWN_MAX_M:
                counts[w, 0 if at_foot else 1, min(int((s + _OWN_MAX_M) / _OWN_BIN_M), bins - 1)] += 1
    own_m = np.full((len(frame), 2), np.nan)
    for w in range(len(frame)):
        for end in range(2):
            total = counts[w, end].sum()
            if total >= _OWN_RETURNS:
                middle = np.searchsorted(np.cumsum(counts[w, end]), 0.5 * total)
                own_m[w, end] = (middle + 0.5) * _OWN_BIN_M - _OWN_MAX_M
        for end in range(2):
            if np.isnan(own_m[w, end]):
                own_m[w, end] = 0.0 if np.isnan(own_m[w, 1 - end]) else own_m[w, 1 - end]
    return own_m


@numba.njit(cache=True, nogil=True)
def _through_window(
    at: _Return, origin: FloatArray, panes: _Panes, lengths: _Lengths
) -> tuple[bool, bool]:  # pragma: no cover
    """Whether a ray reached its return through a window; and whether that is on a window's sill, head or reveal."""
    on_reveal = False
    for g in range(len(panes.frame)):
        s = _before(panes.frame, g, at.x, at.y)
        if s > -panes.beyond_m[g]:
            # Between a window's face and its pane there is nothing but the sill, the head and the reveals.
            if s < lengths.wall_distance_m:
                u = _along(panes.frame, g, at.x, at.y)
                on_reveal = on_reveal or -lengths.margin_m < u < panes.frame[g, _LENGTH] + lengths.margin_m
            continue
        reach = _before(panes.frame, g, origin[0], origin[1])
        if reach < 0.0:
            continue
        t = reach / (reach - s)
        cx, cy = origin[0] + t * (at.x - origin[0]), origin[1] + t * (at.y - origin[1])
        if -lengths.margin_m < _along(panes.frame, g, cx, cy) < panes.frame[g, _LENGTH] + lengths.margin_m:
            return True, on_reveal
    return False, on_reveal


@numba.njit(cache=True, nogil=True)
def _at_edge(
    label: np.int64,
    at: _Return,
    origin: FloatArray,
    faces: _Faces,
    own_m: FloatArray,
    doorways: _Doorways,
    edge_m: float,
) -> np.int64 | Label:  # pragma: no cover
    """The label of a floor, ceiling or wall return near floor or ceiling, by which of them and the walls its ray meets first.

    Range is the noisy coordinate of a return, its direction is not: where the ray crosses a wall's face above the floor and
    below the ceiling it ended on the wall, and on floor or ceiling where it would reach the face beyond them.

    label: as numba holds members, for a function that returns both. own_m: from `_own_places`.
    """
    near_floor, near_a_ceiling = abs(at.height_m) < edge_m, abs(at.below_ceiling_m) < edge_m
    for d in range(len(doorways.frame)):
        # A closed leaf stands on the floor, behind its wall's face.
        depth_m = doorways.depth_m[d]
        if near_floor and depth_m >= 0.0 and abs(_before(doorways.frame, d, at.x, at.y) + depth_m) < edge_m:
            share, u = _crossing(doorways.frame, d, depth_m, at.x, at.y, origin)
            if 0.0 < u < doorways.frame[d, _LENGTH]:
                return Label.DOOR if at.height_m + (share - 1.0) * (at.z - origin[2]) > 0.0 else Label.FLOOR
    missed = False
    for w in range(len(faces.frame)):
        before_m = own_m[w, 0 if near_floor else 1]
        if abs(_before(faces.frame, w, at.x, at.y) - before_m) > edge_m:
            continue
        share, u = _crossing(faces.frame, w, -before_m, at.x, at.y, origin)
        if not 0.0 <= u <= faces.frame[w, _LENGTH]:
            continue
        rise = (share - 1.0) * (at.z - origin[2])
        cx, cy = origin[0] + share * (at.x - origin[0]), origin[1] + share * (at.y - origin[1])
        if _is_in_doorway(cx, cy, at.height_m + rise, doorways):
            continue
        column = min(int(u / CELL_M), faces.first[w + 1] - faces.first[w] - 1)
        is_other_rooms = at.height_m < faces.clear_m[faces.first[w] + column] - _ANOTHER_CEILING_M
        near_ceiling = near_a_ceiling and not is_other_rooms
        if (not near_floor or at.height_m + rise > 0.0) and (not near_ceiling or at.below_ceiling_m - rise > 0.0):
            return Label.WALL
        missed = True
    if label == Label.WALL and missed:
        return Label.FLOOR if near_floor else Label.CEILING
    return label


@numba.njit(cache=True, nogil=True)
def _is_in_doorway(x: float, y: float, height_m: float, doorways: _Doorways) -> bool:  # pragma: no cover
    """Whether a place, so high above the floor, on a face of some wall is between the jambs of one of its doors."""
    for d in range(len(doorways.frame)):
        if (
            0.0 < _along(doorways.frame, d, x, y) < doorways.frame[d, _LENGTH]
            and abs(_before(doorways.frame, d, x, y)) < _OTHER_FACE_M
            and height_m < doorways.head_m[d]
        ):
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _is_above_floor(at: _Return, origin: FloatArray, lengths: _Lengths) -> bool:  # pragma: no cover
    """Whether a floor return is too high to be the floor's scatter.

    A ray that comes in level ends on the floor, or far before it: what stands there has a foot.
    """
    fall = origin[2] - at.z
    steepness = abs(fall) / np.sqrt((at.x - origin[0]) ** 2 + (at.y - origin[1]) ** 2 + fall**2)
    return bool(at.height_m > lengths.floor_scatter_m + lengths.range_scatter_m * steepness)


@numba.njit(cache=True, nogil=True, forceinline=True)  # a call for each return would hand over all arrays
def _at_door(at: _Return, origin: FloatArray, doorways: _Doorways, lengths: _Lengths) -> _AtDoor:  # pragma: no cover
    """What a return is to the building's doors; once it is a leaf's, nothing else is asked."""
    on_reveal = False
    in_opening = False
    in_doorway = False
    for d in range(len(doorways.frame)):
        s = _before(doorways.frame, d, at.x, at.y)
        if abs(s) > _AT_DOOR_M:
            continue
        u, length = _along(doorways.frame, d, at.x, at.y), doorways.frame[d, _LENGTH]
        depth_m, head_m, reveal_m = doorways.depth_m[d], doorways.head_m[d], doorways.reveal_m[d]
        # Between the jambs of a closed door there is nothing but its leaf, its handle, and their scatter.
        if -depth_m - lengths.leaf_distance_m < s < lengths.wall_distance_m:
            share, at_leaf = _crossing(doorways.frame, d, depth_m, at.x, at.y, origin)
            rise = (share - 1.0) * (at.z - origin[2])
            if np.isnan(share):
                at_leaf, rise = u, 0.0
            if 0.0 < at_leaf < length and at.height_m + rise < head_m:
                return _AtDoor(True, on_reveal, in_opening, in_doorway)
        in_opening = in_opening or (
            depth_m < 0.0
            and lengths.opening_m < u < length - lengths.opening_m
            and at.height_m < head_m - lengths.opening_m
            and -reveal_m - lengths.margin_m < s < lengths.margin_m
        )
        in_doorway = in_doorway or (-lengths.margin_m < u < length + lengths.margin_m and at.height_m < head_m)
        # Beside the frame the wall is as deep as its other face scatters.
        deep_m = reveal_m if 0.0 < u < length else reveal_m + lengths.wall_distance_m
        if -deep_m < s < lengths.wall_distance_m and -lengths.wall_distance_m < u < length + lengths.wall_distance_m:
            # At the reveal's end an open leaf hangs, as thick as the reveal's scatter is wide.
            inner_m = _AT_LEAF_M if s < _LEAF_HANGS_M - reveal_m else lengths.at_reveal_m
            at_jamb = u < inner_m or u > length - inner_m
            at_head = head_m - lengths.at_reveal_m < at.height_m < head_m + _LINTEL_M
            on_reveal = on_reveal or at_head or (at_jamb and at.height_m < head_m)
    return _AtDoor(False, on_reveal, in_opening, in_doorway)


@numba.njit(cache=True, nogil=True)
def _nearest_face(
    at: _Return, origin: FloatArray, faces: _Faces, lengths: _Lengths
) -> tuple[float, bool, bool]:  # pragma: no cover
    """Metres to the nearest face, infinite without one; whether something stands against that; whether any has it within.

    Within a wall's body, behind a face that the sensor looks at, is what scatters.
    """
    nearest_m = np.inf
    is_covered = False
    is_within = False
    for w in range(len(faces.frame)):
        s = _before(faces.frame, w, at.x, at.y)
        in_body = -lengths.body_m < s < 0.0 and _is_before(faces.frame, w, origin)
        if abs(s) < nearest_m or in_body:
            u = _along(faces.frame, w, at.x, at.y)
            beside = -lengths.margin_m < u < faces.frame[w, _LENGTH] + lengths.margin_m
            if beside and at.height_m < faces.top_m[w] + _FACE_GOES_ON_M:
                if abs(s) < nearest_m:
                    nearest_m = abs(s)
                    column = min(max(int(u / CELL_M), 0), faces.first[w + 1] - faces.first[w] - 1)
                    row = min(max(int(at.height_m / CELL_M), 0), faces.covered.shape[1] - 1)
                    is_covered = faces.covered[faces.first[w] + column, row]
                is_within = is_within or in_body
    return nearest_m, is_covered, is_within


@numba.njit(cache=True, nogil=True)
def _label_of_refused(at: _Return, refused: _Refused, lengths: _Lengths) -> int:  # pragma: no cover
    """The label of the first refused face that a return lies on, -1 where it lies on none."""
    for f in range(len(refused.frame)):
        if abs(_before(refused.frame, f, at.x, at.y)) < lengths.refused_m:
            u = _along(refused.frame, f, at.x, at.y)
            beside = -lengths.margin_m < u < refused.frame[f, _LENGTH] + lengths.margin_m
            if beside and at.height_m < refused.top_m[f] + _REFUSED_GOES_ON_M:
                return int(refused.label[f])
    return -1


@numba.njit(cache=True, nogil=True)
def _relabel(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    origin: FloatArray,
    faces: _Faces,
    refused: _Refused,
    doorways: _Doorways,
    panes: _Panes,
    lengths: _Lengths,
) -> UInt8Array:  # pragma: no cover
    """The final labels (n,) before halo and levels are asked: return by return the first answer that decides."""
    label = label_scan.copy()
    own_m = _own_places(points, height, below_ceiling, label_scan, faces.frame)
    for i in range(len(points)):
        at = _Return(
            np.float64(points[i, 0]),
            np.float64(points[i, 1]),
            np.float64(points[i, 2]),
            np.float64(height[i]),
            np.float64(below_ceiling[i]),
        )
        is_outside, on_reveal = _through_window(at, origin, panes, lengths)
        if is_outside:
            label[i] = Label.OUTSIDE
            continue
        if label[i] == Label.FLOOR or label[i] == Label.CEILING or label[i] == Label.WALL:
            if abs(at.height_m) < lengths.edge_m or abs(at.below_ceiling_m) < lengths.edge_m:
                label[i] = _at_edge(np.int64(label[i]), at, origin, faces, own_m, doorways, lengths.edge_m)
            if label[i] == Label.FLOOR and _is_above_floor(at, origin, lengths):
                label[i] = Label.CLUTTER
            if label[i] != Label.WALL:
                continue
        door = _at_door(at, origin, doorways, lengths)
        if door.on_leaf:
            label[i] = Label.DOOR
            continue
        on_reveal = on_reveal or door.on_reveal
        if door.in_opening and not on_reveal:
            # A face goes on over its doors, but no wall stands in an open one.
            label[i] = Label.CLUTTER
            continue
        nearest_m, is_covered, is_within = _nearest_face(at, origin, faces, lengths)
        if is_covered and nearest_m < lengths.forget_m and not on_reveal:
            label[i] = Label.CLUTTER
            continue
        is_wall, is_door = label[i] == Label.WALL, label[i] == Label.DOOR
        if nearest_m > lengths.wall_distance_m and (is_wall or is_door) and not on_reveal:
            of_refused = _label_of_refused(at, refused, lengths)
            if of_refused >= 0:
                label[i] = of_refused
                continue
        is_scatter = is_within and not door.in_doorway
        if label[i] == Label.CLUTTER and (on_reveal or nearest_m < lengths.wall_distance_m or is_scatter):
            label[i] = Label.WALL
        elif is_wall and nearest_m > lengths.forget_m:
            label[i] = Label.CLUTTER
        elif is_door:
            is_faces = nearest_m < _SCAN_DOOR_RATIO * lengths.wall_distance_m
            label[i] = Label.WALL if is_faces else Label.CLUTTER
    return label
