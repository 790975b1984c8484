"""Spatial indices of faces against brute force."""

from dataclasses import dataclass

import numpy as np
import pytest

from ffmap.algorithms.base.plan_index import (
    SECTORS,
    cell_at,
    enter,
    index_near,
    pairs_near,
    sector_of,
    sectors_around,
)
from ffmap.algorithms.base.segments import segments


@dataclass(frozen=True)
class Lines:
    ends: np.ndarray
    normal: np.ndarray


def scattered(seed: int, count: int = 40) -> Lines:
    generator = np.random.default_rng(seed)
    ends = generator.uniform(-30, 30, (count, 1, 2)) + generator.uniform(-4, 4, (count, 2, 2))
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return Lines(ends, normal / np.linalg.norm(normal, axis=1, keepdims=True))


def listed(index: np.ndarray, x: float, y: float) -> list[int]:
    p = cell_at(index, x, y)
    return index[index[p] : index[p + 1]].tolist()


@pytest.mark.parametrize("reach_m", [0.06, 0.65, 3.0])
def test_every_face_within_reach_is_listed_in_order(reach_m: float) -> None:
    faces = scattered(1)
    index = index_near(faces, reach_m)
    places = np.random.default_rng(2).uniform(-40, 40, (2_000, 2))
    far = np.array([[1e6, -1e6]])
    near = []
    for face in segments(faces):
        nearest = face.at(np.clip(face.place_m(places), 0.0, face.length_m))
        near.append(np.linalg.norm(nearest - places, axis=1) <= reach_m)
    found = [listed(index, x, y) for x, y in places]
    for faces_near, own in zip(np.transpose(near), found, strict=True):
        assert own == sorted(set(own))
        assert set(np.flatnonzero(faces_near)) <= set(own)
    assert np.mean([len(own) for own in found]) < 0.5 * len(faces.ends)
    assert listed(index, *far[0]) == []
    assert listed(index_near(Lines(np.zeros((0, 2, 2)), np.zeros((0, 2))), reach_m), 0.0, 0.0) == []


def test_pairs_are_those_of_brute_force() -> None:
    faces, reach_m = scattered(1), 0.65
    places = np.random.default_rng(2).uniform(-40, 40, (2_000, 2))
    expected = [
        (i, k)
        for k, face in enumerate(segments(faces))
        for i in np.flatnonzero(
            (np.abs(face.before_m(places)) < reach_m) & face.beside(places, reach_m)
        )
    ]
    assert list(zip(*pairs_near(faces, places, reach_m), strict=True)) == sorted(expected)


@pytest.mark.parametrize("seed", range(20))
def test_every_direction_to_a_shape_is_in_its_sectors(seed: int) -> None:
    generator = np.random.default_rng(seed)
    points = generator.uniform(-8, 8, 2) + generator.uniform(-1, 1, (4, 2))
    if np.linalg.norm(points, axis=1).min() < 3:
        points += 6 * np.sign(points.mean(axis=0))
    faces, count = np.zeros((SECTORS, 1), np.int32), np.zeros(SECTORS, np.int64)
    enter(0, *sectors_around(points), faces, count)
    within = generator.dirichlet(np.ones(4), 500) @ points
    assert all(count[sector_of(x, y)] == 1 for x, y in within)
    assert count.sum() < SECTORS / 2
