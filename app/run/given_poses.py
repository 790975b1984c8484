"""Poses from a file or a topic in place of the odometry: their frame, and the map's origin."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.poses.extrinsics import REACH_M, surfaces_agreement
from ffmap.algorithms.poses.patches import Patches
from ffmap.app.run.sampled_scans import level_by_first_scans, place_returns, scans_of
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import read_pose_topic, read_tum

_FAR_M = 1_000.0
"""Distance (m) from the origin of given poses, for example UTM, beyond which the map has its own
origin: float32 resolves 0.1 mm at a kilometre, but half a metre at UTM northings."""
_FLOOR_OFF_M = 0.1
"""Height (m) of the floor beyond which the map gets its own: later stages look for it near 0."""
_LEAN_MAX_DEG, _LEVEL_DEG = 30.0, 1.0
"""Angle of the z axis from the vertical: beyond the first, poses of the base are refused; beyond
the second, poses of a sensor have the sensor's axes."""
_JUMP_M, _SPEED_MAX_M_S, _COORDINATE_MAX_M = 10.0, 100.0, 1e8
"""Step (m), speed (m/s) and coordinate (m) that no robot has: the poses are not in metres."""
_GAP_S = 1.0
"""Time (s) without poses that is reported."""
_MARGIN_NS = 1_000_000_000
"""Time (ns) before and after the clouds in which poses are used."""

_SCANS, _RETURNS = 31, 10_000
"""Number of scans, and of returns; every second scan makes the patches."""
_NOISE_EVERY = 4
"""Of these scans, every fourth shows the noise: its returns about its own surfaces."""
_BETTER = 1.15
"""Minimum ratio of the distances between surfaces by which one frame is better than another."""
_CHANCE_M = 0.7 * REACH_M / np.sqrt(3.0)
"""RMS distance (m) beyond which surfaces seen at different times do not meet: it is 1/sqrt(3) of
the reach where returns are distributed at random."""
_FITS, _BLURRED = 3.0, 1.5
"""Multiples of the noise: below the first, a frame may be right (KISS-ICP's own poses have 2.4);
above the second, a warning is shown."""
_SHARE_MIN = 0.05
"""Minimum share of returns within reach of a surface; poses 100 times too far apart have 0.02."""
_FRAMES_MAX = 12
"""Maximum number of frames in the bag that are tried; of more, only those of the lidars."""
_T_FRAME_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""The axes of cameras: z forward, y down."""


@dataclass(frozen=True)
class GivenPoses:
    """Poses from outside during the bag, in a map whose origin is near them and on the floor.

    trajectory: T_map_base. frame: the frame that the given poses are of.
    origin_m: (3,) origin of the map in the frame of the given poses; zeros if they are the same.
    """

    trajectory: Trajectory
    frame: str
    origin_m: FloatArray
    warnings: tuple[str, ...]


def given_poses(
    name: str | None, inputs: Inputs, settings: Settings, frame: str | None = None
) -> GivenPoses | None:
    """Read poses from a TUM file, else from a topic of the bag; None where none are named.

    frame: the frame that the poses are of; None to detect it by the clouds.
    Raises InputError where there is neither, no cloud has a pose, or no robot moves so.
    """
    if name is None:
        return None
    read = _read_poses(name, inputs, frame)
    _check_plausible(name, read)
    frame, T_base_frame, warnings = find_pose_frame(name, read, inputs, settings, frame)
    of_base = frame == inputs.rig.base_frame
    if not of_base:
        read = _of_base(read, T_base_frame)
    first = read.T_map_base[0, :3, 3]
    origin_m = np.round(first) * [1, 1, 0] if np.hypot(*first[:2]) > _FAR_M else np.zeros(3)
    # The floor below the first pose is looked for near the origin.
    from_first = read.moved(transforms.make_transform(translation=-first))
    level = level_by_first_scans(inputs, from_first, settings)
    lean_deg = float(np.degrees(np.arccos(np.clip(level.T_map_odom[2, 2], -1.0, 1.0))))
    if not of_base and lean_deg > _LEVEL_DEG:
        # The poses have the axes of the sensor at its first pose.
        origin_m = first + transforms.invert(level.T_map_odom)[:3, 3]
        moved = from_first.moved(level.T_map_odom)
        return GivenPoses(moved, frame, origin_m, tuple(warnings))
    if np.isfinite(level.floor_rms_m):
        if lean_deg > _LEAN_MAX_DEG:
            raise InputError(
                f"--trajectory {name}: its z axis is {lean_deg:.0f} deg from the vertical that "
                f"walls and floor show. Use poses of {inputs.rig.base_frame} in a frame whose z "
                "points up"
            )
        floor_m = first[2] - float((level.T_map_odom @ from_first.T_map_base[0])[2, 3])
        origin_m[2] = floor_m if abs(floor_m) > _FLOOR_OFF_M else 0.0
    else:
        warnings.append(
            f"no floor was found in the first seconds below the poses of {name}. Check that they "
            "are of this drive"
        )
    gaps_s = np.diff(read.stamp_ns) / 1e9
    if len(gaps_s) and gaps_s.max() > _GAP_S:
        warnings.append(
            f"{name} has no pose for {gaps_s.max():.1f} s from "
            f"{read.stamp_ns[gaps_s.argmax()] / 1e9:.3f} s on. Poses are interpolated there, and "
            "wrong where the robot did not move evenly"
        )
    if origin_m.any():
        x, y, z = origin_m
        warnings.append(
            f"the origin of the map, on the floor and near the first pose, is at x {x:.0f}, "
            f"y {y:.0f}, z {z:.3f} m in the frame of {name}. Add it to coordinates of the map to "
            "convert them (run.json: map_origin)"
        )
    moved = read.moved(transforms.make_transform(translation=-origin_m))
    return GivenPoses(moved, frame, origin_m, tuple(warnings))


def find_pose_frame(
    name: str, given: Trajectory, inputs: Inputs, settings: Settings, frame: str | None
) -> tuple[str, FloatArray, list[str]]:
    """Detect the frame of poses: the named one, the base, or one by which surfaces agree better.

    Returns its name, its T_base_frame (4, 4), and warnings.
    Raises InputError for an unknown frame, and where surfaces agree by none.
    """
    sensor = inputs.horizontal or inputs.vertical
    assert sensor is not None
    base, known = inputs.rig.base_frame, _known(inputs)
    if frame is not None and frame not in known:
        raise InputError(
            f"--trajectory-frame {frame}: no such frame; use one of {', '.join(known)}"
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
            f"--trajectory {name}: surfaces that {sensor.lidar.topic} saw at different times are "
            f"{100 * best_m:.1f} cm apart in every known frame. Use poses of this drive, in "
            "metres, stamped by the lidar's clock, or omit --trajectory"
        )
    warnings = []
    if best_m < as_base_m:
        warnings.append(
            f"{name} contains poses of {best}, not of {base}, and is used as such: surfaces seen "
            f"at different times are {100 * best_m:.1f} cm apart, and {100 * as_base_m:.1f} cm by "
            f"{base}; --trajectory-frame {base} overrules this"
        )
    if best_m > _BLURRED * noise_m:
        warnings.append(
            f"{name}: surfaces seen at different times are {100 * best_m:.1f} cm apart by its "
            f"poses (noise: {100 * noise_m:.1f} cm), which blurs the map. Use more precise poses, "
            "or omit --trajectory"
        )
    return best, T_best, warnings


def _of_base(given: Trajectory, T_base_frame: FloatArray) -> Trajectory:
    return Trajectory(given.stamp_ns, given.T_map_base @ transforms.invert(T_base_frame))


def _known(inputs: Inputs) -> dict[str, FloatArray]:
    """T_base_frame (4, 4) of the base, the lidars, and frames that transforms join with them."""
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
    poses: Trajectory, sensor: Sensor, mapped: Sequence[Scan], laid: Sequence[Scan]
) -> tuple[float, float]:
    """Compare returns of some scans with surfaces of others; see `surfaces_agreement`."""
    T = sensor.lidar.T_base_sensor
    patches = Patches.of(place_returns(mapped, poses, T), voxel_m=0.1, neighbours=16)
    return surfaces_agreement(patches, poses, laid, T, _RETURNS)


def _read_poses(name: str, inputs: Inputs, frame: str | None) -> Trajectory:
    """Read the poses during the bag, and the nearest before and after it."""
    whole = _read_all_poses(name, inputs, frame or inputs.rig.base_frame)
    sensor = inputs.vertical or inputs.horizontal
    assert sensor is not None
    stamps = sensor.index.stamp_ns[sensor.index.usable]
    if not whole.covers(stamps, _MARGIN_NS).any():
        raise InputError(
            f"--trajectory {name}: its poses are from {_seconds(whole.stamp_ns)}, the clouds of "
            f"{sensor.lidar.topic} from {_seconds(stamps)}; give poses of this drive that were "
            "stamped by the same clock"
        )
    first = max(int(np.searchsorted(whole.stamp_ns, stamps[0] - _MARGIN_NS)) - 1, 0)
    last = int(np.searchsorted(whole.stamp_ns, stamps[-1] + _MARGIN_NS)) + 1
    return Trajectory(whole.stamp_ns[first:last], whole.T_map_base[first:last])


def _read_all_poses(name: str, inputs: Inputs, frame: str) -> Trajectory:
    if Path(name).exists():
        return read_tum(Path(name))
    with open_bag(inputs.bag_path) as bag:
        if name in bag.topics:
            return read_pose_topic(bag, name, frame, inputs.rig.tree)
    path = inputs.bag_path
    raise InputError(
        f"--trajectory {name}: is neither a file nor a topic of {path}; 'ffmap info {path.words}' "
        "lists the topics"
    )


def _seconds(stamp_ns: IntArray) -> str:
    return f"{stamp_ns[0] / 1e9:.1f} to {stamp_ns[-1] / 1e9:.1f} s"


def _check_plausible(name: str, poses: Trajectory) -> None:
    """Raise InputError where no robot has such poses: grids are as large as they are far apart."""
    places = poses.T_map_base[:, :3, 3]
    if np.abs(places).max() > _COORDINATE_MAX_M:
        raise InputError(
            f"--trajectory {name}: has a pose {np.abs(places).max():.3g} m from its origin; give "
            "metres"
        )
    step_m, step_s = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(poses.stamp_ns) / 1e9
    jumps = np.flatnonzero((step_m > _JUMP_M) & (step_m > _SPEED_MAX_M_S * step_s))
    if len(jumps):
        raise InputError(
            f"--trajectory {name}: jumps by {step_m[jumps[0]]:.6g} m within "
            f"{step_s[jumps[0]]:.3f} s at {poses.stamp_ns[jumps[0]] / 1e9:.3f} s; give poses in "
            "metres, all in one frame"
        )
