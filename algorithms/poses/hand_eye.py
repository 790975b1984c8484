"""Find a second lidar's extrinsics without a first guess, to start a calibration from.

Whatever the robot does, the rotations of one lidar, transformed by the extrinsics, are those of
the other (hand-eye calibration, Tsai and Lenz 1989). A robot on a floor rotates about one axis
only, which determines the lidar's upward direction, but neither its heading nor its position (Heng,
Li and Pollefeys 2013). Both are searched: most of the lidar's returns, along the whole drive, must
fall into voxels that the other lidar saw occupied.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory

_STEP_S, _SPAN_S = 0.2, 2.0
"""Interval and duration of the motions whose rotations are compared."""
_TURNED_MIN_DEG = 30.0
"""Minimum rotation of a drive that determines anything."""
_VOXEL_M, _HEADING_DEG = 0.2, 4.0
"""Resolution of positions and headings; a second round halves both."""
_REACH_M = (1.2, 1.2, 1.4)
"""Maximum distance of the lidar from the base's origin, along its axes."""
_RETURNS = 3000
_MARGIN_VOXELS = 3
_OTHER_DEG = 20.0
"""Minimum difference of the heading of a rival solution."""


@dataclass(frozen=True)
class HandEyeExtrinsics:
    """Extrinsics to within some degrees and centimetres.

    T_base_sensor: (4, 4). hits: share of the returns in voxels that the other lidar saw occupied.
    rival_hits, rival_deg: the same of the best solution with another heading, and the difference
    in heading; near `hits` where the drive is ambiguous.
    """

    T_base_sensor: FloatArray
    hits: float
    rival_hits: float
    rival_deg: float


def align_rotations(base: Trajectory, sensor: Trajectory) -> tuple[FloatArray, FloatArray] | None:
    """Rotate the sensor's rotation vectors onto the base's (Kabsch 1976).

    base: T_odom_base by the one lidar. sensor: T_odom_sensor by the other lidar alone.
    Returns the rotation (3, 3) and the main axis (3,) of rotation in the base, about which the
    rotation is undetermined. None where the robot rotated by less than 30°.
    """
    first = max(base.stamp_ns[0], sensor.stamp_ns[0])
    last = min(base.stamp_ns[-1], sensor.stamp_ns[-1])
    times = np.arange(first, last - round(1e9 * _SPAN_S), round(1e9 * _STEP_S))
    if len(times) == 0:
        return None
    turns = []
    for trajectory in (base, sensor):
        T_after = trajectory.at(times + round(1e9 * _SPAN_S))
        T = transforms.invert(trajectory.at(times)) @ T_after
        turns.append(Rotation.from_matrix(T[:, :3, :3]).as_rotvec())
    turned_rad = np.linalg.norm(turns[0], axis=1).sum() * _STEP_S / _SPAN_S
    if np.degrees(turned_rad) < _TURNED_MIN_DEG:
        return None
    U, _, Vt = np.linalg.svd(turns[0].T @ turns[1])
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, U[:, 0]


def find_extrinsics(
    seen: FloatArray,
    base: Trajectory,
    scans: Sequence[Scan],
    rotation: FloatArray,
    axis: FloatArray,
) -> HandEyeExtrinsics | None:
    """Search the heading and position with most returns in voxels that the other lidar saw.

    seen: (n, 3) the other lidar's returns, in the frame of the base's poses. scans: of the lidar,
    spread over the drive. rotation (3, 3), axis (3,): see `align_rotations`. None where either
    lidar saw nothing.
    """
    points, scan = _thinned(scans)
    if len(points) == 0 or len(seen) == 0:
        return None
    middle_ns = np.array([s.reference_ns for s in scans], np.int64)
    T = base.at(np.clip(middle_ns, base.stamp_ns[0], base.stamp_ns[-1]))
    turned = points @ rotation.T

    R_map_base, t_map_base = T[:, :3, :3], T[:, None, :3, 3]

    def count_hits(voxel_m: float, headings_deg: FloatArray, shifts: FloatArray) -> IntArray:
        grid, origin = _occupied(seen, voxel_m)
        R = Rotation.from_rotvec(np.radians(headings_deg)[:, None] * axis).as_matrix()
        rays = np.einsum("nij,kjl,nl->kni", R_map_base[scan], R, turned, optimize=True)
        origins = shifts @ np.swapaxes(R_map_base, 1, 2) + t_map_base - origin
        return np.asarray(_hits(rays / voxel_m, scan, origins / voxel_m, grid))

    headings = np.arange(0.0, 360.0, _HEADING_DEG)
    shifts = _positions(np.zeros(3), _REACH_M, _VOXEL_M)
    hits = count_hits(_VOXEL_M, headings, shifts)
    h, s = np.unravel_index(int(hits.argmax()), hits.shape)
    away_deg = np.abs((headings - headings[h] + 180.0) % 360.0 - 180.0)
    others = np.where(away_deg > _OTHER_DEG, hits.max(axis=1), 0)
    rival = int(others.argmax())
    near = headings[h] + 0.5 * _HEADING_DEG * np.arange(-2, 3)
    close = _positions(shifts[s], (_VOXEL_M,) * 3, 0.5 * _VOXEL_M)
    close_hits = count_hits(0.5 * _VOXEL_M, near, close)
    i, j = np.unravel_index(int(close_hits.argmax()), close_hits.shape)
    R = Rotation.from_rotvec(np.radians(near[i]) * axis).as_matrix() @ rotation
    return HandEyeExtrinsics(
        T_base_sensor=transforms.make_transform(Rotation.from_matrix(R), close[j]),
        hits=hits[h, s] / len(points),
        rival_hits=others[rival] / len(points),
        rival_deg=float(away_deg[rival]),
    )


def _thinned(scans: Sequence[Scan]) -> tuple[FloatArray, IntArray]:
    """Returns (n, 3), at most one in a voxel of each scan, and the number (n,) of the scan.

    Near surfaces would outvote far ones.
    """
    points: list[FloatArray] = [np.zeros((0, 3))]
    numbers: list[IntArray] = [np.zeros(0, np.int64)]
    for number, scan in enumerate(scans):
        voxel = np.floor(scan.points_sensor / _VOXEL_M).astype(np.int64)
        first = np.unique(voxel, axis=0, return_index=True)[1]
        chosen = first[:: max(1, len(first) * len(scans) // _RETURNS)]
        points.append(scan.points_sensor[chosen].astype(np.float64))
        numbers.append(np.full(len(chosen), number))
    return np.concatenate(points), np.concatenate(numbers)


def _positions(centre: FloatArray, reach_m: tuple[float, ...], step_m: float) -> FloatArray:
    """(n, 3) a grid of positions around a centre (3,)."""
    reach = [round(m / step_m) for m in reach_m]
    axes = [np.arange(-steps, steps + 1) * step_m for steps in reach]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(centre + grid.reshape(-1, 3))


def _occupied(points: FloatArray, voxel_m: float) -> tuple[BoolArray, FloatArray]:
    """The occupied voxels, with a margin of empty ones, and the corner (3,) of the first voxel."""
    origin = np.floor(points.min(axis=0) / voxel_m - _MARGIN_VOXELS) * voxel_m
    voxel = np.floor((points - origin) / voxel_m).astype(np.int64)
    grid = np.zeros(voxel.max(axis=0) + 1 + _MARGIN_VOXELS, bool)
    grid[tuple(voxel.T)] = True
    return grid, origin


@numba.njit(cache=True, nogil=True)
def _hits(rays: FloatArray, scan: IntArray, origins: FloatArray, grid: BoolArray) -> IntArray:
    """(headings, shifts) number of returns in occupied voxels.

    rays: (headings, n, 3) from the lidar to its returns, in the map; scan: (n,) the scan of each.
    origins: (scans, shifts, 3) the lidar's positions from the grid's corner; all in voxels.
    """
    hits = np.zeros((len(rays), origins.shape[1]), np.int64)
    for k in range(len(rays)):
        for n in range(len(scan)):
            x, y, z = rays[k, n]
            for m in range(origins.shape[1]):
                a = int(np.floor(x + origins[scan[n], m, 0]))
                b = int(np.floor(y + origins[scan[n], m, 1]))
                c = int(np.floor(z + origins[scan[n], m, 2]))
                inside = 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1]
                if inside and 0 <= c < grid.shape[2] and grid[a, b, c]:
                    hits[k, m] += 1
    return hits
