"""Loops closed: submaps registered to one another, and a graph of their poses (paper, IV.A: the loop closure of BLAM).

An odometry that registers to what it saw last drifts. Here stretches of the drive become submaps, each is registered to
those before it that lie nearby, and all poses are solved for at once. A registration counts in each direction for as much
as it holds there (the Hessian of its cost), and a robust loss lets go of the false ones: of loops, and of where the
odometry slipped. The only file that imports gtsam.
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

_ALONG = 2  # each submap is joined with this many before it, wherever they lie: that is the way as it was driven
_SLIP_WEIGHT = 0.1  # what counts less than this of the way is off by more than three times the loss's scale
_LOSSES = (30.0, 10.0, 3.0, 1.0)
"""The widths of the loss, as shares of `_LOSS_SCALE_SIGMAS`, from one solution to the next.

Loops that agree with one another, and not with a slip of the odometry, have to move many poses
before they fit: at first all registrations count, and at last those that agree (graduated
non-convexity: Yang, Antonante, Tzoumas and Carlone 2020).
"""
_VOXEL_M = 0.2
"""Edge (m) of the voxels of one Gaussian each: larger ones would blend the two sides of a wall."""
_LOOPS_MAX = 6
"""Maximum number of earlier passes, the nearest ones, that a submap is joined with."""
_DISTANCE_M = 0.4
"""Maximum distance (m) of a point from its Gaussian."""
_ITERATIONS_MAX = 30
"""Maximum number of iterations of a registration."""
_INLIER_SHARE_MIN = 0.4
"""Minimum share of a submap that fits the one that it is joined with: two passes through a doorway,
seen from either side, share no more."""
_LOSS_SCALE_SIGMAS = 3.0
"""Error of a registration, in standard deviations, at which it counts half (Cauchy's loss)."""
_ROUNDS_MAX = 4
"""Maximum number of rounds of joining and solving: solved poses can bring further submaps near each
other."""


class PoseGraphSettings(StepSettings):
    """Closing loops by a graph of submaps; in place of the loop closure of the paper's BLAM (IV.A)."""

    enabled: bool = Field(True, description="Whether loops are closed once the bag has been driven through.")
    submap_scans: int = Field(20, ge=2, description="Number of scans in a submap.")
    every_scans: int = Field(10, ge=1, description="Scans from one submap's middle to the next one's.")
    near_m: float = Field(
        3.0, ge=0, description="Maximum distance (m) between the middles of submaps that a loop joins."
    )


@dataclass(frozen=True)
class PoseGraph:
    """Submaps, what joins them, and where that puts them.

    T_odom_first: (4, 4) the odometry's first pose anew, by registering that scan to those after it.
    scan: (m,) the scan in the middle of each submap, by its place among the poses.
    T_odom_sensor: (m, 4, 4) of that scan as the graph has it; T_correction: (m, 4, 4) from its pose by the odometry to
        that, both in the odometry's frame.
    first, second: (e,) submaps that a registration joins.
    offset: (e,) in standard deviations, how far the solved poses are from what the registration says.
    inlier_share: (e,) share of the second submap that fits the first.
    weight: (e,) how much the registration counted in the end, from 0, where too little fitted, to 1.
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
        """(e,) whether an edge joins two passes; the others join each submap with the two before it."""
        return np.asarray(self.second - self.first > _ALONG)

    @property
    def slips(self) -> IntArray:
        """(k,) the scans near which the odometry slipped, by their places: what joins the way there was let go of. One slip may
        show at several submaps."""
        slipped = ~self.is_loop & (self.weight > 0.0) & (self.weight < _SLIP_WEIGHT)
        return np.unique(self.scan[self.first[slipped]])

    def corrected(self, T_odom_sensor: FloatArray) -> FloatArray:
        """Poses (n, 4, 4) of all scans: each as its two nearest submaps see it, blended between their middles."""
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
class _Edge:
    """The second submap registered to the first."""

    first: int
    second: int
    aligned: Aligned


def close_loops(
    T_odom_sensor: FloatArray, clouds_sensor: Sequence[FloatArray], settings: PoseGraphSettings
) -> PoseGraph:
    """Join submaps of the drive where it comes by again, and solve for their poses.

    T_odom_sensor: (n, 4, 4) of each scan; clouds_sensor: (k, 3) of each, without the motion within its sweep.
    The first submap stays where it is. A drive too short for a submap is left as it is.
    """
    T_odom_first = _first_again(T_odom_sensor, clouds_sensor, settings.submap_scans // 2)
    T_odom_sensor = _with_first(T_odom_sensor, T_odom_first)
    scan = np.arange(0, len(T_odom_sensor), settings.every_scans)
    T_start = T_odom_sensor[scan]

    @lru_cache(maxsize=200)
    def submap(number: int) -> GaussianCloud:
        half = settings.submap_scans // 2
        own = range(max(0, scan[number] - half), min(len(T_odom_sensor), scan[number] + half + 1))
        T_submap_odom = transforms.invert(T_start[number])
        points = [transforms.apply(T_submap_odom @ T_odom_sensor[i], clouds_sensor[i]) for i in own]
        return GaussianCloud(np.concatenate(points))

    T = T_start
    edges: dict[tuple[int, int], _Edge] = {}
    for round_number in range(_ROUNDS_MAX):
        new = sorted(_pairs(T[:, :3, 3], settings.near_m) - edges.keys())
        if not new:
            break
        edges |= {(e.first, e.second): e for e in _register(new, T, submap)}
        # Then the poses are near those that the loops agree on.
        T = _solve(T_start, T, list(edges.values()), _LOSSES if round_number == 0 else _LOSSES[-1:])
    return _answer(T_odom_first, scan, T_start, T, [edges[pair] for pair in sorted(edges)])


def _first_again(
    T_odom_sensor: FloatArray, clouds_sensor: Sequence[FloatArray], half: int
) -> FloatArray:
    """The pose (4, 4) of the first scan by those after it.

    It alone was the map that the second one was registered to, and by its pose the run's map is placed: an error of half a
    degree there turns the whole building. half: the number of scans in half a submap.
    """
    if len(T_odom_sensor) <= half:
        return T_odom_sensor[0] if len(T_odom_sensor) else np.eye(4)
    after = range(1, half + 1)
    points = np.concatenate([transforms.apply(T_odom_sensor[i], clouds_sensor[i]) for i in after])
    # Few scans need larger voxels than elsewhere to hold a turn.
    gaussians = GaussianMap(2.0 * _VOXEL_M)
    gaussians.insert(GaussianCloud(points), np.eye(4))
    first = GaussianCloud(clouds_sensor[0])
    aligned = gaussians.register(first, T_odom_sensor[0], _DISTANCE_M, _ITERATIONS_MAX)
    return aligned.T_map_cloud if aligned.inlier_share >= _INLIER_SHARE_MIN else T_odom_sensor[0]


def _with_first(T_odom_sensor: FloatArray, T_odom_first: FloatArray) -> FloatArray:
    return np.concatenate([T_odom_first[None], T_odom_sensor[1:]]) if len(T_odom_sensor) else T_odom_sensor


def _pairs(position: FloatArray, near_m: float) -> set[tuple[int, int]]:
    """Submaps to be joined: each with those just before it, and with the nearest of each earlier pass."""
    pairs = {(i - back, i) for i in range(len(position)) for back in range(1, _ALONG + 1) if i >= back}
    for i, near in enumerate(
        cKDTree(position).query_ball_point(position, near_m) if len(position) else []
    ):
        passes: list[int] = []
        earlier = np.array([j for j in near if j < i - _ALONG], np.int64)
        for j in earlier[np.argsort(np.linalg.norm(position[earlier] - position[i], axis=1), kind="stable")].tolist():
            if len(passes) == _LOOPS_MAX:
                break
            # Neighbours on the same pass say the same thing.
            if all(abs(j - taken) > _ALONG for taken in passes):
                passes.append(j)
        pairs.update((j, i) for j in passes)
    return pairs


def _register(
    pairs: Sequence[tuple[int, int]],
    T_odom_submap: FloatArray,
    submap: Callable[[int], GaussianCloud],
) -> list[_Edge]:
    """Each second submap registered to its first, from where the poses have it; pairs are sorted by the first."""
    edges: list[_Edge] = []
    mapped, gaussians = -1, GaussianMap(_VOXEL_M)
    for first, second in pairs:
        if first != mapped:
            mapped, gaussians = first, GaussianMap(_VOXEL_M)
            gaussians.insert(submap(first), np.eye(4))
        guess = transforms.invert(T_odom_submap[first]) @ T_odom_submap[second]
        aligned = gaussians.register(submap(second), guess, _DISTANCE_M, _ITERATIONS_MAX)
        edges.append(_Edge(first, second, aligned))
    return edges


def _solve(
    T_start: FloatArray,
    T_guess: FloatArray,
    edges: Sequence[_Edge],
    losses: Sequence[float] = _LOSSES,
) -> FloatArray:
    """Poses (m, 4, 4) that contradict the registrations least, by one loss after another; losses: their widths, as shares of
    `_LOSS_SCALE_SIGMAS`."""
    T = T_guess
    for wider in losses:
        T = _solved(T_start, T, edges, wider * _LOSS_SCALE_SIGMAS)
    return T


def _solved(
    T_start: FloatArray, T_guess: FloatArray, edges: Sequence[_Edge], loss_scale: float
) -> FloatArray:
    """The same by one loss."""
    import gtsam  # noqa: TID251 - its one place; a tenth of a second, in the one process that closes loops

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for number, T in enumerate(T_guess):
        values.insert(number, gtsam.Pose3(T))
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T_start[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    # The odometry's own motion, by half a degree and 5 cm: of weight only where a registration holds nothing.
    way = gtsam.noiseModel.Diagonal.Sigmas(np.array([np.radians(0.5)] * 3 + [0.05] * 3))
    for number in range(1, len(T_start)):
        T_step = transforms.invert(T_start[number - 1]) @ T_start[number]
        graph.add(gtsam.BetweenFactorPose3(number - 1, number, gtsam.Pose3(T_step), way))
    loss = gtsam.noiseModel.mEstimator.Cauchy.Create(loss_scale)
    for edge in edges:
        if edge.aligned.inlier_share < _INLIER_SHARE_MIN:
            continue
        # A direction without hold must not make the graph singular: a standard deviation of a metre and a radian is none.
        held = gtsam.noiseModel.Gaussian.Information(edge.aligned.information + np.eye(6))
        T_first_second = gtsam.Pose3(edge.aligned.T_map_cloud)
        noise = gtsam.noiseModel.Robust.Create(loss, held)
        graph.add(gtsam.BetweenFactorPose3(edge.first, edge.second, T_first_second, noise))
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return np.array([transforms.orthonormal(solved.atPose3(number).matrix()) for number in range(len(T_start))])


def _answer(
    T_odom_first: FloatArray,
    scan: IntArray,
    T_start: FloatArray,
    T: FloatArray,
    edges: Sequence[_Edge],
) -> PoseGraph:
    first = np.array([e.first for e in edges], np.int64)
    second = np.array([e.second for e in edges], np.int64)
    inlier_share = np.array([e.aligned.inlier_share for e in edges])
    offset = np.array([_offset(e, T) for e in edges])
    loss = 1.0 / (1.0 + (offset / _LOSS_SCALE_SIGMAS) ** 2)
    return PoseGraph(
        T_odom_first=T_odom_first,
        scan=scan,
        T_odom_sensor=T,
        T_correction=T @ transforms.invert(T_start),
        first=first,
        second=second,
        offset=offset,
        inlier_share=inlier_share,
        weight=np.where(inlier_share >= _INLIER_SHARE_MIN, loss, 0.0),
    )


def _offset(edge: _Edge, T: FloatArray) -> float:
    """In standard deviations of the registration; along a direction that it does not hold nothing is off."""
    T_solved = transforms.invert(T[edge.first]) @ T[edge.second]
    off = transforms.to_twist(transforms.invert(edge.aligned.T_map_cloud) @ T_solved)
    return float(np.sqrt(np.maximum(off @ edge.aligned.information @ off, 0.0)))
