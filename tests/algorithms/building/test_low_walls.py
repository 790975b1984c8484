"""Walls that end below the ceiling, by cells of their sides; what is too deep, too thin or shows one side alone is none."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.building.face_columns import TracedFaces
from ffmap.algorithms.building.low_walls import LowWallsSettings, find_low_walls, without_low_walls
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Walls
from ffmap.algorithms.building.ray_evidence import (
    FILLED,
    SQUARES,
    THROUGH,
    WallCells,
    first_columns,
)
from ffmap.algorithms.building.unexplained_lines import Line
from tests.faces import faces, traced

BUILDING, SETTINGS = BuildingSettings(), LowWallsSettings()
ROWS = 60


@dataclass(frozen=True)
class LowWall:
    """From (0, 0) along x, its sides at y = 0 and y = -thickness_m, as high as `tops_m` above the floor, turned in the map.

    shown: which of its sides are seen. scatter_m: of their returns. gaps: which columns rays pass.
    passed: how many rays pass each cell, of ten that end there. window_m: between these places rays pass above a sill.
    foot_m: what stands before its sides hides them up to there. ceiling_m: of the rooms on both its sides.
    """

    thickness_m: float = 0.14
    length_m: float = 3.0
    tops_m: tuple[float, float] = (1.1, 1.1)
    shown: tuple[bool, bool] = (True, True)
    scatter_m: float = 0.006
    gaps: tuple[slice, ...] = ()
    passed: float = 0.0
    window_m: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    foot_m: float = 0.0
    ceiling_m: float = 3.6

    def to_map(self, places: np.ndarray) -> np.ndarray:
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        return places @ np.array([[c, s], [-s, c]])

    @property
    def lines(self) -> list[Line]:
        normal = self.to_map(np.array([0.0, 1.0]))
        sides = (np.array([[0.0, -y], [self.length_m, -y]]) for y in (0.0, self.thickness_m))
        return [(self.to_map(ends), normal) for ends in sides]

    def trace(self, asked: Walls) -> TracedFaces:
        first = first_columns(asked)
        cells = WallCells(first, ROWS, np.zeros((first[-1], ROWS, 4), np.float32))
        origin = self.to_map(np.array([0.0, -0.5 * self.thickness_m]))
        for k, face in enumerate(segments(asked)):
            if face.before_m(origin) > 0.0:
                continue  # from there, the wall's other side hides it
            side = int(np.argmin([abs(float(face.before_m(ends[0]))) for ends, _ in self.lines]))
            counts = cells.counts[first[k] : first[k + 1]]
            counts[..., THROUGH] = 10.0
            top = round(self.tops_m[side] / CELL_M)
            if self.shown[side]:
                counts[:, :top, THROUGH] = self.passed
                counts[:, :top, FILLED], counts[:, :top, SQUARES] = 10.0, 10.0 * self.scatter_m**2
            for gap in self.gaps:
                counts[gap, :, :THROUGH], counts[gap, :, THROUGH] = 0.0, 10.0
            counts[:, : round(self.foot_m / CELL_M)] = 0.0
            window = slice(*(round(place / CELL_M) for place in self.window_m))
            counts[window, 20:, [FILLED]], counts[window, 20:, THROUGH] = 0.0, 10.0
        return traced(asked, cells, self.ceiling_m)


def found(wall: LowWall, walls: Walls = NO_WALLS, settings: LowWallsSettings = SETTINGS) -> Walls:
    return find_low_walls(wall.lines, walls, wall.trace, BUILDING, settings)


@pytest.mark.parametrize("turn_deg", [0.0, 31.0, 160.0])
@pytest.mark.parametrize("thickness_m", [0.08, 0.14, 0.24])
@pytest.mark.parametrize("top_m", [0.8, 1.1, 2.1])
def test_both_sides_of_a_wall_that_ends_low_are_found(top_m: float, thickness_m: float, turn_deg: float) -> None:
    wall = LowWall(thickness_m, tops_m=(top_m, top_m), turn_deg=turn_deg)
    sides = found(wall)
    assert len(sides) == 2
    np.testing.assert_allclose(lengths_m(sides.ends), wall.length_m)
    np.testing.assert_allclose(sides.top_m, top_m, atol=CELL_M)
    assert sides.normal[0] @ sides.normal[1] == pytest.approx(-1.0)
    outside = wall.to_map(np.array([[1.0, 1.0], [1.0, -1.0]]))
    assert sorted(int(np.argmax([face.before_m(place) for place in outside])) for face in segments(sides)) == [0, 1]


@pytest.mark.parametrize(
    "wall",
    [
        LowWall(thickness_m=0.04),  # a screen, or a leaf
        LowWall(thickness_m=0.3),  # a cupboard
        LowWall(tops_m=(1.1, 0.8)),  # two things
        LowWall(tops_m=(0.6, 0.6)),  # a bench
        LowWall(length_m=0.6),
        LowWall(shown=(True, False)),  # a cupboard with its back to a wall
        LowWall(scatter_m=0.05),  # books, and the shelf's back
        LowWall(gaps=tuple(slice(k, k + 5) for k in range(4, 60, 9))),  # the posts of a rack
        LowWall(gaps=(slice(0, 24), slice(36, 60))),  # a post of 0.6 m
        LowWall(passed=4.0),  # wire mesh
        LowWall(foot_m=0.6),  # the back of a sofa
    ],
)
def test_what_is_no_wall_is_not_found(wall: LowWall) -> None:
    assert len(found(wall)) == 0


def test_what_lies_beside_another_over_less_than_half_of_it_is_not_its_other_side() -> None:
    wall = LowWall()
    (ends, normal), (behind, _) = wall.lines
    for shift_m, count in ((0.5, 2), (2.0, 0)):
        lines = [(ends, normal), (behind + np.array([shift_m, 0.0]), normal)]
        assert len(find_low_walls(lines, NO_WALLS, wall.trace, BUILDING, SETTINGS)) == count


def test_a_side_that_drift_has_smeared_is_found_once() -> None:
    wall = LowWall()
    smeared = (wall.lines[0][0] + np.array([0.0, 0.04]), wall.lines[0][1])
    assert len(find_low_walls([*wall.lines, smeared], NO_WALLS, wall.trace, BUILDING, SETTINGS)) == 2


def test_faces_at_an_angle_are_not_two_sides_of_a_wall() -> None:
    wall = LowWall()
    for off_m, count in ((0.05, 2), (0.2, 0)):
        askew = (wall.lines[1][0] + np.array([[0.0, 0.0], [0.0, -off_m]]), np.array([off_m / 3.0, 1.0]))
        askew = (askew[0], askew[1] / np.linalg.norm(askew[1]))
        assert len(find_low_walls([wall.lines[0], askew], NO_WALLS, wall.trace, BUILDING, SETTINGS)) == count


def test_how_thick_a_wall_is_counts_where_both_its_sides_are() -> None:
    """A long wall, askew by one degree, is elsewhere by its middle."""
    box = LowWall(tops_m=(2.7, 0.0), shown=(True, False))
    room = room_wall(-0.2)
    long = replace(room, ends=np.array([[[0.0, -0.2], [40.0, -0.2 - 40.0 * np.tan(np.radians(0.9))]]]))
    assert len(found(box, room)) == len(found(box, long)) == 1


def room_wall(y: float, top_m: float = 2.6, towards: float = -1.0) -> Walls:
    """The face of a known wall along x."""
    return replace(faces(((0.0, y), (3.0, y))), normal=np.array([[0.0, towards]]), top_m=np.array([top_m]))


@pytest.mark.parametrize(
    ("y", "top_m", "is_outside"),
    [(-0.1, 2.7, True), (-0.3, 2.6, True), (-0.1, 1.1, False), (-0.45, 2.7, False), (-0.04, 2.7, False)],
)
def test_the_outside_of_a_room_is_as_high_as_its_wall_is_within(y: float, top_m: float, is_outside: bool) -> None:
    """A box in a hall: of its wall, whose inner face reaches the box's own ceiling, rays pass above the outer one."""
    box = LowWall(tops_m=(top_m, 0.0), shown=(True, False))
    sides = found(box, room_wall(y))
    assert len(sides) == int(is_outside)
    # In a room no higher than the one within, it is furniture that hides the wall.
    assert len(found(replace(box, ceiling_m=2.65), room_wall(y))) == 0
    # A window in it leaves it a wall.
    assert len(found(replace(box, window_m=(0.5, 2.2)), room_wall(y))) == int(is_outside)


def test_what_stands_against_a_wall_is_no_side_of_it() -> None:
    shelf = LowWall(tops_m=(2.6, 0.0), shown=(True, False))
    assert len(found(shelf, room_wall(-0.35))) == 1
    own_face = room_wall(-0.25, towards=1.0)
    assert len(found(shelf, room_wall(-0.35).append(own_face))) == 0


def test_where_there_are_no_lines_there_is_no_low_wall() -> None:
    def never(_: Walls) -> TracedFaces:
        raise AssertionError

    trace: Callable[[Walls], TracedFaces] = never
    assert len(find_low_walls([], room_wall(0.0), trace, BUILDING, SETTINGS)) == 0
    # Without another side there is nothing to ask of rays.
    assert len(find_low_walls(LowWall().lines[:1], NO_WALLS, trace, BUILDING, SETTINGS)) == 0


def test_faces_along_a_low_wall_are_no_longer_refused() -> None:
    sides = found(LowWall())
    along, beyond = ((0.2, 0.02), (2.5, 0.02)), ((2.0, 0.0), (9.0, 0.0))
    refused = faces(along, ((0.2, 0.4), (2.5, 0.4)), ((4.0, 0.0), (5.0, 0.0)), ((0.2, 0.0), (2.0, 0.0)), beyond)
    refused = replace(refused, normal=np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]]))
    assert without_low_walls(refused, sides, 0.1).tolist() == [False, True, True, True, True]
    assert without_low_walls(refused, NO_WALLS, 0.1).all()
