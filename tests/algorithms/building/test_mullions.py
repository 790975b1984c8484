"""Mullions before a glazed front's pane, by rays that are cast through it."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, NO_WINDOWS, BuildingSettings, Walls, Windows
from ffmap.algorithms.building.mullions import find_mullions
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import trace_rays
from ffmap.algorithms.scan.summary import Features
from tests.faces import faces
from tests.tracing import rays_alone

RULES = OpeningRules(BuildingSettings(), OpeningsSettings())
PANE_Y = 3.0


def pane(*ends_x: tuple[float, float], behind_m: float = 0.0) -> Windows:
    """Windows in y = 3, seen from smaller y, between these places, their panes so far behind that."""
    ends = np.array([[[low, PANE_Y], [high, PANE_Y]] for low, high in ends_x])
    each = np.ones(len(ends_x))
    return Windows(ends, np.array([[0.0, -1.0]] * len(ends_x)), 0.1 * each, 2.6 * each, behind_m * each)


def wall(low_x: float, high_x: float) -> Walls:
    """What stands beside it, in line."""
    return replace(faces(((low_x, PANE_Y), (high_x, PANE_Y))), normal=np.array([[0.0, -1.0]]))


def through(box_x: tuple[float, float], out_m: float, top_m: float = 3.0) -> list[Features]:
    """Three scans of a room, x from 0 to 4, of which the front's rays pass but where a box that stands out of it returns them."""
    generator, scans = np.random.default_rng(7), []
    for x in (0.8, 2.0, 3.3):
        aim = np.column_stack([generator.uniform(0.0, 4.0, 20_000), np.full(20_000, PANE_Y), generator.uniform(0.0, 2.7, 20_000)])
        origin = np.array([x, 1.0, 1.0])
        way, end = aim - origin, origin + 3.0 * (aim - origin)
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
        scans.append(rays_alone(origin, end, np.full(len(end), Label.CLUTTER, np.uint8)))
    return scans


def found(windows: Windows, walls: Walls, scans: list[Features]) -> Windows:
    return find_mullions(windows, walls, lambda asked, building: trace_rays(asked, scans, building), RULES)


def places(windows: Windows) -> FloatArray:
    """From where to where each is (n, 2), the lower first."""
    return np.sort(windows.ends[..., 0], axis=1)


@pytest.mark.parametrize("box_x", [(1.98, 2.03), (2.01, 2.09)])
@pytest.mark.parametrize("out_m", [0.06, 0.12])
@pytest.mark.parametrize("panes", [((0.0, 4.0),), ((0.0, 2.0), (2.05, 4.0))])
def test_a_mullion_returns_the_rays_from_foot_to_head(
    box_x: tuple[float, float], out_m: float, panes: tuple[tuple[float, float], ...]
) -> None:
    """It parts two panes, or stands before one, and covers columns of the face in part."""
    mullions = found(pane(*panes), NO_WALLS, through(box_x, out_m))
    np.testing.assert_allclose(places(mullions), [box_x], atol=1.2 * CELL_M)
    assert mullions.pane_m == pytest.approx([out_m], abs=0.03)
    # Its front looks into the room.
    np.testing.assert_allclose(mullions.ends[..., 1], PANE_Y - out_m, atol=0.03)


@pytest.mark.parametrize(
    ("box_x", "top_m"), [((1.8, 2.2), 3.0), ((1.98, 2.03), 1.2)], ids=["a curtain is wider", "a thing on legs is lower"]
)
def test_what_stands_before_a_pane_otherwise_is_none(box_x: tuple[float, float], top_m: float) -> None:
    assert not len(found(pane((0.0, 4.0)), NO_WALLS, through(box_x, 0.08, top_m)))


def test_at_a_panes_end_a_mullion_has_the_wall_beside_it() -> None:
    scans = through((1.98, 2.03), 0.08)
    assert len(found(pane((0.0, 2.0)), wall(2.05, 4.0), scans)) == 1
    assert not len(found(pane((0.0, 2.0)), NO_WALLS, scans))  # nothing, as beside a leaf that stands open


def test_a_pane_deep_in_its_wall_has_its_bars_within_that() -> None:
    def trace(*_: object) -> None:
        raise AssertionError("asked")

    for windows in (NO_WINDOWS, pane((0.0, 4.0), behind_m=0.2), pane((0.0, 4.0), behind_m=np.nan)):
        assert find_mullions(windows, NO_WALLS, trace, RULES) is NO_WINDOWS  # type: ignore[arg-type]
