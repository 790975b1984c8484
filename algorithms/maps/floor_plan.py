"""The building as a vector plan: walls with thickness, doors with their leaves, windows, columns, rooms."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, main_direction_deg, turned
from ffmap.algorithms.building.face_columns import Storey
from ffmap.algorithms.building.model import Doors, Walls
from ffmap.algorithms.building.thickness import (
    WallParts,
    WallThicknessSettings,
    face_thickness,
    part_walls,
    usual_thickness,
)
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.maps.areas import closed, grown
from ffmap.algorithms.maps.furniture_free import Immobile
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.scan.doors import DoorState

_COLUMN_MAX_M = 1.2
"""Maximum width (m) of a column: what stands free and has a corner."""
_PIECE_MIN_M = 0.5
"""Minimum length (m) of a piece of wall that stands alone."""
_CORNER_M = 0.12
"""Maximum distance (m) of two faces' ends that make a corner."""
_DRAWN_SHARE_MIN = 0.5
"""Minimum share of a stretch of wall that the grid map shows for it to be drawn."""
_TIDY_M = 0.02
"""Half the width (m) of gaps between walls that are closed."""
_SLIVER_M2 = 0.004
"""Minimum area (m²) of a piece of wall."""
_DOUBLE_DOOR_M = 1.25
"""Maximum width (m) of a doorway with one leaf."""
_LEAF_SHARE_MIN = 0.6
"""Minimum share of an open leaf's area that is seen for its door to get a swing."""
_LEAF_LOW_M = 0.4
"""Minimum height above the floor (m) at which leaves are looked for."""
_LEAF_HIGH_M = 1.8
"""Maximum height above the floor (m) at which leaves are looked for."""
_LEAF_MIN_DEG = 20.0
"""Minimum angle (degrees) of an open leaf to its sill."""
_LEAF_MAX_DEG = 175.0
"""Maximum angle (degrees) of an open leaf to its sill."""
_LEAF_THICKNESS_M = 0.05
"""Maximum distance (m) of a leaf's returns from its middle."""
_HINGE_M = 0.15
"""Distance (m) from the hinge within which nothing tells of a leaf."""
_WALL_MARGIN_M = 0.1
"""Distance (m) from the wall's face within which returns may be the wall's and tell of no leaf."""


class RoomOnPlan(Protocol):
    """What the plan shows of a room; polygon in metres of the map frame."""

    @property
    def name(self) -> str: ...
    @property
    def polygon(self) -> shapely.Polygon: ...
    @property
    def area_m2(self) -> float: ...


@dataclass(frozen=True)
class Leaf:
    """A leaf that stood open. hinge, tip: (2,) in the map. swing_deg: from its closed place to where it stood, signed.

    share: of its area that was seen.
    """

    hinge: FloatArray
    tip: FloatArray
    swing_deg: float
    share: float


@dataclass(frozen=True)
class PlanDoor:
    """outline: what the doorway cuts out of the wall. sill: (2, 2) jambs, on the face in which it was seen.

    closed: (2, 2) where a closed leaf stands. leaves: those that were seen open; none leaves the swing unknown.
    """

    outline: shapely.Polygon
    sill: FloatArray
    closed: FloatArray
    state: DoorState
    leaves: tuple[Leaf, ...]


@dataclass(frozen=True)
class FloorPlan:
    """Everything in metres of the map frame.

    walls: areas of walls that were seen from both sides. assumed: of walls that were seen from one side, as thick as
    their doorways are deep, else with the building's usual thickness. columns: their outlines. windows: what they cut
    out of a wall. direction_deg: of most walls, against the x axis; see `main_direction_deg`.
    """

    walls: tuple[shapely.Polygon, ...]
    assumed: tuple[shapely.Polygon, ...]
    columns: tuple[shapely.Polygon, ...]
    doors: tuple[PlanDoor, ...]
    windows: tuple[shapely.Polygon, ...]
    rooms: tuple[RoomOnPlan, ...]
    direction_deg: float


def draw_floor_plan(
    stretches: Walls,
    immobile: Immobile,
    grid: GridMap,
    storey: Storey,
    thickness: WallThicknessSettings,
    rooms: Sequence[RoomOnPlan] = (),
) -> FloorPlan:
    """The plan of a building.

    stretches: `grid_map.standing_stretches`. grid: the furniture-free one; what it does not show is not drawn.
    storey: the floor that open leaves stand on.
    """
    stretches = stretches.select(_shown(stretches, grid))
    doors = immobile.doors
    of_walls = part_walls(immobile.walls, thickness)
    parts = part_walls(stretches, thickness)
    usual_m = usual_thickness(parts, thickness.unseen_m)
    assumed_m = _assumed_thickness(stretches, doors, usual_m)
    # A doorway is cut out of the wall as it is drawn, where both faces of that were seen.
    drawn_m = face_thickness(immobile.walls, of_walls)[doors.wall]
    cut_m = np.where(np.isfinite(drawn_m), drawn_m, doors.reveal_m)
    columns, in_column = _columns(stretches)
    upright = _upright(immobile.votes, storey)
    outlines = [_quad(doors.ends[d], doors.normal[d], float(cut_m[d])) for d in range(len(doors))]
    windows = [
        _quad(ends, normal, _thickness_at(ends, parts, stretches, usual_m))
        for ends, normal in zip(immobile.windows.ends, immobile.windows.normal, strict=True)
    ]
    cuts = shapely.union_all([*(grown(o, _TIDY_M / 2) for o in outlines), *windows, *columns])
    in_wall = ~in_column & ~_fragments(stretches)
    solid = _bodies(
        stretches, parts, assumed_m, in_wall[parts.wall] & np.isfinite(parts.thickness_m)
    )
    assumed = _bodies(
        stretches, parts, assumed_m, in_wall[parts.wall] & ~np.isfinite(parts.thickness_m)
    )
    solid = solid.difference(cuts)
    assumed = assumed.difference(cuts).difference(solid)
    return FloorPlan(
        walls=tuple(_polygons(solid, _SLIVER_M2)),
        assumed=tuple(_polygons(assumed, _SLIVER_M2)),
        columns=tuple(columns),
        doors=tuple(
            PlanDoor(
                outline=outlines[d],
                sill=doors.ends[d],
                closed=doors.ends[d] - np.nan_to_num(doors.depth_m[d]) * doors.normal[d],
                state=DoorState(int(doors.state[d])),
                leaves=_find_leaves(
                    doors.ends[d], doors.normal[d], float(doors.reveal_m[d]), upright
                )
                if doors.state[d] == DoorState.OPEN
                else (),
            )
            for d in range(len(doors))
        ),
        windows=tuple(windows),
        rooms=tuple(rooms),
        direction_deg=main_direction_deg(immobile.walls.ends),
    )


def _shown(stretches: Walls, grid: GridMap) -> BoolArray:
    """(W,) whether the grid shows most of each stretch; it leaves out what bounds no free space."""
    shown = np.zeros(len(stretches), bool)
    near = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    for w, ends in enumerate(stretches.ends):
        count = max(2, int(np.linalg.norm(ends[1] - ends[0]) / grid.cell_m))
        places = ends[0] + np.linspace(0, 1, count)[:, None] * (ends[1] - ends[0])
        index = np.floor((places - grid.origin) / grid.cell_m).astype(int)[:, None] + near
        index = np.clip(index, 0, np.array(grid.cells.shape[::-1]) - 1)
        occupied = grid.cells[index[..., 1], index[..., 0]] == Cell.OCCUPIED
        shown[w] = occupied.any(axis=1).mean() >= _DRAWN_SHARE_MIN
    return shown


def _assumed_thickness(stretches: Walls, doors: Doors, usual_m: float) -> FloatArray:
    """(W,) how thick the wall behind each stretch is taken for where one side was seen: as its doorways are deep."""
    assumed_m = np.full(len(stretches), usual_m)
    for w, (start, normal) in enumerate(zip(stretches.ends[:, 0], stretches.normal, strict=True)):
        off_m = np.abs((doors.ends - start) @ normal).max(axis=1)
        own = (off_m < _CORNER_M) & (doors.normal @ normal > 0.5)
        if own.any():
            assumed_m[w] = np.median(doors.reveal_m[own])
    return assumed_m


def _bodies(
    stretches: Walls, parts: WallParts, assumed_m: FloatArray, chosen: BoolArray
) -> BaseGeometry:
    """The union of the areas behind some parts of the faces, carried on around the corners of rooms."""
    bodies = []
    for p in np.flatnonzero(chosen):
        w = int(parts.wall[p])
        depth_m = float(parts.thickness_m[p]) if np.isfinite(parts.thickness_m[p]) else float(assumed_m[w])
        ends = parts.ends[p].copy()
        along = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-9)
        for end, outwards in ((0, -along), (1, along)):
            corner = _corner_thickness(ends[end], outwards, w, stretches, parts, assumed_m)
            ends[end] = ends[end] + corner * outwards
        bodies.append(_quad(ends, stretches.normal[w], depth_m))
    joined = shapely.union_all(bodies)
    return closed(joined, _TIDY_M).simplify(1e-3)


def _corner_thickness(
    end: FloatArray,
    outwards: FloatArray,
    w: int,
    stretches: Walls,
    parts: WallParts,
    assumed_m: FloatArray,
) -> float:
    """How far a wall goes on beyond the end of its face: through the wall that it meets at a room's inner corner."""
    for o in range(len(stretches)):
        # The other face looks back along this one: both bound the same room.
        if o == w or stretches.normal[o] @ outwards > -0.5:
            continue
        if np.linalg.norm(stretches.ends[o] - end, axis=1).min() < _CORNER_M:
            own = parts.thickness_m[parts.wall == o]
            return float(np.nanmedian(own)) if np.isfinite(own).any() else float(assumed_m[o])
    return 0.0


def _thickness_at(ends: FloatArray, parts: WallParts, stretches: Walls, usual_m: float) -> float:
    """Thickness of the wall that a window lies in."""
    middle = ends.mean(axis=0)
    best, nearest = usual_m, 0.5
    for p in np.flatnonzero(np.isfinite(parts.thickness_m)):
        line = shapely.LineString(parts.ends[p])
        distance = float(line.distance(shapely.Point(middle)))
        parallel = abs(stretches.normal[parts.wall[p]] @ (ends[1] - ends[0])) < 0.1 * np.linalg.norm(ends[1] - ends[0])
        if parallel and distance < nearest:
            best, nearest = float(parts.thickness_m[p]), distance
    return best


def _columns(stretches: Walls) -> tuple[list[shapely.Polygon], BoolArray]:
    """Free-standing columns, and which stretches (W,) are their faces."""
    in_column = np.zeros(len(stretches), bool)
    if not len(stretches):
        return [], in_column
    group = _groups(stretches, _CORNER_M)
    columns = []
    for g in np.unique(group):
        members = np.flatnonzero(group == g)
        normal, ends = stretches.normal[members], stretches.ends[members]
        if np.abs(normal @ normal[0]).min() > 0.5:
            continue
        # Square to its longest face: around two faces alone the smallest rectangle would lie aslant.
        across = normal[np.argmax(lengths_m(ends))]
        axes = np.array([[-across[1], across[0]], across])
        places = ends.reshape(-1, 2) @ axes.T
        (low_x, low_y), (high_x, high_y) = places.min(axis=0), places.max(axis=0)
        corners = np.array([[low_x, low_y], [high_x, low_y], [high_x, high_y], [low_x, high_y]]) @ axes
        # A column's faces look away from each other; a niche's, or a small room's, look at each other.
        outward = np.einsum("ij,ij->i", ends.mean(axis=1) - corners.mean(axis=0), normal) > -1e-6
        if max(high_x - low_x, high_y - low_y) <= _COLUMN_MAX_M and outward.all():
            columns.append(shapely.Polygon(corners))
            in_column[members] = True
    return columns, in_column


def _fragments(stretches: Walls) -> BoolArray:
    """(W,) which stretches stand alone and are short."""
    group = _groups(stretches, _PIECE_MIN_M)
    length_m = lengths_m(stretches.ends)
    return np.bincount(group, length_m, len(stretches))[group] < _PIECE_MIN_M


def _groups(stretches: Walls, apart_m: float) -> IntArray:
    """(W,) a number that those stretches share which stand together, each near to the next."""
    lines = [shapely.LineString(ends) for ends in stretches.ends]
    group = np.arange(len(lines))
    if not lines:
        return group
    for a, b in shapely.STRtree(lines).query(lines, predicate="dwithin", distance=apart_m).T:
        group[group == group[b]] = group[a]
    return group


def _upright(votes: VoxelVotes, storey: Storey) -> FloatArray:
    """(n, 3) x, y and the height above the floor of the cubes that may be of leaves: neither floor nor ceiling."""
    label = votes.label
    places = votes.mean_position[(label != Label.FLOOR) & (label != Label.CEILING)]
    height_m = places[:, 2] - storey.ground_m(places[:, :2])
    between = (height_m > _LEAF_LOW_M) & (height_m < _LEAF_HIGH_M)
    return np.column_stack([places[between, :2], height_m[between]])


def _find_leaves(
    sill: FloatArray, normal: FloatArray, depth_m: float, upright: FloatArray
) -> tuple[Leaf, ...]:
    """The leaves of an open door, by what stands upright from one of its jambs, as long as the doorway is wide.

    Tried is every angle at every jamb to both sides; one leaf hangs at each jamb at most, and a single one at one of them.
    """
    width_m = float(np.linalg.norm(sill[1] - sill[0]))
    double = width_m > _DOUBLE_DOOR_M
    length_m = width_m / 2 if double else width_m
    points = upright[np.linalg.norm(upright[:, :2] - sill.mean(axis=0), axis=1) < 1.5 * width_m + depth_m]
    found: list[tuple[int, Leaf]] = []
    for jamb in (0, 1):
        candidates = []
        for side in (0.0, depth_m):
            hinge = sill[jamb] - side * normal
            for angle in np.arange(_LEAF_MIN_DEG, _LEAF_MAX_DEG + 1.0, 5.0):
                # Turning towards the front is counter-clockwise at one jamb and clockwise at the other.
                towards = sill[1 - jamb] - sill[jamb]
                front = float(np.sign(towards[0] * normal[1] - towards[1] * normal[0]))
                swing = float(angle) * front * (1.0 if side == 0.0 else -1.0)
                direction = turned(towards / width_m, swing)
                # From there on a leaf is clear of the wall's own returns.
                start_m = max(_WALL_MARGIN_M / max(abs(float(direction @ normal)), 1e-9), _HINGE_M)
                if start_m > 0.5 * length_m:
                    continue
                share = _covered(points - np.append(hinge, 0.0), direction, start_m, length_m)
                candidates.append((share, Leaf(hinge, hinge + length_m * direction, swing, share)))
        if not candidates:
            continue
        share, leaf = max(candidates, key=lambda candidate: candidate[0])
        if share >= _LEAF_SHARE_MIN:
            found.append((jamb, leaf))
    if not double and len(found) > 1:
        found = [max(found, key=lambda jamb_leaf: jamb_leaf[1].share)]
    return tuple(leaf for _, leaf in found)


def _covered(points: FloatArray, direction: FloatArray, start_m: float, length_m: float) -> float:
    """Share of the 10 cm cells of an upright panel, between two distances from its hinge, that hold points seen from there."""
    cell_m = 0.1
    along = points[:, :2] @ direction
    across = np.abs(points[:, 0] * direction[1] - points[:, 1] * direction[0])
    on = (across < _LEAF_THICKNESS_M) & (along > start_m) & (along < length_m)
    columns = max(int((length_m - start_m) / cell_m), 1)
    rows = int((_LEAF_HIGH_M - _LEAF_LOW_M) / cell_m)
    column = np.minimum(((along[on] - start_m) / cell_m).astype(int), columns - 1)
    row = np.minimum(((points[on, 2] - _LEAF_LOW_M) / cell_m).astype(int), rows - 1)
    return len(np.unique(column * rows + row)) / (columns * rows)


def _quad(ends: FloatArray, normal: FloatArray, depth_m: float) -> shapely.Polygon:
    """What lies behind a stretch of a face."""
    return shapely.Polygon(np.concatenate([ends, ends[::-1] - depth_m * normal]))


def _polygons(area: BaseGeometry, min_m2: float) -> Iterable[shapely.Polygon]:
    return (p for p in getattr(area, "geoms", [area]) if p.geom_type == "Polygon" and p.area > min_m2)
