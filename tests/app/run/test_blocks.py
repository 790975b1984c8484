"""Blocks of scans, labelled one after another by a process that works on several runs, as a cluster's worker does."""

from pathlib import Path

import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.halo import Halo
from ffmap.app.run import spool
from ffmap.app.run.arrays import pack
from ffmap.app.run.blocks import LabelJob, holds_clouds_of, label_block, split_blocks
from ffmap.app.setup.inputs import InputOptions, find_inputs
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.truth import read_truth


def reads_its_bag(bag: Path, run: str, block: Path) -> bool:
    """Whether the worker of a run labels the very clouds that its bag holds."""
    inputs = find_inputs(BagPath((bag,)), InputOptions())
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
