"""From the user's options to a run that can begin, or go on: all it needs is found and checked."""

import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer

from ffmap.app.folder import names as run_folder
from ffmap.app.folder.finished_run import FROM_ODOMETRY, mount_corrections
from ffmap.app.folder.names import RunFolder
from ffmap.app.folder.record import bag_of
from ffmap.app.progress import Progress
from ffmap.app.record.stream import check_viewer, start_viewer
from ffmap.app.run import stages
from ffmap.app.run.blocks import holds_clouds_of, split_blocks
from ffmap.app.run.poses import GivenPoses, check_lidars_meet, given_poses
from ffmap.app.run.workers import WorkerLostError
from ffmap.app.setup.inputs import Inputs, digest_clouds, digest_stamps, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings, validate
from ffmap.app.setup.versions import versions
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.rig import MountCorrection

_FREE_MIN_BYTES = 2_000_000_000
INTERRUPTED = 130
"""The exit code of a program that Ctrl-C has ended."""


@dataclass(frozen=True)
class Ready:
    """A run that can begin: all that it needs was found and checked, and no other run gets at its folder.

    record: what run.json holds at its start.
    resumed: whether an earlier start has left results in its folder.
    """

    settings: Settings
    inputs: Inputs
    given: GivenPoses | None
    folder: RunFolder
    options: RunOptions
    record: dict[str, Any]
    resumed: bool


def make_ready(
    stack: ExitStack,
    bag: BagPath,
    settings: Settings,
    options: RunOptions,
    out: Path | None = None,
    overwrite: bool = False,
) -> Ready:
    """Prepare a new run.

    Args:
        stack: holds the run's folder until it is left.
        out: the run's folder; None for a new one.
        overwrite: whether a run that is in the folder already may be replaced.

    Raises InputError for what the user can mend.
    """
    inputs, given = _find(bag, options, settings)
    path = out or run_folder.default_path(inputs.bag_path, settings.short_hash())
    if options.scheduler is not None:
        # The processes of a cluster work in other folders.
        inputs, path = replace(inputs, bag_path=inputs.bag_path.resolve()), path.resolve()
    named = (*bag.parts, options.rig, options.trajectory)
    read = [Path(name) for name in named if name is not None and Path(name).exists()]
    folder = run_folder.create(path, overwrite, read)
    stack.enter_context(run_folder.held(path))
    options = _viewer(options)
    run_folder.clear(folder)
    record = stages.first_record(inputs, settings, options)
    if given is not None:
        record |= {"map_origin": given.origin_m.tolist(), "poses_frame": given.frame}
    return Ready(settings, inputs, given, folder, options, record, resumed=False)


def make_ready_again(stack: ExitStack, path: Path, now: RunOptions) -> Ready | None:
    """Prepare a run that was killed, as it was begun; None where it is complete.

    stack: as above. now: of these, what run.json does not keep.
    """
    path = path if now.scheduler is None else path.resolve()
    stack.enter_context(run_folder.held(path))
    folder = RunFolder(path)
    record = folder.read_json()
    if record.get("outcome") == "complete":
        typer.echo(f"{path} is complete already; nothing to resume")
        return None
    bag, options, settings = _as_begun(path, record)
    options, mounts = options.resumed_with(now), mount_corrections(record)
    inputs, given = _find(bag, options, settings, mounts)
    if mounts:
        # They were refined before.
        options = options.model_copy(update={"mount": "as-given"})
    if options.scheduler is not None:
        inputs = replace(inputs, bag_path=inputs.bag_path.resolve())
    _check_same_bag(inputs, folder, record)
    folder.spool.mkdir(exist_ok=True)
    options = _viewer(options)
    return Ready(settings, inputs, given, folder, options, record, resumed=True)


def _find(
    bag: BagPath, options: RunOptions, settings: Settings, mounts: Sequence[MountCorrection] = ()
) -> tuple[Inputs, GivenPoses | None]:
    """The bag's lidars, and the poses that were given, if any."""
    inputs = find_inputs(bag, options, mounts, settings.scan.own_body)
    given = given_poses(options.trajectory, inputs, settings, options.trajectory_frame)
    if given is None:
        check_lidars_meet(inputs)
        return inputs, None
    return replace(inputs, warnings=(*inputs.warnings, *given.warnings)), given


def carry_out(ready: Ready) -> dict[str, Any]:
    """Run all stages; returns what run.json then holds."""
    inputs = ready.inputs
    how_to_go_on = f"'ffmap run --resume {ready.folder.path}' goes on with the run"
    with interruptible(how_to_go_on), Progress(ready.options.quiet) as progress:
        for warning in (*inputs.warnings, *_little_space(ready.folder.path)):
            progress.warn(warning)
        trajectory = None if ready.given is None else ready.given.trajectory
        return stages.run(
            inputs,
            trajectory,
            ready.settings,
            ready.options,
            ready.folder,
            progress,
            ready.record,
            ready.resumed,
        )


def _little_space(folder: Path) -> list[str]:
    """A warning if the disk has little free space."""
    free = shutil.disk_usage(folder).free
    if free >= _FREE_MIN_BYTES:
        return []
    return [
        f"{folder}: only {free / 1e9:.1f} GB are free on this disk; a minute of driving can take 1 GB. Free some, or "
        "write less with --detail map and --outputs"
    ]


@contextmanager
def interruptible(how_to_go_on: str) -> Iterator[None]:
    """End with one line that says how to go on: where the user interrupts, and where memory runs out."""
    try:
        yield
    except WorkerLostError as error:
        raise InputError(f"{error}; {how_to_go_on}") from None
    except MemoryError:
        raise InputError(f"memory ran out; free some, or give fewer --workers; {how_to_go_on}") from None
    except KeyboardInterrupt:
        # What was interrupted while it was made complains when it goes.
        sys.unraisablehook = lambda _: None
        typer.echo(f"ffmap: interrupted; {how_to_go_on}", err=True)
        raise SystemExit(INTERRUPTED) from None


def _viewer(options: RunOptions) -> RunOptions:
    """Connect to the viewer that is started here, or check the one that was named."""
    try:
        if options.spawn:
            return options.model_copy(update={"connect": start_viewer()})
        if options.connect is not None:
            check_viewer(options.connect)
        return options
    except ConnectionError as error:
        raise InputError(f"--connect: {error}; start a viewer first, or leave --connect out") from error
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Leave it out: recording.rrd can be opened later") from error


def _check_same_bag(inputs: Inputs, folder: RunFolder, record: dict[str, Any]) -> None:
    """Raises InputError where a run was begun with other clouds than the bag holds now, be it by one byte."""
    used, known = inputs.used(record["poses_from"] != FROM_ODOMETRY), record["bag"].get("clouds", {})
    same = record["bag"]["stamps"] == digest_stamps(used)
    if same:
        clouds = digest_clouds(inputs.bag_path, [sensor for sensor in used if sensor.lidar.topic in known])
        same = all(clouds[topic] == digest for topic, digest in known.items())
    if same and any(sensor.lidar.topic not in known for sensor in inputs.verticals):
        # Where the odometry did not take them, not all clouds were read before the last block was finished.
        blocks = [(block, folder.block(block.number, ".arrow")) for block in split_blocks(len(inputs.scans))]
        with open_bag(inputs.bag_path) as bag:
            same = all(holds_clouds_of(path, block, inputs, bag) for block, path in blocks if path.exists())
    if not same:
        raise InputError(f"{inputs.bag_path}: is not the bag that {folder.path} was begun with; start a new run")


def _as_begun(path: Path, record: dict[str, Any]) -> tuple[BagPath, RunOptions, Settings]:
    """What a killed run was started with. record: what its run.json holds."""
    if lacking := [name for name in ("bag", "options", "settings") if not record.get(name)]:
        raise InputError(f"{path / run_folder.RUN_JSON}: lacks {lacking[0]}; start a new run")
    bag, options = bag_of(record), RunOptions.model_validate(record["options"])
    settings = validate(record["settings"], str(path / run_folder.RUN_JSON))
    if bag is None:
        raise InputError(f"{path / run_folder.RUN_JSON}: lacks the bag's path; start a new run")
    if bag.missing is not None:
        raise InputError(
            f"{bag.missing}: the run's bag is gone; bring it back, or start a new run"
        )
    begun, now = record.get("versions", {}), versions()
    if any(begun.get(name) != now[name] for name in ("furniture-free-mapping", "git_revision")):
        raise InputError(
            f"{path}: was begun by another version of ffmap, whose labels may differ; "
            "start a new run"
        )
    if options.stored()["digests"] != options.digests:
        files = " or ".join(str(f) for f in (options.rig, options.trajectory) if f is not None)
        raise InputError(
            f"{files}: is not what {path} was begun with, or is gone; bring that back, or start "
            "a new run"
        )
    return bag, options, settings
