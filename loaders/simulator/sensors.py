"""The lidars: where their emitters point, when they fire, how well they measure, and where the robot carries them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.loaders.simulator.settings import Sensor, SimulationSettings

PointLayout = Literal["velodyne", "ouster", "hesai", "packets"]


@dataclass(frozen=True)
class SensorModel:
    """A spinning lidar.

    elevation_deg: of each emitter about the spin axis, increasing (ring 0 is the lowest).
    columns: firings of each emitter a revolution. rate_hz: revolutions a second.
    column_ns: nanoseconds that all emitters take, one after the other, before the next column.
    noise_m: sigma of a range at right angles. max_range_m: of a white wall at right angles.
    layout: how it fires and what its driver reports: in turns and returns alone, or all emitters at once and every place.
    """

    name: Sensor
    elevation_deg: tuple[float, ...]
    columns: int
    rate_hz: float
    column_ns: float
    noise_m: float
    max_range_m: float
    quantum_m: float
    layout: Literal["velodyne", "ouster"]

    @property
    def rings(self) -> int:
        return len(self.elevation_deg)

    @property
    def firing_order(self) -> IntArray:
        """(rings,) the ring of each firing of a column: Velodynes fire the lower and upper half in turns, Ousters all
        at once, the uppermost first in their rows.
        """
        if self.layout == "ouster":
            return np.arange(self.rings)[::-1]
        return np.arange(self.rings).reshape(2, -1).T.ravel()

    @cached_property
    def firing_ns(self) -> FloatArray:
        """(columns, rings) nanoseconds from the sweep's start, in firing order; at the nominal rate."""
        column = np.arange(self.columns)[:, None] * (1e9 / self.rate_hz / self.columns)
        spread = 0.0 if self.layout == "ouster" else self.column_ns / self.rings
        return np.asarray(column + np.arange(self.rings) * spread)

    @cached_property
    def directions_sensor(self) -> FloatArray:
        """(columns, rings, 3) float32 unit vectors in firing order; the sensor spins clockwise, z is its axis."""
        azimuth = -self.firing_ns * (2 * np.pi * self.rate_hz / 1e9)
        elevation = np.radians(np.array(self.elevation_deg)[self.firing_order])
        flat = np.cos(elevation)
        return np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(np.sin(elevation), azimuth.shape)], -1
        ).astype(np.float32)


SENSORS: dict[Sensor, SensorModel] = {
    "hdl32e": SensorModel(
        "hdl32e", tuple(-92 / 3 + i * 4 / 3 for i in range(32)), 2170, 10.0, 46_080.0, 0.015, 80.0, 0.002, "velodyne"
    ),
    "vlp16": SensorModel(
        "vlp16", tuple(-15.0 + 2.0 * i for i in range(16)), 1808, 10.0, 55_296.0, 0.010, 80.0, 0.002, "velodyne"
    ),
    "os1-16": SensorModel(
        "os1-16", tuple(np.linspace(-16.6, 16.6, 16)), 1024, 10.0, 97_656.0, 0.012, 60.0, 0.001, "ouster"
    ),
    "os0-128": SensorModel(
        "os0-128", tuple(np.linspace(-45.0, 45.0, 128)), 1024, 10.0, 97_656.0, 0.015, 50.0, 0.001, "ouster"
    ),
    "qt64": SensorModel(
        "qt64", tuple(np.linspace(-52.1, 52.1, 64)), 600, 10.0, 108_800.0, 0.015, 40.0, 0.004, "velodyne"
    ),
    "xt32": SensorModel(
        "xt32", tuple(-16.0 + i for i in range(32)), 2000, 10.0, 46_000.0, 0.010, 80.0, 0.004, "velodyne"
    ),
}


@dataclass(frozen=True)
class Lidar:
    """One of the robot's lidars.

    role: horizontal = spin axis upright (odometry), vertical = spin axis forward (sweeps floor, walls and ceiling), or both
        where an upright one is alone.
    period_ns: of a revolution; two differ. phase_ns: its first sweep's start after the horizontal one's.
    points: how its driver lays out its clouds: "hesai" with absolute times, "packets" as one cloud of x y z a UDP packet.
    """

    role: Literal["horizontal", "vertical", "both"]
    topic: str
    frame_id: str
    model: SensorModel
    T_base_sensor: FloatArray
    period_ns: float
    phase_ns: int
    points: PointLayout

    def sweep_start_ns(self, sweep: int) -> int:
        """Nanoseconds from the horizontal lidar's first sweep."""
        return self.phase_ns + round(sweep * self.period_ns)


def mount_lidars(settings: SimulationSettings, rng: np.random.Generator) -> tuple[Lidar, ...]:
    """The horizontal and the vertical lidar; or the upright one that is alone."""
    model = SENSORS[settings.sensor]
    upright = transforms.make_transform(translation=[0.10, 0.0, 0.95])
    forward = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])
    tilted = Rotation.from_euler("y", settings.mount_tilt_deg, degrees=True) * forward
    sideways = transforms.make_transform(tilted, [0.30, 0.0, 0.70])
    names: tuple[str, ...] = {
        "velodyne": ("/horizontal_velodyne/velodyne_points", "horizontal_velodyne",
                     "/vertical_velodyne/velodyne_points", "vertical_velodyne"),
        "ouster": ("/horizontal_ouster/points", "horizontal_ouster", "/vertical_ouster/points", "vertical_ouster")
    }[model.layout]  # fmt: skip
    if settings.lidars == "one":
        names = {"velodyne": ("/velodyne_points", "velodyne"), "ouster": ("/ouster/points", "os_sensor")}[model.layout]
        return start_lidars(model, model.layout, ((names[0], names[1], upright),), rng)
    return start_lidars(model, model.layout, ((names[0], names[1], upright), (names[2], names[3], sideways)), rng)


def start_lidars(
    model: SensorModel, points: PointLayout, mounts: Sequence[tuple[str, str, FloatArray]], rng: np.random.Generator
) -> tuple[Lidar, ...]:
    """Lidars of one model, whose clocks run free. mounts: topic, frame and T_base_sensor of the horizontal one, and of the
    vertical one where there are two.
    """
    nominal_ns = 1e9 / model.rate_hz
    topic, frame, T = mounts[0]
    if len(mounts) == 1:
        return (Lidar("both", topic, frame, model, T, nominal_ns * 1.0007, 0, points),)
    horizontal = Lidar("horizontal", topic, frame, model, T, nominal_ns * 1.0007, 0, points)
    topic, frame, T = mounts[1]
    phase_ns = int(rng.uniform(0, nominal_ns))
    return horizontal, Lidar("vertical", topic, frame, model, T, nominal_ns * 0.9989, phase_ns, points)
