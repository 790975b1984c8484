"""Means and medians that ignore NaN without warnings."""

from collections.abc import Callable

import numpy as np

from ffmap.algorithms.base.scan import FloatArray


def mean_known(values: FloatArray) -> float:
    """The mean of the finite values; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def median_known(values: FloatArray) -> float:
    """The median of the finite values; NaN where there are none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")


def row_means(values: FloatArray, known_min: float = 0.0) -> FloatArray:
    """(n,) means of the rows (n, m); NaN where fewer than this share of a row is finite."""
    return _of_known_rows(np.nanmean, values, known_min)


def row_medians(values: FloatArray, known_min: float = 0.0) -> FloatArray:
    """(n,) medians of the rows (n, m); NaN where fewer than this share of a row is finite."""
    return _of_known_rows(np.nanmedian, values, known_min)


def _of_known_rows(
    of: Callable[..., FloatArray], values: FloatArray, known_min: float
) -> FloatArray:
    known = np.isfinite(values).sum(axis=1)
    enough = (known > 0) & (known >= known_min * values.shape[1])
    found = np.full(len(values), np.nan)
    found[enough] = of(values[enough], axis=1)
    return found
