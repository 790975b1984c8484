"""The robot's drive: along the corridor and back, in and out of rooms through open doors.

A route is a polyline with rounded corners. Progress along it is counted in metres of
`hypot(ds, r dθ)` with r = speed / turn rate. A steady progress keeps both the speed and the turn
rate below their limits.
"""

from dataclasses import dataclass
from operator import itemgetter
from typing import NamedTuple

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator.mesh import Rng
from ffmap.loaders.simulator.plan import Door, Plan, Room
from ffmap.loaders.simulator.settings import SimulationSettings

POSE_RATE_HZ = 100
REST_S = 1.0
ROBOT_RADIUS_M = 0.3

_TURN_RADPS = 0.6
_END_M = 0.9  # Minimum distance of the robot from the corridor's ends
_WEAVE_M = 0.08
_ROUNDING_M = 0.6
_SHARPEST_CURVE_RAD = 2.6  # Sharper turns are made on the spot
_STEP_M = 0.01
_SMOOTHING_S = 0.25


class Visit(NamedTuple):
    """A detour from a place of the corridor's centre line through an open door and back.

    tour: (n, 2) once around the room. peek: (m, 2) in and out again.
    """

    along_m: float
    tour: FloatArray
    peek: FloatArray


@dataclass(frozen=True)
class Ways:
    """Every way through a building, in the plan. corridor: (n, 2) from end to end."""

    line: shapely.LineString
    corridor: FloatArray
    visits: tuple[Visit, ...]

    def area(self, margin_m: float) -> BaseGeometry:
        """Return the floor within a margin of the ways."""
        polylines = [self.corridor, *(way for visit in self.visits for way in visit[1:])]
        # Leg by leg: the buffer of a line that reverses can lose its far end.
        legs = [leg for line in polylines for leg in np.stack([line[:-1], line[1:]], axis=1)]
        return shapely.union_all(shapely.buffer(shapely.linestrings(legs), margin_m))


def draw_ways(plan: Plan, rng: Rng) -> Ways:
    """Draw a way along the corridor, and a visit to every room with an open door to it."""
    line = shapely.LineString(plan.corridor)
    room = plan.free.buffer(-ROBOT_RADIUS_M)
    shapely.prepare(room)
    visits = []
    for door in plan.doors:
        if door.passable and door.rooms[0] == 0:
            visit = _visit(door, plan.rooms[door.rooms[1]], line)
            routes = (_follow(route, 1.0)[0] for route in (visit.tour, visit.peek))
            tour, peek = (shapely.contains_xy(room, places).all() for places in routes)
            if peek:
                visits.append(visit if tour else visit._replace(tour=visit.peek))
    return Ways(line, _weave(line, rng), tuple(visits))


def _weave(line: shapely.LineString, rng: Rng) -> FloatArray:
    """Draw a way along a line with its bends, a few centimetres to either side."""
    places = [*np.arange(_END_M, line.length - _END_M - 1.5, 3.0), line.length - _END_M]
    bends = [line.project(shapely.Point(corner)) for corner in line.coords[1:-1]]
    places = [place for place in places if all(abs(place - bend) > 1.0 for bend in bends)]
    middle = shapely.get_coordinates(line.interpolate(np.sort(places + bends)))
    return np.asarray(middle + np.clip(rng.normal(0, _WEAVE_M, middle.shape), -0.16, 0.16))


def _visit(door: Door, room: Room, line: shapely.LineString) -> Visit:
    """Return the ways into a room: a turn on the spot, and once around it or to its middle."""
    front = shapely.Point(door.spot.to_plan([[0.0, door.depth[1] + 0.5]])[0])
    along = float(np.clip(line.project(front), _END_M, line.length - _END_M))
    beyond = door.spot.to_plan([[0.0, door.depth[1] + 0.45], [0.0, door.depth[0] - 0.75]])
    way_in = np.vstack([line.interpolate(along).coords, beyond])
    inside = door.spot.to_plan([[0.0, door.depth[0] - 1.4]])
    around = np.array(room.interior.centroid.coords)
    for inset in (1.2, 1.45, 1.7):
        core = room.interior.buffer(-inset, join_style="mitre")
        if core.geom_type == "Polygon" and not core.is_empty and core.exterior.length > 2.5:
            ring = np.array(core.simplify(0.3).exterior.coords)[:-1]
            first = int(np.argmin(np.linalg.norm(ring - way_in[-1], axis=1)))
            around = np.roll(ring, -first, axis=0)
    tour, peek = (np.vstack([way_in, detour, way_in[::-1]]) for detour in (around, inside))
    return Visit(along, tour, peek)


def choose_route(ways: Ways, settings: SimulationSettings) -> FloatArray:
    """Return a polyline (n, 2) in the plan, long enough for the drive.

    Along the corridor with as many visits as the time allows, then back with the visits left over,
    and so on.
    """
    budget_m = settings.speed_mps * (settings.duration_s - REST_S)
    radius = settings.speed_mps / _TURN_RADPS
    chosen: list[tuple[float, FloatArray]] = []
    waiting = []
    for visit in sorted(ways.visits, key=lambda visit: visit.along_m):
        for detour in (visit.tour, visit.peek):
            longer = [*chosen, (visit.along_m, detour)]
            if _cost(_leg(ways, longer, True), radius) <= budget_m:
                chosen = longer
                break
        else:
            waiting.append(visit)
    route = _leg(ways, chosen, True)
    forward, planned_m = False, _cost(route, radius)
    while planned_m < budget_m:
        leg = _leg(ways, [(visit.along_m, visit.tour) for visit in waiting], forward)
        route = np.vstack([route, leg[1:]])
        planned_m += _cost(leg, radius)
        forward, waiting = not forward, list(ways.visits)
    return route


def _leg(ways: Ways, chosen: list[tuple[float, FloatArray]], forward: bool) -> FloatArray:
    """Return the way once along the corridor with the chosen detours."""
    stops = [(ways.line.project(shapely.Point(place)), place[None]) for place in ways.corridor]
    # Without places beside a detour, where the robot would drive back and forth.
    stops = [stop for stop in stops if all(abs(stop[0] - along) > 0.7 for along, _ in chosen)]
    ordered = sorted(stops + chosen, key=itemgetter(0), reverse=not forward)
    points = np.vstack([polyline for _, polyline in ordered])
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05
    return np.asarray(points[np.append(True, moved)])


def _cost(route: FloatArray, radius: float) -> float:
    return float(_follow(route, radius)[2][-1])


def _follow(route: FloatArray, radius: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rounded polyline: places (n, 2), headings (n,), unwrapped, and progress (n,)."""
    legs = np.diff(route, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    along = legs / lengths[:, None]
    left = np.stack([-along[:, 1], along[:, 0]], 1)
    turns = np.arctan2((left[:-1] * along[1:]).sum(1), (along[:-1] * along[1:]).sum(1))
    heading, start = float(np.arctan2(along[0, 1], along[0, 0])), route[0]
    places, headings = [route[:1]], [np.array([heading])]
    for i, turn in enumerate([*turns.tolist(), 0.0]):
        rounding = 0.0
        if 0 < abs(turn) < _SHARPEST_CURVE_RAD:
            shortest = min(lengths[i], lengths[i + 1])
            rounding = min(_ROUNDING_M * np.tan(abs(turn) / 2), 0.45 * shortest)
        end = route[i + 1] - rounding * along[i]
        steps = max(int(np.linalg.norm(end - start) / _STEP_M), 1)
        places.append(start + np.linspace(0, 1, steps + 1)[1:, None] * (end - start))
        headings.append(np.full(steps, heading))
        steps = int(abs(turn) / 0.01) + 1 if turn else 0
        turned = np.linspace(0, turn, steps + 1)[1:, None]
        r = rounding / np.tan(abs(turn) / 2) if turn else 0.0
        side = np.sign(turn) * left[i]
        arc = end + r * (np.sin(np.abs(turned)) * along[i] + (1 - np.cos(turned)) * side)
        places.append(arc)
        headings.append(heading + turned[:, 0])
        start, heading = places[-1][-1] if steps else end, heading + turn
    place, angle = np.concatenate(places), np.concatenate(headings)
    step = np.hypot(np.linalg.norm(np.diff(place, axis=0), axis=1), radius * np.diff(angle))
    return place, angle, np.append(0.0, np.cumsum(step))


def drive(route: FloatArray, end_s: float, settings: SimulationSettings, rng: Rng) -> Trajectory:
    """Return T_plan_base from 0 to `end_s` on a level floor, at rest for the first second.

    Poses between two stamps are interpolated linearly: the ground truth is then exact.
    """
    place, angle, progress = _follow(route, settings.speed_mps / _TURN_RADPS)
    time_s = np.arange(round(end_s * POSE_RATE_HZ) + 2) / POSE_RATE_HZ
    done = np.clip((time_s - REST_S) * settings.speed_mps, 0.0, progress[-1])
    smooth = _SMOOTHING_S * POSE_RATE_HZ
    x, y, yaw = (
        gaussian_filter1d(np.interp(done, progress, values), smooth, mode="nearest")
        for values in (*place.T, angle)
    )
    driving = gaussian_filter1d((time_s > REST_S + 0.3).astype(float), smooth, mode="nearest")
    roll, pitch, heave = (_sway(time_s, rng) * driving for _ in range(3))
    sway = np.radians(settings.sway_deg)
    T = np.broadcast_to(np.eye(4), (len(time_s), 4, 4)).copy()
    angles = np.stack([yaw, sway * pitch, sway * roll], 1)
    T[:, :3, :3] = Rotation.from_euler("ZYX", angles).as_matrix()
    T[:, :3, 3] = np.stack([x, y, 0.004 * settings.sway_deg * heave], 1)
    return Trajectory((time_s * 1e9).round().astype(np.int64), T)


def _sway(time_s: FloatArray, rng: Rng) -> FloatArray:
    """Draw a sum of slow oscillations between about -1 and 1."""
    rate_hz, phase = rng.uniform(0.4, 1.8, 4), rng.uniform(0, 2 * np.pi, 4)
    weight = rng.dirichlet(np.ones(4))
    return np.asarray(np.sin(2 * np.pi * rate_hz * time_s[:, None] + phase) @ weight)
