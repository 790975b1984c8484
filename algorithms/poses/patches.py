"""Small planar patches of floors and walls among points."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.scan import FloatArray

_THICKNESS_MAX_M, _BREADTH_MIN_M = 0.02, 0.05
"""Standard deviations (m) of a patch: maximum across it; minimum along it, less being a line."""


@dataclass(frozen=True, eq=False)
class Patches:
    """centre: (n, 3) metres; normal: (n, 3) unit vectors, of either sign."""

    centre: FloatArray
    normal: FloatArray

    @cached_property
    def tree(self) -> cKDTree:
        """Of the centres."""
        return cKDTree(self.centre)

    @classmethod
    def of(cls, points: FloatArray, voxel_m: float, neighbours: int) -> "Patches":
        """One for each voxel of the points (n, 3) whose nearest voxels are on a plane."""
        voxels = np.floor(points / voxel_m).astype(np.int64)
        # One key a voxel: sorting by rows would take most of the time.
        voxel, row = np.unique(voxels @ [1 << 42, 1 << 21, 1], return_inverse=True)
        if len(voxel) < neighbours:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)))
        count = np.bincount(row)
        sums = [np.bincount(row, points[:, axis]) for axis in range(3)]
        centre = np.stack([total / count for total in sums], axis=1)
        nearest = cKDTree(centre).query(centre, k=neighbours)[1]
        # Weighted by returns: few returns of a plane at a voxel's side scatter into the next voxel.
        weight = count[nearest] / count[nearest].sum(axis=1, keepdims=True)
        mean = np.einsum("nk,nki->ni", weight, centre[nearest])
        off = centre[nearest] - mean[:, None]
        variance, direction = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, off, off))
        flat = (variance[:, 0] < _THICKNESS_MAX_M**2) & (variance[:, 1] > _BREADTH_MIN_M**2)
        return cls(mean[flat], direction[flat, :, 0])
