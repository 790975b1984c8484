"""Columns of an upright lidar with a wide field of view: point lines like those of emitters."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan, subset
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.point_lines import COLUMN_PAIRS, SAMPLES, make_point_lines
from tests.corridor import METHOD, Hole, cast, share
from tests.synthetic import scan_of

T_BASE_SENSOR = transforms.make_transform(translation=[0.0, 0.0, 1.0])
EMITTERS_DEG = np.linspace(-45, 45, 64)
DOWN = np.array([0.0, 0.0, -1.0])


def swept(hole: Hole | None = None, yaw_rad: float = 0.0) -> tuple[Scan, PlacedScan, np.ndarray]:
    """A sweep of 64 emitters at the corridor's origin."""
    T = T_BASE_SENSOR @ transforms.from_yaw(yaw_rad, [0.0, 0.0, 0.0])
    scan, truth = cast(T, hole, 0.015, 1, emitters_deg=EMITTERS_DEG, firings=1024)
    return scan, place_scan(scan, Trajectory(np.array([0]), np.eye(4)[None]), T), truth


def labelled(scan: Scan, placed: PlacedScan) -> ScanLabelling:
    return label_scan(scan, placed, METHOD, 1, column_pairs=COLUMN_PAIRS)


def test_a_column_is_a_sector_from_below_upwards_resampled_from_its_middle() -> None:
    scan, _, _ = swept()
    is_horizontal = np.zeros(len(scan), bool)
    lines = make_point_lines(scan, DOWN, is_horizontal, COLUMN_PAIRS)
    assert lines.samples.shape == (2 * COLUMN_PAIRS, SAMPLES)
    assert sorted(lines.order.tolist()) == list(range(len(scan)))
    x, y, z = scan.points_sensor.T
    azimuth_deg = np.degrees(np.arctan2(y, x)) + 180.0
    rises = z / np.linalg.norm(scan.points_sensor, axis=1)
    for line in range(0, 2 * COLUMN_PAIRS, 7):
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        pair, side = divmod(line, 2)
        off_deg = np.abs(azimuth_deg - (pair + 180 * side + 0.5))
        assert np.all(off_deg[own] < 0.502)
        assert np.all(np.diff(rises[own]) > -1e-6)
        # One return of each emitter, the nearest to the sector's middle.
        sampled = np.unique(lines.samples[line])
        assert np.all(np.bincount(scan.ring[sampled], minlength=64) == 1)
        for i in sampled:
            of_emitter = own[scan.ring[own] == scan.ring[i]]
            assert off_deg[i] < off_deg[of_emitter].min() + 2e-3


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, 3.0])
def test_floor_ceiling_and_walls_are_labelled(yaw_rad: float) -> None:
    scan, placed, truth = swept(yaw_rad=yaw_rad)
    found = labelled(scan, placed)
    for code in (Label.FLOOR, Label.CEILING, Label.WALL):
        assert min(share(found.label, truth, code)) > 0.985
    assert len(found.planes) == 4


@pytest.mark.parametrize(("depth", "state"), [(0.06, DoorState.CLOSED), (None, DoorState.OPEN)])
def test_a_closed_door_and_an_open_one_are_found(depth: float | None, state: DoorState) -> None:
    scan, placed, truth = swept(Hole(depth=depth))
    found = labelled(scan, placed)
    assert found.openings.state.tolist() == [state]
    assert found.openings.head_m[0] == pytest.approx(2.1, abs=0.08)
    assert np.sort(found.openings.ends[0, :, 0]) == pytest.approx([-0.5, 0.4], abs=0.08)
    if state == DoorState.CLOSED:
        assert share(found.label, truth, Label.DOOR)[1] > 0.9


@pytest.mark.parametrize("count", [0, 1, 30])
def test_few_returns_make_no_line_and_no_error(count: int) -> None:
    scan, placed, _ = swept()
    few = replace(placed, points_level=placed.points_level[:count])
    found = labelled(subset(scan, np.arange(count)), few)
    assert len(found.label) == count
    assert len(found.planes) == 0


def test_a_column_whose_middle_is_all_floor_is_no_line() -> None:
    """Enough of its returns are not horizontal, but none of them is in the sector's middle."""
    azimuth_rad = np.radians(np.linspace(10.05, 10.95, 41))
    points = np.column_stack([2 * np.cos(azimuth_rad), 2 * np.sin(azimuth_rad), np.full(41, -1.0)])
    is_floor = np.arange(41) == 20
    scan = scan_of(points, np.zeros(41, np.uint16), 1)
    lines = make_point_lines(scan, DOWN, is_floor, COLUMN_PAIRS)
    assert np.all(lines.samples == -1)
