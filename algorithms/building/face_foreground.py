"""What is before each wall face: how high the room is there, and what stands flat against the wall without being it.

A cupboard's back, a shelf, a leaf that was opened against the wall lie closer to it than one scan can tell. Over all scans
the mean distance of a cell's returns before the face is known to millimetres, and they show as relief.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy import ndimage

from ffmap.algorithms.base.known import row_medians
from ffmap.algorithms.base.scan import BoolArray, FloatArray, IntArray
from ffmap.algorithms.base.segments import segment
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.evidence import FOOT_ROW, NEAR, Evidence, first_columns
from ffmap.algorithms.building.model import CELL_M, ON_FACE_M, Doors, Walls, cells_in
from ffmap.algorithms.building.storey import Storey, TracedFaces, above_doors_m, column_places
from ffmap.algorithms.scan.doors import DoorState


class ForegroundSettings(StepSettings):
    """Relief before walls: what many scans together show to stand before a face."""

    relief_m: float = Field(0.010, gt=0, description="Minimum mean distance (m) before a wall's face of relief.")
    edge_share: float = Field(0.6, gt=0, le=1, description="A patch of relief ends below this share of `relief_m`.")
    wall_columns: int = Field(11, ge=1, description="Columns over which the wall above is averaged.")
    returns_min: int = Field(8, ge=1, description="Minimum number of returns that tell a distance before the face.")
    together_max: int = Field(
        7, ge=1, description="Maximum edge, in cells, of the window that is averaged where cells returned too little."
    )
    scatter_max: float = Field(
        2.0,
        gt=0,
        description="A window whose scatter is more than this many times the wall's own holds several surfaces.",
    )
    lean_rows_min: int = Field(20, ge=3, description="Minimum number of rows that tell that a wall leans.")
    lean_rms_max_m: float = Field(
        0.003, gt=0, description="Maximum RMS distance (m) of a leaning wall's rows from a line."
    )
    lean_max: float = Field(0.02, gt=0, description="Maximum lean of a wall, in metres per metre of height.")
    gap_max_m: float = Field(
        0.5, ge=0, description="Maximum height (m) of a gap in relief: a board hides a shelf's back."
    )
    foot_max_m: float = Field(
        0.3,
        gt=0,
        description="Relief that does not come down to this height above the floor (m) hangs on its wall and is wall.",
    )
    strip_max_m: float = Field(0.15, gt=0, description="Maximum width (m) of a strip of relief that is wall: a casing, a skirting.")
    extent_min_m: float = Field(0.4, gt=0, description="Minimum height and width (m) of relief without such strips.")
    extent_max_m: float = Field(3.0, gt=0, description="Maximum width (m) of relief; what is wider is panelling, wall.")
    below_ceiling_m: float = Field(
        0.2, ge=0, description="Relief that comes closer to the ceiling than this (m) is wall: a pillar, a corner."
    )
    end_m: float = Field(0.1, ge=0, description="Distance (m) from a face's end where other walls return.")


@dataclass(frozen=True)
class Foreground:
    """What is before wall faces, by their cells, 5 cm wide and high.

    first: (W + 1,) the column at which each face begins.
    clear_m: (columns,) metres from the floor to the ceiling before each column; NaN where none was seen.
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
        wider = [np.pad(part.covered, ((0, 0), (0, rows - part.covered.shape[1]))) for part in (self, more)]
        return Foreground(
            np.concatenate([self.first, self.first[-1] + more.first[1:]]),
            np.concatenate([self.clear_m, more.clear_m]),
            np.concatenate([self.ground_m, more.ground_m]),
            np.concatenate(wider),
        )


def bare_foreground(low: Walls, storey: Storey) -> Foreground:
    """That of low walls: nothing stands before them, and what lies before them is as high as they are."""
    first = first_columns(low)
    ground_m = storey.ground_m(column_places(low, first))
    return Foreground(first, np.repeat(low.top_m, np.diff(first)), ground_m, np.zeros((len(ground_m), 1), bool))


def find_foreground(
    faces: TracedFaces, opening: BoolArray, doors: Doors, settings: ForegroundSettings
) -> Foreground:
    """What stands flat against the faces, but for the leaves of closed doors.

    opening: (columns, rows) the cells of openings, which are no wall.
    """
    above_m = above_doors_m(faces.clear_m)
    covered = np.zeros(faces.evidence.ended.shape[:2], bool)
    for w in range(len(faces)):
        own = faces.columns(w)
        returns = _returns(faces.evidence, w) * ~opening[own][..., None]
        relief_m = _relief_m(returns, faces.clear_m[own], above_m[own], settings)
        covered[own] = _standing_patches(relief_m, faces.clear_m[own], settings)
    places = column_places(faces.walls, faces.evidence.first, 0.0)
    for d in np.flatnonzero(doors.state == DoorState.CLOSED):
        own = faces.columns(int(doors.wall[d]))
        leaf = segment(doors, d).beside(places[own], CELL_M)
        covered[own, : cells_in(doors.head_m[d]) + 1][leaf] = False
    return Foreground(faces.evidence.first, faces.clear_m, faces.ground_m, covered)


def _returns(evidence: Evidence, w: int) -> FloatArray:
    """(c, rows, 3) returns near one face: their number, and sums of distances and of squares."""
    own, near = evidence.columns(w), slice(0, NEAR + 1)
    layers = evidence.ended[own][..., near], evidence.depth_sum[own][..., near]
    sums = [part.sum(axis=-1, dtype=np.float64) for part in layers]
    return np.stack([*sums, evidence.depth_squares[own]], axis=-1)


def _heights_m(rows: int) -> FloatArray:
    """(rows,) the middle of each row above the floor."""
    return (np.arange(rows) + 0.5) * CELL_M


def _relief_m(counts: FloatArray, clear_m: FloatArray, above_m: FloatArray, settings: ForegroundSettings) -> FloatArray:
    """(c, rows) mean distance of each cell's returns before the wall; NaN where too few returned.

    counts: (c, rows, 3), see `_returns`. above_m: (c,) height above which nothing stands before the wall.
    """
    height_m = _heights_m(counts.shape[1])
    below_ceiling = height_m < np.where(np.isfinite(clear_m), clear_m, np.inf)[:, None] - 2 * CELL_M
    # A face that is fitted over many metres may be off its wall by more than the relief: the wall above tells.
    above = (height_m > above_m[:, None]) & below_ceiling
    wall = (counts * _no_deeper(counts, above, settings)[..., None]).sum(axis=1, keepdims=True)
    wall_m, _ = _mean_and_scatter_m(wall, (settings.wall_columns, 1), settings.returns_min)
    usual_m = _scatter_m(wall)
    relief_m = np.full(counts.shape[:2], np.nan)
    for size in range(1, settings.together_max + 1, 2):
        mean_m, scatter_m = _mean_and_scatter_m(counts, (size, size), settings.returns_min)
        if size > 1:
            # Several cells may hold furniture that stands away and the wall beside it: their mean is neither's.
            mean_m = np.where(scatter_m < settings.scatter_max * usual_m, mean_m, np.nan)
        relief_m = np.where(np.isnan(relief_m), mean_m - wall_m, relief_m)
    between = (np.arange(counts.shape[1]) >= FOOT_ROW) & below_ceiling
    return relief_m - _lean_m(np.where(between, relief_m, np.nan), height_m, settings)


def _standing_patches(relief_m: FloatArray, clear_m: FloatArray, settings: ForegroundSettings) -> BoolArray:
    """(c, rows) whether a cell belongs to a patch of relief that stands on the floor and is neither pillar nor panelling."""
    unseen = np.isnan(relief_m)
    relief_m = np.where(unseen, 0.0, relief_m)
    edge = relief_m > settings.edge_share * settings.relief_m
    before = ndimage.binary_propagation(relief_m > settings.relief_m, mask=edge)
    before[:, :FOOT_ROW] = False
    end = cells_in(settings.end_m)
    before[:end], before[len(before) - end :] = False, False
    # The boards of a shelf hide its back here and there.
    closed = ndimage.binary_closing(before, np.ones((1, cells_in(settings.gap_max_m) + 1)))
    whole = before | (closed & unseen)
    # A casing, or a skirting board, is a strip.
    core = ndimage.binary_opening(whole, np.ones((cells_in(settings.strip_max_m) + 1,) * 2))
    patches, _ = ndimage.label(whole)
    close_below = _heights_m(relief_m.shape[1]) > clear_m[:, None] - settings.below_ceiling_m
    covered = np.zeros_like(before)
    for number, (along, up) in enumerate(ndimage.find_objects(patches), start=1):
        own = patches[along] == number
        length_m, hangs = (along.stop - along.start) * CELL_M, up.start * CELL_M > settings.foot_max_m
        broad = own & core[along]
        extents_m = [CELL_M * np.count_nonzero(broad.any(axis=axis)) for axis in (0, 1)]
        if hangs or min(extents_m) < settings.extent_min_m or length_m > settings.extent_max_m:
            continue
        if not np.any(own & close_below[along]):
            covered[along] |= own
    return np.asarray(covered, bool)


def _lean_m(relief_m: FloatArray, height_m: FloatArray, settings: ForegroundSettings) -> FloatArray:
    """(c, rows) by how much a wall leans forward at each height, or the poses' tilt makes it lean; 0 where it does not.

    A wall that leans comes forward gradually; what stands before one does so by a step.

    relief_m: (c, rows) before the wall above; NaN where unknown, and where floor and ceiling return. height_m: (rows,).
    """
    around = _columns_around(relief_m, settings.wall_columns)
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
        leans = (left_of_line < left_of_step) & (np.sqrt(left_of_line / count[:, 0]) < settings.lean_rms_max_m)
    leans &= (count[:, 0] >= settings.lean_rows_min) & (np.abs(slope[:, 0]) < settings.lean_max)
    return np.where(leans[:, None], usual_m + slope * (height_m - middle_m), 0.0)


def _no_deeper(counts: FloatArray, above: BoolArray, settings: ForegroundSettings) -> BoolArray:
    """(c, rows) which cells above a door's height lie no deeper than most around them: none of a window's head, or beyond it."""
    mean_m = np.where(above & (counts[..., 0] > 0), counts[..., 1] / np.maximum(counts[..., 0], 1.0), np.nan)
    usual_m = row_medians(_columns_around(mean_m, settings.wall_columns).reshape(len(mean_m), -1))
    return np.asarray(mean_m > usual_m[:, None] - ON_FACE_M)


def _columns_around(values: FloatArray, columns: int) -> FloatArray:
    """(c, rows, columns) each cell (c, rows) with those beside it in its row; NaN beyond the ends."""
    beside = columns // 2
    padded = np.pad(values, ((beside, beside), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, columns, axis=0)


def _scatter_m(counts: FloatArray) -> float:
    """Standard deviation of all returns (..., 3: number, sum and sum of squares of their distances); 0 where there is none."""
    filled, total, squares = counts.sum(axis=tuple(range(counts.ndim - 1)), dtype=np.float64)
    return float(np.sqrt(max(squares / filled - (total / filled) ** 2, 0.0))) if filled else 0.0


def _mean_and_scatter_m(counts: FloatArray, size: tuple[int, int], returns_min: float) -> tuple[FloatArray, FloatArray]:
    """Mean distance before the face and its standard deviation over windows; NaN where too few returned.

    counts: (c, rows, 3) returns, the sum of their distances, and of these squared. size: columns and rows of a window.
    """
    filled, total, squares = (ndimage.uniform_filter(counts[..., i].astype(np.float64), size) for i in range(3))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m = np.where(filled * size[0] * size[1] >= returns_min, total / filled, np.nan)
        return mean_m, np.sqrt(np.maximum(squares / filled - mean_m**2, 0.0))


def covered_places(walls: Walls, foreground: Foreground) -> FloatArray:
    """(n, 3) the middles of the covered cells, on their faces, in the map frame."""
    column, row = np.nonzero(foreground.covered)
    z = foreground.ground_m[column] + (row + 0.5) * CELL_M
    return np.column_stack([column_places(walls, foreground.first, 0.0)[column], z])
