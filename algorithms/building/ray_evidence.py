"""What the rays of all scans found in each cell of each wall face.

Nikoohemat et al. (2018) tell a wall's cells apart as filled, empty and occluded by the rays that passed them.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numba
import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import SECTORS, enter, sector_of, sectors_around
from ffmap.algorithms.base.scan import FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import AT_FACE_M, CELL_M, BuildingSettings, Walls
from ffmap.algorithms.scan.summary import Features

FILLED, SUM, SQUARES, THROUGH = range(4)
"""What `WallCells.counts` holds of each cell."""
ANGLES_DEG = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
"""What parts angles of incidence: only returns of like angles have comparable intensities."""
FOOT_ROW = 2
"""The lowest row above sills, skirting boards and the floor's own returns."""

_PARTS_MAX = 4
"""Threads that count rays: each reads all scans anew."""

_COSINES = np.cos(np.radians(ANGLES_DEG))


@dataclass(frozen=True)
class WallCells:
    """What the rays found in each cell of each wall face: columns along it, rows from the floor up, 5 cm each.

    first: (W + 1,) the column at which each wall begins. rows: how many.
    counts: (columns, rows, 4) float32: returns near the face, the sum and the sum of squares of their distances before
    it (metres, negative behind), rays that went through.
    light: (columns, rows, angles, 2) float32: returns at the face of which the intensity is known, and its sum, by the angle of
    incidence (`ANGLES_DEG`); (0, rows, angles, 2) where no scan has any, or rays were not measured against scans' planes.
    """

    first: IntArray
    rows: int
    counts: FloatArray
    light: FloatArray = field(default_factory=lambda: np.zeros((0, 0, len(ANGLES_DEG) + 1, 2), np.float32))

    def minus(self, less: "WallCells") -> "WallCells":
        """Without what some of these rays found of the same faces. Cells in which these found all are left with exact zeros: both
        were summed in one order."""
        light = self.light - less.light if len(less.light) else self.light
        return replace(self, counts=self.counts - less.counts, light=light)

    def of(self, wall: int) -> "WallCells":
        """Of one face alone."""
        own = slice(self.first[wall], self.first[wall + 1])
        return WallCells(
            self.first[wall : wall + 2] - self.first[wall],
            self.rows,
            self.counts[own],
            self.light[own],
        )

    def columns(self, stretches: list[tuple[int, int, int]]) -> IntArray:
        """(c,) the columns of stretches of faces, each a face, its first column and the one after the last."""
        parts = [self.first[w] + np.arange(first, after) for w, first, after in stretches]
        return np.concatenate([np.zeros(0, np.int64), *parts])

    def part(self, stretches: list[tuple[int, int, int]]) -> "WallCells":
        """Of stretches alone, see `columns`; each is a face of its own then."""
        columns = self.columns(stretches)
        starts = np.concatenate([[0], np.cumsum([after - first for _, first, after in stretches])]).astype(np.int64)
        light = self.light[columns] if len(self.light) else self.light
        return WallCells(starts, self.rows, self.counts[columns], light)


class Rays(NamedTuple):
    """The scans of a block for compiled code, as `Features` holds them, in the map frame.

    floors: (s, 10) for `floor_m`: the six numbers of the floor's pieces, whether the higher of them is the floor, how far from
    the sensor they were looked for, and its x and y.
    """

    origin: FloatArray
    floors: FloatArray
    starts: IntArray
    end: FloatArray
    label: UInt8Array
    plane_starts: IntArray
    plane_ends: FloatArray
    plane_normal: FloatArray
    intensity: FloatArray

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
            block.plane_starts,
            np.ascontiguousarray(block.plane_ends_map, np.float64),
            np.ascontiguousarray(block.plane_normal, np.float64),
            np.ascontiguousarray(block.ray_intensity, np.float32),
        )


class OwnPlane(NamedTuple):
    """What makes a plane of a scan its own view of a face; see `BuildingSettings`. cos_angle: of `angle_deg`."""

    distance_m: float
    cos_angle: float
    margin_m: float

    @classmethod
    def of(cls, settings: BuildingSettings) -> "OwnPlane":
        """As the settings say."""
        cos_angle = float(np.cos(np.radians(settings.angle_deg)))
        return cls(settings.own_plane_m, cos_angle, settings.own_plane_margin_m)


def trace_rays(walls: Walls, blocks: Iterable[Features], settings: BuildingSettings) -> WallCells:
    """Every ray against every wall face that looks towards its origin: what it hit there, or that it went through.

    Where the scan itself has a plane of that wall (`own_plane_m`), its rays are measured against that: a leaf lies centimetres
    behind its wall, and the pose may be off by a part of that. blocks: features in any portions.
    """
    first = first_columns(walls)
    columns, rows = int(first[-1]), rows_of(walls)
    counts = np.zeros((columns, rows, 4), np.float32)
    light = np.zeros((0, rows, len(ANGLES_DEG) + 1, 2), np.float32)
    # Asked about faces of which no scan saw a plane, rays tell whether something stands there, not of what it is made.
    own, has_light = OwnPlane.of(settings), settings.own_plane_m > 0.0
    for block in blocks:
        rays = Rays.of(block)
        if len(rays.intensity) and has_light and not len(light):
            light = np.zeros((columns, *light.shape[1:]), np.float32)
        _trace(walls.ends, walls.normal, first, counts, light, rays, settings.near_m, settings.range_m, own, _COSINES)
    return WallCells(first, rows, counts, light)


def trace_shared(
    walls: Walls, blocks: Callable[[], Iterable[Features]], settings: BuildingSettings, workers: int
) -> WallCells:
    """As `trace_rays`, by several threads, each of which asks all rays about some of the faces: no sum depends on how many they
    are.

    blocks: gives all features anew each time.
    """
    parts = max(min(workers, _PARTS_MAX, len(walls)), 1)
    same_rows = replace(walls, top_m=np.full(len(walls), walls.top_m.max(initial=0.0)))

    def trace_some(part: int) -> WallCells:
        # Long faces and short ones, of all rooms, so that no thread has most of the work.
        return trace_rays(same_rows.select(slice(part, None, parts)), blocks(), settings)

    with ThreadPoolExecutor(parts) as threads:
        found = list(threads.map(trace_some, range(parts)))
    if parts == 1:
        return found[0]
    return joined(first_columns(walls), rows_of(walls), [found[w % parts].of(w // parts) for w in range(len(walls))])


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


def first_columns(walls: Walls) -> IntArray:
    """(W + 1,) the column at which each face begins, if all faces' columns are counted one after the other."""
    return np.concatenate([[0], np.cumsum(np.ceil(lengths_m(walls.ends) / CELL_M))]).astype(np.int64)


def rows_of(walls: Walls) -> int:
    """How many rows of cells there are for some faces: half a metre more than the highest of them needs."""
    return int(np.ceil((float(walls.top_m.max(initial=2.0)) + 0.5) / CELL_M))


def joined(first: IntArray, rows: int, faces: list[WallCells]) -> WallCells:
    """The cells of several faces, each at least `rows` high, one after the other. first: see `WallCells`."""
    counts = [np.zeros((0, rows, 4), np.float32), *(face.counts[:, :rows] for face in faces)]
    light = [np.zeros((0, rows, len(ANGLES_DEG) + 1, 2), np.float32), *(face.light[:, :rows] for face in faces)]
    return WallCells(first, rows, np.concatenate(counts), np.concatenate(light))


def returns_at_face(counts: FloatArray) -> FloatArray:
    """(…) the returns that are a face's own, of its cells or sums of them (…, 4): none where their mean lies off it."""
    filled, total = counts[..., FILLED].astype(np.float64), counts[..., SUM].astype(np.float64)
    return np.where(np.abs(total) < AT_FACE_M * filled, filled, 0.0)


def mean_before_m(counts: FloatArray) -> FloatArray:
    """(…) mean distance before the face of the returns of cells, or of sums of them (…, 4); NaN without any."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(counts[..., SUM] / counts[..., FILLED])


def depth_moments(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same, and the variance (…) about it."""
    mean_m = mean_before_m(counts)
    with np.errstate(invalid="ignore", divide="ignore"):
        return mean_m, np.maximum(counts[..., SQUARES] / counts[..., FILLED] - mean_m**2, 0.0)


def with_neighbours(counts: FloatArray) -> FloatArray:
    """Each column with the counts of the two beside it: an emitter's lines may stand farther apart than a column is."""
    summed = counts.copy()
    summed[1:] += counts[:-1]
    summed[:-1] += counts[1:]
    return summed


@numba.njit(cache=True, nogil=True)
def own_plane(
    ends: FloatArray, normal: FloatArray, rays: Rays, scan: int, rules: OwnPlane
) -> tuple[float, float, float, float, float]:  # pragma: no cover
    """Normal x, y and offset of a scan's own plane of a wall face, and the stretch of the face over which it was seen.

    Of several planes the one that shares most with the face; the face itself, and no stretch, where there is none.
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
        far = max(abs(off_0 + rise * (max(low, 0.0) - along_0)), abs(off_0 + rise * (min(high, length) - along_0)))
        if far < rules.distance_m:
            longest, start, stop = shared, low, high
            nx, ny = px, py
            offset = px * plane_ends[0, 0] + py * plane_ends[0, 1]
    return nx, ny, offset, start, stop


@numba.njit(cache=True, nogil=True)
def _looks_at(origin: FloatArray, ends: FloatArray, normal: FloatArray, range_m: float) -> bool:  # pragma: no cover
    """Whether a face is seen from its front side, from at most `range_m` away."""
    ox, oy = origin[0] - ends[0, 0], origin[1] - ends[0, 1]
    reach = normal[0] * ox + normal[1] * oy
    if reach < 0.1 or reach > range_m:
        return False
    dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    length = np.sqrt(dx * dx + dy * dy)
    nearest = min(max((ox * dx + oy * dy) / length, 0.0), length)
    return bool(np.hypot(dx / length * nearest - ox, dy / length * nearest - oy) <= range_m)


@numba.njit(cache=True, nogil=True)
def _sectors(
    origin: FloatArray, ends: FloatArray, normal: FloatArray, plane: FloatArray, near_m: float
) -> tuple[int, int]:  # pragma: no cover
    """The first sector in which a ray may meet a face, or end close to it, and how many there are from there on.

    plane: (5,) the scan's own view of the face, from `own_plane`.
    """
    reach = normal[0] * (origin[0] - ends[0, 0]) + normal[1] * (origin[1] - ends[0, 1])
    cos_angle = normal[0] * plane[0] + normal[1] * plane[1]
    corners = np.empty((4, 2))
    dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    length = np.sqrt(dx * dx + dy * dy)
    for k in range(4):
        # The last column may reach beyond the face's end.
        share = 1.0 + CELL_M / length if k // 2 else 0.0
        x, y = ends[0, 0] + share * dx, ends[0, 1] + share * dy
        # The scan's own plane meets the upright of the face's end here.
        off = (plane[2] - plane[0] * x - plane[1] * y) / cos_angle
        before = max(off, 0.0) + 0.2 if k % 2 else min(off, 0.0) - near_m - 0.1
        if before > reach - 0.1:
            return 0, SECTORS
        corners[k, 0], corners[k, 1] = x + before * normal[0] - origin[0], y + before * normal[1] - origin[1]
    return sectors_around(corners)


@numba.njit(cache=True, nogil=True, inline="always")
def _angle_band(across: float, dx: float, dy: float, dz: float, cosines: FloatArray) -> int:  # pragma: no cover
    """Which of the angles of incidence a ray has; across: its length along the face's normal."""
    cosine, band = across / np.sqrt(dx * dx + dy * dy + dz * dz), 0
    while band < len(cosines) and cosine < cosines[band]:
        band += 1
    return band


@numba.njit(cache=True, nogil=True)
def _trace(
    ends: FloatArray,
    normal: FloatArray,
    first: IntArray,
    counts: FloatArray,
    light: FloatArray,
    rays: Rays,
    near_m: float,
    range_m: float,
    own: OwnPlane,
    cosines: FloatArray,
) -> None:  # pragma: no cover
    faces, rows = len(ends), counts.shape[1]
    has_light = len(light) > 0 and len(rays.intensity) > 0
    origin, starts, ray_end, label, floors = rays.origin, rays.starts, rays.end, rays.label, rays.floors
    along = np.empty((faces, 2))
    for w in range(faces):
        dx, dy = ends[w, 1, 0] - ends[w, 0, 0], ends[w, 1, 1] - ends[w, 0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        along[w, 0], along[w, 1] = dx / length, dy / length
    planes = np.empty((faces, 5))
    in_sector, met = np.empty((SECTORS, faces), np.int32), np.zeros(SECTORS, np.int64)
    for s in range(len(origin)):
        ox, oy, oz = origin[s, 0], origin[s, 1], origin[s, 2]
        met[:] = 0
        for w in range(faces):
            if not _looks_at(origin[s], ends[w], normal[w], range_m):
                continue
            planes[w] = own_plane(ends[w], normal[w], rays, s, own)
            enter(w, *_sectors(origin[s], ends[w], normal[w], planes[w], near_m), in_sector, met)
        for r in range(starts[s], starts[s + 1]):
            sector = sector_of(ray_end[r, 0] - ox, ray_end[r, 1] - oy)
            for k in range(met[sector]):
                w = in_sector[sector, k]
                x, y, z = np.float64(ray_end[r, 0]), np.float64(ray_end[r, 1]), np.float64(ray_end[r, 2])
                dx, dy = along[w, 0], along[w, 1]
                nx, ny = normal[w, 0], normal[w, 1]
                offset = nx * ends[w, 0, 0] + ny * ends[w, 0, 1]
                place = (x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy
                if planes[w, 3] - own.margin_m < place < planes[w, 4] + own.margin_m:
                    nx, ny, offset = planes[w, 0], planes[w, 1], planes[w, 2]
                reach = nx * ox + ny * oy - offset
                side = nx * x + ny * y - offset
                if reach < 0.1 or side > 0.1:
                    continue
                # Floor and ceiling behind an opening are no leaf: what ended there passed the face.
                level = label[r] == Label.FLOOR or label[r] == Label.CEILING
                near = side > (-AT_FACE_M if level else -near_m)
                if not near:
                    t = reach / (reach - side)
                    x, y, z = ox + t * (x - ox), oy + t * (y - oy), oz + t * (z - oz)
                    place = (x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy
                column = int(np.floor(place / CELL_M))
                if column < 0 or column >= first[w + 1] - first[w]:
                    continue
                row = int(np.floor((z - floor_m(floors, s, x, y)) / CELL_M))
                if row < 0 or row >= rows:
                    continue
                column += first[w]
                if near:
                    counts[column, row, FILLED] += 1.0
                    counts[column, row, SUM] += side
                    counts[column, row, SQUARES] += side * side
                    if has_light and abs(side) < AT_FACE_M and np.isfinite(rays.intensity[r]):
                        angle = _angle_band(reach - side, x - ox, y - oy, z - oz, cosines)
                        light[column, row, angle, 0] += 1.0
                        light[column, row, angle, 1] += rays.intensity[r]
                else:
                    counts[column, row, THROUGH] += 1.0
