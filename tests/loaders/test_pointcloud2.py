"""Clouds of every layout become the same scan, and labels find their way back to their points."""

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
from ffmap.loaders.pointcloud2 import describe_layout, encode_labelled, full_labels, merge_clouds
from tests.loaders.bag_builder import START_NS, VELODYNE, cloud, only, point_dtype, sweep


def read(message, time_from="auto", period_ns=100_000_000):
    return decode(message, settle_decoding([message], "/points", time_from, period_ns))


def xyz(points):
    return np.stack([points["x"], points["y"], points["z"]], axis=-1).reshape(-1, 3)


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
    kinds = {"x": position, "y": position, "z": position, "intensity": "u1", "ring": ring, "time": "f4"}
    fields = [(VELODYNE[i][0], kinds[VELODYNE[i][0]]) for i in order]
    stored = np.zeros(points.shape, point_dtype(fields, big, gap))
    for name, _ in fields:
        stored[name] = points[name]
    message = cloud(stored.reshape(height, -1), row_padding=row_padding if height > 1 else 0)
    scan = read(message)
    np.testing.assert_array_equal(scan.points_sensor, xyz(points))
    np.testing.assert_array_equal(scan.ring, points["ring"])
    np.testing.assert_array_equal(scan.time_ns, np.rint(points["time"].astype(np.float64) * 1e9))
    assert (scan.points_sensor.dtype, scan.ring.dtype, scan.time_ns.dtype) == (np.float32, np.uint16, np.int64)
    assert (scan.stamp_ns, scan.start_ns, scan.cloud_size, scan.ring_count) == (START_NS, START_NS, 192, 16)


def test_one_mask_drops_invalid_points_and_keeps_the_rest_aligned():
    points = sweep()
    rng = np.random.default_rng(1)
    bad = rng.random(len(points)) < 0.3
    kinds = itertools.cycle([(np.nan, 1, 1), (1, np.inf, 1), (1, 1, -np.inf), (0, 0, 0), (-0.0, 0, 0)])
    for i in np.flatnonzero(bad):
        points["x"][i], points["y"][i], points["z"][i] = next(kinds)
    scan = read(cloud(points))
    np.testing.assert_array_equal(scan.cloud_index, np.flatnonzero(~bad))
    np.testing.assert_array_equal(scan.points_sensor, xyz(points[~bad]))
    np.testing.assert_array_equal(scan.ring, points["ring"][~bad])
    assert len(scan) == len(scan.time_ns)
    assert scan.cloud_size == len(points)
    assert np.isfinite(scan.points_sensor).all()


def test_a_point_on_an_axis_is_valid():
    points = sweep()
    points["x"][0], points["y"][0], points["z"][0] = 0, 0, 2
    assert read(cloud(points)).cloud_index[0] == 0


@pytest.mark.parametrize("size", [0, 5])
def test_degenerate_clouds_give_an_empty_scan(size):
    points = np.full(size, np.nan, np.float32).astype(point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4")]))
    scan = read(cloud(points))
    assert len(scan) == 0
    assert scan.cloud_size == size


def test_rows_of_an_organised_cloud_are_the_rings():
    points = only(sweep(columns=40), "x", "y", "z").reshape(40, 16).T[::-1]
    scan = read(cloud(points))
    np.testing.assert_array_equal(scan.ring.reshape(16, 40), np.arange(16)[::-1, None] * np.ones((1, 40)))


def test_columns_of_an_organised_cloud_are_the_rings():
    scan = read(cloud(only(sweep(columns=40), "x", "y", "z").reshape(40, 16)))
    np.testing.assert_array_equal(scan.ring.reshape(40, 16), np.arange(16) * np.ones((40, 1)))


def test_rings_are_numbered_upwards_whatever_the_driver_does():
    points = sweep()
    upwards = points["ring"].copy()
    for renumbering in (15 - np.arange(16), np.argsort(np.arange(16) * 7 % 16)):
        points["ring"] = renumbering[upwards]
        np.testing.assert_array_equal(read(cloud(points)).ring, upwards)


def test_a_ring_field_that_is_not_filled_is_not_believed():
    points = sweep()
    upwards = points["ring"].copy()
    points["ring"] = 0
    np.testing.assert_array_equal(read(cloud(points)).ring, upwards)


def test_no_time_field():
    scan = read(cloud(only(sweep(), "x", "y", "z")))
    assert scan.time_ns is None
    assert scan.start_ns == scan.end_ns == START_NS
    assert read(cloud(sweep()), time_from="none").time_ns is None


@pytest.mark.parametrize("packets", [1, 75])
def test_a_time_field_that_is_not_filled_hides_no_other(packets):
    points = sweep(columns=900)
    stored = np.zeros(len(points), point_dtype([*VELODYNE, ("timestamp", "f8")]))
    for name in "xyz":
        stored[name] = points[name]
    true_ns = np.arange(len(points)) // 16 * 111_111
    stored["timestamp"] = (START_NS + true_ns) / 1e9
    parts = [cloud(part, START_NS) for part in np.split(stored, packets)]
    message = merge_clouds(parts) if packets > 1 else parts[0]
    assert settle_decoding([message], "/points").time.name == "timestamp"
    assert np.abs(read(message).time_ns - true_ns).max() <= 1000


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize("layout", ["firing order", "ring by ring", "organised"])
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
    ("message", "words"),
    [
        (lambda: broken(data=cloud(sweep()).data[:-5]), "truncated"),
        (lambda: broken(width=2000), "truncated"),
        (lambda: broken(point_step=20), "field time ends at byte 22, beyond point_step 20"),
        (lambda: broken(fields=cloud(sweep()).fields[1:]), "no field x"),
        (lambda: broken(fields=[]), "no field x y z"),
        (lambda: broken(height=2, width=700, row_step=100), "row_step"),
        (lambda: broken(fields=[replace(cloud(sweep()).fields[0], datatype=77)]), "unknown datatype 77"),
    ],
)
def test_a_cloud_that_contradicts_itself(message, words):
    with pytest.raises(CloudError) as caught:
        settle_decoding([message()], "/points")
    text = str(caught.value)
    assert words in text
    assert text.startswith("/points: ")
    assert "\n" not in text
    good = settle_decoding([cloud(sweep())], "/points")
    with pytest.raises(CloudError):
        decode(message(), good)


def test_one_broken_cloud_among_sound_ones_does_not_matter():
    decoding = settle_decoding([broken(width=9999), cloud(sweep())], "/points")
    assert decoding.rings.count == 16


def test_zero_row_step_and_zero_count_are_forgiven():
    message = cloud(sweep().reshape(16, -1))
    fields = [replace(field, count=0) for field in message.fields]
    assert len(read(replace(message, row_step=0, fields=fields))) == 1440


@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("height", [1, 16])
@pytest.mark.parametrize("big", [False, True])
def test_labels_are_appended_and_nothing_else_changes(padding, height, big):
    points = sweep(columns=12).astype(point_dtype(VELODYNE, big))
    points["x"][5] = np.nan
    message = cloud(points.reshape(height, -1), row_padding=padding if height > 1 else 0)
    scan = read(message)
    label = (np.arange(len(scan)) % 6).astype(np.uint8)
    full = full_labels(scan.cloud_size, scan.cloud_index, label)
    labelled = encode_labelled(message, full, 5 - np.minimum(full, 5))
    assert full[5] == 255
    assert labelled.header == message.header
    assert [f.name for f in labelled.fields] == [*(f.name for f in message.fields), "label", "label_scan"]
    assert labelled.point_step == message.point_step + 2
    assert len(labelled.data) == labelled.height * labelled.row_step
    again = read(labelled)
    for name in ("points_sensor", "ring", "time_ns", "cloud_index"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scan, name))
    stored = labelled.data.reshape(-1, labelled.point_step)
    np.testing.assert_array_equal(stored[:, -2], full)
    np.testing.assert_array_equal(stored[scan.cloud_index, -1], 5 - label)


def test_labelling_a_labelled_cloud_names_each_field_once():
    message = cloud(sweep())
    zeros = np.zeros(message.width, np.uint8)
    twice = encode_labelled(encode_labelled(message, zeros, zeros), zeros + 3, zeros)
    assert [f.name for f in twice.fields].count("label") == 1
    assert set(twice.data.reshape(-1, twice.point_step)[:, -2]) == {3}


def test_labels_of_an_empty_cloud_and_of_a_wrong_number():
    empty = cloud(sweep()[:0])
    nothing = np.zeros(0, np.uint8)
    assert len(encode_labelled(empty, nothing, nothing).data) == 0
    with pytest.raises(ValueError, match="labels for a cloud"):
        encode_labelled(cloud(sweep()), nothing, nothing)


@pytest.mark.parametrize("big", [False, True])
def test_parts_of_a_revolution_are_joined_with_their_stamps_as_times(big):
    points = only(sweep(), "x", "y", "z").astype(point_dtype(VELODYNE[:3], big))
    parts = [cloud(part, START_NS + i * 1_000_000) for i, part in enumerate(np.split(points, 90))]
    scan = read(merge_clouds(parts))
    np.testing.assert_array_equal(scan.points_sensor, xyz(points))
    assert np.abs(scan.time_ns - np.repeat(np.arange(90) * 1_000_000, 16)).max() <= 10
    assert scan.stamp_ns == START_NS


OWN_CLOCK_NS = 1_234_567_000_000
PART_TIMES = {
    "seconds": ("time", "f4", 10**9, "part", "s"),
    "milliseconds": ("time", "f4", 10**6, "part", "s"),
    "float nanoseconds": ("timestamp", "f8", 1, "part", "s"),
    "integer nanoseconds": ("t", "u4", 1, "part", "ns"),
    "integer microseconds": ("time", "u4", 10**3, "part", "ns"),
    "absolute seconds": ("timestamp", "f8", 10**9, "epoch", "s"),
    "from the revolution's start, microseconds": ("time", "u4", 10**3, "revolution", "us"),
    "own clock, microseconds": ("timestamp", "u4", 10**3, "own clock", "us"),
}


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("name", PART_TIMES)
def test_parts_of_a_revolution_keep_their_times_whatever_the_unit(name, big):
    field, kind, unit_ns, reference, unit = PART_TIMES[name]
    points = sweep(columns=900)
    true_ns = np.arange(len(points)) // 16 * 111_111
    stored = np.zeros(len(points), point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), (field, kind)], big))
    for axis in "xyz":
        stored[axis] = points[axis]
    parts = []
    for place in np.split(np.arange(len(points)), 75):
        start_ns = {"part": -true_ns[place[0]], "epoch": START_NS, "own clock": OWN_CLOCK_NS, "revolution": 0}[
            reference
        ]
        since_ns = start_ns + true_ns[place]
        stored[field][place] = since_ns // unit_ns if kind == "u4" else since_ns / unit_ns
        parts.append(cloud(stored[place], START_NS + int(true_ns[place[0]])))
    message = merge_clouds(parts)
    assert settle_decoding([message], "/points").time.unit == unit
    assert np.abs(read(message).time_ns - true_ns).max() <= 1000


def test_parts_whose_times_tell_no_unit_are_timed_by_their_stamps():
    """Whole milliseconds are the same within a part; a field that is not filled is 0."""
    points = sweep()
    for kind, value, unit in (("u4", 7, "ns"), ("f4", 0.0, "s")):
        stored = np.zeros(len(points), point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", kind)]))
        for axis in "xyz":
            stored[axis] = points[axis]
        stored["time"] = value
        message = merge_clouds([cloud(part, START_NS + i * 1_111_111) for i, part in enumerate(np.split(stored, 90))])
        assert settle_decoding([message], "/points").time.unit == unit
        assert np.abs(read(message).time_ns - np.repeat(np.arange(90) * 1_111_111, 16)).max() <= 10
    short = stored.astype(point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", "u2")]))
    with pytest.raises(CloudError, match="field time is too short an integer"):
        merge_clouds([cloud(part, START_NS + i * 1_111_111) for i, part in enumerate(np.split(short, 90))])


def test_layout_says_what_is_there():
    layout = describe_layout(cloud(sweep().reshape(16, -1), frame="/lidar"), "/points")
    assert (layout.frame_id, layout.ring_field, layout.time_fields, layout.height > 1) == ("lidar", "ring", ("time",), True)
    assert [(name, *layout.point.fields[name]) for name in layout.point.names][-2:] == [
        ("ring", np.dtype("<u2"), 16),
        ("time", np.dtype("<f4"), 18),
    ]


def test_a_cloud_unlike_the_others_of_its_topic_gives_no_scan():
    sound = [cloud(sweep(seed=i)) for i in range(7)]
    other_rings = sweep()
    other_rings["ring"] = 65535
    whole_times = np.zeros(1440, point_dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", "u4")]))
    for name in ("x", "y", "z", "ring"):
        whole_times[name] = sweep()[name]
    for odd, reason in (
        (cloud(other_rings), "65535 to 65535, where the topic's other clouds have 16 rings"),
        (cloud(only(sweep(), "x", "y", "z", "time")), "no field with rings"),
        (cloud(whole_times), "of another type"),
    ):
        decoding = settle_decoding([odd, *sound], "/points")
        assert (decoding.rings.source, decoding.rings.count, decoding.time.unit) == ("field", 16, "s")
        with pytest.raises(CloudError, match=reason):
            decode(odd, decoding)
        assert len(decode(sound[0], decoding)) == 1440


def test_a_cloud_whose_times_reach_far_into_the_clouds_after_it_gives_no_scan():
    sound = [cloud(sweep(seed=i)) for i in range(7)]
    stretched = sweep()
    stretched["time"] *= 19
    decoding = settle_decoding(sound, "/points", period_ns=100_000_000)
    with pytest.raises(CloudError, match=r"time span 1\.\d+ s, where a sweep takes 0\.10 s"):
        decode(cloud(stretched), decoding)
    assert len(decode(sound[0], decoding)) == 1440


def test_an_organised_cloud_of_another_shape_gives_no_scan():
    def organised(columns):
        return only(sweep(columns), "x", "y", "z").reshape(columns, 16).T.copy()

    sound = [cloud(organised(90)) for _ in range(4)]
    flat = cloud(organised(90).reshape(1, -1))
    decoding = settle_decoding([flat, *sound], "/points")
    assert (decoding.rings.source, decoding.rings.count) == ("row", 16)
    with pytest.raises(CloudError, match="1 rows, where the topic's other clouds have 16"):
        decode(flat, decoding)
    assert decode(cloud(organised(45)), decoding).ring_count == 16


def test_coordinates_beyond_float32_are_no_returns():
    kinds = [("x", "f8"), ("y", "f8"), ("z", "f8")]
    points = np.zeros(1440, point_dtype(kinds))
    for axis in "xyz":
        points[axis] = sweep()[axis]
    points["x"][:5] = 1e300
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(read(cloud(points))) == 1435


@pytest.mark.parametrize(
    ("fields", "taken"),
    [
        ({"intensity": "f4"}, "intensity"),
        ({"Intensity": "u2"}, "Intensity"),
        ({"intensity": "f4", "reflectivity": "u2"}, "reflectivity"),
        ({}, None),
    ],
)
def test_an_intensity_comes_with_each_return(fields, taken):
    points = sweep(columns=12)
    stored = np.zeros(points.shape, point_dtype([*VELODYNE[:3], *VELODYNE[4:], *fields.items()]))
    for name, _ in (*VELODYNE[:3], *VELODYNE[4:]):
        stored[name] = points[name]
    stored["x"][::7] = np.nan
    for k, name in enumerate(fields):
        stored[name] = np.arange(len(stored)) % 200 + k
    scan = read(cloud(stored))
    if taken is None:
        assert scan.intensity is None
    else:
        np.testing.assert_array_equal(scan.intensity, stored[taken][scan.cloud_index])
        assert scan.intensity.dtype == np.float32


def test_an_intensity_that_never_varies_is_none():
    points = sweep(columns=12)
    points["intensity"] = 1.0
    assert read(cloud(points)).intensity is None


def test_clouds_without_the_field_of_the_others_have_unknown_intensities():
    points = sweep(columns=12)
    points["intensity"] = np.arange(len(points))
    bare = np.zeros(points.shape, point_dtype([*VELODYNE[:3], *VELODYNE[4:]]))
    for name in bare.dtype.names:
        bare[name] = points[name]
    decoding = settle_decoding([cloud(points)] * 3, "/points")
    assert np.isnan(decode(cloud(bare), decoding).intensity).all()


@pytest.mark.parametrize("order", ["in turns", "one after the other", "any"])
def test_of_two_returns_of_a_firing_the_farther_is_read(order):
    first = sweep(columns=12)
    second = first[::4].copy()
    for axis in "xyz":
        second[axis] *= np.float32(1.5)
    same = first[1::4].copy()  # Measured twice
    points = np.concatenate([first, second, same])
    rank = np.concatenate([np.arange(len(first)), np.arange(0, len(first), 4) + 0.5, np.arange(1, len(first), 4) + 0.5])
    places = {"in turns": np.argsort(rank), "one after the other": np.arange(len(points))}
    points = points[places.get(order, np.random.default_rng(3).permutation(len(points)))]
    farther = first.copy()
    farther[::4] = second
    scan, expected = (in_canonical_order(read(cloud(own))) for own in (points, farther))
    assert scan.cloud_size == len(points)
    np.testing.assert_array_equal(xyz(points)[scan.cloud_index], scan.points_sensor)
    for name in ("points_sensor", "ring", "time_ns"):
        np.testing.assert_array_equal(getattr(scan, name), getattr(expected, name))


def test_a_few_second_returns_are_chance():
    points = np.repeat(sweep(columns=12), 2)
    points["x"][:19] *= np.float32(1.5)
    assert not settle_decoding([cloud(points)], "/points").dual
    assert len(read(cloud(points))) == len(points)
