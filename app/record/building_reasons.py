"""The evidence for walls, doors, windows and refused faces, in labels and tables."""

from collections.abc import Sequence

import numpy as np

from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.model import CELL_M, Support, Windows
from ffmap.algorithms.building.parse import Kind
from ffmap.algorithms.building.verdicts import FaceVerdict
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.record.tables import fields_table, table

REFUSALS: dict[int, str] = {
    FaceVerdict.ENDS_LOW: "rays pass above it, below the ceiling (a leaf, a cupboard)",
    FaceVerdict.HANGS: "it is open below over more than a doorway (a duct, a beam)",
    FaceVerdict.ALONE: "few scans saw it, no wall is parallel or square to it, it shows no wall "
    "up to the ceiling (a side of furniture)",
    FaceVerdict.OUTSIDE: "neither floor nor ceiling was seen before it (a house across the street)",
}
"""Why a face is not a wall."""

_ODDS = """\
Walls, doors and windows are stretches of wall faces. *Odds* are natural logarithms (nats) of the
likelihood of the kind against the next best kind, *against* (*gap*: the face ends; *low*: it ends
below the ceiling; *hidden*: objects before it mix with it). *On* are the rays that ended on the
face or in its recess, *behind* those that ended farther behind, and *seen* the share of its 5 cm
cells that rays crossed. *Sheet* is what closes an opening: the share of the rays into it that ended
at one depth behind the face, and in brackets the share of its 20 cm patches that returned any.
Numbers are those of the entities (`walls/007`, its picture `faces/007`) and of `walls.geojson`.
"""
_DOORS = """\
## Doors
A door has wall above it, or an overlight. Below, rays pass (open), or end on a leaf (closed).
A closed leaf is recessed, differs from its wall in intensity, or is made of glass.

Confidence is the share of its rays that agree × the share of its 5 cm columns that are decided. A
leaf that is flush with its wall has no odds, but a contrast of its intensity.
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


def words(kind: int) -> str:
    """Return the name of a kind of stretch."""
    return Kind(kind).name.lower().replace("_", " ")


def short_reasons(support: Support) -> list[str]:
    """Return the odds of each, against the next best kind."""
    return [
        f"intensity differs by {contrast:.0%}"
        if np.isfinite(contrast)
        else f"odds {odds:.0f} nats against {words(second)}"
        if second >= 0
        else "not parsed"
        for odds, second, contrast in zip(
            support.odds, support.second, support.contrast, strict=True
        )
    ]


def reasons(support: Support) -> list[str]:
    """Return the odds of each, and what they rest on."""
    rays = zip(support.on, support.behind, support.seen, strict=True)
    whole = zip(short_reasons(support), rays, _sheets(support, " of patches"), strict=True)
    return [
        why
        + (f"; {on:,.0f} rays ended on it, {behind:,.0f} behind" if on + behind else "")
        + (f"; {seen:.0%} of its cells seen" if np.isfinite(seen) else "")
        + (f"; sheet {sheet}" if sheet != "–" else "")
        for why, (on, behind, seen), sheet in whole
    ]


def _numbered(support: Support, **columns: Sequence[object]) -> dict[str, Sequence[object]]:
    """Return columns of a table: the number of each, more columns, odds and rays."""
    known = support.second >= 0
    return {
        "number": range(len(support)),
        **columns,
        "odds (nats)": [f"{odds:.0f}" if np.isfinite(odds) else "–" for odds in support.odds],
        "against": [
            words(kind) if kind >= 0 else f"contrast {step:.0%}" if np.isfinite(step) else "–"
            for kind, step in zip(support.second, support.contrast, strict=True)
        ],
        **{
            name: [f"{n:,.0f}" if own else "–" for n, own in zip(rays, known, strict=True)]
            for name, rays in (("on", support.on), ("behind", support.behind))
        },
        "seen": [f"{share:.0%}" if np.isfinite(share) else "–" for share in support.seen],
    }


def _sheets(support: Support, of_patches: str = "") -> list[str]:
    """Return what closes each opening: share of rays, share of patches, depth."""
    sheets = zip(support.sheet_share, support.sheet_m, support.sheet_patches, strict=True)
    return [
        f"{share:.0%} ({patches:.0%}{of_patches}) at {depth_m:.2f} m" if np.isfinite(share) else "–"
        for share, depth_m, patches in sheets
    ]


def building_document(building: BuildingModel) -> str:
    """Return the tables in Markdown."""
    doors, judged, foreground = building.doors, building.judged, building.foreground
    parts = [_ODDS, _DOORS, "None."]
    if len(doors):
        states = [DoorState(state).name.lower() for state in doors.state]
        columns = _numbered(doors.support, state=states) | {"sheet": _sheets(doors.support)}
        measured = "confidence", "crossed", "head_m", "scan_count"
        of_doors = fields_table(doors, *measured, **columns)
        parts = [_ODDS, _DOORS, of_doors]
    if len(judged.refused):
        why = [REFUSALS[verdict] for verdict in judged.verdict]
        refused = fields_table(
            judged.refused, "scan_count", **_numbered(judged.refused.support, why=why)
        )
        parts += ["## Faces that are not walls", refused]
    if len(building.walls):
        walls = fields_table(
            building.walls, "scan_count", "rms_m", **_numbered(building.walls.support)
        )
        parts += ["## Walls", walls]
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
            columns = {}
            if isinstance(found, Windows):
                columns = _numbered(found.support) | {"sheet": _sheets(found.support)}
            parts += [f"## {heading}", text, fields_table(found, *fields, **columns)]
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
