"""Which files of a run folder are written, and how much the recording holds of each scan."""

from enum import StrEnum

from ffmap.loaders.errors import InputError


class Detail(StrEnum):
    """How much is logged of each scan."""

    LINES = "lines"
    """Every intermediate."""
    SCANS = "scans"
    """The labelled cloud, planes and doors; no lines and curves."""
    MAP = "map"
    """Poses, metrics and the map; nothing of the single scan."""


class Output(StrEnum):
    """What `--outputs` names; run.json, trajectory.tum and, where the truth is known, metrics.json are always written."""

    RECORDING = "recording"
    """recording.rrd and, where the truth is known, evaluation.rrd."""
    LABELLED_BAG = "labelled-bag"
    """labelled.bag or labelled/: every vertical cloud again, with its labels."""
    LABELS = "labels"
    """labels.parquet: the labels alone, a thousandth of the labelled bag; what compare, inspect and evaluate read."""
    CLOUD = "cloud"
    """cloud.ply."""
    MAPS = "maps"
    """map.yaml and map.pgm, and the maps that the paper compares with."""
    PLAN = "plan"
    """floorplan.svg and floorplan.dxf."""
    GEOJSON = "geojson"
    """walls.geojson, doors.geojson, rooms.geojson, and rooms_NAME.geojson of the maps that the paper compares with."""


RUN_OUTPUTS = tuple(output for output in Output if output is not Output.LABELLED_BAG)
"""What a single run writes: the labelled bag is larger than all of these together."""
SWEEP_OUTPUTS = (Output.RECORDING, Output.LABELS, Output.MAPS, Output.GEOJSON)
"""What each run of a sweep writes: all that its figures are made from, and no cloud."""


def parse_outputs(text: str | None, default: tuple[Output, ...]) -> tuple[Output, ...]:
    """The outputs in a list like recording,maps, each once and as ordered above, or `default`.

    A list that begins with +, as in +labelled-bag, adds to `default`.
    Raises InputError that names what is unknown and lists what is known.
    """
    if text is None:
        return default
    known = [output.value for output in Output]
    wanted = {name.strip() for name in text.removeprefix("+").split(",")}
    if text.startswith("+"):
        wanted |= set(default)
    for name in sorted(wanted):
        if name not in known:
            raise InputError(f"--outputs: there is no output {name!r}; choose among {','.join(known)}")
    return tuple(output for output in Output if output in wanted)
