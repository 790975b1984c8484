"""Find the frame of a given trajectory by the surfaces that a lidar sees at different times."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.mount import REACH_M, surfaces_rms_m
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.run.mount_check import laid_out, scans_of
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError

_SCANS, _RETURNS = 31, 10_000
"""Number of scans over the whole drive, every second of which makes the patches; of returns."""
_WINDOWS, _IN_A_WINDOW = 4, 4
"""Number of short times, and of successive scans in each, that show the noise."""
_BETTER = 1.15
"""Minimum ratio of the distances between surfaces by which one frame is better than another."""
_CHANCE_M = 0.7 * REACH_M / np.sqrt(3.0)
"""RMS distance (m) beyond which surfaces seen at different times do not meet: it is 1/sqrt(3) of the
reach where returns lie at random."""
_BLURRED = 2.0
"""Multiple of the noise beyond which surfaces do not agree, and a user is warned."""
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
    times, by this frame and by the base. noise_m: the same of successive scans. NaN: unknown.
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

    def rms_m(T_base_frame: FloatArray) -> float:
        return _agreement_m(_of_base(given, T_base_frame), sensor, scans[::2], scans[1::2])

    best, T_best = frame or base, known[frame or base]
    noise_m = _noise_m(inputs, sensor, _of_base(given, T_best), settings)
    best_m = as_base_m = rms_m(T_best)
    if frame is None and best_m > _BETTER * noise_m:
        tried = {other: (rms_m(T), T) for other, T in _candidates(known, inputs)}
        other = min(tried, key=lambda one: np.nan_to_num(tried[one][0], nan=np.inf))
        if _BETTER * tried[other][0] < as_base_m:
            best, (best_m, T_best) = other, tried[other]
    if best_m > max(_CHANCE_M, _BLURRED * noise_m):
        raise InputError(
            f"--trajectory {name}: surfaces that {sensor.lidar.topic} saw at different times do not "
            f"meet, of whatever frame the poses are ({100 * best_m:.1f} cm apart at best); give poses "
            "of this drive, in metres, stamped by the lidar's clock, or leave --trajectory out"
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


def _candidates(known: dict[str, FloatArray], inputs: Inputs) -> Iterator[tuple[str, FloatArray]]:
    """Frames by name, T_base_frame (4, 4), each as it is and with a camera's axes."""
    lidars = [sensor.lidar.frame_id for sensor in inputs.by_role.values()]
    named = [*known] if len(known) <= _FRAMES_MAX else [inputs.rig.base_frame, *lidars]
    for words, axes in (("{}", np.eye(4)), ("{} with z forward and y down", _T_FRAME_CAMERA)):
        for frame in named:
            yield words.format(frame), known[frame] @ axes


def _agreement_m(
    odometry: Trajectory, sensor: Sensor, mapped: Sequence[Scan], laid: Sequence[Scan]
) -> float:
    """RMS distance (m) of the returns of some scans from the surfaces of others; NaN: unknown."""
    T = sensor.lidar.T_base_sensor
    patches = Patches.of(laid_out(mapped, odometry, T), cube_m=0.1, neighbours=16)
    return surfaces_rms_m(patches, odometry, laid, T, _RETURNS)


def _noise_m(inputs: Inputs, sensor: Sensor, odometry: Trajectory, settings: Settings) -> float:
    """RMS distance (m) between the surfaces of successive scans; NaN where they do not meet."""
    scans = scans_of(inputs, sensor, odometry, settings, _WINDOWS, _IN_A_WINDOW)
    windows = [scans[first : first + _IN_A_WINDOW] for first in range(0, len(scans), _IN_A_WINDOW)]
    own = np.array(
        [_agreement_m(odometry, sensor, window[::2], window[1::2]) for window in windows]
    )
    return float(np.median(own[np.isfinite(own)])) if np.isfinite(own).any() else float("nan")
