"""One simulated drive: a building is drawn and furnished, the robot drives through it, its lidars fill a bag."""

import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from difflib import get_close_matches
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
from ffmap.loaders.errors import InputError
from ffmap.loaders.frames import StaticTransform
from ffmap.loaders.numbered import numbered
from ffmap.loaders.simulator.bag_writing import DriveWriter
from ffmap.loaders.simulator.building import Plan, build_structure
from ffmap.loaders.simulator.drawn.draw import build_in, check_kind, draw_drawn_plan, with_ramp
from ffmap.loaders.simulator.drawn.elements import DrawnPlan
from ffmap.loaders.simulator.drawn.furnishings import furnish_drawn
from ffmap.loaders.simulator.drawn.ranges import KINDS, ranges_of
from ffmap.loaders.simulator.drawn.structure import build_drawn
from ffmap.loaders.simulator.drawn.truth import drawn_truth
from ffmap.loaders.simulator.furniture import build_outside, furnish
from ffmap.loaders.simulator.layouts import Layout, layout_of, lidars_of, rig_of
from ffmap.loaders.simulator.mesh import Mesh, MeshBuilder
from ffmap.loaders.simulator.motion import ROBOT_RADIUS_M, Ways, choose_route, draw_ways, drive
from ffmap.loaders.simulator.plans import BUILDINGS, draw_plan
from ffmap.loaders.simulator.raytrace import Sweep, Walker, World, scan
from ffmap.loaders.simulator.sensors import Lidar
from ffmap.loaders.simulator.settings import SimulationSettings
from ffmap.loaders.simulator.terrain import Terrain, draw_terrain
from ffmap.loaders.simulator.truth import building_truth
from ffmap.loaders.truth import CLASSES_TOPIC

BASE_FRAME = "base_link"
EPOCH_NS = 1_700_000_000_000_000_000  # When every simulated drive begins

_CLEARANCE_M = 0.15  # Distance between furniture and the robot
_PACKET_COLUMNS = 12
_PACKET_DELAY_NS = 400_000  # From a packet's last firing to the recorder
_ROBOTS_ODOMETRY = "odom"

_Timed = tuple[
    int, str, Any
]  # When a message is due, in nanoseconds from the first horizontal sweep; its topic; itself


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
    base_frame: str
    lidars: tuple[Lidar, ...]
    ring_bias_m: tuple[FloatArray, ...]
    trajectory: Trajectory
    T_map_plan: FloatArray
    truth: dict[str, Any]


def draw_scene(settings: SimulationSettings) -> Scene:
    """Building, furniture, people, lidars and drive, all from the settings and their seed.

    Raises InputError where there is no building or no layout of the name.
    """
    # A stream for each part, so that one more door does not move every chair.
    plan_rng, structure_rng, furniture_rng, outside_rng, drive_rng, sensor_rng = (
        np.random.default_rng([settings.seed, part]) for part in range(6)
    )
    builder = MeshBuilder()
    build = _build_drawn if _is_drawn(settings) else _build_named
    plan, ways, terrain, furniture = build(settings, builder, plan_rng, structure_rng, furniture_rng)
    build_outside(plan, builder, outside_rng)

    avoid = furniture.union(ways.area(ROBOT_RADIUS_M))
    lidars = lidars_of(settings, sensor_rng)
    layout = layout_of(settings)
    T_floor_base = transforms.make_transform(translation=[0.0, 0.0, layout.base_height_m if layout else 0.0])
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
        base_frame=(rig_of(settings.layout).base if layout else None) or BASE_FRAME,
        lidars=lidars,
        ring_bias_m=tuple(sensor_rng.normal(0, settings.ring_bias_m, lidar.model.rings) for lidar in lidars),
        trajectory=_carried(drive_plan.moved(T_map_plan), T_floor_base),
        T_map_plan=T_map_plan,
        truth=drawn_truth(plan, T_map_plan) if isinstance(plan, DrawnPlan) else building_truth(plan, T_map_plan),
    )


_Built = tuple[Plan, Ways, Terrain, BaseGeometry]  # The last: the floor that furniture covers


def _is_drawn(settings: SimulationSettings) -> bool:
    """Whether the building is drawn from ranges. Raises InputError where there is none of the name, or where its kind has no
    property that is asked for.
    """
    known = [*BUILDINGS, *KINDS]
    if settings.building not in known:
        close = get_close_matches(settings.building, known, 1)
        hint = f"did you mean '{close[0]}'? There" if close else "there"
        raise InputError(f"--building '{settings.building}': no such building; {hint} are {', '.join(known)}")
    check_kind(settings)
    return settings.building in KINDS


def _build_named(
    settings: SimulationSettings, mesh: MeshBuilder, plan_rng: np.random.Generator, structure_rng: np.random.Generator,
    furniture_rng: np.random.Generator
) -> _Built:  # fmt: skip
    plan = draw_plan(settings, plan_rng)
    ways = draw_ways(plan, plan_rng)
    build_structure(plan, mesh, structure_rng)
    furniture = furnish(plan, ways.area(ROBOT_RADIUS_M + _CLEARANCE_M), settings.clutter, mesh, furniture_rng)
    return plan, ways, draw_terrain(plan.corridor, settings, plan_rng), furniture


def _build_drawn(
    settings: SimulationSettings, mesh: MeshBuilder, plan_rng: np.random.Generator, structure_rng: np.random.Generator,
    furniture_rng: np.random.Generator
) -> _Built:  # fmt: skip
    empty = draw_drawn_plan(settings, plan_rng)
    ways = draw_ways(empty, plan_rng)
    clear = ways.area(ROBOT_RADIUS_M + _CLEARANCE_M)
    plan = build_in(empty, clear, settings, plan_rng)
    build_drawn(plan, mesh, structure_rng)
    ranges = ranges_of(settings.building, settings.drawn)
    furniture = furnish_drawn(plan, clear, settings.clutter, ranges, mesh, furniture_rng)
    ramped, gradient = with_ramp(settings, plan_rng)
    return plan, ways, draw_terrain(plan.corridor, ramped, plan_rng, gradient), furniture


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
        layout = layout_of(settings)
        world = World(scene.mesh, scene.walkers)
        if layout is None:
            frames = [StaticTransform(scene.base_frame, lidar.frame_id, lidar.T_base_sensor) for lidar in scene.lidars]
            writer.write("/tf_static", writer.transforms(EPOCH_NS, frames), EPOCH_NS, latched=True)
        writer.write("/truth/building", writer.text(json.dumps(scene.truth)), EPOCH_NS, latched=True)
        jobs = _jobs(scene.lidars, settings)
        with ThreadPoolExecutor(settings.workers) as pool:
            streams: list[Iterable[_Timed]] = [_poses(writer, scene, settings, layout)]
            labelled = [lidar.topic for lidar in scene.lidars if lidar.role != "horizontal"]
            truth_topics = {topic: numbered(CLASSES_TOPIC, place) for place, topic in enumerate(labelled)}
            for number, lidar in enumerate(scene.lidars):
                traced = _traced(pool, world, scene, number, jobs[number], settings)
                streams.append(_clouds(writer, lidar, truth_topics.get(lidar.topic), traced, points))
            swept = 0.0
            for log_time_ns, topic, message in merge(*streams, key=itemgetter(0)):
                writer.write(topic, message, EPOCH_NS + log_time_ns)
                if topic in points:
                    clouds[topic] = clouds.get(topic, 0) + 1
                if progress is not None and (share := log_time_ns / (settings.duration_s * 1e9)) > swept + 0.01:
                    swept = share
                    progress(min(share, 1.0))
    files = out.rglob("*") if out.is_dir() else [out]
    return SimulationReport(
        path=out, building=settings.building, rooms=len(scene.plan.rooms), doors=len(scene.plan.doors),
        triangles=len(scene.mesh), clouds=clouds, points=points,
        size_bytes=sum(file.stat().st_size for file in files), duration_s=settings.duration_s
    )  # fmt: skip


def _carried(drive: Trajectory, T_floor_base: FloatArray) -> Trajectory:
    """The base above the place where the robot stands."""
    return Trajectory(drive.stamp_ns, drive.T_map_base @ T_floor_base)


def _poses(writer: DriveWriter, scene: Scene, settings: SimulationSettings, layout: Layout | None) -> Iterator[_Timed]:
    """The true poses during the drive, and what else the layout has that moves with the base."""
    stamps, T = scene.trajectory.stamp_ns, scene.trajectory.T_map_base
    others = layout.others if layout else {}
    for i in range(int(np.searchsorted(stamps, round(settings.duration_s * 1e9), side="right"))):
        due_ns = int(stamps[i])
        stamp_ns = EPOCH_NS + due_ns
        yield due_ns, "/truth/pose", writer.odometry(T[i], stamp_ns, scene.base_frame)
        for topic, kind in others.items():
            match kind:
                case "imu":
                    before, after = T[max(i - 1, 0)], T[min(i + 1, len(T) - 1)]
                    step_s = float(stamps[1] - stamps[0]) / 1e9
                    message = writer.imu(before, T[i], after, step_s, stamp_ns, scene.base_frame)
                case "odometry":
                    message = writer.odometry(T[i], stamp_ns, scene.base_frame, _ROBOTS_ODOMETRY)
                case "tf":
                    pose = StaticTransform(_ROBOTS_ODOMETRY, scene.base_frame, T[i])
                    message = writer.transforms(stamp_ns, [pose])
            yield due_ns, topic, message


def _clouds(
    writer: DriveWriter,
    lidar: Lidar,
    truth_topic: str | None,
    traced: Iterable[tuple[int, Sweep]],
    points: dict[str, int],
) -> Iterator[_Timed]:
    """A lidar's clouds, whole sweeps or packets, with their truth where it is one that is labelled. points: counts them."""
    for due_ns, sweep in traced:
        points[lidar.topic] = points.get(lidar.topic, 0) + int(np.count_nonzero(sweep.range_m))
        parts = _packets(lidar, sweep) if lidar.points == "packets" else [(due_ns, sweep)]
        for part_due_ns, part in parts:
            yield part_due_ns, lidar.topic, writer.cloud(lidar, part, EPOCH_NS)
            if truth_topic is not None:
                yield part_due_ns, truth_topic, writer.classes(lidar, part, EPOCH_NS)


def _packets(lidar: Lidar, sweep: Sweep) -> Iterator[tuple[int, Sweep]]:
    """The sweep's UDP packets, each stamped with its first firing, and when they are due."""
    packet_ns = lidar.period_ns * _PACKET_COLUMNS / lidar.model.columns
    number = np.searchsorted(
        np.arange(1, -(-lidar.model.columns // _PACKET_COLUMNS)) * packet_ns, sweep.time_ns, side="right"
    )
    for i in range(int(number.max()) + 1 if len(number) else 0):
        own = number == i
        first_ns = round(i * packet_ns)
        part = replace(
            sweep,
            **{name: getattr(sweep, name)[own] for name in ("points_sensor", "range_m", "intensity", "ring", "truth")},
            time_ns=sweep.time_ns[own] - first_ns,
            stamp_ns=sweep.stamp_ns + first_ns,
            end_ns=sweep.stamp_ns + first_ns + round(packet_ns),
        )
        yield part.end_ns + _PACKET_DELAY_NS, part


def _jobs(lidars: tuple[Lidar, ...], settings: SimulationSettings) -> list[list[int]]:
    """When each of a lidar's sweeps that end within the drive reaches the recorder, one list a lidar."""
    rng = np.random.default_rng([settings.seed, 72])
    due_ns: list[list[int]] = []
    for lidar in lidars:
        own: list[int] = []
        while (end_ns := lidar.sweep_start_ns(len(own) + 1)) <= settings.duration_s * 1e9:
            own.append(end_ns + int(rng.uniform(1e6, 6e6)))
        due_ns.append(own)
    return due_ns


def _traced(
    pool: ThreadPoolExecutor, world: World, scene: Scene, number: int, due_ns: list[int], settings: SimulationSettings
) -> Iterator[tuple[int, Sweep]]:
    """When each of a lidar's sweeps is due, and itself, a few traced ahead: Embree and NumPy let other threads run."""
    lidar, bias = scene.lidars[number], scene.ring_bias_m[number]
    submitted = (
        (due, pool.submit(scan, world, lidar, scene.trajectory, index, settings, bias))
        for index, due in enumerate(due_ns)
    )
    waiting: deque[tuple[int, Future[Sweep]]] = deque(islice(submitted, settings.workers))
    while waiting:
        due, sweep = waiting.popleft()
        waiting.extend(islice(submitted, 1))
        yield due, sweep.result()
