"""Compiled code is that of the sources as they are, and is kept where that can be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app import compiled_code as module
from ffmap.app.compiled_code import VARIABLE, compiled_code

ROOT = Path(__file__).parents[2]


def test_all_compiled_functions_are_among_the_sources() -> None:
    files = [
        path for top in ("app", "blueprints", "loaders") for path in (ROOT / top).rglob("*.py")
    ]
    assert files
    assert not [path for path in files if "import numba" in path.read_text("utf-8")]


def test_each_state_of_the_sources_has_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(module, "SOURCES", tmp_path / "program")
    (tmp_path / "program").mkdir()

    def folder_of(text: str) -> str:
        (tmp_path / "program" / "callee.py").write_text(text)
        return compiled_code()[VARIABLE]

    first = folder_of("1")
    assert Path(first).is_relative_to(tmp_path / "cache")
    assert folder_of("2") != first
    assert folder_of("1") == first
    monkeypatch.setenv(VARIABLE, "mine")
    assert compiled_code() == {}


def test_without_a_writable_cache_code_is_compiled_for_now(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("no folder")
    code = (
        "import os; from ffmap.app.compiled_code import compiled_code\n"
        "os.environ.update(compiled_code())\n"
        "import ffmap.algorithms.base.plan_index\n"
        "print(os.environ['NUMBA_CACHE_DIR'])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    environment.pop(VARIABLE, None)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    folder = Path(done.stdout.strip())
    assert folder.parent == tmp_path
    assert not folder.exists()
