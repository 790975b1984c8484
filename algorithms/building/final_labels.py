"""From the building back to the scans: the final label of every return."""

from collections import namedtuple
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import Lines, along_line, before_line, crossing
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_verdicts import JudgedFaces
from ffmap.algorithms.building.levels import HeightMap, corrected
from ffmap.algorithms.building.model import CELL_M, Doors, Walls, Windows
from ffmap.algorithms.building.votes import Halo
from ffmap.algorithms.scan.doors import DoorState


class RelabellingSettings(StepSettings):
    """What the building's walls and doors change in a scan's labels."""

    wall_distance_m: float = Field(
        0.04, gt=0, description="Maximum distance (m) from a wall's face of clutter that becomes wall."
    )
    body_m: float = Field(
        0.07,
        ge=0,
        description="Maximum distance (m) behind a face that the sensor looks at of clutter that is the wall's scatter.",
    )
    face_above_m: float = Field(
        0.1, ge=0, description="A face counts this far (m) above the highest that was seen of it."
    )
    leaf_distance_m: float = Field(
        0.1, gt=0, description="Maximum distance (m) behind a closed leaf of a return that is its scatter."
    )
    margin_m: float = Field(0.05, ge=0, description="A wall's face, or a window, counts this far (m) beyond its ends.")
    at_reveal_m: float = Field(
        0.035, ge=0, description="Maximum distance (m) of a return from the reveal or lintel that it is part of."
    )
    opening_m: float = Field(
        0.015, ge=0, description="Distance (m) from the frame of an open door beyond which no wall stands in it."
    )
    at_door_m: float = Field(
        1.0,
        gt=0,
        description="Farther (m) before or behind a door's face nothing belongs to the door: leaves are nearer.",
    )
    other_face_m: float = Field(
        0.5, gt=0, description="Maximum distance (m) from a door's face of other faces that its doorway opens too."
    )
    lintel_m: float = Field(
        0.3, ge=0, description="Maximum height (m) above a door's head of returns that are the underside of its lintel."
    )
    leaf_hangs_m: float = Field(
        0.03, ge=0, description="Width (m) at a reveal's end where the leaf of an open door hangs."
    )
    at_leaf_m: float = Field(
        0.012, ge=0, description="The same as at_reveal_m there: what is farther from it is the leaf."
    )
    scan_door_ratio: float = Field(
        2.0,
        ge=0,
        description="What a scan calls door is wall up to this many wall distances from a face: it is recessed.",
    )
    refused_m: float = Field(
        0.06,
        ge=0,
        description="Maximum distance (m) from a refused face of what a scan calls wall and is clutter, or outside.",
    )
    refused_above_m: float = Field(
        0.2, ge=0, description="The same as face_above_m of a refused face, which no ceiling ends."
    )
    pane_m: float = Field(0.0, ge=0, description="Distance (m) behind a pane beyond which a return is outside.")
    behind_glass_m: float = Field(
        0.12,
        gt=0,
        description="The same behind a window's wall, where the pane returned nothing and its place is not known.",
    )
    forget_m: float = Field(
        0.2, gt=0, description="Distance (m) from every wall's face beyond which what a scan calls wall is clutter."
    )
    edge_m: float = Field(
        0.06,
        ge=0,
        le=0.2,
        description="Maximum distance (m) both from a wall and from floor or ceiling of a return that is of the one that its "
        "ray meets first.",
    )
    another_ceiling_m: float = Field(
        0.06,
        ge=0,
        description="A ceiling this far (m) below the one before a wall is another room's: poses drift, returns scatter.",
    )
    grazing_sine: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Sine of the angle between a ray and a face below which the place where they cross says nothing.",
    )
    own_max_m: float = Field(
        0.06,
        gt=0,
        description="Maximum distance (m) of a face from where a scan itself shows it: poses are off by less.",
    )
    own_from_m: float = Field(
        0.08, ge=0, description="Distance (m) from floor and ceiling from which returns tell where a scan shows a face."
    )
    own_to_m: float = Field(0.7, gt=0, description="Distance (m) from floor and ceiling up to which they do.")
    own_returns_min: int = Field(20, ge=1, description="Minimum returns that tell where a scan shows a face.")
    floor_scatter_m: float = Field(
        0.015, ge=0, description="Maximum height (m) above the floor of returns of the floor itself, seen level."
    )
    range_scatter_m: float = Field(
        0.02,
        ge=0,
        description="Maximum error (m) of a return along its ray, which lifts it off a floor that is seen steeply.",
    )
    halo_ratio: float = Field(
        10.0,
        ge=1,
        description="Clutter with fewer than one in this many votes of the surface beside it is its scatter.",
    )
    halo_wall_m: float = Field(
        0.12, gt=0, description="Maximum distance (m) from a face of clutter that may be the wall's scatter."
    )


@dataclass(frozen=True)
class BuildingModel:
    """What the building tells each scan's returns, in the map frame.

    walls: the faces that stand. before: how high the ceiling hangs before each, and where something stands flat against it.
    judged: with the faces that were refused, whose returns are clutter, or outside. Its own `walls` are not asked.
    levels: what lies at known heights, applied one after the other; false floors are asked before the faces are.
    """

    walls: Walls
    before: Foreground
    judged: JudgedFaces
    doors: Doors
    windows: Windows
    levels: tuple[HeightMap, ...]


class _Faces(NamedTuple):
    """Wall faces for compiled code.

    lines: the W faces. top_m: (W,) highest that was seen. first: (W + 1,) the column at which each begins.
    clear_m: (columns,) from the floor to the ceiling before it. covered: (columns, rows) whether something stands there.
    """

    lines: Lines
    top_m: FloatArray
    first: IntArray
    clear_m: FloatArray
    covered: BoolArray


class _Refused(NamedTuple):
    """Refused faces: their lines, top_m (R,), and the label (R,) of their returns."""

    lines: Lines
    top_m: FloatArray
    label: UInt8Array


class _Doorways(NamedTuple):
    """Doors: the lines of their sills, head_m (D,) above the floor, reveal_m (D,) how deep the reveals are.

    depth_m: (D,) of the closed leaf behind the wall's face; minus infinity where the door is open.
    """

    lines: Lines
    head_m: FloatArray
    depth_m: FloatArray
    reveal_m: FloatArray


class _Panes(NamedTuple):
    """Windows: their lines, and how far behind their face what returns is outside, beyond_m (N,)."""

    lines: Lines
    beyond_m: FloatArray


if TYPE_CHECKING:
    _Rules = RelabellingSettings
else:  # compiled code takes named tuples
    _Rules = namedtuple("_Rules", RelabellingSettings.model_fields)


class _Return(NamedTuple):
    """One return: its place in the map, its height above the floor and below the scan's ceiling, metres."""

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

    points_map: (n, 3). height_m: (n,) above the floor that the scan saw, which doors' heads are measured from too.
    below_ceiling_m: (n,) below the scan's ceiling, infinite without one. label_scan: (n,) of the scan alone; not changed.
    origin_map: (3,) the sensor. halo: the cubes in which clutter is a surface's scatter; asked before the building's levels.
    """
    walls, before, refused = building.walls, building.before, building.judged.refused
    doors, windows = building.doors, building.windows
    leaf_m = np.where(doors.state == DoorState.CLOSED, doors.depth_m, -np.inf)
    beyond_m = np.where(np.isfinite(windows.pane_m), windows.pane_m + settings.pane_m, settings.behind_glass_m)
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
            _Faces(Lines.of(walls), walls.top_m, before.first, before.clear_m, before.covered),
            _Refused(Lines.of(refused), refused.top_m, building.judged.refused_label),
            _Doorways(Lines.of(doors), doors.head_m, leaf_m, doors.reveal_m),
            _Panes(Lines.of(windows), beyond_m),
            _Rules(**settings.model_dump()),
        )
    )
    return corrected(last, points_map, halo.label_of(points_map, label))


@numba.njit(cache=True, nogil=True)
def _own_places(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    lines: Lines,
    rules: _Rules,
) -> FloatArray:  # pragma: no cover
    """(W, 2) how far before each face the scan itself shows its foot, and its top; 0 where it shows neither.

    A pose may be off by a centimetre, and its upright by tenths of a degree, which is as much at the ceiling.
    """
    bin_m, most_m = 0.002, rules.own_max_m
    bins = int(2.0 * most_m / bin_m)
    faces = len(lines.length)
    counts = np.zeros((faces, 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != Label.WALL:
            continue
        at_foot = rules.own_from_m < height[i] < rules.own_to_m
        if not at_foot and not rules.own_from_m < below_ceiling[i] < rules.own_to_m:
            continue
        for w in range(faces):
            s = before_line(lines, w, points[i, 0], points[i, 1])
            u = along_line(lines, w, points[i, 0], points[i, 1])
            if abs(s) < most_m and most_m < u < lines.length[w] - most_m:
                counts[w, 0 if at_foot else 1, min(int((s + most_m) / bin_m), bins - 1)] += 1
    own_m = np.full((faces, 2), np.nan)
    for w in range(faces):
        for end in range(2):
            total = counts[w, end].sum()
            if total >= rules.own_returns_min:
                middle = np.searchsorted(np.cumsum(counts[w, end]), 0.5 * total)
                own_m[w, end] = (middle + 0.5) * bin_m - most_m
        for end in range(2):
            if np.isnan(own_m[w, end]):
                own_m[w, end] = 0.0 if np.isnan(own_m[w, 1 - end]) else own_m[w, 1 - end]
    return own_m


@numba.njit(cache=True, nogil=True)
def _through_window(
    at: _Return, origin: FloatArray, panes: _Panes, rules: _Rules
) -> tuple[bool, bool]:  # pragma: no cover
    """Whether a ray reached its return through a window; and whether that is on a window's sill, head or reveal."""
    on_reveal = False
    for g in range(len(panes.lines.length)):
        s = before_line(panes.lines, g, at.x, at.y)
        if s > -panes.beyond_m[g]:
            # Between a window's face and its pane there is nothing but the sill, the head and the reveals.
            if s < rules.wall_distance_m:
                u = along_line(panes.lines, g, at.x, at.y)
                on_reveal = on_reveal or -rules.margin_m < u < panes.lines.length[g] + rules.margin_m
            continue
        _, u = crossing(panes.lines, g, 0.0, at.x, at.y, origin, 0.0)
        if -rules.margin_m < u < panes.lines.length[g] + rules.margin_m:
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
    rules: _Rules,
) -> np.int64 | Label:  # pragma: no cover
    """The label of a floor, ceiling or wall return near floor or ceiling, by which of them and the walls its ray meets first.

    Range is the noisy coordinate of a return, its direction is not: where the ray crosses a wall's face above the floor and
    below the ceiling it ended on the wall, and on floor or ceiling where it would reach the face beyond them.

    label: as numba holds members, for a function that returns both. own_m: from `_own_places`.
    """
    edge_m = rules.edge_m
    near_floor, near_a_ceiling = abs(at.height_m) < edge_m, abs(at.below_ceiling_m) < edge_m
    for d in range(len(doorways.lines.length)):
        # A closed leaf stands on the floor, behind its wall's face.
        depth_m = doorways.depth_m[d]
        if near_floor and depth_m >= 0.0 and abs(before_line(doorways.lines, d, at.x, at.y) + depth_m) < edge_m:
            share, u = crossing(doorways.lines, d, depth_m, at.x, at.y, origin, rules.grazing_sine)
            if 0.0 < u < doorways.lines.length[d]:
                return Label.DOOR if at.height_m + (share - 1.0) * (at.z - origin[2]) > 0.0 else Label.FLOOR
    missed = False
    for w in range(len(faces.lines.length)):
        before_m = own_m[w, 0 if near_floor else 1]
        if abs(before_line(faces.lines, w, at.x, at.y) - before_m) > edge_m:
            continue
        share, u = crossing(faces.lines, w, -before_m, at.x, at.y, origin, rules.grazing_sine)
        if not 0.0 <= u <= faces.lines.length[w]:
            continue
        rise = (share - 1.0) * (at.z - origin[2])
        cx, cy = origin[0] + share * (at.x - origin[0]), origin[1] + share * (at.y - origin[1])
        if _is_in_doorway(cx, cy, at.height_m + rise, doorways, rules.other_face_m):
            continue
        column = min(int(u / CELL_M), faces.first[w + 1] - faces.first[w] - 1)
        is_other_rooms = at.height_m < faces.clear_m[faces.first[w] + column] - rules.another_ceiling_m
        near_ceiling = near_a_ceiling and not is_other_rooms
        if (not near_floor or at.height_m + rise > 0.0) and (not near_ceiling or at.below_ceiling_m - rise > 0.0):
            return Label.WALL
        missed = True
    if label == Label.WALL and missed:
        return Label.FLOOR if near_floor else Label.CEILING
    return label


@numba.njit(cache=True, nogil=True)
def _is_in_doorway(
    x: float, y: float, height_m: float, doorways: _Doorways, other_face_m: float
) -> bool:  # pragma: no cover
    """Whether a place at this height above the floor, on a face of some wall, is between the jambs of one of its doors."""
    for d in range(len(doorways.lines.length)):
        if (
            0.0 < along_line(doorways.lines, d, x, y) < doorways.lines.length[d]
            and abs(before_line(doorways.lines, d, x, y)) < other_face_m
            and height_m < doorways.head_m[d]
        ):
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _is_above_floor(at: _Return, origin: FloatArray, rules: _Rules) -> bool:  # pragma: no cover
    """Whether a floor return is too high to be the floor's scatter.

    A ray that comes in level ends on the floor, or far before it: what stands there has a foot.
    """
    fall = origin[2] - at.z
    steepness = abs(fall) / np.sqrt((at.x - origin[0]) ** 2 + (at.y - origin[1]) ** 2 + fall**2)
    return bool(at.height_m > rules.floor_scatter_m + rules.range_scatter_m * steepness)


@numba.njit(cache=True, nogil=True, forceinline=True)  # a call for each return would hand over all arrays
def _at_door(at: _Return, origin: FloatArray, doorways: _Doorways, rules: _Rules) -> _AtDoor:  # pragma: no cover
    """What a return is to the building's doors; once it is a leaf's, nothing else is asked."""
    on_reveal = in_opening = in_doorway = False
    for d in range(len(doorways.lines.length)):
        s = before_line(doorways.lines, d, at.x, at.y)
        if abs(s) > rules.at_door_m:
            continue
        u, length = along_line(doorways.lines, d, at.x, at.y), doorways.lines.length[d]
        depth_m, head_m, reveal_m = doorways.depth_m[d], doorways.head_m[d], doorways.reveal_m[d]
        # Between the jambs of a closed door there is nothing but its leaf, its handle, and their scatter.
        if -depth_m - rules.leaf_distance_m < s < rules.wall_distance_m:
            share, at_leaf = crossing(doorways.lines, d, depth_m, at.x, at.y, origin, rules.grazing_sine)
            rise = (share - 1.0) * (at.z - origin[2])
            if np.isnan(share):
                at_leaf, rise = u, 0.0
            if 0.0 < at_leaf < length and at.height_m + rise < head_m:
                return _AtDoor(True, on_reveal, in_opening, in_doorway)
        in_opening = in_opening or (
            depth_m < 0.0
            and rules.opening_m < u < length - rules.opening_m
            and at.height_m < head_m - rules.opening_m
            and -reveal_m - rules.margin_m < s < rules.margin_m
        )
        in_doorway = in_doorway or (-rules.margin_m < u < length + rules.margin_m and at.height_m < head_m)
        # Beside the frame the wall is as deep as its other face scatters.
        deep_m = reveal_m if 0.0 < u < length else reveal_m + rules.wall_distance_m
        if -deep_m < s < rules.wall_distance_m and -rules.wall_distance_m < u < length + rules.wall_distance_m:
            # At the reveal's end an open leaf hangs, as thick as the reveal's scatter is wide.
            inner_m = rules.at_leaf_m if s < rules.leaf_hangs_m - reveal_m else rules.at_reveal_m
            at_jamb = u < inner_m or u > length - inner_m
            at_head = head_m - rules.at_reveal_m < at.height_m < head_m + rules.lintel_m
            on_reveal = on_reveal or at_head or (at_jamb and at.height_m < head_m)
    return _AtDoor(False, on_reveal, in_opening, in_doorway)


@numba.njit(cache=True, nogil=True)
def _nearest_face(
    at: _Return, origin: FloatArray, faces: _Faces, rules: _Rules
) -> tuple[float, bool, bool]:  # pragma: no cover
    """Metres to the nearest face, infinite without one; whether something stands against the wall; whether a wall has it within.

    What stands against the wall is told by the nearest face that the ray could end on or before: a thin wall's other side is
    as close, but in another room. Within a wall's body, behind a face that the sensor looks at, is what scatters.
    """
    nearest_m, nearest_seen_m = np.inf, rules.forget_m
    is_covered = is_within = False
    for w in range(len(faces.lines.length)):
        s = before_line(faces.lines, w, at.x, at.y)
        could_see = s > 0.0 or before_line(faces.lines, w, origin[0], origin[1]) > 0.0
        in_body = -rules.body_m < s < 0.0 and could_see
        if abs(s) < nearest_m or in_body or (could_see and abs(s) < nearest_seen_m):
            u = along_line(faces.lines, w, at.x, at.y)
            beside = -rules.margin_m < u < faces.lines.length[w] + rules.margin_m
            if beside and at.height_m < faces.top_m[w] + rules.face_above_m:
                nearest_m = min(nearest_m, abs(s))
                if could_see and abs(s) < nearest_seen_m:
                    nearest_seen_m = abs(s)
                    column = min(max(int(u / CELL_M), 0), faces.first[w + 1] - faces.first[w] - 1)
                    row = min(max(int(at.height_m / CELL_M), 0), faces.covered.shape[1] - 1)
                    is_covered = faces.covered[faces.first[w] + column, row]
                is_within = is_within or in_body
    return nearest_m, is_covered, is_within


@numba.njit(cache=True, nogil=True)
def _label_of_refused(at: _Return, refused: _Refused, rules: _Rules) -> int:  # pragma: no cover
    """The label of the first refused face that a return lies on, -1 where it lies on none."""
    for f in range(len(refused.lines.length)):
        if abs(before_line(refused.lines, f, at.x, at.y)) < rules.refused_m:
            u = along_line(refused.lines, f, at.x, at.y)
            beside = -rules.margin_m < u < refused.lines.length[f] + rules.margin_m
            if beside and at.height_m < refused.top_m[f] + rules.refused_above_m:
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
    rules: _Rules,
) -> UInt8Array:  # pragma: no cover
    """The final labels (n,) before halo and levels are asked: return by return the first answer that decides."""
    label = label_scan.copy()
    own_m = _own_places(points, height, below_ceiling, label_scan, faces.lines, rules)
    for i in range(len(points)):
        at = _Return(
            np.float64(points[i, 0]),
            np.float64(points[i, 1]),
            np.float64(points[i, 2]),
            np.float64(height[i]),
            np.float64(below_ceiling[i]),
        )
        is_outside, on_reveal = _through_window(at, origin, panes, rules)
        if is_outside:
            label[i] = Label.OUTSIDE
            continue
        if label[i] == Label.FLOOR or label[i] == Label.CEILING or label[i] == Label.WALL:
            if abs(at.height_m) < rules.edge_m or abs(at.below_ceiling_m) < rules.edge_m:
                label[i] = _at_edge(np.int64(label[i]), at, origin, faces, own_m, doorways, rules)
            if label[i] == Label.FLOOR and _is_above_floor(at, origin, rules):
                label[i] = Label.CLUTTER
            if label[i] != Label.WALL:
                continue
        door = _at_door(at, origin, doorways, rules)
        if door.on_leaf:
            label[i] = Label.DOOR
            continue
        on_reveal = on_reveal or door.on_reveal
        if door.in_opening and not on_reveal:
            # A face goes on over its doors, but no wall stands in an open one.
            label[i] = Label.CLUTTER
            continue
        nearest_m, is_covered, is_within = _nearest_face(at, origin, faces, rules)
        if is_covered and not on_reveal:
            label[i] = Label.CLUTTER
            continue
        is_wall, is_door = label[i] == Label.WALL, label[i] == Label.DOOR
        if nearest_m > rules.wall_distance_m and (is_wall or is_door) and not on_reveal:
            of_refused = _label_of_refused(at, refused, rules)
            if of_refused >= 0:
                label[i] = of_refused
                continue
        is_scatter = is_within and not door.in_doorway
        if label[i] == Label.CLUTTER and (on_reveal or nearest_m < rules.wall_distance_m or is_scatter):
            label[i] = Label.WALL
        elif is_wall and nearest_m > rules.forget_m:
            label[i] = Label.CLUTTER
        elif is_door:
            is_faces = nearest_m < rules.scan_door_ratio * rules.wall_distance_m
            label[i] = Label.WALL if is_faces else Label.CLUTTER
    return label
