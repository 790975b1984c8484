"""Level the map by its walls and floor, and each scan by its floor (paper, V: uneven floors).

Walls are upright where floors slope, and a door leaf is recessed by centimetres only: a degree of
inclination hides it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.poses.patches import Patches
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.rearrangement import RearrangementSettings
from ffmap.algorithms.scan.smoothing import SmoothedRanges

_PATCH_VOXEL_M, _PATCH_NEIGHBOURS = 0.06, 30
_FLOOR_WITHIN_M = 6.0
"""Within it, a floor that slopes by 15° is below a sensor's usual height; farther returns blur."""
_FLOOR_SLOPE_MAX_DEG = 15.0
_FLOOR_PATCHES_MIN = 30
_WALL_PATCHES_MIN = 200
_WALL_LEANS_DEG = (8.0, 4.0, 2.0)
"""Maximum inclination of walls against the upright axis, from one estimate to the next."""
_TURN_MAX_DEG = 1.0
"""Maximum angle by which a scan is turned to give its floor the slope of the map's: a floor at a
larger angle is a ramp."""
_FLOOR_WEIGHT = 0.02
"""Of the floor's normal: it decides only the inclination along walls that are all parallel."""


@dataclass(frozen=True)
class Level:
    """The map's frame by walls and floor.

    T_map_odom: (4, 4). The map's z axis is upright, its origin on the floor below the base at the
        first pose, its x axis along the base's heading.
    floor_rms_m: of the floor's points about its plane; NaN where no floor was found.
    floor_slope: (2,) metres up for each metre along the map's x and y.
    """

    T_map_odom: FloatArray
    floor_rms_m: float
    floor_slope: FloatArray


def level_map(points_odom: FloatArray, T_odom_base: FloatArray, seed: int = 0) -> Level:
    """Find the map's frame by the returns of the first sweeps.

    The floor is the largest plane below the base within 15° of horizontal. The upright axis is the
    direction most nearly orthogonal to the normals of the walls on it. Without a floor, it is the
    base's own z axis.

    points_odom: (n, 3) in the odometry's frame. T_odom_base: (4, 4) the first pose.
    """
    points_base = transforms.apply(transforms.invert(T_odom_base), points_odom)
    normal, offset, rms_m = _fit_floor(points_base, seed)
    z = _upright_by_walls(points_base, normal)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    T_map_base0 = np.eye(4)
    T_map_base0[:3, :3] = np.stack([x, np.cross(z, x), z])
    T_map_base0[2, 3] = -offset / float(normal @ z)
    floor_map = T_map_base0[:3, :3] @ normal
    slope = -floor_map[:2] / floor_map[2]
    return Level(T_map_base0 @ transforms.invert(T_odom_base), rms_m, slope)


def _upright_by_walls(points: FloatArray, up: FloatArray) -> FloatArray:
    """Minimize the squared cosines between the axis (3,) and the walls' normals, near a guess."""
    normals = Patches.of(points, _PATCH_VOXEL_M, _PATCH_NEIGHBOURS).normal
    z = up
    for lean_deg in _WALL_LEANS_DEG:
        walls = normals[np.abs(normals @ z) < np.sin(np.radians(lean_deg))]
        if len(walls) < _WALL_PATCHES_MIN:
            return up
        held = _FLOOR_WEIGHT * (np.eye(3) - np.outer(up, up))
        z = np.linalg.eigh(walls.T @ walls / len(walls) + held)[1][:, 0]
        z = z if z @ up > 0 else -z
    return np.asarray(z)


def _fit_floor(points_base: FloatArray, seed: int) -> tuple[FloatArray, float, float]:
    """Unit normal n, offset (n · p = offset) and RMS of the floor below the base, by RANSAC.

    Only level patches count: a sensor that sees little floor has more returns of walls at any one
    height.
    """
    no_floor = np.array([0.0, 0.0, 1.0]), 0.0, float("nan")
    upright_min = np.cos(np.radians(_FLOOR_SLOPE_MAX_DEG))
    near = points_base[np.hypot(points_base[:, 0], points_base[:, 1]) < _FLOOR_WITHIN_M]
    patches = Patches.of(near, _PATCH_VOXEL_M, _PATCH_NEIGHBOURS)
    level = patches.centre[np.abs(patches.normal[:, 2]) > upright_min]
    if len(level) < _FLOOR_PATCHES_MIN:
        return no_floor
    generator = np.random.default_rng(seed)
    level = level[np.argsort(level[:, 2], kind="stable")]
    best_score, best = -np.inf, None
    for attempt in range(300):
        # Among the lowest half, quarter, ... 64th: the floor may be the smallest level surface.
        low = max(len(level) >> 1 + attempt % 6, 3)
        a, b, c = level[generator.choice(low, 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-2:
            continue
        normal /= length if normal[2] > 0 else -length
        if normal[2] < upright_min:
            continue
        offset = float(normal @ a)
        # Below a table top or a ceiling there are surfaces; below the floor only reflections.
        below, above = _count_beside(patches.centre, normal, offset)
        score = np.count_nonzero(np.abs(level @ normal - offset) < 0.03) - 3.0 * below
        if below <= above and score > best_score:
            best_score, best = score, (normal, offset)
    if best is None:
        return no_floor
    normal, offset = best
    for width_m in (0.06, 0.04, 0.03):
        inliers = level[np.abs(level @ normal - offset) < width_m]
        if len(inliers) < _FLOOR_PATCHES_MIN:
            return no_floor
        centre = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - centre, full_matrices=False)[2][2]
        normal = normal if normal[2] > 0 else -normal
        offset = float(normal @ centre)
    below, above = _count_beside(patches.centre, normal, offset)
    if below > above:
        # Without a floor in view: a slanting plane through the ceiling, half above it.
        return no_floor
    residual_m = inliers @ normal - offset
    return normal, offset, float(np.sqrt(np.mean(residual_m**2)))


def _count_beside(points: FloatArray, normal: FloatArray, offset: float) -> tuple[int, int]:
    """How many points (n, 3) are more than 0.1 m below a plane, and how many above it."""
    rise_m = points @ normal - offset
    return int(np.count_nonzero(rise_m < -0.1)), int(np.count_nonzero(rise_m > 0.1))


@dataclass(frozen=True)
class LevelledScan:
    """A scan in the map.

    placed: its smoothed returns. floor: below them, in the frame `level`. ranges: the smoothing.
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
) -> LevelledScan:
    """Put every smoothed return at its firing's pose, and level the scan by the map's floor.

    T_base_sensor: (4, 4). base_height_m: height of the base above the floor. floor_slope: (2,) of
    the map's floor, see `Level`.
    """
    placed = place_scan(ranges.of(scan), trajectory, T_base_sensor, base_height_m)
    x, y, level_m = placed.T_map_level[:3, 3]
    floor = find_floor(placed.points_level, rearrangement, float(floor_slope @ [x, y]) - level_m)
    wanted = floor_slope @ placed.T_map_level[:2, :2]
    if len(floor.pieces):
        # At the foot or top of a ramp, the floor has no single slope.
        return LevelledScan(placed, floor, ranges)
    levelled = turn_to_floor(placed, floor.height_m, floor.slope, wanted)
    if levelled is not placed:
        floor = replace(floor, slope=wanted)
    return LevelledScan(levelled, floor, ranges)


def turn_to_floor(
    placed: PlacedScan,
    floor_height_m: float,
    floor_slope: FloatArray,
    wanted_slope: FloatArray,
) -> PlacedScan:
    """Turn a scan about the floor below it until its floor slopes as the map's does.

    A registration's roll and pitch err by some tenths of a degree, which at a ceiling's height is
    more than a door leaf is recessed.

    floor_height_m: at the level frame's origin. floor_slope, wanted_slope: (2,) of the scan's floor
    and the map's in the level frame, metres up for each metre along x and y.
    """
    own = np.array([*-floor_slope, 1.0]) / np.sqrt(1.0 + np.sum(floor_slope**2))
    wanted = np.array([*-wanted_slope, 1.0]) / np.sqrt(1.0 + np.sum(wanted_slope**2))
    if own @ wanted < np.cos(np.radians(_TURN_MAX_DEG)):
        return placed
    turn, _ = Rotation.align_vectors(wanted, own)
    pivot = np.array([0.0, 0.0, floor_height_m])
    T = transforms.make_transform(turn, pivot - turn.apply(pivot))
    x, y, z = placed.points_level.T
    moved = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in T[:3].astype(np.float32)]
    T_map_tilted = placed.T_map_level @ T @ transforms.invert(placed.T_map_level)
    return replace(
        placed,
        points_level=np.stack(moved, axis=1),
        origin_level=transforms.apply(T, placed.origin_level[None])[0],
        T_map_base=T_map_tilted @ placed.T_map_base,
    )
