"""A run whose scans are labelled on a Dask cluster."""

import json
from pathlib import Path

from tests.program import ffmap, ffmap_here, with_cache


def test_blocks_of_a_drive_are_labelled_by_a_cluster_as_they_are_here(
    small_bag: Path, small_run: Path, cluster: str
) -> None:
    # In a relative folder, which the cluster's workers would look for elsewhere.
    folder, environment = small_bag.parent, with_cache(small_bag.parent / "cache")
    words = ("run", small_bag.name, "--out", "there", "--no-evaluate", "--scheduler", cluster)
    done = ffmap(environment, *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    here, there = small_run, folder / "there"
    digests = [json.loads((run / "run.json").read_text())["labels_digest"] for run in (here, there)]
    assert digests[0] == digests[1] != ""
    for name in ("walls.geojson", "map.pgm", "cloud.ply"):
        assert (here / name).read_bytes() == (there / name).read_bytes()
    assert (there / "recording.rrd").stat().st_size > 100_000


def test_a_scheduler_that_is_not_there_is_one_line(small_bag: Path, tmp_path: Path) -> None:
    words = ("--out", tmp_path / "nowhere", "--scheduler", "tcp://127.0.0.1:9")
    done = ffmap_here(with_cache(tmp_path), "run", small_bag, *words)
    assert done.returncode == 2
    assert "--scheduler tcp://127.0.0.1:9: no Dask scheduler answers there" in done.stderr
    assert "Traceback" not in done.stderr
