"""From wall candidates to wall planes by growing (paper, III.B, Algorithm 1, Fig. 7)."""

from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray, UInt8Array
from ffmap.algorithms.scan.rearrangement import HorizontalPlane, Returns
from ffmap.algorithms.scan.vertical_structures import VerticalStructures
from ffmap.algorithms.scan.wall_candidates import (
    OVERHANG_M,
    Reach,
    WallCandidates,
    WallPlanesSettings,
    choose_candidates,
)

LENGTH_MIN_M = 0.15  # minimum length (m) of a wall plane: the faces of columns are walls
BOTTOM_MAX_M = 2.2  # maximum height (m) of a wall's lower edge, above a door: a duct ends higher
_MERGE_GAP_M = 1.5  # maximum gap (m) between planes in line that are joined
_SPREADS = 1.5
"""Distance of a candidate's ends from its mean, in standard deviations: √3 for evenly spread
samples; less, so that a few odd samples do not lengthen a plane."""


class Growth(IntEnum):
    """What became of a candidate in Algorithm 1."""

    SEEDED = 0  # it began a plane
    JOINED = 1  # it was similar to the current plane and joined it
    BROKE = 2  # it was not similar: it closed the current plane and began the next
    REFUSED = 3  # it does not reach the ceiling and was left out


@dataclass(frozen=True)
class WallPlanes:
    """The wall planes (K,) of a scan, all upright: normal · (x, y) = offset_m in the level frame.

    normal: (K, 2) unit vectors towards the sensor.
    ends: (K, 2, 2) x and y of both ends.
    bottom_m, top_m: heights above the floor that its candidates span.
    rms_m: of its candidates' samples about it.
    line_count, point_count: number of candidates and samples.
    moments: (K, 6) n, Σx, Σy, Σxx, Σxy, Σyy of its samples, from which planes are fused.

    The growing of the candidates (C,), in the order of Algorithm 1:
    candidate_growth: uint8, see `Growth`.
    candidate_distance_m: Θ, its distance from the plane that it was compared with.
    candidate_gap_m: horizontal distance from the last candidate of that plane; both are NaN where
        there was none.
    candidate_grown: number of the plane that Algorithm 1 grew it into, -1 where it was refused.
    candidate_nearest_m: Θ to the nearest plane within reach, once planes in line were joined; NaN
        where there was none.
    candidate_settled: (C, 4) of the plane that it moved to: number of lines, length, RMS, and
        height of its lowest lower edge; NaN where none is near enough. They decide whether
        that plane is a wall.
    candidate_plane: its plane in the end, -1 where it is in none.
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
    candidates: WallCandidates
    candidate_growth: UInt8Array
    candidate_plane: IntArray
    candidate_distance_m: FloatArray
    candidate_gap_m: FloatArray
    candidate_grown: IntArray
    candidate_nearest_m: FloatArray
    candidate_settled: FloatArray

    def __len__(self) -> int:
        return len(self.normal)


def grow_wall_planes(
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    ceilings: tuple[HorizontalPlane, ...],
    meets_ceiling: BoolArray,
    settings: WallPlanesSettings,
) -> WallPlanes:
    """Algorithm 1, repaired; parameters as of `choose_candidates`.

    As printed, it drops the candidate after each seed, the candidate that breaks a plane, and the
    last plane. Here the breaking candidate seeds the next plane, and the last plane is kept. Ω is
    the upright plane of least squares. Θ, which the paper leaves open, is the RMS distance of a
    candidate's samples from the plane. Planes that one odd line has cut are joined, and each
    candidate then moves to the nearest plane.
    """
    candidates = choose_candidates(returns, samples, structures, ceilings, meets_ceiling, settings)
    grown, growth, distance_m, gap_m = _grow(candidates, settings.similarity_m)
    plane, nearest_m = _settle(grown, candidates, settings)

    # Which of the planes are walls.
    count, lines_min = grown.max(initial=0) + 1, settings.lines_min
    total, lines, fits = _fit_planes(plane, candidates.moments, count, lines_min)
    normal, offset_m, rms_m, length_m = fits[:, :2], fits[:, 2], fits[:, 3], fits[:, 5] - fits[:, 4]
    bottom_m = _per_plane(np.minimum, structures.bottom_m[candidates.structure], plane, count)
    top_m = _per_plane(np.maximum, structures.top_m[candidates.structure], plane, count)
    is_wall = (lines >= lines_min) & (length_m >= LENGTH_MIN_M) & (rms_m <= settings.similarity_m)
    lowest_m = bottom_m.copy()
    for k in np.flatnonzero(is_wall & (bottom_m >= BOTTOM_MAX_M)):
        own = candidates.structure[plane == k]
        behind = _structures_behind(returns, samples, structures, own, fits[k], settings)
        lowest = behind if len(behind) >= lines_min else own
        lowest_m[k] = structures.bottom_m[lowest].min()
    is_wall &= lowest_m < BOTTOM_MAX_M
    settled = np.column_stack([lines, length_m, rms_m, lowest_m])
    settled[lines < lines_min, 1:] = np.nan
    settled = np.vstack([settled, np.full(4, np.nan)])[plane]

    # The walls, numbered without the others; none, -1, is the last row of the appended arrays.
    plane = np.append(np.where(is_wall, np.cumsum(is_wall) - 1, -1), -1)[plane].astype(np.int32)
    before_m = normal @ returns.origin_level[:2] - offset_m
    towards_sensor = np.where(before_m > 0, 1.0, -1.0)[is_wall]
    normal, offset_m = normal[is_wall] * towards_sensor[:, None], offset_m[is_wall] * towards_sensor
    return WallPlanes(
        normal=normal,
        offset_m=offset_m,
        ends=_ends(returns, samples, candidates, plane, normal, offset_m),
        bottom_m=bottom_m[is_wall],
        top_m=top_m[is_wall],
        rms_m=rms_m[is_wall],
        line_count=lines[is_wall].astype(np.int32),
        point_count=total[is_wall, 0].astype(np.int32),
        moments=total[is_wall],
        candidates=candidates,
        candidate_growth=growth,
        candidate_plane=plane,
        candidate_distance_m=distance_m,
        candidate_gap_m=gap_m,
        candidate_grown=grown,
        candidate_nearest_m=nearest_m,
        candidate_settled=settled,
    )


@numba.njit(cache=True, nogil=True)
def fit_upright_plane(m: FloatArray) -> tuple[float, float, float, float, float]:
    """Ω: the upright plane of least squares from moments n, Σx, Σy, Σxx, Σxy, Σyy.

    Returns its normal's x and y, its offset, the RMS distance of the points from it and their RMS
    spread along it, in metres.
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
def _theta(m: FloatArray, nx: float, ny: float, offset: float) -> float:
    """Θ: RMS distance of the samples of a candidate, given by their moments, from a plane."""
    square = nx * nx * m[3] + 2.0 * nx * ny * m[4] + ny * ny * m[5]
    square -= 2.0 * offset * (nx * m[1] + ny * m[2])
    return float(np.sqrt(max(square / m[0] + offset * offset, 0.0)))


@numba.njit(cache=True, nogil=True)
def _grow(
    candidates: WallCandidates, similarity_m: float
) -> tuple[IntArray, UInt8Array, FloatArray, FloatArray]:
    """Algorithm 1: the plane (C,) of each candidate, its `Growth`, its Θ and its gap."""
    moments, middle, part = candidates.moments, candidates.middle, candidates.part
    plane = np.full(len(moments), -1, np.int32)
    growth = np.full(len(moments), Growth.REFUSED, np.uint8)
    distance, gap = np.full(len(moments), np.nan), np.full(len(moments), np.nan)
    P = np.zeros(6)  # the current plane's moments
    lines, number, last = 0, -1, -1
    for i in range(len(moments)):
        if candidates.reach[i] == Reach.LOW:
            continue
        compared = lines > 0 and part[last] == part[i]
        joins = False
        if compared:
            if lines == 1:
                # One line has no direction yet: the plane is that of seed and candidate together.
                distance[i] = fit_upright_plane(P + moments[i])[3]
            else:
                nx, ny, offset, _, _ = fit_upright_plane(P)
                distance[i] = _theta(moments[i], nx, ny, offset)
            dx, dy = middle[i] - middle[last]
            gap[i] = np.hypot(dx, dy)
            joins = distance[i] < similarity_m and gap[i] < candidates.gap_max_m[i]
        if joins:
            growth[i] = Growth.JOINED
            P += moments[i]
            lines += 1
        else:
            growth[i] = Growth.BROKE if compared else Growth.SEEDED
            P = moments[i].copy()
            lines = 1
            number += 1
        plane[i] = number
        last = i
    return plane, growth, distance, gap


def _settle(
    grown: IntArray, candidates: WallCandidates, settings: WallPlanesSettings
) -> tuple[IntArray, FloatArray]:
    """Join planes in line, then move each candidate to the nearest plane of enough lines.

    Returns the plane (C,) of each candidate, -1 for none, and Θ to the nearest within reach.
    """
    moments, count = candidates.moments, grown.max(initial=0) + 1
    plane, lines_min = grown.copy(), settings.lines_min
    _join_in_line(plane, moments, count, settings.similarity_m, lines_min)
    reaches = candidates.reach[:, None] != Reach.LOW
    x, y = candidates.middle.T[:, :, None]
    # Twice, because the first time moves the planes.
    for _ in range(2):
        _, _, fits = _fit_planes(plane, moments, count, lines_min)
        nx, ny, _, _, low, high = fits.T
        u, gap_m = nx * y - ny * x, candidates.gap_max_m[:, None]
        beside = reaches & (u >= low - gap_m) & (u <= high + gap_m)
        theta = np.where(beside, _thetas(moments, fits), np.inf)
        nearest_m = theta.min(axis=1)
        plane = np.where(nearest_m < settings.similarity_m, theta.argmin(axis=1), -1)
    return plane, np.where(np.isfinite(nearest_m), nearest_m, np.nan)


@numba.njit(cache=True, nogil=True)
def _thetas(moments: FloatArray, fits: FloatArray) -> FloatArray:
    """Θ (C, P) of each candidate to each plane."""
    theta = np.empty((len(moments), len(fits)))
    for c in range(len(moments)):
        for k in range(len(fits)):
            theta[c, k] = _theta(moments[c], fits[k, 0], fits[k, 1], fits[k, 2])
    return theta


@numba.njit(cache=True, nogil=True)
def _totals(plane: IntArray, moments: FloatArray, count: int) -> tuple[FloatArray, IntArray]:
    """The summed moments (P, 6) of each plane's candidates, and their number (P,)."""
    total, lines = np.zeros((count, 6)), np.zeros(count, np.int64)
    for c in range(len(plane)):
        if plane[c] >= 0:
            total[plane[c]] += moments[c]
            lines[plane[c]] += 1
    return total, lines


@numba.njit(cache=True, nogil=True)
def _fit_planes(
    plane: IntArray, moments: FloatArray, count: int, lines_min: int
) -> tuple[FloatArray, IntArray, FloatArray]:
    """`_totals`, and normal, offset, RMS and both ends along it (P, 6) of planes of enough lines.

    Planes of fewer lines begin at infinity.
    """
    total, lines = _totals(plane, moments, count)
    fits = np.zeros((count, 6))
    fits[:, 4] = np.inf
    for k in range(count):
        if lines[k] >= lines_min:
            nx, ny, offset, rms, _ = fit_upright_plane(total[k])
            low, high = _span(moments, plane == k, nx, ny)
            fits[k] = np.array([nx, ny, offset, rms, low, high])
    return total, lines, fits


@numba.njit(cache=True, nogil=True)
def _span(moments: FloatArray, members: BoolArray, nx: float, ny: float) -> tuple[float, float]:
    """Both ends along a plane of its members' upper parts: mean ± `_SPREADS` × spread."""
    low, high = np.inf, -np.inf
    for c in np.flatnonzero(members):
        m = moments[c]
        u = (nx * m[2] - ny * m[1]) / m[0]
        square = (ny * ny * m[3] - 2 * nx * ny * m[4] + nx * nx * m[5]) / m[0]
        reach = _SPREADS * np.sqrt(max(square - u * u, 0.0))
        low, high = min(low, u - reach), max(high, u + reach)
    return low, high


@numba.njit(cache=True, nogil=True)
def _join_in_line(
    plane: IntArray,
    moments: FloatArray,
    count: int,
    similarity_m: float,
    lines_min: int,
) -> None:
    """Join planes in line, largest first: a line before the wall has cut it in Algorithm 1.

    Changes `plane` (C,).
    """
    total, lines = _totals(plane, moments, count)
    merged = True
    while merged:
        # A merge changes the sizes: repeat until nothing joins.
        merged = False
        by_size = np.argsort(-total[:, 0])
        for a in range(count):
            i = by_size[a]
            if lines[i] < lines_min:
                continue
            for j in by_size[a + 1 :]:
                # A single line has no direction that could be the wall's.
                if lines[j] >= 2 and _are_in_line(plane, moments, total, i, j, similarity_m):
                    plane[plane == j] = i
                    total[i] += total[j]
                    lines[i] += lines[j]
                    total[j] = 0.0
                    lines[j] = 0
                    merged = True


@numba.njit(cache=True, nogil=True)
def _are_in_line(
    plane: IntArray,
    moments: FloatArray,
    total: FloatArray,
    larger: int,
    smaller: int,
    similarity_m: float,
) -> bool:
    """Whether one plane fits two that are at most `_MERGE_GAP_M` apart."""
    nx, ny, offset, rms, _ = fit_upright_plane(total[larger] + total[smaller])
    # Stricter than for a candidate, or two faces 2 σ_th apart would become one between them. The
    # smaller plane is known less well.
    if (
        rms > 0.6 * similarity_m
        or _theta(total[larger], nx, ny, offset) > 0.6 * similarity_m
        or _theta(total[smaller], nx, ny, offset) > 0.8 * similarity_m
    ):
        return False
    low_i, high_i = _span(moments, plane == larger, nx, ny)
    low_j, high_j = _span(moments, plane == smaller, nx, ny)
    return bool(max(low_i, low_j) - min(high_i, high_j) <= _MERGE_GAP_M)


def _structures_behind(
    returns: Returns,
    samples: IntArray,
    structures: VerticalStructures,
    upper: IntArray,
    fit: FloatArray,
    settings: WallPlanesSettings,
) -> IntArray:
    """The structures of a plane below its upper ones, from which something nearer parts them.

    It is a valance or a duct that hangs before the wall. At most one structure for each line.
    upper: (u,) the upper structures. fit: the plane's row of `_fit_planes`.
    """
    found = []
    for u in upper:
        xy = returns.points_level[samples[structures.line[u]], :2]
        rho = np.linalg.norm(xy - returns.origin_level[:2], axis=1)
        for s in range(u - 1, -1, -1):
            if structures.line[s] != structures.line[u]:
                break
            last = structures.last[s]
            first = max(structures.first[s], last - 9)
            off_m = np.abs(xy[first : last + 1] @ fit[:2] - fit[2])
            between = rho[last + 1 : structures.first[u]]
            hidden = between.min(initial=np.inf) < rho[last] - OVERHANG_M
            if off_m.max() < 2.0 * settings.similarity_m and hidden:
                found.append(s)
                break
    return np.array(found, np.int64)


@numba.njit(cache=True, nogil=True)
def _ends(
    returns: Returns,
    samples: IntArray,
    candidates: WallCandidates,
    plane: IntArray,
    normal: FloatArray,
    offset_m: FloatArray,
) -> FloatArray:
    """(K, 2, 2) the outermost places along each plane of its candidates' upper samples."""
    points, extents = returns.points_level, np.empty((len(normal), 2))
    extents[:, 0], extents[:, 1] = np.inf, -np.inf
    for c in range(len(plane)):
        k = plane[c]
        if k >= 0:
            upper = slice(candidates.first[c], candidates.last[c] + 1)
            for i in samples[candidates.line[c], upper]:
                u = normal[k, 0] * points[i, 1] - normal[k, 1] * points[i, 0]
                extents[k, 0], extents[k, 1] = min(extents[k, 0], u), max(extents[k, 1], u)
    ends = np.empty((len(normal), 2, 2))
    for k in range(len(normal)):
        for end in range(2):
            ends[k, end, 0] = normal[k, 0] * offset_m[k] - normal[k, 1] * extents[k, end]
            ends[k, end, 1] = normal[k, 1] * offset_m[k] + normal[k, 0] * extents[k, end]
    return ends


def _per_plane(reduce: np.ufunc, values: FloatArray, plane: IntArray, count: int) -> FloatArray:
    """The minimum or maximum (count,) of each plane's values; infinite without any."""
    reduced = np.full(count, np.inf if reduce is np.minimum else -np.inf)
    reduce.at(reduced, plane[plane >= 0], values[plane >= 0])
    return reduced
