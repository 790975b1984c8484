"""From the building back to the scans: the final label of every return."""

from collections.abc import Sequence

import numba
import numpy as np
from pydantic import Field

from algorithms.before_walls import BeforeWalls
from algorithms.building import CELL_M, Doors, Walls, Windows
from algorithms.doors import DoorState
from algorithms.height_maps import HeightMap
from algorithms.scan import BoolArray, FloatArray, IntArray, UInt8Array
from algorithms.semantic_map import Halo
from algorithms.settings import StepSettings
from algorithms.standing_walls import JudgedFaces

_GRAZING = 0.2
"""Sine of the angle between a ray and a face below which where they cross says nothing."""

_ANOTHER_CEILING_M = 0.06

_OWN_MAX_M, _OWN_BIN_M, _OWN_RETURNS = 0.06, 0.002, 20
"""A scan shows a face so far off at most, to so much, where so many of its returns tell."""
_OWN_FROM_M, _OWN_TO_M = 0.08, 0.7
"""Its foot and its top are told by what returned between these distances from floor, or ceiling."""

_LEAF_HANGS_M, _AT_LEAF_M = 0.03, 0.012
"""Over so much of a reveal, at its end, a return so far within the frame is the leaf's."""


class RelabellingSettings(StepSettings):
    """What the building's walls and doors change in a scan's labels."""

    wall_distance_m: float = Field(
        0.04, gt=0, description="Clutter within so many metres of a fused wall face becomes wall."
    )
    body_m: float = Field(
        0.07,
        ge=0,
        description="Clutter at most so many metres behind a face that the sensor looks at is within the wall: its scatter.",
    )
    leaf_distance_m: float = Field(
        0.1, gt=0, description="A return at most so many metres behind a closed leaf is its scatter."
    )
    margin_m: float = Field(0.05, ge=0, description="A wall face, or a window, counts so many metres beyond its ends.")
    at_reveal_m: float = Field(
        0.035, ge=0, description="A reveal or the underside of a lintel is known to so many metres."
    )
    opening_m: float = Field(0.015, ge=0, description="So many metres within the frame of an open door no wall stands.")
    refused_m: float = Field(
        0.06, ge=0, description="What a scan calls wall at most so many metres off a refused face is clutter, or outside."
    )
    pane_m: float = Field(0.0, ge=0, description="More than so many metres behind a pane a return is outside.")
    behind_glass_m: float = Field(
        0.12,
        gt=0,
        description="The same behind a window's wall, where the pane returned nothing and its place is not known.",
    )
    forget_m: float = Field(
        0.2, gt=0, description="A wall return farther than so many metres from every fused face becomes clutter."
    )
    edge_m: float = Field(
        0.06,
        ge=0,
        le=0.2,
        description="So near both to a wall and to floor or ceiling a return is of the one that its ray meets first.",
    )
    floor_scatter_m: float = Field(
        0.015, ge=0, description="A floor seen level lies within so many metres of where its plane is."
    )
    range_scatter_m: float = Field(
        0.02, ge=0, description="A return is off by at most so many metres along its ray, which lifts it off a floor seen steeply."
    )
    halo_ratio: float = Field(
        10.0,
        ge=1,
        description="Clutter with fewer than one in so many votes of the floor, ceiling or wall beside it is its scatter.",
    )
    halo_wall_m: float = Field(
        0.12, gt=0, description="So near one of the building's faces clutter may be a wall's scatter."
    )


def relabel(
    points_map: FloatArray,
    height_m: FloatArray,
    below_ceiling_m: FloatArray,
    label_scan: UInt8Array,
    origin_map: FloatArray,
    walls: Walls,
    before: BeforeWalls,
    judged: JudgedFaces,
    doors: Doors,
    windows: Windows,
    halo: Halo,
    levels: Sequence[HeightMap],
    settings: RelabellingSettings,
) -> UInt8Array:
    """The final labels (n,): what many scans agree on overrules what one scan saw.

    A return in a closed doorway is door; wall and door only stand where the building has them; clutter on a wall
    face or on a door's reveals or lintel is wall; what a ray reached through a window is outside; clutter that is but the
    scatter of a surface is that surface's, and at the height of the building's ceiling or of a raised floor it is that.

    points_map: (n, 3); height_m: (n,) above the floor; below_ceiling_m: (n,) below the scan's ceiling, infinite without
    one; label_scan: (n,) of the scan alone; origin_map: (3,) the sensor. before: what is before `walls`.
    judged: with the faces that are no walls, whose returns are clutter, or outside.
    """
    closed = doors.state == DoorState.CLOSED
    depth_m = np.where(closed, doors.depth_m, -np.inf)
    label = np.asarray(
        _relabel(
            points_map,
            height_m,
            below_ceiling_m,
            label_scan,
            _frames(walls.ends, walls.normal),
            walls.top_m,
            before.first,
            before.clear_m,
            before.covered,
            _frames(judged.refused.ends, judged.refused.normal),
            judged.refused.top_m,
            judged.refused_label,
            _frames(doors.ends, doors.normal),
            doors.head_m,
            depth_m,
            doors.reveal_m,
            _frames(windows.ends, windows.normal),
            np.where(np.isfinite(windows.pane_m), windows.pane_m + settings.pane_m, settings.behind_glass_m),
            np.ascontiguousarray(origin_map, np.float64),
            settings.wall_distance_m,
            settings.leaf_distance_m,
            settings.margin_m,
            settings.at_reveal_m,
            settings.opening_m,
            settings.refused_m,
            settings.forget_m,
            settings.edge_m,
            settings.body_m,
            settings.floor_scatter_m,
            settings.range_scatter_m,
        )
    )
    label = halo.label_of(points_map, label)
    for level in levels:
        label = level.label_of(points_map, label)
    return label


def _frames(ends: FloatArray, normal: FloatArray) -> FloatArray:
    """(k, 7) for each segment: direction x y, its first end's place along it, normal x y, offset, length."""
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.maximum(length, 1e-9)
    start = np.sum(along * ends[:, 0], axis=1, keepdims=True)
    offset = np.sum(normal * ends[:, 0], axis=1, keepdims=True)
    return np.ascontiguousarray(np.concatenate([along, start, normal, offset, length], axis=1))


@numba.njit(cache=True, nogil=True)
def _crossing(
    plane: FloatArray, behind_m: float, x: float, y: float, origin: FloatArray
) -> tuple[float, float]:  # pragma: no cover
    """Where a ray crosses a face, or the plane so far behind it: the share of the ray's length, the place along the face.

    NaN where the ray does not come from before the face, or runs along it, so that the crossing says nothing.
    """
    before = plane[3] * origin[0] + plane[4] * origin[1] - plane[5] + behind_m
    approach = before - (plane[3] * x + plane[4] * y - plane[5] + behind_m)
    if before <= 0.0 or approach < _GRAZING * np.hypot(x - origin[0], y - origin[1]):
        return np.nan, np.nan
    share = before / approach
    cx, cy = origin[0] + share * (x - origin[0]), origin[1] + share * (y - origin[1])
    return share, plane[0] * cx + plane[1] * cy - plane[2]


@numba.njit(cache=True, nogil=True)
def _own_places(
    points: FloatArray, height: FloatArray, below_ceiling: FloatArray, label_scan: UInt8Array, walls: FloatArray
) -> FloatArray:  # pragma: no cover
    """(W, 2) how far before each face the scan itself shows its foot, and its top; 0 where it shows neither.

    A pose may be off by a centimetre, and its upright by tenths of a degree, which is as much at the ceiling.
    """
    bins = int(2.0 * _OWN_MAX_M / _OWN_BIN_M)
    counts = np.zeros((len(walls), 2, bins), np.int64)
    for i in range(len(points)):
        if label_scan[i] != 3:
            continue
        at_foot = _OWN_FROM_M < height[i] < _OWN_TO_M
        if not at_foot and not _OWN_FROM_M < below_ceiling[i] < _OWN_TO_M:
            continue
        for w in range(len(walls)):
            s = walls[w, 3] * points[i, 0] + walls[w, 4] * points[i, 1] - walls[w, 5]
            u = walls[w, 0] * points[i, 0] + walls[w, 1] * points[i, 1] - walls[w, 2]
            if abs(s) < _OWN_MAX_M and _OWN_MAX_M < u < walls[w, 6] - _OWN_MAX_M:
                counts[w, 0 if at_foot else 1, min(int((s + _OWN_MAX_M) / _OWN_BIN_M), bins - 1)] += 1
    own_m = np.full((len(walls), 2), np.nan)
    for w in range(len(walls)):
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
def _at_edge(
    label: int,
    x: float,
    y: float,
    z: float,
    height: float,
    below_ceiling: float,
    origin: FloatArray,
    walls: FloatArray,
    own_m: FloatArray,
    wall_columns: IntArray,
    ceiling_before: FloatArray,
    doors: FloatArray,
    door_head: FloatArray,
    door_depth: FloatArray,
    edge_m: float,
) -> int:  # pragma: no cover
    """The label of a floor, ceiling or wall return by what its ray meets first, where two of them are near.

    Range is the noisy coordinate of a return, its direction is not: where the ray crosses a wall's face above the floor and
    below the ceiling it ended on the wall, and on floor or ceiling where it would reach the face beyond them.

    own_m: from `_own_places`.
    """
    near_floor, near_a_ceiling = abs(height) < edge_m, abs(below_ceiling) < edge_m
    if not (near_floor or near_a_ceiling):
        return label
    for d in range(len(doors)):
        # A closed leaf stands on the floor, behind its wall's face.
        if near_floor and door_depth[d] >= 0.0:
            s = doors[d, 3] * x + doors[d, 4] * y - doors[d, 5] + door_depth[d]
            if abs(s) < edge_m:
                share, u = _crossing(doors[d], door_depth[d], x, y, origin)
                if 0.0 < u < doors[d, 6]:
                    return 4 if height + (share - 1.0) * (z - origin[2]) > 0.0 else 1
    missed = False
    for w in range(len(walls)):
        before_m = own_m[w, 0 if near_floor else 1]
        if abs(walls[w, 3] * x + walls[w, 4] * y - walls[w, 5] - before_m) > edge_m:
            continue
        share, u = _crossing(walls[w], -before_m, x, y, origin)
        if not 0.0 <= u <= walls[w, 6]:
            continue
        rise = (share - 1.0) * (z - origin[2])
        cx, cy = origin[0] + share * (x - origin[0]), origin[1] + share * (y - origin[1])
        in_doorway = False
        for d in range(len(doors)):
            v = doors[d, 0] * cx + doors[d, 1] * cy - doors[d, 2]
            aside = abs(doors[d, 3] * cx + doors[d, 4] * cy - doors[d, 5])
            in_doorway = in_doorway or (0.0 < v < doors[d, 6] and aside < 0.5 and height + rise < door_head[d])
        if in_doorway:
            continue
        # A ceiling that hangs lower than the one before this wall is another room's.
        clear_m = ceiling_before[wall_columns[w] + min(int(u / CELL_M), wall_columns[w + 1] - wall_columns[w] - 1)]
        near_ceiling = near_a_ceiling and not height < clear_m - _ANOTHER_CEILING_M
        if (not near_floor or height + rise > 0.0) and (not near_ceiling or below_ceiling - rise > 0.0):
            return 3
        missed = True
    if label == 3 and missed:
        return 1 if near_floor else 2
    return label


@numba.njit(cache=True, nogil=True)
def _relabel(
    points: FloatArray,
    height: FloatArray,
    below_ceiling: FloatArray,
    label_scan: UInt8Array,
    walls: FloatArray,
    wall_top: FloatArray,
    wall_columns: IntArray,
    ceiling_before: FloatArray,
    covered: BoolArray,
    refused: FloatArray,
    refused_top: FloatArray,
    refused_label: UInt8Array,
    doors: FloatArray,
    door_head: FloatArray,
    door_depth: FloatArray,
    door_reveal: FloatArray,
    windows: FloatArray,
    beyond_m: FloatArray,
    origin: FloatArray,
    wall_distance_m: float,
    leaf_distance_m: float,
    margin_m: float,
    at_reveal_m: float,
    opening_m: float,
    refused_m: float,
    forget_m: float,
    edge_m: float,
    body_m: float,
    floor_scatter_m: float,
    range_scatter_m: float,
) -> UInt8Array:  # pragma: no cover
    label = label_scan.copy()
    own_m = _own_places(points, height, below_ceiling, label_scan, walls)
    for i in range(len(points)):
        x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
        is_outside = False
        is_reveal = False
        for g in range(len(windows)):
            s = windows[g, 3] * x + windows[g, 4] * y - windows[g, 5]
            reach = windows[g, 3] * origin[0] + windows[g, 4] * origin[1] - windows[g, 5]
            if s > -beyond_m[g]:
                # Between a window's face and its pane there is nothing but the sill, the head and the reveals.
                if s < wall_distance_m:
                    u = windows[g, 0] * x + windows[g, 1] * y - windows[g, 2]
                    is_reveal = is_reveal or -margin_m < u < windows[g, 6] + margin_m
                continue
            if reach < 0.0:
                continue
            t = reach / (reach - s)
            cx, cy = origin[0] + t * (x - origin[0]), origin[1] + t * (y - origin[1])
            u = windows[g, 0] * cx + windows[g, 1] * cy - windows[g, 2]
            if -margin_m < u < windows[g, 6] + margin_m:
                is_outside = True
                break
        if is_outside:
            label[i] = 5
            continue
        if 1 <= label[i] <= 3:
            label[i] = _at_edge(
                label[i],
                x,
                y,
                points[i, 2],
                height[i],
                below_ceiling[i],
                origin,
                walls,
                own_m,
                wall_columns,
                ceiling_before,
                doors,
                door_head,
                door_depth,
                edge_m,
            )
            if label[i] == 1:
                # A ray that comes in level ends on the floor, or far before it: what stands there has a foot.
                fall = origin[2] - points[i, 2]
                steepness = abs(fall) / np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2 + fall**2)
                if height[i] > floor_scatter_m + range_scatter_m * steepness:
                    label[i] = 0
            if label[i] != 3:
                continue
        is_leaf = False
        in_doorway = False
        in_opening = False
        for d in range(len(doors)):
            s = doors[d, 3] * x + doors[d, 4] * y - doors[d, 5]
            if abs(s) > 1.0:
                continue
            u, length = doors[d, 0] * x + doors[d, 1] * y - doors[d, 2], doors[d, 6]
            # Between the jambs of a closed door there is nothing but its leaf, its handle, and their scatter.
            if -door_depth[d] - leaf_distance_m < s < wall_distance_m:
                share, at_leaf = _crossing(doors[d], door_depth[d], x, y, origin)
                rise = (share - 1.0) * (points[i, 2] - origin[2])
                if np.isnan(share):
                    at_leaf, rise = u, 0.0
                if 0.0 < at_leaf < length and height[i] + rise < door_head[d]:
                    is_leaf = True
                    break
            in_opening = in_opening or (
                door_depth[d] < 0.0
                and opening_m < u < length - opening_m
                and height[i] < door_head[d] - opening_m
                and -door_reveal[d] - margin_m < s < margin_m
            )
            in_doorway = in_doorway or (-margin_m < u < length + margin_m and height[i] < door_head[d])
            # Beside the frame the wall is as deep as its other face scatters.
            deep_m = door_reveal[d] if 0.0 < u < length else door_reveal[d] + wall_distance_m
            if -deep_m < s < wall_distance_m and -wall_distance_m < u < length + wall_distance_m:
                # At the reveal's end an open leaf hangs, as thick as the reveal's scatter is wide.
                inner_m = _AT_LEAF_M if s < _LEAF_HANGS_M - door_reveal[d] else at_reveal_m
                at_jamb = u < inner_m or u > length - inner_m
                # Nothing but the lintel's underside is within the wall about the head, which is known to a cell or two.
                at_head = door_head[d] - at_reveal_m < height[i] < door_head[d] + 0.3
                is_reveal = is_reveal or at_head or (at_jamb and height[i] < door_head[d])
        if is_leaf:
            label[i] = 4
            continue
        if in_opening and not is_reveal:
            # A face goes on over its doors, but no wall stands in an open one.
            label[i] = 0
            continue
        nearest = np.inf
        is_scatter = False
        is_covered = False
        for w in range(len(walls)):
            s = walls[w, 3] * x + walls[w, 4] * y - walls[w, 5]
            behind = -s if walls[w, 3] * origin[0] + walls[w, 4] * origin[1] > walls[w, 5] else 0.0
            if abs(s) < nearest or 0.0 < behind < body_m:
                u = walls[w, 0] * x + walls[w, 1] * y - walls[w, 2]
                if -margin_m < u < walls[w, 6] + margin_m and height[i] < wall_top[w] + 0.1:
                    if abs(s) < nearest:
                        nearest = abs(s)
                        column = min(max(int(u / CELL_M), 0), wall_columns[w + 1] - wall_columns[w] - 1)
                        row = min(max(int(height[i] / CELL_M), 0), covered.shape[1] - 1)
                        is_covered = covered[wall_columns[w] + column, row]
                    is_scatter = is_scatter or 0.0 < behind < body_m
        if is_covered and nearest < forget_m and not is_reveal:
            label[i] = 0
            continue
        if nearest > wall_distance_m and (label[i] == 3 or label[i] == 4) and not is_reveal:
            refused_as = -1
            for f in range(len(refused)):
                if abs(refused[f, 3] * x + refused[f, 4] * y - refused[f, 5]) < refused_m:
                    u = refused[f, 0] * x + refused[f, 1] * y - refused[f, 2]
                    if -margin_m < u < refused[f, 6] + margin_m and height[i] < refused_top[f] + 0.2:
                        refused_as = refused_label[f]
                        break
            if refused_as >= 0:
                label[i] = refused_as
                continue
        if label[i] == 0 and (is_reveal or nearest < wall_distance_m or (is_scatter and not in_doorway)):
            label[i] = 3
        elif label[i] == 3 and nearest > forget_m:
            label[i] = 0
        elif label[i] == 4:
            label[i] = 3 if nearest < 2.0 * wall_distance_m else 0
    return label
