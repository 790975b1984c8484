"""Buildings drawn from ranges: closed rooms, the class and place of every part, pinned properties, seeds."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pydantic import ValidationError

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import Truth
from ffmap.app.commands.simulate import simulate as simulate_command
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import BUILDINGS, SimulationSettings
from ffmap.loaders.simulator.drawn.elements import DrawnPlan
from ffmap.loaders.simulator.drawn.ranges import KINDS, Ranges
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M
from ffmap.loaders.simulator.raytrace import World
from ffmap.loaders.simulator.simulate import Scene, draw_scene

PLAIN = {
    "ramp_share": 0, "round_share": 0, "bay_share": 0, "niche_share": 0, "lean_share": 0, "half_wall_share": 0,
    "pillar_share": 0, "stairs_share": 0, "platform_share": 0, "soffit_share": 0, "skylight_share": 0,
    "partition_share": 0, "curtain_share": 0, "ceiling": "flat", "ceiling_m": 3.0, "storey_spread_m": 0, "casing_m": 0,
    "full_height_share": 0, "glazed_share": 0, "door_sill_m": 0, "turn_deg": 90, "legs": "one", "skew_m": 0
}  # fmt: skip
"""Nothing but rooms, doors and windows."""


def scene_of(kind: str = "workplace", seed: int = 1, clutter: float = 0.0, closed: float = 0.4, **drawn: Any) -> Scene:
    settings = SimulationSettings(
        building=kind, seed=seed, duration_s=20, sensor="vlp16", clutter=clutter, closed_share=closed,
        drawn=Ranges.model_validate(drawn)
    )  # fmt: skip
    return draw_scene(settings)


def plan_of(scene: Scene) -> DrawnPlan:
    assert isinstance(scene.plan, DrawnPlan)
    return scene.plan


Cast = Callable[[Any, Any], tuple[np.ndarray, np.ndarray]]


def caster(scene: Scene) -> Cast:
    """Casts rays (n, 3) of the plan: the distance (n,) and class (n,) of what they meet; -1 is nothing."""
    world = World(scene.mesh)

    def cast(origins: Any, directions: Any) -> tuple[np.ndarray, np.ndarray]:
        origins, directions = np.atleast_2d(origins).astype(float), np.atleast_2d(directions).astype(float)
        directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        distance, triangle = world._nearest(
            transforms.apply(scene.T_map_plan, origins).astype(np.float32),
            (directions @ scene.T_map_plan[:3, :3].T).astype(np.float32),
        )
        return distance, np.where(triangle >= 0, scene.mesh.truth[triangle].astype(int), -1)

    return cast


def before(spot: Any, x: float, y: float, z: float) -> np.ndarray:
    """A place in front of a spot."""
    return spot.to_plan(np.array([[x, y, z]]))[0]


def into(spot: Any) -> np.ndarray:
    """The direction against a spot's y."""
    return np.array([np.sin(spot.yaw), -np.cos(spot.yaw), 0.0])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 4, 9])
def test_rooms_are_closed_and_the_way_is_clear(kind: str, seed: int) -> None:
    level = Ranges(ramp_share=0.0)
    scene = draw_scene(SimulationSettings(building=kind, seed=seed, duration_s=60, speed_mps=0.8, clutter=0.5, drawn=level))
    plan, rng, cast = plan_of(scene), np.random.default_rng(seed), caster(scene)
    for room in plan.rooms:
        stand = plan.free.intersection(room.interior).buffer(-0.05)
        place = stand.representative_point()
        origins = np.tile([place.x, place.y, 1.6], (2000, 1))
        _, truth = cast(origins, rng.normal(size=(2000, 3)))
        assert not np.isin(truth, [-1, Truth.OUTSIDE]).any(), room.name
    T_plan_base = transforms.invert(scene.T_map_plan) @ scene.trajectory.T_map_base
    path = shapely.points(T_plan_base[::10, :2, 3])
    free = plan.free.difference(scene.furniture)
    assert shapely.contains_properly(free, path).all()
    assert shapely.distance(free.boundary, path).min() > ROBOT_RADIUS_M - 0.03
    assert any(shapely.contains_xy(room.interior, T_plan_base[:, :2, 3]).any() for room in plan.rooms[1:])


@pytest.mark.parametrize(("place", "recess_m"), [("flush", 0.0), ("middle", 0.08), ("recessed", 0.12), ("flush behind", 0.16)])
def test_a_closed_leaf_stands_in_its_wall_where_it_is_said_to(place: str, recess_m: float) -> None:
    own = {**PLAIN, "leaf": place, "recess_m": 0.12, "inner_wall_m": 0.2, "door_head_m": 2.4, "door": "hinged"}
    scene = scene_of(closed=1.0, **own)
    cast = caster(scene)
    doors = [door for door in plan_of(scene).drawn_doors if door.rooms[0] == "corridor"]
    assert len(doors) >= 3
    for door in doors:
        front = door.depth[1]
        distance, truth = cast(
            [before(door.spot, 0.0, front + 0.4, z) for z in (0.5, 2.37, 2.43)],
            [into(door.spot)] * 3,
        )
        assert truth.tolist() == [Truth.DOOR, Truth.DOOR, Truth.WALL]
        assert np.allclose(distance, [0.4 + recess_m, 0.4 + recess_m, 0.4], atol=1e-3)


def test_doors_without_a_leaf_are_open_and_arches_have_round_heads() -> None:
    scene = scene_of(closed=1.0, door="arch", door_head_m=2.2, **{k: v for k, v in PLAIN.items() if k != "door"})
    cast = caster(scene)
    for door in plan_of(scene).drawn_doors:
        assert not door.closed
        assert door.leaf_areas() == []
        y = door.depth[1] + 0.4
        middle, corner = before(door.spot, 0.0, y, 2.15), before(door.spot, door.width_m / 2 - 0.03, y, 2.15)
        distance, truth = cast([middle, corner], [into(door.spot)] * 2)
        assert truth[1] == Truth.WALL
        assert distance[1] == pytest.approx(0.4, abs=1e-3)
        assert distance[0] > 0.4 + door.depth[1] - door.depth[0]


def test_a_sliding_leaf_hangs_before_its_wall_and_a_glazed_one_has_a_pane() -> None:
    scene = scene_of(closed=1.0, **{**PLAIN, "door": "sliding", "glazed_share": 1.0})
    cast = caster(scene)
    door = next(door for door in plan_of(scene).drawn_doors if door.rooms[0] == "corridor")
    y = door.depth[1] + 0.5
    distance, truth = cast(
        [before(door.spot, x, y, z) for x, z in ((0.0, 1.3), (0.0, 0.15))], [into(door.spot)] * 2
    )
    assert truth.tolist() == [Truth.GLASS, Truth.DOOR]
    assert distance[1] == pytest.approx(0.44, abs=1e-3)


def test_ceilings_hang_as_high_as_they_say_and_what_hangs_from_them_is_ceiling() -> None:
    shapes = set()
    for seed in range(12):
        # In nobody's way: no lamps and ducts under what is not flat, so rays go up from anywhere.
        scene = scene_of("institution", seed, **{**PLAIN, "ceiling": KINDS["institution"].ceiling, "ceiling_m": (3.0, 5.0)})
        cast = caster(scene)
        for room in plan_of(scene).drawn_rooms:
            place = room.interior.representative_point()
            expected = float(room.ceiling.height(np.array([[place.x, place.y]]))[0])
            expected -= max((d.drop_m for d in room.ceiling.drops if d.area.contains(place)), default=0.0)
            if room.ceiling.shape != "flat":
                distance, truth = cast([place.x, place.y, 1.5], [0, 0, 1])
                if truth[0] != Truth.CLUTTER:  # a pendant lamp
                    assert truth[0] == Truth.CEILING, room.ceiling.shape
                    assert distance[0] == pytest.approx(expected - 1.5, abs=2e-3)
                    shapes.add(room.ceiling.shape)
    assert shapes >= {"stepped", "coffered", "beams", "sloping", "gable", "vault"}


def test_built_parts_have_their_classes() -> None:
    seen: set[str] = set()
    for seed in range(8):
        scene = scene_of("institution", seed, ceiling_m=3.0, storey_spread_m=0, flight_m=0.7, half_wall_share=1.0,
                         niche_share=1.0, pillar_share=1.0, platform_share=1.0,
                         lean_share=1.0, lean_deg=12.0, stairs_share=1.0, ceiling="flat", soffit_share=0, skylight_share=0,
                         inner_wall_m=0.3, ramp_share=0, curtain_share=0, picture_share=0)  # fmt: skip
        plan, cast = plan_of(scene), caster(scene)
        down, up = [0, 0, -1], [0, 0, 1]
        for wall in plan.half_walls:
            middle = wall.area.centroid
            distance, truth = cast([middle.x, middle.y, wall.height_m + 0.1], down)
            assert truth[0] == Truth.WALL
            assert distance[0] == pytest.approx(0.1, abs=1e-3)
            seen.add("half wall")
        for column in plan.columns:
            middle = column.centroid
            _, truth = cast([middle.x, middle.y, 1.0], [1, 0, 0])
            assert truth[0] == Truth.WALL
            seen.add("pillar")
        for niche in plan.niches:
            z = (niche.bottom_m + niche.top_m) / 2
            distance, truth = cast(before(niche.spot, 0.0, -0.001, z), into(niche.spot))
            assert truth[0] == Truth.WALL
            assert distance[0] == pytest.approx(-niche.depth[0], abs=5e-3)
            seen.add("niche")
        for wall in plan.leaning:
            distance, truth = cast(before(wall.spot, 0.0, 0.9, 1.0), into(wall.spot))
            assert truth[0] == Truth.WALL
            assert distance[0] == pytest.approx(0.9 - np.tan(np.radians(12.0)), abs=2e-3)
            seen.add("leaning")
        for flight in plan.flights:
            x, y, _ = before(flight.spot, 0.5 * flight.going_m, flight.width_m / 2, 0.0)
            distance, truth = cast([x, y, 1.0], down)
            assert truth[0] == Truth.FLOOR
            assert distance[0] == pytest.approx(1.0 - flight.riser_m, abs=1e-3)
            x, y, _ = before(flight.spot, (flight.steps - 0.5) * flight.going_m, flight.width_m / 2, 0.0)
            room = next(r for r in plan.drawn_rooms if r.ceiling.wells)
            distance, truth = cast([x, y, room.ceiling_m + 0.3], up)
            assert truth[0] == Truth.CEILING  # of the stairwell
            seen.add("stairs")
        if plan.podium is not None:
            middle = plan.podium.representative_point()
            distance, truth = cast([middle.x, middle.y, plan.podium_m + 0.1], down)
            assert (truth[0], distance[0]) == (Truth.FLOOR, pytest.approx(0.1, abs=1e-3))
            seen.add("platform")
    assert seen == {"half wall", "pillar", "niche", "leaning", "stairs", "platform"}


def test_windows_stand_where_they_say_and_ribbons_have_mullions() -> None:
    scene = scene_of(**{**PLAIN, "window": "ribbon", "sill_m": 0.9, "head_gap_m": 0.3, "blind_share": 0})
    windows, cast = plan_of(scene).drawn_windows, caster(scene)
    assert len(windows) >= 4
    for window in windows:
        x = 0.25 * window.width_m + 0.013
        places = [before(window.spot, x, window.depth[1] + 0.3, z) for z in (0.85, 1.8, 2.75)]
        distance, truth = cast(places, [into(window.spot)] * 3)
        assert (truth[0], truth[2]) == (Truth.WALL, Truth.WALL)
        near_mullion = any(abs(x - m) < window.frame_m for m in window.mullions)
        assert near_mullion or truth[1] == Truth.GLASS
        assert np.allclose(distance[[0, 2]], 0.3, atol=1e-3)
        for mullion in window.mullions:
            _, truth = cast(before(window.spot, mullion, window.depth[1] + 0.3, 1.8), into(window.spot))
            assert truth[0] == Truth.WALL


def test_a_pinned_property_holds_everywhere() -> None:
    plan = plan_of(scene_of("dwelling", 3, **{**PLAIN, "door_head_m": 2.5, "inner_wall_m": 0.15, "door": "double"}))
    assert plan.doors
    assert {door.top_m for door in plan.doors} == {2.5}
    assert {round(door.depth[1] - door.depth[0], 6) for door in plan.doors} == {0.15}
    assert {door.leaves for door in plan.doors} == {2}
    assert {room.ceiling_m for room in plan.rooms} == {3.0}


def test_the_truth_tells_designs_and_elements() -> None:
    scene = scene_of("institution", 2, half_wall_share=1.0)
    features = [feature["properties"] for feature in scene.truth["features"]]
    doors = [own for own in features if own["kind"] == "door"]
    assert len(doors) == len(scene.plan.doors)
    assert all(own["design"] and own["wall_thickness"] > 0 for own in doors)
    assert all(own["leaves"] for own in doors if own["state"] == "closed")
    elements = {own["element"] for own in features if own["kind"] == "element"}
    assert "half-height wall" in elements
    assert any(name.startswith("ceiling, ") for name in elements)


def test_the_same_seed_draws_the_same_building() -> None:
    one, two, other = (scene_of("dwelling", seed, 0.5) for seed in (5, 5, 6))
    assert np.array_equal(one.mesh.triangles, two.mesh.triangles)
    assert one.truth == two.truth
    assert one.truth != other.truth


@pytest.mark.parametrize(
    ("building", "triangles", "centre_m", "reflectivity"),
    [
        ("small", 9384, 3.706804, 0.4370604),
        ("office", 23966, 5.262686, 0.5196324),
        ("angled", 19137, 4.838047, 0.5096731),
        ("ell", 26877, 5.670681, 0.5270622),
        ("lab", 21592, 5.39321, 0.4764773),
    ],
)
def test_earlier_kinds_stay_as_they_were(building: str, triangles: int, centre_m: float, reflectivity: float) -> None:
    mesh = draw_scene(SimulationSettings(building=building, seed=5, duration_s=10, sensor="vlp16")).mesh
    assert len(mesh) == triangles
    assert float(np.abs(mesh.triangles).mean()) == pytest.approx(centre_m, abs=1e-4)
    assert float(mesh.reflectivity.mean()) == pytest.approx(reflectivity, abs=1e-5)
    assert not mesh.gloss.any()
    assert not mesh.pane.any()


def test_what_does_not_fit_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"ceiling_m: dwelling .* say drawn.ceiling_m instead"):
        draw_scene(SimulationSettings(building="dwelling", ceiling_m=3.0))
    with pytest.raises(InputError, match="office is not drawn from ranges"):
        draw_scene(SimulationSettings(building="office", drawn=Ranges(door_head_m=(2.4, 2.4))))
    with pytest.raises(ValidationError, match="begins with its lower end"):
        Ranges(door_head_m=(2.4, 2.0))
    with pytest.raises(InputError, match="dwelling, workplace, institution"):
        draw_scene(SimulationSettings(building="castle"))
    for pitch in (0.0, -1.0, 50.0):
        with pytest.raises(ValidationError, match=r"pitch_m lies between 0\.6 and 7\.2"):
            Ranges(pitch_m=(pitch, pitch))
    with pytest.raises(InputError, match=r"no property 'drawn\.door_heads_m'; .*drawn\.door_head_m"):
        simulate_command(tmp_path / "a.bag", {"building": "dwelling"}, ["drawn.door_heads_m=2.4"])
    with pytest.raises(InputError, match=r"simulate: seed"):
        simulate_command(tmp_path / "a.bag", {"building": "dwelling", "seed": 3}, ["seed.of=2"])
    assert set(KINDS).isdisjoint(BUILDINGS)


def test_a_property_of_the_ranges_is_set_from_the_command_line(tmp_path: Path) -> None:
    values = {"building": "dwelling", "duration_s": 1.0, "sensor": "vlp16", "clutter": 0.0}
    simulate_command(tmp_path / "a.bag", values, ["drawn.door_head_m=2.4", "drawn.leaf=flush", "drawn.ceiling_m=[2.6, 3.0]"])
    assert (tmp_path / "a.bag").stat().st_size > 100_000
