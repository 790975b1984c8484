"""The command line: ffmap run, info, simulate, evaluate, maps, settings, bench, demo."""

import errno
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from loaders.errors import InputError

app = typer.Typer(
    name="ffmap",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Maps of the immobile building from a robot's two 3-D lidars, every intermediate in a Rerun recording.",
)


class TimeFrom(StrEnum):
    """Where the time of each firing comes from."""

    AUTO = "auto"
    AZIMUTH = "azimuth"
    NONE = "none"


class DoorsOption(StrEnum):
    """Which doorways of the furniture-free grid are free."""

    OPEN = "open"
    AS_SEEN = "as-seen"
    CLOSED = "closed"


class DetailOption(StrEnum):
    """How much of each scan the recording holds."""

    LINES = "lines"
    SCANS = "scans"
    MAP = "map"


BagArgument = Annotated[Path, typer.Argument(help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap.", show_default=False)]
RigOption = Annotated[
    Path | None, typer.Option("--rig", help="TOML file that says where the lidars sit; asked before /tf_static.")
]
HorizontalOption = Annotated[str | None, typer.Option(help="Topic of the lidar that gives the poses.")]
VerticalOption = Annotated[str | None, typer.Option(help="Topic of the lidar that sweeps the walls.")]
TimeFromOption = Annotated[
    TimeFrom, typer.Option(help="Times of the firings: the cloud's own, recovered from the azimuth, or none.")
]


@app.command()
def run(
    bag: Annotated[
        Path | None, typer.Argument(help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder.  [default: runs/<bag>-<time>-<hash>]")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings as TOML; see 'ffmap settings'.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable.")
    ] = None,
    rig: RigOption = None,
    horizontal: HorizontalOption = None,
    vertical: VerticalOption = None,
    time_from: TimeFromOption = TimeFrom.AUTO,
    trajectory: Annotated[
        str | None,
        typer.Option(help="Poses T_map_base in place of the odometry: a TUM file, or a topic of the bag."),
    ] = None,
    doors: Annotated[
        DoorsOption | None,
        typer.Option(help="Doorways in map.yaml: all open, as they were seen, or closed; --set grid_map.doors.  [default: open]"),
    ] = None,
    detail: Annotated[
        DetailOption, typer.Option(help="What the recording holds of each scan: everything, labels, or the map alone.")
    ] = DetailOption.LINES,
    spawn: Annotated[bool, typer.Option("--spawn", help="Open the Rerun viewer and follow the run live.")] = False,
    connect: Annotated[
        str | None, typer.Option(help="Send to a viewer that runs, as rerun+http://127.0.0.1:9876/proxy.")
    ] = None,
    save: Annotated[bool, typer.Option(help="Write recording.rrd.")] = True,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Labelling processes.  [default: one for each core]")
    ] = None,
    evaluate_: Annotated[
        bool, typer.Option("--evaluate/--no-evaluate", help="Where the bag carries truth, compare with it.")
    ] = True,
    resume: Annotated[
        Path | None, typer.Option(help="Go on with a run folder that was killed; no other argument is needed.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Label every scan of a bag, map the building, record every intermediate.

    Examples:

        ffmap run drive.bag

        ffmap run drive.mcap --out runs/a --set wall_planes.similarity_m=0.04 --spawn

        ffmap run drive.bag --rig rig.toml --trajectory poses.tum

        ffmap run --resume runs/a
    """
    from app.processes import start_server

    start_server()
    from app import run_command

    run_command.run(
        run_command.Arguments(
            bag=bag,
            out=out,
            config=config,
            overrides=(*(set_ or ()), *([f"grid_map.doors={doors.value}"] if doors else [])),
            rig=rig,
            horizontal=horizontal,
            vertical=vertical,
            time_from=time_from.value,
            trajectory=trajectory,
            detail=detail.value,
            spawn=spawn,
            connect=connect,
            save=save,
            workers=workers or os.cpu_count() or 1,
            evaluate=evaluate_,
            quiet=quiet,
        ),
        resume,
    )


@app.command()
def info(
    bag: BagArgument,
    rig: RigOption = None,
    horizontal: HorizontalOption = None,
    vertical: VerticalOption = None,
    time_from: TimeFromOption = TimeFrom.AUTO,
) -> None:
    """What a bag holds: topics, rates, layouts, times, frames, the lidars' roles and why, gaps, what is missing.

    Example:

        ffmap info drive.bag
    """
    from app import info_command

    info_command.info(bag, rig, horizontal, vertical, time_from.value)


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Bag to write: a file (bag), or a folder (mcap, db3).")],
    building: Annotated[str, typer.Option(help="Kind of building.")] = "office",
    seed: Annotated[int, typer.Option(min=0, help="Another building, other furniture, another drive.")] = 0,
    sensor: Annotated[str, typer.Option(help="hdl32e, vlp16 or os1-16.")] = "hdl32e",
    format_: Annotated[str, typer.Option("--format", help="bag (ROS 1), mcap or db3 (ROS 2).")] = "bag",
    duration: Annotated[float, typer.Option(min=1.0, help="Seconds of driving.")] = 60.0,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Any other property of the simulation, as in clutter=0.5.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Make a real bag of a robot with two lidars in a generated, furnished building, with its truth.

    Examples:

        ffmap simulate office.bag --building office --seed 3 --duration 60

        ffmap simulate angled --building angled --sensor vlp16 --format mcap
    """
    from app import simulate_command

    simulate_command.simulate(out, building, seed, sensor, format_, duration, set_ or [], quiet)


@app.command()
def evaluate(
    run_folder: Annotated[Path | None, typer.Argument(metavar="[RUN]", help="Run folder.", show_default=False)] = None,
    truth: Annotated[Path | None, typer.Option(help="Bag with the truth.  [default: the run's own]")] = None,
    suite: Annotated[
        bool, typer.Option("--suite", help="Simulate, run and evaluate buildings of many kinds, one line each.")
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="With --suite: one seed a building, short drives.")] = False,
    seeds: Annotated[
        str | None, typer.Option(help="With --suite: seeds, as in 1001,1002; 1 and 2 are those to tune on.")
    ] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="With --suite: one setting of the runs.")] = None,
    out: Annotated[Path, typer.Option(help="With --suite: where all figures are written.")] = Path("runs/suite.json"),
) -> None:
    """Compare a run with the truth: labels by area, doors, map, trajectory; writes metrics.json.

    Examples:

        ffmap evaluate runs/latest

        ffmap evaluate --suite --quick

        ffmap evaluate --suite --seeds 1,2 --set building.scans_min=5 --out runs/tuning.json
    """
    if suite:
        from app.suite import parse_seeds, run_suite

        if run_folder is not None or truth is not None:
            raise InputError("--suite makes its own bags and runs: give no run folder and no --truth with it")
        sys.exit(1 if run_suite(out, parse_seeds(seeds), quick, set_ or []) else 0)
    if run_folder is None:
        raise InputError("give a run folder, or --suite; 'ffmap evaluate --help' has examples")
    from app import evaluate as evaluation

    evaluation.print_metrics(evaluation.evaluate_run(run_folder, truth, os.cpu_count() or 1))


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
    from app import maps_command

    maps_command.maps(run_folder, reference)


@app.command()
def settings(
    config: Annotated[Path | None, typer.Option(help="Settings to show in place of the defaults.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="One setting, as in doors.recess_min_m=0.03.")] = None,
) -> None:
    """Every setting with its value, unit, meaning and place in the paper, as a TOML file for --config.

    Example:

        ffmap settings > mine.toml
    """
    from app.settings import as_toml, load_settings

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
    from app import bench_command

    bench_command.bench(bag, duration)


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the demonstration's bag and run.")] = Path("demo"),
) -> None:
    """Simulate a small furnished building, run the program on it, and say how to look at the result."""
    from app import demo_command

    demo_command.demo(out)


def _set_environment() -> None:
    """What numpy and the C library read when they start, here and in the worker processes.

    One thread for each process's linear algebra, for the processes themselves fill the cores; and freed memory is kept
    rather than given back, for every cloud asks for the same again.
    """
    for name, value in {
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MALLOC_MMAP_THRESHOLD_": str(64 << 20),
        "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
    }.items():
        os.environ.setdefault(name, value)


def main() -> None:
    """Entry point: the user's mistakes are one line and exit code 2, ours a traceback."""
    _set_environment()
    try:
        app()
    except InputError as error:
        typer.echo(f"ffmap: {error}", err=True)
        sys.exit(2)
    except BrokenPipeError:
        # The reader of our output has gone, as with | head.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        typer.echo(
            "ffmap: no space is left on the disk; free some, then go on with 'ffmap run --resume DIR', or start again",
            err=True,
        )
        sys.exit(2)
    except KeyboardInterrupt:
        typer.echo("ffmap: interrupted; 'ffmap run --resume DIR' goes on with a run", err=True)
        sys.exit(130)
