"""Walls that end below the ceiling, of which both sides are seen, and what is none of these."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.building.evidence import BEYOND, ON
from ffmap.algorithms.building.low_walls import LowWallsSettings, along_low_walls, find_low_walls
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, BuildingSettings, Walls
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import ParsedFaces
from tests.faces import faces, traced
from tests.painted import Painted, evidence_of

SETTINGS = LowWallsSettings()


def parsed_of(walls: Walls, painted: list[Painted], ceiling_m: float = 2.8) -> ParsedFaces:
    known = traced(walls, evidence_of(*painted), ceiling_m)
    return ParsedFaces.of(known, np.zeros((0, 2)), BuildingSettings(), ParseSettings())


@dataclass(frozen=True)
class LowWall:
    """From (0, 0) along x, its sides at y = 0 and y = -thickness_m, turned in the map.

    tops_m: how high its sides are. shown: which of them are seen. shift_m: of the other side along
    x. askew_m: of the other side's far end. smeared_m: of the first side's second line. post_m:
    rays pass but between these places.
    """

    thickness_m: float = 0.14
    length_m: float = 3.0
    tops_m: tuple[float, float] = (1.1, 1.1)
    shown: tuple[bool, bool] = (True, True)
    shift_m: float = 0.0
    askew_m: float = 0.0
    smeared_m: float | None = None
    post_m: tuple[float, float] = (0.0, 9.0)
    turn_deg: float = 0.0
    ceiling_m: float = 2.8

    def to_map(self, places: FloatArray) -> FloatArray:
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        turned = np.asarray(places, float) @ np.array([[c, s], [-s, c]])
        return turned + np.array([2.1, -3.3]) * (self.turn_deg != 0.0)

    @property
    def sides(self) -> Walls:
        (x, y), shift = (self.length_m, -self.thickness_m), self.shift_m
        lines = [[[0.0, 0.0], [x, 0.0]], [[x + shift, y - self.askew_m], [shift, y]]]
        if self.smeared_m is not None:
            lines.append([[0.0, self.smeared_m], [x, self.smeared_m]])
        ends = [self.to_map(np.array(line)) for line in lines]
        return faces(*[tuple(map(tuple, line)) for line in ends])  # type: ignore[misc]

    def found(self, walls: Walls = NO_WALLS) -> Walls:
        painted = []
        for side in range(len(self.sides)):
            face = Painted(int(np.ceil(lengths_m(self.sides.ends)[side] / CELL_M)))
            face.paint((0.0, self.length_m + 1.0), (0.0, self.ceiling_m - 0.05), BEYOND)
            own = side % 2
            if self.shown[own]:
                face.paint(self.post_m, (0.0, self.tops_m[own]), ON)
            painted.append(face)
        return find_low_walls(parsed_of(self.sides, painted, self.ceiling_m), walls, SETTINGS)


@pytest.mark.parametrize("turn_deg", [0.0, 31.0, 160.0])
@pytest.mark.parametrize("thickness_m", [0.08, 0.14, 0.24])
@pytest.mark.parametrize("top_m", [0.8, 1.1, 2.1])
def test_both_sides_of_a_wall_that_ends_low_are_found(
    top_m: float, thickness_m: float, turn_deg: float
) -> None:
    wall = LowWall(thickness_m, tops_m=(top_m, top_m), turn_deg=turn_deg)
    sides = wall.found()
    assert len(sides) == 2
    np.testing.assert_allclose(lengths_m(sides.ends), wall.length_m)
    np.testing.assert_allclose(sides.ends, wall.sides.ends, atol=1e-9)
    np.testing.assert_allclose(sides.top_m, top_m, atol=CELL_M)
    assert sides.normal[0] @ sides.normal[1] == pytest.approx(-1.0)


@pytest.mark.parametrize(
    "wall",
    [
        LowWall(thickness_m=0.04),  # a screen, or a leaf
        LowWall(thickness_m=0.3),  # a cupboard
        LowWall(tops_m=(1.1, 0.8)),  # two things
        LowWall(tops_m=(0.6, 0.6)),  # a bench
        LowWall(length_m=0.6),
        LowWall(shown=(True, False)),  # a cupboard with its back to a wall
        LowWall(post_m=(1.2, 1.8)),
        LowWall(shift_m=2.0),  # beside each other over less than half
        LowWall(askew_m=0.25),
    ],
)
def test_what_is_no_wall_is_not_found(wall: LowWall) -> None:
    assert len(wall.found()) == 0


def test_the_two_sides_may_be_seen_from_here_to_there_and_be_askew_by_a_little() -> None:
    assert len(LowWall(shift_m=0.5).found()) == len(LowWall(askew_m=0.05).found()) == 2


def test_a_side_that_drift_has_smeared_is_found_once() -> None:
    assert len(LowWall(smeared_m=0.04).found()) == 2


def room_wall(y: float, top_m: float = 2.6, towards: float = -1.0) -> Walls:
    """The face of a known wall along x."""
    face, normal = faces(((0.0, y), (3.0, y))), np.array([[0.0, towards]])
    return replace(face, normal=normal, top_m=np.array([top_m]))


@pytest.mark.parametrize(
    ("y", "top_m", "is_outside"),
    [
        (-0.1, 2.7, True),
        (-0.3, 2.6, True),
        (-0.1, 1.1, False),
        (-0.45, 2.7, False),
        (-0.04, 2.7, False),
    ],
)
def test_the_outside_of_a_room_within_a_room_is_as_high_as_its_wall_is_within(
    y: float, top_m: float, is_outside: bool
) -> None:
    box = LowWall(tops_m=(top_m, 0.0), shown=(True, False), ceiling_m=3.6)
    replaced = box.found(room_wall(y))
    assert len(replaced) == int(is_outside)
    # In a room no higher than the one within, it is furniture that hides the wall.
    assert len(replace(box, ceiling_m=2.7).found(room_wall(y))) == 0
    # What looks the same way as the wall stands against it.
    assert len(box.found(room_wall(y, towards=1.0))) == 0


def test_where_there_are_no_lines_there_is_no_low_wall() -> None:
    assert len(find_low_walls(parsed_of(NO_WALLS, []), room_wall(0.0), SETTINGS)) == 0


def test_what_a_low_walls_side_says_of_itself() -> None:
    side = LowWall().found().select([0])
    assert np.isnan(side.rms_m[0])
    assert side.sample_count[0] == 8 * round(3.0 / CELL_M) * round(1.1 / CELL_M)
    (face,) = segments(side)
    assert face.before_m(np.array([1.0, 1.0])) == pytest.approx(1.0)


def test_faces_along_a_low_wall_are_no_longer_refused() -> None:
    sides = LowWall().found()
    along, beyond = ((0.2, 0.02), (2.5, 0.02)), ((2.0, 0.0), (9.0, 0.0))
    before, beside = ((0.2, 0.4), (2.5, 0.4)), ((4.0, 0.0), (5.0, 0.0))
    refused = faces(along, before, beside, ((0.2, 0.0), (2.0, 0.0)), beyond)
    up, across = [0.0, 1.0], [1.0, 0.0]
    refused = replace(refused, normal=np.array([up, up, up, across, up]))
    assert along_low_walls(refused, sides, 0.1).tolist() == [True, False, False, False, False]
    assert not along_low_walls(refused, NO_WALLS, 0.1).any()
