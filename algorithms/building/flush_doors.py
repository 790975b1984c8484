"""Closed doors that are flush with their wall, by how strongly their leaf reflects.

Of all that differs so from its wall (posters, boards, painted dados, walls of another finish) a
leaf alone is as wide and as high as doors are, reaches the floor, differs alike all over, and lies
in the face of its wall, which goes on alike at both sides and above.
"""

from dataclasses import replace
from functools import reduce

import numpy as np

from ffmap.algorithms.base.known import median_known, row_means, row_medians
from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import segment
from ffmap.algorithms.building.evidence import FOOT_ROW, NEAR, ON, Evidence
from ffmap.algorithms.building.model import (
    CELL_M,
    NO_DOORS,
    BuildingSettings,
    Doors,
    cells_in,
    one_door,
    unknown_support,
)
from ffmap.algorithms.building.settle import ParsedFaces
from ffmap.algorithms.scan.doors import DoorState

_RETURNS_MIN, _BINS = 2, 10
"""Least returns of a cell for its mean intensity, and steps of the cosine of incidence."""
_KNOWN_MIN = 0.5
"""Least share of known cells in a column, or of known rows of a leaf, for their median."""
_ERRORS_MIN, _CONTRAST_MIN = 4.0, 0.03
"""Least step of the intensity at a jamb, in standard errors of the steps along its wall, and as a
share of the wall's: the channels of one lidar differ by less."""
_STRIP, _BESIDE, _ABOVE = 2, 6, 3
"""Columns on each side of a jamb, columns of the wall beside a door, rows of the wall above it."""
_ALIKE_MAX, _SPREAD_MAX, _PARTS_MIN = 0.4, 0.6, 0.8
"""Greatest difference of the wall's parts, and of a part of the leaf from its contrast, as shares
of that; least share of the leaf's rows and columns that differ by no more."""
_FLUSH_M = 0.012
"""Greatest distance (m) of a leaf from the wall's face: a board stands out, a recess is parsed."""


def find_flush_doors(parsed: ParsedFaces, settings: BuildingSettings) -> Doors:
    """The closed doors that the intensity of their leaf shows, the strongest contrast first."""
    evidence = parsed.faces.evidence
    shade = _shades(evidence)
    shade[parsed.opening] = np.nan
    found = []
    for w in range(len(parsed.faces)):
        own = evidence.of(w)
        found += [
            (contrast, _door(parsed, w, own, jambs, head, contrast, settings))
            for contrast, jambs, head in _leaves(shade[evidence.columns(w)], own, settings)
        ]
    found.sort(key=lambda seen: -seen[0])
    return reduce(Doors.append, (door for _, door in found), NO_DOORS)


def _shades(evidence: Evidence) -> FloatArray:
    """(columns, rows) mean intensity of each cell over what is usual at its angle of incidence.

    NaN where too few returns have one, or where most rays pass.
    """
    count, total, cosines = (evidence.light[..., k].astype(np.float64) for k in range(3))
    near = evidence.ended[..., ON : NEAR + 1].sum(axis=-1)
    known = (count >= _RETURNS_MIN) & (near > 0.5 * evidence.ended.sum(axis=-1))
    mean = total / np.maximum(count, 1.0)
    cosine = cosines / np.maximum(count, 1.0)
    at = (cosine * _BINS).astype(np.int64).clip(0, _BINS - 1)
    bins = np.unique(at[known])
    if not len(bins):
        return np.full(count.shape, np.nan)
    usual = [np.median(mean[known & (at == k)]) for k in bins]
    middles = [np.median(cosine[known & (at == k)]) for k in bins]
    expected = np.interp(cosine, middles, usual)
    return np.where(known & (expected > 0.0), mean / np.maximum(expected, 1e-9), np.nan)


def _leaves(
    shade: FloatArray, evidence: Evidence, settings: BuildingSettings
) -> list[tuple[float, tuple[int, int], int]]:
    """Contrast, first and last column, and head of the leaves in one face, none over another."""
    lowest = cells_in(settings.door_height_min_m)
    column = row_medians(shade[:, FOOT_ROW:lowest], _KNOWN_MIN)
    step = np.full(len(column), np.nan)
    for c in range(_STRIP, len(column) - _STRIP):
        step[c] = column[c + 1 : c + 1 + _STRIP].mean() - column[c - _STRIP : c].mean()
    edges = _peaks(step)
    found = []
    least, most = cells_in(settings.door_width_min_m), cells_in(settings.door_width_max_m)
    for first in edges:
        for last in edges[(edges - first >= least) & (edges - first <= most)]:
            jambs = int(first), int(last)
            if step[first] * step[last] < 0.0:
                contrast, head = _leaf(shade, column, jambs, settings)
                if head and _is_flush(evidence, jambs, head):
                    found.append((contrast, jambs, head))
    kept: list[tuple[float, tuple[int, int], int]] = []
    for own in sorted(found, reverse=True):
        if not any(own[1][0] < other[1][1] and other[1][0] < own[1][1] for other in kept):
            kept.append(own)
    return kept


def _peaks(step: FloatArray) -> IntArray:
    """(k,) columns where steps (c,) are large, and the largest within two columns."""
    error = 1.4826 * median_known(np.abs(step - median_known(step)))
    size = np.pad(np.nan_to_num(np.abs(step)), 2)
    largest = np.max([size[k : k + len(step)] for k in range(5)], axis=0)
    size = size[2:-2]
    least = np.fmax(_ERRORS_MIN * error, _CONTRAST_MIN)
    return np.flatnonzero((size == largest) & (size > least))


def _leaf(
    shade: FloatArray, column: FloatArray, jambs: tuple[int, int], settings: BuildingSettings
) -> tuple[float, int]:
    """Contrast and head (row) of a leaf between two columns; 0 and 0 where there is none."""
    first, last = jambs
    sides = slice(max(first - _BESIDE, 0), max(first - 1, 0)), slice(last + 2, last + 1 + _BESIDE)
    wall = [column[side][np.isfinite(column[side])] for side in sides]
    if min(map(len, wall)) < _STRIP:
        return 0.0, 0
    within = shade[first + 2 : last - 1]
    around = row_means(np.concatenate([shade[side] for side in sides]).T)
    lowest, highest = (
        cells_in(height_m) for height_m in (settings.door_height_min_m, settings.door_height_max_m)
    )
    steps = row_means(within.T) - around
    step = float(row_medians(steps[None, FOOT_ROW:lowest], _KNOWN_MIN)[0])
    left, right = (float(np.median(own)) for own in wall)
    if not abs(step) >= _CONTRAST_MIN or abs(left - right) > _ALIKE_MAX * abs(step):
        return 0.0, 0
    contrast = steps / step
    gone = np.flatnonzero(contrast[lowest - 1 : highest + 1] < 0.5)
    head = lowest - 1 + int(gone[0]) if len(gone) else 0
    above = contrast[head + 1 : head + 1 + _ABOVE]
    if not head or not np.isfinite(above).any() or np.nanmax(np.abs(above)) > _ALIKE_MAX:
        return 0.0, 0
    # Between two leaves the wall itself differs from both its sides, but not above these.
    beside = around[head + 1 : head + 1 + _ABOVE] - np.nanmedian(around[FOOT_ROW:lowest])
    if not np.nanmax(np.abs(beside)) < _SPREAD_MAX * abs(step):
        return 0.0, 0
    across = (column[first + 2 : last - 1] - 0.5 * (left + right)) / step
    alike = [np.abs(part - 1.0) < _SPREAD_MAX for part in (contrast[FOOT_ROW:head], across)]
    shows = all(part.mean() > _PARTS_MIN for part in alike)
    return (abs(step), head) if shows and alike[0][:3].any() else (0.0, 0)


def _is_flush(evidence: Evidence, jambs: tuple[int, int], head: int) -> bool:
    """Whether a leaf lies in the face of the wall beside it."""
    first, last = jambs
    beside = np.r_[max(first - _BESIDE, 0) : first - 1, last + 2 : last + 1 + _BESIDE]
    columns = np.r_[first + 2 : last - 1], beside[(beside >= 0) & (beside < len(evidence.ended))]
    means = [_mean_m(evidence, own, head) for own in columns]
    return abs(means[0] - means[1]) < _FLUSH_M


def _mean_m(evidence: Evidence, columns: IntArray, head: int) -> float:
    near = slice(0, NEAR + 1)
    count = evidence.ended[columns, FOOT_ROW:head, near].sum()
    return float(evidence.depth_sum[columns, FOOT_ROW:head, near].sum() / max(count, 1.0))


def _door(
    parsed: ParsedFaces,
    w: int,
    evidence: Evidence,
    jambs: tuple[int, int],
    head: int,
    contrast: float,
    settings: BuildingSettings,
) -> Doors:
    face, first, last = segment(parsed.faces.walls, w), *jambs
    ended = evidence.ended[first + 1 : last, FOOT_ROW:head]
    rays, on = ended[..., ON:].sum(axis=(1, 2)), ended[..., ON : NEAR + 1].sum()
    return one_door(
        ends=face.at(CELL_M * np.array([first + 0.5, last + 0.5])),
        normal=face.normal,
        head_m=head * CELL_M,
        depth_m=0.0,
        state=DoorState.CLOSED,
        agreement=float(on / max(rays.sum(), 1.0)),
        coverage=(rays >= settings.rays_min).mean(),
        ray_count=int(rays.sum()),
        wall=w,
        support=replace(unknown_support(1), contrast=np.array([contrast])),
    )
