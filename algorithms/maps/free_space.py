"""Free space of grid maps: what rays crossed near visible floor (paper, IV.C, Fig. 9).

Several maps are drawn in one walk along each ray: each map has a bit in every cell.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.ndimage import binary_closing, binary_dilation, binary_propagation

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.rays import Rays, floor_m
from ffmap.algorithms.maps.grid import MARGIN_M, Cell, GridMap, window
from ffmap.algorithms.scan.summary import Features

FLOOR_REACH_M = 1.5
"""Maximum distance (m) of free cells from visible floor: tables hide floor."""
_RANGE_M = 25.0
"""Maximum distance (m) from the sensor that rays make free."""
_EVERY = 4
"""One ray in this number is walked."""
_BLIND_M = 1.0
"""Maximum distance (m) from its way at which the robot may not see the floor."""
_STEP_MAX_M = 0.5
"""Maximum distance (m) of two places that the robot's way joins: beyond, poses are missing."""
_VISIBLE_CELLS = 2
"""Maximum distance (cells) of a drawn wall from what rays crossed."""
_EIGHT = np.ones((3, 3), bool)


@dataclass(frozen=True)
class Draft:
    """A map without its free cells.

    occupied, blocked: (rows, columns) drawn cells, and cells that stop rays (windows also do).
    doorways: (4, 2) each, free in any case. leaves: (2, 2) each, which close doorways.
    hides_walls: whether occupied cells that bound nothing visible are left out, such as the
    reveals of windows and walls that are continued behind a pillar.
    """

    occupied: BoolArray
    blocked: BoolArray
    doorways: Sequence[FloatArray] = ()
    leaves: Sequence[FloatArray] = ()
    hides_walls: bool = False


def draw_free(
    drafts: Sequence[Draft], frame: GridMap, drive: Drive, knee_m: float
) -> list[GridMap]:
    """Draw free cells into up to 8 maps of one frame, cropped to what the first of them shows.

    A cell is free if a ray crossed it before it was blocked, within `FLOOR_REACH_M` of visible
    floor. Floor is visible where a ray to it ran below `knee_m`; it counts if such cells connect
    it to the robot's way. Beyond visible floor only cells close to a ray's end are free: others
    may be seen through a window.
    """
    passable = np.packbits([~draft.blocked for draft in drafts], axis=0, bitorder="little")[0]
    marked = np.zeros((3, *passable.shape), np.uint8)
    reach, range_cells = int(FLOOR_REACH_M / frame.cell_m), _RANGE_M / frame.cell_m
    for block in drive.blocks():
        start, end, label = _ray_ends(block, frame)
        length = np.hypot(*(end - start)[:, :2].T)
        drop_m = np.maximum(start[:, 2] - end[:, 2], knee_m)
        low_from = np.where(label == Label.FLOOR, (1.0 - knee_m / drop_m) * length, np.inf)
        inside = (end[:, :2] >= 0).all(axis=1) & (end[:, :2] < passable.shape[::-1]).all(axis=1)
        near_from = np.where(inside & (length < range_cells), length - 2 * reach, np.inf)
        _mark_rays(passable, start, end, low_from, near_from, range_cells, marked)
    by_map = np.unpackbits(marked[None], axis=0, count=len(drafts), bitorder="little").astype(bool)
    path = drive.path_map[:, :2]
    maps = [
        _finished(draft, crossed, low, near, frame, path, reach)
        for draft, (crossed, low, near) in zip(drafts, by_map, strict=True)
    ]
    part = window(maps[0] != Cell.UNKNOWN, round(MARGIN_M / frame.cell_m))
    return [GridMap(cells, frame.origin, frame.cell_m).cropped(*part) for cells in maps]


def _finished(
    draft: Draft,
    crossed: BoolArray,
    low: BoolArray,
    near: BoolArray,
    frame: GridMap,
    path: FloatArray,
    reach: int,
) -> UInt8Array:
    """The cells of a map; crossed, low, near: see `_mark_rays`."""
    for doorway in draft.doorways:
        crossed[frame.in_area(doorway)] = True
    # Far away rays are apart; a wall is thicker than the gaps between them that this closes.
    crossed = crossed | binary_closing(crossed, _EIGHT) & ~draft.blocked
    # Floor that is connected to the robot's way: floor behind a sill is not.
    floor = binary_closing(low, _EIGHT) & crossed
    start = np.zeros(floor.shape, bool)
    start[frame.at(path)] = True
    start = binary_dilation(start, iterations=int(_BLIND_M / frame.cell_m)) & floor
    free = binary_propagation(start, _EIGHT, floor)
    near = (binary_closing(near, _EIGHT) | free) & crossed
    free = binary_dilation(free, iterations=reach, mask=near)
    cells = np.where(draft.occupied, Cell.OCCUPIED, Cell.UNKNOWN).astype(np.uint8)
    if draft.hides_walls:
        cells[~binary_dilation(crossed, _EIGHT, iterations=_VISIBLE_CELLS)] = Cell.UNKNOWN
    cells[free] = Cell.FREE
    for step in np.stack([path[:-1], path[1:]], axis=1):
        if np.linalg.norm(step[1] - step[0]) < _STEP_MAX_M:
            cells[frame.on_line(step)] = Cell.FREE
    cells[frame.at(path)] = Cell.FREE
    for doorway in draft.doorways:
        cells[frame.in_area(doorway)] = Cell.FREE
    for leaf in draft.leaves:
        cells[frame.on_line(leaf)] = Cell.OCCUPIED
    return cells


def _ray_ends(block: Features, frame: GridMap) -> tuple[FloatArray, FloatArray, UInt8Array]:
    """Starts and ends (n, 3) of one of `_EVERY` rays, and its label (n,).

    x and y are in cells of the frame, the height is in metres above the floor.
    """
    rays, scan = Rays.of(block), block.ray_scan
    place = np.arange(len(scan)) - rays.starts[scan]
    chosen = np.flatnonzero(place % _EVERY == scan % _EVERY)
    scans = np.arange(len(rays.origin))
    low = np.append(frame.origin, 0.0)
    unit = np.array([frame.cell_m, frame.cell_m, 1.0])
    starts, ends = (
        (np.column_stack([xyz[:, :2], _heights_m(rays.floors, of, xyz)]) - low) / unit
        for of, xyz in ((scans, rays.origin), (scan[chosen], rays.end[chosen].astype(np.float64)))
    )
    return starts[scan[chosen]], ends, rays.label[chosen]


@numba.njit(cache=True)
def _heights_m(
    floors: FloatArray, scan: IntArray, points: FloatArray
) -> FloatArray:  # pragma: no cover
    """Heights (n,) of points (n, 3) above the floor as their scans saw it."""
    heights = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i]
        heights[i] = z - floor_m(floors, scan[i], x, y)
    return heights


@numba.njit(cache=True)
def _mark_rays(
    passable: UInt8Array,
    start: FloatArray,
    end: FloatArray,
    low_from: FloatArray,
    near_from: FloatArray,
    range_cells: float,
    marked: UInt8Array,
) -> None:  # pragma: no cover
    """Walk rays cell by cell (Amanatides and Woo 1987) until they are blocked in all maps.

    passable: (rows, columns) the maps, as bits, that do not block rays in each cell. marked: (3,
    rows, columns) the maps in which a ray crosses it; in which that is at least `low_from` cells
    from its start; and at least `near_from` cells.
    """
    rows, columns = passable.shape
    for r in range(len(start)):
        x, y, dx, dy = start[r, 0], start[r, 1], end[r, 0] - start[r, 0], end[r, 1] - start[r, 1]
        length = np.sqrt(dx * dx + dy * dy)
        column, row = int(np.floor(x)), int(np.floor(y))
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        t_dx = length / abs(dx) if dx != 0 else np.inf
        t_dy = length / abs(dy) if dy != 0 else np.inf
        t_x = (column + (dx > 0) - x) * step_x * t_dx if dx != 0 else np.inf
        t_y = (row + (dy > 0) - y) * step_y * t_dy if dy != 0 else np.inf
        at, left = 0.0, np.uint8(255)
        while at <= min(length, range_cells) and 0 <= column < columns and 0 <= row < rows:
            left &= passable[row, column]
            if left == 0:
                break
            marked[0, row, column] |= left
            if at >= low_from[r]:
                marked[1, row, column] |= left
            if at >= near_from[r]:
                marked[2, row, column] |= left
            at = min(t_x, t_y)
            if t_x < t_y:
                column += step_x
                t_x += t_dx
            else:
                row += step_y
                t_y += t_dy
