"""walls.geojson and doors.geojson."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m, moved
from ffmap.algorithms.building.model import Doors, Walls
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.folder.atomic import write_geojson


def write_walls(path: Path, walls: Walls, thickness_m: FloatArray) -> None:
    """Write wall faces as LineStrings; all lengths in metres, in the map frame.

    thickness_m: (W,) of each face's wall, NaN where its other side was not seen.
    """
    properties = [
        {
            "normal": walls.normal[i],
            "bottom": _millimetres(walls.bottom_m[i]),
            "top": _millimetres(walls.top_m[i]),
            "scans": walls.scan_count[i],
            "rms": walls.rms_m[i],
            "samples": walls.sample_count[i],
            "thickness": _millimetres(thickness_m[i]),
        }
        for i in range(len(walls))
    ]
    _write_lines(path, walls.ends, properties)


def write_doors(path: Path, doors: Doors, rooms: Sequence[Sequence[str | None] | None]) -> None:
    """Write doors as LineStrings along the sill between the jambs, in the map frame.

    The line is below the leaf of a closed door, and in the middle of an open one's reveals.
    rooms: names of the two rooms that each door joins, None for a room that was not mapped.
    """
    properties = [
        {
            "state": DoorState(int(doors.state[i])).name.lower(),
            "width": _millimetres(width_m),
            "height": _millimetres(doors.head_m[i]),
            "depth": _millimetres(doors.depth_m[i]),
            "confidence": doors.confidence[i],
            "crossed": bool(doors.crossed[i]),
            "rooms": rooms[i],
        }
        for i, width_m in enumerate(lengths_m(doors.ends))
    ]
    closed = doors.state == DoorState.CLOSED
    behind_m = np.nan_to_num(np.where(closed, doors.depth_m, 0.5 * doors.reveal_m))
    _write_lines(path, moved(doors.ends, doors.normal, -behind_m), properties)


def _millimetres(length_m: np.floating[Any]) -> float:
    """Round a length (m) to millimetres: it is known no better."""
    return round(float(length_m), 3)


def _write_lines(path: Path, ends: FloatArray, properties: Sequence[dict[str, object]]) -> None:
    features = [
        {"properties": own, "geometry": {"type": "LineString", "coordinates": line}}
        for own, line in zip(properties, ends, strict=True)
    ]
    write_geojson(path, features)
