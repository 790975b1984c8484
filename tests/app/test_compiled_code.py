"""Compiled code is that of the sources as they are, and is kept where that can be written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app import compiled_code as module
from ffmap.app.compiled_code import SOURCES, VARIABLE, compiled_code

ROOT = Path(__file__).parents[2]
CALLEE = "import numba\n\n@numba.njit(cache=True)\ndef callee() -> int:\n    return {}\n"
CALLER = (
    "import numba\nfrom callee import callee\n\n"
    "@numba.njit(cache=True)\ndef caller() -> int:\n    return callee()\n"
)


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A program whose user's cache is beside it."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(module, "user_cache", lambda: tmp_path / "cache")
    monkeypatch.setattr(module, "_PACKAGE", tmp_path / "program")
    folder = tmp_path / "program" / SOURCES
    folder.mkdir(parents=True)
    (folder / "caller.py").write_text(CALLER)
    return folder


def test_all_compiled_functions_are_among_the_sources() -> None:
    files = [
        path for top in ("app", "blueprints", "loaders") for path in (ROOT / top).rglob("*.py")
    ]
    assert files
    assert not [path for path in files if "import numba" in path.read_text("utf-8")]


def test_a_caller_is_compiled_again_when_what_it_calls_has_changed(sources: Path) -> None:
    def folder_of(answer: int) -> Path:
        (sources / "callee.py").write_text(CALLEE.format(answer))
        return Path(compiled_code()[VARIABLE])

    def answer(folder: Path) -> int:
        code = "from caller import caller; print(caller())"
        environment = {**os.environ, VARIABLE: str(folder)}
        # Python's own cache takes what has changed within a second for the same.
        command = [sys.executable, "-B", "-c", code]
        return int(subprocess.check_output(command, cwd=sources, env=environment))

    first = folder_of(1)
    assert answer(first) == 1
    changed = folder_of(2)
    assert changed != first
    assert answer(changed) == 2
    # In one folder the change is not noticed. If Numba ever does, the folders may go.
    assert answer(first) == 1
    assert folder_of(1) == first


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


def test_a_folder_that_the_user_sets_takes_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "mine")
    assert compiled_code() == {}
