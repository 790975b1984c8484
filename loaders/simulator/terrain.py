"""How the ground under a building rises: a slope, and a ramp halfway along the corridor."""

from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.trajectory import Trajectory
from ffmap.loaders.simulator.mesh import Mesh
from ffmap.loaders.simulator.settings import SimulationSettings

_RAMP_GRADIENT = 0.08
_FACET_M = 0.6


@dataclass(frozen=True)
class Terrain:
    """The floor's height over the plan; walls stay upright, ceilings follow the floor.

    gradient: (2,) of the slope. ramp_x_m: where the ramp starts and ends along the plan's x.
    """

    gradient: FloatArray
    ramp_x_m: tuple[float, float]
    ramp_rise_m: float

    @property
    def level(self) -> bool:
        return not self.ramp_rise_m and not self.gradient.any()

    def height(self, xy: FloatArray) -> FloatArray:
        """Height (n,) of the floor at places (n, 2) of the plan, metres."""
        start, end = self.ramp_x_m
        return np.asarray(xy @ self.gradient + np.clip((xy[:, 0] - start) / (end - start), 0, 1) * self.ramp_rise_m)

    def lift_mesh(self, mesh: Mesh) -> Mesh:
        """The building on this ground; large triangles are cut so that they can bend with the ramp."""
        if self.level:
            return mesh
        if self.ramp_rise_m:
            mesh = _facetted(mesh)
        return mesh.warped(lambda vertices: vertices + np.outer(self.height(vertices[:, :2]), [0.0, 0.0, 1.0]))

    def lift_drive(self, drive: Trajectory) -> Trajectory:
        """The robot on this ground, its base standing upright on the floor below it."""
        if self.level:
            return drive
        T = drive.T_map_base.copy()
        centre = T[:, :2, 3]
        reach = 0.25
        fore, left = T[:, :2, 0] * reach, T[:, :2, 1] * reach
        rise = (self.height(centre + fore) - self.height(centre - fore)) / (2 * reach)
        bank = (self.height(centre + left) - self.height(centre - left)) / (2 * reach)
        T[:, 2, 3] += self.height(centre)
        T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_euler("YX", np.arctan(np.stack([-rise, bank], 1))).as_matrix()
        return Trajectory(drive.stamp_ns, T)


def draw_terrain(
    corridor: FloatArray, settings: SimulationSettings, rng: np.random.Generator, ramp_gradient: float = _RAMP_GRADIENT
) -> Terrain:
    """The slope's direction is drawn; the ramp lies in the middle of the corridor's first leg."""
    direction = rng.uniform(0, 2 * np.pi)
    gradient = np.tan(np.radians(settings.floor_slope_deg)) * np.array([np.cos(direction), np.sin(direction)])
    middle = 0.5 * float(corridor[1, 0])
    half = max(settings.ramp_rise_m / ramp_gradient / 2, 0.1)
    return Terrain(gradient, (middle - half, middle + half), settings.ramp_rise_m)


def _facetted(mesh: Mesh) -> Mesh:
    """Triangles near the building cut in four until no side is longer than _FACET_M; the far outside stays as it is."""
    while True:
        triangles = mesh.triangles
        sides = np.linalg.norm(np.roll(triangles, -1, axis=1)[..., :2] - triangles[..., :2], axis=2).max(1)
        cut = (sides > _FACET_M) & (sides < 60.0)
        if not cut.any():
            return mesh
        a, b, c = (triangles[cut, i] for i in range(3))
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        others = [getattr(mesh, field.name) for field in fields(mesh)[1:]]
        tiled = [np.concatenate([values[~cut], np.tile(values[cut], 4)]) for values in others]
        mesh = Mesh(np.concatenate([triangles[~cut], *quarters]), *tiled)
