"""Printed commands call this very installation."""

import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app import own_command


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation in a folder with a space in its name."""
    path = tmp_path / "home" / "my env" / "bin" / "ffmap"
    path.parent.mkdir(parents=True)
    path.write_text("#!/bin/sh\necho ours\n")
    path.chmod(0o755)
    monkeypatch.setattr(sys, "argv", [str(path), "demo"])
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("DISPLAY", ":0")
    return path


def test_path_of_the_script_is_used_outside_path(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in (tmp_path, tmp_path / "home", script.parent):
        monkeypatch.chdir(place)
        command = own_command.own_command()
        assert subprocess.check_output(command, shell=True, text=True) == "ours\n"
    monkeypatch.chdir(tmp_path)
    assert own_command.own_command() == "'home/my env/bin/ffmap'"


def test_name_is_used_if_the_shell_finds_it(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(script.parent))
    assert own_command.view_command(Path("my run")) == "ffmap view 'my run'"
    other = tmp_path / "other" / "ffmap"
    other.parent.mkdir()
    other.write_text("#!/bin/sh\n")
    other.chmod(0o755)
    monkeypatch.setenv("PATH", str(other.parent))
    assert own_command.own_command() != "ffmap"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_runs_open_in_a_browser_without_a_display(
    script: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert " view --web " in own_command.view_command(Path("runs/a"))


def test_packages_are_installed_for_this_interpreter() -> None:
    command = own_command.pip_command("pip").replace("pip install pip", "pip --version")
    assert b"pip" in subprocess.check_output(command, shell=True)
