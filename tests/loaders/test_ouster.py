"""Raw packets of Ouster lidars, written by the maker's library of known points."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("ouster.sdk", reason="ouster-sdk is not installed")

from ffmap.algorithms.base.scan import Scan
from ffmap.app.commands.info import describe
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.errors import InputError
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.scans import read_scans
from ffmap.loaders.sensors import ouster
from tests.loaders.bag_builder import START_NS, Entry, clouds, tf_message, write_bag
from tests.ouster_packets import (
    COLUMN_NS,
    COLUMNS,
    PACKETS,
    PERIOD_NS,
    Revolution,
    metadata,
    metadata_entry,
    packet_entry,
    packets,
    points_of,
    revolution,
)

TOPIC = "/ouster/lidar_packets"
SINGLE = "RNG19_RFL8_SIG16_NIR16"
LATE_NS = 2_000_000  # From a packet's first firing to its recording


def turns(
    count: int = 4, first: int = 65_534, start_ns: int = START_NS, returns: int = 1
) -> list[Revolution]:
    """Successive ones, whose numbers begin anew after 65535."""
    return [
        revolution((first + i) % 65_536, start_ns + i * PERIOD_NS, returns) for i in range(count)
    ]


def entries_of(made: Sequence[Revolution], told: str, ros_version: int = 1) -> list[Entry]:
    """The metadata and all packets, recorded when they were sent."""
    sent = [metadata_entry(told, START_NS - 1, ros_version=ros_version)]
    for turn in made:
        times = turn.time_ns[:: COLUMNS // PACKETS] + LATE_NS
        sent += [
            packet_entry(data, int(time_ns), ros_version=ros_version)
            for data, time_ns in zip(packets(turn, told), times, strict=True)
        ]
    return sent


def read(path: Path) -> list[Scan]:
    with open_bag(path) as bag:
        lidar = find_rig(bag).horizontal
        return [scan for _, scan in read_scans(bag, lidar.index(bag), 0, None, lidar.decoding)]


def assert_same(scan: Scan, turn: Revolution) -> None:
    """Each point to a hundredth of a millimetre, each time to the nanosecond, each ring."""
    rows = np.arange(16)[:, None, None].repeat(COLUMNS, 1).transpose(2, 0, 1)
    known = turn.range_mm > 0
    points, ring = points_of(turn)[known], np.broadcast_to(15 - rows, known.shape)[known]
    times = np.broadcast_to(turn.time_ns, known.shape)[known]
    assert len(scan) == len(points)
    found = scan.start_ns + scan.time_ns
    order, expected = np.lexsort((scan.ring, found)), np.lexsort((ring, times))
    np.testing.assert_array_equal(found[order], times[expected])
    np.testing.assert_array_equal(scan.ring[order], ring[expected])
    np.testing.assert_allclose(scan.points_sensor[order], points[expected], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "profile"), [("a.bag", "LEGACY"), ("sqlite", SINGLE), ("mcap", "RNG15_RFL8_NIR8")]
)
def test_points_come_back_to_the_millimetre_and_the_nanosecond(
    tmp_path: Path, name: str, profile: str
) -> None:
    made = turns()
    version = 1 if name.endswith(".bag") else 2
    scans = read(write_bag(tmp_path / name, entries_of(made, metadata(profile), version)))
    assert len(scans) == len(made)
    for scan, turn in zip(scans, made, strict=True):
        assert scan.stamp_ns == turn.time_ns[0]
        assert_same(scan, turn)


@pytest.mark.parametrize("profile", ["RNG19_RFL8_SIG16_NIR16_DUAL", "RNG15_RFL8_NIR8_DUAL"])
def test_of_two_returns_of_a_firing_the_farther_is_read(tmp_path: Path, profile: str) -> None:
    (turn, *_) = made = turns(2, returns=2)
    (scan, *_) = read(write_bag(tmp_path / "a.bag", entries_of(made, metadata(profile))))
    assert scan.cloud_size == 2 * 16 * COLUMNS
    assert_same(scan, replace(turn, range_mm=turn.range_mm.max(axis=0, keepdims=True)))


def test_lost_late_and_doubled_packets(tmp_path: Path) -> None:
    made = turns(5)
    first, *sent = entries_of(made, metadata(SINGLE))
    lost = [i for i in range(PACKETS, 2 * PACKETS) if i % 5 == 0]
    order = list(range(len(sent)))
    # The third revolution's last packet comes after the fourth's first; the recording begins
    # within the first one.
    order[3 * PACKETS - 1], order[3 * PACKETS] = order[3 * PACKETS], order[3 * PACKETS - 1]
    kept = [i for i in order if i not in lost and i >= 7]
    kept.insert(40, kept[39])
    times = sorted(sent[i][1] for i in kept)
    bag = write_bag(
        tmp_path / "a.bag",
        [first, *((TOPIC, time_ns, sent[i][2]) for time_ns, i in zip(times, kept, strict=True))],
    )
    scans = read(bag)
    assert len(scans) == len(made)
    gone = [range(7), [i - PACKETS for i in lost], [PACKETS - 1], [], []]
    for scan, turn, packets_gone in zip(scans, made, gone, strict=True):
        range_mm = turn.range_mm.copy()
        for packet in packets_gone:
            range_mm[:, :, 16 * packet : 16 * (packet + 1)] = 0
        assert_same(scan, replace(turn, range_mm=range_mm))


def test_a_sensor_that_looks_one_way(tmp_path: Path) -> None:
    """Columns beside its window are not sent, or have no time where their packet begins within."""
    made, told = [], metadata(SINGLE, 100, 300)
    sent = [metadata_entry(told, START_NS - 1)]
    for turn in turns(3):
        looks = (np.arange(COLUMNS) >= 100) & (np.arange(COLUMNS) <= 300)
        turn = replace(turn, range_mm=turn.range_mm * looks, time_ns=turn.time_ns * looks)
        made.append(turn)
        sent += [
            packet_entry(data, int(turn.time_ns[100]) + i * LATE_NS)
            for i, data in enumerate(packets(turn, told))
        ]
    scans = read(write_bag(tmp_path / "a.bag", sent))
    assert len(scans) == len(made)
    for scan, turn in zip(scans, made, strict=True):
        assert_same(scan, turn)


def test_a_clock_of_the_sensors_own_is_set_to_the_bags(tmp_path: Path) -> None:
    """A clock 40 ppm fast from when it was switched on; half the packets are up to 3 ms late."""
    rng = np.random.default_rng(3)
    count, ahead_ns, fast = 100, -1_700_000_000_000_000_000 + 291_000_000_000, 40e-6
    entries, started = [metadata_entry(metadata(SINGLE), START_NS - 1)], []
    for i in range(count):
        true_ns = START_NS + i * PERIOD_NS
        by_sensor_ns = true_ns + ahead_ns + round(fast * i * PERIOD_NS)
        started.append(true_ns)
        data = packets(revolution(i, by_sensor_ns), metadata(SINGLE))[:2]
        for number, packet in enumerate(data):
            late_ns = LATE_NS + int(rng.integers(0, 3_000_000) * (rng.random() < 0.5))
            entries.append(packet_entry(packet, true_ns + number * 16 * COLUMN_NS + late_ns))
    with open_bag(
        write_bag(tmp_path / "a.bag", sorted(entries, key=lambda entry: entry[1]))
    ) as bag:
        index = index_clouds(bag, TOPIC)
    assert index.usable.all()
    off_ns = index.stamp_ns - np.array(started)
    # All are as late as the packets came, and evenly so: motion is told by differences.
    assert 0 < np.median(off_ns) - LATE_NS < 1_500_000
    assert np.ptp(off_ns) < 300_000


def test_two_sensors_have_frames_by_their_namespaces(tmp_path: Path) -> None:
    told = metadata(SINGLE)
    entries = []
    for namespace in ("/left", "/right"):
        entries.append(metadata_entry(told, START_NS, namespace))
        for turn in turns(2):
            entries += [
                packet_entry(data, int(turn.time_ns[0]), namespace) for data in packets(turn, told)
            ]
    edges = [
        ("base", f"{side}/os_sensor", (0, y, 1), (0, 0, 0, 1))
        for side, y in (("left", 0.2), ("right", -0.2))
    ]
    entries.append(("/tf_static", START_NS, tf_message(edges)))
    entries.sort(key=lambda entry: entry[1])
    with open_bag(write_bag(tmp_path / "a.bag", entries)) as bag:
        rig = find_rig(bag)
    assert rig.base_frame == "base"
    assert rig.horizontal.frame_id in ("left/os_sensor", "right/os_sensor")


def test_clouds_of_the_driver_take_precedence_and_packets_of_the_imu_are_no_lidar(
    tmp_path: Path,
) -> None:
    entries = entries_of(turns(3), metadata(SINGLE))
    entries.append(packet_entry(bytes(48), START_NS, name="imu_packets"))
    for more, lidar in (([], TOPIC), (clouds("/ouster/points", 3), "/ouster/points")):
        path = write_bag(
            tmp_path / f"{len(more)}.bag", sorted([*entries, *more], key=lambda entry: entry[1])
        )
        lines = describe(path)
        assert [line for line in lines if line.startswith("lidar ")] == [f"lidar {lidar}"]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (None, "without the sensor's metadata on /ouster/metadata"),
        ("", "no metadata of an Ouster"),
        ('{"prod_line": 3}', "no metadata of an Ouster"),
        ("no json", "no metadata of an Ouster"),
        (metadata("LEGACY"), "3328 bytes, where by the metadata they have 3392"),
    ],
)
def test_packets_without_their_metadata_are_refused(
    tmp_path: Path, told: str | None, words: str
) -> None:
    _, *sent = entries_of(turns(2), metadata(SINGLE))
    first = [] if told is None else [metadata_entry(told, START_NS - 1)]
    with open_bag(write_bag(tmp_path / "a.bag", [*first, *sent])) as bag:
        with pytest.raises(InputError, match=words) as found:
            find_rig(bag)
        assert "\n" not in str(found.value)


@pytest.mark.parametrize("known", ["", "2.0.0"])
def test_without_the_decoder_the_error_names_its_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known: str
) -> None:
    monkeypatch.setattr(ouster, "version", lambda name: known)
    path = write_bag(tmp_path / "a.bag", entries_of(turns(2), metadata(SINGLE)))
    words = r"lidar_packets.*pip install --no-deps 'ouster-sdk"
    with open_bag(path) as bag, pytest.raises(InputError, match=words):
        find_rig(bag)
