"""Containers: messages come out as they were written; other files give one line."""

from pathlib import Path

import pytest

from ffmap.loaders.bag import open_bag
from ffmap.loaders.errors import InputError
from tests.loaders.bag_builder import PERIOD_NS, START_NS, clouds, odometry, write_bag

COUNT = 7
VARIANTS = {
    "a.bag": "",
    "bz2.bag": "bz2",
    "lz4.bag": "lz4",
    "a_db3": "",
    "a_mcap": "",
    "storage_mcap": "storage",
    "message_db3": "message",
    "file_db3": "file",
}


@pytest.fixture(scope="module", params=VARIANTS)
def bag_path(request, tmp_path_factory):
    name = request.param
    version = 1 if name.endswith(".bag") else 2
    entries = [
        *clouds("/a/points", COUNT, ros_version=version),
        *clouds("b", 3, ros_version=version, late_ns=5),
    ]
    entries += [
        (
            "/odom",
            START_NS + i * PERIOD_NS // 4,
            odometry(START_NS + i, [i, 0, 0], ros_version=version),
        )
        for i in range(4 * COUNT)
    ]
    entries.sort(key=lambda entry: entry[1])
    return write_bag(tmp_path_factory.mktemp("bags") / name, entries, 20_000, VARIANTS[name])


def test_topics_and_span(bag_path):
    with open_bag(bag_path) as bag:
        found = {t.name: (t.msgtype, t.count) for t in bag.topics.values()}
        assert found["/a/points"] == ("sensor_msgs/msg/PointCloud2", COUNT)
        assert found["b"] == ("sensor_msgs/msg/PointCloud2", 3)
        assert found["/odom"] == ("nav_msgs/msg/Odometry", 4 * COUNT)
        assert (bag.start_ns, bag.end_ns) == (START_NS, START_NS + COUNT * PERIOD_NS)
        assert bag.container == {".bag": "ros1", "_db3": "sqlite3"}.get(bag_path.name[-4:], "mcap")
        assert not bag.warnings


def test_messages_in_order_from_any_time(bag_path):
    with open_bag(bag_path) as bag:
        everything = [
            (m.topic, m.log_time_ns, bytes(m.data))
            for m in bag.messages(["/a/points", "b", "/odom"])
        ]
        assert len(everything) == 5 * COUNT + 3
        assert [m[1] for m in everything] == sorted(m[1] for m in everything)
        start, stop = START_NS + 2 * PERIOD_NS, START_NS + 3 * PERIOD_NS
        part = [(m.topic, m.log_time_ns) for m in bag.messages(["/a/points", "/odom"], start, stop)]
        assert part == [m[:2] for m in everything if start <= m[1] < stop and m[0] != "b"]
        assert list(bag.messages(["/nothing"])) == []


def test_heads_are_the_messages_first_bytes(bag_path):
    with open_bag(bag_path) as bag:
        for topic, size in (("/a/points", 12), ("b", 300), ("/odom", 10**9)):
            whole = [(m.log_time_ns, bytes(m.data[:size])) for m in bag.messages([topic])]
            assert list(bag.heads(topic, size)) == whole


@pytest.mark.parametrize("name", ["a_db3", "a_mcap"])
def test_bare_file_and_folder_without_metadata(tmp_path, name):
    folder = write_bag(tmp_path / name, clouds("/a", 3, ros_version=2))
    file = next(p for p in folder.iterdir() if p.suffix in (".db3", ".mcap"))
    with open_bag(file) as bag:
        assert bag.topics["/a"].count == 3
    (folder / "metadata.yaml").unlink()
    with open_bag(folder) as bag:
        assert len(list(bag.messages(["/a"]))) == 3


def _with_profile(path, profile):
    """Change the profile, and not the size: the summary contains offsets."""
    data = path.read_bytes()
    size = int.from_bytes(data[9:17], "little")
    header = len(profile).to_bytes(4, "little") + profile
    library = size - len(header) - 4
    path.write_bytes(
        data[:17] + header + library.to_bytes(4, "little") + b" " * library + data[17 + size :]
    )


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("bare", [False, True])
def test_an_mcap_without_profile_is_a_bag_of_ros_2(tmp_path, bare, cut):
    folder = write_bag(tmp_path / "a_mcap", clouds("/a", 3, ros_version=2))
    file = folder / "a_mcap.mcap"
    _with_profile(file, b"")
    if cut:
        file.write_bytes(file.read_bytes()[:-20])
    with open_bag(file if bare else folder) as bag:
        assert [bag.deserialize(raw).width for raw in bag.messages(["/a"])] == [90 * 16] * 3
        assert len(list(bag.heads("/a", 12))) == 3
        assert len(bag.warnings) == cut
    _with_profile(file, b"ros1")
    with pytest.raises(InputError, match="Profile is not ros2"):
        open_bag(file)


def test_empty_bag_opens(tmp_path):
    for name in ("a.bag", "a_db3", "a_mcap"):
        with open_bag(write_bag(tmp_path / name, [])) as bag:
            assert bag.start_ns is None
            assert bag.topics == {}
            assert list(bag.messages(["/a"])) == []


def _bad(tmp_path: Path) -> dict[str, tuple[Path, str]]:
    (tmp_path / "text.bag").write_text("hello\n")
    (tmp_path / "zero.bag").touch()
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    (tmp_path / "folder").mkdir()
    cut = write_bag(tmp_path / "cut_db3", clouds("/a", 20, ros_version=2)) / "cut_db3.db3"
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (tmp_path / "noise.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(range(200)))
    return {
        "missing": (tmp_path / "none.bag", "no such file"),
        "text": (tmp_path / "text.bag", "no bag"),
        "zero": (tmp_path / "zero.bag", "empty"),
        "old": (tmp_path / "old.bag", "version 2.0"),
        "folder": (tmp_path / "folder", "no bag"),
        "cut sqlite": (cut, "cut or damaged"),
        "noise": (tmp_path / "noise.mcap", "damaged from its start"),
    }


def test_bad_input_is_one_line_that_names_the_file(tmp_path):
    for path, words in _bad(tmp_path).values():
        with pytest.raises(InputError) as caught:
            open_bag(path)
        text = str(caught.value)
        assert words in text
        assert path.name in text
        assert "\n" not in text


def test_damage_in_the_middle_is_an_input_error(tmp_path):
    path = write_bag(tmp_path / "a.bag", clouds("/a", 4), 1000, "lz4")
    content = bytearray(path.read_bytes())
    frame = content.rindex(b"\x04\x22\x4d\x18")
    content[frame : frame + 4] = bytes(4)
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged"), open_bag(path) as bag:
        list(bag.messages(["/a"]))
