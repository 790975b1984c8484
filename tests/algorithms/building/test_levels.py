"""The building's level surfaces: ceilings of rooms of different height, sloping ones, beams, raised floors."""

from collections.abc import Iterator

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.building.ceilings import (
    map_ceilings,
    map_glimpsed_ceilings,
    map_sloping_ceilings,
    of_rooms,
)
from ffmap.algorithms.building.face_columns import Storey
from ffmap.algorithms.building.floors import map_floors_beyond, map_raised_floors, map_step_fronts
from ffmap.algorithms.building.height_map import HeightMap, corrected, median_around
from ffmap.algorithms.building.level_settings import LevelsSettings
from ffmap.algorithms.building.levels import map_levels
from ffmap.algorithms.building.rooflights import map_mirrored_floors
from ffmap.algorithms.building.votes import VoxelVotes
from ffmap.algorithms.scan.summary import Features
from tests.tracing import rays_alone
from tests.voting import merge, vote

SETTINGS = LevelsSettings()


def two_rooms() -> HeightMap:
    """Ceilings at 2.5 m where x < 3 and at 3.0 m beyond, with a lamp's returns below the lower one."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(0.02, 6, 0.05), np.arange(0.02, 2, 0.05)))
    points = np.column_stack([x, y, np.where(x < 3, 2.52, 3.02)])
    lamp = np.array([[1.02, 1.02, 2.37]])
    portions = [vote(points, np.full(len(points), Label.CEILING, np.uint8), len(Label), 0.05) for _ in range(3)]
    return map_ceilings(merge([*portions, vote(lamp, np.zeros(1, np.uint8), len(Label), 0.05)]), SETTINGS)


@pytest.mark.parametrize(
    ("point", "label", "expected"),
    [
        ((1.0, 1.0, 2.51), Label.CLUTTER, Label.CEILING),
        ((1.0, 1.0, 2.37), Label.CLUTTER, Label.CLUTTER),  # a lamp
        ((5.0, 1.0, 2.51), Label.CLUTTER, Label.CLUTTER),  # the other room's height
        ((5.0, 1.0, 3.03), Label.CLUTTER, Label.CEILING),
        ((5.0, 3.0, 3.03), Label.CLUTTER, Label.CEILING),  # where the ceiling goes on
        ((5.0, 9.0, 3.03), Label.CLUTTER, Label.CLUTTER),  # far from all that was seen
        ((1.0, 1.0, 2.51), Label.WALL, Label.WALL),  # only clutter is doubted
    ],
)
def test_clutter_at_the_ceilings_height_is_ceiling(
    point: tuple[float, float, float], label: Label, expected: Label
) -> None:
    assert two_rooms().label_of(np.array([point]), np.array([label], np.uint8))[0] == expected


def test_a_building_without_ceilings_changes_nothing() -> None:
    label = np.zeros(1, np.uint8)
    floor = vote(np.zeros((4, 3)), np.full(4, Label.FLOOR, np.uint8), len(Label), 0.05)
    assert map_ceilings(floor, SETTINGS).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    assert map_raised_floors(nothing, SETTINGS, 0.1).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    for votes in (nothing, floor):
        assert map_glimpsed_ceilings(votes, SETTINGS).label_of(np.zeros((1, 3)), label)[0] == Label.CLUTTER
    assert len(two_rooms().label_of(np.zeros((0, 3)), np.zeros(0, np.uint8))) == 0


def lying(x: tuple[float, float], y: tuple[float, float], z: float, slope: float = 0.0) -> np.ndarray:
    """(n, 3) points 5 cm apart on something level, or sloping along x."""
    xs, ys = (a.ravel() for a in np.meshgrid(np.arange(x[0] + 0.02, x[1], 0.05), np.arange(y[0] + 0.02, y[1], 0.05)))
    return np.column_stack([xs, ys, z + slope * xs])


def votes_of(*pieces: tuple[np.ndarray, Label], scans: int = 3) -> VoxelVotes:
    """So many scans that see each piece so."""
    return merge([vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces] * scans)


def raised(*pieces: tuple[np.ndarray, Label], cell_m: float = 0.1) -> HeightMap:
    return map_raised_floors(votes_of(*pieces), SETTINGS, cell_m)


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_platform_is_floor_and_so_is_what_stands_on_it_not(slope: float) -> None:
    floor, platform = lying((0, 4), (0, 4), 0.01, slope), lying((4, 7), (0, 4), 0.16, slope)
    table = lying((5, 6), (1, 2), 0.73 + slope * 5)
    found = raised((floor, Label.FLOOR), (platform, Label.CLUTTER), (table, Label.CLUTTER))
    clutter = np.zeros(1, np.uint8)
    for x in (4.3, 5.5, 6.8):
        assert found.label_of(np.array([[x, 1.5, 0.16 + slope * x]]), clutter)[0] == Label.FLOOR
        assert found.label_of(np.array([[x, 1.5, 0.25 + slope * x]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[5.5, 1.5, 0.73 + slope * 5]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[2.0, 1.5, 0.16 + slope * 2]]), clutter)[0] == Label.CLUTTER
    assert found.label_of(np.array([[5.5, 1.5, 0.16]]), np.array([Label.WALL], np.uint8))[0] == Label.WALL


def test_a_platform_that_shows_in_lines_is_floor() -> None:
    """At a slant, an emitter's line on it is far from the next."""
    floor, platform = lying((0, 4), (0, 4), 0.01), lying((4, 7), (0, 4), 0.16)
    lines = platform[np.floor(platform[:, 0] * 10).astype(int) % 4 == 0]
    found = raised((floor, Label.FLOOR), (lines, Label.CLUTTER))
    inner = lines[(lines[:, 0] > 4.5) & (lines[:, 0] < 6.5) & (np.abs(lines[:, 1] - 2.0) < 1.5)]
    assert np.all(found.label_of(inner, np.zeros(len(inner), np.uint8)) == Label.FLOOR)


def test_a_platform_that_few_returns_show_from_afar_is_floor() -> None:
    floor, platform = lying((0, 4), (0, 4), 0.01), lying((4, 8), (0, 4), 0.16)
    few = np.random.default_rng(3).choice(platform, 300, replace=False)
    inner = few[(few[:, 0] > 4.4) & (few[:, 0] < 7.6) & (np.abs(few[:, 1] - 2.0) < 1.6)]
    label = np.zeros(len(inner), np.uint8)
    for level in map_levels(votes_of((floor, Label.FLOOR), (few, Label.CLUTTER)), (), SETTINGS):
        label = level.label_of(inner, label)
    assert np.mean(label == Label.FLOOR) > 0.97


@pytest.mark.parametrize("cell_m", [0.1, 0.2, 0.3])
@pytest.mark.parametrize(
    ("x", "y", "z"),
    [
        ((1.0, 2.2), (1.0, 1.8), 0.15),  # a pallet
        ((1.0, 3.5), (1.0, 1.9), 0.15),  # a mattress
        ((1.0, 3.5), (1.0, 3.5), 0.45),  # as high as a seat
        ((1.0, 3.5), (1.0, 3.5), 0.04),  # a carpet
    ],
)
def test_what_is_narrow_high_or_thin_is_no_floor(
    x: tuple[float, float], y: tuple[float, float], z: float, cell_m: float
) -> None:
    floor = lying((0, 5), (0, 5), 0.01)
    hidden = (floor[:, 0] > x[0]) & (floor[:, 0] < x[1]) & (floor[:, 1] > y[0]) & (floor[:, 1] < y[1])
    found = raised((floor[~hidden], Label.FLOOR), (lying(x, y, z), Label.CLUTTER), cell_m=cell_m)
    assert np.isnan(found.low_m).all()


def test_a_table_whose_floor_is_seen_below_it_is_none() -> None:
    low_table = lying((1.0, 3.5), (1.0, 3.5), 0.25)
    found = raised((lying((0, 5), (0, 5), 0.01), Label.FLOOR), (low_table, Label.CLUTTER))
    assert np.isnan(found.low_m).all()


@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((5.0, 7.0), (0.0, 4.0), 2.82, Label.CEILING),  # of another room, seen through its doorway
        ((5.0, 7.0), (1.0, 1.4), 2.82, Label.CLUTTER),  # a duct
        ((5.0, 7.0), (0.0, 4.0), 1.92, Label.CLUTTER),  # a bunk
        ((0.0, 4.0), (0.0, 4.0), 2.22, Label.CLUTTER),  # a canopy below the ceiling
    ],
)
def test_a_glimpsed_ceiling_is_high_broad_and_the_highest(
    x: tuple[float, float], y: tuple[float, float], z: float, expected: Label
) -> None:
    pieces = (
        (lying((0, 7), (0, 4), 0.01), Label.FLOOR),
        (lying((0, 4), (0, 4), 2.52), Label.CEILING),
        (lying(x, y, z), Label.CLUTTER),
    )
    votes = merge([vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces] * 3)
    point = np.array([[np.mean(x), np.mean(y), z]])
    assert map_glimpsed_ceilings(votes, SETTINGS).label_of(point, np.array([Label.CLUTTER], np.uint8))[0] == expected


def test_a_lower_ceiling_that_cuts_the_walls_of_a_room_hides_no_strip_of_its_own() -> None:
    """A metre of a higher ceiling, seen over a doorway's head between two lines that the corridor's ceiling leaves on its walls."""
    pieces = [
        (lying((0, 7), (0, 4), 0.01), Label.FLOOR),
        (lying((0, 4), (0, 4), 2.52), Label.CEILING),
        (lying((5.0, 6.0), (0, 4), 2.67), Label.CLUTTER),
        *((lying((x, x + 0.06), (0, 4), 2.52), Label.CEILING) for x in (4.9, 6.04)),
    ]
    votes = merge([vote(p, np.full(len(p), label, np.uint8), len(Label), 0.05) for p, label in pieces] * 3)
    places = np.array([[x, y, 2.67] for x in (5.15, 5.5, 5.85) for y in (0.5, 2.0, 3.5)])
    found = map_glimpsed_ceilings(votes, SETTINGS).label_of(places, np.full(len(places), Label.CLUTTER, np.uint8))
    assert np.all(found == Label.CEILING)


@pytest.mark.parametrize(
    ("x", "y", "is_of_room"),
    [
        ((1.5, 1.9), (0.5, 3.5), False),  # a duct, or a board over a wardrobe
        ((1.0, 2.5), (0.0, 4.0), True),  # a bulkhead
        ((4.1, 7.0), (0.0, 4.0), True),  # another room's, up to the wall between them
    ],
)
def test_a_narrow_strip_below_a_ceiling_is_no_rooms_ceiling(
    x: tuple[float, float], y: tuple[float, float], is_of_room: bool
) -> None:
    high = lying((0, 4), (0, 4), 3.02)
    high = high[(high[:, 0] < x[0]) | (high[:, 0] > x[1]) | (high[:, 1] < y[0]) | (high[:, 1] > y[1])]
    low, floor = lying(x, y, 2.72), lying((0, 7), (0, 4), 0.0)
    assert np.all(of_rooms(np.concatenate([high, low]), SETTINGS) == np.repeat([True, is_of_room], [len(high), len(low)]))
    # What a wall there has to reach is the room's own.
    votes = votes_of((floor, Label.FLOOR), (high, Label.CEILING), (low, Label.CEILING))
    clear_m = Storey.of(votes, (), SETTINGS).clear_m(np.array([[np.mean(x), np.mean(y)]]), 2.0)
    assert clear_m[0] == pytest.approx(2.72 if is_of_room else 3.02, abs=0.05)


def test_without_a_ceiling_no_room_has_one() -> None:
    assert of_rooms(np.zeros((0, 3)), SETTINGS).shape == (0,)


def upright(x: tuple[float, float], y: float, z: tuple[float, float]) -> np.ndarray:
    """(n, 3) points 5 cm apart on a wall along x."""
    xs, zs = (a.ravel() for a in np.meshgrid(np.arange(x[0] + 0.02, x[1], 0.05), np.arange(z[0] + 0.02, z[1], 0.05)))
    return np.column_stack([xs, np.full(len(xs), y), zs])


def test_where_nothing_was_seen_there_is_no_level() -> None:
    assert map_levels(vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05), (), SETTINGS) == ()


def attic(
    turn_deg: float, rise: float, x: tuple[float, float] = (0.0, 3.0), y: tuple[float, float] = (0.0, 2.0)
) -> np.ndarray:
    """(n, 3) points on a plane that begins 1.3 m above the floor and rises along y."""
    xs, ys = (a.ravel() for a in np.meshgrid(np.arange(x[0] + 0.02, x[1], 0.04), np.arange(y[0] + 0.02, y[1], 0.04)))
    noise_m = np.random.default_rng(4).normal(0, 0.006, len(xs))
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return np.column_stack([c * xs - s * ys, s * xs + c * ys, 1.3 + rise * (ys - y[0]) + noise_m])


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, 120.0])
@pytest.mark.parametrize("rise", [0.3, 0.8, 1.4])
def test_a_roofs_underside_is_ceiling_and_what_stands_below_it_not(turn_deg: float, rise: float) -> None:
    roof, floor = attic(turn_deg, rise), attic(turn_deg, 0.0) - [0.0, 0.0, 1.3]
    bed = attic(turn_deg, 0.0, (0.5, 2.5), (0.2, 1.2)) - [0.0, 0.0, 0.8]
    votes = votes_of((floor, Label.FLOOR), (roof, Label.CLUTTER), (bed, Label.CLUTTER))
    found = map_sloping_ceilings(votes, SETTINGS)
    assert np.mean(found.label_of(roof, np.zeros(len(roof), np.uint8)) == Label.CEILING) > 0.97
    assert not np.any(found.label_of(bed, np.zeros(len(bed), np.uint8)))
    # How high the room is, is told from it: what stands at a knee wall's foot reaches it.
    low = attic(turn_deg, rise, (1.0, 2.0), (0.2, 0.4))
    clear_m = Storey.of(votes, map_levels(votes, (), SETTINGS), SETTINGS).clear_m(low[:, :2], 2.0)
    np.testing.assert_allclose(clear_m, 1.3 + 0.3 * rise, atol=0.15 * rise + 0.05)
    assert np.isnan(Storey.of(votes, (), SETTINGS).clear_m(low[:, :2], 2.0)).all()


@pytest.mark.parametrize(
    ("rise", "x", "y"),
    [
        (0.0, (0.0, 3.0), (0.0, 2.0)),  # level: a bunk
        (0.8, (0.0, 0.6), (0.0, 2.0)),  # as narrow as a ladder, or a leaning board
        (2.5, (0.0, 3.0), (0.0, 2.0)),  # a wall that leans
    ],
)
def test_what_is_level_narrow_or_steep_is_no_sloping_ceiling(
    rise: float, x: tuple[float, float], y: tuple[float, float]
) -> None:
    floor = attic(0.0, 0.0) - [0.0, 0.0, 1.3]
    votes = votes_of((floor, Label.FLOOR), (attic(0.0, rise, x, y), Label.CLUTTER))
    assert np.isnan(map_sloping_ceilings(votes, SETTINGS).low_m).all()


@pytest.mark.parametrize(
    ("low_m", "noise_m", "share"),
    [
        (0.9, 0.0, 1.0),  # a drawing board
        (0.0, 0.08, 1.0),  # a heap
        (0.0, 0.0, 0.1),  # what few returns show
    ],
)
def test_what_is_low_rough_or_hardly_seen_is_no_sloping_ceiling(low_m: float, noise_m: float, share: float) -> None:
    generator = np.random.default_rng(5)
    floor = attic(0.0, 0.0) - [0.0, 0.0, 1.3]
    slope = attic(0.0, 0.3, y=(0.0, 2.0)) - [0.0, 0.0, low_m]
    slope[:, 2] += generator.normal(0, noise_m, len(slope))
    slope = slope[generator.uniform(size=len(slope)) < share]
    votes = votes_of((floor, Label.FLOOR), (slope, Label.CLUTTER))
    assert np.isnan(map_sloping_ceilings(votes, SETTINGS).low_m).all()


def test_what_lies_below_something_higher_is_no_sloping_ceiling() -> None:
    floor = attic(0.0, 0.0) - [0.0, 0.0, 1.3]
    above = attic(0.0, 0.0) + np.array([0.0, 0.0, 2.0])
    votes = votes_of((floor, Label.FLOOR), (attic(0.0, 0.5), Label.CLUTTER), (above, Label.CEILING))
    assert np.isnan(map_sloping_ceilings(votes, SETTINGS).low_m).all()


def test_nothing_slopes_in_an_empty_building() -> None:
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    floor = votes_of((lying((0, 4), (0, 4), 0.01), Label.FLOOR))
    for votes in (nothing, floor):
        assert np.isnan(map_sloping_ceilings(votes, SETTINGS).low_m).all()


@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((4.0, 8.0), (0.0, 4.0), 0.2, Label.FLOOR),
        ((4.0, 8.0), (0.0, 4.0), 0.5, Label.CLUTTER),  # a stage: no step
        ((4.0, 5.0), (1.0, 1.8), 0.2, Label.CLUTTER),  # a pallet
    ],
)
def test_the_front_of_a_step_is_floor_and_what_stands_at_its_foot_not(
    x: tuple[float, float], y: tuple[float, float], z: float, expected: Label
) -> None:
    high = lying(x, y, z)
    low = lying((0, 8), (0, 4), 0.01)
    low = low[(low[:, 0] < x[0]) | (low[:, 1] < y[0]) | (low[:, 1] > y[1])]
    front = upright((1.2, 1.6), 0.0, (0.05, z))[:, [1, 0, 2]] + [x[0], 0.0, 0.0]
    found = map_step_fronts(votes_of((low, Label.FLOOR), (high, Label.FLOOR), (front, Label.CLUTTER)), SETTINGS)
    assert np.all(found.label_of(front, np.zeros(len(front), np.uint8)) == expected)
    away = front - [0.3, 0.0, 0.0]
    above = front + np.array([0.0, 0.0, 0.3])
    for other in (away, above):
        assert not np.any(found.label_of(other, np.zeros(len(other), np.uint8)))


def test_a_ramp_has_no_step() -> None:
    low, ramp, high = lying((0, 4), (0, 4), 0.01), lying((4, 8), (0, 4), -0.4, 0.1), lying((8, 12), (0, 4), 0.4)
    found = map_step_fronts(votes_of((low, Label.FLOOR), (ramp, Label.FLOOR), (high, Label.FLOOR)), SETTINGS)
    assert np.isnan(found.low_m).all()
    nothing = vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05)
    assert np.isnan(map_step_fronts(nothing, SETTINGS).low_m).all()


@pytest.mark.parametrize(
    ("x", "y", "z", "expected"),
    [
        ((4.5, 7.5), (1.5, 2.7), 0.03, Label.FLOOR),  # of the next room, through its doorway
        ((4.5, 7.5), (1.5, 1.9), 0.03, Label.CLUTTER),  # a plank
        (
            (4.5, 7.5),
            (1.5, 2.7),
            0.12,
            Label.CLUTTER,
        ),  # a mattress, or the floor of a platform: too high to be the same
    ],
)
def test_floor_goes_on_level_where_no_scan_told(
    x: tuple[float, float], y: tuple[float, float], z: float, expected: Label
) -> None:
    generator = np.random.default_rng(6)
    beyond = generator.permutation(lying(x, y, z))[:350]
    found = map_floors_beyond(
        merge([votes_of((lying((0, 4), (0, 4), 0.01), Label.FLOOR)), votes_of((beyond, Label.CLUTTER), scans=1)]),
        SETTINGS,
    )
    inner = beyond[(beyond[:, 0] > x[0] + 0.4) & (beyond[:, 0] < x[1] - 0.4)]
    told = found.label_of(inner, np.zeros(len(inner), np.uint8))
    assert np.mean(told == expected) > 0.9


def test_single_returns_far_away_stretch_no_grid() -> None:
    room = [(lying((0, 8), (0, 6), 0.0), Label.FLOOR), (lying((0, 8), (0, 6), 2.6), Label.CEILING)]
    platform = [(lying((2, 6), (2, 5), 0.2), Label.CLUTTER)]
    far = np.array([[95.0, 3.0, 0.4], [-95.0, 3.0, 20.0], [3.0, 95.0, 0.1], [3.0, -95.0, 90.0]])
    strays = [
        (far, Label.CLUTTER),
        (far + np.array([0, 0, 1.0]), Label.FLOOR),
        (far + np.array([0, 0, 2.0]), Label.CEILING),
    ]
    alone, among_strays = votes_of(*room, *platform), votes_of(*room, *platform, *strays)
    points = np.concatenate([lying((-1, 9), (-1, 7), z) for z in (0.01, 0.21, 2.61)])
    clutter = np.full(len(points), Label.CLUTTER, np.uint8)
    for level, expected in zip(map_levels(among_strays, (), SETTINGS), map_levels(alone, (), SETTINGS), strict=True):
        assert level.surface is expected.surface
        assert level.low_m.size < 1.2 * expected.low_m.size + 500
        differ = np.mean(level.label_of(points, clutter) != expected.label_of(points, clutter))
        assert differ < 0.02


def test_the_median_of_a_neighbourhood_knows_what_any_of_the_nine_does() -> None:
    generator = np.random.default_rng(0)
    height_m = np.where(generator.random((30, 20)) < 0.2, generator.random((30, 20)), np.nan)
    padded = np.pad(height_m, 1, constant_values=np.nan)
    found = median_around(height_m)
    for row, column in np.ndindex(height_m.shape):
        nine = padded[row : row + 3, column : column + 3]
        expected = np.nan if np.isnan(nine).all() else np.nanmedian(nine)
        np.testing.assert_array_equal(found[row, column], expected)


class TestCeilingDrops:
    """A room of 4 by 3 m, 2.8 m high, with something below its ceiling; coordinates of its inner faces."""

    @staticmethod
    def standing(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
        """(n, 3) points 5 cm apart on the four upright sides of a box."""
        heights = np.arange(z[0] + 0.02, z[1], 0.05)
        along_x, along_y = np.arange(x[0], x[1] + 0.01, 0.05), np.arange(y[0], y[1] + 0.01, 0.05)
        ring = np.concatenate(
            [
                *(np.column_stack([along_x, np.full(len(along_x), side)]) for side in y),
                *(np.column_stack([np.full(len(along_y), side), along_y]) for side in x),
            ]
        )
        return np.column_stack([np.repeat(ring, len(heights), axis=0), np.tile(heights, len(ring))])

    @staticmethod
    def within(points: np.ndarray, x: tuple[float, float], y: tuple[float, float]) -> np.ndarray:
        """(n,) which points (n, 3) are above or below a rectangle."""
        low, high = np.array([x, y]).T
        return np.asarray(((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1))

    def corrected_share(self, *boxes: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]) -> float:
        """Which share of the boxes' undersides and sides becomes ceiling; what is within its scatter aside."""
        ceiling = lying((0, 4), (0, 3), 2.8)
        for x, y, _ in boxes:
            ceiling = ceiling[~self.within(ceiling, x, y)]
        hanging = np.concatenate(
            [np.concatenate([self.standing(*box), lying(box[0], box[1], box[2][0])]) for box in boxes]
        )
        inside = (hanging[:, :2] > 0.03).all(axis=1) & (hanging[:, 0] < 3.97) & (hanging[:, 1] < 2.97)
        hanging = hanging[inside]
        walls = self.standing((0, 4), (0, 3), (0, 2.8))
        for x, y, z in boxes:
            behind = (walls[:, :2] >= [x[0], y[0]]).all(axis=1) & (walls[:, :2] <= [x[1], y[1]]).all(axis=1)
            walls = walls[~(behind & (walls[:, 2] > z[0]))]
        label = self.labels(ceiling, hanging, walls)
        off_ceiling = hanging[:, 2] < 2.8 - SETTINGS.margin_m
        return float(np.mean(label[off_ceiling] == Label.CEILING))

    def labels(self, ceiling: np.ndarray, hanging: np.ndarray, walls: np.ndarray | None = None) -> np.ndarray:
        """What becomes of each of the places (n, 3) below a ceiling that scans took for clutter.

        walls: where they are not 2.8 m high everywhere.
        """
        votes = votes_of(
            (lying((0, 4), (0, 3), 0.0), Label.FLOOR),
            (ceiling, Label.CEILING),
            (self.standing((0, 4), (0, 3), (0, 2.8)) if walls is None else walls, Label.WALL),
            (hanging, Label.CLUTTER),
        )
        return corrected(map_levels(votes, (), SETTINGS), hanging, np.full(len(hanging), Label.CLUTTER, np.uint8))

    def test_a_beam_from_wall_to_wall_is_ceiling(self) -> None:
        assert self.corrected_share(((1.8, 2.1), (0, 3), (2.5, 2.8))) > 0.97

    def test_coffers_are_ceiling(self) -> None:
        beams = [((x, x + 0.2), (0, 3), (2.55, 2.8)) for x in (0.8, 2.2)]
        assert self.corrected_share(*beams, ((0, 4), (1.4, 1.6), (2.55, 2.8))) > 0.95

    def test_a_moulded_beam_is_ceiling(self) -> None:
        """Its side ends at the underside of its moulding, whose own side goes on up."""
        beam, moulding = (1.8, 2.1), (1.7, 2.2)
        sides = np.concatenate([self.standing(beam, (0, 3), (2.4, 2.66)), self.standing(moulding, (0, 3), (2.66, 2.8))])
        undersides = [lying(beam, (0, 3), 2.4), *(lying(x, (0, 3), 2.66) for x in ((1.7, 1.8), (2.1, 2.2)))]
        hanging = np.concatenate([sides, *undersides])
        hanging = hanging[(hanging[:, 1] > 0.03) & (hanging[:, 1] < 2.97)]
        ceiling = lying((0, 4), (0, 3), 2.8)
        label = self.labels(ceiling[~self.within(ceiling, moulding, (0, 3))], hanging)
        assert np.mean(label[hanging[:, 2] < 2.76] == Label.CEILING) > 0.95

    def test_a_duct_on_hangers_is_no_beam_however_rough_its_underside(self) -> None:
        x, y, z = (1.85, 2.15), (0.0, 3.0), (2.3, 2.6)
        hangers = [self.standing((1.98, 2.02), (at - 0.02, at + 0.02), (z[1], 2.8)) for at in np.arange(0.3, 3.0, 0.3)]
        hanging = np.concatenate([self.standing(x, y, z), lying(x, y, z[0]), *hangers])
        hanging = hanging[(hanging[:, 1] > 0.03) & (hanging[:, 1] < 2.97)]
        hanging[:, 2] += np.random.default_rng(2).normal(0, 0.005, len(hanging))
        label = self.labels(lying((0, 4), (0, 3), 2.8), hanging)
        assert np.mean(label[hanging[:, 2] < 2.55] == Label.CEILING) < 0.05

    def test_a_duct_that_hangs_well_below_a_beam_is_no_step_of_it(self) -> None:
        duct, beam = (1.85, 2.05), (1.75, 2.15)
        hanging = np.concatenate([
            self.standing(duct, (0, 3), (2.1, 2.35)), lying(duct, (0, 3), 2.1),
            self.standing(beam, (0, 3), (2.55, 2.8)), lying((1.75, 1.85), (0, 3), 2.55), lying((2.05, 2.15), (0, 3), 2.55),
        ])  # fmt: skip
        hanging = hanging[(hanging[:, 1] > 0.03) & (hanging[:, 1] < 2.97)]
        ceiling = lying((0, 4), (0, 3), 2.8)
        label = self.labels(ceiling[~self.within(ceiling, beam, (0, 3))], hanging)
        assert np.mean(label[hanging[:, 2] < 2.4] == Label.CEILING) < 0.05

    def test_a_beam_under_a_ceiling_that_rises_along_the_room_is_ceiling(self) -> None:
        """It closes up to the ceiling beside it, whose highest place within reach is 24 cm higher."""

        def below_ceiling(points: np.ndarray) -> np.ndarray:
            return np.asarray(points[points[:, 2] < 2.8 + 0.3 * points[:, 0]])

        ceiling = lying((0, 4), (0, 3), 2.8, slope=0.3)
        ceiling = ceiling[(ceiling[:, 0] < 1.8) | (ceiling[:, 0] > 2.1)]
        sides = below_ceiling(self.standing((1.8, 2.1), (0, 3), (3.0, 4.0)))
        beam = np.concatenate([sides, lying((1.8, 2.1), (0, 3), 3.0)])
        beam = beam[(beam[:, 1] > 0.03) & (beam[:, 1] < 2.97)]
        walls = below_ceiling(self.standing((0, 4), (0, 3), (0, 4.0)))
        assert np.mean(self.labels(ceiling, beam, walls) == Label.CEILING) > 0.95

    def test_a_soffit_along_a_wall_is_ceiling(self) -> None:
        assert self.corrected_share(((0, 4), (0, 0.5), (2.4, 2.8))) > 0.95

    def test_a_soffit_closes_up_to_the_ceiling_beside_it_whatever_a_pane_mirrors_above(self) -> None:
        x, y = (0.0, 4.0), (0.0, 0.7)
        soffit = np.concatenate([self.standing(x, (y[1], y[1]), (2.2, 2.8)), lying(x, y, 2.2)])
        soffit = soffit[(soffit[:, 0] > 0.03) & (soffit[:, 0] < 3.97) & (soffit[:, 1] > 0.03)]
        mirrored = lying((0.5, 3.5), y, 3.3)
        walls = self.standing((0, 4), (0, 3), (0, 2.8))
        walls = walls[(walls[:, 1] > y[1]) | (walls[:, 2] < 2.2)]
        label = self.labels(np.concatenate([lying(x, (y[1], 3), 2.8), mirrored]), soffit, walls)
        assert np.mean(label[soffit[:, 2] < 2.76] == Label.CEILING) > 0.95

    @pytest.mark.parametrize(("depth_m", "is_ceiling"), [(0.7, True), (0.3, False)])
    def test_a_soffit_is_ceiling_though_scans_took_its_side_for_a_wall(self, depth_m: float, is_ceiling: bool) -> None:
        """What is no deeper than walls are thick may be the underside of a lintel, whose wall closes up to the ceiling."""
        side = self.standing((0, 4), (depth_m, depth_m), (2.3, 2.8))
        underside = lying((0.03, 3.97), (0.03, depth_m), 2.3)
        walls = self.standing((0, 4), (0, 3), (0, 2.8))
        walls = walls[(walls[:, 1] > depth_m) | (walls[:, 2] < 2.3)]
        label = self.labels(lying((0, 4), (depth_m, 3), 2.8), underside, np.concatenate([walls, side, side]))
        assert np.mean(label == Label.CEILING) > 0.9 if is_ceiling else np.mean(label == Label.CEILING) < 0.1

    @pytest.mark.parametrize("length_m", [1.2, 1.5])
    def test_a_lamp_is_held_by_no_wall(self, length_m: float) -> None:
        assert self.corrected_share(((1.2, 1.2 + length_m), (1.4, 1.6), (2.6, 2.8))) == 0

    def test_what_is_longer_than_lamps_are_is_ceiling_though_its_ends_are_hidden(self) -> None:
        assert self.corrected_share(((1.0, 3.3), (1.4, 1.6), (2.5, 2.8))) > 0.95

    @pytest.mark.parametrize(
        ("x", "y", "pillars", "is_ceiling"),
        [
            ((1.8, 2.0), (0.0, 1.0), (), True),
            # From a pillar to a pillar along one wall; and longer than lamps are, with a slit behind it.
            ((1.0, 2.4), (0.3, 0.5), ((0.7, 0.95), (2.45, 2.7)), False),
            ((0.6, 2.8), (0.25, 0.5), (), False),
            # On one wall alone; and between two all along, which are seen to go on above it.
            ((1.8, 2.0), (0.0, 0.7), (), False),
            ((1.0, 2.6), (0.15, 0.85), (), False),
        ],
    )
    @pytest.mark.parametrize("turned", [False, True])
    def test_a_beam_across_a_corridor_is_ceiling_and_what_runs_along_its_wall_not(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        pillars: tuple[tuple[float, float], ...],
        is_ceiling: bool,
        turned: bool,
    ) -> None:
        """Nothing in a corridor is far from its walls."""
        ceiling = lying((0, 4), (0, 1.0), 2.8)
        # Into slits on both sides one does not see up to the ceiling.
        ceiling = ceiling[~self.within(ceiling, x, (0.0, 1.0) if y == (0.15, 0.85) else y)]
        hanging = np.concatenate([self.standing(x, y, (2.5, 2.8)), lying(x, y, 2.5)])
        hanging = hanging[(hanging[:, 1] > 0.03) & (hanging[:, 1] < 0.97)]
        standing = [self.standing((0, 4), (0, 1.0), (0, 2.8)), *(self.standing(at, (0, 0.5), (0, 2.8)) for at in pillars)]
        turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) if turned else np.eye(3)
        label = self.labels(ceiling @ turn, hanging @ turn, np.concatenate(standing) @ turn)
        share = np.mean(label[hanging[:, 2] < 2.8 - SETTINGS.margin_m] == Label.CEILING)
        assert share > 0.95 if is_ceiling else share < 0.05

    def test_a_duct_leaves_a_slit_to_its_wall(self) -> None:
        assert self.corrected_share(((0, 4), (0.25, 0.55), (2.4, 2.8))) < 0.05

    def test_what_shows_in_the_slit_between_a_duct_and_its_wall_is_no_beam(self) -> None:
        duct, slit = ((0.0, 4.0), (0.2, 0.5), (2.3, 2.5)), ((0.0, 4.0), (0.08, 0.12), (2.55, 2.8))
        assert self.corrected_share(duct, slit) < 0.05

    @pytest.mark.parametrize(
        ("gap_m", "low_m", "seen_m", "is_ceiling"),
        [(0.06, 2.4, 0.15, False), (0.06, 2.38, 0.11, False), (0.0, 2.4, 0.0, True)],
    )
    def test_a_duct_that_all_but_touches_wall_and_ceiling_leaves_its_wall_in_view(
        self, gap_m: float, low_m: float, seen_m: float, is_ceiling: bool
    ) -> None:
        """Through a slit of 6 cm the wall is seen 11 to 15 cm above the duct's underside; over a soffit nothing of it is."""
        box = ((0.0, 4.0), (gap_m, 0.45), (low_m, 2.75))
        hanging = np.concatenate([self.standing(*box), lying(box[0], box[1], box[2][0])])
        hanging = hanging[(hanging[:, 0] > 0.03) & (hanging[:, 0] < 3.97) & (hanging[:, 1] > 0.03)]
        walls = self.standing((0, 4), (0, 3), (0, 2.8))
        walls = walls[(walls[:, 1] > 0.0) | (walls[:, 2] < low_m + seen_m)]
        label = self.labels(lying((0, 4), (0.45, 3), 2.8), hanging, walls)
        assert np.mean(label == Label.CEILING) > 0.95 if is_ceiling else np.mean(label == Label.CEILING) < 0.05

    def test_a_duct_leaves_air_above_it(self) -> None:
        assert self.corrected_share(((1.8, 2.1), (0, 3), (2.3, 2.55))) < 0.05

    def test_a_cupboard_that_reaches_the_ceiling_stands(self) -> None:
        assert self.corrected_share(((0, 1.2), (0, 0.5), (0.0, 2.8))) < 0.1


@pytest.mark.parametrize("taken_for", [Label.WALL, Label.CLUTTER])
def test_walls_below_the_floor_are_of_the_storey_below(taken_for: Label) -> None:
    """Seen down a stairwell beside the floor, whatever scans took them for."""
    wall = np.array([[3.5, y, z] for y in np.arange(0.02, 2, 0.05) for z in np.arange(-2.5, 2.5, 0.05)])
    votes = votes_of((lying((0, 2), (0, 2), 0.0), Label.FLOOR), (wall, taken_for))
    label = corrected(map_levels(votes, (), SETTINGS), wall, np.full(len(wall), Label.WALL, np.uint8))
    below = wall[:, 2] < -SETTINGS.below_floor_m - 0.01
    assert (label[below] == Label.OUTSIDE).all()
    assert (label[wall[:, 2] > -SETTINGS.below_floor_m + 0.01] == Label.WALL).all()


def looking_up(ends: np.ndarray, label: Label, sensor: tuple[float, float, float] = (3.0, 3.0, 1.0)) -> Features:
    """One scan with rays to these ends (n, 3)."""
    return rays_alone(np.array(sensor), ends, np.full(len(ends), label, np.uint8))


class TestRooflights:
    """A room 3 m high with a pane across it, at y from 2 to 4 m, in which the robot below it sees its own floor, 6 m up."""

    floor = lying((0, 6), (0, 6), 0.0)
    ceiling = np.concatenate([lying((0, 6), (0, 2), 3.0), lying((0, 6), (4, 6), 3.0)])
    pane = lying((2, 4), (2, 4), 3.0)
    mirrored = lying((1.2, 4.8), (1.2, 4.8), 6.0)

    def levels(self, mirrored_as: Label, *more: tuple[np.ndarray, Label], height_m: float = 6.0) -> tuple[HeightMap, ...]:
        """Seen by two portions of scans: of one in the room, and of one that stands above its ceiling."""
        high = self.mirrored + np.array([0.0, 0.0, height_m - 6.0])
        votes = votes_of((self.floor, Label.FLOOR), (self.ceiling, Label.CEILING), (high, mirrored_as), *more)
        blocks = [looking_up(high, mirrored_as), looking_up(high, mirrored_as, (3.0, 3.0, 5.0))]
        return map_levels(votes, blocks, SETTINGS)

    def labels(self, levels: tuple[HeightMap, ...], points: np.ndarray, label: Label) -> np.ndarray:
        return corrected(levels, points, np.full(len(points), label, np.uint8))

    @pytest.mark.parametrize("mirrored_as", [Label.CEILING, Label.CLUTTER])
    @pytest.mark.parametrize("pane_as", [Label.CEILING, Label.CLUTTER])
    def test_the_floor_that_a_pane_mirrors_is_outside(self, mirrored_as: Label, pane_as: Label) -> None:
        levels = self.levels(mirrored_as, (self.pane[::7], pane_as))
        inner = self.mirrored[np.abs(self.mirrored[:, :2] - 3.0).max(axis=1) < 1.5]
        assert np.mean(self.labels(levels, inner, mirrored_as) == Label.OUTSIDE) > 0.95
        # So is what stands on it, upside down; the pane, and the ceiling beside it, are not.
        assert (self.labels(levels, np.array([[3.0, 3.0, 4.5]]), Label.WALL) == Label.OUTSIDE).all()
        for kept in (self.pane, self.pane + np.array([0.0, 0.0, 0.2]), self.ceiling):
            assert (self.labels(levels, kept, Label.CEILING) == Label.CEILING).all()

    def test_the_ceiling_of_a_hall_is_none(self) -> None:
        for more in ((), ((lying((2.9, 3.1), (2.0, 4.0), 3.0), Label.CLUTTER),)):  # a row of lamps half way up
            levels = self.levels(Label.CEILING, *more)
            assert (self.labels(levels, self.mirrored, Label.CEILING) == Label.CEILING).all()

    def test_what_lies_farther_up_than_its_mirrored_floor_is_none(self) -> None:
        levels = self.levels(Label.CEILING, (self.pane[::7], Label.CLUTTER), height_m=6.6)
        high = self.mirrored + np.array([0.0, 0.0, 0.6])
        assert (self.labels(levels, high, Label.CEILING) == Label.CEILING).all()

    def test_scans_may_disagree_what_the_mirrored_floor_is(self) -> None:
        """As many call it clutter as ceiling: no ceiling is made of either."""
        levels = self.levels(Label.CEILING, (self.mirrored, Label.CLUTTER), (self.pane[::7], Label.CLUTTER))
        assert not any(
            level.label_of(np.array([[3.0, 3.0, 6.0]]), np.array([Label.CLUTTER], np.uint8))[0] == Label.CEILING for level in levels
        )

    def test_a_ceiling_that_is_high_itself_stays(self) -> None:
        """Below the mirrored floor, whose cells rays to the ceiling end in too; all of it 2 m higher."""
        ceiling, pane = (places + np.array([0.0, 0.0, 2.0]) for places in (self.ceiling, self.pane))
        mirrored = self.mirrored + np.array([0.0, 0.0, 4.0])
        votes = votes_of(
            (self.floor, Label.FLOOR), (ceiling, Label.CEILING), (pane[::7], Label.CLUTTER), (mirrored, Label.CLUTTER)
        )
        levels = map_levels(votes, [looking_up(mirrored, Label.CLUTTER), looking_up(ceiling, Label.CEILING)], SETTINGS)
        inner = mirrored[np.abs(mirrored[:, :2] - 3.0).max(axis=1) < 1.5]
        assert np.mean(self.labels(levels, inner, Label.CLUTTER) == Label.OUTSIDE) > 0.95
        assert (self.labels(levels, ceiling, Label.CEILING) == Label.CEILING).all()

    def test_few_rays_do_not_tell(self) -> None:
        votes = votes_of(
            (self.floor, Label.FLOOR), (self.ceiling, Label.CEILING), (self.mirrored, Label.CLUTTER), (self.pane, Label.CLUTTER)
        )
        seen = np.unique(np.floor(self.mirrored / 0.25), axis=0) * 0.25 + [0.1, 0.1, 0.0]
        for rays, known in ((1, False), (4, True)):
            scan = looking_up(np.repeat(seen, rays, axis=0), Label.CLUTTER)
            assert map_mirrored_floors(votes, [scan], SETTINGS).known.any() == known

    def test_without_anything_high_no_scan_is_asked(self) -> None:
        def blocks() -> Iterator[Features]:
            raise AssertionError
            yield

        votes = votes_of((self.floor, Label.FLOOR), (self.ceiling, Label.CEILING))
        assert not map_mirrored_floors(votes, blocks(), SETTINGS).known.any()
