"""The features of a scan."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.scan.floor import Floor, heights_above_pieces
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.summary import concatenate, extract, move_moments, select_scans
from tests import synthetic

PIECES = np.array([[0.02, 0.01, 0.0], [-0.08, 0.08, 0.02]])
PLANE = Floor(0.03, np.array([0.02, -0.01]), 100)
T_MAP_LEVEL = transforms.from_yaw(0.7, [5.0, -2.0, 0.4])


def labelled(index: int = 0, firings: int = 400) -> tuple[PlacedScan, ScanLabelling]:
    scan = synthetic.scan(index, firings=firings)
    placed = synthetic.level(scan, synthetic.trajectory(3)).placed
    return placed, label_scan(scan, placed, synthetic.settings(), 0)


@pytest.mark.parametrize(
    "floor",
    [PLANE, replace(PLANE, pieces=PIECES, is_foot=True), replace(PLANE, pieces=PIECES)],
    ids=["plane", "ramp's foot", "ramp's top"],
)
def test_the_floor_has_its_height_at_every_place_of_the_map(floor: Floor) -> None:
    placed, labelling = labelled()
    placed, labelling = replace(placed, T_map_level=T_MAP_LEVEL), replace(labelling, floor=floor)
    features = extract(0, placed, labelling)
    places_level = np.random.default_rng(0).uniform(-4, 4, (50, 3))
    places_level[:, 2] = floor.height_at(places_level)
    places_map = placed.to_map(places_level)
    above_m = heights_above_pieces(places_map, features.floor_map[0], features.floor_is_foot[0])
    np.testing.assert_allclose(above_m, 0.0, atol=1e-9)


def test_planes_and_their_moments_are_moved_to_the_map() -> None:
    placed, labelling = labelled()
    features = extract(0, replace(placed, T_map_level=T_MAP_LEVEL), labelling)
    assert len(features.plane_normal) == 2
    for ends, normal in zip(features.plane_ends_map, features.plane_normal, strict=True):
        offset_m = (ends - features.origin_map[0, :2]) @ normal
        assert offset_m[0] == pytest.approx(offset_m[1])
        assert offset_m[0] < 0  # normals point towards the sensor
    xy = np.random.default_rng(1).normal(size=(40, 2))
    moved = placed.to_map(np.pad(xy, ((0, 0), (0, 1))))[:, :2]

    def moments(p: np.ndarray) -> np.ndarray:
        x, y = p.T
        return np.array([[len(p), *(v.sum() for v in (x, y, x * x, x * y, y * y))]])

    found = move_moments(moments(xy), placed.T_map_level)
    np.testing.assert_allclose(found, moments(moved), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("chosen", [[True, False, True], [False] * 3])
def test_scans_that_are_selected_keep_all_their_rows(chosen: list[bool]) -> None:
    parts = [extract(index, *labelled(index, 400 - 60 * index)) for index in range(3)]
    selected = select_scans(concatenate(parts), np.array(chosen))
    kept = [part for part, wanted in zip(parts, chosen, strict=True) if wanted]
    for f in fields(selected):
        none = np.zeros((0, *getattr(parts[0], f.name).shape[1:]))
        wanted = np.concatenate([none, *(getattr(part, f.name) for part in kept)])
        np.testing.assert_array_equal(getattr(selected, f.name), wanted, f.name)
