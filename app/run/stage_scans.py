"""Stage 2 of a run: every scan is labelled, block by block, by the worker processes (paper, III)."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.maps.rivals import Rival
from ffmap.app.record.building import log_map_block
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.run.blocks import STAGES, VOXEL_M, Block, LabelJob, label_block, split_blocks
from ffmap.app.run.context import Run
from ffmap.app.run.poses import RunPoses
from ffmap.app.run.spool import RIVALS, SUMMARY, VOTES, BlockSummary, load
from ffmap.app.setup.inputs import commonest
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import InputError

_REASONS_TOLD = 5
"""Number of skipped clouds that are told one by one while the run goes on."""


@dataclass(frozen=True)
class LabelledScans:
    """jobs: of every block. stamps_ns: (s,) of the labelled scans.

    votes: what the scans' own labels say of each cube of the map. rivals: what the paper's other maps are drawn from.
    """

    jobs: tuple[LabelJob, ...]
    stamps_ns: IntArray
    votes: VoxelVotes
    rivals: VoxelVotes


def label_scans(run: Run, pool: Executor, poses: RunPoses) -> LabelledScans:
    """Label every scan that the trajectory covers. Raises InputError where none can be labelled."""
    assert run.inputs.vertical is not None
    blocks = split_blocks(len(run.inputs.vertical.index))
    run.progress.stage("scans", len(blocks) or None)
    jobs = tuple(_job(run, block, poses) for block in blocks)
    votes, rivals = VoxelTable(VOXEL_M, len(Label)), VoxelTable(run.settings.grid_map.cell_m, len(Rival))
    summaries: list[BlockSummary] = []
    last_T_map_base: FloatArray | None = None
    for block, summary in _in_order(run, pool, jobs):
        path = run.folder.block(block.number, ".arrow")
        own_votes = load(VoxelVotes, path, VOTES)
        new = votes.absorb(own_votes)
        rivals.absorb(load(VoxelVotes, path, RIVALS))
        _tell_skipped(run, summary, sum(len(earlier.skipped_reason) for earlier in summaries))
        if run.log and run.recording and len(summary.scan):
            run.recording.add(path.with_suffix(".rrd"))
            log_trajectory(run.log, summary.stamp_ns, summary.T_map_base, summary.scan, last_T_map_base)
            last_T_map_base = summary.T_map_base[-1]
            points, label = own_votes.mean_position[new].astype(np.float32), majority(own_votes.counts[new])
            log_map_block(run.log, int(summary.scan[-1]), int(summary.stamp_ns[-1]), points, label)
        summaries.append(summary)
        run.progress.advance()
    _summarise(run, blocks, summaries)
    stamps_ns = np.concatenate([np.zeros(0, np.int64), *(summary.stamp_ns for summary in summaries)])
    if not len(stamps_ns):
        why = commonest([reason for summary in summaries for reason in summary.skipped_reason])
        topic = run.inputs.vertical.lidar.topic
        raise InputError(f"{run.inputs.bag_path}: {topic} has no usable cloud ({why}); 'ffmap info' tells more")
    return LabelledScans(jobs, stamps_ns, votes.votes(), rivals.votes())


def _in_order(run: Run, pool: Executor, jobs: tuple[LabelJob, ...]) -> Iterator[tuple[Block, BlockSummary]]:
    """The blocks as they are finished, in the order of time, so that the recording grows in it."""
    running: deque[tuple[Block, Future[BlockSummary] | BlockSummary]] = deque()
    for job in jobs:
        finished = job.path.with_suffix(".arrow")
        has_evidence = job.detail is None or job.path.with_suffix(".rrd").exists()
        done = run.options.resume and finished.exists() and has_evidence
        running.append((job.block, load(BlockSummary, finished, SUMMARY) if done else pool.submit(label_block, job)))
    while running:
        block, summary = running.popleft()
        yield block, summary if isinstance(summary, BlockSummary) else summary.result()


def _job(run: Run, block: Block, poses: RunPoses) -> LabelJob:
    """Only the poses near the block travel to the worker."""
    assert run.inputs.vertical is not None
    stamps = run.inputs.vertical.index.stamp_ns[block.first : block.first + block.count]
    trajectory = poses.trajectory
    first = max(0, int(np.searchsorted(trajectory.stamp_ns, stamps.min() - 1_000_000_000)) - 2)
    last = int(np.searchsorted(trajectory.stamp_ns, stamps.max() + 1_000_000_000)) + 2
    return LabelJob(
        block=block,
        inputs=run.inputs,
        trajectory=Trajectory(trajectory.stamp_ns[first:last], trajectory.T_map_base[first:last]),
        base_height_m=poses.base_height_m,
        floor_slope=poses.floor_slope,
        settings=run.settings,
        recording_id=run.record["recording_id"],
        detail=run.options.detail if run.log else None,
        path=run.folder.block(block.number, ""),
    )


def _tell_skipped(run: Run, summary: BlockSummary, told: int) -> None:
    untold = max(0, _REASONS_TOLD - told)
    for index, reason in list(zip(summary.skipped_scan.tolist(), summary.skipped_reason, strict=True))[:untold]:
        run.progress.warn(f"scan {index} skipped: {reason}")


def _summarise(run: Run, blocks: list[Block], summaries: list[BlockSummary]) -> None:
    """Counts, timings and sizes of all blocks together, for run.json."""
    if not summaries:
        return
    assert run.inputs.vertical is not None
    state = run.state
    digests = np.concatenate([summary.cloud_digest for summary in summaries])
    state.clouds[run.inputs.vertical.lidar.topic] = joined([digests.tobytes()]).hex()
    reasons = [reason for summary in summaries for reason in summary.skipped_reason]
    counts = np.sum([summary.label_counts for summary in summaries], axis=0)
    state.counts |= {
        "clouds": sum(block.count for block in blocks),
        "scans": sum(len(summary.scan) for summary in summaries),
        "skipped": {reason: reasons.count(reason) for reason in sorted(set(reasons))},
        "returns": {label.name.lower(): int(counts[label]) for label in Label},
    }
    milliseconds = np.concatenate([summary.milliseconds for summary in summaries])
    if len(milliseconds):
        by_stage = dict(zip(STAGES, milliseconds.T, strict=True))
        for name, own in by_stage.items():
            state.timings_s[f"{name}_per_scan"] = float(np.median(own)) / 1e3
        state.statistics = {"milliseconds_per_cloud": _spread(by_stage["smoothing"] + by_stage["labelling"])}
        for name in ("points_in_cloud", "points_in_lines"):
            state.statistics[name] = _spread(np.concatenate([getattr(s, name) for s in summaries]).astype(np.float64))
    if reasons:
        state.warnings.append(f"{len(reasons)} vertical clouds skipped: {commonest(reasons)}")
    beyond = np.concatenate([summary.beyond_range for summary in summaries])
    if beyond.any():
        state.counts["beyond_range"] = int(beyond.sum())
        run.warn(
            f"returns farther than {run.settings.scan.range_max_m:g} m away were left out (scan.range_max_m): "
            f"{beyond.sum():,}, in {np.count_nonzero(beyond):,} of {len(beyond):,} scans"
        )


def _spread(values: FloatArray) -> dict[str, float]:
    spread = {"mean": values.mean(), "standard_deviation": values.std(), "min": values.min(), "max": values.max()}
    return {name: float(value) for name, value in spread.items()}
