"""In words, for the recording: why each door is a door, and why faces that look like walls are none."""

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.height_map import HeightMap, Surface
from ffmap.algorithms.building.model import CELL_M, Blinds, Doors, Mullions, Walls, Windows
from ffmap.algorithms.scan.doors import DoorState
from ffmap.app.record.shapes import table
from ffmap.blueprints import entities

_DOORS = """\
## Doors

A door has wall above it, or an overlight; below, a ray either goes on (open) or ends on a leaf that is recessed down to the floor
(closed). A closed leaf that is flush, or whose recess does not show, shows by its casing or its finish, one of glass by its pane,
which most rays pass, and a sliding one by hanging before its wall.
Confidence = share of its rays that agree × share of its columns (5 cm) that are decided so by themselves, or that an open
door's leaf covers; a door that the robot drove through is open for sure.

"""
_AGAINST = """
## What stands against walls

{area_m2:.1f} m² of wall faces are covered: there the mean of all scans' returns lies before the wall above, from the floor up
but not to the ceiling. That is clutter, though single scans take it for the wall.
"""
_MULLIONS = """
## Mullions

A mullion is narrow, returns rays from the foot of a pane to its head, and has a pane on either side; it is wall.

"""
_LOW_WALLS = """
## Low walls

Rays pass above them, below the ceiling. But they are plane, and their other side is seen a wall's thickness behind, as high as they
are, or up to the ceiling of a room within the room: furniture is deeper, screens are thinner.

"""
_BLINDS = """
## What hangs in windows

A lintel lies in its wall's face, and returns as much of a beam. What closes the upper part of a window, higher than a frame is
wide, and lies farther back, or returns more or less, is a blind or a shutter: clutter.

"""


def explain_building(building: BuildingModel) -> str:
    """Markdown: what the building's doors, refused faces, windows and what stands against walls were judged by."""
    foreground, judged, doors, windows = building.foreground, building.judged, building.doors, building.windows
    headings = "door", "width", "confidence", "what held", "scans", "at x, y (m)"
    rows = [_door(doors, d) for d in range(len(doors))] or [("none", "", "", "", "", "")]
    parts = [_DOORS + table(headings, rows)]
    if len(judged.refused):
        faces, length_m = judged.refused, lengths_m(judged.refused.ends)
        refusals = [
            (_place(faces.ends[f]), f"{length_m[f]:.2f} m", entities.REFUSALS[verdict], faces.scan_count[f])
            for f, verdict in enumerate(judged.verdict)
        ]
        parts.append(
            "\n## Faces that are no walls\n\n" + table(("at x, y (m)", "length", "why", "seen on scans"), refusals)
        )
    if foreground.covered.any():
        parts.append(_AGAINST.format(area_m2=np.count_nonzero(foreground.covered) * CELL_M**2))
    for heading, glass in (("Windows", windows), ("Panes of open leaves", building.leaf_panes)):
        if len(glass):
            panes = [_window(glass, w) for w in range(len(glass))]
            parts.append(f"\n## {heading}\n\n" + table(("at x, y (m)", "width", "from – to height", "pane"), panes))
    if len(low := building.low_walls):
        sides = [_low_wall(low, w) for w in range(len(low))]
        parts.append(_LOW_WALLS + table(("at x, y (m)", "length", "height", "its returns scatter by"), sides))
    if len(mullions := building.mullions):
        stand = [_mullion(mullions, m) for m in range(len(mullions))]
        parts.append(_MULLIONS + table(("at x, y (m)", "width", "from – to height", "out of its pane"), stand))
    if len(blinds := building.blinds):
        hung = [_blind(blinds, b) for b in range(len(blinds))]
        parts.append(_BLINDS + table(("at x, y (m)", "width", "from – to height", "what held"), hung))
    if building.levels:
        told = "\n## Level surfaces\n\nTold from all scans, where single ones took them for something else.\n\n"
        surfaces = [_level(level) for level in building.levels]
        parts.append(told + table(("what", "area", "between heights in the map"), surfaces))
    return "\n".join(parts)


def _door(doors: Doors, d: int) -> tuple[str, ...]:
    state = DoorState(int(doors.state[d]))
    held = [f"{doors.agreement[d]:.0%} of {doors.ray_count[d]:,} rays in {doors.coverage[d]:.0%} of its columns"]
    if doors.crossed[d]:
        held.insert(0, "the robot drove through")
    if state == DoorState.CLOSED:
        depth_cm, side = 100 * abs(doors.depth_m[d]), "behind" if doors.depth_m[d] > 0.0 else "before"
        held.append("leaf flush with the wall" if depth_cm == 0.0 else f"leaf {depth_cm:.1f} cm {side} the wall")
    if np.isfinite(doors.contrast[d]):
        held.append(f"leaf {_returns(doors.contrast[d])}")
    if np.isfinite(doors.outline[d]):
        held.append(f"outline {_returns(doors.outline[d])}")
    if np.isfinite(doors.casing_m[d]):
        held.append(f"casing {1000 * doors.casing_m[d]:.0f} mm before the wall")
    if doors.glazed[d]:
        held.append("leaf of glass, with wall on both sides and above")
    if doors.ajar[d]:
        held.append("its leaf stands aslant")
    held.append(f"head at {doors.head_m[d]:.2f} m, wall seen above {doors.lintel[d]:.0%} of it")
    scans = f"{doors.scan_count[d]} from {doors.first_scan[d]} to {doors.last_scan[d]}" if doors.scan_count[d] else "–"
    name, width = f"{d} {state.name.lower()}", f"{lengths_m(doors.ends)[d]:.2f} m"
    return name, width, f"{doors.confidence[d]:.0%}", "; ".join(held), scans, _place(doors.ends[d])


def _window(windows: Windows, w: int) -> tuple[str, ...]:
    pane_m = windows.pane_m[w]
    pane = f"{100 * pane_m:.0f} cm behind the face" if np.isfinite(pane_m) else "returned nothing"
    return *_extent(windows, w), pane


def _low_wall(low: Walls, w: int) -> tuple[str, ...]:
    length_m = float(lengths_m(low.ends[[w]])[0])
    return _place(low.ends[w]), f"{length_m:.2f} m", f"{low.top_m[w]:.2f} m", f"{1000 * low.rms_m[w]:.0f} mm"


def _mullion(mullions: Mullions, m: int) -> tuple[str, ...]:
    return *_extent(mullions, m), f"{100 * mullions.out_m[m]:.0f} cm"


def _blind(blinds: Blinds, b: int) -> tuple[str, ...]:
    behind_m, contrast = blinds.behind_m[b], blinds.contrast[b]
    held = [f"{100 * behind_m:.1f} cm behind the wall"]
    if np.isfinite(contrast):
        held.append(_returns(contrast))
    return *_extent(blinds, b), "; ".join(held)


def _extent(stretches: Windows | Mullions | Blinds, k: int) -> tuple[str, str, str]:
    """Where one of them is, how wide, and between which heights."""
    heights = f"{stretches.bottom_m[k]:.2f} – {stretches.top_m[k]:.2f} m"
    return _place(stretches.ends[k]), f"{lengths_m(stretches.ends)[k]:.2f} m", heights


def _returns(contrast: float) -> str:
    return f"returns {100 * abs(contrast):.0f} % {'more' if contrast > 0 else 'less'} than the wall"


def _level(level: HeightMap) -> tuple[str, ...]:
    name = level.surface.replace("_", " ")
    area_m2 = np.count_nonzero(level.known) * level.cell_m**2
    cells = f" (cells of {level.cell_m:.1f} m)" if level.surface == Surface.RAISED_FLOOR else ""
    return f"{name}{cells}", f"{area_m2:.1f} m²", f"{np.nanmin(level.low_m):.2f} – {np.nanmax(level.high_m):.2f} m"


def _place(ends: FloatArray) -> str:
    x, y = ends.mean(axis=0)
    return f"{x:.2f}, {y:.2f}"
