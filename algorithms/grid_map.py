"""Grid maps of the building (paper, IV.C, Fig. 9)."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from pydantic import Field

from algorithms.building import Doors, Walls
from algorithms.features import Features
from algorithms.scan import FloatArray, IntArray, UInt8Array
from algorithms.settings import StepSettings


class GridMapSettings(StepSettings):
    """The furniture-free grid (paper, IV.C, Fig. 9b)."""

    cell_m: float = Field(0.05, gt=0, le=1, description="Edge of a cell in metres. IV.C.")
    range_m: float = Field(12.0, gt=0, description="Rays clear cells up to so many metres from the sensor. IV.C.")
    margin_m: float = Field(1.0, ge=0, description="Unknown border in metres around the walls. IV.C.")
    door_depth_m: float = Field(
        0.35, ge=0, description="A door is opened so many metres to both sides, through the wall's thickness. IV.C."
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


def draw_furniture_free(
    walls: Walls,
    doors: Doors,
    path_map: FloatArray,
    blocks: Iterable[Features],
    settings: GridMapSettings,
) -> GridMap:
    """Walls occupied, doors open, what the rays crossed before they met a wall free (paper, Fig. 9b).

    path_map: (n, 2 or more) the robot's places, which are free. blocks: the features of all scans in any portions.
    """
    corners = np.concatenate([walls.ends.reshape(-1, 2), path_map[:, :2]])
    if not len(corners):
        return GridMap(np.full((1, 1), Cell.UNKNOWN, np.uint8), np.zeros(2), settings.cell_m)
    cell_m = settings.cell_m
    origin = np.floor((corners.min(axis=0) - settings.margin_m) / cell_m) * cell_m
    columns, rows = np.ceil((corners.max(axis=0) + settings.margin_m - origin) / cell_m).astype(int)
    cells = np.full((rows, columns), Cell.UNKNOWN, np.uint8)
    for ends in walls.ends:
        _set_cells(cells, _cells_along(ends, origin, cell_m), Cell.OCCUPIED)
    for ends, normal in zip(doors.ends, doors.normal, strict=True):
        _open_door(cells, ends, normal, origin, settings)
    for block in blocks:
        _clear_along_rays(
            cells,
            np.ascontiguousarray((block.origin_map[:, :2] - origin) / cell_m, np.float64),
            block.ray_starts,
            np.ascontiguousarray((block.ray_end_map[:, :2] - origin) / cell_m, np.float64),
            settings.range_m / cell_m,
        )
    _set_cells(cells, np.floor((path_map[:, :2] - origin) / cell_m).astype(np.int64), Cell.FREE)
    return GridMap(cells, origin, cell_m)


def _cells_along(ends: FloatArray, origin: FloatArray, cell_m: float) -> IntArray:
    steps = max(2, int(np.ceil(np.linalg.norm(ends[1] - ends[0]) / (0.25 * cell_m))))
    points = ends[0] + np.linspace(0, 1, steps)[:, None] * (ends[1] - ends[0])
    return np.asarray(np.floor((points - origin) / cell_m).astype(np.int64))


def _set_cells(cells: UInt8Array, index_xy: IntArray, value: int) -> None:
    rows, columns = cells.shape
    inside = (index_xy >= 0).all(axis=1) & (index_xy[:, 0] < columns) & (index_xy[:, 1] < rows)
    cells[index_xy[inside, 1], index_xy[inside, 0]] = value


def _open_door(
    cells: UInt8Array, ends: FloatArray, normal: FloatArray, origin: FloatArray, settings: GridMapSettings
) -> None:
    """Free what lies between the jambs, so far to both sides as walls are thick."""
    steps = np.arange(-settings.door_depth_m, settings.door_depth_m + 1e-9, 0.5 * settings.cell_m)
    for step in steps:
        _set_cells(cells, _cells_along(ends + normal * step, origin, settings.cell_m), Cell.FREE)


@numba.njit(cache=True, nogil=True)
def _clear_along_rays(
    cells: UInt8Array, origin: FloatArray, starts: IntArray, end: FloatArray, range_cells: float
) -> None:  # pragma: no cover
    """Walk every fourth ray cell by cell (Amanatides and Woo 1987) and free what is unknown, up to a wall or its end."""
    rows, columns = cells.shape
    for s in range(len(origin)):
        for r in range(starts[s] + s % 4, starts[s + 1], 4):
            dx, dy = end[r, 0] - origin[s, 0], end[r, 1] - origin[s, 1]
            length = np.sqrt(dx * dx + dy * dy)
            if length < 1e-6:
                continue
            column, row = int(np.floor(origin[s, 0])), int(np.floor(origin[s, 1]))
            step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            t_dx = length / abs(dx) if dx != 0 else np.inf
            t_dy = length / abs(dy) if dy != 0 else np.inf
            t_x = (column + (dx > 0) - origin[s, 0]) * step_x * t_dx if dx != 0 else np.inf
            t_y = (row + (dy > 0) - origin[s, 1]) * step_y * t_dy if dy != 0 else np.inf
            stop = min(length, range_cells)
            while True:
                if column < 0 or row < 0 or column >= columns or row >= rows or cells[row, column] == 0:
                    break
                cells[row, column] = 254
                if t_x < t_y:
                    if t_x > stop:
                        break
                    column += step_x
                    t_x += t_dx
                else:
                    if t_y > stop:
                        break
                    row += step_y
                    t_y += t_dy
