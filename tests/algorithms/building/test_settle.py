"""What stands of faces, and what closes their openings, by evidence that is painted."""

import numpy as np
import pytest

from ffmap.algorithms.building.doors import are_passages
from ffmap.algorithms.building.evidence import BEFORE, BEYOND, DEEP, FAR, ON, RECESS, joined
from ffmap.algorithms.building.model import CELL_M, BuildingSettings
from ffmap.algorithms.building.parse import OPENINGS, Kind, ParseSettings
from ffmap.algorithms.building.settle import (
    Opening,
    ParsedFaces,
    Sheet,
    blinds_of,
    doors_of,
    find_openings,
    find_sheet,
    fronts_of,
    glazed_doors_of,
    judge,
    mostly_stands,
    windows_of,
)
from ffmap.algorithms.building.verdicts import FaceVerdict, JudgedFaces
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import faces, traced
from tests.painted import Painted, evidence_of, part, wall

SETTINGS = BuildingSettings()
DOOR, DOOR_M = (2.0, 2.9), (0.0, 2.1)
WINDOW, WINDOW_M = (1.0, 3.0), (0.9, 2.2)


def parsed(face: Painted, ceiling_m: float = 2.8) -> ParsedFaces:
    """Of a face from (0, 0) along x."""
    known = traced(faces(((0.0, 0.0), (face.columns * CELL_M, 0.0))), evidence_of(face), ceiling_m)
    return ParsedFaces.of(known, np.zeros((0, 2)), BuildingSettings(), ParseSettings())


def judged(face: Painted, is_doubtful: bool = False) -> JudgedFaces:
    found, runs = judge(parsed(face), np.array([is_doubtful]), 10.0, SETTINGS)
    assert len(runs) == len(found.walls)
    return found


def opened(face: Painted, ceiling_m: float = 2.8) -> list[Opening]:
    """The openings of one face, into which all rays tell the same as at its cells."""
    found = parsed(face, ceiling_m)
    evidence, stretches = found.faces.evidence, found.stretches[0]
    own = [part(evidence, s.first, s.after) for s in stretches if s.kind in OPENINGS]
    return find_openings(found, lambda _: joined(own, evidence.rows))


def test_a_wall_stands_with_its_doors_and_windows() -> None:
    found = judged(wall(6.0).paint(DOOR, DOOR_M, BEYOND).paint((4.0, 5.0), WINDOW_M, BEYOND))
    np.testing.assert_allclose(found.walls.ends, [[[0.0, 0.0], [6.0, 0.0]]])
    assert len(found.refused) == 0


def test_a_wall_with_windows_all_along_stands_on_its_sill_below_its_lintel() -> None:
    found = judged(wall(2.2).paint((0.0, 2.2), (1.3, 1.95), BEYOND))
    np.testing.assert_allclose(found.walls.ends, [[[0.0, 0.0], [2.2, 0.0]]])


def test_what_hides_a_wall_over_less_than_a_gap_does_not_part_it_and_what_passes_it_does() -> None:
    hidden = judged(wall(6.0).paint((2.0, 2.4), (0.0, 2.8), ON, rays=0.0))
    passed = judged(wall(6.0).paint((2.0, 2.4), (0.0, 2.8), BEYOND))
    assert len(hidden.walls) == 1
    np.testing.assert_allclose(passed.walls.ends[:, :, 0], [[0.0, 2.0], [2.4, 6.0]])


def test_what_ends_low_beside_a_wall_is_refused() -> None:
    found = judged(wall(6.0).paint((4.0, 6.0), (1.1, 2.8), BEYOND))
    np.testing.assert_allclose(found.walls.ends[0, :, 0], [0.0, 4.0])
    np.testing.assert_allclose(found.refused.ends[0, :, 0], [4.0, 6.0])
    assert found.verdict.tolist() == [FaceVerdict.ENDS_LOW]
    wall_, low = found.walls.support, found.refused.support
    assert (wall_.kind[0], low.kind[0], low.second[0]) == (Kind.WALL, Kind.LOW, Kind.WINDOW)
    assert wall_.odds[0] > 10.0 < low.odds[0]
    assert wall_.behind[0] == 0.0 < low.on[0] < low.behind[0]
    assert (wall_.seen[0], low.runs) == (1.0, [(0, 80, 120)])


def test_what_is_open_below_over_all_its_length_hangs() -> None:
    found = judged(wall(6.0).paint((0.0, 6.0), (0.0, 2.1), BEYOND))
    assert len(found.walls) == 0
    assert set(found.verdict) == {FaceVerdict.HANGS}


def test_what_hardly_has_jambs_hangs() -> None:
    """Two columns of wall that go down to the floor are no jambs."""
    for jamb_m, verdicts in ((0.1, {FaceVerdict.HANGS}), (0.5, set())):
        face = wall(2.0).paint((0.0, 2.0 - jamb_m), (0.0, 2.1), BEYOND)
        assert set(judged(face).verdict) == verdicts


def test_a_doubtful_face_has_to_show_itself() -> None:
    for rays, verdicts in ((8.0, []), (0.004, [FaceVerdict.ALONE])):
        face = wall(2.0).paint((0.0, 2.0), (0.0, 2.8), ON, rays)
        assert judged(face, is_doubtful=True).verdict.tolist() == verdicts
        assert len(judged(face).walls) == 1


@pytest.mark.parametrize(
    ("x_m", "top_m", "layer", "kinds"),
    [
        ((1.5, 4.6), 2.3, BEYOND, {Kind.PASSAGE}),  # wider than a pair of leaves
        ((2.0, 3.2), 2.9, BEYOND, {Kind.PASSAGE}),  # higher than a door
        ((2.0, 3.2), 2.1, BEYOND, {Kind.DOORWAY}),
        ((1.5, 4.6), 2.3, DEEP, {Kind.HANGING}),  # closed: a niche
    ],
)
def test_an_opening_larger_than_doors_is_a_passage_where_nothing_closes_it(
    x_m: tuple[float, float], top_m: float, layer: int, kinds: set[Kind]
) -> None:
    face = wall(6.0, 3.2).paint(x_m, (0.0, top_m), layer)
    found = parsed(face, 3.2)
    told, openings = found.with_panes_told(opened(face, 3.2), SETTINGS)
    assert {s.kind for s in told.stretches[0]} == {Kind.WALL} | kinds
    _, runs = judge(told, np.array([False]), 10.0, SETTINGS)
    assert len(runs) == (2 if Kind.HANGING in kinds else 1)
    doors = doors_of(openings, SETTINGS)
    assert are_passages(doors, SETTINGS).tolist() == [
        kind == Kind.PASSAGE for kind in kinds - {Kind.HANGING}
    ]
    for ends in doors.ends:
        np.testing.assert_allclose(ends[:, 0], x_m, atol=1e-6)


def test_what_hangs_beside_no_wall_is_no_passage() -> None:
    face = wall(4.0).paint((1.0, 4.0), (0.0, 2.3), BEYOND)
    told, _ = parsed(face).with_panes_told(opened(face), SETTINGS)
    assert Kind.PASSAGE not in {s.kind for s in told.stretches[0]}


def sheet_in(face: Painted) -> Sheet | None:
    return find_sheet(face.ended[:, 4:40], face.depth_sum[:, 4:40])


def test_a_leaf_is_a_sheet_that_most_rays_end_on() -> None:
    found = sheet_in(Painted(18).paint((0.0, 0.9), DOOR_M, RECESS, before_m=-0.05))
    assert found is not None
    assert (found.behind_m, found.share, found.patches) == pytest.approx((0.05, 1.0, 1.0))


def test_a_pane_returns_few_rays_from_one_depth_all_over() -> None:
    face = Painted(18).paint((0.0, 0.9), DOOR_M, BEYOND, rays=20.0)
    face.ended[..., DEEP], face.depth_sum[..., DEEP] = 1.0, -0.2
    found = sheet_in(face)
    assert found is not None
    assert (found.behind_m, found.patches) == pytest.approx((0.2, 1.0))
    assert found.share == pytest.approx(1 / 21, rel=0.01)


def test_stray_returns_in_an_open_doorway_are_no_pane() -> None:
    face = Painted(18).paint((0.0, 0.9), DOOR_M, BEYOND, rays=20.0)
    assert sheet_in(face) is None
    face.ended[3:5, 10:30:4, DEEP], face.depth_sum[3:5, 10:30:4, DEEP] = 1.0, -0.2
    found = sheet_in(face)
    assert found is not None
    assert found.patches < 0.5


@pytest.mark.parametrize(("layer", "behind_m"), [(BEYOND, np.nan), (RECESS, 0.05), (DEEP, 0.2)])
def test_doors_are_open_or_closed_by_a_leaf(layer: int, behind_m: float) -> None:
    found = opened(wall(5.0).paint(DOOR, DOOR_M, layer, before_m=-behind_m))
    doors = doors_of(found, SETTINGS)
    assert doors.state.tolist() == [DoorState.OPEN if layer == BEYOND else DoorState.CLOSED]
    np.testing.assert_allclose(doors.ends[0, :, 0], DOOR)
    assert doors.head_m[0] == pytest.approx(DOOR_M[1], abs=CELL_M)
    np.testing.assert_allclose(doors.depth_m, behind_m, rtol=1e-5)
    np.testing.assert_allclose([doors.agreement[0], doors.coverage[0], doors.lintel[0]], 1.0)
    assert len(windows_of(found)) == len(glazed_doors_of(found, SETTINGS)) == 0


def test_a_pane_in_a_doorway_is_a_glazed_door_and_a_window() -> None:
    face = wall(5.0).paint(DOOR, DOOR_M, BEYOND, rays=20.0)
    face.ended[40:58, :42, DEEP], face.depth_sum[40:58, :42, DEEP] = 1.0, -0.2
    found = opened(face)
    assert len(doors_of(found, SETTINGS)) == 0
    assert glazed_doors_of(found, SETTINGS).depth_m == pytest.approx(0.2)
    assert windows_of(found).pane_m == pytest.approx(0.2)
    known = windows_of(found).support
    assert (known.sheet_m, known.sheet_patches) == (pytest.approx(0.2), pytest.approx(1.0))
    assert known.sheet_share == pytest.approx(1 / 21, rel=0.01)
    assert known.odds > 0.0
    np.testing.assert_allclose(fronts_of(found).ends[0, :, 1], -0.2, atol=1e-6)


def test_a_frosted_pane_returns_most_rays_and_nothing_else_does() -> None:
    face = wall(5.0).paint(DOOR, (0.5, 2.5), BEYOND, rays=3.0)
    pane = slice(40, 58), slice(10, 50), DEEP
    face.ended[pane], face.depth_sum[pane] = 7.0, 7.0 * -0.2
    found = opened(face)
    assert [own.is_glass for own in found] == [True]
    assert found[0].sheet is not None
    assert found[0].sheet.purity == pytest.approx(1.0)
    assert windows_of(found).pane_m == pytest.approx(0.2)
    # Shelves in a niche return from elsewhere, too.
    before = slice(40, 58), slice(10, 50), RECESS
    face.ended[before], face.depth_sum[before] = 2.0, 2.0 * -0.1
    assert not any(own.is_glass for own in opened(face))


def test_the_purity_of_a_sheet_far_behind_is_a_share() -> None:
    face = Painted(18).paint((0.0, 0.9), DOOR_M, FAR, before_m=-0.6)
    found = sheet_in(face)
    assert found is not None
    assert found.purity == pytest.approx(1.0)


def test_a_wall_as_far_behind_as_depths_are_booked_is_no_pane() -> None:
    """Of its returns a few end in the last layer, and most beyond."""
    face = wall(5.0).paint(DOOR, DOOR_M, BEYOND, rays=20.0)
    face.ended[40:58, :42, FAR], face.depth_sum[40:58, :42, FAR] = 1.0, -0.997
    found = opened(face)
    assert doors_of(found, SETTINGS).state.tolist() == [DoorState.OPEN]
    assert len(windows_of(found)) == len(fronts_of(found)) == 0


def test_windows_have_a_sill_and_blinds_close_their_upper_part() -> None:
    face = wall(5.0).paint(WINDOW, WINDOW_M, BEYOND)
    window = windows_of(opened(face))
    np.testing.assert_allclose(window.ends[0, :, 0], WINDOW)
    assert (window.bottom_m[0], window.top_m[0]) == pytest.approx(WINDOW_M)
    assert len(blinds_of(opened(face))) == 0
    found = opened(face.paint(WINDOW, (1.6, 2.2), RECESS, before_m=-0.08))
    assert windows_of(found).top_m == pytest.approx(1.6)
    blinds = blinds_of(found)
    assert (blinds.bottom_m[0], blinds.top_m[0], blinds.behind_m[0]) == pytest.approx(
        (1.6, 2.2, 0.08)
    )


def test_a_pane_right_before_its_wall_is_a_glazed_sliding_door() -> None:
    face = wall(5.0).paint(DOOR, DOOR_M, BEYOND, rays=20.0)
    face.ended[40:58, :42, BEFORE], face.depth_sum[40:58, :42, BEFORE] = 1.0, 0.055
    found = opened(face)
    assert glazed_doors_of(found, SETTINGS).depth_m == pytest.approx(-0.055)
    assert len(doors_of(found, SETTINGS)) == 0


def test_frames_and_panes_before_a_dark_outside_are_no_blind() -> None:
    face = wall(5.0).paint(WINDOW, WINDOW_M, BEYOND)
    face.paint(WINDOW, (1.6, 2.2), DEEP)
    depth_m = np.random.default_rng(0).uniform(-0.33, -0.13, (40, 12))
    face.depth_sum[20:60, 32:44, DEEP] = 8.0 * depth_m
    found = opened(face)
    assert found[0].stretch.blind < found[0].stretch.head
    assert len(blinds_of(found)) == 0
    assert windows_of(found).top_m == pytest.approx(WINDOW_M[1])


def test_a_part_stands_though_most_of_its_face_does_not() -> None:
    found = parsed(wall(6.0).paint((2.0, 6.0), (0.0, 2.8), BEYOND))
    assert mostly_stands(found, (0, 0, 40))
    assert not mostly_stands(found, (0, 0, 120))
    part = found.part([(0, 0, 40)])
    assert part.stretches == ([s for s in found.stretches[0] if s.after <= 40],)
