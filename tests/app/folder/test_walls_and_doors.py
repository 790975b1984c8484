"""walls.geojson and doors.geojson, read back as JSON."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffmap.app.folder.atomic import write_json
from ffmap.app.folder.walls_and_doors import write_doors, write_walls
from tests.faces import doors, faces


class TestGeojson:
    def test_doors(self, tmp_path: Path):
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
        write_doors(tmp_path / "doors.geojson", found)
        content = json.loads((tmp_path / "doors.geojson").read_text())
        assert content["type"] == "FeatureCollection"
        closed, opened = content["features"]
        assert closed["type"] == "Feature"
        assert closed["geometry"] == {
            "type": "LineString",
            "coordinates": [[0.0, -0.05], [0.9, -0.05]],
        }
        assert opened["geometry"]["coordinates"] == [
            [5.3, 1.12],
            [5.3, 2.0],
        ]  # in the middle of its wall
        assert closed["properties"] == {
            "state": "closed",
            "width": 0.9,
            "height": 2.0,
            "depth": 0.05,
            "confidence": 0.9,
            "crossed": False,
            "rooms": None,
        }
        assert opened["properties"]["state"] == "open"
        assert opened["properties"]["width"] == 0.88  # and not 0.8799999999999999
        assert opened["properties"]["depth"] is None
        write_doors(tmp_path / "doors.geojson", found, [(0, 1), None])
        rooms = [
            f["properties"]["rooms"]
            for f in json.loads((tmp_path / "doors.geojson").read_text())["features"]
        ]
        assert rooms == [[0, 1], None]

    def test_walls(self, tmp_path: Path):
        walls = replace(
            faces(((0.0, 0.0), (4.0, 0.0))), bottom_m=np.array([0.05]), top_m=np.array([2.75])
        )
        write_walls(tmp_path / "walls.geojson", walls)
        (feature,) = json.loads((tmp_path / "walls.geojson").read_text())["features"]
        assert feature["geometry"]["coordinates"] == [[0.0, 0.0], [4.0, 0.0]]
        expected = {
            "normal": [0.0, 1.0],
            "bottom": 0.05,
            "top": 2.75,
            "scans": 9,
            "rms": 0.01,
            "samples": 900,
        }
        assert feature["properties"] == {**expected, "thickness": None}
        for thickness_m, written in ((0.2, 0.2), (np.nan, None)):
            write_walls(tmp_path / "walls.geojson", walls, np.full(len(walls), thickness_m))
            (feature,) = json.loads((tmp_path / "walls.geojson").read_text())["features"]
            assert feature["properties"] == {**expected, "thickness": written}

    def test_what_json_cannot_say_is_null(self, tmp_path: Path):
        write_json(
            tmp_path / "a.json",
            {"a": np.float32("nan"), "b": [np.int64(3), float("inf")], "c": np.eye(2)},
        )
        assert json.loads((tmp_path / "a.json").read_text()) == {
            "a": None,
            "b": [3, None],
            "c": [[1, 0], [0, 1]],
        }
        assert not (tmp_path / "a.json.part").exists()

    def test_a_failure_leaves_the_earlier_file(self, tmp_path: Path):
        write_json(tmp_path / "a.json", 1)
        with pytest.raises(AttributeError):
            write_json(tmp_path / "a.json", object())
        assert json.loads((tmp_path / "a.json").read_text()) == 1
