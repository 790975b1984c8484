"""What is drawn of a scan and its lines is there for every line, also where nothing was found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from ffmap.algorithms.poses.levelling import LevelledScan
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.app.record.inspection import ExplainedScan, ScanFaults, write
from ffmap.app.record.line_reasons import explain_lines
from ffmap.blueprints import entities
from ffmap.blueprints.entities import Fault
from tests import synthetic


def scan_of(settings: dict[str, float]) -> tuple[LevelledScan, ScanLabelling]:
    scan = synthetic.scan(3)
    level = synthetic.level(scan, synthetic.trajectory(4))
    method = synthetic.settings()
    method = replace(method, wall_planes=method.wall_planes.model_copy(update=settings))
    return level, label_scan(scan, level.placed, method, 3)


def by_line(path: Path, entity: str, component: str) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for chunk in RrdReader(path).stream().filter(content=entity, has_timeline=entities.LINE_TIMELINE):
        batch = chunk.to_record_batch()
        lines = batch.column(entities.LINE_TIMELINE).to_pylist()
        found |= dict(zip(lines, batch.column(component).to_pylist(), strict=True))
    return found


@pytest.mark.parametrize("settings", [{}, {"lines_min": 60}], ids=["walls", "no walls"])
def test_each_line_has_its_place_on_the_timeline(settings: dict[str, float], tmp_path: Path) -> None:
    level, labelling = scan_of(settings)
    path = tmp_path / "inspect.rrd"
    explained = ExplainedScan(level, labelling, explain_lines(labelling), None, "# Scan", line=5)
    write(path, "inspect-1", explained)
    lines = set(range(2 * synthetic.RINGS))
    strips = "LineStrips3D:strips"
    upmost = by_line(path, "/scan/line/structures/upmost", strips)
    assert upmost.keys() == lines
    structures = labelling.structures
    for line, drawn in upmost.items():
        own = structures.upmost[line]
        wanted = [structures.last[own] - structures.first[own] + 1] if own >= 0 else []
        assert [len(strip) for strip in drawn] == wanted
    others = by_line(path, "/scan/line/structures/others", strips)
    bottommost = by_line(path, "/scan/line/structures/bottommost", strips)
    for line in lines:
        count = len(upmost[line]) + len(bottommost[line]) + len(others[line])
        assert count == np.count_nonzero(structures.line == line)
    # A fan from the lidar to every sample of the line.
    sight = by_line(path, "/scan/line/sight", "Mesh3D:vertex_positions")
    assert {line: len(drawn) for line, drawn in sight.items()} == {
        line: 1 + np.count_nonzero(labelling.lines.samples[line] >= 0) for line in lines
    }
    planes = by_line(path, "/scan/line/plane", strips)
    members = labelling.planes.candidate_line[labelling.planes.candidate_plane >= 0]
    assert {line: len(drawn) for line, drawn in planes.items()} == {
        line: int(np.count_nonzero(members == line)) for line in lines
    }
    assert (sum(map(len, planes.values())) > 0) == (not settings)
    growing = by_line(path, "/scan/line/growing_plane", strips)
    for line in lines:
        compared = np.isfinite(labelling.planes.candidate_distance_m[labelling.planes.candidate_line == line])
        assert bool(growing[line]) == bool(compared.any())
    door = by_line(path, "/scan/line/door", strips)
    behind = labelling.door_lines.line[labelling.door_lines.behind]
    assert {line for line, drawn in door.items() if drawn} == set(behind.tolist())


def test_what_is_labelled_wrongly_is_marked_in_the_scan_and_in_each_line(tmp_path: Path) -> None:
    level, labelling = scan_of({})
    returns = len(labelling.label)
    fault = np.random.default_rng(2).choice(3, returns, p=(0.9, 0.06, 0.04)).astype(np.uint8)
    lines = labelling.lines
    quiet = lines.order[lines.starts[4] : lines.starts[5]]
    fault[quiet] = Fault.NONE
    path = tmp_path / "inspect.rrd"
    faults = ScanFaults(fault, by_truth=True)
    explained = ExplainedScan(level, labelling, explain_lines(labelling), faults, "# Scan", line=5)
    write(path, "inspect-2", explained)
    (batch,) = (
        batch
        for chunk in RrdReader(path).stream().filter(content="/scan/faults")
        if "Points3D:positions" in (batch := chunk.to_record_batch()).schema.names
    )
    drawn = np.array(batch.column("Points3D:positions")[0].as_py())
    np.testing.assert_array_equal(batch.column("Points3D:class_ids")[0].as_py(), fault[fault > 0])
    # Just before their returns, on the same rays.
    returned = level.placed.points_level[fault > 0] - level.placed.origin_level
    away = drawn - level.placed.origin_level
    np.testing.assert_allclose(np.linalg.norm(returned, axis=1) - np.linalg.norm(away, axis=1), 0.1, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(np.cross(returned, away), axis=1), 0.0, atol=1e-3)
    profiles = by_line(path, "/profile/faults", "Points2D:class_ids")
    told = by_line(path, "/why/line", "TextDocument:text")
    counts = faults.counts(lines)
    assert counts.sum() == np.count_nonzero(fault)
    for line in range(len(lines)):
        own = fault[lines.order[lines.starts[line] : lines.starts[line + 1]]]
        assert list(profiles[line]) == own[own > 0].tolist()
        assert counts[line] == len(profiles[line])
        for kind in (Fault.OF_THE_SCAN, Fault.OF_THE_BUILDING):
            words = f"{np.count_nonzero(own == kind)} {entities.FAULT_CLASSES[kind][0]}"
            assert (words in told[line][0]) == bool((own == kind).any())
    assert counts[4] == 0
    assert "Final labels" not in told[4][0]
    assert faults.worst_line(lines) == int(np.argmax(counts))
    assert ScanFaults(np.zeros(returns, np.uint8), by_truth=True).worst_line(lines) is None
