"""Why each point line is, or is not, in a wall or above a door: conditions with measured values."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array
from ffmap.algorithms.scan.doors import (
    ABOVE_MORE_M,
    ABOVE_PER_RECESS,
    EXCEPTIONS_MAX,
    HEIGHT_MAX_M,
    OPEN_DEPTH_M,
    RETURNS_MIN,
    DoorState,
)
from ffmap.algorithms.scan.labelling import ScanLabelling, label_horizontal
from ffmap.algorithms.scan.point_lines import POINTS_MIN
from ffmap.algorithms.scan.wall_candidates import Reach
from ffmap.algorithms.scan.wall_planes import BOTTOM_MAX_M, LENGTH_MIN_M
from ffmap.app.record.conditions import (
    HEADINGS,
    NOTE,
    Condition,
    centimetres,
    first_unmet,
    setting_of,
)
from ffmap.app.record.tables import fields_table, table
from ffmap.blueprints.entities import LINE_OUTCOMES, LineOutcome

Conditions = tuple[Condition, ...]


@dataclass(frozen=True)
class LineReason:
    """The conditions of a line, in the order of the method, and the result in half a line.

    common: of all lines. candidates: of each of its wall candidates. door: of its up-most one.
    """

    line: int
    short: str
    common: Conditions
    candidates: tuple[Conditions, ...] = ()
    door: Conditions = ()

    @property
    def conditions(self) -> Conditions:
        return (*self.common, *chain(*self.candidates), *self.door)

    @property
    def outcome(self) -> LineOutcome:
        """The outcome by the conditions."""
        if first_unmet(self.common) is not None:
            return LineOutcome.NO_STRUCTURE
        if all(first_unmet(own) is not None for own in self.candidates):
            return LineOutcome.REFUSED
        return LineOutcome.WALL if first_unmet(self.door) is not None else LineOutcome.DOOR

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
    upright = labelling.lines.count(_is_upright(labelling))
    return [_explain(labelling, line, int(count)) for line, count in enumerate(upright)]


def name_of(line: int) -> str:
    return f"line {line} (pair {line // 2}, side {line % 2})"


def _is_upright(labelling: ScanLabelling) -> BoolArray:
    """(n,) whether each return was neither floor nor ceiling when the lines were made."""
    own = labelling.height_m, labelling.below_m, labelling.settings.rearrangement
    return np.asarray(label_horizontal(*own) == Label.CLUTTER)


def _explain(labelling: ScanLabelling, line: int, upright: int) -> LineReason:
    common = _common(labelling, line, upright)
    unmet = first_unmet(common)
    if unmet is not None:
        return LineReason(line, str(unmet), common)
    planes = labelling.planes
    own = np.flatnonzero(planes.candidates.line == line).tolist()
    candidates = tuple(_up_to_first_unmet(_candidate(labelling, c)) for c in own)
    reasons = [_candidate_reason(labelling, c) for c in own]
    # The door conditions are of its up-most structure.
    door_lines = np.flatnonzero(labelling.door_lines.line == line).tolist()
    if door_lines:
        door = _up_to_first_unmet(_door(labelling, door_lines[0]))
        if first_unmet(door) is None:
            reasons.append(_door_reason(labelling, door_lines[0]))
    else:
        door = (_in_plane(None),)
    return LineReason(line, "; ".join(reasons), common, candidates, door)


def _common(labelling: ScanLabelling, line: int, upright: int) -> Conditions:
    """Return the conditions up to the first that is not met."""
    settings, structures = labelling.settings, labelling.structures
    of = f"of {len(labelling.lines.of(line))}"
    name = "III.A: returns without floor and ceiling"
    enough = Condition(name, upright, "≥", POINTS_MIN, note=of)
    if not enough.met:
        return (enough,)
    if labelling.lines.samples[line, 0] < 0:
        name = "III.A: returns in the middle of its sector"
        return (enough, Condition(name, 0, "≥", 1))
    slope, longest = "vertical_structures.slope_max", structures.longest[line]
    points_min = settings.vertical_structures.points_min
    return (
        enough,
        Condition(
            f"III.B, eq. 2: slope of {points_min} steadiest samples",
            _steadiest(structures.slope[line], points_min),
            "<",
            settings.vertical_structures.slope_max,
            setting=setting_of(settings, slope),
            decides=False,
        ),
        Condition(
            "III.B: longest such run, without a jump",
            *(longest, "≥", points_min),
            setting=setting_of(settings, "vertical_structures.points_min"),
        ),
    )


def _steadiest(slope: FloatArray, count: int) -> float:
    """Return the least bound on the slopes of `count` neighbouring samples; NaN without any."""
    known = np.where(np.isnan(slope), np.inf, np.abs(slope))
    least = sliding_window_view(known, count).max(axis=1).min()
    return float(least) if np.isfinite(least) else np.nan


def _reaches_ceiling(labelling: ScanLabelling, c: int, which: str) -> Condition:
    planes, settings = labelling.planes, labelling.settings
    reach, below_m = Reach(planes.candidates.reach[c]), planes.candidates.below_ceiling_m[c]
    if np.isnan(below_m):
        return Condition(
            f"III.B: height of its top (no ceiling in view){which}",
            labelling.structures.top_m[planes.candidates.structure[c]],
            "≥",
            settings.wall_planes.height_min_m,
            "m",
            setting_of(settings, "wall_planes.height_min_m"),
        )
    exceptions = {
        Reach.ABOVE_CEILINGS: "above all ceilings",
        Reach.TURNS_BACK: "no ceiling in its line",
        Reach.OVERHUNG: "overhung up to a ceiling",
    }
    return Condition(
        f"III.B: its top, from the ceiling{which}",
        np.abs(below_m),
        "<",
        settings.wall_planes.reach_m,
        "m",
        setting_of(settings, "wall_planes.reach_m"),
        note="above it" if below_m < 0 else "",
        otherwise=exceptions.get(reach, ""),
    )


def _candidate(labelling: ScanLabelling, c: int) -> Iterator[Condition]:
    """Yield the conditions of a wall candidate, in the order of the method."""
    planes, settings = labelling.planes, labelling.settings
    similarity_m, lines_min = settings.wall_planes.similarity_m, settings.wall_planes.lines_min
    similarity = setting_of(settings, "wall_planes.similarity_m")
    enough = setting_of(settings, "wall_planes.lines_min")
    structure = planes.candidates.structure[c]
    # A lower structure that reaches a ceiling is a candidate too: a wall below a lintel.
    is_upmost = structure == labelling.structures.upmost[planes.candidates.line[c]]
    which = "" if is_upmost else " (lower)"
    yield _reaches_ceiling(labelling, c, which)
    theta_m, gap_m = planes.candidate_distance_m[c], planes.candidate_gap_m[c]
    if not np.isnan(theta_m):
        name = f"Alg. 1, joins: Θ to the growing plane{which}"
        yield Condition(name, theta_m, "<", similarity_m, "m", similarity, decides=False)
        name = f"Alg. 1, joins: distance to its last line{which}"
        gap_max_m, gap = planes.candidates.gap_max_m[c], setting_of(settings, "wall_planes.gap_m")
        yield Condition(name, gap_m, "<", gap_max_m, "m", gap, decides=False)
    grown, nearest_m = planes.candidate_grown, planes.candidate_nearest_m[c]
    peers = int(np.count_nonzero(grown == grown[c]))
    name = f"Alg. 1: lines of the grown plane{which}"
    yield Condition(name, peers, "≥", lines_min, setting=enough, decides=False)
    none = "none within reach" if np.isnan(nearest_m) else ""
    name = f"Alg. 1: Θ to a plane of ≥ {lines_min} lines{which}"
    yield Condition(name, nearest_m, "<", similarity_m, "m", similarity, none)
    lines, length_m, rms_m, lowest_m = planes.candidate_settled[c]
    yield Condition(f"Alg. 1: its lines in the end{which}", lines, "≥", lines_min, setting=enough)
    yield Condition(f"III.B: its length{which}", length_m, "≥", LENGTH_MIN_M, "m")
    yield Condition(f"Alg. 1: its RMS{which}", rms_m, "≤", similarity_m, "m", similarity)
    name = f"III.B: its lower edge, else a duct{which}"
    yield Condition(name, lowest_m, "<", BOTTOM_MAX_M, "m")


def _candidate_reason(labelling: ScanLabelling, c: int) -> str:
    planes = labelling.planes
    if planes.candidate_plane[c] >= 0:
        off = centimetres(planes.candidate_nearest_m[c])
        return f"taken: plane {planes.candidate_plane[c]}, {off} off"
    return f"refused: {first_unmet(_candidate(labelling, c))}"


def _in_plane(plane: int | None) -> Condition:
    name = "III.C, door 1: planes that hold its top"
    note = "" if plane is None else f"(plane {plane})"
    return Condition(name, float(plane is not None), "≥", 1, note=note)


def _door(labelling: ScanLabelling, d: int) -> Iterator[Condition]:
    """Yield the conditions of a door, in the order of the method, and what follows from them."""
    doors, settings = labelling.door_lines, labelling.settings
    recess_m, name = settings.doors.recess_min_m, "III.C, door 2: "
    recess = setting_of(settings, "doors.recess_min_m")
    yield _in_plane(doors.plane[d])
    returns = doors.return_count[d]
    yield Condition(f"{name}returns at the plane or behind", returns, "≥", RETURNS_MIN)
    short = "line too short below the lintel" if np.isnan(doors.recess_m[d]) else ""
    step = f"{name}largest step back"
    yield Condition(step, doors.recess_m[d], ">", recess_m, "m", recess, short)
    above_max_m = ABOVE_PER_RECESS * recess_m + ABOVE_MORE_M
    above = setting_of(settings, "doors.recess_min_m", ABOVE_PER_RECESS)
    off_m = np.abs(doors.above_m[d])
    yield Condition(f"{name}wall above, off its plane", off_m, "≤", above_max_m, "m", above)
    yield Condition(f"{name}depth of the rest", -doors.below_m[d], "≥", recess_m, "m", recess)
    share = doors.on_plane_share[d]
    yield Condition(f"{name}share of it on the plane", share, "≤", EXCEPTIONS_MAX, "%")
    name, start_m = "III.C, door 3: height at which it begins", doors.start_height_m[d]
    height = setting_of(settings, "doors.height_min_m")
    yield Condition(name, start_m, "≥", settings.doors.height_min_m, "m", height)
    yield Condition(name, start_m, "≤", HEIGHT_MAX_M, "m")
    name = "III.C: depth of an open door, else closed"
    yield Condition(name, doors.depth_m[d], ">", OPEN_DEPTH_M, "m", decides=False)
    name, group = "III.C: neighbouring lines of its opening", labelling.openings.door_line_group[d]
    few, lines_min = setting_of(settings, "doors.lines_min"), settings.doors.lines_min
    yield Condition(name, group, "≥", lines_min, setting=few, decides=False)


def _up_to_first_unmet(conditions: Iterable[Condition]) -> Conditions:
    found: list[Condition] = []
    for condition in conditions:
        found.append(condition)
        if condition.decides and not condition.met:
            break
    return tuple(found)


def _door_reason(labelling: ScanLabelling, d: int) -> str:
    doors, opening = labelling.door_lines, int(labelling.openings.door_line_opening[d])
    if not doors.above_door[d]:
        return f"no door: {first_unmet(_door(labelling, d))}"
    state, depth = DoorState(doors.state[d]).name.lower(), centimetres(doors.depth_m[d])
    part = f"part of opening {opening}" if opening >= 0 else "too few lines for an opening"
    below = f"{depth} deep below {doors.start_height_m[d]:.2f} m"
    return f"above a door, {state}: {below}; {part}"


def line_document(
    labelling: ScanLabelling, reason: LineReason, note: str = "", returns: str = ""
) -> str:
    """Return one line's conditions in Markdown.

    note: below the heading. returns: on its returns, below the conditions.
    """
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
        table(HEADINGS, [own.row for own in reason.conditions]).replace("| no |", "| **no** |"),
        NOTE,
        returns,
        f"## Its vertical structures, upwards\n\n{table(headings, rows)}" if rows else "",
    ]
    return "\n\n".join(part for part in parts if part)


def count_outcomes(reasons: Sequence[LineReason]) -> list[tuple[str, str]]:
    """Return the number of lines with each outcome."""
    return [
        (str(sum(reason.outcome == outcome for reason in reasons)), name)
        for outcome, (name, _) in LINE_OUTCOMES.items()
    ]


def scan_document(
    labelling: ScanLabelling,
    reasons: Sequence[LineReason],
    marked: Sequence[int] | None = None,
) -> str:
    """Return a summary of a scan in Markdown: its planes, openings and lines.

    marked: number of marked returns of each line, if known.
    """
    planes, openings = labelling.planes, labelling.openings
    parts = [table(("lines", "outcome"), count_outcomes(reasons))]
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
