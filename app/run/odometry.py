"""The odometry of a bag: registered in a process of its own, for KISS-ICP holds the interpreter's lock, and cached.

The key under which it is cached holds all that a pose depends on and no labelling setting, so that a sweep over labelling
settings costs one odometry.
"""

import hashlib
import json
import queue
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from multiprocessing.connection import Connection

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, within_range
from ffmap.algorithms.base.trajectory import GAP_PERIODS, Trajectory
from ffmap.algorithms.poses.odometry import Registration, doubt
from ffmap.algorithms.poses.pose_graph import PoseGraph
from ffmap.app.run import odometry_cache
from ffmap.app.run.arrays import Arrays, pack, pack_rows, unpack, unpack_rows
from ffmap.app.run.workers import WorkerLostError, process_context, start_as_worker
from ffmap.app.setup.inputs import Inputs, Sensor, digest_clouds, digest_stamps, total_digest
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan, read_digests, read_scans

_PER_FILE = 50
_WAITING = 64
"""Results that the odometry process keeps back while the run's own process is busy."""
_FORMAT = 12
"""Raised whenever a change to reading or registering scans changes poses."""
_RAGGED = ("keypoints_sensor", "local_map_odom")
"""What each registration has another number of."""


@dataclass(frozen=True)
class _Read:
    """The end of an odometry: the digest of all clouds that were read, by topic."""

    clouds: dict[str, str]


_Result = Registration | SkippedScan | PoseGraph | _Read


def cache_key(inputs: Inputs, sensor: Sensor, settings: Settings) -> str:
    """What the poses depend on but for the clouds' bytes, as a name."""
    sensors = _sensors(inputs, sensor, settings)
    content = {
        "format": _FORMAT,
        "stamps": list(digest_stamps(sensors).items()),
        "time_from": sensor.lidar.decoding.time_from,
        "rig": [[s.lidar.T_base_sensor.tolist(), s.lidar.decoding.clock_ns] for s in sensors],
        "own_body": [None if (b := s.lidar.decoding.own_body) is None else b.voxel.tolist() for s in sensors],
        "kiss_icp": version("kiss-icp"),
        "small_gicp": version("small_gicp"),
        "gtsam": version("gtsam"),
        **settings.model_dump(mode="json", include={"scan", "odometry", "refinement", "pose_graph", "trajectory"}),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


class Odometry:
    """The registration of every usable horizontal scan in order, and after them the loops that were closed.

    What is not cached is registered while it is iterated over, once, and cached when that has come to its end.
    """

    def __init__(self, inputs: Inputs, sensor: Sensor, settings: Settings) -> None:
        key = cache_key(inputs, sensor, settings)
        self.cache_warning: str | None = None
        """What went wrong with the cache; None where nothing did. Known once all has been iterated over."""
        cached = self._look_up(key, inputs, _sensors(inputs, sensor, settings))
        self.from_cache = cached is not None
        self._source = cached if cached is not None else self._register_and_keep(key, inputs, sensor, settings)
        self._T_sensor_base = transforms.invert(sensor.lidar.T_base_sensor)
        self._gap_ns = GAP_PERIODS * (sensor.index.period_ns or np.inf)
        self._clouds_ns = sensor.index.stamp_ns[sensor.index.usable]
        self._number_of = np.cumsum(sensor.index.usable) - 1  # of each cloud among those that are usable
        self._numbers: list[int] = []
        self._doubts: list[tuple[int, str]] = []
        self._stamps: list[int] = []
        self._T_odom_sensor: list[FloatArray] = []
        self.pose_graph: PoseGraph | None = None
        """None before the end, and where loops are not to be closed."""
        self.clouds: Mapping[str, str] = {}
        """The digest of all clouds of each topic that was read; empty before the end."""
        self.failed: list[SkippedScan] = []
        """Scans so far whose registration raised an exception; none from the cache."""

    def __iter__(self) -> Iterator[Registration]:
        for result in self._source:
            match result:
                case PoseGraph():
                    self.pose_graph = result
                case _Read():
                    self.clouds = result.clouds
                case SkippedScan():
                    self.failed.append(result)
                case Registration():
                    if (why := doubt(result)) is not None:
                        self._doubts.append((len(self._stamps), why))
                    self._stamps.append(result.stamp_ns)
                    self._numbers.append(int(self._number_of[result.index]))
                    self._T_odom_sensor.append(result.T_odom_sensor)
                    yield result

    def __len__(self) -> int:
        """How many scans have been registered so far."""
        return len(self._stamps)

    @property
    def trajectory(self) -> Trajectory:
        """T_odom_base of the scans so far; of all of them with the loops closed."""
        if self.pose_graph is None:
            return self.registered()
        poses = self.pose_graph.corrected(np.array(self._T_odom_sensor).reshape(-1, 4, 4))
        return Trajectory(np.array(self._stamps, np.int64), poses @ self._T_sensor_base, self._gap_ns)

    @property
    def stamp_ns(self) -> Sequence[int]:
        """Of the scans so far."""
        return self._stamps

    def registered(self, first: int = 0, last: int | None = None) -> Trajectory:
        """T_odom_base of the scans so far as they were registered, or of those from `first` up to `last`."""
        poses = np.array(self._T_odom_sensor[first:last]).reshape(-1, 4, 4)
        return Trajectory(np.array(self._stamps[first:last], np.int64), poses @ self._T_sensor_base, self._gap_ns)

    @property
    def warnings(self) -> list[str]:
        """Which parts of the drive could not be joined to what was seen before, or may be at a wrong place."""
        return unjoined_parts(self._stamps, self._numbers, self._doubts, self._clouds_ns, self._gap_ns)

    def _look_up(self, key: str, inputs: Inputs, sensors: Sequence[Sensor]) -> Iterator[_Result] | None:
        # The clouds are read for their digest only where there may be something to find with it.
        if not odometry_cache.has_any(key):
            return None
        clouds = digest_clouds(inputs.bag_path, sensors)
        found = odometry_cache.look_up(key, total_digest(clouds))
        if found.damage is not None:
            self.cache_warning = (
                f"the odometry in the cache {odometry_cache.cache_folder()} was damaged ({found.damage}); it was thrown away "
                "and is computed anew"
            )
        return None if found.files is None else _from_files(found.files, clouds)

    def _register_and_keep(self, key: str, inputs: Inputs, sensor: Sensor, settings: Settings) -> Iterator[_Result]:
        waiting: list[Registration] = []
        with odometry_cache.Writer(key) as writer:
            for result in _register(inputs, sensor, settings):
                if waiting and (not isinstance(result, Registration) or len(waiting) == _PER_FILE):
                    writer.add(pack_rows(waiting, _RAGGED))
                    waiting = []
                match result:
                    case Registration():
                        waiting.append(result)
                    case PoseGraph():
                        writer.add(pack(result))
                    case _Read():
                        writer.complete(total_digest(result.clouds))
                yield result
        if writer.failure is not None:
            self.cache_warning = (
                f"the odometry cannot be kept in the cache {odometry_cache.cache_folder()} ({writer.failure}); the next run "
                f"computes it again, unless {odometry_cache.CACHE_VARIABLE} names a folder that can be written"
            )


def unjoined_parts(
    stamps_ns: Sequence[int],
    numbers: Sequence[int],
    doubts: Sequence[tuple[int, str]],
    clouds_ns: IntArray,
    gap_ns: float,
) -> list[str]:
    """Warn of the parts of a drive that have no pose, or one that may be wrong, each with its time from the first cloud.

    stamps_ns, numbers: of the scans with a pose; numbers count in the usable clouds, whose stamps are clouds_ns. doubts: place
    among these scans of the first one after a gap, and why it may be wrong. gap_ns: what a longer step between poses is.
    """
    ends = [*zip(stamps_ns, numbers, strict=True), (int(clouds_ns[-1]), len(clouds_ns))]

    def part(at_ns: int, end_ns: int, count: int) -> str:
        return f"the {(end_ns - at_ns) / 1e9:.1f} s after {(at_ns - clouds_ns[0]) / 1e9:.1f} s ({count} scans)"

    found = []
    for (at_ns, number), (next_ns, next_number) in pairwise(ends):
        count = next_number - number - 1
        if count > 1 and next_ns - at_ns > gap_ns:
            lost = f"{part(at_ns, next_ns, count)} could not be joined to the map"
            found.append(f"{lost} and are left out; to map them, cut them out as a bag of their own")
    for (place, why), (until, _) in pairwise([*doubts, (len(stamps_ns), "")]):
        doubtful = part(stamps_ns[place - 1], ends[until - 1][0], until - place)
        found.append(f"{doubtful} could not be joined to the map for certain, and may lie at a wrong place: {why}")
    return found


def _from_files(files: Sequence[Arrays], clouds: dict[str, str]) -> Iterator[_Result]:
    for columns in files:
        if "index" in columns:
            yield from unpack_rows(Registration, columns, _RAGGED)
        else:
            yield unpack(PoseGraph, columns)
    yield _Read(clouds)


def _register(inputs: Inputs, sensor: Sensor, settings: Settings) -> Iterator[_Result]:
    """Raises WorkerLostError where the process is killed, and what went wrong in it."""
    context = process_context()
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(
        target=_odometry_process, args=(inputs, sensor, settings, sending), name="odometry", daemon=True
    )
    process.start()
    # The process alone holds the other end, so that its death ends what is read here, were it in the middle of a message.
    sending.close()
    try:
        while True:
            try:
                result = receiving.recv()
            except (EOFError, OSError):
                process.join()
                raise WorkerLostError.of("the odometry's process", process.exitcode) from None
            if isinstance(result, InputError | MemoryError):
                raise result
            if isinstance(result, str):
                raise RuntimeError(f"the odometry failed:\n{result}")
            yield result
            if isinstance(result, _Read):
                return
    finally:
        process.kill()
        process.join()
        receiving.close()


def _odometry_process(inputs: Inputs, sensor: Sensor, settings: Settings, connection: Connection) -> None:
    start_as_worker()
    outbox: queue.Queue[_Result | Exception | str | None] = queue.Queue(_WAITING)
    sender = threading.Thread(target=_send, args=(outbox, connection))
    sender.start()
    try:
        for result in _registered(inputs, sensor, settings):
            outbox.put(result)
    except (InputError, MemoryError) as error:
        outbox.put(error)
    except Exception:
        outbox.put(traceback.format_exc())
    outbox.put(None)
    sender.join()


def _send(outbox: "queue.Queue[_Result | Exception | str | None]", connection: Connection) -> None:
    # Where the run has ended, this process is about to end too.
    with suppress(BrokenPipeError):
        while (result := outbox.get()) is not None:
            connection.send(result)


def _registered(inputs: Inputs, sensor: Sensor, settings: Settings) -> Iterator[_Result]:
    # Imported here: only this process needs KISS-ICP.
    from ffmap.algorithms.poses.odometry import register_scans
    from ffmap.algorithms.poses.pose_graph import close_loops

    companion = _companion(inputs, settings)
    T_sensor_companion = None
    if companion is not None:
        T_sensor_companion = transforms.invert(sensor.lidar.T_base_sensor) @ companion.lidar.T_base_sensor
    digests: dict[str, list[bytes]] = {}
    scans = _with_companions(inputs.bag_path, sensor, companion, settings.scan.range_max_m, digests)
    poses: list[FloatArray] = []
    clouds: list[FloatArray] = []
    failed: list[SkippedScan] = []

    def fail(index: int, scan: Scan, error: Exception) -> None:
        failed.append(SkippedScan.failed(index, scan.stamp_ns, error))

    T_base_sensor = sensor.lidar.T_base_sensor
    for registration in register_scans(
        scans, settings.odometry, settings.refinement, T_sensor_companion, T_base_sensor, fail
    ):
        yield from failed
        failed.clear()
        yield registration
        poses.append(registration.T_odom_sensor)
        clouds.append(registration.keypoints_sensor)
    yield from failed
    if settings.pose_graph.enabled:
        yield close_loops(np.array(poses).reshape(-1, 4, 4), clouds, settings.pose_graph)
    with open_bag(inputs.bag_path) as bag:
        for read in _sensors(inputs, sensor, settings):
            # Of the companion, what ended after the last scan was not asked for.
            known = digests[read.lidar.topic]
            read_so_far = int(np.searchsorted(np.cumsum(read.index.message_count), len(known), side="right"))
            known.extend(read_digests(bag, read.index, read_so_far))
    yield _Read({topic: joined(known).hex() for topic, known in digests.items()})


def _companion(inputs: Inputs, settings: Settings) -> Sensor | None:
    """The other lidar whose scans are registered with the horizontal one's, the first of several; None where it does both jobs."""
    if inputs.horizontal is None:
        return None
    wanted = settings.refinement.enabled and settings.refinement.companion_points_max > 0
    return next(iter(inputs.others), None) if wanted else None


def _sensors(inputs: Inputs, sensor: Sensor, settings: Settings) -> list[Sensor]:
    """The lidars whose clouds decide the poses."""
    companion = _companion(inputs, settings)
    return [sensor] if companion is None else [sensor, companion]


def _with_companions(
    bag_path: BagPath, sensor: Sensor, companion: Sensor | None, range_max_m: float, digests: dict[str, list[bytes]]
) -> Iterator[tuple[int, Scan, Scan | None]]:
    """The usable scans in order; beside each the companion's last one that ended before it, once.

    digests: takes those of all clouds that are read, by topic.
    """
    others = _usable_scans(bag_path, companion, range_max_m, digests) if companion is not None else iter(())
    following = next(others, None)
    for index, scan in _usable_scans(bag_path, sensor, range_max_m, digests):
        latest: Scan | None = None
        while following is not None and following[1].end_ns <= scan.end_ns:
            latest = following[1]
            following = next(others, None)
        if latest is not None and scan.end_ns - latest.end_ns > _COMPANION_NS:
            latest = None
        yield index, scan, latest


_COMPANION_NS = 200_000_000
"""A companion's scan that ended longer ago says too little of where the sensor is now."""


def _usable_scans(
    bag_path: BagPath, sensor: Sensor, range_max_m: float, digests: dict[str, list[bytes]]
) -> Iterator[tuple[int, Scan]]:
    """The usable scans in order, without the returns that are too far away: a registration may fail on them."""
    own = digests.setdefault(sensor.lidar.topic, [])
    with open_bag(bag_path) as bag:
        for index, scan in read_scans(bag, sensor.index, 0, None, sensor.lidar.decoding, own):
            if isinstance(scan, Scan) and len(near := within_range(scan, range_max_m)):
                yield index, near
