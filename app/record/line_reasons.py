"""Why each point line became what it is, in words, from the evidence of the labelling alone.

The recorder writes the short reasons beside the candidates and the door lines of every scan; `ffmap inspect` tells them
at length, line by line.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import BoolArray
from ffmap.algorithms.scan.doors import Depression, DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.wall_planes import Growth, Membership, Reach
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
    return [_candidate_short(labelling, c) for c in range(len(labelling.planes.candidate_line))]


def door_reasons(labelling: ScanLabelling) -> list[str]:
    """Which conditions of a door held for each line that belongs to a wall plane, in half a line each."""
    return [_door_short(labelling, d) for d in range(len(labelling.door_lines.line))]


def explain_lines(labelling: ScanLabelling) -> list[LineReason]:
    """The reason of every line of a scan."""
    outcomes = line_outcomes(labelling)
    return [_explain(labelling, line, outcomes[line]) for line in range(len(labelling.lines))]


def name_of(line: int) -> str:
    """A line as people speak of it."""
    return f"line {line} (emitter {line // 2}, side {line % 2})"


def line_document(labelling: ScanLabelling, reason: LineReason, note: str = "") -> str:
    """One line's reasons as Markdown; note: what else is to be said of it."""
    outcome = LINE_OUTCOMES[reason.outcome][0]
    parts = [f"# {name_of(reason.line).capitalize()}: {outcome}", "", reason.verdict, ""]
    parts += [note, ""] if note else []
    parts += _check_table(reason.checks)
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
    parts = [f"# {title}", "", *(f"{note}\n" for note in notes)]
    parts += [
        f"Ceilings at {', '.join(heights)} above the floor." if heights else "No ceiling is in view.",
        "",
        "| lines | what became of them |",
        "|---|---|",
    ]
    for outcome, (name, _) in LINE_OUTCOMES.items():
        parts.append(f"| {sum(reason.outcome == outcome for reason in reasons)} | {name} |")
    if len(planes):
        parts += ["", "## Wall planes", "| plane | lines | length | RMS | heights |", "|---|---|---|---|---|"]
        parts += [
            f"| {k} | {planes.line_count[k]} | {np.linalg.norm(planes.ends[k, 1] - planes.ends[k, 0]):.2f} m "
            f"| {_cm(planes.rms_m[k])} | {planes.bottom_m[k]:.2f}–{planes.top_m[k]:.2f} m |"
            for k in range(len(planes))
        ]
    if len(openings):
        parts += ["", "## Openings", "| opening | plane | state | width in view | depth | head | lines |"]
        parts += ["|---|---|---|---|---|---|---|"]
        parts += [
            f"| {o} | {openings.plane[o]} | {_state(openings.state[o])} "
            f"| {np.linalg.norm(openings.ends[o, 1] - openings.ends[o, 0]):.2f} m | {_cm(openings.depth_m[o])} "
            f"| {openings.head_m[o]:.2f} m | {openings.line_count[o]} |"
            for o in range(len(openings))
        ]
    parts += ["", "## Lines (2 × emitter + side)"]
    if marked is None:
        parts += ["| line | outcome | why |", "|---|---|---|"]
        parts += [f"| {r.line} | {LINE_OUTCOMES[r.outcome][0]} | {r.short} |" for r in reasons]
    else:
        parts += ["| line | marked | outcome | why |", "|---|---|---|---|"]
        parts += [f"| {r.line} | {marked[r.line]} | {LINE_OUTCOMES[r.outcome][0]} | {r.short} |" for r in reasons]
    return "\n".join(parts)


# --- one line ---


def _explain(labelling: ScanLabelling, line: int, outcome: LineOutcome) -> LineReason:
    settings = labelling.settings
    lines, structures, planes = labelling.lines, labelling.structures, labelling.planes
    returns = int(lines.starts[line + 1] - lines.starts[line])
    has_samples = bool(lines.samples[line, 0] >= 0)
    points_min = settings.rearrangement.line_points_min
    checks = [
        Check(
            "III.A: returns but floor, ceiling",
            f"{returns} returns in all",
            f"at least {points_min} left",
            has_samples,
        )
    ]
    if not has_samples:
        short = f"fewer than {points_min} returns are neither floor nor ceiling"
        return LineReason(line, outcome, short, f"No point line: {short}.", tuple(checks))
    longest = _longest_run(structures.upright[line])
    own = np.flatnonzero(structures.line == line)
    run_min = settings.vertical_structures.points_min
    checks.append(
        Check(
            "III.B, eq. 2: upright samples",
            f"{_count(len(own), 'structure')}, longest run {longest}",
            f"≥ {run_min} within ±{settings.vertical_structures.slope_max:g}",
            len(own) > 0,
        )
    )
    if not len(own):
        cut = longest >= run_min
        short = (
            f"its upright samples are cut by jumps in range, no {run_min} of them lie together"
            if cut
            else f"at most {longest} neighbouring samples stand upright, {run_min} make a structure"
        )
        return LineReason(line, outcome, short, f"No vertical structure: {short}.", tuple(checks))
    candidates = np.flatnonzero(planes.candidate_line == line).tolist()
    upmost = [c for c in candidates if planes.candidate_structure[c] == structures.upmost[line]]
    further = [c for c in candidates if c not in upmost]
    verdict = [f"Its up-most structure is the wall candidate. {_candidate_sentences(labelling, c)}" for c in upmost]
    verdict += [
        f"A lower structure ends at a ceiling too, as the wall of a next room does below a lintel. "
        f"{_candidate_sentences(labelling, c)}"
        for c in further
    ]
    for c in candidates:
        checks += _candidate_checks(labelling, c, "" if c in upmost else " (lower)")
    short = "; ".join(_candidate_short(labelling, c) for c in candidates)
    door = np.flatnonzero(labelling.door_lines.line == line)
    if len(door):
        checks += _door_checks(labelling, int(door[0]))
        verdict.append(_door_sentence(labelling, int(door[0])))
        if outcome == LineOutcome.DOOR:
            short += "; " + _door_short(labelling, int(door[0]))
    else:
        checks.append(Check("III.C, door 1: in a wall plane", "the up-most is in none", "in one", False))
    return LineReason(line, outcome, short, "\n\n".join(verdict), tuple(checks))


def _structure_role(labelling: ScanLabelling, structure: int) -> str:
    structures, planes = labelling.structures, labelling.planes
    line = structures.line[structure]
    roles = []
    if structures.upmost[line] == structure:
        roles.append("up-most: the wall candidate")
    if structures.bottommost[line] == structure:
        roles.append("bottom-most (kept for comparison, Fig. 6b)")
    for c in np.flatnonzero(planes.candidate_structure == structure):
        roles.append(_candidate_short(labelling, int(c)))
    return "; ".join(roles) or "between the others; not a candidate"


# --- a wall candidate ---


def _candidate_short(labelling: ScanLabelling, c: int) -> str:
    planes = labelling.planes
    plane = planes.candidate_plane[c]
    if plane >= 0:
        return f"taken: plane {plane}, {_cm(planes.candidate_nearest_m[c])} off; {_growth_short(labelling, c)}"
    return f"refused: {_refusal(labelling, c)}"


def _growth_short(labelling: ScanLabelling, c: int) -> str:
    planes = labelling.planes
    match planes.candidate_growth[c]:
        case Growth.JOINED:
            return f"joined at {_cm(planes.candidate_distance_m[c])}"
        case Growth.BROKE:
            return f"broke the plane before it ({_break(labelling, c)})"
        case Growth.SEEDED:
            return "began a plane"
    return "was left out of the growing"


def _break(labelling: ScanLabelling, c: int) -> str:
    """By what a candidate was not similar to the growing plane."""
    planes, settings = labelling.planes, labelling.settings.wall_planes
    parts = []
    if not planes.candidate_distance_m[c] < settings.similarity_m:
        parts.append(f"{_cm(planes.candidate_distance_m[c])} from it")
    if not planes.candidate_gap_m[c] < planes.candidate_gap_max_m[c]:
        parts.append(f"{_cm(planes.candidate_gap_m[c])} beyond its last line")
    return ", ".join(parts)


def _refusal(labelling: ScanLabelling, c: int) -> str:
    planes, settings = labelling.planes, labelling.settings.wall_planes
    grown = planes.candidate_grown[c]
    nearest_m = planes.candidate_nearest_m[c]
    match planes.candidate_membership[c]:
        case Membership.REFUSED:
            below_m = planes.candidate_below_ceiling_m[c]
            if np.isnan(below_m):
                top_m = labelling.structures.top_m[planes.candidate_structure[c]]
                return f"ends {top_m:.2f} m high, a wall without a ceiling in view at least {settings.height_min_m:g} m"
            return f"ends {_cm(below_m)} below the ceiling, a wall at most {_cm(settings.reach_m)}"
        case Membership.ALONE:
            peers = int(np.count_nonzero(planes.candidate_grown == grown))
            own = f"it grew into a plane of {_count(peers, 'line')}"
            if np.isnan(nearest_m):
                return f"{own}, {settings.lines_min} make a wall, and no other plane is within reach"
            return f"{own}; the nearest plane is {_cm(nearest_m)} away, similar is below {_cm(settings.similarity_m)}"
        case Membership.FEW_LINES:
            return f"fewer than {settings.lines_min} lines are left in its plane, the others went to nearer ones"
        case Membership.SHORT:
            return f"its plane is shorter than {_cm(settings.length_min_m)}"
        case Membership.ROUGH:
            return f"its plane's samples lie more than {_cm(settings.similarity_m)} RMS off it"
        case Membership.DUCT:
            bottom_m = labelling.structures.bottom_m[planes.candidate_structure[c]]
            return (
                f"its plane ends more than {settings.bottom_max_m:g} m above the floor in all of its lines (here "
                f"{bottom_m:.2f} m): a duct or a beam"
            )
    return "it is in no plane"


def _reach_sentence(labelling: ScanLabelling, c: int) -> str:
    planes, settings = labelling.planes, labelling.settings.wall_planes
    below_m = planes.candidate_below_ceiling_m[c]
    top_m = labelling.structures.top_m[planes.candidate_structure[c]]
    match planes.candidate_reach[c]:
        case Reach.CEILING:
            side = "below" if below_m >= 0 else "above"
            return f"It reaches the ceiling: it ends {_cm(abs(below_m))} {side} it."
        case Reach.ABOVE_CEILINGS:
            return f"It ends {top_m:.2f} m high, above the highest ceiling in view: another must be there."
        case Reach.HEIGHT:
            return f"No ceiling is in view; it ends {top_m:.2f} m high, which is high enough."
        case Reach.TURNS_BACK:
            return (
                f"It ends {top_m:.2f} m high, but its line has next to no returns of a ceiling: it may turn back below one, "
                "so it counts."
            )
    if np.isnan(below_m):
        return f"No ceiling is in view, and it ends only {top_m:.2f} m high (a wall: {settings.height_min_m:g} m)."
    return (
        f"It does not reach the ceiling: it ends {_cm(below_m)} below it (a wall: at most {_cm(settings.reach_m)}). "
        "What ends so low is furniture, a board or a window's sill."
    )


def _growth_sentence(labelling: ScanLabelling, c: int) -> str:
    planes, settings = labelling.planes, labelling.settings.wall_planes
    match planes.candidate_growth[c]:
        case Growth.SEEDED:
            return "As the first candidate of its side it began a plane."
        case Growth.JOINED:
            return (
                f"It joined the plane that was growing: {_cm(planes.candidate_distance_m[c])} RMS from it (below "
                f"{_cm(settings.similarity_m)}), {_cm(planes.candidate_gap_m[c])} from its last line (below "
                f"{_cm(planes.candidate_gap_max_m[c])})."
            )
        case Growth.BROKE:
            return f"It broke the plane that was growing ({_break(labelling, c)}) and began the next."
    return ""


def _candidate_sentences(labelling: ScanLabelling, c: int) -> str:
    planes = labelling.planes
    plane = planes.candidate_plane[c]
    if plane >= 0:
        end = (
            f"**Taken:** once planes in line were joined, plane {plane} ({planes.line_count[plane]} lines, RMS "
            f"{_cm(planes.rms_m[plane])}) is the nearest, {_cm(planes.candidate_nearest_m[c])} away."
        )
    else:
        end = f"**Refused:** {_refusal(labelling, c)}."
    sentences = [_reach_sentence(labelling, c), _growth_sentence(labelling, c), end]
    return " ".join(sentence for sentence in sentences if sentence)


def _candidate_checks(labelling: ScanLabelling, c: int, which: str) -> list[Check]:
    planes, settings = labelling.planes, labelling.settings.wall_planes
    below_m, distance_m = planes.candidate_below_ceiling_m[c], planes.candidate_distance_m[c]
    top_m = labelling.structures.top_m[planes.candidate_structure[c]]
    checks = [
        Check(
            f"III.B: reaches the ceiling{which}",
            f"{top_m:.2f} m high" if np.isnan(below_m) else f"ends {_cm(below_m)} below",
            f"≥ {settings.height_min_m:g} m" if np.isnan(below_m) else f"≤ {_cm(settings.reach_m)}",
            bool(planes.candidate_reach[c] != Reach.LOW),
        )
    ]
    if not np.isnan(distance_m):
        checks += [
            Check(
                f"Alg. 1: Θ to the growing plane{which}",
                f"{_cm(distance_m)} RMS",
                f"< {_cm(settings.similarity_m)}",
                bool(distance_m < settings.similarity_m),
            ),
            Check(
                f"Alg. 1: distance to its last line{which}",
                _cm(planes.candidate_gap_m[c]),
                f"< {_cm(planes.candidate_gap_max_m[c])}",
                bool(planes.candidate_gap_m[c] < planes.candidate_gap_max_m[c]),
            ),
        ]
    if planes.candidate_reach[c] != Reach.LOW:
        nearest_m = planes.candidate_nearest_m[c]
        checks.append(
            Check(
                f"Alg. 1: in a wall plane in the end{which}",
                "none within reach" if np.isnan(nearest_m) else f"nearest {_cm(nearest_m)} away",
                f"< {_cm(settings.similarity_m)}, ≥ {settings.lines_min} lines",
                bool(planes.candidate_plane[c] >= 0),
            )
        )
    return checks


# --- a door ---


def _door_short(labelling: ScanLabelling, d: int) -> str:
    doors, settings = labelling.door_lines, labelling.settings.doors
    if not doors.behind[d]:
        return f"no door: {_no_depression(labelling, d)}"
    start_m = doors.start_height_m[d]
    if not doors.high_enough[d]:
        return (
            f"no door: what lies {_cm(doors.depth_m[d])} behind begins {start_m:.2f} m high, a door "
            f"{settings.height_min_m:g}–{settings.height_max_m:g} m"
        )
    state = _state(doors.state[d])
    opening = labelling.openings.door_line_opening[d]
    part = f"part of opening {opening}" if opening >= 0 else f"alone, {settings.lines_min} lines make an opening"
    return f"above a door, {state}: {_cm(doors.depth_m[d])} deep below {start_m:.2f} m; {part}"


def _no_depression(labelling: ScanLabelling, d: int) -> str:
    doors, settings = labelling.door_lines, labelling.settings.doors
    match doors.depression[d]:
        case Depression.FEW_RETURNS:
            return "too few returns lie at the plane and behind it"
        case Depression.NONE:
            if np.isnan(doors.recess_m[d]):
                return "the line is too short below the lintel"
            return f"nothing recedes by {_cm(settings.recess_min_m)}, at most {_cm(doors.recess_m[d])}"
        case Depression.ABOVE_OFF_PLANE:
            return f"what lies above the recess is {_cm(abs(doors.above_m[d]))} off the plane itself"
        case Depression.SHALLOW:
            return f"what recedes is {_cm(-doors.below_m[d])} behind the plane, less than {_cm(settings.recess_min_m)}"
        case Depression.EXCEPTIONS:
            return (
                f"{doors.on_plane_share[d]:.0%} of the returns below lie on the plane, at most "
                f"{settings.exceptions_max:.0%} may"
            )
    return "nothing lies behind the plane"


def _door_sentence(labelling: ScanLabelling, d: int) -> str:
    sentence = _door_short(labelling, d)
    return f"**Door:** {sentence}."


def _door_checks(labelling: ScanLabelling, d: int) -> list[Check]:
    doors, settings = labelling.door_lines, labelling.settings.doors
    checks = [
        Check("III.C, door 1: in a wall plane", f"plane {doors.plane[d]}", "in one", True),
        Check(
            "III.C, door 2: all below lies behind",
            f"{_cm(-doors.below_m[d])} behind, {doors.on_plane_share[d]:.0%} on it"
            if not np.isnan(doors.below_m[d])
            else "–"
            if np.isnan(doors.recess_m[d])
            else f"recedes by {_cm(doors.recess_m[d])}",
            f"≥ {_cm(settings.recess_min_m)}, ≤ {settings.exceptions_max:.0%}",
            bool(doors.behind[d]),
        ),
    ]
    if not doors.behind[d]:
        checks.append(Check("III.C, door 3: high enough", "–", "needs condition 2", None))
        return checks
    opening = labelling.openings.door_line_opening[d]
    return [
        *checks,
        Check(
            "III.C, door 3: high enough",
            f"begins {doors.start_height_m[d]:.2f} m high",
            f"{settings.height_min_m:g}–{settings.height_max_m:g} m",
            bool(doors.high_enough[d]),
        ),
        Check(
            "III.C: open or closed",
            f"{_cm(doors.depth_m[d])} deep: {_state(doors.state[d])}",
            f"open > {_cm(settings.open_depth_m)}",
            None,
        ),
        Check(
            "neighbouring lines show it too",
            f"opening {opening}: {_count(int(labelling.openings.line_count[opening]), 'line')}"
            if opening >= 0
            else "in no opening",
            f"≥ {settings.lines_min} lines",
            bool(opening >= 0),
        ),
    ]


# --- words ---


def _check_table(checks: Iterable[Check]) -> list[str]:
    answers = {True: "yes", False: "**no**", None: "–"}
    return [
        "| held | condition | measured | needed |",
        "|---|---|---|---|",
        *(f"| {answers[c.held]} | {c.condition} | {c.measured} | {c.needed} |" for c in checks),
    ]


def _longest_run(held: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _state(state: int) -> str:
    return DoorState(state).name.lower()


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _cm(metres: float) -> str:
    return f"{100 * metres:.1f} cm" if abs(metres) < 1 else f"{metres:.2f} m"
