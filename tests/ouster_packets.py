"""Packets of an Ouster lidar, written by the maker's own library from ranges.

Points are computed from the ranges by the equations of the sensor's manual.
"""

import json
from dataclasses import dataclass

import numpy as np
from ouster.sdk import core

from ffmap.loaders.bag import make_typestore
from tests.loaders.bag_builder import Entry

COLUMNS, COLUMNS_A_PACKET = 512, 16
PACKETS = COLUMNS // COLUMNS_A_PACKET
COLUMN_NS = 195_312
PERIOD_NS = COLUMN_NS * COLUMNS
_ELEVATION_DEG = np.linspace(20.0, -20.0, 16)
_AZIMUTH_DEG = np.tile([3.1, 1.05, -1.05, -3.1], 4)
_BEAM_ORIGIN_MM = 15.8
_SENSOR_ABOVE_MM = 36.18


def metadata(profile: str, first_column: int = 0, last_column: int = COLUMNS - 1) -> str:
    """The text that the driver publishes about the sensor."""
    shift = np.rint(_AZIMUTH_DEG * COLUMNS / 360).astype(int).tolist()
    beam_to_lidar, lidar_to_sensor = np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])
    beam_to_lidar[0, 3], lidar_to_sensor[2, 3] = _BEAM_ORIGIN_MM, _SENSOR_ABOVE_MM
    return json.dumps(
        {
            "prod_line": "OS-1-16",
            "prod_sn": "1",
            "build_rev": "v3.0.1",
            "lidar_mode": f"{COLUMNS}x10",
            "beam_altitude_angles": _ELEVATION_DEG.tolist(),
            "beam_azimuth_angles": _AZIMUTH_DEG.tolist(),
            "beam_to_lidar_transform": beam_to_lidar.ravel().tolist(),
            "lidar_to_sensor_transform": lidar_to_sensor.ravel().tolist(),
            "imu_to_sensor_transform": np.eye(4).ravel().tolist(),
            "data_format": {
                "pixels_per_column": len(_ELEVATION_DEG),
                "columns_per_packet": COLUMNS_A_PACKET,
                "columns_per_frame": COLUMNS,
                "pixel_shift_by_row": shift,
                "column_window": [first_column, last_column],
                "udp_profile_lidar": profile,
                "udp_profile_imu": "LEGACY",
                "fps": 10,
            },
        }
    )


@dataclass(frozen=True, eq=False)
class Revolution:
    """One turn of a sensor.

    range_mm, reflectivity, signal: (returns, rows, columns), range 0 where nothing returned.
    time_ns: (columns,).
    """

    number: int
    range_mm: np.ndarray
    reflectivity: np.ndarray
    signal: np.ndarray
    time_ns: np.ndarray


def revolution(number: int, start_ns: int, returns: int = 1, seed: int = 0) -> Revolution:
    rng = np.random.default_rng((seed, number))
    shape = (returns, len(_ELEVATION_DEG), COLUMNS)
    # One profile of packets counts in steps of 8 mm.
    range_mm = 8 * rng.integers(100, 1000, shape)
    range_mm[rng.random(shape) < 0.1] = 0
    time_ns = start_ns + COLUMN_NS * np.arange(COLUMNS) + rng.integers(0, 50, COLUMNS)
    return Revolution(
        number, range_mm, rng.integers(0, 250, shape), rng.integers(0, 60_000, shape), time_ns
    )


def packets(turn: Revolution, told: str) -> list[bytes]:
    """The packets of a revolution by a sensor's metadata."""
    sensor = core.SensorInfo(told)
    frame = core.LidarFrame(sensor)
    frame.frame_id = turn.number
    frame.timestamp[:] = turn.time_ns
    frame.measurement_id[:] = np.arange(COLUMNS)
    first, last = sensor.format.column_window
    frame.status[first : last + 1] = 1
    measured = {"RANGE": turn.range_mm, "REFLECTIVITY": turn.reflectivity, "SIGNAL": turn.signal}
    for name, values in measured.items():
        for second, own in zip(("", "2"), values, strict=False):
            if frame.has_field(name + second):
                frame.field(name + second)[:] = own
    return [
        bytes(packet.buf)
        for packet in core.frame_to_packets(frame, core.PacketFormat(sensor), 0, 1)
    ]


def points_of(turn: Revolution) -> np.ndarray:
    """(returns, rows, columns, 3) in the sensor's frame, metres; float64."""
    n = _BEAM_ORIGIN_MM
    encoder = 2 * np.pi * (1 - np.arange(COLUMNS) / COLUMNS)
    azimuth = encoder - np.radians(_AZIMUTH_DEG)[:, None]
    elevation = np.radians(_ELEVATION_DEG)[:, None]
    beyond = turn.range_mm - n
    lidar = [
        beyond * np.cos(azimuth) * np.cos(elevation) + n * np.cos(encoder),
        beyond * np.sin(azimuth) * np.cos(elevation) + n * np.sin(encoder),
        beyond * np.sin(elevation),
    ]
    return np.stack([-lidar[0], -lidar[1], lidar[2] + _SENSOR_ABOVE_MM], axis=-1) / 1000.0


def metadata_entry(
    told: str, log_time_ns: int, namespace: str = "/ouster", ros_version: int = 1
) -> Entry:
    return (
        f"{namespace}/metadata",
        log_time_ns,
        make_typestore(ros_version).types["std_msgs/msg/String"](told),
    )


def packet_entry(
    data: bytes,
    log_time_ns: int,
    namespace: str = "/ouster",
    ros_version: int = 1,
    name: str = "lidar_packets",
) -> Entry:
    package = "ouster_ros" if ros_version == 1 else "ouster_sensor_msgs"
    made = make_typestore(ros_version).types[f"{package}/msg/PacketMsg"]
    return f"{namespace}/{name}", log_time_ns, made(np.frombuffer(data, np.uint8))
