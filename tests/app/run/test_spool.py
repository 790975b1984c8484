"""What a labelled scan leaves in the spool for its final labels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffmap.algorithms.base.labels import NO_RETURN
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.maps.rivals import RivalReturns
from ffmap.algorithms.scan.floor import heights_above_pieces
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.summary import ray_rows
from ffmap.app.run import spool
from ffmap.app.run.spool import SpooledScan
from tests.corridor import labelled

SCAN, PLACED, _, LABELLING = labelled()


def kept(tmp_path: Path, scan: Scan, placed: PlacedScan, labelling: ScanLabelling) -> SpooledScan:
    """The second of two scans, written and read back."""
    rivals = RivalReturns.of(placed.points_level, labelling)
    scans = [
        SpooledScan.of(index, scan, placed, labelling, rivals, ray_rows(index, labelling)) for index in (6, 7)
    ]
    spool.save(tmp_path / "block.arrow", spool.pack_scans(scans))
    found = spool.load_scans(tmp_path / "block.arrow")
    assert [one.scan for one in found] == [6, 7]
    return found[1]


@pytest.mark.parametrize("order", ["of the cloud", "another"])
def test_a_scan_comes_back_to_half_a_millimetre(tmp_path: Path, order: str) -> None:
    generator = np.random.default_rng(0)
    places = np.arange(len(SCAN)) + len(SCAN) // 10 * (np.arange(len(SCAN)) > 99)  # some returned nothing
    if order == "another":
        places = generator.permutation(places)
    scan = replace(SCAN, cloud_index=places.astype(np.int32), cloud_size=int(places.max()) + 5)
    found = kept(tmp_path, scan, PLACED, LABELLING)
    np.testing.assert_allclose(found.points_level, PLACED.points_level, atol=0.00051)
    np.testing.assert_array_equal(found.cloud_index, places)
    np.testing.assert_array_equal(found.label_cloud[places], LABELLING.label)
    assert np.count_nonzero(found.label_cloud == NO_RETURN) == scan.cloud_size - len(scan)
    np.testing.assert_array_equal(found.ceiling, LABELLING.ceiling_planes)
    height_m = heights_above_pieces(found.points_level, found.floor, found.floor_is_foot)
    np.testing.assert_allclose(height_m, LABELLING.height_m, atol=0.001)
    np.testing.assert_array_equal(found.label, LABELLING.label)
    rivals = RivalReturns.of(PLACED.points_level, LABELLING)
    np.testing.assert_array_equal(found.rivals.row, rivals.row)
    np.testing.assert_array_equal(found.rivals.rival, rivals.rival)
    np.testing.assert_array_equal(found.origin_level, PLACED.origin_level)


def test_what_is_far_lies_on_a_coarser_grid(tmp_path: Path) -> None:
    far = replace(PLACED, points_level=(20.0 * PLACED.points_level).astype(np.float32))
    found = kept(tmp_path, SCAN, far, LABELLING)
    assert np.abs(far.points_level).max() > 40
    assert found.grid_m > 0.001
    np.testing.assert_allclose(found.points_level, far.points_level, atol=0.51 * found.grid_m)


def test_a_block_without_scans_has_none(tmp_path: Path) -> None:
    spool.save(tmp_path / "block.arrow", spool.pack_scans([]))
    assert spool.load_scans(tmp_path / "block.arrow") == []
