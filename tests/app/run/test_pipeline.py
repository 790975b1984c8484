"""Scans are labelled while others are registered: as if all poses had been known, and whenever the run is killed."""

import json
from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.run.blocks import SCANS_PER_BLOCK, split_blocks
from ffmap.app.run.poses import KnownPoses, RunPoses
from ffmap.blueprints import entities
from ffmap.loaders.simulator import SimulationSettings, simulate
from tests.app.record.recordings import rows
from tests.program import ffmap_here, kill_once, with_cache

# Level soon, so that blocks of scans are handed out long before the last is registered.
EARLY = ("--set", "trajectory.level_s=1", "--no-evaluate", "--outputs", "labels,maps,recording")
PERIOD_NS = 100_000_000


def poses(count: int) -> Trajectory:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3], T[:, 2, 3] = np.arange(count), 0.5
    return Trajectory(PERIOD_NS * np.arange(count), T)


@pytest.mark.parametrize("scans", [0, 1, 4, 5, 20, 24, 25, 599])
def test_blocks_hold_every_scan_once_and_the_first_few(scans: int) -> None:
    blocks = split_blocks(scans)
    assert [scan for block in blocks for scan in range(block.first, block.first + block.count)] == list(range(scans))
    assert [block.number for block in blocks] == list(range(len(blocks)))
    assert all(0 < block.count <= SCANS_PER_BLOCK for block in blocks)
    assert all(block.count < SCANS_PER_BLOCK // 2 for block in blocks[:1])


def test_poses_about_scans_are_known_once_those_after_them_are() -> None:
    whole, scans_ns = poses(60), PERIOD_NS * np.arange(20, 25)
    registered = RunPoses(whole, whole, np.zeros(2)).known.around(scans_ns)
    assert registered is not None
    for count in range(1, 61):
        known = KnownPoses(whole.stamp_ns[:count].tolist(), whole.part(0, count).part, np.zeros(2))
        around = known.around(scans_ns)
        # A second after the last scan, and the pose after that.
        assert (around is not None) == (count >= 36)
        if around is not None:
            np.testing.assert_array_equal(around.stamp_ns, registered.stamp_ns)
    ended = KnownPoses(whole.stamp_ns[:30], whole.part(0, 30).part, np.zeros(2), complete=True)
    last = ended.around(scans_ns)
    assert last is not None
    assert last.stamp_ns[-1] == PERIOD_NS * 29
    assert ended.base_height_m == 0.5


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "format": "bag", "duration_s": 7.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


def finished(cache: Path, *words: object) -> None:
    done = ffmap_here(with_cache(cache), "run", *words)
    assert done.returncode == 0, done.stderr


def results(out: Path) -> tuple[str, bytes, bytes]:
    record = json.loads((out / "run.json").read_text())
    assert record["outcome"] == "complete"
    return record["labels_digest"], (out / "map.pgm").read_bytes(), (out / "trajectory.tum").read_bytes()


def recorded_walls(out: Path) -> dict[int, float]:
    """The number of returns on walls in each scan, as the recording has it."""
    return {row["scan"]: row["scalars"][0] for row in rows(out / "recording.rrd", f"{entities.LABEL_COUNTS}/wall")}


@pytest.fixture(scope="module")
def whole(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "whole"
    finished(out.parent / "cold", bag, "--out", out, *EARLY)
    return out


def test_a_cached_odometry_and_a_single_worker_give_the_same(bag: Path, whole: Path, tmp_path: Path) -> None:
    finished(whole.parent / "cold", bag, "--out", tmp_path / "cached", *EARLY)
    finished(tmp_path / "cold", bag, "--out", tmp_path / "alone", "--workers", 1, "--detail", "map", *EARLY)
    assert results(tmp_path / "cached") == results(tmp_path / "alone") == results(whole)
    assert json.loads((tmp_path / "cached" / "run.json").read_text())["odometry_cached"]
    # A recording of the map alone has the scans' metrics too.
    assert recorded_walls(tmp_path / "alone") == recorded_walls(whole)


def test_a_run_that_is_killed_while_scans_are_registered_goes_on_to_the_same(
    bag: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "killed"
    first_block = out / "spool" / "00000.arrow"
    kill_once(with_cache(tmp_path / "cold"), first_block.exists, "run", bag, "--out", out, *EARLY)
    finished(tmp_path / "cold", "--resume", out)
    assert results(out) == results(whole)
    assert recorded_walls(out) == recorded_walls(whole)
    counts = json.loads((out / "run.json").read_text())["counts"]
    assert len(recorded_walls(out)) == counts["scans"] > SCANS_PER_BLOCK
    assert sum(recorded_walls(out).values()) == counts["returns"]["wall"]
