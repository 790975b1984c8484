"""What was measured of doors, refused faces and windows of the building, in tables."""

import numpy as np

from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.model import CELL_M
from ffmap.algorithms.building.verdicts import FaceVerdict
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.record.tables import fields_table, table

REFUSALS: dict[int, str] = {
    FaceVerdict.ENDS_LOW: "rays pass above it, below the ceiling (a leaf, a cupboard)",
    FaceVerdict.HANGS: "it is open below over more than a doorway (a duct, a beam)",
    FaceVerdict.ALONE: "few scans saw it, no wall is parallel or square to it, it shows no wall "
    "up to the ceiling (a side of furniture)",
    FaceVerdict.LEANS: "it crosses a face that far more scans saw, askew (an open leaf)",
    FaceVerdict.OUTSIDE: "neither floor nor ceiling was seen before it (a house across the street)",
}
"""Why a face is not a wall."""

_DOORS = """\
## Doors
A door has wall above it, or an overlight. Below, rays pass (open), or end on a leaf (closed).
A closed leaf is recessed, differs from its wall in intensity, or is made of glass.

- confidence = agreement (share of its rays) × coverage (share of its 5 cm columns)
- depth: the leaf behind the wall
- lintel: share of the width with wall above
"""
_AGAINST = """\
## Clutter against walls
It covers {area_m2:.1f} m² of wall faces: there, the mean of all scans' returns is before the wall
above, from the floor up but not to the ceiling.
"""
_PANE = "pane: behind the face; – if it returned nothing.\n"
_LOW_WALLS = """\
Rays pass above them, below the ceiling. They are plane, and their other side is seen at a
wall's thickness: furniture is deeper, screens are thinner.
"""
_BLINDS = """\
A blind or shutter closes a window, or its upper part. It is set back behind its wall's face; it
is clutter.
"""


def building_document(building: BuildingModel) -> str:
    """Return the tables in Markdown."""
    doors, judged, foreground = building.doors, building.judged, building.foreground
    parts = [_DOORS, "None."]
    if len(doors):
        states = [DoorState(state).name.lower() for state in doors.state]
        of_doors = fields_table(
            doors,
            *("confidence", "agreement", "ray_count", "coverage", "crossed", "ajar", "depth_m"),
            *("glazed", "head_m", "lintel"),
            *("scan_count", "first_scan", "last_scan"),
            state=states,
        )
        parts = [_DOORS, of_doors]
    if len(judged.refused):
        why = [REFUSALS[verdict] for verdict in judged.verdict]
        refused = fields_table(judged.refused, "scan_count", why=why)
        parts += ["## Faces that are not walls", refused]
    if foreground.covered.any():
        area_m2 = np.count_nonzero(foreground.covered) * CELL_M**2
        parts.append(_AGAINST.format(area_m2=area_m2))
    between = "bottom_m", "top_m"
    for heading, text, found, fields in (
        ("Windows", _PANE, building.windows, (*between, "pane_m")),
        ("Panes of open leaves", _PANE, building.leaf_panes, (*between, "pane_m")),
        ("Low walls", _LOW_WALLS, building.low_walls, ("top_m", "rms_m")),
        ("Blinds and shutters", _BLINDS, building.blinds, (*between, "behind_m")),
    ):
        if len(found):
            parts += [f"## {heading}", text, fields_table(found, *fields)]
    if building.levels:
        rows = []
        for level in building.levels:
            area_m2 = np.count_nonzero(level.known) * level.cell_m**2
            low_m, high_m = np.nanmin(level.low_m), np.nanmax(level.high_m)
            surface = level.surface.replace("_", " ")
            rows.append((surface, level.cell_m, f"{area_m2:.1f}", f"{low_m:.2f} – {high_m:.2f}"))
        headings = "surface", "cells (m)", "area (m²)", "heights in the map (m)"
        parts += ["## Level surfaces that only all scans show", table(headings, rows)]
    return "\n\n".join(parts)
