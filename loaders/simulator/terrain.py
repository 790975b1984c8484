"""The ground under a building: a slope, and a ramp halfway along the corridor."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator.mesh import UP, Mesh, Rng, Span
from ffmap.loaders.simulator.settings import SimulationSettings

_RAMP_GRADIENT = 0.08  # ADA 405.2: 1:12
_FACET_M = 0.6
_REACH_M = 0.25  # From the middle of the robot to its wheels


@dataclass(frozen=True)
class Terrain:
    """Height of the floor; walls stay upright, ceilings follow the floor.

    gradient: (2,) of the slope. ramp_x_m: start and end of the ramp along the plan's x.
    """

    gradient: FloatArray
    ramp_x_m: Span
    ramp_rise_m: float

    def height(self, xy: FloatArray) -> FloatArray:
        """Return heights (n,) of the floor at places (n, 2) of the plan."""
        ramp = np.interp(xy[:, 0], self.ramp_x_m, (0.0, self.ramp_rise_m))
        return np.asarray(xy @ self.gradient + ramp)

    def lift_mesh(self, mesh: Mesh) -> Mesh:
        """Return the building on this ground; triangles that bend with the ramp are divided."""
        if self.ramp_rise_m:
            mesh = _divided(mesh, self.ramp_x_m)
        return mesh.warped(lambda vertices: vertices + self.height(vertices[:, :2])[:, None] * UP)

    def lift_drive(self, drive: Trajectory) -> Trajectory:
        """Return the poses of a robot that follows this ground."""
        T = drive.T_map_base.copy()
        centre, fore, left = T[:, :2, 3], T[:, :2, 0] * _REACH_M, T[:, :2, 1] * _REACH_M
        rise, bank = (
            (self.height(centre + to) - self.height(centre - to)) / (2 * _REACH_M)
            for to in (fore, left)
        )
        tilt = Rotation.from_euler("YX", np.arctan(np.stack([-rise, bank], 1)))
        T[:, 2, 3] += self.height(centre)
        T[:, :3, :3] = T[:, :3, :3] @ tilt.as_matrix()
        return Trajectory(drive.stamp_ns, T)


def draw_terrain(corridor: FloatArray, settings: SimulationSettings, rng: Rng) -> Terrain:
    """Draw the direction of the slope; the ramp is in the middle of the corridor's first leg."""
    heading, slope = rng.uniform(0, 2 * np.pi), np.tan(np.radians(settings.floor_slope_deg))
    middle, half = 0.5 * float(corridor[1, 0]), max(settings.ramp_rise_m / _RAMP_GRADIENT / 2, 0.1)
    gradient = slope * np.array([np.cos(heading), np.sin(heading)])
    return Terrain(gradient, (middle - half, middle + half), settings.ramp_rise_m)


def _divided(mesh: Mesh, ramp_x_m: Span) -> Mesh:
    """Divide the building's triangles that cross the ends of the ramp."""
    x = mesh.triangles[..., 0]
    near = np.ptp(x, axis=1) < 60.0  # Not the ground outside
    crossing = near & np.any([(x.min(1) < end) & (x.max(1) > end) for end in ramp_x_m], axis=0)
    vertices = mesh.triangles[crossing].reshape(-1, 3)
    triangles = np.arange(len(vertices)).reshape(-1, 3)
    vertices, triangles, source = trimesh.remesh.subdivide_to_size(  # type: ignore[no-untyped-call]
        vertices, triangles, _FACET_M, max_iter=12, return_index=True
    )
    return Mesh(
        np.concatenate([mesh.triangles[~crossing], vertices[triangles]]),
        np.concatenate([mesh.faces[~crossing], mesh.faces[crossing][source]]),
    )
