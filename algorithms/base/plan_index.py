"""Spatial indices of faces seen from above: near a point, and by direction from a sensor."""

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import LENGTH, Faces, along_line, before_line, lines_of

SECTORS = 512  # of directions about a sensor
_CELL_M = 0.5  # edge of a cell
_HEADER = 4  # entries before the cells: first column and row, number of columns and rows


def index_near(faces: Faces, reach_m: float) -> IntArray:
    """List for each grid cell the faces at most `reach_m` away from any point in it, ascending.

    With `p = cell_at(index, x, y)`, the faces near (x, y) are `index[index[p]:index[p + 1]]`. A
    single array, because compiled code counts references to each array that it takes out of a
    tuple, which costs more than the look-up.
    """
    ends = np.ascontiguousarray(faces.ends, np.float64)
    if not len(ends):
        return np.array([0, 0, 0, 0, _HEADER + 2, _HEADER + 2], np.int64)
    first = np.floor((ends.min(axis=(0, 1)) - reach_m) / _CELL_M).astype(np.int64)
    shape = np.floor((ends.max(axis=(0, 1)) + reach_m) / _CELL_M).astype(np.int64) + 1 - first
    count = np.zeros(int(shape.prod()), np.int64)
    _list_near(ends, reach_m, first, shape, count, np.zeros(0, np.int64))
    starts = _HEADER + len(count) + 2 + np.concatenate([[0], np.cumsum(count)])
    # The last cell is everything beyond the grid, where no face is near.
    faces_of_cells = np.empty(int(count.sum()), np.int64)
    index = np.concatenate([first, shape, starts, starts[-1:], faces_of_cells])
    _list_near(ends, reach_m, first, shape, starts[:-1].copy(), index)
    return index


@numba.njit(cache=True, nogil=True)
def _list_near(
    ends: FloatArray,
    reach_m: float,
    first: IntArray,
    shape: IntArray,
    place: IntArray,
    index: IntArray,
) -> None:
    """Write each face to index[place[cell]] and advance place; only advance if index is empty."""
    far_m = reach_m + _CELL_M * np.sqrt(0.5)
    for k in range(len(ends)):
        x, y = ends[k, 0, 0] - first[0] * _CELL_M, ends[k, 0, 1] - first[1] * _CELL_M
        dx, dy = ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1]
        square = max(dx * dx + dy * dy, 1e-12)
        left = max(int((min(x, x + dx) - far_m) / _CELL_M), 0)
        right = min(int((max(x, x + dx) + far_m) / _CELL_M) + 1, shape[0])
        low = max(int((min(y, y + dy) - far_m) / _CELL_M), 0)
        high = min(int((max(y, y + dy) + far_m) / _CELL_M) + 1, shape[1])
        for row in range(low, high):
            for column in range(left, right):
                cx, cy = (column + 0.5) * _CELL_M - x, (row + 0.5) * _CELL_M - y
                share = min(max((cx * dx + cy * dy) / square, 0.0), 1.0)
                if np.hypot(cx - share * dx, cy - share * dy) <= far_m:
                    cell = row * shape[0] + column
                    if len(index):
                        index[place[cell]] = k
                    place[cell] += 1


@numba.njit(cache=True, nogil=True, forceinline=True)
def cell_at(index: IntArray, x: float, y: float) -> int:
    """The entry of `index_near` with the start of the list of faces near a point."""
    column = int(np.floor(x / _CELL_M)) - index[0]
    row = int(np.floor(y / _CELL_M)) - index[1]
    if column < 0 or row < 0 or column >= index[2] or row >= index[3]:
        return int(_HEADER + index[2] * index[3])
    return int(_HEADER + row * index[2] + column)


def pairs_near(faces: Faces, points: FloatArray, reach_m: float) -> tuple[IntArray, IntArray]:
    """Find all pairs (p,) of a point (n, 2 or 3) and a face that it is near.

    Near: less than `reach_m` before or behind the face, and less than that beyond its ends.
    """
    index, lines = index_near(faces, 2.0 * reach_m), lines_of(faces)
    return _pairs_near(np.ascontiguousarray(points, np.float64), lines, index, reach_m)


@numba.njit(cache=True, nogil=True)
def _pairs_near(
    points: FloatArray, lines: FloatArray, index: IntArray, reach_m: float
) -> tuple[IntArray, IntArray]:
    point, face = np.empty(64, np.int64), np.empty(64, np.int64)
    count = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        cell = cell_at(index, x, y)
        for place in range(index[cell], index[cell + 1]):
            k = index[place]
            if abs(before_line(lines, k, x, y)) < reach_m:
                along = along_line(lines, k, x, y)
                if -reach_m < along < lines[k, LENGTH] + reach_m:
                    if count == len(point):
                        point = np.concatenate((point, point))
                        face = np.concatenate((face, face))
                    point[count], face[count] = i, k
                    count += 1
    return point[:count], face[:count]


@numba.njit(cache=True, nogil=True, forceinline=True)
def sector_of(x: float, y: float) -> int:
    """The sector, of `SECTORS`, of a direction (x, y); 0 where both are 0.

    Sectors divide the square |x| + |y| = 1 evenly, not the circle: no ray needs an arc tangent.
    """
    total = abs(x) + abs(y)
    if total == 0.0:
        return 0
    quarters = 1.0 - x / total if y >= 0.0 else 3.0 + x / total
    return min(int(quarters * (SECTORS / 4.0)), SECTORS - 1)


@numba.njit(cache=True, nogil=True)
def sectors_around(points: FloatArray) -> tuple[int, int]:
    """First sector and number of sectors that the convex hull of points (n, 2) may reach into.

    Seen from (0, 0), it must be less than half a turn wide.
    """
    middle = np.arctan2(points[:, 1].mean(), points[:, 0].mean())
    low, high = 0.0, 0.0
    for k in range(len(points)):
        angle = np.arctan2(points[k, 1], points[k, 0]) - middle
        angle -= 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)
        low, high = min(low, angle), max(high, angle)
    first = sector_of(np.cos(middle + low), np.sin(middle + low)) - 1
    last = sector_of(np.cos(middle + high), np.sin(middle + high)) + 1
    return first % SECTORS, (last - first) % SECTORS + 1


@numba.njit(cache=True, nogil=True)
def enter(face: int, first: int, sectors: int, faces: IntArray, count: IntArray) -> None:
    """Add a face to the lists of its sectors: faces (SECTORS, n), count (SECTORS,)."""
    for k in range(first, first + sectors):
        sector = k % SECTORS
        faces[sector, count[sector]] = face
        count[sector] += 1
