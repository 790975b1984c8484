"""Properties that hold for any input: transforms, votes, floor and ceilings of wild clouds, labels of wild scans."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import Trajectory, place_scan
from ffmap.algorithms.building.votes import VoxelTable, VoxelVotes
from ffmap.algorithms.scan.ceiling import _CEILINGS_MAX, find_ceilings
from ffmap.algorithms.scan.floor import Floor, find_floor
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, RearrangementSettings
from tests import synthetic
from tests.voting import vote

REARRANGEMENT = RearrangementSettings()
METHOD = synthetic.settings()
CODES = 6
EDGE_M = 0.05

seeded = settings(derandomize=True, deadline=None, max_examples=100)
fewer = settings(seeded, max_examples=40)


def reals(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


def points(
    most: int, reach_m: float, dtype: type[np.floating] = np.float32, least: int = 0
) -> st.SearchStrategy[np.ndarray]:
    """Points (n, 3); Hypothesis likes zeros, equal ones and the ends of the range."""
    width = 32 if dtype is np.float32 else 64
    return st.integers(least, most).flatmap(
        lambda n: arrays.arrays(
            dtype, (n, 3), elements=st.floats(-reach_m, reach_m, allow_nan=False, allow_subnormal=False, width=width)
        )
    )


@st.composite
def rigid(draw: st.DrawFn) -> np.ndarray:
    turn = [draw(reals(-4.0, 4.0)) for _ in range(3)]
    return transforms.make_transform(Rotation.from_rotvec(turn), [draw(reals(-1e3, 1e3)) for _ in range(3)])


class TestTransforms:
    @seeded
    @given(T=rigid(), p=points(8, 100.0, np.float64, least=1))
    def test_there_and_back(self, T: np.ndarray, p: np.ndarray) -> None:
        moved = transforms.apply(T, p)
        np.testing.assert_allclose(transforms.apply(transforms.invert(T), moved), p, atol=1e-9)
        np.testing.assert_allclose(transforms.apply(T, transforms.apply(transforms.invert(T), p)), p, atol=1e-9)
        np.testing.assert_allclose(moved, np.array([T[:3, :3] @ q + T[:3, 3] for q in p]), atol=1e-9)
        np.testing.assert_allclose(  # what is rigid keeps distances
            np.linalg.norm(moved - moved[0], axis=1), np.linalg.norm(p - p[0], axis=1), atol=1e-9
        )

    @seeded
    @given(T=rigid(), other=rigid())
    def test_the_inverse_is_the_matrixs_of_one_and_of_a_stack(self, T: np.ndarray, other: np.ndarray) -> None:
        np.testing.assert_allclose(transforms.invert(T), np.linalg.inv(T), atol=1e-9)
        np.testing.assert_allclose(transforms.invert(transforms.invert(T)), T, atol=1e-9)
        stack = np.stack([T, other])
        np.testing.assert_array_equal(
            transforms.invert(stack), np.stack([transforms.invert(T), transforms.invert(other)])
        )
        np.testing.assert_allclose(
            transforms.invert(T @ other), transforms.invert(other) @ transforms.invert(T), atol=1e-9
        )

    @seeded
    @given(T=rigid(), p=points(8, 100.0, np.float64, least=1), other=rigid())
    def test_one_after_the_other_is_the_product(self, T: np.ndarray, p: np.ndarray, other: np.ndarray) -> None:
        np.testing.assert_allclose(
            transforms.apply(T, transforms.apply(other, p)), transforms.apply(T @ other, p), atol=1e-9
        )

    @seeded
    @given(T=rigid())
    def test_quaternions_there_and_back(self, T: np.ndarray) -> None:
        quaternion = transforms.quaternion_xyzw(T)
        assert quaternion[3] >= 0
        assert np.linalg.norm(quaternion) == pytest.approx(1)
        np.testing.assert_allclose(transforms.from_quaternion(T[:3, 3], quaternion), T, atol=1e-9)

    @seeded
    @given(yaw_rad=reals(-3.1, 3.1), at=st.lists(reals(-1e3, 1e3), min_size=3, max_size=3))
    def test_headings_there_and_back(self, yaw_rad: float, at: list[float]) -> None:
        T = transforms.from_yaw(yaw_rad, at)
        assert transforms.yaw_of(T) == pytest.approx(yaw_rad, abs=1e-9)
        np.testing.assert_array_equal(T[:3, 3], at)
        np.testing.assert_allclose(T[2, :3], [0, 0, 1], atol=1e-12)


def same(a: VoxelVotes, b: VoxelVotes) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in ("keys", "counts", "position_sum", "point_count")
    )


@st.composite
def voters(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Points with codes, many of them in few cubes, some on their faces, with some codes that have no vote."""
    count = draw(st.integers(1, 60))
    whole = arrays.arrays(np.int64, (count, 3), elements=st.integers(-3, 3))
    within = arrays.arrays(np.float64, (count, 3), elements=st.floats(0, 1, exclude_max=True, allow_subnormal=False))
    code = arrays.arrays(np.uint8, count, elements=st.sampled_from([*range(CODES), CODES, 255]))
    return (draw(whole) + draw(within)) * EDGE_M, draw(code)


class TestVotes:
    @seeded
    @given(voters=voters(), data=st.data())
    def test_neither_order_nor_portions_matter(
        self, voters: tuple[np.ndarray, np.ndarray], data: st.DataObject
    ) -> None:
        place, code = voters
        whole = vote(place, code, CODES, EDGE_M)
        order = np.array(data.draw(st.permutations(range(len(place)))))
        cuts = sorted(data.draw(st.lists(st.integers(0, len(place)), max_size=6)))
        table = VoxelTable(EDGE_M, CODES)
        for portion in np.split(order, cuts):  # some of them empty
            if data.draw(st.booleans()):
                table.add(place[portion], code[portion])
            else:  # counted elsewhere
                known = set(table.votes().keys.tolist())
                elsewhere = vote(place[portion], code[portion], CODES, EDGE_M)
                new = table.absorb(elsewhere)
                assert new.tolist() == [key not in known for key in elsewhere.keys.tolist()]
        assert same(table.votes(), whole)
        assert len(table) == len(whole)

    @seeded
    @given(voters=voters())
    def test_every_point_is_counted_once_in_its_own_cube(self, voters: tuple[np.ndarray, np.ndarray]) -> None:
        place, code = voters
        whole = vote(place, code, CODES, EDGE_M)
        cubes = [tuple(cube) for cube in np.floor(place * (1 / EDGE_M)).astype(int).tolist()]
        assert dict(zip(map(tuple, whole.cube_index.tolist()), whole.point_count.tolist(), strict=True)) == Counter(
            cubes
        )
        votes = Counter((cube, c) for cube, c in zip(cubes, code.tolist(), strict=True) if c < CODES)
        for cube, row in zip(whole.cube_index.tolist(), whole.counts.tolist(), strict=True):
            assert row == [votes[tuple(cube), c] for c in range(CODES)]
        # The mean place lies within the cube.
        within = whole.mean_position / EDGE_M - whole.cube_index
        assert np.all((within > -1e-6) & (within < 1 + 1e-6))


@st.composite
def clouds(draw: st.DrawFn) -> np.ndarray:
    """Wild clouds (n, 3): scattered, on one point, on a line, on levels, on a ramp, near and far."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.sampled_from([2000, 100, 61, 60, 19, 3, 2, 1, 0]))
    reach_m = draw(st.sampled_from([3.0, 1e-3, 0.3, 30.0, 200.0]))
    cloud = generator.uniform(-reach_m, reach_m, (count, 3))
    kind = draw(st.sampled_from(["levels", "ramp", "scattered", "one point", "upright", "level", "far away"]))
    if kind == "one point" and count:
        cloud[:] = cloud[0]
    elif kind == "upright" and count:
        cloud[:, :2] = cloud[0, :2]
    elif kind == "level":
        cloud[:, 2] = draw(reals(-5, 5))
    elif kind == "levels":
        cloud[:, 2] = generator.choice([0.0, 0.01, 0.1, 2.4, 2.8, 2.85, 3.1], count)
    elif kind == "ramp":
        cloud[:, 2] = draw(st.sampled_from([0.0, 2.5])) + 0.12 * cloud[:, 0]
    elif kind == "far away":
        cloud += generator.uniform(-150, 150, 3)
    return cloud.astype(np.float32)


WILD = st.one_of(clouds(), clouds(), points(100, 200.0))


def is_sound(plane: HorizontalPlane, slope_max: float, cloud: np.ndarray) -> bool:
    return (
        np.isfinite(plane.height_m)
        and plane.slope.shape == (2,)
        and float(np.hypot(*plane.slope)) <= slope_max + 1e-9
        and 0 <= plane.support <= len(cloud)
        and bool(np.all(np.isfinite(plane.height_at(cloud))))
        and plane.height_at(cloud).shape == (len(cloud),)
    )


class TestHorizontalPlanes:
    def test_any_cloud_has_a_floor(self) -> None:
        found = Counter[bool]()

        @seeded
        @given(cloud=WILD)
        @example(np.zeros((0, 3), np.float32))
        @example(np.zeros((1000, 3), np.float32))
        @example(np.full((1000, 3), 0.2, np.float32))
        def check(cloud: np.ndarray) -> None:
            floor = find_floor(cloud, REARRANGEMENT)
            assert is_sound(floor, REARRANGEMENT.floor_slope_max, cloud)
            if np.count_nonzero(np.abs(cloud[:, 2]) <= REARRANGEMENT.floor_search_m) < 20:
                # Too few returns near it: the map's own.
                assert (floor.height_m, floor.slope.tolist(), floor.support) == (0.0, [0.0, 0.0], 0)
            found[floor.support > 0] += 1

        check()
        assert min(found[False], found[True]) > 10, found  # both were met

    def test_any_cloud_has_sound_ceilings_or_none(self) -> None:
        found = Counter[int]()

        @seeded
        @given(cloud=WILD, seed=st.integers(0, 2**32 - 1))
        @example(np.zeros((0, 3), np.float32), 0)
        @example(np.full((1000, 3), 2.5, np.float32), 0)
        def check(cloud: np.ndarray, seed: int) -> None:
            ceilings = find_ceilings(cloud, cloud[:, 2], Floor(0.0, np.zeros(2), 0), REARRANGEMENT, seed)
            assert len(ceilings) <= _CEILINGS_MAX
            assert all(is_sound(ceiling, 0.03, cloud) for ceiling in ceilings)
            high = cloud[:, 2] > REARRANGEMENT.ceiling_height_min_m
            if np.count_nonzero(high) < max(30, int(REARRANGEMENT.ceiling_support_min * len(cloud))):
                assert ceilings == ()
            found[len(ceilings)] += 1

        check()
        assert min(found[0], found[1], found[2] + found[3]) > 1, found  # none, one and several were met

    @fewer
    @given(
        height_m=reals(-0.2, 0.2),
        ceiling_m=reals(2.3, 6.0),
        seed=st.integers(0, 2**32 - 1),
        junk=st.integers(0, 1000),
    )
    def test_what_is_there_is_found_whatever_flies_about(
        self, height_m: float, ceiling_m: float, seed: int, junk: int
    ) -> None:
        generator = np.random.default_rng(seed)
        cloud = generator.uniform(-5, 5, (6000 + junk, 3))
        cloud[:3000, 2] = height_m + generator.normal(0, 0.01, 3000)
        cloud[3000:6000, 2] = ceiling_m + generator.normal(0, 0.01, 3000)
        cloud = generator.permutation(cloud).astype(np.float32)
        floor = find_floor(cloud, REARRANGEMENT)
        assert floor.height_m == pytest.approx(height_m, abs=0.01)
        ceilings = find_ceilings(cloud, floor.heights_above(cloud), floor, REARRANGEMENT, seed)
        assert ceilings[0].height_m == pytest.approx(ceiling_m, abs=0.01)
        assert max(np.hypot(*floor.slope), np.hypot(*ceilings[0].slope)) < 0.005

    @fewer
    @given(
        steepness=reals(0.0, 0.06),
        towards_rad=reals(-3.1, 3.1),
        bound=st.sampled_from([0.0, 0.03, 0.09]),
        seed=st.integers(0, 2**32 - 1),
    )
    @example(0.06, 0.5, 0.03, 0)
    @example(0.06, 0.5, 0.0, 0)
    def test_a_floor_slopes_as_it_does_but_no_more_than_its_bound(
        self, steepness: float, towards_rad: float, bound: float, seed: int
    ) -> None:
        generator = np.random.default_rng(seed)
        slope = steepness * np.array([np.cos(towards_rad), np.sin(towards_rad)])
        cloud = generator.uniform(-3, 3, (6000, 3))
        cloud[:, 2] = cloud[:, :2] @ slope + generator.normal(0, 0.005, 6000)
        floor = find_floor(cloud.astype(np.float32), REARRANGEMENT.model_copy(update={"floor_slope_max": bound}))
        expected = slope * min(1.0, bound / max(steepness, 1e-12))
        np.testing.assert_allclose(floor.slope, expected, atol=0.002)
        assert np.hypot(*floor.slope) <= bound + 1e-9


ROOM = synthetic.scan(firings=700)


def scan_of(cloud: np.ndarray, ring: np.ndarray, ring_count: int, time_ns: np.ndarray | None) -> Scan:
    return replace(synthetic.scan_of(cloud, ring, ring_count), time_ns=time_ns)


@st.composite
def times(draw: st.DrawFn, count: int) -> np.ndarray | None:
    kind = draw(st.sampled_from(["none", "in order", "in any order"]))
    if kind == "none":
        return None
    time_ns = np.linspace(0, 1e8, count).astype(np.int64)
    return time_ns if kind == "in order" else np.random.default_rng(draw(st.integers(0, 99))).permutation(time_ns)


@st.composite
def scans_of_junk(draw: st.DrawFn) -> Scan:
    cloud, ring_count = draw(WILD), draw(st.sampled_from([1, 2, 16, 128]))
    ring = np.random.default_rng(draw(st.integers(0, 99))).integers(0, ring_count, len(cloud))
    return scan_of(cloud, ring, ring_count, draw(times(len(cloud))))


@st.composite
def scans_of_a_harmed_room(draw: st.DrawFn) -> Scan:
    """A room's scan that is thinned, doubled, shuffled, shrunk, blurred, mixed with junk or read with wrong rings."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kept = np.flatnonzero(generator.random(len(ROOM)) < draw(st.sampled_from([1.0, 0.7, 0.2, 0.01])))
    if draw(st.booleans()):
        kept = generator.choice(kept, len(kept))  # some twice, some not, in any order
    room = ROOM.points_sensor[kept] * draw(st.sampled_from([1.0, 1.1, 0.3, 4.0]))
    room = room + generator.normal(0, draw(st.sampled_from([0.0, 0.02, 0.3])), room.shape)
    junk = draw(WILD)
    ring = np.concatenate([ROOM.ring[kept], generator.integers(0, ROOM.ring_count, len(junk))])
    if draw(st.sampled_from([False, False, True])):
        ring = generator.permutation(ring)
    return scan_of(np.concatenate([room, junk]), ring, ROOM.ring_count, draw(times(len(ring))))


class TestLabels:
    @pytest.mark.parametrize(
        ("scans", "expected"),
        [
            (scans_of_junk(), {Label.CLUTTER}),
            (scans_of_a_harmed_room(), {Label.CLUTTER, Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR}),
        ],
        ids=["junk", "harmed room"],
    )
    def test_every_return_of_any_scan_has_a_label(self, scans: st.SearchStrategy[Scan], expected: set[Label]) -> None:
        met = Counter[int]()

        @seeded
        @given(
            scan=scans,
            tilt_deg=st.sampled_from([(0.0, 0.0), (0.0, 0.0), (1.0, -2.0), (-30.0, 20.0)]),
            yaw_rad=reals(-3.0, 3.0),
            seed=st.integers(0, 2**32 - 1),
        )
        def check(scan: Scan, tilt_deg: tuple[float, float], yaw_rad: float, seed: int) -> None:
            tilt = Rotation.from_euler("ZYX", [np.degrees(yaw_rad), *tilt_deg], degrees=True)
            T_map_base = np.stack([transforms.make_transform(tilt, [x, 0.0, 0.0]) for x in (0.0, 0.05)])
            placed = place_scan(scan, Trajectory(np.array([0, 100_000_000]), T_map_base), synthetic.T_BASE_SENSOR)
            found = label_scan(scan, placed, METHOD, seed)
            assert found.label.shape == found.plane.shape == found.height_m.shape == (len(scan),)
            assert found.label.dtype == np.uint8
            assert np.all(found.label <= max(Label))
            assert np.all(np.isfinite(found.height_m))
            # Walls and doors, and they alone, lie on a plane of this scan; ceilings there are where some were found.
            np.testing.assert_array_equal(found.plane >= 0, np.isin(found.label, [Label.WALL, Label.DOOR]))
            assert np.all(found.plane < len(found.planes))
            assert np.all(np.isfinite(found.planes.normal))
            assert np.all(np.isfinite(found.planes.ends))
            assert found.ceilings or not np.any(found.label == Label.CEILING)
            # The same scan and seed give the same labels.
            np.testing.assert_array_equal(label_scan(scan, placed, METHOD, seed).label, found.label)
            met.update(set(found.label.tolist()))

        check()
        # None of that was said of clutter alone: what junk happens to contain depends on Hypothesis, a room does not.
        assert expected <= set(met), met


@pytest.mark.parametrize("far_m", [1e5, 1e9, 1e19, 3e38])
def test_one_damaged_return_changes_nothing_else(far_m: float) -> None:
    whole = synthetic.scan(firings=1000)
    points = whole.points_sensor.copy()
    points[777] = (-far_m, 0.3, 0.3)
    harmed = replace(whole, points_sensor=points)
    labels = [
        label_scan(
            scan, place_scan(scan, synthetic.trajectory(3), synthetic.T_BASE_SENSOR), synthetic.settings(), 0
        ).label
        for scan in (whole, harmed)
    ]
    assert np.mean(labels[0] != labels[1]) < 0.001
    assert labels[1][777] == Label.CLUTTER
