"""The options of each command: dataclasses whose fields Typer reads as it reads a function's parameters."""

import inspect
import os
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_type_hints

import typer

from ffmap.app.setup.outputs import RUN_OUTPUTS, SWEEP_OUTPUTS, Detail

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from ffmap.app.setup.inputs import InputOptions


_OUTPUTS_HELP = (
    "All that is to be written, as in recording,maps: of recording, labelled (a bag), labels (Parquet, without the clouds), "
    "cloud, maps, plan, geojson."
)


def _option(default: Any = MISSING, *names: str, **options: Any) -> Any:  # noqa: ANN401 - whatever the field is
    """A field that is an option of the command line; it has to be given where there is no default."""
    return field(default=default, metadata={"parameter": typer.Option(*names, **options)})


def _argument(default: Any = MISSING, show_default: bool = False, **options: Any) -> Any:  # noqa: ANN401
    """A field that is told by its place on the command line."""
    return field(default=default, metadata={"parameter": typer.Argument(show_default=show_default, **options)})


@dataclass(frozen=True, kw_only=True)
class _OfTheBag:
    """What is said of a bag."""

    rig: Path | None = _option(None, help="TOML file that says where the lidars sit; asked before /tf_static.")
    horizontal: str | None = _option(None, help="Topic of the lidar that gives the poses.")
    vertical: str | None = _option(None, help="Topic of the lidar that sweeps the walls.")
    time_from: Literal["auto", "azimuth", "none"] = _option(
        "auto", help="Times of the firings: the cloud's own, recovered from the azimuth, or none."
    )

    @property
    def bag_options(self) -> "InputOptions":
        # Here: with it come the loaders, which '--help' need not wait for.
        from ffmap.app.setup.inputs import InputOptions

        return InputOptions(self.rig, self.horizontal, self.vertical, self.time_from)


@dataclass(frozen=True, kw_only=True)
class InfoParameters(_OfTheBag):
    bag: Path = _argument(help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap.")


@dataclass(frozen=True, kw_only=True)
class _HowToRun(_OfTheBag):
    """What one run and the runs of a sweep have in common."""

    config: Path | None = _option(None, help="Settings as TOML; see 'ffmap settings'.")
    set_: list[str] | None = _option(
        None, "--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable."
    )
    trajectory: str | None = _option(
        None, help="Poses T_map_base in place of the odometry: a TUM file, or a topic of the bag."
    )
    evaluate: bool = _option(True, help="Where a bag carries truth, compare with it.")
    quiet: bool = _option(False, "--quiet", "-q", help="Print nothing but errors.")


@dataclass(frozen=True, kw_only=True)
class RunParameters(_HowToRun):
    bag: Path | None = _argument(None, help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap.")
    out: Path | None = _option(None, help="Run folder.  [default: runs/BAG-TIME-HASH]")
    overwrite: bool = _option(False, "--overwrite", help="Replace the run that --out holds already.")
    doors: Literal["open", "as-seen", "closed"] | None = _option(
        None,
        help="Doorways in map.yaml: all open, as they were seen, or closed; --set grid_map.doors.  [default: open]",
    )
    detail: Detail = _option(
        Detail.LINES, help="What the recording holds of each scan: everything, labels, or the map alone."
    )
    spawn: bool = _option(False, "--spawn", help="Open the Rerun viewer and follow the run live.")
    connect: str | None = _option(None, help="Send to a viewer that runs, as rerun+http://127.0.0.1:9876/proxy.")
    save: bool = _option(True, help="Write recording.rrd.")
    outputs: str | None = _option(None, metavar="LIST", help=f"{_OUTPUTS_HELP}  [default: {','.join(RUN_OUTPUTS)}]")
    workers: int | None = _option(None, min=1, help="Labelling processes.  [default: one for each core]")
    resume: Path | None = _option(None, help="Go on with a run folder that was killed; no other argument is needed.")
    verbose: bool = _option(False, "--verbose", "-v", help="Where the truth is known, print all figures as tables.")


@dataclass(frozen=True, kw_only=True)
class SweepParameters(_HowToRun):
    bags: list[Path] = _argument(metavar="BAG", help="ROS bags, as 'ffmap run' takes them.")
    grid: list[str] | None = _option(
        None,
        metavar="NAME=V,V",
        help="A setting and its values, as in doors.lines_min=2,3; with --random and --optuna also a range, as in "
        "wall_planes.similarity_m=0.02..0.08; repeatable.",
    )
    random: int | None = _option(None, min=1, metavar="N", help="Try N combinations drawn at random, not all of them.")
    optuna: int | None = _option(
        None, min=1, metavar="N", help="Try N combinations, each proposed by Optuna after those before."
    )
    objective: str = _option(
        "wall_f1", help="Figure to rank runs by, and for --optuna to optimise; of errors and times the lowest."
    )
    seed: int = _option(0, min=0, help="Of --random and --optuna: the same seed, the same combinations.")
    out: Path | None = _option(
        None, help="Folder of the sweep; named again, it goes on there.  [default: runs/sweep-BAG-HASH]"
    )
    detail: Detail = _option(Detail.MAP, help="What each recording holds; see 'ffmap run'.")
    outputs: str | None = _option(None, metavar="LIST", help=f"{_OUTPUTS_HELP}  [default: {','.join(SWEEP_OUTPUTS)}]")
    workers: int | None = _option(None, min=1, help="Runs at once, one thread each.  [default: one for each core]")
    scheduler: str | None = _option(
        None, metavar="tcp://HOST:PORT", help="Run on the Dask cluster of this scheduler; needs the extra 'cluster'."
    )


@dataclass(frozen=True, kw_only=True)
class EvaluateParameters:
    run_folder: Path | None = _argument(None, metavar="[RUN]", help="Run folder.")
    truth: Path | None = _option(
        None, help="Bag with the truth, or a TUM file of the true poses alone.  [default: the run's own bag]"
    )
    suite: bool = _option(False, "--suite", help="Simulate, run and evaluate buildings of many kinds, one line each.")
    quick: bool = _option(False, "--quick", help="With --suite: one seed a building, short drives.")
    seeds: str | None = _option(None, help="With --suite: seeds, as in 1001,1002; 1 and 2 are those to tune on.")
    set_: list[str] | None = _option(None, "--set", help="With --suite: one setting of the runs.")
    out: Path | None = _option(None, help="With --suite: where all figures are written.  [default: runs/suite.json]")
    workers: int | None = _option(
        None, min=1, help="Processes; with --suite: drives at a time.  [default: one for each core]"
    )


@dataclass(frozen=True, kw_only=True)
class InspectParameters:
    run_folder: Path = _argument(metavar="RUN", help="Run folder.")
    scan: str = _option(help="The scan's number, or 'worst': with most wrong final labels, or most changed ones.")
    line: int | None = _option(
        None,
        help="A point line, 2 × emitter + side: open there, and print its reasons.  [default: that with most wrong labels]",
    )
    bag: Path | None = _option(None, help="Where the run's bag lies now, if it was moved.")
    out: Path | None = _option(None, "--out", "-o", help="Recording.  [default: RUN/inspect-SCAN.rrd]")
    spawn: bool = _option(False, "--spawn", help="Open it in the Rerun viewer.")


@dataclass(frozen=True, kw_only=True)
class CompareParameters:
    run_folders: list[Path] = _argument(metavar="RUN", help="Run folders.")
    out: Path | None = _option(
        None,
        "--out",
        "-o",
        help="Folder for comparison.rrd and comparison.json, or the recording's name (.rrd).  "
        "[default: comparison-RUN-RUN]",
    )
    scans: bool = _option(True, help="With single scans side by side; without, the file is small.")
    spawn: bool = _option(False, "--spawn", help="Open it in the Rerun viewer.")
    quiet: bool = _option(False, "--quiet", "-q", help="Print nothing but errors.")


@dataclass(frozen=True, kw_only=True)
class RoomsParameters:
    map_path: Path = _argument(
        metavar="MAP", help="map_server's .yaml, or an image: .png or .pgm; or a folder of them."
    )
    resolution: float | None = _option(None, help="Edge of a pixel in metres; needed for an image without YAML.")
    out: Path | None = _option(None, help="Folder for what is written.  [default: rooms/<map>]")
    truth: Path | None = _option(
        None, help="Image of the true rooms, white and parted by lines: prints recall and precision."
    )
    doors: Path | None = _option(None, help="Doors that are known, as a run's doors.geojson.")
    config: Path | None = _option(None, help="Settings as TOML; see 'ffmap settings'.")
    set_: list[str] | None = _option(
        None, "--set", help="One setting, as in area_graph.passage_max_m=1.25; repeatable."
    )


@dataclass(frozen=True, kw_only=True)
class RunsParameters:
    place: str = _argument(
        "runs",
        show_default=True,
        metavar="DIR|URL",
        help="Folder with runs, or a catalogue server, as 'ffmap serve' prints it.",
    )
    where: str | None = _option(None, metavar="SQL", help='Only runs of which this is true, as in "wall_f1 > 0.98".')
    sort: str | None = _option(None, metavar="COLUMN", help="Best first for a metric, least first for anything else.")
    reverse: bool = _option(False, "--reverse", help="With --sort: the other way round.")
    columns: str | None = _option(
        None, metavar="LIST", help="Columns to show, as in wall_f1,doors_found; 'all' lists their names."
    )
    dataset: str | None = _option(None, help="With a server: which of its datasets.  [default: runs]")


@dataclass(frozen=True, kw_only=True)
class SimulateParameters:
    out: Path = _argument(help="Bag to write: a file (bag), or a folder (mcap, db3).")
    building: str = _option("office", help="Kind of building: small, office, ell, angled or lab.")
    seed: int = _option(0, min=0, help="Another building, other furniture, another drive.")
    sensor: str = _option("hdl32e", help="hdl32e, vlp16 or os1-16.")
    format_: str = _option("bag", "--format", help="bag (ROS 1), mcap or db3 (ROS 2).")
    duration: float = _option(60.0, min=1.0, help="Seconds of driving.")
    set_: list[str] | None = _option(
        None, "--set", help="Any other property of the simulation, as in clutter=0.5; an unknown one lists them all."
    )
    quiet: bool = _option(False, "--quiet", "-q", help="Print nothing but errors.")


P = TypeVar("P", bound="DataclassInstance")


def with_parameters(kind: type[P]) -> Callable[[Callable[[P], None]], Callable[..., None]]:
    """Let Typer see the fields of a dataclass as the parameters of a command that takes one such dataclass."""

    def decorate(command: Callable[[P], None]) -> Callable[..., None]:
        def called(**words: object) -> None:
            command(kind(**words))

        hints, parameters = get_type_hints(kind), inspect.signature(kind).parameters
        options = {one.name: Annotated[hints[one.name], one.metadata["parameter"]] for one in fields(kind)}
        called.__name__, called.__doc__, called.__annotations__ = command.__name__, command.__doc__, options
        called.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [parameters[name].replace(annotation=option) for name, option in options.items()]
        )
        return called

    return decorate


def one_for_each_core(workers: int | None) -> int:
    """The number of processes that was asked for, or that of the machine's cores."""
    return workers or os.cpu_count() or 1
