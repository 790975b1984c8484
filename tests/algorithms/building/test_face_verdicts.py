"""Which faces stand: ducts, leaves and high windows by hand-made rays; corners, ceilings and walls no scan could tell."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.segments import Segment
from ffmap.algorithms.building.face_columns import FaceColumnsSettings, Storey, TracedFaces, above_doors_m
from ffmap.algorithms.building.face_verdicts import (
    FaceVerdict,
    JudgedFaces,
    StandingWallsSettings,
    along_others,
    join_corners,
    judge_faces,
    leaning_on_others,
    refuse_outside,
    shows_whole,
    trim_at_doorways,
)
from ffmap.algorithms.building.missed_walls import (
    AllReturns,
    MissedWalls,
    MissedWallsSettings,
    SearchSettings,
    find_missed_walls,
)
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, NO_WALLS, BuildingSettings, Walls
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from tests.voting import vote

CEILING_M = 2.8
SETTINGS = StandingWallsSettings()
COLUMNS = FaceColumnsSettings()
SEARCH = SearchSettings(BuildingSettings(), SETTINGS, COLUMNS, MissedWallsSettings())
FILLED, SUM, SQUARES, THROUGH = range(4)


def faces(*ends: tuple[tuple[float, float], tuple[float, float]]) -> Walls:
    """Faces whose normals lie to the left of the way from their first end to their second."""
    segments = np.array(ends, np.float64)
    along = segments[:, 1] - segments[:, 0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    count = len(segments)
    return Walls(
        segments,
        np.stack([-along[:, 1], along[:, 0]], axis=1),
        np.zeros(count),
        np.full(count, CEILING_M),
        np.full(count, 9, np.int32),
        np.full(count, 0.01),
        np.full(count, 900),
    )


def cells_of(length_m: float) -> WallCells:
    """A face on which every cell up to the ceiling returns ten rays."""
    columns, rows = round(length_m / CELL_M), 66
    counts = np.zeros((columns, rows, 4), np.float32)
    counts[:, : int(CEILING_M / CELL_M), FILLED] = 10.0
    return WallCells(np.array([0, columns]), rows, counts)


def pass_rays(cells: WallCells, columns: slice, low_m: float, high_m: float) -> None:
    rows = slice(int(low_m / CELL_M), int(high_m / CELL_M))
    cells.counts[columns, rows, FILLED] = 0.0
    cells.counts[columns, rows, THROUGH] = 20.0


def judged_faces(walls: Walls, cells: WallCells, clear_m: np.ndarray, path_map: np.ndarray) -> JudgedFaces:
    return judge_faces(
        TracedFaces(walls, cells, clear_m, np.zeros(len(clear_m))), path_map, BuildingSettings(), COLUMNS, SETTINGS
    )


def judge(cells: WallCells, path_y: float = 1.0) -> tuple[list[list[float]], list[FaceVerdict]]:
    """Where along the face wall still stands, and the verdicts on the rest."""
    columns = int(cells.first[-1])
    path_map = np.column_stack([np.linspace(0, columns * CELL_M, 200), np.full(200, path_y)])
    judged = judged_faces(faces(((0, 0), (columns * CELL_M, 0))), cells, np.full(columns, CEILING_M), path_map)
    return judged.walls.ends[:, :, 0].round(2).tolist(), [FaceVerdict(v) for v in judged.verdict]


def test_a_short_duct_has_no_wall_below_it_but_a_lintel_does():
    """Seen through a doorway, no more of a duct is seen than a lintel would have."""
    duct = cells_of(1.4)
    pass_rays(duct, slice(None), 0.1, 2.05)
    assert judge(duct) == ([], [FaceVerdict.HANGS])
    lintel = cells_of(2.0)
    pass_rays(lintel, slice(6, 34), 0.1, 2.05)
    assert judge(lintel) == ([[0.0, 2.0]], [])


def test_a_cupboard_below_a_duct_is_no_wall():
    """Up to 1.8 m rays end on the one, and from 2.5 m on the other; between them they go on."""
    cupboard = cells_of(1.0)
    cupboard.counts[:, 50:, FILLED] = 100.0
    pass_rays(cupboard, slice(None), 1.8, 2.5)
    assert judge(cupboard) == ([], [FaceVerdict.ENDS_LOW])
    wall = cells_of(1.0)
    wall.counts[:, 50:, FILLED] = 100.0
    pass_rays(wall, slice(None), 2.3, 2.5)
    assert judge(wall) == ([[0.0, 1.0]], [])


def test_a_face_without_room_before_it_is_outside():
    both = faces(((0, 0), (4, 0)), ((0, 9), (4, 9)))
    judged = JudgedFaces(both, NO_WALLS, np.zeros(0, np.uint8))
    floor = np.stack(np.meshgrid(np.arange(0.0, 4.0, 0.05), [0.5, 1.0], [0.0]), axis=-1).reshape(-1, 3)
    votes = vote(np.repeat(floor, 3, axis=0), np.full(3 * len(floor), Label.FLOOR, np.uint8), 6, 0.05)
    told = refuse_outside(judged, Storey.of(votes, (), 3), COLUMNS)
    np.testing.assert_array_equal(told.walls.ends, both.ends[:1])
    assert told.verdict.tolist() == [FaceVerdict.OUTSIDE]
    assert told.refused_label.tolist() == [Label.OUTSIDE]


def test_a_wall_that_nothing_passes_stands_whole():
    assert judge(cells_of(4.0)) == ([[0.0, 4.0]], [])


def test_a_door_and_a_window_do_not_cut_their_wall():
    cells = cells_of(6.0)
    pass_rays(cells, slice(20, 40), 0.0, 2.1)
    pass_rays(cells, slice(70, 100), 0.9, 2.7)  # up to close below the ceiling
    assert judge(cells) == ([[0.0, 6.0]], [])


def test_a_high_window_does_not_cut_its_wall_though_rays_pass_beside_it():
    cells = cells_of(4.0)
    pass_rays(cells, slice(30, 50), 0.9, 2.5)
    cells.counts[26:30, 43:50, THROUGH] = cells.counts[50:54, 43:50, THROUGH] = 20.0  # aslant, past its edges
    assert judge(cells) == ([[0.0, 4.0]], [])


def test_a_cupboard_under_a_duct_is_no_wall():
    """The duct hides what is above it, where its own wall is seen."""
    front, wall = cells_of(1.2), cells_of(4.0)
    front.counts[:, round(2.0 / CELL_M) :] = 0.0
    both = WallCells(np.array([0, 24, 104]), front.rows, np.concatenate([front.counts, wall.counts]))
    ends = faces(((1, 0.5), (2.2, 0.5)), ((0, 0), (4, 0)))
    path = np.array([[0.0, 2.0], [4.0, 2.0]])
    judged = judged_faces(ends, both, np.full(104, CEILING_M), path)
    np.testing.assert_allclose(judged.walls.ends, ends.ends[1:])
    assert judged.verdict.tolist() == [FaceVerdict.ENDS_LOW]
    alone = judged_faces(ends.select(np.array([0])), front, np.full(24, CEILING_M), path)
    assert len(alone.walls) == 1  # of a wall, too, a duct may hide what is above


def test_a_duct_is_refused():
    cells = cells_of(6.0)
    pass_rays(cells, slice(0, 120), 0.0, 2.2)
    assert judge(cells) == ([], [FaceVerdict.HANGS])


def test_a_wall_beside_a_gate_in_a_high_hall_stands():
    """The gate is wider than doors are, and above leaves' height the wall returns more than below."""
    cells = cells_of(12.0)
    tall = WallCells(cells.first, 100, np.zeros((240, 100, 4), np.float32))
    tall.counts[:, :92, FILLED] = 10.0
    pass_rays(tall, slice(60, 124), 0.0, 3.2)
    judged = judged_faces(faces(((0, 0), (12, 0))), tall, np.full(240, 4.6), np.array([[6.0, 2.0], [7.0, 2.0]]))
    np.testing.assert_allclose(judged.walls.ends[:, :, 0], [[0.0, 3.0], [6.2, 12.0]], atol=3 * CELL_M)
    assert judged.verdict.tolist() == [FaceVerdict.HANGS]


def test_what_rays_end_on_from_foot_to_ceiling_shows_whole():
    whole, leaf, hidden = cells_of(0.4), cells_of(0.4), cells_of(0.4)
    pass_rays(leaf, slice(None), 2.05, CEILING_M)
    hidden.counts[:, 42:] = 0.0  # nobody looked above
    cells = WallCells(np.array([0, 8, 16, 24]), 66, np.concatenate([c.counts for c in (whole, leaf, hidden)]))
    assert shows_whole(
        TracedFaces(faces(*[((0, 0), (0.4, 0))] * 3), cells, np.full(24, CEILING_M), np.zeros(24)), SETTINGS
    ).tolist() == [True, False, False]


def test_the_rest_of_a_duct_goes_with_it():
    cells = cells_of(6.0)
    pass_rays(cells, slice(0, 90), 0.0, 2.2)
    cells.counts[90:, :44] = 0.0  # nobody looked below it
    kept, verdicts = judge(cells)
    assert kept == []
    assert set(verdicts) == {FaceVerdict.HANGS}


def test_where_the_robot_drove_along_stands_no_wall():
    assert judge(cells_of(2.0), path_y=0.05) == ([], [FaceVerdict.HANGS])


def test_a_leaf_is_refused_whether_seen_past_or_against_the_wall_behind():
    past = cells_of(0.9)
    pass_rays(past, slice(None), 2.05, CEILING_M)
    assert judge(past) == ([], [FaceVerdict.ENDS_LOW])
    behind = cells_of(0.9)
    rows = slice(int(2.05 / CELL_M), None)
    behind.counts[:, rows, SUM] = -0.2 * behind.counts[:, rows, FILLED]
    assert judge(behind) == ([], [FaceVerdict.ENDS_LOW])


def test_in_a_low_room_a_shelf_is_told_by_the_last_rows_below_the_ceiling():
    def judged(top_m: float) -> list[FaceVerdict]:
        cells = cells_of(1.5)
        cells.counts[:, int(2.2 / CELL_M) :] = 0.0
        pass_rays(cells, slice(None), top_m, 2.2)
        path = np.array([[0.0, 1.0], [1.5, 1.0]])
        return judged_faces(faces(((0, 0), (1.5, 0))), cells, np.full(30, 2.2), path).verdict.tolist()

    assert judged(1.9) == [FaceVerdict.ENDS_LOW]
    assert judged(2.2) == []


@pytest.mark.parametrize(("ceiling_m", "head_m"), [(2.2, 2.05), (2.25, 2.1), (2.15, 2.0)])
def test_in_a_low_room_a_doorway_cuts_no_wall(ceiling_m: float, head_m: float):
    cells = cells_of(4.0)
    cells.counts[:, int(ceiling_m / CELL_M) :] = 0.0
    pass_rays(cells, slice(31, 49), 0.0, head_m)
    path = np.array([[0.0, 1.0], [4.0, 1.0]])
    judged = judged_faces(faces(((0, 0), (4, 0))), cells, np.full(80, ceiling_m), path)
    np.testing.assert_allclose(judged.walls.ends, [[[0, 0], [4, 0]]])
    assert len(judged.refused) == 0


def test_nothing_shows_whole_of_no_faces_and_below_no_ceiling():
    none = WallCells(np.zeros(1, np.int64), 66, np.zeros((0, 66, 4), np.float32))
    assert shows_whole(TracedFaces(NO_WALLS, none, np.zeros(0), np.zeros(0)), SETTINGS).tolist() == []
    assert shows_whole(
        TracedFaces(faces(((0, 0), (0.4, 0))), cells_of(0.4), np.full(8, np.nan), np.zeros(8)), SETTINGS
    ).tolist() == [False]


def test_walls_show_above_doors_and_in_low_rooms_close_below_the_ceiling():
    clear_m = np.array([np.nan, 2.8, 2.37, 2.2])
    np.testing.assert_allclose(above_doors_m(clear_m, 2.12), [2.12, 2.12, 2.12, 1.95])


def test_a_cupboard_in_line_with_a_wall_is_cut_off():
    cells = cells_of(4.0)
    pass_rays(cells, slice(60, 80), 2.0, CEILING_M)
    kept, verdicts = judge(cells)
    assert verdicts == [FaceVerdict.ENDS_LOW]
    np.testing.assert_allclose(kept, [[0.0, 3.0]], atol=2 * CELL_M)


def test_pillars_in_line_stand_though_rays_pass_between_them():
    cells = cells_of(2.0)
    pass_rays(cells, slice(8, 32), 0.0, CEILING_M)
    assert judge(cells)[0] == [[0.0, 0.4], [1.6, 2.0]]
    # A reveal on either side of an opening is none: it ends at the door's head.
    pass_rays(cells, slice(0, 40), 2.1, CEILING_M)
    assert judge(cells)[0] == []


def test_nothing_is_decided_where_no_ray_went():
    cells = cells_of(2.0)
    cells.counts[...] = 0.0
    assert judge(cells) == ([[0.0, 2.0]], [])


def test_no_face_gives_no_answer():
    none = WallCells(np.zeros(1, np.int64), 66, np.zeros((0, 66, 4), np.float32))
    empty = NO_WALLS
    judged = judged_faces(empty, none, np.zeros(0), np.zeros((0, 2)))
    assert len(judged.walls) == len(judged.refused) == len(judged.verdict) == 0
    assert len(join_corners(empty, SETTINGS)) == 0


def test_faces_meet_in_their_corner_and_leave_gaps_that_are_wide():
    walls = join_corners(faces(((0, 0), (3.6, 0)), ((4, 0.5), (4, 3)), ((0, -2), (0, -9))), SETTINGS)
    np.testing.assert_allclose(walls.ends[0], [[0, 0], [4, 0]], atol=1e-9)
    np.testing.assert_allclose(walls.ends[1], [[4, 0], [4, 3]], atol=1e-9)
    np.testing.assert_allclose(walls.ends[2], [[0, -2], [0, -9]], atol=1e-9)


def test_a_face_that_reached_a_corner_is_not_carried_on_to_another():
    """A pillar's side, between its front and the wall, beside a cupboard."""
    side, front, cupboard = ((3, 0.5), (3, 0.02)), ((3, 0.45), (3.4, 0.45)), ((1, 0.9), (2.6, 0.9))
    walls = join_corners(faces(side, front, cupboard, ((1, 0), (6, 0))), SETTINGS)
    np.testing.assert_allclose(walls.ends[0], [[3, 0.5], [3, 0]], atol=1e-9)


def room(
    wall: bool = True,
    height_m: float = CEILING_M,
    seed: int = 0,
    from_x: float = -1.0,
    to_x: float = 5.0,
    from_y: float = 0.5,
    to_y: float = 2.0,
) -> VoxelVotes:
    """Floor and ceiling of a room, a known wall at y = 0, and clutter on the plane x = 3 from `from_y` to `to_y`."""
    generator = np.random.default_rng(seed)

    def spread(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], count: int) -> np.ndarray:
        low, high = np.array([x, y, z]).T
        return generator.uniform(low, high, (count, 3)) + generator.normal(0, 0.01, (count, 3))

    parts = [
        (spread((from_x, to_x), (0, 3), (0, 0), 40_000), Label.FLOOR),
        (spread((from_x, to_x), (0, 3), (CEILING_M, CEILING_M), 40_000), Label.CEILING),
        (spread((-1, 5), (0, 0), (0, CEILING_M), 9_000), Label.WALL),
    ]
    if wall:
        parts.append((spread((3, 3), (from_y, to_y), (0, height_m), 4_000), Label.CLUTTER))
    points = np.concatenate([p for p, _ in parts])
    label = np.concatenate([np.full(len(p), code, np.uint8) for p, code in parts])
    return vote(points, label, len(Label), 0.05)


def test_the_ceiling_over_a_place_is_known_where_it_was_seen():
    heights = Storey.of(room(), (), 3).clear_m(np.array([[1.0, 1.0], [60.0, 1.0]]), 2.0)
    assert heights[0] == pytest.approx(CEILING_M, abs=0.02)
    assert np.isnan(heights[1])


def search(
    votes: VoxelVotes,
    passed_above_m: float | None = None,
    path_x: float = 0.0,
    hip_m: float = 0.0,
    known: Walls | None = None,
    unseen_m: float = 0.0,
    seen_m: float = CEILING_M,
    window_m: tuple[float, float] | None = None,
    window_from_y: float = 0.0,
    from_y: float = 0.5,
    rays: float = 3.0,
) -> MissedWalls:
    """What is found; so many rays a cell end on every candidate that lies on x = 3, seen from smaller x, and pass the others.

    hip_m: from there to a door's head a few rays pass. unseen_m, seen_m: below and above there no ray comes.
    window_m: between these heights rays pass, from `window_from_y` on. known: a wall beside it. from_y: where the face begins.
    """

    storey = Storey.of(votes, (), 3)

    def trace(candidates: Walls) -> TracedFaces:
        columns = [int(np.ceil(np.linalg.norm(e[1] - e[0]) / CELL_M)) for e in candidates.ends]
        first = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
        counts = np.zeros((int(first[-1]), 60, 4), np.float32)
        for w in range(len(candidates)):
            own = slice(int(first[w]), int(first[w + 1]))
            on = bool(np.all(np.abs(candidates.ends[w, :, 0] - 3.0) < 0.03)) and candidates.normal[w, 0] < -0.9
            counts[own, :56, FILLED if on else THROUGH] = rays
            counts[own, :56, SQUARES] = rays * 0.01**2 * on
            if on and passed_above_m is not None:
                above = slice(int(passed_above_m / CELL_M), 56)
                counts[own, above, FILLED], counts[own, above, THROUGH] = 0.0, 3.0
            if on and hip_m:
                between = slice(int(hip_m / CELL_M), int(2.1 / CELL_M))
                counts[own, between, FILLED], counts[own, between, THROUGH] = 0.0, 0.1
            y = Segment.between(candidates.ends[w]).at((np.arange(columns[w]) + 0.5) * CELL_M)[:, 1]
            if on and window_m is not None:
                pane = counts[own, round(window_m[0] / CELL_M) : round(window_m[1] / CELL_M)]
                pane[y > window_from_y] = np.array([0.0, 0.0, 0.0, 3.0])
            counts[own, : int(unseen_m / CELL_M)] = 0.0
            counts[own, int(seen_m / CELL_M) :] = 0.0
            if on:
                counts[own][(y < from_y) | (y > 2.0)] = 0.0
        return TracedFaces.of(candidates, WallCells(first, 60, counts), storey, SETTINGS.ceiling_near_m)

    others = faces(((-1, 0), (5, 0)))
    others = others if known is None else others.append(known)
    path = np.column_stack([np.full(50, path_x), np.linspace(0.2, 2.8, 50)])
    return find_missed_walls(others, NO_WALLS, AllReturns(votes, storey, path, trace), SEARCH)


def missed(votes: VoxelVotes, **seen: Any) -> Walls:
    return search(votes, **seen).walls


def test_a_wall_that_no_scan_alone_told_is_found():
    walls = missed(room())
    assert len(walls) == 1
    np.testing.assert_allclose(walls.ends[0, :, 0], 3.0, atol=0.02)
    np.testing.assert_allclose(np.sort(walls.ends[0, :, 1]), [0.5, 2.0], atol=0.1)
    np.testing.assert_allclose(walls.normal[0], [-1.0, 0.0], atol=0.02)
    assert walls.top_m[0] == pytest.approx(CEILING_M, abs=0.06)


def test_a_missed_wall_says_what_it_rests_on() -> None:
    """No scan saw a plane of it; three rays end on each of its cells, and it is seen from 0.5 m to 2.5 m."""
    walls = missed(room(), unseen_m=0.5, seen_m=2.5)
    assert walls.scan_count.tolist() == [0]
    assert walls.bottom_m[0] == pytest.approx(0.5, abs=CELL_M)
    assert walls.top_m[0] == pytest.approx(2.5, abs=CELL_M)
    assert walls.sample_count[0] == pytest.approx(3 * (1.5 / CELL_M) * (2.0 / CELL_M), rel=0.1)
    assert walls.rms_m[0] == pytest.approx(0.01, abs=1e-6)


def test_a_pillar_before_a_wall_shows_from_floor_to_ceiling():
    behind = faces(((3.2, 0), (3.2, 3)))
    assert len(missed(room(), known=behind)) == 1
    # A bench, and a duct above it.
    assert len(missed(room(), hip_m=0.6)) == 0
    assert len(missed(room(), hip_m=0.6, known=behind)) == 0
    # What furniture hides may be wall, but for what stands before one.
    assert len(missed(room(), unseen_m=1.2)) == 1
    assert len(missed(room(), unseen_m=1.2, known=behind)) == 0


def room_with_a_duct(underside_x: tuple[float, float]) -> VoxelVotes:
    """The room whose wall shows up to 2 m, and what hangs level before it."""
    votes = room(height_m=2.0)
    x, y = np.meshgrid(np.arange(*underside_x, 0.02), np.arange(0.5, 2.0, 0.02))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.02)], axis=1)
    table = VoxelTable(0.05, len(Label))
    table.absorb(votes)
    table.add(points.astype(np.float32), np.full(len(points), Label.CLUTTER, np.uint8))
    return table.votes()


def test_a_wall_that_shows_below_a_duct_alone_is_found_and_what_hangs_before_it_is_no_wall():
    """The duct's front goes on as a cupboard's, from y = 2.2 m to 3 m."""
    front = faces(((2.55, 0.0), (2.55, 3.0)))
    found = search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=front)
    assert len(found.walls) == 1
    np.testing.assert_allclose(found.walls.ends[0, :, 0], 3.0, atol=0.02)
    np.testing.assert_allclose(np.sort(found.ducts.ends[0, :, 1]), [0.5, 2.0], atol=0.1)
    beside = found.known.ends[np.abs(found.known.normal[:, 0]) > 0.9]
    np.testing.assert_allclose(np.sort(beside[:, :, 1], axis=1), [[0.0, 0.5], [2.0, 3.0]], atol=0.1)
    # What hangs as deep as a wall is thick is a lintel: behind the doorway stands a cupboard, or another room's wall.
    lintel = search(room_with_a_duct((2.55, 2.7)), seen_m=2.0, known=front)
    assert (len(lintel.walls), len(lintel.ducts), len(lintel.known)) == (0, 0, 2)
    # Less than two returns a row show nothing.
    assert len(missed(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=front, rays=0.04)) == 0
    # Without a front it is a shelf.
    assert len(missed(room_with_a_duct((2.55, 3.0)), seen_m=2.0)) == 0


def test_on_a_raised_floor_a_ducts_underside_is_as_high_above_it() -> None:
    votes = room_with_a_duct((2.55, 3.0))
    table = VoxelTable(0.05, len(Label))
    for code in Label:
        own = majority(votes.counts) == code
        points = np.repeat(votes.mean_position[own] + [0.0, 0.0, 0.5], 3, axis=0)
        table.add(points, np.full(len(points), code, np.uint8))
    found = search(table.votes(), seen_m=2.0, known=faces(((2.55, 0.0), (2.55, 3.0))))
    assert (len(found.walls), len(found.ducts)) == (1, 1)


def test_what_is_left_of_a_ducts_front_goes_with_it_where_it_is_too_short_for_a_face():
    found = search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=faces(((2.55, 0.35), (2.55, 3.0))))
    across = [np.sort(w.ends[np.abs(w.normal[:, 0]) > 0.9][:, :, 1], axis=1) for w in (found.ducts, found.known)]
    np.testing.assert_allclose(across[0], [[0.35, 2.0]], atol=0.1)
    np.testing.assert_allclose(across[0][0, 0], 0.35)
    np.testing.assert_allclose(across[1], [[2.0, 3.0]], atol=0.1)


def test_what_is_seen_no_higher_than_heads_are_is_a_leaf_or_a_reveal():
    assert len(missed(room(), seen_m=2.2)) == 0
    assert len(missed(room(), seen_m=2.35)) == 1  # through a doorway, from afar


def test_a_missed_wall_may_have_a_window():
    outer = room(to_x=3.0)
    assert len(missed(outer, window_m=(0.9, 2.1))) == 1
    assert len(missed(outer, window_m=(0.3, 2.1))) == 0  # a bench, and a duct above it
    assert len(missed(outer, window_m=(SEARCH.building.knee_m, 2.1))) == 1  # sills begin at the knee, as for doors
    assert len(missed(room(), window_m=(0.9, 2.1))) == 0  # a table in the room, and a lamp above it


def test_a_window_goes_on_from_a_missed_wall_over_its_sill():
    """Through a doorway, next to nothing of the wall above it is seen."""

    def with_window(foot_m: float) -> Walls:
        return missed(room(to_x=3.0), window_from_y=1.0, window_m=(foot_m, CEILING_M))

    np.testing.assert_allclose(np.sort(with_window(0.9).ends[0, :, 1]), [0.5, 2.0], atol=0.11)
    np.testing.assert_allclose(np.sort(with_window(0.3).ends[0, :, 1]), [0.5, 1.0], atol=0.11)


def test_a_cupboard_and_a_duct_above_it_are_no_wall_with_a_window():
    """Between them rays pass to the wall behind."""
    assert len(missed(room(to_x=3.0), window_m=(0.9, 2.5), known=faces(((3.6, 0), (3.6, 3))))) == 0


def test_a_window_may_reach_close_to_the_ceiling():
    assert len(missed(room(to_x=3.0), window_m=(0.9, 2.5))) == 1
    assert len(missed(room(to_x=3.0), window_m=(0.9, 2.75))) == 0  # a partition


def test_a_pillars_side_is_as_long_as_to_the_corner_with_its_front():
    """Close to the front its returns pass for the front's."""
    front = ((3.02, 0.4), (3.35, 0.4))
    assert len(missed(room(to_y=0.66))) == 0
    assert len(missed(room(to_y=0.66), known=faces(front))) == 1


def test_a_pillar_has_sides_however_little_it_stands_before_its_wall():
    """Most of a side lies so close to the wall, or to the pillar's front, that its returns pass for theirs."""
    found = missed(room(from_y=0.02, to_y=0.24), from_y=0.0, known=faces(((2.95, 0.26), (3.4, 0.26))))
    np.testing.assert_allclose(found.ends[0, :, 0], 3.0, atol=0.01)
    np.testing.assert_allclose(np.sort(found.ends[0, :, 1]), [0.0, 0.26], atol=0.06)


def test_a_pillar_may_be_as_narrow_as_a_wall_is_short():
    """Columns are told with those beside them, which rays pass; its own outer ones count all the same."""
    table = room(from_y=0.7, to_y=1.5)
    found = missed(table, from_y=0.7, window_m=(0.0, CEILING_M), window_from_y=0.93)
    np.testing.assert_allclose(np.sort(found.ends[0, :, 1]), [0.7, 0.93], atol=0.06)
    assert len(missed(table, from_y=0.7, window_m=(0.0, CEILING_M), window_from_y=0.82)) == 0


def test_before_a_wall_of_this_building_floor_or_ceiling_is_seen():
    """Through windows another house's front shows, as high as the ceiling, which ends there."""
    assert len(missed(room(from_x=2.0))) == 1
    assert len(missed(room(from_x=2.9))) == 0


def test_a_missed_wall_ends_at_a_wall_that_it_crosses():
    walls = missed(room(), known=faces(((2.0, 1.2), (4.0, 1.2))))
    along = np.sort(walls.ends[:, :, 1], axis=1)
    np.testing.assert_allclose(along[np.argsort(along[:, 0])], [[0.5, 1.2], [1.2, 2.0]], atol=0.1)
    # What is left beyond is as short as a window's reveal.
    walls = missed(room(), known=faces(((2.0, 1.8), (4.0, 1.8))))
    np.testing.assert_allclose(np.sort(walls.ends[:, :, 1]), [[0.5, 1.8]], atol=0.1)


def test_between_two_walls_that_look_at_each_other_there_is_room():
    assert len(missed(room(), known=faces(((2.8, 3), (2.8, 0))))) == 0
    assert len(missed(room(), known=faces(((2.0, 3), (2.0, 0))))) == 1


def test_a_face_alone_runs_along_and_across_no_others():
    room_of_four = [((0, 0), (8, 0)), ((8, 0), (8, 6)), ((8, 6), (0, 6)), ((0, 6), (0, 0))]
    diagonal, pillar = ((1.0, 1.0), (1.5, 1.4)), ((2.0, 2.0), (2.3, 2.01))
    assert along_others(faces(*room_of_four, diagonal, pillar), SETTINGS).tolist() == [True] * 4 + [False, True]
    assert len(along_others(NO_WALLS, SETTINGS)) == 0


def test_a_leaf_that_is_open_against_its_wall_leans_on_it():
    wall, leaf, across = ((0, 0), (5, 0)), ((1.0, 0.02), (1.9, 0.14)), ((2.5, 0), (2.5, 3))
    pair = replace(faces(wall, leaf, across), scan_count=np.array([40, 9, 9], np.int32))
    assert leaning_on_others(pair, SETTINGS).tolist() == [False, True, False]
    # As many scans saw it: a wall that bends. It stands away, or goes on beyond the other's end: another wall.
    assert not leaning_on_others(replace(pair, scan_count=np.array([20, 9, 9], np.int32)), SETTINGS).any()
    for other in (((1.0, 0.32), (1.9, 0.44)), ((4.6, 0.02), (5.5, 0.14)), ((1.0, 0.02), (1.9, 0.05))):
        assert not leaning_on_others(
            replace(faces(wall, other), scan_count=np.array([40, 9], np.int32)), SETTINGS
        ).any()
    assert len(leaning_on_others(NO_WALLS, SETTINGS)) == 0


def test_furniture_lower_than_the_ceiling_is_no_missed_wall():
    assert len(missed(room(height_m=1.9), passed_above_m=1.9)) == 0


def test_no_wall_is_found_where_the_robot_drove_or_nothing_stands():
    assert len(missed(room(), path_x=3.05)) == 0
    assert len(missed(room(wall=False))) == 0


@pytest.mark.parametrize("goes_on", [False, True])
def test_a_reveal_ends_with_its_wall_unless_a_wall_goes_on_from_it(goes_on: bool) -> None:
    """A wall 0.2 m thick along x; the face across it, at the door's jamb, runs on for the length of a leaf."""
    face = faces(((1.0, 0.5), (1.0, -1.0)))
    cells = cells_of(1.5)
    if not goes_on:
        pass_rays(cells, slice(14, 30), 2.05, CEILING_M)
    door = replace(
        NO_DOORS,
        ends=np.array([[[0.1, 0.5], [1.0, 0.5]]]),
        normal=np.array([[0.0, 1.0]]),
        head_m=np.array([2.05]),
        reveal_m=np.array([0.2]),
    )
    trimmed = trim_at_doorways(TracedFaces(face, cells, np.full(30, CEILING_M), np.zeros(30)), door, SETTINGS)
    assert int(trimmed.faces.cells.first[-1]) == len(trimmed.faces.cells.counts)
    if goes_on:
        np.testing.assert_allclose(trimmed.faces.walls.ends, face.ends)
        assert len(trimmed.leaves) == 0
    else:
        assert trimmed.faces.walls.ends[0, 1, 1] >= 0.3
        np.testing.assert_allclose(trimmed.leaves.ends[0, 1], face.ends[0, 1])
        assert trimmed.leaves.top_m[0] == 2.05


def test_of_a_face_that_two_doorways_would_cut_away_something_is_left() -> None:
    """One door leaves what is above y = 0.3, the other what is below y = 0."""
    face, cells = faces(((1.0, 0.5), (1.0, -1.0))), cells_of(1.5)
    pass_rays(cells, slice(None), 2.05, CEILING_M)
    doors = replace(
        NO_DOORS,
        ends=np.array([[[0.1, 0.5], [1.0, 0.5]], [[1.0, -0.2], [0.1, -0.2]]]),
        normal=np.array([[0.0, 1.0], [0.0, -1.0]]),
        head_m=np.array([2.05, 2.05]),
        reveal_m=np.array([0.2, 0.2]),
    )
    trimmed = trim_at_doorways(TracedFaces(face, cells, np.full(30, CEILING_M), np.zeros(30)), doors, SETTINGS)
    ends = trimmed.faces.walls.ends[0, :, 1]
    np.testing.assert_allclose(ends[0] - ends[1], 2 * CELL_M)
    assert trimmed.faces.cells.first.tolist() == [0, 2]
    assert len(trimmed.faces.cells.counts) == len(trimmed.faces.clear_m) == 2


def test_a_last_column_that_is_next_to_nothing_is_not_what_is_left() -> None:
    """A face 6 columns and a rounding error long, of which a doorway leaves the end."""
    face = faces(((1.0, 0.1), (1.0, -0.2 - 1e-12)))
    cells = cells_of(0.35)
    pass_rays(cells, slice(None), 2.05, CEILING_M)
    door = replace(
        NO_DOORS,
        ends=np.array([[[1.0, -0.25], [0.1, -0.25]]]),
        normal=np.array([[0.0, -1.0]]),
        head_m=np.array([2.05]),
        reveal_m=np.array([0.06]),
    )
    trimmed = trim_at_doorways(TracedFaces(face, cells, np.full(7, CEILING_M), np.zeros(7)), door, SETTINGS)
    assert np.linalg.norm(trimmed.faces.walls.ends[0, 1] - trimmed.faces.walls.ends[0, 0]) > 0.04


def test_faces_far_from_doors_and_no_faces_stay_as_they_are() -> None:
    face, cells = faces(((3.0, 0.5), (3.0, -1.0))), cells_of(1.5)
    trimmed = trim_at_doorways(TracedFaces(face, cells, np.full(30, CEILING_M), np.zeros(30)), NO_DOORS, SETTINGS)
    np.testing.assert_array_equal(trimmed.faces.walls.ends, face.ends)
    nothing = WallCells(np.zeros(1, np.int64), 66, np.zeros((0, 66, 4), np.float32))
    assert (
        len(trim_at_doorways(TracedFaces(NO_WALLS, nothing, np.zeros(0), np.zeros(0)), NO_DOORS, SETTINGS).faces) == 0
    )
