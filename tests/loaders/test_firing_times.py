"""Every driver's times become the same nanoseconds."""

import numpy as np
import pytest

from ffmap.loaders.decoding import decode, settle_decoding
from ffmap.loaders.errors import CloudError
from ffmap.loaders.firing_times import find_time_field
from tests.loaders.bag_builder import START_NS, cloud, point_dtype, sweep

TRUE_NS = np.arange(1440) // 16 * 1_111_111
EPOCH_S = START_NS / 1e9
LAYOUTS = {
    "velodyne, from the start": ("time", "f4", TRUE_NS * 1e-9, "s", "stamp", 0, 10),
    "velodyne, up to the end": ("time", "f4", TRUE_NS * 1e-9 - 0.1, "s", "stamp", -(10**8), 10),
    "ouster": ("t", "u4", TRUE_NS, "ns", "stamp", 0, 0),
    "hesai, robosense": ("timestamp", "f8", EPOCH_S + TRUE_NS * 1e-9, "s", "epoch", 0, 500),
    "ends at the stamp": (
        "timestamp",
        "f8",
        EPOCH_S - 0.1 + TRUE_NS * 1e-9,
        "s",
        "epoch",
        -(10**8),
        500,
    ),
    "absolute nanoseconds": ("timestamp", "f8", START_NS + 1.0 * TRUE_NS, "ns", "epoch", 0, 600),
    "microseconds": ("t", "u4", TRUE_NS // 1000, "us", "stamp", 0, 1000),
    "milliseconds": ("time", "f4", TRUE_NS * 1e-6, "ms", "stamp", 0, 10),
    "sensor's own clock": ("timestamp", "f8", 5000.0 + TRUE_NS * 1e-9, "s", "own clock", 0, 10),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_times_of_every_driver(name):
    field, kind, values, unit, reference, start_ns, within_ns = LAYOUTS[name]
    points = sweep()
    fields = [("x", "f4"), ("y", "f4"), ("z", "f4"), (field, kind)]
    stored = np.zeros(len(points), point_dtype(fields))
    for axis in "xyz":
        stored[axis] = points[axis]
    stored[field] = values
    stored["x"][::7] = np.nan
    message = cloud(stored)
    decoding = settle_decoding([message], "/points")
    assert (decoding.time.unit, decoding.time.reference) == (unit, reference)
    scan = decode(message, decoding)
    first = TRUE_NS[scan.cloud_index].min()
    assert np.abs(scan.time_ns - (TRUE_NS[scan.cloud_index] - first)).max() <= within_ns
    assert (
        abs(scan.start_ns - (START_NS + start_ns + (first if reference != "own clock" else 0)))
        <= within_ns
    )
    assert scan.time_ns.min() == 0


def test_a_field_that_is_not_filled_is_no_time():
    assert find_time_field("time", [(np.zeros(100, np.float32), START_NS)] * 3) is None
    assert find_time_field("time", [(np.full(100, np.nan, np.float32), START_NS)]) is None
    assert find_time_field("time", []) is None
    mixed = [
        (np.array([0, np.nan], np.float32), START_NS),
        (np.linspace(0, 0.1, 9, dtype=np.float32), START_NS),
    ]
    assert find_time_field("time", mixed).unit == "s"


def test_unit_of_poor_clouds_and_of_other_integers():
    assert find_time_field("t", [(np.array([10, 12], np.uint32), START_NS)]).unit == "ns"
    assert find_time_field("time", [(np.array([0.0, 0.001], np.float32), START_NS)]).unit == "s"
    short = [(np.array([0, 3000], np.uint32), START_NS)]
    assert find_time_field("time", short) is None
    ticks_of_100_ns = [(np.arange(0, 1_000_000, 1000, dtype=np.uint32), START_NS)]
    assert find_time_field("time", ticks_of_100_ns, period_ns=100_000_000) is None
    assert find_time_field("time", ticks_of_100_ns, period_ns=1_000_000_000).unit == "us"


def test_times_longer_than_a_sweep_are_an_error():
    field = find_time_field("time", [(np.linspace(0, 0.1, 100, dtype=np.float32), START_NS)])
    with pytest.raises(CloudError, match=r"span 900\.0 s"):
        field.nanoseconds(np.array([0.0, 900.0], np.float32), START_NS)
    with pytest.raises(CloudError):
        field.nanoseconds(np.array([0.0, np.nan], np.float32), START_NS)
    assert field.nanoseconds(np.zeros(0, np.float32), START_NS)[1] == START_NS


def test_times_far_from_the_stamp_are_an_error():
    relative = find_time_field("time", [(np.linspace(0, 0.1, 100), START_NS)])
    epoch = find_time_field("time", [(START_NS / 1e9 + np.linspace(0, 0.1, 100), START_NS)])
    for field in (relative, epoch):
        with pytest.raises(CloudError, match=r"begin [0-9.e+]+ s after the cloud's stamp"):
            field.nanoseconds(np.full(9, 9e9), START_NS)
    with pytest.raises(CloudError, match=r"begin 100\.0 s before the cloud's stamp"):
        relative.nanoseconds(np.linspace(-100, -99.9, 9), START_NS)
    with pytest.raises(CloudError, match=r"as large as 1e\+300 s: no clock's"):
        relative.nanoseconds(np.full(9, 1e300), START_NS)
    own = find_time_field("time", [(5000.0 + np.linspace(0, 0.1, 100), START_NS)])
    assert own.nanoseconds(np.full(9, 1e6), START_NS)[1] == START_NS


def test_absurd_times_in_one_cloud_do_not_tell_the_unit():
    sound = [(np.linspace(0, 0.1, 100), START_NS)] * 5
    huge = [np.linspace(first, 1.1 * first, 100) for first in (1e9, 1e18, 1e25, 1e300)]
    for absurd in (np.linspace(0, 1e9, 100), *huge):
        field = find_time_field("time", [*sound, (absurd, START_NS)])
        assert (field.unit, field.reference) == ("s", "stamp")
