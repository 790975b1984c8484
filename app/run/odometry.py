"""The odometry of a bag: register the horizontal scans and close loops (paper, IV.A), cached."""

import hashlib
import json
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, within_range
from ffmap.algorithms.base.trajectory import GAP_PERIODS, Trajectory
from ffmap.algorithms.poses.odometry import Registration, doubt
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.run.odometry_cache import CacheWriter, read_cached
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.scans import SkippedScan, read_scans

_COMPANION_NS = 200_000_000
"""Maximum age (ns) of the other lidar's scan that is registered with a horizontal one."""
_SCANS_AHEAD = 4
"""Number of scans that are read before they are registered."""
_FORMAT = 18
"""Raised whenever a change to reading or registering scans changes poses."""
Read = tuple[int, Scan, Scan | None]
"""Number of a cloud, its scan, and the companion's."""


@dataclass(frozen=True)
class Odometry:
    """All registered scans of a drive, in their order.

    index: (n,) number of each cloud. stamp_ns: (n,). T_odom_sensor: (n, 4, 4) as registered.
    pose_graph: None where loops are not closed. doubts: place among the scans of the first one
    after a gap, and why its pose may be wrong. failed: scans whose registration raised an
    exception; none from the cache.
    """

    sensor: Sensor
    index: IntArray
    stamp_ns: IntArray
    T_odom_sensor: FloatArray
    pose_graph: PoseGraph | None
    doubts: tuple[tuple[int, str], ...]
    failed: tuple[SkippedScan, ...]
    cached: bool
    cache_warning: str | None

    @property
    def registered(self) -> Trajectory:
        """T_odom_base as registered."""
        return self._of_base(self.T_odom_sensor)

    @property
    def trajectory(self) -> Trajectory:
        """T_odom_base with loops closed."""
        graph = self.pose_graph
        return self._of_base(graph.corrected(self.T_odom_sensor) if graph else self.T_odom_sensor)

    @property
    def warnings(self) -> list[str]:
        """Name the parts of the drive that have no pose, or one that may be wrong."""
        clouds = self.sensor.index
        number_of = np.cumsum(clouds.usable) - 1  # of each cloud among the usable ones
        stamps_ns, numbers = self.stamp_ns.tolist(), number_of[self.index].tolist()
        usable_ns = clouds.stamp_ns[clouds.usable]
        return unjoined_parts(stamps_ns, numbers, self.doubts, usable_ns, self._gap_ns)

    @property
    def _gap_ns(self) -> float:
        return GAP_PERIODS * (self.sensor.index.period_ns or np.inf)

    def _of_base(self, T_odom_sensor: FloatArray) -> Trajectory:
        T_sensor_base = transforms.invert(self.sensor.lidar.T_base_sensor)
        return Trajectory(self.stamp_ns, T_odom_sensor @ T_sensor_base, self._gap_ns)


def run_odometry(
    inputs: Inputs,
    sensor: Sensor,
    settings: Settings,
    fingerprint: Callable[[], str],
    on_scan: Callable[[Registration], None] = lambda registration: None,
    on_failure: Callable[[Sequence[SkippedScan]], None] = lambda failed: None,
) -> Odometry:
    """Register all usable scans of a lidar, or read them from the cache.

    fingerprint: of the bag; called where the cache may contain its odometry, and at the end.
    on_scan: is called for each registration. on_failure: is called with all failed scans so far.
    """
    key = cache_key(inputs, sensor, settings)
    cached = read_cached(key, fingerprint)
    failed: list[SkippedScan] = []

    def fail(cloud: SkippedScan) -> None:
        failed.append(cloud)
        on_failure(failed)

    writer = CacheWriter(key, fingerprint) if cached.results is None else None
    computed = _register(inputs, sensor, settings, fail)
    results = writer.keep(computed) if writer is not None else cached.results
    assert results is not None
    index: list[int] = []
    stamp_ns: list[int] = []
    T_odom_sensor: list[FloatArray] = []
    doubts: list[tuple[int, str]] = []
    pose_graph: PoseGraph | None = None
    for result in results:
        if isinstance(result, PoseGraph):
            pose_graph = result
            continue
        if (why := doubt(result)) is not None:
            doubts.append((len(index), why))
        index.append(result.index)
        stamp_ns.append(result.stamp_ns)
        T_odom_sensor.append(result.T_odom_sensor)
        on_scan(result)
    return Odometry(
        sensor=sensor,
        index=np.array(index, np.int64),
        stamp_ns=np.array(stamp_ns, np.int64),
        T_odom_sensor=np.array(T_odom_sensor).reshape(-1, 4, 4),
        pose_graph=pose_graph,
        doubts=tuple(doubts),
        failed=tuple(failed),
        cached=writer is None,
        cache_warning=cached.damage or (writer.failure if writer else None),
    )


def cache_key(inputs: Inputs, sensor: Sensor, settings: Settings) -> str:
    """Name everything that poses depend on but the bag: no setting of labelling is among it."""
    companion = _companion(inputs, settings)
    sensors = [sensor] if companion is None else [sensor, companion]
    content = {
        "format": _FORMAT,
        "lidars": [
            {
                "topic": s.lidar.topic,
                "clouds": len(s.index),
                "T_base_sensor": s.lidar.T_base_sensor.tolist(),
                "clock_ns": s.lidar.decoding.clock_ns,
                "time_from": s.lidar.decoding.time_from,
                "own_body": b.voxel.tolist() if (b := s.lidar.decoding.own_body) else None,
            }
            for s in sensors
        ],
        **{name: version(name) for name in ("kiss-icp", "small_gicp", "gtsam")},
        **settings.model_dump(
            mode="json", include={"scan", "odometry", "refinement", "pose_graph", "trajectory"}
        ),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def unjoined_parts(
    stamps_ns: Sequence[int],
    numbers: Sequence[int],
    doubts: Sequence[tuple[int, str]],
    clouds_ns: IntArray,
    gap_ns: float,
) -> list[str]:
    """Describe the parts of a drive that have no pose, or one that may be wrong.

    stamps_ns, numbers: of the registered scans; the number of each among the usable clouds.
    doubts: as in `Odometry`. clouds_ns: of the usable clouds. gap_ns: a longer step is a gap.
    """
    ends = [*zip(stamps_ns, numbers, strict=True), (int(clouds_ns[-1]), len(clouds_ns))]

    def part(at_ns: int, end_ns: int, count: int) -> str:
        at_s, seconds = (at_ns - clouds_ns[0]) / 1e9, (end_ns - at_ns) / 1e9
        return f"the {seconds:.1f} s after {at_s:.1f} s ({count} scans)"

    found = []
    for (at_ns, number), (next_ns, next_number) in pairwise(ends):
        count = next_number - number - 1
        if count > 1 and next_ns - at_ns > gap_ns:
            found.append(
                f"{part(at_ns, next_ns, count)} could not be joined to the map and are left out; "
                "to map them, cut them out as a bag of their own"
            )
    for (place, why), (until, _) in pairwise([*doubts, (len(stamps_ns), "")]):
        doubtful = part(stamps_ns[place - 1], ends[until - 1][0], until - place)
        found.append(
            f"{doubtful} could not be joined to the map for certain, and may be at a wrong place: "
            f"{why}"
        )
    return found


def _register(
    inputs: Inputs, sensor: Sensor, settings: Settings, fail: Callable[[SkippedScan], None]
) -> Iterator[Registration | PoseGraph]:
    # Imported here: `ffmap info` and worker processes do not need KISS-ICP and GTSAM.
    from ffmap.algorithms.poses.odometry import register_scans
    from ffmap.algorithms.poses.pose_graph import close_loops

    companion = _companion(inputs, settings)
    T_base_sensor, T_sensor_companion = sensor.lidar.T_base_sensor, None
    if companion is not None:
        T_sensor_companion = transforms.invert(T_base_sensor) @ companion.lidar.T_base_sensor
    read = _with_companions(inputs.bag_path, sensor, companion, settings.scan.range_max_m)
    scans = _ahead(read)
    poses: list[FloatArray] = []
    clouds: list[FloatArray] = []
    for registration in register_scans(
        scans,
        settings.odometry,
        settings.refinement,
        T_sensor_companion,
        T_base_sensor,
        lambda index, scan, error: fail(SkippedScan.failed(index, scan.stamp_ns, error)),
    ):
        yield registration
        poses.append(registration.T_odom_sensor)
        clouds.append(registration.keypoints_sensor)
    if settings.pose_graph.enabled:
        yield close_loops(np.array(poses).reshape(-1, 4, 4), clouds, settings.pose_graph)


def _ahead(read: Iterator[Read]) -> Iterator[Read]:
    """Read in a thread, some scans ahead of those that are registered."""
    with ThreadPoolExecutor(1) as thread:
        waiting = deque(thread.submit(next, read, None) for _ in range(_SCANS_AHEAD))
        while (item := waiting.popleft().result()) is not None:
            waiting.append(thread.submit(next, read, None))
            yield item


def _companion(inputs: Inputs, settings: Settings) -> Sensor | None:
    """Choose the lidar whose scans are registered with the horizontal ones, if any."""
    refinement = settings.refinement
    if inputs.horizontal is None or not refinement.enabled or refinement.companion_points_max == 0:
        return None
    return next(iter(inputs.others), None)


def _with_companions(
    bag_path: BagPath, sensor: Sensor, companion: Sensor | None, range_max_m: float
) -> Iterator[Read]:
    """Read the usable scans; with each the companion's last scan that ended before it, once."""
    others = _usable_scans(bag_path, companion, range_max_m) if companion is not None else iter(())
    following = next(others, None)
    for index, scan in _usable_scans(bag_path, sensor, range_max_m):
        latest: Scan | None = None
        while following is not None and following[1].end_ns <= scan.end_ns:
            latest = following[1]
            following = next(others, None)
        if latest is not None and scan.end_ns - latest.end_ns > _COMPANION_NS:
            latest = None
        yield index, scan, latest


def _usable_scans(
    bag_path: BagPath, sensor: Sensor, range_max_m: float
) -> Iterator[tuple[int, Scan]]:
    """Read the usable scans without returns that are too far away: registration fails on those."""
    with open_bag(bag_path) as bag:
        for index, scan in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding):
            if isinstance(scan, Scan) and len(near := within_range(scan, range_max_m)):
                yield index, near
