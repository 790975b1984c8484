"""A run whose scans are labelled on a Dask cluster."""

import json
from pathlib import Path

import pytest

from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.program import ffmap, ffmap_here, with_cache


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": "bag", "duration_s": 5.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


def test_blocks_of_a_drive_are_labelled_by_a_cluster_as_they_are_here(
    bag: Path, cluster: str
) -> None:
    # In a relative folder, which the cluster's workers would look for elsewhere.
    environment, records = with_cache(bag.parent / "cache"), []
    for program, out, words in (
        (ffmap_here, "here", ()),
        (ffmap, "there", ("--scheduler", cluster)),
    ):
        done = program(environment, "run", bag.name, "--out", out, *words, cwd=bag.parent)
        assert done.returncode == 0, done.stderr
        records.append(json.loads((bag.parent / out / "run.json").read_text()))
    here, there = records
    assert here["labels_digest"] == there["labels_digest"] != ""
    for name in ("walls.geojson", "map.pgm", "cloud.ply"):
        assert (bag.parent / "here" / name).read_bytes() == (
            bag.parent / "there" / name
        ).read_bytes()
    assert (bag.parent / "there" / "recording.rrd").stat().st_size > 100_000


def test_a_scheduler_that_is_not_there_is_one_line(bag: Path) -> None:
    words = ("--out", "nowhere", "--scheduler", "tcp://127.0.0.1:9")
    done = ffmap_here(with_cache(bag.parent / "cache"), "run", bag.name, *words, cwd=bag.parent)
    assert done.returncode == 2
    assert "--scheduler tcp://127.0.0.1:9: no Dask scheduler answers there" in done.stderr
    assert "Traceback" not in done.stderr
