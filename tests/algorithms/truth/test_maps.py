"""Grid maps against the ground truth: cells of walls, and doors that are blocked or not."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import ComparedMap, blocked_doors, cells_along, compare_map
from ffmap.algorithms.truth.tally import VOXEL_M
from tests.rasters import moved, raster
from tests.voting import vote

FACE = np.array([[[0.0, 0.025], [0.5, 0.025]]])


def compare(
    voxels: VoxelVotes, *occupied: tuple[int, int], faces: np.ndarray = FACE
) -> ComparedMap:
    """Compare a map with some occupied cells (row, column)."""
    cells = np.full((40, 60), Cell.FREE, np.uint8)
    for row, column in occupied:
        cells[row, column] = Cell.OCCUPIED
    grid = GridMap(cells, np.array([-1.0, -1.0]), 0.05)
    return compare_map(grid, faces, voxels, np.zeros((0, 2, 2)), np.zeros(0))


def returns(*cells_and_counts: tuple[int, int, int], code: int = Truth.WALL) -> VoxelVotes:
    """Returns in cells (x, y), at many heights."""
    points = np.array(
        [
            ((x + 0.5) * 0.05, (y + 0.5) * 0.05, 0.3 * k)
            for x, y, count in cells_and_counts
            for k in range(count)
        ]
    )
    return vote(points, np.full(len(points), code, np.uint8), 25, VOXEL_M)


@pytest.mark.parametrize(
    ("segment", "cells"),
    [
        ([[0.01, 0.01], [0.11, 0.01]], [[0, 0], [1, 0], [2, 0]]),
        ([[0.11, 0.01], [0.01, 0.01]], [[0, 0], [1, 0], [2, 0]]),
        ([[0.01, 0.0], [0.11, 0.1]], [[0, 0], [1, 0], [1, 1], [2, 1]]),
        ([[-0.01, 0.01], [-0.01, 0.01]], [[-1, 0]]),
    ],
)
def test_cells_that_a_segment_runs_through(segment: list, cells: list) -> None:
    assert cells_along(np.array(segment), 0.05).tolist() == cells


def test_true_cells_need_a_face_and_three_returns_of_walls() -> None:
    compared = compare(returns((0, 0, 3), (1, 0, 2), (2, 1, 9), (4, 0, 5)))
    np.testing.assert_allclose(compared.true_cells, [[0.025, 0.025], [0.225, 0.025]])
    assert len(compare(returns((0, 0, 9), code=Truth.CLUTTER)).true_cells) == 0


def test_precision_recall_and_error_by_hand() -> None:
    # Centres on the face, 5 cm off and 30 cm off.
    compared = compare(returns((0, 0, 3), (9, 0, 3)), (20, 20), (21, 20), (26, 20))
    assert compared.precision == pytest.approx(2 / 3)
    assert compared.recall == pytest.approx(1 / 2)
    assert compared.error_m == pytest.approx(0.025)
    at_limit = compare(returns((0, 0, 3)), (22, 20))
    assert (at_limit.precision, at_limit.recall) == (1, 1)
    cabinet = compare(returns((0, 6, 3), code=Truth.FULL_HEIGHT_CABINET), (26, 20))
    assert (cabinet.cabinets, cabinet.precision) == (1, 0)


def test_empty_map_and_empty_ground_truth() -> None:
    empty = compare(returns((0, 0, 3)))
    assert np.isnan(empty.precision)
    assert empty.recall == 0
    no_faces = compare(returns((0, 0, 3)), (20, 20), faces=np.zeros((0, 2, 2)))
    assert no_faces.precision == 0
    assert np.isnan([no_faces.recall, no_faces.error_m]).all()


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_doorway_is_blocked_unless_free_cells_lead_through(turn_deg: float) -> None:
    def turned(*segments: list) -> np.ndarray:
        return moved(np.array(segments, float), turn_deg, (0.0, 0.0))

    sides = ([[0, 0], [1, 0]], [[2, 0], [3, 0]], [[0, 0.2], [1, 0.2]], [[2, 0.2], [3, 0.2]])
    sill, thick, doorway = turned([[1, 0.1], [2, 0.1]]), np.array([0.2]), raster(turned(*sides))
    assert not blocked_doors(doorway, sill, thick)[0]
    closed = raster(turned(*sides, [[1, 0.05], [2, 0.05]]))
    assert blocked_doors(closed, sill, thick)[0]
    ajar = raster(turned(*sides, [[1, 0.05], [1.6, 0.15]]))
    assert not blocked_doors(ajar, sill, thick)[0]
    unknown = np.where(doorway.cells == Cell.FREE, Cell.UNKNOWN, doorway.cells)
    assert blocked_doors(GridMap(unknown, doorway.origin, 0.05), sill, thick)[0]
