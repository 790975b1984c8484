"""Cloth that hangs: walls are plane, and cloth hangs in folds.

A curtain reaches from the ceiling to the floor as a wall does, and lets no ray pass. But its columns lie some centimetres before
those beside them and behind them by turns, at the same places from top to bottom.
"""

import numpy as np
from pydantic import Field

from ffmap.algorithms.base.known import row_medians
from ffmap.algorithms.base.scan import BoolArray, FloatArray
from ffmap.algorithms.base.settings import StepSettings
from ffmap.algorithms.building.cells import FILLED, THROUGH, mean_before_m
from ffmap.algorithms.building.evidence import FOOT_ROW
from ffmap.algorithms.building.face_columns import long_runs
from ffmap.algorithms.building.model import cells_in

_SEEN_MIN = 0.3  # Of a column's cells, for their median to say where it lies


class FoldsSettings(StepSettings):
    """Telling cloth from walls by its folds."""

    depth_min_m: float = Field(
        0.01,
        gt=0,
        description="Minimum distance (m) of a column's returns from the middle of those of the two beside it, by the median of "
        "the columns around.",
    )
    around_m: float = Field(0.45, gt=0, description="Width (m) around a column over which that median is taken.")
    width_min_m: float = Field(0.4, gt=0, description="Minimum width (m) of cloth: a reveal with its frame is narrower.")


def in_folds(counts: FloatArray, settings: FoldsSettings) -> BoolArray:
    """(c,) which columns of one face hang in folds; counts: (c, rows, 4), see `WallCells`."""
    around = cells_in(settings.around_m)
    before_m = mean_before_m(counts)
    before_m[(counts[..., FILLED] < 2) | (counts[..., FILLED] <= counts[..., THROUGH])] = np.nan
    rows = np.flatnonzero(np.isfinite(before_m[:, FOOT_ROW:]).any(axis=0)) + FOOT_ROW
    if len(counts) < around or len(rows) < 2:
        return np.zeros(len(counts), bool)
    # What stands on a shelf differs from what is beside it as well, but not alike below and above.
    low_m, high_m = (_beside_others_m(before_m[:, half]) for half in np.array_split(rows, 2))
    fold_m = np.where(low_m * high_m > 0.0, np.minimum(np.abs(low_m), np.abs(high_m)), 0.0)
    fold_m[np.isnan(low_m) | np.isnan(high_m)] = np.nan
    padded = np.pad(fold_m, around // 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * (around // 2) + 1)
    known = np.isfinite(windows).sum(axis=1) > around // 2
    folded = known & (row_medians(windows) > settings.depth_min_m)
    return long_runs(folded, cells_in(settings.width_min_m), bridge=1)


def _beside_others_m(before_m: FloatArray) -> FloatArray:
    """(c,) how far each column (c, rows) lies before the middle of the two beside it; NaN where one of them was hardly seen."""
    column_m = row_medians(before_m, _SEEN_MIN)
    beside_m = np.full(len(column_m), np.nan)
    beside_m[1:-1] = column_m[1:-1] - 0.5 * (column_m[:-2] + column_m[2:])
    return beside_m
