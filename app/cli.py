"""The command line: ffmap run, inspect, compare, sweep, runs, view, serve, rooms, maps, info, simulate, evaluate and more.

Each command imports what it needs when it is called: 'ffmap --help' answers at once.
"""

import errno
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from ffmap.app.parameters import (
    CompareParameters,
    EvaluateParameters,
    InfoParameters,
    InspectParameters,
    RoomsParameters,
    RunParameters,
    RunsParameters,
    SimulateParameters,
    SweepParameters,
    one_for_each_core,
    with_parameters,
)
from ffmap.app.setup.outputs import RUN_OUTPUTS, Output, parse_outputs
from ffmap.loaders.errors import InputError

app = typer.Typer(
    name="ffmap",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Maps of the immobile building from a robot's two 3-D lidars, every intermediate in a Rerun recording.",
)


def _tell_version(wanted: bool) -> None:
    if wanted:
        from ffmap.app.setup.versions import versions

        own = versions()
        revision = own["git_revision"]
        typer.echo(f"ffmap {own['furniture-free-mapping']}" + (f" (git {revision})" if revision else ""))
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", callback=_tell_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
@with_parameters(RunParameters)
def run(words: RunParameters) -> None:
    """Label every scan of a bag, map the building, record every intermediate.

    Examples:

        ffmap run drive.bag

        ffmap run drive.mcap --out runs/a --set wall_planes.similarity_m=0.04 --spawn

        ffmap run drive.bag --rig rig.toml --trajectory poses.tum

        ffmap run --resume runs/a
    """
    from ffmap.app.run.workers import start_server

    written = parse_outputs(words.outputs, RUN_OUTPUTS)
    workers = one_for_each_core(words.workers)
    if workers > 1:
        start_server()
    from ffmap.app.commands import run as run_command
    from ffmap.app.run.start import Arguments

    doors = [f"grid_map.doors={words.doors}"] if words.doors else []
    arguments = Arguments(
        bag=words.bag,
        out=words.out,
        config=words.config,
        overrides=(*(words.set_ or ()), *doors),
        bag_options=words.bag_options,
        trajectory=words.trajectory,
        detail=words.detail.value,
        spawn=words.spawn,
        connect=words.connect,
        outputs=tuple(output for output in written if words.save or output is not Output.RECORDING),
        workers=workers,
        evaluate=words.evaluate,
        quiet=words.quiet,
        verbose=words.verbose,
        latest=True,
        overwrite=words.overwrite,
    )
    run_command.run(arguments, words.resume)


@app.command()
@with_parameters(InfoParameters)
def info(words: InfoParameters) -> None:
    """What a bag holds: topics, rates, layouts, times, frames, the lidars' roles and why, gaps, what is missing.

    Example:

        ffmap info drive.bag
    """
    from ffmap.app.commands import info as info_command

    info_command.info(words.bag, words.bag_options)


@app.command()
@with_parameters(SimulateParameters)
def simulate(words: SimulateParameters) -> None:
    """Make a real bag of a robot with two lidars in a generated, furnished building, with its truth.

    Examples:

        ffmap simulate office.bag --building office --seed 3 --duration 60

        ffmap simulate angled --building angled --sensor vlp16 --format mcap
    """
    from ffmap.app.commands import simulate as simulate_command

    values = {name: getattr(words, name) for name in ("building", "seed", "sensor")}
    values |= {"format": words.format_, "duration_s": words.duration}
    simulate_command.simulate(words.out, values, words.set_ or (), words.quiet)


@app.command()
@with_parameters(EvaluateParameters)
def evaluate(words: EvaluateParameters) -> None:
    """Compare a run with the truth: labels by area, doors, map, trajectory; writes metrics.json.

    Examples:

        ffmap evaluate runs/latest

        ffmap evaluate --suite --quick

        ffmap evaluate --suite --seeds 1,2 --set building.scans_min=5 --out runs/tuning.json
    """
    if words.suite:
        from ffmap.app.commands.suite import parse_seeds, run_suite

        if words.run_folder is not None or words.truth is not None:
            raise InputError("--suite makes its own bags and runs: give no run folder and no --truth with it")
        file, seeds = words.out or Path("runs/suite.json"), parse_seeds(words.seeds)
        sys.exit(1 if run_suite(file, seeds, words.quick, words.set_ or [], at_once=words.workers) else 0)
    if words.run_folder is None:
        raise InputError("give a run folder, or --suite; 'ffmap evaluate --help' has examples")
    for name in ("set_", "quick", "seeds", "out"):
        if getattr(words, name):
            option = f"--{name.rstrip('_')}"
            raise InputError(f"{option}: goes with --suite alone; a finished run is evaluated as it was made")
    from ffmap.app.analysis.evaluation import evaluate_run
    from ffmap.app.analysis.metrics_tables import print_metrics
    from ffmap.app.folder.finished_run import open_run

    print_metrics(evaluate_run(open_run(words.run_folder), words.truth, one_for_each_core(words.workers)))


@app.command()
@with_parameters(InspectParameters)
def inspect(words: InspectParameters) -> None:
    """One scan, line by line: what was measured, what each line became, and in words why.

    The scan is labelled again from its bag exactly as the run did, and checked against the run's own labels.

    Examples:

        ffmap inspect runs/latest --scan worst

        ffmap inspect runs/a --scan 120 --line 37 --spawn
    """
    from ffmap.app.commands import inspect as inspect_command

    inspect_command.inspect(words.run_folder, words.scan, words.line, words.bag, words.out, words.spawn)


@app.command()
@with_parameters(CompareParameters)
def compare(words: CompareParameters) -> None:
    """What differs between runs, and where: labels point by point, poses, walls, doors, map, settings, figures.

    The first run is the one that the others are compared with. Whatever the runs have is compared; what cannot be is
    said, as for runs of different bags, or runs that were aborted.

    Examples:

        ffmap compare runs/a runs/b

        ffmap compare runs/a runs/b runs/c -o comparisons/walls --spawn
    """
    from ffmap.app.commands import compare as compare_command

    compare_command.compare(words.run_folders, words.out, words.scans, words.spawn, words.quiet)


@app.command()
@with_parameters(SweepParameters)
def sweep(words: SweepParameters) -> None:
    """Try many settings: every combination a run folder, one odometry for all; a table, sweep.parquet and sweep.rrd.

    A sweep that was stopped goes on with the same command; finished runs are not made again.

    Examples:

        ffmap sweep drive.bag --grid wall_planes.similarity_m=0.03,0.05,0.08 --grid doors.lines_min=2,3

        ffmap sweep a.bag b.bag --grid wall_planes.similarity_m=0.02..0.1 --optuna 30 --objective wall_f1

        ffmap sweep drive.bag --grid seed=0,1,2,3 --scheduler tcp://127.0.0.1:8786
    """
    from ffmap.app.commands import sweep as sweep_command

    if sweep_command.sweep(words):
        sys.exit(1)


@app.command()
@with_parameters(RunsParameters)
def runs(words: RunsParameters) -> None:
    """All runs with the settings in which they differ and their figures; asked of Rerun's catalogue.

    Columns are settings by their names (wall_planes.similarity_m), metrics (wall_f1, doors_found,
    trajectory_ate_rmse_m), counts (walls, doors) and seconds, what a run took.

    Examples:

        ffmap runs runs/sweep-drive-1a2b3c4d --where "wall_f1 > 0.98 and doors.lines_min = 2" --sort seconds

        ffmap runs rerun+http://127.0.0.1:51234 --columns started,wall_f1,door_f1 --sort wall_f1
    """
    from ffmap.app.commands import runs as runs_command
    from ffmap.app.record.catalogue.runs import Query

    query = Query(words.where, words.sort, words.reverse)
    runs_command.runs(words.place, query, words.columns, words.dataset)


@app.command()
def view(
    places: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="Run folders, sweep folders, recordings (.rrd).", show_default=False),
    ],
    web: Annotated[
        bool,
        typer.Option("--web", help="Serve them to a browser on this machine instead, as where there is no display."),
    ] = False,
) -> None:
    """Open runs in the Rerun viewer with the layout that fits them: errors first, where the truth is known.

    Several runs have one layout and a list to choose from; side by side they are in what 'ffmap compare' writes.

    Examples:

        ffmap view runs/latest

        ffmap view runs/a runs/b

        ffmap view runs/sweep-drive-1a2b3c4d

        ffmap view --web runs/latest
    """
    from ffmap.app.commands import view as view_command

    view_command.view(places, web)


@app.command()
def serve(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder with runs.")] = Path("runs"),
    host: Annotated[
        str,
        typer.Option(
            help="Address to listen on; 0.0.0.0 lets every machine on the network read all recordings, settings and paths, "
            "without a password and unencrypted."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any that is free.")] = 51234,
) -> None:
    """Serve a folder of runs as a Rerun catalogue, to 'ffmap runs URL', to the viewer and to Python; Ctrl-C ends it.

    Runs that are finished meanwhile are added. Clients can read, and change nothing. Behind this address Rerun's own server
    listens on a port that only this machine reaches: whoever can start programs here can change the list there (not the
    runs), and register recordings that you may read, until you end it.

    Example:

        ffmap serve /data/runs --host 0.0.0.0
    """
    from ffmap.app.commands import runs as runs_command

    runs_command.serve(folder, host, port)


@app.command()
@with_parameters(RoomsParameters)
def rooms(words: RoomsParameters) -> None:
    """Rooms of any system's grid map, furniture and all: outlines, areas, and which room leads to which.

    Writes rooms.geojson, topology.json, rooms.png and rooms.rrd. Free is white (over 250) in an image; a YAML file has
    its own thresholds. In a folder, every X.png that has its Y_gt_segmentation.png beside it is compared with that.

    Examples:

        ffmap rooms map.yaml

        ffmap rooms floor.png --resolution 0.05 --truth floor_rooms.png

        ffmap rooms ipa_room_segmentation/test_maps --resolution 0.05

        ffmap rooms slam.yaml --set area_graph.furniture_max_m=0 --set area_graph.block_max_m=0
    """
    from ffmap.app.commands import rooms as rooms_command

    rooms_command.rooms(words)


@app.command()
def maps(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.", show_default=False)],
    reference: Annotated[
        Path, typer.Option(help="YAML file of another map of the building, as map_server reads it.", show_default=False)
    ],
) -> None:
    """Lay a run's maps over any other map of the building: alignment, figures, a picture (Fig. 9e), a recording.

    The reference may lie anywhere and be turned by any angle; its resolution must be true.

    Example:

        ffmap maps runs/latest --reference floor3/map.yaml
    """
    from ffmap.app.commands import maps as maps_command

    maps_command.maps(run_folder, reference)


@app.command()
def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Remove all that it holds.")] = False,
) -> None:
    """What the cache of odometries holds: registering a bag's scans is the slowest step, so it is kept for later runs.

    The environment variable FFMAP_CACHE names another folder for it.
    """
    from ffmap.app.commands import cache as cache_command

    cache_command.cache(clear)


@app.command()
def settings(
    config: Annotated[Path | None, typer.Option(help="Settings to show in place of the defaults.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="One setting, as in doors.recess_min_m=0.03.")] = None,
) -> None:
    """Every setting with its value, unit, meaning and place in the paper, as a TOML file for --config.

    Example:

        ffmap settings > mine.toml
    """
    from ffmap.app.setup.settings import as_toml, load_settings

    typer.echo(as_toml(load_settings(config, set_ or [])), nl=False)


@app.command()
def bench(
    bag: Annotated[Path | None, typer.Argument(help="Bag to measure with.  [default: one is simulated]")] = None,
    duration: Annotated[float, typer.Option(min=5.0, help="Seconds of the simulated bag.")] = 60.0,
) -> None:
    """Measure this machine: labelling in ms a scan on one thread, and a whole run against real time.

    Example:

        ffmap bench drive.bag
    """
    from ffmap.app.commands import bench as bench_command

    bench_command.bench(bag, duration)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the demonstration's bag and run.")] = Path("demo"),
) -> None:
    """Simulate a small furnished building, run the program on it, and say how to look at the result."""
    from ffmap.app.commands import demo as demo_command

    demo_command.demo(out)


def main() -> None:
    """Entry point: the user's mistakes are one line and exit code 2, ours a traceback."""
    from ffmap.app.run.workers import ENVIRONMENT

    # For numpy here, and for the worker processes.
    os.environ.update(ENVIRONMENT | os.environ)
    try:
        # Not standalone: Typer's own way to tell of a mistake takes five lines, and it says nothing of an interruption.
        code = app(standalone_mode=False, prog_name="ffmap")
    except _OptionError as error:
        sys.exit(_tell_of_options(error))
    except BrokenPipeError:
        # The reader of our output has gone, as with | head.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (InputError, MemoryError, OSError) as error:
        said = _in_one_line(error)
        if said is None:
            raise
        typer.echo(f"ffmap: {said}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        code = _INTERRUPTED
    if code == _INTERRUPTED:
        typer.echo("ffmap: interrupted", err=True)
    sys.exit(code or 0)


def _in_one_line(error: InputError | MemoryError | OSError) -> str | None:
    """What the user can do; None where the error is ours."""
    if isinstance(error, MemoryError):
        return "memory ran out; free some, or give fewer --workers, and start again"
    if not isinstance(error, OSError):
        return str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "no space is left on the disk; free some, then go on with 'ffmap run --resume DIR', or start again"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR) and error.filename is not None:
        reason = f"cannot be read or written ({error.strerror})"
        return f"{error.filename}: {reason}; change its permissions, or choose another place"
    return None


_INTERRUPTED = 130
_OptionError: type[Exception] = next(kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException")
"""What Typer raises for words that it does not understand. Where it takes this from depends on its version."""


def _tell_of_options(error: Any) -> int:  # noqa: ANN401 - as above
    """Say in one line what is wrong with the words of the command line; returns the exit code."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        typer.echo(context.get_help() if context else error.format_message())
        return 2
    said = " ".join(error.format_message().split()).rstrip(".")
    command = context.command_path if context else "ffmap"
    typer.echo(f"ffmap: {said[:1].lower()}{said[1:]}; '{command} --help' lists what it takes", err=True)
    return 2
