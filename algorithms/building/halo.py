"""The halo of surfaces: where what scans call clutter is the scatter of a floor, a ceiling or a wall of the building."""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import pairs_near
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import along_lines_m, lines_of, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_foreground import Foreground
from ffmap.algorithms.building.model import CELL_M, Doors, Walls
from ffmap.algorithms.building.storey import Storey
from ffmap.algorithms.building.votes import AXIS_BITS, VoxelVotes, cubes_of, unpack_cubes


class HaloSettings(StepSettings):
    """Telling the scatter of surfaces from clutter."""

    ratio: float = Field(
        10.0,
        ge=1,
        description="Clutter with fewer than one in this many votes of the surface beside it is its scatter.",
    )
    wall_m: float = Field(
        0.12, gt=0, description="Maximum distance (m) from a face of clutter that may be the wall's scatter."
    )
    leaf_m: float = Field(1.0, ge=0, description="Maximum distance (m) of an open leaf from its doorway.")
    leaf_off_m: float = Field(0.03, ge=0, description="Minimum distance (m) of an open leaf from its wall.")


@dataclass(frozen=True)
class Halo:
    """Cubes where what a scan calls clutter is the scatter of a floor, a ceiling or a wall: `find_halo`.

    keys: (m,) int64, increasing; label: (m,) uint8, of the surface; voxel_m: the cubes' edge.
    """

    keys: IntArray
    label: UInt8Array
    voxel_m: float

    @property
    def centres(self) -> FloatArray:
        """(m, 3) metres, of the cubes."""
        return np.asarray((unpack_cubes(self.keys) + 0.5) * self.voxel_m)

    def label_of(self, points_map: FloatArray, label: UInt8Array) -> UInt8Array:
        """The labels (n,) of points (n, 3), clutter in a halo given its surface's."""
        clutter = np.flatnonzero(label == Label.CLUTTER)
        if not len(self.keys) or not len(clutter):
            return label
        key, _ = cubes_of(np.ascontiguousarray(points_map[clutter]), 1.0 / self.voxel_m)
        place = np.minimum(np.searchsorted(self.keys, key), len(self.keys) - 1)
        within = self.keys[place] == key
        corrected = label.copy()
        corrected[clutter[within]] = self.label[place[within]]
        return corrected


def find_halo(votes: VoxelVotes, settings: HaloSettings) -> Halo:
    """Where clutter beside a surface has too few returns to be an object, and is that surface's scatter.

    A cube is in a surface's halo where it, or a cube that shares a face with it, has at least `ratio` votes for floor, ceiling or
    wall for each that it has for clutter itself.
    """
    surfaces = votes.counts[:, [Label.FLOOR, Label.CEILING, Label.WALL]].astype(np.int64)
    strength = surfaces.max(axis=1, initial=0)
    dense = strength >= settings.ratio
    codes = np.array([Label.FLOOR, Label.CEILING, Label.WALL], np.uint8)[surfaces.argmax(axis=1)]
    steps = np.array([0, *(sign << axis * AXIS_BITS for axis in range(3) for sign in (1, -1))])
    key = (votes.keys[dense, None] + steps).ravel()
    reach, label = np.repeat(strength[dense], len(steps)), np.repeat(codes[dense], len(steps))
    order = np.lexsort((-reach, key))
    key, reach, label = key[order], reach[order], label[order]
    strongest = np.append(True, key[1:] != key[:-1])[: len(key)]
    key, reach, label = key[strongest], reach[strongest], label[strongest]
    place = np.minimum(np.searchsorted(votes.keys, key), len(votes) - 1)
    clutter = np.where(votes.keys[place] == key, votes.counts[place, Label.CLUTTER], 0) if len(key) else key
    thin = reach >= settings.ratio * np.maximum(clutter, 1)
    return Halo(key[thin], label[thin], votes.voxel_m)


def halo_at_walls(
    halo: Halo,
    walls: Walls,
    doors: Doors,
    foreground: Foreground,
    storey: Storey,
    settings: HaloSettings,
) -> Halo:
    """The halo without that of "walls" which the building does not have: ducts, leaves, cupboards that scans took for walls.

    They lie farther than `wall_m` from every face, or stand before one, or before or behind a doorway, as its leaf does.
    """
    of_wall = np.flatnonzero(halo.label == Label.WALL)
    centre = halo.centres[of_wall]
    height_m = centre[:, 2] - storey.ground_m(centre[:, :2])
    cube, face = pairs_near(walls, centre, settings.wall_m)
    along_m = along_lines_m(lines_of(walls)[face], centre[cube, :2])
    columns = np.diff(foreground.first)[face]
    column = foreground.first[face] + np.clip((along_m / CELL_M).astype(np.int64), 0, columns - 1)
    row = np.clip((height_m[cube] / CELL_M).astype(np.int64), 0, foreground.covered.shape[1] - 1)
    at_face = np.zeros(len(centre), bool)
    at_face[cube[~foreground.covered[column, row]]] = True
    for doorway, reveal_m, head_m in zip(segments(doors), doors.reveal_m, doors.head_m, strict=True):
        before_m = doorway.before_m(centre)
        within_wall = (before_m > -reveal_m - settings.leaf_off_m) & (before_m < settings.leaf_off_m)
        between_jambs = doorway.beside(centre) & (height_m < head_m)
        at_face &= ~(between_jambs & (np.abs(before_m) < settings.leaf_m) & ~within_wall)
    kept = np.ones(len(halo.keys), bool)
    kept[of_wall] = at_face
    return Halo(halo.keys[kept], halo.label[kept], halo.voxel_m)
