"""Walls are drawn with holes where one can go or see through them."""

import numpy as np

from ffmap.algorithms.building.model import NO_WINDOWS, Doors, Walls, Windows
from ffmap.app.record.wall_panels import wall_panels

NO_DOORS = Doors(np.zeros((0, 2, 2)), np.zeros((0, 2)), *(np.zeros(0) for _ in range(15)))  # type: ignore[arg-type]


def walls(*ends: tuple[tuple[float, float], tuple[float, float]], top_m: float = 2.8) -> Walls:
    count = len(ends)
    return Walls(
        ends=np.array(ends),
        normal=np.tile([0.0, 1.0], (count, 1)),
        bottom_m=np.zeros(count),
        top_m=np.full(count, top_m),
        scan_count=np.ones(count, np.int64),
        rms_m=np.zeros(count),
        sample_count=np.ones(count, np.int64),
    )


def doors(*ends: tuple[tuple[float, float], tuple[float, float]], head_m: float = 2.1) -> Doors:
    empty = {name: np.zeros(len(ends)) for name in Doors.__dataclass_fields__}
    return Doors(**empty | {"ends": np.array(ends), "head_m": np.full(len(ends), head_m)})


def window(*ends: tuple[float, float]) -> Windows:
    return Windows(np.array([ends]), np.array([[0.0, 1.0]]), np.array([0.9]), np.array([2.2]), np.array([0.1]))


def rectangles(walls: Walls, doors: Doors, windows: Windows = NO_WINDOWS) -> list[tuple[float, ...]]:
    """Left, right, bottom and top of every panel of walls along x."""
    panels = wall_panels(walls, doors, windows)
    left, right = np.sort(panels.ends[..., 0], axis=1).T
    return sorted(tuple(np.round(r, 6).tolist()) for r in zip(left, right, panels.bottom_m, panels.top_m, strict=True))


def test_a_wall_without_openings_is_one_panel():
    assert rectangles(walls(((0, 0), (4, 0))), NO_DOORS) == [(0, 4, 0, 2.8)]


def test_a_door_is_left_out_up_to_its_head_and_a_window_between_its_heights():
    found = rectangles(walls(((0, 0), (4, 0))), doors(((1.9, 0), (1.0, 0))), window((2.5, 0), (3.5, 0)))
    assert found == [
        (0, 1, 0, 2.8),
        (1, 1.9, 2.1, 2.8),
        (1.9, 2.5, 0, 2.8),
        (2.5, 3.5, 0, 0.9),
        (2.5, 3.5, 2.2, 2.8),
        (3.5, 4, 0, 2.8),
    ]


def test_a_door_pierces_both_faces_of_its_wall_whichever_way_they_run_and_no_other_wall():
    both = walls(((0, 0), (4, 0)), ((4, -0.2), (0, -0.2)), ((0, 2), (4, 2)))
    panels = wall_panels(both, doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert np.bincount(panels.wall).tolist() == [3, 3, 1]
    across = wall_panels(walls(((1.5, -2), (1.5, 2))), doors(((1, 0), (2, 0))), NO_WINDOWS)
    assert len(across.wall) == 1


def test_openings_may_overlap_reach_over_an_end_or_up_to_the_ceiling():
    wall = walls(((0, 0), (3, 0)))
    overlapping = rectangles(wall, doors(((1, 0), (2, 0)), ((1.5, 0), (2.5, 0))))
    assert overlapping == [(0, 1, 0, 2.8), (1, 1.5, 2.1, 2.8), (1.5, 2, 2.1, 2.8), (2, 2.5, 2.1, 2.8), (2.5, 3, 0, 2.8)]
    assert rectangles(wall, doors(((-1, 0), (1, 0)))) == [(0, 1, 2.1, 2.8), (1, 3, 0, 2.8)]
    assert rectangles(wall, doors(((1, 0), (2, 0)), head_m=3.0)) == [(0, 1, 0, 2.8), (2, 3, 0, 2.8)]
    above = rectangles(
        wall, NO_DOORS, Windows(*(np.array(v) for v in ([[[1.0, 0], [2, 0]]], [[0, 1]], [3.0], [4.0], [0.1])))
    )
    assert above == [(0, 1, 0, 2.8), (1, 2, 0, 2.8), (2, 3, 0, 2.8)]


def test_without_walls_or_with_one_of_no_length_there_are_no_panels():
    assert wall_panels(walls(((1, 1), (1, 1))), doors(((1, 0), (2, 0))), NO_WINDOWS).ends.shape == (0, 2, 2)
