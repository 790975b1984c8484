"""Stage 4 of a run: every return's final label by the building's knowledge; labelled bag and fused cloud."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, fuse
from ffmap.app.folder.cloud_file import write_ply
from ffmap.app.folder.labelled_bag import write_labelled_bag
from ffmap.app.folder.labels_file import LabelsWriter, clouds_of
from ffmap.app.folder.names import CLOUD, LABELS
from ffmap.app.record.building import log_cloud
from ffmap.app.run.arrays import pack
from ffmap.app.run.blocks import FINAL_EVIDENCE, VOXEL_M, FinishJob, PlaceJob, finish_block
from ffmap.app.run.context import Run
from ffmap.app.run.spool import FINAL, VOTES, load, load_labels, save
from ffmap.app.setup.inputs import commonest
from ffmap.app.setup.outputs import Output
from ffmap.blueprints import entities
from ffmap.loaders.bag import open_bag
from ffmap.loaders.scans import SkippedScan


def finish(run: Run, pool: Executor, jobs: tuple[PlaceJob, ...], building: Building, trajectory: Trajectory) -> None:
    """Final labels by the workers, while this process writes the labelled bag behind them."""
    run.progress.stage("final", len(jobs))
    table = VoxelTable(VOXEL_M, len(Label))
    outputs = run.options.outputs
    inputs = run.inputs
    clouds = clouds_of(inputs.scans, [sensor.lidar.topic for sensor in inputs.verticals])
    writer = LabelsWriter(run.folder.path / LABELS if Output.LABELS in outputs else None, clouds)
    labels = writer.passing(_labels(run, jobs, _submit(run, pool, jobs, building), table))
    if Output.LABELLED_BAG in outputs:
        indices = [sensor.index for sensor in inputs.verticals]
        with ExitStack() as stack:
            bags = [stack.enter_context(open_bag(inputs.bag_path)) for _ in indices]
            write_labelled_bag(run.folder.path, bags, indices, inputs.rig, trajectory, labels, run.state.clouds)
    deque(labels, maxlen=0)
    run.state.labels_digest = writer.digest
    pool.shutdown()  # the workers' memory goes before the whole cloud is made
    cloud = fuse(table.votes())
    if Output.CLOUD in outputs:
        colours = np.array([entities.CLASSES[label][1] for label in Label], np.uint8)
        write_ply(run.folder.path / CLOUD, cloud, colours[cloud.label])
    if run.log:
        log_cloud(run.log, cloud.points_map, cloud.label)
    run.state.counts["cloud_points"] = len(cloud)


def _submit(run: Run, pool: Executor, jobs: tuple[PlaceJob, ...], building: Building) -> list[Future[list[SkippedScan]] | None]:
    """The work on each block; None where a run that is resumed has done it."""
    halo = run.folder.spool / "halo.arrow"
    save(halo, pack(building.halo))
    pending: list[Future[list[SkippedScan]] | None] = []
    for job in jobs:
        done = job.label.path.with_suffix(FINAL).exists() and run.resumed
        finish = FinishJob(job, building.model, halo)
        pending.append(None if done else pool.submit(finish_block, finish))
    return pending


def _labels(
    run: Run, jobs: tuple[PlaceJob, ...], pending: list[Future[list[SkippedScan]] | None], table: VoxelTable
) -> Iterator[tuple[int, UInt8Array, UInt8Array]]:
    """Number, final label and the scan's own of each cloud, block by block; `table` takes the final votes."""
    failed: list[SkippedScan] = []
    for job, future in zip(jobs, pending, strict=True):
        if future is not None:
            failed += future.result()
            run.keep_failed(failed, len(run.inputs.scans), "final labelling")
        path = job.label.path
        final_path, evidence = path.with_suffix(FINAL), path.with_suffix(FINAL_EVIDENCE)
        if run.recording is not None and evidence.exists():
            run.recording.add(evidence)
        table.absorb(load(VoxelVotes, final_path, VOTES))
        yield from load_labels(path.with_suffix(".arrow"), final_path)
        run.progress.advance()
    if failed:
        why = commonest([scan.reason for scan in failed])
        run.warn(f"{len(failed)} scans keep the labels that they have alone: final labelling failed ({why})")
