"""The labelled bag, read back with rosbags and beside its source."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.app.folder.labelled_bag import write_labelled_bag
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.frames import StaticTransform, edges_of
from ffmap.loaders.rig import Rig
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, sweep, write_bag

CONTAINERS = ["in.bag", "in_mcap", "in_sqlite3"]
T_BASE_LIDAR = transforms.from_yaw(0.5, [0.1, 0.2, 0.3])
RIG = Rig("base", None, (), (StaticTransform("base", "lidar", T_BASE_LIDAR),), ())


def make_bag(path: Path, count: int = 4, **cloud_options: Any) -> Path:
    version = 1 if path.suffix == ".bag" else 2
    entries = []
    for i in range(count):
        points = sweep(seed=i)
        points["x"][:7] = np.nan
        stamp_ns = START_NS + i * PERIOD_NS
        entries.append(("/vertical", stamp_ns + 5, cloud(points, stamp_ns, ros_version=version, **cloud_options)))
    return write_bag(path, entries)


def drive(count: int = 4) -> Trajectory:
    stamps = START_NS + PERIOD_NS * np.arange(count)
    return Trajectory(stamps, np.array([transforms.from_yaw(0.1 * i, [float(i), 0.0, 0.0]) for i in range(count)]))


def read_all(path: Path) -> list[tuple[str, int, Any]]:
    store = get_typestore(Stores.ROS1_NOETIC)
    with AnyReader([path], default_typestore=store) as reader:
        return [(c.topic, t, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages()]


def points_of(message: Any) -> np.ndarray:
    return np.asarray(message.data).reshape(message.height * message.width, message.point_step)


class TestLabelledBag:
    @pytest.mark.parametrize("name", CONTAINERS)
    def test_every_cloud_again_with_its_labels(self, tmp_path: Path, name: str):
        path = make_bag(tmp_path / name)
        generator = np.random.default_rng(0)
        labels = [(i, *generator.integers(0, 6, (2, 1440)).astype(np.uint8)) for i in (0, 1, 3)]
        with open_bag(path) as bag:
            index = index_clouds(bag, "/vertical")
            written = write_labelled_bag(tmp_path, [bag], [index], RIG, drive(), iter(labels))
        assert written.name == ("labelled.bag" if name == "in.bag" else "labelled")
        assert not list(tmp_path.glob("*.part"))
        if name != "in.bag":
            suffix = ".mcap" if "mcap" in name else ".db3"
            assert sorted(p.name for p in written.iterdir()) == [f"labelled{suffix}", "metadata.yaml"]

        before = [m for topic, _, m in read_all(path) if topic == "/vertical"]
        after = read_all(written)
        clouds = [(t, m) for topic, t, m in after if topic == "/vertical"]
        assert [t for t, _ in clouds] == [START_NS + 5 + i * PERIOD_NS for i in range(4)]
        expected = {i: (label, label_scan) for i, label, label_scan in labels}
        for i, (old, (_, new)) in enumerate(zip(before, clouds, strict=True)):
            assert (new.header.stamp, new.header.frame_id) == (old.header.stamp, "lidar")
            assert [f.name for f in new.fields] == [*(f.name for f in old.fields), "label", "label_scan"]
            assert (new.fields[-2].offset, new.fields[-1].offset, new.point_step) == (22, 23, 24)
            points = points_of(new)
            np.testing.assert_array_equal(points[:, :22], points_of(old))
            label, label_scan = expected.get(i, (np.full(1440, 255), np.full(1440, 255)))
            np.testing.assert_array_equal(points[:, 22], label)
            np.testing.assert_array_equal(points[:, 23], label_scan)

    @pytest.mark.parametrize("name", CONTAINERS)
    def test_two_lidars_that_fire_together_have_a_topic_each_and_one_pose(self, tmp_path: Path, name: str):
        version = 1 if name == "in.bag" else 2
        entries = []
        for i in range(3):
            stamp_ns = START_NS + i * PERIOD_NS
            for place, topic in enumerate(("/b", "/a")):
                message = cloud(sweep(seed=10 * place + i), stamp_ns, ros_version=version)
                entries.append((topic, stamp_ns + 5 + place, message))
        path = write_bag(tmp_path / name, entries)
        # Of equal stamps the name decides: even numbers are of /a.
        labels = [(scan, np.full(1440, scan, np.uint8), np.full(1440, 3, np.uint8)) for scan in range(6)]
        with open_bag(path) as first, open_bag(path) as second:
            indices = [index_clouds(first, "/b"), index_clouds(first, "/a")]
            written = write_labelled_bag(tmp_path, [first, second], indices, RIG, drive(3), iter(labels))
        messages = read_all(written)
        for topic, expected in (("/a", [0, 2, 4]), ("/b", [1, 3, 5])):
            own = [points_of(m) for name, _, m in messages if name == topic]
            assert [set(points[:, 22].tolist()) for points in own] == [{scan} for scan in expected]
            before = [points_of(m) for name, _, m in read_all(path) if name == topic]
            for points, old in zip(own, before, strict=True):
                np.testing.assert_array_equal(points[:, :22], old)
        assert len([m for topic, _, m in messages if topic == "/tf"]) == 3

    def test_the_base_is_the_topmost_frame(self, tmp_path: Path):
        T_root_base = transforms.from_yaw(0.3, [1.0, 0.0, -2.0])
        edges = (StaticTransform("root", "base", T_root_base), *RIG.static_transforms)
        with open_bag(make_bag(tmp_path / "in.bag")) as bag:
            rig = Rig("base", None, (), edges, ())
            written = write_labelled_bag(tmp_path, [bag], [index_clouds(bag, "/vertical")], rig, drive(), [])
        static = {e.child: e for topic, _, m in read_all(written) if topic == "/tf_static" for e in edges_of(m)}
        assert {child: edge.parent for child, edge in static.items()} == {"root": "base", "lidar": "base"}
        np.testing.assert_allclose(static["root"].T_parent_child @ T_root_base, np.eye(4), atol=1e-9)

    @pytest.mark.parametrize("name", CONTAINERS)
    def test_transforms(self, tmp_path: Path, name: str):
        with open_bag(make_bag(tmp_path / name)) as bag:
            written = write_labelled_bag(tmp_path, [bag], [index_clouds(bag, "/vertical")], RIG, drive(), [])
        messages = read_all(written)
        (static,) = [m for topic, _, m in messages if topic == "/tf_static"]
        mount = static.transforms[0]
        assert (mount.header.frame_id, mount.child_frame_id) == ("base", "lidar")
        q, t = mount.transform.rotation, mount.transform.translation
        np.testing.assert_allclose(
            transforms.from_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]), T_BASE_LIDAR, atol=1e-12
        )
        poses = [m.transforms[0] for topic, _, m in messages if topic == "/tf"]
        assert [(p.header.frame_id, p.child_frame_id) for p in poses] == [("map", "base")] * 4
        np.testing.assert_allclose([p.transform.translation.x for p in poses], [0, 1, 2, 3], atol=1e-12)
        np.testing.assert_allclose([p.transform.rotation.z for p in poses], np.sin(0.05 * np.arange(4)), atol=1e-12)
        assert poses[2].header.stamp.nanosec == 200_000_000

    def test_clouds_of_rows_with_padding(self, tmp_path: Path):
        points = sweep().reshape(90, 16)
        path = write_bag(tmp_path / "in.bag", [("/vertical", START_NS, cloud(points, row_padding=13))])
        label = np.arange(1440).astype(np.uint8) % 6
        with open_bag(path) as bag:
            index = index_clouds(bag, "/vertical")
            written = write_labelled_bag(tmp_path, [bag], [index], RIG, drive(1), [(0, label, label)])
        (new,) = [m for topic, _, m in read_all(written) if topic == "/vertical"]
        assert (new.height, new.width, new.row_step) == (90, 16, 16 * 24)
        np.testing.assert_array_equal(points_of(new)[:, 22], label)
        np.testing.assert_array_equal(points_of(new)[:, :22].reshape(-1), points.reshape(-1).view(np.uint8))

    def test_a_broken_cloud_stays_as_it_is_and_has_no_pose_before_its_time(self, tmp_path: Path):
        broken = cloud(sweep(), START_NS + PERIOD_NS)
        broken = replace(broken, data=broken.data[:100])
        entries = [
            ("/vertical", START_NS, cloud(sweep())),
            ("/vertical", START_NS + 1, broken),
            ("/vertical", START_NS + 2, cloud(sweep(), START_NS - PERIOD_NS)),
        ]
        with open_bag(write_bag(tmp_path / "in.bag", entries)) as bag:
            written = write_labelled_bag(tmp_path, [bag], [index_clouds(bag, "/vertical")], RIG, drive(), [])
        messages = read_all(written)
        clouds = [m for topic, _, m in messages if topic == "/vertical"]
        assert [m.point_step for m in clouds] == [24, 22, 24]
        assert len([m for topic, _, m in messages if topic == "/tf"]) == 2

    @pytest.mark.parametrize("name", CONTAINERS)
    def test_what_was_there_stays_until_the_new_one_is_complete(self, tmp_path: Path, name: str):
        bag = open_bag(make_bag(tmp_path / name))
        index = index_clouds(bag, "/vertical")
        written = write_labelled_bag(tmp_path, [bag], [index], RIG, drive(), [])

        def failing():
            yield 0, np.zeros(1440, np.uint8), np.zeros(1440, np.uint8)
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            write_labelled_bag(tmp_path, [bag], [index], RIG, drive(), failing())
        assert not list(tmp_path.glob("*.part"))
        assert len(read_all(written)) == 9
        write_labelled_bag(tmp_path, [bag], [index], RIG, drive(), [(0, np.ones(1440, np.uint8), np.ones(1440, np.uint8))])
        assert points_of(read_all(written)[2][2])[0, 22] == 1

    @pytest.mark.parametrize("name", CONTAINERS)
    def test_what_a_killed_run_left_is_no_hindrance(self, tmp_path: Path, name: str):
        if name == "in.bag":
            (tmp_path / "labelled.bag.part").write_bytes(b"half")
        else:
            (tmp_path / "labelled.part" / "labelled").mkdir(parents=True)
            (tmp_path / "labelled.part" / "labelled" / "metadata.yaml").write_text("half")
        with open_bag(make_bag(tmp_path / name)) as bag:
            written = write_labelled_bag(tmp_path, [bag], [index_clouds(bag, "/vertical")], RIG, drive(), [])
        assert len(read_all(written)) == 9
        assert not list(tmp_path.glob("*.part"))

    def test_labels_out_of_order_are_refused(self, tmp_path: Path):
        label = np.zeros(1440, np.uint8)
        with open_bag(make_bag(tmp_path / "in.bag")) as bag:
            index = index_clouds(bag, "/vertical")
            with pytest.raises(ValueError, match="out of order"):
                write_labelled_bag(tmp_path, [bag], [index], RIG, drive(), [(1, label, label), (0, label, label)])
