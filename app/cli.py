"""The command line: ffmap run, inspect, compare, sweep, runs, view, rooms, info and more.

Each command imports its modules when it is called, so that 'ffmap --help' starts at once.
"""

import errno
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from ffmap.app import parameters as shared
from ffmap.app.interruption import interruption_alone, listen
from ffmap.app.setup.outputs import RUN_OUTPUTS, SWEEP_OUTPUTS, Detail, Output, parse_outputs
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

if TYPE_CHECKING:
    from ffmap.app.setup.options import RunOptions

app = typer.Typer(
    name="ffmap",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Build a furniture-free map of a building from a ROS bag of 3-D lidar data, and log every "
    "intermediate to a Rerun recording.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from ffmap.app.setup.versions import versions

        own = versions()
        revision = own["git_revision"]
        git = f" (git {revision})" if revision else ""
        typer.echo(f"ffmap {own['furniture-free-mapping']}{git}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        Option(
            "--version", help="Print the version and exit.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass


def _run_options(context: typer.Context, **others: Any) -> "RunOptions":  # noqa: ANN401
    """Return the options of a run, by their names: those of the command, and others."""
    from ffmap.app.setup.options import RunOptions

    return RunOptions.model_validate(context.params | others)


@app.command()
def run(
    context: typer.Context,
    bag: Annotated[list[Path] | None, shared.BAG] = None,
    rig: shared.Rig = None,
    horizontal: shared.Horizontal = None,
    vertical: shared.Vertical = None,
    time_from: shared.TimeFrom = "auto",
    config: shared.Config = None,
    set_: shared.Set = None,
    trajectory: shared.Trajectory = None,
    trajectory_frame: shared.TrajectoryFrame = None,
    mount: shared.Mount = "refine",
    evaluate: shared.Evaluate = True,
    quiet: shared.Quiet = False,
    out: Annotated[Path | None, Option(help="Run folder.  [default: runs/BAG-TIME-HASH]")] = None,
    overwrite: Annotated[
        bool, Option("--overwrite", help="Replace the run that --out holds already.")
    ] = False,
    doors: Annotated[
        Literal["open", "as-seen", "closed"] | None,
        Option(
            help="Doorways in map.yaml: all open, as seen, or closed; as --set grid_map.doors.  "
            "[default: open]"
        ),
    ] = None,
    detail: shared.Detail = Detail.LINES,
    spawn: Annotated[
        bool, Option("--spawn", help="Open the Rerun viewer and show the run live.")
    ] = False,
    connect: Annotated[
        str | None, Option(help="Send to a running viewer, e.g. rerun+http://127.0.0.1:9876/proxy.")
    ] = None,
    save: Annotated[bool, Option(help="Write recording.rrd.")] = True,
    outputs: shared.Outputs = shared.RUN_OUTPUTS,
    workers: shared.Workers = shared.CORES,
    scheduler: shared.Scheduler = None,
    resume: Annotated[
        Path | None,
        Option(help="Folder of a killed run to continue. Requires no other argument."),
    ] = None,
    verbose: Annotated[
        bool,
        Option("--verbose", "-v", help="Print all figures if the bag holds ground truth."),
    ] = False,
) -> None:
    """Label every scan of a bag, map the building, log every intermediate.

    Examples:

    ```
    ffmap run drive.bag
    ffmap run drive.mcap --out runs/a --set relabelling.range_noise_m=0.03 --spawn
    ffmap run drive.bag --rig rig.toml --trajectory poses.tum
    ffmap run drive_0.bag drive_1.bag drive_2.bag
    ffmap run drive.bag --vertical /left/points --vertical /right/points
    ffmap run --resume runs/a
    ffmap run day.mcap --scheduler tcp://127.0.0.1:8786
    ```
    """
    written = parse_outputs(outputs, RUN_OUTPUTS)
    if not save:
        written = tuple(output for output in written if output is not Output.RECORDING)
    from ffmap.app.commands import run as command
    from ffmap.app.setup.settings import load_settings

    options = _run_options(context, outputs=written)
    overrides = [*(set_ or ()), *([f"grid_map.doors={doors}"] if doors else [])]
    if resume is not None:
        if bag or out or config or overrides or overwrite:
            raise InputError(
                "--resume takes bag and settings from the run: give no bag, --out, --config, --set "
                "or --overwrite"
            )
        command.resume(resume, options)
    elif bag:
        settings = load_settings(config, overrides)
        command.run(BagPath(tuple(bag)), settings, options, out, overwrite, latest=True)
    else:
        raise InputError(
            "give a bag, or --resume with a run folder; 'ffmap run --help' has examples"
        )


@app.command()
def info(
    bag: shared.Bag,
    rig: shared.Rig = None,
    horizontal: shared.Horizontal = None,
    vertical: shared.Vertical = None,
    time_from: shared.TimeFrom = "auto",
) -> None:
    """Print topics, rates, layouts, time stamps, frames, roles of lidars, gaps, missing data.

    Example: `ffmap info drive.bag`
    """
    from ffmap.app.commands.info import describe

    path, verticals = BagPath(tuple(bag)), tuple(vertical or ())
    for line in describe(path, rig, horizontal, verticals, time_from):
        typer.echo(line)


@app.command()
def rigs(
    name: Annotated[
        str | None,
        Argument(metavar="[NAME]", show_default=False, help="Print the file of this rig."),
    ] = None,
) -> None:
    """List the built-in rigs of public data sets, or print the file of a rig.

    A rig is used automatically if a bag has its topics and frames but no extrinsics.

    Examples:

    ```
    ffmap rigs
    ffmap rigs mars > my.toml
    ```
    """
    from ffmap.loaders.rig_file import built_in_path, built_in_rigs

    if name is not None:
        typer.echo(built_in_path(name).read_text(encoding="utf-8"), nl=False)
        return
    for rig in built_in_rigs():
        typer.echo(f"{rig.name}: {rig.description}; source: {rig.source}")
        for lidar in rig.lidars:
            typer.echo(f"  {lidar.sensor or '':<16} {lidar.topic or '':<38} {lidar.frame or ''}")


@app.command()
def calibrate(
    context: typer.Context,
    bag: shared.Bag,
    rig: shared.Rig = None,
    horizontal: shared.Horizontal = None,
    vertical: shared.Vertical = None,
    time_from: shared.TimeFrom = "auto",
    out: Annotated[
        Path | None, Option("--out", "-o", help="Rig file to write.  [default: BAG.rig.toml]")
    ] = None,
    from_motion: Annotated[
        bool,
        Option(
            "--from-motion",
            help="Estimate the extrinsics without a first guess, from the motion of the lidars. "
            "If the bag has no transforms, name the lidars by --horizontal and --vertical.",
        ),
    ] = False,
    recording: Annotated[
        Path | None,
        Option(help="Rerun recording of the surfaces that both lidars see, before and after."),
    ] = None,
    seconds: Annotated[float, Option(min=2.0, help="Seconds of the drive to use.")] = 60.0,
    quiet: Annotated[bool, Option("--quiet", "-q", help="Show no progress.")] = False,
) -> None:
    """Estimate extrinsics and clock offset of each vertical lidar from a drive.

    Refines the extrinsics of the bag or of --rig if these are within 5 deg, 10 cm and 50 ms;
    --from-motion requires no first guess. Prints the standard deviation of each value. Best is a
    drive between walls in which the robot turns once on the spot, left and right.

    Examples:

    ```
    ffmap calibrate drive.bag
    ffmap calibrate drive.bag --rig guess.toml --out rig.toml --recording calibration.rrd
    ffmap calibrate drive.bag --vertical /left/points
    ffmap calibrate drive.bag --from-motion --horizontal /top/points --vertical /side/points
    ```
    """
    from ffmap.app.commands import calibrate as command

    path = BagPath(tuple(bag))
    out = out or path.parts[0].with_name(f"{path.stem}.rig.toml")
    command.calibrate(path, _run_options(context), out, recording, seconds, from_motion)


@app.command()
def simulate(
    out: Annotated[
        Path,
        Argument(show_default=False, help="Bag to write: a file (bag) or a folder (mcap, db3)."),
    ],
    building: Annotated[
        str,
        Option(
            help="Kind of building: small, office, ell, angled, lab; or from wider ranges: "
            "dwelling, workplace, institution."
        ),
    ] = "office",
    seed: Annotated[int, Option(min=0, help="Seed of building, furniture and drive.")] = 0,
    sensor: Annotated[
        str | None,
        Option(help="hdl32e, vlp16, os1-16, os0-128, qt64, xt32, mid360.  [default: hdl32e]"),
    ] = None,
    lidars: Annotated[
        str | None,
        Option(
            help="two: one upright, one on its side; one: one upright; three: one upright, two on "
            "their sides; upright: two upright, front and rear.  [default: two]"
        ),
    ] = None,
    layout: Annotated[
        str,
        Option(help="plain, or the layout of a public data set that 'ffmap rigs' lists."),
    ] = "plain",
    format_: Annotated[str, Option("--format", help="bag (ROS 1), mcap or db3 (ROS 2).")] = "bag",
    duration: Annotated[float, Option(min=1.0, help="Seconds of driving.")] = 60.0,
    set_: Annotated[
        list[str] | None,
        Option(
            "--set",
            help="Any other setting, as in clutter=0.5. An unknown name lists all.",
        ),
    ] = None,
    quiet: shared.Quiet = False,
) -> None:
    """Simulate a drive through a furnished building and write its bag, with ground truth.

    Examples:

    ```
    ffmap simulate office.bag --building office --seed 3 --duration 60
    ffmap simulate angled --building angled --sensor vlp16 --format mcap
    ffmap simulate one.bag --sensor os0-128 --lidars one
    ffmap simulate three.bag --lidars three
    ffmap simulate viral.bag --layout ntu_viral
    ```
    """
    from ffmap.app.commands import simulate as command

    values = {
        "building": building,
        "seed": seed,
        "sensor": sensor,
        "lidars": lidars,
        "layout": layout,
        "format": format_,
        "duration_s": duration,
    }
    given = {name: value for name, value in values.items() if value is not None}
    command.simulate(out, given, set_ or (), quiet)


@app.command()
def evaluate(
    run_folder: shared.RunFolder,
    truth: Annotated[
        list[Path] | None,
        Option(
            help="Bag with the ground truth (repeatable for its files), or a TUM file of the true "
            "poses.  [default: the bag of the run]"
        ),
    ] = None,
    workers: shared.Workers = shared.CORES,
) -> None:
    """Compare a run with the ground truth and write metrics.json.

    Figures: labels by area, doors, map, rooms, trajectory.

    Examples:

    ```
    ffmap evaluate runs/latest
    ffmap evaluate runs/a --truth drive.bag
    ```
    """
    from ffmap.app.analysis.evaluation import evaluate_run
    from ffmap.app.analysis.metrics_tables import print_metrics
    from ffmap.app.folder.finished_run import open_run

    bag = BagPath(tuple(truth)) if truth else None
    print_metrics(evaluate_run(open_run(run_folder), bag, workers))


@app.command()
def inspect(
    run_folder: shared.RunFolder,
    scan: Annotated[
        str | None,
        Option(
            help="Number of the scan, or 'worst': the scan with most wrong or changed labels.  "
            "[default: the building]"
        ),
    ] = None,
    line: Annotated[
        int | None,
        Option(
            help="Point line to open and to print, 2 × pair + side.  "
            "[default: the line with most wrong labels]"
        ),
    ] = None,
    bag: Annotated[
        list[Path] | None,
        Option(help="New path of the bag if it was moved; repeatable for its files."),
    ] = None,
    out: Annotated[
        Path | None, Option("--out", "-o", help="Recording.  [default: RUN/inspect-SCAN.rrd]")
    ] = None,
    spawn: shared.Spawn = False,
) -> None:
    """Show why the building has its walls, doors and windows, or why a scan has its labels.

    Without --scan, prints the odds of each wall, door, window and refused face against the next
    best kind, and the rays they rest on. With --scan, labels the scan again from the bag, checks
    the result against the labels of the run, and prints the reason of each label.

    Examples:

    ```
    ffmap inspect runs/latest
    ffmap inspect runs/latest --scan worst
    ffmap inspect runs/a --scan 120 --line 37 --spawn
    ```
    """
    from ffmap.app.commands import inspect as command

    if scan is None:
        of_scan = {"--line": line, "--bag": bag, "--out": out, "--spawn": spawn or None}
        given = [option for option, value in of_scan.items() if value is not None]
        if given:
            raise InputError(f"{given[0]}: requires --scan")
        command.print_building(run_folder)
        return
    moved = BagPath(tuple(bag)) if bag else None
    command.inspect(run_folder, scan, line, moved, out, spawn)


@app.command()
def compare(
    run_folders: Annotated[
        list[Path], Argument(metavar="RUN", show_default=False, help="Run folders.")
    ],
    out: Annotated[
        Path | None,
        Option(
            "--out",
            "-o",
            help="Folder for comparison.rrd and comparison.json, or the recording's path (.rrd).  "
            "[default: comparison-RUN-RUN]",
        ),
    ] = None,
    scans: Annotated[
        bool, Option(help="Record single scans side by side. Without them the file is small.")
    ] = True,
    spawn: shared.Spawn = False,
    quiet: shared.Quiet = False,
) -> None:
    """Find out which run is better, and where: labels, poses, walls, doors, map, figures.

    Compares each run with the first one. With ground truth in the bag, the recording shows which
    labels became right and wrong. Differences within the tolerance of a figure do not count.

    Examples:

    ```
    ffmap compare runs/a runs/b
    ffmap compare runs/a runs/b runs/c -o comparisons/walls --spawn
    ```
    """
    from ffmap.app.commands import compare as command

    command.compare(run_folders, out, scans, spawn, quiet)


@app.command()
def sweep(
    context: typer.Context,
    bags: Annotated[
        list[Path],
        Argument(
            metavar="BAG",
            show_default=False,
            help="ROS bags, one per drive; for a drive in several files, its folder.",
        ),
    ],
    rig: shared.Rig = None,
    horizontal: shared.Horizontal = None,
    vertical: shared.Vertical = None,
    time_from: shared.TimeFrom = "auto",
    config: shared.Config = None,
    set_: shared.Set = None,
    trajectory: shared.Trajectory = None,
    trajectory_frame: shared.TrajectoryFrame = None,
    mount: shared.Mount = "refine",
    evaluate: shared.Evaluate = True,
    quiet: shared.Quiet = False,
    grid: Annotated[
        list[str] | None,
        Option(
            metavar="NAME=V,V",
            help="Setting and its values, as in relabelling.range_noise_m=0.01,0.03; with "
            "--random and --optuna also a range, as in 0.02..0.08; repeatable.",
        ),
    ] = None,
    random: Annotated[
        int | None,
        Option(min=1, metavar="N", help="Run N random combinations instead of all."),
    ] = None,
    optuna: Annotated[
        int | None,
        Option(
            min=1,
            metavar="N",
            help="Run N combinations that Optuna proposes.",
        ),
    ] = None,
    objective: Annotated[
        str,
        Option(help="Figure by which runs are ranked, and which --optuna optimizes."),
    ] = "wall.f1",
    seed: Annotated[int, Option(min=0, help="Seed of --random and --optuna.")] = 0,
    out: Annotated[
        Path | None,
        Option(help="Folder of the runs and of sweep.csv.  [default: runs/sweep-BAG]"),
    ] = None,
    detail: shared.Detail = Detail.MAP,
    outputs: shared.Outputs = shared.SWEEP_OUTPUTS,
    workers: shared.Workers = shared.CORES,
    scheduler: shared.Scheduler = None,
) -> None:
    """Run with many combinations of settings and rank them in sweep.csv.

    All runs share one odometry; --workers run at once, each in one process. The same command
    continues a sweep that was stopped.

    Examples:

    ```
    ffmap sweep drive.bag --grid foreground.relief_m=0.01,0.04 --grid building.length_min_m=0.25,0.8
    ffmap sweep a.bag b.bag --grid relabelling.range_noise_m=0.01..0.04 --optuna 30
    ffmap sweep drive.bag --grid seed=0,1,2,3 --scheduler tcp://127.0.0.1:8786
    ```
    """
    from ffmap.app.commands import sweep as command
    from ffmap.app.setup.settings import load_settings

    options = _run_options(context, outputs=parse_outputs(outputs, SWEEP_OUTPUTS))
    search = command.Search(tuple(grid or ()), random, optuna, objective, seed)
    if command.sweep(bags, load_settings(config, set_ or ()), options, search, out):
        sys.exit(1)


@app.command()
def runs(
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder with runs.")] = Path("runs"),
    where: Annotated[
        list[str] | None,
        Option(
            metavar="CONDITION",
            help='Show only runs that meet it, as in "wall.f1>0.98"; repeatable.',
        ),
    ] = None,
    sort: Annotated[
        str | None,
        Option(metavar="COLUMN", help="Best first for figures, lowest first otherwise."),
    ] = None,
    reverse: Annotated[bool, Option("--reverse", help="With --sort: reverse the order.")] = False,
    columns: Annotated[
        str | None,
        Option(
            metavar="LIST",
            help="Columns to show, as in wall.f1,doors.recall; 'all' lists the names.",
        ),
    ] = None,
) -> None:
    """List runs with their figures and the settings in which they differ.

    Columns: settings (wall_planes.similarity_m), figures (wall.f1, door.f1), counts (walls,
    doors), seconds of run time.

    Examples:

    ```
    ffmap runs runs/sweep-drive --where "wall.f1>0.98" --where seed=2 --sort seconds
    ffmap runs --columns started,wall.f1,door.f1 --sort wall.f1
    ```
    """
    from ffmap.app.commands import runs as command

    command.runs(folder, where or (), sort, reverse, columns)


@app.command()
def view(
    places: Annotated[
        list[Path],
        Argument(metavar="RUN", show_default=False, help="Run folders, recordings (.rrd)."),
    ],
    web: Annotated[
        bool,
        Option(
            "--web",
            help="Serve the runs to a browser on this machine, for machines without a display.",
        ),
    ] = False,
) -> None:
    """Open runs in the Rerun viewer.

    The viewer lists several runs; 'ffmap compare' shows them side by side.

    Examples:

    ```
    ffmap view runs/latest
    ffmap view runs/a runs/b
    ffmap view --web runs/latest
    ```
    """
    from ffmap.app.commands import view as command

    command.view(places, web)


@app.command()
def rooms(
    map_path: Annotated[
        Path,
        Argument(
            metavar="MAP",
            show_default=False,
            help="Map: .yaml of map_server, .png or .pgm image, or a folder of maps.",
        ),
    ],
    resolution: Annotated[
        float | None, Option(help="Size of a pixel in metres; required for an image without YAML.")
    ] = None,
    out: Annotated[Path | None, Option(help="Output folder.  [default: rooms/<map>]")] = None,
    truth: Annotated[
        Path | None,
        Option(
            help="Image of the true rooms, white and separated by lines; prints recall, precision."
        ),
    ] = None,
    doors: Annotated[Path | None, Option(help="Known doors, e.g. doors.geojson of a run.")] = None,
    config: shared.Config = None,
    set_: shared.Set = None,
) -> None:
    """Segment any grid map into rooms: outlines, areas and passages.

    Writes rooms.geojson, rooms.osm (osmAG), topology.json, rooms.png and rooms.rrd. Pixels above
    250 are free; a YAML file has its own thresholds. In a folder, each X.png is compared with its
    X_gt_segmentation.png. If some maps of a folder fail, the exit code is 2.

    Examples:

    ```
    ffmap rooms map.yaml
    ffmap rooms floor.png --resolution 0.05 --truth floor_rooms.png
    ffmap rooms ipa_room_segmentation/test_maps --resolution 0.05
    ffmap rooms slam.yaml --set area_graph.furniture_max_m=0
    ```
    """
    from ffmap.app.commands import rooms as command

    command.rooms(map_path, resolution, out, truth, doors, config, set_ or ())


@app.command()
def settings(
    name: Annotated[
        str | None,
        Argument(metavar="[WORD]", show_default=False, help="Print the settings with this word."),
    ] = None,
    every: Annotated[bool, Option("--all", help="Print all settings.")] = False,
    config: shared.Config = None,
    set_: shared.Set = None,
) -> None:
    """Print the settings that change figures most, as TOML for --config.

    Each has its value, meaning, unit, paper section, what it acts on, and when to raise or lower
    it. Settings of single scans (scan labels) reach the final labels only through the building.

    Examples:

    ```
    ffmap settings
    ffmap settings doors
    ffmap settings --all > mine.toml
    ```
    """
    from ffmap.app.setup.settings import as_toml, load_settings

    typer.echo(as_toml(load_settings(config, set_ or ()), name, every), nl=False)


@app.command()
def demo(
    out: Annotated[Path, Option(help="Folder of the bag and of the run.")] = Path("demo"),
) -> None:
    """Simulate a small furnished building and map it."""
    from ffmap.app.commands import demo as command

    command.demo(out)


def main() -> None:
    """Run the command line. User errors are one line and exit code 2; bugs are tracebacks."""
    from ffmap.app.compiled_code import compiled_code
    from ffmap.app.run.workers import ENVIRONMENT

    # For numpy and Numba here, and for the worker processes.
    os.environ.update(ENVIRONMENT | os.environ | compiled_code())
    listen()
    try:
        # Not standalone: Typer prints an error in five lines, and nothing for an interruption.
        with interruption_alone():
            code = app(standalone_mode=False, prog_name="ffmap")
    except _UsageError as error:
        sys.exit(_print_usage_error(error))
    except (BrokenPipeError, SystemExit) as end:
        # Typer exits with 1 on a broken pipe, but "| grep -q" has only read enough.
        if not any(isinstance(each, BrokenPipeError) for each in (end, end.__context__)):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    except (InputError, MemoryError, OSError) as error:
        message = _in_one_line(error)
        if message is None:
            raise
        typer.echo(f"ffmap: {message}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        code = _INTERRUPTED
    if code == _INTERRUPTED:
        typer.echo("ffmap: interrupted", err=True)
    sys.exit(code or 0)


def _in_one_line(error: InputError | MemoryError | OSError) -> str | None:
    """Return problem and fix; None for a bug."""
    if isinstance(error, MemoryError):
        return "out of memory; free some, or use fewer --workers, and start again"
    if not isinstance(error, OSError):
        return str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; free some space, then continue with 'ffmap run --resume DIR'"
    if (
        error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR)
        and error.filename is not None
    ):
        reason = f"cannot be read or written ({error.strerror})"
        return f"{error.filename}: {reason}; change its permissions, or choose another place"
    return None


_INTERRUPTED = 130
_UsageError: type[Exception] = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException"
)
"""Raised by Typer for invalid arguments. The module that defines it depends on Typer's version."""


def _print_usage_error(error: Any) -> int:  # noqa: ANN401 - see _UsageError
    """Print one line about invalid arguments; return the exit code."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        typer.echo(context.get_help() if context else error.format_message())
        return 2
    message = " ".join(error.format_message().split()).rstrip(".")
    command = context.command_path if context else "ffmap"
    typer.echo(f"ffmap: {message[:1].lower()}{message[1:]}; see '{command} --help'", err=True)
    return 2
