"""Wall faces and openings as tests need them."""

from dataclasses import fields
from typing import Any

import numpy as np

from ffmap.algorithms.building.evidence import Evidence
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.model import (
    NO_WALLS,
    Blinds,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
    unknown_support,
)
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.building.storey import TracedFaces
from ffmap.algorithms.building.verdicts import JudgedFaces
from ffmap.algorithms.scan.summary import Features
from tests.tracing import traced_by

CEILING_M = 2.8
NO_BLINDS = Blinds(np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))
NO_JUDGED_FACES = JudgedFaces(NO_WALLS, NO_WALLS, np.zeros(0, np.uint8))
NO_FOREGROUND = Foreground(
    np.zeros(1, np.int64), np.zeros(0), np.zeros(0), np.zeros((0, 1), bool)
)

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
        unknown_support(count),
    )


def doors(*ends: Ends, head_m: float = 2.1, **columns: Any) -> Doors:
    """Doors of which all is 0 that is not given."""
    nothing: dict[str, Any] = {field.name: np.zeros(len(ends)) for field in fields(Doors)}
    nothing["normal"] = np.zeros((len(ends), 2))
    nothing["support"] = unknown_support(len(ends))
    given = {name: np.array(values) for name, values in columns.items()}
    heads = np.full(len(ends), head_m)
    return Doors(**nothing | {"ends": np.array(ends), "head_m": heads} | given)


def traced(walls: Walls, evidence: Evidence, clear_m: np.ndarray | float = np.nan) -> TracedFaces:
    """Faces and the rays that met them; clear_m: height of the ceiling before them, if any."""
    columns = int(evidence.first[-1])
    return TracedFaces(walls, evidence, np.full(columns, clear_m), np.zeros(columns))


def parsed(walls: Walls, *scans: Features, ceiling_m: float = CEILING_M) -> ParsedFaces:
    """Faces below a ceiling, parsed by the rays of scans that stayed where they were."""
    faces = traced(walls, traced_by(walls, *scans), ceiling_m)
    return ParsedFaces.of(faces, np.zeros((0, 2)), BuildingSettings(), ParseSettings())


def window(*ends: tuple[float, float]) -> Windows:
    """A window between 0.9 and 2.2 m, its pane 10 cm behind the face."""
    normal, bottom_m, top_m = np.array([[0.0, 1.0]]), np.array([0.9]), np.array([2.2])
    pane_m = np.array([0.1])
    return Windows(np.array([ends]), normal, bottom_m, top_m, pane_m, unknown_support(1))
