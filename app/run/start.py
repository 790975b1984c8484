"""Prepare a run, new or resumed: find and check everything that it needs."""

import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from threading import Thread

from ffmap.app.folder import run_folder
from ffmap.app.folder.names import RUN_JSON, SPOOL
from ffmap.app.folder.record import (
    FROM_ODOMETRY,
    PROGRAM,
    BagEntry,
    LidarEntry,
    RunRecord,
    read_record,
)
from ffmap.app.record.stream import check_viewer, start_viewer
from ffmap.app.run.given_poses import GivenPoses, given_poses
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings, validate
from ffmap.app.setup.versions import versions
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_checks import clock_problem
from ffmap.loaders.errors import InputError
from ffmap.loaders.fingerprint import fingerprint
from ffmap.loaders.rig import Lidar, MountCorrection

_MARGIN_NS = 1_000_000_000
"""Maximum time (ns) of a vertical cloud before or after those of the horizontal lidar."""


@dataclass(frozen=True)
class Run:
    """Everything that a run is made from; its folder is locked.

    given: poses in place of the odometry. record: the content of run.json at the start.
    resumed: whether the folder may contain blocks of an earlier start.
    fingerprint: waits for that of the bag.
    """

    inputs: Inputs
    given: GivenPoses | None
    settings: Settings
    options: RunOptions
    folder: Path
    record: RunRecord
    resumed: bool
    fingerprint: Callable[[], str]

    @property
    def spool(self) -> Path:
        """The folder of finished blocks; removed when the run is complete."""
        return self.folder / SPOOL


@contextmanager
def new_run(
    bag: BagPath, settings: Settings, options: RunOptions, out: Path | None, overwrite: bool
) -> Iterator[Run]:
    """Prepare a new run. out: None for a new folder. overwrite: whether to replace an earlier run.

    Raises InputError for what the user can correct; an earlier run is still complete then.
    """
    inputs, given = _find(bag, options, settings)
    started = f"{datetime.now():%Y%m%d-%H%M%S}"
    folder = out or Path("runs") / f"{bag.stem}-{started}-{settings.short_hash()}"
    if options.scheduler is not None:
        # Processes of a cluster work in other folders.
        folder = folder.resolve()
    named = (*bag.parts, options.rig, options.trajectory)
    read = [Path(name) for name in named if name is not None and Path(name).exists()]
    run_folder.create(folder, overwrite, read)
    with run_folder.held(folder):
        options = _with_viewer(options)
        run_folder.clear(folder)
        record = _first_record(inputs, given, settings, options)
        digest = _hash_in_background(inputs.bag_path)
        yield Run(inputs, given, settings, options, folder, record, False, digest)


@contextmanager
def resumed_run(folder: Path, now: RunOptions) -> Iterator[Run | None]:
    """Prepare a run that was killed, as it was started; None where it is complete.

    now: options that run.json does not contain.
    """
    read_record(folder)
    folder = folder if now.scheduler is None else folder.resolve()
    with run_folder.held(folder):
        record = read_record(folder)
        if record.outcome == "complete":
            yield None
            return
        bag, settings = _as_started(folder, record)
        options, mounts = record.options.resumed_with(now), record.mount_corrections
        inputs, given = _find(bag, options, settings, mounts)
        if mounts:
            # They were refined before.
            options = options.model_copy(update={"mount": "as-given"})
        digest = _hash_in_background(inputs.bag_path)
        if record.bag.digest not in (None, digest()):
            raise InputError(
                f"{inputs.bag_path}: is not the bag that {folder} was started with; start a new run"
            )
        options = _with_viewer(options)
        yield Run(inputs, given, settings, options, folder, record, True, digest)


def _hash_in_background(bag: BagPath) -> Callable[[], str]:
    """Compute the fingerprint of a bag in a thread, while the odometry starts.

    An interrupted program does not wait for the thread.
    """
    future: Future[str] = Future()

    def work() -> None:
        try:
            future.set_result(fingerprint(bag))
        except Exception as error:
            future.set_exception(error)

    Thread(target=work, daemon=True).start()
    return future.result


def _find(
    bag: BagPath, options: RunOptions, settings: Settings, mounts: Sequence[MountCorrection] = ()
) -> tuple[Inputs, GivenPoses | None]:
    """Find the lidars of the bag, and the poses that are given, if any."""
    inputs = find_inputs(bag, options, mounts, settings.scan.own_body)
    given = given_poses(options.trajectory, inputs, settings, options.trajectory_frame)
    if given is None:
        check_lidars_meet(inputs)
        return inputs, None
    return replace(inputs, warnings=(*inputs.warnings, *given.warnings)), given


def check_lidars_meet(inputs: Inputs) -> None:
    """Raise InputError where a vertical lidar has no cloud in the time of the horizontal one."""
    if inputs.horizontal is None:
        return
    horizontal = inputs.horizontal.index.stamp_ns[inputs.horizontal.index.usable]
    first_ns, last_ns = horizontal[0] - _MARGIN_NS, horizontal[-1] + _MARGIN_NS
    for sensor in inputs.verticals:
        vertical = sensor.index.stamp_ns[sensor.index.usable]
        if not ((vertical >= first_ns) & (vertical <= last_ns)).any():
            problem = clock_problem(inputs.horizontal.index, sensor.index)
            raise InputError(f"{inputs.bag_path}: no vertical cloud has a pose: {problem}")


def _first_record(
    inputs: Inputs, given: GivenPoses | None, settings: Settings, options: RunOptions
) -> RunRecord:
    """Create the content of run.json at the start: everything that the run is made from."""
    record = RunRecord(
        program=PROGRAM,
        recording_id=str(uuid.uuid4()),
        started=time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        bag=BagEntry.of(inputs.bag_path, inputs.container),
        base_frame=inputs.rig.base_frame,
        mounts_from=inputs.rig.mounts_from,
        rig={role: _lidar_entry(sensor.lidar) for role, sensor in inputs.by_role.items()},
        poses_from=options.trajectory or FROM_ODOMETRY,
        settings_hash=settings.short_hash(),
        settings=settings.model_dump(mode="json"),
        options=options.with_digests(),
        versions=versions(),
    )
    if given is None:
        return record
    origin = tuple(given.origin_m.tolist())
    return record.model_copy(update={"map_origin": origin, "poses_frame": given.frame})


def _lidar_entry(lidar: Lidar) -> LidarEntry:
    body = lidar.decoding.own_body
    share = None if body is None else round(body.share, 5)
    return LidarEntry(
        topic=lidar.topic, frame=lidar.frame_id, why=lidar.reasons, own_body_share=share
    )


def _with_viewer(options: RunOptions) -> RunOptions:
    """Start the viewer, or check the named one."""
    try:
        if options.spawn:
            return options.model_copy(update={"connect": start_viewer()})
        if options.connect is not None:
            check_viewer(options.connect)
        return options
    except ConnectionError as error:
        raise InputError(f"--connect: {error}; start a viewer first, or omit --connect") from error
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Omit it: recording.rrd can be opened later") from error


def _as_started(folder: Path, record: RunRecord) -> tuple[BagPath, Settings]:
    """Return bag and settings of a killed run. Raises InputError where anything has changed."""
    bag, options, now = record.bag.bag_path, record.options, versions()
    if bag is None or not record.settings:
        raise InputError(f"{folder / RUN_JSON}: lacks the bag or the settings; start a new run")
    if bag.missing is not None:
        raise InputError(
            f"{bag.missing}: the bag of the run is missing; bring it back, or start a new run"
        )
    program = ("furniture-free-mapping", "git_revision")
    if any(record.versions.get(name) != now[name] for name in program):
        raise InputError(
            f"{folder}: was started by another version of ffmap, whose labels may differ; start a "
            "new run"
        )
    if options.with_digests().digests != options.digests:
        files = " or ".join(str(f) for f in (options.rig, options.trajectory) if f is not None)
        raise InputError(
            f"{files}: is not what {folder} was started with, or is missing; bring that back, or "
            "start a new run"
        )
    return bag, validate(record.settings, str(folder / RUN_JSON))
