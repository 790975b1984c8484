"""Wall faces as tests need them."""

import numpy as np

from ffmap.algorithms.building.model import Walls

CEILING_M = 2.8


def faces(*ends: tuple[tuple[float, float], tuple[float, float]]) -> Walls:
    """Faces whose normals lie to the left of the way from their first end to their second."""
    segments = np.array(ends, np.float64)
    along = segments[:, 1] - segments[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    count = len(segments)
    return Walls(
        segments,
        np.stack([-along[:, 1], along[:, 0]], axis=1),
        np.zeros(count),
        np.full(count, CEILING_M),
        np.full(count, 9, np.int32),
        np.full(count, 0.01),
        np.full(count, 900),
    )
