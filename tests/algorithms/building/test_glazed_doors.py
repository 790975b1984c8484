"""Closed doors whose leaf is a pane, on hand-made cells of one face."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.doors import drop_doubtful
from ffmap.algorithms.building.face_columns import TracedFaces
from ffmap.algorithms.building.glazed_doors import find_glazed_doors
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, Doors, Walls, Windows
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import FILLED, SQUARES, WallCells
from ffmap.algorithms.building.windows import WindowsSettings, find_windows

BUILDING = BuildingSettings()
RULES = OpeningRules(BUILDING, OpeningsSettings())
CEILING_M = 2.8
WALL = Walls(
    np.array([[[0.0, 0.0], [4.0, 0.0]]]),
    np.array([[0.0, -1.0]]),
    np.zeros(1),
    np.array([CEILING_M]),
    np.array([9], np.int32),
    np.array([0.01]),
    np.array([900]),
)


def wall() -> np.ndarray:
    """The cells (80, 66, 4) of 4 m of wall: ten rays end on each, with a centimetre of noise."""
    counts = np.zeros((80, 66, 4), np.float32)
    counts[:, : round(CEILING_M / CELL_M), FILLED] = 10.0
    counts[..., SQUARES] = counts[..., FILLED] * 0.01**2
    return counts


def glaze(counts: np.ndarray, x_m: tuple[float, float], z_m: tuple[float, float], depth_m: float) -> None:
    """A pane: nine of ten rays pass it, one returns from behind the face."""
    part = counts[round(x_m[0] / CELL_M) : round(x_m[1] / CELL_M), round(z_m[0] / CELL_M) : round(z_m[1] / CELL_M)]
    part[:] = [1.0, -depth_m, depth_m**2 + 0.01**2, 9.0]


def recess(counts: np.ndarray, x_m: tuple[float, float], z_m: tuple[float, float], depth_m: float) -> None:
    """Opaque, behind the face."""
    part = counts[round(x_m[0] / CELL_M) : round(x_m[1] / CELL_M), round(z_m[0] / CELL_M) : round(z_m[1] / CELL_M)]
    part[:] = [10.0, -10 * depth_m, 10 * (depth_m**2 + 0.01**2), 0.0]


def found(counts: np.ndarray) -> Doors:
    """The glazed doors of the face, by the windows that are found in it."""
    cells = WallCells(np.array([0, 80]), 66, counts)
    clear_m = np.full(80, CEILING_M)
    windows: Windows = find_windows(WALL, cells, clear_m, RULES, WindowsSettings())
    return find_glazed_doors(TracedFaces(WALL, cells, clear_m, np.zeros(80)), windows, RULES)


@pytest.mark.parametrize("depth_m", [0.02, 0.08])
def test_a_pane_in_a_leaf_is_a_closed_door(depth_m: float) -> None:
    """The leaf is 0.9 m wide and 2.1 m high, its stiles and rails 10 cm, the lower one 25 cm; flush, its stiles do not show."""
    counts = wall()
    if depth_m > BUILDING.recess_min_m + 0.01:
        recess(counts, (1.5, 2.4), (0.0, 2.1), depth_m)
    glaze(counts, (1.6, 2.3), (0.25, 2.0), depth_m)
    doors = found(counts)
    assert len(doors) == 1
    assert doors.glazed[0]
    np.testing.assert_allclose(np.sort(doors.ends[0, :, 0]), [1.5, 2.4], atol=CELL_M)
    assert doors.head_m[0] == pytest.approx(2.1, abs=CELL_M)
    assert doors.agreement[0] > BUILDING.opaque_min


def test_a_leaf_of_glass_is_not_dropped_because_rays_pass_it() -> None:
    counts = wall()
    recess(counts, (1.5, 2.4), (0.0, 2.1), 0.08)
    glaze(counts, (1.6, 2.3), (0.25, 2.0), 0.08)
    doors = found(counts)
    assert len(drop_doubtful(replace(doors, scan_count=np.full(1, 9, np.int32)), BUILDING)) == 1


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
    glaze(counts, x_m, z_m, 0.05)
    assert len(found(counts)) == 0


def test_a_pane_beside_other_glass_is_a_window() -> None:
    """A door in a glazed wall cannot be told from the panes beside it."""
    counts = wall()
    glaze(counts, (1.2, 2.0), (0.25, 2.0), 0.05)
    assert len(found(counts)) == 1
    glaze(counts, (2.25, 3.8), (0.25, 2.0), 0.05)
    assert len(found(counts)) == 0
