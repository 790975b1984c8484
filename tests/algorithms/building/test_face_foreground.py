"""What stands flat against a wall, told by the mean distance of each cell's returns before it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.evidence import BEFORE, BEYOND, FAR, LAYERS_M, Evidence
from ffmap.algorithms.building.face_foreground import (
    Foreground,
    ForegroundSettings,
    covered_places,
    find_foreground,
)
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, Doors, Walls, unknown_support
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import traced

CEILING_M = 2.8
LENGTH_M = 6.0
SETTINGS = ForegroundSettings()
FACE = Walls(
    np.array([[[0.0, 0.0], [LENGTH_M, 0.0]]]),
    np.array([[0.0, 1.0]]),
    np.zeros(1),
    np.array([CEILING_M]),
    np.array([9], np.int32),
    np.array([0.01]),
    np.array([900]),
    unknown_support(1),
)
FLAT = (0.0, 0.0)


def evidence_of(counts: FloatArray) -> Evidence:
    """Of one face, by counts (c, rows, 3) of its cells, each in the layer of its mean distance.

    Counts: returns, and sums of their distances before the face and of squares of these.
    """
    columns, rows = counts.shape[:2]
    mean_m = counts[..., 1] / np.maximum(counts[..., 0], 1.0)
    layer = np.clip(np.digitize(mean_m, LAYERS_M[1:]), BEFORE, FAR)
    own = (np.arange(BEYOND) == layer[..., None]).astype(np.float32)
    ended, *sums = (own * counts[..., [k]] for k in range(3))
    ended = np.concatenate([ended, np.zeros((columns, rows, 1), np.float32)], axis=-1)
    nothing = np.zeros((columns, rows, 3), np.float32)
    return Evidence(np.array([0, columns]), ended, sums[0], sums[1].sum(axis=-1), nothing)


def foreground(
    counts: FloatArray, ceiling_m: float = CEILING_M, doors: Doors = NO_DOORS
) -> Foreground:
    """Of the one face, with counts (c, rows, 3) of its cells."""
    faces = traced(FACE, evidence_of(counts), ceiling_m)
    no_opening = np.zeros(faces.evidence.ended.shape[:2], bool)
    return find_foreground(faces, no_opening, doors, SETTINGS)


def relief(
    x_m: tuple[float, float],
    z_m: tuple[float, float],
    depth_m: float,
    wall_m: tuple[float, float] = FLAT,
    outline: int = 0,
    ceiling_m: float = CEILING_M,
    doors: Doors = NO_DOORS,
) -> FloatArray:
    """The cells that are covered where something stands so far before a face that leans from its wall at its ends.

    outline: so many cells around it may be covered as well. ceiling_m: up to there the face returns.
    """
    columns, rows = round(LENGTH_M / CELL_M), 60
    x, z = (np.arange(columns) + 0.5) * CELL_M, (np.arange(rows) + 0.5) * CELL_M
    before_m = np.interp(x, [0, LENGTH_M], wall_m)[:, None] + np.zeros((columns, rows))
    thing = ((x > x_m[0]) & (x < x_m[1]))[:, None] & (z > z_m[0]) & (z < z_m[1])
    before_m = before_m + depth_m * thing + np.random.default_rng(3).normal(0, 0.003, before_m.shape)
    counts = np.zeros((columns, rows, 3), np.float32)
    counts[..., 0] = 40.0 * (z < ceiling_m)
    counts[..., 1] = counts[..., 0] * before_m
    covered = foreground(counts, ceiling_m, doors).covered
    around = ndimage.binary_dilation(thing, np.ones((2 * outline + 1, 2 * outline + 1)))
    assert not covered[~around].any()
    return np.asarray(covered[thing & (z > 0.1)])


@pytest.mark.parametrize("wall_m", [FLAT, (-0.03, 0.05)])
def test_the_back_of_a_shelf_is_covered_however_the_face_leans(wall_m: tuple[float, float]) -> None:
    # A cell at its outline is told with those beside it.
    assert relief((1.0, 2.0), (0.0, 1.6), 0.025, wall_m, outline=1).mean() > 0.98


@pytest.mark.parametrize("state", list(DoorState))
def test_the_leaf_of_a_closed_door_covers_no_wall(state: DoorState) -> None:
    """It hangs before the wall; what stands before an open doorway is no leaf that closes it."""
    doors = replace(
        NO_DOORS,
        ends=np.array([[[2.0, 0.0], [1.0, 0.0]]]),
        normal=FACE.normal,
        head_m=np.array([2.0]),
        state=np.array([state], np.uint8),
        wall=np.zeros(1, np.int32),
    )
    covered = relief((1.0, 2.0), (0.0, 2.0), 0.05, outline=1, doors=doors)
    assert covered.mean() > 0.98 if state == DoorState.OPEN else not covered.any()
    # Beside the door, and above its head, something covers the wall all the same.
    assert relief((1.0, 3.0), (0.0, 2.0), 0.05, outline=1, doors=doors).mean() > 0.45


def test_in_a_low_room_the_last_rows_below_the_ceiling_tell_where_the_wall_is() -> None:
    """Nothing there is higher than leaves are elsewhere."""
    assert relief((1.0, 2.0), (0.0, 1.6), 0.025, outline=1, ceiling_m=2.2).mean() > 0.98
    assert not relief((1.0, 2.0), (0.0, 2.2), 0.025, ceiling_m=2.2).any()


@pytest.mark.parametrize(
    ("x_m", "z_m", "depth_m"),
    [
        ((1.0, 2.0), (0.0, 1.6), 0.005),  # unevenness
        ((1.0, 2.0), (0.9, 2.0), 0.025),  # a board that hangs on its wall
        ((1.0, 2.0), (0.0, 2.8), 0.025),  # a pillar
        ((1.0, 1.4), (0.0, 2.8), 0.08),  # one that the wall beside it outweighs
        ((1.0, 5.0), (0.0, 1.2), 0.025),  # panelling
        ((1.0, 3.0), (0.0, 0.15), 0.025),  # a skirting board
    ],
)
def test_what_is_part_of_a_wall_is_not(x_m: tuple[float, float], z_m: tuple[float, float], depth_m: float) -> None:
    assert not relief(x_m, z_m, depth_m).any()


def test_the_casing_of_a_doorway_is_wall_and_a_shelf_as_large_is_not() -> None:
    """It stands on the floor too, as high and wide as a shelf, but is a strip of 10 cm all around the leaf."""
    columns, rows = round(LENGTH_M / CELL_M), 60
    before_m = np.random.default_rng(3).normal(0, 0.003, (columns, rows))
    before_m[20:40, :42], before_m[70:90, :42] = 0.02, 0.02
    before_m[22:38, :40] = -0.03
    counts = np.zeros((columns, rows, 3), np.float32)
    counts[..., 0] = 40.0 * ((np.arange(rows) + 0.5) * CELL_M < CEILING_M)
    counts[..., 1] = counts[..., 0] * before_m
    covered = foreground(counts).covered
    assert not covered[:50].any()
    assert covered[70:90, 2:42].mean() > 0.95


def test_a_wall_that_leans_is_no_relief_but_a_step_on_it_is() -> None:
    """Poses tilt by a degree: at its foot a wall then comes 3 cm forward, all along."""
    columns, rows = round(LENGTH_M / CELL_M), 60
    z = (np.arange(rows) + 0.5) * CELL_M

    def covered(before_m: FloatArray) -> FloatArray:
        counts = np.zeros((columns, rows, 3), np.float32)
        counts[..., 0] = 40.0 * (z < CEILING_M)
        counts[..., 1] = counts[..., 0] * before_m
        return np.asarray(foreground(counts).covered)

    noise_m = np.random.default_rng(3).normal(0, 0.003, (columns, rows))
    lean_m = np.zeros((columns, rows))
    lean_m[20:70] = 0.03 * (1 - z / CEILING_M)
    assert not covered(lean_m + noise_m).any()
    step_m = np.zeros((columns, rows))
    step_m[20:70, z < 1.4] = 0.03
    assert covered(step_m + noise_m)[20:70, 2:28].mean() > 0.95


def test_a_shelf_is_one_thing_though_its_boards_hide_parts_of_its_back() -> None:
    columns, rows = round(LENGTH_M / CELL_M), 60
    counts = np.zeros((columns, rows, 3), np.float32)
    counts[:, :56, 0] = 40.0
    counts[20:40, 0:32, 1] = 40.0 * 0.03
    counts[20:40, 10:15] = 0.0
    before = foreground(counts)
    assert before.covered[20:40, 15:32].all()


def sparse(low: int, high: int, depth_m: float, share: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """What is covered where two returns a cell tell of a wall, and of a thing before it in columns low to high, 1.6 m high.

    share: of the thing's returns so many, spread evenly, are its own; the others are the wall's.
    """
    columns, rows = round(LENGTH_M / CELL_M), 60
    generator = np.random.default_rng(5)
    before_m = generator.normal(0, 0.01, (columns, rows, 2))
    own = generator.uniform(size=(high - low, 32, 2)) < share
    before_m[low:high, :32] += depth_m * own
    counts = np.zeros((columns, rows, 3), np.float32)
    counts[:, :56, 0] = 2.0
    counts[:, :56, 1], counts[:, :56, 2] = before_m[:, :56].sum(axis=2), (before_m[:, :56] ** 2).sum(axis=2)
    covered = foreground(counts).covered
    return covered[low + 2 : high - 2, 4:30], np.delete(covered, np.s_[low - 4 : high + 4], axis=0)


def test_few_returns_tell_together() -> None:
    thing, wall = sparse(40, 60, 0.025)
    assert thing.mean() > 0.95
    assert not wall.any()
    # What is farther before the wall, and hides it here and there, is no sheet that stands flat against it.
    thing, wall = sparse(40, 60, 0.08, share=0.3)
    assert not thing.any()
    assert not wall.any()


def test_the_reveal_of_a_high_window_is_not_the_wall_that_relief_is_measured_from() -> None:
    columns, rows = round(LENGTH_M / CELL_M), 60
    counts = np.zeros((columns, rows, 3), np.float32)
    counts[:, :56, 0] = 40.0
    counts[40:70, 18:47, 1] = -40.0 * 0.1
    # Curtains hide the wall beside its head.
    counts[34:40, 43:] = counts[70:76, 43:] = 0.0
    assert not foreground(counts).covered.any()


def test_covered_places_lie_on_their_face_above_its_floor() -> None:
    before = replace(foreground(np.zeros((120, 60, 3), np.float32)), ground_m=np.full(120, 0.6))
    before.covered[:80, : round(1.0 / CELL_M)] = True
    places = covered_places(FACE, before)
    assert len(places) == 80 * 20
    assert np.all(places[:, 1] == 0.0)
    assert places[:, 2].max() == pytest.approx(0.6 + 1.0 - 0.5 * CELL_M)
