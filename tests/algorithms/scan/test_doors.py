"""The paper's three door conditions: inputs in which exactly one fails, and in which all hold."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.scan.doors import (
    EXCEPTIONS_MAX,
    Depression,
    DoorLines,
    DoorsSettings,
    DoorState,
    Openings,
    find_door_lines,
    find_openings,
)
from ffmap.algorithms.scan.point_lines import make_point_lines
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import (
    VerticalStructuresSettings,
    find_vertical_structures,
)
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings
from ffmap.algorithms.scan.wall_planes import WallPlanes, grow_wall_planes
from tests.synthetic import scan_of

DOORS = DoorsSettings()
WALL_Y_M, CEILING_M, HEAD_M = 2.0, 2.8, 2.1
ORIGIN = np.array([0.0, 0.0, 1.0])
# The lidar is on its side: its spin axis z points along the level frame's x, its x axis down.
T_LEVEL_SENSOR = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
)

Profile = Callable[[np.ndarray], np.ndarray]
"""How far (m) behind the wall a line's returns are, by the heights at which rays pass the wall."""

WALL_X_M = np.array([-0.9, -0.7, -0.5, -0.3, -0.1, 1.3, 1.5, 1.7, 1.9, 2.1])
DOOR_X_M = np.array([0.3, 0.5, 0.7, 0.9])


def bare(z: np.ndarray) -> np.ndarray:
    return np.zeros_like(z)


def door(depth_m: float, head_m: float = HEAD_M) -> Profile:
    return lambda z: np.where(z < head_m, depth_m, 0.0)


@dataclass(frozen=True)
class Seen:
    """A wall y = 2 seen in upright lines, one at each x, and what the method made of it."""

    planes: WallPlanes
    door_lines: DoorLines
    openings: Openings
    line_at: dict[float, int]

    def rows(self, xs: np.ndarray) -> np.ndarray:
        """The rows of `door_lines` of the lines at some x."""
        lines = [self.line_at[x] for x in xs]
        return np.concatenate([np.flatnonzero(self.door_lines.line == line) for line in lines])


def look(
    profiles: dict[float, Profile], settings: DoorsSettings = DOORS, ceiling_m: float = CEILING_M
) -> Seen:
    """Each line is a column of rays, 2 cm apart on the wall, with 2 mm of noise along the ray."""
    noise = np.random.default_rng(4)
    columns = []
    xs = sorted(profiles)
    for x in xs:
        z = np.arange(0.03, ceiling_m - 0.03, 0.02)
        ray = np.column_stack([np.full_like(z, x), np.full_like(z, WALL_Y_M), z]) - ORIGIN
        far = (WALL_Y_M + profiles[x](z)) / WALL_Y_M + noise.normal(0, 0.001, len(z))
        # Through an open door, rays end at the floor or the ceiling.
        with np.errstate(divide="ignore"):
            to_floor, to_ceiling = -ORIGIN[2] / ray[:, 2], (ceiling_m - ORIGIN[2]) / ray[:, 2]
        shell = np.abs(np.where(ray[:, 2] < 0, to_floor, to_ceiling))
        columns.append(ORIGIN + ray * np.minimum(far, shell)[:, None])
    points = np.concatenate([np.zeros((0, 3)), *columns]).astype(np.float32)
    ring = np.repeat(np.arange(len(xs), dtype=np.uint16), np.array([len(c) for c in columns], int))
    height_m = points[:, 2]
    lines = make_point_lines(
        scan_of(transforms.apply(transforms.invert(T_LEVEL_SENSOR), points), ring, len(xs)),
        -T_LEVEL_SENSOR[2, :3],
        (height_m < 0.02) | (height_m > ceiling_m - 0.02),
    )
    returns = Returns(points, height_m, ORIGIN)
    structures = find_vertical_structures(returns, lines.samples, VerticalStructuresSettings())
    ceilings = (HorizontalPlane(ceiling_m, np.zeros(2), 1000),)
    meets_ceiling = np.ones(len(lines), bool)
    planes = grow_wall_planes(
        returns, lines.samples, structures, ceilings, meets_ceiling, WallPlanesSettings()
    )
    door_lines = find_door_lines(returns, lines, planes, structures.upmost, settings)
    openings = find_openings(door_lines, planes, settings)
    used = np.flatnonzero(np.diff(lines.starts)).tolist()
    line_at = dict(zip(xs, used, strict=True))
    return Seen(planes, door_lines, openings, line_at)


def with_door(
    profile: Profile, settings: DoorsSettings = DOORS, ceiling_m: float = CEILING_M
) -> Seen:
    """Bare wall, four lines with the profile, bare wall; the wall is found in every case."""
    profiles = dict.fromkeys(WALL_X_M, bare) | dict.fromkeys(DOOR_X_M, profile)
    seen = look(profiles, settings, ceiling_m)
    np.testing.assert_allclose(seen.planes.normal[0], [0, -1], atol=5e-3)
    assert seen.planes.offset_m[0] == pytest.approx(-WALL_Y_M, abs=5e-3)
    # No line's up-most structure is on the wall of the next room, seen below the lintel.
    assert not np.any(seen.door_lines.plane)
    # The lines of bare wall belong to it (1) and have nothing behind it (2).
    wall = seen.rows(WALL_X_M)
    assert len(wall) == len(WALL_X_M)
    assert not np.any(seen.door_lines.behind[wall])
    return seen


@pytest.mark.parametrize(
    ("depth_m", "state"),
    [(0.03, DoorState.CLOSED), (0.5, DoorState.OPEN), (4.0, DoorState.OPEN)],
)
def test_where_all_conditions_hold_there_is_one_opening(depth_m: float, state: DoorState) -> None:
    seen = with_door(door(depth_m))
    rows, found, openings = seen.rows(DOOR_X_M), seen.door_lines, seen.openings
    assert np.flatnonzero(found.above_door).tolist() == sorted(rows.tolist())
    assert len(rows) == 4
    assert np.all(found.depression[rows] == Depression.HELD)
    assert set(found.state[rows].tolist()) == {state}
    # It begins at the lintel's lowest return, give or take one.
    np.testing.assert_allclose(found.start_height_m[rows], HEAD_M, atol=0.031)
    if state == DoorState.CLOSED:
        np.testing.assert_allclose(found.depth_m[rows], depth_m, atol=0.003)
    else:  # each return counts half a metre at most, and the floor's near the wall less
        assert np.all((found.depth_m[rows] > 0.4) & (found.depth_m[rows] <= 0.5))
    np.testing.assert_allclose(found.below_m[rows], -found.depth_m[rows])
    np.testing.assert_allclose(found.above_m[rows], 0, atol=0.01)
    places = np.column_stack([DOOR_X_M, np.full(4, WALL_Y_M)])
    np.testing.assert_allclose(found.position[rows], places, atol=0.01)
    assert (openings.plane.tolist(), openings.state.tolist()) == ([0], [state])
    assert openings.line_count.tolist() == [4]
    assert openings.head_m[0] == pytest.approx(HEAD_M, abs=0.031)
    assert openings.depth_m[0] == np.median(found.depth_m[rows])
    sides = openings.ends[0][np.argsort(openings.ends[0, :, 0])]
    np.testing.assert_allclose(sides, places[[0, -1]], atol=0.01)
    assert np.array_equal(openings.door_line_opening >= 0, found.above_door)


def test_condition_1_fails_where_the_line_belongs_to_no_wall_plane() -> None:
    """A duct below the ceiling, half a metre before the wall, hides its upper part."""

    def behind_a_duct(z: np.ndarray) -> np.ndarray:
        return np.where(z > CEILING_M - 0.45, -0.5, door(0.06)(z))

    seen = with_door(behind_a_duct)
    assert len(seen.rows(DOOR_X_M)) == len(seen.openings) == 0


def shelf_in_a_niche(z: np.ndarray) -> np.ndarray:
    """Every third return below the lintel is on the wall plane again."""
    return np.where(np.arange(len(z)) % 3 == 0, 0.0, door(0.1)(z))


def bulge_above(z: np.ndarray) -> np.ndarray:
    """Deep enough below a lintel that stands out, yet hardly behind the plane."""
    return np.where(z < HEAD_M, 0.01, -0.015)


def window(z: np.ndarray) -> np.ndarray:
    """Hollow from its head to its sill, then wall: not "connected to the floor"."""
    return np.where(z < 0.9, 0.0, door(2.0)(z))


@pytest.mark.parametrize(
    ("profile", "depression", "recess_min_m"),
    [
        (bare, Depression.NONE, None),
        (door(0.01), Depression.NONE, 0.005),
        (bulge_above, Depression.SHALLOW, 0.01),
        (shelf_in_a_niche, Depression.EXCEPTIONS, None),
        (window, None, None),
    ],
    ids=["bare", "too shallow", "below a bulge", "some returns on the plane", "window"],
)
def test_condition_2_fails_where_not_all_below_is_behind(
    profile: Profile, depression: Depression | None, recess_min_m: float | None
) -> None:
    seen = with_door(profile)
    rows, found = seen.rows(DOOR_X_M), seen.door_lines
    assert len(rows) == 4  # condition 1 held
    assert not np.any(found.behind[rows])
    for unknown in (found.start_height_m, found.depth_m, found.position):
        assert np.all(np.isnan(unknown[rows]))
    assert len(seen.openings) == 0
    if depression is not None:
        assert set(found.depression[rows].tolist()) == {depression}
        recedes = found.recess_m[rows] > DOORS.recess_min_m
        assert np.all(recedes == (depression != Depression.NONE))
        assert np.all(np.isnan(found.below_m[rows]) == (depression == Depression.NONE))
    if depression == Depression.EXCEPTIONS:
        assert np.all(found.on_plane_share[rows] > EXCEPTIONS_MAX)
    if depression == Depression.SHALLOW:
        assert np.all(-found.below_m[rows] < DOORS.recess_min_m)
    if recess_min_m is not None:  # no other condition failed
        relaxed = with_door(profile, DoorsSettings(recess_min_m=recess_min_m))
        assert np.all(relaxed.door_lines.above_door[relaxed.rows(DOOR_X_M)])
        assert len(relaxed.openings) == 1


def test_returns_before_the_wall_are_ignored() -> None:
    """Somebody before the door: half of the returns below the lintel are well before the wall."""

    def hidden(z: np.ndarray) -> np.ndarray:
        return np.where((z > 0.6) & (z < 1.7), -0.4, door(0.06)(z))

    seen = with_door(hidden)
    assert np.all(seen.door_lines.above_door[seen.rows(DOOR_X_M)])
    np.testing.assert_allclose(seen.openings.depth_m, [0.06], atol=0.01)


@pytest.mark.parametrize(("head_m", "ceiling_m"), [(1.4, CEILING_M), (2.8, 3.4)])
def test_condition_3_fails_where_it_begins_too_low_or_too_high(
    head_m: float, ceiling_m: float
) -> None:
    seen = with_door(door(0.06, head_m), ceiling_m=ceiling_m)
    rows, found = seen.rows(DOOR_X_M), seen.door_lines
    assert np.count_nonzero(found.behind[rows]) == 4  # conditions 1 and 2 held
    np.testing.assert_allclose(found.start_height_m[rows], head_m, atol=0.031)
    assert not np.any(found.high_enough)
    assert len(seen.openings) == 0


def test_lines_are_grouped_with_neighbours_of_their_state() -> None:
    wall = dict.fromkeys([*WALL_X_M, *DOOR_X_M], bare)
    alone = look(wall | {0.5: door(0.06)})
    assert np.count_nonzero(alone.door_lines.above_door) == 1
    assert len(alone.openings) == 0
    assert set(alone.openings.door_line_opening.tolist()) == {-1}
    apart = look(wall | dict.fromkeys([-0.7, -0.5, 1.5, 1.7], door(0.06)))
    assert apart.openings.line_count.tolist() == [2, 2]
    sides = np.sort(np.sort(apart.openings.ends[:, :, 0], axis=1), axis=0)
    np.testing.assert_allclose(sides, [[-0.7, -0.5], [1.5, 1.7]], atol=0.01)
    # A double door with one leaf open.
    leaves = dict.fromkeys([0.3, 0.5], door(0.06)) | dict.fromkeys([0.7, 0.9], door(3.0))
    double = look(wall | leaves).openings
    assert double.state.tolist() == [DoorState.CLOSED, DoorState.OPEN]
    sides = np.sort(double.ends[:, :, 0], axis=1)
    np.testing.assert_allclose(sides, [[0.3, 0.5], [0.7, 0.9]], atol=0.01)


def test_without_walls_there_are_no_doors() -> None:
    seen = look({})
    assert len(seen.planes) == len(seen.door_lines.line) == len(seen.openings) == 0
    assert seen.openings.ends.shape == (0, 2, 2)
