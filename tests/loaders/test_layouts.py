"""Built-in rigs, and simulated bags with their layouts: each rig is chosen for its own bag only."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from ffmap.algorithms.base.scan import Scan
from ffmap.app.commands.simulate import simulate as simulate_command
from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.rig_file import built_in_path, built_in_rigs, rig_path
from ffmap.loaders.scans import read_scans
from ffmap.loaders.simulator import LAYOUTS, SimulationSettings, simulate
from ffmap.loaders.truth import TruthClasses, read_truth
from tests.loaders.bag_builder import START_NS, tf_message, write_bag

RIGS = {rig.name: rig for rig in built_in_rigs()}
OUSTER = "x0:7 y4:7 z8:7 intensity16:7 t20:6 reflectivity24:4 ring26:2 noise28:4 range32:6"
FIELDS = {
    "mars": ("x0:7 y4:7 z8:7 intensity12:7 ring16:4 time18:7", 22),
    "backpack_3d": ("x0:7 y4:7 z8:7", 16),
    "ntu_viral": (OUSTER, 48),
    "newer_college": (OUSTER, 48),
    "oxford_spires": ("x0:7 y4:7 z8:7 intensity16:7 timestamp24:8 ring32:4", 48),
    "hilti_2022": ("x0:7 y4:7 z8:7 intensity16:7 timestamp24:8 ring32:4", 48),
}
RINGS = dict(zip(FIELDS, (32, 16, 16, 128, 64, 32), strict=True))


def small(layout: str) -> SimulationSettings:
    return SimulationSettings(building="small", seed=1, duration_s=0.75, layout=layout)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("layouts")
    for name in LAYOUTS:
        simulate(folder / f"{name}.bag", small(name))
    return {name: folder / f"{name}.bag" for name in LAYOUTS}


def test_every_layout_has_its_rig_with_its_source() -> None:
    assert set(RIGS) == set(LAYOUTS)
    for rig in RIGS.values():
        assert rig.source
        assert "# Unconfirmed:" in rig.path.read_text()
        for lidar in rig.lidars:
            assert lidar.topic
            assert lidar.frame
            assert lidar.T_base_sensor is not None


@pytest.mark.parametrize("name", LAYOUTS)
def test_each_layout_has_its_topics_fields_rig_and_truth(name: str, bags: dict[str, Path]) -> None:
    entries = RIGS[name].lidars
    with open_bag(bags[name]) as bag:
        truth_topics = {"/truth/pose", "/truth/classes", "/truth/building"}
        lidars = {entry.topic for entry in entries}
        assert bag.topics.keys() - truth_topics == lidars | set(RIGS[name].with_topics)
        rig, truth = find_rig(bag), read_truth(bag)
        assert rig.mounts_from == f"the built-in rig {name}"
        assert any(RIGS[name].description in warning for warning in rig.warnings)
        assert rig.base_frame == RIGS[name].base
        found = {own.topic: own for own in (rig.horizontal, *rig.verticals) if own is not None}
        assert found.keys() == {entry.topic for entry in entries}
        for entry in entries:
            own, topic = found[entry.topic or ""], entry.topic or ""
            assert own.frame_id == entry.frame
            np.testing.assert_array_equal(own.T_base_sensor, entry.T_base_sensor)
            cloud = bag.deserialize(next(bag.messages([topic])))
            fields = " ".join(f"{f.name}{f.offset}:{f.datatype}" for f in cloud.fields)
            assert (fields, cloud.point_step) == FIELDS[name]
        assert (rig.vertical is None) == (name == "hilti_2022")
        assert truth is not None
        assert truth.trajectory is not None
        height_m = truth.trajectory.T_map_base[0, 2, 3]
        assert height_m == pytest.approx(LAYOUTS[name].base_height_m, abs=0.01)
        lidar = rig.vertical or rig.horizontal
        assert lidar is not None
        assert lidar.decoding.timed
        assert lidar.ring_count == RINGS[name]
        index = lidar.index(bag)
        true_classes = TruthClasses(bag, truth.classes[lidar.frame_id])
        for _, scan in read_scans(bag, index, 0, len(index) - 1, lidar.decoding):
            assert isinstance(scan, Scan)
            classes = true_classes.at(scan.stamp_ns, scan.cloud_size)
            assert classes is not None
            assert len(classes) == scan.cloud_size
            assert classes[scan.cloud_index].max() <= 10
        if name == "backpack_3d":
            assert np.median(index.message_count) == 75
            assert index.period_ns == pytest.approx(0.05e9, rel=0.01)
        if name == "mars":  # Roles follow the extrinsics, not the names
            assert rig.horizontal is not None
            assert rig.horizontal.frame_id == "vertical_velodyne"


def test_no_rig_is_chosen_for_a_plain_bag(tmp_path: Path) -> None:
    settings = SimulationSettings(building="small", duration_s=0.5, sensor="os1-16")
    simulate(tmp_path / "plain.bag", settings)
    with open_bag(tmp_path / "plain.bag") as bag:
        rig = find_rig(bag)
    assert rig.mounts_from == "the bag's transforms"
    assert not any("built-in" in warning for warning in rig.warnings)


def rewritten(source: Path, path: Path, without: str = "", frames: tuple[str, ...] = ()) -> Path:
    """Write the bag again without a topic, or with transforms of some frames."""
    with AnyReader([source]) as reader:
        kept = [c for c in reader.connections if c.topic != without]
        entries = [
            (c.topic, t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages(kept)
        ]
    if frames:
        turns = ([0.0, 0.0, 0.0, 1.0], [0.5, 0.5, 0.5, 0.5])
        edges = [("robot", own, [0.0] * 3, turn) for own, turn in zip(frames, turns, strict=True)]
        entries.append(("/tf_static", START_NS, tf_message(edges)))
    return write_bag(path, sorted(entries, key=lambda entry: entry[1]))


def test_the_bags_own_transforms_take_precedence(bags: dict[str, Path], tmp_path: Path) -> None:
    frames = ("sensor1/os_sensor", "sensor2/os_sensor")
    with open_bag(rewritten(bags["ntu_viral"], tmp_path / "own.bag", frames=frames)) as bag:
        rig = find_rig(bag)
        assert (rig.base_frame, rig.mounts_from) == ("robot", "the bag's transforms")
        named = find_rig(bag, rig_path(Path("ntu_viral")))
        assert (named.base_frame, named.mounts_from) == ("imu", "the built-in rig ntu_viral")


def test_names_that_many_bags_have_are_not_enough(bags: dict[str, Path], tmp_path: Path) -> None:
    imu = "/alphasense_driver_ros/imu"
    with open_bag(rewritten(bags["newer_college"], tmp_path / "strange.bag", imu)) as bag:
        assert find_rig(bag).mounts_from == "nothing: the only lidar is the base"
    odometry = "/odometry/filtered"
    with open_bag(rewritten(bags["mars"], tmp_path / "mars.bag", odometry)) as bag:
        with pytest.raises(InputError, match="--rig mars"):
            find_rig(bag)
        assert find_rig(bag, rig_path(Path("mars"))).vertical is not None


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean mars"):
        rig_path(Path("marss"))
    with pytest.raises(InputError, match="layout = 'mar': Input should be 'plain', 'mars'"):
        simulate_command(tmp_path / "a.bag", {"layout": "mar"})
    with pytest.raises(InputError, match="layout mars decides sensor itself"):
        simulate_command(tmp_path / "a.bag", {"layout": "mars", "sensor": "vlp16"})
    assert not list(tmp_path.iterdir())


def test_a_file_takes_precedence_over_a_built_in_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert rig_path(Path("mars")) == built_in_path("mars")
    Path("mars").write_text(built_in_path("mars").read_text())
    assert rig_path(Path("mars")) == Path("mars")
