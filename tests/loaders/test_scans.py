"""The index of a bag's clouds, slices of it, and clouds that give no scan."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import Scan
from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.cloud_checks import clock_problem, stamp_problem
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.decoding import settle_decoding
from ffmap.loaders.errors import InputError
from ffmap.loaders.scans import SkippedScan, read_digests, read_scans, sample_messages
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, clouds, header, odometry, only, sweep, write_bag

NAMES = ["a.bag", "lz4.bag", "a_db3", "a_mcap"]


def version(name):
    return 1 if name.endswith(".bag") else 2


def scans_of(bag, topic, first=0, count=None):
    index = index_clouds(bag, topic)
    decoding = settle_decoding(sample_messages(bag, index, 4), index.topic, period_ns=index.period_ns)
    return list(read_scans(bag, index, first, count, decoding))


@pytest.mark.parametrize("name", NAMES)
def test_index_and_any_slice(tmp_path, name):
    entries = clouds("/a", 10, ros_version=version(name))
    path = write_bag(tmp_path / name, entries, 50_000, "lz4" if name == "lz4.bag" else "")
    with open_bag(path) as bag:
        index = index_clouds(bag, "a")
        np.testing.assert_array_equal(index.stamp_ns, START_NS + np.arange(10) * PERIOD_NS)
        np.testing.assert_array_equal(index.log_time_ns, index.stamp_ns + PERIOD_NS)
        assert index.usable.all()
        assert index.period_ns == PERIOD_NS
        whole = scans_of(bag, "/a")
        assert [i for i, _ in whole] == list(range(10))
        for first, count in ((0, 3), (3, 4), (7, 100), (9, 1), (10, 5), (4, 0)):
            part = scans_of(bag, "/a", first, count)
            assert [i for i, _ in part] == list(range(first, min(first + count, 10)))
            for i, scan in part:
                assert scan.stamp_ns == index.stamp_ns[i]
                np.testing.assert_array_equal(scan.points_sensor, whole[i][1].points_sensor)


def test_clouds_are_indexed_once_for_an_open_bag(tmp_path):
    path = write_bag(tmp_path / "a.bag", clouds("/a", 10, ros_version=1), 50_000, "")
    with open_bag(path) as bag, open_bag(path) as again:
        index = index_clouds(bag, "/a")
        assert index_clouds(bag, "a") is index
        assert index_clouds(again, "/a") is not index
        np.testing.assert_array_equal(index_clouds(again, "/a").stamp_ns, index.stamp_ns)


@pytest.mark.parametrize(("stop_ns", "count"), [(0, 0), (35, 4), (40, 4), (1000, 10)])
def test_the_first_part_of_an_index_holds_what_comes_before(tmp_path, stop_ns, count):
    path = write_bag(tmp_path / "a.bag", clouds("/a", 10, ros_version=1), 50_000, "")
    with open_bag(path) as bag:
        part = index_clouds(bag, "a").until(START_NS + stop_ns * PERIOD_NS // 10)
        assert len(part) == count
        assert len(part.usable) == len(part.earlier) == count
        assert part.topic == "/a"
        assert np.all(part.stamp_ns < START_NS + stop_ns * PERIOD_NS // 10)


@pytest.mark.parametrize("name", NAMES)
def test_successive_clouds_are_gathered_to_scans(tmp_path, name):
    with open_bag(write_bag(tmp_path / name, clouds("/a", 10, ros_version=version(name)), 50_000)) as bag:
        single = index_clouds(bag, "/a")
        index = single.gathered(4)
        assert index.message_count.tolist() == [4, 4, 2]
        np.testing.assert_array_equal(index.stamp_ns, single.stamp_ns[::4])
        decoding = settle_decoding(sample_messages(bag, single, 4), "/a", period_ns=4 * PERIOD_NS)
        for first in range(3):
            for i, scan in read_scans(bag, index, first, 1, decoding):
                parts = [part for _, part in read_scans(bag, single, 4 * i, 4 if i < 2 else 2, decoding)]
                assert scan.cloud_size == sum(part.cloud_size for part in parts)
                times = np.concatenate([part.start_ns + part.time_ns for part in parts])
                np.testing.assert_allclose(np.sort(scan.start_ns + scan.time_ns), np.sort(times), atol=100)
        assert list(read_digests(bag, index)) == list(read_digests(bag, single))
        assert list(read_digests(bag, index, 1, 1)) == list(read_digests(bag, single, 4, 4))


def test_no_clouds_are_gathered_across_a_pause_or_with_one_that_is_not_usable(tmp_path):
    made = clouds("/a", 12)
    shifted = [(topic, log + (i >= 6) * 5 * PERIOD_NS, message) for i, (topic, log, message) in enumerate(made)]
    for i, (_, _, message) in enumerate(shifted):
        stamp_ns = START_NS + (2 if i == 9 else i + (i >= 6) * 5) * PERIOD_NS
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    with open_bag(write_bag(tmp_path / "a.bag", shifted)) as bag:
        index = index_clouds(bag, "/a").gathered(4)
    assert index.message_count.tolist() == [4, 2, 3, 1, 2]
    assert index.usable.tolist() == [True, True, True, False, True]


@pytest.mark.parametrize("name", NAMES)
def test_clouds_with_the_same_log_time_are_told_apart(tmp_path, name):
    made = clouds("/a", 9, ros_version=version(name))
    entries = [(topic, START_NS + i // 3, message) for i, (topic, _, message) in enumerate(made)]
    with open_bag(write_bag(tmp_path / name, entries, 60_000)) as bag:
        index = index_clouds(bag, "/a")
        for first in range(9):
            assert [s.stamp_ns for _, s in scans_of(bag, "/a", first, 2)] == index.stamp_ns[first : first + 2].tolist()


def test_clouds_that_give_no_scan_are_counted_and_say_why(tmp_path):
    entries = clouds("/a", 9)
    types = make_typestore(1).types

    def changed(i, **changes):
        message = entries[i][2]
        for key, value in changes.items():
            setattr(message, key, value)
        return message

    empty = sweep()[:0]
    changed(2, **vars(cloud(empty, START_NS + 2 * PERIOD_NS)))
    nan = sweep()
    nan["x"] = np.nan
    changed(4, **vars(cloud(nan, START_NS + 4 * PERIOD_NS)))
    changed(6, header=header(types, START_NS + PERIOD_NS // 2, "lidar"))
    changed(7, data=entries[7][2].data[:100])
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        found = scans_of(bag, "/a")
        reasons = {i: s.reason for i, s in found if isinstance(s, SkippedScan)}
        assert set(reasons) == {2, 4, 6, 7}
        assert reasons[2] == "no points"
        assert "NaN" in reasons[4]
        assert "jumps back by 0.450 s" in reasons[6]
        assert "truncated" in reasons[7]
        assert all(isinstance(s, Scan) for i, s in found if i not in reasons)


def test_one_stamp_far_ahead_does_not_cost_the_clouds_after_it(tmp_path):
    entries = clouds("/a", 8)
    entries[3][2].header.stamp.sec += 3600
    entries[6][2].header.stamp.nanosec = entries[5][2].header.stamp.nanosec
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        reasons = {i: s.reason for i, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)}
        assert set(reasons) == {3, 6}
        assert "ahead" in reasons[3]
        assert "repeats" in reasons[6]


@pytest.mark.parametrize("name", ["a.bag", "a_mcap"])
@pytest.mark.parametrize("clockwise", [True, False])
def test_a_cloud_for_each_packet_is_gathered_to_revolutions(tmp_path, name, clockwise):
    """Cartographer's backpack: 75 messages a revolution at 20 Hz, no ring, no time, a spin that is not quite steady."""
    entries = []
    columns, each = 300, 4
    points = only(sweep(columns, clockwise=clockwise), "x", "y", "z").reshape(columns // each, -1)
    step_ns = 50_000_000 // len(points)
    for i in range(6 * len(points) + 20):
        part = points[i % len(points)].copy()
        if i % 17 == 0:
            part["x"][:20] = np.nan
        stamp_ns = START_NS + i * step_ns + (i % 3) * 10_000
        entries.append(("points", stamp_ns + 1000, cloud(part, stamp_ns, "lidar", version(name))))
    with open_bag(write_bag(tmp_path / name, entries, 100_000)) as bag:
        index = index_clouds(bag, "points")
        assert index.message_count.sum() == len(entries)
        assert np.abs(index.message_count - [75, 75, 75, 75, 75, 75, 20]).max() <= 1
        assert abs(index.period_ns - 50_000_000) < 1_000_000
        scans = scans_of(bag, "points", 1, 3)
        assert [i for i, _ in scans] == [1, 2, 3]
        for i, scan in scans:
            assert scan.stamp_ns == index.stamp_ns[i]
            assert scan.ring_count == 16
            assert scan.cloud_size == index.message_count[i] * each * 16
            assert np.abs(scan.time_ns - scan.cloud_index // (16 * each) * step_ns).max() < 50_000


def test_a_pause_ends_a_revolution(tmp_path):
    points = only(sweep(300), "x", "y", "z").reshape(75, -1)
    entries = []
    for i in range(300):
        stamp_ns = START_NS + i * 666_667 + (3_000_000_000 if i >= 110 else 0)
        entries.append(("/a", stamp_ns, cloud(points[i % 75], stamp_ns)))
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        assert 110 in np.cumsum(index_clouds(bag, "/a").message_count)


def test_a_topic_without_clouds(tmp_path):
    path = write_bag(tmp_path / "a.bag", [("/odom", START_NS, odometry(START_NS, [0, 0, 0]))])
    with open_bag(path) as bag, pytest.raises(InputError, match=r"/odom is nav_msgs/msg/Odometry.*no clouds"):
        index_clouds(bag, "/odom")


DAY_S = 86_400


@pytest.mark.parametrize("wrong", [0, 3, 7])
@pytest.mark.parametrize("off_s", [DAY_S, -DAY_S])
def test_a_stamp_a_day_off_costs_its_own_cloud_alone(tmp_path, wrong, off_s):
    entries = clouds("/a", 8)
    entries[wrong][2].header.stamp.sec += off_s
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        index = index_clouds(bag, "/a")
        assert np.flatnonzero(~index.usable).tolist() == [wrong]
        assert index.period_ns == PERIOD_NS
        (skipped,) = [s for _, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)]
        assert ("ahead" if off_s > 0 else "back") in skipped.reason
        assert abs(skipped.stamp_ns - START_NS) < 8 * PERIOD_NS


def test_a_pause_and_a_clock_that_was_set_cost_no_cloud(tmp_path):
    made = clouds("/a", 12)
    paused = [(t, log + 10**10 * (i >= 10), m) for i, (t, log, m) in enumerate(made)]
    for _, _, message in paused[10:]:
        message.header.stamp.sec += 10
    with open_bag(write_bag(tmp_path / "paused.bag", paused)) as bag:
        assert index_clouds(bag, "/a").usable.all()
    made = clouds("/a", 12)
    for _, _, message in made[6:]:
        message.header.stamp.sec += DAY_S
    with open_bag(write_bag(tmp_path / "set.bag", made)) as bag:
        assert index_clouds(bag, "/a").usable.all()


def test_every_message_twice_is_read_once(tmp_path):
    twice = [entry for entry in clouds("/a", 15) for _ in range(2)]
    with open_bag(write_bag(tmp_path / "a.bag", twice)) as bag:
        index = index_clouds(bag, "/a")
        assert index.message_count.tolist() == [1] * 30
        assert np.count_nonzero(index.usable) == 15
        reasons = {s.reason for _, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)}
        assert reasons == {"stamp repeats that of the cloud before"}


def test_every_part_of_a_revolution_twice_is_read_once(tmp_path):
    parts = only(sweep(300), "x", "y", "z").reshape(75, -1)
    stamps = [START_NS + i * 1_333_333 for i in range(300)]
    entries = [("/a", ns, cloud(parts[i % 75], ns)) for i, ns in enumerate(stamps) for _ in range(2)]
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        assert index_clouds(bag, "/a").message_count.tolist() == [150] * 4
        assert {s.cloud_size for _, s in scans_of(bag, "/a")} == {300 * 16}


def test_parts_of_a_revolution_may_begin_with_one_that_holds_nothing(tmp_path):
    parts = only(sweep(300), "x", "y", "z").reshape(75, -1)
    entries = [("/a", START_NS + i * 1_333_333, cloud(parts[i % 75], START_NS + i * 1_333_333)) for i in range(225)]
    for i in (0, 80):
        message = entries[i][2]
        message.width, message.point_step, message.data = 0, 0, message.data[:0]
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        assert [s.cloud_size for _, s in scans_of(bag, "/a")] == [4736, 4736, 4800]


def test_clouds_that_all_have_one_stamp_are_told(tmp_path):
    entries = clouds("/a", 30)
    for _, _, message in entries:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        index = index_clouds(bag, "/a")
        assert index.message_count.tolist() == [1] * 30
        assert "/a: all 30 clouds have the same stamp, 0.000 s" in stamp_problem(index)
    made = clouds("/a", 30)
    backwards = [(t, log, made[-1 - i][2]) for i, (t, log, _) in enumerate(made)]
    with open_bag(write_bag(tmp_path / "backwards.bag", backwards)) as bag:
        assert "have stamps that do not increase" in stamp_problem(index_clouds(bag, "/a"))
    with open_bag(write_bag(tmp_path / "b.bag", made)) as bag:
        assert stamp_problem(index_clouds(bag, "/a")) is None


def test_clocks_that_are_apart_are_named(tmp_path):
    entries = sorted([*clouds("/a", 30), *clouds("/b", 30, late_ns=40_000_000)], key=lambda entry: entry[1])
    for topic, _, message in entries:
        message.header.stamp.sec += 1000 if topic == "/b" else 0
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        a, b = index_clouds(bag, "/a"), index_clouds(bag, "/b")
        assert "/b are 1000.0 s ahead" in clock_problem(a, b)
        assert "/a are 1000.0 s behind" in clock_problem(b, a)
        assert clock_problem(a, a) is None
    later = [*clouds("/a", 10), *clouds("/b", 10, late_ns=10**12)]
    with open_bag(write_bag(tmp_path / "b.bag", later)) as bag:
        assert "share no time" in clock_problem(index_clouds(bag, "/a"), index_clouds(bag, "/b"))
    together = sorted([*clouds("/a", 10), *clouds("/b", 10, late_ns=300_000_000)], key=lambda entry: entry[1])
    with open_bag(write_bag(tmp_path / "c.bag", together)) as bag:
        assert clock_problem(index_clouds(bag, "/a"), index_clouds(bag, "/b")) is None


@pytest.mark.parametrize("point_step", [0, 4])
def test_a_cloud_without_points_may_say_anything_of_their_layout(tmp_path, point_step):
    entries = clouds("/a", 9)
    message = entries[4][2]
    message.width, message.point_step, message.row_step, message.data = 0, point_step, 0, message.data[:0]
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        assert {i: s.reason for i, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)} == {4: "no points"}


@pytest.mark.parametrize("names", [("x", "y", "z", "ring", "time"), ("x", "y", "z", "ring")])
def test_scans_have_one_order_whatever_the_clouds(tmp_path, names):
    points = only(sweep(), *names)
    shuffle = np.random.default_rng(0).permutation(len(points))
    entries = [
        ("/a", START_NS + i * PERIOD_NS, cloud(points[rows], START_NS + i * PERIOD_NS))
        for i, rows in enumerate((np.arange(len(points)), shuffle))
    ]
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        (_, scan), (_, shuffled) = scans_of(bag, "/a")
    np.testing.assert_array_equal(shuffled.points_sensor, scan.points_sensor)
    np.testing.assert_array_equal(shuffled.ring, scan.ring)
    np.testing.assert_array_equal(shuffle[shuffled.cloud_index], scan.cloud_index)


@pytest.mark.parametrize(("parts", "count"), [(2, 24), (3, 36)])
def test_clouds_that_are_parts_of_a_revolution_are_gathered(tmp_path, parts, count):
    whole = sweep(90)
    entries = []
    for i in range(count):
        part = np.array_split(whole, parts)[i % parts].copy()
        part["time"] -= part["time"].min()
        stamp_ns = START_NS + i * PERIOD_NS // parts
        entries.append(("/a", stamp_ns + PERIOD_NS, cloud(part, stamp_ns)))
    # One is lost: what is left of its revolution stays alone.
    lost = [entry for i, entry in enumerate(entries) if i != 4 * parts]
    for name, kept in ("all", entries), ("lost", lost):
        with open_bag(write_bag(tmp_path / f"{name}.bag", kept)) as bag:
            index = index_clouds(bag, "/a")
            assert np.count_nonzero(index.message_count == parts) >= count // parts - 2
            _, scan = next(read_scans(bag, index, 0, 1, settle_decoding(sample_messages(bag, index, 4), "/a")))
    assert len(scan) == len(whole)
    np.testing.assert_allclose(np.sort(scan.time_ns), 1e9 * whole["time"], atol=100)


def test_whole_revolutions_are_not_gathered_where_half_of_each_is_hidden(tmp_path):
    entries = clouds("/a", 24)
    for _topic, _, message in entries:
        message.data.reshape(-1, message.point_step)[: message.width // 2] = 0
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        assert index_clouds(bag, "/a").message_count.tolist() == [1] * 24
