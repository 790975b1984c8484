"""Wall thickness and the floor plan of a building that is known."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
import shapely

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import main_direction_deg
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import BuildingSettings, Doors
from ffmap.algorithms.building.thickness import (
    WallThicknessSettings,
    door_depths,
    face_thickness,
    part_walls,
    usual_thickness,
)
from ffmap.algorithms.maps.floor_plan import FloorPlan, draw_floor_plan
from ffmap.algorithms.maps.furniture_free import standing_stretches
from ffmap.algorithms.maps.grid import GridMapSettings
from ffmap.algorithms.scan.doors import DoorState
from tests.drawing import draw_furniture_free
from tests.two_rooms import JAMBS_X, SIZE_M, TwoRooms

KNEE_M = BuildingSettings().knee_m
THICKNESS = WallThicknessSettings()
UNKNOWN_M = 0.3


def plan_of(rooms: TwoRooms) -> FloorPlan:
    immobile, drive = rooms.build()
    grid = draw_furniture_free(immobile, drive, GridMapSettings(), THICKNESS, KNEE_M)
    stretches = standing_stretches(immobile)
    return draw_floor_plan(stretches, immobile, grid, THICKNESS)


@pytest.mark.parametrize("turn_deg", [0.0, 25.0, 160.0])
def test_thickness_is_measured_where_both_sides_were_seen(turn_deg: float) -> None:
    rooms = TwoRooms(thickness_m=0.17, turn_deg=turn_deg)
    parts = part_walls(rooms.walls, THICKNESS)
    thickness_m = face_thickness(rooms.walls, parts)
    np.testing.assert_allclose(thickness_m[[3, 6]], 0.17, atol=1e-6)
    assert np.isnan(np.delete(thickness_m, [3, 6])).all()
    assert usual_thickness(parts, THICKNESS.unseen_m) == pytest.approx(0.17)
    closed = hidden(TwoRooms(thickness_m=0.17, turn_deg=turn_deg, closed=True).doors)
    np.testing.assert_allclose(depths(closed, rooms), 0.17, atol=1e-6)


def hidden(doors: Doors) -> Doors:
    """Doors whose lintels tell nothing."""
    return replace(doors, reveal_m=np.full(len(doors), np.nan))


def together(*doors: Doors) -> Doors:
    return reduce(Doors.append, doors)


def depths(doors: Doors, rooms: TwoRooms, through_m: float = np.nan) -> FloatArray:
    through = np.full(len(doors), through_m)
    return door_depths(
        doors, rooms.walls, part_walls(rooms.walls, THICKNESS), THICKNESS, UNKNOWN_M, through
    )


def test_lintels_tell_how_deep_doorways_are() -> None:
    # The wall's faces were seen minutes apart, with drift between them; a lintel's edges were not.
    rooms = TwoRooms(thickness_m=0.17)
    lintel = replace(rooms.doors, reveal_m=np.array([0.24]))
    np.testing.assert_allclose(depths(lintel, rooms), 0.24)
    both = together(lintel, hidden(TwoRooms(closed=True).doors))
    np.testing.assert_allclose(depths(both, rooms), 0.24)
    # In another face of which one side was seen too; the face's own other side comes before.
    for wall, depth_m in ((0, 0.24), (6, 0.17)):
        elsewhere = replace(both, wall=np.array([3, wall]))
        assert depths(elsewhere, rooms)[1] == pytest.approx(depth_m)


def test_a_duct_behind_a_lintel_makes_no_doorway_deeper_than_its_wall() -> None:
    rooms = TwoRooms()
    duct = replace(rooms.doors, reveal_m=np.full(len(rooms.doors), 0.6))
    assert depths(duct, rooms).max() < 0.31


@pytest.mark.parametrize(
    ("through_m", "depth_m"), [(0.8, 0.8), (0.45, 0.4), (0.3, 0.4), (np.nan, 0.4)]
)
def test_a_frame_in_a_thick_wall_does_not_end_its_doorway(through_m: float, depth_m: float) -> None:
    """The lintel's underside ends at the frame; else it is free of the poses' drift."""
    rooms = TwoRooms(both_seen=False)
    to_frame = replace(rooms.doors, reveal_m=np.array([0.4]))
    np.testing.assert_allclose(depths(to_frame, rooms, through_m), depth_m)


def test_a_face_is_cut_where_the_other_side_ends() -> None:
    rooms = TwoRooms()
    walls = rooms.walls.select([3, 6])
    walls.ends[1, 1, 0] = 2.5
    parts = part_walls(walls, THICKNESS)
    own = parts.wall == 0
    lengths = np.linalg.norm(parts.ends[own, 1] - parts.ends[own, 0], axis=1)
    np.testing.assert_allclose(lengths, [2.5, 1.5])
    np.testing.assert_array_equal(np.isnan(parts.thickness_m[own]), [False, True])


@pytest.mark.parametrize("turn_deg", [0.0, 37.0])
def test_walls_are_areas_with_the_doorway_cut_out(turn_deg: float) -> None:
    rooms = TwoRooms(turn_deg=turn_deg)
    plan = plan_of(rooms)
    (x, y), t, (left, right) = SIZE_M, rooms.thickness_m, JAMBS_X

    def area(low_x: float, low_y: float, high_x: float, high_y: float) -> shapely.Polygon:
        corners = shapely.get_coordinates(shapely.box(low_x, low_y, high_x, high_y))
        return shapely.Polygon(rooms.to_map(corners))

    measured, drawn = shapely.union_all(plan.walls), shapely.union_all(plan.walls + plan.assumed)
    for part in (area(0.0, y, left, y + t), area(right, y, x, y + t)):
        assert part.difference(measured).area < 0.03 * part.area
    doorway = area(left, y, right, y + t)
    assert drawn.intersection(doorway.buffer(-0.01)).area < 1e-6
    assert plan.doors[0].outline.symmetric_difference(doorway).area < 0.01
    # The outer walls were seen from within: the usual thickness is drawn behind them only.
    assert drawn.intersection(area(0.0, 0.0, x, y).buffer(-0.02)).area < 1e-6
    corner = shapely.Point(rooms.to_map(np.array([[-0.1, -0.1]]))[0])
    assert shapely.union_all(plan.assumed).contains(corner)


def test_the_main_direction_is_that_of_most_walls_not_the_mean() -> None:
    rng = np.random.default_rng(1)

    def lines(count: int, length_m: float, angle_deg: float) -> np.ndarray:
        starts = rng.uniform(-20, 20, (count, 2))
        spread_deg = rng.normal(angle_deg + 90 * rng.integers(0, 4, count), 0.2)
        along = np.stack([np.cos(np.radians(spread_deg)), np.sin(np.radians(spread_deg))], axis=1)
        return np.stack([starts, starts + length_m * along], axis=1)

    wing, main = lines(30, 2.0, 71.0), lines(12, 8.0, 46.0)
    assert main_direction_deg(np.concatenate([wing, main])) == pytest.approx(-44.0, abs=0.2)
    assert main_direction_deg(lines(20, 3.0, 89.99)) == pytest.approx(0.0, abs=0.2)
    assert main_direction_deg(np.zeros((0, 2, 2))) == 0.0
    assert main_direction_deg(np.zeros((3, 2, 2))) == 0.0


@pytest.mark.parametrize("seen", [4, 2])
@pytest.mark.parametrize("turn_deg", [0.0, 25.0])
def test_a_free_standing_column_is_its_own_outline(seen: int, turn_deg: float) -> None:
    """Also where two of its sides were seen alone."""
    corners = np.array([[2.6, 1.4], [3.0, 1.4], [3.0, 1.8], [2.6, 1.8], [2.6, 1.4]])
    sides = [(corners[i : i + 2], (0.0, 2.6)) for i in range(4)]
    normals = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]], float)

    class WithColumn(TwoRooms):
        @property
        def faces(self):
            own = [(corners[i : i + 2], normals[i]) for i in range(seen)]
            return [*super().faces, *own]

    rooms = WithColumn(both_seen=False, more=tuple(sides), turn_deg=turn_deg)
    plan = plan_of(rooms)
    assert len(plan.columns) == 1
    true = shapely.Polygon(rooms.to_map(corners))
    assert plan.columns[0].symmetric_difference(true).area < 0.01
    assert shapely.union_all([*plan.walls, *plan.assumed]).intersection(plan.columns[0]).area < 1e-6


def test_an_empty_building_has_an_empty_plan() -> None:
    rooms = TwoRooms(both_seen=False)
    immobile, drive = rooms.build()
    grid = draw_furniture_free(
        immobile, Drive(drive.path_map, list), GridMapSettings(), THICKNESS, KNEE_M
    )
    nothing = immobile.walls.select(np.zeros(0, int))
    plan = draw_floor_plan(nothing, immobile, grid, THICKNESS)
    assert (plan.walls, plan.assumed, plan.columns) == ((), (), ())


def test_a_closed_leaf_is_drawn_behind_its_sill() -> None:
    (door,) = plan_of(TwoRooms(closed=True)).doors
    assert door.state == DoorState.CLOSED
    np.testing.assert_allclose(door.closed[:, 1], SIZE_M[1] + 0.04)
