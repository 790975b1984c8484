"""Grid maps: cells and drawing."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from pydantic import Field
from skimage.draw import polygon
from skimage.measure import block_reduce

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings

MARGIN_M = 1.0
"""Width (m) of the unknown border around a map."""


class GridMapSettings(StepSettings):
    """The furniture-free grid and its rivals (paper, IV.C, Fig. 9)."""

    cell_m: float = Field(0.05, ge=0.005, le=1, description="Edge of a cell (m). IV.C.")
    doors: Literal["open", "as-seen", "closed"] = Field(
        "open",
        description="Which doorways are free: open (all), as-seen (of open doors), closed (none). "
        "IV.C.",
    )


class Cell(IntEnum):
    """Content of a cell, with the values of ROS' map_server images."""

    OCCUPIED = 0
    UNKNOWN = 205
    FREE = 254


@dataclass(frozen=True)
class GridMap:
    """An occupancy grid.

    cells: (rows, columns) uint8, see `Cell`; row 0 has the lowest y. origin: (2,) x and y of the
    lower left corner (m).
    """

    cells: UInt8Array
    origin: FloatArray
    cell_m: float

    @classmethod
    def around(cls, places: Sequence[FloatArray], cell_m: float) -> "GridMap":
        """Make an unknown map around places (…, 2), with a margin; of one cell without places."""
        corners = np.concatenate([np.zeros((0, 2)), *(place.reshape(-1, 2) for place in places)])
        low, high = np.zeros(2), np.zeros(2)
        if len(corners):
            low, high = corners.min(axis=0) - MARGIN_M, corners.max(axis=0) + MARGIN_M
        origin = np.floor(low / cell_m).astype(np.int64) * cell_m
        columns, rows = np.maximum(np.ceil((high - origin) / cell_m).astype(int), 1)
        return cls(np.full((rows, columns), Cell.UNKNOWN, np.uint8), origin, cell_m)

    def centres(self, cell: Cell) -> FloatArray:
        """(m, 2) x and y of the middles of all cells of one kind."""
        return self.middles(self.cells == cell)

    def middles(self, chosen: BoolArray) -> FloatArray:
        """(m, 2) x and y of the middles of chosen cells."""
        rows, columns = np.nonzero(chosen)
        return np.asarray(self.origin + (np.stack([columns, rows], axis=1) + 0.5) * self.cell_m)

    def index(self, places: FloatArray) -> tuple[IntArray, BoolArray]:
        """Column and row (…, 2) of places (…, 2), and whether (…,) they are inside the map."""
        index = np.floor((places - self.origin) / self.cell_m).astype(np.int64)
        return index, np.asarray(((index >= 0) & (index < self.cells.shape[::-1])).all(axis=-1))

    def at(self, places: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of the places (n, 2) inside the map."""
        index, inside = self.index(places)
        return index[inside, 1], index[inside, 0]

    def on_line(self, ends: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of a thin line (2, 2): one cell in each column, or row, of its span.

        Ends are not rounded to cells, as `skimage.draw.line` would: that shifts lines by up to
        half a cell.
        """
        start, stop = (ends - self.origin) / self.cell_m
        axis = int(abs(stop[1] - start[1]) > abs(stop[0] - start[0]))
        low, high = sorted((start[axis], stop[axis]))
        middles = np.clip(np.arange(np.floor(low), np.floor(high) + 1) + 0.5, low, high)
        share = (middles - start[axis]) / (stop[axis] - start[axis]) if high > low else np.zeros(1)
        column, row = np.floor(start + share[:, None] * (stop - start)).astype(np.int64).T
        rows, columns = self.cells.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return row[inside], column[inside]

    def in_area(self, corners: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of the cells whose middle is in a polygon (n, 2)."""
        column, row = (corners - self.origin).T / self.cell_m - 0.5
        rows, columns = polygon(row, column, self.cells.shape)  # type: ignore[no-untyped-call]
        return rows, columns

    def cropped(self, rows: slice, columns: slice) -> "GridMap":
        """A part of the map."""
        origin = self.origin + self.cell_m * np.array([columns.start, rows.start])
        return GridMap(np.ascontiguousarray(self.cells[rows, columns]), origin, self.cell_m)

    def cells_within(self, frame: "GridMap") -> UInt8Array:
        """The cells of a frame that holds this map and has the same cells; unknown beyond it."""
        cells = np.full_like(frame.cells, Cell.UNKNOWN)
        column, row = np.round((self.origin - frame.origin) / self.cell_m).astype(int)
        rows, columns = self.cells.shape
        cells[row : row + rows, column : column + columns] = self.cells
        return cells


def window(chosen: BoolArray, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the marked cells with a margin (cells); everything without any."""
    found = [np.flatnonzero(chosen.any(axis=axis)) for axis in (1, 0)]
    if not len(found[0]):
        return slice(0, chosen.shape[0]), slice(0, chosen.shape[1])
    rows, columns = (slice(max(int(i[0]) - margin, 0), int(i[-1]) + 1 + margin) for i in found)
    return rows, columns


def coarsened(grid: GridMap, cells_max: int) -> GridMap:
    """Crop the map around its free cells and enlarge cells until at most `cells_max` are left.

    A large cell is occupied if any of its cells is, and else free if any is: no wall opens, and no
    room is lost.
    """
    part = grid.cropped(*window(grid.cells == Cell.FREE, 10))
    factor = int(np.ceil(np.sqrt(part.cells.size / cells_max)))
    occupied, free = (
        block_reduce(part.cells == cell, factor, np.any)  # type: ignore[no-untyped-call]
        for cell in (Cell.OCCUPIED, Cell.FREE)
    )
    cells = np.select([occupied, free], [Cell.OCCUPIED, Cell.FREE], Cell.UNKNOWN).astype(np.uint8)
    return GridMap(cells, part.origin, part.cell_m * factor)
