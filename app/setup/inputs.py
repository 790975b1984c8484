"""What a run reads: the bag, which lidar is which, and how their clouds become scans."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ffmap.algorithms.base.scan import Scan
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_checks import clock_problem, gap_problem, stamp_problem
from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.errors import InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.numbered import numbered
from ffmap.loaders.own_body import without_own_body
from ffmap.loaders.rig import Lidar, MountCorrection, Rig
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import SkippedScan, read_scans

_FAILED_SHARE_MAX = 0.2
"""Share of the scans that may fail: a few damaged clouds do not matter, and of more the bag or what is said of it is wrong."""
_REASONS_READ = 50
_NO_POSE = (
    "its returns are too few, or all in a line, to be registered, its times overlap those of a cloud before it, or it could not "
    "be joined to the map after a gap"
)


@dataclass(frozen=True)
class Sensor:
    """One lidar of the bag and where its clouds lie."""

    lidar: Lidar
    index: CloudIndex


@dataclass(frozen=True)
class Inputs:
    """Everything that worker processes need to read scans for themselves."""

    bag_path: BagPath
    container: str
    rig: Rig
    horizontal: Sensor | None
    verticals: tuple[Sensor, ...]
    warnings: tuple[str, ...]

    @property
    def vertical(self) -> Sensor | None:
        """The first of those that are labelled, and mostly the only one."""
        return next(iter(self.verticals), None)

    @cached_property
    def scans(self) -> ScanOrder:
        """The clouds of all that are labelled, as one sequence. There has to be such a lidar."""
        return ScanOrder.of([sensor.index for sensor in self.verticals])

    @property
    def others(self) -> tuple[Sensor, ...]:
        """Those that are labelled and do not give the poses: whose mounts matter."""
        horizontal = self.horizontal
        return tuple(s for s in self.verticals if horizontal is None or s.lidar.topic != horizontal.lidar.topic)

    @property
    def by_role(self) -> dict[str, Sensor]:
        """The lidars that were found, by what they are for: horizontal, vertical, vertical_2 and so on."""
        roles = {} if self.horizontal is None else {"horizontal": self.horizontal}
        return roles | {numbered("vertical", place): sensor for place, sensor in enumerate(self.verticals)}

    @property
    def line_pairs(self) -> int | None:
        """Pairs of point lines of the lidar that is labelled, the most of several; None where nothing is."""
        return max((sensor.lidar.line_pairs for sensor in self.verticals), default=None)

    def with_mounts(self, mounts: Iterable[MountCorrection]) -> "Inputs":
        """The same with vertical lidars where they were found to sit."""
        rig = self.rig
        for mount in mounts:
            rig = rig.with_mount(mount)
        sensors = zip(self.verticals, rig.verticals, strict=True)
        return replace(self, rig=rig, verticals=tuple(replace(sensor, lidar=lidar) for sensor, lidar in sensors))

    def used(self, given_poses: bool) -> list[Sensor]:
        """The lidars whose clouds a run reads. given_poses: whether it takes its poses from elsewhere."""
        wanted = (None if given_poses else self.horizontal, *self.verticals)
        return [*{sensor.lidar.topic: sensor for sensor in wanted if sensor is not None}.values()]


def find_lidars(
    bag: Bag,
    options: RunOptions,
    mounts: Iterable[MountCorrection] = (),
    own_body: bool = True,
    unplaced: bool = False,
) -> Rig:
    """Find the lidars of an open bag.

    Args:
        mounts: where an earlier run of this bag found vertical lidars.
        own_body: whether the robot's own body is left out; see `ScanSettings`.
        unplaced: whether lidars may be named whose extrinsics are unknown; they are put at the
            base's origin.

    Raises InputError where they cannot be told.
    """
    topics = options.horizontal, options.vertical
    rig = find_rig(bag, options.rig, *topics, options.time_from, unplaced)
    for mount in mounts:
        rig = rig.with_mount(mount)
    return without_own_body(bag, rig) if own_body else rig


def find_inputs(
    bag_path: BagPath | Path,
    options: RunOptions,
    mounts: Iterable[MountCorrection] = (),
    own_body: bool = True,
    unplaced: bool = False,
) -> Inputs:
    """Open a bag, find its lidars as `find_lidars` does, and settle how their clouds are read.

    Raises InputError that names the file, topic or frame and says what to do.
    """
    with open_bag(bag_path) as bag:
        rig = find_lidars(bag, options, mounts, own_body, unplaced)
        horizontal = _sensor(bag, rig.horizontal) if rig.horizontal else None
        verticals = tuple(_sensor(bag, lidar) for lidar in rig.verticals)
        clocks = [clock_problem(horizontal.index, vertical.index) for vertical in verticals if horizontal]
        lidars = {sensor.lidar.topic: sensor for sensor in (horizontal, *verticals) if sensor is not None}
        missing = [gap_problem(sensor.index) for sensor in lidars.values()]
        return Inputs(
            bag_path=bag.path.resolve(),
            container=bag.container,
            rig=rig,
            horizontal=horizontal,
            verticals=verticals,
            warnings=(*bag.warnings, *rig.warnings, *(problem for problem in (*clocks, *missing) if problem)),
        )


def _sensor(bag: Bag, lidar: Lidar) -> Sensor:
    """Raises InputError where no cloud of the lidar gives a scan, before anything of an earlier run is touched."""
    sensor = Sensor(lidar, lidar.index(bag))
    if problem := stamp_problem(sensor.index):
        raise InputError(f"{bag.path}: {problem}")
    reasons: list[str] = []
    for _, scan in read_scans(bag, sensor.index, 0, None, lidar.decoding):
        if isinstance(scan, Scan):
            return sensor
        reasons.append(scan.reason)
    why = f"{lidar.topic} has no usable cloud ({commonest(reasons)})"
    raise InputError(f"{bag.path}: {why}; name another topic, 'ffmap info {bag.path.words}' lists them")


def why_skipped(bag_path: BagPath, sensor: Sensor, clouds: Sequence[int]) -> str:
    """The commonest reason for which clouds of a lidar, by their numbers, give no scan; of many some tell."""
    reasons: list[str] = []
    with open_bag(bag_path) as bag:
        for number in clouds[:: -(-len(clouds) // _REASONS_READ)]:
            for _, scan in read_scans(bag, sensor.index, number, 1, sensor.lidar.decoding):
                reasons.append(scan.reason if isinstance(scan, SkippedScan) else _NO_POSE)
    return commonest(reasons)


def check_failed(bag_path: BagPath, failed: Sequence[SkippedScan], scans: int, what: str) -> None:
    """Raise InputError where so many of the scans failed that the cause is in all of them. what: failed with them."""
    if len(failed) > _FAILED_SHARE_MAX * scans:
        why = commonest([scan.reason for scan in failed])
        count = sum(scan.reason == why for scan in failed)
        raise InputError(
            f"{bag_path}: {what} failed for {len(failed)} of {scans} scans so far, {count} times with {why}; check lidars, "
            f"transforms and poses ('ffmap info {bag_path.words}'); run.json holds the traceback"
        )


def commonest(reasons: Sequence[str]) -> str:
    """The commonest of the reasons why clouds were skipped, the first by the alphabet of several."""
    return max(sorted(set(reasons)), key=list(reasons).count, default="there is none")
