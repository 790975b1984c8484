"""ffmap info: what a bag contains and lacks."""

import numpy as np
import pytest

from ffmap.app.commands.info import describe
from tests.loaders.bag_builder import (
    PERIOD_NS,
    START_NS,
    cloud,
    clouds,
    only,
    sweep,
    tf_message,
    write_bag,
)

EDGES = [("base", "h", [0, 0, 1], [0, 0, 0, 1]), ("base", "v", [0, 0, 1], [0.5] * 4)]


def entries(count):
    static = ("/tf_static", START_NS, tf_message(EDGES))
    return [*clouds("/h", count, "h"), *clouds("/v", count, "v", late_ns=5), static]


@pytest.fixture
def info(tmp_path):
    """Write a bag and describe it."""

    def describe_entries(made, name="a.bag"):
        return describe(write_bag(tmp_path / name, sorted(made, key=lambda entry: entry[1])))

    return describe_entries


def test_a_whole_rig(info):
    lines = info(entries(6))
    assert lines[0].endswith("a.bag: ros1, ROS 1, 0.4 MB, 0.6 s")
    for line, count in {
        "lidar /h": 1,
        "  frame: h": 1,
        "  clouds: 6 at 10.00 Hz": 2,
        "  rings: 16 rings, -15.0 to +15.0 deg (from field ring)": 2,
        "  times: field time in s, relative to the stamp, a sweep spans 98.9 ms": 2,
        "  horizontal: /h (its spin axis is nearest to gravity (0.0 deg off))": 1,
        "  vertical: /v (its spin axis is nearest to level (0.0 deg off))": 1,
        "  base -> v": 1,
        "  ground truth: no figures can be computed": 1,
    }.items():
        assert lines.count(line) == count, line
    assert sum(line.startswith("  points: 1440 valid of 1440") for line in lines) == 2
    assert "warnings" not in lines


def test_missing_data_is_named(info):
    made = []
    for i in (0, 1, 2, 3, 4, 20, 21, 22):
        stamp_ns = START_NS + i * PERIOD_NS
        for topic, frame in (("/a", "x"), ("/b", "y")):
            points = only(sweep(seed=i), "x", "y", "z")
            made.append((topic, stamp_ns, cloud(points, stamp_ns, frame)))
    lines = info(made)
    gap = f"  gap: 1.60 s after {START_NS / 1e9 + 0.4:.3f} (0.4 s from the first cloud)"
    assert lines.count(gap) == 2
    text = "\n".join(lines[lines.index("missing") :])
    for part in ("rings on /a", "times on /b", "transforms: several lidars need --rig", "truth"):
        assert part in text
    assert any(line.startswith("  not found: ") and "--rig" in line for line in lines)


def test_an_empty_bag_and_a_broken_cloud(info):
    assert "  messages: the bag is empty" in info([], "empty_mcap")
    broken = cloud(sweep())
    broken.data = broken.data[:10]
    lines = info([("/a", START_NS, broken)], "broken.bag")
    assert any(line.startswith("  problem: /a: the cloud is truncated") for line in lines)


def test_bad_clouds_are_counted_and_clocks_are_compared(info):
    made = entries(30)
    made[7][2].data = made[7][2].data[:100]
    for topic, _, message in made:
        if topic == "/v":
            message.header.stamp.sec += 1000
    text = "\n".join(info(made))
    assert text.count("unusable: ") == 1
    assert "  unusable: 1 of 30 clouds that were read: /h: the cloud is truncated" in text
    assert "the clocks of /h and /v are apart: the stamps of /v are 1000.0 s ahead" in text


def test_second_returns_are_named(info):
    made = []
    for topic, stamp_ns, _ in clouds("/a", 4):
        points = sweep(seed=len(made), columns=12)
        behind = points.copy()
        for axis in "xyz":
            behind[axis] *= 1.5
        both = np.concatenate([points, behind])
        made.append((topic, stamp_ns, cloud(both, stamp_ns - PERIOD_NS)))
    lines = info(made)
    assert any(line.startswith("  points: 192 valid of 384") for line in lines)
    assert any("firings return twice" in line for line in lines)
