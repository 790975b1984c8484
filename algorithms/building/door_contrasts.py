"""Closed doors that are flush with their wall, by how strongly their leaf reflects.

Wood, paint and metal return more or less of a beam than the wall around. Of all that differs so from its wall (posters, boards,
painted dados, tiles, whole walls of another finish) a leaf alone is as wide and as high as doors are, reaches the floor, has
straight jambs and a straight head, and lies in the wall's face, which goes on alike at both sides and above.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import mean_known, median_known, row_means, row_medians
from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.closed_doors import (
    Opening,
    doors_in_pictures,
    is_opaque,
    none_over_another,
    shows_from_the_floor,
)
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.model import CELL_M, BuildingSettings, Doors, cells_in
from ffmap.algorithms.building.shades import Picture, peaks


class DoorContrastsSettings(StepSettings):
    """Telling flush doors by the intensity of their leaves."""

    errors_min: float = Field(
        3.0,
        gt=0,
        description="Minimum step of the intensity at a jamb, in standard errors: as the steps elsewhere on the wall scatter.",
    )
    contrast_min: float = Field(
        0.03,
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
        0.6, gt=0, lt=1, description="Maximum deviation of a part of the leaf from its contrast, as a share of that."
    )
    parts_min: float = Field(
        0.8,
        gt=0,
        le=1,
        description="Minimum share of a door's height over which both jambs show, and of its height and width that contrasts.",
    )
    part_m: float = Field(0.2, gt=0, description="Height (m) of the parts by which that is told.")
    flush_m: float = Field(
        0.012, gt=0, description="Maximum distance (m) of the leaf from the wall's face: a board stands out."
    )


def find_contrasting_doors(
    shown: Sequence[Picture], building: BuildingSettings, settings: DoorContrastsSettings
) -> Doors:
    """The closed, flush doors of all faces that the intensity of their leaf shows, those with the strongest contrast first.

    Their leaf lies in the wall's face (`depth_m` 0). shown: see `pictures`.
    """
    doors, contrast = doors_in_pictures(shown, lambda picture: _leaves(picture, building, settings), building.known_min)
    return replace(doors, contrast=contrast)


def _leaves(picture: Picture, building: BuildingSettings, settings: DoorContrastsSettings) -> list[Opening]:
    """The openings that leaves fill in a picture, none over another: the strongest has the greatest step."""
    shade, counts = picture.shade, picture.counts
    strip, lowest = cells_in(settings.strip_m), cells_in(building.door_height_min_m)
    if len(shade) < cells_in(building.door_width_min_m) + 2 * strip or shade.shape[1] <= lowest:
        return []
    column = row_medians(shade[:, FOOT_ROW:lowest], building.known_min)  # guards and dados are on the wall alone
    step = _steps(column, strip)
    error = _scatter(step)
    edges = peaks(step, settings.errors_min * error)
    found = []
    for first in edges:
        for last in edges[(edges > first) & (step[edges] * step[first] < 0.0)]:
            # Smoothing and the cells' own width blur each side by up to a column.
            if not building.door_width_min_m <= (last - first + 1) * CELL_M <= building.door_width_max_m + CELL_M:
                continue
            leaf = _leaf(picture, column, int(first), int(last), building, settings)
            inner = counts[first:last, FOOT_ROW:lowest]
            if leaf is not None and is_opaque(inner, building):
                found.append(leaf)
    return none_over_another(found)


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


def _leaf(
    picture: Picture,
    column: FloatArray,
    first: int,
    last: int,
    building: BuildingSettings,
    settings: DoorContrastsSettings,
) -> Opening | None:
    """The opening that a leaf fills between two columns that hold its jambs; None where there is none."""
    shade, before_m, *_ = picture
    beside, strip, above = (cells_in(length) for length in (settings.beside_m, settings.strip_m, settings.above_m))
    lowest, highest = cells_in(building.door_height_min_m), cells_in(building.door_height_max_m) + 1
    sides = [_beside(column, first, -beside, building.known_min), _beside(column, last, beside, building.known_min)]
    shown = [np.count_nonzero(np.isfinite(column[side])) for side in sides]
    if min(shown) < 1 or max(shown) < building.known_min * beside:
        return None  # Between two doors the wall itself would be a leaf
    wall = mean_known(np.concatenate([column[side] for side in sides]))
    within, around = shade[first + 1 : last], np.concatenate([shade[side] for side in sides])
    steps = row_means(within.T, building.known_min) - row_means(around.T)
    step = median_known(steps[FOOT_ROW:lowest])
    if not abs(step) > settings.contrast_min * abs(wall):
        return None
    contrast = steps / step
    # The head: contrast as far as there, and none above.
    gone = np.flatnonzero(contrast[lowest - 1 : highest + 1] < 0.5)
    if not len(gone):
        return None
    head = lowest - 1 + int(gone[0])
    over = contrast[head + 1 : head + 1 + above]
    if not (np.isfinite(over).any() and np.nanmax(np.abs(over)) < settings.alike_max):
        return None
    upright, across = contrast[FOOT_ROW:head], (column[first + 1 : last] - wall) / step
    if not all(np.mean(np.abs(leaf - 1.0) < settings.spread_max) > settings.parts_min for leaf in (upright, across)):
        return None
    jambs = _jambs(shade[:, FOOT_ROW:head] / step, first, last, strip, cells_in(settings.part_m), settings)
    relief_m = mean_known(before_m[first + 1 : last, FOOT_ROW:head]) - mean_known(
        np.concatenate([before_m[side, FOOT_ROW:head] for side in sides])
    )
    apart = abs(mean_known(column[sides[0]]) - mean_known(column[sides[1]]))
    if not (jambs and abs(relief_m) < settings.flush_m and apart < settings.alike_max * abs(step)):
        return None
    low, high = first + 1 - _share(column, first, sides[0], step), last + _share(column, last, sides[1], step)
    covered = float(np.clip(contrast[head] if np.isfinite(contrast[head]) else 0.0, 0.0, 1.0))
    return Opening(abs(step), step / wall, low, high, (head + covered) * CELL_M)


def _beside(column: FloatArray, jamb: int, width: int, known_min: float) -> slice:
    """The columns of the wall beside a jamb, at most `width` of them, before it where that is negative.

    Close to a corner, or to what hides the wall, fewer show, of which the last holds returns of the other wall, or of that.
    """
    low, high = (max(jamb + width, 0), jamb) if width < 0 else (jamb + 1, min(jamb + 1 + width, len(column)))
    known = low + np.flatnonzero(np.isfinite(column[low:high]))
    if len(known) >= known_min * abs(width) or len(known) < 2:
        return slice(low, high)
    return slice(int(known[1]), high) if width < 0 else slice(low, int(known[-1]))


def _jambs(contrast: FloatArray, first: int, last: int, strip: int, part: int, settings: DoorContrastsSettings) -> bool:
    """Whether both jambs are straight from the foot to the head: each part of the height steps there.

    A plate around the lock steps more than the leaf does.

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
        difference = row_means(inner.T) - row_means(outer.T)
        parts = np.array([median_known(difference[row : row + part]) for row in range(0, len(difference), part)])
        if not shows_from_the_floor(parts, parts > 1.0 - settings.spread_max, settings.parts_min):
            return False
    return True


def _share(column: FloatArray, jamb: int, side: slice, step: float) -> float:
    """Which share of a jamb's column the leaf covers."""
    share = (column[jamb] - mean_known(column[side])) / step
    return float(np.clip(share, 0.0, 1.0)) if np.isfinite(share) else 0.5
