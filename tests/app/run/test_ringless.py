"""A bag of one upright lidar whose pattern does not repeat, from end to end: five of its clouds make a scan."""

import json
from pathlib import Path

import pytest

from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, with_cache


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ringless")
    settings = SimulationSettings(
        building="small", seed=3, duration_s=5.0, sensor="mid360", lidars="one", format="mcap"
    )
    simulate(folder / "bag", settings)
    done = ffmap_here(
        with_cache(folder / "cache"), "run", folder / "bag", "--out", folder / "run", "--outputs", "recording,labels"
    )
    assert done.returncode == 0, done.stderr
    return folder / "run"


def test_its_scans_are_labelled(run_dir: Path) -> None:
    record = json.loads((run_dir / "run.json").read_text())
    assert record["rig"]["horizontal"]["topic"] == record["rig"]["vertical"]["topic"] == "/livox/lidar"
    assert record["counts"]["scans"] == record["counts"]["clouds"] == 10
    metrics = json.loads((run_dir / "metrics.json").read_text())
    for label, least in (("wall", 0.9), ("floor", 0.9), ("ceiling", 0.9)):
        assert metrics[f"{label}.f1"] > least, label
    assert metrics["trajectory.ate_rmse_m"] < 0.02


def test_a_scan_labelled_again_has_the_recorded_labels(run_dir: Path) -> None:
    done = ffmap_here(
        with_cache(run_dir.parent / "cache"), "inspect", run_dir, "--scan", 5, "--out", run_dir.parent / "scan.rrd"
    )
    assert done.returncode == 0, done.stderr
    assert "labels equal" in done.stdout


def test_a_run_goes_on_from_its_blocks(run_dir: Path) -> None:
    before = json.loads((run_dir / "run.json").read_text())
    (run_dir / "run.json").write_text(json.dumps(before | {"outcome": "running"}))
    done = ffmap_here(with_cache(run_dir.parent / "cache"), "run", "--resume", run_dir)
    assert done.returncode == 0, done.stderr
    after = json.loads((run_dir / "run.json").read_text())
    assert after["labels_digest"] == before["labels_digest"]
    assert after["counts"] == before["counts"]
