"""Poses of a run: the odometry in the levelled map, or poses that are given."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.levelling import Level
from ffmap.algorithms.poses.odometry import Registration, weakness
from ffmap.app.record.odometry import log_odometry_frame, log_pose_graph, log_registration
from ffmap.app.run.given_poses import GivenPoses
from ffmap.app.run.odometry import Odometry, run_odometry
from ffmap.app.run.odometry_cache import CACHE_VARIABLE, cache_folder
from ffmap.app.run.report import Report
from ffmap.app.run.sampled_scans import level_by_first_scans
from ffmap.app.setup.inputs import Inputs, Sensor, commonest, why_skipped
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan

_FLUSHED_AFTER = 50
"""Number of registrations after which a viewer receives them."""
_MARGIN_NS = 1_000_000_000
"""Time (ns) before and after some scans in which poses are passed to their worker."""


@dataclass(frozen=True)
class RunPoses:
    """T_map_base of a whole drive.

    trajectory: with loops closed. registered: without; scans are labelled with these poses, which
    have no seams. base_height_m: height of the base above the floor.
    floor_slope: (2,) of the map's floor, metres up for each metre along x and y.
    """

    trajectory: Trajectory
    registered: Trajectory
    base_height_m: float
    floor_slope: FloatArray

    @classmethod
    def of(
        cls, trajectory: Trajectory, registered: Trajectory, floor_slope: FloatArray
    ) -> "RunPoses":
        """Create the poses of a drive that begins on the floor of the map."""
        return cls(trajectory, registered, float(registered.T_map_base[0, 2, 3]), floor_slope)

    def around(self, stamps_ns: IntArray) -> "RunPoses":
        """Select the poses from a second before some scans to a second after."""

        def part(poses: Trajectory) -> Trajectory:
            first = int(np.searchsorted(poses.stamp_ns, stamps_ns.min() - _MARGIN_NS)) - 2
            last = int(np.searchsorted(poses.stamp_ns, stamps_ns.max() + _MARGIN_NS)) + 2
            return poses.part(max(0, first), last)

        return replace(self, trajectory=part(self.trajectory), registered=part(self.registered))


def estimate_poses(
    inputs: Inputs,
    given: GivenPoses | None,
    settings: Settings,
    fingerprint: Callable[[], str],
    report: Report | None = None,
) -> RunPoses:
    """Register the horizontal scans and level the map, unless poses are given.

    fingerprint: of the bag. report: None where poses of an earlier run are computed again.
    Raises InputError where nothing gives poses.
    """
    if given is not None:
        return RunPoses.of(given.trajectory, given.trajectory, np.zeros(2))
    sensor = inputs.horizontal
    if sensor is None:
        raise InputError(
            f"{inputs.bag_path}: no horizontal lidar for the odometry. Name one with --horizontal, "
            "or give poses with --trajectory"
        )
    log = None if report is None else _RegistrationLog(sensor, report)
    callbacks = () if log is None else (log.add, log.check_failed)
    odometry = run_odometry(inputs, sensor, settings, fingerprint, *callbacks)
    if not len(odometry.index):
        raise InputError(
            f"{inputs.bag_path}: {sensor.lidar.topic} has no usable cloud; 'ffmap info' shows why"
        )
    level = level_by_first_scans(inputs, odometry.registered, settings)
    if log is not None and report is not None:
        report.flush()
        _report_odometry(inputs, odometry, level, log.weak, report)
        _log_loops(odometry, level, report)
    T = level.T_map_odom
    trajectory, registered = odometry.trajectory.moved(T), odometry.registered.moved(T)
    return RunPoses.of(trajectory, registered, level.floor_slope)


class _RegistrationLog:
    """Records registrations. weak: why some are weak."""

    def __init__(self, sensor: Sensor, report: Report) -> None:
        self.weak: list[str] = []
        self._sensor, self._report = sensor, report
        self._count = 0
        report.progress.stage("odometry", len(sensor.index))

    def add(self, registration: Registration) -> None:
        why_weak = weakness(registration)
        if why_weak is not None:
            self.weak.append(why_weak)
        if self._report.log:
            if not self._count:
                # The base's first pose, until the map is level.
                stamp_ns, T = np.array([registration.stamp_ns]), self._sensor.lidar.T_base_sensor
                log_odometry_frame(self._report.log, stamp_ns, T[None])
            log_registration(self._report.log, registration, why_weak)
        self._count += 1
        if self._count % _FLUSHED_AFTER == 0:
            self._report.flush()
        self._report.progress.advance()

    def check_failed(self, failed: Sequence[SkippedScan]) -> None:
        self._report.check_failed(failed, len(self._sensor.index), "registration")


def _report_odometry(
    inputs: Inputs, odometry: Odometry, level: Level, weak: list[str], report: Report
) -> None:
    """Report counts and warnings. weak: why some registrations are weak."""
    report.add(odometry_cached=odometry.cached)
    report.count(registrations=len(odometry.index), weak_registrations=len(weak))
    if (graph := odometry.pose_graph) is not None:
        report.count(loops=int(np.count_nonzero(graph.is_loop & (graph.weight > 0))))
    if odometry.cached:
        report.progress.say(
            f"odometry: read from the cache in {cache_folder()}; set {CACHE_VARIABLE} to use "
            "another folder"
        )
    skipped = sorted(set(range(len(odometry.sensor.index))) - set(odometry.index.tolist()))
    if skipped:
        reasons = [cloud.reason for cloud in odometry.failed]
        why = (
            commonest(reasons)
            if reasons
            else why_skipped(inputs.bag_path, odometry.sensor, skipped)
        )
        clouds = len(odometry.sensor.index)
        report.warn(f"{len(skipped)} of {clouds} horizontal clouds skipped: {why}")
    if odometry.cache_warning is not None:
        report.warn(odometry.cache_warning)
    if weak:
        report.warn(
            f"registration was weak for {len(weak)} of {len(odometry.index)} scans, for example: "
            f"{weak[0]}. Poses may be wrong there: see the tab Odometry of the recording"
        )
    for warning in odometry.warnings:
        report.warn(warning)
    if not np.isfinite(level.floor_rms_m):
        report.warn(
            "no floor was found in the first seconds: the map is as level as the base. Check the "
            "rig"
        )
    if graph is not None and len(graph.slips):
        report.warn(
            f"the odometry slipped near scan {', '.join(map(str, graph.slips))}. Loops corrected "
            "it to a few centimetres: see the tab Odometry of the recording"
        )


def _log_loops(odometry: Odometry, level: Level, report: Report) -> None:
    """Record how loops moved the poses."""
    if report.log is None:
        return
    closed, before = odometry.trajectory.T_map_base, odometry.registered.T_map_base
    T_correction = closed @ transforms.invert(before)
    log_odometry_frame(report.log, odometry.stamp_ns, level.T_map_odom @ T_correction)
    if (graph := odometry.pose_graph) is not None:
        moved_m = np.linalg.norm((closed - before)[:, :3, 3], axis=1)
        log_pose_graph(report.log, graph, level.T_map_odom, odometry.stamp_ns, moved_m)
