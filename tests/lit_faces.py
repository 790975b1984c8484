"""A wall's face whose cells return light, and patches of another finish, with seeded noise."""

import numpy as np

from ffmap.algorithms.building.model import CELL_M
from ffmap.algorithms.building.ray_evidence import FILLED, SQUARES, SUM, WallCells, first_columns
from tests.faces import faces

Rectangle = tuple[float, float, float, float]
"""From and to along the face, from and to above the floor, metres."""
LENGTH_M, HEIGHT_M = 5.0, 2.7
RETURNS, WALL, SCATTER = 20, 60.0, 6.0
FALL = np.array([1.0, 0.9, 0.7, 0.5])
FACE = faces(((0, 0), (LENGTH_M, 0)))


def covered(edges_m: np.ndarray, start_m: float, stop_m: float) -> np.ndarray:
    """(n,) which share of each cell between successive edges lies between two places."""
    shared_m = np.minimum(edges_m[1:], stop_m) - np.maximum(edges_m[:-1], start_m)
    return np.clip(shared_m, 0, None) / CELL_M


def filled(
    *patches: tuple[Rectangle, float], before_m: float = 0.0, flip: bool = False
) -> WallCells:
    """A face with patches of other intensities; before_m: how far the patches are before it."""
    rng = np.random.default_rng(5)
    columns, rows = round(LENGTH_M / CELL_M), round(HEIGHT_M / CELL_M)
    along_m, up_m = np.arange(columns + 1) * CELL_M, np.arange(rows + 1) * CELL_M
    mean, out_m = np.full((columns, rows), WALL), np.zeros((columns, rows))
    for (a, b, c, d), own in patches:
        share = np.outer(covered(along_m, a, b), covered(up_m, c, d))
        mean, out_m = mean + share * (own - mean), np.maximum(out_m, share * before_m)
    angles = rng.multinomial(RETURNS, np.full(4, 0.25), size=mean.shape)
    light = np.zeros((columns, rows + 10, 4, 2), np.float32)
    light[:, :rows, :, 0] = angles
    noise = rng.normal(0.0, SCATTER, angles.shape) * np.sqrt(angles)
    light[:, :rows, :, 1] = FALL * (angles * mean[..., None] + noise)
    counts = np.zeros((columns, rows + 10, 4), np.float32)
    counts[:, :rows, FILLED], counts[:, :rows, SUM] = RETURNS, RETURNS * out_m
    counts[:, :rows, SQUARES] = RETURNS * (out_m**2 + 1e-4)
    order = slice(None, None, -1) if flip else slice(None)
    return WallCells(first_columns(FACE), rows + 10, counts[order], light[order])
