"""Mouths of rooms: straight lines from a corner of a wall to another wall that may end a room.

A room that is no deeper than its opening is wide has no bottleneck of the distance map there. But
its walls end at salient corners, and mostly one of the walls is in line with the opening
(compare the approximately convex parts of Liu, Liu and Latecki 2010). The width of an opening is
compared with the free space parallel to it on either side. Bays and corridors that meet are as
wide as their openings; they are no rooms.

Lines are (2, 2) column and row of their ends, in cells.
"""

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m

_IN_LINE_RATIO = 0.85
"""Maximum width of a mouth in line with a wall, as a share of the space on either side."""
_ENCLOSED_RATIO = 1.5
"""Maximum width of all mouths of a room, as a share of its own width."""
_REACH_M = 8.0
"""Maximum width (m) of a mouth."""
_CORNER_M = 0.12
"""Minimum distance (m) by which a corner protrudes from a wall."""
_TURN_MIN = np.radians(30.0)
"""Minimum angle by which a wall turns at a corner."""
_IN_LINE = -np.cos(np.radians(10.0))
"""Maximum cosine of the angle between a mouth and the wall in line with it."""
_LINE_SHARE = 0.25
"""Minimum length of a wall in line with a mouth, as a share of the mouth's width."""
_FACES_M = 0.5
"""Maximum distance (m) of the ends of a mouth on both faces of its wall."""
_DEPTH_SHARE = 0.5
"""Depth of the space on either side that is compared, as a share of the mouth's width."""
_DEPTH_M = (0.2, 0.6)
"""Where that space begins, and its minimum depth (m)."""


def find_mouths(
    free: BoolArray, walls: BoolArray, cell_m: float, ratio: float
) -> tuple[FloatArray, BoolArray]:
    """Find mouths (n, 2, 2), and the cells (rows, columns) that they close.

    The cells are unbroken for four neighbours, and extend through the wall where both of its faces
    have corners.

    free: cells where rooms can be. walls: where openings can end. ratio: maximum width of an
    opening without a wall in line, as a share of the space on either side.
    """
    left, closed = free.copy(), np.zeros(free.shape, bool)
    found: list[FloatArray] = []
    # Each mouth is a wall for those after it.
    for line, in_line in _candidates(free, cell_m):
        start, end = line
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        inset = min(2.5, length / 4) * along  # the walls' own cells at its ends
        if not _at(left, np.linspace(start + inset, end - inset, int(2 * length) + 2)).all():
            continue
        face = _other_face(line, found, _FACES_M / cell_m)
        if face is not None:
            depth = np.linspace(0, 1, int(4 * _FACES_M / cell_m))[:, None, None]
            between: FloatArray = line + depth * (face - line)
        elif all(near_wall(walls, row, column) for column, row in _cells(line)) and (
            length <= (_IN_LINE_RATIO if in_line else ratio) * _space_beside(line, left, cell_m)
        ):
            found.append(line)
            between = line[None]
        else:
            continue
        share = np.linspace(0, 1, int(4 * length) + 8)[:, None]
        for first, last in between:
            column, row = _cells(first - along + share * (last - first + 2 * along)).T
            for rows, columns in ((row, column), (row[:-1], column[1:])):
                left[rows, columns], closed[rows, columns] = False, True
    return np.array(found).reshape(-1, 2, 2), closed


def join_open_areas(
    label: IntArray, mouths: FloatArray, distance: FloatArray, cells_min: float
) -> IntArray:
    """Join areas (rows, columns), 0 for none, across mouths where one of two is small or open.

    distance: of each cell to the nearest obstacle or mouth, in cells. cells_min: minimum size.
    """
    size = np.bincount(label.ravel()).astype(np.float64)
    width = np.zeros(len(size), np.float32)
    np.maximum.at(width, label.ravel(), 2 * distance.ravel())
    length = lengths_m(mouths)
    sides = np.array([_sides(line, label) for line in mouths], np.int64).reshape(-1, 2)
    number = np.arange(len(size), dtype=np.int32)
    while True:
        first, second = sides.T
        apart = (first != second) & (first > 0) & (second > 0)
        total = np.bincount(sides[apart].ravel(), np.repeat(length[apart], 2), len(size))
        openness = total / np.maximum(width, 1e-9)
        smaller = np.where(size[first] < size[second], first, second)
        joined = apart & ((openness[smaller] > _ENCLOSED_RATIO) | (size[smaller] < cells_min))
        if not joined.any():
            return np.asarray(number[label])
        # The most open two first: the pieces of a corridor before the rooms beside it.
        kept, gone = sides[
            np.where(joined, np.minimum(openness[first], openness[second]), -1).argmax()
        ]
        number[number == gone] = kept
        sides[sides == gone] = kept
        size[kept] += size[gone]
        width[kept] = max(width[kept], width[gone])


def near_wall(walls: BoolArray, row: int, column: int) -> bool:
    """Whether a cell or one beside it is a wall."""
    return bool(walls[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].any())


def _candidates(free: BoolArray, cell_m: float) -> list[tuple[FloatArray, bool]]:
    """Lines over free cells, and whether a wall is in line: those first, then the shortest."""
    corner, before, after, edges = _corners(free, _CORNER_M / cell_m)
    if not len(corner):
        return []
    reach = _REACH_M / cell_m
    one, other = cKDTree(corner).query_pairs(reach, output_type="ndarray").T
    facing = np.stack([corner[one], corner[other]], axis=1)
    in_line = _is_in_line(before[one], after[one], facing)
    in_line |= _is_in_line(before[other], after[other], facing[:, ::-1])
    across = _straight_across(corner, edges, reach)
    lines = np.concatenate([facing, across])
    in_line = np.concatenate([in_line, np.zeros(len(across), bool)])
    length = lengths_m(lines)
    share = np.linspace(0.1, 0.9, 17)[:, None]
    between = lines[:, :1] + share * (lines[:, 1:] - lines[:, :1])
    chosen = np.flatnonzero((length > 3) & _at(free, between).all(axis=1))
    chosen = chosen[np.lexsort((length[chosen], ~in_line[chosen]))]
    return list(zip(lines[chosen], in_line[chosen].tolist(), strict=True))


def _corners(
    free: BoolArray, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Corners (n, 2) that protrude into the free cells, the ways (n, 2) to the outline's corners
    before and after each, and the edges (e, 2, 2) of all outlines."""
    corners: list[FloatArray] = [np.zeros((0, 3, 2))]
    # Bordered, so that every outline is closed, with free cells on the same side.
    rings = find_contours(np.pad(free, 1).astype(np.float32), 0.5)  # type: ignore[no-untyped-call]
    for ring in rings:
        chain = shapely.linestrings(ring - 1).simplify(tolerance, preserve_topology=False)
        outline = shapely.get_coordinates(chain)[:-1, ::-1]
        if len(outline) >= 3:
            ways = [np.roll(outline, shift, axis=0) - outline for shift in (1, -1)]
            corners.append(np.stack([outline, *ways], axis=1))
    corner, before, after = np.concatenate(corners).transpose(1, 0, 2)
    cross = after[:, 0] * before[:, 1] - after[:, 1] * before[:, 0]
    out = np.arctan2(cross, -(before * after).sum(axis=1)) < -_TURN_MIN
    return corner[out], before[out], after[out], np.stack([corner, corner + after], axis=1)


def _is_in_line(before: FloatArray, after: FloatArray, lines: FloatArray) -> BoolArray:
    """Whether a wall before or after the corner at each line's start continues the line."""
    length = np.maximum(lengths_m(lines), 1e-9)
    along = (lines[:, 1] - lines[:, 0]) / length[:, None]
    found = np.zeros(len(lines), bool)
    for wall in (before, after):
        own = np.linalg.norm(wall, axis=1)
        found |= ((wall * along).sum(axis=1) < _IN_LINE * own) & (own >= _LINE_SHARE * length)
    return found


def _straight_across(corner: FloatArray, edges: FloatArray, reach: float) -> FloatArray:
    """Lines (n, 2, 2) from corners (c, 2) at a right angle to edges (e, 2, 2)."""
    start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    squared = np.maximum((along**2).sum(axis=1), 1e-9)
    lines: list[FloatArray] = []
    for place in corner:
        share = ((place - start) * along).sum(axis=1) / squared
        foot = start + share[:, None] * along
        near = (share > 0) & (share < 1) & (np.linalg.norm(foot - place, axis=1) < reach)
        lines.append(np.stack([np.broadcast_to(place, foot[near].shape), foot[near]], axis=1))
    return np.concatenate(lines)


def _other_face(line: FloatArray, others: list[FloatArray], near: float) -> FloatArray | None:
    """The line whose two ends are near the ends of this line, in the same direction."""
    if not others:
        return None
    both = np.stack([others, np.array(others)[:, ::-1]])
    away = np.linalg.norm(both - line, axis=-1).max(axis=-1)
    nearest = np.unravel_index(away.argmin(), away.shape)
    return np.asarray(both[nearest]) if away[nearest] < near else None


def _space_beside(line: FloatArray, free: BoolArray, cell_m: float) -> float:
    """Greatest free length (cells) parallel to a line, on the narrower side of it."""
    length = float(np.linalg.norm(line[1] - line[0]))
    along = (line[1] - line[0]) / length
    deepest = max(_DEPTH_M[1] / cell_m, _DEPTH_SHARE * length)
    depth = np.arange(_DEPTH_M[0] / cell_m, deepest + 1, 2.0)
    away = np.arange(0.0, 2.5 * length + 10)  # more does not matter
    widest = []
    for across in (np.array([-along[1], along[0]]), np.array([along[1], -along[0]])):
        steps = np.arange(1.5, depth[-1] + 1)[:, None]
        straight = _at(free, line.mean(axis=0) + steps * across)
        clear = len(straight) if straight.all() else int(straight.argmin())
        base = line.mean(axis=0) + depth[depth <= 1.5 + clear][:, None] * across
        ways = np.stack([_at(free, base[:, None] + way * away[:, None] * along) for way in (1, -1)])
        lengths = np.where(ways.all(axis=2), len(away), ways.argmin(axis=2)).sum(axis=0)
        widest.append(float(lengths.max(initial=0)))
    return min(widest)


def _at(image: NDArray[Any], places: FloatArray) -> NDArray[Any]:
    """The image (rows, columns) at places (..., 2); places outside are as its border."""
    last = np.array(image.shape[::-1]) - 1
    column, row = np.moveaxis(np.clip(_cells(places), 0, last), -1, 0)
    return np.asarray(image[row, column])


def _cells(places: FloatArray) -> IntArray:
    """The cells of places; corners are on borders, where rounding to even skips cells."""
    return np.asarray(np.floor(places + 0.5).astype(np.int64))


def _sides(line: FloatArray, label: IntArray) -> tuple[int, int]:
    """The areas on both sides of a line; 0 for none."""
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    across = np.array([-along[1], along[0]])
    places = line[0] + np.linspace(0.15, 0.85, 9)[:, None] * (line[1] - line[0])
    found = []
    for way in (across, -across):
        beside = _at(label, places[:, None] + np.array([2.0, 3.0])[:, None] * way)
        found.append(int(np.bincount(beside[beside > 0]).argmax()) if beside.any() else 0)
    return found[0], found[1]
