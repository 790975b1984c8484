"""The robot's own body in a lidar's clouds: returns that never move in the sensor's frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

_VOXEL_M = 0.05
_HALF_M = 1.6
"""Half the edge of the cube about the sensor that is searched: beyond the reach of a body."""
_CELLS = round(2 * _HALF_M / _VOXEL_M)
_REACH_M = 1.2
"""Maximum distance of a robot's body. Floor, walls and ceiling extend beyond it."""
_ALWAYS, _OFTEN = 0.9, 0.3
"""Minimum share of the clouds in which a voxel returns: of the body, and of what may join it to the
surroundings. The floor about a robot returns ever less with distance; the body ends abruptly."""
_VOXELS_MIN = 5
"""Minimum number of voxels of a body that return always."""
_LOWEST_PERCENT, _FLOOR_M = 5.0, 0.125
"""The floor's height is this percentile of the voxels beyond the reach; voxels up to `_FLOOR_M`
above may belong to it: noise, the neighbouring voxels, and 2° of tilt over the reach."""
_STILL = 0.3
"""Maximum share of the far returns in voxels that always return. A drive through rooms has 0 to
0.1, a robot at rest 0.95. At 0.6 (less than a metre driven, or along a corridor) furniture beside
the robot was taken for its body, at 0.5 none was."""
_FAR_M, _FAR_VOXEL_M = (2.4, 12.0), 0.25
_CLOUDS_MIN = 8


@dataclass(frozen=True, eq=False)
class OwnBody:
    """Voxels of a sensor's frame that hold the robot itself.

    voxel: (v, 3) int16, from the corner at -1.6 m, dilated by one. share: of the lidar's returns.
    """

    voxel: IntArray
    share: float

    @property
    def points_sensor(self) -> FloatArray:
        """(v, 3) the voxels' centres."""
        return np.asarray((self.voxel + 0.5) * _VOXEL_M - _HALF_M)

    def holds(self, points_sensor: FloatArray) -> BoolArray:
        """(n,) which points (n, 3) are in these voxels."""
        inside = np.flatnonzero(_in_cube(points_sensor))
        held = np.zeros(len(points_sensor), bool)
        held[inside] = self._grid[tuple(_voxels(points_sensor[inside]).T)]
        return held

    @cached_property
    def _grid(self) -> BoolArray:
        return _grid(self.voxel)


def find_own_body(clouds: Sequence[FloatArray], T_base_sensor: FloatArray) -> OwnBody | None:
    """Find voxels near the lidar that return in nearly all clouds of a robot that moves.

    The body is connected, and not with anything beyond the reach of a body: floor and the walls of
    a corridor may be in the same place of the sensor's frame too, but extend further.

    clouds: (n, 3) in the sensor's frame, spread over a drive for which `moves` holds.
    """
    alone, share = np.zeros((2, *(_CELLS,) * 3), np.float32)
    for cloud in clouds:
        occupied = _grid(_voxels(cloud[_in_cube(cloud)]))
        alone += occupied / np.float32(len(clouds))
        # A return at a voxel's border falls on either side of it.
        share += ndimage.maximum_filter(occupied, 3) / np.float32(len(clouds))
    voxel = np.argwhere((alone > 0) & (share >= _OFTEN))
    # A stray return beside a surface that always returns does not always return itself.
    always = (share[tuple(voxel.T)] >= _ALWAYS) & (alone[tuple(voxel.T)] >= _OFTEN)
    centre_sensor = OwnBody(voxel, 0.0).points_sensor
    centre_base = transforms.apply(T_base_sensor, centre_sensor)
    beyond = np.linalg.norm(centre_sensor, axis=1) >= _REACH_M
    heights_m = centre_base[beyond, 2]
    floor_m = np.percentile(heights_m, _LOWEST_PERCENT) if beyond.any() else -np.inf
    above = centre_base[:, 2] > floor_m + _FLOOR_M
    connected, count = ndimage.label(_grid(voxel[above]), np.ones((3, 3, 3)))
    component = connected[tuple(voxel.T)]
    is_body = np.bincount(component[always], minlength=count + 1) >= _VOXELS_MIN
    is_body[np.append(component[beyond], 0)] = False
    body = is_body[component]
    # The foot of the body touches the floor: what always returns below the body.
    column = np.floor(centre_base[:, :2] / _VOXEL_M).astype(np.int64) @ [1 << 20, 1]
    foot = always & ~above & np.isin(column, column[body])
    own = ndimage.maximum_filter(_grid(voxel[body]), 3) | _grid(voxel[foot])
    found = OwnBody(np.argwhere(own).astype(np.int16), 0.0)
    held = sum(int(np.count_nonzero(found.holds(cloud))) for cloud in clouds) if body.any() else 0
    return replace(found, share=held / sum(map(len, clouds))) if held else None


def moves(clouds: Sequence[FloatArray]) -> bool:
    """Whether far returns (n, 3) move in the sensor's frame, so that those that do not are own."""
    if len(clouds) < _CLOUDS_MIN:
        return False
    keys = []
    for cloud in clouds:
        distance_m = np.linalg.norm(cloud, axis=1)
        far = cloud[(distance_m > _FAR_M[0]) & (distance_m < _FAR_M[1])]
        keys.append(np.floor(far / _FAR_VOXEL_M).astype(np.int64) @ [1 << 20, 1 << 10, 1])
    voxels, times = np.unique(np.concatenate([np.unique(own) for own in keys]), return_counts=True)
    every = np.concatenate(keys)
    always = times[np.searchsorted(voxels, every)] >= _ALWAYS * len(clouds)
    return len(every) > 0 and float(always.mean()) < _STILL


def _in_cube(points_sensor: FloatArray) -> BoolArray:
    """(n,) which points (n, 3) are in the cube that is searched."""
    x, y, z = np.abs(points_sensor.T)
    return np.asarray((x < _HALF_M) & (y < _HALF_M) & (z < _HALF_M))


def _grid(voxel: IntArray) -> BoolArray:
    grid = np.zeros((_CELLS,) * 3, bool)
    grid[tuple(voxel.T)] = True
    return grid


def _voxels(points: FloatArray) -> IntArray:
    return np.minimum(((points + _HALF_M) / _VOXEL_M).astype(np.int64), _CELLS - 1)
