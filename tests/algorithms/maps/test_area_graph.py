"""Rooms of plans that are known: turned, furnished, noisy, seen in part, and degenerate."""

from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from scipy import ndimage
from shapely import affinity

from ffmap.algorithms.maps.area_graph import AreaGraph, AreaGraphSettings, find_rooms
from ffmap.algorithms.maps.grid import Cell, GridMap, coarsened
from ffmap.algorithms.truth.rooms import compare_rooms

CELL_M = 0.05
SETTINGS = AreaGraphSettings()
DOOR_M = 0.9
WALL_M = 0.2


@dataclass(frozen=True)
class Plan:
    """Rooms and doorways; the corridor is the first room, and has a doorway to each other room."""

    rooms: tuple[shapely.Polygon, ...]
    doorways: tuple[shapely.Polygon, ...]

    def turned(self, angle_deg: float) -> "Plan":
        def turn(parts: tuple[shapely.Polygon, ...]) -> tuple[shapely.Polygon, ...]:
            return tuple(affinity.rotate(part, angle_deg, origin=(0, 0)) for part in parts)

        return Plan(turn(self.rooms), turn(self.doorways))

    @property
    def corners(self) -> np.ndarray:
        """(D, 4, 2) as `find_rooms` takes doorways: from sill to sill along x or y."""
        return np.array([shapely.get_coordinates(d)[[0, 3, 2, 1]] for d in self.doorways])


def office(door_m: float = DOOR_M, corridor_m: float = 2.0, count: int = 3) -> Plan:
    """A corridor along x with rooms of 4 × 5 m above and below, one doorway each."""
    length = 4.0 * count + WALL_M * (count - 1)
    rooms, doorways = [shapely.box(0, 0, length, corridor_m)], []
    for i in range(count):
        left = i * (4.0 + WALL_M)
        door_x = left + 1.5 - door_m / 2
        for wall, bottom in ((corridor_m, corridor_m + WALL_M), (-WALL_M, -WALL_M - 5)):
            rooms.append(shapely.box(left, bottom, left + 4, bottom + 5))
            doorways.append(shapely.box(door_x, wall, door_x + door_m, wall + WALL_M))
    return Plan(tuple(rooms), tuple(doorways))


def draw(
    plan: Plan, obstacles: tuple[shapely.Geometry, ...] = (), outside: int = Cell.OCCUPIED
) -> GridMap:
    parts = [room.buffer(1e-3) for room in plan.rooms]
    free = shapely.union_all(parts + [doorway.buffer(2e-3) for doorway in plan.doorways])
    low, high = np.reshape(free.bounds, (2, 2))
    origin = np.floor(low / CELL_M) * CELL_M - 0.5
    columns, rows = np.ceil((high + 0.5 - origin) / CELL_M).astype(int)
    x, y = np.meshgrid(*(CELL_M * (np.arange(n) + 0.5) for n in (columns, rows)))
    x, y = x + origin[0], y + origin[1]
    cells = np.full((rows, columns), Cell.OCCUPIED, np.uint8)
    shapely.prepare(free)
    cells[~shapely.contains_xy(free.buffer(0.12), x, y)] = outside
    cells[shapely.contains_xy(free, x, y)] = Cell.FREE
    cells[shapely.contains_xy(shapely.union_all(obstacles), x, y)] = Cell.OCCUPIED
    return GridMap(cells, origin, CELL_M)


def furniture(room: shapely.Polygon) -> list[shapely.Geometry]:
    """A table's legs with chairs about it, a cupboard at the wall and a chest that stands free."""
    x, y = room.bounds[:2]
    legs = [
        shapely.Point(x + 1.2 + dx, y + 1.8 + dy).buffer(0.06)
        for dx in (0.0, 1.4)
        for dy in (0.0, 0.5, 0.9, 1.4)
    ]
    return [
        *legs,
        shapely.box(x + 2.6, y + 4.4, x + 4, y + 5),
        shapely.box(x + 1.4, y + 2.1, x + 2.4, y + 2.9),
    ]


def assert_found(graph: AreaGraph, plan: Plan, least: float = 0.96) -> None:
    figures = compare_rooms(plan.rooms, [room.polygon for room in graph.rooms])
    assert len(graph) == len(plan.rooms)
    assert figures.recall.min() > least
    assert figures.precision.min() > least
    assert figures.split == ()
    assert figures.merged == ()


def corridor_of(graph: AreaGraph, plan: Plan) -> int:
    shared = [room.polygon.intersection(plan.rooms[0]).area for room in graph.rooms]
    return int(np.argmax(shared))


def assert_star(graph: AreaGraph, plan: Plan) -> None:
    """Every room leads to the corridor and nowhere else."""
    corridor = corridor_of(graph, plan)
    others = [room for room in range(len(graph)) if room != corridor]
    expected = sorted((min(corridor, room), max(corridor, room)) for room in others)
    assert sorted(passage.rooms for passage in graph.passages) == expected


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0])
def test_every_room_of_a_plan_is_found_whole_at_any_angle(angle_deg: float) -> None:
    plan = office().turned(angle_deg)
    graph = find_rooms(draw(plan), SETTINGS)
    assert_found(graph, plan)
    assert_star(graph, plan)
    for passage in graph.passages:
        width_m = np.linalg.norm(passage.line[1] - passage.line[0])
        assert width_m == pytest.approx(DOOR_M, abs=3 * CELL_M)
        middle = shapely.Point(passage.line.mean(axis=0))
        assert min(middle.distance(doorway) for doorway in plan.doorways) < 2 * CELL_M
    areas_m2 = [room.area_m2 for room in graph.rooms]
    assert np.diff(areas_m2).max() < 1e-6
    cells = np.bincount(graph.label[graph.label >= 0])
    np.testing.assert_allclose(cells * CELL_M**2, areas_m2, rtol=0.02)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
def test_furniture_parts_no_room_and_belongs_to_it(angle_deg: float) -> None:
    plan = office()
    pieces = [piece for room in plan.rooms[1:] for piece in furniture(room)]
    turned = [affinity.rotate(piece, angle_deg, origin=(0, 0)) for piece in pieces]
    graph = find_rooms(draw(plan.turned(angle_deg), tuple(turned)), SETTINGS)
    assert_found(graph, plan.turned(angle_deg), least=0.95)
    free_standing = shapely.union_all([p for p in turned if p.area < 0.82]).buffer(CELL_M)
    assert shapely.contains_xy(free_standing, graph.furniture).mean() > 0.99
    inside = shapely.union_all([room.polygon for room in graph.rooms])
    assert shapely.contains_xy(inside, graph.furniture).all()


def test_a_noisy_map_has_the_same_rooms() -> None:
    plan = office()
    grid = draw(plan)
    rng = np.random.default_rng(5)
    walls = grid.cells == Cell.OCCUPIED
    near = ndimage.binary_dilation(walls) & ~walls
    grid.cells[near & (rng.random(near.shape) < 0.3)] = Cell.OCCUPIED
    grid.cells[(grid.cells == Cell.FREE) & (rng.random(near.shape) < 0.005)] = Cell.OCCUPIED
    assert_found(find_rooms(grid, SETTINGS), plan, least=0.93)


def test_wide_openings_part_rooms_where_no_door_is_known_and_none_wider_than_known_doors() -> None:
    plan = office(door_m=2.2, corridor_m=4.0)
    assert_found(find_rooms(draw(plan), SETTINGS), plan)
    narrow = np.array([[[1.0, 4.0], [1.9, 4.0], [1.9, 4.2], [1.0, 4.2]]])
    assert len(find_rooms(draw(plan), SETTINGS, narrow)) < len(plan.rooms)


def booths(count: int = 4, mouth_m: float = 2.5) -> Plan:
    """Two rows of booths, 3.4 × 2.3 m, whose mouths are wider than the aisle between them."""
    length = count * (3.4 + WALL_M) - WALL_M
    rooms, mouths = [shapely.box(-3, 0, length + 3, 1.6)], []
    for i in range(count):
        left = i * (3.4 + WALL_M)
        for bottom, wall in ((1.6 + WALL_M, 1.6), (-WALL_M - 2.3, -WALL_M)):
            rooms.append(shapely.box(left, bottom, left + 3.4, bottom + 2.3))
            mouths.append(shapely.box(left + 0.45, wall, left + 0.45 + mouth_m, wall + WALL_M))
    return Plan(tuple(rooms), tuple(mouths))


@pytest.mark.parametrize("angle_deg", [0.0, 17.0])
def test_a_row_of_shallow_labs_is_as_many_rooms(angle_deg: float) -> None:
    plan = booths().turned(angle_deg)
    graph = find_rooms(draw(plan), SETTINGS)
    assert_found(graph, plan, least=0.92)  # half a mouth's reveal, or all, is no true room's
    assert_star(graph, plan)


def test_bays_and_corridors_that_meet_are_no_rooms() -> None:
    bays = [shapely.box(x, 6 - 1e-3, x + 2.5, 7.5) for x in (1.0, 5.0, 9.0)]
    ways = [shapely.box(0, 8, 20, 10), shapely.box(9, 0, 11, 18), shapely.box(0, 0, 2, 10)]
    for parts in ([shapely.box(0, 0, 12, 6), *bays], ways):
        plan = Plan((shapely.union_all(parts),), ())
        assert_found(find_rooms(draw(plan), SETTINGS), plan)


def test_detected_doors_part_rooms_whatever_their_width() -> None:
    plan = office(door_m=2.2)
    graph = find_rooms(draw(plan), SETTINGS, plan.corners)
    assert_found(graph, plan)
    assert_star(graph, plan)
    assert sorted(passage.door for passage in graph.passages) == list(range(len(plan.doorways)))
    corridor = corridor_of(graph, plan)
    assert graph.rooms[corridor].doors == tuple(range(len(plan.doorways)))
    for door, pair in enumerate(graph.door_rooms):
        assert corridor in pair
        for room in pair:
            assert graph.rooms[room].polygon.distance(plan.doorways[door]) < 2 * CELL_M


def test_passages_part_rooms_and_are_no_doors() -> None:
    plan = office(door_m=2.8)
    doorways, passages = plan.corners[:2], plan.corners[2:]
    graph = find_rooms(draw(plan), SETTINGS, doorways, passages=passages)
    assert_found(graph, plan)
    assert_star(graph, plan)
    assert len(graph.door_rooms) == 2
    doors = [passage.door for passage in graph.passages]
    assert doors == [0, 1] + [None] * len(passages)


def test_the_room_beyond_a_closed_door_is_unknown() -> None:
    plan = office()
    graph = find_rooms(draw(Plan(plan.rooms[:-1], plan.doorways)), SETTINGS, plan.corners)
    assert len(graph) == len(plan.rooms) - 1
    assert min(graph.door_rooms[-1]) == -1
    assert max(graph.door_rooms[-1]) >= 0


def test_what_the_robot_reaches_stays_and_what_only_windows_show_goes() -> None:
    plan = office()
    neighbour = shapely.box(0.5, 12.4, 6, 16)  # across the street
    window = np.array([[[1.0, 7.2], [2.6, 7.2]]])
    street = shapely.box(1.0, 7.15, 2.6, 12.4)
    grid = draw(Plan((*plan.rooms, neighbour, street), plan.doorways))
    path = np.column_stack([np.linspace(0.5, 11.5, 80), np.full(80, 1.0)])
    graph = find_rooms(grid, SETTINGS, plan.corners, window, path)
    assert_found(graph, plan)
    without = find_rooms(grid, SETTINGS, plan.corners, window)
    assert any(room.polygon.intersects(neighbour) for room in without.rooms)


def test_the_edge_of_what_was_seen_is_no_jamb() -> None:
    plan = Plan((shapely.box(0, 0, 10, 4),), ())
    grid = draw(plan)
    row = slice(int(0.5 / CELL_M), int(0.5 / CELL_M) + 80)
    # Furniture on both sides hid all but a metre of the room's middle.
    for start, stop in ((0.0, 1.5), (2.5, 4.0)):
        rows = slice(row.start + round(start / CELL_M), row.start + round(stop / CELL_M))
        grid.cells[rows, 100:130] = Cell.UNKNOWN
    path = np.column_stack([np.linspace(0.5, 9.5, 50), np.full(50, 2.0)])
    assert len(find_rooms(grid, SETTINGS)) == 2
    assert len(find_rooms(grid, SETTINGS, path_map=path)) == 1


def test_single_rays_that_left_through_a_gap_are_no_room() -> None:
    plan = Plan((shapely.box(0, 0, 6, 4), shapely.box(5.9, 2, 9, 2.15)), ())
    path = np.column_stack([np.linspace(0.5, 5.5, 50), np.full(50, 3.0)])
    graph = find_rooms(draw(plan, outside=Cell.UNKNOWN), SETTINGS, path_map=path)
    assert len(graph) == 1
    assert graph.rooms[0].area_m2 == pytest.approx(24, rel=0.03)


@pytest.mark.parametrize(
    ("cells", "rooms"),
    [
        (np.full((40, 50), Cell.OCCUPIED, np.uint8), 0),
        (np.full((1, 1), Cell.FREE, np.uint8), 0),
        (np.full((1, 1), Cell.UNKNOWN, np.uint8), 0),
        (np.full((1, 500), Cell.FREE, np.uint8), 1),
        (np.full((40, 50), Cell.FREE, np.uint8), 1),
    ],
)
def test_degenerate_maps(cells: np.ndarray, rooms: int) -> None:
    grid = GridMap(cells, np.zeros(2), CELL_M)
    doorway = np.array([[[0.2, 0.2], [0.2, 1.1], [0.4, 1.1], [0.4, 0.2]]])
    for graph in (
        find_rooms(grid, SETTINGS),
        find_rooms(grid, SETTINGS, doorway),
        find_rooms(grid, SETTINGS, path_map=np.zeros((0, 2))),
    ):
        assert graph.label.shape == cells.shape
        assert len(graph.passages) == 0
    assert len(find_rooms(grid, SETTINGS)) == rooms


def test_a_coarsened_map_keeps_its_walls_and_its_rooms() -> None:
    plan = office()
    grid = draw(plan)
    coarse = coarsened(grid, grid.cells.size // 7)
    assert coarse.cells.size <= grid.cells.size // 7 * 1.1
    assert coarse.cell_m > grid.cell_m
    graph = find_rooms(coarse, SETTINGS)
    figures = compare_rooms(plan.rooms, [room.polygon for room in graph.rooms])
    assert len(graph) == len(plan.rooms)
    assert figures.recall.min() > 0.8
    assert figures.merged == ()
    assert coarsened(grid, grid.cells.size).cell_m == grid.cell_m


def test_the_voronoi_graph_keeps_off_the_walls() -> None:
    plan = office()
    graph = find_rooms(draw(plan), SETTINGS)
    walls = shapely.union_all([room.boundary for room in plan.rooms])
    free = shapely.union_all([*plan.rooms, *(d.buffer(0.01) for d in plan.doorways)])
    walls = walls.difference(shapely.union_all(plan.doorways).buffer(0.02))
    middles = shapely.points(graph.skeleton.mean(axis=1))
    assert 100 < len(middles) < 0.1 * np.count_nonzero(graph.label >= 0)
    assert shapely.contains(free, middles).all()
    assert shapely.distance(middles, walls).min() > 0.2
