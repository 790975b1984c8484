from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.segments import segments
from ffmap.algorithms.building.drive import TraceOnce
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    NO_WINDOWS,
    BuildingSettings,
    Walls,
    Windows,
)
from ffmap.algorithms.building.ray_evidence import (
    ANGLES_DEG,
    FILLED,
    SUM,
    THROUGH,
    OwnPlane,
    Rays,
    WallCells,
    own_plane,
    trace_rays,
    trace_shared,
)
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.scan.summary import NO_INTENSITY, Features, select_rays
from tests.faces import faces as wall_faces
from tests.two_rooms import TwoRooms

SETTINGS = BuildingSettings()


def scattered(seed: int, faces: int = 30, scans: int = 4, rays: int = 3_000) -> tuple[Walls, Features]:
    """Faces that lie anywhere in a hall of 16 m, seen from any side, near and far, and rays that end anywhere in it."""
    generator = np.random.default_rng(seed)
    start, angle = generator.uniform(-8, 8, (faces, 2)), generator.uniform(-np.pi, np.pi, faces)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = np.stack([start, start + generator.uniform(0.3, 9, faces)[:, None] * along], axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    walls = Walls(
        ends, normal, np.zeros(faces), np.full(faces, 2.5), np.full(faces, 9), np.full(faces, 0.01), np.full(faces, 99)
    )
    # Some of the faces have planes of the scans' own, turned and shifted a little.
    planes = faces // 2 * scans
    of_face = np.tile(np.arange(faces // 2), scans)
    turn = generator.uniform(-0.1, 0.1, planes)
    plane_along = along[of_face] * np.cos(turn)[:, None] + normal[of_face] * np.sin(turn)[:, None]
    plane_start = ends[of_face, 0] + generator.uniform(-0.02, 0.02, (planes, 2))
    plane_ends = np.stack([plane_start, plane_start + generator.uniform(0.2, 3, planes)[:, None] * plane_along], axis=1)
    end = np.column_stack([generator.uniform(-10, 10, (scans * rays, 2)), generator.uniform(-0.1, 2.6, scans * rays)])
    # The sensor comes close to where faces end, and many rays end there.
    seen = generator.integers(0, faces, scans)
    near, origin = ends[seen, 1], ends[seen, 1] + generator.uniform(0.5, 2.0, (scans, 1)) * normal[seen]
    end[::2, :2] = np.repeat(near, rays // 2, axis=0) + generator.normal(0.0, 0.03, (len(end[::2]), 2))
    features = Features(
        scan=np.arange(scans),
        origin_map=np.column_stack([origin, np.full(scans, 1.2)]),
        floor_map=np.zeros((scans, 2, 3)),
        floor_is_foot=np.zeros(scans, bool),
        floor_reach_m=np.full(scans, 6.0),
        ray_count=np.full(scans, rays),
        plane_count=np.full(scans, faces // 2),
        ray_end_map=end.astype(np.float32),
        ray_label=generator.choice([Label.CLUTTER, Label.FLOOR, Label.WALL], scans * rays).astype(np.uint8),
        plane_ends_map=plane_ends,
        plane_normal=np.stack([-plane_along[..., 1], plane_along[..., 0]], axis=1),
        plane_bottom_m=np.zeros(planes),
        plane_top_m=np.full(planes, 2.5),
        plane_lines=np.full(planes, 5),
        plane_moments=np.zeros((planes, 6)),
    )
    return walls, features


@pytest.mark.parametrize(("own_plane_m", "near_m"), [(0.0, 0.07), (0.03, 0.35), (0.1, 0.35)])
@pytest.mark.parametrize("seed", range(5))
def test_each_face_counts_the_rays_that_meet_it(seed: int, own_plane_m: float, near_m: float) -> None:
    walls, features = scattered(seed)
    settings = SETTINGS.model_copy(update={"own_plane_m": own_plane_m, "near_m": near_m})
    cells = trace_rays(walls, [features], settings)
    rays, own = Rays.of(features), OwnPlane.of(settings)
    origin, end = features.origin_map[features.ray_scan], features.ray_end_map.astype(np.float64)
    level = np.isin(features.ray_label, [Label.FLOOR, Label.CEILING])
    for w, face in enumerate(segments(walls)):
        planes = np.array([own_plane(walls.ends[w], face.normal, rays, s, own) for s in range(len(features.scan))])
        nx, ny, offset, low, high = planes[features.ray_scan].T
        place_m = face.place_m(end)
        by_plane = (place_m > low - own.margin_m) & (place_m < high + own.margin_m)
        reach_m = np.where(by_plane, nx * origin[:, 0] + ny * origin[:, 1] - offset, face.before_m(origin))
        side_m = np.where(by_plane, nx * end[:, 0] + ny * end[:, 1] - offset, face.before_m(end))
        nearest = face.at(np.clip(face.place_m(origin), 0.0, face.length_m))
        in_range = np.linalg.norm(nearest - origin[:, :2], axis=1) <= settings.range_m
        near = side_m > np.where(level, -AT_FACE_M, -settings.near_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = origin + (reach_m / (reach_m - side_m))[:, None] * (end - origin)
        at = np.where(near[:, None], end, crossing)
        column, row = (np.floor(v / CELL_M) for v in (face.place_m(at), at[:, 2]))
        met = in_range & (face.before_m(origin) >= 0.1) & (reach_m >= 0.1) & (side_m <= 0.1)
        met &= (column >= 0) & (column < cells.first[w + 1] - cells.first[w]) & (row >= 0) & (row < cells.rows)
        counts = cells.counts[cells.first[w] : cells.first[w + 1]]
        assert counts[..., FILLED].sum() == np.count_nonzero(met & near)
        assert counts[..., THROUGH].sum() == np.count_nonzero(met & ~near)
        np.testing.assert_allclose(counts[..., SUM].sum(), side_m[met & near].sum(), atol=1e-3)


@pytest.mark.parametrize("workers", [1, 2, 3, 40])
def test_faces_shared_by_workers_are_told_as_by_one(workers: int) -> None:
    rooms = TwoRooms()
    walls = replace(rooms.walls, top_m=np.linspace(1.0, 4.0, len(rooms.walls)))
    for chosen in (walls, walls.select(slice(0, 1)), walls.select(slice(0, 0))):
        features = rooms.scans(rays=2_000)
        rays = len(features.ray_label)
        features = replace(features, ray_intensity=np.linspace(1, 90, rays).astype(np.float32))
        shared = trace_shared(chosen, lambda features=features: [features, features], SETTINGS, workers)
        alone = trace_rays(chosen, [features, features], SETTINGS)
        assert shared.rows == alone.rows
        for name in ("first", "counts", "light"):
            np.testing.assert_array_equal(getattr(shared, name), getattr(alone, name))
        assert not len(chosen) or alone.light.any()


def test_a_face_that_was_asked_about_is_not_traced_again() -> None:
    rooms, asked = TwoRooms(glass=(0.9, 2.1), both_seen=False), []
    features, settings = rooms.scans(rays=4_000), BuildingSettings()

    def trace(walls: Walls, settings: BuildingSettings, through: Windows | None) -> WallCells:
        asked.append(len(walls))
        return trace_rays(walls, [features if through is None else rays_through(through, features)], settings)

    once, walls = TraceOnce(trace), rooms.walls
    low = replace(walls, top_m=np.full(len(walls), 1.0))
    high = replace(walls, top_m=np.full(len(walls), 4.0))
    portions = (low.select(slice(0, 2)), low, low.select(slice(1, 3)), high.select(slice(0, 1)), low)
    for chosen in portions:
        found, wanted = once(chosen, settings, NO_WINDOWS), trace_rays(chosen, [features], settings)
        assert found.rows == wanted.rows
        np.testing.assert_array_equal(found.first, wanted.first)
        np.testing.assert_array_equal(found.counts, wanted.counts)
    # The first two, the others, none, one again for it is higher now, none.
    assert asked == [2, len(walls) - 2, 1]
    # Of what ended beyond a window alone, once.
    inside = features.ray_end_map[:, 1] > -CELL_M  # as seen from where the robot was
    for _ in range(2):
        found, wanted = once(walls, settings, rooms.window), trace_rays(walls, [select_rays(features, inside)], settings)
        np.testing.assert_allclose(found.counts, wanted.counts, atol=1e-5)
        assert not found.counts[found.counts[..., FILLED] == 0, SUM].any()
    assert asked[3:] == [len(walls) - 1, len(walls)]  # as high as these are, all but one for the first time
    assert once(walls.select(slice(0, 0)), settings, NO_WINDOWS).counts.shape[0] == 0


def test_cells_sum_up_intensities_by_the_angle_of_incidence() -> None:
    walls, origin = wall_faces(((0, 0), (4, 0))), np.array([2.0, 3.0, 1.0])
    end = np.array([[2.0, 0.0, 1.0], [2.0, 0.0, 1.02], [0.5, 0.0, 1.0], [0.5, 0.0, 1.01], [2.0, 0.0, 2.0]], np.float32)
    _, features = scattered(0)
    features = replace(
        features,
        scan=np.array([0]), origin_map=origin[None], floor_map=np.zeros((1, 2, 3)), floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0), ray_count=np.array([5]), plane_count=np.array([0]), ray_end_map=end,
        ray_label=np.full(5, Label.WALL, np.uint8), plane_ends_map=np.zeros((0, 2, 2)), plane_normal=np.zeros((0, 2)),
        ray_intensity=np.array([10.0, np.nan, 30.0, 50.0, 20.0], np.float32),
    )  # fmt: skip
    cells = trace_rays(walls, [features], SETTINGS)
    assert np.diff([0.0, *ANGLES_DEG]).max() <= 10.0  # over more, intensities fall by as much as a leaf's differs
    steepest, slant = np.zeros((2, len(ANGLES_DEG) + 1, 2))
    steepest[0] = 1, 10  # at right angles, one unknown
    slant[np.searchsorted(ANGLES_DEG, 27.0)] = 2, 80
    np.testing.assert_array_equal(cells.light[40, 20], steepest)
    np.testing.assert_array_equal(cells.light[10, 20], slant)
    twice_asked = trace_rays(walls, [features, features], SETTINGS)
    np.testing.assert_array_equal(twice_asked.light, 2 * cells.light)
    dark = trace_rays(walls, [replace(features, ray_intensity=NO_INTENSITY)], SETTINGS)
    assert len(dark.light) == 0
    np.testing.assert_array_equal(dark.counts, cells.counts)
    without_planes = trace_rays(walls, [features], SETTINGS.model_copy(update={"own_plane_m": 0.0}))
    assert len(without_planes.light) == 0
    np.testing.assert_array_equal(without_planes.counts, cells.counts)
