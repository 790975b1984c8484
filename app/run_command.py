"""ffmap run: from the arguments to a finished run folder."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, get_args

import typer

from app import pipeline, run_folder
from app.finished_run import open_run
from app.inputs import InputOptions, Inputs, find_inputs
from app.outputs import RUN_OUTPUTS, Output, check_outputs
from app.poses import given_trajectory
from app.progress import Progress
from app.recorder import Detail
from app.recording import check_viewer, start_viewer
from app.run_folder import EVALUATION, RECORDING, RunFolder
from app.settings import Settings, load_settings, validate
from app.versions import versions
from loaders.errors import InputError
from loaders.pointcloud2 import TimeFrom


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


_STORED = ("rig", "horizontal", "vertical", "time_from", "trajectory", "detail", "outputs", "evaluate")
"""Arguments that run.json keeps, for a run that is resumed."""


def run(arguments: Arguments, resume: Path | None) -> None:
    """Run, or go on with a run; raises InputError for what the user can mend."""
    if resume is not None:
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
    given = given_trajectory(arguments.trajectory, inputs)
    connect_url = _viewer(arguments)
    if record is not None and record["bag"]["digest"] != inputs.bag_digest:
        raise InputError(f"{arguments.bag}: is not the bag that {resume} was made from; start a new run")
    if folder is None:
        folder = run_folder.create(
            arguments.out or run_folder.default_path(arguments.bag.resolve(), settings.short_hash())
        )
        run_folder.clear(folder)
        record = pipeline.first_record(
            inputs, settings, stored(arguments), arguments.bag, arguments.trajectory or "odometry"
        )
    assert record is not None
    with Progress(arguments.quiet) as progress:
        for warning in inputs.warnings:
            progress.warn(warning)
        finished = pipeline.run(
            inputs,
            given,
            settings,
            pipeline.RunOptions(
                detail=Detail(arguments.detail),
                outputs=check_outputs(arguments.outputs),
                connect_url=connect_url,
                workers=arguments.workers,
                resume=resume is not None,
            ),
            folder,
            progress,
            record,
        )
    if arguments.latest:
        run_folder.point_latest_at(folder.path.resolve())
    if not arguments.quiet:
        _report(folder, inputs, finished, Output.RECORDING in arguments.outputs)
    if arguments.evaluate and inputs.vertical is not None:
        _evaluate(folder, arguments)


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
                typer.echo(f"errors:    rerun {folder.path / EVALUATION} {folder.path / RECORDING}")


def stored(arguments: Arguments) -> dict[str, Any]:
    values = asdict(arguments)
    stored = {name: values[name] for name in _STORED}
    if arguments.rig is not None:
        stored["rig"] = str(arguments.rig.resolve())
    if arguments.trajectory is not None and Path(arguments.trajectory).exists():
        stored["trajectory"] = str(Path(arguments.trajectory).resolve())
    return stored


def _resumed(arguments: Arguments, path: Path) -> tuple[Arguments, Settings, RunFolder, dict[str, Any] | None]:
    """What a killed run was started with; None as its record where it is complete."""
    if arguments.bag is not None or arguments.out is not None or arguments.config is not None or arguments.overrides:
        raise InputError("--resume goes on as the run was started: give no bag, --out, --config or --set with it")
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
