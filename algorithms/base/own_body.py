"""The robot's own body as a lidar sees it: returns that stay in one place of the sensor's frame while all else moves by."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray

_VOXEL_M = 0.05
_REACH_M = 1.2
"""Distance from the lidar within which a robot's body ends. Rooms and corridors are larger: floor, walls and ceiling go on."""
_ALWAYS, _OFTEN = 0.9, 0.3
"""Share of the clouds in which a voxel returns: of the body, and of what may join it to the surroundings. The floor about a
robot returns ever less often the farther away it is; the body ends at once."""
_STILL = 0.3
"""Share of the far returns that lie in always the same voxels: 0 to 0.1 in a drive through rooms, 0.95 where a robot stands. At
0.6 (it drives less than a metre, or along a corridor) furniture beside it was taken for its body, at 0.5 none was."""
_FAR_M, _FAR_VOXEL_M = (2.4, 12.0), 0.25
_CLOUDS_MIN, _VOXELS_MIN = 8, 5
_LOWEST_PERCENT = 5.0
_FLOOR_M = 0.125
"""Height above the lowest level that goes on beyond the reach up to which a voxel may be the floor: noise, the voxels beside,
and 2 degrees of tilt over the reach."""


_HALF_M = 1.6
"""Half the edge of the cube about the sensor that is looked at: beyond the reach, to see what goes on there."""
_CELLS = round(2 * _HALF_M / _VOXEL_M)


@dataclass(frozen=True, eq=False)
class OwnBody:
    """Voxels of a sensor's frame that hold the robot itself.

    voxel: (v, 3) int16, from the corner at -1.6 m, with one more about what returned. share: of the lidar's returns.
    """

    voxel: IntArray
    share: float

    @property
    def points_sensor(self) -> FloatArray:
        """(v, 3) the voxels' centres."""
        return np.asarray((self.voxel + 0.5) * _VOXEL_M - _HALF_M)

    def holds(self, points_sensor: FloatArray) -> BoolArray:
        """(n,) which points (n, 3) lie on it."""
        inside = np.flatnonzero((np.abs(points_sensor) < _HALF_M).all(axis=1))
        held = np.zeros(len(points_sensor), bool)
        held[inside] = self._mask[tuple(_voxels(points_sensor[inside]).T)]
        return held

    @cached_property
    def _mask(self) -> BoolArray:
        return _grid(self.voxel)


def find_own_body(clouds: Sequence[FloatArray], T_base_sensor: FloatArray) -> OwnBody | None:
    """The robot's own body by some clouds (n, 3) of one lidar in its frame, spread over the drive; None where there is none.

    It is what returns in nearly all clouds of a robot that moves (see `moves`), and joins nothing that goes on beyond the
    reach of a body: so do the floor and the walls of a corridor, which may stay in one place of the robot too.
    T_base_sensor: (4, 4).
    """
    alone, share = np.zeros((2, *(_CELLS,) * 3), np.float32)
    for cloud in clouds:
        own = _grid(_voxels(cloud[(np.abs(cloud) < _HALF_M).all(axis=1)]))
        alone += own / np.float32(len(clouds))
        # A return on a voxel's edge falls on either side of it.
        share += ndimage.maximum_filter(own, 3) / np.float32(len(clouds))
    voxel = np.argwhere((alone > 0) & (share >= _OFTEN))
    # A stray return beside a surface that is always there is not always there itself.
    always = (share[tuple(voxel.T)] >= _ALWAYS) & (alone[tuple(voxel.T)] >= _OFTEN)
    place_sensor = OwnBody(voxel, 0.0).points_sensor
    place_base = transforms.apply(T_base_sensor, place_sensor)
    beyond = np.linalg.norm(place_sensor, axis=1) >= _REACH_M
    floor_m = np.percentile(place_base[beyond, 2], _LOWEST_PERCENT) if beyond.any() else -np.inf
    above = place_base[:, 2] > floor_m + _FLOOR_M
    joined, count = ndimage.label(_grid(voxel[above]), np.ones((3, 3, 3)))
    cluster = joined[tuple(voxel.T)]
    is_body = np.bincount(cluster[always], minlength=count + 1) >= _VOXELS_MIN
    is_body[np.append(cluster[beyond], 0)] = False
    body = is_body[cluster]
    # Its foot joins the floor, and is what always returns below it.
    column = np.floor(place_base[:, :2] / _VOXEL_M).astype(np.int64) @ [1 << 20, 1]
    foot = always & ~above & np.isin(column, column[body])
    own = ndimage.maximum_filter(_grid(voxel[body]), 3) | _grid(voxel[foot])
    found = OwnBody(np.argwhere(own).astype(np.int16), 0.0)
    held = sum(int(np.count_nonzero(found.holds(cloud))) for cloud in clouds) if body.any() else 0
    return replace(found, share=held / sum(map(len, clouds))) if held else None


def moves(clouds: Sequence[FloatArray]) -> bool:
    """Whether far returns of a lidar show that the robot moves: else all that is near stays in one place of it."""
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


def _grid(voxel: IntArray) -> BoolArray:
    grid = np.zeros((_CELLS,) * 3, bool)
    grid[tuple(voxel.T)] = True
    return grid


def _voxels(points: FloatArray) -> IntArray:
    return np.minimum(((points + _HALF_M) / _VOXEL_M).astype(np.int64), _CELLS - 1)
