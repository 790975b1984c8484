"""All maps of two rooms that are known."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from ffmap.algorithms.building.evidence import Evidence
from ffmap.algorithms.building.fusion import fuse_building
from ffmap.algorithms.building.model import BuildingSettings, Walls
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.all_maps import MapsSettings, draw_maps
from ffmap.algorithms.maps.area_graph import AreaGraphSettings, Segmented
from ffmap.algorithms.maps.grid import GridMapSettings
from ffmap.algorithms.maps.rivals import Rival
from tests.algorithms.building.test_fusion import SETTINGS, driven
from tests.two_rooms import TwoRooms

MAPS = MapsSettings(
    BuildingSettings(),
    WallThicknessSettings(),
    GridMapSettings(),
    AreaGraphSettings(),
)


@pytest.mark.parametrize("closed", [False, True])
def test_two_rooms_are_two_rooms_and_every_map_shows_the_same_extent(closed: bool) -> None:
    rooms = TwoRooms(closed=closed)
    scans = driven(rooms)
    building = fuse_building(scans, SETTINGS)

    def traced_again(_: Walls) -> Evidence:
        pytest.fail("The maps draw what the building was parsed into.")

    maps = draw_maps(building, replace(scans, trace=traced_again), MAPS)
    assert len(maps.rooms) == 2
    assert set(maps.compared_rooms) == set(Segmented) - {Segmented.FURNITURE_FREE}
    assert set(maps.rivals) == set(Rival)
    for rival in maps.rivals.values():
        assert rival.cells.shape == maps.grid.cells.shape
        np.testing.assert_array_equal(rival.origin, maps.grid.origin)
    corners = np.concatenate([shapely.get_coordinates(room.polygon) for room in maps.rooms.rooms])
    faces = shapely.union_all(shapely.linestrings(rooms.walls.ends))
    np.testing.assert_allclose(shapely.distance(shapely.points(corners), faces), 0.0, atol=0.02)
