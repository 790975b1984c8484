"""Walls that every single scan missed: found of the returns of all scans, by hand-made rays."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.segments import Segment
from ffmap.algorithms.building.face_columns import FaceColumnsSettings, Storey, TracedFaces
from ffmap.algorithms.building.face_verdicts import StandingWallsSettings
from ffmap.algorithms.building.folds import FoldsSettings
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.missed_walls import (
    AllReturns,
    MissedWalls,
    MissedWallsSettings,
    SearchSettings,
    find_missed_walls,
)
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Walls
from ffmap.algorithms.building.ray_evidence import WallCells
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes, majority
from tests.faces import CEILING_M, faces
from tests.voting import merge, vote

SETTINGS = StandingWallsSettings()
COLUMNS = FaceColumnsSettings()
SEARCH = SearchSettings(BuildingSettings(), SETTINGS, COLUMNS, MissedWallsSettings(), FoldsSettings())
FILLED, SUM, SQUARES, THROUGH = range(4)


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


def search(
    votes: VoxelVotes,
    passed_above_m: float | None = None,
    path_x: float = 0.0,
    hip_m: float = 0.0,
    known: Walls | None = None,
    refused: Walls = NO_WALLS,
    unseen_m: float = 0.0,
    seen_m: float = CEILING_M,
    window_m: tuple[float, float] | None = None,
    window_y: tuple[float, float] = (0.0, 3.0),
    sill_seen_to_y: float = 3.0,
    doorway_from_y: float = 3.0,
    hidden_from_y: float = 3.0,
    from_y: float = 0.5,
    rays: float = 3.0,
    clear_of_glass: float = 1.0,
    fold_m: float = 0.0,
    building: BuildingSettings = BuildingSettings(),  # noqa: B008 - frozen
) -> MissedWalls:
    """What is found; so many rays a cell end on every candidate that lies on x = 3, seen from smaller x, and pass the others.

    hip_m: from there to a door's head a few rays pass. unseen_m, seen_m: below and above there no ray comes.
    window_m, window_y: between these heights, and from where to where, rays pass; below it none comes from `sill_seen_to_y` on,
    and all pass from `doorway_from_y` on. hidden_from_y: from there no ray comes. known, refused: faces beside it. from_y: where
    the face begins. clear_of_glass: the share of all rays that pass no wall close beside a window. fold_m: by how much each second
    column hangs before the plane, and the others behind it.
    """

    storey = Storey.of(votes, (), LevelsSettings())

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
                beside = (y < window_y[0]) | (y > window_y[1])
                pane[~beside] = np.array([0.0, 0.0, 0.0, 3.0])
                below = counts[own, : round(window_m[0] / CELL_M)]
                below[~beside & (y > sill_seen_to_y)] = 0.0
                below[~beside & (y > doorway_from_y)] = np.array([0.0, 0.0, 0.0, 3.0])
            counts[own, : int(unseen_m / CELL_M)] = 0.0
            counts[own, int(seen_m / CELL_M) :] = 0.0
            if on:
                folds_m = np.where(np.arange(columns[w]) % 2, fold_m, -fold_m)[:, None]
                counts[own, ..., SUM] += folds_m * counts[own, ..., FILLED]
                counts[own, ..., SQUARES] += folds_m**2 * counts[own, ..., FILLED]
                counts[own][(y < from_y) | (y > min(2.0, hidden_from_y))] = 0.0
        return TracedFaces.of(candidates, WallCells(first, 60, counts), storey, SETTINGS.ceiling_near_m)

    others = faces(((-1, 0), (5, 0)))
    others = others if known is None else others.append(known)

    def trace_clear(candidates: Walls) -> TracedFaces:
        traced = trace(candidates)
        return replace(traced, cells=replace(traced.cells, counts=traced.cells.counts * np.float32(clear_of_glass)))

    path = np.column_stack([np.full(50, path_x), np.linspace(0.2, 2.8, 50)])
    settings = replace(SEARCH, building=building)
    return find_missed_walls(others, refused, AllReturns(votes, storey, path, trace, trace_clear), settings)


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


def test_what_only_rays_beside_a_window_show_is_what_its_pane_mirrors() -> None:
    """How far a pane goes is known to some decimetres; a true wall is also seen from elsewhere."""
    reflection, wall = search(room(), clear_of_glass=0.05), search(room(), clear_of_glass=0.2)
    assert (len(reflection.walls), len(wall.walls)) == (0, 1)
    np.testing.assert_array_equal(reflection.mirrored.ends, wall.walls.ends)
    assert len(wall.mirrored) == 0


def test_a_bench_and_a_duct_above_it_are_no_wall() -> None:
    """What furniture hides may be wall, but not where rays pass over it."""
    assert len(missed(room(), unseen_m=1.2)) == 1
    assert len(missed(room(), hip_m=0.6)) == 0


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
    """The duct's front goes on as a cupboard's, from y = 2 m to 3 m."""
    front = faces(((2.55, 0.5), (2.55, 3.0)))
    found = search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=front)
    assert len(found.walls) == 1
    np.testing.assert_allclose(found.walls.ends[0, :, 0], 3.0, atol=0.02)
    np.testing.assert_allclose(np.sort(found.ducts.ends[0, :, 1]), [0.5, 2.0], atol=0.1)
    beside = found.known.ends[np.abs(found.known.normal[:, 0]) > 0.9]
    np.testing.assert_allclose(np.sort(beside[:, :, 1], axis=1), [[2.0, 3.0]], atol=0.1)
    # What hangs as deep as a wall is thick is a lintel: behind the doorway stands a cupboard, or another room's wall.
    lintel = search(room_with_a_duct((2.55, 2.7)), seen_m=2.0, known=front)
    assert (len(lintel.walls), len(lintel.ducts), len(lintel.known)) == (0, 0, 2)
    # Less than two returns a row show nothing.
    assert len(missed(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=front, rays=0.04)) == 0
    # Without a front it is a shelf.
    assert len(missed(room_with_a_duct((2.55, 3.0)), seen_m=2.0)) == 0


@pytest.mark.parametrize(("goes_on_m", "widest_m", "is_duct"), [(0.5, 2.6, False), (0.1, 2.6, True), (0.5, 1.2, True)])
def test_what_closes_a_doorway_deep_in_a_thick_wall_is_a_leaf(goes_on_m: float, widest_m: float, is_duct: bool) -> None:
    """The wall goes on at both ends of a lintel no wider than doors are; a duct's front does not, or it is wider."""
    front, building = faces(((2.55, 0.5 - goes_on_m), (2.55, 3.0))), BuildingSettings(door_width_max_m=widest_m)
    found = search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, known=front, building=building)
    assert (len(found.walls), len(found.ducts)) == (is_duct, is_duct)
    beside = np.sort(found.known.ends[np.abs(found.known.normal[:, 0]) > 0.9][:, :, 1], axis=1)
    rests = [[0.0, 0.5], [2.0, 3.0]] if goes_on_m > 0.25 else [[2.0, 3.0]]
    np.testing.assert_allclose(beside, rests if is_duct else [[0.0, 3.0]], atol=0.1)


def test_a_refused_face_that_hangs_is_the_front_of_a_soffit() -> None:
    """Its own verdict stays; a refused face that stands on the floor is a cupboard's."""
    front = faces(((2.55, 0.0), (2.55, 3.0)))
    hanging = replace(front, bottom_m=np.array([2.0]))
    found = search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, refused=hanging)
    assert (len(found.walls), len(found.ducts), len(found.known)) == (1, 0, 1)
    np.testing.assert_allclose(found.walls.ends[0, :, 0], 3.0, atol=0.02)
    assert len(search(room_with_a_duct((2.55, 3.0)), seen_m=2.0, refused=front).walls) == 0


def test_on_a_raised_floor_a_ducts_underside_is_as_high_above_it() -> None:
    votes = room_with_a_duct((2.55, 3.0))
    table = VoxelTable(0.05, len(Label))
    for code in Label:
        own = majority(votes.counts) == code
        points = np.repeat(votes.mean_position[own] + [0.0, 0.0, 0.5], 3, axis=0)
        table.add(points, np.full(len(points), code, np.uint8))
    found = search(table.votes(), seen_m=2.0, known=faces(((2.55, 0.5), (2.55, 3.0))))
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


def test_what_hangs_in_a_window_does_not_hide_that_its_wall_goes_on() -> None:
    """A blind 15 cm behind the face is no wall before which a cupboard and a duct stand: the wall is there on both sides."""
    blind, beside = faces(((3.15, 0), (3.15, 3))), faces(((3, 0), (3, 0.4)), ((3, 2.1), (3, 3)))
    votes, seen = room(), {"window_m": (1.3, 2.2)}
    assert len(missed(votes, known=blind, **seen)) == 0
    assert len(missed(votes, known=blind.append(beside.select(np.array([0]))), **seen)) == 0
    walls = missed(votes, known=blind.append(beside), **seen)
    np.testing.assert_allclose(np.sort(walls.ends[:, :, 1]), [[0.5, 2.0]], atol=0.1)


@pytest.mark.parametrize("to_m", [2.2, CEILING_M])
@pytest.mark.parametrize("sill_m", [0.3, 1.2])
@pytest.mark.parametrize("window_y", [(0.9, 1.6), (0.75, 1.75)])
def test_between_two_stretches_of_wall_a_sill_in_line_makes_one_wall_of_them(
    window_y: tuple[float, float], sill_m: float, to_m: float
) -> None:
    """However low, high or wide the window: what stands free of walls is not flush with both its neighbours."""
    window: dict[str, Any] = {"window_m": (sill_m, to_m), "window_y": window_y}
    np.testing.assert_allclose(np.sort(missed(room(), **window).ends[:, :, 1]), [[0.5, 2.0]], atol=0.1)


@pytest.mark.parametrize(("to_m", "seen_to_y", "is_one"), [(2.2, 1.1, True), (CEILING_M, 1.1, False), (CEILING_M, 1.4, True)])
def test_what_hides_a_sill_does_not_part_its_wall(to_m: float, seen_to_y: float, is_one: bool) -> None:
    """A lintel over it shows as well that the wall goes on, or half of the sill."""
    ends = missed(room(), window_m=(1.2, to_m), window_y=(0.9, 1.6), sill_seen_to_y=seen_to_y).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(np.sort(ends), axis=0), [[0.5, 2.0]] if is_one else [[0.5, 0.9], [1.6, 2.0]], atol=0.1)


@pytest.mark.parametrize("to_m", [2.2, CEILING_M])
@pytest.mark.parametrize(
    ("back", "stands_behind"),
    [
        (((3.15, 0), (3.15, 3)), True),
        (((4.2, 0), (4.2, 3)), False),  # the wall of another room
        (((3.15, 2.5), (3.15, 3)), False),  # beside it
    ],
)
def test_what_ends_low_before_a_wall_between_piers_is_a_radiator(
    back: tuple[tuple[float, float], tuple[float, float]], stands_behind: bool, to_m: float
) -> None:
    """It is flush with these; with a lintel over it it is the wall's own sill, whatever stands behind."""
    piers = faces(((3, 0), (3, 0.4)), ((3, 2.1), (3, 3)))
    found = missed(room(), known=piers.append(faces(back)), window_m=(0.7, to_m))
    assert len(found) == (0 if stands_behind and to_m == CEILING_M else 1)


def test_a_window_between_known_walls_may_have_less_than_two_returns_in_each_row() -> None:
    """A scan or two saw its sill and its lintel: they rest on the walls in line with them."""
    beside = faces(((3, 0), (3, 0.4)), ((3, 2.1), (3, 3)))
    walls = missed(room(), known=beside, window_m=(1.2, 2.2), rays=0.045)
    np.testing.assert_allclose(np.sort(walls.ends[:, :, 1]), [[0.5, 2.0]], atol=0.1)


def test_a_slit_between_two_things_is_no_window() -> None:
    slit = missed(room(), window_m=(1.0, CEILING_M), window_y=(1.25, 1.35)).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(np.sort(slit), axis=0), [[0.5, 1.25], [1.35, 2.0]], atol=0.1)


def test_a_jamb_is_more_than_one_column_wide() -> None:
    """A kitchen unit reaches from a wall's end to a corner, where a column of returns is the other wall's."""
    ends = missed(room(), window_m=(0.9, CEILING_M), window_y=(0.9, 1.9)).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(ends), [[0.5, 0.9]], atol=0.1)


@pytest.mark.parametrize(("to_m", "is_one"), [(2.2, True), (CEILING_M, False)])
def test_what_stands_before_a_jamb_may_hide_it_but_for_its_edge(to_m: float, is_one: bool) -> None:
    """Below the window's lintel; a kitchen unit has none."""
    ends = missed(room(), window_m=(0.9, to_m), window_y=(0.9, 1.75), hidden_from_y=1.85).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(ends), [[0.5, 1.85 if is_one else 0.9]], atol=0.1)


@pytest.mark.parametrize(("to_m", "neighbours", "is_one"), [(2.2, 2, True), (2.2, 1, False), (CEILING_M, 2, False)])
def test_a_lintel_between_two_walls_in_line_makes_one_wall_of_them(to_m: float, neighbours: int, is_one: bool) -> None:
    """Below it is glass down to the floor, or a wide passage."""
    beside = faces(((3, 0), (3, 0.4)), ((3, 2.1), (3, 3))).select(np.arange(neighbours))
    found = missed(room(), known=beside, window_m=(0.0, to_m)).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(found), [[0.5, 2.0]] if is_one else np.zeros((0, 2)), atol=0.1)
    # What shows over half of the opening is no lintel.
    assert len(missed(room(), known=beside, window_m=(0.0, to_m), hidden_from_y=1.3)) == 0


def test_between_two_stretches_of_wall_a_doorway_stays_one() -> None:
    doorway = missed(room(), window_m=(0.0, 2.1), window_y=(0.9, 1.6)).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(np.sort(doorway), axis=0), [[0.5, 0.9], [1.6, 2.0]], atol=0.1)
    # With a window beside it, and a lintel over both.
    doorway = missed(room(), window_m=(1.0, 2.1), window_y=(0.75, 1.7), doorway_from_y=1.0).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(np.sort(doorway), axis=0), [[0.5, 0.75], [1.7, 2.0]], atol=0.1)


def test_of_what_nothing_low_is_seen_no_sill_is_known() -> None:
    """A blind behind its wall's face shows above the spandrel alone, which hides what stands below it."""
    ends = missed(room(), unseen_m=1.2, window_m=(1.2, 2.2), window_y=(0.9, 1.6)).ends[:, :, 1]
    np.testing.assert_allclose(np.sort(np.sort(ends), axis=0), [[0.5, 0.9], [1.6, 2.0]], atol=0.1)


def test_what_rays_pass_over_all_along_is_furniture_and_what_hangs_above_it() -> None:
    """A bench or a table below, a duct, a lamp or nothing above: no wall stands beside them."""
    for bottom_m, top_m in [(0.3, 2.1), (0.9, 2.1), (0.9, 2.75)]:
        assert len(missed(room(to_x=3.0), window_m=(bottom_m, top_m))) == 0


def test_a_shelf_and_a_duct_above_it_are_no_wall_however_narrow_the_slit_between_them() -> None:
    assert len(missed(room(), window_m=(2.0, 2.15))) == 0
    # A row of cells is too little: its rays may be off.
    assert len(missed(room(), window_m=(2.0, 2.05))) == 1


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
    found = missed(table, from_y=0.7, window_m=(0.0, CEILING_M), window_y=(0.93, 3.0))
    np.testing.assert_allclose(np.sort(found.ends[0, :, 1]), [0.7, 0.93], atol=0.06)
    assert len(missed(table, from_y=0.7, window_m=(0.0, CEILING_M), window_y=(0.82, 3.0))) == 0


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


def test_furniture_lower_than_the_ceiling_is_no_missed_wall():
    assert len(missed(room(height_m=1.9), passed_above_m=1.9)) == 0


def test_no_wall_is_found_where_the_robot_drove_or_nothing_stands():
    assert len(missed(room(), path_x=3.05)) == 0
    assert len(missed(room(wall=False))) == 0


def test_a_curtain_is_no_missed_wall() -> None:
    assert len(missed(room(), fold_m=0.002)) == 1
    assert len(missed(room(), fold_m=0.03)) == 0


@pytest.mark.parametrize("known_from", [1.3, 0.1])
def test_a_round_wall_is_found_as_chords(known_from: float) -> None:
    """None of them runs in a direction that another wall has; a round thing that is lower is none.

    Of half of one the scans may have seen chords, across which lines run in "walls' directions" through the other half's returns.
    """
    generator = np.random.default_rng(0)
    centre, radius_m = np.array([2.0, 1.4]), 1.2

    def on_arc(angle: np.ndarray) -> np.ndarray:
        return centre + radius_m * np.column_stack([np.cos(angle), np.sin(angle)])

    chords = [on_arc(np.array([angle, angle + 0.2])) for angle in np.arange(known_from, 1.2, 0.2)]

    def found_of(height_m: float) -> Walls:
        angle = generator.uniform(-1.3, 1.3, 6_000)
        arc = on_arc(angle)
        arc = arc + generator.normal(0.0, 0.02, arc.shape)
        points = np.column_stack([arc, generator.uniform(0, height_m, len(arc))])
        votes = merge([room(wall=False), vote(points, np.full(len(points), Label.CLUTTER, np.uint8), len(Label), 0.05)])
        storey = Storey.of(votes, (), LevelsSettings())

        def trace(candidates: Walls) -> TracedFaces:
            columns = [int(np.ceil(np.linalg.norm(e[1] - e[0]) / CELL_M)) for e in candidates.ends]
            first = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
            counts = np.zeros((int(first[-1]), 60, 4), np.float32)
            for w, (ends, normal) in enumerate(zip(candidates.ends, candidates.normal, strict=True)):
                along = np.vstack([ends, ends.mean(axis=0)])
                off_m = np.abs(np.linalg.norm(along - centre, axis=1) - radius_m).max()
                on = off_m < 0.05 and normal @ (centre - ends.mean(axis=0)) > 0
                own = counts[int(first[w]) : int(first[w + 1])]
                top = round(height_m / CELL_M)
                own[:, :top, FILLED if on else THROUGH], own[:, top:56, THROUGH] = 3.0, 3.0
            return TracedFaces.of(candidates, WallCells(first, 60, counts), storey, SETTINGS.ceiling_near_m)

        path = np.column_stack([np.full(50, 0.5), np.linspace(0.2, 2.8, 50)])
        known = faces(((-1, 0), (5, 0)), *chords)
        return find_missed_walls(known, NO_WALLS, AllReturns(votes, storey, path, trace, None), SEARCH).walls

    walls = found_of(CEILING_M)
    np.testing.assert_allclose(np.linalg.norm(walls.ends.mean(axis=1) - centre, axis=1), radius_m, atol=0.05)
    length_m = np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1)
    assert 0.7 < length_m.sum() / ((1.3 + known_from) * radius_m) < 1.1
    assert len(found_of(1.6)) == 0
