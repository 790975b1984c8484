"""Where the vertical lidar sits and by which clock it runs, from the surfaces that both lidars see while the robot drives.

Three angles, three shifts and one time lay the vertical lidar's returns on the patches of floor and walls that the horizontal
lidar has mapped: least squares of the distances across the patches, with Cauchy's loss, found anew patch by patch in rounds
whose reach shrinks. Nothing else is asked of the building (Zhang, Kaess and Singh 2016 for what tells which direction is held).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.patches import Patches

REACH_M = 0.1
"""Maximum distance of a return from its patch where their agreement is measured."""
_REACHES_M = (0.6, 0.4, 0.25, 0.15, 0.1, 0.07, 0.07)
"""Maximum distance of a return from its patch, round by round."""
_LOSS_M = 0.02
"""Distance at which a return counts half: about what a lidar's ranges scatter by."""
_STEP_NS = 2_000_000
"""Half the time over which motion is measured, for what a clock that is off does to a return."""
_RETURNS_MIN = 500
_CLUSTER = 12.0
"""Number of returns that tell as much as one: those of one patch share its error, and those of one sweep its pose's."""


@dataclass(frozen=True)
class RefinedExtrinsics:
    """The vertical lidar's place in the base and its clock, refined.

    T_base_sensor: (4, 4). clock_s: what is to be added to its stamps.
    sigma: (7,) standard deviations: rotation about the base's x, y, z (radians), shift along them (m), clock (s); near 1 of
        each unit where the motion does not tell.
    rms_before_m, rms_after_m: of the returns' distances from the patches, as it was given and as refined.
    """

    T_base_sensor: FloatArray
    clock_s: float
    sigma: FloatArray
    rms_before_m: float
    rms_after_m: float
    returns: int

    def change(self, T_given: FloatArray) -> FloatArray:
        """(7,) what was found less what was given, in the units of `sigma`; T_given: (4, 4)."""
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
    """The mount near the given one (4, 4) at which the scans lie best on the patches; None where too little of them does.

    patches: what the horizontal lidar saw, in the trajectory's frame. trajectory: of the base; an error of its poses moves what
    both lidars see alike. scans: of the vertical lidar. agree_m: RMS of the distances up to which the
    given one is kept, with unknown (NaN) `sigma`.
    """
    points_base, stamp_ns = _returns(scans, T_base_sensor, returns_max)
    if len(patches.centre) < _RETURNS_MIN or len(points_base) < _RETURNS_MIN:
        return None
    tree = cKDTree(patches.centre)
    T_correction, clock_s, x = np.eye(4), 0.0, np.zeros(7)
    moving = _Moving.of(points_base, stamp_ns, trajectory)
    matched = _match(moving, patches, tree, REACH_M)
    rms_before_m = _rms(moving.distances(x, *matched))
    if rms_before_m <= agree_m and np.count_nonzero(matched[0]) >= _RETURNS_MIN:
        kept = (T_base_sensor, 0.0, np.full(7, np.nan), rms_before_m, rms_before_m)
        return RefinedExtrinsics(*kept, int(np.count_nonzero(matched[0])))
    for reach_m in _REACHES_M:
        moving = _Moving.of(transforms.apply(T_correction, points_base), stamp_ns + round(1e9 * clock_s), trajectory)
        matched = _match(moving, patches, tree, reach_m)
        if np.count_nonzero(matched[0]) < _RETURNS_MIN:
            return None
        found = least_squares(
            moving.distances,
            np.zeros(7),
            moving.slopes,
            args=matched,
            loss="cauchy",
            f_scale=max(_LOSS_M, 0.2 * reach_m),
        )
        x = found.x
        T_correction, clock_s = _moved(x) @ T_correction, clock_s + float(x[6])
    residual_m = moving.distances(x, *matched)
    # Of a robust fit, those that it believes tell the scatter.
    scatter_m = 1.4826 * float(np.median(np.abs(residual_m)))
    J = moving.slopes(x, *matched) / np.sqrt(1.0 + (residual_m[:, None] / _LOSS_M) ** 2)
    variance = _CLUSTER * scatter_m**2
    # Of each of the seven next to nothing is known beforehand: what no return tells stays unknown.
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
    """RMS distance (m) of the scans' returns from the patches within reach, and the share of those."""
    if not len(patches.centre) or not scans:
        return float("nan"), 0.0
    moving = _Moving.of(*_returns(scans, T_base_sensor, returns_max), trajectory)
    matched = _match(moving, patches, cKDTree(patches.centre), REACH_M)
    return _rms(moving.distances(np.zeros(7), *matched)), float(matched[0].mean())


def _moved(x: FloatArray) -> FloatArray:
    """(4, 4) what the first six do in the base: a turn and a shift."""
    return transforms.from_twist(x[:6])


def _rms(distance_m: FloatArray) -> float:
    return float(np.sqrt(np.mean(distance_m**2))) if len(distance_m) else float("nan")


def _returns(scans: Sequence[Scan], T_base_sensor: FloatArray, returns_max: int) -> tuple[FloatArray, IntArray]:
    """(n, 3) evenly thinned returns in the base as it is given, and the time (n,) of each."""
    stride = max(1, sum(len(scan) for scan in scans) // returns_max)
    points: list[FloatArray] = [np.zeros((0, 3))]
    stamps: list[IntArray] = [np.zeros(0, np.int64)]
    for scan in scans:
        points.append(transforms.apply(T_base_sensor, scan.points_sensor[::stride].astype(np.float64)))
        stamp_ns: IntArray = np.full(len(points[-1]), scan.start_ns)
        stamps.append(stamp_ns if scan.time_ns is None else stamp_ns + scan.time_ns[::stride])
    return np.concatenate(points), np.concatenate(stamps)


@dataclass(frozen=True)
class _Moving:
    """Returns and the base's motion: T (n, 4, 4) at the time of each, and what a second adds to it, T_per_s (n, 4, 4)."""

    points_base: FloatArray
    T: FloatArray
    T_per_s: FloatArray

    @classmethod
    def of(cls, points_base: FloatArray, stamp_ns: IntArray, trajectory: Trajectory) -> "_Moving":
        before, after = trajectory.at(stamp_ns - _STEP_NS), trajectory.at(stamp_ns + _STEP_NS)
        return cls(points_base, trajectory.at(stamp_ns), (after - before) / (2e-9 * _STEP_NS))

    def places(self, x: FloatArray, rows: BoolArray | slice = slice(None)) -> FloatArray:
        """(n, 3) where the returns lie: a clock that is off by some hundredths of a second moves the base along its motion."""
        points = transforms.apply(_moved(x), self.points_base[rows])
        T = self.T[rows] + x[6] * self.T_per_s[rows]
        return np.asarray(np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3])

    def distances(self, x: FloatArray, rows: BoolArray, centre: FloatArray, normal: FloatArray) -> FloatArray:
        """(m,) metres of the matched returns across their patches."""
        return np.asarray(np.einsum("ni,ni->n", self.places(x, rows) - centre, normal))

    def slopes(self, x: FloatArray, rows: BoolArray, centre: FloatArray, normal: FloatArray) -> FloatArray:
        """(m, 7) how the distances change with each of the seven, near a small turn."""
        points = transforms.apply(_moved(x), self.points_base[rows])
        T = self.T[rows] + x[6] * self.T_per_s[rows]
        normal_base = np.einsum("nij,ni->nj", T[:, :3, :3], normal)
        later = np.einsum("nij,nj->ni", self.T_per_s[rows][:, :3, :3], points) + self.T_per_s[rows][:, :3, 3]
        turned = np.cross(points - x[3:6], normal_base)
        return np.column_stack([turned, normal_base, np.einsum("ni,ni->n", later, normal)])


def _match(
    moving: _Moving, patches: Patches, tree: cKDTree, reach_m: float
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which returns (n,) have a patch within reach, and those patches' middles and normals (m, 3)."""
    distance_m, nearest = tree.query(moving.places(np.zeros(7)), distance_upper_bound=reach_m)
    rows = np.isfinite(distance_m)
    return rows, patches.centre[nearest[rows]], patches.normal[nearest[rows]]
