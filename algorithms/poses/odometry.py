"""From horizontal scans to poses by KISS-ICP (paper, IV.A, where it was BLAM); the only file that imports kiss_icp."""

import time
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
from ffmap.algorithms.poses.refinement import (
    LOST_DISTANCE_M,
    WEAK_INLIER_SHARE,
    WEAK_SHARE,
    Refinement,
    RefinementSettings,
    Refiner,
    is_clear,
    may_change,
    middle_ns,
)

if TYPE_CHECKING:
    from kiss_icp.config import KISSConfig  # noqa: TID251 - its one place

_RETRY_NS = 1_000_000_000  # after so long the sensor may see what the map holds: a search takes as long as ten scans
_STEP_MIN_NS = 5_000_000
"""Minimum time between two poses: no lidar sweeps faster, and over less time their errors would look like fast motion."""
_POINTS_PER_VOXEL = 5
"""Maximum number of points in a voxel of the local map. KISS-ICP."""
_THRESHOLD_INITIAL_M = 0.5
"""First correspondence threshold (m), before it adapts. KISS-ICP."""
_MOTION_MIN_M = 0.05
"""Minimum deviation (m) that adapts the threshold. KISS-ICP."""
_ITERATIONS_MAX = 300
"""Maximum number of ICP iterations for a scan. KISS-ICP."""
_CONVERGENCE_M_RAD = 3e-3
"""ICP stops at a smaller step (m and rad). KISS-ICP."""
_EVIDENCE_EVERY_SCANS = 10
"""The local map and the residual are kept for every n-th scan. KISS-ICP."""


class OdometrySettings(StepSettings):
    """KISS-ICP (Vizzo et al. 2023), in place of the paper's BLAM (IV.A)."""

    voxel_m: float = Field(0.25, ge=0.01, le=5, description="Edge (m) of the local map's voxels. KISS-ICP.")
    range_min_m: float = Field(
        0.5, ge=0, description="Minimum range (m): nearer returns are the robot itself. KISS-ICP."
    )
    range_max_m: float = Field(60.0, gt=0, description="Maximum range (m) of the returns that are used. KISS-ICP.")
    points_max: int = Field(
        4_000,
        ge=100,
        description="Maximum number of returns; denser clouds are thinned evenly: the refinement only starts from this pose. "
        "KISS-ICP.",
    )
    deskew: bool = Field(True, description="Compensate the motion within a sweep where the cloud has times. KISS-ICP.")
    threads: int = Field(
        1, ge=0, le=256, description="KISS-ICP's threads; 1 is reproducible, 0 takes all cores. KISS-ICP."
    )


@dataclass(frozen=True)
class Registration:
    """One horizontal scan registered.

    index: of the scan's cloud in the bag.
    stamp_ns: the time of the pose: the middle of the sweep; where poses are not refined, the END of the sweep (KISS-ICP's
        convention with motion compensation).
    T_odom_sensor: (4, 4) at that time, refined; odom is the sensor's frame at the first scan.
    keypoints_sensor: (k, 3) float32, the thinned returns that were registered, as they are seen at that time: of both
        lidars; where poses are not refined, KISS-ICP's own of the one.
    local_map_odom: (m, 3) float32, the local map that they were registered to, moved as the pose was refined; empty
        but for every `_EVIDENCE_EVERY_SCANS`-th scan.
    threshold_m: KISS-ICP's adaptive correspondence threshold.
    correction_m: how far the registration moved the constant-velocity prediction.
    residual_m: median distance of the keypoints to the local map; NaN where that was not kept.
    inlier_share: share of keypoints nearer to the local map than the threshold; NaN likewise.
    refined_m: how far the refinement has moved the pose, all scans until this one together.
    refined_inlier_share, weakest_share, refused, agreement, rival: see `Refinement`; NaN, and False, where poses are not refined.
        The first is NaN for the second scan, too.
    milliseconds: what registration and refinement took.
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
    """Register scans one after another to the map that they build; yields one `Registration` for each that holds a pose.

    What was seen after a gap and is found nowhere in the map has no pose, until a scan is found.

    scans: index, scan, and the last scan of the other lidar, if any, that ended before it. A scan that is not later than the
        last pose gets none.
    T_sensor_companion: (4, 4) where the other lidar sits. T_base_sensor: where this one sits; see `Refiner`.
    on_failure: takes each scan whose registration raised an exception, which has no pose then; None to let it through.
    """
    # Imported here, for a fifth of a second: its settings are asked for everywhere, and scans registered in one process.
    from kiss_icp.kiss_icp import KissICP  # noqa: TID251 - its one place

    range_m = (settings.range_min_m, settings.range_max_m)
    refiner = Refiner(refinement, range_m, T_sensor_companion, T_base_sensor) if refinement.enabled else None
    odometry = KissICP(_configuration(settings))
    stamps_ns: list[int] = []
    tried_ns: int | None = None
    sound = ((index, scan, other) for index, scan, other in scans if holds_a_pose(scan, settings))
    registrable = _in_order(sound, refinement.enabled)
    for number, (index, scan, companion) in enumerate(registrable):
        threshold_m = float(odometry.adaptive_threshold.get_threshold())
        keep_evidence = number % _EVIDENCE_EVERY_SCANS == 0
        local_map = odometry.local_map.point_cloud() if keep_evidence else np.zeros((0, 3))
        started = time.perf_counter()
        if tried_ns is not None and middle_ns(scan) - tried_ns < _RETRY_NS:
            continue
        stamps_ns.append(middle_ns(scan))
        periods = _periods_of_a_gap(stamps_ns)
        if periods:
            # Where the motion so far leads; the refinement looks for other places too, and KISS-ICP starts anew there.
            way = np.linalg.matrix_power(odometry.last_delta, periods - 1)
            odometry.last_pose = transforms.orthonormal(odometry.last_pose @ way)
            if refiner:
                odometry.local_map.clear()
        T_prediction = odometry.last_pose @ odometry.last_delta
        stride = -(-len(scan) // settings.points_max)
        try:
            _, keypoints = odometry.register_frame(
                scan.points_sensor[::stride].astype(np.float64), _sweep_fraction(scan)[::stride]
            )
            T_kiss = odometry.last_pose.copy()
            nan, kept = float("nan"), keypoints.astype(np.float32)
            unrefined = Refinement(scan.end_ns, T_kiss, T_kiss, nan, nan, False, nan, nan, kept)
            refined = refiner.refine(scan, T_kiss, companion, after_gap=periods > 0) if refiner else unrefined
        except Exception as error:
            if on_failure is None or isinstance(error, MemoryError | OSError):
                raise
            on_failure(index, scan, error)
            stamps_ns.pop()
            continue
        tried_ns = stamps_ns.pop() if refined is None else None
        if refined is None:
            continue
        milliseconds = 1e3 * (time.perf_counter() - started)
        residual_m, inlier_share = _residual(keypoints, local_map, T_kiss, threshold_m)
        T_refined_kiss = refined.T_odom_sensor_end @ transforms.invert(T_kiss)
        yield Registration(
            index=index,
            stamp_ns=refined.stamp_ns,
            T_odom_sensor=refined.T_odom_sensor,
            keypoints_sensor=refined.cloud_sensor,
            local_map_odom=transforms.apply(T_refined_kiss, local_map).astype(np.float32),
            threshold_m=threshold_m,
            correction_m=float(np.linalg.norm((transforms.invert(T_prediction) @ T_kiss)[:3, 3])),
            residual_m=residual_m,
            inlier_share=inlier_share,
            refined_m=float(np.linalg.norm(refined.T_odom_sensor_end[:3, 3] - T_kiss[:3, 3])),
            # The map of one scan holds too little of the building to judge the second scan by.
            refined_inlier_share=nan if number == 1 else refined.inlier_share,
            weakest_share=refined.weakest_share,
            refused=refined.refused,
            agreement=refined.agreement,
            rival=refined.rival,
            milliseconds=milliseconds,
        )


def _configuration(settings: OdometrySettings) -> "KISSConfig":
    from kiss_icp.config import KISSConfig  # noqa: TID251 - its one place
    from kiss_icp.config.config import AdaptiveThresholdConfig, DataConfig, MappingConfig, RegistrationConfig  # noqa: TID251 - its one place

    return KISSConfig(
        data=DataConfig(max_range=settings.range_max_m, min_range=settings.range_min_m, deskew=settings.deskew),
        mapping=MappingConfig(voxel_size=settings.voxel_m, max_points_per_voxel=_POINTS_PER_VOXEL),
        registration=RegistrationConfig(
            max_num_iterations=_ITERATIONS_MAX,
            convergence_criterion=_CONVERGENCE_M_RAD,
            max_num_threads=settings.threads,
        ),
        adaptive_threshold=AdaptiveThresholdConfig(
            initial_threshold=_THRESHOLD_INITIAL_M, min_motion_th=_MOTION_MIN_M
        ),
    )


def holds_a_pose(scan: Scan, settings: OdometrySettings) -> bool:
    """Whether a scan has returns in range at enough places, and not all in a line: KISS-ICP ends the program otherwise."""
    # Of a sound scan, a thousand returns show it.
    points = scan.points_sensor[:: max(1, len(scan) // 1_000)].astype(np.float64)
    range_m = np.linalg.norm(points, axis=1)
    points = points[(range_m > settings.range_min_m) & (range_m < settings.range_max_m)]
    voxels = np.floor(points / settings.voxel_m).astype(np.int64)
    _, first = np.unique(voxels @ [1 << 42, 1 << 21, 1], return_index=True)
    places = voxels[first]
    if len(places) < 3:
        return False
    spread = np.linalg.svd((places - places.mean(axis=0)) / np.sqrt(len(places)), compute_uv=False)
    return bool(spread[1] > 0.5)  # voxels, in a second direction


def _in_order(
    scans: Iterable[tuple[int, Scan, Scan | None]], at_middle: bool
) -> Iterator[tuple[int, Scan, Scan | None]]:
    """The scans whose poses, of their middle or of their end, are of later and later times."""
    last_ns: int | None = None
    for index, scan, companion in scans:
        stamp_ns = middle_ns(scan) if at_middle else scan.end_ns
        if last_ns is None or stamp_ns - last_ns >= _STEP_MIN_NS:
            last_ns = stamp_ns
            yield index, scan, companion


def _periods_of_a_gap(stamps_ns: list[int]) -> int:
    """How many usual steps the last one is; 0 unless it is a gap that a sensor may get lost in.

    That is, in which it may go farther than `LOST_DISTANCE_M`.
    """
    if len(stamps_ns) < 2 or may_change(stamps_ns[-1] - stamps_ns[-2]).metres <= LOST_DISTANCE_M:
        return 0
    steps = np.diff(np.array(stamps_ns, np.int64))
    return round(steps[-1] / np.median(steps)) if steps[-1] > GAP_PERIODS * np.median(steps) else 0


def weakness(registration: Registration) -> str | None:
    """In words, why a registration is not to be relied on; None where nothing speaks against it.

    A scan slides along what does not hold it while all of its points fit: no residual shows that (Zhang, Kaess and Singh
    2016, "On degeneracy of optimization-based state estimation problems").
    """
    if registration.refused:
        return "it jumped away from the motion and was refused"
    if registration.refined_inlier_share < WEAK_INLIER_SHARE:
        return f"only {registration.refined_inlier_share:.0%} of the scan fits the map"
    if registration.weakest_share < WEAK_SHARE:
        return f"nothing holds it in one direction ({registration.weakest_share:.1%} of the best one's hold)"
    return None


def doubt(registration: Registration) -> str | None:
    """In words, why a scan after a gap may be placed wrongly, and all after it; None where it is not."""
    if np.isnan(registration.agreement):
        return None
    if registration.refused:
        return "nothing of the map is in sight; the motion before was carried on"
    if is_clear(registration.agreement, registration.rival):
        return None
    return "what is seen there fits another place as well"


def _sweep_fraction(scan: Scan) -> FloatArray:
    """Time of each return from 0 to 1 over the sweep; empty, which leaves motion uncompensated, without times.

    KISS-ICP divides by the span of the times, and ends the program where they are all the same.
    """
    if scan.time_ns is None or scan.time_ns.min(initial=0) == scan.time_ns.max(initial=0):
        return np.zeros(0)
    return np.asarray(scan.time_ns / max(int(scan.time_ns.max(initial=0)), 1), np.float64)


def _residual(
    keypoints_sensor: FloatArray, local_map_odom: FloatArray, T_odom_sensor: FloatArray, threshold_m: float
) -> tuple[float, float]:
    if not len(local_map_odom) or not len(keypoints_sensor):
        return float("nan"), float("nan")
    distance_m, _ = cKDTree(local_map_odom).query(transforms.apply(T_odom_sensor, keypoints_sensor))
    return float(np.median(distance_m)), float(np.mean(distance_m < threshold_m))
