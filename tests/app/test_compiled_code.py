"""Compiled code is that of the sources as they are, and is kept where that can be written, without filling the disk."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ffmap.app import compiled_code as module
from ffmap.app.cli import app
from ffmap.app.compiled_code import SOURCES, VARIABLE, clear_others, compiled_code, folders
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import FFMAP, ffmap

ROOT = Path(__file__).parents[2]
CALLEE = "import numba\n\n@numba.njit(cache=True)\ndef callee() -> int:\n    return {}\n"
CALLER = (
    "import numba\nfrom callee import callee\n\n@numba.njit(cache=True)\ndef caller() -> int:\n    return callee()\n"
)


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a user keeps compiled code; the program lies beside it."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.delenv("FFMAP_CACHE", raising=False)
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


def last_used(folder: Path, hours_ago: float) -> None:
    then = time.time() - 3600.0 * hours_ago
    os.utime(folder / "installation", (then, then))


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


def test_older_states_of_a_program_go_and_others_stay(base: Path) -> None:
    first, second = edit(base, 1), edit(base, 2)
    assert edit(base, 3).is_dir()
    # A program that has just been started may still be compiling into it.
    assert first.is_dir()
    for folder, hours_ago in ((first, 4.0), (second, 3.0)):
        last_used(folder, hours_ago)
    gone, elsewhere, forgotten = (base / name for name in ("gone", "elsewhere", "forgotten"))
    for folder, place, hours_ago in ((gone, base / "x", 2.0), (elsewhere, ROOT, 2.0), (forgotten, ROOT, 24.0 * 40)):
        folder.mkdir()
        (folder / "installation").write_text(str(place))
        last_used(folder, hours_ago)
    (base / "thesis").mkdir()
    third, newest = folders()[0], edit(base, 4)
    assert {path.name for path in base.iterdir()} == {third.name, newest.name, "elsewhere", "thesis"}
    assert clear_others() > 0
    assert {path.name for path in base.iterdir()} == {newest.name, "thesis"}


def test_where_nothing_can_be_written_it_is_compiled_for_now(base: Path, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("no folder")
    code = (
        "import os; from ffmap.app.compiled_code import compiled_code; os.environ.update(compiled_code())\n"
        "import ffmap.algorithms.base.plan_index\n"
        "print(os.environ['NUMBA_CACHE_DIR'])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    folder = Path(done.stdout.strip())
    assert folder.parents[1] == tmp_path
    assert not folder.parent.exists()
    refused = subprocess.run([*FFMAP, "cache", "--warm"], env=environment, capture_output=True, text=True)
    assert refused.returncode == 2
    assert VARIABLE in refused.stderr
    assert len(refused.stderr.splitlines()) == 1


def test_a_folder_that_the_user_names_is_taken(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "mine"))
    assert compiled_code() == {}
    # What another state of the program has chosen for itself, and handed on to this one, is not the user's choice.
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv(VARIABLE, str(edit(base, 1)))
    assert edit(base, 2) != Path(os.environ[VARIABLE])


def test_the_command_tells_of_compiled_code() -> None:
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["cache"]).output
    assert "compiled code: " in shown
    assert os.environ[VARIABLE] in shown


def test_what_is_compiled_beforehand_is_all_that_a_run_needs(tmp_path: Path) -> None:
    """By what Numba says of its cache: all that a run loads, or compiles and saves, the warm-up has loaded or saved."""

    def functions(*words: object) -> set[str]:
        # Processes share the pipe: what each buffers would be cut at 8 KB, in the midst of a name, by what others write.
        environment = {**os.environ, "NUMBA_DEBUG_CACHE": "1", "PYTHONUNBUFFERED": "1"}
        done = ffmap(environment, *words)
        assert done.returncode == 0, done.stderr
        return set(re.findall(r"data (?:loaded from|saved to) '([^']+)'", done.stdout))

    bag = tmp_path / "a.bag"
    simulate(bag, SimulationSettings(building="small", seed=3, duration_s=4.0))
    compiled = functions("cache", "--warm")
    assert len(compiled) > 50
    used = functions("run", bag, "--out", tmp_path / "run", "--quiet")
    assert len(used) > 50
    assert used <= compiled
