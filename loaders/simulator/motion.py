"""The robot's drive: along the corridor and back, in and out of rooms through open doors, swaying a little.

A route is a polyline with rounded corners. Progress along it is counted in metres of `hypot(ds, r dθ)` with
r = speed / turn rate, so that a steady progress keeps both the speed and the turn rate below their limits.
"""

from dataclasses import dataclass
from operator import itemgetter

import numpy as np
import shapely
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from shapely.geometry.base import BaseGeometry

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator.building import Door, Plan, Room
from ffmap.loaders.simulator.settings import SimulationSettings

POSE_RATE_HZ = 100
REST_S = 1.0
ROBOT_RADIUS_M = 0.3  # Nothing stands nearer than this to the path of the base

_END_M = 0.9  # Minimum distance of the robot from the corridor's ends
_WEAVE_M = 0.08
_ROUNDING_M = 0.6
_SHARPEST_CURVE_RAD = 2.6  # Sharper turns are made on the spot
_STEP_M = 0.01
_SMOOTHING_S = 0.25


@dataclass(frozen=True)
class Visit:
    """A detour from the corridor through an open door and back.

    along_m: where it leaves the corridor's middle. tour: (n, 2) once around the room. peek: (m, 2) in and out again.
    """

    along_m: float
    tour: FloatArray
    peek: FloatArray


@dataclass(frozen=True)
class Ways:
    """Every way that a robot may take through a building, in the plan. corridor: (n, 2) from end to end."""

    line: shapely.LineString
    corridor: FloatArray
    visits: tuple[Visit, ...]

    def area(self, margin_m: float) -> BaseGeometry:
        """The floor within a margin of them."""
        polylines = [self.corridor, *(visit.tour for visit in self.visits), *(visit.peek for visit in self.visits)]
        # Segment by segment: the buffer of a line that goes back on itself can lose its far end.
        legs = [shapely.LineString(polyline[i : i + 2]) for polyline in polylines for i in range(len(polyline) - 1)]
        return shapely.union_all([leg.buffer(margin_m) for leg in legs])


def draw_ways(plan: Plan, rng: np.random.Generator) -> Ways:
    """A corridor driven not quite in its middle, and a visit to every room with an open door to it."""
    line = shapely.LineString(plan.corridor)
    rooms = {room.name: room for room in plan.rooms}
    visits = []
    for door in plan.doors:
        if door.passable and rooms[door.rooms[0]].kind == "corridor":
            front = door.spot.to_plan(np.array([[0.0, door.depth[1] + 0.5]]))[0]
            along = float(np.clip(line.project(shapely.Point(front)), _END_M, line.length - _END_M))
            leave = np.array(line.interpolate(along).coords[0])
            peek = _peek(door, leave)
            tour = _tour(door, rooms[door.rooms[1]], leave)
            if _is_clear(peek, plan.free):
                visits.append(Visit(along, tour if _is_clear(tour, plan.free) else peek, peek))
    return Ways(line, _weave(line, rng), tuple(visits))


def _weave(line: shapely.LineString, rng: np.random.Generator) -> FloatArray:
    """Along a line with its bends, shifted by a few centimetres to either side."""
    places = [*np.arange(_END_M, line.length - _END_M - 1.5, 3.0), line.length - _END_M]
    bends = [line.project(shapely.Point(p)) for p in line.coords[1:-1]]
    places = sorted([p for p in places if all(abs(p - bend) > 1.0 for bend in bends)] + bends)
    middle = np.array([line.interpolate(p).coords[0] for p in places])
    return np.asarray(middle + np.clip(rng.normal(0, _WEAVE_M, middle.shape), -2 * _WEAVE_M, 2 * _WEAVE_M))


def _way_in(door: Door, leave: FloatArray) -> FloatArray:
    beyond = [[0.0, door.depth[1] + 0.45], [0.0, door.depth[0] - 0.75]]
    return np.vstack([leave, door.spot.to_plan(np.array(beyond))])


def _peek(door: Door, leave: FloatArray) -> FloatArray:
    """Into the room, a turn on the spot, and out."""
    way_in = _way_in(door, leave)
    inside = door.spot.to_plan(np.array([[0.0, door.depth[0] - 1.4]]))
    return np.vstack([way_in, inside, way_in[::-1]])


def _tour(door: Door, room: Room, leave: FloatArray) -> FloatArray:
    """Once around the room; where it is narrow, to its middle."""
    way_in = _way_in(door, leave)
    for inset in (1.7, 1.45, 1.2):
        core = room.interior.buffer(-inset, join_style="mitre")
        if core.geom_type == "Polygon" and not core.is_empty and core.exterior.length > 2.5:
            ring = np.array(core.simplify(0.3).exterior.coords)[:-1]
            first = int(np.argmin(np.linalg.norm(ring - way_in[-1], axis=1)))
            return np.vstack([way_in, np.roll(ring, -first, axis=0), way_in[::-1]])
    return np.vstack([way_in, np.array(room.interior.centroid.coords[0]), way_in[::-1]])


def _is_clear(route: FloatArray, free: BaseGeometry) -> bool:
    places, _ = _follow(route, 1.0)
    room = free.buffer(-ROBOT_RADIUS_M)
    shapely.prepare(room)
    return bool(shapely.contains_xy(room, places).all())


def choose_route(ways: Ways, settings: SimulationSettings) -> FloatArray:
    """The whole corridor, with as many visits as the time allows; then back with the visits left over, and so on.

    (n, 2) polyline in the plan, long enough for the drive.
    """
    budget_m = settings.speed_mps * (settings.duration_s - REST_S)
    radius = settings.speed_mps / settings.turn_radps
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
    """Once along the corridor with the chosen detours."""
    stops = [(ways.line.project(shapely.Point(place)), place[None]) for place in ways.corridor]
    # A place beside a detour would make the robot go back and forth.
    stops = [stop for stop in stops if all(abs(stop[0] - along) > 0.7 for along, _ in chosen)]
    points = np.vstack([polyline for _, polyline in sorted(stops + chosen, key=itemgetter(0), reverse=not forward)])
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.05
    return np.asarray(points[np.append(True, moved)])


def _cost(route: FloatArray, radius: float) -> float:
    return float(_follow(route, radius)[1][-1, 1])


def _follow(route: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """The rounded polyline: places (n, 2), and their (n, 2) heading (unwrapped) and progress in metres."""
    places, headings = [route[:1]], []
    legs = np.diff(route, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    along = legs / lengths[:, None]
    heading = float(np.arctan2(along[0, 1], along[0, 0]))
    headings.append(np.array([heading]))
    start = route[0]
    for i in range(len(legs)):
        turn, rounding = 0.0, 0.0
        if i + 1 < len(legs):
            (x, y), (next_x, next_y) = along[i], along[i + 1]
            turn = float(np.arctan2(x * next_y - y * next_x, along[i] @ along[i + 1]))
            if abs(turn) < _SHARPEST_CURVE_RAD:
                rounding = min(_ROUNDING_M * abs(np.tan(turn / 2)), 0.45 * lengths[i], 0.45 * lengths[i + 1])
        end = route[i + 1] - rounding * along[i]
        steps = max(int(np.linalg.norm(end - start) / _STEP_M), 1)
        places.append(start + np.linspace(0, 1, steps + 1)[1:, None] * (end - start))
        headings.append(np.full(steps, heading))
        start = end
        if turn:
            steps = max(int(abs(turn) / 0.01), 1)
            part = np.linspace(0, 1, steps + 1)[1:] * turn
            if rounding > 0.02:
                r = rounding / np.tan(abs(turn) / 2)
                side = np.sign(turn) * np.array([-along[i, 1], along[i, 0]])
                arc = start + r * (np.sin(np.abs(part))[:, None] * along[i] + (1 - np.cos(part))[:, None] * side)
            else:
                arc = np.repeat((route[i + 1])[None], steps, axis=0)
            places.append(arc)
            headings.append(heading + part)
            start, heading = arc[-1], heading + turn
    place, angle = np.concatenate(places), np.concatenate(headings)
    step = np.hypot(np.linalg.norm(np.diff(place, axis=0), axis=1), radius * np.abs(np.diff(angle)))
    return place, np.stack([angle, np.append(0.0, np.cumsum(step))], 1)


def drive(route: FloatArray, end_s: float, settings: SimulationSettings, rng: np.random.Generator) -> Trajectory:
    """T_plan_base from 0 to `end_s` at POSE_RATE_HZ, stamps from 0; level floor, at rest for the first second.

    Poses between two stamps are meant to be interpolated linearly: the truth is then exact.
    """
    place, turned = _follow(route, settings.speed_mps / settings.turn_radps)
    angle, progress = turned.T
    time_s = np.arange(round(end_s * POSE_RATE_HZ) + 2) / POSE_RATE_HZ
    done = np.clip((time_s - REST_S) * settings.speed_mps, 0.0, progress[-1])
    smooth = _SMOOTHING_S * POSE_RATE_HZ
    x, y, yaw = (
        gaussian_filter1d(np.interp(done, progress, values), smooth, mode="nearest")
        for values in (place[:, 0], place[:, 1], angle)
    )
    driving = gaussian_filter1d((time_s > REST_S + 0.3).astype(float), smooth, mode="nearest")
    roll, pitch, heave = (_sway(time_s, rng) * driving for _ in range(3))
    sway = np.radians(settings.sway_deg)
    T = np.broadcast_to(np.eye(4), (len(time_s), 4, 4)).copy()
    T[:, :3, :3] = Rotation.from_euler("ZYX", np.stack([yaw, sway * pitch, sway * roll], 1)).as_matrix()
    T[:, :3, 3] = np.stack([x, y, 0.004 * settings.sway_deg * heave], 1)
    return Trajectory((time_s * 1e9).round().astype(np.int64), T)


def _sway(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A sum of slow swings between about -1 and 1."""
    rate_hz, phase = rng.uniform(0.4, 1.8, 4), rng.uniform(0, 2 * np.pi, 4)
    weight = rng.dirichlet(np.ones(4))
    return np.asarray(np.sin(2 * np.pi * rate_hz * time_s[:, None] + phase) @ weight)
