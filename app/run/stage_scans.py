"""Stage 2 of a run: every scan is labelled, block by block, by the worker processes (paper, III), and placed in the map.

A scan's labels owe nothing to where it lies in the map: they are found while others are still registered, and the scan moves
as one when the last loop is closed.
"""

from collections import deque
from concurrent.futures import Executor, Future
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory, level_frame
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.maps.rivals import Rival
from ffmap.app.record.building import log_map_block
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.scans import log_frames, log_metrics
from ffmap.app.run.blocks import STAGES, VOXEL_M, Block, LabelJob, PlaceJob, label_block, place_block, split_blocks
from ffmap.app.run.context import Run
from ffmap.app.run.poses import KnownPoses, RunPoses
from ffmap.app.run.spool import FINAL, PLACED, RIVALS, SUMMARY, VOTES, BlockSummary, load
from ffmap.app.setup.inputs import commonest
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import InputError

_BLOCKS_TOGETHER = 10
"""Blocks whose metrics are recorded together where no viewer waits for them: the recording's index has a line for each portion
of each of its entities.
"""
_REASONS_TOLD = 5
"""Number of skipped clouds that are told one by one while the run goes on."""


@dataclass(frozen=True)
class LabelledScans:
    """jobs: of every block. scan, stamps_ns: (s,) number and stamp of each labelled scan.

    votes: what the scans' own labels say of each cube of the map. rivals: what the paper's other maps are drawn from.
    """

    jobs: tuple[PlaceJob, ...]
    scan: IntArray
    stamps_ns: IntArray
    votes: VoxelVotes
    rivals: VoxelVotes


class Labeller:
    """Labels the scans of a run block by block, each as soon as its poses are known, and places them when all are final."""

    def __init__(self, run: Run, pool: Executor) -> None:
        self._run, self._pool, self._scans = run, pool, run.inputs.scans
        self._blocks = split_blocks(len(self._scans))
        self._jobs: list[LabelJob] = []
        self._running: deque[Future[BlockSummary] | BlockSummary] = deque()
        self._summaries: list[BlockSummary] = []
        self._unlogged: list[BlockSummary] = []

    def go_on(self, poses: KnownPoses) -> None:
        """Have blocks labelled whose poses are known, and record those that are labelled, in the order of time."""
        self._submit(poses)
        while self._running and (isinstance(self._running[0], BlockSummary) or self._running[0].done()):
            self._take()

    def finish(self, poses: RunPoses) -> LabelledScans:
        """Label what is left, and place all scans. Raises InputError where none could be labelled."""
        run = self._run
        run.progress.stage("scans", 2 * len(self._blocks) or None)
        self._submit(poses.known)
        for _ in self._summaries:
            run.progress.advance()
        while self._running:
            self._take()
            run.progress.advance()
        self._log_metrics()
        _summarise(run, self._blocks, self._summaries)
        none = [np.zeros(0, np.int64)]
        scan = np.concatenate(none + [summary.scan for summary in self._summaries])
        stamps_ns = np.concatenate(none + [summary.stamp_ns for summary in self._summaries])
        if not len(stamps_ns):
            why = commonest([reason for summary in self._summaries for reason in summary.skipped_reason])
            topics = [sensor.lidar.topic for sensor in run.inputs.verticals]
            have = f"{' and '.join(topics)} {'have' if len(topics) > 1 else 'has'}"
            raise InputError(
                f"{run.inputs.bag_path}: {have} no usable cloud ({why}); 'ffmap info' tells more"
            )
        votes, rivals = VoxelTable(VOXEL_M, len(Label)), VoxelTable(run.settings.grid_map.cell_m, len(Rival))
        jobs = tuple(self._place_job(*labelled, poses) for labelled in zip(self._jobs, self._summaries, strict=True))
        placing = [self._place(job) for job in jobs]
        last_T_map_base: FloatArray | None = None
        for job, summary, placed in zip(jobs, self._summaries, placing, strict=True):
            if placed is not None:
                placed.result()
            path = job.label.path.with_suffix(PLACED)
            own_votes = load(VoxelVotes, path, VOTES)
            new = votes.absorb(own_votes)
            rivals.absorb(load(VoxelVotes, path, RIVALS))
            if run.log and len(summary.scan):
                T_map_base = poses.trajectory.at(summary.stamp_ns)
                log_trajectory(run.log, summary.stamp_ns, T_map_base, summary.scan, last_T_map_base)
                last_T_map_base = T_map_base[-1]
                log_frames(run.log, summary.stamp_ns, summary.scan, job.T_map_level, summary.T_level_base)
                points, label = own_votes.mean_position[new].astype(np.float32), majority(own_votes.counts[new])
                log_map_block(run.log, int(summary.scan[-1]), int(summary.stamp_ns[-1]), points, label)
            run.progress.advance()
        if run.recording is not None:
            run.recording.cut()
        return LabelledScans(jobs, scan, stamps_ns, votes.votes(), rivals.votes())

    def _submit(self, poses: KnownPoses) -> None:
        """Hand out the blocks whose poses are known; what a run that is resumed has labelled is not labelled again."""
        # Before all clouds were registered nothing told whether they are still the same.
        may_be_done = self._run.resumed and (poses.complete or bool(self._run.record["bag"].get("clouds")))
        while len(self._jobs) < len(self._blocks):
            block = self._blocks[len(self._jobs)]
            trajectory = poses.around(self._scans.stamp_ns[block.first : block.first + block.count])
            if trajectory is None:
                return
            job = self._label_job(block, trajectory, poses)
            self._jobs.append(job)
            labelled = job.path.with_suffix(".arrow")
            has_evidence = job.detail is None or job.path.with_suffix(".rrd").exists()
            if may_be_done and labelled.exists() and has_evidence:
                self._running.append(load(BlockSummary, labelled, SUMMARY))
            else:
                for later in (PLACED, FINAL):
                    job.path.with_suffix(later).unlink(missing_ok=True)
                self._running.append(self._pool.submit(label_block, job))

    def _take(self) -> None:
        """Wait for the first block that is being labelled, and record it."""
        run, running = self._run, self._running.popleft()
        summary = running if isinstance(running, BlockSummary) else running.result()
        _tell_skipped(run, summary, sum(len(earlier.skipped_reason) for earlier in self._summaries))
        if run.recording and len(summary.scan):
            run.recording.add(self._jobs[len(self._summaries)].path.with_suffix(".rrd"))
        self._summaries.append(summary)
        run.keep_failed([s for each in self._summaries for s in each.failed], len(self._scans), "labelling")
        self._unlogged.append(summary)
        if len(self._unlogged) >= (_BLOCKS_TOGETHER if run.options.connect is None else 1):
            self._log_metrics()

    def _log_metrics(self) -> None:
        """Record the metrics of the blocks that were taken since the last time."""
        blocks, self._unlogged = self._unlogged, []
        if self._run.log is not None and blocks:
            stamp_ns, scan, metrics = (
                np.concatenate([getattr(block, name) for block in blocks]) for name in ("stamp_ns", "scan", "metrics")
            )
            log_metrics(self._run.log, stamp_ns, scan, metrics)

    def _place(self, job: PlaceJob) -> Future[None] | None:
        """The work on a block; None where a run that is resumed has done it."""
        done = self._run.resumed and job.label.path.with_suffix(PLACED).exists()
        return None if done else self._pool.submit(place_block, job)

    def _label_job(self, block: Block, trajectory: Trajectory, poses: KnownPoses) -> LabelJob:
        run = self._run
        return LabelJob(
            block=block,
            inputs=run.inputs,
            trajectory=trajectory,
            base_height_m=poses.base_height_m,
            floor_slope=poses.floor_slope,
            settings=run.settings,
            recording_id=run.record["recording_id"],
            detail=run.options.detail if run.log else None,
            path=run.folder.block(block.number, ""),
        )

    def _place_job(self, job: LabelJob, summary: BlockSummary, poses: RunPoses) -> PlaceJob:
        T_map_base = poses.trajectory.at(summary.reference_ns)
        T_map_level = np.array([level_frame(T, poses.base_height_m) for T in T_map_base]).reshape(-1, 4, 4)
        return PlaceJob(job, T_map_level)


def _tell_skipped(run: Run, summary: BlockSummary, told: int) -> None:
    untold = max(0, _REASONS_TOLD - told)
    for index, reason in list(zip(summary.skipped_scan.tolist(), summary.skipped_reason, strict=True))[:untold]:
        run.progress.warn(f"scan {index} skipped: {reason}")


def _summarise(run: Run, blocks: list[Block], summaries: list[BlockSummary]) -> None:
    """Counts, timings and sizes of all blocks together, for run.json."""
    if not summaries:
        return
    state = run.state
    digests, lidar = (np.concatenate([getattr(s, name) for s in summaries]) for name in ("cloud_digest", "digest_lidar"))
    for place, sensor in enumerate(run.inputs.verticals):
        state.clouds[sensor.lidar.topic] = joined([digests[lidar == place].tobytes()]).hex()
    reasons = [reason for summary in summaries for reason in summary.skipped_reason]
    counts = np.sum([summary.label_counts for summary in summaries], axis=0)
    state.counts |= {
        "clouds": sum(block.count for block in blocks),
        "scans": sum(len(summary.scan) for summary in summaries),
        **_scans_by_topic(run, summaries),
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
    rejected_m, scan = (np.concatenate([getattr(s, name) for s in summaries]) for name in ("rejected_m", "scan"))
    if rejected_m.any():
        scans, off_m = scan[rejected_m != 0], float(np.median(rejected_m[rejected_m != 0]))
        run.warn(
            f"{len(scans):,} of the scans {scans[0]} to {scans[-1]} show more ground {100 * abs(off_m):.0f} cm "
            f"{'below' if off_m < 0 else 'above'} the floor under the robot than at its height, as outside a window; it was not "
            f"taken for the floor. 'ffmap inspect {run.folder.path} --scan {scans[0]}' shows it"
        )


def _scans_by_topic(run: Run, summaries: list[BlockSummary]) -> dict[str, dict[str, int]]:
    """How many scans of each lidar were labelled, where there are several."""
    if len(run.inputs.verticals) < 2:
        return {}
    scans = np.concatenate([summary.scan for summary in summaries])
    counts = np.bincount(run.inputs.scans.lidar[scans], minlength=len(run.inputs.verticals))
    topics = [sensor.lidar.topic for sensor in run.inputs.verticals]
    return {"scans_by_topic": dict(zip(topics, counts.tolist(), strict=True))}


def _spread(values: FloatArray) -> dict[str, float]:
    spread = {"mean": values.mean(), "standard_deviation": values.std(), "min": values.min(), "max": values.max()}
    return {name: float(value) for name, value in spread.items()}
