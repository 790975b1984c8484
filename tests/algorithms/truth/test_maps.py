"""Grid maps against the truth: wall cells, and doors that are blocked or not."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Truth
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.truth.maps import blocked_doors, cells_along, compare_wall_map
from ffmap.algorithms.truth.tally import CUBE_M
from tests.rasters import moved, raster
from tests.voting import vote


class TestWallMap:
    def grid(self, *occupied_row_column: tuple[int, int]) -> GridMap:
        cells = np.full((40, 60), Cell.FREE, np.uint8)
        for row, column in occupied_row_column:
            cells[row, column] = Cell.OCCUPIED
        return GridMap(cells, np.array([-1.0, -1.0]), 0.05)

    def wall_returns(self, *cells_and_counts: tuple[int, int, int], code: int = Truth.WALL):
        """Returns in the cells (x, y), spread over heights."""
        points = np.concatenate(
            [
                np.stack([np.full(n, (x + 0.5) * 0.05), np.full(n, (y + 0.5) * 0.05), 0.3 * np.arange(n)], axis=1)
                for x, y, n in cells_and_counts
            ]
        )
        return vote(points, np.full(len(points), code, np.uint8), 25, CUBE_M)

    FACE = np.array([[[0.0, 0.025], [0.5, 0.025]]])

    def test_cells_that_a_segment_runs_through(self):
        assert cells_along(np.array([[0.01, 0.01], [0.11, 0.01]]), 0.05).tolist() == [[0, 0], [1, 0], [2, 0]]
        diagonal = cells_along(np.array([[0.01, 0.0], [0.11, 0.1]]), 0.05).tolist()
        assert diagonal == [[0, 0], [1, 0], [1, 1], [2, 1]]
        assert cells_along(np.array([[-0.01, 0.01], [-0.01, 0.01]]), 0.05).tolist() == [[-1, 0]]
        assert cells_along(np.array([[0.11, 0.01], [0.01, 0.01]]), 0.05).tolist() == [[0, 0], [1, 0], [2, 0]]

    def test_true_cells_need_a_face_and_three_returns_of_walls(self):
        cubes = self.wall_returns((0, 0, 3), (1, 0, 2), (2, 1, 9), (4, 0, 5))
        figures = compare_wall_map(self.FACE, cubes, self.grid())
        np.testing.assert_allclose(figures.true_cells, [[0.025, 0.025], [0.225, 0.025]])
        clutter = self.wall_returns((0, 0, 9), code=Truth.CLUTTER)
        assert len(compare_wall_map(self.FACE, clutter, self.grid()).true_cells) == 0

    def test_precision_recall_and_error_by_hand(self):
        cubes = self.wall_returns((0, 0, 3), (9, 0, 3))
        # Centres: (0.025, 0.025) on the face, (0.025, 0.075) 5 cm off, (0.025, 0.325) 30 cm off.
        figures = compare_wall_map(self.FACE, cubes, self.grid((20, 20), (21, 20), (26, 20)))
        assert figures.precision == pytest.approx(2 / 3)
        assert figures.recall == pytest.approx(1 / 2)
        assert figures.error_m == pytest.approx(0.025)

    def test_ten_centimetres_are_still_right(self):
        figures = compare_wall_map(self.FACE, self.wall_returns((0, 0, 3)), self.grid((22, 20)))
        assert (figures.precision, figures.recall) == (1, 1)

    def test_empty_map_empty_truth(self):
        cubes = self.wall_returns((0, 0, 3))
        figures = compare_wall_map(self.FACE, cubes, self.grid())
        assert np.isnan(figures.precision)
        assert figures.recall == 0
        figures = compare_wall_map(np.zeros((0, 2, 2)), cubes, self.grid((20, 20)))
        assert figures.precision == 0
        assert np.isnan([figures.recall, figures.error_m]).all()


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_doorway_is_blocked_unless_free_cells_lead_through(turn_deg: float) -> None:
    wall = moved(np.array([[[0, 0], [1, 0]], [[2, 0], [3, 0]], [[0, 0.2], [1, 0.2]], [[2, 0.2], [3, 0.2]]], float),
                 turn_deg, (0.0, 0.0))  # fmt: skip
    sill = moved(np.array([[[1, 0.1], [2, 0.1]]], float), turn_deg, (0.0, 0.0))
    thick = np.array([0.2])
    assert not blocked_doors(raster(wall), sill, thick)[0]
    leaf = moved(np.array([[[1, 0.05], [2, 0.05]]], float), turn_deg, (0.0, 0.0))
    assert blocked_doors(raster(np.concatenate([wall, leaf])), sill, thick)[0]
    # A leaf that stands open leaves a way.
    ajar = moved(np.array([[[1, 0.05], [1.6, 0.15]]], float), turn_deg, (0.0, 0.0))
    assert not blocked_doors(raster(np.concatenate([wall, ajar])), sill, thick)[0]
    unknown = raster(wall)
    unknown = GridMap(np.where(unknown.cells == Cell.FREE, Cell.UNKNOWN, unknown.cells), unknown.origin, 0.05)
    assert blocked_doors(unknown, sill, thick)[0]
    assert len(blocked_doors(raster(wall), np.zeros((0, 2, 2)), np.zeros(0))) == 0
