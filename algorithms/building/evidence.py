"""What the rays of all scans found in each cell of each wall face, by how deep they ended.

Nikoohemat et al. (2018) tell a wall's cells apart as filled, empty and occluded by the rays that
passed them. Here a cell says in addition in which layer of depth the rays that crossed it ended.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.plan_index import SECTORS, enter, sector_of, sectors_around
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import CELL_M, Walls
from ffmap.algorithms.building.rays import OwnPlane, Rays, floor_m, own_plane
from ffmap.algorithms.scan.summary import Features

BEFORE, ON, RECESS, DEEP, FAR, BEYOND = range(6)
"""Layers of depth in which rays ended: before the face, on it, behind it by less than `LAYERS_M`,
and beyond all of these."""
LAYERS_M = (0.10, 0.04, -0.03, -0.12, -0.35, -1.0)
"""Where the layers begin (m before the face): those of the face as its range noise and the scatter
of poses are, of a leaf in a frame's rebate, in a wall's reveal, and in the room behind."""
NEAR = RECESS
"""Up to this layer rays ended on the wall, and on what is flat before or in it."""
FOOT_ROW = 2
"""The lowest row above sills, skirting boards and the floor's own returns."""
_LEVEL_BEHIND_M = 0.06
"""Floor and ceiling this far (m) behind a face are seen through an opening in it."""


@dataclass(frozen=True)
class Evidence:
    """The rays of all scans in the cells of wall faces: columns along each, rows from the floor up.

    first: (W + 1,) the column at which each face begins.
    ended: (columns, rows, 6) float32: rays that crossed the cell, by the layer they ended in. Rays
    that ended before the face count where they ended.
    depth_sum: (columns, rows, 5) float32: sum over the rays of each layer but the last of their
    distance before the face (m, negative behind).
    depth_squares: (columns, rows) float32: sum of its squares, of the layers of `NEAR`.
    light: (columns, rows, 3) float32, of the same rays: the number of those with an intensity, and
    the sums of their intensities and of the cosines of their angles of incidence.
    """

    first: IntArray
    ended: FloatArray
    depth_sum: FloatArray
    depth_squares: FloatArray
    light: FloatArray

    def __len__(self) -> int:
        return len(self.first) - 1

    @property
    def rows(self) -> int:
        """Rows of cells."""
        return int(self.ended.shape[1])

    def columns(self, w: int) -> slice:
        """The columns of one face."""
        return slice(int(self.first[w]), int(self.first[w + 1]))

    def of(self, w: int) -> "Evidence":
        """Of one face alone."""
        own = self.columns(w)
        sums = (getattr(self, name)[own] for name in _Sums._fields)
        return Evidence(self.first[w : w + 2] - self.first[w], *sums)

    def part(self, stretches: list[tuple[int, int, int]]) -> tuple[IntArray, "Evidence"]:
        """Stretches of faces as faces of their own, and their columns (c,) here.

        stretches: each a face, its first column and the one after its last.
        """
        parts = [self.first[w] + np.arange(first, after) for w, first, after in stretches]
        columns = np.concatenate([np.zeros(0, np.int64), *parts])
        first = np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
        return columns, Evidence(first, *(getattr(self, name)[columns] for name in _Sums._fields))

    def minus(self, less: "Evidence") -> "Evidence":
        """Without what some of these rays found of the same faces."""
        return Evidence(
            self.first, *(getattr(self, name) - getattr(less, name) for name in _Sums._fields)
        )


class _Sums(NamedTuple):
    """Those of `Evidence`, for compiled code."""

    ended: FloatArray
    depth_sum: FloatArray
    depth_squares: FloatArray
    light: FloatArray

    @classmethod
    def none(cls, columns: int, rows: int) -> "_Sums":
        return cls(
            *(np.zeros((columns, rows, *last), np.float32) for last in ((6,), (5,), (), (3,)))
        )


def trace(
    walls: Walls,
    blocks: Iterable[Features],
    range_m: float,
    own: OwnPlane,
    at_ends: bool = False,
) -> Evidence:
    """Book every ray in the cells of the faces that look towards its origin.

    Where the scan has a plane of its own of a wall, rays are measured against that: a leaf lies
    centimetres behind its wall, and the pose may be off by a part of that.

    range_m: rays from farther tell nothing. blocks: features in any portions. at_ends: book what
    ended behind the face, but not beyond, where it ended: on a reveal it would seem to be within.
    """
    first = first_columns(walls)
    sums = _Sums.none(int(first[-1]), rows_of(walls))
    layers, faces = np.array(LAYERS_M), (walls.ends, walls.normal, first)
    for block in blocks:
        _trace(*faces, sums, Rays.of(block), range_m, own, at_ends, layers)
    return Evidence(first, *sums)


def first_columns(walls: Walls) -> IntArray:
    """(W + 1,) the column at which each face begins, all faces' columns one after the other."""
    counts = np.ceil(lengths_m(walls.ends) / CELL_M)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def rows_of(walls: Walls) -> int:
    """How many rows of cells faces have: half a metre more than the highest of them needs."""
    return int(np.ceil((float(walls.top_m.max(initial=2.0)) + 0.5) / CELL_M))


@numba.njit(cache=True, nogil=True)
def _looks_at(
    origin: FloatArray, ends: FloatArray, normal: FloatArray, range_m: float
) -> bool:  # pragma: no cover
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
    origin: FloatArray, ends: FloatArray, normal: FloatArray, plane: FloatArray
) -> tuple[int, int]:  # pragma: no cover
    """Find the sectors in which a ray may cross a face, or end close before it.

    Returns the first, and how many there are from there on. plane: (5,) the scan's own view of the
    face, from `own_plane`.
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
        before = max(off, 0.0) + LAYERS_M[BEFORE] if k % 2 else min(off, 0.0) - CELL_M
        if before > reach - 0.1:
            return 0, SECTORS
        corners[k, 0] = x + before * normal[0] - origin[0]
        corners[k, 1] = y + before * normal[1] - origin[1]
    return sectors_around(corners)


@numba.njit(cache=True, nogil=True)
def _trace(
    ends: FloatArray,
    normal: FloatArray,
    first: IntArray,
    sums: _Sums,
    rays: Rays,
    range_m: float,
    own: OwnPlane,
    at_ends: bool,
    layers_m: FloatArray,
) -> None:  # pragma: no cover
    faces, rows = len(ends), sums.ended.shape[1]
    origin, starts, ray_end, label = rays.origin, rays.starts, rays.end, rays.label
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
            enter(w, *_sectors(origin[s], ends[w], normal[w], planes[w]), in_sector, met)
        for r in range(starts[s], starts[s + 1]):
            x0, y0, z0 = np.float64(ray_end[r, 0]), np.float64(ray_end[r, 1]), ray_end[r, 2]
            sector = sector_of(x0 - ox, y0 - oy)
            for k in range(met[sector]):
                w = in_sector[sector, k]
                dx, dy = along[w, 0], along[w, 1]
                nx, ny = normal[w, 0], normal[w, 1]
                offset = nx * ends[w, 0, 0] + ny * ends[w, 0, 1]
                reach = nx * ox + ny * oy - offset
                side = nx * x0 + ny * y0 - offset
                share = reach / (reach - side) if side < 0.0 < reach else 1.0
                x, y = ox + share * (x0 - ox), oy + share * (y0 - oy)
                place = (x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy
                if planes[w, 3] - own.margin_m < place < planes[w, 4] + own.margin_m:
                    nx, ny, offset = planes[w, 0], planes[w, 1], planes[w, 2]
                    reach = nx * ox + ny * oy - offset
                    side = nx * x0 + ny * y0 - offset
                if reach < 0.1 or side > layers_m[BEFORE]:
                    continue
                # What ended within an opening came in through it, not through the one beside.
                beside = place < 0.0 or place >= CELL_M * (first[w + 1] - first[w])
                if at_ends and side < 0.0 and beside:
                    continue
                layer = BEYOND
                # Floor and ceiling behind an opening are none of what closes it.
                level = label[r] == Label.FLOOR or label[r] == Label.CEILING
                if not level or side > -_LEVEL_BEHIND_M:
                    layer = BEFORE
                    while layer < BEYOND and side <= layers_m[layer + 1]:
                        layer += 1
                share = 1.0
                if side < 0.0 and (layer == BEYOND or not at_ends):
                    share = reach / (reach - side)
                x, y, z = ox + share * (x0 - ox), oy + share * (y0 - oy), oz + share * (z0 - oz)
                place = (x - ends[w, 0, 0]) * dx + (y - ends[w, 0, 1]) * dy
                column = int(np.floor(place / CELL_M))
                if column < 0 or column >= first[w + 1] - first[w]:
                    continue
                row = int(np.floor((z - floor_m(rays.floors, s, x, y)) / CELL_M))
                if row < 0 or row >= rows:
                    continue
                column += first[w]
                sums.ended[column, row, layer] += 1.0
                if layer < BEYOND:
                    sums.depth_sum[column, row, layer] += side
                if layer <= NEAR:
                    sums.depth_squares[column, row] += side * side
                    if len(rays.intensity) and rays.intensity[r] == rays.intensity[r]:
                        far = np.sqrt((x0 - ox) ** 2 + (y0 - oy) ** 2 + (ray_end[r, 2] - oz) ** 2)
                        light = sums.light[column, row]
                        light[0] += 1.0
                        light[1] += rays.intensity[r]
                        light[2] += (reach - side) / far


def trace_shared(
    walls: Walls,
    blocks: Callable[[], Iterable[Features]],
    range_m: float,
    own: OwnPlane,
    workers: int,
    at_ends: bool = False,
) -> Evidence:
    """Trace in several threads, each of which books all rays in some of the faces.

    No sum depends on the number of threads. blocks: gives all features anew each time.
    """
    parts = max(min(workers, 4, len(walls)), 1)
    # Long faces and short ones, of all rooms, so that no thread has most of the work.
    by_part = [slice(part, None, parts) for part in range(parts)]
    as_high = replace(walls, top_m=np.full(len(walls), walls.top_m.max(initial=0.0)))
    with ThreadPoolExecutor(parts) as threads:
        found = list(
            threads.map(
                lambda chosen: trace(as_high.select(chosen), blocks(), range_m, own, at_ends),
                by_part,
            )
        )
    return joined([found[w % parts].of(w // parts) for w in range(len(walls))], rows_of(walls))


def joined(faces: list[Evidence], rows: int) -> Evidence:
    """The evidence of several faces, each at least `rows` high, one after the other."""
    first = np.concatenate([[0], np.cumsum([len(face.ended) for face in faces])]).astype(np.int64)
    sums = (
        np.concatenate([none, *(getattr(face, name)[:, :rows] for face in faces)])
        for name, none in _Sums.none(0, rows)._asdict().items()
    )
    return Evidence(first, *sums)
