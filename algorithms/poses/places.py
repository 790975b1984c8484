"""Where a scan may have been taken in what was seen before, and how well it agrees with that there."""

import numpy as np
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.correlation import likely_motions
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.gaussian_map import GaussianCloud

_CUBE_M, _UPRIGHT_MIN = 0.2, 3
"""Edge of the cubes in which returns count once, and how many cubes above one another are a wall."""
_NEAR_M, _OFF_MAX_M = 0.5, 0.06
"""How near a surface a return must be to be compared with it, and how far before or behind it may lie."""
_UPRIGHT_COS = 0.5


class Seen:
    """What was seen before, as one cloud. cloud_odom: in the odometry's frame. T_level_odom: (4, 4) to one whose z points up."""

    def __init__(self, cloud_odom: GaussianCloud, T_level_odom: FloatArray) -> None:
        self._points_odom, self._normals_odom = cloud_odom.points, cloud_odom.normals
        self._tree = cKDTree(self._points_odom)
        self._T_level_odom = T_level_odom

    def agreement(self, cloud: GaussianCloud, T_odom_sensor: FloatArray) -> float:
        """Share of a scan's returns from upright surfaces that lie on surfaces seen before, less the share beside such ones.

        Unlike the share that has a Gaussian, it does not depend on where the rings of either scan lie on a surface: they move
        with the lidar. Floor and ceiling agree everywhere.
        """
        points_odom = transforms.apply(T_odom_sensor, cloud.points)
        upright = np.abs(cloud.normals @ T_odom_sensor[:3, :3].T @ self._T_level_odom[2, :3]) < _UPRIGHT_COS
        if not upright.any():
            return 0.0
        distance_m, nearest = self._tree.query(points_odom[upright], distance_upper_bound=_NEAR_M)
        near = np.isfinite(distance_m)
        off = points_odom[upright][near] - self._points_odom[nearest[near]]
        off_m = np.abs(np.einsum("ij,ij->i", off, self._normals_odom[nearest[near]]))
        return float(np.where(off_m < _OFF_MAX_M, 1.0, -1.0).sum() / len(near))

    def likely_places(self, points_sensor: FloatArray, T_odom_last: FloatArray) -> list[FloatArray]:
        """Poses (4, 4) from which the sensor may see its points (n, 3), the likeliest first, as high and inclined as a last one."""
        T_level_last = self._T_level_odom @ T_odom_last
        inclined = transforms.make_transform(transforms.rotation_of(T_level_last))
        target = _walls(transforms.apply(self._T_level_odom, self._points_odom))
        source = _walls(transforms.apply(inclined, points_sensor))
        if not len(source) or not len(target):
            return []
        T_odom_level = transforms.invert(self._T_level_odom)
        places: list[FloatArray] = []
        for T_plane in likely_motions(source, target):
            yaw_rad = float(np.arctan2(T_plane[1, 0], T_plane[0, 0]))
            T_level_turned = transforms.from_yaw(yaw_rad, [*T_plane[:2, 2], T_level_last[2, 3]])
            places.append(T_odom_level @ T_level_turned @ inclined)
        return places


def _walls(points_level: FloatArray) -> FloatArray:
    """Middles (k, 2) of the columns in which points (n, 3) lie above one another."""
    cubes = np.unique(np.floor(points_level / _CUBE_M).astype(np.int64), axis=0)
    columns, count = np.unique(cubes[:, :2], axis=0, return_counts=True)
    return np.asarray((columns[count >= _UPRIGHT_MIN] + 0.5) * _CUBE_M)
