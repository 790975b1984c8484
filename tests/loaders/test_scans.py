"""The index of a bag's clouds, slices of it, and clouds that give no scan."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import Scan
from ffmap.loaders.bag import make_typestore, open_bag
from ffmap.loaders.cloud_checks import clock_problem, gap_problem, stamp_problem
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.decoding import settle_decoding
from ffmap.loaders.scans import SkippedScan, read_scans, sample_messages
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    header,
    only,
    sweep,
    write_bag,
)

NAMES = ["a.bag", "lz4.bag", "a_db3", "a_mcap"]
DAY_S = 86_400


@pytest.fixture
def bag_of(tmp_path):
    """Write a bag and open it."""
    bags = []

    def open_entries(entries, name="a.bag"):
        compression = "lz4" if name == "lz4.bag" else ""
        bags.append(open_bag(write_bag(tmp_path / name, entries, 50_000, compression)))
        return bags[-1]

    yield open_entries
    for bag in bags:
        bag.close()


def version(name):
    return 1 if name.endswith(".bag") else 2


def scans_of(bag, topic, first=0, count=None):
    index = index_clouds(bag, topic)
    samples = sample_messages(bag, index, 4)
    decoding = settle_decoding(samples, index.topic, period_ns=index.period_ns)
    return list(read_scans(bag, index, first, count, decoding))


def reasons_of(bag):
    return {i: s.reason for i, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)}


@pytest.mark.parametrize("name", NAMES)
def test_index_and_any_slice(bag_of, name):
    bag = bag_of(clouds("/a", 10, ros_version=version(name)), name)
    index = index_clouds(bag, "a")
    np.testing.assert_array_equal(index.stamp_ns, START_NS + np.arange(10) * PERIOD_NS)
    np.testing.assert_array_equal(index.log_time_ns, index.stamp_ns + PERIOD_NS)
    assert index.usable.all()
    assert index.period_ns == PERIOD_NS
    whole = scans_of(bag, "/a")
    assert [i for i, _ in whole] == list(range(10))
    for first, count in ((0, 3), (7, 100), (9, 1), (10, 5), (4, 0)):
        part = scans_of(bag, "/a", first, count)
        assert [i for i, _ in part] == list(range(first, min(first + count, 10)))
        for i, scan in part:
            assert scan.stamp_ns == index.stamp_ns[i]
            np.testing.assert_array_equal(scan.points_sensor, whole[i][1].points_sensor)
    for stop_ns, count in ((0, 0), (35, 4), (40, 4), (1000, 10)):
        assert len(index.until(START_NS + stop_ns * PERIOD_NS // 10)) == count


def test_successive_clouds_are_gathered_to_scans(bag_of):
    bag = bag_of(clouds("/a", 10))
    single = index_clouds(bag, "/a")
    index = single.gathered(4)
    assert index.message_count.tolist() == [4, 4, 2]
    np.testing.assert_array_equal(index.stamp_ns, single.stamp_ns[::4])
    decoding = settle_decoding(sample_messages(bag, single, 4), "/a", period_ns=4 * PERIOD_NS)
    for first in range(3):
        for i, scan in read_scans(bag, index, first, 1, decoding):
            count = 4 if i < 2 else 2
            parts = [part for _, part in read_scans(bag, single, 4 * i, count, decoding)]
            assert scan.cloud_size == sum(part.cloud_size for part in parts)
            times = np.concatenate([part.start_ns + part.time_ns for part in parts])
            found = np.sort(scan.start_ns + scan.time_ns)
            np.testing.assert_allclose(found, np.sort(times), atol=100)


def test_no_clouds_are_gathered_across_a_pause_or_with_an_unusable_one(bag_of):
    made = []
    for i, (topic, log, message) in enumerate(clouds("/a", 12)):
        stamp_ns = START_NS + (2 if i == 9 else i + (i >= 6) * 5) * PERIOD_NS
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        made.append((topic, log + (i >= 6) * 5 * PERIOD_NS, message))
    index = index_clouds(bag_of(made), "/a").gathered(4)
    assert index.message_count.tolist() == [4, 2, 3, 1, 2]
    assert index.usable.tolist() == [True, True, True, False, True]


@pytest.mark.parametrize("name", NAMES)
def test_clouds_with_the_same_log_time(bag_of, name):
    made = clouds("/a", 9, ros_version=version(name))
    bag = bag_of([(topic, START_NS + i // 3, m) for i, (topic, _, m) in enumerate(made)], name)
    stamps = index_clouds(bag, "/a").stamp_ns.tolist()
    for first in range(9):
        found = [scan.stamp_ns for _, scan in scans_of(bag, "/a", first, 2)]
        assert found == stamps[first : first + 2]


def test_clouds_that_give_no_scan_have_a_reason(bag_of):
    entries = clouds("/a", 9)
    nan = sweep()
    nan["x"] = np.nan
    entries[2] = (*entries[2][:2], cloud(sweep()[:0], START_NS + 2 * PERIOD_NS))
    entries[4] = (*entries[4][:2], cloud(nan, START_NS + 4 * PERIOD_NS))
    types = make_typestore(1).types
    entries[6][2].header = header(types, START_NS + PERIOD_NS // 2, "lidar")
    entries[7][2].data = entries[7][2].data[:100]
    bag = bag_of(entries)
    reasons = reasons_of(bag)
    assert set(reasons) == {2, 4, 6, 7}
    for i, words in {2: "no points", 4: "NaN", 6: "jumps back by 0.450 s", 7: "truncated"}.items():
        assert words in reasons[i]
    assert sum(isinstance(scan, Scan) for _, scan in scans_of(bag, "/a")) == 5


@pytest.mark.parametrize("point_step", [0, 4, 2**32 - 1])
def test_a_cloud_without_points_may_have_any_layout(bag_of, point_step):
    entries = clouds("/a", 9)
    message = entries[4][2]
    message.width, message.point_step, message.row_step = 0, point_step, 0
    message.data = message.data[:0]
    assert reasons_of(bag_of(entries)) == {4: "no points"}


@pytest.mark.parametrize(("wrong", "off_s"), [(0, DAY_S), (3, -DAY_S), (3, 3600), (7, DAY_S)])
def test_one_wrong_stamp_costs_one_cloud(bag_of, wrong, off_s):
    entries = clouds("/a", 8)
    entries[wrong][2].header.stamp.sec += off_s
    bag = bag_of(entries)
    index = index_clouds(bag, "/a")
    assert np.flatnonzero(~index.usable).tolist() == [wrong]
    assert index.period_ns == PERIOD_NS
    (skipped,) = [s for _, s in scans_of(bag, "/a") if isinstance(s, SkippedScan)]
    assert ("ahead" if off_s > 0 else "back") in skipped.reason
    assert abs(skipped.stamp_ns - START_NS) < 8 * PERIOD_NS


def test_a_pause_and_a_clock_that_was_set_cost_no_cloud(bag_of):
    made = clouds("/a", 12)
    paused = [(t, log + 10**10 * (i >= 10), m) for i, (t, log, m) in enumerate(made)]
    for _, _, message in paused[10:]:
        message.header.stamp.sec += 10
    assert index_clouds(bag_of(paused), "/a").usable.all()
    made = clouds("/a", 12)
    for _, _, message in made[6:]:
        message.header.stamp.sec += DAY_S
    assert index_clouds(bag_of(made, "set.bag"), "/a").usable.all()


@pytest.mark.parametrize(("name", "clockwise"), [("a.bag", True), ("a_mcap", False)])
def test_packets_are_joined_to_revolutions(bag_of, name, clockwise):
    """Cartographer's backpack: 75 messages a revolution at 20 Hz, without rings and times."""
    points = only(sweep(300, clockwise=clockwise), "x", "y", "z").reshape(75, -1)
    step_ns, entries = 50_000_000 // 75, []
    for i in range(6 * 75 + 20):
        part = points[i % 75].copy()
        if i % 17 == 0:
            part["x"][:20] = np.nan
        stamp_ns = START_NS + i * step_ns + (i % 3) * 10_000
        entries.append(("/a", stamp_ns + 1000, cloud(part, stamp_ns, "lidar", version(name))))
    bag = bag_of(entries, name)
    index = index_clouds(bag, "/a")
    assert index.message_count.tolist() == [75] * 6 + [20]
    assert index.period_ns == pytest.approx(50_000_000, abs=1_000_000)
    for i, scan in scans_of(bag, "/a", 1, 3):
        assert scan.stamp_ns == index.stamp_ns[i]
        assert (scan.ring_count, scan.cloud_size) == (16, 75 * 4 * 16)
        assert np.abs(scan.time_ns - scan.cloud_index // (16 * 4) * step_ns).max() < 50_000


def packet_clouds(count, columns=75, step_ns=1_333_333):
    points = only(sweep(300), "x", "y", "z").reshape(columns, -1)
    stamps = [START_NS + i * step_ns for i in range(count)]
    return [("/a", stamp, cloud(points[i % columns], stamp)) for i, stamp in enumerate(stamps)]


def test_messages_that_were_recorded_twice_are_read_once(bag_of):
    bag = bag_of([entry for entry in clouds("/a", 15) for _ in range(2)])
    assert index_clouds(bag, "/a").message_count.tolist() == [1] * 30
    assert set(reasons_of(bag).values()) == {"stamp repeats that of the cloud before"}
    packets = bag_of([entry for entry in packet_clouds(300) for _ in range(2)], "packets.bag")
    assert index_clouds(packets, "/a").message_count.tolist() == [150] * 4
    assert {scan.cloud_size for _, scan in scans_of(packets, "/a")} == {300 * 16}


def test_packets_without_points(bag_of):
    entries = packet_clouds(225)
    for i in (0, 80):
        message = entries[i][2]
        message.width, message.point_step, message.data = 0, 0, message.data[:0]
    assert [s.cloud_size for _, s in scans_of(bag_of(entries), "/a")] == [4736, 4736, 4800]


@pytest.mark.parametrize(("parts", "count"), [(2, 24), (3, 36)])
@pytest.mark.parametrize("lost", [False, True])
def test_parts_of_a_revolution_are_joined(bag_of, parts, count, lost):
    whole, entries = sweep(90), []
    for i in range(count):
        part = np.array_split(whole, parts)[i % parts].copy()
        part["time"] -= part["time"].min()
        stamp_ns = START_NS + i * PERIOD_NS // parts
        entries.append(("/a", stamp_ns + PERIOD_NS, cloud(part, stamp_ns)))
    if lost:
        del entries[4 * parts]
    bag = bag_of(entries)
    index = index_clouds(bag, "/a")
    assert np.count_nonzero(index.message_count == parts) >= count // parts - 2
    scan = scans_of(bag, "/a", 0, 1)[0][1]
    assert len(scan) == len(whole)
    np.testing.assert_allclose(np.sort(scan.time_ns), 1e9 * whole["time"], atol=100)


def test_half_hidden_revolutions_are_not_joined(bag_of):
    entries = clouds("/a", 24)
    for _, _, message in entries:
        message.data.reshape(-1, message.point_step)[: message.width // 2] = 0
    assert index_clouds(bag_of(entries), "/a").message_count.tolist() == [1] * 24


def test_stamps_that_do_not_increase(bag_of):
    entries = clouds("/a", 30)
    assert stamp_problem(index_clouds(bag_of(entries), "/a")) is None
    backwards = [(t, log, entries[-1 - i][2]) for i, (t, log, _) in enumerate(entries)]
    problem = stamp_problem(index_clouds(bag_of(backwards, "backwards.bag"), "/a"))
    assert "have stamps that do not increase" in problem
    for _, _, message in entries:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    problem = stamp_problem(index_clouds(bag_of(entries, "same.bag"), "/a"))
    assert "/a: all 30 clouds have the same stamp, 0.000 s" in problem


def test_clocks_that_are_apart(bag_of):
    def problem(name, count, late_ns, off_s=0):
        entries = [*clouds("/a", count), *clouds("/b", count, late_ns=late_ns)]
        for topic, _, message in entries:
            message.header.stamp.sec += off_s if topic == "/b" else 0
        bag = bag_of(sorted(entries, key=lambda entry: entry[1]), name)
        return clock_problem(index_clouds(bag, "/a"), index_clouds(bag, "/b"))

    assert "the stamps of /b are 1000.0 s ahead" in problem("ahead.bag", 30, 4 * 10**7, 1000)
    assert "the stamps of /b are 1000.0 s behind" in problem("behind.bag", 30, 4 * 10**7, -1000)
    assert "share no time" in problem("later.bag", 10, 10**12)
    assert problem("together.bag", 10, 3 * 10**8) is None


def test_a_lidar_that_ends_before_the_drive_is_named(bag_of):
    index = index_clouds(bag_of(clouds("/a", 20)), "/a")
    ends_ns = int(index.stamp_ns[-1])
    assert gap_problem(index, ends_ns + 500_000_000) is None
    assert "/a has no clouds for 3.0 s after 1.9 s" in gap_problem(index, ends_ns + 3 * 10**9)


@pytest.mark.parametrize("names", [("x", "y", "z", "ring", "time"), ("x", "y", "z", "ring")])
def test_scans_do_not_depend_on_the_order_of_points(bag_of, names):
    points = only(sweep(), *names)
    shuffle = np.random.default_rng(0).permutation(len(points))
    orders = enumerate((np.arange(len(points)), shuffle))
    stamped = [(START_NS + i * PERIOD_NS, points[rows]) for i, rows in orders]
    bag = bag_of([("/a", stamp, cloud(rows, stamp)) for stamp, rows in stamped])
    (_, scan), (_, shuffled) = scans_of(bag, "/a")
    np.testing.assert_array_equal(shuffled.points_sensor, scan.points_sensor)
    np.testing.assert_array_equal(shuffled.ring, scan.ring)
    np.testing.assert_array_equal(shuffle[shuffled.cloud_index], scan.cloud_index)
