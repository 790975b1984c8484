"""Walls are drawn with holes for their openings."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.building.model import NO_DOORS, NO_WINDOWS, Doors, Windows, unknown_support
from ffmap.app.record.wall_panels import wall_panels
from tests.faces import doors, faces, window

WALL_M = 4
HIGH = Windows(
    *(np.array(v) for v in ([[[1.0, 0], [2, 0]]], [[0, 1]], [3.0], [4.0], [0.1])),
    unknown_support(1),
)
"""A window above the wall."""


@pytest.mark.parametrize(
    ("openings", "windows", "expected"),
    [
        (NO_DOORS, NO_WINDOWS, [(0, 4, 0, 2.8)]),
        (
            doors(((1.9, 0), (1.0, 0))),
            window((2.5, 0), (3.5, 0)),
            [
                *((0, 1, 0, 2.8), (1, 1.9, 2.1, 2.8), (1.9, 2.5, 0, 2.8)),
                *((2.5, 3.5, 0, 0.9), (2.5, 3.5, 2.2, 2.8), (3.5, 4, 0, 2.8)),
            ],
        ),
        (
            doors(((1, 0), (2, 0)), ((1.5, 0), (2.5, 0))),  # they overlap
            NO_WINDOWS,
            [
                *((0, 1, 0, 2.8), (1, 1.5, 2.1, 2.8), (1.5, 2, 2.1, 2.8), (2, 2.5, 2.1, 2.8)),
                (2.5, 4, 0, 2.8),
            ],
        ),
        (doors(((-1, 0), (1, 0))), NO_WINDOWS, [(0, 1, 2.1, 2.8), (1, 4, 0, 2.8)]),
        (doors(((1, 0), (2, 0)), head_m=3.0), NO_WINDOWS, [(0, 1, 0, 2.8), (2, 4, 0, 2.8)]),
        (NO_DOORS, HIGH, [(0, 1, 0, 2.8), (1, 2, 0, 2.8), (2, 4, 0, 2.8)]),
    ],
    ids=["none", "door and window", "overlapping", "over an end", "up to the ceiling", "above"],
)
def test_panels_cover_a_wall_but_its_openings(
    openings: Doors, windows: Windows, expected: list[tuple[float, ...]]
) -> None:
    panels = wall_panels(faces(((0, 0), (WALL_M, 0))), openings, windows)
    left, right = np.sort(panels.ends[..., 0], axis=1).T
    found = np.round(np.column_stack([left, right, panels.bottom_m, panels.top_m]), 6)
    assert sorted(map(tuple, found.tolist())) == expected


def test_a_door_pierces_both_faces_of_its_wall_and_no_other_wall() -> None:
    both = faces(((0, 0), (4, 0)), ((4, -0.2), (0, -0.2)), ((0, 2), (4, 2)))
    panels = wall_panels(both, doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert np.bincount(panels.wall).tolist() == [3, 3, 1]
    across = wall_panels(faces(((1.5, -2), (1.5, 2))), doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert len(across.wall) == 1
    no_length = replace(faces(((1, 1), (2, 1))), ends=np.ones((1, 2, 2)))
    assert len(wall_panels(no_length, doors(((1, 0), (2, 0))), NO_WINDOWS).wall) == 0
