"""The poses of a run: its map's frame from the first sweeps, and all of it made again for one that is finished."""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, within_range
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.poses.levelling import Level, level_map
from ffmap.app.run.blocks import points_in_map
from ffmap.app.run.odometry import Odometry
from ffmap.app.run.trajectory_frame import find_pose_frame
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_checks import clock_problem
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import read_scans
from ffmap.loaders.trajectory_file import read_pose_topic, read_tum

_LEVEL_SCANS = 24
_LEVEL_POINTS = 4_000

_FAR_M = 1_000.0
"""Distance in metres from their frame's origin beyond which poses from outside, as in UTM, are moved: float32 keeps a tenth of
a millimetre of a kilometre, but half a metre of the northing of a place."""
_FLOOR_OFF_M = 0.1
"""Distance in metres of the floor from the height 0 of such poses beyond which the steps after this one would not find it."""
_LEAN_MAX_DEG = 30.0
_LEVEL_DEG = 1.0
"""Angle from the upright of the z axis of a sensor's poses beyond which their axes are the sensor's too."""
_JUMP_M, _SPEED_MAX_M_S = 10.0, 100.0
"""Distance in metres and speed of a step between poses beyond which they are of another frame, or not in metres."""
_GAP_S = 1.0
"""Time without poses from which on a robot may have done anything between them."""
_COORDINATE_MAX_M = 1e8
_MARGIN_NS = 1_000_000_000
"""Time before and after the bag's own, or a scan's, in which poses count."""


@dataclass(frozen=True)
class RunPoses:
    """What a run placed its scans with.

    trajectory: T_map_base. registered: the same before loops were closed, by which each scan is labelled: what it owes to
    its poses is the motion within its sweep. floor_slope: (2,) of the map's floor, metres up for each metre along x and y.
    """

    trajectory: Trajectory
    registered: Trajectory
    floor_slope: FloatArray

    @property
    def base_height_m(self) -> float:
        """How high the base stands above the floor."""
        return float(self.registered.T_map_base[0, 2, 3])

    @property
    def known(self) -> "KnownPoses":
        """What scans are labelled with, all of it."""
        return KnownPoses(self.registered.stamp_ns, self.registered.part, self.floor_slope, complete=True)


@dataclass(frozen=True)
class KnownPoses:
    """The poses that scans are labelled with, while they become known.

    stamp_ns: of those that are known, increasing. part: T_map_base of those from one up to another. floor_slope: see
    `RunPoses`. complete: whether there will be no more.
    """

    stamp_ns: Sequence[int] | IntArray
    part: Callable[[int, int], Trajectory]
    floor_slope: FloatArray
    complete: bool = False

    @property
    def base_height_m(self) -> float:
        """How high the base stands above the floor."""
        return float(self.part(0, 1).T_map_base[0, 2, 3])

    def around(self, stamp_ns: IntArray) -> Trajectory | None:
        """The poses about some scans; None while more of them may become known."""
        first = max(0, bisect_left(self.stamp_ns, int(stamp_ns.min()) - _MARGIN_NS) - 2)
        last = bisect_left(self.stamp_ns, int(stamp_ns.max()) + _MARGIN_NS) + 2
        return self.part(first, last) if self.complete or last <= len(self.stamp_ns) else None


@dataclass(frozen=True)
class GivenPoses:
    """Poses from outside, as a run uses them: those of the bag's time, in a map whose origin is near them, on the floor.

    trajectory: T_map_base. frame: that the given poses are of. origin_m: (3,) where the map's origin
    lies in the poses' own frame; zeros where that frame's own origin will do. warnings: what a user
    must know of that. The map keeps the axes of the poses where their z axis is upright.
    """

    trajectory: Trajectory
    frame: str
    origin_m: FloatArray
    warnings: tuple[str, ...]


def given_poses(
    name: str | None, inputs: Inputs, settings: Settings, frame: str | None = None
) -> GivenPoses | None:
    """Poses from a TUM file, or from a topic of the bag where no such file is there; None where none are named.

    frame: that the poses are of; None to find it by the clouds.
    Raises InputError where it is neither, where no cloud has a pose, and where no robot can have had these poses.
    """
    if name is None:
        return None
    read = _read_poses(name, inputs, frame)
    _check_plausible(name, read)
    found = find_pose_frame(name, read, inputs, settings, frame)
    if found.name != inputs.rig.base_frame:
        read = Trajectory(read.stamp_ns, read.T_map_base @ found.T_frame_base)
    first = read.T_map_base[0, :3, 3]
    origin_m = np.round(first) * [1, 1, 0] if np.hypot(*first[:2]) > _FAR_M else np.zeros(3)
    # Wherever the poses lie, the floor below the first of them is looked for near the origin.
    from_first = read.moved(transforms.make_transform(translation=-first))
    level = level_by_first_scans(inputs, from_first, settings)
    warnings = found.warnings(name, inputs.rig.base_frame)
    lean_deg = float(np.degrees(np.arccos(np.clip(level.T_map_odom[2, 2], -1.0, 1.0))))
    if found.name != inputs.rig.base_frame and lean_deg > _LEVEL_DEG:
        # Axes of a sensor at its first pose: the map has those of a run without poses.
        origin_m = first + transforms.invert(level.T_map_odom)[:3, 3]
        return GivenPoses(from_first.moved(level.T_map_odom), found.name, origin_m, tuple(warnings))
    if np.isfinite(level.floor_rms_m):
        _check_upright(name, lean_deg, inputs)
        floor_m = first[2] - float((level.T_map_odom @ from_first.T_map_base[0])[2, 3])
        origin_m[2] = floor_m if abs(floor_m) > _FLOOR_OFF_M else 0.0
    else:
        warnings.append(f"no floor was found in the first seconds below the poses of {name}: are they of this drive?")
    gaps_s = np.diff(read.stamp_ns) / 1e9
    if len(gaps_s) and gaps_s.max() > _GAP_S:
        warnings.append(
            f"{name} has no pose for {gaps_s.max():.1f} s from {read.stamp_ns[gaps_s.argmax()] / 1e9:.3f} s on: the poses of the "
            "scans between are interpolated, and off where the robot did not move evenly"
        )
    if origin_m.any():
        x, y, z = origin_m
        warnings.append(
            f"the map's origin, on the floor and near the first pose, is at x {x:.0f}, y {y:.0f}, z {z:.3f} m in the frame of "
            f"{name}: add that to the map's coordinates to have its (run.json: map_origin)"
        )
    moved = read.moved(transforms.make_transform(translation=-origin_m))
    return GivenPoses(moved, found.name, origin_m, tuple(warnings))


def check_lidars_meet(inputs: Inputs) -> None:
    """Raises InputError where a vertical lidar has no cloud in the time of the horizontal one, which gives its poses."""
    if inputs.horizontal is None:
        return
    horizontal = inputs.horizontal.index.stamp_ns[inputs.horizontal.index.usable]
    for sensor in inputs.verticals:
        vertical = sensor.index.stamp_ns[sensor.index.usable]
        within = (vertical >= horizontal[0] - _MARGIN_NS) & (vertical <= horizontal[-1] + _MARGIN_NS)
        if not within.any():
            problem = clock_problem(inputs.horizontal.index, sensor.index)
            raise InputError(f"{inputs.bag_path}: no vertical cloud has a pose: {problem}")


def _read_poses(name: str, inputs: Inputs, frame: str | None) -> Trajectory:
    """The poses of the bag's own time, and the nearest before and after it."""
    whole = _read_all_poses(name, inputs, frame or inputs.rig.base_frame)
    sensor = inputs.vertical or inputs.horizontal
    assert sensor is not None
    stamps = sensor.index.stamp_ns[sensor.index.usable]
    if not whole.covers(stamps, _MARGIN_NS).any():
        raise InputError(
            f"--trajectory {name}: its poses are of {_seconds(whole.stamp_ns)}, the clouds of {sensor.lidar.topic} of "
            f"{_seconds(stamps)}; give poses of this drive that were stamped by the same clock"
        )
    first = max(int(np.searchsorted(whole.stamp_ns, stamps[0] - _MARGIN_NS)) - 1, 0)
    last = int(np.searchsorted(whole.stamp_ns, stamps[-1] + _MARGIN_NS)) + 1
    return Trajectory(whole.stamp_ns[first:last], whole.T_map_base[first:last])


def _seconds(stamp_ns: IntArray) -> str:
    return f"{stamp_ns[0] / 1e9:.1f} to {stamp_ns[-1] / 1e9:.1f} s"


def _check_plausible(name: str, poses: Trajectory) -> None:
    """Raises InputError where the poses are no robot's: grids reach as far as they do."""
    places = poses.T_map_base[:, :3, 3]
    if np.abs(places).max() > _COORDINATE_MAX_M:
        raise InputError(f"--trajectory {name}: has a pose {np.abs(places).max():.3g} m from its origin; give metres")
    step_m, step_s = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(poses.stamp_ns) / 1e9
    jumps = np.flatnonzero((step_m > _JUMP_M) & (step_m > _SPEED_MAX_M_S * step_s))
    if len(jumps):
        raise InputError(
            f"--trajectory {name}: jumps by {step_m[jumps[0]]:.6g} m within {step_s[jumps[0]]:.3f} s at "
            f"{poses.stamp_ns[jumps[0]] / 1e9:.3f} s; give poses in metres, all in one frame"
        )


def _check_upright(name: str, lean_deg: float, inputs: Inputs) -> None:
    if lean_deg > _LEAN_MAX_DEG:
        wrong = f"its z axis leans {lean_deg:.0f} deg off the upright that walls and floor show"
        raise InputError(
            f"--trajectory {name}: {wrong}; give poses of {inputs.rig.base_frame} in a frame whose z points up"
        )


def _read_all_poses(name: str, inputs: Inputs, frame: str) -> Trajectory:
    if Path(name).exists():
        return read_tum(Path(name))
    with open_bag(inputs.bag_path) as bag:
        if name in bag.topics:
            return read_pose_topic(bag, name, frame, inputs.rig.tree)
    path = inputs.bag_path
    raise InputError(
        f"--trajectory {name}: is neither a file nor a topic of {path}; 'ffmap info {path.words}' lists the topics"
    )


def shows_level(stamp_ns: Sequence[int], settings: Settings) -> bool:
    """Whether the scans that were registered are all that the map is levelled by."""
    return len(stamp_ns) > 1 and stamp_ns[-1] - stamp_ns[0] >= int(settings.trajectory.level_s * 1e9)


def level_by_first_scans(inputs: Inputs, odometry: Trajectory, settings: Settings) -> Level:
    """The map's frame from what some of the first sweeps saw of walls and floor.

    odometry: T_odom_base as it was registered.
    """
    elapsed_ns = odometry.stamp_ns - odometry.stamp_ns[0]
    first_poses = int(np.searchsorted(elapsed_ns, int(settings.trajectory.level_s * 1e9))) + 1
    odometry = odometry.part(0, first_poses)
    sensor = inputs.vertical or inputs.horizontal
    assert sensor is not None
    points: list[FloatArray] = []
    covered = np.flatnonzero(odometry.covers(sensor.index.stamp_ns, margin_ns=100_000_000))
    # Spread over the time: a robot at rest sees the same few walls again and again.
    chosen = set(covered[np.linspace(0, len(covered) - 1, min(_LEVEL_SCANS, len(covered))).astype(int)].tolist())
    first, last = min(chosen, default=0), max(chosen, default=-1)
    with open_bag(inputs.bag_path) as bag:
        for index, scan in read_scans(bag, sensor.index, first, last - first + 1, sensor.lidar.decoding):
            if index not in chosen or not isinstance(scan, Scan):
                continue
            scan = within_range(scan, settings.scan.range_max_m)
            # As measured: planes of thousands of returns need no smoothing, and no labelling setting moves a pose.
            placed = place_scan(scan, odometry, sensor.lidar.T_base_sensor)
            points.append(points_in_map(placed)[:: max(1, len(scan) // _LEVEL_POINTS)])
    return level_map(np.concatenate(points) if points else np.zeros((0, 3)), odometry.T_map_base[0], settings.seed)


def poses_of(inputs: Inputs, given: GivenPoses | None, settings: Settings) -> RunPoses:
    """The poses that a run with these inputs and settings has, bit for bit; registered again where not cached.

    given: the run's poses from outside, or None for its odometry.
    Raises InputError where no lidar gives poses.
    """
    if given is not None:
        return RunPoses(given.trajectory, given.trajectory, np.zeros(2))
    sensor = inputs.horizontal
    if sensor is None:
        raise InputError(f"{inputs.bag_path}: no horizontal lidar gives poses; the run needs its trajectory")
    odometry = Odometry(inputs, sensor, settings)
    deque(odometry, maxlen=0)
    if not len(odometry):
        raise InputError(f"{inputs.bag_path}: {sensor.lidar.topic} has no usable cloud; 'ffmap info' tells more")
    level = level_by_first_scans(inputs, odometry.registered(), settings)
    return levelled(odometry.trajectory, odometry.registered(), level)


def levelled(trajectory: Trajectory, registered: Trajectory, level: Level) -> RunPoses:
    """T_odom_base of a whole drive, with its loops closed and as registered, in the levelled map."""
    return RunPoses(trajectory.moved(level.T_map_odom), registered.moved(level.T_map_odom), level.floor_slope)
