"""One simulated drive: a building is drawn and furnished, the robot drives through it, its lidars fill a bag."""

import json
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.simulator.bag_writing import DriveWriter
from ffmap.loaders.simulator.building import Plan, build_structure
from ffmap.loaders.simulator.furniture import build_outside, furnish
from ffmap.loaders.simulator.mesh import Mesh, MeshBuilder
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M, choose_route, draw_ways, drive
from ffmap.loaders.simulator.plans import draw_plan
from ffmap.loaders.simulator.raytrace import Sweep, Walker, World, scan
from ffmap.loaders.simulator.sensors import Lidar, mount_lidars
from ffmap.loaders.simulator.settings import SimulationSettings
from ffmap.loaders.simulator.terrain import Terrain, draw_terrain
from ffmap.loaders.simulator.truth import building_truth

BASE_FRAME = "base_link"
EPOCH_NS = 1_700_000_000_000_000_000  # When every simulated drive begins

_CLEARANCE_M = 0.15  # Distance between furniture and the robot


@dataclass(frozen=True)
class SimulationReport:
    """What was written. clouds and points: by topic. duration_s: length of the drive."""

    path: Path
    building: str
    rooms: int
    doors: int
    triangles: int
    clouds: dict[str, int]
    points: dict[str, int]
    size_bytes: int
    duration_s: float


@dataclass(frozen=True)
class Scene:
    """Everything there is before the first ray. mesh, trajectory (T_map_base, stamps from the first horizontal sweep)
    and truth (GeoJSON) are in the map's frame. furniture: the floor it covers, in the plan's frame.
    """

    plan: Plan
    mesh: Mesh
    furniture: BaseGeometry
    walkers: tuple[Walker, ...]
    lidars: tuple[Lidar, ...]
    ring_bias_m: tuple[FloatArray, ...]
    trajectory: Trajectory
    T_map_plan: FloatArray
    truth: dict[str, Any]


@dataclass(frozen=True)
class _Job:
    """A message, or two, that are due at `log_time_ns` (from the first horizontal sweep)."""

    log_time_ns: int
    lidar: int
    index: int


def draw_scene(settings: SimulationSettings) -> Scene:
    """Building, furniture, people, lidars and drive, all from the settings and their seed.

    Raises InputError where there is no building of the name.
    """
    # A stream for each part, so that one more door does not move every chair.
    plan_rng, structure_rng, furniture_rng, outside_rng, drive_rng, sensor_rng = (
        np.random.default_rng([settings.seed, part]) for part in range(6)
    )
    plan = draw_plan(settings, plan_rng)
    ways = draw_ways(plan, plan_rng)
    builder = MeshBuilder()
    build_structure(plan, builder, structure_rng)
    furniture = furnish(plan, ways.area(ROBOT_RADIUS_M + _CLEARANCE_M), settings.clutter, builder, furniture_rng)
    build_outside(plan, builder, outside_rng)
    terrain = draw_terrain(plan.corridor, settings, plan_rng)

    avoid = furniture.union(ways.area(ROBOT_RADIUS_M))
    lidars = mount_lidars(settings, sensor_rng)
    longest_s = settings.duration_s + 2 * max(lidar.period_ns for lidar in lidars) / 1e9
    drive_plan = terrain.lift_drive(drive(choose_route(ways, settings), longest_s, settings, drive_rng))
    T_plan_map = transforms.from_yaw(transforms.yaw_of(drive_plan.T_map_base[0]), drive_plan.T_map_base[0, :3, 3])
    T_map_plan = transforms.invert(T_plan_map)
    mesh = terrain.lift_mesh(builder.build()).warped(lambda vertices: transforms.apply(T_map_plan, vertices))
    return Scene(
        plan=plan,
        mesh=mesh,
        furniture=furniture,
        walkers=_walkers(plan, terrain, avoid, settings, T_map_plan, furniture_rng),
        lidars=lidars,
        ring_bias_m=tuple(sensor_rng.normal(0, settings.ring_bias_m, lidar.model.rings) for lidar in lidars),
        trajectory=drive_plan.moved(T_map_plan),
        T_map_plan=T_map_plan,
        truth=building_truth(plan, T_map_plan),
    )


def _walkers(
    plan: Plan, terrain: Terrain, avoid: BaseGeometry, settings: SimulationSettings, T_map_plan: FloatArray,
    rng: np.random.Generator
) -> tuple[Walker, ...]:  # fmt: skip
    """People who walk back and forth where nothing stands in their way and the robot does not drive."""
    space = plan.free.difference(avoid).buffer(-0.25)
    x0, y0, x1, y1 = space.bounds
    walkers: list[Walker] = []
    for _ in range(2000):
        if len(walkers) == settings.walking_people:
            break
        start = np.array([rng.uniform(x0, x1), rng.uniform(y0, y1)])
        heading, length = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 5.0)
        ends = np.array([start, start + length * np.array([np.cos(heading), np.sin(heading)])])
        if space.contains(shapely.LineString(ends)):
            start, end = transforms.apply(T_map_plan, np.c_[ends, terrain.height(ends)])
            walkers.append(Walker(start, end, rng.uniform(0.7, 1.4), rng.uniform(), rng.uniform(1.6, 1.9)))
    return tuple(walkers)


def simulate(
    out: Path, settings: SimulationSettings, progress: Callable[[float], None] | None = None
) -> SimulationReport:
    """Write the bag of one drive at `out`: a file (bag) or a folder (mcap, db3). progress: called with the share that
    is done, 0 to 1. Raises InputError where there is no such building, or `out` exists or cannot be written.
    """
    clouds: dict[str, int] = {}
    points: dict[str, int] = {}
    with DriveWriter(out, settings.format) as writer:
        scene = draw_scene(settings)
        world = World(scene.mesh, scene.walkers)
        frames = [StaticTransform(BASE_FRAME, lidar.frame_id, lidar.T_base_sensor) for lidar in scene.lidars]
        writer.write("/tf_static", writer.transforms(EPOCH_NS, frames), EPOCH_NS, latched=True)
        writer.write("/truth/building", writer.text(json.dumps(scene.truth)), EPOCH_NS, latched=True)
        written = 0
        jobs = _jobs(scene.lidars, settings)
        for job, sweep in _traced(world, scene, jobs, settings):
            written = _write_poses(writer, scene.trajectory, written, job.log_time_ns)
            lidar = scene.lidars[job.lidar]
            writer.write(lidar.topic, writer.cloud(lidar, sweep, EPOCH_NS), EPOCH_NS + job.log_time_ns)
            if lidar.role != "horizontal":
                writer.write("/truth/classes", writer.classes(lidar, sweep, EPOCH_NS), EPOCH_NS + job.log_time_ns)
            clouds[lidar.topic] = clouds.get(lidar.topic, 0) + 1
            points[lidar.topic] = points.get(lidar.topic, 0) + int(np.count_nonzero(sweep.range_m))
            if progress is not None:
                progress(sum(clouds.values()) / len(jobs))
        _write_poses(writer, scene.trajectory, written, round(settings.duration_s * 1e9))
    files = out.rglob("*") if out.is_dir() else [out]
    return SimulationReport(
        path=out, building=settings.building, rooms=len(scene.plan.rooms), doors=len(scene.plan.doors),
        triangles=len(scene.mesh), clouds=clouds, points=points,
        size_bytes=sum(file.stat().st_size for file in files), duration_s=settings.duration_s
    )  # fmt: skip


def _write_poses(writer: DriveWriter, trajectory: Trajectory, first: int, until_ns: int) -> int:
    """The poses from number `first` up to a time; returns the number of the next."""
    following = int(np.searchsorted(trajectory.stamp_ns, until_ns, side="right"))
    for i in range(first, following):
        stamp_ns = EPOCH_NS + int(trajectory.stamp_ns[i])
        writer.write("/truth/pose", writer.odometry(trajectory.T_map_base[i], stamp_ns, BASE_FRAME), stamp_ns)
    return max(first, following)


def _jobs(lidars: tuple[Lidar, ...], settings: SimulationSettings) -> list[_Job]:
    """Every sweep that ends within the drive, in the order in which the clouds reach the recorder."""
    rng = np.random.default_rng([settings.seed, 72])
    jobs = []
    for number, lidar in enumerate(lidars):
        index = 0
        while (end_ns := lidar.sweep_start_ns(index + 1)) <= settings.duration_s * 1e9:
            jobs.append(_Job(end_ns + int(rng.uniform(1e6, 6e6)), number, index))
            index += 1
    return sorted(jobs, key=lambda job: job.log_time_ns)


def _traced(world: World, scene: Scene, jobs: list[_Job], settings: SimulationSettings) -> Iterator[tuple[_Job, Sweep]]:
    """The jobs in their order with their sweeps, a few traced ahead: Embree and NumPy let other threads run."""
    waiting: deque[tuple[_Job, Future[Sweep]]] = deque()
    with ThreadPoolExecutor(settings.workers) as pool:
        for job in jobs:
            bias = scene.ring_bias_m[job.lidar]
            lidar = scene.lidars[job.lidar]
            waiting.append((job, pool.submit(scan, world, lidar, scene.trajectory, job.index, settings, bias)))
            if len(waiting) > 2 * settings.workers:
                done, sweep = waiting.popleft()
                yield done, sweep.result()
        while waiting:
            done, sweep = waiting.popleft()
            yield done, sweep.result()
