"""The ceilings of the whole building, for what single scans saw too little of to find a ceiling of its own."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from algorithms.labels import Label
from algorithms.scan import FloatArray, UInt8Array
from algorithms.semantic_map import VoxelVotes, majority

_CELL_M = 0.25
_VOTES_MIN = 3
_REACH_M = 1.5
"""A ceiling goes on level so far beyond what was seen of it."""
_MARGIN_M = 0.04
"""Poses drift, and returns scatter, by so much."""


@dataclass(frozen=True)
class CeilingMap:
    """How high the ceilings hang: height_m (rows, columns) in the map frame, NaN where none is near.

    origin: (2,) x and y of the first cell's corner, metres.
    """

    origin: FloatArray
    height_m: FloatArray

    def label_of(self, points_map: FloatArray, label: UInt8Array) -> UInt8Array:
        """The labels (n,) of points (n, 3), clutter at the height of the building's ceiling made ceiling."""
        clutter = np.flatnonzero(label == Label.CLUTTER)
        rows, columns = self.height_m.shape
        cell = np.floor((points_map[clutter, :2] - self.origin) / _CELL_M).astype(np.int64)
        inside = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
        clutter, cell = clutter[inside], cell[inside]
        at_ceiling = np.abs(points_map[clutter, 2] - self.height_m[cell[:, 1], cell[:, 0]]) < _MARGIN_M
        corrected = label.copy()
        corrected[clutter[at_ceiling]] = Label.CEILING
        return corrected


NO_CEILINGS = CeilingMap(np.zeros(2), np.zeros((0, 0)))


def map_ceilings(votes: VoxelVotes) -> CeilingMap:
    """The ceilings that all scans found: in each cell the median height of its cubes, and around them the nearest's."""
    is_ceiling = (majority(votes.counts) == Label.CEILING) & (votes.counts.max(axis=1, initial=0) >= _VOTES_MIN)
    position = votes.mean_position[is_ceiling]
    if not len(position):
        return NO_CEILINGS
    origin = position[:, :2].min(axis=0) - _REACH_M
    cell = np.floor((position[:, :2] - origin) / _CELL_M).astype(np.int64)
    columns, rows = cell.max(axis=0) + 1 + int(_REACH_M / _CELL_M)
    index = cell[:, 1] * columns + cell[:, 0]
    order = np.lexsort((position[:, 2], index))
    own, first, count = np.unique(index[order], return_index=True, return_counts=True)
    height_m = np.full(rows * columns, np.nan)
    height_m[own] = position[order, 2][first + count // 2]
    height_m = height_m.reshape(rows, columns)
    away, nearest = ndimage.distance_transform_edt(np.isnan(height_m), return_indices=True)
    filled = np.where(away * _CELL_M <= _REACH_M, height_m[tuple(nearest)], np.nan)
    return CeilingMap(origin, filled)
