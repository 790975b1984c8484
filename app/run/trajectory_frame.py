"""Find the frame of a given trajectory by the surfaces that a lidar sees at different times."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.extrinsics import REACH_M, surfaces_agreement
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.run.mount_check import laid_out, scans_of
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError

_SCANS, _RETURNS = 31, 10_000
"""Number of scans of the drive, every second of which makes the patches, and of returns on those."""
_NOISE_EVERY = 4
"""Of these scans, every fourth shows the noise: its returns about its own surfaces."""
_BETTER = 1.15
"""Minimum ratio of the distances between surfaces by which one frame is better than another."""
_CHANCE_M = 0.7 * REACH_M / np.sqrt(3.0)
"""RMS distance (m) beyond which surfaces seen at different times do not meet: it is 1/sqrt(3) of the
reach where returns lie at random."""
_FITS, _BLURRED = 3.0, 1.5
"""Multiples of the noise: below the first, a frame may be the right one (KISS-ICP's own poses have 2.4);
above the second, a user is warned."""
_SHARE_MIN = 0.05
"""Minimum share of the returns within reach of a surface; poses 100 times too far apart have 0.02."""
_FRAMES_MAX = 12
"""Maximum number of the bag's frames that are tried; of more, those of the lidars."""
_T_FRAME_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""The axes of cameras: z forward, y down."""


@dataclass(frozen=True)
class PoseFrame:
    """The frame that poses are of.

    T_frame_base: (4, 4). rms_m, as_base_m: RMS distance (m) between surfaces seen at different
    times, by this frame and by the base. noise_m: the same within a scan. NaN: unknown.
    """

    name: str
    T_frame_base: FloatArray
    rms_m: float
    as_base_m: float
    noise_m: float

    def warnings(self, given: str, base: str) -> list[str]:
        """What a user must know of it. given: how the poses were named."""
        warnings = []
        if self.rms_m < self.as_base_m:
            warnings.append(
                f"{given} holds poses of {self.name}, not of {base}, and is used as such: surfaces "
                f"that were seen at different times are {100 * self.rms_m:.1f} cm apart, and "
                f"{100 * self.as_base_m:.1f} cm by {base}; --trajectory-frame {base} overrules this"
            )
        if self.rms_m > _BLURRED * self.noise_m:
            warnings.append(
                f"{given}: surfaces that were seen at different times are {100 * self.rms_m:.1f} cm "
                f"apart by its poses (noise: {100 * self.noise_m:.1f} cm), which blurs the map; give "
                "more precise poses, or leave --trajectory out"
            )
        return warnings


def find_pose_frame(
    name: str, given: Trajectory, inputs: Inputs, settings: Settings, frame: str | None
) -> PoseFrame:
    """Return the frame of given poses: the named one, the base's, or one by which surfaces agree better.

    Raises InputError for an unknown frame, and where surfaces agree by none.
    """
    sensor = inputs.horizontal or inputs.vertical
    assert sensor is not None
    base, known = inputs.rig.base_frame, _known(inputs)
    if frame is not None and frame not in known:
        raise InputError(
            f"--trajectory-frame {frame}: no such frame; name one of {', '.join(known)}"
        )
    scans = scans_of(inputs, sensor, given, settings, _SCANS)

    def agreement(T_base_frame: FloatArray) -> tuple[float, float]:
        return _agreement(_of_base(given, T_base_frame), sensor, scans[::2], scans[1::2])

    best, T_best = frame or base, known[frame or base]
    as_given = _of_base(given, T_best)
    noises = [_agreement(as_given, sensor, [scan], [scan])[0] for scan in scans[::_NOISE_EVERY]]
    noise_m = float(np.median(noises)) if noises else float("nan")
    best_m, share = agreement(T_best)
    as_base_m = best_m
    if frame is None and best_m > _BETTER * noise_m:
        for other, T in _candidates(known, inputs).items():
            other_m, other_share = agreement(T)
            fits = other_m < _FITS * noise_m and _BETTER * other_m < as_base_m
            if fits and other_m < best_m and other_share > share:
                best, T_best, best_m, share = other, T, other_m, other_share
    hardly_meets = share < _SHARE_MIN and best_m > _BLURRED * noise_m
    if hardly_meets or best_m > max(_CHANCE_M, _FITS * noise_m):
        raise InputError(
            f"--trajectory {name}: surfaces that {sensor.lidar.topic} saw at different times do not "
            f"meet ({100 * best_m:.1f} cm apart), of whatever frame the poses are; give poses of this "
            "drive, in metres, stamped by the lidar's clock, or leave --trajectory out"
        )
    return PoseFrame(best, transforms.invert(T_best), best_m, as_base_m, noise_m)


def _of_base(given: Trajectory, T_base_frame: FloatArray) -> Trajectory:
    return Trajectory(given.stamp_ns, given.T_map_base @ transforms.invert(T_base_frame))


def _known(inputs: Inputs) -> dict[str, FloatArray]:
    """T_base_frame (4, 4) of the base, the lidars, and the frames that transforms join with them."""
    base, tree = inputs.rig.base_frame, inputs.rig.tree
    lidars = {
        sensor.lidar.frame_id: sensor.lidar.T_base_sensor for sensor in inputs.by_role.values()
    }
    others = {frame: T for frame in tree.frames if (T := tree.between(base, frame)) is not None}
    return {base: np.eye(4), **lidars, **others}


def _candidates(known: dict[str, FloatArray], inputs: Inputs) -> dict[str, FloatArray]:
    """T_base_frame (4, 4) of frames, and of the base and the first lidar with a camera's axes."""
    lidars = [sensor.lidar.frame_id for sensor in inputs.by_role.values()]
    usual = [inputs.rig.base_frame, *lidars]
    frames = {name: T for name, T in known.items() if len(known) <= _FRAMES_MAX or name in usual}
    cameras = {
        f"{name} with z forward and y down": known[name] @ _T_FRAME_CAMERA for name in usual[:2]
    }
    return frames | cameras


def _agreement(
    odometry: Trajectory, sensor: Sensor, mapped: Sequence[Scan], laid: Sequence[Scan]
) -> tuple[float, float]:
    """How the returns of some scans agree with the surfaces of others; see `surfaces_agreement`."""
    T = sensor.lidar.T_base_sensor
    patches = Patches.of(laid_out(mapped, odometry, T), voxel_m=0.1, neighbours=16)
    return surfaces_agreement(patches, odometry, laid, T, _RETURNS)
