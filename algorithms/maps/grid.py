"""Grid maps of the building: furniture-free, or of what was hit in a slice of space (paper, IV.C, Fig. 6 and 9)."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import islice
from typing import Literal, NamedTuple

import numba
import numpy as np
from pydantic import Field
from scipy.ndimage import binary_closing, binary_dilation, binary_propagation, label
from scipy.spatial import cKDTree

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import Segment, lengthened, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import AT_FACE_M, CELL_M, Doors, Walls, Windows, cells_in, stretches
from ffmap.algorithms.building.ray_evidence import FOOT_ROW, THROUGH, Rays, WallCells, floor_m, returns_at_face
from ffmap.algorithms.building.thickness import WallThicknessSettings, face_thickness, part_walls
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.doors import DoorState

DoorsDrawn = Literal["open", "as-seen", "closed"]
_DOOR_MARGIN_M = 0.1
"""A free doorway reaches this far (m) beyond both sides of its wall. IV.C."""
_DOOR_GUESSED_M = 0.3
"""Minimum free depth (m) behind a sill where a leaf or a wall seen from one side hides more.
IV.C."""
_GAP_MAX_M = 0.6
"""Maximum width (m) of a gap beside or in a window's wall that is no passage."""
_FOOT_M = 0.15
"""Minimum height (m) above the floor of rays that prove an opening."""
_PASSED_RAYS_MIN = 6
"""Minimum rays that pass a wall's face at that height where it is open."""
_PASSED_RATIO = 2.0
"""Minimum number of rays that pass there for each that ends."""
_CROSSED_RAYS_MIN = 5
"""Minimum rays at that height that cross a cell for it not to be occupied."""
_CROSSED_RATIO = 5.0
"""Minimum number of rays that cross such a cell for each that ends."""
_CROSSED_CELLS_MIN = 4
"""Minimum number of such cells side by side."""
_ENDS_CELLS = 2.5
"""Maximum distance (cells) of a ray's end from a cell that it may have ended at."""
_SILL_MIN_M = 0.3
"""Minimum height (m) of a window's sill above the floor."""
_RECESS_MAX_M = 0.6
"""Maximum depth (m) of a window's recess, whose sides are no walls."""
_RECESS_BESIDE_M = 0.12
"""Maximum distance (m) of its sides from the window's ends."""
_LEAF_ABOVE_M = 0.3
"""Maximum height (m) above its door's head of what was seen of an open leaf."""
_LEAF_BESIDE_M = 0.1
"""Maximum distance (m) from the doorway of the reveal that an open leaf's face goes on over."""
_BOUNDS_CELLS = 2
"""Maximum distance (cells) from what rays crossed of a wall's cell that is drawn."""
_BLIND_M = 1.0
"""Maximum distance (m) from its way at which the robot may not see the floor."""
_STEP_MAX_M = 0.5
"""Maximum distance (m) of two places of the robot that its way joins: farther, poses are
missing."""


class GridMapSettings(StepSettings):
    """The furniture-free grid and its rivals (paper, IV.C, Fig. 9)."""

    cell_m: float = Field(0.05, ge=0.005, le=1, description="Edge of a cell (m). IV.C.")
    range_m: float = Field(25.0, gt=0, description="Maximum distance (m) from the sensor that rays make free. IV.C.")
    margin_m: float = Field(1.0, ge=0, description="Width (m) of the unknown border around what is drawn. IV.C.")
    doors: DoorsDrawn = Field(
        "open", description="Which doorways are free: open (all), as-seen (those that stood open), closed (none). IV.C."
    )
    rays_min: int = Field(
        3, ge=1, description="Minimum returns, or cubes of wall, that bear out 5 cm of a wall's face. IV.C."
    )
    bridge_m: float = Field(
        0.25, ge=0, description="Maximum gap (m) that is closed in a wall between what was seen of it. IV.C."
    )
    floor_reach_m: float = Field(
        1.5,
        ge=0,
        description="Maximum distance (m) of what rays crossed from floor that was seen: floor hides under tables.",
    )


class Cell(IntEnum):
    """What a cell holds; the values are those of ROS' map_server images."""

    OCCUPIED = 0
    UNKNOWN = 205
    FREE = 254


@dataclass(frozen=True)
class GridMap:
    """cells: (rows, columns) uint8, see `Cell`; row 0 is the lowest y. origin: (2,) x and y of its lower left corner."""

    cells: UInt8Array
    origin: FloatArray
    cell_m: float

    def centres(self, cell: Cell) -> FloatArray:
        """(m, 2) x and y of the middles of all cells of one kind."""
        return self.middles(self.cells == cell)

    def middles(self, chosen: BoolArray) -> FloatArray:
        """(m, 2) x and y of the middles of chosen cells."""
        rows, columns = np.nonzero(chosen)
        return np.asarray(self.origin + (np.stack([columns, rows], axis=1) + 0.5) * self.cell_m)

    def index(self, places: FloatArray) -> tuple[IntArray, BoolArray]:
        """Column and row (…, 2) of the cell that each place (…, 2) lies in, and whether (…,) the map reaches there."""
        index = np.floor((places - self.origin) / self.cell_m).astype(np.int64)
        return index, np.asarray(((index >= 0) & (index < self.cells.shape[::-1])).all(axis=-1))

    def cropped_to(self, other: "GridMap") -> "GridMap":
        """The part that another map of the same cells covers; unknown where this one does not reach."""
        column, row = np.round((self.origin - other.origin) / self.cell_m).astype(int)
        cells = np.full_like(other.cells, Cell.UNKNOWN)
        to_rows, from_rows = _overlap(row, self.cells.shape[0], cells.shape[0])
        to_columns, from_columns = _overlap(column, self.cells.shape[1], cells.shape[1])
        cells[to_rows, to_columns] = self.cells[from_rows, from_columns]
        return GridMap(cells, other.origin, self.cell_m)


def _overlap(shift: int, own: int, other: int) -> tuple[slice, slice]:
    """Where an axis of `own` cells lies in another one when it is shifted, and which of its cells lie there."""
    low, high = max(shift, 0), max(min(shift + own, other), max(shift, 0))
    return slice(low, high), slice(low - shift, high - shift)


class _Frame(NamedTuple):
    """Where the grid's cells lie: x and y of its first corner, and their edge, metres."""

    x: float
    y: float
    cell_m: float


@dataclass(frozen=True)
class Immobile:
    """What the furniture-free grid shows.

    cells: what rays found of the walls, from `wall_cells.trace_rays`. votes: of all scans' labels; they reach farther.
    """

    walls: Walls
    cells: WallCells
    votes: VoxelVotes
    doors: Doors
    windows: Windows


@dataclass(frozen=True)
class Draft:
    """A map of which is drawn what is occupied, and not yet what is free.

    canvas: what is drawn. windows: behind them nothing is free. doorways: (4, 2) each, free in any case. leaves: (2, 2) each,
    which bar theirs. faces: (F, 2, 2) of walls, if these are what is occupied: one that bounds nothing that rays crossed is
    hidden, as the reveals of windows are, and a wall that was carried on behind a pillar.
    """

    canvas: "_Canvas"
    windows: Windows
    doorways: Sequence[FloatArray] = ()
    leaves: Sequence[FloatArray] = ()
    faces: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))


def draft_furniture_free(
    immobile: Immobile, drive: Drive, settings: GridMapSettings, thickness: WallThicknessSettings, knee_m: float
) -> Draft:
    """Walls as thin lines, one for each side that was seen; doorways free through the whole wall (paper, Fig. 9b).

    What lies between the two sides of a wall nobody saw: it stays unknown. Panes stop rays, and stay unknown too.

    knee_m: `BuildingSettings.knee_m`, here and below.
    """
    doors = immobile.doors
    canvas = _Canvas.around([immobile.walls.ends, doors.ends, drive.path_map[:, :2]], settings)
    standing = standing_stretches(immobile, settings, knee_m).ends
    for ends in standing:
        canvas.draw_line(ends, Cell.OCCUPIED)
    canvas.drop_crossed(drive, standing, knee_m)
    parts = part_walls(immobile.walls, thickness)
    # Where the thickness is a guess, or a leaf hid whether it holds here, a doorway rather ends in the room behind.
    guessed = np.isnan(face_thickness(immobile.walls, parts)[doors.wall]) | (doors.state == DoorState.CLOSED)
    reach_m = np.where(guessed, np.maximum(doors.reveal_m, _DOOR_GUESSED_M), doors.reveal_m)
    doorways = [
        _doorway(doors.ends[d], doors.normal[d], reach_m[d], settings.cell_m)
        for d in range(len(doors))
    ]
    for doorway in doorways:
        canvas.draw_area(doorway, Cell.UNKNOWN)
    for d in range(len(doors)):
        for jamb in doors.ends[d]:
            canvas.draw_line(np.stack([jamb, jamb - doors.reveal_m[d] * doors.normal[d]]), Cell.OCCUPIED)
    shut = np.full(len(doors), settings.doors == "closed")
    if settings.doors == "as-seen":
        shut = doors.state == DoorState.CLOSED
    # Drawn when all is free: rays that passed an open door showed what is behind it.
    leaves = [doors.ends[d] - np.nan_to_num(doors.depth_m[d]) * doors.normal[d] for d in np.flatnonzero(shut)]
    open_doorways = [doorway for doorway, is_shut in zip(doorways, shut, strict=True) if not is_shut]
    return Draft(canvas, immobile.windows, open_doorways, leaves, immobile.walls.ends)


def draft_cells(cell_index: IntArray, windows: Windows, drive: Drive, settings: GridMapSettings) -> Draft:
    """A map of given occupied cells; it knows of no doors.

    cell_index: (m, 2) column and row of each cell of `settings.cell_m`, counted from the map frame's origin.
    """
    places = (cell_index + 0.5) * settings.cell_m
    canvas = _Canvas.around([places, drive.path_map[:, :2]], settings)
    canvas.draw_points(places, Cell.OCCUPIED)
    return Draft(canvas, windows)


def draw_free(
    drafts: Sequence[Draft], drive: Drive, settings: GridMapSettings, knee_m: float, workers: int = 1
) -> list[GridMap]:
    """The finished maps: free is what rays crossed before they met something, near to floor that was seen.

    Floor was seen where a ray to it ran below the knee, and counts if such cells join it to the robot's way.

    All maps in one walk along each ray, of which they are layers: each has a bit in every cell. At most 8 drafts.
    workers: number of threads.
    """
    layers = [_Layer(draft, settings) for draft in drafts]
    low, high = (np.array(ends) for ends in zip(*(layer.spanned for layer in layers), strict=True))
    first, shape = low.min(axis=0), (high.max(axis=0) - low.min(axis=0))[::-1]
    x, y = first * settings.cell_m
    frame = _Frame(float(x), float(y), settings.cell_m)
    # The rows and columns of each layer's own canvas; what lies beyond stops its rays.
    edges = np.column_stack([low - first, high - first])[:, [1, 3, 0, 2]]
    own = [(np.uint8(1 << m), slice(*edge[:2]), slice(*edge[2:])) for m, edge in enumerate(edges)]
    barred = np.full(shape, (1 << len(layers)) - 1, np.uint8)
    for layer, (bit, rows, columns) in zip(layers, own, strict=True):
        barred[rows, columns] &= np.where(layer.barred, ~np.uint8(0), ~bit)

    def walked(walk: Callable[[Rays, UInt8Array], None]) -> UInt8Array:
        """(2, rows, columns) what any ray marked."""

        def walk_share(worker: int) -> UInt8Array:
            marked = np.zeros((2, *shape), np.uint8)
            for block in islice(drive.blocks(), worker, None, workers):
                walk(Rays.of(block), marked)
            return marked

        with ThreadPoolExecutor(workers) as threads:
            return np.asarray(np.bitwise_or.reduce(list(threads.map(walk_share, range(workers)))))

    range_cells, gap_max = settings.range_m / settings.cell_m, 2.0 * _cells_reached(settings)
    marked = walked(lambda rays, marked: _cross(barred, len(layers), marked, rays, frame, knee_m, range_cells))
    supported = np.zeros(shape, np.uint8)
    for layer, (bit, rows, columns) in zip(layers, own, strict=True):
        crossed, ran_low = marked[:, rows, columns] & bit != 0
        layer.see(crossed, ran_low, drive.path_map)
        supported[rows, columns] |= np.where(layer.supported, bit, np.uint8(0))
    marked = walked(lambda rays, marked: _bound(barred, edges, supported, marked, rays, frame, range_cells, gap_max))
    path = drive.path_map[:, :2]
    return [
        layer.finished(marked[0, rows, columns] & bit != 0, path)
        for layer, (bit, rows, columns) in zip(layers, own, strict=True)
    ]


def standing_stretches(immobile: Immobile, settings: GridMapSettings, knee_m: float) -> Walls:
    """The stretches of the faces that returns bear out and that reach down to the floor, as faces of their own.

    Left out: what rays passed at knee height (an opening, though no door was made of it), what nothing was seen of (a
    pillar may stand before it), the reveals of windows, below which the wall goes on, and the leaves of open doors.
    """
    walls, cells = immobile.walls, immobile.cells
    voted = immobile.votes.mean_position[immobile.votes.label == Label.WALL, :2]
    tree = cKDTree(voted) if len(voted) else None
    owner: list[int] = []
    found: list[FloatArray] = []
    for w, face in enumerate(segments(walls)):
        counts = cells.counts[cells.first[w] : cells.first[w + 1]].astype(np.float64)
        stands, passed = _columns(counts, settings.rays_min, knee_m)
        middles = face.at((np.arange(len(stands)) + 0.5) * CELL_M)
        if tree is not None:
            stands |= tree.query_ball_point(middles, AT_FACE_M, return_length=True) >= settings.rays_min
        none = _in_window_reveal(middles, face.normal, immobile.windows)
        none |= passed
        # What only all scans together show was proven to stand up to the ceiling, or to be a wall with two sides: no leaf does.
        if walls.scan_count[w]:
            none |= _of_open_leaf(middles, float(walls.top_m[w]), immobile.doors)
        stands &= ~none
        # A face ends at a corner, up to which it is carried on as over any other gap.
        bridge = cells_in(settings.bridge_m)
        for first, last in stretches(np.concatenate([[True], stands, [True]]), bridge):
            columns = np.arange(max(first - 1, 0), min(last, len(stands)))
            open_columns = none[columns]
            if not stands[columns].any():
                continue
            for a, b in stretches(~open_columns, 0):
                low_m, high_m = columns[a] * CELL_M, min((columns[b] + 1) * CELL_M, face.length_m)
                owner.append(w)
                found.append(face.at(np.array([low_m, high_m])))
    return replace(walls.select(np.array(owner, np.int64)), ends=np.array(found).reshape(-1, 2, 2))


def _columns(counts: FloatArray, rays_min: int, knee_m: float) -> tuple[BoolArray, BoolArray]:
    """(c,) whether returns bear each column of a face out, and whether rays passed it down to the floor."""
    on = returns_at_face(counts)
    near = np.convolve(on.sum(axis=1), np.ones(3))[1:-1]
    low = slice(FOOT_ROW, cells_in(knee_m))
    on_low, passed_low = (
        np.convolve(rays[:, low].sum(axis=1), np.ones(3))[1:-1] for rays in (on, counts[..., THROUGH])
    )
    passed = (passed_low >= _PASSED_RAYS_MIN) & (passed_low > _PASSED_RATIO * on_low)
    return near >= rays_min, passed


def _in_window_reveal(places: FloatArray, normal: FloatArray, windows: Windows) -> BoolArray:
    """(c,) whether places (c, 2) of a face lie in the recess of a window with a sill, of whose wall it is no side."""
    within = np.zeros(len(places), bool)
    for window, bottom_m in zip(segments(windows), windows.bottom_m, strict=True):
        if bottom_m < _SILL_MIN_M or abs(normal @ window.normal) > 0.9:  # parallel, to 26°
            continue
        behind_m = -window.before_m(places)
        within |= (
            (behind_m > 0) & (behind_m < _RECESS_MAX_M) & window.beside(places, _RECESS_BESIDE_M)
        )
    return within


def _of_open_leaf(places: FloatArray, top_m: float, doors: Doors) -> BoolArray:
    """(c,) which places (c, 2) of a face belong to a leaf that stands open, beyond the reveal that it carries on.

    A face whose every place lies within a leaf's length of a jamb, and that ends where the door does, is no wall.
    """
    leaf = np.zeros(len(places), bool)
    may_be = (doors.state == DoorState.OPEN) & (top_m < doors.head_m + _LEAF_ABOVE_M)
    for doorway, reveal_m in zip(segments(doors.select(may_be)), doors.reveal_m[may_be], strict=True):
        behind_m = -doorway.before_m(places)
        beyond = (behind_m < -_LEAF_BESIDE_M) | (behind_m > reveal_m + _LEAF_BESIDE_M)
        reach_m = doorway.length_m + reveal_m + _LEAF_BESIDE_M
        for jamb in doorway.at(np.array([0.0, doorway.length_m])):
            if np.linalg.norm(places - jamb, axis=1).max() < reach_m:
                leaf |= beyond
    return leaf


def _doorway(ends: FloatArray, normal: FloatArray, depth_m: float, inset_m: float) -> FloatArray:
    """(4, 2) corners of what a doorway leaves free, around its sill."""
    sill = Segment.between(ends, normal)
    left, right = sill.at(np.array([inset_m, sill.length_m - inset_m]))
    front, back = _DOOR_MARGIN_M * normal, -(depth_m + _DOOR_MARGIN_M) * normal
    return np.array([left + front, right + front, right + back, left + back])


def _in_rectangle(places: FloatArray, corners: FloatArray) -> BoolArray:
    """Which places (n, 2) lie in a rectangle, given by its corners (4, 2) in order."""
    inside = np.ones(len(places), bool)
    for side in (corners[1] - corners[0], corners[3] - corners[0]):
        along = (places - corners[0]) @ side
        inside &= (along >= 0) & (along <= side @ side)
    return inside


def _glazed(faces: FloatArray, windows: Windows) -> list[FloatArray]:
    """The faces (F, 2, 2) that windows lie in."""
    chosen = []
    middles = windows.ends.mean(axis=1)
    for ends in faces:
        face = Segment.between(ends)
        in_face = (np.abs(face.before_m(middles)) < AT_FACE_M) & face.beside(middles)
        if (in_face & (np.abs(windows.normal @ face.along) < 0.1)).any():
            chosen.append(ends)
    return chosen


class _Layer:
    """One of the maps that are drawn together."""

    def __init__(self, draft: Draft, settings: GridMapSettings) -> None:
        self._draft, self._settings = draft, settings
        canvas = self._canvas = deepcopy(draft.canvas)
        # Glass stops rays: what lies behind belongs to another world.
        for ends in draft.windows.ends:
            canvas.draw_line(ends, Cell.OCCUPIED)
        for ends in [
            *_glazed(draft.faces, draft.windows),
            *lengthened(draft.windows.ends, _GAP_MAX_M),
        ]:
            canvas.close_gaps(ends, draft.doorways)
        self.spanned = canvas.first, canvas.first + canvas.cells.shape[::-1]
        self.barred = canvas.cells == Cell.OCCUPIED
        self.crossed = self.supported = np.zeros_like(self.barred)

    def see(self, crossed: BoolArray, low: BoolArray, path_map: FloatArray) -> None:
        """Find the floor that was seen. crossed: by rays; low: by rays that ran below the knee to the floor."""
        canvas = self._canvas
        canvas.cells[crossed] = Cell.FREE
        for doorway in self._draft.doorways:
            canvas.draw_area(doorway, Cell.FREE)
        crossed = canvas.cells == Cell.FREE
        # Far away rays lie apart; a wall is thicker than the gaps between them that this closes.
        self.crossed = crossed | (binary_closing(crossed, np.ones((3, 3))) & (canvas.cells == Cell.UNKNOWN))
        self.supported = canvas.joined_to(path_map, binary_closing(low, np.ones((3, 3))) & self.crossed)

    def finished(self, bounded: BoolArray, path: FloatArray) -> GridMap:
        """bounded: where rays came close to their end, or over known floor again. path: (n, 2) the robot's places."""
        draft, supported = self._draft, self.supported
        if reach := _cells_reached(self._settings):
            near = (binary_closing(bounded, np.ones((3, 3))) | supported) & self.crossed
            supported = binary_dilation(supported, iterations=reach, mask=near)
        canvas = deepcopy(draft.canvas)
        if len(draft.faces):
            visible = binary_dilation(self.crossed, np.ones((3, 3)), iterations=_BOUNDS_CELLS)
            canvas.cells[~visible] = Cell.UNKNOWN
        canvas.cells[supported] = Cell.FREE
        for step in np.stack([path[:-1], path[1:]], axis=1):
            if np.linalg.norm(step[1] - step[0]) < _STEP_MAX_M:
                canvas.draw_line(step, Cell.FREE)
        canvas.draw_points(path, Cell.FREE)
        for doorway in draft.doorways:
            canvas.draw_area(doorway, Cell.FREE)
        for leaf in draft.leaves:
            canvas.draw_line(leaf, Cell.OCCUPIED)
        return canvas.framed()


def _cells_reached(settings: GridMapSettings) -> int:
    """How many cells `floor_reach_m` spans."""
    return int(settings.floor_reach_m / settings.cell_m)


class _Canvas:
    """A grid while it is drawn."""

    def __init__(self, low: FloatArray, high: FloatArray, settings: GridMapSettings) -> None:
        self._settings = settings
        self._cell_m = settings.cell_m
        self.first = np.floor(low / self._cell_m).astype(np.int64)
        self._origin = self.first * self._cell_m
        columns, rows = np.maximum(np.ceil((high - self._origin) / self._cell_m).astype(int), 1)
        self.cells = np.full((rows, columns), Cell.UNKNOWN, np.uint8)

    @classmethod
    def around(cls, places: Sequence[FloatArray], settings: GridMapSettings) -> "_Canvas":
        """Space for places (…, 2) with the margin around; one cell where there are none."""
        corners = np.concatenate([np.zeros((0, 2)), *(place.reshape(-1, 2) for place in places)])
        if not len(corners):
            return cls(np.zeros(2), np.zeros(2), settings)
        return cls(corners.min(axis=0) - settings.margin_m, corners.max(axis=0) + settings.margin_m, settings)

    def draw_points(self, places: FloatArray, cell: Cell) -> None:
        self._set(self._index(places), cell)

    def draw_line(self, ends: FloatArray, cell: Cell) -> None:
        """Thin, and nothing passes it cell by cell."""
        self._set(self._on_line(ends), cell)

    def _on_line(self, ends: FloatArray) -> IntArray:
        """(k, 2) one cell for each column, or each row, that the segment crosses."""
        start, stop = (ends - self._origin) / self._cell_m
        axis = int(abs(stop[1] - start[1]) > abs(stop[0] - start[0]))
        low, high = sorted((start[axis], stop[axis]))
        middles = np.arange(np.floor(low), np.floor(high) + 1) + 0.5
        middles = np.clip(middles, low, high)
        t = (middles - start[axis]) / (stop[axis] - start[axis]) if high > low else np.zeros(1)
        return np.asarray(np.floor(start + t[:, None] * (stop - start)).astype(np.int64))

    def draw_area(self, corners: FloatArray, cell: Cell) -> None:
        """corners: (4, 2) of a rectangle, in order; drawn are the cells whose middle lies in it."""
        rows, columns = self.cells.shape
        low = np.clip(self._index(corners.min(axis=0)[None])[0], 0, [columns, rows])
        high = np.clip(self._index(corners.max(axis=0)[None])[0] + 1, 0, [columns, rows])
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        index = np.stack([x.ravel(), y.ravel()], axis=1)
        inside = _in_rectangle(self._origin + (index + 0.5) * self._cell_m, corners)
        self._set(index[inside], cell)

    def close_gaps(self, ends: FloatArray, doorways: Sequence[FloatArray]) -> None:
        """Let no ray pass a gap in a face that nobody could: beside a pane, or where a part of one was not told.

        ends: (2, 2) of a line along the face.
        """
        line = Segment.between(ends)
        step_m = self._cell_m / 4
        places = np.linspace(ends[0], ends[1], int(line.length_m / step_m) + 2)
        across = self._cell_m * line.normal
        stands = np.zeros(len(places), bool)
        for side in (-across, np.zeros(2), across):
            row, column = np.clip(self._index(places + side)[:, ::-1], 0, np.array(self.cells.shape) - 1).T
            stands |= self.cells[row, column] == Cell.OCCUPIED
        for first, last in stretches(~stands, 0):
            bounded = first > 0 and last < len(places) - 1 and (last - first) * step_m < _GAP_MAX_M
            if bounded and not any(_in_rectangle(places[first : last + 1], doorway).any() for doorway in doorways):
                self.draw_line(places[[first - 1, last + 1]], Cell.OCCUPIED)

    def framed(self) -> GridMap:
        """What is known, with the margin around it: faces that were hidden or passed need no space."""
        known = self.cells != Cell.UNKNOWN
        if not known.any():
            return GridMap(self.cells, self._origin, self._cell_m)
        margin = round(self._settings.margin_m / self._cell_m)
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        bottom, left = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
        cells = self.cells[bottom : rows[-1] + 1 + margin, left : columns[-1] + 1 + margin]
        return GridMap(
            np.ascontiguousarray(cells), self._origin + self._cell_m * np.array([left, bottom]), self._cell_m
        )

    def drop_crossed(self, drive: Drive, lines: FloatArray, knee_m: float) -> None:
        """Forget occupied cells, several side by side, that many more rays crossed below the knee than ended there.

        A face knows of the rays that come from its front; what hangs in a room is passed below from both sides.

        lines: (n, 2, 2) that were drawn.
        """
        across = np.zeros((*self.cells.shape, 2))
        for ends in lines:
            index = self._on_line(ends)
            column, row = index[self._in_grid(index)].T
            across[row, column] = Segment.between(ends).normal
        counts = np.zeros((*self.cells.shape, 2), np.int32)
        for block in drive.blocks():
            _count_crossings(self.cells, across, counts, Rays.of(block), self.frame, knee_m)
        ended, crossed = counts[..., 0], counts[..., 1]
        open_cells = (crossed >= _CROSSED_RAYS_MIN) & (crossed > _CROSSED_RATIO * ended)
        run, _ = label(open_cells, np.ones((3, 3)))
        self.cells[open_cells & (np.bincount(run.ravel()) >= _CROSSED_CELLS_MIN)[run]] = (
            Cell.UNKNOWN
        )

    @property
    def frame(self) -> _Frame:
        """Where its cells lie."""
        return _Frame(float(self._origin[0]), float(self._origin[1]), self._cell_m)

    def joined_to(self, path_map: FloatArray, low: BoolArray) -> BoolArray:
        """What rays close above the floor join to the robot's way: not what lies behind a sill, seen though it may be."""
        start = np.zeros(self.cells.shape, bool)
        index = self._index(path_map)
        index = index[self._in_grid(index)]
        start[index[:, 1], index[:, 0]] = True
        start = binary_dilation(start, iterations=int(_BLIND_M / self._cell_m)) & low
        return np.asarray(binary_propagation(start, np.ones((3, 3)), low))

    def _index(self, places: FloatArray) -> IntArray:
        return np.asarray(np.floor((places[:, :2] - self._origin) / self._cell_m).astype(np.int64))

    def _in_grid(self, index_xy: IntArray) -> BoolArray:
        rows, columns = self.cells.shape
        return np.asarray((index_xy >= 0).all(axis=1) & (index_xy[:, 0] < columns) & (index_xy[:, 1] < rows))

    def _set(self, index_xy: IntArray, cell: Cell) -> None:
        inside = index_xy[self._in_grid(index_xy)]
        self.cells[inside[:, 1], inside[:, 0]] = cell


@numba.njit(cache=True, nogil=True)
def _count_crossings(
    cells: UInt8Array,
    across: FloatArray,
    counts: IntArray,
    rays: Rays,
    frame: _Frame,
    knee_m: float,
) -> None:  # pragma: no cover
    """For each occupied cell the rays that end in it or beside it, and those that cross it; in cells, but for heights.

    A ray that runs along a line, close before it, meets its cells but does not cross it.

    across: (rows, columns, 2) at right angles to the line in each cell. A crossing counts at a
    height from `_FOOT_M` to `knee_m` above the floor, as its scan saw that.
    """
    rows, columns = cells.shape
    origin, starts, end, floors = rays.origin, rays.starts, rays.end, rays.floors
    for s in range(len(origin)):
        x0, y0 = (origin[s, 0] - frame.x) / frame.cell_m, (origin[s, 1] - frame.y) / frame.cell_m
        begin_m = origin[s, 2] - floor_m(floors, s, origin[s, 0], origin[s, 1])
        for r in range(starts[s] + s % 2, starts[s + 1], 2):
            dx, dy = (end[r, 0] - frame.x) / frame.cell_m - x0, (end[r, 1] - frame.y) / frame.cell_m - y0
            end_m = end[r, 2] - floor_m(floors, s, np.float64(end[r, 0]), np.float64(end[r, 1]))
            length = np.sqrt(dx * dx + dy * dy)
            count = int(2 * length) + 1
            last = -1
            for k in range(count + 1):
                t = k / count
                height = begin_m + t * (end_m - begin_m)
                column, row = int(np.floor(x0 + t * dx)), int(np.floor(y0 + t * dy))
                if column < 0 or row < 0 or column >= columns or row >= rows:
                    break
                cell = row * columns + column
                if cell == last or cells[row, column] != 0 or height < _FOOT_M or height > knee_m:
                    continue
                last = cell
                behind = (1 - t) * abs(dx * across[row, column, 0] + dy * across[row, column, 1])
                if behind > _ENDS_CELLS:
                    counts[row, column, 1] += 1
                elif length * (1 - t) <= _ENDS_CELLS:
                    counts[row, column, 0] += 1


@numba.njit(cache=True, nogil=True)
def _walk(
    barred: UInt8Array,
    layers: int,
    x: float,
    y: float,
    dx: float,
    dy: float,
    range_cells: float,
    found: IntArray,
    entered: FloatArray,
    going: UInt8Array,
) -> tuple[int, int, bool]:  # pragma: no cover
    """Walk a ray cell by cell (Amanatides and Woo 1987), up to what bars it in all layers: the number of cells that it crosses,
    the layers, as bits, in which nothing barred it, and whether it came to its end in those rather than to that of the map, or of
    its range.

    x, y: where it begins; dx, dy: from there to its end; in cells. found: (k, 2) to be filled with the cells' rows and columns.
    entered: (k,) with the ray's length up to each; going: (k,) with the layers, as bits, in which nothing has barred it so far.
    They hold one cell more, where the last of the layers is barred.
    """
    rows, columns = barred.shape
    length = np.sqrt(dx * dx + dy * dy)
    if length < 1e-6:
        return 0, 0, True
    column, row = int(np.floor(x)), int(np.floor(y))
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    t_dx = length / abs(dx) if dx != 0 else np.inf
    t_dy = length / abs(dy) if dy != 0 else np.inf
    t_x = (column + (dx > 0) - x) * step_x * t_dx if dx != 0 else np.inf
    t_y = (row + (dy > 0) - y) * step_y * t_dy if dy != 0 else np.inf
    at, count, left = 0.0, 0, (1 << layers) - 1
    while at <= length:
        if at > range_cells or count == len(found) or column < 0 or row < 0 or column >= columns or row >= rows:
            return count, left, False
        left &= ~int(barred[row, column])
        found[count, 0], found[count, 1], entered[count], going[count] = row, column, at, left
        if left == 0:
            break
        count += 1
        at = min(t_x, t_y)
        if t_x < t_y:
            column += step_x
            t_x += t_dx
        else:
            row += step_y
            t_y += t_dy
    return count, left, True


@numba.njit(cache=True, nogil=True)
def _cross(
    barred: UInt8Array,
    layers: int,
    marked: UInt8Array,
    rays: Rays,
    frame: _Frame,
    knee_m: float,
    range_cells: float,
) -> None:  # pragma: no cover
    """Mark (2, rows, columns) what every fourth ray crosses, and where it runs below the knee to its end on the floor."""
    found = np.empty((int(2 * range_cells) + 4, 2), np.int64)
    entered, going = np.empty(len(found)), np.empty(len(found), np.uint8)
    crossed, low = marked[0], marked[1]
    origin, starts, end, label, floors = rays.origin, rays.starts, rays.end, rays.label, rays.floors
    for s in range(len(origin)):
        x, y = (origin[s, 0] - frame.x) / frame.cell_m, (origin[s, 1] - frame.y) / frame.cell_m
        begin_m = origin[s, 2] - floor_m(floors, s, origin[s, 0], origin[s, 1])
        for r in range(starts[s] + s % 4, starts[s + 1], 4):
            dx, dy = (end[r, 0] - frame.x) / frame.cell_m - x, (end[r, 1] - frame.y) / frame.cell_m - y
            low_from = np.inf
            if label[r] == Label.FLOOR:
                drop_m = begin_m - (end[r, 2] - floor_m(floors, s, np.float64(end[r, 0]), np.float64(end[r, 1])))
                low_from = (1.0 - knee_m / max(drop_m, knee_m)) * np.sqrt(dx * dx + dy * dy)
            count, _, _ = _walk(barred, layers, x, y, dx, dy, range_cells, found, entered, going)
            for k in range(count):
                crossed[found[k, 0], found[k, 1]] |= going[k]
                if entered[k] >= low_from:
                    low[found[k, 0], found[k, 1]] |= going[k]


@numba.njit(cache=True, nogil=True)
def _bound(
    barred: UInt8Array,
    edges: IntArray,
    supported: UInt8Array,
    marked: UInt8Array,
    rays: Rays,
    frame: _Frame,
    range_cells: float,
    gap_max: float,
) -> None:  # pragma: no cover
    """Mark (the first of 2, rows, columns) where a ray will end, or be above known floor again, within `gap_max` cells.

    edges: (layers, 4) the first and the last row and column, exclusive, of each layer's own canvas.
    """
    found = np.empty((int(2 * range_cells) + 4, 2), np.int64)
    entered, going = np.empty(len(found)), np.empty(len(found), np.uint8)
    bounded, layers = marked[0], len(edges)
    origin, starts, end = rays.origin, rays.starts, rays.end
    for s in range(len(origin)):
        x, y = (origin[s, 0] - frame.x) / frame.cell_m, (origin[s, 1] - frame.y) / frame.cell_m
        for r in range(starts[s] + s % 4, starts[s + 1], 4):
            dx, dy = (end[r, 0] - frame.x) / frame.cell_m - x, (end[r, 1] - frame.y) / frame.cell_m - y
            count, left, whole = _walk(barred, layers, x, y, dx, dy, range_cells, found, entered, going)
            for layer in range(layers):
                bit = np.uint8(1 << layer)
                own = count
                while own and not going[own - 1] & bit:
                    own -= 1
                if not own:
                    continue
                row, column = found[own, 0], found[own, 1]
                top, bottom, start, stop = edges[layer]
                # Beyond its canvas a layer's rays go on, though they are followed no farther.
                ends = whole if left & bit else top <= row < bottom and start <= column < stop
                last = entered[own - 1] if ends else np.inf
                for k in range(own - 1, -1, -1):
                    if supported[found[k, 0], found[k, 1]] & bit:
                        last = entered[k]
                    elif last - entered[k] <= gap_max:
                        bounded[found[k, 0], found[k, 1]] |= bit
