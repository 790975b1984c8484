"""The robot's own body in its lidar's clouds."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.own_body import find_own_body, moves
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from tests.synthetic import Box, ranges

CLOUDS = 24
# On its side, looking to the left and right, 0.7 m above the floor.
T_BASE_SENSOR = transforms.make_transform(
    Rotation.from_euler("y", 90, degrees=True), [0.3, 0.0, 0.7]
)
ACROSS, AHEAD = (0.25, 0.1), (0.25, 0.0)  # metres along x and y from cloud to cloud
NOTHING = np.zeros((0, 2, 3))
CUPBOARDS = np.array(
    [
        [[0.0, 0.7, 0.0], [0.8, 1.3, 1.8]],
        [[3.0, -1.4, 0.0], [4.0, -0.8, 0.8]],
        [[6.0, 0.6, 0.0], [6.5, 1.5, 2.6]],
    ]
)
ROOM = np.array([[-1.0, -2.5, 0.0], [9.0, 3.5, 2.6]])
CORRIDOR = np.array([[-40.0, -0.8, 0.0], [40.0, 0.8, 2.4]])
BODIES = {
    "plate": [[-0.45, -0.3, 0.05], [0.25, 0.3, 0.45]],
    "bumper above the floor": [[-0.45, -0.3, 0.05], [0.42, 0.3, 0.2]],
    "on the floor": [[-0.45, -0.3, 0.0], [0.42, 0.3, 0.3]],
    "mast of 4 cm": [[0.28, 0.28, 0.3], [0.32, 0.32, 1.6]],
}


@lru_cache
def clouds(
    corridor: bool, step_m: tuple[float, float], body: str | None = None, empty: bool = False
) -> tuple[list[FloatArray], list[BoolArray]]:
    """Clouds (n, 3) of 16 emitters with 1 cm of noise, a step apart, and which returns are own."""
    generator = np.random.default_rng(1)
    room, things = CORRIDOR if corridor else ROOM, NOTHING if empty else CUPBOARDS
    points, own = [], []
    for i in range(CLOUDS):
        azimuth, elevation = np.meshgrid(
            np.arange(0, 2 * np.pi, np.radians(0.4)) + generator.uniform(0, 0.01),
            np.radians(np.arange(-15, 16, 2)),
        )
        level = np.cos(elevation)
        rays_sensor = np.stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1
        ).reshape(-1, 3)
        rays = rays_sensor @ T_BASE_SENSOR[:3, :3].T
        base = np.array([i * step_m[0], (i - 11.5) * step_m[1], 0.0])
        origin = base + T_BASE_SENSOR[:3, 3]
        range_m = ranges(origin, rays, Box(*room, things))
        held = np.zeros(len(rays), bool)
        if body is not None:
            free_m, robot = range_m, base + np.array(BODIES[body])
            range_m = ranges(origin, rays, Box(*room, np.concatenate([things, robot[None]])))
            held = range_m < free_m
        range_m = range_m + generator.normal(0, 0.01, len(range_m))
        points.append((rays_sensor * range_m[:, None]).astype(np.float32))
        own.append(held)
    return points, own


@pytest.mark.parametrize("body", BODIES)
def test_the_body_of_a_moving_robot_is_found(body: str) -> None:
    points, own = clouds(False, ACROSS, body)
    assert moves(points)
    found = find_own_body(points, T_BASE_SENSOR)
    assert found is not None
    held = np.concatenate([found.holds(cloud) for cloud in points])
    true = np.concatenate(own)
    # At the height of the floor, the body is found below its upper part only.
    points_base = np.concatenate([transforms.apply(T_BASE_SENSOR, cloud) for cloud in points])
    assert np.mean(held[true & (points_base[:, 2] > 0.15)]) > 0.99
    assert np.mean(held[~true]) < 0.03
    assert found.share == pytest.approx(np.mean(held), abs=1e-3)
    low, high = np.array(BODIES[body])[:, :2]
    voxels_base = transforms.apply(T_BASE_SENSOR, found.points_sensor)[:, :2]
    assert np.all((voxels_base > low - 0.15) & (voxels_base < high + 0.15))


@pytest.mark.parametrize(("corridor", "step_m"), [(False, ACROSS), (False, AHEAD), (True, AHEAD)])
@pytest.mark.parametrize("empty", [False, True])
def test_floor_walls_and_furniture_are_no_body(
    corridor: bool, step_m: tuple[float, float], empty: bool
) -> None:
    assert find_own_body(clouds(corridor, step_m, empty=empty)[0], T_BASE_SENSOR) is None


def test_at_rest_or_in_a_bare_corridor_nothing_moves() -> None:
    for corridor, step_m in ((False, (0.0, 0.0)), (False, (0.02, 0.01)), (True, AHEAD)):
        assert not moves(clouds(corridor, step_m, empty=True)[0])
    assert not moves(clouds(False, ACROSS)[0][:5])
