"""Rooms, passages and topology of a grid map: the Area Graph (paper, IV.D, Fig. 10).

The Area Graph (Hou, Yuan and Schwertfeger 2019, the paper's [5]) cuts the Voronoi diagram at
openings that a disc of diameter w cannot pass. No w fits all maps: here an opening is narrow in
relation to the rooms beside it. Areas are watershed basins of the distance to the nearest
obstacle, and the saddle between two basins is the critical point of an opening (Thrun 1998). Two
basins are two rooms where the opening is markedly narrower than both: a narrow corridor stays one
room. Detected doors separate rooms in any case. In maps of unknown origin, straight mouths between
corners of walls do so as well (`mouths.py`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely
from pydantic import Field
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist, squareform
from skimage.morphology import local_maxima
from skimage.segmentation import watershed

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import Faces, lengths_m
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.model import Doors
from ffmap.algorithms.maps.grid import Cell, GridMap, window
from ffmap.algorithms.maps.mouths import find_mouths, join_open_areas, near_wall
from ffmap.algorithms.maps.room_outlines import Sides, outline_rooms

NO_DOORWAYS: FloatArray = np.zeros((0, 4, 2))
NO_LINES: FloatArray = np.zeros((0, 2, 2))
_EIGHT = np.ones((3, 3), bool)
_MARGIN = 11
"""Cells around the free ones that are examined."""
_PASSAGE_RATIO = 0.7
"""The opening ratio in maps with known doors or drive, where no straight mouths separate rooms."""
_BLOCK_FILL_MIN, _BLOCK_MAX_M = 0.25, 2.0
"""Compact free-standing blocks, such as tables and cupboards: minimum share of the square of its
length that it covers, maximum length (m)."""
_BEAM_M = 0.15
"""Half the width (m) of the narrowest room: narrower areas are rays that left through a gap."""
_JAMB_M = 0.1
"""Length (m) by which a closed doorway extends into both jambs, whose places are uncertain."""
_BESIDE_DOOR_M = 0.4
"""Maximum distance (m) of a room from the doorway that leads into it."""
_SKELETON_M = 0.25
"""Minimum distance (m) of the drawn Voronoi graph's edges from obstacles."""


class Segmented(StrEnum):
    """The maps that the paper compares (Fig. 10)."""

    FURNITURE_FREE = "furniture_free"
    NORMAL = "normal"  # a slice halfway up, with furniture that alpha removal partly removes
    NORMAL_AS_IS = "normal_without_alpha_removal"


class AreaGraphSettings(StepSettings):
    """Rooms of a grid map (paper, IV.D, Fig. 10)."""

    opening_ratio: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Maximum width of an opening that separates two rooms, as a share of the "
        "narrower room's width, in a map without known doors or drive.",
    )
    furniture_max_m: float = Field(
        1.2,
        ge=0,
        description="Maximum length (m) of free-standing furniture that alpha removal erases, 2 m "
        "if it is a compact block; 0 erases none. IV.D.",
    )
    room_min_m2: float = Field(
        1.0,
        ge=0,
        description="Minimum area (m²) of a room; smaller rooms join the room to which they open, "
        "or are dropped.",
    )


@dataclass(frozen=True)
class Room:
    """One area of the Area Graph.

    name: unique in its map. polygon: in metres of the map frame, with the furniture in the room.
    doors: indices of the detected doors that lead into it, ascending.
    """

    name: str
    polygon: shapely.Polygon
    area_m2: float
    doors: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Passage:
    """Where two rooms meet.

    rooms: indices of the two, the lower first. line: (2, 2) x and y of its ends in metres of the
    map frame. door: index of the detected door, None for an opening without one.
    """

    rooms: tuple[int, int]
    line: FloatArray
    door: int | None


@dataclass(frozen=True, eq=False)
class AreaGraph:
    """Rooms, the largest first, their passages, and the evidence.

    label: (rows, columns) int32 of the grid, the room's index in each cell, -1 without a room.
    origin: (2,) x and y of the grid's lower left corner. door_rooms: of each detected door the
    rooms in front of its sill and behind it, -1 where none was mapped. furniture: (k, 2) centres
    of the cells that the alpha removal removed. skeleton: (s, 2, 2) edges of the Voronoi graph,
    cut at the passages. All in metres of the map frame.
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
        """Names of the rooms that passages join to this room, the largest first."""
        beside = {r for passage in self.passages if room in passage.rooms for r in passage.rooms}
        return [self.rooms[other].name for other in sorted(beside - {room})]


def find_rooms(
    grid: GridMap,
    settings: AreaGraphSettings,
    doorways: FloatArray = NO_DOORWAYS,
    windows: FloatArray = NO_LINES,
    path_map: FloatArray | None = None,
    bounds: Sequence[Faces] = (),
    passages: FloatArray = NO_DOORWAYS,
) -> AreaGraph:
    """Compute the Area Graph of a grid map.

    doorways: (D, 4, 2) corners of the detected doors' openings, the sill's two first; they are
    free in the grid, separate rooms whatever their width, and belong to no room. windows: (W, 2,
    2), through which no room is reached. path_map: (n, 2 or more) the robot's places, for a map
    that was made on the way: rooms that no passage joins to them are dropped, and the edge of the
    mapped space is no jamb; None for a map of unknown origin. bounds: faces of walls, doors and
    windows on which outlines are laid. passages: (P, 4, 2) of openings without a leaf, which
    separate rooms as doorways do. All in metres of the map frame.
    """
    # Watersheds and distances need a border.
    cells = np.pad(grid.cells, 1, constant_values=Cell.UNKNOWN)
    rows, columns = window(cells == Cell.FREE, _MARGIN)
    part = GridMap(cells, grid.origin - grid.cell_m, grid.cell_m).cropped(rows, columns)
    free = part.cells == Cell.FREE
    ways = np.concatenate([doorways, passages])
    closed = _closed(part, ways, windows)
    furniture = _furniture(~free | closed, grid.cell_m, settings.furniture_max_m)
    open_cells = (free | furniture) & ~closed
    walls = ~free if path_map is None else (part.cells == Cell.OCCUPIED) | closed
    distance, nearest = _to_nearest_obstacle(open_cells)
    # Detected doors show how wide openings are: others that separate rooms are hardly wider.
    widest_m = float(np.median(lengths_m(doorways))) + 0.1 if len(doorways) else math.inf
    # On the way, most corners are corners of furniture or of hidden space: no mouth ends there.
    with_mouths = path_map is None and not len(doorways)
    label = _areas(
        open_cells, distance, nearest, walls, grid.cell_m, widest_m, with_mouths, settings
    )
    count = int(label.max(initial=0)) + 1
    found = [_sides(label, part, way) for way in ways]
    sides = np.array(found, np.int32).reshape(-1, 2)
    openings = _openings(label, part)
    if path_map is not None:
        label = _without_beams(label, _BEAM_M / grid.cell_m)
        label = _reached(label, sides, [pair for pair, _ in openings], part.at(path_map[:, :2]))
    numbers = np.flatnonzero(np.bincount(label.ravel(), minlength=1)[1:]) + 1
    # The walls of a map that was made on the way run along the middle of their cells.
    grow_m = 0.0 if path_map is None else grid.cell_m / 2
    outlines = outline_rooms(label, numbers, part, bounds, grow_m)
    index, outlines = _by_size(numbers, outlines, count)
    whole = np.full(cells.shape, -1, np.int32)
    whole[rows, columns] = index[label]
    way_rooms = tuple((int(a), int(b)) for a, b in index[sides])
    door_rooms = way_rooms[: len(doorways)]
    return AreaGraph(
        rooms=_rooms(outlines, door_rooms),
        passages=_passages(index, way_rooms, openings, ways, len(doorways)),
        label=whole[1:-1, 1:-1],
        origin=grid.origin,
        cell_m=grid.cell_m,
        door_rooms=door_rooms,
        furniture=part.middles(furniture & ~free),
        skeleton=_voronoi(label, distance, nearest, part),
    )


def doorways_of(doors: Doors) -> FloatArray:
    """(D, 4, 2) openings of doors through their walls, for `find_rooms`: sill, then far side."""
    behind = doors.ends - doors.normal[:, None] * doors.reveal_m[:, None, None]
    return np.concatenate([doors.ends, behind[:, ::-1]], axis=1)


def sides_of(doors: Doors) -> tuple[Faces, Faces]:
    """The faces of `doorways_of` that bound rooms: in front, and behind."""
    return doors, Sides(doorways_of(doors)[:, 2:], -doors.normal)


def _closed(part: GridMap, doorways: FloatArray, windows: FloatArray) -> BoolArray:
    """Cells of windows, and of doorways through their whole depth and a little into both jambs."""
    closed = np.zeros(part.cells.shape, bool)
    lines = list(windows)
    for a, b, b_back, a_back in doorways:
        jamb = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9) * _JAMB_M
        steps = int(np.ceil(2 * np.linalg.norm(a_back - a) / part.cell_m)) + 1
        depth = np.linspace(0, 1, steps)[:, None]
        front = np.stack([a - jamb + depth * (a_back - a), b + jamb + depth * (b_back - b)], axis=1)
        lines.extend(front)
    for line in lines:
        closed[part.on_line(line)] = True
    return closed


def _to_nearest_obstacle(free: BoolArray) -> tuple[FloatArray, IntArray]:
    """float32 distance (cells) of each cell to the nearest obstacle, and (2, …) that cell."""
    distance, nearest = ndimage.distance_transform_edt(free, return_indices=True)
    return distance.astype(np.float32), nearest


def _furniture(obstacles: BoolArray, cell_m: float, furniture_max_m: float) -> BoolArray:
    """Alpha removal: small free-standing things, and compact blocks (paper, IV.D)."""
    if not furniture_max_m:
        return np.zeros(obstacles.shape, bool)
    label, count = ndimage.label(obstacles, _EIGHT)
    removed = np.zeros(count + 1, bool)
    limit_m = max(furniture_max_m, _BLOCK_MAX_M)
    for number, box in enumerate(ndimage.find_objects(label), 1):
        if max(s.stop - s.start for s in box) * cell_m > limit_m:
            continue
        own = label[box] == number
        length_m = _length(own) * cell_m
        compact = np.count_nonzero(own) * cell_m**2 >= _BLOCK_FILL_MIN * length_m**2
        removed[number] = length_m <= (limit_m if compact else furniture_max_m)
    return np.asarray(removed[label])


def _length(cells: BoolArray) -> float:
    """Greatest distance of two corners of cells, in cells."""
    row, column = np.nonzero(cells)
    corners = [np.column_stack([column + x, row + y]) for x in (0, 1) for y in (0, 1)]
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
    """int32 area of each cell, 0 for none, as passages separate them, and mouths if wanted.

    distance, nearest: see `_basins`. walls: where openings can end. widest_m: maximum width of a
    passage.
    """
    lines, closed, ratio = NO_LINES, np.zeros(free.shape, bool), _PASSAGE_RATIO
    if with_mouths:
        ratio = settings.opening_ratio
        lines, closed = find_mouths(free, walls, cell_m, ratio)
        distance, nearest = _to_nearest_obstacle(free & ~closed)
    cells_min = settings.room_min_m2 / cell_m**2
    basins = _basins(
        free & ~closed, distance, nearest, walls | closed, ratio, widest_m / cell_m, cells_min
    )
    label = join_open_areas(basins, lines, distance, cells_min)
    kept = np.bincount(label.ravel()) >= cells_min
    kept[0] = False
    label = np.where(kept, np.cumsum(kept), 0).astype(np.int32)[label]
    if kept.any() and len(lines):
        beside = ndimage.distance_transform_edt(
            label == 0, return_distances=False, return_indices=True
        )
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
    """int32 basin of the distance map of each cell, 0 for none, joined where no passage is.

    distance, nearest: of each free cell to the nearest obstacle, in cells, and that obstacle's row
    and column. ratio, widest: maximum width of a passage, as a share of the narrower basin's, and
    in cells.
    """
    maxima = local_maxima(distance)  # type: ignore[no-untyped-call]
    summits, _ = ndimage.label(maxima & free, _EIGHT)
    flooded = watershed(-distance, summits, mask=free)  # type: ignore[no-untyped-call]
    basins = np.asarray(flooded, np.int32)
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
        small = size[a] < cells_min or size[b] < cells_min
        if a != b and (wide or small or not _has_jambs(saddle, nearest, walls)):
            parent[a] = b
            size[b] += size[a]
    return np.array([root(basin) for basin in range(len(parent))], np.int32)[basins]


def _saddles(basins: IntArray, distance: FloatArray) -> list[tuple[int, int, tuple[int, int]]]:
    """Pairs of neighbouring basins and the widest cell between them, the widest first."""
    flat, height = basins.ravel(), distance.ravel()
    pairs, cells = [], []
    for step in (1, basins.shape[1]):
        meet = (flat[:-step] != flat[step:]) & (flat[:-step] > 0) & (flat[step:] > 0)
        here = np.flatnonzero(meet)
        there = here + step
        pairs.append(np.sort(np.column_stack([flat[here], flat[there]]), axis=1))
        cells.append(np.where(height[here] < height[there], here, there))
    pair, cell = np.concatenate(pairs), np.concatenate(cells)
    order = np.lexsort((cell, -height[cell]))
    _, widest = np.unique(pair[order], axis=0, return_index=True)
    widest = order[np.sort(widest)]
    row, column = np.unravel_index(cell[widest], basins.shape)
    places = zip(row.tolist(), column.tolist(), strict=True)
    return [(a, b, at) for (a, b), at in zip(pair[widest].tolist(), places, strict=True)]


def _has_jambs(saddle: tuple[int, int], nearest: IntArray, walls: BoolArray) -> bool:
    """Whether walls are on both sides of an opening, and not the edge of the mapped space."""
    site = nearest[:, *saddle]
    opposite = np.array(saddle) + (np.array(saddle) - site) // 2
    other_site = nearest[:, *np.clip(opposite, 0, np.array(walls.shape) - 1)]
    return near_wall(walls, *site) and near_wall(walls, *other_site)


def _sides(label: IntArray, part: GridMap, doorway: FloatArray) -> tuple[int, int]:
    """The areas in front of a doorway's sill and behind it; 0 for none."""
    a, b, b_back, a_back = doorway
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    outwards = np.array([along[1], -along[0]])
    if (a_back - a) @ outwards > 0:
        outwards = -outwards
    steps = np.arange(1.0, _BESIDE_DOOR_M / part.cell_m)[:, None] * part.cell_m
    found = []
    for start, end, direction in ((a, b, outwards), (a_back, b_back, -outwards)):
        places = start + np.linspace(0.2, 0.8, 7)[:, None] * (end - start)
        areas = label[part.at((places[:, None] + steps * direction).reshape(-1, 2))]
        found.append(int(np.bincount(areas[areas > 0]).argmax()) if (areas > 0).any() else 0)
    return found[0], found[1]


def _openings(label: IntArray, part: GridMap) -> list[tuple[tuple[int, int], FloatArray]]:
    """Where areas touch: the pair, the lower first, and the line (2, 2) from jamb to jamb."""
    pairs, edges = [], []
    for down, right in ((1, 0), (0, 1)):
        here = label[: label.shape[0] - down, : label.shape[1] - right]
        there = label[down:, right:]
        row, column = np.nonzero((here != there) & (here > 0) & (there > 0))
        pairs.append(np.sort(np.column_stack([here[row, column], there[row, column]]), axis=1))
        edges.append(_border(row, column, down))
    all_pairs, which = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    border = np.concatenate(edges)
    openings = []
    for number, pair in enumerate(all_pairs):
        merged = shapely.line_merge(shapely.union_all(shapely.linestrings(border[which == number])))
        # Lines whose ends touch at corners are one opening.
        for near in shapely.get_parts(shapely.union_all(merged.buffer(0.9))):
            corners = shapely.get_coordinates(shapely.intersection(merged, near))
            between = squareform(pdist(corners))
            ends = corners[list(np.unravel_index(between.argmax(), between.shape))]
            openings.append(((int(pair[0]), int(pair[1])), part.origin + part.cell_m * ends))
    return openings


def _border(row: IntArray, column: IntArray, down: int) -> IntArray:
    """(n, 2, 2) corners x, y of the edge between each cell and the next in its column, or row."""
    corner = np.column_stack([column + (1 - down), row + down])
    return np.stack([corner, corner + np.array([down, 1 - down])], axis=1)


def _reached(
    label: IntArray,
    sides: IntArray,
    openings: Sequence[tuple[int, int]],
    path: tuple[IntArray, IntArray],
) -> IntArray:
    """Keep the areas that the robot entered, and those that passages join to them."""
    count = int(label.max(initial=0)) + 1
    pairs = np.array([pair for pair in [*sides.tolist(), *openings] if min(pair) > 0], np.int64)
    pairs = pairs.reshape(-1, 2)
    graph = csr_array((np.ones(len(pairs)), pairs.T), (count, count))
    _, group = connected_components(graph, directed=False)
    return np.where(np.isin(group, group[label[path]])[label], label, 0)


def _without_beams(label: IntArray, radius: float) -> IntArray:
    """Remove what no disc of this radius (cells) reaches: single rays that left through a gap."""
    core = ndimage.distance_transform_edt(label > 0) > radius
    near = ndimage.distance_transform_edt(~core) <= radius + 1
    return np.where(near, label, 0)


def _by_size(
    numbers: IntArray, outlines: Sequence[shapely.Polygon], count: int
) -> tuple[IntArray, list[shapely.Polygon]]:
    """The index (count,) by size of each label, -1 without a room, and the outlines by size."""
    # Rounded, so that rooms of equal size keep their order wherever the map is.
    places = np.round([(-area.area, *area.centroid.coords[0]) for area in outlines], 6)
    order = np.lexsort(places.reshape(-1, 3).T[::-1])
    index = np.full(count, -1, np.int32)
    index[numbers[order]] = np.arange(len(order))
    return index, [outlines[i] for i in order]


def _rooms(
    outlines: Sequence[shapely.Polygon], door_rooms: Sequence[tuple[int, int]]
) -> tuple[Room, ...]:
    rooms = []
    for number, outline in enumerate(outlines):
        doors = tuple(door for door, pair in enumerate(door_rooms) if number in pair)
        rooms.append(Room(f"room {number + 1}", outline, float(outline.area), doors))
    return tuple(rooms)


def _passages(
    index: IntArray,
    way_rooms: Sequence[tuple[int, int]],
    openings: Sequence[tuple[tuple[int, int], FloatArray]],
    ways: FloatArray,
    doors: int,
) -> tuple[Passage, ...]:
    """Doors and passages between two rooms, and the openings that are none of these.

    index: see `_by_size`. doors: how many of the ways are doors.
    """
    passages = [
        Passage((min(pair), max(pair)), ways[k, :2], k if k < doors else None)
        for k, pair in enumerate(way_rooms)
        if min(pair) >= 0 and pair[0] != pair[1]
    ]
    by_door = {passage.rooms: passage.line for passage in passages}
    for pair, line in openings:
        a, b = sorted(int(i) for i in index[list(pair)])
        door = by_door.get((a, b))
        if a >= 0 and (door is None or not _same_place(door, line)):
            passages.append(Passage((a, b), line, None))
    return tuple(passages)


def _same_place(line: FloatArray, other: FloatArray) -> bool:
    apart_m = np.linalg.norm(line.mean(axis=0) - other.mean(axis=0))
    return bool(apart_m < np.linalg.norm(line[1] - line[0]) / 2)


def _voronoi(label: IntArray, distance: FloatArray, nearest: IntArray, part: GridMap) -> FloatArray:
    """(s, 2, 2) edges between cells whose nearest obstacles are far apart and far away."""
    far = (label > 0) & (distance * part.cell_m > _SKELETON_M)
    edges = []
    for down, right in ((1, 0), (0, 1)):
        low = np.s_[: label.shape[0] - down, : label.shape[1] - right]
        high = np.s_[down:, right:]
        apart = sum(np.square(site[low] - site[high], dtype=np.float32) for site in nearest)
        chosen = far[low] & (label[low] == label[high]) & (apart > np.square(distance[low]))
        row, column = np.nonzero(chosen)
        edges.append(_border(row, column, down))
    return np.asarray(part.origin + part.cell_m * np.concatenate(edges))
