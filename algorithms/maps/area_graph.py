"""Rooms, passages and topology of a grid map: the Area Graph (paper, IV.D, Fig. 10).

The Area Graph (Hou, Yuan and Schwertfeger 2019, the paper's [5]) cuts the Voronoi diagram at openings that a disc of
diameter w cannot pass. No w fits all maps: here an opening is narrow beside the rooms that it parts. Straight lines between
corners of walls close mouths (`mouths.py`); in what they leave open, watershed basins of the distance to the nearest obstacle
stand for areas, the saddle between two basins for the critical point of an opening (Thrun 1998). Two basins are two rooms
where the opening is markedly narrower than both: a narrow corridor stays a room. Where doors were detected, they part the rooms.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np
import shapely
from pydantic import Field
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist, squareform
from skimage.morphology import convex_hull_image, local_maxima
from skimage.segmentation import watershed

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import Faces, lengths_m
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import Doors
from ffmap.algorithms.maps.areas import grown, largest
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.mouths import find_mouths, join_open_areas
from ffmap.algorithms.maps.room_outlines import Sides, lay_on_faces

NO_DOORWAYS: FloatArray = np.zeros((0, 4, 2))
NO_LINES: FloatArray = np.zeros((0, 2, 2))
_EIGHT = np.ones((3, 3), bool)
_MARGIN = 10  # cells around the free ones that stay in view
_MOUTH_RATIO = 0.85
"""Maximum width of an opening that parts two rooms where a wall would go on along it, as a share of
what lies on either side."""
_ENCLOSED_RATIO = 1.5
"""Maximum width of all straight openings of a room, as a share of its own; what is more open is
none."""
_BLOCK_FILL_MIN = 0.25
"""Minimum share of the square of its length that a compact block covers."""
_BEAM_M = 0.15
"""Half the width (m) of the narrowest room: what is narrower are rays that left through a gap."""
_JAMB_M = 0.1
"""A doorway is closed this far (m) into both jambs, whose place is not known better."""
_BESIDE_DOOR_M = 0.4
"""Maximum distance (m) of a room from the doorway that leads into it."""
_SKELETON_M = 0.25
"""Minimum distance (m) of the drawn Voronoi graph's edges from the obstacles."""


class Segmented(StrEnum):
    """The three that the paper compares (Fig. 10)."""

    FURNITURE_FREE = "furniture_free"
    NORMAL = "normal"  # a slice halfway up with its furniture, of which alpha removal takes away what it knows
    NORMAL_AS_IS = "normal_without_alpha_removal"


class AreaGraphSettings(StepSettings):
    """Rooms of a grid map (paper, IV.D, Fig. 10)."""

    passage_ratio: float = Field(
        0.7,
        gt=0,
        le=1,
        description="Maximum width of an opening that parts two rooms, as a share of the narrower one's, "
        "where doors or the drive are known.",
    )
    opening_ratio: float = Field(
        0.5,
        gt=0,
        le=1,
        description="The same where neither is, in any map: what else parts rooms there is straight from wall to wall.",
    )
    furniture_max_m: float = Field(
        1.2, ge=0, description="Maximum length (m) of what stands free and is furniture (alpha removal); 0: none. IV.D."
    )
    block_max_m: float = Field(
        2.0,
        ge=0,
        description="The same of compact blocks, such as tables and cupboards, which are no walls by their shape; 0: none.",
    )
    room_min_m2: float = Field(
        1.0,
        ge=0,
        description="Minimum area (m²) of a room; smaller ones join the one that they open to, or are dropped.",
    )

    def without_alpha_removal(self) -> "AreaGraphSettings":
        """The same, but all furniture stays."""
        return self.model_copy(update={"furniture_max_m": 0.0, "block_max_m": 0.0})


@dataclass(frozen=True)
class Room:
    """One area of the Area Graph.

    name: unique in its map. polygon: in metres of the map frame; furniture that stands in the room is part of it.
    area_m2: what the polygon covers. doors: indices of the detected doors that lead into it, ascending.
    """

    name: str
    polygon: shapely.Polygon
    area_m2: float
    doors: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Passage:
    """Where two rooms meet.

    rooms: indices of the two, the lower first. line: (2, 2) x and y of its ends in metres of the map frame.
    door: index of the detected door that it is, None where the map alone told.
    """

    rooms: tuple[int, int]
    line: FloatArray
    door: int | None


@dataclass(frozen=True, eq=False)
class AreaGraph:
    """Rooms, the largest first, how they are joined, and the evidence.

    label: (rows, columns) int32, the room's index in each cell of the grid, -1 where there is none; row 0 is the lowest y.
    origin: (2,) x and y of the grid's lower left corner. cell_m: edge of a cell.
    door_rooms: of each detected door the rooms in front of its sill and behind it, -1 where none was mapped.
    furniture: (k, 2) centres of the cells that the alpha removal took away, in metres of the map frame.
    skeleton: (s, 2, 2) edges of the Voronoi graph, cut at the passages, in metres of the map frame.
    """

    rooms: tuple[Room, ...]
    passages: tuple[Passage, ...]
    label: IntArray
    origin: FloatArray
    cell_m: float
    door_rooms: tuple[tuple[int, int], ...]
    furniture: FloatArray
    skeleton: FloatArray

    def __len__(self) -> int:
        return len(self.rooms)

    def neighbours(self, room: int) -> list[str]:
        """The names of the rooms that passages join to this one, the largest first."""
        beside = {other for passage in self.passages if room in passage.rooms for other in passage.rooms} - {room}
        return [self.rooms[other].name for other in sorted(beside)]


def find_rooms(
    grid: GridMap,
    settings: AreaGraphSettings,
    doorways: FloatArray = NO_DOORWAYS,
    windows: FloatArray = NO_LINES,
    path_map: FloatArray | None = None,
    bounds: Sequence[Faces] = (),
) -> AreaGraph:
    """The Area Graph of a grid map.

    doorways: (D, 4, 2) corners of the detected doors' openings, the sill's two first, in metres of the map frame; free in
    the grid, they part rooms whatever their width, and belong to none. windows: (W, 2, 2), through which no room is
    reached. path_map: (n, 2 or more) the robot's places, for a map that was made on the way: rooms that no passage
    joins to them are dropped, the edge of what was seen is no jamb, and what something hid within a room is part of it.
    None for a map whose making is unknown. bounds: the faces of walls, doors and windows that
    outlines are laid on where they run along them.
    """
    view = _View.of(grid)
    free = view.cells == Cell.FREE
    closed = view.drawn(_across(doorways, grid.cell_m, _JAMB_M)) | view.drawn(windows)
    furniture = _furniture(~free | closed, grid.cell_m, settings)
    open_cells = (free | furniture) & ~closed
    walls = ~free if path_map is None else (view.cells == Cell.OCCUPIED) | closed
    distance, nearest = _to_nearest_obstacle(open_cells)
    # Where doors are known, no other opening that parts rooms is wider than they usually are, and 0.1 m.
    widest_m = float(np.median(lengths_m(doorways))) + 0.1 if len(doorways) else math.inf
    # On the way, most corners are those of furniture and of what it hid: nothing that a mouth ends at.
    with_mouths = path_map is None and not len(doorways)
    label = _areas(open_cells, distance, nearest, walls, grid.cell_m, widest_m, with_mouths, settings)
    count = int(label.max(initial=0)) + 1
    found = [_sides(label, view, doorway) for doorway in doorways]
    sides = np.array(found, np.int32).reshape(-1, 2)
    openings = _openings(label, view)
    if path_map is not None:
        label = _without_beams(label, _BEAM_M / grid.cell_m)
        label = _reached(label, sides, [pair for pair, _ in openings], view.at(path_map[:, :2]))
        label = _reaching_on(label, walls & ~furniture)
        label = _with_niches(label, closed, settings.block_max_m / grid.cell_m)
    reach_m = 0.0 if path_map is None else grid.cell_m / 2  # such a map's walls run along the middle of their cells
    removed = view.centres(furniture & ~free)
    skeleton = _voronoi(label, distance, nearest, view, _SKELETON_M)
    numbers = np.flatnonzero(np.bincount(label.ravel()))
    numbers = numbers[numbers > 0]
    outlines = _outlines(label, numbers, view, reach_m)
    outlines = lay_on_faces(outlines, bounds, grid.cell_m)
    index, outlines = _by_size(numbers, outlines, count)
    door_rooms = tuple((int(a), int(b)) for a, b in index[sides])
    return AreaGraph(
        rooms=_rooms(outlines, door_rooms),
        passages=_passages(index, door_rooms, openings, doorways),
        label=view.whole(index[label]),
        origin=grid.origin,
        cell_m=grid.cell_m,
        door_rooms=door_rooms,
        furniture=removed,
        skeleton=skeleton,
    )


def doorways_of(doors: Doors) -> FloatArray:
    """(D, 4, 2) the openings of doors through their walls, for `find_rooms`: the sill, then the far side."""
    behind = doors.ends - doors.normal[:, None] * doors.reveal_m[:, None, None]
    return np.concatenate([doors.ends, behind[:, ::-1]], axis=1)


def sides_of(doors: Doors) -> tuple[Faces, Faces]:
    """The faces of `doorways_of` that rooms end at: in front, and behind."""
    return doors, Sides(doorways_of(doors)[:, 2:], -doors.normal)


def coarsened(grid: GridMap, cells_max: int) -> GridMap:
    """The grid around its free cells, with cells so large that at most `cells_max` are left.

    A large cell is occupied if any of its cells is, and else free if any is: no wall opens, and no room is lost.
    """
    around = _around_free(grid)
    if around is None:
        return grid
    part = grid.cells[around]
    factor = int(np.ceil(np.sqrt(part.size / cells_max)))
    origin = grid.origin + grid.cell_m * np.array([around[1].start, around[0].start])
    if factor > 1:
        tiled = np.pad(part, [(0, -part.shape[0] % factor), (0, -part.shape[1] % factor)], constant_values=Cell.UNKNOWN)
        tiles = tiled.reshape(tiled.shape[0] // factor, factor, tiled.shape[1] // factor, factor)
        occupied = (tiles == Cell.OCCUPIED).any(axis=(1, 3))
        free = (tiles == Cell.FREE).any(axis=(1, 3))
        part = np.select([occupied, free], [Cell.OCCUPIED, Cell.FREE], Cell.UNKNOWN).astype(np.uint8)
    return GridMap(part, origin, grid.cell_m * factor)


def _around_free(grid: GridMap) -> tuple[slice, slice] | None:
    """The rows and columns around a grid's free cells; None where it has none."""
    free = grid.cells == Cell.FREE
    rows, columns = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if not len(rows):
        return None
    low, high = (max(int(axis[0]) - _MARGIN, 0) for axis in (rows, columns)), (rows[-1], columns[-1])
    row, column = (slice(a, int(b) + 1 + _MARGIN) for a, b in zip(low, high, strict=True))
    return row, column


@dataclass(frozen=True, eq=False)
class _View:
    """The part of a grid around its free cells, bordered by unknown ones; first: its row and column in the grid."""

    grid: GridMap
    cells: IntArray
    first: tuple[int, int]

    @staticmethod
    def of(grid: GridMap) -> "_View":
        around = _around_free(grid)
        if around is None:
            return _View(grid, np.full((1, 1), Cell.UNKNOWN, np.uint8), (0, 0))
        cells = np.pad(grid.cells[around], 1, constant_values=Cell.UNKNOWN)
        return _View(grid, cells, (around[0].start - 1, around[1].start - 1))

    @property
    def origin(self) -> FloatArray:
        """x and y of the view's lower left corner."""
        return np.asarray(self.grid.origin + self.grid.cell_m * np.array(self.first[::-1]))

    def at(self, points_map: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of points (n, 2); what lies outside is left out."""
        column, row = np.floor((points_map - self.origin) / self.grid.cell_m).astype(np.int64).T
        inside = (row >= 0) & (column >= 0) & (row < self.cells.shape[0]) & (column < self.cells.shape[1])
        return row[inside], column[inside]

    def drawn(self, lines: FloatArray) -> BoolArray:
        """Cells along lines (n, 2, 2), unbroken for four neighbours."""
        drawn = np.zeros(self.cells.shape, bool)
        for start, end in lines:
            steps = int(np.ceil(4 * np.linalg.norm(end - start) / self.grid.cell_m)) + 1
            drawn[self.at(np.linspace(start, end, steps))] = True
        return drawn

    def whole(self, index: IntArray) -> IntArray:
        """(rows, columns) int32 of the grid: an image of the view in its place; -1 around it."""
        whole = np.full(self.grid.cells.shape, -1, np.int32)
        row, column = self.first
        inner = index[1:-1, 1:-1]
        whole[row + 1 : row + 1 + inner.shape[0], column + 1 : column + 1 + inner.shape[1]] = inner
        return whole

    def centres(self, chosen: BoolArray) -> FloatArray:
        """(n, 2) x and y of the middles of cells."""
        row, column = np.nonzero(chosen)
        return self.origin + self.grid.cell_m * (np.column_stack([column, row]) + 0.5)


def _across(doorways: FloatArray, cell_m: float, jamb_m: float) -> FloatArray:
    """Lines (n, 2, 2) from jamb to jamb and a little into both, over the whole depth of each doorway."""
    lines: list[FloatArray] = [NO_LINES]
    for a, b, b_back, a_back in doorways:
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9) * jamb_m
        depth = np.linspace(0, 1, int(np.ceil(4 * np.linalg.norm(a_back - a) / cell_m)) + 1)[:, None]
        lines.append(np.stack([a - along + depth * (a_back - a), b + along + depth * (b_back - b)], axis=1))
    return np.concatenate(lines)


def _to_nearest_obstacle(free: BoolArray) -> tuple[FloatArray, IntArray]:
    """float32 distance of each cell to the nearest one that is not free, in cells, and (2, …) that one's row and column.

    SciPy's own distances are float64 with several copies, which take longer than the transform itself.
    """
    nearest: IntArray = ndimage.distance_transform_edt(free, return_distances=False, return_indices=True)
    squared = np.zeros(free.shape, np.float32)
    for axis, length in enumerate(free.shape):
        place = np.arange(length, dtype=np.int32)
        away = nearest[axis] - (place[:, None] if axis == 0 else place)
        squared += np.square(away, dtype=np.float32)
    return np.sqrt(squared, out=squared), nearest


def _furniture(obstacles: BoolArray, cell_m: float, settings: AreaGraphSettings) -> BoolArray:
    """Alpha removal: what stands free of the walls and is small, or a compact block (paper, IV.D)."""
    label, count = ndimage.label(obstacles, _EIGHT)
    removed = np.zeros(count + 1, bool)
    limit_m = max(settings.furniture_max_m, settings.block_max_m)
    for number, box in enumerate(ndimage.find_objects(label), 1):
        sides_m = [(s.stop - s.start) * cell_m for s in box]
        if max(sides_m) > limit_m:
            continue
        if math.hypot(*sides_m) <= settings.furniture_max_m:  # nothing in the box is longer
            removed[number] = True
            continue
        own = label[box] == number
        length_m = _length(own) * cell_m
        compact = np.count_nonzero(own) * cell_m**2 >= _BLOCK_FILL_MIN * length_m**2
        removed[number] = length_m <= settings.furniture_max_m or (compact and length_m <= settings.block_max_m)
    return np.asarray(removed[label])


def _length(cells: BoolArray) -> float:
    """Greatest distance of two corners of cells, in cells."""
    row = np.flatnonzero(cells.any(axis=1))
    # No corner between the outermost two of a row is one of the convex hull.
    left, right = cells[row].argmax(axis=1), cells.shape[1] - cells[row, ::-1].argmax(axis=1)
    corners = [np.column_stack([column, edge]) for column in (left, right) for edge in (row, row + 1)]
    hull = shapely.MultiPoint(np.concatenate(corners)).convex_hull
    return float(pdist(shapely.get_coordinates(hull)).max())


def _areas(
    free: BoolArray,
    distance: FloatArray,
    nearest: IntArray,
    walls: BoolArray,
    cell_m: float,
    widest_m: float,
    with_mouths: bool,
    settings: AreaGraphSettings,
) -> IntArray:
    """int32, the area of each cell, 0 where there is none: what passages part, and mouths where they are looked for.

    distance, nearest: as of `_basins`. walls: where openings can end. widest_m: maximum width of a passage.
    """
    lines, closed, ratio = NO_LINES, np.zeros(free.shape, bool), settings.passage_ratio
    if with_mouths:
        ratio = settings.opening_ratio
        lines, closed = find_mouths(free, walls, cell_m, ratio=ratio, ratio_in_line=_MOUTH_RATIO)
        distance, nearest = _to_nearest_obstacle(free & ~closed)
    cells_min = settings.room_min_m2 / cell_m**2
    basins = _basins(free & ~closed, distance, nearest, walls | closed, ratio, widest_m / cell_m, cells_min)
    label = join_open_areas(basins, lines, distance, enclosed=_ENCLOSED_RATIO, cells_min=cells_min)
    size = np.bincount(label.ravel())
    kept = np.flatnonzero(size >= cells_min)
    kept = kept[kept > 0]
    number = np.zeros(len(size), np.int32)
    number[kept] = np.arange(1, len(kept) + 1)
    label = number[label]
    if len(kept) and len(lines):
        beside = ndimage.distance_transform_edt(label == 0, return_distances=False, return_indices=True)
        label = np.where(closed & free, label[tuple(beside)], label)
    return np.asarray(label)


def _basins(
    free: BoolArray,
    distance: FloatArray,
    nearest: IntArray,
    walls: BoolArray,
    ratio: float,
    widest: float,
    cells_min: float,
) -> IntArray:
    """int32, the basin of the distance map of each cell, 0 where there is none, joined where no passage is.

    distance, nearest: of each free cell to the nearest obstacle, in cells, and that obstacle's row and column.
    ratio, widest: maximum width of a passage, as a share of the narrower basin's, and in cells.
    """
    summits, _ = ndimage.label(local_maxima(distance) & free, _EIGHT)  # type: ignore[no-untyped-call]
    basins = np.asarray(watershed(-distance, summits, mask=free), np.int32)  # type: ignore[no-untyped-call]
    size = np.bincount(basins.ravel())
    height = np.zeros(len(size), np.float32)
    height[summits[summits > 0]] = distance[summits > 0]

    # Joined from the widest opening down, as the tree of the distance map's level sets is built.
    parent = np.arange(len(size))

    def root(basin: int) -> int:
        while parent[basin] != basin:
            parent[basin] = parent[parent[basin]]
            basin = parent[basin]
        return basin

    for first, second, saddle in _saddles(basins, distance):
        a, b = sorted((root(first), root(second)), key=lambda basin: float(height[basin]))
        width = 2 * float(distance[saddle])
        wide = width >= widest or width >= ratio * 2 * height[a]
        if a != b and (wide or size[a] < cells_min or size[b] < cells_min or not _has_jambs(saddle, nearest, walls)):
            parent[a] = b
            size[b] += size[a]
    return np.array([root(basin) for basin in range(len(parent))], np.int32)[basins]


def _saddles(basins: IntArray, distance: FloatArray) -> list[tuple[int, int, tuple[int, int]]]:
    """Pairs of neighbouring basins and the cell where the opening between them is widest; the widest first."""
    columns = basins.shape[1]
    flat, height = basins.ravel(), distance.ravel()
    low, high, value, cell = [], [], [], []
    for step in (1, columns):
        here = np.flatnonzero((flat[:-step] != flat[step:]) & (flat[:-step] > 0) & (flat[step:] > 0))
        there = here + step
        low.append(np.minimum(flat[here], flat[there]))
        high.append(np.maximum(flat[here], flat[there]))
        value.append(np.minimum(height[here], height[there]))
        cell.append(np.where(height[here] < height[there], here, there))
    pairs = np.column_stack([np.concatenate(low), np.concatenate(high)])
    values, cells = np.concatenate(value), np.concatenate(cell)
    order = np.lexsort((cells, -values))
    _, widest = np.unique(pairs[order], axis=0, return_index=True)
    widest = order[np.sort(widest)]
    return [
        (int(a), int(b), (int(c) // columns, int(c) % columns))
        for (a, b), c in zip(pairs[widest], cells[widest], strict=True)
    ]


def _has_jambs(saddle: tuple[int, int], nearest: IntArray, walls: BoolArray) -> bool:
    """Whether walls stand on both sides of an opening, not the edge of what was seen."""
    site = nearest[:, saddle[0], saddle[1]]
    step = np.array(saddle) - site
    opposite = nearest[:, *np.clip(np.array(saddle) + step // 2, 0, np.array(walls.shape) - 1)]
    return _near_wall(site, walls) and _near_wall(opposite, walls)


def _near_wall(site: IntArray, walls: BoolArray) -> bool:
    row, column = site
    return bool(walls[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].any())


def _sides(label: IntArray, view: _View, doorway: FloatArray) -> tuple[int, int]:
    """The areas in front of a doorway's sill and behind it; 0 for none."""
    a, b, b_back, a_back = doorway
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    outwards = np.array([along[1], -along[0]])
    depth = a_back - a
    if depth @ outwards > 0:
        outwards = -outwards
    found = []
    for start, end, direction in ((a, b, outwards), (a_back, b_back, -outwards)):
        steps = np.arange(1.0, _BESIDE_DOOR_M / view.grid.cell_m) * view.grid.cell_m
        places = start + np.linspace(0.2, 0.8, 7)[:, None] * (end - start)
        areas = label[view.at((places[:, None] + steps[:, None] * direction).reshape(-1, 2))]
        found.append(int(np.bincount(areas[areas > 0]).argmax()) if (areas > 0).any() else 0)
    return found[0], found[1]


def _openings(label: IntArray, view: _View) -> list[tuple[tuple[int, int], FloatArray]]:
    """Where areas touch: the pair, the lower first, and the line (2, 2) between the opening's jambs."""
    pairs, edges = [], []
    for down, right in ((1, 0), (0, 1)):
        here, there = label[: label.shape[0] - down, : label.shape[1] - right], label[down:, right:]
        row, column = np.nonzero((here != there) & (here > 0) & (there > 0))
        pairs.append(np.sort(np.column_stack([here[row, column], there[row, column]]), axis=1))
        edges.append(_border(row, column, down))
    all_pairs, which = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    order = np.argsort(which, kind="stable")
    groups = np.split(np.concatenate(edges)[order], np.flatnonzero(np.diff(which[order])) + 1)
    openings = []
    for pair, own in zip(all_pairs, groups, strict=False):
        merged = shapely.line_merge(shapely.union_all(shapely.linestrings(own)))
        # Corners that touch are one opening.
        for part in shapely.get_parts(shapely.union_all(shapely.buffer(shapely.get_parts(merged), 0.9))):
            corners = shapely.get_coordinates(shapely.intersection(merged, part))
            between = squareform(pdist(corners))
            ends = corners[list(np.unravel_index(between.argmax(), between.shape))]
            openings.append(((int(pair[0]), int(pair[1])), view.origin + view.grid.cell_m * ends))
    return openings


def _reached(
    label: IntArray, sides: IntArray, openings: Sequence[tuple[int, int]], path: tuple[IntArray, IntArray]
) -> IntArray:
    """Only the areas that the robot entered, and what passages join to them."""
    areas = int(label.max(initial=0)) + 1
    pairs = np.array([pair for pair in [*sides.tolist(), *openings] if min(pair) > 0], np.int64).reshape(-1, 2)
    _, part = connected_components(csr_array((np.ones(len(pairs)), pairs.T), (areas, areas)), directed=False)
    return np.where(np.isin(part, part[label[path]])[label], label, 0)


def _without_beams(label: IntArray, radius: float) -> IntArray:
    """Areas without what no disc of this radius (cells) reaches: single rays that left through a gap."""
    core = ndimage.distance_transform_edt(label > 0) > radius
    near = ndimage.distance_transform_edt(~core) <= radius + 1
    return np.where(near, label, 0)


def _reaching_on(label: IntArray, walls: BoolArray) -> IntArray:
    """Areas with the cells that something hid: whichever way one looks from there, one sees the area or a wall.

    Three of the eight ways have to end in the area, so that the inside of walls and cupboards is none of it.
    """
    known = (label > 0) | walls
    ways = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0)]
    ends = np.stack([_met(np.where(known, label, -1), known, down, right) for down, right in ways])
    area = ends.max(axis=0)
    seen = ends == area
    inside = (seen | (ends == 0)).all(axis=0) & (seen.sum(axis=0) >= 3) & (area > 0) & ~known
    grown = label.copy()
    for number, box in enumerate(ndimage.find_objects(np.where(inside, area, label)), 1):
        if box is not None:
            own = label[box] == number
            reached = ndimage.binary_propagation(own, mask=own | (inside[box] & (area[box] == number)))
            grown[box][reached] = number
    return grown


def _met(value: IntArray, known: BoolArray, down: int, right: int) -> IntArray:
    """What the first known cell holds that one meets from each cell in a direction; -1 where there is none."""
    if down == 0:
        return _met(value.T, known.T, right, 0).T
    met = np.full_like(value, -1)
    before = np.full(value.shape[1], -1, value.dtype)
    for row in range(value.shape[0])[::-down]:
        if right:
            before = np.roll(before, -right)
            before[-1 if right > 0 else 0] = -1
        before = np.where(known[row], value[row], before)
        met[row] = before
    return met


def _with_niches(label: IntArray, closed: BoolArray, size: float) -> IntArray:
    """Areas with the blocks that stand at their walls: notches of the convex hull, at most `size` cells long.

    A notch that touches another area or a doorway is the wall between them; what two areas claim is neither's.
    """
    claims = np.zeros(label.shape, np.uint8)
    filled = label.copy()
    for area, box in enumerate(ndimage.find_objects(label), 1):
        if box is None:
            continue
        hull = convex_hull_image(label[box] == area)  # type: ignore[no-untyped-call]
        notches, count = ndimage.label(hull & (label[box] == 0) & ~closed[box], _EIGHT)
        foreign = closed[box] | ((label[box] > 0) & (label[box] != area))
        touching = np.zeros(count + 1, bool)
        touching[notches[ndimage.binary_dilation(foreign, _EIGHT)]] = True
        for notch, part in enumerate(ndimage.find_objects(notches), 1):
            own = notches[part] == notch
            if not touching[notch] and max(own.shape) <= size and _length(own) <= size:
                claims[box][part] += own
                filled[box][part][own] = area
    return np.where(claims > 1, 0, filled)


def _by_size(
    numbers: IntArray, outlines: Sequence[shapely.Polygon], count: int
) -> tuple[IntArray, list[shapely.Polygon]]:
    """The index (count,) of each label's room, -1 where none is left, and the outlines (k,) of labels (k,) by size."""
    # Rounded, so that rooms of equal size keep their order wherever the map lies.
    places = np.round([(-area.area, *area.centroid.coords[0]) for area in outlines], 6).reshape(-1, 3)
    order = np.lexsort(places.T[::-1])
    index = np.full(count, -1, np.int32)
    index[numbers[order]] = np.arange(len(order))
    return index, [outlines[i] for i in order]


def _rooms(outlines: Sequence[shapely.Polygon], door_rooms: Sequence[tuple[int, int]]) -> tuple[Room, ...]:
    """The rooms with their names and their doors."""
    doors = [tuple(door for door, pair in enumerate(door_rooms) if room in pair) for room in range(len(outlines))]
    return tuple(Room(f"room {i + 1}", area, float(area.area), doors[i]) for i, area in enumerate(outlines))


def _passages(
    index: IntArray,
    door_rooms: Sequence[tuple[int, int]],
    openings: Sequence[tuple[tuple[int, int], FloatArray]],
    doorways: FloatArray,
) -> tuple[Passage, ...]:
    """Doors between two rooms, and the openings between them that are none of these doors; index: see `_by_size`."""
    passages = [
        Passage((min(pair), max(pair)), doorways[door, :2], door)
        for door, pair in enumerate(door_rooms)
        if min(pair) >= 0 and pair[0] != pair[1]
    ]
    by_door = {passage.rooms: passage.line for passage in passages}
    for pair, line in openings:
        a, b = sorted(int(i) for i in index[list(pair)])
        if a >= 0 and not ((a, b) in by_door and _same_place(by_door[a, b], line)):
            passages.append(Passage((a, b), line, None))
    return tuple(passages)


def _same_place(line: FloatArray, other: FloatArray) -> bool:
    return bool(np.linalg.norm(line.mean(axis=0) - other.mean(axis=0)) < np.linalg.norm(line[1] - line[0]) / 2)


def _outlines(label: IntArray, numbers: IntArray, view: _View, reach_m: float) -> list[shapely.Polygon]:
    """The areas' outlines without the cells' steps; neighbours keep their common border.

    reach_m: how far they reach into what is no area.
    """
    boxes: list[list[shapely.Polygon]] = [[] for _ in range(len(numbers))]
    place = np.full(int(label.max(initial=0)) + 1, -1)
    place[numbers] = np.arange(len(numbers))
    change = np.diff(label, axis=1) != 0
    for row in np.flatnonzero(label.any(axis=1)):
        cuts = np.concatenate([[0], np.flatnonzero(change[row]) + 1, [label.shape[1]]])
        for start, stop in pairwise(cuts):
            if label[row, start] > 0:
                boxes[place[label[row, start]]].append((start, row, stop, row + 1))
    cellwise = [shapely.union_all(shapely.box(*np.array(own).T)) for own in boxes]
    if not cellwise:
        return []
    outlines = [largest(area) for area in shapely.coverage_simplify(cellwise, 1.0)]
    if reach_m > 0:
        reach = reach_m / view.grid.cell_m
        tree = shapely.STRtree(outlines)
        outlines = [
            largest(grown(area, reach).difference(
                shapely.union_all([outlines[j] for j in tree.query(area.buffer(reach)) if j != i])
            ))
            for i, area in enumerate(outlines)
        ]  # fmt: skip
    return [shapely.transform(area, lambda corners: view.origin + view.grid.cell_m * corners) for area in outlines]


def _voronoi(label: IntArray, distance: FloatArray, nearest: IntArray, view: _View, far_m: float) -> FloatArray:
    """(s, 2, 2) edges between cells whose nearest obstacles lie far apart, as seen from there, and far away."""
    far = (label > 0) & (distance * view.grid.cell_m > far_m)
    edges = []
    for down, right in ((1, 0), (0, 1)):
        low = np.s_[: label.shape[0] - down, : label.shape[1] - right]
        high = np.s_[down:, right:]
        apart = np.zeros(label[low].shape, np.float32)
        for site in nearest:
            apart += np.square(site[low] - site[high], dtype=np.float32)
        chosen = far[low] & (label[low] == label[high]) & (apart > np.square(distance[low]))
        row, column = np.nonzero(chosen)
        edges.append(_border(row, column, down))
    return np.asarray(view.origin + view.grid.cell_m * np.concatenate(edges))


def _border(row: IntArray, column: IntArray, down: int) -> IntArray:
    """(n, 2, 2) corners x, y of the edge between each cell and the next one, in its column or in its row."""
    corner = np.column_stack([column + (1 - down), row + down])
    return np.stack([corner, corner + np.array([down, 1 - down])], axis=1)
