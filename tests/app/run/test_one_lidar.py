"""A bag of one upright lidar, from end to end: it gives the poses, and its scans are labelled."""

import json
from pathlib import Path

import pytest

from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap_here, with_cache


@pytest.mark.parametrize(
    ("sensor", "topic", "seconds", "f1"),
    [
        # It opens wide: its columns are labelled.
        ("os0-128", "/ouster/points", 6.0, 0.96),
        # Its pattern does not repeat: five of its clouds make a scan.
        ("mid360", "/livox/lidar", 5.0, 0.9),
    ],
)
def test_its_scans_are_labelled_and_a_scan_labelled_again_has_its_labels(
    sensor: str, topic: str, seconds: float, f1: float, tmp_path: Path
) -> None:
    settings = SimulationSettings(
        building="small", seed=3, duration_s=seconds, sensor=sensor, lidars="one"
    )
    bag, out, environment = tmp_path / "one.bag", tmp_path / "run", with_cache(tmp_path / "cache")
    simulate(bag, settings)
    done = ffmap_here(environment, "run", bag, "--out", out, "--outputs", "recording,labels")
    assert done.returncode == 0, done.stderr
    record, metrics = (
        json.loads((out / name).read_text()) for name in ("run.json", "metrics.json")
    )
    assert record["rig"]["horizontal"]["topic"] == record["rig"]["vertical"]["topic"] == topic
    assert record["counts"]["scans"] == record["counts"]["clouds"] >= 10
    for label in ("wall", "floor", "ceiling"):
        assert metrics[f"{label}.f1"] > f1, label
    assert metrics["trajectory.ate_rmse_m"] < 0.02
    again = ffmap_here(environment, "inspect", out, "--scan", 5, "--out", tmp_path / "scan.rrd")
    assert again.returncode == 0, again.stderr
    assert "labels equal" in again.stdout
