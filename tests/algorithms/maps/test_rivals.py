"""The paper's other maps of a furnished room that is known."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.trajectory import PlacedScan, place_scan
from ffmap.algorithms.base.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings
from ffmap.algorithms.maps.free_space import draw_free
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.algorithms.maps.rivals import _HITS_MIN, Rival, draft_rival, rival_returns
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.summary import extract
from tests import synthetic

KNEE_M = BuildingSettings().knee_m
CELL_M = 0.05


@pytest.fixture(scope="module")
def scans() -> list[tuple[PlacedScan, ScanLabelling]]:
    trajectory = synthetic.trajectory(4)
    found = []
    for i in range(4):
        scan = synthetic.scan(i)
        placed = place_scan(scan, trajectory, synthetic.T_BASE_SENSOR)
        found.append((placed, label_scan(scan, placed, synthetic.settings(), seed=0)))
    return found


def counted(scans: list[tuple[PlacedScan, ScanLabelling]]) -> VoxelVotes:
    table = VoxelTable(CELL_M, len(Rival))
    for placed, labelling in scans:
        points_map = placed.to_map(placed.points_level)
        table.add(*rival_returns(points_map, labelling))
    return table.votes()


def cells_of(votes: VoxelVotes, rival: Rival) -> np.ndarray:
    strong = votes.counts[:, list(Rival).index(rival)] >= _HITS_MIN
    return (votes.cube_index[strong, :2] + 0.5) * CELL_M


def test_each_rival_sees_its_own_heights(scans):
    votes = counted(scans)
    low, high = synthetic.LOW_M[:2], synthetic.HIGH_M[:2]

    def off_the_walls(rival: Rival) -> np.ndarray:
        places = cells_of(votes, rival)
        assert len(places) > 50
        distance = np.minimum(places - low, high - places).min(axis=1)
        return places[distance > 0.1]

    # The table is lower than both slices, and before the wall.
    assert len(off_the_walls(Rival.BELOW_CEILING)) == 0
    assert len(off_the_walls(Rival.MIDDLE)) == 0
    assert len(off_the_walls(Rival.UPMOST)) == 0
    table = off_the_walls(Rival.BOTTOMMOST)
    (x0, y0, _), (x1, _, _) = synthetic.TABLE_M
    assert len(table) > 0
    assert ((table[:, 0] > x0 - 0.1) & (table[:, 0] < x1 + 0.1) & (table[:, 1] > y0 - 0.1)).all()


def test_a_slice_under_the_ceiling_does_not_see_the_door(scans):
    votes = counted(scans)
    (left, right), wall = synthetic.DOOR_X_M, synthetic.LOW_M[1]

    def behind(rival: Rival) -> int:
        places = cells_of(votes, rival)
        within = (places[:, 0] > left + 0.1) & (places[:, 0] < right - 0.1)
        return int(np.count_nonzero(within & (places[:, 1] < wall - 0.04)))

    assert behind(Rival.BELOW_CEILING) == 0
    assert behind(Rival.MIDDLE) > 0


def test_without_a_ceiling_there_is_no_slice(scans):
    placed, labelling = scans[0]
    bare = replace(labelling, below_m=np.full_like(labelling.below_m, np.inf))
    votes = counted([(placed, bare)])
    assert votes.counts[:, :2].sum() == 0
    assert votes.counts[:, 2:].sum() > 0


def test_rivals_are_drawn_and_freed_by_rays(scans):
    blocks = [extract(i, *scan) for i, scan in enumerate(scans)]
    drive = Drive(np.array([placed.origin_level for placed, _ in scans]), lambda: blocks)
    votes, path = counted(scans), drive.path_map[:, :2]
    for rival in Rival:
        frame = GridMap.around([cells_of(votes, rival), path], CELL_M)
        draft = draft_rival(rival, votes, frame, NO_WINDOWS)
        (grid,) = draw_free([draft], frame, drive, KNEE_M)
        np.testing.assert_allclose(
            np.sort(grid.centres(Cell.OCCUPIED), axis=0).mean(axis=0),
            cells_of(votes, rival).mean(axis=0),
            atol=0.1,
        )
        assert np.count_nonzero(grid.cells == Cell.FREE) > 1000
