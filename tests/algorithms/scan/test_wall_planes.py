"""Algorithm 1 and its repairs on candidates whose walls are known."""

from collections.abc import Sequence

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.scan.point_lines import SAMPLES
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import VerticalStructures
from ffmap.algorithms.scan.wall_candidates import _UPPER_PART_M, Reach, WallPlanesSettings
from ffmap.algorithms.scan.wall_planes import Growth, Membership, WallPlanes, grow_wall_planes

SETTINGS = WallPlanesSettings()
CEILING_M = 2.8
CEILING = HorizontalPlane(CEILING_M, np.zeros(2), 1000)
ORIGIN = np.array([0.0, 0.0, 1.0])
SPAN_M = (0.1, 2.75)
SEEDED, JOINED, BROKE, REFUSED = Growth.SEEDED, Growth.JOINED, Growth.BROKE, Growth.REFUSED


def wall(start: Sequence[float], end: Sequence[float], count: int, lean_m: float = 0.1) -> np.ndarray:
    """Candidates (count, 2, 2) on a wall: x and y of their lower and upper ends, bent along the wall as lines are."""
    lower = np.linspace(start, end, count)
    along = (lower[-1] - lower[0]) / np.linalg.norm(lower[-1] - lower[0])
    return np.stack([lower, lower + lean_m * along], axis=1)


def samples_of(candidates: np.ndarray, spans: np.ndarray, noise_m: float = 0.0, seed: int = 0) -> np.ndarray:
    """Points (C, 200, 3) of candidates from below upwards."""
    part = np.linspace(0, 1, SAMPLES)[None, :, None]
    xy = candidates[:, None, 0] * (1 - part) + candidates[:, None, 1] * part
    xy = xy + np.random.default_rng(seed).normal(0, noise_m, xy.shape)
    return np.concatenate([xy, spans[:, None, :1] * (1 - part) + spans[:, None, 1:] * part], axis=2)


def grow(
    candidates: np.ndarray,
    line: Sequence[int] | None = None,
    *,
    spans: Sequence[tuple[float, float]] | None = None,
    noise_m: float = 0.0,
    seed: int = 0,
    ceilings: tuple[HorizontalPlane, ...] = (CEILING,),
    T: np.ndarray | None = None,
    rows: Sequence[int] | None = None,
    settings: WallPlanesSettings = SETTINGS,
) -> WallPlanes:
    """Planes from candidates, each the only structure of its line; without `line` on one side, in order.

    T moves everything, the sensor too; `rows` is the order in which the lines come.
    """
    count = len(candidates)
    own_line = np.arange(count) * 2 if line is None else np.asarray(line)
    line_count = int(own_line.max(initial=-1)) + 1
    span = np.array(spans if spans is not None else [SPAN_M] * count, float).reshape(-1, 2)
    points = samples_of(candidates, span, noise_m, seed).reshape(-1, 3)
    height_m = points[:, 2].astype(np.float32)
    origin = ORIGIN
    if T is not None:
        points, origin = transforms.apply(T, points), transforms.apply(T, ORIGIN[None])[0]
    order = np.argsort(own_line) if rows is None else np.asarray(rows)
    samples = np.full((line_count, SAMPLES), -1, np.int32)
    samples[own_line] = np.arange(count * SAMPLES).reshape(-1, SAMPLES)
    upmost = np.full(line_count, -1, np.int32)
    upmost[own_line[order]] = np.arange(count)
    absent = np.full((line_count, SAMPLES), np.nan, np.float32)
    structures = VerticalStructures(
        difference=absent,
        slope=absent,
        upright=np.zeros((line_count, SAMPLES), bool),
        line=own_line[order].astype(np.int32),
        first=np.zeros(count, np.int32),
        last=np.full(count, SAMPLES - 1, np.int32),
        bottom_m=span[order, 0].astype(np.float32),
        top_m=span[order, 1].astype(np.float32),
        upmost=upmost,
        bottommost=upmost,
    )
    return grow_wall_planes(
        Returns(points.astype(np.float32), height_m, origin),
        samples,
        structures,
        ceilings,
        np.ones(line_count, bool),
        settings,
    )


def literal(candidates: np.ndarray, noise_m: float = 0.0, seed: int = 0) -> list[list[int]]:
    """Algorithm 1 as printed, on the candidates' upper parts; Ω and Θ by singular values."""
    points = samples_of(candidates, np.array([SPAN_M] * len(candidates)), noise_m, seed)
    upper = [p[p[:, 2] > p[-1, 2] - _UPPER_PART_M, :2] for p in points]

    def omega(members: list[int]) -> tuple[np.ndarray, np.ndarray]:
        xy = np.concatenate([upper[m] for m in members])
        return np.linalg.svd(xy - xy.mean(axis=0), full_matrices=False)[2][1], xy.mean(axis=0)

    planes: list[list[int]] = []
    current: list[int] = []
    parameters: tuple[np.ndarray, np.ndarray] | None = None
    for i in range(len(candidates)):
        if not current:
            current = [i]
        elif parameters is None:
            parameters = omega(current)  # and candidate i is dropped
        elif np.sqrt(np.mean(((upper[i] - parameters[1]) @ parameters[0]) ** 2)) < SETTINGS.similarity_m:
            current.append(i)
            parameters = omega(current)
        else:
            planes.append(current)  # and candidate i is dropped
            current, parameters = [], None
    return planes  # and the current plane is dropped


CORNER = np.concatenate([wall([-0.4, 2.0], [1.0, 2.0], 8), wall([1.4, 1.9], [1.4, 0.5], 8)])
STRAIGHT = wall([-1.0, 2.0], [1.2, 2.0], 12)


def test_candidates_in_order_grow_one_plane() -> None:
    found = grow(STRAIGHT)
    assert len(found) == 1
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11
    assert found.candidate_plane.tolist() == [0] * 12
    # The seed had nothing to be compared with; all others stand on the plane.
    assert np.isnan(found.candidate_distance_m[0])
    np.testing.assert_allclose(found.candidate_distance_m[1:], 0, atol=1e-3)
    # y = 2, the normal towards the sensor; the ends are those of the outermost candidates' upper parts.
    np.testing.assert_allclose(found.normal, [[0, -1]], atol=1e-5)
    np.testing.assert_allclose(found.offset_m, [-2], atol=1e-5)
    upper = 0.1 * _UPPER_PART_M / (SPAN_M[1] - SPAN_M[0])
    np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [-1 + 0.1 - upper, 1.3], atol=0.002)
    np.testing.assert_allclose(found.ends[0, :, 1], 2, atol=1e-5)
    np.testing.assert_allclose([found.bottom_m[0], found.top_m[0]], SPAN_M, atol=1e-6)
    assert found.line_count.tolist() == [12]
    assert found.rms_m[0] < 1e-3
    assert found.moments[0, 0] == found.point_count[0] > 12 * 10


def test_the_walk_is_emitter_by_emitter_whatever_order_the_structures_come_in() -> None:
    in_order = grow(CORNER)
    rows = np.random.default_rng(2).permutation(16)
    shuffled = grow(CORNER, rows=rows)
    assert shuffled.candidate_line.tolist() == in_order.candidate_line.tolist() == list(range(0, 32, 2))
    assert shuffled.candidate_structure.tolist() == np.argsort(rows).tolist()
    assert shuffled.candidate_growth.tolist() == in_order.candidate_growth.tolist()
    assert shuffled.candidate_plane.tolist() == in_order.candidate_plane.tolist()


def test_the_two_sides_of_the_emitters_are_walked_one_after_the_other() -> None:
    left, right = wall([-0.6, 2.0], [0.8, 2.0], 8), wall([-0.6, -1.5], [0.8, -1.5], 8)
    found = grow(np.stack([left, right], axis=1).reshape(-1, 2, 2), list(range(16)))
    assert found.candidate_line.tolist() == [*range(0, 16, 2), *range(1, 16, 2)]
    # The second side starts afresh, compared with nothing; nothing was broken.
    assert found.candidate_growth.tolist() == 2 * ([SEEDED] + [JOINED] * 7)
    assert np.flatnonzero(np.isnan(found.candidate_distance_m)).tolist() == [0, 8]
    assert found.candidate_plane.tolist() == [0] * 8 + [1] * 8
    np.testing.assert_allclose(found.normal, [[0, -1], [0, 1]], atol=1e-5)
    np.testing.assert_allclose(found.offset_m, [-2, -1.5], atol=1e-5)


@pytest.mark.parametrize("off_m", [0.02, 0.045, -0.045, 0.055, -0.055, 0.3])
def test_a_candidate_off_by_more_than_the_similarity_breaks_the_plane(off_m: float) -> None:
    candidates = STRAIGHT.copy()
    candidates[6, :, 1] += off_m
    found = grow(candidates)
    # Θ is its distance to the plane of those before it.
    assert found.candidate_distance_m[6] == pytest.approx(abs(off_m), abs=1e-4)
    assert found.candidate_growth[:6].tolist() == [SEEDED] + [JOINED] * 5
    assert found.candidate_growth[6] == (JOINED if abs(off_m) < SETTINGS.similarity_m else BROKE)
    wider = grow(candidates, settings=SETTINGS.model_copy(update={"similarity_m": 2 * abs(off_m)}))
    assert wider.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11


def test_a_candidate_too_far_along_the_wall_breaks_the_plane_though_it_is_coplanar() -> None:
    apart = np.concatenate([wall([-2.4, 2.0], [-1.2, 2.0], 6), wall([1.2, 2.0], [2.4, 2.0], 6)])
    found = grow(apart)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 5 + [BROKE] + [JOINED] * 5
    assert found.candidate_distance_m[6] < 0.01
    # What lies between is wider than a merge bridges; a wider bridge makes them one.
    assert found.candidate_plane.tolist() == [0] * 6 + [1] * 6
    bridged = grow(apart, settings=SETTINGS.model_copy(update={"merge_gap_m": 2.5}))
    assert bridged.candidate_growth.tolist() == found.candidate_growth.tolist()
    assert bridged.candidate_plane.tolist() == [0] * 12


def test_a_corner_gives_two_planes() -> None:
    found = grow(CORNER)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 7 + [BROKE] + [JOINED] * 7
    assert found.candidate_plane.tolist() == [0] * 8 + [1] * 8
    np.testing.assert_allclose(found.normal, [[0, -1], [-1, 0]], atol=1e-4)
    np.testing.assert_allclose(found.offset_m, [-2, -1.4], atol=1e-4)
    assert found.line_count.tolist() == [8, 8]


def test_as_printed_a_corner_loses_three_kinds_of_lines_and_the_repair_none() -> None:
    # The line after the seed (1), the line that breaks the plane (8), and all of the last plane.
    assert literal(CORNER) == [[0, 2, 3, 4, 5, 6, 7]]
    found = grow(CORNER)
    assert [np.flatnonzero(found.candidate_plane == k).tolist() for k in range(len(found))] == [
        list(range(8)),
        list(range(8, 16)),
    ]


def test_as_printed_one_wall_is_no_wall() -> None:
    assert literal(STRAIGHT) == []
    assert grow(STRAIGHT).line_count.tolist() == [12]


def test_a_seed_alone_has_no_direction() -> None:
    # Printed, the third candidate is compared with Ω of the seed alone; under noise its direction is anything, and a
    # wall is torn. The last candidate stands off and closes the wall's plane, so that it is not lost for its place.
    candidates, noise_m = np.concatenate([wall([-1.5, 2.0], [2.3, 2.0], 20), wall([2.5, 1.0], [2.5, 0.9], 2)[:1]]), 0.01
    assert literal(candidates) == [[0, *range(2, 20)]]
    kept = []
    for seed in range(8):
        kept.append(max([len(members) for members in literal(candidates, noise_m, seed)], default=0))
        found = grow(candidates, noise_m=noise_m, seed=seed)
        assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 19 + [BROKE]
        assert found.candidate_plane.tolist() == [0] * 20 + [-1]
        assert abs(np.degrees(np.arctan2(found.normal[0, 0], -found.normal[0, 1]))) < 0.3
        assert found.offset_m[0] == pytest.approx(-2, abs=0.003)
        assert found.rms_m[0] == pytest.approx(noise_m, rel=0.1)
    assert max(kept) < 19, kept


@pytest.mark.parametrize(("apart_m", "growth"), [(0.08, JOINED), (0.3, BROKE)])
def test_the_second_candidate_is_compared_with_the_plane_of_both(apart_m: float, growth: Growth) -> None:
    # Two lines that bend far along two parallel walls: each is flat in itself, but they have no plane in common.
    pair = wall([0.0, 2.0], [0.2, 2.0], 2, lean_m=3.0)
    pair[1, :, 1] += apart_m
    found = grow(pair)
    assert found.candidate_growth.tolist() == [SEEDED, growth]
    points = samples_of(pair, np.array([SPAN_M] * 2))
    xy = points[points[:, :, 2] > SPAN_M[1] - _UPPER_PART_M][:, :2]
    rms_m = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xy))
    assert found.candidate_distance_m[1] == pytest.approx(rms_m, rel=0.01)


def test_planes_that_one_odd_line_has_cut_are_joined_again() -> None:
    candidates = STRAIGHT.copy()
    candidates[5, :, 1] -= 0.12
    found = grow(candidates)
    # It seeds a plane, which its neighbour on the wall joins, for any two lines have a plane; the next breaks it.
    assert found.candidate_growth[:8].tolist() == [SEEDED] + [JOINED] * 4 + [BROKE, JOINED, BROKE]
    assert len(found) == 1
    # In the end the neighbour is where it is nearest, and the odd line, near to no plane, is in none.
    assert found.candidate_plane.tolist() == [0] * 5 + [-1] + [0] * 6
    np.testing.assert_allclose(found.offset_m, [-2], atol=1e-4)
    assert found.line_count.tolist() == [11]


def test_what_ends_below_the_ceiling_is_refused_and_breaks_nothing() -> None:
    candidates = STRAIGHT.copy()
    candidates[4, :, 1] -= 0.4
    spans = [SPAN_M] * 12
    spans[4] = (0.1, CEILING_M - SETTINGS.reach_m - 0.1)
    found = grow(candidates, spans=spans)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 3 + [REFUSED] + [JOINED] * 7
    assert np.isnan(found.candidate_distance_m[4])
    assert found.candidate_plane.tolist() == [0] * 4 + [-1] + [0] * 7
    # As high as the others it would have broken the plane.
    assert BROKE in grow(candidates).candidate_growth


@pytest.mark.parametrize(("top_m", "growth"), [(2.0, REFUSED), (2.2, JOINED)])
def test_without_a_ceiling_a_height_decides(top_m: float, growth: Growth) -> None:
    spans = [(0.1, 2.5)] * 12
    spans[3] = (0.1, top_m)
    found = grow(STRAIGHT, spans=spans, ceilings=())
    assert found.candidate_growth[3] == growth
    assert np.delete(found.candidate_growth, 3).tolist() == [SEEDED] + [JOINED] * 10


def test_a_duct_below_the_ceiling_is_no_wall() -> None:
    duct = grow(STRAIGHT, spans=[(SETTINGS.bottom_max_m + 0.1, 2.75)] * 12)
    assert duct.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11
    assert len(duct) == 0
    assert duct.candidate_plane.tolist() == [-1] * 12
    # One line that comes down makes it a wall, as beside a door; planes after a duct are numbered without it.
    spans = [(SETTINGS.bottom_max_m + 0.1, 2.75)] * 12
    spans[7] = SPAN_M
    assert len(grow(STRAIGHT, spans=spans)) == 1
    numbered = grow(CORNER, spans=[(SETTINGS.bottom_max_m + 0.1, 2.75)] * 8 + [SPAN_M] * 8)
    assert numbered.candidate_plane.tolist() == [-1] * 8 + [0] * 8


def test_the_evidence_tells_why_each_candidate_is_in_no_plane() -> None:
    # One too low, one that stands 30 cm before the wall alone; two of their own far away, two that make no length.
    candidates = np.concatenate([STRAIGHT, [STRAIGHT[5] - [0, 0.3]], wall([4.0, -3.0], [4.2, -3.0], 2)])
    spans = [SPAN_M] * len(candidates)
    spans[2] = (0.1, 2.0)
    found = grow(candidates, spans=spans)
    reasons = found.candidate_membership
    assert reasons[2] == Membership.REFUSED
    assert found.candidate_reach[2] == Reach.LOW
    assert found.candidate_below_ceiling_m[2] == pytest.approx(CEILING_M - 2.0, abs=1e-5)
    assert found.candidate_grown[2] == -1
    assert np.isnan(found.candidate_nearest_m[2])
    assert reasons[12] == Membership.ALONE
    assert found.candidate_nearest_m[12] == pytest.approx(0.3, abs=1e-3)
    assert reasons[13:].tolist() == [Membership.ALONE] * 2
    assert np.isnan(found.candidate_nearest_m[13:]).all()
    assert found.candidate_grown[13] == found.candidate_grown[14] == found.candidate_grown[12] + 1
    others = np.delete(np.arange(12), 2)
    assert np.all(reasons[others] == Membership.IN_PLANE)
    assert np.all(found.candidate_reach[others] == Reach.CEILING)
    np.testing.assert_allclose(found.candidate_nearest_m[others], 0, atol=1e-3)
    assert np.array_equal(reasons == Membership.IN_PLANE, found.candidate_plane >= 0)
    # The step from one line to the next is 12 cm, and twice that past the one that was refused.
    step_m = float(STRAIGHT[1, 0, 0] - STRAIGHT[0, 0, 0])
    np.testing.assert_allclose(found.candidate_gap_m[[1, 3]], [step_m, 2 * step_m], atol=1e-3)
    assert np.all(found.candidate_gap_m[others[1:]] < found.candidate_gap_max_m[others[1:]])


def test_the_evidence_tells_by_what_a_plane_was_dropped() -> None:
    duct = grow(STRAIGHT, spans=[(SETTINGS.bottom_max_m + 0.1, 2.75)] * 12)
    assert duct.candidate_membership.tolist() == [Membership.DUCT] * 12
    short = grow(wall([0.0, 2.0], [0.06, 2.0], 4, lean_m=0.0))
    assert short.candidate_membership.tolist() == [Membership.SHORT] * 4
    high = grow(STRAIGHT, spans=[(0.1, CEILING_M + 0.9)] * 12)
    assert set(high.candidate_reach.tolist()) == {Reach.ABOVE_CEILINGS}
    assert set(grow(STRAIGHT, ceilings=()).candidate_reach.tolist()) == {Reach.HEIGHT}


def grow_profile(corners: list[tuple[float, float]], upright: list[int]) -> WallPlanes:
    """Planes from twelve lines of one profile: corners (y, z) from below upwards, and which of its segments are structures."""
    y, z = np.array(corners).T
    place = np.linspace(0, len(y) - 1, SAMPLES)
    segment = np.minimum(place.astype(int), len(y) - 2)
    line = np.column_stack([np.interp(place, np.arange(len(y)), own) for own in (y, z)])
    points = np.concatenate([np.column_stack([np.full(SAMPLES, x), line]) for x in np.linspace(-0.8, 0.8, 12)])
    count, lines = len(upright), np.arange(12, dtype=np.int32)
    absent = np.full((24, SAMPLES), np.nan, np.float32)
    structures = VerticalStructures(
        difference=absent,
        slope=absent,
        upright=np.zeros((24, SAMPLES), bool),
        line=np.repeat(2 * lines, count),
        first=np.tile([np.flatnonzero(segment == s)[0] for s in upright], 12).astype(np.int32),
        last=np.tile([np.flatnonzero(segment == s)[-1] for s in upright], 12).astype(np.int32),
        bottom_m=np.tile(z[upright], 12).astype(np.float32),
        top_m=np.tile(z[np.array(upright) + 1], 12).astype(np.float32),
        upmost=np.repeat(count * lines + count - 1, 2),
        bottommost=np.repeat(count * lines, 2),
    )
    samples = np.repeat(np.arange(12 * SAMPLES, dtype=np.int32).reshape(12, SAMPLES), 2, axis=0)
    returns = Returns(points.astype(np.float32), points[:, 2].astype(np.float32), ORIGIN)
    return grow_wall_planes(returns, samples, structures, (CEILING,), np.ones(24, bool), SETTINGS)


@pytest.mark.parametrize(
    ("above", "is_wall"),
    [
        ([(1.6, 2.2), (1.6, 2.75)], True),  # a soffit
        ([(1.8, 2.4), (1.4, 2.6), (1.0, 2.7)], True),  # a vault
        ([(1.9, 2.2), (1.9, 2.75)], False),  # a lintel: it is a leaf in its opening
        ([(2.0, 2.2), (2.5, 2.3), (2.5, 2.75)], False),  # the wall behind a cabinet
        ([(1.5, 1.9), (1.5, 2.75)], False),  # what hangs before it, without touching it
        ([(1.6, 2.2), (1.6, 2.3)], False),  # a canopy that ends below the ceiling
    ],
)
def test_a_wall_under_what_closes_up_to_the_ceiling_need_not_reach_it(
    above: list[tuple[float, float]], is_wall: bool
) -> None:
    found = grow_profile([(2.0, 0.1), (2.0, 2.2), *above], [0])
    assert set(found.candidate_reach.tolist()) == {Reach.OVERHUNG if is_wall else Reach.LOW}
    assert len(found) == is_wall
    if is_wall:
        np.testing.assert_allclose(found.offset_m, [-2.0], atol=1e-3)


@pytest.mark.parametrize(
    ("below", "is_wall"),
    [
        ([(2.0, 0.1), (2.0, 2.0), (1.4, 1.9), (1.4, 2.3)], True),  # a valance hangs before it
        ([(2.0, 0.1), (2.0, 2.0)], False),  # a cabinet whose front is flush with what hangs over it
        ([(1.7, 0.1), (1.7, 2.0), (1.4, 1.9), (1.4, 2.3)], False),  # what stands below is not in line with it
    ],
)
def test_a_wall_goes_on_below_what_hangs_before_it(below: list[tuple[float, float]], is_wall: bool) -> None:
    """Of the wall above it no more is seen than of a duct's front."""
    found = grow_profile([*below, (2.0, 2.35), (2.0, 2.75)], [0, len(below)])
    assert len(found) == is_wall
    assert set(found.candidate_membership.tolist()) == {Membership.IN_PLANE if is_wall else Membership.DUCT}


def test_an_empty_scan_has_no_planes() -> None:
    found = grow(np.zeros((0, 2, 2)))
    assert len(found) == 0
    assert found.normal.shape == (0, 2)
    assert found.ends.shape == (0, 2, 2)
    assert found.moments.shape == (0, 6)
    for name in ("structure", "line", "growth", "plane", "distance_m"):
        assert getattr(found, f"candidate_{name}").shape == (0,)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_candidates_seed_a_plane_that_is_not_kept(count: int) -> None:
    found = grow(STRAIGHT[:count])
    assert len(found) == 0
    assert found.candidate_growth.tolist() == [SEEDED, JOINED][:count]
    assert found.candidate_plane.tolist() == [-1] * count
    assert np.isnan(found.candidate_distance_m[0])
    assert len(grow(STRAIGHT[: SETTINGS.lines_min])) == 1


@pytest.mark.parametrize("yaw_rad", [0.3, np.pi / 2, 2.5, -2.9])
def test_the_partition_holds_under_motion_about_the_vertical(yaw_rad: float) -> None:
    # A corner with an odd line on one side, a wall on the other, under noise.
    corner = CORNER.copy()
    corner[3, :, 1] -= 0.2
    scene = np.concatenate([corner, wall([-0.6, -1.5], [0.9, -1.2], 9)])
    line = [*range(0, 32, 2), *range(1, 19, 2)]
    still = grow(scene, line, noise_m=0.008)
    assert len(still) == 3
    assert set(still.candidate_plane.tolist()) == {-1, 0, 1, 2}
    assert {SEEDED, JOINED, BROKE} == set(still.candidate_growth.tolist())
    T = transforms.from_yaw(yaw_rad, [30.0, -12.0, 0.0])
    moved = grow(scene, line, noise_m=0.008, T=T)
    assert moved.candidate_plane.tolist() == still.candidate_plane.tolist()
    assert moved.candidate_growth.tolist() == still.candidate_growth.tolist()
    np.testing.assert_allclose(moved.candidate_distance_m, still.candidate_distance_m, atol=1e-4)
    np.testing.assert_allclose(moved.rms_m, still.rms_m, atol=1e-4)
    normal = still.normal @ T[:2, :2].T
    np.testing.assert_allclose(moved.normal, normal, atol=1e-4)
    np.testing.assert_allclose(moved.offset_m, still.offset_m + normal @ T[:2, 3], atol=3e-3)
    np.testing.assert_allclose(moved.ends, still.ends @ T[:2, :2].T + T[:2, 3], atol=1e-3)
