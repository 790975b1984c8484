"""The features of a scan."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.scan.floor import Floor, heights_above_pieces
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.summary import (
    concatenate,
    extract,
    move_moments,
    select_scans,
    with_rays,
    without_rays,
)
from tests import synthetic

PIECES = np.array([[0.02, 0.01, 0.0], [-0.08, 0.08, 0.02]])
PLANE = Floor(0.03, np.array([0.02, -0.01]), 100)


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
    T_map_level = transforms.from_yaw(0.7, [5.0, -2.0, 0.4])
    placed, labelling = replace(placed, T_map_level=T_map_level), replace(labelling, floor=floor)
    features = extract(0, placed, labelling)
    places_level = np.random.default_rng(0).uniform(-4, 4, (50, 3))
    places_level[:, 2] = floor.height_at(places_level)
    places_map = transforms.apply(T_map_level, places_level)
    above_m = heights_above_pieces(places_map, features.floor_map[0], features.floor_is_foot[0])
    np.testing.assert_allclose(above_m, 0.0, atol=1e-9)


def test_moments_move_with_their_points() -> None:
    xy = np.random.default_rng(1).normal(size=(40, 2))

    def moments(p: FloatArray) -> FloatArray:
        x, y = p[:, 0], p[:, 1]
        return np.array([[len(p), *(v.sum() for v in (x, y, x * x, x * y, y * y))]])

    T = transforms.from_yaw(0.7, [3.0, -4.0, 0.0])
    moved = transforms.apply(T, np.column_stack([xy, np.zeros(40)]))[:, :2]
    np.testing.assert_allclose(move_moments(moments(xy), T), moments(moved), rtol=1e-9)


def test_features_move_with_their_scan() -> None:
    T = np.array([transforms.from_yaw(yaw, [3.0 * yaw, -1.0, 0.2]) for yaw in (0.4, -2.0)])
    scans = [labelled(index) for index in range(2)]

    def placed_at(T_map_level: FloatArray) -> list:
        return [
            extract(index, replace(placed, T_map_level=T_map_level[index]), labelling)
            for index, (placed, labelling) in enumerate(scans)
        ]

    level, parts = concatenate(placed_at(np.stack([np.eye(4)] * 2))), placed_at(T)
    ends, labels = [p.ray_end_map for p in parts], [p.ray_label for p in parts]
    moved, wanted = with_rays(without_rays(level).moved(T), ends, labels), concatenate(parts)
    for f in fields(moved):
        np.testing.assert_allclose(
            getattr(moved, f.name), getattr(wanted, f.name), atol=1e-6, rtol=1e-6
        )
    assert len(moved.plane_normal) == 4


@pytest.mark.parametrize("chosen", [[True, False, True], [False, True, False], [False] * 3])
def test_scans_that_are_selected_keep_all_their_rows(chosen: list[bool]) -> None:
    parts = [extract(index, *labelled(index, 400 - 60 * index)) for index in range(3)]
    selected = select_scans(concatenate(parts), np.array(chosen))
    kept = [part for part, wanted in zip(parts, chosen, strict=True) if wanted]
    for f in fields(selected):
        none = np.zeros((0, *getattr(parts[0], f.name).shape[1:]))
        wanted = np.concatenate([none, *(getattr(part, f.name) for part in kept)])
        np.testing.assert_array_equal(getattr(selected, f.name), wanted, f.name)
