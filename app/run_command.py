"""ffmap run: from the arguments to a finished run folder."""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, get_args

import typer

from app import pipeline, run_folder
from app.finished_run import open_run
from app.inputs import InputOptions, Inputs, find_inputs
from app.outputs import RUN_OUTPUTS, Output, check_outputs
from app.poses import check_lidars_meet, given_poses
from app.progress import Progress
from app.recorder import Detail
from app.recording import check_viewer, start_viewer
from app.run_folder import EVALUATION, RECORDING, RunFolder
from app.settings import Settings, load_settings, validate
from app.versions import versions
from loaders.errors import InputError
from loaders.pointcloud2 import TimeFrom

INTERRUPTED = 130
"""The exit code of a program that Ctrl-C has ended."""


@dataclass(frozen=True)
class Arguments:
    """The command line's words; see `app.cli.run`."""

    bag: Path | None
    out: Path | None = None
    config: Path | None = None
    overrides: tuple[str, ...] = ()
    rig: Path | None = None
    horizontal: str | None = None
    vertical: str | None = None
    time_from: TimeFrom = "auto"
    trajectory: str | None = None
    detail: str = "lines"
    spawn: bool = False
    connect: str | None = None
    outputs: tuple[str, ...] = RUN_OUTPUTS
    workers: int = 2
    evaluate: bool = True
    quiet: bool = False
    latest: bool = False
    """Whether `latest` beside the run folder is to point at it: not in a sweep, whose runs come in any order."""
    overwrite: bool = False
    """Whether a run that is in the folder already may be replaced."""


_STORED = ("rig", "horizontal", "vertical", "time_from", "trajectory", "detail", "outputs", "evaluate")
"""Arguments that run.json keeps, for a run that is resumed."""


def run(arguments: Arguments, resume: Path | None) -> None:
    """Run, or go on with a run; raises InputError for what the user can mend, as where another run is at the folder."""
    with ExitStack() as stack:
        _run(arguments, resume, stack)


def _run(arguments: Arguments, resume: Path | None, stack: ExitStack) -> None:
    """stack: holds the run folder until it is left."""
    if resume is not None:
        _check_resumable(arguments)
        stack.enter_context(run_folder.held(resume))
        arguments, settings, folder, record = _resumed(arguments, resume)
        if record is None:
            typer.echo(f"{folder.path} is complete already; nothing to resume")
            return
    else:
        if arguments.bag is None:
            raise InputError("give a bag, or --resume with a run folder; 'ffmap run --help' has examples")
        settings, folder, record = load_settings(arguments.config, arguments.overrides), None, None
    assert arguments.bag is not None
    inputs = find_inputs(
        arguments.bag, InputOptions(arguments.rig, arguments.horizontal, arguments.vertical, arguments.time_from)
    )
    given = given_poses(arguments.trajectory, inputs, settings)
    if given is None:
        check_lidars_meet(inputs)
    else:
        inputs = replace(inputs, warnings=(*inputs.warnings, *given.warnings))
    if record is not None and record["bag"]["digest"] != inputs.bag_digest:
        raise InputError(f"{arguments.bag}: is not the bag that {resume} was made from; start a new run")
    if folder is None:
        folder = run_folder.create(
            arguments.out or run_folder.default_path(arguments.bag.resolve(), settings.short_hash()), arguments.overwrite
        )
        stack.enter_context(run_folder.held(folder.path))
    connect_url = _viewer(arguments)
    if record is None:
        run_folder.clear(folder)
        record = pipeline.first_record(
            inputs, settings, stored(arguments), arguments.bag, arguments.trajectory or "odometry"
        )
        if given is not None:
            record["map_origin"] = given.origin_m.tolist()
    assert record is not None
    options = pipeline.RunOptions(
        detail=Detail(arguments.detail),
        outputs=check_outputs(arguments.outputs),
        connect_url=connect_url,
        workers=arguments.workers,
        resume=resume is not None,
    )
    with (
        _interruptible(f"'ffmap run --resume {folder.path}' goes on with the run"),
        Progress(arguments.quiet) as progress,
    ):
        for warning in inputs.warnings:
            progress.warn(warning)
        trajectory = None if given is None else given.trajectory
        finished = pipeline.run(inputs, trajectory, settings, options, folder, progress, record)
    if arguments.latest:
        run_folder.point_latest_at(folder.path.resolve())
    if not arguments.quiet:
        _report(folder, inputs, finished, Output.RECORDING in arguments.outputs)
    if arguments.evaluate and inputs.vertical is not None:
        with _interruptible(f"the run is complete, 'ffmap evaluate {folder.path}' compares it with the truth"):
            _evaluate(folder, arguments)


@contextmanager
def _interruptible(how_to_go_on: str) -> Iterator[None]:
    """End with one line, and the exit code that says so, where the user interrupts."""
    try:
        yield
    except KeyboardInterrupt:
        # What was interrupted while it was made complains when it goes.
        sys.unraisablehook = lambda _: None
        typer.echo(f"ffmap: interrupted; {how_to_go_on}", err=True)
        raise SystemExit(INTERRUPTED) from None


def _viewer(arguments: Arguments) -> str | None:
    """Where a viewer listens: one that is started, or the one that was named."""
    if not arguments.spawn and arguments.connect is None:
        return None
    try:
        if not arguments.spawn and arguments.connect is not None:
            check_viewer(arguments.connect)
            return arguments.connect
        return start_viewer()
    except ConnectionError as error:
        raise InputError(f"--connect: {error}; start a viewer first, or leave --connect out") from error
    except RuntimeError as error:
        raise InputError(f"--spawn: {error} Leave it out: recording.rrd can be opened later") from error


def _evaluate(folder: RunFolder, arguments: Arguments) -> None:
    from app import evaluate

    finished = open_run(folder.path)
    if evaluate.has_truth(finished):
        metrics = evaluate.evaluate_run(finished, None, arguments.workers)
        if not arguments.quiet:
            evaluate.print_metrics(metrics)
            if (folder.path / EVALUATION).exists():
                typer.echo(f"errors:    {folder.path / EVALUATION}  (open both: ffmap view {folder.path})")


def stored(arguments: Arguments) -> dict[str, Any]:
    values = asdict(arguments)
    stored = {name: values[name] for name in _STORED}
    if arguments.rig is not None:
        stored["rig"] = str(arguments.rig.resolve())
    if arguments.trajectory is not None and Path(arguments.trajectory).exists():
        stored["trajectory"] = str(Path(arguments.trajectory).resolve())
    return stored


def _check_resumable(arguments: Arguments) -> None:
    given = (arguments.bag, arguments.out, arguments.config)
    if any(word is not None for word in given) or arguments.overrides or arguments.overwrite:
        raise InputError("--resume goes on as the run was started: give no bag, --out, --config, --set or --overwrite with it")


def _resumed(arguments: Arguments, path: Path) -> tuple[Arguments, Settings, RunFolder, dict[str, Any] | None]:
    """What a killed run was started with; None as its record where it is complete."""
    folder = RunFolder(path)
    record = folder.read_json()
    if record.get("outcome") == "complete":
        return arguments, Settings(), folder, None
    try:
        options = dict(record["options"])
        bag, settings = Path(record["bag"]["path"]), validate(record["settings"], str(path / run_folder.RUN_JSON))
        if options["time_from"] not in get_args(TimeFrom):
            raise KeyError(options["time_from"])
        options["outputs"] = check_outputs(options["outputs"])
    except KeyError as error:
        raise InputError(f"{path / run_folder.RUN_JSON}: lacks {error}; start a new run") from None
    options["rig"] = Path(options["rig"]) if options["rig"] else None
    if not bag.exists():
        raise InputError(f"{bag}: the run's bag is gone; bring it back, or start a new run")
    begun, now = record.get("versions", {}), versions()
    if any(begun.get(name) != now[name] for name in ("furniture-free-mapping", "git_revision")):
        raise InputError(f"{path}: was begun by another version of ffmap, whose labels may differ; start a new run")
    folder.spool.mkdir(exist_ok=True)
    for leftover in folder.path.rglob("*.part"):
        if leftover.is_file():
            leftover.unlink()
    return replace(arguments, bag=bag, **options), settings, folder, record


def _report(folder: RunFolder, inputs: Inputs, record: dict[str, Any], saved: bool) -> None:
    counts = record["counts"]
    if inputs.vertical is None:
        typer.echo(
            f"{counts.get('registrations', 0)} scans registered; there is nothing to label: {inputs.bag_path.name} has no "
            "lidar that sweeps the walls (a vertical one, its spin axis level)"
        )
    else:
        typer.echo(
            f"{counts['scans']} of {counts['clouds']} scans labelled, {counts['walls']} wall faces, "
            f"{counts['doors']} doors, in {record['timings_s']['total']:.1f} s"
        )
    typer.echo(f"results:   {folder.path}")
    if saved:
        typer.echo(f"recording: {folder.path / RECORDING}  (open it: ffmap view {folder.path})")
