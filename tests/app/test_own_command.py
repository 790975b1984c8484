"""What is printed to be copied calls this very installation."""

import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app import own_command


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation of its own, whose script was started."""
    path = tmp_path / "home" / "my env" / "bin" / "ffmap"
    path.parent.mkdir(parents=True)
    path.write_text("#!/bin/sh\necho ours\n")
    path.chmod(0o755)
    monkeypatch.setattr(sys, "argv", [str(path), "demo"])
    monkeypatch.setenv("PATH", "/nowhere")
    return path


def test_a_script_that_the_shell_does_not_find_is_called_by_its_path(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in (tmp_path, tmp_path / "home", script.parent):
        monkeypatch.chdir(place)
        done = subprocess.run(own_command.own_command(), shell=True, capture_output=True, text=True, check=True)
        assert done.stdout == "ours\n"
    monkeypatch.chdir(tmp_path)
    assert own_command.own_command() == "'home/my env/bin/ffmap'"


def test_a_script_that_the_shell_finds_is_called_by_its_name(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(script.parent))
    assert own_command.own_command() == "ffmap"
    other = tmp_path / "other" / "ffmap"
    other.parent.mkdir()
    other.write_text("#!/bin/sh\n")
    other.chmod(0o755)
    monkeypatch.setenv("PATH", str(other.parent))
    assert own_command.own_command() != "ffmap"


def test_without_a_script_there_is_only_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["-c"])
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    assert own_command.own_command() == "ffmap"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a window can always be opened")
def test_a_run_is_shown_in_a_browser_where_there_is_no_display(script: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(script.parent))
    assert own_command.view_command(Path("runs/my run")) == "ffmap view --web 'runs/my run'"
    monkeypatch.setenv("DISPLAY", ":0")
    assert own_command.view_command(Path("runs/a")) == "ffmap view runs/a"


def test_packages_are_installed_beside_the_program() -> None:
    words = own_command.pip_command("pip").replace("pip install pip", "pip --version")
    done = subprocess.run(words, shell=True, capture_output=True, text=True, check=False)
    assert done.returncode == 0 or "No module named pip" in done.stderr
    assert own_command.pip_command("optuna").endswith("-m pip install optuna")
