"""The labels of a run cloud by cloud, from labels.parquet; memory does not grow with the drive.

A return is known by its cloud's stamp and its place there: two runs on one bag are compared point
by point. Where the returns lie in the map is computed from the run's bag, trajectory and settings.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]

from ffmap.algorithms.base.scan import FloatArray, Scan, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.scan.smoothing import SmoothingSettings, smooth_ranges
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import stream_labels
from ffmap.app.folder.names import LABELS
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Lidar
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import SkippedScan, read_scans
from ffmap.loaders.trajectory_file import read_tum


@dataclass(frozen=True, eq=False)
class CloudLabels:
    """The labels of one cloud, a row for every place in it: 255 where nothing returned.

    scan: its number among the clouds that were labelled. topic: its lidar's; None where the run
    does not tell. label: (m,) final. label_scan: (m,) by the scan alone. points_map: (m, 3) float32
    metres; NaN where nothing returned or no pose is known. None unless asked for.
    """

    scan: int
    topic: str | None
    stamp_ns: int
    label: UInt8Array
    label_scan: UInt8Array
    points_map: FloatArray | None


def labels_file(run: FinishedRun) -> Path | None:
    """The file that holds a run's labels; None where the run did not get so far, or was not to write it."""
    return run.file(LABELS) if run.trajectory is not None else None


def has_points(run: FinishedRun) -> bool:
    """Whether the bag is there that tells where in the map the returns lie."""
    return run.bag_path is not None and run.bag_path.missing is None


def read_run_labels(run: FinishedRun, with_points: bool = False) -> Iterator[CloudLabels]:
    """The labels of every usable cloud, in the order of their stamps; none where the run has no file of them.

    with_points: with the returns' places in the map.
    Raises InputError where the file is damaged, or is not of the bag at the run's path.
    """
    path = labels_file(run)
    if path is None or run.trajectory is None:
        return
    trajectory = read_tum(run.trajectory)
    points = _bag_points(run, trajectory) if with_points else iter(())
    following = next(points, None)
    only = next(iter(run.topics), None)
    try:
        for row, ((scan, label, label_scan), cloud) in enumerate(stream_labels(path)):
            while following is not None and following[0] < scan:
                following = next(points, None)
            own = following[1] if following is not None and following[0] == scan else None
            if own is not None and len(own) != len(label):
                raise InputError(
                    f"{run.bag_path}: is not the bag that {run.path} was made from; put that one there, or move this one away"
                )
            topic, stamp_ns = cloud or (only, int(trajectory.stamp_ns[row]))
            yield CloudLabels(scan, topic, stamp_ns, label, label_scan, own)
    except (OSError, KeyError, IndexError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: cannot be read, or is not of this run ({error}); run ffmap again"
        ) from error


def _bag_points(run: FinishedRun, trajectory: Trajectory) -> Iterator[tuple[int, FloatArray]]:
    """Number and placed returns of each cloud of the run's bag."""
    assert run.bag_path is not None
    inputs = run.find_inputs(run.bag_path)
    smoothing = run.settings().smoothing
    lidars = [sensor.lidar for sensor in inputs.verticals]
    with ExitStack() as stack:
        bags = [stack.enter_context(open_bag(run.bag_path)) for _ in lidars]
        indices = [lidar.index(bag) for lidar, bag in zip(lidars, bags, strict=True)]

        def read(
            place: int, first: int, count: int
        ) -> Iterator[tuple[int, Scan | SkippedScan]]:
            return read_scans(bags[place], indices[place], first, count, lidars[place].decoding)

        for number, place, scan in ScanOrder.of(indices).read(0, None, read):
            if isinstance(scan, Scan):
                yield number, _placed(scan, trajectory, lidars[place], smoothing)


def _placed(
    scan: Scan, trajectory: Trajectory, lidar: Lidar, smoothing: SmoothingSettings
) -> FloatArray:
    """(cloud_size, 3) float32: the smoothed returns in the map, as far as poses reach."""
    points = np.full((scan.cloud_size, 3), np.nan, np.float32)
    if trajectory.covers(np.array([scan.stamp_ns])).all():
        scan = lidar.seen(scan, trajectory)
        smoothed = smooth_ranges(scan, smoothing).of(scan)
        placed = place_scan(smoothed, trajectory, lidar.T_base_sensor)
        points[scan.cloud_index] = placed.to_map(placed.points_level)
    return points


def pair(
    first: Iterator[CloudLabels], second: Iterator[CloudLabels]
) -> Iterator[tuple[CloudLabels | None, CloudLabels | None]]:
    """The clouds of two runs by their stamps, which increase; None where a run has no such cloud.

    Of equal stamps the topics' names decide, as in `ScanOrder`.
    """
    return side_by_side(first, second, lambda cloud: (cloud.stamp_ns, cloud.topic or ""))


T = TypeVar("T")
Key = TypeVar("Key", int, tuple[int, str])


def side_by_side(
    first: Iterator[T], second: Iterator[T], key: Callable[[T], Key], to_the_end: bool = True
) -> Iterator[tuple[T | None, T | None]]:
    """What has the same key, which increases, together; None beside what the other lacks.

    to_the_end: of both; else until either of them ends.
    """
    a, b = next(first, None), next(second, None)
    while (a is not None or b is not None) if to_the_end else (a is not None and b is not None):
        takes_a = a is not None and (b is None or key(a) <= key(b))
        takes_b = b is not None and (a is None or key(b) <= key(a))
        yield (a if takes_a else None), (b if takes_b else None)
        a, b = (next(first, None) if takes_a else a), (next(second, None) if takes_b else b)
