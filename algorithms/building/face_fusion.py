"""Wall faces from the wall planes of all scans."""

from collections.abc import Iterable
from functools import reduce

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_WALLS,
    BuildingSettings,
    Walls,
    cells_in,
    stretches,
    unknown_support,
)
from ffmap.algorithms.scan.summary import Features
from ffmap.algorithms.scan.wall_planes import fit_upright_plane

_TWO_SURFACES, _TWO_SURFACES_MIN_M = 3.0, 0.01
"""Scatter of a plane's samples that two surfaces cause: over the lower quartile of all planes', and
at least (m)."""


def fuse_walls(features: Features, settings: BuildingSettings) -> Walls:
    """Wall faces from the wall planes of all scans.

    The planes join largest first, each the wall face of the same side that it fits; moments add up,
    so that a wall's place is the least-squares one over all its scans. A part that fewer than
    `scans_min` scans bear out is dropped, and a wall with a long gap becomes two. A plane that grew
    over a step, as from a wall to the soffit before it, is tilted: it only joins a wall that others
    show, and does not move it.
    """
    if not len(features.plane_moments):
        return NO_WALLS
    length_m = lengths_m(features.plane_ends_map)
    rms_m = np.array([fit_upright_plane(own)[3] for own in features.plane_moments])
    mixed = rms_m > max(_TWO_SURFACES * np.percentile(rms_m, 25), _TWO_SURFACES_MIN_M)
    order = np.lexsort((-length_m * features.plane_lines, mixed))
    moments, normal, ends = (
        np.ascontiguousarray(values, np.float64)
        for values in (features.plane_moments, features.plane_normal, features.plane_ends_map)
    )
    cos_angle = float(np.cos(np.radians(settings.angle_deg)))
    wall = _join(
        moments, normal, ends, order, mixed, cos_angle, settings.distance_m, settings.gap_m
    )
    members = (np.flatnonzero(wall == w) for w in range(int(wall.max(initial=-1)) + 1))
    faces = (face for own in members for face in _faces_of(features, own, mixed[own], settings))
    return reduce(Walls.append, faces, NO_WALLS)


def _faces_of(
    features: Features, members: IntArray, mixed: BoolArray, settings: BuildingSettings
) -> Iterable[Walls]:
    """The stretches of one fused wall that enough scans saw, each a single face.

    members, mixed: (m,) its planes, and which of them hold parts of two surfaces.
    """
    moments = features.plane_moments[members[~mixed]].sum(axis=0)
    nx, ny, offset, rms, _ = fit_upright_plane(moments)
    normal = np.array([nx, ny])
    if np.sum(features.plane_normal[members] @ normal) < 0:
        normal, offset = -normal, -offset
    along = np.array([-normal[1], normal[0]])
    place = np.sort(features.plane_ends_map[members] @ along, axis=1)
    low = place.min()
    bins = np.floor((place - low) / CELL_M).astype(np.int64)
    cover = np.zeros(bins.max() + 2)
    np.add.at(cover, bins[:, 0], 1)
    np.add.at(cover, bins[:, 1] + 1, -1)
    enough = np.cumsum(cover)[:-1] >= settings.scans_min
    for first, last in stretches(enough, cells_in(settings.gap_m)):
        start, stop = low + first * CELL_M, low + (last + 1) * CELL_M
        if stop - start < settings.length_min_m:
            continue
        inside = members[(place[:, 1] > start) & (place[:, 0] < stop)]
        yield Walls(
            ends=np.stack([normal * offset + along * start, normal * offset + along * stop])[None],
            normal=normal[None],
            bottom_m=np.percentile(features.plane_bottom_m[inside], [10]),
            top_m=np.percentile(features.plane_top_m[inside], [90]),
            scan_count=np.array([len(np.unique(features.plane_scan[inside]))], np.int32),
            rms_m=np.array([rms]),
            sample_count=np.array([features.plane_moments[inside, 0].sum()], np.int64),
            support=unknown_support(1),
        )


@numba.njit(cache=True, nogil=True)
def _join(
    moments: FloatArray,
    normal: FloatArray,
    ends: FloatArray,
    order: IntArray,
    mixed: BoolArray,
    cos_angle: float,
    distance_m: float,
    gap_m: float,
) -> IntArray:  # pragma: no cover
    """The fused wall of each plane, numbered from 0; -1 where it is none's."""
    count = len(order)
    wall = np.full(count, -1, np.int64)
    total = np.zeros((count, 6))
    facing = np.zeros((count, 2))
    fit = np.zeros((count, 5))  # normal x, y, offset, lowest and highest place along it
    walls = 0
    for position in range(count):
        p = order[position]
        best, nearest = -1, distance_m
        for w in range(walls):
            if facing[w, 0] * normal[p, 0] + facing[w, 1] * normal[p, 1] < cos_angle:
                continue
            nx, ny, offset = fit[w, 0], fit[w, 1], fit[w, 2]
            far = 0.0
            low, high = np.inf, -np.inf
            for e in range(2):
                far = max(far, abs(nx * ends[p, e, 0] + ny * ends[p, e, 1] - offset))
                u = -ny * ends[p, e, 0] + nx * ends[p, e, 1]
                low, high = min(low, u), max(high, u)
            if far < nearest and max(low, fit[w, 3]) - min(high, fit[w, 4]) < gap_m:
                best, nearest = w, far
        if best < 0:
            if mixed[p]:
                continue
            best = walls
            walls += 1
            fit[best, 3], fit[best, 4] = np.inf, -np.inf
        wall[p] = best
        if not mixed[p]:
            total[best] += moments[p]
        old = fit[best].copy()
        nx, ny, offset, _, _ = fit_upright_plane(total[best])
        if nx * normal[p, 0] + ny * normal[p, 1] < 0:
            nx, ny, offset = -nx, -ny, -offset
        facing[best, 0], facing[best, 1] = nx, ny
        low, high = np.inf, -np.inf
        for e in range(2):
            u = -ny * ends[p, e, 0] + nx * ends[p, e, 1]
            low, high = min(low, u), max(high, u)
        if old[3] < old[4]:
            # The direction hardly moves once a wall is long: carry its old ends over.
            for u_old in (old[3], old[4]):
                x = old[0] * old[2] - old[1] * u_old
                y = old[1] * old[2] + old[0] * u_old
                u = -ny * x + nx * y
                low, high = min(low, u), max(high, u)
        fit[best, 0], fit[best, 1], fit[best, 2] = nx, ny, offset
        fit[best, 3], fit[best, 4] = low, high
    return wall
