"""Why each point line became what it is, in words, from the evidence of the labelling alone.

The recorder writes the short reasons beside the candidates and the door lines of every scan; `ffmap inspect` tells them
at length, line by line.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffmap.algorithms.base.scan import BoolArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.scan.doors import Depression, DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.wall_candidates import Reach
from ffmap.algorithms.scan.wall_planes import Growth, Membership
from ffmap.app.record.shapes import table
from ffmap.blueprints.entities import LINE_OUTCOMES, LineOutcome


@dataclass(frozen=True)
class Check:
    """One condition: what was measured, what is needed, and whether it held; None where it decides nothing."""

    condition: str
    measured: str
    needed: str
    held: bool | None


@dataclass(frozen=True)
class LineReason:
    """Why a line became what it is.

    outcome: see `LineOutcome`. short: in half a line. verdict: in a few sentences. checks: in the order of the method.
    """

    line: int
    outcome: LineOutcome
    short: str
    verdict: str
    checks: tuple[Check, ...]


def line_outcomes(labelling: ScanLabelling) -> list[LineOutcome]:
    """`LineOutcome` of each line."""
    planes, doors = labelling.planes, labelling.door_lines
    outcome = [LineOutcome.NO_STRUCTURE] * len(labelling.lines)
    # A line with a candidate in a plane is in it, whichever of its candidates that is.
    for line in planes.candidate_line[planes.candidate_plane < 0]:
        outcome[line] = LineOutcome.REFUSED
    for line in planes.candidate_line[planes.candidate_plane >= 0]:
        outcome[line] = LineOutcome.WALL
    for line in doors.line[doors.above_door]:
        outcome[line] = LineOutcome.DOOR
    return outcome


def candidate_reasons(labelling: ScanLabelling) -> list[str]:
    """Why each wall candidate was taken or refused, in half a line each."""
    return [_Candidate(labelling, c).short() for c in range(len(labelling.planes.candidate_line))]


def door_reasons(labelling: ScanLabelling) -> list[str]:
    """Which conditions of a door held for each line that belongs to a wall plane, in half a line each."""
    return [_DoorLine(labelling, d).short() for d in range(len(labelling.door_lines.line))]


def explain_lines(labelling: ScanLabelling) -> list[LineReason]:
    """The reason of every line of a scan."""
    outcomes = line_outcomes(labelling)
    return [_explain(labelling, line, outcomes[line]) for line in range(len(labelling.lines))]


def name_of(line: int) -> str:
    """A line as people speak of it."""
    return f"line {line} (pair {line // 2}, side {line % 2})"


def line_document(labelling: ScanLabelling, reason: LineReason, note: str = "") -> str:
    """One line's reasons as Markdown; note: what else is to be said of it."""
    outcome = LINE_OUTCOMES[reason.outcome][0]
    parts = [f"# {name_of(reason.line).capitalize()}: {outcome}", "", reason.verdict, ""]
    parts += [note, ""] if note else []
    parts.append(_check_table(reason.checks))
    structures = labelling.structures
    own = np.flatnonzero(structures.line == reason.line).tolist()
    if own:
        parts += ["", "## Its vertical structures, from below upwards"]
        parts += [
            f"- samples {structures.first[s]}–{structures.last[s]}, {structures.bottom_m[s]:.2f}–{structures.top_m[s]:.2f} m "
            f"high: {_structure_role(labelling, s)}"
            for s in own
        ]
    return "\n".join(parts)


def scan_document(
    title: str,
    notes: Sequence[str],
    labelling: ScanLabelling,
    reasons: Sequence[LineReason],
    marked: Sequence[int] | None = None,
) -> str:
    """A whole scan as Markdown: what was found, and a table of its lines.

    marked: how many returns of each line are marked; None where that is not known.
    """
    planes, openings = labelling.planes, labelling.openings
    heights = [f"{c.height_m - labelling.floor.height_m:.2f} m" for c in labelling.ceilings]
    found = f"Ceilings at {', '.join(heights)} above the floor." if heights else "No ceiling is in view."
    counts = [
        (sum(reason.outcome == outcome for reason in reasons), name) for outcome, (name, _) in LINE_OUTCOMES.items()
    ]
    parts = [f"# {title}", "", *(f"{note}\n" for note in notes), found, ""]
    parts.append(table(("lines", "what became of them"), counts))
    if len(planes):
        rows: list[tuple[Any, ...]] = []
        for k, length_m in enumerate(lengths_m(planes.ends)):
            reach = f"{planes.bottom_m[k]:.2f}–{planes.top_m[k]:.2f} m"
            rows.append((k, planes.line_count[k], f"{length_m:.2f} m", _cm(planes.rms_m[k]), reach))
        parts += ["", "## Wall planes", table(("plane", "lines", "length", "RMS", "heights"), rows)]
    if len(openings):
        rows = []
        for o, width_m in enumerate(lengths_m(openings.ends)):
            state, size = DoorState(openings.state[o]).name.lower(), (f"{width_m:.2f} m", _cm(openings.depth_m[o]))
            rows.append((o, openings.plane[o], state, *size, f"{openings.head_m[o]:.2f} m", openings.line_count[o]))
        headings = "opening", "plane", "state", "width in view", "depth", "head", "lines"
        parts += ["", "## Openings", table(headings, rows)]
    columns: dict[str, list[Any]] = {"line": [r.line for r in reasons]}
    if marked is not None:
        columns["marked"] = [marked[r.line] for r in reasons]
    columns |= {"outcome": [LINE_OUTCOMES[r.outcome][0] for r in reasons], "why": [r.short for r in reasons]}
    parts += ["", "## Lines (2 × pair + side)", table(list(columns), zip(*columns.values(), strict=True))]
    return "\n".join(parts)


# --- one line ---


def _explain(labelling: ScanLabelling, line: int, outcome: LineOutcome) -> LineReason:
    settings = labelling.settings
    lines, structures, planes = labelling.lines, labelling.structures, labelling.planes
    returns = f"{lines.starts[line + 1] - lines.starts[line]} returns in all"
    has_samples = bool(lines.samples[line, 0] >= 0)
    points_min = settings.rearrangement.line_points_min
    checks = [Check("III.A: returns but floor, ceiling", returns, f"at least {points_min} left", has_samples)]
    if not has_samples:
        short = f"fewer than {points_min} returns are neither floor nor ceiling"
        return LineReason(line, outcome, short, f"No point line: {short}.", tuple(checks))
    longest = _longest_run(structures.upright[line])
    own = np.flatnonzero(structures.line == line)
    run_min = settings.vertical_structures.points_min
    found = f"{_count(len(own), 'structure')}, longest run {longest}"
    needed = f"≥ {run_min} within ±{settings.vertical_structures.slope_max:g}"
    checks.append(Check("III.B, eq. 2: upright samples", found, needed, len(own) > 0))
    if not len(own):
        short = f"at most {longest} neighbouring samples stand upright, {run_min} make a structure"
        if longest >= run_min:
            short = f"its upright samples are cut by jumps in range, no {run_min} of them lie together"
        return LineReason(line, outcome, short, f"No vertical structure: {short}.", tuple(checks))
    candidates = [_Candidate(labelling, c) for c in np.flatnonzero(planes.candidate_line == line)]
    upmost = [candidate for candidate in candidates if candidate.structure == structures.upmost[line]]
    further = [candidate for candidate in candidates if candidate not in upmost]
    verdict = [f"Its up-most structure is the wall candidate. {candidate.sentences()}" for candidate in upmost]
    verdict += [
        "A lower structure ends at a ceiling too, as the wall of a next room does below a lintel. "
        f"{candidate.sentences()}"
        for candidate in further
    ]
    for candidate in candidates:
        checks += candidate.checks("" if candidate in upmost else " (lower)")
    short = "; ".join(candidate.short() for candidate in candidates)
    door_lines = np.flatnonzero(labelling.door_lines.line == line)
    if len(door_lines):
        door = _DoorLine(labelling, door_lines[0])
        checks += door.checks()
        verdict.append(f"**Door:** {door.short()}.")
        if outcome == LineOutcome.DOOR:
            short += f"; {door.short()}"
    else:
        checks.append(Check("III.C, door 1: in a wall plane", "the up-most is in none", "in one", False))
    return LineReason(line, outcome, short, "\n\n".join(verdict), tuple(checks))


def _structure_role(labelling: ScanLabelling, structure: int) -> str:
    structures = labelling.structures
    line = structures.line[structure]
    roles = []
    if structures.upmost[line] == structure:
        roles.append("up-most: the wall candidate")
    if structures.bottommost[line] == structure:
        roles.append("bottom-most (kept for comparison, Fig. 6b)")
    candidates = np.flatnonzero(labelling.planes.candidate_structure == structure)
    roles += [_Candidate(labelling, c).short() for c in candidates]
    return "; ".join(roles) or "between the others; not a candidate"


# --- a wall candidate ---


class _Candidate:
    """What was measured of one wall candidate, and why it was taken or refused."""

    def __init__(self, labelling: ScanLabelling, c: int | np.integer) -> None:
        planes = labelling.planes
        self._planes, self._settings = planes, labelling.settings.wall_planes
        self.structure, self._plane = planes.candidate_structure[c], planes.candidate_plane[c]
        self._grown, self._growth = planes.candidate_grown[c], Growth(planes.candidate_growth[c])
        self._reach, self._membership = Reach(planes.candidate_reach[c]), Membership(planes.candidate_membership[c])
        self._distance_m, self._nearest_m = planes.candidate_distance_m[c], planes.candidate_nearest_m[c]
        self._gap_m, self._gap_max_m = planes.candidate_gap_m[c], planes.candidate_gap_max_m[c]
        self._below_m = planes.candidate_below_ceiling_m[c]
        self._bottom_m = labelling.structures.bottom_m[self.structure]
        self._top_m = labelling.structures.top_m[self.structure]
        self._ends = f"ends {self._top_m:.2f} m high"
        self._sees_ceiling = not np.isnan(self._below_m)

    def short(self) -> str:
        if self._plane < 0:
            return f"refused: {self._refusal()}"
        return f"taken: plane {self._plane}, {_cm(self._nearest_m)} off; {self._growth_short()}"

    def sentences(self) -> str:
        if self._plane < 0:
            end = f"**Refused:** {self._refusal()}."
        else:
            end = (
                f"**Taken:** once planes in line were joined, plane {self._plane} ({self._planes.line_count[self._plane]} "
                f"lines, RMS {_cm(self._planes.rms_m[self._plane])}) is the nearest, {_cm(self._nearest_m)} away."
            )
        return " ".join(sentence for sentence in (self._reach_sentence(), self._growth_sentence(), end) if sentence)

    def checks(self, which: str) -> list[Check]:
        """which: the candidate, where its line has several, as the end of a condition."""
        similar, lines_min = f"< {_cm(self._settings.similarity_m)}", self._settings.lines_min
        reaches = bool(self._reach != Reach.LOW)
        measured, needed = f"{self._top_m:.2f} m high", f"≥ {self._settings.height_min_m:g} m"
        if self._sees_ceiling:
            measured, needed = f"ends {_cm(self._below_m)} below", f"≤ {_cm(self._settings.reach_m)}"
            if self._reach == Reach.OVERHUNG:
                measured, needed = f"{measured}, overhung", f"{needed}, or overhung"
        checks = [Check(f"III.B: reaches the ceiling{which}", measured, needed, reaches)]
        if not np.isnan(self._distance_m):
            near = bool(self._distance_m < self._settings.similarity_m)
            checks.append(
                Check(f"Alg. 1: Θ to the growing plane{which}", f"{_cm(self._distance_m)} RMS", similar, near)
            )
            near, needed = bool(self._gap_m < self._gap_max_m), f"< {_cm(self._gap_max_m)}"
            checks.append(Check(f"Alg. 1: distance to its last line{which}", _cm(self._gap_m), needed, near))
        if reaches:
            nearest = "none within reach" if np.isnan(self._nearest_m) else f"nearest {_cm(self._nearest_m)} away"
            needed, taken = f"{similar}, ≥ {lines_min} lines", bool(self._plane >= 0)
            checks.append(Check(f"Alg. 1: in a wall plane in the end{which}", nearest, needed, taken))
        return checks

    def _break(self) -> str:
        """By what it was not similar to the growing plane."""
        parts = []
        if not self._distance_m < self._settings.similarity_m:
            parts.append(f"{_cm(self._distance_m)} from it")
        if not self._gap_m < self._gap_max_m:
            parts.append(f"{_cm(self._gap_m)} beyond its last line")
        return ", ".join(parts)

    def _growth_short(self) -> str:
        match self._growth:
            case Growth.SEEDED:
                return "began a plane"
            case Growth.JOINED:
                return f"joined at {_cm(self._distance_m)}"
            case Growth.BROKE:
                return f"broke the plane before it ({self._break()})"
            case Growth.REFUSED:
                return "was left out of the growing"

    def _refusal(self) -> str:
        settings = self._settings
        match self._membership:
            case Membership.REFUSED if self._sees_ceiling:
                return f"ends {_cm(self._below_m)} below the ceiling, a wall at most {_cm(settings.reach_m)}"
            case Membership.REFUSED:
                return f"{self._ends}, a wall without a ceiling in view at least {settings.height_min_m:g} m"
            case Membership.ALONE:
                return self._alone()
            case Membership.FEW_LINES:
                return f"fewer than {settings.lines_min} lines are left in its plane, the others went to nearer ones"
            case Membership.SHORT:
                return f"its plane is shorter than {_cm(settings.length_min_m)}"
            case Membership.ROUGH:
                return f"its plane's samples lie more than {_cm(settings.similarity_m)} RMS off it"
            case Membership.DUCT:
                return (
                    f"its plane ends more than {settings.bottom_max_m:g} m above the floor in all of its lines (here "
                    f"{self._bottom_m:.2f} m): a duct or a beam"
                )
        raise ValueError(f"a candidate that is {self._membership.name} was not refused")

    def _alone(self) -> str:
        peers = int(np.count_nonzero(self._planes.candidate_grown == self._grown))
        own = f"it grew into a plane of {_count(peers, 'line')}"
        if np.isnan(self._nearest_m):
            return f"{own}, {self._settings.lines_min} make a wall, and no other plane is within reach"
        similar = f"similar is below {_cm(self._settings.similarity_m)}"
        return f"{own}; the nearest plane is {_cm(self._nearest_m)} away, {similar}"

    def _reach_sentence(self) -> str:
        side, settings = "below" if self._below_m >= 0 else "above", self._settings
        low = f"No ceiling is in view, and it ends only {self._top_m:.2f} m high (a wall: {settings.height_min_m:g} m)."
        if self._sees_ceiling:
            low = (
                f"It does not reach the ceiling: it ends {_cm(self._below_m)} below it (a wall: at most "
                f"{_cm(settings.reach_m)}). What ends lower is furniture, a board or a window's sill."
            )
        return {
            Reach.CEILING: f"It reaches the ceiling: it ends {_cm(abs(self._below_m))} {side} it.",
            Reach.ABOVE_CEILINGS: f"It {self._ends}, above the highest ceiling in view: another must be there.",
            Reach.HEIGHT: f"No ceiling is in view; it {self._ends}, which is high enough.",
            Reach.TURNS_BACK: f"It {self._ends}, but its line has next to no returns of a ceiling: below one it may turn "
            "back, or the view end, so it counts.",
            Reach.OVERHUNG: f"It {self._ends}, and what its line meets above touches it and comes nearer, up to a ceiling: a "
            "soffit, a vault or a roof, so it counts.",
            Reach.LOW: low,
        }[self._reach]

    def _growth_sentence(self) -> str:
        return {
            Growth.SEEDED: "As the first candidate of its side it began a plane.",
            Growth.JOINED: f"It joined the plane that was growing: {_cm(self._distance_m)} RMS from it (below "
            f"{_cm(self._settings.similarity_m)}), {_cm(self._gap_m)} from its last line (below {_cm(self._gap_max_m)}).",
            Growth.BROKE: f"It broke the plane that was growing ({self._break()}) and began the next.",
            Growth.REFUSED: "",
        }[self._growth]


# --- a door ---


class _DoorLine:
    """What was measured of one line of a wall plane below its lintel, and why it is above a door or not."""

    def __init__(self, labelling: ScanLabelling, d: int | np.integer) -> None:
        doors, openings = labelling.door_lines, labelling.openings
        self._settings = labelling.settings.doors
        self._plane, self._behind, self._high_enough = doors.plane[d], doors.behind[d], doors.high_enough[d]
        self._depression, self._on_plane_share = Depression(doors.depression[d]), doors.on_plane_share[d]
        self._recess_m, self._above_m, self._below_m = doors.recess_m[d], doors.above_m[d], doors.below_m[d]
        self._start_m, self._depth_m = doors.start_height_m[d], doors.depth_m[d]
        self._state = DoorState(doors.state[d]).name.lower()
        self._opening = openings.door_line_opening[d]
        self._lines = int(openings.line_count[self._opening]) if self._opening >= 0 else 0

    def short(self) -> str:
        settings = self._settings
        if not self._behind:
            return f"no door: {self._no_depression()}"
        if not self._high_enough:
            return (
                f"no door: what lies {_cm(self._depth_m)} behind begins {self._start_m:.2f} m high, a door "
                f"{settings.height_min_m:g}–{settings.height_max_m:g} m"
            )
        part = (
            f"part of opening {self._opening}" if self._lines else f"alone, {settings.lines_min} lines make an opening"
        )
        return f"above a door, {self._state}: {_cm(self._depth_m)} deep below {self._start_m:.2f} m; {part}"

    def checks(self) -> list[Check]:
        settings = self._settings
        below = "–" if np.isnan(self._recess_m) else f"recedes by {_cm(self._recess_m)}"
        if not np.isnan(self._below_m):
            below = f"{_cm(-self._below_m)} behind, {self._on_plane_share:.0%} on it"
        needed = f"≥ {_cm(settings.recess_min_m)}, ≤ {settings.exceptions_max:.0%}"
        checks = [
            Check("III.C, door 1: in a wall plane", f"plane {self._plane}", "in one", True),
            Check("III.C, door 2: all below lies behind", below, needed, bool(self._behind)),
        ]
        if not self._behind:
            return [*checks, Check("III.C, door 3: high enough", "–", "needs condition 2", None)]
        begins, heights = f"begins {self._start_m:.2f} m high", f"{settings.height_min_m:g}–{settings.height_max_m:g} m"
        deep, open_m = f"{_cm(self._depth_m)} deep: {self._state}", f"open > {_cm(settings.open_depth_m)}"
        lines = f"opening {self._opening}: {_count(self._lines, 'line')}" if self._lines else "in no opening"
        return [
            *checks,
            Check("III.C, door 3: high enough", begins, heights, bool(self._high_enough)),
            Check("III.C: open or closed", deep, open_m, None),
            Check("neighbouring lines show it too", lines, f"≥ {settings.lines_min} lines", self._lines > 0),
        ]

    def _no_depression(self) -> str:
        recess_min = _cm(self._settings.recess_min_m)
        match self._depression:
            case Depression.FEW_RETURNS:
                return "too few returns lie at the plane and behind it"
            case Depression.NONE if np.isnan(self._recess_m):
                return "the line is too short below the lintel"
            case Depression.NONE:
                return f"nothing recedes by {recess_min}, at most {_cm(self._recess_m)}"
            case Depression.ABOVE_OFF_PLANE:
                return f"what lies above the recess is {_cm(abs(self._above_m))} off the plane itself"
            case Depression.SHALLOW:
                return f"what recedes is {_cm(-self._below_m)} behind the plane, less than {recess_min}"
            case Depression.EXCEPTIONS:
                exceptions_max = f"{self._settings.exceptions_max:.0%}"
                return f"{self._on_plane_share:.0%} of the returns below lie on the plane, at most {exceptions_max} may"
            case Depression.HELD:
                return "nothing lies behind the plane"


# --- words ---


def _check_table(checks: Iterable[Check]) -> str:
    answers = {True: "yes", False: "**no**", None: "–"}
    rows = [(answers[c.held], c.condition, c.measured, c.needed) for c in checks]
    return table(("held", "condition", "measured", "needed"), rows)


def _longest_run(held: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _cm(metres: float) -> str:
    return f"{100 * metres:.1f} cm" if abs(metres) < 1 else f"{metres:.2f} m"
