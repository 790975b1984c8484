"""The labels of a run counted against the truth, cloud by cloud, in processes side by side."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import Scan, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.truth.doors import TrueDoors
from ffmap.algorithms.truth.tally import Counter, Tally
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.run.workers import make_pool
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_index import CloudIndex
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Lidar
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import SkippedScan, read_scans
from ffmap.loaders.truth import TruthClasses

CLOUDS_A_SHARE = 100
"""For fewer clouds than this a process more costs more than it saves; with many more, its cubes fill the memory."""
_MARGIN_NS = 200_000_000
"""The first and the last sweep may stand a little outside the true poses."""


@dataclass(frozen=True)
class LabelledClouds:
    """Where a run's vertical clouds and their labels are read.

    bag: the one that the run was made from. lidars: those that were labelled. labels: labels.parquet.
    """

    bag: BagPath
    lidars: tuple[Lidar, ...]
    labels: Path


@dataclass(frozen=True)
class Layer:
    """A second layer of the recording `recording_id`, whose parts lie in `spool`."""

    spool: Path
    recording_id: str


@dataclass(frozen=True, eq=False)
class Counted:
    """All clouds of a run. without_truth: how many were left out. parts: of the layer, in order."""

    tally: Tally
    without_truth: int
    parts: tuple[Path, ...]


@dataclass(frozen=True, eq=False)
class _Share:
    """What is counted at a time: scans [first, first + count) of the run's.

    classes: of each lidar the topic with the truth of its clouds; None where there is none.
    """

    clouds: LabelledClouds
    truth_bag: BagPath
    classes: tuple[str | None, ...]
    trajectory: Trajectory
    doors: TrueDoors
    first: int
    count: int
    layer: Layer | None

    @property
    def part(self) -> Path:
        assert self.layer is not None
        return self.layer.spool / f"scans-{self.first:06d}.rrd"


@dataclass(frozen=True, eq=False)
class _Bags:
    """What is counted and what it is compared with, all open: the clouds, where they lie, and their truth, lidar by lidar."""

    clouds: Sequence[Bag]
    indices: Sequence[CloudIndex]
    classes: Sequence[TruthClasses | None]
    scans: ScanOrder

    @classmethod
    def open(
        cls, path: BagPath, lidars: Sequence[Lidar], truth_bag: BagPath, topics: Sequence[str | None], stack: ExitStack
    ) -> "_Bags":
        bags = [stack.enter_context(open_bag(path)) for _ in lidars]
        truth = stack.enter_context(open_bag(truth_bag))
        indices = [lidar.index(bag) for lidar, bag in zip(lidars, bags, strict=True)]
        classes = [None if topic is None else TruthClasses(truth, topic) for topic in topics]
        return cls(bags, indices, classes, ScanOrder.of(indices))


def count_run(
    clouds: LabelledClouds,
    truth_bag: BagPath,
    trajectory: Trajectory,
    classes: Sequence[str | None],
    doors: TrueDoors,
    workers: int,
    layer: Layer | None = None,
) -> Counted:
    """Count all clouds of a run.

    trajectory: the true one, as read from `truth_bag`. classes: of each lidar the topic there with the true classes of its clouds;
        None where there is none. layer: where the errors of each scan are recorded; None for
        nowhere.
    """
    total, without_truth = Counter(doors), 0
    with ExitStack() as stack:
        topics = tuple(classes)
        bags = _Bags.open(clouds.bag, clouds.lidars, truth_bag, topics, stack)
        count = len(bags.scans)
        edges = np.linspace(0, count, max(1, count // CLOUDS_A_SHARE) + 1).astype(int).tolist()
        shares = [
            _Share(clouds, truth_bag, topics, trajectory, doors, first, last - first, layer)
            for first, last in pairwise(edges)
        ]
        processes = min(workers, len(shares))
        if processes == 1:
            counted: Iterable[tuple[Tally, int]] = (_count(share, bags) for share in shares)
        else:
            counted = stack.enter_context(make_pool(processes)).map(_count_in_worker, shares)
        for tally, missing in counted:
            total.absorb(tally)
            without_truth += missing
    parts = tuple(share.part for share in shares if layer is not None and share.part.exists())
    return Counted(total.tally(), without_truth, parts)


def _count_in_worker(share: _Share) -> tuple[Tally, int]:
    if share.truth_bag not in _opened:
        clouds = share.clouds
        # They live as long as the process, which is as long as one evaluation.
        _opened[share.truth_bag] = _Bags.open(clouds.bag, clouds.lidars, share.truth_bag, share.classes, ExitStack())
    return _count(share, _opened[share.truth_bag])


_opened: dict[BagPath, _Bags] = {}
"""By a worker process: each opens the bags once."""


def _count(share: _Share, bags: _Bags) -> tuple[Tally, int]:
    if share.layer is None:
        return _count_clouds(share, bags, lambda *_: None)
    # Rerun is not needed where a run has no recording.
    from ffmap.app.record.errors import log_scan_errors
    from ffmap.app.record.log import open_log

    with open_log(share.part, share.layer.recording_id) as log:
        return _count_clouds(share, bags, partial(log_scan_errors, log))


def _count_clouds(
    share: _Share, bags: _Bags, log: Callable[[int, int, UInt8Array, UInt8Array], None]
) -> tuple[Tally, int]:
    """log: called with each counted scan's number, stamp, truth and label."""
    counter = Counter(share.doors)
    without_truth = 0
    lidars = share.clouds.lidars
    stored = read_labels(share.clouds.labels, share.first, share.count)

    def read(place: int, first: int, count: int) -> Iterator[tuple[int, Scan | SkippedScan]]:
        return read_scans(bags.clouds[place], bags.indices[place], first, count, lidars[place].decoding)

    for number, place, scan in bags.scans.read(share.first, share.count, read):
        lidar, truth_classes = lidars[place], bags.classes[place]
        if isinstance(scan, SkippedScan):
            counter.skip()
            continue
        classes = None if truth_classes is None else truth_classes.at(scan.stamp_ns, scan.cloud_size)
        if classes is None or not share.trajectory.covers(np.array([scan.start_ns]), _MARGIN_NS)[0]:
            without_truth += 1
            continue
        if len(classes) != scan.cloud_size:
            raise InputError(
                f"{share.truth_bag}: {len(classes)} true classes for a cloud of {scan.cloud_size} points; "
                "give the bag that the run was made from as --truth"
            )
        # What was not labelled has no row.
        full = stored.get(number) or (np.full(scan.cloud_size, NO_RETURN, np.uint8),) * 2
        label, label_scan = (values[scan.cloud_index] for values in full)
        truth = classes[scan.cloud_index]
        # As measured, at the true poses: where a return is counted does not depend on what was made of it.
        placed = place_scan(scan, share.trajectory, lidar.T_base_sensor)
        counter.add(
            placed.to_map(placed.points_level),
            placed.to_map(placed.origin_level[None])[0],
            truth,
            label,
            label_scan,
        )
        log(number, scan.stamp_ns, truth, label)
    return counter.tally(), without_truth
