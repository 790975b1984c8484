"""A drive in several files: it reads as the drive in one file does, and what cannot be one drive is refused."""

import shutil
from collections import deque
from collections.abc import Sequence
from pathlib import Path

import pytest

from ffmap.loaders.bag import Bag, open_bag
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import read_digests
from tests.loaders.bag_builder import PERIOD_NS, START_NS, Entry, cloud, clouds, only, sweep, tf_message, write_bag
from tests.parts import cut, in_one_folder

COUNT = 12
TOPICS = ("/a", "/b")
PLACES_NS = (START_NS + 4 * PERIOD_NS + 7, START_NS + 9 * PERIOD_NS)
"""Between two messages, and at one."""


def drive(version: int) -> list[Entry]:
    """Two topics in turn, a message each 50 ms."""
    entries = [*clouds("/a", COUNT, ros_version=version), *clouds("/b", COUNT, "other", version, PERIOD_NS // 2)]
    static = tf_message([("base", "lidar", (0, 0, 1), (0, 0, 0, 1))], version)
    return [("/tf_static", START_NS, static), *sorted(entries, key=lambda entry: entry[1])]


@pytest.fixture(scope="module", params=["drive.bag", "drive_mcap", "drive_db3"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    name = str(request.param)
    return write_bag(tmp_path_factory.mktemp("whole") / name, drive(1 if name.endswith(".bag") else 2))


def opened(*parts: Path) -> Bag:
    return open_bag(BagPath(parts))


def content(bag: Bag, start_ns: int | None = None, stop_ns: int | None = None) -> list[tuple[str, int, bytes]]:
    return [(raw.topic, raw.log_time_ns, bytes(raw.data)) for raw in bag.messages(bag.topics, start_ns, stop_ns)]


def assert_reads_as(parts: Sequence[Path], whole: Path) -> None:
    with opened(*parts) as bag, open_bag(whole) as one:
        assert bag.topics == one.topics
        assert (bag.start_ns, bag.end_ns, bag.container) == (one.start_ns, one.end_ns, one.container)
        assert content(bag) == content(one)
        times_ns = [START_NS + k * PERIOD_NS // 2 for k in range(0, 2 * COUNT, 3)]
        for start_ns in times_ns:
            assert content(bag, start_ns, start_ns + 3 * PERIOD_NS) == content(one, start_ns, start_ns + 3 * PERIOD_NS)
        for topic in TOPICS:
            assert list(bag.heads(topic, 40)) == list(one.heads(topic, 40))
            assert list(read_digests(bag, index_clouds(bag, topic))) == list(
                read_digests(one, index_clouds(one, topic))
            )


def test_parts_in_any_order_read_as_the_whole(whole: Path, tmp_path: Path) -> None:
    first, second, third = cut(whole, tmp_path, PLACES_NS)
    assert_reads_as([third, first, second], whole)
    with opened(third, first, second) as bag:
        assert bag.path.parts == (first, second, third)
        assert not bag.warnings
        assert [raw.file.stem for raw in bag.messages(["/a"])] == [first.stem] * 4 + [second.stem] * 4 + [
            third.stem
        ] * 4


def test_files_of_a_folder_read_as_the_whole(whole: Path, tmp_path: Path) -> None:
    parts = cut(whole, tmp_path, PLACES_NS)
    if whole.suffix == ".bag":
        with open_bag(tmp_path) as bag:
            assert bag.warnings == [f"{tmp_path.name}: no ROS 2 bag; its 3 data file(s) are read as one bag"]
        assert_reads_as([tmp_path], whole)
        return
    folder = in_one_folder(parts, tmp_path / "folder")
    with open_bag(folder) as bag:
        assert len(bag.files) == 3
        assert not bag.warnings
    assert_reads_as([folder], whole)
    (folder / "metadata.yaml").unlink()
    assert_reads_as([folder], whole)


def test_a_last_part_that_its_recorder_had_not_finished_is_read(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    parts = [path if path.is_file() else next(path.glob("*.*[!l]")) for path in cut(whole, tmp_path, PLACES_NS[:1])]
    _, last = (Path(shutil.copy(path, folder / path.name)) for path in parts)
    last.rename(folder / f"{last.name}.active")
    assert_reads_as([folder], whole)


@pytest.mark.parametrize("name", ["drive.bag", "drive_mcap"])
def test_files_of_a_folder_that_are_left_out_are_named(tmp_path: Path, name: str) -> None:
    version, folder = (1, tmp_path) if name.endswith(".bag") else (2, tmp_path / name)
    write_bag(tmp_path / name, clouds("/a", 3, ros_version=version))
    with open_bag(folder) as bag:
        assert not any("left out" in warning for warning in bag.warnings)
    for other in ("drive.bag.orig", "part_1.mcap.zst", "part_1.bag.orig.active", "notes.txt"):
        (folder / other).write_bytes(b"x")
    with open_bag(folder) as bag:
        (named,) = (warning for warning in bag.warnings if "left out" in warning)
    assert "left out: drive.bag.orig, part_1.bag.orig.active, part_1.mcap.zst; " in named


def test_a_part_that_metadata_does_not_list_is_named(whole: Path, tmp_path: Path) -> None:
    if whole.is_file():
        pytest.skip("a bag of ROS 1 has no metadata")
    folder = Path(shutil.copytree(whole, tmp_path / "folder"))
    data = next(path for path in folder.iterdir() if path.suffix != ".yaml")
    shutil.copy(data, folder / f"later{data.suffix}")
    with open_bag(folder) as bag:
        assert bag.warnings[0].startswith(f"folder: left out: later{data.suffix}; ")
        assert bag.topics["/a"].count == COUNT


def test_messages_out_of_order_at_a_cut_come_in_order(tmp_path: Path) -> None:
    """/b's last message before the cut lies in the second file, /a's first after it in the first."""
    entries = drive(2)
    whole = write_bag(tmp_path / "drive_mcap", entries)
    first = [*entries[:11], entries[12]]
    second = [entries[11], *entries[13:]]
    parts = [write_bag(tmp_path / f"{k}_mcap", part) for k, part in enumerate((first, second))]
    assert_reads_as(parts, whole)
    assert_reads_as([in_one_folder(parts, tmp_path / "folder")], whole)


@pytest.mark.parametrize("name", ["drive.bag", "drive_mcap", "drive_db3"])
def test_a_revolution_of_many_messages_goes_on_in_the_next_file(tmp_path: Path, name: str) -> None:
    points = only(sweep(300), "x", "y", "z").reshape(75, -1)
    step_ns, version = PERIOD_NS // 75, 1 if name.endswith(".bag") else 2
    entries = [
        ("/a", START_NS + k * step_ns, cloud(points[k % 75], START_NS + k * step_ns, "lidar", version))
        for k in range(5 * 75)
    ]
    whole = write_bag(tmp_path / name, entries)
    parts = cut(whole, tmp_path, [START_NS + k * step_ns for k in (100, 101, 230)])
    with opened(*parts) as bag, open_bag(whole) as one:
        index, expected = index_clouds(bag, "/a"), index_clouds(one, "/a")
        assert expected.message_count.tolist() == [75] * 5
        assert index.message_count.tolist() == [75] * 5
        assert index.log_time_ns.tolist() == expected.log_time_ns.tolist()
        assert list(read_digests(bag, index)) == list(read_digests(one, expected))
        assert list(read_digests(bag, index, 1, 1)) == list(read_digests(one, expected, 1, 1))


def test_a_part_without_messages_and_transforms_in_each_are_no_trouble(tmp_path: Path) -> None:
    entries = drive(1)
    static = entries[0]
    half = len(entries) // 2
    repeated = ("/tf_static", entries[half][1], static[2])
    parts = [
        write_bag(tmp_path / f"{k}.bag", part)
        for k, part in enumerate(([], entries[:half], [repeated, *entries[half:]]))
    ]
    with opened(*parts) as bag:
        assert bag.topics["/tf_static"].count == 2
        assert len(index_clouds(bag, "/a")) == len(index_clouds(bag, "/b")) == COUNT
        assert (bag.start_ns, bag.end_ns) == (entries[0][1], entries[-1][1])
        assert not bag.warnings


def test_what_cannot_be_one_drive_is_refused_in_a_line_that_names_the_part(tmp_path: Path) -> None:
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
        ((second, copy), ("copy.bag: its /a overlaps with that of", "drive_1.bag by 0.3 s")),
        ((copy, whole), ("copy.bag: its /a overlaps with that of", "drive.bag by 0.3 s")),
        ((whole, late), ("late.bag: its /a overlaps with that of", "by 1.1 s")),
    ):
        with pytest.raises(InputError) as caught, opened(*parts) as bag:
            index_clouds(bag, "/a")
        assert all(word in str(caught.value) for word in words), caught.value
        assert "\n" not in str(caught.value)


def test_a_gap_between_parts_is_told_with_its_length(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "drive.bag", [entry for entry in drive(1) if entry[0] == "/a"])
    early = cut(whole, tmp_path, [PLACES_NS[0]])[0]
    later = write_bag(tmp_path / "later.bag", clouds("/a", 3, late_ns=16 * PERIOD_NS))
    at_once = write_bag(tmp_path / "at_once.bag", clouds("/b", 3, late_ns=16 * PERIOD_NS))
    with opened(later, at_once, early) as bag:
        assert len(bag.warnings) == 1
        assert bag.warnings[0].startswith(("later.bag: begins 1.3 s after drive_0.bag", "at_once.bag: begins 1.3 s"))
    with opened(whole, write_bag(tmp_path / "next.bag", clouds("/a", 3, late_ns=(COUNT + 5) * PERIOD_NS))) as bag:
        assert not bag.warnings


def test_a_folder_of_several_drives_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    for name, late_ns in (("a.bag", 0), ("b.bag", 60 * 10**9), ("c.bag", 1000 * 10**9)):
        write_bag(tmp_path / "bags" / name, clouds("/a", 3, late_ns=late_ns))
    match = r"c\.bag: begins 939\.8 s after b\.bag ends, so that the folder contains several drives"
    with pytest.raises(InputError, match=match):
        opened(tmp_path / "bags")
    (tmp_path / "bags" / "c.bag").unlink()
    with opened(tmp_path / "bags") as bag:
        assert len(index_clouds(bag, "/a")) == 6


def test_damage_names_the_part_that_is_damaged(tmp_path: Path) -> None:
    whole = write_bag(tmp_path / "drive.bag", drive(1))
    parts = cut(whole, tmp_path, PLACES_NS)
    bad = parts[1].read_bytes()
    # The frame's length, in a cloud's header.
    place = bad.index(b"\x05\x00\x00\x00lidar")
    parts[1].write_bytes(bad[:place] + b"\xff\xff\xff\x7f" + bad[place + 4 :])
    with opened(*parts) as bag, pytest.raises(InputError, match=r"^drive_1\.bag: a message of /a"):
        deque(map(bag.deserialize, bag.messages(["/a"])), maxlen=0)
    parts[1].write_bytes(bad[: len(bad) // 2])
    with opened(*parts) as bag:
        assert bag.warnings[0].startswith("drive_1.bag: cut, or its recorder was killed")


def test_several_paths_are_named_by_the_first() -> None:
    one = BagPath((Path("a/x y.bag"),))
    three = BagPath((Path("a/x_0.bag"), Path("a/x_1.bag"), Path("b/x 2.bag")))
    assert (str(one), one.name, one.stem, one.words) == ("a/x y.bag", "x y.bag", "x y", "'a/x y.bag'")
    assert (str(three), three.name, three.stem) == ("a/x_0.bag and 2 more", "x_0.bag and 2 more", "x_0")
    assert three.words == "a/x_0.bag a/x_1.bag 'b/x 2.bag'"
