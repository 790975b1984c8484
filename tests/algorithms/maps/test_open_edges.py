"""Edges of free space at which scans found a wall."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.open_edges import close_edges, open_edges
from tests.voting import vote

NO_PANES: FloatArray = np.zeros((0, 2, 2))


def room(drawn: bool = False) -> GridMap:
    """Free from y = 1 to y = 3, and unknown beyond; drawn: with a wall at y = 3."""
    cells = np.full((80, 100), Cell.UNKNOWN, np.uint8)
    cells[20:60, 10:90] = Cell.FREE
    if drawn:
        cells[60, 10:90] = Cell.OCCUPIED
    return GridMap(cells, np.zeros(2), 0.05)


def wall(length_m: float = 2.0, label: Label = Label.WALL, top_m: float = 2.5) -> VoxelVotes:
    """What scans found at y = 3.02 from x = 1 on."""
    x, z = np.meshgrid(np.arange(1.02, 1.0 + length_m, 0.05), np.arange(0.03, top_m, 0.05))
    places = np.stack([x.ravel(), np.full(x.size, 3.02), z.ravel()], axis=1)
    return vote(places, np.full(len(places), label, np.uint8), len(Label), 0.05)


def test_a_wall_that_ends_free_space_is_drawn_where_it_was_seen() -> None:
    grid, votes = room(), wall()
    closed = close_edges(grid, votes, NO_PANES)
    drawn = closed.centres(Cell.OCCUPIED)
    np.testing.assert_allclose(np.ptp(drawn, axis=0), [1.95, 0.0], atol=1e-9)
    np.testing.assert_allclose(drawn[:, 1], 3.025)
    assert not open_edges(closed, votes, NO_PANES).any()
    same = replace(closed, cells=np.where(closed.cells == Cell.OCCUPIED, grid.cells, closed.cells))
    np.testing.assert_array_equal(same.cells, grid.cells)


def test_the_cells_in_which_rays_ended_may_be_free() -> None:
    grid = room()
    grid.cells[60, 10:90] = Cell.FREE
    assert open_edges(grid, wall(), NO_PANES)[60].any()


@pytest.mark.parametrize(
    "votes", [wall(0.8), wall(label=Label.CLUTTER), wall(top_m=0.1)], ids=["short", "no wall", "low"]
)
def test_what_is_short_or_no_wall_is_not_drawn(votes: VoxelVotes) -> None:
    assert not open_edges(room(), votes, NO_PANES).any()


def test_what_is_drawn_already_is_not_drawn_again_and_panes_are_not_drawn() -> None:
    assert not open_edges(room(drawn=True), wall(), NO_PANES).any()
    pane = np.array([[[0.5, 3.05], [4.5, 3.05]]])
    assert not open_edges(room(), wall(), pane).any()
