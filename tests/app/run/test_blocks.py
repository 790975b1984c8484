"""Blocks of scans, labelled one after another by a process that works on several runs, as a cluster's worker does."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.halo import Halo
from ffmap.app.record.read_back import rows
from ffmap.app.run import blocks, spool
from ffmap.app.run.arrays import pack
from ffmap.app.run.blocks import LabelJob, holds_clouds_of, label_block, split_blocks
from ffmap.app.setup.inputs import check_failed, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings
from ffmap.blueprints import entities
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.truth import read_truth


def reads_its_bag(bag: Path, run: str, block: Path) -> bool:
    """Whether the worker of a run labels the very clouds that its bag holds."""
    inputs = find_inputs(BagPath((bag,)), RunOptions())
    (first, *_) = split_blocks(len(inputs.scans))
    with open_bag(inputs.bag_path) as opened:
        truth = read_truth(opened)
        assert truth is not None
        assert truth.trajectory is not None
        label_block(LabelJob(first, inputs, truth.trajectory, 0.0, np.zeros(2), Settings(), run, None, block))
        return holds_clouds_of(block.with_suffix(".arrow"), first, inputs, opened)


def test_a_run_reads_its_own_bag_where_another_runs_lay(tmp_path: Path) -> None:
    bags = [tmp_path / name for name in ("first.bag", "second.bag")]
    for seed, bag in enumerate(bags):
        simulate(bag, SimulationSettings(building="small", seed=seed, sensor="vlp16", duration_s=1.0))
    assert reads_its_bag(bags[0], "first", tmp_path / "first")
    bags[1].replace(bags[0])
    assert reads_its_bag(bags[0], "second", tmp_path / "second")


def test_a_run_reads_its_own_halo_where_another_runs_lay(tmp_path: Path) -> None:
    file = tmp_path / "halo.arrow"
    for run, key in (("first", 3), ("second", 7)):
        spool.save(file, pack(Halo(np.array([key]), np.array([Label.WALL], np.uint8), 0.1)))
        for _ in range(2):
            assert spool.load_halo(file, run).keys.tolist() == [key]


def failing(function: Any, calls: set[int], error: Exception) -> Any:
    """A function that does its work and then raises an error, in some of its calls."""
    made = iter(range(1000))

    def called(*values: Any, **named: Any) -> Any:
        answer = function(*values, **named)
        if next(made) in calls:
            raise error
        return answer

    return called


def test_a_scan_that_fails_midway_leaves_nothing_in_its_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = tmp_path / "a.bag"
    simulate(bag, SimulationSettings(building="small", sensor="vlp16", duration_s=1.0))
    inputs = find_inputs(BagPath((bag,)), RunOptions())
    with open_bag(inputs.bag_path) as opened:
        truth = read_truth(opened)
    assert truth is not None
    assert truth.trajectory is not None
    (block, *_) = split_blocks(len(inputs.scans))
    sound = LabelJob(
        block, inputs, truth.trajectory, 0.0, np.zeros(2), Settings(), "a", Detail.SCANS, tmp_path / "sound"
    )
    label_block(sound)
    path = tmp_path / "failing"
    with monkeypatch.context() as patch:
        # One fails before anything of it is recorded, one when all is.
        patch.setattr(blocks, "label_scan", failing(blocks.label_scan, {0}, ValueError("no wall")))
        patch.setattr(blocks, "log_scan", failing(blocks.log_scan, {1}, IndexError("no row")))
        summary = label_block(
            LabelJob(block, inputs, truth.trajectory, 0.0, np.zeros(2), Settings(), "a", Detail.SCANS, path)
        )
    assert block.count == 4
    assert summary.scan.tolist() == [1, 3]
    assert [(s.index, s.reason) for s in summary.failed] == [(0, "ValueError: no wall"), (2, "IndexError: no row")]
    assert all("Traceback" in s.trace for s in summary.failed)
    kept, whole = ({s.scan: s for s in spool.load_scans(tmp_path / f"{name}.arrow")} for name in ("failing", "sound"))
    assert list(kept) == [1, 3]
    for scan, own in kept.items():
        np.testing.assert_array_equal(own.label_cloud, whole[scan].label_cloud)
    (features,) = spool.load_features(path.with_suffix(".arrow"))
    assert set(features.scan.tolist()) <= {1, 3}
    assert len(summary.metrics) == len(summary.beyond_range) == len(summary.milliseconds) == 2
    assert [row.scan for row in rows(path.with_suffix(".rrd"), entities.POINTS, "positions")] == [1, 3]
    monkeypatch.setattr(blocks, "label_scan", failing(blocks.label_scan, {1}, MemoryError()))
    with pytest.raises(MemoryError):
        label_block(sound)


def test_where_more_than_a_fifth_fail_the_commonest_reason_is_named() -> None:
    failed = [SkippedScan(i, 0, "ValueError: no wall" if i else "IndexError: 3", "trace") for i in range(3)]
    check_failed(BagPath((Path("a.bag"),)), failed, 15, "labelling")
    with pytest.raises(
        InputError, match=r"a.bag: labelling failed for 3 of 14 scans.* 2 times with ValueError: no wall"
    ):
        check_failed(BagPath((Path("a.bag"),)), failed, 14, "labelling")
