"""The method on an analytic room: known walls, floor, ceiling, a recessed door, under noise and rigid motion."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import in_canonical_order
from ffmap.algorithms.base.trajectory import PlacedScan, Trajectory, place_scan
from ffmap.algorithms.building.door_frames import DoorFramesSettings, measure_reveals, place_frames
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling, RelabellingSettings
from ffmap.algorithms.building.halo import HaloSettings, find_halo
from ffmap.algorithms.building.model import CELL_M, NO_BLINDS, NO_DOORS, BuildingSettings, Doors, Walls, Windows
from ffmap.algorithms.building.openings import OpeningRules, OpeningsSettings
from ffmap.algorithms.building.ray_evidence import WallCells, trace_rays
from ffmap.algorithms.building.thickness import WallThicknessSettings, door_depths, part_walls
from ffmap.algorithms.building.votes import VoxelTable
from ffmap.algorithms.building.windows import WindowsSettings, find_windows
from ffmap.algorithms.maps.furniture_free import Immobile, both_sides
from ffmap.algorithms.maps.grid import Cell, GridMapSettings
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling, label_scan
from ffmap.algorithms.scan.summary import concatenate, extract
from tests import synthetic
from tests.corridor import HEIGHT_M, METHOD, T_BASE_SENSOR, Hole, cast, labelled, place, pose, share
from tests.drawing import draw_furniture_free
from tests.faces import doors_in, faces, traced
from tests.voting import vote

KNEE_M = BuildingSettings().knee_m


def relabelled(
    placed: PlacedScan, found: ScanLabelling, walls: Walls, doors: Doors, windows: Windows
) -> tuple[np.ndarray, np.ndarray]:
    """A scan's points in the map, and their final labels."""
    points = placed.to_map(placed.points_level).astype(np.float32)
    halo = find_halo(vote(points, found.label, len(Label), 0.05), HaloSettings(ratio=6.0))
    origin = placed.to_map(placed.origin_level[None])[0]
    columns = np.ceil(np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1) / CELL_M)
    first = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
    before = Foreground(first, np.full(first[-1], HEIGHT_M), np.zeros(first[-1]), np.zeros((first[-1], 60), bool))
    relabelling = Relabelling.of(
        BuildingModel(walls, before, NO_JUDGED_FACES, doors, windows, NO_BLINDS, ()), halo, RelabellingSettings()
    )
    below_m = below_ceiling(placed.points_level, found.ceiling_planes)
    return points, relabelling.labels(points, found.height_m, below_m, found.label, origin).label


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


@pytest.mark.parametrize("timed", [True, False])
def test_labels_do_not_depend_on_the_order_of_returns(timed: bool) -> None:
    """A scan as large as a real one, its returns, rings and times shuffled alike: to the bit the same, return by return."""
    scan = replace(synthetic.scan(), time_ns=np.arange(32 * 2170) * 1_440 if timed else None)
    shuffle = np.random.default_rng(3).permutation(len(scan))
    shuffled = replace(
        scan,
        points_sensor=scan.points_sensor[shuffle],
        ring=scan.ring[shuffle],
        time_ns=None if scan.time_ns is None else scan.time_ns[shuffle],
        cloud_index=scan.cloud_index[shuffle],
    )
    found = []
    for ordered in (in_canonical_order(scan), in_canonical_order(shuffled)):
        level = synthetic.level(ordered, synthetic.trajectory(3))
        labelling = label_scan(ordered, level.placed, METHOD, 1)
        by_cloud = np.argsort(ordered.cloud_index)
        features = extract(0, level.placed, labelling)
        found.append(
            (labelling.label[by_cloud], labelling.plane[by_cloud], labelling.height_m[by_cloud], features.ray_end_map)
        )
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


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
        floor_map=np.zeros((1, 2, 3)),
        floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0),
        ray_count=np.array([len(rays)]),
        ray_end_map=rays,
        ray_label=np.zeros(len(rays), np.uint8),
    )
    assert measure_reveals(door, [features], DoorFramesSettings()).reveal_m[0] == pytest.approx(0.18, abs=0.025)


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
    rules = OpeningRules(settings, OpeningsSettings())
    assert len(doors_in(traced(walls, cells), rules)) == doors
    found = find_windows(traced(walls, cells), rules, WindowsSettings())
    assert len(found) == windows
    if hole is not None and windows:
        np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.12)
        np.testing.assert_allclose(found.ends[0, :, 1], 2.0, atol=0.02)
        # What lies beyond is outside.
        _, placed, _, labelling = scans[14][1:]
        doors = doors_in(traced(walls, cells), rules)
        points, final = relabelled(placed, labelling, walls, doors, found)
        assert np.mean(final[points[:, 1] > 2.5] == Label.OUTSIDE) > 0.99
        assert not np.any(final[points[:, 1] < 2.1] == Label.OUTSIDE)


def test_slits_beside_a_mullion_that_returns_more_are_no_window() -> None:
    walls = faces(((0.0, 0.0), (3.0, 0.0)))
    counts = np.zeros((60, 66, 4), np.float32)
    counts[:, :, 0] = 10.0
    # Two slits with a mullion between them that returns more rays than both let through.
    counts[19:31, 20:40, 0], counts[19:31, 20:40, 3] = 0.0, 20.0
    counts[24:26, 20:40, 0], counts[24:26, 20:40, 3] = 1000.0, 0.0
    cells = WallCells(np.array([0, 60]), 66, counts)
    rules = OpeningRules(BuildingSettings(), OpeningsSettings())
    assert len(find_windows(traced(walls, cells), rules, WindowsSettings())) == 0


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
    rules = OpeningRules(settings, OpeningsSettings())
    doors = doors_in(traced(walls, cells), rules)
    assert len(doors) == 1
    assert doors.state[0] == (DoorState.OPEN if depth is None else DoorState.CLOSED)
    np.testing.assert_allclose(doors.ends[0].mean(axis=0), [-0.05, 2.0], atol=0.1)
    assert np.linalg.norm(doors.ends[0, 1] - doors.ends[0, 0]) == pytest.approx(0.9, abs=0.15)
    assert doors.head_m[0] == pytest.approx(2.1, abs=0.04)
    exact = place_frames(doors, walls, [features], settings, DoorFramesSettings())
    np.testing.assert_allclose(np.sort(exact.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.02)
    np.testing.assert_allclose(exact.ends[0, :, 1], doors.ends[0, :, 1], atol=0.01)
    assert exact.head_m[0] == pytest.approx(2.1, abs=0.02)
    # However wrong the head was before.
    far_off = place_frames(replace(doors, head_m=np.array([2.4])), walls, [features], settings, DoorFramesSettings())
    assert far_off.head_m[0] == exact.head_m[0]
    # What tells of a recessed leaf tells nothing of one that is flush, or hangs before its wall: here that of a face farther back.
    for depth_m in (0.0, -0.05):
        back = np.array([0.0, depth_m])
        closed = replace(doors, depth_m=np.array([depth_m]), ends=doors.ends - back)
        behind = replace(walls, ends=walls.ends - back)
        kept = place_frames(closed, behind, [features], settings, DoorFramesSettings())
        np.testing.assert_array_equal(kept.ends, closed.ends)
        assert kept.head_m[0] == doors.head_m[0]
        assert kept.scan_count[0] > 0
    # The wall has no thickness here: its lintel's underside is but the edge's scatter.
    assert measure_reveals(doors, [features], DoorFramesSettings()).reveal_m[0] < 0.1
    windows = find_windows(traced(walls, cells), rules, WindowsSettings())
    assert len(windows) == 0

    if depth is not None:
        _, _, placed, truth, found = scans[14]
        _, final = relabelled(placed, found, walls, doors, windows)
        precision, recall = share(final, truth, Label.DOOR)
        assert precision > 0.9
        assert recall > 0.9

    thickness = WallThicknessSettings()
    depth_m = door_depths(doors, walls, part_walls(walls, thickness), thickness, settings.reveal_m, doors.reveal_m)
    doors = replace(doors, reveal_m=depth_m)
    drive = Drive(np.array([[-1.0, 0.0], [1.5, 0.0]]), lambda: [features])
    of_both = trace_rays(both_sides(walls), [features], BuildingSettings())
    immobile = Immobile(walls, of_both, VoxelTable(0.05, len(Label)).votes(), doors, windows)
    grid = draw_furniture_free(immobile, drive, GridMapSettings(), thickness, KNEE_M)

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
        floor_map=np.zeros((1, 2, 3)),
        floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0),
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
