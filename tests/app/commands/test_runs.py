"""The table of runs: found, sorted, filtered and printed."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app.commands import runs as runs_command
from ffmap.app.commands.runs import find_runs
from ffmap.loaders.errors import InputError

F1 = {"a": 0.90, "b": 0.99, "c": 0.95, "d": 0.80}


def make_run(folder: Path, f1: float | None, settings: dict[str, object], seconds: float) -> Path:
    folder.mkdir(parents=True)
    record = {
        "outcome": "complete",
        "bag": {"path": f"/data/{folder.name}.bag"},
        "settings": settings,
        "counts": {"doors": 4, "walls": 10},
        "timings_s": {"total": seconds},
    }
    (folder / "run.json").write_text(json.dumps(record))
    if f1 is not None:
        metrics = {"wall.f1": f1, "doors.invented": 1 - f1, "floor.f1": 0.9}
        (folder / "metrics.json").write_text(json.dumps(metrics))
    return folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    root = tmp_path / "runs"
    for i, (name, f1) in enumerate(F1.items()):
        settings = {"seed": 0, "wall_planes": {"similarity_m": 0.02 + 0.01 * (i % 3)}}
        make_run(root / ("sweep" if i % 2 else "") / name, f1, settings, 10.0 - i)
    make_run(root / "unknown", None, {"seed": 0, "wall_planes": {"similarity_m": 0.02}}, 3.0)
    (root / "latest").symlink_to(root / "a", target_is_directory=True)
    return root


def listed(
    capsys: pytest.CaptureFixture[str],
    root: Path,
    where: tuple[str, ...] = (),
    sort: str | None = None,
    reverse: bool = False,
    columns: str | None = None,
) -> list[str]:
    """The names in the table, from its top."""
    runs_command.runs(root, where, sort, reverse, columns)
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    return [Path(row.strip("│ ").split("│")[0].strip()).name for row in rows]


def test_every_run_is_listed_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert sorted(listed(capsys, folder)) == ["a", "b", "c", "d", "unknown"]


@pytest.mark.parametrize(
    ("where", "names"),
    [
        (("wall_f1>0.94",), {"b", "c"}),
        (("wall_f1 >= 0.9", "seconds < 9.5"), {"b", "c"}),
        (("wall_planes.similarity_m=0.02",), {"a", "d", "unknown"}),
        (("wall_planes_similarity_m>0.025", "doors_invented<=0.03"), {"b"}),
        (("bag=D.bag",), {"d"}),
        (("bag!=d.bag",), {"a", "b", "c", "unknown"}),
        (("wall_f1>2",), set()),
    ],
)
def test_where(
    folder: Path, where: tuple[str, ...], names: set[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert set(listed(capsys, folder, where)) == names


def test_better_runs_come_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert listed(capsys, folder, sort="wall_f1") == ["b", "c", "a", "d", "unknown"]
    assert listed(capsys, folder, sort="doors_invented") == ["b", "c", "a", "d", "unknown"]
    assert listed(capsys, folder, sort="seconds") == ["unknown", "d", "c", "b", "a"]
    assert listed(capsys, folder, sort="seconds", reverse=True) == ["a", "b", "c", "d", "unknown"]
    assert listed(capsys, folder, sort="wall_planes.similarity_m")[-1] == "c"


@pytest.mark.parametrize(
    ("where", "sort", "columns", "said"),
    [
        (["wall_ff>1"], None, None, "did you mean 'wall.f1'"),
        (["wall_f1>"], None, None, 'as in "wall.f1>0.98"'),
        (["wall_f1>x"], None, None, "is a number"),
        ([], "speed", None, "setting 'speed'"),
        ([], None, "dors", "did you mean 'doors'"),
    ],
)
def test_mistakes(
    folder: Path, where: list[str], sort: str | None, columns: str | None, said: str
) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        runs_command.runs(folder, where, sort, False, columns)


def test_a_run_that_cannot_be_read_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "unknown" / "run.json").write_text("{")
    (folder / "a" / "metrics.json").write_text("[]")
    runs_command.runs(folder, [], None, False, None)
    printed = capsys.readouterr()
    assert "3 runs in" in printed.out
    assert [line.startswith("not listed: ") for line in printed.err.splitlines()] == [True, True]


def test_no_runs(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no runs"):
        find_runs(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        find_runs(tmp_path / "nothing")


def test_columns_are_chosen(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs_command.runs(folder, [], "wall_f1", False, "wall_planes.similarity_m,doors")
    table = capsys.readouterr().out
    assert "doors" in table
    assert "wall.f1" not in table
    runs_command.runs(folder, [], None, False, "all")
    assert "doors.invented\n" in capsys.readouterr().out


def test_the_table_fits_the_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for i, name in enumerate(("drive-20261123-024400-1a2b3c4d", "drive-20261123-031500-5e6f7a8b")):
        doors = {"lines_min": i, "recess_min_m": 0.02 + i, "width_min_m": 0.6 + i}
        planes = {"similarity_m": 0.04 + i, "lines_min": 3 + i}
        make_run(tmp_path / name, 0.9, {"doors": doors, "wall_planes": planes, "seed": i}, 5.0 + i)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    runs_command.runs(tmp_path, [], None, False, None)
    printed = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out).splitlines()
    headings = [line.strip("┃").split("┃") for line in printed if line.startswith("┃")]
    rows = [line for line in printed if line.startswith("│")]
    assert max(map(len, [*rows, *(line for line in printed if line[0] in "┏┡└")])) <= 80
    assert "1a2b3c4d" in "".join(rows)
    columns = ["".join(lines).replace(" ", "") for lines in zip(*headings, strict=True)]
    assert {"run", "wall.f1", "seconds"} <= set(columns)
    for setting in ("doors.lines_min", "wall_planes.similarity_m", "wall_planes.lines_min"):
        assert setting in columns or setting in printed[-1]


def test_a_piped_table_is_whole(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    runs_command.runs(folder, [], None, False, None)
    heading = next(line for line in capsys.readouterr().out.splitlines() if "run" in line)
    names = {name.strip() for name in heading.split("┃")}
    assert {"wall_planes.similarity_m", "wall.f1", "floor.f1"} <= names


def test_the_table_does_not_load_the_method() -> None:
    code = "import sys, ffmap.app.commands.runs; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
