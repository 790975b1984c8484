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
_SHARE_MIN = 0.05  # Of the denser surface: floors reach 0.06 to 0.4, along the heading 0.015 is the most
_DENSER = 3.0
_ROOM_MIN_M = 2.3  # Where one of the two is not seen, it is as far away as in the lowest room


@dataclass(frozen=True)
class Levels:
    """Surfaces on either side of a lidar that kept their distance along an axis.

    below_m, above_m: their distances. share: of a cloud's returns that are on the denser one.
    """

    below_m: float
    above_m: float
    share: float


def find_levels(clouds: Sequence[FloatArray], axis: FloatArray) -> Levels:
    """Find floor and ceiling along an axis (3,).

    clouds: points (n, 3) from the lidar's origin, in the axis' frame, from all over a drive.
    """
    edges = np.arange(-_REACH_M, _REACH_M + _BIN_M / 2, _BIN_M)
    height_m = (edges[1:] + edges[:-1]) / 2
    if len(clouds) < _CLOUDS_MIN:
        return Levels(np.inf, np.inf, 0.0)
    shares = []
    for points in clouds:
        far = np.einsum("ij,ij->i", points, points) > _OWN_M**2
        counts, _ = np.histogram(points[far] @ axis, edges)
        shares.append(np.convolve(counts, np.ones(3), "same") / len(points))
    # What moves along the axis is at any one place in few clouds.
    lasting = np.sort(shares, axis=0)[len(shares) // 4]
    # A floor ends the room: little is beyond it.
    padded = np.pad(lasting, 8)
    beyond = [padded[8 + k :][: len(lasting)] for k in range(-8, 9)]
    outside = np.where(height_m < 0, np.max(beyond[:5], axis=0), np.max(beyond[-5:], axis=0))
    surface = (lasting == maximum_filter1d(lasting, 7)) & (np.abs(height_m) >= _BESIDE_M)
    density = np.where(surface, lasting - outside, 0.0)
    at = [int(np.argmax(np.where(side, density, 0.0))) for side in (height_m < 0, height_m > 0)]
    below_m, above_m = (abs(float(height_m[k])) if density[k] >= _LEVEL_SHARE_MIN else np.inf for k in at)
    lowest = [max(_ROOM_MIN_M - other, _BESIDE_M) for other in (above_m, below_m)]
    below_m, above_m = (low if np.isinf(own) else own for own, low in zip((below_m, above_m), lowest, strict=True))
    return Levels(below_m, above_m, float(density[at].max()))


def upright_axis(levels: Sequence[Levels]) -> int | None:
    """Which of some axes is upright, by the levels along each; None where none shows it.

    The first is, unless no surface keeps its distance along it and along another one does.
    """
    densest = max(range(len(levels)), key=lambda k: levels[k].share)
    first = levels[0].share
    best = densest if first < min(_SHARE_MIN, levels[densest].share / _DENSER) else 0
    return best if levels[best].share >= _SHARE_MIN else None
