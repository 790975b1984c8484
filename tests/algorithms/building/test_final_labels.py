"""Final labels of single returns at one wall along y = 0, seen from y < 0."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import index_near
from ffmap.algorithms.building import final_labels
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.final_labels import (
    ODDS_MAX,
    BuildingModel,
    Relabelled,
    Relabelling,
    RelabellingSettings,
)
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    NO_WALLS,
    NO_WINDOWS,
    Blinds,
    Doors,
    Walls,
    Windows,
    one_door,
    unknown_support,
)
from ffmap.algorithms.building.panels import Kind
from ffmap.algorithms.building.verdicts import FaceVerdict, JudgedFaces
from ffmap.algorithms.scan.doors import DoorState
from tests.faces import NO_BLINDS, NO_FOREGROUND, NO_JUDGED_FACES

SETTINGS = RelabellingSettings()
SENSOR = np.array([2.0, -2.0, 1.0])
CEILING_M = 2.8
TO_SENSOR = np.array([[0.0, -1.0]])
Point = tuple[float, float, float]


def face(x0: float = 0.0, x1: float = 4.0, y: float = 0.0, top_m: float = CEILING_M) -> Walls:
    """A face towards the sensor."""
    counts = np.array([9], np.int32), np.array([0.01]), np.array([900])
    ends = np.array([[[x0, y], [x1, y]]])
    return Walls(ends, TO_SENSOR, np.zeros(1), np.array([top_m]), *counts, unknown_support(1))


def door(depth_m: float) -> Doors:
    """Between x = 1 and x = 2, 2.1 m high, reveals 0.2 m deep; open where the depth is NaN."""
    state = DoorState.OPEN if np.isnan(depth_m) else DoorState.CLOSED
    return one_door(
        ends=[[1.0, 0.0], [2.0, 0.0]],
        normal=[0.0, -1.0],
        head_m=2.1,
        depth_m=depth_m,
        state=state,
        agreement=1.0,
        coverage=1.0,
        ray_count=99,
        wall=0,
        reveal_m=0.2,
    )


OPEN = door(np.nan)


def window(pane_m: float, x0: float = 1.0, x1: float = 3.0) -> Windows:
    extents = np.array([0.9]), np.array([2.0]), np.array([pane_m])
    return Windows(np.array([[[x0, 0.0], [x1, 0.0]]]), TO_SENSOR, *extents, unknown_support(1))


def before(walls: Walls, ceiling_m: float, covered: bool) -> Foreground:
    """A room of one height before all faces, with or without something flat against all."""
    columns = np.ceil(np.linalg.norm(walls.ends[:, 1] - walls.ends[:, 0], axis=1) / CELL_M)
    first = np.concatenate([[0], np.cumsum(columns)]).astype(np.int64)
    count = int(first[-1])
    return Foreground(
        first, np.full(count, ceiling_m), np.zeros(count), np.full((count, 60), covered)
    )


def building(
    walls: Walls = NO_WALLS,
    refused: Walls = NO_WALLS,
    verdict: FaceVerdict = FaceVerdict.ENDS_LOW,
    ceiling_m: float = CEILING_M,
    covered: bool = False,
    **parts: Any,
) -> BuildingModel:
    judged = JudgedFaces(walls, refused, np.full(len(refused), verdict, np.uint8))
    nothing = {"doors": NO_DOORS, "windows": NO_WINDOWS, "blinds": NO_BLINDS, "levels": ()}
    return BuildingModel(walls, before(walls, ceiling_m, covered), judged, **nothing | parts)


def relabelled(
    points: np.ndarray,
    label: np.ndarray,
    model: BuildingModel,
    sensor: np.ndarray = SENSOR,
) -> Relabelled:
    """The returns (n, 3) of a scan with its floor at 0 and its ceiling at 2.8 m, relabelled."""
    height_m = points[:, 2].astype(np.float64)
    relabelling = Relabelling.of(model, SETTINGS)
    return relabelling.labels(points, height_m, CEILING_M - height_m, label, sensor)


def final(
    point: Point, label: Label, sensor: np.ndarray = SENSOR, **parts: Any
) -> tuple[Label, Kind]:
    """The final label of one return, and what it is from."""
    returns = np.array([point], np.float32), np.array([label], np.uint8)
    found = relabelled(*returns, building(**parts), sensor)
    if found.kind[0] in (Kind.WALL, Kind.NOTHING):
        assert (found.wall[0] >= 0) == (found.kind[0] == Kind.WALL)
    return Label(int(found.label[0])), Kind(int(found.kind[0]))


WALL, NOTHING = (Label.WALL, Kind.WALL), (Label.CLUTTER, Kind.NOTHING)
LEAF, REVEAL = (Label.DOOR, Kind.LEAF), (Label.WALL, Kind.REVEAL)
OUTSIDE = (Label.OUTSIDE, Kind.BEYOND_PANE)


@pytest.mark.parametrize(
    ("y", "scan_label", "expected"),
    [
        (-0.02, Label.CLUTTER, WALL),
        (-0.10, Label.CLUTTER, NOTHING),
        (0.06, Label.CLUTTER, WALL),  # scatter: nothing else can be behind a wall
        (0.15, Label.CLUTTER, NOTHING),
        (-0.10, Label.WALL, WALL),
        (-0.40, Label.WALL, NOTHING),
        (0.03, Label.DOOR, WALL),
        (-0.3, Label.DOOR, NOTHING),
    ],
)
def test_a_return_near_a_face(y: float, scan_label: Label, expected: tuple[Label, Kind]) -> None:
    assert final((2.0, y, 1.0), scan_label, walls=face()) == expected


@pytest.mark.parametrize(
    ("ceiling_m", "expected"), [(CEILING_M, WALL), (1.9, NOTHING), (np.nan, NOTHING)]
)
def test_a_wall_extends_to_the_ceiling_before_it(
    ceiling_m: float, expected: tuple[Label, Kind]
) -> None:
    seen = {"walls": face(top_m=2.0), "ceiling_m": ceiling_m}
    assert final((2.0, -0.02, 2.4), Label.CLUTTER, **seen) == expected


def test_a_face_is_not_visible_from_behind() -> None:
    other_side = np.array([2.0, 2.0, 1.0])
    assert final((2.0, 0.02, 1.0), Label.CLUTTER, other_side, walls=face()) == NOTHING


@pytest.mark.parametrize("off_m", [-0.02, 0.0, 0.02])
def test_a_grazing_ray_is_compared_across_the_face(off_m: float) -> None:
    """Along the ray the face is up to a metre away."""
    sensor = np.array([-8.0, -0.5, 1.0])
    assert final((3.0, off_m, 1.0), Label.WALL, sensor, walls=face()) == WALL
    assert final((4.5, off_m, 1.0), Label.WALL, sensor, walls=face()) == NOTHING


@pytest.mark.parametrize("range_error_m", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("by_scan", ["wall", "level"])
@pytest.mark.parametrize(
    ("height_m", "expected"),
    [
        (0.015, Label.WALL),
        (-0.015, Label.FLOOR),
        (CEILING_M - 0.015, Label.WALL),
        (CEILING_M + 0.015, Label.CEILING),
    ],
)
def test_along_an_edge_the_first_surface_on_the_ray_decides(
    by_scan: str, range_error_m: float, height_m: float, expected: Label
) -> None:
    """height_m: where the ray would meet the wall; below the floor it ends on the floor."""
    at_wall = np.array([2.0, 0.0, height_m])
    ray = (at_wall - SENSOR) / np.linalg.norm(at_wall - SENSOR)
    surface_m = 0.0 if height_m < 1.0 else CEILING_M
    level = Label.FLOOR if height_m < 1.0 else Label.CEILING
    end = at_wall if expected == Label.WALL else SENSOR + ray * (surface_m - SENSOR[2]) / ray[2]
    x, y, z = end + ray * range_error_m
    assert final((x, y, z), Label.WALL if by_scan == "wall" else level, walls=face())[0] == expected


@pytest.mark.parametrize("off_m", [-0.015, 0.015])
@pytest.mark.parametrize("level", [Label.FLOOR, Label.CEILING])
def test_a_scan_is_aligned_with_each_face(off_m: float, level: Label) -> None:
    """At floor and ceiling the pose is off in opposite directions."""
    generator = np.random.default_rng(0)
    sign = 1.0 if level == Label.FLOOR else -1.0
    foot = generator.uniform((1.0, sign * off_m, 0.2), (3.0, sign * off_m, 0.6), (60, 3))
    top = generator.uniform((1.0, -sign * off_m, 2.2), (3.0, -sign * off_m, 2.6), (60, 3))
    edge_m = 0.0 if level == Label.FLOOR else CEILING_M
    at_wall = np.column_stack([np.linspace(1.2, 2.8, 40), np.full(40, off_m), np.full(40, edge_m)])
    at_wall[::2, 2] += sign * 0.01
    at_wall[1::2, 2] -= sign * 0.01
    ray = at_wall - SENSOR
    at_level = SENSOR + ray * ((edge_m - SENSOR[2]) / ray[:, 2])[:, None]
    edge = np.where(np.arange(40)[:, None] % 2 == 0, at_wall, at_level)
    points = np.concatenate([foot, top, edge]).astype(np.float32)
    label = np.concatenate([np.full(120, Label.WALL), np.full(40, level)]).astype(np.uint8)
    found = relabelled(points, label, building(walls=face())).label[120:]
    np.testing.assert_array_equal(found[::2], Label.WALL)
    np.testing.assert_array_equal(found[1::2], level)


@pytest.mark.parametrize(
    ("before_m", "height_m", "expected"),
    [
        (0.3, 0.03, Label.FLOOR),
        (2.0, 0.06, Label.CLUTTER),
        (8.0, 0.01, Label.FLOOR),
    ],
)
def test_a_return_near_the_floor(before_m: float, height_m: float, expected: Label) -> None:
    scan_label = Label.FLOOR if height_m < 0.05 else Label.CLUTTER
    assert final((2.0, SENSOR[1] - before_m, height_m), scan_label)[0] == expected


@pytest.mark.parametrize(("ceiling_m", "expected"), [(3.2, Label.WALL), (2.8, Label.CEILING)])
def test_the_ceiling_of_another_room_does_not_hide_a_wall(
    ceiling_m: float, expected: Label
) -> None:
    seen = {"walls": face(top_m=ceiling_m), "ceiling_m": ceiling_m}
    assert final((2.0, -0.001, 2.83), Label.WALL, **seen)[0] == expected


def test_the_ceiling_above_a_low_wall_is_not_its_edge() -> None:
    seen = {"walls": face(top_m=1.1), "ceiling_m": 1.1}
    assert final((2.0, 0.03, 2.78), Label.CEILING, **seen) == (Label.CEILING, Kind.CEILING)


@pytest.mark.parametrize("scan_label", [Label.CLUTTER, Label.WALL, Label.DOOR])
def test_a_closed_door_fills_its_doorway(scan_label: Label) -> None:
    def of(x: float, y: float, z: float) -> tuple[Label, Kind]:
        return final((x, y, z), scan_label, walls=face(), doors=door(0.04))

    assert of(1.5, 0.04, 1.0) == LEAF
    assert of(1.5, 0.0, 1.0) == LEAF  # its handle
    assert of(1.97, 0.04, 1.0) == LEAF
    assert of(1.5, 0.0, 2.3)[0] == Label.WALL  # above it
    assert of(0.9, 0.0, 1.0) == WALL  # beside it


@pytest.mark.parametrize("scan_label", [Label.CLUTTER, Label.WALL, Label.DOOR])
def test_a_closed_door_before_its_wall(scan_label: Label) -> None:
    def of(x: float, y: float, z: float) -> tuple[Label, Kind]:
        return final((x, y, z), scan_label, walls=face(), doors=door(-0.06))

    assert of(1.97, -0.06, 1.0) == LEAF
    assert of(1.5, -0.08, 1.0) == LEAF
    assert of(1.5, -0.01, 2.3)[0] == Label.WALL
    assert of(0.9, -0.01, 1.0) == WALL


def test_a_closed_door_reaches_the_floor() -> None:
    for depth_m in (0.04, -0.06):
        doors = door(depth_m)
        assert final((1.5, depth_m, 0.02), Label.FLOOR, walls=face(), doors=doors) == LEAF
        on_floor = final((1.5, depth_m - 0.04, 0.0), Label.FLOOR, walls=face(), doors=doors)
        assert on_floor == (Label.FLOOR, Kind.FLOOR)


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((1.5, -0.01, 1.0), NOTHING),  # somebody in the doorway
        ((1.5, 0.15, 1.0), NOTHING),
        ((1.5, 0.05, 1.0), NOTHING),
        ((1.01, 0.15, 1.0), REVEAL),  # a jamb
        ((1.5, 0.15, 2.09), REVEAL),  # the underside of the lintel
        ((1.5, -0.01, 2.3), WALL),
        ((1.03, 0.4, 1.0), NOTHING),  # behind the wall
    ],
)
def test_an_open_doorway(point: Point, expected: tuple[Label, Kind]) -> None:
    found = final(point, Label.CLUTTER, walls=face(), doors=OPEN)
    # The lintel is a part of the wall and of the door.
    assert found == expected or (found[0] == expected[0] == Label.WALL)


def test_the_floor_in_an_open_doorway() -> None:
    assert final((2.5, -0.005, 0.02), Label.FLOOR, walls=face()) == WALL
    found = final((1.5, -0.005, 0.01), Label.FLOOR, walls=face(), doors=OPEN)
    assert found == (Label.FLOOR, Kind.FLOOR)


@pytest.mark.parametrize(
    ("point", "verdict", "expected"),
    [
        ((1.5, -0.12, 1.0), FaceVerdict.ENDS_LOW, (Label.CLUTTER, Kind.REFUSED)),
        ((1.5, -0.12, 1.0), FaceVerdict.OUTSIDE, (Label.OUTSIDE, Kind.REFUSED)),
        ((1.5, -0.10, 2.5), FaceVerdict.ENDS_LOW, WALL),  # above it, by the scan alone
        ((1.5, -0.01, 1.0), FaceVerdict.ENDS_LOW, WALL),  # behind it
    ],
)
def test_a_refused_face(point: Point, verdict: FaceVerdict, expected: tuple[Label, Kind]) -> None:
    refused = face(1.0, 1.9, -0.12, top_m=2.05)
    seen = {"walls": face(), "refused": refused, "verdict": verdict}
    assert final(point, Label.WALL, **seen) == expected


def test_a_refused_face_along_a_wall_is_a_duplicate() -> None:
    assert final((2.0, -0.03, 1.0), Label.WALL, walls=face(), refused=face(y=-0.03)) == WALL


def test_what_stands_flat_against_a_wall_is_clutter() -> None:
    relief = (Label.CLUTTER, Kind.RELIEF)
    assert final((2.5, -0.02, 1.0), Label.WALL, walls=face(), covered=True) == relief
    # The wall in the recess of a window, and a jamb, are not covered.
    seen: dict[str, Any] = {"walls": face(), "covered": True}
    assert final((2.0, 0.0, 0.5), Label.WALL, windows=window(0.05), **seen)[0] == Label.WALL
    assert final((1.0, 0.1, 1.0), Label.WALL, doors=OPEN, **seen) == REVEAL


@pytest.mark.parametrize(
    ("pane_m", "y", "expected"),
    [
        (0.16, 0.08, Label.WALL),  # a sill or a reveal
        (0.05, 0.15, Label.OUTSIDE),
        (np.nan, 0.10, Label.WALL),
        (np.nan, 0.30, Label.OUTSIDE),
    ],
)
def test_a_window(pane_m: float, y: float, expected: Label) -> None:
    found = final((2.0, y, 1.2), Label.CLUTTER, walls=face(), windows=window(pane_m))
    assert found[0] == expected


def test_outside_is_behind_a_pane_from_the_sensor() -> None:
    behind, glass = (2.0, 3.0, 1.2), window(0.05)
    assert final(behind, Label.WALL, windows=glass) == OUTSIDE
    assert final(behind, Label.WALL, np.array([9.0, -1.0, 1.0]), windows=glass) == NOTHING
    in_room = np.array([2.0, 1.0, 1.0])
    assert final(behind, Label.WALL, in_room, walls=face(y=3.0), windows=glass) == WALL
    # A pane in the leaf of an open door has no recess in a wall.
    assert final(behind, Label.WALL, leaf_panes=glass) == OUTSIDE
    assert final((2.0, 0.02, 0.5), Label.CLUTTER, leaf_panes=glass) == NOTHING


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((2.0, 0.2, 2.2), (Label.CLUTTER, Kind.BLIND)),
        ((2.0, 0.19, 2.6), OUTSIDE),  # above it
        ((2.0, 0.4, 2.2), OUTSIDE),
    ],
)
@pytest.mark.parametrize("scan_label", [Label.WALL, Label.CLUTTER])
def test_a_blind(point: Point, expected: tuple[Label, Kind], scan_label: Label) -> None:
    extents = (np.array([value]) for value in (2.0, 2.5, 0.2))
    blind = Blinds(window(0.0).ends, TO_SENSOR, *extents)
    seen = {"walls": face(), "windows": window(np.nan), "blinds": blind}
    assert final(point, scan_label, **seen) == expected


class Raised:
    """A level surface that makes clutter of all scans floor."""

    def label_of(self, points_map: np.ndarray, label: np.ndarray) -> np.ndarray:
        return np.where(label == Label.CLUTTER, np.uint8(Label.FLOOR), label)


def test_level_surfaces_of_all_scans_come_last() -> None:
    points = np.array([[2.0, -1.0, 1.5], [2.0, 0.0, 1.5]], np.float32)
    label = np.full(2, Label.CLUTTER, np.uint8)
    found = relabelled(points, label, building(walls=face(), levels=(Raised(),)))
    assert found.label.tolist() == [Label.FLOOR, Label.WALL]
    assert found.kind.tolist() == [Kind.LEVEL, Kind.WALL]
    assert np.isnan(found.odds).tolist() == [True, False]


def test_the_odds_fall_where_another_label_is_as_likely() -> None:
    before_m = np.linspace(0.0, 0.1, 51)
    points = np.column_stack([np.full(51, 2.5), -before_m, np.full(51, 1.0)]).astype(np.float32)
    found = relabelled(points, np.full(51, Label.CLUTTER, np.uint8), building(walls=face()))
    turn = np.flatnonzero(np.diff(found.label))
    assert len(turn) == 1
    assert found.odds.min() >= 1.0
    assert found.odds[turn[0]] < 3.0 < 20.0 < found.odds[0] <= ODDS_MAX
    assert np.all(np.diff(found.odds[: turn[0] + 1]) <= 0)


def test_labels_do_not_change_under_rigid_motion() -> None:
    generator = np.random.default_rng(7)
    points = generator.uniform([0, -0.5, 0], [4, 0.5, 2.8], (4_000, 3))
    label = generator.integers(0, 5, len(points)).astype(np.uint8)
    turn, shift = np.array([[0.8, -0.6], [0.6, 0.8]]), np.array([3.0, -7.0])

    def moved(part: Any) -> Any:
        return replace(part, ends=part.ends @ turn.T + shift, normal=part.normal @ turn.T)

    parts = {"walls": face(), "doors": door(0.04), "windows": window(0.05)}
    still = relabelled(points, label, building(**parts))
    there, sensor = points.copy(), SENSOR.copy()
    there[:, :2], sensor[:2] = points[:, :2] @ turn.T + shift, SENSOR[:2] @ turn.T + shift
    model = building(**{name: moved(part) for name, part in parts.items()})
    found = relabelled(there, label, model, sensor)
    assert np.count_nonzero(still.label != label) > 500
    # The alignment of a scan has bins, into which rounding may sort a return differently.
    assert np.mean(found.label == still.label) > 0.995
    assert np.mean(found.kind == still.kind) > 0.995


def test_an_empty_building_and_an_empty_scan() -> None:
    nothing = BuildingModel(
        NO_WALLS,
        NO_FOREGROUND,
        NO_JUDGED_FACES,
        NO_DOORS,
        NO_WINDOWS,
        NO_BLINDS,
        (),
    )
    assert len(relabelled(np.zeros((0, 3)), np.zeros(0, np.uint8), nothing).label) == 0
    found = relabelled(
        np.array([[2.0, 0.0, 0.0], [2.0, 0.0, 1.0]]), np.array([1, 3], np.uint8), nothing
    )
    assert found.label.tolist() == [Label.FLOOR, Label.CLUTTER]


@pytest.mark.parametrize("seed", range(3))
def test_returns_are_compared_with_all_panels_near_them(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The labels are the same if every return is compared with every panel."""
    generator = np.random.default_rng(seed)

    def many(one: Any, count: int) -> Any:
        start, angle = generator.uniform(-6, 6, (count, 1, 2)), generator.uniform(0, 7, count)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ends = start + np.array([[[0.0], [1.0]]]) * generator.uniform(1, 3) * along[:, None]
        rows = {f.name: np.repeat(getattr(one, f.name), count, axis=0) for f in fields(one)}
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        return replace(one, **rows | {"ends": ends, "normal": normal})

    parts = {
        "walls": many(face(), 12),
        "refused": many(face(), 4),
        "doors": many(door(0.04), 3).append(many(OPEN, 3)),
        "windows": many(window(0.05), 2),
    }
    near = np.concatenate([part.ends.reshape(-1, 2) for part in parts.values()])
    xy = near[generator.integers(0, len(near), 9_000)] + generator.normal(0.0, 0.4, (9_000, 2))
    points = np.column_stack([xy, generator.uniform(0.0, 2.8, 9_000)]).astype(np.float32)
    points[::4, 2], points[1::4, 2] = 0.01, CEILING_M
    label = generator.integers(0, 5, 9_000).astype(np.uint8)
    sensor, model = np.array([0.3, 0.2, 1.0]), building(**parts)
    found = relabelled(points, label, model, sensor)
    monkeypatch.setattr(final_labels, "index_near", lambda faces, _: index_near(faces, 100.0))
    np.testing.assert_array_equal(found.label, relabelled(points, label, model, sensor).label)
    assert np.count_nonzero(found.label != label) > 2_000
