"""What the building changes in a scan's labels: one wall along y = 0, looked at from y < 0, one return at a time."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import index_near
from ffmap.algorithms.building import final_labels
from ffmap.algorithms.building.face_foreground import NO_FOREGROUND, Foreground
from ffmap.algorithms.building.face_verdicts import NO_JUDGED_FACES, FaceVerdict, JudgedFaces
from ffmap.algorithms.building.final_labels import (
    BuildingModel,
    Relabelled,
    Relabelling,
    RelabellingSettings,
)
from ffmap.algorithms.building.halo import HaloSettings, find_halo
from ffmap.algorithms.building.heights import HeightMap, Surface
from ffmap.algorithms.building.label_reasons import REASONS, SURFACE_REASONS, Reason
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_BLINDS,
    NO_DOORS,
    NO_MULLIONS,
    NO_WALLS,
    NO_WINDOWS,
    Blinds,
    Doors,
    Mullions,
    Walls,
    Windows,
)
from ffmap.algorithms.scan.doors import DoorState
from tests.voting import vote

SETTINGS = RelabellingSettings()
SENSOR = np.array([2.0, -2.0, 1.0])
NO_HALO = find_halo(vote(np.zeros((0, 3)), np.zeros(0, np.uint8), len(Label), 0.05), HaloSettings())


def face(x0: float = 0.0, x1: float = 4.0, y: float = 0.0, top_m: float = 2.8) -> Walls:
    """A face towards the sensor."""
    return Walls(
        np.array([[[x0, y], [x1, y]]]),
        np.array([[0.0, -1.0]]),
        np.zeros(1),
        np.array([top_m]),
        np.array([9], np.int32),
        np.array([0.01]),
        np.array([900]),
    )


def door(depth_m: float) -> Doors:
    """Between x = 1 and x = 2, its head at 2.1 m, its reveals 0.2 m deep; open where the depth is NaN."""
    state = DoorState.OPEN if np.isnan(depth_m) else DoorState.CLOSED
    return replace(
        NO_DOORS,
        ends=np.array([[[1.0, 0.0], [2.0, 0.0]]]),
        normal=np.array([[0.0, -1.0]]),
        head_m=np.array([2.1]),
        depth_m=np.array([depth_m]),
        state=np.array([state], np.uint8),
        reveal_m=np.array([0.2]),
    )


def window(pane_m: float) -> Windows:
    return Windows(
        np.array([[[1.0, 0.0], [3.0, 0.0]]]),
        np.array([[0.0, -1.0]]),
        np.array([0.9]),
        np.array([2.0]),
        np.array([pane_m]),
    )


def before(walls: Walls, ceiling_m: float = 2.8, covered: bool | tuple[bool, ...] = False) -> Foreground:
    """A room of one height before all faces, in which something or nothing stands against all, or each, of them."""
    length_m = np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1)
    first = np.concatenate([[0], np.cumsum(np.ceil(length_m / CELL_M))]).astype(np.int64)
    stands = np.repeat(np.broadcast_to(covered, len(walls)), np.diff(first))
    return Foreground(first, np.full(first[-1], ceiling_m), np.zeros(first[-1]), np.tile(stands[:, None], 60))


def final(point: tuple[float, float, float], label: Label, **building: Any) -> Label:
    """The final label of one return, see `final_of`."""
    return Label(int(final_of(np.array([point], np.float32), np.array([label], np.uint8), **building)[0]))


def final_of(points: np.ndarray, label: np.ndarray, **building: Any) -> np.ndarray:
    """The final labels of returns (n, 3), see `relabelled`."""
    return relabelled(points, label, **building).label


def relabelled(
    points: np.ndarray,
    label: np.ndarray,
    walls: Walls = NO_WALLS,
    refused: Walls = NO_WALLS,
    doors: Doors = NO_DOORS,
    windows: Windows = NO_WINDOWS,
    blinds: Blinds = NO_BLINDS,
    sensor: np.ndarray = SENSOR,
    ceiling_m: float = 2.8,
    covered: bool | tuple[bool, ...] = False,
    verdict: FaceVerdict = FaceVerdict.ENDS_LOW,
    levels: tuple[HeightMap, ...] = (),
    leaf_panes: Windows = NO_WINDOWS,
    mullions: Mullions = NO_MULLIONS,
) -> Relabelled:
    """What becomes of returns (n, 3); the scan's ceiling hangs at 2.8 m, that before the walls at `ceiling_m`."""
    height_m = points[:, 2].astype(np.float64)
    return Relabelling.of(
        BuildingModel(
            walls,
            before(walls, ceiling_m, covered),
            JudgedFaces(walls, refused, np.full(len(refused), verdict, np.uint8)),
            doors,
            windows,
            blinds,
            levels,
            leaf_panes,
            mullions,
        ),
        NO_HALO,
        SETTINGS,
    ).labels(points, height_m, 2.8 - height_m, label, sensor)


@pytest.mark.parametrize(
    ("y", "scan_label", "expected"),
    [
        (-0.02, Label.CLUTTER, Label.WALL),  # on the face
        (-0.10, Label.CLUTTER, Label.CLUTTER),  # before it stands furniture
        (0.06, Label.CLUTTER, Label.WALL),  # behind it is the wall's body: scatter
        (0.15, Label.CLUTTER, Label.CLUTTER),  # beyond that, another thing
        (-0.15, Label.WALL, Label.WALL),  # what the scan took for wall stays near a face
        (-0.40, Label.WALL, Label.CLUTTER),  # but not far from all
    ],
)
def test_a_return_by_its_distance_to_a_face(y: float, scan_label: Label, expected: Label) -> None:
    assert final((2.0, y, 1.0), scan_label, walls=face()) == expected


@pytest.mark.parametrize(("ceiling_m", "expected"), [(2.8, Label.WALL), (1.9, Label.CLUTTER), (float("nan"), Label.CLUTTER)])
def test_a_wall_goes_up_to_the_ceiling_before_it(ceiling_m: float, expected: Label) -> None:
    """Of a wall below a slope most is seen no higher than where the slope is low."""
    assert final((2.0, -0.02, 2.4), Label.CLUTTER, walls=face(top_m=2.0), ceiling_m=ceiling_m) == expected


def test_only_the_sensors_side_of_a_face_has_a_body_behind_it() -> None:
    other_side = np.array([2.0, 2.0, 1.0])
    assert final((2.0, 0.06, 1.0), Label.CLUTTER, walls=face(), sensor=other_side) == Label.CLUTTER


def test_an_open_doorway_is_no_body_of_its_wall() -> None:
    point = (1.5, 0.05, 1.0)
    assert final(point, Label.CLUTTER, walls=face()) == Label.WALL
    assert final(point, Label.CLUTTER, walls=face(), doors=door(np.nan)) == Label.CLUTTER


def test_what_a_scan_called_wall_on_a_refused_face_is_clutter() -> None:
    leaf = face(1.0, 1.9, -0.12, top_m=2.05)
    assert final((1.5, -0.12, 1.0), Label.WALL, walls=face()) == Label.WALL
    assert final((1.5, -0.12, 1.0), Label.WALL, walls=face(), refused=leaf) == Label.CLUTTER
    assert (
        final((1.5, -0.12, 1.0), Label.WALL, walls=face(), refused=leaf, verdict=FaceVerdict.OUTSIDE) == Label.OUTSIDE
    )
    # The wall above the leaf, and the wall behind it, stay.
    assert final((1.5, -0.12, 2.5), Label.WALL, walls=face(), refused=leaf) == Label.WALL
    assert final((1.5, -0.02, 1.0), Label.WALL, walls=face(), refused=leaf) == Label.WALL


@pytest.mark.parametrize("scan_label", [Label.CLUTTER, Label.WALL, Label.DOOR])
def test_between_the_jambs_of_a_closed_door_all_is_its_leaf(scan_label: Label) -> None:
    def label_at(x: float, y: float, z: float) -> Label:
        return final((x, y, z), scan_label, walls=face(), doors=door(0.04))

    assert label_at(1.5, 0.04, 1.0) == Label.DOOR
    assert label_at(1.5, 0.0, 1.0) == Label.DOOR  # its handle
    assert label_at(1.5, 0.12, 1.0) == Label.DOOR  # its scatter
    assert label_at(1.5, 0.02, 2.3) == Label.WALL  # the lintel
    assert label_at(0.9, 0.02, 1.0) == Label.WALL  # beside the jamb


@pytest.mark.parametrize("scan_label", [Label.CLUTTER, Label.WALL, Label.DOOR])
@pytest.mark.parametrize("sensor_x", [1.5, -1.0])
def test_a_leaf_may_hang_before_its_wall(scan_label: Label, sensor_x: float) -> None:
    def label_at(x: float, y: float, z: float) -> Label:
        sensor = np.array([sensor_x, -3.0, 1.0])
        return final((x, y, z), scan_label, walls=face(), doors=door(-0.06), sensor=sensor)

    assert label_at(1.97, -0.06, 1.0) == Label.DOOR
    assert label_at(1.5, -0.09, 1.0) == Label.DOOR  # its scatter
    assert label_at(1.5, 0.02, 1.0) == Label.DOOR
    assert label_at(1.5, -0.01, 2.3) == Label.WALL  # above its head
    assert label_at(0.9, -0.01, 1.0) == Label.WALL  # beside it
    assert label_at(1.5, 0.06, 1.0) == (Label.WALL if scan_label == Label.WALL else Label.CLUTTER)  # no open doorway
    if scan_label == Label.CLUTTER:
        assert label_at(1.5, -0.15, 1.0) == Label.CLUTTER


def test_the_foot_of_a_leaf_before_its_wall_is_the_doors() -> None:
    ends_on_leaf, ends_on_floor = (1.5, -0.06, 0.02), (1.5, -0.10, 0.0)
    assert final(ends_on_leaf, Label.FLOOR, walls=face(), doors=door(-0.06)) == Label.DOOR
    assert final(ends_on_floor, Label.FLOOR, walls=face(), doors=door(-0.06)) == Label.FLOOR


def test_along_the_frame_of_a_closed_door_the_leaf_is_where_the_ray_would_meet_it() -> None:
    def label_at(x: float, y: float, z: float) -> Label:
        return final((x, y, z), Label.DOOR, walls=face(), doors=door(0.04))

    # Rising at 45 degrees: the lintel's underside, measured a centimetre too low, and the leaf's upper edge.
    low = np.array([1.5, -1.08, 1.0])
    assert final((1.5, 0.01, 2.09), Label.DOOR, walls=face(), doors=door(0.04), sensor=low) == Label.WALL
    assert (
        final((1.5, 0.05, 2.09), Label.DOOR, walls=face(), doors=door(0.04), sensor=np.array([1.5, -3.0, 1.9]))
        == Label.DOOR
    )
    # At a slant, the reveal within the frame.
    aside = np.array([0.0, -1.0, 1.0])
    assert final((1.99, 0.01, 1.0), Label.DOOR, walls=face(), doors=door(0.04), sensor=aside) == Label.WALL
    # Past the near jamb by a centimetre, the wall beside it.
    assert final((1.0, 0.01, 1.0), Label.WALL, walls=face(), doors=door(0.04), sensor=aside) == Label.WALL
    assert label_at(1.97, 0.04, 1.0) == Label.DOOR


def test_door_without_a_door_of_the_building_is_wall_or_clutter() -> None:
    assert final((3.0, 0.03, 1.0), Label.DOOR, walls=face()) == Label.WALL
    assert final((3.0, -0.3, 1.0), Label.DOOR, walls=face()) == Label.CLUTTER


@pytest.mark.parametrize(("glass", "expected"), [("windows", Label.WALL), ("leaf_panes", Label.CLUTTER)])
def test_around_the_pane_of_an_open_leaf_is_no_wall(glass: str, expected: Label) -> None:
    """A pane that stands alone in a room is a glazed front, with its frame; behind either one sees through glass."""
    pane = Windows(np.array([[[2.0, -0.8], [2.0, -0.2]]]), np.array([[1.0, 0.0]]), np.array([0.9]), np.array([2.0]), np.zeros(1))
    beside = replace(pane, ends=pane.ends - [0.0, 1.5])
    seen: dict[str, Any] = {"walls": face(), "windows": beside, "sensor": np.array([3.8, -0.6, 1.0])}
    seen[glass] = pane if glass == "leaf_panes" else beside.append(pane)
    assert final((2.02, -2.0, 0.5), Label.CLUTTER, **seen) == Label.WALL
    assert final((2.02, -0.5, 0.5), Label.CLUTTER, **seen) == expected
    assert final((1.5, -0.5, 0.5), Label.CLUTTER, **seen) == Label.OUTSIDE


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((2.0, -0.07, 1.5), Label.WALL),
        ((2.5, -0.07, 1.5), Label.CLUTTER),  # beside it
        ((2.0, -0.07, 0.05), Label.CLUTTER),  # below it
        ((2.0, -0.20, 1.5), Label.CLUTTER),  # before it
    ],
)
def test_a_mullion_before_its_pane_is_wall(point: tuple[float, float, float], expected: Label) -> None:
    front = Windows(np.array([[[1.0, 0.0], [2.9, 0.0]]]), np.array([[0.0, -1.0]]), np.array([0.1]), np.array([2.7]), np.zeros(1))
    mullion = Mullions(np.array([[[1.95, 0.0], [2.05, 0.0]]]), front.normal, front.bottom_m, front.top_m, np.array([0.08]))
    assert final(point, Label.CLUTTER, walls=face(), windows=front, mullions=mullion, covered=True) == expected


def test_what_is_seen_past_a_mullion_is_seen_through_its_panes() -> None:
    """They end at it; the wall beside them that a ray comes to past a mullion stays."""
    ends = np.array([[[1.0, 0.0], [1.9, 0.0]], [[2.1, 0.0], [2.4, 0.0]]])
    both, one = np.repeat(np.array([[0.0, -1.0]]), 2, axis=0), np.ones(2)
    front = Windows(ends, both, 0.1 * one, 2.7 * one, 0.0 * one)
    mullion = Mullions(np.array([[[1.95, 0.0], [2.05, 0.0]]]), both[:1], np.array([0.1]), np.array([2.7]), np.array([0.15]))
    seen: dict[str, Any] = {"walls": face(), "windows": front, "sensor": np.array([0.0, -2.0, 1.0])}
    assert final((4.0, 2.0, 1.0), Label.WALL, **seen) == Label.CLUTTER
    assert final((4.0, 2.0, 1.0), Label.WALL, mullions=mullion, **seen) == Label.OUTSIDE
    assert final((2.6, 0.01, 1.0), Label.WALL, mullions=mullion, **seen) == Label.WALL


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((1.03, 0.15, 1.0), Label.WALL),  # a jamb's reveal
        ((1.03, 0.19, 1.0), Label.CLUTTER),  # the hinge of its leaf
        ((1.005, 0.19, 1.0), Label.WALL),
        ((1.5, 0.15, 2.08), Label.WALL),  # the lintel's underside
        ((1.5, 0.15, 1.0), Label.CLUTTER),  # somebody in the doorway
        ((0.98, 0.22, 1.0), Label.WALL),  # beside the frame, the scatter of the wall's other face
        ((1.005, 0.22, 1.0), Label.CLUTTER),
        ((1.03, 0.4, 1.0), Label.CLUTTER),  # deeper than the wall is thick
    ],
)
def test_reveals_of_an_open_door(point: tuple[float, float, float], expected: Label) -> None:
    assert final(point, Label.CLUTTER, walls=face(), doors=door(np.nan)) == expected


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((2.0, 0.2, 2.2), Label.CLUTTER),  # on the blind, which outweighs that the pane may stand before it
        ((2.0, 0.0, 2.2), Label.CLUTTER),  # in the wall's face: between that and the blind there is nothing
        ((2.0, 0.0, 2.6), Label.WALL),  # above it
        ((2.0, 0.1, 1.9), Label.WALL),  # below it
        ((3.5, 0.0, 2.2), Label.WALL),  # beside it
        ((2.0, 0.3, 2.2), Label.OUTSIDE),  # behind it
    ],
)
@pytest.mark.parametrize("scan_label", [Label.WALL, Label.CLUTTER])
def test_what_hangs_in_a_window_is_clutter(point: tuple[float, float, float], expected: Label, scan_label: Label) -> None:
    ends, normal = np.array([[[1.0, 0.0], [3.0, 0.0]]]), np.array([[0.0, -1.0]])
    blind = Blinds(ends, normal, *(np.array([value]) for value in (2.0, 2.5, 0.2, np.nan)))
    found = relabelled(
        np.array([point], np.float32), np.array([scan_label], np.uint8), walls=face(), windows=window(np.nan), blinds=blind
    )
    assert found.label[0] == expected
    assert (found.reason[0] == Reason.ON_BLIND) == (expected == Label.CLUTTER != scan_label)


@pytest.mark.parametrize(
    ("pane_m", "y", "expected"),
    [
        (0.05, 0.04, Label.WALL),  # on the pane: what stands before it is sill and reveal
        (0.05, 0.15, Label.OUTSIDE),
        (np.nan, 0.10, Label.WALL),  # a pane that returned nothing may stand anywhere in its wall
        (np.nan, 0.30, Label.OUTSIDE),
    ],
)
def test_beyond_a_windows_pane_is_outside(pane_m: float, y: float, expected: Label) -> None:
    found = final((2.0, y, 1.2), Label.CLUTTER, walls=face(), windows=window(pane_m))
    assert found == expected


def test_outside_is_what_the_ray_crossed_the_window_for() -> None:
    behind = (2.0, 3.0, 1.2)
    assert final(behind, Label.WALL, windows=window(0.05)) == Label.OUTSIDE
    # The same place seen past the window's end, and from within the room behind, is not.
    assert final(behind, Label.WALL, windows=window(0.05), sensor=np.array([9.0, -1.0, 1.0])) != Label.OUTSIDE
    assert (
        final(behind, Label.WALL, walls=face(y=3.0), windows=window(0.05), sensor=np.array([2.0, 1.0, 1.0]))
        == Label.WALL
    )


@pytest.mark.parametrize("range_error_m", [-0.03, 0.0, 0.03])
@pytest.mark.parametrize("taken_for_wall", [False, True])
@pytest.mark.parametrize(
    ("height_m", "expected"), [(0.01, Label.WALL), (-0.01, Label.FLOOR), (2.79, Label.WALL), (2.81, Label.CEILING)]
)
def test_along_an_edge_the_surface_that_the_ray_meets_first_decides(
    taken_for_wall: bool, range_error_m: float, height_m: float, expected: Label
) -> None:
    # Where the ray crosses the wall's plane: above the floor and below the ceiling it ended there, whatever range it gave.
    crossing = np.array([2.0, 0.0, height_m])
    ray = (crossing - SENSOR) / np.linalg.norm(crossing - SENSOR)
    if expected in (Label.FLOOR, Label.CEILING):
        level_m = 0.0 if expected == Label.FLOOR else 2.8
        crossing = SENSOR + ray * (level_m - SENSOR[2]) / ray[2]
    x, y, z = crossing + ray * range_error_m
    level = Label.FLOOR if height_m < 1.0 else Label.CEILING
    assert final((x, y, z), Label.WALL if taken_for_wall else level, walls=face()) == expected


@pytest.mark.parametrize("off_m", [-0.015, 0.015])
@pytest.mark.parametrize("edge", [Label.FLOOR, Label.CEILING])
def test_along_an_edge_the_wall_stands_where_the_scan_itself_shows_it(off_m: float, edge: Label) -> None:
    """The pose is off by more than rays along the edge are told apart by; of the wall's foot and top one leans the other way."""
    generator = np.random.default_rng(0)
    level_m, inwards = (0.0, 1.0) if edge == Label.FLOOR else (2.8, -1.0)
    own = generator.uniform((1.0, off_m, 0.2), (3.0, off_m, 0.6), (60, 3))
    other = generator.uniform((1.0, -off_m, 2.2), (3.0, -off_m, 2.6), (60, 3))
    if edge == Label.CEILING:
        own[:, 1], other[:, 1] = -off_m, off_m
        own, other = other, own
    # Rays that meet the wall, where it is seen, half a centimetre off the edge, and those that meet the edge's other side.
    crossing = np.column_stack([np.linspace(1.2, 2.8, 40), np.full(40, off_m), np.full(40, level_m)])
    crossing[::2, 2] += inwards * 0.005
    crossing[1::2, 2] -= inwards * 0.005
    ray = crossing - SENSOR
    at_level = SENSOR + ray * ((level_m - SENSOR[2]) / ray[:, 2])[:, None]
    points = np.concatenate([own, other, np.where(np.arange(40)[:, None] % 2 == 0, crossing, at_level)]).astype(
        np.float32
    )
    label = np.concatenate([np.full(120, Label.WALL), np.full(40, edge)]).astype(np.uint8)
    found = final_of(points, label, walls=face())[120:]
    np.testing.assert_array_equal(found[::2], Label.WALL)
    np.testing.assert_array_equal(found[1::2], edge)


@pytest.mark.parametrize(
    ("before_m", "height_m", "expected"),
    [
        (0.3, 0.03, Label.FLOOR),  # straight down a return is off by as much as its range is
        (8.0, 0.03, Label.CLUTTER),  # a ray that comes in level would have ended a quarter of a metre off
        (8.0, 0.01, Label.FLOOR),
    ],
)
def test_what_is_higher_than_the_floor_scatters_is_a_foot(before_m: float, height_m: float, expected: Label) -> None:
    assert final((2.0, SENSOR[1] - before_m, height_m), Label.FLOOR) == expected


def test_the_floor_in_an_open_doorway_is_no_wall() -> None:
    assert final((2.0, -0.005, 0.02), Label.FLOOR, walls=face()) == Label.WALL
    assert final((1.5, -0.005, 0.02), Label.FLOOR, walls=face(), doors=door(np.nan)) == Label.FLOOR


def test_a_closed_leaf_stands_on_the_floor() -> None:
    assert final((1.5, 0.03, 0.03), Label.FLOOR, walls=face(), doors=door(0.04)) == Label.DOOR
    assert final((1.5, 0.01, -0.03), Label.FLOOR, walls=face(), doors=door(0.04)) == Label.FLOOR


@pytest.mark.parametrize(("top_m", "expected"), [(1.1, Label.CEILING), (2.8, Label.WALL)])
def test_the_ceiling_above_a_low_wall_is_no_edge_of_it(top_m: float, expected: Label) -> None:
    """A return of the ceiling, 3 cm before the wall's plane, whose ray meets the plane below the ceiling."""
    at = (2.0, 0.03, 2.78)
    assert final(at, Label.CEILING, walls=face(top_m=top_m), ceiling_m=top_m) == expected


def test_a_ceiling_that_hangs_lower_than_the_room_before_the_wall_is_another_rooms() -> None:
    at = (2.0, -0.02, 2.79)
    assert final(at, Label.CEILING, walls=face(top_m=3.2)) == Label.CEILING
    assert final(at, Label.CEILING, walls=face(top_m=3.2), ceiling_m=3.2) == Label.WALL


def test_no_wall_stands_in_an_open_door() -> None:
    # The face of a wall goes on over its doors; on it a leaf's edge hangs in the doorway.
    assert final((1.1, -0.01, 1.0), Label.WALL, walls=face()) == Label.WALL
    assert final((1.5, -0.01, 1.0), Label.WALL, walls=face(), doors=door(np.nan)) == Label.CLUTTER
    assert final((1.5, -0.01, 2.3), Label.WALL, walls=face(), doors=door(np.nan)) == Label.WALL


def test_what_stands_against_a_wall_is_clutter_though_a_scan_took_it_for_the_wall() -> None:
    assert final((2.0, -0.02, 1.0), Label.WALL, walls=face(), covered=True) == Label.CLUTTER
    assert final((2.0, -0.40, 1.0), Label.CLUTTER, walls=face(), covered=True) == Label.CLUTTER
    # A door's reveal stays.
    assert final((1.02, 0.01, 1.0), Label.WALL, walls=face(), doors=door(np.nan), covered=True) == Label.WALL


def test_labels_hold_under_rigid_motion() -> None:
    generator = np.random.default_rng(7)
    points = generator.uniform([0, -0.5, 0], [4, 0.5, 2.8], (4_000, 3))
    label = generator.integers(0, 5, len(points)).astype(np.uint8)
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    shift = np.array([3.0, -7.0])

    def moved(xy: np.ndarray) -> np.ndarray:
        return xy @ turn.T + shift

    def relabelled(move: bool) -> np.ndarray:
        at, walls, doors, windows, sensor = points.copy(), face(), door(0.04), window(0.05), SENSOR.copy()
        if move:
            at[:, :2], sensor[:2] = moved(at[:, :2]), moved(sensor[:2])
            walls, doors, windows = (
                replace(part, ends=moved(part.ends), normal=part.normal @ turn.T) for part in (walls, doors, windows)
            )
        return Relabelling.of(
            BuildingModel(walls, before(walls), NO_JUDGED_FACES, doors, windows, NO_BLINDS, ()), NO_HALO, SETTINGS
        ).labels(at, points[:, 2], 2.8 - points[:, 2], label, sensor).label

    assert np.count_nonzero(relabelled(False) != label) > 500
    np.testing.assert_array_equal(relabelled(True), relabelled(False))


def test_nothing_is_relabelled_where_there_is_nothing() -> None:
    nothing = Relabelling.of(
        BuildingModel(NO_WALLS, NO_FOREGROUND, NO_JUDGED_FACES, NO_DOORS, NO_WINDOWS, NO_BLINDS, ()), NO_HALO, SETTINGS
    ).labels(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, np.uint8), SENSOR).label
    assert len(nothing) == 0


@pytest.mark.parametrize(("covered", "expected"), [((False, True), Label.WALL), ((True, False), Label.CLUTTER)])
def test_what_stands_in_the_other_room_is_not_before_a_thin_wall(covered: tuple[bool, bool], expected: Label) -> None:
    """Of a wall 8 cm thick a return 5 cm behind its face is closer to the face of the room behind it."""
    other_side = replace(face(y=0.08), normal=np.array([[0.0, 1.0]]))
    assert final((2.0, 0.05, 1.0), Label.WALL, walls=face().append(other_side), covered=covered) == expected


@pytest.mark.parametrize("seed", range(4))
def test_returns_ask_about_every_part_of_the_building_that_they_may_belong_to(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same labels as where every return asks about all faces, doors and windows."""
    generator = np.random.default_rng(seed)

    def scattered(count: int) -> tuple[np.ndarray, np.ndarray]:
        start, angle = generator.uniform(-6, 6, (count, 1, 2)), generator.uniform(-np.pi, np.pi, count)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        length_m = generator.uniform(0.6, 3.0, (count, 1, 1))
        return start + np.array([[[0.0], [1.0]]]) * length_m * along[:, None], np.stack([-along[:, 1], along[:, 0]], 1)

    def many(one: Any, count: int) -> Any:
        ends, normal = scattered(count)
        rows = {f.name: np.repeat(getattr(one, f.name), count, axis=0) for f in fields(one)}
        return replace(one, **rows | {"ends": ends, "normal": normal})

    walls, refused = many(face(), 12), many(face(), 4)
    doors = many(door(0.04), 3).append(many(door(float("nan")), 3))
    windows = many(window(0.05), 3)
    near = np.concatenate([part.ends.reshape(-1, 2) for part in (walls, refused, doors, windows)])
    xy = near[generator.integers(0, len(near), 20_000)] + generator.normal(0.0, 0.6, (20_000, 2))
    points = np.column_stack([xy, generator.uniform(0.0, 2.8, 20_000)]).astype(np.float32)
    # Many lie on the floor and below the ceiling, where rays decide.
    points[::4, 2], points[1::4, 2] = generator.normal(0.0, 0.02, 5_000), 2.8 + generator.normal(0.0, 0.02, 5_000)
    label = generator.integers(0, 5, 20_000).astype(np.uint8)
    building: dict[str, Any] = {"walls": walls, "refused": refused, "doors": doors, "windows": windows}
    found = final_of(points, label, sensor=np.array([0.3, 0.2, 1.0]), **building)
    monkeypatch.setattr(final_labels, "index_near", lambda faces, _: index_near(faces, 100.0))
    np.testing.assert_array_equal(found, final_of(points, label, sensor=np.array([0.3, 0.2, 1.0]), **building))
    assert np.count_nonzero(found != label) > 5_000


LOW_CEILING = HeightMap(
    Surface.CEILING_DROP, np.array([0.0, -2.0]), 1.0, np.full((3, 4), 2.3), np.full((3, 4), 2.7)
)


@pytest.mark.parametrize(
    ("point", "label", "building", "reason", "off_face_m"),
    [
        ((0.5, -0.02, 1.0), Label.CLUTTER, {"walls": face()}, Reason.ON_FACE, 0.02),
        ((0.5, 0.06, 1.0), Label.CLUTTER, {"walls": face()}, Reason.IN_WALL, 0.06),
        ((0.5, -0.02, 1.0), Label.WALL, {"walls": face()}, Reason.KEPT, 0.02),
        ((0.5, -1.0, 1.0), Label.WALL, {"walls": face()}, Reason.NO_FACE, np.inf),
        ((0.5, -0.02, 1.0), Label.WALL, {"walls": face(), "covered": True}, Reason.AGAINST_WALL, 0.02),
        ((0.5, -1.0, 1.0), Label.WALL, {"refused": face(y=-1.0)}, Reason.ON_REFUSED, np.inf),
        ((1.5, 0.03, 1.0), Label.WALL, {"walls": face(), "doors": door(0.03)}, Reason.ON_LEAF, 0.03),
        ((1.5, 0.0, 1.0), Label.WALL, {"walls": face(), "doors": door(np.nan)}, Reason.IN_OPENING, 0.0),
        ((1.02, 0.1, 1.0), Label.CLUTTER, {"walls": face(), "doors": door(np.nan)}, Reason.ON_REVEAL, 0.1),
        ((2.0, 1.0, 1.2), Label.CLUTTER, {"walls": face(), "windows": window(0.05)}, Reason.BEYOND_WINDOW, np.inf),
        ((2.0, -1.0, 0.05), Label.FLOOR, {"walls": face()}, Reason.ABOVE_FLOOR, np.inf),
        ((2.0, -0.5, 2.5), Label.CLUTTER, {"levels": (LOW_CEILING,)}, SURFACE_REASONS[Surface.CEILING_DROP], np.inf),
    ],
)
def test_each_change_of_a_label_says_why(
    point: tuple[float, float, float], label: Label, building: dict[str, Any], reason: int, off_face_m: float
) -> None:
    found = relabelled(np.array([point], np.float32), np.array([label], np.uint8), **building)
    assert REASONS[int(found.reason[0])] == REASONS[reason]
    assert found.off_face_m[0] == pytest.approx(off_face_m, abs=1e-6)
    assert (found.label[0] == label) == (reason == Reason.KEPT)


def test_every_reason_has_words_of_its_own() -> None:
    codes = [*Reason, *SURFACE_REASONS.values()]
    assert sorted(codes) == list(range(len(codes)))
    assert len({REASONS[code] for code in codes}) == len(codes)
