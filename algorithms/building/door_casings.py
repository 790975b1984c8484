"""Closed doors by the casing around them: those that are flush with their wall, and those whose recess does not show.

Half of all doors are flush on one side, and the reveals of a narrow one deep in its wall hide how far back its leaf lies. What
shows is the casing, which stands out of the wall by a centimetre: of all that hangs on walls or is framed there, a door's casing
alone runs from the floor up one side, over the top, and down the other.
"""

import warnings
from collections.abc import Iterator, Sequence
from functools import partial

import numba
import numpy as np
from pydantic import Field

from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import FILLED, THROUGH, depth_moments, mean_before_m
from ffmap.algorithms.building.closed_doors import (
    Opening,
    closed_door,
    is_opaque,
    none_over_another,
)
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import TracedFaces
from ffmap.algorithms.building.model import (
    AT_FACE_M,
    CELL_M,
    NO_DOORS,
    BuildingSettings,
    Doors,
    cells_in,
)


class DoorCasingsSettings(StepSettings):
    """Telling closed doors by their casings."""

    relief_min_m: float = Field(
        0.004, gt=0, description="Minimum distance (m) of a casing before the wall beside it; flatter ones do not show."
    )
    relief_max_m: float = Field(
        0.04, gt=0, description="Maximum distance (m) of a casing before the wall beside it; a shelf's side stands out farther."
    )
    beside_m: float = Field(0.4, gt=0, description="Width (m) on each side of what a casing stands out from.")
    proud_min: float = Field(0.75, gt=0, le=1, description="Minimum share of its cells that stand out.")
    covered_min: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Minimum share of a column of cells that a casing covers: one as wide as a column covers half of one of two.",
    )
    flush_max: float = Field(
        0.4, gt=0, lt=1, description="Maximum relief beside a casing and above it, as a share of its own."
    )
    within_max: float = Field(
        0.1, ge=0, lt=1, description="Maximum share of the leaf's columns that stand out as well."
    )
    relief_reach_m: float = Field(
        0.2,
        gt=0,
        description="Height (m) at the upper end of a casing's side over which it still stands out, and above no more.",
    )
    width_max_m: float = Field(0.15, gt=0, description="Maximum width (m) of a casing's strips.")
    wall_m: float = Field(0.1, gt=0, description="Minimum width (m) of the wall that has to show beside them.")


def find_cased_doors(faces: TracedFaces, building: BuildingSettings, settings: DoorCasingsSettings) -> Doors:
    """The closed doors of all faces that a casing shows, those with the clearest casing first.

    Their leaf lies in the wall's face (`depth_m` 0), or as far behind it, or before, as what returns from within the casing does. A
    door whose casing shows in both faces of its wall is there twice.
    """
    doors = NO_DOORS
    for face in faces.each():
        for casing in _casings(face.counts, building, settings):
            opening = casing.first, casing.last
            depth_m = _leaf_behind_m(face.counts, opening, casing.head_m, building)
            told = partial(closed_door, face.segment, opening, face.counts, casing.head_m, building.known_min, wall=face.number)
            doors = doors.append(told(depth_m=depth_m, casing_m=casing.shows))
    return doors.select(np.argsort(-doors.casing_m, kind="stable"))


def _leaf_behind_m(counts: FloatArray, opening: tuple[float, float], head_m: float, building: BuildingSettings) -> float:
    """How far behind the face a leaf lies, or before it, by what returns from an opening without the columns at its jambs; 0 of a
    flush one."""
    first, last = round(opening[0]) + 1, round(opening[1]) - 1
    behind_m = -float(mean_before_m(counts[first:last, FOOT_ROW : int(head_m / CELL_M)].sum(axis=(0, 1))))
    return behind_m if abs(behind_m) > building.recess_min_m else 0.0


def _casings(counts: FloatArray, building: BuildingSettings, settings: DoorCasingsSettings) -> list[Opening]:
    """The openings within the casings of one face, none over another, each with its relief on its weakest side.

    counts: (c, rows, 4), see `WallCells`.
    """
    beside, wall = cells_in(settings.beside_m), cells_in(settings.wall_m)
    lowest, highest = cells_in(building.door_height_min_m), cells_in(building.door_height_max_m)
    if len(counts) < cells_in(building.door_width_min_m) + 2 * wall or counts.shape[1] <= lowest + 2 * wall:
        return []
    before_m, variance = depth_moments(counts)
    known = (counts[..., FILLED] >= 2) & (counts[..., THROUGH] <= 0.5 * counts[..., FILLED])
    before_m[~known | (np.abs(before_m) > AT_FACE_M)] = np.nan
    spread_m = np.where(np.isnan(before_m), np.nan, np.sqrt(variance))
    upright_m = before_m - _median_beside(before_m, beside)
    found = []
    for head in range(lowest, min(highest, counts.shape[1] - 2 * wall) + 1):
        relief_m, strip = _strips(upright_m, spread_m, head, building, settings)
        for first, last in _pairs(strip, building):
            sides_m = _relief_beside(relief_m, first, -1, wall), _relief_beside(relief_m, last, 1, wall)
            over_m, head_m = _relief_over(before_m, first, last, head, settings)
            weakest_m = min(relief_m[first], relief_m[last], over_m)
            if (
                weakest_m > settings.relief_min_m
                and max(sides_m) < settings.flush_max * weakest_m
                and min(map(abs, sides_m)) < settings.flush_max * weakest_m
                and np.mean(strip[first + wall : last + 1 - wall]) <= settings.within_max
                and is_opaque(counts[first + 1 : last, FOOT_ROW:head], building)
            ):
                low, high = _inner_edge(relief_m, first, settings), _inner_edge(relief_m[::-1], len(relief_m) - 1 - last, settings)
                opening = Opening(weakest_m, weakest_m, low, len(relief_m) - high, head_m)
                if CELL_M * opening.last - CELL_M * opening.first >= building.door_width_min_m:
                    found.append(opening)
    kept = none_over_another(found)
    return [own for own in kept if not _is_between_doors(own, kept, cells_in(settings.width_max_m))]


def _is_between_doors(own: Opening, openings: Sequence[Opening], width_max: int) -> bool:
    """Whether the strips on both sides of an opening are the casings of others, and go on to higher heads: it is their pier."""
    higher = [other for other in openings if other.head_m > own.head_m + CELL_M]
    before = any(0 <= own.first - other.last <= width_max for other in higher)
    return before and any(0 <= other.first - own.last <= width_max for other in higher)


@numba.njit(cache=True, nogil=True)
def _median_beside(values: FloatArray, reach: int) -> FloatArray:  # pragma: no cover
    """(n, m) of each value the median of the known ones up to `reach` before and behind it on the first axis; NaN without any."""
    median = np.full(values.shape, np.nan)
    window = np.empty(2 * reach + 1)
    for j in range(values.shape[1]):
        for i in range(values.shape[0]):
            if np.isnan(values[i, j]):
                continue
            k = 0
            for n in range(max(i - reach, 0), min(i + reach + 1, values.shape[0])):
                if not np.isnan(values[n, j]):
                    window[k] = values[n, j]
                    k += 1
            median[i, j] = np.median(window[:k])
    return median


def _strips(
    upright_m: FloatArray, spread_m: FloatArray, head: int, building: BuildingSettings, settings: DoorCasingsSettings
) -> tuple[FloatArray, BoolArray]:
    """(c,) how far each column stands out of the wall beside it, from the floor to a head's row, NaN where most of that was not
    seen; and whether as a casing does.

    upright_m, spread_m: (c, rows) relief of the cells and standard deviation of their returns' depths, NaN where unknown.
    """
    reach, widest = cells_in(settings.relief_reach_m), cells_in(settings.width_max_m)
    below = upright_m[:, FOOT_ROW:head]
    seen = np.isfinite(below)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns that nobody saw are unknown
        relief_m = np.nanmean(below, axis=1)
        proud = np.nanmean(np.where(seen, below > 0.0, np.nan), axis=1)
        top_m = np.nanmean(below[:, -reach:], axis=1)
        above_m = np.nanmean(upright_m[:, head + widest : head + widest + reach], axis=1)
        column_spread_m = np.nanmean(spread_m[:, FOOT_ROW:head], axis=1)
        beyond_noise_m = np.sqrt(np.maximum(column_spread_m**2 - np.nanmedian(column_spread_m) ** 2, 0.0))
    # What ends lower is the frame of something else, what goes on above a pillar or a pipe.
    ends = (top_m > settings.flush_max * relief_m) & ~(above_m > settings.flush_max * relief_m)
    stands = (relief_m > settings.relief_min_m) & (proud > settings.proud_min)
    # A casing is a sheet before the wall: where it covers a share p of a column, at a depth d, the returns' mean is p d and their
    # variance p (1 - p) d². A board that stands on the wall on its edge, a shelf's side, has returns at all depths.
    with np.errstate(divide="ignore", invalid="ignore"):
        sheet_m = relief_m + beyond_noise_m**2 / relief_m
        covered = np.where(stands & (sheet_m < settings.relief_max_m), relief_m / sheet_m, 0.0)
    # One that parts two columns may cover less than that of either: of both together it covers half as much again.
    beside = np.maximum(np.append(covered[1:], 0.0), np.append(0.0, covered[:-1]))
    sheet = (covered > 0.0) & (np.maximum(covered, (covered + beside) / 1.5) > settings.covered_min)
    is_known = seen.mean(axis=1) > building.known_min
    return np.where(is_known, relief_m, np.nan), stands & ends & sheet & is_known


def _pairs(strip: BoolArray, building: BuildingSettings) -> Iterator[tuple[int, int]]:
    """Two of the strips' columns, as far apart as a door is wide."""
    columns = np.flatnonzero(strip)
    least, most = cells_in(building.door_width_min_m), cells_in(building.door_width_max_m) + 2
    for first in columns:
        for last in columns[(columns - first >= least) & (columns - first <= most)]:
            yield int(first), int(last)


def _beside(values: FloatArray, column: int, outwards: int, wall: int) -> FloatArray:
    """The values (c, …) of the wall's columns beside a casing's strip that holds a column; fewer where the face ends there."""
    nearest = column + outwards * (1 + wall // 2)
    farthest = nearest + outwards * (wall - 1)
    return values[max(min(nearest, farthest), 0) : max(nearest, farthest, -1) + 1]


def _relief_beside(relief_m: FloatArray, column: int, outwards: int, wall: int) -> float:
    """How far what is beside a casing's strip stands out, where that is least; infinity where the face ends there or rays pass.

    Furniture may stand close by, or the frame of a pane beside the door lie farther back.
    """
    beside_m = _beside(relief_m, column, outwards, wall)
    return float(np.min(beside_m)) if len(beside_m) == wall and np.isfinite(beside_m).all() else np.inf


def _relief_over(
    before_m: FloatArray, first: int, last: int, head: int, settings: DoorCasingsSettings
) -> tuple[float, float]:
    """How far what lies over an opening stands out of the wall beside it at the same height, and the height of its lower edge.

    0 where that goes on above. The returns of a ceiling close above blur both alike. The wall is the side that stands out farther:
    the other may be the next door's leaf. before_m: (c, rows) how far cells lie before the face, NaN where unknown.
    """
    wall, widest = cells_in(settings.wall_m), cells_in(settings.width_max_m)
    sides = _beside(before_m, first, -1, wall), _beside(before_m, last, 1, wall)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # rows that nobody saw are unknown
        relief_m = before_m[first : last + 1] - np.fmax(*(np.nanmean(side_m, axis=0) for side_m in sides))
        over_m = np.fmax(relief_m[:, head], relief_m[:, head + 1])
        above_m = np.nanmean(relief_m[:, head + widest : head + widest + wall])
        lower_m, upper_m = np.nan_to_num(np.nanmean(relief_m[:, head : head + 2], axis=0))
    proud = np.mean(over_m > settings.relief_min_m) > settings.proud_min
    if not proud or above_m > settings.flush_max * max(lower_m, upper_m):
        return 0.0, 0.0
    # The row that the head's strip covers in part stands out by that part of its relief.
    covered = min(max(lower_m / upper_m, 0.0), 1.0) if upper_m > 0.0 else 1.0
    return float(np.nanmean(over_m)), (head + 1 - covered) * CELL_M


def _inner_edge(relief_m: FloatArray, column: int, settings: DoorCasingsSettings) -> float:
    """Where the opening begins, in columns from the face's start, beside a casing's strip that holds a column.

    The last column that the strip covers in part stands out by that part of its relief.
    """
    most = cells_in(settings.width_max_m)
    own = relief_m[column : column + most]
    highest = int(np.nanargmax(own))
    edge = column + highest + 1.0
    if highest + 1 < len(own) and own[highest + 1] > 0.0:
        edge += own[highest + 1] / own[highest]
    return float(edge)
