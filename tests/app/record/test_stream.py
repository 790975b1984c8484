"""Parts become one recording, and what a kill leaves can be read."""

import socket

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from ffmap.app.record.log import Log, open_log
from ffmap.app.record.stream import Recording, open_part, send_part
from ffmap.blueprints import run as run_blueprint
from ffmap.blueprints.entities import POINTS, STAMP_TIMELINE
from tests import synthetic
from tests.app.record.recordings import rows, start, write_block
from tests.receiver import receiving, shown


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


def test_what_a_kill_leaves_can_be_read(tmp_path, labelled):
    recording = start(tmp_path, "run-1")
    Log(recording.stream).message("before the block", synthetic.stamp_ns(0))
    write_block(tmp_path / "block.rrd", labelled, 0, 2)
    recording.add(tmp_path / "block.rrd")
    Log(recording.stream).message("after it", synthetic.stamp_ns(1))
    killed = tmp_path / "killed.rrd"
    killed.write_bytes((tmp_path / "recording.rrd").read_bytes())
    recording.set_layout(run_blueprint.build())
    recording.finish()

    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):
        left = {chunk.entity_path for chunk in RrdReader(killed).stream()}
    assert {POINTS, "/messages"} <= left
    finished = tmp_path / "recording.rrd"
    assert len(RrdReader(finished).recordings()) == 1
    texts = [str(row["text"][0]) for row in rows(finished, "/messages", STAMP_TIMELINE)]
    assert texts == ["before the block", "after it"]
    store = RrdReader(finished).store().stream()
    assert sum(chunk.entity_path == POINTS for chunk in store) == 1


def test_parts_are_joined_to_a_file_with_its_layout(tmp_path, labelled):
    parts = [tmp_path / f"{block:04d}.rrd" for block in range(3)]
    for block, part in enumerate(parts):
        write_block(part, labelled, block, 1)
    with open_part(tmp_path / "empty.rrd", "run-1"):
        pass
    out = tmp_path / "joined.rrd"
    with open_log(out, "run-1", layout=run_blueprint.build()) as log:
        for part in (*parts, tmp_path / "empty.rrd"):
            send_part(log.stream, part)
    assert chunks(out) == set.union(*map(chunks, parts))
    assert len(RrdReader(out).blueprints()) == 1


def test_a_file_that_is_no_recording_is_an_error(tmp_path):
    recording = start(tmp_path, "run-10")
    (tmp_path / "block.rrd").write_bytes(b"not a recording at all")
    with pytest.raises(RuntimeError, match="Not an RRD"):
        recording.add(tmp_path / "block.rrd")


def test_a_viewer_receives_every_chunk_and_the_last_layout(tmp_path, labelled):
    with receiving(tmp_path / "seen.rrd") as viewer:
        recording = start(tmp_path, "run-1", viewer.url)
        recording.cut()
        write_block(tmp_path / "block.rrd", labelled, 0, 2)
        recording.add(tmp_path / "block.rrd")
        Log(recording.stream).message("the end", synthetic.stamp_ns(1))
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
            Log(recording.stream).message(f"part {number}", synthetic.stamp_ns(number))
            if number == 2:
                viewer.end()
            recording.cut()
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
        Recording(tmp_path / "run.rrd", "run-8", run_blueprint.build(), url)
