"""What a stage of a run takes beside its floor: what the same machine needs for what cannot be left out of it."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, Scan, UInt8Array, within_range
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.poses.refinement import RefinementSettings
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.scans import read_scans

_SCANS = 60
"""Number of scans that are labelled."""
_CLOUDS = 300
"""Maximum number of clouds that are read."""
_CACHE_LINE_BYTES = 64
_CHUNK_BYTES = 8 << 20


@dataclass(frozen=True)
class Line:
    """A stage beside its floor, both in the same unit. floor: None where nothing of the stage is beyond doubt."""

    floor: float | None
    takes: float

    @property
    def ratio(self) -> float | None:
        """How many times its floor the stage takes."""
        return None if not self.floor else self.takes / self.floor


@dataclass(frozen=True)
class LabellingTimes:
    """Smoothing and labelling of single scans, on one thread.

    floor_ms: (s,) of touching each return once. takes_ms: (s,). points: the returns of a scan, the mean.
    """

    floor_ms: FloatArray
    takes_ms: FloatArray
    points: float

    @property
    def line(self) -> Line:
        """The medians."""
        return Line(float(np.median(self.floor_ms)), float(np.median(self.takes_ms)))


def time_reading(sensor: Sensor, bag_path: BagPath) -> Line:
    """Milliseconds a scan. The floor: the bytes of a lidar's messages, read and not decoded."""
    count = min(len(sensor.index), _CLOUDS)
    messages = int(sensor.index.message_count[:count].sum())

    def touch() -> None:
        with open_bag(bag_path) as bag:
            for raw in islice(bag.messages([sensor.lidar.topic]), messages):
                np.frombuffer(raw.data, np.uint8)[::_CACHE_LINE_BYTES].max(initial=0)

    def decode() -> None:
        with open_bag(bag_path) as bag:
            for _ in read_scans(bag, sensor.index, 0, count, sensor.lidar.decoding):
                pass

    touch()  # from now on the bag is in the system's cache, for both
    return Line(1e3 * _seconds(touch) / count, 1e3 * _seconds(decode) / count)


def time_odometry_floor_s(sensor: Sensor, bag_path: BagPath, settings: Settings) -> float:
    """KISS-ICP alone registers the horizontal scans: nothing is read, refined or closed in this time."""
    # Only the odometry needs KISS-ICP.
    from ffmap.algorithms.poses.odometry import register_scans

    def scans() -> Iterator[tuple[int, Scan, None]]:
        with open_bag(bag_path) as bag:
            for index, scan in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding):
                if isinstance(scan, Scan):
                    yield index, within_range(scan, settings.scan.range_max_m), None

    registrations = register_scans(scans(), settings.odometry, RefinementSettings(enabled=False))
    return sum(registration.milliseconds for registration in registrations) / 1e3


def time_labelling(sensor: Sensor, bag_path: BagPath, trajectory: Trajectory, settings: Settings) -> LabellingTimes:
    """Some scans from all over the bag, once the code is compiled. trajectory: T_map_base."""
    scans, columns = _placed_scans(sensor, bag_path, trajectory, settings), sensor.lidar.column_pairs
    for index, scan, placed in scans[:5]:
        label_scan(scan, placed, settings.method, index, column_pairs=columns)
        _touch_returns(scan.points_sensor, np.empty(len(scan), np.uint8))
    floor_ms, takes_ms = np.empty(len(scans)), np.empty(len(scans))
    for k, (index, scan, placed) in enumerate(scans):
        label = np.empty(len(scan), np.uint8)
        started = time.perf_counter()
        _touch_returns(scan.points_sensor, label)
        touched = time.perf_counter()
        smooth_ranges(scan, settings.smoothing)
        label_scan(scan, placed, settings.method, index, column_pairs=columns)
        floor_ms[k], takes_ms[k] = 1e3 * (touched - started), 1e3 * (time.perf_counter() - touched)
    return LabellingTimes(floor_ms, takes_ms, float(np.mean([len(scan) for _, scan, _ in scans])))


@numba.njit(cache=True, nogil=True)
def _touch_returns(points: FloatArray, label: UInt8Array) -> None:  # pragma: no cover
    """The least that labelling can do: read each return, and write a label for it."""
    for i in range(len(points)):
        label[i] = points[i, 0] + points[i, 1] + points[i, 2] > 0


def time_writing_s(folder: Path, size_bytes: int) -> float:
    """A file of this size is written to a folder, and removed again."""
    chunk, path = np.random.default_rng(0).bytes(_CHUNK_BYTES), folder / "plain"

    def write() -> None:
        with path.open("wb", buffering=0) as file:
            for done in range(0, size_bytes, _CHUNK_BYTES):
                file.write(chunk[: size_bytes - done])

    seconds = _seconds(write)
    path.unlink()
    return seconds


def cloud_bytes(inputs: Inputs) -> int:
    """22 bytes for each place of the lidars' clouds."""
    return sum(22 * sensor.lidar.points_per_cloud * len(sensor.index) for sensor in inputs.used(given_poses=False))


def _placed_scans(
    sensor: Sensor, bag_path: BagPath, trajectory: Trajectory, settings: Settings
) -> list[tuple[int, Scan, PlacedScan]]:
    scans = []
    with open_bag(bag_path) as bag:
        for first in np.linspace(0, len(sensor.index) - 1, _SCANS).astype(int):
            for index, scan in read_scans(bag, sensor.index, int(first), 1, sensor.lidar.decoding):
                if isinstance(scan, Scan):
                    scan = sensor.lidar.seen(within_range(scan, settings.scan.range_max_m), trajectory)
                    ranges = smooth_ranges(scan, settings.smoothing)
                    scans.append((index, scan, place_scan(ranges.of(scan), trajectory, sensor.lidar.T_base_sensor)))
    return scans


def _seconds(work: Callable[[], None]) -> float:
    started = time.perf_counter()
    work()
    return time.perf_counter() - started
