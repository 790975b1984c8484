"""The suite of generated buildings: one small drive for real, tables from figures, mistakes."""

import io
import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from ffmap.app.commands import suite
from ffmap.app.commands.suite import Drive, format_suite, parse_seeds, run_suite
from ffmap.loaders.errors import InputError

FREE_BYTES = 50_000_000_000


@pytest.fixture(autouse=True)
def _a_disk_with_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """The drives here are small; how much is free on the machine that runs the tests is none of their business."""
    real = shutil.disk_usage("/")
    usage = real._replace(free=FREE_BYTES)
    monkeypatch.setattr(suite.shutil, "disk_usage", lambda _: usage)


def test_drives_that_would_not_fit_on_the_disk_are_refused_before_any_is_made(tmp_path: Path) -> None:
    at_once = 6  # of which each needs more than a sixth of what is free
    with pytest.raises(InputError, match="50 GB are free and 6 drives of the suite at once need 54"):
        suite._check_space(tmp_path, at_once)
    suite._check_space(tmp_path, at_once - 1)


def metrics(wall: float, kept: float) -> dict[str, object]:
    return {
        "area": {
            "wall": {"precision": wall, "recall": 0.9, "f1": 0.95},
            "outside_kept_as_structure": kept,
        },
        "trajectory": {"ate_rmse_m": 0.021},
    }


def test_tables_have_means_spreads_and_the_worst() -> None:
    drives = [
        Drive("plain", 1, metrics(0.96, 0.01)),
        Drive("plain", 2, metrics(0.98, 0.03)),
        Drive("odd", 1, metrics(0.90, 0.2)),
        Drive("odd", 2, None, "it failed"),
    ]
    console = Console(width=150, record=True, file=io.StringIO())
    for table in format_suite(drives):
        console.print(table)
    lines = console.export_text().splitlines()

    def row(name: str, number: int) -> str:
        return [line for line in lines if line.strip("│ ").startswith(name)][number]

    assert "97.0±1.0" in row("plain", 0)
    assert "90.0" in row("odd", 0)
    assert "93.5" in row("mean", 0)
    assert "90.0" in row("worst", 0)
    assert "99.6" in row("paper", 0)
    assert "20.0" in row("worst", 1)  # of what is kept of the outside, most is worst
    assert "2.1" in row("mean", 2)


def test_a_drive_is_simulated_run_evaluated_deleted_and_cached(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FFMAP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(suite, "CASES", {"small": {"building": "small", "sensor": "vlp16"}})
    monkeypatch.setattr(suite, "QUICK_S", 2.0)
    out = tmp_path / "results" / "suite.json"
    assert run_suite(out, (3,), True, [], quiet=True) == 0
    first = json.loads(out.read_text())["drives"][0]
    assert 0.5 < first["metrics"]["area"]["floor"]["f1"] <= 1
    assert first["metrics"]["run"]["counts"]["scans"] > 10
    assert list(out.parent.iterdir()) == [out]
    assert "1 of 1 drives, 0 from the cache" in capsys.readouterr().out
    assert run_suite(out, (3,), True, [], quiet=True) == 0
    assert "1 of 1 drives, 1 from the cache" in capsys.readouterr().out
    assert json.loads(out.read_text())["drives"][0]["metrics"] == first["metrics"]


def test_a_drive_that_fails_is_told_and_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FFMAP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(suite, "CASES", {"none": {"building": "castle"}})
    assert run_suite(tmp_path / "suite.json", (3,), True, []) == 1
    told = capsys.readouterr()
    assert "castle" in told.err
    assert "0 of 1 drives" in told.out


@pytest.mark.parametrize("content", ["my thesis", "[]", '{"seeds": 1}'])
def test_file_that_no_suite_wrote_is_left_alone(content: str, tmp_path: Path) -> None:
    out = tmp_path / "thesis.json"
    out.write_text(content)
    with pytest.raises(InputError, match="name another file"):
        run_suite(out, (3,), True, [], quiet=True)
    assert out.read_text() == content


def test_earlier_results_stay_until_the_suite_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite, "CASES", {"one": {}, "two": {}})
    out = tmp_path / "suite.json"
    out.write_text('{"drives": []}')

    def drive(case: str, simulation: suite.Simulation, *_: object) -> suite.Drive:
        if case == "two":
            raise KeyboardInterrupt
        return suite.Drive(case, simulation["seed"], {})

    monkeypatch.setattr(suite, "_drive", drive)
    with pytest.raises(KeyboardInterrupt):
        run_suite(out, (3,), True, [], quiet=True, at_once=1)
    assert json.loads(out.read_text()) == {"drives": []}
    assert [d["case"] for d in json.loads((tmp_path / "suite.json.part").read_text())["drives"]] == ["one"]


def test_drawn_buildings_are_a_suite_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: list[tuple[str, int]] = []
    weak = {
        "doors": {"by_design": {"hinged, flush, closed": {"passed": 3, "found": 1, "state_right": 1}}},
        "elements": {"niche": {"truth": "wall", "labels": {"wall": 30, "door": 10}}},
    }

    def drive(case: str, simulation: suite.Simulation, *_: object) -> suite.Drive:
        run.append((case, simulation["seed"]))
        return suite.Drive(case, simulation["seed"], weak)

    monkeypatch.setattr(suite, "_drive", drive)
    assert run_suite(tmp_path / "suite.json", parse_seeds(None, "drawn"), False, [], quiet=True, at_once=1, name="drawn") == 0
    assert [case for case, _ in run] == list(suite.DRAWN_CASES)
    assert len({seed for _, seed in run}) == len(run)  # no two share a building
    told = capsys.readouterr().out
    assert [part.strip() for part in next(line for line in told.splitlines() if "flush" in line).split("│")[1:-1]] == [
        "hinged, flush, closed", "36", "12", "12"
    ]  # fmt: skip
    assert "75.0" in next(line for line in told.splitlines() if "niche" in line)
    with pytest.raises(InputError, match="named and drawn"):
        run_suite(tmp_path / "suite.json", (1,), False, [], quiet=True, name="runs/latest")


@pytest.mark.parametrize("text", ["one", "1,", "1;2", "-1"])
def test_seeds_that_are_none(text: str) -> None:
    with pytest.raises(InputError, match="--seeds"):
        parse_seeds(text)


def test_seeds() -> None:
    assert parse_seeds("1, 2") == (1, 2)
    assert parse_seeds(None) == suite.REPORTED_SEEDS
