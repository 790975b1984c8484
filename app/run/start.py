"""From the command line's words to a run that can begin, or go on: all that it needs found and checked."""

import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

import typer

from ffmap.app.folder import names as run_folder
from ffmap.app.folder.finished_run import FROM_ODOMETRY, mount_corrections, topics_said
from ffmap.app.folder.names import RunFolder
from ffmap.app.folder.record import bag_of
from ffmap.app.progress import Progress
from ffmap.app.record.stream import check_viewer, start_viewer
from ffmap.app.run import stages
from ffmap.app.run.blocks import holds_clouds_of, split_blocks
from ffmap.app.run.context import RunOptions
from ffmap.app.run.poses import GivenPoses, check_lidars_meet, given_poses
from ffmap.app.run.workers import WorkerLostError
from ffmap.app.setup.inputs import InputOptions, Inputs, digest_clouds, digest_stamps, find_inputs
from ffmap.app.setup.outputs import RUN_OUTPUTS, Detail, check_outputs
from ffmap.app.setup.settings import Settings, load_settings, validate
from ffmap.app.setup.versions import versions
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_digest import joined
from ffmap.loaders.errors import InputError
from ffmap.loaders.pointcloud2 import TimeFrom

_FREE_MIN_BYTES = 2_000_000_000
INTERRUPTED = 130
"""The exit code of a program that Ctrl-C has ended."""


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `ffmap.app.cli.Run`."""

    bag: BagPath | None
    out: Path | None = None
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    bag_options: InputOptions = field(default_factory=InputOptions)
    trajectory: str | None = None
    trajectory_frame: str | None = None
    """The frame that the poses are of; None to find it."""
    detail: str = "lines"
    spawn: bool = False
    connect: str | None = None
    outputs: tuple[str, ...] = RUN_OUTPUTS
    workers: int = 2
    scheduler: str | None = None
    """The address of a Dask cluster."""
    mount: str = "refine"
    evaluate: bool = True
    quiet: bool = False
    verbose: bool = False
    """Whether the figures are printed as tables too."""
    latest: bool = False
    """Whether `latest` beside the run folder is to point at it: not in a sweep, whose runs come in any order."""
    overwrite: bool = False
    """Whether a run that is in the folder already may be replaced."""


_OF_THE_BAG = tuple(option.name for option in fields(InputOptions) if option.name not in ("mounts", "own_body"))
_STORED = (*_OF_THE_BAG, "mount", "trajectory", "trajectory_frame", "detail", "outputs", "evaluate")
"""Arguments that run.json keeps, for a run that is resumed."""


@dataclass(frozen=True)
class Ready:
    """A run that can begin: all that it needs was found and checked, and no other run gets at its folder.

    home: where its results are to lie in the end. record: what run.json holds at its start.
    """

    arguments: Arguments
    settings: Settings
    inputs: Inputs
    given: GivenPoses | None
    home: Path
    folder: RunFolder
    options: RunOptions
    record: dict[str, Any]


def make_ready(arguments: Arguments, stack: ExitStack) -> Ready:
    """A new run; `stack` holds its folder until it is left. Raises InputError for what the user can mend."""
    if arguments.bag is None:
        raise InputError("give a bag, or --resume with a run folder; 'ffmap run --help' has examples")
    settings = load_settings(arguments.config, arguments.overrides)
    inputs, given = _find(arguments, arguments.bag, settings)
    home = arguments.out or run_folder.default_path(inputs.bag_path, settings.short_hash())
    if arguments.scheduler is not None:
        # The processes of a cluster work in other folders.
        inputs, home = replace(inputs, bag_path=inputs.bag_path.resolve()), home.resolve()
    options = _options(arguments)
    folder = run_folder.create(home, arguments.overwrite, _files_read(arguments))
    stack.enter_context(run_folder.held(home))
    options = replace(options, connect_url=_viewer(arguments))
    # A replacement that was killed when only its move was left is the earlier run now.
    run_folder.take_place_if_complete(home)
    run_folder.clear(folder)
    record = stages.first_record(inputs, settings, stored(arguments), arguments.trajectory)
    if given is not None:
        record |= {"map_origin": given.origin_m.tolist(), "poses_frame": given.frame}
    return Ready(arguments, settings, inputs, given, home, folder, options, record)


def make_ready_again(arguments: Arguments, resume: Path, stack: ExitStack) -> Ready | None:
    """A run that was killed, as it was begun; None where it is complete. stack: as above."""
    _check_resumable(arguments)
    resume = resume if arguments.scheduler is None else resume.resolve()
    stack.enter_context(run_folder.held(resume))
    folder = run_folder.unfinished(resume)
    record = folder.read_json()
    if record.get("outcome") == "complete":
        typer.echo(f"{run_folder.take_place(folder).path} is complete already; nothing to resume")
        return None
    arguments, settings = _as_begun(arguments, resume, record)
    assert arguments.bag is not None
    inputs, given = _find(arguments, arguments.bag, settings)
    if arguments.scheduler is not None:
        inputs = replace(inputs, bag_path=inputs.bag_path.resolve())
    options = replace(_options(arguments), resume=True)
    _check_same_bag(inputs, folder, record)
    folder.spool.mkdir(exist_ok=True)
    options = replace(options, connect_url=_viewer(arguments))
    return Ready(arguments, settings, inputs, given, resume, folder, options, record)


def _options(arguments: Arguments) -> RunOptions:
    outputs = check_outputs(arguments.outputs)
    return RunOptions(
        detail=Detail(arguments.detail),
        outputs=outputs,
        workers=arguments.workers,
        scheduler=arguments.scheduler,
        refine_mount=arguments.mount == "refine" and not arguments.bag_options.mounts,
    )


def _find(arguments: Arguments, bag: BagPath, settings: Settings) -> tuple[Inputs, GivenPoses | None]:
    """The bag's lidars, and the poses that were given, if any."""
    inputs = find_inputs(bag, replace(arguments.bag_options, own_body=settings.scan.own_body))
    frame = arguments.trajectory_frame
    given = given_poses(arguments.trajectory, inputs, settings, frame)
    if given is None:
        check_lidars_meet(inputs)
        return inputs, None
    return replace(inputs, warnings=(*inputs.warnings, *given.warnings)), given


def carry_out(ready: Ready) -> tuple[RunFolder, dict[str, Any]]:
    """Run all stages; returns the run's folder in its place, and what its run.json holds."""
    arguments, inputs = ready.arguments, ready.inputs
    how_to_go_on = f"'ffmap run --resume {ready.home}' goes on with the run"
    with interruptible(how_to_go_on), Progress(arguments.quiet) as progress:
        for warning in (*inputs.warnings, *_little_space(ready.folder.path)):
            progress.warn(warning)
        trajectory = None if ready.given is None else ready.given.trajectory
        record = stages.run(inputs, trajectory, ready.settings, ready.options, ready.folder, progress, ready.record)
        folder = run_folder.take_place(ready.folder)
    if arguments.latest:
        run_folder.point_latest_at(folder.path.resolve())
    return folder, record


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


def _viewer(arguments: Arguments) -> str | None:
    """Where a viewer listens: one that is started, or the one that was named."""
    try:
        if arguments.spawn:
            return start_viewer()
        if arguments.connect is not None:
            check_viewer(arguments.connect)
        return arguments.connect
    except ConnectionError as error:
        raise InputError(f"--connect: {error}; start a viewer first, or leave --connect out") from error
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Leave it out: recording.rrd can be opened later") from error


def stored(arguments: Arguments) -> dict[str, Any]:
    """What run.json keeps of the command line, with the digests of the rig's and the poses' file: either may be changed."""
    of_the_bag = {name: getattr(arguments.bag_options, name) for name in _OF_THE_BAG}
    values = {field.name: getattr(arguments, field.name) for field in fields(Arguments)} | of_the_bag
    stored = {name: values[name] for name in _STORED}
    stored["vertical"] = list(stored["vertical"]) or None
    if stored["rig"] is not None:
        stored["rig"] = str(stored["rig"].resolve())
    if arguments.trajectory is not None and Path(arguments.trajectory).exists():
        stored["trajectory"] = str(Path(arguments.trajectory).resolve())
    files = {name: Path(stored[name]) for name in ("rig", "trajectory") if stored[name] is not None}
    stored["digests"] = {name: joined([file.read_bytes()]).hex() for name, file in files.items() if file.is_file()}
    return stored


def _files_read(arguments: Arguments) -> list[Path]:
    """What the user has named to be read."""
    parts = arguments.bag.parts if arguments.bag is not None else ()
    named = (*parts, arguments.config, arguments.bag_options.rig, arguments.trajectory)
    return [Path(name) for name in named if name is not None and Path(name).exists()]


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


def _check_resumable(arguments: Arguments) -> None:
    given = (arguments.bag, arguments.out, arguments.config)
    if any(word is not None for word in given) or arguments.overrides or arguments.overwrite:
        raise InputError(
            "--resume goes on as the run was started: give no bag, --out, --config, --set or --overwrite with it"
        )


def _as_begun(arguments: Arguments, path: Path, record: dict[str, Any]) -> tuple[Arguments, Settings]:
    """What a killed run was started with. record: what its run.json holds."""
    try:
        options = {name: record["options"][name] for name in (*_STORED, "digests")}
        bag, settings = bag_of(record), validate(record["settings"], str(path / run_folder.RUN_JSON))
        if bag is None:
            raise KeyError("bag")
        if options["time_from"] not in get_args(TimeFrom):
            raise KeyError(options["time_from"])
        options["outputs"] = check_outputs(options["outputs"])
        digests = options.pop("digests")
        options["rig"] = Path(options["rig"]) if options["rig"] else None
        options["vertical"] = topics_said(options["vertical"])
    except KeyError as error:
        raise InputError(f"{path / run_folder.RUN_JSON}: lacks {error}; start a new run") from None
    except TypeError as error:
        raise InputError(f"{path / run_folder.RUN_JSON}: is not as ffmap wrote it ({error}); start a new run") from None
    if bag.missing is not None:
        raise InputError(f"{bag.missing}: the run's bag is gone; bring it back, or start a new run")
    begun, now = record.get("versions", {}), versions()
    if any(begun.get(name) != now[name] for name in ("furniture-free-mapping", "git_revision")):
        raise InputError(f"{path}: was begun by another version of ffmap, whose labels may differ; start a new run")
    mounts = mount_corrections(record)
    bag_options = InputOptions(**{name: options.pop(name) for name in _OF_THE_BAG}, mounts=mounts)
    begun_with = replace(arguments, bag=bag, bag_options=bag_options, **options)
    if stored(begun_with)["digests"] != digests:
        named = (bag_options.rig, begun_with.trajectory)
        files = " or ".join(str(file) for file in named if file is not None)
        raise InputError(f"{files}: is not what {path} was begun with, or is gone; bring that back, or start a new run")
    return begun_with, settings
