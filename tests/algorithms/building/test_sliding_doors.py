"""Closed doors whose leaf hangs before the wall, on hand-made cells of one face."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.segments import segments
from ffmap.algorithms.building.door_casings import DoorCasingsSettings, flush_door
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, BuildingSettings, Doors
from ffmap.algorithms.building.ray_evidence import SQUARES, SUM, THROUGH, WallCells
from ffmap.algorithms.building.sliding_doors import find_sliding_doors
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces

BUILDING, CASINGS = BuildingSettings(), DoorCasingsSettings()
HEIGHT_M = 3.2
WALL = faces(((0.0, 0.0), (5.0, 0.0)))


def wall() -> np.ndarray:
    """The cells (100, 66, 4) of 5 m of wall: ten rays end on each, with a centimetre of noise."""
    counts = np.zeros((100, 66, 4), np.float32)
    counts[:, : round(HEIGHT_M / CELL_M)] = [10.0, 0.0, 10.0 * 0.01**2, 0.0]
    return counts


def hang(counts: np.ndarray, x_m: tuple[float, float], z_m: tuple[float, float], before_m: float | np.ndarray) -> None:
    """What hangs before the wall, at one distance or (c, 1) at one for each column."""
    (left, right), (low, high) = ((round(first / CELL_M), round(last / CELL_M)) for first, last in (x_m, z_m))
    part = counts[left:right, low:high]
    part[..., SUM] = 10.0 * before_m
    part[..., SQUARES] = 10.0 * (np.square(before_m) + 0.01**2)


def found(counts: np.ndarray, known: Doors = NO_DOORS) -> Doors:
    return find_sliding_doors(WALL, WallCells(np.array([0, len(counts)]), 66, counts), known, BUILDING, CASINGS)


@pytest.mark.parametrize("before_m", [0.045, 0.06, 0.09])
@pytest.mark.parametrize("head_m", [1.9, 2.1, 2.5])
def test_a_leaf_before_its_wall_is_a_closed_door(before_m: float, head_m: float) -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, head_m), before_m)
    # Its edges cover a part of the cells beside and above it.
    hang(counts, (1.95, 2.0), (0.0, head_m), 0.6 * before_m)
    hang(counts, (2.9, 2.95), (0.0, head_m), 0.3 * before_m)
    hang(counts, (2.0, 2.9), (head_m, head_m + CELL_M), 0.3 * before_m)
    doors = found(counts)
    assert len(doors) == 1
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.95, 2.9], atol=CELL_M)
    assert doors.depth_m[0] == pytest.approx(-before_m, abs=0.001)
    assert doors.head_m[0] == pytest.approx(head_m, abs=CELL_M)
    assert doors.state[0] == DoorState.CLOSED
    assert doors.agreement[0] == 1.0


@pytest.mark.parametrize(
    ("x_m", "z_m", "before_m"),
    [
        ((2.0, 2.9), (0.0, 2.1), 0.02),  # panelling, as thick as a casing
        ((2.0, 2.9), (1.0, 2.1), 0.06),  # a board on the wall
        ((2.0, 2.9), (0.0, 1.5), 0.06),  # a chest
        ((2.0, 2.9), (0.0, HEIGHT_M), 0.06),  # a pilaster
        ((2.0, 2.4), (0.0, 2.1), 0.06),  # a pipe's casing
        ((1.0, 4.5), (0.0, 2.1), 0.06),  # a row of cupboards
        ((0.0, 0.9), (0.0, 2.1), 0.06),  # what stands in a corner
        ((2.0, 2.9), (0.0, 2.7), 0.06),  # higher than doors
    ],
)
def test_what_is_no_leafs_size_is_none(x_m: tuple[float, float], z_m: tuple[float, float], before_m: float) -> None:
    counts = wall()
    hang(counts, x_m, z_m, before_m)
    assert len(found(counts)) == 0


def test_a_curtain_hangs_in_folds() -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.07 + 0.025 * np.sin(np.arange(18.0))[:, None])
    assert len(found(counts)) == 0


def test_where_rays_pass_beside_it_no_wall_holds_a_leaf() -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    assert len(found(counts)) == 1
    counts[60:63, :42] = 0.0
    counts[60:63, :42, THROUGH] = 10.0
    assert len(found(counts)) == 0


@pytest.mark.parametrize(("doorway_m", "off_m", "doors"), [((3.0, 3.9), 0.0, 0), ((3.6, 4.5), 0.0, 1), ((3.0, 3.9), 2.0, 1)])
def test_a_leaf_that_stands_open_against_its_wall_is_beside_its_doorway(
    doorway_m: tuple[float, float], off_m: float, doors: int
) -> None:
    """Not beside one in another wall."""
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    opened = flush_door(next(segments(WALL)), 0, (doorway_m[0] / CELL_M, doorway_m[1] / CELL_M), 0, 2.1, counts, 0.6)
    opened = replace(opened, ends=opened.ends + np.array([0.0, off_m]), state=np.array([DoorState.OPEN], np.uint8))
    assert len(found(counts, opened)) == doors


def test_a_face_that_nobody_saw_has_none() -> None:
    assert len(found(np.zeros((100, 66, 4), np.float32))) == 0


@pytest.mark.parametrize(("low_m", "high_m"), [(0.5, 1.5), (2.1, 2.6)])
def test_of_a_leaf_and_of_the_wall_above_it_most_has_to_be_seen(low_m: float, high_m: float) -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    counts[40:58, round(low_m / CELL_M) : round(high_m / CELL_M)] = 0.0
    assert len(found(counts)) == 0


def test_above_the_highest_row_nothing_is_known() -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    assert len(found(counts)) == 1
    assert len(find_sliding_doors(WALL, WallCells(np.array([0, 100]), 43, counts[:, :43]), NO_DOORS, BUILDING, CASINGS)) == 0
