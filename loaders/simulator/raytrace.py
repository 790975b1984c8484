"""Lidar rays through a mesh: glass, walking people, and what a sensor makes of the surfaces that it hits."""

from dataclasses import dataclass

import numpy as np
from embreex import rtcore_scene  # noqa: TID251 - its one place
from embreex.mesh_construction import TriangleMesh  # noqa: TID251 - its one place

from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator import glass
from ffmap.loaders.simulator.mesh import Mesh
from ffmap.loaders.simulator.sensors import Lidar, SensorModel
from ffmap.loaders.simulator.settings import SimulationSettings

_PASSES = 3  # How many panes a ray may meet
_RETURN_STRENGTH = 30.0  # Signal over the detector's threshold of a white wall at right angles, 10 m away
_MIXED_STEP_M = 0.7  # Beyond this a detector tells the two echoes of an edge apart
_SHEEN = 30  # A sheen narrows to a half within this power of the cosine, 12° off the right angle


@dataclass(frozen=True)
class Walker:
    """A person who walks back and forth between two places (3,) of the map; an upright cylinder with a head.

    phase: where along the way and back at time 0, from 0 to 1.
    """

    start: FloatArray
    end: FloatArray
    speed_mps: float
    phase: float
    height_m: float

    def at(self, time_s: FloatArray) -> FloatArray:
        """Places (n, 3) of the feet in the map."""
        length = max(float(np.linalg.norm(self.end - self.start)), 1e-6)
        cycle = (self.phase + np.asarray(time_s) * self.speed_mps / (2 * length)) % 1.0
        there = 1.0 - np.abs(2.0 * cycle - 1.0)
        return np.asarray(self.start + there[..., None] * (self.end - self.start))

    def meet(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> FloatArray:
        """(n,) distance along each ray, inf where it misses."""
        feet = self.at(time_s)
        offset = origins[:, :2] - feet[:, :2]
        along = directions[:, :2]
        a = np.maximum((along**2).sum(1), 1e-9)
        b = (offset * along).sum(1)
        best = np.full(len(origins), np.inf)
        for radius, low, high in ((0.19, 0.0, 0.82), (0.09, 0.82, 1.0)):
            root = b**2 - a * ((offset**2).sum(1) - radius**2)
            distance = (-b - np.sqrt(np.maximum(root, 0.0))) / a
            height = (origins[:, 2] + distance * directions[:, 2] - feet[:, 2]) / self.height_m
            hit = (root > 0) & (distance > 0) & (height >= low) & (height < high)
            best = np.where(hit, np.minimum(best, distance), best)
        return best


@dataclass(frozen=True)
class Hits:
    """What each ray met. distance_m: along the ray as the sensor counts it, inf for nothing; cosine: of incidence;
    signal: reflectivity times what panes let through; truth: what was hit, OUTSIDE behind or in a pane.
    """

    distance_m: FloatArray
    cosine: FloatArray
    signal: FloatArray
    truth: UInt8Array

    @classmethod
    def none(cls, count: int) -> "Hits":
        """Of rays that met nothing yet."""
        away = np.full(count, np.inf, np.float32)
        return cls(away, np.ones(count, np.float32), np.zeros(count, np.float32), np.full(count, NO_RETURN, np.uint8))


@dataclass(frozen=True)
class Sweep:
    """One revolution as the sensor reports it, in firing order (Velodyne, Livox) or ring by ring (Ouster).

    Velodyne: returns only. Others: (rings · columns) places, zeros where nothing returned, truth NO_RETURN there.
    points_sensor: (n, 3) float32 metres. time_ns: (n,) from the sweep's start. stamp_ns: its start; end_ns: its end.
    """

    points_sensor: FloatArray
    range_m: FloatArray
    intensity: FloatArray
    ring: IntArray
    time_ns: IntArray
    truth: UInt8Array
    stamp_ns: int
    end_ns: int


class World:
    """The map's triangles, ready for rays; safe to use from several threads."""

    def __init__(self, mesh: Mesh, walkers: tuple[Walker, ...] = ()) -> None:
        self.mesh = mesh
        self.walkers = walkers
        edges = mesh.triangles[:, 1:] - mesh.triangles[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        self._normals = (normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]).astype(np.float32)
        self._reflectivity = mesh.reflectivity.astype(np.float32)
        self._gloss = mesh.gloss.astype(np.float32)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, mesh.triangles.astype(np.float32))
        self._scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))  # builds the tree, before any thread

    def trace(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray, rng: np.random.Generator) -> Hits:
        """Trace rays (n, 3) float32 with unit directions, fired at times (n,), through panes, off them, or onto them."""
        count = len(origins)
        hits = Hits.none(count)
        rays = np.arange(count)
        travelled, transmitted = np.zeros(count, np.float32), np.ones(count, np.float32)
        behind = np.zeros(count, bool)
        for last in [False] * _PASSES + [True]:
            distance, triangle = self._nearest(origins, directions)
            person = self._nearest_walker(origins, directions, time_s[rays], distance)
            met = np.flatnonzero((triangle >= 0) | (person < np.inf))
            distance = np.minimum(distance, person)[met]
            triangle = np.where(person < np.inf, -1, triangle)[met]
            normal = self._normals[triangle]
            facing = np.einsum("ij,ij->i", normal, directions[met])
            on_person = triangle < 0
            truth = np.where(on_person, np.uint8(Truth.PERSON), self.mesh.truth[triangle])
            cosine = np.where(on_person, np.float32(0.7), np.abs(facing))
            pane = truth == Truth.GLASS
            kind = np.where(pane, self.mesh.pane[triangle], np.uint8(glass.Glass.PLAIN))
            returned = ~pane if last else ~pane | (rng.random(len(met)) < glass.returns(kind, cosine))
            signal = transmitted[rays[met]] * np.where(on_person, 0.3, self._response(triangle, cosine))
            signal[pane] = glass.echoes(kind, cosine)[pane]
            own = rays[met[returned]]
            hits.distance_m[own] = travelled[own] + distance[returned]
            hits.cosine[own], hits.signal[own] = cosine[returned], signal[returned]
            hits.truth[own] = np.where(behind[own], np.uint8(Truth.OUTSIDE), truth[returned])
            on = np.flatnonzero(~returned)
            if last or not len(on):
                break
            mirrored = rng.random(len(on)) < glass.mirrors(kind[on], cosine[on])
            reached = origins[met[on]] + distance[on, None] * directions[met[on]]
            turned = directions[met[on]] - np.where(mirrored, 2 * facing[on], 0)[:, None] * normal[on]
            rays = rays[met[on]]
            travelled[rays] += distance[on]
            transmitted[rays] *= glass.leaves(kind[on], cosine[on], mirrored)
            behind[rays] = True
            origins, directions = reached + 1e-3 * turned, turned
        return hits

    def _response(self, triangle: IntArray, cosine: FloatArray) -> FloatArray:
        """(n,) reflectivity of triangles seen at a cosine (n,) of incidence: diffuse, and what a sheen adds to it."""
        return np.asarray(self._reflectivity[triangle] + self._gloss[triangle] * cosine**_SHEEN)

    def _nearest(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, IntArray]:
        found = self._scene.run(np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=True)
        return np.where(found["primID"] >= 0, found["tfar"], np.float32(np.inf)), found["primID"]

    def _nearest_walker(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray, before_m: FloatArray
    ) -> FloatArray:
        """(n,) distance to a walking person where one stands before the mesh, else inf."""
        nearest = np.full(len(origins), np.inf, np.float32)
        for walker in self.walkers:
            nearest = np.minimum(nearest, walker.meet(origins, directions, time_s).astype(np.float32))
        return np.where(nearest < before_m, nearest, np.float32(np.inf))


def scan(
    world: World, lidar: Lidar, trajectory: Trajectory, sweep: int, settings: SimulationSettings,
    ring_bias_m: FloatArray
) -> Sweep:  # fmt: skip
    """One revolution, every firing from the pose of its own time.

    trajectory: T_map_base, stamps from the horizontal lidar's first sweep. ring_bias_m: (rings,) range offsets. Its
    chances depend on the seed, the lidar and the sweep alone.
    """
    model = lidar.model
    rng = np.random.default_rng([settings.seed, 71, lidar.number, sweep])
    start_ns = lidar.sweep_start_ns(sweep)
    firing_ns = model.firing_ns * (lidar.period_ns * model.rate_hz / 1e9)
    T_map_sensor = trajectory.at(start_ns + firing_ns[:, 0].astype(np.int64)) @ lidar.T_base_sensor
    directions_sensor = model.directions_sensor(start_ns)
    directions_map = directions_sensor @ np.swapaxes(T_map_sensor[:, :3, :3], 1, 2).astype(np.float32)
    origins = np.repeat(T_map_sensor[:, :3, 3].astype(np.float32), model.rings, axis=0)
    time_s = (start_ns + firing_ns.ravel()) / 1e9
    hits = world.trace(origins, directions_map.reshape(-1, 3), time_s, rng)

    ring = np.broadcast_to(model.firing_order, firing_ns.shape).ravel()
    seen = _detected(hits, settings, model.max_range_m, rng)
    noise = _range_noise(hits, model, settings, rng)
    shape = (model.columns, model.rings)
    distance = _mixed(hits.distance_m.reshape(shape), settings.mixed_share, rng).ravel()
    measured, seen = _measured(distance, seen, noise, ring_bias_m[ring], model, settings)
    points = directions_sensor.reshape(-1, 3) * measured[:, None]
    # Streams of their own, so that ranges do not depend on what is asked of intensities.
    light_rng = np.random.default_rng([settings.seed, 73, lidar.number, sweep])
    gain = np.random.default_rng([settings.seed, 74, lidar.number]).normal(1.0, settings.ring_gain, model.rings)[ring]
    intensity = _intensity(hits, gain, settings, light_rng)
    order = np.arange(len(ring))
    if model.layout == "velodyne":
        order = np.flatnonzero(seen)
    else:
        intensity[~seen] = 0.0
    if model.layout == "ouster":
        order = order.reshape(model.columns, model.rings).T.ravel()
    truth = np.where(seen, hits.truth, np.uint8(NO_RETURN))
    return Sweep(
        points_sensor=points[order],
        range_m=measured[order],
        intensity=intensity[order],
        ring=ring[order],
        time_ns=firing_ns.ravel().astype(np.int64)[order],
        truth=truth[order],
        stamp_ns=start_ns,
        end_ns=start_ns + round(lidar.period_ns),
    )


def _range_noise(
    hits: Hits, model: SensorModel, settings: SimulationSettings, rng: np.random.Generator
) -> FloatArray:  # fmt: skip
    """(n,) errors of ranges, greater where a ray grazes what it meets."""
    sigma = model.noise_m if settings.noise_m is None else settings.noise_m
    grazing = np.minimum(1.0 / np.maximum(hits.cosine, 0.2), 2.0)
    return np.asarray(rng.standard_normal(len(grazing), np.float32) * sigma * (0.75 + 0.25 * grazing))


def _measured(
    distance_m: FloatArray, seen: BoolArray, noise_m: FloatArray, bias_m: FloatArray, model: SensorModel,
    settings: SimulationSettings
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Ranges (n,) as they are reported, 0 where nothing returns, and whether (n,) anything does."""
    measured = np.where(seen, distance_m, 0.0) + noise_m + bias_m
    measured = np.round(measured / model.quantum_m) * model.quantum_m
    seen = seen & (measured > settings.min_range_m)
    return np.where(seen, measured, 0.0).astype(np.float32), seen


def _intensity(hits: Hits, gain: FloatArray, settings: SimulationSettings, rng: np.random.Generator) -> FloatArray:
    """(n,) float32, as percents of a white surface at right angles, 255 at most: as Velodyne's calibrated reflectivity counts.

    Sensors calibrate the range away (manuals of VLP-16 and Ouster), but know no angle of incidence. Rough surfaces fall less with
    it than Lambert's cosine (Oren and Nayar 1994). gain: (n,) of the emitters, which are calibrated one by one.
    """
    strength = hits.signal * (0.3 + 0.7 * hits.cosine) * _faded(hits.distance_m, settings.intensity_half_m)
    scatter = rng.normal(1.0, settings.intensity_noise, len(strength)) if settings.intensity_noise else 1.0
    return np.round(np.clip(100.0 * strength * gain * scatter, 0.0, 255.0)).astype(np.float32)


def _faded(distance_m: FloatArray, half_m: float | None) -> FloatArray | float:
    """What is left of an intensity at a distance (n,), a half at `half_m`; all of it where None."""
    return 1.0 if half_m is None else 1.0 / (1.0 + (distance_m / np.float32(half_m)) ** 2)


def _mixed(distance_m: FloatArray, share: float, rng: np.random.Generator) -> FloatArray:
    """Ranges (columns, rings) where beams that straddle an edge measure something between its two sides.

    The point keeps the truth of the surface in the beam's middle.
    """
    with np.errstate(invalid="ignore"):
        step = np.roll(distance_m, 1, axis=0) - distance_m
    edge = np.flatnonzero((np.abs(step) > 0.05) & (np.abs(step) < _MIXED_STEP_M))
    edge = edge[rng.random(len(edge)) < share]
    mixed = distance_m.copy()
    mixed.flat[edge] += step.flat[edge] * rng.uniform(0.0, 0.7, len(edge))
    return mixed


def _detected(hits: Hits, settings: SimulationSettings, max_range_m: float, rng: np.random.Generator) -> BoolArray:
    """Which firings come back: dark, far and grazing surfaces return less often."""
    distance = np.where(np.isfinite(hits.distance_m), hits.distance_m, max_range_m)
    strength = _RETURN_STRENGTH * hits.signal * hits.cosine / np.maximum(distance / 10.0, 0.2) ** 2
    chance = (1.0 - np.exp(-strength)) * (1.0 - settings.dropout)
    return np.asarray((rng.random(len(distance)) < chance) & (hits.distance_m < max_range_m))
