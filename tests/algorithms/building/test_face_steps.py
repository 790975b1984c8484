"""Faces that planes of single scans laid across a step are cut there, and nothing else is."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.face_alignment import AlignedFaces
from tests.algorithms.building.test_face_alignment import (
    TURNS,
    aligned_by,
    face,
    surface,
    turned,
    votes_of,
)


def distances_m(aligned: AlignedFaces, turn_deg: float) -> FloatArray:
    """(W, 2) how far before y = 0 the ends of the faces lie, those of least x first."""
    inwards = turned(np.array([0.0, 1.0]), turn_deg) - turned(np.zeros(2), turn_deg)
    return np.asarray((aligned.walls.ends - turned(np.zeros(2), turn_deg)) @ inwards)


WALL = (surface(0.0, 2.0),)


@pytest.mark.parametrize("turn_deg", TURNS)
def test_a_wall_and_the_wardrobe_beside_it_that_became_one_face_askew_are_two(turn_deg: float) -> None:
    votes = votes_of(turn_deg, surface(0.0, 2.4), surface(2.4, 3.0, before_m=0.09))
    aligned = aligned_by(face(turn_deg, 0.0, 3.0, -0.03, 0.08), votes)
    np.testing.assert_allclose(distances_m(aligned, turn_deg), [[0.0, 0.0], [0.09, 0.09]], atol=0.004)
    length_m = np.linalg.norm(np.diff(aligned.walls.ends, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(length_m, [2.4, 0.6], atol=0.06)
    np.testing.assert_allclose(aligned.walls.normal @ aligned.fused.normal.T, 1.0, atol=0.002)
    assert aligned.cut.all()
    moved = aligned.fused.ends + aligned.moved_m[..., None] * aligned.fused.normal[:, None]
    np.testing.assert_allclose(aligned.walls.ends, moved, atol=0.001)


def test_a_face_that_steps_twice_becomes_three() -> None:
    votes = votes_of(0.0, surface(0.0, 0.6, before_m=-0.11), surface(0.6, 2.5), surface(2.5, 3.2, before_m=0.09))
    aligned = aligned_by(face(0.0, 0.0, 3.2, -0.12, 0.1), votes)
    np.testing.assert_allclose(distances_m(aligned, 0.0), [[-0.11, -0.11], [0.0, 0.0], [0.09, 0.09]], atol=0.004)


@pytest.mark.parametrize(
    ("what", "surfaces"),
    [
        ("a step that moving bridges", (surface(0.0, 2.0), surface(2.0, 3.0, before_m=0.04))),
        ("a casing, narrower than any wall", (surface(0.0, 2.8), surface(2.8, 3.0, before_m=0.09))),
        ("a duct", (*WALL * 3, surface(2.0, 3.0, high_m=2.0), surface(2.0, 3.0, before_m=0.09, low_m=2.0))),
        ("a cupboard", (*WALL, surface(2.0, 3.0, before_m=0.09, high_m=2.0), surface(2.0, 3.0, low_m=2.0))),
        ("a pane set back, that returns a tenth", (*WALL * 10, surface(2.0, 3.0, before_m=-0.09))),
        ("a pilaster before the wall", (surface(0.0, 1.2), surface(1.2, 1.8, before_m=0.09), surface(1.8, 3.0))),
        ("posts before the wall", tuple(surface(k / 4, (k + 1) / 4, before_m=0.09 * (k % 2)) for k in range(12))),
    ],
)
def test_what_is_no_step_of_a_wall_leaves_its_face_whole(what: str, surfaces: tuple[FloatArray, ...]) -> None:
    aligned = aligned_by(face(0.0, 0.0, 3.0, 0.0, 0.0), votes_of(0.0, *surfaces))
    assert aligned.cut.tolist() == [False], what


def test_a_chord_of_a_round_wall_is_not_cut() -> None:
    """Of a radius of 4 m, fused over 1 m: it is 3 cm deep."""
    angle = np.random.default_rng(3).uniform(-0.125, 0.125, 8000)
    x, y = 0.5 + 4 * np.sin(angle), 4 - 4 * np.cos(angle)
    z = np.random.default_rng(4).uniform(0.1, 2.7, len(angle))
    aligned = aligned_by(face(0.0, 0.0, 1.0, 0.01, 0.01), votes_of(0.0, np.column_stack([x, y, z])))
    assert len(aligned.walls) == 1
