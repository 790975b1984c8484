"""Closed doors whose leaf is a pane, on hand-made cells of one face."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.doors import drop_doubtful
from ffmap.algorithms.building.face_columns import TracedFaces
from ffmap.algorithms.building.glazed_doors import find_glazed_doors, panes_of_open_leaves
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, Doors, Windows
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import FILLED, SQUARES, WallCells
from ffmap.algorithms.building.windows import WindowsSettings, find_windows
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import CEILING_M, doors, faces, window

BUILDING = BuildingSettings()
RULES = OpeningRules(BUILDING, OpeningsSettings())
WALL = faces(((0.0, 0.0), (4.0, 0.0)))


def wall() -> np.ndarray:
    """The cells (80, 66, 4) of 4 m of wall: ten rays end on each, with a centimetre of noise."""
    counts = np.zeros((80, 66, 4), np.float32)
    counts[:, : round(CEILING_M / CELL_M), FILLED] = 10.0
    counts[..., SQUARES] = counts[..., FILLED] * 0.01**2
    return counts


def fill(counts: np.ndarray, x_m: tuple[float, float], z_m: tuple[float, float], depth_m: float, returned: float) -> None:
    """Of ten rays a cell so many return from behind the face, and the others pass: one from a pane, all from a leaf."""
    (left, right), (low, high) = ((round(first / CELL_M), round(last / CELL_M)) for first, last in (x_m, z_m))
    on = returned * np.array([1.0, -depth_m, depth_m**2 + 0.01**2])
    counts[left:right, low:high] = [*on, 10.0 - returned]


def traced(counts: np.ndarray) -> TracedFaces:
    """The face with these cells."""
    return TracedFaces(WALL, WallCells(np.array([0, 80]), 66, counts), np.full(80, CEILING_M), np.zeros(80))


def windows_in(counts: np.ndarray) -> Windows:
    """The windows that are found in the face."""
    face = traced(counts)
    return find_windows(face, RULES, WindowsSettings())


def found(counts: np.ndarray) -> Doors:
    """The glazed doors of the face, by the windows that are found in it."""
    return find_glazed_doors(traced(counts), windows_in(counts), RULES)


@pytest.mark.parametrize(("depth_m", "stiles_show"), [(0.02, False), (0.08, True)])
def test_a_pane_in_a_leaf_is_a_closed_door(depth_m: float, stiles_show: bool) -> None:
    """The leaf is 0.9 m wide and 2.1 m high, its stiles and rails 10 cm, the lower one 25 cm; flush, its stiles do not show."""
    counts = wall()
    if stiles_show:
        fill(counts, (1.5, 2.4), (0.0, 2.1), depth_m, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), depth_m, 1.0)
    doors = found(counts)
    assert len(doors) == 1
    assert doors.glazed[0]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.5, 2.4], atol=0.01 if stiles_show else CELL_M)
    assert np.ptp(doors.ends[0, :, 0]) > 0.85  # its pane alone is 0.7 m wide, or 0.8 m by the cells
    assert doors.head_m[0] == pytest.approx(2.1, abs=CELL_M)
    assert doors.agreement[0] > BUILDING.opaque_min


def test_a_leaf_of_glass_is_not_dropped_because_rays_pass_it() -> None:
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.08, 1.0)
    # Where the jamb is seen from nearby, most of the doorway's returns are its reveal's, which two columns may show.
    fill(counts, (1.5, 1.6), (0.0, 2.1), 0.03, 10.0)
    counts[30:32] *= 10.0
    doors = found(counts)
    assert len(drop_doubtful(replace(doors, scan_count=np.full(1, 9, np.int32)), BUILDING)) == 1


def test_what_stands_aslant_in_an_opening_is_no_leaf_of_glass() -> None:
    """Most rays pass beside it, as they pass a pane, but what returns is of no one leaf."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.08, 1.0)
    pane = replace(window((1.6, 0.0), (2.3, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.08))
    for behind_m in (0.12, 0.16, 0.2):
        fill(counts, (behind_m + 1.5, behind_m + 1.65), (0.25, 2.0), behind_m, 2.0)
    doors = find_glazed_doors(traced(counts), pane, RULES)
    assert len(doors) == 1
    assert len(drop_doubtful(replace(doors, scan_count=np.full(1, 9, np.int32)), BUILDING)) == 0


@pytest.mark.parametrize(
    ("x_m", "z_m"),
    [
        ((1.6, 2.3), (0.9, 2.0)),  # a window
        ((1.6, 2.3), (0.25, 2.7)),  # one up to the ceiling
        ((0.6, 3.6), (0.25, 2.0)),  # a glazed wall
        ((1.6, 1.9), (0.25, 2.0)),  # a slit
    ],
)
def test_other_panes_are_windows_alone(x_m: tuple[float, float], z_m: tuple[float, float]) -> None:
    counts = wall()
    fill(counts, x_m, z_m, 0.05, 1.0)
    assert len(found(counts)) == 0


def test_a_pane_beside_other_glass_is_a_window() -> None:
    """A door in a glazed wall cannot be told from the panes beside it."""
    counts = wall()
    fill(counts, (1.2, 2.0), (0.25, 2.0), 0.03, 1.0)
    assert len(found(counts)) == 1
    fill(counts, (2.25, 3.8), (0.25, 2.0), 0.03, 1.0)
    assert len(found(counts)) == 0


def test_a_door_beside_a_window_with_a_sill_is_told_by_that() -> None:
    """Between them is no pier but their frames."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.08, 1.0)
    fill(counts, (2.45, 3.8), (0.5, 2.0), 0.08, 1.0)
    assert len(found(counts)) == 1
    fill(counts, (2.45, 3.8), (0.1, 2.0), 0.08, 1.0)
    assert len(found(counts)) == 0


def test_furniture_may_hide_the_wall_beside_a_leaf_of_glass_on_one_side() -> None:
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.08, 1.0)
    pane = replace(window((1.6, 0.0), (2.3, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.08))
    counts[48:, :45] = 0.0
    assert len(found(counts)) == len(find_glazed_doors(traced(counts), pane, RULES)) == 1
    counts[:30, :45] = 0.0
    assert len(found(counts)) == len(find_glazed_doors(traced(counts), pane, RULES)) == 0


def test_the_stiles_of_a_pane_deeper_than_cells_tell_show_as_deep_as_they_do() -> None:
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.33, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.33, 1.0)
    pane = replace(window((1.6, 0.0), (2.3, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.4))
    doors = find_glazed_doors(traced(counts), pane, RULES)
    np.testing.assert_allclose(np.sort(doors.ends[:, :, 0]), [[1.5, 2.4]], atol=0.01)


@pytest.mark.parametrize(("frame_m", "count"), [(0.05, 0), (0.1, 1)])
def test_a_window_down_to_the_floor_has_no_stiles(frame_m: float, count: int) -> None:
    """Its frame is narrower."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.12, 10.0)
    fill(counts, (1.5 + frame_m, 2.4 - frame_m), (0.1, 2.1 - frame_m), 0.12, 1.0)
    assert len(found(counts)) == count
    # Beside the frame the glass returns nothing, which makes it no stile.
    pane = replace(window((1.5, 0.0), (2.4, 0.0)), bottom_m=np.full(1, 0.1), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.12))
    edges = [round((1.5 + frame_m) / CELL_M), round((2.4 - frame_m) / CELL_M) - 1]
    counts[edges, 2:] = [0.0, 0.0, 0.0, 10.0]
    assert len(find_glazed_doors(traced(counts), pane, RULES)) == count


def test_a_pane_at_the_end_of_its_face_is_a_window() -> None:
    """Beside it is another wall, or nothing."""
    counts = wall()
    fill(counts, (3.1, 4.0), (0.0, 2.1), 0.12, 10.0)
    fill(counts, (3.2, 3.9), (0.25, 2.0), 0.12, 1.0)
    pane = replace(window((3.2, 0.0), (3.9, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.12))
    assert len(find_glazed_doors(traced(counts), pane, RULES)) == 0


@pytest.mark.parametrize(("rail_m", "count"), [(0.1, 1), (0.5, 0)])
def test_a_leaf_of_glass_is_no_higher_than_doors(rail_m: float, count: int) -> None:
    """Of what is over its glass as much is its rail as lies at the pane."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.3 + rail_m), 0.12, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.3), 0.12, 1.0)
    pane = replace(window((1.6, 0.0), (2.3, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.3), pane_m=np.full(1, 0.12))
    assert len(find_glazed_doors(traced(counts), pane, RULES)) == count


@pytest.mark.parametrize("hidden_m", [0.0, 1.0, 2.1])
def test_a_garden_door_ends_before_the_window_beside_it(hidden_m: float) -> None:
    """A pier of 15 cm parts them, seen, or hidden by furniture, or by a curtain."""
    counts = wall()
    fill(counts, (0.7, 1.7), (0.0, 2.1), 0.05, 10.0)
    fill(counts, (0.8, 1.6), (0.05, 2.0), 0.05, 1.0)
    fill(counts, (1.85, 3.2), (0.9, 2.1), 0.05, 1.0)
    counts[34:37, : round(hidden_m / CELL_M)] = 0.0
    windows = windows_in(counts)
    np.testing.assert_allclose(np.sort(windows.ends[:, :, 0]), [[0.8, 1.6], [1.85, 3.2]], atol=0.11)
    np.testing.assert_allclose(windows.bottom_m, [0.05, 0.9], atol=0.01)


def test_a_leaf_ends_with_its_recessed_stiles() -> None:
    """Which a window may hold already: beside them is the wall, not more of the leaf."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.1), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.0), 0.08, 1.0)
    for ends in (((1.6, 0.0), (2.3, 0.0)), ((1.5, 0.0), (2.4, 0.0))):
        pane = replace(window(*ends), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.0), pane_m=np.full(1, 0.08))
        doors = find_glazed_doors(traced(counts), pane, RULES)
        np.testing.assert_allclose(np.sort(doors.ends[:, :, 0]), [[1.5, 2.4]], atol=0.01)


@pytest.mark.parametrize(
    ("transom_m", "columns", "head_m"),
    [
        ((2.05, 2.15), 1.0, 2.15),
        ((2.05, 2.3), 1.0, 2.15),  # the leaf's rail, and the transom over it
        ((2.05, 2.15), 0.5, 2.5),  # a notice on the pane
        ((1.5, 1.6), 1.0, 2.5),  # a bar of a leaf that is as high as the glass
        (None, 0.0, 2.5),
    ],
)
def test_a_leaf_of_glass_ends_below_its_fanlight(
    transom_m: tuple[float, float] | None, columns: float, head_m: float
) -> None:
    """Below a transom as high as doors' heads; above the fanlight is wall."""
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.5), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.4), 0.08, 1.0)
    if transom_m is not None:
        fill(counts, (1.5, 1.5 + 0.9 * columns), transom_m, 0.08, 10.0)
    doors = found(counts)
    assert len(doors) == 1
    assert doors.head_m[0] == pytest.approx(head_m, abs=0.01)


def test_the_wall_above_a_door_begins_above_its_fanlight() -> None:
    counts = wall()
    fill(counts, (1.5, 2.4), (0.0, 2.3), 0.08, 10.0)
    fill(counts, (1.6, 2.3), (0.25, 2.2), 0.08, 1.0)
    fill(counts, (1.6, 2.3), (1.95, 2.05), 0.08, 10.0)
    assert len(found(counts)) == 1


@pytest.mark.parametrize(("transom_m", "count"), [((2.05, 2.15), 1), (None, 0)])
def test_glass_higher_than_doors_is_one_below_a_transom_alone(transom_m: tuple[float, float] | None, count: int) -> None:
    counts = wall()
    fill(counts, (1.6, 2.3), (0.25, 2.65), 0.03, 1.0)
    if transom_m is not None:
        fill(counts, (1.6, 2.3), transom_m, 0.03, 10.0)
    pane = replace(window((1.6, 0.0), (2.3, 0.0)), bottom_m=np.full(1, 0.25), top_m=np.full(1, 2.65), pane_m=np.full(1, 0.03))
    assert len(find_glazed_doors(traced(counts), pane, RULES)) == count


@pytest.mark.parametrize(
    ("first", "last", "is_leaf"),
    [
        ((1.95, 0.2), (1.95, 0.8), True),
        ((1.1, -0.2), (1.6, -0.8), True),
        ((1.95, 0.4), (1.95, 0.95), True),
        ((1.95, 0.2), (1.95, 1.15), False),  # longer than the doorway is wide
        ((1.95, 0.55), (1.95, 0.95), False),  # not at a jamb
        ((2.1, 0.0), (2.9, 0.0), False),  # in the wall beside it
        ((5.0, 0.2), (5.0, 0.8), False),
    ],
)
def test_a_pane_that_hangs_at_an_open_doorway_is_its_leafs(
    first: tuple[float, float], last: tuple[float, float], is_leaf: bool
) -> None:
    along = np.subtract(last, first) / np.linalg.norm(np.subtract(last, first))
    pane = replace(window(first, last), normal=np.array([[-along[1], along[0]]]))
    both = doors(((6.0, 0.0), (7.0, 0.0)), ((1.0, 0.0), (2.0, 0.0)), normal=[[0.0, 1.0]] * 2, state=[DoorState.OPEN] * 2)
    assert panes_of_open_leaves(pane, both).tolist() == [is_leaf]
    assert panes_of_open_leaves(pane, replace(both, state=np.full(2, DoorState.CLOSED, np.uint8))).tolist() == [False]
