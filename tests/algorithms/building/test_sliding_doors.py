"""Closed doors whose leaf hangs before the wall, on hand-made cells of one face."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.segments import segments
from ffmap.algorithms.building.closed_doors import closed_door
from ffmap.algorithms.building.door_casings import DoorCasingsSettings
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, BuildingSettings, Doors, Windows
from ffmap.algorithms.building.ray_evidence import FILLED, SQUARES, SUM, THROUGH, WallCells
from ffmap.algorithms.building.sliding_doors import (
    HangingLeaf,
    find_hanging_leaves,
    find_sliding_doors,
    sliding_panes,
)
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced

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


def glaze(counts: np.ndarray, passed: float, pane_m: float = 0.04) -> None:
    """A leaf from 2 to 2.9 m and 2.1 m high, 6 cm before the wall: stiles and rails of 10 cm, and a pane that lets rays pass."""
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    hang(counts, (2.1, 2.8), (0.1, 2.0), pane_m)
    counts[42:56, 2:40, [FILLED, SUM, SQUARES]] *= 1.0 - passed
    counts[42:56, 2:40, THROUGH] = 10.0 * passed


def leaves(counts: np.ndarray) -> list[HangingLeaf]:
    """What hangs before the wall."""
    cells = WallCells(np.array([0, len(counts)]), counts.shape[1], counts)
    return find_hanging_leaves(traced(WALL, cells), BUILDING, CASINGS)


def panes(counts: np.ndarray) -> Windows:
    return sliding_panes(leaves(counts))


def found(counts: np.ndarray, known: Doors = NO_DOORS) -> Doors:
    return find_sliding_doors(leaves(counts), known, BUILDING)


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
    opened = closed_door(next(segments(WALL)), (doorway_m[0] / CELL_M, doorway_m[1] / CELL_M), counts, 2.1, 0.6, wall=0)
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
    assert len(leaves(counts[:, :43])) == 0


@pytest.mark.parametrize(("passed", "glazed"), [(0.02, False), (0.2, True), (0.8, True)])
@pytest.mark.parametrize("pane_m", [0.06, 0.045, 0.035])
def test_a_leaf_that_lets_rays_pass_is_a_pane(passed: float, glazed: bool, pane_m: float) -> None:
    """It lies back in its stiles, by less than a leaf is thick."""
    counts = wall()
    glaze(counts, passed, pane_m)
    doors, windows = found(counts), panes(counts)
    assert doors.glazed.tolist() == [glazed]
    assert doors.depth_m[0] == pytest.approx(-pane_m, abs=0.003)
    assert doors.agreement[0] == pytest.approx(1.0 if glazed else 1.0 - passed, abs=0.02)
    assert len(windows) == glazed
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0]), np.tile([2.0, 2.9], (len(windows), 1)), atol=CELL_M)
    np.testing.assert_allclose(windows.ends[:, :, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose([*windows.bottom_m, *windows.top_m], [0.1, 2.0] if glazed else [], atol=CELL_M)


def test_glass_flat_before_a_wall_is_no_leaf_without_stiles_that_stand_out() -> None:
    counts = wall()
    glaze(counts, 0.3, 0.035)
    for stile in ((2.0, 2.1), (2.8, 2.9)):
        hang(counts, stile, (0.0, 2.1), 0.035)
    assert len(found(counts)) == len(panes(counts)) == 0


def test_a_leaf_with_a_small_pane_is_none() -> None:
    counts = wall()
    hang(counts, (2.0, 2.9), (0.0, 2.1), 0.06)
    counts[48:51, 20:34, [FILLED, SUM, SQUARES]] *= 0.2
    counts[48:51, 20:34, THROUGH] = 8.0
    assert found(counts).glazed.tolist() == [False]
    assert len(panes(counts)) == 0
