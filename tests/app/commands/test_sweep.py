"""A sweep: its combinations, killed and started again, interrupted, and with mistakes."""

import csv
import json
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import psutil
import pytest

from ffmap.app.commands.sweep import (
    Combination,
    Parameter,
    Search,
    grid_of,
    optimize,
    parse_grid,
    random_of,
    sweep,
)
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import FFMAP, FFMAP_IN_FRONT, ffmap, with_cache

GRID = ["--grid", "wall_planes.distance_m=0.01,0.045", "--grid", "building.scans_min=3"]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return with_cache(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    simulate(path, SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=2.0))
    return path


def records(out: Path) -> dict[str, dict]:
    return {path.parent.name: json.loads(path.read_text()) for path in out.glob("drive-*/run.json")}


def wait_for_run(process: subprocess.Popen, out: Path, runs: int) -> None:
    """Wait until a sweep has begun some runs."""
    end = time.monotonic() + 1000
    while len(records(out)) < runs and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    assert len(records(out)) >= runs
    assert process.poll() is None


def test_a_killed_sweep_continues_and_each_run_has_its_files_and_its_row(
    bag: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    words = ["sweep", bag, *GRID, "--out", out, "--workers", 1]
    command = [*FFMAP, *map(str, words)]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    wait_for_run(process, out, 2)
    first = next(name for name, own in records(out).items() if own["outcome"] == "complete")
    process.send_signal(signal.SIGTERM)
    process.wait()
    changed_ns = (out / first / "run.json").stat().st_mtime_ns
    done = ffmap(environment, *words)
    assert done.returncode == 0, done.stderr
    assert (out / first / "run.json").stat().st_mtime_ns == changed_ns
    assert f"{first}: " in done.stderr
    assert "(was finished)" in done.stderr
    found = records(out)
    assert [own["outcome"] for own in found.values()] == ["complete", "complete"]
    # One of the drive, and one of its first seconds for the extrinsics.
    assert len(list(Path(environment["FFMAP_CACHE"]).glob("odometry/*.zip"))) == 2
    assert "2 of 2 runs succeeded" in done.stdout
    assert "compare:" in done.stdout
    with (out / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["wall_planes.distance_m"] for row in rows} == {"0.01", "0.045"}
    for row in rows:
        names = {path.name for path in (out / row["run"]).iterdir()}
        assert {"recording.rrd", "evaluation.rrd", "labels.parquet", "map.yaml"} <= names
        assert not {"labelled.bag", "cloud.ply", "spool"} & names
        assert found[row["run"]]["options"]["detail"] == "map"
        metrics = json.loads((out / row["run"] / "metrics.json").read_text())
        assert row["error"] == ""
        assert float(row["wall.f1"]) == metrics["wall.f1"]
        assert float(row["doors"]) == found[row["run"]]["counts"]["doors"]


def test_an_interrupted_sweep_ends_its_runs(
    bag: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    words = ["sweep", str(bag), *GRID, "--out", str(tmp_path), "--workers", "2"]
    process = subprocess.Popen(
        [*FFMAP_IN_FRONT, *words], env=environment, stderr=subprocess.PIPE, text=True
    )
    wait_for_run(process, tmp_path, 1)
    children = psutil.Process(process.pid).children()
    assert children
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "the same command continues" in errors
    assert not psutil.wait_procs(children, timeout=30)[1]
    assert all(record["outcome"] != "complete" for record in records(tmp_path).values())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({"grid": ["wall_planes.similarty_m=1"]}, "wall_planes.similarity_m"),
        ({"outputs": ("recording",)}, "add labels"),
        ({"random": 2, "optuna": 2}, "--random"),
        ({"objective": "wall_f2"}, "wall.f1"),
        ({"optuna": 2, "evaluate": False}, "truth"),
        ({"out": Path("file") / "out"}, "cannot be written"),
        ({"paths": [Path("no.bag")]}, "no.bag"),
        ({"scheduler": "tcp://127.0.0.1:9"}, "dask scheduler"),
        ({"scheduler": "nonsense"}, "tcp://127.0.0.1:8786"),
        ({"scheduler": "tcp://127.0.0.1:9", "without": "distributed"}, "pip install distributed'"),
        ({"optuna": 2, "without": "optuna"}, "pip install optuna'"),
    ],
)
def test_mistakes_are_one_line_and_nothing_starts(
    words: dict, expected: str, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ffmap.app.run.cluster._CONNECT_S", 1.0)
    if "without" in words:
        monkeypatch.setitem(sys.modules, words["without"], None)
    Path("file").touch()
    words = {"grid": ["seed=0,1"], "paths": [bag], "out": Path("out"), **words}
    of_search = ("grid", "random", "optuna", "objective")
    search = Search(**{name: words[name] for name in of_search if name in words})
    others = (*of_search, "paths", "out", "without")
    options = {name: value for name, value in words.items() if name not in others}
    with pytest.raises(InputError) as error:
        sweep(words["paths"], Settings(), RunOptions(quiet=True, **options), search, words["out"])
    assert expected in str(error.value)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.glob("**/run.json"))


def test_a_grid_is_every_combination_once() -> None:
    texts = ["building.door_width_max_m=2, 3.0", "doors.lines_min=2,3,2", "seed=0,1"]
    parameters = parse_grid(texts, False)
    # Values are as the settings hold them.
    assert parameters[0] == Parameter("building.door_width_max_m", (2.0, 3.0))
    assert all(isinstance(value, float) for value in parameters[0].values)
    found = grid_of(parameters)
    assert len(found) == len({tuple(c.items()) for c in found}) == 8
    assert found[0] == {"building.door_width_max_m": 2.0, "doors.lines_min": 2, "seed": 0}
    assert [c["seed"] for c in found[:3]] == [0, 1, 0]


@pytest.mark.parametrize(
    ("texts", "word"),
    [
        ([], "--grid"),
        (["wall_planes.similarity_m"], "step.name=value"),
        (["wall_planes.similarity_m=0.02,"], "step.name=value"),
        (["=1"], "step.name=value"),
        (["wall_planes.similarity_m=0.02,-1"], "similarity_m"),
        (["wall_planes=1"], "wall_planes"),
        (["doors.lines_min=2", "doors.lines_min=3"], "twice"),
        (["wall_planes.similarity_m=0.02..0.05"], "--random"),
        (["doors.lines_min=3..2"], "lower..higher"),
        (["doors.lines_min=1..2..3"], "lower..higher"),
        (["wall_planes.similarity_m=-0.5..0.5"], r"similarity_m = -0\.5"),
    ],
)
def test_mistakes_in_a_grid(texts: list[str], word: str) -> None:
    with pytest.raises(InputError, match=word) as error:
        parse_grid(texts, False)
    assert "\n" not in str(error.value)


def test_random_combinations_are_different_and_the_same_for_a_seed() -> None:
    parameters = parse_grid(["seed=0,1,2,3", "doors.lines_min=2..4"], True)
    found = random_of(parameters, 7, seed=5)
    assert len({tuple(c.items()) for c in found}) == 7
    assert found == random_of(parameters, 7, seed=5) != random_of(parameters, 7, seed=6)
    every = random_of(parameters, 99, seed=5)
    assert len(every) == 12
    assert {c["doors.lines_min"] for c in every} == {2, 3, 4}
    (length,) = parse_grid(["wall_planes.similarity_m=0.02..0.08"], True)
    values = [c["wall_planes.similarity_m"] for c in random_of([length], 60, seed=1)]
    assert len(values) == 60
    assert 0.02 <= min(values) < 0.03
    assert 0.07 < max(values) <= 0.08


@pytest.mark.parametrize(("objective", "best"), [("wall.f1", 2), ("seconds", 3)])
def test_optuna_learns_which_is_better_and_repeats_itself(objective: str, best: int) -> None:
    pytest.importorskip("optuna")
    parameters = parse_grid(["doors.lines_min=2,3", "doors.recess_min_m=0.01..0.03"], True)

    def proposed() -> list[Combination]:
        found: list[Combination] = []

        def perform(combinations: Sequence[Combination]) -> list[float | None]:
            found.extend(dict(own) for own in combinations)
            values = [float(-own["doors.lines_min"]) for own in combinations]
            return [None, *values[1:]] if len(found) % 10 == 0 else values

        optimize(parameters, 40, 4, 0, objective, perform)
        return found

    found = proposed()
    assert len(found) == 40
    assert sum(combination["doors.lines_min"] == best for combination in found[20:]) > 10
    assert found == proposed()
