"""The building's level surfaces: ceilings, platforms, steps, beams, the storey below."""

from collections.abc import Sequence

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.votes import VoxelVotes
from ffmap.algorithms.building.heights import PlanGrid, Surface, corrected, find_patches
from ffmap.algorithms.building.levels import LevelsSettings, map_levels, of_rooms
from ffmap.algorithms.building.storey import Storey
from tests.voting import merge, vote

SETTINGS = LevelsSettings()
Range = tuple[float, float]
Box = tuple[Range, Range, Range]
Piece = tuple[FloatArray, Label]

NOTHING = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)


def lying(x: Range, y: Range, z: float, slope: float = 0.0, step_m: float = 0.05) -> FloatArray:
    """(n, 3) points on a surface that rises along x."""
    xs, ys = np.meshgrid(np.arange(x[0] + 0.02, x[1], step_m), np.arange(y[0] + 0.02, y[1], step_m))
    return np.column_stack([xs.ravel(), ys.ravel(), z + slope * xs.ravel()])


def sides(x: Range, y: Range, z: Range) -> FloatArray:
    """(n, 3) points 5 cm apart on the four upright sides of a box."""
    heights = np.arange(z[0] + 0.02, z[1], 0.05)
    along_x, along_y = np.arange(x[0], x[1] + 0.01, 0.05), np.arange(y[0], y[1] + 0.01, 0.05)
    ring = [np.column_stack([along_x, np.full(len(along_x), at)]) for at in y]
    ring += [np.column_stack([np.full(len(along_y), at), along_y]) for at in x]
    xy = np.concatenate(ring)
    return np.column_stack([np.repeat(xy, len(heights), axis=0), np.tile(heights, len(xy))])


def outside(points: FloatArray, x: Range, y: Range) -> FloatArray:
    """The points that are neither above nor below a rectangle."""
    low, high = np.array([x, y]).T
    return points[~((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)]


def votes_of(*pieces: Piece, scans: int = 3) -> VoxelVotes:
    """The votes of scans that all see these pieces."""
    own = [vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces]
    return merge(own * scans)


def turned(points: FloatArray, degrees: float) -> FloatArray:
    """The points after a rigid motion about the upright axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [3.3, -7.1, 0.4]


def share(
    votes: VoxelVotes, points: Sequence[Sequence[float]] | FloatArray, as_label: Label,
    taken_for: Label = Label.CLUTTER,
) -> float:  # fmt: skip
    """The share of points with a label that becomes another one."""
    own = np.atleast_2d(np.array(points, float))
    label = corrected(map_levels(votes, SETTINGS), own, np.full(len(own), taken_for, np.uint8))
    return float(np.mean(label == as_label))


FLOOR = lying((0, 7), (0, 4), 0.01), Label.FLOOR

# --- ceilings ---


@pytest.mark.parametrize(
    ("point", "taken_for", "expected"),
    [
        ((1.0, 1.0, 2.51), Label.CLUTTER, Label.CEILING),
        ((1.0, 1.0, 2.37), Label.CLUTTER, Label.CLUTTER),  # a lamp
        ((5.0, 1.0, 2.51), Label.CLUTTER, Label.CLUTTER),  # the height of the other room
        ((5.0, 1.0, 3.03), Label.CLUTTER, Label.CEILING),
        ((5.0, 2.6, 3.03), Label.CLUTTER, Label.CEILING),  # where the ceiling continues
        ((5.0, 9.0, 3.03), Label.CLUTTER, Label.CLUTTER),  # far from all that was seen
        ((1.0, 1.0, 2.51), Label.WALL, Label.WALL),  # only clutter is corrected
    ],
)
def test_clutter_at_the_height_of_its_ceiling_is_ceiling(
    point: tuple[float, float, float], taken_for: Label, expected: Label
) -> None:
    rooms = lying((0, 3), (0, 2), 2.52), lying((3, 6), (0, 2), 3.02)
    votes = votes_of(FLOOR, *((room, Label.CEILING) for room in rooms))
    assert share(votes, [point], expected, taken_for) == 1


@pytest.mark.parametrize("degrees", [0.0, 33.0])
@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((5.0, 7.0), (0.0, 4.0), 2.82, Label.CEILING),  # of a room seen through its doorway
        ((5.0, 7.0), (1.0, 1.4), 2.82, Label.CLUTTER),  # a duct
        ((5.0, 7.0), (0.0, 4.0), 1.92, Label.CLUTTER),  # a bunk
        ((0.0, 4.0), (0.0, 4.0), 2.22, Label.CLUTTER),  # a canopy below the ceiling
    ],
)
def test_the_highest_surface_is_a_ceiling_if_it_is_broad_and_high(
    x: Range, y: Range, z: float, expected: Label, degrees: float
) -> None:
    pieces = (FLOOR, (lying((0, 4), (0, 4), 2.52), Label.CEILING), (lying(x, y, z), Label.CLUTTER))
    votes = votes_of(*((turned(points, degrees), label) for points, label in pieces))
    assert share(votes, turned(np.array([[np.mean(x), np.mean(y), z]]), degrees), expected) == 1


@pytest.mark.parametrize("degrees", [0.0, 35.0, 120.0])
@pytest.mark.parametrize("rise", [0.3, 0.8, 1.4])
def test_a_roof_is_ceiling_and_what_is_below_it_is_not(degrees: float, rise: float) -> None:
    roof = lying((0, 2), (0, 3), 1.3, rise, step_m=0.04)
    roof[:, 2] += np.random.default_rng(4).normal(0, 0.006, len(roof))
    bed = turned(lying((0.2, 1.2), (0.5, 2.5), 0.5), degrees)
    roof, floor = turned(roof, degrees), turned(lying((0, 2), (0, 3), 0.0), degrees)
    votes = votes_of((floor, Label.FLOOR), (roof, Label.CLUTTER), (bed, Label.CLUTTER))
    assert share(votes, roof, Label.CEILING) > 0.95
    assert share(votes, bed, Label.CLUTTER) == 1
    # A wall at the roof's foot reaches it.
    foot = turned(np.array([[0.3, 1.2, 0.0], [0.3, 1.8, 0.0]]), degrees)[:, :2]
    clear_m = Storey.of(votes, map_levels(votes, SETTINGS), SETTINGS).clear_m(foot, 2.0)
    np.testing.assert_allclose(clear_m, 1.3 + 0.3 * rise, atol=0.15 * rise + 0.05)


@pytest.mark.parametrize(
    ("rise", "width_m", "low_m", "noise_m"),
    [
        (0.0, 3.0, 1.3, 0.0),  # level: a bunk
        (0.8, 0.6, 1.3, 0.0),  # as narrow as a ladder
        (2.5, 3.0, 1.3, 0.0),  # a wall that leans
        (0.3, 3.0, 0.4, 0.0),  # a drawing board
        (0.3, 3.0, 1.3, 0.08),  # a heap
    ],
)
def test_what_is_level_narrow_steep_low_or_rough_is_no_roof(
    rise: float, width_m: float, low_m: float, noise_m: float
) -> None:
    surface = lying((0, 2), (0, width_m), low_m, rise)
    surface[:, 2] += np.random.default_rng(5).normal(0, noise_m, len(surface))
    votes = votes_of((lying((0, 2), (0, 3), 0.0), Label.FLOOR), (surface, Label.CLUTTER))
    assert share(votes, surface, Label.CEILING) < 0.05


@pytest.mark.parametrize(
    ("x", "y", "is_of_room"),
    [
        ((1.5, 1.9), (0.5, 3.5), False),  # a duct, or a board over a wardrobe
        ((1.0, 2.5), (0.0, 4.0), True),  # a bulkhead
        ((4.1, 7.0), (0.0, 4.0), True),  # of another room, up to the wall between them
    ],
)
def test_a_narrow_strip_below_a_ceiling_is_not_of_a_room(
    x: Range, y: Range, is_of_room: bool
) -> None:
    high, low = outside(lying((0, 4), (0, 4), 3.02), x, y), lying(x, y, 2.72)
    of_room = of_rooms(np.concatenate([high, low]), SETTINGS)
    assert np.all(of_room == np.repeat([True, is_of_room], [len(high), len(low)]))
    # A wall there has to reach the ceiling of the room.
    votes = votes_of(FLOOR, (high, Label.CEILING), (low, Label.CEILING))
    clear_m = Storey.of(votes, (), SETTINGS).clear_m(np.array([[np.mean(x), np.mean(y)]]), 2.0)
    assert clear_m[0] == pytest.approx(2.71 if is_of_room else 3.01, abs=0.05)


# --- floors ---


@pytest.mark.parametrize("slope", [0.0, 0.02])
@pytest.mark.parametrize("kept", ["all", "lines", "few"])
def test_a_platform_is_floor_and_furniture_on_it_is_not(slope: float, kept: str) -> None:
    floor, platform = lying((0, 4), (0, 4), 0.01, slope), lying((4, 8), (0, 4), 0.16, slope)
    if kept == "lines":  # at a slant, the lines of a lidar's channels are far apart
        platform = platform[np.floor(platform[:, 0] * 20).astype(int) % 6 < 2]
    if kept == "few":
        platform = np.random.default_rng(3).choice(platform, 700, replace=False)
    table = lying((5, 6), (1, 2), 0.73, slope)
    votes = votes_of((floor, Label.FLOOR), (platform, Label.CLUTTER), (table, Label.CLUTTER))
    inner = platform[np.abs(platform[:, :2] - [6.0, 2.0]).max(axis=1) < 1.5]
    assert share(votes, inner, Label.FLOOR) > 0.9
    assert share(votes, inner + np.array([0.0, 0.0, 0.09]), Label.CLUTTER) > 0.97
    assert share(votes, table, Label.CLUTTER) == 1
    assert share(votes, inner, Label.WALL, Label.WALL) == 1


@pytest.mark.parametrize("degrees", [0.0, 20.0])
@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        ((1.0, 2.2), (1.0, 1.8), 0.15),  # a pallet
        ((1.0, 3.5), (1.0, 2.0), 0.15),  # a mattress
        ((1.0, 3.5), (1.0, 3.5), 0.45),  # as high as a seat
    ],
)
def test_what_is_narrow_or_high_is_no_floor(x: Range, y: Range, z: float, degrees: float) -> None:
    floor = turned(outside(lying((0, 5), (0, 5), 0.01), x, y), degrees)
    thing = turned(lying(x, y, z), degrees)
    assert share(votes_of((floor, Label.FLOOR), (thing, Label.CLUTTER)), thing, Label.FLOOR) == 0


def test_a_table_with_floor_below_it_is_no_floor() -> None:
    table = lying((1.0, 3.5), (1.0, 3.5), 0.25)
    assert share(votes_of(FLOOR, (table, Label.CLUTTER)), table, Label.FLOOR) == 0


@pytest.mark.parametrize(
    ("y", "expected"), [((1.0, 3.0), Label.FLOOR), ((1.5, 1.9), Label.CLUTTER)]
)
def test_the_floor_continues_where_scans_did_not_find_it(y: Range, expected: Label) -> None:
    beyond = lying((4.5, 7.5), y, 0.03)
    beyond = np.random.default_rng(6).permutation(beyond)[: len(beyond) // 3]
    seen = votes_of((lying((0, 4), (0, 4), 0.01), Label.FLOOR))
    votes = merge([seen, votes_of((beyond, Label.CLUTTER), scans=1)])
    inner = beyond[np.abs(beyond[:, 0] - 6.0) < 1.1]
    assert share(votes, inner, expected) > 0.95


@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((4.0, 8.0), (0.0, 4.0), 0.2, Label.FLOOR),
        ((4.0, 8.0), (0.0, 4.0), 0.5, Label.CLUTTER),  # a stage
        ((4.0, 5.0), (1.0, 1.8), 0.2, Label.CLUTTER),  # a pallet
    ],
)
@pytest.mark.parametrize("taken_for", [Label.FLOOR, Label.CLUTTER])
def test_the_front_of_a_step_is_floor(
    x: Range, y: Range, z: float, expected: Label, taken_for: Label
) -> None:
    front = sides((x[0], x[0]), (1.2, 1.6), (0.05, z - 0.04))
    low = outside(lying((0, 8), (0, 4), 0.01), x, y)
    pieces = (low, Label.FLOOR), (lying(x, y, z), taken_for), (front, Label.CLUTTER)
    votes = votes_of(*pieces)
    assert share(votes, front, expected) > 0.9
    for away in ([-0.4, 0.0, 0.0], [0.0, 0.0, 0.3]):
        assert share(votes, front + np.array(away), Label.CLUTTER) == 1


def test_a_ramp_has_no_step() -> None:
    pieces = lying((0, 4), (0, 4), 0.01), lying((4, 8), (0, 4), -0.39, 0.1)
    levels = map_levels(votes_of(*((points, Label.FLOOR) for points in pieces)), SETTINGS)
    assert Surface.STEP_FRONT not in [level.surface for level in levels]


@pytest.mark.parametrize("taken_for", [Label.WALL, Label.CLUTTER])
def test_walls_below_the_floor_are_outside(taken_for: Label) -> None:
    """Seen down a stairwell beside the floor, whatever scans took them for."""
    wall = sides((3.5, 3.5), (0.0, 2.0), (-2.5, 2.5))
    votes = votes_of((lying((0, 2), (0, 2), 0.0), Label.FLOOR), (wall, taken_for))
    below = wall[:, 2] < -SETTINGS.step_max_m - 0.01
    assert share(votes, wall[below], Label.OUTSIDE, Label.WALL) == 1
    assert share(votes, wall[wall[:, 2] > -SETTINGS.step_max_m + 0.01], Label.WALL, Label.WALL) == 1


# --- what hangs below a ceiling: a room of 4 by 3 m, 2.8 m high ---

ROOM = (0.0, 4.0), (0.0, 3.0), (0.0, 2.8)
BEAM: Box = (1.8, 2.1), (0.0, 3.0), (2.5, 2.8)


def ceiling_share(*boxes: Box, degrees: float = 0.0, slope: float = 0.0) -> float:
    """The share of what is seen of hanging boxes that becomes ceiling."""
    ceiling, walls = lying(ROOM[0], ROOM[1], 2.8, slope), sides(*ROOM[:2], (0.0, 2.8 + 4 * slope))
    hanging = []
    for x, y, z in boxes:
        ceiling = outside(ceiling, x, y)
        hanging += [sides(x, y, (z[0], z[1] + slope * x[1])), lying(x, y, z[0])]
        behind = (walls[:, :2] >= [x[0], y[0]]) & (walls[:, :2] <= [x[1], y[1]])
        walls = walls[~(behind.all(axis=1) & (walls[:, 2] > z[0]))]
    box = np.concatenate(hanging)
    seen = (box[:, :2] > 0.03).all(axis=1) & (box[:, 0] < 3.97) & (box[:, 1] < 2.97)
    box = box[seen & (box[:, 2] < 2.8 + slope * box[:, 0])]
    below_ceiling = box[box[:, 2] < 2.8 - SETTINGS.margin_m]
    walls = walls[walls[:, 2] < 2.8 + slope * walls[:, 0]]
    floor = lying(ROOM[0], ROOM[1], 0.0)
    pieces = (
        (floor, Label.FLOOR),
        (ceiling, Label.CEILING),
        (walls, Label.WALL),
        (box, Label.CLUTTER),
    )
    votes = votes_of(*((turned(points, degrees), label) for points, label in pieces))
    return share(votes, turned(below_ceiling, degrees), Label.CEILING)


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0])
@pytest.mark.parametrize(
    "boxes",
    [
        pytest.param((BEAM,), id="beam"),
        pytest.param(
            (*(((x, x + 0.2), (0.0, 3.0), (2.55, 2.8)) for x in (0.8, 2.2)),
             ((0.0, 4.0), (1.4, 1.6), (2.55, 2.8))), id="coffers"),
        pytest.param((((0.0, 4.0), (0.0, 0.5), (2.4, 2.8)),), id="soffit"),
        pytest.param((((0.9, 3.3), (1.4, 1.6), (2.5, 2.8)),), id="beam with hidden ends"),
    ],
)  # fmt: skip
def test_what_closes_up_to_the_ceiling_is_ceiling(boxes: tuple[Box, ...], degrees: float) -> None:
    assert ceiling_share(*boxes, degrees=degrees) > 0.8


def test_a_beam_below_a_ceiling_that_rises_is_ceiling() -> None:
    assert ceiling_share(BEAM, slope=0.1) > 0.85


@pytest.mark.parametrize("degrees", [0.0, 90.0])
@pytest.mark.parametrize(
    "box",
    [
        pytest.param(((1.2, 2.5), (1.4, 1.6), (2.6, 2.8)), id="lamp"),
        pytest.param(((1.8, 2.1), (0.0, 3.0), (2.3, 2.55)), id="duct with air above it"),
        pytest.param(((0.1, 3.9), (0.25, 0.55), (2.4, 2.8)), id="duct with a slit to its wall"),
        pytest.param(((0.0, 1.2), (0.0, 0.5), (0.0, 2.8)), id="cupboard"),
    ],
)
def test_what_hangs_free_or_stands_is_no_ceiling(box: Box, degrees: float) -> None:
    assert ceiling_share(box, degrees=degrees) < 0.1


# --- all ---


@pytest.mark.parametrize("votes", [NOTHING, votes_of(FLOOR)])
def test_without_ceilings_nothing_changes(votes: VoxelVotes) -> None:
    assert share(votes, [[1.0, 1.0, 2.5]], Label.CLUTTER) == 1
    assert of_rooms(np.zeros((0, 3)), SETTINGS).shape == (0,)


def test_where_nothing_was_seen_there_is_no_level() -> None:
    assert map_levels(NOTHING, SETTINGS) == ()
    assert find_patches(
        PlanGrid.around(np.zeros((0, 3)), 0.1, 1.0), np.full((1, 1, 3), np.nan), 0.02, 0.04, 1.0
    ).width_m.tolist() == [0.0]


ROOM_WITH_ALL = (
    (lying((0, 8), (0, 6), 0.0), Label.FLOOR),
    (lying((0, 8), (0, 6), 2.6), Label.CEILING),
    (lying((8, 12), (0, 6), 0.2), Label.CLUTTER),
    (lying((8, 12), (0, 6), 3.1), Label.CLUTTER),
)


def test_the_order_of_returns_does_not_matter() -> None:
    shuffle = np.random.default_rng(8).permutation
    first, second = (
        map_levels(votes_of(*pieces), SETTINGS)
        for pieces in (ROOM_WITH_ALL, [(shuffle(p), label) for p, label in ROOM_WITH_ALL[::-1]])
    )
    for one, other in zip(first, second, strict=True):
        assert one.surface is other.surface
        np.testing.assert_array_equal(one.low_m, other.low_m)
        np.testing.assert_array_equal(one.high_m, other.high_m)


def test_single_returns_far_away_do_not_stretch_the_grid() -> None:
    far = np.array([[95.0, 3.0, 0.4], [-95.0, 3.0, 20.0], [3.0, 95.0, 0.1], [3.0, -95.0, 90.0]])
    strays = [(far, Label.CLUTTER), (far + np.array([0.0, 0.0, 1.0]), Label.FLOOR)]
    alone = map_levels(votes_of(*ROOM_WITH_ALL), SETTINGS)
    among_strays = map_levels(votes_of(*ROOM_WITH_ALL, *strays), SETTINGS)
    points = np.concatenate([lying((-1, 13), (-1, 7), z) for z in (0.01, 0.21, 2.61, 3.11)])
    clutter = np.full(len(points), Label.CLUTTER, np.uint8)
    differ = corrected(alone, points, clutter) != corrected(among_strays, points, clutter)
    assert differ.mean() < 0.02
    assert max(level.low_m.size for level in among_strays) < 60_000


def test_noise_of_the_range_does_not_matter() -> None:
    generator = np.random.default_rng(9)
    noisy = [(p + generator.normal(0, [0, 0, 0.01], p.shape), label) for p, label in ROOM_WITH_ALL]
    votes = votes_of(*noisy)
    for (points, _), expected in zip(noisy[2:], (Label.FLOOR, Label.CEILING), strict=True):
        assert share(votes, points, expected) > 0.97
