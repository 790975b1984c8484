"""What worker processes do: label a block of scans, and later finish it with the building's knowledge."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, within_range
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling
from ffmap.algorithms.building.votes import VoxelTable
from ffmap.algorithms.maps.rivals import RivalCounter, RivalReturns
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.floor import heights_above_pieces
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.smoothing import SmoothedRanges, smooth_ranges
from ffmap.algorithms.scan.summary import NO_INTENSITY, Features, concatenate, extract_planes, ray_rows, with_rays
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.scans import METRICS, log_final, log_lidar, log_scan, log_skipped, scan_metrics
from ffmap.app.run import spool
from ffmap.app.run.arrays import pack, pack_ragged
from ffmap.app.run.spool import BlockSummary, SpooledScan
from ffmap.app.setup.inputs import Inputs
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_digest import as_rows
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.rig import Lidar
from ffmap.loaders.scans import SkippedScan, read_digests, read_scans

VOXEL_M = 0.05
SCANS_PER_BLOCK = 20
_FIRST_SCANS = 4
"""Scans of the first block: a drive's first scans are labelled half a second sooner than with a whole one."""
FINAL_EVIDENCE = ".final.rrd"
STAGES = ("reading", "smoothing", "placing", "labelling", "recording")
"""What a scan goes through, each timed by itself."""


@dataclass(frozen=True)
class Block:
    """Some consecutive scans: [first, first + count), as numbered in the order of all clouds that are labelled."""

    number: int
    first: int
    count: int


@dataclass(frozen=True)
class LabelJob:
    """What a worker needs to label a block."""

    block: Block
    inputs: Inputs
    trajectory: Trajectory
    base_height_m: float
    """How high the base stands above the floor."""
    floor_slope: FloatArray
    """(2,) of the map's floor, metres up for each metre along x and y."""
    settings: Settings
    recording_id: str
    detail: Detail | None
    path: Path
    """The block's files without their suffixes."""


@dataclass(frozen=True)
class PlaceJob:
    """What a worker needs to place a labelled block in the map."""

    label: LabelJob
    T_map_level: FloatArray
    """(s, 4, 4) of the scans that were labelled."""


@dataclass(frozen=True)
class FinishJob:
    """What a worker needs to finish a block."""

    placed: PlaceJob
    building: BuildingModel
    halo: Path
    """The halo's file in the spool: it grows with the building, and each worker reads it once."""


def split_blocks(scans: int) -> list[Block]:
    """The blocks that `scans` scans make."""
    bounds = [0, *range(_FIRST_SCANS, scans, SCANS_PER_BLOCK), scans]
    return [Block(number, first, after - first) for number, (first, after) in enumerate(pairwise(bounds)) if after > first]


def label_block(job: LabelJob) -> BlockSummary:
    """Label every scan of a block; write its evidence, labels and features to the spool."""
    block = _LabelledBlock()
    with _open_evidence(job, ".rrd") as log:
        watch = _Stopwatch()
        for index, place, scan in _read(job, block.digests):
            watch.lap("reading")
            usable = _usable(index, scan, job)
            if isinstance(usable, Scan):
                try:
                    _label(index, place, usable, job, block, log, watch)
                    block.beyond_range.append(len(scan) - len(usable) if isinstance(scan, Scan) else 0)
                except Exception as error:
                    usable = SkippedScan.failed(index, usable.stamp_ns, error)
            if isinstance(usable, SkippedScan):
                block.skipped.append(usable)
                if log:
                    log.forget(usable.stamp_ns, usable.index)
                    log_skipped(log, usable.index, usable.stamp_ns, usable.reason)
            watch = _Stopwatch()
    summary = block.summary()
    spool.save(
        job.path.with_suffix(".arrow"),
        {
            **pack(summary, spool.SUMMARY),
            **spool.pack_scans(block.spooled),
            **(pack(concatenate(block.features), spool.FEATURES) if block.features else {}),
        },
    )
    return summary


class _Stopwatch:
    """Milliseconds of one scan by stage, see `STAGES`."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}
        self._since = time.perf_counter()

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self.milliseconds[stage] = 1e3 * (now - self._since)
        self._since = now


@dataclass(frozen=True)
class _LabelledBlock:
    """What the scans of a block come to, one after the other."""

    skipped: list[SkippedScan] = field(default_factory=list)
    scans: list[tuple[int, int, int, FloatArray]] = field(default_factory=list)
    features: list[Features] = field(default_factory=list)
    spooled: list[SpooledScan] = field(default_factory=list)
    milliseconds: list[list[float]] = field(default_factory=list)
    metrics: list[FloatArray] = field(default_factory=list)
    sizes: list[tuple[int, int]] = field(default_factory=list)
    beyond_range: list[int] = field(default_factory=list)
    rejected_m: list[float] = field(default_factory=list)
    counts: IntArray = field(default_factory=lambda: np.zeros(256, np.int64))
    digests: dict[int, list[bytes]] = field(default_factory=dict)
    """By the lidar's place."""

    def summary(self) -> BlockSummary:
        return BlockSummary(
            scan=np.array([s[0] for s in self.scans], np.int64),
            stamp_ns=np.array([s[1] for s in self.scans], np.int64),
            reference_ns=np.array([s[2] for s in self.scans], np.int64),
            T_level_base=np.array([s[3] for s in self.scans]).reshape(-1, 4, 4),
            skipped_scan=np.array([s.index for s in self.skipped], np.int64),
            skipped_reason=tuple(s.reason for s in self.skipped),
            skipped_trace=tuple(s.trace for s in self.skipped),
            cloud_digest=as_rows([digest for place in sorted(self.digests) for digest in self.digests[place]]),
            digest_lidar=np.repeat(sorted(self.digests), [len(self.digests[place]) for place in sorted(self.digests)]),
            label_counts=self.counts,
            milliseconds=np.array(self.milliseconds).reshape(-1, len(STAGES)),
            metrics=np.array(self.metrics).reshape(-1, len(METRICS)),
            points_in_cloud=np.array([s[0] for s in self.sizes], np.int64),
            points_in_lines=np.array([s[1] for s in self.sizes], np.int64),
            beyond_range=np.array(self.beyond_range, np.int64),
            rejected_m=np.array(self.rejected_m, np.float64),
        )


def _label(
    index: int, place: int, scan: Scan, job: LabelJob, block: _LabelledBlock, log: Log | None, watch: _Stopwatch
) -> None:
    """Label one scan, record it, and add to the block what it comes to, all of it or nothing. place: of its lidar."""
    inputs, lidar = job.inputs, job.inputs.verticals[place].lidar
    cloud = int(inputs.scans.cloud[index])
    scan = lidar.seen(scan, job.trajectory)
    ranges = smooth_ranges(scan, job.settings.smoothing)
    watch.lap("smoothing")
    level = _placed(scan, ranges, lidar, job)
    placed = level.placed
    watch.lap("placing")
    # By the cloud's own number: what a lidar's scan is labelled does not depend on what else is on the robot.
    seed = seed_of(job.settings.seed, cloud)
    labelling = label_scan(scan, placed, job.settings.method, seed, level.floor, lidar.column_pairs)
    watch.lap("labelling")
    metrics = scan_metrics(ranges, labelling, watch.milliseconds)
    features = extract_planes(index, placed, labelling)
    rivals = RivalReturns.of(placed.points_level, labelling)
    spooled = SpooledScan.of(index, scan, placed, labelling, rivals, ray_rows(cloud, labelling))
    T_level_base = transforms.invert(placed.T_map_level) @ placed.T_map_base
    if log:
        known = any(sensor.lidar.decoding.intensity for sensor in inputs.verticals)
        intensity = NO_INTENSITY if scan.intensity is None and known else scan.intensity
        log_scan(log, index, level, labelling, scan.stamp_ns, inputs.line_pairs, intensity)
        if len(inputs.verticals) > 1:
            log_lidar(log, place, lidar.topic)
    # Nothing below raises: a scan that fails leaves nothing in the block.
    block.metrics.append(metrics)
    block.features.append(features)
    block.spooled.append(spooled)
    counts = np.bincount(labelling.label, minlength=256)
    block.counts[...] += counts
    block.rejected_m.append(level.floor.rejected_m)
    block.scans.append((index, scan.stamp_ns, scan.reference_ns, T_level_base))
    block.sizes.append((scan.cloud_size, len(labelling.label) - int(counts[[Label.FLOOR, Label.CEILING]].sum())))
    watch.lap("recording")
    block.milliseconds.append([watch.milliseconds[stage] for stage in STAGES])


def place_block(job: PlaceJob) -> None:
    """Move each scan of a labelled block to its place in the map; write features and votes there to the spool."""
    labelled = job.label.path.with_suffix(".arrow")
    votes, rivals = VoxelTable(VOXEL_M, len(Label)), RivalCounter(job.label.settings.grid_map.cell_m)
    ends_map: list[FloatArray] = []
    ray_labels: list[UInt8Array] = []
    scans = spool.load_scans(labelled)
    for scan, T_map_level in zip(scans, job.T_map_level, strict=True):
        points_map, label = in_map(T_map_level, scan.points_level), scan.label
        votes.add(points_map, label)
        rivals.add(points_map, scan.rivals)
        ends_map.append(points_map[scan.ray])
        ray_labels.append(label[scan.ray])
    placed = {**pack(votes.votes(), spool.VOTES), **pack(rivals.votes(), spool.RIVALS)}
    for features in spool.load_features(labelled):
        intensities = [scan.ray_intensity for scan in scans]
        moved = with_rays(features.moved(job.T_map_level), ends_map, ray_labels, intensities)
        placed |= pack(moved, spool.FEATURES)
    spool.save(job.label.path.with_suffix(spool.PLACED), placed)


def finish_block(job: FinishJob) -> list[SkippedScan]:
    """Give every return of a block its final label, from where the spool says that it lies; write labels and votes to it.

    Returns the scans that keep their own labels, because their data raised an exception.
    """
    own = job.placed.label
    scans = spool.load_scans(own.path.with_suffix(".arrow"))
    relabelling = Relabelling.of(job.building, spool.load_halo(job.halo, own.recording_id), own.settings.relabelling)
    labels: list[UInt8Array] = []
    failed: list[SkippedScan] = []
    table = VoxelTable(VOXEL_M, len(Label))
    with _open_evidence(own, FINAL_EVIDENCE) as log:
        for scan, T_map_level in zip(scans, job.placed.T_map_level, strict=True):
            points_level, cloud_index = scan.points_level, scan.cloud_index
            points_map = in_map(T_map_level, points_level)
            label_scan = scan.label_cloud[cloud_index]
            try:
                relabelled = relabelling.labels(
                    points_map,
                    # Above the floor that this scan sees: the map's own height drifts.
                    heights_above_pieces(points_level, scan.floor, scan.floor_is_foot),
                    below_ceiling(points_level, scan.ceiling),
                    label_scan,
                    transforms.apply(T_map_level, scan.origin_level[None])[0],
                )
                label = relabelled.label
                if log:
                    log_final(log, scan.scan, scan.stamp_ns, points_level, label_scan, relabelled)
            except Exception as error:
                failed.append(SkippedScan.failed(scan.scan, scan.stamp_ns, error))
                label = label_scan
                if log:
                    log.forget(scan.stamp_ns, scan.scan)
            table.add(points_map, label)
            labels.append(full_labels(len(scan.label_cloud), cloud_index, label))
    final = {**pack_ragged(spool.LABEL, labels), **pack(table.votes(), spool.VOTES)}
    spool.save(own.path.with_suffix(spool.FINAL), final)
    return failed


def _read(job: LabelJob, digests: dict[int, list[bytes]]) -> Iterator[tuple[int, int, Scan | SkippedScan]]:
    """The block's clouds as scans, each with its number and the place of its lidar; `digests` takes those of their bytes."""

    def read(place: int, first: int, count: int) -> Iterator[tuple[int, Scan | SkippedScan]]:
        sensor, bag = job.inputs.verticals[place], _open(job, place)
        own = digests.setdefault(place, [])
        return read_scans(bag, sensor.index, first, count, sensor.lidar.decoding, own)

    return job.inputs.scans.read(job.block.first, job.block.count, read)


def _usable(index: int, scan: Scan | SkippedScan, job: LabelJob) -> Scan | SkippedScan:
    """The scan without the returns that are too far away, where it has a pose and any return is left."""
    if isinstance(scan, SkippedScan):
        return scan
    extrapolate_ns = int(job.settings.trajectory.extrapolate_s * 1e9)
    if not job.trajectory.covers(np.array([scan.start_ns, scan.end_ns]), extrapolate_ns).all():
        return SkippedScan(index, scan.stamp_ns, "no pose at its time")
    range_max_m = job.settings.scan.range_max_m
    near = within_range(scan, range_max_m)
    nothing = SkippedScan(index, scan.stamp_ns, f"no return within {range_max_m:g} m (scan.range_max_m)")
    return near if len(near) else nothing


def _placed(scan: Scan, ranges: SmoothedRanges, lidar: Lidar, job: LabelJob) -> LevelledScan:
    return place_and_level(
        scan,
        ranges,
        job.trajectory,
        lidar.T_base_sensor,
        job.base_height_m,
        job.floor_slope,
        job.settings.rearrangement,
        job.settings.trajectory.level_scan_max_deg,
    )


def holds_clouds_of(path: Path, block: Block, inputs: Inputs, bag: Bag) -> bool:
    """Whether a block's file was made from the very clouds that the bag holds now, byte by byte."""
    found: dict[int, list[bytes]] = {}
    scans = slice(block.first, block.first + block.count)
    for place, sensor in enumerate(inputs.verticals):
        own = inputs.scans.cloud[scans][inputs.scans.lidar[scans] == place]
        if len(own):
            found[place] = list(read_digests(bag, sensor.index, int(own[0]), len(own)))
    digests = [digest for place in sorted(found) for digest in found[place]]
    return np.array_equal(spool.load(BlockSummary, path, spool.SUMMARY).cloud_digest, as_rows(digests))


def points_in_map(placed: PlacedScan) -> FloatArray:
    """(n, 3) float32."""
    return in_map(placed.T_map_level, placed.points_level)


def in_map(T_map_level: FloatArray, points_level: FloatArray) -> FloatArray:
    """(n, 3) float32."""
    T = T_map_level.astype(np.float32)
    points_map = points_level @ T[:3, :3].T
    # Axis by axis: over rows of three, NumPy's addition takes three times as long as the product.
    for axis in range(3):
        points_map[:, axis] += T[axis, 3]
    return np.asarray(points_map)


def seed_of(seed: int, index: int) -> int:
    """The seed of one scan's random numbers: by the run's seed and the scan's number alone."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


@contextmanager
def _open_evidence(job: LabelJob, suffix: str) -> Iterator[Log | None]:
    """The block's part of the recording; None where it has none."""
    # A recording of the map alone has nothing of the final labels, and a file without content is none to Rerun.
    if job.detail is None or (job.detail is Detail.MAP and suffix == FINAL_EVIDENCE):
        yield None
        return
    with open_log(job.path.with_suffix(suffix), job.recording_id, job.detail) as log:
        yield log


class _OpenBags(threading.local):
    """What a thread has open of the run that it works on: the bag, once for each lidar."""

    def __init__(self) -> None:
        self.run: tuple[str, BagPath] | None = None
        self.by_lidar: dict[int, Bag] = {}


_open_bags = _OpenBags()


def _open(job: LabelJob, place: int) -> Bag:
    """The bag for the lidar at this place, opened once in a run.

    Who works on several runs, as a cluster's worker, opens it anew for each: another bag may lie there by then.
    """
    run = job.recording_id, job.inputs.bag_path
    if _open_bags.run != run:
        for bag in _open_bags.by_lidar.values():
            bag.close()
        _open_bags.run, _open_bags.by_lidar = run, {}
    if place not in _open_bags.by_lidar:
        _open_bags.by_lidar[place] = open_bag(job.inputs.bag_path)
    return _open_bags.by_lidar[place]
