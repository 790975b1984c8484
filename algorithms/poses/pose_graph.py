"""Close loops by a pose graph of submaps (paper, IV.A: BLAM's loop closure); imports gtsam.

Odometry drifts. Here overlapping parts of the drive become submaps, each is registered to earlier
ones nearby, and all poses are optimized together. A registration counts in each direction by the
information that it has there (the Hessian of its cost). A robust loss rejects false loops, and
steps at which the odometry slipped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap

_SUBMAP_SCANS, _EVERY_SCANS = 20, 10
"""Number of scans in a submap, and from one submap's middle to the next one's."""
_ALONG = 2
"""Number of submaps before it that each submap is joined with: the way as it was driven."""
_SLIP_WEIGHT = 0.1
"""Maximum weight of a slip: less is an error of more than three times the loss's scale."""
_LOSS_SCALE_SIGMAS = 3.0
"""Error of a registration, in standard deviations, at which it counts half (Cauchy's loss)."""
_LOSSES = (30.0, 10.0, 3.0, 1.0)
"""Widths of the loss, as multiples of `_LOSS_SCALE_SIGMAS`, from one solution to the next. Loops
that agree with one another, but not with a slip of the odometry, have to move many poses before
they fit: at first all registrations count, and at last those that agree (graduated non-convexity:
Yang, Antonante, Tzoumas and Carlone 2020)."""
_ODOMETRY_DEG, _ODOMETRY_M = 0.5, 0.05
"""Standard deviations of the odometry's motion between submaps: for unconstrained directions."""
_VOXEL_M = 0.2
"""Edge (m) of the voxels of one Gaussian each: larger ones would blend the sides of a wall."""
_LOOPS_MAX = 6
"""Maximum number of earlier passes, the nearest ones, that a submap is joined with."""
_DISTANCE_M = 0.4
"""Maximum distance (m) of a point from its Gaussian."""
_ITERATIONS_MAX = 30
"""Maximum number of iterations of a registration."""
_INLIER_SHARE_MIN = 0.4
"""Minimum share of inliers of a registration: two passes through a doorway, seen from either side,
share no more."""
_ROUNDS_MAX = 4
"""Maximum number of rounds of joining and solving: solved poses may bring more submaps together."""


class PoseGraphSettings(StepSettings):
    """Closing loops by a graph of submaps, in place of BLAM's loop closure (paper, IV.A)."""

    enabled: bool = Field(True, description="Whether loops are closed after the whole drive.")
    near_m: float = Field(
        3.0,
        ge=0,
        description="Maximum distance (m) between the middles of submaps that a loop joins.",
    )


@dataclass(frozen=True)
class PoseGraph:
    """Submaps, the registrations that join them, and their optimized poses.

    T_odom_first: (4, 4) the first pose, registered again to the scans after it.
    scan: (m,) index of the pose in the middle of each submap.
    T_odom_sensor: (m, 4, 4) the optimized poses; T_correction: (m, 4, 4) from the odometry's poses
        to them, in the odometry's frame.
    first, second: (e,) submaps that a registration joins.
    offset: (e,) difference between optimized poses and registration, in standard deviations.
    inlier_share: (e,) share of the second submap that fits the first.
    weight: (e,) final weight from 0 to 1; 0 if too little fitted.
    """

    T_odom_first: FloatArray
    scan: IntArray
    T_odom_sensor: FloatArray
    T_correction: FloatArray
    first: IntArray
    second: IntArray
    offset: FloatArray
    inlier_share: FloatArray
    weight: FloatArray

    @property
    def is_loop(self) -> BoolArray:
        """(e,) whether a registration joins two passes, and not neighbours of the same pass."""
        return np.asarray(self.second - self.first > _ALONG)

    @property
    def slips(self) -> IntArray:
        """(k,) indices of poses near which the odometry slipped: rejected neighbours."""
        slipped = ~self.is_loop & (self.weight > 0.0) & (self.weight < _SLIP_WEIGHT)
        return np.unique(self.scan[self.first[slipped]])

    def corrected(self, T_odom_sensor: FloatArray) -> FloatArray:
        """Correct poses (n, 4, 4) by their two nearest submaps, interpolated."""
        n, m = len(T_odom_sensor), len(self.scan)
        T_odom_sensor = _with_first(T_odom_sensor, self.T_odom_first)
        if m == 0:
            return T_odom_sensor
        place = np.interp(np.arange(n), self.scan, np.arange(m))
        before = np.minimum(place.astype(np.int64), max(m - 2, 0))
        after = np.minimum(before + 1, m - 1)
        T_before = self.T_correction[before] @ T_odom_sensor
        T_after = self.T_correction[after] @ T_odom_sensor
        return transforms.interpolated(T_before, T_after, place - before)


@dataclass(frozen=True)
class Edge:
    """The second submap registered to the first."""

    first: int
    second: int
    aligned: Aligned

    def offset(self, T: FloatArray) -> float:
        """Mahalanobis distance between poses T (m, 4, 4) and the registration."""
        T_solved = transforms.invert(T[self.first]) @ T[self.second]
        off = transforms.to_twist(transforms.invert(self.aligned.T_map_cloud) @ T_solved)
        return float(np.sqrt(np.maximum(off @ self.aligned.information @ off, 0.0)))


def close_loops(
    T_odom_sensor: FloatArray, clouds_sensor: Sequence[FloatArray], settings: PoseGraphSettings
) -> PoseGraph:
    """Join submaps where the robot returns to a place, and optimize their poses.

    T_odom_sensor: (n, 4, 4). clouds_sensor: (k, 3) of each, motion compensated.
    The first submap stays in place.
    """
    half = _SUBMAP_SCANS // 2
    T_odom_first = _register_first(T_odom_sensor, clouds_sensor, half)
    T_odom_sensor = _with_first(T_odom_sensor, T_odom_first)
    scan = np.arange(0, len(T_odom_sensor), _EVERY_SCANS)
    T_start = T_odom_sensor[scan]

    @lru_cache(maxsize=200)
    def submap(number: int) -> GaussianCloud:
        middle, T_submap_odom = scan[number], transforms.invert(T_start[number])
        own = range(max(0, middle - half), min(len(T_odom_sensor), middle + half + 1))
        points = [transforms.apply(T_submap_odom @ T_odom_sensor[i], clouds_sensor[i]) for i in own]
        return GaussianCloud(np.concatenate(points))

    T = T_start
    registered: dict[tuple[int, int], Edge] = {}
    for round_number in range(_ROUNDS_MAX):
        new = sorted(_pairs(T[:, :3, 3], settings.near_m) - registered.keys())
        if not new:
            break
        registered |= {(e.first, e.second): e for e in _register(new, T, submap)}
        # After the first round, poses are near those that the loops agree on.
        losses = _LOSSES if round_number == 0 else _LOSSES[-1:]
        T = solve(T_start, T, list(registered.values()), losses)
    edges = [registered[pair] for pair in sorted(registered)]
    offset = np.array([edge.offset(T) for edge in edges])
    inlier_share = np.array([edge.aligned.inlier_share for edge in edges])
    weight = 1.0 / (1.0 + (offset / _LOSS_SCALE_SIGMAS) ** 2)
    return PoseGraph(
        T_odom_first=T_odom_first,
        scan=scan,
        T_odom_sensor=T,
        T_correction=T @ transforms.invert(T_start),
        first=np.array([edge.first for edge in edges], np.int64),
        second=np.array([edge.second for edge in edges], np.int64),
        offset=offset,
        inlier_share=inlier_share,
        weight=np.where(inlier_share >= _INLIER_SHARE_MIN, weight, 0.0),
    )


def _register_first(
    T_odom_sensor: FloatArray, clouds_sensor: Sequence[FloatArray], half: int
) -> FloatArray:
    """Register the first scan to the `half` scans after it.

    The second scan was registered to the first alone, whose pose is that of the whole map: an error
    of half a degree turns the building.
    """
    if len(T_odom_sensor) <= half:
        return T_odom_sensor[0] if len(T_odom_sensor) else np.eye(4)
    after = range(1, half + 1)
    points = [transforms.apply(T_odom_sensor[i], clouds_sensor[i]) for i in after]
    # The points of few scans need larger voxels to constrain a rotation.
    gaussians = GaussianMap(2.0 * _VOXEL_M)
    gaussians.insert(GaussianCloud(np.concatenate(points)), np.eye(4))
    first = GaussianCloud(clouds_sensor[0])
    aligned = gaussians.register(first, T_odom_sensor[0], _DISTANCE_M, _ITERATIONS_MAX)
    return aligned.T_map_cloud if aligned.inlier_share >= _INLIER_SHARE_MIN else T_odom_sensor[0]


def _with_first(T_odom_sensor: FloatArray, T_odom_first: FloatArray) -> FloatArray:
    return np.concatenate([T_odom_first[None], T_odom_sensor[1:]])[: len(T_odom_sensor)]


def _pairs(position: FloatArray, near_m: float) -> set[tuple[int, int]]:
    """Submaps to join: each with those just before it, and the nearest of each earlier pass."""
    along = range(1, _ALONG + 1)
    pairs = {(i - back, i) for i in range(len(position)) for back in along if i >= back}
    if not len(position):
        return pairs
    for i, near in enumerate(cKDTree(position).query_ball_point(position, near_m)):
        earlier = np.array([j for j in near if j < i - _ALONG], np.int64)
        distance_m = np.linalg.norm(position[earlier] - position[i], axis=1)
        passes: list[int] = []
        for j in earlier[np.argsort(distance_m, kind="stable")].tolist():
            # Neighbours on the same pass add nothing.
            is_new = all(abs(j - taken) > _ALONG for taken in passes)
            if is_new and len(passes) < _LOOPS_MAX:
                passes.append(j)
        pairs.update((j, i) for j in passes)
    return pairs


def _register(
    pairs: Sequence[tuple[int, int]],
    T_odom_submap: FloatArray,
    submap: Callable[[int], GaussianCloud],
) -> list[Edge]:
    """Register each second submap to its first; pairs are sorted by the first."""
    edges: list[Edge] = []
    mapped, gaussians = -1, GaussianMap(_VOXEL_M)
    for first, second in pairs:
        if first != mapped:
            mapped, gaussians = first, GaussianMap(_VOXEL_M)
            gaussians.insert(submap(first), np.eye(4))
        guess = transforms.invert(T_odom_submap[first]) @ T_odom_submap[second]
        aligned = gaussians.register(submap(second), guess, _DISTANCE_M, _ITERATIONS_MAX)
        edges.append(Edge(first, second, aligned))
    return edges


def solve(
    T_start: FloatArray,
    T_guess: FloatArray,
    edges: Sequence[Edge],
    losses: Sequence[float] = _LOSSES,
) -> FloatArray:
    """Optimize poses (m, 4, 4) from a guess, by losses of these widths one after another."""
    import gtsam  # noqa: TID251 - its one place; takes 0.1 s

    T = T_guess
    for width in losses:
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for number, T_submap in enumerate(T):
            values.insert(number, gtsam.Pose3(T_submap))
        fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
        graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T_start[0]), fixed))
        sigmas = np.array([np.radians(_ODOMETRY_DEG)] * 3 + [_ODOMETRY_M] * 3)
        way = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        for number in range(1, len(T_start)):
            step = gtsam.Pose3(transforms.invert(T_start[number - 1]) @ T_start[number])
            graph.add(gtsam.BetweenFactorPose3(number - 1, number, step, way))
        loss = gtsam.noiseModel.mEstimator.Cauchy.Create(width * _LOSS_SCALE_SIGMAS)
        for edge in edges:
            if edge.aligned.inlier_share < _INLIER_SHARE_MIN:
                continue
            # Standard deviations of 1 m and 1 rad: the graph must not be singular.
            held = gtsam.noiseModel.Gaussian.Information(edge.aligned.information + np.eye(6))
            noise = gtsam.noiseModel.Robust.Create(loss, held)
            T_first_second = gtsam.Pose3(edge.aligned.T_map_cloud)
            graph.add(gtsam.BetweenFactorPose3(edge.first, edge.second, T_first_second, noise))
        solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        poses = [solved.atPose3(number).matrix() for number in range(len(T_start))]
        T = np.array([transforms.orthonormal(pose) for pose in poses])
    return T
