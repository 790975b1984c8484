"""What is drawn of a scan and its lines is there for every line, also where nothing was found."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from algorithms.labelling import ScanLabelling, label_scan
from algorithms.levelling import LevelledScan
from app.inspect_recorder import write
from app.reasons import explain_lines
from blueprints import entities
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
    write(path, tmp_path, "inspect-1", level, labelling, explain_lines(labelling), "# Scan", line=5)
    lines = set(range(2 * synthetic.RINGS))
    strips = "LineStrips3D:strips"
    upmost = by_line(path, f"{entities.LINE_STRUCTURES}/upmost", strips)
    assert upmost.keys() == lines
    structures = labelling.structures
    for line, drawn in upmost.items():
        own = structures.upmost[line]
        wanted = [structures.last[own] - structures.first[own] + 1] if own >= 0 else []
        assert [len(strip) for strip in drawn] == wanted
    others = by_line(path, f"{entities.LINE_STRUCTURES}/others", strips)
    bottommost = by_line(path, f"{entities.LINE_STRUCTURES}/bottommost", strips)
    for line in lines:
        count = len(upmost[line]) + len(bottommost[line]) + len(others[line])
        assert count == np.count_nonzero(structures.line == line)
    # A fan from the lidar to every sample of the line.
    sight = by_line(path, entities.LINE_SIGHT, "Mesh3D:vertex_positions")
    assert {line: len(drawn) for line, drawn in sight.items()} == {
        line: 1 + np.count_nonzero(labelling.lines.samples[line] >= 0) for line in lines
    }
    planes = by_line(path, entities.LINE_PLANE, strips)
    members = labelling.planes.candidate_line[labelling.planes.candidate_plane >= 0]
    assert {line: len(drawn) for line, drawn in planes.items()} == {
        line: int(np.count_nonzero(members == line)) for line in lines
    }
    assert (sum(map(len, planes.values())) > 0) == (not settings)
    growing = by_line(path, entities.LINE_GROWING, strips)
    for line in lines:
        compared = np.isfinite(labelling.planes.candidate_distance_m[labelling.planes.candidate_line == line])
        assert bool(growing[line]) == bool(compared.any())
    door = by_line(path, entities.LINE_DOOR, strips)
    behind = labelling.door_lines.line[labelling.door_lines.behind]
    assert {line for line, drawn in door.items() if drawn} == set(behind.tolist())
