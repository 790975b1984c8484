"""A sweep as a user meets it: on this machine, killed and started again, on a Dask cluster, and with mistakes."""

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
from tests.program import FFMAP, FFMAP_IN_FRONT, ffmap, ffmap_here, with_cache

GRID = ["--grid", "labelling.wall_distance_m=0.01,0.045", "--grid", "building.scans_min=3"]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return with_cache(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": "bag", "duration_s": 2.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


def records(out: Path) -> dict[str, dict]:
    return {path.parent.name: json.loads(path.read_text()) for path in out.glob("drive-*/run.json")}


@pytest.fixture(scope="module")
def killed(bag: Path, environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, str]:
    """A sweep that was killed after its first run and started again; what was there in between, and what it said."""
    out = tmp_path_factory.mktemp("sweeps") / "killed"
    command = [*FFMAP, "sweep", str(bag), *GRID, "--out", str(out), "--workers", "1"]
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 200
    while len(records(out)) < 2 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    assert process.poll() is None
    # Its run goes on to its end; a second one in the same folder would be refused until then.
    process.send_signal(signal.SIGTERM)
    process.wait()
    while not all((out / name / "metrics.json").exists() for name in records(out)) and time.monotonic() < end:
        time.sleep(0.05)
    before = {
        name: (out / name / "run.json").stat().st_mtime_ns
        for name, record in records(out).items()
        if record["outcome"] == "complete"
    }
    done = ffmap(environment, "sweep", bag, *GRID, "--out", out, "--workers", 1)
    assert done.returncode == 0, done.stderr
    return out, before, done.stdout


def test_a_killed_sweep_repeats_no_finished_run_and_no_odometry(
    killed: tuple[Path, dict, str], environment: dict[str, str]
) -> None:
    out, before, said = killed
    after = records(out)
    assert before
    assert len(after) == 2
    for name, changed_ns in before.items():
        assert (out / name / "run.json").stat().st_mtime_ns == changed_ns
    assert all(record["outcome"] == "complete" for record in after.values())
    # One of the drive, and one of its first seconds by the horizontal lidar alone, for the extrinsics.
    assert len(list(Path(environment["FFMAP_CACHE"]).glob("odometry/*/complete"))) == 2
    assert f"2 of 2 runs, {len(before)} of them were finished" in said
    assert "compare:" in said


def test_the_runs_have_what_a_sweep_writes(killed: tuple[Path, dict, str]) -> None:
    out = killed[0]
    for name, record in records(out).items():
        names = {path.name for path in (out / name).iterdir()}
        assert {"recording.rrd", "evaluation.rrd", "labels.parquet", "metrics.json", "map.yaml"} <= names
        assert not {"labelled.bag", "cloud.ply", "spool"} & names
        assert record["options"]["detail"] == "map"


def test_the_table_holds_every_run(killed: tuple[Path, dict, str]) -> None:
    out = killed[0]
    with (out / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["labelling.wall_distance_m"] for row in rows} == {"0.01", "0.045"}
    for row in rows:
        metrics = json.loads((out / row["run"] / "metrics.json").read_text())
        assert row["error"] == ""
        assert float(row["wall_f1"]) == metrics["area"]["wall"]["f1"]
        assert float(row["doors"]) == records(out)[row["run"]]["counts"]["doors"]


def test_a_cluster_gives_the_same_labels(
    killed: tuple[Path, dict, str], bag: Path, environment: dict[str, str], cluster: str, tmp_path: Path
) -> None:
    done = ffmap(environment, "sweep", bag, *GRID, "--out", tmp_path / "out", "--scheduler", cluster)
    assert done.returncode == 0, done.stderr
    ours, theirs = records(killed[0]), records(tmp_path / "out")
    assert sorted(ours) == sorted(theirs)
    for name in ours:
        assert ours[name]["labels_digest"] == theirs[name]["labels_digest"] != ""
        here, there = (read_labels(out / name / "labels.parquet") for out in (killed[0], tmp_path / "out"))
        assert list(here) == list(there)
        assert all(np.array_equal(here[scan], there[scan]) for scan in here)


def test_an_interrupted_sweep_leaves_no_run_on_the_cluster(
    bag: Path, environment: dict[str, str], cluster: str, tmp_path: Path
) -> None:
    command = [*FFMAP_IN_FRONT, "sweep", str(bag), *GRID, "--out", str(tmp_path / "out"), "--scheduler", cluster]
    process = subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 100
    while not records(tmp_path / "out") and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 130, said
    assert "Traceback" not in said
    assert "the same command goes on" in said
    assert all(record["outcome"] != "complete" for record in records(tmp_path / "out").values())


SEEDS = ["seed=0,1"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({"grid": []}, "--grid"),
        ({"grid": ["wall_planes.similarty_m=1"]}, "wall_planes.similarity_m"),
        ({"grid": ["wall_planes.similarity_m=0.05,-1"]}, "similarity_m = -1"),
        ({"grid": SEEDS, "outputs": ("recording",)}, "add labels"),
        ({"grid": SEEDS, "random": 2, "optuna": 2}, "--random"),
        ({"grid": SEEDS, "objective": "wall_f2"}, "wall_f1"),
        ({"grid": SEEDS, "optuna": 2, "evaluate": False}, "truth"),
        ({"grid": SEEDS, "out": Path("file") / "out"}, "cannot be written"),
        ({"grid": SEEDS, "paths": [Path("no.bag")]}, "no.bag"),
        ({"grid": SEEDS, "scheduler": "tcp://127.0.0.1:9"}, "dask scheduler"),
        ({"grid": SEEDS, "scheduler": "nonsense"}, "tcp://127.0.0.1:8786"),
    ],
)
def test_mistakes_are_one_line_and_nothing_starts(
    words: dict, expected: str, bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("ffmap.app.run.cluster._CONNECT_S", 1.0)
    Path("file").touch()
    of_search, of_sweep = ("grid", "random", "optuna", "objective"), ("paths", "out")
    search = Search(**{name: words[name] for name in of_search if name in words})
    options = {name: words[name] for name in words if name not in (*of_search, *of_sweep)}
    paths, out = words.get("paths", [bag]), words.get("out", Path("out"))
    with pytest.raises(InputError) as error:
        sweep(paths, Settings(), RunOptions(quiet=True, **options), search, out)
    assert expected in str(error.value)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.glob("**/run.json"))


def test_the_command_line_says_which_outputs_there_are(bag: Path, environment: dict[str, str], tmp_path: Path) -> None:
    for command in (("sweep", bag, "--grid", "doors.lines_min=2,3"), ("run", bag)):
        done = ffmap_here(environment, *command, "--outputs", "recording,rooms", "--out", tmp_path / "out")
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1
        assert "'rooms'" in done.stderr
        assert "geojson" in done.stderr


def test_without_dask_it_says_how_to_install_it(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    options = RunOptions(scheduler="tcp://127.0.0.1:9", quiet=True)
    with pytest.raises(InputError, match=r"-m pip install distributed' .*'\.\[cluster\]'"):
        sweep([bag], Settings(), options, Search(SEEDS), tmp_path / "out")


def test_without_optuna_it_says_how_to_install_it(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    options, search = RunOptions(quiet=True), Search(SEEDS, optuna=2)
    with pytest.raises(InputError, match=r"-m pip install optuna' .*'\.\[optuna\]'"):
        sweep([bag], Settings(), options, search, tmp_path / "out")
