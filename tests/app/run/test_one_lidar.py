"""A bag of one upright lidar that opens wide, from end to end: it gives the poses, and its columns are labelled."""

import json
from pathlib import Path

import pytest

from ffmap.app.run.scans import SCANS_PER_BLOCK
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, with_cache


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("one")
    settings = SimulationSettings(building="small", seed=3, duration_s=6.0, sensor="os0-128", lidars="one")
    simulate(folder / "one.bag", settings)
    done = ffmap_here(with_cache(folder / "cache"), "run", folder / "one.bag", "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    return folder / "run"


def test_its_scans_are_labelled_as_well_as_those_of_a_lidar_that_lies(run_dir: Path) -> None:
    record = json.loads((run_dir / "run.json").read_text())
    assert record["rig"]["horizontal"]["topic"] == record["rig"]["vertical"]["topic"] == "/ouster/points"
    assert record["counts"]["scans"] > 2 * SCANS_PER_BLOCK
    metrics = json.loads((run_dir / "metrics.json").read_text())
    for label, least in (("wall", 0.96), ("floor", 0.98), ("ceiling", 0.98)):
        assert metrics[f"{label}.f1"] > least, label
    assert metrics["trajectory.ate_rmse_m"] < 0.02


def test_a_scan_labelled_again_has_the_recorded_labels(run_dir: Path) -> None:
    done = ffmap_here(
        with_cache(run_dir.parent / "cache"), "inspect", run_dir, "--scan", 40, "--out", run_dir.parent / "scan.rrd"
    )
    assert done.returncode == 0, done.stderr
    assert "pair" in done.stdout
    assert "labels equal" in done.stdout
