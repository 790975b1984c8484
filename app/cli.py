"""The command line: ffmap run, inspect, compare, sweep, runs, view, rooms, info, simulate, evaluate and more.

Each command imports what it needs when it is called: 'ffmap --help' answers at once.
"""

import errno
import inspect
import os
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ffmap.app.parameters import (
    BAG_HELP,
    OUTPUTS_HELP,
    HowToRun,
    OfTheBag,
    RoomsParameters,
    SweepParameters,
    argument,
    one_for_each_core,
    option,
)
from ffmap.app.quick_imports import quick_imports
from ffmap.app.setup.outputs import RUN_OUTPUTS, Detail, Output, parse_outputs
from ffmap.loaders.bag_path import BagPath
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


def _bag_at(parts: list[Path] | None) -> BagPath | None:
    """The bag that was named, by one path or by those of its files; None where none was."""
    return BagPath(tuple(parts)) if parts else None


def _command(kind: type) -> type:
    """A command of its own name: its fields are what Typer reads, its docstring the help, and calling it does the work."""
    made: Any = dataclass(frozen=True, kw_only=True)(kind)

    def command(**words: object) -> None:
        made(**words)()

    parameters = inspect.signature(made).parameters
    hints = {one.name: Annotated[one.type, one.metadata["parameter"]] for one in fields(made)}
    command.__doc__, command.__annotations__ = kind.__doc__, hints
    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameters[name].replace(annotation=hint) for name, hint in hints.items()]
    )
    app.command(kind.__name__.lower())(command)
    return kind


@_command
class Run(HowToRun):
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

    bag: list[Path] | None = argument(None, metavar="BAG", help=BAG_HELP)
    out: Path | None = option(None, help="Run folder.  [default: runs/BAG-TIME-HASH]")
    overwrite: bool = option(False, "--overwrite", help="Replace the run that --out holds already.")
    doors: Literal["open", "as-seen", "closed"] | None = option(
        None,
        help="Doorways in map.yaml: all open, as they were seen, or closed; --set grid_map.doors.  [default: open]",
    )
    detail: Detail = option(
        Detail.LINES, help="What the recording holds of each scan: everything, labels, or the map alone."
    )
    spawn: bool = option(False, "--spawn", help="Open the Rerun viewer and follow the run live.")
    connect: str | None = option(None, help="Send to a viewer that runs, as rerun+http://127.0.0.1:9876/proxy.")
    save: bool = option(True, help="Write recording.rrd.")
    outputs: str | None = option(None, metavar="LIST", help=f"{OUTPUTS_HELP}  [default: {','.join(RUN_OUTPUTS)}]")
    workers: int | None = option(None, min=1, help="Labelling processes.  [default: one for each core]")
    scheduler: str | None = option(
        None,
        metavar="tcp://HOST:PORT",
        help="Label on the Dask cluster of this scheduler, by blocks of time; needs the extra 'cluster'.",
    )
    resume: Path | None = option(None, help="Go on with a run folder that was killed; no other argument is needed.")
    verbose: bool = option(False, "--verbose", "-v", help="Where the truth is known, print all figures as tables.")

    def __call__(self) -> None:
        from ffmap.app.run.workers import start_server

        written = parse_outputs(self.outputs, RUN_OUTPUTS)
        workers = one_for_each_core(self.workers)
        if workers > 1:
            start_server()
        with quick_imports():
            from ffmap.app.commands.run import run
            from ffmap.app.run.start import Arguments

        doors = [f"grid_map.doors={self.doors}"] if self.doors else []
        arguments = Arguments(
            bag=_bag_at(self.bag),
            out=self.out,
            config=self.config,
            overrides=(*(self.set_ or ()), *doors),
            bag_options=self.bag_options,
            trajectory=self.trajectory,
            trajectory_frame=self.trajectory_frame,
            mount=self.mount,
            detail=self.detail.value,
            spawn=self.spawn,
            connect=self.connect,
            outputs=tuple(output for output in written if self.save or output is not Output.RECORDING),
            workers=workers,
            scheduler=self.scheduler,
            evaluate=self.evaluate,
            quiet=self.quiet,
            verbose=self.verbose,
            latest=True,
            overwrite=self.overwrite,
        )
        run(arguments, self.resume)


@_command
class Info(OfTheBag):
    """What a bag holds: topics, rates, layouts, times, frames, the lidars' roles and why, gaps, what is missing.

    Example:

        ffmap info drive.bag
    """

    bag: list[Path] = argument(metavar="BAG", help=BAG_HELP)

    def __call__(self) -> None:
        from ffmap.app.commands.info import info

        info(BagPath(tuple(self.bag)), self.bag_options)


@_command
class Rigs:
    """The rigs of public data sets that are built in, or the file of one, as a start for your own.

    A bag whose topics and frames are those of one, and whose own transforms do not place its lidars, is taken to be of it.

    Examples:

        ffmap rigs

        ffmap rigs mars > my.toml
    """

    name: str | None = argument(None, metavar="[NAME]", help="Print the file of this one.")

    def __call__(self) -> None:
        from ffmap.app.commands.rigs import rigs

        rigs(self.name)


@_command
class Calibrate(OfTheBag):
    """Refine where each vertical lidar sits and by which clock it runs, from a drive with two lidars or more.

    Starts from the mount that the bag or --rig says, off by up to some 5 deg, 10 cm and 50 ms, or with --from-motion from how the
    lidars move and what both see; says how certain each of the seven is. Best is a drive between walls in which the robot turns
    once on the spot, left and right.

    Examples:

        ffmap calibrate drive.bag

        ffmap calibrate drive.bag --rig guess.toml --out rig.toml --recording calibration.rrd

        ffmap calibrate drive.bag --vertical /left/points

        ffmap calibrate drive.bag --from-motion --horizontal /top/points --vertical /side/points
    """

    bag: list[Path] = argument(metavar="BAG", help=BAG_HELP)
    out: Path | None = option(None, "--out", "-o", help="Rig file to write.  [default: BAG.rig.toml]")
    from_motion: bool = option(
        False,
        "--from-motion",
        help="Start from no mount at all, but from how the lidars move and what both see. Where the bag tells of no mount, "
        "--horizontal and --vertical name the lidars.",
    )
    recording: Path | None = option(None, help="Draw what both lidars see, before and after, into this recording.")
    seconds: float = option(60.0, min=2.0, help="Seconds of the drive that are used.")
    quiet: bool = option(False, "--quiet", "-q", help="Show no progress.")

    def __call__(self) -> None:
        from ffmap.app.run.workers import start_server

        start_server()
        with quick_imports():
            from ffmap.app.commands.calibrate import calibrate

        bag = BagPath(tuple(self.bag))
        out = self.out or bag.parts[0].with_name(f"{bag.stem}.rig.toml")
        calibrate(bag, self.bag_options, out, self.recording, self.seconds, self.quiet, self.from_motion)


@_command
class Simulate:
    """Make a real bag of a robot with one lidar or several in a generated, furnished building, with its truth.

    Examples:

        ffmap simulate office.bag --building office --seed 3 --duration 60

        ffmap simulate angled --building angled --sensor vlp16 --format mcap

        ffmap simulate one.bag --sensor os0-128 --lidars one

        ffmap simulate three.bag --lidars three

        ffmap simulate viral.bag --layout ntu_viral

        ffmap simulate glass.bag --building angled --returns dual
    """

    out: Path = argument(help="Bag to write: a file (bag), or a folder (mcap, db3).")
    building: str = option(
        "office",
        help="Kind of building: small, office, ell, angled, lab; or drawn from wide ranges: dwelling, workplace, institution.",
    )
    seed: int = option(0, min=0, help="Another building, other furniture, another drive.")
    sensor: str | None = option(None, help="hdl32e, vlp16, os1-16, os0-128, qt64 or xt32.  [default: hdl32e]")
    lidars: str | None = option(
        None,
        help="two: one upright and one on its side; one: an upright one alone; three: one upright and two on their sides, left and "
        "right; upright: two upright ones, front and rear.  [default: two]",
    )
    layout: str = option(
        "plain", help="plain, or as the bags of a public data set, with its sensors: a name that 'ffmap rigs' lists."
    )
    returns: str | None = option(
        None, help="single: the strongest echo of a firing; dual: also what is behind a pane or an edge.  [default: single]"
    )
    format_: str = option("bag", "--format", help="bag (ROS 1), mcap or db3 (ROS 2).")
    duration: float = option(60.0, min=1.0, help="Seconds of driving.")
    set_: list[str] | None = option(
        None, "--set", help="Any other property of the simulation, as in clutter=0.5; an unknown one lists them all."
    )
    quiet: bool = option(False, "--quiet", "-q", help="Print nothing but errors.")

    def __call__(self) -> None:
        from ffmap.app.commands.simulate import simulate

        values = {name: getattr(self, name) for name in ("building", "seed", "sensor", "lidars", "layout", "returns")}
        values = {name: value for name, value in values.items() if value is not None}
        values |= {"format": self.format_, "duration_s": self.duration}
        simulate(self.out, values, self.set_ or (), self.quiet)


@_command
class Evaluate:
    """Compare a run with the ground truth: labels by area, doors, map, trajectory; writes metrics.json.

    Examples:

        ffmap evaluate runs/latest

        ffmap evaluate runs/a --truth drive.bag
    """

    run_folder: Path = argument(metavar="RUN", help="Run folder.")
    truth: list[Path] | None = option(
        None,
        help="Bag with the ground truth, once for each of its files, or a TUM file of the true poses alone.  "
        "[default: the run's own bag]",
    )
    workers: int | None = option(None, min=1, help="Processes.  [default: one for each core]")

    def __call__(self) -> None:
        from ffmap.app.run.workers import start_server

        workers = one_for_each_core(self.workers)
        if workers > 1:
            start_server()
        with quick_imports():
            from ffmap.app.analysis.evaluation import evaluate_run
            from ffmap.app.analysis.metrics_tables import print_metrics
            from ffmap.app.folder.finished_run import open_run

        print_metrics(evaluate_run(open_run(self.run_folder), _bag_at(self.truth), workers))


@_command
class Inspect:
    """One scan, line by line: what was measured, what each line became, and in words why.

    The scan is labelled again from its bag exactly as the run did, and checked against the run's own labels.

    Examples:

        ffmap inspect runs/latest --scan worst

        ffmap inspect runs/a --scan 120 --line 37 --spawn
    """

    run_folder: Path = argument(metavar="RUN", help="Run folder.")
    scan: str = option(help="The scan's number, or 'worst': with most wrong final labels, or most changed ones.")
    line: int | None = option(
        None,
        help="A point line, 2 × pair + side: open there, and print its reasons.  [default: that with most wrong labels]",
    )
    bag: list[Path] | None = option(
        None, help="Where the run's bag lies now, if it was moved; once for each of its files."
    )
    out: Path | None = option(None, "--out", "-o", help="Recording.  [default: RUN/inspect-SCAN.rrd]")
    spawn: bool = option(False, "--spawn", help="Open it in the Rerun viewer.")

    def __call__(self) -> None:
        from ffmap.app.commands.inspect import inspect

        inspect(self.run_folder, self.scan, self.line, _bag_at(self.bag), self.out, self.spawn)


@_command
class Compare:
    """What differs between runs, and where: labels point by point, poses, walls, doors, map, settings, figures.

    The first run is the one that the others are compared with. Whatever the runs have is compared; what cannot be is
    said, as for runs of different bags, or runs that were aborted.

    Examples:

        ffmap compare runs/a runs/b

        ffmap compare runs/a runs/b runs/c -o comparisons/walls --spawn
    """

    run_folders: list[Path] = argument(metavar="RUN", help="Run folders.")
    out: Path | None = option(
        None,
        "--out",
        "-o",
        help="Folder for comparison.rrd and comparison.json, or the recording's name (.rrd).  "
        "[default: comparison-RUN-RUN]",
    )
    scans: bool = option(True, help="With single scans side by side; without, the file is small.")
    spawn: bool = option(False, "--spawn", help="Open it in the Rerun viewer.")
    quiet: bool = option(False, "--quiet", "-q", help="Print nothing but errors.")

    def __call__(self) -> None:
        from ffmap.app.commands.compare import compare

        compare(self.run_folders, self.out, self.scans, self.spawn, self.quiet)


@_command
class Sweep(SweepParameters):
    """Run with many settings: a run folder for each combination, one odometry for all; prints and writes a table.

    The same command continues a sweep that was stopped; finished runs are not repeated.

    Examples:

        ffmap sweep drive.bag --grid wall_planes.similarity_m=0.03,0.05,0.08 --grid doors.lines_min=2,3

        ffmap sweep a.bag b.bag --grid wall_planes.similarity_m=0.02..0.1 --optuna 30 --objective wall_f1

        ffmap sweep drive.bag --grid seed=0,1,2,3 --scheduler tcp://127.0.0.1:8786
    """

    def __call__(self) -> None:
        from ffmap.app.commands.sweep import sweep

        if sweep(self):
            sys.exit(1)


@_command
class Runs:
    """List all runs with the settings in which they differ and their figures.

    Columns are settings by their names (wall_planes.similarity_m), metrics (wall_f1, doors_found,
    trajectory_ate_rmse_m), counts (walls, doors) and seconds, the time that a run took.

    Examples:

        ffmap runs runs/sweep-drive --where "wall_f1>0.98" --where doors.lines_min=2 --sort seconds

        ffmap runs --columns started,wall_f1,door_f1 --sort wall_f1
    """

    folder: Path = argument(Path("runs"), show_default=True, metavar="DIR", help="Folder with runs.")
    where: list[str] | None = option(
        None, metavar="CONDITION", help='List only runs that meet it, as in "wall_f1>0.98"; may be repeated.'
    )
    sort: str | None = option(None, metavar="COLUMN", help="Best first for a metric, least first for anything else.")
    reverse: bool = option(False, "--reverse", help="With --sort: the other way round.")
    columns: str | None = option(
        None, metavar="LIST", help="Columns to show, as in wall_f1,doors_found; 'all' lists their names."
    )

    def __call__(self) -> None:
        from ffmap.app.commands.runs import runs

        runs(self.folder, self.where or [], self.sort, self.reverse, self.columns)


@_command
class View:
    """Open runs in the Rerun viewer with the layout that fits them: errors first, where the truth is known.

    Several runs have one layout and a list to choose from; side by side they are in what 'ffmap compare' writes.

    Examples:

        ffmap view runs/latest

        ffmap view runs/a runs/b

        ffmap view --web runs/latest
    """

    places: list[Path] = argument(metavar="RUN", help="Run folders, recordings (.rrd).")
    web: bool = option(
        False, "--web", help="Serve them to a browser on this machine instead, as where there is no display."
    )

    def __call__(self) -> None:
        from ffmap.app.commands.view import view

        view(self.places, self.web)


@_command
class Rooms(RoomsParameters):
    """Rooms of any system's grid map, furniture and all: outlines, areas, and which room leads to which.

    Writes rooms.geojson, topology.json, rooms.png and rooms.rrd. Free is white (over 250) in an image; a YAML file has
    its own thresholds. In a folder, every X.png that has its Y_gt_segmentation.png beside it is compared with that.
    If some maps of a folder fail, the others are compared, each failure is one line, and the exit code is 2.

    Examples:

        ffmap rooms map.yaml

        ffmap rooms floor.png --resolution 0.05 --truth floor_rooms.png

        ffmap rooms ipa_room_segmentation/test_maps --resolution 0.05

        ffmap rooms slam.yaml --set area_graph.furniture_max_m=0 --set area_graph.block_max_m=0
    """

    def __call__(self) -> None:
        from ffmap.app.commands.rooms import rooms

        rooms(self)


@_command
class Settings:
    """Every setting with its value, unit, meaning and place in the paper, as a TOML file for --config.

    Example:

        ffmap settings > mine.toml
    """

    config: Path | None = option(None, help="Settings to show in place of the defaults.")
    set_: list[str] | None = option(None, "--set", help="One setting, as in doors.recess_min_m=0.03.")

    def __call__(self) -> None:
        from ffmap.app.setup.settings import as_toml, load_settings

        typer.echo(as_toml(load_settings(self.config, self.set_ or [])), nl=False)


@_command
class Demo:
    """Simulate a small furnished building, run the program on it, and say how to look at the result."""

    out: Path = option(Path("demo"), help="Folder for the demonstration's bag and run.")

    def __call__(self) -> None:
        from ffmap.app.commands.demo import demo

        demo(self.out)


def main() -> None:
    """Entry point: the user's mistakes are one line and exit code 2, ours a traceback."""
    from ffmap.app.compiled_code import compiled_code
    from ffmap.app.run.workers import ENVIRONMENT

    # For numpy and Numba here, and for the worker processes.
    os.environ.update(ENVIRONMENT | os.environ | compiled_code())
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
