"""Relabel every scan by the building, in worker processes, and write the labels."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.building.halo import Halo
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.floor import heights_above_pieces
from ffmap.app.folder.labelled_bag import write_labelled_bag
from ffmap.app.folder.labels_file import LabelsWriter, ScanLabels, clouds_of
from ffmap.app.folder.names import LABELS
from ffmap.app.record.log import Log
from ffmap.app.record.scans import log_final
from ffmap.app.run.arrays import map_arrays, pack, pack_rows, unpack, unpack_rows, write_arrays
from ffmap.app.run.blocks import VOXEL_M, Block, LabelledScan
from ffmap.app.run.report import Report
from ffmap.app.run.scans import LabelledScans
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import commonest
from ffmap.app.setup.outputs import Detail, Output
from ffmap.loaders.bag import open_bag
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan


@dataclass(frozen=True)
class FinalLabels:
    """The final labels by voxel of the map; digest: see `LabelsWriter`."""

    votes: VoxelVotes
    digest: str


@dataclass(frozen=True)
class RelabelJob:
    """A block to be relabelled. halo: file that each worker reads once, for it is large."""

    block: Block
    building: BuildingModel
    halo: Path

    @property
    def evidence(self) -> Path:
        """Its part of the recording."""
        return self.block.path.with_suffix(".final.rrd")


@dataclass(frozen=True)
class _RelabelledScan:
    label: UInt8Array


def relabel_scans(
    run: Run,
    labelled: LabelledScans,
    building: Building,
    trajectory: Trajectory,
    executor: Executor,
    report: Report,
) -> FinalLabels:
    """Relabel all scans, and write labels and labelled bag while workers go on."""
    inputs, outputs, folder = run.inputs, run.options.outputs, run.folder.path
    report.progress.stage("final", len(labelled.blocks))
    halo = run.folder.spool / "halo.arrow"
    write_arrays(halo, pack(building.halo))
    jobs = [RelabelJob(block, building.model, halo) for block in labelled.blocks]
    votes = VoxelTable(VOXEL_M, len(Label))
    topics = [sensor.lidar.topic for sensor in inputs.verticals]
    path = folder / LABELS if Output.LABELS in outputs else None
    writer = LabelsWriter(path, clouds_of(inputs.scans, topics))
    labels = writer.passing(_labels(run, jobs, votes, executor, report))
    if Output.LABELLED_BAG in outputs:
        indices = [sensor.index for sensor in inputs.verticals]
        with ExitStack() as stack:
            bags = [stack.enter_context(open_bag(inputs.bag_path)) for _ in indices]
            write_labelled_bag(folder, bags, indices, inputs.rig, trajectory, labels)
    deque(labels, maxlen=0)
    return FinalLabels(votes.votes(), writer.digest)


def _labels(
    run: Run, jobs: list[RelabelJob], votes: VoxelTable, executor: Executor, report: Report
) -> Iterator[ScanLabels]:
    """Yield the labels of each scan, block by block; `votes` takes the final ones."""
    failed: list[SkippedScan] = []
    for job, failed_here in zip(jobs, executor.map(relabel_block, jobs), strict=True):
        failed += failed_here
        report.check_failed(failed, len(run.inputs.scans), "final labelling")
        report.add_part(job.evidence)
        arrays = map_arrays(job.block.relabelled)
        votes.absorb(unpack(VoxelVotes, arrays, "votes_"))
        scans = unpack_rows(LabelledScan, map_arrays(job.block.labelled))
        for scan, final in zip(scans, unpack_rows(_RelabelledScan, arrays), strict=True):
            yield scan.scan, final.label, scan.label_cloud
        report.progress.advance()
    if failed:
        why = commonest([scan.reason for scan in failed])
        report.warn(
            f"{len(failed)} scans keep the labels that they have alone: final labelling failed "
            f"({why})"
        )


def relabel_block(job: RelabelJob) -> list[SkippedScan]:
    """Relabel every return of a block; scans whose data raise an exception keep their labels."""
    block = job.block
    if block.resumed and block.relabelled.exists():
        return []
    scans = unpack_rows(LabelledScan, map_arrays(block.labelled))
    halo = _halo(job.halo, block.recording_id)
    relabelling = Relabelling.of(job.building, halo, block.settings.relabelling)
    labels: list[_RelabelledScan] = []
    failed: list[SkippedScan] = []
    votes = VoxelTable(VOXEL_M, len(Label))
    # A recording of the map alone contains no final labels, and Rerun rejects an empty file.
    with nullcontext() if block.detail is Detail.MAP else block.log(job.evidence) as log:
        for scan in scans:
            try:
                label = _relabel(scan, relabelling, log)
            except Exception as error:
                failed.append(SkippedScan.failed(scan.scan, scan.stamp_ns, error))
                label = scan.label
            votes.add(scan.points_map, label)
            whole = full_labels(len(scan.label_cloud), scan.cloud_index, label)
            labels.append(_RelabelledScan(whole))
    write_arrays(block.relabelled, {**pack_rows(labels), **pack(votes.votes(), "votes_")})
    return failed


def _relabel(scan: LabelledScan, relabelling: Relabelling, log: Log | None) -> UInt8Array:
    points_level, label_scan = scan.points_level, scan.label
    relabelled = relabelling.labels(
        scan.points_map,
        # Above the floor that this scan sees: the height of the map drifts.
        heights_above_pieces(points_level, scan.floor, scan.floor_is_foot),
        below_ceiling(points_level, scan.ceiling),
        label_scan,
        transforms.apply(scan.T_map_level, scan.origin_level[None])[0],
    )
    if log:
        log_final(log, scan.scan, scan.stamp_ns, points_level, label_scan, relabelled)
    return relabelled.label


@lru_cache(maxsize=1)
def _halo(path: Path, _recording_id: str) -> Halo:
    """Map the halo once in a process for each run: another run may write to the same path."""
    return unpack(Halo, map_arrays(path))
