"""Label all scans, block by block in worker processes, and count their labels by voxel."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import IntArray
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes, majority
from ffmap.algorithms.maps.rivals import Rival
from ffmap.app.record.building import log_map_block
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.scans import log_metrics
from ffmap.app.run.arrays import map_arrays, unpack
from ffmap.app.run.blocks import STAGES, VOXEL_M, Block, ScanFigures, label_block
from ffmap.app.run.poses import RunPoses
from ffmap.app.run.report import Report
from ffmap.app.run.start import Run
from ffmap.app.setup.inputs import commonest, counted
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan

SCANS_PER_BLOCK = 20


@dataclass(frozen=True)
class LabelledScans:
    """All labelled scans of a run.

    scan, stamps_ns: (s,) number and stamp of each. votes: labels by voxel of the map. rivals:
    returns that the maps of Fig. 6 and 9 are drawn from.
    """

    blocks: tuple[Block, ...]
    scan: IntArray
    stamps_ns: IntArray
    votes: VoxelVotes
    rivals: VoxelVotes


def label_scans(run: Run, poses: RunPoses, executor: Executor, report: Report) -> LabelledScans:
    """Label and place all scans. Raises InputError where none can be labelled."""
    blocks = split_blocks(run, poses, report.log is not None)
    order, cell_m = run.inputs.scans, run.settings.grid_map.cell_m
    report.progress.stage("scans", len(blocks) or None)
    votes, rivals = VoxelTable(VOXEL_M, len(Label)), VoxelTable(cell_m, len(Rival))
    scans: list[ScanFigures] = []
    skipped: list[SkippedScan] = []
    for block, labelled in zip(blocks, executor.map(label_block, blocks), strict=True):
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
        topics = " and ".join(sensor.lidar.topic for sensor in run.inputs.verticals)
        why = commonest([cloud.reason for cloud in skipped])
        raise InputError(
            f"{run.inputs.bag_path}: no usable cloud on {topics} ({why}); 'ffmap info' shows why"
        )
    numbers, stamps_ns = _column(scans, "scan"), _column(scans, "stamp_ns")
    if report.log:
        log_metrics(report.log, stamps_ns, numbers, _column(scans, "metrics"))
        log_trajectory(report.log, stamps_ns, poses.trajectory.at(stamps_ns), numbers)
        report.flush()
    report.count(**_counts(run, scans, skipped))
    _report_times(scans, report)
    _warn(run, scans, skipped, report)
    return LabelledScans(tuple(blocks), numbers, stamps_ns, votes.votes(), rivals.votes())


def split_blocks(run: Run, poses: RunPoses, recorded: bool) -> list[Block]:
    """Divide all scans into blocks. recorded: whether they are logged to a recording."""
    stamps_ns = run.inputs.scans.stamp_ns
    blocks = []
    for first in range(0, len(stamps_ns), SCANS_PER_BLOCK):
        own_ns = stamps_ns[first : first + SCANS_PER_BLOCK]
        blocks.append(
            Block(
                first=first,
                count=len(own_ns),
                inputs=run.inputs,
                settings=run.settings,
                poses=poses.around(own_ns),
                recording_id=run.record.recording_id,
                detail=run.options.detail if recorded else None,
                path=run.spool / f"{first:06d}",
                resumed=run.resumed,
            )
        )
    return blocks


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


def _report_times(scans: Sequence[ScanFigures], report: Report) -> None:
    """Report the median time of each stage of a scan, and Table I of the paper."""
    milliseconds = dict(zip(STAGES, _column(scans, "milliseconds").T, strict=True))
    medians = {name: float(np.median(values)) for name, values in milliseconds.items()}
    columns = {
        "milliseconds_per_cloud": milliseconds["smoothing"] + milliseconds["labelling"],
        "points_in_cloud": _column(scans, "cloud_size").astype(np.float64),
        "points_in_lines": _column(scans, "points_in_lines").astype(np.float64),
    }
    report.add(
        timings_s={f"{name}_per_scan": median / 1e3 for name, median in medians.items()},
        statistics={
            name: {
                "mean": float(values.mean()),
                "standard_deviation": float(values.std()),
                "min": float(values.min()),
                "max": float(values.max()),
            }
            for name, values in columns.items()
        },
    )


def _warn(
    run: Run, scans: Sequence[ScanFigures], skipped: Sequence[SkippedScan], report: Report
) -> None:
    if skipped:
        why = counted([cloud.reason for cloud in skipped])
        report.warn(f"{len(skipped)} vertical clouds skipped: {why}")
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
            f"'ffmap inspect {run.folder} --scan {first}' shows it"
        )
