"""Flush doors by their intensity, on faces whose cells are filled with seeded noise."""

import numpy as np
import pytest

from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.door_contrasts import DoorContrastsSettings, find_contrasting_doors
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Doors, Walls
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    SQUARES,
    SUM,
    THROUGH,
    WallCells,
    first_columns,
)
from ffmap.algorithms.building.shades import pictures, response_by_angle, shades
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced
from tests.lit_faces import FACE, FALL, HEIGHT_M, LENGTH_M, RETURNS, WALL, Rectangle, filled


def find(*patches: tuple[Rectangle, float], before_m: float = 0.0, flip: bool = False) -> Doors:
    return found_in(filled(*patches, before_m=before_m, flip=flip))


def contrasting(walls: Walls, cells: WallCells) -> Doors:
    building, settings = BuildingSettings(), DoorContrastsSettings()
    return find_contrasting_doors(pictures(traced(walls, cells), building), building, settings)


def found_in(cells: WallCells) -> Doors:
    return contrasting(FACE, cells)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("own", [30.0, 52.0, 57.5, 68.0, 90.0])
@pytest.mark.parametrize(("first_m", "last_m", "head_m"), [(1.5, 2.4, 2.0), (1.48, 2.31, 2.03), (1.02, 2.97, 2.24)])
def test_a_leaf_that_returns_more_or_less_is_a_closed_door(
    first_m: float, last_m: float, head_m: float, own: float, flip: bool
) -> None:
    doors = find(((first_m, last_m, 0.0, head_m), own), flip=flip)
    assert len(doors) == 1
    expected = sorted((LENGTH_M - first_m, LENGTH_M - last_m)) if flip else [first_m, last_m]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), expected, atol=0.02)
    np.testing.assert_allclose(doors.head_m, head_m, atol=0.03)
    assert doors.contrast[0] == pytest.approx(own / WALL - 1.0, abs=0.03)
    assert doors.state[0] == DoorState.CLOSED
    assert doors.depth_m[0] == 0.0


def test_a_leaf_shows_between_the_guards_of_a_corridors_wall() -> None:
    """They are on the wall alone, and darker than the leaf; the mean over all rows would take half its contrast."""
    guards = [((0.0, LENGTH_M, 0.35, 0.55), 40.0), ((0.0, LENGTH_M, 0.85, 0.95), 40.0)]
    doors = find(*guards, ((1.5, 2.4, 0.0, 2.0), 54.0))
    assert len(doors) == 1
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.5, 2.4], atol=0.02)
    assert doors.contrast[0] == pytest.approx(54.0 / WALL - 1.0, abs=0.03)


def test_a_plate_on_a_leaf_hides_neither_jamb() -> None:
    """Around its lock it returns less still."""
    doors = find(((1.5, 2.4, 0.0, 2.0), 52.0), ((1.5, 1.7, 0.7, 1.3), 36.0))
    assert len(doors) == 1
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.5, 2.4], atol=CELL_M)


def test_what_ends_close_above_the_floor_is_no_leaf() -> None:
    """It shows over most of a door's height, as a mirror does."""
    assert len(find(((1.5, 2.4, 0.35, 2.0), 30.0))) == 0


def test_of_two_doors_the_one_that_shows_best_is_first() -> None:
    """Whichever face comes first."""
    cells = filled(((0.6, 1.5, 0.0, 2.0), 52.0), ((3.0, 3.9, 0.0, 2.1), 90.0))
    halves = faces(((0, 0), (2.25, 0)), ((2.25, 0), (LENGTH_M, 0)))
    doors = contrasting(halves, WallCells(first_columns(halves), cells.rows, cells.counts, cells.light))
    np.testing.assert_allclose(doors.contrast, [0.5, 52.0 / WALL - 1.0], atol=0.03)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize(("wall_m", "found"), [(0.15, 1), (0.1, 1), (0.05, 0)])
def test_a_leaf_close_to_a_corner_has_some_wall_there(wall_m: float, found: int, flip: bool) -> None:
    """The face's last column holds returns of the other wall; a finish that goes on to the corner is no leaf."""
    last_m = LENGTH_M - wall_m
    corner = ((LENGTH_M - CELL_M, LENGTH_M, 0.0, HEIGHT_M), 30.0)
    doors = find(((last_m - 0.9, last_m, 0.0, 2.0), 68.0), corner, flip=flip)
    assert len(doors) == found
    if found:
        assert lengths_m(doors.ends) == pytest.approx([0.9], abs=0.03)


def test_two_doors_in_one_wall() -> None:
    assert len(find(((0.6, 1.5, 0.0, 2.0), 40.0), ((3.0, 3.9, 0.0, 2.1), 80.0))) == 2


def test_a_door_in_two_faces_of_one_wall_is_found_with_its_whole_width() -> None:
    cells = filled(((1.6, 2.5, 0.0, 2.0), 40.0))
    halves = faces(((0, 0), (2, 0)), ((2, 0), (LENGTH_M, 0)))
    cells = WallCells(first_columns(halves), cells.rows, cells.counts, cells.light)
    doors = contrasting(halves, cells)
    assert len(doors) >= 1
    np.testing.assert_allclose(np.sort(doors.ends[..., 0]), [[1.6, 2.5]] * len(doors), atol=0.02)


@pytest.mark.parametrize(
    "patches",
    [
        [],  # finished as the wall: nothing shows
        [((1.5, 2.4, 0.0, 2.0), 61.0)],  # less than emitters differ by
        [((1.5, 2.4, 0.5, 2.0), 30.0)],  # a poster
        [((1.5, 2.4, 0.0, 1.5), 30.0)],  # a cupboard is lower than a door
        [((1.5, 1.9, 0.0, 2.0), 30.0)],  # so narrow is no door
        [((0.5, 4.5, 0.0, 2.0), 30.0)],  # a painted dado
        [((0.0, 5.0, 0.0, 2.0), 30.0)],  # one all along the wall
        [((1.5, 2.4, 0.0, 2.7), 30.0)],  # a strip of another finish, up to the ceiling
        [((1.5, 5.0, 0.0, 2.7), 30.0)],  # a wall of two finishes
        [((1.5, 2.4, 0.0, 2.0), 30.0), ((1.5, 2.4, 2.0, 2.7), 90.0)],  # what is above is no more of the wall around
        [((1.5, 2.4, 0.0, 2.0), 30.0), ((2.4, 5.0, 0.0, 2.7), 90.0)],  # nor what is beside
        [((1.5, 1.7, 0.0, 2.0), 30.0), ((2.2, 2.4, 0.0, 2.0), 30.0)],  # two strips
        [((1.5, 2.4, 0.0, 0.7), 30.0), ((1.5, 2.4, 1.2, 2.0), 30.0)],  # two pictures
    ],
)
def test_what_no_leaf_does(patches: list[tuple[Rectangle, float]]) -> None:
    assert len(find(*patches)) == 0


def test_what_stands_out_of_the_wall_is_no_flush_leaf() -> None:
    assert len(find(((1.5, 2.4, 0.0, 2.0), 30.0), before_m=0.02)) == 0


def test_stripes_of_the_wall_itself_are_no_jambs() -> None:
    rng = np.random.default_rng(2)
    cells = filled()
    cells.light[..., 1] *= rng.normal(1.0, 0.1, len(cells.light)).astype(np.float32)[:, None, None]
    assert len(found_in(cells)) == 0


def test_a_doorway_that_rays_pass_is_no_closed_door() -> None:
    cells = filled(((1.5, 2.4, 0.0, 2.0), 30.0))
    cells.counts[30:48, :40, THROUGH] = RETURNS
    assert len(found_in(cells)) == 0


def test_without_intensities_there_is_none() -> None:
    cells = filled(((1.5, 2.4, 0.0, 2.0), 30.0))
    assert len(found_in(WallCells(cells.first, cells.rows, cells.counts))) == 0


def test_the_wall_between_two_recessed_leaves_is_none() -> None:
    """Of the wall beside it only the doors' frames lie in the face, which are as the leaves are."""
    frames = ((1.9, 2.0, 0.0, 2.05), 68.0), ((3.0, 3.1, 0.0, 2.05), 68.0)
    leaves = (1.0, 1.9), (3.1, 4.0)
    cells = filled(*frames, *(((*leaf, 0.0, 2.05), 68.0) for leaf in leaves))
    for first_m, last_m in leaves:
        leaf = cells.counts[round(first_m / CELL_M) : round(last_m / CELL_M), : round(2.05 / CELL_M)]
        leaf[..., SUM], leaf[..., SQUARES] = -0.05 * leaf[..., FILLED], (0.05**2 + 1e-4) * leaf[..., FILLED]
    assert len(found_in(cells)) == 0


@pytest.mark.parametrize("columns", [0, 3, 12])
def test_a_short_face_and_none(columns: int) -> None:
    walls = faces(((0, 0), (columns * CELL_M, 0))) if columns else NO_WALLS
    first = first_columns(walls)
    cells = WallCells(first, 60, np.ones((first[-1], 60, 4), np.float32), np.ones((first[-1], 60, 4, 2), np.float32))
    assert len(contrasting(walls, cells)) == 0


def test_how_intensities_fall_with_the_angle_is_learned_whatever_the_wall_is_made_of() -> None:
    cells = filled(((0.0, 2.0, 0.0, 2.7), 20.0))
    np.testing.assert_allclose(response_by_angle(cells.light), FALL, atol=0.02)
    shade = shades(cells.light, FALL)[:, : round(HEIGHT_M / CELL_M)]
    assert shade[:38].mean() == pytest.approx(20.0, abs=0.5)
    assert shade[42:].mean() == pytest.approx(WALL, abs=0.5)
