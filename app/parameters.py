"""Options and arguments that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

BAG_HELP = (
    "ROS 1 .bag, ROS 2 folder, .db3 or .mcap; or all files of one drive, in any order, or the "
    "folder that holds them."
)
OUTPUTS_HELP = (
    "What is written, as in recording,maps, or what is written too, as in +labelled-bag: of "
    "recording, labelled-bag, labels, cloud, maps, plan, geojson."
)

Bag = Annotated[list[Path], Argument(metavar="BAG", show_default=False, help=BAG_HELP)]
RunFolder = Annotated[Path, Argument(metavar="RUN", show_default=False, help="Run folder.")]

Rig = Annotated[
    Path | None,
    Option(
        help="TOML file that says where the lidars sit, or the name of a built-in rig "
        "('ffmap rigs'); asked before /tf_static."
    ),
]
Horizontal = Annotated[str | None, Option(help="Topic of the lidar that gives the poses.")]
Vertical = Annotated[
    list[str] | None,
    Option(help="Topic of a lidar that sweeps the walls, whose clouds are labelled; repeatable."),
]
TimeFrom = Annotated[
    Literal["auto", "azimuth", "none"],
    Option(help="Times of the firings: the cloud's own, recovered from the azimuth, or none."),
]

Config = Annotated[Path | None, Option(help="Settings as TOML; see 'ffmap settings'.")]
Set = Annotated[
    list[str] | None,
    Option("--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable."),
]
Trajectory = Annotated[
    str | None,
    Option(help="Poses T_map_base in place of the odometry: a TUM file, or a topic of the bag."),
]
TrajectoryFrame = Annotated[
    str | None,
    Option(
        metavar="FRAME",
        help="The frame that --trajectory holds poses of.  [default: the one that the clouds fit]",
    ),
]
Mount = Annotated[
    Literal["refine", "as-given"],
    Option(
        help="Of two lidars or more: whether a vertical one's place and clock are refined where "
        "the first seconds show them off."
    ),
]
Evaluate = Annotated[bool, Option(help="Where a bag carries truth, compare with it.")]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print nothing but errors.")]
Spawn = Annotated[bool, Option("--spawn", help="Open it in the Rerun viewer.")]
