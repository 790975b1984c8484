"""The names of the files in the folder of a run, and places that commands may write to."""

import tempfile
from functools import cache
from pathlib import Path

from ffmap.loaders.errors import InputError

RUN_JSON = "run.json"
RECORDING = "recording.rrd"
EVALUATION = "evaluation.rrd"
TRAJECTORY = "trajectory.tum"
CLOUD = "cloud.ply"
LABELLED_BAG = "labelled.bag"
LABELLED_FOLDER = "labelled"
LABELS = "labels.parquet"
METRICS = "metrics.json"
WALLS = "walls.geojson"
DOORS = "doors.geojson"
PASSAGES = "passages.geojson"
ROOMS = "rooms.geojson"
ROOMS_OSM = "rooms.osm"
FLOOR_PLAN_SVG = "floorplan.svg"
FLOOR_PLAN_DXF = "floorplan.dxf"
OVERLAY = "overlay.png"
SPOOL = "spool"
"""Folder of finished blocks of scans, from which a killed run is resumed."""
SWEEP_TABLE = "sweep.csv"
"""In the folder of a sweep, beside its runs."""


def map_file(name: str) -> str:
    """Name a grid map: map.yaml for the furniture-free one, map_NAME.yaml for the others."""
    # Imported here, as below: `ffmap runs` needs no algorithms.
    from ffmap.blueprints.entities import FURNITURE_FREE

    return "map.yaml" if name == FURNITURE_FREE else f"map_{name}.yaml"


def rooms_file(name: str) -> str:
    """Name the rooms of a map: rooms.geojson for the furniture-free one, or rooms_NAME.geojson."""
    from ffmap.algorithms.maps.area_graph import Segmented

    return ROOMS if name == Segmented.FURNITURE_FREE else f"rooms_{name}.geojson"


@cache
def file_names() -> frozenset[str]:
    """List all files and folders that commands write into the folder of a run."""
    from ffmap.algorithms.maps.area_graph import Segmented
    from ffmap.algorithms.maps.rivals import Rival
    from ffmap.blueprints.entities import FURNITURE_FREE

    names = {RUN_JSON, RECORDING, EVALUATION, TRAJECTORY, CLOUD, LABELLED_BAG, LABELLED_FOLDER}
    names |= {LABELS, METRICS, WALLS, DOORS, PASSAGES, ROOMS_OSM, OVERLAY, SPOOL}
    names |= {FLOOR_PLAN_SVG, FLOOR_PLAN_DXF}
    names |= {rooms_file(name) for name in Segmented}
    for name in (FURNITURE_FREE, *Rival):
        names |= {map_file(name), str(Path(map_file(name)).with_suffix(".pgm"))}
    return frozenset(names)


def check_no_run_loses(path: Path, option: str = "--out") -> None:
    """Raise InputError where this file belongs to a run. option: names the path."""
    if path.name in file_names() and (path.parent / RUN_JSON).exists():
        raise InputError(
            f"{path}: belongs to the run in that folder; give another place to {option}"
        )


def require_writable(folder: Path, instead: str) -> None:
    """Create a folder, and try to write in it.

    Raises InputError where that fails. instead: what the user can do.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); {instead}") from error
