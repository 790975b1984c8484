"""Mouths of rooms: straight lines from a corner of a wall to another, or straight across to a wall, that may end a room.

A room no deeper than its opening is wide has no bottleneck of the distance map there, but its walls end at corners that stand
out, and mostly one of them would go on along the opening (compare the approximately convex parts of Liu, Liu and Latecki
2010). How narrow an opening is, is measured along its own line: beside the way one could go parallel to it on either side.
Bays, and corridors that meet, are as wide as their openings; they are no rooms.
"""

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skimage.measure import find_contours

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

_REACH_M = 8.0  # no wider opening is looked for
_CORNER_M = 0.12  # what stands out of a wall by less is no corner
_TURN_MIN = np.radians(30.0)  # nor is what turns by less
_IN_LINE = -np.cos(np.radians(10.0))  # a wall goes on along an opening, but for this
_LINE_SHARE = 0.25  # such a wall's minimum length as a share of the opening's: a wall's end is shorter
_FACES_M = 0.5  # maximum distance of the ends of an opening on both faces of its wall
_DEPTH_SHARE = 0.5  # how far to either side one looks for more room, as a share of the opening
_DEPTH_M = (0.2, 0.6)  # from where, and at least as far


def find_mouths(
    free: BoolArray, walls: BoolArray, cell_m: float, *, ratio: float, ratio_in_line: float
) -> tuple[FloatArray, BoolArray]:
    """Lines (n, 2, 2), column and row of their ends, and (rows, columns) the cells that they close.

    These are unbroken for four neighbours, and reach through the wall where both of its faces have corners.
    free: cells where rooms can be. walls: where openings can end. ratio, ratio_in_line: maximum width of an opening as a share
    of what lies on either side, measured along it; the second where a wall is in line with it.
    """
    left, closed = free.copy(), np.zeros(free.shape, bool)
    narrow: list[FloatArray] = []
    # Each line that is found is a wall for those after it.
    for line, in_line in _candidates(free, cell_m):
        start, end = line
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        inset = min(2.5, length / 4) * along  # the walls' own cells at its ends
        if not _at(left, np.linspace(start + inset, end - inset, int(2 * length) + 2)).all():
            continue
        face = _other_face(line, narrow, _FACES_M / cell_m)
        if face is not None:
            depth = np.linspace(0, 1, int(4 * _FACES_M / cell_m))[:, None, None]
            between: FloatArray = line + depth * (face - line)
        elif all(near_wall(walls, row, column) for column, row in _cells(line)) and (
            length <= (ratio_in_line if in_line else ratio) * _beside(line, left, cell_m)
        ):
            narrow.append(line)
            between = line[None]
        else:
            continue
        share = np.linspace(0, 1, int(4 * length) + 8)[:, None]
        for first, last in between:
            column, row = _cells(first - along + share * (last - first + 2 * along)).T
            for rows, columns in ((row, column), (row[:-1], column[1:])):
                left[rows, columns], closed[rows, columns] = False, True
    return np.array(narrow).reshape(-1, 2, 2), closed


def join_open_areas(
    label: IntArray, lines: FloatArray, distance: FloatArray, *, enclosed: float, cells_min: float
) -> IntArray:
    """The areas (rows, columns) that lines part, 0 where there is none, joined where one of two is small or open.

    distance: of each cell to the nearest obstacle or line, in cells. enclosed: maximum width of all lines of the smaller of two
    areas, as a share of its own. cells_min: minimum size of an area.
    """
    area = np.bincount(label.ravel()).astype(np.float64)
    width = np.zeros(len(area), np.float32)
    np.maximum.at(width, label.ravel(), 2 * distance.ravel())
    length = _lengths(lines)
    sides = np.array([_sides(line, label) for line in lines], np.int64).reshape(-1, 2)
    number = np.arange(len(area), dtype=np.int32)
    while True:
        first, second = sides.T
        apart = (first != second) & (first > 0) & (second > 0)
        openings = np.bincount(sides[apart].ravel(), np.repeat(length[apart], 2), len(area)) / np.maximum(width, 1e-9)
        smaller = np.where(area[first] < area[second], first, second)
        joined = apart & ((openings[smaller] > enclosed) | (area[smaller] < cells_min))
        if not joined.any():
            return np.asarray(number[label])
        # The two that are most open first: the pieces of a corridor before the rooms beside it.
        most = np.where(joined, np.minimum(openings[first], openings[second]), -1).argmax()
        kept, gone = sides[most]
        number[number == gone] = kept
        sides[sides == gone] = kept
        area[kept] += area[gone]
        width[kept] = max(width[kept], width[gone])


def _lengths(lines: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1))


def _candidates(free: BoolArray, cell_m: float) -> list[tuple[FloatArray, bool]]:
    """Lines (2, 2) over free cells, column and row, and whether a wall goes on along them: those first, then the shortest."""
    corner, before, after, edges = _corners(free, _CORNER_M / cell_m)
    if not len(corner):
        return []
    one, other = cKDTree(corner).query_pairs(_REACH_M / cell_m, output_type="ndarray").T
    facing = np.stack([corner[one], corner[other]], axis=1)
    in_line = _goes_on(before[one], after[one], facing) | _goes_on(before[other], after[other], facing[:, ::-1])
    across = _straight_across(corner, edges, _REACH_M / cell_m)
    lines = np.concatenate([facing, across])
    in_line = np.concatenate([in_line, np.zeros(len(across), bool)])
    length = _lengths(lines)
    between = lines[:, :1] + np.linspace(0.1, 0.9, 17)[:, None] * (lines[:, 1:] - lines[:, :1])
    chosen = np.flatnonzero((length > 3) & _at(free, between).all(axis=1))
    chosen = chosen[np.lexsort((length[chosen], ~in_line[chosen]))]
    return list(zip(lines[chosen], in_line[chosen].tolist(), strict=True))


def _corners(free: BoolArray, tolerance: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(n, 2) column and row of corners that stand out into the free cells, the way to the outline's corners beside each, and
    (e, 2, 2) the edges of all outlines."""
    corners: list[FloatArray] = [np.zeros((0, 3, 2))]
    # Bordered, so that every outline is closed, with free cells on the same side.
    for ring in find_contours(np.pad(free, 1).astype(np.float32), 0.5):  # type: ignore[no-untyped-call]
        chain = shapely.simplify(shapely.linestrings(ring - 1), tolerance, preserve_topology=False)
        outline = shapely.get_coordinates(chain)[:-1, ::-1]
        if len(outline) >= 3:
            before, after = np.roll(outline, 1, axis=0) - outline, np.roll(outline, -1, axis=0) - outline
            corners.append(np.stack([outline, before, after], axis=1))
    corner, before, after = np.concatenate(corners).transpose(1, 0, 2)
    turn = np.arctan2(after[:, 0] * before[:, 1] - after[:, 1] * before[:, 0], -(before * after).sum(axis=1))
    out = turn < -_TURN_MIN
    return corner[out], before[out], after[out], np.stack([corner, corner + after], axis=1)


def _goes_on(before: FloatArray, after: FloatArray, lines: FloatArray) -> BoolArray:
    """Whether a wall at the start of each line (n, 2, 2), on either side of its corner, would go on along it."""
    length = np.maximum(_lengths(lines), 1e-9)
    along = (lines[:, 1] - lines[:, 0]) / length[:, None]
    found = np.zeros(len(lines), bool)
    for wall in (before, after):
        wall_length = np.linalg.norm(wall, axis=1)
        found |= ((wall * along).sum(axis=1) < _IN_LINE * wall_length) & (wall_length >= _LINE_SHARE * length)
    return found


def _straight_across(corner: FloatArray, edges: FloatArray, reach: float) -> FloatArray:
    """Lines (n, 2, 2) from corners (c, 2) that meet edges (e, 2, 2) at a right angle, at most `reach` long."""
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
    """The line whose ends both lie near those of this one, turned as this one is."""
    if not others:
        return None
    there = np.array(others)
    both = np.stack([there, there[:, ::-1]])
    away = np.linalg.norm(both - line, axis=-1).max(axis=-1)
    turned, index = np.unravel_index(away.argmin(), away.shape)
    return np.asarray(both[turned, index]) if away[turned, index] < near else None


def near_wall(walls: BoolArray, row: int, column: int) -> bool:
    """Whether a cell or one beside it is a wall."""
    return bool(walls[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].any())


def _beside(line: FloatArray, free: BoolArray, cell_m: float) -> float:
    """How far one could go parallel to a line, in cells: the most within its depth, on the narrower side of it."""
    length = float(np.linalg.norm(line[1] - line[0]))
    along = (line[1] - line[0]) / length
    depth = np.arange(_DEPTH_M[0] / cell_m, max(_DEPTH_M[1] / cell_m, _DEPTH_SHARE * length) + 1, 2.0)
    away = np.arange(0.0, 2.5 * length + 10)  # more does not matter
    widest = []
    for across in (np.array([-along[1], along[0]]), np.array([along[1], -along[0]])):
        straight = _at(free, line.mean(axis=0) + np.arange(1.5, depth[-1] + 1)[:, None] * across)
        reached = depth[depth <= 1.5 + (len(straight) if straight.all() else int(straight.argmin()))]
        base = line.mean(axis=0) + reached[:, None] * across
        ways = np.stack([_at(free, base[:, None] + way * away[:, None] * along) for way in (1, -1)])
        lengths = np.where(ways.all(axis=2), len(away), ways.argmin(axis=2)).sum(axis=0)
        widest.append(float(lengths.max(initial=0)))
    return min(widest)


def _at(image: NDArray[Any], places: FloatArray) -> NDArray[Any]:
    """The image (rows, columns) at places (..., 2) column and row; what lies outside is as its border."""
    column, row = np.moveaxis(_cells(places), -1, 0)
    return np.asarray(image[np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)])


def _cells(places: FloatArray) -> IntArray:
    """The cells that hold places; corners lie on their borders, and rounding to even numbers would pass every other one."""
    return np.asarray(np.floor(places + 0.5).astype(np.int64))


def _sides(line: FloatArray, label: IntArray) -> tuple[int, int]:
    """The areas on both sides of a line; 0 where there is none."""
    along = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    across = np.array([-along[1], along[0]])
    places = line[0] + np.linspace(0.15, 0.85, 9)[:, None] * (line[1] - line[0])
    found = []
    for way in (across, -across):
        beside = _at(label, places[:, None] + np.array([2.0, 3.0])[:, None] * way)
        found.append(int(np.bincount(beside[beside > 0]).argmax()) if (beside > 0).any() else 0)
    return found[0], found[1]
