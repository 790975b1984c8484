"""Stage 1 of a run: the poses, by registering the horizontal scans (paper, IV.A); scans whose poses are known are labelled."""

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.levelling import Level
from ffmap.algorithms.poses.odometry import Registration, weakness
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.record.odometry import log_odometry_frame, log_pose_graph, log_registrations
from ffmap.app.run.context import Run
from ffmap.app.run.odometry import Odometry
from ffmap.app.run.odometry_cache import CACHE_VARIABLE, cache_folder
from ffmap.app.run.poses import KnownPoses, RunPoses, level_by_first_scans, levelled, shows_level
from ffmap.app.run.stage_scans import Labeller
from ffmap.app.setup.inputs import commonest, why_skipped
from ffmap.loaders.errors import InputError

_LOGGED_AT_ONCE = 50


def find_poses(run: Run, given: Trajectory | None, labeller: Labeller | None) -> RunPoses:
    """The poses in the levelled map: those that were given, or the odometry's. Raises InputError where nothing gives any.

    labeller: goes on with the scans whose poses are known while others are still registered; None where none is labelled.
    """
    if given is not None:
        return RunPoses(given, given, np.zeros(2))
    odometry, level, weak = _register(run, labeller)
    if odometry.cache_warning is not None:
        run.warn(odometry.cache_warning)
    run.state.clouds |= odometry.clouds
    run.state.counts |= {"registrations": len(odometry), "weak_registrations": len(weak)}
    if weak:
        run.warn(
            f"registration was weak for {len(weak)} of {len(odometry)} scans, for example: {weak[0]}; poses may be off there: "
            "see the recording's tab Odometry"
        )
    for warning in odometry.warnings:
        run.warn(warning)
    if not np.isfinite(level.floor_rms_m):
        run.warn("no floor was found in the first seconds: the map keeps the base's own level; is the rig right?")
    trajectory, registered = odometry.trajectory, odometry.registered()
    _take_loops(run, odometry.pose_graph, trajectory, registered, level.T_map_odom)
    return levelled(trajectory, registered, level)


def _register(run: Run, labeller: Labeller | None) -> tuple[Odometry, Level, list[str]]:
    """The odometry of the whole drive, recorded as it goes on, the map's level, and why some registrations are weak."""
    sensor = run.inputs.horizontal
    if sensor is None:
        raise InputError(
            f"{run.inputs.bag_path}: no horizontal lidar gives poses; name one with --horizontal, or give a "
            "trajectory with --trajectory"
        )
    run.progress.stage("odometry", len(sensor.index))
    odometry = Odometry(run.inputs, sensor, run.settings)
    run.state.odometry_cached = odometry.from_cache
    if odometry.from_cache:
        run.progress.say(
            f"odometry: taken from the cache in {cache_folder()}; with {CACHE_VARIABLE} it is another folder"
        )
    registered: list[int] = []
    waiting: list[Registration] = []
    weak: list[str] = []
    level: Level | None = None
    for registration in odometry:
        registered.append(registration.index)
        run.keep_failed(odometry.failed, len(sensor.index), "registration")
        if len(odometry) == 1 and run.log:
            # Until the map is level, the base's first pose is.
            log_odometry_frame(run.log, odometry.registered().stamp_ns, sensor.lidar.T_base_sensor[None])
        waiting.append(registration)
        run.progress.advance()
        if level is None and shows_level(odometry.stamp_ns, run.settings):
            level = level_by_first_scans(run.inputs, odometry.registered(), run.settings)
        if level is None:
            continue
        if len(waiting) >= _LOGGED_AT_ONCE:
            weak += _log(run, waiting)
            waiting = []
        if labeller is not None:
            labeller.go_on(_known(odometry, level))
    weak += _log(run, waiting)
    run.keep_failed(odometry.failed, len(sensor.index), "registration")
    if not registered:
        raise InputError(f"{run.inputs.bag_path}: {sensor.lidar.topic} has no usable cloud; 'ffmap info' tells more")
    if unregistered := sorted(set(range(len(sensor.index))) - set(registered)):
        reasons = [scan.reason for scan in odometry.failed]
        why = commonest(reasons) if reasons else why_skipped(run.inputs.bag_path, sensor, unregistered)
        run.warn(f"{len(unregistered)} of {len(sensor.index)} horizontal clouds skipped: {why}")
    if level is None:
        level = level_by_first_scans(run.inputs, odometry.registered(), run.settings)
    return odometry, level, weak


def _known(odometry: Odometry, level: Level) -> KnownPoses:
    """What has been registered so far, in the levelled map."""

    def part(first: int, last: int) -> Trajectory:
        return odometry.registered(first, last).moved(level.T_map_odom)

    return KnownPoses(odometry.stamp_ns, part, level.floor_slope)


def _log(run: Run, registrations: list[Registration]) -> list[str]:
    """Record registrations; returns why some of them are weak."""
    why_weak = [weakness(registration) for registration in registrations]
    if run.log and run.recording:
        log_registrations(run.log, registrations, why_weak)
        run.recording.cut()
    return [why for why in why_weak if why is not None]


def _take_loops(
    run: Run, graph: PoseGraph | None, trajectory: Trajectory, before: Trajectory, T_map_odom: FloatArray
) -> None:
    """Count the loops, and record what they did to the poses; trajectory: T_odom_base with them closed."""
    if graph is not None:
        run.state.counts["loops"] = int(np.count_nonzero(graph.is_loop & (graph.weight > 0)))
        if len(graph.slips):
            run.warn(
                f"the odometry slipped near scan {', '.join(map(str, graph.slips))}, as loops show, which put it right but for "
                "centimetres there: see the recording's tab Odometry"
            )
    if run.log:
        T_correction = trajectory.T_map_base @ transforms.invert(before.T_map_base)
        log_odometry_frame(run.log, trajectory.stamp_ns, T_map_odom @ T_correction)
        if graph is not None:
            moved_m = np.linalg.norm((trajectory.T_map_base - before.T_map_base)[:, :3, 3], axis=1)
            log_pose_graph(run.log, graph, T_map_odom, trajectory.stamp_ns, moved_m)
