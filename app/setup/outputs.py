"""The files that a run writes, and the amount of detail in its recording."""

from enum import StrEnum

from ffmap.loaders.errors import InputError


class Detail(StrEnum):
    """Detail of the recording of each scan."""

    LINES = "lines"
    """Every intermediate."""
    SCANS = "scans"
    """The labelled cloud, planes and doors, without lines and curves."""
    MAP = "map"
    """Nothing but poses and metrics."""


class Output(StrEnum):
    """Values of `--outputs`.

    run.json, trajectory.tum and, with ground truth, metrics.json are always written.
    """

    RECORDING = "recording"
    """recording.rrd and, with ground truth, evaluation.rrd."""
    LABELLED_BAG = "labelled-bag"
    """labelled.bag or labelled/: every vertical cloud with its labels."""
    LABELS = "labels"
    """labels.parquet, a thousandth of the labelled bag; compare, inspect and evaluate read it."""
    CLOUD = "cloud"
    """cloud.ply."""
    MAPS = "maps"
    """map.yaml and map.pgm, and the maps that the paper compares with."""
    PLAN = "plan"
    """floorplan.svg and floorplan.dxf."""
    GEOJSON = "geojson"
    """walls, doors, passages and rooms.geojson, rooms.osm, rooms_NAME.geojson of other maps."""


RUN_OUTPUTS = tuple(output for output in Output if output is not Output.LABELLED_BAG)
"""Default of a run: the labelled bag is larger than all of these together."""
SWEEP_OUTPUTS = (Output.RECORDING, Output.LABELS, Output.MAPS, Output.GEOJSON)
"""Default of each run of a sweep: everything that figures are computed from."""


def parse_outputs(text: str | None, default: tuple[Output, ...]) -> tuple[Output, ...]:
    """Parse a list like recording,maps; a list like +labelled-bag adds to `default`.

    Raises InputError that names an unknown output and lists the known ones.
    """
    if text is None:
        return default
    known = [output.value for output in Output]
    wanted = {name.strip() for name in text.removeprefix("+").split(",")}
    if text.startswith("+"):
        wanted |= set(default)
    for name in sorted(wanted):
        if name not in known:
            choices = ",".join(known)
            raise InputError(f"--outputs: there is no output {name!r}; choose among {choices}")
    return tuple(output for output in Output if output in wanted)
