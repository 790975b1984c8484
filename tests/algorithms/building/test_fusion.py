"""The building of all scans, from planes and rays that are known."""

from dataclasses import replace

import numpy as np
import pytest

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.base.votes import VoxelTable
from ffmap.algorithms.building import fusion
from ffmap.algorithms.building.drive import AllScans, Drive
from ffmap.algorithms.building.face_foreground import ForegroundSettings
from ffmap.algorithms.building.final_labels import RelabellingSettings
from ffmap.algorithms.building.fusion import Building, FusionSettings, fuse_building
from ffmap.algorithms.building.levels import LevelsSettings
from ffmap.algorithms.building.low_walls import LowWallsSettings
from ffmap.algorithms.building.model import BuildingSettings, Walls, unknown_support
from ffmap.algorithms.building.parse import ParseSettings
from ffmap.algorithms.building.thickness import WallThicknessSettings
from ffmap.algorithms.building.unseen_walls import UnseenWallsSettings
from ffmap.algorithms.building.verdicts import FaceVerdict, StandingWallsSettings
from ffmap.algorithms.building.windows import rays_through
from ffmap.algorithms.maps.grid import GridMapSettings
from ffmap.algorithms.maps.rivals import Rival
from ffmap.algorithms.scan.doors import DoorState
from ffmap.algorithms.scan.summary import Features
from tests.faces import window
from tests.tracing import traced_by
from tests.two_rooms import JAMBS_X, SIZE_M, TwoRooms
from tests.voting import vote

SETTINGS = FusionSettings(
    BuildingSettings(),
    LevelsSettings(),
    ParseSettings(),
    StandingWallsSettings(),
    UnseenWallsSettings(),
    LowWallsSettings(),
    ForegroundSettings(),
    WallThicknessSettings(),
    RelabellingSettings(),
)


def with_planes(features: Features, walls: Walls) -> Features:
    """Each scan has a plane of each face that it stands before."""
    columns: dict[str, list[FloatArray]] = {name: [] for name in ("ends", "normal", "moments")}
    count = []
    for origin in features.origin_map[:, :2]:
        seen = np.flatnonzero(np.sum((origin - walls.ends[:, 0]) * walls.normal, axis=1) > 0)
        for w in seen:
            x, y = np.linspace(*walls.ends[w], 100).T
            columns["ends"].append(walls.ends[w])
            columns["normal"].append(walls.normal[w])
            columns["moments"].append(np.array([100, x.sum(), y.sum(), x @ x, x @ y, y @ y]))
        count.append(len(seen))
    planes = sum(count)
    return replace(
        features,
        plane_count=np.array(count),
        plane_ends_map=np.array(columns["ends"]),
        plane_normal=np.array(columns["normal"]),
        plane_bottom_m=np.zeros(planes),
        plane_top_m=np.full(planes, 2.6),
        plane_lines=np.full(planes, 20, np.int32),
        plane_moments=np.array(columns["moments"]),
    )


def face(ends: list[list[float]], normal: list[float]) -> Walls:
    one = np.ones(1)
    return Walls(
        np.array([ends]),
        np.array([normal]),
        0 * one,
        2.6 * one,
        np.array([5], np.int32),
        0.01 * one,
        900 * one,
        unknown_support(1),
    )


def driven(rooms: TwoRooms, *more: Walls) -> AllScans:
    """more: faces beside the rooms' own that scans take for walls."""
    walls = rooms.walls
    for extra in more:
        walls = walls.append(extra)
    features = with_planes(rooms.scans(rays=20_000), walls)
    # A door that the robot drove through was not closed.
    way = features.origin_map
    way = way[way[:, 1] < SIZE_M[1]] if rooms.closed else way

    return AllScans(
        drive=Drive(way, lambda: [features]),
        votes=vote(features.ray_end_map, features.ray_label, len(Label), 0.05),
        rivals=VoxelTable(GridMapSettings().cell_m, len(Rival)).votes(),
        trace=lambda faces: traced_by(faces, features),
        trace_within=lambda openings: traced_by(openings, features, at_ends=True),
        trace_beyond=lambda faces, panes: traced_by(faces, rays_through(panes, features)),
        levels_settings=SETTINGS.levels,
    )


def built(rooms: TwoRooms, *more: Walls) -> Building:
    return fuse_building(driven(rooms, *more), SETTINGS)


@pytest.mark.parametrize("closed", [False, True])
def test_two_rooms_have_their_walls_and_their_door(closed: bool) -> None:
    rooms = TwoRooms(closed=closed)
    building = built(rooms)
    # A face goes on across the end of the wall between the rooms.
    length_m = lengths_m(rooms.walls.ends).sum() + 2 * rooms.thickness_m
    assert lengths_m(building.model.walls.ends).sum() == pytest.approx(length_m, abs=0.4)
    assert len(building.model.judged.refused) == len(building.model.windows) == 0
    assert building.model.doors.state.tolist() == [DoorState.CLOSED if closed else DoorState.OPEN]
    np.testing.assert_allclose(np.sort(building.model.doors.ends[0, :, 0]), JAMBS_X, atol=0.05)
    assert len(building.thickness_m) == len(building.model.walls)


def test_what_rays_pass_above_is_no_wall() -> None:
    ends = [[3.0, 0.8], [3.0, 2.2]]
    building = built(TwoRooms(more=((np.array(ends), (0.0, 1.2)),)), face(ends, [-1.0, 0.0]))
    assert building.model.judged.verdict.tolist() == [FaceVerdict.ENDS_LOW]
    np.testing.assert_allclose(building.model.judged.refused.ends[0, :, 0], 3.0, atol=0.01)
    assert not np.any(np.abs(building.model.walls.ends[..., 0] - 3.0) < 0.5)


@pytest.mark.parametrize(("thickness_m", "is_wall"), [(0.14, True), (0.3, False)])
def test_what_shows_both_sides_a_walls_thickness_apart_is_a_wall_though_rays_pass_above_it(
    thickness_m: float, is_wall: bool
) -> None:
    sides_x = 2.0 - 0.5 * thickness_m, 2.0 + 0.5 * thickness_m
    ends = [np.array([[x, 0.5], [x, 2.5]]) for x in sides_x]
    taken = [face(ends[0].tolist(), [-1.0, 0.0]), face(ends[1].tolist(), [1.0, 0.0])]
    building = built(TwoRooms(more=tuple((side, (0.0, 1.1)) for side in ends)), *taken)
    model = building.model
    low = model.walls.select(model.walls.top_m < 1.5)
    np.testing.assert_allclose(np.sort(low.ends[:, 0, 0]), sides_x if is_wall else (), atol=0.02)
    np.testing.assert_allclose(low.top_m, 1.1, atol=0.1)
    np.testing.assert_array_equal(model.low_walls.ends, low.ends)
    assert len(model.judged.refused) == (0 if is_wall else 2)
    # All that goes by wall faces knows of them too.
    first, clear_m = model.foreground.first, model.foreground.clear_m
    assert len(building.thickness_m) == len(model.walls) == len(first) - 1
    for w in np.flatnonzero(model.walls.top_m < 1.5):
        np.testing.assert_array_equal(clear_m[first[w] : first[w + 1]], model.walls.top_m[w])
    measured_m = building.thickness_m[model.walls.top_m < 1.5]
    np.testing.assert_allclose(measured_m, thickness_m if is_wall else 0.0, atol=0.02)


def test_what_was_seen_through_a_window_is_no_wall_of_this_building() -> None:
    rooms = TwoRooms(glass=(0.9, 2.1))
    house_opposite = face([[0.0, -rooms.outside_m], [3.0, -rooms.outside_m]], [0.0, 1.0])
    building = built(rooms, house_opposite)
    assert len(building.model.windows) == 1
    judged = building.model.judged
    assert np.all(building.model.walls.ends[..., 1] > -0.2)
    assert not np.any(judged.refused_label[judged.refused.ends[:, 0, 1] < -0.2] == Label.WALL)


@pytest.mark.parametrize("closed", [False, True])
def test_a_pane_at_an_open_doorway_is_its_leafs_and_no_window(
    closed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, y = JAMBS_X[0], SIZE_M[1]
    pane = replace(window((x, y - 0.8), (x, y - 0.2)), normal=np.array([[1.0, 0.0]]))
    monkeypatch.setattr(fusion, "fronts_of", lambda _: pane)
    building = built(TwoRooms(closed=closed))
    assert (len(building.model.windows), len(building.model.leaf_panes)) == ((1, 0) if closed else (0, 1))
