"""The paper's three door conditions, one by one: inputs in which exactly one fails, and the one in which all hold."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.scan.doors import (
    Depression,
    DoorLines,
    DoorsSettings,
    DoorState,
    Openings,
    find_door_lines,
    find_openings,
)
from ffmap.algorithms.scan.point_lines import PointLines, make_point_lines
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, RearrangementSettings, Returns
from ffmap.algorithms.scan.vertical_structures import (
    VerticalStructures,
    VerticalStructuresSettings,
    find_vertical_structures,
)
from ffmap.algorithms.scan.wall_candidates import WallPlanesSettings
from ffmap.algorithms.scan.wall_planes import WallPlanes, grow_wall_planes
from tests.synthetic import scan_of

DOORS = DoorsSettings()
WALL_Y_M = 2.0
CEILING_M = 2.8
HEAD_M = 2.1
ORIGIN = np.array([0.0, 0.0, 1.0])
# The lidar lies on its side: its spin axis z points along the level frame's x, its x axis down.
T_LEVEL_SENSOR = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]])

Profile = Callable[[np.ndarray], np.ndarray]
"""How many metres behind the wall a line's returns lie, by the heights at which their rays pass through the wall."""

WALL_X_M = np.array([-0.9, -0.7, -0.5, -0.3, -0.1, 1.3, 1.5, 1.7, 1.9, 2.1])
DOOR_X_M = np.array([0.3, 0.5, 0.7, 0.9])


def bare(z: np.ndarray) -> np.ndarray:
    return np.zeros_like(z)


def door(depth_m: float, head_m: float = HEAD_M) -> Profile:
    return lambda z: np.where(z < head_m, depth_m, 0.0)


@dataclass(frozen=True)
class Seen:
    """A wall y = 2 seen in upright lines, one at each x, and what the method made of it."""

    points: np.ndarray
    lines: PointLines
    structures: VerticalStructures
    planes: WallPlanes
    door_lines: DoorLines
    openings: Openings
    line_at: dict[float, int]

    def evidence(self, x: float) -> int:
        """The row of the line at x in `door_lines`."""
        (row,) = np.flatnonzero(self.door_lines.line == self.line_at[x])
        return int(row)

    def evidences(self, xs: np.ndarray) -> np.ndarray:
        return np.array([self.evidence(x) for x in xs])


def look(profiles: dict[float, Profile], settings: DoorsSettings = DOORS, ceiling_m: float = CEILING_M) -> Seen:
    """Each line a column of rays from the sensor, 2 cm apart on the wall, with 2 mm of noise along the ray."""
    noise = np.random.default_rng(4)
    columns = []
    xs = sorted(profiles)
    for x in xs:
        z = np.arange(0.03, ceiling_m - 0.03, 0.02)
        ray = np.column_stack([np.full_like(z, x), np.full_like(z, WALL_Y_M), z]) - ORIGIN
        far = (WALL_Y_M + profiles[x](z)) / WALL_Y_M + noise.normal(0, 0.001, len(z))
        # What would lie below the floor or above the ceiling, seen through an open door, is floor or ceiling.
        with np.errstate(divide="ignore"):
            shell = np.where(ray[:, 2] < 0, -ORIGIN[2] / ray[:, 2], (ceiling_m - ORIGIN[2]) / ray[:, 2])
        columns.append(ORIGIN + ray * np.minimum(far, np.abs(shell))[:, None])
    points = np.concatenate([np.zeros((0, 3)), *columns]).astype(np.float32)
    ring = np.repeat(np.arange(len(xs), dtype=np.uint16), np.array([len(c) for c in columns], int))
    height_m = points[:, 2]
    lines = make_point_lines(
        scan_of(transforms.apply(transforms.invert(T_LEVEL_SENSOR), points), ring, len(xs)),
        -T_LEVEL_SENSOR[2, :3],
        (height_m < 0.02) | (height_m > ceiling_m - 0.02),
        RearrangementSettings(),
    )
    returns = Returns(points, height_m, ORIGIN)
    structures = find_vertical_structures(returns, lines.samples, VerticalStructuresSettings())
    planes = grow_wall_planes(
        returns,
        lines.samples,
        structures,
        (HorizontalPlane(ceiling_m, np.zeros(2), 1000),),
        np.ones(len(lines), bool),
        WallPlanesSettings(),
    )
    door_lines = find_door_lines(returns, lines, planes, structures.upmost, settings)
    (used,) = np.nonzero(np.diff(lines.starts))
    return Seen(
        points,
        lines,
        structures,
        planes,
        door_lines,
        find_openings(door_lines, planes, settings),
        dict(zip(xs, used.tolist(), strict=True)),
    )


def with_door(profile: Profile, settings: DoorsSettings = DOORS, ceiling_m: float = CEILING_M) -> Seen:
    """Bare wall, four lines with the profile, bare wall; the wall itself is found in every case."""
    seen = look(dict.fromkeys(WALL_X_M, bare) | dict.fromkeys(DOOR_X_M, profile), settings, ceiling_m)
    np.testing.assert_allclose(seen.planes.normal[0], [0, -1], atol=5e-3)
    assert seen.planes.offset_m[0] == pytest.approx(-WALL_Y_M, abs=5e-3)
    # Through an opening the next room's wall may be seen, below the lintel; no line's up-most structure lies on it.
    assert not np.any(seen.door_lines.plane)
    # The lines of bare wall belong to it (1) and have nothing behind (2), whatever stands between them.
    wall = seen.evidences(WALL_X_M)
    assert not np.any(seen.door_lines.behind[wall])
    return seen


@pytest.mark.parametrize(
    ("depth_m", "state"),
    [(0.03, DoorState.CLOSED), (0.06, DoorState.CLOSED), (0.5, DoorState.OPEN), (4.0, DoorState.OPEN)],
)
def test_where_all_conditions_hold_there_is_one_opening(depth_m: float, state: DoorState) -> None:
    seen = with_door(door(depth_m))
    rows, found = seen.evidences(DOOR_X_M), seen.door_lines
    assert np.all(found.plane[rows] == 0)
    assert np.all(found.behind[rows])
    assert np.all(found.high_enough[rows])
    assert np.flatnonzero(found.above_door).tolist() == sorted(rows.tolist())
    assert set(found.state[rows].tolist()) == {state}
    # It begins at the lintel's lowest return, give or take one.
    np.testing.assert_allclose(found.start_height_m[rows], HEAD_M, atol=0.031)
    for row in rows:
        first, after = seen.lines.starts[found.line[row] : found.line[row] + 2]
        assert found.start_height_m[row] in seen.points[seen.lines.order[first:after], 2]
    if state == DoorState.CLOSED:
        np.testing.assert_allclose(found.depth_m[rows], depth_m, atol=0.003)
    else:  # each return counts half a metre at most, and the floor's near the wall less
        assert np.all((found.depth_m[rows] > 0.4) & (found.depth_m[rows] <= 0.5))
    np.testing.assert_allclose(found.position[rows], np.column_stack([DOOR_X_M, np.full(4, WALL_Y_M)]), atol=0.01)

    assert len(seen.openings) == 1
    assert seen.openings.plane.tolist() == [0]
    assert seen.openings.state.tolist() == [state]
    assert seen.openings.line_count.tolist() == [4]
    assert seen.openings.head_m[0] == pytest.approx(HEAD_M, abs=0.031)
    assert seen.openings.depth_m[0] == np.median(found.depth_m[rows])
    np.testing.assert_allclose(np.sort(seen.openings.ends[0, :, 0]), DOOR_X_M[[0, -1]], atol=0.01)
    np.testing.assert_allclose(seen.openings.ends[0, :, 1], WALL_Y_M, atol=0.01)


def test_condition_1_fails_where_the_line_belongs_to_no_wall_plane() -> None:
    # A duct below the ceiling, half a metre before the wall, hides its upper part; lintel and leaf are in sight.
    duct_m = 0.45

    def behind_a_duct(z: np.ndarray) -> np.ndarray:
        return np.where(z > CEILING_M - duct_m, -0.5, door(0.06)(z))

    seen = with_door(behind_a_duct)
    assert not {seen.line_at[x] for x in DOOR_X_M} & set(seen.door_lines.line.tolist())
    assert not np.any(seen.door_lines.above_door)
    assert len(seen.openings) == 0
    # That alone failed: were these lines of the wall, the other conditions would hold for them.
    planes = seen.planes
    of_door = np.isin(planes.candidate_line, [seen.line_at[x] for x in DOOR_X_M])
    of_door &= seen.structures.upmost[planes.candidate_line] == planes.candidate_structure
    assert np.count_nonzero(of_door) == 4
    assert np.all(planes.candidate_plane[of_door] == -1)
    claimed = replace(planes, candidate_plane=np.where(of_door, 0, planes.candidate_plane).astype(np.int32))
    returns = Returns(seen.points, seen.points[:, 2], ORIGIN)
    lines = find_door_lines(returns, seen.lines, claimed, seen.structures.upmost, DOORS)
    assert set(lines.line[lines.above_door].tolist()) == {seen.line_at[x] for x in DOOR_X_M}
    assert len(find_openings(lines, claimed, DOORS)) == 1


def shelf_in_a_niche(z: np.ndarray) -> np.ndarray:
    """Every third return below the lintel is on the wall plane again."""
    return np.where(np.arange(len(z)) % 3 == 0, 0.0, door(0.1)(z))


def bulge_above(z: np.ndarray) -> np.ndarray:
    """Deep enough seen from a lintel that stands out, yet hardly behind the plane."""
    return np.where(z < HEAD_M, 0.01, -0.015)


def window(z: np.ndarray) -> np.ndarray:
    """Hollow from its head to its sill, then wall down to the floor: "connected to the floor" it is not."""
    return np.where(z < 0.9, 0.0, door(2.0)(z))


@pytest.mark.parametrize(
    ("profile", "forgiving"),
    [
        (door(0.01), {"recess_min_m": 0.005}),
        (bulge_above, {"recess_min_m": 0.01}),
        (shelf_in_a_niche, {"exceptions_max": 0.5}),
        (window, {"exceptions_max": 0.6}),
    ],
    ids=["too shallow", "below a bulge", "some returns on the plane", "wall below a window"],
)
def test_condition_2_fails_where_not_all_below_lies_behind(profile: Profile, forgiving: dict[str, float]) -> None:
    seen = with_door(profile)
    rows, found = seen.evidences(DOOR_X_M), seen.door_lines
    assert np.all(found.plane[rows] == 0)  # condition 1 held
    assert not np.any(found.behind[rows])
    for unknown in (found.start_height_m, found.depth_m, found.position):
        assert np.all(np.isnan(unknown[rows]))
    assert not np.any(found.above_door)
    assert len(seen.openings) == 0
    # That alone failed: with a more forgiving condition 2 the same lines make an opening.
    relaxed = with_door(profile, DOORS.model_copy(update=forgiving))
    assert np.all(relaxed.door_lines.above_door[relaxed.evidences(DOOR_X_M)])
    assert len(relaxed.openings) == 1


@pytest.mark.parametrize(
    ("profile", "depression"),
    [
        (bare, {Depression.NONE}),
        (door(0.01), {Depression.NONE}),
        (shelf_in_a_niche, {Depression.EXCEPTIONS}),
        (bulge_above, {Depression.SHALLOW}),
        (door(0.06), {Depression.HELD}),
    ],
    ids=["bare", "too shallow", "some returns on the plane", "below a bulge", "door"],
)
def test_what_condition_2_measured_tells_why(profile: Profile, depression: set[Depression]) -> None:
    seen = with_door(profile)
    rows, found = seen.evidences(DOOR_X_M), seen.door_lines
    assert set(found.depression[rows].tolist()) == depression
    assert np.array_equal(found.depression == Depression.HELD, found.behind)
    assert np.array_equal(seen.openings.door_line_opening >= 0, found.above_door)
    if depression == {Depression.NONE}:
        assert np.all(found.recess_m[rows] < DOORS.recess_min_m)
        assert np.isnan(found.below_m[rows]).all()
        return
    assert np.all(found.recess_m[rows] > DOORS.recess_min_m)
    if depression == {Depression.EXCEPTIONS}:
        assert np.all(found.on_plane_share[rows] > DOORS.exceptions_max)
    if depression == {Depression.SHALLOW}:
        assert np.all(-found.below_m[rows] < DOORS.recess_min_m)
    if depression == {Depression.HELD}:
        np.testing.assert_allclose(found.below_m[rows], -found.depth_m[rows])
        np.testing.assert_allclose(found.above_m[rows], 0, atol=0.01)


def test_condition_2_fails_on_a_bare_wall() -> None:
    seen = with_door(bare)
    assert len(seen.door_lines.line) == len(WALL_X_M) + len(DOOR_X_M)
    assert not np.any(seen.door_lines.behind)
    assert len(seen.openings) == 0


def test_returns_before_the_wall_say_nothing() -> None:
    # Somebody stands before the leaf: half of the returns below the lintel lie well before the wall.
    def hidden(z: np.ndarray) -> np.ndarray:
        return np.where((z > 0.6) & (z < 1.7), -0.4, door(0.06)(z))

    seen = with_door(hidden)
    assert np.all(seen.door_lines.above_door[seen.evidences(DOOR_X_M)])
    np.testing.assert_allclose(seen.openings.depth_m, [0.06], atol=0.01)


@pytest.mark.parametrize(
    ("head_m", "ceiling_m", "forgiving"),
    [(1.4, CEILING_M, {"height_min_m": 1.3}), (2.8, 3.4, {"height_max_m": 2.9})],
    ids=["too low", "too high"],
)
def test_condition_3_fails_where_it_begins_too_low_or_too_high(
    head_m: float, ceiling_m: float, forgiving: dict[str, float]
) -> None:
    seen = with_door(door(0.06, head_m), ceiling_m=ceiling_m)
    rows, found = seen.evidences(DOOR_X_M), seen.door_lines
    assert np.all(found.plane[rows] == 0)  # condition 1 held
    assert np.all(found.behind[rows])  # condition 2 held
    np.testing.assert_allclose(found.start_height_m[rows], head_m, atol=0.031)
    np.testing.assert_allclose(found.depth_m[rows], 0.06, atol=0.01)
    assert not np.any(found.high_enough)
    assert not np.any(found.above_door)
    assert len(seen.openings) == 0
    # That alone failed: with other bounds the same lines make an opening.
    relaxed = with_door(door(0.06, head_m), DOORS.model_copy(update=forgiving), ceiling_m)
    assert np.all(relaxed.door_lines.high_enough[relaxed.evidences(DOOR_X_M)])
    assert len(relaxed.openings) == 1


def test_one_line_alone_is_no_opening() -> None:
    profiles = dict.fromkeys([*WALL_X_M, *DOOR_X_M], bare)
    seen = look(profiles | {0.5: door(0.06)})
    assert seen.door_lines.line[seen.door_lines.above_door].tolist() == [seen.line_at[0.5]]
    assert len(seen.openings) == 0
    assert set(seen.openings.door_line_opening.tolist()) == {-1}
    assert len(look(profiles | {0.5: door(0.06), 0.7: door(0.06)}).openings) == 1


def test_lines_far_apart_or_of_another_state_are_other_openings() -> None:
    wall = dict.fromkeys([*WALL_X_M, *DOOR_X_M], bare)
    apart = look(wall | dict.fromkeys([-0.7, -0.5, 1.5, 1.7], door(0.06)))
    assert len(apart.openings) == 2
    assert apart.openings.line_count.tolist() == [2, 2]
    np.testing.assert_allclose(
        np.sort(np.sort(apart.openings.ends[:, :, 0], axis=1), axis=0), [[-0.7, -0.5], [1.5, 1.7]], atol=0.01
    )
    # A double door, one leaf of which stands open.
    double = look(wall | dict.fromkeys([0.3, 0.5], door(0.06)) | dict.fromkeys([0.7, 0.9], door(3.0)))
    assert double.openings.state.tolist() == [DoorState.CLOSED, DoorState.OPEN]
    np.testing.assert_allclose(np.sort(double.openings.ends[:, :, 0], axis=1), [[0.3, 0.5], [0.7, 0.9]], atol=0.01)


def test_without_walls_there_are_no_doors() -> None:
    seen = look({})
    assert len(seen.planes) == len(seen.door_lines.line) == len(seen.door_lines.above_door) == len(seen.openings) == 0
    assert seen.openings.ends.shape == (0, 2, 2)
