"""What a run reads: the bag, its lidars and the decoding of their clouds."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ffmap.algorithms.base.scan import Scan
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag import Bag, Container, open_bag
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

_REASONS_READ, _REASONS_NAMED = 50, 3
_NO_POSE = (
    "its returns are too few, or all in a line, to be registered, its times overlap those of a "
    "cloud before it, or it could not be joined to the map after a gap"
)


@dataclass(frozen=True)
class Sensor:
    """A lidar of the bag and the index of its clouds."""

    lidar: Lidar
    index: CloudIndex


@dataclass(frozen=True)
class Inputs:
    """Everything that worker processes need to read scans for themselves."""

    bag_path: BagPath
    container: Container
    rig: Rig
    horizontal: Sensor | None
    verticals: tuple[Sensor, ...]
    warnings: tuple[str, ...]

    @property
    def vertical(self) -> Sensor | None:
        """The first vertical lidar, mostly the only one."""
        return next(iter(self.verticals), None)

    @cached_property
    def scans(self) -> ScanOrder:
        """The clouds of all vertical lidars as one sequence; requires one."""
        return ScanOrder.of([sensor.index for sensor in self.verticals])

    @property
    def others(self) -> tuple[Sensor, ...]:
        """The vertical lidars that do not give the poses, whose extrinsics matter."""
        horizontal = self.horizontal.lidar.topic if self.horizontal else None
        return tuple(sensor for sensor in self.verticals if sensor.lidar.topic != horizontal)

    @property
    def by_role(self) -> dict[str, Sensor]:
        """The lidars by role: horizontal, vertical, vertical_2 and so on."""
        roles = {} if self.horizontal is None else {"horizontal": self.horizontal}
        return roles | {numbered("vertical", i): sensor for i, sensor in enumerate(self.verticals)}

    def with_mounts(self, mounts: Iterable[MountCorrection]) -> "Inputs":
        """Replace the extrinsics of vertical lidars."""
        rig = self.rig
        for mount in mounts:
            rig = rig.with_mount(mount)
        sensors = zip(self.verticals, rig.verticals, strict=True)
        verticals = tuple(replace(sensor, lidar=lidar) for sensor, lidar in sensors)
        return replace(self, rig=rig, verticals=verticals)

    @property
    def sensors(self) -> list[Sensor]:
        """All lidars, each once."""
        return [*{sensor.lidar.topic: sensor for sensor in self.by_role.values()}.values()]


def find_lidars(
    bag: Bag,
    options: RunOptions,
    mounts: Iterable[MountCorrection] = (),
    own_body: bool = True,
    unplaced: bool = False,
) -> Rig:
    """Find the lidars of an open bag.

    Args:
        mounts: extrinsics that an earlier run of this bag estimated.
        own_body: whether the robot's own body is removed; see `ScanSettings`.
        unplaced: whether named lidars may lack extrinsics; see `find_rig`.

    Raises InputError where there are none.
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
    """Open a bag and find its lidars; see `find_lidars`."""
    with open_bag(bag_path) as bag:
        rig = find_lidars(bag, options, mounts, own_body, unplaced)
        horizontal = _sensor(bag, rig.horizontal) if rig.horizontal else None
        verticals = tuple(_sensor(bag, lidar) for lidar in rig.verticals)
        clocks = [clock_problem(horizontal.index, v.index) for v in verticals if horizontal]
        lidars = {sensor.lidar.topic: sensor for sensor in (horizontal, *verticals) if sensor}
        ends_ns = max(int(s.index.stamp_ns[s.index.usable][-1]) for s in lidars.values())
        gaps = [gap_problem(sensor.index, ends_ns) for sensor in lidars.values()]
        return Inputs(
            bag_path=bag.path.resolve(),
            container=bag.container,
            rig=rig,
            horizontal=horizontal,
            verticals=verticals,
            warnings=(*bag.warnings, *rig.warnings, *filter(None, (*clocks, *gaps))),
        )


def _sensor(bag: Bag, lidar: Lidar) -> Sensor:
    """Index a lidar's clouds. Raises InputError where none gives a scan."""
    sensor = Sensor(lidar, lidar.index(bag))
    if problem := stamp_problem(sensor.index):
        raise InputError(f"{bag.path}: {problem}")
    reasons: list[str] = []
    for _, scan in read_scans(bag, sensor.index, 0, None, lidar.decoding):
        if isinstance(scan, Scan):
            return sensor
        reasons.append(scan.reason)
    raise InputError(
        f"{bag.path}: {lidar.topic} has no usable cloud ({commonest(reasons)}); name another "
        f"topic, 'ffmap info {bag.path.words}' lists them"
    )


def why_skipped(bag_path: BagPath, sensor: Sensor, clouds: Sequence[int]) -> str:
    """Find the commonest reason for which some clouds of a lidar give no scan."""
    reasons: list[str] = []
    with open_bag(bag_path) as bag:
        for number in clouds[:: -(-len(clouds) // _REASONS_READ)]:
            for _, scan in read_scans(bag, sensor.index, number, 1, sensor.lidar.decoding):
                reasons.append(scan.reason if isinstance(scan, SkippedScan) else _NO_POSE)
    return commonest(reasons)


def counted(reasons: Sequence[str]) -> str:
    """Name reasons with their numbers, the commonest first."""
    (first, *others) = Counter(sorted(reasons)).most_common()
    if not others:
        return first[0]
    named = [f"{reason} ({count})" for reason, count in (first, *others[: _REASONS_NAMED - 1])]
    rest = sum(count for _, count in others[_REASONS_NAMED - 1 :])
    return ", ".join([*named, f"other reasons ({rest})"] if rest else named)


def commonest(reasons: Sequence[str]) -> str:
    """Find the commonest reason; of several the first by the alphabet."""
    return max(sorted(set(reasons)), key=list(reasons).count, default="no reason is known")
