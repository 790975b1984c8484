"""Why each point line is, or is not, in a wall or above a door: conditions with measured values."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, UInt8Array
from ffmap.algorithms.scan.doors import (
    EXCEPTIONS_MAX,
    HEIGHT_MAX_M,
    OPEN_DEPTH_M,
    Depression,
    DoorState,
)
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.point_lines import POINTS_MIN
from ffmap.algorithms.scan.wall_candidates import Reach
from ffmap.algorithms.scan.wall_planes import BOTTOM_MAX_M, LENGTH_MIN_M, Membership
from ffmap.app.record.tables import fields_table, table
from ffmap.blueprints.entities import LINE_OUTCOMES, LineOutcome

CONDITION_HEADINGS = ("condition", "measured", "limit", "met")


@dataclass(frozen=True)
class Condition:
    """One condition of the method; met: None if it decides nothing."""

    name: str
    measured: str
    limit: str
    met: bool | None

    def __str__(self) -> str:
        return f"{self.name}: {self.measured} (limit {self.limit})"


@dataclass(frozen=True)
class LineReason:
    """The conditions of a line, in the order of the method, and the result in half a line."""

    line: int
    outcome: LineOutcome
    short: str
    conditions: tuple[Condition, ...]

    @property
    def sentence(self) -> str:
        """The result as a sentence; empty without one."""
        return f"{self.short[:1].upper()}{self.short[1:]}." if self.short else ""


def line_outcomes(labelling: ScanLabelling) -> UInt8Array:
    """Return the `LineOutcome` of each line."""
    planes, doors = labelling.planes, labelling.door_lines
    outcome = np.full(len(labelling.lines), LineOutcome.NO_STRUCTURE, np.uint8)
    # A line is in a plane if any of its candidates is.
    outcome[planes.candidates.line[planes.candidate_plane < 0]] = LineOutcome.REFUSED
    outcome[planes.candidates.line[planes.candidate_plane >= 0]] = LineOutcome.WALL
    outcome[doors.line[doors.above_door]] = LineOutcome.DOOR
    return outcome


def candidate_reasons(labelling: ScanLabelling) -> list[str]:
    """Return why each wall candidate was taken or refused."""
    return [_candidate_reason(labelling, c) for c in range(len(labelling.planes.candidates.line))]


def door_reasons(labelling: ScanLabelling) -> list[str]:
    """Return why each line of a wall plane is above a door, or not."""
    return [_door_reason(labelling, d) for d in range(len(labelling.door_lines.line))]


def explain_lines(labelling: ScanLabelling) -> list[LineReason]:
    """Return the reason of each line of a scan."""
    outcomes = enumerate(line_outcomes(labelling))
    return [_explain(labelling, line, LineOutcome(outcome)) for line, outcome in outcomes]


def name_of(line: int) -> str:
    return f"line {line} (pair {line // 2}, side {line % 2})"


def _explain(labelling: ScanLabelling, line: int, outcome: LineOutcome) -> LineReason:
    structures, planes = labelling.structures, labelling.planes
    conditions = [_has_samples(labelling, line)]
    if conditions[-1].met:
        conditions.append(_has_structure(labelling, line))
    if not conditions[-1].met:
        return LineReason(line, outcome, str(conditions[-1]), tuple(conditions))
    reasons = []
    for c in np.flatnonzero(planes.candidates.line == line).tolist():
        # A lower structure that reaches a ceiling is a candidate too: a wall below a lintel.
        upmost = planes.candidates.structure[c] == structures.upmost[line]
        reasons.append(_candidate_reason(labelling, c))
        conditions += _candidate_conditions(labelling, c, "" if upmost else " (lower)")
    door_lines = np.flatnonzero(labelling.door_lines.line == line).tolist()
    for d in door_lines[:1]:
        conditions += _door_conditions(labelling, d)
        if outcome == LineOutcome.DOOR:
            reasons.append(_door_reason(labelling, d))
    if not door_lines:
        conditions.append(Condition("III.C, door 1: in a wall plane", "in none", "in one", False))
    return LineReason(line, outcome, "; ".join(reasons), tuple(conditions))


def _has_samples(labelling: ScanLabelling, line: int) -> Condition:
    lines = labelling.lines
    returns, met = lines.starts[line + 1] - lines.starts[line], lines.samples[line, 0] >= 0
    name = "III.A: returns without floor and ceiling"
    return Condition(name, f"of {returns} returns", f"≥ {POINTS_MIN}", bool(met))


def _has_structure(labelling: ScanLabelling, line: int) -> Condition:
    structures, settings = labelling.structures, labelling.settings.vertical_structures
    found = np.count_nonzero(structures.line == line)
    name = "III.B, eq. 2: neighbouring upright samples, without a jump"
    measured = f"longest run {_longest_run(structures.upright[line])}, {found} structures"
    limit = f"≥ {settings.points_min} within ±{settings.slope_max:g}"
    return Condition(name, measured, limit, bool(found))


def _reaches_ceiling(labelling: ScanLabelling, c: int) -> Condition:
    planes, settings = labelling.planes, labelling.settings.wall_planes
    reach, below_m = Reach(planes.candidates.reach[c]), planes.candidates.below_ceiling_m[c]
    top_m = labelling.structures.top_m[planes.candidates.structure[c]]
    measured, limit = f"top at {top_m:.2f} m", f"≥ {settings.height_min_m:g} m"
    if not np.isnan(below_m):
        measured, limit = f"{_cm(below_m)} below the ceiling", f"≤ {_cm(settings.reach_m)}"
    exception = {
        Reach.ABOVE_CEILINGS: "above all ceilings",
        Reach.TURNS_BACK: "no ceiling in its line",
        Reach.OVERHUNG: "overhung up to a ceiling",
    }.get(reach)
    measured += f", {exception}" if exception else ""
    return Condition("III.B: reaches the ceiling", measured, limit, reach != Reach.LOW)


def _membership(labelling: ScanLabelling, c: int) -> Condition:
    """Return the condition that decided whether a candidate is in a wall plane."""
    planes, settings = labelling.planes, labelling.settings.wall_planes
    nearest_m, similar = planes.candidate_nearest_m[c], f"< {_cm(settings.similarity_m)}"
    few = f"≥ {settings.lines_min} lines"
    match Membership(planes.candidate_membership[c]):
        case Membership.IN_PLANE:
            plane = planes.candidate_plane[c]
            return Condition(f"Alg. 1: distance to plane {plane}", _cm(nearest_m), similar, True)
        case Membership.REFUSED:
            return _reaches_ceiling(labelling, c)
        case Membership.ALONE:
            peers = np.count_nonzero(planes.candidate_grown == planes.candidate_grown[c])
            nearest = "no other near" if np.isnan(nearest_m) else f"nearest {_cm(nearest_m)} away"
            measured = f"of {peers} lines, {nearest}"
            return Condition("Alg. 1: its plane", measured, f"{few}, or {similar}", False)
        case Membership.FEW_LINES:
            return Condition("Alg. 1: lines left in its plane", "fewer", few, False)
        case Membership.SHORT:
            limit = f"≥ {_cm(LENGTH_MIN_M)}"
            return Condition("III.B: length of its plane", "shorter", limit, False)
        case Membership.ROUGH:
            limit = f"≤ {_cm(settings.similarity_m)}"
            return Condition("Alg. 1: RMS of its plane", "more", limit, False)
        case Membership.DUCT:
            bottom_m = labelling.structures.bottom_m[planes.candidates.structure[c]]
            limit = f"≤ {BOTTOM_MAX_M:g} m in one line"
            name = "III.B: lower edge (else a duct)"
            return Condition(name, f"at {bottom_m:.2f} m", limit, False)


def _candidate_conditions(labelling: ScanLabelling, c: int, which: str) -> list[Condition]:
    """which: added to the names of the conditions."""
    planes, settings = labelling.planes, labelling.settings.wall_planes
    conditions = [_reaches_ceiling(labelling, c)]
    for name, measured_m, limit_m in (
        ("Alg. 1: Θ to the growing plane", planes.candidate_distance_m[c], settings.similarity_m),
        (
            "Alg. 1: distance to its last line",
            planes.candidate_gap_m[c],
            planes.candidates.gap_max_m[c],
        ),
    ):
        if not np.isnan(planes.candidate_distance_m[c]):
            near = bool(measured_m < limit_m)
            conditions.append(Condition(name, _cm(measured_m), f"< {_cm(limit_m)}", near))
    if conditions[0].met:
        conditions.append(_membership(labelling, c))
    return [Condition(k.name + which, k.measured, k.limit, k.met) for k in conditions]


def _candidate_reason(labelling: ScanLabelling, c: int) -> str:
    planes = labelling.planes
    plane = planes.candidate_plane[c]
    if plane < 0:
        return f"refused: {_membership(labelling, c)}"
    return f"taken: plane {plane}, {_cm(planes.candidate_nearest_m[c])} off"


def _is_behind(labelling: ScanLabelling, d: int) -> Condition:
    """Return the second condition of a door, with the measurement that decided it."""
    doors, settings = labelling.door_lines, labelling.settings.doors
    name, recess = "III.C, door 2: all below is behind", f"≥ {_cm(settings.recess_min_m)}"
    share, behind_m = doors.on_plane_share[d], -doors.below_m[d]
    if doors.behind[d]:
        measured = f"{_cm(behind_m)}, {share:.0%} on the plane"
        limit = f"{recess}, ≤ {EXCEPTIONS_MAX:.0%} on it"
        return Condition(name, measured, limit, True)
    match Depression(doors.depression[d]):
        case Depression.FEW_RETURNS:
            measured, limit = "too few returns at the plane and behind it", recess
        case Depression.NONE if np.isnan(doors.recess_m[d]):
            measured, limit = "line too short below the lintel", recess
        case Depression.NONE:
            measured, limit = f"recedes by {_cm(doors.recess_m[d])}", recess
        case Depression.ABOVE_OFF_PLANE:
            measured = f"above the recess {_cm(abs(doors.above_m[d]))} off the plane"
            limit = "on it"
        case Depression.SHALLOW:
            measured, limit = _cm(behind_m), recess
        case Depression.EXCEPTIONS:
            measured, limit = f"{share:.0%} on the plane", f"≤ {EXCEPTIONS_MAX:.0%}"
        case Depression.HELD:
            measured, limit = "nothing behind", recess
    return Condition(name, measured, limit, False)


def _is_high(labelling: ScanLabelling, d: int) -> Condition:
    doors, settings = labelling.door_lines, labelling.settings.doors
    measured = f"begins at {doors.start_height_m[d]:.2f} m"
    limit = f"{settings.height_min_m:g}–{HEIGHT_MAX_M:g} m"
    return Condition("III.C, door 3: height", measured, limit, bool(doors.high_enough[d]))


def _door_conditions(labelling: ScanLabelling, d: int) -> list[Condition]:
    doors, openings = labelling.door_lines, labelling.openings
    settings = labelling.settings.doors
    behind = _is_behind(labelling, d)
    plane = f"plane {doors.plane[d]}"
    conditions = [Condition("III.C, door 1: in a wall plane", plane, "in one", True), behind]
    if not behind.met:
        return conditions
    opening = int(openings.door_line_opening[d])
    lines = f"opening {opening}: {openings.line_count[opening]}" if opening >= 0 else "in none"
    open_depth = f"open > {_cm(OPEN_DEPTH_M)}"
    depth = f"{_cm(doors.depth_m[d])}: {DoorState(doors.state[d]).name.lower()}"
    return [
        *conditions,
        _is_high(labelling, d),
        Condition("III.C: depth", depth, open_depth, None),
        Condition("neighbouring lines", lines, f"≥ {settings.lines_min}", opening >= 0),
    ]


def _door_reason(labelling: ScanLabelling, d: int) -> str:
    doors, opening = labelling.door_lines, int(labelling.openings.door_line_opening[d])
    for condition_of in (_is_behind, _is_high):
        if not (condition := condition_of(labelling, d)).met:
            return f"no door: {condition}"
    state, depth = DoorState(doors.state[d]).name.lower(), _cm(doors.depth_m[d])
    part = f"part of opening {opening}" if opening >= 0 else "too few lines for an opening"
    below = f"{depth} deep below {doors.start_height_m[d]:.2f} m"
    return f"above a door, {state}: {below}; {part}"


def line_document(labelling: ScanLabelling, reason: LineReason, note: str = "") -> str:
    """Return one line's conditions in Markdown. note: added below the heading."""
    structures = labelling.structures
    roles = {"up-most": structures.upmost, "bottom-most": structures.bottommost}
    rows = [
        (
            *(structures.first[s], structures.last[s]),
            *(f"{structures.bottom_m[s]:.2f}", f"{structures.top_m[s]:.2f}"),
            " and ".join(role for role, chosen in roles.items() if chosen[reason.line] == s),
        )
        for s in np.flatnonzero(structures.line == reason.line)
    ]
    headings = "first sample", "last sample", "bottom (m)", "top (m)", "role"
    parts = [
        f"# {name_of(reason.line).capitalize()}: {LINE_OUTCOMES[reason.outcome][0]}",
        reason.sentence,
        note,
        table(CONDITION_HEADINGS, condition_rows(reason.conditions)).replace(" no |", " **no** |"),
        f"## Its vertical structures, upwards\n\n{table(headings, rows)}" if rows else "",
    ]
    return "\n\n".join(part for part in parts if part)


def scan_document(
    title: str,
    notes: Sequence[str],
    labelling: ScanLabelling,
    reasons: Sequence[LineReason],
    marked: Sequence[int] | None = None,
) -> str:
    """Return a summary of a scan in Markdown: its planes, openings and lines.

    marked: number of marked returns of each line, if known.
    """
    planes, openings, floor_m = labelling.planes, labelling.openings, labelling.floor.height_m
    heights = [f"{ceiling.height_m - floor_m:.2f} m" for ceiling in labelling.ceilings]
    ceilings = f"Ceilings at {', '.join(heights)} above the floor."
    outcomes = [
        (sum(reason.outcome == outcome for reason in reasons), name)
        for outcome, (name, _) in LINE_OUTCOMES.items()
    ]
    parts = [
        *(f"# {title}", *notes, ceilings if heights else "No ceiling is in view."),
        table(("lines", "outcome"), outcomes),
    ]
    if len(planes):
        fields = "line_count", "rms_m", "bottom_m", "top_m"
        parts += ["## Wall planes", fields_table(planes, *fields, plane=range(len(planes)))]
    if len(openings):
        states = [DoorState(state).name.lower() for state in openings.state]
        fields = "plane", "depth_m", "head_m", "line_count"
        of_openings = fields_table(openings, *fields, state=states)
        parts += ["## Openings", of_openings]
    columns: dict[str, Sequence[object]] = {"line": [r.line for r in reasons]}
    if marked is not None:
        columns["marked"] = [marked[r.line] for r in reasons]
    columns["outcome"] = [LINE_OUTCOMES[r.outcome][0] for r in reasons]
    columns["reason"] = [r.short for r in reasons]
    lines = table(list(columns), list(zip(*columns.values(), strict=True)))
    parts += ["## Lines (2 × pair + side)", lines]
    return "\n\n".join(parts)


def condition_rows(conditions: Iterable[Condition]) -> list[tuple[str, str, str, str]]:
    """Return the rows of a table of conditions."""
    met = {True: "yes", False: "no", None: "–"}
    return [(k.name, k.measured, k.limit, met[k.met]) for k in conditions]


def _longest_run(held: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _cm(metres: float) -> str:
    return f"{100 * metres:.1f} cm" if abs(metres) < 1 else f"{metres:.2f} m"
