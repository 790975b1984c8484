"""Options and arguments that several commands share."""

import os
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from ffmap.app.setup import outputs

CORES = os.cpu_count() or 1
RUN_OUTPUTS = ",".join(outputs.RUN_OUTPUTS)
SWEEP_OUTPUTS = ",".join(outputs.SWEEP_OUTPUTS)


def _rig_file(rig: Path | None) -> Path | None:
    """Return the file of --rig, which may be the name of a built-in rig."""
    # Imported here, so that '--help' starts at once.
    from ffmap.loaders.rig_file import rig_path

    return rig_path(rig) if rig is not None else None


BAG = Argument(
    metavar="BAG",
    show_default=False,
    help="ROS 1 .bag, ROS 2 folder, .db3 or .mcap; or all files of a drive, in any order, or their "
    "folder.",
)
Bag = Annotated[list[Path], BAG]
RunFolder = Annotated[Path, Argument(metavar="RUN", show_default=False, help="Run folder.")]

Rig = Annotated[
    Path | None,
    Option(
        callback=_rig_file,
        help="TOML file with the extrinsics of the lidars, or the name of a built-in rig "
        "('ffmap rigs'); takes precedence over /tf_static.",
    ),
]
Horizontal = Annotated[str | None, Option(help="Topic of the lidar for localization.")]
Vertical = Annotated[
    list[str] | None, Option(help="Topic of a lidar whose clouds are labelled; repeatable.")
]
TimeFrom = Annotated[
    Literal["auto", "azimuth", "none"],
    Option(help="Times of the points: from the cloud, from the azimuth, or none."),
]

Config = Annotated[Path | None, Option(help="Settings as TOML; see 'ffmap settings'.")]
Set = Annotated[
    list[str] | None,
    Option("--set", help="One setting, as in relabelling.range_noise_m=0.03; repeatable."),
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
Detail = Annotated[
    outputs.Detail,
    Option(help="Detail of the recording: all intermediates, labels of scans, or the map."),
]
Outputs = Annotated[
    str,
    Option(
        metavar="LIST",
        help="Files to write, as in recording,maps, or to add, as in +labelled-bag. Names: "
        f"{', '.join(outputs.Output)}.",
    ),
]
Workers = Annotated[int, Option(min=1, show_default="one per core", help="Parallel processes.")]
Scheduler = Annotated[
    str | None,
    Option(
        metavar="tcp://HOST:PORT",
        help="Work on the Dask cluster of this scheduler. Requires the extra 'cluster'.",
    ),
]
Quiet = Annotated[bool, Option("--quiet", "-q", help="Print nothing but errors.")]
Spawn = Annotated[bool, Option("--spawn", help="Open the result in the Rerun viewer.")]
