"""Which side of a robot is up, by the floor and the ceiling in its clouds.

Along the upright axis, and along no other while the robot turns, surfaces keep their distance from the robot. The nearer
one is the floor: a robot on wheels carries its lidars below half a room's height.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from ffmap.algorithms.base.scan import FloatArray

_BIN_M, _REACH_M = 0.05, 10.0
_OWN_M = 0.7  # Nearer returns may be the robot's own
_BESIDE_M = 0.2  # Rings about a lidar's own horizon keep their distance too
_CLOUDS_MIN = 5
_LEVEL_SHARE_MIN = 0.01  # Of a cloud's returns; less is no surface
_SHARE_MIN = 0.05  # Minimum of the denser level; floors reach 0.06 to 0.4, along the heading 0.015 is the most
_DENSER = 3.0
_BASE_MAX_M = 0.35  # Height of a base's origin: on the floor, or at the axles
_ROOM_MIN_M = 2.3  # Where one of the two is not seen, it is as far away as in the lowest room


@dataclass(frozen=True, eq=False)
class LidarView:
    """What a lidar saw during a drive. clouds: points (n, 3) each, from the lidar, in the base's axes. position: (3,) of
    the lidar in the base.
    """

    clouds: Sequence[FloatArray]
    position: FloatArray


@dataclass(frozen=True)
class Levels:
    """Surfaces on either side of a lidar that kept their distance along an axis.

    below_m, above_m: their distances. share: of a cloud's returns that are on the denser one.
    lidar: place of the lidar among those given. base_m: where along the axis the base's origin is, from the lidar.
    """

    below_m: float
    above_m: float
    share: float
    lidar: int
    base_m: float

    @property
    def overturned(self) -> float:
        """How many times nearer than the surface below the one above is: more than 1 where up is down.

        0 where the base's origin is near the surface below, for a mast carries the lidar.
        """
        on_mast = abs(self.below_m + self.base_m) < _BASE_MAX_M
        return 0.0 if on_mast else self.below_m / self.above_m


def find_levels(lidars: Sequence[LidarView], axes: FloatArray) -> tuple[int, Levels] | None:
    """The first of some axes (k, 3) in the base that is upright, and the levels along it; None where no clouds show it.

    The first axis is kept unless no surface keeps its distance along it, and along another one does.
    """
    found = [
        max((_levels(lidar, place, axis) for place, lidar in enumerate(lidars)), key=lambda levels: levels.share)
        for axis in axes
    ]
    densest = max(range(len(found)), key=lambda k: found[k].share)
    best = densest if found[densest].share > _DENSER * found[0].share and found[0].share < _SHARE_MIN else 0
    return (best, found[best]) if found[best].share >= _SHARE_MIN else None


def _levels(lidar: LidarView, place: int, axis: FloatArray) -> Levels:
    edges = np.arange(-_REACH_M, _REACH_M + _BIN_M / 2, _BIN_M)
    height_m = (edges[1:] + edges[:-1]) / 2
    if len(lidar.clouds) < _CLOUDS_MIN:
        return Levels(np.inf, np.inf, 0.0, place, 0.0)
    shares = []
    for points in lidar.clouds:
        far = np.einsum("ij,ij->i", points, points) > _OWN_M**2
        counts, _ = np.histogram(points[far] @ axis, edges)
        shares.append(np.convolve(counts, np.ones(3), "same") / max(len(points), 1))
    # What moves along the axis is at any one place in few clouds.
    lasting = np.sort(shares, axis=0)[len(shares) // 4]
    # A floor ends the room: little is beyond it.
    padded = np.pad(lasting, 8)
    size = len(lasting)
    down = np.max([padded[8 - k : 8 - k + size] for k in range(4, 9)], axis=0)
    up = np.max([padded[8 + k : 8 + k + size] for k in range(4, 9)], axis=0)
    edge = lasting - np.where(height_m < 0, down, up)
    edge[(lasting < maximum_filter1d(lasting, 7)) | (np.abs(height_m) < _BESIDE_M)] = 0.0
    sides = [np.where(side, edge, 0.0) for side in (height_m < 0, height_m > 0)]
    peaks = [float(side.max()) for side in sides]
    below_m, above_m = (
        abs(float(height_m[side.argmax()])) if peak >= _LEVEL_SHARE_MIN else np.inf
        for side, peak in zip(sides, peaks, strict=True)
    )
    below_m, above_m = (
        (max(_ROOM_MIN_M - other, _BESIDE_M) if np.isinf(own) else own)
        for own, other in ((below_m, above_m), (above_m, below_m))
    )
    return Levels(below_m, above_m, max(peaks), place, -float(lidar.position @ axis))
