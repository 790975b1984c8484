"""A bag of one upright lidar that opens wide, from end to end: it gives the poses, and its columns are labelled."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ffmap.app.run.blocks import SCANS_PER_BLOCK
from ffmap.loaders.simulator import SimulationSettings, simulate

FFMAP = [sys.executable, "-c", "from ffmap.app.cli import main; main()"]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one")
    settings = SimulationSettings(building="small", seed=3, duration_s=6.0, sensor="os0-128", lidars="one")
    simulate(folder / "one.bag", settings)
    done = ffmap(folder, "run", "one.bag", "--out", "run")
    assert done.returncode == 0, done.stderr
    return folder / "run"


def ffmap(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "FFMAP_CACHE": str(folder / "cache")}
    return subprocess.run([*FFMAP, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=300)


def test_its_scans_are_labelled_as_well_as_those_of_a_lidar_that_lies(run_dir: Path) -> None:
    record = json.loads((run_dir / "run.json").read_text())
    assert record["rig"]["horizontal"]["topic"] == record["rig"]["vertical"]["topic"] == "/ouster/points"
    assert record["counts"]["scans"] > 2 * SCANS_PER_BLOCK
    metrics = json.loads((run_dir / "metrics.json").read_text())
    for label, least in (("wall", 0.96), ("floor", 0.98), ("ceiling", 0.98)):
        assert metrics["area"][label]["f1"] > least, label
    assert metrics["trajectory"]["ate_rmse_m"] < 0.02


def test_a_scan_labelled_again_has_the_recorded_labels(run_dir: Path) -> None:
    done = ffmap(run_dir.parent, "inspect", "run", "--scan", "40", "--out", "scan.rrd")
    assert done.returncode == 0, done.stderr
    assert "pair" in done.stdout
    assert "differ" not in done.stdout
