"""A run from the bag to the finished folder, stage by stage."""

import shutil
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.building.votes import fuse
from ffmap.algorithms.maps.all_maps import Maps, draw_maps
from ffmap.app.folder.cloud_file import write_ply
from ffmap.app.folder.names import CLOUD, TRAJECTORY
from ffmap.app.folder.room_files import topology
from ffmap.app.progress import Progress
from ffmap.app.record.building import log_cloud
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.run.building import fuse_all_scans, log_maps, write_maps
from ffmap.app.run.extrinsics import check_whole_drive, correct_extrinsics
from ffmap.app.run.final import FinalLabels, relabel_scans
from ffmap.app.run.poses import RunPoses, estimate_poses
from ffmap.app.run.report import Report
from ffmap.app.run.scans import LabelledScans, label_scans
from ffmap.app.run.start import Run
from ffmap.app.run.workers import WorkerLostError, run_executor
from ffmap.app.setup.outputs import Output
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import write_tum

_FREE_MIN_BYTES = 2_000_000_000
INTERRUPTED = 130
"""Exit code of a program that Ctrl-C has ended."""


def map_building(run: Run, executor: Executor, report: Report) -> dict[str, Any]:
    """Run all stages. Returns the content of run.json, but for times and warnings."""
    with report.stage("mounts"):
        run = correct_extrinsics(run, report)
    report.log_start(run)
    with report.stage("odometry"):
        poses = estimate_poses(run.inputs, run.given, run.settings, run.fingerprint, report)
        check_whole_drive(run, poses.trajectory, report)
    run = _keep_start(run)
    if not run.inputs.verticals:
        return _save_trajectory(run, poses, report)
    with report.stage("scans"):
        labelled = label_scans(run, poses, executor, report)
    with report.stage("building"):
        building, evidence = fuse_all_scans(run, labelled, poses.trajectory, report)
    with report.stage("final"):
        final = relabel_scans(run, labelled, building, poses.trajectory, executor, report)
    with report.stage("maps"):
        maps = draw_maps(building, evidence, run.settings.maps)
    return _save(run, poses, labelled, building, final, maps, report)


def carry_out(run: Run) -> dict[str, Any]:
    """Run all stages, and write the run folder. Returns the content of run.json.

    Raises InputError where the bag has no usable cloud; run.json is written all the same.
    """
    started, cpu = time.perf_counter(), time.process_time()
    options, folder = run.options, run.folder
    report: Report | None = None

    def result_of(outcome: str) -> dict[str, Any]:
        seconds = dict(report.seconds) if report else {}
        seconds["total"] = time.perf_counter() - started
        if options.workers == 1 and options.scheduler is None:
            # All of it was the work of this process, whatever else the machine did.
            seconds["cpu"] = time.process_time() - cpu
        return {
            "timings_s": {name: round(value, 3) for name, value in seconds.items()},
            "warnings": report.warnings if report else [],
            "tracebacks": report.tracebacks if report else {},
            "outcome": outcome,
        }

    resume = f"'ffmap run --resume {folder.path}' continues the run"
    with interruptible(resume), Progress(options.quiet) as progress:
        for warning in (*run.inputs.warnings, *_little_space(folder.path)):
            progress.warn(warning)
        folder.write_json({**run.record, "outcome": "running"})
        try:
            report = Report(run, progress)
            needed = [*run.inputs.bag_path.parts, folder.path]
            with run_executor(options.workers, options.scheduler, needed, progress.say) as executor:
                record = map_building(run, executor, report)
            record |= result_of("complete")
            report.finish(record)
        except BaseException:
            aborted = {**folder.read_json(), **result_of("aborted")}
            folder.write_json(aborted)
            # The user has to see what ended the run.
            with suppress(Exception):
                if report is not None:
                    report.finish(aborted)
            raise
        record["files"] = folder.written_files()
        folder.write_json(record)
        shutil.rmtree(folder.spool, ignore_errors=True)
    return record


def _keep_start(run: Run) -> Run:
    """Write the extrinsics and the fingerprint of the bag to run.json: a resumed run needs them."""
    bag = {**run.record["bag"], "digest": run.fingerprint()}
    run = replace(run, record={**run.record, "bag": bag})
    run.folder.write_json({**run.record, "outcome": "running"})
    return run


def _save(
    run: Run,
    poses: RunPoses,
    labelled: LabelledScans,
    building: Building,
    final: FinalLabels,
    maps: Maps,
    report: Report,
) -> dict[str, Any]:
    """Write and record trajectory, maps and cloud. Returns the content of run.json."""
    # Scans of two lidars that fire together have one pose.
    stamps_ns = np.unique(labelled.stamps_ns)
    trajectory = Trajectory(stamps_ns, poses.trajectory.at(stamps_ns))
    write_tum(run.folder.path / TRAJECTORY, trajectory)
    write_maps(run, building, maps)
    log_maps(maps, report)
    cloud = fuse(final.votes)
    if Output.CLOUD in run.options.outputs:
        colours = np.array([entities.CLASSES[label][1] for label in Label], np.uint8)
        write_ply(run.folder.path / CLOUD, cloud, colours[cloud.label])
    if report.log:
        log_cloud(report.log, cloud.points_map, cloud.label)
    report.seconds |= labelled.seconds
    model = building.model
    counts = {
        **poses.counts,
        **labelled.counts,
        "walls": len(model.walls),
        "refused_walls": len(model.judged.refused),
        "doors": len(model.doors),
        "rooms": len(maps.rooms),
        "cloud_points": len(cloud),
    }
    return {
        **run.record,
        "counts": counts,
        "statistics": labelled.statistics,
        "odometry_cached": poses.cached,
        "labels_digest": final.digest,
        "topology": topology(maps.rooms),
    }


def _save_trajectory(run: Run, poses: RunPoses, report: Report) -> dict[str, Any]:
    """Write the only result of a drive without a vertical lidar."""
    trajectory = poses.trajectory
    write_tum(run.folder.path / TRAJECTORY, trajectory)
    if report.log:
        log_trajectory(report.log, trajectory.stamp_ns, trajectory.T_map_base, None)
    return {**run.record, "counts": poses.counts, "odometry_cached": poses.cached}


def _little_space(folder: Path) -> list[str]:
    """Warn if the disk has little free space."""
    free = shutil.disk_usage(folder).free
    if free >= _FREE_MIN_BYTES:
        return []
    return [
        f"{folder}: only {free / 1e9:.1f} GB are free on this disk; a minute of driving can take "
        "1 GB. Free some, or write less with --detail map and --outputs"
    ]


@contextmanager
def interruptible(continuation: str) -> Iterator[None]:
    """End with one line where the user interrupts, and where memory runs out."""
    try:
        yield
    except WorkerLostError as error:
        raise InputError(f"{error}; {continuation}") from None
    except MemoryError:
        raise InputError(
            f"memory ran out; free some, or use fewer --workers; {continuation}"
        ) from None
    except KeyboardInterrupt:
        # Unfinished objects complain when they are deleted.
        sys.unraisablehook = lambda _: None
        typer.echo(f"ffmap: interrupted; {continuation}", err=True)
        raise SystemExit(INTERRUPTED) from None
