"""Compiled code is that of the sources as they are, and is kept where that can be written, without filling the disk."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ffmap.app import compiled_code as module
from ffmap.app.compiled_code import SOURCES, VARIABLE, compiled_code

ROOT = Path(__file__).parents[2]
CALLEE = "import numba\n\n@numba.njit(cache=True)\ndef callee() -> int:\n    return {}\n"
CALLER = (
    "import numba\nfrom callee import callee\n\n@numba.njit(cache=True)\ndef caller() -> int:\n    return callee()\n"
)


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a user keeps compiled code; the program lies beside it."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(module, "user_cache", lambda: tmp_path / "cache")
    monkeypatch.setattr(module, "_PACKAGE", tmp_path / "program")
    for source in SOURCES:
        path = tmp_path / "program" / source / ("" if source.endswith(".py") else "callee.py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(CALLEE.format(1))
    return tmp_path / "cache" / "compiled"


def edit(base: Path, answer: int) -> Path:
    """Change what a function returns, and give the folder for the changed program."""
    (base.parents[1] / "program" / "algorithms" / "callee.py").write_text(CALLEE.format(answer))
    return Path(compiled_code()[VARIABLE])


def test_all_compiled_functions_are_among_the_sources() -> None:
    users = [
        path.relative_to(ROOT).as_posix()
        for top in ("algorithms", "app", "blueprints", "loaders")
        for path in (ROOT / top).rglob("*.py")
        if "import numba" in path.read_text("utf-8")
    ]
    assert users
    assert [user for user in users if not user.startswith("algorithms/") and user not in SOURCES] == []


def test_a_caller_is_compiled_again_when_what_it_calls_has_changed(base: Path) -> None:
    sources = base.parents[1] / "program" / "algorithms"
    (sources / "caller.py").write_text(CALLER)

    def answer(folder: Path) -> int:
        code = "from caller import caller; print(caller())"
        environment = {**os.environ, VARIABLE: str(folder)}
        # Python's own cache takes what has changed within a second for the same.
        return int(subprocess.check_output([sys.executable, "-B", "-c", code], cwd=sources, env=environment))

    first = edit(base, 1)
    assert answer(first) == 1
    changed = edit(base, 2)
    assert changed != first
    assert answer(changed) == 2
    # This is what happens where both share a folder; should it not, then Numba has learnt it, and all of this may go.
    assert answer(first) == 1
    assert edit(base, 1) == first


def test_folders_of_other_states_go_when_they_are_unused(base: Path) -> None:
    first, second = edit(base, 1), edit(base, 2)
    then = time.time() - 40 * 24 * 3600.0
    os.utime(first, (then, then))
    third = edit(base, 3)
    assert {path.name for path in base.iterdir()} == {second.name, third.name}


def test_without_a_writable_cache_code_is_compiled_for_now(base: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("no folder")
    code = (
        "import os; from ffmap.app.compiled_code import compiled_code\n"
        "os.environ.update(compiled_code())\n"
        "import ffmap.algorithms.base.plan_index\n"
        "print(os.environ['NUMBA_CACHE_DIR'])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    folder = Path(done.stdout.strip())
    assert folder.parent == tmp_path
    assert not folder.exists()


def test_a_folder_that_the_user_sets_counts(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "mine"))
    assert compiled_code() == {}
