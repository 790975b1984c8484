"""Rays in the cells of faces: against a plain reference, and single ones with known answers."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.segments import segments, turned
from ffmap.algorithms.building.evidence import (
    BEFORE,
    BEYOND,
    DEEP,
    FAR,
    LAYERS_M,
    NEAR,
    ON,
    RECESS,
    Evidence,
    first_columns,
    joined,
    rows_of,
    trace,
    trace_shared,
)
from ffmap.algorithms.building.model import CELL_M, NO_WALLS, Walls
from ffmap.algorithms.building.rays import OwnPlane, Rays, own_plane
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.scan.summary import (
    Features,
    concatenate,
    select_rays,
    select_scans,
)
from tests.faces import faces, window
from tests.tracing import rays_alone

RANGE_M = 25.0
OWN = OwnPlane(0.03, float(np.cos(np.radians(8.0))), 0.2)
NO_OWN = OWN._replace(distance_m=0.0)
LEVEL_BEHIND_M = 0.06
NAMES = tuple(field.name for field in fields(Evidence))
SCANS, RAYS = 4, 3_000


def walls_of(ends: FloatArray) -> Walls:
    """Faces between ends (W, 2, 2), seen from their left."""
    return faces(*ends.tolist())


def scan_of(
    origin: FloatArray,
    ends: FloatArray,
    label: FloatArray | int = Label.CLUTTER,
    planes: Walls = NO_WALLS,
) -> Features:
    """One scan from a place (3,), of rays to ends (r, 3), and with planes of its own."""
    ends = np.asarray(ends, float).reshape(-1, 3)
    labels = np.broadcast_to(np.asarray(label, np.uint8), len(ends)).copy()
    return replace(
        rays_alone(np.asarray(origin, float), ends, labels),
        plane_count=np.array([len(planes)]),
        plane_ends_map=planes.ends,
        plane_normal=planes.normal,
        plane_bottom_m=planes.bottom_m,
        plane_top_m=planes.top_m,
        plane_lines=planes.scan_count,
        plane_moments=np.zeros((len(planes), 6)),
    )


def scattered(seed: int, count: int = 20) -> tuple[Walls, Features]:
    """Faces anywhere in a hall of 16 m, seen from any side, and rays that end anywhere in it."""
    generator = np.random.default_rng(seed)
    start, angle = generator.uniform(-8, 8, (count, 2)), generator.uniform(-np.pi, np.pi, count)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.stack([start, start + generator.uniform(0.3, 9, count)[:, None] * along], axis=1)
    walls, scans = walls_of(ends), []
    for floor in generator.uniform(-0.03, 0.03, (SCANS, 3)):
        seen = generator.integers(0, count)
        near = ends[seen, 1]
        origin = [*near + generator.uniform(0.5, 2.0) * walls.normal[seen], 1.2]
        end = generator.uniform((-10, -10, -0.1), (10, 10, 2.6), (RAYS, 3))
        # The sensor comes close to where a face ends, and many rays end there.
        end[::2, :2] = near + generator.normal(0.0, 0.03, (RAYS // 2, 2))
        # Many end on a face, or a little before it or behind.
        of, share = generator.integers(0, count, RAYS), generator.uniform(0, 1, (RAYS, 1))
        depth_m = generator.uniform(-0.4, 0.15, (RAYS, 1))
        on_face = ends[of, 0] + share * (ends[of, 1] - ends[of, 0]) + depth_m * walls.normal[of]
        end[1::4, :2] = on_face[1::4]
        # Some of the faces have planes of the scan's own, turned and shifted a little.
        own = ends[: count // 2] + generator.uniform(-0.02, 0.02, (count // 2, 1, 2))
        own[:, 1] += generator.uniform(-0.05, 0.05, (count // 2, 2))
        own[:, 1] = own[:, 0] + generator.uniform(0.2, 1, (count // 2, 1)) * (own[:, 1] - own[:, 0])
        label = generator.choice([Label.CLUTTER, Label.FLOOR, Label.CEILING, Label.WALL], RAYS)
        scan = scan_of(np.array(origin), end, label, walls_of(own))
        intensity = generator.uniform(0.0, 255.0, RAYS).astype(np.float32)
        floor_map = np.broadcast_to(floor * (1, 1, 0.5), (1, 2, 3))
        scans.append(replace(scan, floor_map=floor_map, ray_intensity=intensity))
    return walls, concatenate(scans)


def reference(
    walls: Walls, features: Features, own: OwnPlane, range_m: float, at_ends: bool
) -> list[tuple[FloatArray, ...]]:
    """The sums of each face, by one NumPy expression after another."""
    rays, rows = Rays.of(features), rows_of(walls)
    origin, end = features.origin_map[features.ray_scan], features.ray_end_map.astype(np.float64)
    level = np.isin(features.ray_label, [Label.FLOOR, Label.CEILING])
    found = []
    for w, face in enumerate(segments(walls)):
        scans = range(len(features.scan))
        planes = np.array([own_plane(walls.ends[w], face.normal, rays, s, own) for s in scans])
        nx, ny, offset, low, high = planes[features.ray_scan].T

        def at(share: FloatArray) -> FloatArray:
            return origin + share[:, None] * (end - origin)

        def crossing(reach_m: FloatArray, side_m: FloatArray, behind: BoolArray) -> FloatArray:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.where(behind, reach_m / (reach_m - side_m), 1.0)

        reach_m, side_m = face.before_m(origin), face.before_m(end)
        place_m = face.place_m(at(crossing(reach_m, side_m, (side_m < 0) & (reach_m > 0))))
        nearest = face.at(np.clip(face.place_m(origin), 0.0, face.length_m))
        met = np.linalg.norm(nearest - origin[:, :2], axis=1) <= range_m
        met &= (reach_m >= 0.1) & (reach_m <= range_m)
        by_plane = (place_m > low - own.margin_m) & (place_m < high + own.margin_m)
        reach_m = np.where(by_plane, nx * origin[:, 0] + ny * origin[:, 1] - offset, reach_m)
        side_m = np.where(by_plane, nx * end[:, 0] + ny * end[:, 1] - offset, side_m)
        layer = np.searchsorted(-np.array(LAYERS_M), -side_m, "right") - 1
        layer[level & (side_m <= -LEVEL_BEHIND_M)] = BEYOND
        where = at(crossing(reach_m, side_m, (side_m < 0) & ((layer == BEYOND) | (not at_ends))))
        slope = features.floor_map[features.ray_scan, 0]
        floor_m = slope[:, 0] + (slope[:, 1:] * where[:, :2]).sum(axis=1)
        column = np.floor(face.place_m(where) / CELL_M).astype(int)
        row = np.floor((where[:, 2] - floor_m) / CELL_M).astype(int)
        columns = int(np.ceil(face.length_m / CELL_M))
        met &= (reach_m >= 0.1) & (layer >= 0)
        if at_ends:  # through this opening
            met &= (side_m >= 0) | ((place_m >= 0) & (place_m < columns * CELL_M))
        met &= (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        ended = np.zeros((columns, rows, 6))
        depth_sum, squares = np.zeros((columns, rows, 5)), np.zeros((columns, rows))
        light = np.zeros((columns, rows, 3))
        cells = column[met], row[met], layer[met]
        np.add.at(ended, cells, 1.0)
        within = tuple(index[layer[met] < BEYOND] for index in cells)
        np.add.at(depth_sum, within, side_m[met & (layer < BEYOND)])
        near = met & (layer <= NEAR)
        cells = column[near], row[near]
        np.add.at(squares, cells, side_m[near] ** 2)
        ray_m = np.linalg.norm(end - origin, axis=1)[near]
        cosine = (reach_m - side_m)[near] / ray_m
        intensity = features.ray_intensity[near]
        np.add.at(light, cells, np.column_stack([np.ones(len(ray_m)), intensity, cosine]))
        found.append((ended, depth_sum, squares, light))
    return found


@pytest.mark.parametrize("at_ends", [False, True])
@pytest.mark.parametrize(("own_m", "range_m"), [(0.0, 25.0), (0.03, 25.0), (0.1, 8.0)])
@pytest.mark.parametrize("seed", range(4))
def test_rays_are_booked_as_the_reference_books_them(
    seed: int, own_m: float, range_m: float, at_ends: bool
) -> None:
    walls, features = scattered(seed)
    own = OWN._replace(distance_m=own_m)
    found = trace(walls, [features], range_m, own, at_ends)
    wanted = reference(walls, features, own, range_m, at_ends)
    assert len(found) == len(walls)
    for w, (ended, *sums) in enumerate(wanted):
        face = found.of(w)
        np.testing.assert_array_equal(face.ended, ended)
        for own_sum, its in zip((face.depth_sum, face.depth_squares, face.light), sums, strict=True):
            np.testing.assert_allclose(own_sum, its, rtol=1e-5, atol=1e-4)
    met = [layer for layer in range(6) if found.ended[..., layer].sum() > 50]
    assert met == list(range(6))


FACE = walls_of(np.array([[[0.0, 0.0], [4.0, 0.0]]]))
ORIGIN = np.array([2.025, 3.0, 1.025])


def aimed(x_m: float, z_m: float, before_m: float, origin: FloatArray = ORIGIN) -> FloatArray:
    """Where a ray ends that crosses the face y = 0 there, so far before it."""
    at = np.array([x_m, 0.0, z_m])
    return origin + (origin[1] - before_m) / origin[1] * (at - origin)


@pytest.mark.parametrize(
    ("before_m", "layer"),
    [
        (0.08, BEFORE),
        (0.045, BEFORE),
        (0.03, ON),
        (0.0, ON),
        (-0.025, ON),
        (-0.04, RECESS),
        (-0.11, RECESS),
        (-0.13, DEEP),
        (-0.34, DEEP),
        (-0.4, FAR),
        (-0.9, FAR),
        (-1.1, BEYOND),
        (-6.0, BEYOND),
    ],
)
def test_a_ray_is_booked_where_it_crosses_and_by_how_deep_it_ended(
    before_m: float, layer: int
) -> None:
    end = aimed(1.025, 1.625, before_m)
    for at_ends in (False, True):
        found = trace(FACE, [scan_of(ORIGIN, [end])], RANGE_M, OWN, at_ends)
        at_its_end = before_m > 0 or (at_ends and layer != BEYOND)
        x_m, z_m = (end[0], end[2]) if at_its_end else (1.025, 1.625)
        cell = int(x_m / CELL_M), int(z_m / CELL_M), layer
        assert found.ended.sum() == found.ended[cell] == 1.0
        if layer < BEYOND:
            assert found.depth_sum[cell] == pytest.approx(before_m, abs=1e-5)
            squares = before_m**2 if layer <= NEAR else 0.0
            assert found.depth_squares[cell[:2]] == pytest.approx(squares, abs=1e-5)
        else:
            assert not found.depth_sum.any()


def test_a_ray_that_ended_on_a_reveal_is_booked_there_on_demand() -> None:
    # The jamb at x = 1, 30 cm deep: its rays crossed the face within the opening.
    reveal = np.array([[1.0, -0.1, 1.2], [1.0, -0.2, 1.2], [1.0, -0.28, 1.2]])
    scan = scan_of(np.array([2.0, 1.0, 1.2]), reveal)
    crossed = trace(FACE, [scan], RANGE_M, OWN).ended.sum(axis=(1, 2))
    ended = trace(FACE, [scan], RANGE_M, OWN, at_ends=True).ended.sum(axis=(1, 2))
    assert crossed[21:].sum() == 3.0
    assert ended[19:21].sum() == 3.0


def test_floor_and_ceiling_behind_a_face_are_none_of_what_closes_it() -> None:
    depths = (0.05, -0.02, -0.05, -0.07, -0.2, -0.6, -2.0)
    ends = np.array([aimed(1.025 + 0.2 * k, 1.0, depth) for k, depth in enumerate(depths)])
    layers = [BEFORE, ON, RECESS, RECESS, DEEP, FAR, BEYOND]
    behind = [BEFORE, ON, RECESS, BEYOND, BEYOND, BEYOND, BEYOND]
    for label, wanted in (
        (Label.CLUTTER, layers),
        (Label.WALL, layers),
        (Label.FLOOR, behind),
        (Label.CEILING, behind),
    ):
        found = trace(FACE, [scan_of(ORIGIN, ends, label)], RANGE_M, OWN)
        by_place = found.ended.sum(axis=1)
        assert by_place[by_place.any(axis=1)].argmax(axis=1).tolist() == wanted
        levels = np.isin(range(BEYOND), wanted)
        np.testing.assert_array_equal(found.depth_sum.any(axis=(0, 1)), levels)


def test_nothing_is_seen_from_behind_or_from_beyond_the_range() -> None:
    ends = np.array([aimed(x, 1.0, before) for x in (0.5, 2.0, 3.5) for before in (0.0, -0.5, -2)])

    def met(origin: FloatArray, range_m: float = RANGE_M) -> float:
        return float(trace(FACE, [scan_of(origin, ends)], range_m, OWN).ended.sum())

    assert met(ORIGIN) == 9
    assert met(ORIGIN * (1, -1, 1)) == 0
    assert met(np.array([2.0, 0.05, 1.0])) == 0  # as good as in it
    assert met(ORIGIN, range_m=2.9) == 0
    assert met(np.array([9.0, 1.0, 1.0]), range_m=5.0) == 0  # from beyond its end
    assert met(np.array([9.0, 1.0, 1.0]), range_m=5.2) > 0
    # What ends before it, above it, below it or beside it did not cross it.
    short = [aimed(2.0, 1.0, 0.12), aimed(2.0, 3.4, -1.0), aimed(2.0, -0.1, -1), aimed(4.2, 1, 0)]
    assert not trace(FACE, [scan_of(ORIGIN, short)], RANGE_M, OWN).ended.any()


def test_rays_are_measured_against_a_plane_of_their_own_scan() -> None:
    # As the scan saw it, the wall stood 2 cm before its place, over its first half.
    own = walls_of(np.array([[[0.0, 0.02], [2.0, 0.02]]]))
    places = np.array([0.525, 1.525, 2.125, 2.525, 3.525])
    ends = np.array([aimed(x, 1.0, -0.02) for x in places])
    columns = (places / CELL_M).astype(int)

    def depths(plane: Walls, rules: OwnPlane = OWN) -> FloatArray:
        found = trace(FACE, [scan_of(ORIGIN, ends, planes=plane)], RANGE_M, rules)
        assert found.ended.sum() == len(ends)
        return found.depth_sum.sum(axis=(1, 2))[columns]

    by_plane = [-0.04, -0.04, -0.04, -0.02, -0.02]  # up to 20 cm beyond what it saw
    np.testing.assert_allclose(depths(own), by_plane, atol=1e-4)
    by_face = np.full(5, -0.02)
    np.testing.assert_allclose(depths(own, NO_OWN), by_face, atol=1e-4)
    farther = walls_of(own.ends + np.array([0.0, 0.02]))
    across = walls_of(np.array([[[0.5, 0.0], [0.6, 0.02]]]))
    behind = walls_of(own.ends[:, ::-1])  # the wall's other side
    for other in (farther, across, behind):
        np.testing.assert_allclose(depths(other), by_face, atol=1e-4)
    # Other scans keep to the face, or to what they saw.
    scans = [scan_of(ORIGIN, ends, planes=planes) for planes in (own, NO_WALLS)]
    both = trace(FACE, [concatenate(scans)], RANGE_M, OWN).depth_sum.sum(axis=(1, 2))[columns]
    np.testing.assert_allclose(both, np.array(by_plane) + by_face, atol=1e-4)


def assert_same(found: Evidence, wanted: Evidence, exact: bool = True) -> None:
    for name in NAMES:
        own, its = getattr(found, name), getattr(wanted, name)
        if exact or name in ("first", "ended"):
            np.testing.assert_array_equal(own, its)
        else:
            np.testing.assert_allclose(own, its, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("workers", [0, 1, 2, 3, 40])
def test_no_sum_depends_on_the_number_of_threads(workers: int) -> None:
    walls, features = scattered(7, count=11)
    walls = replace(walls, top_m=np.linspace(1.0, 4.0, len(walls)))
    for chosen in (walls, walls.select(slice(0, 1)), walls.select(slice(0, 0))):
        for at_ends in (False, True):
            rules = RANGE_M, OWN
            shared = trace_shared(chosen, lambda: [features, features], *rules, workers, at_ends)
            alone = trace(chosen, [features, features], *rules, at_ends)
            assert shared.rows == alone.rows == rows_of(chosen)
            assert_same(shared, alone)


def test_sums_hold_for_scans_in_any_order_and_portions() -> None:
    walls, features = scattered(5)
    whole = trace(walls, [features], RANGE_M, OWN)
    scans = [select_scans(features, np.arange(SCANS) == s) for s in range(SCANS)]
    assert_same(trace(walls, scans, RANGE_M, OWN), whole)
    for blocks in (scans[::-1], [concatenate(scans[::-1])], [concatenate(scans[2:]), *scans[:2]]):
        assert_same(trace(walls, blocks, RANGE_M, OWN), whole, exact=False)
    order = np.random.default_rng(0).permutation(len(walls))
    permuted = trace(walls.select(order), [features], RANGE_M, OWN)
    for own, w in enumerate(order):
        assert_same(permuted.of(own), whole.of(int(w)))


@pytest.mark.parametrize("turn_deg", [33.0, 90.0, 180.0, 251.0])
def test_sums_hold_under_rigid_motion(turn_deg: float) -> None:
    walls, features = scattered(3)
    features = replace(features, floor_map=np.zeros((SCANS, 2, 3)))
    shift = np.array([31.0, -17.0])

    def moved(places: FloatArray) -> FloatArray:
        return np.concatenate([turned(places[..., :2], turn_deg) + shift, places[..., 2:]], axis=-1)

    # The floor is where it was, as high everywhere.
    there = replace(
        features,
        origin_map=moved(features.origin_map),
        ray_end_map=moved(features.ray_end_map).astype(np.float32),
        plane_ends_map=moved(features.plane_ends_map),
        plane_normal=turned(features.plane_normal, turn_deg),
    )
    walls_there = replace(walls, ends=moved(walls.ends), normal=turned(walls.normal, turn_deg))
    own, its = (trace(*s, RANGE_M, OWN) for s in ((walls, [features]), (walls_there, [there])))
    # A few rays cross so near a cell's or a layer's edge that rounding decides.
    assert own.ended.sum() > 5_000
    assert np.abs(own.ended - its.ended).sum() <= 2e-3 * own.ended.sum()
    np.testing.assert_allclose(own.depth_sum.sum(), its.depth_sum.sum(), rtol=1e-3)


def test_no_scan_and_no_face() -> None:
    walls, features = scattered(1)
    none = select_scans(features, np.zeros(SCANS, bool))
    for blocks in ([], [none], [none, none]):
        found = trace(walls, blocks, RANGE_M, OWN)
        assert found.ended.shape == (first_columns(walls)[-1], rows_of(walls), 6)
        assert not found.ended.any()
    found = trace(NO_WALLS, [features], RANGE_M, OWN)
    assert (len(found), found.rows, len(found.ended)) == (0, rows_of(NO_WALLS), 0)
    assert rows_of(NO_WALLS) > 0


def test_columns_and_rows_are_as_many_as_faces_need() -> None:
    walls = walls_of(np.array([[[0, 0], [1.0, 0]], [[0, 0], [0, 1.01]], [[0, 0], [0.03, 0]]]))
    assert first_columns(walls).tolist() == [0, 20, 41, 42]
    assert rows_of(replace(walls, top_m=np.array([1.0, 3.0, 2.0]))) == 70


def test_faces_and_stretches_of_them_are_taken_out_and_joined() -> None:
    walls, features = scattered(2, count=6)
    whole = trace(walls, [features], RANGE_M, OWN)
    assert len(whole) == 6
    parts = [whole.of(w) for w in range(6)]
    assert_same(joined(parts, whole.rows), whole)
    for w, face in enumerate(parts):
        assert (len(face), face.columns(0)) == (1, slice(0, len(face.ended)))
        np.testing.assert_array_equal(face.ended, whole.ended[whole.columns(w)])
        assert_same(face, trace(walls.one(w), [features], RANGE_M, OWN))
    # A lower face's evidence is that of a higher one without its upper rows.
    low = joined(parts[:2], 30)
    assert (low.rows, len(low)) == (30, 2)
    np.testing.assert_array_equal(low.ended, whole.ended[: low.first[-1], :30])
    assert joined([], 30).ended.shape == (0, 30, 6)
    counts = np.diff(whole.first)
    columns, part = whole.part([(4, 1, int(counts[4])), (0, 0, 3), (4, 2, 2), (0, 1, 4)])
    assert np.diff(part.first).tolist() == [counts[4] - 1, 3, 0, 3]
    for name in NAMES[1:]:
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[columns])
    columns, part = whole.part([])
    assert (len(columns), len(part), len(part.ended)) == (0, 0, 0)


def test_what_some_rays_found_is_taken_off() -> None:
    walls, features = scattered(4)
    some = np.arange(SCANS) < 2
    whole, first, rest = (
        trace(walls, [scans], RANGE_M, OWN)
        for scans in (features, select_scans(features, some), select_scans(features, ~some))
    )
    assert first.ended.any()
    assert_same(whole.minus(first), rest, exact=False)
    assert not whole.minus(whole).ended.any()
    np.testing.assert_array_equal(whole.minus(first).ended, rest.ended)


def test_rays_that_ended_beyond_a_window_are_told_from_the_others() -> None:
    walls = faces(*(((0, -y), (4, -y)) for y in (0, 1, 2)))
    generator = np.random.default_rng(0)
    x_m, z_m = generator.uniform((0.0, 0.1), (4.0, 2.6), (2_000, 2)).T
    through = (x_m > 1) & (x_m < 2) & (z_m > 0.9) & (z_m < 2.2)
    depth_m = np.where(through, generator.choice([-1.0, -1.9], 2_000), 0.0)
    ends = np.array([aimed(*at) for at in zip(x_m, z_m, depth_m, strict=True)])
    features, pane = scan_of(ORIGIN, ends), window((1.0, 0.0), (2.0, 0.0))
    whole = trace(walls, [features], RANGE_M, OWN)
    beyond = trace(walls, [rays_through(pane, features)], RANGE_M, OWN)
    inside = trace(walls, [select_rays(features, ~through)], RANGE_M, OWN)
    assert whole.of(1).ended.any()
    assert not inside.of(1).ended.any()
    assert_same(whole.minus(beyond), inside, exact=False)
    assert not trace(walls, [], RANGE_M, OWN).ended.any()
