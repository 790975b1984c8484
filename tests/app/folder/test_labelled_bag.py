"""The labelled bag, read back with rosbags and beside its source."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.labelled_bag import write_labelled_bag
from ffmap.app.folder.labels_file import ScanLabels
from ffmap.app.setup.inputs import Inputs, Sensor
from ffmap.loaders.bag import open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.frames import StaticTransform, edges_of
from ffmap.loaders.rig import Rig
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, sweep, write_bag

CONTAINERS = ["in.bag", "in_mcap", "in_sqlite3"]
SIZE = 1440
T_BASE_LIDAR = transforms.from_yaw(0.5, [0.1, 0.2, 0.3])
RIG = Rig("base", None, (), (StaticTransform("base", "lidar", T_BASE_LIDAR),), ())


def make_bag(path: Path, count: int = 4) -> Path:
    version = 1 if path.suffix == ".bag" else 2
    entries = []
    for i in range(count):
        points = sweep(seed=i)
        points["x"][:7] = np.nan
        stamp_ns = START_NS + i * PERIOD_NS
        entries.append(("/vertical", stamp_ns + 5, cloud(points, stamp_ns, ros_version=version)))
    return write_bag(path, entries)


def inputs_of(path: Path, topics: Sequence[str] = ("/vertical",), rig: Rig = RIG) -> Inputs:
    with open_bag(path) as bag:
        lidar: Any = None  # not needed to copy clouds
        sensors = tuple(Sensor(lidar, index_clouds(bag, topic)) for topic in topics)
        return Inputs(BagPath((path,)), bag.container, rig, None, sensors, ())


def drive(count: int = 4) -> Trajectory:
    stamps = START_NS + PERIOD_NS * np.arange(count)
    poses = [transforms.from_yaw(0.1 * i, [float(i), 0.0, 0.0]) for i in range(count)]
    return Trajectory(stamps, np.array(poses))


def labels_of(scan: int, label: UInt8Array, label_scan: UInt8Array) -> ScanLabels:
    return ScanLabels(scan, "/vertical", 0, label, label_scan)


def read_all(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS1_NOETIC)) as reader:
        return [
            (c.topic, time_ns, reader.deserialize(data, c.msgtype))
            for c, time_ns, data in reader.messages()
        ]


def points_of(message: Any) -> UInt8Array:
    return np.asarray(message.data).reshape(message.height * message.width, message.point_step)


@pytest.mark.parametrize("name", CONTAINERS)
def test_every_cloud_again_with_its_labels_and_transforms(tmp_path: Path, name: str) -> None:
    path = make_bag(tmp_path / name)
    rng = np.random.default_rng(0)
    labels = {i: rng.integers(0, 6, (2, SIZE)).astype(np.uint8) for i in (0, 1, 3)}
    rows = [labels_of(i, *own) for i, own in labels.items()]
    written = write_labelled_bag(tmp_path, inputs_of(path), drive(), rows)
    assert written.name == ("labelled.bag" if name == "in.bag" else "labelled")
    assert not list(tmp_path.glob("*.part"))
    if name != "in.bag":
        suffix = ".mcap" if "mcap" in name else ".db3"
        assert sorted(p.name for p in written.iterdir()) == [f"labelled{suffix}", "metadata.yaml"]

    before = [m for topic, _, m in read_all(path) if topic == "/vertical"]
    after = read_all(written)
    clouds = [(t, m) for topic, t, m in after if topic == "/vertical"]
    assert [t for t, _ in clouds] == [START_NS + 5 + i * PERIOD_NS for i in range(4)]
    for i, (old, (_, new)) in enumerate(zip(before, clouds, strict=True)):
        assert (new.header.stamp, new.header.frame_id) == (old.header.stamp, "lidar")
        names = [field.name for field in new.fields]
        assert names == [*(field.name for field in old.fields), "label", "label_scan"]
        assert (new.fields[-2].offset, new.fields[-1].offset, new.point_step) == (22, 23, 24)
        points = points_of(new)
        np.testing.assert_array_equal(points[:, :22], points_of(old))
        expected = labels.get(i, np.full((2, SIZE), 255))
        np.testing.assert_array_equal(points[:, 22:].T, expected)

    (static,) = [m for topic, _, m in after if topic == "/tf_static"]
    (edge,) = edges_of(static)
    assert (edge.parent, edge.child) == ("base", "lidar")
    np.testing.assert_allclose(edge.T_parent_child, T_BASE_LIDAR, atol=1e-12)
    poses = [edge for topic, _, m in after if topic == "/tf" for edge in edges_of(m)]
    assert [(edge.parent, edge.child) for edge in poses] == [("map", "base")] * 4
    T = np.array([edge.T_parent_child for edge in poses])
    np.testing.assert_allclose(T, drive().T_map_base, atol=1e-12)


@pytest.mark.parametrize("name", CONTAINERS)
def test_two_lidars_that_fire_together_have_a_topic_each_and_one_pose(
    tmp_path: Path, name: str
) -> None:
    version = 1 if name == "in.bag" else 2
    entries = []
    for i in range(3):
        stamp_ns = START_NS + i * PERIOD_NS
        for place, topic in enumerate(("/b", "/a")):
            message = cloud(sweep(seed=10 * place + i), stamp_ns, ros_version=version)
            entries.append((topic, stamp_ns + 5 + place, message))
    path = write_bag(tmp_path / name, entries)
    # Of equal stamps the name decides: even numbers are of /a.
    rows = [
        labels_of(scan, np.full(SIZE, scan, np.uint8), np.full(SIZE, 3, np.uint8))
        for scan in range(6)
    ]
    written = write_labelled_bag(tmp_path, inputs_of(path, ("/b", "/a")), drive(3), rows)
    messages = read_all(written)
    for topic, expected in (("/a", [0, 2, 4]), ("/b", [1, 3, 5])):
        own = [points_of(m) for name, _, m in messages if name == topic]
        assert [set(points[:, 22].tolist()) for points in own] == [{scan} for scan in expected]
        before = [points_of(m) for name, _, m in read_all(path) if name == topic]
        for points, old in zip(own, before, strict=True):
            np.testing.assert_array_equal(points[:, :22], old)
    assert len([m for topic, _, m in messages if topic == "/tf"]) == 3


def test_the_base_is_the_topmost_frame(tmp_path: Path) -> None:
    T_root_base = transforms.from_yaw(0.3, [1.0, 0.0, -2.0])
    edges = (StaticTransform("root", "base", T_root_base), *RIG.static_transforms)
    inputs = inputs_of(make_bag(tmp_path / "in.bag"), rig=Rig("base", None, (), edges, ()))
    written = write_labelled_bag(tmp_path, inputs, drive(), [])
    messages = [m for topic, _, m in read_all(written) if topic == "/tf_static"]
    static = {edge.child: edge for message in messages for edge in edges_of(message)}
    assert {name: edge.parent for name, edge in static.items()} == {"root": "base", "lidar": "base"}
    np.testing.assert_allclose(static["root"].T_parent_child @ T_root_base, np.eye(4), atol=1e-9)


def test_clouds_of_rows_with_padding(tmp_path: Path) -> None:
    points = sweep().reshape(90, 16)
    path = write_bag(tmp_path / "in.bag", [("/vertical", START_NS, cloud(points, row_padding=13))])
    label = np.arange(SIZE).astype(np.uint8) % 6
    rows = [labels_of(0, label, label)]
    written = write_labelled_bag(tmp_path, inputs_of(path), drive(1), rows)
    (new,) = [m for topic, _, m in read_all(written) if topic == "/vertical"]
    assert (new.height, new.width, new.row_step) == (90, 16, 16 * 24)
    np.testing.assert_array_equal(points_of(new)[:, 22], label)
    copied = points_of(new)[:, :22].reshape(-1)
    np.testing.assert_array_equal(copied, points.reshape(-1).view(np.uint8))


def test_a_broken_cloud_stays_as_it_is_and_has_no_pose_before_its_time(tmp_path: Path) -> None:
    broken = cloud(sweep(), START_NS + PERIOD_NS)
    broken = replace(broken, data=broken.data[:100])
    entries = [
        ("/vertical", START_NS, cloud(sweep())),
        ("/vertical", START_NS + 1, broken),
        ("/vertical", START_NS + 2, cloud(sweep(), START_NS - PERIOD_NS)),
    ]
    inputs = inputs_of(write_bag(tmp_path / "in.bag", entries))
    messages = read_all(write_labelled_bag(tmp_path, inputs, drive(), []))
    clouds = [m for topic, _, m in messages if topic == "/vertical"]
    assert [m.point_step for m in clouds] == [24, 22, 24]
    assert len([m for topic, _, m in messages if topic == "/tf"]) == 2


@pytest.mark.parametrize("name", CONTAINERS)
def test_an_interrupted_or_killed_run_leaves_the_earlier_bag(tmp_path: Path, name: str) -> None:
    inputs = inputs_of(make_bag(tmp_path / name))
    ones = np.ones(SIZE, np.uint8)
    if name == "in.bag":
        (tmp_path / "labelled.bag.part").write_bytes(b"half")
    else:
        (tmp_path / "labelled.part" / "labelled").mkdir(parents=True)
        (tmp_path / "labelled.part" / "labelled" / "metadata.yaml").write_text("half")
    written = write_labelled_bag(tmp_path, inputs, drive(), [])
    assert len(read_all(written)) == 9

    def failing() -> Iterator[ScanLabels]:
        yield labels_of(0, ones, ones)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_labelled_bag(tmp_path, inputs, drive(), failing())
    assert not list(tmp_path.glob("*.part"))
    assert len(read_all(written)) == 9
    write_labelled_bag(tmp_path, inputs, drive(), [labels_of(0, ones, ones)])
    assert points_of(read_all(written)[2][2])[0, 22] == 1
