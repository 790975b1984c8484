"""Where a second lidar sits, from nothing but how both move and what both see: the start of a calibration.

However the robot moves, the turns of one lidar, carried through the mount, are those of the other (hand-eye calibration, Tsai and
Lenz 1989). A robot on a floor turns about one axis alone: that tells which way the lidar is up, but neither its heading nor where
it sits (Heng, Li and Pollefeys 2013 lack its height alone; in a corridor a lidar that lies sees hardly how far it drives). The
rest is searched for: the heading and the place at which most of its returns, along the whole drive, lie where the other lidar's do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory

_STEP_S = 0.2
_SPAN_S = 2.0
"""Duration of the motions whose turns are compared, one each step."""
_TURNED_MIN_DEG = 30.0
_CELL_M, _HEADING_DEG = 0.2, 4.0
"""Edge of the cubes in which returns of both lidars meet, and between headings; half of them in a second round."""
_REACH_M = (1.2, 1.2, 1.4)
"""Maximum distance of the lidar from the base's origin along its axes."""
_RETURNS = 3000
_MARGIN_CELLS = 3
_OTHER_DEG = 20.0
"""Angle from the best heading beyond which another one is another mount."""


@dataclass(frozen=True)
class HandEyeExtrinsics:
    """Where a lidar sits, to some degrees and centimetres.

    T_base_sensor: (4, 4). hits: share of its returns that lie where the other lidar's do. rival_hits: the same of the best mount
    with another heading; near `hits` where the drive does not tell them apart. rival_deg: its heading from the one found.
    """

    T_base_sensor: FloatArray
    hits: float
    rival_hits: float
    rival_deg: float


def align_rotations(base: Trajectory, sensor: Trajectory) -> tuple[FloatArray, FloatArray] | None:
    """A rotation (3, 3) that carries the sensor's turns into the base's, and the axis (3,) in the base about which most are.

    About that axis the rotation may be any. None where the robot turned by less than 30 degrees.

    base: T_odom_base by the one lidar. sensor: T_odom_sensor by the other lidar alone.
    """
    first, last = max(base.stamp_ns[0], sensor.stamp_ns[0]), min(base.stamp_ns[-1], sensor.stamp_ns[-1])
    times = np.arange(first, last - round(1e9 * _SPAN_S), round(1e9 * _STEP_S))
    if len(times) == 0:
        return None
    turns = []
    for trajectory in (base, sensor):
        T = transforms.invert(trajectory.at(times)) @ trajectory.at(times + round(1e9 * _SPAN_S))
        turns.append(Rotation.from_matrix(T[:, :3, :3]).as_rotvec())
    turned_deg = float(np.degrees(np.linalg.norm(turns[0], axis=1).sum() * _STEP_S / _SPAN_S))
    if turned_deg < _TURNED_MIN_DEG:
        return None
    U, _, Vt = np.linalg.svd(turns[0].T @ turns[1])
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt, U[:, 0]


def find_extrinsics(
    seen: FloatArray, base: Trajectory, scans: Sequence[Scan], rotation: FloatArray, axis: FloatArray
) -> HandEyeExtrinsics | None:
    """The heading about an axis and the place at which most returns of the scans lie where the other lidar's do.

    seen: (n, 3) the other lidar's returns, in the frame of the base's poses. scans: of the lidar that is looked for, spread over
    the drive. rotation (3, 3), axis (3,): as of `align_rotations`. None where either lidar saw nothing.
    """
    points, scan = _thinned(scans)
    if len(points) == 0 or len(seen) == 0:
        return None
    middle_ns = np.array([(s.start_ns + s.end_ns) // 2 for s in scans], np.int64)
    T = base.at(np.clip(middle_ns, base.stamp_ns[0], base.stamp_ns[-1]))
    turned = points @ rotation.T

    def hits_of(cell_m: float, headings_deg: FloatArray, shifts: FloatArray) -> IntArray:
        grid, origin = _occupied(seen, cell_m)
        R = Rotation.from_rotvec(np.radians(headings_deg)[:, None] * axis).as_matrix()
        return np.asarray(_hits(turned, scan, T, R, shifts, grid, origin, cell_m))

    headings = np.arange(0.0, 360.0, _HEADING_DEG)
    shifts = _around(np.zeros(3), _REACH_M, _CELL_M)
    hits = hits_of(_CELL_M, headings, shifts)
    h, s = np.unravel_index(int(hits.argmax()), hits.shape)
    away_deg = np.abs((headings - headings[h] + 180.0) % 360.0 - 180.0)
    others = np.where(away_deg > _OTHER_DEG, hits.max(axis=1), 0)
    near = headings[h] + 0.5 * _HEADING_DEG * np.arange(-2, 3)
    close = _around(shifts[s], (_CELL_M,) * 3, 0.5 * _CELL_M)
    close_hits = hits_of(0.5 * _CELL_M, near, close)
    i, j = np.unravel_index(int(close_hits.argmax()), close_hits.shape)
    R = Rotation.from_rotvec(np.radians(near[i]) * axis).as_matrix() @ rotation
    rival = int(others.argmax())
    shares = hits[h, s] / len(points), others[rival] / len(points)
    return HandEyeExtrinsics(transforms.make_transform(Rotation.from_matrix(R), close[j]), *shares, float(away_deg[rival]))


def _thinned(scans: Sequence[Scan]) -> tuple[FloatArray, IntArray]:
    """(n, 3) returns of the scans, at most one of a cube of each, and the number (n,) of the scan that each is of.

    What is near would outvote what is far.
    """
    points: list[FloatArray] = [np.zeros((0, 3))]
    numbers: list[IntArray] = [np.zeros(0, np.int64)]
    for number, scan in enumerate(scans):
        cube = np.floor(scan.points_sensor / _CELL_M).astype(np.int64)
        first = np.unique(cube, axis=0, return_index=True)[1]
        chosen = first[:: max(1, len(first) * len(scans) // _RETURNS)]
        points.append(scan.points_sensor[chosen].astype(np.float64))
        numbers.append(np.full(len(chosen), number))
    return np.concatenate(points), np.concatenate(numbers)


def _around(centre: FloatArray, reach_m: tuple[float, ...], step_m: float) -> FloatArray:
    """(n, 3) places on a grid around one."""
    axes = [np.arange(-round(reach / step_m), round(reach / step_m) + 1) * step_m for reach in reach_m]
    return np.asarray(centre + np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))


def _occupied(points: FloatArray, cell_m: float) -> tuple[BoolArray, FloatArray]:
    """The cubes that hold a point, with a margin of empty ones around, and the place of the first one's corner."""
    origin = np.floor(points.min(axis=0) / cell_m - _MARGIN_CELLS) * cell_m
    cube = np.floor((points - origin) / cell_m).astype(np.int64)
    grid = np.zeros(cube.max(axis=0) + 1 + _MARGIN_CELLS, bool)
    grid[tuple(cube.T)] = True
    return grid, origin


@numba.njit(cache=True, nogil=True)
def _hits(
    points: FloatArray,
    scan: IntArray,
    T: FloatArray,
    headings: FloatArray,
    shifts: FloatArray,
    grid: BoolArray,
    origin: FloatArray,
    cell_m: float,
) -> IntArray:  # pragma: no cover
    """(headings, shifts) how many points lie in occupied cubes.

    points: (n, 3) in the base, but for their heading and shift; scan: (n,) which of the poses T (s, 4, 4) they are seen from.
    headings: (k, 3, 3) rotations in the base. shifts: (m, 3) in the base.
    """
    hits = np.zeros((len(headings), len(shifts)), np.int64)
    moved = np.empty((len(T), len(shifts), 3))
    for s in range(len(T)):
        for m in range(len(shifts)):
            for a in range(3):
                moved[s, m, a] = (
                    T[s, a, 0] * shifts[m, 0] + T[s, a, 1] * shifts[m, 1] + T[s, a, 2] * shifts[m, 2] + T[s, a, 3]
                ) - origin[a]
    for k in range(len(headings)):
        for n in range(len(points)):
            s = scan[n]
            base = headings[k] @ points[n]
            x = T[s, 0, 0] * base[0] + T[s, 0, 1] * base[1] + T[s, 0, 2] * base[2]
            y = T[s, 1, 0] * base[0] + T[s, 1, 1] * base[1] + T[s, 1, 2] * base[2]
            z = T[s, 2, 0] * base[0] + T[s, 2, 1] * base[1] + T[s, 2, 2] * base[2]
            for m in range(len(shifts)):
                a = int(np.floor((x + moved[s, m, 0]) / cell_m))
                b = int(np.floor((y + moved[s, m, 1]) / cell_m))
                c = int(np.floor((z + moved[s, m, 2]) / cell_m))
                if 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1] and 0 <= c < grid.shape[2] and grid[a, b, c]:
                    hits[k, m] += 1
    return hits
