"""Relabel every scan by the building, in worker processes, and write the labels."""

from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.floor import heights_above_pieces
from ffmap.app.folder.labelled_bag import write_labelled_bag
from ffmap.app.folder.labels_file import ScanLabels, write_labels
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
from ffmap.loaders.pointcloud2 import full_labels
from ffmap.loaders.scans import SkippedScan


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
) -> VoxelVotes:
    """Relabel all scans, and write labels and labelled bag while workers go on.

    Returns the final labels by voxel of the map.
    """
    inputs = run.inputs
    report.progress.stage("final", len(labelled.blocks))
    relabel = partial(relabel_block, building=building.model)
    relabelled = zip(labelled.blocks, executor.map(relabel, labelled.blocks), strict=True)
    votes = VoxelTable(VOXEL_M, len(Label))
    path = run.folder / LABELS if Output.LABELS in run.options.outputs else None
    digest = write_labels(path, _labels(run, relabelled, votes, report))
    report.add(labels_digest=digest)
    if Output.LABELLED_BAG in run.options.outputs:
        labels = (row for block in labelled.blocks for row in _labels_of(block))
        write_labelled_bag(run.folder, inputs, trajectory, labels)
    return votes.votes()


def _labels(
    run: Run,
    relabelled: Iterable[tuple[Block, list[SkippedScan]]],
    votes: VoxelTable,
    report: Report,
) -> Iterator[ScanLabels]:
    """Yield the labels of each scan, block by block; `votes` takes the final ones.

    relabelled: the blocks, each with its scans that failed.
    """
    failed: list[SkippedScan] = []
    for block, failed_here in relabelled:
        failed += failed_here
        report.check_failed(failed, len(run.inputs.scans), "final labelling")
        report.add_part(block.final_evidence)
        votes.absorb(unpack(VoxelVotes, map_arrays(block.relabelled), "votes_"))
        yield from _labels_of(block)
        report.progress.advance()
    if failed:
        why = commonest([scan.reason for scan in failed])
        report.warn(
            f"{len(failed)} scans keep the labels that they have alone: final labelling failed "
            f"({why})"
        )


def _labels_of(block: Block) -> Iterator[ScanLabels]:
    """Read the labels of a block that was relabelled."""
    scans = unpack_rows(LabelledScan, map_arrays(block.labelled))
    finals = unpack_rows(_RelabelledScan, map_arrays(block.relabelled))
    lidar_of, verticals = block.inputs.scans.lidar, block.inputs.verticals
    for scan, final in zip(scans, finals, strict=True):
        topic = verticals[lidar_of[scan.scan]].lidar.topic
        yield ScanLabels(scan.scan, topic, scan.stamp_ns, final.label, scan.label_cloud)


def relabel_block(block: Block, building: BuildingModel) -> list[SkippedScan]:
    """Relabel every return of a block; scans whose data raise an exception keep their labels."""
    if block.resumed and block.relabelled.exists():
        return []
    scans = unpack_rows(LabelledScan, map_arrays(block.labelled))
    relabelling = Relabelling.of(building, block.settings.relabelling)
    labels: list[_RelabelledScan] = []
    failed: list[SkippedScan] = []
    votes = VoxelTable(VOXEL_M, len(Label))
    # A recording of the map alone contains no final labels, and Rerun rejects an empty file.
    with nullcontext() if block.detail is Detail.MAP else block.log(block.final_evidence) as log:
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
