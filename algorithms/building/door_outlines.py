"""Closed doors that are flush with their wall, by the line that their frame draws around them in the intensity.

A leaf may be painted as its wall is; its frame, or the joint around it, returns more or less than either. Of all lines on walls
(edges of panels and tiles, pipes, cables, pictures' frames) a door's alone runs from the floor up one side, over the top, and down
the other, and ends there. A line that stands out of the wall is left to casings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import mean_known, row_means
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

_NEAR, _FAR = 2, 3  # What a line is compared with on each side, in cells from its middle: its edges may blur those between


class DoorOutlinesSettings(StepSettings):
    """Telling flush doors by the outline of their frame in the intensity."""

    contrast_min: float = Field(
        0.02, gt=0, lt=1, description="Minimum difference of a line from what is on either side of it, as a share of that."
    )
    errors_min: float = Field(
        3.0, gt=0, description="Minimum difference of a line, in standard errors: as the columns around the door scatter."
    )
    around_m: float = Field(0.5, gt=0, description="Width (m) of the wall beside a door by which that is told.")
    beside_m: float = Field(0.25, gt=0, description="Width (m) of the wall beside a door that its head is told against.")
    parts_min: float = Field(0.75, gt=0, le=1, description="Minimum share of a door's height over which each line shows.")
    part_m: float = Field(0.2, gt=0, description="Height (m) of the parts by which that is told.")
    spread_max: float = Field(
        0.6, gt=0, lt=1, description="Maximum deviation of a part of a line from the whole, as a share of that."
    )
    head_min: float = Field(
        0.5, gt=0, lt=1, description="Minimum difference of the line over the head, as a share of those at the jambs."
    )
    above_m: float = Field(0.3, gt=0, description="Height (m) above a head over which no jamb's line may go on.")
    above_max: float = Field(0.5, gt=0, lt=1, description="Maximum difference of a line there, as a share of its own.")
    relief_max_m: float = Field(
        0.01, gt=0, description="Maximum distance (m) of a line from the wall beside it: a casing stands out."
    )


class _Lines(NamedTuple):
    """(c, …) by which share each cell differs from those of the columns before it, and from those behind; NaN where unknown."""

    before: FloatArray
    behind: FloatArray

    @classmethod
    def of(cls, shade: FloatArray) -> "_Lines":
        """Along the first axis."""
        padded = np.pad(shade, [(_FAR, _FAR), *[(0, 0)] * (shade.ndim - 1)], constant_values=np.nan)
        size = len(shade)
        with np.errstate(invalid="ignore", divide="ignore"):
            before, behind = (
                2.0 * shade / (padded[_FAR + near :][:size] + padded[_FAR + far :][:size]) - 1.0
                for near, far in ((-_NEAR, -_FAR), (_NEAR, _FAR))
            )
        return cls(before, behind)

    def column(self, c: int, rows: slice) -> float:
        """Of some rows of one column, see `line`."""
        return float(_line(*(mean_known(side[c, rows]) for side in self)))


def _line(before: FloatArray | float, behind: FloatArray | float) -> FloatArray:
    """By how much what differs from both sides in the same direction does so at least; 0 where it does not: that is a step."""
    least = np.where(np.abs(before) < np.abs(behind), before, behind)
    return np.where(np.isfinite(before) & np.isfinite(behind), np.where(np.multiply(before, behind) > 0.0, least, 0.0), np.nan)


def find_outlined_doors(
    shown: Sequence[Picture], building: BuildingSettings, settings: DoorOutlinesSettings
) -> Doors:
    """The closed, flush doors of all faces that an outline in the intensity shows, those with the strongest first.

    Their leaf lies in the wall's face (`depth_m` 0). shown: see `pictures`.
    """
    doors, outline = doors_in_pictures(shown, lambda picture: _outlines(picture, building, settings), building.known_min)
    return replace(doors, outline=outline)


def _outlines(picture: Picture, building: BuildingSettings, settings: DoorOutlinesSettings) -> list[Opening]:
    """The openings within the outlines in a picture, none over another: each shows by the contrast on its weaker jamb."""
    lowest = cells_in(building.door_height_min_m)
    if picture.shade.shape[1] <= lowest:
        return []
    lines = _Lines.of(picture.shade)
    before, behind = (row_means(side[:, FOOT_ROW:lowest], building.known_min) for side in lines)
    line = _line(before, behind)
    found = []
    for first, last in _pairs(line, building, settings):
        contrast = min(line[first], line[last], key=abs)
        noise = _noise(0.5 * (before + behind), first, last, cells_in(settings.around_m))
        inner = picture.counts[first + 1 : last, FOOT_ROW:lowest]
        if abs(contrast) > settings.errors_min * noise and is_opaque(inner, building):
            head = _head(picture.shade, first, last, contrast, building, settings)
            if head is not None and _jambs(picture, lines, line, first, last, int(head), settings):
                low = first + 1 + _share(line[first + 1], line[first])
                high = last - _share(line[last - 1], line[last])
                found.append(Opening(abs(contrast), float(contrast), low, high, head * CELL_M))
    return none_over_another(found)


def _pairs(line: FloatArray, building: BuildingSettings, settings: DoorOutlinesSettings) -> Iterator[tuple[int, int]]:
    """Two columns with a line, both of more or both of less than the wall, as far apart as a door is wide."""
    columns = peaks(line, settings.contrast_min)
    least, most = cells_in(building.door_width_min_m), cells_in(building.door_width_max_m) + 1
    for first in columns:
        apart = columns - first
        for last in columns[(apart > least) & (apart <= most) & (line[columns] * line[first] > 0.0)]:
            yield int(first), int(last)


def _noise(differs: FloatArray, first: int, last: int, around: int) -> float:
    """Standard deviation of what columns beside and between two jambs differ by from their neighbours, but for a few that stand
    out.
    """
    near = np.arange(max(first - around, 0), min(last + around + 1, len(differs)))
    values = differs[near[(np.abs(near - first) > _NEAR) & (np.abs(near - last) > _NEAR)]]
    return 1.4826 * float(np.median(np.abs(values[np.isfinite(values)]))) if np.isfinite(values).any() else np.inf


def _head(
    shade: FloatArray, first: int, last: int, contrast: float, building: BuildingSettings, settings: DoorOutlinesSettings
) -> float | None:
    """Where the line over an opening ends below, in rows; None where there is none.

    It is told against the wall beside, since rays meet all of a row at similar angles.
    """
    lowest, highest = cells_in(building.door_height_min_m), cells_in(building.door_height_max_m)
    beside = cells_in(settings.beside_m)
    around = np.concatenate([shade[max(first - 1 - beside, 0) : max(first - 1, 0)], shade[last + 2 : last + 2 + beside]])
    with np.errstate(invalid="ignore", divide="ignore"):
        line = _line(*_Lines.of(row_means(shade[first + 2 : last - 1].T) / row_means(around.T))) / contrast
    rows = np.nan_to_num(line[: highest + 1])
    rows[: lowest - 1] = 0.0
    head = int(np.argmax(rows))
    if not rows[head] > settings.head_min:
        return None
    return head - _share(line[head - 1], line[head])


def _jambs(
    picture: Picture, lines: _Lines, line: FloatArray, first: int, last: int, head: int, settings: DoorOutlinesSettings
) -> bool:
    """Whether both lines are straight and even from the floor to the head, and end there, and lie in the wall's face."""
    part, above = cells_in(settings.part_m), slice(head + _FAR, head + _FAR + cells_in(settings.above_m))
    for c in (first, last):
        parts = np.array([lines.column(c, slice(row, min(row + part, head))) for row in range(FOOT_ROW, head, part)]) / line[c]
        if not shows_from_the_floor(parts, np.abs(parts - 1.0) < settings.spread_max, settings.parts_min):
            return False
        if lines.column(c, above) / line[c] > settings.above_max:
            return False
        own, *beside = (mean_known(picture.before_m[c + k, FOOT_ROW:head]) for k in (0, -_FAR, -_NEAR, _NEAR, _FAR))
        if not abs(own - np.mean(beside)) < settings.relief_max_m:
            return False
    return True


def _share(beside: float, line: float) -> float:
    """Which share of a neighbouring cell a line covers that lies in both."""
    return float(np.clip(np.nan_to_num(beside / line), 0.0, 1.0))
