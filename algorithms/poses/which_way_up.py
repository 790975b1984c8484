"""Find which axis of a robot is upright, by the floor and the ceiling in its clouds.

Along the upright axis, and along no other while the robot turns, surfaces keep their distance from
the robot. The nearer one is the floor: lidars on wheels are below half a room's height.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from ffmap.algorithms.base.scan import FloatArray

_BIN_M, _REACH_M = 0.05, 10.0
_OWN_M = 0.7  # nearer returns may be the robot's own
_BESIDE_M = 0.2  # rings near the lidar's horizon keep their distance too
_CLOUDS_MIN = 5
_LEVEL_SHARE_MIN = 0.01  # of a cloud's returns on a surface
_SHARE_MIN = 0.05  # of the denser surface: floors have 0.06 to 0.4, surfaces ahead 0.015 at most
_DENSER = 3.0
_ROOM_MIN_M = 2.3  # height of the lowest room: where one of the two surfaces is not seen


@dataclass(frozen=True)
class Levels:
    """Surfaces on either side of a lidar that keep their distance along an axis.

    below_m, above_m: their distances. share: of a cloud's returns on the denser surface.
    """

    below_m: float
    above_m: float
    share: float


def find_levels(clouds: Sequence[FloatArray], axis: FloatArray) -> Levels:
    """Find floor and ceiling along an axis (3,).

    clouds: points (n, 3) from the lidar's origin, in the axis' frame, from all over a drive.
    """
    if len(clouds) < _CLOUDS_MIN:
        return Levels(np.inf, np.inf, 0.0)
    edges = np.arange(-_REACH_M, _REACH_M + _BIN_M / 2, _BIN_M)
    height_m = (edges[1:] + edges[:-1]) / 2
    shares = []
    for points in clouds:
        far = np.einsum("ij,ij->i", points, points) > _OWN_M**2
        counts, _ = np.histogram(points[far] @ axis, edges)
        shares.append(np.convolve(counts, np.ones(3), "same") / len(points))
    # A surface that moves along the axis is in any bin in few clouds only.
    lasting = np.sort(shares, axis=0)[len(shares) // 4]
    # A floor ends the room: few returns are beyond it.
    padded = np.pad(lasting, 8)
    beyond = [padded[8 + k :][: len(lasting)] for k in range(-8, 9)]
    outside = np.where(height_m < 0, np.max(beyond[:5], axis=0), np.max(beyond[-5:], axis=0))
    surface = (lasting == maximum_filter1d(lasting, 7)) & (np.abs(height_m) >= _BESIDE_M)
    density = np.where(surface, lasting - outside, 0.0)
    low, high = (int(np.argmax(density * side)) for side in (height_m < 0, height_m > 0))
    below_m, above_m = (
        abs(float(height_m[k])) if density[k] >= _LEVEL_SHARE_MIN else np.inf for k in (low, high)
    )
    return Levels(
        below_m=max(_ROOM_MIN_M - above_m, _BESIDE_M) if np.isinf(below_m) else below_m,
        above_m=max(_ROOM_MIN_M - below_m, _BESIDE_M) if np.isinf(above_m) else above_m,
        share=float(max(density[low], density[high])),
    )


def upright_axis(levels: Sequence[Levels]) -> int | None:
    """The index of the upright axis by the levels along each axis; None where unknown.

    The first axis, unless no surface keeps its distance along it, but along another axis.
    """
    densest = max(range(len(levels)), key=lambda k: levels[k].share)
    first = levels[0].share
    best = densest if first < min(_SHARE_MIN, levels[densest].share / _DENSER) else 0
    return best if levels[best].share >= _SHARE_MIN else None
