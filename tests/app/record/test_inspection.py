"""What is drawn of a scan and its lines is there for every line, also if nothing was found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from ffmap.algorithms.base.labels import Label, Truth
from ffmap.algorithms.building.panels import KIND_WORDS, Kind
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.app.record.inspection import ExplainedScan, ScanFaults, write
from ffmap.app.record.line_reasons import explain_lines
from ffmap.app.record.shapes import packed_colors
from ffmap.blueprints.entities import (
    BOTTOMMOST_COLOR,
    CLASSES,
    FAULT_CLASSES,
    LINE_TIMELINE,
    UPMOST_COLOR,
    Fault,
)
from tests import synthetic
from tests.app.record.recordings import static

STRIPS = "LineStrips3D:strips"


def explained(settings: dict[str, float]) -> ExplainedScan:
    scan = synthetic.scan(3)
    level = synthetic.level(scan, synthetic.trajectory(4))
    method = synthetic.settings()
    method = replace(method, wall_planes=method.wall_planes.model_copy(update=settings))
    labelling = label_scan(scan, level.placed, method, 3)
    reasons = explain_lines(labelling)
    notes = [f"Note {line}." for line in range(len(reasons))]
    return ExplainedScan(level, labelling, reasons, "# Scan", line=5, notes=notes)


def by_line(path: Path, entity: str, component: str) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for chunk in RrdReader(path).stream().filter(content=entity, has_timeline=LINE_TIMELINE):
        batch = chunk.to_record_batch()
        lines = batch.column(LINE_TIMELINE).to_pylist()
        found |= dict(zip(lines, batch.column(component).to_pylist(), strict=True))
    return found


@pytest.mark.parametrize("settings", [{}, {"lines_min": 60}], ids=["walls", "no walls"])
def test_each_line_is_on_the_timeline(settings: dict[str, float], tmp_path: Path) -> None:
    path, scan = tmp_path / "inspect.rrd", explained(settings)
    write(path, "inspect-1", scan)
    labelling, lines = scan.labelling, range(2 * synthetic.RINGS)
    structures, planes = labelling.structures, labelling.planes
    drawn = by_line(path, "/scan/line/structures", STRIPS)
    colors = by_line(path, "/scan/line/structures", "LineStrips3D:colors")
    sight = by_line(path, "/scan/line/sight", "Mesh3D:vertex_positions")
    in_plane = by_line(path, "/scan/line/plane", STRIPS)
    growing = by_line(path, "/scan/line/growing_plane", STRIPS)
    assert drawn.keys() == set(lines)
    upmost_color, bottommost_color = packed_colors(UPMOST_COLOR, BOTTOMMOST_COLOR)
    for line in lines:
        own = np.flatnonzero(structures.line == line)
        lengths = (structures.last - structures.first + 1)[own]
        assert [len(strip) for strip in drawn[line]] == lengths.tolist()
        is_upmost = own == structures.upmost[line]
        is_bottommost = ~is_upmost & (own == structures.bottommost[line])
        assert (np.array(colors[line]) == upmost_color).tolist() == is_upmost.tolist()
        assert (np.array(colors[line]) == bottommost_color).tolist() == is_bottommost.tolist()
        # A fan from the lidar to every sample of the line.
        assert len(sight[line]) == 1 + np.count_nonzero(labelling.lines.samples[line] >= 0)
        candidates = planes.candidates.line == line
        members = candidates & (planes.candidate_plane >= 0)
        assert len(in_plane[line]) == np.count_nonzero(members)
        compared = np.isfinite(planes.candidate_distance_m[candidates]).any()
        assert bool(growing[line]) == compared
    assert (sum(map(len, in_plane.values())) > 0) == (not settings)
    door = by_line(path, "/scan/line/door", STRIPS)
    behind = labelling.door_lines.line[labelling.door_lines.behind]
    assert {line for line, drawn in door.items() if drawn} == set(behind.tolist())


def test_wrong_labels_are_marked_in_the_scan_and_in_each_line(tmp_path: Path) -> None:
    scan = explained({})
    lines, returns = scan.labelling.lines, len(scan.labelling.label)
    fault = np.random.default_rng(2).choice(3, returns, p=(0.9, 0.06, 0.04)).astype(np.uint8)
    fault[lines.order[lines.starts[4] : lines.starts[5]]] = Fault.NONE
    faults, path = ScanFaults(fault, by_truth=True), tmp_path / "inspect.rrd"
    labelling, truth = scan.labelling, np.full(returns, Truth.BOARD_ON_WALL, np.uint8)
    final = np.where(fault == Fault.OF_THE_BUILDING, Label.CLUTTER, labelling.label)
    why = [KIND_WORDS[Kind.RELIEF] if own == Fault.OF_THE_BUILDING else "" for own in fault]
    known = {"final": final.astype(np.uint8), "truth": truth, "why_changed": why}
    write(path, "inspect-2", replace(scan, faults=faults, **known))
    marked = static(path)["/scan/faults"]
    # What a click on a return shows: its line, the true class, labels, and why.
    for entity, chosen in (("/scan/points", np.arange(returns)), ("/scan/faults", fault > 0)):
        clicked = {name: value[0] for name, value in static(path)[entity].items()}
        line = np.repeat(np.arange(len(lines)), np.diff(lines.starts))[np.argsort(lines.order)]
        assert clicked["line"] == line[chosen].tolist()
        short = [scan.reasons[own].short for own in clicked["line"]]
        assert clicked["why_line"] == short
        assert set(clicked["true_class"]) == {"board on wall"}
        assert clicked["final_label"] == [CLASSES[own][0] for own in final[chosen]]
        assert clicked["why_changed"] == np.array(why, object)[chosen].tolist()
        shown = zip(clicked["name_of_label_scan"], clicked["why_label_scan"], strict=True)
        for name, reason in shown:
            assert reason.startswith(("III.A", "III.C"))
            assert ("from the floor" in reason) == (name == "floor")
    np.testing.assert_array_equal(marked["class_ids"][0], fault[fault > 0])
    # Just before their returns, on the same rays.
    placed = scan.level.placed
    returned = placed.points_level[fault > 0] - placed.origin_level
    away = np.array(marked["positions"][0]) - placed.origin_level
    before_m = np.linalg.norm(returned, axis=1) - np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(before_m, 0.1, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(np.cross(returned, away), axis=1), 0.0, atol=1e-3)
    profiles = by_line(path, "/profile/faults", "Points2D:class_ids")
    documents = by_line(path, "/why/line", "TextDocument:text")
    counts = faults.counts(lines)
    assert counts.sum() == np.count_nonzero(fault)
    for line in range(len(lines)):
        own = fault[lines.order[lines.starts[line] : lines.starts[line + 1]]]
        assert list(profiles[line]) == own[own > 0].tolist()
        assert counts[line] == len(profiles[line])
        for kind in (Fault.OF_THE_SCAN, Fault.OF_THE_BUILDING):
            words = f"{np.count_nonzero(own == kind)} {FAULT_CLASSES[kind][0]}"
            assert (words in documents[line][0]) == bool((own == kind).any())
    assert counts[4] == 0
    assert "Final labels" not in documents[4][0]
    assert faults.worst_line(lines) == int(np.argmax(counts))
    assert ScanFaults(np.zeros(returns, np.uint8), by_truth=True).worst_line(lines) is None
