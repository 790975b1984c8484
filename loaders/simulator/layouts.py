"""Bags laid out as those of public data sets: their topics, frames and mounts are those of the built-in rig of the same name.

Here stands what a rig file does not say: which of the sensors are simulated, how their drivers lay out the points, at what
height the base is carried, and what else the bag holds by which it is known. None of them has transforms of its lidars.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ffmap.loaders.errors import InputError
from ffmap.loaders.rig_file import RigFile, built_in_path, read_rig_file
from ffmap.loaders.simulator.sensors import SENSORS, Lidar, PointLayout, SensorModel, mount_lidars, start_lidars
from ffmap.loaders.simulator.settings import SimulationSettings

OtherTopic = Literal["imu", "odometry", "tf"]
"""What moves beside the lidars: an IMU in the base, and the pose as the robot itself would know it."""


@dataclass(frozen=True)
class Layout:
    """model: of all its lidars. base_height_m: of the base above the floor. others: further topics, and what is on them."""

    model: SensorModel
    points: PointLayout
    base_height_m: float
    others: Mapping[str, OtherTopic] = field(default_factory=dict)


LAYOUTS: Mapping[str, Layout] = {
    "mars": Layout(SENSORS["hdl32e"], "velodyne", 0.0, {"/odometry/filtered": "odometry", "/tf": "tf"}),
    # 1500 packets a second: 12 firings of all emitters each, as a VLP-16 sends them that reports dual returns.
    "backpack_3d": Layout(replace(SENSORS["vlp16"], rate_hz=20.0, columns=900), "packets", 1.1, {"imu": "imu"}),
    "ntu_viral": Layout(SENSORS["os1-16"], "ouster", 1.2, {"/imu/imu": "imu"}),
    "newer_college": Layout(SENSORS["os0-128"], "ouster", 1.2, {"/alphasense_driver_ros/imu": "imu"}),
    "oxford_spires": Layout(SENSORS["qt64"], "hesai", 1.1, {"/alphasense_driver_ros/imu": "imu"}),
    "hilti_2022": Layout(SENSORS["xt32"], "hesai", 1.2, {"/alphasense/imu": "imu"}),
}
PLAIN = "plain"


def layout_of(settings: SimulationSettings) -> Layout | None:
    """The layout that is asked for; None for the plain one. Raises InputError where there is none of the name, or where the
    sensors are asked for too, which the layout decides.
    """
    if settings.layout == PLAIN:
        return None
    if settings.layout not in LAYOUTS:
        raise InputError(f"simulate: no layout {settings.layout!r}; the layouts are {', '.join((PLAIN, *LAYOUTS))}")
    if said := settings.model_fields_set & {"sensor", "lidars", "mount_tilt_deg"}:
        raise InputError(f"simulate: {settings.layout} decides its own {' and '.join(sorted(said))}; leave that out")
    return LAYOUTS[settings.layout]


def lidars_of(settings: SimulationSettings, rng: np.random.Generator) -> tuple[Lidar, ...]:
    """The lidars where the settings put them; of a layout, where the rig's file does. Raises InputError as `layout_of`."""
    layout = layout_of(settings)
    if layout is None:
        return mount_lidars(settings, rng)
    mounts = []
    for entry in rig_of(settings.layout).lidars:
        assert entry.topic is not None
        assert entry.frame is not None
        assert entry.T_base_sensor is not None
        mounts.append((entry.topic, entry.frame, entry.T_base_sensor))
    # The horizontal one first: its spin axis is nearest to gravity.
    mounts.sort(key=lambda mount: -abs(float(mount[2][2, 2])))
    return start_lidars(layout.model, layout.points, mounts, rng, both=len(mounts) == 1)


def rig_of(layout: str) -> RigFile:
    """The built-in rig of a layout."""
    return read_rig_file(built_in_path(layout))
