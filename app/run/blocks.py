"""What worker processes do: label a block of scans, and later finish it with the building's knowledge.

A block's results lie in the spool as files that appear whole: its part of the recording, and an .npz of its labels,
features and voxel votes. They are all that passes between processes, so that a killed run can go on.
"""

import time
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray, Scan, UInt8Array, within_range
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings, relabel
from ffmap.algorithms.building.votes import Halo, VoxelTable, VoxelVotes
from ffmap.algorithms.maps.rivals import RivalCounter, RivalMapsSettings
from ffmap.algorithms.poses.levelling import LevelledScan, place_and_level
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.labelling import MethodSettings, label_scan
from ffmap.algorithms.scan.smoothing import SmoothedRanges, smooth_ranges
from ffmap.algorithms.scan.summary import Features, concatenate, extract
from ffmap.app.record.scans import Detail, Recorder
from ffmap.app.record.stream import open_part
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.cloud_digest import as_rows
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan, read_digests, read_scans

VOXEL_M = 0.05
SCANS_PER_BLOCK = 20
FINAL_EVIDENCE = ".final.rrd"
STAGES = ("reading", "smoothing", "placing", "labelling", "recording")
"""What a scan goes through, each timed by itself."""


@dataclass(frozen=True)
class Block:
    """Some consecutive clouds of the vertical lidar: [first, first + count), as numbered in the bag."""

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
    extrapolate_ns: int
    level_scan_max_deg: float
    method: MethodSettings
    rival_maps: RivalMapsSettings
    cell_m: float
    """Edge of the grid maps' cells."""
    seed: int
    recording_id: str
    detail: Detail | None
    path: Path
    """The block's files without their suffixes."""


@dataclass(frozen=True)
class FinishJob:
    """What a worker needs to finish a block."""

    label: LabelJob
    building: BuildingModel
    halo: Path
    """A file that `save_halo` wrote: it grows with the building, and each worker reads it once."""
    settings: RelabellingSettings


@dataclass(frozen=True)
class BlockSummary:
    """What the run's own process needs to know of a labelled block.

    scan: (s,) scans that were labelled; stamp_ns, T_map_base: (s,), (s, 4, 4) at their header stamps.
    skipped: number and reason of each cloud that was not.
    cloud_digest: (k, 16) uint8 of the bytes of every cloud of the block, skipped ones too.
    label_counts: (256,) returns by label. milliseconds: (s, 5), see `STAGES`.
    points_in_cloud, points_in_lines: (s,)
    beyond_range: (s,) returns that were left out because they lie too far away.
    """

    scan: IntArray
    stamp_ns: IntArray
    T_map_base: FloatArray
    skipped_scan: IntArray
    skipped_reason: tuple[str, ...]
    cloud_digest: UInt8Array
    label_counts: IntArray
    milliseconds: FloatArray
    points_in_cloud: IntArray
    points_in_lines: IntArray
    beyond_range: IntArray


def split_blocks(clouds: int) -> list[Block]:
    """The blocks that `clouds` clouds make."""
    return [
        Block(number, first, min(SCANS_PER_BLOCK, clouds - first))
        for number, first in enumerate(range(0, clouds, SCANS_PER_BLOCK))
    ]


def label_block(job: LabelJob) -> BlockSummary:
    """Label every scan of a block; write its evidence, labels, features and votes to the spool."""
    sensor = _vertical(job.inputs)
    skipped: list[SkippedScan] = []
    scans: list[tuple[int, int, FloatArray]] = []
    features: list[Features] = []
    labels: list[UInt8Array] = []
    ceilings: list[FloatArray] = []
    milliseconds: list[list[float]] = []
    sizes: list[tuple[int, int]] = []
    beyond_range: list[int] = []
    counts = np.zeros(256, np.int64)
    digests: list[bytes] = []
    table = VoxelTable(VOXEL_M, len(Label))
    rivals = RivalCounter(job.cell_m, job.rival_maps)
    with _open_evidence(job, ".rrd") as recorder:
        started = time.perf_counter()
        for index, scan in read_scans(
            _open(job.inputs.bag_path), sensor.index, job.block.first, job.block.count, sensor.lidar.decoding, digests
        ):
            read = time.perf_counter()
            if (
                isinstance(scan, Scan)
                and not job.trajectory.covers(np.array([scan.start_ns, scan.end_ns]), job.extrapolate_ns).all()
            ):
                scan = SkippedScan(index, scan.stamp_ns, "no pose at its time")
            returns = len(scan) if isinstance(scan, Scan) else 0
            if isinstance(scan, Scan):
                scan = _near(index, scan, job)
            if isinstance(scan, SkippedScan):
                skipped.append(scan)
                if recorder:
                    recorder.log_skipped(scan.index, scan.stamp_ns, scan.reason)
                started = time.perf_counter()
                continue
            ranges = smooth_ranges(scan, job.method.smoothing)
            smoothed = time.perf_counter()
            level = _place(scan, ranges, job)
            placed = level.placed
            was_placed = time.perf_counter()
            labelling = label_scan(scan, placed, job.method, seed_of(job.seed, index))
            labelled = time.perf_counter()
            timings = {
                "reading": 1e3 * (read - started),
                "smoothing": 1e3 * (smoothed - read),
                "placing": 1e3 * (was_placed - smoothed),
                "labelling": 1e3 * (labelled - was_placed),
            }
            if recorder:
                recorder.log_scan(index, level, labelling, scan.stamp_ns, timings)
            features.append(extract(index, placed, labelling))
            table.add(points_in_map(placed), labelling.label)
            rivals.add(placed, labelling)
            labels.append(full_labels(scan, labelling.label))
            ceilings.append(labelling.ceiling_planes)
            counts += np.bincount(labelling.label, minlength=256)
            scans.append((index, scan.stamp_ns, job.trajectory.at(np.array([scan.stamp_ns]))[0]))
            beyond_range.append(returns - len(scan))
            sizes.append(
                (scan.cloud_size, int(np.count_nonzero(~np.isin(labelling.label, (Label.FLOOR, Label.CEILING)))))
            )
            milliseconds.append([*timings.values(), 1e3 * (time.perf_counter() - labelled)])
            started = time.perf_counter()
        if recorder:
            recorder.log_scan_metrics()
    summary = BlockSummary(
        scan=np.array([s[0] for s in scans], np.int64),
        stamp_ns=np.array([s[1] for s in scans], np.int64),
        T_map_base=np.array([s[2] for s in scans]).reshape(-1, 4, 4),
        skipped_scan=np.array([s.index for s in skipped], np.int64),
        skipped_reason=tuple(s.reason for s in skipped),
        cloud_digest=as_rows(digests),
        label_counts=counts,
        milliseconds=np.array(milliseconds).reshape(-1, len(STAGES)),
        points_in_cloud=np.array([s[0] for s in sizes], np.int64),
        points_in_lines=np.array([s[1] for s in sizes], np.int64),
        beyond_range=np.array(beyond_range, np.int64),
    )
    _save(
        job.path.with_suffix(".npz"),
        {
            **{f"summary_{f.name}": np.asarray(getattr(summary, f.name)) for f in fields(BlockSummary)},
            **_label_arrays(labels, summary.scan),
            "ceiling_count": np.array([len(c) for c in ceilings], np.int64),
            "ceiling_planes": np.concatenate(ceilings) if ceilings else np.zeros((0, 3)),
            **(
                {f"feature_{f.name}": getattr(concatenate(features), f.name) for f in fields(Features)}
                if features
                else {}
            ),
            **_vote_arrays("votes", table.votes()),
            **_vote_arrays("rivals", rivals.votes()),
        },
    )
    return summary


def finish_block(job: FinishJob) -> None:
    """Read a block's scans a second time and give every return its final label; write labels and votes to the spool.

    Raises InputError where they are not what was read the first time.
    """
    label_job = job.label
    sensor = _vertical(label_job.inputs)
    earlier = load_labels(label_job.path.with_suffix(".npz"))
    ceilings = _load_ceilings(label_job.path.with_suffix(".npz"))
    labels: list[UInt8Array] = []
    numbers: list[int] = []
    digests: list[bytes] = []
    table = VoxelTable(VOXEL_M, len(Label))
    with _open_evidence(label_job, FINAL_EVIDENCE) as recorder:
        for index, scan in read_scans(
            _open(label_job.inputs.bag_path),
            sensor.index,
            label_job.block.first,
            label_job.block.count,
            sensor.lidar.decoding,
            digests,
        ):
            if index not in earlier or isinstance(scan, SkippedScan):
                continue
            scan = within_range(scan, label_job.method.scan.range_max_m)
            level = _place(scan, smooth_ranges(scan, label_job.method.smoothing), label_job)
            placed = level.placed
            points_map = points_in_map(placed)
            label_of_scan = earlier[index][scan.cloud_index]
            label = relabel(
                points_map,
                # A map's height drifts; a door's head is so high above the floor that it was seen with.
                level.floor.heights_above(placed.points_level),
                below_ceiling(placed.points_level, ceilings[index]),
                label_of_scan,
                placed.to_map(placed.origin_level[None])[0],
                job.building,
                _load_halo(job.halo),
                job.settings,
            )
            if recorder:
                recorder.log_final(index, scan.stamp_ns, placed, label_of_scan, label)
            table.add(points_map, label)
            labels.append(full_labels(scan, label))
            numbers.append(index)
    if not np.array_equal(as_rows(digests), load_summary(label_job.path.with_suffix(".npz")).cloud_digest):
        raise InputError(
            f"{label_job.inputs.bag_path}: changed while the run was reading it; let nothing write to it, and start a new run"
        )
    _save(
        label_job.path.with_suffix(".final.npz"),
        {
            **_label_arrays(labels, np.array(numbers, np.int64)),
            **_vote_arrays("votes", table.votes()),
        },
    )


def _near(index: int, scan: Scan, job: LabelJob) -> Scan | SkippedScan:
    """The scan without the returns that are too far away to be used."""
    range_max_m = job.method.scan.range_max_m
    near = within_range(scan, range_max_m)
    return (
        near
        if len(near)
        else SkippedScan(index, scan.stamp_ns, f"no return within {range_max_m:g} m (scan.range_max_m)")
    )


def _place(scan: Scan, ranges: SmoothedRanges, job: LabelJob) -> LevelledScan:
    T_base_sensor = _vertical(job.inputs).lidar.T_base_sensor
    return place_and_level(
        scan,
        ranges,
        job.trajectory,
        T_base_sensor,
        job.base_height_m,
        job.floor_slope,
        job.method.rearrangement,
        job.level_scan_max_deg,
    )


def holds_clouds_of(path: Path, block: Block, inputs: Inputs) -> bool:
    """Whether a block's .npz was made from the very clouds that the bag holds now, byte by byte."""
    found = read_digests(_open(inputs.bag_path), _vertical(inputs).index, block.first, block.count)
    return np.array_equal(load_summary(path).cloud_digest, as_rows(list(found)))


def load_summary(path: Path) -> BlockSummary:
    """The summary in a block's .npz."""
    with np.load(path) as spooled:
        values = {f.name: spooled[f"summary_{f.name}"] for f in fields(BlockSummary)}
    values["skipped_reason"] = tuple(str(reason) for reason in values["skipped_reason"])
    return BlockSummary(**values)


def load_features(path: Path) -> Features | None:
    """The features in a block's .npz; None where it holds no scan."""
    with np.load(path) as spooled:
        if f"feature_{fields(Features)[0].name}" not in spooled:
            return None
        return Features(**{f.name: spooled[f"feature_{f.name}"] for f in fields(Features)})


def load_labels(path: Path) -> dict[int, UInt8Array]:
    """Labels of each cloud in a block's .npz, by its number, one for each place in the cloud."""
    with np.load(path) as spooled:
        parts = np.split(spooled["label"], np.cumsum(spooled["label_size"])[:-1])
        return (
            {int(scan): part for scan, part in zip(spooled["label_scan"], parts, strict=True)}
            if len(spooled["label_scan"])
            else {}
        )


def _load_ceilings(path: Path) -> dict[int, FloatArray]:
    """The ceiling planes (k, 3) of each scan in a block's .npz, by its number."""
    with np.load(path) as spooled:
        parts = np.split(spooled["ceiling_planes"], np.cumsum(spooled["ceiling_count"]))
        return {int(scan): part for scan, part in zip(spooled["label_scan"], parts, strict=False)}


def load_votes(path: Path) -> VoxelVotes:
    """The voxel votes in a block's .npz, of the scans' own labels or of the final ones."""
    return _load_votes(path, "votes")


def load_rivals(path: Path) -> VoxelVotes:
    """What `RivalCounter` counted of a block, from its .npz."""
    return _load_votes(path, "rivals")


def _load_votes(path: Path, name: str) -> VoxelVotes:
    with np.load(path) as spooled:
        values = {f.name: spooled[f"{name}_{f.name}"] for f in fields(VoxelVotes)}
    return VoxelVotes(**{**values, "voxel_m": float(values["voxel_m"])})


def _vote_arrays(name: str, votes: VoxelVotes) -> dict[str, IntArray | FloatArray]:
    return {f"{name}_{f.name}": np.asarray(getattr(votes, f.name)) for f in fields(VoxelVotes)}


def save_halo(path: Path, halo: Halo) -> None:
    """Write what `FinishJob.halo` names."""
    _save(path, {f.name: np.asarray(getattr(halo, f.name)) for f in fields(Halo)})


@lru_cache(maxsize=1)
def _load_halo(path: Path) -> Halo:
    with np.load(path) as stored:
        return Halo(stored["keys"], stored["label"], float(stored["voxel_m"]))


def points_in_map(placed: PlacedScan) -> FloatArray:
    """(n, 3) float32."""
    T = placed.T_map_level.astype(np.float32)
    return np.asarray(placed.points_level @ T[:3, :3].T + T[:3, 3])


def seed_of(seed: int, index: int) -> int:
    """The seed of one scan's random numbers: by the run's seed and the scan's number alone."""
    return int(np.random.SeedSequence([seed, index]).generate_state(1)[0])


class _NoEvidence:
    def __enter__(self) -> None:
        return None

    def __exit__(self, *_: object) -> None:
        return None


class _Evidence:
    """A block's part of the recording and its recorder."""

    def __init__(self, path: Path, recording_id: str, detail: Detail) -> None:
        self._block = open_part(path, recording_id)
        self._detail = detail

    def __enter__(self) -> Recorder:
        return Recorder(self._block.__enter__(), self._detail)

    def __exit__(self, *error: object) -> None:
        self._block.__exit__(*error)  # type: ignore[arg-type]


def _open_evidence(job: LabelJob, suffix: str) -> _Evidence | _NoEvidence:
    # A recording of the map alone has nothing of the final labels, and a file without content is none to Rerun.
    if job.detail is None or (job.detail is Detail.MAP and suffix == FINAL_EVIDENCE):
        return _NoEvidence()
    return _Evidence(job.path.with_suffix(suffix), job.recording_id, job.detail)


def _vertical(inputs: Inputs) -> Sensor:
    if inputs.vertical is None:
        raise ValueError("a run without a vertical lidar has nothing to label")
    return inputs.vertical


@cache
def _open(path: Path) -> Bag:
    """Each worker opens the bag once."""
    return open_bag(path)


def _label_arrays(labels: list[UInt8Array], scan: IntArray) -> dict[str, IntArray]:
    return {
        "label": np.concatenate(labels) if labels else np.zeros(0, np.uint8),
        "label_size": np.array([len(label) for label in labels], np.int64),
        "label_scan": scan,
    }


def _save(path: Path, arrays: dict[str, IntArray | FloatArray]) -> None:
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]
    part.replace(path)
