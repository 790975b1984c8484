"""Recordings are read in the order of their rows; incomplete ones are refused in one line."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from ffmap.app.record.log import Log
from ffmap.app.record.read_back import rows
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


def test_what_is_not_a_complete_recording_is_refused(recording: Path) -> None:
    content = recording.read_bytes()
    cuts = (content[:size] for size in range(0, len(content), max(1, len(content) // 16)))
    for part in (*cuts, b"this is no recording, though it is long enough for a header"):
        recording.write_bytes(part)
        with pytest.raises(InputError, match=r"whole\.rrd: is not a complete Rerun recording"):
            list(rows(recording, "/scan/points"))
