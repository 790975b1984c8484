"""Glazed fronts: told from open passages, furniture and mirror images by rays that are cast through a front."""

from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.face_verdicts import JudgedFaces, StandingWallsSettings
from ffmap.algorithms.building.glass_fronts import (
    AllRays,
    GlassFrontsSettings,
    GlassRules,
    find_glass_fronts,
    new_fronts,
    set_in_walls,
)
from ffmap.algorithms.building.missed_walls import MissedWallsSettings
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    NO_WINDOWS,
    BuildingSettings,
    Walls,
    Windows,
)
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.scan.summary import Features, concatenate
from tests.faces import faces, window
from tests.tracing import rays_alone, tracing
from tests.voting import vote

BUILDING = BuildingSettings(near_m=0.07, own_plane_m=0.0, range_m=25.0)
FRONTS = GlassFrontsSettings()
RULES = GlassRules(OpeningRules(BUILDING, OpeningsSettings()), StandingWallsSettings(), FRONTS, MissedWallsSettings())
DEPTH_M = 3.0
PATH = np.column_stack([np.linspace(0.8, 3.2, 25), np.full(25, 1.0)])


@dataclass(frozen=True)
class Front:
    """What stands in the plane y = 3, over the whole width of a room [0, 4] × [0, 3], and what its rays meet.

    returned, mirrored: shares of the rays that a pane returns, and that it mirrors, which end in the room's mirror image.
    open_x: from where to where no pane stands. walls_x: from where to where walls return all rays. dust_x: from
    where to where a pane's share is a tenth. shelf: boards that return nearly all rays, and nothing between them, in place of a
    pane; railing_m: distance of upright bars that do. person_x: where someone 0.5 m wide stands, who returns all rays.
    turn_deg: of the whole in the map.
    """

    returned: float = 0.05
    mirrored: float = 0.1
    open_x: tuple[float, float] = (9.0, 9.0)
    walls_x: tuple[tuple[float, float], ...] = ()
    dust_x: tuple[float, float] = (9.0, 9.0)
    shelf: bool = False
    railing_m: float | None = None
    person_x: float | None = None
    rays: int = 12_000
    turn_deg: float = 0.0

    def scan(self, x: float, generator: np.random.Generator) -> Features:
        """What one scan sees of it from 1 m before the room's middle."""
        origin = np.array([x, 1.0, 1.0])
        aim = np.column_stack(
            [generator.uniform(0.0, 4.0, self.rays), np.full(self.rays, DEPTH_M), generator.uniform(0.05, 2.6, self.rays)]
        )
        ray = aim - origin
        drawn = generator.random(self.rays)
        glazed = (aim[:, 0] < self.open_x[0]) | (aim[:, 0] > self.open_x[1])
        dusty = (aim[:, 0] > self.dust_x[0]) & (aim[:, 0] < self.dust_x[1])
        on_pane = drawn < self.returned * glazed * np.where(dusty, 0.1, 1.0)
        for low, high in self.walls_x:
            on_pane |= (aim[:, 0] > low) & (aim[:, 0] < high)
        if self.shelf:
            on_pane = (aim[:, 2] % 0.4 < 0.04) & (drawn < 0.9)
        if self.railing_m is not None:
            # Between its bars something thin returns as few rays as glass.
            on_pane = drawn < np.where(aim[:, 0] % self.railing_m < 0.015, 0.9, 0.4 * self.returned)
        if self.person_x is not None:
            on_pane |= np.abs(aim[:, 0] - self.person_x) < 0.25
        solid = self.shelf or self.railing_m is not None
        mirrored = ~on_pane & glazed & (not solid) & (drawn < self.returned + self.mirrored)
        # The image of the wall behind the robot, at y = 6, and a wall of the building opposite.
        end_y = np.where(on_pane, DEPTH_M, np.where(mirrored, 2 * DEPTH_M, 14.0))
        way = (end_y - origin[1]) / ray[:, 1]
        way += generator.normal(0.0, 0.01, self.rays) / np.linalg.norm(ray, axis=1)
        end = self.to_map(origin + way[:, None] * ray)
        return rays_alone(self.to_map(origin[None])[0], end, np.full(self.rays, Label.CLUTTER, np.uint8))

    def to_map(self, places: FloatArray) -> FloatArray:
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        turned = np.asarray(places, float).copy()
        turned[..., :2] = turned[..., :2] @ np.array([[c, s], [-s, c]])
        return turned

    def found(
        self,
        scans: int = 8,
        persons_x: tuple[float | None, ...] = (None,),
        refused: Walls = NO_WALLS,
        windows: Windows = NO_WINDOWS,
        more_walls: Walls = NO_WALLS,
        whole: Walls = NO_WALLS,
    ) -> Windows:
        """What is found by scans along the robot's way, in which a person stands at one place after the other."""
        generator = np.random.default_rng(4)
        places = zip(np.linspace(0.8, 3.2, scans), cycle(persons_x), strict=False)
        parts = [replace(self, person_x=person_x).scan(x, generator) for x, person_x in places]
        seen = concatenate(parts)
        votes = vote(seen.ray_end_map, seen.ray_label, len(Label), 0.05)

        def trace(asked: Walls, known: Windows) -> WallCells:
            return tracing(seen)(asked, BUILDING, known)

        def each_scan(asked: Walls) -> list[WallCells]:
            return [trace_rays(asked, [part], BUILDING) for part in parts]

        sides = faces(((0, 3), (0, 0)), ((0, 0), (4, 0)), ((4, 0), (4, 3))).append(more_walls)
        walls = replace(sides, ends=self.to_map(sides.ends), normal=self.to_map(sides.normal))
        judged = JudgedFaces(walls, refused, np.zeros(len(refused), np.uint8))
        return find_glass_fronts(whole, judged, windows, AllRays(votes, self.to_map(PATH), trace, each_scan), RULES)


@pytest.mark.parametrize("returned", [0.02, 0.07, 0.2])
@pytest.mark.parametrize("turn_deg", [0.0, 33.0])
def test_a_pane_from_wall_to_wall_is_found_and_what_it_mirrors_is_none(returned: float, turn_deg: float) -> None:
    front = Front(returned=returned, turn_deg=turn_deg)
    fronts = front.found()
    assert len(fronts) == 1
    back = Front(turn_deg=-turn_deg)
    ends = back.to_map(fronts.ends[0])
    np.testing.assert_allclose(ends[:, 1], DEPTH_M, atol=0.02)
    np.testing.assert_allclose(np.sort(ends[:, 0]), [0.0, 4.0], atol=0.25)
    np.testing.assert_allclose(back.to_map(fronts.normal[0]), [0.0, -1.0], atol=0.02)
    assert fronts.top_m[0] == pytest.approx(2.6, abs=2 * CELL_M)
    assert fronts.pane_m.tolist() == [0.0]


def test_an_open_passage_is_no_pane_and_ends_one() -> None:
    assert len(Front(returned=0.0, mirrored=0.0).found()) == 0
    fronts = Front(open_x=(1.4, 2.6)).found()
    assert len(fronts) == 2
    edges = np.sort(fronts.ends[..., 0], axis=1)
    np.testing.assert_allclose(edges[np.argsort(edges[:, 0])], [[0.0, 1.4], [2.6, 4.0]], atol=0.25)


def test_a_grating_returns_more_than_glass_does() -> None:
    assert len(Front(returned=0.4, mirrored=0.0).found()) == 0


def test_each_pane_returns_its_share_whatever_is_in_line_with_it() -> None:
    """A leaf's edge sweeps the plane once in a while; two jambs part what it leaves there from a pane."""
    walls_x = ((0.0, 0.6), (1.7, 2.3), (3.4, 4.0))
    known = faces(*(((high, DEPTH_M), (low, DEPTH_M)) for low, high in walls_x))
    found = Front(mirrored=0.0, walls_x=walls_x, dust_x=(2.0, 4.0), rays=30_000).found(more_walls=known)
    np.testing.assert_allclose(np.sort(found.ends[:, :, 0]), [[0.6, 1.7]], atol=0.12)


def test_a_mullion_parts_no_pane_however_narrow_its_panes_are() -> None:
    """Two panes, each narrower than a pane that stands alone, on both sides of what passes for a short wall."""
    walls_x = ((0.0, 1.5), (1.92, 2.08), (2.5, 4.0))
    known = faces(*(((high, DEPTH_M), (low, DEPTH_M)) for low, high in walls_x))
    found = Front(walls_x=walls_x).found(more_walls=known)
    assert len(found) == 1
    np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [1.5, 2.5], atol=0.12)
    # A pier as wide as a wall's end parts them.
    walls_x = ((0.0, 1.4), (1.82, 2.18), (2.6, 4.0))
    known = faces(*(((high, DEPTH_M), (low, DEPTH_M)) for low, high in walls_x))
    assert len(Front(walls_x=walls_x).found(more_walls=known)) == 0


def test_a_shelf_returns_rays_in_some_places_and_none_in_others() -> None:
    assert len(Front(shelf=True).found()) == 0


@pytest.mark.parametrize(("behind_m", "from_x", "panes"), [(0.4, 0.0, 0), (0.4, 3.0, 1), (1.0, 0.0, 1)])
def test_a_sheet_close_before_a_wall_is_the_edges_of_a_shelf(behind_m: float, from_x: float, panes: int) -> None:
    """Unless the wall is behind a small part of it, or a room's depth away."""
    wall = faces(((4.0, DEPTH_M + behind_m), (from_x, DEPTH_M + behind_m)))
    assert len(Front(mirrored=0.0).found(more_walls=wall)) == panes


@pytest.mark.parametrize("scans", [8, 40])
@pytest.mark.parametrize(("apart_m", "panes"), [(0.15, 0), (0.25, 0), (0.6, 1)])
def test_a_railing_returns_rays_and_few_in_turns_and_a_windows_bars_are_farther_apart(
    scans: int, apart_m: float, panes: int
) -> None:
    assert len(Front(railing_m=apart_m).found(scans)) == panes


def test_who_walks_by_returns_all_rays_at_once_and_is_no_pane() -> None:
    walk = tuple(np.arange(0.25, 4.0, 0.5))
    assert len(Front(returned=0.0, mirrored=0.0).found(persons_x=walk)) == 0
    assert len(Front().found(persons_x=(2.0, None, None, None, None, None, None, None))) == 1


def test_few_rays_tell_nothing() -> None:
    assert len(Front(rays=40).found()) == 0


def test_no_pane_is_where_the_robot_drove_or_nothing_was_seen() -> None:
    through = replace(Front(), turn_deg=0.0)
    generator = np.random.default_rng(4)
    seen = concatenate([through.scan(x, generator) for x in (1.0, 2.0, 3.0)])
    votes = vote(seen.ray_end_map, seen.ray_label, len(Label), 0.05)
    way = np.column_stack([np.linspace(0.2, 3.8, 60), np.full(60, DEPTH_M)])

    def trace(asked: Walls, known: Windows) -> WallCells:
        return tracing(seen)(asked, BUILDING, known)

    rays = AllRays(votes, way, trace, lambda asked: [trace(asked, NO_WINDOWS)])
    nothing = JudgedFaces(faces(((0, 0), (4, 0))), NO_WALLS, np.zeros(0, np.uint8))
    assert len(find_glass_fronts(NO_WALLS, nothing, NO_WINDOWS, rays, RULES)) == 0
    unseen = replace(rays, votes=vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05), path_map=PATH)
    assert len(find_glass_fronts(NO_WALLS, nothing, NO_WINDOWS, unseen, RULES)) == 0


def test_a_face_that_rays_speak_against_may_be_a_pane() -> None:
    """Scans saw a plane there, which explains its returns."""
    sides = faces(((4.0, DEPTH_M), (0.0, DEPTH_M)), ((0.0, DEPTH_M), (4.0, DEPTH_M)))
    for side in range(2):  # from the room behind it as well: a pane has two sides
        found = Front().found(refused=sides.select(np.array([side])))
        np.testing.assert_allclose(found.ends[..., 1], [[DEPTH_M, DEPTH_M]], atol=0.02)


@pytest.mark.parametrize("before_m", [0.04, 0.06])
def test_a_pane_is_found_behind_its_frame(before_m: float) -> None:
    """Scans saw the plane of the frame's front, which explains the pane's returns."""
    frame = faces(((4.0, DEPTH_M - before_m), (0.0, DEPTH_M - before_m)))
    found = Front().found(refused=frame)
    np.testing.assert_allclose(found.ends[..., 1], [[DEPTH_M, DEPTH_M]], atol=0.02)
    assert not len(Front(shelf=True).found(refused=frame))


@pytest.mark.parametrize("panes", [0, 1])
def test_a_face_that_was_cut_into_parts_too_short_for_a_pane_is_asked_whole(panes: int) -> None:
    """The parts explain the returns, so that no line is drawn through them."""
    parts = faces(*(((x + 0.45, DEPTH_M), (x, DEPTH_M)) for x in np.arange(0.0, 4.0, 0.5)))
    whole = faces(((4.0, DEPTH_M), (0.0, DEPTH_M))).select(np.arange(panes))
    found = Front(mirrored=0.0).found(refused=parts, whole=whole)
    assert len(found) == panes
    np.testing.assert_allclose(np.sort(found.ends[..., 0]), np.tile([0.0, 4.0], (panes, 1)), atol=0.25)


def test_a_pane_is_as_wide_as_all_lines_show_that_lie_on_it() -> None:
    """Two faces of which each shows two thirds, more of them both than apart."""
    found = Front().found(refused=faces(((4.0, DEPTH_M), (1.6, DEPTH_M)), ((2.4, DEPTH_M), (0.0, DEPTH_M))))
    assert len(found) == 1
    np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [0.0, 4.0], atol=0.15)


def test_a_front_is_new_where_no_known_window_has_most_of_it() -> None:
    front = replace(window((0.0, 0.0), (2.0, 0.0)), pane_m=np.zeros(1))
    assert len(new_fronts(front, NO_WINDOWS, FRONTS)) == 1
    assert len(new_fronts(front, window((0.5, 0.1), (3.0, 0.1)), FRONTS)) == 0
    assert len(new_fronts(front, window((1.5, 0.1), (3.0, 0.1)), FRONTS)) == 1
    # Another room's window, back to back with this one.
    behind = replace(window((0.0, -0.3), (2.0, -0.3)), normal=np.array([[0.0, -1.0]]))
    assert len(new_fronts(front, behind, FRONTS)) == 1


def test_a_front_stands_in_the_wall_beside_it() -> None:
    front = replace(window((1.0, -0.2), (3.0, -0.2)), pane_m=np.zeros(1))
    beside = faces(((0.0, 0.0), (0.9, 0.0)))
    in_wall = set_in_walls(front, beside, FRONTS)
    np.testing.assert_allclose(in_wall.ends[0], [[1.0, 0.0], [3.0, 0.0]], atol=1e-9)
    assert in_wall.pane_m[0] == pytest.approx(0.2)
    # One that looks the other way, is before the pane by more than a wall's depth, or far along it, is not its wall.
    for other in (((0.9, 0.0), (0.0, 0.0)), ((0.0, 0.6), (0.9, 0.6)), ((-3.0, 0.0), (-2.0, 0.0))):
        np.testing.assert_allclose(set_in_walls(front, faces(other), FRONTS).ends, front.ends)
    assert len(set_in_walls(NO_WINDOWS, beside, FRONTS)) == 0


