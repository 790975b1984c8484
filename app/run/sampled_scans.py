"""Some scans of a lidar, spread over the drive."""

from collections.abc import Sequence

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, within_range
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.poses.levelling import Level, level_map
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.scans import read_scans

_MAP_POINTS = 12_000
"""Maximum number of returns of one scan in a map."""
_LEVEL_S, _LEVEL_SCANS, _LEVEL_POINTS = 8.0, 24, 4_000
"""Of the map's levelling: seconds from the start, number of scans, and of returns of each."""
_MARGIN_NS = 100_000_000
"""Duration (ns) of a sweep: it is covered by poses that begin and end so much farther out."""


def scans_of(
    inputs: Inputs, sensor: Sensor, odometry: Trajectory, settings: Settings, count: int
) -> list[Scan]:
    """Read at most `count` of a lidar's scans, spread over the time of the poses."""
    covered = np.flatnonzero(odometry.covers(sensor.index.stamp_ns, margin_ns=-_MARGIN_NS))
    return _read(inputs, sensor, np.unique(_spread(covered, count)), settings)


def map_of(inputs: Inputs, odometry: Trajectory, settings: Settings, count: int) -> FloatArray:
    """Place returns (n, 3) of some scans of the horizontal lidar."""
    assert inputs.horizontal is not None
    scans = scans_of(inputs, inputs.horizontal, odometry, settings, count)
    return place_returns(scans, odometry, inputs.horizontal.lidar.T_base_sensor)


def place_returns(
    scans: Sequence[Scan], poses: Trajectory, T_base_sensor: FloatArray, most: int = _MAP_POINTS
) -> FloatArray:
    """Place at most about `most` returns (n, 3) of each scan."""
    points: list[FloatArray] = [np.zeros((0, 3))]
    for scan in scans:
        placed = place_scan(scan, poses, T_base_sensor)
        points.append(placed.to_map(placed.points_level[:: max(1, len(scan) // most)]))
    return np.concatenate(points).astype(np.float64)


def level_by_first_scans(inputs: Inputs, poses: Trajectory, settings: Settings) -> Level:
    """Find the frame of the map by walls and floor in the first scans.

    poses: T_odom_base, as registered.
    """
    elapsed_ns = poses.stamp_ns - poses.stamp_ns[0]
    count = int(np.searchsorted(elapsed_ns, round(_LEVEL_S * 1e9))) + 1
    poses = poses.part(0, count)
    sensor = inputs.vertical or inputs.horizontal
    assert sensor is not None
    covered = np.flatnonzero(poses.covers(sensor.index.stamp_ns, margin_ns=_MARGIN_NS))
    points: list[FloatArray] = [np.zeros((0, 3), np.float32)]
    # Spread over time: a robot at rest sees the same few walls.
    for scan in _read(inputs, sensor, np.unique(_spread(covered, _LEVEL_SCANS)), settings):
        # Not smoothed: planes of thousands of returns need it not.
        placed = place_scan(scan, poses, sensor.lidar.T_base_sensor)
        points_map = transform(placed.T_map_level, placed.points_level)
        points.append(points_map[:: max(1, len(scan) // _LEVEL_POINTS)])
    return level_map(np.concatenate(points), poses.T_map_base[0], settings.seed)


def transform(T_map_level: FloatArray, points_level: FloatArray) -> FloatArray:
    """Transform points (n, 3) in single precision."""
    T = T_map_level.astype(np.float32)
    points_map = points_level @ T[:3, :3].T
    # Axis by axis: over rows of three, NumPy's addition takes three times as long as the product.
    for axis in range(3):
        points_map[:, axis] += T[axis, 3]
    return np.asarray(points_map)


def _spread(numbers: IntArray, count: int) -> IntArray:
    places = np.linspace(0, len(numbers) - 1, min(count, len(numbers)))
    return np.asarray(numbers[places.astype(int)])


def _read(inputs: Inputs, sensor: Sensor, numbers: IntArray, settings: Settings) -> list[Scan]:
    scans: list[Scan] = []
    with open_bag(inputs.bag_path) as bag:
        for number in numbers.tolist():
            for _, scan in read_scans(bag, sensor.index, number, 1, sensor.lidar.decoding):
                if isinstance(scan, Scan):
                    near = within_range(scan, settings.scan.range_max_m)
                    scans += [near] if len(near) else []
    return scans
