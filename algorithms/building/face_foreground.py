"""What is before each wall face: how high the room is there, and what stands flat against the wall without being it.

A cupboard's back, a shelf, a leaf that was opened against the wall lie closer to it than one scan can tell. Over all scans
the mean distance of a cell's returns before the face is known to millimetres, and such things show as relief.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.labels import Label
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import segments
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.face_columns import above_doors_m, column_places
from ffmap.algorithms.building.model import CELL_M, Doors, Walls, cells_in
from ffmap.algorithms.building.ray_evidence import FILLED, FOOT_ROW, SUM, THROUGH, WallCells
from ffmap.algorithms.building.votes import Halo

_REVEAL_M, _FRONT_PERCENT = 0.03, 75.0
"""So far behind this percentile of the cells around it a cell is no longer the wall's surface."""
_WALL_COLUMNS = 11
"""Columns over which the distance of the wall above is averaged."""
_CELLS_TOGETHER = (1, 3, 5, 7)
"""Where a cell returned too little, so many along and up tell together."""
_BRIDGE_ROWS = 11
_LEAF_OFF_M, _LEAF_REACH_M = 0.03, 1.0
"""Between these distances before and behind a doorway what stands between its jambs is its leaf, no wall."""
_LEAN_ROWS, _LEAN_RMS_M, _LEAN_MAX = 20, 0.003, 0.02
"""So many rows, so close to a line that leans by no more, tell that a wall leans."""
_EDGE = 0.6
"""A patch of relief goes on where it is so much lower than its threshold."""


class BeforeWallsSettings(StepSettings):
    """Relief before walls: what many scans together show to stand before a face."""

    relief_m: float = Field(
        0.010, gt=0, description="What returns on average this many metres before a wall's face is not the wall."
    )
    above_m: float = Field(
        2.12,
        gt=0,
        description="Above this many metres, to the ceiling, the wall itself is seen; in lower rooms in the last 25 cm.",
    )
    returns_min: int = Field(8, ge=1, description="Fewest returns that tell a distance before the face.")
    scatter_max: float = Field(
        2.0, gt=0, description="What returns with this many times the wall's own scatter is no surface, but several."
    )
    foot_max_m: float = Field(
        0.3,
        gt=0,
        description="What does not come down to this many metres above the floor hangs on its wall and is wall.",
    )
    extent_min_m: float = Field(
        0.4, gt=0, description="Relief that is lower or narrower than this many metres is wall."
    )
    extent_max_m: float = Field(
        3.0, gt=0, description="Relief that is longer than this many metres is wall: panelling."
    )
    below_ceiling_m: float = Field(
        0.2, ge=0, description="Relief that comes so close to the ceiling, in metres, is wall: a pillar, a corner."
    )
    end_m: float = Field(
        0.1, ge=0, description="Closer than this many metres to a face's end another wall's returns tell."
    )


@dataclass(frozen=True)
class BeforeWalls:
    """What is before wall faces, by their cells, 5 cm wide and high.

    first: (W + 1,) the column at which each face begins.
    clear_m: (columns,) metres from the floor to the ceiling before each column; NaN where none was seen.
    covered: (columns, rows) whether something stands flat against the wall there.
    """

    first: IntArray
    clear_m: FloatArray
    covered: BoolArray


NOTHING_BEFORE = BeforeWalls(np.zeros(1, np.int64), np.zeros(0), np.zeros((0, 1), bool))


def look_before_walls(cells: WallCells, clear_m: FloatArray, settings: BeforeWallsSettings) -> BeforeWalls:
    """What stands flat against the faces.

    cells: of the faces. clear_m: (columns,) from the floor to the ceiling before each column.
    """
    covered = np.zeros(cells.counts.shape[:2], bool)
    for first, after in zip(cells.first[:-1], cells.first[1:], strict=True):
        covered[first:after] = _relief(cells.counts[first:after], clear_m[first:after], settings)
    return BeforeWalls(cells.first, clear_m, covered)


def _relief(counts: FloatArray, clear_m: FloatArray, settings: BeforeWallsSettings) -> BoolArray:
    """(c, rows) whether a cell belongs to a patch of relief that stands on the floor and is neither pillar nor panelling.

    counts: (c, rows, 4), see `WallCells`.
    """
    height_m = (np.arange(counts.shape[1]) + 0.5) * CELL_M
    top_m = np.where(np.isfinite(clear_m), clear_m, np.inf)[:, None]
    # A face that is fitted over many metres may be off its wall by more than the relief: the wall above tells.
    above = (height_m > above_doors_m(clear_m, settings.above_m)[:, None]) & (height_m < top_m - 2 * CELL_M)
    wall = (counts[..., :THROUGH] * (above & ~_reveals(counts, above))[..., None]).sum(axis=1, keepdims=True)
    wall_m, _ = _mean_and_scatter_m(wall, (_WALL_COLUMNS, 1), settings.returns_min)
    usual_m = _scatter_m(wall)
    relief_m = np.full(counts.shape[:2], np.nan)
    for size in _CELLS_TOGETHER:
        mean_m, scatter_m = _mean_and_scatter_m(counts[..., :THROUGH], (size, size), settings.returns_min)
        if size > 1:
            # Several cells may hold a thing that stands away and the wall beside it: their mean is neither's.
            mean_m = np.where(scatter_m < settings.scatter_max * usual_m, mean_m, np.nan)
        relief_m = np.where(np.isnan(relief_m), mean_m - wall_m, relief_m)
    between = (np.arange(counts.shape[1]) >= FOOT_ROW) & (height_m < top_m - 2 * CELL_M)
    relief_m -= _lean_m(np.where(between, relief_m, np.nan), height_m)
    unseen = np.isnan(relief_m)
    relief_m = np.where(unseen, 0.0, relief_m)
    before = ndimage.binary_propagation(relief_m > settings.relief_m, mask=relief_m > _EDGE * settings.relief_m)
    before[:, :FOOT_ROW] = False
    end = cells_in(settings.end_m)
    before[:end], before[len(before) - end :] = False, False
    # The boards of a shelf hide its back here and there.
    bridged = before | (ndimage.binary_closing(before, np.ones((1, _BRIDGE_ROWS))) & unseen)
    patches, _ = ndimage.label(bridged)
    covered = np.zeros_like(before)
    for number, (along, up) in enumerate(ndimage.find_objects(patches), start=1):
        length_m, rise_m = (along.stop - along.start) * CELL_M, (up.stop - up.start) * CELL_M
        hangs = up.start * CELL_M > settings.foot_max_m
        if hangs or min(length_m, rise_m) < settings.extent_min_m or length_m > settings.extent_max_m:
            continue
        own = patches[along] == number
        if not np.any(own & (height_m > top_m[along] - settings.below_ceiling_m)):
            covered[along] |= own
    return np.asarray(covered, bool)


def _lean_m(relief_m: FloatArray, height_m: FloatArray) -> FloatArray:
    """(c, rows) by how much a wall leans forward at each height, or poses' tilt makes it; 0 where it does not.

    A wall that leans comes forward little by little; what stands before one does so by a step.

    relief_m: (c, rows) before the wall above; NaN where unknown, and where floor and ceiling return. height_m: (rows,).
    """
    around = _columns_around(relief_m)
    known = np.isfinite(around).any(axis=2)
    mean_m = np.zeros_like(relief_m)
    mean_m[known] = np.nanmedian(around[known], axis=1)
    count = known.sum(axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle_m, usual_m = ((known * of).sum(axis=1, keepdims=True) / count for of in (height_m, mean_m))
        z, y = np.where(known, height_m - middle_m, 0.0), np.where(known, mean_m - usual_m, 0.0)
        slope = (z * y).sum(axis=1, keepdims=True) / (z**2).sum(axis=1, keepdims=True)
        left_of_line = (y**2).sum(axis=1) - (slope * z * y).sum(axis=1)
        below, total = known.cumsum(axis=1)[:, :-1], y.cumsum(axis=1)[:, :-1]
        # Since y sums to 0, what a step explains is the square of the sum below it, by both counts.
        by_step = np.where((below > 0) & (below < count), total**2 * (1 / below + 1 / (count - below)), 0.0)
        left_of_step = (y**2).sum(axis=1) - by_step.max(axis=1)
        leans = (left_of_line < left_of_step) & (np.sqrt(left_of_line / count[:, 0]) < _LEAN_RMS_M)
    leans &= (count[:, 0] >= _LEAN_ROWS) & (np.abs(slope[:, 0]) < _LEAN_MAX)
    return np.where(leans[:, None], usual_m + slope * (height_m - middle_m), 0.0)


def _reveals(counts: FloatArray, above: BoolArray) -> BoolArray:
    """(c, rows) which cells lie behind most of those above a door's height around them: of a window's head, or beyond it."""
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m = np.where(above, counts[..., SUM] / counts[..., FILLED], np.nan)
    around = _columns_around(mean_m)
    front_m = np.full(len(mean_m), np.nan)
    known = np.isfinite(around).any(axis=(1, 2))
    front_m[known] = np.nanpercentile(around[known], _FRONT_PERCENT, axis=(1, 2))
    return np.asarray(mean_m < front_m[:, None] - _REVEAL_M)


def _columns_around(values: FloatArray) -> FloatArray:
    """(c, rows, _WALL_COLUMNS) each cell (c, rows) with those beside it in its row; NaN beyond the ends."""
    beside = _WALL_COLUMNS // 2
    padded = np.pad(values, ((beside, beside), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, _WALL_COLUMNS, axis=0)


def _scatter_m(counts: FloatArray) -> float:
    """Standard deviation of all returns (..., 3: how many, sum, sum of squares of their distances); 0 of none."""
    filled, total, squares = counts.sum(axis=tuple(range(counts.ndim - 1)), dtype=np.float64)
    return float(np.sqrt(max(squares / filled - (total / filled) ** 2, 0.0))) if filled else 0.0


def _mean_and_scatter_m(counts: FloatArray, size: tuple[int, int], returns_min: float) -> tuple[FloatArray, FloatArray]:
    """Mean distance before the face and its standard deviation over windows of so many columns and rows; NaN where too few
    returned.

    counts: (c, rows, 3) returns, the sum of their distances, and of these squared.
    """
    filled, total, squares = (ndimage.uniform_filter(counts[..., i].astype(np.float64), size) for i in range(3))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m = np.where(filled * size[0] * size[1] >= returns_min, total / filled, np.nan)
        return mean_m, np.sqrt(np.maximum(squares / filled - mean_m**2, 0.0))


def covered_places(walls: Walls, before: BeforeWalls) -> FloatArray:
    """(n, 3) the middles of the covered cells, on their faces, metres above the floor."""
    column, row = np.nonzero(before.covered)
    return np.column_stack([column_places(walls, before.first, 0.0)[column], (row + 0.5) * CELL_M])


def halo_at_walls(halo: Halo, walls: Walls, doors: Doors, before: BeforeWalls, near_m: float) -> Halo:
    """The halo without that of "walls" which the building does not have: what scans took for one.

    Ducts, leaves, cupboards: they lie farther than `near_m` metres from every face, or stand before one. And straight before
    and behind a doorway hangs its leaf.
    """
    is_wall = halo.label == Label.WALL
    centre = halo.centres
    at_face = np.zeros(len(halo.keys), bool)
    for w, face in enumerate(segments(walls)):
        place_m = face.place_m(centre)
        near = (np.abs(face.before_m(centre)) < near_m) & face.beside(centre, near_m)
        column = np.clip((place_m[near] / CELL_M).astype(np.int64), 0, before.first[w + 1] - before.first[w] - 1)
        row = np.clip((centre[near, 2] / CELL_M).astype(np.int64), 0, before.covered.shape[1] - 1)
        at_face[near] |= ~before.covered[before.first[w] + column, row]
    for doorway, reveal_m, head_m in zip(segments(doors), doors.reveal_m, doors.head_m, strict=True):
        before_m = doorway.before_m(centre)
        within_wall = (before_m > -reveal_m - _LEAF_OFF_M) & (before_m < _LEAF_OFF_M)
        between_jambs = doorway.beside(centre) & (centre[:, 2] < head_m)
        at_face &= ~(between_jambs & (np.abs(before_m) < _LEAF_REACH_M) & ~within_wall)
    kept = ~is_wall | at_face
    return Halo(halo.keys[kept], halo.label[kept], halo.voxel_m)
