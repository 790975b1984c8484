"""Closed doors that are flush with their wall, by how strongly their leaf reflects.

Wood, paint and metal return more or less of a beam than the wall around. Of all that differs so from its wall (posters, boards,
painted dados, tiles, whole walls of another finish) a leaf alone is as wide and as high as doors are, reaches the floor, has
straight jambs and a straight head, and lies in the wall's face, which goes on alike at both sides and above.

Intensities fall with the angle of incidence in a way that depends on the sensor. Cells that were seen at several angles tell
how, whatever they are made of.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.base.segments import Segment, segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.door_casings import flush_door, is_opaque
from ffmap.algorithms.building.model import CELL_M, NO_DOORS, ON_FACE_M, BuildingSettings, Doors, Walls, cells_in
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, SUM, THROUGH, WallCells

_RETURNS_MIN = 2  # Of a cell, for its mean to count
_ONE_DIRECTION = 0.998  # Cosine of what faces of one wall differ by at most


class DoorContrastsSettings(StepSettings):
    """Telling flush doors by the intensity of their leaves."""

    errors_min: float = Field(
        5.0,
        gt=0,
        description="Minimum step of the intensity at a jamb, in standard errors: as the steps elsewhere on the wall scatter.",
    )
    contrast_min: float = Field(
        0.05,
        gt=0,
        lt=1,
        description="Minimum step of the intensity, as a share of the wall's: emitters differ by less.",
    )
    strip_m: float = Field(0.1, gt=0, description="Width (m) of what is compared on both sides of a jamb.")
    beside_m: float = Field(
        0.3, gt=0, description="Width (m) of the wall beside a door that the leaf is compared with."
    )
    above_m: float = Field(
        0.15, gt=0, description="Height (m) of the wall above a door that has to be like the wall beside."
    )
    alike_max: float = Field(
        0.4, gt=0, lt=1, description="Maximum difference of the wall's own parts, as a share of the leaf's contrast."
    )
    spread_max: float = Field(
        0.5, gt=0, lt=1, description="Maximum deviation of a part of the leaf from its contrast, as a share of that."
    )
    parts_min: float = Field(
        0.8, gt=0, le=1, description="Minimum share of a door's height over which both jambs show."
    )
    part_m: float = Field(0.2, gt=0, description="Height (m) of the parts by which that is told.")
    one_wall_m: float = Field(
        0.05,
        gt=0,
        description="Maximum distance (m) of another face that a wall goes on in, and a leaf may lie in both.",
    )
    flush_m: float = Field(
        0.012, gt=0, description="Maximum distance (m) of the leaf from the wall's face: a board stands out."
    )


class _Leaf(NamedTuple):
    """One leaf in a picture: its contrast with the wall, in the sensor's unit and as a share of the wall's; from which column to
    which; its head.
    """

    step: float
    contrast: float
    first: float
    last: float
    head_m: float


class _Picture(NamedTuple):
    """A face's cells: mean intensity (c, rows), see `shades`, and counts (c, rows, 4), see `WallCells`."""

    shade: FloatArray
    counts: FloatArray

    @classmethod
    def of(cls, cells: WallCells, response: FloatArray) -> "_Picture":
        """Of a single face. response: see `response_by_angle`."""
        return cls(shades(cells.light, response), cells.counts.astype(np.float64))


def find_contrasting_doors(
    walls: Walls, cells: WallCells, building: BuildingSettings, settings: DoorContrastsSettings
) -> Doors:
    """The closed, flush doors of all faces that their intensity shows, those with the strongest contrast first.

    Their leaf lies in the wall's face (`depth_m` 0). None where no scan has intensities.
    """
    doors = NO_DOORS
    if not len(cells.light):
        return doors
    response = response_by_angle(cells.light)
    faces = tuple(segments(walls))
    own = [_Picture.of(cells.of(w), response) for w in range(len(walls))]
    reach = cells_in(building.door_width_max_m)
    for w, face in enumerate(faces):
        picture = _continued(w, faces, own, reach, settings.one_wall_m)
        for leaf in _leaves(picture, building, settings):
            opening = leaf.first, leaf.last
            shared = min(leaf.last, len(own[w].shade) + reach) - max(leaf.first, reach)
            if shared < 0.4 * (leaf.last - leaf.first):
                continue  # It is rather the other face's
            door = flush_door(face, w, opening, reach, leaf.head_m, picture.counts, building.known_min)
            doors = doors.append(replace(door, contrast=np.array([leaf.contrast])))
    return doors.select(np.argsort(-np.abs(doors.contrast), kind="stable"))


def _continued(w: int, faces: Sequence[Segment], own: list[_Picture], reach: int, one_wall_m: float) -> _Picture:
    """A face with `reach` columns more at each end, as far as other faces of its wall go on there: a door may lie in two of them.

    one_wall_m: how far they may lie apart.
    """
    size, face = len(own[w].shade), faces[w]
    shade, counts = (
        np.full((size + 2 * reach, *column.shape[1:]), nothing)
        for column, nothing in zip(own[w], (np.nan, 0.0), strict=True)
    )
    shade[reach : reach + size], counts[reach : reach + size] = own[w]
    for k, other in enumerate(faces):
        ends = np.stack([other.start, other.at(np.array([other.length_m]))[0]])
        if k == w or other.normal @ face.normal < _ONE_DIRECTION or np.abs(face.before_m(ends)).max() > one_wall_m:
            continue
        places = face.place_m(other.at(CELL_M * (np.arange(len(own[k].shade)) + 0.5)))
        column = np.floor(places / CELL_M).astype(np.int64) + reach
        beyond = (column >= 0) & (column < len(shade)) & ((column < reach) | (column >= reach + size))
        shade[column[beyond]], counts[column[beyond]] = own[k].shade[beyond], own[k].counts[beyond]
    return _Picture(shade, counts)


def response_by_angle(light: FloatArray) -> FloatArray:
    """(angles,) how intensities fall with the angle of incidence, 1 at right angles, by the cells that were seen at two of them.

    light: see `WallCells`.
    """
    response = np.ones(light.shape[2])
    count, total = light[..., 0].astype(np.float64), light[..., 1].astype(np.float64)
    for k in range(1, len(response)):
        both = np.minimum(count[..., k - 1], count[..., k])
        seen = (both >= _RETURNS_MIN) & (total[..., k - 1] > 0.0) & (total[..., k] > 0.0)
        ratio = total[seen, k] / count[seen, k] * count[seen, k - 1] / total[seen, k - 1]
        response[k] = response[k - 1] * (_weighted_median(ratio, both[seen]) if len(ratio) else 1.0)
    return response


def _weighted_median(values: FloatArray, weights: FloatArray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def shades(light: FloatArray, response: FloatArray) -> FloatArray:
    """(columns, rows) mean intensity of each cell as it is at right angles, NaN where too few returns tell.

    light: see `WallCells`. response: (angles,) see `response_by_angle`.
    """
    count = light[..., 0].sum(axis=-1)
    total = (light[..., 1].astype(np.float64) / response).sum(axis=-1)
    return np.where(count >= _RETURNS_MIN, total / np.maximum(count, 1.0), np.nan)


def _leaves(picture: _Picture, building: BuildingSettings, settings: DoorContrastsSettings) -> list[_Leaf]:
    """The leaves in a picture, none over another."""
    shade, counts = picture
    strip, lowest = cells_in(settings.strip_m), cells_in(building.door_height_min_m)
    if len(shade) < cells_in(building.door_width_min_m) + 2 * strip or shade.shape[1] <= lowest:
        return []
    with np.errstate(invalid="ignore", divide="ignore"):
        before_m = counts[..., SUM] / counts[..., FILLED]
    # What stands out of the face, or is rays' way through it, is neither wall nor leaf.
    off = (np.abs(before_m) > ON_FACE_M) | (counts[..., THROUGH] > 0.5 * counts[..., FILLED])
    shade, before_m = np.where(off, np.nan, shade), np.where(off, np.nan, before_m)
    column = _column_means(shade[:, FOOT_ROW:lowest], building.known_min)
    step = _steps(column, strip)
    error = _scatter(step)
    edges = _edges(step, settings.errors_min * error)
    found = []
    for first in edges:
        for last in edges[(edges > first) & (step[edges] * step[first] < 0.0)]:
            # Smoothing and the cells' own width blur each side by up to a column.
            if not building.door_width_min_m <= (last - first + 1) * CELL_M <= building.door_width_max_m + CELL_M:
                continue
            leaf = _leaf(shade, before_m, column, int(first), int(last), building, settings)
            inner = counts[first:last, FOOT_ROW:lowest]
            if leaf is not None and is_opaque(inner, building):
                found.append(leaf)
    found.sort(key=lambda leaf: -abs(leaf.step))
    leaves: list[_Leaf] = []
    for leaf in found:
        if not any(leaf.first < other.last and other.first < leaf.last for other in leaves):
            leaves.append(leaf)
    return leaves


def _column_means(shade: FloatArray, known_min: float) -> FloatArray:
    """(c,) of each column of cells (c, rows), NaN where too little of it is known."""
    known = np.isfinite(shade)
    count = known.sum(axis=1)
    mean = np.where(known, shade, 0.0).sum(axis=1) / np.maximum(count, 1)
    return np.where(count >= known_min * shade.shape[1], mean, np.nan)


def _steps(column: FloatArray, strip: int) -> FloatArray:
    """(c,) by how much a strip of columns from each on differs from one before it; a jamb lies anywhere in the column between."""
    step = np.full(len(column), np.nan)
    for c in range(strip, len(column) - strip):
        step[c] = column[c + 1 : c + 1 + strip].mean() - column[c - strip : c].mean()
    return step


def _scatter(values: FloatArray) -> float:
    """Standard deviation of the known ones, but for a few that stand out; 0 where none is known."""
    known = values[np.isfinite(values)]
    return 1.4826 * float(np.median(np.abs(known - np.median(known)))) if len(known) else 0.0


def _edges(step: FloatArray, least: float) -> IntArray:
    """The columns at which a face's steps are greatest, on either side of 0, and at least so great."""
    size = np.nan_to_num(np.abs(step))
    padded = np.pad(size, 2)
    greatest = np.max([padded[k : k + len(size)] for k in range(5)], axis=0)
    return np.flatnonzero((size > 0.0) & (size >= least) & (size == greatest))


def _leaf(
    shade: FloatArray,
    before_m: FloatArray,
    column: FloatArray,
    first: int,
    last: int,
    building: BuildingSettings,
    settings: DoorContrastsSettings,
) -> _Leaf | None:
    """The leaf between two columns that hold its jambs; None where there is none."""
    beside, strip, above = (cells_in(length) for length in (settings.beside_m, settings.strip_m, settings.above_m))
    lowest, highest = cells_in(building.door_height_min_m), cells_in(building.door_height_max_m) + 1
    sides = [slice(max(first - beside, 0), first), slice(last + 1, last + 1 + beside)]
    if not all(np.count_nonzero(np.isfinite(column[side])) >= building.known_min * beside for side in sides):
        return None  # Between two doors the wall itself would be a leaf
    wall = np.concatenate([column[side] for side in sides])
    step = _mean(column[first + 1 : last]) - _mean(wall)
    if not abs(step) > settings.contrast_min * abs(_mean(wall)):
        return None
    within, around = shade[first + 1 : last], np.concatenate([shade[side] for side in sides])
    contrast = (_row_means(within, building.known_min) - _row_means(around, 0.0)) / step
    # The head: contrast as far as there, and none above.
    gone = np.flatnonzero(contrast[lowest - 1 : highest + 1] < 0.5)
    if not len(gone):
        return None
    head = lowest - 1 + int(gone[0])
    over = contrast[head + 1 : head + 1 + above]
    if not (np.isfinite(over).any() and np.nanmax(np.abs(over)) < settings.alike_max):
        return None
    leaf = contrast[FOOT_ROW:head]
    if not np.mean(np.abs(leaf - 1.0) < settings.spread_max) > settings.parts_min:
        return None
    jambs = _jambs(shade[:, FOOT_ROW:head] / step, first, last, strip, cells_in(settings.part_m), settings)
    relief_m = _mean(before_m[first + 1 : last, FOOT_ROW:head]) - _mean(
        np.concatenate([before_m[side, FOOT_ROW:head] for side in sides])
    )
    apart = abs(_mean(column[sides[0]]) - _mean(column[sides[1]]))
    if not (jambs and abs(relief_m) < settings.flush_m and apart < settings.alike_max * abs(step)):
        return None
    low, high = first + 1 - _share(column, first, sides[0], step), last + _share(column, last, sides[1], step)
    covered = float(np.clip(contrast[head] if np.isfinite(contrast[head]) else 0.0, 0.0, 1.0))
    return _Leaf(step, step / _mean(wall), low, high, (head + covered) * CELL_M)


def _jambs(contrast: FloatArray, first: int, last: int, strip: int, part: int, settings: DoorContrastsSettings) -> bool:
    """Whether both jambs are straight from the foot to the head: each part of the height steps there, and as the whole does.

    contrast: (c, rows) of the whole face between foot and head, in units of the leaf's step.
    """
    for column, inwards in ((first, 1), (last, -1)):
        inner, outer = (
            contrast[max(min(near, far), 0) : max(near, far, -1) + 1]
            for near, far in (
                (column + inwards, column + inwards * strip),
                (column - inwards, column - inwards * strip),
            )
        )
        if len(inner) < strip or len(outer) < strip:
            return False
        difference = _row_means(inner, 0.0) - _row_means(outer, 0.0)
        parts = np.array([_mean(difference[row : row + part]) for row in range(0, len(difference), part)])
        # A leaf reaches the floor: the lowest part that was seen steps as well.
        known = np.flatnonzero(np.isfinite(parts))
        right = np.abs(parts - 1.0) < settings.spread_max
        if not len(known) or known[0] > 1 or not right[known[0]] or right.sum() < settings.parts_min * len(parts):
            return False
    return True


def _share(column: FloatArray, jamb: int, side: slice, step: float) -> float:
    """Which share of a jamb's column the leaf covers."""
    share = (column[jamb] - _mean(column[side])) / step
    return float(np.clip(share, 0.0, 1.0)) if np.isfinite(share) else 0.5


def _row_means(cells: FloatArray, known_min: float) -> FloatArray:
    """(rows,) of cells (c, rows), NaN where too few of a row are known."""
    return _column_means(cells.T, max(known_min, 1.0 / max(len(cells), 1)))


def _mean(values: FloatArray) -> float:
    """Of the known ones; NaN of none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")
