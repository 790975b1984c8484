"""Each line's reason says what the evidence says, and turns with it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.trajectory import place_scan
from ffmap.algorithms.scan.labelling import MethodSettings, ScanLabelling, label_scan
from ffmap.algorithms.scan.wall_planes import Membership
from ffmap.app.record.line_reasons import (
    candidate_reasons,
    door_reasons,
    explain_lines,
    line_document,
    line_outcomes,
    scan_document,
)
from ffmap.blueprints.entities import LineOutcome
from tests import synthetic


def labelled(settings: MethodSettings) -> ScanLabelling:
    scan = synthetic.scan(3)
    return label_scan(scan, place_scan(scan, synthetic.trajectory(4), synthetic.T_BASE_SENSOR), settings, 3)


@pytest.fixture(scope="module")
def usual() -> ScanLabelling:
    return labelled(synthetic.settings())


def test_every_candidate_and_door_line_has_its_reason(usual: ScanLabelling) -> None:
    reasons = candidate_reasons(usual)
    planes = usual.planes
    assert len(reasons) == len(planes.candidate_line) > 30
    for c, reason in enumerate(reasons):
        plane = planes.candidate_plane[c]
        off = f"taken: plane {plane}, {100 * planes.candidate_nearest_m[c]:.1f} cm off"
        assert reason.startswith(off if plane >= 0 else "refused: ")
    doors = usual.door_lines
    for d, reason in enumerate(door_reasons(usual)):
        assert reason.startswith("above a door, closed: " if doors.above_door[d] else "no door: ")
        if doors.above_door[d]:
            assert f"below {doors.start_height_m[d]:.2f} m; part of opening 0" in reason
    assert np.count_nonzero(doors.above_door) >= 2


def test_lines_are_explained_by_their_checks(usual: ScanLabelling) -> None:
    reasons = explain_lines(usual)
    assert [reason.line for reason in reasons] == list(range(2 * synthetic.RINGS))
    assert [reason.outcome for reason in reasons] == line_outcomes(usual)
    for reason in reasons:
        held = {check.condition: check.held for check in reason.checks}
        assert held["III.A: returns but floor, ceiling"] == (usual.lines.samples[reason.line, 0] >= 0)
        assert (reason.outcome == LineOutcome.DOOR) == bool(held.get("III.C, door 3: high enough"))
        if reason.outcome == LineOutcome.NO_STRUCTURE:
            assert reason.short in reason.verdict
        document = line_document(usual, reason)
        assert document.startswith(f"# Line {reason.line} (pair {reason.line // 2}, side {reason.line % 2})")
        # What a table shows is in columns: no text may bring a bar of its own.
        assert {line.count("|") for line in document.splitlines() if line.startswith("|")} == {5}
        assert not re.search(r"\bnan\b", document)
    document = scan_document("Scan 3", ["A note."], usual, reasons)
    assert document.count("\n| ") > 2 * synthetic.RINGS
    assert not re.search(r"\bnan\b", document)


@pytest.mark.parametrize(
    ("step", "values", "membership", "words"),
    [
        ("wall_planes", {"reach_m": 0.001}, Membership.REFUSED, "below the ceiling, a wall at most 0.1 cm"),
        ("wall_planes", {"lines_min": 60}, Membership.ALONE, "60 make a wall, and no other plane is within reach"),
        ("wall_planes", {"length_min_m": 30.0}, Membership.SHORT, "its plane is shorter than 30.00 m"),
        ("wall_planes", {"bottom_max_m": 0.01}, Membership.DUCT, "a duct or a beam"),
    ],
)
def test_the_reason_turns_with_the_setting(
    usual: ScanLabelling, step: str, values: dict[str, float], membership: Membership, words: str
) -> None:
    settings = synthetic.settings()
    changed = replace(settings, **{step: getattr(settings, step).model_copy(update=values)})
    found = labelled(changed)
    # Lines without a return of the ceiling are believed whatever they reach.
    own = np.flatnonzero(found.planes.candidate_membership == membership)
    assert len(own) > 10
    assert np.count_nonzero(usual.planes.candidate_membership == membership) < len(own)
    reasons = candidate_reasons(found)
    assert all(words in reasons[c] for c in own)
    explained = {reason.line: reason for reason in explain_lines(found)}
    for line in found.planes.candidate_line[own]:
        assert words in explained[int(line)].verdict


def test_a_scan_of_nothing_is_explained_too(usual: ScanLabelling) -> None:
    scan = synthetic.scan(3)
    few = replace(
        scan,
        points_sensor=scan.points_sensor[:50],
        ring=scan.ring[:50],
        cloud_index=scan.cloud_index[:50],
    )
    placed = place_scan(few, synthetic.trajectory(4), synthetic.T_BASE_SENSOR)
    found = label_scan(few, placed, synthetic.settings(), 3)
    reasons = explain_lines(found)
    assert {reason.outcome for reason in reasons} == {LineOutcome.NO_STRUCTURE}
    assert all("fewer than 20 returns" in reason.short for reason in reasons)
    assert "No ceiling is in view." in scan_document("Scan", [], found, reasons)
