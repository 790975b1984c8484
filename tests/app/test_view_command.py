"""What `ffmap view` opens, and how."""

import json
from pathlib import Path

import pytest

from app.view_command import files_of
from loaders.errors import InputError


def make_run(folder: Path, *files: str, detail: str = "lines") -> Path:
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"options": {"detail": detail}}))
    for name in files:
        (folder / name).touch()
    return folder


def test_errors_come_before_the_recording_whose_layout_would_hide_them(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", "recording.rrd", "evaluation.rrd")
    assert files_of(run) == [run / "evaluation.rrd", run / "recording.rrd"]
    assert files_of(make_run(tmp_path / "b", "recording.rrd")) == [tmp_path / "b" / "recording.rrd"]


def test_sweeps_and_single_recordings(tmp_path: Path) -> None:
    (tmp_path / "sweep.rrd").touch()
    assert files_of(tmp_path) == [tmp_path / "sweep.rrd"]
    assert files_of(tmp_path / "sweep.rrd") == [tmp_path / "sweep.rrd"]


def test_nothing_to_see(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run and no sweep"):
        files_of(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"no recording\.rrd"):
        files_of(make_run(tmp_path / "a", "evaluation.rrd"))
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match="no recording"):
        files_of(tmp_path / "notes.txt")
