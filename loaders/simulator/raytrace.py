"""Lidar rays through a mesh: glass, walking people, and the errors of the sensor."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from embreex import rtcore_scene  # noqa: TID251 - its one place
from embreex.mesh_construction import TriangleMesh  # noqa: TID251 - its one place

from ffmap.algorithms.base.labels import NO_RETURN, Truth
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator import glass
from ffmap.loaders.simulator.mesh import Mesh, Rng
from ffmap.loaders.simulator.sensors import Lidar
from ffmap.loaders.simulator.settings import SimulationSettings

_PASSES = 3  # Number of panes that a ray may meet
_RETURN_STRENGTH = 30.0  # Signal of a white wall at normal incidence, 10 m away, over the threshold
_SHEEN = 30  # Power of the cosine: gloss is halved 12° from normal incidence
_MIXED_STEP_M = 0.7  # Beyond this a detector separates the two echoes of an edge
_MIXED_SHARE = 0.2  # Of the firings at an edge, those that measure between both surfaces
_DROPOUT = 0.002  # Share of firings lost for no reason
_MIN_RANGE_M = 0.6
_RING_BIAS = 0.2  # Range offset of each emitter, sigma, as a share of the range noise
_RING_GAIN = 0.05  # Difference in intensity between emitters, sigma
_INTENSITY_NOISE = 0.05
_WALKER = ((0.19, 0.0, 0.82), (0.09, 0.82, 1.0))  # Radius (m) and heights (shares): body, head


@dataclass(frozen=True)
class Walker:
    """A person who walks back and forth between two places (3,) of the map.

    phase: place along the way and back at time 0, from 0 to 1.
    """

    start: FloatArray
    end: FloatArray
    speed_mps: float
    phase: float
    height_m: float

    def meet(self, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> FloatArray:
        """Return the distance (n,) along each ray, inf where it misses."""
        way = self.end - self.start
        cycle = (self.phase + time_s * self.speed_mps / (2 * np.linalg.norm(way))) % 1.0
        feet = self.start + (1.0 - np.abs(2.0 * cycle - 1.0))[:, None] * way
        offset, along = origins[:, :2] - feet[:, :2], directions[:, :2]
        a, b = np.maximum((along**2).sum(1), 1e-9), (offset * along).sum(1)
        best = np.full(len(origins), np.inf, np.float32)
        for radius, low, high in _WALKER:
            root = b**2 - a * ((offset**2).sum(1) - radius**2)
            distance = (-b - np.sqrt(np.maximum(root, 0.0))) / a
            height = (origins[:, 2] + distance * directions[:, 2] - feet[:, 2]) / self.height_m
            hit = (root > 0) & (distance > 0) & (height >= low) & (height < high)
            best[hit] = np.minimum(best, distance)[hit]
        return best


@dataclass(frozen=True)
class Hits:
    """What each ray met: distance (inf: nothing), cosine of incidence, strength of the echo, class.

    The class is OUTSIDE behind a pane or in a mirror.
    """

    distance_m: FloatArray
    cosine: FloatArray
    signal: FloatArray
    truth: UInt8Array


@dataclass(frozen=True)
class Sweep:
    """One revolution as the sensor reports it, in firing order (Velodyne, Livox) or by rings.

    Velodyne: returns only. Others: all places, zeros where nothing returned, truth NO_RETURN.
    points_sensor: (n, 3) float32, metres. time_ns: (n,) from stamp_ns, the start.
    """

    points_sensor: FloatArray
    range_m: FloatArray
    intensity: FloatArray
    ring: IntArray
    time_ns: IntArray
    truth: UInt8Array
    stamp_ns: int

    def only(self, rows: IntArray | BoolArray) -> "Sweep":
        """Return the sweep with some of its places."""
        arrays: dict[str, Any] = {k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **{name: values[rows] for name, values in arrays.items()})


class World:
    """The map's triangles and people, ready for rays from several threads."""

    def __init__(self, mesh: Mesh, walkers: tuple[Walker, ...] = ()) -> None:
        self.walkers = walkers
        self._faces = mesh.faces
        edges = mesh.triangles[:, 1:] - mesh.triangles[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        self._normals = (normal / length[:, None]).astype(np.float32)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, mesh.triangles.astype(np.float32))
        self.nearest(np.zeros((1, 3)), np.ones((1, 3)))  # Builds the tree before any thread

    def nearest(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the distance (n,) to the mesh and the triangle (n,), inf and -1 for none."""
        rays = (np.ascontiguousarray(own, np.float32) for own in (origins, directions))
        found = self._scene.run(*rays, output=True)
        hit = found["primID"] >= 0
        return np.where(hit, found["tfar"], np.float32(np.inf)), found["primID"]

    def trace(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray, rng: Rng
    ) -> Hits:
        """Trace rays (n, 3), float32, with unit directions, fired at times (n,)."""
        count = len(origins)
        none, all_ = np.zeros(count, np.float32), np.ones(count, np.float32)
        nothing = np.full(count, NO_RETURN, np.uint8)
        hits = Hits(np.full(count, np.inf, np.float32), all_.copy(), none.copy(), nothing)
        rays, travelled, transmitted = np.arange(count), none, all_
        behind = np.zeros(count, bool)
        for panes in range(_PASSES + 1):
            distance, triangle = self.nearest(origins, directions)
            for walker in self.walkers:
                person = walker.meet(origins, directions, time_s[rays])
                triangle = np.where(person < distance, -2, triangle)
                distance = np.minimum(distance, person)
            met = np.flatnonzero(triangle != -1)
            distance, triangle, on_person = distance[met], triangle[met], triangle[met] == -2
            face, normal = self._faces[triangle], self._normals[triangle]
            facing = np.einsum("ij,ij->i", normal, directions[met])
            cosine = np.where(on_person, np.float32(0.7), np.abs(facing))
            truth = np.where(on_person, np.uint8(Truth.PERSON), face["truth"])
            kind = np.where(truth == Truth.GLASS, face["pane"], np.uint8(0))
            pane = kind > 0
            returned = ~pane
            if panes < _PASSES:
                returned |= rng.random(len(met)) < glass.returns(kind, cosine)
            diffuse = face["reflectivity"] + face["gloss"] * cosine**_SHEEN
            signal = transmitted[rays[met]] * np.where(on_person, 0.3, diffuse)
            signal[pane] = glass.echoes(kind)[pane]
            own = rays[met[returned]]
            hits.distance_m[own] = travelled[own] + distance[returned]
            hits.cosine[own], hits.signal[own] = cosine[returned], signal[returned]
            hits.truth[own] = np.where(behind[own], np.uint8(Truth.OUTSIDE), truth[returned])
            on = np.flatnonzero(~returned)
            if not len(on):
                break
            mirrored = rng.random(len(on)) < glass.mirrors(kind[on], cosine[on])
            rays, origins, directions = rays[met[on]], origins[met[on]], directions[met[on]]
            travelled[rays] += distance[on]
            transmitted[rays] *= glass.leaves(kind[on], cosine[on], mirrored)
            behind[rays] = True
            reached = origins + distance[on, None] * directions
            directions = directions - np.where(mirrored, 2 * facing[on], 0)[:, None] * normal[on]
            origins = reached + 1e-3 * directions
        return hits


def scan(
    world: World, lidar: Lidar, trajectory: Trajectory, sweep: int, settings: SimulationSettings
) -> Sweep:
    """Return one revolution, every firing from the pose of its own time.

    trajectory: T_map_base, stamps from the horizontal lidar's first sweep. Random numbers depend on
    the seed, the lidar and the sweep only.
    """
    model = lidar.model
    rng = np.random.default_rng([settings.seed, 71, lidar.number, sweep])
    emitters = np.random.default_rng([settings.seed, 74, lidar.number])
    start_ns = lidar.sweep_start_ns(sweep)
    firing_ns = model.firing_ns * (lidar.period_ns * model.rate_hz / 1e9)
    poses = trajectory.at(start_ns + firing_ns[:, 0].astype(np.int64)) @ lidar.T_base_sensor
    directions_sensor = model.directions_sensor(start_ns)
    directions_map = directions_sensor @ np.swapaxes(poses[:, :3, :3], 1, 2).astype(np.float32)
    origins = np.repeat(poses[:, :3, 3].astype(np.float32), model.rings, axis=0)
    time_s = (start_ns + firing_ns.ravel()) / 1e9
    hits = world.trace(origins, directions_map.reshape(-1, 3), time_s, rng)

    ring = np.broadcast_to(model.firing_order, firing_ns.shape).ravel()
    bias_m = emitters.normal(0.0, _RING_BIAS * model.noise_m, model.rings)[ring]
    gain = emitters.normal(1.0, _RING_GAIN, model.rings)[ring]
    seen = _detected(hits, model.max_range_m, rng)
    range_m = np.where(seen, hits.distance_m, 0.0)
    if model.noise_m:
        distance = hits.distance_m.reshape(firing_ns.shape)
        range_m = np.where(seen, _mixed(distance, rng).ravel(), 0.0)
        grazing = np.minimum(1.0 / np.maximum(hits.cosine, 0.2), 2.0)
        sigma_m = model.noise_m * (0.75 + 0.25 * grazing)
        range_m += rng.standard_normal(len(ring)) * sigma_m + bias_m
    range_m = np.round(range_m / model.quantum_m) * model.quantum_m
    seen &= range_m > _MIN_RANGE_M
    range_m = np.where(seen, range_m, 0.0).astype(np.float32)
    intensity = _intensity(hits, gain, settings.intensity_half_m, rng)
    intensity[~seen] = 0.0
    whole = Sweep(
        points_sensor=directions_sensor.reshape(-1, 3) * range_m[:, None],
        range_m=range_m,
        intensity=intensity,
        ring=ring,
        time_ns=firing_ns.ravel().astype(np.int64),
        truth=np.where(seen, hits.truth, np.uint8(NO_RETURN)),
        stamp_ns=start_ns,
    )
    if model.layout == "velodyne":
        return whole.only(seen)
    by_ring = np.arange(len(ring)).reshape(model.columns, model.rings).T.ravel()
    return whole.only(by_ring) if model.layout == "ouster" else whole


def _detected(hits: Hits, max_range_m: float, rng: Rng) -> BoolArray:
    """Draw which firings return: less often from dark, far and grazing surfaces."""
    distance = np.minimum(hits.distance_m, max_range_m)
    strength = _RETURN_STRENGTH * hits.signal * hits.cosine / np.maximum(distance / 10.0, 0.2) ** 2
    chance = (1.0 - np.exp(-strength)) * (1.0 - _DROPOUT)
    return np.asarray((rng.random(len(distance)) < chance) & (hits.distance_m < max_range_m))


def _mixed(distance_m: FloatArray, rng: Rng) -> FloatArray:
    """Return ranges (columns, rings) with values between both sides of some edges.

    Their class is that of the surface in the middle of the beam.
    """
    with np.errstate(invalid="ignore"):
        step = np.roll(distance_m, 1, axis=0) - distance_m
    edge = np.flatnonzero((np.abs(step) > 0.05) & (np.abs(step) < _MIXED_STEP_M))
    edge = edge[rng.random(len(edge)) < _MIXED_SHARE]
    mixed = distance_m.copy()
    mixed.flat[edge] += step.flat[edge] * rng.uniform(0.0, 0.7, len(edge))
    return mixed


def _intensity(hits: Hits, gain: FloatArray, half_m: float | None, rng: Rng) -> FloatArray:
    """Return intensities (n,), float32: percent of a white surface at normal incidence, up to 255.

    Sensors calibrate the range away (manuals of VLP-16 and Ouster), but not the angle of incidence.
    Rough surfaces fall less with it than Lambert's cosine (Oren and Nayar 1994).
    """
    strength = hits.signal * (0.3 + 0.7 * hits.cosine)
    if half_m:
        strength /= 1.0 + (hits.distance_m / half_m) ** 2
    scatter = rng.normal(1.0, _INTENSITY_NOISE, len(strength))
    return np.round(np.clip(100.0 * strength * gain * scatter, 0.0, 255.0)).astype(np.float32)
