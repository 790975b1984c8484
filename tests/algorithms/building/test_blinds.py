"""What hangs in windows: one wall along y = 0 with a window between x = 1 and 3, a blind in its upper part."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.blinds import BlindsSettings, find_blinds
from ffmap.algorithms.building.model import CELL_M, Blinds, BuildingSettings, Windows
from ffmap.algorithms.building.ray_evidence import ANGLES_DEG, FILLED, SQUARES, THROUGH, WallCells
from tests.faces import faces, traced, window

WALL = faces(((0.0, 0.0), (4.0, 0.0)))
WINDOW = replace(window((1.0, 0.0), (3.0, 0.0)), top_m=np.array([1.6]))
COLUMNS, ROWS = slice(20, 60), 66


def wall(reflectance: float | None = 40.0) -> WallCells:
    """The wall, ten returns on its face in every cell, but for the window's clear part, between 0.9 and 1.6 m."""
    counts = np.zeros((80, ROWS, 4), np.float32)
    counts[..., FILLED], counts[..., SQUARES] = 10.0, 10.0 * 0.005**2
    light = np.zeros((80 if reflectance else 0, ROWS, len(ANGLES_DEG) + 1, 2), np.float32)
    if reflectance:
        light[..., 0, :] = 10.0, 10.0 * reflectance
    counts[COLUMNS, 18:32] = 0.0
    counts[COLUMNS, 18:32, THROUGH] = 10.0
    return WallCells(np.array([0, 80]), ROWS, counts, light)


def hang(
    cells: WallCells,
    low_m: float,
    high_m: float,
    depth_m: float = 0.0,
    *,
    columns: slice = COLUMNS,
    returns: float = 10.0,
    spread_m: float = 0.005,
    passed: float = 0.0,
    reflectance: float = 40.0,
) -> None:
    """In the window's columns rays end between these heights, so deep behind the face."""
    rows = slice(round(low_m / CELL_M), round(high_m / CELL_M))
    cells.counts[columns, rows] = returns, -returns * depth_m, returns * (depth_m**2 + spread_m**2), passed
    if len(cells.light):
        cells.light[columns, rows, 0] = returns, returns * reflectance


def found(cells: WallCells, windows: Windows = WINDOW) -> Blinds:
    return find_blinds(windows, traced(WALL, cells), BuildingSettings(), BlindsSettings())


def test_what_hangs_behind_the_face_is_found_and_the_lintel_above_it_is_not() -> None:
    seen = wall(None)
    hang(seen, 1.6, 2.2, 0.1)
    blinds = found(seen)
    np.testing.assert_allclose(blinds.ends, WINDOW.ends)
    np.testing.assert_allclose([blinds.bottom_m, blinds.top_m, blinds.behind_m], [[1.6], [2.2], [0.1]], atol=1e-5)
    assert np.isnan(blinds.contrast).all()


@pytest.mark.parametrize("reflectance", [20.0, 60.0])
@pytest.mark.parametrize("depth_m", [0.0, -0.02])  # a roller may stand out of the face
def test_a_flush_blind_is_told_by_what_it_returns(reflectance: float, depth_m: float) -> None:
    seen = wall()
    hang(seen, 1.6, 2.2, depth_m, reflectance=reflectance)
    blinds = found(seen)
    np.testing.assert_allclose([blinds.bottom_m, blinds.top_m, blinds.behind_m], [[1.6], [2.2], [0.0]], atol=1e-5)
    assert blinds.contrast[0] == pytest.approx(reflectance / 40.0 - 1.0, abs=0.01)


def test_a_lintel_is_no_blind() -> None:
    assert not len(found(wall()))
    assert not len(found(wall(None)))
    # Paint is not so even.
    seen = wall()
    hang(seen, 1.6, 2.2, 0.01, reflectance=46.0)
    assert not len(found(seen))


@pytest.mark.parametrize(
    "what",
    [
        pytest.param({"high_m": 1.75}, id="a frame"),
        pytest.param({"columns": slice(20, 30)}, id="a stile"),
        pytest.param({"returns": 2.0}, id="glass that returns but few"),
        pytest.param({"passed": 20.0}, id="glass that most rays pass"),
        pytest.param({"spread_m": 0.05}, id="the underside of a lintel"),
        pytest.param({"low_m": 1.9}, id="what lies above the lintel"),
    ],
)
def test_what_is_not_like_a_blind_is_none(what: dict[str, object]) -> None:
    seen = wall()
    hang(seen, **{"low_m": 1.6, "high_m": 2.2, "depth_m": 0.1} | what)  # type: ignore[arg-type]
    assert not len(found(seen))


def test_between_its_clear_part_and_a_blind_glass_may_return_nothing() -> None:
    seen = wall()
    seen.counts[COLUMNS, 32:36] = 0.0
    hang(seen, 1.8, 2.2, 0.1)
    assert found(seen).bottom_m[0] == pytest.approx(1.8)


def test_a_blind_may_reach_the_ceiling_and_its_slats_let_some_rays_pass() -> None:
    seen = wall(None)
    hang(seen, 1.6, 3.3, 0.1, passed=8.0)
    assert found(seen).top_m[0] == pytest.approx(3.3)


def test_the_wall_beside_the_windows_tells_though_most_of_the_face_is_blinds() -> None:
    wide = replace(WINDOW, ends=np.array([[[0.4, 0.0], [3.6, 0.0]]]))
    seen = wall()
    seen.counts[8:72, 18:32] = [0.0, 0.0, 0.0, 10.0]
    hang(seen, 1.6, 2.8, columns=slice(8, 72), reflectance=20.0)
    assert found(seen, wide).contrast.tolist() == pytest.approx([-0.5], abs=0.01)
    # The face was laid along the blinds, and the wall stands out of it.
    bare = replace(seen, light=seen.light[:0])
    assert not len(found(bare, wide))
    for columns in (slice(0, 8), slice(72, 80)):
        hang(bare, 0.0, 3.3, -0.03, columns=columns)
    assert found(bare, wide).behind_m.tolist() == pytest.approx([0.03], abs=0.001)
    # Two windows side by side with nothing between them: nothing tells.
    halves = [replace(WINDOW, ends=np.array([[[a, 0.0], [a + 2.0, 0.0]]])) for a in (0.0, 2.0)]
    seen = wall()
    seen.counts[:, 18:32] = [0.0, 0.0, 0.0, 10.0]
    hang(seen, 1.6, 2.8, columns=slice(0, 80), reflectance=20.0)
    assert not len(found(seen, halves[0].append(halves[1])))


def test_what_closes_a_window_below_its_clear_part_is_its_sill() -> None:
    seen = wall()
    hang(seen, 0.4, 0.9, 0.1)
    assert not len(found(seen))


def test_each_window_has_its_own_and_one_of_no_wall_has_none() -> None:
    seen = wall()
    hang(seen, 1.6, 2.2, 0.1)
    far = replace(WINDOW, ends=WINDOW.ends + 5.0)
    assert len(found(seen, far)) == 0
    assert len(found(seen, WINDOW.append(far).append(WINDOW))) == 2
    assert len(found(seen, WINDOW.select(slice(0, 0)))) == 0
