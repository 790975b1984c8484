"""Labels of a run cloud by cloud, from labels.parquet, and its clouds, from the bag.

A return is identified by its cloud and its place there, so two runs on one bag are compared point
by point.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]

from ffmap.algorithms.base.scan import FloatArray, Scan
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import ScanLabels, stream_labels
from ffmap.app.folder.names import LABELS
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import Lidar
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import SkippedScan, read_scans
from ffmap.loaders.trajectory_file import read_tum

PlacedLabels = tuple[ScanLabels, FloatArray | None]
"""Labels of a cloud, and the returns (m, 3) float32 in the map, NaN without a return or a pose."""


def read_run_labels(run: FinishedRun, with_points: bool = False) -> Iterator[PlacedLabels]:
    """Yield the labels of every usable cloud by time stamp; none if the run has no labels.

    with_points: whether the returns are placed in the map; requires the run's bag and trajectory.
    Raises InputError if the file is damaged, or belongs to another bag than is at the run's path.
    """
    path = run.file(LABELS)
    if path is None:
        return
    points: Iterator[tuple[int, FloatArray]] = iter(())
    if with_points and run.trajectory is not None:
        points = _placed_clouds(run, read_tum(run.trajectory))
    following = next(points, None)
    try:
        for labels in stream_labels(path):
            while following is not None and following[0] < labels.scan:
                following = next(points, None)
            own = following[1] if following is not None and following[0] == labels.scan else None
            if own is not None and len(own) != len(labels.label):
                raise InputError(
                    f"{run.bag_path}: is not the bag that {run.path} was made from; put that one "
                    "there, or move this one away"
                )
            yield labels, own
    except (OSError, KeyError, IndexError, pa.ArrowException) as error:
        raise InputError(
            f"{path}: cannot be read, or is not of this run ({error}); run ffmap again"
        ) from error


def read_clouds(
    bag: BagPath, lidars: Sequence[Lidar], first: int = 0, count: int | None = None
) -> Iterator[tuple[int, int, Scan | SkippedScan]]:
    """Yield number, lidar and scan of the clouds [first, first + count) of all lidars."""
    with ExitStack() as stack:
        bags = [stack.enter_context(open_bag(bag)) for _ in lidars]
        indices = [lidar.index(own) for lidar, own in zip(lidars, bags, strict=True)]

        def read(place: int, first: int, count: int) -> Iterator[tuple[int, Scan | SkippedScan]]:
            return read_scans(bags[place], indices[place], first, count, lidars[place].decoding)

        yield from ScanOrder.of(indices).read(first, count, read)


def _placed_clouds(run: FinishedRun, trajectory: Trajectory) -> Iterator[tuple[int, FloatArray]]:
    """Yield number and smoothed returns (m, 3) in the map of each cloud, NaN without a pose."""
    assert run.bag_path is not None
    lidars = [sensor.lidar for sensor in run.find_inputs(run.bag_path).verticals]
    smoothing = run.settings().smoothing
    for number, place, scan in read_clouds(run.bag_path, lidars):
        if isinstance(scan, SkippedScan):
            continue
        points = np.full((scan.cloud_size, 3), np.nan, np.float32)
        if trajectory.covers(np.array([scan.stamp_ns])).all():
            seen = lidars[place].seen(scan, trajectory)
            smoothed = smooth_ranges(seen, smoothing).of(seen)
            placed = place_scan(smoothed, trajectory, lidars[place].T_base_sensor)
            points[seen.cloud_index] = placed.to_map(placed.points_level)
        yield number, points


def side_by_side(
    first: Iterator[PlacedLabels], second: Iterator[PlacedLabels]
) -> Iterator[tuple[PlacedLabels | None, PlacedLabels | None]]:
    """Pair the clouds of two runs by stamp and topic; None if one of them lacks the cloud."""

    def key(cloud: PlacedLabels) -> tuple[int, str]:
        return cloud[0].stamp_ns, cloud[0].topic

    a, b = next(first, None), next(second, None)
    while a is not None or b is not None:
        takes_a = a is not None and (b is None or key(a) <= key(b))
        takes_b = b is not None and (a is None or key(b) <= key(a))
        yield (a if takes_a else None), (b if takes_b else None)
        a, b = (next(first, None) if takes_a else a), (next(second, None) if takes_b else b)
