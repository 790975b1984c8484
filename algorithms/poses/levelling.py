"""Which way is up: the map levelled by its walls and its floor, each scan by its floor (paper, V: uneven floors).

Walls stand upright where floors slope, and a leaf's recess is but centimetres: a degree of lean hides it.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.poses.patches import Patches
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.rearrangement import RearrangementSettings
from ffmap.algorithms.scan.smoothing import SmoothedRanges

_FLOOR_WITHIN_M, _FLOOR_SLOPE_MAX_DEG, _FLOOR_PATCHES_MIN = 6.0, 15.0, 30


@dataclass(frozen=True)
class Level:
    """The map's frame as walls and floor give it.

    T_map_odom: (4, 4); the map's z is upright, its origin lies on the floor below the base at the first pose, its x runs
        along the base's forward.
    floor_rms_m: of the floor's points about its plane; NaN where no floor was found.
    floor_slope: (2,) metres up for each metre along the map's x and y.
    """

    T_map_odom: FloatArray
    floor_rms_m: float
    floor_slope: FloatArray


def level_map(points_odom: FloatArray, T_odom_base: FloatArray, seed: int = 0) -> Level:
    """The map's frame from the returns of the first sweeps.

    The floor is the largest plane below the base whose normal is within 15° of the base's z axis. What stands upright on
    it then tells how it slopes: up is the direction that the normals of walls are most nearly at right angles to.

    points_odom: (n, 3) in the odometry's frame. T_odom_base: (4, 4) the first pose.
    Without a floor the base's own z axis is up.
    """
    points_base = transforms.apply(transforms.invert(T_odom_base), points_odom)
    normal, offset, rms_m = _fit_floor(points_base, seed)
    z = _up_by_walls(points_base, normal)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    T_map_base0 = np.eye(4)
    T_map_base0[:3, :3] = np.stack([x, np.cross(z, x), z])
    # Below the base, along the upright, lies the floor.
    T_map_base0[2, 3] = -offset / float(normal @ z)
    floor_map = T_map_base0[:3, :3] @ normal
    return Level(T_map_base0 @ transforms.invert(T_odom_base), rms_m, -floor_map[:2] / floor_map[2])


def _up_by_walls(points: FloatArray, up: FloatArray) -> FloatArray:
    """The upright (3,) near a first guess: least squares of the walls' normals against it, held by the guess."""
    normals = Patches.of(points, cube_m=0.06, neighbours=30).normal
    z = up
    for limit_deg in (8.0, 4.0, 2.0):
        walls = normals[np.abs(normals @ z) < np.sin(np.radians(limit_deg))]
        if len(walls) < 200:
            return up
        # The floor's normal weighs little: it decides only the lean along a single direction of walls, which they leave open.
        spread = walls.T @ walls / len(walls) + 0.02 * (np.eye(3) - np.outer(up, up))
        z = np.linalg.eigh(spread)[1][:, 0]
        z = z if z @ up > 0 else -z
    return np.asarray(z)


@dataclass(frozen=True)
class LevelledScan:
    """A scan in its place in the map.

    placed: its smoothed returns. floor: below them, in the frame `level`. ranges: what smoothed them.
    """

    placed: PlacedScan
    floor: Floor
    ranges: SmoothedRanges


def place_and_level(
    scan: Scan,
    ranges: SmoothedRanges,
    trajectory: Trajectory,
    T_base_sensor: FloatArray,
    base_height_m: float,
    floor_slope: FloatArray,
    rearrangement: RearrangementSettings,
    max_deg: float,
) -> LevelledScan:
    """The scan's smoothed returns with every firing at its own pose, turned to the map's floor.

    T_base_sensor: (4, 4). base_height_m: how high the base stands above the floor. floor_slope: (2,) of the map's floor,
    metres up for each metre along x and y. max_deg: a floor that slopes more against the map's is a ramp.
    """
    placed = place_scan(ranges.of(scan), trajectory, T_base_sensor, base_height_m)
    x, y, level_m = placed.T_map_level[:3, 3]
    floor = find_floor(placed.points_level, rearrangement, float(floor_slope @ [x, y]) - level_m)
    wanted = floor_slope @ placed.T_map_level[:2, :2]
    if len(floor.pieces):
        # At a ramp's foot or top no one slope is the floor's.
        return LevelledScan(placed, floor, ranges)
    levelled = turn_to_floor(placed, floor.height_m, floor.slope, wanted, max_deg)
    return LevelledScan(levelled, floor if levelled is placed else replace(floor, slope=wanted), ranges)


def turn_to_floor(
    placed: PlacedScan, floor_height_m: float, floor_slope: FloatArray, wanted_slope: FloatArray, max_deg: float
) -> PlacedScan:
    """The scan turned about the floor below it so that its floor slopes as the map's does.

    A registration's roll and pitch err by some tenths of a degree, which at a ceiling's height is more than a leaf is
    recessed. A floor that slopes by more than `max_deg` against the map's is a ramp, and stays one.

    floor_height_m: of the floor at the level frame's origin; floor_slope: (2,) metres up for each metre along x and y, as
    the scan shows it; wanted_slope: (2,) as the map has it, both in the level frame.
    """
    own = np.array([-floor_slope[0], -floor_slope[1], 1.0]) / np.sqrt(1.0 + np.sum(floor_slope**2))
    wanted = np.array([-wanted_slope[0], -wanted_slope[1], 1.0]) / np.sqrt(1.0 + np.sum(wanted_slope**2))
    if own @ wanted < np.cos(np.radians(max_deg)):
        return placed
    turn, _ = Rotation.align_vectors(wanted, own)
    pivot = np.array([0.0, 0.0, floor_height_m])
    T = transforms.make_transform(turn, pivot - turn.apply(pivot))
    return replace(
        placed,
        points_level=_move(placed.points_level, T.astype(np.float32)),
        origin_level=transforms.apply(T, placed.origin_level[None])[0],
        T_map_base=placed.T_map_level @ T @ transforms.invert(placed.T_map_level) @ placed.T_map_base,
    )


@numba.njit(cache=True, nogil=True)
def _move(points: FloatArray, T: FloatArray) -> FloatArray:  # pragma: no cover
    moved = np.empty_like(points)
    for i in range(len(points)):
        for row in range(3):
            moved[i, row] = T[row, 0] * points[i, 0] + T[row, 1] * points[i, 1] + T[row, 2] * points[i, 2] + T[row, 3]
    return moved


def _fit_floor(points_base: FloatArray, seed: int) -> tuple[FloatArray, float, float]:
    """Unit normal, offset (normal · p = offset) and RMS of the floor under the base.

    Of level pieces of surfaces alone: where a sensor sees little floor, more returns of walls lie at any one height.
    """
    up = np.array([0.0, 0.0, 1.0])
    # Within 6 m a floor that slopes by 15° stays below a sensor's usual height; farther returns only blur it.
    near = points_base[np.hypot(points_base[:, 0], points_base[:, 1]) < _FLOOR_WITHIN_M]
    patches = Patches.of(near, cube_m=0.06, neighbours=30)
    level = patches.centre[np.abs(patches.normal[:, 2]) > np.cos(np.radians(_FLOOR_SLOPE_MAX_DEG))]
    if len(level) < _FLOOR_PATCHES_MIN:
        return up, 0.0, float("nan")
    generator = np.random.default_rng(seed)
    level = level[np.argsort(level[:, 2], kind="stable")]
    best_score, best = -np.inf, (up, float("nan"))
    for attempt in range(300):
        # Among the lowest half, quarter, ... to the 64th part: the floor may be the least of what is level.
        low = max(len(level) >> 1 + attempt % 6, 3)
        a, b, c = level[generator.choice(low, 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-2:
            continue
        normal /= length if normal[2] > 0 else -length
        if normal[2] < np.cos(np.radians(_FLOOR_SLOPE_MAX_DEG)):
            continue
        offset = float(normal @ a)
        # A table top or a ceiling has surfaces below it; the floor has none but reflections.
        below, above = _beside(patches.centre, normal, offset)
        score = np.count_nonzero(np.abs(level @ normal - offset) < 0.03) - 3.0 * below
        if below <= above and score > best_score:
            best_score, best = score, (normal, offset)
    normal, offset = best
    if not np.isfinite(offset):
        return up, 0.0, float("nan")
    for width_m in (0.06, 0.04, 0.03):
        inliers = level[np.abs(level @ normal - offset) < width_m]
        if len(inliers) < _FLOOR_PATCHES_MIN:
            return up, 0.0, float("nan")
        centre = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - centre, full_matrices=False)[2][2]
        normal = normal if normal[2] > 0 else -normal
        offset = float(normal @ centre)
    below, above = _beside(patches.centre, normal, offset)
    if below > above:
        # A slanting plane through the ceiling, where no floor is seen, has half of the ceiling above it.
        return up, 0.0, float("nan")
    residual = inliers @ normal - offset
    return normal, offset, float(np.sqrt(np.mean(residual**2)))


def _beside(points: FloatArray, normal: FloatArray, offset: float) -> tuple[int, int]:
    """How many points (n, 3) lie well below a plane, and how many well above it."""
    rise = points @ normal - offset
    return int(np.count_nonzero(rise < -0.1)), int(np.count_nonzero(rise > 0.1))
