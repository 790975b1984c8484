"""The lidars: directions of emitters, times of firings, errors, and extrinsics."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.rig_file import RigFile, built_in_path, read_rig_file
from ffmap.loaders.simulator.mesh import Rng
from ffmap.loaders.simulator.settings import Sensor, SimulationSettings

PointLayout = Literal["velodyne", "ouster", "hesai", "packets", "livox"]
Extrinsics = tuple[str, str, FloatArray]
"""Topic, frame, T_base_sensor."""

# The Livox Mid-360 turns its beam fast about the vertical and nods it slowly. Its table of
# directions (https://github.com/Livox-SDK/livox_laser_simulation, mid360.csv, 5 µs a row) shows
# about 180 turns and 10 nods a second, and four lines 1.7° apart. Simplified: turns are level, and
# the lines are above each other. The rates have no common multiple with the rate of the clouds.
_TURN_HZ, _NOD_HZ = 179.63, 9.8717
_NOD_MIDDLE_DEG, _NOD_SWING_DEG = 22.5, 26.95


@dataclass(frozen=True)
class SensorModel:
    """A spinning lidar.

    elevation_deg: of each emitter about the spin axis, ascending (ring 0 is the lowest).
    columns: firings of each emitter per revolution. rate_hz: revolutions per second.
    column_ns: time in which all emitters fire, one after the other.
    noise_m: sigma of a range at normal incidence. max_range_m: of a white wall there.
    layout: "velodyne" fires interleaved and reports returns only; "ouster" fires all emitters at
        once and reports every place; "livox" fires one after the other and reports every place.
    """

    elevation_deg: tuple[float, ...]
    columns: int
    column_ns: float
    noise_m: float
    max_range_m: float
    quantum_m: float
    layout: Literal["velodyne", "ouster", "livox"]
    rate_hz: float = 10.0

    @property
    def rings(self) -> int:
        return len(self.elevation_deg)

    @property
    def firing_order(self) -> IntArray:
        """Ring (rings,) of each firing of a column."""
        order = np.arange(self.rings)
        if self.layout == "velodyne":
            return order.reshape(2, -1).T.ravel()
        return order[::-1] if self.layout == "ouster" else order

    @cached_property
    def firing_ns(self) -> FloatArray:
        """Time (columns, rings) since the sweep's start, in firing order, at the nominal rate."""
        column = np.arange(self.columns)[:, None] * (1e9 / self.rate_hz / self.columns)
        spread = 0.0 if self.layout == "ouster" else self.column_ns / self.rings
        return np.asarray(column + np.arange(self.rings) * spread)

    def directions_sensor(self, start_ns: int) -> FloatArray:
        """Return unit vectors (columns, rings, 3), float32, of the sweep that starts then.

        In firing order; the sensor spins clockwise about z.
        """
        if self.layout != "livox":
            return self._repeated_directions
        time_s = (start_ns + self.firing_ns) / 1e9
        nod = np.sin(2 * np.pi * _NOD_HZ * time_s)
        elevation = np.radians(_NOD_MIDDLE_DEG + _NOD_SWING_DEG * nod)
        return _unit_vectors(-2 * np.pi * _TURN_HZ * time_s, elevation + self._elevation_rad)

    @cached_property
    def _repeated_directions(self) -> FloatArray:
        azimuth = -self.firing_ns * (2 * np.pi * self.rate_hz / 1e9)
        return _unit_vectors(azimuth, np.broadcast_to(self._elevation_rad, azimuth.shape))

    @property
    def _elevation_rad(self) -> FloatArray:
        return np.asarray(np.radians(np.array(self.elevation_deg)[self.firing_order]))


def _unit_vectors(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    flat = np.cos(elevation)
    vectors = [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]
    return np.stack(vectors, -1).astype(np.float32)


def _spread(lowest_deg: float, highest_deg: float, rings: int) -> tuple[float, ...]:
    return tuple(np.linspace(lowest_deg, highest_deg, rings).tolist())


_SENSORS: dict[Sensor, SensorModel] = {
    "hdl32e": SensorModel(
        _spread(-92 / 3, 32 / 3, 32), 2170, 46_080.0, 0.015, 80.0, 0.002, "velodyne"
    ),
    "vlp16": SensorModel(_spread(-15, 15, 16), 1808, 55_296.0, 0.010, 80.0, 0.002, "velodyne"),
    "os1-16": SensorModel(_spread(-16.6, 16.6, 16), 1024, 97_656.0, 0.012, 60.0, 0.001, "ouster"),
    "os0-128": SensorModel(_spread(-45, 45, 128), 1024, 97_656.0, 0.015, 50.0, 0.001, "ouster"),
    "qt64": SensorModel(_spread(-52.1, 52.1, 64), 600, 108_800.0, 0.015, 40.0, 0.004, "velodyne"),
    "xt32": SensorModel(_spread(-16, 15, 32), 2000, 46_000.0, 0.010, 80.0, 0.004, "velodyne"),
    "mid360": SensorModel(_spread(-2.55, 2.55, 4), 5000, 20_000.0, 0.020, 70.0, 0.001, "livox"),
}


class Layout(NamedTuple):
    """Lidars of a public data set; topics, frames and extrinsics are those of its built-in rig.

    base_height_m: above the floor.
    """

    sensor: Sensor
    points: PointLayout
    base_height_m: float


LAYOUTS: Mapping[str, Layout] = {
    "mars": Layout("hdl32e", "velodyne", 0.0),
    "backpack_3d": Layout("vlp16", "packets", 1.1),
    "ntu_viral": Layout("os1-16", "ouster", 1.2),
    "newer_college": Layout("os0-128", "ouster", 1.2),
    "oxford_spires": Layout("qt64", "hesai", 1.1),
    "hilti_2022": Layout("xt32", "hesai", 1.2),
}


@dataclass(frozen=True)
class Lidar:
    """One of the robot's lidars.

    maps: whether its clouds are to be labelled, and have ground truth.
    period_ns: of a revolution; no two are equal. phase_ns: start of its first sweep, from the
        horizontal lidar's. points: layout of its clouds: "hesai" with absolute times, "packets" as
        one cloud of x y z per UDP packet.
    """

    topic: str
    frame_id: str
    model: SensorModel
    T_base_sensor: FloatArray
    period_ns: float
    phase_ns: int
    points: PointLayout
    maps: bool
    number: int

    def sweep_start_ns(self, sweep: int) -> int:
        """Return the time from the horizontal lidar's first sweep."""
        return self.phase_ns + round(sweep * self.period_ns)


_NAMES = {
    "velodyne": ("velodyne", "velodyne_points", "velodyne"),
    "ouster": ("ouster", "points", "os_sensor"),
    "livox": ("livox", "lidar", "livox_frame"),
}
"""By layout: name in topics and frames, name of the clouds, and frame of a lidar that is alone."""


def draw_lidars(settings: SimulationSettings, rng: Rng) -> tuple[Lidar, ...]:
    """Return the lidars, the one for localization first, with free-running clocks."""
    layout = LAYOUTS.get(settings.layout)
    model = _SENSORS[layout.sensor if layout else settings.sensor]
    points = layout.points if layout else model.layout
    if points == "packets":
        # 1500 packets a second of 12 firings, as a VLP-16 with dual returns sends them.
        model = replace(model, rate_hz=20.0, columns=900)
    if settings.noise_m is not None:
        model = replace(model, noise_m=settings.noise_m)
    placed = _place_as_rig(settings.layout) if layout else _place(settings, model)
    alone = len(placed) == 1 or settings.lidars == "upright"
    nominal_ns = 1e9 / model.rate_hz
    lidars = []
    for number, (topic, frame, T) in enumerate(placed):
        phase_ns = int(rng.uniform(0, nominal_ns)) if number else 0
        period_ns = nominal_ns * (0.9993 - 0.0004 * number if number else 1.0007)
        maps = number > 0 or alone
        lidars.append(Lidar(topic, frame, model, T, period_ns, phase_ns, points, maps, number))
    return tuple(lidars)


def _place_as_rig(name: str) -> list[Extrinsics]:
    placed = [
        (entry.topic, entry.frame, entry.T_base_sensor)
        for entry in rig_of(name).lidars
        if entry.topic is not None and entry.frame is not None and entry.T_base_sensor is not None
    ]
    # The horizontal lidar first: its spin axis is nearest to gravity.
    return sorted(placed, key=lambda extrinsics: -abs(float(extrinsics[2][2, 2])))


def rig_of(layout: str) -> RigFile:
    """Return the built-in rig of a layout."""
    return read_rig_file(built_in_path(layout))


def _place(settings: SimulationSettings, model: SensorModel) -> list[Extrinsics]:
    """Return the extrinsics of the lidars of the settings."""
    maker, clouds, alone = _NAMES[model.layout]

    def place(name: str, at: list[float], rotation: Rotation | None = None) -> Extrinsics:
        T = transforms.make_transform(rotation, at)
        return f"/{name}_{maker}/{clouds}", f"{name}_{maker}", T

    # A field of view that ends 7° below the horizon meets the floor at 8 times its height.
    height_m = 0.40 if model.layout == "livox" else 0.95
    forward = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])
    tilted = Rotation.from_euler("y", settings.mount_tilt_deg, degrees=True) * forward
    outwards = Rotation.from_euler("z", 30, degrees=True)
    horizontal = place("horizontal", [0.10, 0.0, height_m])
    match settings.lidars:
        case "one":
            topic = f"/{clouds}" if model.layout == "velodyne" else f"/{maker}/{clouds}"
            return [(topic, alone, horizontal[2])]
        case "two":
            return [horizontal, place("vertical", [0.30, 0.0, 0.70], tilted)]
        case "three":
            # A wall across the way is then swept before the robot reaches it.
            return [
                horizontal,
                place("left", [0.20, 0.20, 0.70], outwards * tilted),
                place("right", [0.20, -0.20, 0.70], outwards.inv() * tilted),
            ]
        case "upright":
            return [place("front", [0.25, 0.0, height_m]), place("rear", [-0.25, 0.0, height_m])]
