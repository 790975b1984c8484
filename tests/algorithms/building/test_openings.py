"""Doors, windows and what is seen through them, on hand-made walls, cells and rays."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.segments import Segment
from ffmap.algorithms.building.closed_doors import closed_door
from ffmap.algorithms.building.deep_openings import tell_deep_openings
from ffmap.algorithms.building.door_frames import DoorFramesSettings, place_frames
from ffmap.algorithms.building.doors import (
    drop_doubtful,
    each_once,
    lower_heads_to_overlights,
    prove_crossed,
)
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WALLS,
    NO_WINDOWS,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
)
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings, is_pane, to_jambs
from ffmap.algorithms.building.ray_evidence import Rays, WallCells, floor_m, trace_rays
from ffmap.algorithms.building.windows import (
    WindowsSettings,
    find_pane_m,
    find_windows,
    is_in_wall,
    join_windows,
    look_deeper,
    rays_through,
    seen_through,
    widened_in_walls,
)
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import Features
from tests.faces import doors_in, faces, traced, window
from tests.tracing import rays_alone

FILLED, SUM, SQUARES, THROUGH = range(4)
SETTINGS = BuildingSettings()
RULES = OpeningRules(SETTINGS, OpeningsSettings())
WALL = replace(faces(((0.0, 0.0), (4.0, 0.0))), normal=np.array([[0.0, -1.0]]))
WALL_1 = WALL.ends[0], WALL.normal[0]
WINDOW = Windows(
    np.array([[[1.0, 0.0], [3.0, 0.0]]]), np.array([[0.0, -1.0]]), np.array([0.9]), np.array([2.0]), np.array([0.05])
)


def cells() -> WallCells:
    """The wall, ten returns on its face in every cell."""
    counts = np.zeros((80, 66, 4), np.float32)
    counts[..., FILLED] = 10.0
    return WallCells(np.array([0, 80]), 66, counts)


def recess(cells: WallCells, low_m: float, high_m: float, depth_m: float) -> None:
    """Between x = 1.5 and 2.4 the returns of these heights lie behind the face."""
    part = cells.counts[30:48, round(low_m / CELL_M) : round(high_m / CELL_M)]
    part[..., SUM] = -depth_m * part[..., FILLED]
    part[..., SQUARES] = depth_m**2 * part[..., FILLED]


def features(origin: tuple[float, float], rays: np.ndarray, planes: np.ndarray) -> Features:
    """One scan with rays (r, 3) and planes (p, 2, 2)."""
    return replace(
        rays_alone(np.array([*origin, 1.0]), rays, np.arange(len(rays)).astype(np.uint8)),
        plane_count=np.array([len(planes)]),
        plane_ends_map=planes,
        plane_normal=np.tile([0.0, -1.0], (len(planes), 1)),
        plane_bottom_m=np.zeros(len(planes)),
        plane_top_m=np.full(len(planes), 2.8),
        plane_lines=np.full(len(planes), 5),
        plane_moments=np.zeros((len(planes), 6)),
    )


@pytest.mark.parametrize(("depth_m", "found"), [(0.012, 0), (0.021, 1), (0.08, 1)])
def test_a_closed_leaf_is_recessed(depth_m: float, found: int) -> None:
    seen = cells()
    recess(seen, 0.0, 2.1, depth_m)
    doors = doors_in(traced(WALL, seen), RULES)
    assert len(doors) == found
    if found:
        assert doors.depth_m[0] == pytest.approx(depth_m, abs=0.005)
        np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


@pytest.mark.parametrize("state", [DoorState.OPEN, DoorState.CLOSED])
@pytest.mark.parametrize(("head_m", "ceiling_m"), [(1.95, 2.8), (2.25, 2.8), (2.5, 2.8), (2.45, 2.6)])
def test_doors_are_found_however_high_their_heads_are(state: DoorState, head_m: float, ceiling_m: float) -> None:
    """Close below a ceiling too, where more rows of the opening than of the wall lie above the usual heads."""
    seen = cells()
    recess(seen, 0.0, head_m, 0.05)
    if state == DoorState.OPEN:
        part = seen.counts[30:48, : round(head_m / CELL_M)]
        part[...], part[..., THROUGH] = 0.0, 10.0
    doors = doors_in(traced(WALL, seen, ceiling_m), RULES)
    assert doors.state.tolist() == [state]
    assert doors.head_m[0] == pytest.approx(head_m, abs=CELL_M)
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_the_underside_of_a_duct_that_touches_the_wall_is_no_lintel() -> None:
    """It has returns at all depths before the face, all along the wall; the lintel shows below it."""
    seen = cells()
    recess(seen, 0.0, 2.0, 0.03)
    underside = seen.counts[:, round(2.2 / CELL_M) : round(2.3 / CELL_M)]
    underside[..., SUM], underside[..., SQUARES] = 0.03 * underside[..., FILLED], 0.0012 * underside[..., FILLED]
    seen.counts[:, round(2.3 / CELL_M) :] = 0.0
    doors = doors_in(traced(WALL, seen, 2.8), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED]
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_a_leaf_goes_on_behind_what_stands_before_it() -> None:
    """A cupboard before a third of a door: its sides return from before the wall's face, and it hides what is behind it."""
    seen = cells()
    recess(seen, 0.0, 2.1, 0.05)
    hidden = seen.counts[38:44, : round(1.0 / CELL_M)]
    hidden[...] = 0.0
    for side in (hidden[0], hidden[-1]):
        side[:, FILLED], side[:, SUM], side[:, SQUARES] = 10.0, 0.3, 0.009
    doors = doors_in(traced(WALL, seen), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED]
    assert doors.depth_m[0] == pytest.approx(0.05, abs=0.005)
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


@pytest.mark.parametrize("forward_m", [0.0, 0.05])
def test_a_cornice_is_no_lintel_of_the_wall_below_it(forward_m: float) -> None:
    """It steps forward along the whole wall, higher than doors are."""
    seen = cells()
    seen.counts[:, round(2.9 / CELL_M) :, SUM] = forward_m * 10.0
    seen.counts[:, round(2.9 / CELL_M) :, SQUARES] = forward_m**2 * 10.0
    recess(seen, 0.0, 2.1, 0.1)
    doors = doors_in(traced(WALL, seen, 3.3), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED]
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


@pytest.mark.parametrize("sill_m", [0.7, 0.35])
def test_a_pane_above_a_flush_parapet_is_no_leaf(sill_m: float) -> None:
    seen = cells()
    recess(seen, sill_m, 2.1, 0.05)
    assert len(doors_in(traced(WALL, seen), RULES)) == 0


def test_a_niche_above_a_parapet_that_stands_back_a_little_is_no_leaf() -> None:
    """A leaf lies as deep at its foot as it does above."""
    seen = cells()
    recess(seen, 0.0, 0.9, 0.02)
    recess(seen, 0.9, 2.1, 0.13)
    assert len(doors_in(traced(WALL, seen), RULES)) == 0


def test_a_recess_up_to_the_ceiling_is_no_door() -> None:
    seen = cells()
    recess(seen, 0.0, 2.8, 0.05)
    assert len(doors_in(traced(WALL, seen), RULES)) == 0


@pytest.mark.parametrize(
    ("pane_m", "heads_m"),
    [((2.4, 2.75), [2.4]), ((2.1, 2.3), [2.1]), ((2.4, 2.5), []), ((2.65, 2.8), []), ((1.5, 1.75), [])],
)
def test_a_leaf_and_the_overlight_above_it_share_a_recess_higher_than_doors(
    pane_m: tuple[float, float], heads_m: list[float]
) -> None:
    """A pane that lies lower is a panel, one that lies higher is no overlight, and a slit no pane: the recess is a niche."""
    seen = cells()
    recess(seen, 0.0, 2.85, 0.07)
    low, high = (round(height_m / CELL_M) for height_m in pane_m)
    seen.counts[32:46, low:high] *= 0.2
    seen.counts[32:46, low:high, THROUGH] = 8.0
    doors = doors_in(traced(WALL, seen, 3.2), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED] * len(heads_m)
    np.testing.assert_allclose(doors.head_m, heads_m, atol=CELL_M)
    seen.counts[32:46, low:high] *= 0.01
    assert not len(doors_in(traced(WALL, seen, 3.2), RULES))  # some strays


@pytest.mark.parametrize(("low_m", "walls", "found"), [(2.1, 2, 1), (2.1, 1, 0), (1.0, 2, 0)])
def test_a_leaf_below_an_overlight_up_to_the_ceiling_has_its_wall_on_both_sides(low_m: float, walls: int, found: int) -> None:
    """What the pane returns is no lintel; a pane that begins lower is a window above a parapet that stands back."""
    seen = cells()
    recess(seen, 0.0, 3.0, 0.03)
    pane = seen.counts[30:48, round(low_m / CELL_M) : 58]
    pane[...] = (2.0, -2.0 * 0.06, 2.0 * 0.06**2, 8.0)
    if walls == 1:
        seen.counts[:30] = 0.0
    doors = doors_in(traced(WALL, seen, 3.0), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED] * found
    if found:
        assert doors.depth_m[0] == pytest.approx(0.03, abs=0.005)
        assert doors.head_m[0] == pytest.approx(low_m, abs=CELL_M)
        np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_above_a_fitted_cupboard_is_no_overlight() -> None:
    """Its upper edge takes a part of a row, which returns some of the rays."""
    seen = cells()
    recess(seen, 0.0, 3.0, 0.03)
    seen.counts[30:48, 40] = (4.0, -4.0 * 0.03, 4.0 * 0.03**2, 6.0)
    seen.counts[30:48, 41:60] = (0.0, 0.0, 0.0, 10.0)
    assert not len(doors_in(traced(WALL, seen, 3.0), RULES))


def test_a_window_above_a_leaf_is_its_overlight() -> None:
    """It is no pane of the door's, whose head lies below it though both stand in one recess."""
    seen = cells()
    recess(seen, 0.0, 2.6, 0.03)
    overlight = replace(WINDOW, ends=np.array([[[1.5, 0.0], [2.4, 0.0]]]), bottom_m=np.array([2.2]), top_m=np.array([2.6]))
    doors = doors_in(traced(WALL, seen, 3.2), RULES, overlight)
    assert doors.head_m[0] == pytest.approx(2.6, abs=CELL_M)
    assert lower_heads_to_overlights(doors, overlight, RULES).head_m.tolist() == [2.2]
    # Neither a window beside the door nor one lower than heads are, and no open doorway's head, which its lintel shows.
    for other in (replace(overlight, ends=overlight.ends + np.array([1.0, 0.0])), replace(overlight, bottom_m=np.array([1.2]))):
        np.testing.assert_array_equal(lower_heads_to_overlights(doors, other, RULES).head_m, doors.head_m)
    opened = replace(doors, state=np.array([DoorState.OPEN], np.uint8))
    np.testing.assert_array_equal(lower_heads_to_overlights(opened, overlight, RULES).head_m, doors.head_m)
    assert not len(doors_in(traced(WALL, seen, 3.2), RULES, replace(overlight, bottom_m=np.array([1.2]))))


def test_a_low_ceiling_before_a_part_of_a_wall_is_no_lintel() -> None:
    """Its own returns come forward from the face, and what is below them seems to recede."""
    seen = cells()
    ceiling = seen.counts[34:76, round(2.5 / CELL_M) : round(2.6 / CELL_M)]
    ceiling[..., SUM] = 0.05 * ceiling[..., FILLED]
    # Above it nothing of the wall is seen from here; at its end another wall's returns come forward too.
    seen.counts[34:76, round(2.6 / CELL_M) :] = 0.0
    seen.counts[76:, :, SUM] = 0.025 * seen.counts[76:, :, FILLED]
    clear_m = np.full(80, 2.8)
    assert len(doors_in(traced(WALL, seen, clear_m), RULES)) == 1
    clear_m[34:] = 2.5
    assert len(doors_in(traced(WALL, seen, clear_m), RULES)) == 0


def test_the_other_side_of_a_lintel_that_a_duct_hides_does_not_hide_the_doorway() -> None:
    """Below the duct 10 cm of the lintel show; above, the wall is 5 cm thick, and its other face is seen from the room behind."""
    seen = cells()
    recess(seen, 2.15, 2.4, 0.05)
    part = seen.counts[30:48, : round(2.05 / CELL_M)]
    part[...], part[..., THROUGH] = 0.0, 10.0
    seen.counts[:, round(2.4 / CELL_M) :] = 0.0
    doors = doors_in(traced(WALL, seen, 2.8), RULES)
    assert doors.state.tolist() == [DoorState.OPEN]
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


@pytest.mark.parametrize("state", [DoorState.OPEN, DoorState.CLOSED])
def test_a_duct_may_hide_a_lintel_if_the_wall_stands_on_both_sides(state: DoorState) -> None:
    seen = cells()
    seen.counts[:, round(2.05 / CELL_M) :] = 0.0
    recess(seen, 0.0, 2.05, 0.05)
    if state == DoorState.OPEN:
        part = seen.counts[30:48, : round(2.05 / CELL_M)]
        part[...], part[..., THROUGH] = 0.0, 10.0
    clear_m = np.full(80, 2.8)
    doors = doors_in(traced(WALL, seen, clear_m), RULES)
    assert doors.state.tolist() == [state]
    assert doors.lintel.tolist() == [0.0]
    assert doors.head_m[0] == pytest.approx(2.05, abs=CELL_M)
    # An alcove up to the ceiling is seen to be none, and a recess in a corner may be the corner.
    high = WallCells(seen.first, seen.rows, seen.counts.copy())
    high.counts[30:48, round(2.05 / CELL_M) : round(2.7 / CELL_M), THROUGH] = 10.0
    assert len(doors_in(traced(WALL, high, clear_m), RULES)) == 0
    seen.counts[48:] = 0.0
    assert len(doors_in(traced(WALL, seen, clear_m), RULES)) == 0


def test_a_leaf_that_stands_aslant_is_ajar() -> None:
    def leaf(free_edge_m: float) -> Doors:
        seen = cells()
        depth_m = np.linspace(0.03, 0.03 + free_edge_m, 18)[:, None]
        part = seen.counts[30:48, : round(2.1 / CELL_M)]
        part[..., SUM], part[..., SQUARES] = -depth_m * part[..., FILLED], depth_m**2 * part[..., FILLED]
        return doors_in(traced(WALL, seen), RULES)

    assert leaf(0.05).state.tolist() == [DoorState.CLOSED]
    assert leaf(0.05).ajar.tolist() == [False]
    ajar = leaf(0.25)
    assert ajar.state.tolist() == [DoorState.OPEN]
    assert ajar.ajar.tolist() == [True]
    assert ajar.lintel.tolist() == [1.0]
    assert np.isnan(ajar.depth_m[0])
    np.testing.assert_allclose(ajar.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_a_deep_leaf_is_not_ajar_though_columns_at_its_jamb_hold_the_reveal_too() -> None:
    seen = cells()
    depth_m = np.full((18, 1), 0.2)
    depth_m[:3] = 0.03
    part = seen.counts[30:48, : round(2.1 / CELL_M)]
    part[..., SUM], part[..., SQUARES] = -depth_m * part[..., FILLED], depth_m**2 * part[..., FILLED]
    doors = doors_in(traced(WALL, seen), RULES)
    assert doors.state.tolist() == [DoorState.CLOSED]
    np.testing.assert_allclose(doors.depth_m, 0.2, atol=0.01)


@pytest.mark.parametrize("leaves", [1, 2])
def test_a_leaf_ajar_is_part_of_its_doorway(leaves: int) -> None:
    """Near its hinge it is as near to the face as a closed one, and it leaves few columns open."""
    seen = cells()
    rows = slice(0, round(2.1 / CELL_M))
    depth_m = np.linspace(0.03, 0.4, 15)
    # One leaf covers x = 1.5 to 2.25 of a doorway to 2.55, two cover 1.5 to 2.25 and 2.55 to 3.3.
    columns = [np.arange(30, 45)] if leaves == 1 else [np.arange(30, 45), np.arange(65, 50, -1)]
    opened = np.arange(45, 51)
    for leaf in columns:
        for column, behind_m in zip(leaf, depth_m, strict=True):
            cell = seen.counts[column, rows]
            if behind_m < SETTINGS.near_m:
                cell[:, SUM], cell[:, SQUARES] = -10.0 * behind_m, 10.0 * behind_m**2
            else:
                cell[:], cell[:, THROUGH] = 0.0, 10.0
    seen.counts[opened, rows] = np.array([0.0, 0.0, 0.0, 10.0])
    doors = each_once(doors_in(traced(WALL, seen), RULES), RULES)
    assert doors.state.tolist() == [DoorState.OPEN]
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.55 if leaves == 1 else 3.3], atol=2 * CELL_M)
    assert doors.confidence[0] > 0.6


@pytest.mark.parametrize(("set_back_m", "door_m"), [(1.9, (1.9, 3.0)), (1.4, (0.5, 3.0)), (1.0, (0.9, 3.0))])
def test_a_wall_set_back_beside_a_doorway_is_no_leaf(set_back_m: float, door_m: tuple[float, float]) -> None:
    """A leaf ends at its jamb: what lies behind the face over more than its width is wall, and the reveal lies behind that."""
    below, column = np.zeros((80, 4)), np.arange(80) * CELL_M + 0.5 * CELL_M
    below[:, FILLED] = 10.0
    below[(column > 1.9 - set_back_m) & (column < 1.9), SUM] = -0.04 * 10.0
    below[(column > 1.9) & (column < 2.0), SUM] = -0.15 * 10.0
    below[(column > 2.0) & (column < 3.0)] = [0.0, 0.0, 0.0, 10.0]
    first, last = to_jambs(below, 40, 59, RULES.openings.leaf_max_m)
    assert (first * CELL_M, (last + 1) * CELL_M) == pytest.approx(door_m)
    assert to_jambs(below[::-1], 20, 39, RULES.openings.leaf_max_m) == (79 - last, 79 - first)


def test_a_leaf_at_the_edge_of_what_is_looked_at_is_no_pane() -> None:
    def opening(sheet_m: float) -> int:
        """A narrow opening, of whose rays some return from behind the face."""
        seen = cells()
        part = seen.counts[30:36, : round(2.1 / CELL_M)]
        part[..., THROUGH], part[..., FILLED] = 10.0, 1.0
        part[..., SUM], part[..., SQUARES] = -sheet_m, sheet_m**2
        return len(find_windows(traced(WALL, seen), RULES, WindowsSettings()))

    assert opening(0.1) == 1
    assert opening(0.34) == 0


def test_a_door_has_its_wall_beside_it() -> None:
    seen = cells()
    recess(seen, 0.0, 2.1, 0.05)
    # A cupboard's front below a board that stands out: nothing beside it is flush with the board.
    for beside in (slice(0, 30), slice(48, 80)):
        seen.counts[beside] = 0.0
        seen.counts[beside, 1:36, THROUGH] = 10.0
    assert len(doors_in(traced(WALL, seen), RULES)) == 0
    # In a corner there is wall on one side only.
    seen.counts[48:51] = 0.0
    seen.counts[48:51, :, FILLED] = 10.0
    assert len(doors_in(traced(WALL, seen), RULES)) == 1


def opening(seen: WallCells) -> None:
    """Between x = 1.5 and 2.4 rays pass up to 2.1 m."""
    part = seen.counts[30:48, 0:42]
    part[...], part[..., THROUGH] = 0.0, 50.0


def test_what_hangs_behind_a_lintel_does_not_hide_its_door() -> None:
    seen = cells()
    opening(seen)
    # From close by, rays under the lintel rise to a duct behind it: as many returns as from the lintel itself.
    duct = seen.counts[30:48, 46:51]
    duct[..., FILLED], duct[..., SUM], duct[..., SQUARES] = 20.0, -10 * 0.3, 10 * 0.3**2
    doors = doors_in(traced(WALL, seen), RULES)
    assert doors.state.tolist() == [DoorState.OPEN]
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_a_doorway_is_taken_from_the_face_that_shows_all_of_it() -> None:
    """The nearer face, seen better, ends within the doorway."""
    walls = Walls(
        np.array([[[0.0, 0.0], [2.15, 0.0]], [[4.0, 0.1], [0.0, 0.1]]]),
        np.array([[0.0, -1.0], [0.0, 1.0]]),
        np.zeros(2),
        np.full(2, 2.8),
        np.full(2, 9, np.int32),
        np.full(2, 0.01),
        np.full(2, 900),
    )
    seen = cells()
    opening(seen)
    both = np.concatenate([3.0 * seen.counts[:43], seen.counts[::-1]])
    seen_twice = doors_in(traced(walls, WallCells(np.array([0, 43, 123]), 66, both)), RULES)
    assert len(seen_twice) == 2
    doors = each_once(seen_twice, RULES)
    assert len(doors) == 1
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.5, 2.4], atol=2 * CELL_M)


@pytest.mark.parametrize(
    ("far_y", "aside_m", "looks", "doors"),
    [
        (0.2, 0.0, 1.0, 1),
        (0.85, 0.0, 1.0, 1),
        (0.85, 0.4, 1.0, 1),
        (0.85, 0.8, 1.0, 2),  # beside it
        (1.3, 0.0, 1.0, 2),  # a corridor lies between
        (-0.85, 0.0, 1.0, 2),  # across a corridor
        (0.85, 0.0, -1.0, 2),  # one behind the other
    ],
)
def test_a_doorway_in_a_thick_wall_is_one_door(far_y: float, aside_m: float, looks: float, doors: int) -> None:
    near = closed_door(Segment.between(*WALL_1), (20.0, 38.0), cells().counts, 2.1, 0.0, wall=0)
    far = replace(near, ends=near.ends[:, ::-1] + [aside_m, far_y], normal=np.array([[0.0, looks]]))
    found = each_once(replace(near.append(far), scan_count=np.full(2, 99, np.int32)), RULES)
    assert len(found) == doors
    assert found.reveal_m[0] == pytest.approx(far_y if doors == 1 else np.nan, nan_ok=True)


def test_a_door_that_is_doubtful_in_one_face_hides_none_that_is_sure_in_the_other() -> None:
    """The recess of a leaf, seen by no scan from nearby, and its casing on the wall's other side."""
    recessed = closed_door(Segment.between(*WALL_1), (20.0, 38.0), cells().counts, 2.1, 0.0, wall=0)
    cased = replace(recessed, ends=recessed.ends[:, ::-1] + [0.05, 0.1], normal=-recessed.normal, casing_m=np.array([0.012]))
    seen = replace(recessed.append(cased), scan_count=np.array([0, 99], np.int32))
    assert each_once(seen, RULES).casing_m.tolist() == [0.012]
    assert len(each_once(replace(seen, scan_count=np.full(2, 99, np.int32)), RULES)) == 1


def test_a_window_behind_a_desk_is_no_doorway() -> None:
    seen = cells()
    opening(seen)
    seen.counts[30:48, 0:14] = 0.0  # the desk hides the wall below the pane
    assert len(doors_in(traced(WALL, seen), RULES)) == 0


def test_floor_and_ceiling_behind_an_opening_passed_its_face() -> None:
    rays = np.array([[2.0, 0.2, 0.0], [2.0, 0.2, 0.0], [2.0, 0.2, 0.0], [2.0, 0.0, 0.5]])
    scan = replace(features((2.0, -0.8), rays, np.zeros((0, 2, 2))), ray_label=np.array([1, 2, 0, 1], np.uint8))
    seen = trace_rays(WALL, [scan], SETTINGS).counts
    # The first two crossed the face 0.2 m above the floor; the third may be a leaf's foot, the last is on the face.
    assert seen[40, 4].tolist() == [0.0, 0.0, 0.0, 2.0]
    assert seen[40, 0].tolist() == pytest.approx([1.0, -0.2, 0.04, 0.0])
    assert seen[40, 10, FILLED] == 1.0
    assert seen[..., FILLED].sum() + seen[..., THROUGH].sum() == 4.0


@pytest.mark.parametrize(("before_m", "near", "far"), [(10.0, 1, 1), (15.0, 0, 1), (30.0, 0, 0)])
def test_rays_count_from_so_far_as_they_tell(before_m: float, near: int, far: int) -> None:
    scan = features((2.0, -before_m), np.array([[2.0, 0.0, 1.0]]), np.zeros((0, 2, 2)))
    for range_m, counted in ((SETTINGS.range_m, near), (SETTINGS.far_m, far)):
        seen = trace_rays(WALL, [scan], SETTINGS.model_copy(update={"range_m": range_m}))
        assert seen.counts[..., FILLED].sum() == counted


def test_an_open_door_is_found_though_its_jambs_are_hidden() -> None:
    seen = cells()
    opening(seen)
    # Seen through another door: of the wall beside, only what is above shows.
    seen.counts[:30, :42] = seen.counts[48:, :42] = 0.0
    assert len(doors_in(traced(WALL, seen), RULES)) == 1
    # Where the wall beside is seen to stand back, or to be passed, the opening is no doorway.
    for beside in (seen.counts[:30, :42], seen.counts[48:, :42]):
        beside[..., FILLED], beside[..., SUM] = 10.0, -10 * 0.045
    assert len(doors_in(traced(WALL, seen), RULES)) == 0


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_doorway_reaches_to_the_jamb_that_its_leaf_hides(mirrored: bool) -> None:
    """The leaf stands ajar towards the robot: near its hinge it shows before the wall, beyond that no ray comes."""
    seen = cells()
    opening(seen)
    near, far = seen.counts[30:34, 0:42], seen.counts[34:42, 0:42]
    near[..., FILLED], near[..., SUM], near[..., SQUARES], near[..., THROUGH] = 10.0, 10 * 0.05, 10 * 0.05**2, 0.0
    far[...] = 0.0
    if mirrored:
        seen.counts[...] = seen.counts[::-1].copy()
    doors = doors_in(traced(WALL, seen), RULES)
    assert doors.state.tolist() == [DoorState.OPEN]
    expected = [1.6, 2.5] if mirrored else [1.5, 2.4]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), expected, atol=2 * CELL_M)
    # Where that has no end, or the wall above has, nothing tells where the jamb is.
    for rows in (slice(0, 42), slice(42, 66)):
        doubtful = WallCells(seen.first, 66, seen.counts.copy())
        beside = doubtful.counts[42:] if mirrored else doubtful.counts[:38]
        beside[:, rows] = 0.0
        assert len(doors_in(traced(WALL, doubtful), RULES)) == 0


@pytest.mark.parametrize("head_m", [2.4, 3.0])
def test_an_open_passage_may_be_higher_than_doors(head_m: float) -> None:
    seen = cells()
    part = seen.counts[30:48, : round(head_m / CELL_M)]
    part[...], part[..., THROUGH] = 0.0, 10.0
    passage = doors_in(traced(WALL, seen, 3.3), RULES)
    assert passage.state.tolist() == [DoorState.OPEN]
    assert passage.head_m[0] == pytest.approx(head_m, abs=CELL_M)


@pytest.mark.filterwarnings("error")
def test_a_face_that_is_passed_over_all_its_length_has_no_door() -> None:
    narrow = replace(WALL, ends=np.array([[[1.5, 0.0], [2.4, 0.0]]]))
    seen = cells()
    opening(seen)
    alone = WallCells(np.array([0, 18]), 66, seen.counts[30:48].copy())
    assert len(doors_in(traced(narrow, alone), RULES)) == 0


def test_a_wide_opening_beside_a_cupboard_is_as_wide_as_it_is() -> None:
    seen = cells()
    opening(seen)
    seen.counts[48:60, 0:42] = 0.0  # behind the cupboard
    doors = doors_in(traced(WALL, seen), RULES)
    np.testing.assert_allclose(doors.ends[0, :, 0], [1.5, 2.4], atol=2 * CELL_M)


def test_where_a_window_is_there_is_no_door() -> None:
    seen = cells()
    opening(seen)
    assert len(doors_in(traced(WALL, seen), RULES)) == 1
    assert len(doors_in(traced(WALL, seen), RULES, WINDOW)) == 0
    # Seen from the other side of its wall it is a window as well; in another wall it is another's.
    assert len(doors_in(traced(WALL, seen), RULES, replace(WINDOW, normal=-WINDOW.normal))) == 0
    assert (
        len(doors_in(traced(WALL, seen), RULES, replace(WINDOW, ends=WINDOW.ends + np.array([0.0, 0.5])))) == 1
    )


def test_a_pane_down_to_the_floor_shows_though_more_stands_behind_it() -> None:
    seen = cells()
    opening(seen)
    part = seen.counts[30:48, 0:42]
    part[..., FILLED], part[..., SUM], part[..., SQUARES] = 2.0, -0.16, 2 * 0.08**2
    # A cupboard stands 20 cm behind the pane, over half of it.
    behind = part[9:, 3:]
    behind[..., FILLED] += 4.0
    behind[..., SUM] -= 4 * 0.28
    behind[..., SQUARES] += 4 * 0.28**2
    assert len(doors_in(traced(WALL, seen), RULES)) == 0
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    assert windows.pane_m.tolist() == pytest.approx([0.08], abs=0.005)
    # What shows in two columns alone is the edge of a leaf, and the opening a door.
    part[..., :THROUGH] = 0.0
    part[4:6, 3:, FILLED], part[4:6, 3:, SUM], part[4:6, 3:, SQUARES] = 30.0, -30 * 0.2, 30 * 0.2**2
    assert len(doors_in(traced(WALL, seen), RULES)) == 1


def test_a_pane_shows_beside_what_stands_close_behind_it() -> None:
    """A sideboard behind a third of a glazed wall returns more than all of the pane, from one depth too."""
    glazed = np.zeros((60, 66, 4))
    glazed[..., THROUGH] = 10.0
    glazed[..., FILLED], glazed[..., SUM], glazed[..., SQUARES] = 1.0, -0.03, 0.03**2
    glazed[:20, :18] = [40.0, -40 * 0.2, 40 * 0.2**2, 0.0]
    assert is_pane(glazed, RULES)
    # Without the pane it is an opening before which a sideboard stands.
    empty = glazed.copy()
    empty[20:, :, :THROUGH], empty[:20, 18:, :THROUGH] = 0.0, 0.0
    assert not is_pane(empty, RULES)


def test_a_wide_pane_shows_though_its_face_is_not_quite_in_line_with_it() -> None:
    """The face of the beam above 5 m of glass runs from 5 to 25 cm before the pane; a rack there has depth all along."""
    depth_m = np.linspace(0.05, 0.25, 100)[:, None]
    glazed = np.zeros((100, 66, 4))
    glazed[..., THROUGH], glazed[..., FILLED] = 10.0, 1.0
    glazed[..., SUM], glazed[..., SQUARES] = -depth_m, depth_m**2
    assert is_pane(glazed, RULES)
    glazed[::2, :, SUM] -= 0.08
    glazed[::4, :, SUM] -= 0.12
    assert not is_pane(glazed, RULES)


def test_the_wall_behind_what_hangs_before_it_is_no_pane() -> None:
    """Both lie on one sheet; a pane lets rays pass, though glass that is met straight on may return most of them."""
    behind = np.zeros((100, 66, 4))
    behind[..., FILLED], behind[..., SUM], behind[..., SQUARES] = 10.0, -10 * 0.2, 10 * 0.2**2
    behind[..., THROUGH] = 0.2
    assert not is_pane(behind, RULES)
    behind[..., THROUGH] = 2.0
    assert is_pane(behind, RULES)


def test_a_window_is_as_wide_as_it_is_though_its_sill_is_hidden() -> None:
    seen = cells()
    seen.counts[20:60, 18:44, FILLED], seen.counts[20:60, 18:44, THROUGH] = 0.0, 50.0
    # A desk stands before most of it: no ray reaches the wall below, and none passes there.
    seen.counts[26:56, 0:18] = 0.0
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, 3.0]], atol=2 * CELL_M)
    # Where nothing of a sill is seen, it may be a doorway that is blocked.
    seen.counts[18:62, 0:18] = 0.0
    assert len(find_windows(traced(WALL, seen), RULES, WindowsSettings())) == 0
    # But no doorway is as high as that.
    seen.counts[20:60, 44:54, FILLED], seen.counts[20:60, 44:54, THROUGH] = 0.0, 50.0
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, 3.0]], atol=2 * CELL_M)


def test_a_windows_pane_is_placed_by_what_it_returns() -> None:
    seen = cells()
    seen.counts[20:60, 18:44, FILLED], seen.counts[20:60, 18:44, THROUGH] = 0.0, 50.0
    assert np.isnan(find_windows(traced(WALL, seen), RULES, WindowsSettings()).pane_m).all()
    pane = seen.counts[20:60, 18:44]
    pane[..., FILLED], pane[..., SUM], pane[..., SQUARES] = 1.0, -0.06, 0.06**2
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    assert windows.pane_m.tolist() == pytest.approx([0.06], abs=0.002)
    np.testing.assert_allclose(windows.ends[0, :, 0], [1.0, 3.0], atol=2 * CELL_M)
    np.testing.assert_allclose([windows.bottom_m[0], windows.top_m[0]], [0.9, 2.2], atol=CELL_M)


@pytest.mark.parametrize(
    ("pane_m", "returned", "found_m"), [(0.36, 0.1, 0.36), (0.45, 0.5, 0.45), (0.45, 0.95, None), (0.9, 0.1, None)]
)
def test_the_pane_of_a_deep_niche_is_looked_for_behind_the_walls_face(
    pane_m: float, returned: float, found_m: float | None
) -> None:
    """Where nothing passes it, it is no pane but what stands there, and no wall is so thick as the deepest."""
    generator = np.random.default_rng(5)
    aim = np.column_stack([generator.uniform(1.0, 3.0, 4000), np.full(4000, pane_m), generator.uniform(0.9, 2.2, 4000)])
    ray = aim - [2.0, -2.0, 1.0]
    way = np.where(generator.random(4000) < returned, 1.0, 8.0)
    seen = features((2.0, -2.0), [2.0, -2.0, 1.0] + way[:, None] * ray, np.zeros((0, 2, 2)))
    seen = replace(seen, ray_label=np.full(4000, Label.CLUTTER, np.uint8))
    windows = replace(WINDOW, pane_m=np.array([np.nan])).append(WINDOW)
    asked: list[int] = []

    def trace(faces: Walls) -> WallCells:
        asked.append(len(faces))
        return trace_rays(faces, [seen], SETTINGS)

    deeper = look_deeper(windows, trace, RULES, WindowsSettings())
    assert deeper.pane_m[0] == pytest.approx(np.nan if found_m is None else found_m, abs=0.01, nan_ok=True)
    assert deeper.pane_m[1] == WINDOW.pane_m[0]
    assert look_deeper(WINDOW, trace, RULES, WindowsSettings()) is WINDOW
    assert asked == [1]  # those of which nothing is known alone


def below_a_blind(head_m: float, pane: bool = True) -> WallCells:
    """From 1 to 3 m rays pass from the floor up to `head_m`, where a flush blind closes the rest."""
    seen = cells()
    glass = seen.counts[20:60, : round(head_m / CELL_M)]
    glass[...], glass[..., THROUGH] = 0.0, 20.0
    if pane:
        glass[..., FILLED], glass[..., SUM], glass[..., SQUARES] = 1.0, -0.08, 0.08**2
    return seen


@pytest.mark.parametrize("head_m", [0.6, 1.2])
def test_glass_down_to_the_floor_shows_below_a_blind(head_m: float) -> None:
    seen = below_a_blind(head_m)
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, 3.0]], atol=2 * CELL_M)
    assert windows.top_m.tolist() == pytest.approx([head_m], abs=CELL_M)
    assert windows.pane_m.tolist() == pytest.approx([0.08], abs=0.005)
    assert not len(doors_in(traced(WALL, seen), RULES, windows))
    # Below what hangs on a wall nothing returns.
    seen = below_a_blind(head_m, pane=False)
    assert not len(find_windows(traced(WALL, seen), RULES, WindowsSettings()))


def test_glass_below_a_blind_ends_at_the_doorway_beside_it() -> None:
    """The sweeps that meet the wall above a doorway do not meet what closes it, for nothing does."""
    for doorway in (slice(40, 60), slice(48, 62)):
        seen = below_a_blind(1.2)
        seen.counts[60:] = cells().counts[60:]
        seen.counts[doorway, :42] = [0.0, 0.0, 0.0, 50.0]
        windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
        np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, doorway.start * CELL_M]], atol=2 * CELL_M)


def test_glass_below_a_blind_is_as_wide_as_it_is_however_low() -> None:
    """No wall shows in so few rows, be it there or not."""
    seen = cells()
    seen.counts[20:60, 2:5] = [1.0, -0.08, 0.08**2, 50.0]
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, 3.0]], atol=2 * CELL_M)


def test_beside_a_doorways_jamb_is_no_glass() -> None:
    """Where some rays pass and others end on the reveal, which lies on a sheet too."""
    seen = cells()
    opening(seen)  # from 1.5 to 2.4 m
    seen.counts[27:30, :32] = [20.0, -20 * 0.16, 20 * 0.16**2, 25.0]
    assert not len(find_windows(traced(WALL, seen), RULES, WindowsSettings()))
    assert len(doors_in(traced(WALL, seen), RULES)) == 1


def glazed_wall(silent: tuple[float, float], sill_m: float = 0.0) -> WallCells:
    """Between x = 0.3 and 3.7 glass from a sill up to 2.5 m, from which nothing returns between two other places."""
    seen = cells()
    seen.counts[6:74, round(sill_m / CELL_M) : 50] = [1.0, -0.06, 0.06**2, 50.0]
    seen.counts[round(silent[0] / CELL_M) : round(silent[1] / CELL_M), round(sill_m / CELL_M) : 50] = [0.0, 0.0, 0.0, 50.0]
    return seen


@pytest.mark.parametrize(
    ("silent", "sill_m", "panes"),
    [
        ((1.5, 2.5), 0.0, [0.3, 1.5, 2.5, 3.7]),
        ((1.5, 1.5), 0.0, [0.3, 3.7]),
        ((1.8, 2.2), 0.0, [0.3, 3.7]),  # no door is so narrow
        ((1.5, 2.5), 0.4, [0.3, 3.7]),  # above a sill it is an open sash
    ],
)
def test_an_open_doorway_in_a_glazed_wall_parts_its_panes(
    silent: tuple[float, float], sill_m: float, panes: list[float]
) -> None:
    """Most of what is open is glass, but in the doorway nothing returns."""
    seen = glazed_wall(silent, sill_m)
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0], axis=None), panes, atol=2 * CELL_M)
    # What a window lets pass is no door's.
    for ends in np.round(windows.ends[:, :, 0] / CELL_M).astype(int):
        seen.counts[ends.min() : ends.max(), :50] = 0.0
    doors = doors_in(traced(WALL, seen), RULES, windows)
    np.testing.assert_allclose(doors.ends[:, :, 0], [panes[1:3]] if len(panes) > 2 else np.zeros((0, 2)), atol=2 * CELL_M)


def test_what_stands_in_a_doorway_of_a_glazed_wall_does_not_hide_it() -> None:
    seen = glazed_wall((1.5, 2.5))
    seen.counts[40, 20:24] = [2.0, -0.06, 0.06**2, 40.0]
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0], axis=None), [0.3, 1.5, 2.5, 3.7], atol=2 * CELL_M)


def test_a_sliver_beside_a_doorway_of_a_glazed_wall_is_no_pane() -> None:
    seen = glazed_wall((0.45, 1.4))
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0], axis=None), [1.4, 3.7], atol=2 * CELL_M)


def test_a_wide_silent_part_of_a_glazed_wall_is_no_doorway() -> None:
    """No door is 2.8 m wide: its glass was met aslant."""
    wall = replace(WALL, ends=np.array([[[0.0, 0.0], [8.0, 0.0]]]))
    counts = np.concatenate([cells().counts, cells().counts])
    counts[6:154, :50], counts[60:116, :50] = [1.0, -0.06, 0.06**2, 50.0], [0.0, 0.0, 0.0, 50.0]
    seen = WallCells(np.array([0, 160]), 66, counts)
    windows = find_windows(traced(wall, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0], axis=None), [0.3, 7.7], atol=2 * CELL_M)


BEAMS_BACK = replace(faces(((0.0, 0.3), (1.5, 0.3))), normal=np.array([[0.0, 1.0]]))
WALLS_BACK = replace(faces(((0.0, 0.3), (2.5, 0.3))), normal=np.array([[0.0, 1.0]]))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(
    ("other", "is_jamb"),
    [
        (faces(((1.5, 0.3), (1.5, 2.0))), True),
        (faces(((1.0, 0.1), (1.0, 2.0))), False),
        (BEAMS_BACK, False),
        (WALLS_BACK, True),
        (window((1.6, 0.1), (3.0, 0.1)), True),
        (NO_WALLS, False),
    ],
)
def test_an_open_doorway_at_a_faces_end_has_another_face_or_a_pane_there(
    other: Walls | Windows, is_jamb: bool, mirrored: bool
) -> None:
    """A beam from a pillar ends where scans saw no more of it."""
    seen, walls, windows = beside_a_pillar([0.0, 0.0, 0.0, 10.0], other, mirrored)
    doors = doors_in(traced(walls, seen), RULES, windows)
    assert doors.select(doors.wall == 0).state.tolist() == ([DoorState.OPEN] if is_jamb else [])


def test_a_leaf_at_a_faces_end_needs_no_wall_there() -> None:
    closed, walls, windows = beside_a_pillar([10.0, -0.5, 0.025, 0.0], NO_WALLS, False)
    assert doors_in(traced(walls, closed), RULES, windows).state.tolist() == [DoorState.CLOSED]
    ajar, walls, windows = beside_a_pillar([10.0, -0.5, 0.025, 0.0], NO_WALLS, False)
    slant_m = np.linspace(0.02, 0.2, 20)[:, None]
    ajar.counts[10:, :46, SUM], ajar.counts[10:, :46, SQUARES] = -10.0 * slant_m, 10.0 * slant_m**2
    doors = doors_in(traced(walls, ajar), RULES, windows)
    assert (doors.state.tolist(), doors.ajar.tolist()) == ([DoorState.OPEN], [True])


def beside_a_pillar(below: list[float], other: Walls | Windows, mirrored: bool) -> tuple[WallCells, Walls, Windows]:
    """A pillar from x = 0 to 0.5 with a beam to x = 1.5, cells with these counts below that, and one other face or a window."""
    part = cells().counts[:30]
    part[10:, :46] = below
    walls, windows = replace(WALL, ends=np.array([[[0.0, 0.0], [1.5, 0.0]]])), NO_WINDOWS
    if mirrored:
        walls, part = replace(walls, ends=walls.ends[:, ::-1]), part[::-1]
    if isinstance(other, Windows):
        return WallCells(np.array([0, 30]), 66, part), walls, other
    if not len(other):
        return WallCells(np.array([0, 30]), 66, part), walls, windows
    return WallCells(np.array([0, 30, 80]), 66, np.concatenate([part, cells().counts[:50]])), walls.append(other), windows


def test_glass_up_to_the_ceiling_is_no_window_of_its_face() -> None:
    """What stands beside it need not be a wall: fronts are told by their panes alone."""
    seen = cells()
    seen.counts[20:60, :56] = [1.0, -0.08, 0.08**2, 20.0]
    seen.counts[20:60, 56:] = 0.0
    assert not len(find_windows(traced(WALL, seen, 2.8), RULES, WindowsSettings()))


def test_a_window_goes_on_where_its_glass_returns_nothing() -> None:
    seen = cells()
    seen.counts[20:60, 18:44] = 0.0
    seen.counts[30:40, 18:44, THROUGH] = 50.0
    np.testing.assert_allclose(
        find_windows(traced(WALL, seen), RULES, WindowsSettings()).ends[:, :, 0], [[1.0, 3.0]], atol=CELL_M
    )
    # Where nothing returns from below or above either, nothing is known of it.
    seen.counts[40:60] = 0.0
    np.testing.assert_allclose(
        find_windows(traced(WALL, seen), RULES, WindowsSettings()).ends[:, :, 0], [[1.0, 2.0]], atol=2 * CELL_M
    )


def test_a_window_shows_though_few_of_the_rays_that_pass_it_return() -> None:
    """Outside is nothing in range: less than two rays in a row of three cells."""
    seen = cells()
    seen.counts[20:60, 18:44] = 0.0
    seen.counts[20:60, 18:44, THROUGH] = 0.5
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, 3.0]], atol=2 * CELL_M)
    # Far fewer are stray ones.
    seen.counts[20:60, 18:44, THROUGH] = 0.1
    assert len(find_windows(traced(WALL, seen), RULES, WindowsSettings())) == 0


@pytest.mark.parametrize(
    ("depth_m", "passed", "end"),
    [
        (0.08, 2.0, 3.0),  # the same pane, met straight on
        (0.08, 0.0, 2.0),  # a leaf in line with it
        (0.14, 2.0, 2.0),  # a leaf that is ajar, behind it
    ],
)
def test_a_window_goes_on_where_its_glass_returns_most_rays(depth_m: float, passed: float, end: float) -> None:
    seen = cells()
    pane, beside = seen.counts[20:40, 0:44], seen.counts[40:60, 0:44]
    pane[..., FILLED], pane[..., SUM], pane[..., SQUARES], pane[..., THROUGH] = 1.0, -0.08, 0.08**2, 50.0
    beside[..., SUM], beside[..., SQUARES], beside[..., THROUGH] = -10 * depth_m, 10 * depth_m**2, passed
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    # The reveals of what is no pane count for three columns at most.
    np.testing.assert_allclose(windows.ends[:, :, 0], [[1.0, end]], atol=0.2)


@pytest.mark.parametrize(("returned", "found"), [(0.0, 0), (3.0, 1)])
def test_what_returns_at_a_jamb_alone_makes_no_pane_of_an_opening_higher_than_doors(returned: float, found: int) -> None:
    """The opening reaches the ceiling at 3.3 m; at a jamb the edge of an open leaf returns some rays below what may be a lintel."""
    counts = np.zeros((80, 80, 4), np.float32)
    counts[..., FILLED] = 10.0
    counts[20:40, :65] = [returned, -0.2 * returned, 0.2**2 * returned, 50.0]
    counts[36:40, :44] = [5.0, -1.0, 0.2, 50.0]
    counts[36:40, 44:] = [10.0, 0.0, 0.0, 0.0]
    seen = WallCells(np.array([0, 80]), 80, counts)
    windows = find_windows(traced(replace(WALL, top_m=np.array([3.8])), seen, 3.3), RULES, WindowsSettings())
    assert np.count_nonzero(np.ptp(windows.ends[:, :, 0], axis=1) > 0.8) == found


def test_a_window_ends_at_the_doorway_beside_it() -> None:
    """Between window and door there is no more than a bar, and above the door its wall shows, as it does above the window."""
    seen = cells()
    seen.counts[10:40, 18:42, FILLED], seen.counts[10:40, 18:42, THROUGH] = 0.0, 50.0
    seen.counts[42:60, :44, FILLED], seen.counts[42:60, :44, THROUGH] = 0.0, 50.0
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[0.5, 2.0]], atol=2 * CELL_M)
    doors = doors_in(traced(WALL, seen), RULES, windows)
    np.testing.assert_allclose(np.sort(doors.ends[:, :, 0]), [[2.1, 3.0]], atol=CELL_M)


def test_a_pane_on_a_low_rail_ends_at_the_doorway_beside_it() -> None:
    """Of what tells them apart, the rail alone is left."""
    seen = cells()
    seen.counts[10:40, 3:42] = [1.0, -0.07, 0.07**2, 50.0]
    seen.counts[45:63, :44] = [0.0, 0.0, 0.0, 50.0]
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    np.testing.assert_allclose(windows.ends[:, :, 0], [[0.5, 2.0]], atol=2 * CELL_M)
    doors = doors_in(traced(WALL, seen), RULES, windows)
    np.testing.assert_allclose(np.sort(doors.ends[:, :, 0]), [[2.25, 3.15]], atol=CELL_M)


@pytest.mark.parametrize(
    ("depth_m", "passed", "found"),
    [
        (0.1, 8.0, 1),  # glass below a blind: as many rays return as pass
        (0.1, 0.5, 0),  # a leaf
        (0.3, 8.0, 0),  # a cabinet behind an opening
        (0.0, 8.0, 0),  # what stands in the face
    ],
)
def test_glass_returns_some_rays_and_lets_others_pass(depth_m: float, passed: float, found: int) -> None:
    seen = cells()
    recess(seen, 0.0, 2.2, 0.1)
    recess(seen, 0.0, 1.0, depth_m)
    seen.counts[30:48, 0:20, THROUGH] = passed
    windows = find_windows(traced(WALL, seen), RULES, WindowsSettings())
    assert len(windows) == found
    if found:
        np.testing.assert_allclose(windows.ends[:, :, 0], [[1.5, 2.4]], atol=2 * CELL_M)
        assert windows.pane_m[0] == pytest.approx(0.1, abs=0.005)


def test_rays_that_ended_beyond_a_window_passed_it() -> None:
    rays = np.array(
        [
            [2.0, 3.0, 1.2],  # through the window
            [2.0, 0.02, 1.2],  # on its pane
            [2.0, -1.0, 0.0],  # before it
            [9.0, 3.0, 1.2],  # past its end
        ]
    )
    passed = rays_through(WINDOW, features((2.0, -2.0), rays, np.zeros((0, 2, 2))))
    assert passed.ray_label.tolist() == [0]
    assert passed.ray_count.tolist() == [1]
    np.testing.assert_array_equal(passed.ray_end_map, rays[:1].astype(np.float32))
    # From the other side it is that side's window, if any.
    assert not len(rays_through(WINDOW, features((2.0, 2.0), rays, np.zeros((0, 2, 2)))).ray_label)


def test_planes_beyond_a_window_were_seen_through_it() -> None:
    planes = np.array(
        [
            [[1.0, 4.0], [3.0, 4.0]],  # the house across the street
            [[0.0, 0.0], [4.0, 0.0]],  # the window's own wall
            [[8.0, 1.0], [12.0, 1.0]],  # past the window
        ]
    )
    scan = features((2.0, -2.0), np.zeros((0, 3)), planes)
    assert seen_through(WINDOW, scan).tolist() == [True, False, False]
    assert not seen_through(NO_WINDOWS, scan).any()
    turned = replace(scan, origin_map=np.array([[2.0, 2.0, 1.0]]))
    assert not seen_through(WINDOW, turned).any()


@pytest.mark.parametrize(
    ("path", "crossed"),
    [
        ([[2.0, -1.0], [2.0, 1.0]], True),
        ([[1.0, -1.0], [2.6, 0.2]], True),  # at a slant, between two poses
        ([[3.0, -1.0], [3.0, 1.0]], False),  # beside the jamb
        ([[2.0, -1.0], [2.0, -0.1], [2.2, -1.0]], False),  # up to it and back
        ([[2.0, -1.0]], False),
        (np.zeros((0, 2)), False),
    ],
)
def test_a_door_that_was_driven_through_is_open(path: list[list[float]], crossed: bool) -> None:
    seen = cells()
    recess(seen, 0.0, 2.1, 0.05)
    closed = doors_in(traced(WALL, seen), RULES)
    assert closed.state.tolist() == [DoorState.CLOSED]
    proven = prove_crossed(closed, np.array(path, np.float64))
    assert proven.crossed.tolist() == [crossed]
    assert proven.state.tolist() == [DoorState.OPEN if crossed else DoorState.CLOSED]
    assert np.isnan(proven.depth_m[0]) == crossed
    assert (proven.confidence[0] == 1.0) == (crossed or closed.confidence[0] == 1.0)
    assert len(prove_crossed(NO_DOORS, np.array(path, np.float64))) == 0


def test_what_frames_show_to_be_no_door_is_dropped() -> None:
    closed, opened = DoorState.CLOSED, DoorState.OPEN
    kinds = [
        # head, scans, width, agreement, state; the leaf 2 cm deep
        (2.05, 9, 0.9, 1.0, closed),
        (1.70, 9, 0.9, 1.0, closed),  # a wall that leans
        (2.73, 9, 0.9, 1.0, closed),  # up to the ceiling
        (1.70, 9, 0.9, 1.0, opened),
        (2.05, 1, 0.9, 1.0, closed),
        (2.05, 0, 0.9, 1.0, opened),
        (2.05, 9, 0.9, 0.7, closed),  # rays pass it: a pane, met straight on
        (2.05, 9, 0.9, 0.7, opened),
        (2.05, 9, 0.2, 1.0, opened),  # the rays left little of it
        (2.05, 9, 0.9, 0.1, opened),  # few of its columns show it
    ]
    head_m, scan_count, width_m, agreement, state = (np.array(column) for column in zip(*kinds, strict=True))
    shape = {f.name: getattr(NO_DOORS, f.name) for f in fields(Doors)}
    doors = Doors(**{name: np.zeros((len(kinds), *v.shape[1:]), v.dtype) for name, v in shape.items()})
    doors.ends[:, 1, 0] = width_m
    doors = replace(doors, head_m=head_m, scan_count=scan_count, agreement=agreement, state=state.astype(np.uint8))
    doors = replace(doors, coverage=np.ones(len(kinds)), depth_m=np.full(len(kinds), 0.02))
    kept = drop_doubtful(doors, BuildingSettings())
    # A recess that no error makes shows from afar as well.
    deep = drop_doubtful(replace(doors, depth_m=np.full(len(kinds), 0.1)), BuildingSettings())
    np.testing.assert_array_equal(deep.scan_count, scan_count[[0, 3, 4, 5, 7]])
    np.testing.assert_array_equal(kept.head_m, head_m[[0, 3, 5, 7]])
    np.testing.assert_array_equal(kept.state, [closed, opened, opened, opened])
    assert len(drop_doubtful(NO_DOORS, BuildingSettings())) == 0


def seen_through_a_doorway(origin: tuple[float, float], depth_m: float, generator: np.random.Generator) -> np.ndarray:
    """(r, 3) what rays from 1 m above the floor meet: a wall 20 cm thick, its opening from x = 1.5 to 2.4 and 2.08 m high.

    A leaf stands `depth_m` behind the face; without one rays go on to a wall at y = 3. Ranges scatter by 1.5 cm.
    """
    start = np.array([*origin, 1.0])
    aim = np.column_stack([generator.uniform(1.2, 2.7, 40_000), np.zeros(40_000), generator.uniform(0.0, 2.7, 40_000)])
    ray = aim - start
    within = (aim[:, 0] > 1.5) & (aim[:, 0] < 2.4) & (aim[:, 2] < 2.08)
    with np.errstate(divide="ignore"):
        to_jamb = np.where(ray[:, 0] > 0, 2.4 - aim[:, 0], 1.5 - aim[:, 0]) / ray[:, 0]
        to_head = np.where(ray[:, 2] > 0, (2.08 - aim[:, 2]) / ray[:, 2], np.inf)
    # Metres behind the face as a share of the way to it.
    reveal = np.minimum(to_jamb, to_head)
    reveal = np.where(reveal * ray[:, 1] < 0.2, reveal, np.inf)
    beyond = np.minimum(reveal, (depth_m if np.isfinite(depth_m) else 3.0) / ray[:, 1])
    share = 1.0 + np.where(within, beyond, 0.0)
    share += generator.normal(0.0, 0.015, len(ray)) / np.linalg.norm(ray, axis=1)
    return start + share[:, None] * ray


@pytest.mark.parametrize("depth_m", [np.nan, 0.04])
def test_frames_are_placed_to_a_centimetre_though_reveals_return_too(depth_m: float) -> None:
    """Most of what returns next to a head from below is the lintel's underside."""
    generator = np.random.default_rng(3)
    scans = [
        features((x, y), seen_through_a_doorway((x, y), depth_m, generator), WALL.ends)
        for x, y in ((1.2, -1.5), (2.9, -1.0))
    ]
    state = DoorState.OPEN if np.isnan(depth_m) else DoorState.CLOSED
    door = replace(
        NO_DOORS,
        **{field.name: np.zeros((1, *getattr(NO_DOORS, field.name).shape[1:])) for field in fields(Doors)},
    )
    door = replace(
        door,
        ends=np.array([[[1.55, 0.0], [2.45, 0.0]]]),
        normal=WALL.normal,
        head_m=np.array([2.0]),
        depth_m=np.array([depth_m]),
        state=np.array([state], np.uint8),
        wall=np.zeros(1, np.int32),
        casing_m=np.full(1, np.nan),
        contrast=np.full(1, np.nan),
        outline=np.full(1, np.nan),
    )
    placed = place_frames(door, WALL, scans, SETTINGS, DoorFramesSettings())
    np.testing.assert_allclose(placed.ends[0, :, 0], [1.5, 2.4], atol=0.012)
    assert placed.head_m[0] == pytest.approx(2.08, abs=0.012)
    assert placed.scan_count[0] == 2
    # Where all leaves are lower, what ends up there is no leaf's head.
    lower = place_frames(door, WALL, scans, SETTINGS.model_copy(update={"door_height_max_m": 2.0}), DoorFramesSettings())
    assert lower.head_m[0] == pytest.approx(2.08 if np.isnan(depth_m) else 2.0, abs=0.012)
    flush = replace(door, depth_m=np.zeros(1), casing_m=np.full(1, 0.01))
    kept = place_frames(flush, WALL, scans, SETTINGS, DoorFramesSettings())
    np.testing.assert_array_equal(kept.ends, door.ends)
    assert (kept.head_m[0], kept.scan_count[0]) == (2.0, 2)
    # Seen at a slant alone, the jambs of an open door show all the same; where a leaf is, its recess shifts what is seen.
    aside = [features((-3.0, -1.0), seen_through_a_doorway((-3.0, -1.0), depth_m, generator), WALL.ends)]
    placed = place_frames(door, WALL, aside, SETTINGS, DoorFramesSettings())
    np.testing.assert_allclose(placed.ends[0, :, 0], [1.5, 2.4] if np.isnan(depth_m) else [1.55, 2.45], atol=0.012)


@pytest.mark.parametrize(("x", "height_m"), [(4.0, 0.4), (6.0, 0.6), (20.0, 0.6), (-20.0, 0.0)])
def test_a_ramp_ends_where_it_was_seen(x: float, height_m: float) -> None:
    """A floor that rises by a tenth from x = 0 on, seen up to 6 m away."""
    seen = features((0.0, 0.0), np.ones((1, 3)), WALL.ends)
    pieces = np.array([[[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]])
    rays = Rays.of(replace(seen, floor_map=pieces, floor_is_foot=np.ones(1, bool)))
    assert floor_m(rays.floors, 0, x, 0.0) == pytest.approx(height_m)


def test_a_window_is_in_a_wall_that_looks_the_same_way() -> None:
    """What a pane mirrored is no wall, and its windows are none."""
    ends = np.array([[[1.0, 0.05], [2.0, 0.05]], [[1.0, 2.0], [2.0, 2.0]], [[1.0, 0.0], [2.0, 0.0]], [[9.0, 0.0], [9.5, 0.0]]])
    normal = np.array([[0.0, -1.0], [0.0, -1.0], [0.0, 1.0], [0.0, -1.0]])
    windows = Windows(ends, normal, np.full(4, 0.9), np.full(4, 2.0), np.zeros(4))
    assert is_in_wall(windows, WALL, WindowsSettings()).tolist() == [True, False, False, False]
    assert not is_in_wall(windows, NO_WALLS, WindowsSettings()).any()


@pytest.mark.parametrize(
    ("other", "bottom_m", "count"),
    [
        (((1.8, 0.05), (3.5, 0.05)), 0.9, 2),  # the window beside a garden door
        (((1.8, 0.05), (3.5, 0.05)), 0.2, 1),  # more of its pane
        (((1.2, 0.05), (3.5, 0.05)), 0.9, 1),  # most of one is the other
    ],
)
def test_windows_that_overlap_are_one_but_for_a_garden_door_and_the_window_beside_it(
    other: tuple[tuple[float, float], tuple[float, float]], bottom_m: float, count: int
) -> None:
    door = replace(window((1.0, 0.0), (2.0, 0.0)), bottom_m=np.zeros(1))
    both = door.append(replace(window(*other), bottom_m=np.full(1, bottom_m)))
    joined = join_windows(both, 0.1, 0.3)
    assert len(joined) == count
    assert joined.bottom_m.min() == 0.0
    assert len(join_windows(both, 0.1, np.inf)) == 1


@pytest.mark.parametrize(("ends", "longer_m"), [(((1.0, 0.05), (2.0, 0.05)), 0.3), (((1.0, 1.0), (2.0, 1.0)), 0.0)])
def test_a_pane_may_go_on_in_its_wall_and_a_screen_in_a_room_does_not(
    ends: tuple[tuple[float, float], tuple[float, float]], longer_m: float
) -> None:
    pane = replace(window(*ends), normal=WALL.normal[:1])
    widened = widened_in_walls(pane, WALL, 0.3, WindowsSettings())
    np.testing.assert_allclose(np.sort(widened.ends[0, :, 0]), [1.0 - longer_m, 2.0 + longer_m])
    assert len(widened_in_walls(NO_WINDOWS, WALL, 0.3, WindowsSettings())) == 0


@pytest.mark.parametrize(
    ("first", "last", "low_row", "top_row", "doors"),
    [
        (34, 44, 20, 32, 1),  # a vision panel
        (33, 38, 20, 32, 1),
        (31, 47, 20, 32, 0),  # as wide as a window within its frame
        (34, 44, 20, 55, 0),  # nothing ends above it
    ],
)
def test_rays_pass_a_leafs_vision_panel(first: int, last: int, low_row: int, top_row: int, doors: int) -> None:
    seen = cells()
    recess(seen, 0.0, 2.1, 0.08)
    seen.counts[first:last, low_row:top_row] = [0.0, 0.0, 0.0, 10.0]
    assert _closed_for_sure(seen) == doors


def _closed_for_sure(seen: WallCells) -> int:
    """How many closed doors stand where many scans saw them."""
    found = doors_in(traced(WALL, seen), RULES)
    sure = each_once(replace(found, scan_count=np.full(len(found), 99, np.int32)), RULES)
    return int(np.count_nonzero(sure.state == DoorState.CLOSED))


@pytest.mark.parametrize("lean_m", [0.0, 0.02])
@pytest.mark.parametrize(("head_m", "doors"), [(1.4, 0), (1.6, 0), (2.0, 1)])
def test_a_niche_lower_than_doors_is_none(head_m: float, doors: int, lean_m: float) -> None:
    """Few rays come to the wall above it, which may lean back a little."""
    seen = cells()
    recess(seen, 0.0, 1.95, lean_m)
    seen.counts[30:48, round(head_m / CELL_M) : round(1.95 / CELL_M)] *= 0.1
    recess(seen, 0.0, head_m, 0.07)
    assert _closed_for_sure(seen) == doors


def test_what_was_not_seen_is_no_leaf_around_a_panel() -> None:
    """Below a window something hides what is there, and of its leaf no rail shows."""
    seen = cells()
    recess(seen, 0.0, 2.1, 0.08)
    seen.counts[34:44, 16:25] = [0.0, 0.0, 0.0, 10.0]
    assert _closed_for_sure(seen) == 1
    seen.counts[38, :16] = 0.0
    assert _closed_for_sure(seen) == 0


DOORWAY = closed_door(Segment.between(*WALL_1), (30.0, 48.0), cells().counts, 2.0, 0.6, wall=0)
OPEN = replace(DOORWAY, state=np.array([DoorState.OPEN], np.uint8), depth_m=np.array([np.nan]))


def deep_rays(generator: np.random.Generator, depth_m: float, half_m: float, past: float) -> list[Features]:
    """Three scans through a doorway from x = 1.5 to 2.4: what stands so deep behind it is twice `half_m` wide; a share goes on."""
    scans = []
    for x in (0.9, 1.95, 3.0):
        at = np.column_stack([generator.uniform(-half_m, half_m, 3000) + 1.95, generator.uniform(0.0, 1.98, 3000)])
        end = np.insert(at, 1, depth_m + generator.normal(0.0, 0.005, 3000), axis=1)
        origin = np.array([x, -1.5, 1.0])
        way = end - origin
        end = end[np.abs(origin[0] + way[:, 0] * 1.5 / way[:, 1] - 1.95) < 0.45]
        goes_on = generator.random(len(end)) < past
        end[goes_on] = origin + 3.0 * (end[goes_on] - origin)
        scan = features((x, -1.5), end, np.zeros((0, 2, 2)))
        scans.append(replace(scan, ray_label=np.full(len(end), Label.CLUTTER, np.uint8)))
    return scans


@pytest.mark.parametrize(
    ("depth_m", "half_m", "past", "closed"),
    [(0.45, 0.45, 0.0, True), (0.64, 0.45, 0.05, True), (0.64, 1.2, 0.0, False), (0.64, 0.45, 0.3, False), (1.3, 0.45, 0.0, False)],
)
def test_a_leaf_at_the_far_side_of_a_thick_wall_shuts_its_doorway(
    depth_m: float, half_m: float, past: float, closed: bool
) -> None:
    """Not the back of a closet, which is wider than its doorway, nor what rays pass, nor what stands in the next room."""
    scans = deep_rays(np.random.default_rng(4), depth_m, half_m, past)
    doors, windows = tell_deep_openings(OPEN, lambda faces, deep: trace_rays(faces, scans, deep), RULES)
    assert not len(windows)
    assert doors.state.tolist() == [DoorState.CLOSED if closed else DoorState.OPEN]
    assert doors.depth_m[0] == pytest.approx(depth_m if closed else np.nan, abs=0.01, nan_ok=True)
    assert not closed or doors.agreement[0] > RULES.building.opaque_min


def test_a_vision_panel_leaves_a_deep_leaf_shut_and_shelves_at_two_depths_are_none() -> None:
    """Hand-made cells: neither is one of which half was seen."""
    counts = np.zeros((34, 60, 4), np.float32)
    counts[8:26, :, FILLED] = 10.0
    counts[8:26, :, SUM], counts[8:26, :, SQUARES] = -5.0, 2.5
    paned, shelves, half_seen = counts.copy(), counts.copy(), counts.copy()
    paned[14:20, 20:30] = 0.0
    paned[14:20, 20:30, THROUGH] = 10.0
    shelves[8:26, ::2, SUM], shelves[8:26, ::2, SQUARES] = -7.0, 4.9
    half_seen[8:17] = 0.0
    board, cabinet = np.zeros_like(counts), np.zeros_like(counts)
    for things, rows in ((board, slice(17, 23)), (cabinet, slice(0, 24))):
        things[8:26, :, THROUGH] = 10.0
        things[8:26, rows] = counts[8:26, rows]
    floor = counts.copy()
    floor[8:26, :12] = 0.0
    floor[8:26, :12, THROUGH] = 10.0  # rays that end on the floor before the leaf
    closed, opened = DoorState.CLOSED, DoorState.OPEN
    for seen, state in (
        (counts, closed), (paned, closed), (floor, closed), (shelves, opened), (half_seen, opened), (board, opened),
        (cabinet, opened)
    ):  # fmt: skip
        doors, _ = tell_deep_openings(OPEN, lambda *_, seen=seen: WallCells(np.array([0, 34]), 60, seen), RULES)
        assert doors.state.tolist() == [state]


def test_only_doors_that_stand_wide_open_are_asked_for_a_deep_leaf() -> None:
    def trace(*_: object) -> WallCells:
        raise AssertionError("asked")

    yes = np.array([True])
    for doors in (NO_DOORS, DOORWAY, replace(OPEN, ajar=yes), replace(OPEN, crossed=yes)):
        assert tell_deep_openings(doors, trace, RULES) == (doors, NO_WINDOWS)


@pytest.mark.parametrize(("depth_m", "half_m", "past", "is_window"), [
    (0.45, 0.45, 0.9, True), (0.64, 1.2, 0.9, True), (0.45, 0.05, 0.9, False), (1.3, 0.45, 0.9, False), (0.45, 0.45, 1.0, False),
])  # fmt: skip
def test_a_pane_at_the_far_side_of_a_thick_wall_makes_its_doorway_a_window(
    depth_m: float, half_m: float, past: float, is_window: bool
) -> None:
    """Not a post in the doorway, nor what stands in the next room, nor where nothing returns."""
    scans = deep_rays(np.random.default_rng(4), depth_m, half_m, past)
    doors, windows = tell_deep_openings(OPEN, lambda faces, deep: trace_rays(faces, scans, deep), RULES)
    assert (len(doors), len(windows)) == ((0, 1) if is_window else (1, 0))
    if is_window:
        np.testing.assert_array_equal(windows.ends, OPEN.ends)
        assert windows.pane_m == pytest.approx([depth_m], abs=0.01)
        assert windows.bottom_m[0] < 0.5
        np.testing.assert_array_equal(windows.top_m, OPEN.head_m)
    else:
        assert doors.state.tolist() == [DoorState.OPEN]


@pytest.mark.parametrize(("hidden_rows", "is_window"), [(0, True), (24, False)])
def test_of_a_doorway_that_things_hide_for_the_most_part_no_pane_is_told(hidden_rows: int, is_window: bool) -> None:
    """Hand-made cells: what stands in the way lies at all depths, the sheet above it lets nine rays of ten pass."""
    counts = np.zeros((34, 60, 4), np.float32)
    counts[8:26, :, FILLED], counts[8:26, :, SUM], counts[8:26, :, SQUARES], counts[8:26, :, THROUGH] = 1.0, -0.5, 0.25, 9.0
    counts[8:26, :hidden_rows] = (10.0, -5.0, 3.4, 0.0)
    doors, windows = tell_deep_openings(OPEN, lambda *_: WallCells(np.array([0, 34]), 60, counts), RULES)
    assert (len(doors), len(windows)) == ((0, 1) if is_window else (1, 0))


def test_the_jamb_of_a_doorway_is_no_pane_though_strays_return_from_as_deep() -> None:
    """Hand-made cells: one ray in three hundred returns from where all do that meet the jamb."""
    counts = np.zeros((34, 60, 4), np.float32)
    counts[8:26, :, THROUGH] = 100.0
    counts[8:24, ::3, FILLED], counts[8:24, ::3, SUM], counts[8:24, ::3, SQUARES] = 1.0, -0.03, 0.0009
    counts[24:26] = (100.0, -3.0, 0.09, 0.0)
    seen = WallCells(np.array([0, 34]), 60, counts)
    doors, windows = tell_deep_openings(OPEN, lambda *_: seen, RULES)
    assert (len(doors), len(windows)) == (1, 0)


@pytest.mark.parametrize(("rows", "is_pane_shown"), [(slice(0, 41), True), (slice(5, 38, 3), True), (slice(3, 6), False)])
def test_a_pane_shows_all_over_and_not_as_the_edge_of_a_sill(rows: slice, is_pane_shown: bool) -> None:
    counts = np.zeros((10, 41, 4))
    counts[..., THROUGH] = 80.0
    counts[:, rows, FILLED], counts[:, rows, SUM], counts[:, rows, SQUARES] = 20.0, -20.0 * 0.01, 20.0 * 0.01**2
    np.testing.assert_allclose(find_pane_m(counts, RULES), 0.01 if is_pane_shown else np.nan)
