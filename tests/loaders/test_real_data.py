"""Real recordings, where they are at hand."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ffmap.app.commands.info import describe
from ffmap.loaders.bag import open_bag
from ffmap.loaders.cloud_index import index_clouds
from ffmap.loaders.find_rig import find_rig
from ffmap.loaders.scans import read_scans
from ffmap.loaders.trajectory_file import read_tum

FOLDER = os.environ.get("FFMAP_REAL_DATA")
pytestmark = pytest.mark.skipif(
    not FOLDER, reason="FFMAP_REAL_DATA names no folder with real recordings"
)


def real(name: str) -> Path:
    path = Path(FOLDER or "") / name
    if not path.exists():
        pytest.skip(f"{name} is not in FFMAP_REAL_DATA")
    return path


def scans_of(path: Path):
    with open_bag(path) as bag:
        rig = find_rig(bag)
        index = index_clouds(bag, rig.horizontal.topic)
        return rig, [scan for _, scan in read_scans(bag, index, 0, None, rig.horizontal.decoding)]


def test_a_hesai_without_rings_has_32():
    rig, scans = scans_of(real("hilti_14.bag"))
    rings = rig.horizontal.decoding.rings
    assert (rings.source, rings.count, rig.vertical, len(scans)) == ("elevation", 32, None, 30)
    np.testing.assert_allclose(rings.elevation_deg, np.arange(-16, 16), atol=0.3)
    for scan in scans:
        x, y, z = scan.points_sensor.T.astype(np.float64)
        off_deg = np.degrees(np.arctan2(z, np.hypot(x, y))) - rings.elevation_deg[scan.ring]
        assert np.mean(np.abs(off_deg[x * x + y * y + z * z > 1]) < 0.25) > 0.99
    assert len(read_tum(real("hilti_14.tum"))) == 30


def test_an_ouster_has_its_rows_as_rings():
    rig, scans = scans_of(real("os0_room.bag"))
    assert (rig.horizontal.decoding.rings.source, rig.horizontal.ring_count) == ("row", 128)
    for scan in scans:
        assert len(scan) < scan.cloud_size == 128 * 1024
        # Rows run downwards, ring 0 is the lowest.
        np.testing.assert_array_equal(scan.ring, 127 - scan.cloud_index // 1024)


def test_packets_become_the_clouds_that_another_decoder_made():
    rig, scans = scans_of(real("vlp16_packets"))
    assert (len(scans), rig.horizontal.ring_count) == (4, 16)
    for scan in scans:
        assert 0.09e9 < scan.end_ns - scan.start_ns < 0.11e9
        assert abs(scan.start_ns - scan.stamp_ns) < 1_000_000
    content = real("vlp16_packets_decoded.pcd").read_bytes().split(b"DATA binary\n", 1)[1]
    points = np.frombuffer(content, np.float32).reshape(-1, 8)[:, :3]
    # The decoders differ in which block begins a sweep and in which returns are too near.
    gaps = [cKDTree(scan.points_sensor).query(points)[0] for scan in scans]
    assert min(np.percentile(gap, 95) for gap in gaps) < 0.02


@pytest.mark.parametrize("name", ["hilti_14.bag", "os0_room.bag", "vlp16_packets"])
def test_every_recording_can_be_described(name):
    lines = describe(real(name))
    assert "missing" in lines
    assert any(line.startswith("  horizontal: /") for line in lines)
    assert not any(line.startswith("  problem: ") for line in lines)
