"""Printed commands can be copied."""

import sys
from pathlib import Path

import pytest

from ffmap.app import own_command


def test_the_path_of_the_script_is_printed_where_the_shell_does_not_find_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "my env" / "ffmap"
    script.parent.mkdir()
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "argv", [str(script), "demo"])
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("PATH", "/nowhere")
    assert own_command.view_command(Path("my run")) == f"'{script}' view 'my run'"
    monkeypatch.setenv("PATH", str(script.parent))
    assert own_command.view_command(Path("my run")) == "ffmap view 'my run'"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_runs_open_in_a_browser_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert " view --web " in own_command.view_command(Path("runs/a"))
