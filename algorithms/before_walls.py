"""What is before each wall face: how high the room is there, and what stands flat against the wall without being it.

A cupboard's back, a shelf, a leaf that was opened against the wall lie closer to it than one scan can tell. Over all scans
the mean distance of a cell's returns before the face is known to millimetres, and such things show as relief.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field
from scipy import ndimage

from algorithms.building import CELL_M, WallCells, Walls
from algorithms.labels import Label
from algorithms.scan import BoolArray, FloatArray, IntArray
from algorithms.semantic_map import Halo
from algorithms.settings import StepSettings
from algorithms.standing_walls import column_places

_FILLED, _SUM = 0, 1
_WALL_COLUMNS = 11
"""Columns over which the distance of the wall above is averaged."""
_BRIDGE_ROWS = 11
_EDGE = 0.6
"""A patch of relief goes on where it is so much lower than its threshold."""
_FOOT_ROWS = 2
"""Rows that hold the floor's own returns, and skirting boards."""


class BeforeWallsSettings(StepSettings):
    """Relief before walls: what many scans together show to stand before a face."""

    relief_m: float = Field(
        0.014, gt=0, description="What returns on average so many metres before a wall's face is not the wall."
    )
    above_m: float = Field(2.12, gt=0, description="Above so many metres, to the ceiling, the wall itself is seen.")
    returns_min: int = Field(8, ge=1, description="Fewest returns that tell a distance before the face.")
    foot_max_m: float = Field(
        0.3,
        gt=0,
        description="What does not come down to so many metres above the floor hangs on its wall and is wall.",
    )
    extent_min_m: float = Field(0.4, gt=0, description="Relief that is lower or narrower than so many metres is wall.")
    extent_max_m: float = Field(3.0, gt=0, description="Relief that is longer than so many metres is wall: panelling.")
    below_ceiling_m: float = Field(
        0.2, ge=0, description="Relief that comes so close to the ceiling, in metres, is wall: a pillar, a corner."
    )
    end_m: float = Field(
        0.1, ge=0, description="Closer than so many metres to a face's end another wall's returns tell."
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
    above = (height_m > settings.above_m) & (height_m < top_m - 2 * CELL_M)
    wall_m = _mean_m(
        (counts[..., : _SUM + 1] * above[..., None]).sum(axis=1, keepdims=True), (_WALL_COLUMNS, 1), settings
    )
    relief_m = _mean_m(counts[..., : _SUM + 1], (1, 1), settings) - wall_m
    unseen = np.isnan(relief_m)
    relief_m = np.where(unseen, 0.0, relief_m)
    before = ndimage.binary_propagation(relief_m > settings.relief_m, mask=relief_m > _EDGE * settings.relief_m)
    before[:, :_FOOT_ROWS] = False
    end = int(settings.end_m / CELL_M)
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


def _mean_m(counts: FloatArray, size: tuple[int, int], settings: BeforeWallsSettings) -> FloatArray:
    """Mean distance before the face over windows of so many columns and rows; NaN where too few returned.

    counts: (c, rows, 2) returns, and the sum of their distances.
    """
    filled, total = (ndimage.uniform_filter(counts[..., i].astype(np.float64), size) for i in (_FILLED, _SUM))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(filled * size[0] * size[1] >= settings.returns_min, total / filled, np.nan))


def covered_places(walls: Walls, before: BeforeWalls) -> FloatArray:
    """(n, 3) the middles of the covered cells, on their faces, metres above the floor."""
    column, row = np.nonzero(before.covered)
    return np.column_stack([column_places(walls, before.first, 0.0)[column], (row + 0.5) * CELL_M])


def halo_at_walls(halo: Halo, walls: Walls, before: BeforeWalls, near_m: float) -> Halo:
    """The halo without that of "walls" which the building does not have: what scans took for one.

    Ducts, leaves, cupboards: they lie farther than `near_m` metres from every face, or stand before one.
    """
    is_wall = halo.label == Label.WALL
    centre = halo.centres
    at_face = np.zeros(len(halo.keys), bool)
    for w in range(len(walls)):
        length_m = float(np.linalg.norm(walls.ends[w, 1] - walls.ends[w, 0]))
        relative = centre[:, :2] - walls.ends[w, 0]
        place_m = relative @ (walls.ends[w, 1] - walls.ends[w, 0]) / max(length_m, 1e-9)
        near = (np.abs(relative @ walls.normal[w]) < near_m) & (place_m > -near_m) & (place_m < length_m + near_m)
        column = np.clip((place_m[near] / CELL_M).astype(np.int64), 0, before.first[w + 1] - before.first[w] - 1)
        row = np.clip((centre[near, 2] / CELL_M).astype(np.int64), 0, before.covered.shape[1] - 1)
        at_face[near] |= ~before.covered[before.first[w] + column, row]
    kept = ~is_wall | at_face
    return Halo(halo.keys[kept], halo.label[kept], halo.voxel_m)
