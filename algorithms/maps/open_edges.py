"""Where free space ends in the unknown although scans found a wall there.

A wall that few places show, as one seen through a door, may be no face of the building. It is drawn
where its returns are if it ends free space over more than a metre.
"""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.maps.grid import Cell, GridMap

_LENGTH_MIN_M = 1.0
"""Minimum length (m) of an edge that is drawn: shorter ones are gaps in drawn walls."""
_NEAR_CELLS = 2
"""Maximum distance (cells) from free and unknown space. Nearer to a drawn wall or pane, returns are
its own."""
_VOXELS_MIN = 3
"""Minimum number of voxels of wall above a cell."""
_EIGHT = np.ones((3, 3), bool)


def close_edges(grid: GridMap, votes: VoxelVotes, panes: FloatArray) -> GridMap:
    """Draw the walls at which free space ends, see `open_edges`."""
    ends = open_edges(grid, votes, panes)
    return replace(grid, cells=np.where(ends, np.uint8(Cell.OCCUPIED), grid.cells))


def open_edges(grid: GridMap, votes: VoxelVotes, panes: FloatArray) -> BoolArray:
    """Find the cells (rows, columns) of walls of scans between free and unknown space.

    Args:
        votes: all scans' labels by voxel.
        panes: (N, 2, 2) ends of windows, which end free space and are not drawn.
    """
    voxels = np.zeros(grid.cells.shape, np.int64)
    np.add.at(voxels, grid.at(votes.mean_position[votes.label == Label.WALL, :2]), 1)
    drawn = grid.cells == Cell.OCCUPIED
    for pane in panes:
        drawn[grid.on_line(pane)] = True
    near_free, near_unknown, near_drawn = (
        ndimage.binary_dilation(cells, _EIGHT, iterations=_NEAR_CELLS)
        for cells in (grid.cells == Cell.FREE, grid.cells == Cell.UNKNOWN, drawn)
    )
    # Rays ended in these cells, which may therefore be free.
    ends = (voxels >= _VOXELS_MIN) & near_free & near_unknown & ~near_drawn
    label, _ = ndimage.label(ndimage.binary_dilation(ends, _EIGHT), _EIGHT)
    for number, box in enumerate(ndimage.find_objects(label), 1):
        own = ends[box] & (label[box] == number)
        if np.hypot(*np.ptp(np.argwhere(own), axis=0)) * grid.cell_m < _LENGTH_MIN_M:
            ends[box] &= ~own
    return np.asarray(ends)
