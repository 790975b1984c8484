"""Blocks of scans: labelled by a worker of several runs, and read again to be relabelled."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.scan.floor import heights_above_pieces
from ffmap.algorithms.scan.summary import Features
from ffmap.app.record.read_back import rows
from ffmap.app.run import blocks
from ffmap.app.run.arrays import map_arrays, pack_rows, unpack, unpack_rows, write_arrays
from ffmap.app.run.blocks import Block, LabelledScan, label_block
from ffmap.app.run.poses import RunPoses
from ffmap.app.setup.inputs import Inputs, find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.outputs import Detail
from ffmap.app.setup.settings import Settings
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.truth import read_truth
from tests.corridor import labelled

SCAN, PLACED, _, LABELLING = labelled()


def block_of(
    inputs: Inputs,
    path: Path,
    run: str = "a",
    detail: Detail | None = None,
    first: int = 0,
    count: int = 4,
) -> Block:
    """Some scans of a simulated drive, with its true poses."""
    with open_bag(inputs.bag_path) as bag:
        truth = read_truth(bag)
    assert truth is not None
    assert truth.trajectory is not None
    poses = RunPoses(truth.trajectory, truth.trajectory, 0.0, np.zeros(2))
    return Block(first, count, inputs, Settings(), poses, run, detail, path)


def drive(path: Path, **values: Any) -> Inputs:
    simulate(path, SimulationSettings(building="small", sensor="vlp16", duration_s=1.0, **values))
    return find_inputs(BagPath((path,)), RunOptions())


def labels_of(block: Block) -> dict[int, np.ndarray]:
    found = unpack_rows(LabelledScan, map_arrays(block.labelled))
    return {scan.scan: scan.label_cloud for scan in found}


def test_a_worker_reads_the_bag_of_its_run_where_another_bag_was(tmp_path: Path) -> None:
    found = []
    for run in ("first", "second"):
        inputs = drive(tmp_path / f"{run}.bag", seed=len(found))
        (tmp_path / f"{run}.bag").replace(tmp_path / "drive.bag")
        block = block_of(
            replace(inputs, bag_path=BagPath((tmp_path / "drive.bag",))), tmp_path / run, run
        )
        label_block(block)
        found.append(labels_of(block)[0])
    assert not np.array_equal(*found)


def failing(function: Callable[..., Any], calls: set[int], error: Exception) -> Callable[..., Any]:
    """A function that raises an error at the end of some of its calls."""
    made = iter(range(1000))

    def called(*values: Any, **named: Any) -> Any:
        answer = function(*values, **named)
        if next(made) in calls:
            raise error
        return answer

    return called


def test_a_scan_that_fails_midway_leaves_nothing_in_its_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sound = block_of(drive(tmp_path / "a.bag"), tmp_path / "sound", detail=Detail.SCANS)
    label_block(sound)
    block = replace(sound, path=tmp_path / "failing")
    with monkeypatch.context() as patch:
        # One fails before anything of it is recorded, one when all is.
        patch.setattr(blocks, "label_scan", failing(blocks.label_scan, {0}, ValueError("no wall")))
        patch.setattr(blocks, "log_scan", failing(blocks.log_scan, {1}, IndexError("no row")))
        done = label_block(block)
    assert [scan.scan for scan in done.scans] == [1, 3]
    assert [(s.index, s.reason) for s in done.skipped] == [
        (0, "ValueError: no wall"),
        (2, "IndexError: no row"),
    ]
    assert all("Traceback" in s.trace for s in done.skipped)
    kept, whole = labels_of(block), labels_of(sound)
    assert list(kept) == [1, 3]
    for scan, label in kept.items():
        np.testing.assert_array_equal(label, whole[scan])
    features = unpack(Features, map_arrays(block.labelled), "feature_")
    assert features.scan.tolist() == [1, 3]
    # The recording shows nothing of a scan that failed.
    assert [row.scan for row in rows(block.evidence, "/scan", "is_recursive")] == [0, 2]
    monkeypatch.setattr(blocks, "label_scan", failing(blocks.label_scan, {1}, MemoryError()))
    with pytest.raises(MemoryError):
        label_block(sound)


@pytest.mark.parametrize(
    ("order", "scale"), [("of the cloud", 1.0), ("another", 1.0), ("another", 20.0)]
)
def test_a_scan_comes_back_to_half_its_grid(tmp_path: Path, order: str, scale: float) -> None:
    generator = np.random.default_rng(0)
    # Some returned nothing.
    places = np.arange(len(SCAN)) + len(SCAN) // 10 * (np.arange(len(SCAN)) > 99)
    if order == "another":
        places = generator.permutation(places)
    scan = replace(SCAN, cloud_index=places.astype(np.int32), cloud_size=int(places.max()) + 5)
    placed = replace(PLACED, points_level=(scale * PLACED.points_level).astype(np.float32))
    written = [LabelledScan.of(number, scan, placed, LABELLING) for number in (6, 7)]
    write_arrays(tmp_path / "block.arrow", pack_rows(written))
    _, found = unpack_rows(LabelledScan, map_arrays(tmp_path / "block.arrow"))
    assert found.scan == 7
    assert (found.grid_m > 0.001) == (scale > 1.0)  # a return is farther than 32 m away
    np.testing.assert_allclose(found.points_level, placed.points_level, atol=0.51 * found.grid_m)
    np.testing.assert_array_equal(found.cloud_index, places)
    np.testing.assert_array_equal(found.label, LABELLING.label)
    assert np.count_nonzero(found.label_cloud == NO_RETURN) == scan.cloud_size - len(scan)
    np.testing.assert_array_equal(found.ceiling, LABELLING.ceiling_planes)
    np.testing.assert_array_equal(found.origin_level, placed.origin_level)
    if scale == 1.0:
        height_m = heights_above_pieces(found.points_level, found.floor, found.floor_is_foot)
        np.testing.assert_allclose(height_m, LABELLING.height_m, atol=0.001)
