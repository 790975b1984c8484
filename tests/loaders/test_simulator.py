"""The simulator: contents of its bags, and whether the ground truth agrees with the returns."""

import json
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from rosbags.highlevel import AnyReader
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.app.commands import simulate as simulate_command
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.simulator.raytrace import World, scan
from ffmap.loaders.simulator.simulate import Scene, draw_scene

Traced = tuple[Scene, np.ndarray, np.ndarray]


def trace(settings: SimulationSettings, sweeps: range, lidar: int = 1) -> Traced:
    """Return a scene, the returns (n, 3) of some sweeps in the map, and their classes."""
    scene = draw_scene(settings)
    world, own = World(scene.mesh, scene.walkers), scene.lidars[lidar]
    points, truth = [], []
    for sweep in (scan(world, own, scene.trajectory, k, settings) for k in sweeps):
        T = scene.trajectory.at(sweep.stamp_ns + sweep.time_ns) @ own.T_base_sensor
        points.append(np.einsum("nij,nj->ni", T[:, :3, :3], sweep.points_sensor) + T[:, :3, 3])
        truth.append(sweep.truth)
    classes = np.concatenate(truth)
    return scene, np.concatenate(points)[classes != NO_RETURN], classes[classes != NO_RETURN]


def lines_of(scene: Scene, kind: str) -> list[shapely.LineString]:
    own = (f for f in scene.truth["features"] if f["properties"]["kind"] == kind)
    return [shapely.LineString(f["geometry"]["coordinates"]) for f in own]


def messages_of(path: Path) -> dict[str, list[Any]]:
    messages: dict[str, list[Any]] = defaultdict(list)
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            messages[connection.topic].append(reader.deserialize(raw, connection.msgtype))
    return messages


@pytest.fixture(scope="module")
def exact() -> Traced:
    """A drive in and out of rooms without any error of measurement, every 30th sweep."""
    values = {"building": "office", "seed": 4, "duration_s": 50, "sensor": "vlp16"}
    settings = SimulationSettings.model_validate({**values, "noise_m": 0, "closed_share": 0.5})
    return trace(settings, range(0, 480, 30))


@pytest.mark.parametrize("container", ["bag", "mcap", "db3"])
def test_a_bag_can_be_read_back(container: Any, tmp_path: Path) -> None:
    settings = SimulationSettings(
        building="small", seed=1, sensor="vlp16", format=container, duration_s=0.75
    )
    simulate(tmp_path / "drive", settings)
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]
    path = tmp_path / "drive"
    if container == "bag":
        path = path.rename(tmp_path / "drive.bag")
    messages = messages_of(path)
    counts = Counter({topic: len(own) for topic, own in messages.items()})
    assert counts["/tf_static"] == counts["/truth/building"] == 1
    assert counts["/truth/pose"] >= 70
    assert counts["/truth/classes"] == counts["/vertical_velodyne/velodyne_points"] >= 6
    clouds = messages["/vertical_velodyne/velodyne_points"]
    for cloud, classes in zip(clouds, messages["/truth/classes"], strict=True):
        assert " ".join(f"{f.name}{f.offset}:{f.datatype}" for f in cloud.fields) == (
            "x0:7 y4:7 z8:7 intensity12:7 ring16:4 time18:7"
        )
        assert (cloud.point_step, cloud.height, cloud.is_dense) == (22, 1, True)
        assert classes.header.stamp == cloud.header.stamp
        assert len(classes.data) == cloud.width
        assert classes.data.max() <= max(Truth)
        row = [("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
        rows = np.frombuffer(cloud.data.tobytes(), row)
        assert rows["time"].min() >= 0
        assert 0.09 < rows["time"].max() < 0.101
        elevation = np.degrees(np.arcsin(rows["xyz"][:, 2] / np.linalg.norm(rows["xyz"], axis=1)))
        assert np.allclose(elevation, -15 + 2.0 * rows["ring"], atol=0.01)
    frames = {t.child_frame_id: t for t in messages["/tf_static"][0].transforms}
    assert set(frames) == {"horizontal_velodyne", "vertical_velodyne"}
    building = json.loads(messages["/truth/building"][0].data)
    kinds = {feature["properties"]["kind"] for feature in building["features"]}
    assert {"wall", "door", "room"} <= kinds


@pytest.mark.parametrize(
    ("lidars", "labelled"), [("three", ["left", "right"]), ("upright", ["front", "rear"])]
)
def test_each_lidar_for_mapping_has_its_truth(
    lidars: Any, labelled: list[str], tmp_path: Path
) -> None:
    settings = SimulationSettings(
        building="small", seed=1, sensor="os1-16", duration_s=0.5, lidars=lidars
    )
    simulate(tmp_path / "drive.bag", settings)
    read = messages_of(tmp_path / "drive.bag")
    topics = {topic for topic in read if topic.startswith("/truth/classes")}
    assert topics == {"/truth/classes", "/truth/classes_2"}
    for topic, name in zip(sorted(topics), labelled, strict=True):
        for classes, cloud in zip(read[topic], read[f"/{name}_ouster/points"], strict=True):
            assert classes.header == cloud.header
            assert classes.header.frame_id == f"{name}_ouster"
            assert (cloud.height, cloud.width, cloud.point_step) == (16, 1024, 48)
            # Every place is there, zero where nothing returned.
            rows = cloud.data.reshape(-1, 48)
            empty = rows[:, 32:36].copy().view("<u4")[:, 0] == 0
            assert 0 < empty.mean() < 0.5
            assert not rows[empty, :12].copy().view("<f4").any()
            assert np.array_equal(classes.data == NO_RETURN, empty)
            assert np.array_equal(rows[:, 26], np.repeat(np.arange(16), 1024))


def test_the_seed_decides_the_bag(tmp_path: Path) -> None:
    bags = [tmp_path / name for name in ("one.bag", "two.bag", "other.bag")]
    values = {"building": "small", "sensor": "vlp16", "duration_s": 0.35, "walking_people": 1}
    for bag, seed in zip(bags, (5, 5, 6), strict=True):
        simulate(bag, SimulationSettings.model_validate({**values, "seed": seed}))
    one, two, other = (bag.read_bytes() for bag in bags)
    assert one == two
    assert one != other


def test_returns_are_on_floors_ceilings_and_walls(exact: Traced) -> None:
    scene, points, truth = exact
    assert np.allclose(scene.trajectory.T_map_base[0], np.eye(4), atol=1e-3)
    assert np.abs(points[truth == Truth.FLOOR, 2]).max() < 0.01
    ceiling = points[truth == Truth.CEILING, 2]
    heights = np.array([room.ceiling_m for room in scene.plan.rooms])
    assert len(ceiling) > 1000
    assert np.abs(ceiling[:, None] - heights).min(1).max() < 0.01
    low = points[(truth == Truth.WALL) & (points[:, 2] < 0.7)]
    openings = [line.buffer(0.5) for kind in ("door", "glass") for line in lines_of(scene, kind)]
    wall = low[~shapely.contains_xy(shapely.union_all(openings), low[:, :2])]
    assert len(wall) > 5000
    faces = shapely.union_all(lines_of(scene, "wall"))
    distance = shapely.distance(faces, shapely.points(wall[:, :2]))
    assert np.quantile(distance, 0.999) < 0.01


def test_closed_leaves_are_recessed_as_the_truth_states(exact: Traced) -> None:
    scene, points, truth = exact
    leaf, seen = points[truth == Truth.DOOR], 0
    for door in scene.plan.doors:
        at = transforms.from_yaw(door.spot.yaw, [door.spot.x, door.spot.y, 0.0])
        local = transforms.apply(transforms.invert(scene.T_map_plan @ at), leaf)
        behind = door.depth[1] - local[:, 1]
        here = (np.abs(local[:, 0]) < door.width_m / 2 + 0.01) & (np.abs(behind) < 0.3)
        here &= np.abs(local[:, 2] - 1.04) > 0.05  # Not the lever
        if door.closed and door.rooms[0] == 0 and np.count_nonzero(here) > 200:
            seen += 1
            assert np.median(behind[here]) == pytest.approx(door.recess_m, abs=0.005)
            assert 0.03 <= door.recess_m <= 0.06
            assert local[here, 2].max() < door.top_m + 0.01
    assert seen >= 2


def test_beams_pass_through_glass_and_seldom_return() -> None:
    values = {"building": "small", "seed": 2, "duration_s": 25, "sensor": "vlp16", "noise_m": 0}
    glazed = {"window": "curtain wall", "glass": ["clear", "double"], "glazed_share": 0.5}
    settings = SimulationSettings.model_validate({**values, **glazed})
    scene, points, truth = trace(settings, range(0, 240, 20))
    T_plan_map = transforms.invert(scene.T_map_plan)
    places = transforms.apply(T_plan_map, points)[:, :2]
    inside = shapely.contains_xy(scene.plan.footprint.buffer(-0.4), places)
    pane, beyond = truth == Truth.GLASS, truth == Truth.OUTSIDE
    assert np.count_nonzero(beyond & ~inside) > 3 * np.count_nonzero(pane) > 0
    indoors = shapely.contains_xy(scene.plan.footprint.buffer(0.05), places)
    assert not np.any((truth <= Truth.DOOR) & ~beyond & ~indoors)


def test_intensities_depend_on_the_surface_and_the_angle_of_incidence(exact: Traced) -> None:
    settings = SimulationSettings(building="office", seed=4, duration_s=50, sensor="vlp16")
    scene = exact[0]
    world, lidar = World(scene.mesh), scene.lidars[1]
    sweep = scan(world, lidar, scene.trajectory, 20, settings)
    floor, wall = (sweep.intensity[sweep.truth == own] for own in (Truth.FLOOR, Truth.WALL))
    assert abs(np.median(floor) - np.median(wall)) > 5
    assert np.quantile(wall, 0.02) < 0.75 * np.quantile(wall, 0.98)
    faded = settings.model_copy(update={"intensity_half_m": 5.0})
    other = scan(world, lidar, scene.trajectory, 20, faded)
    np.testing.assert_array_equal(sweep.points_sensor, other.points_sensor)
    assert other.intensity.mean() < 0.95 * sweep.intensity.mean()


def test_walking_people_walk() -> None:
    values = {"building": "small", "seed": 1, "duration_s": 10, "sensor": "vlp16", "clutter": 0}
    settings = SimulationSettings.model_validate({**values, "walking_people": 6})
    scene, points, truth = trace(settings, range(0, 90, 6), lidar=0)
    assert len(scene.walkers) == 6
    people = points[truth == Truth.PERSON]
    assert len(people) > 50
    assert people[:, 2].max() < 1.95


def test_a_slope_and_a_ramp_lift_the_floor_and_the_robot() -> None:
    values = {"building": "small", "duration_s": 20, "sensor": "vlp16", "noise_m": 0, "sway_deg": 0}
    ground = {"ramp_rise_m": 0.3, "floor_slope_deg": 0.5}
    scene, points, truth = trace(
        SimulationSettings.model_validate({**values, **ground}), range(0, 190, 40)
    )
    base = scene.trajectory.T_map_base[:, :3, 3]
    assert np.ptp(base[:, 2]) > 0.2
    floor = points[truth == Truth.FLOOR]
    distance, nearest = cKDTree(base[:, :2]).query(floor[:, :2])
    beside = distance < 0.2
    assert np.count_nonzero(beside) > 100
    assert np.abs(floor[beside, 2] - base[nearest[beside], 2]).max() < 0.03


@pytest.mark.parametrize(
    ("values", "overrides", "message"),
    [
        ({"building": "castle"}, [], "building = 'castle': Input should be 'office'"),
        ({}, ["building=[1]"], "building = \\[1\\]"),
        ({"sensor": "hdl64"}, [], r"simulate: sensor = 'hdl64'"),
        ({}, ["clutterr=0.5"], "no setting 'clutterr'; the settings are building, seed"),
        ({}, ["clutter"], "write it as name=value"),
        ({}, ["door_head_m=[2.4, 2.0]"], "the lower end of a range comes first"),
        ({}, ["leaf=open"], "simulate: leaf = 'open'"),
        ({}, ["glass=[]"], "simulate: glass"),
        ({}, ["room_width_m=0"], r"room_width_m must be between 1\.1 and 14"),
    ],
)
def test_wrong_settings_are_refused(
    values: dict[str, Any], overrides: list[str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        simulate_command.simulate(tmp_path / "drive.bag", values, overrides)
    assert not list(tmp_path.iterdir())


def test_no_file_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "drive.bag").touch()
    with pytest.raises(InputError, match="exists already"):
        simulate(tmp_path / "drive.bag", SimulationSettings())
    theirs = tmp_path / "other.bag.part"
    theirs.mkdir()
    settings = SimulationSettings(building="small", sensor="vlp16", duration_s=0.5)
    simulate(tmp_path / "other.bag", settings)
    assert theirs.exists()


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate_command, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="simulated drives require trimesh and embreex; install"):
        simulate_command.simulate(tmp_path / "a.bag", {})
