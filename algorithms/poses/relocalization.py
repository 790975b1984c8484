"""Relocalize a scan after a gap, during which the robot may have gone anywhere within reach.

The scan is registered from where the motion before the gap leads, from where the robot was, and
from the poses at which its walls correlate best with those seen before. The pose with the best
agreement wins; the farther from the expected ones, the better it has to agree.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap
from ffmap.algorithms.poses.motion import Change, extrapolate, may_change

LOST_DISTANCE_M = 0.5
"""Maximum distance (m) of a point from its Gaussian where the guess may be off."""
ITERATIONS_MAX = 20
"""Maximum number of iterations of a registration."""
_RECALLED_MAX = 100
"""Maximum number of earlier scans that are searched."""
_SEEN_M = 5.0
"""Maximum further distance of the sensor when it saw the surroundings of a pose within reach."""
_POSES_MAX, _RESWEPT_MAX = 8, 3
"""Maximum number of likely poses that are tried, and of fits that are tried with other motions."""
_SAME = Change(degrees=10.0, metres=0.5)
"""Registrations that differ by less are of the same place."""
_AGREEMENT_MIN = 0.3
"""Of 70 scans, the best pose in another building's map has 0.12 at most, the right pose in their
own map 0.49 at least."""
_RIVAL = 0.05
"""Minimum advantage in agreement of a pose at the end of the reach over the expected one."""
_CLOSE_M, _OFF_MAX_M = 0.5, 0.06
"""Maximum distance of a return from a point of a surface to be compared with it, and from the
surface to agree."""
_UPRIGHT_COS = 0.5
_VOXEL_M, _UPRIGHT_MIN = 0.2, 3
"""Edge of the voxels in which returns count once, and minimum number above each other on a wall."""
_CELL_MIN_M, _CELLS_MAX, _TURN_STEP_DEG, _BLUR_CELLS = 0.2, 400, 2.0, 1.5
"""Of the correlation: minimum edge and maximum number of cells a side, step, blur of the target."""


@dataclass(frozen=True)
class Relocalized:
    """A scan registered after a gap.

    cloud: the scan, compensated by the motion motion_per_ns (6,).
    off: difference from the nearest expected pose, as a share of the maximum.
    agreement: with the surfaces seen before. rival: the best agreement at another place.
    refused: whether it agrees nowhere. The pose is then where the motion leads.
    """

    aligned: Aligned
    cloud: GaussianCloud
    motion_per_ns: FloatArray
    off: float
    agreement: float
    rival: float = 0.0
    refused: bool = False


def is_clear(agreement: float, rival: float) -> bool:
    """Whether a scan agrees at its pose, and clearly less at the next best one."""
    return agreement >= _AGREEMENT_MIN and agreement - rival >= _RIVAL


class Relocalizer:
    """Remembers all scans, and finds a scan among them.

    distance_m: maximum distance of a point from its Gaussian. T_level_odom: (4, 4) to a frame whose
    z axis points up.
    """

    def __init__(self, distance_m: float, T_level_odom: FloatArray) -> None:
        self._distance_m = distance_m
        self._T_level_odom = T_level_odom
        self._seen: list[tuple[FloatArray, FloatArray]] = []

    def remember(self, T_odom_sensor: FloatArray, cloud_sensor: FloatArray) -> None:
        """Keep a registered scan, (n, 3) points."""
        self._seen.append((T_odom_sensor, cloud_sensor))

    def find(
        self,
        compensated: Callable[[FloatArray], GaussianCloud],
        gaussians: GaussianMap,
        T_odom_last: FloatArray,
        motion_per_ns: FloatArray,
        elapsed_ns: int,
    ) -> Relocalized:
        """Register a scan to the map, into which the scans within reach are inserted again.

        compensated: the scan by a given motion. T_odom_last, motion_per_ns: of the last scan.
        """
        change = may_change(elapsed_ns)
        surfaces = self._recall(T_odom_last, change.metres + _SEEN_M)
        gaussians.insert(surfaces.cloud_odom, np.eye(4))
        motions = [motion_per_ns, np.zeros(6)]
        clouds = [compensated(motion) for motion in motions]
        expected = [extrapolate(T_odom_last, motion, elapsed_ns) for motion in motions]
        fits: list[Relocalized] = []

        def off(T: FloatArray) -> float:
            return min(change.share_between(T_expected, T) for T_expected in expected)

        def try_from(guess: FloatArray, cloud: GaussianCloud, motion: FloatArray) -> None:
            lost = gaussians.register(cloud, guess, LOST_DISTANCE_M, ITERATIONS_MAX)
            guess = lost.T_map_cloud
            aligned = gaussians.register(cloud, guess, self._distance_m, ITERATIONS_MAX)
            T = aligned.T_map_cloud
            if off(T) <= 1.0:
                agreement = surfaces.agreement(cloud, T)
                fits.append(Relocalized(aligned, cloud, motion, off(T), agreement))

        for guess, cloud, motion in zip(expected, clouds, motions, strict=True):
            try_from(guess, cloud, motion)
        if max((fit.agreement for fit in fits), default=0.0) < 1.0 - _RIVAL:
            poses: list[FloatArray] = []
            for T in surfaces.likely_poses(clouds[0].points, T_odom_last):
                is_new = not any(_SAME.share_between(T, other) <= 1.0 for other in poses)
                if len(poses) < _POSES_MAX and is_new and off(T) <= 1.0:
                    poses.append(T)
            for T in poses:
                try_from(T, clouds[0], motions[0])
        # Only a fit shows whether the sensor moved within the sweep as before, or as in the gap.
        for fit in sorted(fits, key=lambda fit: -fit.agreement)[:_RESWEPT_MAX]:
            T = fit.aligned.T_map_cloud
            way = transforms.to_twist(transforms.invert(T_odom_last) @ T)
            other = motions[1] if fit.motion_per_ns is motions[0] else motions[0]
            for motion in (other, way / elapsed_ns):
                try_from(T, compensated(motion), motion)
        nothing = Aligned(expected[0], 0.0, np.zeros((6, 6)))
        nowhere = Relocalized(nothing, clouds[0], motions[0], 0.0, 0.0)
        best = max(fits, key=lambda fit: fit.agreement - _RIVAL * fit.off, default=nowhere)
        T_best = best.aligned.T_map_cloud
        others = [f for f in fits if _SAME.share_between(T_best, f.aligned.T_map_cloud) > 1.0]
        best = replace(best, rival=max((fit.agreement for fit in others), default=0.0))
        if best.agreement >= _AGREEMENT_MIN:
            return best
        return replace(best, aligned=replace(best.aligned, T_map_cloud=expected[0]), refused=True)

    def _recall(self, T_odom_last: FloatArray, reach_m: float) -> "_Surfaces":
        """The surfaces that were seen from within reach."""
        seen = [
            (T, points)
            for T, points in self._seen
            if np.linalg.norm(T[:3, 3] - T_odom_last[:3, 3]) < reach_m
        ]
        seen = seen[:: -(-len(seen) // _RECALLED_MAX)]
        points_odom = np.concatenate([transforms.apply(T, points) for T, points in seen])
        return _Surfaces(GaussianCloud(points_odom), self._T_level_odom)


class _Surfaces:
    """Surfaces that were seen before, as one cloud."""

    def __init__(self, cloud_odom: GaussianCloud, T_level_odom: FloatArray) -> None:
        self.cloud_odom = cloud_odom
        self._points_odom, self._normals_odom = cloud_odom.points, cloud_odom.normals
        self._tree = cKDTree(self._points_odom)
        self._T_level_odom = T_level_odom

    def agreement(self, cloud: GaussianCloud, T_odom_sensor: FloatArray) -> float:
        """Share of a scan's returns from upright surfaces on surfaces, less the share beside them.

        Unlike the share with a Gaussian, it does not depend on where the rings of either scan hit a
        surface: they move with the lidar. Floor and ceiling agree everywhere.
        """
        points_odom = transforms.apply(T_odom_sensor, cloud.points)
        up_sensor = T_odom_sensor[:3, :3].T @ self._T_level_odom[2, :3]
        upright = np.abs(cloud.normals @ up_sensor) < _UPRIGHT_COS
        if not upright.any():
            return 0.0
        distance_m, nearest = self._tree.query(points_odom[upright], distance_upper_bound=_CLOSE_M)
        close = np.isfinite(distance_m)
        off = points_odom[upright][close] - self._points_odom[nearest[close]]
        off_m = np.abs(np.einsum("ij,ij->i", off, self._normals_odom[nearest[close]]))
        return float(np.where(off_m < _OFF_MAX_M, 1.0, -1.0).sum() / len(close))

    def likely_poses(self, points_sensor: FloatArray, T_odom_last: FloatArray) -> list[FloatArray]:
        """Poses (4, 4) at the height and inclination of the last one, the likeliest first."""
        T_level_last = self._T_level_odom @ T_odom_last
        inclined = transforms.make_transform(transforms.rotation_of(T_level_last))
        target = _walls(transforms.apply(self._T_level_odom, self._points_odom))
        source = _walls(transforms.apply(inclined, points_sensor))
        if not len(source) or not len(target):
            return []
        T_odom_level = transforms.invert(self._T_level_odom)
        poses: list[FloatArray] = []
        for T_plane in _likely_motions(source, target):
            yaw_rad = float(np.arctan2(T_plane[1, 0], T_plane[0, 0]))
            T_level_yawed = transforms.from_yaw(yaw_rad, [*T_plane[:2, 2], T_level_last[2, 3]])
            poses.append(T_odom_level @ T_level_yawed @ inclined)
        return poses


def _walls(points_level: FloatArray) -> FloatArray:
    """Centres (k, 2) of the columns in which points (n, 3) are above each other."""
    voxels = np.unique(np.floor(points_level / _VOXEL_M).astype(np.int64), axis=0)
    columns, count = np.unique(voxels[:, :2], axis=0, return_counts=True)
    return np.asarray((columns[count >= _UPRIGHT_MIN] + 0.5) * _VOXEL_M)


def _likely_motions(source: FloatArray, target: FloatArray) -> list[FloatArray]:
    """Rank the rigid motions T_target_source (3, 3) of points (n, 2) onto others (m, 2).

    For each rotation, the best of all translations by correlation with the blurred target (Chen and
    Defrise 1994). Neither set may be empty.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2  # a quarter of a second

    centre = source.mean(axis=0)
    reach = float(np.linalg.norm(source - centre, axis=1).max())
    size = max(float(np.ptp(target, axis=0).max()), 2 * reach)
    cell_m = max(_CELL_MIN_M, size / _CELLS_MAX)
    low = target.min(axis=0) - 2 * cell_m
    shape = (np.ceil((np.ptp(target, axis=0) + 4 * cell_m) / cell_m)).astype(int) + 1
    hit = np.zeros(shape, bool)
    hit[tuple(np.floor((target - low) / cell_m).astype(int).T)] = True
    near = np.exp(-0.5 * (distance_transform_edt(~hit) / _BLUR_CELLS) ** 2)
    half = int(np.ceil(reach / cell_m)) + 1
    full = shape + 2 * half
    fast = [next_fast_len(int(length), real=True) for length in full]
    spectrum = rfft2(near, fast)
    found: list[tuple[float, FloatArray]] = []
    for turn in np.radians(np.arange(0.0, 360.0, _TURN_STEP_DEG)):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        index = np.floor(((source - centre) @ R.T) / cell_m).astype(int) + half
        kernel = np.zeros((2 * half + 1, 2 * half + 1))
        np.add.at(kernel, tuple(index.T), 1.0)
        flipped = rfft2(np.minimum(kernel, 3.0)[::-1, ::-1], fast)
        score = irfft2(spectrum * flipped, fast)[: full[0], : full[1]]
        peak = np.unravel_index(int(np.argmax(score)), score.shape)
        # Index k of the full correlation puts the kernel's middle on cell k - half.
        middle = low + (np.array(peak) - half + 0.5) * cell_m
        T = np.eye(3)
        T[:2, :2], T[:2, 2] = R, middle - R @ centre
        found.append((float(score[peak]), T))
    found.sort(key=lambda candidate: -candidate[0])
    return [T for _, T in found]
