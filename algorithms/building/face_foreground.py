"""What is before each wall face: how high the room is there, and what stands flat against the wall.

A cupboard's back, a shelf, a leaf that was opened against the wall lie closer to it than one scan
can tell. Over all scans the mean distance of a cell's returns before the face is known to
millimetres. In each column of cells something stands if a line with a step fits these distances
better than a line: walls and poses lean.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import row_medians
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import segment
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.evidence import FOOT_ROW, NEAR, Evidence, first_columns
from ffmap.algorithms.building.model import (
    CELL_M,
    ON_FACE_M,
    Doors,
    Walls,
    cells_in,
    stretches,
)
from ffmap.algorithms.building.parse import CELL_MEAN_M, RAY_M
from ffmap.algorithms.building.storey import Storey, TracedFaces, above_doors_m, column_places
from ffmap.algorithms.scan.doors import DoorState

_AROUND, _FEW = 11, 8
"""Columns that count together above doors, and the returns of a cell that need no others."""
_END_M, _CEILING_M = 0.1, 0.1
"""Distances (m) from a face's ends, and below the ceiling, where other surfaces return."""
_LEAN = 0.005
"""Standard deviation of how much walls lean, and poses tilt (m per m): 0.3 degrees."""
_FOOT_M = 0.3
"""Greatest height (m) of the foot of what stands on the floor; what is seen higher only hangs."""
_ALL_OVER_MIN = 0.7
"""Least share of a thing's rows that stand before the wall: fewer do of what hangs on it."""


class ForegroundSettings(StepSettings):
    """Relief before walls: what many scans together show to stand before a face."""

    relief_m: float = Field(
        0.006, gt=0, description="Minimum mean distance (m) of relief from its wall."
    )
    extent_min_m: float = Field(
        0.4, gt=0, description="Minimum height and width (m) of relief: casings are narrower."
    )
    extent_max_m: float = Field(
        3.0, gt=0, description="Maximum width (m) of relief; what is wider is panelling, wall."
    )


@dataclass(frozen=True)
class Foreground:
    """What is before wall faces, by their cells, 5 cm wide and high.

    first: (W + 1,) the column at which each face begins.
    clear_m: (columns,) metres from the floor to the ceiling before each column; NaN where none was
        seen.
    ground_m: (columns,) map z of the floor before each column.
    covered: (columns, rows) whether something stands flat against the wall there.
    """

    first: IntArray
    clear_m: FloatArray
    ground_m: FloatArray
    covered: BoolArray

    def append(self, more: "Foreground") -> "Foreground":
        """Of these faces and of more."""
        rows = max(self.covered.shape[1], more.covered.shape[1])
        wider = [
            np.pad(part.covered, ((0, 0), (0, rows - part.covered.shape[1])))
            for part in (self, more)
        ]
        return Foreground(
            np.concatenate([self.first, self.first[-1] + more.first[1:]]),
            np.concatenate([self.clear_m, more.clear_m]),
            np.concatenate([self.ground_m, more.ground_m]),
            np.concatenate(wider),
        )


def bare_foreground(low: Walls, storey: Storey) -> Foreground:
    """That of low walls: nothing stands before them, and the room there is as high as they are."""
    first = first_columns(low)
    ground_m = storey.ground_m(column_places(low, first))
    clear_m = np.repeat(low.top_m, np.diff(first))
    return Foreground(first, clear_m, ground_m, np.zeros((len(ground_m), 1), bool))


def find_foreground(
    faces: TracedFaces, opening: BoolArray, doors: Doors, settings: ForegroundSettings
) -> Foreground:
    """What stands flat against the faces, but for the leaves of closed doors.

    opening: (columns, rows) the cells of openings, which are no wall.
    """
    covered = np.zeros(faces.evidence.ended.shape[:2], bool)
    for w in range(len(faces)):
        own = faces.columns(w)
        profile = _profile(*_returns(faces.evidence, w), opening[own], faces.clear_m[own])
        covered[own] = _standing(*profile, faces.clear_m[own], settings)
    places = column_places(faces.walls, faces.evidence.first, 0.0)
    for d in np.flatnonzero(doors.state == DoorState.CLOSED):
        own = faces.columns(int(doors.wall[d]))
        leaf = segment(doors, d).beside(places[own], CELL_M)
        covered[own, : cells_in(doors.head_m[d]) + 1][leaf] = False
    return Foreground(faces.evidence.first, faces.clear_m, faces.ground_m, covered)


def _returns(evidence: Evidence, w: int) -> tuple[FloatArray, FloatArray]:
    """(c, rows) returns near one face: their number, and the sum of their distances."""
    own, near = evidence.columns(w), slice(0, NEAR + 1)
    layers = evidence.ended[own][..., near], evidence.depth_sum[own][..., near]
    count, total_m = (part.sum(axis=-1, dtype=np.float64) for part in layers)
    return count, total_m


def _heights_m(rows: int) -> FloatArray:
    """(rows,) the middle of each row above the floor."""
    return (np.arange(rows) + 0.5) * CELL_M


def _profile(
    count: FloatArray, total_m: FloatArray, opening: BoolArray, clear_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(c, rows) mean distance of each cell's returns before the wall, and its weight (1/m²).

    The wall is where it is above doors, since walls alone stand there. Cells there with few returns
    count together with the columns around. Distances end at `ON_FACE_M`: a shelf's back tells more
    than its boards. Openings, and what is deeper behind the wall, count as so far behind it.
    """
    height_m = _heights_m(count.shape[1])
    room_m = np.where(np.isfinite(clear_m), clear_m, np.inf)[:, None]
    above = height_m > above_doors_m(clear_m)[:, None]
    asked = (np.arange(count.shape[1]) >= FOOT_ROW) & (height_m < room_m - _CEILING_M)
    known = asked & (count > 0) & ~opening
    mean_m = np.where(known, total_m / np.maximum(count, 1.0), np.nan)
    usual_m = row_medians(_around(np.where(above, mean_m, np.nan)).reshape(len(mean_m), -1))
    deep = opening | (mean_m < usual_m[:, None] - ON_FACE_M)
    count, total_m = (np.where(known & ~deep, of, 0.0) for of in (count, total_m))
    together = [np.nansum(_around(of), axis=2) for of in (count, total_m)]
    count, total_m = np.where(above & (count < _FEW), together, (count, total_m))
    wall_m = np.nan_to_num(usual_m)[:, None]
    before_m = np.minimum(total_m / np.maximum(count, 1.0) - wall_m, ON_FACE_M)
    variance = RAY_M**2 / np.maximum(count, 1.0) + CELL_MEAN_M**2
    before_m[deep], variance[deep] = -ON_FACE_M, CELL_MEAN_M**2
    return before_m, np.where((count > 0) | (deep & asked), 1.0 / variance, 0.0)


def _around(values: FloatArray) -> FloatArray:
    """(c, rows, columns) each cell with those beside it in its row; NaN beyond the ends."""
    padded = np.pad(values, ((_AROUND // 2,) * 2, (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, _AROUND, axis=0)


def _standing(
    mean_m: FloatArray, weight: FloatArray, clear_m: FloatArray, settings: ForegroundSettings
) -> BoolArray:
    """(c, rows) whether a cell is of what stands on the floor, no pillar and no panelling."""
    rows = np.arange(mean_m.shape[1])
    step_m, odds = _steps(mean_m, weight)
    stands = (step_m > settings.relief_m) & (rows >= cells_in(settings.extent_min_m) - 1)
    stands &= _heights_m(len(rows)) < (clear_m - 2.0 * _CEILING_M)[:, None]
    head = np.where(stands, odds, -np.inf).argmax(axis=1)[:, None]
    below = (rows <= head) & np.take_along_axis(stands, head, axis=1)
    seen, over = weight * below, weight * (rows > head)
    wall_m = (over * mean_m).sum(axis=1) / np.maximum(over.sum(axis=1), 1e-9)
    before = seen * (mean_m > np.maximum(wall_m, 0.0)[:, None] + settings.relief_m)
    all_over = np.asarray(before.sum(axis=1) > _ALL_OVER_MIN * seen.sum(axis=1))
    end = cells_in(_END_M)
    all_over[:end], all_over[len(all_over) - end :] = False, False
    covered = np.zeros(weight.shape, bool)
    for first, last in stretches(all_over, cells_in(_END_M)):
        width_m, own = (last + 1 - first) * CELL_M, slice(first, last + 1)
        stands_low = before[own, : cells_in(_FOOT_M)].any()
        if stands_low and settings.extent_min_m <= width_m <= settings.extent_max_m:
            covered[own] = below[own]
    return covered


def _steps(mean_m: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(c, rows) the step up to and with each row, and its odds (nats) against a line without.

    Both lines are of least squares, and lean as little as walls do.
    """
    height_m = _heights_m(weight.shape[1])
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    z = height_m - (weight * height_m).sum(axis=1, keepdims=True) / total
    y = mean_m - (weight * mean_m).sum(axis=1, keepdims=True) / total
    spread = (weight * z**2).sum(axis=1, keepdims=True) + _LEAN**-2
    slope = (weight * z * y).sum(axis=1, keepdims=True) / spread
    left = (weight * (y - slope * z)).cumsum(axis=1)
    below, moment = weight.cumsum(axis=1), (weight * z).cumsum(axis=1)
    information = np.maximum(below - below**2 / total - moment**2 / spread, 1e-9)
    return left / information, 0.5 * left**2 / information


def covered_places(walls: Walls, foreground: Foreground) -> FloatArray:
    """(n, 3) the middles of the covered cells, on their faces, in the map frame."""
    column, row = np.nonzero(foreground.covered)
    z = foreground.ground_m[column] + (row + 0.5) * CELL_M
    return np.column_stack([column_places(walls, foreground.first, 0.0)[column], z])
