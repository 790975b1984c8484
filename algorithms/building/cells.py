"""Rays that ended at wall faces and rays that passed them, as sums of layers of depth."""

from dataclasses import dataclass

import numpy as np

from ffmap.algorithms.base.scan import FloatArray, IntArray
from ffmap.algorithms.building.evidence import BEYOND, Evidence
from ffmap.algorithms.building.model import AT_FACE_M

FILLED, SUM, SQUARES, THROUGH = range(4)
"""What `WallCells.counts` holds of each cell."""


@dataclass(frozen=True)
class WallCells:
    """What the rays found in each cell of each wall face.

    first: (W + 1,) the column at which each face begins. rows: how many.
    counts: (columns, rows, 4) float32: returns down to a layer of depth, the sum and the sum of
    squares of their distances before the face (m, negative behind), and deeper rays.
    light: see `Evidence`.
    """

    first: IntArray
    rows: int
    counts: FloatArray
    light: FloatArray

    @classmethod
    def of_layers(cls, evidence: Evidence, deepest: int) -> "WallCells":
        """Count rays down to a layer as returns, and deeper ones as passed."""
        near = slice(0, deepest + 1)
        columns = (
            evidence.ended[..., near].sum(axis=-1),
            evidence.depth_sum[..., near].sum(axis=-1),
            evidence.depth_squares[..., near].sum(axis=-1),
            evidence.ended[..., deepest + 1 : BEYOND + 1].sum(axis=-1),
        )
        counts = np.stack(columns, axis=-1)
        return cls(evidence.first, counts.shape[1], counts, evidence.light)

    def of(self, wall: int) -> "WallCells":
        """Of one face alone."""
        own = slice(self.first[wall], self.first[wall + 1])
        return WallCells(
            self.first[wall : wall + 2] - self.first[wall],
            self.rows,
            self.counts[own],
            self.light[own],
        )


def returns_at_face(counts: FloatArray) -> FloatArray:
    """(…) the returns that are a face's own, of its cells or sums of them (…, 4): none where their mean lies off it."""
    filled, total = counts[..., FILLED].astype(np.float64), counts[..., SUM].astype(np.float64)
    return np.where(np.abs(total) < AT_FACE_M * filled, filled, 0.0)


def mean_before_m(counts: FloatArray) -> FloatArray:
    """(…) mean distance before the face of the returns of cells, or of sums of them (…, 4); NaN without any."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(counts[..., SUM] / counts[..., FILLED])


def depth_moments(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same, and the variance (…) about it."""
    mean_m = mean_before_m(counts)
    with np.errstate(invalid="ignore", divide="ignore"):
        return mean_m, np.maximum(counts[..., SQUARES] / counts[..., FILLED] - mean_m**2, 0.0)


def with_neighbours(counts: FloatArray) -> FloatArray:
    """Each column with the counts of the two beside it: an emitter's lines may stand farther apart than a column is."""
    summed = counts.copy()
    summed[1:] += counts[:-1]
    summed[:-1] += counts[1:]
    return summed
