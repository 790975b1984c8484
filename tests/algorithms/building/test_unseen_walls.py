"""Walls that no scan shows as a plane: lines in the voxels of all scans, and which of them stand."""

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.evidence import BEYOND, ON
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.model import NO_WALLS, BuildingSettings, Walls
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.building.storey import Storey, TracedFaces
from ffmap.algorithms.building.unseen_walls import (
    Columns,
    UnseenWallsSettings,
    both_sides,
    lines_of_any_direction,
    straight_lines,
    unexplained_columns,
    walls_of,
)
from ffmap.algorithms.building.verdicts import wall_directions
from tests.faces import CEILING_M, faces
from tests.painted import Painted, evidence_of
from tests.voting import vote

SIZES, SETTINGS = BuildingSettings(), UnseenWallsSettings()
KNOWN = faces(((-1.0, 0.0), (5.0, 0.0)))


def columns(start: tuple[float, float], stop: tuple[float, float], seed: int = 0) -> FloatArray:
    """(n, 2) columns of returns, 5 cm apart, on a line with a centimetre of noise."""
    count = int(np.hypot(*np.subtract(stop, start)) / 0.05)
    on = np.linspace(start, stop, count)
    return on + np.random.default_rng(seed).normal(0.0, 0.008, on.shape)


def many(place: FloatArray) -> Columns:
    """Columns of many voxels."""
    return Columns(place, np.full(len(place), 9.0), np.full(len(place), CEILING_M))


@pytest.mark.parametrize("turn_deg", [0.0, 17.0, 63.0])
def test_lines_along_the_walls_are_found_strongest_first(turn_deg: float) -> None:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turn = np.array([[c, s], [-s, c]])
    stray = np.random.default_rng(1).uniform(0.0, 3.0, (15, 2))
    place = [columns((3.0, 0.5), (3.0, 2.0)), columns((0.0, 2.5), (2.5, 2.5), seed=2), stray]
    lines = straight_lines(many(np.concatenate(place) @ turn), np.eye(2) @ turn, 0.6, SETTINGS)
    ends = np.array([ends for ends, _ in lines[:2]]) @ turn.T
    expected = [[[0.0, 2.5], [2.5, 2.5]], [[3.0, 0.5], [3.0, 2.0]]]
    np.testing.assert_allclose(np.sort(ends, axis=1), expected, atol=0.06)
    np.testing.assert_allclose([ends[0, :, 1] - 2.5, ends[1, :, 0] - 3.0], 0.0, atol=0.01)


def test_a_straight_line_has_no_gap_longer_than_a_walls() -> None:
    place = np.concatenate([columns((0.0, 0.0), (2.0, 0.0)), columns((3.0, 0.0), (4.0, 0.0))])
    for gap_m, count in ((0.6, 2), (1.2, 1)):
        found = straight_lines(many(place), np.array([[0.0, 1.0]]), gap_m, SETTINGS)
        assert len(found) == count
    assert straight_lines(many(place), np.zeros((0, 2)), 0.6, SETTINGS) == []


def test_a_round_wall_is_found_as_chords_and_what_is_strewn_is_none() -> None:
    angle = np.arange(-1.3, 1.3, 0.05 / 1.5)
    arc = 1.5 * np.column_stack([np.cos(angle), np.sin(angle)])
    arc += np.random.default_rng(0).normal(0.0, 0.004, arc.shape)
    lines = lines_of_any_direction(arc, SETTINGS)
    ends = np.array([ends for ends, _ in lines])
    np.testing.assert_allclose(np.linalg.norm(ends.mean(axis=1), axis=1), 1.5, atol=0.05)
    assert 0.6 < lengths_m(ends).sum() / (2.6 * 1.5) < 1.1
    strewn = np.random.default_rng(0).uniform(0.0, 3.0, (60, 2))
    for places in (strewn, strewn[:0]):
        assert lines_of_any_direction(places, SETTINGS) == []


def room(top_m: float = CEILING_M) -> VoxelVotes:
    """Floor, ceiling, the known wall at y = 0, and clutter at x = 3 from y = 0.5 to 2."""
    generator = np.random.default_rng(0)

    def spread(low: tuple[float, ...], high: tuple[float, ...], count: int) -> FloatArray:
        return generator.uniform(low, high, (count, 3)) + generator.normal(0, 0.008, (count, 3))

    parts = [
        (spread((-1, 0, 0), (5, 3, 0), 40_000), Label.FLOOR),
        (spread((-1, 0, CEILING_M), (5, 3, CEILING_M), 40_000), Label.CEILING),
        (spread((-1, 0, 0), (5, 0, CEILING_M), 9_000), Label.WALL),
        (spread((3, 0.5, 0), (3, 2, top_m), 4_000), Label.CLUTTER),
    ]
    label = np.repeat([code for _, code in parts], [len(points) for points, _ in parts])
    return vote(np.concatenate([points for points, _ in parts]), label, len(Label), 0.05)


def found(
    top_m: float = CEILING_M,
    known: Walls = KNOWN,
    refused: Walls = NO_WALLS,
    seen_m: float = CEILING_M,
    door_m: float = 0.0,
    scatter_m: float = 0.01,
) -> Walls:
    """Rays from smaller x end on what stands at x = 3 and pass above it, and all else.

    seen_m: above it no ray comes to x = 3. door_m: width of a doorway there. scatter_m: of what
    returns.
    """
    votes, storey = room(top_m), Storey.of(room(top_m), (), LevelsSettings())

    columns = unexplained_columns(votes, known.append(refused), SETTINGS)
    lines = straight_lines(columns, wall_directions(known, 0.04), SIZES.gap_m, SETTINGS)
    candidates = both_sides(lines)
    painted = []
    for face, normal in zip(segments(candidates), candidates.normal, strict=True):
        own = Painted(int(np.ceil(face.length_m / 0.05)))
        own.paint((0.0, 99.0), (0.0, CEILING_M), BEYOND)
        if normal[0] < -0.9 and np.abs(face.start[0] - 3.0) < 0.03:
            own.paint((0.0, 99.0), (0.0, top_m), ON)
            own.paint((0.0, 99.0), (seen_m, 3.0), ON, rays=0.0)
            own.paint((0.3, 0.3 + door_m), (0.0, 2.1), BEYOND)
        painted.append(own)
    traced = TracedFaces.of(candidates, evidence_of(*painted, scatter_m=scatter_m), storey)
    parsed = ParsedFaces.of(traced, np.zeros((0, 2)), SIZES, ParseSettings())
    walls, runs = walls_of(parsed, np.arange(len(candidates)), known, SIZES, SETTINGS)
    assert len(walls) == len(runs)
    return walls


def test_a_wall_that_no_scan_alone_told_is_found_on_the_side_that_it_is_seen_from() -> None:
    walls = found()
    np.testing.assert_allclose(np.sort(walls.ends, axis=1), [[[3.0, 0.5], [3.0, 2.0]]], atol=0.1)
    np.testing.assert_allclose(walls.normal[0], [-1.0, 0.0], atol=0.02)
    assert walls.scan_count.tolist() == [0]


def test_furniture_is_no_wall_nor_what_faces_explain() -> None:
    assert len(found(top_m=1.9)) == 0
    same = faces(((3.02, 0.5), (3.02, 2.0)))
    assert len(found(refused=same)) == len(found(known=KNOWN.append(same))) == 0
    # Between two walls that look at each other there is room.
    assert len(found(known=KNOWN.append(faces(((2.8, 3.0), (2.8, 0.0)))))) == 0


@pytest.mark.parametrize(("scatter_m", "count"), [(0.045, 1), (0.06, 0)])
def test_what_is_strewn_about_a_line_is_no_wall(scatter_m: float, count: int) -> None:
    assert len(found(scatter_m=scatter_m)) == count


def test_an_unseen_wall_is_as_high_as_its_returns() -> None:
    assert found().top_m == pytest.approx(CEILING_M, abs=0.1)


@pytest.mark.parametrize(("seen_m", "count"), [(2.1, 0), (2.4, 1)])
def test_what_shows_no_higher_than_heads_is_a_leaf_or_a_reveal(seen_m: float, count: int) -> None:
    assert len(found(seen_m=seen_m)) == count


@pytest.mark.parametrize(("door_m", "count"), [(0.65, 1), (0.9, 0)])
def test_a_line_that_is_doorway_for_the_most_part_is_no_wall(door_m: float, count: int) -> None:
    assert len(found(door_m=door_m)) == count
