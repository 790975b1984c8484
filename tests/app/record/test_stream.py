"""Parts are joined as they are, and what a kill leaves can be read."""

import socket

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from ffmap.app.record import stream
from ffmap.app.record.log import Log
from ffmap.app.record.stream import Recording, open_part
from ffmap.blueprints import entities
from ffmap.blueprints import run as run_blueprint
from tests import synthetic
from tests.app.record.recordings import rows, start, write_block
from tests.receiver import receiving, shown


def test_forwarding_keeps_every_chunk(recording):
    kept = {chunk.id for chunk in RrdReader(recording).stream()}
    for block in recording.parent.glob("????.rrd"):
        assert {chunk.id for chunk in RrdReader(block).stream()} <= kept


def test_the_file_holds_properties_classes_blueprint_and_footer(recording):
    assert [entry.recording_id for entry in RrdReader(recording).recordings()] == ["run-1"]
    assert len(RrdReader(recording).blueprints()) == 1
    RrdReader(recording).store()  # fails without a footer
    static = RrdReader(recording).stream().filter(is_static=True).collect()
    columns = {field.name: chunk for chunk in static.stream() for field in chunk.to_record_batch().schema}
    assert columns["wall_planes_similarity_m"].to_record_batch()["wall_planes_similarity_m"].to_pylist() == [[0.05]]
    assert any(name.startswith("AnnotationContext") for name in columns)
    assert any("TextDocument" in name for name in columns)


def test_a_block_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(KeyError), open_part(tmp_path / "block.rrd", "run-6"):
        raise KeyError("a worker's error")
    assert list(tmp_path.iterdir()) == []


def test_what_a_kill_leaves_can_be_read_and_what_is_finished_has_its_footer(tmp_path, labelled):
    recording = start(tmp_path, "run-1")
    Log(recording.stream).message("before the block", synthetic.stamp_ns(0))
    write_block(tmp_path / "block.rrd", labelled, 0, 2)
    recording.add(tmp_path / "block.rrd")
    Log(recording.stream).message("after it", synthetic.stamp_ns(1))
    killed = tmp_path / "killed.rrd"
    killed.write_bytes((tmp_path / "recording.rrd").read_bytes())
    recording.finish()

    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):
        left = {chunk.entity_path for chunk in RrdReader(killed).stream()}
    assert {entities.POINTS, entities.MESSAGES} <= left
    finished = RrdReader(tmp_path / "recording.rrd")
    assert [entry.recording_id for entry in finished.recordings()] == ["run-1"]
    assert len(finished.blueprints()) == 1
    messages = [row["text"] for row in rows(tmp_path / "recording.rrd", entities.MESSAGES, entities.STAMP_TIMELINE)]
    assert [str(text[0]) for text in messages] == ["before the block", "after it"]
    assert sum(chunk.entity_path == entities.POINTS for chunk in finished.store().stream()) == 1


@pytest.mark.parametrize("blocks", [1, 3, 4, 8, 10])
def test_of_many_parts_all_are_in_the_recording(tmp_path, labelled, monkeypatch, blocks):
    monkeypatch.setattr(stream, "_PARTS_AT_ONCE", 3)
    recording = start(tmp_path, "run-1")
    kept = set()
    for block in range(blocks):
        part = tmp_path / f"{block:04d}.rrd"
        write_block(part, labelled, block % 4, 1)
        kept |= {chunk.id for chunk in RrdReader(part).stream()}
        Log(recording.stream).message(f"block {block}", synthetic.stamp_ns(block))
        recording.add(part)
    recording.set_layout(run_blueprint.build())
    recording.finish(parts_stay=True)
    assert {f"{block:04d}.rrd" for block in range(blocks)} <= {path.name for path in tmp_path.iterdir()}
    assert not list(tmp_path.glob("joined-*"))
    finished = RrdReader(tmp_path / "recording.rrd")
    assert kept <= {chunk.id for chunk in finished.store().stream()}
    assert [entry.recording_id for entry in finished.recordings()] == ["run-1"]
    texts = [row["text"] for row in rows(tmp_path / "recording.rrd", entities.MESSAGES, entities.STAMP_TIMELINE)]
    assert [str(text[0]) for text in texts] == [f"block {block}" for block in range(blocks)]


def test_many_parts_may_be_let_go_as_they_are_joined(tmp_path, labelled, monkeypatch):
    monkeypatch.setattr(stream, "_PARTS_AT_ONCE", 3)
    parts = [tmp_path / f"{block:04d}.rrd" for block in range(10)]
    for block, part in enumerate(parts):
        write_block(part, labelled, block % 4, 1)
    kept = {chunk.id for part in parts for chunk in RrdReader(part).stream()}
    stream.join([], parts, tmp_path / "recording.rrd", parts_stay=False)
    assert kept == {chunk.id for chunk in RrdReader(tmp_path / "recording.rrd").store().stream()}
    assert [path.name for path in tmp_path.iterdir()] == ["recording.rrd"]


def test_a_file_that_is_no_recording_is_not_appended(tmp_path):
    recording = start(tmp_path, "run-10")
    (tmp_path / "block.rrd").write_bytes(b"not a recording at all")
    with pytest.raises(RuntimeError, match="is not framed"):
        recording.add(tmp_path / "block.rrd")


def test_a_wrong_shape_is_an_error(tmp_path):
    with (
        pytest.raises(ValueError, match=r"(?i)expected|shape|length|size"),
        open_part(tmp_path / "block.rrd", "run-7") as stream,
    ):
        stream.log("/points", rr.Points3D(np.zeros((3, 4))))


def test_a_viewer_receives_every_chunk_and_the_last_layout(tmp_path, labelled):
    with receiving(tmp_path / "seen.rrd") as viewer:
        recording = start(tmp_path, "run-1", viewer.url)
        recording.cut()  # nothing but the properties
        recording.cut()  # nothing at all
        write_block(tmp_path / "block.rrd", labelled, 0, 2)
        with open_part(tmp_path / "empty.rrd", "run-1"):
            pass
        for part in ("empty.rrd", "block.rrd"):
            recording.add(tmp_path / part)
        Log(recording.stream).message("the end", synthetic.stamp_ns(1))
        recording.set_layout(run_blueprint.build(evaluated=True))
        recording.finish()
        assert viewer.holds(tmp_path / "recording.rrd")
        # Without this view, a layout has an evaluation.
        assert "What this needs" not in shown(viewer.path)


def test_a_viewer_that_ends_does_not_end_the_run(tmp_path):
    said: list[str] = []
    with receiving(tmp_path / "seen.rrd") as viewer:
        recording = start(tmp_path, "run-11", viewer.url, said.append)
        for number in range(4):
            Log(recording.stream).message(f"part {number}", synthetic.stamp_ns(number))
            if number == 2:
                viewer.end()
            recording.cut()
        recording.set_layout(run_blueprint.build())
        recording.finish()
    assert said == ["The viewer has ended. The run continues without it."]
    texts = [row["text"] for row in rows(tmp_path / "recording.rrd", entities.MESSAGES, entities.STAMP_TIMELINE)]
    assert [str(text[0]) for text in texts] == [f"part {number}" for number in range(4)]


def test_a_viewer_that_is_not_there_is_an_error_and_not_a_wait(tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"rerun+http://127.0.0.1:{probe.getsockname()[1]}/proxy"
    with pytest.raises(ConnectionError, match="no Rerun viewer"):
        Recording(tmp_path / "run.rrd", tmp_path, "run-8", run_blueprint.build(), url)
