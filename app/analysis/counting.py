"""Count the labels of a run against the ground truth, in processes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.truth.doors import TrueDoors
from ffmap.algorithms.truth.tally import Tally
from ffmap.app.analysis.run_labels import read_clouds
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.run.workers import make_pool
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Lidar
from ffmap.loaders.scans import SkippedScan
from ffmap.loaders.truth import TruthClasses

CLOUDS_PER_JOB = 200
"""With fewer, a process costs more time than it saves; with more, its voxels fill the memory."""
_MARGIN_NS = 200_000_000
"""The first and the last scan may begin this long before and after the true poses."""


@dataclass(frozen=True, eq=False)
class Counting:
    """A run to count, and the ground truth.

    bag, lidars, labels: the run's bag, the lidars it labelled, and its labels.parquet.
    truth_bag: has the true classes of the clouds of each lidar on `topics`, None without any.
    trajectory: the true one. doors: the true ones.
    spool, recording_id: folder and id of the recording of each scan's errors, None for none.
    """

    bag: BagPath
    lidars: tuple[Lidar, ...]
    labels: Path
    truth_bag: BagPath
    topics: tuple[str | None, ...]
    trajectory: Trajectory
    doors: TrueDoors
    spool: Path | None = None
    recording_id: str = ""


def count_run(counting: Counting, workers: int) -> Tally:
    """Count all clouds; the parts of the recording are `scans-*.rrd` in the spool."""
    with open_bag(counting.bag) as bag:
        clouds = sum(len(lidar.index(bag)) for lidar in counting.lidars)
    firsts = range(0, clouds, CLOUDS_PER_JOB)
    total = Tally(counting.doors)
    with make_pool(max(1, min(workers, len(firsts)))) as pool:
        for tally in pool.map(partial(_count_job, counting, CLOUDS_PER_JOB), firsts):
            total.absorb(tally)
    return total


def _count_job(counting: Counting, count: int, first: int) -> Tally:
    if counting.spool is None:
        return _count_clouds(counting, first, count, lambda *_: None)
    # Rerun is not needed without a recording.
    from ffmap.app.record.errors import log_scan_errors
    from ffmap.app.record.log import open_log

    part = counting.spool / f"scans-{first:06d}.rrd"
    with open_log(part, counting.recording_id) as log:
        return _count_clouds(counting, first, count, partial(log_scan_errors, log))


def _count_clouds(
    counting: Counting,
    first: int,
    count: int,
    log: Callable[[int, int, UInt8Array, UInt8Array], None],
) -> Tally:
    """Count the clouds [first, first + count).

    log: called with number, time stamp, true classes and labels of each scan.
    """
    tally = Tally(counting.doors)
    stored = read_labels(counting.labels, first, count)
    with open_bag(counting.truth_bag) as truth_bag:
        true_classes = [topic and TruthClasses(truth_bag, topic) for topic in counting.topics]
        clouds = read_clouds(counting.bag, counting.lidars, first, count)
        for number, place, scan in clouds:
            if isinstance(scan, SkippedScan):
                tally.skipped += 1
                continue
            own = true_classes[place]
            classes = own.at(scan.stamp_ns, scan.cloud_size) if own else None
            covered = counting.trajectory.covers(np.array([scan.start_ns]), _MARGIN_NS)[0]
            if classes is None or not covered:
                tally.without_truth += 1
                continue
            if len(classes) != scan.cloud_size:
                raise InputError(
                    f"{counting.truth_bag}: {len(classes)} true classes for a cloud of "
                    f"{scan.cloud_size} points; give the bag that the run was made from as --truth"
                )
            unlabelled = np.full(scan.cloud_size, NO_RETURN, np.uint8)
            row = stored.get(number)
            full = (row.label, row.label_scan) if row is not None else (unlabelled, unlabelled)
            label, label_scan = (values[scan.cloud_index] for values in full)
            truth = classes[scan.cloud_index]
            # As measured and at the true poses, so that areas do not depend on the run.
            T_base_sensor = counting.lidars[place].T_base_sensor
            placed = place_scan(scan, counting.trajectory, T_base_sensor)
            points_map = placed.to_map(placed.points_level)
            origin_map = placed.to_map(placed.origin_level[None])[0]
            tally.add(points_map, origin_map, truth, label, label_scan)
            log(number, scan.stamp_ns, truth, label)
    return tally
