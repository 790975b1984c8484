"""Each line's reason is what the evidence shows, and changes with it."""

import operator
import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import place_scan
from ffmap.algorithms.scan.labelling import MethodSettings, ScanLabelling, label_scan
from ffmap.app.analysis.run_labels import read_clouds
from ffmap.app.record.conditions import Condition
from ffmap.app.record.line_reasons import (
    LineReason,
    candidate_reasons,
    door_reasons,
    explain_lines,
    line_document,
    line_outcomes,
    scan_document,
)
from ffmap.app.record.return_reasons import ReturnReasons
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import load_settings
from ffmap.blueprints.entities import CLASSES, LineOutcome
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.scans import SkippedScan
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.truth import read_truth
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
    documents = [line_document(usual, reason) for reason in reasons]
    for reason, document in zip(reasons, documents, strict=True):
        name = f"# Line {reason.line} (pair {reason.line // 2}, side {reason.line % 2})"
        assert document.startswith(name)
    documents.append(scan_document(usual, reasons))
    for document in documents:
        assert not re.search(r"\bnan\b", document)
        for block in document.split("\n\n"):  # no text in a table may have a bar of its own
            table = [row.count("|") for row in block.splitlines() if row.startswith("|")]
            assert len(set(table)) <= 1


@pytest.mark.parametrize(
    ("values", "unmet", "reason"),
    [
        (
            {"reach_m": 0.001},
            "III.B: its top, from the ceiling",
            "(limit < 0.1 cm; wall_planes.reach_m=0.001)",
        ),
        (
            {"lines_min": 60},
            "Alg. 1: Θ to a plane of ≥ 60 lines",
            "none within reach (limit < 5.0 cm; wall_planes.similarity_m=0.05)",
        ),
    ],
)
def test_the_reason_changes_with_the_setting(
    usual: ScanLabelling, values: dict[str, float], unmet: str, reason: str
) -> None:
    settings = synthetic.settings()
    planes = settings.wall_planes.model_copy(update=values)
    found = labelled(replace(settings, wall_planes=planes))
    refused = [own for own in explain_lines(found) if own.outcome == LineOutcome.REFUSED]
    own = [line for line in refused if any(c.name == unmet and not c.met for c in line.conditions)]
    # Lines without a return of the ceiling are candidates at any height.
    assert len(own) > 10
    assert all(reason in line.short for line in own)


def as_displayed(condition: Condition) -> bool:
    """Whether a condition holds by the numbers and the comparison in its row alone."""
    _, measured, limit, met, _, _ = condition.row
    number = re.match(r"-?[\d.]+", measured)
    comparison, *words = limit.split()
    compare = {"<": operator.lt, "≤": operator.le, ">": operator.gt, "≥": operator.ge}[comparison]
    holds = ", or " in limit
    if number is not None and not holds:
        assert re.sub(r"[-\d.]+", "", measured).split()[:1] == words[1:2] or not words[1:2]
        holds = compare(float(number[0]), float(words[0].rstrip("%,")))
    assert met.strip("()") == ("yes" if holds else "no"), condition
    return holds


def outcome_as_displayed(reason: LineReason) -> LineOutcome:
    def hold(conditions: Iterable[Condition]) -> bool:
        held = [as_displayed(own) or not own.decides for own in conditions]
        return all(held)

    if not hold(reason.common):
        return LineOutcome.NO_STRUCTURE
    held = [hold(own) for own in reason.candidates]
    if not any(held):
        return LineOutcome.REFUSED
    return LineOutcome.DOOR if hold(reason.door) else LineOutcome.WALL


Driven = list[tuple[ScanLabelling, FloatArray]]


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    """Scans of a simulated drive and their returns, with the usual and with stricter settings."""
    path = BagPath((tmp_path_factory.mktemp("drive") / "drive.bag",))
    drive = SimulationSettings(building="small", seed=2, sensor="vlp16", duration_s=6.0)
    simulate(path.parts[0], drive)
    lidars = [own.lidar for own in find_inputs(path, RunOptions()).verticals]
    with open_bag(path) as bag:
        truth = read_truth(bag)
    assert truth is not None
    assert truth.trajectory is not None
    walls = "similarity_m=0.004", "reach_m=0.03", "lines_min=6"
    strict = [f"wall_planes.{own}" for own in walls] + ["doors.recess_min_m=0.04"]
    few = ["vertical_structures.points_min=170"]
    settings = [load_settings(None, own).method for own in ([], strict, few)]
    found = []
    for number, place, scan in read_clouds(path, lidars):
        if number % 6 == 3 and not isinstance(scan, SkippedScan):
            placed = place_scan(scan, truth.trajectory, lidars[place].T_base_sensor)
            labelled = [label_scan(scan, placed, own, number) for own in settings]
            found += [(own, placed.points_level) for own in labelled]
    assert len(found) > 10
    return found


def test_conditions_as_displayed_give_the_outcome(driven: Driven) -> None:
    outcomes, names = set(), set()
    for labelling, _ in driven:
        reasons = explain_lines(labelling)
        shown = [outcome_as_displayed(reason) for reason in reasons]
        assert shown == line_outcomes(labelling).tolist()
        assert shown == [reason.outcome for reason in reasons]
        outcomes |= set(shown)
        names |= {
            own.name.removesuffix(" (lower)")
            for reason in reasons
            for own in reason.conditions
            if not own.met and own.decides
        }
    assert outcomes == set(LineOutcome)
    assert len(names) > 8, names


def test_a_setting_at_its_turning_value_turns_the_condition(driven: Driven) -> None:
    turned = set()
    for labelling, _ in driven:
        conditions = [own for reason in explain_lines(labelling) for own in reason.conditions]
        for own in conditions:
            value = own.turning_value
            if value is None:
                continue
            setting = own.setting
            assert setting is not None
            limit = own.limit + setting.scale * (value - setting.value)
            assert replace(own, limit=limit).met != own.met
            assert setting.allows(value)
            turned.add((setting.assignment.partition("=")[0], own.met))
    assert len(turned) > 10, turned


def test_returns_have_the_labels_of_their_conditions(driven: Driven) -> None:
    shown: set[str] = set()
    for labelling, points_level in driven:
        reasons = ReturnReasons(labelling, points_level)
        texts = reasons.short()
        assert all(texts)
        rows = reasons.rows()
        counts = np.bincount(labelling.label, minlength=len(Label))
        for label in Label:
            own = [row for row in rows if row[1] == CLASSES[label][0]]
            assert sum(int(row[0].replace(",", "")) for row in own) == counts[label]
            shown |= {row[2][:20] for row in own}
        # The condition of each group's median return, and so of more than its own.
        assert all(row[5] == "yes" for row in rows)
        surfaces = reasons.surface_rows
        assert len(surfaces) == 1 + len(labelling.ceilings)
        assert int(surfaces[0][4].replace(",", "")) == counts[Label.FLOOR]
        assert "distance from the floor: " in texts[int(np.argmax(labelling.label == Label.FLOOR))]
    assert len(shown) > 5, shown


def test_a_scan_with_few_returns_is_explained_too() -> None:
    found = labelled(synthetic.settings(), 50)
    reasons = explain_lines(found)
    assert {reason.outcome for reason in reasons} == {LineOutcome.NO_STRUCTURE}
    assert all("(limit ≥ 20)" in reason.short for reason in reasons)
