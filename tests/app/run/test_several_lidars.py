"""Bags of several lidars, from end to end: each is labelled as if it were alone."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.record import RunRecord
from ffmap.app.record.read_back import rows
from ffmap.app.run.arrays import map_arrays, unpack_rows
from ffmap.app.run.blocks import LabelledScan, label_block
from ffmap.app.run.extrinsics import check_extrinsics
from ffmap.app.setup.inputs import find_inputs
from ffmap.app.setup.options import RunOptions
from ffmap.app.setup.settings import load_settings
from ffmap.blueprints import entities
from ffmap.loaders.bag import open_bag
from ffmap.loaders.rig import MountCorrection
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.trajectory_file import read_tum
from ffmap.loaders.truth import read_truth
from tests.app.run.test_scans import block_of
from tests.program import ffmap_here, with_cache

LEFT, RIGHT, UPRIGHT = (
    f"/{place}_velodyne/velodyne_points" for place in ("left", "right", "horizontal")
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive with three lidars, and a run of it: all outputs, two workers."""
    path = tmp_path_factory.mktemp("three")
    settings = SimulationSettings(
        building="small", seed=3, duration_s=3.0, sensor="vlp16", lidars="three", format="mcap"
    )
    simulate(path / "drive", settings)
    outputs = ("--outputs", "recording,labelled-bag,labels,maps,geojson")
    run(path, path / "drive", *outputs)
    return path


def run(folder: Path, bag: Path, *words: object) -> None:
    """Run on a bag into the folder `run`."""
    environment = with_cache(folder / "cache")
    done = ffmap_here(environment, "run", bag, "--out", folder / "run", *words)
    assert done.returncode == 0, done.stderr


def clouds_of(bag: Path) -> Counter[str]:
    with open_bag(bag) as opened:
        return Counter({name: topic.count for name, topic in opened.topics.items() if topic.count})


def test_all_that_lie_are_labelled_and_vote_together(folder: Path) -> None:
    record = open_run(folder / "run").record
    counts = record.counts
    assert record.rig["horizontal"].topic == UPRIGHT
    assert set(record.topics) == {LEFT, RIGHT}
    driven = clouds_of(folder / "drive")
    assert counts["clouds"] == driven[LEFT] + driven[RIGHT]
    assert counts["scans"] == sum(counts["scans_by_topic"].values()) > 0.9 * counts["clouds"]
    labelled = clouds_of(folder / "run" / "labelled")
    assert (labelled[LEFT], labelled[RIGHT]) == (driven[LEFT], driven[RIGHT])
    assert len(read_tum(folder / "run" / "trajectory.tum")) == counts["scans"]
    metrics = json.loads((folder / "run" / "metrics.json").read_text())
    assert metrics["scans.counted"] == counts["scans"]
    assert metrics["scans.skipped"] == 0
    assert metrics["scans.without_truth"] == counts["clouds"] - counts["scans"]
    for label, least in (("wall", 0.97), ("floor", 0.98), ("ceiling", 0.98)):
        assert metrics[f"{label}.f1"] > least, label


def test_the_recording_tells_which_lidar_each_scan_is_from(folder: Path) -> None:
    inputs = find_inputs(folder / "drive", RunOptions())
    topics = open_run(folder / "run").record.topics
    path = folder / "run" / "recording.rrd"
    said = {row.scan: row.values for row in rows(path, "/scan/lidar", "place")}
    drawn = {row.scan for row in rows(path, entities.POINTS, entities.POINT_LABEL_SCAN)}
    assert said.keys() == drawn
    for scan, values in said.items():
        place = int(inputs.scans.lidar[scan])
        assert int(values["place"][0]) == place
        assert topics[place] in str(values["text"][0])
    assert {int(values["place"][0]) for values in said.values()} == {0, 1}


def labels_of(inputs_of: RunOptions, folder: Path, name: str) -> dict[tuple[str, int], UInt8Array]:
    """The scans' own labels by topic and stamp, at the true poses."""
    inputs = find_inputs(folder / "drive", inputs_of)
    found: dict[tuple[str, int], UInt8Array] = {}
    block = block_of(inputs, folder / name, count=len(inputs.scans))
    label_block(block)
    for scan in unpack_rows(LabelledScan, map_arrays(block.labelled)):
        topic = inputs.verticals[inputs.scans.lidar[scan.scan]].lidar.topic
        found[topic, scan.stamp_ns] = scan.label_cloud
    return found


def test_a_lidars_scans_are_labelled_as_if_it_were_alone(folder: Path) -> None:
    together = labels_of(RunOptions(), folder, "together")
    assert {topic for topic, _ in together} == {LEFT, RIGHT}
    for topic in (LEFT, RIGHT):
        alone = labels_of(RunOptions(vertical=(topic,)), folder, topic.split("_")[0][1:])
        of_topic = {key: labels for key, labels in together.items() if key[0] == topic}
        assert alone.keys() == of_topic.keys()
        assert len(alone) > 20
        for key, labels in alone.items():
            np.testing.assert_array_equal(of_topic[key], labels)


def test_a_scan_is_labelled_again_bit_for_bit(folder: Path) -> None:
    inputs = find_inputs(folder / "drive", RunOptions())
    # The last but one of the second lidar.
    scan = int(np.flatnonzero(inputs.scans.lidar == 1)[-2])
    words = ("inspect", folder / "run", "--scan", scan, "--out", folder / "scan.rrd")
    done = ffmap_here(with_cache(folder / "cache"), *words)
    assert done.returncode == 0, done.stderr
    topic = inputs.verticals[inputs.scans.lidar[scan]].lidar.topic
    assert f"Scan {scan} is cloud {inputs.scans.cloud[scan]} of {topic}." in done.stdout
    assert "labels equal label_scan in labels.parquet" in done.stdout


def test_only_the_mount_that_is_off_is_refined(folder: Path) -> None:
    settings = load_settings(None, [])
    inputs = find_inputs(folder / "drive", RunOptions())
    with open_bag(inputs.bag_path) as bag:
        truth = read_truth(bag)
    assert truth is not None
    assert truth.trajectory is not None
    (left,) = (sensor.lidar for sensor in inputs.verticals if sensor.lidar.topic == LEFT)
    T_off = left.T_base_sensor @ transforms.from_twist(np.array([0.0, 0.02, 0.03, 0.05, 0.0, 0.04]))
    off = inputs.with_mounts([MountCorrection(LEFT, tuple(map(tuple, T_off.tolist())), 0)])
    mounts = {mount.topic: mount for mount in check_extrinsics(off, truth.trajectory, settings)}
    assert {topic: mount.is_off for topic, mount in mounts.items()} == {LEFT: True, RIGHT: False}
    assert f"the extrinsics of {LEFT} " in mounts[LEFT].warning("")
    entries = {topic: mount.entry for topic, mount in mounts.items()}
    (correction,) = RunRecord(mounts=entries).mount_corrections
    assert correction.topic == LEFT
    np.testing.assert_allclose(correction.T_base_sensor, mounts[LEFT].found.T_base_sensor)


def test_two_upright_lidars_that_open_wide_are_labelled_both(tmp_path: Path) -> None:
    settings = SimulationSettings(
        building="small", seed=3, duration_s=1.0, sensor="os0-128", lidars="upright"
    )
    simulate(tmp_path / "drive.bag", settings)
    words = ("--trajectory", "/truth/pose", "--outputs", "labels,maps")
    run(tmp_path, tmp_path / "drive.bag", *words)
    driven = clouds_of(tmp_path / "drive.bag")
    topics = ["/front_ouster/points", "/rear_ouster/points"]
    assert [driven["/truth/classes"], driven["/truth/classes_2"]] == [
        driven[topic] for topic in topics
    ]
    assert sorted(open_run(tmp_path / "run").record.topics) == topics
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["scans.without_truth"] == 0
    assert metrics["wall.f1"] > 0.95
