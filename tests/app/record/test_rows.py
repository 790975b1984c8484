"""Rows that are sent together read like rows that were logged one by one."""

import numpy as np
import rerun as rr

from ffmap.app.record.log import open_log
from ffmap.blueprints import entities
from tests.app.record.recordings import rows, static

STAMP_NS = 1_700_000_000_123_456_789


def test_rows_of_any_length_keep_their_places_and_values(tmp_path):
    random = np.random.default_rng(1)
    clouds = [random.normal(size=(count, 3)).astype(np.float32) for count in (3, 0, 5)]
    with open_log(tmp_path / "part.rrd", "rows") as log:
        for index, cloud in enumerate(clouds):
            log.at(STAMP_NS + index, index)
            log.row("cloud", rr.Points3D, {"weight": cloud[:, 0].astype(np.float64)}, positions=cloud)
            log.row("texts", rr.Points2D, positions=cloud[:, :2], labels=[f"{index}.{k}" for k in range(len(cloud))])
    found = list(rows(tmp_path / "part.rrd", "/cloud"))
    assert [row["scan"] for row in found] == [0, 1, 2]
    assert [row["stamp"].value for row in found] == [STAMP_NS, STAMP_NS + 1, STAMP_NS + 2]
    for row, cloud in zip(found, clouds, strict=True):
        np.testing.assert_array_equal(np.array([*row["positions"]]).reshape(-1, 3), cloud)
        np.testing.assert_array_equal(row["weight"], cloud[:, 0])
    texts = [list(row["labels"]) for row in rows(tmp_path / "part.rrd", "/texts")]
    assert texts == [["0.0", "0.1", "0.2"], [], ["2.0", "2.1", "2.2", "2.3", "2.4"]]


def test_rows_of_other_archetypes_take_turns_on_one_entity(tmp_path):
    with open_log(tmp_path / "part.rrd", "rows") as log:
        for index in range(25):  # more than are sent together
            log.at(STAMP_NS + index, index)
            if index % 2:
                log.row("thing", rr.Clear, is_recursive=[False])
            else:
                log.row("thing", rr.Points3D, positions=np.full((1, 3), index, np.float32))
    found = {row["scan"]: row for row in rows(tmp_path / "part.rrd", "/thing")}
    assert sorted(found) == list(range(25))
    for index in range(0, 25, 2):
        assert found[index]["positions"][0].tolist() == [index] * 3


def test_what_holds_throughout_lies_on_no_timeline(tmp_path):
    with open_log(tmp_path / "part.rrd", "rows") as log:
        log.timeless = True
        log.row("cloud", rr.Points3D, positions=np.ones((2, 3), np.float32))
    assert np.shape(static(tmp_path / "part.rrd")["/cloud"]["positions"]) == (1, 2, 3)


def test_a_line_of_a_scan_is_a_time_too(tmp_path):
    with open_log(tmp_path / "part.rrd", "rows") as log:
        for line in (4, 2):
            log.at_line(line)
            log.row("mark", rr.Points3D, positions=np.full((1, 3), line, np.float32))
    found = {
        row["line"]: row["positions"][0][0] for row in rows(tmp_path / "part.rrd", "/mark", entities.LINE_TIMELINE)
    }
    assert found == {2: 2.0, 4: 4.0}
