"""Check the extrinsics of vertical lidars by surfaces that the horizontal lidar sees too."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.extrinsics import (
    RefinedExtrinsics,
    refine_extrinsics,
    surfaces_agreement,
)
from ffmap.algorithms.poses.hand_eye import align_rotations, find_extrinsics
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.folder.record import MountEntry
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

    change: (7,) found less given, as `RefinedExtrinsics.change`. clock_given_ns: time that is
    added to its stamps already. own_rms_m: RMS distance (m) of the horizontal lidar's returns from
    surfaces of its other scans.
    """

    topic: str
    found: RefinedExtrinsics
    change: FloatArray
    clock_given_ns: int
    own_rms_m: float

    @property
    def is_off(self) -> bool:
        """Whether the given extrinsics are wrong for certain."""
        if not self.found.returns:
            # With right extrinsics, the lidars share a quarter of their returns or more.
            return not self.fits
        least = np.array([np.radians(_OFF_DEG)] * 3 + [_OFF_M] * 3 + [_OFF_S])
        off = np.abs(self.change) > np.maximum(least, _SIGMAS * self.found.sigma)
        return bool(off.any()) and self.found.rms_before_m > _BETTER * self.found.rms_after_m

    @property
    def fits(self) -> bool:
        """Whether the surfaces of both lidars agree with the extrinsics found."""
        return not self.found.rms_after_m > _NOISE_MAX * self.own_rms_m

    @property
    def is_refined(self) -> bool:
        """Whether the extrinsics found fit, and are near enough to the given ones to be used."""
        return self.fits and self.off_deg <= _REFINED_DEG and self.off_m <= _REFINED_M

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
    def entry(self) -> MountEntry:
        """The entry of run.json."""
        entry = MountEntry(
            rms_horizontal_m=round(self.own_rms_m, 6),
            rms_as_given_m=round(self.found.rms_before_m, 6),
            rms_refined_m=round(self.found.rms_after_m, 6),
        )
        if not self.is_off:
            return entry
        T, clock_ns = self.correction.T_base_sensor, self.correction.clock_ns
        return entry.model_copy(
            update={"used": "refined", "T_base_sensor": T, "clock_ns": clock_ns}
        )

    def warning(self, end: str) -> str:
        """Describe extrinsics that are wrong. end: what has been done about it, or can be."""
        found = self.found
        return (
            f"the extrinsics of {self.topic} in the bag or rig file are wrong by "
            f"{self.off_deg:.1f} deg and {100 * self.off_m:.1f} cm, or its clock by "
            f"{1e3 * found.clock_s:+.0f} ms (known to {1e3 * found.sigma[6]:.0f} ms). Surfaces "
            f"that both lidars see are {100 * found.rms_before_m:.1f} cm apart, and "
            f"{100 * found.rms_after_m:.1f} cm with refined extrinsics. {end}"
        )


def correct_extrinsics(run: Run, report: Report) -> Inputs:
    """Refine the extrinsics of vertical lidars where the first seconds show them to be wrong.

    Raises InputError where extrinsics are wrong by more than a refinement can correct.
    """
    inputs, horizontal = run.inputs, run.inputs.horizontal
    skip = run.given is not None or run.options.mount == "as-given"
    if horizontal is None or not inputs.others or skip:
        return inputs

    def drive(seconds: float) -> Trajectory:
        return drive_alone(
            inputs, run.settings, seconds, run.fingerprint, report.progress, horizontal
        )

    lidars = check_extrinsics(inputs, drive(_FIRST_S), run.settings, keep_agreeing=True)
    if any(lidar.is_off for lidar in lidars):
        lidars = check_extrinsics(inputs, drive(_LONG_S), run.settings, *_TO_REFINE)
    report.add(mounts={lidar.topic: lidar.entry for lidar in lidars})
    off = [lidar for lidar in lidars if lidar.is_off]
    for lidar in off:
        if not lidar.is_refined:
            raise InputError(_refusal(inputs, lidar))
        report.warn(
            lidar.warning("These are used; --mount as-given uses those of the bag or rig file")
        )
    return inputs.with_mounts(lidar.correction for lidar in off) if off else inputs


def check_whole_drive(run: Run, trajectory: Trajectory, report: Report) -> None:
    """Warn of extrinsics that the whole drive shows to be wrong: a straight start hides a clock."""
    if run.options.mount == "as-given":
        return
    bag = run.inputs.bag_path.words
    for lidar in check_extrinsics(run.inputs, trajectory, run.settings, keep_agreeing=True):
        if lidar.is_off:
            report.warn(
                lidar.warning(
                    "The whole drive shows this, not its first seconds. Run 'ffmap calibrate "
                    f"{bag} --out rig.toml', then 'ffmap run {bag} --rig rig.toml'"
                )
            )


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
            topic, change = sensor.lidar.topic, found.change(T_given)
            checked.append(CheckedExtrinsics(topic, found, change, clock_ns, own_rms_m))
    return checked


def _refusal(inputs: Inputs, lidar: CheckedExtrinsics) -> str:
    """Name the transform that is wrong, and the fix."""
    bag = inputs.bag_path
    child = next(s.lidar.frame_id for s in inputs.others if s.lidar.topic == lidar.topic)
    edges = (edge for edge in inputs.rig.static_transforms if edge.child == child)
    parent = next((edge.parent for edge in edges), inputs.rig.base_frame)
    apart_cm, noise_cm = 100 * lidar.found.rms_before_m, 100 * lidar.own_rms_m
    return (
        f"{bag}: the transform {parent} -> {child} is wrong: surfaces that {lidar.topic} and the "
        f"horizontal lidar see are {apart_cm:.1f} cm apart (noise: {noise_cm:.1f} cm). Run "
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
