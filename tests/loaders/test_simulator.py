"""The simulator: what its bags contain, and whether their truth agrees with the geometry."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import shapely
from pydantic import ValidationError
from rosbags.highlevel import AnyReader
from scipy.spatial import cKDTree

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import BUILDINGS, SimulationSettings, simulate
from ffmap.loaders.simulator.building import Door
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M
from ffmap.loaders.simulator.raytrace import Sweep, World, scan
from ffmap.loaders.simulator.simulate import Scene, draw_scene


def returns_in_map(scene: Scene, sweep: Sweep, lidar: int) -> np.ndarray:
    """Every place of a sweep at the true pose of its own firing, (n, 3) in the map."""
    T = scene.trajectory.at(sweep.stamp_ns + sweep.time_ns) @ scene.lidars[lidar].T_base_sensor
    return np.einsum("nij,nj->ni", T[:, :3, :3], sweep.points_sensor) + T[:, :3, 3]


def trace(settings: SimulationSettings, sweeps: range, lidar: int = 1) -> tuple[Scene, np.ndarray, np.ndarray]:
    """A scene, the returns (n, 3) of some sweeps in the map, and their truth."""
    scene = draw_scene(settings)
    world = World(scene.mesh, scene.walkers)
    traced = [scan(world, scene.lidars[lidar], scene.trajectory, k, settings, scene.ring_bias_m[lidar]) for k in sweeps]
    points = np.concatenate([returns_in_map(scene, sweep, lidar) for sweep in traced])
    truth = np.concatenate([sweep.truth for sweep in traced])
    return scene, points[truth != NO_RETURN], truth[truth != NO_RETURN]


def features(scene: Scene, kind: str) -> list[dict]:
    return [f for f in scene.truth["features"] if f["properties"]["kind"] == kind]


@pytest.fixture(scope="module")
def exact() -> tuple[Scene, np.ndarray, np.ndarray]:
    """A drive in and out of rooms without any error of measurement, every 15th sweep."""
    settings = SimulationSettings(
        building="office",
        seed=4,
        duration_s=50,
        sensor="vlp16",
        noise_m=0,
        ring_bias_m=0,
        mixed_share=0,
        closed_share=0.5,
    )
    return trace(settings, range(0, 480, 15))


@pytest.mark.parametrize(("container", "path"), [("bag", "drive.bag"), ("mcap", "drive"), ("db3", "drive")])
def test_a_bag_can_be_read_back(container: str, path: str, tmp_path: Path) -> None:
    settings = SimulationSettings(building="small", seed=1, sensor="vlp16", format=container, duration_s=0.75)
    report = simulate(tmp_path / path, settings)
    assert [p.name for p in tmp_path.iterdir()] == [path]
    counts: Counter[str] = Counter()
    messages: dict[str, list] = {}
    with AnyReader([tmp_path / path]) as reader:
        last = 0
        for connection, log_time_ns, raw in reader.messages():
            assert log_time_ns >= last
            last = log_time_ns
            counts[connection.topic] += 1
            messages.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    assert counts["/tf_static"] == counts["/truth/building"] == 1
    assert counts["/truth/pose"] >= 70
    assert counts["/truth/classes"] == counts["/vertical_velodyne/velodyne_points"] >= 6
    assert {topic: counts[topic] for topic in report.clouds} == report.clouds
    for cloud, classes in zip(messages["/vertical_velodyne/velodyne_points"], messages["/truth/classes"], strict=True):
        assert [(f.name, f.offset, f.datatype) for f in cloud.fields] == [
            ("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)
        ]  # fmt: skip
        assert (cloud.point_step, cloud.height, cloud.is_dense) == (22, 1, True)
        assert len(cloud.data) == 22 * cloud.width
        assert classes.header.stamp == cloud.header.stamp
        assert len(classes.data) == cloud.width
        assert classes.data.max() <= max(Truth)
        rows = np.frombuffer(
            cloud.data.tobytes(), [("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")]
        )
        assert rows["time"].min() >= 0
        assert 0.09 < rows["time"].max() < 0.101
        elevation = np.degrees(np.arcsin(rows["xyz"][:, 2] / np.linalg.norm(rows["xyz"], axis=1)))
        assert np.allclose(elevation, -15 + 2.0 * rows["ring"], atol=0.01)
    frames = {t.child_frame_id: t for t in messages["/tf_static"][0].transforms}
    assert set(frames) == {"horizontal_velodyne", "vertical_velodyne"}
    assert {t.header.frame_id for t in frames.values()} == {"base_link"}
    kinds = {f["properties"]["kind"] for f in json.loads(messages["/truth/building"][0].data)["features"]}
    assert {"wall", "door", "room"} <= kinds


@pytest.mark.parametrize(
    ("lidars", "labelled"),
    [("three", ["left_velodyne", "right_velodyne"]), ("upright", ["front_velodyne", "rear_velodyne"])],
)
def test_each_lidar_that_is_labelled_has_its_truth(lidars: str, labelled: list[str], tmp_path: Path) -> None:
    values = {"building": "small", "seed": 1, "sensor": "vlp16", "lidars": lidars, "duration_s": 0.5}
    simulate(tmp_path / "drive.bag", SimulationSettings.model_validate(values))
    with AnyReader([tmp_path / "drive.bag"]) as reader:
        read: dict[str, list] = {}
        for connection, _, raw in reader.messages():
            read.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    assert {topic for topic in read if topic.startswith("/truth/classes")} == {"/truth/classes", "/truth/classes_2"}
    for topic, frame in zip(("/truth/classes", "/truth/classes_2"), labelled, strict=True):
        for classes, cloud in zip(read[topic], read[f"/{frame}/velodyne_points"], strict=True):
            assert classes.header == cloud.header
            assert classes.header.frame_id == frame
            assert classes.width == cloud.width
    # No two lidars err alike.
    first, second = (read[f"/{frame}/velodyne_points"][0] for frame in labelled)
    assert first.data.tobytes() != second.data.tobytes()


def test_ouster_clouds_are_organised_with_zeros(tmp_path: Path) -> None:
    settings = SimulationSettings(building="small", sensor="os1-16", duration_s=0.4, dropout=0.1)
    simulate(tmp_path / "drive.bag", settings)
    with AnyReader([tmp_path / "drive.bag"]) as reader:
        wanted = [c for c in reader.connections if c.topic in ("/vertical_ouster/points", "/truth/classes")]
        read = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)]
    cloud, classes = read[:2]
    assert (cloud.height, cloud.width, cloud.point_step) == (16, 1024, 48)
    rows = cloud.data.reshape(-1, 48)
    empty = rows[:, 32:36].copy().view("<u4")[:, 0] == 0
    assert 0.05 < empty.mean() < 0.5
    assert not rows[empty, :12].copy().view("<f4").any()
    assert np.array_equal(classes.data == NO_RETURN, empty)
    assert np.array_equal(rows[:, 26].reshape(16, 1024), np.repeat(np.arange(16), 1024).reshape(16, 1024))


def test_the_same_settings_make_the_same_bag(tmp_path: Path) -> None:
    settings = SimulationSettings(building="small", seed=5, sensor="vlp16", duration_s=0.75, walking_people=1)
    bags = [tmp_path / name for name in ("one.bag", "two.bag", "other.bag")]
    simulate(bags[0], settings.model_copy(update={"workers": 1}))
    simulate(bags[1], settings.model_copy(update={"workers": 3}))
    simulate(bags[2], settings.model_copy(update={"seed": 6}))
    one, two, other = (bag.read_bytes() for bag in bags)
    assert one == two
    assert one != other


def test_floor_lies_at_zero_and_ceilings_at_their_heights(exact: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    scene, points, truth = exact
    assert np.abs(points[truth == Truth.FLOOR, 2]).max() < 0.01
    heights = np.array([room["properties"]["ceiling"] for room in features(scene, "room")])
    ceiling = points[truth == Truth.CEILING, 2]
    assert len(ceiling) > 1000
    assert np.abs(ceiling[:, None] - heights).min(1).max() < 0.01


def test_wall_returns_lie_on_the_true_faces(exact: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    scene, points, truth = exact
    faces = [shapely.LineString(f["geometry"]["coordinates"]) for f in features(scene, "wall")]
    doors = [shapely.LineString(f["geometry"]["coordinates"]).buffer(0.3) for f in features(scene, "door")]
    panes = [shapely.LineString(f["geometry"]["coordinates"]).buffer(0.5) for f in features(scene, "glass")]
    low = (truth == Truth.WALL) & (points[:, 2] < 0.7)
    openings = shapely.union_all(doors + panes)
    wall = points[low][~shapely.contains_xy(openings, points[low, :2])]
    assert len(wall) > 5000
    distance = shapely.distance(shapely.union_all(faces), shapely.points(wall[:, :2]))
    assert np.quantile(distance, 0.999) < 0.01


def test_closed_leaves_stand_behind_the_wall_as_far_as_said(exact: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    scene, points, truth = exact
    leaf = points[truth == Truth.DOOR]
    seen = 0
    for door in scene.plan.doors:
        if not door.closed or door.rooms[0] != "corridor":
            continue
        along, behind, z = at_door(scene, door, leaf)
        here = (np.abs(along) < door.width_m / 2 + 0.01) & (np.abs(behind) < 0.3)
        flush = here & ((z < 1.0) | (z > 1.1))  # not the lever
        if np.count_nonzero(flush) < 200:
            continue
        seen += 1
        assert np.median(behind[flush]) == pytest.approx(door.recess_m, abs=0.005)
        assert 0.03 <= door.recess_m <= 0.06
        assert z[here].max() < door.top_m + 0.01
    assert seen >= 2


def at_door(scene: Scene, door: Door, points_map: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Metres along the wall from the doorway's middle, behind the front face, and above the floor."""
    T_map_spot = scene.T_map_plan @ transforms.from_yaw(door.spot.yaw, [door.spot.x, door.spot.y, 0.0])
    local = transforms.apply(transforms.invert(T_map_spot), points_map)
    return local[:, 0], door.depth[1] - local[:, 1], local[:, 2]


def test_the_map_begins_below_the_base(exact: tuple[Scene, np.ndarray, np.ndarray]) -> None:
    trajectory = exact[0].trajectory
    assert np.allclose(trajectory.T_map_base[0], np.eye(4), atol=1e-3)
    at_rest = trajectory.T_map_base[trajectory.stamp_ns < 0.3e9]
    assert np.allclose(at_rest, at_rest[0], atol=2e-3)


def test_glass_lets_through_mirrors_and_seldom_returns() -> None:
    settings = SimulationSettings(building="small", seed=2, duration_s=25, sensor="vlp16", glass=1.0, noise_m=0)
    scene, points, truth = trace(settings, range(0, 240, 10))
    indoors = shapely.Polygon(transforms.apply(scene.T_map_plan, np.array(
        [[*p, 0.0] for p in scene.plan.footprint.exterior.coords]))[:, :2])  # fmt: skip
    inside = shapely.contains_xy(indoors.buffer(-0.4), points[:, :2])
    pane, beyond = truth == Truth.GLASS, truth == Truth.OUTSIDE
    assert np.count_nonzero(beyond & ~inside) > 3 * np.count_nonzero(pane) > 0
    assert not np.any((truth <= Truth.DOOR) & ~shapely.contains_xy(indoors.buffer(0.05), points[:, :2]))


def test_intensities_tell_materials_apart_and_fall_with_the_angle_of_incidence() -> None:
    settings = SimulationSettings(
        building="small", seed=2, duration_s=10, sensor="vlp16", noise_m=0, ring_gain=0, intensity_noise=0
    )
    scene = draw_scene(settings)
    world = World(scene.mesh)
    sweep = scan(world, scene.lidars[1], scene.trajectory, 20, settings, scene.ring_bias_m[1])
    noisy = settings.model_copy(update={"ring_gain": 0.05, "intensity_noise": 0.05})
    other = scan(world, scene.lidars[1], scene.trajectory, 20, noisy, scene.ring_bias_m[1])
    np.testing.assert_array_equal(sweep.points_sensor, other.points_sensor)  # ranges are the same
    own = sweep.truth == Truth.WALL
    assert 0.03 < np.std(other.intensity[own] / sweep.intensity[own]) < 0.1
    floor, wall = sweep.intensity[sweep.truth == Truth.FLOOR], sweep.intensity[own]
    assert floor.max() < 0.75 * wall.max()
    assert wall.min() < 0.75 * wall.max()


def test_walking_people_walk() -> None:
    settings = SimulationSettings(building="office", seed=3, duration_s=10, sensor="vlp16", walking_people=6, clutter=0)
    scene, points, truth = trace(settings, range(0, 90, 6), lidar=0)
    assert len(scene.walkers) == 6
    people = points[truth == Truth.PERSON]
    assert len(people) > 50
    assert people[:, 2].max() < 1.95


@pytest.mark.parametrize("building", BUILDINGS)
@pytest.mark.parametrize("seed", [1, 2])
def test_the_robot_keeps_clear_of_everything(building: str, seed: int) -> None:
    settings = SimulationSettings(building=building, seed=seed, duration_s=120, clutter=1.0)
    scene = draw_scene(settings)
    T_plan_base = transforms.invert(scene.T_map_plan) @ scene.trajectory.T_map_base
    path = shapely.points(T_plan_base[::5, :2, 3])
    free = scene.plan.free.difference(scene.furniture)
    assert shapely.contains_properly(free, path).all()
    assert shapely.distance(free.boundary, path).min() > ROBOT_RADIUS_M - 0.03
    step = np.linalg.norm(np.diff(T_plan_base[:, :2, 3], axis=0), axis=1) * 100
    turn = np.diff(np.unwrap(np.arctan2(T_plan_base[:, 1, 0], T_plan_base[:, 0, 0]))) * 100
    assert step.max() < 0.62
    assert np.abs(turn).max() < 0.65
    visited = [room for room in scene.plan.rooms[1:] if shapely.contains_xy(room.interior, T_plan_base[:, :2, 3]).any()]
    assert visited
    passed = sum(
        np.linalg.norm(T_plan_base[:, :2, 3] - [door.spot.x, door.spot.y], axis=1).min() < 3.0
        for door in scene.plan.doors if door.rooms[0] == "corridor"
    )  # fmt: skip
    assert passed >= 0.8 * sum(door.rooms[0] == "corridor" for door in scene.plan.doors)


def test_a_slope_and_a_ramp_lift_the_floor_and_the_robot() -> None:
    settings = SimulationSettings(
        building="office", duration_s=30, sensor="vlp16", noise_m=0, ramp_rise_m=0.3, floor_slope_deg=0.5, sway_deg=0
    )
    scene, points, truth = trace(settings, range(0, 290, 40))
    base = scene.trajectory.T_map_base[:, :3, 3]
    assert np.ptp(base[:, 2]) > 0.2
    floor = points[truth == Truth.FLOOR]
    distance, nearest = cKDTree(base[:, :2]).query(floor[:, :2])
    beside = distance < 0.2
    assert np.count_nonzero(beside) > 100
    assert np.abs(floor[beside, 2] - base[nearest[beside], 2]).max() < 0.03


def test_unknown_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'office'"):
        simulate(tmp_path / "drive.bag", SimulationSettings(building="ofice"))
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValidationError, match="sensor"):
        SimulationSettings(sensor="hdl64")  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="clutterr"):
        SimulationSettings(clutterr=0.5)  # type: ignore[call-arg]
    (tmp_path / "drive.bag").touch()
    with pytest.raises(InputError, match="exists already"):
        simulate(tmp_path / "drive.bag", SimulationSettings())
    theirs = tmp_path / "other.bag.part"
    theirs.mkdir()
    (theirs / "thesis.txt").touch()
    simulate(tmp_path / "other.bag", SimulationSettings(building="small", sensor="vlp16", duration_s=1.0))
    assert (theirs / "thesis.txt").exists()
