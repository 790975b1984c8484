"""Before the stages of a run: check the extrinsics of the vertical lidars by the first seconds."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.hand_eye import align_rotations, find_extrinsics
from ffmap.app.progress import Progress
from ffmap.app.run.context import Run
from ffmap.app.run.mount_check import CheckedMount, check_mounts, map_of, scans_of
from ffmap.app.run.odometry import Odometry
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import MountCorrection

_FIRST_S, _LONG_S = 8.0, 60.0
"""Duration (s) that shows extrinsics to be off, and by which they are refined. Only turns separate a
shift from a clock: after 25 s of a straight way a clock was known to 15 ms, after a turn to 4."""
_TO_REFINE = 80, 80, 40_000
"""Scans of either lidar, and returns, by which extrinsics are refined; fewer show them to be off."""
_SCANS = 200
"""Number of scans of each lidar that a mount is searched with."""
_HITS_MIN, _RIVAL_MAX = 0.3, 0.9
"""Minimum share of a lidar's returns that meet the other's where its mount is found by them, and maximum
ratio to that of any other mount's share."""


def settle_mounts(run: Run) -> Run:
    """Return the run with refined extrinsics where the given ones are off; record what was found.

    Raises InputError where extrinsics are off by more than a refinement can mend.
    """
    inputs, horizontal = run.inputs, run.inputs.horizontal
    if horizontal is None or not inputs.others or run.options.mount == "as-given":
        return run
    odometry = drive_alone(inputs, horizontal, run.settings, _FIRST_S, run.progress)
    mounts = check_mounts(inputs, odometry, run.settings, keep_agreeing=True)
    if any(mount.is_off for mount in mounts):
        odometry = drive_alone(inputs, horizontal, run.settings, _LONG_S, run.progress)
        mounts = check_mounts(inputs, odometry, run.settings, *_TO_REFINE)
    if mounts and mounts[0].alone:
        run.record["mount"] = mounts[0].record
    elif mounts:
        run.record["mounts"] = {mount.topic: mount.record for mount in mounts}
    off = [mount for mount in mounts if mount.is_off]
    for mount in off:
        if not mount.is_refined:
            raise InputError(_refusal(run, mount, odometry))
        run.warn(mount.warning)
    return (
        replace(run, inputs=inputs.with_mounts(mount.correction for mount in off)) if off else run
    )


def check_whole_drive(run: Run, trajectory: Trajectory) -> None:
    """Warn of extrinsics that the whole drive shows to be off; a straight start hides a clock.

    trajectory: T_map_base of the whole drive.
    """
    if run.options.mount == "refine":
        for mount in check_mounts(run.inputs, trajectory, run.settings, keep_agreeing=True):
            if mount.is_off:
                run.warn(mount.late_warning(run.inputs.bag_path.words))


def _refusal(run: Run, mount: CheckedMount, odometry: Trajectory) -> str:
    """Name the transform that is wrong, about what it should be, and the way out."""
    inputs, bag = run.inputs, run.inputs.bag_path
    sensor = next(sensor for sensor in inputs.others if sensor.lidar.topic == mount.topic)
    fits: MountCorrection | str = mount.correction
    if not mount.agrees:
        seen = map_of(inputs, odometry, run.settings, _SCANS)
        fits = mount_by_motion(inputs, sensor, odometry, seen, run.settings, _LONG_S, run.progress)
    child = sensor.lidar.frame_id
    edges = (edge for edge in inputs.rig.static_transforms if edge.child == child)
    parent = next((edge.parent for edge in edges), inputs.rig.base_frame)
    needed = ""
    if (
        not isinstance(fits, str)
        and (T := inputs.with_mounts([fits]).rig.tree.between(parent, child)) is not None
    ):
        shift = ", ".join(f"{v:.2f}" for v in T[:3, 3])
        turn = ", ".join(
            f"{round(v)}" for v in Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        )
        needed = f"; about x, y, z = {shift} m and roll, pitch, yaw = {turn} deg would fit"
    apart_cm, noise_cm = 100 * mount.found.rms_before_m, 100 * mount.own_rms_m
    return (
        f"{bag}: the transform {parent} -> {child} is wrong: surfaces that {mount.topic} and the "
        f"horizontal lidar see are {apart_cm:.1f} cm apart (noise: {noise_cm:.1f} cm){needed}. Run "
        f"'ffmap calibrate {bag.words} --from-motion --out rig.toml', then 'ffmap run {bag.words} "
        "--rig rig.toml'; --mount as-given uses it all the same"
    )


def drive_alone(
    inputs: Inputs, sensor: Sensor, settings: Settings, seconds: float, progress: Progress
) -> Trajectory:
    """T_odom_base of the first seconds by one lidar, loops closed, whatever the others' extrinsics are."""
    sensor = replace(
        sensor, index=sensor.index.until(int(sensor.index.stamp_ns[0] + 1e9 * seconds))
    )
    progress.stage(f"odometry of {sensor.lidar.topic}", len(sensor.index))
    refinement = settings.refinement.model_copy(update={"enabled": True, "companion_points_max": 0})
    odometry = Odometry(inputs, sensor, settings.model_copy(update={"refinement": refinement}))
    for _ in odometry:
        progress.advance()
    return odometry.trajectory


def mount_by_motion(
    inputs: Inputs,
    sensor: Sensor,
    odometry: Trajectory,
    seen: FloatArray,
    settings: Settings,
    seconds: float,
    progress: Progress,
) -> MountCorrection | str:
    """Find about where a lidar sits by its turns and what it sees; why not, and a fix, where it cannot.

    odometry, seen: T_odom_base by the horizontal lidar, and what it saw (n, 3) in that frame.
    """
    topic = sensor.lidar.topic
    alone = replace(sensor, lidar=replace(sensor.lidar, T_base_sensor=np.eye(4)))
    aligned = align_rotations(odometry, drive_alone(inputs, alone, settings, seconds, progress))
    if aligned is None:
        return (
            f"the robot turns too little to tell where {topic} sits; drive a bend or turn on the "
            "spot, or say about where it sits in --rig FILE"
        )
    progress.stage(f"mount of {topic}", None)
    found = find_extrinsics(
        seen, odometry, scans_of(inputs, alone, odometry, settings, _SCANS), *aligned
    )
    if found is None:
        told = "one of them sees nothing"
    elif found.rival_hits > _RIVAL_MAX * found.hits:
        told = f"turned by {found.rival_deg:.0f} deg it fits as well"
    elif found.hits < _HITS_MIN:
        told = f"{100 * found.hits:.0f} % of its returns meet the other lidar's"
    else:
        return MountCorrection(
            topic, tuple(map(tuple, found.T_base_sensor.tolist())), sensor.lidar.decoding.clock_ns
        )
    return (
        f"what the lidars see does not tell where {topic} sits ({told}); drive into another room "
        "and turn there, or say about where it sits in --rig FILE"
    )
