"""Poses refined by generalised ICP to a map of Gaussians; the only file that imports small_gicp.

KISS-ICP matches points to points. The rings that a lidar draws on floor and walls move with it, and so do their points:
in a bare corridor that holds the pose back, by a metre at worst. Distributions have no such bias: a patch of floor holds
a scan at its height and nowhere else (Segal et al. 2009; voxels of Gaussians: Koide et al. 2021, "Voxelized GICP").
"""

from dataclasses import dataclass

import numpy as np
import small_gicp
from pydantic import Field

from algorithms import transforms
from algorithms.scan import FloatArray, Scan
from algorithms.settings import StepSettings


class RefinementSettings(StepSettings):
    """Registering each scan again, to a map of Gaussians; in place of the paper's loop closure by BLAM (IV.A)."""

    enabled: bool = Field(True, description="Whether poses are refined; if not, they are KISS-ICP's own.")
    voxel_m: float = Field(0.4, gt=0, le=5, description="Edge in metres of the voxels that hold one Gaussian each.")
    points_max: int = Field(8_000, ge=100, description="Denser clouds are thinned evenly to at most so many returns.")
    resolution_m: float = Field(0.2, gt=0, le=5, description="Scans are thinned to a point in so many metres.")
    neighbours: int = Field(10, ge=4, description="Points that a point's covariance is estimated from.")
    distance_m: float = Field(0.5, gt=0, description="Points farther than so many metres from a Gaussian have none.")
    iterations_max: int = Field(20, ge=1, description="Most iterations a scan.")


@dataclass(frozen=True)
class Refinement:
    """One scan registered again.

    T_odom_sensor: (4, 4) at the end of the sweep.
    inlier_share: share of the thinned scan's points that have a Gaussian; 1 for the first scan.
    weakest_share: how well the scan holds its place in the direction in which it holds it least, as a share of how well
        it does in the best one; near 0 in a corridor without a feature. 1 for the first scan.
    """

    T_odom_sensor: FloatArray
    inlier_share: float
    weakest_share: float


class Refiner:
    """Registers scan after scan to the map that the earlier ones made.

    settings: of the refinement. range_m: returns nearer or farther than these are left out.
    """

    def __init__(self, settings: RefinementSettings, range_m: tuple[float, float]) -> None:
        self._settings = settings
        self._range_m = range_m
        self._map = small_gicp.GaussianVoxelMap(settings.voxel_m)
        self._last: tuple[int, FloatArray, FloatArray] | None = None
        """End of the last sweep, its pose by the odometry, and its refined one."""
        self._motion_per_ns: FloatArray = np.zeros(6)

    def refine(self, scan: Scan, T_odom_sensor: FloatArray) -> Refinement:
        """T_odom_sensor: the odometry's pose at the scan's end; its motion since the last scan is the first guess."""
        source = self._thin(scan)
        if self._last is None:
            refined = Refinement(T_odom_sensor, 1.0, 1.0)
        else:
            last_ns, T_odom_before, T_refined_before = self._last
            guess = T_refined_before @ transforms.invert(T_odom_before) @ T_odom_sensor
            refined = self._register(source, guess)
            motion = transforms.invert(T_refined_before) @ refined.T_odom_sensor
            self._motion_per_ns = transforms.to_twist(motion) / max(scan.end_ns - last_ns, 1)
        self._map.insert(source, refined.T_odom_sensor)
        self._last = (scan.end_ns, T_odom_sensor, refined.T_odom_sensor)
        return refined

    def _register(self, source: "small_gicp.PointCloud", guess: FloatArray) -> Refinement:
        found = small_gicp.align(
            self._map,
            source,
            guess,
            max_correspondence_distance=self._settings.distance_m,
            num_threads=1,
            max_iterations=self._settings.iterations_max,
            rotation_epsilon=1e-4,
            translation_epsilon=2e-4,
        )
        if not found.num_inliers or not np.isfinite(found.T_target_source).all():
            return Refinement(guess, 0.0, 0.0)
        # Small errors of rounding would grow from pose to pose.
        T_odom_sensor = transforms.orthonormal(np.array(found.T_target_source))
        hold = np.linalg.eigvalsh(np.asarray(found.H)[3:, 3:])
        return Refinement(
            T_odom_sensor, found.num_inliers / max(source.size(), 1), float(max(hold[0], 0.0) / max(hold[2], 1e-9))
        )

    def _thin(self, scan: Scan) -> "small_gicp.PointCloud":
        """Fewer points with covariances, moved to where they are seen from the end of the sweep.

        The motion within the sweep is taken to go on as it did between the last two refined poses.
        """
        stride = -(-len(scan) // self._settings.points_max) or 1
        points = scan.points_sensor[::stride].astype(np.float64)
        range_m = np.linalg.norm(points, axis=1)
        kept = (range_m > self._range_m[0]) & (range_m < self._range_m[1])
        points = points[kept]
        if scan.time_ns is not None:
            before_ns = scan.start_ns + scan.time_ns[::stride][kept] - scan.end_ns
            turn, shift = self._motion_per_ns[:3] * before_ns[:, None], self._motion_per_ns[3:] * before_ns[:, None]
            # A turn within a sweep is small: two terms of its series leave less than a millimetre.
            first = np.cross(turn, points)
            points = points + first + 0.5 * np.cross(turn, first) + shift
        cloud, _ = small_gicp.preprocess_points(
            points, downsampling_resolution=self._settings.resolution_m, num_neighbors=self._settings.neighbours
        )
        return cloud
