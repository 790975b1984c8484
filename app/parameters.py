"""Options and arguments that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

BAG_HELP = (
    "ROS 1 .bag, ROS 2 folder, .db3 or .mcap; or all files of a drive, in any order, or their "
    "folder."
)
OUTPUTS_HELP = (
    "Files to write, as in recording,maps, or to add, as in +labelled-bag. Names: recording, "
    "labelled-bag, labels, cloud, maps, plan, geojson."
)

Bag = Annotated[list[Path], Argument(metavar="BAG", show_default=False, help=BAG_HELP)]
RunFolder = Annotated[Path, Argument(metavar="RUN", show_default=False, help="Run folder.")]

Rig = Annotated[
    Path | None,
    Option(
        help="TOML file with the extrinsics of the lidars, or the name of a built-in rig "
        "('ffmap rigs'); takes precedence over /tf_static."
    ),
]
Horizontal = Annotated[str | None, Option(help="Topic of the lidar for localization.")]
Vertical = Annotated[
    list[str] | None,
    Option(help="Topic of a lidar whose clouds are labelled; repeatable."),
]
TimeFrom = Annotated[
    Literal["auto", "azimuth", "none"],
    Option(help="Times of the points: from the cloud, from the azimuth, or none."),
]

Config = Annotated[Path | None, Option(help="Settings as TOML; see 'ffmap settings'.")]
Set = Annotated[
    list[str] | None,
    Option("--set", help="One setting, as in wall_planes.similarity_m=0.05; repeatable."),
]
Trajectory = Annotated[
    str | None,
    Option(help="Poses T_map_base instead of the odometry: a TUM file, or a topic of the bag."),
]
TrajectoryFrame = Annotated[
    str | None,
    Option(
        metavar="FRAME",
        help="Frame of the poses of --trajectory.  [default: detected from the clouds]",
    ),
]
Mount = Annotated[
    Literal["refine", "as-given"],
    Option(
        help="Refine extrinsics and clock offset of vertical lidars if the first seconds show "
        "that they are off, or use them as given."
    ),
]
Evaluate = Annotated[bool, Option(help="Evaluate the run if the bag holds ground truth.")]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print nothing but errors.")]
Spawn = Annotated[bool, Option("--spawn", help="Open the result in the Rerun viewer.")]
