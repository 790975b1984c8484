"""Maps laid over each other: a known motion is recovered, another building is told."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import Agreement, overlay
from ffmap.algorithms.truth.reference import Alignment, align_maps, compare_with_reference, unseen_walls

PLAN = np.array(
    [
        [[0, 0], [9, 0]], [[9, 0], [9, 6]], [[9, 6], [0, 6]], [[0, 6], [0, 0]],
        [[4, 0], [4, 3.5]], [[4, 4.5], [4, 6]], [[4, 2], [6.5, 2]], [[7.5, 2], [9, 2]],
    ],
    float,
)  # fmt: skip
OTHER = np.array(
    [
        [[0, 0], [3, 0]], [[3, 0], [3, 14]], [[3, 14], [0, 14]], [[0, 14], [0, 0]],
        [[0, 5], [1, 5]], [[2, 5], [3, 5]], [[3, 9], [8, 12]], [[8, 12], [3, 14]],
    ],
    float,
)  # fmt: skip


def moved(plan: FloatArray, turn_deg: float, shift: tuple[float, float]) -> FloatArray:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return plan @ np.array([[c, s], [-s, c]]) + np.array(shift)


def raster(plan: FloatArray, cell_m: float = 0.05, noise_m: float = 0.0, furniture: int = 0) -> GridMap:
    generator = np.random.default_rng(0)
    dots = np.concatenate([a + np.linspace(0, 1, 400)[:, None] * (b - a) for a, b in plan])
    dots = dots + generator.normal(0, noise_m, dots.shape) if noise_m else dots
    low, high = dots.min(axis=0), dots.max(axis=0)
    dots = np.concatenate([dots, generator.uniform(low, high, (furniture, 2))])
    origin = np.floor((low - 0.5) / cell_m) * cell_m
    columns, rows = np.ceil((high + 0.5 - origin) / cell_m).astype(int)
    cells = np.full((rows, columns), Cell.FREE, np.uint8)
    index = np.clip(np.floor((dots - origin) / cell_m).astype(int), 0, [columns - 1, rows - 1])
    cells[index[:, 1], index[:, 0]] = Cell.OCCUPIED
    return GridMap(cells, origin, cell_m)


@pytest.mark.parametrize(("turn_deg", "shift"), [(0.0, (0.0, 0.0)), (71.3, (12.4, -3.3)), (-152.6, (-40.0, 25.5))])
def test_a_known_motion_is_recovered(turn_deg: float, shift: tuple[float, float]) -> None:
    grid, reference = raster(PLAN, noise_m=0.01, furniture=40), raster(moved(PLAN, turn_deg, shift), 0.08)
    found = align_maps(grid, reference)
    assert found.fits
    assert (found.turn_deg - turn_deg + 180) % 360 - 180 == pytest.approx(0, abs=0.3)
    np.testing.assert_allclose(found.shift_m, shift, atol=0.06)
    np.testing.assert_allclose(found.to_map(moved(PLAN, turn_deg, shift)), PLAN, atol=0.06)


def test_another_building_does_not_fit() -> None:
    assert not align_maps(raster(PLAN), raster(OTHER)).fits
    assert not align_maps(raster(OTHER), raster(PLAN)).fits
    empty = GridMap(np.full((9, 9), Cell.FREE, np.uint8), np.zeros(2), 0.05)
    assert not align_maps(empty, raster(PLAN)).fits
    assert not align_maps(raster(PLAN), empty).fits


def test_figures_against_a_reference() -> None:
    reference = raster(PLAN)
    # The map lacks the inner walls, has one that is not there, and is a cell off.
    false = np.array([[[1.0, 3.0], [3.0, 3.0]]])
    grid = raster(np.concatenate([PLAN[:4], false]) + np.array([0.0, 0.06]))
    figures = compare_with_reference(grid, grid, reference, Alignment(np.eye(3), 1.0))
    assert figures.precision == pytest.approx(30 / 32, abs=0.01)
    assert figures.recall == pytest.approx(30 / 39, abs=0.02)
    assert 0.0 < figures.error_m < 0.08
    shown = overlay(grid, figures, np.zeros((0, 2)))

    def at(x: float, y: float) -> int:
        column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_m).astype(int)
        return int(shown[row, column])

    assert at(2.0, 3.07) == Agreement.ONLY_MAP
    assert at(4.01, 1.0) == Agreement.ONLY_REFERENCE
    assert at(2.0, 0.07) == Agreement.BOTH
    assert at(2.0, 1.0) == Agreement.FREE


def test_walls_that_the_map_never_saw_are_not_missed() -> None:
    reference = raster(PLAN)
    half = raster(PLAN)
    cells = half.cells.copy()
    cells[:, int((5.0 - half.origin[0]) / 0.05) :] = Cell.UNKNOWN
    half = GridMap(cells, half.origin, half.cell_m)
    identity = Alignment(np.eye(3), 1.0)
    figures = compare_with_reference(half, half, reference, identity)
    assert figures.recall > 0.99
    assert unseen_walls(half, reference, identity)[:, 0].min() > 4.9
