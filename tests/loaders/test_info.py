"""What a bag is said to hold and to lack."""

import numpy as np

from ffmap.app.commands.info import describe
from ffmap.loaders.cloud_checks import gap_problem
from ffmap.loaders.info import describe_bag, ring_words, time_words
from tests.loaders.bag_builder import PERIOD_NS, START_NS, cloud, clouds, only, sweep, tf_message, write_bag


def test_a_whole_rig(tmp_path):
    entries = [
        *clouds("/h/points", 6, "h"),
        *clouds("/v/points", 6, "v", late_ns=5),
        (
            "/tf_static",
            START_NS,
            tf_message([("base", "h", [0, 0, 1], [0, 0, 0, 1]), ("base", "v", [0, 0, 1], [0.5] * 4)]),
        ),
    ]
    info = describe_bag(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    assert (info.bag.container, info.bag.ros_version, info.bag.duration_s > 0.5) == ("ros1", 1, True)
    assert {t.name: t.count for t in info.bag.topics.values()} == {"/h/points": 6, "/v/points": 6, "/tf_static": 1}
    assert info.tree.frames == ["base", "h", "v"]
    assert (info.rig.horizontal.topic, info.rig.vertical.topic) == ("/h/points", "/v/points")
    found = info.clouds[0]
    assert (found.index.topic, found.decoding.layout.frame_id, len(found.index)) == ("/h/points", "h", 6)
    assert ring_words(found.decoding) == "16 rings, -15.0 to +15.0 deg (from field ring)"
    assert time_words(found.decoding) == "field time in s, relative to the stamp, a sweep spans 98.9 ms"
    assert found.points == (1440, 1440)
    assert describe(info).count("  clouds: 6 at 10.00 Hz") == 2
    assert info.missing == ("truth: no figures can be computed",)
    assert info.rig_problem is None


def test_what_is_missing_is_said(tmp_path):
    entries = []
    for i in (0, 1, 2, 3, 4, 20, 21, 22):
        stamp_ns = START_NS + i * PERIOD_NS
        for topic, frame in (("/a", "x"), ("/b", "y")):
            entries.append((topic, stamp_ns, cloud(only(sweep(seed=i), "x", "y", "z"), stamp_ns, frame)))
    info = describe_bag(write_bag(tmp_path / "a.bag", entries))
    assert info.rig is None
    assert "--rig" in info.rig_problem
    assert info.clouds[0].index.gaps == [(START_NS + 4 * PERIOD_NS, 16 * PERIOD_NS)]
    (line, _) = [line for line in describe(info) if "gap:" in line]
    assert line.strip() == f"gap: 1.60 s after {START_NS / 1e9 + 0.4:.3f} (0.4 s from the first cloud)"
    words = "/a has no clouds for 1.6 s after 0.4 s: the driver or the recorder lost them"
    assert gap_problem(info.clouds[0].index) == words
    text = " ".join(info.missing)
    for part in ("rings on /a", "times on /b", "transforms: several lidars need --rig", "truth"):
        assert part in text


def test_an_empty_bag_and_a_broken_cloud(tmp_path):
    info = describe_bag(write_bag(tmp_path / "empty_mcap", []))
    assert info.missing == ("messages: the bag is empty",)
    assert "empty" in info.rig_problem
    broken = cloud(sweep())
    broken.data = broken.data[:10]
    info = describe_bag(write_bag(tmp_path / "broken.bag", [("/a", START_NS, broken)]))
    assert "truncated" in info.clouds[0].problem
    assert info.clouds[0].points == (0, 0)
    assert info.bag.duration_s == 0.0


def test_bad_clouds_are_counted_and_clocks_apart_are_named(tmp_path):
    entries = [
        *clouds("/h", 30, "h"),
        *clouds("/v", 30, "v", late_ns=5),
        (
            "/tf_static",
            START_NS,
            tf_message([("base", "h", [0, 0, 1], [0, 0, 0, 1]), ("base", "v", [0, 0, 1], [0.5] * 4)]),
        ),
    ]
    truncated = entries[7][2]
    truncated.data = truncated.data[:100]
    for _, _, message in entries[30:60]:
        message.header.stamp.sec += 1000
    info = describe_bag(write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1])))
    ((reason, count),) = info.clouds[0].bad_clouds
    assert (count, info.clouds[0].read_count) == (1, 30)
    assert "truncated" in reason
    assert info.clouds[1].bad_clouds == ()
    assert any(
        "the clocks of /h and /v are apart: the stamps of /v are 1000.0 s ahead" in text for text in info.warnings
    )
    lines = describe(info)
    assert any(
        line.startswith("  unusable: 1 of 30 clouds that were read: /h: the cloud is truncated") for line in lines
    )


def test_of_second_returns_a_line_says_that_the_farther_are_read(tmp_path):
    entries = []
    for topic, stamp_ns, _ in clouds("/a", 4):
        points = sweep(seed=len(entries), columns=12)
        behind = points.copy()
        for axis in "xyz":
            behind[axis] *= 1.5
        entries.append((topic, stamp_ns, cloud(np.concatenate([points, behind]), stamp_ns - PERIOD_NS)))
    info = describe_bag(write_bag(tmp_path / "a.bag", entries))
    assert info.clouds[0].points == (len(points), 2 * len(points))
    assert [line for line in info.warnings if "firings return twice" in line]
