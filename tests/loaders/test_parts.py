"""A drive in several files reads as the drive in one file; other files are refused."""

import shutil
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import pytest

from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.errors import InputError
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    Entry,
    cloud,
    clouds,
    only,
    sweep,
    tf_message,
    write_bag,
)
from tests.parts import cut, in_one_folder

COUNT = 12
TOPICS = ("/a", "/b")
PLACES_NS = (START_NS + 4 * PERIOD_NS + 7, START_NS + 9 * PERIOD_NS)
"""Between two messages, and at one."""


def drive(version: int) -> list[Entry]:
    """Two topics in turn, a message each 50 ms."""
    entries = [
        *clouds("/a", COUNT, ros_version=version),
        *clouds("/b", COUNT, "other", version, PERIOD_NS // 2),
    ]
    static = tf_message([("base", "lidar", (0, 0, 1), (0, 0, 0, 1))], version)
    return [("/tf_static", START_NS, static), *sorted(entries, key=lambda entry: entry[1])]


@pytest.fixture(scope="module", params=["drive.bag", "drive_mcap", "drive_db3"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    name = str(request.param)
    version = 1 if name.endswith(".bag") else 2
    return write_bag(tmp_path_factory.mktemp("whole") / name, drive(version))


def opened(*parts: Path) -> Bag:
    return open_bag(BagPath(parts))


def assert_reads_as(parts: Sequence[Path], whole: Path) -> None:
    def content(bag: Bag, *span: int) -> list[tuple[str, int, bytes]]:
        messages = bag.messages(bag.topics, *span)
        return [(raw.topic, raw.log_time_ns, bytes(raw.data)) for raw in messages]

    with opened(*parts) as bag, open_bag(whole) as one:
        assert bag.topics == one.topics
        assert (bag.start_ns, bag.end_ns) == (one.start_ns, one.end_ns)
        assert content(bag) == content(one)
        for start_ns in range(START_NS, START_NS + COUNT * PERIOD_NS, 3 * PERIOD_NS // 2):
            span = start_ns, start_ns + 3 * PERIOD_NS
            assert content(bag, *span) == content(one, *span)
        for topic in TOPICS:
            assert list(bag.heads(topic, 40)) == list(one.heads(topic, 40))


def test_parts_in_any_order_and_in_a_folder_read_as_the_whole(whole: Path, tmp_path: Path) -> None:
    first, second, third = cut(whole, tmp_path, PLACES_NS)
    assert_reads_as([third, first, second], whole)
    with opened(third, first, second) as bag:
        assert bag.path.parts == (first, second, third)
        assert not bag.warnings
    folder = tmp_path
    if whole.suffix != ".bag":
        folder = in_one_folder([first, second, third], tmp_path / "folder")
        assert_reads_as([folder], whole)
        (folder / "metadata.yaml").unlink()
    assert_reads_as([folder], whole)
    with open_bag(folder) as bag:
        assert not bag.warnings


def test_an_unfinished_last_part_is_read(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    parts = cut(whole, tmp_path, PLACES_NS[:1])
    files = [path if path.is_file() else next(path.glob("*.*[!l]")) for path in parts]
    _, last = (Path(shutil.copy(path, folder / path.name)) for path in files)
    last.rename(folder / f"{last.name}.active")
    assert_reads_as([folder], whole)


def test_files_that_are_not_read_are_named(whole: Path, tmp_path: Path) -> None:
    file = whole if whole.is_file() else next(whole.glob("*.*[!l]"))
    shutil.copy(file, tmp_path)
    for other in ("part_1.mcap.zst", "a.bag.orig.active", "notes.txt"):
        (tmp_path / other).write_bytes(b"x")
    with open_bag(tmp_path) as bag:
        (named,) = (warning for warning in bag.warnings if "left out" in warning)
        assert "left out: a.bag.orig.active, " in named
        assert "part_1.mcap.zst; " in named
        assert bag.topics["/a"].count == COUNT


def test_messages_out_of_order_at_a_cut_come_in_order(tmp_path: Path) -> None:
    """/b's last message before the cut is in the second file, /a's first after it in the first."""
    entries = drive(2)
    whole = write_bag(tmp_path / "drive_mcap", entries)
    halves = [*entries[:11], entries[12]], [entries[11], *entries[13:]]
    parts = [write_bag(tmp_path / f"{k}_mcap", part) for k, part in enumerate(halves)]
    assert_reads_as(parts, whole)
    assert_reads_as([in_one_folder(parts, tmp_path / "folder")], whole)


def test_a_revolution_may_continue_in_the_next_file(tmp_path: Path) -> None:
    points = only(sweep(300), "x", "y", "z").reshape(75, -1)
    stamps = [START_NS + k * PERIOD_NS // 75 for k in range(5 * 75)]
    entries = [("/a", ns, cloud(points[k % 75], ns)) for k, ns in enumerate(stamps)]
    whole = write_bag(tmp_path / "drive.bag", entries)
    parts = cut(whole, tmp_path, [stamps[k] for k in (100, 101, 230)])
    with opened(*parts) as bag:
        index = index_clouds(bag, "/a")
        assert index.message_count.tolist() == [75] * 5
        assert index.log_time_ns.tolist() == stamps[::75]


def test_empty_parts_and_repeated_transforms(tmp_path: Path) -> None:
    entries = drive(1)
    half = len(entries) // 2
    repeated = ("/tf_static", entries[half][1], entries[0][2])
    parts = enumerate(([], entries[:half], [repeated, *entries[half:]]))
    with opened(*(write_bag(tmp_path / f"{k}.bag", part) for k, part in parts)) as bag:
        assert bag.topics["/tf_static"].count == 2
        assert len(index_clouds(bag, "/a")) == len(index_clouds(bag, "/b")) == COUNT
        assert not bag.warnings


def test_files_of_different_drives_are_refused(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "drive.bag", drive(1))
    ros2 = write_bag(tmp_path / "ros2_mcap", drive(2))
    _, second, _ = cut(whole, tmp_path, PLACES_NS)
    copy = Path(shutil.copy(second, tmp_path / "copy.bag"))
    link = tmp_path / "link.bag"
    link.symlink_to(whole)
    late = write_bag(tmp_path / "late.bag", clouds("/a", COUNT, late_ns=PERIOD_NS // 3))
    for parts, words in (
        ((whole, whole), ("drive.bag: its /a overlaps with that of",)),
        ((whole, link), ("link.bag: its /a overlaps with that of", "drive.bag")),
        ((whole, ros2), ("ros2_mcap.mcap: is a bag of ROS 2", "drive.bag one of ROS 1")),
        ((whole, tmp_path / "none.bag"), ("none.bag: no such file",)),
        ((second, copy), ("copy.bag: its /a overlaps with that of", "1_drive.bag by 0.4 s")),
        ((whole, late), ("late.bag: its /a overlaps with that of",)),
    ):
        with pytest.raises(InputError) as caught, opened(*parts) as bag:
            index_clouds(bag, "/a")
        assert all(word in str(caught.value) for word in words), caught.value
        assert "\n" not in str(caught.value)


def test_gaps_between_parts(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    for name, late_s in (("a.bag", 0), ("b.bag", 60), ("c.bag", 1000)):
        write_bag(tmp_path / "bags" / name, clouds("/a", 3, late_ns=late_s * 10**9))
    with pytest.raises(InputError, match=r"c\.bag: begins 939\.8 s after b\.bag ends, so that"):
        opened(tmp_path / "bags")
    with opened(*(tmp_path / "bags" / f"{name}.bag" for name in "bac")) as bag:
        assert [warning.split(":")[0] for warning in bag.warnings] == ["b.bag", "c.bag"]
        assert bag.warnings[0].startswith("b.bag: begins 59.8 s after a.bag ends: a part ")


def test_damage_names_the_part(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "drive.bag", drive(1))
    parts = cut(whole, tmp_path, PLACES_NS)
    content = parts[1].read_bytes()
    # The frame's length, in a cloud's header.
    place = content.index(b"\x05\x00\x00\x00lidar")
    parts[1].write_bytes(content[:place] + b"\xff\xff\xff\x7f" + content[place + 4 :])
    with opened(*parts) as bag, pytest.raises(InputError, match=r"^1_drive\.bag: a message of /a"):
        deque(map(bag.deserialize, bag.messages(["/a"])), maxlen=0)
    parts[1].write_bytes(content[: len(content) // 2])
    with opened(*parts) as bag:
        assert bag.warnings[0].startswith("1_drive.bag: cut, or its recorder was killed")
