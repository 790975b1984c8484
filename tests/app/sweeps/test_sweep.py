"""A sweep on this machine, killed and started again, on a Dask cluster, and with mistakes."""

import csv
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ffmap.app.commands.sweep import Search, sweep
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import Settings
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import FFMAP, FFMAP_IN_FRONT, ffmap, with_cache

GRID = ["--grid", "wall_planes.distance_m=0.01,0.045", "--grid", "building.scans_min=3"]
SEEDS = ["seed=0,1"]
Killed = tuple[Path, dict[str, int], str]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return with_cache(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    drive = {"building": "small", "seed": 3, "sensor": "vlp16", "format": "bag", "duration_s": 2.0}
    simulate(path, SimulationSettings.model_validate(drive))
    return path


def records(out: Path) -> dict[str, dict]:
    return {path.parent.name: json.loads(path.read_text()) for path in out.glob("drive-*/run.json")}


@pytest.fixture(scope="module")
def killed(
    bag: Path, environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Killed:
    """A sweep killed after its first run and started again: its folder, the time stamps of run.json
    in between, and its output."""
    out = tmp_path_factory.mktemp("sweeps") / "killed"
    words = ["sweep", bag, *GRID, "--out", out, "--workers", 1]
    command = [*FFMAP, *map(str, words)]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 200
    while len(records(out)) < 2 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    assert process.poll() is None
    # Its run continues; a second one in the same folder would be refused until it has ended.
    process.send_signal(signal.SIGTERM)
    process.wait()
    while not all((out / name / "metrics.json").exists() for name in records(out)):
        assert time.monotonic() < end
        time.sleep(0.05)
    before = {
        name: (out / name / "run.json").stat().st_mtime_ns
        for name, record in records(out).items()
        if record["outcome"] == "complete"
    }
    done = ffmap(environment, *words)
    assert done.returncode == 0, done.stderr
    return out, before, done.stdout


def test_a_killed_sweep_repeats_no_finished_run_and_no_odometry(
    killed: Killed, environment: dict[str, str]
) -> None:
    out, before, printed = killed
    after = records(out)
    assert before
    assert len(after) == 2
    for name, changed_ns in before.items():
        assert (out / name / "run.json").stat().st_mtime_ns == changed_ns
    assert all(record["outcome"] == "complete" for record in after.values())
    # One of the drive, and one of its first seconds for the extrinsics.
    assert len(list(Path(environment["FFMAP_CACHE"]).glob("odometry/*.zip"))) == 2
    assert f"2 of 2 runs, {len(before)} of them were finished" in printed
    assert "compare:" in printed


def test_each_run_has_its_files_and_its_row(killed: Killed) -> None:
    out = killed[0]
    with (out / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["wall_planes.distance_m"] for row in rows} == {"0.01", "0.045"}
    for row in rows:
        names = {path.name for path in (out / row["run"]).iterdir()}
        assert {"recording.rrd", "evaluation.rrd", "labels.parquet", "map.yaml"} <= names
        assert not {"labelled.bag", "cloud.ply", "spool"} & names
        record = records(out)[row["run"]]
        assert record["options"]["detail"] == "map"
        metrics = json.loads((out / row["run"] / "metrics.json").read_text())
        assert row["error"] == ""
        assert float(row["wall.f1"]) == metrics["wall.f1"]
        assert float(row["doors"]) == record["counts"]["doors"]


def test_a_cluster_gives_the_same_labels(
    killed: Killed, bag: Path, environment: dict[str, str], cluster: str, tmp_path: Path
) -> None:
    words = ("sweep", bag, *GRID, "--out", tmp_path / "out", "--scheduler", cluster)
    done = ffmap(environment, *words)
    assert done.returncode == 0, done.stderr
    ours, theirs = records(killed[0]), records(tmp_path / "out")
    assert sorted(ours) == sorted(theirs)
    for name in ours:
        assert ours[name]["labels_digest"] == theirs[name]["labels_digest"] != ""
        files = [out / name / "labels.parquet" for out in (killed[0], tmp_path / "out")]
        here, there = map(read_labels, files)
        assert list(here) == list(there)
        assert all(np.array_equal(here[scan], there[scan]) for scan in here)


def test_an_interrupted_sweep_leaves_no_run_on_the_cluster(
    bag: Path, environment: dict[str, str], cluster: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    words = ["sweep", str(bag), *GRID, "--out", str(out), "--scheduler", cluster]
    process = subprocess.Popen(
        [*FFMAP_IN_FRONT, *words],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 100
    while not records(out) and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=60)[1]
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "the same command continues" in errors
    assert all(record["outcome"] != "complete" for record in records(out).values())


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({"grid": []}, "--grid"),
        ({"grid": ["wall_planes.similarty_m=1"]}, "wall_planes.similarity_m"),
        ({"grid": ["wall_planes.similarity_m=0.05,-1"]}, "similarity_m = -1"),
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
    words = {"grid": SEEDS, "paths": [bag], "out": Path("out"), **words}
    of_search = ("grid", "random", "optuna", "objective")
    search = Search(**{name: words[name] for name in of_search if name in words})
    others = (*of_search, "paths", "out", "without")
    options = {name: value for name, value in words.items() if name not in others}
    with pytest.raises(InputError) as error:
        sweep(words["paths"], Settings(), RunOptions(quiet=True, **options), search, words["out"])
    assert expected in str(error.value)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.glob("**/run.json"))
