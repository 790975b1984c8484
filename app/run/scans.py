"""Label every scan by itself (paper, III), block by block in worker processes, and place it."""

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import NO_RETURN, Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, within_range
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, level_frame
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.maps.rivals import Rival, RivalCounter, RivalReturns
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.smoothing import smooth_ranges
from ffmap.algorithms.scan.summary import (
    NO_INTENSITY,
    Features,
    concatenate,
    extract_planes,
    ray_rows,
    with_rays,
)
from ffmap.app.record.building import log_map_block
from ffmap.app.record.log import Log, open_log
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.scans import log_lidar, log_metrics, log_scan, log_skipped, scan_metrics
from ffmap.app.run.arrays import map_arrays, pack, pack_rows, unpack, unpack_rows, write_arrays
from ffmap.app.run.poses import RunPoses, poses_around
from ffmap.app.run.report import Report
from ffmap.app.run.sampled_scans import transform
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import Inputs, commonest
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_scans

VOXEL_M = 0.05
"""Edge (m) of the voxels in which labels are counted."""
SCANS_PER_BLOCK = 20
_FIRST_SCANS = 4
"""Number of scans in the first block: a viewer shows them half a second sooner."""
_GRID_M = 0.001
"""Grid (m) on which returns are kept; coarser where a return is farther than 32 m away."""
_STAGES = ("reading", "smoothing", "placing", "labelling", "recording")
"""Steps of a scan whose time is measured, in their order."""
_WARNED_ONE_BY_ONE = 5
"""Number of skipped clouds that are reported one by one."""


@dataclass(frozen=True)
class Block:
    """Scans [first, first + count) in the order of all clouds, and what labels them.

    trajectory, registered: T_map_base around these scans, with loops closed and without.
    base_height_m: height of the base above the floor. floor_slope: (2,) of the map's floor.
    detail: None where nothing is recorded. path: of its files, without their suffixes.
    """

    first: int
    count: int
    inputs: Inputs
    settings: Settings
    trajectory: Trajectory
    registered: Trajectory
    base_height_m: float
    floor_slope: FloatArray
    recording_id: str
    detail: Detail | None
    path: Path

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
    def is_done(self) -> bool:
        """Whether an earlier start of the run has labelled it."""
        return self.labelled.exists() and (self.detail is None or self.evidence.exists())

    def log(self, path: Path) -> AbstractContextManager[Log | None]:
        """Open a part of the recording; None where nothing is recorded."""
        if self.detail is None:
            return nullcontext()
        return open_log(path, self.recording_id, self.detail)


@dataclass(frozen=True)
class LabelledScan:
    """A labelled scan, as it is relabelled later.

    scan: its number. stamp_ns: of its header. origin_level: (3,) the sensor.
    floor: (2, 3), floor_is_foot: as `heights_above_pieces` takes them. ceiling: (c, 3), see `plane_rows`.
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

    milliseconds: (5,) see `_STAGES`. metrics: (m,) see `METRICS`. returns: (6,) by label.
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


@dataclass(frozen=True)
class LabelledScans:
    """All labelled scans of a run.

    scan, stamps_ns: (s,) number and stamp of each. votes: labels by voxel of the map. rivals:
    returns that the maps of Fig. 6 and 9 are drawn from. counts, seconds, statistics: for run.json.
    """

    blocks: tuple[Block, ...]
    scan: IntArray
    stamps_ns: IntArray
    votes: VoxelVotes
    rivals: VoxelVotes
    counts: dict[str, Any]
    seconds: dict[str, float]
    statistics: dict[str, Any]


def label_scans(run: Run, poses: RunPoses, executor: Executor, report: Report) -> LabelledScans:
    """Label and place all scans. Raises InputError where none can be labelled."""
    blocks = split_blocks(run, poses, report.log is not None)
    order, cell_m = run.inputs.scans, run.settings.grid_map.cell_m
    report.progress.stage("scans", len(blocks) or None)
    votes, rivals = VoxelTable(VOXEL_M, len(Label)), VoxelTable(cell_m, len(Rival))
    scans: list[ScanFigures] = []
    skipped: list[SkippedScan] = []
    done = label_block_again if run.resumed else label_block
    for block, labelled in zip(blocks, executor.map(done, blocks), strict=True):
        for cloud in labelled.skipped[: max(0, _WARNED_ONE_BY_ONE - len(skipped))]:
            report.progress.warn(f"scan {cloud.index} skipped: {cloud.reason}")
        skipped += labelled.skipped
        scans += labelled.scans
        report.check_failed([s for s in skipped if s.trace], len(order), "labelling")
        arrays = map_arrays(block.labelled)
        own = unpack(VoxelVotes, arrays, "votes_")
        new = votes.absorb(own)
        rivals.absorb(unpack(VoxelVotes, arrays, "rivals_"))
        if labelled.scans:
            last = labelled.scans[-1]
            report.add_part(block.evidence)
            if report.log:
                points = own.mean_position[new].astype(np.float32)
                label = majority(own.counts[new])
                log_map_block(report.log, last.scan, last.stamp_ns, points, label)
        report.progress.advance()
    if not scans:
        raise InputError(f"{run.inputs.bag_path}: {_no_scan(run, skipped)}; 'ffmap info' shows why")
    numbers, stamps_ns = _column(scans, "scan"), _column(scans, "stamp_ns")
    if report.log:
        log_metrics(report.log, stamps_ns, numbers, _column(scans, "metrics"))
        log_trajectory(report.log, stamps_ns, poses.trajectory.at(stamps_ns), numbers)
        report.flush()
    _warn(run, scans, skipped, report)
    return LabelledScans(
        blocks=tuple(blocks),
        scan=numbers,
        stamps_ns=stamps_ns,
        votes=votes.votes(),
        rivals=rivals.votes(),
        counts=_counts(run, scans, skipped),
        seconds=_seconds(scans),
        statistics=_statistics(scans),
    )


def block_bounds(scans: int) -> list[tuple[int, int]]:
    """Divide scans into blocks: the first scan of each, and the one after its last."""
    bounds = [0, *range(_FIRST_SCANS, scans, SCANS_PER_BLOCK), scans]
    return [(first, end) for first, end in pairwise(bounds) if end > first]


def split_blocks(run: Run, poses: RunPoses, recorded: bool) -> list[Block]:
    """Divide all scans into blocks."""
    stamps_ns = run.inputs.scans.stamp_ns
    return [
        Block(
            first=first,
            count=end - first,
            inputs=run.inputs,
            settings=run.settings,
            trajectory=poses_around(poses.trajectory, stamps_ns[first:end]),
            registered=poses_around(poses.registered, stamps_ns[first:end]),
            base_height_m=poses.base_height_m,
            floor_slope=poses.floor_slope,
            recording_id=run.record["recording_id"],
            detail=run.options.detail if recorded else None,
            path=run.folder.spool / f"{number:05d}",
        )
        for number, (first, end) in enumerate(block_bounds(len(stamps_ns)))
    ]


def label_block_again(block: Block) -> LabelledBlock:
    """Label a block unless an earlier start of the run has."""
    if not block.is_done:
        return label_block(block)
    arrays = map_arrays(block.labelled)
    scans = unpack_rows(ScanFigures, arrays, "figures_")
    return LabelledBlock(scans, unpack_rows(SkippedScan, arrays, "skipped_"))


def label_block(block: Block) -> LabelledBlock:
    """Label every scan of a block, and write the block's file and its part of the recording."""
    block.relabelled.unlink(missing_ok=True)
    votes = VoxelTable(VOXEL_M, len(Label))
    rivals = RivalCounter(block.settings.grid_map.cell_m)
    scans: list[LabelledScan] = []
    features: list[Features] = []
    figures: list[ScanFigures] = []
    skipped: list[SkippedScan] = []
    with block.log(block.evidence) as log:
        watch = _Stopwatch()
        for number, place, read in _read(block):
            watch.lap("reading")
            scan = _usable(number, read, block)
            if isinstance(scan, Scan):
                assert isinstance(read, Scan)
                try:
                    own = _label(number, place, scan, len(read) - len(scan), block, log, watch)
                except Exception as error:
                    scan = SkippedScan.failed(number, scan.stamp_ns, error)
            if isinstance(scan, SkippedScan):
                skipped.append(scan)
                if log:
                    log_skipped(log, scan.index, scan.stamp_ns, scan.reason)
            else:
                scans.append(own.scan)
                features.append(own.features)
                figures.append(own.figures)
                votes.add(own.points_map, own.scan.label)
                rivals.add(own.points_map, own.rivals)
            watch = _Stopwatch()
    arrays = {
        **pack_rows(scans),
        **pack_rows(figures, "figures_"),
        **pack_rows(skipped, "skipped_"),
        **(pack(concatenate(features), "feature_") if features else {}),
        **pack(votes.votes(), "votes_"),
        **pack(rivals.votes(), "rivals_"),
    }
    write_arrays(block.labelled, arrays)
    return LabelledBlock(figures, skipped)


@dataclass(frozen=True)
class _Labelled:
    scan: LabelledScan
    points_map: FloatArray
    features: Features
    rivals: RivalReturns
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
    inputs, settings = block.inputs, block.settings
    lidar, cloud = inputs.verticals[place].lidar, int(inputs.scans.cloud[number])
    scan = lidar.seen(scan, block.registered)
    ranges = smooth_ranges(scan, settings.smoothing)
    watch.lap("smoothing")
    level = place_and_level(
        scan,
        ranges,
        block.registered,
        lidar.T_base_sensor,
        block.base_height_m,
        block.floor_slope,
        settings.rearrangement,
        settings.trajectory.level_scan_max_deg,
    )
    watch.lap("placing")
    # By the cloud's own number: other lidars on the robot do not change its labels.
    seed = seed_of(settings.seed, cloud)
    labelling = label_scan(
        scan, level.placed, settings.method, seed, level.floor, lidar.column_pairs
    )
    watch.lap("labelling")
    metrics = scan_metrics(ranges, labelling, watch.milliseconds)
    rivals = RivalReturns.of(level.placed.points_level, labelling)
    level = _moved(level, block, scan)
    labelled = LabelledScan.of(number, scan, level.placed, labelling)
    points_map = labelled.points_map
    rays = ray_rows(cloud, labelling)
    features = with_rays(
        extract_planes(number, level.placed, labelling).moved(labelled.T_map_level[None]),
        [points_map[rays]],
        [labelling.label[rays]],
        [NO_INTENSITY if scan.intensity is None else scan.intensity[rays]],
    )
    if log:
        known = any(sensor.lidar.decoding.intensity for sensor in inputs.verticals)
        intensity = NO_INTENSITY if scan.intensity is None and known else scan.intensity
        log_scan(log, number, level, labelling, scan.stamp_ns, intensity)
        if len(inputs.verticals) > 1:
            log_lidar(log, place, lidar.topic)
    returns = np.bincount(labelling.label, minlength=len(Label))[list(Label)]
    horizontal = returns[Label.FLOOR] + returns[Label.CEILING]
    watch.lap("recording")
    figures = ScanFigures(
        scan=number,
        stamp_ns=scan.stamp_ns,
        milliseconds=np.array([watch.milliseconds[stage] for stage in _STAGES]),
        metrics=metrics,
        returns=returns,
        cloud_size=scan.cloud_size,
        points_in_lines=len(labelling.label) - int(horizontal),
        beyond_range=beyond_range,
        rejected_m=level.floor.rejected_m,
    )
    return _Labelled(labelled, points_map, features, rivals, figures)


def _moved(level: LevelledScan, block: Block, scan: Scan) -> LevelledScan:
    """Move a scan to its pose after loops are closed."""
    placed = level.placed
    T_level_base = np.linalg.inv(placed.T_map_level) @ placed.T_map_base
    (T_map_base,) = block.trajectory.at(np.array([scan.reference_ns]))
    T_map_level = level_frame(T_map_base, block.base_height_m)
    return replace(
        level,
        placed=replace(placed, T_map_level=T_map_level, T_map_base=T_map_level @ T_level_base),
    )


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


def _usable(number: int, scan: Scan | SkippedScan, block: Block) -> Scan | SkippedScan:
    """Leave out returns that are too far away, and skip scans without a pose or a return."""
    if isinstance(scan, SkippedScan):
        return scan
    settings = block.settings
    extrapolate_ns = int(settings.trajectory.extrapolate_s * 1e9)
    swept_ns = np.array([scan.start_ns, scan.end_ns])
    if not block.registered.covers(swept_ns, extrapolate_ns).all():
        return SkippedScan(number, scan.stamp_ns, "no pose at its time")
    range_max_m = settings.scan.range_max_m
    near = within_range(scan, range_max_m)
    if not len(near):
        reason = f"no return within {range_max_m:g} m (scan.range_max_m)"
        return SkippedScan(number, scan.stamp_ns, reason)
    return near


def seed_of(seed: int, index: int) -> int:
    """Derive the seed of one scan from the seed of the run and the number of the cloud."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


def _column(scans: Sequence[ScanFigures], name: str) -> Any:  # noqa: ANN401 - any array
    return np.array([getattr(scan, name) for scan in scans])


def _counts(
    run: Run, scans: Sequence[ScanFigures], skipped: Sequence[SkippedScan]
) -> dict[str, Any]:
    reasons = sorted(cloud.reason for cloud in skipped)
    returns = _column(scans, "returns").sum(axis=0)
    counts: dict[str, Any] = {"clouds": len(run.inputs.scans), "scans": len(scans)}
    topics = [sensor.lidar.topic for sensor in run.inputs.verticals]
    if len(topics) > 1:
        lidar = run.inputs.scans.lidar[_column(scans, "scan")]
        by_topic = np.bincount(lidar, minlength=len(topics)).tolist()
        counts["scans_by_topic"] = dict(zip(topics, by_topic, strict=True))
    counts["skipped"] = {reason: reasons.count(reason) for reason in reasons}
    counts["returns"] = {label.name.lower(): int(returns[label]) for label in Label}
    if beyond := int(_column(scans, "beyond_range").sum()):
        counts["beyond_range"] = beyond
    return counts


def _seconds(scans: Sequence[ScanFigures]) -> dict[str, float]:
    medians = np.median(_column(scans, "milliseconds"), axis=0) / 1e3
    return {f"{stage}_per_scan": float(s) for stage, s in zip(_STAGES, medians, strict=True)}


def _statistics(scans: Sequence[ScanFigures]) -> dict[str, Any]:
    """Compute Table I of the paper."""
    milliseconds = dict(zip(_STAGES, _column(scans, "milliseconds").T, strict=True))
    columns = {
        "milliseconds_per_cloud": milliseconds["smoothing"] + milliseconds["labelling"],
        "points_in_cloud": _column(scans, "cloud_size").astype(np.float64),
        "points_in_lines": _column(scans, "points_in_lines").astype(np.float64),
    }
    return {
        name: {
            "mean": float(values.mean()),
            "standard_deviation": float(values.std()),
            "min": float(values.min()),
            "max": float(values.max()),
        }
        for name, values in columns.items()
    }


def _no_scan(run: Run, skipped: Sequence[SkippedScan]) -> str:
    topics = " and ".join(sensor.lidar.topic for sensor in run.inputs.verticals)
    return f"no usable cloud on {topics} ({commonest([cloud.reason for cloud in skipped])})"


def _warn(
    run: Run, scans: Sequence[ScanFigures], skipped: Sequence[SkippedScan], report: Report
) -> None:
    if skipped:
        why = commonest([cloud.reason for cloud in skipped])
        report.warn(f"{len(skipped)} vertical clouds skipped: {why}", show=False)
    beyond = _column(scans, "beyond_range")
    if beyond.any():
        report.warn(
            f"returns farther than {run.settings.scan.range_max_m:g} m away were left out "
            f"(scan.range_max_m): {beyond.sum():,}, in {np.count_nonzero(beyond):,} of "
            f"{len(beyond):,} scans"
        )
    if rejected := [scan for scan in scans if scan.rejected_m]:
        off_m = float(np.median([scan.rejected_m for scan in rejected]))
        first, last = rejected[0].scan, rejected[-1].scan
        report.warn(
            f"{len(rejected):,} of the scans {first} to {last} show more ground "
            f"{100 * abs(off_m):.0f} cm {'below' if off_m < 0 else 'above'} the floor under the "
            "robot than at its height, for example outside a window. It is not used as the floor. "
            f"'ffmap inspect {run.folder.path} --scan {first}' shows it"
        )
