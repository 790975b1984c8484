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

PointLayout = Literal["velodyne", "ouster", "hesai", "packets", "livox"]


@dataclass(frozen=True)
class Nodding:
    """A beam that turns fast about the upright and nods slowly: the pattern of a Livox Mid-360, which does not repeat.

    The table of directions that Livox published for its simulator (https://github.com/Livox-SDK/livox_laser_simulation,
    mid360.csv, 5 µs a row) shows about 180 turns and 10 nods a second, four lines 1.7° apart. Simplified: in the table each
    turn leans by some degrees and the lines' azimuths spread by as much; here turns lie level, one line above the other.

    turn_hz, nod_hz: have no common multiple with each other and the clouds' rate. middle_deg, swing_deg: of the nodding, a sine.
    """

    turn_hz: float
    nod_hz: float
    middle_deg: float
    swing_deg: float

    def look(self, time_ns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Azimuth and elevation of the beam in radians."""
        time_s = time_ns / 1e9
        nod = np.sin(2 * np.pi * self.nod_hz * time_s)
        return -2 * np.pi * self.turn_hz * time_s, np.radians(self.middle_deg + self.swing_deg * nod)


@dataclass(frozen=True)
class SensorModel:
    """A spinning lidar.

    elevation_deg: of each emitter about the spin axis, increasing (ring 0 is the lowest); where it nods, against the beam.
    columns: firings of each emitter a revolution. rate_hz: revolutions a second.
    column_ns: nanoseconds that all emitters take, one after the other, before the next column.
    noise_m: sigma of a range at right angles. max_range_m: of a white wall at right angles.
    layout: how it fires and what its driver reports: in turns and returns alone, or all emitters at once and every place;
        "livox": one after the other and every place.
    nodding: how its beam moves; None where it turns at the rate of its clouds.
    """

    name: Sensor
    elevation_deg: tuple[float, ...]
    columns: int
    rate_hz: float
    column_ns: float
    noise_m: float
    max_range_m: float
    quantum_m: float
    layout: Literal["velodyne", "ouster", "livox"]
    nodding: Nodding | None = None

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
        if self.layout == "livox":
            return np.arange(self.rings)
        return np.arange(self.rings).reshape(2, -1).T.ravel()

    @cached_property
    def firing_ns(self) -> FloatArray:
        """(columns, rings) nanoseconds from the sweep's start, in firing order; at the nominal rate."""
        column = np.arange(self.columns)[:, None] * (1e9 / self.rate_hz / self.columns)
        spread = 0.0 if self.layout == "ouster" else self.column_ns / self.rings
        return np.asarray(column + np.arange(self.rings) * spread)

    def directions_sensor(self, start_ns: int) -> FloatArray:
        """(columns, rings, 3) float32 unit vectors of the sweep that begins then, in firing order; the sensor spins clockwise,
        z is its axis.
        """
        if self.nodding is None:
            return self._repeated_directions
        azimuth, elevation = self.nodding.look(start_ns + self.firing_ns)
        return _unit_vectors(azimuth, elevation + self._elevation_rad)

    @cached_property
    def _repeated_directions(self) -> FloatArray:
        return _unit_vectors(-self.firing_ns * (2 * np.pi * self.rate_hz / 1e9), self._elevation_rad)

    @property
    def _elevation_rad(self) -> FloatArray:
        return np.asarray(np.radians(np.array(self.elevation_deg)[self.firing_order]))


def _unit_vectors(azimuth: FloatArray, elevation: FloatArray) -> FloatArray:
    flat = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), azimuth.shape)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), up], -1).astype(np.float32)


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
    "mid360": SensorModel(
        "mid360",
        (-2.55, -0.85, 0.85, 2.55),
        5000,
        10.0,
        20_000.0,
        0.020,
        70.0,
        0.001,
        "livox",
        Nodding(turn_hz=179.63, nod_hz=9.8717, middle_deg=22.5, swing_deg=26.95),
    ),
}


@dataclass(frozen=True)
class Lidar:
    """One of the robot's lidars.

    role: horizontal = spin axis upright (odometry), vertical = swept floor, walls and ceiling (its spin axis forward, or upright
        where it opens wide), or both where an upright one is alone or has another beside it.
    period_ns: of a revolution; two differ. phase_ns: its first sweep's start after the horizontal one's.
    points: how its driver lays out its clouds: "hesai" with absolute times, "packets" as one cloud of x y z a UDP packet.
    number: its place among the robot's lidars.
    """

    role: Literal["horizontal", "vertical", "both"]
    topic: str
    frame_id: str
    model: SensorModel
    T_base_sensor: FloatArray
    period_ns: float
    phase_ns: int
    points: PointLayout
    number: int = 0

    def sweep_start_ns(self, sweep: int) -> int:
        """Nanoseconds from the horizontal lidar's first sweep."""
        return self.phase_ns + round(sweep * self.period_ns)


_NAMES: dict[PointLayout, tuple[str, str, str]] = {
    "velodyne": ("velodyne", "velodyne_points", "velodyne"),
    "ouster": ("ouster", "points", "os_sensor"),
    "livox": ("livox", "lidar", "livox_frame"),
}
"""By driver: the maker's name in topics and frames, what the clouds' topics end in, and the frame of a lidar that is alone."""


def mount_lidars(settings: SimulationSettings, rng: np.random.Generator) -> tuple[Lidar, ...]:
    """The lidars that the settings ask for, the one that gives the poses first."""
    model = SENSORS[settings.sensor]
    maker, clouds, alone = _NAMES[model.layout]

    def mount(place: str, rotation: Rotation | None, at: list[float]) -> tuple[str, str, FloatArray]:
        return f"/{place}_{maker}/{clouds}", f"{place}_{maker}", transforms.make_transform(rotation, at)

    # A beam that opens 7 degrees downwards meets the floor at 8 times its height.
    height_m = 0.40 if model.nodding else 0.95
    forward = Rotation.from_quat([0.5, 0.5, 0.5, 0.5])
    tilted = Rotation.from_euler("y", settings.mount_tilt_deg, degrees=True) * forward
    horizontal = mount("horizontal", None, [0.10, 0.0, height_m])
    match settings.lidars:
        case "one":
            mounts = [(f"/{maker}/{clouds}" if model.layout != "velodyne" else f"/{clouds}", alone, horizontal[2])]
        case "two":
            mounts = [horizontal, mount("vertical", tilted, [0.30, 0.0, 0.70])]
        case "three":
            # Turned outwards by 30 degrees: a wall square to the way is then swept before the robot has come to it.
            mounts = [
                horizontal,
                mount("left", Rotation.from_euler("z", 30, degrees=True) * tilted, [0.20, 0.20, 0.70]),
                mount("right", Rotation.from_euler("z", -30, degrees=True) * tilted, [0.20, -0.20, 0.70]),
            ]
        case "upright":
            mounts = [mount("front", None, [0.25, 0.0, height_m]), mount("rear", None, [-0.25, 0.0, height_m])]
    both = settings.lidars in ("one", "upright")
    return start_lidars(model, model.layout, mounts, rng, both)


def start_lidars(
    model: SensorModel,
    points: PointLayout,
    mounts: Sequence[tuple[str, str, FloatArray]],
    rng: np.random.Generator,
    both: bool,
) -> tuple[Lidar, ...]:
    """Lidars of one model, whose clocks run free. mounts: topic, frame and T_base_sensor of the one that gives the poses, and of
    those that are labelled. both: whether the first is labelled too.
    """
    nominal_ns = 1e9 / model.rate_hz
    topic, frame, T = mounts[0]
    lidars = [Lidar("both" if both else "horizontal", topic, frame, model, T, nominal_ns * 1.0007, 0, points)]
    for number, (topic, frame, T) in enumerate(mounts[1:], start=1):
        phase_ns, period_ns = int(rng.uniform(0, nominal_ns)), nominal_ns * (0.9993 - 0.0004 * number)
        lidars.append(Lidar("vertical", topic, frame, model, T, period_ns, phase_ns, points, number))
    return tuple(lidars)
