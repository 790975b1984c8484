"""The building is drawn as it was found, and says why."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.building.evidence import BEYOND, ON
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.heights import HeightMap, Surface
from ffmap.algorithms.building.model import Blinds, BuildingSettings, unknown_support
from ffmap.algorithms.building.parse import Kind, ParseSettings
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.building.verdicts import FaceVerdict, JudgedFaces
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.record.building import (
    log_building,
    log_faces,
    log_fused_walls,
    log_grid,
    log_map_block,
)
from ffmap.app.record.building_reasons import building_document
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.scans import log_skipped
from ffmap.app.record.stream import open_part
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from tests import synthetic
from tests.app.record.recordings import rows, start, static, vectors
from tests.faces import NO_JUDGED_FACES, doors, faces, traced, window
from tests.painted import evidence_of, wall

WALLS = replace(
    faces(((0.0, 0.0), (4.0, 0.0))),
    support=replace(
        unknown_support(1),
        **{"kind": np.array([Kind.WALL]), "second": np.array([Kind.LOW]), "odds": np.array([42.4])},
        **{"on": np.array([1500.0]), "behind": np.array([20.0]), "seen": np.array([0.75])},
    ),
)
DOOR = doors(
    ((1.0, 0.0), (1.9, 0.0)),
    **{"depth_m": [0.05], "agreement": [1.0], "coverage": [0.9], "lintel": [0.75]},
    **{"ajar": [False], "ray_count": [50], "scan_count": [3], "first_scan": [5]},
    **{"last_scan": [9], "crossed": [False]},
)


def building() -> BuildingModel:
    """A wall with a closed door and a window, a leaf that was refused, and level surfaces."""
    columns = 80
    covered = np.zeros((columns, 60), bool)
    covered[2:4, 1] = True
    before = Foreground(np.array([0, columns]), np.full(columns, 2.8), np.zeros(columns), covered)
    attic = np.full((2, 3), np.nan)
    attic[1, 2] = 2.0
    heights = attic - 0.04, attic + 0.04
    levels = (HeightMap(Surface.CEILING, np.array([1.0, 3.0]), 0.1, *heights),)
    refused = faces(((1.0, 0.0), (1.0, 0.9)))
    judged = JudgedFaces(WALLS, refused, np.array([FaceVerdict.ENDS_LOW]))
    sheet = {"sheet_m": 0.1, "sheet_share": 0.08, "sheet_patches": 0.95}
    known = replace(WALLS.support, **{name: np.array([value]) for name, value in sheet.items()})
    pane = replace(window((2.5, 0.0), (3.5, 0.0)), support=known)
    hung = (np.array([value]) for value in (2.2, 2.6, 0.12))
    blinds = Blinds(pane.ends, pane.normal, *hung)
    return BuildingModel(WALLS, before, judged, DOOR, pane, blinds, levels)


def recorded(folder: Path, model: BuildingModel) -> dict[str, dict[str, Any]]:
    with open_part(folder / "building.rrd", "run-4") as stream:
        log_building(Log(stream), model)
    return static(folder / "building.rrd")


def test_walls_doors_and_windows_are_drawn_where_they_are(tmp_path):
    found = recorded(tmp_path, building())
    assert found["/world/building/doors"]["labels"][0] == ["door 0: closed, 0.90 m; not parsed"]
    why = "odds 42 nats against low; 1,500 rays ended on it, 20 behind; 75% of its cells seen"
    assert found[f"{entities.WALLS}/000"]["labels"][0] == [f"wall 0: {why}"]
    assert found[f"{entities.WALLS}/000"]["odds"][0] == pytest.approx([42.4])
    (of_pane,) = found["/world/building/windows"]["labels"][0]
    assert of_pane == f"window 0: {why}; sheet 8% (95% of patches) at 0.10 m"
    assert "no wall 0: rays pass above it" in str(found["/world/building/refused_walls"]["labels"])
    against = vectors(found["/world/building/against_walls"]["positions"][0])
    np.testing.assert_allclose(against, [[0.125, 0, 0.075], [0.175, 0, 0.075]], atol=1e-6)
    outline = vectors(found["/world/building/windows"]["strips"][0][0])
    corners = [[2.5, 0, 0.9], [3.5, 0, 0.9], [3.5, 0, 2.2]]
    np.testing.assert_allclose(outline[:3], corners, rtol=1e-6)
    hung = vectors(found["/world/building/blinds"]["vertex_positions"][0])
    corners = [[2.5, -0.12, 2.2], [3.5, -0.12, 2.2], [3.5, -0.12, 2.6], [2.5, -0.12, 2.6]]
    np.testing.assert_allclose(hung, corners, rtol=1e-6)
    panels = vectors(found[f"{entities.WALLS}/000"]["vertex_positions"][0]).reshape(-1, 4, 3)
    in_door = (panels.mean(axis=1)[:, 0] > 1.0) & (panels.mean(axis=1)[:, 0] < 1.9)
    assert panels[in_door, :, 2].min() >= 2.0999  # only what is above its head
    leaf = vectors(found["/world/building/leaves"]["vertex_positions"][0])
    corners = [[1.0, 0, 0], [1.9, 0, 0], [1.9, 0, 2.1], [1.0, 0, 2.1]]
    np.testing.assert_allclose(leaf, corners, rtol=1e-6)
    ceiling = found[f"/world/building/levels/{Surface.CEILING}"]
    np.testing.assert_allclose(vectors(ceiling["centers"][0]), [[1.25, 3.15, 2.0]], rtol=1e-6)
    np.testing.assert_allclose(ceiling["high_m"][0], [2.04], rtol=1e-6)


def test_an_open_door_is_its_frame_alone(tmp_path):
    found = recorded(tmp_path, replace(building(), doors=replace(DOOR, state=np.ones(1, np.uint8))))
    assert "/world/building/doors" in found
    assert "/world/building/leaves" not in found


def rows_of(document: str, heading: str) -> list[dict[str, str]]:
    """The rows of the first table after a heading of a document in Markdown."""
    lines = document.split(f"## {heading}\n")[1].splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("|"))
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in lines[first : first + lines[first:].index("") if "" in lines[first:] else None]
    ]
    return [dict(zip(cells[0], row, strict=True)) for row in cells[2:]]


def test_the_document_has_what_was_measured():
    document = building_document(building())
    (door,) = rows_of(document, "Doors")
    assert door["state"] == "closed"
    assert (door["x, y (m)"], door["length (m)"]) == ("1.45, 0.00", "0.90")
    assert (door["confidence"], door["odds (nats)"], door["sheet"]) == ("0.9", "–", "–")
    (own,) = rows_of(document, "Walls")
    assert (own["odds (nats)"], own["against"], own["on"]) == ("42", "low", "1,500")
    (refused,) = rows_of(document, "Faces that are not walls")
    assert "rays pass above it" in refused["why"]
    (pane,) = rows_of(document, "Windows")
    assert (pane["bottom (m)"], pane["top (m)"], pane["pane (m)"]) == ("0.9", "2.2", "0.1")
    (blind,) = rows_of(document, "Blinds and shutters")
    assert blind["behind (m)"] == "0.12"
    assert "| ceiling | 0.1 | 0.0 | 1.96 – 2.04 |" in document
    assert not re.search(r"\bnan\b", document)
    for heading in ("Low walls", "Panes of open leaves"):
        assert f"## {heading}" not in document
    empty = replace(building(), doors=DOOR.select(np.zeros(1, bool)), judged=NO_JUDGED_FACES)
    assert "None." in building_document(empty)


def test_panes_and_low_walls_are_told_from_windows(tmp_path):
    model = replace(
        building(),
        leaf_panes=window((1.0, 0.3), (1.0, 0.9)),
        low_walls=replace(WALLS, top_m=np.array([1.1]), rms_m=np.array([0.006])),
    )
    found = recorded(tmp_path, model)
    labels = found["/world/building/windows"]["labels"][0]
    assert [label.split(":")[0] for label in labels] == ["window 0", "pane of an open leaf 0"]
    document = found["/world/building/reasons"]["text"][0][0]
    assert rows_of(document, "Panes of open leaves")[0]["length (m)"] == "0.60"
    assert rows_of(document, "Low walls")[0]["rms (m)"] == "0.006"


def test_fused_planes_are_drawn_before_any_is_judged(tmp_path):
    fused = replace(WALLS, rms_m=np.array([0.013]))
    with open_part(tmp_path / "faces.rrd", "run-4") as stream:
        log_fused_walls(Log(stream), fused)
    found = static(tmp_path / "faces.rrd")["/world/building/fused_walls"]
    scans = int(fused.scan_count[0])
    assert f"fused from wall planes of {scans} scans, 13 mm rms" in str(found["labels"])
    np.testing.assert_allclose(found["rms_m"][0], [0.013], rtol=1e-6)


def test_map_trajectory_and_messages(tmp_path):
    path = tmp_path / "recording.rrd"
    recording = start(tmp_path, "run-4")
    log = Log(recording.stream)
    cells = np.full((2, 3), Cell.FREE, np.uint8)
    cells[0, 0], cells[1, 2] = Cell.OCCUPIED, Cell.UNKNOWN
    log_grid(log, entities.FURNITURE_FREE, GridMap(cells, np.array([-1.0, 2.0]), 0.05))
    stamps = np.array([synthetic.stamp_ns(index) for index in range(3)])
    log_trajectory(log, stamps, synthetic.trajectory(3).T_map_base, np.arange(3))
    log_map_block(log, 2, int(stamps[2]), np.ones((4, 3)), np.array([1, 2, 2, 3], np.uint8))
    log_skipped(log, 1, int(stamps[1]), "all returns invalid")
    log.send_rows()
    recording.set_layout(run_blueprint.build(True, (0.0, 0.0), 5.0))
    recording.finish()
    image = static(path)[f"{entities.GRID}/{entities.FURNITURE_FREE}"]["data"][0][0]
    assert list(bytes(image)) == [0, 0, 255, 100, 0, 0]  # the uppermost row first
    steps = [vectors(row["strips"][0]) for row in rows(path, entities.TRAJECTORY)]
    np.testing.assert_allclose(steps[2], [[0.05, 0.0, 0.0], [0.1, 0.0, 0.0]], atol=1e-6)
    assert [len(row["class_ids"]) for row in rows(path, "/world/map/ceiling")] == [2]
    assert "scan 1 skipped: all returns invalid" in str(list(rows(path, "/messages")))


def test_each_wall_face_is_a_picture_of_where_rays_ended(tmp_path):
    face = wall(4.0).paint((1.0, 1.9), (0.0, 2.1), BEYOND)
    known = traced(faces(((0.0, 0.0), (4.0, 0.0))), evidence_of(face), 2.8)
    parsed = ParsedFaces.of(known, np.zeros((0, 2)), BuildingSettings(), ParseSettings())
    leaning = faces(((1.0, 0.0), (1.0, 0.9)))
    refused = leaning.append(parsed.cut([(0, 0, 80)]))
    with open_part(tmp_path / "faces.rrd", "run-4") as stream:
        log_faces(Log(stream), parsed, parsed, JudgedFaces(WALLS, refused, np.array([3, 1])))
    found = static(tmp_path / "faces.rrd")
    own = found[f"{entities.FACES}/000"]
    (buffer,), (layout,) = own["albedo_texture_buffer"][0], own["albedo_texture_format"][0]
    assert (layout["width"], layout["height"]) == (80, 56)
    picture = np.array(buffer, np.uint8).reshape(56, 80, 3)
    # Its first row is the highest.
    assert tuple(picture[-1, 30]) == entities.LAYER_COLORS[BEYOND]
    assert tuple(picture[0, 30]) == tuple(picture[-1, 50]) == entities.LAYER_COLORS[ON]
    corners = vectors(own["vertex_positions"][0])
    np.testing.assert_allclose(corners.min(axis=0), [0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [4.0, 0.0, 2.8], atol=1e-6)
    # The first of the refused faces was not parsed, so the second has a picture.
    assert f"{entities.FACES}/refused/001" in found
    labels = own["labels"][0]
    assert [label.split(",")[0] for label in labels] == ["wall", "doorway", "wall"]
    assert all("nats against" in label for label in labels)
