"""Simulate a drive: draw and furnish a building, drive through it, write a bag."""

import json
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from heapq import merge
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.numbered import numbered
from ffmap.loaders.simulator.bag_writing import DriveWriter
from ffmap.loaders.simulator.built_in import build_in, draw_plan
from ffmap.loaders.simulator.furniture import furnish
from ffmap.loaders.simulator.mesh import Mesh, MeshBuilder, Rng
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M, choose_route, draw_ways, drive
from ffmap.loaders.simulator.plan import Plan
from ffmap.loaders.simulator.raytrace import Sweep, Walker, World, scan
from ffmap.loaders.simulator.sensors import LAYOUTS, Lidar, draw_lidars, rig_of
from ffmap.loaders.simulator.settings import SimulationSettings
from ffmap.loaders.simulator.structure import build_outside, build_structure
from ffmap.loaders.simulator.terrain import Terrain, draw_terrain
from ffmap.loaders.simulator.truth import building_truth
from ffmap.loaders.truth import BUILDING_TOPIC, CLASSES_TOPIC, POSE_TOPIC

EPOCH_NS = 1_700_000_000_000_000_000  # Start of every simulated drive

_CLEARANCE_M = 0.15  # Between furniture and the robot
_PACKET_COLUMNS = 12
_PACKET_DELAY_NS = 400_000  # From a packet's last firing to the recorder

_Timed = tuple[int, str, Any]
"""Time since the first horizontal sweep (ns) at which a message is recorded, topic, message."""


@dataclass(frozen=True)
class Scene:
    """Everything that exists before the first ray.

    mesh, trajectory (T_map_base, stamps from the first horizontal sweep) and truth (GeoJSON) are in
    the map's frame. furniture: the floor it covers, in the plan's frame.
    """

    plan: Plan
    mesh: Mesh
    furniture: BaseGeometry
    walkers: tuple[Walker, ...]
    base_frame: str
    lidars: tuple[Lidar, ...]
    trajectory: Trajectory
    T_map_plan: FloatArray
    truth: dict[str, Any]


def draw_scene(settings: SimulationSettings) -> Scene:
    """Draw the building, furniture, people, lidars and drive from the settings and their seed."""
    # One stream for each part, so that one more door does not move every chair.
    plan_rng, structure_rng, furniture_rng, outside_rng, drive_rng, sensor_rng = (
        np.random.default_rng([settings.seed, part]) for part in range(6)
    )
    layout, lidars = LAYOUTS.get(settings.layout), draw_lidars(settings, sensor_rng)
    plan = draw_plan(settings, plan_rng)
    ways = draw_ways(plan, plan_rng)
    clear = ways.area(ROBOT_RADIUS_M + _CLEARANCE_M)
    plan = build_in(plan, clear, settings, plan_rng)
    terrain = draw_terrain(plan.corridor, settings, plan_rng)

    builder = MeshBuilder()
    build_structure(plan, builder, structure_rng)
    build_outside(plan, builder, outside_rng)
    furniture = furnish(plan, clear, settings.clutter, builder, furniture_rng)

    longest_s = settings.duration_s + 2 * max(lidar.period_ns for lidar in lidars) / 1e9
    level = drive(choose_route(ways, settings), longest_s, settings, drive_rng)
    driven = terrain.lift_drive(level)
    first = driven.T_map_base[0]
    T_map_plan = transforms.invert(transforms.from_yaw(transforms.yaw_of(first), first[:3, 3]))
    height_m = layout.base_height_m if layout else 0.0
    T_floor_base = transforms.make_transform(translation=[0.0, 0.0, height_m])
    lifted = terrain.lift_mesh(builder.build())
    avoid = furniture.union(ways.area(ROBOT_RADIUS_M))
    return Scene(
        plan=plan,
        mesh=lifted.warped(lambda vertices: transforms.apply(T_map_plan, vertices)),
        furniture=furniture,
        walkers=_draw_walkers(plan, terrain, avoid, settings, T_map_plan, furniture_rng),
        base_frame=(rig_of(settings.layout).base if layout else None) or "base_link",
        lidars=lidars,
        trajectory=Trajectory(driven.stamp_ns, T_map_plan @ driven.T_map_base @ T_floor_base),
        T_map_plan=T_map_plan,
        truth=building_truth(plan, T_map_plan),
    )


def _draw_walkers(
    plan: Plan, terrain: Terrain, avoid: BaseGeometry, settings: SimulationSettings,
    T_map_plan: FloatArray, rng: Rng
) -> tuple[Walker, ...]:  # fmt: skip
    """Draw people who walk back and forth, clear of furniture and of the robot."""
    space = plan.free.difference(avoid).buffer(-0.25)
    walkers: list[Walker] = []
    for _ in range(2000):
        if space.is_empty or len(walkers) == settings.walking_people:
            break
        start = rng.uniform(*np.reshape(space.bounds, (2, 2)))
        # Half of them beside the robot, along the corridor.
        heading, length = rng.choice([0.0, rng.uniform(0, 2 * np.pi)]), rng.uniform(1.0, 5.0)
        ends = np.array([start, start + length * np.array([np.cos(heading), np.sin(heading)])])
        if space.contains(shapely.LineString(ends)):
            places = transforms.apply(T_map_plan, np.c_[ends, terrain.height(ends)])
            speed, phase, height = rng.uniform([0.7, 0.0, 1.6], [1.4, 1.0, 1.9]).tolist()
            walkers.append(Walker(places[0], places[1], speed, phase, height))
    return tuple(walkers)


def simulate(
    out: Path, settings: SimulationSettings, progress: Callable[[float], None] | None = None
) -> None:
    """Write the bag of one drive: a file (bag) or a folder (mcap, db3).

    progress: called with the share done, 0 to 1. Raises InputError if `out` exists or cannot be
    written.
    """
    with DriveWriter(out, settings.format) as writer:
        scene = draw_scene(settings)
        world, base = World(scene.mesh, scene.walkers), scene.base_frame
        if settings.layout in LAYOUTS:
            # The topics by which the rig is found; their content is not read.
            first = writer.pose(scene.trajectory.T_map_base[0], EPOCH_NS, base)
            for topic in rig_of(settings.layout).with_topics:
                writer.write(topic, first, EPOCH_NS)
        else:
            placed = [
                StaticTransform(base, lidar.frame_id, lidar.T_base_sensor) for lidar in scene.lidars
            ]
            writer.write("/tf_static", writer.transforms(EPOCH_NS, placed), EPOCH_NS, latched=True)
        truth = writer.text(json.dumps(scene.truth))
        writer.write(BUILDING_TOPIC, truth, EPOCH_NS, latched=True)
        due_rng = np.random.default_rng([settings.seed, 72])
        streams: list[Iterable[_Timed]] = [_poses(writer, scene, settings)]
        mapping = [lidar for lidar in scene.lidars if lidar.maps]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for lidar in scene.lidars:
                due_ns = _due(lidar, settings, due_rng)
                traced = _traced(pool, world, scene.trajectory, lidar, due_ns, settings)
                number = mapping.index(lidar) if lidar in mapping else None
                classes = None if number is None else numbered(CLASSES_TOPIC, number)
                streams.append(_clouds(writer, lidar, classes, traced))
            for log_time_ns, topic, message in merge(*streams, key=itemgetter(0)):
                writer.write(topic, message, EPOCH_NS + log_time_ns)
                if progress is not None:
                    progress(min(log_time_ns / (settings.duration_s * 1e9), 1.0))


def _poses(writer: DriveWriter, scene: Scene, settings: SimulationSettings) -> Iterator[_Timed]:
    """Yield the true poses during the drive."""
    stamps, T = scene.trajectory.stamp_ns, scene.trajectory.T_map_base
    during = stamps <= settings.duration_s * 1e9
    for due_ns, pose in zip(stamps[during].tolist(), T[during], strict=True):
        yield due_ns, POSE_TOPIC, writer.pose(pose, EPOCH_NS + due_ns, scene.base_frame)


def _clouds(
    writer: DriveWriter, lidar: Lidar, truth_topic: str | None, traced: Iterable[tuple[int, Sweep]]
) -> Iterator[_Timed]:
    """Yield a lidar's clouds, sweeps or packets, with their classes."""
    for sweep_due_ns, sweep in traced:
        whole = [(sweep_due_ns, sweep)]
        for due_ns, part in _packets(lidar, sweep) if lidar.points == "packets" else whole:
            yield due_ns, lidar.topic, writer.cloud(lidar, part, EPOCH_NS)
            if truth_topic is not None:
                yield due_ns, truth_topic, writer.classes(lidar, part, EPOCH_NS)


def _packets(lidar: Lidar, sweep: Sweep) -> Iterator[tuple[int, Sweep]]:
    """Yield the sweep's UDP packets, each stamped with its first firing."""
    packet_ns = lidar.period_ns * _PACKET_COLUMNS / lidar.model.columns
    number = (sweep.time_ns / packet_ns).astype(int)
    for i in range(lidar.model.columns // _PACKET_COLUMNS):
        first_ns, part = round(i * packet_ns), sweep.only(number == i)
        stamp_ns = sweep.stamp_ns + first_ns
        part = replace(part, time_ns=part.time_ns - first_ns, stamp_ns=stamp_ns)
        yield stamp_ns + round(packet_ns) + _PACKET_DELAY_NS, part


def _due(lidar: Lidar, settings: SimulationSettings, rng: Rng) -> list[int]:
    """Draw when each of a lidar's sweeps that end within the drive is recorded."""
    due_ns: list[int] = []
    while (end_ns := lidar.sweep_start_ns(len(due_ns) + 1)) <= settings.duration_s * 1e9:
        due_ns.append(end_ns + int(rng.uniform(1e6, 6e6)))
    return due_ns


def _traced(
    pool: ThreadPoolExecutor, world: World, trajectory: Trajectory, lidar: Lidar,
    due_ns: list[int], settings: SimulationSettings
) -> Iterator[tuple[int, Sweep]]:  # fmt: skip
    """Yield a lidar's sweeps, a few traced ahead: Embree and NumPy release the interpreter."""
    submitted = (
        (due, pool.submit(scan, world, lidar, trajectory, index, settings))
        for index, due in enumerate(due_ns)
    )
    waiting: deque[tuple[int, Future[Sweep]]] = deque(islice(submitted, os.cpu_count()))
    while waiting:
        due, sweep = waiting.popleft()
        waiting.extend(islice(submitted, 1))
        yield due, sweep.result()
