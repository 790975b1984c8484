"""Mullions before a glazed front's pane, by rays that are cast through it."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_MULLIONS,
    NO_WINDOWS,
    BuildingSettings,
    Mullions,
    Windows,
)
from ffmap.algorithms.building.mullions import find_mullions
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.scan.summary import Features, select_rays
from tests.tracing import rays_alone

RULES = OpeningRules(BuildingSettings(), OpeningsSettings())
PANE_Y = 3.0


def pane(*ends_x: tuple[float, float], behind_m: float = 0.0, bottom_m: float = 0.1) -> Windows:
    """Windows whose panes stand in y = 3, seen from smaller y, between these places, so far behind their wall's face."""
    ends = np.array([[[low, PANE_Y - behind_m], [high, PANE_Y - behind_m]] for low, high in ends_x])
    each = np.ones(len(ends_x))
    return Windows(ends, np.array([[0.0, -1.0]] * len(ends_x)), bottom_m * each, 2.6 * each, behind_m * each)


def through(box_x: tuple[float, float], out_m: float, top_m: float = 3.0, turn_deg: float = 0.0) -> list[Features]:
    """Three scans of a room, x from 0 to 4, of which the front returns a few rays, and a box that stands out of it all.

    turn_deg: of the whole in the map.
    """
    generator, scans, turn = np.random.default_rng(7), [], turned(turn_deg)
    for x in (0.8, 2.0, 3.3):
        aim = np.column_stack([generator.uniform(0.0, 4.0, 20_000), np.full(20_000, PANE_Y), generator.uniform(0.0, 2.7, 20_000)])
        origin = np.array([x, 1.0, 1.0])
        way, end = aim - origin, origin + 3.0 * (aim - origin)
        on_pane = generator.random(len(aim)) < 0.3
        end[on_pane] = aim[on_pane]
        with np.errstate(divide="ignore"):
            # Where a ray enters the box: through its front, or one of its sides.
            for at, axis in ((PANE_Y - out_m, 1), (box_x[0], 0), (box_x[1], 0)):
                share = (at - origin[axis]) / way[:, axis]
                place = origin + share[:, None] * way
                meets = (place[:, 0] > box_x[0] - 1e-9) & (place[:, 0] < box_x[1] + 1e-9) & (place[:, 2] < top_m)
                meets &= (place[:, 1] > PANE_Y - out_m - 1e-9) & (place[:, 1] < PANE_Y) & (share > 0.0)
                nearer = meets & (share < np.linalg.norm(end - origin, axis=1) / np.linalg.norm(way, axis=1))
                end[nearer] = place[nearer]
        end += generator.normal(0.0, 0.005, end.shape)
        scans.append(rays_alone(turn @ origin, end @ turn.T, np.full(len(end), Label.CLUTTER, np.uint8)))
    return scans


def turned(degrees: float) -> FloatArray:
    """(3, 3) about the upright."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def found(windows: Windows, scans: list[Features]) -> Mullions:
    return find_mullions(windows, lambda asked, building: trace_rays(asked, scans, building), RULES)


@pytest.mark.parametrize("box_x", [(1.98, 2.03), (2.01, 2.09), (1.96, 2.06)])
@pytest.mark.parametrize("out_m", [0.06, 0.15])
@pytest.mark.parametrize("panes", [((0.0, 4.0),), ((0.0, 1.98), (2.05, 4.0)), ((2.05, 4.0), (0.0, 1.98))])
@pytest.mark.parametrize(("behind_m", "turn_deg"), [(0.0, 0.0), (0.07, 130.0)])
def test_a_mullion_returns_the_rays_from_foot_to_head(
    box_x: tuple[float, float], out_m: float, panes: tuple[tuple[float, float], ...], behind_m: float, turn_deg: float
) -> None:
    """It parts two panes, or stands before one, and covers columns of the face in part."""
    windows, turn = pane(*panes, behind_m=behind_m), turned(turn_deg)[:2, :2]
    windows = replace(windows, ends=windows.ends @ turn.T, normal=windows.normal @ turn.T)
    mullions = found(windows, through(box_x, out_m, turn_deg=turn_deg))
    ends = mullions.ends @ turn
    np.testing.assert_allclose(np.sort(ends[..., 0], axis=1), [box_x], atol=1.2 * CELL_M)
    np.testing.assert_allclose(ends[..., 1], PANE_Y, atol=1e-6)
    np.testing.assert_allclose(mullions.normal @ turn, [[0.0, -1.0]], atol=1e-9)
    assert mullions.out_m == pytest.approx([out_m], abs=0.02)
    assert (mullions.bottom_m[0], mullions.top_m[0]) == (0.1, 2.6)


@pytest.mark.parametrize(
    ("box_x", "top_m", "bottom_m"),
    [
        pytest.param((1.8, 2.0), 3.0, 0.1, id="a curtain is wider"),
        pytest.param((1.98, 2.03), 2.0, 0.1, id="a lamp is lower"),
        pytest.param((1.98, 2.03), 3.0, 0.9, id="a pole before a window with a sill"),
    ],
)
def test_what_stands_before_a_pane_otherwise_is_none(box_x: tuple[float, float], top_m: float, bottom_m: float) -> None:
    assert not len(found(pane((0.0, 4.0), bottom_m=bottom_m), through(box_x, 0.08, top_m)))


@pytest.mark.parametrize("more", [(), ((2.05, 4.0),)])
def test_what_stands_at_a_panes_end_is_none(more: tuple[tuple[float, float], ...]) -> None:
    """A curtain drawn aside, or the edge of an open leaf; unless there is another pane, in line and seen from the same side."""
    scans, windows = through((1.98, 2.03), 0.08), pane((0.0, 1.98), *more)
    assert len(found(windows, scans)) == len(more)
    for ends, normal in ((windows.ends[1:] + np.array([0.0, 0.3]), windows.normal[1:]), (windows.ends[1:], -windows.normal[1:])):
        others = replace(windows.select(np.arange(len(more)) + 1), ends=ends, normal=normal)
        assert not len(found(windows.select(np.zeros(1, int)).append(others), scans))


def test_what_few_rays_met_is_none() -> None:
    scans = [select_rays(scan, np.arange(len(scan.ray_end_map)) % 400 == 0) for scan in through((1.98, 2.03), 0.08)]
    assert not len(found(pane((0.0, 4.0)), scans))


def test_a_pane_deep_in_its_wall_has_its_mullions_within_that() -> None:
    def trace(*_: object) -> WallCells:
        raise AssertionError("asked")

    for windows in (NO_WINDOWS, pane((0.0, 4.0), behind_m=0.2), replace(pane((0.0, 4.0)), pane_m=np.full(1, np.nan))):
        assert find_mullions(windows, trace, RULES) is NO_MULLIONS
