"""The building of an analytic corridor's scans: walls, one door or window, final labels, grid."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.trajectory import PlacedScan
from ffmap.algorithms.building.door_frames import measure_reveals, place_frames
from ffmap.algorithms.building.drive import Drive
from ffmap.algorithms.building.evidence import RECESS, first_columns
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.face_fusion import fuse_walls
from ffmap.algorithms.building.final_labels import BuildingModel, Relabelling, RelabellingSettings
from ffmap.algorithms.building.model import (
    NO_DOORS,
    BuildingSettings,
    Doors,
    Walls,
    Windows,
    unknown_support,
)
from ffmap.algorithms.building.settle import (
    Opening,
    doors_of,
    find_openings,
    windows_of,
)
from ffmap.algorithms.building.thickness import WallThicknessSettings, door_depths, part_walls
from ffmap.algorithms.maps.furniture_free import Immobile
from ffmap.algorithms.maps.grid import Cell, GridMapSettings
from ffmap.algorithms.scan.ceiling import below_ceiling
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.labelling import ScanLabelling
from ffmap.algorithms.scan.summary import Features, concatenate, extract
from tests.corridor import HEIGHT_M, Hole, labelled, share
from tests.drawing import draw_furniture_free
from tests.faces import NO_BLINDS, NO_JUDGED_FACES, parsed
from tests.tracing import traced_by

SETTINGS = BuildingSettings()


def openings_of(walls: Walls, features: Features) -> list[Opening]:
    """What is open in the faces, below a ceiling over all of the corridor."""
    found = parsed(walls, features, ceiling_m=HEIGHT_M)
    return find_openings(found, lambda within: traced_by(within, features, at_ends=True))


def seen(hole: Hole | None) -> tuple[list[tuple], Features]:
    """Thirty scans along the corridor, and their features."""
    places = enumerate(np.linspace(-1.0, 1.5, 30))
    scans = [labelled(hole, seed=i, x=x)[1:] for i, x in places]
    parts = [extract(i, placed, found) for i, (placed, _, found) in enumerate(scans)]
    return scans, concatenate(parts)


def relabelled(
    placed: PlacedScan, found: ScanLabelling, walls: Walls, doors: Doors, windows: Windows
) -> tuple[np.ndarray, np.ndarray]:
    """A scan's points in the map, and their final labels."""
    points = placed.to_map(placed.points_level).astype(np.float32)
    origin = placed.to_map(placed.origin_level[None])[0]
    first = first_columns(walls)
    count = first[-1]
    before = Foreground(
        first, np.full(count, HEIGHT_M), np.zeros(count), np.zeros((count, 60), bool)
    )
    model = BuildingModel(walls, before, NO_JUDGED_FACES, doors, windows, NO_BLINDS, ())
    relabelling = Relabelling.of(model, RelabellingSettings())
    below_m = below_ceiling(placed.points_level, found.ceiling_planes)
    labels = relabelling.labels(points, found.height_m, below_m, found.label, origin)
    return points, labels.label


@pytest.mark.parametrize(
    ("hole", "doors", "windows"),
    [
        (Hole(depth=None, pane=0.02), 0, 1),
        (Hole(depth=None, foot=0.9), 0, 1),
        (None, 0, 0),
    ],
    ids=["pane to the floor", "open window", "bare wall"],
)
def test_windows_are_distinguished_from_open_doors(
    hole: Hole | None, doors: int, windows: int
) -> None:
    scans, features = seen(hole)
    walls = fuse_walls(features, SETTINGS)
    openings = openings_of(walls, features)
    found_doors = doors_of(openings, SETTINGS)
    assert len(found_doors) == doors
    found = windows_of(openings)
    assert len(found) == windows
    if hole is not None:
        np.testing.assert_allclose(np.sort(found.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.12)
        np.testing.assert_allclose(found.ends[0, :, 1], 2.0, atol=0.02)
        placed, _, labelling = scans[14]
        points, final = relabelled(placed, labelling, walls, found_doors, found)
        assert np.mean(final[points[:, 1] > 2.5] == Label.OUTSIDE) > 0.99
        assert not np.any(final[points[:, 1] < 2.09] == Label.OUTSIDE)  # the pane is at 2.1


@pytest.mark.parametrize("depth", [0.05, None])
def test_the_building_has_its_walls_and_its_door(depth: float | None) -> None:
    hole = Hole(depth=depth)
    scans, features = seen(hole)
    walls = fuse_walls(features, SETTINGS)
    feet = np.round(walls.normal * np.sum(walls.normal * walls.ends[:, 0], axis=1)[:, None], 1)
    assert {(0.0, 2.0), (0.0, -1.5)} <= set(map(tuple, feet + 0.0))
    openings = openings_of(walls, features)
    doors = doors_of(openings, SETTINGS)
    assert doors.state.tolist() == [DoorState.OPEN if depth is None else DoorState.CLOSED]
    np.testing.assert_allclose(doors.ends[0].mean(axis=0), [-0.05, 2.0], atol=0.1)
    exact = place_frames(doors, walls, [features], SETTINGS)
    np.testing.assert_allclose(np.sort(exact.ends[0, :, 0]), [hole.x0, hole.x1], atol=0.02)
    np.testing.assert_allclose(exact.ends[0, :, 1], doors.ends[0, :, 1], atol=0.01)
    assert exact.head_m[0] == pytest.approx(2.1, abs=0.02)
    # However wrong the head was before.
    far_off = replace(doors, head_m=np.array([2.4]))
    placed = place_frames(far_off, walls, [features], SETTINGS)
    assert placed.head_m[0] == exact.head_m[0]
    # Evidence of a recessed door does not apply to one that is flush with its wall, or before it.
    for depth_m in (0.0, -0.05):
        back = np.array([0.0, depth_m])
        closed = replace(doors, depth_m=np.array([depth_m]), ends=doors.ends - back)
        behind = replace(walls, ends=walls.ends - back)
        kept = place_frames(closed, behind, [features], SETTINGS)
        np.testing.assert_array_equal(kept.ends, closed.ends)
        assert kept.head_m[0] == doors.head_m[0]
        assert kept.scan_count[0] > 0
    # The wall has no thickness here: its lintel's underside is the edge's scatter.
    assert measure_reveals(doors, [features]).reveal_m[0] < 0.1
    windows = windows_of(openings)
    assert len(windows) == 0
    if depth is not None:
        placed, truth, found = scans[14]
        _, final = relabelled(placed, found, walls, doors, windows)
        assert min(share(final, truth, Label.DOOR)) > 0.9

    thickness = WallThicknessSettings()
    parts = part_walls(walls, thickness)
    depth_m = door_depths(doors, walls, parts, thickness, SETTINGS.reveal_m, doors.reveal_m)
    doors = replace(doors, reveal_m=depth_m)
    drive = Drive(np.array([[-1.0, 0.0], [1.5, 0.0]]), lambda: [features])
    stretches = parsed(walls, features, ceiling_m=HEIGHT_M).stretches
    immobile = Immobile(walls, stretches, doors, windows)
    grid = draw_furniture_free(immobile, drive, GridMapSettings(), thickness, SETTINGS.knee_m)

    def at(x: float, y: float) -> int:
        column, row = np.floor((np.array([x, y]) - grid.origin) / grid.cell_m).astype(int)
        return int(grid.cells[row, column])

    assert at(-0.05, 2.0) == Cell.FREE  # through the door, even a closed one
    assert Cell.OCCUPIED in {at(0.9, 1.97), at(0.9, 2.02)}
    assert at(0.5, 0.5) == Cell.FREE
    assert at(1.5, 2.4) == Cell.UNKNOWN


def test_the_underside_of_a_lintel_shows_the_depth_of_a_reveal() -> None:
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
    rays = np.concatenate([underside, leaf]).astype(np.float32)
    features = of_rays(rays)
    assert measure_reveals(door, [features]).reveal_m[0] == pytest.approx(0.18, abs=0.025)


def of_rays(rays: np.ndarray, **planes: np.ndarray) -> Features:
    """A scan's features with other rays, on a level floor, and other planes where given."""
    _, placed, _, found = labelled()
    return replace(
        extract(0, placed, found),
        floor_map=np.zeros((1, 2, 3)),
        floor_is_foot=np.zeros(1, bool),
        floor_reach_m=np.full(1, 6.0),
        ray_count=np.array([len(rays)]),
        ray_end_map=rays,
        ray_label=np.zeros(len(rays), np.uint8),
        **planes,
    )


@pytest.mark.parametrize(("lean_deg", "is_own"), [(0.8, True), (4.0, False)])
def test_a_scans_own_plane_is_used_only_where_the_scan_saw_it(
    lean_deg: float, is_own: bool
) -> None:
    """The scan's plane of the first 2 m of a face leans: its own, or that of a leaf ajar."""
    lean = np.radians(lean_deg)
    x = np.linspace(0.1, 5.9, 59)
    features = of_rays(
        np.column_stack([x, np.full(59, 2.0), np.full(59, 1.0)]).astype(np.float32),
        origin_map=np.array([[3.0, 0.0, 1.0]]),
        plane_count=np.array([1]),
        plane_ends_map=np.array([[[0.0, 2.0], [2 * np.cos(lean), 2 + 2 * np.sin(lean)]]]),
        plane_normal=np.array([[np.sin(lean), -np.cos(lean)]]),
        plane_moments=np.zeros((1, 6)),
        plane_bottom_m=np.zeros(1),
        plane_top_m=np.full(1, 2.8),
        plane_lines=np.ones(1, np.int32),
    )
    ends, normal = np.array([[[0.0, 2.0], [6.0, 2.0]]]), np.array([[0.0, -1.0]])
    ones = np.ones(1, np.int32)
    wall = Walls(
        ends,
        normal,
        np.zeros(1),
        np.full(1, 2.8),
        ones,
        np.zeros(1),
        900 * ones,
        unknown_support(1),
    )
    evidence = traced_by(wall, features)
    filled = evidence.ended[..., : RECESS + 1].sum(axis=(1, 2))
    total = evidence.depth_sum[..., : RECESS + 1].sum(axis=(1, 2))
    mean_m = np.divide(total, filled, out=np.zeros_like(total), where=filled > 0)
    assert filled[50:].sum() > 30
    np.testing.assert_allclose(mean_m[50:], 0.0, atol=1e-6)
    assert filled[:40].sum() > 15
    np.testing.assert_allclose(mean_m[:40].max(), 2 * np.sin(lean) if is_own else 0.0, atol=0.004)
