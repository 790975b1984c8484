"""From the building back to the scans: the final label of every return."""

from collections import namedtuple
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import cell_at, index_near
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import (
    LENGTH,
    Faces,
    along_line,
    before_line,
    crossing,
    lengthened,
    lines_of,
)
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.halo import Halo
from ffmap.algorithms.building.heights import HeightMap
from ffmap.algorithms.building.label_reasons import SURFACE_REASONS, Reason
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    NO_WINDOWS,
    Blinds,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.storey import CEILING_MARGIN_M
from ffmap.algorithms.building.verdicts import JudgedFaces
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
        0.1, ge=0, description="A face counts this far (m) above the highest that was seen of it, and up to the ceiling."
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
    behind_glass_m: float = Field(
        0.12,
        gt=0,
        description="The same behind a window's wall, where the pane returned nothing and its place is not known.",
    )
    forget_m: float = Field(
        0.2, gt=0, description="Distance (m) from every wall's face beyond which what a scan calls wall is clutter."
    )
    scatter_m: float = Field(
        0.06,
        ge=0,
        le=0.2,
        description="Maximum distance (m) of a return from the surface that it is of: ranges scatter, poses drift.",
    )
    grazing_sine: float = Field(
        0.2,
        gt=0,
        lt=1,
        description="Sine of the angle between a ray and a face below which the place where they cross says nothing.",
    )
    own_to_m: float = Field(
        0.7,
        gt=0,
        description="Maximum distance (m) from floor and ceiling of the returns that tell where a scan shows a face.",
    )
    own_returns_min: int = Field(20, ge=1, description="Minimum number of them.")
    floor_scatter_m: float = Field(
        0.015, ge=0, description="Maximum height (m) above the floor of returns of the floor itself, seen level."
    )
    range_scatter_m: float = Field(
        0.02,
        ge=0,
        description="Maximum error (m) of a return along its ray, which lifts it off a floor that is seen steeply.",
    )


@dataclass(frozen=True)
class BuildingModel:
    """What the building tells each scan's returns, in the map frame.

    walls: the faces that stand. foreground: how high the ceiling hangs before each, and where something stands flat against it.
    judged: with the faces that were refused, whose returns are clutter, or outside. Its own `walls` are not asked.
    levels: what lies at known heights, applied one after the other. leaf_panes: the panes of open doors' leaves, which stand in the
    rooms: what lies behind them is seen through glass, but what is around them is no wall. low_walls: those of the walls that end
    below the ceiling.
    """

    walls: Walls
    foreground: Foreground
    judged: JudgedFaces
    doors: Doors
    windows: Windows
    blinds: Blinds
    levels: tuple[HeightMap, ...]
    leaf_panes: Windows = NO_WINDOWS
    low_walls: Walls = NO_WALLS


TOP, REFUSED_AS = 7, 8
"""Beside those of `lines_of`, columns of faces and refused faces: the highest that was seen, and the label of their returns."""
HEAD, LEAF, REVEAL = 7, 8, 9
"""The same of doorways: the head's height above the floor, how far the closed leaf is behind the wall's face (negative
before it, minus infinity where the door is open), and how deep the reveals are."""
ABOVE_LOW_WALL_M = 0.3
"""Before a low wall all is as high as itself: the ceiling is this much higher (m); of other walls it differs by less."""
BEYOND = 7
"""The same of panes: how far behind their face what returns is outside."""
BEHIND, LOW, HIGH = 7, 8, 9
"""The same of blinds: how far behind their wall they hang, and the heights between which they do; and of mullions, whose line is
their front: how far behind it their pane is."""


def _table(faces: Faces, *columns: FloatArray | UInt8Array) -> FloatArray:
    """Lines of faces and more of their columns."""
    return np.ascontiguousarray(np.column_stack([lines_of(faces), *columns]))


if TYPE_CHECKING:
    _Rules = RelabellingSettings
else:  # compiled code takes named tuples
    _Rules = namedtuple("_Rules", RelabellingSettings.model_fields)


ON_LEAF, ON_REVEAL, IN_OPENING, IN_DOORWAY, ON_BLIND = 1, 2, 4, 8, 16
"""What a return is to the building's doors and windows, as bits: a closed leaf's; a reveal's or a lintel's, hence wall; between
the jambs of an open door; before, within or behind one, where no wall has a body; a blind's."""


@dataclass(frozen=True)
class Relabelled:
    """The final label of each return (n,), why it is another than the scan's own (see `REASONS`), and metres to the nearest wall's
    face: infinite where none is near, or none was asked."""

    label: UInt8Array
    reason: UInt8Array
    off_face_m: FloatArray


@dataclass(frozen=True)
class Relabelling:
    """A building as the returns of scans are asked about it: tables for compiled code, and what is near each place.

    faces, refused, doorways, panes, blinds: a row for each, see `TOP`, `HEAD`, `BEYOND` and `LOW`; with an index of
        `index_near` each, the faces with one of those that rays meet along an edge, and with one of those that a return may be at;
        that of panes is of the walls' windows alone.
    foreground: what is before the faces, by their columns.
    levels: what lies at known heights, asked last; halo: the cubes in which clutter is a surface's scatter, before these.
    """

    faces: tuple[FloatArray, IntArray, IntArray]
    refused: tuple[FloatArray, IntArray]
    doorways: tuple[FloatArray, IntArray]
    panes: tuple[FloatArray, IntArray]
    blinds: tuple[FloatArray, IntArray]
    foreground: Foreground
    rules: "_Rules"
    levels: tuple[HeightMap, ...]
    halo: Halo

    @classmethod
    def of(cls, building: BuildingModel, halo: Halo, settings: RelabellingSettings) -> "Relabelling":
        """By the settings, which say how far each part of the building reaches."""
        walls, refused, doors, windows = building.walls, building.judged.refused, building.doors, building.windows
        blinds, panes = building.blinds, windows.append(building.leaf_panes)
        leaf_m = np.where(doors.state == DoorState.CLOSED, doors.depth_m, -np.inf)
        beyond_m = np.where(np.isfinite(panes.pane_m), panes.pane_m, settings.behind_glass_m)
        # A ray that ends this close to a face or a leaf may cross it so far away, if it comes in as level as is asked about.
        at_face_m = max(settings.forget_m, settings.body_m)
        edge_m = 2.0 * settings.scatter_m
        off_leaf_m = settings.leaf_distance_m + settings.wall_distance_m + np.max(leaf_m, initial=0.0)
        door_m = settings.at_door_m + max(settings.other_face_m, off_leaf_m / settings.grazing_sine)
        pane_m = max(settings.wall_distance_m, float(beyond_m.max(initial=0.0)))
        margin_m = max(settings.margin_m, settings.wall_distance_m)
        return cls(
            (
                _table(walls, walls.top_m),
                index_near(replace(walls, ends=lengthened(walls.ends, edge_m / settings.grazing_sine)), edge_m),
                index_near(walls, at_face_m + margin_m),
            ),
            (
                _table(refused, refused.top_m, building.judged.refused_label),
                index_near(refused, settings.scatter_m + margin_m),
            ),
            (_table(doors, doors.head_m, leaf_m, doors.reveal_m), index_near(doors, door_m + margin_m)),
            (_table(panes, beyond_m), index_near(windows, pane_m + margin_m)),
            (
                _table(blinds, blinds.behind_m, blinds.bottom_m, blinds.top_m),
                index_near(blinds, float(blinds.behind_m.max(initial=0.0)) + settings.wall_distance_m),
            ),
            building.foreground,
            _Rules(**settings.model_dump()),
            building.levels,
            halo,
        )

    def labels(
        self,
        points_map: FloatArray,
        height_m: FloatArray,
        below_ceiling_m: FloatArray,
        label_scan: UInt8Array,
        origin_map: FloatArray,
    ) -> Relabelled:
        """The final labels (n,): what many scans agree on overrules what one scan saw.

        points_map: (n, 3). height_m: (n,) above the floor that the scan saw, which doors' heads are measured from too.
        below_ceiling_m: (n,) below the scan's ceiling, infinite without one. label_scan: (n,) of the scan alone; not changed.
        origin_map: (3,) the sensor.
        """
        origin = np.ascontiguousarray(origin_map, np.float64)
        reason = np.zeros(len(label_scan), np.uint8)
        lines, along_edges, at_faces = self.faces
        # Every question is asked of all returns at once: asked one by one, what takes most is to hand over the arrays.
        own_m = _own_places(points_map, height_m, below_ceiling_m, label_scan, lines, along_edges, self.rules)
        on_blind = _are_within(points_map, height_m, *self.blinds, self.rules)
        outside = _outside(points_map, origin, self.panes[0], self.rules) & ~on_blind
        label, asked = _at_edges(
            points_map,
            height_m,
            below_ceiling_m,
            label_scan,
            outside,
            origin,
            lines,
            along_edges,
            self.foreground.first,
            self.foreground.clear_m,
            own_m,
            *self.doorways,
            self.rules,
        )
        at_edge = np.where(outside, np.uint8(Reason.BEYOND_WINDOW), _EDGE_REASONS[label])
        np.copyto(reason, at_edge, where=label != label_scan)
        at_door = _at_doors(points_map, height_m, asked, origin, *self.doorways, self.rules)
        _mark_window_reveals(points_map, asked, at_door, *self.panes, self.rules)
        at_door[on_blind] |= ON_BLIND
        foreground = self.foreground.first, self.foreground.clear_m, self.foreground.covered
        nearest = _nearest_faces(points_map, height_m, asked, origin, lines, at_faces, *foreground, self.rules)
        refused = _labels_of_refused(points_map, height_m, asked, *self.refused, self.rules)
        decided = np.asarray(_decided(label, asked, at_door, *nearest, refused, self.rules, reason))
        scattered = np.where(on_blind, decided, self.halo.label_of(points_map, decided))
        reason[scattered != decided] = Reason.IN_HALO
        final = _by_levels(self.levels, points_map, scattered, reason)
        reason[final == label_scan] = Reason.KEPT
        return Relabelled(final, reason, nearest[0])


_EDGE_REASONS = np.full(len(Label), Reason.MET_FIRST, np.uint8)
_EDGE_REASONS[[Label.CLUTTER, Label.DOOR]] = Reason.ABOVE_FLOOR, Reason.ON_LEAF
"""Why a return has each label once edges were looked at."""


def _by_levels(
    levels: Sequence[HeightMap], points_map: FloatArray, label: UInt8Array, reason: UInt8Array
) -> UInt8Array:
    """The labels (n,) corrected by one level surface after the other; writes to `reason` (n,) which of them did."""
    for level in levels:
        corrected = level.label_of(points_map, label)
        reason[corrected != label] = SURFACE_REASONS[level.surface]
        label = corrected
    return label


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
    bin_m, most_m = 0.002, rules.scatter_m
    bins = int(2.0 * most_m / bin_m)
    counts = np.zeros((len(faces), 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != Label.WALL:
            continue
        at_foot = CEILING_MARGIN_M < height[i] < rules.own_to_m
        if not at_foot and not CEILING_MARGIN_M < below_ceiling[i] < rules.own_to_m:
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
def _outside(points: FloatArray, origin: FloatArray, panes: FloatArray, rules: _Rules) -> BoolArray:  # pragma: no cover
    """(n,) whether a ray reached its return through a window."""
    outside = np.zeros(len(points), np.bool_)
    for g in range(len(panes)):
        if before_line(panes, g, origin[0], origin[1]) <= 0.0:
            continue
        for i in range(len(points)):
            x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
            if before_line(panes, g, x, y) <= -panes[g, BEYOND]:
                _, u = crossing(panes, g, 0.0, x, y, origin, 0.0)
                outside[i] |= -rules.margin_m < u < panes[g, LENGTH] + rules.margin_m
    return outside


@numba.njit(cache=True, nogil=True)
def _are_within(
    points: FloatArray, height: FloatArray, boxes: FloatArray, near_boxes: IntArray, rules: _Rules
) -> BoolArray:  # pragma: no cover
    """(n,) whether a return lies on a blind, or between it and its wall's face; on a mullion, or between its front and its pane:
    nothing else is there."""
    found = np.zeros(len(points), np.bool_)
    if not len(boxes):
        return found
    for i in range(len(points)):
        x, y, height_m = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(height[i])
        p = cell_at(near_boxes, x, y)
        for k in range(near_boxes[p], near_boxes[p + 1]):
            b = near_boxes[k]
            if (
                boxes[b, LOW] < height_m < boxes[b, HIGH]
                and -boxes[b, BEHIND] - rules.wall_distance_m < before_line(boxes, b, x, y) < rules.wall_distance_m
                and 0.0 < along_line(boxes, b, x, y) < boxes[b, LENGTH]
            ):
                found[i] = True
    return found


@numba.njit(cache=True, nogil=True)
def _at_edges(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    outside: BoolArray,
    origin: FloatArray,
    faces: FloatArray,
    near_faces: IntArray,
    first: IntArray,
    clear_m: FloatArray,
    own_m: FloatArray,
    doorways: FloatArray,
    near_doorways: IntArray,
    rules: _Rules,
) -> tuple[UInt8Array, BoolArray]:  # pragma: no cover
    """The labels of floor, ceiling and wall returns near floor or ceiling, by which of them and the walls their rays meet first.

    Range is the noisy coordinate of a return, its direction is not: where the ray crosses a wall's face above the floor and
    below the ceiling it ended on the wall, and on floor or ceiling where it would reach the face beyond them. A floor return
    that is too high to be the floor's scatter is clutter: a ray that comes in level ends on the floor, or far before it, and
    what stands there has a foot.

    own_m: from `_own_places`. Also returned is of which returns doors and faces are to be asked (n,).
    """
    label, asked = label_scan.copy(), np.zeros(len(points), np.bool_)
    edge_m = rules.scatter_m
    for i in range(len(points)):
        if outside[i]:
            label[i] = Label.OUTSIDE
            continue
        if label[i] != Label.FLOOR and label[i] != Label.CEILING and label[i] != Label.WALL:
            asked[i] = True
            continue
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        height_m, below_m = np.float64(height[i]), np.float64(below_ceiling[i])
        near_floor, near_a_ceiling = abs(height_m) < edge_m, abs(below_m) < edge_m
        if near_floor or near_a_ceiling:
            is_leaf = False
            p = cell_at(near_doorways, x, y)
            for k in range(near_doorways[p], near_doorways[p + 1]):
                # A closed leaf stands on the floor, behind its wall's face or before it.
                d = near_doorways[k]
                depth_m = doorways[d, LEAF]
                if near_floor and abs(before_line(doorways, d, x, y) + depth_m) < edge_m:
                    share, u = crossing(doorways, d, depth_m, x, y, origin, rules.grazing_sine)
                    if 0.0 < u < doorways[d, LENGTH]:
                        is_leaf = True
                        label[i] = Label.DOOR if height_m + (share - 1.0) * (z - origin[2]) > 0.0 else Label.FLOOR
                        break
            missed, met = False, is_leaf
            p = cell_at(near_faces, x, y)
            for k in range(near_faces[p], near_faces[p + 1]):
                w = near_faces[k]
                before_m = own_m[w, 0 if near_floor else 1]
                if met or abs(before_line(faces, w, x, y) - before_m) > edge_m:
                    continue
                share, u = crossing(faces, w, -before_m, x, y, origin, rules.grazing_sine)
                if not 0.0 <= u <= faces[w, LENGTH]:
                    continue
                rise = (share - 1.0) * (z - origin[2])
                cx, cy = origin[0] + share * (x - origin[0]), origin[1] + share * (y - origin[1])
                if _is_in_doorway(cx, cy, height_m + rise, doorways, near_doorways, rules.other_face_m):
                    continue
                column = min(int(u / CELL_M), first[w + 1] - first[w] - 1)
                if height_m > clear_m[first[w] + column] + ABOVE_LOW_WALL_M:
                    continue  # the ceiling above a low wall
                is_other_rooms = height_m < clear_m[first[w] + column] - rules.scatter_m
                near_ceiling = near_a_ceiling and not is_other_rooms
                if (not near_floor or height_m + rise > 0.0) and (not near_ceiling or below_m - rise > 0.0):
                    label[i], met = Label.WALL, True
                missed = True
            if label[i] == Label.WALL and missed and not met:
                label[i] = Label.FLOOR if near_floor else Label.CEILING
        if label[i] == Label.FLOOR:
            fall = origin[2] - z
            steepness = abs(fall) / np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2 + fall**2)
            if height_m > rules.floor_scatter_m + rules.range_scatter_m * steepness:
                label[i] = Label.CLUTTER
        asked[i] = label[i] == Label.WALL
    return label, asked


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


@numba.njit(cache=True, nogil=True)
def _at_doors(
    points: FloatArray,
    height: FloatArray,
    asked: BoolArray,
    origin: FloatArray,
    doorways: FloatArray,
    near_doorways: IntArray,
    rules: _Rules,
) -> UInt8Array:  # pragma: no cover
    """(n,) what returns are to the building's doors, see `ON_LEAF`; once one is a leaf's, nothing else is asked."""
    found = np.zeros(len(points), np.uint8)
    for i in range(len(points)):
        if not asked[i]:
            continue
        x, y, z, height_m = points[i, 0], points[i, 1], np.float64(points[i, 2]), np.float64(height[i])
        p = cell_at(near_doorways, np.float64(x), np.float64(y))
        for k in range(near_doorways[p], near_doorways[p + 1]):
            d = near_doorways[k]
            s = before_line(doorways, d, np.float64(x), np.float64(y))
            if abs(s) > rules.at_door_m:
                continue
            u, length = along_line(doorways, d, np.float64(x), np.float64(y)), doorways[d, LENGTH]
            depth_m, head_m, reveal_m = doorways[d, LEAF], doorways[d, HEAD], doorways[d, REVEAL]
            # Between the jambs of a closed door there is nothing but its leaf, its handle, and their scatter; a ray that does
            # not come in between the jambs ended on the wall beside them.
            if -depth_m - rules.leaf_distance_m < s < max(-depth_m, 0.0) + rules.wall_distance_m:
                share, at_leaf = crossing(
                    doorways, d, depth_m, np.float64(x), np.float64(y), origin, rules.grazing_sine
                )
                _, at_face = crossing(doorways, d, 0.0, np.float64(x), np.float64(y), origin, rules.grazing_sine)
                rise = (share - 1.0) * (z - origin[2])
                if np.isnan(share):
                    at_leaf, rise = u, 0.0
                enters = depth_m < 0.0 or np.isnan(at_face) or 0.0 < at_face < length
                if enters and 0.0 < at_leaf < length and height_m + rise < head_m:
                    found[i] |= ON_LEAF
                    break
            if (
                depth_m == -np.inf
                and rules.opening_m < u < length - rules.opening_m
                and height_m < head_m - rules.opening_m
                and -reveal_m - rules.margin_m < s < rules.margin_m
            ):
                found[i] |= IN_OPENING
            if -rules.margin_m < u < length + rules.margin_m and height_m < head_m:
                found[i] |= IN_DOORWAY
            # Beside the frame the wall is as deep as its other face scatters.
            deep_m = reveal_m if 0.0 < u < length else reveal_m + rules.wall_distance_m
            if -deep_m < s < rules.wall_distance_m and -rules.wall_distance_m < u < length + rules.wall_distance_m:
                # At the reveal's end an open leaf hangs, as thick as the reveal's scatter is wide.
                inner_m = rules.at_leaf_m if s < rules.leaf_hangs_m - reveal_m else rules.at_reveal_m
                at_jamb = u < inner_m or u > length - inner_m
                at_head = head_m - rules.at_reveal_m < height_m < head_m + rules.lintel_m
                if at_head or (at_jamb and height_m < head_m):
                    found[i] |= ON_REVEAL
    return found


@numba.njit(cache=True, nogil=True)
def _mark_window_reveals(
    points: FloatArray,
    asked: BoolArray,
    found: UInt8Array,
    panes: FloatArray,
    near_panes: IntArray,
    rules: _Rules,
) -> None:  # pragma: no cover
    """Mark returns between a window's face and its pane too, where there is nothing but sill, head and reveals."""
    for i in range(len(points)):
        if not asked[i]:
            continue
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        p = cell_at(near_panes, x, y)
        for k in range(near_panes[p], near_panes[p + 1]):
            g = near_panes[k]
            if -panes[g, BEYOND] < before_line(panes, g, x, y) < rules.wall_distance_m:
                u = along_line(panes, g, x, y)
                if -rules.margin_m < u < panes[g, LENGTH] + rules.margin_m:
                    found[i] |= ON_REVEAL


@numba.njit(cache=True, nogil=True)
def _nearest_faces(
    points: FloatArray,
    height: FloatArray,
    asked: BoolArray,
    origin: FloatArray,
    faces: FloatArray,
    near_faces: IntArray,
    first: IntArray,
    clear_m: FloatArray,
    covered: BoolArray,
    rules: _Rules,
) -> tuple[FloatArray, BoolArray, BoolArray]:  # pragma: no cover
    """(n,) each: metres to the nearest face, infinite without one; whether something stands against the wall; whether a wall has
    the return within.

    What stands against the wall is told by the nearest face that the ray could end on or before: a thin wall's other side is
    as close, but in another room. Within a wall's body, behind a face that the sensor looks at, is what scatters.
    """
    nearest_m = np.full(len(points), np.inf)
    is_covered, is_within = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    before_sensor = np.array([before_line(faces, w, origin[0], origin[1]) > 0.0 for w in range(len(faces))], np.bool_)
    for i in range(len(points)):
        if not asked[i]:
            continue
        x, y, height_m = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(height[i])
        nearest_seen_m = rules.forget_m
        p = cell_at(near_faces, x, y)
        for k in range(near_faces[p], near_faces[p + 1]):
            w = near_faces[k]
            s = before_line(faces, w, x, y)
            could_see = s > 0.0 or before_sensor[w]
            in_body = -rules.body_m < s < 0.0 and could_see
            if abs(s) < nearest_m[i] or in_body or (could_see and abs(s) < nearest_seen_m):
                u = along_line(faces, w, x, y)
                beside = -rules.margin_m < u < faces[w, LENGTH] + rules.margin_m
                column = min(max(int(u / CELL_M), 0), first[w + 1] - first[w] - 1)
                # Where the ceiling rises, so does the wall.
                if beside and (height_m < faces[w, TOP] + rules.face_above_m or height_m < clear_m[first[w] + column]):
                    nearest_m[i] = min(nearest_m[i], abs(s))
                    if could_see and abs(s) < nearest_seen_m:
                        nearest_seen_m = abs(s)
                        row = min(max(int(height_m / CELL_M), 0), covered.shape[1] - 1)
                        is_covered[i] = covered[first[w] + column, row]
                    is_within[i] = is_within[i] or in_body
    return nearest_m, is_covered, is_within


@numba.njit(cache=True, nogil=True)
def _labels_of_refused(
    points: FloatArray,
    height: FloatArray,
    asked: BoolArray,
    refused: FloatArray,
    near_refused: IntArray,
    rules: _Rules,
) -> IntArray:  # pragma: no cover
    """(n,) int16 the label of the first refused face that each return lies on, -1 where it lies on none."""
    label = np.full(len(points), -1, np.int16)
    for i in range(len(points)):
        if not asked[i]:
            continue
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        p = cell_at(near_refused, x, y)
        for k in range(near_refused[p], near_refused[p + 1]):
            f = near_refused[k]
            if abs(before_line(refused, f, x, y)) < rules.scatter_m:
                u = along_line(refused, f, x, y)
                beside = -rules.margin_m < u < refused[f, LENGTH] + rules.margin_m
                if beside and height[i] < refused[f, TOP]:
                    label[i] = np.int16(refused[f, REFUSED_AS])
                    break
    return label


@numba.njit(cache=True, nogil=True)
def _decided(
    label: UInt8Array,
    asked: BoolArray,
    at_door: UInt8Array,
    nearest_m: FloatArray,
    is_covered: BoolArray,
    is_within: BoolArray,
    refused: IntArray,
    rules: _Rules,
    reason: UInt8Array,
) -> UInt8Array:  # pragma: no cover
    """The final labels (n,) before halo and levels are asked: return by return the first answer that decides, in `reason` too."""
    final = label.copy()
    for i in range(len(label)):
        if not asked[i]:
            continue
        on_reveal = bool(at_door[i] & ON_REVEAL)
        is_wall, is_door = label[i] == Label.WALL, label[i] == Label.DOOR
        is_scatter = is_within[i] and not at_door[i] & IN_DOORWAY
        is_near = nearest_m[i] < rules.wall_distance_m
        why = Reason.KEPT
        if at_door[i] & ON_LEAF:
            final[i], why = Label.DOOR, Reason.ON_LEAF
        elif at_door[i] & ON_BLIND:
            final[i], why = Label.CLUTTER, Reason.ON_BLIND
        elif not on_reveal and (at_door[i] & IN_OPENING or is_covered[i]):
            # A face goes on over its doors, but no wall stands in an open one.
            final[i], why = Label.CLUTTER, Reason.IN_OPENING if at_door[i] & IN_OPENING else Reason.AGAINST_WALL
        elif not on_reveal and (is_wall or is_door) and nearest_m[i] > rules.wall_distance_m and refused[i] >= 0:
            final[i], why = refused[i], Reason.ON_REFUSED
        elif label[i] == Label.CLUTTER and (on_reveal or is_near or is_scatter):
            final[i], why = Label.WALL, Reason.ON_REVEAL if on_reveal else Reason.ON_FACE if is_near else Reason.IN_WALL
        elif is_wall and nearest_m[i] > rules.forget_m:
            final[i], why = Label.CLUTTER, Reason.NO_FACE
        elif is_door:
            final[i], why = Label.WALL if is_near else Label.CLUTTER, Reason.ON_FACE if is_near else Reason.NO_FACE
        if final[i] != label[i]:
            reason[i] = why
    return final
