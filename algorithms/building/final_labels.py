"""From the building back to the scans: the final label of every return."""

from collections import namedtuple
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import SECTORS, cell_at, enter, index_near, sector_of, sectors_around
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import (
    ALONG_X,
    ALONG_Y,
    LENGTH,
    NORMAL_X,
    NORMAL_Y,
    OFFSET,
    START,
    Faces,
    along_line,
    before_line,
    crossing,
    lines_of,
)
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
        gt=0,
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


TOP, REFUSED_AS = 7, 8
"""Beside those of `lines_of`, columns of faces and refused faces: the highest that was seen, and the label of their returns."""
HEAD, LEAF, REVEAL = 7, 8, 9
"""The same of doorways: the head's height above the floor, how far the closed leaf is behind the wall's face (minus infinity
where the door is open), and how deep the reveals are."""
BEYOND = 7
"""The same of panes: how far behind their face what returns is outside."""


def _table(faces: Faces, *columns: FloatArray | UInt8Array) -> FloatArray:
    """Lines of faces and more of their columns."""
    return np.ascontiguousarray(np.column_stack([lines_of(faces), *columns]))


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


@dataclass(frozen=True)
class Relabelling:
    """A building as the returns of scans are asked about it: tables for compiled code, and what is near each place.

    faces, refused, doorways, panes: a row for each, see `TOP`, `HEAD` and `BEYOND`; with an index of `index_near` each.
    before: what is before the faces, by their columns.
    false_floors: what a scan took for floor on a wall, which is to be asked about like anything else there.
    levels: what lies at known heights, asked last; halo: the cubes in which clutter is a surface's scatter, before these.
    """

    faces: tuple[FloatArray, IntArray]
    refused: tuple[FloatArray, IntArray]
    doorways: tuple[FloatArray, IntArray]
    panes: tuple[FloatArray, IntArray]
    before: Foreground
    rules: "_Rules"
    false_floors: tuple[HeightMap, ...]
    levels: tuple[HeightMap, ...]
    halo: Halo

    @classmethod
    def of(cls, building: BuildingModel, halo: Halo, settings: RelabellingSettings) -> "Relabelling":
        """By the settings, which say how far each part of the building reaches."""
        walls, refused, doors, windows = building.walls, building.judged.refused, building.doors, building.windows
        leaf_m = np.where(doors.state == DoorState.CLOSED, doors.depth_m, -np.inf)
        beyond_m = np.where(np.isfinite(windows.pane_m), windows.pane_m + settings.pane_m, settings.behind_glass_m)
        # A ray that ends this close to a face or a leaf may cross it so far away, if it comes in as level as is asked about.
        at_face_m = max(settings.forget_m, settings.body_m, settings.scan_door_ratio * settings.wall_distance_m)
        face_m = max(at_face_m, (settings.edge_m + settings.own_max_m) / settings.grazing_sine)
        off_leaf_m = settings.leaf_distance_m + settings.wall_distance_m + np.max(leaf_m, initial=0.0)
        door_m = settings.at_door_m + max(settings.other_face_m, off_leaf_m / settings.grazing_sine)
        pane_m = max(settings.wall_distance_m, float(beyond_m.max(initial=0.0)))
        margin_m = max(settings.margin_m, settings.wall_distance_m)
        return cls(
            (_table(walls, walls.top_m), index_near(walls, face_m + margin_m)),
            (
                _table(refused, refused.top_m, building.judged.refused_label),
                index_near(refused, settings.refused_m + margin_m),
            ),
            (_table(doors, doors.head_m, leaf_m, doors.reveal_m), index_near(doors, door_m + margin_m)),
            (_table(windows, beyond_m), index_near(windows, pane_m + margin_m)),
            building.before,
            _Rules(**settings.model_dump()),
            tuple(level for level in building.levels if level.surface.taken_for == Label.FLOOR),
            tuple(level for level in building.levels if level.surface.taken_for != Label.FLOOR),
            halo,
        )

    def labels(
        self,
        points_map: FloatArray,
        height_m: FloatArray,
        below_ceiling_m: FloatArray,
        label_scan: UInt8Array,
        origin_map: FloatArray,
    ) -> UInt8Array:
        """The final labels (n,): what many scans agree on overrules what one scan saw.

        points_map: (n, 3). height_m: (n,) above the floor that the scan saw, which doors' heads are measured from too.
        below_ceiling_m: (n,) below the scan's ceiling, infinite without one. label_scan: (n,) of the scan alone; not changed.
        origin_map: (3,) the sensor.
        """
        label = _relabel(
            points_map,
            height_m,
            below_ceiling_m,
            corrected(self.false_floors, points_map, label_scan),
            np.ascontiguousarray(origin_map, np.float64),
            *self.faces,
            self.before.first,
            self.before.clear_m,
            self.before.covered,
            *self.refused,
            *self.doorways,
            *self.panes,
            self.rules,
        )
        return corrected(self.levels, points_map, self.halo.label_of(points_map, np.asarray(label)))


@numba.njit(cache=True, nogil=True)
def _own_places(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    faces: FloatArray,
    near_faces: IntArray,
    rules: _Rules,
) -> FloatArray:  # pragma: no cover
    """(W, 2) how far before each face the scan itself shows its foot, and its top; 0 where it shows neither.

    A pose may be off by a centimetre, and its upright by tenths of a degree, which is as much at the ceiling.
    """
    bin_m, most_m = 0.002, rules.own_max_m
    bins = int(2.0 * most_m / bin_m)
    counts = np.zeros((len(faces), 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != Label.WALL:
            continue
        at_foot = rules.own_from_m < height[i] < rules.own_to_m
        if not at_foot and not rules.own_from_m < below_ceiling[i] < rules.own_to_m:
            continue
        p = cell_at(near_faces, points[i, 0], points[i, 1])
        for k in range(near_faces[p], near_faces[p + 1]):
            w = near_faces[k]
            s = before_line(faces, w, points[i, 0], points[i, 1])
            u = along_line(faces, w, points[i, 0], points[i, 1])
            if abs(s) < most_m and most_m < u < faces[w, LENGTH] - most_m:
                counts[w, 0 if at_foot else 1, min(int((s + most_m) / bin_m), bins - 1)] += 1
    own_m = np.full((len(faces), 2), np.nan)
    for w in range(len(faces)):
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
def _panes_by_sector(
    origin: FloatArray, panes: FloatArray, rules: _Rules
) -> tuple[IntArray, IntArray]:  # pragma: no cover
    """The panes (SECTORS, N) that the sensor may look through in each direction, and how many there are (SECTORS,)."""
    in_sector, count = np.empty((SECTORS, len(panes)), np.int32), np.zeros(SECTORS, np.int64)
    corners = np.empty((2, 2))
    for g in range(len(panes)):
        if before_line(panes, g, origin[0], origin[1]) > 0.0:
            for k in range(2):
                along = panes[g, START] + (panes[g, LENGTH] + rules.margin_m if k else -rules.margin_m)
                across = panes[g, OFFSET]
                corners[k, 0] = across * panes[g, NORMAL_X] + along * panes[g, ALONG_X] - origin[0]
                corners[k, 1] = across * panes[g, NORMAL_Y] + along * panes[g, ALONG_Y] - origin[1]
            enter(g, *sectors_around(corners), in_sector, count)
    return in_sector, count


@numba.njit(cache=True, nogil=True, forceinline=True)
def _is_outside(
    at: _Return, origin: FloatArray, panes: FloatArray, in_sector: IntArray, count: IntArray, rules: _Rules
) -> bool:  # pragma: no cover
    """Whether a ray reached its return through a window; in_sector, count: from `_panes_by_sector`."""
    sector = sector_of(at.x - origin[0], at.y - origin[1])
    for k in range(count[sector]):
        g = in_sector[sector, k]
        if before_line(panes, g, at.x, at.y) <= -panes[g, BEYOND]:
            _, u = crossing(panes, g, 0.0, at.x, at.y, origin, 0.0)
            if -rules.margin_m < u < panes[g, LENGTH] + rules.margin_m:
                return True
    return False


@numba.njit(cache=True, nogil=True, forceinline=True)
def _on_window_reveal(at: _Return, panes: FloatArray, near_panes: IntArray, rules: _Rules) -> bool:  # pragma: no cover
    """Whether a return lies between a window's face and its pane, where there is nothing but sill, head and reveals."""
    p = cell_at(near_panes, at.x, at.y)
    for k in range(near_panes[p], near_panes[p + 1]):
        g = near_panes[k]
        if -panes[g, BEYOND] < before_line(panes, g, at.x, at.y) < rules.wall_distance_m:
            u = along_line(panes, g, at.x, at.y)
            if -rules.margin_m < u < panes[g, LENGTH] + rules.margin_m:
                return True
    return False


@numba.njit(cache=True, nogil=True, forceinline=True)
def _at_edge(
    label: np.int64,
    at: _Return,
    origin: FloatArray,
    faces: FloatArray,
    near_faces: IntArray,
    first: IntArray,
    clear_m: FloatArray,
    own_m: FloatArray,
    doorways: FloatArray,
    near_doorways: IntArray,
    rules: _Rules,
) -> np.int64 | Label:  # pragma: no cover
    """The label of a floor, ceiling or wall return near floor or ceiling, by which of them and the walls its ray meets first.

    Range is the noisy coordinate of a return, its direction is not: where the ray crosses a wall's face above the floor and
    below the ceiling it ended on the wall, and on floor or ceiling where it would reach the face beyond them.

    label: as numba holds members, for a function that returns both. own_m: from `_own_places`.
    """
    edge_m = rules.edge_m
    near_floor, near_a_ceiling = abs(at.height_m) < edge_m, abs(at.below_ceiling_m) < edge_m
    p = cell_at(near_doorways, at.x, at.y)
    for k in range(near_doorways[p], near_doorways[p + 1]):
        # A closed leaf stands on the floor, behind its wall's face.
        d = near_doorways[k]
        depth_m = doorways[d, LEAF]
        if near_floor and depth_m >= 0.0 and abs(before_line(doorways, d, at.x, at.y) + depth_m) < edge_m:
            share, u = crossing(doorways, d, depth_m, at.x, at.y, origin, rules.grazing_sine)
            if 0.0 < u < doorways[d, LENGTH]:
                return Label.DOOR if at.height_m + (share - 1.0) * (at.z - origin[2]) > 0.0 else Label.FLOOR
    missed = False
    p = cell_at(near_faces, at.x, at.y)
    for k in range(near_faces[p], near_faces[p + 1]):
        w = near_faces[k]
        before_m = own_m[w, 0 if near_floor else 1]
        if abs(before_line(faces, w, at.x, at.y) - before_m) > edge_m:
            continue
        share, u = crossing(faces, w, -before_m, at.x, at.y, origin, rules.grazing_sine)
        if not 0.0 <= u <= faces[w, LENGTH]:
            continue
        rise = (share - 1.0) * (at.z - origin[2])
        cx, cy = origin[0] + share * (at.x - origin[0]), origin[1] + share * (at.y - origin[1])
        if _is_in_doorway(cx, cy, at.height_m + rise, doorways, near_doorways, rules.other_face_m):
            continue
        column = min(int(u / CELL_M), first[w + 1] - first[w] - 1)
        is_other_rooms = at.height_m < clear_m[first[w] + column] - rules.another_ceiling_m
        near_ceiling = near_a_ceiling and not is_other_rooms
        if (not near_floor or at.height_m + rise > 0.0) and (not near_ceiling or at.below_ceiling_m - rise > 0.0):
            return Label.WALL
        missed = True
    if label == Label.WALL and missed:
        return Label.FLOOR if near_floor else Label.CEILING
    return label


@numba.njit(cache=True, nogil=True)
def _is_in_doorway(
    x: float, y: float, height_m: float, doorways: FloatArray, near_doorways: IntArray, other_face_m: float
) -> bool:  # pragma: no cover
    """Whether a place at this height above the floor, on a face of some wall, is between the jambs of one of its doors."""
    p = cell_at(near_doorways, x, y)
    for k in range(near_doorways[p], near_doorways[p + 1]):
        d = near_doorways[k]
        if (
            0.0 < along_line(doorways, d, x, y) < doorways[d, LENGTH]
            and abs(before_line(doorways, d, x, y)) < other_face_m
            and height_m < doorways[d, HEAD]
        ):
            return True
    return False


@numba.njit(cache=True, nogil=True, forceinline=True)
def _is_above_floor(at: _Return, origin: FloatArray, rules: _Rules) -> bool:  # pragma: no cover
    """Whether a floor return is too high to be the floor's scatter.

    A ray that comes in level ends on the floor, or far before it: what stands there has a foot.
    """
    fall = origin[2] - at.z
    steepness = abs(fall) / np.sqrt((at.x - origin[0]) ** 2 + (at.y - origin[1]) ** 2 + fall**2)
    return bool(at.height_m > rules.floor_scatter_m + rules.range_scatter_m * steepness)


@numba.njit(cache=True, nogil=True, forceinline=True)  # a call for each return would hand over all arrays
def _at_door(
    at: _Return, origin: FloatArray, doorways: FloatArray, near_doorways: IntArray, rules: _Rules
) -> _AtDoor:  # pragma: no cover
    """What a return is to the building's doors; once it is a leaf's, nothing else is asked."""
    on_reveal = in_opening = in_doorway = False
    p = cell_at(near_doorways, at.x, at.y)
    for k in range(near_doorways[p], near_doorways[p + 1]):
        d = near_doorways[k]
        s = before_line(doorways, d, at.x, at.y)
        if abs(s) > rules.at_door_m:
            continue
        u, length = along_line(doorways, d, at.x, at.y), doorways[d, LENGTH]
        depth_m, head_m, reveal_m = doorways[d, LEAF], doorways[d, HEAD], doorways[d, REVEAL]
        # Between the jambs of a closed door there is nothing but its leaf, its handle, and their scatter.
        if -depth_m - rules.leaf_distance_m < s < rules.wall_distance_m:
            share, at_leaf = crossing(doorways, d, depth_m, at.x, at.y, origin, rules.grazing_sine)
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


@numba.njit(cache=True, nogil=True, forceinline=True)
def _nearest_face(
    at: _Return,
    origin: FloatArray,
    faces: FloatArray,
    near_faces: IntArray,
    first: IntArray,
    covered: BoolArray,
    rules: _Rules,
) -> tuple[float, bool, bool]:  # pragma: no cover
    """Metres to the nearest face, infinite without one; whether something stands against the wall; whether a wall has it within.

    What stands against the wall is told by the nearest face that the ray could end on or before: a thin wall's other side is
    as close, but in another room. Within a wall's body, behind a face that the sensor looks at, is what scatters.
    """
    nearest_m, nearest_seen_m = np.inf, rules.forget_m
    is_covered = is_within = False
    p = cell_at(near_faces, at.x, at.y)
    for k in range(near_faces[p], near_faces[p + 1]):
        w = near_faces[k]
        s = before_line(faces, w, at.x, at.y)
        could_see = s > 0.0 or before_line(faces, w, origin[0], origin[1]) > 0.0
        in_body = -rules.body_m < s < 0.0 and could_see
        if abs(s) < nearest_m or in_body or (could_see and abs(s) < nearest_seen_m):
            u = along_line(faces, w, at.x, at.y)
            beside = -rules.margin_m < u < faces[w, LENGTH] + rules.margin_m
            if beside and at.height_m < faces[w, TOP] + rules.face_above_m:
                nearest_m = min(nearest_m, abs(s))
                if could_see and abs(s) < nearest_seen_m:
                    nearest_seen_m = abs(s)
                    column = min(max(int(u / CELL_M), 0), first[w + 1] - first[w] - 1)
                    row = min(max(int(at.height_m / CELL_M), 0), covered.shape[1] - 1)
                    is_covered = covered[first[w] + column, row]
                is_within = is_within or in_body
    return nearest_m, is_covered, is_within


@numba.njit(cache=True, nogil=True, forceinline=True)
def _label_of_refused(
    at: _Return, refused: FloatArray, near_refused: IntArray, rules: _Rules
) -> int:  # pragma: no cover
    """The label of the first refused face that a return lies on, -1 where it lies on none."""
    p = cell_at(near_refused, at.x, at.y)
    for k in range(near_refused[p], near_refused[p + 1]):
        f = near_refused[k]
        if abs(before_line(refused, f, at.x, at.y)) < rules.refused_m:
            u = along_line(refused, f, at.x, at.y)
            beside = -rules.margin_m < u < refused[f, LENGTH] + rules.margin_m
            if beside and at.height_m < refused[f, TOP] + rules.refused_above_m:
                return int(refused[f, REFUSED_AS])
    return -1


@numba.njit(cache=True, nogil=True)
def _relabel(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    origin: FloatArray,
    faces: FloatArray,
    near_faces: IntArray,
    first: IntArray,
    clear_m: FloatArray,
    covered: BoolArray,
    refused: FloatArray,
    near_refused: IntArray,
    doorways: FloatArray,
    near_doorways: IntArray,
    panes: FloatArray,
    near_panes: IntArray,
    rules: _Rules,
) -> UInt8Array:  # pragma: no cover
    """The final labels (n,) before halo and levels are asked: return by return the first answer that decides."""
    label = label_scan.copy()
    own_m = _own_places(points, height, below_ceiling, label_scan, faces, near_faces, rules)
    in_sector, pane_count = _panes_by_sector(origin, panes, rules)
    has_panes = pane_count.any()
    for i in range(len(points)):
        at = _Return(
            np.float64(points[i, 0]),
            np.float64(points[i, 1]),
            np.float64(points[i, 2]),
            np.float64(height[i]),
            np.float64(below_ceiling[i]),
        )
        if has_panes and _is_outside(at, origin, panes, in_sector, pane_count, rules):
            label[i] = Label.OUTSIDE
            continue
        if label[i] == Label.FLOOR or label[i] == Label.CEILING or label[i] == Label.WALL:
            if abs(at.height_m) < rules.edge_m or abs(at.below_ceiling_m) < rules.edge_m:
                label[i] = _at_edge(
                    np.int64(label[i]),
                    at,
                    origin,
                    faces,
                    near_faces,
                    first,
                    clear_m,
                    own_m,
                    doorways,
                    near_doorways,
                    rules,
                )
            if label[i] == Label.FLOOR and _is_above_floor(at, origin, rules):
                label[i] = Label.CLUTTER
            if label[i] != Label.WALL:
                continue
        door = _at_door(at, origin, doorways, near_doorways, rules)
        if door.on_leaf:
            label[i] = Label.DOOR
            continue
        on_reveal = door.on_reveal or _on_window_reveal(at, panes, near_panes, rules)
        if door.in_opening and not on_reveal:
            # A face goes on over its doors, but no wall stands in an open one.
            label[i] = Label.CLUTTER
            continue
        nearest_m, is_covered, is_within = _nearest_face(at, origin, faces, near_faces, first, covered, rules)
        if is_covered and not on_reveal:
            label[i] = Label.CLUTTER
            continue
        is_wall, is_door = label[i] == Label.WALL, label[i] == Label.DOOR
        if nearest_m > rules.wall_distance_m and (is_wall or is_door) and not on_reveal:
            of_refused = _label_of_refused(at, refused, near_refused, rules)
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
