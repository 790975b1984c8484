"""Flush doors by their casings, on faces whose cells are filled with seeded noise."""

from collections.abc import Callable

import numpy as np
import pytest

from ffmap.algorithms.building.door_casings import DoorCasingsSettings, find_cased_doors
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Doors
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    SQUARES,
    SUM,
    THROUGH,
    WallCells,
    first_columns,
)
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced

Rectangle = tuple[float, float, float, float]
"""From and to along the face, from and to above the floor, metres."""
LENGTH_M, HEIGHT_M = 4.0, 2.7
RETURNS, SCATTER_M = 20, 0.01
CASING_M, WIDTH_M = 0.012, 0.07


def frame(first_m: float, last_m: float, bottom_m: float, head_m: float) -> list[Rectangle]:
    """The strips at both sides of an opening and over it."""
    over = (first_m - WIDTH_M, last_m + WIDTH_M, head_m, head_m + WIDTH_M)
    sides = ((first_m - WIDTH_M, first_m), (last_m, last_m + WIDTH_M))
    return [over, *((a, b, bottom_m, head_m) for a, b in sides)]


def covered(edges_m: np.ndarray, start_m: float, stop_m: float) -> np.ndarray:
    """(n,) which share of each cell between successive edges lies between two places."""
    return np.clip(np.minimum(edges_m[1:], stop_m) - np.maximum(edges_m[:-1], start_m), 0, None) / CELL_M


def find(
    *proud: Rectangle,
    passed: Rectangle | None = None,
    relief_m: float = CASING_M,
    flip: bool = False,
    spread: float = 0.0,
    scatter_m: float = SCATTER_M,
    recess: Rectangle | None = None,
    recess_m: float = 0.0,
    change: Callable[[np.ndarray], None] = lambda counts: None,
) -> Doors:
    """The cased doors of a face with something that stands out of it, a stretch that rays pass, and one that is set back.

    spread: standard deviation of the depths of what stands out, as a share of its relief. change: what else is done to the cells.
    """
    rng = np.random.default_rng(5)
    columns, rows = round(LENGTH_M / CELL_M), round(HEIGHT_M / CELL_M)
    along_m, up_m = np.arange(columns + 1) * CELL_M, np.arange(rows + 1) * CELL_M
    share = sum(
        (np.outer(covered(along_m, a, b), covered(up_m, c, d)) for a, b, c, d in proud), np.zeros((columns, rows))
    )
    mean_m = relief_m * np.minimum(share, 1.0) + rng.normal(0, scatter_m / np.sqrt(RETURNS), share.shape)
    if recess is not None:
        a, b, c, d = (round(value / CELL_M) for value in recess)
        mean_m[a:b, c:d] -= recess_m
    counts = np.zeros((columns, rows + 10, 4), np.float32)
    counts[:, :rows, FILLED], counts[:, :rows, SUM] = RETURNS, RETURNS * mean_m
    of_sheet = np.minimum(share, 1.0)
    # Of a cell that is covered in part, some returns lie before the wall and some on it.
    variance_m2 = relief_m**2 * (of_sheet * (1.0 - of_sheet) + (spread * of_sheet) ** 2)
    counts[:, :rows, SQUARES] = RETURNS * (mean_m**2 + scatter_m**2 + variance_m2)
    if passed is not None:
        a, b, c, d = (round(value / CELL_M) for value in passed)
        counts[a:b, c:d] = 0.0
        counts[a:b, c:d, THROUGH] = RETURNS
    change(counts)
    walls = faces(((0, 0), (LENGTH_M, 0)))
    cells = WallCells(first_columns(walls), counts.shape[1], counts[::-1] if flip else counts)
    return find_cased_doors(traced(walls, cells), BuildingSettings(), DoorCasingsSettings())


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize(
    ("first_m", "last_m", "head_m"),
    [(1.5, 2.4, 2.0), (1.48, 2.31, 2.03), (1.02, 2.97, 2.24), (1.485, 2.415, 2.0)],  # of the last, each strip parts two columns
)
def test_a_casing_shows_a_closed_door_to_two_centimetres(
    first_m: float, last_m: float, head_m: float, flip: bool
) -> None:
    doors = find(*frame(first_m, last_m, 0.0, head_m), flip=flip)
    assert len(doors) == 1
    expected = sorted((LENGTH_M - first_m, LENGTH_M - last_m)) if flip else [first_m, last_m]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), expected, atol=0.02)
    np.testing.assert_allclose(doors.head_m, head_m, atol=0.025)
    assert doors.state[0] == DoorState.CLOSED
    assert doors.depth_m[0] == 0.0
    assert 0.5 * CASING_M < doors.casing_m[0] < 1.1 * CASING_M


def test_the_pier_between_two_doors_is_none_whatever_hangs_on_it() -> None:
    """Their casings stand on both its sides, and a lamp over it like a head."""
    left, right = frame(0.4, 1.3, 0.0, 2.0), frame(2.15, 3.05, 0.0, 2.0)
    inner = 1.3 + WIDTH_M, 2.15 - WIDTH_M
    doors = find(*left, *right, (*inner, 1.85, 1.95))
    np.testing.assert_allclose(np.sort(doors.ends[:, :, 0], axis=None), [0.4, 1.3, 2.15, 3.05], atol=0.03)


def furniture_close_by(counts: np.ndarray) -> None:
    counts[52:58, :30, SUM] = 0.05 * RETURNS  # from 10 cm beside the casing on


def pane_beside(counts: np.ndarray) -> None:
    counts[51:53, :40, SUM] = -0.02 * RETURNS  # its frame begins at the casing
    counts[53:61, :40] = 0.0
    counts[53:61, :40, THROUGH] = RETURNS


def panes_on_both_sides(counts: np.ndarray) -> None:
    pane_beside(counts)
    pane_beside(counts[::-1])


def doorway_beside(counts: np.ndarray) -> None:
    counts[51:61, :40] = 0.0
    counts[51:61, :40, THROUGH] = RETURNS


@pytest.mark.parametrize(
    ("beside", "doors"), [(furniture_close_by, 1), (pane_beside, 1), (panes_on_both_sides, 0), (doorway_beside, 0)]
)
def test_a_casing_stands_out_of_what_is_beside_it(beside: Callable[[np.ndarray], None], doors: int) -> None:
    """On one side at least that is the wall."""
    assert len(find(*frame(1.55, 2.45, 0.0, 2.0), change=beside)) == doors


def test_a_casing_that_parts_two_columns_shows_beside_a_gap() -> None:
    """It covers less than half of the one, and in the other the gap beside the leaf takes back some of what stands out."""

    def with_gap(counts: np.ndarray) -> None:
        gap_m = -0.01
        for column, share, behind_m in ((28, 0.45, 0.0), (29, 0.78, gap_m), (49, 0.78, gap_m), (50, 0.45, 0.0)):
            mean_m = share * CASING_M + (1 - share) * behind_m
            square_m2 = share * CASING_M**2 + (1 - share) * behind_m**2 + SCATTER_M**2
            counts[column, :40] = RETURNS * np.array([1.0, mean_m, square_m2, 0.0])

    assert len(find(*frame(1.5, 2.45, 0.0, 2.0), change=with_gap)) == 1


def test_two_doors_in_one_wall() -> None:
    assert len(find(*frame(0.5, 1.4, 0.0, 2.0), *frame(2.4, 3.3, 0.0, 2.0))) == 2


def test_the_wall_between_two_open_doorways_is_none_though_their_casings_frame_it() -> None:
    """What shows at the height of its head beside it is the undersides of their lintels, behind the wall's face."""
    doorways = (0.2, 1.1, 0.0, 2.0), (2.2, 3.1, 0.0, 2.0)
    between = [*frame(0.2, 1.1, 0.0, 2.0), *frame(2.2, 3.1, 0.0, 2.0)]
    assert len(find(*between)) == 2  # closed

    def opened(counts: np.ndarray) -> None:
        for first_m, last_m, _, head_m in doorways:
            first, last, head = (round(value / CELL_M) for value in (first_m, last_m, head_m))
            counts[first:last, :head] = 0.0
            counts[first:last, :head, THROUGH] = RETURNS
            counts[first:last, head : head + 2] = [RETURNS, -0.05 * RETURNS, 0.05**2 * RETURNS, 0.0]

    assert len(find(*between, change=opened)) == 0


@pytest.mark.parametrize("flip", [False, True])
def test_the_wall_between_two_doors_is_none_though_one_is_recessed(flip: bool) -> None:
    """Beside it, at the height of its head, lies that one's leaf, before which the wall between stands out."""
    doors = find(
        *frame(0.2, 1.1, 0.0, 2.0), *frame(2.2, 3.1, 0.0, 2.1), recess=(2.2, 3.1, 0.0, 2.05), recess_m=0.03, flip=flip
    )
    between = LENGTH_M - 1.65 if flip else 1.65
    assert not np.any(np.abs(doors.ends[:, :, 0].mean(axis=1) - between) < 0.3)
    assert len(doors) == 2


def test_a_bare_wall_has_none() -> None:
    assert len(find()) == 0


def test_a_casing_that_is_as_flat_as_noise_shows_nothing() -> None:
    assert len(find(*frame(1.5, 2.4, 0.0, 2.0), relief_m=0.001)) == 0


def test_a_flat_casing_shows_where_the_wall_is_flatter() -> None:
    assert len(find(*frame(1.5, 2.4, 0.0, 2.0), relief_m=0.006, scatter_m=0.4 * SCATTER_M)) == 1


@pytest.mark.parametrize(
    "proud",
    [
        frame(1.5, 2.4, 0.8, 2.0),  # a window or a picture does not reach the floor
        frame(1.5, 2.4, 0.0, 1.5),  # a cupboard is lower than a door
        frame(1.5, 1.9, 0.0, 2.0),  # so narrow is no door
        frame(1.5, 2.4, 0.0, 2.0)[1:],  # two pilasters
        frame(1.5, 2.4, 0.0, 2.0)[:2],  # one of them and a shelf
        [*frame(1.5, 2.4, 0.0, 2.0), (1.43, 2.47, 0.0, 2.07)],  # a cabinet, proud all over
        [*frame(1.5, 2.4, 0.0, 2.0), (1.43, 1.5, 2.0, 2.7), (2.4, 2.47, 2.0, 2.7)],  # pillars that go on to the ceiling
        [(0, 4, 2.0, 2.7), *frame(1.5, 2.4, 0.0, 2.0)],  # a wall that stands out over its whole length
    ],
)
def test_what_no_casing_does(proud: list[Rectangle]) -> None:
    assert len(find(*proud)) == 0


def test_boards_that_stand_on_the_wall_on_their_edge_are_no_casing() -> None:
    """The sides of an open shelf, 2 cm wide: of each column's returns 40 % lie at all depths up to 8 cm, others on the wall."""
    shelf = frame(1.5, 2.4, 0.0, 2.0)
    mean_m, square_m2 = 0.4 * 0.04, 0.4 * 0.08**2 / 3
    assert len(find(*shelf, relief_m=mean_m)) == 1
    assert len(find(*shelf, relief_m=mean_m, spread=np.sqrt(square_m2 - mean_m**2) / mean_m)) == 0


@pytest.mark.parametrize(
    ("relief_m", "spread"),
    [
        (0.035, 1 / np.sqrt(3)),  # a board as wide as a column, 7 cm deep: deeper than a casing
        (0.012, 1.2),  # a rod, which covers less of its columns than a casing does
    ],
)
def test_what_is_too_deep_or_too_narrow_is_no_casing(relief_m: float, spread: float) -> None:
    strips = frame(1.5, 2.4, 0.0, 2.0)
    assert len(find(*strips, relief_m=relief_m)) == 1
    assert len(find(*strips, relief_m=relief_m, spread=spread)) == 0


def test_a_leaf_within_a_casing_lies_where_rays_end() -> None:
    """At the other face of a thick wall, as often in old buildings: of a narrow door the reveals hide how wide it is."""
    opening, leaf = (1.5, 2.4, 0.0, 2.0), (1.55, 2.35, 0.0, 2.0)
    doors = find(*frame(*opening), recess=leaf, recess_m=0.25)
    np.testing.assert_allclose(doors.depth_m, [0.25], atol=0.01)
    assert find(*frame(*opening)).depth_m == [0.0]


def test_the_frame_of_a_leaf_that_hangs_before_its_wall_is_a_casing_too() -> None:
    """A pane set back in its frame by 2 cm, all of it before the wall."""
    doors = find(*frame(1.5, 2.4, 0.0, 2.0), relief_m=0.055, recess=(1.5, 2.4, 0.0, 2.0), recess_m=-0.035)
    np.testing.assert_allclose(doors.depth_m, [-0.035], atol=0.005)


def test_a_doorway_that_rays_pass_is_no_closed_door() -> None:
    assert len(find(*frame(1.5, 2.4, 0.0, 2.0), passed=(1.5, 2.4, 0.0, 2.0))) == 0


@pytest.mark.parametrize("columns", [0, 3, 12])
def test_a_short_face_and_none(columns: int) -> None:
    walls = faces(((0, 0), (columns * CELL_M, 0))) if columns else NO_WALLS
    cells = WallCells(first_columns(walls), 60, np.ones((columns, 60, 4), np.float32))
    assert len(find_cased_doors(traced(walls, cells), BuildingSettings(), DoorCasingsSettings())) == 0
