"""Options that commands share, or that more than the command line reads: fields of dataclasses, as Typer's parameters."""

import os
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from ffmap.app.setup.outputs import SWEEP_OUTPUTS, Detail

if TYPE_CHECKING:
    from ffmap.app.setup.inputs import InputOptions

OUTPUTS_HELP = (
    "All that is to be written, as in recording,maps: of recording, labelled (a bag), labels (Parquet, without the clouds), "
    "cloud, maps, plan, geojson."
)


def option(default: Any = MISSING, *names: str, **options: Any) -> Any:  # noqa: ANN401 - whatever the field is
    """A field that is an option of the command line; it has to be given where there is no default."""
    return field(default=default, metadata={"parameter": typer.Option(*names, **options)})


def argument(default: Any = MISSING, show_default: bool = False, **options: Any) -> Any:  # noqa: ANN401
    """A field that is told by its place on the command line."""
    return field(default=default, metadata={"parameter": typer.Argument(show_default=show_default, **options)})


BAG_HELP = (
    "ROS 1 .bag, ROS 2 folder, .db3 or .mcap; or all files of one drive, in any order, or the folder that holds them."
)


@dataclass(frozen=True, kw_only=True)
class OfTheBag:
    """What is said of a bag."""

    rig: Path | None = option(
        None,
        help="TOML file that says where the lidars sit, or the name of a built-in rig ('ffmap rigs'); asked before /tf_static.",
    )
    horizontal: str | None = option(None, help="Topic of the lidar that gives the poses.")
    vertical: list[str] | None = option(
        None, help="Topic of a lidar that sweeps the walls, whose clouds are labelled; repeatable."
    )
    time_from: Literal["auto", "azimuth", "none"] = option(
        "auto", help="Times of the firings: the cloud's own, recovered from the azimuth, or none."
    )

    @property
    def bag_options(self) -> "InputOptions":
        # Here: with it come the loaders, which '--help' need not wait for.
        from ffmap.app.setup.inputs import InputOptions
        from ffmap.loaders.rig_file import rig_path

        rig, verticals = rig_path(self.rig) if self.rig else None, tuple(self.vertical or ())
        return InputOptions(rig, self.horizontal, verticals, self.time_from)


@dataclass(frozen=True, kw_only=True)
class HowToRun(OfTheBag):
    """What one run and the runs of a sweep have in common."""

    config: Path | None = option(None, help="Settings as TOML; see 'ffmap settings'.")
    set_: list[str] | None = option(None, "--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable.")
    trajectory: str | None = option(
        None, help="Poses T_map_base in place of the odometry: a TUM file, or a topic of the bag."
    )
    trajectory_frame: str | None = option(
        None,
        metavar="FRAME",
        help="The frame that --trajectory holds poses of.  [default: the one that the clouds fit]",
    )
    mount: Literal["refine", "as-given"] = option(
        "refine",
        help="Of two lidars or more: whether a vertical one's place and clock are refined where the first seconds show them off.",
    )
    evaluate: bool = option(True, help="Where a bag carries truth, compare with it.")
    quiet: bool = option(False, "--quiet", "-q", help="Print nothing but errors.")


@dataclass(frozen=True, kw_only=True)
class SweepParameters(HowToRun):
    bags: list[Path] = argument(
        metavar="BAG", help="ROS bags, each a drive; of one in several files, the folder that holds them."
    )
    grid: list[str] | None = option(
        None,
        metavar="NAME=V,V",
        help="A setting and its values, as in doors.lines_min=2,3; with --random and --optuna also a range, as in "
        "wall_planes.similarity_m=0.02..0.08; repeatable.",
    )
    random: int | None = option(None, min=1, metavar="N", help="Try N combinations drawn at random, not all of them.")
    optuna: int | None = option(
        None, min=1, metavar="N", help="Try N combinations, each proposed by Optuna after those before."
    )
    objective: str = option(
        "wall_f1", help="Figure to rank runs by, and for --optuna to optimise; of errors and times the lowest."
    )
    seed: int = option(0, min=0, help="Of --random and --optuna: the same seed, the same combinations.")
    out: Path | None = option(
        None, help="Folder of the sweep's runs and its table.  [default: runs/sweep-BAG]"
    )
    detail: Detail = option(Detail.MAP, help="What each recording holds; see 'ffmap run'.")
    outputs: str | None = option(None, metavar="LIST", help=f"{OUTPUTS_HELP}  [default: {','.join(SWEEP_OUTPUTS)}]")
    workers: int | None = option(None, min=1, help="Runs at once, one thread each.  [default: one for each core]")
    scheduler: str | None = option(
        None, metavar="tcp://HOST:PORT", help="Run on the Dask cluster of this scheduler; needs the extra 'cluster'."
    )


@dataclass(frozen=True, kw_only=True)
class RoomsParameters:
    map_path: Path = argument(metavar="MAP", help="map_server's .yaml, or an image: .png or .pgm; or a folder of them.")
    resolution: float | None = option(None, help="Edge of a pixel in metres; needed for an image without YAML.")
    out: Path | None = option(None, help="Folder for what is written.  [default: rooms/<map>]")
    truth: Path | None = option(
        None, help="Image of the true rooms, white and parted by lines: prints recall and precision."
    )
    doors: Path | None = option(None, help="Doors that are known, as a run's doors.geojson.")
    config: Path | None = option(None, help="Settings as TOML; see 'ffmap settings'.")
    set_: list[str] | None = option(None, "--set", help="One setting, as in area_graph.opening_ratio=0.4; repeatable.")


def one_for_each_core(workers: int | None) -> int:
    """The number of processes that was asked for, or that of the machine's cores."""
    return workers or os.cpu_count() or 1
