"""Motion compensation of a scan in the corridor of tests/corridor.py."""

from dataclasses import replace

import numpy as np

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.scan import Scan
from ffmap.algorithms.base.trajectory import Trajectory, place_scan, seen_at_once
from tests.corridor import cast

PARTS, PART_NS = 25, 20_000_000
T_BASE_SENSOR = transforms.make_transform(translation=[0.0, 0.0, 1.0])
EDGES_DEG = np.linspace(-45, 45, 128)[1:] - 45 / 127


def drive() -> Trajectory:
    """Half a second at 1 m/s with a turn of 20 degrees."""
    stamps = np.arange(PARTS + 1) * PART_NS
    seconds = (stamps / 1e9).tolist()
    poses = [transforms.from_yaw(np.radians(40) * s, [s - 0.25, 0.0, 0.0]) for s in seconds]
    return Trajectory(stamps, np.stack(poses))


def moving() -> Scan:
    """Rays of all elevations, each part from the pose of its time."""
    rng, trajectory, parts = np.random.default_rng(3), drive(), []
    for k in range(PARTS):
        T = trajectory.at(np.array([k * PART_NS]))[0] @ T_BASE_SENSOR
        emitters_deg = np.sort(rng.uniform(-45, 45, 8))
        scan, _ = cast(T, None, 0.0, k, emitters_deg=emitters_deg, firings=500)
        parts.append(scan.points_sensor)
    points = np.concatenate(parts)
    return Scan(
        points_sensor=points,
        ring=np.zeros(len(points), np.uint16),
        ring_count=len(EDGES_DEG) + 1,
        time_ns=np.repeat(np.arange(PARTS) * PART_NS, [len(part) for part in parts]),
        start_ns=0,
        stamp_ns=0,
        cloud_index=np.arange(len(points), dtype=np.int32),
        cloud_size=len(points),
    )


def at_once(scan: Scan) -> Scan:
    return seen_at_once(scan, drive(), T_BASE_SENSOR, np.tan(np.radians(EDGES_DEG)))


def off_walls_m(points_map: np.ndarray) -> np.ndarray:
    """(n,) distances to the nearest surface of the corridor."""
    x, y, z = points_map.T
    return np.min(np.abs([x + 4, x - 6, y + 1.5, y - 2, z, z - 2.8]), axis=0)


def test_returns_are_at_the_same_places_as_with_their_times() -> None:
    scan = moving()
    still = at_once(scan)
    assert still.time_ns is None
    assert still.start_ns == still.end_ns == still.reference_ns == scan.reference_ns
    assert at_once(still) is still
    np.testing.assert_array_equal(still.cloud_index, scan.cloud_index)
    swept, placed = (place_scan(s, drive(), T_BASE_SENSOR) for s in (scan, still))
    np.testing.assert_allclose(placed.points_level, swept.points_level, atol=2e-4)
    np.testing.assert_allclose(placed.T_map_base, swept.T_map_base, atol=1e-12)
    assert off_walls_m(placed.to_map(placed.points_level)).max() < 2e-3
    x, y, z = still.points_sensor.T.astype(float)
    elevation_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))
    np.testing.assert_array_equal(still.ring, np.searchsorted(EDGES_DEG, elevation_deg))
    # Without compensation the corridor is smeared.
    untimed = replace(scan, time_ns=None, start_ns=scan.reference_ns)
    smeared = place_scan(untimed, drive(), T_BASE_SENSOR)
    assert np.percentile(off_walls_m(smeared.to_map(smeared.points_level)), 75) > 0.05
