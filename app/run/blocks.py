"""The work of a worker process: label and place every scan of a block (paper, III)."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, within_range
from ffmap.algorithms.base.trajectory import (
    EXTRAPOLATE_NS,
    PlacedScan,
    level_frame,
)
from ffmap.algorithms.base.votes import VoxelTable
from ffmap.algorithms.maps.rivals import Rival, rival_returns
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.smoothing import SmoothedRanges, smooth_ranges
from ffmap.algorithms.scan.summary import NO_INTENSITY, Features, concatenate, extract
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import log_lidar, log_scan, log_skipped, scan_metrics
from ffmap.app.run.arrays import map_arrays, pack, pack_rows, unpack_rows, write_arrays
from ffmap.app.run.poses import RunPoses
from ffmap.app.run.sampled_scans import transform
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_scans

VOXEL_M = 0.05
"""Edge (m) of the voxels in which labels are counted."""
STAGES = ("reading", "smoothing", "placing", "labelling", "recording")
"""Steps of a scan whose time is measured, in their order."""
_GRID_M = 0.001
"""Grid (m) on which returns are kept; coarser where a return is farther than 32 m away."""


@dataclass(frozen=True)
class Block:
    """Scans [first, first + count) in the order of all clouds, and what labels them.

    poses: around these scans.
    detail: None where nothing is recorded. path: of its files, without their suffixes.
    resumed: whether an earlier start of the run may have labelled it.
    """

    first: int
    count: int
    inputs: Inputs
    settings: Settings
    poses: RunPoses
    recording_id: str
    detail: Detail | None
    path: Path
    resumed: bool = False

    @property
    def labelled(self) -> Path:
        """The file of its labelled scans."""
        return self.path.with_suffix(".arrow")

    @property
    def evidence(self) -> Path:
        """Its part of the recording."""
        return self.path.with_suffix(".rrd")

    @property
    def relabelled(self) -> Path:
        """The file of its final labels."""
        return self.path.with_suffix(".final.arrow")

    @property
    def final_evidence(self) -> Path:
        """The part of the recording that its final labels are in."""
        return self.path.with_suffix(".final.rrd")

    @property
    def is_done(self) -> bool:
        """Whether an earlier start of the run has labelled it."""
        recorded = self.detail is None or self.evidence.exists()
        return self.resumed and recorded and self.labelled.exists()

    def log(self, path: Path) -> AbstractContextManager[Log | None]:
        """Open a part of the recording; None where nothing is recorded."""
        if self.detail is None:
            return nullcontext()
        return open_log(path, self.recording_id, self.detail)


@dataclass(frozen=True)
class LabelledScan:
    """A labelled scan, as it is relabelled later.

    scan: its number. stamp_ns: of its header. origin_level: (3,) the sensor.
    floor: (2, 3), floor_is_foot: as `heights_above_pieces` takes them.
    ceiling: (c, 3), see `plane_rows`.
    point: (n, 3) int16, returns in multiples of grid_m. All these in the frame level.
    place: (n,) int32, place of each return in the cloud; empty for returns in the cloud's order.
    label_cloud: (cloud_size,) uint8, see `full_labels`.
    """

    scan: int
    stamp_ns: int
    T_map_level: FloatArray
    origin_level: FloatArray
    floor: FloatArray
    floor_is_foot: bool
    ceiling: FloatArray
    grid_m: float
    point: IntArray
    place: IntArray
    label_cloud: UInt8Array

    @classmethod
    def of(
        cls, number: int, scan: Scan, placed: PlacedScan, labelling: ScanLabelling
    ) -> "LabelledScan":
        farthest_m = float(np.abs(placed.points_level).max(initial=0.0))
        grid_m = max(_GRID_M, farthest_m / np.iinfo(np.int16).max)
        in_order = bool(np.all(np.diff(scan.cloud_index) > 0))
        return cls(
            scan=number,
            stamp_ns=scan.stamp_ns,
            T_map_level=placed.T_map_level,
            origin_level=placed.origin_level,
            floor=labelling.floor.both_pieces,
            floor_is_foot=labelling.floor.is_foot,
            ceiling=labelling.ceiling_planes,
            grid_m=grid_m,
            point=np.rint(placed.points_level * np.float32(1.0 / grid_m)).astype(np.int16),
            place=scan.cloud_index[:0] if in_order else scan.cloud_index,
            label_cloud=full_labels(scan.cloud_size, scan.cloud_index, labelling.label),
        )

    @property
    def points_level(self) -> FloatArray:
        """(n, 3) float32, metres."""
        return np.asarray(self.point * np.float32(self.grid_m))

    @property
    def points_map(self) -> FloatArray:
        """(n, 3) float32, metres."""
        return transform(self.T_map_level, self.points_level)

    @property
    def cloud_index(self) -> IntArray:
        """(n,) place of each return in the cloud."""
        return self.place if len(self.place) else np.flatnonzero(self.label_cloud != NO_RETURN)

    @property
    def label(self) -> UInt8Array:
        """(n,) label of each return."""
        return self.label_cloud[self.cloud_index]


@dataclass(frozen=True)
class ScanFigures:
    """Figures of one labelled scan.

    milliseconds: (5,) see `STAGES`. metrics: (m,) see `METRICS`. returns: (6,) by label.
    beyond_range: returns that are left out because they are too far away. rejected_m: see `Floor`.
    """

    scan: int
    stamp_ns: int
    milliseconds: FloatArray
    metrics: FloatArray
    returns: IntArray
    cloud_size: int
    points_in_lines: int
    beyond_range: int
    rejected_m: float


@dataclass(frozen=True)
class LabelledBlock:
    """What a worker returns of a block; the file of the block contains the rest."""

    scans: list[ScanFigures]
    skipped: list[SkippedScan]


def label_block(block: Block) -> LabelledBlock:
    """Label every scan of a block, and write the block's file and its part of the recording."""
    if block.is_done:
        arrays = map_arrays(block.labelled)
        figures = unpack_rows(ScanFigures, arrays, "figures_")
        return LabelledBlock(figures, unpack_rows(SkippedScan, arrays, "skipped_"))
    block.relabelled.unlink(missing_ok=True)
    votes = VoxelTable(VOXEL_M, len(Label))
    rivals = VoxelTable(block.settings.grid_map.cell_m, len(Rival))
    scans: list[LabelledScan] = []
    features: list[Features] = []
    done = LabelledBlock([], [])
    with block.log(block.evidence) as log:
        watch = _Stopwatch()
        for number, place, read in _read(block):
            watch.lap("reading")
            scan = usable(number, read, block)
            if isinstance(scan, Scan):
                assert isinstance(read, Scan)
                try:
                    own = _label(number, place, scan, len(read) - len(scan), block, log, watch)
                except Exception as error:
                    scan = SkippedScan.failed(number, scan.stamp_ns, error)
            if isinstance(scan, SkippedScan):
                done.skipped.append(scan)
                if log:
                    log_skipped(log, scan.index, scan.stamp_ns, scan.reason)
            else:
                scans.append(own.scan)
                features.append(own.features)
                done.scans.append(own.figures)
                votes.add(own.points_map, own.scan.label)
                rivals.add(*own.rivals)
            watch = _Stopwatch()
    written = {
        **pack_rows(scans),
        **pack_rows(done.scans, "figures_"),
        **pack_rows(done.skipped, "skipped_"),
        **(pack(concatenate(features), "feature_") if features else {}),
        **pack(votes.votes(), "votes_"),
        **pack(rivals.votes(), "rivals_"),
    }
    write_arrays(block.labelled, written)
    return done


@dataclass(frozen=True)
class _Labelled:
    scan: LabelledScan
    points_map: FloatArray
    features: Features
    rivals: tuple[FloatArray, UInt8Array]
    figures: ScanFigures


def _label(
    number: int,
    place: int,
    scan: Scan,
    beyond_range: int,
    block: Block,
    log: Log | None,
    watch: "_Stopwatch",
) -> _Labelled:
    """Label and record one scan. place: of its lidar among the labelled ones."""
    inputs = block.inputs
    lidar, cloud = inputs.verticals[place].lidar, int(inputs.scans.cloud[number])
    alone = label_alone(number, scan, block, watch.lap)
    scan, level, labelling = alone.scan, alone.level, alone.labelling
    metrics = scan_metrics(alone.ranges, labelling, watch.milliseconds)
    level = _with_loops_closed(level, scan, block)
    labelled = LabelledScan.of(number, scan, level.placed, labelling)
    points_map = labelled.points_map
    rivals = rival_returns(points_map, labelling)
    intensity = NO_INTENSITY if scan.intensity is None else scan.intensity
    features = extract(cloud, level.placed, labelling, points_map, intensity)
    features = replace(features, scan=np.array([number]))
    if log:
        known = any(sensor.lidar.decoding.intensity for sensor in inputs.verticals)
        shown = intensity if len(intensity) or known else None
        log_scan(log, number, level, labelling, scan.stamp_ns, shown)
        if len(inputs.verticals) > 1:
            log_lidar(log, place, lidar.topic)
    returns = np.bincount(labelling.label, minlength=len(Label))[list(Label)]
    horizontal = returns[Label.FLOOR] + returns[Label.CEILING]
    watch.lap("recording")
    figures = ScanFigures(
        scan=number,
        stamp_ns=scan.stamp_ns,
        milliseconds=np.array([watch.milliseconds[stage] for stage in STAGES]),
        metrics=metrics,
        returns=returns,
        cloud_size=scan.cloud_size,
        points_in_lines=len(labelling.label) - int(horizontal),
        beyond_range=beyond_range,
        rejected_m=level.floor.rejected_m,
    )
    return _Labelled(labelled, points_map, features, rivals, figures)


@dataclass(frozen=True)
class LabelledAlone:
    """A scan labelled by itself. scan: its returns in the order of the labels."""

    scan: Scan
    ranges: SmoothedRanges
    level: LevelledScan
    labelling: ScanLabelling


def label_alone(
    number: int, scan: Scan, block: Block, lap: Callable[[str], None] = lambda stage: None
) -> LabelledAlone:
    """Smooth, place and label one usable scan of a block. lap: is called after each stage."""
    inputs, settings = block.inputs, block.settings
    lidar = inputs.verticals[inputs.scans.lidar[number]].lidar
    scan = lidar.seen(scan, block.poses.registered)
    ranges = smooth_ranges(scan, settings.smoothing)
    lap("smoothing")
    level = place_and_level(
        scan,
        ranges,
        block.poses.registered,
        lidar.T_base_sensor,
        block.poses.base_height_m,
        block.poses.floor_slope,
        settings.rearrangement,
    )
    lap("placing")
    # By the cloud's own number: other lidars on the robot do not change its labels.
    seed = np.random.SeedSequence([settings.seed, int(inputs.scans.cloud[number])])
    labelling = label_scan(
        scan,
        level.placed,
        settings.method,
        int(seed.generate_state(1)[0]),
        level.floor,
        lidar.column_pairs,
    )
    lap("labelling")
    return LabelledAlone(scan, ranges, level, labelling)


def _with_loops_closed(level: LevelledScan, scan: Scan, block: Block) -> LevelledScan:
    """Move a labelled scan to its pose with loops closed: it moves as one."""
    placed = level.placed
    T_level_base = transforms.invert(placed.T_map_level) @ placed.T_map_base
    (T_map_base,) = block.poses.trajectory.at(np.array([scan.reference_ns]))
    T_map_level = level_frame(T_map_base, block.poses.base_height_m)
    moved = replace(placed, T_map_level=T_map_level, T_map_base=T_map_level @ T_level_base)
    return replace(level, placed=moved)


class _Stopwatch:
    """Milliseconds of one scan by stage."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.milliseconds[stage] = 1e3 * (now - self._since)
        self._since = now


def _read(block: Block) -> Iterator[tuple[int, int, Scan | SkippedScan]]:
    """Read the scans of a block, each with its number and the place of its lidar."""
    inputs = block.inputs

    def read(place: int, first: int, count: int) -> Iterator[tuple[int, Scan | SkippedScan]]:
        sensor, thread = inputs.verticals[place], threading.get_ident()
        bag = _open(inputs.bag_path, block.recording_id, thread, place)
        return read_scans(bag, sensor.index, first, count, sensor.lidar.decoding)

    return inputs.scans.read(block.first, block.count, read)


@lru_cache(maxsize=8)
def _open(bag_path: BagPath, _recording_id: str, _thread: int, _place: int) -> Bag:
    """Open a bag once for each run, thread and lidar: another run may find another bag there."""
    return open_bag(bag_path)


def usable(number: int, scan: Scan | SkippedScan, block: Block) -> Scan | SkippedScan:
    """Leave out returns that are too far away, and skip scans without a pose or a return."""
    if isinstance(scan, SkippedScan):
        return scan
    settings = block.settings
    swept_ns = np.array([scan.start_ns, scan.end_ns])
    if not block.poses.registered.covers(swept_ns, EXTRAPOLATE_NS).all():
        return SkippedScan(number, scan.stamp_ns, "no pose at its time")
    range_max_m = settings.scan.range_max_m
    near = within_range(scan, range_max_m)
    if not len(near):
        reason = f"no return within {range_max_m:g} m (scan.range_max_m)"
        return SkippedScan(number, scan.stamp_ns, reason)
    return near
