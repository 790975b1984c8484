"""A recording that was cut anywhere is read up to the cut, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from ffmap.app.record.log import Log
from ffmap.app.record.read_back import readable, rows
from ffmap.app.record.stream import open_part
from ffmap.loaders.errors import InputError

ROWS = 12


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Twelve messages of one row, with a static one before them."""
    path = tmp_path / "whole.rrd"
    with open_part(path, "cut-1") as stream:
        stream.log("/scan/points", rr.Points3D.from_fields(radii=1.0), static=True)
        for scan in range(ROWS):
            log = Log(stream)
            log.at(1_000_000_000 + scan, scan)
            points = np.full((scan, 3), scan, np.float32)
            log.row("/scan/points", rr.Points3D, positions=points)
            log.send_rows()
    return path


def test_rows_come_with_their_values_in_order(recording: Path) -> None:
    found = list(rows(recording, "/scan/points", "positions"))
    assert [row.scan for row in found] == list(range(ROWS))
    assert [row.stamp_ns for row in found] == [1_000_000_000 + scan for scan in range(ROWS)]
    assert [row.values["positions"].shape for row in found] == [(scan, 3) for scan in range(ROWS)]
    assert list(rows(recording, "/scan/points", "class_ids")) == []
    assert list(rows(recording, "/nothing")) == []


def test_a_recording_is_read_up_to_wherever_it_was_cut(recording: Path, tmp_path: Path) -> None:
    content = recording.read_bytes()
    with readable(recording) as found:
        assert found.whole
        assert found.path == recording
    cut = tmp_path / "cut.rrd"
    read, refused = [], 0
    for size in range(0, len(content), max(1, len(content) // 16)):
        cut.write_bytes(content[:size])
        try:
            with readable(cut) as found:
                assert not found.whole
                assert found.warning is not None
                assert str(cut) in found.warning
                scans = [row.scan for row in rows(found.path, "/scan/points", "positions")]
        except InputError:
            refused += 1
            continue
        assert scans == list(range(len(scans)))
        read.append(len(scans))
    # The longer it is, the more is read; all of it once only the footer is cut.
    assert read == sorted(read)
    assert read[-1] == ROWS
    assert 0 < refused < 6
    assert not list(Path(found.path.parent).glob("*.part"))


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "text.rrd"
    for content in (b"", b"this is no recording, though it is long enough for a header"):
        path.write_bytes(content)
        refused = pytest.raises(InputError, match=r"text\.rrd: is not a Rerun recording")
        with refused, readable(path):
            pass
