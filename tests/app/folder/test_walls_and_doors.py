"""walls.geojson and doors.geojson, read back as JSON."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.maps.area_graph import find_rooms
from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.room_files import topology, write_passages
from ffmap.app.folder.walls_and_doors import write_doors, write_walls
from tests.algorithms.maps.test_area_graph import SETTINGS, draw, office
from tests.faces import doors, faces


def features(path: Path) -> list[dict[str, Any]]:
    content = json.loads(path.read_text())
    assert content["type"] == "FeatureCollection"
    return list(content["features"])


def test_doors(tmp_path: Path) -> None:
    path = tmp_path / "doors.geojson"
    found = doors(
        ((0.0, 0.0), (0.9, 0.0)),
        ((5.0, 1.12), (5.0, 2.0)),
        head_m=2.0,
        normal=[[0.0, 1.0], [-1.0, 0.0]],
        reveal_m=[0.3, 0.6],
        depth_m=[0.05, np.nan],
        state=[0, 1],
        agreement=[0.9, 0.7],
        coverage=[1.0, 1.0],
        crossed=[False, True],
    )
    write_doors(path, found, [("a", None), None])
    closed, opened = features(path)
    line = {"type": "LineString", "coordinates": [[0.0, -0.05], [0.9, -0.05]]}
    assert (closed["type"], closed["geometry"]) == ("Feature", line)
    assert closed["properties"] == {
        "state": "closed",
        "width": 0.9,
        "height": 2.0,
        "depth": 0.05,
        "confidence": 0.9,
        "crossed": False,
        "rooms": ["a", None],
    }
    # In the middle of its wall.
    assert opened["geometry"]["coordinates"] == [[5.3, 1.12], [5.3, 2.0]]
    expected = {"state": "open", "width": 0.88, "depth": None, "crossed": True, "rooms": None}
    assert opened["properties"].items() >= expected.items()


def test_walls(tmp_path: Path) -> None:
    path = tmp_path / "walls.geojson"
    walls = faces(((0.0, 0.0), (4.0, 0.0)), ((0.0, 1.0), (4.0, 1.0)))
    walls = replace(walls, bottom_m=np.full(2, 0.05), top_m=np.full(2, 2.75))
    write_walls(path, walls, np.array([0.2, np.nan]))
    known, unknown = features(path)
    assert known["geometry"]["coordinates"] == [[0.0, 0.0], [4.0, 0.0]]
    assert known["properties"] == {
        "normal": [0.0, 1.0],
        "bottom": 0.05,
        "top": 2.75,
        "scans": 9,
        "rms": 0.01,
        "samples": 900,
        "thickness": 0.2,
    }
    assert unknown["properties"] == known["properties"] | {"thickness": None}


def test_what_json_cannot_say_is_null_and_a_failure_leaves_the_earlier_file(tmp_path: Path) -> None:
    path, b = tmp_path / "a.json", [np.int64(3), float("inf")]
    write_json(path, {"a": np.float32("nan"), "b": b, "c": np.eye(2)})
    expected = {"a": None, "b": [3, None], "c": [[1, 0], [0, 1]]}
    assert json.loads(path.read_text()) == expected
    with pytest.raises(AttributeError):
        write_json(path, object())
    assert json.loads(path.read_text()) == expected
    assert [file.name for file in tmp_path.iterdir()] == ["a.json"]


def test_passages_are_the_openings_of_the_topology_that_have_no_door(tmp_path: Path) -> None:
    plan = office(door_m=2.8)
    ways = plan.corners
    graph = find_rooms(draw(plan), SETTINGS, ways[:1], passages=ways[1:])
    write_passages(tmp_path / "passages.geojson", graph)
    expected = [own for own in topology(graph)["passages"] if own["door"] is None]
    found = features(tmp_path / "passages.geojson")
    assert len(found) == len(ways) - 1
    for own, passage in zip(found, expected, strict=True):
        width_m = passage["width_m"]
        assert own["properties"] == {"rooms": passage["rooms"], "width": width_m}
        assert width_m == pytest.approx(2.8)
        line = np.array(own["geometry"]["coordinates"])
        np.testing.assert_allclose(line.mean(axis=0), passage["middle"], atol=1e-3)
