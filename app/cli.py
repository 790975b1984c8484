"""The command line: ffmap run, inspect, compare, sweep, runs, view, rooms, info and more.

Each command imports what it needs when it is called: 'ffmap --help' answers at once.
"""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Argument, Option

from ffmap.app import parameters as shared
from ffmap.app.quick_imports import quick_imports
from ffmap.app.setup.outputs import RUN_OUTPUTS, SWEEP_OUTPUTS, Detail, Output, parse_outputs
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError

app = typer.Typer(
    name="ffmap",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Maps of the immobile building from a robot's two 3-D lidars, every intermediate in a "
    "Rerun recording.",
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
            "--version", help="Print the version and end.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass


def _rig_file(rig: Path | None) -> Path | None:
    """The file of --rig, which may be the name of a built-in rig."""
    from ffmap.loaders.rig_file import rig_path

    return rig_path(rig) if rig is not None else None


@app.command()
def run(
    bag: Annotated[
        list[Path] | None, Argument(metavar="BAG", show_default=False, help=shared.BAG_HELP)
    ] = None,
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
            help="Doorways in map.yaml: all open, as they were seen, or closed; "
            "--set grid_map.doors.  [default: open]"
        ),
    ] = None,
    detail: Annotated[
        Detail,
        Option(help="What the recording holds of each scan: everything, labels, or the map alone."),
    ] = Detail.LINES,
    spawn: Annotated[
        bool, Option("--spawn", help="Open the Rerun viewer and follow the run live.")
    ] = False,
    connect: Annotated[
        str | None, Option(help="Send to a viewer that runs, as rerun+http://127.0.0.1:9876/proxy.")
    ] = None,
    save: Annotated[bool, Option(help="Write recording.rrd.")] = True,
    outputs: Annotated[
        str | None,
        Option(metavar="LIST", help=f"{shared.OUTPUTS_HELP}  [default: {','.join(RUN_OUTPUTS)}]"),
    ] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Labelling processes.  [default: one for each core]")
    ] = None,
    scheduler: Annotated[
        str | None,
        Option(
            metavar="tcp://HOST:PORT",
            help="Label on the Dask cluster of this scheduler, by blocks of time; needs the "
            "extra 'cluster'.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        Option(help="Go on with a run folder that was killed; no other argument is needed."),
    ] = None,
    verbose: Annotated[
        bool,
        Option("--verbose", "-v", help="Where the truth is known, print all figures as tables."),
    ] = False,
) -> None:
    """Label every scan of a bag, map the building, record every intermediate.

    Examples:

        ffmap run drive.bag

        ffmap run drive.mcap --out runs/a --set wall_planes.similarity_m=0.04 --spawn

        ffmap run drive.bag --rig rig.toml --trajectory poses.tum

        ffmap run drive_0.bag drive_1.bag drive_2.bag

        ffmap run drive.bag --vertical /left/points --vertical /right/points

        ffmap run --resume runs/a

        ffmap run day.mcap --scheduler tcp://127.0.0.1:8786
    """
    from ffmap.app.run.workers import start_server

    written = parse_outputs(outputs, RUN_OUTPUTS)
    workers = workers or os.cpu_count() or 1
    if workers > 1:
        start_server()
    with quick_imports():
        from ffmap.app.commands import run as command
        from ffmap.app.setup.options import RunOptions
        from ffmap.app.setup.settings import load_settings

    options = RunOptions(
        rig=_rig_file(rig),
        horizontal=horizontal,
        vertical=tuple(vertical or ()),
        time_from=time_from,
        trajectory=trajectory,
        trajectory_frame=trajectory_frame,
        mount=mount,
        detail=detail,
        outputs=tuple(output for output in written if save or output is not Output.RECORDING),
        evaluate=evaluate,
        workers=workers,
        scheduler=scheduler,
        connect=connect,
        spawn=spawn,
        quiet=quiet,
        verbose=verbose,
    )
    overrides = [*(set_ or ()), *([f"grid_map.doors={doors}"] if doors else [])]
    if resume is not None:
        if bag or out or config or overrides or overwrite:
            raise InputError(
                "--resume goes on as the run was started: give no bag, --out, --config, --set "
                "or --overwrite with it"
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
    """What a bag holds: topics, rates, layouts, times, frames, the lidars' roles and why, gaps,
    what is missing.

    Example:

        ffmap info drive.bag
    """
    from ffmap.app.commands.info import describe
    from ffmap.loaders.info import describe_bag

    path, verticals = BagPath(tuple(bag)), tuple(vertical or ())
    for line in describe(describe_bag(path, _rig_file(rig), horizontal, verticals, time_from)):
        typer.echo(line)


@app.command()
def rigs(
    name: Annotated[
        str | None,
        Argument(metavar="[NAME]", show_default=False, help="Print the file of this one."),
    ] = None,
) -> None:
    """The rigs of public data sets that are built in, or the file of one, as a start for your own.

    A bag whose topics and frames are those of one, and whose own transforms do not place its
    lidars, is taken to be of it.

    Examples:

        ffmap rigs

        ffmap rigs mars > my.toml
    """
    from ffmap.app.tables import make_table, table_console
    from ffmap.loaders.rig_file import built_in_path, built_in_rigs

    if name is not None:
        typer.echo(built_in_path(name).read_text(encoding="utf-8"), nl=False)
        return
    known = built_in_rigs()
    rows = [
        (rig.name if n == 0 else "", lidar.sensor or "", lidar.topic or "", lidar.frame or "")
        for rig in known
        for n, lidar in enumerate(rig.lidars)
    ]
    headings = ("name", "lidars", "topics", "frames")
    table_console().print(make_table(None, headings, rows, left=range(4)))
    for rig in known:
        typer.echo(f"{rig.name}: {rig.description}; source: {rig.source}")


@app.command()
def calibrate(
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
            help="Start from no mount at all, but from how the lidars move and what both see. "
            "Where the bag tells of no mount, --horizontal and --vertical name the lidars.",
        ),
    ] = False,
    recording: Annotated[
        Path | None,
        Option(help="Draw what both lidars see, before and after, into this recording."),
    ] = None,
    seconds: Annotated[float, Option(min=2.0, help="Seconds of the drive that are used.")] = 60.0,
    quiet: Annotated[bool, Option("--quiet", "-q", help="Show no progress.")] = False,
) -> None:
    """Refine where each vertical lidar sits and by which clock it runs, from a drive with two
    lidars or more.

    Starts from the mount that the bag or --rig says, off by up to some 5 deg, 10 cm and 50 ms, or
    with --from-motion from how the lidars move and what both see; says how certain each of the
    seven is. Best is a drive between walls in which the robot turns once on the spot, left and
    right.

    Examples:

        ffmap calibrate drive.bag

        ffmap calibrate drive.bag --rig guess.toml --out rig.toml --recording calibration.rrd

        ffmap calibrate drive.bag --vertical /left/points

        ffmap calibrate drive.bag --from-motion --horizontal /top/points --vertical /side/points
    """
    from ffmap.app.run.workers import start_server

    start_server()
    with quick_imports():
        from ffmap.app.commands import calibrate as command
        from ffmap.app.setup.options import RunOptions

    options = RunOptions(
        rig=_rig_file(rig),
        horizontal=horizontal,
        vertical=tuple(vertical or ()),
        time_from=time_from,
        quiet=quiet,
    )
    path = BagPath(tuple(bag))
    out = out or path.parts[0].with_name(f"{path.stem}.rig.toml")
    command.calibrate(path, options, out, recording, seconds, from_motion)


@app.command()
def simulate(
    out: Annotated[
        Path,
        Argument(show_default=False, help="Bag to write: a file (bag), or a folder (mcap, db3)."),
    ],
    building: Annotated[
        str,
        Option(
            help="Kind of building: small, office, ell, angled, lab; or drawn from wide ranges: "
            "dwelling, workplace, institution."
        ),
    ] = "office",
    seed: Annotated[
        int, Option(min=0, help="Another building, other furniture, another drive.")
    ] = 0,
    sensor: Annotated[
        str | None, Option(help="hdl32e, vlp16, os1-16, os0-128, qt64 or xt32.  [default: hdl32e]")
    ] = None,
    lidars: Annotated[
        str | None,
        Option(
            help="two: one upright and one on its side; one: an upright one alone; three: one "
            "upright and two on their sides, left and right; upright: two upright ones, front and "
            "rear.  [default: two]"
        ),
    ] = None,
    layout: Annotated[
        str,
        Option(
            help="plain, or as the bags of a public data set, with its sensors: a name that "
            "'ffmap rigs' lists."
        ),
    ] = "plain",
    format_: Annotated[str, Option("--format", help="bag (ROS 1), mcap or db3 (ROS 2).")] = "bag",
    duration: Annotated[float, Option(min=1.0, help="Seconds of driving.")] = 60.0,
    set_: Annotated[
        list[str] | None,
        Option(
            "--set",
            help="Any other property of the simulation, as in clutter=0.5; an unknown one lists "
            "them all.",
        ),
    ] = None,
    quiet: shared.Quiet = False,
) -> None:
    """Make a real bag of a robot with one lidar or several in a generated, furnished building,
    with its truth.

    Examples:

        ffmap simulate office.bag --building office --seed 3 --duration 60

        ffmap simulate angled --building angled --sensor vlp16 --format mcap

        ffmap simulate one.bag --sensor os0-128 --lidars one

        ffmap simulate three.bag --lidars three

        ffmap simulate viral.bag --layout ntu_viral
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
            help="Bag with the ground truth, once for each of its files, or a TUM file of the "
            "true poses alone.  [default: the run's own bag]"
        ),
    ] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Processes.  [default: one for each core]")
    ] = None,
) -> None:
    """Compare a run with the ground truth: labels by area, doors, map, trajectory; writes
    metrics.json.

    Examples:

        ffmap evaluate runs/latest

        ffmap evaluate runs/a --truth drive.bag
    """
    from ffmap.app.run.workers import start_server

    workers = workers or os.cpu_count() or 1
    if workers > 1:
        start_server()
    with quick_imports():
        from ffmap.app.analysis.evaluation import evaluate_run
        from ffmap.app.analysis.metrics_tables import print_metrics
        from ffmap.app.folder.finished_run import open_run

    bag = BagPath(tuple(truth)) if truth else None
    print_metrics(evaluate_run(open_run(run_folder), bag, workers))


@app.command()
def inspect(
    run_folder: shared.RunFolder,
    scan: Annotated[
        str,
        Option(
            help="The scan's number, or 'worst': with most wrong final labels, or most changed "
            "ones."
        ),
    ],
    line: Annotated[
        int | None,
        Option(
            help="A point line, 2 × pair + side: open there, and print its reasons.  "
            "[default: that with most wrong labels]"
        ),
    ] = None,
    bag: Annotated[
        list[Path] | None,
        Option(help="Where the run's bag lies now, if it was moved; once for each of its files."),
    ] = None,
    out: Annotated[
        Path | None, Option("--out", "-o", help="Recording.  [default: RUN/inspect-SCAN.rrd]")
    ] = None,
    spawn: shared.Spawn = False,
) -> None:
    """One scan, line by line: what was measured, what each line became, and in words why.

    The scan is labelled again from its bag exactly as the run did, and checked against the run's
    own labels.

    Examples:

        ffmap inspect runs/latest --scan worst

        ffmap inspect runs/a --scan 120 --line 37 --spawn
    """
    from ffmap.app.commands import inspect as command

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
            help="Folder for comparison.rrd and comparison.json, or the recording's name (.rrd).  "
            "[default: comparison-RUN-RUN]",
        ),
    ] = None,
    scans: Annotated[
        bool, Option(help="With single scans side by side; without, the file is small.")
    ] = True,
    spawn: shared.Spawn = False,
    quiet: shared.Quiet = False,
) -> None:
    """What differs between runs, and where: labels point by point, poses, walls, doors, map,
    settings, figures.

    The first run is the one that the others are compared with. Whatever the runs have is
    compared; what cannot be is said, as for runs of different bags, or runs that were aborted.

    Examples:

        ffmap compare runs/a runs/b

        ffmap compare runs/a runs/b runs/c -o comparisons/walls --spawn
    """
    from ffmap.app.commands import compare as command

    command.compare(run_folders, out, scans, spawn, quiet)


@app.command()
def sweep(
    bags: Annotated[
        list[Path],
        Argument(
            metavar="BAG",
            show_default=False,
            help="ROS bags, each a drive; of one in several files, the folder that holds them.",
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
            help="A setting and its values, as in doors.lines_min=2,3; with --random and --optuna "
            "also a range, as in wall_planes.similarity_m=0.02..0.08; repeatable.",
        ),
    ] = None,
    random: Annotated[
        int | None,
        Option(min=1, metavar="N", help="Try N combinations drawn at random, not all of them."),
    ] = None,
    optuna: Annotated[
        int | None,
        Option(
            min=1,
            metavar="N",
            help="Try N combinations, each proposed by Optuna after those before.",
        ),
    ] = None,
    objective: Annotated[
        str,
        Option(
            help="Figure to rank runs by, and for --optuna to optimise; of errors and times the "
            "lowest."
        ),
    ] = "wall_f1",
    seed: Annotated[
        int, Option(min=0, help="Of --random and --optuna: the same seed, the same combinations.")
    ] = 0,
    out: Annotated[
        Path | None,
        Option(help="Folder of the sweep's runs and its table.  [default: runs/sweep-BAG]"),
    ] = None,
    detail: Annotated[
        Detail, Option(help="What each recording holds; see 'ffmap run'.")
    ] = Detail.MAP,
    outputs: Annotated[
        str | None,
        Option(metavar="LIST", help=f"{shared.OUTPUTS_HELP}  [default: {','.join(SWEEP_OUTPUTS)}]"),
    ] = None,
    workers: Annotated[
        int | None,
        Option(min=1, help="Runs at once, one thread each.  [default: one for each core]"),
    ] = None,
    scheduler: Annotated[
        str | None,
        Option(
            metavar="tcp://HOST:PORT",
            help="Run on the Dask cluster of this scheduler; needs the extra 'cluster'.",
        ),
    ] = None,
) -> None:
    """Run with many settings: a run folder for each combination, one odometry for all; prints and
    writes a table.

    The same command continues a sweep that was stopped; finished runs are not repeated.

    Examples:

        ffmap sweep drive.bag --grid wall_planes.similarity_m=0.03,0.05,0.08 --grid doors.lines_min=2,3

        ffmap sweep a.bag b.bag --grid wall_planes.similarity_m=0.02..0.1 --optuna 30 --objective wall_f1

        ffmap sweep drive.bag --grid seed=0,1,2,3 --scheduler tcp://127.0.0.1:8786
    """
    from ffmap.app.commands import sweep as command
    from ffmap.app.setup.options import RunOptions
    from ffmap.app.setup.settings import load_settings

    options = RunOptions(
        rig=_rig_file(rig),
        horizontal=horizontal,
        vertical=tuple(vertical or ()),
        time_from=time_from,
        trajectory=trajectory,
        trajectory_frame=trajectory_frame,
        mount=mount,
        detail=detail,
        outputs=parse_outputs(outputs, SWEEP_OUTPUTS),
        evaluate=evaluate,
        workers=workers or os.cpu_count() or 1,
        scheduler=scheduler,
        quiet=quiet,
    )
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
            help='List only runs that meet it, as in "wall_f1>0.98"; may be repeated.',
        ),
    ] = None,
    sort: Annotated[
        str | None,
        Option(metavar="COLUMN", help="Best first for a metric, least first for anything else."),
    ] = None,
    reverse: Annotated[bool, Option("--reverse", help="With --sort: the other way round.")] = False,
    columns: Annotated[
        str | None,
        Option(
            metavar="LIST",
            help="Columns to show, as in wall_f1,doors_found; 'all' lists their names.",
        ),
    ] = None,
) -> None:
    """List all runs with the settings in which they differ and their figures.

    Columns are settings by their names (wall_planes.similarity_m), metrics (wall_f1, doors_found,
    trajectory_ate_rmse_m), counts (walls, doors) and seconds, the time that a run took.

    Examples:

        ffmap runs runs/sweep-drive --where "wall_f1>0.98" --where doors.lines_min=2 --sort seconds

        ffmap runs --columns started,wall_f1,door_f1 --sort wall_f1
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
            help="Serve them to a browser on this machine instead, as where there is no display.",
        ),
    ] = False,
) -> None:
    """Open runs in the Rerun viewer with the layout that fits them: errors first, where the truth
    is known.

    Several runs have one layout and a list to choose from; side by side they are in what
    'ffmap compare' writes.

    Examples:

        ffmap view runs/latest

        ffmap view runs/a runs/b

        ffmap view --web runs/latest
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
            help="map_server's .yaml, or an image: .png or .pgm; or a folder of them.",
        ),
    ],
    resolution: Annotated[
        float | None, Option(help="Edge of a pixel in metres; needed for an image without YAML.")
    ] = None,
    out: Annotated[
        Path | None, Option(help="Folder for what is written.  [default: rooms/<map>]")
    ] = None,
    truth: Annotated[
        Path | None,
        Option(
            help="Image of the true rooms, white and parted by lines: prints recall and precision."
        ),
    ] = None,
    doors: Annotated[
        Path | None, Option(help="Doors that are known, as a run's doors.geojson.")
    ] = None,
    config: shared.Config = None,
    set_: Annotated[
        list[str] | None,
        Option("--set", help="One setting, as in area_graph.opening_ratio=0.4; repeatable."),
    ] = None,
) -> None:
    """Rooms of any system's grid map, furniture and all: outlines, areas, and which room leads to
    which.

    Writes rooms.geojson, topology.json, rooms.png and rooms.rrd. Free is white (over 250) in an
    image; a YAML file has its own thresholds. In a folder, every X.png that has its
    Y_gt_segmentation.png beside it is compared with that. If some maps of a folder fail, the
    others are compared, each failure is one line, and the exit code is 2.

    Examples:

        ffmap rooms map.yaml

        ffmap rooms floor.png --resolution 0.05 --truth floor_rooms.png

        ffmap rooms ipa_room_segmentation/test_maps --resolution 0.05

        ffmap rooms slam.yaml --set area_graph.furniture_max_m=0 --set area_graph.block_max_m=0
    """
    from ffmap.app.commands import rooms as command

    command.rooms(map_path, resolution, out, truth, doors, config, set_ or ())


@app.command()
def settings(
    config: Annotated[
        Path | None, Option(help="Settings to show in place of the defaults.")
    ] = None,
    set_: Annotated[
        list[str] | None, Option("--set", help="One setting, as in doors.recess_min_m=0.03.")
    ] = None,
) -> None:
    """Every setting with its value, unit, meaning and place in the paper, as a TOML file for
    --config.

    Example:

        ffmap settings > mine.toml
    """
    from ffmap.app.setup.settings import as_toml, load_settings

    typer.echo(as_toml(load_settings(config, set_ or ())), nl=False)


@app.command()
def demo(
    out: Annotated[Path, Option(help="Folder for the demonstration's bag and run.")] = Path("demo"),
) -> None:
    """Simulate a small furnished building, run the program on it, and say how to look at the
    result."""
    from ffmap.app.commands import demo as command

    command.demo(out)


def main() -> None:
    """Entry point: the user's mistakes are one line and exit code 2, ours a traceback."""
    from ffmap.app.compiled_code import compiled_code
    from ffmap.app.run.workers import ENVIRONMENT

    # For numpy and Numba here, and for the worker processes.
    os.environ.update(ENVIRONMENT | os.environ | compiled_code())
    try:
        # Not standalone: Typer's own way to tell of a mistake takes five lines, and it says nothing of an interruption.
        with _help_at_once():
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


@contextmanager
def _help_at_once() -> Iterator[None]:
    """Write a page of help in one go where another program reads it.

    A reader that ends early, as grep -q does, then leaves no broken pipe and no exit code of 1.
    """
    out = sys.__stdout__
    helping = not {"-h", "--help"}.isdisjoint(sys.argv)
    if not helping or out is None or sys.stdout is not out or out.isatty():
        yield
        return
    with redirect_stdout(io.StringIO()) as page:
        yield
    os.write(out.fileno(), page.getvalue().encode())


def _in_one_line(error: InputError | MemoryError | OSError) -> str | None:
    """What the user can do; None where the error is ours."""
    if isinstance(error, MemoryError):
        return "memory ran out; free some, or give fewer --workers, and start again"
    if not isinstance(error, OSError):
        return str(error)
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "no space is left on the disk; free some, then go on with 'ffmap run --resume DIR', or start again"
    if (
        error.errno in (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR)
        and error.filename is not None
    ):
        reason = f"cannot be read or written ({error.strerror})"
        return f"{error.filename}: {reason}; change its permissions, or choose another place"
    return None


_INTERRUPTED = 130
_OptionError: type[Exception] = next(
    kind for kind in typer.BadParameter.__mro__ if kind.__name__ == "ClickException"
)
"""What Typer raises for words that it does not understand. Where it takes this from depends on its version."""


def _tell_of_options(error: Any) -> int:  # noqa: ANN401 - as above
    """Say in one line what is wrong with the words of the command line; returns the exit code."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        typer.echo(context.get_help() if context else error.format_message())
        return 2
    said = " ".join(error.format_message().split()).rstrip(".")
    command = context.command_path if context else "ffmap"
    typer.echo(
        f"ffmap: {said[:1].lower()}{said[1:]}; '{command} --help' lists what it takes", err=True
    )
    return 2
