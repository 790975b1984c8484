"""Clouds and maps of Gaussians, and their registration by VGICP; the only import of small_gicp.

KISS-ICP matches points to points. The rings of a lidar on floor and walls move with it, and so do
their points: in a bare corridor that holds the pose back, by up to a metre. Distributions have no
such bias: a patch of floor constrains height and inclination only (Segal et al. 2009, "GICP";
voxels of Gaussians: Koide et al. 2021, "Voxelized GICP").
"""

from dataclasses import dataclass

import numpy as np
import small_gicp  # noqa: TID251 - its one place

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray

_RESOLUTION_M = 0.2
"""Edge (m) of the voxels that keep one point each of a cloud."""
_NEIGHBOURS = 12
"""Number of neighbours from which a point's covariance is estimated."""


@dataclass(frozen=True)
class Aligned:
    """A cloud registered to a map.

    T_map_cloud: (4, 4); the guess where nothing matched.
    inlier_share: share of the cloud's points that have a Gaussian.
    information: (6, 6) Hessian of the pose, rotation before translation, for a small motion in the
        cloud's frame; zeros where nothing matched.
    """

    T_map_cloud: FloatArray
    inlier_share: float
    information: FloatArray

    @property
    def weakest_share(self) -> float:
        """Information on the position in its weakest direction, as a share of its strongest."""
        held = np.linalg.eigvalsh(self.information[3:, 3:])
        return float(max(held[0], 0.0) / max(held[2], 1e-9))


class GaussianCloud:
    """Points (n, 3) in metres, thinned, each with the covariance of its neighbourhood."""

    def __init__(self, points: FloatArray) -> None:
        self.cloud, _ = small_gicp.preprocess_points(
            points.astype(np.float64),
            downsampling_resolution=_RESOLUTION_M,
            num_neighbors=_NEIGHBOURS,
        )

    def __len__(self) -> int:
        return int(self.cloud.size())

    @property
    def points(self) -> FloatArray:
        """(m, 3) float32."""
        return np.asarray(self.cloud.points())[:, :3].astype(np.float32)

    @property
    def normals(self) -> FloatArray:
        """(m, 3) float32 unit vectors of the neighbourhoods' planes."""
        return np.asarray(self.cloud.normals())[:, :3].astype(np.float32)


class GaussianMap:
    """Voxels with one Gaussian each.

    voxel_m: their edge. memory: number of insertions after which a voxel without new points is
    removed; None keeps all.
    """

    def __init__(self, voxel_m: float, memory: int | None = None) -> None:
        self._map = small_gicp.GaussianVoxelMap(voxel_m)
        self._map.set_lru(horizon=2_000_000_000 if memory is None else memory, clear_cycle=10)

    def insert(self, cloud: GaussianCloud, T_map_cloud: FloatArray) -> None:
        """Add a cloud at its pose."""
        self._map.insert(cloud.cloud, T_map_cloud)

    def register(
        self, cloud: GaussianCloud, guess: FloatArray, distance_m: float, iterations_max: int
    ) -> Aligned:
        """Find the pose near a guess (4, 4).

        distance_m: maximum distance of a point from its Gaussian; others are ignored.
        """
        found = small_gicp.align(
            self._map,
            cloud.cloud,
            guess,
            max_correspondence_distance=distance_m,
            num_threads=1,
            max_iterations=iterations_max,
            rotation_epsilon=1e-4,
            translation_epsilon=2e-4,
        )
        if not found.num_inliers or not np.isfinite(found.T_target_source).all():
            return Aligned(guess, 0.0, np.zeros((6, 6)))
        return Aligned(
            # Rounding errors would grow from pose to pose.
            transforms.orthonormal(np.array(found.T_target_source)),
            found.num_inliers / len(cloud),
            np.array(found.H),
        )
