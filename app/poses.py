"""The poses of a run: its map's frame from the first sweeps, and all of it made again for one that is finished."""

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from algorithms.levelling import Level, level_map
from algorithms.scan import FloatArray, Scan
from algorithms.trajectory import Trajectory, place_scan
from app.blocks import points_in_map
from app.inputs import Inputs
from app.odometry_stage import Odometry
from app.settings import Settings
from loaders.bag import open_bag
from loaders.errors import InputError
from loaders.scans import read_scans
from loaders.trajectory_file import read_pose_topic, read_tum

_LEVEL_SCANS = 24
_LEVEL_POINTS = 4_000


@dataclass(frozen=True)
class RunPoses:
    """What a run placed its scans with.

    trajectory: T_map_base. floor_slope: (2,) of the map's floor, metres up for each metre along x and y.
    from_cache: whether the odometry was cached.
    """

    trajectory: Trajectory
    floor_slope: FloatArray
    from_cache: bool

    @property
    def base_height_m(self) -> float:
        """How high the base stands above the floor."""
        return float(self.trajectory.T_map_base[0, 2, 3])


def given_trajectory(name: str | None, inputs: Inputs) -> Trajectory | None:
    """Poses from a TUM file, or from a topic of the bag where no such file is there; None where none are named.

    Raises InputError where it is neither.
    """
    if name is None:
        return None
    if Path(name).exists():
        return read_tum(Path(name))
    with open_bag(inputs.bag_path) as bag:
        if name in bag.topics:
            return read_pose_topic(bag, name, inputs.rig.base_frame, inputs.rig.tree)
    raise InputError(
        f"--trajectory {name}: is neither a file nor a topic of {inputs.bag_path}; "
        f"'ffmap info {inputs.bag_path}' lists the topics"
    )


def level_by_first_scans(inputs: Inputs, odometry: Trajectory, settings: Settings) -> Level:
    """The map's frame from what some of the first sweeps saw of walls and floor.

    odometry: T_odom_base.
    """
    elapsed_ns = odometry.stamp_ns - odometry.stamp_ns[0]
    first_poses = int(np.searchsorted(elapsed_ns, int(settings.trajectory.level_s * 1e9))) + 1
    odometry = Trajectory(odometry.stamp_ns[:first_poses], odometry.T_map_base[:first_poses])
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
            # As measured: planes of thousands of returns need no smoothing, and no labelling setting moves a pose.
            placed = place_scan(scan, odometry, sensor.lidar.T_base_sensor)
            stride = max(1, len(scan) // _LEVEL_POINTS)
            points.append(points_in_map(placed)[::stride])
    return level_map(np.concatenate(points) if points else np.zeros((0, 3)), odometry.T_map_base[0], settings.seed)


def poses_of(inputs: Inputs, given: Trajectory | None, settings: Settings) -> RunPoses:
    """The poses that a run with these inputs and settings has, bit for bit; registered again where not cached.

    given: the run's poses from outside, or None for its odometry.
    Raises InputError where no lidar gives poses.
    """
    if given is not None:
        return RunPoses(given, np.zeros(2), from_cache=False)
    sensor = inputs.horizontal
    if sensor is None:
        raise InputError(f"{inputs.bag_path}: no horizontal lidar gives poses; the run needs its trajectory")
    odometry = Odometry(inputs, sensor, settings)
    deque(odometry, maxlen=0)
    if not len(odometry):
        raise InputError(f"{inputs.bag_path}: {sensor.lidar.topic} has no usable cloud; 'ffmap info' tells more")
    trajectory = odometry.trajectory
    level = level_by_first_scans(inputs, trajectory, settings)
    return RunPoses(trajectory.moved(level.T_map_odom), level.floor_slope, odometry.from_cache)
