"""The building as a vector plan: walls with thickness, doors, windows, columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, main_direction_deg, moved
from ffmap.algorithms.building.model import Doors, Walls
from ffmap.algorithms.building.thickness import (
    WallParts,
    WallThicknessSettings,
    face_thickness,
    part_walls,
    usual_thickness,
)
from ffmap.algorithms.maps.area_graph import Room
from ffmap.algorithms.maps.areas import closed, grown
from ffmap.algorithms.maps.furniture_free import Immobile
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.scan.doors import DoorState

_COLUMN_MAX_M = 1.2
"""Maximum width (m) of a free-standing column."""
_PIECE_MIN_M = 0.5
"""Minimum length (m) of an isolated piece of wall."""
_CORNER_M = 0.12
"""Maximum distance (m) of two faces' ends that form a corner."""
_WINDOW_WALL_M = 0.5
"""Maximum distance (m) of a window from the wall whose thickness it has."""
_DRAWN_SHARE_MIN = 0.5
"""Minimum share of a stretch of wall that the grid map shows for it to be drawn."""
_TIDY_M = 0.02
"""Half the width (m) of gaps between walls that are closed."""
_SLIVER_M2 = 0.004
"""Minimum area (m²) of a piece of wall."""


@dataclass(frozen=True)
class PlanDoor:
    """A door on the plan.

    outline: what the doorway cuts out of the wall. sill: (2, 2) jambs, on the face in which the
    door was seen. closed: (2, 2) where the leaf is, or would be, closed.
    """

    outline: shapely.Polygon
    sill: FloatArray
    closed: FloatArray
    state: DoorState


@dataclass(frozen=True)
class FloorPlan:
    """The plan, in metres of the map frame.

    walls: areas of walls that were seen from both sides. assumed: of walls that were seen from one
    side, as thick as their doorways are deep, else with the building's usual thickness. windows:
    what they cut out of walls. direction_deg: see `main_direction_deg`.
    """

    walls: tuple[shapely.Polygon, ...]
    assumed: tuple[shapely.Polygon, ...]
    columns: tuple[shapely.Polygon, ...]
    doors: tuple[PlanDoor, ...]
    windows: tuple[shapely.Polygon, ...]
    rooms: tuple[Room, ...]
    direction_deg: float


def draw_floor_plan(
    standing: Walls,
    immobile: Immobile,
    grid: GridMap,
    thickness: WallThicknessSettings,
    rooms: Sequence[Room] = (),
) -> FloorPlan:
    """Draw the plan of a building.

    standing: see `standing_stretches`. grid: the furniture-free grid; what it does not show is not
    drawn.
    """
    stretches = standing.select(_shown(standing, grid))
    doors = immobile.doors
    parts = part_walls(stretches, thickness)
    usual_m = usual_thickness(parts, thickness.unseen_m)
    assumed_m = _assumed_thickness(stretches, doors, usual_m)
    columns, in_column = _columns(stretches)
    outlines = _doorways(immobile, thickness)
    windows = [
        _behind(ends, normal, _thickness_at(ends, parts, stretches, usual_m))
        for ends, normal in zip(immobile.windows.ends, immobile.windows.normal, strict=True)
    ]
    cuts = shapely.union_all([*(grown(o, _TIDY_M / 2) for o in outlines), *windows, *columns])
    in_wall = (~in_column & ~_fragments(stretches))[parts.wall]
    measured = np.isfinite(parts.thickness_m)
    walls, assumed = (
        _bodies(stretches, parts, assumed_m, in_wall & chosen).difference(cuts)
        for chosen in (measured, ~measured)
    )
    closed_leaves = moved(doors.ends, doors.normal, -np.nan_to_num(doors.depth_m))
    states = [DoorState(state) for state in doors.state.tolist()]
    plan_doors = map(PlanDoor, outlines, doors.ends, closed_leaves, states)
    return FloorPlan(
        walls=_pieces(walls),
        assumed=_pieces(assumed.difference(walls)),
        columns=tuple(columns),
        doors=tuple(plan_doors),
        windows=tuple(windows),
        rooms=tuple(rooms),
        direction_deg=main_direction_deg(immobile.walls.ends),
    )


def _shown(stretches: Walls, grid: GridMap) -> BoolArray:
    """(W,) whether the grid shows most of each stretch; it hides walls that bound no free space."""
    occupied = binary_dilation(grid.cells == Cell.OCCUPIED)
    shares = [occupied[grid.on_line(ends)] for ends in stretches.ends]
    return np.array([len(on) > 0 and on.mean() >= _DRAWN_SHARE_MIN for on in shares], bool)


def _doorways(immobile: Immobile, thickness: WallThicknessSettings) -> list[shapely.Polygon]:
    """What each doorway cuts out of its wall: all of it, where both faces of that were seen."""
    doors, walls = immobile.doors, immobile.walls
    measured_m = face_thickness(walls, part_walls(walls, thickness))[doors.wall]
    depth_m = np.where(np.isfinite(measured_m), measured_m, doors.reveal_m)
    return [_behind(*own) for own in zip(doors.ends, doors.normal, depth_m, strict=True)]


def _assumed_thickness(stretches: Walls, doors: Doors, usual_m: float) -> FloatArray:
    """(W,) thickness of the wall behind each stretch, as its doorways are deep, else as usual."""
    assumed_m = np.full(len(stretches), usual_m)
    for w, (ends, normal) in enumerate(zip(stretches.ends, stretches.normal, strict=True)):
        off_m = np.abs((doors.ends - ends[0]) @ normal).max(axis=1)
        own = (off_m < _CORNER_M) & (doors.normal @ normal > 0.5)
        if own.any():
            assumed_m[w] = np.median(doors.reveal_m[own])
    return assumed_m


def _bodies(
    stretches: Walls, parts: WallParts, assumed_m: FloatArray, chosen: BoolArray
) -> BaseGeometry:
    """The union of the areas behind some parts of the faces, continued around rooms' corners."""
    bodies = []
    for p in np.flatnonzero(chosen):
        w = int(parts.wall[p])
        known_m = float(parts.thickness_m[p])
        ends = parts.ends[p].copy()
        along = (ends[1] - ends[0]) / max(float(np.linalg.norm(ends[1] - ends[0])), 1e-9)
        for end, outwards in ((0, -along), (1, along)):
            ends[end] += _corner_m(ends[end], outwards, w, stretches, parts, assumed_m) * outwards
        depth_m = known_m if np.isfinite(known_m) else float(assumed_m[w])
        bodies.append(_behind(ends, stretches.normal[w], depth_m))
    return closed(shapely.union_all(bodies), _TIDY_M).simplify(1e-3)


def _corner_m(
    end: FloatArray,
    outwards: FloatArray,
    w: int,
    stretches: Walls,
    parts: WallParts,
    assumed_m: FloatArray,
) -> float:
    """How far (m) a wall continues at an inner corner: through the wall that it meets there."""
    # The other face looks back along this one: both bound the same room.
    meets = stretches.normal @ outwards <= -0.5
    meets &= np.linalg.norm(stretches.ends - end, axis=2).min(axis=1) < _CORNER_M
    meets[w] = False
    if not meets.any():
        return 0.0
    other = int(meets.argmax())
    own = parts.thickness_m[parts.wall == other]
    return float(np.nanmedian(own)) if np.isfinite(own).any() else float(assumed_m[other])


def _thickness_at(ends: FloatArray, parts: WallParts, stretches: Walls, usual_m: float) -> float:
    """Thickness of the wall around a window."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    middle = shapely.Point(ends.mean(axis=0))
    away_m = shapely.distance(shapely.linestrings(parts.ends), middle)
    usable = np.isfinite(parts.thickness_m) & (away_m < _WINDOW_WALL_M)
    usable &= np.abs(stretches.normal[parts.wall] @ along) < 0.1
    if not usable.any():
        return usual_m
    return float(parts.thickness_m[np.where(usable, away_m, np.inf).argmin()])


def _columns(stretches: Walls) -> tuple[list[shapely.Polygon], BoolArray]:
    """Free-standing columns, and which stretches (W,) are their faces."""
    in_column = np.zeros(len(stretches), bool)
    group = _groups(stretches, _CORNER_M)
    columns = []
    for g in np.unique(group):
        members = np.flatnonzero(group == g)
        normal, ends = stretches.normal[members], stretches.ends[members]
        if np.abs(normal @ normal[0]).min() > 0.5:
            continue
        # Square to its longest face: the smallest rectangle around two faces alone is slanted.
        across = normal[np.argmax(lengths_m(ends))]
        axes = np.array([[-across[1], across[0]], across])
        places = ends.reshape(-1, 2) @ axes.T
        low, high = places.min(axis=0), places.max(axis=0)
        corners = shapely.get_coordinates(shapely.box(*low, *high)) @ axes
        # A column's faces look away from each other; those of a niche look at each other.
        off = ends.mean(axis=1) - corners[:-1].mean(axis=0)
        outward = np.einsum("ij,ij->i", off, normal) > -1e-6
        if (high - low).max() <= _COLUMN_MAX_M and outward.all():
            columns.append(shapely.Polygon(corners))
            in_column[members] = True
    return columns, in_column


def _fragments(stretches: Walls) -> BoolArray:
    """(W,) which stretches are isolated and short."""
    group = _groups(stretches, _PIECE_MIN_M)
    return np.bincount(group, lengths_m(stretches.ends), len(stretches))[group] < _PIECE_MIN_M


def _groups(stretches: Walls, apart_m: float) -> IntArray:
    """(W,) a number for each group of stretches, of near stretches."""
    lines = shapely.linestrings(stretches.ends)
    pairs = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=apart_m)
    graph = csr_array((np.ones(pairs.shape[1]), pairs), (len(lines), len(lines)))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _behind(ends: FloatArray, normal: FloatArray, depth_m: float) -> shapely.Polygon:
    """The rectangle behind a stretch of a face."""
    return shapely.Polygon(np.concatenate([ends, ends[::-1] - depth_m * normal]))


def _pieces(area: BaseGeometry) -> tuple[shapely.Polygon, ...]:
    return tuple(piece for piece in shapely.get_parts(area) if piece.area > _SLIVER_M2)
