"""What `ffmap view` opens, and how."""

import json
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import psutil
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from ffmap.app.commands import view as view_command
from ffmap.app.commands.view import files_of, view
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError
from tests.program import FFMAP_IN_FRONT


def make_run(folder: Path, *files: str, recording_id: str = "") -> Path:
    folder.mkdir()
    identity = recording_id or f"id of {folder.name}"
    (folder / "run.json").write_text(json.dumps({"recording_id": identity}))
    for name in files:
        (folder / name).touch()
    return folder


def test_files_of_a_run_and_a_single_recording(tmp_path: Path) -> None:
    """The errors are last: the viewer uses the layout of the last file."""
    run = make_run(tmp_path / "a", "recording.rrd", "evaluation.rrd")
    assert files_of(run) == [run / "recording.rrd", run / "evaluation.rrd"]
    assert files_of(run / "recording.rrd") == [run / "recording.rrd"]
    under_way = make_run(tmp_path / "b")
    (under_way / "spool").mkdir()
    for name in ("own.rrd", "000000.rrd", "000000.arrow"):
        (under_way / "spool" / name).touch()
    assert files_of(under_way) == [under_way / "spool" / n for n in ("000000.rrd", "own.rrd")]


def test_nothing_to_see(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    make_run(tmp_path / "a", "evaluation.rrd")
    for name, words in (
        ("nothing", "no such folder"),
        (".", "is no run"),
        ("a", r"no recording\.rrd"),
        ("notes.txt", "is no recording"),
    ):
        with pytest.raises(InputError, match=words):
            files_of(tmp_path / name)


def test_several_runs_have_one_layout_that_comes_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [make_run(tmp_path / name, "recording.rrd") for name in ("a", "b")]
    opened: list[Path] = []
    layouts: list[tuple[str, int]] = []

    def look(files: list[Path]) -> None:
        opened.extend(files)
        readers = [RrdReader(file) for file in files[len(runs) :]]
        for reader in readers:
            layouts.append((reader.recordings()[0].recording_id, len(reader.blueprints())))

    monkeypatch.setattr(view_command, "_open", lambda files, _: look(files))
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


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window can always be opened")
def test_without_a_display_one_line_says_how_to_see_it_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    run = make_run(tmp_path / "a", "recording.rrd", "evaluation.rrd")
    with pytest.raises(InputError) as error:
        view([run])
    said = str(error.value)
    assert "\n" not in said
    recording, version = str(run / "recording.rrd"), f"rerun-sdk=={rr.__version__}"
    for words in ("no display found", f"view --web {run}", recording, version):
        assert words in said


def test_a_browser_is_served_on_the_loopback_address_alone(tmp_path: Path) -> None:
    with rr.RecordingStream(entities.APPLICATION_ID) as stream:
        stream.save(tmp_path / "a.rrd")
        stream.log("/world", rr.TextLog("something"), static=True)
    process = subprocess.Popen(
        [*FFMAP_IN_FRONT, "view", "--web", str(tmp_path / "a.rrd")],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"Rerun" in page.read()
        wasm = address.partition("?")[0] + "re_viewer_bg.wasm"
        with urllib.request.urlopen(wasm, timeout=30) as program:
            assert program.read(4) == b"\0asm"
        servers = psutil.Process(process.pid).children(recursive=True)
        connections = [c for server in servers for c in server.net_connections()]
        listening = [c.laddr for c in connections if c.status == psutil.CONN_LISTEN]
        assert {place.ip for place in listening} == {"127.0.0.1"}
        [source] = parse_qs(urlsplit(address).query)["url"]
        ports = {urlsplit(url).port for url in (address, source)}
        assert ports == {place.port for place in listening}
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == 0
    assert not psutil.wait_procs(servers, timeout=30)[1]
