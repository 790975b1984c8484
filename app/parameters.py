"""The options of the commands that have many: dataclasses whose fields Typer reads as it reads a function's parameters."""

import inspect
import os
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar, get_type_hints

import typer

from ffmap.app.setup.outputs import RUN_OUTPUTS, SWEEP_OUTPUTS, Detail

if TYPE_CHECKING:
    from ffmap.app.setup.inputs import InputOptions


class TimeFrom(StrEnum):
    """Where the time of each firing comes from."""

    AUTO = "auto"
    AZIMUTH = "azimuth"
    NONE = "none"


class Doorways(StrEnum):
    """Which doorways of the furniture-free grid are free."""

    OPEN = "open"
    AS_SEEN = "as-seen"
    CLOSED = "closed"


RigOption = Annotated[
    Path | None, typer.Option("--rig", help="TOML file that says where the lidars sit; asked before /tf_static.")
]
HorizontalOption = Annotated[str | None, typer.Option(help="Topic of the lidar that gives the poses.")]
VerticalOption = Annotated[str | None, typer.Option(help="Topic of the lidar that sweeps the walls.")]
TimeFromOption = Annotated[
    TimeFrom, typer.Option(help="Times of the firings: the cloud's own, recovered from the azimuth, or none.")
]
ConfigOption = Annotated[Path | None, typer.Option(help="Settings as TOML; see 'ffmap settings'.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
_OUTPUTS_HELP = (
    "All that is to be written, as in recording,maps: of recording, labelled (a bag), labels (Parquet, without the clouds), "
    "cloud, maps, plan, geojson."
)


@dataclass(frozen=True, kw_only=True)
class _HowToRun:
    """What one run and the runs of a sweep have in common."""

    config: ConfigOption = None
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable.")
    ] = None
    rig: RigOption = None
    horizontal: HorizontalOption = None
    vertical: VerticalOption = None
    time_from: TimeFromOption = TimeFrom.AUTO
    trajectory: Annotated[
        str | None, typer.Option(help="Poses T_map_base in place of the odometry: a TUM file, or a topic of the bag.")
    ] = None
    evaluate: Annotated[
        bool, typer.Option("--evaluate/--no-evaluate", help="Where a bag carries truth, compare with it.")
    ] = True
    quiet: QuietOption = False

    @property
    def bag_options(self) -> "InputOptions":
        # Here: with it come the loaders, which '--help' need not wait for.
        from ffmap.app.setup.inputs import InputOptions

        return InputOptions(self.rig, self.horizontal, self.vertical, self.time_from.value)


@dataclass(frozen=True, kw_only=True)
class RunParameters(_HowToRun):
    """Of `ffmap run`."""

    bag: Annotated[Path | None, typer.Argument(help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap.", show_default=False)] = (
        None
    )
    out: Annotated[Path | None, typer.Option(help="Run folder.  [default: runs/BAG-TIME-HASH]")] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the run that --out holds already.")] = False
    doors: Annotated[
        Doorways | None,
        typer.Option(
            help="Doorways in map.yaml: all open, as they were seen, or closed; --set grid_map.doors.  [default: open]"
        ),
    ] = None
    detail: Annotated[
        Detail, typer.Option(help="What the recording holds of each scan: everything, labels, or the map alone.")
    ] = Detail.LINES
    spawn: Annotated[bool, typer.Option("--spawn", help="Open the Rerun viewer and follow the run live.")] = False
    connect: Annotated[
        str | None, typer.Option(help="Send to a viewer that runs, as rerun+http://127.0.0.1:9876/proxy.")
    ] = None
    save: Annotated[bool, typer.Option("--save/--no-save", help="Write recording.rrd.")] = True
    outputs: Annotated[
        str | None, typer.Option(metavar="LIST", help=f"{_OUTPUTS_HELP}  [default: {','.join(RUN_OUTPUTS)}]")
    ] = None
    workers: Annotated[int | None, typer.Option(min=1, help="Labelling processes.  [default: one for each core]")] = (
        None
    )
    resume: Annotated[
        Path | None, typer.Option(help="Go on with a run folder that was killed; no other argument is needed.")
    ] = None
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Where the truth is known, print all figures as tables.")
    ] = False


@dataclass(frozen=True, kw_only=True)
class SweepParameters(_HowToRun):
    """Of `ffmap sweep`."""

    bags: Annotated[list[Path], typer.Argument(metavar="BAG", help="ROS bags, as 'ffmap run' takes them.")]
    grid: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=V,V",
            help="A setting and its values, as in doors.lines_min=2,3; with --random and --optuna also a range, as in "
            "wall_planes.similarity_m=0.02..0.08; repeatable.",
        ),
    ] = None
    random: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Try N combinations drawn at random, not all of them.")
    ] = None
    optuna: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Try N combinations, each proposed by Optuna after those before."),
    ] = None
    objective: Annotated[
        str, typer.Option(help="Figure to rank runs by, and for --optuna to optimise; of errors and times the lowest.")
    ] = "wall_f1"
    seed: Annotated[
        int, typer.Option(min=0, help="Of --random and --optuna: the same seed, the same combinations.")
    ] = 0
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the sweep; named again, it goes on there.  [default: runs/sweep-BAG-HASH]"),
    ] = None
    detail: Annotated[Detail, typer.Option(help="What each recording holds; see 'ffmap run'.")] = Detail.MAP
    outputs: Annotated[
        str | None, typer.Option(metavar="LIST", help=f"{_OUTPUTS_HELP}  [default: {','.join(SWEEP_OUTPUTS)}]")
    ] = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Runs at once, one thread each.  [default: one for each core]")
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="Run on the Dask cluster of this scheduler; needs the extra 'cluster'."
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class RoomsParameters:
    """Of `ffmap rooms`."""

    map_path: Annotated[
        Path,
        typer.Argument(
            metavar="MAP",
            help="map_server's .yaml, or an image: .png or .pgm; or a folder of them.",
            show_default=False,
        ),
    ]
    resolution: Annotated[
        float | None, typer.Option(help="Edge of a pixel in metres; needed for an image without YAML.")
    ] = None
    out: Annotated[Path | None, typer.Option(help="Folder for what is written.  [default: rooms/<map>]")] = None
    truth: Annotated[
        Path | None,
        typer.Option(help="Image of the true rooms, white and parted by lines: prints recall and precision."),
    ] = None
    doors: Annotated[Path | None, typer.Option(help="Doors that are known, as a run's doors.geojson.")] = None
    config: ConfigOption = None
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as in area_graph.passage_max_m=1.25; repeatable.")
    ] = None


P = TypeVar("P")


def with_parameters(kind: type[P]) -> Callable[[Callable[[P], None]], Callable[..., None]]:
    """Let Typer see the fields of a dataclass as the parameters of a command that takes one such dataclass."""

    def decorate(command: Callable[[P], None]) -> Callable[..., None]:
        def called(**words: object) -> None:
            command(kind(**words))

        hints = get_type_hints(kind, include_extras=True)
        parameters = inspect.signature(kind).parameters.values()
        called.__name__, called.__doc__ = command.__name__, command.__doc__
        called.__annotations__ = {parameter.name: hints[parameter.name] for parameter in parameters}
        called.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
            [parameter.replace(annotation=hints[parameter.name]) for parameter in parameters]
        )
        return called

    return decorate


def one_for_each_core(workers: int | None) -> int:
    """The number of processes that was asked for, or that of the machine's cores."""
    return workers or os.cpu_count() or 1
