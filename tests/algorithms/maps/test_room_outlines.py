"""Outlines of cells, laid on the faces that bound the rooms."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
from shapely import affinity

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import turned
from ffmap.algorithms.building.model import BuildingSettings
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.area_graph import (
    AreaGraph,
    AreaGraphSettings,
    doorways_of,
    find_rooms,
    sides_of,
)
from ffmap.algorithms.maps.furniture_free import standing_stretches
from ffmap.algorithms.maps.grid import GridMapSettings
from ffmap.algorithms.maps.room_outlines import Sides, lay_on_faces
from tests.drawing import draw_furniture_free
from tests.two_rooms import SIZE_M, TwoRooms

KNEE_M = BuildingSettings().knee_m
CELL_M = 0.05
L_SHAPE = np.array([[0, 0], [6, 0], [6, 2.5], [3.5, 2.5], [3.5, 5], [0, 5]], float)
PILLAR = np.array([[1, 1], [1, 1.4], [1.4, 1.4], [1.4, 1]], float)


def in_cells(room: shapely.Polygon) -> shapely.Polygon:
    """What a grid makes of a room: all cells whose middle is in it or half a cell from it."""
    low, high = np.floor(np.reshape(room.bounds, (2, 2)) / CELL_M) + np.array([[-2], [2]])
    axes = np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)))
    corners = CELL_M * np.stack(axes, axis=-1).reshape(-1, 2)
    middles = corners + CELL_M / 2
    left, bottom = corners[shapely.contains_xy(room.buffer(CELL_M / 2), *middles.T)].T
    cells = shapely.box(left, bottom, left + CELL_M, bottom + CELL_M)
    return shapely.union_all(cells, grid_size=1e-9)


def faces_of(room: shapely.Polygon, short_m: float = 0.0) -> Sides:
    """The faces around a room, which end `short_m` before its corners."""
    ends, normals = [], []
    for ring in (shapely.polygons(room.exterior).normalize().exterior.reverse(), *room.interiors):
        hole = ring in list(room.interiors)
        corners = shapely.get_coordinates(ring)
        ccw = shapely.is_ccw(ring)
        for a, b in pairwise(corners):
            along = (b - a) / np.linalg.norm(b - a)
            left = np.array([-along[1], along[0]])
            ends.append([a + short_m * along, b - short_m * along])
            normals.append(left if ccw != hole else -left)
    return Sides(np.array(ends), np.array(normals))


def building(rooms: TwoRooms) -> AreaGraph:
    immobile, drive = rooms.build()
    grid = draw_furniture_free(immobile, drive, GridMapSettings(), WallThicknessSettings(), KNEE_M)
    doors, windows = immobile.doors, immobile.windows
    faces = (standing_stretches(immobile), *sides_of(doors), windows)
    ways = doorways_of(doors)
    return find_rooms(grid, AreaGraphSettings(), ways, windows.ends, drive.path_map, faces)


@pytest.mark.parametrize("turn_deg", [0.0, 12.0, 37.0])
def test_rooms_end_at_the_faces_of_their_walls(turn_deg: float) -> None:
    rooms = TwoRooms(turn_deg=turn_deg, shift=(0.37, -1.21))
    found = building(rooms)
    (x, y), t = SIZE_M, rooms.thickness_m
    for room, low, high in zip(found.rooms, (0, y + t), (y, 2 * y), strict=True):
        corners = np.array([(0, low), (x, low), (x, high), (0, high)], float)
        true = shapely.Polygon(rooms.to_map(corners))
        assert room.polygon.symmetric_difference(true).area < 1e-3
        assert len(room.polygon.exterior.coords) == 5
        assert room.polygon.exterior.hausdorff_distance(true.exterior) < 1e-4


@pytest.mark.parametrize("turn_deg", [0.0, 15.0, 40.0])
@pytest.mark.parametrize("short_m", [0.0, 0.06])
def test_inner_and_outer_corners_and_pillars_are_met(turn_deg: float, short_m: float) -> None:
    room = shapely.Polygon(turned(L_SHAPE, turn_deg), [turned(PILLAR, turn_deg)])
    (laid,) = lay_on_faces([in_cells(room)], [faces_of(room, short_m)], CELL_M)
    assert laid.symmetric_difference(room).area < 1e-4
    assert len(shapely.get_coordinates(laid)) == len(shapely.get_coordinates(room))


def test_what_no_face_bounds_stays_where_it_was_without_steps() -> None:
    room = shapely.Polygon(turned(L_SHAPE, 20.0))
    cells, faces = in_cells(room), faces_of(room)
    away_m = np.linalg.norm(faces.ends.mean(axis=1) - turned(np.array([6.0, 1.25]), 20.0), axis=1)
    known = away_m > 0.1
    (laid,) = lay_on_faces([cells], [Sides(faces.ends[known], faces.normal[known])], CELL_M)
    assert laid.symmetric_difference(room).area < 2.5 * CELL_M
    assert len(laid.exterior.coords) < 12
    # A face that the room does not reach attracts nothing, nor does one that it goes around.
    far = Sides(
        np.array([[[0.0, -0.3], [6.0, -0.3]], [[1.0, 1.0], [2.0, 1.0]]]),
        np.array([[0.0, 1.0], [0.0, 1.0]]),
    )
    (same,) = lay_on_faces([shapely.Polygon(L_SHAPE)], [far], CELL_M)
    assert same.equals(shapely.Polygon(L_SHAPE))


def test_rooms_on_both_sides_of_a_thin_wall_do_not_overlap() -> None:
    for thickness_m in (0.04, 0.1):
        rooms = [shapely.box(0, 0, 4, 3), shapely.box(0, 3 + thickness_m, 4, 6)]
        cells = [shapely.box(-0.03, -0.02, 4.02, 3.03), shapely.box(-0.01, 3.03, 4.03, 6.04)]
        ends: FloatArray = np.concatenate([faces_of(room).ends for room in rooms])
        normal: FloatArray = np.concatenate([faces_of(room).normal for room in rooms])
        laid = lay_on_faces(cells, [Sides(ends, normal)], CELL_M)
        assert laid[0].intersection(laid[1]).area < 1e-9
        for own, true in zip(laid, rooms, strict=True):
            assert own.symmetric_difference(true).area < 1e-3


def test_no_room_is_lost_whatever_faces_there_are() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        width_m, height_m = rng.uniform(0.5, 4.0, 2)
        angle_deg = rng.uniform(0.0, 90.0)
        boxes = [shapely.box(low, 0, low + width_m, height_m) for low in (0.0, width_m + 0.1)]
        rooms = [affinity.rotate(box, angle_deg, origin=(0, 0)) for box in boxes]
        ends = np.cumsum(rng.uniform(-2.0, 3.0, (rng.integers(1, 12), 2, 2)), axis=1)
        along = ends[:, 1] - ends[:, 0]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        normal /= np.linalg.norm(along, axis=1, keepdims=True)
        laid = lay_on_faces(rooms, [Sides(ends, normal)], CELL_M)
        for own, before in zip(laid, rooms, strict=True):
            assert own.is_valid
            assert own.area > 0.4 * before.area
            assert before.buffer(0.3).covers(own)
        assert laid[0].intersection(laid[1]).area < 1e-8
