"""A run from beginning to end: mounts, odometry, scans, building, final.

Scans are labelled while others are still registered, and placed in the map once all poses are final: the last loop of a drive
may move the first scan.
"""

import shutil
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.finished_run import FROM_ODOMETRY
from ffmap.app.folder.names import PROGRAM, RECORDING, TRAJECTORY, RunFolder, written_files
from ffmap.app.folder.record import bag_entry
from ffmap.app.progress import Progress
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.stream import Recording, send_properties
from ffmap.app.record.whole_run import layout, log_own_body, log_static, log_warnings
from ffmap.app.run.context import Run, RunState
from ffmap.app.run.stage_building import build, draw, take_maps
from ffmap.app.run.stage_final import finish
from ffmap.app.run.stage_mounts import check_whole_drive, settle_mounts
from ffmap.app.run.stage_odometry import find_poses
from ffmap.app.run.stage_scans import Labeller
from ffmap.app.run.workers import make_pool
from ffmap.app.setup.inputs import Inputs, digest_stamps
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Output
from ffmap.app.setup.settings import Settings
from ffmap.app.setup.versions import versions
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError
from ffmap.loaders.trajectory_file import write_tum


def run(
    inputs: Inputs,
    given: Trajectory | None,
    settings: Settings,
    options: RunOptions,
    folder: RunFolder,
    progress: Progress,
    record: dict[str, Any],
    resumed: bool = False,
) -> dict[str, Any]:
    """Run everything and write the run folder; returns what run.json holds.

    given: T_map_base in place of the odometry, or None. record: what run.json holds at the start; its `recording_id`
    names the recording. resumed: whether results of an earlier start may be in the folder.
    Raises InputError where the bag has no usable cloud.
    """
    worked = time.process_time()
    state = RunState(warnings=list(inputs.warnings))
    folder.write_json({**record, "outcome": "running"})
    recording: Recording | None = None
    log: Log | None = None
    try:
        recording = _open(inputs, options, folder, record, progress)
        scan_stamps_ns = inputs.scans.stamp_ns if inputs.verticals else None
        log = Log(recording.stream, options.detail, scan_stamps_ns=scan_stamps_ns) if recording else None
        run = Run(
            inputs, settings, options, folder, progress, record, recording, log, state, resumed
        )
        _run_stages(run, given)
        if options.workers == 1:
            # All of it was this process's work, whatever else the machine was busy with.
            state.timings_s["cpu"] = time.process_time() - worked
        _log_result(log, record, state, "complete")
        if recording is not None:
            recording.finish()
    except BaseException:
        folder.write_json({**record, **state.gathered(record), "outcome": "aborted"})
        # What ended the run is what the user has to hear of.
        with suppress(Exception):
            _log_result(log, record, state, "aborted")
        with suppress(Exception):
            if recording is not None:
                recording.finish(parts_stay=True)
        raise
    record = {**record, **state.gathered(record), "files": written_files(folder), "outcome": "complete"}
    folder.write_json(record)
    shutil.rmtree(folder.spool, ignore_errors=True)
    return record


def _run_stages(run: Run, given: Trajectory | None) -> None:
    if given is None:
        with run.stage("mounts"):
            run = settle_mounts(run)
    _log_start(run)
    with _pool(run) as pool:
        try:
            with run.stage("odometry"):
                labeller = Labeller(run, pool) if run.inputs.verticals else None
                poses = find_poses(run, given, labeller)
                check_whole_drive(run, poses.trajectory)
            # Before any scan is labelled with these poses, so that a run that is resumed knows what they were made from.
            run.folder.write_json({**run.record, "bag": run.state.bag_as_read(run.record), "outcome": "running"})
            if labeller is None:
                _keep_trajectory(run, poses.trajectory)
                return
            with run.stage("scans"):
                scans = labeller.finish(poses)
            _write_trajectory(run, poses.trajectory, scans.stamps_ns)
            with run.stage("building"):
                building, gathered = build(run, scans, poses.trajectory)
            with run.stage("final"), ThreadPoolExecutor(1) as beside:
                # No label asks the maps.
                drawing = beside.submit(draw, run, building, gathered)
                finish(run, pool, scans.jobs, building, poses.trajectory)
                take_maps(run, drawing.result())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextmanager
def _pool(run: Run) -> Iterator[Executor]:
    """Who labels: processes here, or those of a cluster."""
    if run.options.scheduler is None:
        with make_pool(run.options.workers) as pool:
            yield pool
        return
    from ffmap.app.run.cluster import connect

    with connect(run.options.scheduler, [*run.inputs.bag_path.parts, run.folder.path]) as cluster:
        run.progress.say(f"cluster: {cluster.slots} blocks of scans at once")
        yield cluster.executor


def _open(
    inputs: Inputs, options: RunOptions, folder: RunFolder, record: dict[str, Any], progress: Progress
) -> Recording | None:
    """The run's recording; None where none is wanted. Raises InputError where the viewer has gone."""
    save = Output.RECORDING in options.outputs
    if not save and options.connect is None:
        return None
    try:
        return Recording(
            folder.path / RECORDING if save else None,
            folder.spool,
            record["recording_id"],
            layout(inputs.line_pairs, options.detail, record, several_lidars=len(inputs.verticals) > 1),
            options.connect,
            progress.say,
        )
    except ConnectionError as error:
        raise InputError(
            f"{error}: the viewer has ended; is there a display? Leave --spawn or --connect out: the recording can be opened later"
        ) from error


def _sensors(run: Run) -> dict[str, FloatArray]:
    """T_base_sensor of each lidar by its role."""
    return {role: sensor.lidar.T_base_sensor for role, sensor in run.inputs.by_role.items()}


def _log_start(run: Run) -> None:
    if run.log is None or run.recording is None:
        return
    slope_max = run.settings.vertical_structures.slope_max
    log_static(run.log, _sensors(run), entities.explain(run.record), run.inputs.line_pairs, slope_max)
    for role, sensor in run.inputs.by_role.items():
        if (body := sensor.lidar.decoding.own_body) is not None:
            log_own_body(run.log, role, body)
    send_properties(run.log.stream, "settings", run.settings.model_dump(mode="json"))
    told = ("settings_hash", "bag", "versions", "started")
    send_properties(run.log.stream, "run", {name: run.record[name] for name in told if name in run.record})
    # A viewer shows what the views are while the first scans are registered.
    run.recording.cut()


_TOLD_ELSEWHERE = ("statistics", "warnings", "bag", "tracebacks")
"""Among the metrics, as a text, and among the properties of the run."""


def _log_result(log: Log | None, record: dict[str, Any], state: RunState, outcome: str) -> None:
    """As properties, which a list of runs asks for."""
    if log is not None:
        gathered = state.gathered(record)
        result = {name: value for name, value in gathered.items() if name not in _TOLD_ELSEWHERE}
        digest = gathered["bag"].get("digest")
        send_properties(log.stream, "result", {**result, "bag_digest": digest, "outcome": outcome})
        log_warnings(log, state.warnings)


def _write_trajectory(run: Run, trajectory: Trajectory, stamps_ns: IntArray) -> None:
    # Scans of two lidars that fire together have one pose.
    stamps_ns = np.unique(stamps_ns)
    write_tum(run.folder.path / TRAJECTORY, Trajectory(stamps_ns, trajectory.at(stamps_ns)))


def _keep_trajectory(run: Run, trajectory: Trajectory) -> None:
    """All that a drive without a vertical lidar comes to."""
    _write_trajectory(run, trajectory, trajectory.stamp_ns)
    if run.log:
        log_trajectory(run.log, trajectory.stamp_ns, trajectory.T_map_base, None)


def first_record(
    inputs: Inputs, settings: Settings, options: RunOptions
) -> dict[str, Any]:
    """What run.json holds from the start: everything that the run is made from."""
    return {
        "program": PROGRAM,
        "recording_id": str(uuid.uuid4()),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "bag": {
            **bag_entry(inputs.bag_path),
            "container": inputs.container,
            "stamps": digest_stamps(inputs.used(options.trajectory is not None)),
        },
        "base_frame": inputs.rig.base_frame,
        "mounts_from": inputs.rig.mounts_from,
        "rig": {
            role: {"topic": s.lidar.topic, "frame": s.lidar.frame_id, "why": s.lidar.reasons}
            | ({} if (body := s.lidar.decoding.own_body) is None else {"own_body_share": round(body.share, 5)})
            for role, s in inputs.by_role.items()
        },
        "poses_from": options.trajectory or FROM_ODOMETRY,
        "settings_hash": settings.short_hash(),
        "settings": settings.model_dump(mode="json"),
        "options": options.stored(),
        "versions": versions(),
    }
