"""Algorithm 1 and its repairs on candidates whose walls are known."""

from collections.abc import Sequence

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.scan.point_lines import SAMPLES
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import VerticalStructures
from ffmap.algorithms.scan.wall_candidates import Reach, WallPlanesSettings
from ffmap.algorithms.scan.wall_planes import (
    BOTTOM_MAX_M,
    Growth,
    WallPlanes,
    grow_wall_planes,
)

SETTINGS = WallPlanesSettings()
UPPER_PART_M = 0.4
CEILING_M = 2.8
CEILING = HorizontalPlane(CEILING_M, np.zeros(2), 1000)
ORIGIN = np.array([0.0, 0.0, 1.0])
SPAN_M = (0.1, 2.75)
DUCT_M = (BOTTOM_MAX_M + 0.1, 2.75)
SEEDED, JOINED, BROKE, REFUSED = Growth.SEEDED, Growth.JOINED, Growth.BROKE, Growth.REFUSED


def wall(
    start: Sequence[float], end: Sequence[float], count: int, lean_m: float = 0.1
) -> np.ndarray:
    """Candidates (count, 2, 2): x and y of their lower and upper ends, bent along the wall."""
    lower = np.linspace(start, end, count)
    along = (lower[-1] - lower[0]) / np.linalg.norm(lower[-1] - lower[0])
    return np.stack([lower, lower + lean_m * along], axis=1)


CORNER = np.concatenate([wall([-0.4, 2.0], [1.0, 2.0], 8), wall([1.4, 1.9], [1.4, 0.5], 8)])
STRAIGHT = wall([-1.0, 2.0], [1.2, 2.0], 12)


def samples_of(candidates: np.ndarray, spans: np.ndarray, noise_m: float = 0.0) -> np.ndarray:
    """Points (C, 200, 3) of candidates from below upwards."""
    part = np.linspace(0, 1, SAMPLES)[None, :, None]
    xy = candidates[:, None, 0] * (1 - part) + candidates[:, None, 1] * part
    xy = xy + np.random.default_rng(0).normal(0, noise_m, xy.shape)
    z = spans[:, None, :1] * (1 - part) + spans[:, None, 1:] * part
    return np.concatenate([xy, z], axis=2)


def structures_of(
    lines: int, line: np.ndarray, first: np.ndarray, last: np.ndarray, heights_m: np.ndarray
) -> VerticalStructures:
    """Structures (S,) line by line from below upwards; heights_m: (S, 2) of their ends."""
    absent = np.full((lines, SAMPLES), np.nan, np.float32)
    upmost, bottommost = np.full((2, lines), -1, np.int32)
    upmost[line] = np.arange(len(line))
    bottommost[line[::-1]] = np.arange(len(line))[::-1]
    bottom_m, top_m = heights_m.astype(np.float32).T
    extent = (run.astype(np.int32) for run in (line, first, last))
    is_upright = np.zeros(absent.shape, bool)
    return VerticalStructures(
        absent, absent, is_upright, *extent, bottom_m, top_m, upmost, bottommost, upmost + 1
    )


def grow(
    candidates: np.ndarray,
    line: Sequence[int] | None = None,
    *,
    spans: Sequence[tuple[float, float]] | None = None,
    noise_m: float = 0.0,
    ceilings: tuple[HorizontalPlane, ...] = (CEILING,),
    T: np.ndarray | None = None,
    rows: Sequence[int] | None = None,
    settings: WallPlanesSettings = SETTINGS,
) -> WallPlanes:
    """Planes from candidates, each the only structure of its line; by default on one side.

    T moves everything, the sensor too; `rows` is the order in which the lines come.
    """
    count = len(candidates)
    own_line = np.arange(count) * 2 if line is None else np.asarray(line)
    lines = int(own_line.max(initial=-1)) + 1
    span = np.array(spans if spans is not None else [SPAN_M] * count, float).reshape(-1, 2)
    points = samples_of(candidates, span, noise_m).reshape(-1, 3)
    returns = Returns(points.astype(np.float32), points[:, 2].astype(np.float32), ORIGIN)
    if T is not None:
        moved = transforms.apply(T, np.vstack([points, ORIGIN]))
        returns = Returns(moved[:-1].astype(np.float32), returns.height_m, moved[-1])
    order = np.argsort(own_line) if rows is None else np.asarray(rows)
    samples = np.full((lines, SAMPLES), -1, np.int32)
    samples[own_line] = np.arange(count * SAMPLES).reshape(-1, SAMPLES)
    first, last = np.zeros(count, int), np.full(count, SAMPLES - 1)
    structures = structures_of(lines, own_line[order], first, last, span[order])
    meets_ceiling = np.ones(lines, bool)
    return grow_wall_planes(returns, samples, structures, ceilings, meets_ceiling, settings)


def test_candidates_in_order_grow_one_plane() -> None:
    found = grow(STRAIGHT)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11
    assert found.candidate_plane.tolist() == [0] * 12
    assert np.isnan(found.candidate_distance_m[0])  # the seed was compared with nothing
    np.testing.assert_allclose(found.candidate_distance_m[1:], 0, atol=1e-3)
    # y = 2, the normal towards the sensor; the ends are those of the outermost upper parts.
    np.testing.assert_allclose(found.normal, [[0, -1]], atol=1e-5)
    np.testing.assert_allclose(found.offset_m, [-2], atol=1e-5)
    assert found.line_count.tolist() == [12]
    assert found.moments[0, 0] == found.point_count[0] > 12 * 10
    np.testing.assert_allclose([found.bottom_m[0], found.top_m[0]], SPAN_M, atol=1e-5)
    ends = found.ends[0][np.argsort(found.ends[0, :, 0])]
    np.testing.assert_allclose(ends, [[-0.915, 2.0], [1.3, 2.0]], atol=0.005)


def test_the_walk_is_emitter_by_emitter_whatever_the_order_of_structures() -> None:
    in_order = grow(CORNER)
    rows = np.random.default_rng(2).permutation(16)
    shuffled = grow(CORNER, rows=rows)
    assert shuffled.candidates.line.tolist() == list(range(0, 32, 2))
    assert shuffled.candidates.structure.tolist() == np.argsort(rows).tolist()
    assert in_order.candidates.line.tolist() == shuffled.candidates.line.tolist()
    for name in ("growth", "plane"):
        expected = getattr(in_order, f"candidate_{name}").tolist()
        assert getattr(shuffled, f"candidate_{name}").tolist() == expected


def test_the_two_sides_of_the_emitters_are_walked_one_after_the_other() -> None:
    left, right = wall([-0.6, 2.0], [0.8, 2.0], 8), wall([-0.6, -1.5], [0.8, -1.5], 8)
    found = grow(np.stack([left, right], axis=1).reshape(-1, 2, 2), list(range(16)))
    assert found.candidates.line.tolist() == [*range(0, 16, 2), *range(1, 16, 2)]
    # The second side seeds its own plane, compared with nothing; nothing was broken.
    assert found.candidate_growth.tolist() == 2 * ([SEEDED] + [JOINED] * 7)
    assert np.flatnonzero(np.isnan(found.candidate_distance_m)).tolist() == [0, 8]
    assert found.candidate_plane.tolist() == [0] * 8 + [1] * 8
    np.testing.assert_allclose(found.normal, [[0, -1], [0, 1]], atol=1e-5)
    np.testing.assert_allclose(found.offset_m, [-2, -1.5], atol=1e-5)


@pytest.mark.parametrize("off_m", [0.02, -0.045, 0.055, -0.055, 0.3])
def test_a_candidate_off_by_more_than_the_similarity_breaks_the_plane(off_m: float) -> None:
    candidates = STRAIGHT.copy()
    candidates[6, :, 1] += off_m
    found = grow(candidates)
    # Θ is its distance to the plane of those before it.
    assert found.candidate_distance_m[6] == pytest.approx(abs(off_m), abs=1e-4)
    assert found.candidate_growth[:6].tolist() == [SEEDED] + [JOINED] * 5
    assert found.candidate_growth[6] == (JOINED if abs(off_m) < SETTINGS.similarity_m else BROKE)
    similarity = {"similarity_m": 2 * abs(off_m)}
    wider = grow(candidates, settings=SETTINGS.model_copy(update=similarity))
    assert wider.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11


def test_a_coplanar_candidate_too_far_along_the_wall_breaks_the_plane() -> None:
    apart = np.concatenate([wall([-2.4, 2.0], [-1.2, 2.0], 6), wall([1.2, 2.0], [2.4, 2.0], 6)])
    found = grow(apart)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 5 + [BROKE] + [JOINED] * 5
    assert found.candidate_distance_m[6] < 0.01
    # The gap is wider than planes in line are joined across.
    assert found.candidate_plane.tolist() == [0] * 6 + [1] * 6
    joined = grow(np.concatenate([apart[:6] + np.array([1.0, 0.0]), apart[6:]]))
    assert joined.candidate_growth.tolist() == found.candidate_growth.tolist()
    assert joined.candidate_plane.tolist() == [0] * 12


@pytest.mark.parametrize(("apart_m", "growth"), [(0.08, JOINED), (0.3, BROKE)])
def test_the_second_candidate_is_compared_with_the_plane_of_both(
    apart_m: float, growth: Growth
) -> None:
    """Two lines that bend far along two parallel walls: each is flat, but they have no plane."""
    pair = wall([0.0, 2.0], [0.2, 2.0], 2, lean_m=3.0)
    pair[1, :, 1] += apart_m
    found = grow(pair)
    assert found.candidate_growth.tolist() == [SEEDED, growth]
    points = samples_of(pair, np.array([SPAN_M] * 2))
    xy = points[points[:, :, 2] > SPAN_M[1] - UPPER_PART_M][:, :2]
    rms_m = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(xy))
    assert found.candidate_distance_m[1] == pytest.approx(rms_m, rel=0.01)


def test_planes_that_one_odd_line_has_cut_are_joined_again() -> None:
    candidates = STRAIGHT.copy()
    candidates[5, :, 1] -= 0.12
    found = grow(candidates)
    # It seeds a plane; its neighbour joins, as any two lines have a plane; the next breaks it.
    expected = [SEEDED] + [JOINED] * 4 + [BROKE, JOINED, BROKE]
    assert found.candidate_growth[:8].tolist() == expected
    # In the end the neighbour is in the nearest plane, and the odd line in none.
    assert found.candidate_plane.tolist() == [0] * 5 + [-1] + [0] * 6
    np.testing.assert_allclose(found.offset_m, [-2], atol=1e-4)
    assert found.line_count.tolist() == [11]


def test_a_candidate_that_ends_below_the_ceiling_is_refused_and_breaks_nothing() -> None:
    candidates = STRAIGHT.copy()
    candidates[4, :, 1] -= 0.4
    spans = [SPAN_M] * 12
    spans[4] = (0.1, CEILING_M - SETTINGS.reach_m - 0.1)
    found = grow(candidates, spans=spans)
    assert found.candidate_growth.tolist() == [SEEDED] + [JOINED] * 3 + [REFUSED] + [JOINED] * 7
    assert np.isnan(found.candidate_distance_m[4])
    assert found.candidate_plane.tolist() == [0] * 4 + [-1] + [0] * 7
    # As high as the others, it breaks the plane.
    assert BROKE in grow(candidates).candidate_growth


@pytest.mark.parametrize(("top_m", "growth"), [(2.0, REFUSED), (2.2, JOINED)])
def test_without_a_ceiling_the_height_decides(top_m: float, growth: Growth) -> None:
    spans = [(0.1, 2.5)] * 12
    spans[3] = (0.1, top_m)
    found = grow(STRAIGHT, spans=spans, ceilings=())
    assert found.candidate_growth[3] == growth
    assert np.delete(found.candidate_growth, 3).tolist() == [SEEDED] + [JOINED] * 10
    assert Reach.HEIGHT in found.candidates.reach


def test_a_duct_below_the_ceiling_is_no_wall() -> None:
    duct = grow(STRAIGHT, spans=[DUCT_M] * 12)
    assert duct.candidate_growth.tolist() == [SEEDED] + [JOINED] * 11
    assert len(duct) == 0
    assert duct.candidate_plane.tolist() == [-1] * 12
    np.testing.assert_allclose(duct.candidate_settled[:, 3], DUCT_M[0], atol=1e-6)
    # One line that comes down, as beside a door, makes it a wall.
    assert len(grow(STRAIGHT, spans=[DUCT_M] * 11 + [SPAN_M])) == 1
    # Planes after a duct are numbered without it.
    numbered = grow(CORNER, spans=[DUCT_M] * 8 + [SPAN_M] * 8)
    assert numbered.candidate_plane.tolist() == [-1] * 8 + [0] * 8


@pytest.mark.parametrize("seen", [80, 5])
def test_a_wall_behind_a_valance_is_no_duct_where_it_is_seen_below(seen: int) -> None:
    """Twelve lines: some samples of the wall, a board 0.4 m before it, the wall's upper end."""
    part, top = np.arange(SAMPLES), slice(150, SAMPLES)
    y, z = np.where((part >= seen) & (part < top.start), 1.6, 2.0), np.linspace(0.1, 2.2, SAMPLES)
    z[top] = np.linspace(DUCT_M[0], DUCT_M[1], SAMPLES - top.start)
    xs = np.linspace(-0.8, 0.8, 12)
    points = np.concatenate([np.column_stack([np.full(SAMPLES, x), y, z]) for x in xs])
    heights_m = np.array([[z[0], z[seen - 1]], DUCT_M])
    structures = structures_of(
        24,
        2 * np.arange(12).repeat(2),
        np.tile([0, top.start], 12),
        np.tile([seen - 1, SAMPLES - 1], 12),
        np.tile(heights_m, (12, 1)),
    )
    returns = Returns(points.astype(np.float32), points[:, 2].astype(np.float32), ORIGIN)
    samples = np.arange(12 * SAMPLES, dtype=np.int32).reshape(12, SAMPLES).repeat(2, axis=0)
    found = grow_wall_planes(returns, samples, structures, (CEILING,), np.ones(24, bool), SETTINGS)
    np.testing.assert_allclose(found.offset_m, [-2.0], atol=1e-3)


def test_the_evidence_shows_why_each_candidate_is_in_no_plane() -> None:
    # One too low (2), one 30 cm before the wall alone (12), two far away by themselves (13, 14).
    far = wall([4.0, -3.0], [4.2, -3.0], 2)
    candidates = np.concatenate([STRAIGHT, [STRAIGHT[5] - [0, 0.3]], far])
    spans = [SPAN_M] * len(candidates)
    spans[2] = (0.1, 2.0)
    found = grow(candidates, spans=spans)
    settled, nearest_m = found.candidate_settled, found.candidate_nearest_m
    assert found.candidates.reach[2] == Reach.LOW
    assert found.candidates.below_ceiling_m[2] == pytest.approx(CEILING_M - 2.0, abs=1e-5)
    assert found.candidate_grown[2] == -1
    assert np.isnan(settled[[2, 12, 13, 14]]).all()
    assert nearest_m[12] == pytest.approx(0.3, abs=1e-3)
    assert np.isnan(nearest_m[[2, 13, 14]]).all()
    grown = found.candidate_grown[12:]
    assert (grown - grown[0]).tolist() == [0, 1, 1]
    others = np.delete(np.arange(12), 2)
    assert np.all(found.candidates.reach[others] == Reach.CEILING)
    np.testing.assert_allclose(nearest_m[others], 0, atol=1e-3)
    assert set(settled[others, 0].tolist()) == {11.0}
    np.testing.assert_allclose(settled[others, 2], found.rms_m[0])
    assert np.flatnonzero(found.candidate_plane >= 0).tolist() == others.tolist()
    # From one line to the next, and past the one that was refused.
    step_m = float(STRAIGHT[1, 0, 0] - STRAIGHT[0, 0, 0])
    np.testing.assert_allclose(found.candidate_gap_m[[1, 3]], [step_m, 2 * step_m], atol=1e-3)
    assert np.all(found.candidate_gap_m[others[1:]] < found.candidates.gap_max_m[others[1:]])
    short = grow(wall([0.0, 2.0], [0.06, 2.0], 4, lean_m=0.0))
    assert len(short) == 0
    assert np.all(short.candidate_settled[:, 0] == 4)
    assert np.all(short.candidate_settled[:, 1] < 0.15)
    high = grow(STRAIGHT, spans=[(0.1, CEILING_M + 0.9)] * 12)
    assert set(high.candidates.reach.tolist()) == {Reach.ABOVE_CEILINGS}


@pytest.mark.parametrize("yaw_rad", [np.pi / 2, 2.5])
def test_the_partition_holds_under_motion_about_the_vertical(yaw_rad: float) -> None:
    # A corner with an odd line on one side, a wall on the other, under noise.
    corner = CORNER.copy()
    corner[3, :, 1] -= 0.2
    scene = np.concatenate([corner, wall([-0.6, -1.5], [0.9, -1.2], 9)])
    line = [*range(0, 32, 2), *range(1, 19, 2)]
    still = grow(scene, line, noise_m=0.008)
    assert set(still.candidate_plane.tolist()) == {-1, 0, 1, 2}
    np.testing.assert_allclose(still.rms_m, 0.008, rtol=0.15)
    assert {SEEDED, JOINED, BROKE} == set(still.candidate_growth.tolist())
    T = transforms.from_yaw(yaw_rad, [30.0, -12.0, 0.0])
    moved = grow(scene, line, noise_m=0.008, T=T)
    assert moved.candidate_plane.tolist() == still.candidate_plane.tolist()
    assert moved.candidate_growth.tolist() == still.candidate_growth.tolist()
    distance_m = still.candidate_distance_m
    np.testing.assert_allclose(moved.candidate_distance_m, distance_m, atol=1e-4)
    np.testing.assert_allclose(moved.rms_m, still.rms_m, atol=1e-4)
    normal = still.normal @ T[:2, :2].T
    np.testing.assert_allclose(moved.normal, normal, atol=1e-4)
    np.testing.assert_allclose(moved.offset_m, still.offset_m + normal @ T[:2, 3], atol=3e-3)
    np.testing.assert_allclose(moved.ends, still.ends @ T[:2, :2].T + T[:2, 3], atol=1e-3)
