"""Clouds of every layout become the same scan, and labels return to their points."""

import itertools
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffmap.algorithms.base.scan import in_canonical_order
from ffmap.loaders.decoding import decode, settle_decoding
from ffmap.loaders.errors import CloudError
from ffmap.loaders.pointcloud2 import encode_labelled, full_labels, merge_clouds
from tests.loaders.bag_builder import START_NS, VELODYNE, cloud, only, point_dtype, sweep

XYZ = VELODYNE[:3]


def read(message, time_from="auto", period_ns=100_000_000):
    return decode(message, settle_decoding([message], "/points", time_from, period_ns))


def xyz(points):
    return np.stack([points["x"], points["y"], points["z"]], axis=-1).reshape(-1, 3)


def stored(points, fields, big=False, gap=0, **values):
    """The points with other fields or types; values: of new fields."""
    made = np.zeros(points.shape, point_dtype(fields, big, gap))
    for name, _ in fields:
        made[name] = values[name] if name in values else points[name]
    return made


@settings(max_examples=40, deadline=None)
@given(
    order=st.permutations(range(6)),
    big=st.booleans(),
    gap=st.integers(0, 5),
    height=st.sampled_from([1, 4, 16]),
    row_padding=st.integers(0, 9),
    position=st.sampled_from(["f4", "f8"]),
    ring=st.sampled_from(["u1", "u2", "i4", "f4"]),
)
def test_every_layout_gives_the_same_scan(order, big, gap, height, row_padding, position, ring):
    points = sweep(columns=12)
    kinds = dict.fromkeys("xyz", position) | {"intensity": "u1", "ring": ring, "time": "f4"}
    fields = [(VELODYNE[i][0], kinds[VELODYNE[i][0]]) for i in order]
    grid = stored(points, fields, big, gap).reshape(height, -1)
    scan = read(cloud(grid, row_padding=row_padding if height > 1 else 0))
    np.testing.assert_array_equal(scan.points_sensor, xyz(points))
    np.testing.assert_array_equal(scan.ring, points["ring"])
    np.testing.assert_array_equal(scan.time_ns, np.rint(points["time"].astype(np.float64) * 1e9))
    dtypes = (scan.points_sensor.dtype, scan.ring.dtype, scan.time_ns.dtype)
    assert dtypes == (np.float32, np.uint16, np.int64)
    assert (scan.stamp_ns, scan.start_ns) == (START_NS, START_NS)
    assert (scan.cloud_size, scan.ring_count) == (192, 16)


def test_invalid_points_are_removed():
    points = sweep()
    bad = np.random.default_rng(1).random(len(points)) < 0.3
    bad[0] = False
    points["x"][0], points["y"][0] = 0, 0  # On the spin axis
    invalid = [(np.nan, 1, 1), (1, np.inf, 1), (1, 1, -np.inf), (0, 0, 0), (-0.0, 0, 0)]
    for i, values in zip(np.flatnonzero(bad), itertools.cycle(invalid), strict=False):
        points["x"][i], points["y"][i], points["z"][i] = values
    scan = read(cloud(points))
    np.testing.assert_array_equal(scan.cloud_index, np.flatnonzero(~bad))
    np.testing.assert_array_equal(scan.points_sensor, xyz(points[~bad]))
    np.testing.assert_array_equal(scan.ring, points["ring"][~bad])
    assert (len(scan), scan.cloud_size) == (len(scan.time_ns), len(points))


def test_coordinates_beyond_float32_are_invalid():
    points = stored(sweep(), [(axis, "f8") for axis in "xyz"])
    points["x"][:5] = 1e300
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read(cloud(points))) == 1435
    for size in (0, 5):
        scan = read(cloud(np.full(size, np.nan, np.float32).astype(point_dtype(XYZ))))
        assert (len(scan), scan.cloud_size) == (0, size)


def test_rows_and_columns_of_an_organised_cloud_are_rings():
    grid = only(sweep(columns=40), "x", "y", "z").reshape(40, 16)
    rings = np.tile(np.arange(16), (40, 1))
    np.testing.assert_array_equal(read(cloud(grid)).ring, rings.ravel())
    np.testing.assert_array_equal(read(cloud(grid.T[::-1])).ring, rings.T[::-1].ravel())


def test_rings_are_numbered_upwards():
    points = sweep()
    upwards = points["ring"].copy()
    for numbers in (15 - np.arange(16), np.argsort(np.arange(16) * 7 % 16), np.zeros(16)):
        points["ring"] = numbers[upwards]
        np.testing.assert_array_equal(read(cloud(points)).ring, upwards)


def test_no_times():
    scan = read(cloud(only(sweep(), "x", "y", "z")))
    assert scan.time_ns is None
    assert scan.start_ns == scan.end_ns == START_NS
    assert read(cloud(sweep()), time_from="none").time_ns is None


@pytest.mark.parametrize("packets", [1, 75])
def test_an_empty_field_of_times_hides_no_other(packets):
    points = sweep(columns=900)
    true_ns = np.arange(len(points)) // 16 * 111_111
    fields = [*XYZ, ("time", "f4"), ("timestamp", "f8")]
    made = stored(points, fields, time=0, timestamp=(START_NS + true_ns) / 1e9)
    parts = [cloud(part, START_NS) for part in np.split(made, packets)]
    message = merge_clouds(parts) if packets > 1 else parts[0]
    assert settle_decoding([message], "/points").time.name == "timestamp"
    assert np.abs(read(message).time_ns - true_ns).max() <= 1000


@pytest.mark.parametrize(
    ("layout", "clockwise"),
    [("firing order", True), ("firing order", False), ("ring by ring", True), ("organised", False)],
)
def test_times_from_the_azimuth(clockwise, layout):
    points = sweep(columns=200, clockwise=clockwise)
    true_ns = np.rint(points["time"].astype(np.float64) * 1e9).astype(np.int64)
    shape = np.arange(len(points)).reshape(200, 16)
    order = shape.ravel() if layout == "firing order" else shape.T.ravel()
    points, true_ns = points[order], true_ns[order]
    # A fifth of the points is missing, as through windows; the first column is, too.
    points["x"][np.random.default_rng(0).random(len(points)) < 0.2] = np.nan
    grid = points.reshape(16, 200) if layout == "organised" else points
    scan = read(cloud(only(grid, "x", "y", "z")), time_from="azimuth")
    assert np.abs(scan.time_ns - true_ns[scan.cloud_index]).max() <= 1_000_000
    assert scan.time_ns.min() >= 0


def broken(**changes):
    return replace(cloud(sweep()), **changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"data": cloud(sweep()).data[:-5]}, "truncated"),
        ({"width": 2000}, "truncated"),
        ({"point_step": 2**32 - 1}, "truncated"),
        ({"point_step": 20}, "field time ends at byte 22, beyond point_step 20"),
        ({"fields": cloud(sweep()).fields[1:]}, "no field x"),
        ({"fields": []}, "no field x y z"),
        ({"height": 2, "width": 700, "row_step": 100}, "row_step"),
        ({"fields": [replace(cloud(sweep()).fields[0], datatype=77)]}, "unknown datatype 77"),
    ],
)
def test_an_inconsistent_cloud(changes, words):
    with pytest.raises(CloudError) as caught:
        settle_decoding([broken(**changes)], "/points")
    text = str(caught.value)
    assert text.startswith("/points: ")
    assert words in text
    assert "\n" not in text
    good = settle_decoding([broken(**changes), cloud(sweep())], "/points")
    assert good.rings.count == 16
    with pytest.raises(CloudError):
        decode(broken(**changes), good)


@pytest.mark.parametrize(
    ("padding", "height", "big"), [(0, 1, False), (0, 16, True), (6, 16, False)]
)
def test_labels_are_appended_and_nothing_else_changes(padding, height, big):
    points = sweep(columns=12).astype(point_dtype(VELODYNE, big, gap=3))
    points["x"][5] = np.nan
    message = cloud(points.reshape(height, -1), row_padding=padding)
    scan = read(message)
    label = (np.arange(len(scan)) % 6).astype(np.uint8)
    full = full_labels(scan.cloud_size, scan.cloud_index, label)
    assert full[5] == 255
    zeros = np.zeros_like(full)
    once = encode_labelled(message, zeros, zeros)
    for labelled in (encode_labelled(message, full, 255 - full), encode_labelled(once, full, full)):
        names = [field.name for field in labelled.fields]
        assert names == [*(field.name for field in message.fields), "label", "label_scan"]
        assert len(labelled.data) == labelled.height * labelled.row_step
        again = read(labelled)
        for name in ("points_sensor", "ring", "time_ns", "cloud_index"):
            np.testing.assert_array_equal(getattr(again, name), getattr(scan, name))
        data = labelled.data.reshape(-1, labelled.point_step)
        np.testing.assert_array_equal(data[:, -2], full)
    with pytest.raises(ValueError, match="labels for a cloud"):
        encode_labelled(message, zeros[1:], zeros[1:])
    empty = cloud(sweep()[:0])
    assert len(encode_labelled(empty, zeros[:0], zeros[:0]).data) == 0


@pytest.mark.parametrize(
    ("big", "kind", "value", "unit"),
    [(False, None, 0, "s"), (True, "u4", 7, "ns"), (True, "f4", 0, "s")],
)
def test_parts_without_their_own_times_have_those_of_their_stamps(big, kind, value, unit):
    """Whole milliseconds are the same within a part; a field that is not filled is 0."""
    fields = [*XYZ, ("time", kind)] if kind else XYZ
    made = stored(sweep(), fields, big, time=value)
    parts = [cloud(part, START_NS + i * 1_111_111) for i, part in enumerate(np.split(made, 90))]
    message = merge_clouds(parts)
    scan = read(message)
    np.testing.assert_array_equal(scan.points_sensor, xyz(sweep()))
    assert np.abs(scan.time_ns - np.repeat(np.arange(90) * 1_111_111, 16)).max() <= 10
    assert settle_decoding([message], "/points").time.unit == unit
    assert scan.stamp_ns == START_NS
    if kind == "u4":
        short = made.astype(point_dtype([*XYZ, ("time", "u2")]))
        parts = [cloud(p, START_NS + i * 1_111_111) for i, p in enumerate(np.split(short, 90))]
        with pytest.raises(CloudError, match="field time is too short an integer"):
            merge_clouds(parts)


PART_TIMES = {
    "seconds": ("time", "f4", 10**9, "part", "s"),
    "float nanoseconds": ("timestamp", "f8", 1, "part", "s"),
    "integer nanoseconds": ("t", "u4", 1, "part", "ns"),
    "integer microseconds": ("time", "u4", 10**3, "part", "ns"),
    "absolute seconds": ("timestamp", "f8", 10**9, "epoch", "s"),
    "revolution's start, microseconds": ("time", "u4", 10**3, "revolution", "us"),
    "own clock, microseconds": ("timestamp", "u4", 10**3, "own clock", "us"),
}


@pytest.mark.parametrize("name", PART_TIMES)
def test_parts_of_a_revolution_keep_their_times(name):
    field, kind, unit_ns, reference, unit = PART_TIMES[name]
    points = sweep(columns=900)
    true_ns = np.arange(len(points)) // 16 * 111_111
    start_ns = {"part": 0, "epoch": START_NS, "own clock": 1_234_567_000_000, "revolution": 0}
    made = stored(points, [*XYZ, (field, kind)], **{field: 0})
    parts = []
    for place in np.split(np.arange(len(points)), 75):
        since_ns = start_ns[reference] + true_ns[place]
        since_ns -= true_ns[place[0]] if reference == "part" else 0
        made[field][place] = since_ns // unit_ns if kind == "u4" else since_ns / unit_ns
        parts.append(cloud(made[place], START_NS + int(true_ns[place[0]])))
    message = merge_clouds(parts)
    assert settle_decoding([message], "/points").time.unit == unit
    assert np.abs(read(message).time_ns - true_ns).max() <= 1000


def test_a_cloud_unlike_the_others_of_its_topic_gives_no_scan():
    sound = [cloud(sweep(seed=i)) for i in range(7)]
    other_rings, stretched = sweep(), sweep()
    other_rings["ring"] = 65535
    stretched["time"] *= 19
    whole_times = stored(sweep(), [*XYZ, ("ring", "u2"), ("time", "u4")])
    for odd, reason in (
        (cloud(other_rings), "65535 to 65535, where the topic's other clouds have 16 rings"),
        (cloud(only(sweep(), "x", "y", "z", "time")), "no field with rings"),
        (cloud(whole_times), "of another type"),
        (cloud(stretched), r"time span 1\.\d+ s, where a sweep takes 0\.10 s"),
    ):
        decoding = settle_decoding([odd, *sound], "/points", period_ns=100_000_000)
        assert (decoding.rings.source, decoding.rings.count) == ("field", 16)
        assert decoding.time.unit == "s"
        with pytest.raises(CloudError, match=reason):
            decode(odd, decoding)
        assert len(decode(sound[0], decoding)) == 1440


def test_an_organised_cloud_of_another_shape_gives_no_scan():
    def organised(columns):
        return only(sweep(columns), "x", "y", "z").reshape(columns, 16).T.copy()

    flat = cloud(organised(90).reshape(1, -1))
    decoding = settle_decoding([flat, *(cloud(organised(90)) for _ in range(4))], "/points")
    assert (decoding.rings.source, decoding.rings.count) == ("row", 16)
    with pytest.raises(CloudError, match="1 rows, where the topic's other clouds have 16"):
        decode(flat, decoding)
    assert decode(cloud(organised(45)), decoding).ring_count == 16


@pytest.mark.parametrize(
    ("fields", "used"),
    [
        ({"intensity": "f4"}, "intensity"),
        ({"Intensity": "u2"}, "Intensity"),
        ({"intensity": "f4", "reflectivity": "u2"}, "reflectivity"),
        ({}, None),
    ],
)
def test_intensities(fields, used):
    points = sweep(columns=12)
    values = {name: np.arange(len(points)) % 200 + k for k, name in enumerate(fields)}
    made = stored(points, [*XYZ, *VELODYNE[4:], *fields.items()], **values)
    made["x"][::7] = np.nan
    scan = read(cloud(made))
    if used is None:
        assert scan.intensity is None
        return
    np.testing.assert_array_equal(scan.intensity, made[used][scan.cloud_index])
    assert scan.intensity.dtype == np.float32
    decoding = settle_decoding([cloud(made)] * 3, "/points")
    bare = cloud(stored(points, [*XYZ, *VELODYNE[4:]]))
    assert np.isnan(decode(bare, decoding).intensity).all()
    made[used] = 1
    assert settle_decoding([cloud(made)], "/points").intensity != used


@pytest.mark.parametrize("order", ["in turns", "one after the other", "any"])
def test_of_two_returns_of_a_firing_the_farther_is_read(order):
    first = sweep(columns=12)
    second = first[::4].copy()
    for axis in "xyz":
        second[axis] *= np.float32(1.5)
    points = np.concatenate([first, second, first[1::4]])  # The last are measured twice
    rank = np.arange(len(first))
    rank = np.concatenate([rank, rank[::4] + 0.5, rank[1::4] + 0.5])
    places = {"in turns": np.argsort(rank), "one after the other": np.arange(len(points))}
    points = points[places.get(order, np.random.default_rng(3).permutation(len(points)))]
    farther = first.copy()
    farther[::4] = second
    scan, expected = (in_canonical_order(read(cloud(own))) for own in (points, farther))
    assert scan.cloud_size == len(points)
    np.testing.assert_array_equal(xyz(points)[scan.cloud_index], scan.points_sensor)
    for name in ("points_sensor", "ring", "time_ns"):
        np.testing.assert_array_equal(getattr(scan, name), getattr(expected, name))
    # A few second returns are chance.
    few = np.repeat(first, 2)
    few["x"][:19] *= np.float32(1.5)
    assert len(read(cloud(few))) == len(few)
