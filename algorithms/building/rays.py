"""Rays of scans for compiled code, the floor below them, and a scan's own view of a wall."""

from typing import NamedTuple

import numba
import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.building.model import BuildingSettings
from ffmap.algorithms.scan.summary import Features


class Rays(NamedTuple):
    """The scans of a block for compiled code, as `Features` holds them, in the map frame.

    floors: (s, 10) for `floor_m`: the six numbers of the floor's pieces, whether the higher of
    them is the floor, how far from the sensor they were looked for, and its x and y.
    """

    origin: FloatArray
    floors: FloatArray
    starts: IntArray
    end: FloatArray
    label: UInt8Array
    intensity: FloatArray
    plane_starts: IntArray
    plane_ends: FloatArray
    plane_normal: FloatArray

    @classmethod
    def of(cls, block: Features) -> "Rays":
        """Those of a block, laid out in memory as compiled code expects it."""
        pieces, origin = block.floor_map.reshape(-1, 6), block.origin_map[:, :2]
        floors = np.column_stack([pieces, block.floor_is_foot, block.floor_reach_m, origin])
        return cls(
            np.ascontiguousarray(block.origin_map, np.float64),
            np.ascontiguousarray(floors, np.float64),
            block.ray_starts,
            np.ascontiguousarray(block.ray_end_map, np.float32),
            block.ray_label,
            np.ascontiguousarray(block.ray_intensity, np.float32),
            block.plane_starts,
            np.ascontiguousarray(block.plane_ends_map, np.float64),
            np.ascontiguousarray(block.plane_normal, np.float64),
        )


class OwnPlane(NamedTuple):
    """What makes a plane of a scan its own view of a face; see `BuildingSettings`.

    cos_angle: of `angle_deg`.
    """

    distance_m: float
    cos_angle: float
    margin_m: float

    @classmethod
    def of(cls, settings: BuildingSettings) -> "OwnPlane":
        """As the settings say."""
        cos_angle = float(np.cos(np.radians(settings.angle_deg)))
        return cls(settings.own_plane_m, cos_angle, settings.own_plane_margin_m)


@numba.njit(cache=True, nogil=True, forceinline=True)
def floor_m(floors: FloatArray, scan: int, x: float, y: float) -> float:  # pragma: no cover
    """Height of the floor at a place in the map (m), as a scan saw it; floors: see `Rays`.

    A ramp ends: beyond where the pieces of a floor that bends were seen, it goes on level.
    """
    bends = False
    for k in range(3):
        bends = bends or floors[scan, k] != floors[scan, 3 + k]
    if bends:
        dx, dy = x - floors[scan, 8], y - floors[scan, 9]
        share = min(1.0, floors[scan, 7] / max(np.sqrt(dx * dx + dy * dy), 1e-9))
        x, y = floors[scan, 8] + share * dx, floors[scan, 9] + share * dy
    first = floors[scan, 0] + floors[scan, 1] * x + floors[scan, 2] * y
    if not bends:
        return float(first)
    second = floors[scan, 3] + floors[scan, 4] * x + floors[scan, 5] * y
    return float(max(first, second) if floors[scan, 6] > 0.0 else min(first, second))


@numba.njit(cache=True, nogil=True)
def own_plane(
    ends: FloatArray, normal: FloatArray, rays: Rays, scan: int, rules: OwnPlane
) -> tuple[float, float, float, float, float]:  # pragma: no cover
    """Normal x, y and offset of a scan's own plane of a wall face, and its stretch of the face.

    Of several planes the one that shares most with the face; the face itself, and no stretch,
    where there is none.
    """
    along = ends[1] - ends[0]
    length = np.sqrt(along[0] ** 2 + along[1] ** 2)
    dx, dy = along[0] / length, along[1] / length
    nx, ny, offset = normal[0], normal[1], normal[0] * ends[0, 0] + normal[1] * ends[0, 1]
    longest, start, stop = 0.0, np.inf, -np.inf
    for p in range(rays.plane_starts[scan], rays.plane_starts[scan + 1]):
        px, py = rays.plane_normal[p, 0], rays.plane_normal[p, 1]
        if px * normal[0] + py * normal[1] < rules.cos_angle:
            continue
        plane_ends = rays.plane_ends[p]
        x0, y0 = plane_ends[0, 0] - ends[0, 0], plane_ends[0, 1] - ends[0, 1]
        x1, y1 = plane_ends[1, 0] - ends[0, 0], plane_ends[1, 1] - ends[0, 1]
        along_0, along_1 = x0 * dx + y0 * dy, x1 * dx + y1 * dy
        low, high = min(along_0, along_1), max(along_0, along_1)
        shared = min(high, length) - max(low, 0.0)
        if shared <= longest:
            continue
        # How far off it is where it lies beside the face; beyond, another wall may go on.
        off_0, off_1 = normal[0] * x0 + normal[1] * y0, normal[0] * x1 + normal[1] * y1
        rise = (off_1 - off_0) / (along_1 - along_0)
        far = max(
            abs(off_0 + rise * (max(low, 0.0) - along_0)),
            abs(off_0 + rise * (min(high, length) - along_0)),
        )
        if far < rules.distance_m:
            longest, start, stop = shared, low, high
            nx, ny = px, py
            offset = px * plane_ends[0, 0] + py * plane_ends[0, 1]
    return nx, ny, offset, start, stop
