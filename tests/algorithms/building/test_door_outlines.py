"""Flush doors by the outline of their frame, on faces whose cells are filled with seeded noise."""

import numpy as np
import pytest

from ffmap.algorithms.building.door_outlines import DoorOutlinesSettings, find_outlined_doors
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Doors, Walls
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    SQUARES,
    SUM,
    THROUGH,
    WallCells,
    first_columns,
)
from ffmap.algorithms.building.shades import pictures
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced
from tests.lit_faces import FACE, LENGTH_M, RETURNS, WALL, Rectangle, filled

Patch = tuple[Rectangle, float]


def frame(
    first_m: float, last_m: float, head_m: float, own: float, *, wide_m: float = 0.05, foot_m: float = 0.0
) -> list[Patch]:
    """Around an opening: up one side, over the top, and down the other."""
    top_m = head_m + wide_m
    return [
        ((first_m - wide_m, first_m, foot_m, top_m), own),
        ((last_m, last_m + wide_m, foot_m, top_m), own),
        ((first_m, last_m, head_m, top_m), own),
    ]


def outlined(walls: Walls, cells: WallCells) -> Doors:
    building = BuildingSettings()
    return find_outlined_doors(pictures(traced(walls, cells), building), building, DoorOutlinesSettings())


def find(*patches: Patch, flip: bool = False) -> Doors:
    return outlined(FACE, filled(*patches, flip=flip))


LINES = frame(1.5, 2.4, 2.0, 52.0)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("wide_m", [0.04, 0.05, 0.08])
@pytest.mark.parametrize("own", [40.0, 52.0, 68.0, 90.0])
@pytest.mark.parametrize(("first_m", "last_m", "head_m"), [(1.5, 2.4, 2.0), (1.48, 2.31, 2.03), (1.02, 2.97, 2.24)])
def test_a_frame_that_returns_more_or_less_than_leaf_and_wall_is_a_closed_door(
    first_m: float, last_m: float, head_m: float, own: float, wide_m: float, flip: bool
) -> None:
    doors = find(*frame(first_m, last_m, head_m, own, wide_m=wide_m), flip=flip)
    assert len(doors) == 1
    expected = sorted((LENGTH_M - first_m, LENGTH_M - last_m)) if flip else [first_m, last_m]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), expected, atol=0.04)
    np.testing.assert_allclose(doors.head_m, head_m, atol=0.04)
    assert np.sign(doors.outline[0]) == np.sign(own - WALL)
    assert doors.state[0] == DoorState.CLOSED
    assert doors.depth_m[0] == 0.0
    assert np.isnan(doors.contrast[0])


def test_a_leaf_of_another_finish_within() -> None:
    assert len(find(*frame(1.5, 2.4, 2.0, 45.0), ((1.5, 2.4, 0.0, 2.0), 62.0))) == 1


def test_two_doors_in_one_wall() -> None:
    assert len(find(*frame(0.6, 1.5, 2.0, 50.0), *frame(3.0, 3.9, 2.1, 72.0))) == 2


def test_of_two_doors_the_one_that_shows_best_is_first() -> None:
    """Whichever face comes first."""
    cells = filled(*frame(0.6, 1.5, 2.0, 52.0), *frame(3.0, 3.9, 2.1, 90.0))
    halves = faces(((0, 0), (2.25, 0)), ((2.25, 0), (LENGTH_M, 0)))
    doors = outlined(halves, WallCells(first_columns(halves), cells.rows, cells.counts, cells.light))
    assert doors.outline[0] > 0.3 > -doors.outline[1] > 0.0


def test_a_line_that_ends_above_the_floor_is_no_frame() -> None:
    """It shows over most of a door's height, as a mirror's does."""
    assert len(find(*frame(1.5, 2.4, 2.0, 52.0, foot_m=0.4))) == 0


def test_a_door_in_two_faces_of_one_wall_is_found_with_its_whole_width() -> None:
    cells = filled(*frame(1.6, 2.5, 2.0, 50.0))
    halves = faces(((0, 0), (2, 0)), ((2, 0), (LENGTH_M, 0)))
    doors = outlined(halves, WallCells(first_columns(halves), cells.rows, cells.counts, cells.light))
    assert len(doors) >= 1
    np.testing.assert_allclose(np.sort(doors.ends[..., 0]), [[1.6, 2.5]] * len(doors), atol=0.03)


@pytest.mark.parametrize(
    "patches",
    [
        [],
        frame(1.5, 2.4, 2.0, 59.4),  # less than columns scatter by
        LINES[:2],  # two lines without one over them
        [LINES[0], LINES[2]],  # one side is missing
        frame(1.5, 2.4, 2.0, 52.0, foot_m=0.6),  # a picture's frame
        frame(1.5, 2.4, 1.4, 52.0),  # a cupboard's
        frame(1.5, 1.9, 2.0, 52.0),  # so narrow is no door
        frame(0.5, 4.5, 2.0, 52.0),  # nor so wide
        [*LINES[:2], ((0.0, 5.0, 2.0, 2.05), 52.0), ((1.45, 1.5, 2.0, 2.7), 52.0), ((2.4, 2.45, 2.0, 2.7), 52.0)],  # panels
        [LINES[0], ((2.4, 2.45, 0.0, 2.05), 68.0), LINES[2]],  # one line of less, one of more
        [((1.5, 2.4, 0.0, 2.0), 52.0)],  # a leaf without a frame has steps, no lines
    ],
)
def test_what_no_frame_draws(patches: list[Patch]) -> None:
    assert len(find(*patches)) == 0


def test_a_frame_that_stands_out_is_left_to_casings() -> None:
    assert len(outlined(FACE, filled(*LINES, before_m=0.02))) == 0


def test_stripes_of_the_wall_itself_are_no_jambs() -> None:
    rng = np.random.default_rng(2)
    cells = filled(*LINES)
    cells.light[..., 1] *= rng.normal(1.0, 0.1, len(cells.light)).astype(np.float32)[:, None, None]
    assert len(outlined(FACE, cells)) == 0


def test_a_doorway_that_rays_pass_is_no_closed_door() -> None:
    cells = filled(*LINES)
    cells.counts[31:47, :40, THROUGH] = 0.45 * RETURNS
    cells.counts[31:47, :40, FILLED] *= 0.5
    cells.counts[31:47, :40, [SUM, SQUARES]] *= 0.5
    assert len(outlined(FACE, cells)) == 0


def test_without_intensities_there_is_none() -> None:
    cells = filled(*LINES)
    assert len(outlined(FACE, WallCells(cells.first, cells.rows, cells.counts))) == 0


@pytest.mark.parametrize("columns", [0, 3, 12])
def test_a_short_face_and_none(columns: int) -> None:
    walls = faces(((0, 0), (columns * CELL_M, 0))) if columns else NO_WALLS
    first = first_columns(walls)
    cells = WallCells(first, 60, np.ones((first[-1], 60, 4), np.float32), np.ones((first[-1], 60, 4, 2), np.float32))
    assert len(outlined(walls, cells)) == 0
