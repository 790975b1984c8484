"""Refine poses by VGICP: register each scan, with the other lidar's, to a map of Gaussians."""

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from pydantic import Field

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.poses.gaussian_map import Aligned, GaussianCloud, GaussianMap
from ffmap.algorithms.poses.motion import Change, extrapolate, may_change, seen_at
from ffmap.algorithms.poses.relocalization import ITERATIONS_MAX, LOST_DISTANCE_M, Relocalizer

_BLIND_NS = 2_000_000_000
"""Maximum time over which a motion is extrapolated where nothing fits: robots change theirs."""
_FIT_DROP_MAX = 0.03
"""A scan with a smaller share of inliers than the last one by more than this is registered from the
other guesses too, and from all within two thirds of the distance; the best fit counts."""
_MEMORY_SCANS = 50
"""Number of scans after which a voxel without points is removed; the pose graph closes loops."""
WEAK_SHARE = 0.012
"""Minimum information in a scan's weakest direction, as a share of that in its strongest; along a
bare corridor it is less, and the registration is weak."""
WEAK_INLIER_SHARE = 0.4
"""Minimum share of inliers; with less, the registration is weak."""
_PASSES_MAX = 3
"""Maximum number of times that a sweep is compensated and registered, each time by the motion that
the last registration found."""
_BEND = Change(degrees=0.25, metres=0.01)
"""Maximum error over half a sweep of the motion by which it was compensated."""


class RefinementSettings(StepSettings):
    """Registering each scan again, to a map of Gaussians (the paper's poses are BLAM's, IV.A)."""

    enabled: bool = Field(
        True, description="Whether poses are refined; if not, they are KISS-ICP's."
    )
    voxel_m: float = Field(
        0.2,
        ge=0.01,
        le=5,
        description="Edge (m) of the voxels of one Gaussian each: larger ones would blend the two "
        "sides of a wall.",
    )
    points_max: int = Field(
        6_000,
        ge=100,
        description="Maximum number of returns of a scan, about; denser ones are thinned evenly.",
    )
    companion_points_max: int = Field(
        5_000,
        ge=0,
        description="Maximum number of returns of the other lidar, which sees floor and ceiling; "
        "they are registered together.",
    )
    distance_m: float = Field(
        0.12,
        gt=0,
        description="Maximum distance (m) of a point from its Gaussian: less than the thickness of "
        "a wall, whose other side comes into view in a doorway.",
    )


@dataclass(frozen=True)
class Refinement:
    """A scan registered again.

    stamp_ns: the middle of the sweep. T_odom_sensor: (4, 4) at that time.
    motion_per_ns: (6,) since the last scan; see motion.py.
    cloud_sensor: (k, 3) float32, the registered returns of both lidars, as seen at `stamp_ns`.
    inlier_share: share of the cloud that has a Gaussian; 1 for the first scan.
    weakest_share: information in the weakest direction, as a share of that in the strongest; near 0
        in a bare corridor. 1 for the first scan.
    refused: whether the registration jumped. The pose is then where the odometry's motion leads.
    agreement, rival: after a gap, with the surfaces seen before, at this pose and at the best other
        one; see `Relocalized`. NaN elsewhere.
    """

    stamp_ns: int
    T_odom_sensor: FloatArray
    motion_per_ns: FloatArray
    cloud_sensor: FloatArray
    inlier_share: float = 1.0
    weakest_share: float = 1.0
    refused: bool = False
    agreement: float = float("nan")
    rival: float = float("nan")


class _Fit(NamedTuple):
    """A registration, and whether it jumped."""

    aligned: Aligned
    jumped: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """Smaller is better."""
        return self.jumped, -self.aligned.inlier_share


class Refiner:
    """Registers scan after scan to the map that the earlier ones made.

    A sweep is compensated to its middle by the motion of the refined poses: an error of this motion
    bends both halves of a sweep the opposite way and leaves the pose as it is. (The odometry's own
    motion is noisy where few returns constrain it.) The first motion is found with the second scan,
    starting from rest; the first scan is then compensated again.

    range_m: minimum and maximum range of the returns that are used.
    T_sensor_companion: (4, 4) extrinsics of the other lidar, if there is one.
    T_base_sensor: (4, 4) extrinsics on a base that is level at the start; None: z points up.
    """

    def __init__(
        self,
        settings: RefinementSettings,
        range_m: tuple[float, float],
        T_sensor_companion: FloatArray | None = None,
        T_base_sensor: FloatArray | None = None,
    ) -> None:
        self._settings = settings
        self._range_m = range_m
        self._T_sensor_companion = T_sensor_companion
        self._map = GaussianMap(settings.voxel_m, _MEMORY_SCANS)
        T_level_odom = np.eye(4) if T_base_sensor is None else T_base_sensor
        self._relocalizer = Relocalizer(settings.distance_m, T_level_odom)
        self._last: Refinement | None = None
        self._T_odometry_last: FloatArray = np.eye(4)
        self._first: tuple[Scan, Scan | None] | None = None
        self._trusted_ns = 0

    def refine(
        self,
        scan: Scan,
        T_odometry: FloatArray,
        companion: Scan | None = None,
        after_gap: bool = False,
    ) -> Refinement | None:
        """Register a scan, and with it the last one of the other lidar that ended before it.

        T_odometry: the odometry's pose (4, 4) in the middle of the sweep. after_gap: whether the
        scan may be anywhere within reach. None, without any effect on later scans, if it is then
        found nowhere and the gap is too long to extrapolate the motion.
        """
        stamp_ns = scan.reference_ns
        if self._last is None:
            motionless = np.zeros(6)
            cloud = self._compensated(scan, companion, stamp_ns, motionless)
            found = Refinement(stamp_ns, T_odometry, motionless, cloud.points)
            self._first = scan, companion
        elif after_gap:
            found, cloud = self._relocalize(scan, companion, self._last)
            if found.refused:
                if stamp_ns - self._last.stamp_ns > _BLIND_NS:
                    return None
                # The map must not mix returns of a guessed pose with earlier ones.
                self._map = GaussianMap(self._settings.voxel_m, _MEMORY_SCANS)
            self._first = None
        else:
            found, cloud = self._track(scan, companion, self._last, T_odometry)
            self._first = None
        if not found.refused:
            self._trusted_ns = stamp_ns
        self._map.insert(cloud, found.T_odom_sensor)
        self._relocalizer.remember(found.T_odom_sensor, found.cloud_sensor)
        self._last, self._T_odometry_last = found, T_odometry
        return found

    def _relocalize(
        self, scan: Scan, companion: Scan | None, last: Refinement
    ) -> tuple[Refinement, GaussianCloud]:
        stamp_ns = scan.reference_ns
        found = self._relocalizer.find(
            lambda motion_per_ns: self._compensated(scan, companion, stamp_ns, motion_per_ns),
            self._map,
            last.T_odom_sensor,
            last.motion_per_ns,
            stamp_ns - last.stamp_ns,
        )
        refinement = Refinement(
            stamp_ns=stamp_ns,
            T_odom_sensor=found.aligned.T_map_cloud,
            motion_per_ns=found.motion_per_ns,
            cloud_sensor=found.cloud.points,
            inlier_share=found.aligned.inlier_share,
            weakest_share=found.aligned.weakest_share,
            refused=found.refused,
            agreement=found.agreement,
            rival=found.rival,
        )
        return refinement, found.cloud

    def _track(
        self, scan: Scan, companion: Scan | None, last: Refinement, T_odometry: FloatArray
    ) -> tuple[Refinement, GaussianCloud]:
        """Register a scan from where the motion leads, and else from where the odometry's does."""
        stamp_ns = scan.reference_ns
        elapsed_ns = stamp_ns - last.stamp_ns
        change = may_change(stamp_ns - self._trusted_ns)
        motion_per_ns = last.motion_per_ns
        expected: list[FloatArray] = [
            extrapolate(last.T_odom_sensor, motion_per_ns, elapsed_ns),
            last.T_odom_sensor @ transforms.invert(self._T_odometry_last) @ T_odometry,
        ]
        guesses = expected
        usual = max(WEAK_INLIER_SHARE, last.inlier_share - _FIT_DROP_MAX)
        for number in range(_PASSES_MAX):
            if self._first is not None:
                first = self._compensated(*self._first, last.stamp_ns, motion_per_ns)
                self._map = GaussianMap(self._settings.voxel_m, _MEMORY_SCANS)
                self._map.insert(first, last.T_odom_sensor)
            swept = self._compensated(scan, companion, stamp_ns, motion_per_ns)
            fit = self._register(swept, guesses, expected, change, usual)
            if number and fit.jumped:
                break
            aligned, cloud, assumed_per_ns = fit.aligned, swept, motion_per_ns
            lost = fit.jumped or not aligned.inlier_share
            T = expected[-1] if lost else aligned.T_map_cloud
            way = transforms.to_twist(transforms.invert(last.T_odom_sensor) @ T)
            motion_per_ns = way / elapsed_ns
            found = Refinement(
                stamp_ns=stamp_ns,
                T_odom_sensor=T,
                motion_per_ns=motion_per_ns,
                cloud_sensor=cloud.points,
                inlier_share=aligned.inlier_share,
                weakest_share=aligned.weakest_share,
                refused=fit.jumped,
            )
            bend = (motion_per_ns - assumed_per_ns) * (scan.end_ns - stamp_ns)
            # A refused registration does not show how the sensor moved within the sweep.
            settled = fit.jumped or _BEND.share_of(bend) <= 1.0
            if self._first is None and settled:
                break
            guesses = [T, *expected]
        return found, cloud

    def _register(
        self,
        cloud: GaussianCloud,
        guesses: list[FloatArray],
        expected: list[FloatArray],
        change: Change,
        share_usual: float,
    ) -> _Fit:
        """Register a cloud from the guesses, and from farther where it jumps or hardly fits.

        A jump differs from all expected poses by more than `change`: the scan matched another place
        that looks like this one.
        """

        def best_fit(guesses: list[FloatArray], *distances_m: float, share_min: float) -> _Fit:
            """The first registration with enough inliers that is no jump, or else the best."""
            fits: list[_Fit] = []
            for distance_m, guess in product(distances_m, guesses):
                found = self._map.register(cloud, guess, distance_m, ITERATIONS_MAX)
                off = min(change.share_between(T, found.T_map_cloud) for T in expected)
                fits.append(_Fit(found, found.inlier_share > 0 and off > 1.0))
                if not fits[-1].jumped and found.inlier_share >= share_min:
                    return fits[-1]
            return min(fits, key=lambda fit: fit.rank)

        near_m = self._settings.distance_m
        fit = best_fit(guesses, near_m, 2 / 3 * near_m, share_min=share_usual)
        if not fit.jumped and fit.aligned.inlier_share >= WEAK_INLIER_SHARE:
            return fit
        lost = best_fit(guesses, LOST_DISTANCE_M, share_min=WEAK_INLIER_SHARE)
        # Within a larger distance more inliers are found: shares are compared at the same distance.
        near = best_fit([lost.aligned.T_map_cloud], near_m, share_min=share_usual)
        return min(fit, near, key=lambda fit: fit.rank)

    def _compensated(
        self, scan: Scan, companion: Scan | None, stamp_ns: int, motion_per_ns: FloatArray
    ) -> GaussianCloud:
        """Both lidars' returns, thinned, as seen at a time, with their covariances."""
        settings, range_m = self._settings, self._range_m
        points = seen_at(stamp_ns, scan, motion_per_ns, range_m, settings.points_max)
        others_max, T_sensor_companion = settings.companion_points_max, self._T_sensor_companion
        if companion is None or T_sensor_companion is None or not others_max:
            return GaussianCloud(points)
        others = seen_at(
            stamp_ns, companion, motion_per_ns, range_m, others_max, T_sensor_companion
        )
        return GaussianCloud(np.concatenate([points, others]))
