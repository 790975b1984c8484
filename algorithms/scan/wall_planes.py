"""From wall candidates to wall planes by growing (paper, III.B, Algorithm 1, Fig. 7)."""

from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import VerticalStructures

_SPREADS = 1.5
"""Distance of a candidate's ends from its mean, in standard deviations; its moments do not hold them.

For evenly spread samples it is √3; less, so that a few odd samples do not lengthen the plane.
"""
_UPPER_PART_M = 0.4
"""Height (m) of the upper part of a candidate that is fitted: no leaf or furniture stands before
it. III.B."""
_OVERHANG_M = 0.2
"""Minimum depth (m) of a soffit, a vault or a roof over a candidate, which closes up to the
ceiling: leaves and blinds stand less deep in their openings, and what lies above furniture is
farther. III.B."""
_GAP_M_PER_M = 0.15
"""Added to the gap for each metre of range, for emitters spread apart. Alg. 1."""


class WallPlanesSettings(StepSettings):
    """Growing wall planes from candidates (paper, III.B, Algorithm 1)."""

    similarity_m: float = Field(
        0.05,
        gt=0,
        le=1,
        description="σ_th: maximum RMS distance (m) of a candidate from the plane that it joins. Alg. 1.",
    )
    reach_m: float = Field(
        0.35,
        gt=0,
        description="Maximum distance (m) below a ceiling at which a candidate ends: walls meet the ceiling. III.B.",
    )
    height_min_m: float = Field(
        2.1, gt=0, description="Minimum height (m) of a wall where no ceiling is in view. III.B."
    )
    bottom_max_m: float = Field(
        2.2,
        gt=0,
        description="Maximum height above the floor (m) of a wall's lower edge, above a door; what ends higher is a duct. "
        "III.B.",
    )
    gap_m: float = Field(0.3, gt=0, description="Maximum gap (m) between neighbouring lines of a plane. Alg. 1.")
    merge_gap_m: float = Field(
        1.5,
        ge=0,
        description="Maximum gap (m) between planes in line that are joined: a line that broke the plane is bridged. Alg. 1.",
    )
    lines_min: int = Field(3, ge=2, description="Minimum number of lines in a wall plane. Alg. 1.")
    length_min_m: float = Field(0.15, ge=0, description="Minimum length (m) of a wall plane; columns are walls. III.B.")


class Growth(IntEnum):
    """What became of a candidate in Algorithm 1."""

    SEEDED = 0  # it started a plane
    JOINED = 1  # it was similar to the current plane and joined it
    BROKE = 2  # it was not similar: the current plane was closed, and this candidate became the next seed
    REFUSED = 3  # it does not reach the ceiling and was left out


class Reach(IntEnum):
    """Whether a candidate is as high as a wall, and by what."""

    LOW = 0  # it ends too far below the ceiling, or too low where none is in view: it is refused
    CEILING = 1  # it ends close to a ceiling
    ABOVE_CEILINGS = 2  # it ends above the highest ceiling in view: another is there
    HEIGHT = 3  # no ceiling is in view, and it is high enough
    TURNS_BACK = 4  # its line has next to no returns of a ceiling: it may turn back, or the view end, below it
    OVERHUNG = 5  # what its line meets above it touches it and comes nearer, up to a ceiling: a soffit, a vault, a roof


class Membership(IntEnum):
    """Whether a candidate is in a wall plane in the end, and why it is not."""

    IN_PLANE = 0
    REFUSED = 1  # it does not reach the ceiling
    ALONE = 2  # no plane of enough lines is similar and near
    FEW_LINES = 3  # its plane has too few lines left once each candidate went to the nearest one
    SHORT = 4  # its plane is too short
    ROUGH = 5  # its plane's samples lie too far from it
    DUCT = 6  # its plane ends high above the floor in all of its lines


@dataclass(frozen=True)
class WallPlanes:
    """The wall planes of one scan, all upright: normal · (x, y) = offset_m, in the level frame.

    normal: (K, 2) unit vectors towards the sensor.
    offset_m: (K,)
    ends: (K, 2, 2) x and y of its two ends along the plane.
    bottom_m, top_m: (K,) heights that its candidates span.
    rms_m: (K,) of its candidates' samples about it.
    line_count, point_count: (K,) candidates and samples in it.
    moments: (K, 6) its samples' n, Σx, Σy, Σxx, Σxy, Σyy, from which planes of many scans can be fused.

    The growing, one row for each candidate, in the order in which Algorithm 1 met it:
    candidate_structure: (C,) the vertical structure, by its index in `VerticalStructures`.
    candidate_line: (C,) its point line.
    candidate_growth: (C,) uint8, see `Growth`.
    candidate_plane: (C,) index of the plane that holds it in the end, -1 where none does.
    candidate_distance_m: (C,) Θ, its distance to the plane that it was compared with; NaN where there was none.
    candidate_reach: (C,) uint8, see `Reach`.
    candidate_below_ceiling_m: (C,) how far it ends below the ceiling that is nearest to its end in height, negative
        above; NaN where no ceiling is in view.
    candidate_gap_m: (C,) horizontal distance to the candidate before it in the plane that it was compared with; NaN
        where there was none.
    candidate_gap_max_m: (C,) the largest such distance that would do.
    candidate_grown: (C,) number of the plane that Algorithm 1 grew it into, before planes in line were joined and small
        ones dropped; -1 where it was refused.
    candidate_nearest_m: (C,) Θ to the nearest plane within reach when each candidate went to the nearest; NaN where
        none was.
    candidate_membership: (C,) uint8, see `Membership`.
    """

    normal: FloatArray
    offset_m: FloatArray
    ends: FloatArray
    bottom_m: FloatArray
    top_m: FloatArray
    rms_m: FloatArray
    line_count: IntArray
    point_count: IntArray
    moments: FloatArray
    candidate_structure: IntArray
    candidate_line: IntArray
    candidate_growth: UInt8Array
    candidate_plane: IntArray
    candidate_distance_m: FloatArray
    candidate_reach: UInt8Array
    candidate_below_ceiling_m: FloatArray
    candidate_gap_m: FloatArray
    candidate_gap_max_m: FloatArray
    candidate_grown: IntArray
    candidate_nearest_m: FloatArray
    candidate_membership: UInt8Array

    def __len__(self) -> int:
        return len(self.normal)


def grow_wall_planes(
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    ceilings: tuple[HorizontalPlane, ...],
    floor: HorizontalPlane,
    meets_ceiling: BoolArray,
    settings: WallPlanesSettings,
) -> WallPlanes:
    """Algorithm 1, repaired.

    As printed it drops the candidate after each seed, the one that breaks a plane, and the last plane; here the
    breaking candidate seeds the next plane and the last plane is kept. Θ, which the paper leaves open, is the RMS
    distance of the candidate's samples to the plane; Ω is the upright plane of least squares. Planes that one odd line
    has cut are joined again, and each candidate then goes to the nearest plane of the scan.

    samples: (L, 200) the returns of each point line from below upwards, from `make_point_lines`.
    structures: the vertical structures of those lines.
    ceilings, floor: of this scan in the level frame; no ceilings where none is in view.
    meets_ceiling: (L,) whether each line has more than a few stray returns of a ceiling.
    """
    candidates = _choose_candidates(returns, samples, structures, ceilings, floor, meets_ceiling, settings)
    moments, reaches = candidates.moments, candidates.reach != Reach.LOW
    grown, growth, distance_m, gap_m = _grow(
        moments, candidates.part, reaches, candidates.gap_max_m, settings.similarity_m
    )
    settled, nearest_m, membership = _settle(grown, moments, reaches, candidates.gap_max_m, settings)
    bottom_m = _per_plane(np.minimum, structures.bottom_m[candidates.structure], settled, np.inf)
    for k in np.flatnonzero(bottom_m >= settings.bottom_max_m):
        bottom_m[k] = _bottom_behind(int(k), settled, returns, samples, structures, candidates, settings)
    plane = _renumbered(settled, bottom_m < settings.bottom_max_m)
    membership[(settled >= 0) & (plane < 0)] = Membership.DUCT
    return WallPlanes(
        *_fit_planes(returns, samples, structures, candidates, plane),
        candidate_structure=candidates.structure.astype(np.int32),
        candidate_line=candidates.upper[:, 0].astype(np.int32),
        candidate_growth=growth,
        candidate_plane=plane,
        candidate_distance_m=distance_m,
        candidate_reach=candidates.reach,
        candidate_below_ceiling_m=candidates.below_ceiling_m,
        candidate_gap_m=gap_m,
        candidate_gap_max_m=candidates.gap_max_m,
        candidate_grown=grown,
        candidate_nearest_m=nearest_m,
        candidate_membership=membership,
    )


@dataclass(frozen=True)
class _Candidates:
    """The candidates (C,) in the order of Algorithm 1.

    structure: the vertical structure of each. part: the part of the walk that it is in.
    upper: (C, 3) its point line, and its upper part's lowest and highest sample. moments: (C, 6) n, Σx, Σy, Σxx, Σxy, Σyy of
        that part.
    reach, below_ceiling_m, gap_max_m: as of `WallPlanes`.
    """

    structure: IntArray
    part: IntArray
    upper: IntArray
    moments: FloatArray
    reach: UInt8Array
    below_ceiling_m: FloatArray
    gap_max_m: FloatArray


def _choose_candidates(
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    ceilings: tuple[HorizontalPlane, ...],
    floor: HorizontalPlane,
    meets_ceiling: BoolArray,
    settings: WallPlanesSettings,
) -> _Candidates:
    """Up-most structures, and others that end at a ceiling; parameters as of `grow_wall_planes`."""
    is_upmost = structures.upmost[structures.line] == np.arange(len(structures.line))
    tops_level = returns.points_level[samples[structures.line, structures.last]]
    reach, below_ceiling_m = _reach_of(tops_level, structures.top_m, ceilings, floor, settings)
    low = np.flatnonzero(is_upmost & (structures.top_m > 0.5 * settings.height_min_m) & (reach == Reach.LOW))
    lines, tops, origin = structures.line[low], structures.last[low], returns.origin_level[:2]
    ends_level = returns.points_level[samples[lines, -1]]
    end_reach, _ = _reach_of(ends_level, floor.heights_above(ends_level), ceilings, floor, settings)
    overhung = _overhung(returns.points_level, samples, lines, tops, origin)
    overhung &= end_reach != Reach.LOW
    reach[low[overhung]] = Reach.OVERHUNG
    # Through an opening a line shows the wall of the next room below the lintel: what ends at a ceiling is a candidate
    # too, though it is not the up-most.
    chosen = np.flatnonzero(is_upmost | ((reach != Reach.LOW) & (len(ceilings) > 0)))
    # Algorithm 1 walks along the wall: emitter by emitter on one side, then on the other; up-most structures first.
    line = structures.line[chosen]
    walk = np.lexsort((line, line % 2, ~is_upmost[chosen]))
    chosen, line = chosen[walk], line[walk]
    # A line that sweeps a wall ahead in a circle may turn back below the ceiling, and a column ends where the lidar opens no
    # further: it has next to no returns of the ceiling.
    turns_back = ~meets_ceiling[line] & is_upmost[chosen] & (structures.top_m[chosen] > 0.5 * settings.height_min_m)
    spans = np.stack([line, structures.first[chosen], structures.last[chosen]], axis=1)
    moments, upper = _upper_parts(returns.points_level, returns.height_m, samples, spans)
    x0, y0 = returns.origin_level[:2]
    range_m = np.hypot(moments[:, 1] / moments[:, 0] - x0, moments[:, 2] / moments[:, 0] - y0)
    return _Candidates(
        structure=chosen,
        part=line % 2 + 2 * ~is_upmost[chosen],
        upper=upper,
        moments=moments,
        reach=np.where((reach[chosen] == Reach.LOW) & turns_back, np.uint8(Reach.TURNS_BACK), reach[chosen]),
        below_ceiling_m=below_ceiling_m[chosen],
        gap_max_m=settings.gap_m + _GAP_M_PER_M * range_m,
    )


def _reach_of(
    top_level: FloatArray,
    top_m: FloatArray,
    ceilings: tuple[HorizontalPlane, ...],
    floor: HorizontalPlane,
    settings: WallPlanesSettings,
) -> tuple[UInt8Array, FloatArray]:
    """`Reach` of each structure but for lines that turn back, and how far it ends below the nearest ceiling."""
    if not ceilings:
        reach = np.where(top_m >= settings.height_min_m, Reach.HEIGHT, Reach.LOW)
        return reach.astype(np.uint8), np.full(len(top_m), np.nan)
    below_m = np.array([ceiling.height_at(top_level) - top_level[:, 2] for ceiling in ceilings])
    nearest_m = below_m[np.abs(below_m).argmin(axis=0), np.arange(len(top_m))]
    # Above the highest ceiling in view may be another that is not.
    highest_m = np.max([c.height_at(top_level) - floor.height_at(top_level) for c in ceilings], axis=0)
    reach = np.select(
        [np.abs(nearest_m) < settings.reach_m, top_m > highest_m], [Reach.CEILING, Reach.ABOVE_CEILINGS], Reach.LOW
    )
    return reach.astype(np.uint8), nearest_m


@numba.njit(cache=True, nogil=True)
def _overhung(
    points: FloatArray, samples: IntArray, line: IntArray, last: IntArray, origin: FloatArray
) -> BoolArray:  # pragma: no cover
    """(s,) whether what each structure's line meets above it touches it, is no farther and no lower, and comes nearer.

    No ray passes above such a structure: over furniture, and below what hangs before a wall, there are such. line, last: (s,) of
    some structures, the line and the highest sample. Of ten samples above one may be stray, by a
    quarter of `_OVERHANG_M`.
    """
    overhung = np.zeros(len(line), np.bool_)
    for s in range(len(line)):
        own = samples[line[s]]
        top = own[last[s]]
        rho, z = np.hypot(points[top, 0] - origin[0], points[top, 1] - origin[1]), points[top, 2]
        above = len(own) - 1 - last[s]
        if above < 3:
            continue
        stray, nearest = 0, rho
        for j in range(last[s] + 1, len(own)):
            rho_j, z_j = np.hypot(points[own[j], 0] - origin[0], points[own[j], 1] - origin[1]), points[own[j], 2]
            if j == last[s] + 1 and np.hypot(rho_j - rho, z_j - z) > _OVERHANG_M:
                stray = above
            stray += rho_j > rho + 0.25 * _OVERHANG_M or z_j < z - 0.25 * _OVERHANG_M
            nearest = min(nearest, rho_j)
        overhung[s] = nearest < rho - _OVERHANG_M and 10 * stray <= above
    return overhung


def _renumbered(plane: IntArray, kept: BoolArray) -> IntArray:
    """The plane (C,) of each candidate by its number among those planes (P,) that are kept, -1 for others."""
    return np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)[plane].astype(np.int32)


def _per_plane(reduce: np.ufunc, values: FloatArray, plane: IntArray, start: float) -> FloatArray:
    reduced = np.full(int(plane.max(initial=-1)) + 1, start)
    reduce.at(reduced, plane[plane >= 0], values[plane >= 0])
    return reduced


def _bottom_behind(
    plane: int,
    settled: IntArray,
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    candidates: _Candidates,
    settings: WallPlanesSettings,
) -> float:
    """Height (m) of a plane's lowest end: a wall goes on below what hangs before it, a valance or a duct.

    settled: (C,) the plane of each candidate; this one ends high in all of its lines.
    """
    own = settled == plane
    behind = _behind(
        returns.points_level,
        samples,
        np.stack([structures.line, structures.first, structures.last], axis=1),
        candidates.structure[own],
        fit_upright_plane(candidates.moments[own].sum(axis=0))[:3],
        returns.origin_level[:2],
        settings.similarity_m,
    )
    lowest_m = structures.bottom_m[candidates.structure[own] if len(behind) < settings.lines_min else behind]
    return float(lowest_m.min())


@numba.njit(cache=True, nogil=True)
def _behind(
    points: FloatArray,
    samples: IntArray,
    spans: IntArray,
    upper: IntArray,
    plane: tuple[float, float, float],
    origin: FloatArray,
    similarity_m: float,
) -> IntArray:  # pragma: no cover
    """The structures in a plane that something nearer parts from those above them in their lines, one for each such line.

    spans: (S, 3) line, first and last sample of each structure, line by line from below upwards. upper: (u,) the structures above.
    plane: its normal and offset.
    """
    nx, ny, offset = plane
    found = np.empty(len(upper), np.int64)
    count = 0
    for u in upper:
        s = u - 1
        while s >= 0 and spans[s, 0] == spans[u, 0]:
            own = samples[spans[s, 0]]
            off = 0.0
            for j in range(spans[s, 2] - 9, spans[s, 2] + 1):
                off = max(off, abs(nx * points[own[j], 0] + ny * points[own[j], 1] - offset))
            top = own[spans[s, 2]]
            rho, nearest = np.hypot(points[top, 0] - origin[0], points[top, 1] - origin[1]), np.inf
            for j in range(spans[s, 2] + 1, spans[u, 1]):
                nearest = min(nearest, np.hypot(points[own[j], 0] - origin[0], points[own[j], 1] - origin[1]))
            if off < 2.0 * similarity_m and nearest < rho - _OVERHANG_M:
                found[count] = s
                count += 1
                break
            s -= 1
    return found[:count]


def _fit_planes(
    returns: Returns, samples: IntArray, structures: VerticalStructures, candidates: _Candidates, plane: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray, IntArray, FloatArray]:
    """The first nine fields of `WallPlanes`, from the plane (C,) of each candidate."""
    count = int(plane.max(initial=-1)) + 1
    total, lines = _totals(plane, candidates.moments, count)
    normal, offset_m, rms_m = _fit_all(total, np.ascontiguousarray(returns.origin_level[:2]))
    low, high = _extents(returns.points_level, samples, candidates.upper, plane, normal)
    along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    foot = normal * offset_m[:, None]
    return (
        normal,
        offset_m,
        np.stack([foot + along * low[:, None], foot + along * high[:, None]], axis=1),
        _per_plane(np.minimum, structures.bottom_m[candidates.structure], plane, np.inf),
        _per_plane(np.maximum, structures.top_m[candidates.structure], plane, -np.inf),
        rms_m,
        lines.astype(np.int32),
        total[:, 0].astype(np.int32),
        total,
    )


@numba.njit(cache=True, nogil=True)
def _extents(
    points: FloatArray, samples: IntArray, upper: IntArray, plane: IntArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray]:  # pragma: no cover
    low = np.full(len(normal), np.inf)
    high = np.full(len(normal), -np.inf)
    for c in range(len(plane)):
        k = plane[c]
        if k < 0:
            continue
        for s in range(upper[c, 1], upper[c, 2] + 1):
            i = samples[upper[c, 0], s]
            u = -normal[k, 1] * points[i, 0] + normal[k, 0] * points[i, 1]
            low[k] = min(low[k], u)
            high[k] = max(high[k], u)
    return low, high


@numba.njit(cache=True, nogil=True)
def _upper_parts(
    points: FloatArray, height: FloatArray, samples: IntArray, spans: IntArray
) -> tuple[FloatArray, IntArray]:  # pragma: no cover
    """n, Σx, Σy, Σxx, Σxy, Σyy of each candidate's upper part, and that part's line, lowest and highest sample.

    spans: (C, 3) line, first and last sample of each candidate.
    """
    moments = np.zeros((len(spans), 6))
    upper = spans.copy()
    for c in range(len(spans)):
        line, first, last = spans[c, 0], spans[c, 1], spans[c, 2]
        top = height[samples[line, last]]
        s = last
        while s >= first and (last - s < 10 or height[samples[line, s]] > top - _UPPER_PART_M):
            i = samples[line, s]
            x, y = np.float64(points[i, 0]), np.float64(points[i, 1])
            moments[c, 0] += 1.0
            moments[c, 1] += x
            moments[c, 2] += y
            moments[c, 3] += x * x
            moments[c, 4] += x * y
            moments[c, 5] += y * y
            s -= 1
        upper[c, 1] = s + 1
    return moments, upper


@numba.njit(cache=True, nogil=True)
def fit_upright_plane(m: FloatArray) -> tuple[float, float, float, float, float]:  # pragma: no cover
    """Ω: the upright plane of least squares from moments n, Σx, Σy, Σxx, Σxy, Σyy.

    Returns its normal's x and y, its offset, the RMS distance of the points and their RMS spread along it, in metres.
    """
    mx, my = m[1] / m[0], m[2] / m[0]
    vxx = max(m[3] / m[0] - mx * mx, 0.0)
    vyy = max(m[5] / m[0] - my * my, 0.0)
    vxy = m[4] / m[0] - mx * my
    angle = 0.5 * np.arctan2(2.0 * vxy, vxx - vyy)
    nx, ny = -np.sin(angle), np.cos(angle)
    mean, half = 0.5 * (vxx + vyy), np.hypot(0.5 * (vxx - vyy), vxy)
    return nx, ny, nx * mx + ny * my, np.sqrt(max(mean - half, 0.0)), np.sqrt(mean + half)


@numba.njit(cache=True, nogil=True)
def _theta(m: FloatArray, nx: float, ny: float, offset: float) -> float:  # pragma: no cover
    """Θ: RMS distance of a candidate, given by its moments, to a plane."""
    mean_square = (nx * nx * m[3] + 2.0 * nx * ny * m[4] + ny * ny * m[5] - 2.0 * offset * (nx * m[1] + ny * m[2])) / m[
        0
    ] + offset * offset
    return float(np.sqrt(max(mean_square, 0.0)))


@numba.njit(cache=True, nogil=True)
def _grow(
    moments: FloatArray, side: IntArray, reaches: BoolArray, gap_max_m: FloatArray, similarity_m: float
) -> tuple[IntArray, UInt8Array, FloatArray, FloatArray]:  # pragma: no cover
    """Algorithm 1: each candidate's plane (-1 where it is refused), its `Growth`, Θ and the gap, both NaN for a seed.

    moments: (C, 6) in the order of the walk. side: (C,) the part of the walk; no plane goes on from one to the next.
    reaches: (C,) whether it is high enough. gap_max_m: (C,) metres.
    """
    count = len(moments)
    plane = np.full(count, -1, np.int32)
    growth = np.full(count, Growth.REFUSED, np.uint8)
    distance = np.full(count, np.nan)
    gap = np.full(count, np.nan)
    current = np.zeros(6)
    lines, number, last = 0, -1, -1
    for c in range(count):
        if not reaches[c]:
            continue
        joined = False
        if lines > 0 and side[last] == side[c]:
            dx = moments[c, 1] / moments[c, 0] - moments[last, 1] / moments[last, 0]
            dy = moments[c, 2] / moments[c, 0] - moments[last, 2] / moments[last, 0]
            if lines == 1:
                # One line has no direction yet: the plane is that of seed and candidate together.
                nx, ny, offset, rms, _ = fit_upright_plane(current + moments[c])
                distance[c] = rms
            else:
                nx, ny, offset, _, _ = fit_upright_plane(current)
                distance[c] = _theta(moments[c], nx, ny, offset)
            gap[c] = np.hypot(dx, dy)
            joined = distance[c] < similarity_m and gap[c] < gap_max_m[c]
        if joined:
            growth[c] = Growth.JOINED
            current += moments[c]
            lines += 1
        else:
            growth[c] = Growth.BROKE if lines > 0 and side[last] == side[c] else Growth.SEEDED
            current = moments[c].copy()
            lines = 1
            number += 1
        plane[c] = number
        last = c
    return plane, growth, distance, gap


@numba.njit(cache=True, nogil=True)
def _span(moments: FloatArray, members: BoolArray, nx: float, ny: float) -> tuple[float, float]:  # pragma: no cover
    """Least and largest place along the plane that its members' upper parts reach, metres: mean ± `_SPREADS` × spread."""
    low, high = np.inf, -np.inf
    for c in range(len(moments)):
        if members[c]:
            m = moments[c]
            u = (-ny * m[1] + nx * m[2]) / m[0]
            spread = np.sqrt(max((ny * ny * m[3] - 2 * nx * ny * m[4] + nx * nx * m[5]) / m[0] - u * u, 0.0))
            low = min(low, u - _SPREADS * spread)
            high = max(high, u + _SPREADS * spread)
    return low, high


@numba.njit(cache=True, nogil=True)
def _totals(plane: IntArray, moments: FloatArray, planes: int) -> tuple[FloatArray, IntArray]:  # pragma: no cover
    """The summed moments (P, 6) of the candidates of each plane, and how many they are (P,)."""
    total = np.zeros((planes, 6))
    lines = np.zeros(planes, np.int64)
    for c in range(len(plane)):
        if plane[c] >= 0:
            total[plane[c]] += moments[c]
            lines[plane[c]] += 1
    return total, lines


@numba.njit(cache=True, nogil=True)
def _join_in_line(
    plane: IntArray,
    moments: FloatArray,
    total: FloatArray,
    lines: IntArray,
    similarity_m: float,
    merge_gap_m: float,
    lines_min: int,
) -> None:  # pragma: no cover
    """Join planes in line, largest first: a line that stood before the wall has cut it in Algorithm 1.

    Changes plane (C,), and total (P, 6) and lines (P,) of `_totals`; a plane that has joined another has no lines left.
    """
    merged = True
    while merged:
        # A merge changes the sizes: go round again until nothing joins.
        merged = False
        by_size = np.argsort(-total[:, 0])
        for a in range(len(total)):
            i = by_size[a]
            if lines[i] < lines_min:
                continue
            for b in range(a + 1, len(total)):
                j = by_size[b]
                # A single line has no direction that could be the wall's.
                if lines[j] < 2 or not _are_in_line(plane, moments, total, (i, j), similarity_m, merge_gap_m):
                    continue
                plane[plane == j] = i
                total[i] += total[j]
                lines[i] += lines[j]
                total[j] = 0.0
                lines[j] = 0
                merged = True


@numba.njit(cache=True, nogil=True)
def _are_in_line(
    plane: IntArray, moments: FloatArray, total: FloatArray, pair: tuple[int, int], similarity_m: float, gap_m: float
) -> bool:  # pragma: no cover
    """Whether one plane fits two, with no more than `gap_m` metres between them; the larger comes first."""
    larger, smaller = pair
    nx, ny, offset, rms, _ = fit_upright_plane(total[larger] + total[smaller])
    # Stricter than where a candidate joins: two faces twice `similarity_m` apart would become one between them. The smaller
    # plane is known less well than the larger.
    if (
        rms > 0.6 * similarity_m
        or _theta(total[larger], nx, ny, offset) > 0.6 * similarity_m
        or _theta(total[smaller], nx, ny, offset) > 0.8 * similarity_m
    ):
        return False
    low_i, high_i = _span(moments, plane == larger, nx, ny)
    low_j, high_j = _span(moments, plane == smaller, nx, ny)
    return bool(max(low_i, low_j) - min(high_i, high_j) <= gap_m)


@numba.njit(cache=True, nogil=True)
def _fits(
    plane: IntArray, moments: FloatArray, total: FloatArray, lines: IntArray, lines_min: int
) -> FloatArray:  # pragma: no cover
    """(P, 6) normal, offset, RMS distance and both ends along it; one with too few lines begins at infinity."""
    fits = np.zeros((len(total), 6))
    fits[:, 4] = np.inf
    for i in range(len(total)):
        if lines[i] >= lines_min:
            nx, ny, offset, rms, _ = fit_upright_plane(total[i])
            low, high = _span(moments, plane == i, nx, ny)
            fits[i] = np.array([nx, ny, offset, rms, low, high])
    return fits


@numba.njit(cache=True, nogil=True)
def _assign_to_nearest(
    plane: IntArray, moments: FloatArray, reaches: BoolArray, gap_m: FloatArray, fits: FloatArray, similarity_m: float
) -> FloatArray:  # pragma: no cover
    """Give every candidate to the nearest plane that has enough lines, whichever plane it was grown into; changes `plane`.

    Returns Θ (C,) to the nearest of those that are beside it, metres; NaN where none is.
    """
    distance = np.full(len(plane), np.nan)
    for c in range(len(plane)):
        if not reaches[c]:
            continue
        best, nearest, closest = -1, similarity_m, np.inf
        for i in range(len(fits)):
            nx, ny = fits[i, 0], fits[i, 1]
            u = (-ny * moments[c, 1] + nx * moments[c, 2]) / moments[c, 0]
            if u < fits[i, 4] - gap_m[c] or u > fits[i, 5] + gap_m[c]:
                continue
            theta = _theta(moments[c], nx, ny, fits[i, 2])
            closest = min(closest, theta)
            if theta < nearest:
                best, nearest = i, theta
        plane[c] = best
        distance[c] = closest if closest < np.inf else np.nan
    return distance


def _settle(
    grown: IntArray, moments: FloatArray, reaches: BoolArray, gap_m: FloatArray, settings: WallPlanesSettings
) -> tuple[IntArray, FloatArray, UInt8Array]:
    """Join planes in line, give every candidate to the nearest plane, drop what is too small, number them anew.

    grown: (C,) the plane that Algorithm 1 grew each candidate into, -1 where it refused it. moments: (C, 6) of its upper
    part. reaches: (C,) whether it is high enough. gap_m: (C,) how far beyond a plane's ends it may be of it.
    Returns each candidate's plane, its distance to the nearest plane within reach and its `Membership`.
    """
    plane, similarity_m, lines_min = grown.copy(), settings.similarity_m, settings.lines_min
    planes = int(grown.max(initial=-1)) + 1
    total, lines = _totals(plane, moments, planes)
    _join_in_line(plane, moments, total, lines, similarity_m, settings.merge_gap_m, lines_min)
    # Twice, for the first time moves the planes.
    for _ in range(2):
        fits = _fits(plane, moments, total, lines, lines_min)
        distance = _assign_to_nearest(plane, moments, reaches, gap_m, fits, similarity_m)
        total, lines = _totals(plane, moments, planes)
    fits = _fits(plane, moments, total, lines, lines_min)
    fails = [lines < lines_min, fits[:, 5] - fits[:, 4] < settings.length_min_m, fits[:, 3] > similarity_m]
    reasons = [Membership.FEW_LINES, Membership.SHORT, Membership.ROUGH]
    verdict = np.append(np.select(fails, reasons, Membership.IN_PLANE), Membership.ALONE)
    membership = np.where((plane < 0) & ~reaches, Membership.REFUSED, verdict[plane]).astype(np.uint8)
    return _renumbered(plane, verdict[:-1] == Membership.IN_PLANE), distance, membership


@numba.njit(cache=True, nogil=True)
def _fit_all(total: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:  # pragma: no cover
    """Normals towards the sensor, offsets and RMS of planes from their moments."""
    normal = np.empty((len(total), 2))
    offset_m = np.empty(len(total))
    rms_m = np.empty(len(total))
    for k in range(len(total)):
        nx, ny, offset, rms, _ = fit_upright_plane(total[k])
        sign = 1.0 if nx * origin[0] + ny * origin[1] - offset > 0 else -1.0
        normal[k, 0], normal[k, 1], offset_m[k], rms_m[k] = sign * nx, sign * ny, sign * offset, rms
    return normal, offset_m, rms_m
