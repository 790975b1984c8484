"""The bench: stages beside their floors, a drive repeated, other revisions, and mistakes."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.app.analysis import bench_runs
from ffmap.app.analysis.bench_floors import LabellingTimes, Line
from ffmap.app.analysis.bench_report import Budget
from ffmap.app.analysis.bench_runs import MeasuredRun, Program, measure_run, medians, revision, this_program
from ffmap.app.commands import bench as bench_command
from ffmap.app.run.odometry_cache import CACHE_VARIABLE
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate

ROOT = Path(__file__).resolve().parents[3]
STAGES = ("odometry", "scans", "building", "final")
RUN = MeasuredRun(
    8.0, {"odometry": 2.0, "scans": 3.0, "building": 1.0, "final": 1.5}, 4.0, (1.0, 4.0, 3.0, 2.0), 10, 20
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "duration_s": 3.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


@dataclass(frozen=True)
class Measured:
    """What a bench of a drive, once and twice over, has printed and written; cache: the user's."""

    printed: str
    content: dict[str, Any]
    cache: Path


def ffmap(*words: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [Path(sys.executable).with_name("ffmap"), *words]
    return subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True)


@pytest.fixture(scope="module")
def measured(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Measured:
    folder = tmp_path_factory.mktemp("bench")
    out, cache = folder / "bench.json", folder / "cache"
    done = ffmap("bench", bag, "--repeat", "2", "--json", out, FFMAP_CACHE=str(cache))
    assert done.returncode == 0, done.stderr
    return Measured(done.stdout, json.loads(out.read_text()), cache)


def test_tables_show_every_stage_with_its_unit(measured: Measured) -> None:
    rows = {line.split("│")[1].strip() for line in measured.printed.splitlines() if line.startswith("│")}
    assert rows >= {
        "reading",
        "smoothing, labelling",
        *STAGES,
        "whole run",
        "this machine",
        "the paper",
        "the run",
        "2 times",
    }
    for heading in (
        "floor, ms",
        "takes, ms",
        "floor, s",
        "takes, s",
        "ratio",
        "median, ms",
        "quarter 4, MiB",
        "2 times, s",
    ):
        assert heading in measured.printed
    assert "s of driving a second" in measured.printed
    assert "of the clouds' bytes" in measured.printed


def test_json_has_the_same_figures(measured: Measured) -> None:
    content = measured.content
    assert content["runs"] == 1
    assert content["clouds"] > 50
    assert content["driving_s"] == pytest.approx(3.0, abs=0.3)
    assert content["budget"].keys() == {"reading", "labelling", *STAGES, "whole_run"}
    for name, line in content["budget"].items():
        unit = "ms" if name in ("reading", "labelling") else "s"
        floor, takes = line[f"floor_{unit}"], line[f"takes_{unit}"]
        assert takes > 0
        assert (floor is None) == (name in ("building", "whole_run"))
        assert line["ratio"] == (None if floor is None else pytest.approx(takes / floor))
    labelling = content["budget"]["labelling"]
    assert labelling["min_ms"] <= labelling["takes_ms"] <= labelling["max_ms"]
    assert 0 < content["recording"]["share_of_clouds"] < 2
    for memory in (content["memory"], content["repeated"]["memory"]):
        assert len(memory["peak_by_quarter_mib"]) == 4
        assert memory["peak_mib"] == max(memory["peak_by_quarter_mib"]) > 50
    assert content["repeated"]["times"] == 2
    assert content["repeated"]["driving_s"] > 2 * content["driving_s"]


def test_no_odometry_of_the_users_is_taken_or_left(measured: Measured) -> None:
    assert not measured.cache.exists()


def test_this_process_has_its_own_cache_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for named in (True, False):
        monkeypatch.setenv(CACHE_VARIABLE, "mine") if named else monkeypatch.delenv(CACHE_VARIABLE)
        environment = dict(os.environ)
        with bench_command._odometries_kept_in(tmp_path):
            assert os.environ[CACHE_VARIABLE] == str(tmp_path)
        assert dict(os.environ) == environment


def test_json_on_standard_output_stands_alone(
    bag: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    labelling = LabellingTimes(np.array([0.5]), np.array([2.0]), 1000.0)
    stages = {name: Line(None, RUN.timings_s[name]) for name in STAGES}
    budget = Budget(1, 2, 4.0, 80, 100, Line(1.0, 2.0), labelling, stages, RUN, None)
    monkeypatch.setattr(bench_command, "_measure_budget", lambda *_: budget)
    bench_command.bench(BagPath((bag,)), 60.0, json=Path("-"))
    content = json.loads(capsys.readouterr().out)
    assert content["budget"]["whole_run"]["times_real_time"] == 0.5
    assert content["recording"]["share_of_clouds"] == 0.1
    assert "repeated" not in content


def test_two_versions_run_in_turn_and_never_on_an_earlier_odometry(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    asked: list[tuple[str, Path]] = []

    def measure(
        program: Program, bag: BagPath, folder: Path, workers: int, cache: Path, trajectory: Path | None
    ) -> MeasuredRun:
        asked.append((program.name, cache))
        # The first runs of both compile code, and are long.
        slow = 100.0 if len(asked) <= 2 else 2.0 if program.import_path else 1.0
        return replace(RUN, whole_s=slow * RUN.whole_s)

    monkeypatch.setattr(bench_command, "measure_run", measure)
    monkeypatch.setattr(bench_command, "revision", lambda name, _: Program(name, "app.cli", tmp_path))
    out = tmp_path / "bench.json"
    bench_command.bench(BagPath((bag,)), 60.0, runs=2, against="v1", json=out)
    assert [name for name, _ in asked] == ["this version", "v1"] * 3
    assert len({cache for _, cache in asked}) == 6
    content = json.loads(out.read_text())
    assert content["this"]["whole_run_s"] == 8.0
    assert content["other"]["whole_run_s"] == 16.0
    assert content["ratio"]["whole_run"] == 0.5
    assert content["against"] == "v1"
    printed = capsys.readouterr().out
    for name in ("v1, s", "v1, ms", "v1, MiB", "ratio", *STAGES, "whole run", "peak memory"):
        assert name in printed


def test_medians_are_of_each_figure() -> None:
    runs = [replace(RUN, whole_s=s, timings_s={"scans": 10 - s}, peaks_mib=(s, 1, 2, 3)) for s in (1.0, 5.0, 2.0)]
    middle = medians(runs)
    assert (middle.whole_s, middle.timings_s, middle.peaks_mib) == (2.0, {"scans": 8.0}, (2.0, 1, 2, 3))


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no git checkout")
def test_another_revision_is_imported_from_its_own_folder(tmp_path: Path) -> None:
    program = revision("HEAD", tmp_path)
    assert program.import_path == tmp_path
    told = subprocess.run(
        [sys.executable, "-P", "-c", f"import {program.command_line} as module; print(module.__file__)"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert told.stdout.startswith(str(tmp_path)), told.stderr


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no git checkout")
def test_a_revision_that_is_not_there_is_told_in_one_line(bag: Path) -> None:
    done = ffmap("bench", bag, "--against", "no-such-revision")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.splitlines() == [
        "ffmap: --against no-such-revision: the checkout has no such revision; 'git log' lists them"
    ]


def test_without_a_checkout_there_is_no_other_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_runs, "__file__", str(tmp_path / "app" / "analysis" / "bench_runs.py"))
    with pytest.raises(InputError, match="runs from none"):
        revision("HEAD", tmp_path / "other")


def test_a_run_that_fails_says_why(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.bag: no such file"):
        measure_run(this_program(), BagPath((tmp_path / "nothing.bag",)), tmp_path, 1, tmp_path / "cache")
    with pytest.raises(
        InputError, match=r"--against v1: its run ended with exit code 1 \(ModuleNotFoundError.*\); name"
    ):
        measure_run(
            Program("v1", "no_such.cli", tmp_path), BagPath((tmp_path / "a.bag",)), tmp_path, 1, tmp_path / "cache"
        )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"json": Path("no-such-folder") / "a.json"}, "--json no-such-folder/a.json: there is no folder"),
        ({"json": Path()}, "--json .: is a folder"),
        ({"against": "HEAD", "repeat": 2}, "--repeat: measures one version"),
    ],
)
def test_mistakes_are_told_before_anything_is_measured(words: dict[str, Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        bench_command.bench(BagPath((tmp_path / "not-even-there.bag",)), 60.0, **words)
