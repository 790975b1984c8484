"""Walls are drawn with holes where one can go or see through them."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.building.model import NO_DOORS, NO_WINDOWS, Doors, Walls, Windows
from ffmap.app.record.wall_panels import wall_panels
from tests.faces import doors, faces, window


def rectangles(walls: Walls, doors: Doors, windows: Windows = NO_WINDOWS) -> list[tuple[float, ...]]:
    """Left, right, bottom and top of every panel of walls along x."""
    panels = wall_panels(walls, doors, windows)
    left, right = np.sort(panels.ends[..., 0], axis=1).T
    return sorted(tuple(np.round(r, 6).tolist()) for r in zip(left, right, panels.bottom_m, panels.top_m, strict=True))


def test_a_wall_without_openings_is_one_panel():
    assert rectangles(faces(((0, 0), (4, 0))), NO_DOORS) == [(0, 4, 0, 2.8)]


def test_a_door_is_left_out_up_to_its_head_and_a_window_between_its_heights():
    found = rectangles(faces(((0, 0), (4, 0))), doors(((1.9, 0), (1.0, 0))), window((2.5, 0), (3.5, 0)))
    assert found == [
        (0, 1, 0, 2.8),
        (1, 1.9, 2.1, 2.8),
        (1.9, 2.5, 0, 2.8),
        (2.5, 3.5, 0, 0.9),
        (2.5, 3.5, 2.2, 2.8),
        (3.5, 4, 0, 2.8),
    ]


def test_a_door_pierces_both_faces_of_its_wall_whichever_way_they_run_and_no_other_wall():
    both = faces(((0, 0), (4, 0)), ((4, -0.2), (0, -0.2)), ((0, 2), (4, 2)))
    panels = wall_panels(both, doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert np.bincount(panels.wall).tolist() == [3, 3, 1]
    across = wall_panels(faces(((1.5, -2), (1.5, 2))), doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert len(across.wall) == 1


def test_openings_may_overlap_reach_over_an_end_or_up_to_the_ceiling():
    wall = faces(((0, 0), (3, 0)))
    overlapping = rectangles(wall, doors(((1, 0), (2, 0)), ((1.5, 0), (2.5, 0))))
    assert overlapping == [(0, 1, 0, 2.8), (1, 1.5, 2.1, 2.8), (1.5, 2, 2.1, 2.8), (2, 2.5, 2.1, 2.8), (2.5, 3, 0, 2.8)]
    assert rectangles(wall, doors(((-1, 0), (1, 0)))) == [(0, 1, 2.1, 2.8), (1, 3, 0, 2.8)]
    assert rectangles(wall, doors(((1, 0), (2, 0)), head_m=3.0)) == [(0, 1, 0, 2.8), (2, 3, 0, 2.8)]
    above = rectangles(
        wall, NO_DOORS, Windows(*(np.array(v) for v in ([[[1.0, 0], [2, 0]]], [[0, 1]], [3.0], [4.0], [0.1])))
    )
    assert above == [(0, 1, 0, 2.8), (1, 2, 0, 2.8), (2, 3, 0, 2.8)]


def test_without_walls_or_with_one_of_no_length_there_are_no_panels():
    none = replace(faces(((1, 1), (2, 1))), ends=np.ones((1, 2, 2)))
    assert wall_panels(none, doors(((1, 0), (2, 0))), NO_WINDOWS).ends.shape == (0, 2, 2)
