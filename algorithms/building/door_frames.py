"""Where doors' jambs, heads and reveals are, to a centimetre."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    ON_FACE_M,
    BuildingSettings,
    Doors,
    Walls,
    stretches,
)
from ffmap.algorithms.building.rays import OwnPlane, Rays, floor_m, own_plane
from ffmap.algorithms.scan.summary import Features

_BIN_M = 0.01
"""The places that an edge of an opening may have lie this far apart."""
_JAMB_REACH_M = 0.2
"""Greatest distance (m) of a jamb from where the face's cells show it."""
_FROM_M, _TO_M = 0.3, 6.0
"""Distances (m) of scans before the face: nearer ones see it aslant, others have few rays there."""
_CORNER_M = 0.15
"""Closer to a jamb (m) rays tell nothing of the head, and the reverse."""
_FOOT_M = 0.2
"""Lower above the floor (m) sills, stops and thresholds stand in the doorway."""
_UNDERSIDE_M = 0.08
"""Greatest distance (m) from a door's head of returns from its lintel's underside."""
_BEHIND_MAX_M = 0.1
"""Greatest depth (m) behind the face that a ray through it counts with."""
_RAYS_MIN = 30
"""Least rays on the face, and behind it, that place a jamb or a head."""
_REVEAL_MAX_M = 0.7
"""Greatest depth (m) of a door's reveals."""


class _Frames(NamedTuple):
    """Doors for compiled code: see `Doors`; the ends and normals of their walls' faces.

    is_open: whether no leaf was seen in it.
    """

    ends: FloatArray
    head_m: FloatArray
    is_open: BoolArray
    depth_m: FloatArray
    wall_ends: FloatArray
    wall_normal: FloatArray


class _Evidence(NamedTuple):
    """What rays tell of the edges of D openings.

    jamb_cost_m, head_cost_m: (D, 2, bins), (D, bins) by how much rays end off where they would with
        the edge in each bin, from within the opening outwards.
    jamb_rays, head_rays: (D, 2, 2), (D, 2) rays that ended on the face, and behind it.
    scans: (D, 3) the number of scans that tell of the door, the first and the last.
    """

    jamb_cost_m: FloatArray
    jamb_rays: IntArray
    head_cost_m: FloatArray
    head_rays: IntArray
    scans: IntArray

    @classmethod
    def none(cls, doors: int, heads_m: tuple[float, float]) -> "_Evidence":
        jamb_bins = 1 + round(2 * _JAMB_REACH_M / _BIN_M)
        head_bins = round((heads_m[1] - heads_m[0]) / _BIN_M)
        return cls(
            np.zeros((doors, 2, jamb_bins)),
            np.zeros((doors, 2, 2), np.int64),
            np.zeros((doors, head_bins)),
            np.zeros((doors, 2), np.int64),
            np.tile(np.array([0, -1, -1], np.int64), (doors, 1)),
        )


def place_frames(
    doors: Doors,
    walls: Walls,
    blocks: Iterable[Features],
    building: BuildingSettings,
) -> Doors:
    """The doors with jambs and head to a centimetre, and with the scans that saw these.

    Beyond a jamb or the head rays end on the wall's face, within they pass it or end on the leaf
    behind, or on the reveal or the lintel's underside. Each edge goes where rays contradict it
    least; one without rays on both sides stays.

    walls: those that `doors.wall` counts.
    """
    heads_m = building.door_height_min_m - 2.0 * CELL_M, building.door_height_max_m + 2.0 * CELL_M
    evidence = _Evidence.none(len(doors), heads_m)
    frames = _Frames(
        np.ascontiguousarray(doors.ends, np.float64),
        np.ascontiguousarray(doors.head_m, np.float64),
        np.isnan(doors.depth_m),
        np.fmin(doors.depth_m, _BEHIND_MAX_M),
        np.ascontiguousarray(walls.ends[doors.wall], np.float64),
        np.ascontiguousarray(walls.normal[doors.wall], np.float64),
    )
    own = OwnPlane.of(building)
    for block in blocks:
        _compare_with_frames(
            frames, evidence, np.asarray(block.scan, np.int64), Rays.of(block), own, heads_m
        )
    ends, head_m = doors.ends.copy(), doors.head_m.copy()
    for d, doorway in enumerate(segments(doors)):
        if doors.depth_m[d] <= 0.0:
            continue  # Its leaf is flush, or hangs before the wall, and looks as that does.
        for side, outwards in ((0, -1.0), (1, 1.0)):
            edge_m = _edge_m(evidence.jamb_cost_m[d, side], evidence.jamb_rays[d, side], _RAYS_MIN)
            if edge_m is not None:
                ends[d, side] += outwards * doorway.along * (edge_m - _JAMB_REACH_M)
        edge_m = _edge_m(evidence.head_cost_m[d], evidence.head_rays[d], _RAYS_MIN)
        # Above the highest leaves it is the recess that ends, which holds an overlight too.
        highest_m = np.inf if frames.is_open[d] else building.door_height_max_m + CELL_M
        if edge_m is not None and heads_m[0] + edge_m < highest_m:
            head_m[d] = heads_m[0] + edge_m
    count, first, last = evidence.scans.T
    return replace(
        doors,
        ends=ends,
        head_m=head_m,
        scan_count=count.astype(np.int32),
        first_scan=first,
        last_scan=last,
    )


def _edge_m(cost_m: FloatArray, rays: IntArray, rays_min: int) -> float | None:
    """Where (m) from the first bin rays contradict an edge least; None where too few tell."""
    return float(np.argmin(cost_m)) * _BIN_M if rays.min() >= rays_min else None


@numba.njit(cache=True, nogil=True)
def _add_costs(
    cost_m: FloatArray,
    first_m: float,
    place_m: float,
    outwards: float,
    end_m: float,
    depth_m: float,
) -> None:  # pragma: no cover
    """Add, for an edge in each bin, by how much a ray ended off where it then should have.

    Beyond the edge a ray ends on the face; within, on the leaf or wherever, or before on the reveal
    or the lintel's underside, if it comes near enough.

    first_m: the first bin's place. place_m: where the ray meets the face; outwards: by how many
        metres it nears the edge for each behind that. end_m: how far behind the face it ended;
        depth_m: where it would within the opening.
    """
    for k in range(len(cost_m)):
        inside_m = first_m + k * _BIN_M - place_m
        off_m = abs(end_m)
        if inside_m > 0.0:
            off_m = depth_m - end_m
            if outwards > 0.0:
                off_m = min(off_m, abs(end_m - inside_m / outwards))
        cost_m[k] += min(off_m, depth_m)


@numba.njit(cache=True, nogil=True)
def _compare_with_frames(
    frames: _Frames,
    evidence: _Evidence,
    scan: IntArray,
    rays: Rays,
    own: OwnPlane,
    heads_m: tuple[float, float],
) -> None:  # pragma: no cover
    ends, head_m, is_open, depth_m, wall_ends, wall_normal = frames
    jamb_cost_m, jamb_rays, head_cost_m, head_rays, scans = evidence
    origin, starts, ray_end, floors = rays.origin, rays.starts, rays.end, rays.floors
    for d in range(len(ends)):
        dx, dy = ends[d, 1, 0] - ends[d, 0, 0], ends[d, 1, 1] - ends[d, 0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        for s in range(len(origin)):
            ox, oy = origin[s, 0] - ends[d, 0, 0], origin[s, 1] - ends[d, 0, 1]
            reach = wall_normal[d, 0] * ox + wall_normal[d, 1] * oy
            # Seen at a slant, a leaf's recess shifts where rays pass the face.
            aslant = (
                not is_open[d]
                and abs(ox * dx + oy * dy - 0.5 * length) > 2.0 * reach + 0.5 * length
            )
            if aslant or reach < _FROM_M or reach > _TO_M:
                continue
            nx, ny, offset, start, stop = own_plane(wall_ends[d], wall_normal[d], rays, s, own)
            wx, wy = ends[d, 0, 0] - wall_ends[d, 0, 0], ends[d, 0, 1] - wall_ends[d, 0, 1]
            if not start < wx * dx + wy * dy + 0.5 * length < stop:
                nx, ny = wall_normal[d, 0], wall_normal[d, 1]
                offset = nx * wall_ends[d, 0, 0] + ny * wall_ends[d, 0, 1]
            offset -= nx * ends[d, 0, 0] + ny * ends[d, 0, 1]
            reach = nx * ox + ny * oy - offset
            if reach < _FROM_M:
                continue
            saw = False
            for r in range(starts[s], starts[s + 1]):
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                side = nx * x + ny * y - offset
                if side > AT_FACE_M:
                    continue
                # A ray's direction is known far better than where on it it ended.
                t = reach / (reach - side)
                x, y, z = (
                    ox + t * (x - ox),
                    oy + t * (y - oy),
                    origin[s, 2] + t * (ray_end[r, 2] - origin[s, 2]),
                )
                u = x * dx + y * dy
                if u < -_JAMB_REACH_M or u > length + _JAMB_REACH_M:
                    continue
                height = z - floor_m(floors, s, ray_end[r, 0], ray_end[r, 1])
                kind = 0 if -side < min(0.5 * depth_m[d], ON_FACE_M) else 1
                end_m = min(max(-side, -depth_m[d]), depth_m[d])
                if _CORNER_M < u < length - _CORNER_M and heads_m[0] < height < heads_m[1]:
                    head_rays[d, kind] += 1
                    rise = (z - origin[s, 2]) / reach
                    _add_costs(head_cost_m[d], heads_m[0], height, rise, end_m, depth_m[d])
                if height < _FOOT_M or height > head_m[d] - _CORNER_M:
                    continue
                saw = True
                sideways = (u - (ox * dx + oy * dy)) / reach
                if u < _JAMB_REACH_M:
                    jamb_rays[d, 0, kind] += 1
                    _add_costs(jamb_cost_m[d, 0], -_JAMB_REACH_M, -u, -sideways, end_m, depth_m[d])
                if u > length - _JAMB_REACH_M:
                    jamb_rays[d, 1, kind] += 1
                    _add_costs(
                        jamb_cost_m[d, 1], -_JAMB_REACH_M, u - length, sideways, end_m, depth_m[d]
                    )
            if saw:
                scans[d, 0] += 1
                scans[d, 1] = scan[s] if scans[d, 1] < 0 else scans[d, 1]
                scans[d, 2] = scan[s]


def measure_reveals(doors: Doors, blocks: Iterable[Features]) -> Doors:
    """The doors with the depth of their reveals, by the returns of the underside of each lintel.

    Nothing else hangs in a doorway at the height of its head; the leaf's edge stands beside a jamb,
    which is left out.
    """
    # The underside shows over most of eight parts of the door's width; the edge of a leaf that is
    # ajar does not.
    counts = np.zeros((len(doors), int(_REVEAL_MAX_M / _BIN_M), 8), np.int64)
    length_m = lengths_m(doors.ends)
    for block in blocks:
        _count_undersides(doors.ends, doors.normal, length_m, doors.head_m, counts, Rays.of(block))
    reveal_m = doors.reveal_m.copy()
    for d in range(len(doors)):
        # As deep as returns follow each other without a gap, over most of the width: the upper edge
        # of a leaf that is ajar is narrow. They scatter about the end, which is where half as many
        # return as before.
        enough = np.count_nonzero(counts[d], axis=1) > 0.5 * counts.shape[2]
        runs = stretches(enough, 4)
        if runs and runs[0][0] * _BIN_M <= 0.1:
            returns = np.convolve(counts[d].sum(axis=1), np.ones(3), "same")[: runs[0][1] + 1]
            usual = np.median(returns[len(returns) // 2 :])
            reveal_m[d] = (np.flatnonzero(returns > 0.5 * usual)[-1] + 1) * _BIN_M
    return replace(doors, reveal_m=reveal_m)


@numba.njit(cache=True, nogil=True)
def _count_undersides(
    ends: FloatArray,
    normal: FloatArray,
    length_m: FloatArray,
    head_m: FloatArray,
    counts: IntArray,
    rays: Rays,
) -> None:  # pragma: no cover
    if not len(ends):
        return
    bins = counts.shape[1]
    lowest_m, highest_m = head_m.min() - _UNDERSIDE_M, head_m.max() + _UNDERSIDE_M
    starts, ray_end, floors = rays.starts, rays.end, rays.floors
    for s in range(len(starts) - 1):
        for r in range(starts[s], starts[s + 1]):
            height = ray_end[r, 2] - floor_m(floors, s, ray_end[r, 0], ray_end[r, 1])
            if height < lowest_m or height > highest_m:
                continue
            for d in range(len(ends)):
                if abs(height - head_m[d]) > _UNDERSIDE_M:
                    continue
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                behind = -(normal[d, 0] * x + normal[d, 1] * y)
                if behind < 0.0 or behind >= bins * _BIN_M:
                    continue
                u = (
                    (ends[d, 1, 0] - ends[d, 0, 0]) * x + (ends[d, 1, 1] - ends[d, 0, 1]) * y
                ) / length_m[d]
                inner = (u - _CORNER_M) / (length_m[d] - 2 * _CORNER_M)
                if 0.0 <= inner < 1.0:
                    counts[d, int(behind / _BIN_M), int(inner * counts.shape[2])] += 1
