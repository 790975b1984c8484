"""Check the extrinsics of vertical lidars by surfaces that the horizontal lidar sees too."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.extrinsics import (
    RefinedExtrinsics,
    refine_extrinsics,
    surfaces_agreement,
)
from ffmap.algorithms.poses.hand_eye import align_rotations, find_extrinsics
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.progress import Progress
from ffmap.app.run.odometry import run_odometry
from ffmap.app.run.report import Report
from ffmap.app.run.sampled_scans import map_of, scans_of
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import MountCorrection

_FIRST_S, _LONG_S = 8.0, 60.0
"""Duration (s) by which extrinsics are checked, and by which they are refined. Only turns separate
a shift from a clock: after 25 s of a straight way a clock was known to 15 ms, after a turn to 4."""
_OFF_DEG, _OFF_M, _OFF_S = 0.3, 0.02, 0.005
"""Minimum error of extrinsics and clock that is corrected."""
_SIGMAS = 3.0
"""Minimum error in standard deviations of the estimate."""
_BETTER = 1.15
"""Minimum ratio of the distance between surfaces as given to that as refined."""
_TO_CHECK = 16, 20, 10_000
"""Number of scans of the horizontal lidar that make patches, of scans of the vertical lidar that
are compared with them, and of returns."""
_TO_REFINE = 80, 80, 40_000
"""The same where extrinsics are refined."""
_REFINED_DEG, _REFINED_M = 5.0, 0.1
"""Maximum change by a refinement: extrinsics that are farther off may settle on the next wall. The
clock may be off by any time."""
_NOISE_MAX = 1.5
"""Maximum distance between both lidars' surfaces after a refinement, as a multiple of the distance
between the horizontal lidar's own. Right extrinsics have 1.05 to 1.15, wrong ones 2 to 4."""
_SEARCHED = 200
"""Number of scans of each lidar with which unknown extrinsics are searched."""
_HITS_MIN, _RIVAL_MAX = 0.3, 0.9
"""Minimum share of returns that meet the other lidar's where extrinsics are found, and maximum
ratio of the share by any other extrinsics to it."""


Drive = Callable[[Sensor], Trajectory]


@dataclass(frozen=True)
class CheckedExtrinsics:
    """What a drive shows of a vertical lidar's extrinsics.

    alone: whether no other lidar has extrinsics to be checked. change: (7,) found less given, as
    `RefinedExtrinsics.change`. clock_given_ns: time that is added to its stamps already.
    own_rms_m: RMS distance (m) of the horizontal lidar's returns from surfaces of its other scans.
    """

    topic: str
    alone: bool
    found: RefinedExtrinsics
    change: FloatArray
    clock_given_ns: int
    own_rms_m: float

    @property
    def is_off(self) -> bool:
        """Whether the given extrinsics are wrong for certain."""
        least = np.array([np.radians(_OFF_DEG)] * 3 + [_OFF_M] * 3 + [_OFF_S])
        off = np.abs(self.change) > np.maximum(least, _SIGMAS * self.found.sigma)
        return bool(off.any()) and self.found.rms_before_m > _BETTER * self.found.rms_after_m

    @property
    def agrees(self) -> bool:
        """Whether the surfaces of both lidars agree to the noise with the extrinsics found."""
        return not self.found.rms_after_m > _NOISE_MAX * self.own_rms_m

    @property
    def is_refined(self) -> bool:
        """Whether the extrinsics found are near enough to the given ones to be used."""
        return self.agrees and self.off_deg <= _REFINED_DEG and self.off_m <= _REFINED_M

    @property
    def off_deg(self) -> float:
        """Angle between given and found rotation."""
        return float(np.degrees(np.linalg.norm(self.change[:3])))

    @property
    def off_m(self) -> float:
        """Distance between given and found translation."""
        return float(np.linalg.norm(self.change[3:6]))

    @property
    def correction(self) -> MountCorrection:
        clock_ns = self.clock_given_ns + round(1e9 * self.found.clock_s)
        rows = tuple(map(tuple, self.found.T_base_sensor.tolist()))
        return MountCorrection(self.topic, rows, clock_ns)

    @property
    def record(self) -> dict[str, Any]:
        """The entry of run.json."""
        found = self.found
        figures = {"rms_as_given_m": found.rms_before_m, "rms_horizontal_m": self.own_rms_m}
        if refined := bool(np.isfinite(found.sigma).all()):
            figures |= {"rms_refined_m": found.rms_after_m, "clock_s": found.clock_s}
            figures |= {"off_deg": self.off_deg, "off_m": self.off_m}
        record: dict[str, Any] = {"used": "refined" if self.is_off else "as given"}
        record |= {name: round(value, 6) for name, value in figures.items()}
        if refined:
            angles, shifts, clock = np.degrees(found.sigma[:3]), found.sigma[3:6], found.sigma[6:]
            sigma = {"rotation_deg": angles, "shift_m": shifts, "clock_s": clock}
            record["sigma"] = {name: v.round(6).tolist() for name, v in sigma.items()}
        if self.is_off:
            clock_ns = self.correction.clock_ns
            record |= {"T_base_sensor": found.T_base_sensor.tolist(), "clock_ns": clock_ns}
        return record

    @property
    def warning(self) -> str:
        found, which = self.found, "" if self.alone else f" {self.topic}"
        return (
            f"the extrinsics of the vertical lidar{which} in the bag or rig file are wrong by "
            f"{self.off_deg:.1f} deg and {100 * self.off_m:.1f} cm, and its clock by "
            f"{1e3 * found.clock_s:+.0f} ms (known to {1e3 * found.sigma[6]:.0f} ms). Surfaces "
            f"that both lidars see were {100 * found.rms_before_m:.1f} cm apart. With the refined "
            f"extrinsics, which are used, they are {100 * found.rms_after_m:.1f} cm apart. "
            "--mount as-given uses the bag's"
        )

    def late_warning(self, bag: str) -> str:
        """Warn where only the whole drive shows that extrinsics are wrong. bag: as typed."""
        found = self.found
        return (
            f"the extrinsics of {self.topic} in the bag or rig file are wrong by "
            f"{self.off_deg:.1f} deg and {100 * self.off_m:.1f} cm, or its clock by "
            f"{1e3 * found.clock_s:+.0f} ms, as the whole drive shows. Surfaces that both lidars "
            f"see are {100 * found.rms_before_m:.1f} cm apart, and "
            f"{100 * found.rms_after_m:.1f} cm with extrinsics that fit. Run "
            f"'ffmap calibrate {bag} --out rig.toml', then 'ffmap run {bag} --rig rig.toml'"
        )


def correct_extrinsics(run: Run, report: Report) -> Run:
    """Refine the extrinsics of vertical lidars where the first seconds show them to be wrong.

    Raises InputError where extrinsics are wrong by more than a refinement can correct.
    """
    inputs, horizontal = run.inputs, run.inputs.horizontal
    skip = run.given is not None or run.options.mount == "as-given"
    if horizontal is None or not inputs.others or skip:
        return run

    def drive(sensor: Sensor, seconds: float = _LONG_S) -> Trajectory:
        return drive_alone(inputs, run.settings, seconds, run.fingerprint, report.progress, sensor)

    odometry = drive(horizontal, _FIRST_S)
    lidars = check_extrinsics(inputs, odometry, run.settings, keep_agreeing=True)
    if any(lidar.is_off for lidar in lidars):
        odometry = drive(horizontal)
        lidars = check_extrinsics(inputs, odometry, run.settings, *_TO_REFINE)
    record = dict(run.record)
    if lidars and lidars[0].alone:
        record["mount"] = lidars[0].record
    elif lidars:
        record["mounts"] = {lidar.topic: lidar.record for lidar in lidars}
    off = [lidar for lidar in lidars if lidar.is_off]
    for lidar in off:
        if not lidar.is_refined:
            raise InputError(_refusal(run, lidar, odometry, drive))
        report.warn(lidar.warning)
    corrected = inputs.with_mounts(lidar.correction for lidar in off) if off else inputs
    return replace(run, inputs=corrected, record=record)


def check_whole_drive(run: Run, trajectory: Trajectory, report: Report) -> None:
    """Warn of extrinsics that the whole drive shows to be wrong: a straight start hides a clock."""
    if run.options.mount == "refine":
        for lidar in check_extrinsics(run.inputs, trajectory, run.settings, keep_agreeing=True):
            if lidar.is_off:
                report.warn(lidar.late_warning(run.inputs.bag_path.words))


def check_extrinsics(
    inputs: Inputs,
    odometry: Trajectory,
    settings: Settings,
    mapped: int = _TO_CHECK[0],
    compared: int = _TO_CHECK[1],
    returns: int = _TO_CHECK[2],
    keep_agreeing: bool = False,
) -> list[CheckedExtrinsics]:
    """Check the vertical lidars that see enough of what the horizontal lidar sees.

    odometry: T_odom_base. mapped, compared, returns: see `_TO_CHECK`.
    keep_agreeing: whether extrinsics are kept with which surfaces agree.
    """
    if inputs.horizontal is None or not inputs.others:
        return []
    patches = Patches.of(map_of(inputs, odometry, settings, mapped), voxel_m=0.1, neighbours=16)
    # The scans between those that made the patches.
    own = scans_of(inputs, inputs.horizontal, odometry, settings, 2 * mapped - 1)[1::2]
    T_base_own = inputs.horizontal.lidar.T_base_sensor
    own_rms_m, _ = surfaces_agreement(patches, odometry, own, T_base_own, returns)
    checked = []
    for sensor in inputs.others:
        scans = scans_of(inputs, sensor, odometry, settings, compared)
        T_given, clock_ns = sensor.lidar.T_base_sensor, sensor.lidar.decoding.clock_ns
        agree_m = _BETTER * own_rms_m if keep_agreeing else 0.0
        if found := refine_extrinsics(patches, odometry, scans, T_given, returns, agree_m):
            alone, change = len(inputs.others) == 1, found.change(T_given)
            topic = sensor.lidar.topic
            checked.append(CheckedExtrinsics(topic, alone, found, change, clock_ns, own_rms_m))
    return checked


def _refusal(run: Run, lidar: CheckedExtrinsics, odometry: Trajectory, drive: Drive) -> str:
    """Name the transform that is wrong, about what it should be, and the fix."""
    inputs, bag = run.inputs, run.inputs.bag_path
    sensor = next(sensor for sensor in inputs.others if sensor.lidar.topic == lidar.topic)
    fits: MountCorrection | str = lidar.correction
    if not lidar.agrees:
        seen = map_of(inputs, odometry, run.settings, _SEARCHED)
        fits = extrinsics_by_motion(inputs, sensor, odometry, seen, run.settings, drive)
    child = sensor.lidar.frame_id
    edges = (edge for edge in inputs.rig.static_transforms if edge.child == child)
    parent = next((edge.parent for edge in edges), inputs.rig.base_frame)
    needed = ""
    if not isinstance(fits, str):
        T = inputs.with_mounts([fits]).rig.tree.between(parent, child)
        if T is not None:
            shift = ", ".join(f"{v:.2f}" for v in T[:3, 3])
            angles = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
            turn = ", ".join(f"{round(v)}" for v in angles)
            needed = f"; about x, y, z = {shift} m and roll, pitch, yaw = {turn} deg would fit"
    apart_cm, noise_cm = 100 * lidar.found.rms_before_m, 100 * lidar.own_rms_m
    return (
        f"{bag}: the transform {parent} -> {child} is wrong: surfaces that {lidar.topic} and the "
        f"horizontal lidar see are {apart_cm:.1f} cm apart (noise: {noise_cm:.1f} cm){needed}. Run "
        f"'ffmap calibrate {bag.words} --from-motion --out rig.toml', then 'ffmap run {bag.words} "
        "--rig rig.toml'; --mount as-given uses it all the same"
    )


def drive_alone(
    inputs: Inputs,
    settings: Settings,
    seconds: float,
    fingerprint: Callable[[], str],
    progress: Progress,
    sensor: Sensor,
) -> Trajectory:
    """Estimate T_odom_base of the first seconds by one lidar: extrinsics do not matter to it."""
    end_ns = int(sensor.index.stamp_ns[0] + 1e9 * seconds)
    sensor = replace(sensor, index=sensor.index.until(end_ns))
    progress.stage(f"odometry of {sensor.lidar.topic}", len(sensor.index))
    refinement = settings.refinement.model_copy(update={"enabled": True, "companion_points_max": 0})
    settings = settings.model_copy(update={"refinement": refinement})
    odometry = run_odometry(inputs, sensor, settings, fingerprint, lambda _: progress.advance())
    return odometry.trajectory


def extrinsics_by_motion(
    inputs: Inputs,
    sensor: Sensor,
    odometry: Trajectory,
    seen: FloatArray,
    settings: Settings,
    drive: Drive,
) -> MountCorrection | str:
    """Estimate the extrinsics of a lidar by its motion and its returns; a reason where it fails.

    odometry, seen: T_odom_base by the horizontal lidar, and its returns (n, 3) in that frame.
    drive: estimates T_odom_base by one lidar.
    """
    topic = sensor.lidar.topic
    alone = replace(sensor, lidar=replace(sensor.lidar, T_base_sensor=np.eye(4)))
    aligned = align_rotations(odometry, drive(alone))
    if aligned is None:
        return (
            f"the robot turns too little to estimate the extrinsics of {topic}. Drive a bend or "
            "turn on the spot, or give rough extrinsics in --rig FILE"
        )
    scans = scans_of(inputs, alone, odometry, settings, _SEARCHED)
    found = find_extrinsics(seen, odometry, scans, *aligned)
    if found is None:
        reason = "one of them sees nothing"
    elif found.rival_hits > _RIVAL_MAX * found.hits:
        reason = f"rotated by {found.rival_deg:.0f} deg it fits as well"
    elif found.hits < _HITS_MIN:
        reason = f"{100 * found.hits:.0f} % of its returns meet the other lidar's"
    else:
        rows = tuple(map(tuple, found.T_base_sensor.tolist()))
        return MountCorrection(topic, rows, sensor.lidar.decoding.clock_ns)
    return (
        f"the returns of the lidars do not determine the extrinsics of {topic} ({reason}). Drive "
        "into another room and turn there, or give rough extrinsics in --rig FILE"
    )
