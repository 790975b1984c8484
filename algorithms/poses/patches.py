"""Small flat pieces of floors and walls among points."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base.scan import FloatArray

_THICKNESS_MAX_M, _BREADTH_MIN_M = 0.02, 0.05
"""RMS thickness beyond which a neighbourhood is not flat, and RMS breadth below which it is a line."""


@dataclass(frozen=True)
class Patches:
    """centre: (n, 3) metres; normal: (n, 3) unit vectors, of either sign."""

    centre: FloatArray
    normal: FloatArray

    @classmethod
    def of(cls, points: FloatArray, cube_m: float, neighbours: int) -> "Patches":
        """One for each cube with points (n, 3) whose neighbourhood, of the nearest cubes, is flat and no line."""
        cubes = np.floor(points / cube_m).astype(np.int64)
        # By one number a cube: by rows, to sort them takes most of the time.
        cube, row = np.unique(cubes @ [1 << 42, 1 << 21, 1], return_inverse=True)
        if len(cube) < neighbours:
            return cls(np.zeros((0, 3)), np.zeros((0, 3)))
        count = np.bincount(row)
        centre = np.stack([np.bincount(row, points[:, axis]) / count for axis in range(3)], axis=1)
        nearest = cKDTree(centre).query(centre, k=neighbours)[1]
        # Weighted: of a plane that lies at a cube's side, few returns scatter into the next one.
        near, weight = centre[nearest], count[nearest] / count[nearest].sum(axis=1, keepdims=True)
        middle = np.einsum("nk,nki->ni", weight, near)
        centred = near - middle[:, None]
        variance, direction = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, centred, centred))
        flat = (variance[:, 0] < _THICKNESS_MAX_M**2) & (variance[:, 1] > _BREADTH_MIN_M**2)
        return cls(middle[flat], direction[flat, :, 0])
