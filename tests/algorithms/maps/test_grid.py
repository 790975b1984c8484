"""The furniture-free grid of a known building, at any angle."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.model import NO_WINDOWS, BuildingSettings, Walls, Windows
from ffmap.algorithms.building.parse import Kind, Stretch
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.maps import free_space
from ffmap.algorithms.maps.free_space import draw_free
from ffmap.algorithms.maps.furniture_free import (
    Immobile,
    draft_cells,
    standing_stretches,
)
from ffmap.algorithms.maps.grid import Cell, GridMap, GridMapSettings
from ffmap.algorithms.truth.maps import blocked_doors
from tests.drawing import draw_cells, draw_furniture_free
from tests.faces import parsed
from tests.two_rooms import CEILING_M, JAMBS_X, SIZE_M, TwoRooms, without

KNEE_M = BuildingSettings().knee_m
SETTINGS, THICKNESS = GridMapSettings(), WallThicknessSettings()
TURNS = [0.0, 17.0, 45.0, 101.0]


def draw(immobile: Immobile, drive: Drive, settings: GridMapSettings = SETTINGS) -> GridMap:
    return draw_furniture_free(immobile, drive, settings, THICKNESS, KNEE_M)


def at(grid: GridMap, rooms: TwoRooms, places: FloatArray) -> FloatArray:
    index, _ = grid.index(rooms.to_map(np.array(places, float)))
    return grid.cells[index[:, 1], index[:, 0]]


def row(x_low: float, x_high: float, y: float) -> FloatArray:
    return np.column_stack([np.linspace(x_low, x_high, 9), np.full(9, y)])


def across_the_door(rooms: TwoRooms, beyond_m: float = 0.05) -> FloatArray:
    """Places from before the wall to behind it, in the middle of the doorway."""
    y = np.arange(SIZE_M[1] - beyond_m, SIZE_M[1] + rooms.thickness_m + beyond_m, 0.02)
    return np.column_stack([np.full(len(y), np.mean(JAMBS_X)), y])


def with_walls(
    rooms: TwoRooms, walls: Walls, windows: Windows | None = None
) -> tuple[Immobile, Drive]:
    """The rooms, of which other faces were detected."""
    immobile, drive = rooms.build(windows=windows)
    stretches = parsed(walls, rooms.scans(), ceiling_m=CEILING_M).stretches
    return replace(immobile, walls=walls, parsed=stretches), drive


def with_face(
    rooms: TwoRooms, ends: list[list[float]], normal: list[float], top_m: float = 2.6
) -> tuple[Immobile, Drive]:
    """The rooms with one more face that was taken for a wall's."""
    face = {"ends": np.array([ends]), "normal": np.array([normal]), "top_m": np.array([top_m])}
    return with_walls(rooms, rooms.walls.append(replace(rooms.walls.select([0]), **face)))


@pytest.mark.parametrize("turn_deg", TURNS)
def test_walls_are_thin_lines_as_far_apart_as_they_are_thick(turn_deg: float) -> None:
    rooms = TwoRooms(turn_deg=turn_deg, shift=(3.1, -7.2))
    grid = draw(*rooms.build())
    occupied = rooms.to_rooms(grid.centres(Cell.OCCUPIED))
    middle = (occupied[:, 0] > 2.7) & (occupied[:, 0] < 3.7) & (np.abs(occupied[:, 1] - 3.1) < 0.5)
    sides = occupied[middle, 1]
    assert (np.minimum(np.abs(sides - 3.0), np.abs(sides - 3.2)) < 0.04).all()
    # One cell for each 5 cm along the longer axis, on either side.
    slant = max(abs(np.cos(np.radians(turn_deg))), abs(np.sin(np.radians(turn_deg))))
    for side in (sides < 3.1, sides > 3.1):
        assert np.count_nonzero(side) == pytest.approx(1.0 / 0.05 * slant, abs=2)
    assert (at(grid, rooms, row(2.8, 3.6, 3.1)) == Cell.UNKNOWN).all()


@pytest.mark.parametrize("turn_deg", TURNS)
@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("both_seen", [False, True])
def test_a_doorway_is_free_through_the_whole_wall(
    turn_deg: float, closed: bool, both_seen: bool
) -> None:
    rooms = TwoRooms(turn_deg=turn_deg, closed=closed, both_seen=both_seen, thickness_m=0.25)
    grid = draw(*rooms.build())
    assert (at(grid, rooms, across_the_door(rooms)) == Cell.FREE).all()
    sill = rooms.doors.ends + 0.5 * rooms.thickness_m * -rooms.doors.normal[:, None]
    assert not blocked_doors(grid, sill, np.array([rooms.thickness_m])).any()
    jambs = rooms.to_rooms(grid.centres(Cell.OCCUPIED))
    for x in JAMBS_X:
        near = (np.abs(jambs[:, 0] - x) < 0.06) & (jambs[:, 1] > 3.03) & (jambs[:, 1] < 3.14)
        assert near.any()


def test_closed_leaves_and_doorways_block_where_that_is_asked() -> None:
    for closed in (False, True):
        rooms = TwoRooms(closed=closed)
        sill = rooms.doors.ends - 0.1 * rooms.doors.normal[:, None]
        for doors, is_blocked in (("open", False), ("as-seen", closed), ("closed", True)):
            grid = draw(*rooms.build(), GridMapSettings(doors=doors))
            assert blocked_doors(grid, sill, np.array([0.2]))[0] == is_blocked
    # The room that an open door showed is free, even if the door is drawn closed.
    rooms = TwoRooms(both_seen=False)
    grid = draw(*rooms.build(), GridMapSettings(doors="closed"))
    behind = np.array([[np.mean(JAMBS_X), SIZE_M[1] + rooms.thickness_m + 0.5]])
    assert (at(grid, rooms, behind) == Cell.FREE).all()
    assert Cell.OCCUPIED in at(grid, rooms, across_the_door(rooms))


@pytest.mark.parametrize("doors", ["open", "as-seen", "closed"])
def test_a_passage_is_free_through_the_whole_wall_whatever_is_asked_of_doors(doors: str) -> None:
    rooms = TwoRooms()
    immobile, drive = rooms.build(without(rooms.doors))
    grid = draw(replace(immobile, passages=rooms.doors), drive, GridMapSettings(doors=doors))
    assert (at(grid, rooms, across_the_door(rooms)) == Cell.FREE).all()


def test_an_opening_without_a_detected_door_is_not_walled_up() -> None:
    rooms = TwoRooms()
    grid = draw(*rooms.build(without(rooms.doors)))
    assert (at(grid, rooms, across_the_door(rooms)) == Cell.FREE).all()
    closed = TwoRooms(closed=True)
    grid = draw(*closed.build(without(closed.doors)))
    assert Cell.OCCUPIED in at(grid, closed, across_the_door(closed))


def test_only_what_closes_an_opening_at_the_face_is_drawn_where_no_door_was_found() -> None:
    rooms = TwoRooms(both_seen=False)
    immobile, _ = rooms.build(without(rooms.doors))
    columns = {"first": 30, "after": 48, "sill": 2, "head": 41, "blind": 41}
    for kind, stands in (
        (Kind.WALL, True),
        (Kind.WINDOW, True),
        (Kind.HIDDEN, True),
        (Kind.LEAF_RECESSED, True),
        (Kind.LEAF_DEEP, False),
        (Kind.LEAF_FAR, False),
        (Kind.DOORWAY, False),
        (Kind.PANE, False),
        (Kind.PASSAGE, False),
    ):
        own = Stretch(kind, **columns, odds=9.0, second=Kind.GAP)
        parsed_so = replace(immobile, walls=immobile.walls.select([3]), parsed=[[own]])
        found = lengths_m(standing_stretches(parsed_so).ends)
        np.testing.assert_allclose(found, [4.0] if stands else [1.5, 1.6], atol=1e-6)


def test_a_wall_is_not_continued_behind_a_pillar() -> None:
    rooms = TwoRooms(pillar=True)
    behind = np.column_stack([np.full(3, 0.01), [1.17, 1.2, 1.22]])
    assert (at(draw(*rooms.build()), rooms, behind) == Cell.UNKNOWN).all()
    assert (at(draw(*TwoRooms().build()), rooms, behind) == Cell.OCCUPIED).all()


def test_glass_stops_rays_and_stays_unknown() -> None:
    rooms = TwoRooms(glass=(0.0, 2.1), both_seen=False)
    known = draw(*rooms.build(windows=rooms.window))
    assert (at(known, rooms, row(1.2, 1.8, -0.6)) == Cell.UNKNOWN).all()
    assert (at(known, rooms, row(1.2, 1.8, 0.01)) == Cell.UNKNOWN).all()
    assert (at(draw(*rooms.build()), rooms, row(1.2, 1.8, -0.6)) == Cell.FREE).all()


@pytest.mark.parametrize(("pane_m", "blocked"), [(0.55, True), (0.2, False)])
def test_no_ray_passes_a_narrow_gap_beside_a_pane(pane_m: float, blocked: bool) -> None:
    rooms = TwoRooms(glass=(0.0, 2.1), both_seen=False)
    along = rooms.window.ends[0, 1] - rooms.window.ends[0, 0]
    ends = rooms.window.ends[0, 0] + np.array([[0.0], [pane_m]]) * along
    grid = draw(*rooms.build(windows=replace(rooms.window, ends=ends[None])))
    behind = at(grid, rooms, row(1.0 + pane_m + 0.1, 1.8, -0.4))
    assert (Cell.FREE in behind) != blocked
    # What stops rays there was not seen.
    assert Cell.OCCUPIED not in at(grid, rooms, row(1.0 + pane_m + 0.1, 1.8, 0.01))


def test_the_reveals_of_a_window_are_no_walls_but_its_sill_is() -> None:
    rooms = TwoRooms(glass=(0.9, 2.1), both_seen=False)
    reveal = {"ends": np.array([[[1.0, 0.0], [1.0, -0.3]]]), "normal": np.array([[1.0, 0.0]])}
    walls = rooms.walls.append(replace(rooms.walls.select([2]), **reveal))
    for windows, is_wall in ((rooms.window, False), (None, True)):
        immobile, _ = with_walls(rooms, walls, windows)
        found = standing_stretches(immobile).ends
        last = walls.ends[-1, :, 0]
        assert any(np.allclose(np.sort(e[:, 0]), last, atol=0.01) for e in found) == is_wall
        southern = [ends for ends in found if np.allclose(ends[:, 1], 0.0)]
        assert sum(np.linalg.norm(ends[1] - ends[0]) for ends in southern) > 3.9


def test_free_is_only_space_near_to_visible_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    rooms = TwoRooms(both_seen=False)
    immobile, drive = rooms.build()
    features = next(iter(drive.blocks()))
    label = np.where(features.ray_end_map[:, 0] > 1.5, Label.CLUTTER, features.ray_label)
    dark = replace(features, ray_label=label.astype(np.uint8))
    monkeypatch.setattr(free_space, "FLOOR_REACH_M", 0.5)
    grid = draw(immobile, Drive(drive.path_map[:1], lambda: [dark]))
    assert (at(grid, rooms, np.array([[1.0, 1.0], [1.8, 1.0]])) == Cell.FREE).all()
    # From 3.3 m away rays to the floor at 1.5 m run below the knee from 2.6 m on.
    assert (at(grid, rooms, np.array([[3.3, 1.0], [3.5, 1.0]])) == Cell.UNKNOWN).all()


def short_wall(rooms: TwoRooms) -> tuple[Immobile, Drive]:
    """Neither the wall below the pane nor the pane were detected."""
    walls = rooms.walls
    walls.ends[2, 1, 0] = 1.0
    return with_walls(rooms, walls)


def test_floor_beyond_a_sill_is_not_free_although_it_was_seen(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rooms = TwoRooms(glass=(0.7, 2.1), both_seen=False, outside_m=9.0)
    immobile, drive = short_wall(rooms)
    monkeypatch.setattr(free_space, "FLOOR_REACH_M", 0.5)
    blocks = list(drive.blocks())
    seen = np.concatenate([block.ray_end_map[block.ray_label == Label.FLOOR] for block in blocks])
    assert np.count_nonzero(seen[:, 1] < -3.0) > 20
    free = draw(immobile, drive).centres(Cell.FREE)
    assert free[:, 1].min() > -0.6
    assert np.count_nonzero(free[:, 1] > 0) * SETTINGS.cell_m**2 > 11.0
    # A known pane stops rays in every map.
    none = np.zeros((0, 2), int)
    free = draw_cells(none, rooms.window, drive, SETTINGS, KNEE_M).centres(Cell.FREE)
    assert free[(free[:, 0] > 1.2) & (free[:, 0] < 1.8), 1].min() > -0.1


def test_space_that_rays_cross_beyond_an_undetected_window_is_not_free() -> None:
    rooms = TwoRooms(glass=(0.95, 2.1), both_seen=False, outside_m=9.0)
    immobile, drive = short_wall(rooms)
    features = next(iter(drive.blocks()))
    # Outside there is no ceiling.
    sky = (features.ray_end_map[:, 1] < -0.05) & (features.ray_end_map[:, 1] > -8.5)
    open_air = replace(
        features,
        ray_count=np.bincount(features.ray_scan[~sky], minlength=len(features.scan)),
        ray_end_map=features.ray_end_map[~sky],
        ray_label=features.ray_label[~sky],
    )
    grid = draw(immobile, replace(drive, blocks=lambda: [open_air]))
    assert grid.centres(Cell.FREE)[:, 1].min() > -0.35  # the reveals are 30 cm deep
    assert (at(grid, rooms, row(0.2, 3.8, 0.1)) == Cell.FREE).all()


def lifted(drive: Drive, floor: FloatArray) -> Drive:
    """The same drive on another floor: its height at the map's origin, its slope along x and y."""

    def on_floor(places: FloatArray) -> FloatArray:
        height = places[:, 2] + floor[0] + places[:, :2] @ floor[1:]
        return np.column_stack([places[:, :2], height])

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


@pytest.mark.parametrize(
    "floor", [[1.2, 0.0, 0.0], [-0.3, 0.0, 0.0], [0.1, 0.06, -0.04]], ids=["up", "down", "slope"]
)
def test_heights_are_measured_from_the_floor(floor: list[float]) -> None:
    immobile, drive = TwoRooms(both_seen=False).build()
    level = draw(immobile, drive)
    other = draw(immobile, lifted(drive, np.array(floor)))
    assert level.cells.shape == other.cells.shape
    assert np.mean(level.cells != other.cells) < 1e-3


def test_the_leaf_of_an_open_door_is_no_wall_but_its_reveal_is() -> None:
    y = SIZE_M[1] + 0.2
    face = ([[JAMBS_X[0], y - 0.2], [JAMBS_X[0], y + 0.7]], [1.0, 0.0])
    rooms = TwoRooms(leaf_deg=90.0)

    def reach(immobile: Immobile) -> float:
        found = standing_stretches(immobile).ends
        along = [ends for ends in found if np.allclose(ends[:, 0], JAMBS_X[0])]
        return max(float(ends[:, 1].max()) for ends in along)

    immobile, _ = with_face(rooms, *face, top_m=2.05)
    assert reach(immobile) < y + 0.2
    # A wall there reaches the ceiling.
    assert reach(with_face(rooms, *face)[0]) > y + 0.6


def test_nothing_gives_an_unknown_map() -> None:
    rooms = TwoRooms()
    immobile, _ = rooms.build(without(rooms.doors))
    walls = immobile.walls.select(np.zeros(0, int))
    nowhere = Drive(np.zeros((0, 3)), list)
    assert (draw(replace(immobile, walls=walls, parsed=()), nowhere).cells == Cell.UNKNOWN).all()
    empty = draw_cells(np.zeros((0, 2), int), NO_WINDOWS, nowhere, SETTINGS, KNEE_M)
    assert (empty.cells == Cell.UNKNOWN).all()


def test_maps_that_are_drawn_together_are_as_if_each_were_alone() -> None:
    rooms = TwoRooms(glass=(0.9, 2.1), both_seen=False, turn_deg=17.0)
    _, drive = rooms.build(windows=rooms.window)
    frame = GridMap.around([rooms.walls.ends, drive.path_map[:, :2]], SETTINGS.cell_m)
    few, more = rooms.to_map(row(0.5, 0.6, 0.5)), rooms.to_map(row(2.0, 3.0, 2.0))
    drafts = [
        draft_cells(places, frame, windows)
        for places, windows in ((few, NO_WINDOWS), (more, rooms.window), (few, NO_WINDOWS))
    ]
    together = draw_free(drafts, frame, drive, KNEE_M)
    for draft, grid in zip(drafts, together, strict=True):
        alone, _ = draw_free([draft, drafts[0]], frame, drive, KNEE_M)
        one, other = grid.cells_within(frame), alone.cells_within(frame)
        both = (one != Cell.UNKNOWN) & (other != Cell.UNKNOWN)
        assert np.count_nonzero(both) > 1000
        np.testing.assert_array_equal(one[both], other[both])
    assert (together[0].cells == Cell.FREE).sum() > 1000
    assert (together[1].cells != together[0].cells).any()
