"""Where doors' jambs, heads and reveals are, to a centimetre."""

from collections.abc import Iterable
from dataclasses import replace

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import lengths_m, segments
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    FRAME_REACH_M,
    ON_FACE_M,
    BuildingSettings,
    Doors,
    Walls,
    stretches,
)
from ffmap.algorithms.building.ray_evidence import own_plane
from ffmap.algorithms.scan.floor import floor_height
from ffmap.algorithms.scan.summary import Features

_FRAME_BIN_M = 0.01
_FRAME_BINS = 1 + round(2 * FRAME_REACH_M / _FRAME_BIN_M)
"""Places that a jamb may have, from FRAME_REACH_M within its door to as far beyond it."""
_HEAD_BINS = 100
_HEAD_MIN_M = 1.7
_HEAD_MAX_M = _HEAD_MIN_M + _HEAD_BINS * _FRAME_BIN_M
"""Above the floor; no head is looked for elsewhere."""
_REACH_MIN_M, _REACH_MAX_M = 0.3, 6.0
"""Scans from so far before the face tell of a frame: nearer ones meet it aslant, and farther ones with few rays."""
_CORNER_M = 0.15
"""So near to a jamb rays tell nothing of the head, and so near to the head nothing of a jamb."""
_FOOT_M = 0.2
"""Below it sills, stops and thresholds stand in the doorway."""
_AT_HEAD_M = 0.08
"""Rays that end so near to a door's head may have met its lintel's underside."""
_BEYOND_M = 0.1
"""Of an open door's rays it does not matter how much farther behind the face they ended."""
_FRAME_RAYS = 30
"""Fewest rays on the face, and behind it, that move a jamb or a head."""
_REVEAL_BIN_M = 0.01
_REVEAL_MAX_M = 0.7
_UNDERSIDE_PARTS = 8
"""A lintel's underside shows over most of so many parts of the door's width; the edge of a leaf that is ajar does not."""


def place_frames(doors: Doors, walls: Walls, blocks: Iterable[Features], settings: BuildingSettings) -> Doors:
    """The doors with jambs and head where the rays tell them to a centimetre, and with the scans that saw these.

    Beyond a jamb or the head rays end on the wall's face, within they pass it or end on the leaf behind, or on the reveal or
    the lintel's underside. Each edge goes where rays contradict it least; one without rays on both sides stays.

    walls: those that `doors.wall` counts.
    """
    jamb_cost_m, jamb_rays = np.zeros((len(doors), 2, _FRAME_BINS)), np.zeros((len(doors), 2, 2), np.int64)
    head_cost_m, head_rays = np.zeros((len(doors), _HEAD_BINS)), np.zeros((len(doors), 2), np.int64)
    scans = np.zeros((len(doors), 3), np.int64)
    scans[:, 1:] = -1
    depth_m = np.where(np.isfinite(doors.depth_m), np.minimum(doors.depth_m, _BEYOND_M), _BEYOND_M)
    for block in blocks:
        _compare_with_frames(
            np.ascontiguousarray(doors.ends, np.float64),
            np.ascontiguousarray(doors.head_m, np.float64),
            depth_m,
            np.ascontiguousarray(walls.ends[doors.wall], np.float64),
            np.ascontiguousarray(walls.normal[doors.wall], np.float64),
            jamb_cost_m,
            jamb_rays,
            head_cost_m,
            head_rays,
            scans,
            np.ascontiguousarray(block.scan, np.int64),
            np.ascontiguousarray(block.origin_map, np.float64),
            np.ascontiguousarray(block.floor_map, np.float64),
            block.floor_is_foot,
            block.ray_starts,
            block.ray_end_map,
            block.plane_starts,
            np.ascontiguousarray(block.plane_ends_map, np.float64),
            np.ascontiguousarray(block.plane_normal, np.float64),
            settings.own_plane_m,
            float(np.cos(np.radians(settings.angle_deg))),
        )
    ends, head_m = doors.ends.copy(), doors.head_m.copy()
    for d, doorway in enumerate(segments(doors)):
        for side, outwards in ((0, -1.0), (1, 1.0)):
            edge_m = _edge_m(jamb_cost_m[d, side], jamb_rays[d, side])
            if edge_m is not None:
                ends[d, side] += outwards * doorway.along * (edge_m - FRAME_REACH_M)
        edge_m = _edge_m(head_cost_m[d], head_rays[d])
        head_m[d] = doors.head_m[d] if edge_m is None else _HEAD_MIN_M + edge_m
    count, first, last = scans.T
    return replace(doors, ends=ends, head_m=head_m, scan_count=count.astype(np.int32), first_scan=first, last_scan=last)


def _edge_m(cost_m: FloatArray, rays: IntArray) -> float | None:
    """How far from the first bin an opening's edge lies, where rays contradict it least; None where too few tell.

    cost_m: (bins,) by how much rays end off where they would with the edge there, from within the opening outwards, 1 cm each.
    rays: (2,) how many of them ended on the face, and behind it.
    """
    if rays.min() < _FRAME_RAYS:
        return None
    return float(np.argmin(cost_m)) * _FRAME_BIN_M


@numba.njit(cache=True, nogil=True)
def _add_costs(
    cost_m: FloatArray, first_m: float, place_m: float, outwards: float, end_m: float, depth_m: float
) -> None:  # pragma: no cover
    """Add, for an edge in each bin, by how much a ray ended off where it then should have.

    Beyond the edge a ray ends on the face; within, on the leaf or wherever, or before on the reveal or the lintel's
    underside, if it comes near enough.

    first_m: the first bin's place. place_m: where the ray meets the face; outwards: by how many metres it nears the edge for
    each behind that. end_m: how far behind the face it ended; depth_m: where it would within the opening.
    """
    for k in range(len(cost_m)):
        inside_m = first_m + k * _FRAME_BIN_M - place_m
        off_m = abs(end_m)
        if inside_m > 0.0:
            off_m = depth_m - end_m
            if outwards > 0.0:
                off_m = min(off_m, abs(end_m - inside_m / outwards))
        cost_m[k] += min(off_m, depth_m)


@numba.njit(cache=True, nogil=True)
def _compare_with_frames(
    ends: FloatArray,
    head_m: FloatArray,
    depth_m: FloatArray,
    wall_ends: FloatArray,
    wall_normal: FloatArray,
    jamb_cost_m: FloatArray,
    jamb_rays: IntArray,
    head_cost_m: FloatArray,
    head_rays: IntArray,
    scans: IntArray,
    scan: IntArray,
    origin: FloatArray,
    floor: FloatArray,
    is_foot: BoolArray,
    starts: IntArray,
    ray_end: FloatArray,
    plane_starts: IntArray,
    plane_ends: FloatArray,
    plane_normal: FloatArray,
    own_plane_m: float,
    cos_angle: float,
) -> None:  # pragma: no cover
    for d in range(len(ends)):
        dx, dy = ends[d, 1, 0] - ends[d, 0, 0], ends[d, 1, 1] - ends[d, 0, 1]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
        for s in range(len(origin)):
            ox, oy = origin[s, 0] - ends[d, 0, 0], origin[s, 1] - ends[d, 0, 1]
            reach = wall_normal[d, 0] * ox + wall_normal[d, 1] * oy
            # Seen at a slant, a leaf's recess shifts where rays pass the face.
            if (
                reach < _REACH_MIN_M
                or reach > _REACH_MAX_M
                or abs(ox * dx + oy * dy - 0.5 * length) > 2.0 * reach + 0.5 * length
            ):
                continue
            nx, ny, offset, start, stop = own_plane(
                wall_ends[d],
                wall_normal[d],
                plane_ends,
                plane_normal,
                plane_starts[s],
                plane_starts[s + 1],
                own_plane_m,
                cos_angle,
            )
            middle = (
                (ends[d, 0, 0] - wall_ends[d, 0, 0]) * dx + (ends[d, 0, 1] - wall_ends[d, 0, 1]) * dy + 0.5 * length
            )
            if not start < middle < stop:
                nx, ny = wall_normal[d, 0], wall_normal[d, 1]
                offset = nx * wall_ends[d, 0, 0] + ny * wall_ends[d, 0, 1]
            offset -= nx * ends[d, 0, 0] + ny * ends[d, 0, 1]
            reach = nx * ox + ny * oy - offset
            if reach < _REACH_MIN_M:
                continue
            saw = False
            for r in range(starts[s], starts[s + 1]):
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                side = nx * x + ny * y - offset
                if side > AT_FACE_M:
                    continue
                # A ray's direction is known far better than where on it it ended.
                t = reach / (reach - side)
                x, y, z = ox + t * (x - ox), oy + t * (y - oy), origin[s, 2] + t * (ray_end[r, 2] - origin[s, 2])
                u = x * dx + y * dy
                if u < -FRAME_REACH_M or u > length + FRAME_REACH_M:
                    continue
                height = z - floor_height(floor[s], is_foot[s], ray_end[r, 0], ray_end[r, 1])
                kind = 0 if -side < min(0.5 * depth_m[d], ON_FACE_M) else 1
                end_m = min(max(-side, -depth_m[d]), depth_m[d])
                if _CORNER_M < u < length - _CORNER_M and _HEAD_MIN_M < height < _HEAD_MAX_M:
                    head_rays[d, kind] += 1
                    _add_costs(head_cost_m[d], _HEAD_MIN_M, height, (z - origin[s, 2]) / reach, end_m, depth_m[d])
                if height < _FOOT_M or height > head_m[d] - _CORNER_M:
                    continue
                saw = True
                sideways = (u - (ox * dx + oy * dy)) / reach
                if u < FRAME_REACH_M:
                    jamb_rays[d, 0, kind] += 1
                    _add_costs(jamb_cost_m[d, 0], -FRAME_REACH_M, -u, -sideways, end_m, depth_m[d])
                if u > length - FRAME_REACH_M:
                    jamb_rays[d, 1, kind] += 1
                    _add_costs(jamb_cost_m[d, 1], -FRAME_REACH_M, u - length, sideways, end_m, depth_m[d])
            if saw:
                scans[d, 0] += 1
                scans[d, 1] = scan[s] if scans[d, 1] < 0 else scans[d, 1]
                scans[d, 2] = scan[s]


def measure_reveals(doors: Doors, blocks: Iterable[Features]) -> Doors:
    """The doors with the depth of their reveals, by the returns of the underside of each lintel.

    Nothing else hangs in a doorway at the height of its head; the leaf's edge stands beside a jamb, which is left out.
    """
    bins = int(_REVEAL_MAX_M / _REVEAL_BIN_M)
    counts = np.zeros((len(doors), bins, _UNDERSIDE_PARTS), np.int64)
    length_m = lengths_m(doors.ends)
    for block in blocks:
        _count_undersides(
            doors.ends,
            doors.normal,
            length_m,
            doors.head_m,
            counts,
            np.ascontiguousarray(block.floor_map, np.float64),
            block.floor_is_foot,
            block.ray_starts,
            block.ray_end_map,
        )
    reveal_m = doors.reveal_m.copy()
    for d in range(len(doors)):
        # Behind the face by as far as returns follow each other without a gap, over most of the width: a leaf's upper edge
        # that is ajar is narrow. They scatter about the end, which is where half as many return as before.
        enough = np.count_nonzero(counts[d], axis=1) > 0.5 * _UNDERSIDE_PARTS
        runs = stretches(enough, 4)
        if runs and runs[0][0] * _REVEAL_BIN_M <= 0.1:
            returns = np.convolve(counts[d].sum(axis=1), np.ones(3), "same")[: runs[0][1] + 1]
            usual = np.median(returns[len(returns) // 2 :])
            reveal_m[d] = (np.flatnonzero(returns > 0.5 * usual)[-1] + 1) * _REVEAL_BIN_M
    return replace(doors, reveal_m=reveal_m)


@numba.njit(cache=True, nogil=True)
def _count_undersides(
    ends: FloatArray,
    normal: FloatArray,
    length_m: FloatArray,
    head_m: FloatArray,
    counts: IntArray,
    floor: FloatArray,
    is_foot: BoolArray,
    starts: IntArray,
    ray_end: FloatArray,
) -> None:  # pragma: no cover
    bins = counts.shape[1]
    for s in range(len(floor)):
        for r in range(starts[s], starts[s + 1]):
            height = ray_end[r, 2] - floor_height(floor[s], is_foot[s], ray_end[r, 0], ray_end[r, 1])
            if height < _HEAD_MIN_M or height > _HEAD_MAX_M:
                continue
            for d in range(len(ends)):
                if abs(height - head_m[d]) > _AT_HEAD_M:
                    continue
                x, y = ray_end[r, 0] - ends[d, 0, 0], ray_end[r, 1] - ends[d, 0, 1]
                behind = -(normal[d, 0] * x + normal[d, 1] * y)
                if behind < 0.0 or behind >= bins * _REVEAL_BIN_M:
                    continue
                u = ((ends[d, 1, 0] - ends[d, 0, 0]) * x + (ends[d, 1, 1] - ends[d, 0, 1]) * y) / length_m[d]
                inner = (u - _CORNER_M) / (length_m[d] - 2 * _CORNER_M)
                if 0.0 <= inner < 1.0:
                    counts[d, int(behind / _REVEAL_BIN_M), int(inner * counts.shape[2])] += 1
