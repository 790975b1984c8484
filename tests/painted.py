"""Evidence as tests paint it: faces of cells, and where the rays into these ended."""

from dataclasses import dataclass, field

import numpy as np

from ffmap.algorithms.base.scan import FloatArray
from ffmap.algorithms.building.evidence import BEYOND, NEAR, ON, Evidence
from ffmap.algorithms.building.model import CELL_M

ROWS = 60
DEPTHS_M = (0.07, 0.0, -0.07, -0.2, -0.6)
"""Where rays of each layer end that are not said to end elsewhere: metres before the face."""


@dataclass
class Painted:
    """One face: columns and rows of cells, nothing of which is seen until it is painted."""

    columns: int
    ended: FloatArray = field(init=False)
    depth_sum: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.ended = np.zeros((self.columns, ROWS, 6), np.float32)
        self.depth_sum = np.zeros((self.columns, ROWS, 5), np.float32)

    def paint(
        self,
        x_m: tuple[float, float],
        z_m: tuple[float, float],
        layer: int,
        rays: float = 8.0,
        before_m: float | None = None,
    ) -> "Painted":
        """So many rays into each cell between places along it and heights end there."""
        columns, rows = (slice(*(round(at / CELL_M) for at in span)) for span in (x_m, z_m))
        self.ended[columns, rows] = 0.0
        self.depth_sum[columns, rows] = 0.0
        self.ended[columns, rows, layer] = rays
        if layer < BEYOND:
            at_m = DEPTHS_M[layer] if before_m is None else before_m
            self.depth_sum[columns, rows, layer] = rays * at_m
        return self


def wall(length_m: float, top_m: float = 2.8) -> Painted:
    """A face that rays end on all over."""
    return Painted(round(length_m / CELL_M)).paint((0.0, length_m), (0.0, top_m), ON)


def part(face: Evidence, first: int, after: int) -> Evidence:
    """Some columns of one face's evidence."""
    sums = face.ended, face.depth_sum, face.depth_squares, face.light
    return Evidence(np.array([0, after - first]), *(own[first:after] for own in sums))


def evidence_of(*faces: Painted, scatter_m: float = 0.01) -> Evidence:
    """What rays found of faces; scatter_m: of the returns of each cell about their mean."""
    first = np.concatenate([[0], np.cumsum([face.columns for face in faces])]).astype(np.int64)
    none = [np.zeros((0, ROWS, layers), np.float32) for layers in (6, 5)]
    ended = np.concatenate([none[0], *(face.ended for face in faces)])
    depth_sum = np.concatenate([none[1], *(face.depth_sum for face in faces)])
    near = slice(0, NEAR + 1)
    count, total = ended[..., near].sum(axis=-1), depth_sum[..., near].sum(axis=-1)
    squares = total**2 / np.maximum(count, 1.0) + count * np.float32(scatter_m**2)
    return Evidence(first, ended, depth_sum, squares, np.zeros((*count.shape, 3), np.float32))
