"""A run that is killed in any stage is resumed to the same results."""

import json
from pathlib import Path

import pytest

from ffmap.app.run.scans import SCANS_PER_BLOCK
from tests.app.record.recordings import rows
from tests.program import ffmap_here, kill_once, with_cache

OPTIONS = ("--no-evaluate", "--outputs", "labels,maps,recording")
LEFT_BY = {
    "odometry": "cache/odometry/*.part",
    "scans": "killed/spool/000000.arrow",
    "final": "killed/spool/*.final.arrow",
}
"""A file that shows that a stage is under way."""


def finished(cache: Path, *words: object) -> None:
    done = ffmap_here(with_cache(cache), "run", *words)
    assert done.returncode == 0, done.stderr


def results(out: Path) -> tuple[str, bytes, bytes, dict[int, float]]:
    """Labels' digest, map, trajectory, and returns on walls in each recorded scan."""
    record = json.loads((out / "run.json").read_text())
    assert record["outcome"] == "complete"
    walls = rows(out / "recording.rrd", "/metrics/labels/wall")
    recorded = {row["scan"]: row["scalars"][0] for row in walls}
    assert len(recorded) == record["counts"]["scans"] > SCANS_PER_BLOCK
    assert sum(recorded.values()) == record["counts"]["returns"]["wall"]
    map_file, poses = (out / "map.pgm").read_bytes(), (out / "trajectory.tum").read_bytes()
    return record["labels_digest"], map_file, poses, recorded


def test_a_cached_odometry_and_a_single_worker_give_the_same(
    small_bag: Path, small_run: Path, tmp_path: Path
) -> None:
    words = ("--out", tmp_path / "alone", "--workers", 1, "--detail", "map", *OPTIONS)
    finished(small_run.parent / "cache", small_bag, *words)
    assert results(tmp_path / "alone") == results(small_run)
    assert json.loads((tmp_path / "alone" / "run.json").read_text())["odometry_cached"]


@pytest.mark.parametrize("stage", LEFT_BY)
def test_a_killed_run_is_resumed_to_the_same(
    stage: str, small_bag: Path, small_run: Path, tmp_path: Path
) -> None:
    cache, out = tmp_path / "cache", tmp_path / "killed"

    def left() -> list[Path]:
        return [*tmp_path.glob(LEFT_BY[stage])]

    kill_once(with_cache(cache), left, "run", small_bag, "--out", out, *OPTIONS)
    assert json.loads((out / "run.json").read_text())["outcome"] == "running"
    finished(cache, "--resume", out)
    assert results(out) == results(small_run)
