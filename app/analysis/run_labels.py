"""The labels of a run cloud by cloud, from whichever of its files has them; memory does not grow with the drive.

These are the labelled bag; `labels.parquet`, which holds the labels alone, one row for each cloud that has a pose in
`trajectory.tum`; or the recording.

A return is known by its cloud's stamp and its place there: two runs on one bag are compared point by point.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import FloatArray, Scan, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.scan.smoothing import SmoothingSettings, smooth_ranges
from ffmap.app.folder.finished_run import FinishedRun
from ffmap.app.folder.labels_file import stream_labels
from ffmap.app.folder.names import LABELS
from ffmap.app.record.read_back import ReadableRecording, Row, rows
from ffmap.app.setup.inputs import find_inputs
from ffmap.blueprints import entities
from ffmap.loaders.bag import Bag, Message, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import describe_layout, field_column
from ffmap.loaders.rig import Lidar, find_rig
from ffmap.loaders.scan_order import ScanOrder
from ffmap.loaders.scans import SkippedScan, cloud_topics, read_clouds
from ffmap.loaders.trajectory_file import read_tum


@dataclass(frozen=True, eq=False)
class CloudLabels:
    """The labels of one cloud.

    scan: its number among the clouds that were labelled. topic: its lidar's; None where the file does not tell.
    label_scan: (m,) by the scan alone. label: (m,) final; None where the run did not get so far.
    points_map: (m, 3) float32 metres; NaN where nothing returned or no pose is known. None unless asked for.
    every_place: whether there is a row for every place in the cloud, 255 where nothing returned, as in a labelled bag;
        else one for each return, in the cloud's order, as in a recording.
    """

    scan: int
    topic: str | None
    stamp_ns: int
    label_scan: UInt8Array
    label: UInt8Array | None
    points_map: FloatArray | None
    every_place: bool

    def of_returns(self) -> "CloudLabels":
        """With rows for the labelled returns alone."""
        if not self.every_place:
            return self
        own = self.label_scan != NO_RETURN
        label, points = (None if values is None else values[own] for values in (self.label, self.points_map))
        return replace(self, label_scan=self.label_scan[own], label=label, points_map=points, every_place=False)


@dataclass(frozen=True)
class LabelSource:
    """Where a run's labels are read from; None where nothing of the run holds any."""

    run: FinishedRun
    recording: ReadableRecording | None

    @property
    def file(self) -> str | None:
        """The file's name within the run folder."""
        if self.run.labelled is not None:
            return self.run.labelled.name
        if self._alone is not None:
            return LABELS
        return self.run.recording.name if self.recording is not None and self.run.recording is not None else None

    @property
    def has_points(self) -> bool:
        """Whether it tells where in the map the returns lie."""
        if self.run.labelled is None and self._alone is not None:
            return self.run.bag_path is not None and self.run.bag_path.missing is None
        return True

    @property
    def _alone(self) -> Path | None:
        return self.run.file(LABELS) if self.run.trajectory is not None else None

    def read(self, with_points: bool = False, first: int = 0) -> Iterator[CloudLabels]:
        """The labels of every usable cloud, in the order of their stamps.

        with_points: with the returns' places in the map. first: a scan before which none is wanted.
        Raises InputError where the file is damaged.
        """
        if self.run.labelled is not None:
            return _read_bag(self.run.labelled, self.run, with_points, first)
        if self._alone is not None:
            return _read_alone(self._alone, self.run, with_points and self.has_points)
        if self.recording is not None:
            # Of a run that did not end it is not known which scans the final stage had reached.
            final = self.run.complete and self.recording.whole
            return _read_recording(self.recording.path, self.run, final, with_points)
        return iter(())


def _read_bag(path: Path, run: FinishedRun, with_points: bool, first: int) -> Iterator[CloudLabels]:
    trajectory = read_tum(run.trajectory) if with_points and run.trajectory is not None else None
    smoothing = run.settings().smoothing if with_points else None
    with ExitStack() as stack:
        bag = stack.enter_context(open_bag(path))
        lidars = labelled_lidars(bag, run)
        for number, lidar, scan, message in _clouds(path, lidars, first, stack):
            if not isinstance(scan, Scan):
                continue
            layout = describe_layout(message, lidar.topic)
            label, label_scan = (
                field_column(message, layout, name).astype(np.uint8) for name in ("label", "label_scan")
            )
            points = _placed(scan, trajectory, lidar, smoothing) if smoothing is not None else None
            yield CloudLabels(number, lidar.topic, scan.stamp_ns, label_scan, label, points, every_place=True)


def _clouds(
    path: BagPath | Path, lidars: Sequence[Lidar], first: int, stack: ExitStack
) -> Iterator[tuple[int, Lidar, Scan | SkippedScan, Message | None]]:
    """Number, lidar, scan and message of the clouds of several lidars from one on; `stack` closes what is opened."""
    bags = [stack.enter_context(open_bag(path)) for _ in lidars]
    indices = [lidar.index(bag) for lidar, bag in zip(lidars, bags, strict=True)]

    def read(place: int, start: int, count: int) -> Iterator[tuple[int, tuple[Scan | SkippedScan, Message | None]]]:
        clouds = read_clouds(bags[place], indices[place], start, count, lidars[place].decoding)
        return ((cloud, (scan, message)) for cloud, scan, message in clouds)

    for number, place, (scan, message) in ScanOrder.of(indices).read(first, None, read):
        yield number, lidars[place], scan, message


def labelled_lidars(bag: Bag, run: FinishedRun) -> tuple[Lidar, ...]:
    """The lidars of a run's labelled bag, read as the run read its own bag; raises InputError where it is no such bag."""
    topics = cloud_topics(bag)
    if set(topics) != set(run.topics or topics[:1]):
        raise InputError(
            f"{bag.path}: has clouds on {', '.join(topics) or 'no topic'} where those of {', '.join(run.topics) or 'one'} belong; "
            "run ffmap again"
        )
    lidars = find_rig(bag, verticals=run.topics or topics, time_from=run.time_from).verticals
    # Each of its clouds is a scan, of however many clouds it was made.
    return tuple(replace(lidar, clouds_a_scan=1) for lidar in lidars)


def _read_alone(path: Path, run: FinishedRun, with_points: bool) -> Iterator[CloudLabels]:
    assert run.trajectory is not None
    trajectory = read_tum(run.trajectory)
    points = _bag_points(run, trajectory) if with_points else iter(())
    following = next(points, None)
    only = next(iter(run.topics), None)
    try:
        for row, ((scan, label, label_scan), cloud) in enumerate(stream_labels(path)):
            while following is not None and following[0] < scan:
                following = next(points, None)
            own = following[1] if following is not None and following[0] == scan else None
            topic, stamp_ns = cloud or (only, int(trajectory.stamp_ns[row]))
            yield CloudLabels(scan, topic, stamp_ns, label_scan, label, own, every_place=True)
    except (OSError, KeyError, IndexError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read, or is not of this run ({error}); run ffmap again") from error


def _bag_points(run: FinishedRun, trajectory: Trajectory) -> Iterator[tuple[int, FloatArray]]:
    """Number and placed returns of each cloud of the run's bag."""
    assert run.bag_path is not None
    inputs = find_inputs(run.bag_path, run.input_options)
    smoothing = run.settings().smoothing
    with ExitStack() as stack:
        lidars = [sensor.lidar for sensor in inputs.verticals]
        for number, lidar, scan, _ in _clouds(run.bag_path, lidars, 0, stack):
            if isinstance(scan, Scan):
                yield number, _placed(scan, trajectory, lidar, smoothing)


def _placed(scan: Scan, trajectory: Trajectory | None, lidar: Lidar, smoothing: SmoothingSettings) -> FloatArray:
    """(cloud_size, 3) float32: the smoothed returns in the map, as far as poses reach."""
    points = np.full((scan.cloud_size, 3), np.nan, np.float32)
    if trajectory is not None and trajectory.covers(np.array([scan.stamp_ns])).all():
        scan = lidar.seen(scan, trajectory)
        placed = place_scan(smooth_ranges(scan, smoothing).of(scan), trajectory, lidar.T_base_sensor)
        points[scan.cloud_index] = placed.to_map(placed.points_level)
    return points


def _read_recording(path: Path, run: FinishedRun, has_final: bool, with_points: bool) -> Iterator[CloudLabels]:
    """The final stage logs the labels of scans that it changed a second time, far behind the first in the file."""
    said = rows(path, entities.SCAN_LIDAR, entities.LIDAR_PLACE) if len(run.topics) > 1 else iter(())
    topic, saying = next(iter(run.topics), None), next(said, None)
    final = (row for row in rows(path, entities.POINTS, "class_ids") if "positions" not in row.values)
    poses = rows(path, entities.SCAN, "translation") if with_points else iter(())
    following, pose = next(final, None), next(poses, None)
    for row in rows(path, entities.POINTS, entities.POINT_LABEL_SCAN):
        while following is not None and following.scan < row.scan:
            following = next(final, None)
        while pose is not None and pose.scan < row.scan:
            pose = next(poses, None)
        while saying is not None and saying.scan <= row.scan:
            topic, saying = run.topics[int(saying.values[entities.LIDAR_PLACE][0])], next(said, None)
        label = label_scan = row.values[entities.POINT_LABEL_SCAN].astype(np.uint8)
        if following is not None and following.scan == row.scan:
            label = following.values["class_ids"].astype(np.uint8)
        points = _in_map(row, pose) if with_points else None
        yield CloudLabels(row.scan, topic, row.stamp_ns, label_scan, label if has_final else None, points, every_place=False)


def _in_map(row: Row, pose: Row | None) -> FloatArray:
    positions: FloatArray = row.values["positions"].astype(np.float32)
    if pose is None or pose.scan != row.scan:
        return np.full_like(positions, np.nan)
    T = transforms.from_quaternion(pose.values["translation"][0], pose.values["quaternion"][0])
    return np.asarray(transforms.apply(T, positions), np.float32)


def pair(
    first: Iterator[CloudLabels], second: Iterator[CloudLabels]
) -> Iterator[tuple[CloudLabels | None, CloudLabels | None]]:
    """The clouds of two runs by their stamps, which increase, row by row the same returns; None where a run has no such.

    Of equal stamps the topics' names decide, as in `ScanOrder`.
    """
    for a, b in side_by_side(first, second, lambda cloud: (cloud.stamp_ns, cloud.topic or "")):
        if a is not None and b is not None and a.every_place != b.every_place:
            # A recording has rows for returns alone.
            a, b = a.of_returns(), b.of_returns()
        yield a, b


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
