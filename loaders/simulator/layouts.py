"""Bags like those of public data sets: topics, frames and extrinsics of the built-in rigs.

A layout adds what a rig file lacks: the sensor model, the point layout, the height of the base, and
the other topics by which the data set is detected, with one message each. None has transforms.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from ffmap.loaders.errors import InputError
from ffmap.loaders.rig_file import RigFile, built_in_path, read_rig_file
from ffmap.loaders.simulator.mesh import Rng
from ffmap.loaders.simulator.sensors import (
    Extrinsics,
    Lidar,
    PointLayout,
    place_lidars,
    sensor_model,
    start_lidars,
)
from ffmap.loaders.simulator.settings import Sensor, SimulationSettings

OtherTopic = Literal["imu", "odometry"]


@dataclass(frozen=True)
class Layout:
    """sensor: of all lidars. base_height_m: above the floor. others: further topics."""

    sensor: Sensor
    points: PointLayout
    base_height_m: float
    others: Mapping[str, OtherTopic] = field(default_factory=dict)


LAYOUTS: Mapping[str, Layout] = {
    "mars": Layout("hdl32e", "velodyne", 0.0, {"/odometry/filtered": "odometry"}),
    "backpack_3d": Layout("vlp16", "packets", 1.1, {"imu": "imu"}),
    "ntu_viral": Layout("os1-16", "ouster", 1.2, {"/imu/imu": "imu"}),
    "newer_college": Layout("os0-128", "ouster", 1.2, {"/alphasense_driver_ros/imu": "imu"}),
    "oxford_spires": Layout("qt64", "hesai", 1.1, {"/alphasense_driver_ros/imu": "imu"}),
    "hilti_2022": Layout("xt32", "hesai", 1.2, {"/alphasense/imu": "imu"}),
}


def layout_of(settings: SimulationSettings) -> Layout | None:
    """Return the layout of the settings, None for plain.

    Raises InputError if there is no such layout, or if a sensor is set too.
    """
    if settings.layout == "plain":
        return None
    if settings.layout not in LAYOUTS:
        known = ", ".join(("plain", *LAYOUTS))
        raise InputError(f"simulate: no layout {settings.layout!r}; the layouts are {known}")
    if given := settings.model_fields_set & {"sensor", "lidars", "mount_tilt_deg"}:
        names = " and ".join(sorted(given))
        raise InputError(f"simulate: {settings.layout} decides its own {names}; leave that out")
    return LAYOUTS[settings.layout]


def lidars_of(settings: SimulationSettings, rng: Rng) -> tuple[Lidar, ...]:
    """Return the lidars of the settings, or of the layout's rig. Raises InputError as above."""
    layout = layout_of(settings)
    if layout is None:
        return place_lidars(settings, rng)
    placed: list[Extrinsics] = [
        (entry.topic, entry.frame, entry.T_base_sensor)
        for entry in rig_of(settings.layout).lidars
        if entry.topic is not None and entry.frame is not None and entry.T_base_sensor is not None
    ]
    # The horizontal lidar first: its spin axis is nearest to gravity.
    placed.sort(key=lambda extrinsics: -abs(float(extrinsics[2][2, 2])))
    model = sensor_model(layout.sensor, settings)
    if layout.points == "packets":
        # 1500 packets a second of 12 firings, as a VLP-16 with dual returns sends them.
        model = replace(model, rate_hz=20.0, columns=900)
    return start_lidars(model, layout.points, placed, rng, both=len(placed) == 1)


def rig_of(layout: str) -> RigFile:
    """Return the built-in rig of a layout."""
    return read_rig_file(built_in_path(layout))
