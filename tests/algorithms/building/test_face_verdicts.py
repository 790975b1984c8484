"""Which faces stand: ducts, leaves and high windows by hand-made rays; corners, reveals and heights of rooms."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.face_columns import (
    FaceColumnsSettings,
    Storey,
    TracedFaces,
    above_doors_m,
)
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
from ffmap.algorithms.building.folds import FoldsSettings
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WALLS,
    NO_WINDOWS,
    BuildingSettings,
    Walls,
)
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.windows import without_panes
from tests.faces import CEILING_M, doors, faces, window
from tests.voting import vote

SETTINGS = StandingWallsSettings()
COLUMNS = FaceColumnsSettings()
FILLED, SUM, SQUARES, THROUGH = range(4)


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
        TracedFaces(walls, cells, clear_m, np.zeros(len(clear_m))),
        path_map,
        OpeningRules(BuildingSettings(), OpeningsSettings()),
        COLUMNS,
        SETTINGS,
        FoldsSettings(),
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


def test_a_pillar_below_a_beams_end_stands_and_a_cupboard_there_does_not():
    beam = cells_of(6.0)
    pass_rays(beam, slice(8, None), 0.1, 2.05)
    kept, verdicts = judge(beam)
    np.testing.assert_allclose(kept, [[0.0, 0.4]], atol=CELL_M + 1e-9)
    assert verdicts == [FaceVerdict.HANGS]
    pass_rays(beam, slice(8), 1.8, 2.1)  # far more rays end below
    beam.counts[:8, :36, FILLED] = 100.0
    assert judge(beam)[0] == []


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


def test_what_leaves_a_gap_below_the_ceiling_is_no_wall():
    """A wardrobe in a low room: rays pass its uppermost 10 cm alone, far less than end on it above doors."""
    assert judge(cells_of(1.5)) == ([[0.0, 1.5]], [])
    wardrobe = cells_of(1.5)
    pass_rays(wardrobe, slice(None), CEILING_M - 0.2, CEILING_M)
    assert judge(wardrobe) == ([], [FaceVerdict.ENDS_LOW])
    wardrobe.counts[:, :, FILLED] = np.maximum(wardrobe.counts[:, :, FILLED], 8.0)  # things on its top
    assert judge(wardrobe) == ([], [FaceVerdict.ENDS_LOW])


def test_a_gap_of_one_row_may_be_the_ceilings_scatter() -> None:
    wall = cells_of(1.5)
    pass_rays(wall, slice(None), CEILING_M - 0.14, CEILING_M)
    assert judge(wall) == ([[0.0, 1.5]], [])


def test_a_fanlight_is_no_gap_above_furniture():
    """What rays pass from the floor up has nothing that could end low."""
    doorway = cells_of(2.0)
    pass_rays(doorway, slice(6, 34), 0.1, 2.05)
    pass_rays(doorway, slice(6, 34), CEILING_M - 0.2, CEILING_M)
    assert judge(doorway) == ([[0.0, 2.0]], [])


def test_a_face_without_room_before_it_is_outside():
    both = faces(((0, 0), (4, 0)), ((0, 9), (4, 9)))
    judged = JudgedFaces(both, NO_WALLS, np.zeros(0, np.uint8))
    floor = np.stack(np.meshgrid(np.arange(0.0, 4.0, 0.05), [0.5, 1.0], [0.0]), axis=-1).reshape(-1, 3)
    votes = vote(np.repeat(floor, 3, axis=0), np.full(3 * len(floor), Label.FLOOR, np.uint8), 6, 0.05)
    told = refuse_outside(judged, Storey.of(votes, (), LevelsSettings()), COLUMNS)
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


def test_a_door_as_high_as_codes_allow_does_not_cut_its_wall():
    cells = cells_of(6.0)
    pass_rays(cells, slice(40, 60), 0.0, 2.5)
    assert judge(cells) == ([[0.0, 6.0]], [])


def test_a_glazed_wall_is_no_duct_however_long():
    """Its panes let most rays through, but what they return comes from one sheet."""
    cells = cells_of(8.0)
    pass_rays(cells, slice(10, 150), 0.0, 2.3)
    assert judge(cells)[1] == [FaceVerdict.HANGS]
    cells.counts[10:150, : int(2.3 / CELL_M), FILLED] = 1.0
    assert judge(cells) == ([[0.0, 8.0]], [])


@pytest.mark.parametrize("known", [True, False])
def test_what_a_windows_bars_and_posters_return_is_not_beyond_its_wall(known: bool) -> None:
    """A shop's front, its glass 13 cm behind the fascia: of the rays that pass it nothing is left where the glass is known."""
    front = cells_of(6.0)
    glass = front.counts[4:116, 1:46]
    glass[..., SUM], glass[..., SQUARES] = -1.3, 0.169
    walls, pane_y = faces(((0, 0), (6, 0))), -0.13
    panes = replace(window((0.2, pane_y), (5.8, pane_y)), bottom_m=np.array([0.05]), top_m=np.array([2.3]))
    traced = TracedFaces(walls, front, np.full(120, CEILING_M), np.zeros(120))
    cleared = without_panes(traced, panes if known else NO_WINDOWS, BuildingSettings().near_m)
    verdicts = judged_faces(walls, cleared.cells, cleared.clear_m, np.array([[3.0, 1.0]])).verdict
    assert verdicts.tolist() == ([] if known else [FaceVerdict.HANGS])


def test_a_curtain_before_a_window_stays() -> None:
    """Rays end on it; a face farther before the window than walls are deep has nothing of the window in it."""
    curtain = cells_of(2.0)
    pass_rays(curtain, slice(20, None), 1.0, 2.0)
    for y, passed in ((-0.1, 0.0), (-0.9, 20.0)):
        traced = TracedFaces(faces(((0, 0), (2, 0))), curtain, np.full(40, CEILING_M), np.zeros(40))
        cleared = without_panes(traced, window((0.0, y), (2.0, y)), BuildingSettings().near_m).cells.counts
        assert (cleared[:20, :50, FILLED] == 10.0).all()
        assert (cleared[22:, 22:38, THROUGH] == passed).all()
    assert (curtain.counts[22:, 22:38, THROUGH] == 20.0).all()


@pytest.mark.parametrize("ends", [((0.5, 0.0), (9.0, 0.0)), ((9.0, 0.0), (0.5, 0.0))])
def test_only_what_passes_a_window_itself_is_left_out(ends: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """Of two faces the second has one that is longer than it; nothing beside it, above or below is left out."""
    walls = faces(((0, 5), (1, 5)), ((0, 0), (1.02, 0)))
    counts = np.zeros((20 + 21, 66, 4), np.float32)
    counts[..., THROUGH] = 20.0
    traced = TracedFaces(walls, WallCells(np.array([0, 20, 41]), 66, counts), np.full(41, CEILING_M), np.zeros(41))
    cleared = without_panes(traced, window(*ends), BuildingSettings().near_m).cells.counts[..., THROUGH] == 0.0
    expected = np.zeros((41, 66), bool)
    expected[20 + 10 :, round(0.9 / CELL_M) : round(2.2 / CELL_M)] = True
    np.testing.assert_array_equal(cleared, expected)


def test_a_high_window_does_not_cut_its_wall_though_rays_pass_beside_it():
    cells = cells_of(4.0)
    pass_rays(cells, slice(30, 50), 0.9, 2.5)
    cells.counts[26:30, 43:50, THROUGH] = cells.counts[50:54, 43:50, THROUGH] = 20.0  # aslant, past its edges
    assert judge(cells) == ([[0.0, 4.0]], [])


def test_windows_with_mullions_below_a_soffit_do_not_cut_their_wall():
    """Between them stand but 25 cm of wall; what is above 2.7 m is hidden."""
    cells = cells_of(4.0)
    for first, last in ((10, 26), (31, 47), (56, 72)):
        pass_rays(cells, slice(first, last), 0.9, 2.5)
    cells.counts[:, round(2.7 / CELL_M) :] = 0.0
    assert judge(cells) == ([[0.0, 4.0]], [])


def test_a_window_along_a_whole_face_does_not_cut_its_wall():
    """A ribbon of windows has no jambs, but its spandrel is in line with the wall above."""
    cells = cells_of(6.0)
    pass_rays(cells, slice(None), 0.75, 2.5)
    assert judge(cells) == ([[0.0, 6.0]], [])


@pytest.mark.parametrize(("sill_m", "stands"), [(0.75, True), (1.55, True), (1.8, False)])
def test_a_spandrel_may_be_high_but_what_reaches_doors_heads_is_a_cupboards(sill_m: float, stands: bool) -> None:
    """Above a sill of 1.55 m rays pass less of what is below doors' heads than the spandrel takes of it."""
    cells = cells_of(6.0)
    pass_rays(cells, slice(None), sill_m, 2.5)
    assert bool(judge(cells)[0]) == stands


def test_a_duct_is_refused():
    cells = cells_of(6.0)
    pass_rays(cells, slice(0, 120), 0.0, 2.2)
    assert judge(cells) == ([], [FaceVerdict.HANGS])


@pytest.mark.parametrize(("before_m", "stands"), [(0.09, True), (-0.2, False)], ids=["before the wall", "behind a duct"])
def test_what_ends_before_a_face_has_not_passed_it(before_m: float, stands: bool) -> None:
    """Panels on a far wall stand 9 cm before it over half its length; below a duct its own wall is seen 20 cm behind."""
    cells = cells_of(6.0)
    part = cells.counts[:60, : round(2.2 / CELL_M)]
    part[..., SUM] = before_m * part[..., FILLED]
    part[..., SQUARES] = before_m**2 * part[..., FILLED]
    assert (judge(cells) == ([[0.0, 6.0]], [])) == stands


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


@pytest.mark.parametrize(("returns", "stands"), [(2.0, False), (10.0, True)])
def test_of_a_duct_what_shows_less_below_than_above_is_a_rest(returns: float, stands: bool):
    """Some rays pass beside what stands there; where most end, and more than above, it is the wall beside a gate."""
    cells = cells_of(6.0)
    pass_rays(cells, slice(0, 84), 0.1, 2.05)
    cells.counts[84:, :42, FILLED] = returns
    cells.counts[84:, 10:14] = [0.0, 0.0, 0.0, 3.0]
    assert judge(cells)[0] == ([[4.2, 6.0]] if stands else [])


def test_where_the_robot_drove_along_stands_no_wall():
    assert judge(cells_of(2.0), path_y=0.05) == ([], [FaceVerdict.HANGS])
    # A narrow robot gets close to a pillar.
    assert judge(cells_of(2.0), path_y=0.18) == ([[0.0, 2.0]], [])


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
    # Far more rays end on a pillar's side than on its front, behind the face and all in one column.
    cells.counts[38, :, FILLED], cells.counts[38, :, SUM] = 100.0, -20.0
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


def test_the_ceiling_over_a_place_is_known_where_it_was_seen():
    floor = np.stack(np.meshgrid(np.arange(0.0, 4.0, 0.05), np.arange(0.0, 2.0, 0.05), [0.0]), axis=-1).reshape(-1, 3)
    storey = Storey(floor, floor + np.array([0.0, 0.0, CEILING_M]))
    heights = storey.clear_m(np.array([[1.0, 1.0], [60.0, 1.0]]), 2.0)
    assert heights[0] == pytest.approx(CEILING_M, abs=0.02)
    assert np.isnan(heights[1])


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


@pytest.mark.parametrize("head_m", [2.05, CEILING_M])
@pytest.mark.parametrize("goes_on", [False, True])
def test_a_reveal_ends_with_its_wall_unless_a_wall_goes_on_from_it(goes_on: bool, head_m: float) -> None:
    """A wall 0.2 m thick along x; the face across it, at the jamb of a door or of a higher passage, runs on as long as a leaf."""
    face = faces(((1.0, 0.5), (1.0, -1.0)))
    cells = cells_of(1.5)
    if not goes_on:
        pass_rays(cells, slice(14, 30), 2.05, CEILING_M)
    door = doors(((0.1, 0.5), (1.0, 0.5)), head_m=head_m, normal=[[0.0, 1.0]], reveal_m=[0.2])
    trimmed = trim_at_doorways(TracedFaces(face, cells, np.full(30, CEILING_M), np.zeros(30)), door, SETTINGS)
    assert int(trimmed.faces.cells.first[-1]) == len(trimmed.faces.cells.counts)
    if goes_on:
        np.testing.assert_allclose(trimmed.faces.walls.ends, face.ends)
        assert len(trimmed.leaves) == 0
    else:
        assert trimmed.faces.walls.ends[0, 1, 1] >= 0.3
        np.testing.assert_allclose(trimmed.leaves.ends[0, 1], face.ends[0, 1])
        assert trimmed.leaves.top_m[0] == head_m


def test_a_wall_goes_on_from_a_reveal_though_most_of_it_is_an_open_doorway() -> None:
    """As of a closet at a corridor's end, whose leaf stands ajar: no door is known there."""
    face, cells = faces(((1.0, 0.5), (1.0, -1.0))), cells_of(1.5)
    pass_rays(cells, slice(10, 28), 0.1, 2.05)
    door = doors(((0.1, 0.5), (1.0, 0.5)), head_m=2.05, normal=[[0.0, 1.0]], reveal_m=[0.2])

    def leaves(cells: WallCells, clear_m: float = CEILING_M) -> int:
        return len(trim_at_doorways(TracedFaces(face, cells, np.full(30, clear_m), np.zeros(30)), door, SETTINGS).leaves)

    assert leaves(cells) == 0
    assert leaves(cells, np.nan) == 1
    hidden = cells_of(1.5)
    hidden.counts[:, : round(2.1 / CELL_M)] = 0.0  # by furniture
    assert leaves(hidden) == 0
    passed = cells_of(1.5)
    pass_rays(passed, slice(10, 28), 0.1, CEILING_M)
    assert leaves(passed) == 1


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


def lay(cells: WallCells, before_m: np.ndarray) -> None:
    """Move what returns from each column (c,), or cell (c, rows), before the face."""
    cells.counts[..., SUM] = cells.counts[..., FILLED] * (before_m[:, None] if before_m.ndim == 1 else before_m)
    cells.counts[..., SQUARES] = cells.counts[..., SUM] * before_m.reshape(len(before_m), -1)


def folds_m(columns: int, first: int, after: int, deep_m: float = 0.03, period_m: float = 0.16) -> np.ndarray:
    """(c,) how far the columns lie before a face, in some of which cloth hangs."""
    along_m = (np.arange(columns) + 0.5) * CELL_M
    hangs = (np.arange(columns) >= first) & (np.arange(columns) < after)
    return np.where(hangs, deep_m * np.sin(2 * np.pi * along_m / period_m), 0.0)


@pytest.mark.parametrize("flip", [1, -1])
def test_cloth_hangs_in_folds_and_a_wall_does_not(flip: int) -> None:
    wall = cells_of(4.0)
    lay(wall, folds_m(80, 20, 50)[::flip])
    stands, verdicts = judge(wall)
    assert verdicts == [FaceVerdict.FOLDED]
    expected = [[0.0, 1.0], [2.5, 4.0]] if flip == 1 else [[0.0, 1.5], [3.0, 4.0]]
    np.testing.assert_allclose(stands, expected, atol=2 * CELL_M)


@pytest.mark.parametrize(
    "before_m",
    [
        folds_m(80, 20, 50, deep_m=0.006),  # as uneven as old plaster
        folds_m(80, 20, 25),  # as narrow as a casing with its jamb
        np.where(np.arange(80) % 12 < 2, 0.04, 0.0),  # pilasters
        np.linspace(-0.03, 0.03, 80),  # a face that is askew
        np.where(np.arange(80) > 40, 0.06, 0.0),  # a step
    ],
)
def test_what_is_not_in_folds(before_m: np.ndarray) -> None:
    wall = cells_of(4.0)
    lay(wall, before_m)
    assert judge(wall) == ([[0.0, 4.0]], [])


def test_what_stands_on_shelves_is_not_alike_from_top_to_bottom() -> None:
    wall, fold_m = cells_of(4.0), folds_m(80, 20, 50)[:, None] * np.ones(66)
    fold_m[:, 26:] *= -1.0  # higher up what lay before lies behind
    lay(wall, fold_m)
    assert judge(wall) == ([[0.0, 4.0]], [])
    low = cells_of(4.0)
    lay(low, folds_m(80, 20, 50))
    low.counts[20:50, 33:] = 0.0  # of its upper half a fifth shows
    assert FaceVerdict.FOLDED not in judge(low)[1]
