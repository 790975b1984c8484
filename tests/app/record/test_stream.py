"""Parts become one recording, and what a kill leaves can be read."""

import socket

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from ffmap.app.record.log import Log, open_log
from ffmap.app.record.stream import Recording, open_part
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import POINTS, STAMP_TIMELINE
from tests import synthetic
from tests.app.record.recordings import rows, start, write_block
from tests.receiver import receiving, shown


def log_message(recording, text, scan):
    log = Log(recording.stream)
    log.at(synthetic.stamp_ns(scan))
    log.message(text)
    log.send_rows()


def chunks(path):
    return {chunk.id for chunk in RrdReader(path).stream()}


def test_the_file_has_all_parts_properties_a_layout_and_a_footer(recording):
    for block in recording.parent.glob("????.rrd"):
        assert chunks(block) <= chunks(recording)
    assert [entry.recording_id for entry in RrdReader(recording).recordings()] == ["run-1"]
    assert len(RrdReader(recording).blueprints()) == 1
    RrdReader(recording).store()  # fails without a footer
    static = RrdReader(recording).stream().filter(is_static=True).collect()
    columns = {f.name: chunk for chunk in static.stream() for f in chunk.to_record_batch().schema}
    name = "wall_planes_similarity_m"
    assert columns[name].to_record_batch()[name].to_pylist() == [[0.05]]


def test_a_part_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(KeyError), open_part(tmp_path / "block.rrd", "run-6"):
        raise KeyError("an error of a worker")
    wrong_shape = pytest.raises(ValueError, match=r"(?i)expected|shape|length|size")
    with wrong_shape, open_part(tmp_path / "block.rrd", "run-7") as stream:
        stream.log("/points", rr.Points3D(np.zeros((3, 4))))
    assert list(tmp_path.iterdir()) == []


def test_rows_of_the_run_and_of_its_workers_are_in_one_file(tmp_path, labelled):
    recording = start(tmp_path, "run-1")
    log_message(recording, "before the block", 0)
    write_block(tmp_path / "block.rrd", labelled, 0, 2)
    with open_part(tmp_path / "empty.rrd", "run-1"):
        pass
    for part in ("block.rrd", "empty.rrd"):
        recording.add(tmp_path / part)
    log_message(recording, "after it", 1)
    recording.set_layout(run_blueprint.build())
    recording.finish()
    finished = tmp_path / "recording.rrd"
    assert len(RrdReader(finished).recordings()) == len(RrdReader(finished).blueprints()) == 1
    texts = [str(row["text"][0]) for row in rows(finished, "/messages", STAMP_TIMELINE)]
    assert texts == ["before the block", "after it"]
    assert [row["scan"] for row in rows(finished, POINTS)] == [0, 1]
    # A run that is killed leaves its parts only.
    parts = {part.name for part in (tmp_path / "spool").iterdir()}
    assert parts == {"layout.rrd", "own.rrd"}


def test_rows_are_sent_together_until_they_are_large(tmp_path):
    with open_log(tmp_path / "block.rrd", "run-1") as log:
        for scan in range(6):
            log.at(synthetic.stamp_ns(scan), scan)
            log.row("/small", rr.Points3D, {"more": np.zeros(scan)}, positions=np.ones((scan, 3)))
            log.row("/large", rr.Points3D, positions=np.ones((30_000, 3), np.float32))
        log.row("/small", rr.Clear, is_recursive=[False])
    found = [c for c in RrdReader(tmp_path / "block.rrd").stream() if not c.is_static]
    assert sum(chunk.entity_path == "/small" for chunk in found) == 2
    assert [c.num_rows for c in found if c.entity_path == "/large"] == [3, 3]
    small = [c.to_record_batch().to_pydict() for c in found if c.entity_path == "/small"]
    assert [len(more) for more in small[0]["more"]] == [0, 1, 2, 3, 4, 5]
    assert [len(xyz) for xyz in small[0]["Points3D:positions"]] == [0, 1, 2, 3, 4, 5]
    assert small[0]["scan"] == [0, 1, 2, 3, 4, 5]


def test_a_file_that_is_no_recording_is_an_error(tmp_path):
    recording = start(tmp_path, "run-10")
    (tmp_path / "block.rrd").write_bytes(b"not a recording at all")
    recording.add(tmp_path / "block.rrd")
    with pytest.raises(OSError, match="cannot be joined"):
        recording.finish()
    assert not list(tmp_path.glob("recording.rrd*"))


def test_a_viewer_receives_every_chunk_and_the_last_layout(tmp_path, labelled):
    with receiving(tmp_path / "seen.rrd") as viewer:
        recording = start(tmp_path, "run-1", viewer.url)
        recording.flush()
        write_block(tmp_path / "block.rrd", labelled, 0, 2)
        recording.add(tmp_path / "block.rrd")
        log_message(recording, "the end", 1)
        recording.set_layout(run_blueprint.build(evaluated=True))
        recording.finish()
        assert viewer.holds(tmp_path / "recording.rrd")
        # Without this view, a layout has an evaluation.
        assert "What this needs" not in shown(viewer.path)


def test_a_viewer_that_ends_does_not_end_the_run(tmp_path):
    printed: list[str] = []
    with receiving(tmp_path / "seen.rrd") as viewer:
        recording = start(tmp_path, "run-11", viewer.url, printed.append)
        for number in range(4):
            log_message(recording, f"part {number}", number)
            if number == 2:
                viewer.end()
            recording.flush()
        recording.set_layout(run_blueprint.build())
        recording.finish()
    assert printed == ["The viewer has ended. The run continues without it."]
    found = rows(tmp_path / "recording.rrd", "/messages", STAMP_TIMELINE)
    assert [str(row["text"][0]) for row in found] == [f"part {number}" for number in range(4)]


def test_a_viewer_that_is_not_there_is_an_error_and_not_a_wait(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"rerun+http://127.0.0.1:{probe.getsockname()[1]}/proxy"
    with pytest.raises(ConnectionError, match="no Rerun viewer"):
        Recording(tmp_path / "run.rrd", tmp_path, "run-8", run_blueprint.build(), url)
