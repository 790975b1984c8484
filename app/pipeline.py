"""A run from the bag to the finished folder, stage by stage."""

import shutil
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.algorithms.base.votes import VoxelVotes, fuse
from ffmap.algorithms.building.fusion import Building
from ffmap.algorithms.maps.all_maps import Maps, draw_maps
from ffmap.app.folder.cloud_file import write_ply
from ffmap.app.folder.names import CLOUD, TRAJECTORY
from ffmap.app.folder.record import RunRecord
from ffmap.app.folder.room_files import topology
from ffmap.app.interruption import interruption_alone
from ffmap.app.progress import Progress
from ffmap.app.record.building import log_cloud
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.run.building import fuse_all_scans, log_maps, write_maps
from ffmap.app.run.extrinsics import check_whole_drive, correct_extrinsics
from ffmap.app.run.final import relabel_scans
from ffmap.app.run.poses import estimate_poses
from ffmap.app.run.report import Report
from ffmap.app.run.scans import label_scans
from ffmap.app.run.start import Run
from ffmap.app.run.workers import WorkerLostError, run_executor
from ffmap.app.setup.outputs import Output
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import write_tum

_FREE_MIN_BYTES = 2_000_000_000
INTERRUPTED = 130
"""Exit code of a program that Ctrl-C has ended."""


def map_building(run: Run, executor: Executor, report: Report) -> None:
    """Run all stages."""
    with report.stage("mounts"):
        inputs = correct_extrinsics(run, report)
        run = replace(run, inputs=inputs)
    report.log_start(inputs)
    with report.stage("odometry"):
        poses = estimate_poses(inputs, run.given, run.settings, run.fingerprint, report)
        check_whole_drive(run, poses.trajectory, report)
    # A resumed run needs the extrinsics and the fingerprint.
    report.add(bag=run.record.bag.model_copy(update={"digest": run.fingerprint()}))
    report.write()
    if not inputs.verticals:
        trajectory = poses.trajectory
        write_tum(run.folder / TRAJECTORY, trajectory)
        if report.log:
            log_trajectory(report.log, trajectory.stamp_ns, trajectory.T_map_base, None)
        return
    with report.stage("scans"):
        labelled = label_scans(run, poses, executor, report)
    with report.stage("building"):
        building, evidence = fuse_all_scans(run, labelled, poses.trajectory, report)
    with report.stage("final"):
        votes = relabel_scans(run, labelled, building, poses.trajectory, executor, report)
    with report.stage("maps"):
        maps = draw_maps(building, evidence, run.settings.maps)
    # Scans of two lidars that fire together have one pose.
    stamps_ns = np.unique(labelled.stamps_ns)
    write_tum(run.folder / TRAJECTORY, Trajectory(stamps_ns, poses.trajectory.at(stamps_ns)))
    _save(run, building, votes, maps, report)


def carry_out(run: Run) -> RunRecord:
    """Run all stages, and write the run folder. Returns the content of run.json.

    Raises InputError where the bag has no usable cloud; run.json is written all the same.
    """
    options, folder = run.options, run.folder
    resume = f"'ffmap run --resume {folder}' continues the run"
    with interruptible(resume), Progress(options.quiet) as progress:
        for warning in (*run.inputs.warnings, *_little_space(folder)):
            progress.warn(warning)
        report = Report(run, progress)
        report.add(outcome="running")
        report.write()
        run.spool.mkdir(exist_ok=True)
        try:
            report.open_recording()
            needed = [*run.inputs.bag_path.parts, folder]
            with (
                run_executor(options.workers, options.scheduler, needed, progress.say) as executor,
                interruption_alone(),
            ):
                map_building(run, executor, report)
            report.finish("complete")
        except BaseException:
            # The user has to see what ended the run, not what follows from it.
            with suppress(Exception):
                report.finish("aborted")
            raise
    shutil.rmtree(run.spool, ignore_errors=True)
    return report.record


def _save(run: Run, building: Building, votes: VoxelVotes, maps: Maps, report: Report) -> None:
    """Write and record maps and cloud. votes: final labels by voxel."""
    write_maps(run, building, maps)
    log_maps(maps, report)
    cloud = fuse(votes)
    if Output.CLOUD in run.options.outputs:
        colours = np.array([entities.CLASSES[label][1] for label in Label], np.uint8)
        write_ply(run.folder / CLOUD, cloud, colours[cloud.label])
    if report.log:
        log_cloud(report.log, cloud.points_map, cloud.label)
    report.count(
        walls=len(building.model.walls),
        refused_walls=len(building.model.judged.refused),
        doors=len(building.model.doors),
        rooms=len(maps.rooms),
        cloud_points=len(cloud),
    )
    report.add(topology=topology(maps.rooms))


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
        typer.echo(f"ffmap: interrupted; {continuation}", err=True)
        raise SystemExit(INTERRUPTED) from None
