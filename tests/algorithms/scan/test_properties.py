"""Properties that hold for any input: floor, ceilings and labels of wild scans."""

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
from ffmap.algorithms.scan.ceiling import find_ceilings
from ffmap.algorithms.scan.floor import FLOOR_SEARCH_M, Floor, find_floor
from ffmap.algorithms.scan.labelling import label_scan
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, RearrangementSettings
from tests import synthetic

REARRANGEMENT = RearrangementSettings()
METHOD = synthetic.settings()
SEEDS = st.integers(0, 2**32 - 1)

seeded = settings(derandomize=True, deadline=None, max_examples=100)


def reals(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


def points(count_max: int, reach_m: float) -> st.SearchStrategy[np.ndarray]:
    """Points (n, 3); Hypothesis likes zeros, equal ones and the ends of the range."""
    within = st.floats(-reach_m, reach_m, allow_nan=False, allow_subnormal=False, width=32)
    return st.integers(0, count_max).flatmap(
        lambda n: arrays.arrays(np.float32, (n, 3), elements=within)
    )


@st.composite
def clouds(draw: st.DrawFn) -> np.ndarray:
    """Wild clouds (n, 3): scattered, on one point, on a line, on levels, on a ramp, far away."""
    generator = np.random.default_rng(draw(SEEDS))
    count = draw(st.sampled_from([2000, 100, 61, 60, 19, 3, 2, 1, 0]))
    reach_m = draw(st.sampled_from([3.0, 1e-3, 0.3, 30.0, 200.0]))
    cloud = generator.uniform(-reach_m, reach_m, (count, 3))
    kinds = ["levels", "ramp", "scattered", "one point", "upright", "level", "far away"]
    kind = draw(st.sampled_from(kinds))
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
        and float(np.hypot(*plane.slope)) <= slope_max + 1e-9
        and 0 <= plane.support <= len(cloud)
        and bool(np.all(np.isfinite(plane.height_at(cloud))))
    )


def levels(*heights_m: float) -> np.ndarray:
    """A cloud (n, 3) of level surfaces, one above the other."""
    generator = np.random.default_rng(0)
    cloud = generator.uniform(-4, 4, (600 * len(heights_m), 3))
    cloud[:, 2] = np.tile(heights_m, 600) + generator.normal(0, 0.01, len(cloud))
    return cloud.astype(np.float32)


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
            if np.count_nonzero(np.abs(cloud[:, 2]) <= FLOOR_SEARCH_M) < 20:
                assert (floor.height_m, floor.slope.tolist(), floor.support) == (0.0, [0.0, 0.0], 0)
            found[floor.support > 0] += 1

        check()
        assert min(found[False], found[True]) > 10, found  # both occurred

    def test_any_cloud_has_sound_ceilings_or_none(self) -> None:
        found = Counter[int]()

        @seeded
        @given(cloud=WILD, seed=SEEDS)
        @example(np.zeros((0, 3), np.float32), 0)
        @example(np.full((1000, 3), 2.5, np.float32), 0)
        @example(levels(2.5), 0)
        @example(levels(2.5, 3.2), 0)
        @example(levels(2.5, 3.0, 3.6), 0)
        def check(cloud: np.ndarray, seed: int) -> None:
            floor = Floor(0.0, np.zeros(2), 0)
            ceilings = find_ceilings(cloud, cloud[:, 2], floor, REARRANGEMENT, seed)
            assert len(ceilings) <= 3
            assert all(is_sound(ceiling, 0.03, cloud) for ceiling in ceilings)
            high = np.count_nonzero(cloud[:, 2] > REARRANGEMENT.ceiling_height_min_m)
            if high < max(30, int(0.02 * len(cloud))):
                assert ceilings == ()
            found[len(ceilings)] += 1

        check()
        assert min(found[0], found[1], found[2] + found[3]) > 1, found  # none, one and several


ROOM = synthetic.scan(firings=700)


@st.composite
def timed(draw: st.DrawFn, cloud: np.ndarray, ring: np.ndarray, ring_count: int) -> Scan:
    """A scan without times, with times in order, or in any order."""
    time_ns = np.linspace(0, 1e8, len(cloud)).astype(np.int64)
    shuffled = np.random.default_rng(draw(st.integers(0, 99))).permutation(time_ns)
    times = draw(st.sampled_from([None, time_ns, shuffled]))
    return replace(synthetic.scan_of(cloud, ring, ring_count), time_ns=times)


@st.composite
def scans_of_junk(draw: st.DrawFn) -> Scan:
    cloud, ring_count = draw(WILD), draw(st.sampled_from([1, 2, 16, 128]))
    ring = np.random.default_rng(draw(st.integers(0, 99))).integers(0, ring_count, len(cloud))
    return draw(timed(cloud, ring, ring_count))


@st.composite
def scans_of_a_harmed_room(draw: st.DrawFn) -> Scan:
    """A room thinned, doubled, shuffled, shrunk, blurred, mixed with junk or with wrong rings."""
    generator = np.random.default_rng(draw(SEEDS))
    share = draw(st.sampled_from([1.0, 0.7, 0.2, 0.01]))
    kept = np.flatnonzero(generator.random(len(ROOM)) < share)
    if draw(st.booleans()):
        kept = generator.choice(kept, len(kept))  # some twice, some not, in any order
    room = ROOM.points_sensor[kept] * draw(st.sampled_from([1.0, 1.1, 0.3, 4.0]))
    room = room + generator.normal(0, draw(st.sampled_from([0.0, 0.02, 0.3])), room.shape)
    junk = draw(WILD)
    ring = np.concatenate([ROOM.ring[kept], generator.integers(0, ROOM.ring_count, len(junk))])
    if draw(st.sampled_from([False, False, True])):
        ring = generator.permutation(ring)
    return draw(timed(np.concatenate([room, junk]), ring, ROOM.ring_count))


@pytest.mark.parametrize(
    ("scans", "expected"),
    [
        (scans_of_junk(), {Label.CLUTTER}),
        (
            scans_of_a_harmed_room(),
            {Label.CLUTTER, Label.FLOOR, Label.CEILING, Label.WALL, Label.DOOR},
        ),
    ],
    ids=["junk", "harmed room"],
)
def test_every_return_of_any_scan_has_a_label(
    scans: st.SearchStrategy[Scan], expected: set[Label]
) -> None:
    met = Counter[int]()

    @seeded
    @given(
        scan=scans,
        tilt_deg=st.sampled_from([(0.0, 0.0), (0.0, 0.0), (1.0, -2.0), (-30.0, 20.0)]),
        yaw_rad=reals(-3.0, 3.0),
        seed=SEEDS,
    )
    def check(scan: Scan, tilt_deg: tuple[float, float], yaw_rad: float, seed: int) -> None:
        tilt = Rotation.from_euler("ZYX", [np.degrees(yaw_rad), *tilt_deg], degrees=True)
        T = np.stack([transforms.make_transform(tilt, [x, 0.0, 0.0]) for x in (0.0, 0.05)])
        trajectory = Trajectory(np.array([0, 100_000_000]), T)
        placed = place_scan(scan, trajectory, synthetic.T_BASE_SENSOR)
        found = label_scan(scan, placed, METHOD, seed)
        assert found.label.shape == found.plane.shape == found.height_m.shape == (len(scan),)
        assert found.label.dtype == np.uint8
        assert np.all(np.isfinite(found.height_m))
        # Walls and doors, and no other returns, are on a plane of this scan.
        on_plane = np.isin(found.label, [Label.WALL, Label.DOOR])
        np.testing.assert_array_equal(found.plane >= 0, on_plane)
        assert np.all(found.plane < len(found.planes))
        assert np.all(np.isfinite(found.planes.ends))
        assert found.ceilings or not np.any(found.label == Label.CEILING)
        np.testing.assert_array_equal(label_scan(scan, placed, METHOD, seed).label, found.label)
        met.update(set(found.label.tolist()))

    check()
    assert expected <= set(met) <= set(Label), met


@pytest.mark.parametrize("far_m", [1e5, 1e19, 3e38])
def test_one_damaged_return_changes_nothing_else(far_m: float) -> None:
    whole = synthetic.scan(firings=1000)
    points = whole.points_sensor.copy()
    points[777] = (-far_m, 0.3, 0.3)
    labels = []
    for scan in (whole, replace(whole, points_sensor=points)):
        placed = place_scan(scan, synthetic.trajectory(3), synthetic.T_BASE_SENSOR)
        labels.append(label_scan(scan, placed, METHOD, 0).label)
    assert np.mean(labels[0] != labels[1]) < 0.001
    assert labels[1][777] == Label.CLUTTER
