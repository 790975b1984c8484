"""What `ffmap view` opens, and how."""

import json
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from app import view_command
from app.view_command import files_of, view
from loaders.errors import InputError


def make_run(folder: Path, *files: str, recording_id: str = "") -> Path:
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"recording_id": recording_id or f"id of {folder.name}"}))
    for name in files:
        (folder / name).touch()
    return folder


def test_errors_come_after_the_recording_whose_layout_would_hide_them(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", "recording.rrd", "evaluation.rrd")
    assert files_of(run) == [run / "recording.rrd", run / "evaluation.rrd"]
    assert files_of(make_run(tmp_path / "b", "recording.rrd")) == [tmp_path / "b" / "recording.rrd"]


def test_sweeps_and_single_recordings(tmp_path: Path) -> None:
    (tmp_path / "sweep.rrd").touch()
    assert files_of(tmp_path) == [tmp_path / "sweep.rrd"]
    assert files_of(tmp_path / "sweep.rrd") == [tmp_path / "sweep.rrd"]


def test_nothing_to_see(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        files_of(tmp_path / "nothing")
    with pytest.raises(InputError, match="no run and no sweep"):
        files_of(tmp_path)
    with pytest.raises(InputError, match=r"no recording\.rrd"):
        files_of(make_run(tmp_path / "a", "evaluation.rrd"))
    (tmp_path / "notes.txt").touch()
    with pytest.raises(InputError, match="no recording"):
        files_of(tmp_path / "notes.txt")


def test_several_runs_have_one_layout_that_comes_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [make_run(tmp_path / name, "recording.rrd") for name in ("a", "b")]
    opened: list[Path] = []
    layouts: list[tuple[str, int]] = []

    def look(files: list[Path]) -> None:
        opened.extend(files)
        readers = [RrdReader(file) for file in files[len(runs) :]]
        layouts.extend((reader.recordings()[0].recording_id, len(reader.blueprints())) for reader in readers)

    monkeypatch.setattr(view_command, "_open", look)
    view(runs)
    assert opened[:2] == [run / "recording.rrd" for run in runs]
    assert layouts == [("id of a", 1), ("id of b", 1)]
    said = capsys.readouterr().out
    for run in runs:
        assert f"id of {run.name}  {run}" in said
    opened.clear()
    view(runs[:1])
    assert opened == [runs[0] / "recording.rrd"]
    with pytest.raises(InputError, match="copy"):
        view([*runs, make_run(tmp_path / "c", "recording.rrd", recording_id="id of a")])
