"""Wall faces and openings as tests need them."""

from dataclasses import fields
from typing import Any

import numpy as np

from ffmap.algorithms.building.doors import find_doors
from ffmap.algorithms.building.face_columns import TracedFaces
from ffmap.algorithms.building.model import NO_WINDOWS, Doors, Walls, Windows
from ffmap.algorithms.building.openings import OpeningRules
from ffmap.algorithms.building.ray_evidence import WallCells

CEILING_M = 2.8


Ends = tuple[tuple[float, float], tuple[float, float]]


def faces(*ends: Ends) -> Walls:
    """Faces whose normals lie to the left of the way from their first end to their second."""
    segments = np.array(ends, np.float64)
    along = segments[:, 1] - segments[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    count = len(segments)
    return Walls(
        segments,
        np.stack([-along[:, 1], along[:, 0]], axis=1),
        np.zeros(count),
        np.full(count, CEILING_M),
        np.full(count, 9, np.int32),
        np.full(count, 0.01),
        np.full(count, 900),
    )


def doors(*ends: Ends, head_m: float = 2.1, **columns: Any) -> Doors:
    """Doors of which all is 0 that is not given, and that no casing shows."""
    nothing = {field.name: np.zeros(len(ends)) for field in fields(Doors)}
    nothing |= {name: np.full(len(ends), np.nan) for name in ("casing_m", "contrast", "outline")}
    given = {name: np.array(values) for name, values in columns.items()}
    heads = np.full(len(ends), head_m)
    return Doors(**nothing | {"ends": np.array(ends), "head_m": heads} | given)


def traced(walls: Walls, cells: WallCells, clear_m: np.ndarray | float = np.nan) -> TracedFaces:
    """Faces and the rays that met them; clear_m: height of the ceiling before them, if any."""
    columns = int(cells.first[-1])
    return TracedFaces(walls, cells, np.full(columns, clear_m), np.zeros(columns))


def doors_in(faces: TracedFaces, rules: OpeningRules, windows: Windows = NO_WINDOWS) -> Doors:
    """The doors of faces before which no floor was seen."""
    return find_doors(faces, rules, windows, np.zeros(len(faces.clear_m), bool))


def window(*ends: tuple[float, float]) -> Windows:
    """A window between 0.9 and 2.2 m, its pane 10 cm behind the face."""
    normal, bottom_m, top_m = np.array([[0.0, 1.0]]), np.array([0.9]), np.array([2.2])
    return Windows(np.array([ends]), normal, bottom_m, top_m, np.array([0.1]))
