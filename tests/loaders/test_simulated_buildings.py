"""Simulated buildings: closed rooms, clear ways, the class and place of every part."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import shapely

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Truth
from ffmap.loaders.simulator import PRESETS, SimulationSettings
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M
from ffmap.loaders.simulator.raytrace import World
from ffmap.loaders.simulator.simulate import Scene, draw_scene


def scene_of(building: str, seed: int = 1, **values: Any) -> Scene:
    given = {"duration_s": 20, "clutter": 0.0, **values}
    return draw_scene(SimulationSettings(building=building, seed=seed, **given))


Cast = Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]


def caster(scene: Scene) -> Cast:
    """Return a function that casts rays (n, 3) of the plan.

    It returns the distance (n,) and class (n,), -1 for nothing.
    """
    world = World(scene.mesh)

    def cast(origins: Any, directions: Any) -> tuple[np.ndarray, np.ndarray]:
        origins, directions = np.atleast_2d(origins).astype(float), np.atleast_2d(directions)
        directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        at = transforms.apply(scene.T_map_plan, origins)
        distance, triangle = world.nearest(at, directions @ scene.T_map_plan[:3, :3].T)
        truth = scene.mesh.faces["truth"][triangle].astype(int)
        return distance, np.where(triangle >= 0, truth, -1)

    return cast


def before(spot: Any, x: float, y: float, *heights: float) -> np.ndarray:
    """Return places (n, 3) in front of a spot."""
    return spot.to_plan([[x, y, z] for z in heights])


def into(spot: Any, count: int = 1) -> np.ndarray:
    """Return the direction against a spot's y, `count` times."""
    return np.tile([np.sin(spot.yaw), -np.cos(spot.yaw), 0.0], (count, 1))


@pytest.mark.parametrize("building", PRESETS)
def test_rooms_are_closed_and_the_way_is_clear(building: str) -> None:
    scene = scene_of(building, duration_s=120, clutter=1.0)
    plan, cast, rng = scene.plan, caster(scene), np.random.default_rng(1)
    T_plan_base = transforms.invert(scene.T_map_plan) @ scene.trajectory.T_map_base
    places = T_plan_base[:, :2, 3]
    for room in plan.rooms:
        place = plan.free.intersection(room.interior).buffer(-0.05).representative_point()
        rays = rng.normal(size=(1000, 3))
        _, truth = cast(np.tile([place.x, place.y, 1.6], (1000, 1)), rays)
        assert not np.isin(truth, [-1, Truth.OUTSIDE]).any(), room.name
    free, path = plan.free.difference(scene.furniture).buffer(0), shapely.points(places[::5])
    assert shapely.contains_properly(free, path).all()
    assert shapely.distance(free.boundary, path).min() > ROBOT_RADIUS_M - 0.03
    yaw = np.unwrap(np.arctan2(T_plan_base[:, 1, 0], T_plan_base[:, 0, 0]))
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() * 100 < 0.62
    assert np.abs(np.diff(yaw)).max() * 100 < 0.65
    assert any(shapely.contains_xy(room.interior, places).any() for room in plan.rooms[1:])
    doors = [door.spot for door in plan.doors if door.rooms[0] == 0]
    passed = [np.linalg.norm(places - [own.x, own.y], axis=1).min() < 3.0 for own in doors]
    assert sum(passed) >= 0.8 * len(doors)
    assert len({door.rooms[1] for door in plan.doors if door.rooms[0] == 0}) >= 2


@pytest.mark.parametrize(
    ("place", "recess_m"),
    [("flush", 0.0), ("middle", 0.08), ("recessed", 0.12), ("flush behind", 0.16)],
)
def test_a_closed_leaf_is_where_the_settings_place_it(place: str, recess_m: float) -> None:
    scene = scene_of(
        "office", leaf=place, recess_m=0.12, wall_thickness_m=0.2, door_head_m=2.4, door="hinged",
        ceiling_m=3.0, closed_share=1.0, glazed_share=0
    )  # fmt: skip
    doors, cast = [door for door in scene.plan.doors if door.rooms[0] == 0], caster(scene)
    assert len(doors) >= 3
    assert {room.ceiling_m for room in scene.plan.rooms} == {3.0}
    for door in doors:
        origins = before(door.spot, 0.0, door.depth[1] + 0.4, 0.5, 2.37, 2.43)
        distance, truth = cast(origins, into(door.spot, 3))
        assert truth.tolist() == [Truth.DOOR, Truth.DOOR, Truth.WALL]
        assert np.allclose(distance, [0.4 + recess_m, 0.4 + recess_m, 0.4], atol=1e-3)


def test_a_sliding_leaf_is_in_front_of_its_wall_and_a_glazed_one_has_a_pane() -> None:
    scene = scene_of("office", door="sliding", glazed_share=1.0, closed_share=1.0)
    cast = caster(scene)
    for door in scene.plan.doors:
        origins = before(door.spot, 0.0, door.depth[1] + 0.5, 1.3, 0.15)
        distance, truth = cast(origins, into(door.spot, 2))
        assert truth.tolist() == [Truth.GLASS, Truth.DOOR]
        assert distance[1] == pytest.approx(0.44, abs=1e-3)
    scene = scene_of("office", door="opening", closed_share=1.0)
    assert not any(door.closed or door.leaf_areas for door in scene.plan.doors)


@pytest.mark.parametrize("shape", ["soffit", "beams", "coffered", "sloping", "gable", "vault"])
def test_ceilings_are_as_high_as_stated_and_what_hangs_from_them_is_ceiling(shape: str) -> None:
    scene = scene_of("institution", ceiling=shape, ceiling_m=(3.0, 5.0), built="nothing")
    rooms, cast, rng = scene.plan.rooms, caster(scene), np.random.default_rng(1)
    assert sum(room.ceiling.shape == shape for room in rooms) > 0.7 * len(rooms)
    for room in rooms:
        place = shapely.points(rng.uniform(*np.reshape(room.interior.bounds, (2, 2)), (40, 2)))
        place = place[shapely.contains(room.interior.buffer(-0.1), place)]
        expected = room.ceiling.height(shapely.get_coordinates(place))
        expected -= np.where(shapely.contains(room.ceiling.drops, place), room.ceiling.drop_m, 0)
        origins = np.c_[shapely.get_coordinates(place), np.full(len(place), 1.5)]
        distance, truth = cast(origins, np.tile([0, 0, 1], (len(place), 1)))
        free = truth != Truth.CLUTTER  # Lamps and ducts
        assert (truth[free] == Truth.CEILING).all()
        assert np.allclose(distance[free], expected[free] - 1.5, atol=2e-3)


def test_built_in_parts_have_their_classes() -> None:
    built = ["round corner", "niche", "pillar", "half wall", "leaning wall", "steps"]
    seen: set[str] = set()
    for seed in range(6):
        values = {"ceiling": "flat", "built": built, "step_m": 0.3, "wall_thickness_m": 0.3}
        scene = scene_of("institution", seed, **values)
        cast = caster(scene)
        for niche in scene.plan.niches:
            z = (niche.bottom_m + niche.top_m) / 2
            distance, truth = cast(before(niche.spot, 0.0, -0.001, z), into(niche.spot))
            assert truth[0] == Truth.WALL
            assert distance[0] == pytest.approx(-niche.depth[0], abs=5e-3)
            seen.add("niche")
        for part in scene.plan.parts:
            seen.add(part.name)
            place = part.shadow.representative_point()
            if part.top is not None:
                _, truth = cast([place.x, place.y, 0.01], [0, 0, 1])
                assert truth[0] == part.truth
            elif part.z[1] < 2.0:
                distance, truth = cast([place.x, place.y, 2.04], [0, 0, -1])
                assert truth[0] == part.truth
                assert distance[0] <= 2.04 - part.z[1] + 1e-3
            else:
                _, truth = cast([place.x, place.y, 1.0], [1, 0, 0])
                assert truth[0] == part.truth == Truth.WALL
    assert seen >= {"niche", "pillar", "half-height wall", "leaning wall", "stairs", "platform"}
    assert "round wall" in seen


def test_the_truth_states_designs_and_elements() -> None:
    scene = scene_of("institution", 2, built="half wall")
    features = [feature["properties"] for feature in scene.truth["features"]]
    doors = [own for own in features if own["kind"] == "door"]
    assert len(doors) == len(scene.plan.doors)
    assert all(own["design"] and own["wall_thickness"] > 0 for own in doors)
    assert all(own["leaves"] for own in doors if own["state"] == "closed")
    elements = {own["element"] for own in features if own["kind"] == "element"}
    assert "half-height wall" in elements
    assert any(name.startswith("ceiling, ") for name in elements)
