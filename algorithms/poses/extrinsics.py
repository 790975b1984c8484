"""Refine a vertical lidar's extrinsics and clock offset by the surfaces that both lidars see.

Three angles, three shifts and a time move the vertical lidar's returns onto the planar patches of
floor and walls that the horizontal lidar mapped: least squares of the point-to-plane distances with
Cauchy's loss, matched anew in rounds of decreasing reach. Directions that the drive does not
constrain have a large standard deviation (Zhang, Kaess and Singh 2016).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.patches import Patches

REACH_M = 0.1
"""Maximum distance of a return from its patch where their agreement is measured."""
_REACHES_M = (0.6, 0.4, 0.25, 0.15, 0.1, 0.07, 0.07)
"""Maximum distance of a return from its patch, round by round."""
_LOSS_M = 0.02
"""Distance at which a return counts half: about the noise of a lidar's ranges."""
_STEP_NS = 2_000_000
"""Half the time over which the base's velocity is measured."""
_RETURNS_MIN = 500
_CLUSTER = 12.0
"""Number of returns with the information of one: those of a patch share its error, and those of a
sweep the error of its pose."""


@dataclass(frozen=True)
class RefinedExtrinsics:
    """The vertical lidar's extrinsics and clock offset, refined.

    T_base_sensor: (4, 4). clock_s: to be added to the time stamps.
    sigma: (7,) standard deviations: rotation about the base's x, y, z (rad), shift along them (m),
        clock (s); near 1 where the motion does not constrain it, NaN where nothing was refined.
    rms_before_m, rms_after_m: of the distances from the patches, as given and as refined.
    returns: number of returns with a patch; 0 where too few have one to refine anything.
    """

    T_base_sensor: FloatArray
    clock_s: float
    sigma: FloatArray
    rms_before_m: float
    rms_after_m: float
    returns: int

    def change(self, T_given: FloatArray) -> FloatArray:
        """(7,) the refined less the given extrinsics (4, 4), in the units of `sigma`."""
        turn = transforms.to_twist(self.T_base_sensor @ transforms.invert(T_given))[:3]
        return np.array([*turn, *(self.T_base_sensor - T_given)[:3, 3], self.clock_s])


def refine_extrinsics(
    patches: Patches,
    trajectory: Trajectory,
    scans: Sequence[Scan],
    T_base_sensor: FloatArray,
    returns_max: int = 20_000,
    agree_m: float = 0.0,
) -> RefinedExtrinsics | None:
    """Find the extrinsics near the given ones (4, 4) at which the scans fit the patches best.

    patches: seen by the horizontal lidar, in the trajectory's frame. trajectory: of the base.
    scans: of the vertical lidar. agree_m: maximum RMS distance at which the given ones are kept.
    None where there are too few patches or returns.
    """
    points_base, stamp_ns = _returns(scans, T_base_sensor, returns_max)
    if len(patches.centre) < _RETURNS_MIN or len(points_base) < _RETURNS_MIN:
        return None
    matched = _Matched.of(points_base, stamp_ns, trajectory, patches, REACH_M)
    x, unknown, count = np.zeros(7), np.full(7, np.nan), len(matched.points_base)
    rms_before_m = _rms(matched.distances(x)) if count else REACH_M
    if rms_before_m <= agree_m and count >= _RETURNS_MIN:
        return RefinedExtrinsics(T_base_sensor, 0.0, unknown, rms_before_m, rms_before_m, count)
    T_correction, clock_s = np.eye(4), 0.0
    for reach_m in _REACHES_M:
        points = transforms.apply(T_correction, points_base)
        times_ns = stamp_ns + round(1e9 * clock_s)
        matched = _Matched.of(points, times_ns, trajectory, patches, reach_m)
        if len(matched.points_base) < _RETURNS_MIN:
            return RefinedExtrinsics(T_base_sensor, 0.0, unknown, rms_before_m, rms_before_m, 0)
        x = least_squares(
            matched.distances,
            np.zeros(7),
            matched.jacobian,
            loss="cauchy",
            f_scale=max(_LOSS_M, 0.2 * reach_m),
        ).x
        T_correction = transforms.from_twist(x[:6]) @ T_correction
        clock_s += float(x[6])
    residual_m = matched.distances(x)
    # Robust: 1.4826 median absolute deviations of a normal distribution are its sigma.
    scatter_m = 1.4826 * float(np.median(np.abs(residual_m)))
    J = matched.jacobian(x) / np.sqrt(1.0 + (residual_m[:, None] / _LOSS_M) ** 2)
    variance = _CLUSTER * scatter_m**2
    # A prior of 1 for each of the seven: what no return constrains stays unknown.
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(J.T @ J + variance * np.eye(7))))
    return RefinedExtrinsics(
        transforms.orthonormal(T_correction @ T_base_sensor),
        clock_s,
        sigma,
        rms_before_m,
        _rms(residual_m),
        len(residual_m),
    )


def surfaces_agreement(
    patches: Patches,
    trajectory: Trajectory,
    scans: Sequence[Scan],
    T_base_sensor: FloatArray,
    returns_max: int,
) -> tuple[float, float]:
    """RMS distance (m) of the scans' returns to the patches within reach, and their share."""
    if not len(patches.centre) or not scans:
        return float("nan"), 0.0
    points_base, stamp_ns = _returns(scans, T_base_sensor, returns_max)
    matched = _Matched.of(points_base, stamp_ns, trajectory, patches, REACH_M)
    share = len(matched.points_base) / max(len(points_base), 1)
    return _rms(matched.distances(np.zeros(7))), share


def _rms(distance_m: FloatArray) -> float:
    return float(np.sqrt(np.mean(distance_m**2))) if len(distance_m) else float("nan")


def _returns(
    scans: Sequence[Scan], T_base_sensor: FloatArray, returns_max: int
) -> tuple[FloatArray, IntArray]:
    """Evenly thinned returns (n, 3) in the base, and their times (n,)."""
    stride = max(1, sum(len(scan) for scan in scans) // returns_max)
    points: list[FloatArray] = [np.zeros((0, 3))]
    stamps: list[IntArray] = [np.zeros(0, np.int64)]
    for scan in scans:
        own = scan.points_sensor[::stride].astype(np.float64)
        points.append(transforms.apply(T_base_sensor, own))
        stamp_ns: IntArray = np.full(len(own), scan.start_ns)
        stamps.append(stamp_ns if scan.time_ns is None else stamp_ns + scan.time_ns[::stride])
    return np.concatenate(points), np.concatenate(stamps)


@dataclass(frozen=True)
class _Matched:
    """Returns (m, 3) with a patch: the base's pose T (m, 4, 4) at the time of each, and dT/dt.

    The seven parameters x: a twist of the returns in the base, and a clock offset (s), which moves
    the base along its motion.
    """

    points_base: FloatArray
    T: FloatArray
    T_per_s: FloatArray
    centre: FloatArray
    normal: FloatArray

    @classmethod
    def of(
        cls,
        points_base: FloatArray,
        stamp_ns: IntArray,
        trajectory: Trajectory,
        patches: Patches,
        reach_m: float,
    ) -> "_Matched":
        """Match points (n, 3) at times (n,) with the nearest patches within reach."""
        T = trajectory.at(stamp_ns)
        places = np.einsum("nij,nj->ni", T[:, :3, :3], points_base) + T[:, :3, 3]
        distance_m, nearest = patches.tree.query(places, distance_upper_bound=reach_m)
        near = np.isfinite(distance_m)
        before = trajectory.at(stamp_ns[near] - _STEP_NS)
        after = trajectory.at(stamp_ns[near] + _STEP_NS)
        T_per_s = (after - before) / (2e-9 * _STEP_NS)
        centre, normal = patches.centre[nearest[near]], patches.normal[nearest[near]]
        return cls(points_base[near], T[near], T_per_s, centre, normal)

    def distances(self, x: FloatArray) -> FloatArray:
        """(m,) signed distances (m) to the patches."""
        points, T = self._moved(x)
        places = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
        return np.asarray(np.einsum("ni,ni->n", places - self.centre, self.normal))

    def jacobian(self, x: FloatArray) -> FloatArray:
        """(m, 7) derivatives of the distances, for a small rotation."""
        points, T = self._moved(x)
        normal_base = np.einsum("nij,ni->nj", T[:, :3, :3], self.normal)
        turned = np.cross(points - x[3:6], normal_base)
        velocity = np.einsum("nij,nj->ni", self.T_per_s[:, :3, :3], points)
        along = np.einsum("ni,ni->n", velocity + self.T_per_s[:, :3, 3], self.normal)
        return np.column_stack([turned, normal_base, along])

    def _moved(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = transforms.apply(transforms.from_twist(x[:6]), self.points_base)
        return points, self.T + x[6] * self.T_per_s
