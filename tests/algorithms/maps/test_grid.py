"""The furniture-free grid of a building that is known, whichever way it is turned."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings, Walls
from ffmap.algorithms.building.ray_evidence import trace_rays
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps.grid import (
    Cell,
    Drive,
    GridMap,
    GridMapSettings,
    Immobile,
    draft_cells,
    draft_furniture_free,
    draw_free,
    standing_stretches,
)
from ffmap.algorithms.truth.maps import WALL_TOLERANCE_M, blocked_doors
from tests.drawing import draw_cells, draw_furniture_free
from tests.two_rooms import JAMBS_X, SIZE_M, TwoRooms, without

KNEE_M = BuildingSettings().knee_m
SETTINGS, THICKNESS = GridMapSettings(), WallThicknessSettings()
TURNS = [0.0, 17.0, 45.0, 101.0]


def drawn(rooms: TwoRooms, settings: GridMapSettings = SETTINGS) -> GridMap:
    return draw_furniture_free(*rooms.build(), settings, THICKNESS, KNEE_M)


def at(grid: GridMap, rooms: TwoRooms, places: FloatArray) -> FloatArray:
    index = np.floor((rooms.to_map(np.array(places, float)) - grid.origin) / grid.cell_m).astype(int)
    return grid.cells[index[:, 1], index[:, 0]]


def across_the_door(rooms: TwoRooms, beyond_m: float = 0.05) -> FloatArray:
    """Places from before the wall to behind it, in the middle of the doorway."""
    y = np.arange(SIZE_M[1] - beyond_m, SIZE_M[1] + rooms.thickness_m + beyond_m, 0.02)
    return np.column_stack([np.full(len(y), np.mean(JAMBS_X)), y])


@pytest.mark.parametrize("turn_deg", TURNS)
def test_walls_are_thin_lines_as_far_apart_as_they_are_thick(turn_deg: float) -> None:
    rooms = TwoRooms(turn_deg=turn_deg, shift=(3.1, -7.2))
    grid = drawn(rooms)
    occupied = rooms.to_rooms(grid.centres(Cell.OCCUPIED))
    middle = (occupied[:, 0] > 2.7) & (occupied[:, 0] < 3.7) & (np.abs(occupied[:, 1] - 3.1) < 0.5)
    sides = occupied[middle, 1]
    assert (np.minimum(np.abs(sides - 3.0), np.abs(sides - 3.2)) < 0.04).all()
    # One cell for each 5 cm along the longer axis, on either side.
    slant = max(abs(np.cos(np.radians(turn_deg))), abs(np.sin(np.radians(turn_deg))))
    assert np.count_nonzero(sides < 3.1) == pytest.approx(1.0 / 0.05 * slant, abs=2)
    assert np.count_nonzero(sides > 3.1) == pytest.approx(1.0 / 0.05 * slant, abs=2)
    inside = np.column_stack([np.linspace(2.8, 3.6, 9), np.full(9, 3.1)])
    assert (at(grid, rooms, inside) == Cell.UNKNOWN).all()


@pytest.mark.parametrize("turn_deg", TURNS)
@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("both_seen", [False, True])
def test_a_doorway_is_free_through_the_whole_wall(turn_deg: float, closed: bool, both_seen: bool) -> None:
    rooms = TwoRooms(turn_deg=turn_deg, closed=closed, both_seen=both_seen, thickness_m=0.25)
    grid = drawn(rooms)
    assert (at(grid, rooms, across_the_door(rooms)) == Cell.FREE).all()
    sill = rooms.doors.ends + 0.5 * rooms.thickness_m * -rooms.doors.normal[:, None]
    assert not blocked_doors(grid, sill, np.array([rooms.thickness_m])).any()
    jambs = rooms.to_rooms(grid.centres(Cell.OCCUPIED))
    for x in JAMBS_X:
        near = (np.abs(jambs[:, 0] - x) < 0.06) & (jambs[:, 1] > 3.03) & (jambs[:, 1] < 3.14)
        assert near.any()


def test_closed_leaves_and_doorways_block_where_that_is_asked() -> None:
    thick = np.array([0.2])
    for closed in (False, True):
        rooms = TwoRooms(closed=closed)
        sill = rooms.doors.ends - 0.1 * rooms.doors.normal[:, None]
        blocked = {
            doors: bool(blocked_doors(drawn(rooms, GridMapSettings(doors=doors)), sill, thick)[0])
            for doors in ("open", "as-seen", "closed")
        }
        assert blocked == {"open": False, "as-seen": closed, "closed": True}


def test_what_an_open_door_showed_is_free_though_the_door_is_to_be_drawn_closed() -> None:
    rooms = TwoRooms(both_seen=False)
    grid = drawn(rooms, GridMapSettings(doors="closed"))
    behind = np.array([[np.mean(JAMBS_X), SIZE_M[1] + rooms.thickness_m + 0.5]])
    assert (at(grid, rooms, behind) == Cell.FREE).all()
    assert Cell.OCCUPIED in at(grid, rooms, across_the_door(rooms))


def test_an_opening_that_no_door_was_made_of_is_not_walled_up() -> None:
    rooms = TwoRooms()
    immobile, drive = rooms.build(without(rooms.doors))
    grid = draw_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M)
    assert (at(grid, rooms, across_the_door(rooms)) == Cell.FREE).all()
    closed = TwoRooms(closed=True)
    immobile, drive = closed.build(without(closed.doors))
    grid = draw_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M)
    assert Cell.OCCUPIED in at(grid, closed, across_the_door(closed))


def test_a_wall_is_not_carried_on_behind_a_pillar() -> None:
    rooms = TwoRooms(pillar=True)
    grid = drawn(rooms)
    behind = np.column_stack([np.full(3, 0.01), [1.17, 1.2, 1.22]])
    assert (at(grid, rooms, behind) == Cell.UNKNOWN).all()
    assert (at(drawn(TwoRooms()), rooms, behind) == Cell.OCCUPIED).all()


def test_glass_stops_rays_and_stays_unknown() -> None:
    rooms = TwoRooms(glass=(0.0, 2.1), both_seen=False)
    behind = np.column_stack([np.linspace(1.2, 1.8, 5), np.full(5, -0.6)])
    known = draw_furniture_free(*rooms.build(windows=rooms.window), SETTINGS, THICKNESS, KNEE_M)
    assert (at(known, rooms, behind) == Cell.UNKNOWN).all()
    assert (at(known, rooms, np.column_stack([np.linspace(1.2, 1.8, 5), np.full(5, 0.01)])) == Cell.UNKNOWN).all()
    assert (at(drawn(rooms), rooms, behind) == Cell.FREE).all()


@pytest.mark.parametrize(("told_m", "expected"), [(0.55, Cell.UNKNOWN), (0.2, Cell.FREE)])
def test_no_ray_passes_a_gap_beside_a_pane_that_nobody_could(told_m: float, expected: Cell) -> None:
    rooms = TwoRooms(glass=(0.0, 2.1), both_seen=False)
    along = rooms.window.ends[0, 1] - rooms.window.ends[0, 0]
    ends = rooms.window.ends[0, 0] + np.array([[0.0], [told_m]]) * along
    grid = draw_furniture_free(
        *rooms.build(windows=replace(rooms.window, ends=ends[None])), SETTINGS, THICKNESS, KNEE_M
    )
    gap_x = np.linspace(1.0 + told_m + 0.1, 1.8, 5)
    assert expected in at(grid, rooms, np.column_stack([gap_x, np.full(5, -0.4)]))
    assert (Cell.FREE in at(grid, rooms, np.column_stack([gap_x, np.full(5, -0.4)]))) == (expected == Cell.FREE)
    # What stops rays there was not seen.
    assert Cell.OCCUPIED not in at(grid, rooms, np.column_stack([gap_x, np.full(5, 0.01)]))


def test_the_reveals_of_a_window_are_no_walls_but_its_sill_is() -> None:
    rooms = TwoRooms(glass=(0.9, 2.1), both_seen=False)
    immobile, _ = rooms.build(windows=rooms.window)
    reveal = rooms.walls.select([2])
    reveal = replace(reveal, ends=np.array([[[1.0, 0.0], [1.0, -0.3]]]), normal=np.array([[1.0, 0.0]]))
    walls = rooms.walls.append(reveal)
    cells = trace_rays(walls, [rooms.scans()], BuildingSettings())
    with_window = replace(immobile, walls=walls, cells=cells)
    last = walls.ends[-1]
    for known, expected in ((with_window, False), (replace(with_window, windows=rooms.build()[0].windows), True)):
        stretches = standing_stretches(known, SETTINGS, KNEE_M).ends
        assert any(np.allclose(np.sort(ends[:, 0]), last[:, 0], atol=0.01) for ends in stretches) == expected
        southern = [ends for ends in stretches if np.allclose(ends[:, 1], 0.0)]
        assert sum(np.linalg.norm(ends[1] - ends[0]) for ends in southern) > 3.9


def test_free_is_only_what_lies_near_to_floor_that_was_seen() -> None:
    rooms = TwoRooms(both_seen=False)
    immobile, drive = rooms.build()
    features = next(iter(drive.blocks()))
    label = features.ray_label.copy()
    label[features.ray_end_map[:, 0] > 1.5] = 0
    dark = features.__class__(**{**features.__dict__, "ray_label": label})
    near = GridMapSettings(floor_reach_m=0.5)
    grid = draw_furniture_free(immobile, Drive(drive.path_map[:1], lambda: [dark]), near, THICKNESS, KNEE_M)
    assert (at(grid, rooms, np.array([[1.0, 1.0], [1.8, 1.0]])) == Cell.FREE).all()
    # From 3.3 m away rays to the floor at 1.5 m run below the knee from 2.6 m on.
    assert (at(grid, rooms, np.array([[3.3, 1.0], [3.5, 1.0]])) == Cell.UNKNOWN).all()


def test_floor_beyond_a_sill_is_not_free_though_it_was_seen() -> None:
    rooms = TwoRooms(glass=(0.7, 2.1), both_seen=False, outside_m=9.0)
    immobile, drive = rooms.build()
    walls = rooms.walls
    walls.ends[2, 1, 0] = 1.0  # of the wall below the pane, and of the pane, nothing was made
    unknown = replace(immobile, walls=walls, cells=trace_rays(walls, [rooms.scans()], BuildingSettings()))
    settings = GridMapSettings(floor_reach_m=0.5, margin_m=8.0)
    seen = np.concatenate([block.ray_end_map[block.ray_label == Label.FLOOR] for block in drive.blocks()])
    assert np.count_nonzero(seen[:, 1] < -3.0) > 20
    free = draw_furniture_free(unknown, drive, settings, THICKNESS, KNEE_M).centres(Cell.FREE)
    assert free[:, 1].min() > -0.6
    assert np.count_nonzero(free[:, 1] > 0) * settings.cell_m**2 > 11.0
    # A pane that is known stops rays in every map.
    rival = draw_cells(np.zeros((0, 2), int), rooms.window, drive, settings, KNEE_M).centres(Cell.FREE)
    assert rival[(rival[:, 0] > 1.2) & (rival[:, 0] < 1.8), 1].min() > -0.1


def test_what_rays_leave_through_a_window_that_was_not_told_is_not_free() -> None:
    rooms = TwoRooms(glass=(0.95, 2.1), both_seen=False, outside_m=9.0)
    immobile, drive = rooms.build()
    walls = rooms.walls
    walls.ends[2, 1, 0] = 1.0
    unknown = replace(immobile, walls=walls, cells=trace_rays(walls, [rooms.scans()], BuildingSettings()))
    features = next(iter(drive.blocks()))
    sky = (features.ray_end_map[:, 1] < -0.05) & (features.ray_end_map[:, 1] > -8.5)  # outside there is no ceiling
    scan = np.repeat(np.arange(len(features.scan)), features.ray_count.astype(int))[~sky]
    open_air = replace(
        features,
        ray_count=np.bincount(scan, minlength=len(features.scan)),
        ray_end_map=features.ray_end_map[~sky],
        ray_label=features.ray_label[~sky],
    )
    drive = replace(drive, blocks=lambda: [open_air])
    grid = draw_furniture_free(unknown, drive, GridMapSettings(margin_m=8.0), THICKNESS, KNEE_M)
    free = grid.centres(Cell.FREE)
    assert free[:, 1].min() > -0.35  # the reveals are 30 cm deep
    assert (at(grid, rooms, np.column_stack([np.linspace(0.2, 3.8, 9), np.full(9, 0.1)])) == Cell.FREE).all()


def with_face(rooms: TwoRooms, ends: list[list[float]], normal: list[float], top_m: float) -> tuple[Immobile, Drive]:
    """The rooms with one more face that was taken for a wall's."""
    immobile, drive = rooms.build()
    more = rooms.walls.select([0])
    more = replace(more, ends=np.array([ends]), normal=np.array([normal]), top_m=np.array([top_m]))
    walls: Walls = rooms.walls.append(more)
    return replace(immobile, walls=walls, cells=trace_rays(walls, [rooms.scans()], BuildingSettings())), drive


def test_what_rays_pass_below_from_behind_is_no_wall() -> None:
    beam = ([[1.0, 2.2], [2.0, 2.2]], [0.0, 1.0])
    rooms = TwoRooms(both_seen=False, more=((np.array(beam[0]), (2.3, 2.6)),))
    grid = draw_furniture_free(*with_face(rooms, *beam, 2.6), SETTINGS, THICKNESS, KNEE_M)
    places = np.column_stack([np.linspace(1.1, 1.9, 9), np.full(9, 2.21)])
    assert (at(grid, rooms, places) == Cell.FREE).all()
    screen = TwoRooms(both_seen=False, more=((np.array(beam[0]), (0.0, 2.6)),))
    grid = draw_furniture_free(*with_face(screen, *beam, 2.6), SETTINGS, THICKNESS, KNEE_M)
    assert (at(grid, screen, places) == Cell.OCCUPIED).all()


def lifted(drive: Drive, floor: FloatArray) -> Drive:
    """The same drive on another floor: its height at the map's origin, its slope along x and y."""

    def on_floor(places: FloatArray) -> FloatArray:
        return np.column_stack([places[:, :2], places[:, 2] + floor[0] + places[:, :2] @ floor[1:]])

    blocks = [
        replace(
            block,
            origin_map=on_floor(block.origin_map),
            ray_end_map=on_floor(block.ray_end_map).astype(np.float32),
            floor_map=np.tile(floor, (len(block.scan), 2, 1)),
        )
        for block in drive.blocks()
    ]
    return replace(drive, blocks=lambda: blocks)


@pytest.mark.parametrize("floor", [[1.2, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.1, 0.06, -0.04]], ids=["up", "down", "slope"])
def test_heights_are_those_above_the_floor(floor: list[float]) -> None:
    """Whether rays cross a cell below the knee, and run close to the floor, does not depend on how high that lies."""
    beam = ([[1.0, 2.2], [2.0, 2.2]], [0.0, 1.0])
    rooms = TwoRooms(both_seen=False, more=((np.array(beam[0]), (2.3, 2.6)),))
    immobile, drive = with_face(rooms, *beam, 2.6)
    level = draw_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M)
    other = draw_furniture_free(immobile, lifted(drive, np.array(floor)), SETTINGS, THICKNESS, KNEE_M)
    assert level.cells.shape == other.cells.shape
    assert np.mean(level.cells != other.cells) < 1e-3
    places = np.column_stack([np.linspace(1.1, 1.9, 9), np.full(9, 2.21)])
    assert (at(other, rooms, places) == Cell.FREE).all()


def looked_along(rooms: TwoRooms, drive: Drive, origin: np.ndarray, ends: np.ndarray, count: int) -> Drive:
    """The drive and one scan more, of so many rays at the height of a shin, that end between two places."""
    features = next(iter(drive.blocks()))
    ray_end = rooms.to_map(np.linspace(ends[0], ends[1], count))
    along = replace(
        features,
        scan=np.array([99]),
        origin_map=np.array([[*rooms.to_map(origin[None])[0], 0.3]]),
        floor_map=np.zeros((1, 2, 3)),
        floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0),
        ray_count=np.array([count]),
        plane_count=np.array([0]),
        ray_end_map=np.column_stack([ray_end, np.full(count, 0.3)]).astype(np.float32),
        ray_label=np.full(count, Label.CLUTTER, np.uint8),
    )
    return replace(drive, blocks=lambda: [features, along])


def test_rays_along_a_beam_that_end_beyond_it_do_not_hold_it() -> None:
    """What hangs is passed below from both sides; that very many rays ran along under it, and did not end there, is no wall."""
    beam = ([[1.0, 2.2], [2.0, 2.2]], [0.0, 1.0])
    rooms = TwoRooms(both_seen=False, more=((np.array(beam[0]), (2.3, 2.6)),))
    immobile, drive = with_face(rooms, *beam, 2.6)
    with_it = looked_along(rooms, drive, np.array([0.6, 2.215]), np.array([[3.4, 2.215], [3.5, 2.215]]), 60_000)
    places = np.column_stack([np.linspace(1.1, 1.9, 9), np.full(9, 2.21)])
    grid = draw_furniture_free(immobile, with_it, SETTINGS, THICKNESS, KNEE_M)
    assert (at(grid, rooms, places) == Cell.FREE).all()


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_rays_along_a_wall_do_not_cross_it(turn_deg: float) -> None:
    """Below the knee a shelf on legs hides its wall, and one scan looked along behind it."""
    shelf = (np.array([[0.3, 2.7], [1.3, 2.7]]), (0.0, 1.0))
    rooms = TwoRooms(both_seen=False, more=(shelf,), turn_deg=turn_deg, shift=(0.0, -0.02))
    immobile, drive = rooms.build()
    with_it = looked_along(rooms, drive, np.array([0.1, 2.985]), np.array([[0.5, 2.985], [1.3, 2.985]]), 80)
    wall = np.column_stack([np.linspace(0.3, 1.2, 40), np.full(40, 3.0)])
    expected = at(draw_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M), rooms, wall)
    assert (expected == Cell.OCCUPIED).mean() > 0.8  # of a slanted line some places lie in a cell beside it
    grid = draw_furniture_free(immobile, with_it, SETTINGS, THICKNESS, KNEE_M)
    np.testing.assert_array_equal(at(grid, rooms, wall), expected)


def test_the_leaf_of_an_open_door_is_no_wall_but_its_reveal_is() -> None:
    y = SIZE_M[1] + 0.2
    face = ([[JAMBS_X[0], y - 0.2], [JAMBS_X[0], y + 0.7]], [1.0, 0.0])
    rooms = TwoRooms(leaf_deg=90.0)
    immobile, _ = with_face(rooms, *face, 2.05)
    stretches = standing_stretches(immobile, SETTINGS, KNEE_M).ends
    along = [ends for ends in stretches if np.allclose(ends[:, 0], JAMBS_X[0])]
    assert along
    assert max(float(ends[:, 1].max()) for ends in along) < y + 0.2
    # A wall there reaches the ceiling.
    partition, _ = with_face(rooms, *face, 2.6)
    along = [
        ends for ends in standing_stretches(partition, SETTINGS, KNEE_M).ends if np.allclose(ends[:, 0], JAMBS_X[0])
    ]
    assert max(float(ends[:, 1].max()) for ends in along) > y + 0.6
    # So does one that only all scans together showed, though its upper part was not seen.
    proven = replace(immobile, walls=replace(immobile.walls, scan_count=np.append(immobile.walls.scan_count[:-1], 0)))
    along = [ends for ends in standing_stretches(proven, SETTINGS, KNEE_M).ends if np.allclose(ends[:, 0], JAMBS_X[0])]
    assert max(float(ends[:, 1].max()) for ends in along) > y + 0.6


def test_the_whole_is_right_to_ten_centimetres() -> None:
    rooms = TwoRooms(turn_deg=33.0)
    grid = drawn(rooms)
    occupied = rooms.to_rooms(grid.centres(Cell.OCCUPIED))
    segments = [ends for ends, (low, _) in rooms.panels if low == 0.0]
    distance = np.full(len(occupied), np.inf)
    for a, b in segments:
        t = np.clip((occupied - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(occupied - a - t[:, None] * (b - a), axis=1))
    assert (distance < WALL_TOLERANCE_M).mean() > 0.99
    assert distance.mean() < 0.02


def test_nothing_gives_an_unknown_map() -> None:
    rooms = TwoRooms()
    immobile, _ = rooms.build(without(rooms.doors))
    nothing = Immobile(
        immobile.walls.select(np.zeros(0, int)),
        immobile.cells.__class__(np.zeros(1, np.int64), 50, np.zeros((0, 50, 4), np.float32)),
        immobile.votes,
        immobile.doors,
        immobile.windows,
    )
    grid = draw_furniture_free(nothing, Drive(np.zeros((0, 3)), list), SETTINGS, THICKNESS, KNEE_M)
    assert (grid.cells == Cell.UNKNOWN).all()
    empty = draw_cells(np.zeros((0, 2), int), NO_WINDOWS, Drive(np.zeros((0, 3)), list), SETTINGS, KNEE_M)
    assert (empty.cells == Cell.UNKNOWN).all()


def test_faces_that_are_not_shown_need_no_space() -> None:
    rooms = TwoRooms()
    grid = draw_furniture_free(
        *with_face(rooms, [[1.0, 30.0], [2.0, 30.0]], [0.0, -1.0], 2.6), SETTINGS, THICKNESS, KNEE_M
    )
    plain = drawn(rooms)
    np.testing.assert_allclose(grid.origin, plain.origin)
    rows, columns = plain.cells.shape
    np.testing.assert_array_equal(grid.cells[:rows, :columns], plain.cells)
    known = np.argwhere(grid.cells != Cell.UNKNOWN)
    margin = round(SETTINGS.margin_m / SETTINGS.cell_m)
    np.testing.assert_array_equal(known.min(axis=0), margin)
    np.testing.assert_allclose(np.array(grid.cells.shape) - 1 - known.max(axis=0), margin, atol=1)


def test_given_cells_are_occupied_and_the_rest_is_freed_by_the_same_rays() -> None:
    rooms = TwoRooms(both_seen=False)
    _, drive = rooms.build()
    grid = draw_cells(np.array([[20, 20], [70, 10], [-10, 70]]), NO_WINDOWS, drive, SETTINGS, KNEE_M)
    occupied = grid.centres(Cell.OCCUPIED)
    np.testing.assert_allclose(np.sort(occupied, axis=0), [[-0.475, 0.525], [1.025, 1.025], [3.525, 3.525]], atol=1e-6)
    assert (at(grid, rooms, np.array([[2.0, 0.7], [0.5, 2.5]])) == Cell.FREE).all()
    # What the cell hides from the rays stays unknown only where none comes another way; beyond the walls all is.
    assert (at(grid, rooms, np.array([[-0.2, 1.0]])) == Cell.UNKNOWN).all()


@pytest.mark.parametrize("shift", [(0, 0), (3, 1), (-2, 2), (-30, 0), (0, 40)])
def test_a_map_is_cropped_to_the_area_of_another(shift: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    kinds = np.array([Cell.OCCUPIED, Cell.UNKNOWN, Cell.FREE], np.uint8)
    frame = GridMap(rng.choice(kinds, (7, 9)), np.array([1.35, -2.1]), 0.05)
    own = GridMap(rng.choice(kinds, (8, 6)), frame.origin + 0.05 * np.array(shift), 0.05)
    cropped = own.cropped_to(frame)
    assert cropped.cells.shape == frame.cells.shape
    np.testing.assert_array_equal(cropped.origin, frame.origin)
    high = frame.origin + 0.05 * np.array([9, 7])
    for kind in (Cell.OCCUPIED, Cell.FREE):
        places = own.centres(kind)
        inside = ((places > frame.origin) & (places < high)).all(axis=1)
        np.testing.assert_allclose(cropped.centres(kind), places[inside])


@pytest.mark.parametrize("workers", [1, 2])
def test_maps_that_are_drawn_together_are_as_if_each_were_alone(workers: int) -> None:
    rooms = TwoRooms(glass=(0.9, 2.1), both_seen=False, turn_deg=17.0)
    immobile, drive = rooms.build(windows=rooms.window)
    # Of very different extents, so that each leaves the others' canvas, or does not reach it.
    few, far = np.array([[10, 10], [11, 10]]), np.array([[-200, 40], [300, 300], [40, 20], [41, 20], [42, 20]])
    drafts = [
        draft_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M),
        draft_cells(few, NO_WINDOWS, drive, SETTINGS),
        draft_cells(far, rooms.window, drive, SETTINGS),
        draft_furniture_free(immobile, drive, SETTINGS, THICKNESS, KNEE_M),
    ]
    together = draw_free(drafts, drive, SETTINGS, KNEE_M, workers)
    for draft, grid in zip(drafts, together, strict=True):
        (alone,) = draw_free([draft], drive, SETTINGS, KNEE_M)
        np.testing.assert_array_equal(grid.cells, alone.cells)
        np.testing.assert_allclose(grid.origin, alone.origin)
    assert (together[0].cells == Cell.FREE).sum() > 1000
    assert (together[1].cells != together[0].cells[: together[1].cells.shape[0], : together[1].cells.shape[1]]).any()
