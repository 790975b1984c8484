"""The building is drawn as it was found, and says why."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.building.face_alignment import AlignedFaces
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES, FaceVerdict, JudgedFaces
from ffmap.algorithms.building.final_labels import BuildingModel
from ffmap.algorithms.building.height_map import HeightMap, Surface
from ffmap.algorithms.building.model import NO_BLINDS, NO_WINDOWS, Blinds, Mullions
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.record.building import log_building, log_fused_walls, log_grid, log_map_block
from ffmap.app.record.building_reasons import explain_building
from ffmap.app.record.log import Log
from ffmap.app.record.odometry import log_trajectory
from ffmap.app.record.scans import log_skipped
from ffmap.app.record.stream import open_part
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from tests import synthetic
from tests.app.record.recordings import rows, start, static, vectors
from tests.faces import doors, faces, window

WALLS = faces(((0.0, 0.0), (4.0, 0.0)))
DOOR = doors(
    ((1.0, 0.0), (1.9, 0.0)),
    **{"depth_m": [0.05], "agreement": [1.0], "coverage": [0.9], "lintel": [0.75]},
    **{"ajar": [False], "ray_count": [50], "scan_count": [3], "first_scan": [5], "last_scan": [9], "crossed": [False]},
)


def building() -> BuildingModel:
    """A wall with a closed door and a window, a leaf that was refused, and level surfaces."""
    columns = 80
    covered = np.zeros((columns, 60), bool)
    covered[2:4, 1] = True
    before = Foreground(np.array([0, columns]), np.full(columns, 2.8), np.zeros(columns), covered)
    attic = np.full((2, 3), np.nan)
    attic[1, 2] = 2.0
    levels = (HeightMap(Surface.SLOPING_CEILING, np.array([1.0, 3.0]), 0.1, attic - 0.04, attic + 0.04),)
    judged = JudgedFaces(WALLS, faces(((1.0, 0.0), (1.0, 0.9))), np.array([FaceVerdict.ENDS_LOW]))
    pane = window((2.5, 0.0), (3.5, 0.0))
    hung = (np.array([value]) for value in (2.2, 2.6, 0.12, -0.3))
    return BuildingModel(WALLS, before, judged, DOOR, pane, Blinds(pane.ends, pane.normal, *hung), levels)


def recorded(folder: Path, model: BuildingModel) -> dict[str, dict[str, Any]]:
    with open_part(folder / "building.rrd", "run-4") as stream:
        log_building(Log(stream), model)
    return static(folder / "building.rrd")


def test_walls_doors_and_windows_are_drawn_where_they_are(tmp_path):
    found = recorded(tmp_path, building())
    assert "closed door, 0.90 m, 90%" in str(found[entities.DOORS]["labels"])
    assert "no wall: rays pass above it" in str(found[entities.REFUSED_WALLS]["labels"])
    against = vectors(found[entities.AGAINST_WALLS]["positions"][0])
    np.testing.assert_allclose(against, [[0.125, 0, 0.075], [0.175, 0, 0.075]], atol=1e-6)
    outline = vectors(found[entities.WINDOWS]["strips"][0][0])
    np.testing.assert_allclose(outline[:3], [[2.5, 0, 0.9], [3.5, 0, 0.9], [3.5, 0, 2.2]], rtol=1e-6)
    hung = vectors(found[entities.BLINDS]["vertex_positions"][0])
    np.testing.assert_allclose(hung, [[2.5, -0.12, 2.2], [3.5, -0.12, 2.2], [3.5, -0.12, 2.6], [2.5, -0.12, 2.6]], rtol=1e-6)
    panels = vectors(found[entities.WALLS]["vertex_positions"][0]).reshape(-1, 4, 3)
    in_door = (panels.mean(axis=1)[:, 0] > 1.0) & (panels.mean(axis=1)[:, 0] < 1.9)
    assert panels[in_door, :, 2].min() >= 2.0999  # only what is above its head
    leaf = vectors(found[entities.DOOR_LEAVES]["vertex_positions"][0])
    np.testing.assert_allclose(leaf, [[1.0, 0, 0], [1.9, 0, 0], [1.9, 0, 2.1], [1.0, 0, 2.1]], rtol=1e-6)
    sloping = found[f"{entities.LEVELS}/{Surface.SLOPING_CEILING}"]
    np.testing.assert_allclose(vectors(sloping["centers"][0]), [[1.25, 3.15, 2.0]], rtol=1e-6)
    np.testing.assert_allclose(sloping["high_m"][0], [2.04], rtol=1e-6)


def test_a_leaf_may_hang_before_its_wall(tmp_path):
    found = recorded(tmp_path, replace(building(), doors=replace(DOOR, depth_m=np.array([-0.05]))))
    assert "leaf 5.0 cm before the wall" in found[entities.BUILDING_REASONS]["text"][0][0]


def test_an_open_door_is_its_frame_alone(tmp_path):
    found = recorded(tmp_path, replace(building(), doors=replace(DOOR, state=np.ones(1, np.uint8))))
    assert entities.DOORS in found
    assert entities.DOOR_LEAVES not in found


def test_the_building_says_why(tmp_path):
    reasons = recorded(tmp_path, building())[entities.BUILDING_REASONS]["text"][0][0]
    for words in (
        "100% of 50 rays in 90% of its columns; leaf 5.0 cm behind the wall",
        "head at 2.10 m, wall seen above 75% of it",
        "3 from 5 to 9",
        "rays pass above it",
        "10 cm behind the face",
        "| 3.00, 0.00 | 1.00 m | 2.20 – 2.60 m | 12.0 cm behind the wall; returns 30 % less than the wall |",
        "| sloping ceiling | 0.0 m² | 1.96 – 2.04 m |",
    ):
        assert words in reasons
    assert "aslant" not in reasons
    ajar = replace(building(), judged=NO_JUDGED_FACES, doors=replace(DOOR, ajar=np.array([True])), levels=())
    assert "its leaf stands aslant" in explain_building(ajar)


def test_the_pane_of_an_open_leaf_is_told_from_a_window(tmp_path):
    pane = window((1.0, 0.3), (1.0, 0.9))
    found = recorded(tmp_path, replace(building(), leaf_panes=pane))
    assert found[entities.WINDOWS]["labels"][0] == ["window", "pane of an open leaf"]
    reasons = found[entities.BUILDING_REASONS]["text"][0][0]
    assert "| 1.00, 0.60 | 0.60 m | 0.90 – 2.20 m | 10 cm behind the face |" in reasons.split("## Panes of open leaves")[1]
    alone = recorded(tmp_path, replace(building(), windows=NO_WINDOWS, blinds=NO_BLINDS, leaf_panes=pane))
    assert "## Windows" not in alone[entities.BUILDING_REASONS]["text"][0][0]


def test_low_walls_are_listed_with_what_they_rest_on():
    low = replace(WALLS, top_m=np.array([1.1]), rms_m=np.array([0.006]))
    reasons = explain_building(replace(building(), low_walls=low))
    assert "| 2.00, 0.00 | 4.00 m | 1.10 m | 6 mm |" in reasons.split("## Low walls")[1]
    assert "## Low walls" not in explain_building(building())


def test_a_mullion_is_shown_before_its_pane(tmp_path):
    between_m = np.array([0.1]), np.array([2.6])
    mullion = Mullions(np.array([[[1.0, 0.0], [1.1, 0.0]]]), np.array([[0.0, 1.0]]), *between_m, np.array([0.08]))
    found = recorded(tmp_path, replace(building(), mullions=mullion))
    corners = np.array(found[entities.MULLIONS]["vertex_positions"][0])
    np.testing.assert_allclose(np.unique(corners.round(4), axis=0)[:, 1], 0.08)
    assert (corners[:, 2].min(), corners[:, 2].max()) == pytest.approx((0.1, 2.6))
    reasons = found[entities.BUILDING_REASONS]["text"][0][0]
    assert "| 1.05, 0.00 | 0.10 m | 0.10 – 2.60 m | 8 cm |" in reasons.split("## Mullions")[1]
    assert "## Mullions" not in explain_building(building())


def test_a_cased_door_says_where_its_leaf_lies() -> None:
    """Flush with its wall, or deep in it where the reveals hide its recess."""
    cased = replace(DOOR, casing_m=np.array([0.006]))
    deep = explain_building(replace(building(), doors=replace(cased, depth_m=np.array([0.28]))))
    assert "leaf 28.0 cm behind the wall; casing 6 mm before the wall" in deep
    flush = explain_building(replace(building(), doors=replace(cased, depth_m=np.zeros(1))))
    assert "leaf flush with the wall; casing 6 mm before the wall" in flush
    outlined = explain_building(replace(building(), doors=replace(cased, outline=np.array([-0.062]))))
    assert "outline returns 6 % less than the wall" in outlined


def test_a_glazed_door_and_a_reflection_say_what_they_are(tmp_path: Path) -> None:
    model = building()
    judged = replace(model.judged, verdict=np.array([FaceVerdict.MIRRORED]))
    model = replace(model, judged=judged, doors=replace(DOOR, glazed=np.array([True])))
    reasons = explain_building(model)
    assert "leaf of glass, with wall on both sides and above" in reasons
    assert "a pane's reflection of another wall" in reasons
    found = recorded(tmp_path, model)
    assert found[entities.DOORS]["glazed"][0] == [1]
    assert "a pane's reflection of another wall" in str(found[entities.REFUSED_WALLS]["labels"])


def test_faces_are_drawn_as_they_were_before_they_were_laid_along_all_returns(tmp_path):
    moved = AlignedFaces(WALLS, replace(WALLS, ends=WALLS.ends + 0.02), np.array([[-0.02, 0.013]]), np.array([True]))
    with open_part(tmp_path / "faces.rrd", "run-4") as stream:
        log_fused_walls(Log(stream), moved)
    found = static(tmp_path / "faces.rrd")[entities.FUSED_WALLS]
    assert "its ends then moved -2.0 and +1.3 cm towards the room; a part of a face that was cut" in str(found["labels"])
    np.testing.assert_allclose(found["moved_m"][0], [[-0.02, 0.013]], rtol=1e-6)


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
    recording.set_layout(run_blueprint.build(32, (0.0, 0.0), 5.0))
    recording.finish()
    image = static(path)[f"{entities.GRID}/{entities.FURNITURE_FREE}"]["data"][0][0]
    assert list(bytes(image)) == [0, 0, 255, 100, 0, 0]  # the uppermost row first
    steps = [vectors(row["strips"][0]) for row in rows(path, entities.TRAJECTORY)]
    np.testing.assert_allclose(steps[2], [[0.05, 0.0, 0.0], [0.1, 0.0, 0.0]], atol=1e-6)
    assert [len(row["class_ids"]) for row in rows(path, entities.MAP_CEILING)] == [2]
    assert "scan 1 skipped: all returns invalid" in str(list(rows(path, entities.MESSAGES)))
