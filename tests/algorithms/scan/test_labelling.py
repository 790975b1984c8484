"""The method on an analytic corridor: known walls, floor, ceiling and door, under noise."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import in_canonical_order, subset
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.summary import extract
from tests import synthetic
from tests.corridor import HEIGHT_M, METHOD, T_BASE_SENSOR, Hole, cast, labelled, place, pose, share


def test_a_bare_corridor_is_labelled_almost_without_error() -> None:
    _, _, truth, found = labelled()
    for code in (Label.FLOOR, Label.CEILING, Label.WALL):
        assert min(share(found.label, truth, code)) > 0.97, code
    assert found.ceilings[0].height_m == pytest.approx(HEIGHT_M, abs=0.005)
    # Side walls and both ends: planes at the known offsets, facing the sensor.
    planes = found.planes
    walls = np.round(planes.normal * planes.offset_m[:, None], 1) + 0.0
    assert {(0.0, 2.0), (0.0, -1.5)} <= set(map(tuple, walls))
    assert np.all(planes.offset_m < 0)
    assert len(found.openings) == 0


def test_a_closed_door_recessed_by_centimetres_is_found() -> None:
    _, _, truth, found = labelled(Hole(depth=0.05))
    precision, recall = share(found.label, truth, Label.DOOR)
    assert precision > 0.8
    assert recall > 0.6
    assert set(found.openings.state.tolist()) == {DoorState.CLOSED}
    assert np.median(found.openings.depth_m) == pytest.approx(0.05, abs=0.015)
    start_m = found.door_lines.start_height_m[found.door_lines.above_door]
    assert np.all(start_m > METHOD.doors.height_min_m)
    assert np.all(start_m == pytest.approx(2.1, abs=0.25))


def test_an_open_door_is_an_open_opening() -> None:
    assert DoorState.OPEN in labelled(Hole(depth=None))[3].openings.state


def test_without_a_ceiling_in_view_none_is_invented() -> None:
    _, _, _, found = labelled(ceiling=False)
    assert found.ceilings == ()
    assert not np.any(found.label == Label.CEILING)


@pytest.mark.parametrize("timed", [True, False])
def test_labels_do_not_depend_on_the_order_of_returns(timed: bool) -> None:
    """The same to the bit, return by return, for a scan as large as a real one."""
    scan = replace(synthetic.scan(), time_ns=np.arange(32 * 2170) * 1_440 if timed else None)
    rows = np.random.default_rng(3).permutation(len(scan))
    found = []
    for ordered in (in_canonical_order(scan), in_canonical_order(subset(scan, rows))):
        placed = synthetic.level(ordered, synthetic.trajectory(3)).placed
        own = label_scan(ordered, placed, METHOD, 1)
        by_cloud = np.argsort(ordered.cloud_index)
        by_return = (values[by_cloud] for values in (own.label, own.plane, own.height_m))
        found.append((*by_return, extract(0, placed, own).ray_end_map))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("yaw_rad", [0.4, -2.9])
def test_labels_hold_under_rigid_motion_of_the_whole(yaw_rad: float) -> None:
    scan, _, _, found = labelled(Hole())
    moved = place(scan, transforms.from_yaw(yaw_rad, [30.0, -12.0, 0.0]))
    assert np.mean(label_scan(scan, moved, METHOD, 1).label == found.label) > 0.999


@pytest.mark.parametrize("count", [0, 1, 5, 300])
def test_empty_and_tiny_scans_are_labelled(count: int) -> None:
    scan, placed, _, _ = labelled()
    few = replace(placed, points_level=placed.points_level[:count])
    assert len(label_scan(subset(scan, np.arange(count)), few, METHOD, 1).label) == count


def test_the_floor_is_found_wherever_the_robot_has_climbed() -> None:
    """By the map, robot and floor are 0.6 m higher than at the start: a ramp, or drift."""
    scan, truth = cast(pose() @ T_BASE_SENSOR, None, 0.015, 3)
    trajectory = Trajectory(np.array([0]), transforms.make_transform(None, [1.0, 0.0, 0.6])[None])
    placed = place_scan(scan, trajectory, T_BASE_SENSOR, base_height_m=0.0)
    found = label_scan(scan, placed, METHOD, 3)
    assert share(found.label, truth, Label.FLOOR)[1] > 0.97
    floor_map = placed.to_map(placed.points_level)[truth == Label.FLOOR, 2]
    np.testing.assert_allclose(floor_map, 0.6, atol=0.1)
    features = extract(0, placed, found)
    np.testing.assert_allclose(features.floor_map[0] @ [1.0, 1.0, 0.0], 0.6, atol=0.02)
