"""Faces that planes of scans put askew come to lie along what all scans returned."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.face_alignment import (
    AlignedFaces,
    FaceAlignmentSettings,
    align_faces,
)
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.model import NO_WALLS, Walls, unknown_support
from ffmap.algorithms.building.storey import Storey
from tests.voting import vote

TURNS = [0.0, 31.0, 90.0, 203.0]


def aligned_by(walls: Walls, votes: VoxelVotes) -> AlignedFaces:
    storey = Storey.of(votes, (), LevelsSettings())
    return align_faces(walls, votes, storey, FaceAlignmentSettings())


def turned(places: FloatArray, turn_deg: float) -> FloatArray:
    """Places (…, 2) by so many degrees, and shifted."""
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return places @ np.array([[c, s], [-s, c]]) + [1.3, -2.7]


def surface(
    start: float, stop: float, before_m: float = 0.0, low_m: float = 0.1, high_m: float = 2.7, noise_m: float = 0.006
) -> FloatArray:
    """(n, 3) returns of an upright surface along x, so far before y = 0."""
    generator = np.random.default_rng(5)
    count = int(8000 * (stop - start))
    y = before_m + noise_m * generator.standard_normal(count)
    return np.column_stack([generator.uniform(start, stop, count), y, generator.uniform(low_m, high_m, count)])


def votes_of(turn_deg: float, *surfaces: FloatArray, label: Label = Label.WALL) -> VoxelVotes:
    points = np.concatenate(surfaces)
    placed = np.column_stack([turned(points[:, :2], turn_deg), points[:, 2]])
    return vote(placed, np.full(len(placed), label, np.uint8), len(Label), 0.05)


def face(turn_deg: float, start: float, stop: float, off_start_m: float, off_stop_m: float) -> Walls:
    """Along x, its ends so far off y = 0, to which side its normal points."""
    ends = turned(np.array([[start, off_start_m], [stop, off_stop_m]]), turn_deg)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    one = np.ones(1)
    normal = np.array([[-along[1], along[0]]])
    counts = np.array([3], np.int32), 0.01 * one, np.array([900])
    return Walls(ends[None], normal, 0 * one, 2.7 * one, *counts, unknown_support(1))


def off_m(walls: Walls, turn_deg: float) -> FloatArray:
    """(2,) how far the ends of the one face lie from y = 0."""
    return np.asarray(turned(np.zeros((1, 2)), turn_deg) - walls.ends[0]) @ (
        turned(np.array([0.0, -1.0]), turn_deg) - [1.3, -2.7]
    )


@pytest.mark.parametrize("turn_deg", TURNS)
def test_a_pillars_side_that_was_off_by_eight_degrees_comes_to_lie_along_its_returns(turn_deg: float) -> None:
    fused = face(turn_deg, 0.0, 0.45, -0.03, 0.035)
    aligned = aligned_by(fused, votes_of(turn_deg, surface(0.0, 0.45)))
    np.testing.assert_allclose(off_m(aligned.walls, turn_deg), 0.0, atol=0.003)
    np.testing.assert_allclose(aligned.moved_m, [[0.03, -0.035]], atol=0.004)
    assert aligned.fused is fused
    towards_room = turned(np.array([0.0, 1.0]), turn_deg) - turned(np.zeros(2), turn_deg)
    np.testing.assert_allclose(aligned.walls.normal[0], towards_room, atol=0.015)


@pytest.mark.parametrize("turn_deg", TURNS)
def test_a_plane_that_runs_on_to_the_wall_behind_comes_to_lie_along_the_surface_that_most_columns_show(
    turn_deg: float,
) -> None:
    """A pillar before its wall: the face lies on the pillar where that is the longer part."""
    votes = votes_of(turn_deg, surface(0.0, 0.5), surface(0.5, 0.75, before_m=-0.12))
    aligned = aligned_by(face(turn_deg, 0.0, 0.6, 0.02, -0.05), votes)
    np.testing.assert_allclose(off_m(aligned.walls, turn_deg), 0.0, atol=0.004)


def test_what_stands_before_a_wall_does_not_move_it_while_the_wall_shows_above() -> None:
    cupboards = surface(0.2, 3.8, before_m=0.03, high_m=1.9)
    above = surface(0.0, 4.0, low_m=1.9)
    aligned = aligned_by(face(0.0, 0.0, 4.0, 0.0, 0.0), votes_of(0.0, cupboards, cupboards, above))
    np.testing.assert_allclose(aligned.moved_m, 0.0, atol=0.002)


def test_above_heads_is_told_from_the_floor_that_a_ramp_has_raised() -> None:
    floor = surface(0.0, 4.0, before_m=0.2, low_m=0.5, high_m=0.5)
    cupboards = surface(0.2, 3.8, before_m=0.03, low_m=0.5, high_m=2.5)
    above = surface(0.0, 4.0, low_m=2.5, high_m=3.2)
    points = np.concatenate([*[cupboards] * 8, above])
    placed = np.column_stack([turned(points[:, :2], 0.0), points[:, 2]])
    ground = np.column_stack([turned(floor[:, :2], 0.0), floor[:, 2]])
    label = np.repeat(np.array([Label.WALL, Label.FLOOR], np.uint8), [len(placed), len(ground)])
    aligned = aligned_by(face(0.0, 0.0, 4.0, 0.0, 0.0), vote(np.concatenate([placed, ground]), label, len(Label), 0.05))
    np.testing.assert_allclose(aligned.moved_m, 0.0, atol=0.004)


def test_where_nothing_shows_above_a_leaf_that_is_broader_than_its_wall_does_not_move_it() -> None:
    """Below a duct; the wall shows on both sides of the leaf, 4 cm before it."""
    low = [surface(a, b, off, high_m=1.9) for a, b, off in ((0, 0.6, 0), (0.6, 1.5, -0.04), (1.5, 1.65, 0))]
    aligned = aligned_by(face(0.0, 0.0, 1.65, -0.02, -0.02), votes_of(0.0, *low))
    np.testing.assert_allclose(aligned.moved_m, 0.02, atol=0.003)


@pytest.mark.parametrize("label", [Label.FLOOR, Label.CEILING])
def test_floor_and_ceiling_move_nothing(label: Label) -> None:
    votes = votes_of(0.0, surface(0.0, 1.0, before_m=0.04), label=label)
    aligned = aligned_by(face(0.0, 0.0, 1.0, 0.0, 0.0), votes)
    assert (aligned.moved_m == 0).all()
    np.testing.assert_array_equal(aligned.walls.ends, aligned.fused.ends)


def test_a_face_without_returns_stays_and_no_faces_are_none() -> None:
    far = votes_of(0.0, surface(5.0, 6.0))
    stays = aligned_by(face(0.0, 0.0, 1.0, 0.01, 0.02), far)
    assert (stays.moved_m == 0).all()
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    assert (aligned_by(face(0.0, 0.0, 1.0, 0.01, 0.02), nothing).moved_m == 0).all()
    assert len(aligned_by(NO_WALLS, far).walls) == 0


def test_faces_do_not_depend_on_each_others_order() -> None:
    votes = votes_of(0.0, surface(0.0, 0.5), surface(2.0, 4.0))
    both = face(0.0, 0.0, 0.5, 0.03, -0.02).append(face(0.0, 2.0, 4.0, -0.01, 0.015))
    aligned = aligned_by(both, votes)
    swapped = aligned_by(both.select(np.array([1, 0])), votes)
    np.testing.assert_array_equal(aligned.walls.ends[::-1], swapped.walls.ends)
    np.testing.assert_allclose(aligned.walls.ends[:, :, 1] + 2.7, 0.0, atol=0.003)


def test_a_face_that_returned_from_one_end_alone_is_not_turned_by_it() -> None:
    aligned = aligned_by(face(0.0, 0.0, 6.0, 0.0, 0.0), votes_of(0.0, surface(0.0, 0.2, before_m=0.03)))
    assert (aligned.moved_m == 0).all()


def test_every_column_has_one_vote_however_often_it_was_seen() -> None:
    """A pillar's side of 20 cm, looked at for long, and 80 cm of wall 4 cm behind it."""
    often = [surface(0.0, 0.2, before_m=0.02)] * 9
    aligned = aligned_by(face(0.0, 0.0, 1.0, 0.0, 0.0), votes_of(0.0, surface(0.2, 1.0, before_m=-0.02), *often))
    np.testing.assert_allclose(aligned.moved_m, -0.02, atol=0.004)


def test_where_the_wall_shows_above_the_longest_surface_is_not_asked_for() -> None:
    """A pillar before its wall, of which the face's other end holds a little as well, in line with the pillar's far edge."""
    votes = votes_of(0.0, surface(0.0, 0.5), surface(0.5, 0.75, before_m=-0.05))
    aligned = aligned_by(face(0.0, 0.0, 0.75, 0.0, 0.0), votes)
    np.testing.assert_allclose(aligned.moved_m, 0.0, atol=0.006)


def test_a_few_columns_at_either_end_are_no_longer_surface_than_what_most_columns_show() -> None:
    """Below a duct: scatter behind both ends of what is seen of the wall."""
    scatter = [surface(a, b, before_m=-0.058, high_m=1.9) for a, b in ((0.03, 0.15), (1.35, 1.47))]
    aligned = aligned_by(face(0.0, 0.0, 1.5, 0.0, 0.0), votes_of(0.0, surface(0.15, 1.35, high_m=1.9), *scatter))
    np.testing.assert_allclose(aligned.moved_m, 0.0, atol=0.004)


def test_the_wall_around_the_corner_does_not_turn_a_face() -> None:
    across = surface(0.0, 0.07)[:, [1, 0, 2]] + [0.02, 0.0, 0.0]
    corner = votes_of(0.0, surface(0.0, 0.3), *[across] * 20)
    aligned = aligned_by(face(0.0, 0.0, 0.3, 0.0, 0.0), corner)
    np.testing.assert_allclose(aligned.moved_m, 0.0, atol=0.005)
