"""What a scan hands to the building."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.scan.floor import Floor, heights_above_pieces
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.summary import concatenate, extract, move_moments, select_scans, with_rays, without_rays
from tests import synthetic

PIECES = np.array([[0.02, 0.01, 0.0], [-0.08, 0.08, 0.02]])
PLANE = Floor(0.03, np.array([0.02, -0.01]), 100)


@pytest.mark.parametrize(
    "floor",
    [PLANE, replace(PLANE, pieces=PIECES, is_foot=True), replace(PLANE, pieces=PIECES, is_foot=False)],
    ids=["plane", "ramp's foot", "ramp's top"],
)
def test_the_floor_has_its_height_at_every_place_of_the_map(floor: Floor) -> None:
    scan = synthetic.scan(firings=400)
    placed = synthetic.level(scan, synthetic.trajectory(2)).placed
    labelling = replace(label_scan(scan, placed, synthetic.settings(), 0), floor=floor)
    T_map_level = transforms.from_yaw(0.7, [5.0, -2.0, 0.4])
    features = extract(0, replace(placed, T_map_level=T_map_level), labelling)
    places_level = np.random.default_rng(0).uniform(-4, 4, (50, 3))
    places_level[:, 2] = floor.height_at(places_level)
    places_map = transforms.apply(T_map_level, places_level)
    found_m = heights_above_pieces(places_map, features.floor_map[0], features.floor_is_foot[0])
    np.testing.assert_allclose(found_m, 0.0, atol=1e-6)


def test_moments_move_with_their_points() -> None:
    xy = np.random.default_rng(1).normal(size=(40, 2))

    def moments(p: FloatArray) -> FloatArray:
        x, y = p[:, 0], p[:, 1]
        return np.array([[len(p), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()]])

    T = transforms.from_yaw(0.7, [3.0, -4.0, 0.0])
    moved = transforms.apply(T, np.column_stack([xy, np.zeros(40)]))[:, :2]
    np.testing.assert_allclose(move_moments(moments(xy), T), moments(moved), rtol=1e-9)


def test_features_move_with_their_scan() -> None:
    trajectory, T = synthetic.trajectory(2), [transforms.from_yaw(yaw, [3.0 * yaw, -1.0, 0.2]) for yaw in (0.4, -2.0)]
    parts = {"level": [], "map": []}
    for index, T_map_level in enumerate(T):
        scan = synthetic.scan(index, firings=400)
        placed = synthetic.level(scan, trajectory).placed
        labelling = label_scan(scan, placed, synthetic.settings(), 0)
        for frame, T_frame in (("level", np.eye(4)), ("map", T_map_level)):
            parts[frame].append(extract(index, replace(placed, T_map_level=T_frame), labelling))
    level, wanted = concatenate(parts["level"]), concatenate(parts["map"])
    ends = [part.ray_end_map for part in parts["map"]]
    moved = with_rays(without_rays(level).moved(np.array(T)), ends, [part.ray_label for part in parts["map"]])
    for field in fields(moved):
        np.testing.assert_allclose(getattr(moved, field.name), getattr(wanted, field.name), atol=1e-6, rtol=1e-6)
    assert len(moved.plane_normal) == 4


@pytest.mark.parametrize("chosen", [[True, False, True], [False, True, False], [False, False, False]])
def test_scans_that_are_selected_keep_all_that_is_theirs(chosen: list[bool]) -> None:
    trajectory, parts = synthetic.trajectory(3), []
    for index in range(3):
        scan = synthetic.scan(index, firings=400 - 60 * index)
        placed = synthetic.level(scan, trajectory).placed
        parts.append(extract(index, placed, label_scan(scan, placed, synthetic.settings(), 0)))
    selected = select_scans(concatenate(parts), np.array(chosen))
    kept = [part for part, wanted in zip(parts, chosen, strict=True) if wanted]
    for f in fields(selected):
        own = [getattr(part, f.name) for part in kept]
        wanted = np.concatenate(own) if own else np.zeros((0, *getattr(parts[0], f.name).shape[1:]))
        np.testing.assert_array_equal(getattr(selected, f.name), wanted, f.name)
