"""The method on an analytic room: known walls, floor, ceiling, a recessed door, under noise and rigid motion."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.building.door_frames import measure_reveals, place_frames
from ffmap.algorithms.building.doors import find_doors
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES
from ffmap.algorithms.building.final_labels import BuildingModel, RelabellingSettings, relabel
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, BuildingSettings, Doors, Walls, Windows
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.building.votes import VoxelTable, find_halo
from ffmap.algorithms.building.windows import find_windows
from ffmap.algorithms.maps.grid import Cell, GridMapSettings, Immobile, draw_furniture_free
from ffmap.algorithms.poses.levelling import level_map, turn_to_floor
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.point_lines import (
    LEANING_MIN_DEG,
    SAMPLES,
    HorizontalPlane,
    PointLines,
    below_ceiling,
    find_ceilings,
    find_floor,
    make_point_lines,
)
from ffmap.algorithms.scan.summary import concatenate, extract, move_moments
from tests import synthetic
from tests.voting import vote

METHOD = synthetic.settings()
HEIGHT_M = 2.8
# The lidar lies on its side: its spin axis z points along the base's x, its x axis down.
T_BASE_SENSOR = transforms.make_transform(
    Rotation.from_matrix(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])), [0.0, 0.0, 0.8]
)


@dataclass(frozen=True)
class Hole:
    """In the wall y = 2: from x0 to x1, from foot to head; depth of the leaf behind the wall, None for an open door.

    pane: the share of the rays that a pane 10 cm behind the wall returns.
    """

    x0: float = -0.5
    x1: float = 0.4
    foot: float = 0.0
    head: float = 2.1
    depth: float | None = 0.05
    pane: float = 0.0


def cast(
    T_map_sensor: np.ndarray, hole: Hole | None, noise_m: float, seed: int, ceiling: bool = True
) -> tuple[Scan, np.ndarray]:
    """One sweep of 32 emitters in a corridor -4 < x < 6, -1.5 < y < 2, and the true label of each return."""
    generator = np.random.default_rng(seed)
    azimuth, elevation = np.meshgrid(
        np.linspace(0, 2 * np.pi, 1800, endpoint=False), np.radians(np.linspace(-30, 10, 32)), indexing="ij"
    )
    ring = np.tile(np.arange(32, dtype=np.uint16), 1800)
    direction_sensor = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    origin = T_map_sensor[:3, 3]
    d = direction_sensor @ T_map_sensor[:3, :3].T
    best = np.full(len(d), np.inf)
    label = np.zeros(len(d), np.uint8)
    planes = [
        (2, 0.0, Label.FLOOR),
        (0, -4.0, Label.WALL),
        (0, 6.0, Label.WALL),
        (1, -1.5, Label.WALL),
        (1, 2.0, Label.WALL),
    ]
    if ceiling:
        planes.append((2, HEIGHT_M, Label.CEILING))
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis, at, code in planes:
            t = (at - origin[axis]) / d[:, axis]
            hit = (t > 1e-6) & (t < best)
            if axis == 1 and at == 2.0 and hole is not None:
                p = origin + t[:, None] * d
                in_hole = (p[:, 0] > hole.x0) & (p[:, 0] < hole.x1) & (p[:, 2] < hole.head)
                in_hole &= p[:, 2] > hole.foot
                hit &= ~in_hole
                t_pane = (at + 0.1 - origin[axis]) / d[:, axis]
                returned = in_hole & (t_pane < best) & (t > 0) & (generator.random(len(d)) < hole.pane)
                best[returned], label[returned] = t_pane[returned], Label.OUTSIDE
            best[hit], label[hit] = t[hit], code
        if hole is not None:
            t = (2.0 + (4.0 if hole.depth is None else hole.depth) - origin[1]) / d[:, 1]
            p = origin + t[:, None] * d
            behind = (t > 0) & (t < best) & (p[:, 2] > 0) & (p[:, 2] < HEIGHT_M)
            best[behind], label[behind] = t[behind], Label.CLUTTER if hole.depth is None else Label.DOOR
    keep = np.isfinite(best) & (best < 30)
    range_m = best[keep] + generator.normal(0, noise_m, keep.sum())
    scan = Scan(
        points_sensor=(direction_sensor[keep] * range_m[:, None]).astype(np.float32),
        ring=ring[keep],
        ring_count=32,
        time_ns=None,
        start_ns=0,
        stamp_ns=0,
        cloud_index=np.flatnonzero(keep).astype(np.int32),
        cloud_size=len(keep),
    )
    return scan, label[keep]


def pose(x: float = 0.0, yaw_rad: float = 0.0) -> np.ndarray:
    return transforms.from_yaw(yaw_rad, [x, 0.0, 0.0])


def place(scan: Scan, T_map_base: np.ndarray) -> PlacedScan:
    return place_scan(scan, Trajectory(np.array([0]), T_map_base[None]), T_BASE_SENSOR)


def labelled(
    hole: Hole | None = None, noise_m: float = 0.015, seed: int = 1, x: float = 0.0, ceiling: bool = True
) -> tuple[Scan, PlacedScan, np.ndarray, ScanLabelling]:
    scan, truth = cast(pose(x) @ T_BASE_SENSOR, hole, noise_m, seed, ceiling)
    placed = place(scan, pose(x))
    return scan, placed, truth, label_scan(scan, placed, METHOD, seed)


def relabelled(
    placed: PlacedScan, found: ScanLabelling, walls: Walls, doors: Doors, windows: Windows
) -> tuple[np.ndarray, np.ndarray]:
    """A scan's points in the map, and their final labels."""
    points = placed.to_map(placed.points_level).astype(np.float32)
    halo = find_halo(vote(points, found.label, len(Label), 0.05), 6.0)
    origin = placed.to_map(placed.origin_level[None])[0]
    columns = np.ceil(np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1) / CELL_M)
    first = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
    before = Foreground(first, np.full(first[-1], HEIGHT_M), np.zeros(first[-1]), np.zeros((first[-1], 60), bool))
    return points, relabel(
        points,
        found.height_m,
        below_ceiling(placed.points_level, found.ceiling_planes),
        found.label,
        origin,
        BuildingModel(walls, before, NO_JUDGED_FACES, doors, windows, ()),
        halo,
        RelabellingSettings(),
    )


def share(label: np.ndarray, truth: np.ndarray, code: int) -> tuple[float, float]:
    """Precision and recall by points."""
    right = np.count_nonzero((label == code) & (truth == code))
    return right / max(np.count_nonzero(label == code), 1), right / max(np.count_nonzero(truth == code), 1)


def test_a_bare_corridor_is_labelled_almost_without_error() -> None:
    _, _, truth, found = labelled()
    for code in (Label.FLOOR, Label.CEILING, Label.WALL):
        precision, recall = share(found.label, truth, code)
        assert precision > 0.97, code
        assert recall > 0.97, code
    assert found.ceilings[0].height_m == pytest.approx(HEIGHT_M, abs=0.005)
    # Side walls and both ends: planes at the known offsets, facing the sensor.
    walls = {tuple(np.round(n * o, 1) + 0.0) for n, o in zip(found.planes.normal, found.planes.offset_m, strict=True)}
    assert {(0.0, 2.0), (0.0, -1.5)} <= walls
    assert np.all(found.planes.normal @ np.array([0.0, 0.0]) - found.planes.offset_m > 0)


def test_a_closed_leaf_recessed_by_centimetres_is_door() -> None:
    _, _, truth, found = labelled(Hole(depth=0.05))
    precision, recall = share(found.label, truth, Label.DOOR)
    assert precision > 0.8
    assert recall > 0.6
    assert len(found.openings) >= 1
    assert set(found.openings.state.tolist()) == {DoorState.CLOSED}
    assert np.median(found.openings.depth_m) == pytest.approx(0.05, abs=0.015)
    above = found.door_lines.above_door
    assert np.all(found.door_lines.start_height_m[above] > METHOD.doors.height_min_m)
    assert np.all(found.door_lines.start_height_m[above] == pytest.approx(2.1, abs=0.25))


def test_an_open_door_is_an_open_opening_and_a_bare_wall_has_none() -> None:
    assert DoorState.OPEN in labelled(Hole(depth=None))[3].openings.state
    assert len(labelled(None)[3].openings) == 0


def test_without_a_ceiling_in_view_none_is_invented() -> None:
    _, _, _, found = labelled(ceiling=False)
    assert found.ceilings == ()
    assert not np.any(found.label == Label.CEILING)


def test_labels_do_not_depend_on_the_order_of_returns() -> None:
    scan, placed, _, found = labelled(Hole())
    shuffle = np.random.default_rng(3).permutation(len(scan))
    shuffled = replace(
        scan, points_sensor=scan.points_sensor[shuffle], ring=scan.ring[shuffle], cloud_index=scan.cloud_index[shuffle]
    )
    other = label_scan(shuffled, replace(placed, points_level=placed.points_level[shuffle]), METHOD, 1)
    assert np.mean(other.label == found.label[shuffle]) > 0.99


@pytest.mark.parametrize("yaw_rad", [0.4, 1.3, -2.9])
def test_labels_hold_under_rigid_motion_of_the_whole(yaw_rad: float) -> None:
    scan, _, _, found = labelled(Hole())
    moved = place(scan, transforms.from_yaw(yaw_rad, [30.0, -12.0, 0.0]))
    assert np.mean(label_scan(scan, moved, METHOD, 1).label == found.label) > 0.999


def test_empty_and_tiny_scans_are_labelled_without_complaint() -> None:
    scan, placed, _, _ = labelled()
    for count in (0, 1, 5, 300):
        few = replace(
            scan, points_sensor=scan.points_sensor[:count], ring=scan.ring[:count], cloud_index=scan.cloud_index[:count]
        )
        found = label_scan(few, replace(placed, points_level=placed.points_level[:count]), METHOD, 1)
        assert len(found.label) == count


def test_point_lines_have_exactly_200_returns_from_below_upwards() -> None:
    scan, _placed, _, found = labelled()
    lines = found.lines
    assert lines.samples.shape == (64, SAMPLES)
    assert sorted(lines.order.tolist()) == list(range(len(scan)))
    # Eq. 1, unfolded: the angle about the spin axis from straight down, to what single precision leaves of it.
    down = transforms.invert(T_BASE_SENSOR)[:3, :3] @ np.array([0.0, 0.0, -1.0])
    radial = scan.points_sensor[:, :2] / np.linalg.norm(scan.points_sensor[:, :2], axis=1, keepdims=True)
    angle_rad = np.arccos(np.clip(radial @ down[:2], -1, 1))
    for line in range(64):
        own = lines.order[lines.starts[line] : lines.starts[line + 1]]
        assert np.all(scan.ring[own] == line // 2)
        assert np.all(np.diff(angle_rad[own]) > -1e-3)
    full = lines.samples[lines.samples[:, 0] >= 0]
    assert np.all(np.diff(angle_rad[full], axis=1) > -1e-3)
    assert not np.any(np.isin(found.label[full], [Label.FLOOR, Label.CEILING]) & (found.plane[full] < 0))


def test_equation_2_is_kept_as_printed() -> None:
    _, placed, _, found = labelled()
    points, samples = placed.points_level, found.lines.samples
    for line in np.flatnonzero(samples[:, 0] >= 0)[::7]:
        p = points[samples[line]].astype(np.float64) - placed.origin_level
        rho = np.hypot(p[:, 0], p[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = np.diff(rho) / np.diff(p[:, 2])
        ours = found.structures.difference[line, 1:]
        usable = np.isfinite(expected) & (np.abs(np.diff(p[:, 2])) > 1e-4)
        np.testing.assert_allclose(ours[usable], expected[usable], rtol=2e-2, atol=2e-2)


def test_an_upright_spin_axis_has_no_lines() -> None:
    scan, _, _, _ = labelled()

    def lines(tilt_deg: float) -> PointLines:
        down = np.array([np.sin(np.radians(tilt_deg)), 0.0, -np.cos(np.radians(tilt_deg))])
        return make_point_lines(
            scan.points_sensor, scan.ring, 32, down, np.zeros(len(scan), bool), METHOD.rearrangement
        )

    for tilt_deg in (0.0, LEANING_MIN_DEG - 0.1):
        with pytest.raises(ValueError, match="upright"):
            lines(tilt_deg)
    assert len(lines(LEANING_MIN_DEG + 0.1).order) == len(scan)


def test_floor_and_ceiling_follow_a_tilt() -> None:
    _, placed, _, _ = labelled()
    tilt = Rotation.from_euler("xy", [0.8, -0.6], degrees=True)
    points = (tilt.apply(placed.points_level) + np.array([0.0, 0.0, 0.05])).astype(np.float32)
    floor = find_floor(points, METHOD.rearrangement)
    assert floor.height_m == pytest.approx(0.05, abs=0.01)
    level = turn_to_floor(replace(placed, points_level=points), floor.height_m, floor.slope, np.zeros(2), 2.0)
    again = find_floor(level.points_level, METHOD.rearrangement)
    assert np.hypot(*again.slope) < 0.002
    untouched = turn_to_floor(replace(placed, points_level=points), floor.height_m, floor.slope, np.zeros(2), 0.1)
    assert untouched.points_level is points


def test_a_ceiling_over_a_ramp_may_slope_with_it_or_be_level() -> None:
    generator = np.random.default_rng(2)
    xy = generator.uniform(-3, 3, (6_000, 2))
    ramp = HorizontalPlane(0.0, np.array([0.08, 0.0]), 0)
    for slope in (0.08, 0.0):
        points = np.column_stack([xy, 2.8 + slope * xy[:, 0] + generator.normal(0, 0.01, len(xy))]).astype(np.float32)
        (ceiling,) = find_ceilings(points, ramp, METHOD.rearrangement, 0)
        assert ceiling.height_m == pytest.approx(2.8, abs=0.01)
        np.testing.assert_allclose(ceiling.slope, [slope, 0.0], atol=0.005)


def test_ceiling_is_independent_of_the_seed() -> None:
    _, placed, _, _ = labelled()
    floor = HorizontalPlane(0.0, np.zeros(2), 0)
    found = [find_ceilings(placed.points_level, floor, METHOD.rearrangement, seed)[0].height_m for seed in range(5)]
    assert np.ptp(found) < 0.005


def test_the_map_is_levelled_by_floor_and_walls() -> None:
    tilt = transforms.make_transform(Rotation.from_euler("xyz", [3.0, -2.0, 40.0], degrees=True), [5.0, 1.0, -0.3])
    _, placed, _, _ = labelled()
    T_odom_base = tilt @ pose()
    level = level_map(transforms.apply(tilt, placed.points_level), T_odom_base)
    assert level.floor_rms_m < 0.03
    T_map_odom = level.T_map_odom
    np.testing.assert_allclose(level.floor_slope, 0, atol=0.005)
    np.testing.assert_allclose((T_map_odom @ T_odom_base)[:3, 3], 0, atol=0.02)
    np.testing.assert_allclose((T_map_odom @ tilt)[2, :3], [0, 0, 1], atol=0.005)


def test_walls_tell_which_way_is_up_where_the_floor_slopes() -> None:
    scans = [labelled(seed=i, x=x) for i, x in enumerate(np.linspace(0.0, 1.0, 12))]
    points = np.concatenate([placed.to_map(placed.points_level) for _, placed, _, _ in scans])
    floor = np.concatenate([truth for _, _, truth, _ in scans]) == Label.FLOOR
    points[floor, 2] -= 0.02 * points[floor, 1]  # the walls' normals lie along y: slopes along x they leave open
    tilt = transforms.make_transform(Rotation.from_euler("xy", [2.0, -1.0], degrees=True), [0.0, 0.0, 0.0])
    level = level_map(transforms.apply(tilt, points), tilt @ pose())
    lean_deg = np.degrees(np.arccos((level.T_map_odom @ tilt)[2, 2]))
    assert lean_deg < 0.2  # the floor's normal is off by 1.15 degrees
    np.testing.assert_allclose(level.floor_slope, [0.0, -0.02], atol=0.004)


def test_an_underside_tells_how_deep_a_reveal_is() -> None:
    generator = np.random.default_rng(5)
    door = replace(
        NO_DOORS,
        ends=np.array([[[0.0, 2.0], [1.0, 2.0]]]),
        normal=np.array([[0.0, -1.0]]),
        head_m=np.array([2.1]),
        depth_m=np.array([np.nan]),
        state=np.array([DoorState.OPEN], np.uint8),
        reveal_m=np.array([0.3]),
    )
    underside = generator.uniform([0.0, 2.0, 2.09], [1.0, 2.18, 2.11], (3_000, 3))
    leaf = generator.uniform([0.8, 2.2, 2.05], [0.84, 2.6, 2.1], (3_000, 3))
    _, placed, _, found = labelled()
    rays = np.concatenate([underside, leaf]).astype(np.float32)
    features = replace(
        extract(0, placed, found),
        floor_map=np.zeros((1, 3)),
        ray_count=np.array([len(rays)]),
        ray_end_map=rays,
        ray_label=np.zeros(len(rays), np.uint8),
    )
    assert measure_reveals(door, [features]).reveal_m[0] == pytest.approx(0.18, abs=0.025)


def test_poses_between_stamps_are_scipys() -> None:
    generator = np.random.default_rng(0)
    turns = Rotation.from_rotvec(np.cumsum(generator.normal(0, 0.1, (8, 3)), axis=0))
    T = np.stack([transforms.make_transform(r, [i, 2 * i, 0]) for i, r in enumerate(turns)])
    stamps = 1_700_000_000_000_000_000 + np.arange(8) * 100_000_000
    trajectory = Trajectory(stamps, T)
    times = stamps[0] + generator.integers(0, 700_000_000, 50)
    expected = Slerp((stamps - stamps[0]) * 1e-9, turns)((times - stamps[0]) * 1e-9)
    ours = trajectory.at(times)
    assert np.max((Rotation.from_matrix(ours[:, :3, :3]).inv() * expected).magnitude()) < 1e-6
    np.testing.assert_allclose(ours[:, 0, 3], (times - stamps[0]) / 1e8, atol=1e-6)
    with pytest.raises(ValueError, match="increase"):
        Trajectory(stamps[::-1], T)


def test_moments_move_with_their_points() -> None:
    xy = np.random.default_rng(1).normal(size=(40, 2))

    def moments(p: np.ndarray) -> np.ndarray:
        x, y = p[:, 0], p[:, 1]
        return np.array([[len(p), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()]])

    T = transforms.from_yaw(0.7, [3.0, -4.0, 0.0])
    moved = transforms.apply(T, np.column_stack([xy, np.zeros(40)]))[:, :2]
    np.testing.assert_allclose(move_moments(moments(xy), T), moments(moved), rtol=1e-9)


@pytest.mark.parametrize(
    ("hole", "doors", "windows"),
    [
        (Hole(depth=None), 1, 0),
        (Hole(depth=None, pane=0.02), 0, 1),
        (Hole(depth=None, foot=0.9), 0, 1),
        (Hole(depth=None, foot=0.9, pane=0.02), 0, 1),
        (Hole(depth=0.05), 1, 0),
        (None, 0, 0),
    ],
    ids=["open door", "pane to the floor", "open window", "window", "closed door", "bare wall"],
)
def test_glass_is_told_from_open_doors(hole: Hole | None, doors: int, windows: int) -> None:
    scans = [(i, *labelled(hole, seed=i, x=x)) for i, x in enumerate(np.linspace(-1.0, 1.5, 30))]
    features = concatenate([extract(i, placed, found) for i, _, placed, _, found in scans])
    settings = BuildingSettings()
    walls = fuse_walls(features, settings)
    cells = trace_rays(walls, [features], settings)
    assert len(find_doors(walls, cells, np.full(int(cells.first[-1]), np.nan), settings)) == doors
    found = find_windows(walls, cells, np.full(int(cells.first[-1]), np.nan), settings)
    assert len(found) == windows
    if hole is not None and windows:
        np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.12)
        np.testing.assert_allclose(found.ends[0, :, 1], 2.0, atol=0.02)
        # What lies beyond is outside.
        _, placed, _, labelling = scans[14][1:]
        doors = find_doors(walls, cells, np.full(int(cells.first[-1]), np.nan), settings)
        points, final = relabelled(placed, labelling, walls, doors, found)
        assert np.mean(final[points[:, 1] > 2.5] == Label.OUTSIDE) > 0.99
        assert not np.any(final[points[:, 1] < 2.1] == Label.OUTSIDE)


def test_slits_beside_a_mullion_that_returns_more_are_no_window() -> None:
    walls = Walls(
        np.array([[[0.0, 0.0], [3.0, 0.0]]]),
        np.array([[0.0, -1.0]]),
        np.zeros(1),
        np.array([2.8]),
        np.array([9], np.int32),
        np.array([0.01]),
        np.array([900]),
    )
    counts = np.zeros((60, 66, 4), np.float32)
    counts[:, :, 0] = 10.0
    # Two slits with a mullion between them that returns more rays than both let through.
    counts[19:31, 20:40, 0], counts[19:31, 20:40, 3] = 0.0, 20.0
    counts[24:26, 20:40, 0], counts[24:26, 20:40, 3] = 1000.0, 0.0
    cells = WallCells(np.array([0, 60]), 66, counts)
    assert len(find_windows(walls, cells, np.full(int(cells.first[-1]), np.nan), BuildingSettings())) == 0


@pytest.mark.parametrize("depth", [0.05, None])
def test_the_building_of_several_scans_has_its_walls_and_its_door(depth: float | None) -> None:
    hole = Hole(depth=depth)
    scans = [(i, *labelled(hole, seed=i, x=x)) for i, x in enumerate(np.linspace(-1.0, 1.5, 30))]
    features = concatenate([extract(i, placed, found) for i, _, placed, _, found in scans])
    settings = BuildingSettings()
    walls = fuse_walls(features, settings)
    offsets = {tuple(np.round(n * (n @ e[0]), 1) + 0.0) for n, e in zip(walls.normal, walls.ends, strict=True)}
    assert {(0.0, 2.0), (0.0, -1.5)} <= offsets
    cells = trace_rays(walls, [features], settings)
    doors = find_doors(walls, cells, np.full(int(cells.first[-1]), np.nan), settings)
    assert len(doors) == 1
    assert doors.state[0] == (DoorState.OPEN if depth is None else DoorState.CLOSED)
    np.testing.assert_allclose(doors.ends[0].mean(axis=0), [-0.05, 2.0], atol=0.1)
    assert np.linalg.norm(doors.ends[0, 1] - doors.ends[0, 0]) == pytest.approx(0.9, abs=0.15)
    assert doors.head_m[0] == pytest.approx(2.1, abs=0.04)
    exact = place_frames(doors, walls, [features], settings)
    np.testing.assert_allclose(np.sort(exact.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.02)
    np.testing.assert_allclose(exact.ends[0, :, 1], doors.ends[0, :, 1], atol=0.01)
    assert exact.head_m[0] == pytest.approx(2.1, abs=0.02)
    # However wrong the head was before.
    far_off = place_frames(replace(doors, head_m=np.array([2.4])), walls, [features], settings)
    assert far_off.head_m[0] == exact.head_m[0]
    # The wall has no thickness here: its lintel's underside is but the edge's scatter.
    assert measure_reveals(doors, [features]).reveal_m[0] < 0.1
    windows = find_windows(walls, cells, np.full(int(cells.first[-1]), np.nan), settings)
    assert len(windows) == 0

    if depth is not None:
        _, _, placed, truth, found = scans[14]
        _, final = relabelled(placed, found, walls, doors, windows)
        precision, recall = share(final, truth, Label.DOOR)
        assert precision > 0.9
        assert recall > 0.9

    drive = Drive(np.array([[-1.0, 0.0], [1.5, 0.0]]), lambda: [features])
    immobile = Immobile(walls, cells, VoxelTable(0.05, len(Label)).votes(), doors, windows)
    grid = draw_furniture_free(immobile, drive, GridMapSettings(), WallThicknessSettings())

    def at(x: float, y: float) -> int:
        column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_m).astype(int)
        return int(grid.cells[row, column])

    assert at(-0.05, 2.0) == Cell.FREE  # through the door, even a closed one
    assert Cell.OCCUPIED in {at(0.9, 1.97), at(0.9, 2.02)}
    assert at(0.5, 0.5) == Cell.FREE
    assert at(1.5, 2.4) == Cell.UNKNOWN


@pytest.mark.parametrize(("lean_deg", "is_own"), [(0.8, True), (4.0, False)])
def test_a_scans_own_plane_tells_of_a_wall_only_where_the_scan_saw_it(lean_deg: float, is_own: bool) -> None:
    """A face 6 m long, and the scan's plane of its first 2 m, which leans: it may be the face's, or a leaf's that stands ajar."""
    lean = np.radians(lean_deg)
    normal = np.array([np.sin(lean), -np.cos(lean)])
    scans = [(0, *labelled(Hole(depth=None), seed=0, x=0.0))]
    features = concatenate([extract(i, placed, found) for i, _, placed, _, found in scans])
    x = np.linspace(0.1, 5.9, 59)
    features = replace(
        features,
        origin_map=np.array([[3.0, 0.0, 1.0]]),
        floor_map=np.zeros((1, 3)),
        ray_count=np.array([len(x)], np.int32),
        ray_end_map=np.column_stack([x, np.full(len(x), 2.0), np.full(len(x), 1.0)]).astype(np.float32),
        plane_count=np.array([1], np.int32),
        plane_ends_map=np.array([[[0.0, 2.0], [2.0 * np.cos(lean), 2.0 + 2.0 * np.sin(lean)]]]),
        plane_normal=normal[None],
        plane_moments=np.zeros((1, 6)),
        plane_bottom_m=np.zeros(1),
        plane_top_m=np.full(1, 2.8),
        plane_lines=np.ones(1, np.int32),
    )
    wall = Walls(
        np.array([[[0.0, 2.0], [6.0, 2.0]]]),
        np.array([[0.0, -1.0]]),
        np.zeros(1),
        np.full(1, 2.8),
        np.ones(1, np.int32),
        np.zeros(1),
        np.array([900]),
    )
    cells = trace_rays(wall, [features], BuildingSettings())
    filled, total = cells.counts[..., 0].sum(axis=1), cells.counts[..., 1].sum(axis=1)
    mean_m = np.divide(total, filled, out=np.zeros_like(total), where=filled > 0)
    assert filled[50:].sum() > 30
    np.testing.assert_allclose(mean_m[50:], 0.0, atol=1e-6)
    assert filled[:40].sum() > 15
    np.testing.assert_allclose(mean_m[:40].max(), 2.0 * np.sin(lean) if is_own else 0.0, atol=0.004)


def test_the_floor_is_found_wherever_the_robot_has_climbed() -> None:
    scan, truth = cast(pose() @ T_BASE_SENSOR, None, 0.015, 3)
    # The map says that robot and floor are 0.6 m higher than at the start: a ramp, or drift.
    climbed = transforms.make_transform(None, [1.0, 0.0, 0.6])
    placed = place_scan(scan, Trajectory(np.array([0]), climbed[None]), T_BASE_SENSOR, base_height_m=0.0)
    found = label_scan(scan, placed, METHOD, 3)
    assert share(found.label, truth, Label.FLOOR)[1] > 0.97
    np.testing.assert_allclose(placed.to_map(placed.points_level)[truth == Label.FLOOR, 2], 0.6, atol=0.1)
    features = extract(0, placed, found)
    np.testing.assert_allclose(features.floor_map[0] @ [1.0, 1.0, 0.0], 0.6, atol=0.02)


def test_a_duct_below_the_ceiling_is_no_ceiling_of_its_own_and_a_lower_room_has_one() -> None:
    generator = np.random.default_rng(3)
    floor = HorizontalPlane(0.0, np.zeros(2), 0)

    def returns(count: int, low: tuple[float, float], high: tuple[float, float], height_m: float) -> np.ndarray:
        return np.column_stack([generator.uniform(low, high, (count, 2)), generator.normal(height_m, 0.005, count)])

    ceiling = returns(12_000, (-3, -3), (3, 3), 2.8)
    duct = returns(4_000, (-3, 1.0), (3, 1.4), 2.45)
    lower = returns(4_000, (3, -3), (5, 1), 2.45)
    with_duct = find_ceilings(np.concatenate([ceiling, duct]).astype(np.float32), floor, METHOD.rearrangement, 0)
    assert [round(c.height_m, 1) for c in with_duct] == [2.8]
    with_room = find_ceilings(np.concatenate([ceiling, lower]).astype(np.float32), floor, METHOD.rearrangement, 0)
    assert sorted(round(c.height_m, 2) for c in with_room) == [2.45, 2.8]
