"""Files of a run with other values than a run writes: an error names the file and the value."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.app.analysis.evaluation import read_doors
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.record import (
    BagEntry,
    LidarEntry,
    MountEntry,
    RunRecord,
    read_record,
    write_record,
)
from ffmap.app.setup.options import RunOptions
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features


@pytest.mark.parametrize(
    ("record", "name"),
    [
        ({"bag": {"path": 5}}, "bag.path"),
        ({"options": {"time_from": "never"}}, "options.time_from"),
        ({"rig": {"vertical": "x"}}, "rig.vertical"),
        ({"rig": {"vertical_2": {"frame": "x"}}}, "rig.vertical_2.topic"),
        ({"mounts": {"/a": {"T_base_sensor": [[1.0]]}}}, "mounts./a.T_base_sensor.*"),
        ({"map_origin": [1.0, "x", 0.0]}, "map_origin.1"),
        ({"timings_s": {"total": "long"}}, "timings_s.total"),
        ({"counts": None, "settings": [3]}, "settings"),
        ({"recording_id": {}}, "recording_id"),
    ],
)
def test_a_value_of_another_kind_in_run_json(
    record: dict[str, Any], name: str, tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=rf"run\.json: {name}: "):
        open_run(tmp_path)


def test_a_record_is_read_as_it_was_written(tmp_path: Path) -> None:
    T = tuple(map(tuple, np.eye(4).tolist()))
    written = RunRecord(
        bag=BagEntry.of(BagPath((tmp_path / "a.bag", tmp_path / "b.bag")), "ros1"),
        rig={role: LidarEntry(topic=f"/{role}") for role in ("vertical", "vertical_2")},
        mounts={
            "/vertical": MountEntry(rms_as_given_m=0.01),
            "/vertical_2": MountEntry(used="refined", T_base_sensor=T, clock_ns=7),
        },
        options=RunOptions(rig=tmp_path / "rig.toml", vertical=("/left",)),
        statistics={"points_in_lines": {"mean": float("nan")}},
    )
    write_record(tmp_path, written)
    read = read_record(tmp_path)
    assert read.statistics["points_in_lines"]["mean"] is None
    assert read.model_copy(update={"statistics": written.statistics}) == written
    assert read.topics == ("/vertical", "/vertical_2")
    assert [mount.topic for mount in read.mount_corrections] == ["/vertical_2"]
    assert read.bag.bag_path == BagPath((tmp_path / "a.bag", tmp_path / "b.bag")).resolve()


def test_a_record_of_another_version_may_hold_more_and_less(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"new": [1], "options": {"new": 1}}))
    assert open_run(tmp_path).bag_path is None


LINE = {"type": "LineString", "coordinates": [[0, 0], [1, 2]]}
DOOR = {"width": 0.9, "state": "open"}


def features(*of: object) -> dict[str, object]:
    return {"type": "FeatureCollection", "features": list(of)}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "no list of features"),
        ({"features": None}, "no list of features"),
        (features(None), "feature 0"),
        (
            features({"geometry": LINE, "properties": DOOR}, {"geometry": LINE}),
            "feature 1: properties",
        ),
        (
            features({"geometry": {**LINE, "coordinates": [[0, 0]]}, "properties": DOOR}),
            "coordinates",
        ),
        (
            features(
                {"geometry": {**LINE, "coordinates": [[0, 0], [1, None]]}, "properties": DOOR}
            ),
            "coordinates",
        ),
        (features({"geometry": {**LINE, "type": "Point"}, "properties": DOOR}), "geometry.type"),
        (
            features({"geometry": LINE, "properties": {"width": None, "state": "open"}}),
            "properties.width",
        ),
    ],
)
def test_doors_that_are_none(content: object, words: str, tmp_path: Path) -> None:
    (tmp_path / "doors.geojson").write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"doors\.geojson: .*{words}"):
        read_doors(tmp_path / "doors.geojson")


@pytest.mark.parametrize(
    "ring", [[], [[[0, 0], [1, 0], [0, 0]]], [[[0, 0], [1, 0], [1, 1], [0, None]]]]
)
def test_outlines_that_are_none(ring: object, tmp_path: Path) -> None:
    outline = {"geometry": {"type": "Polygon", "coordinates": ring}, "properties": {}}
    (tmp_path / "rooms.geojson").write_text(json.dumps(features(outline)))
    with pytest.raises(InputError, match="coordinates"):
        read_features(tmp_path / "rooms.geojson", "outlines", "run ffmap again")


@pytest.mark.parametrize("make", [InputError, lambda line: InputError(f"a\x1b[31m{line}")])
def test_an_error_is_one_line_whatever_it_names(make: Callable[[str], InputError]) -> None:
    said = str(make("topic a\nb\r\tc\x00"))
    assert said.isprintable()
