"""Files of a run with other values than a run writes: an error names the file and the value."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.app.analysis.evaluation import read_doors
from ffmap.app.folder.finished_run import FinishedRun, open_run
from ffmap.app.folder.record import mount_corrections
from ffmap.loaders.errors import InputError
from ffmap.loaders.geojson import read_features


@pytest.mark.parametrize(
    ("record", "name"),
    [
        ({"bag": {"path": 5}}, "bag.path"),
        ({"bag": []}, "bag"),
        ({"options": {"rig": [1]}}, "options.rig"),
        ({"options": {"time_from": "never"}}, "options.time_from"),
        ({"rig": {"vertical": "x"}}, "rig.vertical"),
        ({"rig": {"vertical_2": {"frame": "x"}}}, "rig.vertical_2.topic"),
        ({"mounts": {"/a": {"clock_ns": "x"}}}, "mounts./a.clock_ns"),
        ({"timings_s": {"total": "long"}}, "timings_s.total"),
        ({"statistics": {"points": 3}}, "statistics.points"),
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


def test_what_was_labelled_and_where_it_sits_is_told_of_one_lidar_and_of_several(
    tmp_path: Path,
) -> None:
    def found(**record: Any) -> FinishedRun:
        (tmp_path / "run.json").write_text(json.dumps(record))
        return open_run(tmp_path)

    mount = {"used": "refined", "T_base_sensor": np.eye(4).tolist(), "clock_ns": 7}
    rig = {role: {"topic": f"/{role}"} for role in ("horizontal", "vertical")}
    one = found(rig=rig, mount=mount, options={"vertical": "/vertical"})
    assert one.topics == one.options.vertical == ("/vertical",)
    assert [(m.topic, m.clock_ns) for m in mount_corrections(one.record)] == [("/vertical", 7)]
    # The lidar of the poses is labelled too: the mount that was looked into is the other's.
    rig = {
        "horizontal": {"topic": "/a"},
        "vertical": {"topic": "/a"},
        "vertical_2": {"topic": "/b"},
    }
    upright = found(rig=rig, mount=mount, options={"vertical": None})
    assert (upright.topics, upright.options.vertical) == (("/a", "/b"), ())
    assert [m.topic for m in mount_corrections(upright.record)] == ["/b"]
    rig["horizontal"] = {"topic": "/c"}
    several = found(
        rig=rig,
        mounts={"/a": {"used": "as given"}, "/b": mount},
        options={"vertical": ["/b", "/a"]},
    )
    assert several.options.vertical == ("/b", "/a")
    assert [m.topic for m in mount_corrections(several.record)] == ["/b"]
    assert found().topics == found(rig={"vertical": None}).topics == ()


def test_a_record_of_another_version_may_hold_more_and_less(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"bag": None, "new": [1], "options": {"new": 1}}))
    assert open_run(tmp_path).part("options") == {"new": 1}


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
