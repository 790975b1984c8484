"""Register horizontal scans by KISS-ICP (paper, IV.A, there BLAM); the only import of kiss_icp."""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.base.trajectory import GAP_PERIODS
from ffmap.algorithms.poses.motion import extrapolate, may_change, seen_at
from ffmap.algorithms.poses.refinement import (
    WEAK_INLIER_SHARE,
    WEAK_SHARE,
    Refinement,
    RefinementSettings,
    Refiner,
)
from ffmap.algorithms.poses.relocalization import LOST_DISTANCE_M, is_clear

if TYPE_CHECKING:
    from kiss_icp.config import KISSConfig  # noqa: TID251 - its one place

_RETRY_NS = 1_000_000_000
"""Time between two searches for a lost pose: a search takes as long as ten scans."""
_STEP_MIN_NS = 5_000_000
"""Minimum time between two poses: no lidar spins faster; noise would look like motion."""
_RECENT_STEPS = 20
"""Number of steps whose median is the period."""
_EVIDENCE_EVERY_SCANS = 10
"""The local map and the residual are kept for every n-th scan."""


class OdometrySettings(StepSettings):
    """KISS-ICP (Vizzo et al. 2023), in place of the paper's BLAM (IV.A)."""

    voxel_m: float = Field(
        0.25, ge=0.01, le=5, description="Edge (m) of the local map's voxels. KISS-ICP."
    )
    range_min_m: float = Field(
        0.5, ge=0, description="Minimum range (m): nearer returns are the robot's own. KISS-ICP."
    )
    range_max_m: float = Field(
        60.0, gt=0, description="Maximum range (m) of the returns that are used. KISS-ICP."
    )
    points_max: int = Field(
        4_000,
        ge=100,
        description="Maximum number of returns, about; denser clouds are thinned evenly: this pose "
        "is only the refinement's first guess. KISS-ICP.",
    )


@dataclass(frozen=True)
class Registration:
    """One registered horizontal scan.

    index: of the scan's cloud in the bag.
    stamp_ns: time of the pose: the middle of the sweep.
    T_odom_sensor: (4, 4) at that time; odom is the sensor's frame at the first scan.
    keypoints_sensor: (k, 3) float32, the registered returns as seen at that time: of both lidars,
        or KISS-ICP's if poses are not refined.
    local_map_odom: (m, 3) float32, KISS-ICP's local map, moved as the pose was refined; empty
        except for every `_EVIDENCE_EVERY_SCANS`-th scan.
    threshold_m: KISS-ICP's adaptive correspondence threshold.
    correction_m: distance between the constant-velocity prediction and KISS-ICP's pose.
    residual_m: median distance of the keypoints to the local map; NaN without a local map.
    inlier_share: share of keypoints nearer to it than the threshold; NaN without a local map.
    refined_m: distance between KISS-ICP's pose and the refined pose.
    refined_inlier_share, weakest_share, refused, agreement, rival: see `Refinement`; NaN and False
        if poses are not refined. The first is NaN for the second scan, too.
    milliseconds: duration of registration and refinement.
    """

    index: int
    stamp_ns: int
    T_odom_sensor: FloatArray
    keypoints_sensor: FloatArray
    local_map_odom: FloatArray
    threshold_m: float
    correction_m: float
    residual_m: float
    inlier_share: float
    refined_m: float
    refined_inlier_share: float
    weakest_share: float
    refused: bool
    agreement: float
    rival: float
    milliseconds: float


def register_scans(
    scans: Iterable[tuple[int, Scan, Scan | None]],
    settings: OdometrySettings,
    refinement: RefinementSettings,
    T_sensor_companion: FloatArray | None = None,
    T_base_sensor: FloatArray | None = None,
    on_failure: Callable[[int, Scan, Exception], None] | None = None,
) -> Iterator[Registration]:
    """Register scans one after another to the map that they build.

    Scans after a gap that match nothing in the map have no pose, until one does.

    scans: index, scan, and the last scan of the other lidar, if any, that ended before it. A scan
        that is not later than the last one, or determines no pose, is skipped.
    T_sensor_companion, T_base_sensor: (4, 4) extrinsics, see `Refiner`.
    on_failure: called for a scan whose registration raises an exception, which then has no pose;
        None to raise it.
    """
    registrar = _Registrar(settings, refinement, T_sensor_companion, T_base_sensor)
    lost_ns: int | None = None
    for index, scan, companion in scans:
        if lost_ns is not None and scan.reference_ns - lost_ns < _RETRY_NS:
            continue
        if not (registrar.is_next(scan) and _determines_pose(scan, settings)):
            continue
        try:
            found = registrar.register(index, scan, companion)
        except Exception as error:
            if on_failure is None or isinstance(error, MemoryError | OSError):
                raise
            on_failure(index, scan, error)
            continue
        lost_ns = scan.reference_ns if found is None else None
        if found is not None:
            yield found


class _Registrar:
    """KISS-ICP, the refinement of its poses, and the motion so far."""

    def __init__(
        self,
        settings: OdometrySettings,
        refinement: RefinementSettings,
        T_sensor_companion: FloatArray | None,
        T_base_sensor: FloatArray | None,
    ) -> None:
        from kiss_icp.kiss_icp import KissICP  # noqa: TID251 - its one place; takes 0.2 s

        self._settings = settings
        self._range_m = settings.range_min_m, settings.range_max_m
        self._kiss = KissICP(_configuration(settings))
        self._refiner: Refiner | None = None
        if refinement.enabled:
            self._refiner = Refiner(refinement, self._range_m, T_sensor_companion, T_base_sensor)
        self._last: Refinement | None = None
        self._count = 0
        self._steps_ns: deque[int] = deque(maxlen=_RECENT_STEPS)

    def is_next(self, scan: Scan) -> bool:
        """Whether a scan is later than the last one; otherwise noise would look like motion."""
        return self._last is None or scan.reference_ns - self._last.stamp_ns >= _STEP_MIN_NS

    def register(self, index: int, scan: Scan, companion: Scan | None) -> Registration | None:
        """Register a scan; None where it matches nothing after a gap."""
        kiss, last, stamp_ns = self._kiss, self._last, scan.reference_ns
        threshold_m = float(kiss.adaptive_threshold.get_threshold())
        keep_evidence = self._count % _EVIDENCE_EVERY_SCANS == 0
        local_map = kiss.local_map.point_cloud() if keep_evidence else np.zeros((0, 3))
        started = time.perf_counter()
        motion_per_ns: FloatArray = np.zeros(6)
        after_gap = False
        if last is not None:
            motion_per_ns = last.motion_per_ns
            after_gap = self._is_gap(stamp_ns - last.stamp_ns)
            kiss.last_delta = extrapolate(np.eye(4), motion_per_ns, stamp_ns - last.stamp_ns)
        if after_gap and self._refiner:
            # The refinement tries other poses too; KISS-ICP starts anew.
            kiss.local_map.clear()
        T_prediction = kiss.last_pose @ kiss.last_delta
        points = seen_at(stamp_ns, scan, motion_per_ns, self._range_m, self._settings.points_max)
        # Without times: the points are compensated already.
        _, keypoints = kiss.register_frame(points, np.zeros(0))
        T_kiss = kiss.last_pose.copy()
        if self._refiner:
            refined = self._refiner.refine(scan, T_kiss, companion, after_gap)
        else:
            refined = _unrefined(stamp_ns, T_kiss, keypoints, last)
        if refined is None:
            return None
        milliseconds = 1e3 * (time.perf_counter() - started)
        if last is not None:
            self._steps_ns.append(stamp_ns - last.stamp_ns)
        self._last = refined
        self._count += 1
        residual_m, inlier_share = _residual(keypoints, local_map, T_kiss, threshold_m)
        T_prediction_kiss = transforms.invert(T_prediction) @ T_kiss
        T_refined = refined.T_odom_sensor
        T_refined_kiss = T_refined @ transforms.invert(T_kiss)
        return Registration(
            index=index,
            stamp_ns=stamp_ns,
            T_odom_sensor=T_refined,
            keypoints_sensor=refined.cloud_sensor,
            local_map_odom=transforms.apply(T_refined_kiss, local_map).astype(np.float32),
            threshold_m=threshold_m,
            correction_m=float(np.linalg.norm(T_prediction_kiss[:3, 3])),
            residual_m=residual_m,
            inlier_share=inlier_share,
            refined_m=float(np.linalg.norm(T_refined[:3, 3] - T_kiss[:3, 3])),
            # The map of one scan holds too little of the building to judge the second scan by.
            refined_inlier_share=float("nan") if self._count == 2 else refined.inlier_share,
            weakest_share=refined.weakest_share,
            refused=refined.refused,
            agreement=refined.agreement,
            rival=refined.rival,
            milliseconds=milliseconds,
        )

    def _is_gap(self, elapsed_ns: int) -> bool:
        """Whether the sensor may have moved by more than `LOST_DISTANCE_M` unexpectedly."""
        is_long = elapsed_ns > GAP_PERIODS * np.median([*self._steps_ns, elapsed_ns])
        return bool(is_long) and may_change(elapsed_ns).metres > LOST_DISTANCE_M


def weakness(registration: Registration) -> str | None:
    """Why a registration is unreliable; None if it is reliable.

    A scan slides in directions that do not constrain it while all of its points fit; no residual
    shows that (Zhang, Kaess and Singh 2016, "On degeneracy of optimization-based state estimation
    problems").
    """
    if registration.refused:
        return "it jumped away from the motion and was refused"
    if registration.refined_inlier_share < WEAK_INLIER_SHARE:
        return f"only {registration.refined_inlier_share:.0%} of the scan fits the map"
    if registration.weakest_share < WEAK_SHARE:
        share = f"{registration.weakest_share:.1%}"
        return f"one direction is not constrained ({share} of the information in the best one)"
    return None


def doubt(registration: Registration) -> str | None:
    """Why a scan after a gap, and all after it, may be at a wrong place; None if it is not."""
    if np.isnan(registration.agreement):
        return None
    if registration.refused:
        return "nothing of the map is in sight; the motion was extrapolated"
    if is_clear(registration.agreement, registration.rival):
        return None
    return "the scan fits another place as well"


def _configuration(settings: OdometrySettings) -> "KISSConfig":
    from kiss_icp.config import KISSConfig, config  # noqa: TID251 - its one place

    return KISSConfig(
        data=config.DataConfig(
            max_range=settings.range_max_m, min_range=settings.range_min_m, deskew=False
        ),
        mapping=config.MappingConfig(voxel_size=settings.voxel_m, max_points_per_voxel=5),
        registration=config.RegistrationConfig(
            max_num_iterations=300,
            convergence_criterion=3e-3,  # m and rad
            max_num_threads=1,  # reproducible
        ),
        adaptive_threshold=config.AdaptiveThresholdConfig(
            initial_threshold=0.5,  # m
            min_motion_th=0.05,  # m
        ),
    )


def _determines_pose(scan: Scan, settings: OdometrySettings) -> bool:
    """Whether the returns in range are in three voxels that are not in a line.

    KISS-ICP aborts the process otherwise.
    """
    # A thousand returns are enough.
    points = scan.points_sensor[:: max(1, len(scan) // 1_000)].astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    points = points[(range_m > settings.range_min_m) & (range_m < settings.range_max_m)]
    voxels = np.floor(points / settings.voxel_m).astype(np.int64)
    _, first = np.unique(voxels @ [1 << 42, 1 << 21, 1], return_index=True)
    occupied = voxels[first]
    if len(occupied) < 3:
        return False
    centred = occupied - occupied.mean(axis=0)
    spread = np.linalg.svd(centred / np.sqrt(len(occupied)), compute_uv=False)
    return bool(spread[1] > 0.5)  # voxels, in a second direction


def _unrefined(
    stamp_ns: int, T_kiss: FloatArray, keypoints: FloatArray, last: Refinement | None
) -> Refinement:
    motion_per_ns = np.zeros(6)
    if last is not None:
        way = transforms.to_twist(transforms.invert(last.T_odom_sensor) @ T_kiss)
        motion_per_ns = way / (stamp_ns - last.stamp_ns)
    return Refinement(
        stamp_ns=stamp_ns,
        T_odom_sensor=T_kiss,
        motion_per_ns=motion_per_ns,
        cloud_sensor=keypoints.astype(np.float32),
        inlier_share=float("nan"),
        weakest_share=float("nan"),
    )


def _residual(
    keypoints_sensor: FloatArray,
    local_map_odom: FloatArray,
    T_odom_sensor: FloatArray,
    threshold_m: float,
) -> tuple[float, float]:
    if not len(local_map_odom) or not len(keypoints_sensor):
        return float("nan"), float("nan")
    keypoints_odom = transforms.apply(T_odom_sensor, keypoints_sensor)
    distance_m, _ = cKDTree(local_map_odom).query(keypoints_odom)
    return float(np.median(distance_m)), float(np.mean(distance_m < threshold_m))
