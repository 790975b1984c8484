"""Each line's reason is what the evidence shows, and changes with it."""

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


def labelled(settings: MethodSettings, returns: int | None = None) -> ScanLabelling:
    scan = synthetic.scan(3)
    fields = ("points_sensor", "ring", "cloud_index")
    scan = replace(scan, **{name: getattr(scan, name)[:returns] for name in fields})
    placed = place_scan(scan, synthetic.trajectory(4), synthetic.T_BASE_SENSOR)
    return label_scan(scan, placed, settings, 3)


@pytest.fixture(scope="module")
def usual() -> ScanLabelling:
    return labelled(synthetic.settings())


def test_every_candidate_and_door_line_has_its_reason(usual: ScanLabelling) -> None:
    reasons, planes = candidate_reasons(usual), usual.planes
    assert len(reasons) == len(planes.candidates.line) > 30
    for c, reason in enumerate(reasons):
        plane = planes.candidate_plane[c]
        off = f"taken: plane {plane}, {100 * planes.candidate_nearest_m[c]:.1f} cm off"
        assert reason.startswith(off if plane >= 0 else "refused: ")
    doors = usual.door_lines
    assert np.count_nonzero(doors.above_door) >= 2
    for d, reason in enumerate(door_reasons(usual)):
        assert reason.startswith("above a door, closed: " if doors.above_door[d] else "no door: ")
        if doors.above_door[d]:
            assert f"below {doors.start_height_m[d]:.2f} m; part of opening 0" in reason


def test_lines_are_explained_by_their_conditions(usual: ScanLabelling) -> None:
    reasons = explain_lines(usual)
    assert [reason.line for reason in reasons] == list(range(2 * synthetic.RINGS))
    assert [reason.outcome for reason in reasons] == line_outcomes(usual).tolist()
    documents = [line_document(usual, reason) for reason in reasons]
    for reason, document in zip(reasons, documents, strict=True):
        met = {condition.name: condition.met for condition in reason.conditions}
        has_samples = usual.lines.samples[reason.line, 0] >= 0
        assert met["III.A: returns without floor and ceiling"] == has_samples
        is_door = reason.outcome == LineOutcome.DOOR
        assert is_door == bool(met.get("III.C, door 3: height"))
        name = f"# Line {reason.line} (pair {reason.line // 2}, side {reason.line % 2})"
        assert document.startswith(name)
    documents.append(scan_document("Scan 3", ["A note."], usual, reasons))
    for document in documents:
        assert not re.search(r"\bnan\b", document)
        for block in document.split("\n\n"):  # no text in a table may have a bar of its own
            table = [row.count("|") for row in block.splitlines() if row.startswith("|")]
            assert len(set(table)) <= 1


@pytest.mark.parametrize(
    ("values", "membership", "words"),
    [
        ({"reach_m": 0.001}, Membership.REFUSED, "below the ceiling (limit ≤ 0.1 cm)"),
        ({"lines_min": 60}, Membership.ALONE, "no other near (limit ≥ 60 lines, or < 5.0 cm)"),
    ],
)
def test_the_reason_changes_with_the_setting(
    usual: ScanLabelling, values: dict[str, float], membership: Membership, words: str
) -> None:
    settings = synthetic.settings()
    planes = settings.wall_planes.model_copy(update=values)
    found = labelled(replace(settings, wall_planes=planes))
    # Lines without a return of the ceiling are candidates at any height.
    own = np.flatnonzero(found.planes.candidate_membership == membership)
    assert len(own) > 10
    assert np.count_nonzero(usual.planes.candidate_membership == membership) < len(own)
    reasons = candidate_reasons(found)
    assert all(words in reasons[c] for c in own)
    explained = explain_lines(found)
    assert all(words in explained[int(line)].short for line in found.planes.candidates.line[own])


def test_a_scan_with_few_returns_is_explained_too() -> None:
    found = labelled(synthetic.settings(), 50)
    reasons = explain_lines(found)
    assert {reason.outcome for reason in reasons} == {LineOutcome.NO_STRUCTURE}
    assert all("(limit ≥ 20)" in reason.short for reason in reasons)
    assert "No ceiling is in view." in scan_document("Scan", [], found, reasons)
